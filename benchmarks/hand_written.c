/* The nominal valve as one would write it in C for speed: the comparator of benchmarks/solvers.py.

   Rodas4 (E. Hairer, G. Wanner, Solving ODEs II, sec. VI.4), six stages, order 4; Jacobian by hand; its linear system
   reduced along its pattern to armature rate and spool velocity. States in SI; errors are judged as valvesim does.
   Equations: valvesim/valve/equations.py with a current drive, without effects and laminar losses. */

#include <math.h>

#define N 6
enum { THETA, OMEGA, P1, P2, X, V };
/* places in valvesim.Coefficients */
enum {
    UPPER_1, UPPER_2, LOWER_1, LOWER_2, GAP_AREA, ARM, MMF, RELUCTANCE, FLUX_SHARE, TURNS, RESISTANCE, INDUCTANCE, TUBE,
    ROD, INERTIA, DAMPING, NOZZLE_ARM, FEEDBACK_ARM, GAP_1, GAP_2, NOZZLE_1, NOZZLE_2, ORIFICE_1, ORIFICE_2, C_NOZZLE,
    C_ORIFICE, LOSS_1, LOSS_2, LOSS_3, VOLUME, AREA, MASS, SPOOL_DAMPING, STROKE, WIDTH, C_PORT, NULL_OPENING, OVERLAP,
    CIRCUMFERENCE, CLEARANCE, LENGTH, DENSITY, VISCOSITY, BULK_0, BULK_SLOPE, FLAPPER_STOP, SPOOL_STOP, STOP_DAMPING,
    TRANSITION, COEFFICIENTS
};

typedef struct { /* of one valve at one temperature */
    double g[4], m, s1, s3, r0, mmf, turns, torque, arm, tube, rod, inertia, damping, r, L, gap_1, gap_2;
    double nozzle_area_1, nozzle_area_2, jets, k01, k02, kn1, kn2, w2, area, mass, spool_damping, stroke, width;
    double beta_0, beta_slope, volume, flapper_stop, spool_stop, stop_damping;
} Valve;

typedef struct { /* a command: what it holds, then a sine or a linear chirp on top; jumps at `time` */
    double offset, amplitude, frequency, sweep, time;
} Command;

typedef struct { double W01, W10, W12, W13, W14, W20, W25, W30, W35, W50, W52, W53, W54, d, i22, i33, a, b, c, e; } Factors;

static const double MU_0 = 4e-7 * M_PI;

static void derive(const double *c, double supply, Valve *v)
{
    const double flow = sqrt(2.0 / c[DENSITY]);
    v->m = 1.0 / (MU_0 * c[GAP_AREA]);
    v->g[0] = c[UPPER_1], v->g[1] = c[UPPER_2], v->g[2] = c[LOWER_2], v->g[3] = c[LOWER_1];
    v->s1 = 1.0 / ((c[UPPER_1] + c[UPPER_2]) * v->m), v->s3 = 1.0 / ((c[LOWER_1] + c[LOWER_2]) * v->m);
    v->r0 = c[RELUCTANCE] / c[FLUX_SHARE], v->mmf = c[MMF], v->turns = c[TURNS], v->arm = c[ARM];
    v->torque = c[ARM] / (2.0 * MU_0 * c[GAP_AREA]);
    v->tube = c[TUBE], v->rod = c[ROD], v->inertia = 1.0 / c[INERTIA], v->damping = c[DAMPING];
    v->r = c[NOZZLE_ARM], v->L = c[NOZZLE_ARM] + c[FEEDBACK_ARM], v->gap_1 = c[GAP_1], v->gap_2 = c[GAP_2];
    v->nozzle_area_1 = M_PI * c[NOZZLE_1] * c[NOZZLE_1] / 4.0, v->nozzle_area_2 = M_PI * c[NOZZLE_2] * c[NOZZLE_2] / 4.0;
    v->jets = 2.0 * M_PI * v->r * supply * c[C_NOZZLE] * c[C_NOZZLE];
    v->k01 = M_PI * c[ORIFICE_1] * c[ORIFICE_1] / 4.0 * c[C_ORIFICE] * flow;
    v->k02 = M_PI * c[ORIFICE_2] * c[ORIFICE_2] / 4.0 * c[C_ORIFICE] * flow;
    v->kn1 = M_PI * c[NOZZLE_1] * c[C_NOZZLE] * flow, v->kn2 = M_PI * c[NOZZLE_2] * c[C_NOZZLE] * flow;
    v->w2 = c[TRANSITION] * c[TRANSITION], v->area = c[AREA], v->mass = 1.0 / c[MASS], v->spool_damping = c[SPOOL_DAMPING];
    v->stroke = c[STROKE], v->width = 0.43 * c[WIDTH], v->beta_0 = c[BULK_0], v->beta_slope = c[BULK_SLOPE];
    v->volume = 1.0 / c[VOLUME], v->flapper_stop = c[FLAPPER_STOP], v->spool_stop = c[SPOOL_STOP];
    v->stop_damping = c[STOP_DAMPING];
}

