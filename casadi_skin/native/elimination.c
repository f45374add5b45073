/* Cells of a row eliminated from its free end on, but for the last; see stability/hill.py. */

#include <math.h>
#include <string.h>

#include "kernel.h"

typedef struct {
    int64_t cells, size, parts, sites, from, to; /* parts: 2 for complex numbers, real parts of a matrix first */
    const double *blocks, *springs;              /* real: (cells, size, size); of the bond behind each cell */
} row;

static void swap(double *x, double *y, int64_t count, int64_t step)
{
    for (int64_t i = 0; i < count * step; i += step) {
        const double other = x[i];
        x[i] = y[i], y[i] = other;
    }
}

/* One step of Gauss and Jordan on row i, by row k, which is divided by its pivot already. */
static void step_real(int64_t n, double *restrict x, const double *restrict pivot, int64_t k)
{
    const double f = x[k];
    x[k] = 0.0;
    for (int64_t j = 0; j < n; j++)
        x[j] -= f * pivot[j];
}

static void step_complex(int64_t n, double *restrict x, double *restrict y, const double *restrict re,
                         const double *restrict im, int64_t k)
{
    const double f = x[k], g = y[k];
    x[k] = y[k] = 0.0;
    for (int64_t j = 0; j < n; j++) {
        x[j] -= f * re[j] - g * im[j];
        y[j] -= f * im[j] + g * re[j];
    }
}

/* The inverse in the place of A, with exchanges of rows; its determinant is added to log and phase. */
static void invert(int64_t n, int64_t parts, double *A, int64_t *exchanges, double *log_det, double *phase)
{
    double *B = A + n * n; /* imaginary parts */
    for (int64_t k = 0; k < n; k++) {
        int64_t p = k;
        double most = -1.0;
        for (int64_t i = k; i < n; i++) {
            const double here = fabs(A[i * n + k]) + (parts == 2 ? fabs(B[i * n + k]) : 0.0);
            if (here > most)
                most = here, p = i;
        }
        exchanges[k] = p;
        for (int64_t part = 0; p != k && part < parts; part++)
            swap(A + part * n * n + k * n, A + part * n * n + p * n, n, 1);
        double *re = A + k * n, *im = B + k * n;
        const double a = re[k], b = parts == 2 ? im[k] : 0.0, size = hypot(a, b), sign = p == k ? 1.0 : -1.0;
        const double c = a / size * sign, s = b / size * sign, old = phase[0];
        *log_det += log(size);
        phase[0] = old * c - phase[1] * s, phase[1] = old * s + phase[1] * c;
        const double u = a / size / size, v = -b / size / size; /* 1 over the pivot */
        re[k] = 1.0;
        if (parts == 2)
            im[k] = 0.0;
        for (int64_t j = 0; j < n; j++) {
            const double x = re[j], y = parts == 2 ? im[j] : 0.0;
            re[j] = x * u - y * v;
            if (parts == 2)
                im[j] = x * v + y * u;
        }
        for (int64_t i = 0; i < n; i++) {
            if (i == k)
                continue;
            if (parts == 2)
                step_complex(n, A + i * n, B + i * n, re, im, k);
            else
                step_real(n, A + i * n, re, k);
        }
    }
    for (int64_t k = n - 1; k >= 0; k--)
        for (int64_t part = 0; exchanges[k] != k && part < parts; part++)
            swap(A + part * n * n + k, A + part * n * n + exchanges[k], n, n);
}

/* For each of `values` squares of frequencies, (values, parts, size): the inverse for cell number 1, (values, parts,
   size, size), logarithms and phases, (values) and (values, 2), of the product of determinants down to it. `memory` has
   `parts * size * size` numbers, `exchanges` `size`. */
KERNEL(eliminated)(const row *r, int64_t values, const double *squares, double *behind, double *logs, double *phases,
                   double *memory, int64_t *exchanges)
{
    const int64_t n = r->size, area = n * n, count = n / r->sites;
    for (; values > 0; values--, squares += r->parts * n, behind += r->parts * area, logs++, phases += 2) {
        *logs = 0.0, phases[0] = 1.0, phases[1] = 0.0;
        for (int64_t cell = r->cells - 1; cell > 0; cell--) {
            memset(memory, 0, (size_t)(r->parts * area) * sizeof(double));
            memcpy(memory, r->blocks + cell * area, (size_t)area * sizeof(double));
            for (int64_t part = 0; part < r->parts; part++) {
                double *A = memory + part * area;
                for (int64_t i = 0; i < n; i++)
                    A[i * (n + 1)] -= squares[part * n + i];
                if (cell == r->cells - 1)
                    continue;
                const double square = r->springs[cell] * r->springs[cell], *there = behind + part * area;
                for (int64_t i = 0; i < count; i++)
                    for (int64_t j = 0; j < count; j++)
                        A[(i * r->sites + r->from) * n + j * r->sites + r->from] -=
                            square * there[(i * r->sites + r->to) * n + j * r->sites + r->to];
            }
            invert(n, r->parts, memory, exchanges, logs, phases);
            memcpy(behind, memory, (size_t)(r->parts * area) * sizeof(double));
        }
    }
    return 0;
}
