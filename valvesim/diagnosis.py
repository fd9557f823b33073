"""Given measured data: what the simulation gets wrong, its cause, the extended model and the gain on locked records.

The order of work: fit the base model with its parameters inside their tolerances; test every candidate and every free
term against what is left; refit the few that could explain it, alone and in pairs; look again at what those leave.
A cause is named only where nothing else explains the data nearly as well and nothing is left over.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from .answer import (
    AMBIGUOUS,
    CAUSE,
    NO_DISCREPANCY,
    UNKNOWN,
    CandidateAnswer,
    DetectionLimit,
    Diagnosis,
    Estimate,
    Gain,
    NextTest,
    NoiseFound,
    Score,
    Shift,
    Term,
    Trace,
)
from .beginnings import begin
from .channels import SIGNAL_CHANNELS, STATE_CHANNELS
from .errors import InputError, SolveError
from .evidence import inverse_of
from .extension import effect_files, scenario_text
from .next_test import design
from .prediction import Variant, prepare
from .recovery import Recovered, recover
from .scene import Scene
from .search import Searched, search
from .session import Record, Session, load_session
from .study import (
    SHAPE_STEP,
    BaseFit,
    Fit,
    Study,
    own_step,
    prepare_study,
    residual_of,
    within_tolerance,
)
from .weighing import ANSWER_RATIO, Explained, chance_beside, doubt, heat_of, width_of

UNKNOWN_PRICE = 6.4  # deviance: of a hundred names given alone four stand for what nobody has listed
HOPELESS = 0.35  # share of the signal that stays unexplained where the records are not of this valve
LIKELY = 0.9  # chance that the locked records get better, below which no extended model is offered
RIVALS_TOLD = 2  # of an answer set: from how many a test is sought that tells the likeliest
INTERVAL = (0.025, 0.975)
UNITS = {channel.name: channel.unit for channel in (*STATE_CHANNELS, *SIGNAL_CHANNELS)}


def diagnose(session: Session | str | Path, *, progress: Callable[[str, float], None] | None = None) -> Diagnosis:
    """Diagnose a session, or the folder of one. `progress(stage, share)` is told what is being done.

    The same session and seed give the same answer. Raises InputError for a session that cannot be used and SolveError
    where the nominal valve cannot be simulated under the session's inputs.
    """
    tell = progress or (lambda stage, share: None)
    tell("reading", 0.0)
    session = session if isinstance(session, Session) else load_session(session)
    study = prepare_study(session)
    base, known = begin(study, lambda stage, share: tell(stage, 0.05 + 0.25 * share))
    searched = search(base, lambda stage, share: tell(stage, 0.3 + 0.6 * share), known)
    tell("measuring the gain", 0.9)
    return _answer(searched)


# ---------------------------------------------------------------- the answer


def _answer(searched: Searched) -> Diagnosis:
    base, scene, level = searched.base, searched.scene, searched.level
    found, rivals = searched.found, searched.rivals
    study, session = base.study, base.study.session
    best = found[0] if found else None
    chosen = best.fit if best is not None else base.fit
    in_set, none_listed = [*rivals, *chance_beside(base, rivals, level)], searched.none_listed
    hopeless = _hopeless(base, chosen)
    recovered: Recovered | None = None
    if searched.alarm and not hopeless and (none_listed or not in_set):
        recovered = recover(base, scene)
        if recovered is not None and in_set and _explains_more(recovered, found):
            in_set, none_listed = [], ""
    answers = _candidate_answers(base, found, in_set, level, none_listed)
    verdict = _verdict(searched.alarm, in_set, none_listed)
    term: Term | None = None
    notes = list(session.notes)
    if any(not noise.verified for noise in study.noise.values()):
        notes.append(
            "noise unverified: no repeats, so it was taken from what the model leaves; small effects may hide in it"
        )
    if hopeless:
        verdict, in_set = UNKNOWN, []
        notes.insert(
            0, "the base model cannot come near these records: are they of this valve, with these units and signs?"
        )
    named = best if verdict in (CAUSE, AMBIGUOUS) else None
    unextended = base.fit.variant(study.base)
    variant, readings, point = unextended, base.fit.readings, base.fit.point
    if named is not None:
        variant, readings, point = chosen.variant(study.base), chosen.readings, chosen.point
    elif verdict == UNKNOWN and recovered is not None:
        term, variant, readings, point = recovered.term, recovered.variant, recovered.readings, recovered.point
    causes = tuple(c.name for c in best.candidates) if verdict == CAUSE and best is not None else ()
    estimates = _estimates(base, searched.final) if named is not None else ()
    before = base.fit if variant is unextended else within_tolerance(base)
    gain, claimed, offered, traces, failed = _gain(base, before, variant, readings)
    notes += failed
    if not offered and variant is not unextended:
        variant = before.variant(study.base)
        notes.append(
            "the locked records do not show that the extension helps: the scenario is that of the refitted base model"
        )
    return Diagnosis(
        title=session.title,
        verdict=verdict,
        causes=causes,
        summary=_summary(verdict, in_set, term, notes, none_listed),
        location=_location(verdict, in_set),
        candidates=tuple(answers),
        parameters=estimates,
        gain=gain,
        gain_claimed=claimed,
        extension_offered=offered and variant is not unextended,
        detection_limits=_limits(scene, level),
        next_test=_next(base, in_set) if verdict == AMBIGUOUS else None,
        term=term,
        shifts=_shifts(study, point),
        noise=tuple(
            NoiseFound(channel=channel, rate=rate, deviation=n.deviation, unit=UNITS[channel], order=len(n.lags),
                       verified=n.verified, source=n.source)
            for (channel, rate), n in study.noise.items()
        ),
        scores=_scores(scene),
        alarm_level=level,
        errors=_errors(study, before),
        notes=tuple(notes),
        traces=traces,
        extended_scenario=scenario_text(session, variant),
        extended_effects=effect_files(session, variant),
        extended_variant=variant,
    )  # fmt: skip


def _candidate_answers(
    base: BaseFit, found: Sequence[Explained], in_set: Sequence[Explained], level: float, none_listed: str = ""
) -> list[CandidateAnswer]:
    """All hypotheses with their probabilities, likeliest first; beside them what is in no catalogue, and chance.

    `none_listed` tells why what is in no catalogue belongs to the answer set, if it does.
    """
    if not found:
        return []
    width, heat = width_of(base, found[0]), heat_of(base, found[0])
    known = [one.weighed(heat) for one in found]
    unknown = known[0] + (UNKNOWN_PRICE * heat if in_set else -2.0 * width)
    if none_listed:
        unknown = known[0] + 2.0 * heat
    values = np.array([*known, known[0] + doubt(base, found[0], level), unknown])
    weights = np.exp(-0.5 * (values - values.min()) / heat)
    weights /= weights.sum()
    members = {one.label for one in in_set}
    answers = [
        CandidateAnswer(
            names=tuple(c.name for c in one.candidates),
            label=one.label,
            location=" and ".join(dict.fromkeys(c.location() for c in one.candidates)),
            probability=float(weight),
            deviance_fall=float(base.fit.deviance - one.fit.deviance),
            in_set=one.label in members,
        )
        for one, weight in zip([*found, Explained(base.fit)], weights[:-1], strict=True)
    ]
    nothing = CandidateAnswer(names=("unknown",), label="none of the known causes", location="", deviance_fall=0.0,
                              probability=float(weights[-1]), in_set=not in_set or bool(none_listed))  # fmt: skip
    ranked = sorted([*answers, nothing], key=lambda a: -a.probability)
    return [a for a in ranked if a.in_set or a.probability > 1e-3]


def _explains_more(recovered: Recovered, found: Sequence[Explained]) -> bool:
    """Whether a term that nobody has listed explains more than any cause that is, for the price of its figures."""
    least = min(one.least + one.fit.occam for one in found)
    return recovered.deviance + recovered.freedom * np.log(found[0].fit.rows) < least - ANSWER_RATIO


def _verdict(alarm: bool, in_set: Sequence[Explained], none_listed: str = "") -> str:
    if not alarm:
        return NO_DISCREPANCY
    if not in_set:
        return UNKNOWN
    return CAUSE if len(in_set) == 1 and not none_listed else AMBIGUOUS


def _hopeless(base: BaseFit, fit: Fit) -> bool:
    """True where most of the signal stays unexplained in most channels: these records are not of this valve."""
    shares = []
    for bench, read in zip(base.study.benches, fit.readings, strict=True):
        for name, column in read.items():
            usable = bench.record.usable[name]
            measured, column = bench.record.values[name][usable], column[usable]
            noise = base.study.noise[name, bench.record.pace].deviation
            signal = float(np.std(measured))
            if signal > 5.0 * noise:
                shares.append(float(np.sqrt(np.mean((measured - column) ** 2))) / signal)
    return bool(shares) and float(np.median(shares)) > HOPELESS


def _estimates(base: BaseFit, final: Scene) -> tuple[Estimate, ...]:
    """Amplitudes and shapes of the fit's extras with 95 % intervals, from the curvature at the fit."""
    from scipy.stats import t as student_t

    fit, gram = final.fit, final.gram
    p, total = gram.parameters, gram.total
    own = [1 + p + k for k in final.own]
    at = [*range(1, 1 + p), *own]
    H = total[np.ix_(at, at)].copy()
    for k, (_, shape) in enumerate(fit.kinds):
        H[p + k, p + k] += np.log(SHAPE_STEP) ** 2 if shape else 0.0
    H[np.arange(p), np.arange(p)] += 1.0
    C = inverse_of(H)
    # parts of records that disagree widen the interval: no model is the plant (a sandwich over the parts)
    pushes = C @ np.array([part[at, 0] for part in gram.products]).T
    parts = len(gram.products)
    others = max(parts - 1, 1)
    few = float(student_t.ppf(0.975, others))

    def half_width(combine: np.ndarray) -> float:
        among = float(np.sum((combine @ pushes) ** 2)) * parts / others
        return float(max(1.96 * np.sqrt(combine @ C @ combine), few * np.sqrt(among)))

    names = [parameter.name for parameter in base.study.base.parameters]
    found = []
    for k, (extra, shape) in enumerate(fit.kinds):
        candidate = extra.candidate
        if candidate.effect is None:
            j = names.index(candidate.name.removeprefix("parameter:"))
            parameter = base.study.base.parameters[j]
            combine = np.zeros(len(at))
            combine[j], combine[p + k] = parameter.deviation, own_step(extra)
            value = parameter.nominal + fit.point[j] * parameter.deviation + extra.excess
            half = half_width(combine)
            low, high = value - half, value + half
            found.append(
                Estimate(
                    name=parameter.name, cause=candidate.name, value=value, low=low, high=high, unit=parameter.unit
                )
            )
            continue
        effect = candidate.effect
        if shape:
            declared = next(q for q in effect.parameters if q.name == shape)
            value = dict(extra.shapes)[shape]
            half = np.log(SHAPE_STEP) * half_width(np.eye(len(at))[p + k])
            low, high = value * np.exp(-half), value * np.exp(half)
        else:
            declared = effect.amplitude
            value = (declared.neutral or 0.0) + extra.excess
            combine = own_step(extra) * np.eye(len(at))[p + k]
            if candidate.family in names:  # the sensor's error within tolerance is the same error: their sum is known
                j = names.index(candidate.family)
                combine[j] = base.study.base.parameters[j].deviation
                value += fit.point[j] * combine[j]
            half = half_width(combine)
            low, high = value - half, value + half
        low, high = max(low, declared.bounds[0]), min(high, declared.bounds[1])
        found.append(
            Estimate(name=declared.name, cause=candidate.family, value=float(value), low=float(low), high=float(high),
                     unit=declared.unit, doc=declared.doc)
        )  # fmt: skip
        if not shape:
            found += [
                Estimate(name=name, cause=candidate.family, value=v, low=v, high=v, unit="1", doc="as found")
                for name, v in candidate.fixed
                if name not in dict(extra.shapes)
            ]
    return tuple(found)


