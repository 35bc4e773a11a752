/* What an FMU does that its description does not say, or says wrongly: whether its algebraic loops are solved only when
 * the derivatives are asked for, and whether derivatives depend on more states than are declared, found at two points
 * about the first run's start; and whether its directional derivatives with respect to the targets are right. */
#include <float.h>

#include "engine.h"

enum { PROBE_POINTS = 2, TRUST_POINTS = 3 };

/* Between 0.1 and 0.9, the same in every worker. */
static double share(int place) { return 0.1 + 0.8 * fmod(0.6180339887498949 * (double)(place + 1), 1.0); }

/* A little away from the start, in time too; no further, where the model's code may not stand it. */
static double probe_point(const Run *r, int k, const double *x0, double *x)
{
    for (int i = 0; i < r->n; i++) {
        x[i] = x0[i] + (k ? -1e-4 : 1e-4) * share(k * r->n + i) * fmax(fabs(x0[i]), r->nominal[i]);
    }
    return r->t + 1e-4 * (k + 1) * (fmin(r->t_end, r->next_event) - r->t);
}

static int agrees(double a, double b, double size) { return !(fabs(a - b) > 1e-9 * fmax(fmax(fabs(a), fabs(b)), size)); }

static int read_all(Run *r, double *out)
{
    Fmu *f = r->fmu;
    int status = FMI_OK;
    if (r->n_other) status = f->get_real(f->instance, r->other_reference, (size_t)r->n_other, out);
    if (!is_error(status) && r->problem->nz) status = f->get_indicators(f->instance, out + r->n_other, (size_t)r->problem->nz);
    if (!is_error(status) && r->problem->has_directional)
        status = directional_column(r, r->problem->state_reference[0], out + r->n_other + r->problem->nz);
    return status;
}

/* Is anything else once the derivatives have been asked for? */
static int needs_derivatives_first(Run *r, const double *x0, double *x)
{
    const int64_t size = r->n_other + r->problem->nz + (r->problem->has_directional ? r->n : 0);
    if (!size) return 0;
    double *before = malloc(sizeof *before * (size_t)(2 * size)), *after = before + size;
    int differs = 0;
    for (int k = 0; before && k < PROBE_POINTS; k++) {
        const double t = probe_point(r, k, x0, x);
        int status = set_point(r, t, x);
        if (!is_error(status)) status = read_all(r, before);
        if (!is_error(status)) status = r->fmu->get_derivatives(r->fmu->instance, r->derivatives_unused, (size_t)r->n);
        if (!is_error(status)) status = read_all(r, after);
        for (int64_t i = 0; i < size && !is_error(status); i++) differs |= !agrees(before[i], after[i], 0.0);
    }
    free(before);
    return differs;
}

static void use_dense_pattern(Problem *p)
{
    const int n = p->n;
    p->color = own(p, n, sizeof *p->color), p->column_start = own(p, n + 1, sizeof *p->column_start);
    p->row = own(p, (int64_t)n * n, sizeof *p->row);
    p->n_colors = n;
    for (int j = 0; j < n; j++) {
        p->color[j] = j;
        p->column_start[j + 1] = (j + 1) * n;
        for (int i = 0; i < n; i++) p->row[j * n + i] = i;
    }
}

/* The Jacobian by the declared pattern against the one without. */
static int pattern_is_right(Run *r, const double *x0, double *x)
{
    Problem *p = r->problem;
    const int n = r->n;
    if (p->n_colors == n && p->column_start[n] == n * n) return 1;
    Problem plain = *p;
    use_dense_pattern(&plain);
    p->owned = plain.owned;
    double *all = malloc(sizeof *all * (size_t)(n * n));
    const double fine = p->has_directional ? 1e-9 : 1e-4;
    int right = 1;
    for (int k = 0; k < PROBE_POINTS && right; k++) {
        const double t = probe_point(r, k, x0, x);
        if (is_error(rhs(r, t, x, r->f)) || is_error(jacobian(r, t, x, r->f, r->jac))) continue;
        r->problem = &plain;
        const int status = jacobian(r, t, x, r->f, all);
        r->problem = p;
        for (int i = 0; i < n && !is_error(status); i++) {
            double size = 0.0;
            for (int j = 0; j < n; j++) size = fmax(size, fabs(all[i * n + j]) * r->nominal[j]);
            for (int j = 0; j < n; j++)
                right &= !(fabs(all[i * n + j] - r->jac[i * n + j]) * r->nominal[j] > fine * size);
        }
    }
    free(all);
    return right;
}

/* Where the model cannot start there is nothing to find; the run will tell why. */
void probe(Run *r)
{
    Problem *p = r->problem;
    if (p->probed) return;
    if (!r->n || initialise(r) != AB_OK) {
        p->probed = !r->n;
        return;
    }
    p->probed = 1;
    double *x0 = malloc(sizeof *x0 * (size_t)(2 * r->n)), *x = x0 + r->n;
    if (!x0) return;
    memcpy(x0, r->x, sizeof *x0 * (size_t)r->n);
    p->derivatives_first = needs_derivatives_first(r, x0, x);
    if (!pattern_is_right(r, x0, x)) use_dense_pattern(p);
    free(x0);
}

