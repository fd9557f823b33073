"""The linear response to many changes along a course: the loops of `TangentLinear`, compiled.

Changes go side by side, `LANES` to a block. What is done to a block in a step is printed for a number of states
(`machine_code`); the loops around it, which call that, are plain Python that numba compiles once.

Symbols
    d scaled states (s of them), A(t) Jacobian, g(t) forcing, h a step of the course (n points):  d' = A d + g
    d_k+1 = E d_k + early g_k + late g_k+1,  early = h (phi1 - phi2), late = h phi2
    E = exp(hA), phi1 = (E - I)/hA, phi2 = (phi1 - I)/hA
    (exact for A constant and g straight over a step, however stiff)
    by doubling: phi2(2A) = (phi1^2 + 2 phi2)/4, phi1(2A) = (E + I) phi1/2, E(2A) = E^2
"""

from __future__ import annotations

import functools
import inspect
from dataclasses import dataclass
from types import ModuleType
from typing import Any

import numpy as np

from valvesim.solver import cache, machine_code
from valvesim.solver.codegen import LANES, ONE_AT_A_TIME, second_level, with_replaced
from valvesim.solver.rodas5p import call

FACTORIALS = (1.0, 1.0, 2.0, 6.0, 24.0, 120.0, 720.0, 5040.0)
LARGEST_NORM = 0.25  # of a matrix whose series is taken
OVERFLOW = 1e300  # of a number of use


def product(X, Y, Z, out, share, weight, diagonal):
    """Fill out = share (X Y + weight Z) + diagonal I of matrices (s, s, lanes)."""
    out[:] = share * (np.einsum("ikl,kjl->ijl", X, Y) + weight * Z) + diagonal * np.eye(len(X))[:, :, None]


def advance(E, early, late, d, before, g, out):
    """Fill out = E d + early before + late g of matrices (s, s) and blocks (s or more, lanes)."""
    s = len(E)
    out[:s] = E @ d[:s] + early @ before[:s] + late @ g[:s]


def channel(slope, d, direct, out):
    """Fill out (1, lanes) = direct + slope d of a slope (s,), a block (s, lanes) and a row (lanes,)."""
    out[0] = direct + slope @ d


def accumulate(factor, change, g):
    """Add a factor times a row of changes (lanes,) to a row g (lanes,)."""
    g[:] = g + factor * change


def extend(d, largest):
    """Raise a row of sizes (lanes,) to those of a block (s, lanes) where these are larger; no number is none."""
    largest[:] = np.fmax(largest, np.fmax.reduce(np.abs(d)))


def printed(s: int) -> list[str]:
    """The lines of `product`, `advance`, `channel`, `accumulate` and `extend` for s states."""
    every = range(s)
    lines = ["def product(X, Y, Z, out, share, weight, diagonal):"]
    for i in every:
        for j in every:
            terms = " + ".join(f"X[{i}, {k}] * Y[{k}, {j}]" for k in every)
            rest = " + diagonal" if i == j else ""
            lines.append(f"    out[{i}, {j}] = share * ({terms} + weight * Z[{i}, {j}]){rest}")
    lines.append("def advance(E, early, late, d, before, g, out):")
    for i in every:
        steps = (f"E[{i}, {j}] * d[{j}] + early[{i}, {j}] * before[{j}] + late[{i}, {j}] * g[{j}]" for j in every)
        lines.append(f"    out[{i}] = {' + '.join(steps)}")
    lines.append("def channel(slope, d, direct, out):")
    lines.append(f"    out[0] = direct[0] + {' + '.join(f'slope[{i}] * d[{i}]' for i in every)}")
    lines += ["def accumulate(factor, change, g):", "    g[0] = g[0] + factor * change[0]"]
    lines.append("def extend(d, largest):")
    lines += [f"    largest[0] = maximum(fabs(d[{i}]), largest[0])" for i in every]
    return lines


