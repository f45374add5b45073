/* Linear modes in closed form: the orbits of vanishing amplitude, exact where the parameter kappa = g S is 0. */

#include "@p.h"

#include <math.h>

int @p_linear_mode(int mode, double *z)
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
