/* Floquet multipliers from the transition matrix over a quarter of the period of an odd, reversible orbit.
 *
 * With Phi = [[A, B], [C, D]] and mu the eigenvalues of B^T C, the map over half the period has lambda + 1/lambda =
 * 2 + 4 mu, and the multipliers over the period are lambda^2. The eigenvalues come from the reduction to Hessenberg form
 * by elimination, and the QR iteration with shifts (Golub and Van Loan, Matrix Computations, section 7.5), in complex
 * arithmetic. In arrays a complex number is two doubles, for the caller's array is one of doubles. */

#include "@p.h"

#include <complex.h>
#include <math.h>

enum { N = @P_FLOW_STATES / 2, SWEEPS = 60 };

static double complex get(const double *place)
{
    return place[0] + place[1] * I;
}

static void put(double *place, double complex value)
{
    place[0] = creal(value);
    place[1] = cimag(value);
}

/* The entry of row i and column j of the matrix at `h`, and its place. */
#define AT(i, j) (h + 2 * ((size_t)(j) * N + (i)))
#define H(i, j) get(AT(i, j))

static void swap(double *a, double *b)
{
    double complex kept = get(a);

    put(a, get(b));
    put(b, kept);
}

static void hessenberg(double *h)
{
    int i, j, k, largest;

    for (k = 1; k < N - 1; k++) {
        for (largest = k, i = k + 1; i < N; i++)
            if (cabs(H(i, k - 1)) > cabs(H(largest, k - 1))) largest = i;
        if (cabs(H(largest, k - 1)) == 0.0) continue;
        for (j = 0; j < N; j++) swap(AT(k, j), AT(largest, j));
        for (i = 0; i < N; i++) swap(AT(i, k), AT(i, largest));
        for (i = k + 1; i < N; i++) {
            double complex factor = H(i, k - 1) / H(k, k - 1);
            for (j = 0; j < N; j++) put(AT(i, j), H(i, j) - factor * H(k, j));
            for (j = 0; j < N; j++) put(AT(j, k), H(j, k) + factor * H(j, i));
        }
    }
}

/* The eigenvalue of the last 2 x 2 block of 0..last that is nearer to its last entry. */
static double complex shift(const double *h, int last)
{
    double complex a = H(last - 1, last - 1), d = H(last, last), half = 0.5 * (a - d);
    double complex product = H(last - 1, last) * H(last, last - 1), root = csqrt(half * half + product);

    if (creal(conj(half) * root) < 0.0) root = -root;
    return cabs(half + root) > 0.0 ? d - product / (half + root) : d;
}

/* One QR step on rows and columns first..last: rotations from the left, then from the right. */
static void sweep(double *h, int first, int last, double complex s, double *turns)
{
    double *turn;
    int i, k;

    for (k = first; k <= last; k++) put(AT(k, k), H(k, k) - s);
    for (k = first, turn = turns; k < last; k++, turn += 4) {
        double complex a = H(k, k), b = H(k + 1, k), c, d;
        double size = hypot(cabs(a), cabs(b));
        c = size > 0.0 ? a / size : 1.0;
        d = size > 0.0 ? b / size : 0.0;
        put(turn, c);
        put(turn + 2, d);
        for (i = k; i <= last; i++) {
            double complex upper = H(k, i), lower = H(k + 1, i);
            put(AT(k, i), conj(c) * upper + conj(d) * lower);
            put(AT(k + 1, i), c * lower - d * upper);
        }
    }
    for (k = first, turn = turns; k < last; k++, turn += 4) {
        double complex c = get(turn), d = get(turn + 2);
        for (i = first; i <= (k + 2 < last ? k + 2 : last); i++) {
            double complex left = H(i, k), right = H(i, k + 1);
            put(AT(i, k), left * c + right * d);
            put(AT(i, k + 1), right * conj(c) - left * conj(d));
        }
    }
    for (k = first; k <= last; k++) put(AT(k, k), H(k, k) + s);
}

static int eigenvalues(double *h, double *turns)
{
    int last = N - 1, first, tries = 0;

    hessenberg(h);
    while (last > 0) {
        for (first = last; first > 0; first--) {
            double size = cabs(H(first, first)) + cabs(H(first - 1, first - 1));
            if (cabs(H(first, first - 1)) <= 1e-16 * size) break;
        }
        if (first == last) {
            last--;
            tries = 0;
            continue;
        }
        if (++tries > SWEEPS) return 1;
        sweep(h, first, last, tries % 20 ? shift(h, last) : H(last, last) + cabs(H(last, last - 1)), turns);
    }
    return 0;
}

/* Modulus of the multiplier lambda^2 outside the unit circle, lambda + 1/lambda = 2 + 4 mu. */
static double modulus(double complex mu, double tolerance)
{
    double complex c = 1.0 + 2.0 * mu, root = 2.0 * csqrt(mu * (mu + 1.0));
    double larger = fmax(cabs(c + root), cabs(c - root));

    if (fabs(cimag(mu)) <= tolerance && creal(mu) >= -1.0 - tolerance && creal(mu) <= tolerance) return 1.0;
    return larger * larger;
}

int @p_multipliers(const double *Phi, double tolerance, double *mu_real, double *mu_imaginary, double *largest,
                   double *trivial, double *work)
{
    double *h = work, *turns = h + 2 * (size_t)N * N;
    int i, j, k, nearest = 0;

    for (j = 0; j < N; j++)
        for (i = 0; i < N; i++) {
            double sum = 0.0;
            for (k = 0; k < N; k++) sum += Phi[(size_t)(N + i) * 2 * N + k] * Phi[(size_t)j * 2 * N + N + k];
            put(AT(i, j), sum);
        }
    if (eigenvalues(h, turns)) return 1;
    for (i = 0; i < N; i++) {
        mu_real[i] = creal(H(i, i));
        mu_imaginary[i] = cimag(H(i, i));
        if (cabs(H(i, i) + 1.0) < cabs(H(nearest, nearest) + 1.0)) nearest = i;
    }
    *trivial = cabs(H(nearest, nearest) + 1.0);
    *largest = 1.0;
    for (i = 0; i < N; i++)
        if (i != nearest) *largest = fmax(*largest, modulus(H(i, i), tolerance));
    return 0;
}
