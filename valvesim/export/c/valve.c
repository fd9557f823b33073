/* The valve as a whole: start values, checks, coefficients at the temperatures of the moment, rates and outputs. */
#include "valve.h"

#include <math.h>

void valve_defaults(Valve *valve)
{
    static const Valve empty;
    int k;
    *valve = empty;
    for (k = 0; k < VALVE_PARAMETERS; k++) {
        valve->parameters[k] = valve_parameter_table[k].start;
    }
    for (k = 0; k < VALVE_INPUTS; k++) {
        valve->inputs[k] = valve_input_table[k].start;
    }
    for (k = 0; k < VALVE_STATES; k++) {
        valve->states[k] = valve_state_table[k].start; /* zero where the start works it out */
    }
    valve->tolerance = VALVE_TOLERANCE;
    valve->culprit = -1;
}

void valve_parameters_changed(Valve *valve)
{
    valve->coefficients_valid = 0;
    valve->propagator_step = 0.0;
}

void valve_temperatures_changed(Valve *valve)
{
    valve->coefficients_valid = 0;
}

static int within(double value, const ValveVariable *variable)
{
    return isfinite(value) && (value >= variable->low) && (value <= variable->high);
}

ValveStatus valve_check_inputs(Valve *valve, const double inputs[])
{
    int k;
    const double supply = inputs[VALVE_INPUT_SUPPLY_PRESSURE];
    for (k = 0; k < VALVE_INPUTS; k++) {
        if (!within(inputs[k], &valve_input_table[k])) {
            valve->culprit = k;
            return VALVE_INPUT_RANGE;
        }
    }
    if (inputs[VALVE_INPUT_RETURN_PRESSURE] >= supply) {
        return VALVE_RETURN_PRESSURE;
    }
    if (fabs(inputs[VALVE_INPUT_LOAD_PRESSURE]) > supply * (1.0 + 1e-9)) {
        return VALVE_LOAD_PRESSURE;
    }
    return VALVE_OK;
}

ValveStatus valve_check(Valve *valve)
{
    int k;
    for (k = 0; k < VALVE_PARAMETERS; k++) {
        if (!within(valve->parameters[k], &valve_parameter_table[k])) {
            valve->culprit = k;
            return VALVE_PARAMETER_RANGE;
        }
    }
    for (k = 0; k < VALVE_STATES; k++) {
        if (!isfinite(valve->states[k])) {
            valve->culprit = k;
            return VALVE_STATE_RANGE;
        }
    }
    return valve_check_inputs(valve, valve->inputs);
}

double valve_ambient(const Valve *valve)
{
#ifdef VALVE_PARAMETER_AMBIENT
    return valve->parameters[VALVE_PARAMETER_AMBIENT];
#else
    (void)valve;
    return 0.0;
#endif
}

ValveStatus valve_coefficients_at(Valve *valve, const double temperatures[], const double inputs[], double c[])
{
    int k;
    valve_model_coefficients(valve->parameters, temperatures, inputs, c);
    for (k = 0; k < VALVE_COEFFICIENTS; k++) {
        if (!isfinite(c[k])) {
            valve->culprit = k;
            return VALVE_NO_COEFFICIENT;
        }
    }
    for (k = 0; k < VALVE_CLEARANCES; k++) {
        if (c[valve_clearances[k]] <= 0.0) {
            valve->culprit = valve_clearances[k];
            return VALVE_CLEARANCE_CLOSED;
        }
    }
    return VALVE_OK;
}

ValveStatus valve_refresh(Valve *valve)
{
    ValveStatus status = VALVE_OK;
    if (!valve->coefficients_valid) {
        status = valve_coefficients_at(valve, &valve->states[VALVE_COUPLED], valve->inputs, valve->coefficients);
        valve_model_prepare(valve->coefficients, valve->prepared);
        valve->coefficients_valid = (status == VALVE_OK);
    }
    return status;
}

ValveStatus valve_rates(Valve *valve, double rates[VALVE_STATE_ROOM])
{
    double y[VALVE_COUPLED], sources[VALVE_SLOW_ROOM + 2];
    int k;
    ValveStatus status = valve_refresh(valve);
    if (status != VALVE_OK) {
        return status;
    }
    for (k = 0; k < VALVE_COUPLED; k++) {
        y[k] = valve->states[k] / valve_state_table[k].scale;
    }
    valve_model_rates(y, valve->inputs, valve->prepared, rates);
    for (k = 0; k < VALVE_COUPLED; k++) {
        rates[k] *= valve_state_table[k].scale;
    }
    for (k = 0; k < VALVE_SLOW; k++) {
        sources[k] = valve->states[VALVE_COUPLED + k];
    }
    valve_model_pilot_oil(valve->parameters, valve->inputs, &sources[VALVE_SLOW]);
    sources[VALVE_SLOW + 1] = valve_ambient(valve);
    valve_model_thermal_rates(valve->parameters, sources, &rates[VALVE_COUPLED]);
    for (k = 0; k < VALVE_STATES; k++) {
        if (!isfinite(rates[k])) {
            valve->culprit = k;
            return VALVE_NOT_FINITE;
        }
    }
    return VALVE_OK;
}

ValveStatus valve_outputs(Valve *valve, double outputs[VALVE_OUTPUTS])
{
    const ValveStatus status = valve_refresh(valve);
    if (status == VALVE_OK) {
        valve_model_outputs(valve->states, valve->inputs, valve->coefficients, valve->parameters, outputs);
    }
    return status;
}

ValveStatus valve_start(Valve *valve)
{
    double oil;
    int k;
    ValveStatus status;
    for (k = 0; k < VALVE_COUPLED; k++) {
        valve->states[k] = 0.0;
    }
    valve_model_pilot_oil(valve->parameters, valve->inputs, &oil);
    for (k = VALVE_COUPLED; k < VALVE_STATES; k++) {
        if (!valve_state_table[k].known) { /* without a start of its own a part is as warm as the oil; a lag is behind */
            const int path = k - VALVE_NODES;
            valve->states[k] = ((path >= VALVE_COUPLED) && VALVE_LAGGED_PARTS) ? valve->states[path] : oil;
        }
    }
    status = valve_check(valve);
    valve_parameters_changed(valve);
    if (status == VALVE_OK) {
        status = valve_refresh(valve);
    }
    if (status == VALVE_OK) {
        status = valve_rest(valve);
    }
    valve->time = 0.0;
    valve->step = VALVE_FIRST_STEP;
    valve->accepted = 0.0;
    valve->rejected = 0.0;
    valve->command_before = valve->inputs[VALVE_INPUT_COMMAND];
    for (k = 0; k < VALVE_COUPLED; k++) {
        valve->rest[k] = valve->states[k] / valve_state_table[k].scale;
    }
    return status;
}
