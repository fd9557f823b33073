"""Standard streams that may be closed, full, end in a closed pipe, or know few characters."""

from __future__ import annotations

import codecs
import os
import sys

CLOSED_PIPE = 141  # the exit code of a program that SIGPIPE ends
_PLAIN = {
    "°": "deg", "±": "+-", "²": "^2", "³": "^3", "µ": "u", "μ": "u", "·": "*", "×": "x", "–": "-", "−": "-", "…": "...",
    "Δ": "d", "→": "->", "≤": "<=", "≥": ">=",
}  # fmt: skip


def prepare_streams() -> None:
    """Standard streams that take any text: closed ones lead nowhere, and missing characters have plain ones."""
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        if getattr(sys, name) is None:  # closed: opened in its place, lest a file of results gets its number
            setattr(sys, name, open(os.devnull, mode, encoding="utf-8"))
    codecs.register_error("valvesim.plain", _plain)
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="valvesim.plain")


def _plain(error: UnicodeError) -> tuple[str, int]:
    """What stands for the characters that a stream's encoding lacks."""
    if not isinstance(error, UnicodeEncodeError):
        raise error
    return "".join(_PLAIN.get(each, "?") for each in error.object[error.start : error.end]), error.end


def drop_output() -> None:
    """What is still to be written to standard output goes nowhere: the interpreter would complain of it at its end."""
    try:
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, sys.stdout.fileno())
        os.close(nowhere)
    except (OSError, ValueError):
        sys.stdout = open(os.devnull, "w", encoding="utf-8")
