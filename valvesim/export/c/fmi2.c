/* FMI 2.0, model exchange and co-simulation: the standard's functions over the instance that both versions share. */
#include "fmi2_types.h"

#include <stdlib.h>
#include <string.h>

#include "fmi_instance.h"

/* Called first in nearly every function: no instance, or the wrong moment. */
#define REQUIRE(phases, function)                                                    \
    Instance *instance = (Instance *)c;                                              \
    if (instance == NULL) {                                                          \
        return fmi2Error;                                                            \
    }                                                                                \
    if (instance_in_phase(instance, (phases), (function)) != GOOD) {                 \
        return fmi2Error;                                                            \
    }
#define EXCHANGE (PHASE_EVENT | PHASE_CONTINUOUS)

static fmi2Status status_of(Outcome outcome)
{
    return (outcome == GOOD) ? fmi2OK : ((outcome == DISCARDED) ? fmi2Discard : fmi2Error);
}

static void tell(void *given, Outcome outcome, const char *message)
{
    const Instance *instance = (const Instance *)given;
    const fmi2CallbackFunctions *functions = (const fmi2CallbackFunctions *)instance->functions;
    if ((functions != NULL) && (functions->logger != NULL)) {
        const fmi2Status status = status_of(outcome);
        functions->logger(instance->environment, instance->name, status,
                          (status == fmi2Discard) ? "logStatusDiscard" : "logStatusError", "%s", message);
    }
}

static void *no_instance(const fmi2CallbackFunctions *functions, fmi2String name, const char *message)
{
    if ((functions != NULL) && (functions->logger != NULL)) {
        functions->logger(functions->componentEnvironment, (name != NULL) ? name : "", fmi2Error, "logStatusError", "%s",
                          message);
    }
    return NULL;
}

FMI2_Export const char *fmi2GetTypesPlatform(void)
{
    return fmi2TypesPlatform;
}

FMI2_Export const char *fmi2GetVersion(void)
{
    return fmi2Version;
}

FMI2_Export fmi2Component fmi2Instantiate(fmi2String instanceName, fmi2Type fmuType, fmi2String fmuGUID,
                                          fmi2String fmuResourceLocation, const fmi2CallbackFunctions *functions,
                                          fmi2Boolean visible, fmi2Boolean loggingOn)
{
    Instance *instance;
    (void)fmuResourceLocation;
    (void)visible;
    if ((instanceName == NULL) || (instanceName[0] == '\0')) {
        return no_instance(functions, instanceName, "the instance has no name");
    }
    if ((fmuGUID == NULL) || (strcmp(fmuGUID, VALVE_HASH) != 0)) {
        return no_instance(functions, instanceName, "the GUID is not that of this model: the description is another's");
    }
    if ((fmuType != fmi2ModelExchange) && (fmuType != fmi2CoSimulation)) {
        return no_instance(functions, instanceName, "unknown type of FMU");
    }
    instance = (Instance *)calloc(1, sizeof *instance);
    if (instance == NULL) {
        return no_instance(functions, instanceName, "out of memory");
    }
    (void)strncpy(instance->name, instanceName, sizeof instance->name - 1);
    if (functions != NULL) {
        instance->functions = calloc(1, sizeof *functions);
        if (instance->functions == NULL) {
            free(instance);
            return no_instance(functions, instanceName, "out of memory");
        }
        (void)memcpy(instance->functions, functions, sizeof *functions);
        instance->environment = functions->componentEnvironment;
    }
    instance->tell = tell;
    instance->logging = loggingOn;
    instance->run.co_simulation = (fmuType == fmi2CoSimulation);
    instance_reset(instance);
    return instance;
}

FMI2_Export void fmi2FreeInstance(fmi2Component c)
{
    if (c != NULL) {
        free(((Instance *)c)->functions);
        free(c);
    }
}

FMI2_Export fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean loggingOn, size_t nCategories,
                                           const fmi2String categories[])
{
    REQUIRE(PHASES_ALL, "fmi2SetDebugLogging")
    (void)nCategories;
    (void)categories;
    instance->logging = loggingOn;
    return fmi2OK;
}

FMI2_Export fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean toleranceDefined, fmi2Real tolerance,
                                           fmi2Real startTime, fmi2Boolean stopTimeDefined, fmi2Real stopTime)
{
    REQUIRE(PHASE_INSTANTIATED, "fmi2SetupExperiment")
    if (instance_tolerance(instance, toleranceDefined, tolerance) != GOOD) {
        return fmi2Error;
    }
    if (stopTimeDefined && !(stopTime > startTime)) {
        (void)instance_fail(instance, BAD, "the stop time must be after the start time");
        return fmi2Error;
    }
    instance->run.stop_defined = stopTimeDefined;
    instance->run.stop = stopTime;
    return status_of(instance_set_time(instance, startTime));
}

