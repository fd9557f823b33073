"""The full suite of hidden effects: what valvesim's diagnosis finds in sessions of a plant that is not its model.

    .venv/bin/python benchmarks/hidden_effects.py run --workers 2  # the same again after a break: it goes on
    .venv/bin/python benchmarks/hidden_effects.py report           # docs/hidden_effects.md from what there is
    .venv/bin/python benchmarks/hidden_effects.py run --results new.jsonl  # another engine at the strengths of the old
    .venv/bin/python benchmarks/hidden_effects.py beside --results new.jsonl  # what pairs show each, worked out anew

A case is drawn by tests/hidden_plant.py, its strength tuned to a distance d', its session written to a folder, and
diagnosed from that folder alone. Each case adds one line of JSON to the results. The table has seeds of its own
(TABLE_SEEDS); while the diagnosis is being worked on, --seed-offset 10000 draws others.

Symbols
    y readings, r whitened by the true noise; dy what is hidden adds to them; J answers to the base parameters
    d'^2 = dy'dy - dy'J (J'J + I)^-1 J'dy: what the base parameters, held by their priors, cannot take up;
    where they take up nearly all, from the point that they reach, less what even the true cause leaves
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import sys
import tempfile
import time
import traceback
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from contextlib import ExitStack, contextmanager
from dataclasses import asdict, dataclass, field, fields, replace
from multiprocessing import get_context
from pathlib import Path
from typing import Any
from unittest.mock import patch
from zlib import crc32

ROOT = Path(__file__).resolve().parent.parent
for threads in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):  # before numpy: a worker is one core
    os.environ.setdefault(threads, "1")
sys.path.insert(0, str(ROOT / "tests"))

import hidden_plant  # noqa: E402
import numpy as np  # noqa: E402
from hidden_baselines import baselines  # noqa: E402
from hidden_plant import (  # noqa: E402
    DRAWN,
    EFFECTS,
    OUTSIDE,
    PARAMETERS,
    SENSOR_FAULTS,
    Case,
    Run,
    draw,
    responses,
    write_session,
)
from hidden_report import SHOWS, TABLE_SEEDS, write_report  # noqa: E402

import valvesim as vs  # noqa: E402
from valvesim.diagnosis import coarse_to_fine as leading_segments  # noqa: E402
from valvesim.diagnosis import diagnose as engine  # noqa: E402
from valvesim.diagnosis import isolation, refits, second_cause  # noqa: E402
from valvesim.diagnosis.result import Diagnosis, NextTest, Term, plain_json  # noqa: E402
from valvesim.diagnosis.score_test import ScoreTest, score_test  # noqa: E402
from valvesim.identification.candidates import Candidate  # noqa: E402
from valvesim.identification.fit import Fit, FittedCandidate, evaluate_fit  # noqa: E402
from valvesim.identification.fit_jacobian import linearise_study  # noqa: E402
from valvesim.identification.hypothesis_fit import continue_from, fit_from_prior, fit_hypothesis  # noqa: E402
from valvesim.identification.linearised_record import LinearisedRecord  # noqa: E402
from valvesim.identification.noise_model import NoiseModel  # noqa: E402
from valvesim.identification.nominal_fit import NominalFit, fit_nominal, fit_nominal_from  # noqa: E402
from valvesim.identification.options import DEFAULT_IDENTIFICATION  # noqa: E402
from valvesim.identification.predictor import prepare_record  # noqa: E402
from valvesim.identification.session import Session  # noqa: E402
from valvesim.identification.session_toml import load_session  # noqa: E402
from valvesim.identification.study import Study, prepare_session  # noqa: E402
from valvesim.simulation.batch import cores  # noqa: E402
from valvesim.units import quantities  # noqa: E402
from valvesim.valve.catalogue import CATALOGUE  # noqa: E402

RESULTS = ROOT / "benchmarks" / "results" / "hidden_effects.jsonl"
DOCUMENT = ROOT / "docs" / "hidden_effects.md"
PLANT = f"{crc32(Path(hidden_plant.__file__).read_bytes()):08x}"
KINDS = hidden_plant.KINDS

TARGETS = (5.0, 8.0, 15.0, 40.0)
PARAMETER_TARGETS = (8.0, 15.0, 40.0, 15.0)
OUTSIDE_TARGETS = (8.0, 15.0, 40.0, 40.0)
PAIR_TARGET = 20.0  # d' of both together
NONE_CASES, PAIR_CASES, POOR_CASES = 200, 50, 32
ORACLE_LOOKS = 1
MOST_CONTINUED, NO_GAIN = 6, 0.5  # times that a fit of the ruler is continued, and the chi-square that ends it
STRONGEST = 20.0  # times the strength as drawn
MOST_OFFSET = 0.35  # of a parameter, relative: beyond it is another valve
INSIDE = 0.95  # share of the catalogue's bounds that a hidden amplitude keeps to
CLOSE = 0.15  # relative miss of d' after which the strength is tuned once more
TRIALS = 5
STRANGE = 3.0  # times the target
SHARED = 0.6  # of what a base parameter costs alone where others help to take its place: where tuning starts
RULER_STEPS, LONGEST_STEP, UNMOVED = 3, 6.0, 0.1  # of the base parameters, in prior deviations
FALLEN = 0.8  # of d'^2 from one step to the next: then it has settled
TAKEN_UP = 6.0  # times what is left: where they take up more, the linear equations are not trusted
LONGEST_DIAGNOSIS = 240.0  # s of the processor, of the diagnosis after a next test
BASELINE_EVERY = 8  # cases: the baselines refit a dozen candidates


def _one_side(
    diameter: str, difference: str, share: Callable[[dict[str, Any]], float]
) -> dict[str, Callable[[Any, dict[str, Any]], float]]:
    """The mean of both diameters and their difference where that on one side is larger by a share."""
    return {
        diameter: lambda valve, p: getattr(valve, diameter) * (1.0 + share(p) / 2.0),
        difference: lambda valve, p: getattr(valve, diameter) * share(p) * (1.0 if p["side"] == 1.0 else -1.0),
    }


TWINS: dict[str, dict[str, Callable[[Any, dict[str, Any]], float]]] = {
    "magnet_demagnetization": {"polarization_mmf": lambda valve, p: valve.polarization_mmf * (1.0 - p["loss"])},
    "coil_turns_loss": {"coil_turns": lambda valve, p: valve.coil_turns * (1.0 - p["loss"])},
    "flexure_stiffness_loss": {"spring_tube_stiffness": lambda valve, p: valve.spring_tube_stiffness * (1 - p["loss"])},
    "fixed_orifice_clogging": _one_side(
        "fixed_orifice_diameter", "fixed_orifice_difference", lambda p: np.sqrt(1.0 - p["clogged_share"]) - 1.0
    ),
    "nozzle_erosion": _one_side(
        "nozzle_diameter", "nozzle_diameter_difference", lambda p: np.sqrt(1.0 + p["share"]) - 1.0
    ),
    "null_gap_asymmetry": {"null_gap_difference": lambda valve, p: valve.null_gap_difference + p["difference"]},
    "spool_edge_wear": {"null_opening": lambda valve, p: valve.null_opening + p["rounding"]},
    "spool_lap": {"land_overlap": lambda valve, p: valve.land_overlap + p["overlap"]},
    "coil_resistance_drift": {"coil_resistance": lambda valve, p: valve.coil_resistance * (1.0 + p["share"])},
    **{name: {name: lambda valve, p, name=name: getattr(valve, name) * (1.0 + p["offset"])} for name in PARAMETERS},
}
"""Hidden thing -> the base parameters that can take its place, and the values at which they do."""


# ---------------------------------------------------------------- the cases


@dataclass(frozen=True)
class Spec:
    """One case of the list: what is hidden (drawn where `name` is None), and the d' to tune it to (0: as drawn)."""

    kind: str
    name: str | None
    seed: int
    target: float = 0.0

    @property
    def key(self) -> str:
        """What tells it from all others."""
        return f"{self.kind} {self.name or '-'} {self.seed} {self.target:g}"


