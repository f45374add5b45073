/* Floquet multipliers from the transition matrix over a quarter of the period of an odd, reversible orbit.
 *
 * With Phi = [[A, B], [C, D]] and mu the eigenvalues of B^T C, the map over half the period has lambda + 1/lambda =
 * 2 + 4 mu, and the multipliers over the period are lambda^2. The eigenvalues come from the reduction to Hessenberg form
 * by elimination, and Francis' QR iteration with double shifts in real arithmetic (Martin, Peters and Wilkinson 1970;
 * Golub and Van Loan, Matrix Computations, section 7.5). What is below NEGLIGIBLE of a pivot is left out: far from the
 * diagonal the matrix of a long chain is as small as that. */

#include "@p.h"

#include <math.h>

#define NEGLIGIBLE 1e-40
#define EPSILON 2.3e-16
enum { N = @P_FLOW_STATES / 2, SWEEPS = 60 };

/* The entry of row i and column j of the matrix at `h`. */
#define H(i, j) h[(size_t)(j) * N + (size_t)(i)]

/* B^T C: four sums at a time, which do not wait for each other. */
static void product(const double *restrict Phi, double *restrict h)
{
    size_t i, j, k;

    for (j = 0; j < N; j++) {
        const double *c = Phi + 2 * N * j + N;
        for (i = 0; i < N; i++) {
            const double *b = Phi + 2 * N * (N + i);
            double first = 0.0, second = 0.0, third = 0.0, fourth = 0.0;
            for (k = 0; k + 3 < N; k += 4) {
                first += b[k] * c[k];
                second += b[k + 1] * c[k + 1];
                third += b[k + 2] * c[k + 2];
                fourth += b[k + 3] * c[k + 3];
            }
            for (; k < N; k++) first += b[k] * c[k];
            h[j * N + i] = first + second + (third + fourth);
        }
    }
}

static void swap(double *a, double *b)
{
    double kept = *a;

    *a = *b;
    *b = kept;
}

/* `factors` holds N numbers. */
static void hessenberg(double *restrict h, double *restrict factors)
{
    int i, j, k, largest, last;

    for (k = 1; k < N - 1; k++) {
        double *column = &H(0, k);
        for (largest = k, i = k + 1; i < N; i++)
            if (fabs(H(i, k - 1)) > fabs(H(largest, k - 1))) largest = i;
        if (!(fabs(H(largest, k - 1)) > 0.0)) continue;
        if (largest != k) {
            for (j = k - 1; j < N; j++) swap(&H(k, j), &H(largest, j));
            for (i = 0; i < N; i++) swap(&H(i, k), &H(i, largest));
        }
        for (last = k, i = k + 1; i < N; i++) {
            factors[i] = H(i, k - 1) / H(k, k - 1);
            if (fabs(factors[i]) > NEGLIGIBLE) last = i;
            H(i, k - 1) = 0.0;
        }
        for (j = k; j < N; j++) {
            double *to = &H(0, j), upper = H(k, j);
            if (fabs(upper) > 0.0)
                for (i = k + 1; i <= last; i++) to[i] -= factors[i] * upper;
        }
        for (j = k + 1; j <= last; j++) {
            const double *from = &H(0, j), factor = factors[j];
            for (i = 0; i < N; i++) column[i] += factor * from[i];
        }
    }
}

/* Both eigenvalues of rows and columns last-1 and last. */
static void pair(const double *h, int last, double *real, double *imaginary)
{
    double half = 0.5 * (H(last - 1, last - 1) - H(last, last)), corner = H(last, last);
    double off = H(last, last - 1) * H(last - 1, last), square = half * half + off, root = sqrt(fabs(square));

    real[last] = real[last - 1] = corner + half;
    imaginary[last] = imaginary[last - 1] = 0.0;
    if (square < 0.0) {
        imaginary[last - 1] = root;
        imaginary[last] = -root;
    } else {
        double sum = half + (half < 0.0 ? -root : root);
        real[last - 1] = corner + sum;
        real[last] = fabs(sum) > 0.0 ? corner - off / sum : corner;
    }
}

