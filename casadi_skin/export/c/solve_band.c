/* Solves [dR/dz; row that holds one unknown] x = b: LU with partial pivoting of the band of the state values, the other
 * unknowns and equations in a border that is eliminated last.
 *
 * The band alone is singular at a linear mode, so its diagonal entry at the largest state value is raised, and one
 * unknown more in the border takes that back (Govaerts, Numerical Methods for Bifurcations, chapter 3). */

#include "@p.h"

#include <math.h>

enum { SIZE = @P_UNKNOWNS, N = @P_STATE_UNKNOWNS, W = @P_HALF_BANDWIDTH, LD = 3 * W + 1, EDGE = SIZE - N + 1 };
#define BAND(i, j) band[(size_t)(j) * LD + (size_t)(2 * W + (i) - (j))]

/* LU of the band in place, right-hand sides (N rows, columns one after the other) solved along. */
static int band_solve(double *restrict band, double *restrict right, int columns)
{
    int i, j, k, c, pivot;

    for (k = 0; k < N; k++) {
        int below = k + W < N ? k + W : N - 1, beside = k + 2 * W < N ? k + 2 * W : N - 1;
        for (pivot = k, i = k + 1; i <= below; i++)
            if (fabs(BAND(i, k)) > fabs(BAND(pivot, k))) pivot = i;
        if (!(fabs(BAND(pivot, k)) > 0.0)) return 1;
        if (pivot != k) {
            for (j = k; j <= beside; j++) {
                double kept = BAND(k, j);
                BAND(k, j) = BAND(pivot, j);
                BAND(pivot, j) = kept;
            }
            for (c = 0; c < columns; c++) {
                double *b = right + (size_t)c * N, kept = b[k];
                b[k] = b[pivot];
                b[pivot] = kept;
            }
        }
        for (i = k + 1; i <= below; i++) BAND(i, k) /= BAND(k, k);
        for (j = k + 1; j <= beside; j++) {
            double factor = BAND(k, j);
            if (factor != 0.0)
                for (i = k + 1; i <= below; i++) BAND(i, j) -= BAND(i, k) * factor;
        }
        for (c = 0; c < columns; c++) {
            double *b = right + (size_t)c * N;
            for (i = k + 1; i <= below; i++) b[i] -= BAND(i, k) * b[k];
        }
    }
    for (c = 0; c < columns; c++) {
        double *b = right + (size_t)c * N;
        for (k = N - 1; k >= 0; k--) {
            b[k] /= BAND(k, k);
            for (i = k - 2 * W < 0 ? 0 : k - 2 * W; i < k; i++) b[i] -= BAND(i, k) * b[k];
        }
    }
    return 0;
}

/* Gaussian elimination of the border with partial pivoting. */
static int border_solve(double border[EDGE][EDGE], double *b)
{
    int i, j, k, pivot;

    for (k = 0; k < EDGE; k++) {
        for (pivot = k, i = k + 1; i < EDGE; i++)
            if (fabs(border[i][k]) > fabs(border[pivot][k])) pivot = i;
        if (!(fabs(border[pivot][k]) > 0.0)) return 1;
        for (j = k; j < EDGE; j++) {
            double kept = border[k][j];
            border[k][j] = border[pivot][j];
            border[pivot][j] = kept;
        }
        if (pivot != k) {
            double kept = b[k];
            b[k] = b[pivot];
            b[pivot] = kept;
        }
        for (i = k + 1; i < EDGE; i++) {
            double factor = border[i][k] / border[k][k];
            for (j = k; j < EDGE; j++) border[i][j] -= factor * border[k][j];
            b[i] -= factor * b[k];
        }
    }
    for (k = EDGE - 1; k >= 0; k--) {
        for (j = k + 1; j < EDGE; j++) b[k] -= border[k][j] * b[j];
        b[k] /= border[k][k];
    }
    return 0;
}

int @p_solve(const double *restrict dRdz, int held, const double *restrict z, double *restrict b,
             double *restrict work)
{
    double *band = work, *below = band + (size_t)LD * N, *right = below + (size_t)EDGE * N; /* columns, then b */
    double border[EDGE][EDGE], outer[EDGE], raised = 0.0;
    int i, j, k, r, pin = 0;
    size_t n;

    for (n = 0; n < (size_t)(LD + 2 * EDGE + 1) * N; n++) work[n] = 0.0;
    for (i = 0; i < EDGE; i++)
        for (j = 0; j < EDGE; j++) border[i][j] = 0.0;
    for (j = 0; j < SIZE; j++)
        for (k = @p_residual_colptr[j]; k < @p_residual_colptr[j + 1]; k++) {
            i = @p_residual_row[k];
            if (i < N && j < N) BAND(i, j) = dRdz[k];
            else if (i < N) right[(size_t)(j - N + 1) * N + (size_t)i] = dRdz[k];
            else if (j < N) below[(size_t)(i - N + 1) * N + (size_t)j] = dRdz[k];
            else border[i - N + 1][j - N + 1] = dRdz[k];
        }
    if (held < N) below[(size_t)(EDGE - 1) * N + (size_t)held] = 1.0;
    else border[EDGE - 1][held - N + 1] = 1.0;

    for (i = 1; i < N; i++)
        if (fabs(z[i]) > fabs(z[pin])) pin = i;
    for (i = pin < W ? 0 : pin - W; i < N && i <= pin + W; i++) raised = fmax(raised, fabs(BAND(i, pin)));
    BAND(pin, pin) += raised;
    right[pin] = -raised;
    below[pin] = -1.0;
    border[0][0] = 1.0;

    for (i = 0; i < N; i++) right[(size_t)EDGE * N + (size_t)i] = b[i];
    if (band_solve(band, right, EDGE + 1)) return 1;
    for (i = 0; i < EDGE; i++) outer[i] = i == 0 ? 0.0 : b[N + i - 1];
    for (r = 0; r < EDGE; r++)
        for (i = 0; i < N; i++) {
            double factor = below[(size_t)r * N + (size_t)i];
            if (factor == 0.0) continue;
            for (j = 0; j < EDGE; j++) border[r][j] -= factor * right[(size_t)j * N + (size_t)i];
            outer[r] -= factor * right[(size_t)EDGE * N + (size_t)i];
        }
    if (border_solve(border, outer)) return 1;
    for (i = 0; i < N; i++) {
        b[i] = right[(size_t)EDGE * N + (size_t)i];
        for (j = 0; j < EDGE; j++) b[i] -= right[(size_t)j * N + (size_t)i] * outer[j];
    }
    for (j = 1; j < EDGE; j++) b[N + j - 1] = outer[j];
    return 0;
}
