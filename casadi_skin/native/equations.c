/* Collocation equations on K intervals, R increments and d stages in each; see zero/discretisation.py.

   Unknowns are x_0, X_01 .. X_0q, x_1, ..., x_K in the order of time, R = q + 1, n numbers each, then m scalars; numbers
   are the lengths of the intervals, which sum to 1, then the constants of the model. Equations are

       x_i - x_0 - h sum_j a_ij f(s_j, X_j), i = 1 .. R, in each interval, then conditions and integrals. */

#include <math.h>
#include <string.h>

#include "kernel.h"

enum { VALUES = 64 }; /* of an interval, and states, scalars and integrals times scalars, at most */
static const double ON_VALUE = 1e-14; /* distance of a place from a value that is rounding, of the interval */

/* A model at K d + 1 places, the stages with the last one twice or the check points of the defect, and at both ends;
   matrices by columns. Functions that are no lists of operations, whose `of` is 0, are evaluated by CasADi before. */
typedef struct {
    int64_t n, K, R, d, m, entries, conditions, integrals, nonzeros; /* entries of df/dx that are not zero */
    int64_t by_ends[3];          /* how many entries derivatives of the conditions have */
    const double *extended;      /* weights of the increments, (R, d) */
    const int8_t *differences;   /* constant parts of the non-zeros */
    const int32_t *stiff, *rest; /* non-zeros that take derivatives by the states at stages, and all others */
    const double *field, *by_states, *by_scalars, *condition, *by_end[3], *integrand, *by_x, *by_s;
    const places *of_field, *of_conditions, *of_integrands; /* of (s, x, scalars, constants); x_0, x_K for s, x */
    const double *nodes;                                    /* of the stages, (d) */
    const int64_t *stages;         /* which of the values of an interval they are */
    const int32_t *rows, *columns; /* of the non-zeros */
} equations;

static int64_t state_values(const equations *e) { return e->n * (e->K * e->R + 1); }

/* Scalars and constants at all places of a function. */
static void give_numbers(const equations *e, const places *p, const double *z, const double *numbers)
{
    const double *given[2] = {z + state_values(e), numbers + e->K};
    for (int a = 0; a < 2; a++)
        for (int64_t size = p->argument_sizes[2 + a], i = 0; i < p->count; i++)
            memcpy(p->argument[2 + a] + i * size, given[a], (size_t)size * sizeof(double));
}

static void at_stages(const equations *e, const places *p, const double *z, const double *numbers)
{
    double *s = p->argument[0], *x = p->argument[1], before = 0.0;
    give_numbers(e, p, z, numbers);
    for (int64_t k = 0; k < e->K; k++) {
        const double after = before + numbers[k], start = after - numbers[k];
        for (int64_t j = 0; j < e->d; j++, x += e->n) {
            *s++ = start + numbers[k] * e->nodes[j];
            memcpy(x, z + (k * e->R + e->stages[j]) * e->n, (size_t)e->n * sizeof(double));
        }
        before = after;
    }
    *s = s[-1];
    memcpy(x, x - e->n, (size_t)e->n * sizeof(double));
    NAMED(at_places)(p);
}

/* Derivatives of the field by the first n states as last computed, at so many places, dense, (places, n, n); `rows` and
   `columns` are those of their entries. */
static void dense(const equations *e, int64_t count, int64_t n, const int64_t *rows, const int64_t *columns, double *found)
{
    const double *from = e->by_states;
    memset(found, 0, (size_t)(count * n * n) * sizeof(double));
    for (int64_t s = 0; s < count; s++, from += e->entries, found += n * n)
        for (int64_t i = 0; i < e->entries; i++)
            if (rows[i] < n && columns[i] < n)
                found[rows[i] * n + columns[i]] = from[i];
}

/* These at the stages, (K d, n, n). */
KERNEL(collocation_jacobians)(const void *of, const double *z, const double *numbers, int64_t n, const int64_t *rows,
                              const int64_t *columns, double *jacobians)
{
    const equations *e = of;
    if (e->of_field)
        at_stages(e, e->of_field, z, numbers);
    dense(e, e->K * e->d, n, rows, columns, jacobians);
    return 0;
}

/* The first `count` components of a field that does not depend on time, at the ends of intervals, (K + 1, count). */
void NAMED(collocation_velocities)(const void *of, const double *z, const double *numbers, int64_t count,
                                   double *velocities)
{
    const equations *e = of;
    places ends = *e->of_field;
    ends.count = e->K + 1;
    give_numbers(e, &ends, z, numbers);
    for (int64_t k = 0; k <= e->K; k++)
        memcpy(ends.argument[1] + k * e->n, z + k * e->R * e->n, (size_t)e->n * sizeof(double));
    NAMED(at_places)(&ends);
    for (int64_t k = 0; k <= e->K; k++)
        memcpy(velocities + k * count, e->field + k * e->n, (size_t)count * sizeof(double));
}

