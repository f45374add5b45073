/* Matrices on intervals between right and left bases of blocks of their eigenvalues. Numbers are real or complex: these
   are kept as two arrays, real and imaginary parts. */

#include <math.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include "matrices.h"

#define EXPORTED __attribute__((visibility("default")))

/* Matrices (size, width) of real and imaginary parts at one node: right and left bases, both by columns, images of
   these, and the block products (count, width). `inner` holds them times one another. */
typedef struct {
    int64_t size, count, width, parts;
    double *right[2], *left[2], *image[2], *inner[2];
} node;

/* result (rows, width) = A B of numbers in `parts` arrays; A may have one, a real one. */
static void multiply(const node *at, int64_t rows, const double *real, const double *imaginary, int64_t down,
                     int64_t across, double *const B[2], double *const result[2])
{
    for (int64_t i = 0; i < at->parts; i++) {
        memset(result[i], 0, (size_t)(rows * at->width) * sizeof(double));
        add_product(rows, at->size, at->width, 1.0, real, down, across, B[i], result[i]);
        if (imaginary)
            add_product(rows, at->size, at->width, i ? 1.0 : -1.0, imaginary, down, across, B[1 - i], result[i]);
    }
}

/* inner (count, width) = A^T B of bases by columns. */
static void contract(const node *at, double *const A[2], double *const B[2])
{
    multiply(at, at->count, A[0], at->parts == 2 ? A[1] : NULL, 1, at->width, B, at->inner);
}

/* `count` numbers from `first` on, `stride` apart, divided by x + iy. */
static void divide(int64_t parts, double x, double y, int64_t count, int64_t stride, int64_t first, double *const to[2])
{
    const double real = x / (x * x + y * y), imaginary = -y / (x * x + y * y);
    for (int64_t b = 0; b < count; b++) {
        const int64_t k = first + b * stride;
        const double u = to[0][k];
        if (parts == 1)
            to[0][k] = u / x;
        else {
            const double v = to[1][k];
            to[0][k] = u * real - v * imaginary;
            to[1][k] = u * imaginary + v * real;
        }
    }
}

/* left (size, width): of the rows that it has, those combinations that give the identity within blocks with the right
   basis; `inner` holds the rows times the right basis. 0 where these are no numbers. */
static int normalise(node *at, const int64_t *places, const uint8_t *same)
{
    const int64_t count = at->count, width = at->width;
    for (int64_t a = 0; a < count; a++) {
        int idle = 1;
        for (int64_t b = 0; b < count; b++)
            for (int64_t i = 0; i < at->parts; i++) {
                double *entry = at->inner[i] + a * width + b;
                *entry = same[places[a] * at->size + places[b]] ? *entry : 0.0;
                idle &= *entry == 0.0;
                if (!isfinite(*entry))
                    return 0;
            }
        if (idle)
            at->inner[0][a * width + a] = 1.0;
    }
    for (int64_t k = 0; k < count; k++) {  /* elimination with the largest pivot; what is eliminated are columns of left */
        int64_t pivot = k;
        double largest = -1.0;
        for (int64_t a = k; a < count; a++) {
            const double x = at->inner[0][a * width + k], y = at->parts == 2 ? at->inner[1][a * width + k] : 0.0;
            if (x * x + y * y > largest) {
                largest = x * x + y * y;
                pivot = a;
            }
        }
        if (largest == 0.0)
            return 0;
        for (int64_t i = 0; i < at->parts && pivot != k; i++) {
            for (int64_t b = 0; b < count; b++) {
                const double kept = at->inner[i][k * width + b];
                at->inner[i][k * width + b] = at->inner[i][pivot * width + b];
                at->inner[i][pivot * width + b] = kept;
            }
            for (int64_t b = 0; b < at->size; b++) {
                const double kept = at->left[i][b * width + k];
                at->left[i][b * width + k] = at->left[i][b * width + pivot];
                at->left[i][b * width + pivot] = kept;
            }
        }
        const double x = at->inner[0][k * width + k], y = at->parts == 2 ? at->inner[1][k * width + k] : 0.0;
        divide(at->parts, x, y, at->size, width, k, at->left);
        divide(at->parts, x, y, count - k - 1, 1, k * width + k + 1, at->inner);
        for (int64_t a = 0; a < count; a++) {
            const double f = at->inner[0][a * width + k], g = at->parts == 2 ? at->inner[1][a * width + k] : 0.0;
            if (a == k || (f == 0.0 && g == 0.0))
                continue;
            for (int64_t b = k + 1; b < count; b++) {
                const double u = at->inner[0][k * width + b], v = at->parts == 2 ? at->inner[1][k * width + b] : 0.0;
                at->inner[0][a * width + b] -= f * u - g * v;
                if (at->parts == 2)
                    at->inner[1][a * width + b] -= f * v + g * u;
            }
            for (int64_t b = 0; b < at->size; b++) {
                const double u = at->left[0][b * width + k], v = at->parts == 2 ? at->left[1][b * width + k] : 0.0;
                at->left[0][b * width + a] -= f * u - g * v;
                if (at->parts == 2)
                    at->left[1][b * width + a] -= f * v + g * u;
            }
        }
    }
    return 1;
}

