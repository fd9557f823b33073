"""The datasheet of a valve at any oil temperatures: static and dynamic figures, measured on the model as on a bench.

The figures are those of `bench` and `response`; nothing is computed here a second time.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

from valvesim.characterisation.acceptance.acceptance_tests import AcceptanceTests, acceptance_tests
from valvesim.characterisation.class_figures import beside_class
from valvesim.characterisation.figure_of_merit import Absent, FigureOfMerit, shown
from valvesim.characterisation.response_set import ResponseSet, measure_responses
from valvesim.simulation.scenario import Scenario, Thermal
from valvesim.valve.fluid import Oil
from valvesim.valve.parameters import Valve


@dataclass(frozen=True, kw_only=True)
class Datasheet:
    """Everything that the pages show: one bench and one set of responses for every oil temperature (°C)."""

    valve: Valve
    oil: Oil
    oil_temperatures: tuple[float, ...]
    benches: tuple[AcceptanceTests, ...]
    responses: tuple[ResponseSet, ...]


def measure(
    valve: Valve, oil: Oil, *, oil_temperatures: Sequence[float], progress: Callable[[float], None] | None = None
) -> Datasheet:  # fmt: skip
    """Run every test at every oil temperature, all parts at it. `progress` is told the share that is done.

    Raises as `acceptance_tests` and `response.measure_responses` do.
    """
    temperatures = tuple(float(t) for t in oil_temperatures)
    benches: list[AcceptanceTests] = []
    responses: list[ResponseSet] = []
    for k, temperature in enumerate(temperatures):

        def tell(share: float, part: float, start: float, k: int = k) -> None:
            if progress is not None:
                progress((k + start + part * share) / len(temperatures))

        benches.append(
            acceptance_tests(valve, oil_temperature=temperature, oil=oil, progress=partial(tell, part=0.25, start=0.0))
        )
        base = Scenario(valve=valve, oil=oil, thermal=Thermal(network=None))
        responses += measure_responses(
            base, oil_temperatures=(temperature,), chirp=False, progress=partial(tell, part=0.75, start=0.25)
        )
    return Datasheet(
        valve=valve, oil=oil, oil_temperatures=temperatures, benches=tuple(benches), responses=tuple(responses)
    )


def static_rows(sheet: Datasheet) -> list[tuple[str, ...]]:
    """Rows (figure, unit, value at each oil temperature); a dash where it cannot be had."""
    return _rows([{f.name: f for f in one.figures} for one in sheet.benches])


def dynamic_rows(sheet: Datasheet) -> list[tuple[str, ...]]:
    """Rows (figure and amplitude, unit, value at each oil temperature)."""
    columns = []
    for one in sheet.responses:
        found: dict[str, FigureOfMerit | Absent] = {}
        tests: tuple[Any, ...] = (*one.steps, *one.sweeps)
        for test in tests:
            found.update({f"{f.name} at {100 * test.share:.0f} % of rated": f for f in test.figures})
        columns.append(found)
    return _rows(columns)


def class_rows(sheet: Datasheet) -> list[tuple[str, str, str, str]]:
    """Rows (figure, published for the class, this valve, source) at the first oil temperature."""
    base = Scenario(valve=sheet.valve, oil=sheet.oil, thermal=Thermal(network=None))
    rows = []
    for published, own in beside_class(base, sheet.responses[0]):
        limits = [FigureOfMerit(published.name, value, published.unit, "") for value in (published.low, published.high)]
        low, high = (shown(limit)[0] for limit in limits)
        text = f"{low} {shown(limits[0])[2]}" if low == high else f"{low} to {high} {shown(limits[0])[2]}"
        mine = own.reason if isinstance(own, Absent) else " ".join((shown(own)[0], shown(own)[2]))
        rows.append((published.name.replace("_", " "), text, mine, published.source))
    return rows


def absent_rows(sheet: Datasheet) -> list[tuple[str, str, str]]:
    """Rows (oil temperature, figure, reason) of what could not be had."""
    rows = []
    for temperature, one, response in zip(sheet.oil_temperatures, sheet.benches, sheet.responses, strict=True):
        tests: tuple[Any, ...] = (*response.steps, *response.sweeps)
        figures = [*one.figures, *(f for test in tests for f in test.figures)]
        rows += [
            (f"{temperature:g} °C", f.name.replace("_", " "), f.reason) for f in figures if isinstance(f, Absent)
        ]  # fmt: skip
    return rows


def _rows(columns: Sequence[dict[str, FigureOfMerit | Absent]]) -> list[tuple[str, ...]]:
    rows = []
    for name in dict.fromkeys(name for column in columns for name in column):
        found = [column.get(name) for column in columns]
        unit = next((shown(f)[2] for f in found if isinstance(f, FigureOfMerit)), "")
        cells = [shown(f)[0] if isinstance(f, FigureOfMerit) else "-" for f in found]
        rows.append((name.replace("_", " "), unit, *cells))
    return rows
