/* Equilibria of few states along a stretch of a branch, and whether eigenvalues stay on their sides of the axis there;
   see follow/rest_events.py, whose steps these are.

   Unknowns z = (y, u) are n + 1 numbers, the equations F(y, u) = 0 are n. The branch is near a cubic in sigma, and the
   equilibrium at sigma is the one with row . (z - z of the cubic) = 0. */

#include <math.h>
#include <string.h>

#include "kernel.h"

/* The equations at several states at once, and rows and columns of the non-zeros of their derivatives. */
typedef struct {
    int64_t n, nonzeros;
    const places *of;
    const int64_t *rows, *columns;
    double *memory; /* 2 (n + 1) (n + 8) numbers */
} rests;

/* Derivatives by all unknowns, (n, n + 1), or by the states alone, (n, n). */
static void fill(const rests *e, int64_t width, const double *entries, double *matrix)
{
    memset(matrix, 0, (size_t)(e->n * width) * sizeof(double));
    for (int64_t i = 0; i < e->nonzeros; i++)
        if (e->columns[i] < width)
            matrix[e->rows[i] * width + e->columns[i]] = entries[i];
}

/* One step of Newton's method from z, closed by the row; its square in the metric. */
static double step_from(const rests *e, const double *residual, const double *entries, const double *row,
                        const double *weights, double *z)
{
    const int64_t size = e->n + 1;
    double *matrix = e->memory, *step = matrix + size * size, square = 0.0;
    fill(e, size, entries, matrix);
    memcpy(matrix + e->n * size, row, (size_t)size * sizeof(double));
    memcpy(step, residual, (size_t)e->n * sizeof(double));
    step[e->n] = 0.0;
    NAMED(divide)(size, 1, matrix, step);
    for (int64_t i = 0; i < size; i++)
        square += weights[i] * step[i] * step[i];
    for (int64_t i = 0; i < size && square < INFINITY; i++)
        z[i] -= step[i];
    return square;
}

/* Equilibria at `count` places from guesses z, (count, n + 1), in at most so many steps, until one is no longer than
   `still` in the metric; derivatives where the last step began, and whether it was so short. */
KERNEL(rests_along)(const rests *e, int64_t count, int64_t steps, double still, const double *row, const double *weights,
              double *z, double *entries, int8_t *settled)
{
    const int64_t size = e->n + 1, most = e->of->count;
    memset(settled, 0, (size_t)count);
    for (int64_t first = 0; first < count; first += most) {
        const int64_t some = count - first < most ? count - first : most;
        int64_t left = some;
        for (int64_t step = 0; step < steps && left; step++) {
            for (int64_t i = 0; i < most; i++)
                memcpy(e->of->argument[0] + i * size, z + (first + (i < some ? i : some - 1)) * size,
                       (size_t)size * sizeof(double));
            NAMED(at_places)(e->of);
            for (int64_t i = 0; i < some; i++) {
                const double *own = e->of->result[1] + i * e->nonzeros;
                if (settled[first + i])
                    continue;
                memcpy(entries + (first + i) * e->nonzeros, own, (size_t)e->nonzeros * sizeof(double));
                if (step_from(e, e->of->result[0] + i * e->n, own, row, weights, z + (first + i) * size) <= still * still)
                    settled[first + i] = 1, left--;
            }
        }
    }
    return 0;
}

static void sort(int64_t count, double *x)
{
    for (int64_t i = 1; i < count; i++)
        for (int64_t j = i; j > 0 && x[j] < x[j - 1]; j--) {
            const double other = x[j];
            x[j] = x[j - 1], x[j - 1] = other;
        }
}

/* Whether the k-th largest real part of the eigenvalues keeps its sign at places with these derivatives, (count,
   non-zeros), by more than `sure` times its change from one to the next, and more than rounding may make of it: the
   largest eigenvalue and the largest entry times `small`. Returns 1 where it is not so. */
KERNEL(keep_sides)(const rests *e, int64_t count, const double *entries, double sure, const double *small)
{
    const int64_t n = e->n;
    double *matrix = e->memory, *re = matrix + n * n, *im = re + n, *before = im + n, *low = before + n;
    double *high = low + n, *moved = high + n, *room = moved + n, entry = 0.0;
    for (int64_t k = 0; k < count; k++, entries += e->nonzeros) {
        fill(e, n, entries, matrix);
        const double own = largest(matrix, n * n);
        entry = own > entry ? own : entry;
        if (!(own < INFINITY) || NAMED(eigenvalues)(n, matrix, re, im, 0, room))
            return 1;
        sort(n, re);
        for (int64_t i = 0; i < n; i++) {
            const double change = k ? fabs(re[i] - before[i]) : 0.0;
            low[i] = k && low[i] < re[i] ? low[i] : re[i], high[i] = k && high[i] > re[i] ? high[i] : re[i];
            moved[i] = k && moved[i] > change ? moved[i] : change, before[i] = re[i];
        }
    }
    const double size = -low[0] > high[n - 1] ? -low[0] : high[n - 1];
    const double rounding = small[0] * size > small[1] * entry ? small[0] * size : small[1] * entry;
    for (int64_t i = 0; i < n; i++) {
        const double away = low[i] > -high[i] ? low[i] : -high[i];
        if (!(away > sure * moved[i] && away > rounding))
            return 1;
    }
    return 0;
}
