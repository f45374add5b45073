/* Factors and solutions of collocation equations closed by one more row; see solve/bordered.py.

   Unknowns x_0, X_01 .. X_0q, x_1, ..., x_K in the order of time, n numbers each, then m scalars s. Equations: R n of
   each interval, R = q + 1, in its own unknowns and s; conditions in x_0, x_K and s; long rows, integrals and the
   closing row, in all unknowns. Within each interval Gaussian elimination with exchanges of rows takes the q n inner
   unknowns out (Ascher, Mattheij and Russell 1995, section 7.2) and leaves n rows

       S_k x_k + E_k x_(k+1) + G_k s = r_k.

   Then x_1 .. x_(K-1) in turn, each
   from 2 n rows (Wright 1993), and what is left is dense in x_0, x_K and s. Long rows are eliminated along, as
   further rows of every block that are no pivots. Rows are divided by their largest terms in units that balance the
   derivatives by one another, all powers of 2 (Osborne 1960): no pivot is chosen by the units of the states.

   Blocks are stored by columns, as many numbers each as is a multiple of EIGHT; a chunk is what a register holds. */

#include <math.h>
#include <string.h>

#include "kernel.h"

static const double ROUNDING = 1e-13; /* of the entries of a scalar in long rows */
enum { EIGHT = 8, PANEL = 4, TOGETHER = 4, ALIGNED = 64, SWEEPS = 20 };
typedef double chunk __attribute__((vector_size(REGISTER * sizeof(double)), may_alias));
typedef int64_t bits __attribute__((vector_size(REGISTER * sizeof(double)), may_alias));

typedef struct {
    int64_t n, K, R, m, conditions, longs, nonzeros; /* long rows: integrals and the closing row */
    int64_t heights[3], widths[3];                   /* of the blocks of an interval, of a node, and of the last one */
    /* Where parts of the memory begin: blocks of intervals, of nodes, the last one, long rows at nodes and scalars,
       scales of rows and units, room, and orders of rows, which are integers. */
    int64_t at[7];
    const int32_t *target, *rows; /* of the non-zeros of the Jacobian, by columns: places in the memory, and rows */
    const int64_t *columns;       /* where each column of them begins, and the last one ends */
    double singular, accurate;
    const double *probe; /* residuals of size 1 in general position */
} layout;

typedef struct {
    double *blocks, *nodes, *last, *longs, *scales, *units, *room;
    int32_t *orders, *node_orders, *last_order;
} factors;

static factors within(const layout *l, double *memory)
{
    double *base = (double *)(((uintptr_t)memory + ALIGNED - 1) / ALIGNED * ALIGNED);
    const int64_t *at = l->at, rows = l->n * l->R;
    factors f = {base + at[0], base + at[1], base + at[2], base + at[3], base + at[4], 0, base + at[5], 0, 0, 0};
    f.units = f.scales + l->n * l->K * l->R + l->n + l->m;
    f.orders = (int32_t *)(base + at[6]);
    f.node_orders = f.orders + l->K * rows, f.last_order = f.node_orders + (l->K - 1) * 2 * l->n;
    return f;
}

/* Elimination in one block ------------------------------------------------------------------------------------------*/

static const int64_t BEHIND[2 * EIGHT] = {0, 0, 0, 0, 0, 0, 0, 0, -1, -1, -1, -1, -1, -1, -1, -1};

/* Those of the numbers of a chunk from number `first` of it on, and those before it; zeros elsewhere. */
static inline chunk from(chunk x, int64_t first)
{
    bits kept;
    memcpy(&kept, BEHIND + EIGHT - first, sizeof kept);
    return (chunk)((bits)x & kept);
}

static inline chunk until(chunk x, int64_t first)
{
    bits left;
    memcpy(&left, BEHIND + EIGHT - first, sizeof left);
    return (chunk)((bits)x & ~left);
}

static inline const chunk *chunks(const double *x) { return (const chunk *)x; }

static inline void exchange(double *x, int64_t i, int64_t j)
{
    const double other = x[i];
    x[i] = x[j], x[j] = other;
}