def cases(offset: int = TABLE_SEEDS) -> list[Spec]:
    """All cases, kinds interleaved, so that the first hundred are a small suite of their own."""

    def each(names: Sequence[str], repeats: int, targets: Sequence[float]) -> list[tuple[str, float]]:
        return [(n, targets[(r + k) % len(targets)]) for r in range(repeats) for k, n in enumerate(names)]

    lists: dict[str, list[tuple[str | None, float]]] = {
        "none": [(None, 0.0)] * NONE_CASES,
        "effect": [*each(DRAWN, 8, TARGETS)],
        "pair": [(None, PAIR_TARGET)] * PAIR_CASES,
        "outside": [*each(list(OUTSIDE), 4, OUTSIDE_TARGETS)],
        "parameter": [*each(PARAMETERS, 4, PARAMETER_TARGETS)],
        "sensor": [*each(list(SENSOR_FAULTS), 6, TARGETS)],
        "poor": [(None, 0.0)] * POOR_CASES,
    }
    placed = [
        ((at + 0.5) / len(members), kind, Spec(kind, name, offset + at, target))
        for kind, members in lists.items()
        for at, (name, target) in enumerate(members)
    ]
    return [spec for _, _, spec in sorted(placed, key=lambda each: each[:2])]


# ---------------------------------------------------------------- strength


Records = list[dict[str, np.ndarray]]
Row = dict[str, Any]


@dataclass(frozen=True)
class Tuned:
    """A case at its strength: `factors` on the amplitudes as drawn, `distance` its measured d', noise-free `records`.

    Of a pair `alone` are the d' of each, and `overlap` the cosine between what they show.
    """

    case: Case
    factors: tuple[float, ...]
    distance: float
    alone: tuple[float, ...]
    overlap: float
    records: Records


