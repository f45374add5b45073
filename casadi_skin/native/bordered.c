/* Solutions with a banded matrix and its border; see solvers/bordered.py, whose steps these are.

   Arrays are stored as LAPACK takes them: a row of ours is a column of its. Its routines are those of scipy, whose
   addresses come with the layout. */

#include <math.h>
#include <stdint.h>
#include <string.h>

#define EXPORTED __attribute__((visibility("default")))

typedef struct {
    int64_t count;
    const int64_t *source, *target; /* of non-zeros of the Jacobian that go to places of an array */
} entries;

typedef struct {
    void (*gbtrf)(const int *, const int *, const int *, const int *, double *, const int *, int *, int *);
    void (*gbtrs)(const char *, const int *, const int *, const int *, const int *, const double *, const int *,
                  const int *, double *, const int *, int *);
    void (*getrf)(const int *, const int *, double *, const int *, int *, int *);
    void (*getrs)(const char *, const int *, const int *, const double *, const int *, const int *, double *,
                  const int *, int *);
    int64_t banded, size, width, nonzeros; /* unknowns in the band, all unknowns, half bandwidth */
    entries inside, right, below, corner;
    const int64_t *rows, *columns; /* of the non-zeros */
    double singular, accurate;
} layout;

/* A factorised matrix: the band, what is left of the columns and rows of its border, and the Schur complement. */
typedef struct {
    double *band, *right, *below, *corner;
    int *pivots, *order;
} factors;

static factors within(const layout *l, double *memory)
{
    const int64_t n = l->banded, edge = l->size - n + 1;
    factors f = {memory, 0, 0, 0, 0, 0};
    f.right = f.band + n * (3 * l->width + 1), f.below = f.right + edge * n, f.corner = f.below + edge * n;
    f.pivots = (int *)(f.corner + edge * edge), f.order = f.pivots + n;
    return f;
}

static void fill(const entries *e, const double *nonzeros, double *array)
{
    for (int64_t i = 0; i < e->count; i++)
        array[e->target[i]] = nonzeros[e->source[i]];
}

static double largest(const double *x, int64_t count)
{
    double most = 0.0;
    for (int64_t i = 0; i < count; i++)
        most = fabs(x[i]) > most || x[i] != x[i] ? fabs(x[i]) : most;
    return most;
}

static double product(const double *x, const double *y, int64_t count)
{
    double sum = 0.0;
    for (int64_t i = 0; i < count; i++)
        sum += x[i] * y[i];
    return sum;
}

/* Solutions of `count` systems in the place of their right-hand sides, (count, size); at most 8 unknowns in the border. */
EXPORTED void casadi_skin_bordered_solve(const layout *l, double *memory, int64_t count, double *x)
{
    const int64_t n = l->banded, edge = l->size - n + 1;
    const int band = (int)n, width = (int)l->width, stored = 3 * width + 1, border = (int)edge, all = (int)l->size;
    const int columns = (int)count, one = 1;
    const factors f = within(l, memory);
    int info;
    l->gbtrs("N", &band, &width, &width, &columns, f.band, &stored, f.pivots, x, &all, &info);
    for (; count > 0; count--, x += l->size) {
        double outer[8] = {0.0};
        memcpy(outer + 1, x + n, (size_t)(edge - 1) * sizeof(double));
        for (int64_t r = 0; r < edge; r++)
            outer[r] -= product(f.below + r * n, x, n);
        l->getrs("N", &border, &one, f.corner, &border, f.order, outer, &border, &info);
        for (int64_t r = 0; r < edge; r++)
            for (int64_t i = 0; i < n; i++)
                x[i] -= outer[r] * f.right[r * n + i];
        memcpy(x + n, outer + 1, (size_t)(edge - 1) * sizeof(double));
    }
}

/* Factors in `memory`; the sign of the determinant, or 0 where elimination meets a zero. */
static double factorise(const layout *l, const double *z, const double *nonzeros, const double *row, double *memory)
{
    const int64_t n = l->banded, edge = l->size - n + 1, stored = 3 * l->width + 1;
    const int band = (int)n, width = (int)l->width, leading = (int)stored, border = (int)edge;
    const factors f = within(l, memory);
    int info;
    memset(memory, 0, (size_t)(n * stored + 2 * edge * n + edge * edge) * sizeof(double));
    fill(&l->inside, nonzeros, f.band), fill(&l->right, nonzeros, f.right);
    fill(&l->below, nonzeros, f.below), fill(&l->corner, nonzeros, f.corner);
    memcpy(f.below + (edge - 1) * n, row, (size_t)n * sizeof(double));
    for (int64_t c = 1; c < edge; c++)
        f.corner[c * edge + edge - 1] = row[n + c - 1];
    int64_t pin = 0; /* where the band is raised, and an unknown more takes that back */
    for (int64_t i = 1; i < n; i++)
        pin = fabs(z[i]) > fabs(z[pin]) ? i : pin;
    const double raised = largest(f.band + pin * stored, stored);
    f.band[pin * stored + 2 * l->width] += raised;
    f.right[pin] = -raised, f.below[pin] = -1.0, f.corner[0] = 1.0;

    l->gbtrf(&band, &band, &width, &width, f.band, &leading, f.pivots, &info);
    if (info)
        return 0.0;
    l->gbtrs("N", &band, &width, &width, &border, f.band, &leading, f.pivots, f.right, &band, &info);
    for (int64_t r = 0; r < edge; r++)
        for (int64_t c = 0; c < edge; c++)
            f.corner[c * edge + r] -= product(f.below + r * n, f.right + c * n, n);
    l->getrf(&border, &border, f.corner, &border, f.order, &info);
    if (info)
        return 0.0;
    int64_t odd = 0;
    for (int64_t i = 0; i < n; i++)
        odd += (f.band[i * stored + 2 * l->width] < 0.0) + (f.pivots[i] != i + 1);
    for (int64_t i = 0; i < edge; i++)
        odd += (f.corner[i * edge + i] < 0.0) + (f.order[i] != i + 1);
    return odd % 2 ? -1.0 : 1.0;
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
EXPORTED int casadi_skin_bordered_steps(const layout *l, int64_t states, const double *z, const double *nonzeros,
                                        const double *rows, int64_t each, double *x, double *orientation,
                                        double *memory, double *defect)
{
    for (; states > 0; states--, z += l->size, nonzeros += l->nonzeros, rows += l->size, x += each * l->size) {
        *orientation = factorise(l, z, nonzeros, rows, memory);
        if (*orientation++ == 0.0)
            return 1;
        casadi_skin_bordered_solve(l, memory, each, x);
        if (!reliable(l, nonzeros, rows, x + (each - 2) * l->size, x + (each - 1) * l->size, defect))
            return 1;
    }
    return 0;
}
