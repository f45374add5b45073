/* Which eigenvalues of matrices on intervals stay in one block, and whether those of different blocks stay apart. Numbers
   are real, or complex: then their real and imaginary parts follow one another. */

#include <math.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#define EXPORTED __attribute__((visibility("default")))

enum { MOST_PROBES = 16 };

/* What decides who is joined: see `stability.blocks`. */
typedef struct {
    double apart, coupled, resolved;
    int64_t degree;
} limits;

static double size_of(int64_t parts, const double *number)
{
    return parts == 1 ? fabs(number[0]) : sqrt(number[0] * number[0] + number[1] * number[1]);
}

static double distance_of(int64_t parts, const double *one, const double *other)
{
    const double apart[2] = {one[0] - other[0], parts == 2 ? one[1] - other[1] : 0.0};
    return size_of(parts, apart);
}

/* Whether two are joined, from the matrices K (nodes, size, size) at the nodes; `shift` is what one moves the other by
   where they are not. */
static int are_joined(int64_t nodes, int64_t size, int64_t parts, const double *K, int64_t a, int64_t b, limits limit,
                      double *shift)
{
    const int64_t square = size * size * parts, middle = nodes / 2 * square, down = (size + 1) * parts;
    double nearest = INFINITY, farthest = 0.0, coupling = 0.0, from[2] = {0.0, 0.0};
    for (int64_t i = 0; i < parts; i++)
        from[i] = K[middle + a * down + i] - K[middle + b * down + i];
    for (int64_t j = 0; j < nodes; j++) {
        const double *here = K + j * square;
        const double *up = here + (a * size + b) * parts, *low = here + (b * size + a) * parts;
        double difference[2] = {0.0, 0.0}, product[2] = {up[0] * low[0], 0.0};
        for (int64_t i = 0; i < parts; i++)
            difference[i] = here[a * down + i] - here[b * down + i];
        if (parts == 2) {
            product[0] -= up[1] * low[1];
            product[1] = up[0] * low[1] + up[1] * low[0];
        }
        const double near = size_of(parts, difference), far = distance_of(parts, difference, from);
        const double coupled = size_of(parts, product);
        nearest = near < nearest ? near : nearest;
        farthest = far > farthest ? far : farthest;
        coupling = coupled > coupling ? coupled : coupling;
    }
    const double distance = size_of(parts, from);
    double away = distance / (farthest > 1e-300 ? farthest : 1e-300);
    away = away < 1.0 ? 1.0 : away > 1e3 ? 1e3 : away;
    const double decay = pow(away + sqrt(away * away - 1.0), (double)-limit.degree);
    const double expected = coupling * away * away / (distance > 1e-300 ? distance : 1e-300) * decay;
    *shift = coupling / nearest;
    return distance < limit.apart * farthest || coupling > limit.coupled * nearest * limit.coupled * nearest ||
           expected > limit.resolved;
}

/* Mark all that are joined to `a` directly or through others. */
static void gather(int64_t size, const uint8_t *joined, int64_t a, int64_t *waiting, uint8_t *row)
{
    int64_t count = 1;
    waiting[0] = a;
    row[a] = 1;
    while (count) {
        const uint8_t *here = joined + waiting[--count] * size;
        for (int64_t b = 0; b < size; b++)
            if (here[b] && !row[b]) {
                row[b] = 1;
                waiting[count++] = b;
            }
    }
}

/* Who is in one block, `same` (intervals, size, size), and what the others move each by, `shifts` (intervals, size),
   from K (intervals, nodes, size, size) and those that are `glued`. 1 where there is no memory. */
EXPORTED int casadi_skin_graph(int64_t intervals, int64_t nodes, int64_t size, int64_t parts, const double *K,
                               const uint8_t *glued, double apart, double coupled, double resolved, int64_t degree,
                               uint8_t *same, double *shifts)
{
    const limits limit = {apart, coupled, resolved, degree};
    double *moved = malloc((size_t)(size * size) * sizeof(double));
    int64_t *waiting = malloc((size_t)size * sizeof(int64_t));
    uint8_t *joined = malloc((size_t)(size * size));
    const int missing = !moved || !waiting || !joined;
    for (int64_t i = 0; i < intervals && !missing; i++) {
        uint8_t *found = same + i * size * size;
        const uint8_t *known = glued + i * size * size;
        for (int64_t a = 0; a < size; a++)
            for (int64_t b = 0; b < a; b++) {
                double shift;
                const int both = are_joined(nodes, size, parts, K + i * nodes * size * size * parts, a, b, limit, &shift);
                moved[a * size + b] = moved[b * size + a] = shift;
                joined[a * size + b] = joined[b * size + a] = (uint8_t)(both || known[a * size + b] || known[b * size + a]);
            }
        memset(found, 0, (size_t)(size * size));
        for (int64_t a = 0; a < size; a++) {
            joined[a * size + a] = 0;
            gather(size, joined, a, waiting, found + a * size);
        }
        for (int64_t a = 0; a < size; a++) {
            shifts[i * size + a] = 0.0;
            for (int64_t b = 0; b < size; b++)
                shifts[i * size + a] += found[a * size + b] ? 0.0 : moved[a * size + b];
        }
    }
    free(moved);
    free(waiting);
    free(joined);
    return missing;
}

/* The square of a difference of two numbers. */
static void square_of(int64_t parts, const double *one, const double *other, double *square)
{
    const double x = one[0] - other[0], y = parts == 2 ? one[1] - other[1] : 0.0;
    square[0] = x * x - y * y;
    square[1] = 2.0 * x * y;
}

/* For which intervals numbers of different blocks, values (intervals, probes, size), stay apart between the probes: the
   least square of a distance of two, as a polynomial there by `weights` (between, probes), is at least the part
   `nearer` of the least at the probes. */
EXPORTED void casadi_skin_apart(int64_t intervals, int64_t probes, int64_t size, int64_t parts, const double *values,
                                const uint8_t *same, int64_t between, const double *weights, double nearer,
                                uint8_t *found)
{
    for (int64_t i = 0; i < intervals; i++) {
        const double *here = values + i * probes * size * parts;
        found[i] = 1;
        for (int64_t a = 0; a < size && found[i]; a++)
            for (int64_t b = 0; b < a && found[i]; b++) {
                double squares[2 * MOST_PROBES], least = INFINITY;
                if (same[(i * size + a) * size + b])
                    continue;
                for (int64_t j = 0; j < probes; j++) {
                    const double *row = here + j * size * parts;
                    square_of(parts, row + a * parts, row + b * parts, squares + 2 * j);
                    const double length = size_of(2, squares + 2 * j);
                    least = length < least ? length : least;
                }
                for (int64_t k = 0; k < between && found[i]; k++) {
                    double sum[2] = {0.0, 0.0};
                    for (int64_t j = 0; j < probes; j++) {
                        sum[0] += weights[k * probes + j] * squares[2 * j];
                        sum[1] += weights[k * probes + j] * squares[2 * j + 1];
                    }
                    found[i] = size_of(2, sum) >= nearer * least;
                }
            }
    }
}
