/* Jacobians of polynomial right-hand sides along orbits, and the variational flow X'' = J(t) X along these by kicks
   V += s_k J_k X and drifts X += a_k V.

   Products are rounded before they are added (-ffp-contract=off), in the order of the non-zeros of a row, as scipy and
   numpy do it: the results are the same to the last bit where these are compiled without fused operations. */

#include <stdlib.h>
#include <string.h>

#include "kernel.h"

/* Orbits by their values at nodes, (sites, nodes) each, those of one `stride` numbers after those of the orbit before,
   and J along them: `constant` and terms. `weights` has shape (nodes, phases), `parameters` one p an orbit; `states`
   has room for sites * phases numbers, `products` for one a phase. */
typedef struct {
    int64_t sites, nodes, phases, stride, nonzeros;
    const double *values, *weights, *parameters, *constant;
    double *states, *products;
    terms polynomials;
} orbits;

/* States at the phases, (sites, phases), from the values of one orbit. */
static void sample(const orbits *o, const double *values)
{
    memset(o->states, 0, (size_t)(o->sites * o->phases) * sizeof(double));
    for (int64_t a = 0; a < o->sites; a++)
        for (int64_t m = 0; m < o->nodes; m++)
            for (int64_t i = 0; i < o->phases; i++)
                o->states[a * o->phases + i] += values[a * o->nodes + m] * o->weights[m * o->phases + i];
}

/* Non-zeros of J along one orbit, (phases, nonzeros). */
static void jacobians_along(const orbits *o, int64_t orbit, double *result)
{
    const terms *t = &o->polynomials;
    sample(o, o->values + orbit * o->stride);
    for (int64_t i = 0; i < o->phases; i++)
        memcpy(result + i * o->nonzeros, o->constant, (size_t)o->nonzeros * sizeof(double));
    for (int64_t n = 0; n < t->count; n++) {
        const int64_t *factors = t->factors + t->first_factors[n];
        double coefficient = t->coefficients[n], *place = result + t->places[n];
        for (int64_t power = 0; power < t->powers[n]; power++)
            coefficient *= o->parameters[orbit];
        for (int64_t i = 0; i < o->phases; i++)
            o->products[i] = coefficient;
        for (int64_t d = 0; d < t->degrees[n]; d++)
            for (int64_t i = 0; i < o->phases; i++)
                o->products[i] *= o->states[factors[d] * o->phases + i];
        for (int64_t i = 0; i < o->phases; i++)
            place[i * o->nonzeros] += o->products[i];
    }
}

/* Non-zeros of J along orbits, (count, phases, nonzeros). */
KERNEL(jacobians)(const orbits *o, int64_t count, double *result)
{
    for (int64_t k = 0; k < count; k++)
        jacobians_along(o, k, result + k * o->phases * o->nonzeros);
    return 0;
}

#ifdef __AVX2__
enum { LANES = 4 };
#else
enum { LANES = 2 };
#endif
enum { ALIGNED = 64, COLUMNS = 8, WIDEST = 24 }; /* columns that go together: as many as bands allow for, and at most */
typedef double lanes __attribute__((vector_size(LANES * sizeof(double)), may_alias));

#define INLINED static inline __attribute__((always_inline))
#define UNROLL _Pragma("GCC unroll 24")

static int64_t larger(int64_t a, int64_t b) { return a > b ? a : b; }
static int64_t smaller(int64_t a, int64_t b) { return a < b ? a : b; }

/* Whether the columns of a block that starts at `start` are those of the block before, moved down by `width`: J is the
   same, moved, in all rows that differ from zero in them. */
static int alike(int64_t start, int64_t width, int64_t n, int64_t farthest, const int32_t *indptr,
                 const int32_t *indices, int64_t kicks, const double *jacobians)
{
    const int64_t low = start - width - farthest, high = start + farthest;
    if (low < 0 || high + width > n)
        return 0;
    for (int64_t i = low; i < high; i++) {
        const int32_t *row = indptr + i, *moved = row + width;
        if (row[1] - row[0] != moved[1] - moved[0])
            return 0;
        for (int32_t m = 0; m < row[1] - row[0]; m++)
            if (indices[row[0] + m] + width != indices[moved[0] + m])
                return 0;
    }
    const size_t bytes = (size_t)(indptr[high] - indptr[low]) * sizeof(double);
    for (int64_t k = 0; k < kicks; k++, jacobians += indptr[n])
        if (memcmp(jacobians + indptr[low], jacobians + indptr[low + width], bytes) != 0)
            return 0;
    return 1;
}

