/* The interface of FMI 3.0: Model Exchange and Co-Simulation. It only translates; see instance.h and dop853.h. */
#include "fmi3Functions.h"

#include "dop853.h"
#include "instance.h"

#if defined(__GNUC__) /* functions of the standard have arguments that this model does not use */
#pragma GCC diagnostic ignored "-Wunused-parameter"
#endif

#define STATUS(status) ((fmi3Status)(status))

/* A function of the interface with its parameters, and the expression that gives its status; NAME is its name. */
#define FUNCTION(name, parameters, status)   \
    fmi3Status fmi3##name parameters {       \
        static const char NAME[] = #name;    \
        return STATUS(status);               \
    }

/* An instance, and some of its variables. */
#define THESE fmi3Instance c, const fmi3ValueReference references[], size_t count

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
    if (logMessage)
        logMessage(instanceEnvironment, fmi3Error, "logStatusError", "Instantiate: no Scheduled Execution here");
    return NULL;
}

void fmi3FreeInstance(fmi3Instance instance) { free(instance); }

FUNCTION(SetDebugLogging, (fmi3Instance c, fmi3Boolean on, size_t count, const fmi3String categories[]),
         allowed(c, NAME, ~0) ? ERROR : set_logging(c, on, count, categories))

fmi3Status fmi3EnterInitializationMode(fmi3Instance instance, fmi3Boolean toleranceDefined, fmi3Float64 tolerance,
                                       fmi3Float64 startTime, fmi3Boolean stopTimeDefined, fmi3Float64 stopTime) {
    Instance *c = instance;
    if (begin_initialization(c, "EnterInitializationMode", toleranceDefined, tolerance, startTime) != OK)
        return fmi3Error;
    c->now.mode = INITIALIZATION;
    return fmi3OK;
}

FUNCTION(ExitInitializationMode, (fmi3Instance c),
         move(c, NAME, INITIALIZATION, c && ((Instance *)c)->kind == MODEL_EXCHANGE ? EVENT : STEP))
FUNCTION(EnterEventMode, (fmi3Instance c),
         in_model_exchange(c, NAME, CONTINUOUS) ? ERROR : move(c, NAME, CONTINUOUS, EVENT))
FUNCTION(EnterContinuousTimeMode, (fmi3Instance c),
         in_model_exchange(c, NAME, EVENT) ? ERROR : move(c, NAME, EVENT, CONTINUOUS))
FUNCTION(EnterStepMode, (fmi3Instance c), allowed(c, NAME, 0))
FUNCTION(EnterConfigurationMode, (fmi3Instance c), allowed(c, NAME, 0))
FUNCTION(ExitConfigurationMode, (fmi3Instance c), allowed(c, NAME, 0))
FUNCTION(Terminate, (fmi3Instance c), move(c, NAME, EVENT | CONTINUOUS | STEP, TERMINATED))

fmi3Status fmi3Reset(fmi3Instance instance) {
    if (!instance) return fmi3Error;
    start_values(instance);
    return fmi3OK;
}

/* Values ------------------------------------------------------------------------------------------------------------- */

static int wrong(Instance *c, const char *function, int are_wrong) {
    return c && are_wrong ? say(c, ERROR, "%s: numbers of variables and of values do not fit", function) : OK;
}

FUNCTION(GetFloat64, (THESE, fmi3Float64 values[], size_t nValues),
         wrong(c, NAME, nValues != count) ? ERROR : get_values(c, NAME, references, count, values))
FUNCTION(SetFloat64, (THESE, const fmi3Float64 values[], size_t nValues),
         wrong(c, NAME, nValues != count) ? ERROR : set_values(c, NAME, references, count, values))

