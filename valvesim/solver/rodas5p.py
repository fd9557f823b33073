"""The integrator: Rodas5P, an L-stable, stiffly accurate Rosenbrock method of order 5.

Chosen since the lightly damped 8 kHz mode of the chambers defeats high-order BDF, because a linear solve with an exact
Jacobian a stage needs no Newton iteration, and because its order does not collapse under time dependent coefficients.
Source of the method and its figures: G. Steinebach, "Construction of Rosenbrock-Wanner method Rodas5P", BIT 63 (2023).

Symbols
    y scaled states, h step, f derivative, J its Jacobian, W = 1/(gamma h) - J, k_i stages, e error of the step
    W k_i = f(t + c_i h, y + sum a_ij k_j) + sum C_ij k_j/h + d_i h df/dt

`integrate` is plain Python that numba compiles; `derivative`, `jacobian` and the two functions of the linear systems
(`solver.elimination`) are printed from a traced model.
"""

from __future__ import annotations

import numpy as np

from valvesim.inputs import piece_value

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

RATE_SPAN = 0.02  # share of a step over which df/dt is taken
FIRST_BEND = 1e4  # tolerances by which a state may bend away, y'' h^2, in the first step after a break or a knot

DONE, TOO_MANY_STEPS, STEP_TOO_SMALL = 0, 1, 2


def set_inputs(rows, t, u):
    """Inputs of the model at time t from the rows of one interval: command with its rate, then the pressures."""
    u[0], u[1] = piece_value(rows[0], t)
    for k in range(1, rows.shape[0]):
        u[k + 1] = piece_value(rows[k], t)[0]


def set_coefficients(knot_times, knots, at, t, c):
    """Coefficients at time t on the straight line between knots `at` and `at` + 1."""
    if at + 1 < knot_times.shape[0]:
        share = (t - knot_times[at]) / (knot_times[at + 1] - knot_times[at])
        for k in range(c.shape[0]):
            c[k] = knots[at, k] + share * (knots[at + 1, k] - knots[at, k])


