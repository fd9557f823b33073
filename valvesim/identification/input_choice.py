"""How the command goes between its samples, by what the readings say: straight, with corners, held, smoothly, or with
edges.

Each way is run at the point of a fit, and judged by the chi-square that the linearised equations then predict: straight
lines stay unless another is better by more than chance. The times of edges become nuisance parameters, anywhere within
their interval; a jump whose time no reading can tell thereby weighs nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from valvesim.errors import InputError, SolveError
from valvesim.identification.between_samples import (
    Deviations,
    EdgeDuration,
    EdgeTime,
    Held,
    Smooth,
    corners_of,
    edges_of,
    sampled_edges,
    smooth_command,
    undersampled_share,
)
from valvesim.identification.fit import Fit, FittedCandidate, evaluate_fit, predict_readings, rescored
from valvesim.identification.least_squares import bounded_step
from valvesim.identification.linearised_record import LinearisedRecord
from valvesim.identification.options import IdentificationOptions
from valvesim.identification.predictor import RecordPredictor, Trajectory, is_quasi_static
from valvesim.identification.prior import NominalModel, NuisanceParameter
from valvesim.identification.session import UNITS, Record, Session, value_text
from valvesim.identification.study import PreparedSession, Study, residual_of
from valvesim.valve.effects.sensors import SENSOR_DELAY


@dataclass(frozen=True, eq=False)
class InputChoice:
    """A way in which commands may go between their samples: how it is told, what deviates, and what of it is fitted."""

    name: str
    deviations: Deviations
    parameters: tuple[NuisanceParameter, ...]


STRAIGHT = InputChoice("straight", (), ())
HELD_NAME = "held until the next"
READ_BACK_NAME = "held from the one before, as read back before it changed"


def input_choices(
    session: Session, read_back: bool = False, *, options: IdentificationOptions
) -> tuple[InputChoice, ...]:
    """The ways that are open to a session's commands, the plainest first; last, where it is asked, `read_back`: a
    generator's staircase written down half a sample late, where a hold is half a sample early.

    Those of records sampled too slowly to show the valve's motion go straight: a hold or an edge between two samples
    would be a delay there, and a delay is what a cause may be.
    """
    fast = [record for record in session.records if not is_quasi_static(record, options=options)]
    records = [record for record in fast if record.moves(record.command)]
    if not records:
        return (STRAIGHT,)
    corners: Deviations = tuple((found, 1.0) for r in records if (found := corners_of(r, options=options)) is not None)
    smooth: Deviations = (*((smooth_command(r, options=options), 1.0) for r in records), *corners)
    edges = tuple(
        edge_parameter(record, edge)
        for record in records
        if record.role == "train"
        for edge in edges_fitted(record, options=options)
    )
    choices = [
        STRAIGHT,
        *([InputChoice("joined by straight lines that meet at corners between them", corners, ())] if corners else []),
        InputChoice(HELD_NAME, tuple((Held(r.name, r.command), 1.0) for r in records), ()),
        InputChoice("joined smoothly", smooth, ()),
    ]
    if edges:
        choices += [
            InputChoice("joined by straight lines, with edges at fitted times", corners, edges),
            InputChoice("joined smoothly, with edges at fitted times", smooth, edges),
        ]
    if read_back:
        late = tuple((Held(r.name, r.command, read_back=True), 1.0) for r in records)
        choices.append(InputChoice(READ_BACK_NAME, late, ()))
    return tuple(choices)


def _jumps_of(record: Record, *, options: IdentificationOptions) -> Sequence[EdgeTime]:
    """The jumps of a record's command as edges."""
    return edges_of(record.name, record.command, record.values[record.command], options=options)


def edges_fitted(record: Record, *, options: IdentificationOptions) -> Sequence[EdgeTime | EdgeDuration]:
    """What is fitted of the edges of a record's command: the times of its jumps, and how long those last in which a
    sample was taken.
    """
    sampled = sampled_edges(record, options=options)
    return [*_jumps_of(record, options=options)[: options.input.most_edges], *([sampled] if sampled else [])]


def edge_parameter(record: Record, edge: EdgeTime | EdgeDuration) -> NuisanceParameter:
    """The time of a jump, anywhere within its interval, counted from the middle; or the duration of edges, anything up
    to a step, counted from half of one.
    """
    step = 1.0 / record.rate
    name = f"edge_duration@{record.name}"
    if isinstance(edge, EdgeTime):
        name = f"edge_time@{record.name}:{edge.after}"
    return NuisanceParameter(name, "s", 0.0, step / np.sqrt(12.0), (-0.5 * step, 0.5 * step), input=edge)


