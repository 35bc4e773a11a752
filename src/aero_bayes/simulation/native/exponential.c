/* Steps of exponential collocation over the short segments between two values of a moving input: with a kept Jacobian A
 *   x' = A x + d(t, x),
 * the linear part is exact, however stiff, and what the model leaves, d, is a parabola through three points of the step
 * (M. Hochbruck, A. Ostermann, Acta Numerica 19 (2010) 209; the points make the quadrature of order 4). The matrices of
 * the linear part (phi.c) depend on A and on the step's length alone and are kept while the model stays close to its
 * linearisation, so that a step costs four evaluations and some products of a matrix and a vector; two evaluations
 * where the model is linear. Errors are estimated; a segment for which one such step is not good enough, or in which an
 * event occurs, is left to the method of rodas.c.
 *
 * To step several parameter vectors together: the matrices belong to each vector (they are its own A), the sequence of
 * products and evaluations is that of attempt() for all, and a step counts where it is good enough for each of them. */
#include "engine.h"

/* Points of the parabola, its values at the step's beginning and end by those at the points. */
static const double point[NODES_X] = {1.0 / 6.0, 2.0 / 3.0, 1.0};
static const double at_start[NODES_X] = {1.6, -1.0, 0.4};
/* Lagrange's polynomials of the points: coefficients of 1, s and s^2 / 2. */
static const double lagrange[NODES_X][3] = {{1.6, -4.0, 4.8}, {-1.0, 7.0, -12.0}, {0.4, -3.0, 7.2}};

/* Lagrange's polynomials at a point between, where the parabola is tried on the model; and the third power's there by its
 * value at the beginning. */
#define BETWEEN (1.0 / 3.0)
static const double between[NODES_X] = {8.0 / 15.0, 2.0 / 3.0, -0.2};
#define CUBIC_BETWEEN (-1.0 / 3.0)

#define CLOSE_TO_LINEAR 1e-3 /* a remainder, in units of the tolerance, that does not count */
#define OFF_PARABOLA 0.3     /* error at the end by the parabola's defect at the beginning: at least that of a kink */
#define OF_SMOOTH 0.3         /* and the share of it that counts where the remainder was seen to be smooth; less misses kinks */
#define OLD_JACOBIAN 0.5     /* error from which a newer Jacobian is worth its matrices, */
#define FAR_FROM_JACOBIAN 5e-3 /* where the corrections shrink by no more than this */
#define MUCH_SMALLER 0.1       /* error at which a step of twice the length is likely to do */
#define OF_CORRECTIONS 0.3   /* error that may be left to corrections not made */

enum {
    CHECK_EACH = 16,   /* a linear model is looked at between its samples, and the iteration's contraction measured anew */
    MOST_ROUNDS = 4,
    LONGEST_PAUSE = 64, /* segments that are left to the other method after failures */
    MOST_LEVELS = 3,    /* halvings of a segment */
    TRY_LONGER = 4      /* segments after which one halving less is tried */
};

static double *take(double **at, size_t count)
{
    double *here = *at;
    *at += count;
    return here;
}

static void lay_out_flow(Flow *f, double **at, size_t size)
{
    f->transition = take(at, 4 * size);
    f->of_slope = take(at, size), f->of_ramp = take(at, size);
    for (int j = 0; j < NODES_X; j++) f->of_node[j] = take(at, size);
}

/* Memory of the steps, kept for all runs of an experiment; 0 where there is none. */
int exponential_open(Run *r)
{
    if (r->exponential) return 1;
    const size_t n = (size_t)r->n, rows = (n + 3) / 4 * 4, size = n * rows, inputs = (size_t)r->e->n_signals;
    const size_t flows = MOST_TABLES * (NODES_X + 1 + MOST_INSIDE);
    Exponential *k = calloc(1, sizeof *k);
    const size_t count = flows * 9 * size + 9 * size + inputs * rows + (3 * NODES_X + 9) * rows;
    double *at = k ? calloc(count + 8, sizeof *at) : NULL;
    if (!at) {
        free(k);
        return 0;
    }
    k->memory = at;
    k->rows = (int)rows;
    k->a = take(&at, size), k->work = take(&at, 8 * size), k->b = take(&at, inputs * rows);
    for (int t = 0; t < MOST_TABLES; t++) {
        for (int j = 0; j < NODES_X; j++) lay_out_flow(&k->table[t].node[j], &at, size);
        lay_out_flow(&k->table[t].between, &at, size);
        for (int j = 0; j < MOST_INSIDE; j++) lay_out_flow(&k->table[t].inside[j], &at, size);
    }
    for (int j = 0; j < NODES_X; j++)
        k->x[j] = take(&at, rows), k->d[j] = take(&at, rows), k->linear[j] = take(&at, rows);
    k->f0 = take(&at, rows), k->x0 = take(&at, rows), k->ramp = take(&at, rows), k->v = take(&at, rows);
    k->change = take(&at, rows), k->end = take(&at, rows), k->first = take(&at, rows), k->second = take(&at, rows);
    k->middle = take(&at, rows);
    r->exponential = k;
    return 1;
}

