/* What both versions of FMI share; see the header. */
#include "fmi_instance.h"

#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <string.h>

#define HEAD_SIZE 48

Outcome instance_fail(Instance *instance, Outcome outcome, const char *format, ...)
{
    va_list arguments;
    va_start(arguments, format);
    (void)vsnprintf(instance->message, sizeof instance->message, format, arguments);
    va_end(arguments);
    if (instance->tell != NULL) {
        instance->tell(instance, outcome, instance->message);
    }
    return outcome;
}

static const char *phase_name(Phase phase)
{
    switch (phase) {
    case PHASE_INSTANTIATED: return "before initialization";
    case PHASE_INITIALIZATION: return "initialization mode";
    case PHASE_EVENT: return "event mode";
    case PHASE_CONTINUOUS: return "continuous-time mode";
    case PHASE_STEP: return "step mode";
    default: return "after termination";
    }
}

Outcome instance_in_phase(Instance *instance, int phases, const char *function)
{
    if (((int)instance->run.phase & phases) != 0) {
        return GOOD;
    }
    return instance_fail(instance, BAD, "%s: not allowed in this state (%s)", function, phase_name(instance->run.phase));
}

Outcome instance_status(Instance *instance, ValveStatus status)
{
    char text[300];
    if (status == VALVE_OK) {
        return GOOD;
    }
    valve_describe(&instance->run.valve, status, text, sizeof text);
    return instance_fail(instance, BAD, "%s", text);
}

void instance_reset(Instance *instance)
{
    Run *run = &instance->run;
    const int co_simulation = run->co_simulation;
    (void)memset(run, 0, sizeof *run);
    valve_defaults(&run->valve);
    run->co_simulation = co_simulation;
    run->phase = PHASE_INSTANTIATED;
}

/* The state at rest under the first inputs, worked out when it is asked for. */
Outcome instance_settle(Instance *instance)
{
    Run *run = &instance->run;
    Outcome outcome = GOOD;
    if (!run->settled) {
        const double time = run->valve.time;
        outcome = instance_status(instance, valve_start(&run->valve));
        run->valve.time = time;
        run->settled = (outcome == GOOD);
    }
    return outcome;
}

static int within(unsigned reference, unsigned block, int count)
{
    return (reference >= block) && (reference < block + (unsigned)count);
}

static Outcome unknown_reference(Instance *instance, unsigned reference)
{
    return instance_fail(instance, BAD, "no variable has the value reference %u", reference);
}

Outcome instance_get(Instance *instance, unsigned reference, double *value)
{
    Run *run = &instance->run;
    Valve *valve = &run->valve;
    double values[VALVE_STATE_ROOM + VALVE_OUTPUTS];
    Outcome outcome = GOOD;
    if (reference == REF_TIME) {
        *value = valve->time;
    } else if (within(reference, REF_PARAMETER, VALVE_PARAMETERS)) {
        *value = valve->parameters[reference - REF_PARAMETER];
    } else if (within(reference, REF_INPUT, VALVE_INPUTS)) {
        *value = valve->inputs[reference - REF_INPUT];
    } else if (within(reference, REF_STATE, VALVE_STATES) || within(reference, REF_DERIVATIVE, VALVE_STATES)
               || within(reference, REF_OUTPUT, VALVE_OUTPUTS)) {
        if (run->phase == PHASE_INSTANTIATED) {
            if (within(reference, REF_STATE, VALVE_STATES)) {
                *value = valve->states[reference - REF_STATE]; /* its start value */
                return GOOD;
            }
            return instance_fail(instance, BAD, "outputs and derivatives have no value before initialization");
        }
        outcome = instance_settle(instance);
        if (outcome != GOOD) {
            return outcome;
        }
        if (within(reference, REF_STATE, VALVE_STATES)) {
            *value = valve->states[reference - REF_STATE];
        } else if (within(reference, REF_DERIVATIVE, VALVE_STATES)) {
            outcome = instance_status(instance, valve_rates(valve, values));
            *value = (outcome == GOOD) ? values[reference - REF_DERIVATIVE] : 0.0;
        } else {
            outcome = instance_status(instance, valve_outputs(valve, values));
            *value = (outcome == GOOD) ? values[reference - REF_OUTPUT] : 0.0;
        }
    } else {
        outcome = unknown_reference(instance, reference);
    }
    return outcome;
}

static Outcome check_value(Instance *instance, const ValveVariable *about, double value)
{
    if (!isfinite(value)) {
        return instance_fail(instance, BAD, "%s: the value is not a finite number; it keeps its old one", about->name);
    }
    if ((value < about->low) || (value > about->high)) {
        return instance_fail(instance, BAD, "%s = %.6g %s is outside [%.6g, %.6g] %s; it keeps its old value",
                             about->name, value, about->unit, about->low, about->high, about->unit);
    }
    return GOOD;
}

