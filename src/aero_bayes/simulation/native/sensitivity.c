/* Forward sensitivities S = dx/dp on the steps of the state (staggered direct method; M. Caracotsios, W. Stewart 1985;
 * W. Feehery, J. Tolsma, P. Barton 1997). S' = A(t) S + B(t) is linear, with A = df/dx and B = df/dp along the
 * continuous extension of the state. The same Rosenbrock method is applied to it as to any non-autonomous system: its
 * exact Jacobian is A(t_n), so the factors of the state's own step serve every column. A and B are taken at four points
 * of the step and interpolated by a cubic, which also gives their time derivative. */
#include "engine.h"

static const double node[4] = {0.0, 1.0 / 3.0, 2.0 / 3.0, 1.0};

static void cubic_weights(double x, double *w)
{
    for (int i = 0; i < 4; i++) {
        w[i] = 1.0;
        for (int j = 0; j < 4; j++)
            if (j != i) w[i] *= (x - node[j]) / (node[i] - node[j]);
    }
}

static const double slope_at_0[4] = {-5.5, 9.0, -4.5, 1.0};

static int jumps(const Run *r, int signal)
{
    return (!r->e->signals[signal].linear || is_driven(r, signal)) && r->u_before[signal] != r->u0[signal];
}

static void swap_jumps(Run *r, const Target *column)
{
    for (int i = 0; i < r->e->n_signals; i++) {
        if (!jumps(r, i) || !delays(column, i)) continue;
        const double after = r->u0[i];
        r->u0[i] = r->u_before[i];
        r->u_before[i] = after;
    }
}

/* f at r->t with those inputs that a column delays as they were before they jumped. */
static int slope_before(Run *r, const Target *column, double *to)
{
    swap_jumps(r, column);
    int status = inputs_jump(r, r->t);
    if (!is_error(status)) status = rhs(r, r->t, r->x, to);
    swap_jumps(r, column);
    return status;
}

/* Inputs jumped at r->t, from r->u_before and the slope r->f1 to the slope r->f: for the columns that delay some of them
 * these jump later. have_f is cleared where the FMU stood elsewhere. */
int delay_jump(Run *r, int *have_f)
{
    int moved = 0, status = FMI_OK;
    for (int k = 0; k < r->q && !is_error(status); k++) {
        const Target *column = &r->column_target[k];
        const double *before = r->f1;
        int own = 0, others = 0;
        for (int i = 0; i < r->e->n_signals; i++) {
            if (!jumps(r, i)) continue;
            own |= delays(column, i);
            others |= !delays(column, i);
        }
        if (!own) continue;
        if (others) {
            moved = 1;
            before = r->u;
            status = slope_before(r, column, r->u);
        }
        for (int i = 0; i < r->n; i++) r->s[i * r->ld + k] += before[i] - r->f[i];
    }
    if (!moved || is_error(status)) return status;
    *have_f = 0;
    return inputs_jump(r, r->t);
}

/* An input that jumps at the first sample already moves its delay's column: x(t0) waits for it. */
static int delay_at_start(Run *r)
{
    const Target all = {.kind = TARGET_DELAY, .a = -1};
    int any = 0, have_f = 1;
    for (int i = 0; i < r->e->n_signals; i++) {
        r->u_before[i] = inputs_before(r, i);
        for (int c = 0; c < r->q; c++) any |= jumps(r, i) && delays(&r->column_target[c], i);
    }
    if (!any || !r->n) return FMI_OK;
    int status = slope_before(r, &all, r->f1);
    if (!is_error(status)) status = inputs_jump(r, r->t);
    if (!is_error(status)) status = rhs(r, r->t, r->x, r->f);
    return is_error(status) ? status : delay_jump(r, &have_f);
}

/* Sets S(t0). Returns an outcome. */
int sensitivity_begin(Run *r)
{
    for (int j = 0; j < r->q; j++) r->column_target[j] = r->e->targets[r->active[j]];
    memset(r->s_largest, 0, sizeof *r->s_largest * (size_t)r->ld);
    for (int i = 0; i < r->n; i++)
        for (int k = 0; k < r->ld; k++) r->s[i * r->ld + k] = k < r->q ? r->s0[i * r->q + k] : 0.0;
    return is_error(delay_at_start(r)) ? AB_MODEL_ERROR : AB_OK;
}

/* What moves with the columns beside the states: parameters, and signals. Their references go behind the first `known` ones
 * of r->seed_reference. Returns how many there are in all. */