static inline double root(double dp, double w2, double *slope)
{
    const double s = dp * dp + w2, q = 1.0 / sqrt(sqrt(s));
    if (slope) *slope = q - 0.5 * dp * dp * q / s;
    return dp * q;
}

static inline double contact(double x, double v, double low, double high, double k, double c, double *by_x, double *by_v)
{
    const double beyond = fmax(x - high, 0.0), below = fmax(low - x, 0.0);
    const double back = fmax(1.0 + c * v, 0.0), on = fmax(1.0 - c * v, 0.0);
    if (by_x) {
        *by_x = -k * ((x > high ? back : 0.0) + (x < low ? on : 0.0));
        *by_v = -k * c * ((on > 0.0 ? below : 0.0) + (back > 0.0 ? beyond : 0.0));
    }
    return k * (below * on - beyond * back);
}

/* rates f, and with J (a non-null pointer) the entries of the Jacobian that are not constant */
static inline void rates(const Valve *v, const double *y, double i, const double *p, double *f, double J[N][N])
{
    const double supply = p[0], back = p[1], load = p[2], theta = y[THETA], omega = y[OMEGA];
    const double a = v->arm * v->m, n = v->turns * i;
    const double R1 = v->g[0] * v->m - a * theta, R2 = v->g[1] * v->m + a * theta;
    const double R3 = v->g[2] * v->m - a * theta, R4 = v->g[3] * v->m + a * theta;
    const double path = 1.0 / (2.0 * R1 * R2 * v->s1 + 2.0 * R3 * R4 * v->s3 + v->r0);
    const double phi = (2.0 * v->mmf - n * ((R1 - R2) * v->s1 + (R3 - R4) * v->s3)) * path;
    const double sides = (2.0 * n + (R2 - R1) * phi) * v->s1 + (2.0 * n + (R4 - R3) * phi) * v->s3;
    const double x_f = v->r * theta, x1 = v->gap_1 - x_f, x2 = v->gap_2 + x_f, rod = v->rod * (v->L * theta + y[X]);
    double stop_x, stop_v, spool_x, spool_v, d01, d02, dn1, dn2;
    const int full = J != 0;
    const double stop = contact(x_f, v->r * omega, -v->gap_2, v->gap_1, v->flapper_stop, v->stop_damping,
                                full ? &stop_x : 0, &stop_v);
    const double end = contact(y[X], y[V], -v->stroke, v->stroke, v->spool_stop, v->stop_damping, full ? &spool_x : 0,
                               &spool_v);
    const double q01 = root(supply - y[P1], v->w2, full ? &d01 : 0), q02 = root(supply - y[P2], v->w2, full ? &d02 : 0);
    const double qn1 = root(y[P1] - back, v->w2, full ? &dn1 : 0), qn2 = root(y[P2] - back, v->w2, full ? &dn2 : 0);
    const double open_1 = v->kn1 * fmax(x1, 0.0), open_2 = v->kn2 * fmax(x2, 0.0);
    const double in_1 = v->k01 * q01 - open_1 * qn1 - v->area * y[V], in_2 = v->k02 * q02 - open_2 * qn2 + v->area * y[V];
    const double b1 = (v->beta_0 + v->beta_slope * y[P1]) * v->volume, b2 = (v->beta_0 + v->beta_slope * y[P2]) * v->volume;
    f[THETA] = omega;
    f[OMEGA] = v->inertia * (v->torque * phi * sides - v->damping * omega - v->tube * theta - v->L * rod
                             - v->r * (v->nozzle_area_1 * (y[P1] - back) - v->nozzle_area_2 * (y[P2] - back))
                             + v->jets * (x2 - x1) * (x2 + x1) + v->r * stop);
    f[P1] = in_1 * b1;
    f[P2] = in_2 * b2;
    f[X] = y[V];
    f[V] = v->mass * (v->area * (y[P1] - y[P2]) - rod - v->width * (supply * y[X] - load * fabs(y[X]))
                      - v->spool_damping * y[V] + end);
    if (!full) return;
    const double path_t = 2.0 * a * (R1 - R2) * v->s1 + 2.0 * a * (R3 - R4) * v->s3;
    const double phi_t = (2.0 * n * a * (v->s1 + v->s3) - phi * path_t) * path;
    const double sides_t = (2.0 * a * phi + (R2 - R1) * phi_t) * v->s1 + (2.0 * a * phi + (R4 - R3) * phi_t) * v->s3;
    J[OMEGA][THETA] = v->inertia * (v->torque * (phi_t * sides + phi * sides_t) - v->tube - v->L * v->L * v->rod
                                    + 2.0 * v->jets * v->r * (x2 + x1) + v->r * v->r * stop_x);
    J[OMEGA][OMEGA] = v->inertia * (v->r * v->r * stop_v - v->damping);
    J[OMEGA][P1] = -v->inertia * v->r * v->nozzle_area_1;
    J[OMEGA][P2] = v->inertia * v->r * v->nozzle_area_2;
    J[OMEGA][X] = -v->inertia * v->L * v->rod;
    J[P1][THETA] = x1 > 0.0 ? v->r * v->kn1 * qn1 * b1 : 0.0;
    J[P1][P1] = (-v->k01 * d01 - open_1 * dn1) * b1 + in_1 * v->beta_slope * v->volume;
    J[P1][V] = -v->area * b1;
    J[P2][THETA] = x2 > 0.0 ? -v->r * v->kn2 * qn2 * b2 : 0.0;
    J[P2][P2] = (-v->k02 * d02 - open_2 * dn2) * b2 + in_2 * v->beta_slope * v->volume;
    J[P2][V] = v->area * b2;
    J[V][THETA] = -v->mass * v->rod * v->L;
    J[V][P1] = v->mass * v->area;
    J[V][P2] = -v->mass * v->area;
    J[V][X] = v->mass * (spool_x - v->rod - v->width * (supply - (y[X] < 0.0 ? -load : load)));
    J[V][V] = v->mass * (spool_v - v->spool_damping);
}

