/* Outputs that are no states: asked of the FMU at every sample, or, where a step spans many samples, at a few Chebyshev
 * points of it with a polynomial between them. As many points again, between those, tell whether the polynomial is as
 * good as the step itself; where it is not, the piece is halved. */
#include "lanes.h"

enum { NODES = 6, POINTS = PIECE_POINTS, SHORT = 22 };

/* cos(pi (1 - k / 10)): even ones carry the polynomial, odd ones check it. */
static const double point[POINTS] = {
    -1.0, -0.9510565162951535, -0.8090169943749475, -0.5877852522924731, -0.30901699437494745, 0.0,
    0.30901699437494745, 0.5877852522924731, 0.8090169943749475, 0.9510565162951535, 1.0};

/* Lagrange's polynomials of the even points. */
static void lagrange(double x, double *w)
{
    double sum = 0.0;
    for (int i = 0; i < NODES; i++) {
        const double away = x - point[2 * i];
        if (away == 0.0) {
            memset(w, 0, sizeof *w * NODES);
            w[i] = 1.0;
            return;
        }
        w[i] = (i % 2 ? -1.0 : 1.0) * (i == 0 || i == NODES - 1 ? 0.5 : 1.0) / away;
        sum += w[i];
    }
    for (int i = 0; i < NODES; i++) w[i] /= sum;
}

/* Values at (t, x): that of output o to y[o * stride]. */
int read_values(Run *r, double t, const double *x, double *y, int64_t stride)
{
    Fmu *f = r->fmu;
    const Experiment *e = r->e;
    if (r->lane) return lane_values(r, t, x, y, stride);
    int status = set_point(r, t, x);
    if (!is_error(status) && r->n_other)
        status = f->get_real(f->instance, r->other_reference, (size_t)r->n_other, r->other);
    if (is_error(status)) return status;
    for (int64_t o = 0, next = 0; o < e->m; o++) {
        if (e->output_state[o] >= 0) continue;
        if (e->output_kind[o] == 0) {
            y[o * stride] = r->other[next++];
            continue;
        }
        int whole = 0;
        int (*get)(fmi_component, const fmi_reference *, size_t, int *) =
            e->output_kind[o] == 1 ? f->get_integer : f->get_boolean;
        if (!get || is_error(get(f->instance, &e->output_reference[o], 1, &whole))) return FMI_ERROR;
        y[o * stride] = whole;
    }
    return FMI_OK;
}

/* dy/dp where the FMU stands: y_x S + y_p + y_u u_p, one call a column; the row of output o to to[o * stride]. */
static int read_sensitivities(Run *r, const double *s, double *to, int64_t stride)
{
    const Experiment *e = r->e;
    const int n = r->n;
    for (int k = 0; k < r->q; k++) {
        const Target *target = &r->column_target[k];
        int known = n;
        for (int i = 0; i < n; i++) {
            r->seed_reference[i] = r->problem->state_reference[i];
            r->seed[i] = s[i * r->ld + k];
        }
        if (target->kind == TARGET_PARAMETER) {
            r->seed_reference[known] = (fmi_reference)target->a;
            r->seed[known++] = 1.0;
        }
        for (int i = 0; i < e->n_signals; i++) {
            if (!delays(target, i) || r->slope[i] == 0.0) continue;
            r->seed_reference[known] = r->u_reference[i];
            r->seed[known++] = -r->slope[i];
        }
        int moves = 0;
        for (int i = 0; i < known; i++) moves |= r->seed[i] != 0.0;
        if (!moves) memset(r->other, 0, sizeof *r->other * (size_t)r->n_other);
        if (r->n_other && moves) {
            const int status = r->fmu->directional(r->fmu->instance, r->other_reference, (size_t)r->n_other,
                                                   r->seed_reference, (size_t)known, r->seed, r->other);
            if (is_error(status)) return status;
        }
        for (int64_t o = 0, next = 0; o < e->m; o++)
            if (e->output_state[o] < 0) to[o * stride + k] = e->output_kind[o] == 0 ? r->other[next++] : 0.0;
    }
    return FMI_OK;
}

/* Both at a fraction of the step. */
static int read_outputs(Run *r, double t, double fraction, double *y, int64_t y_stride, double *s, int64_t s_stride)
{
    const int n = r->n;
    const int64_t size = (int64_t)n * r->ld;
    for (int i = 0; i < n; i++) kernels->horner(r->dense + i, n, &fraction, 1, r->u + i);
    const int status = read_values(r, t, r->u, y, y_stride);
    if (is_error(status) || !r->q) return status;
    kernels->dense_rows(r->su, r->sdense, size, &fraction, 1, size, size);
    return read_sensitivities(r, r->su, s, s_stride);
}

