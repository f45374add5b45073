/* The right-hand side with the variational equations V' = J V of any number of columns. */

#include "@p.h"

int @p_variational(double t, const double *restrict x, const double *restrict p, int columns, const double *restrict V,
                   double *restrict dxdt, double *restrict dVdt, double *restrict work)
{
    double *J = work, *rest = work + @P_JACOBIAN_NONZEROS;
    int c, j, k, failed = @p_jacobian(t, x, p, dxdt, J, 0, rest);

    for (c = 0; c < columns && !failed; c++) {
        const double *v = V + (size_t)c * @P_STATES;
        double *result = dVdt + (size_t)c * @P_STATES;
        for (j = 0; j < @P_STATES; j++) result[j] = 0.0;
        for (j = 0; j < @P_STATES; j++)
            for (k = @p_jacobian_colptr[j]; k < @p_jacobian_colptr[j + 1]; k++) result[@p_jacobian_row[k]] += J[k] * v[j];
    }
    return failed;
}
