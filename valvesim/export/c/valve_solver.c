/* The integrator: Rodas5P, an L-stable, stiffly accurate Rosenbrock method of order 5, as valvesim's own.
 *
 * Source of the method and its figures: G. Steinebach, "Construction of Rosenbrock-Wanner method Rodas5P", BIT 63
 * (2023). y scaled states, h step, f derivative, J its Jacobian, W = 1/(gamma h) - J, k stages:
 *     W k_i = f(t + c_i h, y + sum a_ij k_j) + sum C_ij k_j/h + d_i h df/dt
 * Coefficients run straight between knots in time, which are set so close that they would.
 */
#include "valve.h"

#include <math.h>

#define N VALVE_COUPLED
#define STAGES VALVE_TABLEAU_STAGES /* the method's figures stand in valve_model.h, printed from valvesim's own */
#define GAMMA VALVE_TABLEAU_GAMMA
#define MOST_HALVINGS 16 /* of an advance, between two knots */
#define MOST_STEPS 50000000.0

static const double A[STAGES][STAGES] = VALVE_TABLEAU_A;
static const double C[STAGES][STAGES] = VALVE_TABLEAU_C;
static const double NODES[STAGES] = VALVE_TABLEAU_NODES;
static const double D[STAGES] = VALVE_TABLEAU_D; /* zero from the sixth on */

/* A stretch of an advance on which the coefficients run straight. Times are seconds since the advance began. */
typedef struct {
    double begin, end;
    double first[VALVE_COEFFICIENTS], change[VALVE_COEFFICIENTS];
    int bent;    /* the coefficients change */
    int driven;  /* the inputs change */
    const double *cold, *warm; /* temperatures at both ends */
    const ValveHooks *hooks;
} Stretch;

static void inputs_at(const Valve *valve, const ValveHooks *hooks, double t, double u[VALVE_INPUTS])
{
    int k;
    for (k = 0; k < VALVE_INPUTS; k++) {
        u[k] = valve->inputs[k] + t * (valve->slopes[0][k] + 0.5 * t * (valve->slopes[1][k] + t / 3.0 * valve->slopes[2][k]));
    }
    if ((hooks != NULL) && (hooks->inputs_at != NULL)) {
        hooks->inputs_at(hooks->context, t, u);
    } else if (valve->slopes[0][VALVE_INPUT_COMMAND] != 0.0) {
        u[VALVE_INPUT_COMMAND_RATE] = valve->slopes[0][VALVE_INPUT_COMMAND]
            + t * (valve->slopes[1][VALVE_INPUT_COMMAND] + 0.5 * t * valve->slopes[2][VALVE_INPUT_COMMAND]);
    }
}

static void conditions_at(const Valve *valve, const Stretch *stretch, double t, double u[], double c[])
{
    int k;
    if (stretch->driven) {
        inputs_at(valve, stretch->hooks, t, u);
    }
    if (stretch->bent) {
        const double share = (t - stretch->begin) / (stretch->end - stretch->begin);
        for (k = 0; k < VALVE_COEFFICIENTS; k++) {
            c[k] = stretch->first[k] + share * stretch->change[k];
        }
    }
}

static double larger(double a, double b)
{
    return (a > b) ? a : b;
}

static double size_of(const Valve *valve, double a, double b, int i)
{
    const double far = larger(fabs(a - valve->rest[i]), fabs(b - valve->rest[i]));
    return VALVE_ABSOLUTE_SHARE * valve->tolerance + valve->tolerance * far;
}

