"""What every page and picture is marked with: title, valve, version of the package, date."""

from __future__ import annotations

import datetime
from collections.abc import Sequence
from dataclasses import dataclass, field

from valvesim.valve.valve_name import valve_name as valve_name
from valvesim.version import package_version as package_version


@dataclass(frozen=True, kw_only=True)
class TitleBlock:
    """Title of a page or picture, the valve that it shows, the day of the run and the version that ran it."""

    title: str
    valve: str
    date: datetime.date
    version: str = field(default_factory=package_version)
    facts: Sequence[tuple[str, str]] = ()  # what else it was made with: oil, tolerance, seed

    @property
    def origin(self) -> str:
        """All but the title, on one line."""
        return f"{self.valve} · valvesim {self.version} · {self.date.isoformat()}"

    @property
    def made_by(self) -> list[tuple[str, str]]:
        """All that the page was made of and with, as terms and texts."""
        made = (("Valve", self.valve), *self.facts, ("Version", f"valvesim {self.version}"), ("Date", str(self.date)))
        return [(term, text) for term, text in made if text]