def searched_edges(study: Study, fit: Fit) -> np.ndarray:
    """The point (p,) of a fit without candidates, with each edge that is followed by more than noise where in its
    interval it leaves least until the next of them, all else being as it is.

    Leakage peaks and struck stops come and go with an edge: steps of a fit by derivatives end beside them. Each place
    is run, in a record for all its edges at once; edges stay where that leaves no less of the record.
    """
    model, found, options = study.nominal, fit.point.copy(), study.options.input
    low, high = model.limits
    near = fit.trajectories or [None] * len(study.predictors)
    for predictor, read, trajectory in zip(study.predictors, fit.readings, near, strict=True):
        record = predictor.record
        edges = [(p.input.after, k) for k, p in enumerate(model.parameters)
                 if isinstance(p.input, EdgeTime) and p.input.record == record.name
                 and _misfit_after(study, record, read, p.input) >= options.edge_misfit]  # fmt: skip
        if not edges:
            continue
        after, own = np.transpose(sorted(edges))
        places = np.repeat(fit.point[None], options.edge_places + 1, axis=0)
        places[1:, own] = np.linspace(low[own], high[own], options.edge_places)
        moved_reads = (_readings_at(study, predictor, at, trajectory) for at in places[1:])
        squares = np.array([_squared_residuals(study, predictor, each) for each in (read, *moved_reads)])
        left = np.add.reduceat(squares, after + 1, axis=1) + places[:, own] ** 2
        best = np.argmin(left, axis=0)
        best[left[0] - np.min(left, axis=0) <= options.edge_gain] = 0
        moved = fit.point.copy()
        moved[own] = places[best, own]
        if not best.any():
            continue
        ended = _squared_residuals(study, predictor, _readings_at(study, predictor, moved, trajectory))
        if ended.sum() + moved @ moved < squares[0].sum() + fit.point @ fit.point:
            found[own] = moved[own]
    return found


def _readings_at(
    study: Study, predictor: RecordPredictor, point: np.ndarray, near: Trajectory | None
) -> dict[str, np.ndarray]:
    """What the channels of a record read at a point (p,) without candidates, by running it, `near` a trajectory."""
    variant = study.nominal.at(point)
    return predictor.readings(predictor.run(variant, near), variant)


def _squared_residuals(
    study: Study, predictor: RecordPredictor, read: dict[str, np.ndarray], *, beyond_noise: bool = False
) -> np.ndarray:
    """The squares (samples,) of what readings leave of a record, whitened, of all channels together; less those that
    noise alone leaves, where what is left `beyond_noise` is asked.
    """
    record, total = predictor.record, np.zeros(len(predictor.record.time))
    residual = residual_of(record, read)
    for name, white in zip(record.outputs, study.whiten(predictor, residual), strict=True):
        kept = study.noise[name, record.pace].kept(record.usable[name])
        of_noise = study.expected_squares(record, name) if beyond_noise else 0.0
        total[np.flatnonzero(kept)[:: study.stride]] += white[:, 0] ** 2 - of_noise
    return total


def excess_after_jumps(study: Study, fit: Fit) -> float:
    """The chi-square that a fit leaves beyond the noise in the samples after the jumps of the commands."""
    left = 0.0
    for predictor, read in zip(study.predictors, fit.readings, strict=True):
        record, after = predictor.record, np.zeros(len(predictor.record.time), dtype=bool)
        for edge in _jumps_of(record, options=study.options):
            after[edge.after + 1 : edge.after + 1 + study.options.input.settling_samples] = True
        if after.any():
            left += float(np.sum(_squared_residuals(study, predictor, read, beyond_noise=True)[after]))
    return left


def _misfit_after(study: Study, record: Record, read: dict[str, np.ndarray], edge: EdgeTime) -> float:
    """The mean square of what is left in the samples after an edge, in noise deviations, of the worst channel."""
    after = slice(edge.after, edge.after + study.options.input.edge_samples)
    misfits = [0.0]
    for name in record.outputs:
        usable = record.usable[name][after]
        off = (record.values[name] - read[name])[after][usable] / study.noise[name, record.pace].deviation
        misfits += [float(np.mean(off**2))] if usable.any() else []
    return max(misfits)


