/* One simulation, from initialisation to the last sample. */
#include <float.h>
#include <time.h>

#include "engine.h"

static int64_t read_clock(clockid_t id)
{
    struct timespec t;
    clock_gettime(id, &t);
    return (int64_t)t.tv_sec * 1000000000 + t.tv_nsec;
}

int64_t now_ns(void) { return read_clock(CLOCK_MONOTONIC); }

int64_t process_ns(void) { return read_clock(CLOCK_PROCESS_CPUTIME_ID); }

int64_t thread_ns(void) { return read_clock(CLOCK_THREAD_CPUTIME_ID); }

/* Hands out parts of one block, each on a 64-byte line; the first pass (base NULL) only measures. */
typedef struct {
    char *base;
    size_t used;
} Pool;

static void *part(Pool *p, size_t count, size_t size)
{
    const size_t at = p->used;
    p->used += (count * size + 127) / 64 * 64;
    return p->base ? p->base + at : NULL;
}

#define REALS(count) part(p, (size_t)(count), sizeof(double))
#define PART(type, count) part(p, (size_t)(count), sizeof(type))

static void lay_out(Run *r, Pool *p)
{
    const Problem *problem = r->problem;
    const Experiment *e = r->e;
    const size_t n = (size_t)r->n, nz = (size_t)r->nz, m = (size_t)e->m, ld = (size_t)r->ld, q = (size_t)r->q;
    const size_t inputs = (size_t)e->n_signals, columns = (size_t)problem->p;
    size_t grid = 0;
    for (size_t i = 0; i < inputs; i++) grid += (size_t)e->signals[i].count;
    r->x = REALS(n), r->x1 = REALS(n), r->f = REALS(n), r->f1 = REALS(n), r->ft = REALS(n), r->u = REALS(n);
    r->r = REALS(n), r->settled = REALS(n), r->nominal = REALS(n), r->seen = REALS(n), r->column = REALS(n);
    r->jac = REALS(n * n), r->lu = REALS(n * n), r->k = REALS(8 * n), r->dense = REALS(5 * n);
    r->pivot = PART(int, n);
    r->factors.start = PART(int, 2 * n + 1), r->factors.col = PART(int, n * n);
    r->factors.val = REALS(n * n), r->factors.diagonal = REALS(n);
    r->seed = REALS(n + inputs + 1);
    r->seed_reference = PART(fmi_reference, n + inputs + 1);
    const size_t starts = (size_t)problem->n_fixed + (size_t)e->n_start + columns + 1;
    r->start_value = REALS(starts);
    r->start_reference = PART(fmi_reference, starts);
    r->z0 = REALS(nz), r->z1 = REALS(nz), r->z2 = REALS(nz), r->z_try = REALS(nz);
    r->signal_values = PART(double *, inputs);
    r->signal_store = REALS(grid);
    r->cell = PART(int64_t, inputs);
    r->u0 = REALS(inputs), r->slope = REALS(inputs), r->u_now = REALS(inputs);
    r->delay = REALS(inputs), r->u_before = REALS(inputs);
    r->u_reference = PART(fmi_reference, inputs);
    r->breaks = PART(Break, e->n_breaks);
    r->column_target = PART(Target, q);
    r->order = PART(int, q);
    r->column_from = REALS(q);
    r->s0 = REALS(n * q);
    if (q) {
        r->s = REALS(n * ld), r->s1 = REALS(n * ld), r->su = REALS(n * ld), r->g_dot = REALS(n * ld);
        r->s_seen = REALS(ld);
        r->sv = REALS(8 * n * ld), r->sdense = REALS(5 * n * ld);
        r->a_node = REALS(4 * n * n), r->b_node = REALS(4 * n * ld), r->b_now = REALS(n * ld);
        r->a_packed = REALS(4 * n * n);
        r->a_now.start = PART(int, n + 1), r->a_now.col = PART(int, n * n), r->a_now.val = REALS(n * n);
    }
    r->other = REALS(m), r->fraction = REALS(BLOCK);
    r->piece_y = REALS(PIECE_POINTS * m), r->piece_s = REALS(PIECE_POINTS * m * ld);
    r->other_reference = PART(fmi_reference, m);
    Sink *k = &r->sink;
    k->y = REALS(m * BLOCK);
    k->s = REALS(m * BLOCK * ld);
    k->filter = PART(Filter, m);
    k->filter_mean = REALS(m * ld);
    k->gradient = REALS(ld), k->hessian = REALS(ld * ld);
    k->residual = REALS(BLOCK), k->gain = REALS(BLOCK), k->decay = REALS(BLOCK), k->weight = REALS(BLOCK);
}

