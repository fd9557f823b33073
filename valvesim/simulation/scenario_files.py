"""The scenarios that come along, by name: in the top folder `scenarios`, and inside the package once installed."""

from __future__ import annotations

import os
from pathlib import Path

from valvesim.errors import InputError, nearest

_PACKAGE = Path(__file__).parents[1]


def bundled_scenarios() -> dict[str, Path]:
    """Name and file of each scenario that comes along, by name; studies stand in the same folder as NAME_study."""
    inside, beside = _PACKAGE / "scenarios", _PACKAGE.parent / "scenarios"
    folder = inside if inside.is_dir() else beside
    return {path.stem: path for path in sorted(folder.glob("*.toml")) if not path.stem.endswith("_study")}


def scenario_file(given: str | Path) -> Path:
    """The file that is meant: one that exists, else the scenario of that name that comes along.

    Raises InputError where there is neither, with the nearest name.
    """
    path, known = Path(given), bundled_scenarios()
    if os.path.exists(path) or path.name != str(given) or path.suffix not in ("", ".toml"):
        return path
    if path.stem in known:
        return known[path.stem]
    raise InputError(f"no such file, nor a scenario that comes along{nearest(path.stem, known)}", file=path)
