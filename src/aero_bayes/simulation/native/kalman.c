/* The continuous-discrete extended Kalman filter of a model with process noise, dx = f dt + diag(sigma) dW:
 * A. H. Jazwinski, Stochastic Processes and Filtering Theory (1970), ch. 8. Between two samples the mean takes the
 * steps of step.c, or that of the model's linearisation, which is cheaper and exact for a linear model: between two close
 * readings its error is mostly within the tolerance. Readings are taken one output at a time, in Joseph's form. */
#include "engine.h"

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
    double *at = k ? calloc(16 * square + 5 * n + 2 * m + m * n + 1, sizeof *at) : NULL;
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
static double take_reading(Run *r, int64_t o, double measured, double *predicted)
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
        const double total = take_reading(r, o, e->measured ? e->measured[o * e->n + sample] : NAN, &predicted);
        *finite &= total > 0.0 && isfinite(total) && isfinite(predicted);
        if (to) to[o] = predicted, to[m + o] = total;
        if (r->sink.kept) r->sink.kept[o * e->n + sample] = predicted;
    }
    return FMI_OK;
}

#define ENOUGH 1e-13 /* the exponential series ends with a term that is at most so large beside the first */

/* a p a' into the symmetric p, with `work` and `turned` between */
static void sandwich(double *restrict p, const double *restrict a, double *restrict work, double *restrict turned, int n)
{
    for (int i = 0; i < n; i++)
        for (int j = 0; j < n; j++) turned[j * n + i] = a[i * n + j];
    kernel_product(work, a, p, n);
    kernel_product(p, work, turned, n);
    for (int i = 0; i < n; i++)
        for (int j = 0; j < i; j++) p[j * n + i] = p[i * n + j];
}

/* The exponents of one step: k->omega of the transition, k->noise of the diffusion, from the Jacobians `begin`,
 * k->middle and k->end. */
static void exponents(Kalman *k, const double *begin, double h, int n)
{
    const double *middle = k->middle, *end = k->end;
    int changes = 0;
    memset(k->noise, 0, sizeof *k->noise * (size_t)(n * n));
    for (int i = 0; i < n * n; i++) {
        changes |= begin[i] != end[i];
        k->omega[i] = h / 6.0 * (begin[i] + 4.0 * middle[i] + end[i]);
    }
    for (int i = 0; i < n; i++) k->noise[i * n + i] = h * k->rate[i];
    if (!changes) return;
    const double w = h * h / 12.0;
    kernel_product(k->work, begin, end, n);
    kernel_product(k->term, end, begin, n);
    for (int i = 0; i < n; i++)
        for (int j = 0; j < n; j++) {
            k->omega[i * n + j] -= w * (k->work[i * n + j] - k->term[i * n + j]);
            const double v = w * (begin[i * n + j] - end[i * n + j]) * k->rate[j];
            k->noise[i * n + j] -= v;
            k->noise[j * n + i] -= v;
        }
}

static double largest(const double *a, int n)
{
    double size = 0.0;
    for (int i = 0; i < n * n; i++) size = larger(size, fabs(a[i]));
    return size;
}

/* Are these the exponents of the last step, up to the rounding of its length? Then so is the transition. */
static int same(double *last, const double *now, int n)
{
    const double near = 1e-12 * largest(now, n);
    int equal = 1;
    for (int i = 0; i < n * n; i++) equal &= fabs(last[i] - now[i]) <= near;
    if (!equal) memcpy(last, now, sizeof *last * (size_t)(n * n));
    return equal;
}

/* k->phi = exp(omega), k->drift = int_0^1 exp(omega s) ds and k->q = int_0^1 exp(omega s) noise exp(omega' s) ds: series
 * over a part of the interval that is short enough, and as many doublings. The last ones serve again where the exponents
 * are the same. */
