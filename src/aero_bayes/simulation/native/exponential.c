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

/* Lagrange's polynomials of the points: coefficients of 1, s and s^2 / 2. */
static const double lagrange[NODES_X][3] = {{1.6, -4.0, 4.8}, {-1.0, 7.0, -12.0}, {0.4, -3.0, 7.2}};

/* Lagrange's polynomials at a point between, where the parabola is tried on the model; and the third power's there by its
 * value at the beginning. */
#define BETWEEN (1.0 / 3.0)
static const double between[NODES_X] = {8.0 / 15.0, 2.0 / 3.0, -0.2};
#define CUBIC_BETWEEN (-1.0 / 3.0)
#define OFF_AT_CORNER 1.5 /* error at the end by what is left there of a corner: at least that of a jump between two points */

/* Error at the end by the same defect where the remainder is a third power: by h A, of which it is the first term (and
 * never more than by the next), and by the corrections' contraction, as the states at the points are off too. */
#define OF_SMOOTH 0.01
#define MOST_OF_SMOOTH 0.1
#define OLD_JACOBIAN 0.5     /* error from which a newer Jacobian is worth its matrices, */
#define FAR_FROM_JACOBIAN 5e-3 /* where the corrections shrink by no more than this */
#define MUCH_SMALLER 0.1       /* error at which a step of twice the length is likely to do */
#define OF_CORRECTIONS 0.003   /* error that may be left to corrections not made: it has the same sign step after step */
#define SAME_JACOBIAN 1e-2     /* change of h times the Jacobian over a step, in sizes of the states, that is none */
#define STIFF 0.5 /* size of h A from which sensitivities move too fast within a step for a parabola */

enum {
    CHECK_EACH = 16,   /* a linear model is looked at between its samples, and the iteration's contraction measured anew */
    MOST_ROUNDS = 4,
    MOST_LEVELS = 3,    /* halvings of a segment */
    TRY_LONGER = 4,     /* segments after which one halving less is tried */
    LASTED = 8          /* steps of a Jacobian that are worth the derivatives of its matrices */
};
#define MOST_MEMORY 64e6 /* bytes of them */

#define REALS(count) take(a, (size_t)(count), sizeof(double))

static Matrix take_matrices(Arena *a, size_t count, const Exponential *k, int ld)
{
    const size_t n = (size_t)k->system.n;
    const Matrix m = {REALS(count * n * (size_t)k->rows), REALS(count * n * n * (size_t)ld)};
    return m;
}

static void lay_out_flow(Flow *f, Arena *a, const Exponential *k, int ld)
{
    f->transition = take_matrices(a, 4, k, ld);
    f->of_slope = take_matrices(a, 1, k, ld), f->of_ramp = take_matrices(a, 1, k, ld);
    for (int j = 0; j < NODES_X; j++) f->of_node[j] = take_matrices(a, 1, k, ld);
}

static void lay_out(Exponential *k, Arena *a, size_t inputs, int ld)
{
    const size_t n = (size_t)k->system.n, rows = (size_t)k->rows, all_rows = (size_t)k->all_rows;
    k->system.a = take_matrices(a, 1, k, ld), k->system.work = take_matrices(a, 8, k, ld);
    k->b = REALS(inputs * rows);
    for (int t = 0; t < MOST_TABLES; t++) {
        StepTable *table = &k->table[t];
        for (int j = 0; j < NODES_X; j++) lay_out_flow(&table->node[j], a, k, ld);
        lay_out_flow(&table->between, a, k, ld);
        table->of_slope = REALS(n * all_rows), table->of_ramp = REALS(n * all_rows);
        table->of_nodes = REALS(NODES_X * n * all_rows);
        for (int j = 0; j < MOST_INSIDE; j++) lay_out_flow(&table->inside[j], a, k, ld);
    }
    k->points = REALS(all_rows + rows), k->linear = REALS(all_rows + rows), k->remainders = REALS(all_rows + rows);
    for (int j = 0; j < NODES_X; j++) {
        k->x[j] = k->points + (size_t)j * n, k->d[j] = k->remainders + (size_t)j * n;
        k->nearness[j] = REALS(n * rows);
        k->g[j] = REALS(n * (size_t)ld), k->s_linear[j] = REALS(n * (size_t)ld);
    }
    k->s_slope = REALS(n * (size_t)ld), k->s_ramp = REALS(n * (size_t)ld);
    k->f0 = REALS(rows), k->x0 = REALS(rows), k->ramp = REALS(rows), k->v = REALS(rows);
    k->change = REALS(rows), k->end = REALS(rows), k->first = REALS(rows), k->second = REALS(rows);
    k->middle = REALS(rows), k->weight = REALS(rows);
}

