/* The interface of FMI 3.0: Model Exchange and Co-Simulation. It only translates; see instance.h and dop853.h. */
#include "fmi3Functions.h"

#include "dop853.h"
#include "instance.h"

#define UNUSED(argument) ((void)(argument))
#define STATUS(status) ((fmi3Status)(status))

static void report(Instance *c, int status, const char *category, const char *message) {
    fmi3LogMessageCallback log_message;
    memcpy(&log_message, &c->callbacks, sizeof log_message); /* ISO C has no cast from void * to a function */
    log_message(c->environment, STATUS(status), category, message);
}

static Instance *instantiate(fmi3String name, fmi3String token, int kind, fmi3Boolean logging_on,
                             fmi3InstanceEnvironment environment, fmi3LogMessageCallback log_message) {
    Instance *c;
    if (!token || strcmp(token, INSTANTIATION_TOKEN)) {
        if (log_message) log_message(environment, fmi3Error, "logStatusError", "Instantiate: wrong instantiation token");
        return NULL;
    }
    c = new_instance(name, kind, logging_on);
    if (!c) return NULL;
    c->environment = environment;
    if (log_message) {
        memcpy(&c->callbacks, &log_message, sizeof log_message);
        c->report = report;
    }
    return c;
}

/* Creation and modes ------------------------------------------------------------------------------------------------ */

const char *fmi3GetVersion(void) { return fmi3Version; }

fmi3Instance fmi3InstantiateModelExchange(fmi3String instanceName, fmi3String instantiationToken,
                                          fmi3String resourcePath, fmi3Boolean visible, fmi3Boolean loggingOn,
                                          fmi3InstanceEnvironment instanceEnvironment,
                                          fmi3LogMessageCallback logMessage) {
    UNUSED(resourcePath), UNUSED(visible);
    return instantiate(instanceName, instantiationToken, MODEL_EXCHANGE, loggingOn, instanceEnvironment, logMessage);
}

fmi3Instance fmi3InstantiateCoSimulation(fmi3String instanceName, fmi3String instantiationToken,
                                         fmi3String resourcePath, fmi3Boolean visible, fmi3Boolean loggingOn,
                                         fmi3Boolean eventModeUsed, fmi3Boolean earlyReturnAllowed,
                                         const fmi3ValueReference requiredIntermediateVariables[],
                                         size_t nRequiredIntermediateVariables,
                                         fmi3InstanceEnvironment instanceEnvironment,
                                         fmi3LogMessageCallback logMessage,
                                         fmi3IntermediateUpdateCallback intermediateUpdate) {
    UNUSED(resourcePath), UNUSED(visible), UNUSED(earlyReturnAllowed), UNUSED(intermediateUpdate);
    UNUSED(requiredIntermediateVariables), UNUSED(nRequiredIntermediateVariables);
    if (eventModeUsed) {
        if (logMessage) logMessage(instanceEnvironment, fmi3Error, "logStatusError", "Instantiate: no Event Mode here");
        return NULL;
    }
    return instantiate(instanceName, instantiationToken, CO_SIMULATION, loggingOn, instanceEnvironment, logMessage);
}

fmi3Instance fmi3InstantiateScheduledExecution(fmi3String instanceName, fmi3String instantiationToken,
                                               fmi3String resourcePath, fmi3Boolean visible, fmi3Boolean loggingOn,
                                               fmi3InstanceEnvironment instanceEnvironment,
                                               fmi3LogMessageCallback logMessage, fmi3ClockUpdateCallback clockUpdate,
                                               fmi3LockPreemptionCallback lockPreemption,
                                               fmi3UnlockPreemptionCallback unlockPreemption) {
    UNUSED(instanceName), UNUSED(instantiationToken), UNUSED(resourcePath), UNUSED(visible), UNUSED(loggingOn);
    UNUSED(clockUpdate), UNUSED(lockPreemption), UNUSED(unlockPreemption);
    if (logMessage)
        logMessage(instanceEnvironment, fmi3Error, "logStatusError", "Instantiate: no Scheduled Execution here");
    return NULL;
}

