/* The steps of one segment, with error control: exponential steps where the input moves at each sample, elsewhere a
 * Rosenbrock step, its sensitivities, and a search for state events. */
#include <float.h>

#include "engine.h"

/* The largest that each state has been so far. */
void note_sizes(Run *r)
{
    for (int i = 0; i < r->n; i++) r->largest[i] = larger(r->largest[i], fabs(r->x[i]));
}

/* In place of the fraction of a segment: a step of the linearisation over all that was left of it. */
#define LINEARISED 2.0
/* The same for an exponential step, with what it tells of itself added. */
#define EXPONENTIAL 4.0

void remember_step(Run *r, double fraction)
{
    if (!r->record) return;
    if (r->n_steps == r->cap_steps) {
        r->cap_steps = 2 * r->cap_steps + 256;
        r->steps = realloc(r->steps, sizeof *r->steps * (size_t)r->cap_steps);
    }
    r->steps[r->n_steps++] = fraction;
}

static void swap(double **a, double **b)
{
    double *c = *a;
    *a = *b;
    *b = c;
}

/* f, its Jacobian and its time derivative at the start of a step. */
static int evaluate_start(Run *r, Segment *g)
{
    int status;
    if (!g->have_f) {
        if (is_error(status = rhs(r, r->t, r->x, r->f))) return status;
        g->have_f = 1;
        g->have_jac = g->have_node = 0;
    }
    if (!g->have_jac) {
        if (is_error(status = jacobian(r, r->t, r->x, r->f, r->jac))) return status;
        g->have_jac = 1;
    }
    if (r->sensitive && !g->have_node) {
        if (is_error(status = set_point(r, r->t, r->x))) return status;
        if (is_error(status = sensitivity_node(r, 0, r->t, r->x, r->jac))) return status;
        g->have_node = 1;
    }
    return FMI_OK;
}

static int time_derivative(Run *r, double h)
{
    const double later = r->t + fmax(1e-6 * h, 64.0 * DBL_EPSILON * fabs(r->t)), dt = later - r->t;
    const int status = rhs(r, later, r->x, r->ft);
    for (int i = 0; i < r->n; i++) r->ft[i] = (r->ft[i] - r->f[i]) / dt;
    return status;
}

/* A rejected step: smaller, or the outcome where it cannot become smaller. */
static int reject_step(Run *r, Segment *g, double h, double error)
{
    r->rejected++;
    g->h = h * (error < INFINITY ? fmax(0.15, 0.9 * pow(error, -0.2)) : 0.2);
    if (g->h > 16.0 * DBL_EPSILON * fmax(fabs(r->t), 1e-30)) return AB_OK;
    return error < INFINITY || r->status == FMI_DISCARD ? AB_SOLVER_FAILED : AB_NOT_FINITE;
}

int exceeds_limits(Run *r)
{
    if (r->taken + r->rejected > r->problem->max_steps) return AB_SOLVER_FAILED;
    if (r->e->most_steps && r->taken + r->rejected > r->e->most_steps) return AB_TOO_SLOW;
    if ((r->taken + r->rejected) % 32) return AB_OK;
    /* The thread's own clock is a system call, as long as several steps; the other is not. */
    if (now_ns() > r->earliest && thread_ns() > r->deadline) return AB_TIMED_OUT;
    return AB_OK;
}

/* What follows each step that was taken: the FMU is told where it asks for it. */
static int complete_step(Run *r, Segment *g)
{
    Fmu *f = r->fmu;
    int status;
    if (r->nz) memcpy(r->z0, r->z1, sizeof *r->z0 * (size_t)r->nz);
    if (r->problem->step_callback) {
        int event = 0, stop = 0;
        if (is_error(status = set_point(r, r->t, r->x))) return outcome_of(r->fmu, status);
        if (is_error(status = f->completed(f->instance, 1, &event, &stop))) return outcome_of(r->fmu, status);
        if (stop) return AB_MODEL_ERROR;
        g->asked = event && !g->event;
        g->event |= event;
    } else if (g->event && is_error(status = set_point(r, r->t, r->x)))
        return outcome_of(r->fmu, status);
    return AB_OK;
}

/* Do such steps pay up to `end`? Not where many samples lie before it, or where they failed just now. */
static int exponential_may(Run *r, double end)
{
    const Experiment *e = r->e;
    if (r->n == 0 || filters(r) || !may_be_exponential(r->problem, e)) return 0;
    const int64_t last = r->sample + MOST_INSIDE + 1;
    if (moves_at_samples(e) && last < e->n && e->time[last] < end - r->resolution) return 0;
    if (!exponential_open(r) || (r->sensitive && !r->exponential->columns)) return 0;
    exponential_ready(r);
    return 1;
}

/* How far a step may go that is to end at `end`: where inputs rest, to the next sample. */
static double reach_of(const Run *r, double end)
{
    const Experiment *e = r->e;
    if (moves_at_samples(e)) return end - r->t;
    int64_t next = r->sample;
    while (next < e->n && e->time[next] <= r->t + r->resolution) next++;
    return next < e->n && e->time[next] < end - r->resolution ? e->time[next] - r->t : end - r->t;
}