def _summary(
    verdict: str, in_set: Sequence[Explained], term: Term | None, notes: Sequence[str], none_listed: str = ""
) -> str:
    if verdict == NO_DISCREPANCY:
        return "No discrepancy: the model explains the records within their noise and its own tolerances."
    if verdict == CAUSE:
        return f"The cause is {_said(in_set[0])}."
    if verdict == AMBIGUOUS:
        causes = [*(_said(one) for one in in_set if one.candidates)]
        if none_listed:
            return f"Something is wrong, perhaps {' or '.join(causes)}, or none of the known causes: {none_listed}."
        if in_set[-1].candidates:
            return f"Something is wrong, and these cannot be told apart: {'; '.join(causes)}."
        return f"Something may be wrong, or noise alone shows it; it would be {' or '.join(causes)}."
    if notes and notes[0].startswith("the base model cannot"):
        return f"Nothing is named: {notes[0]}"
    if term is None:
        return "Something is wrong that none of the known causes explains."
    return (
        "Something is wrong that none of the known causes explains; it acts like a term in the "
        f"{term.port.replace('_', ' ')} that depends on the {term.variable.replace('_', ' ')}"
        + (f", and nearly as well like {_some(term.alike)}." if term.alike else ".")
    )


def _some(labels: Sequence[str], most: int = 2) -> str:
    """A few labels in words, and how many more there are."""
    more = len(labels) - most
    return " or ".join(labels[:most]) + (f" (and {more} more)" if more > 0 else "")


