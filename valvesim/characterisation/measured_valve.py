"""A measured valve: the records of its acceptance tests in a folder, and every figure that they allow.

    title = "Servo valve 5329"                 # acceptance.toml
    serial_number = "5329"
    rated_current = "25 mA"
    [conditions]
    supply_pressure = "205.5 bar"
    oil_temperature = "40 degC"
    [instruments]
    flow = "2.5 %"
    [[records]]
    file = "flow_gain.csv"
    test = "flow"
    supply_pressure = "70 bar"

The tests are those of `RECORD_TESTS`. Conditions of a record take the place of the folder's. What instruments may be
off by is taken as an error of scale, at two standard deviations; the classes of ISO 10770-1 hold where none is stated.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from valvesim.characterisation.acceptance.acceptance_tests import CYCLE_TESTS, record_figures
from valvesim.characterisation.acceptance.coil import coil_figures
from valvesim.characterisation.acceptance.measured_threshold import measured_threshold
from valvesim.characterisation.acceptance.record import ACCEPTANCE_CHANNELS, AcceptanceRecord
from valvesim.characterisation.dither import dither_of
from valvesim.characterisation.figure_of_merit import Absent, FigureOfMerit, FiguresOfMerit
from valvesim.characterisation.frequency_response import FrequencyResponse, at_single_frequencies, join_points
from valvesim.characterisation.judgement_table import Tests
from valvesim.characterisation.options import DEFAULT_CHARACTERISATION, CharacterisationOptions
from valvesim.characterisation.sine_point import fit_sine
from valvesim.characterisation.specification import HELD, Specification, read_condition
from valvesim.characterisation.spectral_response import spectral_response
from valvesim.characterisation.step_response import step_figures
from valvesim.errors import InputError, unknown_name
from valvesim.io import check_known, check_printable, check_tables, located, read_names, read_toml
from valvesim.measurement.columns_table import Statements, statements_of, statements_of_record
from valvesim.measurement.headings import MEASURED_UNITS
from valvesim.measurement.recording import read_recording
from valvesim.units import parse
from valvesim.valve.effect_trust import check_inside

RECORD_TESTS = (*CYCLE_TESTS, "threshold", "step", "chirp", "sine", "coil")
"""Tests of a record, in the order of a report: slow cycles, then what moves, then the coils."""
DYNAMIC_OUTPUTS = ("spool_position", "load_flow", "load_pressure")
"""What may be the output of a threshold or dynamic test, the first that a record has."""
INSTRUMENTS = {"flow": 0.025, "current": 0.015, "pressure": 0.02, "resistance": 0.02, "dynamics": 0.01, "time": 0.01}
"""Classes of ISO 10770-1 (2009), and of pressure gauges of class 2, as shares."""
_INVOLVED = {
    "m^3/s": ("flow",), "m^3/s/A": ("flow", "current"), "A": ("current",), "Pa": ("pressure",),
    "Pa/A": ("pressure", "current"), "-": ("pressure", "current"), "1": ("current",), "ohm": ("resistance",),
    "H": ("resistance", "dynamics"), "Hz": ("dynamics",), "s": ("time",), "dB": (), "%": (), "deg": (),
}  # fmt: skip
_EXACT = ("dead_zone", "meter_resolution", "polarity", "flow_exponent", "lag", "rate", "linearity", "symmetry")
"""Figures to which the scale of an instrument does nothing."""


@dataclass(frozen=True, kw_only=True)
class MeasuredResult:
    """One test: which of `RECORD_TESTS`, its `conditions` by the names of a specification's (SI), figures named as
    bench and response do, and the columns (n,) in SI that they were reduced from; of a chirp or several sines also
    `response`.
    """

    test: str
    source: str
    conditions: Mapping[str, float]
    figures: FiguresOfMerit
    values: Mapping[str, np.ndarray]
    notes: tuple[str, ...] = ()
    response: FrequencyResponse | None = None

    @property
    def title(self) -> str:
        """The test in words."""
        return f"{self.test.replace('-', ' ')} of {self.source}"


@dataclass(frozen=True, kw_only=True)
class MeasuredValve:
    """A valve as its records have it; `instruments` are shares at two standard deviations."""

    title: str
    serial_number: str
    rated_current: float
    conditions: Mapping[str, float]
    instruments: Mapping[str, float]
    tests: tuple[MeasuredResult, ...]

    @property
    def figures(self) -> list[tuple[FigureOfMerit | Absent, Mapping[str, float]]]:
        """Every figure with its conditions, as `specification.judge` takes them."""
        return [(figure, test.conditions) for test in self.tests for figure in test.figures]


def measured_tests(measured: MeasuredValve, specification: Specification | None = None) -> Tests:
    """Every test; responses also at the single frequencies that a specification has limits at."""
    frequencies = () if specification is None else specification.single_frequencies
    tests = [(test.title, test.conditions, test.figures) for test in measured.tests]
    for test in measured.tests:
        if test.response is not None:
            tests += at_single_frequencies(test.title, test.conditions, test.response, frequencies)
    return tests


def load_measured_valve(
    folder: str | Path, *, options: CharacterisationOptions = DEFAULT_CHARACTERISATION
) -> MeasuredValve:
    """Read a folder with `acceptance.toml` and its records, of any format, and reduce them.

    Raises InputError (file, line, key) for a broken file, an unknown test, and a record that its test cannot be told
    from.
    """
    folder = Path(folder)
    path = folder / "acceptance.toml"
    text, table = read_toml(path, "a measured valve is a folder with acceptance.toml and its records")
    with located(path, text, document="acceptance"):
        return _read(table, folder, options)


def _read(table: dict[str, Any], folder: Path, options: CharacterisationOptions) -> MeasuredValve:
    known = ("title", "serial_number", "rated_current", "conditions", "instruments", "columns", "csv", "records")
    check_known(table, known, "acceptance")
    check_tables(table, ("conditions", "instruments"))
    columns = statements_of(table.get("columns", {}), table.get("csv", {}))
    words = {key: table.get(key, "") for key in ("title", "serial_number")}
    for key, text in words.items():
        check_printable(text, key)
    if "rated_current" not in table:
        raise InputError("is missing, such as rated_current = '25 mA'", key="rated_current", joint=" ")
    rated = parse(table["rated_current"], "A", "rated_current")
    if rated <= 0.0:
        raise InputError(f"{table['rated_current']!r} must be positive", key="rated_current")
    check_known(table.get("conditions", {}), HELD, "conditions")
    common = {n: read_condition(n, text, f"conditions.{n}") for n, text in table.get("conditions", {}).items()}
    check_known(table.get("instruments", {}), tuple(INSTRUMENTS), "instruments")
    stated = {n: parse(text, "1", f"instruments.{n}") for n, text in table.get("instruments", {}).items()}
    for name, share in stated.items():
        if not 0.0 <= share <= 0.5:
            raise InputError(f"{table['instruments'][name]!r} is outside [0, 50] %", key=f"instruments.{name}")
    records = table.get("records", [])
    if not isinstance(records, list) or not records or not all(isinstance(one, dict) for one in records):
        raise InputError("expected [[records]], one for each test", key="records")
    instruments = {**INSTRUMENTS, **stated}
    results = [
        _reduce(entry, f"records.{k}" if len(records) > 1 else "records", folder, common, rated, columns, options)
        for k, entry in enumerate(records, start=1)
    ]
    results = _join_sines(results, rated, options)
    told = tuple(replace(one, figures=_with_instruments(one.figures, instruments)) for one in results)
    told = (*told, *_null_shifts(told))
    return MeasuredValve(
        **words, rated_current=rated, conditions=common, instruments=instruments, tests=_in_order(told)
    )  # fmt: skip


def _in_order(tests: Sequence[MeasuredResult]) -> tuple[MeasuredResult, ...]:
    order = (*RECORD_TESTS, "null-shift")
    return tuple(sorted(tests, key=lambda one: order.index(one.test)))


# ---------------------------------------------------------------- one record

_METER = {"lag": "s", "dead_zone": "m^3/s"}


def _reduce(
    entry: Mapping[str, Any], where: str, folder: Path, common: Mapping[str, float], rated: float,
    columns: Statements, options: CharacterisationOptions,
) -> MeasuredResult:  # fmt: skip
    known = ("file", "files", "test", "frequency", *HELD, "pressure_drop", *_METER, "columns", "csv")
    check_known(entry, known, where)
    test = entry.get("test")
    if not isinstance(test, str) or test not in RECORD_TESTS:
        raise unknown_name("test", str(test), RECORD_TESTS, f"{where}.test")
    given = entry.get("files", [entry["file"]] if "file" in entry else [])
    names = read_names(given, f"{where}.files", "file")
    if not names:
        raise InputError("needs a file", key=where, joint=" ")
    for name in names:
        check_inside(name, folder, f"{where}.file")
    may = (*HELD, "pressure_drop", "frequency")
    own = {n: read_condition(n, entry[n], f"{where}.{n}") for n in may if n in entry}
    meter = {n: parse(entry[n], _METER[n], f"{where}.{n}") for n in _METER if n in entry}
    wanted = ("voltage", "current") if test == "coil" else (*ACCEPTANCE_CHANNELS, "spool_position")
    stated = statements_of_record(entry, columns, where)
    recording = read_recording([folder / name for name in names], wanted, stated=stated)
    there = np.all([np.isfinite(column) for column in recording.values.values()], axis=0)
    values = {"time": recording.time[there]} | {name: column[there] for name, column in recording.values.items()}
    at = {**common, **own}
    try:
        reduced = _REDUCTIONS[test](names[0], values, at, meter, rated, options)
    except InputError as error:
        if error.key or error.file:
            raise
        others = f"; no channel: {', '.join(recording.left_out)}; state them in [columns]" if recording.left_out else ""
        raise InputError(f"{error}{others}", key=f"{where}.file") from None
    return MeasuredResult(
        test=test, source=names[0], conditions={**at, **reduced.conditions}, figures=reduced.figures, values=values,
        notes=recording.notes, response=reduced.response,
    )  # fmt: skip


class Reduced(NamedTuple):
    """What a record gives: figures, conditions that it tells itself, and its frequency response."""

    figures: FiguresOfMerit
    conditions: Mapping[str, float] = {}
    response: FrequencyResponse | None = None


def _named(test: str, figures: FiguresOfMerit) -> FiguresOfMerit:
    return tuple(replace(figure, name=f"{test}.{figure.name}") for figure in figures)


def _cycle(test: str) -> Callable[..., Reduced]:
    """The reduction of a slow cycle."""

    def reduce(source, values, at, meter, rated, options) -> Reduced:
        record = AcceptanceRecord(source=source, values=dither_of(at).means(values), options=options.acceptance)
        figures = record_figures(record, test, rated_current=None if test == "flow-load" else rated, **meter)
        figures = tuple(one for one in figures if one.name != "threshold")  # of a record of its own
        if test == "flow-load":
            figures = tuple(replace(one, name=f"{one.name}_positive") for one in figures)
            return Reduced(_named(test, figures), {"pressure_drop": 7e6})
        return Reduced(_named(test, figures))

    return reduce


def _output(source: str, values: Mapping[str, np.ndarray]) -> str:
    for name in DYNAMIC_OUTPUTS:
        if name in values:
            return name
    raise InputError(f"{source}: no output; expected one of {', '.join(DYNAMIC_OUTPUTS)}")


def _needs(source: str, values: Mapping[str, np.ndarray], name: str) -> np.ndarray:
    if name not in values:
        raise InputError(f"{source}: no column {name!r}, which this test needs; it has {', '.join(values)}")
    return values[name]


def _threshold(source, values, at, meter, rated, options) -> Reduced:
    record = AcceptanceRecord(source=source, values=dither_of(at).means(values), options=options.acceptance)
    return Reduced(_named("flow", (measured_threshold(record, _output(source, values), rated_current=rated),)))


def _step(source, values, at, meter, rated, options) -> Reduced:
    current, output = _needs(source, values, "current"), _output(source, values)
    dither, last = dither_of(at), slice(-len(current) // 3, None)  # by then the step has settled
    current, moved = (dither.taken_off(values["time"], column, last) for column in (current, values[output]))
    amplitude = abs(float(np.median(current[-3:]) - np.median(current[:3]))) / rated
    figures = step_figures(values["time"], current, moved, unit=MEASURED_UNITS[output])
    return Reduced(figures, {"amplitude": amplitude})


def _chirp(source, values, at, meter, rated, options) -> Reduced:
    current, output = _needs(source, values, "current"), _output(source, values)
    response = spectral_response(values["time"], current, values[output], channel=output, options=options.response)
    return Reduced(response.figures, {"amplitude": response.amplitude / rated}, response)


def _sine(source, values, at, meter, rated, options) -> Reduced:
    if "frequency" not in at:
        raise InputError(f"{source}: the frequency of a sine is missing, such as frequency = '40 Hz'")
    current, output = _needs(source, values, "current"), _output(source, values)
    point = fit_sine(values["time"], current, values[output], at["frequency"], dither=_fitted_beside(at))
    lag = float(-np.rad2deg(np.angle(point.gain)))
    figures = (
        FigureOfMerit("gain", float(np.abs(point.gain)), f"{MEASURED_UNITS[output]}/A",
                      "amplitude of output over current"),
        FigureOfMerit("phase_lag", lag + 360.0 * (lag < -90.0), "deg", "output behind the current"),
    )
    return Reduced(figures, {"amplitude": point.input_amplitude / rated})


def _fitted_beside(at: Mapping[str, float]) -> float:
    """The frequency of the dither, Hz; zero without one."""
    return dither_of(at).frequency if at.get("dither_amplitude") else 0.0


def _coil(source, values, at, meter, rated, options) -> Reduced:
    figures = coil_figures(
        values["time"], _needs(source, values, "voltage"), _needs(source, values, "current"),
        temperature=at.get("oil_temperature"), options=options.acceptance,
    )  # fmt: skip
    return Reduced(_named("coil", figures))


_REDUCTIONS: dict[str, Callable[..., Reduced]] = {name: _cycle(name) for name in CYCLE_TESTS} | {
    "threshold": _threshold, "step": _step, "chirp": _chirp, "sine": _sine, "coil": _coil,
}  # fmt: skip


# ---------------------------------------------------------------- several records


def _join_sines(
    results: Sequence[MeasuredResult], rated: float, options: CharacterisationOptions
) -> list[MeasuredResult]:
    """Sines of one amplitude, oil temperature and supply as one frequency response; one alone stays a sine."""
    groups: dict[tuple[float, ...], list[MeasuredResult]] = {}
    joined = [one for one in results if one.test != "sine"]
    for one in (one for one in results if one.test == "sine"):
        key = (round(one.conditions["amplitude"], 2), *(one.conditions.get(name, np.nan) for name in HELD))
        groups.setdefault(key, []).append(one)
    for group in groups.values():
        if len(group) < 3:
            joined += group
            continue
        points = []
        for one in group:
            output = one.values[_output(one.source, one.values)]
            points.append(
                fit_sine(one.values["time"], one.values["current"], output, one.conditions["frequency"],
                         dither=_fitted_beside(one.conditions))
            )  # fmt: skip
        response = join_points(points, share=group[0].conditions["amplitude"], options=options.response)
        at = {name: value for name, value in group[0].conditions.items() if name != "frequency"}
        joined.append(MeasuredResult(
            test="sine", source=f"{len(group)} records", conditions=at, figures=response.figures, values={},
            response=response,
        ))  # fmt: skip
    return joined


_SHIFTS = (
    ("oil_temperature", "temperature", "temperature_difference", "over the oil temperature"),
    ("supply_pressure", "supply", "pressure_change", "over the supply pressure"),
    ("return_pressure", "return", "pressure_change", "over the return pressure"),
)


def _null_shifts(tests: Sequence[MeasuredResult]) -> list[MeasuredResult]:
    """Shift of null between tests that differ in one condition alone, share of i_R: a curve, and over all of it."""
    nulls = [
        (test.conditions, figure)
        for test in tests
        for figure in test.figures
        if isinstance(figure, FigureOfMerit) and figure.name in ("flow.null_bias", "pressure-gain.null_bias")
    ]
    shifts = []
    for condition, name, span_name, doc in _SHIFTS:
        for kind in ("flow.null_bias", "pressure-gain.null_bias"):
            alike: dict[tuple[float, ...], list[tuple[float, FigureOfMerit]]] = {}
            for at, figure in nulls:
                if figure.name == kind and condition in at:
                    others = tuple(at.get(other, np.nan) for other in HELD if other != condition)
                    alike.setdefault(tuple(np.nan_to_num(others, nan=-1.0)), []).append((at[condition], figure))
            for group in alike.values():
                group.sort(key=lambda pair: pair[0])
                places = np.array([value for value, _ in group])
                if len(group) < 2 or np.ptp(places) == 0.0:
                    continue
                null = np.array([figure.value for _, figure in group])
                error = float(np.hypot(group[0][1].uncertainty or 0.0, group[-1][1].uncertainty or 0.0))
                span = float(np.ptp(places))
                conditions = {span_name: span if name == "temperature" else span / float(places.max())}
                shift = FigureOfMerit(f"null-shift.{name}", float(null[-1] - null[0]), "1",
                                      f"shift of null {doc}, share of i_R", error)  # fmt: skip
                shifts.append(MeasuredResult(
                    test="null-shift", source=f"{len(group)} tests, {kind.split('.')[0]}", conditions=conditions,
                    figures=(shift,), values={condition: places, "null_bias": null},
                ))  # fmt: skip
    return shifts


def _with_instruments(figures: FiguresOfMerit, instruments: Mapping[str, float]) -> FiguresOfMerit:
    """Figures with what the instruments may be off by in their uncertainty."""
    told: list[FigureOfMerit | Absent] = []
    for figure in figures:
        if isinstance(figure, Absent) or figure.name.rpartition(".")[2] in _EXACT:
            told.append(figure)
            continue
        shares = [instruments[name] / 2.0 for name in _INVOLVED.get(figure.unit, ())]
        scale = abs(figure.value) * float(np.sqrt(np.sum(np.square(shares))))
        told.append(replace(figure, uncertainty=float(np.hypot(figure.uncertainty or 0.0, scale))))
    return tuple(told)

