/* Printed by valvesim: the C code flies what valvesim's own simulation has flown, and must give the same.
 *
 * Inputs are straight between samples. Every state and output must stay within a share of its span of the reference,
 * which was computed at a relative tolerance of 1e-8; once with error control and once in fixed steps. A wrong input
 * must be refused.
 */
#include "valve.h"

#include <math.h>
#include <stdio.h>

#define SAMPLES @SAMPLES@
#define CHANNELS @CHANNELS@
#define STEP @STEP@

static const double inputs[SAMPLES][@INPUTS@] = {
@INPUT_ROWS@};
static const double expected[SAMPLES][CHANNELS] = {
@EXPECTED_ROWS@};
static const double spans[CHANNELS] = {@SPANS@};
static const int places[CHANNELS] = {@PLACES@}; /* a state, or an output behind the states */

static int failed(Valve *valve, ValveStatus status, const char *what)
{
    char text[300];
    if (status == VALVE_OK) {
        return 0;
    }
    valve_describe(valve, status, text, sizeof text);
    (void)printf("%s: %s\n", what, text);
    return 1;
}

/* Largest error of all channels at all samples, as a share of their spans; negative where the run fails. */
static double fly(int fixed_steps)
{
    Valve valve;
    double outputs[VALVE_OUTPUTS], worst = 0.0;
    int sample, k;
    valve_defaults(&valve);
    for (k = 0; k < VALVE_INPUTS; k++) {
        valve.inputs[k] = inputs[0][k];
    }
    if (failed(&valve, valve_start(&valve), "start")) {
        return -1.0;
    }
    for (sample = 0; sample < SAMPLES; sample++) {
        if (failed(&valve, valve_outputs(&valve, outputs), "outputs")) {
            return -1.0;
        }
        for (k = 0; k < CHANNELS; k++) {
            const double value = (places[k] < VALVE_STATES) ? valve.states[places[k]] : outputs[places[k] - VALVE_STATES];
            const double error = fabs(value - expected[sample][k]) / spans[k];
            worst = (error > worst) ? error : worst;
        }
        if (sample + 1 < SAMPLES) {
            for (k = 0; k < VALVE_INPUTS; k++) {
                valve.inputs[k] = inputs[sample][k];
                valve.slopes[0][k] = (inputs[sample + 1][k] - inputs[sample][k]) / STEP;
            }
            if (failed(&valve, (fixed_steps > 0) ? valve_advance_fixed(&valve, STEP, fixed_steps)
                                                 : valve_advance(&valve, STEP, NULL), "advance")) {
                return -1.0;
            }
        }
    }
    return worst;
}

int main(void)
{
    Valve valve;
    const double variable = fly(0), fixed = fly(@FIXED_STEPS@);
    int good = (variable >= 0.0) && (variable < @ERROR@) && (fixed >= 0.0) && (fixed < @ERROR_FIXED@);
    (void)printf("largest error: %.2e of the span with error control, %.2e in fixed steps\n", variable, fixed);
    valve_defaults(&valve);
    valve.inputs[VALVE_INPUT_SUPPLY_PRESSURE] = NAN;
    if (valve_start(&valve) != VALVE_INPUT_RANGE) {
        (void)printf("an input that is no number is not refused\n");
        good = 0;
    }
    (void)printf(good ? "passed\n" : "FAILED\n");
    return good ? 0 : 1;
}
