/* Bases T that make matrices K block diagonal, K T = T L, at the nodes of intervals. Numbers are real or complex: these
   are kept as two arrays, real and imaginary parts. */

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "kernel.h"

enum { LANES = REGISTER > 4 ? REGISTER : 4, ROWS = 4 }; /* columns side by side, and rows that go together */
typedef double lanes __attribute__((vector_size(LANES * sizeof(double)), aligned(sizeof(double)), may_alias));

/* result (rows, width) += sign A B with A (rows, inner), its rows `down` numbers apart, and B (inner, width). */
static void add_product(int64_t rows, int64_t inner, int64_t width, double sign, const double *A, int64_t down,
                        const double *B, double *result)
{
    for (int64_t first = 0; first < rows; first += ROWS) {
        const double *row[ROWS];
        for (int64_t r = 0; r < ROWS; r++)
            row[r] = A + (first + r < rows ? first + r : rows - 1) * down;
        for (int64_t k = 0; k < width; k += LANES) {
            lanes sums[ROWS] = {{0.0}};
            for (int64_t b = 0; b < inner; b++) {
                const lanes here = *(const lanes *)(B + b * width + k);
                for (int64_t r = 0; r < ROWS; r++)
                    sums[r] += row[r][b] * here;
            }
            for (int64_t r = 0; r < ROWS && first + r < rows; r++)
                *(lanes *)(result + (first + r) * width + k) += sign * sums[r];
        }
    }
}

/* Numbers by rows, real and imaginary parts side by side, (rows, columns) -> (rows, width) each. */
static void separate(int64_t parts, const double *from, int64_t rows, int64_t columns, int64_t width,
                     double *const to[2])
{
    for (int64_t i = 0; i < parts; i++)
        for (int64_t a = 0; a < rows; a++)
            for (int64_t k = 0; k < columns; k++)
                to[i][a * width + k] = from[(a * columns + k) * parts + i];
}

/* One node: K (size, size); T, the product K T and weights (size, width), of which `count` columns are used; their
   blocks (count, width). Each has a real part and, of complex numbers, `parts` == 2, an imaginary one. `places` are
   those of the columns among the rows, `same` (size, size) whether two rows belong to one block. */
typedef struct {
    int64_t size, count, width, parts;
    const int64_t *places;
    const uint8_t *same;
    double *K[2], *T[2], *product[2], *weights[2], *block[2];
} node;

/* The same of real and imaginary parts. */
static void add_products(const node *at, int64_t inner, double sign, double *const A[2], int64_t stride,
                         double *const B[2], double *const result[2])
{
    add_product(at->size, inner, at->width, sign, A[0], stride, B[0], result[0]);
    if (at->parts == 2) {
        add_product(at->size, inner, at->width, -sign, A[1], stride, B[1], result[0]);
        add_product(at->size, inner, at->width, sign, A[0], stride, B[1], result[1]);
        add_product(at->size, inner, at->width, sign, A[1], stride, B[0], result[1]);
    }
}

/* 1 / (mu_k - mu_a) between blocks, 0 inside of them. */
static void weigh(const node *at)
{
    const int64_t n = at->size, down = n + 1;
    for (int64_t a = 0; a < n; a++)
        for (int64_t k = 0; k < at->count; k++) {
            const int64_t p = at->places[k];
            const double x = at->K[0][p * down] - at->K[0][a * down];
            const double y = at->parts == 2 ? at->K[1][p * down] - at->K[1][a * down] : 0.0;
            const int none = at->same[p * n + a] || (x == 0.0 && y == 0.0);
            if (at->parts == 1)
                at->weights[0][a * at->width + k] = none ? 0.0 : 1.0 / x;
            else {
                at->weights[0][a * at->width + k] = none ? 0.0 : x / (x * x + y * y);
                at->weights[1][a * at->width + k] = none ? 0.0 : -y / (x * x + y * y);
            }
        }
}

/* A step of Newton's method without couplings inside a block; the square of its largest entry, infinite where one is no
   number. */
