/* A slave of FMI 2.0 for Co-Simulation that is not of this package: a solver of fixed steps (Runge-Kutta, order 4) inside.

   z = X + iY, z' = (mu + i omega) z - cubic |z|^2 z + force(t), where x = SIZE_X X and y = SIZE_Y Y. What is odd about
   it is set by parameters, whose start values are those of start.h: noise of each communication step, how states may be set, its own steps, a hidden state. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

enum { TIME, X, Y, DER_X, DER_Y, MU, OMEGA, CUBIC, NOISE, SIZE_X, SIZE_Y, SUBSTEPS, ODD, U, FORCE, DRIVE, X0, Y0, COUNT };
enum { NOTHING_ODD, SET_LATE, NEVER_SET, HIDDEN, FAILS, RESET_IN_PART, LAGS, BY_PARAMETERS }; /* what is odd */
enum { OK = 0, DISCARD = 2, ERROR = 3 };
enum { INSTANTIATED, INITIALISING, STEPPING };
static const double OWN_STEP = 0.01; /* of one that lags */
static const double START[COUNT] =
#include "start.h"
    ;
typedef struct {
    double v[COUNT], hidden;
    int mode;
} Slave;
#define EXPORT __attribute__((visibility("default")))
#define UNUSED(name) \
    EXPORT int fmi2##name(void) { return ERROR; }

static void rates(const Slave *c, double t, const double *z, double *dz)
{
    const double *v = c->v, grows = v[MU] - v[CUBIC] * (z[0] * z[0] + z[1] * z[1]);
    dz[0] = grows * z[0] - v[OMEGA] * z[1] + v[U] + v[FORCE] * cos(v[DRIVE] * t);
    dz[1] = v[OMEGA] * z[0] + grows * z[1];
    dz[2] = v[ODD] == HIDDEN ? -0.1 * z[2] : 0.0;
    if (v[ODD] == HIDDEN) dz[0] += z[2];
}

static void runge_kutta(Slave *c, double t, double h, double *z)
{
    static const double at[] = {0.0, 0.5, 0.5, 1.0}, weight[] = {1 / 6., 1 / 3., 1 / 3., 1 / 6.};
    double k[3] = {0, 0, 0}, stage[3], sum[3] = {0, 0, 0};
    int i, j;
    for (i = 0; i < 4; i++) {
        for (j = 0; j < 3; j++) stage[j] = z[j] + at[i] * h * k[j];
        rates(c, t + at[i] * h, stage, k);
        for (j = 0; j < 3; j++) sum[j] += weight[i] * k[j];
    }
    for (j = 0; j < 3; j++) z[j] += h * sum[j];
}

/* A number between -1/2 and 1/2 that changes with every digit of z. */
static double rough(double z)
{
    const double found = sin(z * 1e7) * 43758.5453;
    return found - floor(found) - 0.5;
}

EXPORT int fmi2DoStep(Slave *c, double t, double step, int none)
{
    double z[3] = {c->v[X] / c->v[SIZE_X], c->v[Y] / c->v[SIZE_Y], c->hidden};
    const int lags = c->v[ODD] == LAGS, steps = lags ? (int)floor((t + step - c->v[TIME]) / OWN_STEP + 1e-6) : (int)c->v[SUBSTEPS];
    int k;
    (void)none;
    if (c->mode != STEPPING) return ERROR;
    if (c->v[ODD] == FAILS && z[0] > 2.0) return DISCARD;
    for (k = 0; k < steps; k++) {
        const double h = lags ? OWN_STEP : step / steps;
        runge_kutta(c, c->v[TIME], h, z);
        c->v[TIME] = lags ? c->v[TIME] + OWN_STEP : t + (k + 1) * h;
    }
    c->v[X] = c->v[SIZE_X] * (z[0] + c->v[NOISE] * rough(z[1]));
    c->v[Y] = c->v[SIZE_Y] * (z[1] + c->v[NOISE] * rough(z[0]));
    c->hidden = z[2];
    return OK;
}

EXPORT int fmi2Reset(Slave *c)
{
    const int in_part = c->v[ODD] == RESET_IN_PART;
    memset(c, 0, sizeof *c);
    memcpy(c->v, START, sizeof START);
    if (in_part) c->v[OMEGA] = 1.1;
    c->hidden = 0.1;
    return OK;
}

EXPORT void *fmi2Instantiate(const char *name, int kind, const char *token)
{
    Slave *c = calloc(1, sizeof *c);
    (void)name;
    if (!c || kind != 1 || strcmp(token, "slave")) return NULL;
    fmi2Reset(c);
    return c;
}

EXPORT void fmi2FreeInstance(Slave *c) { free(c); }
EXPORT int fmi2SetupExperiment(Slave *c) { return c->mode == INSTANTIATED ? OK : ERROR; }
EXPORT int fmi2EnterInitializationMode(Slave *c) { return c->mode == INSTANTIATED ? (c->mode = INITIALISING, OK) : ERROR; }
EXPORT int fmi2ExitInitializationMode(Slave *c)
{
    if (c->v[ODD] == BY_PARAMETERS) {
        c->v[X] = c->v[X0];
        c->v[Y] = c->v[Y0];
    }
    return c->mode == INITIALISING ? (c->mode = STEPPING, OK) : ERROR;
}

EXPORT int fmi2SetReal(Slave *c, const unsigned *references, size_t n, const double *values)
{
    size_t i;
    for (i = 0; i < n; i++) {
        const int state = references[i] == X || references[i] == Y, late = c->mode == STEPPING;
        if (references[i] >= COUNT || (state && (c->v[ODD] == NEVER_SET || c->v[ODD] == BY_PARAMETERS))) return ERROR;
        if (state && (c->v[ODD] == SET_LATE) != late) return ERROR;
        c->v[references[i]] = values[i];
    }
    return OK;
}

EXPORT int fmi2GetReal(Slave *c, const unsigned *references, size_t n, double *values)
{
    size_t i;
    for (i = 0; i < n; i++) {
        if (references[i] >= COUNT) return ERROR;
        values[i] = c->v[references[i]];
    }
    return OK;
}

EXPORT const char *fmi2GetVersion(void) { return "2.0"; }
EXPORT const char *fmi2GetTypesPlatform(void) { return "default"; }
UNUSED(SetDebugLogging) UNUSED(Terminate) UNUSED(GetInteger) UNUSED(GetBoolean) UNUSED(GetString) UNUSED(SetInteger)
UNUSED(SetBoolean) UNUSED(SetString) UNUSED(GetFMUstate) UNUSED(SetFMUstate) UNUSED(FreeFMUstate)
UNUSED(SerializedFMUstateSize) UNUSED(SerializeFMUstate) UNUSED(DeSerializeFMUstate) UNUSED(GetDirectionalDerivative)
UNUSED(SetRealInputDerivatives) UNUSED(GetRealOutputDerivatives) UNUSED(CancelStep) UNUSED(GetStatus)
UNUSED(GetRealStatus) UNUSED(GetIntegerStatus) UNUSED(GetBooleanStatus) UNUSED(GetStringStatus)