def propagators(product, A, h, E, early, late):
    """Fill E, early and late (n-1, s, s) of the steps h (n-1,) between the matrices A (n, s, s).

    Some steps at a time, side by side in the last place: what the one of largest norm needs, all of them get.
    """
    n = A.shape[0]
    s, lanes = A.shape[1], LANES
    shape = (s, s, lanes)
    S, P, phi, late_phi, T = np.empty(shape), np.empty(shape), np.empty(shape), np.empty(shape), np.empty(shape)
    for first in range(0, n - 1, lanes):
        norm = 0.0
        for side in range(lanes):
            k = min(first + side, n - 2)
            for i in range(s):
                row = 0.0
                for j in range(s):
                    S[i, j, side] = 0.5 * h[k] * (A[k, i, j] + A[k + 1, i, j])
                    row += abs(S[i, j, side])
                norm = max(norm, row)
        halvings = 0
        while norm > LARGEST_NORM:
            norm *= 0.5
            halvings += 1
        shrink = 0.5**halvings
        for i in range(s):
            for j in range(s):
                for side in range(lanes):
                    S[i, j, side] *= shrink
                    late_phi[i, j, side] = 1.0 / FACTORIALS[7] if i == j else 0.0
        for power in range(6, 1, -1):  # Horner's scheme of phi2 = sum S^k/(k+2)!
            call(product, S, late_phi, S, T, 1.0, 0.0, 1.0 / FACTORIALS[power])
            late_phi, T = T, late_phi
        call(product, S, late_phi, S, phi, 1.0, 0.0, 1.0)
        call(product, S, phi, S, P, 1.0, 0.0, 1.0)
        for _ in range(halvings):  # doubling: no inverse is taken, so that a memory which rests does no harm
            call(product, phi, phi, late_phi, T, 0.25, 2.0, 0.0)
            late_phi, T = T, late_phi
            call(product, P, phi, phi, T, 0.5, 1.0, 0.0)
            phi, T = T, phi
            call(product, P, P, P, T, 1.0, 0.0, 0.0)
            P, T = T, P
        for side in range(min(lanes, n - 1 - first)):
            k = first + side
            for i in range(s):
                for j in range(s):
                    E[k, i, j] = P[i, j, side]
                    early[k, i, j] = h[k] * (phi[i, j, side] - late_phi[i, j, side])
                    late[k, i, j] = h[k] * late_phi[i, j, side]


def propagate(E, early, late, g, d):
    """Fill d (n, s, k) from forcings g (n, s, k), starting at rest: d_0 = -A^-1 g_0 is given in d[0]."""
    for k in range(E.shape[0]):
        for i in range(d.shape[1]):
            for v in range(d.shape[2]):
                value = 0.0
                for j in range(d.shape[1]):
                    value += E[k, i, j] * d[k, j, v] + early[k, i, j] * g[k, j, v] + late[k, i, j] * g[k + 1, j, v]
                d[k + 1, i, v] = value


