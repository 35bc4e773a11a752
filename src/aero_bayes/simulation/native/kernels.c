/* The vector loops. */
#include "engine.h"

/* Compiled for every processor, and once more for AVX2, with which a run with sensitivities takes 0.55 of the time; the
 * loader takes what this processor has. */
#if defined(__x86_64__) && defined(__GLIBC__)
#define WIDE __attribute__((target_clones("default", "avx2")))
#else
#define WIDE
#endif

typedef double Four __attribute__((vector_size(32), aligned(8), may_alias));

/* out[k] = c[0] + fraction[k] c[stride] + ... of degree four (Horner) */
WIDE void kernel_horner(const double *c, int stride, const double *fraction, int64_t count, double *out)
{
    const double c0 = c[0], c1 = c[stride], c2 = c[2 * stride], c3 = c[3 * stride], c4 = c[4 * stride];
    for (int64_t k = 0; k < count; k++) {
        const double x = fraction[k];
        out[k] = c0 + x * (c1 + x * (c2 + x * (c3 + x * c4)));
    }
}

#define COMBINE(T)                                                                                      \
    case T:                                                                                             \
        for (int64_t k = 0; k < count; k++) {                                                           \
            double y = base[k];                                                                         \
            for (int j = 0; j < T; j++) y += w[j] * v[j * stride + k];                                  \
            out[k] = y;                                                                                 \
        }                                                                                               \
        break;

/* out = base + sum_j w[j] v_j, for at most eight terms; out may be base */
WIDE void kernel_combine(double *restrict out, const double *base, const double *restrict w, int terms,
                    const double *restrict v, int64_t stride, int64_t count)
{
    switch (terms) {
        COMBINE(0)
        COMBINE(1)
        COMBINE(2)
        COMBINE(3)
        COMBINE(4)
        COMBINE(5)
        COMBINE(6)
        COMBINE(7)
        COMBINE(8)
    }
}

/* v += sign * sum of val * (rows of s) for one row of a sparse matrix, eight or four columns at a time */
#define SPARSE_ROW(Columns, target, source, first, last, OP)                                            \
    {                                                                                                   \
        Four v0 = *(const Four *)(target), v1 = v0;                                                     \
        if (Columns == 8) v1 = *(const Four *)((target) + 4);                                           \
        for (int k = (first); k < (last); k++) {                                                        \
            const double *from = (source) + (int64_t)col[k] * ld + c;                                   \
            v0 OP val[k] * *(const Four *)from;                                                         \
            if (Columns == 8) v1 OP val[k] * *(const Four *)(from + 4);                                 \
        }                                                                                               \
        *(Four *)(target) = v0;                                                                         \
        if (Columns == 8) *(Four *)((target) + 4) = v1;                                                 \
    }

/* out += a s for a sparse a by rows; q is a multiple of 4 */
WIDE void kernel_multiply(double *restrict out, const Sparse *a, const double *restrict s, int64_t q, int64_t ld)
{
    const int *start = a->start, *col = a->col;
    const double *val = a->val;
    for (int64_t c = 0; c < q;) {
        const int wide = q - c >= 8;
        for (int i = 0; i < a->n; i++) {
            double *target = out + (int64_t)i * ld + c;
            if (wide)
                SPARSE_ROW(8, target, s, start[i], start[i + 1], +=)
            else
                SPARSE_ROW(4, target, s, start[i], start[i + 1], +=)
        }
        c += wide ? 8 : 4;
    }
}

/* b = (LU)^-1 P b for many right-hand sides; rows of L, then rows of U, then the reciprocals of its diagonal */
WIDE void kernel_solve(const Sparse *lu, const int *restrict pivot, double *restrict b, int64_t q, int64_t ld)
{
    const int n = lu->n, *start = lu->start, *col = lu->col;
    const double *val = lu->val;
    for (int i = 0; lu->pivoted && i < n; i++)
        if (pivot[i] != i)
            for (int64_t k = 0; k < q; k++) {
                const double y = b[i * ld + k];
                b[i * ld + k] = b[pivot[i] * ld + k];
                b[pivot[i] * ld + k] = y;
            }
    for (int64_t c = 0; c < q;) {
        const int wide = q - c >= 8;
        for (int i = 0; i < n; i++) {
            double *target = b + (int64_t)i * ld + c;
            if (start[i] == start[i + 1]) continue;
            if (wide)
                SPARSE_ROW(8, target, b, start[i], start[i + 1], -=)
            else
                SPARSE_ROW(4, target, b, start[i], start[i + 1], -=)
        }
        for (int i = n - 1; i >= 0; i--) {
            double *target = b + (int64_t)i * ld + c;
            if (wide)
                SPARSE_ROW(8, target, b, start[n + i], start[n + i + 1], -=)
            else
                SPARSE_ROW(4, target, b, start[n + i], start[n + i + 1], -=)
            const double w = lu->diagonal[i];
            for (int k = 0; k < (wide ? 8 : 4); k++) target[k] *= w;
        }
        c += wide ? 8 : 4;
    }
}

