"""The integrator: Rodas5P, an L-stable, stiffly accurate Rosenbrock method of order 5.

Chosen since the lightly damped 8 kHz mode of the chambers defeats high-order BDF, because a linear solve with an exact
Jacobian a stage needs no Newton iteration, and because its order does not collapse under time dependent coefficients.
Source of the method and its figures: G. Steinebach, "Construction of Rosenbrock-Wanner method Rodas5P", BIT 63 (2023).

Symbols
    y scaled states, h step, f derivative, J its Jacobian, W = 1/(gamma h) - J, k_i stages, e error of the step
    W k_i = f(t + c_i h, y + sum a_ij k_j) + sum C_ij k_j/h + d_i h df/dt

`integrate` is plain Python that numba compiles; what it calls is printed from a traced model (`solver.codegen`) and
from the figures below, a line for each state. The last axis of its arrays are the lanes: valves that take their steps
together, each as short as the most demanding of them needs. One valve is one lane.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from valvesim.inputs import piece_motion

STAGES = 8
GAMMA = 0.21193756319429014
_A6 = [-7.502846399306121, 2.561846144803919, -11.627539656261098, -0.18268767659942256, 0.030198172008377946]
A = np.array(
    [
        [0.0] * 7,
        [3.0] + [0.0] * 6,
        [2.849394379747939, 0.45842242204463923] + [0.0] * 5,
        [-6.954028509809101, 2.489845061869568, -10.358996098473584] + [0.0] * 4,
        [2.8029986275628964, 0.5072464736228206, -0.3988312541770524, -0.04721187230404641] + [0.0] * 3,
        [*_A6, 0.0, 0.0],
        [*_A6, 1.0, 0.0],
        [*_A6, 1.0, 1.0],
    ]
)
C = np.array(
    [
        [0.0] * 7,
        [-14.155112264123755] + [0.0] * 6,
        [-17.97296035885952, -2.859693295451294] + [0.0] * 5,
        [147.12150275711716, -1.41221402718213, 71.68940251302358] + [0.0] * 4,
        [165.43517024871676, -0.4592823456491126, 42.90938336958603, -5.961986721573306] + [0.0] * 3,
        [24.854864614690072, -3.0009227002832186, 47.4931110020768, 5.5814197821558125, -0.6610691825249471, 0.0, 0.0],
        [30.91273214028599, -3.1208243349937974, 77.79954646070892, 34.28646028294783, -19.097331116725623,
         -28.087943162872662, 0.0],
        [37.80277123390563, -3.2571969029072276, 112.26918849496327, 66.9347231244047, -40.06618937091002,
         -54.66780262877968, -9.48861652309627],
    ]
)  # fmt: skip
NODES = np.array([0.0, 0.6358126895828704, 0.4095798393397535, 0.9769306725060716, 0.4288403609558664, 1.0, 1.0, 1.0])
D = np.array([0.21193756319429014, -0.42387512638858027, -0.3384627126235924, 1.8046452872882734, 2.325825639765069])
DENSE = np.array(
    [
        [25.948786856663858, -2.5579724845846235, 10.433815404888879, -2.3679251022685204, 0.524948541321073,
         1.1241088310450404, 0.4272876194431874, -0.17202221070155493],
        [-9.91568850695171, -0.9689944594115154, 3.0438037242978453, -24.495224566215796, 20.176138334709044,
         15.98066361424651, -6.789040303419874, -6.710236069923372],
        [11.419903575922262, 2.8879645146136994, 72.92137995996029, 80.12511834622643, -52.072871366152654,
         -59.78993625266729, -0.15582684282751913, 4.883087185713722],
    ]
)  # fmt: skip

NODE_OF_STAGE = [0, 0, 1, 2, 3, 4, 4, 4]  # from the second stage on; the last three are at the end of the step

FIRST_BEND = 1e4  # tolerances by which a state may bend away, y'' h^2, in the first step after a break or a knot

DONE, TOO_MANY_STEPS, STEP_TOO_SMALL = 0, 1, 2


def print_step(n: int, solve: Sequence[str]) -> list[str]:
    """`step(y, u, c, h, f, f_t, W, K, new, rate)` and what else a step of n states needs, for `straight_line`.

    `solve` are the lines of `elimination`. A step solves for the k of each stage, a call of `rates` between them, and
    leaves the states at its end in `new`.
    """
    lines = ["def step(y, u, c, h, f, f_t, W, K, new, rate):", "    per_h = 1.0 / h"]
    for s in range(STAGES):
        for i in range(n):
            late = f" + {D[s]} * h * f_t[{i}]" if s < len(D) else ""
            coupled = f" + per_h * ({_weighted(C[s, :s], i)})" if s else ""
            lines += [f"    x{i} = {'rate' if s else 'f'}[{i}]{late}{coupled}"]
        lines += [f"    {line}" for line in solve]
        lines += [f"    K[{s}, {i}] = x{i}" for i in range(n)]
        if s + 1 < STAGES:
            lines += [f"    new[{i}] = y[{i}] + {_weighted(A[s + 1, : s + 1], i)}" for i in range(n)]
            at = NODE_OF_STAGE[s + 1]
            lines += [f"    rates(new, u[{at}], c[{at}], rate)"]
        else:
            lines += [f"    new[{i}] = new[{i}] + x{i}" for i in range(n)]
    return [*lines, *_print_output(n), *_print_error(n)]


def _weighted(weights: np.ndarray, i: int) -> str:
    """A sum over the stages."""
    return " + ".join(f"{float(weight)!r} * K[{s}, {i}]" for s, weight in enumerate(weights) if weight)


def _print_output(n: int) -> list[str]:
    """`bend(K, bent)` and `within(y, new, bent, share, out)`: the states at a share of the step."""
    lines = ["def bend(K, bent):"]
    lines += [f"    bent[{k}, {i}] = {_weighted(weights, i)}" for k, weights in enumerate(DENSE) for i in range(n)]
    lines += ["def within(y, new, bent, share, out):", "    left = 1.0 - share"]
    for i in range(n):
        curve = f"left * (bent[0, {i}] + share * (bent[1, {i}] + share * bent[2, {i}]))"
        lines += [f"    out[{i}] = left * y[{i}] + share * (new[{i}] + {curve})"]
    return lines


def _print_error(n: int) -> list[str]:
    """`error(y, new, K, rest, atol, rtol, e)`: the worst of the states in tolerances, and the sum of them."""
    lines = ["def error(y, new, K, rest, atol, rtol, e):"]
    for i in range(n):
        size = f"atol[{i}] + rtol * maximum(fabs(y[{i}] - rest[{i}]), fabs(new[{i}] - rest[{i}]))"
        lines += [f"    e{i} = fabs(K[{STAGES - 1}, {i}]) / ({size})"]
    worst = "e0"
    for i in range(1, n):
        worst = f"maximum({worst}, e{i})"
    return [*lines, f"    e[0] = {worst}", f"    e[1] = {' + '.join(f'e{i}' for i in range(n))}"]


def set_inputs(rows, interval, t, u, u_t):
    """Inputs of the model at time t, and how fast they change: command, its rate, then the pressures."""
    u[0], u[1], u_t[1] = piece_motion(rows[interval, 0], t)
    u_t[0] = u[1]
    for k in range(1, rows.shape[1]):
        u[k + 1], u_t[k + 1], _ = piece_motion(rows[interval, k], t)


def set_inputs_of_step(rows, interval, t, h, u, rated):
    """Inputs at the nodes of a step from t on: (nodes, inputs); the rate of the command where the model is `rated`."""
    for k in range(rows.shape[1]):
        row = rows[interval, k]
        at = k + 1 if k else 0
        for node in range(5):
            u[node, at], rate, _ = piece_motion(row, t + NODES[node + 1] * h)
            if rated and k == 0:
                u[node, 1] = rate


def set_coefficients_of_step(c, c_t, past, h, out):
    """Coefficients at the nodes of a step that begins `past` the knot of c: (nodes, n_c, lanes)."""
    for node in range(5):
        late = past + NODES[node + 1] * h
        for k in range(c.shape[0]):
            for lane in range(c.shape[1]):
                out[node, k, lane] = c[k, lane] + late * c_t[k, lane]


def copy_rows(rows, out):
    """Copy rows (n, lanes), element by element: an assignment of slices takes seconds to compile."""
    for k in range(rows.shape[0]):
        for lane in range(rows.shape[1]):
            out[k, lane] = rows[k, lane]


def call(function, *arguments):
    """Call a printed function, here one of Python; in compiled code it is `machine_code.caller`'s, by an address."""
    function(*arguments)