void exponential_close(Exponential *k)
{
    if (!k) return;
    free(k->memory);
    free(k);
}

/* Before a run. */
void exponential_begin(Run *r)
{
    if (!r->exponential) return;
    r->exponential->level = r->exponential->stale = r->exponential->since_longer = 0;
    r->exponential->known = r->exponential->pause = r->exponential->last_pause = r->exponential->linear_model = 0;
}

/* The matrices that the step uses, from e^(theta h A) and the integrals behind it. */
static void weigh_flow(Flow *f, double h, size_t size)
{
    const double *i0 = f->transition + size, *i1 = i0 + size, *i2 = i1 + size;
    for (size_t i = 0; i < size; i++) {
        f->of_slope[i] = h * i0[i];
        f->of_ramp[i] = h * i1[i];
        for (int j = 0; j < NODES_X; j++)
            f->of_node[j][i] = h * (lagrange[j][0] * i0[i] + lagrange[j][1] * i1[i] + lagrange[j][2] * i2[i]);
    }
}

static StepTable *table_of(Run *r, double h)
{
    Exponential *k = r->exponential;
    const int n = r->n, rows = k->rows;
    const size_t size = (size_t)(n * rows);
    const double near = h * larger(1e-3 * r->rtol, 1e-13);
    for (int i = 0; i < k->n_tables; i++)
        if (fabs(k->table[i].h - h) <= near) return &k->table[i];
    if (k->n_tables == MOST_TABLES) k->n_tables = 0;
    StepTable *t = &k->table[k->n_tables++];
    t->h = h;
    t->n_inside = 0;
    double *third = t->between.transition;
    phi_flow(t->node[0].transition, k->a, h, point[0], k->work, n, rows);
    phi_follow(third, point[0], t->node[0].transition, t->node[0].transition, n, rows);
    phi_follow(t->node[1].transition, 1.0 / 3.0, third, third, n, rows);
    phi_follow(t->node[2].transition, 1.0 / 3.0, third, t->node[1].transition, n, rows);
    for (int j = 0; j < NODES_X; j++) weigh_flow(&t->node[j], h, size);
    weigh_flow(&t->between, h, size);
    return t;
}

static Flow *flow_inside(Run *r, StepTable *t, double theta)
{
    Exponential *k = r->exponential;
    const double near = larger(1e-3 * r->rtol, 1e-13);
    for (int i = 0; i < t->n_inside; i++)
        if (fabs(t->inside[i].theta - theta) <= near) return &t->inside[i];
    if (t->n_inside == MOST_INSIDE) t->n_inside = 0;
    Flow *f = &t->inside[t->n_inside++];
    f->theta = theta;
    phi_flow(f->transition, k->a, t->h, theta, k->work, r->n, k->rows);
    weigh_flow(f, t->h, (size_t)(r->n * k->rows));
    return f;
}

/* A and, where inputs may slope, df/du anew at (r->t, r->x), with r->f there. */
static int renew_jacobian(Run *r)
{
    Exponential *k = r->exponential;
    const int n = r->n, rows = k->rows;
    int status = set_point(r, r->t, r->x);
    if (!is_error(status)) status = jacobian(r, r->t, r->x, r->f, r->jac);
    for (int i = 0; r->any_linear && r->problem->has_directional && i < r->e->n_signals && !is_error(status); i++)
        status = directional_column(r, r->u_reference[i], k->b + i * rows);
    if (is_error(status)) return status;
    for (int j = 0; j < n; j++)
        for (int i = 0; i < n; i++) {
            if (!isfinite(r->jac[i * n + j])) return FMI_DISCARD;
            k->a[j * rows + i] = r->jac[i * n + j];
        }
    k->known = 1;
    k->age = k->n_tables = k->linear_model = k->stale = 0;
    k->contraction = -1.0;
    return status;
}

