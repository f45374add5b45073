/* The multipliers of a closed chain of maps, later ones times earlier ones; see stability/closed_maps.py, whose steps
   these are.

   Matrices are small, row by row. K maps M_k, (K, n, n), from one place to the next, the last back to the first. */

#include <float.h>
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

/* Y in the place of X with A Y = X, (n, columns), by elimination with exchanges in A; the sign of its determinant. */
double NAMED(divide)(int64_t n, int64_t columns, double *A, double *X)
{
    double sign = 1.0;
    for (int64_t k = 0; k < n; k++) {
        int64_t best = k;
        for (int64_t i = k + 1; i < n; i++)
            if (fabs(A[i * n + k]) > fabs(A[best * n + k]))
                best = i;
        if (best != k)
            sign = -sign;
        for (int64_t j = 0; best != k && j < n + columns; j++) {
            const int64_t width = j < n ? n : columns;
            double *one = j < n ? A + k * n + j : X + k * columns + j - n, *other = one + (best - k) * width;
            const double value = *one;
            *one = *other, *other = value;
        }
        if (A[k * (n + 1)] < 0.0)
            sign = -sign;
        for (int64_t i = k + 1; i < n; i++) {
            const double f = A[i * n + k] / A[k * (n + 1)];
            for (int64_t j = k + 1; j < n; j++)
                A[i * n + j] -= f * A[k * n + j];
            for (int64_t j = 0; j < columns; j++)
                X[i * columns + j] -= f * X[k * columns + j];
        }
    }
    for (int64_t k = n - 1; k >= 0; k--)
        for (int64_t j = 0; j < columns; j++) {
            for (int64_t i = k + 1; i < n; i++)
                X[k * columns + j] -= A[k * n + i] * X[i * columns + j];
            X[k * columns + j] /= A[k * (n + 1)];
        }
    return sign;
}

/* Later maps times earlier ones, and where wanted the inverse of that by those of the maps, each of norm 1 with the
   logarithm of its size. `memory` has two matrices. */
static void products(int64_t K, int64_t n, const double *maps, double *forward, double *inverse, double *logs,
                     double *memory)
{
    double *other = memory, *now = forward;
    identity(n, now);
    logs[0] = logs[1] = 0.0;
    for (int64_t k = 0; k < K; k++) {
        double *next = now == forward ? other : forward;
        times(n, next, maps + k * n * n, now);
        scale(n, next, logs, k == K - 1);
        now = next;
    }
    if (now != forward)
        memcpy(forward, now, (size_t)(n * n) * sizeof(double));
    if (!inverse)
        return;
    identity(n, inverse);
    for (int64_t k = K - 1; k >= 0; k--) {
        memcpy(memory, maps + k * n * n, (size_t)(n * n) * sizeof(double));
        NAMED(divide)(n, n, memory, inverse);
        scale(n, inverse, logs + 1, k == 0);
    }
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
static void turned(int64_t K, int64_t n, int64_t v, int64_t r, const double *maps, const double *vectors, double *right,
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
    double *here = half + area, *positive = here + area;
    for (int64_t k = 0; k < K; k++) {
        const double *Q = frames + k * area, *after = frames + (k + 1) % K * area, *M = maps + k * area;
        times(n, half, M, Q);
        for (int64_t i = 0; i < n; i++)
            for (int64_t j = 0; j < n; j++) {
                double sum = 0.0;
                for (int64_t a = 0; a < n; a++)
                    sum += after[a * n + i] * half[a * n + j];
                here[i * n + j] = sum;
            }
        for (int64_t i = 0; i < r; i++)
            for (int64_t j = 0; j < r; j++)
                right[(k * r + i) * r + j] = here[i * n + j];
        for (int64_t i = r; i < v; i++)
            for (int64_t j = r; j < v; j++)
                left[(k * (v - r) + i - r) * (v - r) + j - r] = here[i * n + j];
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
                across[(k * m + i - v) * m + j - v] = here[i * n + j];
            }
    }
}

/* Sums over all maps of |x| sizes |y|: of each row x of `left` times the maps after and column y of `right` times those
   before, (n), and of all rows and columns of 1, in `whole`; vectors are complex, (2, n, n). `memory` has (K + 8) n^2
   numbers. */
static void moved(int64_t K, int64_t n, const double *maps, const double *sizes, const double *left, const double *right,
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
}

