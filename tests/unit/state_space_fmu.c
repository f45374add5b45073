/* A linear system x' = A x + B u, y = x with arrays: Model Exchange of FMI 3.0 with what an importer calls. */
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

enum { N = 2, M = 2, A = 1, B = 2, U = 3, X = 4, RATES = 5, OK = 0, ERROR = 3 };
typedef struct {
    double a[N * N], b[N * M], u[M], x[N];
} Instance;
#define EXPORT __attribute__((visibility("default")))
#define UNUSED(name) EXPORT int fmi3##name(void) { return ERROR; }

static double *entries(Instance *c, uint32_t reference, size_t *count)
{
    double *const places[] = {c->a, c->b, c->u, c->x};
    const size_t counts[] = {N * N, N * M, M, N};
    if (reference < A || reference > X) return NULL;
    *count = counts[reference - A];
    return places[reference - A];
}

EXPORT int fmi3Reset(Instance *c)
{
    static const Instance start = {{0, 1, -1, 0}, {1, 0, 0, 1}, {0, 0}, {1, 0}};
    *c = start;
    return OK;
}

EXPORT void *fmi3InstantiateModelExchange(const char *name, const char *token)
{
    Instance *c = malloc(sizeof *c);
    (void)name;
    if (strcmp(token, "arrays")) return NULL;
    fmi3Reset(c);
    return c;
}

EXPORT void fmi3FreeInstance(Instance *c) { free(c); }

EXPORT int fmi3EnterInitializationMode(Instance *c) { return c ? OK : ERROR; }
EXPORT int fmi3ExitInitializationMode(Instance *c) { return c ? OK : ERROR; }
EXPORT int fmi3EnterEventMode(Instance *c) { return c ? OK : ERROR; }
EXPORT int fmi3EnterContinuousTimeMode(Instance *c) { return c ? OK : ERROR; }
EXPORT int fmi3SetTime(Instance *c, double t) { return c && t == t ? OK : ERROR; }

EXPORT int fmi3UpdateDiscreteStates(Instance *c, _Bool *a, _Bool *b, _Bool *d, _Bool *e, _Bool *f, double *next)
{
    *a = *b = *d = *e = *f = 0;
    *next = 0;
    return c ? OK : ERROR;
}

EXPORT int fmi3SetFloat64(Instance *c, const uint32_t *references, size_t n, const double *values, size_t size)
{
    size_t i, count, done = 0;
    for (i = 0; i < n; i++, done += count) {
        double *to = entries(c, references[i], &count);
        if (!to || done + count > size) return ERROR;
        memcpy(to, values + done, count * sizeof *to);
    }
    return done == size ? OK : ERROR;
}

EXPORT int fmi3GetContinuousStateDerivatives(Instance *c, double *rates, size_t size)
{
    size_t i, j;
    if (size != N) return ERROR;
    for (i = 0; i < N; i++) {
        rates[i] = 0;
        for (j = 0; j < N; j++) rates[i] += c->a[i * N + j] * c->x[j];
        for (j = 0; j < M; j++) rates[i] += c->b[i * M + j] * c->u[j];
    }
    return OK;
}

EXPORT int fmi3GetFloat64(Instance *c, const uint32_t *references, size_t n, double *values, size_t size)
{
    size_t i, count, done = 0;
    for (i = 0; i < n; i++, done += count) {
        double *from = entries(c, references[i], &count);
        if (references[i] == RATES && done + (count = N) <= size) fmi3GetContinuousStateDerivatives(c, values + done, N);
        else if (!from || done + count > size) return ERROR;
        else memcpy(values + done, from, count * sizeof *from);
    }
    return done == size ? OK : ERROR;
}

EXPORT int fmi3GetContinuousStates(Instance *c, double *x, size_t n) { memcpy(x, c->x, n * sizeof *x); return OK; }
EXPORT int fmi3SetContinuousStates(Instance *c, const double *x, size_t n) { memcpy(c->x, x, n * sizeof *x); return OK; }

UNUSED(ActivateModelPartition) UNUSED(CompletedIntegratorStep) UNUSED(DeserializeFMUState) UNUSED(DoStep)
UNUSED(EnterConfigurationMode) UNUSED(EnterStepMode) UNUSED(EvaluateDiscreteStates) UNUSED(ExitConfigurationMode)
UNUSED(FreeFMUState) UNUSED(GetAdjointDerivative) UNUSED(GetBinary) UNUSED(GetBoolean) UNUSED(GetClock)
UNUSED(GetDirectionalDerivative) UNUSED(GetEventIndicators) UNUSED(GetFMUState) UNUSED(GetFloat32) UNUSED(GetInt16)
UNUSED(GetInt32) UNUSED(GetInt64) UNUSED(GetInt8) UNUSED(GetIntervalDecimal) UNUSED(GetIntervalFraction)
UNUSED(GetNominalsOfContinuousStates) UNUSED(GetNumberOfContinuousStates) UNUSED(GetNumberOfEventIndicators)
UNUSED(GetNumberOfVariableDependencies) UNUSED(GetOutputDerivatives) UNUSED(GetShiftDecimal) UNUSED(GetShiftFraction)
UNUSED(GetString) UNUSED(GetUInt16) UNUSED(GetUInt32) UNUSED(GetUInt64) UNUSED(GetUInt8)
UNUSED(GetVariableDependencies) UNUSED(GetVersion) UNUSED(InstantiateCoSimulation)
UNUSED(InstantiateScheduledExecution) UNUSED(SerializeFMUState) UNUSED(SerializedFMUStateSize) UNUSED(SetBinary)
UNUSED(SetBoolean) UNUSED(SetClock) UNUSED(SetDebugLogging) UNUSED(SetFMUState) UNUSED(SetFloat32) UNUSED(SetInt16)
UNUSED(SetInt32) UNUSED(SetInt64) UNUSED(SetInt8) UNUSED(SetIntervalDecimal) UNUSED(SetIntervalFraction)
UNUSED(SetShiftDecimal) UNUSED(SetShiftFraction) UNUSED(SetString) UNUSED(SetUInt16) UNUSED(SetUInt32)
UNUSED(SetUInt64) UNUSED(SetUInt8) UNUSED(Terminate)