@dataclass(frozen=True)
class Ruler:
    """Measures d' in a case, about the very valve on its bench: there the base parameters start, with their priors.

    About the nominal valve the scatter alone would tilt J enough to pass 0.5 % of lost magnet for d' = 6.
    """

    study: Study
    quiet: Records
    at_rest: tuple[LinearisedRecord, ...]
    J: np.ndarray

    def change(self, case: Case, records: Records) -> np.ndarray:
        """Whitened dy (rows,) of the training records."""
        by_name = {run.name: k for k, run in enumerate(case.runs)}
        columns = []
        for predictor in self.study.predictors:
            k = by_name[predictor.record.name]
            columns.append({c: (records[k][c] - self.quiet[k][c])[:, None] for c in predictor.record.outputs})
        return self.study.stack(columns)[:, 0]

    def products(self, changes: np.ndarray) -> np.ndarray:
        """(k, k) products of changes (rows, k) off the base parameters, by the linear equations."""
        shadow = self.J.T @ changes
        return changes.T @ changes - shadow.T @ np.linalg.solve(self._H(self.J), shadow)

    def distance(self, case: Case, change: np.ndarray) -> float:
        """d' of a change (rows,): the least that the base parameters leave of it, moved and asked again if they must.

        The linear equations err by a few hundredths of what they take up, and by more at the leakage's peaks, which may
        be more than what is left: what a base parameter can stand for is first tried with that parameter in its place.
        """
        point = self.shift(case)
        left, J, least = change, self.J, np.inf
        for k in range(RULER_STEPS + 1):
            if np.any(point):
                try:
                    linearised, J = _linearised_at(self.study, point)
                except (vs.SolveError, vs.InputError):  # no such valve
                    if k:
                        break
                    point = np.zeros(len(point))
                else:
                    left = change - self.moved_candidates(linearised)
            gradient = J.T @ left - point
            step = np.linalg.solve(self._H(J), gradient)
            now = float(left @ left + point @ point)
            before, least = least, min(least, max(now - float(gradient @ step), 0.0))
            if least > FALLEN * before or np.max(np.abs(step)) < UNMOVED or now < TAKEN_UP**2 * least:
                break
            point = point + step * min(1.0, LONGEST_STEP / float(np.max(np.abs(step))))
        return float(np.sqrt(least))

    def settled(self, case: Case, records: Records) -> float:
        """The same by fitting the base to the noise-free records, as a diagnosis would.

        What even the true cause leaves, fitted likewise, is the plant's and not what is hidden: it does not count.
        """
        study = self._shown(case, records)
        starts = [np.zeros(self.J.shape[1]), *([equivalent] if np.any(equivalent := self.shift(case)) else [])]
        bases = [fit_nominal_from(study, evaluate_fit(study, point, ())) for point in starts]
        nominal = min(bases, key=lambda one: one.fit.chi_square)
        left = evaluate_fit(study, nominal.fit.point, ()).chi_square  # with all samples in full
        return float(np.sqrt(max(left - self._left_by_cause(case, study, nominal), 0.0)))

    def beside(self, case: Case, records: Records) -> tuple[float, ...]:
        """d' of each of what is hidden beside the others, by fits to the noise-free records, in which peaks count as in
        a diagnosis; () where the model lacks one of them.

        Fits are begun from within tolerance too, and from the very valve and where the pair ends, and continued there
        until they are at their ends: one without the other that stops short would have that show more.
        """
        study = self._shown(case, records)
        fitted = true_extras(case, study)
        if fitted is None:
            return ()
        origin = np.zeros(self.J.shape[1])
        nominal = fit_nominal_from(study, evaluate_fit(study, origin, ()))

        def left_by(some: tuple[FittedCandidate, ...], points: Sequence[np.ndarray]) -> tuple[float, np.ndarray]:
            ends = [fit_from_prior(nominal, some), *(_end_of_fit(nominal, point, some) for point in points)]
            begun = self._left_by(some, nominal.study, nominal)
            best = min((end for end in ends if end is not None), key=lambda end: end.chi_square, default=None)
            return (begun, origin) if best is None else (min(begun, best.chi_square), best.point)

        all_left, end = left_by(fitted, [origin])
        left = [left_by(tuple(one for one in fitted if one is not each), [origin, end])[0] for each in fitted]
        return tuple(float(np.sqrt(max(without - all_left, 0.0))) for without in left)

    def _shown(self, case: Case, records: Records) -> Study:
        """The study of noise-free records as the hidden changes those of the nominal valve."""
        by_name = {run.name: k for k, run in enumerate(case.runs)}
        predictors = []
        for predictor, rest in zip(self.study.predictors, self.at_rest, strict=True):
            k = by_name[predictor.record.name]
            shown = {c: rest.readings[c] + records[k][c] - self.quiet[k][c] for c in predictor.record.outputs}
            predictors.append(
                replace(predictor, record=replace(predictor.record, values={**predictor.record.values, **shown}))
            )
        return replace(self.study, predictors=tuple(predictors))

    def _left_by_cause(self, case: Case, study: Study, nominal: NominalFit) -> float:
        """The deviance that even the true cause leaves; zero where the model has none such, or none so strong."""
        fitted = true_extras(case, study)
        left = self._left_by(fitted, study, nominal) if fitted is not None else np.inf
        return left if np.isfinite(left) else 0.0

    def _left_by(self, fitted: tuple[FittedCandidate, ...], study: Study, nominal: NominalFit) -> float:
        """The least deviance that these leave, fitted from their true figures; inf where the model cannot follow."""
        least = np.inf
        for point in (np.zeros(self.J.shape[1]), nominal.fit.point):
            try:
                begun = evaluate_fit(study, point, fitted)
            except (vs.SolveError, vs.InputError):
                continue
            least = min(least, begun.chi_square)
            refitted = fit_hypothesis(nominal, fitted, point, linearisations=ORACLE_LOOKS)
            if refitted is not None:
                least = min(least, evaluate_fit(study, refitted.point, refitted.fitted).chi_square)
        return float(least)

    def moved_candidates(self, linearised: Sequence[LinearisedRecord]) -> np.ndarray:
        """Whitened readings (rows,) of other views less those at rest."""
        moved = []
        for linear, rest in zip(linearised, self.at_rest, strict=True):
            moved.append({name: (linear.readings[name] - own)[:, None] for name, own in rest.readings.items()})
        return self.study.stack(moved)[:, 0]

    def shift(self, case: Case) -> np.ndarray:
        """The point (p,) at which base parameters stand for what is hidden: zero where none can."""
        names = [parameter.name for parameter in self.study.nominal.parameters]
        point = np.zeros(len(names))
        for name, figures in case.hidden:
            for equivalent, value in TWINS.get(name, {}).items():
                if equivalent in names:
                    own = self.study.nominal.parameters[k := names.index(equivalent)]
                    point[k] = (value(self.study.nominal.variant.valve, dict(figures)) - own.nominal) / own.deviation
        return point

    @staticmethod
    def _H(J: np.ndarray) -> np.ndarray:
        return J.T @ J + np.eye(J.shape[1])


def ruler(case: Case, quiet: Records, folder: Path) -> Ruler:
    """The ruler of a case; `quiet` are its noise-free records with nothing hidden."""
    write(case, quiet, folder)
    study = prepare_session(replace(load_session(folder), valve=case.valve))
    meters = {meter.channel: meter for meter in case.meters}
    noise = {(c, b.record.pace): _true_noise(meters[c]) for b in study.predictors for c in b.record.outputs}
    study = study.with_noise(noise)
    return Ruler(study, quiet, *_linearised_at(study, np.zeros(len(study.nominal.parameters))))


