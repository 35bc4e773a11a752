/* The continuous-discrete extended Kalman filter of a model with process noise, dx = f dt + diag(sigma) dW:
 * A. H. Jazwinski, Stochastic Processes and Filtering Theory (1970), ch. 8. Between two samples mean and covariance take
 * the steps of covariance.c. Readings are taken one output at a time, in Joseph's form. */
#include "engine.h"

#define LOG_2PI 1.8378770664093454836

static double *reals(size_t count) { return calloc(count + 1, sizeof(double)); }

void kalman_close(Kalman *k)
{
    if (!k) return;
    free(k->memory);
    free(k);
}

/* Memory of the filter, kept for all runs of an experiment; 0 where there is none. */
int kalman_open(Run *r)
{
    if (r->kalman) return 1;
    const size_t n = (size_t)r->n, m = (size_t)r->e->m, square = n * n;
    Kalman *k = calloc(1, sizeof *k);
    double *at = k ? reals(16 * square + 5 * n + 2 * m + m * n) : NULL;
    if (!at) {
        free(k);
        return 0;
    }
    k->memory = at;
    double **squares[] = {&k->p, &k->f, &k->phi, &k->q, &k->middle, &k->end, &k->omega,
                          &k->noise, &k->term, &k->work, &k->power, &k->part, &k->spare, &k->drift,
                          &k->last_omega, &k->last_noise};
    for (size_t i = 0; i < sizeof squares / sizeof *squares; i++, at += square) *squares[i] = at;
    double **vectors[] = {&k->rate, &k->x, &k->before, &k->gain, &k->slope};
    for (size_t i = 0; i < sizeof vectors / sizeof *vectors; i++, at += n) *vectors[i] = at;
    k->variance = at, k->y = at + m, k->h = at + 2 * m;
    r->kalman = k;
    return 1;
}

/* Numbers that the filter gives for each sample: predicted outputs and their variances, and for a smoother states,
 * covariance, transition from the sample before, and the slopes of the outputs. */
int64_t kalman_width(const Experiment *e, int n, int mode)
{
    return 2 * e->m + (mode == MODE_FILTER_STATES ? n + 2 * n * n + e->m * n : 0);
}

static void identity(double *a, int n)
{
    memset(a, 0, sizeof *a * (size_t)(n * n));
    for (int i = 0; i < n; i++) a[i * n + i] = 1.0;
}

/* Diffusion, initial covariance and reading noise of this run. */
void kalman_begin(Run *r)
{
    Kalman *k = r->kalman;
    const Problem *problem = r->problem;
    const Experiment *e = r->e;
    const int n = r->n;
    memset(k->p, 0, sizeof *k->p * (size_t)(n * n));
    for (int i = 0; i < n; i++) {
        k->rate[i] = problem->diffusion[i] * problem->diffusion[i];
        k->p[i * n + i] = e->start_sd[i] * e->start_sd[i];
    }
    for (int64_t o = 0; o < e->m; o++) k->variance[o] = e->reading_sd[o] * e->reading_sd[o];
    for (int64_t j = 0; r->values && j < problem->p; j++) {
        const Target *t = &e->targets[j];
        const double square = r->values[j] * r->values[j];
        if (t->kind == TARGET_DIFFUSION) k->rate[t->a] = square;
        if (t->kind == TARGET_READING_NOISE) k->variance[t->a] = square;
    }
    k->log_likelihood = 0.0;
    k->begun = 0;
    k->reach = INFINITY;
    identity(k->f, n);
}