/* One column x by `count` pivots from row k on, whose columns begin at `pivots`, and their exchanges of rows. */
static inline __attribute__((always_inline)) void update(int64_t height, int64_t k, const int count,
                                                         const double *pivots, const int32_t *with, double *x)
{
    double u[PANEL];
    for (int j = 0; j < count; j++)
        if (with[j] != k + j)
            exchange(x, k + j, with[j]);
    for (int j = 0; j < count; j++) {
        u[j] = x[k + j];
        for (int i = 0; i < j; i++)
            u[j] -= pivots[i * height + k + j] * u[i];
        if (j)
            x[k + j] = u[j];
    }
    int64_t i = (k + count) / REGISTER * REGISTER;
    const int64_t head = (k + count) % REGISTER;
    if (head && i < height) {
        chunk y = *chunks(x + i);
        for (int j = 0; j < count; j++)
            y -= from(*chunks(pivots + j * height + i), head) * u[j];
        *(chunk *)(x + i) = y;
        i += REGISTER;
    }
    for (; i < height; i += REGISTER) {
        chunk y = *chunks(x + i);
        for (int j = 0; j < count; j++)
            y -= *chunks(pivots + j * height + i) * u[j];
        *(chunk *)(x + i) = y;
    }
}

static void update_all(int64_t height, int64_t k, int64_t count, const double *pivots, const int32_t *with,
                       int64_t columns, double *x)
{
    for (; columns > 0; columns--, x += height)
        switch (count) {
        case 4: update(height, k, 4, pivots, with, x); break;
        case 3: update(height, k, 3, pivots, with, x); break;
        case 2: update(height, k, 2, pivots, with, x); break;
        case 1: update(height, k, 1, pivots, with, x); break;
        default: break;
        }
}

/* Factors of a block in its place, with `pivots` pivots in its first columns, from its first `rows` rows. The inverses
   of the pivots stand in their places. `order` is that of the rows. Returns the number of exchanges with that of
   negative pivots, or -1 where a pivot vanishes. */
static int64_t eliminate(int64_t pivots, int64_t rows, int64_t height, int64_t width, double *block, int32_t *order)
{
    int64_t odd = 0;
    for (int64_t i = 0; i < rows; i++)
        order[i] = (int32_t)i;
    for (int64_t first = 0; first < pivots; first += PANEL) {
        const int64_t count = pivots - first < PANEL ? pivots - first : PANEL;
        double *panel = block + first * height;
        int32_t with[PANEL];
        for (int64_t j = 0; j < count; j++) {
            const int64_t k = first + j;
            double *x = panel + j * height;
            int64_t p = k;
            double most = fabs(x[k]);
            for (int64_t i = k + 1; i < rows; i++)
                if (fabs(x[i]) > most)
                    most = fabs(x[i]), p = i;
            with[j] = (int32_t)p;
            if (x[p] == 0.0)
                return -1;
            odd += (p != k) + (x[p] < 0.0);
            if (p != k) {
                for (double *other = block; other < panel + count * height; other += height)
                    exchange(other, k, p);
                const int32_t row = order[k];
                order[k] = order[p], order[p] = row;
            }
            const double inverse = 1.0 / x[k];
            int64_t i = (k + 1) / REGISTER * REGISTER;
            if (i < height) {
                const chunk head = *chunks(x + i);
                *(chunk *)(x + i) = (chunk)((bits)until(head, (k + 1) % REGISTER) |
                                            (bits)from(head * inverse, (k + 1) % REGISTER));
            }
            for (i += REGISTER; i < height; i += REGISTER)
                *(chunk *)(x + i) *= inverse;
            x[k] = inverse;
            update_all(height, k, 1, x, &(int32_t){(int32_t)k}, count - 1 - j, x + height);
        }
        update_all(height, first, count, panel, with, width - first - count, panel + count * height);
    }
    return odd;
}

/* Right-hand sides y, (count, height), in the order of the rows: what the lower factor makes of them. */
static inline __attribute__((always_inline)) void lower(int64_t pivots, int64_t height, const double *block,
                                                        const int count, double *y)
{
    for (int64_t k = 0; k < pivots; k++) {
        const double *x = block + k * height;
        const int64_t start = (k + 1) / REGISTER * REGISTER;
        double value[TOGETHER];
        for (int r = 0; r < count; r++)
            value[r] = y[r * height + k];
        if (start >= height)
            break;
        const chunk head = from(*chunks(x + start), (k + 1) % REGISTER);
        for (int r = 0; r < count; r++)
            *(chunk *)(y + r * height + start) -= head * value[r];
        for (int64_t i = start + REGISTER; i < height; i += REGISTER)
            for (int r = 0; r < count; r++)
                *(chunk *)(y + r * height + i) -= *chunks(x + i) * value[r];
    }
}

/* Unknowns x, (pivots) each `apart` numbers after those before, from y and the columns behind the pivots, already
   taken off. */
