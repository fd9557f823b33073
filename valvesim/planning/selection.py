"""The shortest list of tests that reaches an aim, and the cheapest sensor that brings it within reach."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import combinations, product

import numpy as np

from valvesim.identification.projection import inverse_of, project
from valvesim.planning.bench import AddedSensor, BenchPlan
from valvesim.planning.options import DEFAULT_PLANNING, PlanningOptions
from valvesim.planning.outlook import CandidateScores, cause_groups, cause_size, level_of, sought_causes
from valvesim.planning.sensitivities import PlannedSensitivities


@dataclass(frozen=True, kw_only=True)
class Goal:
    """One thing that is asked: `kind` is "detect", "isolate" or "know", `of` the cause or parameter, `rival` the other
    cause of an isolation."""

    kind: str
    of: str
    rival: str = ""


@dataclass(frozen=True, kw_only=True)
class SensorAdvice:
    """What added sensors would bring together: the goals that all tests then reach and did not before, and the cost."""

    channels: tuple[str, ...]
    cost: float
    reached: tuple[Goal, ...]


@dataclass(frozen=True, kw_only=True)
class Selection:
    """The chosen tests: `repeats[k]` of test k; goals `reached` and `missed`; `duration` s with what comes before each.

    `advice` are single added sensors, the one that brings the most for its cost first; `added` the cheapest sensors
    that together bring all that any do, None where none does or none is needed.
    """

    repeats: tuple[int, ...]
    reached: tuple[Goal, ...]
    missed: tuple[Goal, ...]
    duration: float
    advice: tuple[SensorAdvice, ...]
    added: SensorAdvice | None


class Chooser:
    """Which goals a choice of repeats and channels reaches, by the formulas of `outlook`."""

    def __init__(self, plan: BenchPlan, planned: PlannedSensitivities, options: PlanningOptions):
        self.plan, self.planned, self.options = plan, planned, options
        self.groups = cause_groups(planned.candidates)
        self.sought = sought_causes(planned, plan.aim)
        self.durations = np.array([float(e.time[-1]) + plan.setup for e in planned.experiments])
        everything = [1] * len(planned.experiments)
        scores = project(planned.gram(everything, self.channels()), 0, len(planned.candidates))
        self.level = level_of(planned, scores, options=options.diagnosis, seed=plan.session.seed)
        self.names = [p.name for p in planned.nominal.parameters]

    def channels(self, *more: str) -> tuple[str, ...]:
        """The channels of the bench, and these."""
        return (*(sensor.channel for sensor in self.plan.sensors), *more)

    def goals(self) -> list[Goal]:
        """All that the aim asks."""
        aim = self.plan.aim
        goals = [Goal(kind="detect", of=label) for label in self.sought]
        if aim.isolate:
            goals += [Goal(kind="isolate", of=a, rival=b) for a, b in product(self.sought, self.sought) if a != b]
        return [*goals, *(Goal(kind="know", of=name) for name in aim.parameters)]

    def reached(self, repeats: Sequence[int], channels: Sequence[str]) -> frozenset[Goal]:
        """The goals that a choice reaches."""
        gram = self.planned.gram(repeats, channels)
        scores = project(gram, 0, len(self.planned.candidates))
        judged = CandidateScores(self.planned, scores, self.level, self.options)
        found = set()
        for label in self.sought:
            k = min(self.groups[label], key=judged.limit)
            size = cause_size(self.planned.candidates[k], self.plan.aim)
            if judged.power(k, size) < self.options.choice.power:
                continue
            found.add(Goal(kind="detect", of=label))
            for other in self.sought if self.plan.aim.isolate else ():
                if other != label and not judged.separation(k, self.groups[other], size) < self.options.choice.power:
                    found.add(Goal(kind="isolate", of=label, rival=other))
        if self.plan.aim.parameters:
            p = gram.parameters
            covariance = inverse_of(gram.total[1 : 1 + p, 1 : 1 + p] + np.eye(p))
            for name, asked in self.plan.aim.parameters.items():
                if name in self.names:
                    k = self.names.index(name)
                    own = float(np.sqrt(covariance[k, k])) * self.planned.nominal.parameters[k].deviation
                    if own <= asked:
                        found.add(Goal(kind="know", of=name))
        return frozenset(found)

    def shortest(self, channels: Sequence[str], progress: Callable[[float], None]) -> tuple[int, ...]:
        """The repeats of each test that reach all that can be reached in the shortest time."""
        count = len(self.durations)
        most = self.options.diagnosis.design.replicates
        attainable = self.reached([most[-1]] * count, channels)
        times = next(n for n in most if n == most[-1] or self.reached([n] * count, channels) >= attainable)
        if not attainable:
            return (0,) * count
        if count <= self.options.choice.exhaustive:
            repeats = self._shortest_subset(times, attainable, channels, progress)
        else:
            repeats = [times] * count
        return tuple(self._trimmed(repeats, attainable, channels))

    def _shortest_subset(
        self, times: int, attainable: frozenset[Goal], channels: Sequence[str], progress: Callable[[float], None]
    ) -> list[int]:
        count = len(self.durations)
        subsets = sorted(product((0, times), repeat=count), key=lambda one: float(np.dot(one, self.durations)))
        needed = [k for k in range(count)
                  if not self.reached([times * (j != k) for j in range(count)], channels) >= attainable]  # fmt: skip
        subsets = [one for one in subsets if all(one[k] for k in needed)]
        for number, one in enumerate(subsets):
            if number % 20 == 0:
                progress(number / len(subsets))
            if any(one) and self.reached(one, channels) >= attainable:
                return list(one)
        return [times] * count

    def _trimmed(self, repeats: list[int], attainable: frozenset[Goal], channels: Sequence[str]) -> list[int]:
        """The repeats without what is not needed, longest tests first."""
        for k in np.argsort(-self.durations * np.array(repeats)):
            for fewer in (0, *(n for n in self.options.diagnosis.design.replicates if n < repeats[k])):
                less = [fewer if j == k else n for j, n in enumerate(repeats)]
                if fewer < repeats[k] and any(less) and self.reached(less, channels) >= attainable:
                    repeats = less
                    break
        return repeats


def select_tests(
    plan: BenchPlan,
    planned: PlannedSensitivities,
    progress: Callable[[float], None] = lambda share: None,
    *,
    options: PlanningOptions = DEFAULT_PLANNING,
) -> Selection:
    """The shortest list of tests, and what added sensors would bring."""
    chooser = Chooser(plan, planned, options)
    channels = chooser.channels()
    repeats = chooser.shortest(channels, progress)
    reached = chooser.reached(repeats, channels)
    goals = chooser.goals()
    missed = [goal for goal in goals if goal not in reached]
    advice = []
    if missed:
        every = [options.diagnosis.design.replicates[-1]] * len(repeats)

        def brings(sensors: Sequence[AddedSensor]) -> SensorAdvice:
            names = tuple(one.sensor.channel for one in sensors)
            found = chooser.reached(every, chooser.channels(*names))
            new = tuple(goal for goal in missed if goal in found)
            return SensorAdvice(channels=names, cost=sum(one.cost for one in sensors), reached=new)

        advice = [brings((one,)) for one in plan.added]
        added = _cheapest(plan.added, advice, brings)
    advice.sort(key=lambda one: (-len(one.reached) / one.cost, one.cost))
    return Selection(
        repeats=tuple(int(n) for n in repeats),
        reached=tuple(goal for goal in goals if goal in reached),
        missed=tuple(missed),
        duration=float(np.dot(repeats, chooser.durations)),
        advice=tuple(advice),
        added=added if missed else None,
    )


def _cheapest(
    sensors: Sequence[AddedSensor], single: Sequence[SensorAdvice], brings: Callable[..., SensorAdvice]
) -> SensorAdvice | None:
    """The cheapest sensors that together bring all that any do; None where none brings anything."""
    most = brings(sensors).reached if sensors else ()
    if not most:
        return None
    for one in sorted(single, key=lambda one: one.cost):
        if len(one.reached) == len(most):
            return one
    subsets = [some for count in range(2, len(sensors) + 1) for some in combinations(sensors, count)]
    for some in sorted(subsets, key=lambda some: sum(one.cost for one in some)):
        found = brings(some)
        if len(found.reached) == len(most):
            return found
    return None
