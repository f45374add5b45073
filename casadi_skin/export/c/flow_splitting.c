/* Flow of a model of second order with its transition matrix: symplectic splitting of order 6, SRKN11b of
 * S. Blanes and P. C. Moan, J. Comput. Appl. Math. 142 (2002) 313. Kicks v += b h f(q) and drifts q += a h v alternate;
 * the transition matrix goes through the derivatives of the same maps, so that it is that of the discrete flow. */

#include "@p.h"

enum { N = @P_FLOW_STATES / 2, STAGES = 11 };

/* Velocities of two columns (positions, then velocities) after a kick, together: it takes less time. J is h df/dq by
 * rows. */
static void kick_columns(const double *J, double *first, double *second)
{
    int i, k;

    for (i = 0; i < N; i++) {
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

static int kick(double t, double h, double *x, double *Phi, const double *p, double *work)
{
    double *force = work, *J = work + N;
    int k, failed = @p_force(t, x, p, force, J, J + @P_FORCE_NONZEROS);
    double *column;

    if (failed) return failed;
    for (k = 0; k < N; k++) x[N + k] += h * force[k];
    for (k = 0; k < @P_FORCE_NONZEROS; k++) J[k] *= h;
    for (column = Phi; Phi && column < Phi + (size_t)4 * N * N; column += 4 * N) kick_columns(J, column, column + 2 * N);
    return 0;
}

static void drift(double h, double *x, double *Phi)
{
    double *column;
    int j;

    for (j = 0; j < N; j++) x[j] += h * x[N + j];
    for (column = Phi; Phi && column < Phi + (size_t)4 * N * N; column += 2 * N)
        for (j = 0; j < N; j++) column[j] += h * column[N + j];
}

int @p_flow(double t, double duration, int steps, double *x, double *Phi, const double *p, double *work)
{
    const double *a = @p_flow_drifts, *b = @p_flow_kicks;
    double h = duration / steps, now;
    int i, step, failed = steps < 1;

    if (Phi) {
        for (i = 0; i < 4 * N * N; i++) Phi[i] = 0.0;
        for (i = 0; i < 2 * N; i++) Phi[i * (2 * N + 1)] = 1.0;
    }
    for (step = 0; step < steps && !failed; step++) {
        now = t + step * h;
        failed = kick(now, b[0] * h, x, Phi, p, work);
        for (i = 0; i < STAGES && !failed; i++) {
            drift(a[i] * h, x, Phi);
            now += a[i] * h;
            failed = kick(now, b[i + 1] * h, x, Phi, p, work);
        }
    }
    return failed;
}
