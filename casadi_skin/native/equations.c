/* Equations of collocation in odd cosines and their Jacobian at several states; see zero/cosines.py.

   A model is a list of instructions on scalars, as CasADi has them. Each is carried out at all nodes of a state before
   the next one: results are those of CasADi to the last bit, but for sums over the nodes. */

#include <math.h>
#include <string.h>

#include "kernel.h"

enum { INPUT, OUTPUT, CONSTANT, ASSIGN, ADD, SUB, MUL, DIV, NEG, SQUARE, TWICE, INVERSE, SQRT, SIN, COS, TAN, EXP, LOG,
       TANH, POWER, EQUAL, LESS_EQUAL, NOT, IF_ELSE_ZERO };

/* An instruction writes place `out` of the work from places `first` and `second`. Of INPUT `first` and `second` are the
   argument and its element, of OUTPUT `out` is the element of the result; a CONSTANT is the `first` of the constants. */
typedef struct {
    int64_t count;
    const int32_t *operations, *out, *first, *second;
    const double *constants;
} program;

typedef struct {
    int64_t nodes, sites, slopes, nonzeros; /* slopes: non-zeros of the derivative of the force */
    const double *second_derivative;        /* (nodes, nodes) */
    const double *cosine, *amplitude, *at_zero; /* (nodes): cos(theta); weights of its coefficient, of a value at 0 */
    const double *constant;                 /* the part of the non-zeros that is constant */
    const int64_t *at_slopes, *at_frequency, *at_parameter, *at_norm; /* non-zeros that take the rest */
    program force, norm;
    double *work, *forces, *start;
} equations;

#define LANES(expression) \
    for (int64_t i = 0; i < lanes; i++) \
        x[i] = expression; \
    break

/* Results, (elements, lanes), of a program at several places side by side: arguments are states, (elements, lanes),
   zeros for their velocities, the parameter, and numbers. */
static void run(const program *p, int64_t lanes, const double *states, double parameter, const double *numbers,
                double *work, double *result)
{
    for (int64_t k = 0; k < p->count; k++) {
        const int64_t first = p->first[k], second = p->second[k];
        const double *a = work + first * lanes, *b = work + second * lanes;
        double *x = (p->operations[k] == OUTPUT ? result : work) + p->out[k] * lanes;
        double value = 0.0;
        switch (p->operations[k]) {
        case INPUT:
            value = first == 2 ? parameter : first == 3 ? numbers[second] : 0.0;
            a = states + second * lanes;
            if (first) {
                LANES(value);
            }
            LANES(a[i]);
        case CONSTANT: value = p->constants[first]; LANES(value);
        case OUTPUT:
        case ASSIGN: LANES(a[i]);
        case ADD: LANES(a[i] + b[i]);
        case SUB: LANES(a[i] - b[i]);
        case MUL: LANES(a[i] * b[i]);
        case DIV: LANES(a[i] / b[i]);
        case NEG: LANES(-a[i]);
        case SQUARE: LANES(a[i] * a[i]);
        case TWICE: LANES(2.0 * a[i]);
        case INVERSE: LANES(1.0 / a[i]);
        case SQRT: LANES(sqrt(a[i]));
        case SIN: LANES(sin(a[i]));
        case COS: LANES(cos(a[i]));
        case TAN: LANES(tan(a[i]));
        case EXP: LANES(exp(a[i]));
        case LOG: LANES(log(a[i]));
        case TANH: LANES(tanh(a[i]));
        case POWER: LANES(pow(a[i], b[i]));
        case EQUAL: LANES(a[i] == b[i]);
        case LESS_EQUAL: LANES(a[i] <= b[i]);
        case NOT: LANES(!a[i]);
        case IF_ELSE_ZERO: LANES(a[i] ? b[i] : 0.0);
        }
    }
}

/* Residuals, (states, unknowns - 1), and non-zeros of the Jacobian, (states, nonzeros), at states (states, unknowns). */
KERNEL(residuals)(const equations *e, int64_t states, const double *z, const double *numbers, double *residual,
                  double *nonzeros)
{
    const int64_t H = e->nodes, n = H * e->sites;
    for (; states > 0; states--, z += n + 2, residual += n + 1, nonzeros += e->nonzeros) {
        const double Omega = z[n], square = Omega * Omega, cube = pow(Omega, 3.0);
        const double *slopes = e->forces + n, *by_parameter = slopes + e->slopes * H;
        run(&e->force, H, z, z[n + 1], numbers, e->work, e->forces);
        for (int64_t a = 0; a < e->sites; a++) {
            const double *x = z + a * H;
            double amplitude = 0.0, start = 0.0;
            for (int64_t m = 0; m < H; m++)
                amplitude += e->amplitude[m] * x[m], start += e->at_zero[m] * x[m];
            e->start[a] = start;
            for (int64_t i = 0; i < H; i++) { /* what is beyond cos(theta) has no large entries to be rounded */
                double sum = 0.0;
                for (int64_t m = 0; m < H; m++)
                    sum += e->second_derivative[i * H + m] * (x[m] - e->cosine[m] * amplitude);
                residual[a * H + i] = sum - e->cosine[i] * amplitude - e->forces[a * H + i] / square;
            }
        }
        memcpy(nonzeros, e->constant, (size_t)e->nonzeros * sizeof(double));
        for (int64_t i = 0; i < e->slopes * H; i++)
            nonzeros[e->at_slopes[i]] -= slopes[i] / square;
        for (int64_t i = 0; i < n; i++) {
            nonzeros[e->at_frequency[i]] = 2.0 * e->forces[i] / cube;
            nonzeros[e->at_parameter[i]] = -by_parameter[i] / square;
        }
        run(&e->norm, 1, e->start, z[n + 1], numbers, e->work, e->forces); /* those at the nodes are used up */
        residual[n] = e->forces[0];
        for (int64_t a = 0; a < e->sites; a++)
            for (int64_t m = 0; m < H; m++)
                nonzeros[e->at_norm[a * H + m]] = e->at_zero[m] * e->forces[1 + a];
    }
    return 0;
}