/* The step's own solution at a time, to the beginning of r->dense and r->sdense. */
static void solution_at(Run *r, double time)
{
    const Exponential *k = r->exponential;
    const size_t size = sizeof *r->dense * (size_t)r->n;
    if (time - r->t <= r->resolution) {
        memcpy(r->dense, k->x0, size);
        if (r->sensitive) memcpy(r->sdense, r->s, size * (size_t)r->ld);
        return;
    }
    const Flow *f = flow_inside(r, k->now, (time - r->t) / k->now->h);
    state_at(r, f, k->v);
    memcpy(r->dense, k->v, size);
    if (r->sensitive) columns_at(r, f, r->sdense);
}

/* Samples before `limit`. */
static int exponential_emit(Run *r, double limit)
{
    const Experiment *e = r->e;
    const int n = r->n;
    int status = FMI_OK;
    double at;
    memset(r->dense, 0, sizeof *r->dense * (size_t)(5 * n));
    if (r->sensitive) memset(r->sdense, 0, sizeof *r->sdense * (size_t)(5 * n * r->ld));
    for (Late *l; !is_error(status) && (l = late_due(r, limit, &at));) {
        solution_at(r, at);
        status = late_emit_here(r, l, at);
    }
    while (!is_error(status) && r->sample < e->n && e->time[r->sample] < limit) {
        const double time = e->time[r->sample];
        solution_at(r, time);
        status = emit_until(r, 0.0, time, 1);
    }
    return status;
}

/* Where inputs rest, a segment counts no more steps than the other method would take: others are limited by a multiple. */
enum { AFTER_JUMP = 20 };

/* Exponential steps over the segment, as far as they are good enough. */
static int exponential_segment(Run *r, Segment *g)
{
    int status, outcome = AB_OK, steps = 0;
    if (!r->replay && !exponential_may(r, g->end)) return AB_OK;
    if (r->exponential) r->exponential->carried = 0;
    while (!outcome && !g->event && g->end - r->t > r->resolution) {
        double recorded = -1.0, left = reach_of(r, g->end);
        if (r->replay) {
            if (r->at_step < r->n_steps) recorded = r->steps[r->at_step] - EXPONENTIAL;
            if (recorded < 0.0 || !exponential_open(r)) return AB_OK;
            left = r->at_step + 1 < r->n_steps ? r->steps[r->at_step + 1] * (g->end - g->begin) : 0.0;
        }
        if (!g->have_f && is_error(status = rhs(r, r->t, r->x, r->f))) return outcome_of(r->fmu, status);
        double h = exponential_step(r, g->end - g->begin, left, &recorded);
        g->have_jac = g->have_node = 0; /* the FMU stands elsewhere */
        g->have_f = h > 0.0 && r->form == LINEAR_FORM;
        g->fresh = 1;
        if (is_error(r->status)) return outcome_of(r->fmu, r->status);
        if (!(h > 0.0)) return r->replay ? AB_SOLVER_FAILED : AB_OK;
        const int last = r->t + h >= g->end - r->resolution;
        status = exponential_emit(r, (last ? g->end : r->t + h) - r->resolution);
        if (is_error(status)) return outcome_of(r->fmu, status);
        remember_step(r, EXPONENTIAL + recorded);
        remember_step(r, h / (g->end - g->begin));
        r->at_step += 2;
        r->taken += moves_at_samples(r->e) || steps++ < AFTER_JUMP;
        r->t = last ? g->end : r->t + h;
        swap(&r->x, &r->x1);
        if (r->sensitive) swap(&r->s, &r->s1);
        note_sizes(r);
        outcome = complete_step(r, g);
    }
    return outcome;
}