def _end_of_fit(nominal: NominalFit, point: np.ndarray, fitted: tuple[FittedCandidate, ...]) -> Fit | None:
    """Candidates fitted from a point (p,) until a fit continued gains nothing; None where no valve has them there."""
    try:
        fit = evaluate_fit(nominal.study, point, fitted)
    except (vs.SolveError, vs.InputError):
        return None
    for _ in range(MOST_CONTINUED):
        further = continue_from(nominal, fit, np.inf)
        if further is None or further.chi_square > fit.chi_square - NO_GAIN:
            break
        fit = further
    return fit


def _linearised_at(study: Study, point: np.ndarray) -> tuple[tuple[LinearisedRecord, ...], np.ndarray]:
    """(views, J) of the training records from a point of the base parameters."""
    linearised, columns = linearise_study(study, study.nominal.at(point))
    return tuple(linearised), study.stack(columns)


def _true_noise(meter: hidden_plant.Meter) -> NoiseModel:
    rho = meter.colour
    return NoiseModel(deviation(meter) * float(np.sqrt(1.0 - rho * rho)), (rho,) if rho else (), True, "the plant's")


def deviation(meter: hidden_plant.Meter) -> float:
    """Standard deviation of a meter's noise and rounding."""
    return float(np.hypot(meter.noise, meter.resolution / np.sqrt(12.0)))


def write(case: Case, records: Records, folder: Path) -> None:
    """The session of a case whose noise-free records are known already."""
    with patch.object(hidden_plant, "responses", lambda case, strength=1.0: records):
        write_session(case, folder)


def tune(case: Case, target: float, folder: Path) -> Tuned:
    """The case at the strength whose d' is nearest to the target; one thing alone, at a target of 0, as drawn."""
    quiet = responses(case, 0.0)
    if not case.hidden:
        return Tuned(case, (), 0.0, (), 0.0, quiet)
    rule = ruler(case, quiet, folder)
    most = np.array([_most(name, figures) for name, figures in case.hidden])
    first, changes = np.minimum(1.0, most), []
    for k in range(len(most)):  # each alone, to know its share
        factors, trial, records = _run(case, np.where(np.arange(len(most)) == k, first, 0.0))
        first[k] = factors[k]
        changes.append(rule.change(trial, records))
    G = rule.products(np.column_stack(changes) / first)
    size = np.sqrt(np.maximum(np.diag(G), 1e-12))
    for k, (name, _) in enumerate(case.hidden):
        if name in TWINS:  # the linear equations would take it for far stronger than it is
            alone = scaled(case, np.where(np.arange(len(most)) == k, first, 0.0))
            shift = SHARED * float(np.linalg.norm(rule.shift(alone)))  # in prior deviations: it costs no more than that
            size[k] = (shift or rule.distance(alone, changes[k])) / first[k]
    overlap = float(G[0, -1] / np.sqrt(G[0, 0] * G[-1, -1])) if len(most) == 2 else 0.0
    if target == 0.0:
        distance = min(rule.distance(trial, changes[0]), rule.settled(trial, records))
        return Tuned(trial, tuple(map(float, first)), distance, (distance,), overlap, records)
    direction = _factors(size, overlap, target, most)
    best: Tuned | None = None
    scale, tried, believed = 1.0, [(0.0, 0.0)], False  # (scale, d')
    taken = any(name in TWINS for name, _ in case.hidden)  # nearly all of it, by a base parameter
    for _ in range(TRIALS):
        factors, trial, records = _run(case, np.minimum(scale * direction, most))
        distance = rule.distance(trial, rule.change(trial, records))
        sure = taken or abs(distance / target - 1.0) < CLOSE or distance > STRANGE * target
        if sure:
            distance = min(distance, rule.settled(trial, records))
        if best is None or _miss(distance, target) < _miss(best.distance, target):
            alone = tuple(map(float, size * factors)) if len(most) == 2 else (distance,)
            best, believed = Tuned(trial, tuple(map(float, factors)), distance, alone, overlap, records), sure
        tried.append((scale, distance))
        scale = _next_scale(tried, target)
        if abs(distance / target - 1.0) < CLOSE or np.allclose(np.minimum(scale * direction, most), factors, rtol=0.02):
            break
    assert best is not None
    return best if believed else confirmed(rule, best)


def beside(tuned: Tuned, folder: Path) -> tuple[float, ...]:
    """d' of each of a pair beside the other."""
    return ruler(tuned.case, responses(tuned.case, 0.0), folder).beside(tuned.case, tuned.records)


def confirmed(rule: Ruler, tuned: Tuned) -> Tuned:
    """A case with a d' that a fit to its noise-free records bears out."""
    distance = min(tuned.distance, rule.settled(tuned.case, tuned.records))
    return replace(tuned, distance=distance, alone=tuned.alone if len(tuned.alone) == 2 else (distance,))


def _next_scale(tried: Sequence[tuple[float, float]], target: float) -> float:
    """Where d' meets the target: between the trials on either side of it, else in proportion to the last."""
    scale, distance = tried[-1]
    below = max((one for one in tried if one[1] <= target), default=(0.0, 0.0))
    above = min((one for one in tried if one[1] > target), default=None)
    if above is not None and len(tried) > 2 and below[0] < above[0]:
        share = (target - below[1]) / (above[1] - below[1])
        return below[0] + min(max(share, 0.1), 0.9) * (above[0] - below[0])
    return scale * float(np.clip(target / max(distance, 1e-9), 0.1, 10.0))


def _miss(distance: float, target: float) -> float:
    return abs(float(np.log(max(distance, 1e-9) / target)))