void fmi3FreeInstance(fmi3Instance instance) { free(instance); }

fmi3Status fmi3SetDebugLogging(fmi3Instance instance, fmi3Boolean loggingOn, size_t nCategories,
                               const fmi3String categories[]) {
    if (allowed(instance, "SetDebugLogging", ~0) != OK) return fmi3Error;
    return STATUS(set_logging(instance, loggingOn, nCategories, categories));
}

fmi3Status fmi3EnterInitializationMode(fmi3Instance instance, fmi3Boolean toleranceDefined, fmi3Float64 tolerance,
                                       fmi3Float64 startTime, fmi3Boolean stopTimeDefined, fmi3Float64 stopTime) {
    Instance *c = instance;
    UNUSED(stopTimeDefined), UNUSED(stopTime);
    if (begin_initialization(c, "EnterInitializationMode", toleranceDefined, tolerance, startTime) != OK)
        return fmi3Error;
    c->now.mode = INITIALIZATION;
    return fmi3OK;
}

fmi3Status fmi3ExitInitializationMode(fmi3Instance instance) {
    Instance *c = instance;
    return STATUS(move(c, "ExitInitializationMode", INITIALIZATION, c && c->kind == MODEL_EXCHANGE ? EVENT : STEP));
}

fmi3Status fmi3EnterEventMode(fmi3Instance instance) {
    if (in_model_exchange(instance, "EnterEventMode", CONTINUOUS) != OK) return fmi3Error;
    return STATUS(move(instance, "EnterEventMode", CONTINUOUS, EVENT));
}

fmi3Status fmi3EnterContinuousTimeMode(fmi3Instance instance) {
    if (in_model_exchange(instance, "EnterContinuousTimeMode", EVENT) != OK) return fmi3Error;
    return STATUS(move(instance, "EnterContinuousTimeMode", EVENT, CONTINUOUS));
}

fmi3Status fmi3EnterStepMode(fmi3Instance instance) { return STATUS(allowed(instance, "EnterStepMode", 0)); }

fmi3Status fmi3EnterConfigurationMode(fmi3Instance instance) {
    return STATUS(allowed(instance, "EnterConfigurationMode", 0));
}

fmi3Status fmi3ExitConfigurationMode(fmi3Instance instance) {
    return STATUS(allowed(instance, "ExitConfigurationMode", 0));
}

fmi3Status fmi3Terminate(fmi3Instance instance) {
    return STATUS(move(instance, "Terminate", EVENT | CONTINUOUS | STEP, TERMINATED));
}

fmi3Status fmi3Reset(fmi3Instance instance) {
    if (!instance) return fmi3Error;
    start_values(instance);
    return fmi3OK;
}

/* Values ------------------------------------------------------------------------------------------------------------- */

fmi3Status fmi3GetFloat64(fmi3Instance instance, const fmi3ValueReference valueReferences[], size_t nValueReferences,
                          fmi3Float64 values[], size_t nValues) {
    if (instance && nValues != nValueReferences)
        return STATUS(say(instance, ERROR, "GetFloat64: as many values as references are accepted"));
    return STATUS(get_values(instance, "GetFloat64", valueReferences, nValueReferences, values));
}

fmi3Status fmi3SetFloat64(fmi3Instance instance, const fmi3ValueReference valueReferences[], size_t nValueReferences,
                          const fmi3Float64 values[], size_t nValues) {
    if (instance && nValues != nValueReferences)
        return STATUS(say(instance, ERROR, "SetFloat64: as many values as references are accepted"));
    return STATUS(set_values(instance, "SetFloat64", valueReferences, nValueReferences, values));
}

/* There are variables of no other type. */
static fmi3Status none(Instance *c, const char *function, size_t count) {
    if (allowed(c, function, ~0) != OK) return fmi3Error;
    return count ? STATUS(say(c, ERROR, "%s: no variable has this type", function)) : fmi3OK;
}

