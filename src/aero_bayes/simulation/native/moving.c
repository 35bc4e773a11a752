/* Where a run takes exponential steps (exponential.c), and its samples within them. */
#include "engine.h"

/* Do such steps pay up to `end`? Not where many samples lie before it, or where they failed just now. */
int exponential_may(Run *r, double end)
{
    const Experiment *e = r->e;
    if (r->n == 0 || r->n > MOST_STATES || filters(r) || !moves_at_samples(e)) return 0;
    const int64_t last = r->sample + MOST_INSIDE + 1;
    if (last < e->n && e->time[last] < end - r->resolution) return 0;
    if (!exponential_open(r) || (r->sensitive && !r->exponential->columns)) return 0;
    return exponential_ready(r);
}

/* Samples before `limit`, from the step's own solution at their times. */
int exponential_emit(Run *r, double limit)
{
    const Experiment *e = r->e;
    Exponential *k = r->exponential;
    const int n = r->n;
    memset(r->dense, 0, sizeof *r->dense * (size_t)(5 * n));
    if (r->sensitive) memset(r->sdense, 0, sizeof *r->sdense * (size_t)(5 * n * r->ld));
    while (r->sample < e->n && e->time[r->sample] < limit) {
        const double time = e->time[r->sample], theta = (time - r->t) / k->now->h;
        if (time - r->t <= r->resolution) {
            memcpy(r->dense, k->x0, sizeof *r->dense * (size_t)n);
            if (r->sensitive) memcpy(r->sdense, r->s, sizeof *r->s * (size_t)(n * r->ld));
        } else {
            const Flow *f = flow_inside(r, k->now, theta);
            state_at(r, f, k->v);
            memcpy(r->dense, k->v, sizeof *r->dense * (size_t)n);
            if (r->sensitive) columns_at(r, f, r->sdense);
        }
        const int status = emit_until(r, 0.0, time, 1);
        if (is_error(status)) return status;
    }
    return FMI_OK;
}