def _factors(size: np.ndarray, overlap: float, target: float, most: np.ndarray) -> np.ndarray:
    """Factors at which what is hidden has d' = target in all: two alike, or the one that can less at its most.

    Two that cancel in part would have to be stronger: neither goes beyond the target alone.
    """
    cosine = np.array([[1.0, overlap], [overlap, 1.0]])[: len(size), : len(size)]
    most = np.minimum(most, target / size)
    alone = np.minimum(size * most, max(target / np.sqrt(len(size)), SHOWS))
    for _ in range(20):
        distance = float(np.sqrt(max(alone @ cosine @ alone, 1e-300)))
        alone = np.minimum(alone * target / distance, size * most)
    return alone / size


def _run(case: Case, factors: np.ndarray) -> tuple[np.ndarray, Case, Records]:
    """(factors, case, noise-free records) at factors, or at half of them and again half where the plant diverges."""
    for _ in range(5):
        trial = scaled(case, factors)
        try:
            return factors, trial, responses(trial)
        except (FloatingPointError, ZeroDivisionError, ValueError, vs.InputError) as error:
            last = error
        factors = factors / 2.0
    raise last


def scaled(case: Case, factors: Iterable[float]) -> Case:
    """The case with the amplitude of each thing hidden times a factor, reckoned from its neutral value."""
    hidden = []
    for (name, figures), factor in zip(case.hidden, factors, strict=True):
        parameter, neutral = amplitude(name)
        hidden.append((name, {**figures, parameter: neutral + float(factor) * (figures[parameter] - neutral)}))
    return replace(case, hidden=tuple(hidden))


def amplitude(name: str) -> tuple[str, float]:
    """(amplitude's name, its neutral value) of a hidden thing."""
    if name in PARAMETERS:
        return "offset", 0.0
    if name in SENSOR_FAULTS:
        return SENSOR_FAULTS[name][0], 0.0
    entry = EFFECTS.get(name) or OUTSIDE[name]
    return entry.parameter, entry.neutral


def _most(name: str, figures: dict[str, Any]) -> float:
    """The largest factor at which the amplitude stays inside the bounds of catalogue or valve."""
    parameter, neutral = amplitude(name)
    away = figures[parameter] - neutral
    if name in OUTSIDE:
        return STRONGEST
    if name in PARAMETERS:
        nominal = float(getattr(vs.Valve(), name))
        low, high = (value / nominal - 1.0 for value in quantities(vs.Valve)[name].metadata["bounds"])
        low, high = max(low, -MOST_OFFSET), min(high, MOST_OFFSET)
    else:
        effect = CATALOGUE[name]
        effect = effect.on(figures["channel"]) if effect.reading is not None else effect
        low, high = (value - neutral for value in effect.amplitude.bounds)
    return float(min(INSIDE * (high if away > 0.0 else low) / away, STRONGEST))


# ---------------------------------------------------------------- the truth


def truth_labels(case: Case) -> list[str]:
    """What is hidden by the diagnosis' own labels: name, sensor, side; `outside:NAME` for what it cannot know."""
    labels = []
    for name, figures in case.hidden:
        at = f"@{figures['channel']}" if "channel" in figures else ""
        side = f"[side={figures['side']:g}]" if "side" in figures else ""
        prefix = "parameter:" if name in PARAMETERS else "outside:" if name in OUTSIDE else ""
        labels.append(f"{prefix}{name}{at}{side}")
    return labels


def true_extras(case: Case, study: Study) -> tuple[FittedCandidate, ...] | None:
    """What is hidden as the model's own effects at their true figures, upon the valve as it came off the line.

    None where the catalogue lacks it.
    """
    fitted = []
    figures_of = hidden_plant.truth(case)["parameters"]
    for label, (cause, figures) in zip(truth_labels(case), figures_of.items(), strict=True):
        same = [c for c in study.candidates if c.label == label]
        if not same:
            return None
        candidate = min(same, key=lambda c: _apart(c, figures))
        if candidate.effect is None:
            name = cause.removeprefix("parameter:")
            own_value = case.unit.get(name, float(getattr(study.session.valve, name)))
            fitted.append(FittedCandidate(candidate, figures["value"] - own_value))
            continue
        own, fixed = candidate.effect.amplitude, dict(candidate.fixed)
        shapes = tuple((p.name, figures.get(p.name, fixed.get(p.name, p.default))) for p in candidate.shapes())
        low, high = candidate.limits
        above_neutral = float(np.clip(figures[own.name] - (own.neutral or 0.0), INSIDE * low, INSIDE * high))
        fitted.append(FittedCandidate(candidate, above_neutral, shapes))
    return tuple(fitted)


def _apart(candidate: Candidate, figures: dict[str, Any]) -> float:
    """How far a candidate's fixed shapes are from the true ones, in logarithms."""
    return sum(abs(float(np.log(value / figures.get(name, value)))) for name, value in candidate.fixed)


def true_term(case: Case) -> tuple[str, str, str, Any] | None:
    """(port, variable, memory, w) of a term outside the catalogue that is a function of one variable; else None."""
    ((name, p),) = case.hidden
    size, shape = p["size"], p.get("form_shape", 1.0)
    supply = float(np.median([run.supply for run in case.runs]))
    motor = 2.82  # N m/A, the torque constant of the reference valve
    terms = {
        "cubic_spool_spring": ("spool_force", "spool_position", "none", lambda x: -size * x**3),
        "spool_detent": ("spool_force", "spool_position", "none", lambda x: -size * np.sin(2.0 * np.pi * x / shape)),
        "quadratic_spool_damping": ("spool_force", "spool_velocity", "none", lambda v: -size * v * np.abs(v)),
        "quadratic_armature_torque": ("armature_torque", "armature_angle", "none", lambda a: size * a * a),
        "spool_end_leakage": ("pilot_flow", "pilot_differential_pressure", "none", lambda d: -size * d),
        "hydraulic_lock": ("spool_force", "spool_position", "none", lambda x: -size * supply * x * np.abs(x)),
        "torque_memory_of_pressure": ("armature_torque", "pilot_differential_pressure", "lag", lambda d: size * d),
        "armature_memory": ("armature_torque", "armature_angle", "path", lambda a: -size * np.ones_like(a)),
        "amplifier_dead_band": ("armature_torque", "current", "none", lambda i: -motor * np.clip(i, -size, size)),
        "one_sided_spool_spring": ("spool_force", "spool_position", "none", lambda x: -size * x * x),
    }
    return terms.get(name)