#define OTHER_TYPE(type)                                                                                              \
    fmi3Status fmi3Get##type(fmi3Instance instance, const fmi3ValueReference valueReferences[],                       \
                             size_t nValueReferences, fmi3##type values[], size_t nValues) {                          \
        UNUSED(valueReferences), UNUSED(values), UNUSED(nValues);                                                     \
        return none(instance, "Get" #type, nValueReferences);                                                         \
    }                                                                                                                 \
    fmi3Status fmi3Set##type(fmi3Instance instance, const fmi3ValueReference valueReferences[],                       \
                             size_t nValueReferences, const fmi3##type values[], size_t nValues) {                    \
        UNUSED(valueReferences), UNUSED(values), UNUSED(nValues);                                                     \
        return none(instance, "Set" #type, nValueReferences);                                                         \
    }
OTHER_TYPE(Float32)
OTHER_TYPE(Int8)
OTHER_TYPE(UInt8)
OTHER_TYPE(Int16)
OTHER_TYPE(UInt16)
OTHER_TYPE(Int32)
OTHER_TYPE(UInt32)
OTHER_TYPE(Int64)
OTHER_TYPE(UInt64)
OTHER_TYPE(Boolean)
OTHER_TYPE(String)

fmi3Status fmi3GetBinary(fmi3Instance instance, const fmi3ValueReference valueReferences[], size_t nValueReferences,
                         size_t valueSizes[], fmi3Binary values[], size_t nValues) {
    UNUSED(valueReferences), UNUSED(valueSizes), UNUSED(values), UNUSED(nValues);
    return none(instance, "GetBinary", nValueReferences);
}

fmi3Status fmi3SetBinary(fmi3Instance instance, const fmi3ValueReference valueReferences[], size_t nValueReferences,
                         const size_t valueSizes[], const fmi3Binary values[], size_t nValues) {
    UNUSED(valueReferences), UNUSED(valueSizes), UNUSED(values), UNUSED(nValues);
    return none(instance, "SetBinary", nValueReferences);
}

fmi3Status fmi3GetClock(fmi3Instance instance, const fmi3ValueReference valueReferences[], size_t nValueReferences,
                        fmi3Clock values[]) {
    UNUSED(valueReferences), UNUSED(values);
    return none(instance, "GetClock", nValueReferences);
}

fmi3Status fmi3SetClock(fmi3Instance instance, const fmi3ValueReference valueReferences[], size_t nValueReferences,
                        const fmi3Clock values[]) {
    UNUSED(valueReferences), UNUSED(values);
    return none(instance, "SetClock", nValueReferences);
}

fmi3Status fmi3GetIntervalDecimal(fmi3Instance instance, const fmi3ValueReference valueReferences[],
                                  size_t nValueReferences, fmi3Float64 intervals[],
                                  fmi3IntervalQualifier qualifiers[]) {
    UNUSED(valueReferences), UNUSED(intervals), UNUSED(qualifiers);
    return none(instance, "GetIntervalDecimal", nValueReferences);
}

fmi3Status fmi3GetIntervalFraction(fmi3Instance instance, const fmi3ValueReference valueReferences[],
                                   size_t nValueReferences, fmi3UInt64 counters[], fmi3UInt64 resolutions[],
                                   fmi3IntervalQualifier qualifiers[]) {
    UNUSED(valueReferences), UNUSED(counters), UNUSED(resolutions), UNUSED(qualifiers);
    return none(instance, "GetIntervalFraction", nValueReferences);
}

fmi3Status fmi3GetShiftDecimal(fmi3Instance instance, const fmi3ValueReference valueReferences[],
                               size_t nValueReferences, fmi3Float64 shifts[]) {
    UNUSED(valueReferences), UNUSED(shifts);
    return none(instance, "GetShiftDecimal", nValueReferences);
}

fmi3Status fmi3GetShiftFraction(fmi3Instance instance, const fmi3ValueReference valueReferences[],
                                size_t nValueReferences, fmi3UInt64 counters[], fmi3UInt64 resolutions[]) {
    UNUSED(valueReferences), UNUSED(counters), UNUSED(resolutions);
    return none(instance, "GetShiftFraction", nValueReferences);
}

