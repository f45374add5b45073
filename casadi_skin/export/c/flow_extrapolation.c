/* Flow of a model of first order with its transition matrix: Gragg's midpoint rule in 2, 4, 6, 8 substeps, extrapolated
 * to order 8 (Gragg-Bulirsch-Stoer; Hairer, Norsett and Wanner, Solving Ordinary Differential Equations I, II.9). */

#include "@p.h"

enum { N = @P_FLOW_STATES, ROWS = 4 };

/* The state with the columns of Phi behind it, and their derivative. */
static int field(double t, const double *X, int columns, const double *p, double *F, double *work)
{
    return @p_variational(t, X, p, columns, X + N, F, F + N, work);
}

/* The state after a step in n substeps of the midpoint rule with Gragg's smoothing at the end; m entries. */
static int midpoint(double t, double step, int n, const double *restrict X, int columns, const double *p,
                    double *restrict result, double *restrict scratch, double *work, size_t m)
{
    double *before = scratch, *here = scratch + m, *F = scratch + 2 * m, h = step / n;
    size_t i;
    int k, failed = field(t, X, columns, p, F, work);

    for (i = 0; i < m; i++) {
        before[i] = X[i];
        here[i] = X[i] + h * F[i];
    }
    for (k = 1; k < n && !failed; k++) {
        failed = field(t + k * h, here, columns, p, F, work);
        for (i = 0; i < m; i++) {
            double next = before[i] + 2.0 * h * F[i];
            before[i] = here[i];
            here[i] = next;
        }
    }
    if (!failed) failed = field(t + step, here, columns, p, F, work);
    for (i = 0; i < m; i++) result[i] = 0.5 * (before[i] + here[i] + h * F[i]);
    return failed;
}

int @p_flow(double t, double duration, int steps, double *restrict x, double *restrict Phi, const double *restrict p,
            double *restrict work)
{
    int columns = Phi ? N : 0, step, j, k, failed = steps < 1;
    size_t m = (size_t)N * (size_t)(1 + columns), i;
    double *X = work, *table = work + m, *scratch = table + ROWS * m, *rest = scratch + 3 * m, h = duration / steps;

    for (i = 0; i < N; i++) X[i] = x[i];
    for (i = N; i < m; i++) X[i] = (i - N) % (N + 1) == 0 ? 1.0 : 0.0;
    for (step = 0; step < steps && !failed; step++) {
        for (j = 0; j < ROWS && !failed; j++) {
            failed = midpoint(t + step * h, h, 2 * (j + 1), X, columns, p, table + (size_t)j * m, scratch, rest, m);
            for (k = j; k > 0 && !failed; k--) { /* Aitken and Neville, in squares of the substep */
                double ratio = (double)(j + 1) / k, *coarse = table + (size_t)(k - 1) * m, *fine = table + (size_t)k * m;
                for (i = 0; i < m; i++) coarse[i] = fine[i] + (fine[i] - coarse[i]) / (ratio * ratio - 1.0);
            }
        }
        for (i = 0; i < m; i++) X[i] = table[i];
    }
    for (i = 0; i < N; i++) x[i] = X[i];
    for (i = N; i < m; i++) Phi[i - N] = X[i];
    return failed;
}
