/* Maps over the intervals of collocation; see stability/full_period.py.

   Matrices are small, row by row. Stages of LANES intervals are solved for together, one interval a lane, by elimination
   without exchanges; intervals whose factors grow are left to the caller. */

#include <math.h>
#include <string.h>

#include "kernel.h"

enum { LANES = 8 };
typedef double lanes[LANES];

/* A method: stages, Runge-Kutta matrix (d, d), weights of the end (d). */
typedef struct {
    int64_t stages;
    const double *matrix, *end;
} method;

#define EACH for (int64_t l = 0; l < LANES; l++)

/* x += f y for rows of `count` numbers in lanes, f one a lane. */
static inline void add(int64_t count, lanes *restrict x, const double *restrict f, const lanes *restrict y)
{
    for (int64_t j = 0; j < count; j++)
        EACH x[j][l] += f[l] * y[j][l];
}

static inline void add_times(int64_t count, lanes *restrict x, double f, const lanes *restrict y)
{
    for (int64_t j = 0; j < count; j++)
        EACH x[j][l] += f * y[j][l];
}

/* Jacobians of LANES intervals times their lengths; those beyond the last interval are those of the last one. */
static void take(int64_t count, int64_t first, int64_t K, const double *lengths, const double *from, lanes *to)
{
    for (int64_t l = 0; l < LANES; l++) {
        const int64_t k = first + l < K ? first + l : K - 1;
        for (int64_t i = 0; i < count; i++)
            to[i][l] = lengths[k] * from[k * count + i];
    }
}

/* x = A y of matrices (n, n) in lanes. */
static inline void product(int64_t n, lanes *restrict x, const lanes *restrict A, const lanes *restrict y)
{
    memset(x, 0, (size_t)(n * n) * sizeof(lanes));
    for (int64_t i = 0; i < n; i++)
        for (int64_t k = 0; k < n; k++)
            add(n, x + i * n, A[i * n + k], y + k * n);
}

/* Factors of a matrix (N, N) in its place, multipliers below; the largest of these of each lane. */
static void factor(int64_t N, lanes *A, double *growth)
{
    for (int64_t k = 0; k < N; k++) {
        lanes inverse, f;
        EACH inverse[l] = 1.0 / A[k * N + k][l];
        for (int64_t i = k + 1; i < N; i++) {
            EACH f[l] = -A[i * N + k][l] * inverse[l];
            EACH growth[l] = growth[l] >= fabs(f[l]) ? growth[l] : fabs(f[l]); /* NaN stays */
            EACH A[i * N + k][l] = f[l];
            add(N - k - 1, A + i * N + k + 1, f, A + k * N + k + 1);
        }
        EACH A[k * N + k][l] = inverse[l];
    }
}

/* Solutions in the place of right-hand sides (N, n). */
static void solve(int64_t N, int64_t n, const lanes *A, lanes *x)
{
    for (int64_t i = 1; i < N; i++)
        for (int64_t k = 0; k < i; k++)
            add(n, x + i * n, A[i * N + k], x + k * n);
    for (int64_t i = N - 1; i >= 0; i--) {
        for (int64_t k = i + 1; k < N; k++) {
            lanes f;
            EACH f[l] = -A[i * N + k][l];
            add(n, x + i * n, f, x + k * n);
        }
        for (int64_t j = 0; j < n; j++)
            EACH x[i * n + j][l] *= A[i * N + i][l];
    }
}

static void give(int64_t area, int64_t first, int64_t K, const lanes *from, double *to)
{
    for (int64_t l = 0; l < LANES && first + l < K; l++)
        for (int64_t i = 0; i < area; i++)
            to[(first + l) * area + i] = from[i][l];
}

/* Maps over K intervals, (K, n, n), from derivatives of the field at their stages, (K, d, n, n), and how much factors
   grow, (K). `memory` has LANES times (d n)^2 + 2 (d + 1) n^2 numbers. */
KERNEL(interval_maps)(const method *of, int64_t K, int64_t n, const double *lengths, const double *jacobians,
                      double *maps, double *growth, double *memory)
{
    const int64_t d = of->stages, N = d * n, area = n * n;
    lanes *A = (lanes *)memory, *J = A + N * N, *M = J + d * area, *P = M + area, *slopes = P + d * area;
    for (int64_t first = 0; first < K; first += LANES) {
        lanes largest = {0.0};
        take(d * area, first, K, lengths, jacobians, J);
        for (int64_t i = 0; i < d; i++)
            for (int64_t a = 0; a < n; a++)
                for (int64_t j = 0; j < d; j++)
                    for (int64_t b = 0; b < n; b++) {
                        const double weight = -of->matrix[i * d + j], one = i == j && a == b ? 1.0 : 0.0;
                        EACH A[(i * n + a) * N + j * n + b][l] = weight * J[j * area + a * n + b][l] + one;
                    }
        memset(M, 0, (size_t)((d + 1) * area) * sizeof(lanes)); /* M and P begin as 1 */
        for (int64_t i = 0; i <= d; i++)
            for (int64_t a = 0; a < n; a++)
                EACH M[i * area + a * n + a][l] = 1.0;
        factor(N, A, largest);
        solve(N, n, A, P);
        for (int64_t j = 0; j < d; j++) {
            product(n, slopes, J + j * area, P + j * area);
            add_times(area, M, of->end[j], slopes);
        }
        give(area, first, K, M, maps);
        for (int64_t l = 0; l < LANES && first + l < K; l++)
            growth[first + l] = largest[l];
    }
    return 0;
}
