/* Variational flow X'' = J(t) X along orbits by kicks V += s_k J_k X and drifts X += a_k V.

   Products are rounded before they are added (-ffp-contract=off), in the order of the non-zeros of a row, as scipy and
   numpy do it: the results are the same to the last bit where these are compiled without fused operations. */

#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#if defined(__AVX512F__)
enum { LANES = 8 };
#elif defined(__AVX__)
enum { LANES = 4 };
#else
enum { LANES = 2 };
#endif
enum { COLUMNS = 8, GROUPS = COLUMNS / LANES, ALIGNED = 64 };
typedef double lanes __attribute__((vector_size(LANES * sizeof(double))));

/* What grows from unit positions and from unit velocities at COLUMNS components, side by side. */
typedef union {
    lanes groups[2 * GROUPS];
    double entries[2 * COLUMNS];
} columns;

#define EXPORTED __attribute__((visibility("default")))
#define UNROLL _Pragma("GCC unroll 8")

static int64_t larger(int64_t a, int64_t b) { return a > b ? a : b; }
static int64_t smaller(int64_t a, int64_t b) { return a < b ? a : b; }

/* Whether the columns of a block that starts at `start` are those of the block before, moved down by COLUMNS: J is the
   same, moved, in all rows that differ from zero in them. */
static int alike(int64_t start, int64_t n, int64_t farthest, const int32_t *indptr, const int32_t *indices,
                 int64_t kicks, const double *jacobians)
{
    const int64_t low = start - COLUMNS - farthest, high = start + farthest;
    if (low < 0 || high + COLUMNS > n)
        return 0;
    for (int64_t i = low; i < high; i++) {
        const int32_t *row = indptr + i, *moved = row + COLUMNS;
        if (row[1] - row[0] != moved[1] - moved[0])
            return 0;
        for (int32_t m = 0; m < row[1] - row[0]; m++)
            if (indices[row[0] + m] + COLUMNS != indices[moved[0] + m])
                return 0;
    }
    const size_t bytes = (size_t)(indptr[high] - indptr[low]) * sizeof(double);
    for (int64_t k = 0; k < kicks; k++, jacobians += indptr[n])
        if (memcmp(jacobians + indptr[low], jacobians + indptr[low + COLUMNS], bytes) != 0)
            return 0;
    return 1;
}

/* Transition matrix phi of one orbit, (2n, 2n) by rows, or with `band` >= 0 the bands of its blocks, (2n, 2(2 band + 1)):
   row i of a block from column i - band on. Velocities are multiplied by h inside. x and v have n entries, `scaled` has
   one for each non-zero of J. */
static void one_orbit(int64_t n, int64_t reach, int64_t farthest, const int32_t *indptr, const int32_t *indices,
                      int64_t kicks, const double *weights, const double *drifts, double h, const double *jacobians,
                      int64_t band, double *phi, columns *x, columns *v, double *scaled)
{
    const int64_t nonzeros = indptr[n];
    const double square = h * h;
    const int64_t block = band < 0 ? n : 2 * band + 1;

    for (int64_t start = 0; start < n; start += COLUMNS) {
        const int64_t end = smaller(n, start + COLUMNS);
        const int64_t first = larger(0, start - farthest), last = smaller(n, end + farthest);
        const int same = start > 0 && end - start == COLUMNS && alike(start, n, farthest, indptr, indices, kicks, jacobians);
        if (same) { /* x and v are those of the block before */
            memmove(x + first, x + first - COLUMNS, (size_t)(last - first) * sizeof(columns));
            memmove(v + first, v + first - COLUMNS, (size_t)(last - first) * sizeof(columns));
        } else {
            memset(x, 0, (size_t)n * 2 * sizeof(columns));
            for (int64_t i = start; i < end; i++) {
                x[i].entries[i - start] = 1.0;
                v[i].entries[COLUMNS + i - start] = h;
            }
        }
        int64_t low = start, high = end; /* what is farther than all kicks so far reach is zero */
        for (int64_t k = 0; k < kicks && !same; k++) {
            low = larger(first, low - reach), high = smaller(last, high + reach);
            const double *jacobian = jacobians + k * nonzeros, weight = weights[k] * square;
            for (int64_t m = indptr[low]; m < indptr[high]; m++)
                scaled[m] = jacobian[m] * weight;
            for (int64_t i = low; i < high; i++) {
                lanes sum[2 * GROUPS] = {{0.0}};
                for (int64_t m = indptr[i]; m < indptr[i + 1]; m++) {
                    const columns *other = x + indices[m];
                    UNROLL for (int g = 0; g < 2 * GROUPS; g++) sum[g] += scaled[m] * other->groups[g];
                }
                UNROLL for (int g = 0; g < 2 * GROUPS; g++) v[i].groups[g] += sum[g];
            }
            for (int64_t i = low; k + 1 < kicks && i < high; i++)
                UNROLL for (int g = 0; g < 2 * GROUPS; g++) x[i].groups[g] += drifts[k] * v[i].groups[g];
        }
        for (int64_t i = first; i < last; i++) {
            double *above = phi + i * 2 * block + start - (band < 0 ? 0 : i - band), *below = above + n * 2 * block;
            for (int64_t c = 0; c < end - start; c++) {
                above[c] = x[i].entries[c], above[block + c] = x[i].entries[COLUMNS + c];
                below[c] = v[i].entries[c] / h, below[block + c] = v[i].entries[COLUMNS + c] / h;
            }
        }
    }
}

/* Transition matrices phi of several orbits, (points, 2n, 2n), each with steps of its own length, in `kicks` kicks with
   `drifts` between them. `jacobians` has the non-zeros of J at the kicks, (kicks, indptr[n]), ordered by rows, of one
   point `stride` numbers after that before;
   none is farther than `reach` from the diagonal. Of phi, which is zero before, what is farther than `farthest` from the
   diagonals of its blocks stays zero; with `band` >= 0, and no less than farthest + COLUMNS - 1, phi has the bands of
   its blocks, (points, 2n, 2(2 band + 1)). Returns 0, or 1 where there is no memory. */
EXPORTED int casadi_skin_splitting(int64_t points, int64_t n, int64_t reach, int64_t farthest, const int32_t *indptr,
                                   const int32_t *indices, int64_t kicks, const double *weights, const double *drifts,
                                   const double *steps, const double *jacobians, int64_t stride, int64_t band,
                                   double *phi)
{
    const int64_t nonzeros = indptr[n], entries = 4 * n * (band < 0 ? n : 2 * band + 1);
    char *memory = malloc((size_t)n * 2 * sizeof(columns) + (size_t)nonzeros * sizeof(double) + ALIGNED);
    if (memory == NULL)
        return 1;
    columns *x = (columns *)(((uintptr_t)memory + ALIGNED - 1) / ALIGNED * ALIGNED), *v = x + n;
    for (int64_t p = 0; p < points; p++)
        one_orbit(n, reach, farthest, indptr, indices, kicks, weights, drifts, steps[p],
                  jacobians + p * stride, band, phi + p * entries, x, v, (double *)(v + n));
    free(memory);
    return 0;
}