/* Takes steps up to the segment's end or to an event. */
int integrate_segment(Run *r, Segment *g)
{
    const int n = r->n;
    int outcome, status;
    if ((outcome = exponential_segment(r, g))) return outcome;
    while (!g->event && g->end - r->t > r->resolution) {
        if ((outcome = exceeds_limits(r))) return outcome;
        if (n && is_error(status = evaluate_start(r, g))) return outcome_of(r->fmu, status);
        const double left = g->end - r->t;
        if (g->fresh) {
            g->h = n ? first_step(r, left) : left;
            g->fresh = 0;
        }
        double h = g->h;
        const double recorded = r->replay && r->at_step < r->n_steps ? r->steps[r->at_step] : -1.0;
        if (r->replay) h = recorded > 0.0 ? fmin(recorded, 1.0) * (g->end - g->begin) : left;
        int last = h >= left * (1.0 - 1e-9);
        if (!r->replay && !last && 2.0 * h > left) h = h > 0.95 * left ? left : 0.5 * left;
        if (r->replay && r->at_step + 1 < r->n_steps && r->steps[r->at_step + 1] < 0.0) last = 1;
        last |= h >= left;
        if (last) h = left;
        double error = 0.0;
        int linearised = filters(r) && last && n && !r->time_dependent && (!r->replay || recorded > 1.0);
        if (linearised) {
            linearised = kalman_linearised(r, h, r->replay);
            if (is_error(r->status)) return outcome_of(r->fmu, r->status);
            if (linearised && r->nz) linearised = find_event(r, h) > 1.0 && !is_error(r->status);
        }
        if (n && !linearised) {
            if (r->time_dependent && is_error(r->status = time_derivative(r, h))) {
                if (r->status != FMI_DISCARD) return outcome_of(r->fmu, r->status);
                if ((outcome = reject_step(r, g, h, NAN))) return outcome;
                continue;
            }
            error = rodas_step(r, h, r->time_dependent ? r->ft : NULL);
            if (r->status == FMI_ERROR || r->status == FMI_FATAL) return outcome_of(r->fmu, r->status);
            if (!(error <= 1.0) && !(r->replay && error < INFINITY)) {
                if (r->replay) return AB_SOLVER_FAILED;
                if ((outcome = reject_step(r, g, h, error))) return outcome;
                continue;
            }
            continuous_extension(r->dense, n, r->x, r->x1, r->k, n);
        }
        const double t1 = last ? g->end : r->t + h;
        double root = 2.0;
        if (r->nz && !linearised) {
            root = find_event(r, h);
            if (is_error(r->status)) {
                if (r->status != FMI_DISCARD) return outcome_of(r->fmu, r->status);
                if ((outcome = reject_step(r, g, h, NAN))) return outcome;
                continue;
            }
        }
        int have_f1 = 0;
        if (r->sensitive && n) {
            if (is_error(status = rhs(r, t1, r->x1, r->f1))) return outcome_of(r->fmu, status);
            double *jac = r->a_node + 3 * n * n;
            if (is_error(status = jacobian(r, t1, r->x1, r->f1, jac))) return outcome_of(r->fmu, status);
            if (!r->problem->has_directional && is_error(status = set_point(r, t1, r->x1))) return outcome_of(r->fmu, status);
            if (is_error(status = sensitivity_node(r, 3, t1, r->x1, jac))) return outcome_of(r->fmu, status);
            const double s_error = sensitivity_step(r, h, root);
            if (is_error(r->status) && r->status != FMI_DISCARD) return outcome_of(r->fmu, r->status);
            if (!(s_error <= 1.0)) {
                if ((outcome = reject_step(r, g, h, s_error))) return outcome;
                continue;
            }
            error = fmax(error, s_error);
            swap(&r->s, &r->s1);
            have_f1 = root > 1.0;
        }
        for (int i = 0; i < n && root <= 1.0; i++)
            kernel_horner(r->dense + i, n, &root, 1, r->x1 + i);
        const double reached = root <= 1.0 ? r->t + root * h : t1;
        const double limit = root <= 1.0 ? reached : last ? g->end - r->resolution : t1;
        if (!n) memset(r->dense, 0, sizeof *r->dense);
        late_emit(r, h, limit);
        if (linearised)
            kalman_advance(r, h);
        else if (is_error(status = filters(r) ? kalman_step(r, h, fmin(root, 1.0)) : emit_until(r, h, limit, 0)))
            return outcome_of(r->fmu, status);
        if (!r->replay && !linearised) g->h = h * (error > 0.0 ? fmin(8.0, fmax(0.2, 0.9 * pow(error, -0.2))) : 8.0);
        remember_step(r, linearised ? LINEARISED : h / (g->end - g->begin));
        r->at_step++;
        r->taken++;
        r->t = reached;
        swap(&r->x, &r->x1);
        note_sizes(r);
        g->have_f = g->have_jac = g->have_node = 0;
        if (root <= 1.0 && r->relay != RELAY_FREE) {
            if (is_error(status = relay_turn(r))) return outcome_of(r->fmu, status);
            if (!r->sensitive) remember_event(r);
            g->fresh = 1;
            if (!moves_at_samples(r->e) && (outcome = exponential_segment(r, g))) return outcome;
            continue;
        }
        if (have_f1) {
            swap(&r->f, &r->f1);
            memcpy(r->jac, r->a_node + 3 * n * n, sizeof *r->jac * (size_t)(n * n));
            memcpy(r->a_node, r->a_node + 3 * n * n, sizeof *r->jac * (size_t)(n * n));
            memcpy(r->b_node, r->b_node + 3 * n * r->ld, sizeof *r->jac * (size_t)(n * r->ld));
            g->have_f = g->have_jac = g->have_node = 1;
        }
        if (filters(r) && n && !linearised) { /* the filter was there */
            swap(&r->f, &r->f1);
            memcpy(r->jac, r->kalman->end, sizeof *r->jac * (size_t)(n * n));
            g->have_f = g->have_jac = 1;
        }
        g->event = root <= 1.0;
        if ((outcome = complete_step(r, g))) return outcome;
    }
    return AB_OK;
}
