"""How small changes of a valve show in its sensors: the linearised equations along a trajectory, solved for many at
once.

A change of an effect or an unknown term is a forcing: what it adds to the rates along the trajectory, and to what the
sensors read directly; that of a parameter is one by the derivatives of the equations with respect to their
coefficients. The valve answers linearly with its Jacobian along the trajectory. So one run of the valve gives the
answer to some hundred changes, each exact as its size goes to zero.

Symbols
    d scaled states, A Jacobian, g forcing:  d' = A d + g;  E, early, late of a step: `solver.linear_response`
"""

from __future__ import annotations

import functools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from valvesim.identification.predictor import RecordPredictor, Trajectory
from valvesim.solver.codegen import LANES
from valvesim.solver.linear_response import compile_response
from valvesim.solver.partial_derivatives import CoefficientCourse, CompiledDerivatives
from valvesim.valve.laws import lag_of_step

DIVERGED = 1e100  # scaled: squares of what is larger overflow


def relaxation_recursion(a, decay, share, z):
    """Fill z (n,): z_k+1 = decay_k z_k + share_k a_k."""
    for k in range(a.shape[0]):
        z[k + 1] = decay[k] * z[k] + share[k] * a[k]


@functools.cache
def _relaxation() -> Any:
    from numba import njit

    return njit(cache=True, nogil=True, error_model="numpy")(relaxation_recursion)


def first_order_response(a: np.ndarray, b: np.ndarray, step: np.ndarray | float) -> np.ndarray:
    """z (n,) of z' = a - b z: a and b (n,) at rest, then constant over each of n - 1 steps (n - 1,) or of one length;
    starts at rest.
    """
    z = np.empty(len(a))
    z[0] = a[0] / b[0] if b[0] * np.max(step, initial=0.0) > 1e-12 else 0.0
    a, b = np.array(a[1:]), np.array(b[1:])
    decay = np.exp(-b * step)
    share = np.where(np.abs(b * step) > 1e-9, -np.expm1(-b * step) / np.where(b == 0.0, 1.0, b), step)
    _relaxation()(a, decay, share, z)
    return z


def memory_response(a: np.ndarray, B: np.ndarray, step: np.ndarray) -> np.ndarray:
    """z (n, s) of z' = a - B z: a (n, s) and B (n, s, s) at rest, then constant over each of n - 1 steps (n - 1,);
    starts at rest. Where one is of another, B must stay as it is.
    """
    s = a.shape[1]
    if not (B[:, ~np.eye(s, dtype=bool)]).any():
        return np.stack([first_order_response(a[:, k], B[:, k, k], step) for k in range(s)], axis=-1)
    E, early, late = propagators_of(-B, np.asarray(step, dtype=float))
    z = np.empty((len(a), s, 1))
    z[0, :, 0] = np.linalg.lstsq(B[0], a[0], rcond=1e-12)[0]
    compile_response(s).propagate(E, np.zeros_like(E), early + late, np.ascontiguousarray(a[:, :, None]), z)
    return z[:, :, 0]


