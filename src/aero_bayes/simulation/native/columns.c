/* Sensitivities S = dx/dp over an exponential step: the derivative of its formula by the parameters, with A(p) and its
 * derivatives C_k = dA/dp_k. With y = x - x(t0), what the linearisation leaves of S_k' = J(t) S_k + B_k(t) is
 *   g_k = B_k + J S_k - B_k(t0) - J(t0) S_k(t0) - A (S_k - S_k(t0)) - C_k y,
 * as smooth as the remainder of the states, however fast they move: B_k itself is not, where a circuit settles within a
 * step. It is a parabola through the points of the step too. C_k need not be exact, and is left out (zero) where nothing
 * is stiff. Where the model is linear, g_k is zero, and a step costs the slopes at its beginning alone. */
#include "engine.h"

#define STEP_OF_STATES 1e-4  /* relative, for C_k by differences: most models are bilinear in states and parameters */
#define OF_PARABOLA 0.3      /* share of OFF_PARABOLA's error that counts */
#define CHANGE 0.1           /* of the end by the last round of corrections, in units of the tolerance */

enum { MOST_ROUNDS = 5 };

static size_t width(const Run *r) { return (size_t)(r->n * r->ld); }

/* to += m s */
static void apply(const Run *r, double *to, const double *m, const double *s)
{
    kernel_apply_rows(to, m, s, r->n, r->exponential->rows, r->ld, r->ld);
}

/* C_k anew at (r->t, r->x). */
int columns_renew(Run *r)
{
    Exponential *k = r->exponential;
    const Problem *p = r->problem;
    const int n = r->n, ld = r->ld;
    double *base = r->b_node, *moved = base + width(r), *x = r->u;
    memset(k->system.a.slopes, 0, sizeof *base * width(r) * (size_t)n);
    int status = set_point(r, r->t, r->x);
    if (!is_error(status)) status = sensitivity_slopes(r, base);
    for (int color = 0; color < p->n_colors && !is_error(status); color++) {
        memcpy(x, r->x, sizeof *x * (size_t)n);
        for (int j = 0; j < n; j++)
            if (p->color[j] == color) x[j] += STEP_OF_STATES * larger(larger(r->largest[j], fabs(x[j])), LEAST_SIZE);
        status = set_point(r, r->t, x);
        if (!is_error(status)) status = sensitivity_slopes(r, moved);
        for (int j = 0; j < n && !is_error(status); j++) {
            if (p->color[j] != color) continue;
            const double inverse = 1.0 / (x[j] - r->x[j]);
            for (int at = p->column_start[j]; at < p->column_start[j + 1]; at++)
                for (int c = p->row[at] * ld; c < (p->row[at] + 1) * ld; c++)
                    k->system.a.slopes[(size_t)j * width(r) + (size_t)c] = inverse * (moved[c] - base[c]);
        }
    }
    if (status == FMI_DISCARD) { /* beyond where the model is defined: it goes without them */
        memset(k->system.a.slopes, 0, sizeof *base * width(r) * (size_t)n);
        status = FMI_OK;
    }
    return status;
}

/* The columns at a fraction of the step without remainders. */
static void linear_columns(const Run *r, const Flow *f, double *to)
{
    const Exponential *k = r->exponential;
    const int n = r->n, wide = (int)width(r);
    memcpy(to, r->s, sizeof *to * width(r));
    apply(r, to, f->of_slope.value, k->s_slope);
    if (r->any_linear) apply(r, to, f->of_ramp.value, k->s_ramp);
    if (!k->system.ld) return;
    kernel_apply(to, f->of_slope.slopes, k->f0, n, wide);
    if (k->ramps) kernel_apply(to, f->of_ramp.slopes, k->ramp, n, wide);
    for (int j = 0; k->rounds != ONLY_END && j < NODES_X; j++) kernel_apply(to, f->of_node[j].slopes, k->d[j], n, wide);
}

static void add_remainders(const Run *r, const Flow *f, double *to)
{
    for (int j = 0; j < NODES_X; j++) apply(r, to, f->of_node[j].value, r->exponential->g[j]);
}

/* The columns at a fraction of the last step. */
void columns_at(const Run *r, const Flow *f, double *s)
{
    linear_columns(r, f, s);
    if (!r->exponential->bare_columns) add_remainders(r, f, s);
}

/* The Jacobian where the FMU stands, by columns, less A; or A added to nothing where it is NULL. */
static int jacobian_less(Run *r, double t, const double *x, const double *a, double *to)
{
    const int n = r->n, rows = r->exponential->rows, status = jacobian(r, t, x, NULL, r->a_node);
    for (int j = 0; j < n; j++)
        for (int i = 0; i < n; i++) to[j * rows + i] = r->a_node[i * n + j] - (a ? a[j * rows + i] : 0.0);
    return status;
}

/* Slopes at the beginning, and what they grow by where inputs slope. */
static int begin(Run *r, int whole)
{
    Exponential *k = r->exponential;
    if (k->carried) {
        memcpy(k->s_slope, k->s_ramp, sizeof *k->s_slope * width(r));
        return FMI_OK;
    }
    int status = set_point(r, r->t, r->x);
    if (!is_error(status)) status = sensitivity_slopes(r, k->s_slope);
    if (!is_error(status) && whole) status = jacobian_less(r, r->t, r->x, NULL, k->nearness[0]);
    if (!is_error(status) && r->any_linear) {
        status = set_point(r, r->t + k->now->h, r->x);
        if (!is_error(status)) status = sensitivity_slopes(r, k->s_ramp);
        for (size_t i = 0; i < width(r); i++) k->s_ramp[i] -= k->s_slope[i];
    }
    apply(r, k->s_slope, whole ? k->nearness[0] : k->system.a.value, r->s);
    return status;
}