Run *run_open(Problem *problem, Experiment *e, int q, const int64_t *active)
{
    Run *r = calloc(1, sizeof *r);
    if (!r) return NULL;
    r->problem = problem;
    r->e = e;
    r->n = problem->n;
    r->nz = problem->nz;
    r->q = q;
    r->ld = (q + 3) / 4 * 4;
    r->rtol = problem->rtol;
    r->atol = problem->atol;
    int64_t *columns = malloc(sizeof *columns * (size_t)(q + 1));
    Pool pool = {NULL, 0};
    lay_out(r, &pool);
    void *memory = NULL;
    if (!columns || posix_memalign(&memory, 64, pool.used + 64)) {
        free(columns);
        free(r);
        return NULL;
    }
    memset(memory, 0, pool.used + 64);
    if (q) memcpy(columns, active, sizeof *columns * (size_t)q);
    r->active = columns;
    r->memory = memory;
    pool = (Pool){memory, 0};
    lay_out(r, &pool);
    for (int64_t o = 0; o < e->m; o++)
        if (e->output_state[o] < 0 && e->output_kind[o] == 0) r->other_reference[r->others++] = e->output_reference[o];
    return r;
}

void run_close(Run *r)
{
    if (!r) return;
    kalman_close(r->kalman);
    free((void *)r->active);
    free(r->steps);
    free(r->memory);
    free(r);
}

static int outcome_of(Run *r, int status)
{
    if (status == FMI_FATAL) fmu_discard(r->fmu);
    return worse(status) ? AB_MODEL_ERROR : AB_OK;
}

/* Does f change with time alone? Looked for at a few times ahead, with the states held; f at r->t is in r->f. */
static int depends_on_time(Run *r, double until, int times)
{
    static const double ahead[] = {0.0123, 0.618, 1e-4, 0.217, 0.9};
    for (int k = 0; k < times; k++) {
        if (worse(rhs(r, r->t + ahead[k] * (until - r->t), r->x, r->u))) return 1;
        for (int i = 0; i < r->n; i++)
            if (r->u[i] != r->f[i]) return 1;
    }
    return 0;
}

/* The largest that each state has been so far. */
static void look_at_size(Run *r)
{
    for (int i = 0; i < r->n; i++) r->seen[i] = larger(r->seen[i], fabs(r->x[i]));
}

static void remember_step(Run *r, double fraction)
{
    if (!r->record) return;
    if (r->n_steps == r->cap_steps) {
        r->cap_steps = 2 * r->cap_steps + 256;
        r->steps = realloc(r->steps, sizeof *r->steps * (size_t)r->cap_steps);
    }
    r->steps[r->n_steps++] = fraction;
}

/* Do the states still bear the values of their own variables? Not where the model has selected others. */
static int selected_anew(Run *r, const double *x)
{
    double *value = r->settled;
    if (worse(r->fmu->get_real(r->fmu->instance, r->problem->state_reference, (size_t)r->n, value))) return 0;
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
    if ((outcome = outcome_of(r, f->enter_event(f->instance)))) return outcome;
    if (inputs_too && (outcome = outcome_of(r, inputs_apply(r, r->t)))) return outcome;
    if ((outcome = outcome_of(r, event_iterate(r)))) return outcome;
    if ((outcome = outcome_of(r, f->enter_continuous(f->instance)))) return outcome;
    if (!r->n) return AB_OK;
    if ((outcome = outcome_of(r, f->get_states(f->instance, r->u, (size_t)r->n)))) return outcome;
    int jumped = r->nominals_changed;
    for (int i = 0; i < r->n; i++) {
        if (!isfinite(r->u[i])) return AB_NOT_FINITE;
        jumped |= r->u[i] != r->x[i];
        r->x[i] = r->u[i];
    }
    if (!jumped) return AB_OK;
    r->events_seen = 1;
    if (filters(r) && !r->nominals_changed) return AB_STATES_JUMP;
    if (r->nominals_changed && (outcome = outcome_of(r, read_nominals(r)))) return outcome;
    return selected_anew(r, r->x) ? AB_STATES_ANEW : AB_OK;
}