/* out[t] = c_0 + fraction[t] c_1 + ... of degree four for rows of q */
WIDE void kernel_dense_rows(double *restrict out, const double *restrict c, int64_t stride,
                       const double *restrict fraction, int64_t count, int64_t q, int64_t ld)
{
    const double *c1 = c + stride, *c2 = c + 2 * stride, *c3 = c + 3 * stride, *c4 = c + 4 * stride;
    for (int64_t t = 0; t < count; t++) {
        const double x = fraction[t];
        for (int64_t k = 0; k < q; k++)
            out[t * ld + k] = c[k] + x * (c1[k] + x * (c2[k] + x * (c3[k] + x * c4[k])));
    }
}

/* r = y - measured, zero where nothing was measured; returns how many were */
WIDE int64_t kernel_residual(const double *restrict y, const double *restrict measured, int64_t count,
                        double *restrict r)
{
    int64_t used = 0;
    for (int64_t k = 0; k < count; k++) {
        const double v = measured[k];
        const int seen = v == v;
        r[k] = seen ? y[k] - v : 0.0;
        used += seen;
    }
    return used;
}

WIDE double kernel_square(const double *restrict r, int64_t count)
{
    double sum = 0.0;
#pragma omp simd reduction(+ : sum)
    for (int64_t k = 0; k < count; k++) sum += r[k] * r[k];
    return sum;
}

/* Innovations of one series in place: mean_k = (1 - gain) decay mean + gain r. Returns the last mean. */
WIDE double kernel_colour(double *restrict r, int64_t count, const double *restrict gain,
                     const double *restrict decay, const double *restrict weight, double mean)
{
    for (int64_t k = 0; k < count; k++) {
        const double v = r[k], back = (1.0 - gain[k]) * decay[k], innovation = v - decay[k] * mean;
        mean = back * mean + gain[k] * v;
        r[k] = innovation * weight[k];
    }
    return mean;
}

/* c = a b of square matrices; c is neither */
WIDE void kernel_product(double *restrict c, const double *restrict a, const double *restrict b, int n)
{
    for (int i = 0; i < n; i++, a += n, c += n) {
        int j = 0;
        for (; j + 4 <= n; j += 4) {
            Four sum = {0};
            for (int k = 0; k < n; k++) sum += a[k] * *(const Four *)(b + k * n + j);
            *(Four *)(c + j) = sum;
        }
        for (; j < n; j++) {
            double sum = 0.0;
            for (int k = 0; k < n; k++) sum += a[k] * b[k * n + j];
            c[j] = sum;
        }
    }
}

/* out += m v for a matrix by columns of `rows`, a multiple of 4; out is not v */
WIDE void kernel_apply(double *restrict out, const double *restrict m, const double *restrict v, int n, int rows)
{
    for (int i = 0; i < rows; i += 4) {
        Four even = *(const Four *)(out + i), odd = {0};
        const double *at = m + i;
        int j = 0;
        for (; j + 2 <= n; j += 2, at += 2 * rows) {
            even += *(const Four *)at * v[j];
            odd += *(const Four *)(at + rows) * v[j + 1];
        }
        if (j < n) even += *(const Four *)at * v[j];
        *(Four *)(out + i) = even + odd;
    }
}

/* Two rows of out += m s, `Columns` of them; enough sums for their additions not to wait for each other. */
#define TWO_ROWS(Columns)                                                                               \
    {                                                                                                   \
        double *first = out + i * ld + c, *second = first + (i + 1 < n ? ld : 0);                       \
        const int next = i + 1 < n ? i + 1 : i;                                                         \
        Four a0 = *(const Four *)first, b0 = *(const Four *)second, a1 = a0, b1 = b0;                   \
        if (Columns == 8) a1 = *(const Four *)(first + 4), b1 = *(const Four *)(second + 4);            \
        for (int j = 0; j < n; j++) {                                                                   \
            const double *from = s + j * ld + c; const double v = m[j * rows + i], w = m[j * rows + next];\
            a0 += v * *(const Four *)from, b0 += w * *(const Four *)from;                               \
            if (Columns == 8) a1 += v * *(const Four *)(from + 4), b1 += w * *(const Four *)(from + 4); \
        }                                                                                               \
        *(Four *)second = b0, *(Four *)first = a0;                                                      \
        if (Columns == 8) *(Four *)(second + 4) = b1, *(Four *)(first + 4) = a1;                        \
    }

/* out += m s for such a matrix and rows of q columns, a multiple of 4 */
WIDE void kernel_apply_rows(double *restrict out, const double *restrict m, const double *restrict s, int n,
                       int rows, int64_t q, int64_t ld)
{
    for (int64_t c = 0; c < q;) {
        const int wide = q - c >= 8;
        for (int i = 0; i < n; i += 2) {
            if (wide)
                TWO_ROWS(8)
            else
                TWO_ROWS(4)
        }
        c += wide ? 8 : 4;
    }
}
