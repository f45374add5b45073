/* The interface of FMI 2.0: Model Exchange and Co-Simulation. It only translates; see instance.h and dop853.h. */
#include "fmi2Functions.h"

#include "dop853.h"
#include "instance.h"

#if defined(__GNUC__) /* functions of the standard have arguments that this model does not use */
#pragma GCC diagnostic ignored "-Wunused-parameter"
#endif

#define STATUS(status) ((fmi2Status)(status))

/* A function of the interface with its parameters, and the expression that gives its status; NAME is its name. */
#define FUNCTION(name, parameters, status)   \
    fmi2Status fmi2##name parameters {       \
        static const char NAME[] = #name;    \
        return STATUS(status);               \
    }

/* An instance, and some of its variables. */
#define THESE fmi2Component c, const fmi2ValueReference references[], size_t count

static void report(Instance *c, int status, const char *category, const char *message) {
    const fmi2CallbackFunctions *callbacks = c->callbacks;
    callbacks->logger(c->environment, c->name, STATUS(status), category, message);
}

/* Creation and modes ------------------------------------------------------------------------------------------------ */

const char *fmi2GetTypesPlatform(void) { return fmi2TypesPlatform; }

const char *fmi2GetVersion(void) { return fmi2Version; }

fmi2Component fmi2Instantiate(fmi2String instanceName, fmi2Type fmuType, fmi2String fmuGUID,
                              fmi2String fmuResourceLocation, const fmi2CallbackFunctions *functions,
                              fmi2Boolean visible, fmi2Boolean loggingOn) {
    Instance *c;
    if (!functions) return NULL;
    if (!fmuGUID || strcmp(fmuGUID, INSTANTIATION_TOKEN)) {
        if (functions->logger)
            functions->logger(functions->componentEnvironment, instanceName, fmi2Error, "logStatusError",
                              "Instantiate: wrong GUID");
        return NULL;
    }
    c = new_instance(instanceName, fmuType == fmi2CoSimulation ? CO_SIMULATION : MODEL_EXCHANGE, loggingOn);
    if (!c) return NULL;
    c->environment = functions->componentEnvironment;
    c->callbacks = functions;
    if (functions->logger) c->report = report;
    return c;
}

void fmi2FreeInstance(fmi2Component c) { free(c); }

FUNCTION(SetDebugLogging, (fmi2Component c, fmi2Boolean on, size_t count, const fmi2String categories[]),
         allowed(c, NAME, ~0) ? ERROR : set_logging(c, on, count, categories))
FUNCTION(SetupExperiment,
         (fmi2Component c, fmi2Boolean toleranceDefined, fmi2Real tolerance, fmi2Real startTime,
          fmi2Boolean stopTimeDefined, fmi2Real stopTime),
         begin_initialization(c, NAME, toleranceDefined, tolerance, startTime))
FUNCTION(EnterInitializationMode, (fmi2Component c), move(c, NAME, INSTANTIATED, INITIALIZATION))
FUNCTION(ExitInitializationMode, (fmi2Component c),
         move(c, NAME, INITIALIZATION, c && ((Instance *)c)->kind == MODEL_EXCHANGE ? EVENT : STEP))
FUNCTION(Terminate, (fmi2Component c), move(c, NAME, EVENT | CONTINUOUS | STEP, TERMINATED))

fmi2Status fmi2Reset(fmi2Component c) {
    if (!c) return fmi2Error;
    start_values(c);
    return fmi2OK;
}

/* Values ------------------------------------------------------------------------------------------------------------- */

FUNCTION(GetReal, (THESE, fmi2Real values[]), get_values(c, NAME, references, count, values))
FUNCTION(SetReal, (THESE, const fmi2Real values[]), set_values(c, NAME, references, count, values))