def _said(one: Explained) -> str:
    """A hypothesis in words: `sensor_bias@load_flow` as "sensor bias of load flow"."""
    return " together with ".join(
        c.family.replace("parameter:", "the figure of ").replace("@", " of ").replace("_", " ") for c in one.candidates
    )


def _location(verdict: str, in_set: Sequence[Explained]) -> str:
    if verdict not in (CAUSE, AMBIGUOUS):
        return ""
    return " or ".join(dict.fromkeys(c.location() for one in in_set for c in one.candidates))


def _limits(scene: Scene, level: float) -> tuple[DetectionLimit, ...]:
    """For each candidate, the amplitude that would pass the alarm nine times in ten."""
    best: dict[str, DetectionLimit] = {}
    distance = scene.projected.distance
    visible = scene.visible()
    for k, candidate in enumerate(scene.candidates):
        name = candidate.effect.amplitude.name if candidate.effect is not None else candidate.name.partition(":")[2]
        amplitude = None
        if visible[k]:
            amplitude = float((level + 1.2816) / distance[k] * abs(scene.sizes[k]))
        one = DetectionLimit(
            name=candidate.name, label=candidate.family, parameter=name, amplitude=amplitude, unit=candidate.unit
        )
        old = best.get(candidate.family)
        if old is None or old.amplitude is None or (amplitude is not None and amplitude < old.amplitude):
            best[candidate.family] = one
    return tuple(best.values())