def choose_inputs(
    study: Study,
    point: np.ndarray,
    linearised: Sequence[LinearisedRecord],
    columns: Sequence[dict[str, np.ndarray]],
    now: InputChoice = STRAIGHT,
    fitted: tuple[FittedCandidate, ...] = (),
) -> InputChoice:
    """The way of the commands that the readings ask for, by a point (p,) near the best fit of a study without any, and
    the candidates that are `fitted` beside it.

    `columns` are the sensitivities there, first of all those of the study's own parameters. Another way than `now` must
    be better by more than chance; straight lines need be no worse.
    """
    p, options = len(point), study.options.input
    known = [{name: each[:, :p] for name, each in own.items()} for own in columns]
    J = study.stack(known)
    gram = J.T @ J
    best, least, reached, straight = now, np.inf, np.inf, np.inf
    delays, starts, near = are_delays(study.nominal), [point], [one.trajectory for one in linearised]
    if np.any(np.abs(point[delays]) > study.options.fit.tolerance_deviations):  # a hold is half a sample late
        starts.append(np.where(delays, 0.0, point))
    choices = input_choices(study.session, now.name == READ_BACK_NAME, options=study.options)
    for choice in sorted(choices, key=lambda one: one.name != now.name):
        nominal = study.nominal.extended(choice.parameters, choice.deviations)
        own = study.with_nominal(nominal)
        own = replace(own, spread=undersampling_spread(own))
        first = own.stack(known) if own.spread else J
        blocks = [first, added_columns(own, linearised, nominal, choice.parameters)] if choice.parameters else [first]
        H = _gram(blocks, gram if first is J else first.T @ first) + np.eye(len(nominal.parameters))
        added = np.zeros(len(choice.parameters))
        tried = [_evaluated(own, np.append(start, added), fitted, near) for start in starts]
        normalisation = own.log_determinant()
        predicted = [
            (_predicted(fit, blocks, H, nominal) + normalisation, fit.rows, fit.chi_square + normalisation)
            for fit in tried
            if fit is not None
        ]
        if not predicted:
            continue
        chi_square, rows, before = min(predicted)
        least = min(least, chi_square) if choice.name == now.name else least
        straight = chi_square if choice.name == STRAIGHT.name else straight
        gain = max(
            options.minimum_gain, options.gain_share * (least - rows), options.linear_share * (before - chi_square)
        )
        if chi_square < least - gain and chi_square < reached:
            best, reached = choice, chi_square
    return STRAIGHT if best is now and straight < least + options.minimum_gain else best


def are_delays(nominal: NominalModel) -> np.ndarray:
    """(p,) True for the parameters that are a sensor's delay."""
    return np.array([p.sensor is not None and p.sensor.name == SENSOR_DELAY.name for p in nominal.parameters])


def _evaluated(
    study: Study, point: np.ndarray, fitted: tuple[FittedCandidate, ...], near: Sequence[Trajectory]
) -> Fit | None:
    """The fit at a point (p,) with candidates, `near` trajectories; None where it cannot be simulated."""
    try:
        return evaluate_fit(study, point, fitted, near)
    except (SolveError, InputError):
        return None


def _gram(blocks: Sequence[np.ndarray], first: np.ndarray) -> np.ndarray:
    """J'J (n, n) of blocks of columns side by side, where that of the first block is known."""
    return np.block([[first if i == j == 0 else a.T @ b for j, b in enumerate(blocks)] for i, a in enumerate(blocks)])


def _predicted(fit: Fit, blocks: Sequence[np.ndarray], H: np.ndarray, nominal: NominalModel) -> float:
    """The chi-square that the linearised equations predict of a fit's next step, within the parameters' bounds; J is in
    blocks of columns, `H` is J'J with the precision of the priors.
    """
    gradient = np.concatenate([block.T @ fit.residual for block in blocks]) - fit.point
    step = bounded_step(H, gradient, nominal.limits - fit.point)
    return float(fit.chi_square - (2.0 * gradient - H @ step) @ step)


def added_columns(
    study: Study,
    linearised: Sequence[LinearisedRecord],
    nominal: NominalModel,
    parameters: Sequence[NuisanceParameter],
) -> np.ndarray:
    """Whitened sensitivities (rows, len(parameters)) to one prior deviation of each, beside trajectories without it."""
    by = study.options.sensitivity.step

    def columns_of(linear: LinearisedRecord) -> dict[str, np.ndarray]:
        inputs = [p.input for p in parameters if p.input is not None]
        own = [k for k, one in enumerate(inputs) if one.record == linear.predictor.record.name]
        here = linear.variant
        middle = replace(here, deviations=(*nominal.variant.deviations, *((one, 0.0) for one in inputs)))
        out = {name: np.zeros((len(read), len(parameters))) for name, read in linear.readings.items()}
        if own:
            moved = linear.input_difference([parameters[k].moved(middle, by) for k in own], middle)
            for name, columns in moved.items():
                out[name][:, own] = columns / by
        return out

    return study.stack([columns_of(linear) for linear in linearised])


def chi_square_of_way(study: Study, fit: Fit) -> float:
    """The chi-square by which a fit under one way of the commands is held against those under others: without what
    that may be wrong by, but for what the samples do not tell (minus twice the log likelihood, up to a constant).
    """
    plain = replace(study, spread=undersampling_spread(study))
    return rescored(plain, fit).chi_square + plain.log_determinant()


