"""Verdicts of a command: its figures against an acceptance specification, and the exit code where one fails."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from valvesim.characterisation.judgement_table import Tests
    from valvesim.characterisation.specification import Judgement, Specification
    from valvesim.valve.parameters import Valve

FAILED = 3  # exit code: the input is right, everything ran, and a figure is out of its limits


def read_specification(path: Path | None) -> Specification | None:
    """The specification of `--spec`; None without. Raises InputError for one that makes no sense."""
    from valvesim.characterisation.specification import load_specification

    return None if path is None else load_specification(path)


def oil_temperatures(given: str | None, specification: Specification | None) -> list[float]:
    """The temperatures (°C) of `--oil-temperature`, else that of the specification's conditions, else 20 °C."""
    from valvesim.units import parse_list

    if given is not None:
        return list(parse_list(given, "degC", "--oil-temperature").tolist())
    conditions = {} if specification is None else specification.conditions
    return [conditions.get("oil_temperature", 20.0)]


def temperature_difference(specification: Specification | None) -> float:
    """The temperature difference (K) of the null shift that a specification limits, else that of the standard."""
    from valvesim.characterisation.acceptance.null_shift import TEMPERATURE_DIFFERENCE

    limits = () if specification is None else specification.of("null_shift_temperature")
    return next((one.conditions["temperature_difference"] for one in limits), TEMPERATURE_DIFFERENCE)


def judged_by(
    specification: Specification | None, tests: Tests, *, valve: Valve | None = None
) -> tuple[Judgement, ...]:  # fmt: skip
    """Every limit with the figures of the tests that show it, and of a simulated `valve` with its own data."""
    from valvesim.characterisation.figure_of_merit import FigureOfMerit
    from valvesim.characterisation.specification import judge

    if specification is None:
        return ()
    measured = [(figure, at) for _, at, figures in tests for figure in figures]
    if valve is not None:
        for name, unit in (("rated_current", "A"), ("coil_resistance", "ohm"), ("coil_inductance", "H")):
            own = FigureOfMerit(f"valve.{name}", float(getattr(valve, name)), unit, "the valve's own figure")
            measured.append((own, {}))
    return judge(specification, measured)


def end_on_failure(judged: Sequence[Judgement]) -> None:
    """End the command with `FAILED` where a figure fails."""
    from valvesim.characterisation.judgement_table import failed

    if failed(judged):
        raise SystemExit(FAILED)
