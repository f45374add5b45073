@@ rhs
/* dx/dt at time t (STATES entries). Returns 0. */
int @p_rhs(double t, const double *restrict x, const double *restrict p, double *restrict dxdt, double *restrict work);
@@ jacobian
/* dx/dt, the non-zeros of df/dx by columns (JACOBIAN_NONZEROS of them; column j has entries colptr[j] to colptr[j+1]-1
 * in the rows named), and df/dp, dense by columns (STATES times PARAMETERS). A result may be a null pointer where it is
 * not wanted. Returns 0. */
int @p_jacobian(double t, const double *restrict x, const double *restrict p, double *restrict dxdt,
                double *restrict dfdx, double *restrict dfdp, double *restrict work);
@@ variational
/* dx/dt and dV/dt = (df/dx) V for V of any number of columns, one after the other (STATES entries each). Returns 0. */
int @p_variational(double t, const double *restrict x, const double *restrict p, int columns, const double *restrict V,
                   double *restrict dxdt, double *restrict dVdt, double *restrict work);
@@ outputs
/* The outputs (OUTPUTS entries). Returns 0. */
int @p_outputs(double t, const double *restrict x, const double *restrict p, double *restrict y,
               double *restrict work);
@@ flow_splitting
/* Moves the state x (FLOW_STATES entries, p as many as FLOW_PARAMETERS) from time t on by `duration` in equal steps
 * (symplectic splitting of order 6) and gives the transition matrix Phi, by columns, unless it is a null pointer.
 * Returns 0, or 1 for steps < 1. */
int @p_flow(double t, double duration, int steps, double *restrict x, double *restrict Phi, const double *restrict p,
            double *restrict work);
@@ flow_extrapolation
/* Moves the state x (FLOW_STATES entries, p as many as FLOW_PARAMETERS) from time t on by `duration` in equal steps
 * (extrapolated midpoint rule of order 8) and gives the transition matrix Phi, by columns, unless it is a null pointer:
 * then 8 FLOW_STATES + VARIATIONAL_WORK doubles of work are enough. Returns 0, or 1 for steps < 1. */
int @p_flow(double t, double duration, int steps, double *restrict x, double *restrict Phi, const double *restrict p,
            double *restrict work);
@@ force
/* Used by the flow. */
int @p_force(double t, const double *restrict q, const double *restrict p, double *restrict force,
             double *restrict dfdq, double *restrict work);
@@ multipliers
/* The flow of a chain is that of the gauge: x = (q, q'), p = (kappa). Floquet multipliers of an orbit that starts at
 * rest, from Phi over a quarter of its period: the SITES numbers mu, with 2 + 4 mu = lambda + 1/lambda for the map over
 * half the period, and the largest modulus of a multiplier lambda^2 over the period but for the trivial pair (mu = -1),
 * whose distance from -1 is `trivial`. A mu that is real and in [-1, 0] within `tolerance` has modulus 1: the orbit is
 * stable where all are. Returns 0, or 1 where the QR iteration does not converge. */
int @p_multipliers(const double *restrict Phi, double tolerance, double *restrict mu_real,
                   double *restrict mu_imaginary, double *restrict largest, double *restrict trivial,
                   double *restrict work);
@@ residual
/* The collocation equations R(z) = 0 of periodic orbits that start at rest (EQUATIONS entries) and the non-zeros of
 * dR/dz by columns, in the pattern below. z holds q_n at the NODES phases Omega t = (i + 1/2) pi/(2 NODES), site after
 * site, then Omega, then the parameter kappa = g S; the last equation is that the sum of rho_n^2 q_n^2 is 1 at t = 0.
 * Returns 0. */
int @p_residual(const double *restrict z, double *restrict R, double *restrict dRdz, double *restrict work);
@@ linear_mode
/* The linear mode 1..SITES as unknowns z with kappa = 0, where a family starts. Returns 0, or 1 for a mode that is not
 * there or does not oscillate. */
int @p_linear_mode(int mode, double *restrict z);

/* Positions q_n at t = 0, where all velocities vanish. */
void @p_positions(const double *restrict z, double *restrict q);
@@ newton
typedef struct {
    int status;      /* one of the constants below */
    int iterations;  /* linear systems solved */
    double step;     /* length of the last step, relative to the orbit */
    double residual; /* largest |R| before that step */
} @p_newton_report;
enum { @P_CONVERGED, @P_TOO_MANY_ITERATIONS, @P_SINGULAR, @P_DIVERGED, @P_BAD_INPUT };

/* Newton's method from the guess z for the orbit whose unknown `held` (OMEGA or PARAMETER) has this value, until a step
 * is not longer than `tolerance`, relative to the orbit, in `most` iterations at most. Returns the status, 0 where it
 * converged; z is changed then only. */
int @p_newton(double *restrict z, int held, double value, double tolerance, int most, @p_newton_report *report,
              double *restrict work);

/* A status in words. */
const char *@p_newton_words(int status);
@@ solve_band
/* Used by Newton's method. */
int @p_solve(const double *restrict dRdz, int held, const double *restrict z, double *restrict b,
             double *restrict work);
@@ ipopt
/* The orbit with this kappa by Ipopt, from a guess: unknowns z and the residuals R of the equations (UNKNOWNS entries),
 * which the caller checks. Needs libipopt; not for several threads at once. Returns 0. */
int @p_ipopt(const double *restrict guess, double kappa, double *restrict z, double *restrict R,
             double *restrict work);
@@ orbit
/* Displacements and velocities of the sites at time t in physical coordinates; either may be a null pointer. Returns
 * 0. */
int @p_orbit(double t, double *restrict y, double *restrict velocity);
@@ orbit_fourier
/* x at time t and its time derivative; either may be a null pointer. Returns 0. */
int @p_orbit(double t, double *restrict x, double *restrict dxdt);
@@ begin
#include <stddef.h>

#if defined(__cplusplus) || defined(_MSC_VER) /* where C99's `restrict` is no keyword */
#define @P_RESTRICT __restrict
#else
#define @P_RESTRICT restrict
#endif

#ifdef __cplusplus
extern "C" {
#endif
@@ end
#ifdef __cplusplus
}
#endif
