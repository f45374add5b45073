/* Products of maps, and the multipliers of a closed chain of them; see stability/closed_maps.py.

   Matrices are small, row by row. */

#include <math.h>
#include <string.h>

#include "kernel.h"

static inline void times(int64_t n, double *restrict x, const double *restrict A, const double *restrict y)
{
    for (int64_t i = 0; i < n; i++) {
        for (int64_t j = 0; j < n; j++)
            x[i * n + j] = A[i * n] * y[j];
        for (int64_t k = 1; k < n; k++)
            for (int64_t j = 0; j < n; j++)
                x[i * n + j] += A[i * n + k] * y[k * n + j];
    }
}

static double size_of(int64_t count, const double *x)
{
    double sum = 0.0;
    for (int64_t i = 0; i < count; i++)
        sum += x[i] * x[i];
    return sqrt(sum);
}

static void identity(int64_t n, double *x)
{
    memset(x, 0, (size_t)(n * n) * sizeof(double));
    for (int64_t i = 0; i < n; i++)
        x[i * (n + 1)] = 1.0;
}

/* x in units of its norm, whose logarithm is added where it is far from 1 or `now`. */
static void scale(int64_t n, double *x, double *log_size, int now)
{
    const double size = size_of(n * n, x);
    if (size > 0.0 && (now || !(1e-60 < size && size < 1e60))) {
        *log_size += log(size);
        for (int64_t i = 0; i < n * n; i++)
            x[i] /= size;
    }
}

/* Y in the place of X with A Y = X, (n, n), by elimination with exchanges in A; the sign of its determinant. */
static double divide(int64_t n, double *A, double *X)
{
    double sign = 1.0;
    for (int64_t k = 0; k < n; k++) {
        int64_t best = k;
        for (int64_t i = k + 1; i < n; i++)
            if (fabs(A[i * n + k]) > fabs(A[best * n + k]))
                best = i;
        if (best != k) {
            sign = -sign;
            for (int64_t j = 0; j < n; j++) {
                double a = A[k * n + j], x = X[k * n + j];
                A[k * n + j] = A[best * n + j], A[best * n + j] = a;
                X[k * n + j] = X[best * n + j], X[best * n + j] = x;
            }
        }
        if (A[k * (n + 1)] < 0.0)
            sign = -sign;
        for (int64_t i = k + 1; i < n; i++) {
            const double f = A[i * n + k] / A[k * (n + 1)];
            for (int64_t j = k + 1; j < n; j++)
                A[i * n + j] -= f * A[k * n + j];
            for (int64_t j = 0; j < n; j++)
                X[i * n + j] -= f * X[k * n + j];
        }
    }
    for (int64_t k = n - 1; k >= 0; k--)
        for (int64_t j = 0; j < n; j++) {
            for (int64_t i = k + 1; i < n; i++)
                X[k * n + j] -= A[k * n + i] * X[i * n + j];
            X[k * n + j] /= A[k * (n + 1)];
        }
    return sign;
}

/* Later maps times earlier ones, and where wanted the inverse of that by those of the maps, each of norm 1 with the
   logarithm of its size; then the sign of the determinant. `memory` has two matrices. */
KERNEL(products)(int64_t K, int64_t n, const double *maps, double *forward, double *inverse, double *logs,
                 double *memory)
{
    double *other = memory, *now = forward;
    identity(n, now);
    logs[0] = logs[1] = 0.0, logs[2] = 1.0;
    for (int64_t k = 0; k < K; k++) {
        double *next = now == forward ? other : forward;
        times(n, next, maps + k * n * n, now);
        scale(n, next, logs, k == K - 1);
        now = next;
    }
    if (now != forward)
        memcpy(forward, now, (size_t)(n * n) * sizeof(double));
    if (!inverse)
        return 0;
    identity(n, inverse);
    for (int64_t k = K - 1; k >= 0; k--) {
        memcpy(memory, maps + k * n * n, (size_t)(n * n) * sizeof(double));
        logs[2] *= divide(n, memory, inverse);
        scale(n, inverse, logs + 1, k == 0);
    }
    return 0;
}

/* An orthogonal matrix Q whose first columns span the columns of V, (n, v), which becomes triangular, by reflections. */
static void orthogonal(int64_t n, int64_t v, double *V, double *Q)
{
    identity(n, Q);
    for (int64_t k = 0; k < v && k < n - 1; k++) {
        double square = 0.0, head;
        for (int64_t i = k; i < n; i++)
            square += V[i * v + k] * V[i * v + k];
        if (!(square > 0.0))
            continue;
        head = V[k * v + k] + copysign(sqrt(square), V[k * v + k]);
        const double twice = 2.0 / (square - V[k * v + k] * V[k * v + k] + head * head);
        const double diagonal = -copysign(sqrt(square), V[k * v + k]);
        V[k * v + k] = head;
        for (int64_t j = k + 1; j < v; j++) {
            double along = 0.0;
            for (int64_t i = k; i < n; i++)
                along += V[i * v + k] * V[i * v + j];
            for (int64_t i = k; i < n; i++)
                V[i * v + j] -= twice * along * V[i * v + k];
        }
        for (int64_t i = 0; i < n; i++) {
            double along = 0.0;
            for (int64_t j = k; j < n; j++)
                along += Q[i * n + j] * V[j * v + k];
            for (int64_t j = k; j < n; j++)
                Q[i * n + j] -= twice * along * V[j * v + k];
        }
        V[k * v + k] = diagonal;
        for (int64_t i = k + 1; i < n; i++)
            V[i * v + k] = 0.0;
    }
}

