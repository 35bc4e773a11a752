/* A motor that swings a body, as a tool that factors nothing writes it: two hundred variables are computed one after the
 * other for everything that is asked, a Jacobian is computed by columns through all of them, parameters are refused, and
 * the outputs are copies of the states. Update happens once where nothing has changed. */
#define STATES {0, 2, 4, 6}
#define DERIVATIVES {1, 3, 5, 7}
#define FIXED
#define OWN_DIRECTIONAL
#include "skeleton.h"
enum { I, DI, W, DW, Q, DQ, TH, DTH, Y_I, Y_W, Y_TH, R, L, K, J, D, G, B, S, U = 40 };
enum { CHAIN = 200 };
static void start(Model *m)
{
    const double own[] = {8.4, 1.16e-3, 0.042, 8.7e-6, 2.4e-8, 8.4e-7, 6e-3, 0.09};
    memcpy(m->r + R, own, sizeof own);
}
static int initialize(Model *m) { return OK; }
/* v = f(x), and dv = df/dx . dx where dx is given: the same chain either way. */
static void evaluate(const double *r, const double *x, const double *dx, double du, double *v, double *dv)
{
    double a[CHAIN], da[CHAIN];
    a[0] = x[3], da[0] = dx ? dx[3] : 0.0;
    for (int i = 1; i < CHAIN; i++) { /* sin(x[3]) for i = 1, passed on with hardly a change */
        a[i] = i == 1 ? sin(a[0]) : a[i - 1] * (1.0 + 1e-15 * r[R]);
        if (dx) da[i] = i == 1 ? cos(a[0]) * da[0] : da[i - 1] * (1.0 + 1e-15 * r[R]);
    }
    const double lift = r[G] * x[1] * fabs(x[1]);
    v[0] = (r[U] - r[R] * x[0] - r[K] * x[1]) / r[L];
    v[1] = (r[K] * x[0] - r[D] * x[1] * fabs(x[1])) / r[J];
    v[2] = (0.16 * lift - r[B] * x[2] - r[S] * a[CHAIN - 1]) / 0.0217;
    v[3] = x[2];
    if (!dx) return;
    dv[0] = (du - r[R] * dx[0] - r[K] * dx[1]) / r[L];
    dv[1] = (r[K] * dx[0] - 2.0 * r[D] * fabs(x[1]) * dx[1]) / r[J];
    dv[2] = (0.32 * r[G] * fabs(x[1]) * dx[1] - r[B] * dx[2] - r[S] * da[CHAIN - 1]) / 0.0217;
    dv[3] = dx[2];
}
static int update(Model *m)
{
    double *r = m->r, x[4], v[4];
    for (int i = 0; i < 4; i++) x[i] = r[2 * i];
    evaluate(r, x, NULL, 0.0, v, NULL);
    for (int i = 0; i < 4; i++) r[2 * i + 1] = v[i];
    r[Y_I] = x[0], r[Y_W] = x[1], r[Y_TH] = x[3];
    return OK;
}
static int discrete(Model *m, Events *e) { return OK; }
static void zero_crossings(Model *m, double *z) {}
static int derivative(Model *m, unsigned unknown, unsigned known, double *v) { return ERROR; }
API int fmi2GetDirectionalDerivative(void *c, const unsigned *unknown, size_t nu, const unsigned *known, size_t nk,
                                     const double *seed, double *out)
{
    const double *r = ((Model *)c)->r;
    double x[4], dx[4] = {0}, du = 0.0, v[4], dv[4];
    for (int i = 0; i < 4; i++) x[i] = r[2 * i];
    for (size_t k = 0; k < nk; k++) {
        if (known[k] == U) du += seed[k];
        else if (known[k] < 8 && known[k] % 2 == 0) dx[known[k] / 2] += seed[k];
        else return ERROR;
    }
    evaluate(r, x, dx, du, v, dv);
    for (size_t i = 0; i < nu; i++) {
        const unsigned u = unknown[i];
        out[i] = u < 8 ? dv[u / 2] : dx[u == Y_TH ? 3 : u - Y_I];
    }
    return OK;
}