/* The standard promises directional derivatives with respect to states and inputs; an FMU may refuse parameters, or answer
 * with zeros (the Modelica Association's VanDerPol does). Before sensitivities are built on them, they are held against
 * differences at a few points about the model's own start. Only what differences show beyond doubt counts: where both
 * sides of a difference agree with each other. */
typedef struct {
    int n, size;              /* states; derivatives and other real outputs */
    fmi_reference *unknown;   /* of both */
    double *at;               /* TRUST_POINTS x n */
    double *base, *high, *low, *told;
} Trial;

static int read_unknowns(Run *r, const Trial *b, const double *x, double *out)
{
    const int status = rhs(r, r->t, x, out);
    if (is_error(status) || b->size == b->n) return status;
    return r->fmu->get_real(r->fmu->instance, b->unknown + b->n, (size_t)(b->size - b->n), out + b->n);
}

static int read_points(Run *r, const Trial *b, double *out)
{
    for (int k = 0; k < TRUST_POINTS; k++)
        if (is_error(read_unknowns(r, b, b->at + k * b->n, out + k * b->size))) return FMI_ERROR;
    return FMI_OK;
}

/* Does what the FMU told contradict both sides of the difference? */
static int contradicted(const Trial *b, double step)
{
    for (int i = 0; i < TRUST_POINTS * b->size; i++) {
        const double above = (b->high[i] - b->base[i]) / step, below = (b->base[i] - b->low[i]) / step;
        const double size = larger(fabs(above), fabs(below));
        const double noise = 1e4 * DBL_EPSILON * fabs(b->base[i]) / step;
        if (!isfinite(size) || !(fabs(above - below) <= 1e-2 * size) || size <= noise) continue;
        if (!(fabs(b->told[i] - above) <= 0.05 * larger(size, fabs(b->told[i])))) return 1;
    }
    return 0;
}

/* What the FMU tells at every point; not OK where it refuses. The model stands at its own values. */
static int read_directional(Run *r, const Trial *b, fmi_reference known)
{
    for (int k = 0; k < TRUST_POINTS; k++) {
        int status = set_point(r, r->t, b->at + k * b->n);
        if (!is_error(status) && b->size)
            status = derivative_columns(r, b->unknown, (size_t)b->size, &known, 1, b->told + k * b->size);
        if (is_error(status)) return status;
    }
    return FMI_OK;
}

static int parameter_is_right(Run *r, const Trial *b, double *trial, int64_t j)
{
    const Target *t = &r->e->targets[j];
    if (initialise(r) != AB_OK || is_error(read_directional(r, b, (fmi_reference)t->a))) return 0;
    const double kept = trial[j], step = 1e-5 * (kept != 0.0 ? fabs(kept) : t->scale);
    int failed = 0;
    for (int side = 1; side >= -1 && !failed; side -= 2) {
        trial[j] = kept + side * step;
        failed = initialise(r) != AB_OK || is_error(read_points(r, b, side > 0 ? b->high : b->low));
    }
    trial[j] = kept;
    return failed || !contradicted(b, step); /* beyond the parameter's range nothing can be compared */
}

/* The model's own start and two points about it, the same in every worker. */
static void lay_points(const Run *r, const Trial *b)
{
    for (int k = 0; k < TRUST_POINTS; k++)
        for (int i = 0; i < b->n; i++) {
            const double away = k == 0 ? 0.0 : share(k * b->n + i);
            b->at[k * b->n + i] = r->x[i] + (k == 2 ? -away : away) * r->nominal[i];
        }
}

int derivatives_are_right(Run *r)
{
    const Problem *p = r->problem;
    const Experiment *e = r->e;
    const double *values = r->values;
    Trial b = {.n = r->n, .size = r->n};
    b.unknown = malloc(sizeof *b.unknown * (size_t)(r->n + e->m + 1));
    for (int i = 0; i < r->n; i++) b.unknown[i] = p->derivative_reference[i];
    for (int64_t o = 0; o < e->m; o++)
        if (e->output_state[o] < 0 && e->output_kind[o] == 0) b.unknown[b.size++] = e->output_reference[o];
    double *trial = calloc((size_t)p->p + 1, sizeof *trial);
    double *memory = calloc((size_t)(TRUST_POINTS * (b.n + 4 * b.size) + 1), sizeof *memory);
    b.at = memory;
    b.base = b.at + TRUST_POINTS * b.n, b.high = b.base + TRUST_POINTS * b.size, b.low = b.high + TRUST_POINTS * b.size;
    b.told = b.low + TRUST_POINTS * b.size;

    int right = 1, known = own_values(r, trial) == AB_OK;
    if (known) {
        lay_points(r, &b);
        r->values = trial;
        known = initialise(r) == AB_OK && !is_error(read_points(r, &b, b.base));
    }
    if (!known) r->values = values; /* the model cannot start from its own values: only refusals are seen */
    for (int64_t j = 0; j < p->p && right; j++) {
        const Target *t = &e->targets[j];
        if (t->kind != TARGET_PARAMETER || acts_apart(p, t)) continue;
        if (known)
            right = parameter_is_right(r, &b, trial, j);
        else
            right = initialise(r) == AB_OK && !is_error(rhs(r, r->t, r->x, r->f)) &&
                    !is_error(directional_column(r, (fmi_reference)t->a, r->column));
    }
    r->values = values;
    free(memory);
    free(trial);
    free(b.unknown);
    return right;
}