/* One step from y to new_y; returns its error in tolerances, 1e10 where it is no number. */
static double rosenbrock_step(const Valve *valve, const Stretch *stretch, double t, double h, const double y[N],
                              const double f[N], double J[N][N], double u[], double c[], double new_y[N])
{
    double W[N][N], K[STAGES][N], slope[N], late[N];
    double error;
    int i, j, s;
    const int moving = stretch->driven || stretch->bent;
    for (i = 0; i < N; i++) {
        late[i] = 0.0;
    }
    if (moving) { /* df/dt by a second-order difference, long enough to stay clear of rounding */
        for (s = 0; s < 2; s++) {
            conditions_at(valve, stretch, t + (double)(s + 1) * VALVE_RATE_SPAN * h, u, c);
            valve_model_derivative(y, u, c, valve->parameters, slope);
            for (i = 0; i < N; i++) {
                const double rate = (slope[i] - f[i]) / (VALVE_RATE_SPAN * h);
                late[i] = (s == 0) ? 2.0 * rate : late[i] - 0.5 * rate;
            }
        }
    }
    for (i = 0; i < N; i++) {
        for (j = 0; j < N; j++) {
            W[i][j] = -J[i][j];
        }
        W[i][i] += 1.0 / (GAMMA * h);
    }
    error = valve_model_factor(W) ? 0.0 : 1e10;
    for (i = 0; i < N; i++) {
        K[0][i] = f[i] + h * D[0] * late[i];
        new_y[i] = y[i];
    }
    valve_model_substitute(W, K[0]);
    for (s = 1; s < STAGES; s++) {
        for (i = 0; i < N; i++) {
            double advanced = y[i], coupled = 0.0;
            for (j = 0; j < s; j++) {
                advanced += A[s][j] * K[j][i];
                coupled += C[s][j] * K[j][i];
            }
            new_y[i] = advanced;
            K[s][i] = coupled / h;
        }
        if (moving && (s < 6)) { /* the last three stages are at the end of the step */
            conditions_at(valve, stretch, t + NODES[s] * h, u, c);
        }
        valve_model_derivative(new_y, u, c, valve->parameters, slope);
        for (i = 0; i < N; i++) {
            K[s][i] += slope[i] + ((s < 5) ? h * D[s] * late[i] : 0.0);
        }
        valve_model_substitute(W, K[s]);
    }
    for (i = 0; i < N; i++) {
        double share;
        new_y[i] += K[STAGES - 1][i];
        share = fabs(K[STAGES - 1][i]) / size_of(valve, y[i], new_y[i], i);
        error = isfinite(share) ? larger(error, share) : 1e10;
    }
    return error;
}

/* After a break y' bends by y'' = J f + df/dt: a step that a long one before it allows would be right at its end alone. */
static double first_step(const Valve *valve, const Stretch *stretch, double t, double h, const double y[N],
                         const double f[N], double J[N][N])
{
    double u[VALVE_INPUTS], c[VALVE_COEFFICIENTS], slope[N];
    const double span = VALVE_RATE_SPAN * ((h < stretch->end - t) ? h : (stretch->end - t));
    int i, j;
    for (i = 0; i < VALVE_COEFFICIENTS; i++) {
        c[i] = stretch->first[i];
    }
    inputs_at(valve, stretch->hooks, t + span, u);
    conditions_at(valve, stretch, t + span, u, c);
    valve_model_derivative(y, u, c, valve->parameters, slope);
    for (i = 0; i < N; i++) {
        double bending = (slope[i] - f[i]) / span;
        const double size = size_of(valve, y[i], y[i], i);
        for (j = 0; j < N; j++) {
            bending += J[i][j] * f[j];
        }
        bending = fabs(bending);
        if (bending * h * h > VALVE_FIRST_BEND * size) {
            h = sqrt(VALVE_FIRST_BEND * size / bending);
        }
    }
    return h;
}

static int fastest(const double f[N])
{
    int i, found = 0;
    for (i = 0; i < N; i++) {
        if (!isfinite(f[i])) {
            return i;
        }
        if (fabs(f[i]) > fabs(f[found])) {
            found = i;
        }
    }
    return found;
}

static void write_states(Valve *valve, const double y[N])
{
    int i;
    for (i = 0; i < N; i++) {
        valve->states[i] = y[i] * valve_state_table[i].scale;
    }
}