/* The functions that are lists of operations. */
static void evaluate_all(const equations *e, const double *z, const double *numbers)
{
    if (e->of_field)
        at_stages(e, e->of_field, z, numbers);
    if (e->of_integrands)
        at_stages(e, e->of_integrands, z, numbers);
    if (e->of_conditions) {
        give_numbers(e, e->of_conditions, z, numbers);
        memcpy(e->of_conditions->argument[0], z, (size_t)e->n * sizeof(double));
        memcpy(e->of_conditions->argument[1], z + state_values(e) - e->n, (size_t)e->n * sizeof(double));
        NAMED(at_places)(e->of_conditions);
    }
}

/* Of the field's values: the end of an interval is the last of the R, whose weights are those of integrals. */
static void residual_of(const equations *e, const double *z, const double *lengths, double *residual)
{
    const int64_t n = e->n, d = e->d, own = e->integrals;
    for (int64_t k = 0; k < e->K; k++, z += e->R * n)
        for (int64_t i = 0; i < e->R; i++, residual += n)
            for (int64_t c = 0; c < n; c++) {
                double sum = 0.0;
                for (int64_t j = 0; j < d; j++)
                    sum += lengths[k] * e->extended[i * d + j] * e->field[(k * d + j) * n + c];
                residual[c] = z[(i + 1) * n + c] - z[c] - sum;
            }
    memcpy(residual, e->condition, (size_t)e->conditions * sizeof(double));
    residual += e->conditions;
    memset(residual, 0, (size_t)own * sizeof(double));
    for (int64_t k = 0; k < e->K * d; k++)
        for (int64_t i = 0; i < own; i++)
            residual[i] += lengths[k / d] * e->extended[(e->R - 1) * d + k % d] * e->integrand[k * own + i];
}

/* Residual and non-zeros of the Jacobian. */
KERNEL(collocation_equations)(const equations *e, const double *z, const double *numbers, double *residual,
                              double *nonzeros)
{
    const int64_t n = e->n, d = e->d, own = e->integrals, scalars = e->m * n;
    const int32_t *stiff = e->stiff, *rest = e->rest;
    const double *lengths = numbers;
    evaluate_all(e, z, numbers);
    residual_of(e, z, lengths, residual);
    for (int64_t i = 0; i < e->nonzeros; i++)
        nonzeros[i] = e->differences[i];
    for (int64_t k = 0; k < e->K; k++)
        for (int64_t i = 0; i < e->R; i++) {
            const double *weights = e->extended + i * d;
            for (int64_t j = 0; j < d; j++) {
                const double weight = lengths[k] * weights[j], *by_states = e->by_states + (k * d + j) * e->entries;
                for (int64_t c = 0; c < e->entries; c++)
                    nonzeros[*stiff++] -= weight * by_states[c];
            }
            for (int64_t c = 0; c < scalars; c++) {
                double sum = 0.0;
                for (int64_t j = 0; j < d; j++)
                    sum += lengths[k] * weights[j] * e->by_scalars[(k * d + j) * scalars + c];
                nonzeros[*rest++] = -sum;
            }
        }
    for (int end = 0; end < 3; end++)
        for (int64_t i = 0; i < e->by_ends[end]; i++)
            nonzeros[*rest++] = e->by_end[end][i];
    if (!own)
        return 0;
    const double *weights = e->extended + (e->R - 1) * d;
    const int32_t *by_scalars = rest + e->K * d * own * n;
    for (int64_t i = 0; i < own * e->m; i++)
        nonzeros[by_scalars[i]] = 0.0;
    for (int64_t k = 0; k < e->K * d; k++) {
        const double weight = lengths[k / d] * weights[k % d];
        for (int64_t i = 0; i < own * n; i++)
            nonzeros[*rest++] = weight * e->by_x[k * own * n + i];
        for (int64_t i = 0; i < own * e->m; i++)
            nonzeros[by_scalars[i]] += weight * e->by_s[k * own * e->m + i];
    }
    return 0;
}

/* The Jacobian times a step, (size - 1). */
KERNEL(collocation_times)(const equations *e, const double *nonzeros, const double *step, double *sums)
{
    memset(sums, 0, (size_t)(e->n * e->K * e->R + e->conditions + e->integrals) * sizeof(double));
    for (int64_t i = 0; i < e->nonzeros; i++)
        sums[e->rows[i]] += nonzeros[i] * step[e->columns[i]];
    return 0;
}