#define NO_VARIABLES(name, parameters) FUNCTION(name, parameters, none(c, NAME, count))
#define OTHER_TYPE(type)                                    \
    NO_VARIABLES(Get##type, (THESE, fmi2##type values[]))   \
    NO_VARIABLES(Set##type, (THESE, const fmi2##type values[]))
OTHER_TYPE(Integer)
OTHER_TYPE(Boolean)
OTHER_TYPE(String)

/* The FMU state and partial derivatives ------------------------------------------------------------------------------ */

FUNCTION(GetFMUstate, (fmi2Component c, fmi2FMUstate *state), get_state(c, NAME, state))
FUNCTION(SetFMUstate, (fmi2Component c, fmi2FMUstate state), set_state(c, NAME, state))
FUNCTION(FreeFMUstate, (fmi2Component c, fmi2FMUstate *state), free_state(c, NAME, state))
FUNCTION(SerializedFMUstateSize, (fmi2Component c, fmi2FMUstate state, size_t *size),
         allowed(c, NAME, ~0) ? ERROR : (*size = SERIALISED, OK))
FUNCTION(SerializeFMUstate, (fmi2Component c, fmi2FMUstate state, fmi2Byte bytes[], size_t size),
         serialise(c, NAME, state, bytes, size))
FUNCTION(DeSerializeFMUstate, (fmi2Component c, const fmi2Byte bytes[], size_t size, fmi2FMUstate *state),
         deserialise(c, NAME, bytes, size, state))
FUNCTION(GetDirectionalDerivative,
         (fmi2Component c, const fmi2ValueReference unknowns[], size_t nUnknowns, const fmi2ValueReference knowns[],
          size_t nKnowns, const fmi2Real seed[], fmi2Real sensitivity[]),
         directional(c, NAME, unknowns, nUnknowns, knowns, nKnowns, seed, sensitivity))

/* Model Exchange ----------------------------------------------------------------------------------------------------- */

FUNCTION(EnterEventMode, (fmi2Component c),
         in_model_exchange(c, NAME, CONTINUOUS | EVENT) ? ERROR : move(c, NAME, CONTINUOUS | EVENT, EVENT))

fmi2Status fmi2NewDiscreteStates(fmi2Component c, fmi2EventInfo *fmi2eventInfo) {
    if (in_model_exchange(c, "NewDiscreteStates", EVENT) != OK) return fmi2Error;
    memset(fmi2eventInfo, 0, sizeof *fmi2eventInfo); /* no events, and nothing that they would change */
    return fmi2OK;
}

FUNCTION(EnterContinuousTimeMode, (fmi2Component c),
         in_model_exchange(c, NAME, EVENT) ? ERROR : move(c, NAME, EVENT, CONTINUOUS))

fmi2Status fmi2CompletedIntegratorStep(fmi2Component c, fmi2Boolean noSetFMUStatePriorToCurrentPoint,
                                       fmi2Boolean *enterEventMode, fmi2Boolean *terminateSimulation) {
    if (in_model_exchange(c, "CompletedIntegratorStep", CONTINUOUS) != OK) return fmi2Error;
    *enterEventMode = *terminateSimulation = fmi2False;
    return fmi2OK;
}

FUNCTION(SetTime, (fmi2Component c, fmi2Real time), set_time(c, NAME, time))
FUNCTION(SetContinuousStates, (fmi2Component c, const fmi2Real x[], size_t nx), set_states(c, NAME, x, nx))
FUNCTION(GetContinuousStates, (fmi2Component c, fmi2Real x[], size_t nx),
         get_vector(c, NAME, INITIALIZATION | EVENT | CONTINUOUS | TERMINATED, 'x', x, nx))
FUNCTION(GetDerivatives, (fmi2Component c, fmi2Real derivatives[], size_t nx),
         get_vector(c, NAME, INITIALIZATION | EVENT | CONTINUOUS | TERMINATED, 'd', derivatives, nx))
FUNCTION(GetNominalsOfContinuousStates, (fmi2Component c, fmi2Real nominals[], size_t nx),
         get_vector(c, NAME, INSTANTIATED | INITIALIZATION | EVENT | CONTINUOUS | TERMINATED, 'n', nominals, nx))
NO_VARIABLES(GetEventIndicators, (fmi2Component c, fmi2Real indicators[], size_t count))

/* Co-Simulation ------------------------------------------------------------------------------------------------------ */

NO_VARIABLES(SetRealInputDerivatives, (THESE, const fmi2Integer orders[], const fmi2Real values[]))
NO_VARIABLES(GetRealOutputDerivatives, (THESE, const fmi2Integer orders[], fmi2Real values[]))
FUNCTION(DoStep, (fmi2Component c, fmi2Real from, fmi2Real span, fmi2Boolean noSetFMUStatePriorToCurrentPoint),
         communication_step(c, NAME, from, span))

/* A step is done when fmi2DoStep returns, so that there is none to cancel. */
FUNCTION(CancelStep, (fmi2Component c), allowed(c, NAME, 0))

/* Where a step was discarded the instance is at the time before it. */
FUNCTION(GetRealStatus, (fmi2Component c, const fmi2StatusKind kind, fmi2Real *value),
         allowed(c, NAME, ~0) || kind != fmi2LastSuccessfulTime ? DISCARD : (*value = ((Instance *)c)->now.time, OK))
FUNCTION(GetBooleanStatus, (fmi2Component c, const fmi2StatusKind kind, fmi2Boolean *value),
         allowed(c, NAME, ~0) || kind != fmi2Terminated ? DISCARD : (*value = fmi2False, OK))

fmi2Status fmi2GetStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Status *value) { return fmi2Discard; }

fmi2Status fmi2GetIntegerStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Integer *value) { return fmi2Discard; }

fmi2Status fmi2GetStringStatus(fmi2Component c, const fmi2StatusKind kind, fmi2String *value) { return fmi2Discard; }