static inline __attribute__((always_inline)) void upper(int64_t pivots, int64_t height, const double *block,
                                                        const int count, double *y, double *x, int64_t apart)
{
    for (int64_t k = pivots - 1; k >= 0; k--) {
        const double *column = block + k * height;
        const int64_t end = k / REGISTER * REGISTER;
        double value[TOGETHER];
        for (int r = 0; r < count; r++)
            x[r * apart + k] = value[r] = y[r * height + k] * column[k];
        const chunk head = until(*chunks(column + end), k % REGISTER);
        for (int r = 0; r < count; r++)
            *(chunk *)(y + r * height + end) -= head * value[r];
        for (int64_t i = 0; i < end; i += REGISTER)
            for (int r = 0; r < count; r++)
                *(chunk *)(y + r * height + i) -= *chunks(column + i) * value[r];
    }
}

/* y less n columns times values x, (count, n), each `apart` numbers after those before. */
static inline __attribute__((always_inline)) void take_off(int64_t pivots, int64_t height, const double *columns,
                                                           int64_t n, const int count, double *y, const double *x,
                                                           int64_t apart)
{
    for (int64_t i = 0; i < pivots; i += REGISTER)
        for (int r = 0; r < count; r++) {
            chunk sum = *chunks(y + r * height + i);
            for (int64_t c = 0; c < n; c++)
                sum -= *chunks(columns + c * height + i) * x[r * apart + c];
            *(chunk *)(y + r * height + i) = sum;
        }
}

/* Solutions of `count` systems in the place of their right-hand sides, each `apart` numbers after the one before. */
static inline __attribute__((always_inline)) void solve(const layout *l, factors f, const int count, double *x,
                                                        int64_t apart)
{
    const int64_t n = l->n, m = l->m, longs = l->longs, inner = n * (l->R - 1), rows = n * l->R, K = l->K;
    const int64_t *height = l->heights, *width = l->widths, bottom = K * rows, last = 2 * n + m;
    double *y = f.room, *front = y + TOGETHER * (height[0] + height[1] + height[2]), *added = front + TOGETHER * last;
    memset(added, 0, (size_t)(TOGETHER * longs) * sizeof(double));
    for (int64_t k = 0; k < K; k++) { /* the inner unknowns' right-hand sides go to their places, r_k to that of x_k */
        const double *scale = f.scales + k * rows;
        const int32_t *order = f.orders + k * rows;
        memset(y, 0, (size_t)(count * height[0]) * sizeof(double));
        for (int r = 0; r < count; r++)
            for (int64_t i = 0; i < rows; i++)
                y[r * height[0] + i] = x[r * apart + k * rows + order[i]] * scale[i];
        lower(inner, height[0], f.blocks + k * height[0] * width[0], count, y);
        for (int r = 0; r < count; r++) {
            double *to = x + r * apart + k * rows;
            const double *of = y + r * height[0];
            memcpy(to + n, of, (size_t)inner * sizeof(double));
            memcpy(k ? to : front + r * n, of + inner, (size_t)n * sizeof(double));
            for (int64_t i = 0; i < longs; i++)
                added[r * longs + i] += of[rows + i];
        }
        if (k == 0)
            continue;
        order = f.node_orders + (k - 1) * 2 * n;
        memset(y, 0, (size_t)(count * height[1]) * sizeof(double));
        for (int r = 0; r < count; r++)
            for (int64_t i = 0; i < 2 * n; i++)
                y[r * height[1] + i] =
                    order[i] < n ? front[r * n + order[i]] : x[r * apart + k * rows + order[i] - n];
        lower(n, height[1], f.nodes + (k - 1) * height[1] * width[1], count, y);
        for (int r = 0; r < count; r++) {
            const double *of = y + r * height[1];
            memcpy(x + r * apart + k * rows, of, (size_t)n * sizeof(double));
            memcpy(front + r * n, of + n, (size_t)n * sizeof(double));
            for (int64_t i = 0; i < longs; i++)
                added[r * longs + i] += of[2 * n + i];
        }
    }
    memset(y, 0, (size_t)(count * height[2]) * sizeof(double));
    double *ends = front; /* x_0, x_K and s, (count, last) */
    for (int r = 0; r < count; r++)
        for (int64_t i = 0; i < last; i++) {
            const int64_t row = f.last_order[i] - n, none = row - l->conditions;
            const double value = row < 0 ? front[r * n + row + n] : x[r * apart + bottom + row];
            y[r * height[2] + i] =
                (none < 0 ? value : value + added[r * longs + none]) * (row < 0 ? 1.0 : f.scales[bottom + row]);
        }
    lower(last, height[2], f.last, count, y);
    upper(last, height[2], f.last, count, y, ends, last);
    for (int r = 0; r < count; r++) {
        memcpy(x + r * apart, ends + r * last, (size_t)n * sizeof(double));
        memcpy(x + r * apart + bottom, ends + r * last + n, (size_t)(n + m) * sizeof(double));
    }
    for (int64_t k = K - 1; k >= 0; k--) { /* x_k, then what is between x_k and x_(k+1) */
        double *here = x + k * rows;
        if (k) {
            const double *node = f.nodes + (k - 1) * height[1] * width[1], *beside = node + n * height[1];
            for (int r = 0; r < count; r++)
                memcpy(y + r * height[1], here + r * apart, (size_t)n * sizeof(double));
            take_off(n, height[1], beside, n, count, y, x, apart);
            take_off(n, height[1], beside + n * height[1], n, count, y, here + rows, apart);
            take_off(n, height[1], beside + 2 * n * height[1], m, count, y, x + bottom + n, apart);
            upper(n, height[1], node, count, y, here, apart);
        }
        const double *block = f.blocks + k * height[0] * width[0], *beside = block + inner * height[0];
        for (int r = 0; r < count; r++)
            memcpy(y + r * height[0], here + n + r * apart, (size_t)inner * sizeof(double));
        take_off(inner, height[0], beside, n, count, y, here, apart);
        take_off(inner, height[0], beside + n * height[0], n, count, y, here + rows, apart);
        take_off(inner, height[0], beside + 2 * n * height[0], m, count, y, x + bottom + n, apart);
        upper(inner, height[0], block, count, y, here + n, apart);
    }
}

