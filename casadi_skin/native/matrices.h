/* Matrices by their real and imaginary parts, in rows of whole lanes. */

#include <stdint.h>

#if defined(__AVX512F__)
enum { LANES = 8 };
#else
enum { LANES = 4 };
#endif
enum { ROWS = 4 };
typedef double lanes __attribute__((vector_size(LANES * sizeof(double)), aligned(sizeof(double))));

/* result (rows, width) += sign A B with A (rows, inner), `down` and `across` numbers from entry to entry, and
   B (inner, width). */
static void add_product(int64_t rows, int64_t inner, int64_t width, double sign, const double *A, int64_t down,
                        int64_t across, const double *B, double *result)
{
    for (int64_t first = 0; first < rows; first += ROWS) {
        const double *row[ROWS];
        for (int64_t r = 0; r < ROWS; r++)
            row[r] = A + (first + r < rows ? first + r : rows - 1) * down;
        for (int64_t k = 0; k < width; k += LANES) {
            lanes sums[ROWS] = {{0.0}};
            for (int64_t b = 0; b < inner; b++) {
                const lanes here = *(const lanes *)(B + b * width + k);
                for (int64_t r = 0; r < ROWS; r++)
                    sums[r] += row[r][b * across] * here;
            }
            for (int64_t r = 0; r < ROWS && first + r < rows; r++)
                *(lanes *)(result + (first + r) * width + k) += sign * sums[r];
        }
    }
}

/* Numbers by rows, real and imaginary parts side by side, (rows, columns) -> (rows, width) each. */
static void separate(int64_t parts, const double *from, int64_t rows, int64_t columns, int64_t width,
                     double *const to[2])
{
    for (int64_t i = 0; i < parts; i++)
        for (int64_t a = 0; a < rows; a++)
            for (int64_t k = 0; k < columns; k++)
                to[i][a * width + k] = from[(a * columns + k) * parts + i];
}
