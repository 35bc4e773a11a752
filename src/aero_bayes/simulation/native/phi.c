/* What a linear system x' = A x + b s^k / k! does over a fraction of a step: e^(theta h A) and the integrals
 *   I_k(theta) = integral over s from 0 to theta of e^((theta - s) h A) s^k / k!, k = 0, 1, 2,
 * the phi-functions of exponential integrators times powers of theta (M. Hochbruck, A. Ostermann, Acta Numerica 19
 * (2010) 209, section 2). They are summed up as series for a small part of the step and put together by the
 * semigroup's rule. Matrices are kept by columns, each padded to a multiple of four rows. */
#include "engine.h"

#define SMALL 0.25 /* norm up to which nine terms of the series are exact to 5e-14 */

/* c = a b */
static void product(double *restrict c, const double *a, const double *b, int n, int rows)
{
    memset(c, 0, sizeof *c * (size_t)(n * rows));
    for (int j = 0; j < n; j++) kernels->apply(c + j * rows, a, b + j * rows, n, rows);
}

static void add(double *restrict to, double w, const double *from, int size)
{
    for (int i = 0; i < size; i++) to[i] += w * from[i];
}

static void add_diagonal(double *a, double w, int n, int rows)
{
    for (int i = 0; i < n; i++) a[i * rows + i] += w;
}

/* The four matrices one after the other. */
static double *part_of(double *flow, int k, int size) { return flow + k * size; }

/* Those over a + b from those over a and, then, over b. `to` is neither. */
static void follow(double *restrict to, double a, const double *first, const double *then, int n, int rows)
{
    const int size = n * rows;
    double factor = 1.0;
    for (int k = 0; k < 4; k++) product(to + k * size, then, first + k * size, n, rows);
    for (int shift = 0; shift < 3; shift++) { /* a^shift / shift! I_l(b) goes to I_(l + shift) */
        for (int l = 0; l + shift < 3; l++) add(to + (1 + l + shift) * size, factor, then + (1 + l) * size, size);
        factor *= a / (shift + 1);
    }
}

/* The series of a small part: I_2 = theta^3 sum of (theta h A)^k / (k + 3)!, and the others from it. */
static void series(double *restrict flow, const double *a, double h, double theta, double *restrict work, int n, int rows)
{
    static const double c[9] = {1.0 / 6, 1.0 / 24, 1.0 / 120, 1.0 / 720, 1.0 / 5040, 1.0 / 40320, 1.0 / 362880,
                                1.0 / 3628800, 1.0 / 39916800};
    const int size = n * rows;
    double *z = work, *z2 = z + size, *z3 = z2 + size, *sum = z3 + size;
    double *i2 = part_of(flow, 3, size);
    for (int i = 0; i < size; i++) z[i] = theta * h * a[i];
    product(z2, z, z, n, rows);
    product(z3, z2, z, n, rows);
    for (int i = 0; i < size; i++) sum[i] = c[7] * z[i] + c[8] * z2[i];
    add_diagonal(sum, c[6], n, rows);
    for (int low = 3; low >= 0; low -= 3) {
        product(i2, z3, sum, n, rows);
        for (int i = 0; i < size; i++) sum[i] = i2[i] + c[low + 1] * z[i] + c[low + 2] * z2[i];
        add_diagonal(sum, c[low], n, rows);
    }
    memcpy(i2, sum, sizeof *sum * (size_t)size);
    static const double inverse_factorial[3] = {1.0, 1.0, 0.5};
    for (int k = 2; k >= 0; k--) { /* phi_k = z phi_(k + 1) + 1 / k! */
        double *phi = part_of(flow, k, size);
        product(phi, z, part_of(flow, k + 1, size), n, rows);
        add_diagonal(phi, inverse_factorial[k], n, rows);
    }
    double power = theta;
    for (int k = 1; k < 4; k++, power *= theta) {
        double *i = part_of(flow, k, size);
        for (int j = 0; j < size; j++) i[j] *= power;
    }
}

static double norm_of(const double *a, int n, int rows)
{
    double columns = 0.0, lines = 0.0;
    for (int j = 0; j < n; j++) {
        double column = 0.0, line = 0.0;
        for (int i = 0; i < n; i++) column += fabs(a[j * rows + i]), line += fabs(a[i * rows + j]);
        columns = larger(columns, column), lines = larger(lines, line);
    }
    return fmin(columns, lines);
}

/* e^(theta h A), I_0, I_1, I_2 into `flow`; `work` holds eight matrices. */
void phi_flow(double *flow, const double *a, double h, double theta, double *work, int n, int rows)
{
    const int size = n * rows;
    int doublings = 0;
    const double norm = fabs(theta * h) * norm_of(a, n, rows);
    if (norm > SMALL) (void)frexp(norm / SMALL, &doublings);
    double part = ldexp(theta, -doublings);
    double *other = work + 4 * size;
    series(doublings % 2 ? other : flow, a, h, part, work, n, rows);
    for (; doublings > 0; doublings--, part *= 2.0) {
        double *from = doublings % 2 ? other : flow, *to = doublings % 2 ? flow : other;
        follow(to, part, from, from, n, rows);
    }
}

/* Those over a + b. */
void phi_follow(double *to, double a, const double *first, const double *then, int n, int rows)
{
    follow(to, a, first, then, n, rows);
}
