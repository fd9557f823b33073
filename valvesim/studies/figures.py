"""The figures of merit that a study may keep of each member, by name, each in one family.

    run.CHANNEL.REDUCTION     of the scenario's run (or the loop's): lowest, highest, largest, mean, rms, span, end
    drift.QUANTITY.REDUCTION  static drift along the run's temperatures (end, largest) of angle and spool position
    bench.TEST.FIGURE         the static acceptance tests of `valvesim bench`, isothermal, at `bench_temperature`
    response.TEST.FIGURE      steps and stepped sines of `valvesim response`: step_25, sine_100 (% of rated command)
    own.FIGURE                of functions of one's own, of a member's case: {name: value}

A name may hold `*`. What a family computes is what the command of its name computes, by the same functions.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from typing import Any

import numpy as np

from valvesim.channels import Channel
from valvesim.characterisation.acceptance.acceptance_tests import RIG_TESTS, rig_figures
from valvesim.characterisation.acceptance.rig import Rig
from valvesim.characterisation.figure_of_merit import FigureOfMerit, FiguresOfMerit
from valvesim.characterisation.frequency_response import FREQUENCIES, frequency_response
from valvesim.characterisation.held_scenario import held, held_oil_temperature, rated_command
from valvesim.characterisation.response_set import SINE_AMPLITUDES, STEP_AMPLITUDES
from valvesim.characterisation.step_response import step_response
from valvesim.characterisation.thermal_drift import QUANTITIES, reference_current
from valvesim.errors import InputError, unknown_name
from valvesim.simulation.scenario import Scenario
from valvesim.valve.coefficients import REFERENCE_TEMPERATURE, PartTemperatures
from valvesim.valve.equilibrium import static_solution

FAMILIES = ("run", "drift", "bench", "response", "own")
RESPONSE_FIGURES = {
    **dict.fromkeys(
        ("time_to_90_percent", "rise_time", "settling_time", "overshoot", "dead_time", "mean_rate"), "step"
    ),
    **dict.fromkeys(("frequency_minus_3_db", "frequency_minus_90_deg", "resonant_peak", "largest_distortion"), "sine"),
}
"""The test of a response that shows a figure."""
RESPONSE_TESTS = (*(f"step_{100 * s:g}" for s in STEP_AMPLITUDES), *(f"sine_{100 * s:g}" for s in SINE_AMPLITUDES))
DRIFT_POINTS = 101  # of the run's temperatures, as `static_drift` takes them


@dataclass(frozen=True)
class KeptFigure:
    """A figure of merit that is kept: name, unit and definition."""

    name: str
    unit: str
    doc: str


REDUCTIONS: dict[str, tuple[str, Callable[[np.ndarray], float]]] = {
    "lowest": ("least value", lambda y: float(np.min(y))),
    "highest": ("greatest value", lambda y: float(np.max(y))),
    "largest": ("greatest magnitude", lambda y: float(np.max(np.abs(y)))),
    "mean": ("mean", lambda y: float(np.mean(y))),
    "rms": ("root of the mean square", lambda y: float(np.sqrt(np.mean(y * y)))),
    "span": ("greatest less least value", lambda y: float(np.ptp(y))),
    "end": ("value at the end", lambda y: float(y[-1])),
}
"""Reductions of a channel over time to one number."""


def run_figures(channels: Sequence[Channel]) -> tuple[KeptFigure, ...]:
    """Every figure that a run with these channels has."""
    return tuple(
        KeptFigure(f"run.{channel.name}.{name}", channel.unit, f"{doc} of {channel.doc or channel.name}")
        for channel in channels
        for name, (doc, _) in REDUCTIONS.items()
    )


DRIFT_FIGURES = tuple(
    KeptFigure(
        f"drift.{quantity}.{name}", "1", f"static drift of the {quantity.replace('_', ' ')} against 20 °C, {doc}",
    )
    for quantity in QUANTITIES
    for name, doc in (("end", "at the end of the run"), ("largest", "greatest magnitude along the run"))
)


def static_drifts(scenario: Scenario, names: Sequence[str]) -> dict[str, np.ndarray]:
    """Those `names` of `DRIFT_FIGURES`, (k,) for a valve of arrays (k,), else ().

    The drift is that of `thermal_drift.static_drift`, along the run's temperatures; they are solved for where they are
    asked for. Raises as `static_solution` does.
    """
    times = np.linspace(0.0, scenario.duration, DRIFT_POINTS)
    parts = scenario.temperatures(knots=times).parts
    still = all(np.ptp(temperature) == 0.0 for temperature in vars(parts).values())
    if still or all(name.endswith(".end") for name in names):
        parts = PartTemperatures(**{name: temperature[-1:] for name, temperature in vars(parts).items()})
    valve = scenario.valve_at_start
    columns: Any = {
        name: np.asarray(value)[:, None] for name, value in vars(valve).items() if isinstance(value, np.ndarray)
    }
    valve, current = replace(valve, **columns), reference_current(replace(scenario, valve=_first(scenario.valve)))

    def solve(temperatures: PartTemperatures, routes: tuple[str, ...]):
        return static_solution(valve, current=current, parts=temperatures, routes=routes, oil=scenario.oil)

    cold = solve(PartTemperatures.uniform(REFERENCE_TEMPERATURE), ())
    warm = solve(parts, tuple(scenario.thermal.routes))
    drifts: dict[str, np.ndarray] = {}
    for quantity in QUANTITIES:
        drift = np.asarray(getattr(warm, quantity) / getattr(cold, quantity) - 1.0)
        drifts[f"drift.{quantity}.end"] = drift[..., -1]
        drifts[f"drift.{quantity}.largest"] = np.max(np.abs(drift), axis=-1)
    return {name: drifts[name] for name in names}


def _first(valve: Any) -> Any:
    """The first valve of a batch: its rated current and resistance tell at which current drift is told."""
    return replace(valve, **{n: float(v[0]) for n, v in vars(valve).items() if isinstance(v, np.ndarray)})


def bench_figures(scenario: Scenario, tests: Sequence[str], *, temperature: float, points: int) -> FiguresOfMerit:
    """The figures of static acceptance tests of a scenario's valve, oil and effects; see `rig_figures`."""
    rig = Rig(
        valve=scenario.valve_at_start, oil=scenario.oil, oil_temperature=temperature, effects=scenario.effects,
        period=1e4, points=points,
    )  # fmt: skip
    return _named("bench", rig_figures(rig, tests))


