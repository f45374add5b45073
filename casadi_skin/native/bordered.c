/* Solutions with a banded matrix and its border; see solve/bordered.py, whose steps these are.

   The band is factorised as LAPACK's gbtf2 does it, in the same places: its routine calls four others a column, which
   takes several times as long where the band is narrow. A row of our arrays is a column of its. */

#include <math.h>
#include <string.h>

#include "kernel.h"

enum { LANES = 8, ALIGNED = 64 }; /* right-hand sides that go together, side by side */
typedef double lanes __attribute__((vector_size(LANES * sizeof(double)), may_alias));

typedef struct {
    int64_t count;
    const int64_t *source, *target; /* of non-zeros of the Jacobian that go to places of an array */
} entries;

/* Where a band is narrower than its width: the last row with an entry in columns up to each, the last column with one
   in rows up to each, and the number of entries above the diagonal that factors have in each column. */
typedef struct {
    const int64_t *deep, *reach, *above;
} extents;

typedef struct {
    int64_t banded, size, width, nonzeros; /* unknowns in the band, all unknowns, half bandwidth */
    entries inside, right, below, corner;
    const int64_t *rows, *columns; /* of the non-zeros */
    double singular, accurate;
    extents within_band;
} layout;

/* A factorised matrix: the band, what is left of the columns and rows of its border, and the Schur complement. */
typedef struct {
    double *band, *right, *below, *corner;
    int64_t *pivots, *order;
    double *room; /* for LANES right-hand sides of the band */
} factors;

static factors within(const layout *l, double *memory)
{
    const int64_t n = l->banded, edge = l->size - n + 1;
    factors f = {memory, 0, 0, 0, 0, 0, 0};
    f.right = f.band + n * (3 * l->width + 1), f.below = f.right + edge * n, f.corner = f.below + edge * n;
    f.pivots = (int64_t *)(f.corner + edge * (3 * edge - 2)), f.order = f.pivots + n;
    f.room = (double *)(((uintptr_t)(f.order + edge) + ALIGNED - 1) / ALIGNED * ALIGNED);
    return f;
}

static void fill(const entries *e, const double *nonzeros, double *array)
{
    for (int64_t i = 0; i < e->count; i++)
        array[e->target[i]] = nonzeros[e->source[i]];
}

static double product(const double *x, const double *y, int64_t count)
{
    double sums[4] = {0.0}; /* independent of one another, so that they go together */
    for (; count % 4; count--)
        sums[0] += x[count - 1] * y[count - 1];
    for (int64_t i = 0; i < count; i += 4)
        for (int64_t k = 0; k < 4; k++)
            sums[k] += x[i + k] * y[i + k];
    return (sums[0] + sums[1]) + (sums[2] + sums[3]);
}

static void subtract(double *restrict y, const double *restrict x, double factor, int64_t count)
{
    for (int64_t i = 0; i < count; i++)
        y[i] -= x[i] * factor;
}

static int64_t smaller(int64_t a, int64_t b) { return a < b ? a : b; }

/* Row exchanges and factors of a band of this half width, in columns of 3 width + 1 with the diagonal at 2 width.
   Exchanges are counted from the diagonal; returns their number with that of negative pivots, or -1 where a pivot
   vanishes. */
static int64_t factorise(int64_t n, int64_t width, const extents *e, double *band, int64_t *exchanges)
{
    const int64_t step = 3 * width; /* from an entry to that right of it */
    int64_t last = 0, odd = 0;      /* the last column that rows so far reach */
    for (int64_t j = 0; j < n; j++) {
        double *pivot = band + j * (step + 1) + 2 * width;
        const int64_t below = e ? e->deep[j] - j : smaller(width, n - 1 - j);
        int64_t p = 0;
        double most = fabs(pivot[0]);
        for (int64_t i = 1; i <= below; i++)
            if (fabs(pivot[i]) > most)
                most = fabs(pivot[i]), p = i;
        exchanges[j] = p;
        if (pivot[p] == 0.0)
            return -1;
        const int64_t right = e ? e->reach[j + p] : smaller(n - 1, j + width + p);
        last = last > right ? last : right;
        odd += (p > 0) + (pivot[p] < 0.0);
        for (int64_t c = 0; p && c <= last - j; c++) {
            double *entry = pivot + c * step, other = entry[p];
            entry[p] = entry[0], entry[0] = other;
        }
        for (int64_t i = 1; i <= below; i++)
            pivot[i] /= pivot[0];
        for (int64_t c = 1; c <= last - j; c++) {
            double *entry = pivot + c * step;
            if (entry[0] != 0.0)
                subtract(entry + 1, pivot + 1, entry[0], below);
        }
    }
    return odd;
}