fmi3Status fmi3SetIntervalDecimal(fmi3Instance instance, const fmi3ValueReference valueReferences[],
                                  size_t nValueReferences, const fmi3Float64 intervals[]) {
    UNUSED(valueReferences), UNUSED(intervals);
    return none(instance, "SetIntervalDecimal", nValueReferences);
}

fmi3Status fmi3SetIntervalFraction(fmi3Instance instance, const fmi3ValueReference valueReferences[],
                                   size_t nValueReferences, const fmi3UInt64 counters[],
                                   const fmi3UInt64 resolutions[]) {
    UNUSED(valueReferences), UNUSED(counters), UNUSED(resolutions);
    return none(instance, "SetIntervalFraction", nValueReferences);
}

fmi3Status fmi3SetShiftDecimal(fmi3Instance instance, const fmi3ValueReference valueReferences[],
                               size_t nValueReferences, const fmi3Float64 shifts[]) {
    UNUSED(valueReferences), UNUSED(shifts);
    return none(instance, "SetShiftDecimal", nValueReferences);
}

fmi3Status fmi3SetShiftFraction(fmi3Instance instance, const fmi3ValueReference valueReferences[],
                                size_t nValueReferences, const fmi3UInt64 counters[],
                                const fmi3UInt64 resolutions[]) {
    UNUSED(valueReferences), UNUSED(counters), UNUSED(resolutions);
    return none(instance, "SetShiftFraction", nValueReferences);
}

/* Dependencies of elements are not provided: all variables are scalars, see modelDescription.xml. */
fmi3Status fmi3GetNumberOfVariableDependencies(fmi3Instance instance, fmi3ValueReference valueReference,
                                               size_t *nDependencies) {
    UNUSED(valueReference), UNUSED(nDependencies);
    return none(instance, "GetNumberOfVariableDependencies", 1);
}

fmi3Status fmi3GetVariableDependencies(fmi3Instance instance, fmi3ValueReference dependent,
                                       size_t elementIndicesOfDependent[], fmi3ValueReference independents[],
                                       size_t elementIndicesOfIndependents[], fmi3DependencyKind dependencyKinds[],
                                       size_t nDependencies) {
    UNUSED(dependent), UNUSED(elementIndicesOfDependent), UNUSED(independents);
    UNUSED(elementIndicesOfIndependents), UNUSED(dependencyKinds), UNUSED(nDependencies);
    return none(instance, "GetVariableDependencies", 1);
}

/* The FMU state ------------------------------------------------------------------------------------------------------ */

fmi3Status fmi3GetFMUState(fmi3Instance instance, fmi3FMUState *FMUState) {
    return STATUS(get_state(instance, "GetFMUState", FMUState));
}

fmi3Status fmi3SetFMUState(fmi3Instance instance, fmi3FMUState FMUState) {
    return STATUS(set_state(instance, "SetFMUState", FMUState));
}

fmi3Status fmi3FreeFMUState(fmi3Instance instance, fmi3FMUState *FMUState) {
    return STATUS(free_state(instance, "FreeFMUState", FMUState));
}

fmi3Status fmi3SerializedFMUStateSize(fmi3Instance instance, fmi3FMUState FMUState, size_t *size) {
    UNUSED(FMUState);
    if (allowed(instance, "SerializedFMUStateSize", ~0) != OK) return fmi3Error;
    *size = SERIALISED;
    return fmi3OK;
}

fmi3Status fmi3SerializeFMUState(fmi3Instance instance, fmi3FMUState FMUState, fmi3Byte serializedState[],
                                 size_t size) {
    return STATUS(serialise(instance, "SerializeFMUState", FMUState, (char *)serializedState, size));
}

fmi3Status fmi3DeserializeFMUState(fmi3Instance instance, const fmi3Byte serializedState[], size_t size,
                                   fmi3FMUState *FMUState) {
    return STATUS(deserialise(instance, "DeserializeFMUState", (const char *)serializedState, size, FMUState));
}

/* Partial derivatives ------------------------------------------------------------------------------------------------ */