/* The largest of the terms of each equation: non-zeros of a matrix times unknowns z, into `terms`, which are zero. */
KERNEL(largest_terms)(int64_t nonzeros, const double *values, const int32_t *rows, const int32_t *columns,
                      const double *z, double *terms)
{
    for (int64_t i = 0; i < nonzeros; i++) {
        const double term = fabs(values[i] * z[columns[i]]);
        if (term > terms[rows[i]] || term != term) /* a term that is no number stays */
            terms[rows[i]] = term;
    }
    return 0;
}

static double length_of(const double *weights, const double *step, int64_t size)
{
    double sum = 0.0;
    for (int64_t i = 0; i < size; i++)
        sum += weights[i] * step[i] * step[i];
    return sqrt(sum);
}

/* As `Problem.null_vector`, by factors in `memory` of the Jacobian or of one nearby: t, (size). Returns 1 where what they
   leave does not become small fast; `room` has `size` numbers. */
KERNEL(collocation_null_vector)(const equations *e, const void *layout, double *memory, const double *nonzeros,
                                const double *weights, double accurate, double slowest, double *t, double *room)
{
    const int64_t count = e->n * e->K * e->R + e->conditions + e->integrals;
    memset(t, 0, (size_t)count * sizeof(double)), t[count] = 1.0;
    NAMED(collocation_solve)(layout, memory, 1, t);
    const double size = length_of(weights, t, count + 1);
    for (double before = size, off;; before = off) {
        NAMED(collocation_times)(e, nonzeros, t, room), room[count] = 0.0;
        NAMED(collocation_solve)(layout, memory, 1, room);
        for (int64_t i = 0; i <= count; i++)
            t[i] -= room[i];
        off = length_of(weights, room, count + 1);
        if (off * off <= accurate * before * size)
            return 0;
        if (!(off <= slowest * before))
            return 1;
    }
}

/* Weights of the defect at check points of an interval, see zero/butcher.py: q inner ones, and of all places, which are
   the start, the inner ones and the end, `count` from number `first` on. */
typedef struct {
    int64_t q, first, count;
    const double *inner, *values, *slopes, *increments, *between; /* (q), (q, d + 1), (count, d + 1), (R, count), (q, count) */
    const double *at_stages, *at_checks;                         /* weights of integrals, (d), (count) */
} checks;

static inline double product(const double *weights, const double *values, int64_t count, int64_t apart)
{
    double sum = 0.0;
    for (int64_t i = 0; i < count; i++)
        sum += weights[i] * values[i * apart];
    return sum;
}

/* Which of the places of all check points, the inner ones of all intervals and then their ends, is one of an interval. */
static int64_t place_of(const equations *e, const checks *c, int64_t k, int64_t i)
{
    i += c->first;
    return i == 0 ? e->K * c->q + k : i > c->q ? e->K * c->q + k + 1 : k * c->q + i - 1;
}

static void at_checks(const equations *e, const checks *c, const places *p, const double *z, const double *numbers)
{
    const int64_t n = e->n, inside = e->K * c->q;
    double *s = p->argument[0], *x = p->argument[1], place = 0.0;
    give_numbers(e, p, z, numbers);
    for (int64_t k = 0; k <= e->K; k++) {
        const double *first = z + k * e->R * n;
        s[inside + k] = place;
        memcpy(x + (inside + k) * n, first, (size_t)n * sizeof(double));
        for (int64_t i = 0; k < e->K && i < c->q; i++) {
            s[k * c->q + i] = place + numbers[k] * c->inner[i];
            for (int64_t a = 0; a < n; a++) {
                double sum = 0.0;
                for (int64_t j = 1; j <= e->d; j++)
                    sum += c->values[i * (e->d + 1) + j] * (first[j * n + a] - first[a]);
                x[(k * c->q + i) * n + a] = first[a] + sum;
            }
        }
        if (k < e->K)
            place += numbers[k];
    }
    NAMED(at_places)(p);
}

/* The residual in a method of twice as many stages, (size - 1), and the integral of the defect from the start of its
   interval to each inner check point, less the polynomial through those at the stages, (K q, n). */
