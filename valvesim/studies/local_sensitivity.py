"""Local sensitivities: the slope of each figure over each quantity at the nominal member, and the spread it makes.

Figures of a run come from the tangent-linear equations along the nominal run, solved for all quantities at once with
the exact Jacobian (`identification.tangent_linear`); what a quantity adds to the rates is a central difference of the
equations at held states. All other figures are central differences over the members next to the nominal one.

Symbols
    y figure, x_j quantity with standard deviation s_j:  share of the linearised variance (dy/dx_j s_j)^2 / sum
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from valvesim.channels import Inputs
from valvesim.characterisation.position_loop import PositionLoop
from valvesim.errors import InputError
from valvesim.identification.tangent_linear import TangentLinear, propagators_of
from valvesim.inputs import evaluate
from valvesim.simulation.temperature_knots import between
from valvesim.studies.distributions import Distribution
from valvesim.studies.members import FAILURES, StudyPlan, nominal_channels, prepared, run_block, validity_warnings
from valvesim.studies.parameter_study import ParameterStudy
from valvesim.studies.variables import Case, Varied, apply, scenario_of

DIFFERENCE = 0.1  # standard deviations, of figures
FORCING = 1e-3  # standard deviations, of the equations' rates
FEWEST_TIMES, MOST_TIMES = 2_000, 20_000  # of the tangent-linear equations, a whole number to each sample of the run


@dataclass(frozen=True)
class LocalSensitivity:
    """Slopes (figures, variables), in figure unit per quantity unit; `deviation` (variables,) of the quantities.

    NaN where the nominal member has no figure, or the quantity is a choice; `exact` (figures,) tells which are of the
    tangent-linear equations.
    """

    keys: tuple[str, ...]
    figures: tuple[str, ...]
    slopes: np.ndarray
    deviation: np.ndarray
    exact: np.ndarray

    @property
    def shares(self) -> np.ndarray:
        """Shares (figures, variables) of the linearised variance; NaN where nothing moves a figure."""
        parts = (self.slopes * self.deviation) ** 2
        total = np.nansum(parts, axis=1, keepdims=True)
        return np.divide(parts, total, out=np.full_like(parts, np.nan), where=total > 0.0)


def local_sensitivity(study: ParameterStudy, plan: StudyPlan) -> LocalSensitivity:
    """The local sensitivities of a study. Raises as the nominal member's run does."""
    names = tuple(figure.name for figure in plan.figures)
    continuous = [k for k, v in enumerate(study.variables) if isinstance(v.distribution, Distribution)]
    deviation = np.full(len(study.variables), np.nan)
    slopes, exact = np.full((len(names), len(study.variables)), np.nan), np.zeros(len(names), dtype=bool)
    for k in continuous:
        deviation[k] = study.variables[k].distribution.deviation  # type: ignore[union-attr]
    runs = [name for name in names if name.startswith("run.")]
    with validity_warnings():
        if runs and continuous:
            own = _run_slopes(study, plan, runs, [study.variables[k] for k in continuous], deviation[continuous])
            for name, row in own.items():
                slopes[names.index(name), continuous], exact[names.index(name)] = row, True
        others = [k for k, name in enumerate(names) if not exact[k]]
        if others and continuous:
            slopes[np.ix_(others, continuous)] = _differences(study, plan, others, continuous, deviation)
    return LocalSensitivity(study.keys, names, slopes, deviation, exact)


def _differences(
    study: ParameterStudy, plan: StudyPlan, figures: list[int], variables: list[int], deviation: np.ndarray
) -> np.ndarray:
    """Slopes (figures, variables) by central differences over members next to the nominal one."""
    nominal = np.array([v.quantity.nominal if k in variables else 0.0 for k, v in enumerate(study.variables)])
    draws = np.tile(nominal, (2 * len(variables), 1))
    for j, k in enumerate(variables):
        draws[2 * j, k] += DIFFERENCE * deviation[k]
        draws[2 * j + 1, k] -= DIFFERENCE * deviation[k]
    keep = tuple(plan.figures[k].name for k in figures)
    own = replace(study, keep=keep, percentiles=None, whole=None)
    kept = tuple(plan.figures[k] for k in figures)
    own_plan = replace(plan, figures=kept, nominal=plan.nominal[figures], reference=None)
    values = run_block(own, own_plan, 0, draws).figures
    return ((values[::2] - values[1::2]) / (2.0 * DIFFERENCE * deviation[variables])[:, None]).T


