/* One simulation, from initialisation to the last sample: what happens between two segments, the run with its
 * sensitivities, and how it is begun, so that no result depends on the runs before it. */
#include "engine.h"

enum { NEED_DIFFERENCES = -1 };

/* Does f change with time alone? Looked for at a few times ahead, with the states held; f at r->t is in r->f. */
static int depends_on_time(Run *r, double until, int times)
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
    if (inputs_too && (outcome = outcome_of(r->fmu, inputs_jump(r, r->t)))) return outcome;
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
static int cross_segment_end(Run *r, Segment *g)
{
    int kink, outcome, status;
    const int jump = inputs_pass(r, &kink);
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
    if (jump || kink) inputs_enter(r, r->t);
    if (events) {
        if ((outcome = enter_event(r, jump || kink))) return outcome;
        if (r->nz && is_error(status = indicators(r, r->t, r->x, r->z0))) return outcome_of(r->fmu, status);
    } else if (jump || kink) {
        if (is_error(status = inputs_jump(r, r->t))) return outcome_of(r->fmu, status);
        if (jump && is_error(status = relay_jump(r))) return outcome_of(r->fmu, status);
        g->have_node = 0;
    }
    if (events || jump) {
        g->have_f = g->have_jac = g->have_node = 0;
        g->fresh = 1;
    }
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
        remember_event(r);
    if (shifts && is_error(status = delay_jump(r, &g->have_f))) return outcome_of(r->fmu, status);
    return AB_OK;
}

/* With process noise: samples at r->t move the states, and indicators that change their sign by that are an event. */
static int filter_samples(Run *r, Segment *g)
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
    remember_event(r);
    g->fresh = 1;
    return outcome_of(r->fmu, indicators(r, r->t, r->x, r->z0));
}

/* One run into the sink that was begun. Returns an outcome, or NEED_DIFFERENCES where sensitivities were wanted and an
 * event changed the states or their slope. */
