/* Collocation equations on K intervals: residual and Jacobian; see zero/discretisation.py. */

#include <string.h>

#include "kernel.h"

/* What a model gives at the d stages of K intervals, one stage after the other, and at both ends; matrices by columns. */
typedef struct {
    int64_t n, K, R, d, m, entries, conditions, integrals, nonzeros; /* entries of df/dx that are not zero */
    int64_t by_ends[3];                   /* how many entries derivatives of the conditions have */
    const double *extended, *differences; /* weights of the increments, (R, d); constant parts of the non-zeros */
    const int64_t *stiff, *rest;          /* non-zeros that take derivatives by the states at stages, and all others */
    const double *field, *by_states, *by_scalars, *condition, *by_end[3], *integrand, *by_x, *by_s;
} equations;

/* Residual and non-zeros of the Jacobian of x_i - x_0 - h sum_j a_ij f_j, i = 1 .. R, in each interval, then of the
   conditions and of the integrals. The last R is the end of the interval, whose weights are those of integrals. */
KERNEL(collocation_equations)(const equations *e, const double *z, const double *lengths, double *residual,
                              double *nonzeros)
{
    const int64_t n = e->n, d = e->d, own = e->integrals, scalars = e->m * n;
    const int64_t *stiff = e->stiff, *rest = e->rest;
    memcpy(nonzeros, e->differences, (size_t)e->nonzeros * sizeof(double));
    for (int64_t k = 0; k < e->K; k++, z += e->R * n)
        for (int64_t i = 0; i < e->R; i++, residual += n) {
            const double *weights = e->extended + i * d;
            for (int64_t c = 0; c < n; c++) {
                double sum = 0.0;
                for (int64_t j = 0; j < d; j++)
                    sum += lengths[k] * weights[j] * e->field[(k * d + j) * n + c];
                residual[c] = z[(i + 1) * n + c] - z[c] - sum;
            }
            for (int64_t j = 0; j < d; j++) {
                const double weight = lengths[k] * weights[j], *by_states = e->by_states + (k * d + j) * e->entries;
                for (int64_t c = 0; c < e->entries; c++)
                    nonzeros[*stiff++] -= weight * by_states[c];
            }
            for (int64_t c = 0; c < scalars; c++) {
                double sum = 0.0;
                for (int64_t j = 0; j < d; j++)
                    sum += lengths[k] * weights[j] * e->by_scalars[(k * d + j) * scalars + c];
                nonzeros[*rest++] = -sum;
            }
        }
    memcpy(residual, e->condition, (size_t)e->conditions * sizeof(double));
    for (int end = 0; end < 3; end++)
        for (int64_t i = 0; i < e->by_ends[end]; i++)
            nonzeros[*rest++] = e->by_end[end][i];
    if (!own)
        return 0;
    const double *weights = e->extended + (e->R - 1) * d;
    residual += e->conditions;
    memset(residual, 0, (size_t)own * sizeof(double));
    const int64_t *by_scalars = rest + e->K * d * own * n;
    for (int64_t i = 0; i < own * e->m; i++)
        nonzeros[by_scalars[i]] = 0.0;
    for (int64_t k = 0; k < e->K * d; k++) {
        const double weight = lengths[k / d] * weights[k % d];
        for (int64_t i = 0; i < own; i++)
            residual[i] += weight * e->integrand[k * own + i];
        for (int64_t i = 0; i < own * n; i++)
            nonzeros[*rest++] = weight * e->by_x[k * own * n + i];
        for (int64_t i = 0; i < own * e->m; i++)
            nonzeros[by_scalars[i]] += weight * e->by_s[k * own * e->m + i];
    }
    return 0;
}
