"""What can go wrong, by name: input that makes no sense, a solve that fails, a range of validity that is left."""

from __future__ import annotations

import difflib
import warnings
from collections.abc import Iterable

LONGEST_MESSAGE = 1000  # characters


class ValvesimError(Exception):
    """Base of every error that this package raises on purpose. Its text is one line that is safe on a terminal."""

    def __str__(self) -> str:
        return one_line(super().__str__())


def one_line(text: str) -> str:
    """A text from outside on one line: control characters written as escapes, the middle of a long one left out."""
    if len(text) > LONGEST_MESSAGE:
        text = f"{text[: LONGEST_MESSAGE // 2]} ... {text[-LONGEST_MESSAGE // 2 :]}"
    return text if text.isprintable() else "".join(c if c.isprintable() else ascii(c)[1:-1] for c in text)


class InputError(ValvesimError, ValueError):
    """The input is wrong: the message says what, where, the value, the allowed range and the nearest valid name."""


class SolveError(ValvesimError, RuntimeError):
    """A solver failed: the message says when, in which state, and what to try."""


class ValidityWarning(UserWarning):
    """A law is used outside the range that it was fitted or rated for."""


_already_warned: set[str] = set()


def warn_once(message: str, *, about: str | None = None) -> None:
    """Warn with a `ValidityWarning`, once per process and subject: the message, unless `about` names one."""
    if (about or message) not in _already_warned:
        _already_warned.add(about or message)
        warnings.warn(message, ValidityWarning, stacklevel=2)


def forget_warnings() -> None:
    """Let every validity warning be given again (for a new run in the same process, and for tests)."""
    _already_warned.clear()


def nearest(name: str, names: Iterable[str]) -> str:
    """`"; did you mean 'x'?"` for the closest valid name, else the list of valid names (all of a short one)."""
    names = sorted(names)
    close = difflib.get_close_matches(str(name), names, n=1, cutoff=0.5)
    if close:
        return f"; did you mean {close[0]!r}?"
    return f"; valid names: {', '.join(names)}" if names else ""


def unknown_name(what: str, name: str, names: Iterable[str], where: str = "") -> InputError:
    """The error for a name that is not one of `names`, ready to be raised."""
    return InputError(f"{where + ': ' if where else ''}unknown {what} {name!r}{nearest(name, names)}")
