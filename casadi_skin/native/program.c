/* Expressions as CasADi has them, the operations of which that are alike done together: lists of numbers at equal steps
   in, one list out. Each operation is that of CasADi, so that the results are the same to the last bit. */

#include <math.h>

#include "kernel.h"

/* What an operation makes of numbers x and y; native/__init__.py has the same names in the same order. */
#define FAST(make) \
    make(add, x + y) make(sub, x - y) make(mul, x * y) make(div, x / y) make(neg, -x) make(sq, x * x) make(twice, 2.0 * x)
#define OTHER(make)                                                                                                     \
    make(inv, 1.0 / x) make(pow, pow(x, y)) make(constpow, pow(x, y)) make(exp, exp(x)) make(log, log(x))              \
    make(sqrt, sqrt(x)) make(sin, sin(x)) make(cos, cos(x)) make(tan, tan(x)) make(asin, asin(x)) make(acos, acos(x))  \
    make(atan, atan(x)) make(sinh, sinh(x)) make(cosh, cosh(x)) make(tanh, tanh(x)) make(asinh, asinh(x))              \
    make(acosh, acosh(x)) make(atanh, atanh(x)) make(atan2, atan2(x, y)) make(hypot, hypot(x, y))                      \
    make(expm1, expm1(x)) make(log1p, log1p(x)) make(erf, erf(x)) make(floor, floor(x)) make(ceil, ceil(x))            \
    make(fabs, fabs(x)) make(sign, x < 0 ? -1.0 : x > 0 ? 1.0 : x) make(lt, x < y) make(le, x <= y) make(eq, x == y)   \
    make(ne, x != y) make(not, !x) make(and, x && y) make(or, x || y) make(if_else_zero, x ? y : 0.0)                  \
    make(fmin, fmin(x, y)) make(fmax, fmax(x, y)) make(copysign, copysign(x, y))

enum {
#define NUMBER(name, value) OF_##name,
    FAST(NUMBER) OTHER(NUMBER)
#undef NUMBER
};

#define OVER(of, first, second)                   \
    for (int64_t i = 0; i < count; i++) {         \
        const double x = a[first], y = b[second]; \
        (void)x, (void)y, out[i] = of;            \
    }

static void operate(int64_t code, int64_t count, double *restrict out, const double *restrict a, int64_t da,
                    const double *restrict b, int64_t db)
{
    switch (code) {
#define CASE(name, value)                              \
    case OF_##name:                                    \
        if (da == 1 && db == 1)                        \
            OVER(value, i, i)                          \
        else if (da == 0 && db == 1)                   \
            OVER(value, 0, i)                          \
        else if (da == 1 && db == 0)                   \
            OVER(value, i, 0)                          \
        else                                           \
            OVER(value, i * da, i * db)                \
        break;
        FAST(CASE)
#undef CASE
#define CASE(name, value)           \
    case OF_##name:                 \
        OVER(value, i * da, i * db) \
        break;
        OTHER(CASE)
#undef CASE
    }
}

/* Lists from `first` to `last` - 1, each behind those before it in `values`, which begins with the arguments. */
void NAMED(evaluate)(const program *p, int64_t first, int64_t last)
{
    for (int64_t k = first; k < last; k++) {
        const int64_t *list = p->lists + 7 * k; /* operation, length, place, first places and steps of x and of y */
        operate(list[0], list[1], p->values + list[2], p->values + list[3], list[4], p->values + list[5], list[6]);
    }
}
