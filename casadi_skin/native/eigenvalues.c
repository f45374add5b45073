/* Eigenvalues and vectors of small real matrices A, (n, n), row by row: A V = V diag(w).

   A is balanced by a permutation and by powers of 2 (Parlett and Reinsch 1969; James, Langou and Lowery 2014), made
   Hessenberg by reflections, and quasi-triangular, A = Z T Z', by double shifts (Francis 1961) with deflation by Ahues
   and Tisseur (1997): the steps that LAPACK's dgebal, dgehrd, dlahqr, dlanv2 and dtrevc take. */

#include <float.h>
#include <math.h>
#include <string.h>

#include "kernel.h"

enum { MOST_SWEEPS = 300, ROTATIONS = 40 };
static const double ULP = DBL_EPSILON, TINY = DBL_MIN / DBL_EPSILON;

static inline double larger(double a, double b) { return a > b ? a : b; }
static inline double smaller(double a, double b) { return a < b ? a : b; }

/* Units, powers of 2, in which rows and columns from `low` to before `high` are of one size; A is in these after. */
static void scale_to_balance(int64_t n, int64_t low, int64_t high, double *A, double *units)
{
    const double least = DBL_MIN / DBL_EPSILON, most = 1.0 / least;
    for (int again = 1, sweeps = 0; again && sweeps < MOST_SWEEPS; sweeps++) {
        again = 0;
        for (int64_t i = low; i < high; i++) {
            double c = 0.0, r = 0.0, factor = 1.0;
            for (int64_t j = low; j < high; j++)
                c = hypot(c, A[j * n + i]), r = hypot(r, A[i * n + j]);
            const double sum = c + r;
            if (!(c > 0.0 && r > 0.0 && isfinite(sum)))
                continue;
            for (; c < r / 2.0 && factor < most; r /= 2.0)
                factor *= 2.0, c *= 2.0;
            for (; c / 2.0 >= r && factor > least; c /= 2.0)
                factor /= 2.0, r *= 2.0;
            const double unit = units[i] * factor;
            if (c + r >= 0.95 * sum || !(unit < most && unit > least))
                continue;
            again = 1, units[i] = unit;
            for (int64_t j = 0; j < n; j++)
                A[i * n + j] /= factor;
            for (int64_t j = 0; j < n; j++)
                A[j * n + i] *= factor;
        }
    }
}

/* The same of a whole matrix, which is lost. */
void NAMED(balancing)(int64_t n, double *A, double *units)
{
    for (int64_t i = 0; i < n; i++)
        units[i] = 1.0;
    scale_to_balance(n, 0, n, A, units);
}

static void exchange(int64_t n, double *A, int64_t *order, int64_t i, int64_t j)
{
    const int64_t place = order[i];
    order[i] = order[j], order[j] = place;
    for (int64_t k = 0; k < n; k++) {
        const double x = A[i * n + k];
        A[i * n + k] = A[j * n + k], A[j * n + k] = x;
    }
    for (int64_t k = 0; k < n; k++) {
        const double x = A[k * n + i];
        A[k * n + i] = A[k * n + j], A[k * n + j] = x;
    }
}

/* Rows without entries beside the diagonal go last, such columns first; what is left is between `low` and `high`. */
static void permute(int64_t n, double *A, int64_t *order, int64_t *low, int64_t *high)
{
    *low = 0, *high = n;
    for (int of_rows = 1; of_rows >= 0; of_rows--)
        for (int64_t i = *low; i < *high;) {
            int alone = 1;
            for (int64_t j = *low; j < *high && alone; j++)
                alone = i == j || (of_rows ? A[i * n + j] : A[j * n + i]) == 0.0;
            if (!alone) {
                i++;
                continue;
            }
            exchange(n, A, order, i, of_rows ? *high - 1 : *low);
            if (of_rows)
                --*high;
            else
                ++*low;
            i = *low;
        }
}

/* A vector x_0 .. x_(count - 1), `apart` numbers from one to the next: I - t v v', v_0 = 1, takes it to (beta, 0 ..).
   Gives t; x becomes beta and the rest of v. */
