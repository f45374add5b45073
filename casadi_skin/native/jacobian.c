/* Non-zeros of the Jacobian of a polynomial right-hand side along orbits given by their values at nodes. */

#include <stdint.h>
#include <string.h>

#define EXPORTED __attribute__((visibility("default")))

/* Terms coefficient * p^power * product of `degree` states, each added to one of the non-zeros. */
typedef struct {
    int64_t count;
    const int64_t *powers, *degrees, *places, *first_factors, *factors;
    const double *coefficients;
} terms;

/* States at the phases, (sites, phases): the values of one orbit at its nodes, (sites, nodes), times weights. */
static void sample(int64_t sites, int64_t nodes, int64_t phases, const double *values, const double *weights,
                   double *states)
{
    memset(states, 0, (size_t)(sites * phases) * sizeof(double));
    for (int64_t a = 0; a < sites; a++)
        for (int64_t m = 0; m < nodes; m++)
            for (int64_t i = 0; i < phases; i++)
                states[a * phases + i] += values[a * nodes + m] * weights[m * phases + i];
}

/* Non-zeros of J along several orbits, (orbits, phases, nonzeros): `constant` and the terms. The values of an orbit are
   `stride` numbers after those of the orbit before; `weights` has shape (nodes, phases), `parameters` one p an orbit.
   `states` has sites * phases entries, `products` one for each phase. */
EXPORTED void casadi_skin_jacobians(int64_t orbits, int64_t sites, int64_t nodes, int64_t phases, const double *values,
                                    int64_t stride, const double *weights, const double *parameters, int64_t nonzeros,
                                    const double *constant, const terms *t, double *states, double *products,
                                    double *result)
{
    for (int64_t k = 0; k < orbits; k++, result += phases * nonzeros) {
        sample(sites, nodes, phases, values + k * stride, weights, states);
        for (int64_t i = 0; i < phases; i++)
            memcpy(result + i * nonzeros, constant, (size_t)nonzeros * sizeof(double));
        for (int64_t n = 0; n < t->count; n++) {
            const int64_t *factors = t->factors + t->first_factors[n];
            double coefficient = t->coefficients[n], *place = result + t->places[n];
            for (int64_t power = 0; power < t->powers[n]; power++)
                coefficient *= parameters[k];
            for (int64_t i = 0; i < phases; i++)
                products[i] = coefficient;
            for (int64_t d = 0; d < t->degrees[n]; d++)
                for (int64_t i = 0; i < phases; i++)
                    products[i] *= states[factors[d] * phases + i];
            for (int64_t i = 0; i < phases; i++)
                place[i * nonzeros] += products[i];
        }
    }
}