/* The orthogonal matrix at the end of all maps, in the place of that at their start, and triangular factors (K, n, n). */
static void triangular(int64_t K, int64_t n, const double *maps, double *frame, double *factors)
{
    for (int64_t k = 0; k < K; k++) {
        times(n, factors + k * n * n, maps + k * n * n, frame);
        orthogonal(n, n, factors + k * n * n, frame);
    }
}

/* Eigenvalues by their logarithms ---------------------------------------------------------------------------------- */

enum { SUBSPACE_ROUNDS = 60, MOST_STATES = 16 }; /* these and others as in closed_maps.py */
static const double SMALL_LOG = -0.6931471805599453; /* of SMALL_MODULUS, 1/2 */
static const double EXTREME_LOG_CONDITION = 32.23619130191664, LOG_MODULUS_SPREAD = 9.210340371976184;
static const double CONVERGED_LOG_GAIN = 40.0, OPEN_FRAME = 1e-8, LARGEST_LOGARITHM = 709.782712893384;
static const double SLOWEST_MOTION_RATIO = 1e-6, COUPLED_ENTRY_RATIO = 1e-8;
static const double MAP_ENTRY_ROUNDING = 64.0, BACKWARD_ERROR_UNITS = 4.0;

/* exp(log) times a phase (re, im) of modulus 1. */
typedef struct {
    double log, re, im;
} eigenvalue;

/* Those in descending modulus, and `order` of where they were, if there is one. */
static void sort(int64_t n, eigenvalue *values, int64_t *order)
{
    for (int64_t i = 0; order && i < n; i++)
        order[i] = i;
    for (int64_t i = 1; i < n; i++)
        for (int64_t j = i; j > 0 && values[j - 1].log < values[j].log; j--) {
            const eigenvalue value = values[j];
            values[j] = values[j - 1], values[j - 1] = value;
            if (order) {
                const int64_t place = order[j];
                order[j] = order[j - 1], order[j - 1] = place;
            }
        }
}

/* Those of exp(size) A, which is lost, and right vectors and their order where wanted; 1 where they are not found.
   `memory` has n^2 + 8 n numbers. */
static int eigenvalues_of(int64_t n, double *A, double size, eigenvalue *values, double *vectors, int64_t *order,
                          double *memory)
{
    double *re = memory, *im = re + n;
    if (NAMED(eigenvalues)(n, A, re, im, vectors, im + n))
        return 1;
    for (int64_t i = 0; i < n; i++) {
        const double modulus = hypot(re[i], im[i]);
        values[i] = modulus > 0.0 ? (eigenvalue){log(modulus) + size, re[i] / modulus, im[i] / modulus}
                                  : (eigenvalue){-INFINITY, 1.0, 0.0};
    }
    sort(n, values, order);
    return 0;
}

static double modulus_of(eigenvalue value) { return exp(fmin(value.log, LARGEST_LOGARITHM)); }

static double distance_to_one(eigenvalue value)
{
    const double modulus = modulus_of(value);
    return hypot(modulus * value.re - 1.0, modulus * value.im);
}

/* Mark the `count` values that are nearest to 1. */
static void mark_near(int64_t n, const eigenvalue *values, int64_t count, int8_t *is_near)
{
    memset(is_near, 0, (size_t)n);
    for (; count > 0; count--) {
        int64_t nearest = -1;
        for (int64_t i = 0; i < n; i++)
            if (!is_near[i] && (nearest < 0 || distance_to_one(values[i]) < distance_to_one(values[nearest])))
                nearest = i;
        if (nearest >= 0)
            is_near[nearest] = 1;
    }
}

/* By blocks of triangular factors, from a frame made of the first rows and columns of a matrix in general position,
   (across, across); 1 where a factor is singular. `memory` has (K + 8) n^2 + 12 n numbers. */