static double reflection(int64_t count, double *x, int64_t apart)
{
    double most = 0.0, square = 0.0;
    for (int64_t i = 1; i < count; i++)
        most = larger(most, fabs(x[i * apart]));
    if (!(most > 0.0))
        return 0.0;
    const double scale = larger(most, fabs(x[0]));
    for (int64_t i = 0; i < count; i++)
        square += (x[i * apart] / scale) * (x[i * apart] / scale);
    const double beta = -copysign(scale * sqrt(square), x[0]), head = x[0] - beta;
    for (int64_t i = 1; i < count; i++)
        x[i * apart] /= head;
    const double t = -head / beta;
    x[0] = beta;
    return t;
}

/* Rows, or columns, of x from `first` on by I - t v v' on `count` neighbours. */
static void reflect(int64_t count, const double *v, double t, double *x, int64_t apart, int64_t others, int64_t step)
{
    for (int64_t j = 0; j < others; j++, x += step) {
        double sum = 0.0;
        for (int64_t i = 0; i < count; i++)
            sum += v[i] * x[i * apart];
        for (int64_t i = 0; i < count; i++)
            x[i * apart] -= t * sum * v[i];
    }
}

static void make_hessenberg(int64_t n, int64_t low, int64_t high, double *A, double *Z, double *v)
{
    for (int64_t k = low; k < high - 2; k++) {
        const int64_t count = high - k - 1;
        const double t = reflection(count, A + (k + 1) * n + k, n);
        v[0] = 1.0;
        for (int64_t i = 1; i < count; i++)
            v[i] = A[(k + 1 + i) * n + k], A[(k + 1 + i) * n + k] = 0.0;
        reflect(count, v, t, A + (k + 1) * n + k + 1, n, n - k - 1, 1);
        reflect(count, v, t, A + k + 1, 1, n, n);
        reflect(count, v, t, Z + k + 1, 1, n, n);
    }
}

/* A block ((a, b), (c, d)) is made ((a, b), (0, d)), or one with a = d and b c < 0, by a rotation (cs, sn). */
static void standardise(double *A, double *B, double *C, double *D, double *cs, double *sn)
{
    double a = *A, b = *B, c = *C, d = *D;
    *cs = 1.0, *sn = 0.0;
    if (c != 0.0 && b == 0.0) {
        *cs = 0.0, *sn = 1.0;
        const double other = d;
        d = a, a = other, b = -c, c = 0.0;
    } else if (c != 0.0 && !(a - d == 0.0 && (b > 0.0) != (c > 0.0))) {
        double p = 0.5 * (a - d);
        const double most = larger(fabs(b), fabs(c));
        const double least = smaller(fabs(b), fabs(c)) * copysign(1.0, b) * copysign(1.0, c);
        const double scale = larger(fabs(p), most);
        double z = p / scale * p + most / scale * least;
        if (z >= 4.0 * ULP) { /* real */
            z = p + copysign(sqrt(scale) * sqrt(z), p);
            a = d + z, d -= most / z * least;
            const double tau = hypot(c, z);
            *cs = z / tau, *sn = c / tau;
            b -= c, c = 0.0;
        } else { /* complex, or nearly equal: equal on the diagonal */
            const double sigma = b + c, tau = hypot(sigma, a - d);
            p = 0.5 * (a - d);
            *cs = sqrt(0.5 * (1.0 + fabs(sigma) / tau));
            *sn = -(p / (tau * *cs)) * copysign(1.0, sigma);
            const double aa = a * *cs + b * *sn, bb = -a * *sn + b * *cs;
            const double cc = c * *cs + d * *sn, dd = -c * *sn + d * *cs;
            a = aa * *cs + cc * *sn, b = bb * *cs + dd * *sn, c = -aa * *sn + cc * *cs, d = -bb * *sn + dd * *cs;
            a = d = 0.5 * (a + d);
            if (c != 0.0 && b == 0.0) {
                b = -c, c = 0.0;
                const double other = *cs;
                *cs = -*sn, *sn = other;
            } else if (c != 0.0 && (b > 0.0) == (c > 0.0)) { /* real after all */
                const double sab = sqrt(fabs(b)), sac = sqrt(fabs(c)), turn = 1.0 / sqrt(fabs(b + c)), old = *cs;
                p = copysign(sab * sac, c);
                a += p, d -= p, b -= c, c = 0.0;
                const double cs1 = sab * turn, sn1 = sac * turn;
                *cs = old * cs1 - *sn * sn1, *sn = old * sn1 + *sn * cs1;
            }
        }
    }
    *A = a, *B = b, *C = c, *D = d;
}