KERNEL(collocation_missed)(const equations *e, const checks *c, const double *z, const double *numbers, double *residual,
                           double *between)
{
    const int64_t n = e->n, d = e->d, own = e->integrals, bottom = n * e->K * e->R;
    double defects[VALUES];
    memset(residual + bottom, 0, (size_t)(e->conditions + own) * sizeof(double));
    if (own) { /* integrals by the method of twice as many stages less those by this one */
        at_stages(e, e->of_integrands, z, numbers);
        for (int64_t k = 0; k < e->K; k++)
            for (int64_t i = 0; i < own; i++) {
                const double *values = e->integrand + k * d * own + i;
                residual[bottom + e->conditions + i] +=
                    numbers[k] * (product(c->at_stages, values, d, own) -
                                  product(e->extended + (e->R - 1) * d, values, d, own));
            }
        at_checks(e, c, e->of_integrands, z, numbers);
        for (int64_t k = 0; k < e->K; k++)
            for (int64_t j = 0; j < c->count; j++)
                for (int64_t i = 0; i < own; i++)
                    residual[bottom + e->conditions + i] +=
                        numbers[k] * c->at_checks[j] * e->integrand[place_of(e, c, k, j) * own + i];
    }
    at_checks(e, c, e->of_field, z, numbers);
    for (int64_t k = 0; k < e->K; k++)
        for (int64_t a = 0; a < n; a++) {
            const double *values = z + k * e->R * n + a;
            for (int64_t i = 0; i < c->count; i++) {
                double slope = 0.0;
                for (int64_t j = 1; j <= d; j++)
                    slope += c->slopes[i * (d + 1) + j] * (values[j * n] - values[0]);
                defects[i] = numbers[k] * e->field[place_of(e, c, k, i) * n + a] - slope;
            }
            for (int64_t i = 0; i < e->R; i++)
                residual[(k * e->R + i) * n + a] = -product(c->increments + i * c->count, defects, c->count, 1);
            for (int64_t i = 0; i < c->q; i++)
                between[(k * c->q + i) * n + a] = product(c->between + i * c->count, defects, c->count, 1);
        }
    return 0;
}

/* The largest change of a state relative to the size of its component, in a step and, where there is what z misses between
   its values, (K q, n), less that at the inner check points; NaN where one is none. */
static double change_of(const equations *e, const checks *c, const double *step, const double *between,
                        const double *sizes)
{
    const int64_t n = e->n, d = e->d;
    double most = 0.0, none = 0.0;
    for (int64_t a = 0; a < n; a++) {
        double of_state = 0.0;
        for (int64_t i = 0; i <= e->K * e->R; i++) {
            const double x = fabs(step[i * n + a]);
            of_state = x > of_state ? x : of_state, none += x * 0.0;
        }
        for (int64_t k = 0; between && k < e->K; k++)
            for (int64_t i = 0; i < c->q; i++) {
                const double *values = step + k * e->R * n + a;
                const double x = fabs(product(c->values + i * (d + 1), values, d + 1, n) - between[(k * c->q + i) * n + a]);
                of_state = x > of_state ? x : of_state, none += x * 0.0;
            }
        const double change = of_state / sizes[a];
        most = change > most ? change : most, none += change * 0.0;
    }
    return most + none;
}

KERNEL(collocation_change)(const equations *e, const checks *c, const double *step, const double *between,
                           const double *sizes, double *change)
{
    *change = change_of(e, c, step, between, sizes);
    return 0;
}

/* The step to the solution of a method of twice as many stages, (size), what z misses between its values, and the largest
   changes by both and by what factors of a Jacobian nearby have left of the step. `room` has 2 size numbers. */
KERNEL(collocation_improved)(const equations *e, const checks *c, const void *layout, double *memory, const double *z,
                             const double *numbers, const double *residual, const double *nonzeros, const double *sizes,
                             double *step, double *between, double *changes, double *room)
{
    const int64_t count = e->n * e->K * e->R + e->conditions + e->integrals;
    double *right = room, *more = room + count + 1;
    NAMED(collocation_missed)(e, c, z, numbers, right, between);
    for (int64_t i = 0; i < count; i++)
        right[i] += residual[i];
    right[count] = more[count] = 0.0;
    memcpy(step, right, (size_t)(count + 1) * sizeof(double));
    NAMED(collocation_solve)(layout, memory, 1, step);
    NAMED(collocation_times)(e, nonzeros, step, more);
    for (int64_t i = 0; i < count; i++)
        more[i] = right[i] - more[i];
    NAMED(collocation_solve)(layout, memory, 1, more);
    for (int64_t i = 0; i <= count; i++)
        step[i] += more[i];
    changes[0] = change_of(e, c, step, between, sizes);
    changes[1] = change_of(e, c, more, 0, sizes);
    return 0;
}

/* Units ------------------------------------------------------------------------------------------------------------ */

/* What unknowns are measured by, see zero/stated_problem.py: each of the n states by its largest value in all `columns`
   and no less than its floor, of those without a floor by `least` of the largest; the m scalars but the last by their
   values and no less than a floor. Sizes of residuals are floors over `part`. */