static double improve(const node *at)
{
    const int64_t total = at->size * at->width;
    for (int64_t i = 0; i < at->parts; i++)
        memset(at->product[i], 0, (size_t)total * sizeof(double));
    add_products(at, at->size, 1.0, at->K, at->size, at->T, at->product);
    for (int64_t i = 0; i < at->parts; i++)
        for (int64_t j = 0; j < at->count; j++)
            for (int64_t k = 0; k < at->count; k++) {
                const int inside = at->same[at->places[j] * at->size + at->places[k]];
                at->block[i][j * at->width + k] = inside ? at->product[i][at->places[j] * at->width + k] : 0.0;
            }
    add_products(at, at->count, -1.0, at->T, at->width, at->block, at->product);
    double tops[LANES] = {0.0}, sums[LANES] = {0.0}, largest = 0.0, sum = 0.0;
    for (int64_t n = 0; n < total; n += LANES)
        for (int64_t l = n; l < n + LANES; l++) {
            double x = at->product[0][l] * at->weights[0][l], square = x * x;
            if (at->parts == 2) {
                const double y = at->product[0][l] * at->weights[1][l] + at->product[1][l] * at->weights[0][l];
                x -= at->product[1][l] * at->weights[1][l];
                at->T[1][l] += y;
                square = x * x + y * y;
            }
            at->T[0][l] += x;
            tops[l - n] = square > tops[l - n] ? square : tops[l - n];
            sums[l - n] += square;
        }
    for (int64_t l = 0; l < LANES; l++) {
        largest = tops[l] > largest ? tops[l] : largest;
        sum += sums[l];
    }
    return isnan(sum) ? INFINITY : largest;
}

/* Memory for a node, all of it zero; NULL where there is none. */
static double *reserve(node *at, int64_t columns)
{
    const int64_t squares = at->size * at->size, width = (columns + LANES - 1) / LANES * LANES;
    const int64_t each = squares + (3 * at->size + columns) * width;
    double *memory = calloc((size_t)(2 * each + 1), sizeof(double));
    at->width = width;
    for (int64_t i = 0; i < 2 && memory; i++) {
        at->K[i] = memory + i * each;
        at->T[i] = at->K[i] + squares;
        at->product[i] = at->T[i] + at->size * width;
        at->weights[i] = at->product[i] + at->size * width;
        at->block[i] = at->weights[i] + at->size * width;
    }
    return memory;
}

/* The sum of arrays of `size` numbers, those of the nodes `known`, times weights. */
static void predict(int64_t count, const int64_t *known, const double *weights, int64_t size, const double *T,
                    double *result)
{
    memset(result, 0, (size_t)size * sizeof(double));
    for (int64_t k = 0; k < count; k++)
        for (int64_t n = 0; n < size; n++)
            result[n] += weights[k] * T[known[k] * size + n];
}

/* T (nodes, size, columns) of one interval, zero before, from the middle node to ever finer sets; 1 if it is found. */
static int one_interval(node *at, int64_t nodes, int64_t columns, const double *K, int64_t levels,
                        const int64_t *counts, const int64_t *numbers, const double *weights, int64_t iterations,
                        double enough, double *T)
{
    const int64_t squares = at->size * at->size * at->parts, size = at->size * columns * at->parts;
    for (int64_t k = 0; k < at->count; k++)
        T[nodes / 2 * size + (at->places[k] * columns + k) * at->parts] = 1.0;
    for (int64_t level = 0; level < levels; level++, counts += 2) {
        const int64_t *known = numbers, *wanted = numbers + counts[0];
        for (int64_t w = 0; w < counts[1]; w++, weights += counts[0]) {
            double *here = T + wanted[w] * size, largest = INFINITY;
            predict(counts[0], known, weights, size, T, here);
            separate(at->parts, K + wanted[w] * squares, at->size, at->size, at->size, at->K);
            separate(at->parts, here, at->size, columns, at->width, at->T);
            weigh(at);
            for (int64_t n = 0; n < iterations && largest > enough * enough; n++)
                if (!((largest = improve(at)) < 1.0) && largest > enough * enough)
                    return 0;
            if (largest > enough * enough)
                return 0;
            for (int64_t i = 0; i < at->parts; i++)
                for (int64_t a = 0; a < at->size; a++)
                    for (int64_t k = 0; k < at->count; k++)
                        here[(a * columns + k) * at->parts + i] = at->T[i][a * at->width + k];
        }
        numbers += counts[0] + counts[1];
    }
    return 1;
}