typedef struct {
    double end;        /* of the segment */
    double begin;
    double h;          /* size of the next step */
    int fresh;         /* no step size is known */
    int have_f, have_jac, have_node;
    int event;         /* a state or step event ended the segment early */
    int asked;         /* a step event: the FMU asked for it after a step */
    int idle;          /* and nothing came of it */
} Segment;

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
        if (worse(status = rhs(r, r->t, r->x, r->f))) return status;
        g->have_f = 1;
        g->have_jac = g->have_node = 0;
    }
    if (!g->have_jac) {
        if (worse(status = jacobian(r, r->t, r->x, r->f, r->jac))) return status;
        g->have_jac = 1;
    }
    if (r->q && r->alive && !g->have_node) {
        if (worse(status = set_point(r, r->t, r->x))) return status;
        if (worse(status = sensitivity_node(r, 0, r->t, r->x, r->jac))) return status;
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
static int smaller(Run *r, Segment *g, double h, double error)
{
    r->rejected++;
    if (error == error) {
        g->h = h * fmax(0.15, 0.9 * pow(error, -0.2));
    } else
        g->h = 0.2 * h;
    if (g->h > 16.0 * DBL_EPSILON * fmax(fabs(r->t), 1e-30)) return AB_OK;
    return error == error || r->status == FMI_DISCARD ? AB_SOLVER_FAILED : AB_NOT_FINITE;
}

static int stuck(Run *r)
{
    if (r->taken + r->rejected > r->problem->max_steps) return AB_SOLVER_FAILED;
    if ((r->taken + r->rejected) % 32 == 0 && thread_ns() > r->deadline) return AB_TIMED_OUT;
    return AB_OK;
}


/* Takes steps up to the segment's end or to an event. */
static int integrate_segment(Run *r, Segment *g)
{
    Fmu *f = r->fmu;
    const int n = r->n;
    int outcome, status;
    while (!g->event && g->end - r->t > r->resolution) {
        if ((outcome = stuck(r))) return outcome;
        if (n && worse(status = evaluate_start(r, g))) return outcome_of(r, status);
        const double left = g->end - r->t;
        if (g->fresh) {
            g->h = n ? first_step(r, left) : left;
            g->fresh = 0;
        }
        double h = g->h;
        if (r->replay) h = r->at_step < r->n_steps ? r->steps[r->at_step] * (g->end - g->begin) : left;
        int last = h >= left * (1.0 - 1e-9);
        if (!r->replay && !last && 2.0 * h > left) h = h > 0.95 * left ? left : 0.5 * left;
        if (r->replay && r->at_step + 1 < r->n_steps && r->steps[r->at_step + 1] < 0.0) last = 1;
        last |= h >= left;
        if (last) h = left;
        double error = 0.0;
        if (n) {
            if (r->time_dependent && worse(r->status = time_derivative(r, h))) {
                if (r->status != FMI_DISCARD) return outcome_of(r, r->status);
                if ((outcome = smaller(r, g, h, NAN))) return outcome;
                continue;
            }
            error = rodas_step(r, h, r->time_dependent ? r->ft : NULL);
            if (r->status == FMI_ERROR || r->status == FMI_FATAL) return outcome_of(r, r->status);
            if (!(error <= 1.0) && !(r->replay && error < INFINITY)) {
                if (r->replay) return AB_SOLVER_FAILED;
                if ((outcome = smaller(r, g, h, error))) return outcome;
                continue;
            }
            rodas_dense(r);
        }
        const double t1 = last ? g->end : r->t + h;
        double root = 2.0;
        if (r->nz) {
            root = find_event(r, h);
            if (worse(r->status)) {
                if (r->status != FMI_DISCARD) return outcome_of(r, r->status);
                if ((outcome = smaller(r, g, h, NAN))) return outcome;
                continue;
            }
        }
        int have_f1 = 0;
        if (r->q && r->alive && n) {
            if (worse(status = rhs(r, t1, r->x1, r->f1))) return outcome_of(r, status);
            double *jac = r->a_node + 3 * n * n;
            if (worse(status = jacobian(r, t1, r->x1, r->f1, jac))) return outcome_of(r, status);
            if (!r->problem->has_directional && worse(status = set_point(r, t1, r->x1))) return outcome_of(r, status);
            if (worse(status = sensitivity_node(r, 3, t1, r->x1, jac))) return outcome_of(r, status);
            const double s_error = sensitivity_step(r, h, root);
            if (worse(r->status) && r->status != FMI_DISCARD) return outcome_of(r, r->status);
            if (!(s_error <= 1.0)) {
                if ((outcome = smaller(r, g, h, s_error))) return outcome;
                continue;
            }
            error = fmax(error, s_error);
            swap(&r->s, &r->s1);
            have_f1 = root > 1.0;
        }
        for (int i = 0; i < n && root <= 1.0; i++)
            kernels->horner(r->dense + i, n, method->dense, &root, 1, r->x1 + i);
        const double reached = root <= 1.0 ? r->t + root * h : t1;
        const double limit = root <= 1.0 ? reached : last ? g->end - r->resolution : t1;
        if (!n) memset(r->dense, 0, sizeof *r->dense);
        status = filters(r) ? kalman_step(r, h, fmin(root, 1.0)) : emit_until(r, h, limit, 0);
        if (worse(status)) return outcome_of(r, status);
        if (!r->replay) {
            const double growth = error > 0.0 ? 0.9 * pow(error, -0.2) : 8.0;
            g->h = h * fmin(8.0, fmax(0.2, growth));
        }
        remember_step(r, h / (g->end - g->begin));
        r->at_step++;
        r->taken++;
        r->t = reached;
        swap(&r->x, &r->x1);
        look_at_size(r);
        g->have_f = g->have_jac = g->have_node = 0;
        if (have_f1) {
            swap(&r->f, &r->f1);
            memcpy(r->jac, r->a_node + 3 * n * n, sizeof *r->jac * (size_t)(n * n));
            memcpy(r->a_node, r->a_node + 3 * n * n, sizeof *r->jac * (size_t)(n * n));
            memcpy(r->b_node, r->b_node + 3 * n * r->ld, sizeof *r->jac * (size_t)(n * r->ld));
            g->have_f = g->have_jac = g->have_node = 1;
        }
        if (filters(r) && n) { /* the filter was there */
            swap(&r->f, &r->f1);
            memcpy(r->jac, r->kalman->end, sizeof *r->jac * (size_t)(n * n));
            g->have_f = g->have_jac = 1;
        }
        g->event = root <= 1.0;
        if (r->nz) memcpy(r->z0, r->z1, sizeof *r->z0 * (size_t)r->nz);
        if (r->problem->step_callback) {
            int event = 0, stop = 0;
            if (worse(status = set_point(r, r->t, r->x))) return outcome_of(r, status);
            if (worse(status = f->completed(f->instance, 1, &event, &stop))) return outcome_of(r, status);
            if (stop) return AB_MODEL_ERROR;
            g->asked = event && !g->event;
            g->event |= event;
        } else if (g->event && worse(status = set_point(r, r->t, r->x)))
            return outcome_of(r, status);
    }
    return AB_OK;
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
static int cross(Run *r, Segment *g)
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
    const int shifts = jump && r->sensitive && delay_column(r);
    const int idle = g->asked && !jump && !timed && r->n;
    const int watch = (r->sensitive && (timed || g->event)) || idle;
    const int look = (timed || g->event) && r->n && !r->time_dependent;
    if (shifts || watch) {
        if (worse(status = rhs(r, r->t, r->x, r->f1))) return outcome_of(r, status);
    } else if ((jump || timed || g->event) && worse(status = set_point(r, r->t, r->x)))
        return outcome_of(r, status);
    memcpy(r->u_before, r->u0, sizeof *r->u0 * (size_t)r->e->n_signals);
    if (jump || kink) inputs_enter(r, r->t);
    if (jump || timed || g->event) {
        if ((outcome = enter_event(r, jump || kink))) return outcome;
        if (r->nz && worse(status = indicators(r, r->t, r->x, r->z0))) return outcome_of(r, status);
        g->have_f = g->have_jac = g->have_node = 0;
        g->fresh = 1;
    } else if (kink) {
        if (worse(status = inputs_apply(r, r->t))) return outcome_of(r, status);
        g->have_node = 0;
    }
    if (r->sensitive && (jump || kink)) sensitivity_enter(r, r->t);
    if (shifts || watch || look) {
        if (worse(status = rhs(r, r->t, r->x, r->f))) return outcome_of(r, status);
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
    if (shifts && worse(status = delay_jump(r, &g->have_f))) return outcome_of(r, status);
    return AB_OK;
}

/* Samples at r->t move the states; indicators that change their sign by that are an event. */
static int read_samples(Run *r, Segment *g)
{
    int outcome, status, finite;
    while (kalman_next(r) <= r->t + r->resolution) {
        if (worse(status = kalman_read(r, &finite))) return outcome_of(r, status);
        if (!finite) return AB_NOT_FINITE;
        g->have_f = g->have_jac = g->have_node = 0;
    }
    if (!r->nz) return AB_OK;
    if (worse(status = indicators(r, r->t, r->x, r->z1))) return outcome_of(r, status);
    swap(&r->z0, &r->z1);
    if (!crossed(r->z0, r->z1, r->nz)) return AB_OK;
    if ((outcome = enter_event(r, 0))) return outcome;
    r->events_seen = g->fresh = 1;
    return outcome_of(r, indicators(r, r->t, r->x, r->z0));
}

/* One run into the sink that was begun. Returns an outcome, or NEED_DIFFERENCES where sensitivities were wanted and an
 * event changed the states or their slope. */
int run_once(Run *r)
{
    int outcome, status;
    const int n = r->n;
    r->taken = r->rejected = r->evaluations = 0;
    r->events_seen = 0;
    r->at_step = 0;
    if (r->record) r->n_steps = 0;
    if ((outcome = fmu_begin(r))) return outcome;
    memset(r->seen, 0, sizeof *r->seen * (size_t)n);
    look_at_size(r);
    r->sensitive = r->q > 0;
    if (r->sensitive) {
        if ((outcome = sensitivity_begin(r))) return outcome;
        memset(r->sdense, 0, sizeof *r->sdense * (size_t)(5 * n * r->ld));
    }
    r->time_dependent = r->any_linear;
    if (n && !r->any_linear)
        r->time_dependent = worse(rhs(r, r->t, r->x, r->f)) || depends_on_time(r, r->t_end, 5);
    if (r->nz && worse(status = indicators(r, r->t, r->x, r->z0))) return outcome_of(r, status);
    Segment g = {.fresh = 1};
    if (r->next_event <= r->t + r->resolution) {
        g.end = r->t;
        if ((outcome = cross(r, &g))) return outcome;
    }
    if (filters(r)) {
        kalman_begin(r);
        if ((outcome = read_samples(r, &g))) return outcome;
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
        if ((outcome = cross(r, &g))) return outcome;
        if (filters(r) && (outcome = read_samples(r, &g))) return outcome;
        if (!g.idle) {
            remember_step(r, -1.0);
            if (r->replay && r->at_step < r->n_steps && r->steps[r->at_step] < 0.0) r->at_step++;
        }
        if ((outcome = stuck(r))) return outcome;
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
    if (worse(status = emit_until(r, 0.0, INFINITY, 1))) return outcome_of(r, status);
    sink_flush(r);
    return AB_OK;
}