typedef struct {
    int64_t n, columns, m;
    const double *floors, *scalar_floors; /* (n), (m - 1) */
    double least, part;
} units;

static double sizes_of(const units *u, const double *z, double *restrict sizes)
{
    double most = 0.0;
    memset(sizes, 0, (size_t)u->n * sizeof(double));
    for (int64_t i = 0; i < u->columns; i++, z += u->n)
        for (int64_t a = 0; a < u->n; a++) {
            const double x = fabs(z[a]);
            sizes[a] = x > sizes[a] || x != x ? x : sizes[a]; /* what is no number stays */
        }
    for (int64_t a = 0; a < u->n; a++) {
        sizes[a] = u->floors[a] > sizes[a] ? u->floors[a] : sizes[a];
        most = sizes[a] > most || sizes[a] != sizes[a] ? sizes[a] : most;
    }
    for (int64_t a = 0; a < u->n; a++)
        if (!(u->floors[a] > 0.0 || sizes[a] > u->least * most))
            sizes[a] = u->least * most;
    return most;
}

static double scalar_size(const units *u, const double *z, int64_t i)
{
    const double x = fabs(z[u->columns * u->n + i]), floor = u->scalar_floors[i];
    return floor > x ? floor : x;
}

/* Sizes of the states, (n). */
KERNEL(collocation_sizes)(const units *u, const double *z, double *sizes)
{
    sizes_of(u, z, sizes);
    return 0;
}

/* The diagonal of the metric, (size), for a scale of the last scalar. */
KERNEL(collocation_metric)(const units *u, const double *z, double scale, double *weights)
{
    double *first = weights;
    sizes_of(u, z, first);
    for (int64_t a = 0; a < u->n; a++)
        first[a] = 1.0 / (first[a] * first[a]) / (double)u->columns;
    for (int64_t i = 1; i < u->columns; i++)
        memcpy(first + i * u->n, first, (size_t)u->n * sizeof(double));
    weights += u->columns * u->n;
    for (int64_t i = 0; i < u->m - 1; i++) {
        const double size = scalar_size(u, z, i);
        *weights++ = 1.0 / (size * size);
    }
    *weights = 1.0 / (scale * scale);
    return 0;
}

/* The largest speed of the states along the mesh over the mean one, `gaps` between the columns; `sizes` is room. */
KERNEL(collocation_speed)(const units *u, const double *z, const double *gaps, double *sizes, double *speed)
{
    double whole = 0.0, most = 0.0;
    sizes_of(u, z, sizes);
    for (int64_t i = 0; i < u->columns - 1; i++, z += u->n) {
        double way = 0.0;
        for (int64_t a = 0; a < u->n; a++) {
            const double move = (z[u->n + a] - z[a]) / sizes[a];
            way += move * move;
        }
        way = sqrt(way), whole += way;
        most = way / gaps[i] > most ? way / gaps[i] : most;
    }
    *speed = whole > 0.0 ? most / whole : 0.0;
    return 0;
}

/* Newton's method ---------------------------------------------------------------------------------------------------*/

/* Its limits, named as in solve/newton.py, which takes the same steps by numpy. */
typedef struct {
    int64_t steps;
    double tolerance, shrink, negligible, chord, fast, safety, slow;
} newton;

enum { CONVERGED, DIVERGED, SLOW, SINGULAR };

/* Sizes of all unknowns, (size); returns the least of residuals of conditions. */
static double all_sizes(const units *u, const double *z, double *sizes)
{
    const double most = sizes_of(u, z, sizes);
    double least = 1.0, *scalars = sizes + u->n * u->columns;
    for (int64_t a = 0; a < u->n; a++) {
        if (u->floors[a] == 0.0)
            sizes[a] = most;
        else if (u->floors[a] / u->part < least)
            least = u->floors[a] / u->part;
    }
    for (int64_t i = 1; i < u->columns; i++)
        memcpy(sizes + i * u->n, sizes, (size_t)u->n * sizeof(double));
    for (int64_t i = 0; i < u->m - 1; i++)
        scalars[i] = scalar_size(u, z, i);
    scalars[u->m - 1] = 1.0;
    return least;
}

/* Newton's method from z, with row . z = value, in steps whose length the `weights` give. Units are those of unknowns,
   1 where `u` is 0. Returns how it ends: z is then where it came to, and there are the residual and the non-zeros; the
   factors in `memory` are of a matrix at z or nearby; in `found` are the number of steps and the sign of the
   determinant. `room` has 6 size numbers. */
