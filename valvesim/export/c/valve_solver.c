/* The integrator: Rodas5P, an L-stable, stiffly accurate Rosenbrock method of order 5, as valvesim's own.
 *
 * Source of the method and its figures: G. Steinebach, "Construction of Rosenbrock-Wanner method Rodas5P", BIT 63
 * (2023). A step, the solution of its linear systems and its error are printed with the equations (valve_model.c).
 * Coefficients run straight between knots in time, which are set so close that they would.
 */
#include "valve.h"

#include <math.h>

#define N VALVE_COUPLED
#define NODES VALVE_NODES_OF_STEP /* times within a step at which its stages look */
#define MOST_HALVINGS 12 /* of an advance, between two knots */
#define SHORTEST 1e-12 /* s, of an advance */
#define MOST_STEPS 10000000.0
#define RATE_SPAN 0.02 /* share of a step over which the rate of inputs is taken that a caller gives */

static const double node_shares[NODES] = VALVE_NODE_SHARES;

/* A stretch of an advance on which the prepared coefficients run straight. Times are seconds since it began. */
typedef struct {
    double begin, end;
    double first[VALVE_PREPARED], rate[VALVE_PREPARED];
    int bent;                  /* the coefficients change */
    int driven;                /* the inputs change */
    const double *cold, *warm; /* temperatures at both ends */
    const ValveHooks *hooks;
} Stretch;

/* What a step works with. */
typedef struct {
    double f[N], f_t[N], J[N][N], W[N][N], K[VALVE_STAGES][N], rate[N], atol[N];
    double u[VALVE_INPUTS], u_t[VALVE_INPUTS], u_late[NODES][VALVE_INPUTS];
    double c[VALVE_PREPARED], c_late[NODES][VALVE_PREPARED];
} Work;

static double larger(double a, double b)
{
    return (a > b) ? a : b;
}

static int has_inputs(const ValveHooks *hooks)
{
    return (hooks != NULL) && (hooks->inputs_at != NULL);
}

static void inputs_at(const Valve *valve, const ValveHooks *hooks, double t, double u[VALVE_INPUTS])
{
    const double(*slopes)[VALVE_INPUTS] = valve->slopes;
    int k;
    for (k = 0; k < VALVE_INPUTS; k++) {
        u[k] = valve->inputs[k] + t * (slopes[0][k] + 0.5 * t * (slopes[1][k] + t / 3.0 * slopes[2][k]));
    }
    if (has_inputs(hooks)) {
        hooks->inputs_at(hooks->context, t, u);
    } else if (slopes[0][VALVE_INPUT_COMMAND] != 0.0) {
        u[VALVE_INPUT_COMMAND_RATE] = slopes[0][VALVE_INPUT_COMMAND]
            + t * (slopes[1][VALVE_INPUT_COMMAND] + 0.5 * t * slopes[2][VALVE_INPUT_COMMAND]);
    }
}

/* How fast the inputs change at t; from a caller by a second-order difference within a step of h. */
static void input_rates(const Valve *valve, const Stretch *stretch, double t, double h, const double u[VALVE_INPUTS],
                        double u_t[VALVE_INPUTS])
{
    const double(*slopes)[VALVE_INPUTS] = valve->slopes;
    int k;
    if (!stretch->driven) {
        for (k = 0; k < VALVE_INPUTS; k++) {
            u_t[k] = 0.0;
        }
    } else if (has_inputs(stretch->hooks)) {
        double near[VALVE_INPUTS], far[VALVE_INPUTS];
        const double span = RATE_SPAN * ((h < stretch->end - t) ? h : (stretch->end - t));
        inputs_at(valve, stretch->hooks, t + span, near);
        inputs_at(valve, stretch->hooks, t + 2.0 * span, far);
        for (k = 0; k < VALVE_INPUTS; k++) {
            u_t[k] = (4.0 * (near[k] - u[k]) - (far[k] - u[k])) / (2.0 * span);
        }
    } else {
        for (k = 0; k < VALVE_INPUTS; k++) {
            u_t[k] = slopes[0][k] + t * (slopes[1][k] + 0.5 * t * slopes[2][k]);
        }
        u_t[VALVE_INPUT_COMMAND_RATE] = slopes[1][VALVE_INPUT_COMMAND] + t * slopes[2][VALVE_INPUT_COMMAND];
    }
}

