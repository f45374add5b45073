/* The multipliers of an orbit of collocation, and what those of a better one say of them; see stability/full_period.py,
   whose steps these are.

   Of n states that come first among those of the equations, on K intervals of d stages. An orbit that is not forced has
   the multiplier 1 of its velocity; no more are known. */

#include <math.h>
#include <string.h>

#include "kernel.h"

enum { MOST_STATES = 16 };
static const double SLOWEST_MOTION_RATIO = 1e-6, SMALLEST_COMPONENT_RATIO = 1e-6, LARGEST_LOGARITHM = 709.782712893384;
static const double FAR_LOG_EIGENVALUE = 7.0, LOG_TWO = 0.6931471805599453, RESOLVED_LOG_GROWTH = 2.0;
static const double WITHIN_PART = 1.0, SAME_LOG = 1e-8; /* these as in closed_maps.py and full_period.py */

typedef struct {
    int64_t n, K, d, apart, trivial; /* numbers from one end of an interval to the next; multipliers that are 1: 1 or 0 */
    const void *equations, *method;
    const int64_t *rows, *columns; /* of the entries of the field's derivatives */
    const double *general;         /* an orthogonal matrix in general position */
    double *jacobians, *maps, *velocities, *bounds; /* (K, d, n, n), (K, n, n), (K + 1, n), (K) */
    double *contraction, *memory;                   /* the logarithm of the determinant of all maps */
} orbit;

/* The size of each component at the ends of intervals, no less than a part of the largest. */
static void sizes_of(const orbit *o, const double *z, double *sizes)
{
    double most = 0.0;
    memset(sizes, 0, (size_t)o->n * sizeof(double));
    for (int64_t k = 0; k <= o->K; k++)
        for (int64_t i = 0; i < o->n; i++)
            sizes[i] = fmax(sizes[i], fabs(z[k * o->apart + i]));
    for (int64_t i = 0; i < o->n; i++)
        most = fmax(most, sizes[i]);
    const double least = most > 0.0 ? SMALLEST_COMPONENT_RATIO * most : 1.0;
    for (int64_t i = 0; i < o->n; i++)
        sizes[i] = fmax(sizes[i], least);
}

/* In how many parts intervals are taken, each as often as `bounds` say; 0 where they are taken as they are: where not
   several of the multipliers behind the first `trivial` are so far from 1 that digits may be lost, and no interval is so
   long that they are. */
static double parts_of(const orbit *o, const double *numbers, const double *logs, int64_t trivial)
{
    double most = 0.0, parts = 0.0;
    int64_t far = 0;
    for (int64_t i = trivial; i < o->n; i++)
        most = fmax(most, fabs(logs[i])), far += fabs(logs[i]) > LOG_TWO;
    if (!(most > FAR_LOG_EIGENVALUE && far > 1))
        return 0.0;
    NAMED(changes)(o->K, o->d, o->n, numbers, o->jacobians, RESOLVED_LOG_GROWTH, WITHIN_PART, o->bounds);
    most = largest(o->bounds, o->K);
    for (int64_t k = 0; k < o->K; k++)
        parts += o->bounds[k] = fmax(ceil(o->bounds[k] / WITHIN_PART), 1.0);
    return most <= RESOLVED_LOG_GROWTH ? 0.0 : parts;
}

/* How many directions are known: none at rest. */
static int64_t directions(const orbit *o, const double *sizes)
{
    double speed = 0.0;
    for (int64_t i = 0; o->trivial && i < (o->K + 1) * o->n; i++)
        speed = fmax(speed, fabs(o->velocities[i] / sizes[i % o->n]));
    return speed > SLOWEST_MOTION_RATIO;
}

/* What `multipliers` finds of an orbit, n (n + 4) + 4 numbers, and behind them in how many parts the intervals are to be
   taken. The lengths of the intervals are the first of `numbers`. Returns 1 where eigenvalues do not converge. */