/* Solutions of LANES systems side by side, x (n, LANES): each in the order of operations of `substitute`. */
static void substitute_together(int64_t n, int64_t width, const extents *e, const double *band,
                                const int64_t *exchanges, lanes *x)
{
    for (int64_t j = 0; j < n; j++) {
        const double *pivot = band + j * (3 * width + 1) + 2 * width;
        const int64_t below = e->deep[j] - j;
        const lanes value = x[j + exchanges[j]];
        x[j + exchanges[j]] = x[j], x[j] = value;
        for (int64_t i = 1; i <= below; i++)
            x[j + i] -= pivot[i] * value;
    }
    for (int64_t j = n - 1; j >= 0; j--) {
        const double *pivot = band + j * (3 * width + 1) + 2 * width;
        const int64_t above = e->above[j];
        const lanes value = x[j] / pivot[0];
        x[j] = value;
        for (int64_t i = above; i > 0; i--)
            x[j - i] -= pivot[-i] * value;
    }
}

/* Solutions of `count` systems with these factors, each `apart` numbers after the one before. */
static void substitute(int64_t n, int64_t width, const extents *e, const double *band, const int64_t *exchanges,
                       int64_t count, int64_t apart, double *right)
{
    for (int64_t j = 0; j < n; j++) {
        const double *pivot = band + j * (3 * width + 1) + 2 * width;
        const int64_t below = e ? e->deep[j] - j : smaller(width, n - 1 - j);
        for (int64_t k = 0; k < count; k++) {
            double *x = right + k * apart + j;
            const double value = x[exchanges[j]];
            x[exchanges[j]] = x[0], x[0] = value;
            subtract(x + 1, pivot + 1, value, below);
        }
    }
    for (int64_t j = n - 1; j >= 0; j--) {
        const double *pivot = band + j * (3 * width + 1) + 2 * width;
        const int64_t above = e ? e->above[j] : smaller(2 * width, j);
        for (int64_t k = 0; k < count; k++) {
            double *x = right + k * apart + j;
            x[0] /= pivot[0];
            subtract(x - above, pivot - above, x[0], above);
        }
    }
}

/* What the border makes of solutions with the band alone, (count, size); at most 8 unknowns in the border. */
static void complete(const layout *l, factors f, int64_t count, double *x)
{
    const int64_t n = l->banded, edge = l->size - n + 1;
    for (; count > 0; count--, x += l->size) {
        double outer[8] = {0.0};
        memcpy(outer + 1, x + n, (size_t)(edge - 1) * sizeof(double));
        for (int64_t r = 0; r < edge; r++)
            outer[r] -= product(f.below + r * n, x, n);
        substitute(edge, edge - 1, 0, f.corner, f.order, 1, 0, outer);
        for (int64_t r = 0; r < edge; r++)
            for (int64_t i = 0; i < n; i++)
                x[i] -= outer[r] * f.right[r * n + i];
        memcpy(x + n, outer + 1, (size_t)(edge - 1) * sizeof(double));
    }
}

KERNEL(bordered_solve)(const void *of, double *memory, int64_t count, double *x)
{
    const layout *l = of;
    const factors f = within(l, memory);
    substitute(l->banded, l->width, &l->within_band, f.band, f.pivots, count, l->size, x);
    complete(l, f, count, x);
    return 0;
}

/* The columns of the border and `count` right-hand sides x, (count, size), with the band alone, in one go where they
   are no more than LANES. */
static void eliminate(const layout *l, factors f, int64_t count, double *x)
{
    const int64_t n = l->banded, edge = l->size - n + 1;
    if (edge + count > LANES) {
        substitute(n, l->width, &l->within_band, f.band, f.pivots, edge, n, f.right);
        substitute(n, l->width, &l->within_band, f.band, f.pivots, count, l->size, x);
        return;
    }
    double *columns[LANES];
    for (int64_t k = 0; k < edge + count; k++)
        columns[k] = k < edge ? f.right + k * n : x + (k - edge) * l->size;
    memset(f.room, 0, (size_t)(n * LANES) * sizeof(double));
    for (int64_t k = 0; k < edge + count; k++)
        for (int64_t i = 0; i < n; i++)
            f.room[i * LANES + k] = columns[k][i];
    substitute_together(n, l->width, &l->within_band, f.band, f.pivots, (lanes *)f.room);
    for (int64_t k = 0; k < edge + count; k++)
        for (int64_t i = 0; i < n; i++)
            columns[k][i] = f.room[i * LANES + k];
}