/* From the beginning of a stretch to its end, or to where the hook stops it: *reached. */
static ValveStatus integrate(Valve *valve, const Stretch *stretch, double y[N], double *reached)
{
    double f[N], J[N][N], new_y[N], u[VALVE_INPUTS], c[VALVE_COEFFICIENTS];
    double t = stretch->begin, h = valve->step, steps = 0.0;
    int i, fresh = 1;
    for (i = 0; i < VALVE_COEFFICIENTS; i++) {
        c[i] = stretch->first[i];
    }
    inputs_at(valve, stretch->hooks, t, u);
    *reached = t;
    while (t < stretch->end) {
        double free, error;
        conditions_at(valve, stretch, t, u, c);
        valve_model_derivative(y, u, c, valve->parameters, f);
        valve_model_jacobian(y, u, c, valve->parameters, J);
        if (fresh) {
            fresh = 0;
            h = first_step(valve, stretch, t, h, y, f, J);
        }
        free = h; /* the step that the error control wants, before the end shortens it */
        for (;;) {
            steps += 1.0;
            h = (free < stretch->end - t) ? free : (stretch->end - t);
            if (t + 1.01 * h >= stretch->end) {
                h = stretch->end - t;
            }
            valve->culprit = fastest(f);
            if (steps > MOST_STEPS) {
                return VALVE_TOO_MANY_STEPS;
            }
            if (!(h > 1e-14 * larger(fabs(t), 1e-3)) && (h < stretch->end - t)) {
                return VALVE_STEP_TOO_SMALL;
            }
            error = rosenbrock_step(valve, stretch, t, h, y, f, J, u, c, new_y);
            if (error <= 1.0) {
                break;
            }
            valve->rejected += 1.0;
            free = h * larger(0.9 * pow(error, -0.2), 0.1);
        }
        valve->accepted += 1.0;
        t = (h == stretch->end - t) ? stretch->end : t + h;
        for (i = 0; i < N; i++) {
            y[i] = new_y[i];
        }
        if (h < free) {
            h = free; /* a step that the end has shortened says nothing of longer ones */
        } else {
            const double growth = 0.85 * pow(larger(error, 1e-10), -0.2);
            h *= (growth < 0.2) ? 0.2 : ((growth > 3.0) ? 3.0 : growth);
        }
        valve->step = h;
        *reached = t;
        if ((stretch->hooks != NULL) && (stretch->hooks->step_done != NULL)) {
            const double share = (t - stretch->begin) / (stretch->end - stretch->begin);
            write_states(valve, y);
            conditions_at(valve, stretch, t, u, c);
            for (i = 0; i < VALVE_COEFFICIENTS; i++) {
                valve->coefficients[i] = c[i];
            }
            for (i = 0; i < VALVE_SLOW; i++) {
                valve->states[N + i] = stretch->cold[i] + share * (stretch->warm[i] - stretch->cold[i]);
            }
            valve->coefficients_valid = 1;
            if (stretch->hooks->step_done(stretch->hooks->context, t, valve->states, u)) {
                break;
            }
        }
    }
    return VALVE_OK;
}

static int is_driven(const Valve *valve, const ValveHooks *hooks)
{
    int k, order;
    if ((hooks != NULL) && (hooks->inputs_at != NULL)) {
        return 1;
    }
    for (order = 0; order < VALVE_ORDERS; order++) {
        for (k = 0; k < VALVE_INPUTS; k++) {
            if (valve->slopes[order][k] != 0.0) {
                return 1;
            }
        }
    }
    return 0;
}

/* Temperatures at the end of a stretch of `length`, coefficients there, and whether a straight line leads there. */
static ValveStatus look_ahead(Valve *valve, const ValveHooks *hooks, double begin, double length, const double before[],
                              double after[], Stretch *stretch, int *straight)
{
    double u[VALVE_INPUTS], middle[VALVE_SLOW_ROOM], c_middle[VALVE_COEFFICIENTS], c_end[VALVE_COEFFICIENTS];
    double oil[3];
    int k, moved = 0;
    ValveStatus status;
    for (k = 0; k < 3; k++) {
        inputs_at(valve, hooks, begin + 0.5 * (double)k * length, u);
        valve_model_pilot_oil(valve->parameters, u, &oil[k]);
    }
    valve_propagate(valve, 0.5 * length, oil[0], oil[1], before, middle);
    valve_propagate(valve, 0.5 * length, oil[1], oil[2], middle, after);
    moved = (oil[0] != oil[1]) || (oil[1] != oil[2]);
    for (k = 0; k < VALVE_SLOW; k++) {
        moved = moved || (fabs(after[k] - before[k]) > 1e-12);
    }
    stretch->bent = 0;
    *straight = 1;
    if (!moved) {
        return VALVE_OK;
    }
    status = valve_coefficients_at(valve, after, u, c_end);
    if (status == VALVE_OK) {
        inputs_at(valve, hooks, begin + 0.5 * length, u);
        status = valve_coefficients_at(valve, middle, u, c_middle);
    }
    if (status != VALVE_OK) {
        return status;
    }
    for (k = 0; k < VALVE_COEFFICIENTS; k++) {
        const double first = stretch->first[k], size = larger(fabs(first), fabs(c_end[k]));
        const double least = (k >= VALVE_FIRST_TEMPERATURE) ? 100.0 : 0.0;
        stretch->change[k] = c_end[k] - first;
        stretch->bent = stretch->bent || (stretch->change[k] != 0.0);
        *straight = *straight && (fabs(c_middle[k] - 0.5 * (first + c_end[k])) <= VALVE_KNOT_ERROR * larger(size, least));
    }
    return VALVE_OK;
}