/* Maps in frames whose first columns span vectors at their ends, (K, v, n), that at the last end is the first: of the
   first r of these to themselves (K, r, r), of the others (K, v - r, v - r), and across all of them (K, m, m) with the
   sizes of its entries' terms. `memory` has 2 (K + 2) n^2 numbers. */
KERNEL(turned)(int64_t K, int64_t n, int64_t v, int64_t r, const double *maps, const double *vectors, double *right,
               double *left, double *across, double *sizes, double *memory)
{
    const int64_t m = n - v, area = n * n;
    double *frames = memory, *frames_of_sizes = frames + K * area, *half = frames_of_sizes + K * area;
    for (int64_t k = 0; k < K; k++) {
        double *V = half, *Q = frames + k * area;
        for (int64_t i = 0; i < n; i++)
            for (int64_t j = 0; j < v; j++)
                V[i * v + j] = vectors[(k * v + j) * n + i];
        orthogonal(n, v, V, Q);
        for (int64_t i = 0; i < area; i++)
            frames_of_sizes[k * area + i] = fabs(Q[i]);
    }
    double *turned = half + area, *positive = turned + area;
    for (int64_t k = 0; k < K; k++) {
        const double *Q = frames + k * area, *after = frames + (k + 1) % K * area, *M = maps + k * area;
        times(n, half, M, Q);
        for (int64_t i = 0; i < n; i++)
            for (int64_t j = 0; j < n; j++) {
                double sum = 0.0;
                for (int64_t a = 0; a < n; a++)
                    sum += after[a * n + i] * half[a * n + j];
                turned[i * n + j] = sum;
            }
        for (int64_t i = 0; i < r; i++)
            for (int64_t j = 0; j < r; j++)
                right[(k * r + i) * r + j] = turned[i * n + j];
        for (int64_t i = r; i < v; i++)
            for (int64_t j = r; j < v; j++)
                left[(k * (v - r) + i - r) * (v - r) + j - r] = turned[i * n + j];
        for (int64_t i = 0; i < area; i++)
            positive[i] = fabs(M[i]);
        times(n, half, positive, frames_of_sizes + k * area);
        after = frames_of_sizes + (k + 1) % K * area;
        for (int64_t i = v; i < n; i++)
            for (int64_t j = v; j < n; j++) {
                double sum = 0.0;
                for (int64_t a = 0; a < n; a++)
                    sum += after[a * n + i] * half[a * n + j];
                sizes[(k * m + i - v) * m + j - v] = sum;
                across[(k * m + i - v) * m + j - v] = turned[i * n + j];
            }
    }
    return 0;
}

/* Sums over all maps of |x| sizes |y|: of each row x of `left` times the maps after and column y of `right` times those
   before, (n), and of all rows and columns of 1, in `whole`; vectors are complex, (2, n, n). `memory` has (K + 8) n^2
   numbers. */
KERNEL(moved)(int64_t K, int64_t n, const double *maps, const double *sizes, const double *left, const double *right,
              double *sums, double *whole, double *memory)
{
    const int64_t area = n * n;
    double *there = memory, *back = there + K * area, *other = back + area, *x = other + area, *y = x + 2 * area;
    double *z = y + 2 * area;
    identity(n, there);
    for (int64_t k = 0; k < K - 1; k++)
        times(n, there + (k + 1) * area, maps + k * area, there + k * area);
    identity(n, back);
    memset(sums, 0, (size_t)n * sizeof(double));
    *whole = 0.0;
    for (int64_t k = K - 1; k >= 0; k--) {
        for (int64_t part = 0; part < 2; part++) {
            times(n, x + part * area, left + part * area, back);
            times(n, y + part * area, there + k * area, right + part * area);
        }
        for (int64_t i = 0; i < area; i++) {
            x[i] = sqrt(x[i] * x[i] + x[area + i] * x[area + i]);
            y[i] = sqrt(y[i] * y[i] + y[area + i] * y[area + i]);
            x[area + i] = fabs(back[i]), y[area + i] = fabs(there[k * area + i]);
        }
        times(n, z, x, sizes + k * area);
        for (int64_t i = 0; i < n; i++)
            for (int64_t j = 0; j < n; j++)
                sums[i] += z[i * n + j] * y[j * n + i];
        times(n, z, x + area, sizes + k * area);
        times(n, x, z, y + area);
        for (int64_t i = 0; i < area; i++)
            *whole += x[i];
        times(n, other, back, maps + k * area);
        memcpy(back, other, (size_t)area * sizeof(double));
    }
    return 0;
}

/* The orthogonal matrix at the end of all maps, in the place of that at their start, and triangular factors (K, n, n). */
KERNEL(triangular)(int64_t K, int64_t n, const double *maps, double *frame, double *factors)
{
    for (int64_t k = 0; k < K; k++) {
        times(n, factors + k * n * n, maps + k * n * n, frame);
        orthogonal(n, n, factors + k * n * n, frame);
    }
    return 0;
}
