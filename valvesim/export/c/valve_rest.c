/* The valve at rest under its inputs: the static solution, then Newton's method where effects act on a balance.
 *
 * The static solution follows the branch from zero angle at zero current: the first angle at which the torque that is
 * left over vanishes on the way on which it pushes, stops included. At every angle each chamber divides the pressure
 * between its fixed orifice and its nozzle, and the spool balances its forces.
 */
#include "valve.h"

#include <math.h>

#define N VALVE_COUPLED
#define GRID 48       /* angles to a null gap on which the first change of sign is looked for */
#define REACH 3       /* null gaps within which every rest must lie, the flapper's stop bent */
#define SETTLED 1e-9  /* left over of each balance, as a share of its largest term */

typedef struct {
    const double *u, *c;
    double current;
} Held;

/* Pressure of a chamber at rest: Newton's method, halving the bracket where a step leaves it. */
static double chamber_pressure(const Held *held, int side, double q[4], double guess)
{
    const double supply = held->u[VALVE_INPUT_SUPPLY_PRESSURE], back = held->u[VALVE_INPUT_RETURN_PRESSURE];
    double low = (supply < back) ? supply : back, high = (supply < back) ? back : supply;
    double p = (guess < low) ? low : ((guess > high) ? high : guess);
    int turn;
    for (turn = 0; turn < 80; turn++) {
        double surplus[2], next, moved;
        q[side] = p;
        if (side == 1) {
            valve_model_rest_surplus_1(q, held->u, held->c, surplus);
        } else {
            valve_model_rest_surplus_2(q, held->u, held->c, surplus);
        }
        if (surplus[0] == 0.0) {
            break;
        }
        if (surplus[0] > 0.0) {
            low = p;
        } else {
            high = p;
        }
        next = p - surplus[0] / surplus[1];
        if (!((next >= low) && (next <= high)) || ((turn > 8) && (turn % 3 == 0))) {
            next = 0.5 * (low + high);
        }
        moved = fabs(next - p);
        p = next;
        if ((moved <= 4e-16 * fabs(p)) || (high - low <= 4e-16 * high)) {
            break;
        }
    }
    q[side] = p;
    return p;
}

/* Torque left over at a held angle; q and the spool's position come out too. */
static double torque(const Held *held, double theta, double q[4], double *spool)
{
    double guess[2], balance[2];
    q[0] = theta;
    q[3] = held->current;
    valve_model_rest_guess(q, held->u, held->c, guess);
    (void)chamber_pressure(held, 1, q, guess[0]);
    (void)chamber_pressure(held, 2, q, guess[1]);
    valve_model_rest_balance(q, held->u, held->c, balance);
    *spool = balance[1];
    return balance[0];
}

/* The zero between a and b: false position with Anderson and Bjorck's weight, halving at times. */
static double bracketed_root(const Held *held, double a, double f_a, double b, double f_b, double gap)
{
    double q[4], spool;
    int turn;
    for (turn = 0; turn < 120; turn++) {
        const double least = (a < b) ? a : b, most = (a < b) ? b : a;
        double x = (a * f_b - b * f_a) / (f_b - f_a), f_x;
        int settled;
        if (!isfinite(x) || (turn % 4 == 3)) {
            x = 0.5 * (a + b);
        }
        x = (x < least) ? least : ((x > most) ? most : x);
        f_x = torque(held, x, q, &spool);
        settled = ((fabs(x - b) <= 1e-15 * gap) && (turn > 0)) || (f_x == 0.0) || (fabs(a - x) <= 1e-15 * gap);
        if (f_x * f_b < 0.0) {
            a = b;
            f_a = f_b;
        } else {
            const double weight = 1.0 - f_x / f_b;
            f_a *= (isfinite(weight) && (weight > 0.0)) ? weight : 0.5;
        }
        b = x;
        f_b = f_x;
        if (settled) {
            break;
        }
    }
    return b;
}

