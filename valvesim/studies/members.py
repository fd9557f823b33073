"""The members of a study run: those that differ in figures of the equations alone as one batch, each reduced at once.

Coefficients of some members are computed, used and dropped; of a run nothing stays but the figures of merit, the counts
of the percentiles, and the channels of the few that are kept whole. A member that fails is a row with its reason.
"""

from __future__ import annotations

import contextlib
import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np

from valvesim.characterisation.figure_of_merit import Absent, FigureOfMerit, FiguresOfMerit
from valvesim.characterisation.position_loop import (
    LoopProblem,
    PositionLoop,
    integrate_loops,
    loop_values,
    prepare_loop,
)
from valvesim.errors import SolveError, ValidityWarning, ValvesimError, forget_warnings, one_line
from valvesim.simulation.batch import KNOT_BYTES
from valvesim.simulation.run import Problem, channel_values, integrate_batch, prepare
from valvesim.studies.channel_histogram import BINS, Reference, count, reference_of
from valvesim.studies.distributions import OptionChoice
from valvesim.studies.figures import (
    DRIFT_FIGURES,
    REDUCTIONS,
    KeptFigure,
    bench_figures,
    matching,
    own_figures,
    response_figures,
    run_figures,
    static_drifts,
    tests_of,
)
from valvesim.studies.parameter_study import ChannelPercentiles, ParameterStudy
from valvesim.studies.variables import Case, Varied, apply, scenario_of

MOST_IN_BATCH = 1000
LONGEST_REASON = 200  # characters
FAILURES = (ValvesimError, ArithmeticError, np.linalg.LinAlgError)
"""What may go wrong with one member without anything being wrong with the study."""


Channels = dict[str, np.ndarray]
"""Channels (n_t,) of a run by name."""


class Runs(Protocol):
    """A batch that is ready to run."""

    @property
    def times(self) -> np.ndarray:
        """Output times (n_t,)."""
        ...

    def each(self, members: Sequence[int], names: Callable[[int], Sequence[str]]) -> Iterator[Channels | SolveError]:
        """Channels (n_t,) by name of each member's run, those of `names` at least, or why it fails."""
        ...


@dataclass(frozen=True)
class ScenarioRuns:
    """Runs of a scenario for a batch of valves."""

    problem: Problem

    @property
    def times(self) -> np.ndarray:
        """Output times (n_t,)."""
        return self.problem.times

    def each(self, members: Sequence[int], names: Callable[[int], Sequence[str]]) -> Iterator[Channels | SolveError]:
        """See `Runs`; signals are computed where one is asked for, or a sensor has an effect."""
        scenario = self.problem.scenario
        own = {channel.name: k for k, channel in enumerate(scenario.model.state_channels)}
        read = any(active.effect.reading for active in scenario.effects)
        for member, states in zip(members, integrate_batch(self.problem, members), strict=True):
            asked = names(member)
            if isinstance(states, SolveError):
                yield states
            elif read or any(name not in own for name in asked):
                yield channel_values(self.problem, states, member)
            else:
                yield {name: states[:, own[name]] for name in asked}


@dataclass(frozen=True)
class LoopRuns:
    """Runs of a position loop for a batch of valves and actuators."""

    problem: LoopProblem

    @property
    def times(self) -> np.ndarray:
        """Output times (n_t,)."""
        return self.problem.times

    def each(self, members: Sequence[int], names: Callable[[int], Sequence[str]]) -> Iterator[Channels | SolveError]:
        """See `Runs`; the signals of a loop are few and always there."""
        for member, states in zip(members, integrate_loops(self.problem, members), strict=True):
            yield states if isinstance(states, SolveError) else loop_values(self.problem, states, member)


def prepared(case: Case, knot_times: np.ndarray | None = None) -> Runs:
    """The runs of a case. Raises as `simulate` and `prepare_loop` do."""
    if isinstance(case, PositionLoop):
        return LoopRuns(prepare_loop(case, knot_times=knot_times))
    return ScenarioRuns(prepare(case, knot_times=knot_times))