def integrate(
    prepare, linearise, factor, step, error, bend, within, n_c, rated, y, clock, t_end, starts, rows, knot_times,
    knots, t_out, out, rtol, atol, rest, max_steps, count
):  # fmt: skip
    """Advance scaled states `y` (n, lanes) in place from clock[0] to t_end; return a status.

    clock: [time, next step, next output index]; all updated, so that a run can go on in slices.
    starts, rows: input pieces between breaks; knot_times (m,), knots (m, ..., lanes): coefficients, which `prepare`
    turns into the n_c that the equations use, straight in between. rated: whether the rate of the command is felt.
    t_out (n_t,), out (n_t, n, lanes): times of the output, which is filled.
    rtol: relative tolerance of a state's distance from `rest` (n, lanes), so that a small motion about a large pressure
    is as exact as a large one. atol (n,): absolute tolerance of each scaled state; infinite where its error does not
    matter.
    count: [accepted, rejected] steps, added to. A step crosses neither a break nor a knot.
    """
    n, lanes = y.shape
    u, u_t, u_late = np.empty(rows.shape[1] + 1), np.empty(rows.shape[1] + 1), np.empty((5, rows.shape[1] + 1))
    c, c_knot, c_next = np.empty((n_c, lanes)), np.empty((n_c, lanes)), np.empty((n_c, lanes))
    c_t, c_late = np.empty((n_c, lanes)), np.empty((5, n_c, lanes))
    f, f_t, J = np.empty((n, lanes)), np.empty((n, lanes)), np.empty((n, n, lanes))
    W, pivots, K = np.empty((n, n, lanes)), np.empty((1, lanes)), np.empty((STAGES, n, lanes))
    new, rate = np.empty((n, lanes)), np.empty((n, lanes))
    e, bent = np.empty((2, lanes)), np.empty((3, n, lanes))
    for lane in range(lanes):
        for k in range(n_c):
            c_t[k, lane] = 0.0
        for i in range(n):
            for j in range(n):
                J[i, j, lane] = 0.0  # where no entry is, none will be written
    t, h, at_out = clock[0], clock[1], int(clock[2])
    interval, at, prepared, fresh, moving = 0, 0, -1, False, False
    while interval + 1 < starts.shape[0] and starts[interval + 1] <= t:
        interval += 1
    while at_out < t_out.shape[0] and t_out[at_out] <= t:
        copy_rows(y, out[at_out])
        at_out += 1
    status = DONE
    steps = 0
    while t < t_end:
        stop = t_end
        if interval + 1 < starts.shape[0] and starts[interval + 1] < stop:
            stop = starts[interval + 1]
        while t < stop:
            while at + 2 < knot_times.shape[0] and knot_times[at + 1] <= t:
                at += 1
                fresh = True
            limit = stop
            if at + 2 < knot_times.shape[0] and knot_times[at + 1] < limit:
                limit = knot_times[at + 1]  # coefficients bend or jump there
            if at != prepared:
                call(prepare, knots[at], c_knot)
                moving = at + 1 < knot_times.shape[0]
                if moving:
                    call(prepare, knots[at + 1], c_next)
                    for k in range(n_c):
                        for lane in range(lanes):
                            c_t[k, lane] = (c_next[k, lane] - c_knot[k, lane]) / (knot_times[at + 1] - knot_times[at])
                set_coefficients_of_step(c_knot, c_t, 0.0, 0.0, c_late)
                prepared = at
            for k in range(n_c):
                for lane in range(lanes):
                    c[k, lane] = c_knot[k, lane] + (t - knot_times[at]) * c_t[k, lane]
            set_inputs(rows, interval, t, u, u_t)
            call(linearise, y, u, u_t, c, c_t, f, J, f_t)
            if fresh:
                # past a break y' bends by y'' = J f + df/dt; a long step would be right at its end alone
                fresh = False
                for i in range(n):
                    for lane in range(lanes):
                        bending = f_t[i, lane]
                        for j in range(n):
                            bending += J[i, j, lane] * f[j, lane]
                        size = atol[i] + rtol * abs(y[i, lane] - rest[i, lane])
                        if abs(bending) * h * h > FIRST_BEND * size:
                            h = np.sqrt(FIRST_BEND * size / abs(bending))
            free = h  # the step that the error control wants, before any break shortens it
            while True:
                steps += 1
                if steps > max_steps:
                    status = TOO_MANY_STEPS
                    break
                h = min(free, limit - t)
                if t + 1.01 * h >= limit:
                    h = limit - t
                if h < 1e-14 * max(abs(t), 1.0) and h < limit - t:
                    status = STEP_TOO_SMALL
                    break
                set_inputs_of_step(rows, interval, t, h, u_late, rated)
                if moving:
                    set_coefficients_of_step(c_knot, c_t, t - knot_times[at], h, c_late)
                call(factor, J, 1.0 / (GAMMA * h), W, pivots)
                call(step, y, u_late, c_late, h, f, f_t, W, K, new, rate)
                call(error, y, new, K, rest, atol, rtol, e)
                worst = 0.0
                for lane in range(lanes):  # the stages may be finite where W is singular
                    finite = np.isfinite(e[1, lane]) and np.isfinite(pivots[0, lane])
                    worst = max(worst, e[0, lane]) if finite else 1e10
                if worst <= 1.0:
                    break
                count[1] += 1
                free = h * max(0.9 * worst**-0.2, 0.1)
            if status != DONE:
                break
            count[0] += 1
            end = limit if h == limit - t else t + h
            if at_out < t_out.shape[0] and t_out[at_out] <= end:
                call(bend, K, bent)
            while at_out < t_out.shape[0] and t_out[at_out] <= end:
                call(within, y, new, bent, (t_out[at_out] - t) / h, out[at_out])
                at_out += 1
            copy_rows(new, y)
            t = end
            grown = h * min(max(0.85 * max(worst, 1e-10) ** -0.2, 0.2), 3.0)
            h = free if h < free else grown  # a step that a break has shortened says nothing of longer ones
        if status != DONE:
            break
        interval += 1
        fresh = True
    clock[0], clock[1], clock[2] = t, h, at_out
    return status