KERNEL(collocation_corrected)(const equations *e, const void *layout, const units *u, const newton *by,
                              const double *numbers, const double *weights, const double *row, double value,
                              double *memory, double *z, double *residual, double *nonzeros, double *found, double *room)
{
    const int64_t count = e->n * e->K * e->R + e->conditions + e->integrals, size = count + 1;
    double *step = room, *sizes = room + size, *x = room + 2 * size, least = 1.0, last = INFINITY;
    int factored = 0, reuse = 0;
    for (int64_t i = 1; i <= by->steps; i++) {
        found[0] = (double)i;
        NAMED(collocation_equations)(e, z, numbers, residual, nonzeros);
        if (!factored || !reuse) {
            least = u ? all_sizes(u, z, sizes) : 1.0;
            if (NAMED(collocation_factors)(layout, nonzeros, row, u ? sizes : 0, least, memory, found + 1, x, x + 3 * size))
                return SINGULAR;
            factored = 1;
        }
        memcpy(step, residual, (size_t)count * sizeof(double));
        step[count] = product(row, z, size, 1) - value;
        NAMED(collocation_solve)(layout, memory, 1, step);
        const double length = length_of(weights, step, size);
        if (reuse && !(length <= by->slow * last)) {
            reuse = 0;
            continue;
        }
        if (length <= by->negligible * by->tolerance) /* the equations at z are known */
            return CONVERGED;
        for (int64_t k = 0; k < size; k++)
            z[k] -= step[k];
        if (!(length < INFINITY) || length > (10.0 * last > 1.0 ? 10.0 * last : 1.0) || length > by->shrink * last)
            return DIVERGED;
        const double before = last < 1.0 ? last : 1.0;
        const int quadratic = !reuse && length < by->chord && length * length / before < 0.1 * by->tolerance;
        const int linear = reuse && by->safety * length * length / last < 0.1 * by->tolerance;
        if (length <= by->tolerance || quadratic || linear) {
            NAMED(collocation_equations)(e, z, numbers, residual, nonzeros);
            return CONVERGED;
        }
        reuse = length <= by->chord || length <= by->fast * before;
        last = length;
    }
    return SLOW;
}

/* Intervals with the polynomials on them: through all R + 1 values of one, at `support`, by barycentric weights, and of
   degree d through the first d + 1, with their weights in the coefficient of degree d. */
typedef struct {
    int64_t n, K, R, d;
    const double *support, *barycentric, *leading;
} intervals;

/* States of `many` solutions z, each `apart` numbers after the one before, at places between the edges of K intervals, to
   `found`, each `after` numbers behind the one before: by the polynomials through all values of an interval, which are
   at `support`, R + 1 of them. */
KERNEL(collocation_interpolated)(const intervals *of, const double *edges, int64_t many, const double *z,
                                 int64_t apart, int64_t count, const double *at, double *found, int64_t after)
{
    const int64_t n = of->n, K = of->K, R = of->R;
    for (int64_t p = 0, k = 0; p < count; p++, found += n) {
        while (k < K - 1 && at[p] >= edges[k + 1])
            k++;
        while (k > 0 && at[p] < edges[k])
            k--;
        double weights[VALUES], sum = 0.0;
        const double own = (at[p] - edges[k]) / (edges[k + 1] - edges[k]);
        int64_t hit = -1;
        for (int64_t j = 0; j <= R; j++) {
            const double offset = own - of->support[j];
            if (fabs(offset) < ON_VALUE)
                hit = j;
            weights[j] = of->barycentric[j] / offset;
            sum += weights[j];
        }
        for (int64_t v = 0; v < many; v++) {
            const double *values = z + v * apart + k * R * n;
            for (int64_t a = 0; a < n; a++)
                found[v * after + a] = hit < 0 ? product(weights, values + a, R + 1, n) / sum : values[hit * n + a];
        }
    }
    return 0;
}

/* Derivatives of the field by the first n states at `count` places on the polynomials, dense. */
void NAMED(collocation_jacobians_at)(const void *of, const void *polynomials, const double *edges, const double *z,
                                     const double *numbers, int64_t count, const double *at, int64_t n,
                                     const int64_t *rows, const int64_t *columns, double *jacobians)
{
    const equations *e = of;
    places these = *e->of_field;
    give_numbers(e, &these, z, numbers);
    for (int64_t most = e->K * e->d + 1; count > 0; count -= most, at += most, jacobians += most * n * n) {
        these.count = count < most ? count : most;
        memcpy(these.argument[0], at, (size_t)these.count * sizeof(double));
        NAMED(collocation_interpolated)(polynomials, edges, 1, z, 0, these.count, at, these.argument[1], 0);
        NAMED(at_places)(&these);
        dense(e, these.count, n, rows, columns, jacobians);
    }
}

