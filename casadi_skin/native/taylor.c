/* Power series of a branch of collocation equations Omega^2 D2 x = f(x, p), order by order; see zero/recursion.py.

   Series are stored order by order. Terms are coefficient * p^power * product of `degree` states, each added to a row of
   f, or of the normalisation, whose states are those at phase zero. */

#include <stdint.h>
#include <string.h>

#define EXPORTED __attribute__((visibility("default")))

/* Terms, and the orders of the products of their first two, three, ... states at each node. */
typedef struct {
    int64_t count;
    const int64_t *powers, *degrees, *rows, *first_factors, *factors, *first_products;
    const double *coefficients;
    double *products;
} terms;

typedef struct {
    int64_t nodes, sites, orders, size, highest; /* highest power of p */
    const double *second_derivative, *at_zero;   /* (nodes, nodes), and weights of the nodes in a value at phase zero */
    double *unknowns, *curvature, *start, *powers, *squared, *right; /* right: size entries */
    terms force, norm;
} series;

/* out += sum of factors[j] * rows[j], j = from .. to - 1: rows `step` apart go down while factors go up. */
static void convolve(double *out, const double *factors, int64_t factor_step, const double *rows, int64_t row_step,
                     int64_t from, int64_t to, int64_t length)
{
    for (int64_t j = from; j < to; j++)
        for (int64_t i = 0; i < length; i++)
            out[i] += factors[j * factor_step] * rows[-j * row_step + i];
}

static void multiply(double *out, const double *left, int64_t left_step, const double *right, int64_t right_step,
                     int64_t from, int64_t to, int64_t length)
{
    for (int64_t j = from; j < to; j++)
        for (int64_t i = 0; i < length; i++)
            out[i] += left[j * left_step + i] * right[-j * right_step + i];
}

/* Values of the terms at order k as if the states had no part of that order; added to `total`, rows of `length`. */
static void first(const series *s, const terms *t, const double *states, int64_t step, int64_t length, int64_t k,
                  double *total)
{
    const int64_t orders = s->orders + 1;
    for (int64_t n = 0; n < t->count; n++) {
        const int64_t *factors = t->factors + t->first_factors[n], degree = t->degrees[n];
        const double *powers = s->powers + t->powers[n] * orders, coefficient = t->coefficients[n];
        double *row = total + t->rows[n] * length, *product = t->products + t->first_products[n];
        if (degree == 0) {
            for (int64_t i = 0; i < length; i++)
                row[i] += coefficient * powers[k];
            continue;
        }
        const double *left = states + factors[0] * length;
        int64_t left_step = step;
        for (int64_t level = 1; level < degree; level++) {
            double *out = product + k * length;
            memset(out, 0, (size_t)length * sizeof(double));
            /* of the last of the states, and of the first where it is one alone, there is no part of order k */
            multiply(out, left, left_step, states + factors[level] * length + k * step, step, 1, level == 1 ? k : k + 1,
                     length);
            left = product, left_step = length, product += orders * length;
        }
        double value[length];
        memset(value, 0, sizeof value);
        if (t->powers[n])
            convolve(value, powers, 1, left + k * left_step, left_step, 0, k + 1, length);
        else
            memcpy(value, left + k * left_step, sizeof value);
        for (int64_t i = 0; i < length; i++)
            row[i] += coefficient * value[i];
    }
}

/* What the part of order k of the states adds to the products. */
static void complete(const series *s, const terms *t, const double *states, int64_t step, int64_t length, int64_t k)
{
    for (int64_t n = 0; n < t->count; n++) {
        const int64_t *factors = t->factors + t->first_factors[n];
        double *product = t->products + t->first_products[n];
        for (int64_t i = 0; i < length && t->degrees[n] > 1; i++) {
            double change = states[factors[0] * length + k * step + i], left = states[factors[0] * length + i];
            for (int64_t level = 1; level < t->degrees[n]; level++) {
                const double *right = states + factors[level] * length + i;
                double *out = product + (level - 1) * (s->orders + 1) * length + i;
                change = k ? change * right[0] + left * right[k * step] : left * right[0];
                out[k * length] = k < 2 ? change : out[k * length] + change;
                left = out[0];
            }
        }
    }
}

/* Order k of the powers of p, and of Omega^2, from the parts of Omega and p of orders `from` to k - `from`. */
static void scalars(const series *s, int64_t k, int64_t from)
{
    const int64_t states = s->nodes * s->sites, orders = s->orders + 1;
    const double *Omega = s->unknowns + states, *p = Omega + 1;
    s->squared[k] = 0.0;
    multiply(s->squared + k, Omega, s->size, Omega + k * s->size, s->size, from, k + 1 - from, 1);
    s->powers[k] = k == 0;
    for (int64_t power = 1; power <= s->highest; power++) {
        double *of = s->powers + power * orders;
        of[k] = 0.0;
        multiply(of + k, of - orders, 1, p + k * s->size, s->size, 0, k + 1, 1);
    }
}

/* Take over order k of the unknowns, which are in `unknowns`, and complete what depends on them. */
EXPORTED void casadi_skin_taylor_put(series *s, int64_t k)
{
    const int64_t H = s->nodes, states = H * s->sites;
    const double *x = s->unknowns + k * s->size;
    for (int64_t a = 0; a < s->sites; a++) {
        double start = 0.0;
        for (int64_t m = 0; m < H; m++)
            start += s->at_zero[m] * x[a * H + m];
        s->start[k * s->sites + a] = start;
        for (int64_t i = 0; i < H; i++) {
            double sum = 0.0;
            for (int64_t m = 0; m < H; m++)
                sum += s->second_derivative[i * H + m] * x[a * H + m];
            s->curvature[k * states + a * H + i] = sum;
        }
    }
    scalars(s, k, 0);
    complete(s, &s->force, s->unknowns, s->size, H, k);
    complete(s, &s->norm, s->start, s->sites, 1, k);
}

/* Right-hand side of order k: minus the equations without what the part of order k of the unknowns adds. */
EXPORTED void casadi_skin_taylor_right(series *s, int64_t k)
{
    const int64_t states = s->nodes * s->sites;
    memset(s->unknowns + k * s->size, 0, (size_t)s->size * sizeof(double));
    memset(s->start + k * s->sites, 0, (size_t)s->sites * sizeof(double));
    memset(s->right, 0, (size_t)s->size * sizeof(double));
    scalars(s, k, 1);
    convolve(s->right, s->squared + k, -1, s->curvature, -states, 0, k, states);
    for (int64_t i = 0; i < states; i++)
        s->right[i] = -s->right[i];
    first(s, &s->force, s->unknowns, s->size, s->nodes, k, s->right);
    for (int64_t i = 0; i < states; i++)
        s->right[i] /= s->squared[0];
    first(s, &s->norm, s->start, s->sites, 1, k, s->right + states);
    s->right[states] = -s->right[states];
}

/* All orders from the third on, by solutions in the place of their right-hand sides. */
EXPORTED void casadi_skin_taylor_series(series *s, void (*solve)(const void *, double *, int64_t, double *),
                                        const void *layout, double *factors)
{
    for (int64_t k = 2; k <= s->orders; k++) {
        casadi_skin_taylor_right(s, k);
        solve(layout, factors, 1, s->right);
        memcpy(s->unknowns + k * s->size, s->right, (size_t)s->size * sizeof(double));
        casadi_skin_taylor_put(s, k);
    }
}