@dataclass(frozen=True)
class StudyPlan:
    """What all blocks share, made once from the nominal member: the figures that are kept with their nominal values.

    `knot_times` (m,) are those of the temperatures of every member, None where each has its own; `samples` (n_t,) are
    the output samples of the percentiles, which count from `reference`.
    """

    figures: tuple[KeptFigure, ...]
    nominal: np.ndarray
    bench: tuple[str, ...]
    response: tuple[str, ...]
    times: np.ndarray
    knot_times: np.ndarray | None = None
    samples: np.ndarray = field(default_factory=lambda: np.zeros(0, dtype=int))
    reference: Reference | None = None


@dataclass(frozen=True)
class BlockResult:
    """What is kept of the members of one block, numbered from `first` on.

    `figures` (k, n_figures), NaN where there is none; `reasons` why, "" where there are all; `counts` (channels, n_t,
    bins) with `lowest` and `highest` (channels, n_t), and `whole` channels by member's number; `warnings` once each.
    """

    number: int
    first: int
    figures: np.ndarray
    reasons: tuple[str, ...]
    counts: np.ndarray
    lowest: np.ndarray
    highest: np.ndarray
    whole: dict[int, np.ndarray]
    warnings: tuple[str, ...]


def make_plan(study: ParameterStudy) -> StudyPlan:
    """The plan of a study. InputError for a figure that no member has; raises too where the nominal member fails."""
    case, scenario = study.case, scenario_of(study.case)
    families = {name.partition(".")[0] for name in study.keep}
    bench, response = tests_of("bench", study.keep), tests_of("response", study.keep)
    times, knot_times, reference, samples = np.zeros(0), None, None, np.zeros(0, dtype=int)
    known: list[KeptFigure] = []
    values: dict[str, float] = {}
    if "run" in families or study.percentiles is not None or study.whole is not None:
        runs: Any = prepared(case)
        times = runs.times
        knot_times = _common_knots(study, runs.problem.path.times)
        known += run_figures(study.channels)
        channels = nominal_channels(study, runs)
        values |= _reduced(channels, [figure.name for figure in known], times, study.options.start)
        if study.percentiles is not None:
            scale = {channel.name: channel.scale for channel in study.channels}
            samples = _samples(times, study.percentiles)
            rows = np.array([channels[name][samples] for name in study.percentiles.channels])
            reference = reference_of(rows, np.array([scale[name] for name in study.percentiles.channels]))
    if "drift" in families:
        known += DRIFT_FIGURES
        values |= {name: float(v) for name, v in static_drifts(scenario, [f.name for f in DRIFT_FIGURES]).items()}
    for figure in _single_figures(study, case, bench, response):
        known.append(KeptFigure(figure.name, getattr(figure, "unit", ""), getattr(figure, "doc", "")))
        values[figure.name] = figure.value if isinstance(figure, FigureOfMerit) else np.nan
    figures = matching(study.keep, known)
    nominal = np.array([values[figure.name] for figure in figures])
    return StudyPlan(figures, nominal, bench, response, times, knot_times, samples, reference)


def _common_knots(study: ParameterStudy, times: np.ndarray) -> np.ndarray | None:
    """The knots (m,) of the nominal temperatures where they will do for every member, else None.

    They will not where what drives the temperatures varies, nor where nothing but a member's own figures may move them.
    """
    effects = {a.effect.name for a in scenario_of(study.case).effects if a.effect.temperatures}
    driven = any(
        key.startswith("thermal") or key.split(".")[1:2] and key.split(".")[1] in effects for key in study.keys
    )
    still = len(times) == 1 and scenario_of(study.case).thermal.network is not None
    return None if driven or still else times


def nominal_channels(study: ParameterStudy, runs: Runs) -> Channels:
    """All channels of the one member of a case that has run. Raises SolveError."""
    names = [channel.name for channel in study.channels]
    (channels,) = runs.each([0], lambda member: names)
    if isinstance(channels, SolveError):
        raise channels
    return channels


def _samples(times: np.ndarray, asked: ChannelPercentiles) -> np.ndarray:
    """Places of the output times (n_t,) of percentiles, as even as the samples are."""
    first = int(np.searchsorted(times, asked.start * (1.0 - 1e-12)))
    last = int(np.searchsorted(times, asked.end * (1.0 + 1e-12), side="right")) - 1
    return np.unique(np.linspace(min(first, last), last, asked.points).astype(int))


