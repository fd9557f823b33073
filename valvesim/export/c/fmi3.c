/* FMI 3.0, model exchange and co-simulation: the standard's functions over the instance that both versions share. */
#include "fmi3_types.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "fmi_instance.h"

/* Called first in nearly every function: no instance, or the wrong moment. */
#define REQUIRE(phases, function)                                                    \
    Instance *instance = (Instance *)given;                                          \
    if (instance == NULL) {                                                          \
        return fmi3Error;                                                            \
    }                                                                                \
    if (instance_in_phase(instance, (phases), (function)) != GOOD) {                 \
        return fmi3Error;                                                            \
    }
#define EXCHANGE (PHASE_EVENT | PHASE_CONTINUOUS)

typedef struct {
    fmi3LogMessageCallback log;
    fmi3IntermediateUpdateCallback update;
    int inputs_wanted;  /* the importer gives inputs within a step */
    int rate_wanted;    /* the rate of the command among them */
    int steps_wanted;   /* it reads outputs there, or may stop there */
    int returns_early;
    double point, end;  /* where the communication step begins and ends */
    int stopped;
} Importer;

static fmi3Status status_of(Outcome outcome)
{
    return (outcome == GOOD) ? fmi3OK : ((outcome == DISCARDED) ? fmi3Discard : fmi3Error);
}

static void tell(void *given, Outcome outcome, const char *message)
{
    const Instance *instance = (const Instance *)given;
    const Importer *importer = (const Importer *)instance->functions;
    if (importer->log != NULL) {
        const fmi3Status status = status_of(outcome);
        importer->log(instance->environment, status, (status == fmi3Discard) ? "logStatusDiscard" : "logStatusError",
                      message);
    }
}

static fmi3Instance no_instance(fmi3LogMessageCallback log, fmi3InstanceEnvironment environment, const char *message)
{
    if (log != NULL) {
        log(environment, fmi3Error, "logStatusError", message);
    }
    return NULL;
}

static fmi3Instance instantiate(int co_simulation, fmi3String name, fmi3String token, fmi3Boolean logging,
                                fmi3InstanceEnvironment environment, fmi3LogMessageCallback log)
{
    Instance *instance;
    Importer *importer;
    if ((name == NULL) || (name[0] == '\0')) {
        return no_instance(log, environment, "the instance has no name");
    }
    if ((token == NULL) || (strcmp(token, VALVE_HASH) != 0)) {
        return no_instance(log, environment,
                           "the instantiation token is not that of this model: the description is another's");
    }
    instance = (Instance *)calloc(1, sizeof *instance);
    importer = (Importer *)calloc(1, sizeof *importer);
    if ((instance == NULL) || (importer == NULL)) {
        free(instance);
        free(importer);
        return no_instance(log, environment, "out of memory");
    }
    (void)strncpy(instance->name, name, sizeof instance->name - 1);
    importer->log = log;
    instance->functions = importer;
    instance->environment = environment;
    instance->tell = tell;
    instance->logging = logging;
    instance->run.co_simulation = co_simulation;
    instance_reset(instance);
    return instance;
}

FMI3_Export const char *fmi3GetVersion(void)
{
    return fmi3Version;
}

FMI3_Export fmi3Instance fmi3InstantiateModelExchange(fmi3String instanceName, fmi3String instantiationToken,
                                                      fmi3String resourcePath, fmi3Boolean visible,
                                                      fmi3Boolean loggingOn,
                                                      fmi3InstanceEnvironment instanceEnvironment,
                                                      fmi3LogMessageCallback logMessage)
{
    (void)resourcePath;
    (void)visible;
    return instantiate(0, instanceName, instantiationToken, loggingOn, instanceEnvironment, logMessage);
}