/* The first zero of the torque from `start` on the way on which it pushes; not found: *found is 0. */
static double first_root(const Held *held, double start, double gap, int *found)
{
    double q[4], spool, before = start, f_before = torque(held, start, q, &spool);
    const double way = (f_before > 0.0) ? 1.0 : -1.0;
    int k;
    *found = 1;
    if (f_before == 0.0) {
        return start;
    }
    for (k = 1; k <= REACH * GRID; k++) {
        const double theta = start + way * gap * (double)k / (double)GRID, f = torque(held, theta, q, &spool);
        if (f * way <= 0.0) {
            return bracketed_root(held, before, f_before, theta, f, gap);
        }
        before = theta;
        f_before = f;
    }
    *found = 0;
    return before;
}

/* The least change x that solves matrix x = right in the least squares, by a one-sided Jacobi decomposition: where
 * several states could give way, as the memories of friction can, all do a little. */
static void least_squares(double matrix[N][N], const double right[N], double x[N])
{
    double V[N][N], largest = 0.0;
    int i, j, k, sweep;
    for (i = 0; i < N; i++) {
        for (j = 0; j < N; j++) {
            V[i][j] = (i == j) ? 1.0 : 0.0;
        }
    }
    for (sweep = 0; sweep < 60; sweep++) {
        int rotated = 0;
        for (j = 0; j < N - 1; j++) {
            for (k = j + 1; k < N; k++) {
                double alpha = 0.0, beta = 0.0, gamma = 0.0, zeta, t, cosine, sine;
                for (i = 0; i < N; i++) {
                    alpha += matrix[i][j] * matrix[i][j];
                    beta += matrix[i][k] * matrix[i][k];
                    gamma += matrix[i][j] * matrix[i][k];
                }
                if ((gamma == 0.0) || (fabs(gamma) <= 1e-15 * sqrt(alpha * beta))) {
                    continue;
                }
                rotated = 1;
                zeta = (beta - alpha) / (2.0 * gamma);
                t = ((zeta > 0.0) ? 1.0 : -1.0) / (fabs(zeta) + sqrt(1.0 + zeta * zeta));
                cosine = 1.0 / sqrt(1.0 + t * t);
                sine = cosine * t;
                for (i = 0; i < N; i++) {
                    const double a = matrix[i][j], b = matrix[i][k], v = V[i][j], w = V[i][k];
                    matrix[i][j] = cosine * a - sine * b;
                    matrix[i][k] = sine * a + cosine * b;
                    V[i][j] = cosine * v - sine * w;
                    V[i][k] = sine * v + cosine * w;
                }
            }
        }
        if (!rotated) {
            break;
        }
    }
    for (j = 0; j < N; j++) {
        double square = 0.0;
        x[j] = 0.0;
        for (i = 0; i < N; i++) {
            square += matrix[i][j] * matrix[i][j];
        }
        largest = (square > largest) ? square : largest;
    }
    for (j = 0; j < N; j++) {
        double square = 0.0, share = 0.0;
        for (i = 0; i < N; i++) {
            square += matrix[i][j] * matrix[i][j];
            share += matrix[i][j] * right[i];
        }
        if (square > 1e-26 * largest) {
            for (i = 0; i < N; i++) {
                x[i] += V[i][j] * share / square;
            }
        }
    }
}

static double left_over(const double rates[N], const double scale[N])
{
    double most = 0.0;
    int i;
    for (i = 0; i < N; i++) {
        const double share = fabs(rates[i] / scale[i]);
        if (!isfinite(share)) {
            return INFINITY;
        }
        most = (share > most) ? share : most;
    }
    return most;
}

