/* What a linear system x' = A x + b s^k / k! does over a fraction of a step: e^(theta h A) and the integrals
 *   I_k(theta) = integral over s from 0 to theta of e^((theta - s) h A) s^k / k!, k = 0, 1, 2,
 * the phi-functions of exponential integrators times powers of theta (M. Hochbruck, A. Ostermann, Acta Numerica 19
 * (2010) 209, section 2). They are summed up as series for a small part of the step and put together by the
 * semigroup's rule. Matrices are kept by columns, each padded to a multiple of four rows. Beside each may stand its
 * derivatives along several dA/dp: each column then holds all of them, a row of `ld` for each of its n entries. */
#include "engine.h"

#define SMALL 0.25 /* norm up to which nine terms of the series are exact to 5e-14 */

static int size_of(const Linear *m) { return m->n * m->rows; }
static int wide_of(const Linear *m) { return m->n * m->ld; } /* a column of derivatives */

Matrix matrix_at(const Linear *m, Matrix first, int k)
{
    return (Matrix){first.value + k * size_of(m), m->ld ? first.slopes + k * m->n * wide_of(m) : NULL};
}

/* c = a b */
static void product(const Linear *m, Matrix c, Matrix a, Matrix b)
{
    const int n = m->n, rows = m->rows, wide = wide_of(m);
    memset(c.value, 0, sizeof *c.value * (size_t)size_of(m));
    for (int j = 0; j < n; j++) kernel_apply(c.value + j * rows, a.value, b.value + j * rows, n, rows);
    if (!m->ld) return;
    memset(c.slopes, 0, sizeof *c.slopes * (size_t)(n * wide));
    for (int j = 0; j < n; j++) {
        kernel_apply_rows(c.slopes + j * wide, a.value, b.slopes + j * wide, n, rows, m->ld, m->ld);
        kernel_apply(c.slopes + j * wide, a.slopes, b.value + j * rows, n, wide);
    }
}

/* to = w from */
static void set(const Linear *m, Matrix to, double w, Matrix from)
{
    for (int i = 0; i < size_of(m); i++) to.value[i] = w * from.value[i];
    for (int i = 0; i < m->n * wide_of(m); i++) to.slopes[i] = w * from.slopes[i];
}

/* to += w from */
static void add(const Linear *m, Matrix to, double w, Matrix from)
{
    for (int i = 0; i < size_of(m); i++) to.value[i] += w * from.value[i];
    for (int i = 0; i < m->n * wide_of(m); i++) to.slopes[i] += w * from.slopes[i];
}

static void add_diagonal(const Linear *m, Matrix a, double w)
{
    for (int i = 0; i < m->n; i++) a.value[i * m->rows + i] += w;
}

/* The four matrices over a + b from those over a and, then, over b. `to` is neither. */
void phi_follow(const Linear *m, Matrix to, double a, Matrix first, Matrix then)
{
    double factor = 1.0;
    for (int k = 0; k < 4; k++) product(m, matrix_at(m, to, k), then, matrix_at(m, first, k));
    for (int shift = 0; shift < 3; shift++) { /* a^shift / shift! I_l(b) goes to I_(l + shift) */
        for (int l = 0; l + shift < 3; l++)
            add(m, matrix_at(m, to, 1 + l + shift), factor, matrix_at(m, then, 1 + l));
        factor *= a / (shift + 1);
    }
}

/* The series of a small part: I_2 = theta^3 sum of (theta h A)^k / (k + 3)!, and the others from it. */
static void series(const Linear *m, Matrix flow, double h, double theta)
{
    static const double c[9] = {1.0 / 6, 1.0 / 24, 1.0 / 120, 1.0 / 720, 1.0 / 5040, 1.0 / 40320, 1.0 / 362880,
                                1.0 / 3628800, 1.0 / 39916800};
    const Matrix z = m->work, z2 = matrix_at(m, z, 1), z3 = matrix_at(m, z, 2), sum = matrix_at(m, z, 3);
    const Matrix i2 = matrix_at(m, flow, 3);
    set(m, z, theta * h, m->a);
    product(m, z2, z, z);
    product(m, z3, z2, z);
    set(m, sum, c[7], z);
    add(m, sum, c[8], z2);
    add_diagonal(m, sum, c[6]);
    for (int low = 3; low >= 0; low -= 3) {
        product(m, i2, z3, sum);
        set(m, sum, 1.0, i2);
        add(m, sum, c[low + 1], z);
        add(m, sum, c[low + 2], z2);
        add_diagonal(m, sum, c[low]);
    }
    set(m, i2, 1.0, sum);
    static const double inverse_factorial[3] = {1.0, 1.0, 0.5};
    for (int k = 2; k >= 0; k--) { /* phi_k = z phi_(k + 1) + 1 / k! */
        product(m, matrix_at(m, flow, k), z, matrix_at(m, flow, k + 1));
        add_diagonal(m, matrix_at(m, flow, k), inverse_factorial[k]);
    }
    double power = theta;
    for (int k = 1; k < 4; k++, power *= theta) set(m, matrix_at(m, flow, k), power, matrix_at(m, flow, k));
}

/* The lesser of the sums of magnitudes by columns and by rows. */
double phi_norm(const Linear *m)
{
    const int n = m->n, rows = m->rows;
    const double *a = m->a.value;
    double columns = 0.0, lines = 0.0;
    for (int j = 0; j < n; j++) {
        double column = 0.0, line = 0.0;
        for (int i = 0; i < n; i++) column += fabs(a[j * rows + i]), line += fabs(a[i * rows + j]);
        columns = larger(columns, column), lines = larger(lines, line);
    }
    return fmin(columns, lines);
}

/* e^(theta h A), I_0, I_1, I_2 into `flow`. */
void phi_flow(const Linear *m, Matrix flow, double h, double theta)
{
    int doublings = 0;
    const double norm = fabs(theta * h) * phi_norm(m);
    if (norm > SMALL) (void)frexp(norm / SMALL, &doublings);
    double part = ldexp(theta, -doublings);
    const Matrix other = matrix_at(m, m->work, 4);
    series(m, doublings % 2 ? other : flow, h, part);
    for (; doublings > 0; doublings--, part *= 2.0) {
        const Matrix from = doublings % 2 ? other : flow, to = doublings % 2 ? flow : other;
        phi_follow(m, to, part, from, from);
    }
}