def term_error(case: Case, term: Term) -> float | None:
    """Relative L2 error of a recovered term over its knots, offsets removed; None where it is of another kind."""
    expected = true_term(case)
    if expected is None or (term.port, term.variable, term.memory) != expected[:3]:
        return None
    at, got = np.asarray(term.at), np.asarray(term.value)
    want = expected[3](at)
    if term.memory != "path":  # whose sign turns: nothing takes up its mean
        got, want = got - got.mean(), want - want.mean()
    return float(np.linalg.norm(got - want) / max(np.linalg.norm(want), 1e-300))


# ---------------------------------------------------------------- one case


@dataclass
class Caught:
    """What a diagnosis fits on its way, kept so that oracle and baselines need not fit it again."""

    nominal: NominalFit | None = None
    scores: ScoreTest | None = None
    fits: list[Fit] = field(default_factory=list)


def diagnose_and_catch(folder: Path) -> tuple[Diagnosis, Caught, tuple[float, float]]:
    """(diagnosis, its fits, seconds on the clock and of processor)."""
    caught = Caught()

    def catching_base(*arguments, **named) -> NominalFit:
        caught.nominal = fit_nominal(*arguments, **named)
        return caught.nominal

    def catching_look(nominal: NominalFit, fit: Fit, **named) -> ScoreTest:
        scores = score_test(nominal, fit, **named)
        caught.scores = scores if fit is nominal.fit and caught.scores is None else caught.scores
        return scores

    def catching_refit(*arguments, **named) -> Fit | None:
        fit = fit_hypothesis(*arguments, **named)
        caught.fits += [fit] if fit is not None else []
        return fit

    with ExitStack() as stack:
        stack.enter_context(patch.object(leading_segments, "fit_nominal", catching_base))
        for module in (isolation, second_cause):
            stack.enter_context(patch.object(module, "score_test", catching_look))
        for module in (refits, second_cause):
            stack.enter_context(patch.object(module, "fit_hypothesis", catching_refit))
        begin, worked = time.perf_counter(), time.process_time()
        found = engine.diagnose(folder)
        return found, caught, (time.perf_counter() - begin, time.process_time() - worked)


def tuned_case(case: Case, target: float, earlier: Row | None, folder: Path) -> Tuned:
    """The case at its strength: that of an earlier row if the plant is the same, its d' by the priors of today; else
    tuned now.
    """
    if earlier is None or earlier.get("plant") != PLANT or "distance" not in earlier:
        return tune(case, target, folder)
    case = scaled(case, earlier["factors"])
    factors, alone = (tuple(earlier[name]) for name in ("factors", "alone"))
    tuned = Tuned(case, factors, 0.0, alone, earlier["overlap"], responses(case))
    if not case.hidden:
        return tuned
    rule = ruler(case, responses(case, 0.0), folder)
    return confirmed(rule, replace(tuned, distance=rule.distance(case, rule.change(case, tuned.records))))


def run_case(spec: Spec, earlier: Row | None, with_baselines: bool, with_next_tests: bool) -> Row:
    """The line of a case. What fails is told in it: `outcome` "error", with the message."""
    row: Row = {**asdict(spec), "key": spec.key, "plant": PLANT, "outcome": "error"}
    begin = time.perf_counter()
    with tempfile.TemporaryDirectory(prefix="valvesim_hidden_") as place, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            case = draw(spec.seed, spec.kind, name=spec.name)
            row |= _of_case(case)
            tuned = tuned_case(case, spec.target, earlier, Path(place) / "quiet")
            row |= _of_case(tuned.case) | {
                "factors": tuned.factors, "distance": tuned.distance, "alone": tuned.alone, "overlap": tuned.overlap,
            }  # fmt: skip
            folder = Path(place) / "session"
            write(tuned.case, tuned.records, folder)
            if spec.kind == "pair":
                row["beside"] = beside(tuned, Path(place) / "quiet")
            row["preparing"] = time.perf_counter() - begin
            found, caught, (row["seconds"], row["cpu_seconds"]) = diagnose_and_catch(folder)
            row |= _of_diagnosis(tuned.case, found)
            row["outcome"] = "done"
            row |= _errors(tuned, found, caught, load_session(folder), row)
            if found.next_test is not None and with_next_tests:
                row["after_next_test"] = _after_next_test(tuned, found.next_test, Path(place) / "longer")
                row["next_test_stopped"] = row["after_next_test"] is None
            if with_baselines:
                start = time.perf_counter()
                row["baselines"] = baselines(caught.nominal, caught.scores, caught.fits, found)
                row["baseline_seconds"] = time.perf_counter() - start
        except Exception as error:  # a suite of hundreds does not stop for one: it is an outcome
            frames = traceback.extract_tb(error.__traceback__)
            at = [f for f in frames if f.filename.startswith(str(ROOT)) and ".venv" not in f.filename][-1]
            row["message"] = f"{type(error).__name__} in {Path(at.filename).name}:{at.lineno}: {error}"[:600]
    row["total"] = time.perf_counter() - begin
    return plain_json(row)