/* At a point: J - A, and in `rest` what of g_k does not depend on S_k there. */
static int visit(Run *r, int j, double *rest)
{
    Exponential *k = r->exponential;
    const double t = r->t + point_of[j] * k->now->h;
    int status = set_point(r, t, k->x[j]);
    if (!is_error(status)) status = sensitivity_slopes(r, rest);
    if (!is_error(status)) status = jacobian_less(r, t, k->x[j], k->system.a.value, k->nearness[j]);
    if (is_error(status)) return status;
    for (size_t i = 0; i < width(r); i++) rest[i] -= k->s_slope[i];
    for (size_t i = 0; r->any_linear && i < width(r); i++) rest[i] -= point_of[j] * k->s_ramp[i];
    apply(r, rest, k->system.a.value, r->s);
    if (!k->system.ld) return status;
    for (int i = 0; i < r->n; i++) k->v[i] = k->x0[i] - k->x[j][i];
    kernel_apply(rest, k->system.a.slopes, k->v, r->n, (int)width(r));
    return status;
}

/* Corrections until they change the end no more; returns how much they still do. They shrink as those of the states. */
static double correct(Run *r, const StepTable *t, const double *rest)
{
    Exponential *k = r->exponential;
    const size_t size = width(r), bytes = sizeof(double) * size;
    double *before = r->sv, *add = r->su, *at = before + size, error = INFINITY;
    memset(before, 0, bytes);
    for (int round = 0; round < MOST_ROUNDS && error > CHANGE; round++) {
        for (int j = 0; j < NODES_X; j++) {
            double *s = at + (size_t)j * size;
            memcpy(s, k->s_linear[j], bytes);
            if (round) add_remainders(r, &t->node[j], s);
        }
        for (int j = 0; j < NODES_X; j++) {
            memcpy(k->g[j], rest + (size_t)j * size, bytes);
            apply(r, k->g[j], k->nearness[j], at + (size_t)j * size);
        }
        memset(add, 0, bytes);
        add_remainders(r, &t->node[2], add);
        for (size_t i = 0; i < size; i++) {
            r->s1[i] = k->s_linear[2][i] + add[i];
            before[i] = add[i] - before[i];
        }
        const double change = sensitivity_error(r, before);
        error = round ? change : k->contraction >= 0.0 ? 3.0 * k->contraction * change : INFINITY;
        if (!(change < INFINITY)) return NAN;
        memcpy(before, add, bytes);
    }
    k->linear_columns = k->linear_model && sensitivity_error(r, add) <= CLOSE_TO_LINEAR;
    return error <= CHANGE ? error : INFINITY;
}

/* The slopes of a linear model's columns at the end of a step without slopes of inputs, to where these would be: samples
 * within the step need those at its beginning. */
static void carry(Run *r)
{
    Exponential *k = r->exponential;
    double *more = r->sv;
    for (size_t i = 0; i < width(r); i++) more[i] = r->s1[i] - r->s[i];
    memcpy(k->s_ramp, k->s_slope, sizeof *more * width(r));
    apply(r, k->s_ramp, k->system.a.value, more);
    for (int i = 0; i < r->n; i++) k->v[i] = k->x[NODES_X - 1][i] - k->x0[i];
    kernel_apply(k->s_ramp, k->system.a.slopes, k->v, r->n, (int)width(r));
}

/* S at the end of the step that the states have just taken, to r->s1; its error in units of the tolerance. */
double columns_step(Run *r)
{
    Exponential *k = r->exponential;
    StepTable *t = k->now;
    const size_t size = width(r);
    k->bare_columns = k->rounds == ONLY_END && (r->form == LINEAR_FORM || k->linear_columns);
    r->status = begin(r, !k->bare_columns);
    if (is_error(r->status)) return NAN;
    linear_columns(r, &t->node[2], k->s_linear[2]);
    if (k->bare_columns) {
        memcpy(r->s1, k->s_linear[2], sizeof *r->s1 * size);
        k->carried = r->form == LINEAR_FORM && !r->any_linear;
        if (k->carried) carry(r);
        return 0.0;
    }
    for (int j = 0; j < NODES_X; j++) {
        if (j < 2) linear_columns(r, &t->node[j], k->s_linear[j]);
        r->status = visit(r, j, r->b_node + (size_t)j * size);
        if (is_error(r->status)) return NAN;
    }
    const double change = correct(r, t, r->b_node);
    if (!(change < INFINITY)) return change;
    double *defect = r->su, *effect = r->sv;
    for (size_t i = 0; i < size; i++)
        defect[i] = at_start[0] * k->g[0][i] + at_start[1] * k->g[1][i] + at_start[2] * k->g[2][i];
    memset(effect, 0, sizeof *effect * size);
    apply(r, effect, t->node[2].of_slope.value, defect);
    return change + OF_PARABOLA * OFF_PARABOLA * sensitivity_error(r, effect);
}