/* Outputs at (r->t, r->x) to k->y and their slopes by the states to the rows of k->h. */
static int outputs(Run *r)
{
    Kalman *k = r->kalman;
    const Experiment *e = r->e;
    const Problem *p = r->problem;
    const int n = r->n;
    int status;
    memset(k->h, 0, sizeof *k->h * (size_t)(e->m * n));
    for (int64_t o = 0; o < e->m; o++)
        if (e->output_state[o] >= 0) {
            k->y[o] = r->x[e->output_state[o]];
            k->h[o * n + e->output_state[o]] = 1.0;
        }
    if (!e->n_other) return FMI_OK;
    if (is_error(status = read_values(r, r->t, r->x, k->y, 1))) return status;
    memcpy(k->x, r->x, sizeof *k->x * (size_t)n);
    for (int j = 0; r->n_other && j < n; j++) {
        double base = 0.0, one = 1.0;
        if (p->has_directional)
            status = r->fmu->directional(r->fmu->instance, r->other_reference, (size_t)r->n_other,
                                         &p->state_reference[j], 1, &one, r->other);
        else {
            k->x[j] += 1.5e-8 * larger(fabs(r->x[j]), r->nominal[j]);
            one = 1.0 / (k->x[j] - r->x[j]);
            status = set_point(r, r->t, k->x);
            if (!is_error(status))
                status = r->fmu->get_real(r->fmu->instance, r->other_reference, (size_t)r->n_other, r->other);
            k->x[j] = r->x[j];
        }
        if (is_error(status)) return status;
        for (int64_t o = 0, next = 0; o < e->m; o++) {
            if (e->output_state[o] >= 0 || e->output_kind[o] != 0) continue;
            if (!p->has_directional) base = k->y[o];
            k->h[o * n + j] = (r->other[next++] - base) * one;
        }
    }
    return FMI_OK;
}

/* One reading of one output; its variance, not positive where the filter has failed. */
static double take(Run *r, int64_t o, double measured, double *predicted)
{
    Kalman *k = r->kalman;
    const int n = r->n;
    const double *h = k->h + o * n, noise = k->variance[o];
    double *p = k->p, *g = k->slope, y = k->y[o], spread = 0.0;
    for (int i = 0; i < n; i++) {
        g[i] = 0.0;
        for (int j = 0; j < n; j++) g[i] += p[i * n + j] * h[j];
        y += h[i] * (r->x[i] - k->before[i]);
    }
    for (int i = 0; i < n; i++) spread += h[i] * g[i];
    const double total = spread + noise;
    *predicted = y;
    if (measured != measured || !(total > 0.0)) return total;
    const double away = measured - y;
    k->log_likelihood -= 0.5 * (away * away / total + log(total) + LOG_2PI);
    for (int i = 0; i < n; i++) k->gain[i] = g[i] / total;
    for (int i = 0; i < n; i++) {
        r->x[i] += k->gain[i] * away;
        for (int j = 0; j < n; j++) p[i * n + j] -= k->gain[i] * g[j];
    }
    for (int i = 0; i < n; i++) { /* p is (1 - K h) P now; times (1 - K h)', plus K noise K' */
        double v = noise * k->gain[i];
        for (int j = 0; j < n; j++) v -= p[i * n + j] * h[j];
        g[i] = v;
    }
    for (int i = 0; i < n; i++)
        for (int j = 0; j < n; j++) p[i * n + j] += g[i] * k->gain[j];
    for (int i = 0; i < n; i++)
        for (int j = 0; j < i; j++) p[i * n + j] = p[j * n + i] = 0.5 * (p[i * n + j] + p[j * n + i]);
    return total;
}

/* Time of the next sample. */
double kalman_next(const Run *r) { return r->sample < r->e->n ? r->e->time[r->sample] : INFINITY; }

/* The sample at r->t: predictions are kept, readings move r->x. Returns an FMI status; *finite tells of the numbers. */
int kalman_read(Run *r, int *finite)
{
    Kalman *k = r->kalman;
    const Experiment *e = r->e;
    const int n = r->n, width = (int)kalman_width(e, n, r->mode);
    const int64_t m = e->m, sample = r->sample++, square = (int64_t)n * n;
    const int status = outputs(r);
    double *to = r->sink.trajectory ? r->sink.trajectory + sample * width : NULL;
    if (is_error(status)) return status;
    memcpy(k->before, r->x, sizeof *r->x * (size_t)n);
    if (r->mode == MODE_FILTER_STATES) {
        double *at = to + 2 * m;
        memcpy(at, r->x, sizeof *at * (size_t)n), at += n;
        memcpy(at, k->p, sizeof *at * (size_t)square), at += square;
        memcpy(at, k->f, sizeof *at * (size_t)square), at += square;
        memcpy(at, k->h, sizeof *at * (size_t)(m * n));
        identity(k->f, n);
    }
    *finite = 1;
    for (int64_t o = 0; o < m; o++) {
        double predicted;
        const double total = take(r, o, e->measured ? e->measured[o * e->n + sample] : NAN, &predicted);
        *finite &= total > 0.0 && isfinite(total) && isfinite(predicted);
        if (to) to[o] = predicted, to[m + o] = total;
        if (r->sink.kept) r->sink.kept[o * e->n + sample] = predicted;
    }
    return FMI_OK;
}