/* What sloping inputs add to the slope of the states over the step. */
static int find_ramp(Run *r, double h)
{
    Exponential *k = r->exponential;
    memset(k->ramp, 0, sizeof *k->ramp * (size_t)k->rows);
    k->ramps = r->any_slope;
    if (!r->any_slope) return FMI_OK;
    if (r->problem->has_directional) {
        for (int s = 0; s < r->e->n_signals; s++)
            for (int i = 0; i < r->n; i++) k->ramp[i] += h * r->slope[s] * k->b[s * k->rows + i];
        return FMI_OK;
    }
    const int status = rhs(r, r->t + h, r->x, k->ramp);
    for (int i = 0; i < r->n; i++) k->ramp[i] -= k->f0[i];
    return status;
}

/* The model's linearisation at a fraction of the step. */
static void linear_at(const Run *r, const Flow *f, double *to)
{
    const Exponential *k = r->exponential;
    memcpy(to, k->x0, sizeof *to * (size_t)k->rows);
    kernels->apply(to, f->of_slope, k->f0, r->n, k->rows);
    if (k->ramps) kernels->apply(to, f->of_ramp, k->ramp, r->n, k->rows);
}

/* to += what the remainders add there */
static void add_remainders(const Run *r, const Flow *f, double *to)
{
    const Exponential *k = r->exponential;
    for (int j = 0; j < NODES_X; j++) kernels->apply(to, f->of_node[j], k->d[j], r->n, k->rows);
}

/* What the slope at x at a fraction of the step leaves of the linearisation, to d. */
static int remainder_at(Run *r, double h, double theta, const double *x, double *d)
{
    Exponential *k = r->exponential;
    double *v = k->v;
    const int status = rhs(r, r->t + theta * h, x, d);
    if (is_error(status)) return status;
    for (int i = 0; i < k->rows; i++) v[i] = k->x0[i] - x[i];
    for (int i = 0; i < r->n; i++) d[i] -= k->f0[i] + theta * k->ramp[i];
    kernels->apply(d, k->a, v, r->n, k->rows);
    return status;
}

static int find_remainder(Run *r, double h, int j) { return remainder_at(r, h, point[j], r->exponential->x[j], r->exponential->d[j]); }

/* Size at the step's end, in units of the tolerance, of a slope that acts all the step long. */
static double effect(Run *r, const StepTable *t, const double *slope)
{
    Exponential *k = r->exponential;
    memset(k->v, 0, sizeof *k->v * (size_t)k->rows);
    kernels->apply(k->v, t->node[2].of_slope, slope, r->n, k->rows);
    return scaled_norm(r, k->v, r->x, k->end);
}

/* Corrections by the remainders until they change the end no more. Returns their error in units of the tolerance; the end
 * is left in k->end. Where `rounds` is not zero there are so many. */
static double iterate(Run *r, const StepTable *t, int rounds)
{
    Exponential *k = r->exponential;
    const size_t bytes = sizeof(double) * (size_t)k->rows;
    double size = 0.0;
    memset(k->change, 0, bytes);
    for (int round = 1;; round++) {
        double *add = k->first;
        memset(add, 0, bytes);
        add_remainders(r, &t->node[2], add);
        for (int i = 0; i < r->n; i++) {
            k->change[i] = add[i] - k->change[i];
            k->end[i] = k->linear[2][i] + add[i];
        }
        const double now = scaled_norm(r, k->change, r->x, k->end);
        memcpy(k->change, add, bytes);
        k->rounds = round;
        if (!(now < INFINITY)) return NAN;
        if (round > 1) k->contraction = size > 0.0 ? now / size : 0.0;
        size = now;
        if (rounds ? round == rounds : round == MOST_ROUNDS) return rounds || k->contraction < 0.5 ? now : INFINITY;
        const int measured = round > 1 || (k->contraction >= 0.0 && k->age % CHECK_EACH);
        const double error = measured ? 3.0 * k->contraction * now : now;
        if (!rounds && error <= OF_CORRECTIONS) return error;
        for (int j = 0; j < NODES_X; j++) {
            memcpy(k->x[j], k->linear[j], bytes);
            add_remainders(r, &t->node[j], k->x[j]);
        }
        for (int j = 0; j < NODES_X; j++) {
            r->status = find_remainder(r, t->h, j);
            if (is_error(r->status)) return NAN;
        }
    }
}

