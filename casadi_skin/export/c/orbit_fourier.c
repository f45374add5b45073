/* A converged orbit: x_n(t) = sum_k a_kn cos(k w t) + b_kn sin(k w t), w = 2 pi/T. */

#include "@p.h"

#include <math.h>

int @p_orbit(double t, double *restrict x, double *restrict dxdt)
{
    const double w = 2.0 * acos(-1.0) / @p_orbit_period, theta = 2.0 * acos(-1.0) * fmod(t / @p_orbit_period, 1.0);
    int n, k;

    for (n = 0; n < @P_ORBIT_STATES; n++) {
        if (x) x[n] = 0.0;
        if (dxdt) dxdt[n] = 0.0;
    }
    for (k = 0; k <= @P_HARMONICS; k++) {
        const double c = cos(k * theta), s = sin(k * theta);
        for (n = 0; n < @P_ORBIT_STATES; n++) {
            const double a = @p_orbit_cosines[k * @P_ORBIT_STATES + n], b = @p_orbit_sines[k * @P_ORBIT_STATES + n];
            if (x) x[n] += a * c + b * s;
            if (dxdt) dxdt[n] += k * w * (b * c - a * s);
        }
    }
    return 0;
}
