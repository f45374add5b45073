@@ head
/* What this export computes, with all digits; see README.md for the numbers to expect. */

#include <math.h>
#include <stdio.h>

#include "@p.h"

@@ newton arrays
static double z[@P_UNKNOWNS], newton_work[@P_NEWTON_WORK];
@@ flow arrays
static double x[@P_FLOW_STATES], Phi[@P_FLOW_STATES * @P_FLOW_STATES], flow_work[@P_FLOW_WORK];
static double mu_real[@P_SITES], mu_imaginary[@P_SITES], multipliers_work[@P_MULTIPLIERS_WORK];
@@ orbit of a chain
    {
        static double y[@P_SITES], velocity[@P_SITES];
        double S = 0.0;
        int n;

        @p_orbit(@p_orbit_period, y, velocity);
        for (n = 0; n < @P_SITES; n++) S += y[n] * y[n];
        printf("orbit_period %.17g\norbit_S %.17g\n", @p_orbit_period, S);
    }
@@ newton from the orbit
    @p_newton_report report;
    int i;

    /* The orbit, wrong by a thousandth, put right by Newton's method at its kappa. */
    for (i = 0; i < @P_UNKNOWNS; i++) z[i] = @p_orbit_z[i] * (1.0 + 1e-3 * sin(i + 1.0));
    if (@p_newton(z, @P_PARAMETER, @p_orbit_kappa, 1e-13, 20, &report, newton_work)) {
        fprintf(stderr, "newton: %s\n", @p_newton_words(report.status));
        return 1;
    }
    printf("period %.17g\niterations %d\n", 2.0 * acos(-1.0) / z[@P_OMEGA], report.iterations);
@@ newton from a linear mode
    @p_newton_report report;
    int k, failed = @p_linear_mode(@mode, z);

    if (failed) fprintf(stderr, "linear mode @mode does not oscillate\n");

    /* From the linear mode to S = @S in steps of S. */
    for (k = 1; k <= 4 && !failed; k++) {
        failed = @p_newton(z, @P_PARAMETER, @p_g * @S * k / 4, 1e-13, 20, &report, newton_work);
        if (failed) fprintf(stderr, "newton: %s\n", @p_newton_words(report.status));
    }
    if (failed) return 1;
    printf("period %.17g\n", 2.0 * acos(-1.0) / z[@P_OMEGA]);
@@ multipliers
    {
        double largest, trivial, quarter, kappa;
@start        @p_flow(0.0, quarter, @steps, x, Phi, &kappa, flow_work);
        if (@p_multipliers(Phi, 1e-10, mu_real, mu_imaginary, &largest, &trivial, multipliers_work)) {
            fprintf(stderr, "multipliers: the QR iteration did not converge\n");
            return 1;
        }
        printf("largest_multiplier %.17g\ntrivial_deviation %.3g\n", largest, trivial);
    }
@@ start from newton

        @p_positions(z, x); /* at rest at t = 0: the velocities are zeros */
        quarter = 0.5 * acos(-1.0) / z[@P_OMEGA];
        kappa = z[@P_PARAMETER];
@@ start from the orbit
        int n;

        @p_orbit(0.0, x, 0); /* at rest at t = 0: the velocities are zeros */
        for (n = 0; n < @P_SITES; n++) x[n] /= sqrt(@p_orbit_S) * @p_rho[n];
        quarter = 0.25 * @p_orbit_period;
        kappa = @p_orbit_kappa;
@@ orbit of a model
    printf("orbit_period %.17g\n", @p_orbit_period);
@@ return
    {
        static double x[@P_STATES], start[@P_STATES], Phi[@P_STATES * @P_STATES], work[@P_FLOW_WORK];
        double p[@P_PARAMETERS + 1] = {0.0}, trace = 0.0, off = 0.0;
        int i;

@nominal        @p_orbit(0.0, start, @velocities);
        for (i = 0; i < @P_STATES; i++) x[i] = start[i];
        @p_flow(0.0, @p_orbit_period, @harmonic_steps * (@P_HARMONICS + 8), x, Phi, p, work);
        for (i = 0; i < @P_STATES; i++) {
            off = fmax(off, fabs(x[i] - start[i]));
            trace += Phi[i * (@P_STATES + 1)];
        }
        printf("return_error %.3g\ntrace %.17g\n", off, trace);
    }
@@ flow
    {
        static double x[@P_FLOW_STATES], Phi[@P_FLOW_STATES * @P_FLOW_STATES], work[@P_FLOW_WORK];
        double p[@P_FLOW_PARAMETERS + 1] = {0.0}, trace = 0.0;
        int i;

@nominal        for (i = 0; i < @P_FLOW_STATES; i++) x[i] = 0.1 / (i + 1);
        @p_flow(0.0, 1.0, 100, x, Phi, p, work);
        for (i = 0; i < @P_FLOW_STATES; i++) {
            trace += Phi[i * (@P_FLOW_STATES + 1)];
            printf("%s %.17g\n", @p_state_names[i], x[i]);
        }
        printf("trace %.17g\n", trace);
    }
@@ right-hand side
    {
        static double state[@P_STATES], dxdt[@P_STATES], work[@P_RHS_WORK];
        double p[@P_PARAMETERS + 1] = {0.0};
        int i;

@nominal        for (i = 0; i < @P_STATES; i++) state[i] = 0.1 / (i + 1);
        @p_rhs(0.0, state, p, dxdt, work);
        for (i = 0; i < @P_STATES; i += 1 + @P_STATES / @shown) printf("rhs_%d %.17g\n", i, dxdt[i]);
    }
@@ sizes
    printf("states %d\n", @P_STATES);
@@ nominal values
        for (i = 0; i < @P_PARAMETERS; i++) p[i] = @p_nominal[i];