def _shifts(study: Study, point: np.ndarray) -> tuple[Shift, ...]:
    shifts = [
        Shift(
            name=p.name,
            unit=p.unit,
            nominal=p.nominal,
            value=float(p.nominal + t * p.deviation),
            share_of_tolerance=float(t / 2.0),
        )
        for p, t in zip(study.base.parameters, point, strict=True)
    ]
    return tuple(sorted(shifts, key=lambda s: -abs(s.share_of_tolerance)))


def _scores(scene: Scene, most: int = 15) -> tuple[Score, ...]:
    z = scene.z()
    best: dict[str, float] = {}
    for candidate, value in zip(scene.candidates, z, strict=True):
        best[candidate.family] = max(best.get(candidate.family, 0.0), float(value))
    ranked = sorted(best.items(), key=lambda pair: -pair[1])
    return tuple(Score(label=label, z=value) for label, value in ranked[:most])


def _errors(study: Study, before: Fit) -> dict[str, dict[str, float]]:
    table: dict[str, dict[str, float]] = {}
    for bench, read in zip(study.benches, before.readings, strict=True):
        record = bench.record
        table[record.name] = {}
        for name in record.outputs:
            left = (record.values[name] - read[name])[record.usable[name]]
            deviation = study.noise[name, record.pace].deviation
            table[record.name][name] = float(np.sqrt(np.mean(left**2)) / deviation)
    return table


