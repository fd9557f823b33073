"""A plan: which tests to run on a bench, and what they will show, before anything is measured."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from valvesim.diagnosis.experiments import Experiment
from valvesim.errors import InputError
from valvesim.io import write_atomically
from valvesim.planning.bench import BenchPlan
from valvesim.planning.options import DEFAULT_PLANNING, PlanningOptions
from valvesim.planning.outlook import Outlook, cause_groups, outlook, sought_causes
from valvesim.planning.plan_toml import load_plan
from valvesim.planning.selection import Goal, Selection, SensorAdvice, select_tests
from valvesim.planning.sensitivities import PlannedSensitivities, planned_sensitivities
from valvesim.planning.structure import isolability, structural_model


@dataclass(frozen=True, kw_only=True, eq=False)
class PlannedTest:
    """A test of the plan: how often it is run, and for how long in all, with what comes before each run, s."""

    experiment: Experiment
    repeats: int
    duration: float


@dataclass(frozen=True, kw_only=True, eq=False)
class Plan:
    """What to run and what it will show.

    `tests` are the chosen ones; `outlook` is what they show on the sensors of the bench, `with_added` what all tests do
    with the advised sensors beside them (None where none is advised). `structural` (k, k) is True where the equations'
    structure lets cause k of the outlook (row) be told from another (column), and on the diagonal be detected.
    `validation` is a further test to hold out, None where the bench can do no other. `notes` say what was left out.
    """

    bench: BenchPlan
    planned: PlannedSensitivities
    selection: Selection
    tests: tuple[PlannedTest, ...]
    outlook: Outlook
    with_added: Outlook | None
    structural: np.ndarray
    validation: Experiment | None
    notes: tuple[str, ...]

    def to_json(self, path: str | Path) -> Path:
        """Write all figures as JSON, SI. Returns the path."""
        text = json.dumps(_plain(self), indent=1, allow_nan=False)
        return write_atomically(Path(path), lambda own: _write(own, text))


def plan_tests(
    bench: BenchPlan | str | Path,
    *,
    progress: Callable[[str, float], None] | None = None,
    options: PlanningOptions = DEFAULT_PLANNING,
) -> Plan:
    """Plan the tests of a bench, or of a plan file. `progress(stage, share)` is called with what is being done.

    Raises InputError for a plan that makes no sense, and where none of its tests can be run.
    """
    tell = progress or (lambda stage, share: None)
    bench = bench if isinstance(bench, BenchPlan) else load_plan(bench, options=options)
    planned = planned_sensitivities(
        bench, lambda share: tell("linearising the tests", 0.5 * share), options=options.diagnosis
    )  # fmt: skip
    if not sought_causes(planned, bench.aim):
        raise InputError("none of these causes shows on the bench's drive and sensors", key="aim.causes")
    selection = select_tests(
        bench, planned, lambda share: tell("choosing the tests", 0.5 + 0.4 * share), options=options
    )
    tell("telling what they show", 0.9)
    channels = tuple(sensor.channel for sensor in bench.sensors)
    seed = bench.session.seed
    chosen = outlook(planned, bench.aim, selection.repeats, channels, options=options, seed=seed)
    with_added = None
    if selection.added is not None:
        every = [options.diagnosis.design.replicates[-1]] * len(planned.experiments)
        more = (*channels, *selection.added.channels)
        with_added = outlook(planned, bench.aim, every, more, options=options, seed=seed)
    tests = tuple(
        PlannedTest(experiment=one, repeats=n, duration=n * (float(one.time[-1]) + bench.setup))
        for one, n in zip(planned.experiments, selection.repeats, strict=True) if n
    )  # fmt: skip
    others = [one for one, n in zip(planned.experiments, selection.repeats, strict=True) if not n]
    return Plan(
        bench=bench, planned=planned, selection=selection, tests=tests, outlook=chosen, with_added=with_added,
        structural=_structural(bench, planned, channels, tuple(cause.label for cause in chosen.causes),
                               options=options),
        validation=min(others, key=lambda one: float(one.time[-1]), default=None),
        notes=tuple(f"left out, for it cannot be run: {one}" for one in planned.left_out),
    )  # fmt: skip


def _structural(
    bench: BenchPlan, planned: PlannedSensitivities, channels: tuple[str, ...], labels: tuple[str, ...], *,
    options: PlanningOptions,
) -> np.ndarray:
    """Structural detectability (diagonal) and isolability (k, k) of the causes."""
    groups = cause_groups(planned.candidates)
    effects = {label: planned.candidates[groups[label][0]].effect for label in labels}
    known = {label: effect for label, effect in effects.items() if effect is not None}
    model = structural_model(bench.session.valve, channels, known, options=options.structure)
    names, found = isolability(model)
    place = {name: k for k, name in enumerate(names)}
    return np.array([
        [bool(found[place[a], place[b]]) if a in place and b in place else False for b in labels] for a in labels
    ]).reshape(len(labels), len(labels))  # fmt: skip


def goal_text(goal: Goal) -> str:
    """A goal in words."""
    if goal.kind == "isolate":
        return f"tell {goal.of} from {goal.rival}"
    return f"{goal.kind} {goal.of}"


def _plain(plan: Plan) -> dict[str, Any]:
    def shown(one: Outlook) -> dict[str, Any]:
        powers = [[None if np.isnan(value) else float(value) for value in row] for row in one.powers]
        return {"alarm_level": one.level, "causes": [asdict(cause) for cause in one.causes], "isolability": powers,
                "parameters": [asdict(parameter) for parameter in one.parameters]}  # fmt: skip

    def advised(one: SensorAdvice) -> dict[str, Any]:
        return {"channels": list(one.channels), "cost": one.cost, "reached": [goal_text(g) for g in one.reached]}

    chosen = plan.selection
    return {
        "title": plan.bench.session.title,
        "tests": [{"name": t.experiment.description, "repeats": t.repeats, "duration": t.duration} for t in plan.tests],
        "validation": plan.validation.description if plan.validation is not None else None,
        "duration": chosen.duration,
        "reached": [goal_text(goal) for goal in chosen.reached],
        "missed": [goal_text(goal) for goal in chosen.missed],
        "sensors": [sensor.channel for sensor in plan.bench.sensors],
        "advice": [advised(one) for one in chosen.advice],
        "added": advised(chosen.added) if chosen.added is not None else None,
        "outlook": shown(plan.outlook),
        "with_added": shown(plan.with_added) if plan.with_added is not None else None,
        "structural": plan.structural.tolist(),
        "notes": list(plan.notes),
    }  # fmt: skip


def _write(path: Path, text: str) -> None:
    path.write_text(text + "\n", encoding="utf-8")