def run_block(study: ParameterStudy, plan: StudyPlan, number: int, draws: np.ndarray) -> BlockResult:
    """Run the members of a block, whose draws (k, variables) are given. Members that fail are rows with a reason."""
    first, members = number * study.block_size, len(draws)
    channels = study.percentiles.channels if study.percentiles is not None else ()
    shape = (len(channels), len(plan.samples))
    out = BlockResult(
        number, first, np.full((members, len(plan.figures)), np.nan), (), np.zeros((*shape, BINS), dtype=np.uint32),
        np.full(shape, np.inf), np.full(shape, -np.inf), {}, (),
    )  # fmt: skip
    reasons = [""] * members
    with validity_warnings() as told:
        for rows in _batches(study, plan, draws):
            _run_batch(study, plan, draws, rows, out, reasons)
        if plan.bench or plan.response or study.options.functions:
            for k in range(members):
                _run_single(study, plan, draws[k], k, out, reasons)
    cut = tuple(one_line(reason)[:LONGEST_REASON] for reason in reasons)
    return BlockResult(
        number, first, out.figures, cut, out.counts, out.lowest, out.highest, out.whole, tuple(told)
    )  # fmt: skip


@contextlib.contextmanager
def validity_warnings() -> Iterator[list[str]]:
    """The validity warnings given inside, once each, in a list in place of being shown; other warnings are ignored."""
    told: list[str] = []
    forget_warnings()
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("ignore")
        warnings.simplefilter("always", ValidityWarning)
        yield told
        told += dict.fromkeys(str(one.message) for one in caught if issubclass(one.category, ValidityWarning))


def _batches(study: ParameterStudy, plan: StudyPlan, draws: np.ndarray) -> Iterator[np.ndarray]:
    """Places (k,) of members that differ in nothing but figures of the equations, some at a time."""
    apart = [k for k, variable in enumerate(study.variables) if not _in_batch(study.case, variable)]
    names = len(scenario_of(study.case).model.coefficient_names)
    knots = 1 if plan.knot_times is None else len(plan.knot_times)
    size = int(np.clip(KNOT_BYTES / (8.0 * names * knots), 1, MOST_IN_BATCH))
    _, group = np.unique(draws[:, apart], axis=0, return_inverse=True) if apart else (0, np.zeros(len(draws), int))
    order = np.argsort(group, kind="stable")
    for rows in np.split(order, np.flatnonzero(np.diff(group[order])) + 1):
        for start in range(0, len(rows), size):
            yield rows[start : start + size]


def _in_batch(case: Case, variable: Varied) -> bool:
    """Whether members that differ in it run as one batch."""
    section, _, rest = variable.key.partition(".")
    if isinstance(variable.distribution, OptionChoice) or not variable.quantity.in_batch:
        return False
    if section != "effects":
        return True
    name = rest.partition(".")[0]
    return not any(a.effect.name == name and a.effect.temperatures for a in scenario_of(case).effects)


def _case_of(study: ParameterStudy, draws: np.ndarray, rows: np.ndarray) -> Case:
    """The case of a batch; of one member with plain numbers."""
    values = study.values(draws[rows[0]])
    if len(rows) > 1:
        for k, variable in enumerate(study.variables):
            if _in_batch(study.case, variable):
                values[variable.key] = draws[rows, k]
    return apply(study.case, values)


@dataclass(frozen=True)
class _Ready:
    """A batch that is ready to run, if anything of a run is kept, and its drifts by figure."""

    runs: Runs | None
    drifts: dict[str, np.ndarray]


def _prepare_batch(study: ParameterStudy, plan: StudyPlan, draws: np.ndarray, rows: np.ndarray) -> _Ready:
    """The batch of some members. Raises one of `FAILURES` where a member cannot be prepared."""
    case, names = _case_of(study, draws, rows), [figure.name for figure in plan.figures]
    simulated = any(name.startswith("run.") for name in names) or study.percentiles or study.whole
    runs = prepared(case, plan.knot_times) if simulated else None
    drifts = [name for name in names if name.startswith("drift.")]
    return _Ready(runs, static_drifts(scenario_of(case), drifts) if drifts else {})