static void solve_all(const layout *l, factors f, int64_t count, double *x)
{
    const int64_t size = l->n * (l->K * l->R + 1) + l->m;
    while (count > 0) {
        const int64_t these = count < TOGETHER ? count : TOGETHER;
        switch (these) {
        case 4: solve(l, f, 4, x, size); break;
        case 3: solve(l, f, 3, x, size); break;
        case 2: solve(l, f, 2, x, size); break;
        default: solve(l, f, 1, x, size); break;
        }
        count -= these, x += these * size;
    }
}

KERNEL(collocation_solve)(const void *of, double *memory, int64_t count, double *x)
{
    const layout *l = of;
    solve_all(l, within(l, memory), count, x);
    return 0;
}

/* Transposed: by the same factors, with the columns of what is above ------------------------------------------------ */

static inline double dot(int64_t count, const double *x, const double *y)
{
    chunk sums = {0};
    double sum = 0.0;
    for (int64_t i = 0; i < count; i += REGISTER)
        sums += *chunks(x + i) * *chunks(y + i);
    for (int i = 0; i < REGISTER; i++)
        sum += sums[i];
    return sum;
}

/* y, (height), whose first `pivots` numbers solve U^T y = x; the others are zero. */
static void upper_transposed(int64_t pivots, int64_t height, const double *block, const double *x, double *y)
{
    memset(y, 0, (size_t)height * sizeof(double));
    for (int64_t k = 0; k < pivots; k++)
        y[k] = (x[k] - dot(height, block + k * height, y)) * block[k * height + k];
}

/* x, (n), less what n columns make of y. */
static void take_off_transposed(int64_t height, const double *columns, int64_t n, const double *y, double *x)
{
    for (int64_t c = 0; c < n; c++)
        x[c] -= dot(height, columns + c * height, y);
}

/* The first `pivots` numbers of y, zero before, from x and the others, which stay, by the transposed lower factor. */
static void lower_transposed(int64_t pivots, int64_t height, const double *block, const double *x, double *y)
{
    for (int64_t k = pivots - 1; k >= 0; k--)
        y[k] = x[k] - dot(height, block + k * height, y);
}

/* The solution of the transposed system in the place of its right-hand side: that is in the order of the unknowns, the
   solution in that of the equations. */
