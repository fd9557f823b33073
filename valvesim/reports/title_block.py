"""What every page and picture is marked with: title, valve, version of the package, date."""

from __future__ import annotations

import datetime
from dataclasses import dataclass, field
from importlib.metadata import PackageNotFoundError, version

from valvesim.units import DISPLAY, quantities, symbol
from valvesim.valve.parameters import Valve, reference_valve

MOST_CHANGES = 3  # of the reference valve that are named one by one


def package_version() -> str:
    """The version of valvesim that is installed; "unknown" where it runs from a folder that never was."""
    try:
        return version("valvesim")
    except PackageNotFoundError:
        return "unknown"


@dataclass(frozen=True, kw_only=True)
class TitleBlock:
    """Title of a page or picture, the valve that it shows, the day of the run and the version that ran it."""

    title: str
    valve: str
    date: datetime.date
    version: str = field(default_factory=package_version)

    @property
    def origin(self) -> str:
        """All but the title, on one line."""
        return f"{self.valve} · valvesim {self.version} · {self.date.isoformat()}"


def valve_name(valve: Valve) -> str:
    """The valve in words: its name, or the reference valve with what differs from it where that is little."""
    if valve.name:
        return valve.name
    reference, changes = reference_valve(), []
    for name, field_ in quantities(valve).items():
        value = getattr(valve, name)
        if value != getattr(reference, name):
            unit, factor = DISPLAY.get(field_.metadata["unit"], (field_.metadata["unit"], 1.0))
            shown = "" if unit in ("1", "-") else f" {symbol(unit)}"
            changes.append(f"{name.replace('_', ' ')} {value * factor:.5g}{shown}")
    if valve.flow_coefficients is not reference.flow_coefficients:
        changes.append("another flow law")
    if not changes:
        return "reference valve"
    if len(changes) > MOST_CHANGES:
        return f"reference valve with {len(changes)} parameters changed"
    return f"reference valve with {', '.join(changes)}"