FMI2_Export fmi2Status fmi2EnterInitializationMode(fmi2Component c)
{
    REQUIRE(PHASE_INSTANTIATED, "fmi2EnterInitializationMode")
    instance->run.phase = PHASE_INITIALIZATION;
    return fmi2OK;
}

FMI2_Export fmi2Status fmi2ExitInitializationMode(fmi2Component c)
{
    REQUIRE(PHASE_INITIALIZATION, "fmi2ExitInitializationMode")
    if (instance_settle(instance) != GOOD) {
        return fmi2Error;
    }
    instance->run.last_step = instance->run.valve.time;
    instance->run.phase = instance->run.co_simulation ? PHASE_STEP : PHASE_EVENT;
    return fmi2OK;
}

FMI2_Export fmi2Status fmi2Terminate(fmi2Component c)
{
    REQUIRE(PHASES_RUN, "fmi2Terminate")
    instance->run.phase = PHASE_TERMINATED;
    return fmi2OK;
}

FMI2_Export fmi2Status fmi2Reset(fmi2Component c)
{
    REQUIRE(PHASES_ALL, "fmi2Reset")
    instance_reset(instance);
    return fmi2OK;
}

/* ---------------------------------------------------------------- variables */

FMI2_Export fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, fmi2Real value[])
{
    size_t k;
    REQUIRE(PHASES_ALL, "fmi2GetReal")
    if ((nvr > 0) && ((vr == NULL) || (value == NULL))) {
        (void)instance_fail(instance, BAD, "fmi2GetReal: no arrays are given");
        return fmi2Error;
    }
    for (k = 0; k < nvr; k++) {
        if (instance_get(instance, vr[k], &value[k]) != GOOD) {
            return fmi2Error;
        }
    }
    return fmi2OK;
}

FMI2_Export fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, const fmi2Real value[])
{
    size_t k;
    REQUIRE(PHASES_ALL & ~PHASE_TERMINATED, "fmi2SetReal")
    if ((nvr > 0) && ((vr == NULL) || (value == NULL))) {
        (void)instance_fail(instance, BAD, "fmi2SetReal: no arrays are given");
        return fmi2Error;
    }
    for (k = 0; k < nvr; k++) {
        if (instance_set(instance, vr[k], value[k]) != GOOD) {
            return fmi2Error;
        }
    }
    return fmi2OK;
}

static fmi2Status no_variable(fmi2Component c, size_t nvr, const char *function)
{
    REQUIRE(PHASES_ALL, function)
    if (nvr > 0) {
        (void)instance_fail(instance, BAD, "%s: every variable of this FMU is real", function);
        return fmi2Error;
    }
    return fmi2OK;
}

FMI2_Export fmi2Status fmi2GetInteger(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, fmi2Integer value[])
{
    (void)vr;
    (void)value;
    return no_variable(c, nvr, "fmi2GetInteger");
}

FMI2_Export fmi2Status fmi2GetBoolean(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, fmi2Boolean value[])
{
    (void)vr;
    (void)value;
    return no_variable(c, nvr, "fmi2GetBoolean");
}

FMI2_Export fmi2Status fmi2GetString(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, fmi2String value[])
{
    (void)vr;
    (void)value;
    return no_variable(c, nvr, "fmi2GetString");
}

FMI2_Export fmi2Status fmi2SetInteger(fmi2Component c, const fmi2ValueReference vr[], size_t nvr,
                                      const fmi2Integer value[])
{
    (void)vr;
    (void)value;
    return no_variable(c, nvr, "fmi2SetInteger");
}

FMI2_Export fmi2Status fmi2SetBoolean(fmi2Component c, const fmi2ValueReference vr[], size_t nvr,
                                      const fmi2Boolean value[])
{
    (void)vr;
    (void)value;
    return no_variable(c, nvr, "fmi2SetBoolean");
}

FMI2_Export fmi2Status fmi2SetString(fmi2Component c, const fmi2ValueReference vr[], size_t nvr,
                                     const fmi2String value[])
{
    (void)vr;
    (void)value;
    return no_variable(c, nvr, "fmi2SetString");
}

/* ---------------------------------------------------------------- saved states */

