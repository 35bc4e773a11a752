/* Rosenbrock methods for stiff systems, in the form that needs no products with the Jacobian:
 * E. Hairer, G. Wanner, Solving Ordinary Differential Equations II (1996), section IV.7.
 * Rodas5P: G. Steinebach, BIT Numerical Mathematics 63:27 (2023); order 5(4), L-stable, stiffly accurate,
 * continuous extension of order 4. */
#include <float.h>

#include "engine.h"

const Method rodas5p = {
    0.21193756319429014,
    {{0},
     {3.0},
     {2.849394379747939, 0.45842242204463923},
     {-6.954028509809101, 2.489845061869568, -10.358996098473584},
     {2.8029986275628964, 0.5072464736228206, -0.3988312541770524, -0.04721187230404641},
     {-7.502846399306121, 2.561846144803919, -11.627539656261098, -0.18268767659942256, 0.030198172008377946},
     {-7.502846399306121, 2.561846144803919, -11.627539656261098, -0.18268767659942256, 0.030198172008377946, 1.0},
     {-7.502846399306121, 2.561846144803919, -11.627539656261098, -0.18268767659942256, 0.030198172008377946, 1.0,
      1.0}},
    {{0},
     {-14.155112264123755},
     {-17.97296035885952, -2.859693295451294},
     {147.12150275711716, -1.41221402718213, 71.68940251302358},
     {165.43517024871676, -0.4592823456491126, 42.90938336958603, -5.961986721573306},
     {24.854864614690072, -3.0009227002832186, 47.4931110020768, 5.5814197821558125, -0.6610691825249471},
     {30.91273214028599, -3.1208243349937974, 77.79954646070892, 34.28646028294783, -19.097331116725623,
      -28.087943162872662},
     {37.80277123390563, -3.2571969029072276, 112.26918849496327, 66.9347231244047, -40.06618937091002,
      -54.66780262877968, -9.48861652309627}},
    {0.0, 0.6358126895828704, 0.4095798393397535, 0.9769306725060716, 0.4288403609558664, 1.0, 1.0, 1.0},
    {0.21193756319429014, -0.42387512638858027, -0.3384627126235924, 1.8046452872882734, 2.325825639765069, 0.0, 0.0,
     0.0},
    {{25.948786856663858, -2.5579724845846235, 10.433815404888879, -2.3679251022685204, 0.524948541321073,
      1.1241088310450404, 0.4272876194431874, -0.17202221070155493},
     {-9.91568850695171, -0.9689944594115154, 3.0438037242978453, -24.495224566215796, 20.176138334709044,
      15.98066361424651, -6.789040303419874, -6.710236069923372},
     {11.419903575922262, 2.8879645146136994, 72.92137995996029, 80.12511834622643, -52.072871366152654,
      -59.78993625266729, -0.15582684282751913, 4.883087185713722}},
};

/* LU with row exchanges, kept without its zeros: physical models are sparse even when they are small. Returns 1 for a
 * singular matrix. */
static int lu_factor(double *restrict a, int n, int *restrict pivot, Sparse *out)
{
    out->n = n;
    out->pivoted = 0;
    for (int j = 0; j < n; j++) {
        int best = j;
        double size = fabs(a[j * n + j]);
        for (int i = j + 1; i < n; i++)
            if (fabs(a[i * n + j]) > size) size = fabs(a[i * n + j]), best = i;
        pivot[j] = best;
        if (!(size > 0.0)) return 1;
        if (best != j) {
            out->pivoted = 1;
            for (int k = 0; k < n; k++) {
                const double v = a[j * n + k];
                a[j * n + k] = a[best * n + k];
                a[best * n + k] = v;
            }
        }
        const double inverse = out->diagonal[j] = 1.0 / a[j * n + j];
        for (int i = j + 1; i < n; i++) {
            if (a[i * n + j] == 0.0) continue;
            const double w = a[i * n + j] *= inverse;
            for (int k = j + 1; k < n; k++) a[i * n + k] -= w * a[j * n + k];
        }
    }
    int filled = 0;
    for (int i = 0; i < n; i++) {
        out->start[i] = filled;
        for (int j = 0; j < i; j++)
            if (a[i * n + j] != 0.0) out->col[filled] = j, out->val[filled++] = a[i * n + j];
    }
    for (int i = 0; i < n; i++) {
        out->start[n + i] = filled;
        for (int j = i + 1; j < n; j++)
            if (a[i * n + j] != 0.0) out->col[filled] = j, out->val[filled++] = a[i * n + j];
    }
    out->start[2 * n] = filled;
    return 0;
}