/* Whether the polynomial meets the odd points of `columns` series side by side, each to a tolerance times its size;
 * `w` has its weights there, a row a point. */
static int polynomial_fits(const double *w, const double *v, int64_t columns, int64_t stride, double tolerance)
{
    for (int64_t j = 0; j < columns; j++) {
        double size = 0.0;
        for (int k = 0; k < POINTS; k++) size = larger(size, fabs(v[k * stride + j]));
        for (int k = 1; k < POINTS; k += 2) {
            double off = -v[k * stride + j];
            for (int i = 0; i < NODES; i++) off += w[k / 2 * NODES + i] * v[2 * i * stride + j];
            if (!(fabs(off) <= tolerance * size)) return 0;
        }
    }
    return 1;
}

/* Samples `from` on, by a polynomial over all of them; 0 where it is not good enough. */
static int interpolate(Run *r, const double *time, int64_t from, int64_t count, int *status)
{
    const Experiment *e = r->e;
    Sink *sink = &r->sink;
    const int64_t ld = r->ld, wide = e->m * ld;
    const double first = r->fraction[from], middle = 0.5 * (first + r->fraction[from + count - 1]);
    const double half = middle - first, t0 = time[from], t1 = time[from + count - 1];
    for (int k = 0; k < POINTS; k++) {
        const double t = 0.5 * (t0 + t1) + 0.5 * (t1 - t0) * point[k];
        *status = read_outputs(r, t, middle + half * point[k], r->piece_y + k * e->m, 1, r->piece_s + k * wide, ld);
        if (is_error(*status)) return 0;
    }
    double check[POINTS / 2 * NODES];
    for (int k = 1; k < POINTS; k += 2) lagrange(point[k], check + k / 2 * NODES);
    for (int64_t o = 0; o < e->m; o++)
        if (e->output_state[o] < 0 && (!polynomial_fits(check, r->piece_y + o, 1, e->m, r->rtol) ||
                                       !polynomial_fits(check, r->piece_s + o * ld, r->q, wide, 100.0 * r->rtol)))
            return 0;
    for (int64_t i = 0; i < count; i++) {
        double w[NODES], x = (r->fraction[from + i] - middle) / half;
        lagrange(x, w);
        const int64_t at = sink->filled + from + i;
        for (int64_t o = 0; o < e->m; o++) {
            if (e->output_state[o] >= 0) continue;
            double y = 0.0, *s = sink->s + (o * BLOCK + at) * ld;
            for (int k = 0; k < NODES; k++) y += w[k] * r->piece_y[2 * k * e->m + o];
            sink->y[o * BLOCK + at] = y;
            if (!r->q) continue;
            memset(s, 0, sizeof *s * (size_t)ld);
            kernels->combine(s, s, w, NODES, r->piece_s + o * ld, 2 * wide, ld);
        }
    }
    return 1;
}

/* The next `count` samples of the sink's block, at r->fraction of the step. */
int read_samples(Run *r, const double *time, int64_t count)
{
    const Experiment *e = r->e;
    Sink *sink = &r->sink;
    int status = FMI_OK, smooth = r->n > 0;
    for (int64_t o = 0; o < e->m; o++) smooth &= e->output_state[o] >= 0 || e->output_kind[o] == 0;
    for (int64_t k = 0; k < count;) {
        const int64_t piece = count - k < r->piece ? count - k : r->piece;
        if (smooth && piece >= SHORT && r->fraction[k + piece - 1] > r->fraction[k]) {
            if (interpolate(r, time, k, piece, &status)) {
                k += piece;
                if (r->piece < BLOCK) r->piece *= 2;
                continue;
            }
            if (is_error(status)) return status;
            if (r->piece > SHORT) {
                r->piece /= 2;
                continue;
            }
        }
        for (const int64_t end = k + piece; k < end; k++) {
            const int64_t at = sink->filled + k;
            status = read_outputs(r, time[k], r->fraction[k], sink->y + at, BLOCK, sink->s + at * r->ld, BLOCK * r->ld);
            if (is_error(status)) return status;
        }
    }
    return FMI_OK;
}
