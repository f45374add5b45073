/* Maps over the intervals of collocation; see stability/full_period.py.

   x' = A(t) x at the d stages of an interval of length h: slopes S_i = A_i (1 + h sum_j a_ij S_j), the map is
   1 + h sum_i b_i S_i, in units that balance the largest entries of all A.

   And collocation equations by what they are between the ends of intervals alone, see solve/condensed.py: with derivatives
   B(t) by scalars s and residuals R_i of the stages, their changes are

       X_i = x + sum_j a_ij h (A_j X_j + B_j s) + R_i  =  P_i x + G_i s + g_i.

   Matrices are small, row by row. Stages of LANES intervals are solved for together, one interval a lane, by elimination
   without exchanges, and once more with exchanges where factors grow. */

#include <math.h>
#include <string.h>

#include "kernel.h"

enum { LANES = 8, TOGETHER = 4, SPECTRAL_SQUARINGS = 3, MOST_STATES = 16 };
static const double MOST_GROWTH = 16.0; /* of factors without exchanges; measured: as accurate as with them */
static const double SMALLEST_RATE_RATIO = 1e-30; /* with the two above as in full_period.py */
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

/* Jacobians of LANES intervals in units, and lengths; those beyond the last interval are those of the last. */
static void take(int64_t d, int64_t n, int64_t first, int64_t K, const double *lengths, const double *units,
                 const double *from, lanes *to, double *h)
{
    const int64_t area = n * n;
    for (int64_t l = 0; l < LANES; l++) {
        const int64_t k = first + l < K ? first + l : K - 1;
        const double *jacobian = from + k * d * area;
        h[l] = lengths[k];
        for (int64_t i = 0; i < area; i++) {
            const double factor = units[i % n] / units[i / n];
            for (int64_t s = 0; s < d; s++)
                to[s * area + i][l] = factor * jacobian[s * area + i];
        }
    }
}

/* Units that balance the largest of the entries of `count` matrices (n, n). */
static void units_of(int64_t count, int64_t n, const double *matrices, double *units)
{
    double most[MOST_STATES * MOST_STATES] = {0.0};
    for (int64_t s = 0; s < count; s++)
        for (int64_t i = 0; i < n * n; i++)
            most[i] = fabs(matrices[s * n * n + i]) > most[i] ? fabs(matrices[s * n * n + i]) : most[i];
    NAMED(balancing)(n, most, units);
}

/* x = A y in lanes, with y (n, columns). */
static inline void product(int64_t n, int64_t columns, lanes *restrict x, const lanes *restrict A,
                           const lanes *restrict y)
{
    memset(x, 0, (size_t)(n * columns) * sizeof(lanes));
    for (int64_t i = 0; i < n; i++)
        for (int64_t k = 0; k < n; k++)
            add(columns, x + i * columns, A[i * n + k], y + k * columns);
}

/* x += f_0 y_0 + f_1 y_1 + .. of `many` rows y, `apart` lanes from one to the next: x is read and written once. */
static inline __attribute__((always_inline)) void add_rows(int64_t count, lanes *restrict x, const int many,
                                                           const lanes *f, const lanes *restrict y, int64_t apart)
{
    for (int64_t j = 0; j < count; j++) {
        lanes sum;
        memcpy(sum, x[j], sizeof sum);
        for (int m = 0; m < many; m++)
            EACH sum[l] += f[m][l] * y[m * apart + j][l];
        memcpy(x[j], sum, sizeof sum);
    }
}

static inline void add_some(int64_t count, lanes *x, int64_t many, const lanes *f, const lanes *y, int64_t apart)
{
    switch (many) {
    case 4: add_rows(count, x, 4, f, y, apart); break;
    case 3: add_rows(count, x, 3, f, y, apart); break;
    case 2: add_rows(count, x, 2, f, y, apart); break;
    default: add_rows(count, x, 1, f, y, apart); break;
    }
}

/* Factors of a matrix (N, N) in its place, row by row with TOGETHER pivots at a time: multipliers below, with the other
   sign, and inverses of pivots on the diagonal; the largest multiplier of each lane. */