/* T (intervals, nodes, size, columns) from K (intervals, nodes, size, size), `same` (intervals, size, size) and
   `places` (intervals, columns), -1 behind those of an interval; T is zero before, and of no use where it is not
   `found`. Each of the levels has `counts` of nodes known and wanted, whose `numbers` follow one another, and the
   weights of the known ones in each of the wanted. Fails where there is no memory. */
KERNEL(invariant)(int64_t intervals, int64_t nodes, int64_t size, int64_t columns, int64_t parts, const double *K,
                  const int64_t *places, const uint8_t *same, int64_t levels, const int64_t *counts,
                  const int64_t *numbers, const double *weights, int64_t iterations, double enough, double *T,
                  uint8_t *found)
{
    node at = {.size = size, .parts = parts};
    double *memory = reserve(&at, columns);
    if (!memory)
        return 1;
    for (int64_t i = 0; i < intervals; i++) {
        at.places = places + i * columns;
        at.same = same + i * size * size;
        for (at.count = 0; at.count < columns && at.places[at.count] >= 0;)
            at.count++;
        for (int64_t k = 0; k < parts; k++)  // columns that this interval does not have are zero
            memset(at.T[k], 0, (size_t)((3 * size + columns) * at.width) * sizeof(double));
        found[i] = (uint8_t)one_interval(&at, nodes, columns, K + i * nodes * size * size * parts, levels, counts,
                                         numbers, weights, iterations, enough, T + i * nodes * size * columns * parts);
    }
    free(memory);
    return 0;
}

/* Whether steps from the identity at all nodes of an interval become small together; the diagonals of what is found. */
static int one_test(node *at, int64_t nodes, const double *K, int64_t steps, double small, double largest,
                    double *diagonals)
{
    const int64_t size = at->size, parts = at->parts;
    for (int64_t n = 0; n < nodes; n++) {
        separate(parts, K + n * size * size * parts, size, size, size, at[n].K);
        for (int64_t i = 0; i < parts; i++)
            memset(at[n].T[i], 0, (size_t)(4 * size * at->width) * sizeof(double));
        weigh(at + n);
        for (int64_t a = 0; a < size; a++)
            at[n].T[0][a * at->width + a] = 1.0;
        improve(at + n);  // the first step only puts couplings over distances
    }
    for (int64_t step = 0; step < steps; step++) {
        double most = 0.0;
        for (int64_t n = 0; n < nodes; n++) {
            const double here = improve(at + n);
            most = here > most ? here : most;
        }
        for (int64_t n = 0; n < nodes; n++)
            for (int64_t i = 0; i < parts; i++)
                for (int64_t a = 0; a < size; a++)
                    diagonals[(n * size + a) * parts + i] = at[n].block[i][a * at->width + a];
        if (!(most < largest * largest))
            return 0;
        if (step > 0 && most <= small * small)
            return 1;
    }
    return 0;
}

/* For which intervals steps at all nodes become `small`, none of them as large as `largest`, and the diagonals of the
   blocks, (intervals, nodes, size), from K (intervals, nodes, size, size). Fails where there is no memory. */
KERNEL(contracts)(int64_t intervals, int64_t nodes, int64_t size, int64_t parts, const double *K, const uint8_t *same,
                  const int64_t *places, int64_t steps, double small, double largest, double *diagonals, uint8_t *found)
{
    node *at = calloc((size_t)(nodes + 1), sizeof(node));
    double **memory = calloc((size_t)(nodes + 1), sizeof(double *));
    int missing = 0;
    if (!at || !memory) {
        free(memory);
        free(at);
        return 1;
    }
    for (int64_t n = 0; n < nodes && !missing; n++) {
        at[n] = (node){.size = size, .count = size, .parts = parts, .places = places};
        memory[n] = reserve(at + n, size);
        missing = !memory[n];
    }
    for (int64_t i = 0; i < intervals && !missing; i++) {
        for (int64_t n = 0; n < nodes; n++)
            at[n].same = same + i * size * size;
        found[i] = (uint8_t)one_test(at, nodes, K + i * nodes * size * size * parts, steps, small, largest,
                                     diagonals + i * nodes * size * parts);
    }
    for (int64_t n = 0; n < nodes; n++)
        free(memory[n]);
    free(memory);
    free(at);
    return missing;
}