static int is_negligible(int64_t n, int64_t low, int64_t high, const double *H, int64_t k)
{
    const double below = fabs(H[k * n + k - 1]), beside = fabs(H[(k - 1) * n + k]);
    const double here = H[k * n + k], before = H[(k - 1) * n + k - 1];
    double sum = fabs(before) + fabs(here);
    if (below <= TINY)
        return 1;
    if (sum == 0.0 && k - 2 >= low)
        sum += fabs(H[(k - 1) * n + k - 2]);
    if (sum == 0.0 && k + 1 < high)
        sum += fabs(H[(k + 1) * n + k]);
    if (below > ULP * sum)
        return 0;
    const double ab = larger(below, beside), ba = smaller(below, beside);
    const double aa = larger(fabs(here), fabs(before - here)), bb = smaller(fabs(here), fabs(before - here));
    return ba * (ab / (aa + ab)) <= larger(TINY, ULP * (bb * (aa / (aa + ab))));
}

/* One double shift on rows l .. i of H; `round` counts those since the last deflation. */
static void sweep(int64_t n, int64_t l, int64_t i, int64_t round, double *H, double *Z)
{
    double h11 = H[(i - 1) * n + i - 1], h21 = H[i * n + i - 1], h12 = H[(i - 1) * n + i], h22 = H[i * n + i], v[3];
    if (round % 20 == 0) {
        const double s = fabs(h21) + fabs(H[(i - 1) * n + i - 2]);
        h11 = h22 = 0.75 * s + h22, h12 = -0.4375 * s, h21 = s;
    } else if (round % 10 == 0) {
        const double s = fabs(H[(l + 1) * n + l]) + fabs(H[(l + 2) * n + l + 1]);
        h11 = h22 = 0.75 * s + H[l * n + l], h12 = -0.4375 * s, h21 = s;
    }
    double r1 = 0.0, r2 = 0.0, turn = 0.0;
    const double s = fabs(h11) + fabs(h12) + fabs(h21) + fabs(h22);
    if (s > 0.0) {
        h11 /= s, h21 /= s, h12 /= s, h22 /= s;
        const double half = 0.5 * (h11 + h22), det = (h11 - half) * (h22 - half) - h12 * h21, root = sqrt(fabs(det));
        if (det >= 0.0)
            r1 = r2 = half * s, turn = root * s;
        else
            r1 = r2 = s * (fabs(half + root - h22) <= fabs(half - root - h22) ? half + root : half - root);
    }
    int64_t m = i - 2;
    for (;; m--) {
        const double *row = H + m * n + m, *next = row + n, *last = next + n;
        double size = fabs(row[0] - r2) + fabs(turn) + fabs(next[0]);
        const double part = next[0] / size;
        v[0] = part * row[1] + (row[0] - r1) * ((row[0] - r2) / size) + turn * (turn / size);
        v[1] = part * (row[0] + next[1] - r1 - r2);
        v[2] = part * last[1];
        size = fabs(v[0]) + fabs(v[1]) + fabs(v[2]);
        v[0] /= size, v[1] /= size, v[2] /= size;
        if (m == l)
            break;
        const double beside = fabs(H[(m - 1) * n + m - 1]) + fabs(row[0]) + fabs(next[1]);
        if (fabs(row[-1]) * (fabs(v[1]) + fabs(v[2])) <= ULP * fabs(v[0]) * beside)
            break;
    }
    for (int64_t k = m; k < i; k++) {
        const int64_t count = i - k + 1 < 3 ? i - k + 1 : 3;
        for (int64_t j = 0; k > m && j < count; j++)
            v[j] = H[(k + j) * n + k - 1];
        const double t = reflection(count, v, 1), beta = v[0];
        if (k > m) {
            H[k * n + k - 1] = beta;
            for (int64_t j = 1; j < count; j++)
                H[(k + j) * n + k - 1] = 0.0;
        } else if (m > l)
            H[k * n + k - 1] *= 1.0 - t;
        v[0] = 1.0;
        reflect(count, v, t, H + k * n + k, n, n - k, 1);
        reflect(count, v, t, H + k, 1, (k + 3 < i ? k + 3 : i) + 1, n);
        reflect(count, v, t, Z + k, 1, n, n);
    }
}