fmi3Status fmi3GetDirectionalDerivative(fmi3Instance instance, const fmi3ValueReference unknowns[], size_t nUnknowns,
                                        const fmi3ValueReference knowns[], size_t nKnowns, const fmi3Float64 seed[],
                                        size_t nSeed, fmi3Float64 sensitivity[], size_t nSensitivity) {
    if (instance && (nSeed != nKnowns || nSensitivity != nUnknowns))
        return STATUS(say(instance, ERROR, "GetDirectionalDerivative: seeds or sensitivities are too few or many"));
    return STATUS(directional(instance, "GetDirectionalDerivative", unknowns, nUnknowns, knowns, nKnowns, seed,
                              sensitivity));
}

fmi3Status fmi3GetAdjointDerivative(fmi3Instance instance, const fmi3ValueReference unknowns[], size_t nUnknowns,
                                    const fmi3ValueReference knowns[], size_t nKnowns, const fmi3Float64 seed[],
                                    size_t nSeed, fmi3Float64 sensitivity[], size_t nSensitivity) {
    Instance *c = instance;
    double *own; /* seeds of states that are outputs */
    size_t i;
    int n;
    if (check_derivative(c, "GetAdjointDerivative", unknowns, nUnknowns, knowns, nKnowns) != OK) return fmi3Error;
    if (nSeed != nUnknowns || nSensitivity != nKnowns)
        return STATUS(say(c, ERROR, "GetAdjointDerivative: seeds or sensitivities are too few or many"));
    own = c->trial;
    memset(c->trial, 0, sizeof c->trial);
    clear_seeds(c);
    for (i = 0; i < nUnknowns; i++) {
        const fmi3ValueReference r = unknowns[i];
        if (r < FIRST_DERIVATIVE) own[r - FIRST_STATE] += seed[i];
        else *place(c, UNKNOWN, r) += seed[i];
    }
    point(c, &c->now.time, c->now.x);
    c->arg[3] = c->dxdot;
    c->arg[4] = c->dy;
    c->res[0] = &c->dt;
    c->res[1] = c->dx;
    c->res[2] = c->dp;
    if (run(c, MODEL_ADJOINT)) return STATUS(say(c, DISCARD, "GetAdjointDerivative: cannot be evaluated"));
    for (n = 0; n < NX; n++) c->dx[n] += own[n];
    for (i = 0; i < nKnowns; i++) sensitivity[i] = *place(c, KNOWN, knowns[i]);
    if (!all_finite(sensitivity, (int)nKnowns))
        return STATUS(say(c, DISCARD, "GetAdjointDerivative: the result is not finite"));
    return fmi3OK;
}

/* Model Exchange ----------------------------------------------------------------------------------------------------- */

fmi3Status fmi3EvaluateDiscreteStates(fmi3Instance instance) {
    return STATUS(allowed(instance, "EvaluateDiscreteStates", 0));
}

fmi3Status fmi3UpdateDiscreteStates(fmi3Instance instance, fmi3Boolean *discreteStatesNeedUpdate,
                                    fmi3Boolean *terminateSimulation, fmi3Boolean *nominalsOfContinuousStatesChanged,
                                    fmi3Boolean *valuesOfContinuousStatesChanged, fmi3Boolean *nextEventTimeDefined,
                                    fmi3Float64 *nextEventTime) {
    if (allowed(instance, "UpdateDiscreteStates", EVENT) != OK) return fmi3Error;
    *discreteStatesNeedUpdate = *terminateSimulation = *nominalsOfContinuousStatesChanged = fmi3False;
    *valuesOfContinuousStatesChanged = *nextEventTimeDefined = fmi3False;
    *nextEventTime = 0.0;
    return fmi3OK;
}

fmi3Status fmi3CompletedIntegratorStep(fmi3Instance instance, fmi3Boolean noSetFMUStatePriorToCurrentPoint,
                                       fmi3Boolean *enterEventMode, fmi3Boolean *terminateSimulation) {
    UNUSED(noSetFMUStatePriorToCurrentPoint);
    if (in_model_exchange(instance, "CompletedIntegratorStep", CONTINUOUS) != OK) return fmi3Error;
    *enterEventMode = *terminateSimulation = fmi3False;
    return fmi3OK;
}

