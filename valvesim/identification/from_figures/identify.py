"""A valve identified from the figures of a specification: its file, what was asked and reached, and what is assumed.

The prior is that of believable valves of its size (`similarity`); figures move it as far as they reach (`posterior`),
and what they leave open stays at its prior and is said to be assumed.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from valvesim.characterisation.measured_valve import MeasuredValve
from valvesim.characterisation.specification import COMMON, Limit, Specification
from valvesim.errors import InputError
from valvesim.identification.from_figures.conflicts import Conflict, conflicts_of
from valvesim.identification.from_figures.measured_figures import with_measurements
from valvesim.identification.from_figures.next_figure import NextFigure, next_figures
from valvesim.identification.from_figures.options import DEFAULT_FROM_FIGURES, FromFiguresOptions
from valvesim.identification.from_figures.posterior import Posterior, fit
from valvesim.identification.from_figures.prediction import FITTED, Asked, FigurePredictor, asked_of
from valvesim.identification.from_figures.similarity import ANCHOR, UNKNOWNS, similar_valves
from valvesim.units import quantities
from valvesim.valve.effect import ActiveEffect
from valvesim.valve.effects.motor import hysteresis_of_width
from valvesim.valve.effects.spool import COULOMB_FRICTION
from valvesim.valve.parameters import Valve
from valvesim.valve.valve_file import ValveFile

ASSUMED_CONDITIONS = {"supply_pressure": 21e6, "return_pressure": 0.5e6, "oil_temperature": 40.0}
"""What is assumed where a specification is silent (ISO 10770-1: 40 °C)."""
DERIVED = (
    "coil_turns", "spring_tube_stiffness", "fixed_orifice_diameter", "spool_stroke", "null_opening", "land_overlap",
)  # fmt: skip
SCALED = ("air_gap_area", "magnet_reluctance")
"""Parameters that follow from what is fitted, and those that follow from the size alone."""


@dataclass(frozen=True)
class IdentifiedParameter:
    """A parameter of the valve in SI: `low` and `high` are its 95 % interval, `similar` what similarity gives.

    `identified` where the figures narrow it; else it is assumed.
    """

    name: str
    unit: str
    value: float
    low: float
    high: float
    similar: float
    identified: bool


@dataclass(frozen=True)
class ReachedFigure:
    """A figure: what was asked, what the valve has, and one standard deviation of it by all figures together, SI."""

    asked: Asked
    value: float
    deviation: float

    @property
    def reached(self) -> bool:
        """Whether it keeps its limits."""
        return self.asked.reached(self.value)


@dataclass(frozen=True, kw_only=True)
class Identification:
    """The answer: `valve` is ready to be written, `posterior` what the rest is told from."""

    specification: Specification
    valve: ValveFile
    posterior: Posterior
    figures: tuple[ReachedFigure, ...]
    parameters: tuple[IdentifiedParameter, ...]
    conflicts: tuple[Conflict, ...]
    next_figures: tuple[NextFigure, ...]
    notes: tuple[str, ...]


def identify(
    specification: Specification, *, measured: MeasuredValve | None = None, seed: int = 0, workers: int = 1,
    progress: Callable[[float], None] | None = None, options: FromFiguresOptions = DEFAULT_FROM_FIGURES,
) -> Identification:  # fmt: skip
    """Identify a valve, of a `measured` one also from the figures of its records.

    `workers` threads simulate; `progress` is told the share that is done.

    Raises InputError where rated flow or rated current is missing or of another kind of valve, and SolveError where no
    valve near similarity runs.
    """
    if measured is not None:
        specification = with_measurements(specification, measured, options=options.measurement)
    tell = progress if progress is not None else lambda share: None
    flow, current = (_needed(specification, name) for name in ("rated_flow", "rated_current"))
    conditions = {**ASSUMED_CONDITIONS, **specification.conditions}
    coils = [limit.nominal for limit in specification.of("coil_resistance") if not math.isnan(limit.nominal)]
    similar = similar_valves(
        rated_flow=flow.nominal, pressure_drop=flow.conditions["pressure_drop"], rated_current=current.nominal,
        conditions=conditions, oil=specification.oil, coil_resistance=next(iter(coils), None), options=options,
    )  # fmt: skip
    asked = tuple(asked_of(limit) for limit in specification.limits if limit.figure in FITTED)
    predictor = FigurePredictor(asked, conditions, specification.oil, workers, options)
    posterior = fit(similar, predictor, seed=seed, progress=lambda share: tell(0.6 * share))
    tell(0.6)
    conflicts = conflicts_of(posterior, predictor, progress=lambda share: tell(0.6 + 0.3 * share))
    tell(0.9)
    following = next_figures(posterior, predictor)
    valve, parameters = _described(specification, posterior, options)
    if measured is not None:
        valve = replace(valve, serial_number=measured.serial_number)
    figures = tuple(map(ReachedFigure, asked, map(float, posterior.predicted), map(float, posterior.deviations)))
    tell(1.0)
    return Identification(
        specification=specification, valve=valve, posterior=posterior, figures=figures, parameters=parameters,
        conflicts=conflicts, next_figures=following, notes=_notes(specification, conditions),
    )  # fmt: skip


def _needed(specification: Specification, name: str) -> Limit:
    """The limit of a figure without which there is no size."""
    limits = [limit for limit in specification.of(name) if not math.isnan(limit.nominal)]
    if not limits:
        example = "38 L/min" if name == "rated_flow" else "40 mA"
        given = specification.of(name)
        why = "has one limit alone" if given else "is missing"
        raise InputError(
            f"{why}: the size of a valve is told by it, such as {name} = {{ value = '{example}' }}",
            key=given[0].key if given else f"figures.{name}", joint=" ",
        )  # fmt: skip
    return limits[0]


# ---------------------------------------------------------------- the valve's file


def _described(
    specification: Specification, posterior: Posterior, options: FromFiguresOptions
) -> tuple[ValveFile, tuple[IdentifiedParameter, ...]]:
    """The valve's file with sources, tolerances and correlations, and its parameters with their intervals."""
    similar, n, step = posterior.similar, len(posterior.point), options.posterior.step
    names = [unknown.name for unknown in UNKNOWNS if unknown.name in quantities(Valve)]
    names = sorted({*names, *DERIVED}, key=list(quantities(Valve)).index)

    def table(point: np.ndarray) -> np.ndarray:
        valves = similar.valves(point + step * np.vstack([np.zeros(n), np.eye(n), -np.eye(n)]))
        columns = [np.broadcast_to(getattr(valves, name), (2 * n + 1,)) for name in names]
        return np.stack(columns, axis=-1)

    at, usual = table(posterior.point), table(np.zeros(n))
    signed = np.array([quantities(Valve)[name].default == 0.0 for name in names])  # lie around zero: no logarithm
    value = np.where(np.abs(at[0]) < 1e-6 * np.abs(at - at[0]).max(axis=0), 0.0, at[0])  # what differences left of zero
    value = np.array([float(f"{v:.6g}") for v in value])
    with np.errstate(divide="ignore", invalid="ignore"):
        scaled, prior = (np.where(signed, t, np.log(np.where(signed, 1.0, t))) for t in (at, usual))
    slopes, usual_slopes = ((t[1 : n + 1] - t[n + 1 :]).T / (2.0 * step) for t in (scaled, prior))
    covariance = slopes @ posterior.covariance @ slopes.T
    deviation, before = np.sqrt(np.diag(covariance)), np.sqrt(np.diag(usual_slopes @ usual_slopes.T))
    low = np.where(signed, value - 1.96 * deviation, value * np.exp(-1.96 * deviation))
    high = np.where(signed, value + 1.96 * deviation, value * np.exp(1.96 * deviation))
    units = {name: field.metadata["unit"] for name, field in quantities(Valve).items()}
    narrowed = deviation < options.posterior.identified * before
    parameters = tuple(
        IdentifiedParameter(name, units[name], float(v), float(a), float(b), float(m), bool(t))
        for name, v, a, b, m, t in zip(names, value, low, high, usual[0], narrowed, strict=True)
    )
    own: dict[str, Any] = {name: float(f"{getattr(similar.base, name):.6g}") for name in SCALED}
    own |= {name: float(v) for name, v in zip(names, value, strict=True)}
    single = replace(similar.base, **own, name=specification.title)
    width = 2.0 * deviation * np.where(signed, 1.0, np.abs(value))
    correlation = covariance / np.outer(deviation, deviation)
    sources = {
        f"valve.{p.name}": "identified from its figures" if p.identified else f"assumed: {ANCHOR}" for p in parameters
    }
    sources |= {f"valve.{name}": f"assumed: {ANCHOR}" for name in SCALED}
    sources["valve.spool_stroke"] = f"assumed: {options.similarity.stop:g} of the stroke at rated current"
    sources["valve.rated_current"] = _needed(specification, "rated_current").source or "specification"
    return ValveFile(
        title=specification.title, valve=single, oil=specification.oil, effects=_in_service(specification, single),
        sources=sources, tolerances={n: float(f"{w:.3g}") for n, w in zip(names, width, strict=True)},
        correlations={
            (names[j], names[k]): round(float(correlation[j, k]), 3)
            for j in range(len(names)) for k in range(j) if abs(correlation[j, k]) >= 5e-3
        },
    ), parameters  # fmt: skip


def _in_service(specification: Specification, valve: Valve) -> tuple[ActiveEffect, ...]:
    """The hysteresis that a specification states a value of, as that of the magnetic circuit."""
    stated = [limit.value for limit in specification.of("hysteresis") if not math.isnan(limit.value)]
    if not stated or stated[0] <= 0.0:
        return ()
    rated = float(valve.rated_current)
    return (hysteresis_of_width(stated[0] * rated, rated),)


def _notes(specification: Specification, conditions: dict[str, float]) -> tuple[str, ...]:
    """What was assumed and what of the specification does not bear on the valve."""
    silent = [name.replace("_", " ") for name in COMMON if name not in specification.conditions]
    notes = [f"assumed where the specification is silent: {', '.join(silent)}"] if silent else []
    for name in ("hysteresis", "threshold"):
        limits = specification.of(name)
        if limits and all(math.isnan(limit.value) for limit in limits):
            notes.append(f"{name}: the valve has none, which keeps the limit; a value would be modelled")
        elif limits and name == "threshold":
            notes.append(f"threshold: not modelled; add effects.{COULOMB_FRICTION.name} to the valve file")
    return tuple(notes)
