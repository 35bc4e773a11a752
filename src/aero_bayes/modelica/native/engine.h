/* What the exponential steps of co-simulation need around them: the engine's own files exponential.c and phi.c take one
 * communication step by them, as a run of the engine a segment between two values of a moving input. */
#ifndef AERO_BAYES_ENGINE_H
#define AERO_BAYES_ENGINE_H
#include "rodas.h"

#include "exponential.h"

enum { FMI_OK, FMI_WARNING, FMI_DISCARD, FMI_ERROR };

typedef struct { int has_directional; } Problem;
typedef struct { int n_signals; } Experiment;

/* One instance's steps. Inputs are held, so that no signal slopes; there are no sensitivities (ld is 0). */
typedef struct Run {
    Model *m;
    const Problem *problem;
    const Experiment *e;
    Exponential *exponential;
    int n, nz, ld, sensitive, status, form, any_linear, any_slope, relay;
    double t, rtol, atol;
    double *x, *x1, *f, *jac, *nominal, *largest, *slope, *z0, *z1;
    const unsigned *u_reference;
} Run;

/* out += m v for a matrix by columns of `rows`, a multiple of 4 */
static void kernel_apply(double *restrict out, const double *restrict m, const double *restrict v, int n, int rows) {
    for (int j = 0; j < n; j++)
        for (int i = 0; i < rows; i++) out[i] += m[(size_t)j * rows + i] * v[j];
}
static void kernel_apply_rows(double *out, const double *m, const double *s, int n, int rows, long q, long ld) {
    (void)out; (void)m; (void)s; (void)n; (void)rows; (void)q; (void)ld;
}

static int is_error(int status) { return status > FMI_WARNING; }

static int set_point(Run *r, double t, const double *x) {
    move_to(r->m, t, x);
    return FMI_OK;
}
static int rhs(Run *r, double t, const double *x, double *f) {
    derivatives_at(r->m, t, x, f);
    return clear_failure(r->m) ? FMI_DISCARD : FMI_OK;
}
static int jacobian(Run *r, double t, const double *x, const double *f, double *jac) {
    (void)t; (void)x; (void)f;
    need_jacobian(r->m);
    for (int i = 0; i < NX; i++)
        for (int j = 0; j < NX; j++) jac[i * NX + j] = group(r->m, JX)[(size_t)j * NROW + i];
    return clear_failure(r->m) ? FMI_DISCARD : FMI_OK;
}
static int directional_column(Run *r, unsigned known, double *column) {
    (void)r; (void)known; (void)column;
    return FMI_ERROR;
}
static int indicators(Run *r, double t, const double *x, double *z) {
    move_to(r->m, t, x);
    event_indicators(r->m, z);
    return clear_failure(r->m) ? FMI_DISCARD : FMI_OK;
}
static int relay_turns(const Run *r, double *const *x) { (void)r; (void)x; return 0; }
static int columns_renew(Run *r) { (void)r; return FMI_ERROR; }
static double columns_step(Run *r) { (void)r; return NAN; }

#include "exponential.c"
#include "phi.c"

static void close_steps(Run *r) {
    if (!r) return;
    exponential_close(r->exponential);
    free(r);
}

/* The buffers of an instance's steps; NULL where its model cannot have them. */
static Run *open_steps(Model *m) {
    static const Problem problem = {1};
    static const Experiment none = {0};
    const size_t n = (size_t)NX, nz = (size_t)count_indicators();
    if (!n || n > MOST_STATES) return NULL;
    Run *r = calloc(1, sizeof *r + sizeof(double) * (5 * n + n * n + 2 * nz));
    if (!r) return NULL;
    double *at = (double *)(r + 1);
    *r = (Run){.m = m, .problem = &problem, .e = &none, .n = NX, .nz = (int)nz};
    r->x = at, r->x1 = at + n, r->f = at + 2 * n, r->nominal = at + 3 * n, r->largest = at + 4 * n, r->jac = at + 5 * n;
    r->z0 = r->jac + n * n, r->z1 = r->z0 + nz;
    for (int i = 0; i < NX; i++) r->nominal[i] = fabs(INFO.nominal[i]);
    if (!exponential_open(r)) {
        free(r);
        return NULL;
    }
    return r;
}

/* What was kept from earlier steps is forgotten: an instance that is set to a state goes on as the one that was there. */
static void begin_steps(Run *r) {
    if (!r) return;
    exponential_begin(r);
    memset(r->largest, 0, sizeof(double) * (size_t)NX);
}

/* As far as such steps are good enough from (t, x), up to `end`; returns where they lead, x along. */
static double exponential_until(Run *r, double t, double *x, double end) {
    const double span = end - t, least = 1e-12 * fmax(span, fabs(end));
    r->t = t;
    r->rtol = r->atol = r->m->tolerance; /* a nominal value that nobody stated follows the state's size */
    exponential_ready(r);
    memcpy(r->x, x, sizeof *x * (size_t)NX);
    if (r->nz && is_error(indicators(r, t, r->x, r->z0))) return t;
    while (end - r->t > least) {
        double told = -1.0;
        for (int i = 0; i < NX; i++) r->largest[i] = larger(r->largest[i], fabs(r->x[i]));
        if (is_error(rhs(r, r->t, r->x, r->f))) break;
        const double h = exponential_step(r, span, end - r->t, &told);
        if (!(h > 0)) break;
        r->t = end - (r->t + h) <= least ? end : r->t + h;
        memcpy(r->x, r->x1, sizeof *x * (size_t)NX);
        if (r->nz) memcpy(r->z0, r->z1, sizeof *r->z0 * (size_t)r->nz);
    }
    memcpy(x, r->x, sizeof *x * (size_t)NX);
    return r->t;
}

#endif