static void solve_transposed(const layout *l, factors f, double *x)
{
    const int64_t n = l->n, m = l->m, longs = l->longs, inner = n * (l->R - 1), rows = n * l->R, K = l->K;
    const int64_t *height = l->heights, *width = l->widths, bottom = K * rows, last = 2 * n + m;
    double *y = f.room, *ends = y + height[0] + height[1] + height[2], *front = ends + height[2], *own = front + n;
    const double *added = x + bottom + l->conditions; /* that of the long rows, which all blocks add to */
    memcpy(ends, x, (size_t)n * sizeof(double)), memcpy(ends + n, x + bottom, (size_t)(n + m) * sizeof(double));
    for (int64_t k = 0; k < K; k++) { /* the upper factor, in the order of elimination */
        const double *block = f.blocks + k * height[0] * width[0], *beside = block + inner * height[0];
        double *here = x + k * rows, *next = k < K - 1 ? here + rows : ends + n;
        upper_transposed(inner, height[0], block, here + n, y);
        memcpy(here + n, y, (size_t)inner * sizeof(double));
        take_off_transposed(height[0], beside, n, y, k ? here : ends);
        take_off_transposed(height[0], beside + n * height[0], n, y, next);
        take_off_transposed(height[0], beside + 2 * n * height[0], m, y, ends + 2 * n);
        if (k == 0)
            continue;
        block = f.nodes + (k - 1) * height[1] * width[1], beside = block + n * height[1];
        upper_transposed(n, height[1], block, here, y);
        memcpy(here, y, (size_t)n * sizeof(double));
        take_off_transposed(height[1], beside, n, y, ends);
        take_off_transposed(height[1], beside + n * height[1], n, y, next);
        take_off_transposed(height[1], beside + 2 * n * height[1], m, y, ends + 2 * n);
    }
    upper_transposed(last, height[2], f.last, ends, y);
    memcpy(ends, y, (size_t)last * sizeof(double));
    memset(y, 0, (size_t)height[2] * sizeof(double));
    lower_transposed(last, height[2], f.last, ends, y);
    for (int64_t i = 0; i < last; i++) {
        const int64_t row = f.last_order[i] - n;
        *(row < 0 ? front + row + n : x + bottom + row) = row < 0 ? y[i] : y[i] * f.scales[bottom + row];
    }
    for (int64_t k = K - 1; k >= 0; k--) { /* the lower factor, backwards: the node's, then the interval's */
        double *here = x + k * rows;
        if (k) {
            const int32_t *order = f.node_orders + (k - 1) * 2 * n;
            memset(y, 0, (size_t)height[1] * sizeof(double));
            memcpy(y + n, front, (size_t)n * sizeof(double));
            memcpy(y + 2 * n, added, (size_t)longs * sizeof(double));
            lower_transposed(n, height[1], f.nodes + (k - 1) * height[1] * width[1], here, y);
            for (int64_t i = 0; i < 2 * n; i++)
                *(order[i] < n ? front + order[i] : own + order[i] - n) = y[i];
        }
        memset(y, 0, (size_t)height[0] * sizeof(double));
        memcpy(y + inner, k ? own : front, (size_t)n * sizeof(double));
        memcpy(y + rows, added, (size_t)longs * sizeof(double));
        lower_transposed(inner, height[0], f.blocks + k * height[0] * width[0], here + n, y);
        for (int64_t i = 0; i < rows; i++)
            here[f.orders[k * rows + i]] = y[i] * f.scales[k * rows + i];
    }
}

KERNEL(collocation_solve_transposed)(const void *of, double *memory, int64_t count, double *x)
{
    const layout *l = of;
    for (int64_t i = 0, size = l->n * (l->K * l->R + 1) + l->m; i < count; i++)
        solve_transposed(l, within(l, memory), x + i * size);
    return 0;
}

/* Factors ---------------------------------------------------------------------------------------------------------- */

/* 1 over the power of 2 below x, 1 of a number that is zero, tiny or not finite. */
static inline double scale_of(double x)
{
    uint64_t u;
    memcpy(&u, &x, sizeof u);
    const uint64_t exponent = u >> 52;
    u = exponent > 0 && exponent < 2046 ? (2046 - exponent) << 52 : (uint64_t)1023 << 52;
    memcpy(&x, &u, sizeof u);
    return x;
}

static inline void grow(double *most, double x) { *most = x > *most ? x : *most; }

/* The largest entries of the rows of an interval's block times units of the unknowns, into `by_units`, and times their
   sizes, into `by_sizes` if there are any. */
static void largest_terms(const layout *l, int64_t k, const double *block, const double *units, const double *sizes,
                          double *restrict by_units, double *restrict by_sizes)
{
    const int64_t n = l->n, rows = n * l->R, height = l->heights[0];
    const int64_t starts[4] = {k * rows + n, k * rows, (k + 1) * rows, l->K * rows + n}; /* in the columns' order */
    const int64_t counts[4] = {rows - n, n, n, l->m};
    memset(by_units, 0, (size_t)height * sizeof(double));
    memset(by_sizes, 0, (size_t)height * sizeof(double));
    for (int part = 0; part < 4; part++)
        for (int64_t c = starts[part]; c < starts[part] + counts[part]; c++, block += height) {
            const double unit = units[c], size = sizes ? sizes[c] : 0.0;
            for (int64_t i = 0; i < height; i += EIGHT)
                for (int64_t j = i; j < i + EIGHT; j++) {
                    grow(by_units + j, fabs(block[j]) * unit);
                    grow(by_sizes + j, fabs(block[j]) * size);
                }
        }
}