def _run_slopes(
    study: ParameterStudy, plan: StudyPlan, names: list[str], variables: list[Varied], deviation: np.ndarray
) -> dict[str, np.ndarray]:
    """Slopes (variables,) of figures of the nominal run by name."""
    case, start = study.case, study.options.start
    scenario = scenario_of(case)
    every = max(-(-FEWEST_TIMES // len(plan.times)), 1)
    rate = min(scenario.output_rate * every, MOST_TIMES / scenario.duration)
    fine: Case = _at_rate(case, rate)
    runs: Any = prepared(fine, plan.knot_times)
    values = nominal_channels(study, runs)
    compiled, times = runs.problem.compiled, runs.times
    model: Any = fine.model
    states = np.column_stack([values[channel.name] for channel in model.state_channels])
    at = _Equations(fine, times, plan.knot_times)
    step = FORCING * deviation
    nominal = at.terms({})
    moved = [_both(at, v, h) for v, h in zip(variables, step, strict=True)]
    forcing = np.stack(
        [np.column_stack([(np.broadcast_to(a, times.shape) - np.broadcast_to(b, times.shape)) / (2.0 * h)
                          for a, b in zip(model.rhs(states.T, *up), model.rhs(states.T, *down), strict=True)])
         for (up, down), h in zip(moved, step, strict=True)], axis=2,
    )  # fmt: skip
    scale = compiled.scale
    A = np.empty((len(times), len(scale), len(scale)))
    u, c = (np.ascontiguousarray(np.column_stack(np.broadcast_arrays(*one))) for one in nominal)
    compiled.jacobians(np.ascontiguousarray(states / scale), u, c, A)
    steps = np.diff(times)
    tangent = TangentLinear(np.arange(len(scale)), scale, A, *propagators_of(A, steps), {}, steps)
    response = tangent.response(forcing / scale[:, None]) * scale[:, None]
    since = every * int(np.searchsorted(times[::every], start * (1.0 - 1e-12)))
    slopes = {}
    for name in names:
        _, channel, reduction = name.split(".")
        y = values[channel]
        dy = _channel_slopes(model, channel, states, response, moved, step, times)
        slopes[name] = _reduced_slope(reduction, y[since::every], dy[since::every])
    return slopes


def _at_rate(case: Case, rate: float) -> Case:
    scenario = replace(scenario_of(case), output_rate=rate)
    return replace(case, scenario=scenario) if isinstance(case, PositionLoop) else scenario


class _Equations:
    """Inputs and coefficients of a case along given times."""

    def __init__(self, case: Case, times: np.ndarray, knot_times: np.ndarray | None):
        self.case, self.times, self.knot_times = case, times, knot_times

    def terms(self, changes: dict[str, float]) -> tuple[Inputs, tuple]:
        """(inputs, flat coefficients), of arrays (n_t,), of the case with these changes."""
        case = apply(self.case, changes)
        runs: Any = prepared(case, self.knot_times)
        problem, scenario = runs.problem, scenario_of(case)
        command = case.reference if isinstance(case, PositionLoop) else case.command
        driven = [evaluate(one, self.times) for one in (command, *scenario.pressures())]
        inputs = Inputs(driven[0], np.zeros_like(self.times), *driven[1:])
        return inputs, tuple(between(self.times, problem.path.times, problem.knots[0]))


def _both(at: _Equations, variable: Varied, step: float) -> tuple[Any, Any]:
    """Terms with a quantity a step above and below its nominal value."""
    nominal = variable.quantity.nominal
    try:
        return at.terms({variable.key: nominal + step}), at.terms({variable.key: nominal - step})
    except FAILURES as error:
        raise InputError(f"no slope at the nominal value: {error}", key=f"vary.{variable.key}") from None


def _channel_slopes(
    model: Any, channel: str, states: np.ndarray, response: np.ndarray, moved: list, step: np.ndarray, times: np.ndarray
) -> np.ndarray:
    """Slopes (n_t, variables) of a channel: of a state itself, of a signal along the tangent."""
    names = [one.name for one in model.state_channels]
    if channel in names:
        return response[:, names.index(channel), :]
    signals = [one.name for one in model.signal_channels]
    if channel not in signals:
        return np.full((len(times), len(step)), np.nan)
    k, columns = signals.index(channel), []
    for j, h in enumerate(step):
        high, low = (
            model.signals(tuple((states + sign * h * response[:, :, j]).T), *terms)[k]
            for sign, terms in zip((1.0, -1.0), moved[j], strict=True)
        )
        columns.append(np.broadcast_to((high - low) / (2.0 * h), times.shape))
    return np.column_stack(columns)


def _reduced_slope(reduction: str, y: np.ndarray, dy: np.ndarray) -> np.ndarray:
    """Slopes (variables,) of a reduction of a channel y (n_t,) whose own are dy (n_t, variables)."""
    low, high, large = int(np.argmin(y)), int(np.argmax(y)), int(np.argmax(np.abs(y)))
    rms = float(np.sqrt(np.mean(y * y)))
    return {
        "lowest": lambda: dy[low],
        "highest": lambda: dy[high],
        "largest": lambda: np.sign(y[large]) * dy[large],
        "mean": lambda: dy.mean(axis=0),
        "rms": lambda: (y[:, None] * dy).mean(axis=0) / rms if rms > 0.0 else np.zeros(dy.shape[1]),
        "span": lambda: dy[high] - dy[low],
        "end": lambda: dy[-1],
    }[reduction]()