FMI3_Export fmi3Instance fmi3InstantiateCoSimulation(
    fmi3String instanceName, fmi3String instantiationToken, fmi3String resourcePath, fmi3Boolean visible,
    fmi3Boolean loggingOn, fmi3Boolean eventModeUsed, fmi3Boolean earlyReturnAllowed,
    const fmi3ValueReference requiredIntermediateVariables[], size_t nRequiredIntermediateVariables,
    fmi3InstanceEnvironment instanceEnvironment, fmi3LogMessageCallback logMessage,
    fmi3IntermediateUpdateCallback intermediateUpdate)
{
    Instance *instance;
    size_t k;
    (void)resourcePath;
    (void)visible;
    if (eventModeUsed) {
        return no_instance(logMessage, instanceEnvironment, "this FMU has no event mode in co-simulation");
    }
    instance = (Instance *)instantiate(1, instanceName, instantiationToken, loggingOn, instanceEnvironment, logMessage);
    if (instance != NULL) {
        Importer *importer = (Importer *)instance->functions;
        importer->update = intermediateUpdate;
        importer->returns_early = earlyReturnAllowed;
        importer->steps_wanted = earlyReturnAllowed || (nRequiredIntermediateVariables > 0);
        for (k = 0; k < nRequiredIntermediateVariables; k++) {
            const fmi3ValueReference reference = requiredIntermediateVariables[k];
            importer->inputs_wanted = importer->inputs_wanted
                || ((reference >= REF_INPUT) && (reference < REF_INPUT + (unsigned)VALVE_INPUTS));
            importer->rate_wanted = importer->rate_wanted || (reference == REF_INPUT + VALVE_INPUT_COMMAND_RATE);
        }
    }
    return instance;
}

FMI3_Export fmi3Instance fmi3InstantiateScheduledExecution(
    fmi3String instanceName, fmi3String instantiationToken, fmi3String resourcePath, fmi3Boolean visible,
    fmi3Boolean loggingOn, fmi3InstanceEnvironment instanceEnvironment, fmi3LogMessageCallback logMessage,
    fmi3ClockUpdateCallback clockUpdate, fmi3LockPreemptionCallback lockPreemption,
    fmi3UnlockPreemptionCallback unlockPreemption)
{
    (void)instanceName;
    (void)instantiationToken;
    (void)resourcePath;
    (void)visible;
    (void)loggingOn;
    (void)clockUpdate;
    (void)lockPreemption;
    (void)unlockPreemption;
    return no_instance(logMessage, instanceEnvironment, "this FMU has no scheduled execution");
}

FMI3_Export void fmi3FreeInstance(fmi3Instance given)
{
    if (given != NULL) {
        free(((Instance *)given)->functions);
        free(given);
    }
}

FMI3_Export fmi3Status fmi3SetDebugLogging(fmi3Instance given, fmi3Boolean loggingOn, size_t nCategories,
                                           const fmi3String categories[])
{
    REQUIRE(PHASES_ALL, "fmi3SetDebugLogging")
    (void)nCategories;
    (void)categories;
    instance->logging = loggingOn;
    return fmi3OK;
}

FMI3_Export fmi3Status fmi3EnterInitializationMode(fmi3Instance given, fmi3Boolean toleranceDefined,
                                                   fmi3Float64 tolerance, fmi3Float64 startTime,
                                                   fmi3Boolean stopTimeDefined, fmi3Float64 stopTime)
{
    REQUIRE(PHASE_INSTANTIATED, "fmi3EnterInitializationMode")
    if (instance_tolerance(instance, toleranceDefined, tolerance) != GOOD) {
        return fmi3Error;
    }
    if (stopTimeDefined && !(stopTime > startTime)) {
        (void)instance_fail(instance, BAD, "the stop time must be after the start time");
        return fmi3Error;
    }
    if (instance_set_time(instance, startTime) != GOOD) {
        return fmi3Error;
    }
    instance->run.stop_defined = stopTimeDefined;
    instance->run.stop = stopTime;
    instance->run.phase = PHASE_INITIALIZATION;
    return fmi3OK;
}

FMI3_Export fmi3Status fmi3ExitInitializationMode(fmi3Instance given)
{
    REQUIRE(PHASE_INITIALIZATION, "fmi3ExitInitializationMode")
    if (instance_settle(instance) != GOOD) {
        return fmi3Error;
    }
    instance->run.last_step = instance->run.valve.time;
    instance->run.phase = instance->run.co_simulation ? PHASE_STEP : PHASE_EVENT;
    return fmi3OK;
}

FMI3_Export fmi3Status fmi3Terminate(fmi3Instance given)
{
    REQUIRE(PHASES_RUN, "fmi3Terminate")
    instance->run.phase = PHASE_TERMINATED;
    return fmi3OK;
}

FMI3_Export fmi3Status fmi3Reset(fmi3Instance given)
{
    REQUIRE(PHASES_ALL, "fmi3Reset")
    if (instance->inside_step) {
        (void)instance_fail(instance, BAD, "fmi3Reset: not within a step");
        return fmi3Error;
    }
    instance_reset(instance);
    return fmi3OK;
}

/* ---------------------------------------------------------------- variables */