static void coefficients_at(const Stretch *stretch, double t, double c[VALVE_PREPARED])
{
    int k;
    for (k = 0; k < VALVE_PREPARED; k++) {
        c[k] = stretch->first[k] + (t - stretch->begin) * stretch->rate[k];
    }
}

static void begin_work(const Valve *valve, const Stretch *stretch, Work *work)
{
    int i, j, k;
    for (i = 0; i < N; i++) {
        work->atol[i] = VALVE_ABSOLUTE_SHARE * valve->tolerance;
        for (j = 0; j < N; j++) {
            work->J[i][j] = 0.0; /* where the pattern has none */
            work->W[i][j] = 0.0;
        }
    }
    inputs_at(valve, stretch->hooks, stretch->begin, work->u);
    for (k = 0; k < VALVE_PREPARED; k++) {
        work->c[k] = stretch->first[k];
    }
    for (j = 0; j < NODES; j++) {
        for (k = 0; k < VALVE_INPUTS; k++) {
            work->u_late[j][k] = work->u[k];
        }
        for (k = 0; k < VALVE_PREPARED; k++) {
            work->c_late[j][k] = work->c[k];
        }
    }
}

static void linearise(const Valve *valve, const Stretch *stretch, double t, double h, const double y[N], Work *work)
{
    if (stretch->driven) {
        inputs_at(valve, stretch->hooks, t, work->u);
    }
    if (stretch->bent) {
        coefficients_at(stretch, t, work->c);
    }
    input_rates(valve, stretch, t, h, work->u, work->u_t);
    valve_model_linearise(y, work->u, work->u_t, work->c, stretch->rate, work->f, work->J, work->f_t);
}

/* After a break y' bends by y'' = J f + df/dt: a step as long as those before it would be right at its end alone. */
static double first_step(const Valve *valve, double h, const double y[N], const Work *work)
{
    int i, j;
    for (i = 0; i < N; i++) {
        double bending = work->f_t[i];
        const double size = work->atol[i] + valve->tolerance * fabs(y[i] - valve->rest[i]);
        for (j = 0; j < N; j++) {
            bending += work->J[i][j] * work->f[j];
        }
        bending = fabs(bending);
        if (bending * h * h > VALVE_FIRST_BEND * size) {
            h = sqrt(VALVE_FIRST_BEND * size / bending);
        }
    }
    return h;
}