FMI2_Export fmi2Status fmi2GetFMUstate(fmi2Component c, fmi2FMUstate *FMUstate)
{
    REQUIRE(PHASES_ALL, "fmi2GetFMUstate")
    if (FMUstate == NULL) {
        return fmi2Error;
    }
    if (*FMUstate == NULL) {
        *FMUstate = malloc(sizeof(Run));
    }
    if (*FMUstate == NULL) {
        (void)instance_fail(instance, BAD, "out of memory");
        return fmi2Error;
    }
    (void)memcpy(*FMUstate, &instance->run, sizeof(Run));
    return fmi2OK;
}

FMI2_Export fmi2Status fmi2SetFMUstate(fmi2Component c, fmi2FMUstate FMUstate)
{
    REQUIRE(PHASES_ALL, "fmi2SetFMUstate")
    if (FMUstate == NULL) {
        (void)instance_fail(instance, BAD, "fmi2SetFMUstate: there is no saved state");
        return fmi2Error;
    }
    (void)memcpy(&instance->run, FMUstate, sizeof(Run));
    return fmi2OK;
}

FMI2_Export fmi2Status fmi2FreeFMUstate(fmi2Component c, fmi2FMUstate *FMUstate)
{
    (void)c;
    if (FMUstate != NULL) {
        free(*FMUstate);
        *FMUstate = NULL;
    }
    return fmi2OK;
}

FMI2_Export fmi2Status fmi2SerializedFMUstateSize(fmi2Component c, fmi2FMUstate FMUstate, size_t *size)
{
    REQUIRE(PHASES_ALL, "fmi2SerializedFMUstateSize")
    (void)FMUstate;
    *size = instance_serialized_size();
    return fmi2OK;
}

FMI2_Export fmi2Status fmi2SerializeFMUstate(fmi2Component c, fmi2FMUstate FMUstate, fmi2Byte serializedState[],
                                             size_t size)
{
    REQUIRE(PHASES_ALL, "fmi2SerializeFMUstate")
    if (FMUstate == NULL) {
        (void)instance_fail(instance, BAD, "fmi2SerializeFMUstate: there is no saved state");
        return fmi2Error;
    }
    return status_of(instance_serialize(instance, (const Run *)FMUstate, (unsigned char *)serializedState, size));
}

FMI2_Export fmi2Status fmi2DeSerializeFMUstate(fmi2Component c, const fmi2Byte serializedState[], size_t size,
                                               fmi2FMUstate *FMUstate)
{
    Run run;
    REQUIRE(PHASES_ALL, "fmi2DeSerializeFMUstate")
    if ((FMUstate == NULL)
        || (instance_deserialize(instance, (const unsigned char *)serializedState, size, &run) != GOOD)) {
        return fmi2Error;
    }
    if (*FMUstate == NULL) {
        *FMUstate = malloc(sizeof(Run));
    }
    if (*FMUstate == NULL) {
        (void)instance_fail(instance, BAD, "out of memory");
        return fmi2Error;
    }
    (void)memcpy(*FMUstate, &run, sizeof run);
    return fmi2OK;
}

FMI2_Export fmi2Status fmi2GetDirectionalDerivative(fmi2Component c, const fmi2ValueReference vUnknown_ref[],
                                                    size_t nUnknown, const fmi2ValueReference vKnown_ref[],
                                                    size_t nKnown, const fmi2Real dvKnown[], fmi2Real dvUnknown[])
{
    REQUIRE(PHASES_RUN | PHASE_TERMINATED, "fmi2GetDirectionalDerivative")
    return status_of(instance_directional(instance, vUnknown_ref, nUnknown, vKnown_ref, nKnown, dvKnown, dvUnknown));
}

/* ---------------------------------------------------------------- model exchange */

FMI2_Export fmi2Status fmi2EnterEventMode(fmi2Component c)
{
    REQUIRE(EXCHANGE, "fmi2EnterEventMode")
    instance->run.phase = PHASE_EVENT;
    return fmi2OK;
}

FMI2_Export fmi2Status fmi2NewDiscreteStates(fmi2Component c, fmi2EventInfo *eventInfo)
{
    int changed = 0;
    REQUIRE(PHASE_EVENT, "fmi2NewDiscreteStates")
    if (instance_update(instance, &changed) != GOOD) {
        return fmi2Error;
    }
    eventInfo->newDiscreteStatesNeeded = fmi2False;
    eventInfo->terminateSimulation = fmi2False;
    eventInfo->nominalsOfContinuousStatesChanged = fmi2False;
    eventInfo->valuesOfContinuousStatesChanged = changed ? fmi2True : fmi2False;
    eventInfo->nextEventTimeDefined = fmi2False;
    eventInfo->nextEventTime = 0.0;
    return fmi2OK;
}

