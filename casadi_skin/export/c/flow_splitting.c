/* Flow of a model of second order with its transition matrix: symplectic splitting of order 6, SRKN11b of
 * S. Blanes and P. C. Moan, J. Comput. Appl. Math. 142 (2002) 313. Kicks v += b h f(q) and drifts q += a h v alternate;
 * the transition matrix goes through the derivatives of the same maps, so that it is that of the discrete flow.
 *
 * A column of it begins at one site and spreads by the width of the force's band with every kick. Its ends are left out
 * while they are below NEGLIGIBLE: of a long chain most of the matrix is as small as that. */

#include "@p.h"

#include <math.h>
#include <stddef.h>

#define NEGLIGIBLE 1e-60
enum { N = @P_FLOW_STATES / 2, STAGES = 11, SPREAD = @P_FORCE_WIDTH };

/* Sites that a pair of columns has reached, kept as doubles in the caller's array. */
typedef struct {
    double low, high;
} Reach;

/* Velocities of two columns (positions, then velocities) after a kick, together: it takes less time. J is h df/dq by
 * rows. */
static void kick_columns(const double *restrict J, double *restrict first, double *restrict second, int low, int high)
{
    int i, k;

    for (i = low; i <= high; i++) {
        double one = 0.0, two = 0.0;
        for (k = @p_force_rowptr[i]; k < @p_force_rowptr[i + 1]; k++) {
            int j = @p_force_column[k];
            one += J[k] * first[j];
            two += J[k] * second[j];
        }
        first[N + i] += one;
        second[N + i] += two;
    }
}

/* Whether all that two columns have at a site is negligible; then it is none. */
static int cleared(double *first, double *second)
{
    const double size = fmax(fabs(first[0]) + fabs(first[N]), fabs(second[0]) + fabs(second[N]));

    if (!(size < NEGLIGIBLE)) return 0;
    first[0] = first[N] = second[0] = second[N] = 0.0;
    return 1;
}

static int kick(double t, double h, double *x, double *Phi, Reach *reach, const double *p, double *work)
{
    double *force = work, *J = work + N;
    int k, failed = @p_force(t, x, p, force, J, J + @P_FORCE_NONZEROS);

    if (failed) return failed;
    for (k = 0; k < N; k++) x[N + k] += h * force[k];
    for (k = 0; k < @P_FORCE_NONZEROS; k++) J[k] *= h;
    for (k = 0; Phi && k < N; k++) {
        double *first = Phi + (size_t)4 * N * (size_t)k, *second = first + 2 * N;
        int low = (int)reach[k].low - SPREAD, high = (int)reach[k].high + SPREAD;
        if (low < 0) low = 0;
        if (high > N - 1) high = N - 1;
        kick_columns(J, first, second, low, high);
        while (low < high && cleared(first + low, second + low)) low++;
        while (low < high && cleared(first + high, second + high)) high--;
        reach[k].low = low;
        reach[k].high = high;
    }
    return 0;
}

static void drift(double h, double *x, double *Phi, const Reach *reach)
{
    int j, k;

    for (j = 0; j < N; j++) x[j] += h * x[N + j];
    for (k = 0; Phi && k < 2 * N; k++) {
        double *column = Phi + (size_t)2 * N * (size_t)k;
        const int high = (int)reach[k / 2].high;
        for (j = (int)reach[k / 2].low; j <= high; j++) column[j] += h * column[N + j];
    }
}

int @p_flow(double t, double duration, int steps, double *restrict x, double *restrict Phi, const double *restrict p,
            double *restrict work)
{
    const double *a = @p_flow_drifts, *b = @p_flow_kicks;
    Reach *reach = (Reach *)work;
    double h = duration / steps, now, *rest = work + 2 * N;
    int i, step, failed = steps < 1;
    size_t k;

    if (Phi) {
        for (k = 0; k < (size_t)4 * N * N; k++) Phi[k] = 0.0;
        for (k = 0; k < 2 * N; k++) Phi[k * (2 * N + 1)] = 1.0;
        for (i = 0; i < N; i++) { /* where the units of columns 2i and 2i + 1 are */
            const int one = 2 * i % N, two = (2 * i + 1) % N;
            reach[i].low = one < two ? one : two;
            reach[i].high = one < two ? two : one;
        }
    }
    for (step = 0; step < steps && !failed; step++) {
        now = t + step * h;
        failed = kick(now, b[0] * h, x, Phi, reach, p, rest);
        for (i = 0; i < STAGES && !failed; i++) {
            drift(a[i] * h, x, Phi, reach);
            now += a[i] * h;
            failed = kick(now, b[i + 1] * h, x, Phi, reach, p, rest);
        }
    }
    return failed;
}