# ---------------------------------------------------------------- gain


def _gain(
    base: BaseFit, before: Fit, extended: Variant, readings: Sequence[dict[str, np.ndarray]]
) -> tuple[tuple[Gain, ...], bool, bool, tuple[Trace, ...], list[str]]:
    """Errors of base and extended model on the locked records, opened here and once; and traces of all records.

    The first flag tells whether a gain is claimed, the second whether the extended model is offered: where it most
    likely does better on what it has not seen, or where nobody can tell. Last what could not be simulated, in words:
    then it is not offered.
    """
    study, session = base.study, base.study.session
    universe = study.benches[0].universe
    variants = (before.variant(study.base), extended)
    gains, traces, pooled, failed = [], [], [], []
    for bench, *reads in zip(study.benches, before.readings, readings, strict=True):
        traces += _traces(study, bench.record, reads)
    for record in session.locked:
        try:
            bench = prepare(session, record, universe)
            reads = [bench.readings(bench.run(variant), variant) for variant in variants]
        except (InputError, SolveError) as reason:  # what was found in the others stands all the same
            failed.append(f"no gain is measured on a locked record that cannot be simulated: {reason}")
            continue
        traces += _traces(study, record, reads)
        white = []
        for name in record.outputs:
            key = _nearest_noise(study, name, record.pace)
            if key is None:
                continue
            columns = np.column_stack([residual_of(record, read)[name][:, 0] for read in reads])
            white.append(study.noise[key].whiten(columns, record.usable[name]))
        if not white:
            continue
        squares = np.concatenate([w**2 for w in white])
        change = squares[:, 1] - squares[:, 0]
        pooled.append(change)
        low, high = np.quantile(_block_means(change, session.seed), INTERVAL)
        error, extended_error = np.sqrt(squares.mean(axis=0))
        gains.append(
            Gain(record=record.name, before=float(error), after=float(extended_error), floor=1.0,
                 change=float(change.mean()), low=float(low), high=float(high), claimed=bool(high < 0.0))
        )  # fmt: skip
    claimed, offered = False, True
    if pooled:
        means = _block_means(np.concatenate(pooled), session.seed)
        claimed, offered = bool(np.quantile(means, INTERVAL[1]) < 0.0), bool(np.mean(means < 0.0) >= LIKELY)
    return tuple(gains), claimed, offered and not failed, tuple(traces), failed


def _nearest_noise(study: Study, channel: str, rate: float) -> tuple[str, float] | None:
    """The key of the noise of a channel at the nearest rate; None where training has not seen the channel."""
    rates = [r for name, r in study.noise if name == channel]
    return (channel, min(rates, key=lambda r: abs(np.log(r / rate)))) if rates else None


def _block_means(change: np.ndarray, seed: int, draws: int = 1000) -> np.ndarray:
    """(draws,) means as they would have come out, by drawing blocks: neighbours are alike."""
    size = max(int(np.sqrt(len(change))), 1)
    count = max(len(change) // size, 1)
    blocks = change[: count * size].reshape(count, size).mean(axis=1)
    rng = np.random.default_rng(seed)
    return blocks[rng.integers(0, count, (draws, count))].mean(axis=1)


def _traces(study: Study, record: Record, reads: Sequence[dict[str, np.ndarray]]) -> list[Trace]:
    found = []
    for name in record.outputs:
        key = _nearest_noise(study, name, record.pace)
        found.append(
            Trace(record=record.name, channel=name, unit=UNITS[name], role=record.role, time=record.time,
                  measured=record.values[name], base=reads[0][name], extended=reads[1][name],
                  noise=study.noise[key].deviation if key is not None else 0.0)
        )  # fmt: skip
    return found


def _next(base: BaseFit, in_set: Sequence[Explained]) -> NextTest | None:
    """The test that tells the likeliest from the next, or where none does, from the one after it."""
    first, *others = in_set
    tests = (
        design(base, first.fit, other.fit, (first.label, other.label), lambda more: width_of(base, first, more))
        for other in others[:RIVALS_TOLD]
    )
    return next((test for test in tests if test is not None), None)