/* One step from y to new_y, linearised at its begin; returns its error in tolerances, 1e10 where it is no number. */
static double rosenbrock_step(const Valve *valve, const Stretch *stretch, double t, double h, const double y[N],
                              Work *work, double new_y[N])
{
    double pivots[1], e[2];
    int k;
    for (k = 0; k < NODES; k++) {
        if (stretch->driven) {
            inputs_at(valve, stretch->hooks, t + node_shares[k] * h, work->u_late[k]);
        }
        if (stretch->bent) {
            coefficients_at(stretch, t + node_shares[k] * h, work->c_late[k]);
        }
    }
    valve_model_factor(work->J, 1.0 / (VALVE_GAMMA * h), work->W, pivots);
    valve_model_step(y, work->u_late, work->c_late, h, work->f, work->f_t, work->W, work->K, new_y, work->rate);
    valve_model_error(y, new_y, work->K, valve->rest, work->atol, valve->tolerance, e);
    return (isfinite(e[1]) && isfinite(pivots[0])) ? e[0] : 1e10;
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

static void read_states(const Valve *valve, double y[N])
{
    int i;
    for (i = 0; i < N; i++) {
        y[i] = valve->states[i] / valve_state_table[i].scale;
    }
}

static void write_states(Valve *valve, const double y[N])
{
    int i;
    for (i = 0; i < N; i++) {
        valve->states[i] = y[i] * valve_state_table[i].scale;
    }
}

/* The valve as it is within an advance, for the hook; whether it wants to stop there. */
static int tell_step(Valve *valve, const Stretch *stretch, double t, const double y[N])
{
    const double share = (t - stretch->begin) / (stretch->end - stretch->begin);
    double u[VALVE_INPUTS];
    int k;
    write_states(valve, y);
    for (k = 0; k < VALVE_SLOW; k++) {
        valve->states[N + k] = stretch->cold[k] + share * (stretch->warm[k] - stretch->cold[k]);
    }
    inputs_at(valve, stretch->hooks, t, u);
    valve_temperatures_changed(valve);
    return stretch->hooks->step_done(stretch->hooks->context, t, valve->states, u);
}

/* From the beginning of a stretch to its end, or to where the hook stops it: *reached. */
static ValveStatus integrate(Valve *valve, const Stretch *stretch, double y[N], double *reached)
{
    Work work;
    double new_y[N], t = stretch->begin, h = valve->step, steps = 0.0;
    int i, fresh = 1;
    begin_work(valve, stretch, &work);
    *reached = t;
    while (t < stretch->end) {
        double free, error;
        linearise(valve, stretch, t, h, y, &work);
        if (fresh) {
            fresh = 0;
            h = first_step(valve, h, y, &work);
        }
        free = h; /* the step that the error control wants, before the end shortens it */
        for (;;) {
            steps += 1.0;
            h = (free < stretch->end - t) ? free : (stretch->end - t);
            if (t + 1.01 * h >= stretch->end) {
                h = stretch->end - t;
            }
            if (steps > MOST_STEPS) {
                valve->culprit = fastest(work.f);
                return VALVE_TOO_MANY_STEPS;
            }
            if (!(h > 1e-14 * larger(fabs(t), 1e-3)) && (h < stretch->end - t)) {
                valve->culprit = fastest(work.f);
                return VALVE_STEP_TOO_SMALL;
            }
            error = rosenbrock_step(valve, stretch, t, h, y, &work, new_y);
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
        if ((stretch->hooks != NULL) && (stretch->hooks->step_done != NULL) && tell_step(valve, stretch, t, y)) {
            break;
        }
    }
    return VALVE_OK;
}

static int is_driven(const Valve *valve, const ValveHooks *hooks)
{
    int k, order;
    if (has_inputs(hooks)) {
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

/* Temperatures and coefficients at the end of a stretch of `length`; *bend above 1: no straight line leads there. */
static ValveStatus look_ahead(Valve *valve, const ValveHooks *hooks, double begin, double length,
                              const double c_begin[VALVE_COEFFICIENTS], double c_end[VALVE_COEFFICIENTS],
                              const double before[], double after[], Stretch *stretch, double *bend)
{
    double u[VALVE_INPUTS], middle[VALVE_SLOW_ROOM], c_middle[VALVE_COEFFICIENTS], last[VALVE_PREPARED], oil[3];
    int k, moved;
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
    stretch->bent = moved;
    *bend = 0.0;
    for (k = 0; k < VALVE_PREPARED; k++) {
        stretch->rate[k] = 0.0;
    }
    if (!moved) {
        for (k = 0; k < VALVE_COEFFICIENTS; k++) {
            c_end[k] = c_begin[k];
        }
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
        const double size = larger(fabs(c_begin[k]), fabs(c_end[k]));
        const double least = (k >= VALVE_FIRST_TEMPERATURE) ? 100.0 : 0.0;
        const double off = fabs(c_middle[k] - 0.5 * (c_begin[k] + c_end[k]));
        *bend = larger(*bend, (off > 0.0) ? off / (VALVE_KNOT_ERROR * larger(size, least)) : 0.0);
    }
    valve_model_prepare(c_end, last);
    for (k = 0; k < VALVE_PREPARED; k++) {
        stretch->rate[k] = (last[k] - stretch->first[k]) / length;
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
        for (i = 0; i < VALVE_PREPARED; i++) {
            ramp.first[i] = valve->prepared[i];
        }
        for (i = 0; i < VALVE_ORDERS; i++) {
            for (k = 0; k < VALVE_INPUTS; k++) {
                slopes[i][k] = valve->slopes[i][k];
                valve->slopes[i][k] = 0.0;
            }
        }
        read_states(valve, y);
        valve->inputs[VALVE_INPUT_COMMAND] = before;
        valve->slopes[0][VALVE_INPUT_COMMAND] = (after - before) / VALVE_JUMP_TIME;
        valve->step = 0.01 * VALVE_JUMP_TIME;
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
    double c_begin[VALVE_COEFFICIENTS], c_end[VALVE_COEFFICIENTS];
    double begin = 0.0, length = duration, reached = 0.0, bend;
    int k, halvings = 0, stopped = 0;
    ValveStatus status = (isfinite(duration) && (duration >= SHORTEST)) ? valve_check(valve) : VALVE_DURATION;
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
    read_states(valve, y);
    for (k = 0; k < VALVE_COEFFICIENTS; k++) {
        c_begin[k] = valve->coefficients[k];
    }
    for (k = 0; k < VALVE_PREPARED; k++) {
        stretch.first[k] = valve->prepared[k];
    }
    for (k = 0; k < VALVE_SLOW; k++) {
        temperatures[k] = valve->states[N + k];
    }
    stretch.cold = temperatures;
    stretch.warm = after;
    stretch.hooks = hooks;
    stretch.driven = is_driven(valve, hooks);
    while ((begin < duration) && !stopped) {
        status = look_ahead(valve, hooks, begin, length, c_begin, c_end, temperatures, after, &stretch, &bend);
        if (status != VALVE_OK) {
            break;
        }
        if ((bend > 1.0) && (halvings < MOST_HALVINGS)) {
            length *= 0.5;
            halvings++;
            continue;
        }
        stretch.begin = begin;
        stretch.end = (begin + 1.000001 * length >= duration) ? duration : begin + length;
        status = integrate(valve, &stretch, y, &reached);
        stopped = (status != VALVE_OK) || (reached < stretch.end);
        if (stopped && (reached > begin)) { /* the temperatures as far as that */
            double oil[2];
            inputs_at(valve, hooks, begin, u);
            valve_model_pilot_oil(valve->parameters, u, &oil[0]);
            inputs_at(valve, hooks, reached, u);
            valve_model_pilot_oil(valve->parameters, u, &oil[1]);
            valve_propagate(valve, reached - begin, oil[0], oil[1], temperatures, after);
        }
        for (k = 0; k < VALVE_SLOW; k++) {
            temperatures[k] = (reached > begin) ? after[k] : temperatures[k];
        }
        for (k = 0; k < VALVE_COEFFICIENTS; k++) {
            c_begin[k] = c_end[k];
        }
        for (k = 0; k < VALVE_PREPARED; k++) {
            stretch.first[k] += stretch.rate[k] * (stretch.end - stretch.begin);
        }
        begin = stretch.end;
        if ((halvings > 0) && (bend < 0.2)) { /* twice as long bends four times as far */
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
        valve->coefficients[k] = c_begin[k];
    }
    for (k = 0; k < VALVE_PREPARED; k++) {
        valve->prepared[k] = stretch.first[k];
    }
    valve->coefficients_valid = (status == VALVE_OK) && !stopped;
    arrive(valve, hooks, reached);
    return status;
}

ValveStatus valve_advance_fixed(Valve *valve, double duration, int steps)
{
    Stretch stretch;
    Work work;
    double y[N], new_y[N], after[VALVE_SLOW_ROOM], c_end[VALVE_COEFFICIENTS];
    double *temperatures = &valve->states[N];
    double bend;
    int k, i;
    ValveStatus status =
        (isfinite(duration) && (duration >= SHORTEST) && (steps > 0)) ? valve_check(valve) : VALVE_DURATION;
    if (status == VALVE_OK) {
        status = valve_pass_jump(valve);
    }
    if (status == VALVE_OK) {
        status = valve_refresh(valve);
    }
    for (k = 0; k < VALVE_PREPARED; k++) {
        stretch.first[k] = valve->prepared[k];
    }
    if (status == VALVE_OK) {
        status = look_ahead(valve, NULL, 0.0, duration, valve->coefficients, c_end, temperatures, after, &stretch,
                            &bend); /* a line all the same: the caller chooses how long it is */
    }
    if (status != VALVE_OK) {
        return status;
    }
    stretch.hooks = NULL;
    stretch.driven = is_driven(valve, NULL);
    stretch.begin = 0.0;
    stretch.end = duration;
    begin_work(valve, &stretch, &work);
    read_states(valve, y);
    for (k = 0; k < steps; k++) {
        const double h = duration / (double)steps, t = h * (double)k;
        linearise(valve, &stretch, t, h, y, &work);
        (void)rosenbrock_step(valve, &stretch, t, h, y, &work, new_y);
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
        valve->coefficients[k] = c_end[k];
    }
    for (k = 0; k < VALVE_PREPARED; k++) {
        valve->prepared[k] = stretch.first[k] + stretch.rate[k] * duration;
    }
    arrive(valve, NULL, duration);
    return VALVE_OK;
}