static void scale_rows(int64_t height, int64_t width, double *block, const double *scales)
{
    for (int64_t c = 0; c < width; c++, block += height)
        for (int64_t i = 0; i < height; i += REGISTER)
            *(chunk *)(block + i) *= *chunks(scales + i);
}

/* Long rows of a block, behind its first `rows` rows: what n columns of them add at a node. */
static void add_long(const layout *l, int64_t rows, int64_t height, int64_t n, const double *columns, double *at)
{
    for (int64_t c = 0; c < n; c++)
        for (int64_t i = 0; i < l->longs; i++)
            at[c * l->longs + i] += columns[c * height + rows + i];
}

/* The matrix into the memory. */
static void fill(const layout *l, factors f, const double *nonzeros, const double *row)
{
    const int64_t n = l->n, inner = n * (l->R - 1), rows = n * l->R, *height = l->heights, *width = l->widths;
    const int64_t longs = l->longs, bottom = l->K * rows;
    double *restrict base = f.blocks;
    const int32_t *restrict target = l->target;
    memset(base, 0, (size_t)(l->K * height[0] * width[0]) * sizeof(double));
    memset(f.last, 0, (size_t)(height[2] * width[2] + longs * (n * (l->K + 1) + l->m)) * sizeof(double));
    for (int64_t i = 0, count = l->nonzeros; i < count; i++)
        base[target[i]] = nonzeros[i];
    for (int64_t k = 0; k < l->K; k++) {
        double *block = f.blocks + k * height[0] * width[0] + rows + longs - 1;
        for (int64_t i = 0; i < inner; i++)
            block[i * height[0]] = row[k * rows + n + i];
    }
    for (int64_t k = 0; k <= l->K; k++)
        for (int64_t i = 0; i < n; i++)
            f.longs[(k * n + i + 1) * longs - 1] = row[k * rows + i];
    for (int64_t i = 0; i < l->m; i++)
        f.longs[((l->K + 1) * n + i + 1) * longs - 1] = row[bottom + n + i];
}

/* Units of all unknowns: of the n states those that balance their derivatives by one another, and of the m scalars, whose derivatives they make
   no larger than 1; from the last n rows of every interval, which have those at all its stages. */
static void balance(const layout *l, factors f, double *units)
{
    const int64_t n = l->n, K = l->K, rows = n * l->R, inner = rows - n, height = l->heights[0], width = l->widths[0];
    double *by_states = f.room;
    memset(by_states, 0, (size_t)(n * n) * sizeof(double));
    for (int64_t k = 0; k < K; k++)
        for (int64_t c = 0; c < inner + 2 * n; c += n)
            for (int64_t j = 0; j < n; j++)
                for (int64_t i = 0; i < n; i++)
                    grow(by_states + j * n + i, fabs(f.blocks[(k * width + c + j) * height + inner + i]));
    for (int64_t i = 0; i < n; i++)
        units[i] = 1.0, by_states[i * (n + 1)] = 0.0;
    for (int64_t moved = 1, sweeps = 0; moved && sweeps < SWEEPS; sweeps++) {
        moved = 0;
        for (int64_t i = 0; i < n; i++) {
            double column = 0.0, row = 0.0;
            for (int64_t j = 0; j < n; j++)
                grow(&column, by_states[i * n + j]), grow(&row, by_states[j * n + i]);
            const double factor = scale_of(sqrt(column)) / scale_of(sqrt(row)), unit = units[i] * factor;
            if (!(column * row > 0.0) || (factor <= 2.0 && factor >= 0.5) || !(unit < 1e100 && unit > 1e-100))
                continue;
            moved = 1, units[i] = unit;
            for (int64_t j = 0; j < n; j++)
                by_states[i * n + j] *= factor, by_states[j * n + i] /= factor;
        }
    }
    for (int64_t j = 0; j < l->m; j++) {
        double most = 0.0, in_longs = 0.0;
        for (int64_t k = 0; k < K; k++)
            for (int64_t i = 0; i < n; i++)
                grow(&most, fabs(f.blocks[(k * width + inner + 2 * n + j) * height + inner + i]) / units[i]);
        for (int64_t i = 0; i < l->longs; i++)
            grow(&in_longs, fabs(f.longs[((K + 1) * n + j) * l->longs + i]));
        if (most <= ROUNDING * in_longs) /* derivatives by it are rounding: long rows alone have it */
            most = in_longs;
        units[K * rows + n + j] = scale_of(most);
    }
    for (int64_t i = n; i < K * rows + n; i++)
        units[i] = units[i - n];
}