static void factor(int64_t N, lanes *A, double *growth)
{
    for (int64_t i = 0; i < N; i++) {
        lanes *row = A + i * N;
        for (int64_t k = 0; k < i; k += TOGETHER) {
            const int64_t many = i - k < TOGETHER ? i - k : TOGETHER;
            for (int64_t j = k; j < k + many; j++) {
                if (j > k)
                    add_some(1, row + j, j - k, row + k, A + k * N + j, N);
                EACH row[j][l] *= -A[j * N + j][l];
                EACH growth[l] = growth[l] >= fabs(row[j][l]) ? growth[l] : fabs(row[j][l]); /* NaN stays */
            }
            add_some(N - k - many, row + k + many, many, row + k, A + k * N + k + many, N);
        }
        EACH row[i][l] = 1.0 / row[i][l];
    }
}

/* Solutions in the place of right-hand sides (N, n). */
static void solve(int64_t N, int64_t n, const lanes *A, lanes *x)
{
    for (int64_t i = 1; i < N; i++)
        for (int64_t k = 0; k < i; k += TOGETHER)
            add_some(n, x + i * n, i - k < TOGETHER ? i - k : TOGETHER, A + i * N + k, x + k * n, n);
    for (int64_t i = N - 1; i >= 0; i--) {
        for (int64_t k = i + 1; k < N; k += TOGETHER) {
            const int64_t many = N - k < TOGETHER ? N - k : TOGETHER;
            lanes f[TOGETHER];
            for (int64_t m = 0; m < many; m++)
                EACH f[m][l] = -A[i * N + k + m][l];
            add_some(n, x + i * n, many, f, x + k * n, n);
        }
        for (int64_t j = 0; j < n; j++)
            EACH x[i * n + j][l] *= A[i * N + i][l];
    }
}

/* The matrix 1 - h a_ij A_j of the stages of LANES intervals. */
static void stage_system(const method *of, int64_t n, const double *h, const lanes *J, lanes *A)
{
    const int64_t d = of->stages, N = d * n;
    for (int64_t i = 0; i < d; i++)
        for (int64_t j = 0; j < d; j++) {
            lanes weight;
            EACH weight[l] = -h[l] * of->matrix[i * d + j];
            for (int64_t a = 0; a < n; a++)
                for (int64_t b = 0; b < n; b++) {
                    const double one = i == j && a == b ? 1.0 : 0.0;
                    EACH A[(i * n + a) * N + j * n + b][l] = weight[l] * J[(j * n + a) * n + b][l] + one;
                }
        }
}

/* Solutions at the stages of LANES intervals in the place of right-hand sides (d n, columns). `room` has (d n)^2 + LANES
   d n columns numbers. */
static void stages(const method *of, int64_t n, int64_t columns, const double *h, const lanes *J, lanes *A, lanes *P,
                   double *room)
{
    const int64_t d = of->stages, N = d * n, count = N * columns;
    lanes growth = {0.0};
    double *given = room + N * N;
    stage_system(of, n, h, J, A);
    factor(N, A, growth);
    int grown = 0;
    EACH grown |= !(growth[l] <= MOST_GROWTH);
    for (int64_t l = 0; grown && l < LANES; l++)
        for (int64_t i = 0; i < count; i++)
            given[l * count + i] = P[i][l];
    solve(N, columns, A, P);
    if (!grown)
        return;
    stage_system(of, n, h, J, A);
    for (int64_t l = 0; l < LANES; l++) {
        double *x = given + l * count;
        if (growth[l] <= MOST_GROWTH)
            continue;
        for (int64_t i = 0; i < N * N; i++)
            room[i] = A[i][l];
        NAMED(divide)(N, columns, room, x);
        for (int64_t i = 0; i < count; i++)
            P[i][l] = x[i];
    }
}

/* 1 at all stages, in the first n of the columns of right-hand sides, which are zero. */
static void ones(int64_t N, int64_t n, int64_t columns, lanes *P)
{
    memset(P, 0, (size_t)(N * columns) * sizeof(lanes));
    for (int64_t i = 0; i < N; i++)
        EACH P[i * columns + i % n][l] = 1.0;
}

