/* Power series of a branch of collocation equations Omega^2 D2 x = f(x, p), order by order; see zero/cosines.py.

   Series are stored order by order. Terms are coefficient * p^power * product of `degree` states, each added to a row of
   f, or of the normalisation, whose states are those at phase zero. */

#include <string.h>

#include "kernel.h"

/* Terms, and the orders of the products of their first two, three, ... states at each node. */
typedef struct {
    terms of;
    const int64_t *first_products;
    double *products;
} polynomials;

typedef struct {
    int64_t nodes, sites, orders, size, highest; /* highest power of p */
    const double *second_derivative, *at_zero;   /* (nodes, nodes), and weights of the nodes in a value at phase zero */
    double *unknowns, *curvature, *start, *powers, *squared, *right; /* right: size entries */
    polynomials force, norm;
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
static void first(const series *s, const polynomials *p, const double *states, int64_t step, int64_t length, int64_t k,
                  double *total)
{
    const int64_t orders = s->orders + 1;
    const terms *t = &p->of;
    for (int64_t n = 0; n < t->count; n++) {
        const int64_t *factors = t->factors + t->first_factors[n], degree = t->degrees[n];
        const double *powers = s->powers + t->powers[n] * orders, coefficient = t->coefficients[n];
        double *row = total + t->places[n] * length, *product = p->products + p->first_products[n];
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
static void complete(const series *s, const polynomials *p, const double *states, int64_t step, int64_t length, int64_t k)
{
    const terms *t = &p->of;
    for (int64_t n = 0; n < t->count; n++) {
        const int64_t *factors = t->factors + t->first_factors[n];
        double *product = p->products + p->first_products[n];
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
KERNEL(series_put)(series *s, int64_t k)
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
    return 0;
}

/* Right-hand side of order k: minus the equations without what the part of order k of the unknowns adds. */
KERNEL(series_right)(series *s, int64_t k)
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
    return 0;
}

/* A linear tail that is eliminated, order by order; see lattice/core_with_tail.py. */
typedef struct {
    int64_t orders, nodes, size, first, place, touched, own_Omega;
    const int64_t *columns;               /* of the block, `touched` in number, of which `own_Omega` is that of Omega */
    const double *by_u;                   /* Omega, across, down by powers of u, (orders + 1, 1 + 2 nodes) */
    const double *transform, *block, *by_Omega; /* to harmonics; (nodes, touched); (size - 1) */
    double *along, *powers;               /* as by_u along the branch; powers of the change of u, by order */
    double *balance, *site, *found;       /* by order: nodes, nodes, size */
    double bond;
} tail;

static void by_harmonics(const tail *t, const double *nodes, double *harmonics)
{
    for (int64_t h = 0; h < t->nodes; h++) {
        harmonics[h] = 0.0;
        for (int64_t i = 0; i < t->nodes; i++)
            harmonics[h] += t->transform[h * t->nodes + i] * nodes[i];
    }
}

/* The order of Omega, across and down as if u had no part of it. */
static void without(const tail *t, int64_t k, double *order)
{
    const int64_t count = 1 + 2 * t->nodes, orders = t->orders + 1;
    const double *u = t->powers + orders;
    memset(order, 0, (size_t)count * sizeof(double));
    for (int64_t m = 2; m <= k; m++) {
        double power = 0.0;
        for (int64_t i = 1; i < k; i++)
            power += t->powers[(m - 1) * orders + k - i] * u[i];
        t->powers[m * orders + k] = power;
        for (int64_t f = 0; f < count; f++)
            order[f] += power * t->by_u[m * count + f];
    }
}

/* Solves for order k of a core by factors for the equations with the tail: the right-hand side becomes theirs, and what
   is left in its place is that order of the core's unknowns, with Omega in the place of u. */
static void solve_with_tail(const tail *t, int64_t k, const void *layout, double *factors, double *right)
{
    const int64_t H = t->nodes, functions = 1 + 2 * H;
    double order[functions], known[H], *rows = right + t->first;
    without(t, k, order);
    by_harmonics(t, rows, known);
    for (int64_t h = 0; h < H; h++)
        known[h] = t->block[h * t->touched + t->own_Omega] * order[0] - known[h];
    for (int64_t i = 0; i < t->size - 1; i++)
        right[i] -= t->by_Omega[i] * order[0];
    for (int64_t h = 0; h < H; h++) {
        const double *across = t->along + 1 + h, *down = across + H;
        double sum = down[0] * known[h] + order[1 + H + h] * t->balance[h] - t->bond * order[1 + h] * t->site[h];
        for (int64_t j = 1; j < k; j++)
            sum += down[j * functions] * t->balance[(k - j) * H + h] -
                   t->bond * across[j * functions] * t->site[(k - j) * H + h];
        rows[h] = -sum;
    }
    NAMED(bordered_solve)(layout, factors, 1, right);

    const double u = right[t->place];
    memcpy(t->found + k * t->size, right, (size_t)t->size * sizeof(double));
    t->powers[t->orders + 1 + k] = u;
    for (int64_t f = 0; f < functions; f++)
        t->along[k * functions + f] = order[f] + u * t->by_u[functions + f];
    by_harmonics(t, rows, t->site + k * H);
    right[t->place] = u * t->by_u[functions];
    for (int64_t h = 0; h < H; h++) {
        double sum = known[h];
        for (int64_t i = 0; i < t->touched; i++)
            sum += t->block[h * t->touched + i] * right[t->columns[i]];
        t->balance[k * H + h] = sum;
    }
    right[t->place] = t->along[k * functions];
}

/* All orders from the third on, by factors of a bordered matrix; with a tail where there is one, else NULL. */
KERNEL(series_solve)(series *s, const tail *t, const void *layout, double *factors)
{
    for (int64_t k = 2; k <= s->orders; k++) {
        NAMED(series_right)(s, k);
        if (t)
            solve_with_tail(t, k, layout, factors, s->right);
        else
            NAMED(bordered_solve)(layout, factors, 1, s->right);
        memcpy(s->unknowns + k * s->size, s->right, (size_t)s->size * sizeof(double));
        NAMED(series_put)(s, k);
    }
    return 0;
}