/* Memory of the steps, kept for all runs of an experiment; 0 where there is none. */
int exponential_open(Run *r)
{
    if (r->exponential) return 1;
    const size_t n = (size_t)r->n, matrices = MOST_TABLES * (NODES_X + 1 + MOST_INSIDE) * 9 + 9;
    Exponential *k = calloc(1, sizeof *k);
    if (!k) return 0;
    k->rows = (r->n + 3) / 4 * 4, k->all_rows = (NODES_X * r->n + 3) / 4 * 4;
    k->columns = (double)(matrices * n * n * (size_t)r->ld) * sizeof(double) <= MOST_MEMORY;
    k->system = (Linear){.n = r->n, .rows = k->rows};
    Arena arena = {NULL, 0};
    for (int pass = 0; pass < 2; pass++) {
        lay_out(k, &arena, (size_t)r->e->n_signals, k->columns ? r->ld : 0);
        if (!pass) arena = (Arena){k->memory = calloc(1, arena.used), 0};
        if (!k->memory) {
            free(k);
            return 0;
        }
    }
    r->exponential = k;
    exponential_begin(r); /* the first run as every other */
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
    Exponential *k = r->exponential;
    if (!k) return;
    k->level = k->stale = k->since_longer = 0;
    k->known = k->corners = k->failed = k->linear_model = k->linear_columns = 0;
    k->age = LASTED;
}

/* The matrices that the step uses, from e^(theta h A) and the integrals behind it. */
static void weigh(double *of_slope, double *of_ramp, double *const of_node[], double h, const double *i0, size_t size)
{
    const double *i1 = i0 + size, *i2 = i1 + size;
    for (size_t i = 0; i < size; i++) {
        of_slope[i] = h * i0[i];
        of_ramp[i] = h * i1[i];
        for (int j = 0; j < NODES_X; j++)
            of_node[j][i] = h * (lagrange[j][0] * i0[i] + lagrange[j][1] * i1[i] + lagrange[j][2] * i2[i]);
    }
}

static void weigh_flow(const Linear *m, Flow *f, double h)
{
    const Matrix i0 = matrix_at(m, f->transition, 1), *w = f->of_node;
    weigh(f->of_slope.value, f->of_ramp.value, (double *const[]){w[0].value, w[1].value, w[2].value}, h, i0.value,
          (size_t)(m->n * m->rows));
    if (m->ld)
        weigh(f->of_slope.slopes, f->of_ramp.slopes, (double *const[]){w[0].slopes, w[1].slopes, w[2].slopes}, h,
              i0.slopes, (size_t)(m->n * m->n * m->ld));
}

/* The rows that belong to a point, of a matrix for all points, from one of its own. */
static void put_rows(const Exponential *k, double *to, int point, const double *from)
{
    const int n = k->system.n;
    for (int j = 0; j < n; j++)
        for (int i = 0; i < n; i++) to[j * k->all_rows + point * n + i] = from[j * k->rows + i];
}