/* What feels the command's rate passes through a jump of it: in no time that matters, along a ramp. */
ValveStatus valve_pass_jump(Valve *valve)
{
    ValveStatus status = VALVE_OK;
    const double before = valve->command_before, after = valve->inputs[VALVE_INPUT_COMMAND];
    if (VALVE_USES_RATE && (fabs(after - before) > 1e-6 * (fabs(after) + fabs(before)))) {
        double slopes[VALVE_ORDERS][VALVE_INPUTS], y[N], reached;
        const double step = valve->step;
        Stretch ramp = {0.0, VALVE_JUMP_TIME, {0.0}, {0.0}, 0, 1, NULL, NULL, NULL};
        int i, k;
        status = valve_refresh(valve);
        for (i = 0; i < VALVE_COEFFICIENTS; i++) {
            ramp.first[i] = valve->coefficients[i];
        }
        for (i = 0; i < VALVE_ORDERS; i++) {
            for (k = 0; k < VALVE_INPUTS; k++) {
                slopes[i][k] = valve->slopes[i][k];
                valve->slopes[i][k] = 0.0;
            }
        }
        for (i = 0; i < N; i++) {
            y[i] = valve->states[i] / valve_state_table[i].scale;
        }
        valve->inputs[VALVE_INPUT_COMMAND] = before;
        valve->slopes[0][VALVE_INPUT_COMMAND] = (after - before) / VALVE_JUMP_TIME;
        valve->step = 1e-11;
        if (status == VALVE_OK) {
            status = integrate(valve, &ramp, y, &reached);
        }
        valve->inputs[VALVE_INPUT_COMMAND] = after;
        for (i = 0; i < VALVE_ORDERS; i++) {
            for (k = 0; k < VALVE_INPUTS; k++) {
                valve->slopes[i][k] = slopes[i][k];
            }
        }
        if (status == VALVE_OK) {
            write_states(valve, y);
        }
        valve->step = step;
    }
    valve->command_before = after;
    return status;
}

/* Inputs and time as they are `elapsed` seconds on. */
static void arrive(Valve *valve, const ValveHooks *hooks, double elapsed)
{
    double u[VALVE_INPUTS];
    int k;
    inputs_at(valve, hooks, elapsed, u);
    for (k = 0; k < VALVE_INPUTS; k++) {
        valve->inputs[k] = (k == VALVE_INPUT_COMMAND_RATE) ? valve->inputs[k] : u[k];
        valve->slopes[0][k] += elapsed * (valve->slopes[1][k] + 0.5 * elapsed * valve->slopes[2][k]);
        valve->slopes[1][k] += elapsed * valve->slopes[2][k];
    }
    valve->command_before = valve->inputs[VALVE_INPUT_COMMAND];
    valve->time += elapsed;
}

