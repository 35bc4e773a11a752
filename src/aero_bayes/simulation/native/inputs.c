/* Input signals: hold or linear on a grid of their own, each with its delay, constant beyond their ends. */
#include <float.h>

#include "engine.h"

static int by_time(const void *a, const void *b)
{
    const double x = ((const Break *)a)->time, y = ((const Break *)b)->time;
    return (x > y) - (x < y);
}

/* Two times closer than this are one. */
static double resolution(const Run *r)
{
    const Experiment *e = r->e;
    return 16.0 * DBL_EPSILON * fmax(fabs(e->time[0]), fabs(e->time[e->n - 1]));
}

#define SAME 1e-12 /* of the size of a value: what is no jump */

static void enter_cell(Run *r, int i, double at)
{
    const Drive *d = &r->drive[i];
    const int64_t k = r->cell[i];
    r->slope[i] = d->slope[k];
    r->u0[i] = d->value[k] + d->slope[k] * (at - d->time[k]);
}

static double end_of_cell(const Drive *d, int64_t k) { return d->value[k] + d->slope[k] * (d->time[k + 1] - d->time[k]); }

static void add_driven_breaks(Run *r, int i, double from, double to)
{
    const Drive *d = &r->drive[i];
    for (int64_t k = 1; k < d->count; k++) {
        const double t = d->time[k] + r->delay[i], value = d->value[k], before = end_of_cell(d, k - 1);
        if (t <= from || t > to) continue;
        const int jump = fabs(value - before) > SAME * larger(fabs(value), fabs(before));
        int breaks = jump || fabs(d->slope[k] - d->slope[k - 1]) > 1e-9 * (fabs(d->slope[k]) + fabs(d->slope[k - 1]));
        for (int j = 0; d->by[j] && !breaks; j++)
            for (int at = 0; at < 2; at++) breaks |= d->by[j][at * d->room + k] != d->by[j][at * d->room + k - 1];
        if (breaks)
            r->breaks[r->n_breaks++] = (Break){t, jump};
    }
}

/* Value of a signal before r->t, which is entered: another one where it jumps just now. */
double inputs_before(const Run *r, int i)
{
    const Signal *s = &r->e->signals[i];
    const int64_t k = r->cell[i];
    const double *time = is_driven(r, i) ? r->drive[i].time : s->time;
    if (k < 1 || fabs(time[k] + r->delay[i] - r->t) > r->resolution) return r->u0[i];
    return is_driven(r, i) ? end_of_cell(&r->drive[i], k - 1) : s->values[k - 1];
}

/* How fast a signal moves with a column where the FMU stands. */
double input_by(const Run *r, int i, int k)
{
    if (delays(&r->column_target[k], i)) return -r->slope[i];
    const double *row = r->row_of ? r->row_of[i * r->q + k] : NULL;
    if (!row) return 0.0;
    const Drive *d = &r->drive[i];
    const int64_t cell = r->cell[i];
    if (r->exact && has_lines(r, i)) return d->by_now[(row - d->by[0]) / (2 * d->room)];
    return row[cell] + row[d->room + cell] * (r->at - r->delay[i] - d->time[cell]);
}

/* Until inputs_as_lines: what operators make of linear signals at this time is given to the FMU, not lines in its place. */
int inputs_exact(Run *r, double t)
{
    int status = FMI_OK;
    for (int i = 0; r->drive && i < r->e->n_signals && !is_error(status); i++) {
        if (!has_lines(r, i)) continue;
        status = operators_at(r, i, t - r->delay[i], &r->u0[i], &r->slope[i], r->drive[i].by_now);
        r->u0[i] -= r->slope[i] * (t - r->u_time);
        r->exact = r->any_slope = 1;
    }
    return status;
}

/* The FMU is left where it stands. */
int inputs_as_lines(Run *r)
{
    if (!r->exact) return FMI_OK;
    r->exact = r->any_slope = 0;
    for (int i = 0; i < r->e->n_signals; i++) {
        if (has_lines(r, i)) enter_cell(r, i, r->u_time - r->delay[i]);
        r->any_slope |= r->slope[i] != 0.0;
    }
    return inputs_apply(r, r->at);
}

/* Delays of this run. */
void inputs_delay(Run *r)
{
    for (int i = 0; i < r->e->n_signals; i++) {
        r->delay[i] = 0.0;
        for (int64_t j = 0; r->values && j < r->problem->p; j++)
            if (delays(&r->e->targets[j], i)) r->delay[i] += r->values[j];
    }
}

