/* Numbers of an FMU at several points in one call: an instance of its binary goes to the time, the state and the inputs
   of each, and gives its derivatives, event indicators, values of variables, or derivatives along several seeds. */

#include <stddef.h>

#include "kernel.h"

/* Functions of the standard; those of FMI 3.0 are told how many numbers there are beside how many variables. */
typedef void any_function(void);
typedef int set_time(void *, double);
typedef int set_states(void *, const double *, size_t);
typedef int get_states(void *, double *, size_t);
typedef int set_reals(void *, const uint32_t *, size_t, const double *);
typedef int set_floats(void *, const uint32_t *, size_t, const double *, size_t);
typedef int get_reals(void *, const uint32_t *, size_t, double *);
typedef int get_floats(void *, const uint32_t *, size_t, double *, size_t);
typedef int real_derivatives(void *, const uint32_t *, size_t, const uint32_t *, size_t, const double *, double *);
typedef int float_derivatives(void *, const uint32_t *, size_t, const uint32_t *, size_t, const double *, size_t,
                              double *, size_t);

typedef struct {
    int64_t fmi, states; /* 2 or 3 */
    void *instance;
    set_time *to_time;
    set_states *to_states;
    any_function *set; /* of reals or of floats, as the two below */
    get_states *derivatives;
    any_function *get, *directional;
    get_states *indicators; /* as the derivatives, of which there are others */
} component;

typedef struct {
    int64_t variables, numbers;
    const uint32_t *references;
} group;

typedef struct {
    const double *t, *x, *inputs; /* (points), (points, states), (points, numbers of inputs) */
    group input, wanted, known;   /* derivatives are wanted where there is no `wanted` variable */
    int64_t indicators;           /* their number, where these are wanted */
    int64_t directions;
    const double *seeds;          /* (directions, numbers of knowns); where there are none, values are wanted */
    double *result;               /* of one point, (directions or 1, numbers wanted) */
    int64_t picked;               /* how many of these go to `numbers`, from the places `pick` */
    const int64_t *pick;
    double *numbers;              /* (points, picked) */
    int64_t *failed;              /* the row where a call failed, which of `call` below, and its status */
} points;

enum call { SET_TIME, SET_STATES, SET_INPUTS, GET_DERIVATIVES, GET_VALUES, GET_DIRECTIONAL, GET_INDICATORS };
enum status { WARNING = 1, ERROR = 3 };

static int place(const component *of, const points *at, int64_t row, enum call *call)
{
    int status = of->to_time(of->instance, at->t[row]);
    *call = SET_TIME;
    if (status > WARNING)
        return status;
    *call = SET_STATES;
    status = of->to_states(of->instance, at->x + row * of->states, (size_t)of->states);
    if (status > WARNING || !at->input.variables)
        return status;
    *call = SET_INPUTS;
    const double *given = at->inputs + row * at->input.numbers;
    const size_t count = (size_t)at->input.variables, numbers = (size_t)at->input.numbers;
    if (of->fmi == 2)
        return ((set_reals *)of->set)(of->instance, at->input.references, count, given);
    return ((set_floats *)of->set)(of->instance, at->input.references, count, given, numbers);
}

static int values(const component *of, const points *at, double *result, enum call *call)
{
    const size_t count = (size_t)at->wanted.variables, numbers = (size_t)at->wanted.numbers;
    *call = at->indicators ? GET_INDICATORS : count ? GET_VALUES : GET_DERIVATIVES;
    if (at->indicators)
        return of->indicators(of->instance, result, (size_t)at->indicators);
    if (!count)
        return of->derivatives(of->instance, result, (size_t)of->states);
    if (of->fmi == 2)
        return ((get_reals *)of->get)(of->instance, at->wanted.references, count, result);
    return ((get_floats *)of->get)(of->instance, at->wanted.references, count, result, numbers);
}

static int along(const component *of, const points *at, const double *seed, double *result, enum call *call)
{
    const group u = at->wanted, k = at->known;
    const size_t unknowns = (size_t)u.variables, knowns = (size_t)k.variables;
    *call = GET_DIRECTIONAL;
    if (!of->directional)
        return ERROR;
    if (of->fmi == 2)
        return ((real_derivatives *)of->directional)(of->instance, u.references, unknowns, k.references, knowns, seed,
                                                     result);
    return ((float_derivatives *)of->directional)(of->instance, u.references, unknowns, k.references, knowns, seed,
                                                  (size_t)k.numbers, result, (size_t)u.numbers);
}

/* Points from `first` to before `last`; 1 where the binary refuses one, and those before it are done. */
KERNEL(fmu_at)(const component *of, const points *at, int64_t first, int64_t last)
{
    const int64_t size = at->wanted.variables ? at->wanted.numbers : of->states;
    enum call call = SET_TIME;
    for (int64_t row = first; row < last; row++) {
        int status = place(of, at, row, &call);
        for (int64_t s = 0; status <= WARNING && s < at->directions; s++)
            status = along(of, at, at->seeds + s * at->known.numbers, at->result + s * size, &call);
        if (status <= WARNING && !at->directions)
            status = values(of, at, at->result, &call);
        if (status > WARNING) {
            at->failed[0] = row;
            at->failed[1] = call;
            at->failed[2] = status;
            return 1;
        }
        for (int64_t k = 0; k < at->picked; k++)
            at->numbers[row * at->picked + k] = at->result[at->pick[k]];
    }
    return 0;
}