static fmi3Status check_counts(Instance *instance, const void *references, size_t n, const void *values, size_t n_values)
{
    if ((n != n_values) || ((n > 0) && ((references == NULL) || (values == NULL)))) {
        (void)instance_fail(instance, BAD, "%u value references go with %u values: every variable is a scalar",
                            (unsigned)n, (unsigned)n_values);
        return fmi3Error;
    }
    return fmi3OK;
}

FMI3_Export fmi3Status fmi3GetFloat64(fmi3Instance given, const fmi3ValueReference valueReferences[],
                                      size_t nValueReferences, fmi3Float64 values[], size_t nValues)
{
    size_t k;
    REQUIRE(PHASES_ALL, "fmi3GetFloat64")
    if (check_counts(instance, valueReferences, nValueReferences, values, nValues) != fmi3OK) {
        return fmi3Error;
    }
    for (k = 0; k < nValueReferences; k++) {
        if (instance_get(instance, valueReferences[k], &values[k]) != GOOD) {
            return fmi3Error;
        }
    }
    return fmi3OK;
}

FMI3_Export fmi3Status fmi3SetFloat64(fmi3Instance given, const fmi3ValueReference valueReferences[],
                                      size_t nValueReferences, const fmi3Float64 values[], size_t nValues)
{
    size_t k;
    REQUIRE(PHASES_ALL & ~PHASE_TERMINATED, "fmi3SetFloat64")
    if (check_counts(instance, valueReferences, nValueReferences, values, nValues) != fmi3OK) {
        return fmi3Error;
    }
    for (k = 0; k < nValueReferences; k++) {
        if (instance_set(instance, valueReferences[k], values[k]) != GOOD) {
            return fmi3Error;
        }
    }
    return fmi3OK;
}

static fmi3Status no_variable(fmi3Instance given, size_t n, const char *function)
{
    REQUIRE(PHASES_ALL, function)
    if (n > 0) {
        (void)instance_fail(instance, BAD, "%s: every variable of this FMU is of type Float64", function);
        return fmi3Error;
    }
    return fmi3OK;
}