static StepTable *table_of(Run *r, double h)
{
    Exponential *k = r->exponential;
    const double near = h * larger(1e-3 * r->rtol, 1e-13);
    for (int i = 0; i < k->n_tables; i++)
        if (fabs(k->table[i].h - h) <= near) return &k->table[i];
    if (k->n_tables == MOST_TABLES) k->n_tables = 0;
    StepTable *t = &k->table[k->n_tables++];
    t->h = h;
    t->n_inside = 0;
    const Linear *m = &k->system;
    const Matrix third = t->between.transition;
    phi_flow(m, t->node[0].transition, h, point_of[0]);
    phi_follow(m, third, point_of[0], t->node[0].transition, t->node[0].transition);
    phi_follow(m, t->node[1].transition, 1.0 / 3.0, third, third);
    phi_follow(m, t->node[2].transition, 1.0 / 3.0, third, t->node[1].transition);
    for (int j = 0; j < NODES_X; j++) {
        const Flow *f = &t->node[j];
        weigh_flow(m, &t->node[j], h);
        put_rows(k, t->of_slope, j, f->of_slope.value), put_rows(k, t->of_ramp, j, f->of_ramp.value);
        for (int i = 0; i < NODES_X; i++) put_rows(k, t->of_nodes + i * m->n * k->all_rows, j, f->of_node[i].value);
    }
    weigh_flow(m, &t->between, h);
    return t;
}

Flow *flow_inside(Run *r, StepTable *t, double theta)
{
    Exponential *k = r->exponential;
    const double near = larger(1e-3 * r->rtol, 1e-13);
    for (int i = 0; i < t->n_inside; i++)
        if (fabs(t->inside[i].theta - theta) <= near) return &t->inside[i];
    if (t->n_inside == MOST_INSIDE) t->n_inside = 0;
    Flow *f = &t->inside[t->n_inside++];
    f->theta = theta;
    phi_flow(&k->system, f->transition, t->h, theta);
    weigh_flow(&k->system, f, t->h);
    return f;
}

/* What a state's absolute tolerance is relative to. A nominal value of 1 is one that nobody declared: there it is the
 * largest that the state has been so far, which `now` may exceed. */
double state_size(const Run *r, int i, double now)
{
    return r->nominal[i] == 1.0 ? larger(larger(r->largest[i], now), LEAST_SIZE) : r->nominal[i];
}

/* The Jacobian at (r->t, r->x), with r->f there, to r->jac, and df/du where inputs may slope. */
static int linearise(Run *r)
{
    Exponential *k = r->exponential;
    int status = set_point(r, r->t, r->x);
    if (!is_error(status)) status = jacobian(r, r->t, r->x, r->f, r->jac);
    for (int i = 0; r->any_linear && r->problem->has_directional && i < r->e->n_signals && !is_error(status); i++)
        status = directional_column(r, r->u_reference[i], k->b + i * k->rows);
    return status;
}

/* Is the linearisation at the end of a step by h the one at its beginning? The end is guessed by it. */
static int keeps_jacobian(Run *r, double h)
{
    Exponential *k = r->exponential;
    const int n = r->n, rows = k->rows;
    double *x = k->middle, *f = k->end, *jac = k->nearness[0], *column = k->v;
    if (is_error(linearise(r))) return 0;
    for (int i = 0; i < n; i++) {
        double bend = 0.0;
        for (int j = 0; j < n; j++) bend += r->jac[i * n + j] * r->f[j];
        for (int s = 0; r->any_slope && r->problem->has_directional && s < r->e->n_signals; s++)
            bend += k->b[s * rows + i] * r->slope[s];
        x[i] = r->x[i] + h * (r->f[i] + 0.5 * h * bend);
    }
    if (is_error(rhs(r, r->t + h, x, f)) || is_error(jacobian(r, r->t + h, x, f, jac))) return 0;
    double most = 0.0;
    for (int i = 0; i < n; i++)
        for (int j = 0; j < n; j++)
            most = larger(most, h * fabs(jac[i * n + j] - r->jac[i * n + j]) * state_size(r, j, fabs(r->x[j])) /
                                    state_size(r, i, fabs(r->x[i])));
    for (int s = 0; r->any_slope && r->problem->has_directional && s < r->e->n_signals; s++) {
        if (is_error(directional_column(r, r->u_reference[s], column))) return 0;
        for (int i = 0; i < n; i++)
            most = larger(most, h * h * fabs((column[i] - k->b[s * rows + i]) * r->slope[s]) / state_size(r, i, fabs(r->x[i])));
    }
    return most <= SAME_JACOBIAN;
}

