/* Solves [dR/dz; row that holds one unknown] x = b: dense LU with partial pivoting. */

#include "@p.h"

#include <math.h>

enum { SIZE = @P_UNKNOWNS };
#define A(i, j) a[(size_t)(j) * SIZE + (i)]

int @p_solve(const double *dRdz, int held, const double *z, double *b, double *work)
{
    double *a = work;
    int i, j, k, pivot;
    size_t n;

    (void)z;
    for (n = 0; n < (size_t)SIZE * SIZE; n++) a[n] = 0.0;
    for (j = 0; j < SIZE; j++)
        for (k = @p_residual_colptr[j]; k < @p_residual_colptr[j + 1]; k++) A(@p_residual_row[k], j) = dRdz[k];
    A(SIZE - 1, held) = 1.0;
    for (k = 0; k < SIZE; k++) {
        for (pivot = k, i = k + 1; i < SIZE; i++)
            if (fabs(A(i, k)) > fabs(A(pivot, k))) pivot = i;
        if (!(fabs(A(pivot, k)) > 0.0)) return 1;
        if (pivot != k) {
            double kept = b[k];
            b[k] = b[pivot];
            b[pivot] = kept;
            for (j = k; j < SIZE; j++) {
                kept = A(k, j);
                A(k, j) = A(pivot, j);
                A(pivot, j) = kept;
            }
        }
        for (i = k + 1; i < SIZE; i++) {
            A(i, k) /= A(k, k);
            b[i] -= A(i, k) * b[k];
        }
        for (j = k + 1; j < SIZE; j++) {
            double factor = A(k, j);
            if (factor != 0.0)
                for (i = k + 1; i < SIZE; i++) A(i, j) -= A(i, k) * factor;
        }
    }
    for (k = SIZE - 1; k >= 0; k--) {
        b[k] /= A(k, k);
        for (i = 0; i < k; i++) b[i] -= A(i, k) * b[k];
    }
    return 0;
}
