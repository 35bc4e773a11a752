/* What an FMU does that its description does not say, or says wrongly, found at two points about the first run's start:
 * whether its algebraic loops are solved only when the derivatives are asked for, and whether derivatives depend on more
 * states than are declared. */
#include <float.h>

#include "engine.h"

enum { POINTS = 2 };

/* A little away from the start, in time too; no further, where the model's code may not stand it. */
static double probe_point(const Run *r, int k, const double *x0, double *x)
{
    for (int i = 0; i < r->n; i++) {
        const double away = 0.1 + 0.8 * fmod(0.6180339887498949 * (double)(k * r->n + i + 1), 1.0);
        x[i] = x0[i] + (k ? -1e-4 : 1e-4) * away * fmax(fabs(x0[i]), r->nominal[i]);
    }
    return r->t + 1e-4 * (k + 1) * (fmin(r->t_end, r->next_event) - r->t);
}

static int agrees(double a, double b, double size) { return !(fabs(a - b) > 1e-9 * fmax(fmax(fabs(a), fabs(b)), size)); }

static int read_all(Run *r, double *out)
{
    Fmu *f = r->fmu;
    int status = FMI_OK;
    if (r->n_other) status = f->get_real(f->instance, r->other_reference, (size_t)r->n_other, out);
    if (!is_error(status) && r->nz) status = f->get_indicators(f->instance, out + r->n_other, (size_t)r->nz);
    if (!is_error(status) && r->problem->has_directional)
        status = directional_column(r, r->problem->state_reference[0], out + r->n_other + r->nz);
    return status;
}

/* Is anything else once the derivatives have been asked for? */
static int needs_derivatives_first(Run *r, const double *x0, double *x)
{
    const int64_t size = r->n_other + r->nz + (r->problem->has_directional ? r->n : 0);
    if (!size) return 0;
    double *before = malloc(sizeof *before * (size_t)(2 * size)), *after = before + size;
    int differs = 0;
    for (int k = 0; before && k < POINTS; k++) {
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
    p->row = realloc(p->row, sizeof *p->row * (size_t)(n * n));
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
    plain.color = malloc(sizeof *plain.color * (size_t)n);
    plain.column_start = calloc((size_t)n + 1, sizeof *plain.column_start);
    plain.row = NULL;
    use_dense_pattern(&plain);
    double *all = malloc(sizeof *all * (size_t)(n * n));
    const double fine = p->has_directional ? 1e-9 : 1e-4;
    int right = 1;
    for (int k = 0; k < POINTS && right; k++) {
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
    free(plain.color);
    free(plain.column_start);
    free(plain.row);
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
