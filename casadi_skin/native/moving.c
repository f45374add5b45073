/* A mesh that moves with the layers of an orbit: see follow/moving.py, which has the same by numpy. */

#include "kernel.h"

/* Values of n states at the start and at `ends` of K intervals, (K R + 1, n), with the weights of the first d + 1 of an
   interval in the derivative at its start and at its ends, (R + 1, d + 1). */
typedef struct {
    int64_t n, K, R, d;
    const double *ends, *slopes;
} layers;

/* x' at all places, in fractions of the whole. */
static void slopes_of(const layers *of, const double *lengths, const double *z, double *found)
{
    const int64_t n = of->n, K = of->K, R = of->R, d = of->d;
    for (int64_t k = 0; k < K; k++, z += R * n)
        for (int64_t i = 0; i < (k < K - 1 ? R : R + 1); i++, found += n)
            for (int64_t a = 0; a < n; a++) {
                double sum = 0.0;
                for (int64_t j = 1; j <= d; j++)
                    sum += of->slopes[i * (d + 1) + j] * (z[j * n + a] - z[a]);
                found[a] = sum / lengths[k];
            }
}

/* x' v from x', where edges move so that lengths change. */
static void multiplied(const layers *of, const double *change, double *found)
{
    const int64_t n = of->n, R = of->R;
    double edge = 0.0;
    for (int64_t k = 0; k < of->K; edge += change[k++])
        for (int64_t i = 0; i < R; i++, found += n)
            for (int64_t a = 0; a < n; a++)
                found[a] *= edge + (i > 0 ? of->ends[i - 1] : 0.0) * change[k];
    for (int64_t a = 0; a < n; a++)
        found[a] *= edge;
}

KERNEL(shifted)(const layers *of, const double *lengths, const double *z, const double *change, double *found)
{
    slopes_of(of, lengths, z, found);
    multiplied(of, change, found);
    return 0;
}

/* The change of lengths with the least |t + x' v|^2 + stretch mean |dv/ds|^2, by elimination of a tridiagonal matrix, and
   x' v. `room` has 3 (K + 1) numbers. */
KERNEL(drift)(const layers *of, const double *lengths, const double *z, const double *weights, const double *tangent,
              double stretch, double *change, double *found, double *room)
{
    const int64_t n = of->n, K = of->K, R = of->R;
    double *diagonal = room, *beside = room + K + 1, *v = room + 2 * (K + 1);
    slopes_of(of, lengths, z, found);
    diagonal[0] = v[0] = 0.0;
    for (int64_t k = 0, p = 0; k < K; k++) {
        const double stiff = stretch / (double)K / (lengths[k] * lengths[k]);
        double first = stiff, last = stiff, both = -stiff, left = 0.0, right = 0.0;
        for (int64_t i = 0; i < R; i++) {
            const double before = i > 0 ? of->ends[i - 1] : 0.0, after = 1.0 - before;
            double own = 0.0, with_t = 0.0;
            for (int64_t a = 0; a < n; a++, p++) {
                own += weights[p] * found[p] * found[p];
                with_t += weights[p] * found[p] * tangent[p];
            }
            first += own * after * after, last += own * before * before, both += own * after * before;
            left -= with_t * after, right -= with_t * before;
        }
        diagonal[k] += first, v[k] += left, beside[k] = both;
        diagonal[k + 1] = last, v[k + 1] = right;
    }
    for (int64_t k = 2; k < K; k++) { /* edges 1 to K - 1: both ends stay */
        const double ratio = beside[k - 1] / diagonal[k - 1];
        diagonal[k] -= ratio * beside[k - 1], v[k] -= ratio * v[k - 1];
    }
    v[0] = v[K] = 0.0;
    for (int64_t k = K - 1; k > 0; k--)
        v[k] = (v[k] - (k < K - 1 ? beside[k] * v[k + 1] : 0.0)) / diagonal[k];
    for (int64_t k = 0; k < K; k++)
        change[k] = v[k + 1] - v[k];
    multiplied(of, change, found);
    return 0;
}