static void lu_solve(const Sparse *lu, const int *restrict pivot, double *restrict b)
{
    const int n = lu->n, *restrict start = lu->start, *restrict col = lu->col;
    const double *restrict val = lu->val;
    for (int i = 0; lu->pivoted && i < n; i++)
        if (pivot[i] != i) {
            const double v = b[i];
            b[i] = b[pivot[i]];
            b[pivot[i]] = v;
        }
    for (int i = 1; i < n; i++)
        for (int k = start[i]; k < start[i + 1]; k++) b[i] -= val[k] * b[col[k]];
    for (int i = n - 1; i >= 0; i--) {
        double v = b[i];
        for (int k = start[n + i]; k < start[n + i + 1]; k++) v -= val[k] * b[col[k]];
        b[i] = v * lu->diagonal[i];
    }
}

/* In units of the tolerance. */
double scaled_norm(const Run *r, const double *v, const double *x, const double *x1)
{
    double sum = 0.0;
    for (int i = 0; i < r->n; i++) {
        const double now = larger(fabs(x[i]), fabs(x1[i]));
        const double e = v[i] / (r->atol * state_size(r, i, now) + r->rtol * now);
        sum += e * e;
    }
    return sqrt(sum / (double)(r->n ? r->n : 1));
}

/* One step of size h from (r->t, r->x) with r->f, r->jac there and ft = df/dt (or NULL). The new state is in r->x1,
 * the stages in r->k. Returns the scaled error estimate; not a number where the step must be repeated smaller. */
double rodas_step(Run *r, double h, const double *ft)
{
    const int n = r->n;
    const double diagonal = 1.0 / (h * rodas5p.gamma);
    double w[8];
    for (int i = 0; i < n * n; i++) r->lu[i] = -r->jac[i];
    for (int i = 0; i < n; i++) r->lu[i * n + i] += diagonal;
    r->status = FMI_OK;
    if (lu_factor(r->lu, n, r->pivot, &r->factors)) return NAN;
    for (int s = 0; s < STAGES; s++) {
        double *k = r->k + s * n;
        const double *f = r->f;
        if (s) {
            kernel_combine(r->u, r->x, rodas5p.a[s], s, r->k, n, n);
            r->status = rhs(r, r->t + rodas5p.alpha[s] * h, r->u, r->r);
            if (is_error(r->status)) return NAN;
            f = r->r;
        }
        for (int j = 0; j < s; j++) w[j] = rodas5p.c[s][j] / h;
        kernel_combine(k, f, w, s, r->k, n, n);
        if (ft && rodas5p.d[s] != 0.0)
            for (int i = 0; i < n; i++) k[i] += h * rodas5p.d[s] * ft[i];
        lu_solve(&r->factors, r->pivot, k);
    }
    const double *last = r->k + (STAGES - 1) * n;
    for (int i = 0; i < n; i++) r->x1[i] = r->u[i] + last[i];
    return scaled_norm(r, last, r->x, r->x1);
}

/* Coefficients of the continuous extension of `count` numbers in powers of fraction = (t - t_n) / h, from x to x1 by the
 * stages k; those of a power, and those of a stage, are `stride` behind the ones before. */
void continuous_extension(double *c, int64_t stride, const double *x, const double *x1, const double *k, int64_t count)
{
    memset(c, 0, sizeof *c * (size_t)count);
    for (int d = 0; d < 3; d++) kernel_combine(c + (2 + d) * stride, c, rodas5p.H[d], STAGES, k, stride, count);
    for (int64_t i = 0; i < count; i++) {
        const double k1 = c[2 * stride + i], k2 = c[3 * stride + i], k3 = c[4 * stride + i];
        c[i] = x[i];
        c[stride + i] = x1[i] - x[i] + k1;
        c[2 * stride + i] = k2 - k1;
        c[3 * stride + i] = k3 - k2;
        c[4 * stride + i] = -k3;
    }
}

/* A first step from the size and the rate of change of the slope: with x' ~ exp(-t / tau), amplitude a in units of the
 * tolerance, the error of the embedded method is about 1e-3 a (h / tau)^5. */
double first_step(Run *r, double limit)
{
    const int n = r->n;
    for (int i = 0; i < n; i++) {
        double v = 0.0;
        for (int j = 0; j < n; j++) v += r->jac[i * n + j] * r->f[j];
        r->u[i] = v;
    }
    const double slope = scaled_norm(r, r->f, r->x, r->x), bend = scaled_norm(r, r->u, r->x, r->x);
    if (!(slope > 0.0)) return limit;
    if (!(bend > 0.0)) return fmin(limit, 1e6 / slope);
    const double tau = slope / bend, amplitude = slope * tau;
    const double h = tau * pow(1e-3 * amplitude, -0.2);
    return h < limit ? h : limit;
}
