/* What a status means, in words. The only file of the model that uses stdio.h. */
#include "valve.h"

#include <math.h>
#include <stdio.h>

static void tell_range(char text[], size_t size, const char *what, const ValveVariable *about, double value)
{
    if (!isfinite(value)) {
        (void)snprintf(text, size, "%s %s is not a finite number", what, about->name);
    } else {
        (void)snprintf(text, size, "%s %s = %.6g %s is outside [%.6g, %.6g] %s", what, about->name, value, about->unit,
                       about->low, about->high, about->unit);
    }
}

void valve_describe(const Valve *valve, ValveStatus status, char text[], size_t size)
{
    const int k = (valve->culprit >= 0) ? valve->culprit : 0;
    const char *state = valve_state_table[(k < VALVE_STATES) ? k : 0].name;
    const double supply = valve->inputs[VALVE_INPUT_SUPPLY_PRESSURE];
    switch (status) {
    case VALVE_OK:
        (void)snprintf(text, size, "done");
        break;
    case VALVE_PARAMETER_RANGE:
        tell_range(text, size, "parameter", &valve_parameter_table[k], valve->parameters[k]);
        break;
    case VALVE_INPUT_RANGE:
        tell_range(text, size, "input", &valve_input_table[k], valve->inputs[k]);
        break;
    case VALVE_STATE_RANGE:
        (void)snprintf(text, size, "state %s is not a finite number", state);
        break;
    case VALVE_RETURN_PRESSURE:
        (void)snprintf(text, size, "return_pressure (%.6g Pa) must be below supply_pressure (%.6g Pa)",
                       valve->inputs[VALVE_INPUT_RETURN_PRESSURE], supply);
        break;
    case VALVE_LOAD_PRESSURE:
        (void)snprintf(text, size, "load_pressure (%.6g Pa) is beyond supply_pressure (%.6g Pa)",
                       valve->inputs[VALVE_INPUT_LOAD_PRESSURE], supply);
        break;
    case VALVE_CLEARANCE_CLOSED:
        (void)snprintf(text, size, "%s closes at the temperatures and parameters at hand, t = %.6g s",
                       valve_coefficient_names[k], valve->time);
        break;
    case VALVE_NO_COEFFICIENT:
        (void)snprintf(text, size, "%s is no number at the temperatures and parameters at hand, t = %.6g s",
                       valve_coefficient_names[k], valve->time);
        break;
    case VALVE_NULL_UNSTABLE:
        (void)snprintf(text, size, "no stable null inside the null gap: the magnetic spring or the jets carry the "
                       "flapper onto a nozzle; lower valve.polarization_mmf or raise valve.spring_tube_stiffness");
        break;
    case VALVE_NO_REST:
        (void)snprintf(text, size, "the valve finds no rest at the start: %s stays in motion; try a smaller first "
                       "command or a larger effect width", state);
        break;
    case VALVE_TOO_MANY_STEPS:
    case VALVE_STEP_TOO_SMALL:
        (void)snprintf(text, size, "the integration failed at about t = %.6g s in %s: %s; try a larger "
                       "valve.transition_pressure or effect width, a smaller command, or a looser tolerance",
                       valve->time, state,
                       (status == VALVE_TOO_MANY_STEPS) ? "too many steps were needed" : "the step became too small");
        break;
    case VALVE_NOT_FINITE:
        (void)snprintf(text, size, "%s has left the range of numbers at about t = %.6g s", state, valve->time);
        break;
    case VALVE_DURATION:
        (void)snprintf(text, size, "the duration and the count of steps must be positive and finite");
        break;
    default:
        (void)snprintf(text, size, "unknown status %d", (int)status);
        break;
    }
}