/* Maps over K intervals, (K, n, n), from derivatives of the field at their stages, (K, d, n, n), and the logarithm of
   the determinant of their product. `memory` has LANES ((d n)^2 + (3 d + 2) n^2) + (d n)^2 numbers. */
KERNEL(interval_maps)(const void *by, int64_t K, int64_t n, const double *lengths, const double *jacobians,
                      double *maps, double *contraction, double *memory)
{
    const method *of = by;
    const int64_t d = of->stages, N = d * n, area = n * n;
    lanes *A = (lanes *)memory, *J = A + N * N, *M = J + d * area, *P = M + area, *slopes = P + d * area;
    double units[MOST_STATES], *room = (double *)(slopes + area);
    lanes h, weight;
    units_of(K * d, n, jacobians, units);
    *contraction = 0.0;
    for (int64_t first = 0; first < K; first += LANES) {
        take(d, n, first, K, lengths, units, jacobians, J, h);
        ones(N, n, n, P);
        stages(of, n, n, h, J, A, P, room);
        memset(M, 0, (size_t)area * sizeof(lanes));
        for (int64_t a = 0; a < n; a++)
            EACH M[a * n + a][l] = 1.0;
        for (int64_t j = 0; j < d; j++) {
            product(n, n, slopes, J + j * area, P + j * area);
            EACH weight[l] = h[l] * of->end[j];
            add(area, M, weight, slopes);
        }
        for (int64_t l = 0; l < LANES && first + l < K; l++) {
            for (int64_t i = 0; i < area; i++)
                maps[(first + l) * area + i] = M[i][l] * (units[i / n] / units[i % n]);
            for (int64_t j = 0; j < d; j++)
                for (int64_t a = 0; a < n; a++)
                    *contraction += h[l] * of->end[j] * J[j * area + a * (n + 1)][l];
        }
    }
    return 0;
}

/* What equations are between the ends of intervals, x_(k+1) = M x_k + G s + g: (n, n + m + 1) of each of K, into `maps`, and
   the same of the stages, (d n, n + m + 1), into `inner`. Derivatives by the m scalars are by columns, (K d, m, n), the
   residual has `apart` numbers an interval, of the stages first, of its end last. `memory` has LANES ((d n)^2 + (d + 1) (n
   + 2 (n + m + 1)) n + d n (n + m + 1)) + (d n)^2 numbers. */
void NAMED(condense)(const void *by, int64_t K, int64_t n, int64_t m, const double *lengths, const double *jacobians,
                     const double *by_scalars, const double *residual, int64_t apart, double *maps, double *inner,
                     double *memory)
{
    const method *of = by;
    const int64_t d = of->stages, N = d * n, w = n + m + 1;
    lanes *A = (lanes *)memory, *J = A + N * N, *B = J + d * n * n, *P = B + N * m, *M = P + N * w, *slopes = M + n * w;
    double units[MOST_STATES], *room = (double *)(slopes + n * w);
    lanes h, weight;
    units_of(K * d, n, jacobians, units);
    for (int64_t first = 0; first < K; first += LANES) {
        const double *ends = residual + apart - n;
        take(d, n, first, K, lengths, units, jacobians, J, h);
        ones(N, n, w, P);
        for (int64_t l = 0; l < LANES; l++) {
            const int64_t k = first + l < K ? first + l : K - 1;
            for (int64_t i = 0; i < N; i++) {
                P[i * w + n + m][l] = residual[k * apart + i] / units[i % n];
                for (int64_t c = 0; c < m; c++)
                    B[i * m + c][l] = by_scalars[((k * d + i / n) * m + c) * n + i % n] / units[i % n];
            }
        }
        for (int64_t i = 0; i < N; i++)
            for (int64_t j = 0; j < d; j++) {
                EACH weight[l] = h[l] * of->matrix[i / n * d + j];
                add(m, P + i * w + n, weight, B + (j * n + i % n) * m);
            }
        stages(of, n, w, h, J, A, P, room);
        ones(n, n, w, M);
        for (int64_t j = 0; j < d; j++) {
            product(n, w, slopes, J + j * n * n, P + j * n * w);
            EACH weight[l] = h[l] * of->end[j];
            for (int64_t i = 0; i < n; i++)
                add(m, slopes + i * w + n, (const double[LANES]){1, 1, 1, 1, 1, 1, 1, 1}, B + (j * n + i) * m);
            add(n * w, M, weight, slopes);
        }
        for (int64_t l = 0; l < LANES && first + l < K; l++)
            for (int64_t i = 0; i < N + n; i++) {
                double *to = i < N ? inner + ((first + l) * N + i) * w : maps + ((first + l) * n + i - N) * w;
                const lanes *from = i < N ? P + i * w : M + (i - N) * w;
                for (int64_t c = 0; c < w; c++)
                    to[c] = from[c][l] * (c < n ? units[i % n] / units[c] : units[i % n]);
                if (i >= N)
                    to[n + m] += ends[(first + l) * apart + i - N];
            }
    }
}

