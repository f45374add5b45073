/* One instance of the model: its values, the modes it may be in, and everything that the interfaces of FMI 2.0 and 3.0
   have in common. All functions are static: a program that links several of these models meets no name twice.
   Nothing is shared between instances; there is no other memory than the instance itself. */
#ifndef INSTANCE_H
#define INSTANCE_H

#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "config.h"

/* Statuses and their numbers are those of fmi2Status and fmi3Status. */
enum { OK = 0, WARNING = 1, DISCARD = 2, ERROR = 3 };

/* Modes of FMI 3.0; FMI 2.0 has the same under other names. STEP is that between two communication points. */
enum { INSTANTIATED = 1, INITIALIZATION = 2, EVENT = 4, CONTINUOUS = 8, STEP = 16, TERMINATED = 32, FAILED = 64 };

enum { MODEL_EXCHANGE, CO_SIMULATION };

enum { SOLVER_STAGES = 12 };

/* Value references: the time, the states, their derivatives, the parameters, the inputs, the outputs. */
enum {
    FIRST_STATE = 1,
    FIRST_DERIVATIVE = FIRST_STATE + NX,
    FIRST_PARAMETER = FIRST_DERIVATIVE + NX,
    FIRST_INPUT = FIRST_PARAMETER + NP - NI,
    FIRST_OUTPUT = FIRST_PARAMETER + NP,
    VARIABLES = FIRST_OUTPUT + NY
};

/* Categories of messages, as bits. */
enum { LOG_DISCARD = 1, LOG_ERROR = 2, LOG_ALL = 3 };

/* The FMU state: what getting, setting and serialising it takes. Arrays have one element more, as C knows no empty ones. */
typedef struct {
    void *none; /* null: fmusim 0.0.39 gives the state to be freed where its address is to be given */
    int mode;
    double time, step, tolerance; /* step: what the solver of Co-Simulation proposes next, 0 before the first */
    double x[NX + 1], p[NP + 1];
} Values;

typedef struct Instance {
    Values now;
    int kind;
    int derivatives_known, outputs_known; /* whether xdot, y belong to `now` */
    double xdot[NX + 1], y[NY + 1];
    double dt, dx[NX + 1], dp[NP + 1], dxdot[NX + 1], dy[NY + 1]; /* seeds and sensitivities */
    double stage[SOLVER_STAGES][NX + 1], trial[NX + 1];           /* of the solver of Co-Simulation */
    const double *arg[SZ_ARG];
    double *res[SZ_RES];
    casadi_int iw[SZ_IW];
    double w[SZ_W];
    int logged; /* categories, as bits */
    void *environment;
    void (*report)(struct Instance *c, int status, const char *category, const char *message);
    const void *callbacks; /* of the interface */
    char name[128];
} Instance;

/* Messages and modes ------------------------------------------------------------------------------------------------ */

static int say(Instance *c, int status, const char *format, ...) {
    char message[512];
    va_list arguments;
    const int error = status >= ERROR;
    if (error) c->now.mode = FAILED;
    if (!c->report || !(error || (c->logged & LOG_DISCARD))) return status; /* errors are always told */
    va_start(arguments, format);
    vsnprintf(message, sizeof message, format, arguments);
    va_end(arguments);
    c->report(c, status, error ? "logStatusError" : "logStatusDiscard", message);
    return status;
}

static const char *mode_name(int mode) {
    switch (mode) {
        case INSTANTIATED: return "Instantiated";
        case INITIALIZATION: return "Initialization Mode";
        case EVENT: return "Event Mode";
        case CONTINUOUS: return "Continuous-Time Mode";
        case STEP: return "Step Mode";
        case TERMINATED: return "Terminated";
        default: return "a state after an error";
    }
}

/* OK where the function may be called in the mode that the instance is in; an error otherwise. */
static int allowed(Instance *c, const char *function, int modes) {
    if (!c) return ERROR;
    if (c->now.mode & modes) return OK;
    return say(c, ERROR, "%s: not allowed in %s", function, mode_name(c->now.mode));
}

static int in_model_exchange(Instance *c, const char *function, int modes) {
    if (!c) return ERROR;
    if (c->kind != MODEL_EXCHANGE) return say(c, ERROR, "%s: not allowed in Co-Simulation", function);
    return allowed(c, function, modes);
}

static void changed(Instance *c) { c->derivatives_known = c->outputs_known = 0; }

static void start_values(Instance *c) {
    memset(&c->now, 0, sizeof c->now); /* with its padding: a serialised state has no bytes left to chance */
    memcpy(c->now.x, START_STATES, NX * sizeof(double));
    memcpy(c->now.p, START_PARAMETERS, NP * sizeof(double));
    c->now.mode = INSTANTIATED;
    c->now.tolerance = DEFAULT_TOLERANCE;
    changed(c);
}