#define NO_VARIABLE_OF(type)                                                                                       \
    FMI3_Export fmi3Status fmi3Get##type(fmi3Instance given, const fmi3ValueReference valueReferences[],            \
                                         size_t nValueReferences, fmi3##type values[], size_t nValues)             \
    {                                                                                                              \
        (void)valueReferences;                                                                                     \
        (void)values;                                                                                              \
        (void)nValues;                                                                                             \
        return no_variable(given, nValueReferences, "fmi3Get" #type);                                              \
    }                                                                                                              \
    FMI3_Export fmi3Status fmi3Set##type(fmi3Instance given, const fmi3ValueReference valueReferences[],            \
                                         size_t nValueReferences, const fmi3##type values[], size_t nValues)       \
    {                                                                                                              \
        (void)valueReferences;                                                                                     \
        (void)values;                                                                                              \
        (void)nValues;                                                                                             \
        return no_variable(given, nValueReferences, "fmi3Set" #type);                                              \
    }

NO_VARIABLE_OF(Float32)
NO_VARIABLE_OF(Int8)
NO_VARIABLE_OF(UInt8)
NO_VARIABLE_OF(Int16)
NO_VARIABLE_OF(UInt16)
NO_VARIABLE_OF(Int32)
NO_VARIABLE_OF(UInt32)
NO_VARIABLE_OF(Int64)
NO_VARIABLE_OF(UInt64)
NO_VARIABLE_OF(Boolean)
NO_VARIABLE_OF(String)

FMI3_Export fmi3Status fmi3GetBinary(fmi3Instance given, const fmi3ValueReference valueReferences[],
                                     size_t nValueReferences, size_t valueSizes[], fmi3Binary values[], size_t nValues)
{
    (void)valueReferences;
    (void)valueSizes;
    (void)values;
    (void)nValues;
    return no_variable(given, nValueReferences, "fmi3GetBinary");
}

FMI3_Export fmi3Status fmi3SetBinary(fmi3Instance given, const fmi3ValueReference valueReferences[],
                                     size_t nValueReferences, const size_t valueSizes[], const fmi3Binary values[],
                                     size_t nValues)
{
    (void)valueReferences;
    (void)valueSizes;
    (void)values;
    (void)nValues;
    return no_variable(given, nValueReferences, "fmi3SetBinary");
}

FMI3_Export fmi3Status fmi3GetClock(fmi3Instance given, const fmi3ValueReference valueReferences[],
                                    size_t nValueReferences, fmi3Clock values[])
{
    (void)valueReferences;
    (void)values;
    return no_variable(given, nValueReferences, "fmi3GetClock");
}

FMI3_Export fmi3Status fmi3SetClock(fmi3Instance given, const fmi3ValueReference valueReferences[],
                                    size_t nValueReferences, const fmi3Clock values[])
{
    (void)valueReferences;
    (void)values;
    return no_variable(given, nValueReferences, "fmi3SetClock");
}

/* What this FMU does not have, and its description does not claim. */
static fmi3Status not_here(fmi3Instance given, const char *function, const char *what)
{
    Instance *instance = (Instance *)given;
    if (instance != NULL) {
        (void)instance_fail(instance, BAD, "%s: this FMU has no %s", function, what);
    }
    return fmi3Error;
}

FMI3_Export fmi3Status fmi3GetNumberOfVariableDependencies(fmi3Instance given, fmi3ValueReference valueReference,
                                                           size_t *nDependencies)
{
    (void)valueReference;
    (void)nDependencies;
    return not_here(given, "fmi3GetNumberOfVariableDependencies", "dependencies by element; the description has all");
}

FMI3_Export fmi3Status fmi3GetVariableDependencies(fmi3Instance given, fmi3ValueReference dependent,
                                                   size_t elementIndicesOfDependent[],
                                                   fmi3ValueReference independents[],
                                                   size_t elementIndicesOfIndependents[],
                                                   fmi3DependencyKind dependencyKinds[], size_t nDependencies)
{
    (void)dependent;
    (void)elementIndicesOfDependent;
    (void)independents;
    (void)elementIndicesOfIndependents;
    (void)dependencyKinds;
    (void)nDependencies;
    return not_here(given, "fmi3GetVariableDependencies", "dependencies by element; the description has all");
}

/* ---------------------------------------------------------------- saved states */

FMI3_Export fmi3Status fmi3GetFMUState(fmi3Instance given, fmi3FMUState *FMUState)
{
    REQUIRE(PHASES_ALL, "fmi3GetFMUState")
    if (FMUState == NULL) {
        return fmi3Error;
    }
    if (*FMUState == NULL) {
        *FMUState = malloc(sizeof(Run));
    }
    if (*FMUState == NULL) {
        (void)instance_fail(instance, BAD, "out of memory");
        return fmi3Error;
    }
    (void)memcpy(*FMUState, &instance->run, sizeof(Run));
    return fmi3OK;
}

FMI3_Export fmi3Status fmi3SetFMUState(fmi3Instance given, fmi3FMUState FMUState)
{
    REQUIRE(PHASES_ALL, "fmi3SetFMUState")
    if ((FMUState == NULL) || instance->inside_step) {
        (void)instance_fail(instance, BAD, "fmi3SetFMUState: there is no saved state, or a step is under way");
        return fmi3Error;
    }
    (void)memcpy(&instance->run, FMUState, sizeof(Run));
    return fmi3OK;
}

FMI3_Export fmi3Status fmi3FreeFMUState(fmi3Instance given, fmi3FMUState *FMUState)
{
    (void)given;
    if (FMUState != NULL) {
        free(*FMUState);
        *FMUState = NULL;
    }
    return fmi3OK;
}

FMI3_Export fmi3Status fmi3SerializedFMUStateSize(fmi3Instance given, fmi3FMUState FMUState, size_t *size)
{
    REQUIRE(PHASES_ALL, "fmi3SerializedFMUStateSize")
    (void)FMUState;
    *size = instance_serialized_size();
    return fmi3OK;
}

FMI3_Export fmi3Status fmi3SerializeFMUState(fmi3Instance given, fmi3FMUState FMUState, fmi3Byte serializedState[],
                                             size_t size)
{
    REQUIRE(PHASES_ALL, "fmi3SerializeFMUState")
    if (FMUState == NULL) {
        (void)instance_fail(instance, BAD, "fmi3SerializeFMUState: there is no saved state");
        return fmi3Error;
    }
    return status_of(instance_serialize(instance, (const Run *)FMUState, serializedState, size));
}

FMI3_Export fmi3Status fmi3DeserializeFMUState(fmi3Instance given, const fmi3Byte serializedState[], size_t size,
                                               fmi3FMUState *FMUState)
{
    Run run;
    REQUIRE(PHASES_ALL, "fmi3DeserializeFMUState")
    if ((FMUState == NULL) || (instance_deserialize(instance, serializedState, size, &run) != GOOD)) {
        return fmi3Error;
    }
    if (*FMUState == NULL) {
        *FMUState = malloc(sizeof(Run));
    }
    if (*FMUState == NULL) {
        (void)instance_fail(instance, BAD, "out of memory");
        return fmi3Error;
    }
    (void)memcpy(*FMUState, &run, sizeof run);
    return fmi3OK;
}

/* ---------------------------------------------------------------- sensitivities */

FMI3_Export fmi3Status fmi3GetDirectionalDerivative(fmi3Instance given, const fmi3ValueReference unknowns[],
                                                    size_t nUnknowns, const fmi3ValueReference knowns[],
                                                    size_t nKnowns, const fmi3Float64 seed[], size_t nSeed,
                                                    fmi3Float64 sensitivity[], size_t nSensitivity)
{
    REQUIRE(PHASES_RUN | PHASE_TERMINATED, "fmi3GetDirectionalDerivative")
    if ((check_counts(instance, knowns, nKnowns, seed, nSeed) != fmi3OK)
        || (check_counts(instance, unknowns, nUnknowns, sensitivity, nSensitivity) != fmi3OK)) {
        return fmi3Error;
    }
    return status_of(instance_directional(instance, unknowns, nUnknowns, knowns, nKnowns, seed, sensitivity));
}

FMI3_Export fmi3Status fmi3GetAdjointDerivative(fmi3Instance given, const fmi3ValueReference unknowns[],
                                                size_t nUnknowns, const fmi3ValueReference knowns[], size_t nKnowns,
                                                const fmi3Float64 seed[], size_t nSeed, fmi3Float64 sensitivity[],
                                                size_t nSensitivity)
{
    REQUIRE(PHASES_RUN | PHASE_TERMINATED, "fmi3GetAdjointDerivative")
    if ((check_counts(instance, unknowns, nUnknowns, seed, nSeed) != fmi3OK)
        || (check_counts(instance, knowns, nKnowns, sensitivity, nSensitivity) != fmi3OK)) {
        return fmi3Error;
    }
    return status_of(instance_adjoint(instance, unknowns, nUnknowns, knowns, nKnowns, seed, sensitivity));
}

/* ---------------------------------------------------------------- structure and clocks: none */

FMI3_Export fmi3Status fmi3EnterConfigurationMode(fmi3Instance given)
{
    return not_here(given, "fmi3EnterConfigurationMode", "structural parameter");
}

FMI3_Export fmi3Status fmi3ExitConfigurationMode(fmi3Instance given)
{
    return not_here(given, "fmi3ExitConfigurationMode", "structural parameter");
}

FMI3_Export fmi3Status fmi3GetIntervalDecimal(fmi3Instance given, const fmi3ValueReference valueReferences[],
                                              size_t nValueReferences, fmi3Float64 intervals[],
                                              fmi3IntervalQualifier qualifiers[])
{
    (void)valueReferences;
    (void)nValueReferences;
    (void)intervals;
    (void)qualifiers;
    return not_here(given, "fmi3GetIntervalDecimal", "clock");
}

FMI3_Export fmi3Status fmi3GetIntervalFraction(fmi3Instance given, const fmi3ValueReference valueReferences[],
                                               size_t nValueReferences, fmi3UInt64 counters[],
                                               fmi3UInt64 resolutions[], fmi3IntervalQualifier qualifiers[])
{
    (void)valueReferences;
    (void)nValueReferences;
    (void)counters;
    (void)resolutions;
    (void)qualifiers;
    return not_here(given, "fmi3GetIntervalFraction", "clock");
}

FMI3_Export fmi3Status fmi3GetShiftDecimal(fmi3Instance given, const fmi3ValueReference valueReferences[],
                                           size_t nValueReferences, fmi3Float64 shifts[])
{
    (void)valueReferences;
    (void)nValueReferences;
    (void)shifts;
    return not_here(given, "fmi3GetShiftDecimal", "clock");
}

FMI3_Export fmi3Status fmi3GetShiftFraction(fmi3Instance given, const fmi3ValueReference valueReferences[],
                                            size_t nValueReferences, fmi3UInt64 counters[], fmi3UInt64 resolutions[])
{
    (void)valueReferences;
    (void)nValueReferences;
    (void)counters;
    (void)resolutions;
    return not_here(given, "fmi3GetShiftFraction", "clock");
}

FMI3_Export fmi3Status fmi3SetIntervalDecimal(fmi3Instance given, const fmi3ValueReference valueReferences[],
                                              size_t nValueReferences, const fmi3Float64 intervals[])
{
    (void)valueReferences;
    (void)nValueReferences;
    (void)intervals;
    return not_here(given, "fmi3SetIntervalDecimal", "clock");
}

FMI3_Export fmi3Status fmi3SetIntervalFraction(fmi3Instance given, const fmi3ValueReference valueReferences[],
                                               size_t nValueReferences, const fmi3UInt64 counters[],
                                               const fmi3UInt64 resolutions[])
{
    (void)valueReferences;
    (void)nValueReferences;
    (void)counters;
    (void)resolutions;
    return not_here(given, "fmi3SetIntervalFraction", "clock");
}

FMI3_Export fmi3Status fmi3SetShiftDecimal(fmi3Instance given, const fmi3ValueReference valueReferences[],
                                           size_t nValueReferences, const fmi3Float64 shifts[])
{
    (void)valueReferences;
    (void)nValueReferences;
    (void)shifts;
    return not_here(given, "fmi3SetShiftDecimal", "clock");
}

FMI3_Export fmi3Status fmi3SetShiftFraction(fmi3Instance given, const fmi3ValueReference valueReferences[],
                                            size_t nValueReferences, const fmi3UInt64 counters[],
                                            const fmi3UInt64 resolutions[])
{
    (void)valueReferences;
    (void)nValueReferences;
    (void)counters;
    (void)resolutions;
    return not_here(given, "fmi3SetShiftFraction", "clock");
}

FMI3_Export fmi3Status fmi3ActivateModelPartition(fmi3Instance given, fmi3ValueReference clockReference,
                                                  fmi3Float64 activationTime)
{
    (void)clockReference;
    (void)activationTime;
    return not_here(given, "fmi3ActivateModelPartition", "clock");
}

/* ---------------------------------------------------------------- model exchange */

FMI3_Export fmi3Status fmi3EnterEventMode(fmi3Instance given)
{
    REQUIRE(EXCHANGE, "fmi3EnterEventMode")
    instance->run.phase = PHASE_EVENT;
    return fmi3OK;
}

FMI3_Export fmi3Status fmi3EvaluateDiscreteStates(fmi3Instance given)
{
    REQUIRE(PHASE_INITIALIZATION | PHASE_EVENT, "fmi3EvaluateDiscreteStates")
    return fmi3OK;
}

FMI3_Export fmi3Status fmi3UpdateDiscreteStates(fmi3Instance given, fmi3Boolean *discreteStatesNeedUpdate,
                                                fmi3Boolean *terminateSimulation,
                                                fmi3Boolean *nominalsOfContinuousStatesChanged,
                                                fmi3Boolean *valuesOfContinuousStatesChanged,
                                                fmi3Boolean *nextEventTimeDefined, fmi3Float64 *nextEventTime)
{
    int changed = 0;
    REQUIRE(PHASE_EVENT, "fmi3UpdateDiscreteStates")
    if (instance_update(instance, &changed) != GOOD) {
        return fmi3Error;
    }
    *discreteStatesNeedUpdate = false;
    *terminateSimulation = false;
    *nominalsOfContinuousStatesChanged = false;
    *valuesOfContinuousStatesChanged = (changed != 0);
    *nextEventTimeDefined = false;
    *nextEventTime = 0.0;
    return fmi3OK;
}

FMI3_Export fmi3Status fmi3EnterContinuousTimeMode(fmi3Instance given)
{
    REQUIRE(PHASE_EVENT, "fmi3EnterContinuousTimeMode")
    instance->run.phase = PHASE_CONTINUOUS;
    return fmi3OK;
}

FMI3_Export fmi3Status fmi3CompletedIntegratorStep(fmi3Instance given, fmi3Boolean noSetFMUStatePriorToCurrentPoint,
                                                   fmi3Boolean *enterEventMode, fmi3Boolean *terminateSimulation)
{
    REQUIRE(PHASE_CONTINUOUS, "fmi3CompletedIntegratorStep")
    (void)noSetFMUStatePriorToCurrentPoint;
    *enterEventMode = false;
    *terminateSimulation = false;
    return fmi3OK;
}

FMI3_Export fmi3Status fmi3SetTime(fmi3Instance given, fmi3Float64 time)
{
    REQUIRE(EXCHANGE, "fmi3SetTime")
    return status_of(instance_set_time(instance, time));
}

FMI3_Export fmi3Status fmi3SetContinuousStates(fmi3Instance given, const fmi3Float64 continuousStates[],
                                               size_t nContinuousStates)
{
    REQUIRE(PHASE_CONTINUOUS, "fmi3SetContinuousStates")
    return status_of(instance_set_states(instance, continuousStates, nContinuousStates));
}

FMI3_Export fmi3Status fmi3GetContinuousStateDerivatives(fmi3Instance given, fmi3Float64 derivatives[],
                                                         size_t nContinuousStates)
{
    REQUIRE(EXCHANGE | PHASE_TERMINATED, "fmi3GetContinuousStateDerivatives")
    return status_of(instance_rates(instance, derivatives, nContinuousStates));
}

FMI3_Export fmi3Status fmi3GetEventIndicators(fmi3Instance given, fmi3Float64 eventIndicators[],
                                              size_t nEventIndicators)
{
    REQUIRE(EXCHANGE | PHASE_TERMINATED, "fmi3GetEventIndicators")
    (void)eventIndicators;
    return (nEventIndicators == 0) ? fmi3OK : not_here(given, "fmi3GetEventIndicators", "event indicator");
}

FMI3_Export fmi3Status fmi3GetContinuousStates(fmi3Instance given, fmi3Float64 continuousStates[],
                                               size_t nContinuousStates)
{
    REQUIRE(EXCHANGE | PHASE_TERMINATED, "fmi3GetContinuousStates")
    if (nContinuousStates != (size_t)VALVE_STATES) {
        (void)instance_fail(instance, BAD, "%u states are asked for of %d", (unsigned)nContinuousStates, VALVE_STATES);
        return fmi3Error;
    }
    (void)memcpy(continuousStates, instance->run.valve.states, nContinuousStates * sizeof continuousStates[0]);
    return fmi3OK;
}

FMI3_Export fmi3Status fmi3GetNominalsOfContinuousStates(fmi3Instance given, fmi3Float64 nominals[],
                                                         size_t nContinuousStates)
{
    size_t k;
    REQUIRE(PHASES_ALL, "fmi3GetNominalsOfContinuousStates")
    if (nContinuousStates != (size_t)VALVE_STATES) {
        (void)instance_fail(instance, BAD, "%u nominals are asked for of %d", (unsigned)nContinuousStates, VALVE_STATES);
        return fmi3Error;
    }
    for (k = 0; k < nContinuousStates; k++) {
        nominals[k] = valve_state_table[k].scale;
    }
    return fmi3OK;
}

FMI3_Export fmi3Status fmi3GetNumberOfEventIndicators(fmi3Instance given, size_t *nEventIndicators)
{
    REQUIRE(PHASES_ALL, "fmi3GetNumberOfEventIndicators")
    *nEventIndicators = 0;
    return fmi3OK;
}

FMI3_Export fmi3Status fmi3GetNumberOfContinuousStates(fmi3Instance given, size_t *nContinuousStates)
{
    REQUIRE(PHASES_ALL, "fmi3GetNumberOfContinuousStates")
    *nContinuousStates = (size_t)VALVE_STATES;
    return fmi3OK;
}

/* ---------------------------------------------------------------- co-simulation */

FMI3_Export fmi3Status fmi3EnterStepMode(fmi3Instance given)
{
    return not_here(given, "fmi3EnterStepMode", "event mode in co-simulation to leave");
}

FMI3_Export fmi3Status fmi3GetOutputDerivatives(fmi3Instance given, const fmi3ValueReference valueReferences[],
                                                size_t nValueReferences, const fmi3Int32 orders[],
                                                fmi3Float64 values[], size_t nValues)
{
    size_t k;
    REQUIRE(PHASE_STEP | PHASE_TERMINATED, "fmi3GetOutputDerivatives")
    if (check_counts(instance, valueReferences, nValueReferences, values, nValues) != fmi3OK) {
        return fmi3Error;
    }
    for (k = 0; k < nValueReferences; k++) {
        if (orders[k] != 1) {
            (void)instance_fail(instance, BAD, "derivatives of outputs are known of first order");
            return fmi3Error;
        }
    }
    return status_of(instance_output_rates(instance, valueReferences, nValueReferences, values));
}

static double command_at(Instance *instance, double time)
{
    const Importer *importer = (const Importer *)instance->functions;
    fmi3Boolean early = false;
    fmi3Float64 early_time = 0.0;
    importer->update(instance->environment, importer->point + time, true, false, false, false, &early, &early_time);
    return instance->run.valve.inputs[VALVE_INPUT_COMMAND];
}

/* Inputs within a step, which the importer sets when it is asked to; the command's rate by what is near. */
static void inputs_at(void *given, double time, double inputs[VALVE_INPUTS])
{
    Instance *instance = (Instance *)given;
    const Importer *importer = (const Importer *)instance->functions;
    const double length = importer->end - importer->point, span = ((time < 0.5 * length) ? 1e-3 : -1e-3) * length;
    double rate = 0.0;
    if (VALVE_USES_RATE && !importer->rate_wanted) {
        rate = command_at(instance, time + span) / span;
    }
    rate -= command_at(instance, time) / span;
    (void)memcpy(inputs, instance->run.valve.inputs, sizeof instance->run.valve.inputs);
    if (VALVE_USES_RATE && !importer->rate_wanted) {
        inputs[VALVE_INPUT_COMMAND_RATE] = rate;
    }
}

/* A step inside the communication step is done: outputs may be read, and the importer may want to stop. */
static int step_done(void *given, double time, const double states[VALVE_STATES], const double inputs[VALVE_INPUTS])
{
    Instance *instance = (Instance *)given;
    Importer *importer = (Importer *)instance->functions;
    Valve *valve = &instance->run.valve;
    double kept[VALVE_INPUTS];
    const double begun = valve->time;
    fmi3Boolean early = false;
    fmi3Float64 early_time = 0.0;
    (void)states;
    (void)memcpy(kept, valve->inputs, sizeof kept);
    (void)memcpy(valve->inputs, inputs, sizeof kept);
    valve->time = importer->point + time;
    importer->update(instance->environment, valve->time, false, true, true, importer->returns_early, &early, &early_time);
    valve->time = begun;
    (void)memcpy(valve->inputs, kept, sizeof kept);
    importer->stopped = (importer->returns_early && early && (early_time <= importer->point + time));
    return importer->stopped;
}

FMI3_Export fmi3Status fmi3DoStep(fmi3Instance given, fmi3Float64 currentCommunicationPoint,
                                  fmi3Float64 communicationStepSize, fmi3Boolean noSetFMUStatePriorToCurrentPoint,
                                  fmi3Boolean *eventHandlingNeeded, fmi3Boolean *terminateSimulation,
                                  fmi3Boolean *earlyReturn, fmi3Float64 *lastSuccessfulTime)
{
    Importer *importer;
    Valve *valve;
    ValveHooks hooks = {NULL, NULL, NULL};
    ValveStatus status;
    double begun, end;
    REQUIRE(PHASE_STEP, "fmi3DoStep")
    (void)noSetFMUStatePriorToCurrentPoint;
    valve = &instance->run.valve;
    importer = (Importer *)instance->functions;
    *eventHandlingNeeded = false;
    *terminateSimulation = false;
    *earlyReturn = false;
    *lastSuccessfulTime = valve->time;
    if (instance->inside_step) {
        (void)instance_fail(instance, BAD, "fmi3DoStep: a step is under way");
        return fmi3Error;
    }
    if (instance_check_step(instance, currentCommunicationPoint, communicationStepSize) != GOOD) {
        return fmi3Error;
    }
    begun = valve->time;
    end = currentCommunicationPoint + communicationStepSize;
    importer->point = currentCommunicationPoint;
    importer->end = end;
    importer->stopped = 0;
    if (importer->update != NULL) {
        hooks.context = instance;
        hooks.inputs_at = importer->inputs_wanted ? inputs_at : NULL;
        hooks.step_done = importer->steps_wanted ? step_done : NULL;
    }
    if (VALVE_USES_RATE) {
        valve->slopes[0][VALVE_INPUT_COMMAND] = valve->inputs[VALVE_INPUT_COMMAND_RATE];
    }
    instance->inside_step = 1;
    status = valve_advance(valve, communicationStepSize, &hooks);
    instance->inside_step = 0;
    (void)memset(valve->slopes, 0, sizeof valve->slopes);
    if (status != VALVE_OK) {
        (void)instance_status(instance, status);
        *lastSuccessfulTime = valve->time;
        return fmi3Error;
    }
    if (importer->stopped && (currentCommunicationPoint + (valve->time - begun) < end)) {
        *earlyReturn = true;
        valve->time = currentCommunicationPoint + (valve->time - begun);
    } else {
        valve->time = end;
    }
    *lastSuccessfulTime = valve->time;
    instance->run.last_step = valve->time;
    return fmi3OK;
}