static void rotate(int64_t count, double *x, double *y, int64_t step, double cs, double sn)
{
    for (int64_t j = 0; j < count; j++, x += step, y += step) {
        const double a = *x, b = *y;
        *x = cs * a + sn * b, *y = cs * b - sn * a;
    }
}

/* H becomes quasi-triangular; eigenvalues (re, im), conjugate ones one after the other. Returns 1 where it fails. */
static int make_triangular(int64_t n, int64_t low, int64_t high, double *H, double *Z, double *re, double *im)
{
    for (int64_t i = 0; i < n; i++)
        re[i] = H[i * (n + 1)], im[i] = 0.0;
    for (int64_t i = high - 1, round = 0; i >= low;) {
        int64_t l = i;
        while (l > low && !is_negligible(n, low, high, H, l))
            l--;
        if (l > low)
            H[l * n + l - 1] = 0.0;
        if (l < i - 1) {
            if (++round > MOST_SWEEPS || !isfinite(H[i * n + i]))
                return 1;
            sweep(n, l, i, round, H, Z);
            continue;
        }
        re[i] = H[i * n + i];
        if (l == i - 1) {
            double *a = H + l * n + l, *c = a + n, cs, sn;
            standardise(a, a + 1, c, c + 1, &cs, &sn);
            rotate(n - i - 1, a + 2, c + 2, 1, cs, sn);
            rotate(l, H + l, H + i, n, cs, sn);
            rotate(n, Z + l, Z + i, n, cs, sn);
            re[l] = a[0], re[i] = c[1];
            im[l] = a[1] != 0.0 && c[0] != 0.0 ? sqrt(fabs(a[1])) * sqrt(fabs(c[0])) : 0.0, im[i] = -im[l];
        }
        i = l - 1, round = 0;
    }
    return 0;
}

typedef struct {
    double re, im;
} number;

static inline number minus_product(number x, number a, number b)
{
    return (number){x.re - (a.re * b.re - a.im * b.im), x.im - (a.re * b.im + a.im * b.re)};
}

static inline number quotient(number x, number y)
{
    const double size = larger(fabs(y.re), fabs(y.im)), re = y.re / size, im = y.im / size;
    const double square = (re * re + im * im) * size;
    return (number){(x.re * re + x.im * im) / square, (x.im * re - x.re * im) / square};
}

/* The vector of T for its eigenvalue number k, (n). Of a pair that is the first of the two. */
static void vector_of(int64_t n, const double *T, const double *re, const double *im, int64_t k, number *x)
{
    const double least = larger(ULP * (fabs(re[k]) + fabs(im[k])), TINY);
    memset(x, 0, (size_t)n * sizeof(number));
    int64_t j = k - 1;
    x[k].re = 1.0;
    if (im[k] != 0.0) { /* (a - w) x_k + b x_(k + 1) = 0 with w = a + i v */
        const double b = T[k * n + k + 1], c = T[(k + 1) * n + k];
        if (fabs(b) >= fabs(c))
            x[k + 1].im = im[k] / b;
        else
            x[k] = (number){0.0, im[k] / c}, x[k + 1].re = 1.0;
    }
    const int64_t last = im[k] != 0.0 ? k + 1 : k;
    for (; j >= 0; j--) {
        const int64_t first = j > 0 && T[j * n + j - 1] != 0.0 ? j - 1 : j;
        number sums[2] = {{0.0, 0.0}, {0.0, 0.0}};
        for (int64_t i = first; i <= j; i++)
            for (int64_t m = j + 1; m <= last; m++)
                sums[i - first].re -= T[i * n + m] * x[m].re, sums[i - first].im -= T[i * n + m] * x[m].im;
        number d = {T[j * n + j] - re[k], -im[k]};
        if (first == j) {
            if (fabs(d.re) + fabs(d.im) < least)
                d = (number){least, 0.0};
            x[j] = quotient(sums[0], d);
            continue;
        }
        const double b = T[first * n + j], c = T[j * n + first];
        const number a = {T[first * n + first] - re[k], -im[k]};
        number det = minus_product((number){b * c, 0.0}, a, d); /* b c - a d */
        if (fabs(det.re) + fabs(det.im) < least * least)
            det = (number){least * least, 0.0};
        number one = {b * sums[1].re, b * sums[1].im}, other = {c * sums[0].re, c * sums[0].im};
        x[first] = quotient(minus_product(one, d, sums[0]), det);
        x[j] = quotient(minus_product(other, a, sums[1]), det);
        j = first;
    }
}