/* The equations between the ends of intervals alone, by what `condense` has of these: non-zeros by columns, each at its
   place in `order`, which lists them by intervals, then those of conditions and of integrals; and the residual. */
static void between_ends(const equations *e, const double *lengths, const double *maps, const double *inner,
                         const double *residual, const int64_t *order, double *nonzeros, double *right)
{
    const int64_t n = e->n, m = e->m, d = e->d, own = e->integrals, w = n + m + 1, bottom = n * e->K * e->R;
    const double *weights = e->extended + (e->R - 1) * d;
    double by_s[VALUES] = {0.0};
    for (int64_t i = 0; i < e->K * n; i++, maps += w) {
        nonzeros[*order++] = 1.0;
        for (int64_t c = 0; c < n + m; c++)
            nonzeros[*order++] = -maps[c];
        right[i] = maps[n + m];
    }
    right += e->K * n;
    for (int end = 0; end < 3; end++)
        for (int64_t i = 0; i < e->by_ends[end]; i++)
            nonzeros[*order++] = e->by_end[end][i];
    memcpy(right, residual + bottom, (size_t)(e->conditions + own) * sizeof(double));
    right += e->conditions;
    for (int64_t k = 0; k < e->K; k++)
        for (int64_t i = 0; i < own; i++) {
            double row[2 * VALUES] = {0.0};
            for (int64_t j = 0; j < d; j++)
                for (int64_t a = 0; a < n; a++) {
                    const double by_x = e->by_x[((k * d + j) * n + a) * own + i], *at = inner + ((k * d + j) * n + a) * w;
                    for (int64_t c = 0; c < w; c++)
                        row[c] += lengths[k] * weights[j] * by_x * at[c];
                }
            for (int64_t c = 0; c < n; c++)
                nonzeros[*order++] = row[c];
            for (int64_t c = 0; c < m; c++) {
                by_s[i * m + c] += row[n + c];
                for (int64_t j = 0; j < d; j++)
                    by_s[i * m + c] += lengths[k] * weights[j] * e->by_s[((k * d + j) * m + c) * own + i];
            }
            right[i] -= row[n + m];
        }
    for (int64_t i = 0; i < own * m; i++)
        nonzeros[*order++] = by_s[i];
}

/* One Newton step from a solution of coarser equations, to z on these, (size): with the last scalar held, or, where there
   is a `way`, brought back to it along that. `given` are one or two rows of `apart` numbers, the solution and its way,
   `weights` are of the n states at ends of intervals and of the scalars, (n + m), by which the way is measured. A change
   of the last scalar on the way below `least` is that of a fold. Returns 1 where the matrix is singular but for rounding,
   see `collocation_factors`, which takes the equations between ends of intervals, `layout`. */
KERNEL(collocation_newton)(const equations *e, const void *polynomials, const double *edges, const double *given,
                           int64_t rows_given, int64_t apart, const double *weights, double least, const double *numbers,
                           int64_t count, const double *at, const int64_t *rows, const int64_t *columns,
                           const void *method, const void *layout, const int64_t *order, int64_t nonzeros_count,
                           double *memory, double *z, double *room)
{
    const int64_t n = e->n, m = e->m, K = e->K, d = e->d, R = e->R, w = n + m + 1, size = n * (K * R + 1) + m;
    const int64_t short_size = n * (K + 1) + m, equations_count = size - 1;
    double *both = room, *residual = both + 2 * size, *jacobians = residual + equations_count, sign;
    double *maps = jacobians + K * d * n * n, *inner = maps + K * n * w, *nonzeros = inner + K * d * n * w;
    double *row = nonzeros + nonzeros_count, *x = row + short_size, *right = x + 3 * short_size, *rest = right + short_size;
    NAMED(collocation_interpolated)(polynomials, edges, rows_given, given, apart, count, at, both, size);
    for (int64_t i = 0; i < rows_given; i++)
        memcpy(both + (i + 1) * size - m, given + (i + 1) * apart - m, (size_t)m * sizeof(double));
    evaluate_all(e, both, numbers);
    residual_of(e, both, numbers, residual);
    dense(e, K * d, n, rows, columns, jacobians);
    NAMED(condense)(method, K, n, m, numbers, jacobians, e->by_scalars, residual, R * n, maps, inner, rest);
    between_ends(e, numbers, maps, inner, residual, order, nonzeros, right);
    const double *way = rows_given > 1 ? both + size : NULL;
    memset(row, 0, (size_t)short_size * sizeof(double)), row[short_size - 1] = 1.0;
    for (int64_t k = 0; way && k <= K; k++)
        for (int64_t a = 0; a < n; a++)
            row[k * n + a] = weights[a] * way[k * R * n + a];
    for (int64_t c = 0; way && c < m; c++)
        row[(K + 1) * n + c] = weights[n + c] * way[size - m + c];
    if (NAMED(collocation_factors)(layout, nonzeros, row, NULL, 1.0, memory, &sign, x, rest))
        return 1;
    right[short_size - 1] = 0.0;
    NAMED(collocation_solve)(layout, memory, 1, right);

    /* the step, and z without it */
    for (int64_t k = 0; k <= K; k++) {
        const double *start = right + k * n, *s = right + (K + 1) * n;
        memcpy(z + k * R * n, start, (size_t)n * sizeof(double));
        for (int64_t i = 0; k < K && i < (R - 1) * n; i++) {
            const double *from = inner + (k * d * n + i) * w;
            double sum = from[n + m];
            for (int64_t c = 0; c < n; c++)
                sum += from[c] * start[c];
            for (int64_t c = 0; c < m; c++)
                sum += from[n + c] * s[c];
            z[k * R * n + n + i] = sum;
        }
    }
    memcpy(z + size - m, right + (K + 1) * n, (size_t)m * sizeof(double));
    const int back = way && fabs(way[size - 1]) > least;
    const double along = back ? z[size - 1] / way[size - 1] : 0.0;
    for (int64_t i = 0; i < size; i++)
        z[i] = both[i] - (back ? z[i] - along * way[i] : z[i]);
    if (back)
        z[size - 1] = both[size - 1];
    return 0;
}