static Instance *new_instance(const char *name, int kind, int logging_on) {
    Instance *c = calloc(1, sizeof(Instance));
    if (!c) return NULL;
    c->kind = kind;
    c->logged = logging_on ? LOG_ALL : 0;
    if (name) strncpy(c->name, name, sizeof c->name - 1);
    start_values(c);
    return c;
}

static int set_logging(Instance *c, int on, size_t count, const char *const categories[]) {
    int bits = count ? 0 : LOG_ALL;
    size_t i;
    for (i = 0; i < count; i++) {
        if (categories[i] && !strcmp(categories[i], "logStatusDiscard")) bits |= LOG_DISCARD;
        else if (categories[i] && !strcmp(categories[i], "logStatusError")) bits |= LOG_ERROR;
        else return say(c, ERROR, "SetDebugLogging: unknown category");
    }
    c->logged = on ? c->logged | bits : c->logged & ~bits;
    return OK;
}

/* The equations ----------------------------------------------------------------------------------------------------- */

typedef int (*Equations)(const double **arg, double **res, casadi_int *iw, double *w, int memory);

static int all_finite(const double *values, int count) {
    int i;
    for (i = 0; i < count; i++)
        if (!isfinite(values[i])) return 0;
    return 1;
}

/* The arguments that all functions begin with; the functions use these arrays beyond their arguments as well. */
static void point(Instance *c, const double *time, const double *x) {
    c->arg[0] = time;
    c->arg[1] = x;
    c->arg[2] = c->now.p;
}

static int run(Instance *c, Equations f) { return f(c->arg, c->res, c->iw, c->w, 0); }

/* x' at a time and a state; nonzero where it is not finite. */
static int derivatives_at(Instance *c, double time, const double *x, double *xdot) {
    point(c, &time, x);
    c->res[0] = xdot;
    return run(c, MODEL_DERIVATIVES) || !all_finite(xdot, NX);
}

static int need_derivatives(Instance *c) {
    if (c->derivatives_known) return OK;
    if (derivatives_at(c, c->now.time, c->now.x, c->xdot))
        return say(c, DISCARD, "derivatives are not finite at time %.17g", c->now.time);
    c->derivatives_known = 1;
    return OK;
}

static int need_outputs(Instance *c) {
    if (c->outputs_known) return OK;
    point(c, &c->now.time, c->now.x);
    c->res[0] = c->y;
    if (run(c, MODEL_OUTPUTS)) return say(c, DISCARD, "outputs cannot be evaluated at time %.17g", c->now.time);
    c->outputs_known = 1;
    return OK;
}

/* Values by their references ---------------------------------------------------------------------------------------- */

static int get_value(Instance *c, unsigned int reference, double *value) {
    int status = OK;
    if (reference == 0) *value = c->now.time;
    else if (reference < FIRST_DERIVATIVE) *value = c->now.x[reference - FIRST_STATE];
    else if (reference < FIRST_PARAMETER) {
        if ((status = need_derivatives(c)) == OK) *value = c->xdot[reference - FIRST_DERIVATIVE];
    } else if (reference < FIRST_OUTPUT) *value = c->now.p[reference - FIRST_PARAMETER];
    else if (reference < VARIABLES) {
        if ((status = need_outputs(c)) != OK) return status;
        if (!isfinite(c->y[reference - FIRST_OUTPUT]))
            return say(c, DISCARD, "variable %u is not finite at time %.17g", reference, c->now.time);
        *value = c->y[reference - FIRST_OUTPUT];
    } else return say(c, ERROR, "no variable has value reference %u", reference);
    return status;
}

static int get_values(Instance *c, const char *function, const unsigned int references[], size_t count,
                      double values[]) {
    int status = allowed(c, function, ~0);
    size_t i;
    for (i = 0; i < count && status == OK; i++) status = get_value(c, references[i], &values[i]);
    return status;
}

/* Access to variables of another type than those that there are. */
static int none(Instance *c, const char *function, size_t count) {
    if (allowed(c, function, ~0) != OK) return ERROR;
    return count ? say(c, ERROR, "%s: no variable has this type", function) : OK;
}

