"""The datasheet of a valve at any oil temperatures: static and dynamic figures, measured on the model as on a bench.

The figures are those of `bench` and `response`; nothing is computed here a second time.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from valvesim.characterisation.acceptance.acceptance_tests import AcceptanceTests, acceptance_tests
from valvesim.characterisation.class_figures import ClassFigure
from valvesim.characterisation.figure_of_merit import Absent, FigureOfMerit, FiguresOfMerit
from valvesim.characterisation.lumped_figures import beside_class
from valvesim.characterisation.response_set import ResponseSet, measure_responses, response_tests
from valvesim.characterisation.specification import Specification
from valvesim.shown import Shown
from valvesim.simulation.scenario import Scenario, Thermal
from valvesim.units import reads_units
from valvesim.valve.effect import ActiveEffect
from valvesim.valve.fluid import MIL_PRF_5606, Oil
from valvesim.valve.parameters import Valve


@dataclass(frozen=True, kw_only=True, repr=False)
class Datasheet(Shown):
    """Everything that the pages show: one bench and one set of responses for every oil temperature (°C).

    `beside_class`: published figures of merit of the class, each with the valve's own at the first temperature.
    """

    valve: Valve
    oil: Oil
    oil_temperatures: tuple[float, ...]
    benches: tuple[AcceptanceTests, ...]
    responses: tuple[ResponseSet, ...]
    beside_class: tuple[tuple[ClassFigure, FigureOfMerit | Absent], ...]

    def in_words(self) -> str:
        """The valve and the oil temperatures."""
        at = ", ".join(f"{temperature:g}" for temperature in self.oil_temperatures)
        return f"{self.valve.in_words()}, oil {self.oil.name} at {at} °C"


@reads_units(oil_temperatures="degC")
def measure(
    valve: Valve | None = None, oil: Oil = MIL_PRF_5606, *, oil_temperatures: Sequence[float] = (20.0,),
    effects: Sequence[ActiveEffect] = (), progress: Callable[[float], None] | None = None,
) -> Datasheet:  # fmt: skip
    """Run every test at every oil temperature, all parts at it, with `effects` in service.

    Of the reference valve unless another is given.

    `progress` is told the share that is done. Raises as `acceptance_tests` and `response.measure_responses` do.
    """
    valve = Valve() if valve is None else valve
    temperatures = tuple(float(t) for t in np.atleast_1d(oil_temperatures))
    base = Scenario(valve=valve, oil=oil, thermal=Thermal(network=None), effects=tuple(effects))
    benches: list[AcceptanceTests] = []
    responses: list[ResponseSet] = []
    for k, temperature in enumerate(temperatures):

        def tell(share: float, part: float, start: float, k: int = k) -> None:
            if progress is not None:
                progress((k + start + part * share) / len(temperatures))

        benches.append(
            acceptance_tests(
                valve, oil_temperature=temperature, oil=oil, effects=effects,
                progress=partial(tell, part=0.25, start=0.0),
            )  # fmt: skip
        )
        responses += measure_responses(
            base, oil_temperatures=(temperature,), chirp=False, progress=partial(tell, part=0.75, start=0.25)
        )
    return Datasheet(
        valve=valve, oil=oil, oil_temperatures=temperatures, benches=tuple(benches), responses=tuple(responses),
        beside_class=beside_class(base, responses[0]),
    )  # fmt: skip


def datasheet_tests(
    sheet: Datasheet, specification: Specification | None = None
) -> list[tuple[str, dict[str, float], FiguresOfMerit]]:  # fmt: skip
    """Every test of a datasheet as (title, conditions by the names of a specification's, figures), SI, of responses
    also at the single frequencies that a specification has limits at.
    """
    benches = [(f"bench, oil at {one.oil_temperature:g} °C", one.conditions, one.figures) for one in sheet.benches]
    source = Scenario(valve=sheet.valve, thermal=Thermal(network=None))
    return benches + response_tests(sheet.responses, source, specification)