def response_figures(
    scenario: Scenario, tests: Sequence[str], *, frequencies: Sequence[float] = FREQUENCIES
) -> FiguresOfMerit:
    """The figures of steps and stepped sines, of `RESPONSE_TESTS`, from where the scenario starts."""
    base = held(scenario)
    base, rated = held(base, oil_temperature=held_oil_temperature(base)), rated_command(base)
    figures: FiguresOfMerit = ()
    for test in tests:
        kind, _, percent = test.partition("_")
        amplitude = float(percent) / 100.0 * rated
        if kind == "step":
            own = step_response(base, amplitude=amplitude).figures
        else:
            own = frequency_response(base, amplitude=amplitude, frequencies=frequencies).figures
        figures += _named(f"response.{test}", own)
    return figures


def _named(prefix: str, figures: FiguresOfMerit) -> FiguresOfMerit:
    return tuple(replace(figure, name=f"{prefix}.{figure.name}") for figure in figures)


OwnFigures = Callable[[Any], Mapping[str, float]]
"""A function of one's own: of a member's case (a scenario or a position loop) figures of merit by name."""


def own_figures(case: Any, functions: Sequence[OwnFigures]) -> FiguresOfMerit:
    """The figures of functions of one's own. InputError where one gives something else than numbers by name."""
    figures: FiguresOfMerit = ()
    for function in functions:
        try:
            told = {str(name): float(value) for name, value in function(case).items()}
        except Exception as error:  # it is a stranger's
            problem = f"{function.__name__} fails with {type(error).__name__}: {error}; it must give numbers by name"
            raise InputError(problem, key="figures.functions") from None
        doc = (function.__doc__ or function.__name__).strip().split("\n")[0]
        figures += tuple(FigureOfMerit(f"own.{name}", value, "-", doc) for name, value in told.items())
    return figures


FAMILY_TESTS = {"bench": RIG_TESTS, "response": RESPONSE_TESTS}


def tests_of(family: str, names: Sequence[str]) -> tuple[str, ...]:
    """The tests of a family ("bench" or "response") that some names of figures need. InputError for an unknown one."""
    needed = []
    for name in names:
        first, _, rest = name.partition(".")
        if first == family:
            test = rest.partition(".")[0]
            found = [one for one in FAMILY_TESTS[family] if fnmatchcase(one, test)]
            if not found and family == "response" and re.fullmatch(r"(step|sine)_\d{1,3}(\.\d+)?", test):
                found = [test]  # of another amplitude
            if not found:
                raise unknown_name(f"test of {family}", test, FAMILY_TESTS[family], "figures.keep")
            needed += found
    return tuple(dict.fromkeys([one for one in FAMILY_TESTS[family] if one in needed] + needed))


def check_families(names: Sequence[str]) -> None:
    """InputError for a name whose first part is no family."""
    for name in names:
        if name.partition(".")[0] not in FAMILIES:
            raise unknown_name("family of figures", name.partition(".")[0], FAMILIES, "figures.keep")


def matching(names: Sequence[str], known: Sequence[KeptFigure]) -> tuple[KeptFigure, ...]:
    """The known figures that names (with `*`) ask for, in the order of `names`. InputError where one asks for none."""
    picked: dict[str, KeptFigure] = {}
    for name in names:
        found = [figure for figure in known if fnmatchcase(figure.name, name)]
        if not found:
            raise unknown_name("figure of merit", name, [figure.name for figure in known], "figures.keep")
        picked |= {figure.name: figure for figure in found}
    return tuple(picked.values())