int run_once(Run *r)
{
    int outcome, status;
    const int n = r->n;
    r->taken = r->rejected = 0;
    r->events_seen = 0;
    r->n_events = 0;
    r->at_step = 0;
    if (r->record) r->n_steps = 0;
    r->begins_sensitive = r->q > 0;
    outcome = initialise(r);
    r->begins_sensitive = 0;
    if (outcome) return outcome;
    if (is_error(status = late_begin(r))) return outcome_of(r->fmu, status);
    memset(r->largest, 0, sizeof *r->largest * (size_t)n);
    note_sizes(r);
    exponential_begin(r);
    r->form = form_of(r->problem);
    if (is_error(status = relay_begin(r))) return outcome_of(r->fmu, status);
    r->sensitive = r->q > 0;
    if (r->sensitive) {
        if ((outcome = sensitivity_begin(r))) return outcome;
        if (is_error(status = relay_columns_begin(r))) return outcome_of(r->fmu, status);
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
    double time;
    for (Late *l; (l = late_due(r, INFINITY, &time));)
        if (is_error(status = late_emit_here(r, l, time))) return outcome_of(r->fmu, status);
    if (is_error(status = emit_until(r, 0.0, INFINITY, 1))) return outcome_of(r->fmu, status);
    return outcome_of(r->fmu, sink_flush(r));
}

/* Are the FMU's directional derivatives with respect to every target of the problem right? Tried once. */
static int can_differentiate(Run *r)
{
    Problem *p = r->problem;
    if (fmu_ready(p) != AB_OK || !p->has_directional) return 0;
    for (int64_t i = 0; i < p->n_experiments && p->parameter_directional < 0; i++) {
        Run *other = problem_run(p, i, p->runs_q, p->runs_active);
        if (!other || !derivatives_are_right(other)) p->parameter_directional = 0;
    }
    if (p->parameter_directional < 0) p->parameter_directional = 1;
    return p->parameter_directional;
}

/* One run into the sink, with sensitivities where there are active columns. */
static int simulate(Run *r, int mode, const double *noise)
{
    start_time_limit(r);
    probe(r);
    sink_begin(r, mode, noise);
    if (filters(r) && !kalman_open(r)) return AB_SOLVER_FAILED;
    if (!r->q) return run_once(r);
    if (filters(r)) return run_differences(r);
    int outcome = NEED_DIFFERENCES;
    if (can_differentiate(r)) {
        if ((outcome = start_sensitivities(r))) return outcome;
        sink_begin(r, mode, noise);
        outcome = run_once(r);
    }
    if (outcome != NEED_DIFFERENCES) return outcome;
    sink_begin(r, mode, noise);
    return run_differences(r);
}

/* What puts an FMU back to its start before a run: a reset, or only a new instance? Some FMUs report a reset that they do
 * not do, or keep values in memory that all their instances share. So the first run that differs from the one before it
 * is done twice, after a reset and on a new instance; until then every run has a new one. Equal runs that differ even on
 * new instances are no simulation. */

/* FNV-1a of the parameter vector; never 0. */
static uint64_t hash_values(const Run *r)
{
    uint64_t hash = 14695981039346656037ull;
    const unsigned char *byte = (const unsigned char *)r->values;
    for (size_t i = 0; i < sizeof *r->values * (size_t)r->problem->p; i++) hash = (hash ^ byte[i]) * 1099511628211ull;
    return hash | 1;
}

static int attempt(Run *r, int mode, const double *noise, int begin, double *y)
{
    r->problem->fmu->begin = begin;
    r->sink.kept = y;
    const int outcome = simulate(r, mode, noise);
    r->sink.kept = NULL;
    return outcome;
}

/* To what the solver's tolerance leaves open, of each output's range. */
static int agree(const Run *r, const double *a, const double *b)
{
    const int64_t n = r->e->n;
    for (int64_t o = 0; o < r->e->m; o++, a += n, b += n) {
        double low = INFINITY, high = -INFINITY, away = 0.0;
        for (int64_t i = 0; i < n; i++) {
            low = fmin(low, b[i]), high = fmax(high, b[i]);
            away = larger(away, fabs(a[i] - b[i]));
        }
        const double near = (1e-5 + 10.0 * r->rtol) * (high - low) + 1e-9 * larger(fabs(low), fabs(high));
        if (!(away <= near)) return 0;
    }
    return 1;
}

static int compare(Run *r, int mode, const double *noise)
{
    Fmu *f = r->problem->fmu;
    const int once = r->problem->single_instance;
    double *after = calloc((size_t)(2 * r->e->n * r->e->m + 1), sizeof *after), *anew = after + r->e->n * r->e->m;
    if (!after) return AB_SOLVER_FAILED;
    const int reset = attempt(r, mode, noise, BEGIN_RESET, after);
    int outcome = attempt(r, mode, noise, once ? BEGIN_RESET : BEGIN_NEW, anew);
    if (outcome != AB_OK)
        f->begin = BEGIN_UNKNOWN;
    else if (reset == AB_OK && agree(r, after, anew))
        f->begin = BEGIN_RESET;
    else if (once || attempt(r, mode, noise, BEGIN_NEW, after) != AB_OK || !agree(r, after, anew))
        f->begin = BEGIN_NOTHING;
    free(after);
    return f->begin == BEGIN_NOTHING ? AB_NOT_REPEATABLE : outcome;
}

/* One run into the sink, as simulate, whose result does not depend on the runs before it. */
int run_repeatable(Run *r, int mode, const double *noise)
{
    Problem *p = r->problem;
    if (fmu_load(p)) return AB_MODEL_ERROR;
    if (p->fmu->begin == BEGIN_NOTHING) return AB_NOT_REPEATABLE;
    if (p->fmu->begin != BEGIN_UNKNOWN) return simulate(r, mode, noise);
    const uint64_t hash = hash_values(r);
    if (r->values_hash && r->values_hash != hash) return compare(r, mode, noise);
    const int outcome = simulate(r, mode, noise);
    if (outcome == AB_OK) r->values_hash = hash;
    return outcome;
}
