/* The flow q'' = f(q) by kicks q' += b_k h f(q) and drifts q += a_k h q', and the variational flow X'' = J(t) X along
   orbits by kicks V += s_k J_k X and drifts X += a_k V.

   Products are rounded before they are added (-ffp-contract=off), in the order of the non-zeros of a row, as scipy and
   numpy do it: the results are the same to the last bit where these are compiled without fused operations. */

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "kernel.h"

enum { LANES = REGISTER, ALIGNED = 64, COLUMNS = 8, WIDEST = 24 }; /* columns that go together: as many as bands allow for, and at most */
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

/* Transition matrix phi of one orbit, (2n, 2n) by rows. What grows from unit positions and from unit velocities at `width`
   components, side by side, goes through the stages together: x and v have n rows of these. Velocities are multiplied by
   h inside. `scaled` has an entry for each non-zero of J. */
INLINED void one_orbit(const int64_t width, int64_t n, int64_t reach, int64_t farthest, const int32_t *indptr,
                       const int32_t *indices, int64_t kicks, const double *weights, const double *drifts, double h,
                       const double *jacobians, double *phi, lanes *x, lanes *v, double *scaled)
{
    const int64_t nonzeros = indptr[n], groups = 2 * width / LANES;
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
            double *above = phi + i * 2 * n + start, *below = above + n * 2 * n;
            const double *position = positions + 2 * width * i, *velocity = velocities + 2 * width * i;
            for (int64_t c = 0; c < end - start; c++) {
                above[c] = position[c], above[n + c] = position[width + c];
                below[c] = velocity[c] / h, below[n + c] = velocity[width + c] / h;
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

/* Transition matrices phi of several orbits, (points, 2n, 2n), each with steps of its own length, in `kicks` kicks with
   `drifts` between them. `jacobians` has the non-zeros of J at the kicks, (kicks, indptr[n]), ordered by rows, of one
   point `stride` numbers after that before; none is farther than `reach` from the diagonal. Of phi, which is zero before,
   what is farther than `farthest` from the diagonals of its blocks stays zero. Fails where there is no memory. */
KERNEL(transitions)(int64_t points, int64_t n, int64_t reach, int64_t farthest, const int32_t *indptr,
                    const int32_t *indices, int64_t kicks, const double *weights, const double *drifts,
                    const double *steps, const double *jacobians, int64_t stride, double *phi)
{
    const int64_t nonzeros = indptr[n], width = width_for(n, farthest);
    char *memory = malloc((size_t)(4 * n * width + nonzeros) * sizeof(double) + ALIGNED);
    if (memory == NULL)
        return 1;
    lanes *x = (lanes *)(((uintptr_t)memory + ALIGNED - 1) / ALIGNED * ALIGNED), *v = x + 2 * n * width / LANES;
    double *scaled = (double *)(v + 2 * n * width / LANES);
    for (int64_t p = 0; p < points; p++, jacobians += stride, phi += 4 * n * n)
        switch (width) {
#define OF(w) case w: one_orbit(w, n, reach, farthest, indptr, indices, kicks, weights, drifts, steps[p], jacobians, \
                                phi, x, v, scaled); break;
            OF(8) OF(16) OF(24)
#undef OF
        }
    free(memory);
    return 0;
}

/* The next of `count` equal steps h of a state, x and v with n entries each; false where it is no longer finite. */
static int one_step(const program *f, int64_t kicks, const double *weights, const double *drifts, double h, double *x,
                    double *v)
{
    const int64_t n = f->states;
    double sum = 0.0;
    for (int64_t k = 0; k < kicks; k++) {
        const double kick = weights[k] * h;
        if (k > 0) {
            const double drift = drifts[k - 1] * h;
            for (int64_t i = 0; i < n; i++)
                x[i] += drift * v[i];
            memcpy(f->values, x, (size_t)n * sizeof(double));
            NAMED(evaluate)(f, f->fixed, f->count);
        }
        for (int64_t i = 0; i < n; i++)
            v[i] += kick * f->values[f->results[i]];
    }
    for (int64_t i = 0; i < n; i++)
        sum += fabs(v[i]) + fabs(x[i]);
    return sum < INFINITY;
}

/* States (points, 2n) after `counts` steps from what they are, or, where they are `chained`, from the one before; those
   that would come from one that is not finite are not, either. */
KERNEL(stepped)(const program *f, int64_t kicks, const double *weights, const double *drifts, int64_t chained,
                int64_t points, const int64_t *counts, const double *steps, double *states)
{
    const int64_t n = f->states;
    NAMED(evaluate)(f, 0, f->fixed);
    for (int64_t p = 0; p < points; p++) {
        double *x = states + p * 2 * n;
        if (chained && p > 0)
            memcpy(x, x - 2 * n, 2 * (size_t)n * sizeof(double));
        if (counts[p] == 0)
            continue;
        memcpy(f->values, x, (size_t)n * sizeof(double)); /* the last kick of a step has the force of the next one */
        NAMED(evaluate)(f, f->fixed, f->count);
        int finite = 1;
        for (int64_t s = 0; s < counts[p] && finite; s++)
            finite = one_step(f, kicks, weights, drifts, steps[p], x, x + n);
        if (!finite)
            x[0] = NAN;
    }
    return 0;
}
