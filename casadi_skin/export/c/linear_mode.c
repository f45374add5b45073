/* Linear modes in closed form: the orbits of vanishing amplitude, exact where the parameter kappa = g S is 0; and positions
 * at t = 0 of any orbit. */

#include "@p.h"

#include <math.h>

int @p_linear_mode(int mode, double *restrict z)
{
    const double pi = acos(-1.0), s = sqrt((1.0 - @p_gamma) * (1.0 + @p_gamma));
    double norm = 0.0, half = sin(mode * pi / (2 * @P_SITES + 2));
    double square = @p_alpha + 2.0 * @p_gamma * @p_gamma / (1.0 + s) + 4.0 * s * half * half;
    int n, i;

    if (mode < 1 || mode > @P_SITES || !(square > 0.0)) return 1;
    for (n = 0; n < @P_SITES; n++) {
        double turn = fmod((n + 1.0) * mode, 2.0 * (@P_SITES + 1)); /* the sine of a reduced angle */
        double q = sin(turn * pi / (@P_SITES + 1));
        norm += @p_rho[n] * @p_rho[n] * q * q;
        for (i = 0; i < @P_NODES; i++) z[n * @P_NODES + i] = q * cos((i + 0.5) * pi / (2 * @P_NODES));
    }
    for (i = 0; i < @P_STATE_UNKNOWNS; i++) z[i] /= sqrt(norm);
    z[@P_OMEGA] = sqrt(square);
    z[@P_PARAMETER] = 0.0;
    return 0;
}

/* The polynomial in odd cosines through values at theta_i = (i + 1/2) pi/(2 NODES) has at 0 their sum times
 * (2/NODES) sum_k cos((2k + 1) theta_i) = (-1)^i/(NODES sin theta_i). */
void @p_positions(const double *restrict z, double *restrict q)
{
    const double step = acos(-1.0) / (2 * @P_NODES);
    int n, i, nodes = @P_NODES;

    for (n = 0; n < @P_SITES; n++) q[n] = 0.0;
    for (i = 0; i < @P_NODES; i++) {
        const double weight = (i % 2 ? -1.0 : 1.0) / (nodes * sin((i + 0.5) * step));
        for (n = 0; n < @P_SITES; n++) q[n] += weight * z[n * @P_NODES + i];
    }
}
