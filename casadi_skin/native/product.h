/* Products of matrices of which only the second is copied into lanes. */

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
