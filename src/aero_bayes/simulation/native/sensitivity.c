/* Forward sensitivities S = dx/dp on the steps of the state (staggered direct method; M. Caracotsios, W. Stewart 1985;
 * W. Feehery, J. Tolsma, P. Barton 1997). S' = A(t) S + B(t) is linear, with A = df/dx and B = df/dp along the
 * continuous extension of the state. The same Rosenbrock method is applied to it as to any non-autonomous system: its
 * exact Jacobian is A(t_n), so the factors of the state's own step serve every column. A and B are taken at four points
 * of the step and interpolated by a cubic, which also gives their time derivative. */
#include "engine.h"

static const double node[4] = {0.0, 1.0 / 3.0, 2.0 / 3.0, 1.0};

static void cubic_weights(double x, double *w)
{
    for (int i = 0; i < 4; i++) {
        w[i] = 1.0;
        for (int j = 0; j < 4; j++)
            if (j != i) w[i] *= (x - node[j]) / (node[i] - node[j]);
    }
}

static const double slope_at_0[4] = {-5.5, 9.0, -4.5, 1.0};

/* Columns whose signal value or delay cannot act before time t stay exactly zero: they are left out. */
void sensitivity_enter(Run *r, double t)
{
    while (r->alive < r->q && r->column_from[r->alive] <= t + r->resolution) r->alive++;
}

static double from_time(const Run *r, const Target *t)
{
    if (t->kind != TARGET_INPUT) return -INFINITY;
    const Signal *s = &r->e->signals[t->a];
    const int64_t k = s->linear ? t->b - 1 : t->b;
    return k <= 0 ? -INFINITY : s->time[k] + r->delay;
}

/* An input that jumps at the first sample already moves the delay's column: x(t0) waits for it. */
static int delay_at_start(Run *r)
{
    int column = -1, jumps = 0;
    for (int k = 0; k < r->q; k++)
        if (r->column_target[k].kind == TARGET_DELAY) column = k;
    if (column < 0 || !r->n) return FMI_OK;
    for (int i = 0; i < r->e->n_signals; i++) {
        const Signal *s = &r->e->signals[i];
        const int64_t k = r->cell[i];
        if (s->linear || k == 0 || fabs(s->time[k] + r->delay - r->t) > r->resolution) continue;
        jumps |= r->signal_values[i][k] != r->signal_values[i][k - 1];
        r->u0[i] = r->signal_values[i][k - 1];
    }
    if (!jumps) return FMI_OK;
    int status = inputs_apply(r, r->t);
    if (!worse(status)) status = rhs(r, r->t, r->x, r->f1);
    inputs_enter(r, r->t);
    if (!worse(status)) status = inputs_apply(r, r->t);
    if (!worse(status)) status = rhs(r, r->t, r->x, r->f);
    if (worse(status)) return status;
    for (int i = 0; i < r->n; i++) r->s[i * r->ld + column] += r->f1[i] - r->f[i];
    return FMI_OK;
}

/* Sorts the active columns and sets S(t0). Returns an outcome. */
int sensitivity_begin(Run *r)
{
    const Experiment *e = r->e;
    for (int j = 0; j < r->q; j++) {
        const Target t = e->targets[r->active[j]];
        const double from = from_time(r, &t);
        int k = j;
        for (; k > 0 && r->column_from[k - 1] > from; k--) {
            r->column_from[k] = r->column_from[k - 1];
            r->column_target[k] = r->column_target[k - 1];
            r->order[k] = r->order[k - 1];
        }
        r->column_from[k] = from;
        r->column_target[k] = t;
        r->order[k] = j;
    }
    r->alive = 0;
    sensitivity_enter(r, r->t);
    for (int i = 0; i < r->n; i++)
        for (int k = 0; k < r->ld; k++)
            r->s[i * r->ld + k] = k < r->q ? r->s0[i * r->q + r->order[k]] : 0.0;
    return worse(delay_at_start(r)) ? AB_MODEL_ERROR : AB_OK;
}

static int needs_signal(const Run *r, int signal)
{
    const Target *t = r->column_target;
    for (int k = 0; k < r->alive; k++) {
        if (t[k].kind == TARGET_DELAY && r->slope[signal] != 0.0) return 1;
        if (t[k].kind == TARGET_INPUT && t[k].a == signal) return 1;
    }
    return 0;
}

/* A and B at one of the four points; the FMU stands at (t, x) already. jac is a known A, or NULL. */
int sensitivity_node(Run *r, int index, double t, const double *x, const double *jac)
{
    const int n = r->n, ld = r->ld;
    double *a = r->a_node + index * n * n, *b = r->b_node + index * n * ld;
    if (jac)
        memcpy(a, jac, sizeof *a * (size_t)(n * n));
    else {
        const int status = jacobian(r, t, x, NULL, a);
        if (worse(status)) return status;
    }
    memset(b, 0, sizeof *b * (size_t)(n * ld));
    for (int k = 0; k < r->alive; k++)
        if (r->column_target[k].kind == TARGET_PARAMETER) {
            const int status = directional_column(r, (fmi_reference)r->column_target[k].a, r->column);
            if (worse(status)) return status;
            for (int i = 0; i < n; i++) b[i * ld + k] = r->column[i];
        }
    for (int signal = 0; signal < r->e->n_signals; signal++) {
        if (!needs_signal(r, signal)) continue;
        const int status = directional_column(r, r->u_reference[signal], r->column);
        if (worse(status)) return status;
        for (int k = 0; k < r->alive; k++) {
            const Target *target = &r->column_target[k];
            double w = 0.0;
            if (target->kind == TARGET_DELAY)
                w = -r->slope[signal];
            else if (target->kind == TARGET_INPUT && target->a == signal)
                w = input_weight(r, target, t);
            if (w != 0.0)
                for (int i = 0; i < n; i++) b[i * ld + k] += w * r->column[i];
        }
    }
    return FMI_OK;
}