/* The largest terms of conditions and of long rows, (n + m), for sizes of the unknowns; the latter's entries within
   intervals are left out. */
static void largest_at_ends(const layout *l, factors f, const double *sizes, double *most)
{
    const int64_t n = l->n, K = l->K, rows = n * l->R;
    memset(most, 0, (size_t)(n + l->m) * sizeof(double));
    for (int64_t c = 0; c < 2 * n + l->m; c++)
        for (int64_t i = 0; i < l->conditions; i++)
            grow(most + i, fabs(f.last[c * l->heights[2] + n + i]) * sizes[c < n ? c : K * rows + c - n]);
    for (int64_t c = 0; c < n * (K + 1) + l->m; c++) {
        const int64_t node = c < n * K ? c / n : K;
        for (int64_t i = 0; i < l->longs; i++)
            grow(most + l->conditions + i, fabs(f.longs[c * l->longs + i]) * sizes[node * (rows - n) + c]);
    }
}

/* Factors in `memory`; the sign of the determinant, or 0 where a pivot vanishes. The largest terms of the equations, by
   the sizes of the unknowns, go to `terms`, (size), if there are any. */
static double factors_of(const layout *l, factors f, const double *nonzeros, const double *row, const double *sizes,
                         double *terms)
{
    const int64_t n = l->n, m = l->m, K = l->K, longs = l->longs, inner = n * (l->R - 1), rows = n * l->R;
    const int64_t *height = l->heights, *width = l->widths, bottom = K * rows, last = 2 * n + m;
    const int64_t own = n + l->conditions; /* of the last block: rows that are no long ones */
    double *units = f.units, *end_rows = f.scales + bottom, *scalars = f.longs + (K + 1) * n * longs;
    double *most = f.room, *by_sizes = most + height[0], *scales = by_sizes + height[0];
    int64_t odd = (n * inner * K + n * (K - 1)) % 2; /* of the orders of equations and of unknowns */
    fill(l, f, nonzeros, row);
    balance(l, f, units);
    largest_at_ends(l, f, units, end_rows);
    if (sizes)
        largest_at_ends(l, f, sizes, terms + bottom);
    for (int64_t i = 0; i < height[0]; i++)
        scales[i] = 1.0;
    for (int64_t k = 0; k < K; k++) {
        double *block = f.blocks + k * height[0] * width[0], *start = block + inner * height[0];
        double *end = start + n * height[0], *by_scalars = end + n * height[0];
        largest_terms(l, k, block, units, sizes, most, by_sizes);
        for (int64_t i = 0; i < longs; i++)
            grow(end_rows + l->conditions + i, most[rows + i]);
        if (sizes)
            memcpy(terms + k * rows, by_sizes, (size_t)rows * sizeof(double));
        for (int64_t i = 0; sizes && i < longs; i++)
            grow(terms + bottom + l->conditions + i, by_sizes[rows + i]);
        for (int64_t i = 0; i < rows; i++)
            scales[i] = scale_of(most[i]);
        scale_rows(height[0], width[0], block, scales);
        int32_t *order = f.orders + k * rows;
        const int64_t more = eliminate(inner, rows, height[0], width[0], block, order);
        if (more < 0)
            return 0.0;
        odd += more;
        for (int64_t i = 0; i < rows; i++)
            f.scales[k * rows + i] = scales[order[i]];
        add_long(l, rows, height[0], n, start, f.longs + k * n * longs);
        add_long(l, rows, height[0], n, end, f.longs + (k + 1) * n * longs);
        add_long(l, rows, height[0], m, by_scalars, scalars);
        if (k == 0)
            continue;

        /* n rows in x_0, x_k and s from before, and n in x_k, x_(k+1) and s: columns x_k, x_0, x_(k+1), s. */
        double *node = f.nodes + (k - 1) * height[1] * width[1], *before = node - height[1] * width[1];
        memset(node, 0, (size_t)(height[1] * width[1]) * sizeof(double));
        for (int64_t c = 0; c < 2 * n + m; c++) { /* x_0, x_k, s of the first rows; x_k, x_(k+1), s of the others */
            const double *one = k == 1 ? f.blocks + (inner + c) * height[0] + inner : before + (n + c) * height[1] + n;
            const double *other = start + c * height[0] + inner;
            double *to = node + (c < n ? n + c : c < 2 * n ? c - n : n + c) * height[1];
            memcpy(to, one, (size_t)n * sizeof(double));
            to = node + (c < n ? c : n + c) * height[1];
            memcpy(to + n, other, (size_t)n * sizeof(double));
        }
        for (int64_t c = 0; c < n; c++)
            memcpy(node + c * height[1] + 2 * n, f.longs + (k * n + c) * longs, (size_t)longs * sizeof(double));
        const int64_t again = eliminate(n, 2 * n, height[1], width[1], node, f.node_orders + (k - 1) * 2 * n);
        if (again < 0)
            return 0.0;
        odd += again;
        add_long(l, 2 * n, height[1], n, node + n * height[1], f.longs);
        add_long(l, 2 * n, height[1], n, node + 2 * n * height[1], f.longs + (k + 1) * n * longs);
        add_long(l, 2 * n, height[1], m, node + 3 * n * height[1], scalars);
    }

    for (int64_t i = 0; i < n + m; i++)
        end_rows[i] = scale_of(end_rows[i]);
    const double *before = f.nodes + (K - 2) * height[1] * width[1];
    for (int64_t c = 0; c < last; c++) {
        double *to = f.last + c * height[2];
        const double *front = K == 1 ? f.blocks + (inner + c) * height[0] + inner : before + (n + c) * height[1] + n;
        memcpy(to, front, (size_t)n * sizeof(double));
        memcpy(to + own, (c < n ? f.longs + c * longs : f.longs + (K * n + c - n) * longs),
               (size_t)longs * sizeof(double));
        for (int64_t i = 0; i < n + m; i++)
            to[n + i] *= end_rows[i];
    }
    const int64_t more = eliminate(last, last, height[2], width[2], f.last, f.last_order);
    return more < 0 ? 0.0 : (odd + more) % 2 ? -1.0 : 1.0;
}

