"""All static acceptance tests on the model, and the same reduction of a measured record."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from valvesim.characterisation.acceptance.cycle import cycle
from valvesim.characterisation.acceptance.flow import flow_figures
from valvesim.characterisation.acceptance.flow_load import RATED_DROP, flow_load_figures, flow_load_record
from valvesim.characterisation.acceptance.leakage import leakage_figures
from valvesim.characterisation.acceptance.null_shift import (
    PRESSURE_CHANGE,
    TEMPERATURE_DIFFERENCE,
    NullShiftCurve,
    null_shift_curves,
    null_shift_figures,
)
from valvesim.characterisation.acceptance.pressure_gain import blocked_cycle, pressure_gain_figures
from valvesim.characterisation.acceptance.record import AcceptanceRecord, part_of, read_record, record_of
from valvesim.characterisation.acceptance.rig import Rig
from valvesim.characterisation.acceptance.threshold import threshold_figure
from valvesim.characterisation.dither import NO_DITHER, Dither
from valvesim.characterisation.figure_of_merit import Absent, FiguresOfMerit
from valvesim.characterisation.options import DEFAULT_CHARACTERISATION, AcceptanceOptions
from valvesim.errors import check_kind, unknown_name
from valvesim.measurement.columns_table import NOTHING_STATED, Statements
from valvesim.shown import Shown, notebook
from valvesim.simulation.fmu_valve import FmuValve
from valvesim.units import reads_units
from valvesim.valve.effect import ActiveEffect
from valvesim.valve.fluid import MIL_PRF_5606, Oil
from valvesim.valve.parameters import Valve

CYCLE_TESTS = ("flow", "pressure-gain", "leakage", "flow-load")


def record_figures(
    record: AcceptanceRecord, test: str, *, resolution: float | None = None, lag: float | None = None,
    dead_zone: float | None = None, rated_current: float | None = None,
) -> FiguresOfMerit:  # fmt: skip
    """The figures of a measured record by test: "flow", "pressure-gain", "leakage" or "flow-load".

    `resolution` of the output, `lag` (s) and `dead_zone` (m^3/s) of the meter are as stated; what is not is estimated
    from the record or said to be missing. `rated_current` (A) is the record's amplitude by default.
    Raises InputError for an unknown test, missing columns, no complete cycle, too few points, or a clipped current.
    """
    if test == "flow":
        c = cycle(record, "load_flow", resolution=resolution)
        return (
            *flow_figures(c, rated_current=rated_current, lag=lag, dead_zone=dead_zone),
            Absent("threshold", "needs a stop and a reversal of the current, which this record does not hold"),
        )
    if test == "pressure-gain":
        c = cycle(record, "load_pressure", resolution=resolution)
        return pressure_gain_figures(c, rated_current=rated_current, lag=lag)
    if test == "leakage":
        return leakage_figures(cycle(record, "internal_leakage", resolution=resolution), lag=lag)
    if test == "flow-load":
        return flow_load_figures(record, resolution=resolution)
    raise unknown_name("test", test, CYCLE_TESTS)


@dataclass(frozen=True, kw_only=True)
class MeasuredTest:
    """One measured test: its record, which of `CYCLE_TESTS` it is, and the figures of merit reduced from it."""

    record: AcceptanceRecord
    test: str
    figures: FiguresOfMerit


@reads_units(lag="s", dead_zone="m^3/s", rated_current="A")
def measured_test(
    file: Path, test: str, *, resolution: float | None = None, lag: float | None = None,
    dead_zone: float | None = None, rated_current: float | None = None, stated: Statements = NOTHING_STATED,
    options: AcceptanceOptions = DEFAULT_CHARACTERISATION.acceptance,
) -> MeasuredTest:  # fmt: skip
    """Read a measured file and reduce it. Raises as `read_record` and `record_figures` do."""
    record = read_record(file, stated=stated, options=options)
    figures = record_figures(
        record, test, resolution=resolution, lag=lag, dead_zone=dead_zone, rated_current=rated_current
    )  # fmt: skip
    return MeasuredTest(record=record, test=test, figures=figures)


@dataclass(frozen=True, kw_only=True, repr=False)
class AcceptanceTests(Shown):
    """A simulated bench: `figures` named `test.figure`, and the records they come from.

    `flow` (no load) and `blocked` hold one full cycle each, `flow_load` one record per held current with `current`,
    load_pressure, load_flow and pressure_drop. `blocked` is None where the valve is an FMU, whose equations do not tell
    the load pressure at which no flow leaves it.
    """

    valve: Valve
    oil_temperature: float
    figures: FiguresOfMerit
    flow: AcceptanceRecord
    blocked: AcceptanceRecord | None
    flow_load: tuple[AcceptanceRecord, ...]
    null_shift: tuple[NullShiftCurve, ...] = ()
    temperature_difference: float = TEMPERATURE_DIFFERENCE
    dither: Dither = NO_DITHER

    @property
    def conditions(self) -> dict[str, float]:
        """What the tests were done at, by the names of a specification's conditions, SI."""
        valve = self.valve
        return {"supply_pressure": float(valve.supply_pressure), "return_pressure": float(valve.return_pressure),
                "oil_temperature": self.oil_temperature, "pressure_drop": RATED_DROP,
                "temperature_difference": self.temperature_difference, "pressure_change": PRESSURE_CHANGE,
                **self.dither.conditions}  # fmt: skip

    def in_words(self) -> str:
        """How many figures of which valve, and the oil's temperature."""
        return f"{len(self.figures)} figures of merit, oil at {self.oil_temperature:g} °C, {self.valve.in_words()}"

    def plot(self) -> Any:
        """A matplotlib figure of all tests."""
        return notebook().plot(self)


