"""What can go wrong, by name: input that makes no sense, a solve that fails, a range of validity that is left."""

from __future__ import annotations

import difflib
import os
import warnings
from collections.abc import Iterable
from typing import Any

LONGEST_MESSAGE = 1000  # characters
COMPARED_CHARACTERS = 200  # characters of an unknown name that are compared with the valid ones


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
    """The input is wrong: the message says what, where, the value, the allowed range and the nearest valid name.

    `problem` is told after `key` and `joint`: `valve.null_gap` ` = ` `0 m is outside (0, 0.001] m`. Whoever decides by
    an error reads its fields and never its text:

    key      dotted key of a file, or name of an argument, that is wrong; "" where the problem is no single one's
    name     what nobody knows of the table or list `key`, "" where the problem is another
    related  further keys that the problem is between
    file     where it stands, with its `line` (from 1), or
    setting  the `--set` of the command line that it comes from
    """

    def __init__(
        self,
        problem: str,
        *,
        key: str = "",
        joint: str = ": ",
        name: str = "",
        related: tuple[str, ...] = (),
        file: str | os.PathLike[str] = "",
        line: int | None = None,
        setting: str = "",
    ) -> None:
        super().__init__(problem)
        self.problem, self.key, self.joint, self.name, self.related = problem, key, joint, name, related
        self.file, self.line, self.setting = str(file), line, setting

    def __str__(self) -> str:
        place = f"--set {self.setting!r}" if self.setting else self.file
        place += f", line {self.line}" if self.line is not None else ""
        return one_line(f"{place}{': ' if place else ''}{self.key}{self.joint if self.key else ''}{self.problem}")

    @property
    def keys(self) -> tuple[str, ...]:
        """The dotted keys that the problem speaks of, an unknown name as one of its table."""
        return tuple(key for key in (".".join(filter(None, (self.key, self.name))), *self.related) if key)

    def at(self, **fields: Any) -> InputError:
        """The same error with other fields."""
        own = ("key", "joint", "name", "related", "file", "line", "setting")
        return InputError(self.problem, **({name: getattr(self, name) for name in own} | fields))

    def moved(self, old: str, new: str) -> InputError:
        """The same error with its keys of the table `old` in the table `new`; "" is the top of the file, both ways."""

        def key(given: str) -> str:
            if not given or (old and given != old and not given.startswith(f"{old}.")):
                return given
            return ".".join(filter(None, (new, given[len(old) :].strip(".")))) if old else f"{new}.{given}".strip(".")

        return self.at(key=key(self.key), related=tuple(map(key, self.related)))


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
    close = difflib.get_close_matches(str(name)[:COMPARED_CHARACTERS], names, n=1, cutoff=0.5)
    if close:
        return f"; did you mean {close[0]!r}?"
    return f"; valid names: {', '.join(names)}" if names else ""


def check_kind(value: Any, kinds: type | tuple[type, ...], where: str, expected: str) -> None:
    """Raise InputError unless `value` is one of these kinds; `expected` says in words what is."""
    if not isinstance(value, kinds):
        raise InputError(f"expected {expected}, got {one_line(repr(value))}", key=where)


def unknown_name(what: str, name: str, names: Iterable[str], where: str = "") -> InputError:
    """The error for a name that is not one of `names` of the table or list `where`, ready to be raised."""
    return InputError(f"unknown {what} {name!r}{nearest(name, names)}", key=where, name=name)
