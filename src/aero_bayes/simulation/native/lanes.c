/* Several runs at a time: every round takes one step in each lane. What differs from lane to lane (segments between jumps
 * of the inputs, error control, samples) goes by each lane's own Run, as in run.c and step.c; the arithmetic of the step
 * is in lanes.inc. Models with events, algebraic loops or step callbacks are run one by one. */
#include "lanes.h"

/* Whether all that the experiment asks for is in the lane functions. Where inputs move at each sample or nearly so, the
 * exponential steps of a single run are cheaper. */
static int covers(const Problem *p, const LaneTable *model, const Experiment *e)
{
    if (may_be_exponential(p, e)) return 0;
    for (int64_t o = 0; o < e->m; o++) {
        const unsigned at = (unsigned)e->output_reference[o] - model->first_output;
        if (e->output_state[o] < 0 && (e->output_kind[o] != 0 || at >= (unsigned)model->ny)) return 0;
    }
    for (int i = 0; i < e->n_signals; i++)
        if ((unsigned)e->signals[i].reference - model->first_input >= (unsigned)model->nu) return 0;
    return 1;
}

/* AERO_BAYES_LANES=0 in the environment lets runs go one by one, for comparison. */
static const LaneTable *table_of(Problem *p, ab_lanes_constants_function **constants)
{
    ab_lanes_function *tables;
    const char *asked = getenv("AERO_BAYES_LANES");
    if (asked && !strcmp(asked, "0")) return NULL;
    if (p->version == 3 || !p->n || p->nz || p->step_callback || p->diffusion || fmu_load(p)) return NULL;
    if (fmu_symbol(p->fmu, "ab_lanes", &tables) || fmu_symbol(p->fmu, "ab_lanes_constants", constants)) return NULL;
    const LaneTable *model = tables(has_wide() ? AB_AVX2 : AB_BASELINE);
    if (!model || model->version != AB_LANES_VERSION || model->lanes != WIDE || model->nx != p->n) return NULL;
    for (int64_t e = 0; e < p->n_experiments; e++)
        if (!covers(p, model, &p->experiments[e])) return NULL;
    return model;
}

#define REALS(count) take(a, (size_t)(count) * WIDE, sizeof(double))
#define INTEGERS(count) take(a, (size_t)(count), sizeof(int))

static void lay_out(Lanes *s, Arena *a)
{
    const int n = s->n, nk = s->model->constants + 1, nu = s->nu + 1;
    s->k = REALS(nk), s->u = REALS(nu), s->u0 = REALS(nu), s->slope = REALS(nu), s->u_time = REALS(1);
    s->time = REALS(1), s->h = REALS(1), s->over_h = REALS(1), s->later = REALS(1), s->error = REALS(1), s->growth = REALS(1);
    s->norm = REALS(2), s->accepted = take(a, WIDE, sizeof(int64_t));
    s->x = REALS(n), s->x1 = REALS(n), s->f = REALS(n), s->ft = REALS(n), s->point = REALS(n), s->value = REALS(n);
    s->largest = REALS(n), s->nominal = REALS(n), s->inverse = REALS(n);
    s->jac = REALS(n * n), s->lu = REALS(n * n), s->stage = REALS(STAGES * n), s->dense = REALS(5 * n);
    s->output_u = REALS(nu), s->output_x = REALS(n), s->output = REALS(s->model->ny);
    s->pivot = INTEGERS(n * WIDE), s->there = take(a, (size_t)(n * n), 1);
    s->lower_start = INTEGERS(n + 1), s->upper_start = INTEGERS(n + 1);
    s->lower = INTEGERS(n * n), s->upper = INTEGERS(n * n);
    s->constant = take(a, (size_t)nk + (size_t)nu, sizeof(double));
    s->input_reference = take(a, (size_t)nu, sizeof(fmi_reference));
    for (int l = 0; l < WIDE; l++) s->lane[l].constants = REALS(nk);
}