/* Error at the end from the form of the remainder, in units of the tolerance. The parabola does not pass through zero at
 * the beginning. Where that is much, the third power through that too is tried on the model at a point between: a smooth
 * remainder it meets, and then the end is far more exact than the beginning. */
static double error_of_parabola(Run *r, const StepTable *t)
{
    Exponential *k = r->exponential;
    double *defect = k->first, *off = k->second;
    for (int i = 0; i < k->rows; i++)
        defect[i] = at_start[0] * k->d[0][i] + at_start[1] * k->d[1][i] + at_start[2] * k->d[2][i];
    const double error = OFF_PARABOLA * effect(r, t, defect);
    if (error <= OLD_JACOBIAN || !(OF_SMOOTH * error < 1.0)) return error;
    double *x = k->middle;
    linear_at(r, &t->between, x);
    add_remainders(r, &t->between, x);
    r->status = remainder_at(r, t->h, BETWEEN, x, off);
    if (is_error(r->status)) return NAN;
    for (int i = 0; i < k->rows; i++)
        off[i] -= between[0] * k->d[0][i] + between[1] * k->d[1][i] + between[2] * k->d[2][i] - CUBIC_BETWEEN * defect[i];
    return OF_SMOOTH * error + OFF_PARABOLA * effect(r, t, off);
}

/* One step with the matrices at hand; its error in units of the tolerance. */
static double attempt(Run *r, StepTable *t, int rounds)
{
    Exponential *k = r->exponential;
    const int n = r->n;
    const size_t bytes = sizeof(double) * (size_t)k->rows;
    memcpy(k->f0, r->f, sizeof *r->f * (size_t)n);
    memcpy(k->x0, r->x, sizeof *r->x * (size_t)n);
    r->status = find_ramp(r, t->h);
    if (is_error(r->status)) return NAN;
    linear_at(r, &t->node[2], k->linear[2]);
    memcpy(k->x[2], k->linear[2], bytes);
    memcpy(k->end, k->linear[2], bytes);
    r->status = find_remainder(r, t->h, 2);
    if (is_error(r->status)) return NAN;
    k->rounds = 0;
    const double left = effect(r, t, k->d[2]);
    if (rounds ? rounds == ONLY_END : k->linear_model && left <= CLOSE_TO_LINEAR && k->age % CHECK_EACH) {
        for (int j = 0; j < NODES_X; j++) memset(k->d[j], 0, bytes);
        k->rounds = ONLY_END;
        return left;
    }
    int linear = left <= CLOSE_TO_LINEAR;
    for (int j = 0; j < 2; j++) {
        linear_at(r, &t->node[j], k->linear[j]);
        memcpy(k->x[j], k->linear[j], bytes);
        r->status = find_remainder(r, t->h, j);
        if (is_error(r->status)) return NAN;
        linear = linear && effect(r, t, k->d[j]) <= CLOSE_TO_LINEAR;
    }
    k->linear_model = linear;
    const double error = iterate(r, t, rounds);
    if (!(error < INFINITY)) return error;
    return error + error_of_parabola(r, t);
}

/* Does an event indicator change its sign? The indicators at the end are left in r->z1. */
static int meets_event(Run *r, const StepTable *t)
{
    Exponential *k = r->exponential;
    for (int j = 0; j < NODES_X; j++) {
        double *x = j == 2 ? k->end : k->x[j];
        if (j < 2) {
            linear_at(r, &t->node[j], x);
            add_remainders(r, &t->node[j], x);
        }
        r->status = indicators(r, r->t + point[j] * t->h, x, r->z1);
        if (is_error(r->status) || crossed(r->z0, r->z1, r->nz)) return 1;
    }
    return 0;
}