/* A and df/du anew for steps by h. Their derivatives too, where sensitivities are stiff or have many steps of them. */
static int renew_jacobian(Run *r, double h)
{
    Exponential *k = r->exponential;
    const int n = r->n, rows = k->rows, status = linearise(r);
    if (is_error(status)) return status;
    for (int j = 0; j < n; j++)
        for (int i = 0; i < n; i++) {
            if (!isfinite(r->jac[i * n + j])) return FMI_DISCARD;
            k->system.a.value[j * rows + i] = r->jac[i * n + j];
        }
    const int worth = r->sensitive && (r->form == LINEAR_FORM || k->age >= LASTED || h * phi_norm(&k->system) > STIFF);
    k->system.ld = worth ? r->ld : 0;
    k->known = 1;
    k->age = k->n_tables = k->linear_model = k->linear_columns = k->stale = 0;
    k->contraction = -1.0;
    return worth ? columns_renew(r) : status;
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
    kernel_apply(to, f->of_slope.value, k->f0, r->n, k->rows);
    if (k->ramps) kernel_apply(to, f->of_ramp.value, k->ramp, r->n, k->rows);
}

/* to += what the remainders add there */
static void add_remainders(const Run *r, const Flow *f, double *to)
{
    const Exponential *k = r->exponential;
    for (int j = 0; j < NODES_X; j++) kernel_apply(to, f->of_node[j].value, k->d[j], r->n, k->rows);
}

/* The states at a fraction of the last step. */
void state_at(const Run *r, const Flow *f, double *to)
{
    linear_at(r, f, to);
    add_remainders(r, f, to);
}

/* The linearisation at all points. */
static void linear_at_points(Run *r, const StepTable *t)
{
    Exponential *k = r->exponential;
    const int n = r->n;
    for (int j = 0; j < NODES_X; j++) memcpy(k->linear + j * n, k->x0, sizeof *k->x0 * (size_t)n);
    kernel_apply(k->linear, t->of_slope, k->f0, n, k->all_rows);
    if (k->ramps) kernel_apply(k->linear, t->of_ramp, k->ramp, n, k->all_rows);
    memcpy(k->points, k->linear, sizeof *k->linear * (size_t)k->all_rows);
}

/* What the slope at x at a fraction of the step leaves of the linearisation, to d. */
static int remainder_at(Run *r, double h, double theta, const double *x, double *d)
{
    Exponential *k = r->exponential;
    double *v = k->v, *left = k->second;
    const int n = r->n, status = rhs(r, r->t + theta * h, x, left);
    if (is_error(status)) return status;
    for (int i = 0; i < n; i++) {
        v[i] = k->x0[i] - x[i];
        left[i] -= k->f0[i];
    }
    for (int i = 0; k->ramps && i < n; i++) left[i] -= theta * k->ramp[i];
    kernel_apply(left, k->system.a.value, v, n, k->rows);
    for (int i = 0; i < n; i++) d[i] = left[i];
    return status;
}

static int find_remainder(Run *r, double h, int j) { return remainder_at(r, h, point_of[j], r->exponential->x[j], r->exponential->d[j]); }

/* In units of the tolerance, as scaled_norm, with what the states are at the step's beginning and by the linearisation at its end. */
static double scaled_size(const Run *r, const double *v)
{
    const double *weight = r->exponential->weight;
    double sum = 0.0;
    for (int i = 0; i < r->n; i++) sum += v[i] * v[i] * weight[i];
    return sqrt(sum);
}

static void find_weights(Run *r)
{
    Exponential *k = r->exponential;
    const double *end = k->linear + (NODES_X - 1) * r->n;
    for (int i = 0; i < r->n; i++) {
        const double now = larger(fabs(r->x[i]), fabs(end[i]));
        const double tolerance = r->atol * state_size(r, i, now) + r->rtol * now;
        k->weight[i] = 1.0 / (tolerance * tolerance * (double)r->n);
    }
}

/* Size at the step's end, in units of the tolerance, of a slope that acts all the step long. */
static double effect(Run *r, const StepTable *t, const double *slope)
{
    Exponential *k = r->exponential;
    memset(k->v, 0, sizeof *k->v * (size_t)k->rows);
    kernel_apply(k->v, t->node[2].of_slope.value, slope, r->n, k->rows);
    return scaled_size(r, k->v);
}