#define NO_VARIABLES(name, parameters) FUNCTION(name, parameters, none(c, NAME, count))
#define OTHER_TYPE(type)                                                    \
    NO_VARIABLES(Get##type, (THESE, fmi3##type values[], size_t nValues))   \
    NO_VARIABLES(Set##type, (THESE, const fmi3##type values[], size_t nValues))
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
NO_VARIABLES(GetBinary, (THESE, size_t sizes[], fmi3Binary values[], size_t nValues))
NO_VARIABLES(SetBinary, (THESE, const size_t sizes[], const fmi3Binary values[], size_t nValues))
NO_VARIABLES(GetClock, (THESE, fmi3Clock values[]))
NO_VARIABLES(SetClock, (THESE, const fmi3Clock values[]))
NO_VARIABLES(GetIntervalDecimal, (THESE, fmi3Float64 intervals[], fmi3IntervalQualifier qualifiers[]))
NO_VARIABLES(GetIntervalFraction,
             (THESE, fmi3UInt64 counters[], fmi3UInt64 resolutions[], fmi3IntervalQualifier qualifiers[]))
NO_VARIABLES(GetShiftDecimal, (THESE, fmi3Float64 shifts[]))
NO_VARIABLES(GetShiftFraction, (THESE, fmi3UInt64 counters[], fmi3UInt64 resolutions[]))
NO_VARIABLES(SetIntervalDecimal, (THESE, const fmi3Float64 intervals[]))
NO_VARIABLES(SetIntervalFraction, (THESE, const fmi3UInt64 counters[], const fmi3UInt64 resolutions[]))
NO_VARIABLES(SetShiftDecimal, (THESE, const fmi3Float64 shifts[]))
NO_VARIABLES(SetShiftFraction, (THESE, const fmi3UInt64 counters[], const fmi3UInt64 resolutions[]))

/* Dependencies of elements are not provided: all variables are scalars, see modelDescription.xml. */
FUNCTION(GetNumberOfVariableDependencies, (fmi3Instance c, fmi3ValueReference reference, size_t *count),
         none(c, NAME, 1))
FUNCTION(GetVariableDependencies,
         (fmi3Instance c, fmi3ValueReference dependent, size_t dependentElements[], fmi3ValueReference independents[],
          size_t independentElements[], fmi3DependencyKind kinds[], size_t count),
         none(c, NAME, 1))

/* The FMU state ------------------------------------------------------------------------------------------------------ */

FUNCTION(GetFMUState, (fmi3Instance c, fmi3FMUState *state), get_state(c, NAME, state))
FUNCTION(SetFMUState, (fmi3Instance c, fmi3FMUState state), set_state(c, NAME, state))
FUNCTION(FreeFMUState, (fmi3Instance c, fmi3FMUState *state), free_state(c, NAME, state))
FUNCTION(SerializedFMUStateSize, (fmi3Instance c, fmi3FMUState state, size_t *size),
         allowed(c, NAME, ~0) ? ERROR : (*size = SERIALISED, OK))
FUNCTION(SerializeFMUState, (fmi3Instance c, fmi3FMUState state, fmi3Byte bytes[], size_t size),
         serialise(c, NAME, state, (char *)bytes, size))
FUNCTION(DeserializeFMUState, (fmi3Instance c, const fmi3Byte bytes[], size_t size, fmi3FMUState *state),
         deserialise(c, NAME, (const char *)bytes, size, state))

/* Partial derivatives ------------------------------------------------------------------------------------------------ */

FUNCTION(GetDirectionalDerivative,
         (fmi3Instance c, const fmi3ValueReference unknowns[], size_t nUnknowns, const fmi3ValueReference knowns[],
          size_t nKnowns, const fmi3Float64 seed[], size_t nSeed, fmi3Float64 sensitivity[], size_t nSensitivity),
         wrong(c, NAME, nSeed != nKnowns || nSensitivity != nUnknowns)
             ? ERROR
             : directional(c, NAME, unknowns, nUnknowns, knowns, nKnowns, seed, sensitivity))

fmi3Status fmi3GetAdjointDerivative(fmi3Instance instance, const fmi3ValueReference unknowns[], size_t nUnknowns,
                                    const fmi3ValueReference knowns[], size_t nKnowns, const fmi3Float64 seed[],
                                    size_t nSeed, fmi3Float64 sensitivity[], size_t nSensitivity) {
    Instance *c = instance;
    double *own; /* seeds of states that are outputs */
    size_t i;
    int n;
    if (check_derivative(c, "GetAdjointDerivative", unknowns, nUnknowns, knowns, nKnowns) != OK) return fmi3Error;
    if (wrong(c, "GetAdjointDerivative", nSeed != nUnknowns || nSensitivity != nKnowns)) return fmi3Error;
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

FUNCTION(EvaluateDiscreteStates, (fmi3Instance c), allowed(c, NAME, 0))

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
    if (in_model_exchange(instance, "CompletedIntegratorStep", CONTINUOUS) != OK) return fmi3Error;
    *enterEventMode = *terminateSimulation = fmi3False;
    return fmi3OK;
}

FUNCTION(SetTime, (fmi3Instance c, fmi3Float64 time), set_time(c, NAME, time))
FUNCTION(SetContinuousStates, (fmi3Instance c, const fmi3Float64 x[], size_t count), set_states(c, NAME, x, count))
FUNCTION(GetContinuousStates, (fmi3Instance c, fmi3Float64 x[], size_t count),
         get_vector(c, NAME, INITIALIZATION | EVENT | CONTINUOUS | TERMINATED, 'x', x, count))
FUNCTION(GetContinuousStateDerivatives, (fmi3Instance c, fmi3Float64 derivatives[], size_t count),
         get_vector(c, NAME, INITIALIZATION | EVENT | CONTINUOUS | TERMINATED, 'd', derivatives, count))
FUNCTION(GetNominalsOfContinuousStates, (fmi3Instance c, fmi3Float64 nominals[], size_t count),
         get_vector(c, NAME, INITIALIZATION | EVENT | CONTINUOUS | TERMINATED, 'n', nominals, count))
NO_VARIABLES(GetEventIndicators, (fmi3Instance c, fmi3Float64 indicators[], size_t count))
FUNCTION(GetNumberOfEventIndicators, (fmi3Instance c, size_t *count),
         in_model_exchange(c, NAME, ~FAILED) ? ERROR : (*count = 0, OK))
FUNCTION(GetNumberOfContinuousStates, (fmi3Instance c, size_t *count),
         in_model_exchange(c, NAME, ~FAILED) ? ERROR : (*count = NX, OK))

/* Co-Simulation ------------------------------------------------------------------------------------------------------ */

NO_VARIABLES(GetOutputDerivatives, (THESE, const fmi3Int32 orders[], fmi3Float64 values[], size_t nValues))

fmi3Status fmi3DoStep(fmi3Instance instance, fmi3Float64 currentCommunicationPoint, fmi3Float64 communicationStepSize,
                      fmi3Boolean noSetFMUStatePriorToCurrentPoint, fmi3Boolean *eventHandlingNeeded,
                      fmi3Boolean *terminateSimulation, fmi3Boolean *earlyReturn, fmi3Float64 *lastSuccessfulTime) {
    int status;
    *eventHandlingNeeded = *terminateSimulation = *earlyReturn = fmi3False;
    status = communication_step(instance, "DoStep", currentCommunicationPoint, communicationStepSize);
    if (instance) *lastSuccessfulTime = ((Instance *)instance)->now.time;
    return STATUS(status);
}

FUNCTION(ActivateModelPartition, (fmi3Instance c, fmi3ValueReference clock, fmi3Float64 time), allowed(c, NAME, 0))