def integrate(
    derivative, jacobian, factor, back_substitute, y, clock, t_end, starts, rows, knot_times, knots, t_out, out, rtol,
    atol, rest, max_steps, count
):  # fmt: skip
    """Advance scaled states `y` in place from clock[0] to t_end; fill `out` at the times `t_out`; return a status.

    clock: [time, next step, next output index]; all updated, so that a run can go on in slices.
    starts, rows: input pieces between breaks; knot_times (m,), knots (m, n_c): coefficients, straight in between.
    rtol: relative tolerance of a state's distance from `rest` (n,), so that a small motion about a large pressure is
    as exact as a large one. atol (n,): absolute tolerance of each scaled state; infinite where its error does not
    matter.
    count: [accepted, rejected] steps, added to. A step crosses neither a break nor a knot.
    """
    n, n_c = y.shape[0], knots.shape[1]
    f, f_late, u = np.empty(n), np.empty(n), np.empty(rows.shape[1] + 1)
    c, stage_y, new, W = np.empty(n_c), np.empty(n), np.empty(n), np.empty((n, n))
    for k in range(n_c):
        c[k] = knots[0, k]
    J, K, bend = np.empty((n, n)), np.empty((STAGES, n)), np.empty((3, n))
    t, h, at_out = clock[0], clock[1], int(clock[2])
    interval, at, fresh = 0, 0, False
    while interval + 1 < starts.shape[0] and starts[interval + 1] <= t:
        interval += 1
    while at_out < t_out.shape[0] and t_out[at_out] <= t:
        for i in range(n):
            out[at_out, i] = y[i]
        at_out += 1
    status = DONE
    steps = 0
    while t < t_end:
        stop = t_end
        if interval + 1 < starts.shape[0] and starts[interval + 1] < stop:
            stop = starts[interval + 1]
        row = rows[interval]
        while t < stop:
            while at + 2 < knot_times.shape[0] and knot_times[at + 1] <= t:
                at += 1
                fresh = True
            limit = stop
            if at + 2 < knot_times.shape[0] and knot_times[at + 1] < limit:
                limit = knot_times[at + 1]  # coefficients bend or jump there
            set_inputs(row, t, u)
            set_coefficients(knot_times, knots, at, t, c)
            derivative(y, u, c, f)
            jacobian(y, u, c, J)
            if fresh:
                # past a break y' bends by y'' = J f + df/dt; a long step would be right at its end alone
                fresh = False
                delta = RATE_SPAN * min(h, limit - t)
                set_inputs(row, t + delta, u)
                set_coefficients(knot_times, knots, at, t + delta, c)
                derivative(y, u, c, stage_y)
                for i in range(n):
                    bending = (stage_y[i] - f[i]) / delta
                    for j in range(n):
                        bending += J[i, j] * f[j]
                    size = atol[i] + rtol * abs(y[i] - rest[i])
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
                # df/dt by a second-order difference, long enough to stay clear of rounding
                for k in range(2):
                    delta = (k + 1) * RATE_SPAN * h
                    set_inputs(row, t + delta, u)
                    set_coefficients(knot_times, knots, at, t + delta, c)
                    derivative(y, u, c, stage_y)
                    for i in range(n):
                        change = (stage_y[i] - f[i]) / (RATE_SPAN * h)
                        f_late[i] = 2.0 * change if k == 0 else f_late[i] - 0.5 * change
                for i in range(n):
                    for j in range(n):
                        W[i, j] = -J[i, j]
                    W[i, i] += 1.0 / (GAMMA * h)
                finite = factor(W)  # where W is singular the stages are not finite, and the step is refused
                per_h = 1.0 / h
                for i in range(n):
                    K[0, i] = f[i] + h * D[0] * f_late[i]
                back_substitute(W, K[0])
                for s in range(1, STAGES):
                    for i in range(n):
                        advanced, coupled = y[i], 0.0
                        for j in range(s):
                            advanced += A[s, j] * K[j, i]
                            coupled += C[s, j] * K[j, i]
                        new[i] = advanced
                        K[s, i] = coupled * per_h
                    if s < 6:  # the last three stages are at the end of the step
                        set_inputs(row, t + NODES[s] * h, u)
                        set_coefficients(knot_times, knots, at, t + NODES[s] * h, c)
                    derivative(new, u, c, stage_y)
                    for i in range(n):
                        K[s, i] += stage_y[i]
                        if s < 5:
                            K[s, i] += h * D[s] * f_late[i]
                    back_substitute(W, K[s])
                error = 0.0 if finite else 1e10
                for i in range(n):
                    new[i] += K[STAGES - 1, i]
                    size = atol[i] + rtol * max(abs(y[i] - rest[i]), abs(new[i] - rest[i]))
                    share = abs(K[STAGES - 1, i]) / size
                    error = max(error, share) if np.isfinite(share) else 1e10
                if error <= 1.0:
                    break
                count[1] += 1
                free = h * max(0.9 * error**-0.2, 0.1)
            if status != DONE:
                break
            count[0] += 1
            end = limit if h == limit - t else t + h
            if at_out < t_out.shape[0] and t_out[at_out] <= end:
                for k in range(3):
                    for i in range(n):
                        bend[k, i] = 0.0
                        for s in range(STAGES):
                            bend[k, i] += DENSE[k, s] * K[s, i]
            while at_out < t_out.shape[0] and t_out[at_out] <= end:
                share = (t_out[at_out] - t) / h
                for i in range(n):
                    bent = (1.0 - share) * (bend[0, i] + share * (bend[1, i] + share * bend[2, i]))
                    out[at_out, i] = (1.0 - share) * y[i] + share * (new[i] + bent)
                at_out += 1
            for i in range(n):
                y[i] = new[i]
            t = end
            grown = h * min(max(0.85 * max(error, 1e-10) ** -0.2, 0.2), 3.0)
            h = free if h < free else grown  # a step that a break has shortened says nothing of longer ones
        if status != DONE:
            break
        interval += 1
        fresh = True
    clock[0], clock[1], clock[2] = t, h, at_out
    return status