int moving_variables(Run *r, int known)
{
    int *column = r->known_column;
    for (int k = 0; k < r->q; k++)
        if (r->column_target[k].kind == TARGET_PARAMETER && !acts_apart(r->problem, &r->column_target[k])) {
            r->seed_reference[known++] = (fmi_reference)r->column_target[k].a;
            *column++ = k;
        }
    for (int signal = 0; signal < r->e->n_signals; signal++) {
        int moved = 0;
        for (int k = 0; k < r->q; k++) moved |= input_by(r, signal, k) != 0.0;
        if (!moved) continue;
        r->seed_reference[known++] = r->u_reference[signal];
        *column++ = -1 - signal;
    }
    return known;
}

/* Adds to a row over the columns what such variables add, by the derivatives by them. */
void add_moving(const Run *r, const double *by, int count, double *row)
{
    for (int j = 0; j < count; j++) {
        const int column = r->known_column[j];
        if (column >= 0) row[column] += by[j];
        for (int k = 0; column < 0 && k < r->q; k++) {
            const double moved = input_by(r, -1 - column, k);
            if (moved != 0.0) row[k] += moved * by[j];
        }
    }
}

/* B where the FMU stands. */
int sensitivity_slopes(Run *r, double *b)
{
    const int n = r->n, ld = r->ld, count = moving_variables(r, 0);
    memset(b, 0, sizeof *b * (size_t)(n * ld));
    const int status = derivative_columns(r, r->problem->derivative_reference, (size_t)n, r->seed_reference, (size_t)count,
                                          r->columns);
    for (int i = 0; i < n && !is_error(status); i++) add_moving(r, r->columns + i * count, count, b + i * ld);
    return status;
}

/* A and B at one of the four points; the FMU stands at (t, x) already. jac is a known A, or NULL. */
int sensitivity_node(Run *r, int index, double t, const double *x, const double *jac)
{
    const int n = r->n;
    double *a = r->a_node + index * n * n;
    if (jac)
        memcpy(a, jac, sizeof *a * (size_t)(n * n));
    else {
        const int status = jacobian(r, t, x, NULL, a);
        if (is_error(status)) return status;
    }
    return sensitivity_slopes(r, r->b_node + index * n * r->ld);
}

/* Share of the largest that a column has been so far which it counts for at least: what it has died away to, where an
 * input rests, is rounding, and no step is small enough for that. */
#define LEAST_SHARE 0.1

/* Error of the worst column from r->s to r->s1, each in units of its own size. */
double sensitivity_error(Run *r, const double *v)
{
    const int n = r->n, ld = r->ld;
    const double rtol = 100.0 * r->rtol;
    double worst = 0.0;
    for (int k = 0; k < r->q; k++) {
        double before = 0.0, after = 0.0, sum = 0.0;
        for (int i = 0; i < n; i++) {
            before = larger(before, fabs(r->s[i * ld + k]) / r->nominal[i]);
            after = larger(after, fabs(r->s1[i * ld + k]) / r->nominal[i]);
        }
        r->s_largest[k] = larger(r->s_largest[k], before);
        const double size = larger(larger(before, after), LEAST_SHARE * r->s_largest[k]);
        /* A column that has died away (that of a start, long ago) is about to leave the range of numbers. */
        if (size < 1e-200) continue;
        for (int i = 0; i < n; i++) {
            const double scale = larger(fabs(r->s[i * ld + k]), fabs(r->s1[i * ld + k])) + size * r->nominal[i];
            const double e = v[i * ld + k] / (rtol * scale);
            sum += e * e;
        }
        if (!(sum < INFINITY)) return NAN;
        worst = larger(worst, sum / (double)n);
    }
    return sqrt(worst);
}

/* The entries of A that are not zero at all four points, row by row, with their four values. */
static int pack_jacobians(Run *r)
{
    const int n = r->n;
    const double *a = r->a_node;
    Sparse *out = &r->a_now;
    int filled = 0;
    out->n = n;
    for (int i = 0; i < n; i++) {
        out->start[i] = filled;
        for (int j = 0; j < n; j++) {
            const int at = i * n + j;
            const double v0 = a[at], v1 = a[at + n * n], v2 = a[at + 2 * n * n], v3 = a[at + 3 * n * n];
            if (v0 == 0.0 && v1 == 0.0 && v2 == 0.0 && v3 == 0.0) continue;
            double *to = r->a_packed + 4 * filled;
            to[0] = v0, to[1] = v1, to[2] = v2, to[3] = v3;
            out->col[filled++] = j;
        }
    }
    out->start[n] = filled;
    return filled;
}