static int by_schur(int64_t K, int64_t n, const double *maps, int64_t across, const double *general, eigenvalue *values,
                    double *memory)
{
    const int64_t area = n * n;
    double *factors = memory, *start = factors + K * area, *frame = start + area, *logs = frame + area;
    double *block = logs + n, *product = block + area, *other = product + area, *room = other + area;
    int64_t edges[MOST_STATES + 1], count = 0;
    for (int64_t i = 0; i < n; i++)
        memcpy(start + i * n, general + i * across, (size_t)n * sizeof(double));
    orthogonal(n, n, start, frame);
    for (int64_t turn = 1, narrow = 0; turn <= SUBSPACE_ROUNDS && !narrow; turn++) {
        memcpy(start, frame, (size_t)area * sizeof(double));
        triangular(K, n, maps, frame, factors);
        for (int64_t i = 0; i < n; i++) {
            logs[i] = 0.0;
            for (int64_t k = 0; k < K; k++) {
                const double diagonal = fabs(factors[k * area + i * (n + 1)]);
                if (!(diagonal > 0.0))
                    return 1;
                logs[i] += log(diagonal);
            }
        }
        count = 0, edges[0] = 0, narrow = 1;
        for (int64_t i = 1; i <= n; i++) {
            double open_at = 0.0; /* the largest product of vectors on both sides of this edge */
            for (int64_t row = i; row < n; row++)
                for (int64_t column = 0; column < i; column++) {
                    double sum = 0.0;
                    for (int64_t j = 0; j < n; j++)
                        sum += start[j * n + row] * frame[j * n + column];
                    open_at = fmax(open_at, fabs(sum));
                }
            if (i < n && !((double)(turn - 1) * (logs[i - 1] - logs[i]) > CONVERGED_LOG_GAIN && open_at <= OPEN_FRAME))
                continue;
            narrow = narrow && fabs(logs[edges[count]] - logs[i - 1]) <= LOG_MODULUS_SPREAD;
            edges[++count] = i;
        }
    }
    for (int64_t e = 0; e < count; e++) {
        const int64_t a = edges[e], w = edges[e + 1] - a;
        double size = 0.0, *now = product, *next = other;
        identity(w, now);
        for (int64_t k = 0; k < K; k++) {
            for (int64_t i = 0; i < w; i++)
                memcpy(block + i * w, factors + k * area + (a + i) * n + a, (size_t)w * sizeof(double));
            times(w, next, block, now);
            scale(w, next, &size, k == K - 1);
            double *swap = now;
            now = next, next = swap;
        }
        for (int64_t i = 0; i < w; i++)
            for (int64_t j = 0; j < w; j++) {
                block[i * w + j] = 0.0;
                for (int64_t row = 0; row < n; row++)
                    block[i * w + j] += start[row * n + a + i] * frame[row * n + a + j];
            }
        times(w, next, block, now);
        if (eigenvalues_of(w, next, size, values + a, NULL, NULL, room))
            return 1;
    }
    sort(n, values, NULL);
    return 0;
}

/* The inverse of a complex matrix, parts (2, n, n), which is lost; infinite where it is singular. */
static void invert(int64_t n, double *re, double *inverse)
{
    double *im = re + n * n, *x = inverse, *y = x + n * n;
    identity(n, x);
    memset(y, 0, (size_t)(n * n) * sizeof(double));
    for (int64_t k = 0; k < n; k++) {
        int64_t best = k;
        for (int64_t i = k + 1; i < n; i++)
            if (hypot(re[i * n + k], im[i * n + k]) > hypot(re[best * n + k], im[best * n + k]))
                best = i;
        for (int64_t j = 0; best != k && j < n; j++)
            for (double *part = re; part; part = part == re ? im : part == im ? x : part == x ? y : NULL) {
                const double other = part[k * n + j];
                part[k * n + j] = part[best * n + j], part[best * n + j] = other;
            }
        const double a = re[k * n + k], b = im[k * n + k], square = a * a + b * b;
        for (int64_t i = 0; i < n; i++) {
            if (i == k)
                continue;
            const double p = re[i * n + k], q = im[i * n + k];
            const double f = (p * a + q * b) / square, g = (q * a - p * b) / square;
            for (int64_t j = 0; j < n; j++) {
                double *row = re + i * n + j, *other = re + k * n + j, *turn = im + i * n + j, *of = im + k * n + j;
                *row -= f * *other - g * *of, *turn -= f * *of + g * *other;
                row = x + i * n + j, other = x + k * n + j, turn = y + i * n + j, of = y + k * n + j;
                *row -= f * *other - g * *of, *turn -= f * *of + g * *other;
            }
        }
    }
    for (int64_t k = 0; k < n; k++) {
        const double a = re[k * n + k], b = im[k * n + k], square = a * a + b * b;
        for (int64_t j = 0; j < n; j++) {
            const double p = x[k * n + j], q = y[k * n + j];
            x[k * n + j] = square > 0.0 ? (p * a + q * b) / square : INFINITY;
            y[k * n + j] = square > 0.0 ? (q * a - p * b) / square : INFINITY;
        }
    }
}