static void transition(Kalman *k, int n)
{
    const int known = same(k->last_omega, k->omega, n) & same(k->last_noise, k->noise, n);
    if (known && k->begun) return;
    k->begun = 1;
    double norm = 0.0;
    for (int i = 0; i < n; i++) {
        double row = 0.0;
        for (int j = 0; j < n; j++) row += fabs(k->omega[i * n + j]);
        norm = larger(norm, row);
    }
    int doublings = 0;
    if (norm > 0.25) (void)frexp(norm / 0.25, &doublings);
    const double part = ldexp(1.0, -doublings);
    for (int i = 0; i < n * n; i++) {
        k->part[i] = k->omega[i] *= part;
        k->phi[i] = k->power[i] = k->part[i];
        k->drift[i] = 0.5 * part * k->part[i];
        k->q[i] = k->term[i] = k->noise[i] * part;
    }
    for (int i = 0; i < n; i++) k->drift[i * n + i] += part;
    double left = 1.0;
    for (int order = 2; left > ENOUGH; order++) {
        left *= 2.0 * norm * part / order;
        const double scale = 1.0 / order;
        kernel_product(k->work, k->part, k->power, n);
        kernel_product(k->spare, k->part, k->term, n);
        for (int i = 0; i < n; i++)
            for (int j = 0; j < n; j++) {
                k->power[i * n + j] = scale * k->work[i * n + j];
                k->phi[i * n + j] += k->power[i * n + j];
                k->drift[i * n + j] += part / (order + 1) * k->power[i * n + j];
                k->term[i * n + j] = scale * (k->spare[i * n + j] + k->spare[j * n + i]);
                k->q[i * n + j] += k->term[i * n + j];
            }
    }
    for (int d = 0; d < doublings; d++) {
        memcpy(k->term, k->q, sizeof *k->q * (size_t)(n * n));
        memcpy(k->power, k->phi, sizeof *k->phi * (size_t)(n * n));
        for (int i = 0; i < n; i++) k->power[i * n + i] += 1.0;
        sandwich(k->term, k->power, k->work, k->spare, n);
        kernel_product(k->work, k->phi, k->drift, n);
        for (int i = 0; i < n * n; i++) k->drift[i] = 2.0 * k->drift[i] + k->work[i];
        kernel_product(k->work, k->phi, k->phi, n);
        for (int i = 0; i < n * n; i++) {
            k->q[i] += k->term[i];
            k->phi[i] = 2.0 * k->phi[i] + k->work[i];
        }
    }
    for (int i = 0; i < n; i++) k->phi[i * n + i] += 1.0;
}

/* P <- phi P phi' + Q, and the transition since the last sample. */
static void advance(Run *r, const double *phi, const double *q)
{
    Kalman *k = r->kalman;
    const int n = r->n;
    sandwich(k->p, phi, k->work, k->spare, n);
    for (int i = 0; i < n * n; i++) k->p[i] += q[i];
    if (r->mode != MODE_FILTER_STATES) return;
    kernel_product(k->work, phi, k->f, n);
    memcpy(k->f, k->work, sizeof *k->f * (size_t)(n * n));
}

/* What the model's curvature adds to a step of its linearisation, to k->gain, from the slopes r->f and r->f1 at both
 * ends of a step by h to r->x1. Its size, in units of the tolerance, says up to which length such steps may be tried. */
static double error_of_linearisation(Run *r, double h)
{
    Kalman *k = r->kalman;
    const int n = r->n;
    for (int i = 0; i < n; i++) {
        double left = r->f1[i] - r->f[i];
        for (int j = 0; j < n; j++) left -= r->jac[i * n + j] * (r->x1[j] - r->x[j]);
        k->gain[i] = h / 3.0 * left;
    }
    const double error = scaled_norm(r, k->gain, r->x, r->x1);
    k->reach = error > 0.0 ? 0.9 * h * pow(error, -1.0 / 3.0) : error == 0.0 ? INFINITY : 0.0;
    return error;
}

/* The covariance over the step from r->t by h, of the `fraction` of it that was taken; r->x1 is its end. The Jacobian
 * at the beginning, the middle and the end of the step gives the transition by the Magnus expansion of order 4 (Blanes,
 * Casas, Oteo, Ros, Physics Reports 470 (2009) 151). The last one is left in k->end, the derivatives in r->f1. */