def propagators_of(A: np.ndarray, h: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """E, early and late (n-1, s, s) of the steps h (n-1,) between the matrices A (n, s, s), see
    `solver.linear_response`.
    """
    E, early, late = (np.empty((len(A) - 1, *A.shape[1:])) for _ in range(3))
    compile_response(A.shape[1]).propagators(np.ascontiguousarray(A), h, E, early, late)
    return E, early, late


class Sampling(NamedTuple):
    """How a channel is read: with a first-order `lag` (s), and each time by four points of the course from `first` (r,)
    on, rising, by `weights` (r, 4).
    """

    first: np.ndarray
    weights: np.ndarray
    lag: float = 0.0


def sampled_at(times: np.ndarray, at: np.ndarray, lag: float = 0.0) -> Sampling:
    """Sampling at times (r,), none before the last, of what is at times (n,), four or more: by cubics through the four
    points about each (Lagrange).
    """
    first = np.clip(np.searchsorted(times, at, "right") - 2, 0, len(times) - 4)
    about = times[first + np.arange(4)[:, None]]
    weights = np.empty((len(at), 4))
    for j in range(4):
        others = [i for i in range(4) if i != j]
        weights[:, j] = np.prod([(at - about[i]) / (about[j] - about[i]) for i in others], axis=0)
    return Sampling(first, weights, lag)


class Forcing(NamedTuple):
    """What a change adds to the scaled rates (rows, s) and directly to channels, by name (rows,), from a point of the
    course on; before and after it adds nothing.
    """

    start: int
    rates: np.ndarray
    direct: Mapping[str, np.ndarray]


class ScaledForcing(NamedTuple):
    """One forcing (n points, from the first on) times each of the `shares` (n, k) of it: k changes."""

    whole: Forcing
    shares: np.ndarray


@dataclass(frozen=True, eq=False)
class TangentLinear:
    """The equations linear along a trajectory of `steps` (n-1,) in s: `response` solves them, `slopes` are those of the
    channels over the states (the output matrix).
    """

    active: np.ndarray  # indices of the states that take part
    scale: np.ndarray
    A: np.ndarray
    E: np.ndarray
    early: np.ndarray
    late: np.ndarray
    slopes: dict[str, np.ndarray]  # channel -> (n, s), d(channel)/d(scaled state)
    steps: np.ndarray

    def response(self, forcing: np.ndarray) -> np.ndarray:
        """Sensitivities (n, s, k) of the scaled states to forcings (n, s, k) of the scaled rates, at rest with the
        first.

        Zero where one grows without end: along a trajectory that limit cycles the linearised equations tell nothing.
        """
        g = np.ascontiguousarray(forcing)
        d = np.empty_like(g)
        d[0] = self._at_rest(g[0])
        compile_response(len(self.active)).propagate(self.E, self.early, self.late, g, d)
        bounded = (d.min(axis=(0, 1)) > -DIVERGED) & (d.max(axis=(0, 1)) < DIVERGED)
        d[:, :, ~bounded] = 0.0
        return d

    def _at_rest(self, g: np.ndarray) -> np.ndarray:
        """The scaled states (s, k) at rest under a forcing (s, k): a memory at rest stays where it is."""
        return -np.linalg.lstsq(self.A[0], g, rcond=1e-12)[0]

    def read_responses(
        self,
        reads: Mapping[str, Sampling],
        forcings: Sequence[Forcing],
        changed: ChangedCoefficients | None = None,
        scaled: ScaledForcing | None = None,
    ) -> dict[str, np.ndarray]:
        """The responses (r, k) of channels as they are read, to changed coefficients, then to forcings, then to a
        scaled one. As with `response`, zero where one grows without end.
        """
        names, n, s = list(reads), len(self.A), len(self.active)
        blocks = changed.blocks(self.active, self.scale, names) if changed else ChangedBlocks.none(n)
        given, count = len(blocks.order), len(blocks.order) + len(forcings)
        first_scaled = LANES * -(-count // LANES)
        lengths = [len(one.rates) for one in forcings]
        forced, forced_at = np.zeros((sum(lengths), s + len(names))), np.cumsum([0, *lengths])
        shares, whole = np.zeros((0, n, LANES)), np.zeros((n, s + len(names)))
        if scaled is not None:
            _fill_forcing(whole, scaled.whole, names)
            k = scaled.shares.shape[1]
            padded = np.pad(scaled.shares, ((0, 0), (0, -k % LANES)))
            shares = np.ascontiguousarray(np.moveaxis(padded.reshape(n, -1, LANES), 1, 0))
        start = np.zeros((s, first_scaled + LANES * len(shares)))
        start[:, :given] = blocks.forcing_at_first(s)
        for j, one in enumerate(forcings):
            _fill_forcing(forced[forced_at[j] : forced_at[j + 1]], one, names)
            if one.start == 0 and lengths[j]:
                start[:, given + j] = one.rates[0]
        start[:, first_scaled:] = whole[0, :s, None] * shares[:, 0].reshape(1, -1)
        start = np.ascontiguousarray(np.moveaxis(self._at_rest(start).reshape(s, -1, LANES), 1, 0))
        at = np.cumsum([0, *(len(one.first) for one in reads.values())])
        out, largest = np.full((at[-1], len(start), LANES), np.nan), np.empty((len(start), LANES))
        lags = np.zeros((len(reads), n - 1, 2))
        for k, read in enumerate(reads.values()):
            if read.lag > 0.0:
                lags[k] = np.transpose(lag_of_step(read.lag, self.steps))
        compile_response(s).read_responses(
            self.E, self.early, self.late, start, np.stack([self.slopes[name] for name in names]), blocks.changes,
            blocks.place, blocks.share, blocks.partials, blocks.entries, blocks.rows, blocks.columns, blocks.factors,
            blocks.entries_at, count, forced, np.array([one.start for one in forcings], dtype=np.int64), forced_at,
            whole, shares, lags, np.concatenate([one.first for one in reads.values()]),
            np.concatenate([one.weights for one in reads.values()]), at, out, largest,
        )  # fmt: skip
        last = first_scaled + (scaled.shares.shape[1] if scaled is not None else 0)
        own = np.concatenate([np.argsort(blocks.order), np.arange(given, count), np.arange(first_scaled, last)])
        found, grown = out.reshape(len(out), -1), largest.ravel()[own] >= DIVERGED
        answers = {name: found[at[k] : at[k + 1], own] for k, name in enumerate(names)}
        for answer in answers.values() if grown.any() else ():
            answer[:, grown] = 0.0
        return answers


def _fill_forcing(out: np.ndarray, forcing: Forcing, names: Sequence[str]) -> None:
    """Fill out (rows, s + channels) with what a forcing adds to the scaled rates and to channels of these names."""
    s = forcing.rates.shape[1]
    out[:, :s] = forcing.rates
    for k, name in enumerate(names):
        if name in forcing.direct:
            out[:, s + k] = forcing.direct[name]


@dataclass(frozen=True, eq=False)
class ChangedCoefficients:
    """Small `changes` (m, n_c, k) of coefficients at the knots of a course, and the derivatives `partials` (., n) of
    `compiled` along it.
    """

    changes: np.ndarray
    course: CoefficientCourse
    compiled: CompiledDerivatives
    partials: np.ndarray

    def blocks(self, active: np.ndarray, scale: np.ndarray, names: Sequence[str]) -> ChangedBlocks:
        """The changes in blocks, those beside each other that change the same coefficients; of the rates of the active
        states, and of channels.
        """
        compiled, s = self.compiled, len(active)
        row_of = np.full(compiled.states.stop + len(compiled.signals), -1)
        row_of[active] = np.arange(s)
        factor_of = np.ones(len(row_of))
        factor_of[active] = 1.0 / scale
        for k, name in enumerate(compiled.signals):
            if name in names:
                row_of[compiled.states.stop + k] = s + list(names).index(name)
        entries = compiled.entries(slice(0, len(row_of)), compiled.coefficients)
        entries = entries[row_of[compiled.targets[entries]] >= 0]
        coefficient = compiled.arguments[entries] - compiled.coefficients.start
        moves = np.array(self.changes.any(axis=0))  # (n_c, k)
        order = np.lexsort((np.argmax(moves, axis=0), -moves.sum(axis=0)))
        changes, chosen, columns, at = list[np.ndarray](), list[np.ndarray](), list[np.ndarray](), [0]
        for first in range(0, len(order), LANES):
            own = order[first : first + LANES]
            moving = np.flatnonzero(moves[:, own].any(axis=1))
            place = np.full(len(moves), -1)
            place[moving] = sum(one.shape[1] for one in changes) + np.arange(len(moving))
            changes.append(np.zeros((len(self.changes), len(moving), LANES)))
            changes[-1][:, :, : len(own)] = self.changes[:, moving][:, :, own]
            acts = place[coefficient] >= 0
            chosen.append(entries[acts])
            columns.append(place[coefficient[acts]])
            at.append(at[-1] + len(chosen[-1]))
        every = np.concatenate(chosen)
        targets = compiled.targets[every]
        return ChangedBlocks(
            order, np.concatenate(changes, axis=1), self.course.place, self.course.share, self.partials, every,
            row_of[targets], np.concatenate(columns), factor_of[targets], np.array(at),
        )  # fmt: skip


@dataclass(frozen=True, eq=False)
class ChangedBlocks:
    """Changes of coefficients in blocks, as `solver.linear_response.read_responses` takes them, in another `order`."""

    order: np.ndarray
    changes: np.ndarray
    place: np.ndarray
    share: np.ndarray
    partials: np.ndarray
    entries: np.ndarray
    rows: np.ndarray
    columns: np.ndarray
    factors: np.ndarray
    entries_at: np.ndarray

    @staticmethod
    def none(n: int) -> ChangedBlocks:
        """No change along n points."""
        no = np.zeros(0, dtype=np.int64)
        return ChangedBlocks(
            no, np.zeros((1, 0, LANES)), np.zeros(n, dtype=np.int64), np.zeros(n), np.zeros((0, n)), no, no, no,
            np.zeros(0), np.zeros(1, dtype=np.int64),
        )  # fmt: skip

    def forcing_at_first(self, s: int) -> np.ndarray:
        """What the changes add to the scaled rates at the first point, (s, k)."""
        g = np.zeros((s, LANES * (len(self.entries_at) - 1)))
        for b, (first, last) in enumerate(zip(self.entries_at, self.entries_at[1:], strict=False)):
            for e in range(first, last):
                if self.rows[e] < s:
                    slope = self.factors[e] * self.partials[self.entries[e], 0]
                    g[self.rows[e], LANES * b : LANES * (b + 1)] += slope * self.changes[0, self.columns[e]]
        return g[:, : len(self.order)]


@dataclass(frozen=True, eq=False)
class Course:
    """The points that a record is linearised at, by their `times` (n,): those of its predictor's `grid` (n_grid,) in
    time, fewer where motion is smooth, and more where the equations change fast. `inputs` (n, n_u) and `states`
    (n, n_x) there, and the places of the `samples`.
    """

    times: np.ndarray
    inputs: np.ndarray
    states: np.ndarray
    grid: np.ndarray
    samples: np.ndarray

    @property
    def steps(self) -> np.ndarray:
        """The steps (n-1,) between the points, s."""
        return np.diff(self.times)

    def between(self, on_grid: np.ndarray) -> np.ndarray:
        """What is given on the grid (n_grid, k), at all points: straight between those of the grid."""
        if self.times is self.grid:
            return on_grid
        columns = [np.interp(self.times, self.grid, column) for column in on_grid.T]  # none where inputs stand still
        return np.reshape(columns, (-1, len(self.times))).T

    def midpoints(self, rates: np.ndarray) -> Course:
        """The middles of its steps, by cubics through the states and their rates (n, n_x) at the ends (Hermite): they
        go on where something stops the states and throws them back within a step.
        """
        x, u, h = self.states, self.inputs, self.steps[:, None]
        middle = (x[1:] + x[:-1]) / 2.0 + h * (rates[:-1] - rates[1:]) / 8.0
        times = (self.times[1:] + self.times[:-1]) / 2.0
        return Course(times, (u[1:] + u[:-1]) / 2.0, middle, times, self.samples[:0])


def change_of_jacobian(
    trajectory: Trajectory, compiled: CompiledDerivatives, active: np.ndarray, before: np.ndarray, after: np.ndarray
) -> np.ndarray:
    """By how much d(scaled rate)/d(scaled state) of the `active` states changes (n,), in the norm of largest row sums,
    from the one `before` to that `after` of a trajectory's model, see `CompiledDerivatives.jacobian`.
    """
    scale, sums = _state_scale(trajectory), np.zeros((compiled.states.stop, before.shape[1]))
    for own, e in enumerate(compiled.entries(compiled.states, compiled.states)):
        i, j = compiled.targets[e], compiled.arguments[e]
        if i in active and j in active:
            sums[i] += np.abs(after[own] - before[own]) * (scale[j] / scale[i])
    return sums.max(axis=0, initial=0.0)


def _state_scale(trajectory: Trajectory) -> np.ndarray:
    return np.array([channel.scale for channel in trajectory.model.state_channels])


def linearise_along(
    predictor: RecordPredictor, trajectory: Trajectory, course: Course, active: np.ndarray,
    compiled: CompiledDerivatives, partials: np.ndarray,
) -> TangentLinear:  # fmt: skip
    """The equations along the course of a trajectory, in its `active` states: memories of absent effects take no part.

    `partials` are the derivatives of its model along it.
    """
    scale = _state_scale(trajectory)
    place = {int(k): row for row, k in enumerate(active)}
    A = np.zeros((len(course.times), len(active), len(active)))
    for e in compiled.entries(compiled.states, compiled.states):
        i, j = compiled.targets[e], compiled.arguments[e]
        if i in place and j in place:
            A[:, place[i], place[j]] = partials[e] * (scale[j] / scale[i])
    slopes = _slopes(predictor, place, scale, compiled, partials)
    return TangentLinear(active, scale[active], A, *propagators_of(A, course.steps), slopes, course.steps)


def _slopes(
    predictor: RecordPredictor, place: Mapping[int, int], scale: np.ndarray, compiled: CompiledDerivatives,
    partials: np.ndarray,
) -> dict[str, np.ndarray]:  # fmt: skip
    """d(channel)/d(scaled state), (n, s), of the states that have a `place` among the s."""
    s, slopes = compiled.states.stop, {}
    own = [channel.name for channel in compiled.model.state_channels]
    for name in predictor.record.outputs:
        slopes[name] = np.zeros((partials.shape[1], len(place)))
        if name in own:
            slopes[name][:, place[own.index(name)]] = scale[own.index(name)]
            continue
        at = s + compiled.signals.index(name)
        for e in compiled.entries(slice(at, at + 1), compiled.states):
            if (j := compiled.arguments[e]) in place:
                slopes[name][:, place[j]] = partials[e] * scale[j]
    return slopes