/* What rounding makes of each eigenvalue, at first order, or of a pair that nearly meets: from the right vectors, whose
   columns are in `order`, of the product of size exp(size). `memory` has (K + 16) n^2 + n + 1 numbers. */
static void rounding_of(int64_t K, int64_t n, const double *maps, const double *sizes, const double *vectors,
                        const int64_t *order, double size, const eigenvalue *values, double *rounding, double *memory)
{
    const int64_t area = n * n;
    double *right = memory, *left = right + 2 * area, *lost = left + 2 * area, *sums = lost + 2 * area;
    for (int64_t part = 0; part < 2; part++)
        for (int64_t i = 0; i < n; i++)
            for (int64_t j = 0; j < n; j++)
                right[part * area + i * n + j] = vectors[part * area + i * n + order[j]];
    memcpy(lost, right, (size_t)(2 * area) * sizeof(double));
    invert(n, lost, left);
    moved(K, n, maps, sizes, left, right, sums, sums + n, sums + n + 1);
    const double bound = sqrt(MAP_ENTRY_ROUNDING * DBL_EPSILON * sums[n]);
    for (int64_t i = 0; i < n; i++) {
        const double row = hypot(size_of(n, left + i * n), size_of(n, left + area + i * n));
        const double by_maps = MAP_ENTRY_ROUNDING * sums[i] + BACKWARD_ERROR_UNITS * row * exp(size);
        const double own = DBL_EPSILON * modulus_of(values[i]), by = DBL_EPSILON * by_maps;
        rounding[i] = fmin(by < own ? own : by, bound); /* a number where the other is none */
    }
}

/* Eigenvalues of a product of maps with entries of terms of these sizes, and what rounding makes of them if wanted. Returns
   1 where they come from a periodic Schur form, else 0, or -1 where they do not converge. `memory` has (K + 28) n^2 + 20 n numbers. */
static int spectrum_of(int64_t K, int64_t n, const double *maps, const double *sizes, int64_t across,
                       const double *general, eigenvalue *values, double *rounding, double *memory)
{
    const int64_t area = n * n;
    double *forward = memory, *inverse = forward + area, *vectors = inverse + area, *room = vectors + 2 * area, logs[2];
    int64_t order[MOST_STATES];
    eigenvalue backward[MOST_STATES];
    products(K, n, maps, forward, inverse, logs, room);
    const double range = logs[0] + logs[1] + 0.0 * largest(inverse, area); /* NaN where a map is singular */
    int failed = eigenvalues_of(n, forward, logs[0], values, rounding ? vectors : NULL, order, room), extreme = 0;
    if (K > 1 && range <= EXTREME_LOG_CONDITION && !failed) {
        failed = eigenvalues_of(n, inverse, logs[1], backward, NULL, NULL, room);
        for (int64_t i = 0; i < n && !failed; i++) { /* each from that which has more of its digits */
            const eigenvalue other = backward[n - 1 - i];
            const int one = n == 1 || 0.5 * (values[i].log - other.log) < 0.5 * (logs[0] - logs[1]);
            if (values[i].log < SMALL_LOG && one)
                values[i] = (eigenvalue){-other.log, other.re, -other.im};
        }
    } else if (K > 1) {
        extreme = 1;
        eigenvalue found[MOST_STATES];
        if (!by_schur(K, n, maps, across, general, found, room))
            memcpy(values, found, (size_t)n * sizeof(eigenvalue)), failed = 0;
    }
    if (failed)
        return -1;
    for (int64_t i = 0; rounding && i < n; i++)
        rounding[i] = MAP_ENTRY_ROUNDING * DBL_EPSILON * (double)K * modulus_of(values[i]);
    if (rounding && !extreme)
        rounding_of(K, n, maps, sizes, vectors, order, logs[0], values, rounding, room);
    return extreme;
}

/* Multipliers of a chain, those that are 1 for every orbit first ---------------------------------------------------- */

/* `vectors`, (K, v, n), of length 1 at the places where the first r and the others are not too small, or too nearly
   dependent, for their directions; how many places, which go to `places`. `memory` has K + n^2 numbers. */
