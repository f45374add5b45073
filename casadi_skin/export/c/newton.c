/* Newton's method for the periodic orbit: the collocation equations closed by one more, which holds Omega or the
 * parameter. */

#include "@p.h"

#include <math.h>
#include <string.h>

enum { SIZE = @P_UNKNOWNS, STATES = @P_STATE_UNKNOWNS };

/* Length of a step in the metric |dq|^2/|q|^2 + (20 dOmega/Omega)^2 + (dp/scale)^2. */
static double length_of(const double *step, const double *z, double scale)
{
    double state = 0.0, change = 0.0, rest = 0.0;
    int i;

    for (i = 0; i < STATES; i++) {
        state += z[i] * z[i];
        change += step[i] * step[i];
    }
    for (i = STATES; i < SIZE; i++) {
        double s = step[i] * (i == @P_OMEGA ? 20.0 / z[i] : i == @P_PARAMETER ? 1.0 / scale : 1.0);
        rest += s * s;
    }
    return sqrt(change / state + rest);
}

/* Largest defect of the linear system that gave the step, relative to its largest terms. */
static double defect_of(const double *dRdz, const double *R, const double *step, double *product)
{
    double largest = 0.0, defect = 0.0;
    int j, k;

    for (j = 0; j < SIZE; j++) product[j] = j < SIZE - 1 ? -R[j] : 0.0;
    for (j = 0; j < SIZE; j++)
        for (k = @p_residual_colptr[j]; k < @p_residual_colptr[j + 1]; k++) {
            product[@p_residual_row[k]] += dRdz[k] * step[j];
            largest = fmax(largest, fabs(dRdz[k] * step[j]));
        }
    for (j = 0; j < SIZE - 1; j++) {
        largest = fmax(largest, fabs(R[j]));
        defect = product[j] == product[j] ? fmax(defect, fabs(product[j])) : HUGE_VAL;
    }
    return largest > 0.0 ? defect / largest : 0.0;
}

int @p_newton(double *restrict z, int held, double value, double tolerance, int most, @p_newton_report *report,
              double *restrict work)
{
    double *R = work, *dRdz = R + SIZE, *step = dRdz + @P_RESIDUAL_NONZEROS, *product = step + SIZE;
    double *start = product + SIZE, *rest = start + SIZE, last = HUGE_VAL, scale = fmax(1.0, fabs(z[@P_PARAMETER]));
    int i;

    memcpy(start, z, SIZE * sizeof *z);
    report->iterations = 0;
    report->step = report->residual = HUGE_VAL;
    report->status = @P_TOO_MANY_ITERATIONS;
    if (!(z[@P_OMEGA] > 0.0) || (held != @P_OMEGA && held != @P_PARAMETER)) report->status = @P_BAD_INPUT;
    while (report->status == @P_TOO_MANY_ITERATIONS && report->iterations < most) {
        report->iterations++;
        if (@p_residual(z, R, dRdz, rest)) report->status = @P_DIVERGED;
        for (report->residual = 0.0, i = 0; i < SIZE - 1; i++) report->residual = fmax(report->residual, fabs(R[i]));
        memcpy(step, R, (SIZE - 1) * sizeof *step);
        step[SIZE - 1] = z[held] - value;
        if (@p_solve(dRdz, held, z, step, rest) || !(defect_of(dRdz, R, step, product) < 1e-6)) {
            report->status = @P_SINGULAR;
            break;
        }
        for (i = 0; i < SIZE; i++) z[i] -= step[i];
        report->step = length_of(step, start, scale);
        if (!(report->step <= fmax(1.0, 10.0 * last)) || !(z[@P_OMEGA] > 0.0)) {
            report->status = @P_DIVERGED;
        } else if (report->step <= tolerance) {
            report->status = @P_CONVERGED;
        }
        last = report->step;
    }
    if (report->status == @P_CONVERGED) z[held] = value;
    else memcpy(z, start, SIZE * sizeof *z);
    return report->status;
}

const char *@p_newton_words(int status)
{
    static const char *const words[] = {"converged", "too many iterations", "the matrix is singular", "diverged",
                                        "Omega is not positive, or neither Omega nor the parameter is held"};
    return status >= 0 && status < 5 ? words[status] : "unknown status";
}