/* Bases at one node: right = vectors T, and left, of which rows are those of P right or, for `special` columns, those of
   others^T inverse, times what makes left right the identity within blocks. 0 where they are no numbers. */
static int make_bases(node *at, const double *P, const double *vectors, const double *inverse, const int64_t *places,
                      const uint8_t *same, const uint8_t *special, int64_t columns, const double *T,
                      int64_t others, const double *S, double *const turned[2])
{
    const int64_t m = at->size, width = at->width, parts = at->parts;
    for (int64_t i = 0; i < 2; i++)
        memset(at->image[i], 0, (size_t)(m * width) * sizeof(double));
    separate(parts, T, m, columns, width, at->image);
    separate(parts, vectors, m, m, m, turned);
    multiply(at, m, turned[0], parts == 2 ? turned[1] : NULL, m, 1, at->image, at->right);
    if (P)
        multiply(at, m, P, NULL, m, 1, at->right, at->left);
    for (int64_t k = 0, s = 0; k < at->count; k++) {
        if (!special[k])
            continue;
        for (int64_t b = 0; b < m; b++) {
            double x = 0.0, y = 0.0;
            for (int64_t a = 0; a < m; a++) {
                const double *one = S + (a * others + s) * parts, *other = inverse + (a * m + b) * parts;
                x += one[0] * other[0] - (parts == 2 ? one[1] * other[1] : 0.0);
                y += parts == 2 ? one[0] * other[1] + one[1] * other[0] : 0.0;
            }
            at->left[0][b * width + k] = x;
            if (parts == 2)
                at->left[1][b * width + k] = y;
        }
        s++;
    }
    contract(at, at->left, at->right);
    return normalise(at, places, same);
}

/* Multiply right bases and divide left ones by factors; raise the largest squares of their columns. */
static void scale(node *at, const double *factors, double *right, double *left)
{
    for (int64_t k = 0; k < at->count; k++) {
        double x = 0.0, y = 0.0;
        for (int64_t i = 0; i < at->parts; i++)
            for (int64_t b = 0; b < at->size; b++) {
                double *one = at->right[i] + b * at->width + k, *other = at->left[i] + b * at->width + k;
                *one *= factors[k];
                *other /= factors[k];
                x += *one * *one;
                y += *other * *other;
            }
        right[k] = x > right[k] ? x : right[k];
        left[k] = y > left[k] ? y : left[k];
    }
}

/* K between left and right bases, P between right ones, Q between left ones: (forms, size, size) of real matrices ->
   (forms, columns, columns). */
static void between_bases(node *at, int64_t forms, const double *matrices, int64_t columns, double *result)
{
    const int64_t square = at->size * at->size;
    for (int64_t f = 0; f < forms; f++) {
        double *const *outer = f == 1 ? at->right : at->left, *const *inner = f == 2 ? at->left : at->right;
        multiply(at, at->size, matrices + f * square, NULL, at->size, 1, inner, at->image);
        contract(at, outer, at->image);
        for (int64_t a = 0; a < at->count; a++)
            for (int64_t b = 0; b < at->count; b++)
                for (int64_t i = 0; i < at->parts; i++)
                    result[((f * columns + a) * columns + b) * at->parts + i] = at->inner[i][a * at->width + b];
    }
}

