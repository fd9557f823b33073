"""What objects are in a session: one line as `repr`, a small page in a notebook.

The page and the pictures of an object are made by `valvesim.notebook`, far above in the layers, which is loaded by its
name when an object is first looked at: this is the one way upwards.
"""

from __future__ import annotations

from importlib import import_module
from typing import Any


class Shown:
    """An object that people look at. A class of it says `in_words` what it is."""

    __slots__ = ()

    def in_words(self) -> str:
        """What the object is, on one line."""
        raise NotImplementedError

    def __repr__(self) -> str:
        return f"<{type(self).__name__}: {self.in_words()}>"

    def _repr_html_(self) -> str:
        return str(notebook().html(self))


def notebook() -> Any:
    """The module `valvesim.notebook`."""
    return import_module("valvesim.notebook")