/* W = diagonal - J, reduced to the 2 x 2 system (a b; c e) of armature rate and spool velocity, held inverted */
static inline void factor(double J[N][N], double diagonal, Factors *w)
{
    const double d = 1.0 / diagonal, i22 = 1.0 / (diagonal - J[P1][P1]), i33 = 1.0 / (diagonal - J[P2][P2]);
    w->d = d, w->i22 = i22, w->i33 = i33;
    w->W10 = -J[OMEGA][THETA], w->W12 = -J[OMEGA][P1], w->W13 = -J[OMEGA][P2], w->W14 = -J[OMEGA][X];
    w->W20 = -J[P1][THETA], w->W25 = -J[P1][V], w->W30 = -J[P2][THETA], w->W35 = -J[P2][V];
    w->W50 = -J[V][THETA], w->W52 = -J[V][P1], w->W53 = -J[V][P2], w->W54 = -J[V][X];
    const double t2 = w->W20 * d * i22, t3 = w->W30 * d * i33, v2 = w->W25 * i22, v3 = w->W35 * i33;
    const double a = diagonal - J[OMEGA][OMEGA] + w->W10 * d - w->W12 * t2 - w->W13 * t3;
    const double b = w->W14 * d - w->W12 * v2 - w->W13 * v3;
    const double c = w->W50 * d - w->W52 * t2 - w->W53 * t3;
    const double e = diagonal - J[V][V] + w->W54 * d - w->W52 * v2 - w->W53 * v3;
    const double inverse = 1.0 / (a * e - b * c);
    w->a = e * inverse, w->b = -b * inverse, w->c = -c * inverse, w->e = a * inverse;
}