def _ready(
    study: ParameterStudy, plan: StudyPlan, draws: np.ndarray, rows: np.ndarray, reasons: list[str]
) -> tuple[_Ready | None, np.ndarray]:
    """(the batch, its members): halved until those that cannot be prepared are found, then the rest as one."""
    try:
        return _prepare_batch(study, plan, draws, rows), rows
    except FAILURES as error:
        if len(rows) == 1:
            reasons[rows[0]] = str(error)
            return None, rows[:0]
    good = np.concatenate([_ready(study, plan, draws, half, reasons)[1] for half in np.array_split(rows, 2)])
    return (_prepare_batch(study, plan, draws, good), good) if len(good) else (None, good)


def _run_batch(
    study: ParameterStudy, plan: StudyPlan, draws: np.ndarray, rows: np.ndarray, out: BlockResult, reasons: list[str]
) -> None:  # fmt: skip
    """Runs and drifts of a batch into `out`, without the members that cannot be prepared."""
    places = {figure.name: k for k, figure in enumerate(plan.figures)}
    ready, rows = _ready(study, plan, draws, rows, reasons)
    if ready is None:
        return
    for name, values in ready.drifts.items():
        out.figures[rows, places[name]] = values
    runs = ready.runs
    if runs is None:
        return
    percentiles = study.percentiles.channels if study.percentiles is not None else ()
    whole = study.whole.channels if study.whole is not None else ()
    kept = set(study.whole.members) if study.whole is not None else set()
    reduced = [name for name in places if name.startswith("run.")]
    names = list(dict.fromkeys([name.split(".")[1] for name in reduced] + list(percentiles)))

    def asked(k: int) -> list[str]:
        return [*names, *whole] if out.first + int(rows[k]) in kept else names

    for k, channels in enumerate(runs.each(range(len(rows)), asked)):
        row = rows[k]
        if isinstance(channels, SolveError):
            reasons[row] = str(channels).replace(f" of member {k}", "")
            continue
        for name, value in _reduced(channels, reduced, runs.times, study.options.start).items():
            out.figures[row, places[name]] = value
        if plan.reference is not None:
            sampled = np.array([channels[name][plan.samples] for name in percentiles])
            count(out.counts, plan.reference, sampled)
            np.fmin(out.lowest, sampled, out=out.lowest)
            np.fmax(out.highest, sampled, out=out.highest)
        if out.first + int(row) in kept:
            out.whole[out.first + int(row)] = np.array([channels[name] for name in whole])


def _reduced(values: dict[str, np.ndarray], names: Sequence[str], times: np.ndarray, start: float) -> dict[str, float]:
    """Figures by their names `run.CHANNEL.REDUCTION`, from `start` s on."""
    since = int(np.searchsorted(times, start * (1.0 - 1e-12)))
    figures = {}
    for name in names:
        _, channel, reduction = name.split(".")
        figures[name] = REDUCTIONS[reduction][1](values[channel][since:])
    return figures


def _run_single(
    study: ParameterStudy, plan: StudyPlan, draw: np.ndarray, row: int, out: BlockResult, reasons: list[str]
) -> None:  # fmt: skip
    """Bench and response of one member into `out`."""
    places = {figure.name: k for k, figure in enumerate(plan.figures)}
    try:
        figures = _single_figures(study, study.member(draw), plan.bench, plan.response)
    except FAILURES as error:
        reasons[row] = reasons[row] or str(error)
        return
    for figure in figures:
        if figure.name not in places:
            continue
        if isinstance(figure, Absent):
            reasons[row] = reasons[row] or f"{figure.name}: {figure.reason}"
        else:
            out.figures[row, places[figure.name]] = figure.value


def _single_figures(study: ParameterStudy, case: Case, bench: Sequence[str], response: Sequence[str]) -> FiguresOfMerit:
    """The figures of merit of acceptance tests and responses of one member."""
    scenario, at = scenario_of(case), study.options
    figures: FiguresOfMerit = ()
    if bench:
        figures += bench_figures(scenario, bench, temperature=at.bench_temperature, points=at.bench_points)
    if response:
        figures += response_figures(scenario, response)
    return figures + own_figures(case, at.functions)
