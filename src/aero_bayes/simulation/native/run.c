/* One simulation, from initialisation to the last sample. */

#include "engine.h"

/* One run into the sink that was begun. Returns an outcome, or NEED_DIFFERENCES where sensitivities were wanted and an
 * event changed the states or their slope. */
int run_once(Run *r)
{
    int outcome, status;
    const int n = r->n;
    r->taken = r->rejected = 0;
    r->events_seen = 0;
    r->at_step = 0;
    if (r->record) r->n_steps = 0;
    if ((outcome = initialise(r))) return outcome;
    memset(r->largest, 0, sizeof *r->largest * (size_t)n);
    note_sizes(r);
    exponential_begin(r);
    r->sensitive = r->q > 0;
    if (r->sensitive) {
        if ((outcome = sensitivity_begin(r))) return outcome;
        memset(r->sdense, 0, sizeof *r->sdense * (size_t)(5 * n * r->ld));
    }
    r->time_dependent = r->any_linear;
    if (n && !r->any_linear)
        r->time_dependent = is_error(rhs(r, r->t, r->x, r->f)) || depends_on_time(r, r->t_end, 5);
    if (r->nz && is_error(status = indicators(r, r->t, r->x, r->z0))) return outcome_of(r->fmu, status);
    Segment g = {.fresh = 1};
    if (r->next_event <= r->t + r->resolution) {
        g.end = r->t;
        if ((outcome = cross_segment_end(r, &g))) return outcome;
    }
    if (filters(r)) {
        kalman_begin(r);
        if ((outcome = filter_samples(r, &g))) return outcome;
    }
    while (r->t_end - r->t > r->resolution) {
        if (!g.idle) g.begin = r->t;
        g.end = r->t_end;
        g.event = g.idle = 0;
        if (r->next_break < r->n_breaks) g.end = fmin(g.end, r->breaks[r->next_break].time);
        if (r->next_event < g.end) g.end = r->next_event;
        if (filters(r)) g.end = fmin(g.end, kalman_next(r));
        if (r->t_end - g.end <= r->resolution) g.end = r->t_end;
        if ((outcome = integrate_segment(r, &g))) return outcome;
        if ((outcome = cross_segment_end(r, &g))) return outcome;
        if (filters(r) && (outcome = filter_samples(r, &g))) return outcome;
        if (!g.idle) {
            remember_step(r, -1.0);
            if (r->replay && r->at_step < r->n_steps && r->steps[r->at_step] < 0.0) r->at_step++;
        }
        if ((outcome = exceeds_limits(r))) return outcome;
        r->taken++;
    }
    if (filters(r)) return AB_OK;
    if (n) {
        memset(r->dense, 0, sizeof *r->dense * (size_t)(5 * n));
        memcpy(r->dense, r->x, sizeof *r->dense * (size_t)n);
        if (r->sensitive) {
            memset(r->sdense, 0, sizeof *r->sdense * (size_t)(5 * n * r->ld));
            memcpy(r->sdense, r->s, sizeof *r->sdense * (size_t)(n * r->ld));
        }
    }
    if (is_error(status = emit_until(r, 0.0, INFINITY, 1))) return outcome_of(r->fmu, status);
    sink_flush(r);
    return AB_OK;
}