def read_responses(
    advance, channel, accumulate, extend, E, early, late, start, slopes, changes, place, share, partials, entries,
    rows, columns, factors, entries_at, responses, forced, forced_from, forced_at, scaled, shares, lags, first,
    weights, reads, out, largest,
):  # fmt: skip
    """Fill out (r, blocks, lanes), the responses of channels as they are read, to changes of coefficients, then to
    forcings, at last to one forcing times shares of it, along a course of n points; and `largest` (blocks, lanes), how
    far the states went, endless where they end as no number.

    `changes` (m, q, lanes) are those of a coefficient in a block, at the knots; `place` and `share` (n,) tell where
    points are among these. Of the entries of block b, `entries_at[b]` to `entries_at[b + 1]`, each is a row
    `entries[e]` of the derivatives `partials` (., n): of target `rows[e]`, a rate (s of them) or a channel, by change
    `columns[e]`, and counts `factors[e]` times. Of so many `responses` the last are to forcings, each the rows
    `forced_at[j]` to `forced_at[j + 1]` of `forced` (., s + channels) from point `forced_from[j]` on. The last blocks
    are to the forcing `scaled` (n, s + channels) times each of the `shares` (blocks of these, n, lanes). `start`
    (blocks, s, lanes) are the responses at the first point, `slopes` (channels, n, s) those of the channels over the
    states. Channel j follows with a first-order lag, `lags[j, k]` (how much of its distance is left after step k, and
    of a change added to it; zeros without a lag), and is read `reads[j + 1] - reads[j]` times, each by four points from
    `first` on, none before the last, with `weights` (r, 4).
    """
    s, lanes = slopes.shape[2], LANES
    channels, n, blocks, last = slopes.shape[0], slopes.shape[1], start.shape[0], changes.shape[0] - 1
    change, d, moved = np.empty((changes.shape[1], lanes)), start.copy(), np.empty((blocks, s, lanes))
    g, before = np.zeros((blocks, s + channels, lanes)), np.zeros((blocks, s + channels, lanes))
    recent, following = np.empty((channels, 4, blocks, 1, lanes)), reads[:-1].copy()
    first_scaled = blocks - shares.shape[0]
    distance, value = np.zeros((channels, blocks, lanes)), np.zeros((channels, blocks, lanes))
    largest[:] = 0.0
    for at in range(n):
        here, after, part = place[at], min(place[at] + 1, last), share[at]
        for q in range(changes.shape[1]):
            for v in range(lanes):
                change[q, v] = changes[here, q, v] + part * (changes[after, q, v] - changes[here, q, v])
        g[:] = 0.0
        for b in range(entries_at.shape[0] - 1):
            for e in range(entries_at[b], entries_at[b + 1]):
                factor, i, q = factors[e] * partials[entries[e], at], rows[e], columns[e]
                call(accumulate, factor, change[q], g[b, i])
        for j in range(forced_from.shape[0]):
            row = forced_at[j] + at - forced_from[j]
            if forced_at[j] <= row < forced_at[j + 1]:
                response = responses - forced_from.shape[0] + j
                for i in range(s + channels):
                    g[response // lanes, i, response % lanes] = forced[row, i]
        for b in range(shares.shape[0]):
            for i in range(s + channels):
                if scaled[at, i] != 0.0:
                    call(accumulate, scaled[at, i], shares[b, at], g[first_scaled + b, i])
        if at > 0:
            for b in range(blocks):
                call(advance, E[at - 1], early[at - 1], late[at - 1], d[b], before[b], g[b], moved[b])
            d, moved = moved, d
        for b in range(blocks):
            call(extend, d[b], largest[b])
        before, g = g, before
        for j in range(channels):
            for b in range(blocks):
                call(channel, slopes[j, at], d[b], before[b, s + j], recent[j, at % 4, b])
                if lags[j, 0, 1] != 0.0:
                    for v in range(lanes):
                        new = recent[j, at % 4, b, 0, v]
                        if at > 0:
                            left, ramp = lags[j, at - 1, 0], lags[j, at - 1, 1]
                            distance[j, b, v] = left * distance[j, b, v] - ramp * (new - value[j, b, v])
                        value[j, b, v] = new
                        recent[j, at % 4, b, 0, v] = new + distance[j, b, v]
            while following[j] < reads[j + 1] and first[following[j]] == at - 3:
                r = following[j]
                w0, w1, w2, w3 = weights[r, 0], weights[r, 1], weights[r, 2], weights[r, 3]
                r0, r1, r2, r3 = (at - 3) % 4, (at - 2) % 4, (at - 1) % 4, at % 4
                for b in range(blocks):
                    for v in range(lanes):
                        out[r, b, v] = (
                            w0 * recent[j, r0, b, 0, v] + w1 * recent[j, r1, b, 0, v]
                            + w2 * recent[j, r2, b, 0, v] + w3 * recent[j, r3, b, 0, v]
                        )  # fmt: skip
                following[j] += 1
    for b in range(blocks):
        for i in range(s):
            for v in range(lanes):
                if not abs(d[b, i, v]) < OVERFLOW:  # nor a number
                    largest[b, v] = np.inf


OPTIONS = "error_model='numpy', fastmath={'contract'}"  # a product may be added without rounding


@dataclass(frozen=True, eq=False)
class CompiledResponse:
    """`propagators`, `propagate` and `read_responses` with the functions of a number of states."""

    propagators: Any
    propagate: Any
    read_responses: Any


def compile_response(states: int) -> CompiledResponse:
    """The loops with the functions of a number of states; a few seconds the first time on a machine."""
    with ONE_AT_A_TIME:
        return _compile(states)


CALLED_IN_A_BLOCK = ("advance", "channel", "accumulate", "extend")
"""The printed functions that `read_responses` calls, as it takes them."""


@functools.lru_cache(maxsize=64)
def _compile(states: int) -> CompiledResponse:
    code = machine_code.load_machine_code(["linear response", str(states)], lambda: block_source(states))
    loops = _load_loops()
    return CompiledResponse(
        code.bound(loops.propagators, ["product"]), loops.propagate, code.bound(loops.read_responses, CALLED_IN_A_BLOCK)
    )  # fmt: skip


def block_source(states: int) -> str:
    """The printed functions for a number of states."""
    columns = dict.fromkeys(("X", "Y", "Z", "out", "E", "early", "late"), states)
    return machine_code.with_layout(
        printed(states), lanes=LANES, columns=columns, shared=("E", "early", "late", "slope"),
        numbers=("share", "weight", "diagonal", "factor"),
    )  # fmt: skip


@functools.cache
def _load_loops() -> ModuleType:
    return cache.load(["linear response"], _loops_source, (machine_code.caller, propagators), _call_once)


def _loops_source() -> str:
    """The Python source of the loops, with their lanes in figures, so that loops over them are unrolled."""
    lanes = ("LANES", str(LANES))
    functions = with_replaced(propagators, lanes), inspect.getsource(propagate), with_replaced(read_responses, lanes)
    names = "from valvesim.solver.linear_response import FACTORIALS, OVERFLOW, LARGEST_NORM"
    return machine_code.loops_source(functions, names, OPTIONS)


def _call_once(module: ModuleType) -> None:
    """Each function called on nothing, so that it is compiled here and not in somebody's first run."""
    E, no, nothing = np.zeros((0, 1, 1)), np.zeros(0, dtype=np.int64), np.zeros(0)
    at = np.zeros(1, dtype=np.int64)
    with second_level():
        module.propagators(0, np.zeros((1, 1, 1)), np.ones(0), E, E, E)
        module.propagate(E, E, E, np.zeros((1, 1, 1)), np.zeros((1, 1, 1)))
        module.read_responses(
            *(0 for _ in CALLED_IN_A_BLOCK), E, E, E, np.zeros((0, 1, LANES)), np.zeros((0, 0, 1)),
            np.zeros((1, 0, LANES)), no, nothing, np.zeros((0, 0)), no, no, no, nothing, at,
            0, np.zeros((0, 1)), no, at, np.zeros((0, 1)), np.zeros((0, 0, LANES)), np.zeros((0, 1, 2)), no,
            np.zeros((0, 4)), at, np.zeros((0, 0, LANES)), np.zeros((0, LANES)),
        )  # fmt: skip