/* Eigenvalues (re, im), and where wanted right vectors of norm 1 as columns of `vectors`, (2, n, n), real parts first.
   A is lost. `memory` has n^2 + 6 n numbers. Returns 1 where they do not converge. */
int NAMED(eigenvalues)(int64_t n, double *A, double *re, double *im, double *vectors, double *memory)
{
    double *Z = memory, *units = Z + n * n, *v = units + n;
    int64_t low, high, *order = (int64_t *)(v + n);
    number *x = (number *)(order + n);
    memset(Z, 0, (size_t)(n * n) * sizeof(double));
    for (int64_t i = 0; i < n; i++)
        units[i] = 1.0, order[i] = i, Z[i * (n + 1)] = 1.0;
    permute(n, A, order, &low, &high);
    scale_to_balance(n, low, high, A, units);
    make_hessenberg(n, low, high, A, Z, v);
    if (make_triangular(n, low, high, A, Z, re, im))
        return 1;
    for (int64_t k = 0; vectors && k < n; k++) {
        double square = 0.0;
        vector_of(n, A, re, im, k, x);
        for (int64_t i = 0; i < n; i++) {
            number sum = {0.0, 0.0};
            for (int64_t j = 0; j < n; j++)
                sum.re += Z[i * n + j] * x[j].re, sum.im += Z[i * n + j] * x[j].im;
            sum.re *= units[i], sum.im *= units[i];
            vectors[order[i] * n + k] = sum.re, vectors[(n + order[i]) * n + k] = sum.im;
            square += sum.re * sum.re + sum.im * sum.im;
        }
        const double size = sqrt(square);
        for (int64_t i = 0; i < n; i++)
            vectors[i * n + k] /= size, vectors[(n + i) * n + k] /= size;
        if (im[k] != 0.0) {
            for (int64_t i = 0; i < n; i++)
                vectors[i * n + k + 1] = vectors[i * n + k], vectors[(n + i) * n + k + 1] = -vectors[(n + i) * n + k];
            k++;
        }
    }
    return 0;
}

/* The smallest and the largest singular value of a matrix A, (rows, n), by rotations of its rows, which are lost. */
void NAMED(singular_values)(int64_t rows, int64_t n, double *A, double *least, double *most)
{
    for (int turned = 1, sweeps = 0; turned && sweeps < ROTATIONS; sweeps++) {
        turned = 0;
        for (int64_t i = 0; i < rows; i++)
            for (int64_t j = i + 1; j < rows; j++) {
                double aa = 0.0, ab = 0.0, bb = 0.0;
                for (int64_t k = 0; k < n; k++) {
                    const double a = A[i * n + k], b = A[j * n + k];
                    aa += a * a, ab += a * b, bb += b * b;
                }
                if (!(fabs(ab) > ULP * sqrt(aa) * sqrt(bb)))
                    continue;
                const double zeta = (bb - aa) / (2.0 * ab), t = copysign(1.0, zeta) / (fabs(zeta) + hypot(1.0, zeta));
                const double cs = 1.0 / sqrt(1.0 + t * t);
                turned = 1;
                rotate(n, A + i * n, A + j * n, 1, cs, -cs * t);
            }
    }
    *least = INFINITY, *most = 0.0;
    for (int64_t i = 0; i < rows; i++) {
        double square = 0.0;
        for (int64_t k = 0; k < n; k++)
            square += A[i * n + k] * A[i * n + k];
        *least = smaller(*least, sqrt(square)), *most = larger(*most, sqrt(square));
    }
}
