"""The simulated test rig: a valve at held temperature and pressures under a slow current."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from valvesim.characterisation.acceptance.cycle import cycle, loop
from valvesim.characterisation.acceptance.record import record_of
from valvesim.characterisation.dither import NO_DITHER, SAMPLES, Dither
from valvesim.errors import unknown_name
from valvesim.inputs import Command, Constant, Table
from valvesim.simulation.run import simulate
from valvesim.simulation.scenario import Scenario, Thermal
from valvesim.valve.coefficients import Coefficients, PartTemperatures
from valvesim.valve.effect import ActiveEffect
from valvesim.valve.fluid import Oil
from valvesim.valve.parameters import Valve


@dataclass(frozen=True, kw_only=True)
class Rig:
    """A valve on the bench: everything that a test does not change. With `dither` channels are means over it."""

    valve: Valve
    oil: Oil
    oil_temperature: float
    effects: tuple[ActiveEffect, ...]
    period: float
    points: int
    dither: Dither = NO_DITHER

    def run(self, command: Command, duration: float, *, load_pressure: Command | None = None) -> dict[str, np.ndarray]:
        """All channels and "time" of an isothermal run."""
        dither = self.dither
        result = simulate(
            Scenario(
                title="bench",
                duration=duration,
                valve=self.valve,
                oil=self.oil,
                thermal=Thermal(network=None),
                oil_temperature=Constant(value=self.oil_temperature),
                command=dither.upon(command, float(self.valve.rated_current)),
                load_pressure=load_pressure,
                effects=self.effects,
                output_rate=SAMPLES * dither.frequency if dither.amplitude else 1.25 * self.points / duration,
                tolerance=1e-6,
            )
        )
        if "load_flow" not in result.values:  # of an FMU alone
            raise unknown_name("channel", "load_flow", result.names, "the FMU's outputs")
        return dither.means({"time": result.time, **result.values})

    def full_cycle(self, *, null: float | None = None) -> dict[str, np.ndarray]:
        """A triangle from i_R to -i_R and back; with `null` (A) half of the time is spent within 5 % of i_R of it."""
        top, quarter = float(self.valve.rated_current), self.period / 4.0
        times, currents = [0.0, quarter, 3 * quarter, 5 * quarter], [0.0, top, -top, top]
        if null is not None:
            slow = np.clip([null + 0.05 * top, null - 0.05 * top], -0.9 * top, 0.9 * top)
            times[2:] = [1.5 * quarter, 2.5 * quarter, 3 * quarter, 3.5 * quarter, 4.5 * quarter, 5 * quarter]
            currents[2:] = [*slow, -top, *slow[::-1], top]
        values = self.run(Table(times=tuple(times), values=tuple(currents)), 5 * quarter)
        whole = values["time"] >= quarter * (1 - 1e-9)
        return {name: v[whole] for name, v in values.items()}

    def coefficients(self) -> Coefficients:
        """The coefficients at the oil's temperature, changed by the effects."""
        parts = PartTemperatures.uniform(self.oil_temperature)
        c = self.valve.at(parts, oil=self.oil)
        for active in self.effects:
            if active.effect.coefficients is not None:
                c = active.effect.coefficients(c, active.values, parts)
        return c

    def null(self) -> float:
        """Mid-line current at zero flow, A."""
        values = self.full_cycle()
        bend = loop(cycle(record_of("null", values, "load_flow"), "load_flow"))
        return float(np.interp(0.0, bend.output, bend.middle))