@reads_units(oil_temperature="degC", period="s", temperature_difference="delta_degC")
def acceptance_tests(
    valve: Valve | None = None,
    *,
    oil_temperature: float = 20.0,
    oil: Oil = MIL_PRF_5606,
    effects: Sequence[ActiveEffect] = (),
    period: float = 1e4,
    points: int = 8000,
    temperature_difference: float = TEMPERATURE_DIFFERENCE,
    dither: Dither = NO_DITHER,
    progress: Callable[[float], None] | None = None,
    options: AcceptanceOptions = DEFAULT_CHARACTERISATION.acceptance,
) -> AcceptanceTests:
    """Run every static test on the model, all parts at `oil_temperature` (°C), and reduce it as a measured one.

    Of the reference valve unless another is given. `temperature_difference` (K) is that of the null shift.

    The current runs a triangle of `period` s over +-i_R, `points` samples each; the valve trails it by about 1/800 s.
    With a `dither` the flow curve, the threshold and the blocked ports run in `dithered_period` s; flow over load and
    the shift of null are told without. Blocked ports are quasi-static: see `blocked_load_pressure`. `progress` is told
    the share that is done.
    Raises as `simulate` does, and SolveError where the blocked ports find no load pressure.
    """
    valve = Valve() if valve is None else valve
    check_kind(valve, Valve, "valve", "a Valve (load_valve reads a file)")
    rig = Rig(
        valve=valve, oil=oil, oil_temperature=oil_temperature, effects=tuple(effects), period=period, points=points
    )
    dithered = replace(rig, dither=dither, period=options.dithered_period) if dither.amplitude else rig
    tell = progress if progress is not None else lambda share: None
    flow = record_of("flow", dithered.full_cycle(), "load_flow")
    figures = _flow_figures(dithered, flow)
    tell(0.3)
    blocked = None if isinstance(valve, FmuValve) else blocked_cycle(dithered)
    if blocked is None:
        why = "blocked ports need the valve's equations, which an FMU does not tell"
        figures += tuple(Absent(name, why) for name in BLOCKED_TESTS)
    else:
        figures += _blocked_figures(dithered, blocked, BLOCKED_TESTS)
    tell(0.6)
    shares = (-1.0, -0.75, -0.5, -0.25, 0.25, 0.5, 0.75, 1.0)
    flow_load = tuple(flow_load_record(rig, share * float(valve.rated_current)) for share in shares)
    figures += _flow_load_figures(rig, flow_load[-1], flow_load[0])
    tell(0.8)
    figures += _named("null-shift", null_shift_figures(rig, temperature_difference=temperature_difference))
    tell(1.0)
    return AcceptanceTests(
        valve=valve, oil_temperature=oil_temperature, figures=figures, flow=flow, blocked=blocked, flow_load=flow_load,
        null_shift=() if isinstance(valve, FmuValve) else null_shift_curves(rig),
        temperature_difference=temperature_difference, dither=dither,
    )  # fmt: skip


RIG_TESTS = ("flow", *(BLOCKED_TESTS := ("pressure-gain", "leakage")), "flow-load", "null-shift")
"""The tests of a simulated bench, in the order of its figures."""


def rig_figures(rig: Rig, tests: Sequence[str]) -> FiguresOfMerit:
    """The figures of some of `RIG_TESTS`, as `acceptance_tests` has them: no other test is run.

    Blocked ports (pressure-gain, leakage) take nine tenths of the time of all. Raises as `acceptance_tests` does.
    """
    for name in tests:
        if name not in RIG_TESTS:
            raise unknown_name("test", name, RIG_TESTS)
    figures: FiguresOfMerit = ()
    if "flow" in tests:
        figures += _flow_figures(rig, record_of("flow", rig.full_cycle(), "load_flow"))
    if blocked := [name for name in BLOCKED_TESTS if name in tests]:
        figures += _blocked_figures(rig, blocked_cycle(rig), blocked)
    if "flow-load" in tests:
        rated = float(rig.valve.rated_current)
        figures += _flow_load_figures(rig, flow_load_record(rig, rated), flow_load_record(rig, -rated))
    if "null-shift" in tests:
        figures += _named("null-shift", null_shift_figures(rig))
    return figures


def _flow_figures(rig: Rig, record: AcceptanceRecord) -> FiguresOfMerit:
    c, rated = cycle(record, "load_flow"), float(rig.valve.rated_current)
    own = flow_figures(c, rated_current=rated, lag=0.0, dead_zone=0.0)
    return _named("flow", (*own, threshold_figure(rig)))


def _blocked_figures(rig: Rig, record: AcceptanceRecord, tests: Sequence[str]) -> FiguresOfMerit:
    figures: FiguresOfMerit = ()
    if "pressure-gain" in tests:
        c, rated = cycle(record, "load_pressure"), float(rig.valve.rated_current)
        figures += _named("pressure-gain", pressure_gain_figures(c, rated_current=rated, lag=0.0))
    if "leakage" in tests:
        figures += _named("leakage", leakage_figures(cycle(record, "internal_leakage"), lag=0.0))
    return figures


def _flow_load_figures(rig: Rig, positive: AcceptanceRecord, negative: AcceptanceRecord) -> FiguresOfMerit:
    figures: FiguresOfMerit = ()
    for record, name in ((positive, "positive"), (negative, "negative")):
        own = flow_load_figures(part_of(record, record.values["pressure_drop"] <= rig.valve.supply_pressure))
        figures += _named("flow-load", tuple(replace(f, name=f"{f.name}_{name}") for f in own))
    return figures


def _named(test: str, figures: FiguresOfMerit) -> FiguresOfMerit:
    return tuple(replace(f, name=f"{test}.{f.name}") for f in figures)
