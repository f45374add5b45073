/* What the kernels share: their names, terms of polynomials, and programs.

   Every source is compiled for any processor, and on x86-64 for AVX2 and AVX-512 too, under names of its own: REGISTER
   numbers go together. Fields of structures have eight bytes each, as native/__init__.py writes them. */

#include <math.h>
#include <stdint.h>

_Static_assert(sizeof(void *) == 8 && sizeof(double) == 8, "fields of structures have eight bytes");

#if defined(__AVX512F__)
#define NAMED(name) name##_avx512
enum { REGISTER = 8 };
#elif defined(__AVX2__)
#define NAMED(name) name##_avx2
enum { REGISTER = 4 };
#else
#define NAMED(name) name
enum { REGISTER = 2 };
#endif
#ifdef _WIN32
#define KERNEL(name) __declspec(dllexport) int NAMED(name)
#else
#define KERNEL(name) __attribute__((visibility("default"))) int NAMED(name) /* returns 0, or 1 where it fails */
#endif

/* The largest modulus, NaN where one of the numbers is none or not finite. */
static inline double largest(const double *x, int64_t count)
{
    double most[8] = {0.0}, none[8] = {0.0}; /* independent of one another, so that they go together */
    for (; count % 8; count--) {
        most[0] = fabs(x[count - 1]) > most[0] ? fabs(x[count - 1]) : most[0];
        none[0] += x[count - 1] * 0.0;
    }
    for (int64_t i = 0; i < count; i += 8)
        for (int64_t k = 0; k < 8; k++) {
            most[k] = fabs(x[i + k]) > most[k] ? fabs(x[i + k]) : most[k];
            none[k] += x[i + k] * 0.0;
        }
    for (int64_t k = 1; k < 8; k++) {
        most[0] = most[k] > most[0] ? most[k] : most[0];
        none[0] += none[k];
    }
    return most[0] + none[0];
}

/* Terms coefficient * p^power * product of `degree` states, each added to a place of its own, a row or a non-zero. */
typedef struct {
    int64_t count;
    const int64_t *powers, *degrees, *places, *first_factors, *factors;
    const double *coefficients;
} terms;

/* Solutions of `count` systems in the place of their right-hand sides, (count, size), by factors in `memory`. */
int NAMED(bordered_solve)(const void *layout, double *memory, int64_t count, double *x);
int NAMED(collocation_solve)(const void *layout, double *memory, int64_t count, double *x);
int NAMED(collocation_factors)(const void *layout, const double *nonzeros, const double *row, const double *sizes,
                               double least, double *memory, double *sign, double *x, double *room);

/* Operations on lists of numbers; those up to `fixed` do not depend on the state, which `values` begin with. */
typedef struct {
    int64_t states, fixed, count;
    const int64_t *lists, *results; /* (count, 7), and the places of the results, (states) */
    double *values;
} program;

void NAMED(evaluate)(const program *p, int64_t first, int64_t last);

/* A function at many places. */
typedef struct {
    int64_t count, together, arguments, results; /* places, those that go together, arguments and results */
    const program *of;                           /* whose values begin with the entries of all arguments, each a list */
    const int64_t *argument_sizes, *result_sizes;
    double *const *argument; /* (count, size) each */
    double *const *result;
} places;

int NAMED(at_places)(const places *p);

/* Solutions in the place of X, (n, columns), with A, which is overwritten; the sign of its determinant: multipliers.c. */
double NAMED(divide)(int64_t n, int64_t columns, double *A, double *X);

/* Eigenvalues and vectors, units that balance a matrix, and its smallest and largest singular value: eigenvalues.c. */
int NAMED(eigenvalues)(int64_t n, double *A, double *re, double *im, double *vectors, double *memory);
void NAMED(balancing)(int64_t n, double *A, double *units);
void NAMED(singular_values)(int64_t rows, int64_t n, double *A, double *least, double *most);

/* Of collocation equations, equations.c: derivatives at the stages and at places, and velocities at ends of intervals. */
int NAMED(collocation_jacobians)(const void *of, const double *z, const double *numbers, int64_t n, const int64_t *rows,
                                 const int64_t *columns, double *jacobians);
void NAMED(collocation_jacobians_at)(const void *of, const void *polynomials, const double *edges, const double *z,
                                     const double *numbers, int64_t count, const double *at, int64_t n,
                                     const int64_t *rows, const int64_t *columns, double *jacobians);
void NAMED(collocation_velocities)(const void *of, const double *z, const double *numbers, int64_t count,
                                   double *velocities);

/* Collocation equations between the ends of intervals: interval_maps.c; factors of those: collocation.c. */
void NAMED(condense)(const void *method, int64_t K, int64_t n, int64_t m, const double *lengths, const double *jacobians,
                     const double *by_scalars, const double *residual, int64_t apart, double *maps, double *inner,
                     double *memory);
int NAMED(collocation_factors)(const void *layout, const double *nonzeros, const double *row, const double *sizes,
                               double least, double *memory, double *sign, double *x, double *room);

/* Maps over intervals, what may change in these, and multipliers of a chain: interval_maps.c, multipliers.c. */
int NAMED(interval_maps)(const void *of, int64_t K, int64_t n, const double *lengths, const double *jacobians,
                         double *maps, double *contraction, double *memory);
void NAMED(changes)(int64_t K, int64_t d, int64_t n, const double *lengths, const double *jacobians, double enough,
                    double small, double *bounds);
int NAMED(multipliers)(int64_t K, int64_t n, int64_t r, int64_t l, int64_t trivial, double contraction, double sign,
                       int64_t wanted, const double *maps, const double *right, const double *left, const double *units,
                       const double *general, double *found, double *memory);