/* Where the factors without exchanges have entries: those of df/dx, and what elimination fills in. */
static void find_pattern(Lanes *s)
{
    const Problem *p = s->problem;
    const int n = s->n;
    char *there = s->there;
    for (int j = 0; j < n; j++) there[j * n + j] = 1;
    for (int j = 0; j < n; j++)
        for (int k = p->column_start[j]; k < p->column_start[j + 1]; k++) there[p->row[k] * n + j] = 1;
    for (int j = 0; j < n; j++)
        for (int i = j + 1; i < n; i++)
            for (int k = j + 1; there[i * n + j] && k < n; k++) there[i * n + k] |= there[j * n + k];
    int lower = 0, upper = 0;
    for (int i = 0; i < n; i++) {
        s->lower_start[i] = lower, s->upper_start[i] = upper;
        for (int j = 0; j < i; j++)
            if (there[i * n + j]) s->lower[lower++] = j;
        for (int j = i + 1; j < n; j++)
            if (there[i * n + j]) s->upper[upper++] = j;
    }
    s->lower_start[n] = lower, s->upper_start[n] = upper;
}

void lanes_close(Lanes *s)
{
    if (!s) return;
    for (int l = 0; l < WIDE; l++) {
        for (int64_t e = 0; s->lane[l].buffers && e < s->problem->n_experiments; e++) run_close(s->lane[l].buffers[e]);
        free(s->lane[l].buffers);
    }
    free(s->memory);
    free(s);
}

static Lanes *lanes_open(Problem *p)
{
    ab_lanes_constants_function *constants;
    const LaneTable *model = table_of(p, &constants);
    Lanes *s = model ? calloc(1, sizeof *s) : NULL;
    if (!s) return NULL;
    *s = (Lanes){.problem = p, .model = model, .constants = constants, .n = p->n, .nu = model->nu};
    for (int half = 0; half < 2; half++) s->kernels[half] = lane_kernels_for(half);
    s->moves = model->time_varying;
    for (int64_t e = 0; e < p->n_experiments; e++)
        for (int i = 0; i < p->experiments[e].n_signals; i++) s->moves |= p->experiments[e].signals[i].linear;
    Arena arena = {NULL, 0};
    lay_out(s, &arena);
    int failed = posix_memalign(&s->memory, 64, arena.used + 64) != 0;
    if (!failed) {
        memset(s->memory, 0, arena.used + 64);
        arena = (Arena){s->memory, 0};
        lay_out(s, &arena);
        find_pattern(s);
    }
    for (int l = 0; l < WIDE; l++) {
        Lane *lane = &s->lane[l];
        *lane = (Lane){.all = s, .at = l, .stale = 1, .constants = lane->constants};
        lane->buffers = calloc((size_t)p->n_experiments + 1, sizeof(Run *));
        failed |= !lane->buffers;
    }
    for (int i = 0; !failed && i < s->nu; i++) s->input_reference[i] = (fmi_reference)(model->first_input + (unsigned)i);
    if (failed) {
        lanes_close(s);
        return NULL;
    }
    p->fmu->begin = BEGIN_RESET; /* these FMUs are our own: a reset does as much as a new instance */
    return s;
}

/* The lanes of a problem, or NULL where its runs go one by one. */
Lanes *lanes_of(Problem *p)
{
    if (!p->lanes_sought) p->lanes = lanes_open(p);
    p->lanes_sought = 1;
    return p->lanes;
}

/* The buffers of a lane's run of an experiment; NULL without memory. */
Run *lane_buffers(Lanes *s, int lane, int64_t experiment)
{
    Run **r = &s->lane[lane].buffers[experiment];
    if (!*r) *r = run_open(s->problem, &s->problem->experiments[experiment], 0, &experiment);
    return *r;
}

static void put_column(double *to, int lane, const double *from, int count)
{
    for (int i = 0; i < count; i++) to[i * WIDE + lane] = from[i];
}

/* Input values of the lane's present segment. */
static void put_inputs(Lanes *s, int lane)
{
    const Run *r = s->lane[lane].run;
    for (int i = 0; i < r->e->n_signals; i++) {
        const int64_t at = (int64_t)(r->u_reference[i] - (fmi_reference)s->model->first_input) * WIDE + lane;
        s->u[at] = s->u0[at] = r->u0[i];
        s->slope[at] = r->slope[i];
    }
    s->u_time[lane] = r->u_time;
}