def _after_next_test(tuned: Tuned, test: NextTest, folder: Path) -> Row | None:
    """What the diagnosis says once the test that it has asked for has been made on the plant; None where that takes
    longer than `LONGEST_DIAGNOSIS`.
    """
    inputs = test.inputs
    run = Run(
        name="next_test", shape="designed", rate=1.0 / float(inputs["time"][1]), command=inputs[tuned.case.drive],
        oil=inputs["oil_temperature"], supply=float(inputs["supply_pressure"][0]),
        load=float(inputs["load_pressure"][0]),
    )  # fmt: skip
    records = [*tuned.records, *responses(replace(tuned.case, runs=(run,)))]
    write(replace(tuned.case, runs=(*tuned.case.runs, run)), records, folder)
    try:
        with stopped_after(LONGEST_DIAGNOSIS):
            found = engine.diagnose(folder)
    except Stopped:
        return None
    return {"verdict": found.verdict, "in_set": [one.label for one in found.candidates if one.in_set]}


class Stopped(BaseException):
    """Ends what takes too long: no handler of errors takes it for one."""


@contextmanager
def stopped_after(seconds: float) -> Iterator[None]:
    """Raises `Stopped` in the main thread once it has worked so many seconds of the processor."""

    def stop(*_: Any) -> None:
        raise Stopped

    before = signal.signal(signal.SIGPROF, stop)
    signal.setitimer(signal.ITIMER_PROF, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        signal.signal(signal.SIGPROF, before)


def _of_case(case: Case) -> Row:
    hidden = hidden_plant.truth(case)
    return {
        "labels": truth_labels(case), "truth": hidden["parameters"], "channels": case.channels, "drive": case.drive,
        "isothermal": case.isothermal, "colour": max(meter.colour for meter in case.meters),
    }  # fmt: skip


def _of_diagnosis(case: Case, found: Diagnosis) -> Row:
    named = [one.label for one in found.candidates if one.names == found.causes and one.in_set]
    return {
        "verdict": found.verdict,
        "causes": found.causes,
        "named": named[0].split(" + ") if found.causes and named else list(found.causes),
        "candidates": [
            {**asdict(one), "labels": [] if one.names == ("unknown",) else one.label.split(" + ")}
            for one in found.candidates[:10]
        ],
        "parameters": [asdict(one) for one in found.parameters],
        "gain": [asdict(one) for one in found.gain],
        "gain_claimed": found.gain_claimed,
        "extension_offered": found.extension_offered,
        "location": found.location,
        "summary": found.summary,
        "limits": {one.label: one.amplitude and float(f"{one.amplitude:.4g}") for one in found.detection_limits},
        "limit_units": {one.label: one.unit for one in found.detection_limits},
        "next_test": asdict(replace(found.next_test, inputs={})) if found.next_test is not None else None,
        "term": asdict(found.term) if found.term is not None else None,
        "term_truth": case.kind == "outside" and true_term(case) is not None,
        "term_error": term_error(case, found.term) if found.term is not None and case.kind == "outside" else None,
        "top_score": found.scores[0].z if found.scores else 0.0,
        "alarm_level": found.alarm_level,
    }


def _errors(tuned: Tuned, found: Diagnosis, caught: Caught, session: Session, row: Row) -> Row:
    """True errors on the locked records, in noise deviations: of base, extension and oracle."""
    truth = {run.name: record for run, record in zip(tuned.case.runs, tuned.records, strict=True)}
    sigma = {meter.channel: deviation(meter) for meter in tuned.case.meters}

    def pooled(readings: Iterable[tuple[str, str, np.ndarray]]) -> float:
        left = [(read - truth[record][channel]) / sigma[channel] for record, channel, read in readings]
        return float(np.sqrt(np.mean(np.concatenate(left) ** 2)))

    offered = found.extension_offered
    locked = [trace for trace in found.traces if trace.role == "test" and trace.channel in sigma]
    errors: Row = {
        "error_before": pooled((t.record, t.channel, t.base) for t in locked),
        "error_after": pooled((t.record, t.channel, t.extended if offered else t.base) for t in locked),
    }
    nominal = caught.nominal
    fitted = true_extras(tuned.case, nominal.study) if nominal is not None and tuned.case.hidden else None
    if nominal is None or fitted is None:
        return errors
    oracle = _oracle(tuned.case, nominal, fitted, caught.fits)
    variant = oracle.variant(nominal.study.nominal)
    read = []
    for record in session.locked:
        predictor = prepare_record(
            session, record, nominal.study.predictors[0].universe, options=DEFAULT_IDENTIFICATION
        )
        values = predictor.readings(predictor.run(variant), variant)
        read += [(record.name, name, values[name]) for name in record.outputs]
    return {**errors, "error_oracle": pooled(read), "oracle_fall": nominal.fit.chi_square - oracle.chi_square}


def _oracle(case: Case, nominal: NominalFit, fitted: tuple[FittedCandidate, ...], fits: Sequence[Fit]) -> Fit:
    """The true cause fitted to the data, from the plant's own figures; the base where that explains the data better."""
    own = sorted(member.candidate.label for member in fitted)
    point = [(case.unit.get(p.name, p.nominal) - p.nominal) / p.deviation for p in nominal.study.nominal.parameters]
    of_study = (f for f in fits if len(f.point) == len(point))  # others were fitted before the bench was among it
    tried = [nominal.fit, *(f for f in of_study if sorted(e.candidate.label for e in f.fitted) == own)]
    again = fit_hypothesis(nominal, fitted, np.array(point), linearisations=ORACLE_LOOKS)
    tried += [again] if again is not None else []
    return min(tried, key=lambda fit: fit.chi_square)


# ---------------------------------------------------------------- all of them


def measure_beside(path: Path, workers: int) -> None:
    """What each of a pair shows beside the other, worked out anew for the rows of a results file, which is written once
    all are done.
    """
    rows = read_results(path)
    pairs = [row for row in rows if row["kind"] == "pair" and row["outcome"] == "done"]
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
        for row, found in zip(pairs, pool.map(_beside_of_row, pairs), strict=True):
            print(f"{row['seed']}: {row['beside']} is {found}", flush=True)
            row["beside"] = found
    path.write_text("".join(json.dumps(row) + "\n" for row in rows), encoding="utf-8")


def _beside_of_row(row: Row) -> tuple[float, ...]:
    spec = Spec(**{field.name: row[field.name] for field in fields(Spec)})
    with tempfile.TemporaryDirectory(prefix="valvesim_hidden_") as place, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        tuned = tuned_case(draw(spec.seed, spec.kind, name=spec.name), spec.target, row, Path(place) / "quiet")
        return beside(tuned, Path(place) / "quiet")


def read_results(path: Path) -> list[Row]:
    """The lines of a results file; a last line that was cut off by an interruption is left out."""
    rows = []
    for line in path.read_text(encoding="utf-8").splitlines() if path.exists() else ():
        try:
            rows.append(json.loads(line))
        except json.JSONDecodeError:
            print(f"{path}: a line that is no JSON is left out: {line[:60]}", file=sys.stderr)
    return rows


def run(
    todo: Sequence[Spec], path: Path, earlier: Mapping[str, Row], workers: int, with_baselines: bool,
    with_next_tests: bool,
) -> None:  # fmt: skip
    """Run cases that the results do not hold yet; this process alone writes, a line at a time.

    `earlier` are rows by key, whose strengths are taken over.
    """
    done = {row["key"] for row in read_results(path)}
    left = [spec for spec in todo if spec.key not in done]
    path.parent.mkdir(parents=True, exist_ok=True)
    if path.exists() and path.read_bytes()[-1:] not in (b"", b"\n"):  # an interruption within a line
        with path.open("a", encoding="utf-8") as file:
            file.write("\n")
    with path.open("a", encoding="utf-8") as file:

        def job(spec: Spec) -> tuple[Any, ...]:
            also_baselines = with_baselines and crc32(spec.key.encode()) % BASELINE_EVERY == 0
            return run_case, spec, earlier.get(spec.key), also_baselines, with_next_tests

        def add(spec: Spec, row: Row) -> str:
            file.write(json.dumps(row, ensure_ascii=False, allow_nan=False) + "\n")
            file.flush()
            return _told(spec, row)

        _over(left, len(todo), workers, job, add)


def _over(
    left: Sequence[Spec],
    total: int,
    workers: int,
    job: Callable[[Spec], tuple[Any, ...]],
    tell: Callable[[Spec, Any], str],
) -> None:
    """Work through cases in processes of their own, with progress: `job` gives a function and its arguments."""
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(),
               TextColumn("left"), TimeRemainingColumn())  # fmt: skip
    pool = ProcessPoolExecutor(workers, mp_context=get_context("spawn"))
    try:
        with Progress(*columns, speed_estimate_period=600.0) as progress:
            bar = progress.add_task("hidden effects", total=total, completed=total - len(left))
            waiting: dict[Future, Spec] = {}
            queue = iter(left)
            while True:
                while len(waiting) < workers and (spec := next(queue, None)) is not None:
                    waiting[pool.submit(*job(spec))] = spec
                if not waiting:
                    break
                for future in wait(waiting, return_when=FIRST_COMPLETED).done:
                    spec = waiting.pop(future)
                    progress.update(bar, advance=1, description=tell(spec, future.result())[:70].ljust(70))
    finally:
        pool.shutdown(wait=False, cancel_futures=True)