static void interpolate_jacobian(Run *r, int entries, const double *w)
{
    for (int k = 0; k < entries; k++) {
        const double *a = r->a_packed + 4 * k;
        r->a_now.val[k] = w[0] * a[0] + w[1] * a[1] + w[2] * a[2] + w[3] * a[3];
    }
}

/* B at a point of the step: the combination of its four values. */
static void combine_nodes(Run *r, double *out, const double *w, int64_t size)
{
    for (int64_t i = 0; i < size; i++)
        out[i] = w[0] * r->b_node[i] + w[1] * r->b_node[size + i] + w[2] * r->b_node[2 * size + i] +
                 w[3] * r->b_node[3 * size + i];
}

/* The continuous extension, for the rows that samples read or for all. */
static void extend(Run *r, int all)
{
    const int64_t ld = r->ld, size = (int64_t)r->n * ld;
    for (int i = 0; i < r->n; i++) {
        int wanted = all || r->e->n_other > 0;
        for (int64_t o = 0; o < r->e->m && !wanted; o++) wanted = r->e->output_state[o] == i;
        const int64_t at = i * ld;
        if (wanted) continuous_extension(r->sdense + at, size, r->s + at, r->s1 + at, r->sv + at, ld);
    }
}

/* The step of the state has been accepted: r->factors are its own, r->dense its continuous extension, points 0 and 3
 * are filled. Leaves S(t + root h) in r->s1 and its continuous extension in r->sdense. Returns the error, NAN for
 * failure. */
double sensitivity_step(Run *r, double h, double root)
{
    const int n = r->n, ld = r->ld;
    const int64_t size = (int64_t)n * ld;
    static const double first[4] = {1.0, 0.0, 0.0, 0.0}, last[4] = {0.0, 0.0, 0.0, 1.0};
    r->status = FMI_OK;
    for (int k = 1; k < 3; k++) {
        for (int i = 0; i < n; i++) kernel_horner(r->dense + i, n, &node[k], 1, r->u + i);
        r->status = set_point(r, r->t + node[k] * h, r->u);
        if (is_error(r->status)) return NAN;
        r->status = sensitivity_node(r, k, r->t + node[k] * h, r->u, NULL);
        if (is_error(r->status)) return NAN;
    }
    double w[8];
    const int entries = pack_jacobians(r);
    /* g_dot = A'(t_n) S + B'(t_n), per unit of fraction */
    combine_nodes(r, r->g_dot, slope_at_0, size);
    interpolate_jacobian(r, entries, slope_at_0);
    kernel_multiply(r->g_dot, &r->a_now, r->s, ld, ld);
    const double *u = r->s;
    for (int stage = 0; stage < STAGES; stage++) {
        double *v = r->sv + stage * size;
        const double *b = r->b_now;
        if (stage == 0) {
            interpolate_jacobian(r, entries, first);
            b = r->b_node;
        } else if (rodas5p.alpha[stage] == 1.0) {
            if (rodas5p.alpha[stage - 1] != 1.0) interpolate_jacobian(r, entries, last);
            b = r->b_node + 3 * size;
        } else {
            cubic_weights(rodas5p.alpha[stage], w);
            interpolate_jacobian(r, entries, w);
            combine_nodes(r, r->b_now, w, size);
        }
        if (stage) {
            kernel_combine(r->su, r->s, rodas5p.a[stage], stage, r->sv, size, size);
            u = r->su;
        }
        for (int j = 0; j < stage; j++) w[j] = rodas5p.c[stage][j] / h;
        kernel_combine(v, b, w, stage, r->sv, size, size);
        kernel_multiply(v, &r->a_now, u, ld, ld);
        if (rodas5p.d[stage] != 0.0) kernel_combine(v, v, &rodas5p.d[stage], 1, r->g_dot, 0, size);
        kernel_solve(&r->factors, r->pivot, v, ld, ld);
    }
    const double *end = r->sv + (STAGES - 1) * size;
    for (int64_t i = 0; i < size; i++) r->s1[i] = r->su[i] + end[i];
    const double error = sensitivity_error(r, end);
    if (!(error <= 1.0)) return error;
    extend(r, root < 1.0);
    for (int64_t i = 0; i < size && root < 1.0; i++)
        kernel_horner(r->sdense + i, (int)size, &root, 1, r->s1 + i);
    return error;
}