FMI2_Export fmi2Status fmi2EnterContinuousTimeMode(fmi2Component c)
{
    REQUIRE(PHASE_EVENT, "fmi2EnterContinuousTimeMode")
    instance->run.phase = PHASE_CONTINUOUS;
    return fmi2OK;
}

FMI2_Export fmi2Status fmi2CompletedIntegratorStep(fmi2Component c, fmi2Boolean noSetFMUStatePriorToCurrentPoint,
                                                   fmi2Boolean *enterEventMode, fmi2Boolean *terminateSimulation)
{
    REQUIRE(PHASE_CONTINUOUS, "fmi2CompletedIntegratorStep")
    (void)noSetFMUStatePriorToCurrentPoint;
    *enterEventMode = fmi2False;
    *terminateSimulation = fmi2False;
    return fmi2OK;
}

FMI2_Export fmi2Status fmi2SetTime(fmi2Component c, fmi2Real time)
{
    REQUIRE(EXCHANGE, "fmi2SetTime")
    return status_of(instance_set_time(instance, time));
}

FMI2_Export fmi2Status fmi2SetContinuousStates(fmi2Component c, const fmi2Real x[], size_t nx)
{
    REQUIRE(PHASE_CONTINUOUS, "fmi2SetContinuousStates")
    return status_of(instance_set_states(instance, x, nx));
}

FMI2_Export fmi2Status fmi2GetDerivatives(fmi2Component c, fmi2Real derivatives[], size_t nx)
{
    REQUIRE(EXCHANGE | PHASE_TERMINATED, "fmi2GetDerivatives")
    return status_of(instance_rates(instance, derivatives, nx));
}

FMI2_Export fmi2Status fmi2GetEventIndicators(fmi2Component c, fmi2Real eventIndicators[], size_t ni)
{
    REQUIRE(EXCHANGE | PHASE_TERMINATED, "fmi2GetEventIndicators")
    (void)eventIndicators;
    if (ni != 0) {
        (void)instance_fail(instance, BAD, "this FMU has no event indicators");
        return fmi2Error;
    }
    return fmi2OK;
}

FMI2_Export fmi2Status fmi2GetContinuousStates(fmi2Component c, fmi2Real x[], size_t nx)
{
    REQUIRE(EXCHANGE | PHASE_TERMINATED, "fmi2GetContinuousStates")
    if (nx != (size_t)VALVE_STATES) {
        (void)instance_fail(instance, BAD, "%u states are asked for of %d", (unsigned)nx, VALVE_STATES);
        return fmi2Error;
    }
    (void)memcpy(x, instance->run.valve.states, nx * sizeof x[0]);
    return fmi2OK;
}

FMI2_Export fmi2Status fmi2GetNominalsOfContinuousStates(fmi2Component c, fmi2Real x_nominal[], size_t nx)
{
    size_t k;
    REQUIRE(PHASES_ALL, "fmi2GetNominalsOfContinuousStates")
    if (nx != (size_t)VALVE_STATES) {
        (void)instance_fail(instance, BAD, "%u nominals are asked for of %d", (unsigned)nx, VALVE_STATES);
        return fmi2Error;
    }
    for (k = 0; k < nx; k++) {
        x_nominal[k] = valve_state_table[k].scale;
    }
    return fmi2OK;
}

/* ---------------------------------------------------------------- co-simulation */

FMI2_Export fmi2Status fmi2SetRealInputDerivatives(fmi2Component c, const fmi2ValueReference vr[], size_t nvr,
                                                   const fmi2Integer order[], const fmi2Real value[])
{
    size_t k;
    REQUIRE(PHASE_INSTANTIATED | PHASE_INITIALIZATION | PHASE_STEP, "fmi2SetRealInputDerivatives")
    for (k = 0; k < nvr; k++) {
        if ((vr[k] < REF_INPUT) || (vr[k] >= REF_INPUT + (unsigned)VALVE_INPUTS)) {
            (void)instance_fail(instance, BAD, "value reference %u is no input", vr[k]);
            return fmi2Error;
        }
        if ((order[k] < 1) || (order[k] > VALVE_ORDERS)) {
            (void)instance_fail(instance, BAD, "derivatives of inputs are followed to order %d", VALVE_ORDERS);
            return fmi2Error;
        }
        if (!(value[k] - value[k] == 0.0)) {
            (void)instance_fail(instance, BAD, "%s: its derivative is not a finite number",
                                valve_input_table[vr[k] - REF_INPUT].name);
            return fmi2Error;
        }
        instance->run.valve.slopes[order[k] - 1][vr[k] - REF_INPUT] = value[k];
    }
    return fmi2OK;
}