/* Matrices K, P and Q, or K alone, (any, nodes, forms, size, size), those of the intervals by `numbers`, and errors like
   them where there are any, on the `columns` whose invariant bases are T (intervals, nodes, size, columns), in coordinates that `vectors` and their
   `inverse` (intervals, size, size) change to. `places` (intervals, columns) are those of the columns, -1 behind them;
   those that are `special` have left bases of their own, S (intervals, nodes, size, others). Results are `values` and
   `changes` (intervals, nodes, forms, columns, columns), and the largest squares of right and left columns (intervals,
   2, columns); all zero before and where an interval is not `found`, before or here. 1 where there is no memory. */
EXPORTED int casadi_skin_forms(int64_t intervals, int64_t nodes, int64_t forms, int64_t size, int64_t parts,
                               const double *matrices, const double *errors, const int64_t *numbers,
                               const double *vectors, const double *inverse, const uint8_t *same, int64_t columns, const int64_t *places,
                               const uint8_t *special, const double *T, int64_t others, const double *S,
                               double *values, double *changes, double *squares, uint8_t *found)
{
    node at = {.size = size, .parts = parts, .width = (columns + LANES - 1) / LANES * LANES};
    const int64_t basis = size * at.width, each = 3 * basis + columns * at.width + size * size;
    const int64_t whole = forms * size * size, small = forms * columns * columns * parts;
    double *memory = calloc((size_t)(2 * each + columns), sizeof(double)), *turned[2], *factors = memory + 2 * each;
    if (!memory)
        return 1;
    for (int64_t i = 0; i < 2; i++) {
        at.right[i] = memory + i * each;
        at.left[i] = at.right[i] + basis;
        at.image[i] = at.left[i] + basis;
        at.inner[i] = at.image[i] + basis;
        turned[i] = at.inner[i] + columns * at.width;
    }
    for (int64_t n = 0; n < intervals; n++) {
        const int64_t *here = places + n * columns;
        double *longest = squares + 2 * n * columns;
        for (at.count = 0; at.count < columns && here[at.count] >= 0;)
            at.count++;
        for (int64_t j = 0; j < nodes && found[n]; j++) {  /* the middle first: there columns and rows get one length */
            const int64_t node_number = j == 0 ? nodes / 2 : j <= nodes / 2 ? j - 1 : j;
            const int64_t k = n * nodes + node_number, from = (numbers[n] * nodes + node_number) * whole;
            for (int64_t i = 0; i < parts; i++)
                memset(at.left[i], 0, (size_t)basis * sizeof(double));
            found[n] = (uint8_t)make_bases(&at, forms > 1 ? matrices + from + size * size : NULL,
                                           vectors + n * size * size * parts, inverse + n * size * size * parts, here,
                                           same + n * size * size, special + n * columns, columns,
                                           T + k * size * columns * parts, others, S + k * size * others * parts, turned);
            if (!found[n])
                break;
            for (int64_t a = 0; a < at.count && j == 0; a++) {
                double sum = 0.0;
                for (int64_t i = 0; i < parts; i++)
                    for (int64_t b = 0; b < size; b++)
                        sum += at.left[i][b * at.width + a] * at.left[i][b * at.width + a];
                factors[a] = sum > 0.0 ? sqrt(sqrt(sum)) : 1.0;
            }
            scale(&at, factors, longest, longest + columns);
            between_bases(&at, forms, matrices + from, columns, values + k * small);
            if (errors)
                between_bases(&at, forms, errors + from, columns, changes + k * small);
        }
        if (!found[n]) {
            memset(values + n * nodes * small, 0, (size_t)(nodes * small) * sizeof(double));
            memset(longest, 0, (size_t)(2 * columns) * sizeof(double));
            if (errors)
                memset(changes + n * nodes * small, 0, (size_t)(nodes * small) * sizeof(double));
        }
    }
    free(memory);
    return 0;
}