static inline void solve(const Factors *w, double *x)
{
    const double t = x[THETA] * w->d, s = x[X] * w->d;
    const double p1 = (x[P1] - w->W20 * t) * w->i22, p2 = (x[P2] - w->W30 * t) * w->i33;
    const double o = x[OMEGA] - w->W10 * t - w->W12 * p1 - w->W13 * p2 - w->W14 * s;
    const double u = x[V] - w->W50 * t - w->W52 * p1 - w->W53 * p2 - w->W54 * s;
    x[OMEGA] = w->a * o + w->b * u;
    x[V] = w->c * o + w->e * u;
    x[THETA] = t + w->d * x[OMEGA];
    x[X] = s + w->d * x[V];
    x[P1] = (x[P1] - w->W20 * x[THETA] - w->W25 * x[V]) * w->i22;
    x[P2] = (x[P2] - w->W30 * x[THETA] - w->W35 * x[V]) * w->i33;
}

static const double GAMMA = 0.25, NODES[6] = {0.0, 0.386, 0.21, 0.63, 1.0, 1.0};
static const double D[6] = {0.25, -0.1043, 0.1035, -0.03620000000000023, 0.0, 0.0};
static const double A[6][5] = {
    {0},
    {1.544},
    {0.9466785280815826, 0.2557011698983284},
    {3.314825187068521, 2.896124015972201, 0.9986419139977817},
    {1.221224509226641, 6.019134481288629, 12.53708332932087, -0.6878860361058950},
    {1.221224509226641, 6.019134481288629, 12.53708332932087, -0.6878860361058950, 1.0},
};
static const double C[6][5] = {
    {0},
    {-5.6688},
    {-2.430093356833875, -0.2063599157091915},
    {-0.1073529058151375, -9.594562251023355, -20.47028614809616},
    {7.496443313967647, -10.24680431464352, -33.99990352819905, 11.70890893206160},
    {8.083246795921522, -7.981132988064893, -31.52159432874371, 16.31930543123136, -6.058818238834054},
};
static const double DENSE[2][5] = {
    {10.12623508344586, -7.487995877610167, -34.80091861555747, -7.992771707568823, 1.025137723295662},
    {-0.6762803392801253, 6.087714651680015, 16.43084320892478, 24.76722511418386, -6.594389125716872},
};

static inline double current_at(const Command *c, double t)
{
    const double tau = t - c->time;
    if (tau < 0.0 || c->amplitude == 0.0) return c->offset;
    return c->offset + c->amplitude * sin(2.0 * M_PI * (c->frequency * tau + 0.5 * c->sweep * tau * tau));
}

static void valve_at(long at, const double *knot_times, const double *knots, double t, double supply, Valve *v)
{
    const double *low = knots + at * COEFFICIENTS, *high = low + COEFFICIENTS;
    const double share = (t - knot_times[at]) / (knot_times[at + 1] - knot_times[at]);
    double c[COEFFICIENTS];
    for (int k = 0; k < COEFFICIENTS; k++) c[k] = low[k] + share * (high[k] - low[k]);
    derive(c, supply, v);
}