Outcome instance_set(Instance *instance, unsigned reference, double value)
{
    Run *run = &instance->run;
    Valve *valve = &run->valve;
    const int before = ((int)run->phase & (PHASE_INSTANTIATED | PHASE_INITIALIZATION)) != 0;
    const ValveVariable *about;
    Outcome outcome;
    if (within(reference, REF_PARAMETER, VALVE_PARAMETERS)) {
        about = &valve_parameter_table[reference - REF_PARAMETER];
        if ((run->phase == PHASE_CONTINUOUS) || instance->inside_step) {
            return instance_fail(instance, BAD, "%s: a parameter is set between steps, in event mode", about->name);
        }
        outcome = check_value(instance, about, value);
        if ((outcome == GOOD) && (valve->parameters[reference - REF_PARAMETER] != value)) {
            valve->parameters[reference - REF_PARAMETER] = value;
            valve_parameters_changed(valve);
            run->settled = run->settled && !before;
        }
        return outcome;
    }
    if (within(reference, REF_INPUT, VALVE_INPUTS)) {
        double *input = &valve->inputs[reference - REF_INPUT];
        about = &valve_input_table[reference - REF_INPUT];
        outcome = check_value(instance, about, value);
        if ((outcome == GOOD) && (*input != value)) {
            *input = value;
            if (reference - REF_INPUT == VALVE_INPUT_OIL_TEMPERATURE) {
                valve_temperatures_changed(valve);
            }
            run->settled = run->settled && !before;
        }
        return outcome;
    }
    if (within(reference, REF_STATE, VALVE_STATES)) {
        about = &valve_state_table[reference - REF_STATE];
        if (!before || !about->known) {
            return instance_fail(instance, BAD, "%s: %s", about->name,
                                 about->known ? "a state is given before the run alone"
                                              : "the valve starts at rest, so this state is worked out");
        }
        outcome = check_value(instance, about, value);
        if (outcome == GOOD) {
            valve->states[reference - REF_STATE] = value;
            run->settled = 0;
        }
        return outcome;
    }
    if ((reference == REF_TIME) || within(reference, REF_DERIVATIVE, VALVE_STATES)
        || within(reference, REF_OUTPUT, VALVE_OUTPUTS)) {
        return instance_fail(instance, BAD, "the variable of value reference %u cannot be set", reference);
    }
    return unknown_reference(instance, reference);
}

Outcome instance_set_time(Instance *instance, double time)
{
    if (!isfinite(time)) {
        return instance_fail(instance, BAD, "the time is not a finite number");
    }
    instance->run.valve.time = time;
    return GOOD;
}

Outcome instance_set_states(Instance *instance, const double states[], size_t count)
{
    size_t k;
    if (count != (size_t)VALVE_STATES) {
        return instance_fail(instance, BAD, "%u states are given for %d", (unsigned)count, VALVE_STATES);
    }
    for (k = 0; k < count; k++) {
        if (!isfinite(states[k])) {
            return instance_fail(instance, BAD, "state %s is not a finite number", valve_state_table[k].name);
        }
    }
    for (k = 0; k < count; k++) {
        if ((k >= (size_t)VALVE_COUPLED) && (instance->run.valve.states[k] != states[k])) {
            valve_temperatures_changed(&instance->run.valve);
        }
        instance->run.valve.states[k] = states[k];
    }
    return GOOD;
}

Outcome instance_rates(Instance *instance, double rates[], size_t count)
{
    double all[VALVE_STATE_ROOM];
    size_t k;
    ValveStatus status;
    if (count != (size_t)VALVE_STATES) {
        return instance_fail(instance, BAD, "%u derivatives are asked for of %d", (unsigned)count, VALVE_STATES);
    }
    status = valve_check_inputs(&instance->run.valve, instance->run.valve.inputs);
    if (status == VALVE_OK) {
        status = valve_rates(&instance->run.valve, all);
    }
    if (status != VALVE_OK) {
        char text[300];
        valve_describe(&instance->run.valve, status, text, sizeof text);
        return instance_fail(instance, DISCARDED, "%s", text); /* a solver may try a shorter step */
    }
    for (k = 0; k < count; k++) {
        rates[k] = all[k];
    }
    if (instance->run.phase == PHASE_CONTINUOUS) { /* from here the command jumps, if it does so at an event */
        instance->run.valve.command_before = instance->run.valve.inputs[VALVE_INPUT_COMMAND];
    }
    return GOOD;
}

/* After an event: what feels the command's rate passes through its jump. */
Outcome instance_update(Instance *instance, int *states_changed)
{
    Valve *valve = &instance->run.valve;
    ValveStatus status = valve_check(valve);
    *states_changed = VALVE_USES_RATE && (valve->command_before != valve->inputs[VALVE_INPUT_COMMAND]);
    if (status == VALVE_OK) {
        status = valve_pass_jump(valve);
    }
    return instance_status(instance, status);
}