FMI2_Export fmi2Status fmi2GetRealOutputDerivatives(fmi2Component c, const fmi2ValueReference vr[], size_t nvr,
                                                    const fmi2Integer order[], fmi2Real value[])
{
    size_t k;
    REQUIRE(PHASE_STEP | PHASE_TERMINATED, "fmi2GetRealOutputDerivatives")
    for (k = 0; k < nvr; k++) {
        if (order[k] != 1) {
            (void)instance_fail(instance, BAD, "derivatives of outputs are known of first order");
            return fmi2Error;
        }
    }
    return status_of(instance_output_rates(instance, vr, nvr, value));
}

FMI2_Export fmi2Status fmi2DoStep(fmi2Component c, fmi2Real currentCommunicationPoint, fmi2Real communicationStepSize,
                                  fmi2Boolean noSetFMUStatePriorToCurrentPoint)
{
    Valve *valve;
    ValveStatus status;
    REQUIRE(PHASE_STEP, "fmi2DoStep")
    (void)noSetFMUStatePriorToCurrentPoint;
    valve = &instance->run.valve;
    if (instance_check_step(instance, currentCommunicationPoint, communicationStepSize) != GOOD) {
        return fmi2Error;
    }
    if ((valve->slopes[0][VALVE_INPUT_COMMAND] == 0.0) && VALVE_USES_RATE) {
        valve->slopes[0][VALVE_INPUT_COMMAND] = valve->inputs[VALVE_INPUT_COMMAND_RATE];
    }
    status = valve_advance(valve, communicationStepSize, NULL);
    (void)memset(valve->slopes, 0, sizeof valve->slopes);
    if (status != VALVE_OK) {
        (void)instance_status(instance, status);
        return fmi2Error;
    }
    valve->time = currentCommunicationPoint + communicationStepSize;
    instance->run.last_step = valve->time;
    return fmi2OK;
}

FMI2_Export fmi2Status fmi2CancelStep(fmi2Component c)
{
    REQUIRE(PHASES_ALL, "fmi2CancelStep")
    (void)instance_fail(instance, BAD, "fmi2CancelStep: a step is done before fmi2DoStep returns");
    return fmi2Error;
}

FMI2_Export fmi2Status fmi2GetStatus(fmi2Component c, const fmi2StatusKind s, fmi2Status *value)
{
    REQUIRE(PHASES_ALL, "fmi2GetStatus")
    (void)s;
    (void)value;
    (void)instance_fail(instance, DISCARDED, "fmi2GetStatus: no step is ever pending");
    return fmi2Discard;
}

FMI2_Export fmi2Status fmi2GetRealStatus(fmi2Component c, const fmi2StatusKind s, fmi2Real *value)
{
    REQUIRE(PHASES_ALL, "fmi2GetRealStatus")
    if (s != fmi2LastSuccessfulTime) {
        (void)instance_fail(instance, DISCARDED, "fmi2GetRealStatus: only the last successful time is known");
        return fmi2Discard;
    }
    *value = instance->run.last_step;
    return fmi2OK;
}

FMI2_Export fmi2Status fmi2GetIntegerStatus(fmi2Component c, const fmi2StatusKind s, fmi2Integer *value)
{
    REQUIRE(PHASES_ALL, "fmi2GetIntegerStatus")
    (void)s;
    (void)value;
    return fmi2Discard;
}

FMI2_Export fmi2Status fmi2GetBooleanStatus(fmi2Component c, const fmi2StatusKind s, fmi2Boolean *value)
{
    REQUIRE(PHASES_ALL, "fmi2GetBooleanStatus")
    if (s != fmi2Terminated) {
        return fmi2Discard;
    }
    *value = fmi2False;
    return fmi2OK;
}

FMI2_Export fmi2Status fmi2GetStringStatus(fmi2Component c, const fmi2StatusKind s, fmi2String *value)
{
    REQUIRE(PHASES_ALL, "fmi2GetStringStatus")
    (void)s;
    (void)value;
    return fmi2Discard;
}
