/* A converged orbit: y_n(t) = sum_k c_kn cos((2k+1) Omega t), summed by Clenshaw's recurrence. */

#include "@p.h"

#include <math.h>

int @p_orbit(double t, double *restrict y, double *restrict velocity)
{
    double theta = fmod(@p_orbit_Omega * t, 2.0 * acos(-1.0)), twice = 2.0 * cos(2.0 * theta);
    int n, k;

    for (n = 0; n < @P_SITES; n++) {
        double b1 = 0.0, b2 = 0.0, d1 = 0.0, d2 = 0.0;
        for (k = @P_HARMONICS - 1; k >= 0; k--) {
            double c = @p_orbit_coefficients[k * @P_SITES + n], b = c + twice * b1 - b2;
            double d = (2 * k + 1) * c + twice * d1 - d2;
            b2 = b1, b1 = b;
            d2 = d1, d1 = d;
        }
        if (y) y[n] = (b1 - b2) * cos(theta);
        if (velocity) velocity[n] = -@p_orbit_Omega * (d1 + d2) * sin(theta);
    }
    return 0;
}