Outcome instance_tolerance(Instance *instance, int defined, double tolerance)
{
    if (defined) {
        if (!(isfinite(tolerance) && (tolerance >= 1e-10) && (tolerance <= 1e-2))) {
            return instance_fail(instance, BAD, "the tolerance %.6g is outside [1e-10, 0.01]", tolerance);
        }
        instance->run.valve.tolerance = tolerance;
    }
    return GOOD;
}

Outcome instance_check_step(Instance *instance, double point, double size)
{
    const Run *run = &instance->run;
    const double now = run->valve.time, slack = 1e-9 * (fabs(now) + fabs(size));
    if (!isfinite(point) || !isfinite(size) || !(size > 0.0)) {
        return instance_fail(instance, BAD, "a communication step needs a finite time and a positive size, not %.9g s, %.9g s",
                             point, size);
    }
    if (fabs(point - now) > slack) {
        return instance_fail(instance, BAD, "the communication point %.9g s is not where the last step ended, %.9g s; "
                             "time that goes back needs a saved state", point, now);
    }
    if (run->stop_defined && (point + size > run->stop + slack)) {
        return instance_fail(instance, BAD, "the step to %.9g s goes beyond the stop time %.9g s", point + size, run->stop);
    }
    return GOOD;
}

/* ---------------------------------------------------------------- sensitivities */

static Outcome ready_for_sensitivities(Instance *instance)
{
    Outcome outcome = instance_in_phase(instance, PHASES_RUN | PHASE_TERMINATED, "a derivative of the equations");
    return (outcome == GOOD) ? instance_status(instance, valve_refresh(&instance->run.valve)) : outcome;
}

/* Where a reference stands among [states, inputs, parameters], or -1. */
static int known_place(unsigned reference)
{
    if (within(reference, REF_STATE, VALVE_STATES)) {
        return (int)(reference - REF_STATE);
    }
    if (within(reference, REF_INPUT, VALVE_INPUTS)) {
        return VALVE_STATES + (int)(reference - REF_INPUT);
    }
    if (within(reference, REF_PARAMETER, VALVE_PARAMETERS)) {
        return VALVE_STATES + VALVE_INPUTS + (int)(reference - REF_PARAMETER);
    }
    return -1;
}

/* Where it stands among [derivatives, outputs, states], or -1: a state is an output too. */
static int unknown_place(unsigned reference)
{
    if (within(reference, REF_DERIVATIVE, VALVE_STATES)) {
        return (int)(reference - REF_DERIVATIVE);
    }
    if (within(reference, REF_OUTPUT, VALVE_OUTPUTS)) {
        return VALVE_STATES + (int)(reference - REF_OUTPUT);
    }
    if (within(reference, REF_STATE, VALVE_STATES)) {
        return VALVE_STATES + VALVE_OUTPUTS + (int)(reference - REF_STATE);
    }
    return -1;
}

#define KNOWNS (VALVE_STATES + VALVE_INPUTS + VALVE_PARAMETERS)
#define UNKNOWNS (2 * VALVE_STATES + VALVE_OUTPUTS)

static void forward(const Valve *valve, const double seeds[KNOWNS], double out[UNKNOWNS])
{
    int k;
    valve_model_forward(valve->states, valve->inputs, valve->parameters, seeds, &seeds[VALVE_STATES],
                        &seeds[VALVE_STATES + VALVE_INPUTS], out);
    for (k = 0; k < VALVE_STATES; k++) {
        out[VALVE_STATES + VALVE_OUTPUTS + k] = seeds[k];
    }
}

Outcome instance_directional(Instance *instance, const unsigned unknowns[], size_t unknown_count,
                             const unsigned knowns[], size_t known_count, const double seed[], double sensitivity[])
{
    double seeds[KNOWNS] = {0.0}, out[UNKNOWNS];
    size_t k;
    Outcome outcome = ready_for_sensitivities(instance);
    for (k = 0; (k < known_count) && (outcome == GOOD); k++) {
        const int place = known_place(knowns[k]);
        if (place < 0) {
            outcome = instance_fail(instance, BAD, "value reference %u is no state, input or parameter", knowns[k]);
        } else {
            seeds[place] += seed[k];
        }
    }
    if (outcome == GOOD) {
        forward(&instance->run.valve, seeds, out);
    }
    for (k = 0; (k < unknown_count) && (outcome == GOOD); k++) {
        const int place = unknown_place(unknowns[k]);
        if (place < 0) {
            outcome = instance_fail(instance, BAD, "value reference %u is no derivative or output", unknowns[k]);
        } else {
            sensitivity[k] = out[place];
        }
    }
    return outcome;
}