/* Transition matrix phi of one orbit, (2n, 2n) by rows, or with `band` >= 0 the bands of its blocks, (2n, 2(2 band + 1)):
   row i of a block from column i - band on. What grows from unit positions and from unit velocities at `width`
   components, side by side, goes through the stages together: x and v have n rows of these. Velocities are multiplied by
   h inside. `scaled` has an entry for each non-zero of J. */
INLINED void one_orbit(const int64_t width, int64_t n, int64_t reach, int64_t farthest, const int32_t *indptr,
                       const int32_t *indices, int64_t kicks, const double *weights, const double *drifts, double h,
                       const double *jacobians, int64_t band, double *phi, lanes *x, lanes *v, double *scaled)
{
    const int64_t nonzeros = indptr[n], block = band < 0 ? n : 2 * band + 1, groups = 2 * width / LANES;
    const double square = h * h;
    double *positions = (double *)x, *velocities = (double *)v;

    for (int64_t start = 0; start < n; start += width) {
        const int64_t end = smaller(n, start + width);
        const int64_t first = larger(0, start - farthest), last = smaller(n, end + farthest);
        const int same = start > 0 && end - start == width &&
                         alike(start, width, n, farthest, indptr, indices, kicks, jacobians);
        if (same) { /* x and v are those of the block before */
            memmove(x + first * groups, x + (first - width) * groups, (size_t)((last - first) * groups) * sizeof(lanes));
            memmove(v + first * groups, v + (first - width) * groups, (size_t)((last - first) * groups) * sizeof(lanes));
        } else {
            memset(x, 0, (size_t)(n * 2 * groups) * sizeof(lanes));
            for (int64_t i = start; i < end; i++) {
                positions[2 * width * i + i - start] = 1.0;
                velocities[2 * width * i + width + i - start] = h;
            }
        }
        int64_t low = start, high = end; /* what is farther than all kicks so far reach is zero */
        for (int64_t k = 0; k < kicks && !same; k++) {
            low = larger(first, low - reach), high = smaller(last, high + reach);
            const double *jacobian = jacobians + k * nonzeros, weight = weights[k] * square;
            for (int64_t m = indptr[low]; m < indptr[high]; m++)
                scaled[m] = jacobian[m] * weight;
            for (int64_t i = low; i < high; i++) {
                lanes sum[2 * WIDEST / LANES] = {{0.0}}, *own = v + i * groups;
                for (int64_t m = indptr[i]; m < indptr[i + 1]; m++) {
                    const lanes *other = x + indices[m] * groups;
                    UNROLL for (int g = 0; g < groups; g++) sum[g] += scaled[m] * other[g];
                }
                UNROLL for (int g = 0; g < groups; g++) own[g] += sum[g];
            }
            for (int64_t g = low * groups; k + 1 < kicks && g < high * groups; g++)
                x[g] += drifts[k] * v[g];
        }
        for (int64_t i = first; i < last; i++) {
            double *above = phi + i * 2 * block + start - (band < 0 ? 0 : i - band), *below = above + n * 2 * block;
            const double *position = positions + 2 * width * i, *velocity = velocities + 2 * width * i;
            for (int64_t c = 0; c < end - start; c++) {
                above[c] = position[c], above[block + c] = position[width + c];
                below[c] = velocity[c] / h, below[block + c] = velocity[width + c] / h;
            }
        }
    }
}

/* The number of columns that go together: what is left over in the last block costs as much as what is wanted. */
static int64_t width_for(int64_t n, int64_t farthest)
{
    const int64_t by_two = (n + 15) / 16 * 16, by_three = (n + 23) / 24 * 24;
    if (farthest < n || n <= COLUMNS || LANES < 4) /* bands are narrow; too few registers */
        return COLUMNS;
    return by_three < by_two ? 24 : 16;
}

