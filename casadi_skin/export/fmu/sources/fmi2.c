/* The interface of FMI 2.0: Model Exchange and Co-Simulation. It only translates; see instance.h and dop853.h. */
#include "fmi2Functions.h"

#include "dop853.h"
#include "instance.h"

#define UNUSED(argument) ((void)(argument))
#define STATUS(status) ((fmi2Status)(status))

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
    UNUSED(fmuResourceLocation), UNUSED(visible);
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

fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean loggingOn, size_t nCategories,
                               const fmi2String categories[]) {
    if (allowed(c, "SetDebugLogging", ~0) != OK) return fmi2Error;
    return STATUS(set_logging(c, loggingOn, nCategories, categories));
}

fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean toleranceDefined, fmi2Real tolerance, fmi2Real startTime,
                               fmi2Boolean stopTimeDefined, fmi2Real stopTime) {
    UNUSED(stopTimeDefined), UNUSED(stopTime);
    return STATUS(begin_initialization(c, "SetupExperiment", toleranceDefined, tolerance, startTime));
}

fmi2Status fmi2EnterInitializationMode(fmi2Component c) {
    return STATUS(move(c, "EnterInitializationMode", INSTANTIATED, INITIALIZATION));
}

fmi2Status fmi2ExitInitializationMode(fmi2Component c) {
    const int to = c && ((Instance *)c)->kind == MODEL_EXCHANGE ? EVENT : STEP;
    return STATUS(move(c, "ExitInitializationMode", INITIALIZATION, to));
}

fmi2Status fmi2Terminate(fmi2Component c) {
    return STATUS(move(c, "Terminate", EVENT | CONTINUOUS | STEP, TERMINATED));
}

fmi2Status fmi2Reset(fmi2Component c) {
    if (!c) return fmi2Error;
    start_values(c);
    return fmi2OK;
}

/* Values ------------------------------------------------------------------------------------------------------------- */

fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, fmi2Real value[]) {
    return STATUS(get_values(c, "GetReal", vr, nvr, value));
}

fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, const fmi2Real value[]) {
    return STATUS(set_values(c, "SetReal", vr, nvr, value));
}

/* There are variables of no other type. */
static fmi2Status none(Instance *c, const char *function, size_t count) {
    if (allowed(c, function, ~0) != OK) return fmi2Error;
    return count ? STATUS(say(c, ERROR, "%s: no variable has this type", function)) : fmi2OK;
}

#define OTHER_TYPE(type)                                                                                              \
    fmi2Status fmi2Get##type(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, fmi2##type value[]) {        \
        UNUSED(vr), UNUSED(value);                                                                                    \
        return none(c, "Get" #type, nvr);                                                                             \
    }                                                                                                                 \
    fmi2Status fmi2Set##type(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, const fmi2##type value[]) {  \
        UNUSED(vr), UNUSED(value);                                                                                    \
        return none(c, "Set" #type, nvr);                                                                             \
    }
OTHER_TYPE(Integer)
OTHER_TYPE(Boolean)
OTHER_TYPE(String)

/* The FMU state and partial derivatives ------------------------------------------------------------------------------ */

fmi2Status fmi2GetFMUstate(fmi2Component c, fmi2FMUstate *FMUstate) {
    return STATUS(get_state(c, "GetFMUstate", FMUstate));
}

fmi2Status fmi2SetFMUstate(fmi2Component c, fmi2FMUstate FMUstate) {
    return STATUS(set_state(c, "SetFMUstate", FMUstate));
}

fmi2Status fmi2FreeFMUstate(fmi2Component c, fmi2FMUstate *FMUstate) {
    return STATUS(free_state(c, "FreeFMUstate", FMUstate));
}

fmi2Status fmi2SerializedFMUstateSize(fmi2Component c, fmi2FMUstate FMUstate, size_t *size) {
    UNUSED(FMUstate);
    if (allowed(c, "SerializedFMUstateSize", ~0) != OK) return fmi2Error;
    *size = SERIALISED;
    return fmi2OK;
}

fmi2Status fmi2SerializeFMUstate(fmi2Component c, fmi2FMUstate FMUstate, fmi2Byte serializedState[], size_t size) {
    return STATUS(serialise(c, "SerializeFMUstate", FMUstate, serializedState, size));
}

fmi2Status fmi2DeSerializeFMUstate(fmi2Component c, const fmi2Byte serializedState[], size_t size,
                                   fmi2FMUstate *FMUstate) {
    return STATUS(deserialise(c, "DeSerializeFMUstate", serializedState, size, FMUstate));
}

fmi2Status fmi2GetDirectionalDerivative(fmi2Component c, const fmi2ValueReference vUnknown_ref[], size_t nUnknown,
                                        const fmi2ValueReference vKnown_ref[], size_t nKnown, const fmi2Real dvKnown[],
                                        fmi2Real dvUnknown[]) {
    return STATUS(directional(c, "GetDirectionalDerivative", vUnknown_ref, nUnknown, vKnown_ref, nKnown, dvKnown,
                              dvUnknown));
}

/* Model Exchange ----------------------------------------------------------------------------------------------------- */

fmi2Status fmi2EnterEventMode(fmi2Component c) {
    if (in_model_exchange(c, "EnterEventMode", CONTINUOUS | EVENT) != OK) return fmi2Error;
    return STATUS(move(c, "EnterEventMode", CONTINUOUS | EVENT, EVENT));
}

