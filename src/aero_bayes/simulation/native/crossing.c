/* What happens between two segments: jumps and kinks of inputs, time events, state events and step events. */
#include "engine.h"

/* Does f change with time alone? Looked for at a few times ahead, with the states held; f at r->t is in r->f. */
int depends_on_time(Run *r, double until, int times)
{
    static const double ahead[] = {0.0123, 0.618, 1e-4, 0.217, 0.9};
    for (int k = 0; k < times; k++) {
        if (is_error(rhs(r, r->t + ahead[k] * (until - r->t), r->x, r->u))) return 1;
        for (int i = 0; i < r->n; i++)
            if (r->u[i] != r->f[i]) return 1;
    }
    return 0;
}

/* Has the model chosen other state variables (dynamic state selection)? Then a state differs from its own variable. */
static int states_reselected(Run *r, const double *x)
{
    double *value = r->derivatives_unused;
    if (is_error(r->fmu->get_real(r->fmu->instance, r->problem->state_reference, (size_t)r->n, value))) return 0;
    for (int i = 0; i < r->n; i++)
        if (fabs(value[i] - x[i]) > 1e-9 * fmax(fabs(x[i]), r->nominal[i])) return 1;
    return 0;
}

/* Event mode at r->t: new input values, discrete states iterated, new continuous states. They are read whatever the
 * FMU says of them: some report no change after a reinit. */
static int enter_event(Run *r, int inputs_too)
{
    Fmu *f = r->fmu;
    int outcome;
    if ((outcome = outcome_of(r->fmu, f->enter_event(f->instance)))) return outcome;
    if (inputs_too && (outcome = outcome_of(r->fmu, inputs_apply(r, r->t)))) return outcome;
    if ((outcome = outcome_of(r->fmu, event_iterate(r)))) return outcome;
    if ((outcome = outcome_of(r->fmu, f->enter_continuous(f->instance)))) return outcome;
    if (!r->n) return AB_OK;
    if ((outcome = outcome_of(r->fmu, f->get_states(f->instance, r->u, (size_t)r->n)))) return outcome;
    int jumped = r->nominals_changed;
    for (int i = 0; i < r->n; i++) {
        if (!isfinite(r->u[i])) return AB_NOT_FINITE;
        jumped |= r->u[i] != r->x[i];
        r->x[i] = r->u[i];
    }
    if (!jumped) return AB_OK;
    r->events_seen = 1;
    if (filters(r) && !r->nominals_changed) return AB_STATES_JUMP;
    if (r->nominals_changed && (outcome = outcome_of(r->fmu, read_nominals(r)))) return outcome;
    return states_reselected(r, r->x) ? AB_STATES_ANEW : AB_OK;
}

static int delay_column(const Run *r)
{
    for (int k = 0; k < r->q; k++)
        if (r->column_target[k].kind == TARGET_DELAY) return 1;
    return 0;
}

/* Is the slope the same before (r->f1) and after (r->f) a state event? Then S has no jump there, however the event moves
 * with the parameters. */
static int slope_is_kept(const Run *r)
{
    const double span = r->t_end - r->e->time[0];
    for (int i = 0; i < r->n; i++) {
        const double size = larger(larger(fabs(r->f[i]), fabs(r->f1[i])), r->nominal[i] / span);
        if (!(fabs(r->f[i] - r->f1[i]) <= 1e-6 * size)) return 0;
    }
    return 1;
}

/* What happens at the end of a segment: jumps and kinks of inputs, time and state events. */
int cross_segment_end(Run *r, Segment *g)
{
    int jump = 0, kink = 0, outcome, status;
    while (r->next_break < r->n_breaks && r->breaks[r->next_break].time <= r->t + r->resolution) {
        if (r->breaks[r->next_break].jump)
            jump = 1;
        else
            kink = 1;
        r->next_break++;
    }
    const int timed = r->next_event <= r->t + r->resolution;
    const int events = timed || g->event || (jump && !r->fmu->eventless);
    const int shifts = jump && r->sensitive && delay_column(r);
    const int idle = g->asked && !jump && !timed && r->n;
    const int watch = (r->sensitive && (timed || g->event)) || idle;
    const int look = (timed || g->event) && r->n && !r->time_dependent;
    if (shifts || watch) {
        if (is_error(status = rhs(r, r->t, r->x, r->f1))) return outcome_of(r->fmu, status);
    } else if (events && is_error(status = set_point(r, r->t, r->x)))
        return outcome_of(r->fmu, status);
    memcpy(r->u_before, r->u0, sizeof *r->u0 * (size_t)r->e->n_signals);
    if (jump || kink) inputs_enter(r, r->t);
    if (events) {
        if ((outcome = enter_event(r, jump || kink))) return outcome;
        if (r->nz && is_error(status = indicators(r, r->t, r->x, r->z0))) return outcome_of(r->fmu, status);
    } else if (jump || kink) {
        if (is_error(status = inputs_apply(r, r->t))) return outcome_of(r->fmu, status);
        g->have_node = 0;
    }
    if (events || jump) {
        g->have_f = g->have_jac = g->have_node = 0;
        g->fresh = 1;
    }
    if (r->sensitive && (jump || kink)) sensitivity_activate(r, r->t);
    if (shifts || watch || look) {
        if (is_error(status = rhs(r, r->t, r->x, r->f))) return outcome_of(r->fmu, status);
        g->have_f = 1;
    }
    if (look) {
        r->time_dependent = depends_on_time(r, fmin(r->t_end, r->next_event), 2);
        g->have_f = 0; /* the FMU stands elsewhere now */
    }
    int changed = r->events_seen;
    if (r->sensitive && g->event && !g->asked)
        changed |= jump || timed || (r->n && !slope_is_kept(r));
    else
        for (int i = 0; watch && i < r->n; i++) changed |= r->f[i] != r->f1[i];
    if (watch && r->sensitive && (r->events_seen || ((!jump || g->event) && changed))) return NEED_DIFFERENCES;
    g->idle = idle && !changed;
    if (g->idle)
        g->fresh = 0; /* nothing happened: the step size still fits */
    else if (g->event && !r->sensitive)
        r->events_seen = 1; /* the time of a state event moves with the parameters: its step cannot be repeated */
    if (shifts && is_error(status = delay_jump(r, &g->have_f))) return outcome_of(r->fmu, status);
    return AB_OK;
}

/* With process noise: samples at r->t move the states, and indicators that change their sign by that are an event. */
int filter_samples(Run *r, Segment *g)
{
    int outcome, status, finite;
    while (kalman_next(r) <= r->t + r->resolution) {
        if (is_error(status = kalman_read(r, &finite))) return outcome_of(r->fmu, status);
        if (!finite) return AB_NOT_FINITE;
        g->have_f = g->have_jac = g->have_node = 0;
    }
    if (!r->nz) return AB_OK;
    memcpy(r->z1, r->z0, sizeof *r->z0 * (size_t)r->nz);
    if (is_error(status = indicators(r, r->t, r->x, r->z0))) return outcome_of(r->fmu, status);
    if (!crossed(r->z1, r->z0, r->nz)) return AB_OK;
    if ((outcome = enter_event(r, 0))) return outcome;
    r->events_seen = g->fresh = 1;
    return outcome_of(r->fmu, indicators(r, r->t, r->x, r->z0));
}