static int64_t well_directed(int64_t K, int64_t n, int64_t v, int64_t r, double *vectors, int64_t *places,
                             double *memory)
{
    int64_t count = 0;
    double *least = memory, *room = least + 2 * K, most[2] = {0.0, 0.0}, none;
    for (int64_t k = 0; k < K; k++)
        for (int part = 0; part < 2; part++) {
            const int64_t rows = part ? v - r : r;
            memcpy(room, vectors + (k * v + part * r) * n, (size_t)(rows * n) * sizeof(double));
            NAMED(singular_values)(rows, n, room, least + 2 * k + part, &none);
            most[part] = fmax(most[part], least[2 * k + part]);
        }
    for (int64_t k = 0; k < K; k++) {
        if ((r && !(least[2 * k] > SLOWEST_MOTION_RATIO * most[0])) ||
            (v > r && !(least[2 * k + 1] > SLOWEST_MOTION_RATIO * most[1])))
            continue;
        for (int64_t i = 0; i < v; i++) {
            const double *from = vectors + (k * v + i) * n, size = size_of(n, from);
            for (int64_t j = 0; j < n; j++)
                vectors[(count * v + i) * n + j] = from[j] / size;
        }
        places[count++] = k;
    }
    return count;
}

/* Maps from one of these places to the next, in the place of `maps`, by way of `joined`, (count, n, n). */
static void join(int64_t K, int64_t n, int64_t count, const int64_t *places, double *maps, double *joined, double *room)
{
    const int64_t area = n * n;
    for (int64_t p = 0; p < count; p++) {
        const int64_t last = p + 1 < count ? places[p + 1] : places[0] + K;
        double *to = joined + p * area;
        memcpy(to, maps + places[p] * area, (size_t)area * sizeof(double));
        for (int64_t k = places[p] + 1; k < last; k++) {
            times(n, room, maps + k % K * area, to);
            memcpy(to, room, (size_t)area * sizeof(double));
        }
    }
    memcpy(maps, joined, (size_t)(count * area) * sizeof(double));
}

/* Units, from given ones, in which no entry of a matrix is large by its units; gives its norm in these. */
static double balanced_units(int64_t n, const double *matrix, const double *given, double *units)
{
    double scaled[MOST_STATES * MOST_STATES], sizes[MOST_STATES * MOST_STATES], diagonal = 0.0, least, norm;
    for (int64_t i = 0; i < n; i++)
        for (int64_t j = 0; j < n; j++)
            scaled[i * n + j] = matrix[i * n + j] * given[j] / given[i];
    for (int64_t i = 0; i < n; i++)
        diagonal = fmax(diagonal, fabs(scaled[i * (n + 1)]));
    for (int64_t i = 0; i < n * n; i++)
        sizes[i] = fabs(scaled[i]) + COUPLED_ENTRY_RATIO * (diagonal > 0.0 ? diagonal : 1.0);
    NAMED(balancing)(n, sizes, units);
    for (int64_t i = 0; i < n; i++)
        for (int64_t j = 0; j < n; j++)
            scaled[i * n + j] *= units[j] / units[i];
    NAMED(singular_values)(n, n, scaled, &least, &norm);
    for (int64_t i = 0; i < n; i++)
        units[i] *= given[i];
    return norm;
}

/* Of n a single one that is tiny, or huge where none is tiny, from the logarithm and the sign of their product: where there
   is but one, that tells whether it is. What rounding makes of it is relative then, where that of the product of K maps is
   as large as it is. */
static void by_liouville(int64_t n, eigenvalue *values, double contraction, double sign, int64_t K, double *rounding)
{
    int64_t small = 0, large = 0;
    double re = sign, im = 0.0, relative = MAP_ENTRY_ROUNDING * DBL_EPSILON * (double)K;
    for (int64_t i = 0; i < n; i++) {
        const double log = n == 1 ? contraction : values[i].log;
        small += log < SMALL_LOG, large += log > -SMALL_LOG;
    }
    const int64_t index = small == 1 ? n - 1 : large == 1 && !small ? 0 : -1;
    if (index < 0)
        return;
    for (int64_t i = 0; i < n; i++)
        if (i != index) {
            const double other = re * values[i].re - im * values[i].im;
            im = re * values[i].im + im * values[i].re, re = other;
            contraction -= values[i].log, relative += rounding[i] / fmax(modulus_of(values[i]), DBL_MIN);
        }
    values[index] = (eigenvalue){contraction, re < 0.0 ? -1.0 : 1.0, 0.0};
    const double modulus = fmax(modulus_of(values[index]), DBL_MIN);
    if (rounding[index] > modulus)
        rounding[index] = relative * modulus;
}