/* The list of breaks of this run; the segment at r->t is entered. */
void inputs_prepare(Run *r)
{
    const Experiment *e = r->e;
    const double tiny = r->resolution = resolution(r), from = e->time[0] + tiny, to = e->time[e->n - 1] + tiny;
    r->t_end = e->time[e->n - 1];
    r->n_breaks = r->next_break = 0;
    r->any_linear = 0;
    int filled = 0;
    for (int i = 0; i < e->n_signals; i++) {
        const Signal *s = &e->signals[i];
        const double *v = s->values;
        r->u_reference[i] = s->reference;
        r->cell[i] = 0;
        r->any_linear |= s->linear || (s->operator >= 0 && r->problem->operators[s->operator].memory == RATE_LIMIT);
        const int64_t before = r->n_breaks;
        if (is_driven(r, i)) add_driven_breaks(r, i, from, to);
        for (int64_t b = 0; b < s->n_breaks && !is_driven(r, i); b++) {
            const int64_t k = s->breaks[b];
            const double t = s->time[k] + r->delay[i];
            if (t <= from || t > to) continue;
            r->breaks[r->n_breaks++] = (Break){t, !s->linear && k > 0 && v[k] != v[k - 1]};
        }
        filled += r->n_breaks > before;
    }
    if (filled > 1) qsort(r->breaks, (size_t)r->n_breaks, sizeof *r->breaks, by_time);
    inputs_enter(r, r->t);
}

/* Passes the breaks up to r->t: do input values jump there, or only their slopes? */
int inputs_pass(Run *r, int *kink)
{
    int jump = 0;
    *kink = 0;
    for (int i = 0; i < r->e->n_signals; i++) r->u_before[i] = r->u0[i] + r->slope[i] * (r->t - r->u_time);
    for (; r->next_break < r->n_breaks && r->breaks[r->next_break].time <= r->t + r->resolution; r->next_break++)
        *(r->breaks[r->next_break].jump ? &jump : kink) = 1;
    return jump;
}

/* Value and slope of every signal from time t on. */
void inputs_enter(Run *r, double t)
{
    const Experiment *e = r->e;
    r->any_slope = 0;
    r->u_time = t;
    for (int i = 0; i < e->n_signals; i++) {
        const Signal *s = &e->signals[i];
        const double *v = s->values, at = t - r->delay[i];
        int64_t k = r->cell[i];
        if (is_driven(r, i)) {
            const Drive *d = &r->drive[i];
            while (k + 1 < d->count && d->time[k + 1] <= at + r->resolution) k++;
            r->cell[i] = k;
            enter_cell(r, i, at);
            r->any_slope |= r->slope[i] != 0.0;
            continue;
        }
        while (k + 1 < s->count && s->time[k + 1] <= at + r->resolution) k++;
        r->cell[i] = k;
        r->u0[i] = v[k];
        r->slope[i] = 0.0;
        if (s->linear && k + 1 < s->count && at >= s->time[0] - r->resolution) {
            r->slope[i] = (v[k + 1] - v[k]) / (s->time[k + 1] - s->time[k]);
            r->u0[i] += r->slope[i] * (at - s->time[k]);
            r->any_slope |= r->slope[i] != 0.0;
        }
    }
}

static double input_at(const Run *r, int i, double t) { return r->u0[i] + r->slope[i] * (t - r->u_time); }

/* Real inputs, which may move at any time. */
int inputs_apply(Run *r, double t)
{
    size_t count = 0;
    for (int i = 0; i < r->e->n_signals; i++) {
        if (r->e->signals[i].kind) continue;
        r->u_real[count] = r->u_reference[i];
        r->u_now[count++] = input_at(r, i, t);
    }
    return count ? r->fmu->set_real(r->fmu->instance, r->u_real, count, r->u_now) : FMI_OK;
}

/* All inputs, at an event or before the start: others than real ones may change there only. */
int inputs_jump(Run *r, double t)
{
    Fmu *f = r->fmu;
    int status = inputs_apply(r, t);
    for (int i = 0; i < r->e->n_signals && !is_error(status); i++) {
        const int kind = r->e->signals[i].kind, whole = (int)lround(input_at(r, i, t));
        if (!kind) continue;
        int (*set)(fmi_component, const fmi_reference *, size_t, const int *) =
            kind == 1 ? f->set_integer : kind == 2 ? f->set_boolean : f->set_long;
        status = set ? set(f->instance, &r->u_reference[i], 1, &whole) : FMI_ERROR;
    }
    return status;
}
