"""Figures of a measured valve as what identification asks for, and those that a model has in their place."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from valvesim.characterisation.figure_of_merit import FigureOfMerit
from valvesim.characterisation.measured_valve import MeasuredValve
from valvesim.characterisation.specification import CONDITIONS, COVERAGE, FIGURES, Limit, Specification
from valvesim.identification.from_figures.options import DEFAULT_FROM_FIGURES, FromFiguresOptions, MeasurementOptions
from valvesim.identification.from_figures.prediction import CENTRED, FITTED, FigurePredictor, asked_of
from valvesim.valve.valve_file import ValveFile

SPECIFIED_FIGURES = {"coil.coil_resistance_at_20": "coil_resistance", "coil.coil_inductance": "coil_inductance"} | {
    shown: name for name, figure in FIGURES.items() if name in FITTED for shown in figure.shown_by
    if not shown.startswith(("valve.", "coil."))
}  # fmt: skip
"""A measured figure -> the figure of a specification that it shows."""
TELLING = (
    "coil_resistance", "coil_inductance", "rated_flow", "flow_gain", "null_bias", "pressure_gain", "null_leakage",
    "tare_leakage", "null_shift_temperature", "null_shift_supply", "null_shift_return", "frequency_minus_3_db",
    "frequency_minus_90_deg", "time_to_90_percent",
)  # fmt: skip
"""Measured figures that identify a valve: each tells something of its own, and its uncertainty is known."""


def measured_limits(
    measured: MeasuredValve, *, options: MeasurementOptions = DEFAULT_FROM_FIGURES.measurement
) -> list[Limit]:
    """Each measured figure that can be predicted, once for its conditions: weighted mean of those that show it."""
    groups: dict[tuple[str, tuple[tuple[str, float], ...]], list[FigureOfMerit]] = {}
    for figure, at in measured.figures:
        name = SPECIFIED_FIGURES.get(figure.name)
        if name not in TELLING or not isinstance(figure, FigureOfMerit):
            continue
        groups.setdefault((name, tuple(sorted(_conditions(name, at).items()))), []).append(figure)
    limits = []
    for (name, conditions), figures in groups.items():
        values = np.array([abs(f.value) if name.startswith(("flow_gain", "rated_flow")) else f.value for f in figures])
        floor = options.least_shift if name in CENTRED else 0.0
        errors = np.array([max(f.uncertainty or 0.0, options.least_deviation * abs(f.value), floor) for f in figures])
        weights = errors**-2
        value = float(np.sum(weights * values) / np.sum(weights))
        # instruments are shared, so that two figures of one meter are no better than the best of them
        width = COVERAGE * float(max(np.min(errors), np.std(values)))
        limits.append(Limit(figure=name, value=value, low=value - width, high=value + width,
                            conditions=dict(conditions), source="measured"))  # fmt: skip
    return limits


def _conditions(name: str, given: Mapping[str, float]) -> dict[str, float]:
    """The conditions of a figure: those of its test, then its own defaults."""
    known = {key: value for key, value in FIGURES[name].conditions.items() if value > 0.0}
    return known | {key: value for key, value in given.items() if key in CONDITIONS and key in _known(name)}


def _known(name: str) -> tuple[str, ...]:
    return ("supply_pressure", "return_pressure", "oil_temperature", *FIGURES[name].conditions)


def _place(limit: Limit) -> tuple[str, float]:
    """The figure and its amplitude, which a record has to a percent of rated current."""
    return limit.figure, round(limit.conditions.get("amplitude", 0.0), 2)


def with_measurements(
    specification: Specification, measured: MeasuredValve, *,
    options: MeasurementOptions = DEFAULT_FROM_FIGURES.measurement,
) -> Specification:  # fmt: skip
    """The specification with measured figures in the place of its own, where they are told of the same conditions."""
    limits = measured_limits(measured, options=options)
    told = {_place(limit) for limit in limits}
    kept = [limit for limit in specification.limits if _place(limit) not in told]
    if not specification.of("rated_current"):
        kept.append(Limit(figure="rated_current", value=measured.rated_current, source="acceptance.toml"))
    hysteresis = [f.value for f, _ in measured.figures if f.name == "flow.hysteresis" and isinstance(f, FigureOfMerit)]
    if hysteresis and all(np.isnan(one.value) for one in specification.of("hysteresis")):
        kept = [one for one in kept if one.figure != "hysteresis"]
        kept.append(Limit(figure="hysteresis", value=max(hysteresis[0], 0.0), source="measured"))
    return Specification(
        title=measured.title or specification.title, limits=(*kept, *limits),
        conditions={**specification.conditions, **measured.conditions}, oil=specification.oil,
    )  # fmt: skip


def model_figures(
    described: ValveFile, measured: MeasuredValve, *, options: FromFiguresOptions = DEFAULT_FROM_FIGURES
) -> dict[tuple[str, str], float]:
    """What a valve's model has in place of each measured figure, SI, by (title of the test, figure).

    Without its effects in service; raises as `FigurePredictor.predict` does.
    """
    places, limits = [], []
    for test in measured.tests:
        for figure in test.figures:
            name = SPECIFIED_FIGURES.get(figure.name)
            if name is not None and isinstance(figure, FigureOfMerit):
                places.append((test.title, figure.name))
                limits.append(Limit(figure=name, value=figure.value, conditions=_conditions(name, test.conditions)))
    valve = described.valve
    at = {"supply_pressure": float(valve.supply_pressure), "return_pressure": float(valve.return_pressure),
          "oil_temperature": 40.0, **measured.conditions}  # fmt: skip
    predictor = FigurePredictor(tuple(map(asked_of, limits)), at, described.oil, options=options)
    return dict(zip(places, map(float, predictor.predict(valve, 1)[0]), strict=True)) if limits else {}