ValveStatus valve_advance(Valve *valve, double duration, const ValveHooks *hooks)
{
    Stretch stretch;
    double y[N], u[VALVE_INPUTS], temperatures[VALVE_SLOW_ROOM], after[VALVE_SLOW_ROOM];
    double begin = 0.0, length = duration, reached = 0.0;
    int k, straight, halvings = 0;
    ValveStatus status = (isfinite(duration) && (duration > 0.0)) ? valve_check(valve) : VALVE_DURATION;
    if (status == VALVE_OK) {
        status = valve_pass_jump(valve);
    }
    if (status == VALVE_OK) {
        inputs_at(valve, hooks, duration, u);
        status = valve_check_inputs(valve, u);
    }
    if (status == VALVE_OK) {
        status = valve_refresh(valve);
    }
    if (status != VALVE_OK) {
        return status;
    }
    for (k = 0; k < N; k++) {
        y[k] = valve->states[k] / valve_state_table[k].scale;
    }
    for (k = 0; k < VALVE_COEFFICIENTS; k++) {
        stretch.first[k] = valve->coefficients[k];
        stretch.change[k] = 0.0;
    }
    for (k = 0; k < VALVE_SLOW; k++) {
        temperatures[k] = valve->states[N + k];
    }
    stretch.cold = temperatures;
    stretch.warm = after;
    stretch.hooks = hooks;
    stretch.driven = is_driven(valve, hooks);
    while (begin < duration) {
        status = look_ahead(valve, hooks, begin, length, temperatures, after, &stretch, &straight);
        if (status != VALVE_OK) {
            break;
        }
        if (!straight && (halvings < MOST_HALVINGS)) {
            length *= 0.5;
            halvings++;
            continue;
        }
        stretch.begin = begin;
        stretch.end = (begin + 1.000001 * length >= duration) ? duration : begin + length;
        status = integrate(valve, &stretch, y, &reached);
        if (status != VALVE_OK) {
            break;
        }
        if (reached < stretch.end) { /* stopped on the way: the temperatures as far as that */
            double oil[2];
            inputs_at(valve, hooks, begin, u);
            valve_model_pilot_oil(valve->parameters, u, &oil[0]);
            inputs_at(valve, hooks, reached, u);
            valve_model_pilot_oil(valve->parameters, u, &oil[1]);
            valve_propagate(valve, reached - begin, oil[0], oil[1], temperatures, after);
        }
        for (k = 0; k < VALVE_SLOW; k++) {
            temperatures[k] = after[k];
        }
        if (stretch.bent) {
            const double share = (reached - begin) / (stretch.end - begin);
            for (k = 0; k < VALVE_COEFFICIENTS; k++) {
                stretch.first[k] += share * stretch.change[k];
            }
        }
        if (reached < stretch.end) {
            break;
        }
        begin = stretch.end;
        if (halvings > 0) {
            length *= 2.0;
            halvings--;
        }
        length = (length < duration - begin) ? length : duration - begin;
    }
    write_states(valve, y);
    for (k = 0; k < VALVE_SLOW; k++) {
        valve->states[N + k] = temperatures[k];
    }
    for (k = 0; k < VALVE_COEFFICIENTS; k++) {
        valve->coefficients[k] = stretch.first[k];
    }
    valve->coefficients_valid = (status == VALVE_OK);
    arrive(valve, hooks, reached);
    return status;
}

ValveStatus valve_advance_fixed(Valve *valve, double duration, int steps)
{
    Stretch stretch;
    double y[N], new_y[N], f[N], J[N][N], u[VALVE_INPUTS], c[VALVE_COEFFICIENTS], after[VALVE_SLOW_ROOM];
    double *temperatures = &valve->states[VALVE_COUPLED];
    int k, i, straight;
    ValveStatus status = (isfinite(duration) && (duration > 0.0) && (steps > 0)) ? valve_check(valve) : VALVE_DURATION;
    if (status == VALVE_OK) {
        status = valve_pass_jump(valve);
    }
    if (status == VALVE_OK) {
        status = valve_refresh(valve);
    }
    for (k = 0; k < VALVE_COEFFICIENTS; k++) {
        stretch.first[k] = valve->coefficients[k];
        stretch.change[k] = 0.0;
        c[k] = stretch.first[k];
    }
    if (status == VALVE_OK) {
        status = look_ahead(valve, NULL, 0.0, duration, temperatures, after, &stretch, &straight);
    }
    if (status != VALVE_OK) {
        return status;
    }
    stretch.hooks = NULL;
    stretch.driven = is_driven(valve, NULL);
    stretch.begin = 0.0;
    stretch.end = duration;
    for (i = 0; i < N; i++) {
        y[i] = valve->states[i] / valve_state_table[i].scale;
    }
    inputs_at(valve, NULL, 0.0, u);
    for (k = 0; k < steps; k++) {
        const double h = duration / (double)steps, t = h * (double)k;
        conditions_at(valve, &stretch, t, u, c);
        valve_model_derivative(y, u, c, valve->parameters, f);
        valve_model_jacobian(y, u, c, valve->parameters, J);
        (void)rosenbrock_step(valve, &stretch, t, h, y, f, J, u, c, new_y);
        for (i = 0; i < N; i++) {
            if (!isfinite(new_y[i])) {
                valve->culprit = i;
                return VALVE_NOT_FINITE;
            }
            y[i] = new_y[i];
        }
        valve->accepted += 1.0;
    }
    write_states(valve, y);
    for (k = 0; k < VALVE_SLOW; k++) {
        temperatures[k] = after[k];
    }
    for (k = 0; k < VALVE_COEFFICIENTS; k++) {
        valve->coefficients[k] = stretch.first[k] + (stretch.bent ? stretch.change[k] : 0.0);
    }
    arrive(valve, NULL, duration);
    return VALVE_OK;
}