/* Factors in `memory`, and right-hand sides x, (each, size), eliminated in the band; the sign of the determinant, or 0
   where elimination meets a zero. */
static double factors_of(const layout *l, const double *z, const double *nonzeros, const double *row, int64_t each,
                         double *x, double *memory)
{
    const int64_t n = l->banded, edge = l->size - n + 1, stored = 3 * l->width + 1;
    const factors f = within(l, memory);
    memset(memory, 0, (size_t)(n * stored + 2 * edge * n + edge * (3 * edge - 2)) * sizeof(double));
    fill(&l->inside, nonzeros, f.band), fill(&l->right, nonzeros, f.right), fill(&l->below, nonzeros, f.below);
    memcpy(f.below + (edge - 1) * n, row, (size_t)n * sizeof(double));
    int64_t pin = 0; /* where the band is raised, and an unknown more takes that back */
    for (int64_t i = 1; i < n; i++)
        pin = fabs(z[i]) > fabs(z[pin]) ? i : pin;
    const double raised = largest(f.band + pin * stored, stored);
    f.band[pin * stored + 2 * l->width] += raised;
    f.right[pin] = -raised, f.below[pin] = -1.0;

    const int64_t odd = factorise(n, l->width, &l->within_band, f.band, f.pivots);
    if (odd < 0)
        return 0.0;
    eliminate(l, f, each, x);
    double corner[64] = {1.0}; /* of the border, by rows */
    fill(&l->corner, nonzeros, corner);
    memcpy(corner + (edge - 1) * edge + 1, row + n, (size_t)(edge - 1) * sizeof(double));
    for (int64_t r = 0; r < edge; r++)
        for (int64_t c = 0; c < edge; c++)
            f.corner[c * (3 * edge - 2) + 2 * (edge - 1) + r - c] =
                corner[r * edge + c] - product(f.below + r * n, f.right + c * n, n);
    const int64_t more = factorise(edge, edge - 1, 0, f.corner, f.order);
    return more < 0 ? 0.0 : (odd + more) % 2 ? -1.0 : 1.0;
}

/* Whether solutions for residuals in general position, `response`, and for the closing row alone, `along`, are those of
   a regular matrix. A NaN fails every comparison. `defect` has `size` entries. */
static int reliable(const layout *l, const double *nonzeros, const double *row, const double *response,
                    const double *along, double *defect)
{
    if (!(largest(response, l->size) < l->singular))
        return 0;
    memset(defect, 0, (size_t)l->size * sizeof(double));
    for (int64_t i = 0; i < l->nonzeros; i++)
        defect[l->rows[i]] += nonzeros[i] * along[l->columns[i]];
    const double most = largest(along, l->size) * largest(nonzeros, l->nonzeros);
    return largest(defect, l->size) <= l->accurate * most &&
           fabs(product(row, along, l->size) - 1.0) <= l->accurate;
}

/* Solutions at several states z, (states, size), each closed by a row of its own, in the place of their right-hand
   sides, (states, each, size), of which the last but one is for residuals in general position and the last for the
   closing row alone; signs of the determinants in `orientation`. `memory` has the factors of the last state, then `size`
   entries. Returns 0, or 1 where a matrix is singular but for rounding. */
KERNEL(bordered_steps)(const layout *l, int64_t states, const double *z, const double *nonzeros, const double *rows,
                       int64_t each, double *x, double *orientation, double *memory, double *defect)
{
    for (; states > 0; states--, z += l->size, nonzeros += l->nonzeros, rows += l->size, x += each * l->size) {
        *orientation = factors_of(l, z, nonzeros, rows, each, x, memory);
        if (*orientation++ == 0.0)
            return 1;
        complete(l, within(l, memory), each, x);
        if (!reliable(l, nonzeros, rows, x + (each - 2) * l->size, x + (each - 1) * l->size, defect))
            return 1;
    }
    return 0;
}