/* Corrections by the remainders until they change the end no more. Returns their error in units of the tolerance. Where
 * `rounds` is not zero there are so many. */
static double iterate(Run *r, const StepTable *t, int rounds)
{
    Exponential *k = r->exponential;
    const int n = r->n;
    const size_t bytes = sizeof(double) * (size_t)k->all_rows;
    double size = 0.0;
    for (int round = 1;; round++) {
        memcpy(k->change, k->x[NODES_X - 1], sizeof(double) * (size_t)n);
        memcpy(k->points, k->linear, bytes);
        kernel_apply(k->points, t->of_nodes, k->remainders, NODES_X * n, k->all_rows);
        for (int i = 0; i < n; i++) k->change[i] -= k->x[NODES_X - 1][i];
        const double now = scaled_size(r, k->change);
        k->rounds = round;
        if (!(now < INFINITY)) return NAN;
        if (round > 1) k->contraction = size > 0.0 ? now / size : 0.0;
        size = now;
        if (rounds ? round == rounds : round == MOST_ROUNDS) return rounds || k->contraction < 0.5 ? now : INFINITY;
        const int measured = round > 1 || (k->contraction >= 0.0 && k->age % CHECK_EACH);
        const double error = measured ? 3.0 * k->contraction * now : now;
        if (!rounds && error <= OF_CORRECTIONS) return error;
        for (int j = 0; j < NODES_X; j++) {
            r->status = find_remainder(r, t->h, j);
            if (is_error(r->status)) return NAN;
        }
    }
}

/* Error at the end from the form of the remainder, in units of the tolerance. The parabola does not pass through zero at
 * the beginning. Where that is much, the third power through that too is tried on the model at a point between: a smooth
 * remainder it meets, and then the end is far more exact than the beginning. In a run with corners it is looked at there in
 * any case: between the points a state may pass a corner and come back. */
static double error_of_parabola(Run *r, const StepTable *t)
{
    Exponential *k = r->exponential;
    double *defect = k->first, *off = k->end;
    for (int i = 0; i < r->n; i++)
        defect[i] = at_start[0] * k->d[0][i] + at_start[1] * k->d[1][i] + at_start[2] * k->d[2][i];
    const double whole = effect(r, t, defect), error = OFF_PARABOLA * whole;
    const int bends = error > OLD_JACOBIAN;
    if (!bends && !k->corners) return error;
    memset(off, 0, sizeof *off * (size_t)k->rows);
    kernel_apply(off, k->system.a.value, defect, r->n, k->rows);
    const double linear = fmin(OF_SMOOTH * t->h * effect(r, t, off), MOST_OF_SMOOTH * whole);
    const double smooth = linear + fmax(k->contraction, 0.0) * whole;
    if (bends && !(smooth < 1.0)) return error;
    double *x = k->middle;
    state_at(r, &t->between, x);
    r->status = remainder_at(r, t->h, BETWEEN, x, off);
    if (is_error(r->status)) return NAN;
    for (int i = 0; i < r->n; i++)
        off[i] -= between[0] * k->d[0][i] + between[1] * k->d[1][i] + between[2] * k->d[2][i] - CUBIC_BETWEEN * defect[i];
    return (bends ? smooth : error) + (k->corners ? OFF_AT_CORNER : OFF_PARABOLA) * effect(r, t, off);
}

/* The step of a linear model is exact. */
static double exact_step(Run *r, const StepTable *t)
{
    Exponential *k = r->exponential;
    linear_at(r, &t->node[2], k->end);
    for (int i = 0; i < r->n; i++)
        if (!isfinite(k->end[i])) return NAN;
    memcpy(k->x[NODES_X - 1], k->end, sizeof *k->end * (size_t)r->n);
    memset(k->remainders, 0, sizeof *k->remainders * (size_t)k->all_rows);
    k->rounds = ONLY_END;
    return 0.0;
}

