@@ report of Newton's method
typedef struct {
    int status;      /* one of the constants below */
    int iterations;  /* linear systems solved */
    double step;     /* length of the last step, relative to the orbit */
    double residual; /* largest |R| before that step */
} @p_newton_report;
enum { @P_CONVERGED, @P_TOO_MANY_ITERATIONS, @P_SINGULAR, @P_DIVERGED, @P_BAD_INPUT };
@@ positions
void @p_positions(const double *z, double *q)
{
    int n, i;

    for (n = 0; n < @P_SITES; n++)
        for (q[n] = 0.0, i = 0; i < @P_NODES; i++) q[n] += at_zero[i] * z[n * @P_NODES + i];
}