/* Memory for x, v and `scaled` of one_orbit, to be freed by its address; NULL where there is none. */
static char *room_for(int64_t n, int64_t nonzeros, int64_t width, lanes **x, lanes **v, double **scaled)
{
    char *memory = malloc((size_t)(4 * n * width + nonzeros) * sizeof(double) + ALIGNED);
    *x = (lanes *)(((uintptr_t)memory + ALIGNED - 1) / ALIGNED * ALIGNED);
    *v = *x + 2 * n * width / LANES, *scaled = (double *)(*v + 2 * n * width / LANES);
    return memory;
}

/* The same for any width that `width_for` gives. */
static void orbit_of_width(int64_t width, int64_t n, int64_t reach, int64_t farthest, const int32_t *indptr,
                           const int32_t *indices, int64_t kicks, const double *weights, const double *drifts, double h,
                           const double *jacobians, int64_t band, double *phi, lanes *x, lanes *v, double *scaled)
{
    switch (width) {
#define OF(w) case w: one_orbit(w, n, reach, farthest, indptr, indices, kicks, weights, drifts, h, jacobians, band, \
                                phi, x, v, scaled); break;
        OF(8) OF(16) OF(24)
#undef OF
    }
}

/* Transition matrices phi of several orbits, (points, 2n, 2n), each with steps of its own length, in `kicks` kicks with
   `drifts` between them. `jacobians` has the non-zeros of J at the kicks, (kicks, indptr[n]), ordered by rows, of one
   point `stride` numbers after that before; none is farther than `reach` from the diagonal. Of phi, which is zero before, what is farther than `farthest` from the
   diagonals of its blocks stays zero; with `band` >= 0, and no less than farthest + COLUMNS - 1, phi has the bands of
   its blocks, (points, 2n, 2(2 band + 1)). Fails where there is no memory. */
KERNEL(transitions)(int64_t points, int64_t n, int64_t reach, int64_t farthest, const int32_t *indptr,
                    const int32_t *indices, int64_t kicks, const double *weights, const double *drifts,
                    const double *steps, const double *jacobians, int64_t stride, int64_t band, double *phi)
{
    const int64_t nonzeros = indptr[n], entries = 4 * n * (band < 0 ? n : 2 * band + 1), width = width_for(n, farthest);
    lanes *x, *v;
    double *scaled;
    char *memory = room_for(n, nonzeros, width, &x, &v, &scaled);
    if (memory == NULL)
        return 1;
    for (int64_t p = 0; p < points; p++, jacobians += stride, phi += entries)
        orbit_of_width(width, n, reach, farthest, indptr, indices, kicks, weights, drifts, steps[p], jacobians, band, phi,
                       x, v, scaled);
    free(memory);
    return 0;
}

/* Transition matrices phi of several orbits in several numbers of steps, (levels, points, 2n, 2n) in kicks[r] kicks, all
   of whose entries are computed. J is sampled orbit by orbit, so that it stays in the cache of a core; `weights` and
   `drifts` are those of one number of steps after the other, and so are the phases; `steps` has shape (levels, points).
   Matrices of one level are `apart` numbers after those of the level before; `found` has room for one orbit's J. Fails
   where there is no memory. */
KERNEL(flows)(const orbits *o, int64_t points, int64_t n, int64_t reach, const int32_t *indptr, const int32_t *indices,
              int64_t levels, const int64_t *kicks, const double *weights, const double *drifts, const double *steps,
              double *found, int64_t apart, double *phi)
{
    const int64_t width = width_for(n, n);
    lanes *x, *v;
    double *scaled;
    char *memory = room_for(n, indptr[n], width, &x, &v, &scaled);
    if (memory == NULL)
        return 1;
    for (int64_t p = 0; p < points; p++) {
        jacobians_along(o, p, found);
        for (int64_t r = 0, k = 0; r < levels; k += kicks[r], r++)
            orbit_of_width(width, n, reach, n, indptr, indices, kicks[r], weights + k, drifts + k - r,
                           steps[r * points + p], found + k * indptr[n], -1, phi + r * apart + p * 4 * n * n, x, v, scaled);
    }
    free(memory);
    return 0;
}