fmi2Status fmi2NewDiscreteStates(fmi2Component c, fmi2EventInfo *fmi2eventInfo) {
    if (in_model_exchange(c, "NewDiscreteStates", EVENT) != OK) return fmi2Error;
    memset(fmi2eventInfo, 0, sizeof *fmi2eventInfo); /* no events, and nothing that they would change */
    return fmi2OK;
}

fmi2Status fmi2EnterContinuousTimeMode(fmi2Component c) {
    if (in_model_exchange(c, "EnterContinuousTimeMode", EVENT) != OK) return fmi2Error;
    return STATUS(move(c, "EnterContinuousTimeMode", EVENT, CONTINUOUS));
}

fmi2Status fmi2CompletedIntegratorStep(fmi2Component c, fmi2Boolean noSetFMUStatePriorToCurrentPoint,
                                       fmi2Boolean *enterEventMode, fmi2Boolean *terminateSimulation) {
    UNUSED(noSetFMUStatePriorToCurrentPoint);
    if (in_model_exchange(c, "CompletedIntegratorStep", CONTINUOUS) != OK) return fmi2Error;
    *enterEventMode = *terminateSimulation = fmi2False;
    return fmi2OK;
}

fmi2Status fmi2SetTime(fmi2Component c, fmi2Real time) { return STATUS(set_time(c, "SetTime", time)); }

fmi2Status fmi2SetContinuousStates(fmi2Component c, const fmi2Real x[], size_t nx) {
    return STATUS(set_states(c, "SetContinuousStates", x, nx));
}

fmi2Status fmi2GetContinuousStates(fmi2Component c, fmi2Real x[], size_t nx) {
    const int modes = INITIALIZATION | EVENT | CONTINUOUS | TERMINATED;
    return STATUS(get_vector(c, "GetContinuousStates", modes, 'x', x, nx));
}

fmi2Status fmi2GetDerivatives(fmi2Component c, fmi2Real derivatives[], size_t nx) {
    const int modes = INITIALIZATION | EVENT | CONTINUOUS | TERMINATED;
    return STATUS(get_vector(c, "GetDerivatives", modes, 'd', derivatives, nx));
}

fmi2Status fmi2GetNominalsOfContinuousStates(fmi2Component c, fmi2Real x_nominal[], size_t nx) {
    const int modes = INSTANTIATED | INITIALIZATION | EVENT | CONTINUOUS | TERMINATED;
    return STATUS(get_vector(c, "GetNominalsOfContinuousStates", modes, 'n', x_nominal, nx));
}

fmi2Status fmi2GetEventIndicators(fmi2Component c, fmi2Real eventIndicators[], size_t ni) {
    UNUSED(eventIndicators);
    return none(c, "GetEventIndicators", ni);
}

/* Co-Simulation ------------------------------------------------------------------------------------------------------ */

fmi2Status fmi2SetRealInputDerivatives(fmi2Component c, const fmi2ValueReference vr[], size_t nvr,
                                       const fmi2Integer order[], const fmi2Real value[]) {
    UNUSED(vr), UNUSED(order), UNUSED(value);
    return none(c, "SetRealInputDerivatives", nvr);
}

fmi2Status fmi2GetRealOutputDerivatives(fmi2Component c, const fmi2ValueReference vr[], size_t nvr,
                                        const fmi2Integer order[], fmi2Real value[]) {
    UNUSED(vr), UNUSED(order), UNUSED(value);
    return none(c, "GetRealOutputDerivatives", nvr);
}

fmi2Status fmi2DoStep(fmi2Component c, fmi2Real currentCommunicationPoint, fmi2Real communicationStepSize,
                      fmi2Boolean noSetFMUStatePriorToCurrentPoint) {
    UNUSED(noSetFMUStatePriorToCurrentPoint);
    return STATUS(communication_step(c, "DoStep", currentCommunicationPoint, communicationStepSize));
}

/* A step is done when fmi2DoStep returns, so that there is none to cancel. */
fmi2Status fmi2CancelStep(fmi2Component c) { return STATUS(allowed(c, "CancelStep", 0)); }

/* Where a step was discarded the instance is at the time before it. */
fmi2Status fmi2GetRealStatus(fmi2Component c, const fmi2StatusKind s, fmi2Real *value) {
    if (allowed(c, "GetRealStatus", ~0) != OK || s != fmi2LastSuccessfulTime) return fmi2Discard;
    *value = ((Instance *)c)->now.time;
    return fmi2OK;
}

fmi2Status fmi2GetBooleanStatus(fmi2Component c, const fmi2StatusKind s, fmi2Boolean *value) {
    if (allowed(c, "GetBooleanStatus", ~0) != OK || s != fmi2Terminated) return fmi2Discard;
    *value = fmi2False;
    return fmi2OK;
}

fmi2Status fmi2GetStatus(fmi2Component c, const fmi2StatusKind s, fmi2Status *value) {
    UNUSED(c), UNUSED(s), UNUSED(value);
    return fmi2Discard;
}

fmi2Status fmi2GetIntegerStatus(fmi2Component c, const fmi2StatusKind s, fmi2Integer *value) {
    UNUSED(c), UNUSED(s), UNUSED(value);
    return fmi2Discard;
}

fmi2Status fmi2GetStringStatus(fmi2Component c, const fmi2StatusKind s, fmi2String *value) {
    UNUSED(c), UNUSED(s), UNUSED(value);
    return fmi2Discard;
}