/* Scaled states at which every rate vanishes, next to those given. */
ValveStatus valve_settle(Valve *valve, double y[VALVE_COUPLED])
{
    static const double still[VALVE_PREPARED + VALVE_INPUTS];
    double rates[N], late[N], J[N][N], scale[N], step[N], right[N], ahead[N];
    const double *u = valve->inputs, *c = valve->prepared;
    int i, j, turn;
    valve->culprit = 0;
    for (turn = 0; turn < 60; turn++) {
        double size, share = 1.0, most = 0.0, now;
        for (i = 0; i < N; i++) {
            for (j = 0; j < N; j++) {
                J[i][j] = 0.0; /* where the pattern has none */
            }
        }
        valve_model_linearise(y, u, still, c, still, rates, J, late);
        for (i = 0; i < N; i++) {
            scale[i] = 1e-300;
            for (j = 0; j < N; j++) {
                if (!isfinite(J[i][j])) {
                    valve->culprit = i;
                    return VALVE_NO_REST;
                }
                scale[i] = (fabs(J[i][j]) > scale[i]) ? fabs(J[i][j]) : scale[i];
            }
        }
        for (i = 0; i < N; i++) {
            for (j = 0; j < N; j++) {
                J[i][j] /= scale[i];
            }
            right[i] = -rates[i] / scale[i];
        }
        size = left_over(rates, scale);
        least_squares(J, right, step);
        for (;;) {
            for (i = 0; i < N; i++) {
                ahead[i] = y[i] + share * step[i];
            }
            valve_model_rates(ahead, u, c, rates);
            now = left_over(rates, scale);
            if ((now <= (1.0 - 0.1 * share) * size + 1e-14) || (share <= 1e-3)) {
                break;
            }
            share *= 0.5;
        }
        for (i = 0; i < N; i++) {
            y[i] = ahead[i];
            if (!(fabs(step[i]) <= most)) {
                most = fabs(step[i]);
                valve->culprit = i;
            }
        }
        if ((share * most < 1e-12) || ((share == 1.0) && (most < 1e-10))) {
            return (now < SETTLED) ? VALVE_OK : VALVE_NO_REST;
        }
    }
    return VALVE_NO_REST;
}

ValveStatus valve_rest(Valve *valve)
{
    double about[2], q[4], spool, theta, above, below, y[N];
    const double command = valve->inputs[VALVE_INPUT_COMMAND], command_rate = valve->inputs[VALVE_INPUT_COMMAND_RATE];
    Held held;
    int i, found;
    ValveStatus status = VALVE_OK;
    held.u = valve->inputs;
    held.c = valve->coefficients;
    valve_model_rest_current(valve->inputs, valve->coefficients, about); /* current, and null gap over nozzle arm */
    held.current = 0.0;
    theta = first_root(&held, 0.0, about[1], &found);
    above = torque(&held, theta + 1e-5 * about[1], q, &spool);
    below = torque(&held, theta - 1e-5 * about[1], q, &spool);
    valve->culprit = 0;
    if (!found || (fabs(theta) >= about[1]) || (above >= below)) {
        return VALVE_NULL_UNSTABLE;
    }
    held.current = about[0];
    if (held.current != 0.0) {
        theta = first_root(&held, theta, about[1], &found);
        if (!found) {
            return VALVE_NO_REST;
        }
    }
    (void)torque(&held, theta, q, &spool);
    for (i = 0; i < N; i++) {
        y[i] = 0.0;
    }
    y[VALVE_STATE_ARMATURE_ANGLE] = theta;
    y[VALVE_STATE_NOZZLE_PRESSURE_1] = q[1];
    y[VALVE_STATE_NOZZLE_PRESSURE_2] = q[2];
    y[VALVE_STATE_SPOOL_POSITION] = spool;
#ifdef VALVE_STATE_DRIVE_CURRENT
    y[VALVE_STATE_DRIVE_CURRENT] = held.current;
#endif
    for (i = 0; i < N; i++) {
        y[i] /= valve_state_table[i].scale;
    }
    if (VALVE_SETTLES) {
        valve->inputs[VALVE_INPUT_COMMAND_RATE] = 0.0;
        status = valve_settle(valve, y);
        valve->inputs[VALVE_INPUT_COMMAND_RATE] = command_rate;
        valve->inputs[VALVE_INPUT_COMMAND] = command;
    }
    for (i = 0; i < N; i++) {
        valve->states[i] = y[i] * valve_state_table[i].scale;
    }
    return status;
}