def undersampling_spread(prepared: PreparedSession) -> dict[tuple[str, str], np.ndarray]:
    """What readings hang on how commands go on smoothly where their samples do not tell it, by record and channel, (n,)
    in SI; empty where these tell it throughout.
    """
    variant = prepared.nominal.at(np.zeros(len(prepared.nominal.parameters)))
    records = [predictor.record for predictor in prepared.predictors]
    smooth = {one.record for one, _ in variant.deviations if isinstance(one, Smooth)}
    if not any(record.name in smooth and undersampled_share(record, options=prepared.options) for record in records):
        return {}
    lower = tuple((one.of_lower_degree if isinstance(one, Smooth) else one, by) for one, by in variant.deviations)
    try:
        both = [predict_readings(prepared, replace(variant, deviations=each)) for each in (variant.deviations, lower)]
    except (SolveError, InputError):
        return {}
    return {
        (record.name, name): np.abs(one[name] - other[name])
        for record, one, other in zip(records, *both, strict=True)
        for name in record.outputs
    }


def input_spread(prepared: PreparedSession) -> dict[tuple[str, str], np.ndarray]:
    """What a reading hangs on the way of the commands between their samples, by record and channel, (n,) in SI.

    A share of what straight lines would read less, or more: so far any way may be wrong. Edges beyond those that are
    fitted may be anywhere in their intervals.
    """
    nominal = prepared.nominal
    variant = nominal.at(np.zeros(len(nominal.parameters)))
    edges = tuple(each for each in variant.deviations if isinstance(each[0], EdgeTime | EdgeDuration))
    early, late = (_edges_left(prepared, by) if edges else () for by in (-0.5, 0.5))
    variants = [variant, replace(variant, deviations=edges)]
    if early:
        variants += [replace(variant, deviations=(*variant.deviations, *each)) for each in (early, late)]
    try:
        read = [predict_readings(prepared, one) for one in variants]
    except (SolveError, InputError):
        return {}
    share, spread, undersampled = prepared.options.input.spread, {}, undersampling_spread(prepared)
    for k, predictor in enumerate(prepared.predictors):
        for name in predictor.record.outputs:
            own, straight, *ends = (one[k][name] for one in read)
            deviation = share * np.abs(own - straight)
            if ends:
                deviation = np.hypot(deviation, np.abs(ends[1] - ends[0]) / np.sqrt(12.0))  # evenly in between
            deviation = np.hypot(deviation, undersampled.get((predictor.record.name, name), 0.0))
            spread[predictor.record.name, name] = deviation
    return spread


def _edges_left(prepared: PreparedSession, by: float) -> Deviations:
    """The edges of training records that are too many to be fitted, all off by so many steps of their records."""
    records = [predictor.record for predictor in prepared.predictors]
    return tuple(
        (edge, by / record.rate)
        for record in records if record.moves(record.command)
        for edge in _jumps_of(record, options=prepared.options)[prepared.options.input.most_edges :]
    )  # fmt: skip


def input_notes(session: Session, choice: InputChoice, *, options: IdentificationOptions) -> list[str]:
    """What was taken of the commands between their samples, in words."""
    notes = [f"the command's samples were taken as {choice.name}: the readings fit better so than by straight lines"]
    smooth = {one.record for one, _ in choice.deviations if isinstance(one, Smooth)}
    for record in session.training:
        if record.name in smooth and (share := undersampled_share(record, options=options)):
            notes.append(
                f"{record.name}: in {100.0 * share:.3g} % of it the {record.command} moves too fast for its samples "
                f"to tell how, and readings count less; {3.0 * record.rate:.0f} Hz would do"
            )
        edges = [p.input for p in choice.parameters if isinstance(p.input, EdgeTime) and p.input.record == record.name]
        if edges:
            values = record.values[record.command]
            most = max(abs(float(values[edge.after + 1] - values[edge.after])) for edge in edges)
            notes.append(
                f"{record.name}: the {record.command} jumps up to {value_text(most, UNITS[record.command])} within one "
                f"sample, {len(edges)} times; when, was fitted from the readings"
            )
        durations = (p.input for p in choice.parameters if isinstance(p.input, EdgeDuration))
        for lasting in (one for one in durations if one.record == record.name):
            notes.append(
                f"{record.name}: a sample was taken within {len(lasting.at)} edges of the {record.command}; how long "
                "they last was fitted from the readings"
            )
        more = len(_jumps_of(record, options=options)) - options.input.most_edges
        if edges and more > 0:
            notes.append(f"{record.name}: {more} more jumps are too many to fit; noise counts as larger after them")
    return notes