int kalman_step(Run *r, double h, double fraction)
{
    Kalman *k = r->kalman;
    const int n = r->n;
    const double half = 0.5 * fraction;
    int status;
    for (int i = 0; i < n; i++) kernel_horner(r->dense + i, n, &half, 1, k->x + i);
    if (is_error(status = rhs(r, r->t + half * h, k->x, r->f1))) return status;
    if (is_error(status = jacobian(r, r->t + half * h, k->x, r->f1, k->middle))) return status;
    if (is_error(status = rhs(r, r->t + fraction * h, r->x1, r->f1))) return status;
    if (is_error(status = jacobian(r, r->t + fraction * h, r->x1, r->f1, k->end))) return status;
    (void)error_of_linearisation(r, fraction * h);
    exponents(k, r->jac, fraction * h, n);
    transition(k, n);
    advance(r, k->phi, k->q);
    return FMI_OK;
}

/* The cubic through both ends of a step, in powers of the fraction. */
static void hermite(Run *r, double h)
{
    const int n = r->n;
    double *c = r->dense;
    for (int i = 0; i < n; i++) {
        const double begin = h * r->f[i], end = h * r->f1[i], change = r->x1[i] - r->x[i];
        c[i] = r->x[i];
        c[n + i] = begin;
        c[2 * n + i] = 3.0 * change - 2.0 * begin - end;
        c[3 * n + i] = begin + end - 2.0 * change;
        c[4 * n + i] = 0.0;
    }
}

/* A step of the linearisation from (r->t, r->x) by h, to r->x1: exponential Euler-Rosenbrock, with an estimate of its
 * error from what the model leaves at the end (M. Hochbruck, A. Ostermann, J. Schweitzer, SIAM J. Numer. Anal. 47 (2009)
 * 786; in filters, T. Ozaki, Statistica Sinica 2 (1992) 113). Where the error is too large and the step is not `forced`
 * the answer is 0. Errors of the model are left in r->status. */
int kalman_linearised(Run *r, double h, int forced)
{
    Kalman *k = r->kalman;
    const int n = r->n;
    r->status = FMI_OK;
    if (!forced && h > k->reach) return 0;
    memset(k->noise, 0, sizeof *k->noise * (size_t)(n * n));
    for (int i = 0; i < n; i++) k->noise[i * n + i] = h * k->rate[i];
    for (int i = 0; i < n * n; i++) k->omega[i] = h * r->jac[i];
    transition(k, n);
    for (int i = 0; i < n; i++) {
        double v = 0.0;
        for (int j = 0; j < n; j++) v += k->drift[i * n + j] * r->f[j];
        r->x1[i] = r->x[i] + h * v;
    }
    r->status = rhs(r, r->t + h, r->x1, r->f1);
    double error = NAN;
    if (!is_error(r->status))
        error = error_of_linearisation(r, h);
    else if (r->status == FMI_DISCARD)
        r->status = FMI_OK;
    if (!(error <= 1.0) && !(forced && error < INFINITY)) return 0;
    r->status = jacobian(r, r->t + h, r->x1, r->f1, k->end);
    for (int i = 0; i < n; i++) r->x1[i] += k->gain[i];
    if (r->nz) hermite(r, h);
    return !is_error(r->status);
}

/* The covariance over that step. The change D of the Jacobian enters to first order: phi with half of h D before it and
 * half behind, the noise with its mean from when it acts. */
void kalman_advance(Run *r, double h)
{
    Kalman *k = r->kalman;
    const int n = r->n;
    int changes = 0;
    for (int i = 0; i < n * n; i++) {
        k->middle[i] = h * (k->end[i] - r->jac[i]);
        changes |= k->middle[i] != 0.0;
    }
    if (!changes) {
        advance(r, k->phi, k->q);
        return;
    }
    kernel_product(k->work, k->middle, k->phi, n);
    kernel_product(k->spare, k->phi, k->middle, n);
    kernel_product(k->part, k->middle, k->q, n);
    for (int i = 0; i < n; i++)
        for (int j = 0; j < n; j++) {
            k->power[i * n + j] = k->phi[i * n + j] + 0.25 * (k->work[i * n + j] + k->spare[i * n + j]);
            k->term[i * n + j] = k->q[i * n + j] + (k->part[i * n + j] + k->part[j * n + i]) / 6.0;
        }
    advance(r, k->power, k->term);
}
