/* Power series of a branch of a core whose linear tail is eliminated, order by order; see lattice/tail_recursion.py.

   A solver in the place of the core's own: it turns the right-hand side of an order of the core into that with the
   tail, solves, and leaves that order of the core's unknowns, with Omega in the place of u. */

#include <stdint.h>
#include <string.h>

#define EXPORTED __attribute__((visibility("default")))

typedef struct {
    void (*solve)(const void *, double *, int64_t, double *);
    const void *layout;
    int64_t order, orders, nodes, size, first, place, touched, own_Omega; /* order: the one to be solved next */
    const int64_t *columns;               /* of the block, `touched` in number, of which `own_Omega` is that of Omega */
    const double *by_u;                   /* Omega, across, down by powers of u, (orders + 1, 1 + 2 nodes) */
    const double *transform, *block, *by_Omega; /* to harmonics; (nodes, touched); (size - 1) */
    double *along, *powers;               /* as by_u along the branch; powers of the change of u, by order */
    double *balance, *site, *found;       /* by order: nodes, nodes, size */
    double bond;
} tail;

static void by_harmonics(const tail *t, const double *nodes, double *harmonics)
{
    for (int64_t h = 0; h < t->nodes; h++) {
        harmonics[h] = 0.0;
        for (int64_t i = 0; i < t->nodes; i++)
            harmonics[h] += t->transform[h * t->nodes + i] * nodes[i];
    }
}

/* The order of Omega, across and down as if u had no part of it. */
static void without(const tail *t, int64_t k, double *order)
{
    const int64_t count = 1 + 2 * t->nodes, orders = t->orders + 1;
    const double *u = t->powers + orders;
    memset(order, 0, (size_t)count * sizeof(double));
    for (int64_t m = 2; m <= k; m++) {
        double power = 0.0;
        for (int64_t i = 1; i < k; i++)
            power += t->powers[(m - 1) * orders + k - i] * u[i];
        t->powers[m * orders + k] = power;
        for (int64_t f = 0; f < count; f++)
            order[f] += power * t->by_u[m * count + f];
    }
}

EXPORTED void casadi_skin_tail_solve(tail *t, double *factors, int64_t count, double *right)
{
    const int64_t k = t->order++, H = t->nodes, functions = 1 + 2 * H;
    double order[functions], known[H], *rows = right + t->first;
    (void)count; /* one */
    without(t, k, order);
    by_harmonics(t, rows, known);
    for (int64_t h = 0; h < H; h++)
        known[h] = t->block[h * t->touched + t->own_Omega] * order[0] - known[h];
    for (int64_t i = 0; i < t->size - 1; i++)
        right[i] -= t->by_Omega[i] * order[0];
    for (int64_t h = 0; h < H; h++) {
        const double *across = t->along + 1 + h, *down = across + H;
        double sum = down[0] * known[h] + order[1 + H + h] * t->balance[h] - t->bond * order[1 + h] * t->site[h];
        for (int64_t j = 1; j < k; j++)
            sum += down[j * functions] * t->balance[(k - j) * H + h] -
                   t->bond * across[j * functions] * t->site[(k - j) * H + h];
        rows[h] = -sum;
    }
    t->solve(t->layout, factors, 1, right);

    const double u = right[t->place];
    memcpy(t->found + k * t->size, right, (size_t)t->size * sizeof(double));
    t->powers[t->orders + 1 + k] = u;
    for (int64_t f = 0; f < functions; f++)
        t->along[k * functions + f] = order[f] + u * t->by_u[functions + f];
    by_harmonics(t, rows, t->site + k * H);
    right[t->place] = u * t->by_u[functions];
    for (int64_t h = 0; h < H; h++) {
        double sum = known[h];
        for (int64_t i = 0; i < t->touched; i++)
            sum += t->block[h * t->touched + i] * right[t->columns[i]];
        t->balance[k * H + h] = sum;
    }
    right[t->place] = t->along[k * functions];
}