/* A run begins in a lane: it is initialised by FMI's functions. Returns an outcome; the lane is idle if it is not OK. */
int lane_begin(Lanes *s, int at, Run *r, int mode, const double *noise)
{
    Lane *lane = &s->lane[at];
    const int n = s->n;
    int outcome;
    start_time_limit(r);
    sink_begin(r, mode, noise);
    r->taken = r->rejected = 0;
    r->status = FMI_OK;
    if ((outcome = initialise(r))) return outcome;
    if ((outcome = outcome_of(r->fmu, s->constants(r->fmu->instance,
                                                   s->constant))))
        return outcome;
    put_column(s->k, at, s->constant, s->model->constants);
    for (int64_t i = 0; r->e->n_other && i < s->model->constants; i++)
        for (int l = 0; l < WIDE; l++) lane->constants[i * WIDE + l] = s->constant[i];
    if (s->nu && (outcome = outcome_of(r->fmu, r->fmu->get_real(r->fmu->instance, s->input_reference, (size_t)s->nu,
                                                                  s->constant))))
        return outcome;
    put_column(s->u, at, s->constant, s->nu);
    put_column(s->u0, at, s->constant, s->nu);
    for (int i = 0; i < s->nu; i++) s->slope[i * WIDE + at] = 0.0;
    put_column(s->x, at, r->x, n);
    put_column(s->nominal, at, r->nominal, n);
    for (int i = 0; i < n; i++) s->largest[i * WIDE + at] = fabs(r->x[i]);
    r->lane = lane;
    lane->run = r;
    lane->segment = (Segment){.fresh = 1};
    lane->inside = lane->ended = lane->stale = 0;
    put_inputs(s, at);
    return AB_OK;
}

static void end_lane(Lane *lane, int outcome)
{
    lane->ended = 1;
    lane->outcome = outcome;
    lane->stale = outcome != AB_OK;
}

/* The last sample; nothing is left of the run. */
static void finish(Lanes *s, Lane *lane)
{
    Run *r = lane->run;
    memset(r->dense, 0, sizeof *r->dense * (size_t)(5 * s->n));
    for (int i = 0; i < s->n; i++) r->dense[i] = s->x[i * WIDE + lane->at];
    const int status = emit_until(r, 0.0, INFINITY, 1);
    if (!is_error(status)) sink_flush(r);
    end_lane(lane, outcome_of(r->fmu, status));
}

/* Jumps and kinks of the inputs at the end of a segment, as cross_segment_end. */
static int cross(Lanes *s, Lane *lane)
{
    Run *r = lane->run;
    int kink;
    const int jump = inputs_pass(r, &kink);
    if (jump || kink) {
        inputs_enter(r, r->t);
        put_inputs(s, lane->at);
    }
    lane->segment.fresh |= jump;
    const int outcome = exceeds_limits(r);
    r->taken++;
    return outcome;
}

/* Brings a lane to where its next step begins, or to the end of its run. */
static void enter_segment(Lanes *s, Lane *lane)
{
    Run *r = lane->run;
    int outcome;
    while (!lane->ended) {
        if (!lane->inside) {
            if (!(r->t_end - r->t > r->resolution)) {
                finish(s, lane);
                return;
            }
            double end = r->t_end;
            if (r->next_break < r->n_breaks) end = fmin(end, r->breaks[r->next_break].time);
            if (r->t_end - end <= r->resolution) end = r->t_end;
            lane->segment.begin = r->t;
            lane->segment.end = end;
            lane->inside = 1;
        }
        if (lane->segment.end - r->t > r->resolution) {
            if ((outcome = exceeds_limits(r))) end_lane(lane, outcome);
            return;
        }
        lane->inside = 0;
        if ((outcome = cross(s, lane))) end_lane(lane, outcome);
    }
}

/* Size of the lane's next step. */
static void choose_size(Lanes *s, Lane *lane)
{
    const Run *r = lane->run;
    Segment *g = &lane->segment;
    const double left = g->end - r->t;
    if (g->fresh) g->h = first_step_of(s->norm[lane->at], s->norm[WIDE + lane->at], left);
    g->fresh = 0;
    double h = g->h;
    lane->last = h >= left * (1.0 - 1e-9);
    if (!lane->last && 2.0 * h > left) h = h > 0.95 * left ? left : 0.5 * left;
    lane->last |= h >= left;
    s->h[lane->at] = lane->last ? left : h;
}

static int has_samples(const Lanes *s, const Lane *lane)
{
    const Run *r = lane->run;
    return r->sample < r->e->n && r->e->time[r->sample] < r->t + s->h[lane->at];
}

