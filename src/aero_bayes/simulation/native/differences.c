/* Where derivatives are missing: initial states by differences of the initialisation, and whole trajectories by internal
 * numerical differentiation (H. G. Bock 1981): the perturbed runs repeat the recorded steps of the base run, so that
 * the adaptivity of the step size adds no noise. Runs with state events cannot repeat the steps; they are done at a
 * hundredth of the tolerance instead. An event that moves over a sample would enter its difference as a jump over the
 * step: a side counts at a sample only where as many events came before it as in the base run. */
#include "engine.h"

static double step_of(const Target *t, double value, double relative)
{
    const double size = fabs(value);
    if (t->kind == TARGET_DELAY) return 0.1 * relative;
    return relative * (size > 0.0 ? size : t->scale);
}

static int touches_start(const Target *t) { return t->kind == TARGET_PARAMETER || t->kind == TARGET_START; }

/* The model's own values of what the columns set, to `trial`; r->x is its own start. Returns an outcome. */
int own_values(Run *r, double *trial)
{
    r->values = NULL;
    int outcome = initialise(r);
    for (int64_t j = 0; j < r->problem->p && !outcome; j++) {
        const Target *t = &r->e->targets[j];
        const fmi_reference reference = (fmi_reference)t->a;
        if (t->kind == TARGET_START) trial[j] = r->x[t->a];
        if (t->kind == TARGET_PARAMETER)
            outcome = outcome_of(r->fmu, r->fmu->get_real(r->fmu->instance, &reference, 1, &trial[j]));
    }
    return outcome;
}

/* Which columns move x(t0)? Found once at the model's own values, so that every worker finds the same. */
static void find_start_columns(Run *r)
{
    Experiment *e = r->e;
    Problem *p = r->problem;
    const double *values = r->values;
    double *trial = calloc((size_t)p->p + 1, sizeof *trial), *base = calloc((size_t)r->n + 1, sizeof *base);
    const int failed = own_values(r, trial) != AB_OK;
    memcpy(base, r->x, sizeof *base * (size_t)r->n);
    r->values = trial;
    for (int64_t j = 0; j < p->p; j++) {
        const Target *t = &e->targets[j];
        if (!touches_start(t)) {
            e->start_matters[j] = 0;
            continue;
        }
        const double kept = trial[j];
        trial[j] += step_of(t, kept, 1e-3);
        e->start_matters[j] = failed || initialise(r) != AB_OK;
        trial[j] = kept;
        for (int i = 0; i < r->n; i++)
            if (!(t->kind == TARGET_START && i == t->a) && r->x[i] != base[i]) e->start_matters[j] = 1;
    }
    r->values = values;
    free(trial);
    free(base);
}

/* dx(t0)/dp of the active columns into r->s0. */
int start_sensitivities(Run *r)
{
    Experiment *e = r->e;
    const int n = r->n, q = r->q;
    if (r->problem->p && e->start_matters[0] < 0) find_start_columns(r);
    memset(r->s0, 0, sizeof *r->s0 * (size_t)(n * q));
    double *trial = NULL;
    const double *values = r->values;
    int outcome = AB_OK;
    for (int j = 0; j < q && !outcome; j++) {
        const int64_t column = r->active[j];
        const Target *t = &e->targets[column];
        if (t->kind == TARGET_START) r->s0[t->a * q + j] = 1.0;
        if (!e->start_matters[column]) continue;
        if (!trial) {
            trial = malloc(sizeof *trial * (size_t)r->problem->p);
            memcpy(trial, values, sizeof *trial * (size_t)r->problem->p);
            r->values = trial;
        }
        const double step = step_of(t, values[column], 6e-6);
        for (int side = 1; side >= -1 && !outcome; side -= 2) {
            trial[column] = values[column] + side * step;
            outcome = initialise(r);
            for (int i = 0; i < n; i++)
                if (!(t->kind == TARGET_START && i == t->a)) r->s0[i * q + j] += side * r->x[i] / (2.0 * step);
        }
        trial[column] = values[column];
    }
    r->values = values;
    free(trial);
    return outcome;
}

static int trajectory(Run *r, double *y)
{
    start_time_limit(r);
    r->sink.trajectory = y;
    sink_begin(r, r->mode, NULL);
    return run_once(r);
}

/* How many more state events than in the base run, with its counts in `before`, came before each sample. */
static void more_events(const Run *r, const int64_t *before, int64_t *more)
{
    int64_t k = 0;
    for (int64_t i = 0; i < r->e->n; i++) {
        while (k < r->n_events && r->event_times[k] <= r->e->time[i]) k++;
        more[i] = k - (before ? before[i] : 0);
    }
}

typedef struct {
    const double *outputs;
    int64_t *events, *high, *low; /* at each sample, and how many more there are on either side */
} Base;