KERNEL(orbit_multipliers)(const orbit *o, const double *z, const double *numbers, int64_t with_rounding, double *found)
{
    double sizes[MOST_STATES], *behind = found + o->n * (o->n + 4);
    if (o->trivial)
        NAMED(collocation_velocities)(o->equations, z, numbers, o->n, o->velocities);
    NAMED(collocation_jacobians)(o->equations, z, numbers, o->n, o->rows, o->columns, o->jacobians);
    NAMED(interval_maps)(o->method, o->K, o->n, numbers, o->jacobians, o->maps, o->contraction, o->memory);
    sizes_of(o, z, sizes);
    if (NAMED(multipliers)(o->K, o->n, directions(o, sizes), 0, o->trivial, *o->contraction, 1.0, with_rounding,
                           o->maps, o->velocities, NULL, sizes, o->general, found, o->memory))
        return 1;
    behind[4] = parts_of(o, numbers, found, (int64_t)behind[0]);
    return 0;
}

/* The same by so many parts as `orbit_multipliers` has found to be needed, but for those multipliers that both have: the
   others are more accurate, as an orbit is more accurate at the ends of intervals. `memory` has P (1 + d + (d + 9) n^2 + n)
   + 40 n^2 + 21 n numbers for P parts, and as many as `interval_maps` needs. */
KERNEL(orbit_multipliers_by_parts)(const orbit *o, const void *polynomials, const double *edges, const double *z,
                                   const double *numbers, const double *nodes, int64_t parts, int64_t with_rounding,
                                   double *found, double *memory)
{
    const int64_t n = o->n, d = o->d, area = n * n;
    double *lengths = memory, *at = lengths + parts, *jacobians = at + parts * d, *maps = jacobians + parts * d * area;
    double *velocities = maps + parts * area, *room = velocities + (parts + 1) * n, sizes[MOST_STATES], start = 0.0, lost;
    double whole[MOST_STATES * (MOST_STATES + 4) + 4];
    for (int64_t k = 0, p = 0; k < o->K; k++)
        for (int64_t i = 0; i < (int64_t)o->bounds[k]; i++, p++) {
            lengths[p] = numbers[k] / o->bounds[k];
            for (int64_t j = 0; j < d; j++)
                at[p * d + j] = start + lengths[p] * nodes[j];
            start += lengths[p];
        }
    NAMED(collocation_jacobians_at)(o->equations, polynomials, edges, z, numbers, parts * d, at, n, o->rows, o->columns,
                                    jacobians);
    NAMED(interval_maps)(o->method, parts, n, lengths, jacobians, maps, &lost, room);
    for (int64_t k = 0, p = 0; k < o->K; k++)
        for (int64_t i = 0; i < (int64_t)o->bounds[k]; i++, p++)
            for (int64_t a = 0; a < n; a++) {
                double sum = i ? 0.0 : o->velocities[k * n + a]; /* within an interval those are less accurate */
                for (int64_t b = 0; i && b < n; b++)
                    sum += maps[(p - 1) * area + a * n + b] * velocities[(p - 1) * n + b];
                velocities[p * n + a] = sum;
            }
    memcpy(velocities + parts * n, o->velocities + o->K * n, (size_t)n * sizeof(double));
    sizes_of(o, z, sizes);
    memcpy(whole, found, (size_t)(n * (n + 4) + 4) * sizeof(double));
    if (NAMED(multipliers)(parts, n, directions(o, sizes), 0, o->trivial, *o->contraction, 1.0, with_rounding, maps,
                           velocities, NULL, sizes, o->general, found, room))
        return 1;
    for (int64_t i = (int64_t)found[n * (n + 4)], r = 3 * n; i < n; i++, r++)
        if (fabs(whole[i]) <= FAR_LOG_EIGENVALUE && fabs(whole[i] - found[i]) <= SAME_LOG)
            found[i] = whole[i], found[n + i] = whole[n + i], found[2 * n + i] = whole[2 * n + i], found[r] = whole[r];
    return 0;
}

static double distance(const double *x, const double *y, double size)
{
    return hypot(x[0] / size - y[0] / size, x[1] / size - y[1] / size);
}

/* Of each of m values, pairs of numbers, from that of the better ones which it is nearest to, relative to their sizes;
   conjugate ones have one distance. Returns 1 where one of these is the nearest to two. */
