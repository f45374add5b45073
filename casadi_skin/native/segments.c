/* Steps of a chain q'' = f(q) = -stiffness q + coupling (its neighbours) - cubic q^3 by kicks q' += b_k h f(q) and drifts
   q += a_k h q', with first and second derivatives by the state before them and by h.

   With Z the derivative of q, (n, columns), p and r the adjoints of q' behind a kick and of q behind a drift, and A = df/dq,
   the second derivative of multipliers times the state behind them is the sum over all kicks of
   Z' diag(b h p f''(q)) Z, and of m 1' + 1 m' in the place of h with m = Z' (b A p + (r before - r) / h). */

#include <stdlib.h>
#include <string.h>

#include "kernel.h"

typedef struct {
    int64_t n, kicks; /* kicks of one step */
    double stiffness, coupling;
    const double *weights, *drifts, *cubic;
} chain;

enum { BLOCK = 8, GROUPS = 4 * REGISTER }; /* columns that go together */

static double weight(const chain *c, int64_t k, int64_t last)
{
    const int64_t place = k % (c->kicks - 1);
    if (k == 0)
        return c->weights[0];
    return place ? c->weights[place] : c->weights[c->kicks - 1] + (k < last ? c->weights[0] : 0.0);
}

/* out += factor * (coupling of the neighbours - diagonal times their own), rows of `columns` numbers */
static void neighbours(const chain *c, double factor, const double *diagonal, const double *restrict in,
                       double *restrict out, int64_t columns)
{
    const double side = factor * c->coupling;
    for (int64_t i = 0; i < c->n; i++, in += columns, out += columns) {
        const double own = -factor * diagonal[i];
        const double *left = i ? in - columns : in, *right = i + 1 < c->n ? in + columns : in;
        const double l = i ? side : 0.0, r = i + 1 < c->n ? side : 0.0;
        for (int64_t j = 0; j < columns; j++)
            out[j] += own * in[j] + l * left[j] + r * right[j];
    }
}

/* The diagonal of -A at q, or that of which f(q) is made. */
static void diagonal_at(const chain *c, const double *q, double factor, double *diagonal)
{
    for (int64_t i = 0; i < c->n; i++)
        diagonal[i] = c->stiffness + factor * c->cubic[i] * q[i] * q[i];
}

/* hessian += Z' diag(d) Z, its upper half by blocks of rows of Z, `wide` numbers each. */
static void squares(int64_t n, int64_t wide, const double *z, const double *d, double *hessian)
{
    for (int64_t a = 0; a < wide; a += 2)
        for (int64_t from = a / BLOCK * BLOCK; from < wide; from += GROUPS) {
            const int64_t count = wide - from < GROUPS ? wide - from : GROUPS;
            double one[GROUPS] = {0.0}, other[GROUPS] = {0.0};
            for (int64_t i = 0; i < n; i++) {
                const double *row = z + i * wide, s = d[i] * row[a], t = d[i] * row[a + 1];
                if (count == GROUPS)
                    for (int64_t j = 0; j < GROUPS; j++)
                        one[j] += s * row[from + j], other[j] += t * row[from + j];
                else
                    for (int64_t j = 0; j < count; j++)
                        one[j] += s * row[from + j], other[j] += t * row[from + j];
            }
            for (int64_t j = 0; j < count; j++)
                hessian[a * wide + from + j] += one[j], hessian[(a + 1) * wide + from + j] += other[j];
        }
}

