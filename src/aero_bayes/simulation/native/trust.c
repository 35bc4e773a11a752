/* Are the FMU's directional derivatives with respect to the targets right? The standard promises those with respect to
 * states and inputs; an FMU may refuse parameters, or answer with zeros (the Modelica Association's VanDerPol does).
 * Before sensitivities are built on them, they are held against differences at a few points about the model's own start.
 * Only what differences show beyond doubt counts: where both sides of a difference agree with each other. */
#include <float.h>

#include "engine.h"

enum { POINTS = 3 };

typedef struct {
    int n, size;              /* states; derivatives and other real outputs */
    fmi_reference *unknown;   /* of both */
    double *at;               /* POINTS x n */
    double *base, *high, *low, *told;
} Probe;

static int read_unknowns(Run *r, const Probe *b, const double *x, double *out)
{
    const int status = rhs(r, r->t, x, out);
    if (is_error(status) || b->size == b->n) return status;
    return r->fmu->get_real(r->fmu->instance, b->unknown + b->n, (size_t)(b->size - b->n), out + b->n);
}

static int read_points(Run *r, const Probe *b, double *out)
{
    for (int k = 0; k < POINTS; k++)
        if (is_error(read_unknowns(r, b, b->at + k * b->n, out + k * b->size))) return FMI_ERROR;
    return FMI_OK;
}

/* Does what the FMU told contradict both sides of the difference? */
static int contradicted(const Probe *b, double step)
{
    for (int i = 0; i < POINTS * b->size; i++) {
        const double above = (b->high[i] - b->base[i]) / step, below = (b->base[i] - b->low[i]) / step;
        const double size = larger(fabs(above), fabs(below));
        const double noise = 1e4 * DBL_EPSILON * fabs(b->base[i]) / step;
        if (!isfinite(size) || !(fabs(above - below) <= 1e-2 * size) || size <= noise) continue;
        if (!(fabs(b->told[i] - above) <= 0.05 * larger(size, fabs(b->told[i])))) return 1;
    }
    return 0;
}

/* What the FMU tells at every point; not OK where it refuses. The model stands at its own values. */
static int read_directional(Run *r, const Probe *b, fmi_reference known)
{
    const double one = 1.0;
    for (int k = 0; k < POINTS; k++) {
        int status = set_point(r, r->t, b->at + k * b->n);
        if (!is_error(status) && b->size)
            status = r->fmu->directional(r->fmu->instance, b->unknown, (size_t)b->size, &known, 1, &one,
                                         b->told + k * b->size);
        if (is_error(status)) return status;
    }
    return FMI_OK;
}

static int parameter_is_right(Run *r, const Probe *b, double *trial, int64_t j)
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

static int input_is_right(Run *r, const Probe *b, const Target *t)
{
    const fmi_reference known = r->u_reference[t->a];
    if (initialise(r) != AB_OK || is_error(read_directional(r, b, known))) return 0;
    const double kept = r->u_now[t->a], step = 1e-5 * larger(fabs(kept), t->scale);
    int failed = 0;
    for (int side = 1; side >= -1 && !failed; side -= 2) {
        const double value = kept + side * step;
        failed = is_error(r->fmu->set_real(r->fmu->instance, &known, 1, &value)) ||
                 is_error(read_points(r, b, side > 0 ? b->high : b->low));
    }
    return failed || !contradicted(b, step);
}

/* The model's own start and two points about it, the same in every worker. */
static void lay_points(const Run *r, const Probe *b)
{
    for (int k = 0; k < POINTS; k++)
        for (int i = 0; i < b->n; i++) {
            const double away = k == 0 ? 0.0 : 0.1 + 0.8 * fmod(0.6180339887498949 * (double)(k * b->n + i + 1), 1.0);
            b->at[k * b->n + i] = r->x[i] + (k == 2 ? -away : away) * r->nominal[i];
        }
}

int derivatives_are_right(Run *r)
{
    const Problem *p = r->problem;
    const Experiment *e = r->e;
    const double *values = r->values;
    Probe b = {.n = r->n, .size = r->n};
    b.unknown = malloc(sizeof *b.unknown * (size_t)(r->n + e->m + 1));
    for (int i = 0; i < r->n; i++) b.unknown[i] = p->derivative_reference[i];
    for (int64_t o = 0; o < e->m; o++)
        if (e->output_state[o] < 0 && e->output_kind[o] == 0) b.unknown[b.size++] = e->output_reference[o];
    double *trial = calloc((size_t)p->p + 1, sizeof *trial);
    double *memory = calloc((size_t)(POINTS * (b.n + 4 * b.size) + 1), sizeof *memory);
    b.at = memory;
    b.base = b.at + POINTS * b.n, b.high = b.base + POINTS * b.size, b.low = b.high + POINTS * b.size;
    b.told = b.low + POINTS * b.size;

    r->values = NULL;
    int right = 1, known = initialise(r) == AB_OK;
    if (known) {
        lay_points(r, &b);
        for (int64_t j = 0; j < p->p; j++) {
            const fmi_reference reference = (fmi_reference)e->targets[j].a;
            if (e->targets[j].kind == TARGET_START) trial[j] = r->x[e->targets[j].a];
            if (e->targets[j].kind == TARGET_PARAMETER)
                known &= !is_error(r->fmu->get_real(r->fmu->instance, &reference, 1, &trial[j]));
        }
        r->values = trial;
        known = known && initialise(r) == AB_OK && !is_error(read_points(r, &b, b.base));
    }
    if (!known) r->values = values; /* the model cannot start from its own values: only refusals are seen */
    for (int64_t j = 0; j < p->p && right; j++) {
        const Target *t = &e->targets[j];
        if (t->kind != TARGET_PARAMETER && t->kind != TARGET_INPUT) continue;
        if (!known) {
            const fmi_reference reference =
                t->kind == TARGET_INPUT ? e->signals[t->a].reference : (fmi_reference)t->a;
            right = initialise(r) == AB_OK && !is_error(rhs(r, r->t, r->x, r->f)) &&
                    !is_error(directional_column(r, reference, r->column));
        } else
            right = t->kind == TARGET_INPUT ? input_is_right(r, &b, t) : parameter_is_right(r, &b, trial, j);
    }
    r->values = values;
    free(memory);
    free(trial);
    free(b.unknown);
    return right;
}