/* The smaller of the largest sums of moduli of rows and of columns. */
static double bound_of(int64_t n, const double *A)
{
    double by_rows = 0.0, by_columns = 0.0;
    for (int64_t i = 0; i < n; i++) {
        double row = 0.0, column = 0.0;
        for (int64_t j = 0; j < n; j++)
            row += fabs(A[i * n + j]), column += fabs(A[j * n + i]);
        by_rows = row > by_rows ? row : by_rows, by_columns = column > by_columns ? column : by_columns;
    }
    return fmin(by_rows, by_columns);
}

/* For each of K intervals, (K), bounds of the logarithm of the factor by which something may change in it: from norms of
   h A, and where one of these is above `enough`, from norms of their powers, which bound their eigenvalues closely, where
   they are above `small`. */
void NAMED(changes)(int64_t K, int64_t d, int64_t n, const double *lengths, const double *jacobians, double enough,
                    double small, double *bounds)
{
    const int64_t area = n * n;
    double units[MOST_STATES], factors[MOST_STATES * MOST_STATES], A[MOST_STATES * MOST_STATES];
    double square[MOST_STATES * MOST_STATES], size = 0.0;
    units_of(K * d, n, jacobians, units);
    for (int64_t i = 0; i < area; i++)
        factors[i] = units[i % n] / units[i / n];
    for (int64_t k = 0; k < K; k++) {
        bounds[k] = 0.0;
        for (int64_t s = k * d; s < (k + 1) * d; s++) {
            for (int64_t i = 0; i < area; i++) {
                A[i] = lengths[k] * jacobians[s * area + i] * factors[i];
                size = fabs(A[i]) > size ? fabs(A[i]) : size;
            }
            bounds[k] = fmax(bounds[k], bound_of(n, A));
        }
    }
    if (!(largest(bounds, K) > enough))
        return;
    for (int64_t k = 0; k < K; k++) {
        if (bounds[k] <= small)
            continue;
        bounds[k] = 0.0;
        for (int64_t s = k * d; s < (k + 1) * d; s++) {
            for (int64_t i = 0; i < area; i++) {
                const double entry = lengths[k] * jacobians[s * area + i] * factors[i] / size;
                A[i] = fabs(entry) >= SMALLEST_RATE_RATIO ? entry : 0.0;
            }
            for (int turn = 0; turn < SPECTRAL_SQUARINGS; turn++) {
                memset(square, 0, (size_t)area * sizeof(double));
                for (int64_t i = 0; i < n; i++)
                    for (int64_t a = 0; a < n; a++)
                        for (int64_t j = 0; j < n; j++)
                            square[i * n + j] += A[i * n + a] * A[a * n + j];
                memcpy(A, square, (size_t)area * sizeof(double));
            }
            bounds[k] = fmax(bounds[k], bound_of(n, A));
        }
        bounds[k] = size * pow(bounds[k], 1.0 / (1 << SPECTRAL_SQUARINGS));
    }
}