/* Error of the worst column, each in units of its own size. */
static double column_error(const Run *r, const double *v)
{
    const int n = r->n, ld = r->ld;
    const double rtol = 10.0 * r->rtol;
    double worst = 0.0;
    for (int k = 0; k < r->alive; k++) {
        double size = 0.0, sum = 0.0;
        for (int i = 0; i < n; i++)
            size = fmax(size, fmax(fabs(r->s[i * ld + k]), fabs(r->s1[i * ld + k])) / r->nominal[i]);
        if (size == 0.0) continue;
        for (int i = 0; i < n; i++) {
            const double scale = fmax(fabs(r->s[i * ld + k]), fabs(r->s1[i * ld + k])) + size * r->nominal[i];
            const double e = v[i * ld + k] / (rtol * scale);
            sum += e * e;
        }
        worst = fmax(worst, sum / (double)n);
        if (!(sum < INFINITY)) return NAN;
    }
    return sqrt(worst);
}

/* The step of the state has been accepted: r->lu its factors, r->dense its continuous extension, nodes 0 and 3 are
 * filled. Leaves S(t + h) in r->s1 and its continuous extension in r->sdense. Returns the error, NAN for failure. */
double sensitivity_step(Run *r, double h)
{
    const Method *m = method;
    const int n = r->n, ld = r->ld;
    const int64_t size = (int64_t)n * ld;
    const int64_t alive = (r->alive + 3) / 4 * 4;
    if (!r->alive) return 0.0;
    for (int k = 1; k < 3; k++) {
        for (int i = 0; i < n; i++) kernels->horner(r->dense + i, n, m->dense, &node[k], 1, r->u + i);
        r->status = set_point(r, r->t + node[k] * h, r->u);
        if (worse(r->status)) return NAN;
        r->status = sensitivity_node(r, k, r->t + node[k] * h, r->u, NULL);
        if (worse(r->status)) return NAN;
    }
    double w[8];
    const int64_t nn = (int64_t)n * n;
    /* g_dot = A'(t_n) S + B'(t_n), per unit of theta */
    memset(r->g_dot, 0, sizeof(double) * (size_t)size);
    memset(r->a_now, 0, sizeof(double) * (size_t)nn);
    kernels->combine(r->a_now, r->a_now, slope_at_0, 4, r->a_node, nn, nn);
    kernels->combine(r->g_dot, r->g_dot, slope_at_0, 4, r->b_node, size, size);
    kernels->multiply(r->g_dot, r->a_now, r->s, n, alive, ld);
    const double *u = r->s;
    for (int stage = 0; stage < m->stages; stage++) {
        double *v = r->sv + stage * size;
        const double *a, *b;
        if (stage == 0) {
            a = r->a_node;
            b = r->b_node;
        } else if (m->alpha[stage] == 1.0) {
            a = r->a_node + 3 * nn;
            b = r->b_node + 3 * size;
        } else {
            cubic_weights(m->alpha[stage], w);
            memset(r->a_now, 0, sizeof(double) * (size_t)nn);
            memset(r->b_now, 0, sizeof(double) * (size_t)size);
            kernels->combine(r->a_now, r->a_now, w, 4, r->a_node, nn, nn);
            kernels->combine(r->b_now, r->b_now, w, 4, r->b_node, size, size);
            a = r->a_now;
            b = r->b_now;
        }
        if (stage) {
            kernels->combine(r->su, r->s, m->a[stage], stage, r->sv, size, size);
            u = r->su;
        }
        for (int j = 0; j < stage; j++) w[j] = m->c[stage][j] / h;
        kernels->combine(v, b, w, stage, r->sv, size, size);
        kernels->multiply(v, a, u, n, alive, ld);
        if (m->d[stage] != 0.0) kernels->combine(v, v, &m->d[stage], 1, r->g_dot, 0, size);
        kernels->solve(r->lu, r->pivot, v, n, alive, ld);
    }
    const double one = 1.0;
    double *last = r->sv + (m->stages - 1) * size;
    kernels->combine(r->s1, r->su, &one, 1, last, 0, size);
    const double error = column_error(r, last);
    double *c = r->sdense;
    for (int d = 0; d < 3; d++) {
        double *k = c + (2 + d) * size;
        memset(k, 0, sizeof(double) * (size_t)size);
        kernels->combine(k, k, m->H[d], m->stages, r->sv, size, size);
    }
    for (int64_t i = 0; i < size; i++) {
        const double k1 = c[2 * size + i], k2 = c[3 * size + i], k3 = c[4 * size + i];
        c[i] = r->s[i];
        c[size + i] = r->s1[i] - r->s[i] + k1;
        c[2 * size + i] = k2 - k1;
        c[3 * size + i] = k3 - k2;
        c[4 * size + i] = -k3;
    }
    return error;
}