/* From rest `y` (N,) at `begin` to `end`; states (n_out, N) at t_out; returns the steps tried, negative where it fails. */
long hand_written(double begin, double end, double *y, const double *rest, const double *scale, const double *pressures,
                  const Command *command, long n_knots, const double *knot_times, const double *knots, double rtol,
                  double atol_share, long n_out, const double *t_out, double *out)
{
    double t = begin, h = 1e-5, f[N], late[N], J[N][N], K[6][N], new[N], r[N], error;
    long at = 0, at_out = 0, tried = 0;
    const int moving = n_knots > 1;
    Valve now, then;
    Factors w;
    derive(knots, pressures[0], &now);
    then = now;
    while (at_out < n_out && t_out[at_out] <= t) {
        for (int i = 0; i < N; i++) out[at_out * N + i] = y[i];
        at_out++;
    }
    while (t < end) {
        while (at + 2 < n_knots && knot_times[at + 1] <= t) at++;
        const double limit = (at + 2 < n_knots && knot_times[at + 1] < end) ? knot_times[at + 1] : end;
        if (moving) valve_at(at, knot_times, knots, t, pressures[0], &now);
        rates(&now, y, current_at(command, t), pressures, f, J);
        double wanted = h;
        while (1) {
            if (++tried > 100000000) return -1;
            h = fmin(wanted, limit - t);
            if (t + 1.01 * h >= limit) h = limit - t;
            if (moving || command->amplitude != 0.0) {
                const double span = 1e-3 * h;
                if (moving) valve_at(at, knot_times, knots, t + span, pressures[0], &then);
                rates(&then, y, current_at(command, t + span), pressures, late, 0);
                for (int i = 0; i < N; i++) late[i] = (late[i] - f[i]) / span;
            } else
                for (int i = 0; i < N; i++) late[i] = 0.0;
            factor(J, 1.0 / (GAMMA * h), &w);
            const double per_h = 1.0 / h;
#pragma GCC unroll 6
            for (int s = 0; s < 6; s++) {
                const double *rate = f;
                if (s) {
                    for (int i = 0; i < N; i++) {
                        new[i] = y[i];
                        for (int j = 0; j < s; j++) new[i] += A[s][j] * K[j][i];
                    }
                    if (s < 5 && moving) valve_at(at, knot_times, knots, t + NODES[s] * h, pressures[0], &then);
                    rates(&then, new, current_at(command, t + NODES[s] * h), pressures, r, 0);
                    rate = r;
                }
                for (int i = 0; i < N; i++) {
                    double coupled = 0.0;
                    for (int j = 0; j < s; j++) coupled += C[s][j] * K[j][i];
                    K[s][i] = rate[i] + coupled * per_h + h * D[s] * late[i];
                }
                solve(&w, K[s]);
            }
            error = 0.0;
            for (int i = 0; i < N; i++) {
                new[i] += K[5][i];
                const double size = atol_share * rtol * scale[i] + rtol * fmax(fabs(y[i] - rest[i]), fabs(new[i] - rest[i]));
                error = fmax(error, fabs(K[5][i]) / size);
            }
            if (error <= 1.0) break;
            wanted = h * fmax(0.9 * pow(error, -0.25), 0.1);
            if (h < 1e-14) return -2;
        }
        const double next = h == limit - t ? limit : t + h;
        if (at_out < n_out && t_out[at_out] <= next) {
            double bend[2][N];
            for (int i = 0; i < N; i++)
                for (int k = 0; k < 2; k++) {
                    bend[k][i] = 0.0;
                    for (int s = 0; s < 5; s++) bend[k][i] += DENSE[k][s] * K[s][i];
                }
            for (; at_out < n_out && t_out[at_out] <= next; at_out++) {
                const double share = (t_out[at_out] - t) / h, left = 1.0 - share;
                for (int i = 0; i < N; i++)
                    out[at_out * N + i] = left * y[i] + share * (new[i] + left * (bend[0][i] + share * bend[1][i]));
            }
        }
        for (int i = 0; i < N; i++) y[i] = new[i];
        t = next;
        const double grown = h * fmin(fmax(0.85 * pow(fmax(error, 1e-10), -0.25), 0.2), 3.0);
        h = wanted > h ? wanted : grown;
    }
    return tried;
}