/* Nothing is set where one of the values cannot be. */
static int set_values(Instance *c, const char *function, const unsigned int references[], size_t count,
                      const double values[]) {
    const int before = INSTANTIATED | INITIALIZATION;
    size_t i;
    if (allowed(c, function, before | EVENT | CONTINUOUS | STEP) != OK) return ERROR;
    for (i = 0; i < count; i++) {
        const unsigned int r = references[i];
        const int state = r >= FIRST_STATE && r < FIRST_DERIVATIVE;
        const int parameter = r >= FIRST_PARAMETER && r < FIRST_OUTPUT;
        if (!state && !parameter) return say(c, ERROR, "%s: variable %u cannot be set", function, r);
        if (state && !(c->now.mode & (before | EVENT)))
            return say(c, ERROR, "%s: state %u cannot be set in %s", function, r, mode_name(c->now.mode));
        if (r < FIRST_INPUT && c->now.mode == CONTINUOUS)
            return say(c, ERROR, "%s: variable %u cannot be set in %s", function, r, mode_name(c->now.mode));
        if (!isfinite(values[i])) return say(c, DISCARD, "%s: value of variable %u is not finite", function, r);
        if (parameter) {
            const int k = (int)(r - FIRST_PARAMETER);
            if (values[i] < PARAMETER_MIN[k] || values[i] > PARAMETER_MAX[k])
                return say(c, DISCARD, "%s: parameter %u given %.17g; accepted: %.17g to %.17g", function, r, values[i],
                           PARAMETER_MIN[k], PARAMETER_MAX[k]);
        }
    }
    for (i = 0; i < count; i++) {
        const unsigned int r = references[i];
        if (r < FIRST_DERIVATIVE) c->now.x[r - FIRST_STATE] = values[i];
        else c->now.p[r - FIRST_PARAMETER] = values[i];
    }
    changed(c);
    return OK;
}

static int set_states(Instance *c, const char *function, const double x[], size_t count) {
    if (in_model_exchange(c, function, CONTINUOUS | EVENT) != OK) return ERROR;
    if (count != NX) return say(c, ERROR, "%s: given %u states; accepted: %d", function, (unsigned)count, NX);
    if (!all_finite(x, NX)) return say(c, DISCARD, "%s: a state is not finite", function);
    memcpy(c->now.x, x, NX * sizeof(double));
    changed(c);
    return OK;
}

static int set_time(Instance *c, const char *function, double time) {
    if (in_model_exchange(c, function, CONTINUOUS | EVENT) != OK) return ERROR;
    if (!isfinite(time)) return say(c, ERROR, "%s: the time is not finite", function);
    c->now.time = time;
    changed(c);
    return OK;
}

/* A vector of NX numbers: states, derivatives or nominal values. */
static int get_vector(Instance *c, const char *function, int modes, char which, double values[], size_t count) {
    int status = in_model_exchange(c, function, modes);
    if (status != OK) return status;
    if (count != NX) return say(c, ERROR, "%s: given %u states; accepted: %d", function, (unsigned)count, NX);
    if (which == 'd' && (status = need_derivatives(c)) != OK) return status;
    memcpy(values, which == 'd' ? c->xdot : which == 'x' ? c->now.x : NOMINALS, NX * sizeof(double));
    return OK;
}

/* Derivatives with respect to states, parameters and time ------------------------------------------------------------ */

enum { KNOWN, UNKNOWN };

/* Place of the seed or the sensitivity of a variable: knowns are time, states, parameters; unknowns derivatives, outputs
   and the states that are outputs themselves, for which `own` is asked. NULL where the variable is none of these. */
static double *place(Instance *c, int side, unsigned int r) {
    if (side == KNOWN && r == 0) return &c->dt;
    if (r >= FIRST_STATE && r < FIRST_DERIVATIVE) return &c->dx[r - FIRST_STATE];
    if (side == KNOWN && r >= FIRST_PARAMETER && r < FIRST_OUTPUT) return &c->dp[r - FIRST_PARAMETER];
    if (side == UNKNOWN && r >= FIRST_DERIVATIVE && r < FIRST_PARAMETER) return &c->dxdot[r - FIRST_DERIVATIVE];
    if (side == UNKNOWN && r >= FIRST_OUTPUT && r < VARIABLES) return &c->dy[r - FIRST_OUTPUT];
    return NULL;
}

static int check_places(Instance *c, const char *function, int side, const unsigned int references[], size_t count) {
    size_t i;
    for (i = 0; i < count; i++)
        if (!place(c, side, references[i]))
            return say(c, ERROR, "%s: variable %u is not accepted as %s", function, references[i],
                       side == KNOWN ? "known" : "unknown");
    return OK;
}

/* All seeds are cleared before each call: what an earlier one left has no effect. */
static void clear_seeds(Instance *c) {
    c->dt = 0.0;
    memset(c->dx, 0, sizeof c->dx);
    memset(c->dp, 0, sizeof c->dp);
    memset(c->dxdot, 0, sizeof c->dxdot);
    memset(c->dy, 0, sizeof c->dy);
}