def _told(spec: Spec, row: Row) -> str:
    answer = row.get("verdict", row.get("message", "error"))
    return f"{spec.kind} {spec.name or ''}: {answer} {' + '.join(row.get('named', ()))}"


def main() -> None:
    """The command line."""
    parser = argparse.ArgumentParser(description="The full suite of hidden effects.")
    parser.add_argument("what", choices=("run", "report", "beside"))
    parser.add_argument("--cases", type=int, help="only the first so many of the list")
    parser.add_argument("--kinds", nargs="+", choices=KINDS, help="only these")
    parser.add_argument("--seed-offset", type=int, default=TABLE_SEEDS, help="10000 while the diagnosis is worked on")
    parser.add_argument("--results", type=Path, default=RESULTS)
    parser.add_argument("--strengths", type=Path, default=RESULTS, help="rows whose strengths need no tuning again")
    parser.add_argument(
        "--keep-strengths",
        action="store_true",
        help="also those of an earlier file of the plant, of the same equations",
    )
    parser.add_argument("--workers", type=int, default=cores())
    parser.add_argument("--baselines", action=argparse.BooleanOptionalAction, default=True)
    parser.add_argument("--next-tests", action=argparse.BooleanOptionalAction, default=True, help="make them")
    parser.add_argument("-o", "--output", type=Path, default=DOCUMENT, help="the report's file")
    options = parser.parse_args()
    chosen = [spec for spec in cases(options.seed_offset) if options.kinds is None or spec.kind in options.kinds]
    chosen = chosen[: options.cases]
    try:
        if options.what == "run":
            taken = {"plant": PLANT} if options.keep_strengths else {}
            earlier = {row["key"]: row | taken for row in read_results(options.strengths)}
            with_others = options.baselines, options.next_tests
            return run(chosen, options.results, earlier, options.workers, *with_others)
    except KeyboardInterrupt:
        sys.exit(f"interrupted; what is done stands in {options.results}, the same command goes on from there")
    if options.what == "beside":
        return measure_beside(options.results, options.workers)
    keys = {spec.key for spec in chosen}
    rows = {row["key"]: row for row in read_results(options.results) if row["key"] in keys}
    if not rows:
        sys.exit(f"{options.results}: no results of these cases; make them with `run`")
    write_report(list(rows.values()), len(chosen), options.output)
    print(f"wrote {options.output} from {len(rows)} of {len(chosen)} cases")


if __name__ == "__main__":
    main()