fmi3Status fmi3SetTime(fmi3Instance instance, fmi3Float64 time) { return STATUS(set_time(instance, "SetTime", time)); }

fmi3Status fmi3SetContinuousStates(fmi3Instance instance, const fmi3Float64 continuousStates[],
                                   size_t nContinuousStates) {
    return STATUS(set_states(instance, "SetContinuousStates", continuousStates, nContinuousStates));
}

fmi3Status fmi3GetContinuousStates(fmi3Instance instance, fmi3Float64 continuousStates[], size_t nContinuousStates) {
    const int modes = INITIALIZATION | EVENT | CONTINUOUS | TERMINATED;
    return STATUS(get_vector(instance, "GetContinuousStates", modes, 'x', continuousStates, nContinuousStates));
}

fmi3Status fmi3GetContinuousStateDerivatives(fmi3Instance instance, fmi3Float64 derivatives[],
                                             size_t nContinuousStates) {
    const int modes = INITIALIZATION | EVENT | CONTINUOUS | TERMINATED;
    return STATUS(get_vector(instance, "GetContinuousStateDerivatives", modes, 'd', derivatives, nContinuousStates));
}

fmi3Status fmi3GetNominalsOfContinuousStates(fmi3Instance instance, fmi3Float64 nominals[],
                                             size_t nContinuousStates) {
    const int modes = INITIALIZATION | EVENT | CONTINUOUS | TERMINATED;
    return STATUS(get_vector(instance, "GetNominalsOfContinuousStates", modes, 'n', nominals, nContinuousStates));
}

fmi3Status fmi3GetEventIndicators(fmi3Instance instance, fmi3Float64 eventIndicators[], size_t nEventIndicators) {
    UNUSED(eventIndicators);
    return none(instance, "GetEventIndicators", nEventIndicators);
}

fmi3Status fmi3GetNumberOfEventIndicators(fmi3Instance instance, size_t *nEventIndicators) {
    if (in_model_exchange(instance, "GetNumberOfEventIndicators", ~FAILED) != OK) return fmi3Error;
    *nEventIndicators = 0;
    return fmi3OK;
}

fmi3Status fmi3GetNumberOfContinuousStates(fmi3Instance instance, size_t *nContinuousStates) {
    if (in_model_exchange(instance, "GetNumberOfContinuousStates", ~FAILED) != OK) return fmi3Error;
    *nContinuousStates = NX;
    return fmi3OK;
}

/* Co-Simulation ------------------------------------------------------------------------------------------------------ */

fmi3Status fmi3GetOutputDerivatives(fmi3Instance instance, const fmi3ValueReference valueReferences[],
                                    size_t nValueReferences, const fmi3Int32 orders[], fmi3Float64 values[],
                                    size_t nValues) {
    UNUSED(valueReferences), UNUSED(orders), UNUSED(values), UNUSED(nValues);
    return none(instance, "GetOutputDerivatives", nValueReferences);
}

fmi3Status fmi3DoStep(fmi3Instance instance, fmi3Float64 currentCommunicationPoint, fmi3Float64 communicationStepSize,
                      fmi3Boolean noSetFMUStatePriorToCurrentPoint, fmi3Boolean *eventHandlingNeeded,
                      fmi3Boolean *terminateSimulation, fmi3Boolean *earlyReturn, fmi3Float64 *lastSuccessfulTime) {
    int status;
    UNUSED(noSetFMUStatePriorToCurrentPoint);
    *eventHandlingNeeded = *terminateSimulation = *earlyReturn = fmi3False;
    status = communication_step(instance, "DoStep", currentCommunicationPoint, communicationStepSize);
    if (instance) *lastSuccessfulTime = ((Instance *)instance)->now.time;
    return STATUS(status);
}

fmi3Status fmi3ActivateModelPartition(fmi3Instance instance, fmi3ValueReference clockReference,
                                      fmi3Float64 activationTime) {
    UNUSED(clockReference), UNUSED(activationTime);
    return STATUS(allowed(instance, "ActivateModelPartition", 0));
}