static int distances_of(int64_t m, const double *values, const double *better, double *distances)
{
    double own[MOST_STATES];
    int64_t taken = 0, pairs = 0;
    for (int64_t i = 0; i < m; i++) {
        double least = INFINITY;
        int64_t nearest = 0;
        pairs += values[2 * i + 1] != 0.0;
        for (int64_t j = 0; j < m; j++) {
            const double one = hypot(values[2 * i], values[2 * i + 1]), other = hypot(better[2 * j], better[2 * j + 1]);
            const double size = fmax(1.0, fmax(one, other)), apart = distance(values + 2 * i, better + 2 * j, size);
            if (apart < least)
                least = apart, nearest = j, own[i] = apart * size;
        }
        if (!(least < INFINITY) || taken >> nearest & 1)
            return 1;
        taken |= (int64_t)1 << nearest;
    }
    for (int64_t i = 0; i < m; i++) {
        const double conjugate[2] = {values[2 * i], -values[2 * i + 1]};
        int64_t partner = 0;
        for (int64_t j = 1; pairs && j < m; j++)
            if (distance(conjugate, values + 2 * j, 1.0) < distance(conjugate, values + 2 * partner, 1.0))
                partner = j;
        distances[i] = pairs ? fmax(own[i], own[partner]) : own[i];
    }
    return 0;
}

/* Multipliers of n states as numbers, real and imaginary parts, the trivial ones first; by their logarithms and phases. */
static void values_of(int64_t n, const double *found, double *values)
{
    for (int64_t i = 0; i < n; i++) {
        const double modulus = exp(fmin(found[i], LARGEST_LOGARITHM));
        values[2 * i] = modulus * found[n + i], values[2 * i + 1] = modulus * found[2 * n + i];
    }
}

/* What `orbit_multipliers` has found of an orbit as numbers with errors, from what it has `better`, if there is that:
   distances times `safety` and rounding. Into `row` go the multipliers, (n, 2); their logarithms, (n); of those that are
   not trivial the errors, whether they are on the circle and whether they are real, (n) each; the product, (n, n); how
   many are trivial, their distance from 1, the largest error, the largest modulus, and how far the trivial ones may be
   off, `drift` times the norm. Returns 1 where it is not plain which belongs to which. */
KERNEL(judged_multipliers)(int64_t n, const double *found, const double *better, double safety, double drift, double *row)
{
    double *logs = row + 2 * n, *errors = logs + n, *on_circle = errors + n, *real = on_circle + n, *matrix = real + n;
    double *numbers = matrix + n * n, others[2 * MOST_STATES], away = 1.0, most[2] = {0.0, 0.0}, none = 0.0;
    const double *behind = found + n * (n + 4);
    const int64_t trivial = (int64_t)behind[0], m = n - trivial;
    values_of(n, found, row);
    memcpy(logs, found, (size_t)n * sizeof(double));
    if (better) {
        values_of(n, better, others);
        if (better[n * (n + 4)] != behind[0] || distances_of(m, row + 2 * trivial, others + 2 * trivial, errors))
            return 1;
    }
    numbers[3] = 0.0;
    for (int64_t i = 0; i < m; i++) {
        const double *value = row + 2 * (trivial + i), modulus = hypot(value[0], value[1]);
        errors[i] = better ? safety * errors[i] + found[3 * n + i] : INFINITY;
        const int decisive = modulus >= 1.0 - errors[i];
        most[decisive] = fmax(most[decisive], errors[i] / fmax(1.0, modulus)), none += decisive;
        numbers[3] = fmax(numbers[3], modulus);
        on_circle[i] = fabs(modulus - 1.0) <= errors[i], real[i] = fabs(value[1]) <= errors[i];
    }
    for (int64_t i = 0; i < trivial; i++)
        away *= hypot(row[2 * i] - 1.0, row[2 * i + 1]);
    for (int64_t i = 0; i < n * n; i++)
        matrix[i] = found[4 * n + i] * exp(fmin(behind[1], LARGEST_LOGARITHM));
    numbers[0] = behind[0], numbers[1] = trivial ? pow(away, 1.0 / (double)trivial) : 0.0;
    numbers[2] = none > 0.0 ? most[1] : most[0], numbers[4] = drift * behind[2];
    return 0;
}
