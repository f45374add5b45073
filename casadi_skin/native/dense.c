/* Factors of small closed matrices A = [dR/dz; row], (n, n) row by row, by elimination with exchanges of rows, and
   whether they serve: see solve/bordered.py, which takes the same steps. */

#include <math.h>
#include <string.h>

#include "kernel.h"

typedef struct {
    int64_t n, nonzeros;
    const int64_t *rows, *columns; /* of the non-zeros of the Jacobian */
    double growth, accurate;       /* of a solution that only a singular matrix gives; residual of one that is right */
    const double *probe;           /* residuals of size 1 in general position, (n - 1) */
    double *room;                  /* n n + 2 n numbers */
} closed;

/* Solutions in the place of right-hand sides x, (count, n); `memory` has the factors, (n, n), and the exchanges, (n). */
KERNEL(dense_solve)(const closed *l, const double *memory, int64_t count, double *x)
{
    const int64_t n = l->n, *with = (const int64_t *)(memory + n * n);
    for (; count > 0; count--, x += n) {
        for (int64_t k = 0; k < n; k++) {
            const double value = x[with[k]];
            x[with[k]] = x[k], x[k] = value;
            for (int64_t i = k + 1; i < n; i++)
                x[i] -= memory[i * n + k] * value;
        }
        for (int64_t k = n - 1; k >= 0; k--) {
            for (int64_t j = k + 1; j < n; j++)
                x[k] -= memory[k * n + j] * x[j];
            x[k] /= memory[k * (n + 1)];
        }
    }
    return 0;
}

/* Factors of A in the place of A; the sign of its determinant, 0 where a pivot vanishes or is no number. */
static double factorise(int64_t n, double *A, int64_t *with)
{
    double sign = 1.0;
    for (int64_t k = 0; k < n; k++) {
        with[k] = k;
        for (int64_t i = k + 1; i < n; i++)
            if (fabs(A[i * n + k]) > fabs(A[with[k] * n + k]))
                with[k] = i;
        for (int64_t j = k; with[k] != k && j < n; j++) {
            const double value = A[k * n + j];
            A[k * n + j] = A[with[k] * n + j], A[with[k] * n + j] = value;
        }
        const double pivot = A[k * (n + 1)];
        if (!(fabs(pivot) > 0.0 && fabs(pivot) < INFINITY))
            return 0.0;
        sign = (with[k] != k) == (pivot < 0.0) ? sign : -sign;
        for (int64_t i = k + 1; i < n; i++) {
            const double factor = A[i * n + k] /= pivot;
            for (int64_t j = k + 1; j < n; j++)
                A[i * n + j] -= factor * A[k * n + j];
        }
    }
    return sign;
}

/* Factors in `memory`, n (n + 1) numbers. Returns 1 of a matrix that is singular but for rounding, or not finite. */
KERNEL(dense_factors)(const closed *l, const double *nonzeros, const double *row, double *memory, double *sign)
{
    const int64_t n = l->n;
    double *A = l->room, *x = A + n * n, *general = x + n, defect = 0.0;
    memset(A, 0, (size_t)(n * n + n) * sizeof(double));
    for (int64_t i = 0; i < l->nonzeros; i++)
        A[l->rows[i] * n + l->columns[i]] = nonzeros[i];
    memcpy(A + (n - 1) * n, row, (size_t)n * sizeof(double));
    memcpy(memory, A, (size_t)(n * n) * sizeof(double));
    *sign = factorise(n, memory, (int64_t *)(memory + n * n));
    if (*sign == 0.0)
        return 1;
    memcpy(general, l->probe, (size_t)(n - 1) * sizeof(double));
    x[n - 1] = 1.0, general[n - 1] = 0.0;
    NAMED(dense_solve)(l, memory, 2, x);
    if (!(largest(general, n) < l->growth))
        return 1;
    const double most = l->accurate * largest(x, n) * largest(nonzeros, l->nonzeros);
    for (int64_t i = 0; i < n; i++) {
        defect = i == n - 1 ? -1.0 : 0.0;
        for (int64_t j = 0; j < n; j++)
            defect += A[i * n + j] * x[j];
        if (!(fabs(defect) <= (i == n - 1 ? l->accurate : most)))
            return 1;
    }
    return 0;
}