/* Samples of an accepted step, and the size of the next one. */
static void advance_lane(Lanes *s, Lane *lane)
{
    Run *r = lane->run;
    Segment *g = &lane->segment;
    const int n = s->n;
    const double h = s->h[lane->at], t1 = lane->last ? g->end : r->t + h;
    if (has_samples(s, lane)) {
        for (int64_t o = 0; o < r->e->m; o++) {
            const int state = r->e->output_state[o];
            for (int j = 0; state >= 0 && j < 5; j++) r->dense[j * n + state] = s->dense[(j * n + state) * WIDE + lane->at];
        }
        for (int i = 0; r->e->n_other && i < 5 * n; i++) r->dense[i] = s->dense[i * WIDE + lane->at];
        const int status = emit_until(r, h, lane->last ? g->end - r->resolution : t1, 0);
        if (is_error(status)) end_lane(lane, outcome_of(r->fmu, status));
    }
    g->h = h * s->growth[lane->at];
    r->taken++;
    r->t = t1;
}

/* An idle lane takes the numbers of a busy one, so that nothing in it costs time. */
static void copy_lane(Lanes *s, int to, int from)
{
    double *const part[] = {s->k, s->u, s->u0, s->slope, s->u_time, s->x, s->largest, s->nominal};
    const int count[] = {s->model->constants, s->nu, s->nu, s->nu, 1, s->n, s->n, s->n};
    for (int a = 0; a < 8; a++)
        for (int i = 0; i < count[a]; i++) part[a][i * WIDE + to] = part[a][i * WIDE + from];
    s->lane[to].stale = 0;
}

/* One step in every busy lane; `ended` of lanes whose run came to its end. */
void lanes_advance(Lanes *s)
{
    int busy = -1, fresh = 0, dense = 0;
    for (int l = 0; l < WIDE; l++) {
        Lane *lane = &s->lane[l];
        if (!lane->run || lane->ended) continue;
        enter_segment(s, lane);
        if (lane->ended) continue;
        busy = l;
        fresh |= lane->segment.fresh;
        s->time[l] = lane->run->t;
    }
    if (busy < 0) return;
    const LaneKernels *kernels = s->kernels[busy < WIDE / 2];
    for (int l = 0; l < kernels->lanes; l++) {
        const Lane *lane = &s->lane[l];
        if (lane->run && !lane->ended) continue;
        if (lane->stale) copy_lane(s, l, busy);
        s->time[l] = s->time[busy];
    }
    if (s->moves) kernels->inputs(s, s->time);
    s->model->derivatives(kernels->lanes, s->k, s->time, s->u, s->x, s->f);
    s->model->jacobian(kernels->lanes, s->k, s->time, s->u, s->x, s->jac);
    if (fresh) kernels->slope_sizes(s);
    for (int l = 0; l < WIDE; l++)
        if (s->lane[l].run && !s->lane[l].ended) choose_size(s, &s->lane[l]);
    for (int l = 0; l < WIDE; l++)
        if (!s->lane[l].run || s->lane[l].ended) s->h[l] = s->h[busy];
    kernels->step(s);
    for (int l = 0; l < WIDE; l++) {
        Lane *lane = &s->lane[l];
        s->accepted[l] = 0;
        if (!lane->run || lane->ended) continue;
        Run *r = lane->run;
        if (s->error[l] <= 1.0) {
            s->accepted[l] = -1;
            dense |= has_samples(s, lane);
            continue;
        }
        const int outcome = reject_step(r, &lane->segment, s->h[l], s->error[l]);
        if (outcome) end_lane(lane, outcome);
    }
    if (dense) kernels->dense(s);
    for (int l = 0; l < WIDE; l++)
        if (s->accepted[l]) advance_lane(s, &s->lane[l]);
    kernels->accept(s);
}

/* Values of the outputs that are no states, as read_values of sink.c. */
int lane_values(Run *r, double t, const double *x, double *y, int64_t stride)
{
    const Lane *lane = r->lane;
    Lanes *s = lane->all;
    const Experiment *e = r->e;
    for (int i = 0; i < s->n; i++)
        for (int l = 0; l < WIDE; l++) s->output_x[i * WIDE + l] = x[i];
    for (int i = 0; i < s->nu; i++)
        for (int l = 0; l < WIDE; l++) {
            const int64_t at = (int64_t)i * WIDE + lane->at;
            s->output_u[i * WIDE + l] = s->u0[at] + s->slope[at] * (t - s->u_time[lane->at]);
        }
    for (int l = 0; l < WIDE; l++) s->later[l] = t;
    s->model->outputs(WIDE / 2, lane->constants, s->later, s->output_u, s->output_x, s->output);
    for (int64_t o = 0; o < e->m; o++)
        if (e->output_state[o] < 0)
            y[o * stride] = s->output[(int64_t)((unsigned)e->output_reference[o] - s->model->first_output) * WIDE];
    return FMI_OK;
}