Outcome instance_adjoint(Instance *instance, const unsigned unknowns[], size_t unknown_count, const unsigned knowns[],
                         size_t known_count, const double seed[], double sensitivity[])
{
    const Valve *valve = &instance->run.valve;
    double seeds[UNKNOWNS] = {0.0}, out[KNOWNS];
    size_t k;
    Outcome outcome = ready_for_sensitivities(instance);
    for (k = 0; (k < unknown_count) && (outcome == GOOD); k++) {
        const int place = unknown_place(unknowns[k]);
        if (place < 0) {
            outcome = instance_fail(instance, BAD, "value reference %u is no derivative or output", unknowns[k]);
        } else {
            seeds[place] += seed[k];
        }
    }
    if (outcome == GOOD) {
        valve_model_adjoint(valve->states, valve->inputs, valve->parameters, seeds, out);
        for (k = 0; k < (size_t)VALVE_STATES; k++) {
            out[k] += seeds[VALVE_STATES + VALVE_OUTPUTS + k];
        }
    }
    for (k = 0; (k < known_count) && (outcome == GOOD); k++) {
        const int place = known_place(knowns[k]);
        if (place < 0) {
            outcome = instance_fail(instance, BAD, "value reference %u is no state, input or parameter", knowns[k]);
        } else {
            sensitivity[k] = out[place];
        }
    }
    return outcome;
}

/* First derivatives of outputs over time, with the inputs as steady as they have been set. */
Outcome instance_output_rates(Instance *instance, const unsigned references[], size_t count, double rates[])
{
    double seeds[KNOWNS] = {0.0}, out[UNKNOWNS];
    size_t k;
    Outcome outcome = ready_for_sensitivities(instance);
    if (outcome == GOOD) {
        outcome = instance_status(instance, valve_rates(&instance->run.valve, out));
    }
    if (outcome == GOOD) {
        for (k = 0; k < (size_t)VALVE_STATES; k++) {
            seeds[k] = out[k];
        }
        forward(&instance->run.valve, seeds, out);
    }
    for (k = 0; (k < count) && (outcome == GOOD); k++) {
        const int place = unknown_place(references[k]);
        if (place < VALVE_STATES) {
            outcome = instance_fail(instance, BAD, "value reference %u is no output", references[k]);
        } else {
            rates[k] = out[place];
        }
    }
    return outcome;
}

/* ---------------------------------------------------------------- saved states */

size_t instance_serialized_size(void)
{
    return HEAD_SIZE + sizeof(Run);
}

static void head(unsigned char bytes[HEAD_SIZE])
{
    (void)memset(bytes, 0, HEAD_SIZE);
    (void)snprintf((char *)bytes, HEAD_SIZE, "%s %u", VALVE_HASH, (unsigned)sizeof(Run));
}

Outcome instance_serialize(Instance *instance, const Run *run, unsigned char bytes[], size_t size)
{
    if (size < instance_serialized_size()) {
        return instance_fail(instance, BAD, "a saved state takes %u bytes", (unsigned)instance_serialized_size());
    }
    head(bytes);
    (void)memcpy(&bytes[HEAD_SIZE], run, sizeof *run);
    return GOOD;
}

static int sound(const Run *run)
{
    int k, good = (run->phase == PHASE_INSTANTIATED) || (run->phase == PHASE_INITIALIZATION) || (run->phase == PHASE_EVENT)
        || (run->phase == PHASE_CONTINUOUS) || (run->phase == PHASE_STEP) || (run->phase == PHASE_TERMINATED);
    for (k = 0; k < VALVE_STATES; k++) {
        good = good && isfinite(run->valve.states[k]);
    }
    for (k = 0; k < VALVE_PARAMETERS; k++) {
        good = good && isfinite(run->valve.parameters[k]);
    }
    return good && isfinite(run->valve.time) && (run->valve.step > 0.0 || run->phase < PHASE_EVENT)
        && (run->valve.tolerance > 0.0);
}

Outcome instance_deserialize(Instance *instance, const unsigned char bytes[], size_t size, Run *run)
{
    unsigned char expected[HEAD_SIZE];
    head(expected);
    if ((size != instance_serialized_size()) || (memcmp(bytes, expected, HEAD_SIZE) != 0)) {
        return instance_fail(instance, BAD, "these bytes are no saved state of this model");
    }
    (void)memcpy(run, &bytes[HEAD_SIZE], sizeof *run);
    if (!sound(run)) {
        return instance_fail(instance, BAD, "these bytes are a damaged state of this model");
    }
    run->valve.culprit = 0;
    valve_parameters_changed(&run->valve); /* what is worked out is worked out anew */
    return GOOD;
}