/* Wanted density of intervals, see zero/mesh.py, which has the same by numpy: of states z in sizes of the components, by
   the jumps of their derivatives of order d, whose rounding is `noise`. `room` has 3 K numbers. */
enum { ROUNDS = 3 };

KERNEL(collocation_density)(const intervals *of, const double *lengths, const double *edges, const double *z,
                            const double *sizes, double noise, double floor, double ratio, double *wanted, double *room)
{
    const int64_t n = of->n, K = of->K, d = of->d;
    double *needed = room, *forward = room + K, *middles = room + 2 * K, least = INFINITY, total;
    int64_t resolved = 0;
    for (int64_t k = 0; k < K; k++)
        wanted[k] = 1.0, middles[k] = edges[k + 1] - 0.5 * lengths[k];
    for (int64_t k = 0; k < K - 1; k++) { /* forward: jumps, then slopes between two intervals */
        const double before = pow(lengths[k], -(double)d), after = pow(lengths[k + 1], -(double)d);
        const double *values = z + k * of->R * n, *next = values + of->R * n, rounding = noise * (after + before);
        forward[k] = 0.0;
        for (int64_t a = 0; a < n; a++) {
            const double jump = fabs(product(of->leading, next + a, d + 1, n) * after -
                                     product(of->leading, values + a, d + 1, n) * before) / sizes[a];
            forward[k] = jump > forward[k] ? jump : forward[k];
        }
        resolved |= forward[k] > rounding;
        least = rounding < least ? rounding : least;
        needed[k] = rounding;
    }
    if (!resolved)
        return 0;
    for (int64_t k = 0; k < K - 1; k++) {
        const double jump = forward[k] > 2.0 * needed[k] ? forward[k] - needed[k] : least; /* noise draws none */
        forward[k] = jump / (0.5 * (lengths[k + 1] + lengths[k]));
    }
    for (int64_t k = 0; k < K; k++) {
        const double left = forward[k ? k - 1 : 0], right = forward[k < K - 1 ? k : K - 2];
        wanted[k] = needed[k] = pow(k && k < K - 1 ? 0.5 * (left + right) : k ? left : right, 1.0 / (double)(d + 1));
    }
    for (int round = 0; round < ROUNDS; round++) { /* floor and rate depend on the mean of the result */
        total = product(lengths, wanted, K, 1);
        const double rate = log(ratio) * (double)K / total;
        double most = INFINITY;
        for (int64_t k = 0; k < K; k++) {
            const double own = 1.0 / (needed[k] > floor * total ? needed[k] : floor * total), low = own - rate * middles[k];
            most = low < most ? low : most;
            forward[k] = rate * middles[k] + most, wanted[k] = own;
        }
        most = INFINITY;
        for (int64_t k = K - 1; k >= 0; k--) {
            const double high = wanted[k] + rate * middles[k];
            most = high < most ? high : most;
            const double backward = most - rate * middles[k];
            wanted[k] = 1.0 / (forward[k] < backward ? forward[k] : backward);
        }
    }
    return 0;
}