/* Multipliers of K maps of n states, n at most 16, the trivial ones first. Of `trivial` ones r directions and l gradients,
   (any, r, n) and (any, l, n) at the K places and more, are known. `general` is an orthogonal matrix in general position,
   `contraction` the logarithm of the determinant, NaN where it is not known, and `sign` its sign, which maps that shrink
   all but one direction by ten powers have lost.

   `found` takes (n) logarithms, real and imaginary parts of phases, what rounding makes of those that are not trivial if
   that is `wanted`; the product of all maps, (n, n); and how many are trivial, the logarithm of the product's size, its
   norm in balanced units, and whether a periodic Schur form was needed. `memory` has (8 K + 40) n^2 + 20 n + 4 K numbers.
   Returns 1 where eigenvalues do not converge. */
KERNEL(multipliers)(int64_t K, int64_t n, int64_t r, int64_t l, int64_t trivial, double contraction, double sign,
                    int64_t wanted, const double *maps, const double *right, const double *left, const double *units,
                    const double *general, double *found, double *memory)
{
    const int64_t v = r + l, area = n * n;
    double *rounding = found + 3 * n, *matrix = rounding + n, *numbers = matrix + area;
    double *M = memory, *vectors = M + K * area, *blocks = vectors + K * area, *beside = blocks + K * area;
    double *across = beside + K * area, *sizes = across + K * area, *room = sizes + K * area, logs[3];
    double lost[MOST_STATES * MOST_STATES], scales[MOST_STATES], by[MOST_STATES];
    int64_t *places = (int64_t *)(room + (2 * K + 36) * area + 20 * n + 2 * K);
    eigenvalue across_all[MOST_STATES], all[MOST_STATES];
    int64_t count = 0, known = 0;
    products(K, n, maps, matrix, NULL, logs, room);

    const double norm = balanced_units(n, matrix, units, scales);
    for (int64_t k = 0; k < K; k++) {
        for (int64_t i = 0; i < n; i++)
            for (int64_t j = 0; j < n; j++)
                M[k * area + i * n + j] = maps[k * area + i * n + j] * (scales[j] / scales[i]);
        for (int64_t i = 0; i < v; i++)
            for (int64_t j = 0; j < n; j++)
                vectors[(k * v + i) * n + j] =
                    i < r ? right[(k * r + i) * n + j] / scales[j] : left[(k * l + i - r) * n + j] * scales[j];
    }

    /* what the vectors take out, and across that */
    if (v)
        count = well_directed(K, n, v, r, vectors, places, room);
    const int directed = count > 0;
    if (directed) {
        if (count < K)
            join(K, n, count, places, M, across, room);
        turned(count, n, v, r, M, vectors, blocks, beside, across, sizes, room);
        for (int part = 0; part < 2; part++) {
            const int64_t size = part ? l : r;
            products(count, size, part ? beside : blocks, lost, NULL, logs + 1, room);
            if (size && eigenvalues_of(size, lost, logs[1], all + known, NULL, NULL, room))
                return 1;
            known += size;
        }
    } else { /* no directions: all of it */
        count = K;
        memcpy(across, M, (size_t)(K * area) * sizeof(double));
        for (int64_t i = 0; i < K * area; i++)
            sizes[i] = fabs(M[i]);
    }
    const int64_t size = n - known;
    int extreme = 0;
    if (size)
        extreme = spectrum_of(count, size, across, sizes, n, general, across_all, wanted ? by : NULL, room);
    if (extreme < 0)
        return 1;

    int8_t is_near[MOST_STATES];
    double by_near = 0.0; /* the logarithm of the product of trivial ones, 0 where vectors tell */
    mark_near(size, across_all, trivial - known, is_near);
    for (int64_t i = 0; i < size; i++)
        if (is_near[i]) {
            by_near += directed ? 0.0 : across_all[i].log;
            all[known++] = across_all[i];
        }
    const int64_t first = known;
    for (int64_t i = 0; i < size; i++)
        if (!is_near[i]) {
            rounding[known - first] = wanted ? by[i] : 0.0;
            all[known++] = across_all[i];
        }

    if (!isnan(contraction))
        by_liouville(n - first, all + first, contraction - by_near, sign, K, rounding);
    for (int64_t i = 0; i < n; i++)
        found[i] = all[i].log, found[n + i] = all[i].re, found[2 * n + i] = all[i].im;
    numbers[0] = (double)first, numbers[1] = logs[0], numbers[3] = extreme;
    numbers[2] = fmax(1.0, norm * exp(fmin(logs[0], 700.0)));
    return 0;
}