/* One double step on rows and columns first..last; x, y and w are the shifts: their sum is x + y, their product xy - w. */
static void sweep(double *h, int first, int last, double x, double y, double w)
{
    double p = 0.0, q = 0.0, r = 0.0, s, size = 1.0;
    int i, j, k, start;

    for (start = last - 2;; start--) { /* from two small entries below the diagonal on, where there are any */
        double z = H(start, start);
        p = ((x - z) * (y - z) - w) / H(start + 1, start) + H(start, start + 1);
        q = H(start + 1, start + 1) - z - (x - z) - (y - z);
        r = H(start + 2, start + 1);
        s = fabs(p) + fabs(q) + fabs(r);
        p /= s;
        q /= s;
        r /= s;
        if (start == first) break;
        s = fabs(H(start - 1, start - 1)) + fabs(z) + fabs(H(start + 1, start + 1));
        if (fabs(H(start, start - 1)) * (fabs(q) + fabs(r)) <= EPSILON * fabs(p) * s) break;
    }
    for (i = start + 2; i <= last; i++) {
        H(i, i - 2) = 0.0;
        if (i > start + 2) H(i, i - 3) = 0.0;
    }
    for (k = start; k < last; k++) {
        const int three = k < last - 1, low = k + 3 < last ? k + 3 : last;
        double u, v, t, *a = &H(0, k), *b = &H(0, k + 1), *c = three ? &H(0, k + 2) : b;
        if (k > start) {
            p = H(k, k - 1);
            q = H(k + 1, k - 1);
            r = three ? H(k + 2, k - 1) : 0.0;
            size = fabs(p) + fabs(q) + fabs(r);
            if (!(size > 0.0)) continue;
            p /= size;
            q /= size;
            r /= size;
        }
        s = sqrt(p * p + q * q + r * r);
        if (p < 0.0) s = -s;
        if (k > start) H(k, k - 1) = -s * size;
        else if (start > first) H(k, k - 1) = -H(k, k - 1);
        p += s;
        t = p / s;
        u = q / s;
        v = r / s;
        q /= p;
        r /= p;
        for (j = k; j <= last; j++) {
            double *row = &H(k, j), sum = row[0] + q * row[1];
            if (three) {
                sum += r * row[2];
                row[2] -= sum * v;
            }
            row[1] -= sum * u;
            row[0] -= sum * t;
        }
        if (three)
            for (i = first; i <= low; i++) {
                double sum = t * a[i] + u * b[i] + v * c[i];
                a[i] -= sum;
                b[i] -= sum * q;
                c[i] -= sum * r;
            }
        else
            for (i = first; i <= low; i++) {
                double sum = t * a[i] + u * b[i];
                a[i] -= sum;
                b[i] -= sum * q;
            }
    }
}

static int eigenvalues(double *h, double *real, double *imaginary)
{
    int last = N - 1, first, tries = 0;

    while (last >= 0) {
        for (first = last; first > 0; first--) {
            double size = fabs(H(first, first)) + fabs(H(first - 1, first - 1));
            if (fabs(H(first, first - 1)) <= EPSILON * size) break;
        }
        if (first >= last - 1) {
            if (first < last) {
                pair(h, last, real, imaginary);
            } else {
                real[last] = H(last, last);
                imaginary[last] = 0.0;
            }
            last = first - 1;
            tries = 0;
            continue;
        }
        if (++tries > SWEEPS) return 1;
        if (tries % 10) {
            double off = H(last, last - 1) * H(last - 1, last);
            sweep(h, first, last, H(last, last), H(last - 1, last - 1), off);
        } else { /* other shifts, where it goes round in circles */
            double size = fabs(H(last, last - 1)) + fabs(H(last - 1, last - 2)), middle = H(last, last) + 0.75 * size;
            sweep(h, first, last, middle, middle, -0.4375 * size * size);
        }
    }
    return 0;
}

/* Modulus of the multiplier lambda^2 outside the unit circle, lambda + 1/lambda = 2 + 4 mu. */
static double modulus(double real, double imaginary, double tolerance)
{
    const double a = real * (real + 1.0) - imaginary * imaginary, b = imaginary * (2.0 * real + 1.0);
    const double size = hypot(a, b), long_part = sqrt(2.0 * (size + fabs(a)));
    const double short_part = long_part > 0.0 ? 2.0 * fabs(b) / long_part : 0.0;
    const double root = a < 0.0 ? short_part : long_part, turned = copysign(a < 0.0 ? long_part : short_part, b);
    const double c = 1.0 + 2.0 * real, d = 2.0 * imaginary; /* c + i d, and the root of 4 mu (mu + 1) */
    const double larger = fmax(hypot(c + root, d + turned), hypot(c - root, d - turned));

    if (fabs(imaginary) <= tolerance && real >= -1.0 - tolerance && real <= tolerance) return 1.0;
    return larger * larger;
}

int @p_multipliers(const double *restrict Phi, double tolerance, double *restrict mu_real,
                   double *restrict mu_imaginary, double *restrict largest, double *restrict trivial,
                   double *restrict work)
{
    double *h = work;
    int i, nearest = 0;

    product(Phi, h);
    hessenberg(h, h + (size_t)N * N);
    if (eigenvalues(h, mu_real, mu_imaginary)) return 1;
    for (i = 0; i < N; i++)
        if (hypot(mu_real[i] + 1.0, mu_imaginary[i]) < hypot(mu_real[nearest] + 1.0, mu_imaginary[nearest])) nearest = i;
    *trivial = hypot(mu_real[nearest] + 1.0, mu_imaginary[nearest]);
    *largest = 1.0;
    for (i = 0; i < N; i++)
        if (i != nearest) *largest = fmax(*largest, modulus(mu_real[i], mu_imaginary[i], tolerance));
    return 0;
}
