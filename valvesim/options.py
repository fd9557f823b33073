"""How an option is declared: a threshold, tolerance or size with its unit, meaning and where its value comes from.

A stage has a frozen dataclass of them, and `option_table` lists all. A value whose source is `JUDGEMENT` follows from
no data sheet or theorem.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from typing import Any

JUDGEMENT = "judgement"


def option(value: Any, unit: str, doc: str, source: str) -> Any:
    """A dataclass field that declares an option once: value, unit ("1" for a number), meaning, source of the value."""
    return dataclasses.field(default=value, metadata={"unit": unit, "doc": doc, "source": source})


def option_table(options: Any) -> Iterator[tuple[str, Any, str, str, str]]:
    """(name, value, unit, doc, source) of each option, those of stages inside as `stage.name`."""
    for declared in dataclasses.fields(options):
        value = getattr(options, declared.name)
        if dataclasses.is_dataclass(value):
            yield from ((f"{declared.name}.{name}", *rest) for name, *rest in option_table(value))
        else:
            yield declared.name, value, *(declared.metadata[key] for key in ("unit", "doc", "source"))