/* One segment of `last` + 1 kicks: room for 4 (last + 1) n + 3 n + (2 n + wide) wide numbers. */
static void one_segment(const chain *c, int64_t last, double h, const double *before, const double *multipliers,
                        double *after, double *jacobian, double *hessian, double *room)
{
    const int64_t n = c->n, columns = 2 * n + 1, wide = (columns + BLOCK - 1) / BLOCK * BLOCK;
    double *q = room, *v = q + (last + 1) * n, *p = v + (last + 1) * n, *r = p + (last + 1) * n;
    double *diagonal = r + (last + 1) * n, *e = diagonal + n, *force = e + n, *z = force + n, *u = z + n * wide;
    double *second = u + n * wide, sum = 0.0;
    double *x = after, *y = after + n;
    memcpy(after, before, 2 * (size_t)n * sizeof(double));
    for (int64_t k = 0; k <= last; k++) {
        memcpy(q + k * n, x, (size_t)n * sizeof(double));
        diagonal_at(c, x, 1.0, diagonal);
        neighbours(c, weight(c, k, last) * h, diagonal, x, y, 1);
        memcpy(v + k * n, y, (size_t)n * sizeof(double));
        for (int64_t i = 0; i < n && k < last; i++)
            x[i] += c->drifts[k % (c->kicks - 1)] * h * y[i];
    }
    if (multipliers) {
        double *of_q = e, *of_v = force;
        memcpy(of_q, multipliers, (size_t)n * sizeof(double));
        memcpy(of_v, multipliers + n, (size_t)n * sizeof(double));
        for (int64_t k = last; k >= 0; k--) {
            for (int64_t i = 0; i < n; i++) {
                const double a = k < last ? c->drifts[k % (c->kicks - 1)] : 0.0;
                r[k * n + i] = k < last ? of_q[i] : 0.0;
                of_v[i] += a * h * of_q[i];
                p[k * n + i] = of_v[i];
                sum += a * v[k * n + i] * r[k * n + i] / h;
            }
            diagonal_at(c, q + k * n, 3.0, diagonal);
            neighbours(c, weight(c, k, last) * h, diagonal, of_v, of_q, 1);
        }
    }
    memset(z, 0, (size_t)((2 * n + wide) * wide) * sizeof(double));
    for (int64_t i = 0; i < n; i++)
        z[i * wide + i] = u[i * wide + n + i] = 1.0;
    for (int64_t k = 0; k <= last; k++) {
        const double b = weight(c, k, last), *at = q + k * n;
        diagonal_at(c, at, 3.0, diagonal);
        if (multipliers) {
            for (int64_t i = 0; i < n; i++)
                e[i] = ((k ? r[(k - 1) * n + i] : 0.0) - r[k * n + i]) / h;
            neighbours(c, b, diagonal, p + k * n, e, 1);
            for (int64_t i = 0; i < n; i++)
                for (int64_t j = 0; j < columns; j++)
                    second[j * wide + columns - 1] += (j < columns - 1 ? 1.0 : 2.0) * z[i * wide + j] * e[i];
            for (int64_t i = 0; i < n; i++)
                e[i] = -6.0 * b * h * p[k * n + i] * c->cubic[i] * at[i];
            squares(n, wide, z, e, second);
        }
        neighbours(c, b * h, diagonal, z, u, wide);
        diagonal_at(c, at, 1.0, diagonal);
        memset(force, 0, (size_t)n * sizeof(double));
        neighbours(c, b, diagonal, at, force, 1);
        for (int64_t i = 0; i < n; i++)
            u[i * wide + columns - 1] += force[i];
        const double a = k < last ? c->drifts[k % (c->kicks - 1)] : 0.0;
        for (int64_t j = 0; j < n * wide; j++)
            z[j] += a * h * u[j];
        for (int64_t i = 0; i < n; i++)
            z[i * wide + columns - 1] += a * v[k * n + i];
    }
    for (int64_t i = 0; i < 2 * n; i++)
        memcpy(jacobian + i * columns, z + i * wide, (size_t)columns * sizeof(double));
    if (multipliers) {
        second[(columns - 1) * wide + columns - 1] -= 2.0 * sum;
        for (int64_t i = 0; i < columns; i++)
            for (int64_t j = 0; j < columns; j++)
                hessian[i * columns + j] = i <= j ? second[i * wide + j] : second[j * wide + i];
    }
}

/* Segments of `counts` steps from states (segments, 2n): states behind them, their derivatives (segments, 2n, 2n + 1) by
   the states and h, and where there are multipliers (segments, 2n) the second derivatives (segments, 2n + 1, 2n + 1). */
KERNEL(segments)(const chain *c, int64_t count, const int64_t *counts, double h, const double *states,
                 const double *multipliers, double *after, double *jacobians, double *hessians)
{
    const int64_t n = c->n, columns = 2 * n + 1, wide = (columns + BLOCK - 1) / BLOCK * BLOCK;
    int64_t most = 0;
    for (int64_t s = 0; s < count; s++)
        most = counts[s] > most ? counts[s] : most;
    double *room = malloc((size_t)((4 * (most * (c->kicks - 1) + 1) + 3) * n + (2 * n + wide) * wide) * sizeof(double));
    if (room == NULL)
        return 1;
    for (int64_t s = 0; s < count; s++)
        one_segment(c, counts[s] * (c->kicks - 1), h, states + s * 2 * n, multipliers ? multipliers + s * 2 * n : NULL,
                    after + s * 2 * n, jacobians + s * 2 * n * columns, hessians + (multipliers ? s * columns * columns : 0),
                    room);
    free(room);
    return 0;
}