static void add_products(int64_t size, const int64_t *restrict columns, const int32_t *restrict rows,
                         const double *restrict nonzeros, const double *restrict x, double *restrict sums)
{
    for (int64_t c = 0; c < size; c++) {
        const double value = x[c];
        for (int64_t i = columns[c], end = columns[c + 1]; i < end; i++)
            sums[rows[i]] += nonzeros[i] * value;
    }
}

/* Factors in `memory` of the matrix of these non-zeros and this last row, the sign of its determinant in `sign`, and in
   x, (3, size), the solutions for the closing row alone and for residuals in general position, of size 1 and in units
   of their own, conditions at least `least`; of which the last is not solved for without `sizes`. They
   have to be those of a regular matrix. Returns 0, or 1 where that is singular but for rounding. A NaN fails every
   comparison. `room` has `size` numbers. */
KERNEL(collocation_factors)(const void *of, const double *nonzeros, const double *row, const double *sizes,
                            double least, double *memory, double *sign, double *x, double *room)
{
    const layout *l = of;
    const factors f = within(l, memory);
    const int64_t bottom = l->n * l->K * l->R, size = bottom + l->n + l->m;
    double *raw = x + size, *general = raw + size;
    *sign = factors_of(l, f, nonzeros, row, sizes, room);
    if (*sign == 0.0)
        return 1;
    memset(x, 0, (size_t)size * sizeof(double)), x[size - 1] = 1.0;
    memcpy(raw, l->probe, (size_t)(size - 1) * sizeof(double));
    for (int64_t i = 0; sizes && i < size - 1; i++)
        general[i] = raw[i] * (i < bottom || room[i] > least ? room[i] : least);
    raw[size - 1] = general[size - 1] = 0.0;
    solve_all(l, f, sizes ? 3 : 2, x);
    for (int64_t i = 0; sizes && i < size; i++)
        general[i] /= sizes[i];
    if (!(largest(raw, size) < l->singular || (sizes && largest(general, size) < l->singular)))
        return 1;
    memset(room, 0, (size_t)size * sizeof(double));
    add_products(size, l->columns, l->rows, nonzeros, x, room);
    double closed = -1.0;
    for (int64_t i = 0; i < size; i++)
        closed += row[i] * x[i];
    const double most = largest(x, size) * largest(nonzeros, l->nonzeros);
    return !(largest(room, size) <= l->accurate * most && fabs(closed) <= l->accurate);
}
