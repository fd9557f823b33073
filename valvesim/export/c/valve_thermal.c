/* Temperatures of the parts, a step on: exact for an oil temperature that is straight in between.
 *
 * T' = M T + N [oil, ambient] is linear and hears nothing of the valve's motion, so one matrix exponential of
 *     [ M  N_oil  N_ambient  0 ]
 *     [ 0    0        0      1 ]   (oil grows by its rate)
 *     [ 0    0        0      0 ]
 * carries it over any step: T(h) = E T + f oil + g ambient + r (change of the oil). It is kept for steps of its length.
 */
#include "valve.h"

#include <math.h>

#define SIZE (VALVE_SLOW + 3)
#define OIL VALVE_SLOW
#define AMBIENT (VALVE_SLOW + 1)
#define RATE (VALVE_SLOW + 2)
#define TERMS 12   /* of the series for a matrix of norm 1/4: the next is below 1e-16 */

static void multiply(double left[SIZE][SIZE], double right[SIZE][SIZE], double product[SIZE][SIZE])
{
    int i, j, k;
    for (i = 0; i < SIZE; i++) {
        for (j = 0; j < SIZE; j++) {
            double sum = 0.0;
            for (k = 0; k < SIZE; k++) {
                sum += left[i][k] * right[k][j];
            }
            product[i][j] = sum;
        }
    }
}

static void copy(double from[SIZE][SIZE], double to[SIZE][SIZE])
{
    int i, j;
    for (i = 0; i < SIZE; i++) {
        for (j = 0; j < SIZE; j++) {
            to[i][j] = from[i][j];
        }
    }
}

/* exp(matrix) by its series, the matrix halved until that is short, and squared back. */
static void exponential(double matrix[SIZE][SIZE], double result[SIZE][SIZE])
{
    double term[SIZE][SIZE], product[SIZE][SIZE], norm = 0.0, share = 1.0;
    int i, j, k, halvings = 0;
    for (i = 0; i < SIZE; i++) {
        double row = 0.0;
        for (j = 0; j < SIZE; j++) {
            row += fabs(matrix[i][j]);
        }
        norm = (row > norm) ? row : norm;
    }
    while ((norm * share > 0.25) && (halvings < 60)) {
        share *= 0.5;
        halvings++;
    }
    for (i = 0; i < SIZE; i++) {
        for (j = 0; j < SIZE; j++) {
            matrix[i][j] *= share;
            term[i][j] = (i == j) ? 1.0 : 0.0;
            result[i][j] = term[i][j];
        }
    }
    for (k = 1; k <= TERMS; k++) {
        multiply(term, matrix, product);
        for (i = 0; i < SIZE; i++) {
            for (j = 0; j < SIZE; j++) {
                term[i][j] = product[i][j] / (double)k;
                result[i][j] += term[i][j];
            }
        }
    }
    for (k = 0; k < halvings; k++) {
        multiply(result, result, product);
        copy(product, result);
    }
}

/* The propagator of a step: the network is probed with one source at a time. */
static void prepare(Valve *valve, double step)
{
    double matrix[SIZE][SIZE] = {{0.0}}, result[SIZE][SIZE], sources[VALVE_SLOW_ROOM + 2] = {0.0};
    double rates[VALVE_SLOW_ROOM];
    int i, j;
    for (j = 0; j < VALVE_SLOW + 2; j++) {
        sources[j] = 1.0;
        valve_model_thermal_rates(valve->parameters, sources, rates);
        sources[j] = 0.0;
        for (i = 0; i < VALVE_SLOW; i++) {
            matrix[i][j] = rates[i] * step;
        }
    }
    matrix[OIL][RATE] = 1.0;
    exponential(matrix, result);
    for (i = 0; i < VALVE_SLOW; i++) {
        for (j = 0; j < SIZE; j++) {
            valve->transition[i][j] = result[i][j];
        }
    }
    valve->propagator_step = step;
}

void valve_propagate(Valve *valve, double step, double oil_before, double oil_after, const double from[], double to[])
{
    double next[VALVE_SLOW_ROOM];
    int i, j;
    if (VALVE_SLOW == 0) {
        return;
    }
    if (fabs(step - valve->propagator_step) > 1e-9 * step) {
        prepare(valve, step);
    }
    for (i = 0; i < VALVE_SLOW; i++) {
        const double *row = valve->transition[i];
        double sum = row[OIL] * oil_before + row[AMBIENT] * valve_ambient(valve) + row[RATE] * (oil_after - oil_before);
        for (j = 0; j < VALVE_SLOW; j++) {
            sum += row[j] * from[j];
        }
        next[i] = sum;
    }
    for (i = 0; i < VALVE_SLOW; i++) {
        to[i] = next[i];
    }
}