/* Do such steps pay up to `end`? Not where many samples lie before it, or where they failed just now. */
int exponential_may(Run *r, double end)
{
    const Experiment *e = r->e;
    if (r->n == 0 || r->n > MOST_STATES || filters(r) || !moves_at_samples(e)) return 0;
    const int64_t last = r->sample + MOST_INSIDE + 1;
    if (last < e->n && e->time[last] < end - r->resolution) return 0;
    if (!exponential_open(r)) return 0;
    Exponential *k = r->exponential;
    if (k->pause > 0) {
        k->pause--;
        return 0;
    }
    if (k->level > 0 && (k->worst < MUCH_SMALLER || ++k->since_longer >= TRY_LONGER)) k->level--, k->since_longer = 0;
    k->worst = 0.0;
    return 1;
}

/* One step by h; whether it is good enough. */
static int try_step(Run *r, double h, int renew, int code)
{
    Exponential *k = r->exponential;
    double error = NAN;
    r->status = renew ? renew_jacobian(r) : FMI_OK;
    if (!is_error(r->status)) {
        k->now = table_of(r, h);
        error = attempt(r, k->now, code);
    }
    const int good = !is_error(r->status) && (code ? error < INFINITY : error <= 1.0);
    if (r->status == FMI_DISCARD) r->status = FMI_OK;
    k->error = error;
    return good;
}

/* A step from (r->t, r->x), where r->f is the slope, by a part of the segment's `span` that is good enough, to r->x1; its
 * length, at most `left`, or 0 where none is good enough. Errors of the model are left in r->status. `recorded` is what
 * an earlier run's step of length `left` told of itself, or negative. */
double exponential_step(Run *r, double span, double left, double *recorded)
{
    Exponential *k = r->exponential;
    const int forced = *recorded >= 0.0, code = forced ? (int)*recorded : 0;
    r->status = FMI_OK;
    int renewed = forced ? code >= RENEWED : !k->known || k->stale;
    double h = forced ? left : fmin(left, ldexp(span, -k->level));
    int good = try_step(r, h, renewed, code % RENEWED);
    while (!good && !forced && !is_error(r->status) && k->level < MOST_LEVELS) {
        const int renew = !renewed && (k->contraction < 0.0 || k->contraction > FAR_FROM_JACOBIAN || !(k->error < INFINITY));
        if (!renew) h = fmin(left, ldexp(span, -++k->level));
        renewed |= renew;
        good = try_step(r, h, renew, 0);
    }
    if (is_error(r->status)) return 0.0;
    if (good && r->nz && meets_event(r, k->now)) { /* the other method looks for it */
        k->known = 0;
        if (r->status == FMI_DISCARD) r->status = FMI_OK;
        return 0.0;
    }
    if (!good) {
        k->known = k->level = 0;
        k->last_pause = k->last_pause < LONGEST_PAUSE / 2 ? 2 * k->last_pause + 1 : LONGEST_PAUSE;
        k->pause = k->last_pause;
        return 0.0;
    }
    k->stale = k->age > 0 && k->error > OLD_JACOBIAN && k->contraction > FAR_FROM_JACOBIAN;
    k->age++;
    k->worst = larger(k->worst, k->error);
    k->last_pause = 0;
    memcpy(r->x1, k->end, sizeof *r->x1 * (size_t)r->n);
    *recorded = k->rounds + (renewed ? RENEWED : 0);
    return h;
}

/* Samples before `limit`, from the step's own solution at their times. */
int exponential_emit(Run *r, double limit)
{
    const Experiment *e = r->e;
    Exponential *k = r->exponential;
    const int n = r->n;
    memset(r->dense, 0, sizeof *r->dense * (size_t)(5 * n));
    while (r->sample < e->n && e->time[r->sample] < limit) {
        const double time = e->time[r->sample], theta = (time - r->t) / k->now->h;
        if (time - r->t <= r->resolution)
            memcpy(r->dense, k->x0, sizeof *r->dense * (size_t)n);
        else {
            const Flow *f = flow_inside(r, k->now, theta);
            linear_at(r, f, k->v);
            add_remainders(r, f, k->v);
            memcpy(r->dense, k->v, sizeof *r->dense * (size_t)n);
        }
        const int status = emit_until(r, 0.0, time, 1);
        if (is_error(status)) return status;
    }
    return FMI_OK;
}