/* One step with the matrices at hand; its error in units of the tolerance. */
static double attempt(Run *r, StepTable *t, int rounds)
{
    Exponential *k = r->exponential;
    const int n = r->n;
    memcpy(k->f0, r->f, sizeof *r->f * (size_t)n);
    memcpy(k->x0, r->x, sizeof *r->x * (size_t)n);
    r->status = find_ramp(r, t->h);
    if (is_error(r->status)) return NAN;
    if (r->form == LINEAR_FORM) return exact_step(r, t);
    linear_at_points(r, t);
    find_weights(r);
    r->status = find_remainder(r, t->h, 2);
    if (is_error(r->status)) return NAN;
    k->rounds = 0;
    const int looks = rounds ? rounds == ONLY_END : r->form != OTHER_FORM && (k->linear_model || k->age % CHECK_EACH == 0);
    const double left = looks ? effect(r, t, k->d[2]) : INFINITY;
    if (rounds ? looks : left <= CLOSE_TO_LINEAR && k->linear_model && k->age % CHECK_EACH) {
        memset(k->remainders, 0, sizeof *k->remainders * (size_t)k->all_rows);
        k->rounds = ONLY_END;
        return left;
    }
    int linear = left <= CLOSE_TO_LINEAR;
    for (int j = 0; j < 2; j++) {
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
        r->status = indicators(r, r->t + point_of[j] * t->h, k->x[j], r->z1);
        if (is_error(r->status) || crossed(r->z0, r->z1, r->nz)) return 1;
    }
    return relay_turns(r, k->x);
}

/* At the beginning of a segment. */
void exponential_ready(Run *r)
{
    Exponential *k = r->exponential;
    if (k->level > 0 && (k->worst < MUCH_SMALLER || ++k->since_longer >= TRY_LONGER)) k->level--, k->since_longer = 0;
    k->worst = 0.0;
}

/* One step by h; whether it is good enough. */
static int try_step(Run *r, double h, int renew, int code)
{
    Exponential *k = r->exponential;
    double error = NAN;
    r->status = renew ? renew_jacobian(r, h) : FMI_OK;
    if (!is_error(r->status)) {
        k->now = table_of(r, h);
        error = attempt(r, k->now, code);
        if (r->sensitive && error <= 1.0 && !is_error(r->status)) error = larger(error, columns_step(r));
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
    if (k->failed && !forced && !keeps_jacobian(r, h)) return 0.0;
    int good = try_step(r, h, renewed, code % RENEWED);
    while (!good && !forced && !is_error(r->status) && k->level < MOST_LEVELS) {
        const int renew = !renewed && (k->contraction < 0.0 || k->contraction > FAR_FROM_JACOBIAN || !(k->error < INFINITY));
        if (!renew) h = fmin(left, ldexp(span, -++k->level));
        renewed |= renew;
        good = try_step(r, h, renew, 0);
    }
    if (is_error(r->status)) return 0.0;
    if (good && r->nz && meets_event(r, k->now)) { /* the other method looks for it */
        k->known &= r->relay != 0;
        if (r->status == FMI_DISCARD) r->status = FMI_OK;
        return 0.0;
    }
    if (!good) {
        k->known = k->level = 0;
        k->failed = k->corners = 1;
        return 0.0;
    }
    k->stale = k->age > 0 && k->error > OLD_JACOBIAN && k->contraction > FAR_FROM_JACOBIAN;
    k->age++;
    k->worst = larger(k->worst, k->error);
    k->failed = 0;
    memcpy(r->x1, k->x[NODES_X - 1], sizeof *r->x1 * (size_t)r->n);
    if (r->form == LINEAR_FORM) { /* the slope there */
        for (int i = 0; i < r->n; i++) k->v[i] = r->x1[i] - k->x0[i], k->end[i] = r->f[i] + (k->ramps ? k->ramp[i] : 0.0);
        kernel_apply(k->end, k->system.a.value, k->v, r->n, k->rows);
        memcpy(r->f, k->end, sizeof *r->f * (size_t)r->n);
    }
    *recorded = k->rounds + (renewed ? RENEWED : 0);
    return h;
}