static int check_derivative(Instance *c, const char *function, const unsigned int unknowns[], size_t unknown_count,
                            const unsigned int knowns[], size_t known_count) {
    if (allowed(c, function, INITIALIZATION | EVENT | CONTINUOUS | STEP | TERMINATED) != OK) return ERROR;
    if (check_places(c, function, UNKNOWN, unknowns, unknown_count) != OK) return ERROR;
    return check_places(c, function, KNOWN, knowns, known_count);
}

static int directional(Instance *c, const char *function, const unsigned int unknowns[], size_t unknown_count,
                       const unsigned int knowns[], size_t known_count, const double seed[], double sensitivity[]) {
    size_t i;
    if (check_derivative(c, function, unknowns, unknown_count, knowns, known_count) != OK) return ERROR;
    clear_seeds(c);
    for (i = 0; i < known_count; i++) *place(c, KNOWN, knowns[i]) += seed[i];
    point(c, &c->now.time, c->now.x);
    c->arg[3] = &c->dt;
    c->arg[4] = c->dx;
    c->arg[5] = c->dp;
    c->res[0] = c->dxdot;
    c->res[1] = c->dy;
    if (run(c, MODEL_FORWARD)) return say(c, DISCARD, "%s: cannot be evaluated", function);
    for (i = 0; i < unknown_count; i++) sensitivity[i] = *place(c, UNKNOWN, unknowns[i]);
    if (!all_finite(sensitivity, (int)unknown_count)) return say(c, DISCARD, "%s: the result is not finite", function);
    return OK;
}

/* The FMU state ------------------------------------------------------------------------------------------------------ */

static int get_state(Instance *c, const char *function, void **state) {
    if (allowed(c, function, ~FAILED) != OK) return ERROR;
    if (!state) return say(c, ERROR, "%s: no place given for the state", function);
    if (!*state && !(*state = malloc(sizeof(Values)))) return say(c, ERROR, "%s: out of memory", function);
    memcpy(*state, &c->now, sizeof(Values));
    return OK;
}

static int set_state(Instance *c, const char *function, const void *state) {
    if (allowed(c, function, ~0) != OK) return ERROR;
    if (!state) return say(c, ERROR, "%s: no state given", function);
    memcpy(&c->now, state, sizeof(Values));
    changed(c);
    return OK;
}

static int free_state(Instance *c, const char *function, void **state) {
    if (allowed(c, function, ~0) != OK) return ERROR;
    if (!state) return OK;
    free(*state);
    *state = NULL;
    return OK;
}

/* A serialised state begins with the token of the model: that of another model is refused. */
enum { TOKEN = sizeof INSTANTIATION_TOKEN, SERIALISED = TOKEN + sizeof(Values) };

static int serialise(Instance *c, const char *function, const void *state, char bytes[], size_t size) {
    if (allowed(c, function, ~0) != OK) return ERROR;
    if (!state || size < SERIALISED) return say(c, ERROR, "%s: no state, or too few bytes given", function);
    memcpy(bytes, INSTANTIATION_TOKEN, TOKEN);
    memcpy(bytes + TOKEN, state, sizeof(Values));
    return OK;
}

static int deserialise(Instance *c, const char *function, const char bytes[], size_t size, void **state) {
    if (allowed(c, function, ~0) != OK) return ERROR;
    if (!state || size != SERIALISED || memcmp(bytes, INSTANTIATION_TOKEN, TOKEN))
        return say(c, ERROR, "%s: the bytes are no state of this model", function);
    if (!*state && !(*state = malloc(sizeof(Values)))) return say(c, ERROR, "%s: out of memory", function);
    memcpy(*state, bytes + TOKEN, sizeof(Values));
    return OK;
}

/* From one mode to the next ------------------------------------------------------------------------------------------ */

static int begin_initialization(Instance *c, const char *function, int tolerance_given, double tolerance,
                                double start_time) {
    if (allowed(c, function, INSTANTIATED) != OK) return ERROR;
    if (!isfinite(start_time)) return say(c, ERROR, "%s: the start time is not finite", function);
    if (tolerance_given && !(tolerance > 0.0 && tolerance < 1.0))
        return say(c, ERROR, "%s: tolerance %g; accepted: between 0 and 1", function, tolerance);
    c->now.tolerance = tolerance_given ? tolerance : DEFAULT_TOLERANCE;
    c->now.time = start_time;
    changed(c);
    return OK;
}

static int move(Instance *c, const char *function, int from, int to) {
    if (allowed(c, function, from) != OK) return ERROR;
    c->now.mode = to;
    return OK;
}

#endif
