"""An acceptance specification: the figures that a valve must have, with limits and conditions, and the verdict.

    title = "Servo valve 38 L/min"
    [conditions]
    supply_pressure = "210 bar"
    oil_temperature = "40 degC"
    [figures]
    rated_flow = { value = "38 L/min", tolerance = "10 %", pressure_drop = "70 bar", source = "catalogue, p. 7" }
    hysteresis = { high = "3 %" }
    frequency_minus_90_deg = [{ low = "110 Hz", amplitude = "40 %" }, { low = "80 Hz", amplitude = "100 %" }]

A figure has a `value` with or without a `tolerance`, or limits `low` and `high`; the same figure at several conditions
is a list. Conditions of a figure take the place of the specification's.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from pathlib import Path
from typing import Any

from valvesim.characterisation.dither import DITHER_CONDITIONS
from valvesim.characterisation.figure_of_merit import Absent, FigureOfMerit
from valvesim.errors import InputError, unknown_name
from valvesim.io import check_known, check_printable, check_tables, located, read_toml
from valvesim.units import parse
from valvesim.valve.fluid import MIL_PRF_5606, Oil
from valvesim.valve.valve_toml import read_oil_table

COVERAGE = 2.0  # standard deviations, either side of a value, within which it is taken to lie (ISO 14253-1: 95 %)


@dataclass(frozen=True)
class Condition:
    """A condition of a test: its unit, meaning and bounds."""

    unit: str
    doc: str
    bounds: tuple[float, float]


CONDITIONS = {
    "supply_pressure": Condition("Pa", "at the valve, absolute", (1e5, 1e8)),
    "return_pressure": Condition("Pa", "behind the nozzles, absolute", (0.0, 1e8)),
    "oil_temperature": Condition("degC", "of oil and parts", (-60.0, 300.0)),
    "pressure_drop": Condition("Pa", "across the valve, both lands together", (1e4, 1e8)),
    "amplitude": Condition("1", "share of rated current, peak", (1e-3, 1.5)),
    "frequency": Condition("Hz", "of the sine", (1e-2, 5e3)),
    "dither_amplitude": Condition("1", "share of rated current, peak, of a sine upon the command", (0.0, 0.5)),
    "dither_frequency": Condition("Hz", "of the dither", (1.0, 1e4)),
    "temperature_difference": Condition("delta_degC", "over which null shifts", (1.0, 300.0)),
    "pressure_change": Condition("1", "share of supply pressure over which null shifts, either way", (0.01, 1.0)),
}
"""What a test may be done at."""
COMMON = ("supply_pressure", "return_pressure", "oil_temperature")
HELD = (*COMMON, *DITHER_CONDITIONS)
"""Conditions that may also be of a whole specification, or of all records of a valve."""


@dataclass(frozen=True)
class SpecifiedFigure:
    """A figure that a specification may hold: its unit, meaning, conditions of its own with their defaults, and the
    figures of bench and response that show it. `spread` is the tolerance (share of the value) where none is given.
    """

    unit: str
    doc: str
    shown_by: tuple[str, ...]
    conditions: Mapping[str, float] = field(default_factory=dict)
    spread: float = 0.1


FIGURES = {
    "rated_current": SpecifiedFigure("A", "rated current", ("valve.rated_current",), spread=0.0),
    "coil_resistance": SpecifiedFigure(
        "ohm", "coils as connected, at 20 °C", ("coil.coil_resistance", "valve.coil_resistance"), spread=0.1
    ),
    "coil_inductance": SpecifiedFigure("H", "coils as connected", ("valve.coil_inductance",), spread=0.3),
    "rated_flow": SpecifiedFigure(
        "m^3/s", "flow at rated current and pressure drop",
        ("flow-load.rated_flow_positive", "flow-load.rated_flow_negative", "rated_flow"), {"pressure_drop": 7e6},
    ),
    "flow_at_rated": SpecifiedFigure(
        "m^3/s", "flow at rated current without load, by the normal lines", ("flow.flow_at_rated",)
    ),
    "flow_gain": SpecifiedFigure(
        "m^3/s/A", "slope of flow over current without load", ("flow.flow_gain_positive", "flow.flow_gain_negative")
    ),
    "linearity": SpecifiedFigure("1", "share of rated flow", ("flow.linearity",), spread=0.5),
    "symmetry": SpecifiedFigure("1", "of the polarities' gains", ("flow.symmetry",), spread=0.5),
    "hysteresis": SpecifiedFigure(
        "1", "share of rated current", ("flow.hysteresis", "pressure-gain.hysteresis"), spread=0.3
    ),
    "threshold": SpecifiedFigure("1", "share of rated current", ("flow.threshold",), spread=0.5),
    "null_bias": SpecifiedFigure(
        "1", "share of rated current", ("flow.null_bias", "pressure-gain.null_bias"), spread=0.3
    ),
    "lap": SpecifiedFigure("1", "of the lands, share of rated current, + overlap", ("flow.lap",), spread=0.5),
    "pressure_gain": SpecifiedFigure(
        "Pa/A", "slope of the blocked load pressure over current", ("pressure-gain.pressure_gain",), spread=0.2
    ),
    "pressure_gain_share": SpecifiedFigure(
        "-", "share of supply pressure per share of rated current", ("pressure-gain.pressure_gain_share",), spread=0.2
    ),
    "null_leakage": SpecifiedFigure(
        "m^3/s", "greatest internal leakage, blocked ports", ("leakage.null_leakage",), spread=0.2
    ),
    "tare_leakage": SpecifiedFigure("m^3/s", "least internal leakage: pilot flow", ("leakage.tare",), spread=0.2),
    "null_shift_temperature": SpecifiedFigure(
        "1", "share of rated current", ("null-shift.temperature",), {"temperature_difference": 38.0}, spread=0.5
    ),
    "null_shift_supply": SpecifiedFigure(
        "1", "share of rated current", ("null-shift.supply",), {"pressure_change": 0.2}, spread=0.5
    ),
    "null_shift_return": SpecifiedFigure(
        "1", "share of rated current", ("null-shift.return",), {"pressure_change": 0.2}, spread=0.5
    ),
    "frequency_minus_3_db": SpecifiedFigure(
        "Hz", "where the amplitude ratio is -3 dB", ("frequency_minus_3_db",), {"amplitude": 0.4}
    ),
    "frequency_minus_90_deg": SpecifiedFigure(
        "Hz", "where the phase lag is 90 degrees", ("frequency_minus_90_deg",), {"amplitude": 0.4}
    ),
    "amplitude_ratio": SpecifiedFigure(
        "dB", "at a frequency, from that at low frequency", ("amplitude_ratio",), {"amplitude": 0.4, "frequency": 0.0}
    ),
    "phase_lag": SpecifiedFigure(
        "deg", "at a frequency", ("phase_lag",), {"amplitude": 0.4, "frequency": 0.0}
    ),
    "time_to_90_percent": SpecifiedFigure(
        "s", "from the step of the current to 90 % of the change", ("time_to_90_percent",), {"amplitude": 1.0}
    ),
    "rise_time": SpecifiedFigure("s", "from 10 to 90 % of the change", ("rise_time",), {"amplitude": 1.0}),
    "overshoot": SpecifiedFigure("%", "of a step, in percent of the change", ("overshoot",), {"amplitude": 0.25}),
}  # fmt: skip
"""The figures that a specification may hold, by name."""


# ---------------------------------------------------------------- limits and verdicts


class Verdict(StrEnum):
    """Whether a figure keeps its limits, told with its uncertainty."""

    PASS = "pass"
    FAIL = "fail"
    UNDECIDED = "undecided"
    NOT_MEASURED = "not measured"


def verdict(value: float, uncertainty: float, low: float, high: float) -> Verdict:
    """Pass where the value is within [low, high] by `COVERAGE` standard deviations, fail where it is so far outside.

    In between it is undecided (decision rule of ISO 14253-1). Without uncertainty a value on a limit passes.
    """
    reach = COVERAGE * uncertainty
    if not math.isfinite(value):
        return Verdict.NOT_MEASURED
    if low + reach <= value <= high - reach:
        return Verdict.PASS
    return Verdict.FAIL if value + reach < low or value - reach > high else Verdict.UNDECIDED


@dataclass(frozen=True, kw_only=True)
class Limit:
    """A figure of a specification in SI: nominal `value` (nan without), `low` and `high` (infinite without).

    `conditions` are by name of `CONDITIONS`, in SI. `key` is where it stands in its file.
    """

    figure: str
    value: float = math.nan
    low: float = -math.inf
    high: float = math.inf
    conditions: Mapping[str, float] = field(default_factory=dict)
    source: str = ""
    key: str = ""

    @property
    def unit(self) -> str:
        """SI unit of value and limits."""
        return FIGURES[self.figure].unit

    @property
    def nominal(self) -> float:
        """The value, else the middle of two limits; nan with one limit alone."""
        if not math.isnan(self.value):
            return self.value
        return (self.low + self.high) / 2.0 if math.isfinite(self.low + self.high) else math.nan

    @property
    def deviation(self) -> float:
        """One standard deviation of the figure among valves: half of how far the limits are from the value."""
        spread = FIGURES[self.figure].spread * abs(self.nominal)
        reaches = [abs(end - self.nominal) for end in (self.low, self.high) if math.isfinite(end)]
        return (min(reaches) if reaches else spread) / COVERAGE

    def verdict(self, value: float, uncertainty: float = 0.0) -> Verdict:
        """As `verdict` has it; a figure without a sign of its own is judged by its size."""
        size = abs(value) if self.figure in UNSIGNED and self.low >= 0.0 or self._both_ways else value
        return verdict(size, uncertainty, self.low, self.high)

    @property
    def _both_ways(self) -> bool:
        """A shift or bias that is limited above alone may be as large the other way."""
        return self.figure in UNSIGNED and math.isinf(self.low)


UNSIGNED = ("null_bias", "lap", "null_shift_temperature", "null_shift_supply", "null_shift_return", "rated_flow",
            "flow_gain", "pressure_gain", "pressure_gain_share")  # fmt: skip
"""Figures that catalogues give without a sign."""


@dataclass(frozen=True, kw_only=True)
class Specification:
    """What a valve must have: limits, and the conditions that hold where a limit has none of its own."""

    title: str = ""
    limits: tuple[Limit, ...] = ()
    conditions: Mapping[str, float] = field(default_factory=dict)
    oil: Oil = MIL_PRF_5606

    def of(self, figure: str) -> tuple[Limit, ...]:
        """The limits of one figure."""
        return tuple(limit for limit in self.limits if limit.figure == figure)

    @property
    def single_frequencies(self) -> tuple[float, ...]:
        """The frequencies, Hz, at which it limits amplitude ratio or phase lag."""
        limits = (*self.of("amplitude_ratio"), *self.of("phase_lag"))
        return tuple(sorted({limit.conditions["frequency"] for limit in limits}))


@dataclass(frozen=True, kw_only=True)
class Judgement:
    """A limit beside what was measured: the figure or why there is none, its conditions, and the verdict."""

    limit: Limit
    measured: FigureOfMerit | Absent
    verdict: Verdict


MeasuredFigures = Sequence[tuple[FigureOfMerit | Absent, Mapping[str, float]]]
"""Figures, named as bench and response do, each with the conditions of its test."""


def judge(specification: Specification, measured: MeasuredFigures) -> tuple[Judgement, ...]:
    """Each limit with every measured figure that shows it at its conditions, or one that says that none does.

    Conditions agree within 10 % (temperatures 5 K); what one side does not state is taken to agree.
    """
    judged = []
    for limit in specification.limits:
        if math.isinf(limit.low) and math.isinf(limit.high):
            continue  # a value alone limits nothing
        names = FIGURES[limit.figure].shown_by
        named = [(figure, at) for figure, at in measured if figure.name in names]
        shown = [figure for figure, at in named if _agree(limit.conditions, at)]
        values = [figure for figure in shown if isinstance(figure, FigureOfMerit)]
        if not values:
            why = "no test at its conditions" if named and not shown else "no test gives it"
            reason = next((figure.reason for figure in shown if isinstance(figure, Absent)), why)
            judged.append(Judgement(limit=limit, measured=Absent(limit.figure, reason), verdict=Verdict.NOT_MEASURED))
        for figure in values:
            told = limit.verdict(figure.value, figure.uncertainty or 0.0)
            judged.append(Judgement(limit=limit, measured=figure, verdict=told))
    return tuple(judged)


def _agree(wanted: Mapping[str, float], given: Mapping[str, float]) -> bool:
    for name, value in wanted.items():
        if name in given and abs(given[name] - value) > (5.0 if name == "oil_temperature" else 0.1 * abs(value)):
            return False
    return True


# ---------------------------------------------------------------- reading

_LIMIT_KEYS = ("value", "tolerance", "low", "high", "source")


def load_specification(path: str | Path) -> Specification:
    """Read a specification. Raises InputError (file, line, key) for anything that makes no sense, limits the wrong way
    round, and a figure that no nozzle-flapper servo valve has.
    """
    path = Path(path)
    text, table = read_toml(path, "a specification is a TOML file with [figures]")
    with located(path, text, document="specification"):
        return _read(table, path.parent)


def _read(table: dict[str, Any], folder: Path) -> Specification:
    check_known(table, ("title", "conditions", "oil", "figures"), "specification")
    check_tables(table, ("conditions", "oil", "figures"))
    title = table.get("title", "")
    check_printable(title, "title")
    given = table.get("conditions", {})
    check_known(given, HELD, "conditions")
    conditions = {name: read_condition(name, text, f"conditions.{name}") for name, text in given.items()}
    figures = table.get("figures", {})
    if not figures:
        raise InputError("is missing or empty, such as rated_flow = { value = '38 L/min' }", key="figures", joint=" ")
    limits: list[Limit] = []
    for name, entries in figures.items():
        if name not in FIGURES:
            raise unknown_name("figure of a nozzle-flapper servo valve", name, FIGURES, "figures")
        several = entries if isinstance(entries, list) else [entries]
        for k, entry in enumerate(several, start=1):
            where = f"figures.{name}" + (f".{k}" if len(several) > 1 else "")
            limits.append(_read_limit(name, entry, where, conditions))
    if len({limit.value for limit in limits if limit.figure == "rated_current"}) > 1:
        problem = "is given more than once: coils in series and in parallel are two valves, each with its resistance"
        raise InputError(problem, key="figures.rated_current", joint=" ")
    oil = read_oil_table(table.get("oil", {}), folder)
    return Specification(title=title, limits=tuple(limits), conditions=conditions, oil=oil)


def read_condition(name: str, text: Any, where: str) -> float:
    """A condition in SI from text with its unit, within its bounds."""
    condition = CONDITIONS[name]
    if name == "pressure_drop" and isinstance(text, str) and "land" in text:
        raise InputError(f"{text!r} is of one land: write twice that, of both lands together", key=where)
    value, (low, high) = parse(text, condition.unit, where), condition.bounds
    if not low <= value <= high:
        problem = f"{text!r} is outside [{low:g}, {high:g}] {condition.unit} ({condition.doc})"
        raise InputError(problem, key=where)
    return value


def _read_limit(name: str, entry: Any, where: str, common: Mapping[str, float]) -> Limit:
    figure = FIGURES[name]
    table = {"value": entry} if isinstance(entry, (str, int, float)) else entry
    if not isinstance(table, dict):
        raise InputError(f"expected a table such as {{ value = '1 {figure.unit}' }}, got {entry!r}", key=where)
    own = (*HELD, *figure.conditions)
    check_known(table, (*_LIMIT_KEYS, *own), where)
    source = table.get("source", "")
    check_printable(source, f"{where}.source")
    unit = "1" if figure.unit == "-" else figure.unit
    stated = {
        key: parse(_without_sign(table[key], f"{where}.{key}"), unit, f"{where}.{key}")
        for key in ("value", "low", "high") if key in table
    }  # fmt: skip
    if not stated:
        raise InputError("needs a value, or a limit low or high", key=where, joint=" ")
    if "tolerance" in table:
        stated |= _within_tolerance(name, stated, table["tolerance"], f"{where}.tolerance")
    limit = replace(Limit(figure=name, source=source, key=where), **stated)  # type: ignore[arg-type]
    if limit.low > limit.high:
        problem = f"{table['low']!r} is above high = {table['high']!r}: the limits are the wrong way round"
        raise InputError(problem, key=f"{where}.low", related=(f"{where}.high",))
    if not math.isnan(limit.value) and not limit.low <= limit.value <= limit.high:
        raise InputError(f"{table['value']!r} is outside its own limits", key=f"{where}.value")
    positive = figure.unit in ("A", "ohm", "H", "m^3/s", "m^3/s/A", "Pa/A", "Hz", "s")
    for key, value in stated.items():
        if positive and key in table and value <= 0.0:
            raise InputError(f"{table[key]!r} must be positive", key=f"{where}.{key}")
    defaults = {key: value for key, value in figure.conditions.items() if value > 0.0}
    stated_conditions = {key: read_condition(key, table[key], f"{where}.{key}") for key in own if key in table}
    conditions = {**common, **defaults, **stated_conditions}
    if missing := [key for key in figure.conditions if key not in conditions]:
        raise InputError(f"needs {missing[0]} ({CONDITIONS[missing[0]].doc})", key=where, joint=" ")
    return replace(limit, conditions=conditions)


def _without_sign(text: Any, where: str) -> Any:
    """The text of a quantity; one with a sign of comparison is refused, since it is a limit."""
    for signs, key in (("<≤", "high"), (">≥", "low")):
        if isinstance(text, str) and text.lstrip()[:1] in tuple(signs):
            bare = text.strip().lstrip(f"{signs}= ")
            raise InputError(f"{text!r} is a limit: write {{ {key} = '{bare}' }}", key=where)
    return text


def _within_tolerance(name: str, stated: Mapping[str, float], text: Any, where: str) -> dict[str, float]:
    """The limits of a value with a tolerance, a share of it or a figure of its own unit."""
    if "value" not in stated or len(stated) > 1:
        raise InputError("goes with a value alone, in place of low and high", key=where)
    value, unit = stated["value"], "1" if FIGURES[name].unit == "-" else FIGURES[name].unit
    share = isinstance(text, str) and text.rstrip().endswith("%") and FIGURES[name].unit not in ("1", "%")
    width = parse(text, "1", where) * abs(value) if share else parse(text, unit, where)
    if width <= 0.0:
        raise InputError(f"{text!r} must be positive", key=where)
    return {"low": value - width, "high": value + width}