/* Both sides where both can be run, else the one that can. */
static int difference(Run *plain, double *trial, int64_t column, double step, const Base *base, double *up,
                      double *down, int64_t size)
{
    const int64_t each = size / plain->e->n;
    const double value = trial[column];
    trial[column] = value + step;
    const double above = trial[column] - value;
    const int high = trajectory(plain, up);
    more_events(plain, base->events, base->high);
    trial[column] = value - step;
    const double below = value - trial[column];
    const int low = trajectory(plain, down);
    more_events(plain, base->events, base->low);
    trial[column] = value;
    if (high && low) return high;
    for (int64_t i = 0; i < size; i++) {
        const int moved_up = base->high[i / each] != 0, moved_down = base->low[i / each] != 0;
        const int no_up = high || (moved_up && !moved_down && !low), no_down = low || (moved_down && !moved_up && !high);
        const double a = no_up ? base->outputs[i] : up[i], b = no_down ? base->outputs[i] : down[i];
        up[i] = (a - b) / ((no_up ? 0.0 : above) + (no_down ? 0.0 : below));
    }
    return AB_OK;
}

/* Numbers that a run gives for each sample. */
static int64_t width(const Run *r) { return filters(r) ? kalman_width(r->e, r->n, r->mode) : r->e->m; }

/* The filter's predictions with their slopes go where they were asked for as they are. */
static void hand_over(Run *r, const double *base, double *const *slopes)
{
    const int64_t size = r->e->n * width(r);
    memcpy(r->sink.trajectory, base, sizeof *base * (size_t)size);
    for (int64_t i = 0; i < size; i++)
        for (int j = 0; j < r->q; j++) r->sink.sensitivity[i * r->q + j] = slopes[j][i];
    for (int64_t i = 0; r->sink.kept && i < r->e->n; i++)
        for (int64_t o = 0; o < r->e->m; o++) r->sink.kept[o * r->e->n + i] = base[i * width(r) + o];
}

/* The plain runs' outputs are those of laws at them. */
static void feed(Run *r, const double *base, double *const *slopes)
{
    Sink *k = &r->sink;
    const Experiment *e = r->e;
    for (int64_t i = 0; i < e->n; i++) {
        for (int64_t o = 0; o < e->m; o++) {
            k->y[o * BLOCK + k->filled] = base[i * e->m + o];
            double *s = k->s + (o * BLOCK + k->filled) * r->ld;
            for (int j = 0; j < r->q; j++) s[j] = slopes[j][i * e->m + o];
        }
        if (++k->filled == BLOCK) sink_pass_on(r);
    }
    if (k->filled) sink_pass_on(r);
}

/* One run with sensitivities into r's sink, which was begun. */
int run_differences(Run *r)
{
    const Experiment *e = r->e;
    const int64_t size = e->n * width(r);
    Run *plain = run_open(r->problem, r->e, 0, NULL);
    if (plain) plain->mode = filters(r) ? r->mode : MODE_TRAJECTORY;
    double *base = malloc(sizeof *base * (size_t)size), *down = malloc(sizeof *down * (size_t)size);
    const int64_t counts = e->n + 1;
    int64_t *events = calloc((size_t)(3 * counts), sizeof *events);
    const Base known = {base, events, events + counts, events + 2 * counts};
    double **slopes = calloc((size_t)r->q + 1, sizeof *slopes);
    double *trial = malloc(sizeof *trial * (size_t)(r->problem->p + 1));
    const int ready = plain && (!filters(r) || kalman_open(plain));
    int outcome = ready && base && down && events && slopes && trial ? AB_OK : AB_SOLVER_FAILED;
    double relative = 1e-5;
    if (!outcome) {
        memcpy(trial, r->values, sizeof *trial * (size_t)r->problem->p);
        plain->values = trial;
        plain->deadline = r->deadline;
        plain->earliest = r->earliest;
        plain->record = 1;
        outcome = trajectory(plain, base);
        plain->record = 0;
        plain->replay = 1;
        if (!outcome && plain->events_seen) {
            plain->replay = 0;
            plain->rtol *= 0.01;
            plain->atol *= 0.01;
            relative = 1e-4;
            outcome = trajectory(plain, base);
            more_events(plain, NULL, events);
        }
    }
    for (int j = 0; j < r->q && !outcome; j++) {
        const int64_t column = r->active[j];
        slopes[j] = calloc((size_t)size, sizeof **slopes);
        if (!slopes[j]) outcome = AB_SOLVER_FAILED;
        if (outcome || e->targets[column].kind == TARGET_NONE) continue;
        const double step = step_of(&e->targets[column], trial[column], relative);
        outcome = difference(plain, trial, column, step, &known, slopes[j], down, size);
        if (outcome && outcome != AB_TIMED_OUT && plain->replay) {
            plain->replay = 0;
            outcome = difference(plain, trial, column, 10.0 * step, &known, slopes[j], down, size);
            plain->replay = 1;
        }
    }
    if (!outcome) (filters(r) ? hand_over : feed)(r, base, slopes);
    for (int j = 0; slopes && j < r->q; j++) free(slopes[j]);
    free(slopes);
    free(base);
    free(down);
    free(events);
    free(trial);
    run_close(plain);
    return outcome;
}
