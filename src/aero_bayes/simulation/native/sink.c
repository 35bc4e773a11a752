/* Where samples go. Outputs that are states are read from the continuous extension; others
 * are asked of the FMU at every sample, or, where a step spans many samples, at a few Chebyshev points of it with a
 * polynomial between them. As many points again, between those, tell whether the polynomial is as good as the step
 * itself; where it is not, the piece is halved. Blocks of samples end in a trajectory or a likelihood.
 *
 * The noise of one output is Gaussian: white plus an Ornstein-Uhlenbeck process, as a scalar innovations (Kalman) filter.
 * State space form of a first-order process: S. Sarkka, Bayesian Filtering and Smoothing (2013), ch. 4; on a uniform
 * grid the gain converges to its steady value, which the discrete Riccati equation gives in closed form. */
#include "engine.h"

static void filter_begin(Filter *f, const double *noise, double spacing)
{
    memset(f, 0, sizeof *f);
    f->white = noise[0] * noise[0];
    f->stationary = noise[1] * noise[1];
    f->tau = noise[2];
    if (!(f->tau > 0.0) && f->stationary > 0.0) { /* no memory: just more white noise */
        f->white += f->stationary;
        f->stationary = 0.0;
    }
    f->variance = f->stationary;
    f->first = 1;
    f->phi = spacing > 0.0 && f->stationary > 0.0 ? exp(-spacing / f->tau) : 0.0;
    f->p_steady = -1.0;
    if (spacing > 0.0 && f->stationary > 0.0) {
        /* P = phi^2 P R / (P + R) + Q  =>  P^2 + P (R - phi^2 R - Q) - Q R = 0 */
        const double r = f->white, q = -f->stationary * expm1(-2.0 * spacing / f->tau);
        const double b = r * -expm1(-2.0 * spacing / f->tau) - q;
        const double root = sqrt(b * b + 4.0 * q * r);
        f->p_steady = b > 0.0 ? 2.0 * q * r / (b + root) : 0.5 * (root - b);
    }
}

/* Gains for the next samples; `measured` may be NULL for "all there". Returns the number of samples used. */
static int64_t filter_gains(Filter *f, const double *time, const double *measured, int64_t count, double spacing,
                            double *gain, double *decay, double *weight, double *log_det)
{
    int64_t used = 0, k = 0;
    double sum = 0.0;
    while (k < count) {
        if (f->steady && spacing > 0.0) {
            const double total = f->p_steady + f->white, g = f->p_steady / total, w = 1.0 / sqrt(total);
            const int64_t from = k;
            while (k < count && !(measured && measured[k] != measured[k])) {
                gain[k] = g;
                decay[k] = f->phi;
                weight[k] = w;
                k++;
            }
            used += k - from;
            sum += 0.5 * (double)(k - from) * (LOG_2PI + log(total));
            f->variance = f->p_steady * f->white / total;
            if (k == count) break;
            f->steady = 0;
        }
        double phi = f->phi, p = f->variance;
        if (f->first) {
            phi = 0.0;
            p = f->stationary;
            f->first = 0;
        } else {
            if (!(spacing > 0.0)) {
                const double dt = time[k] - f->last_time;
                if (dt != f->last_dt) {
                    f->last_dt = dt;
                    f->last_phi = exp(-dt / f->tau);
                }
                phi = f->last_phi;
            }
            p = phi * phi * p + f->stationary * (1.0 - phi * phi);
        }
        if (!(spacing > 0.0)) f->last_time = time[k];
        decay[k] = phi;
        if (measured && measured[k] != measured[k]) {
            gain[k] = weight[k] = 0.0;
            f->variance = p;
        } else {
            const double total = p + f->white;
            gain[k] = p / total;
            weight[k] = 1.0 / sqrt(total);
            sum += 0.5 * (LOG_2PI + log(total));
            used++;
            f->variance = p * f->white / total;
            if (f->p_steady >= 0.0 && fabs(p - f->p_steady) <= 1e-14 * f->p_steady) f->steady = 1;
        }
        k++;
    }
    *log_det += sum;
    return used;
}

/* Rows (k, n) in place to innovations over their standard deviation, whose inverse goes to weight (noises, n). Either
 * one noise holds for all rows or each row has its own; `mean` is k zeros. Times count where spacing is zero. */
EXPORT void ab_whiten(const double *time, double spacing, int64_t n, const double *noise, int64_t noises, double *rows,
                      int64_t k, double *mean, double *weight)
{
    enum { PART = 512 };
    double gain[PART], decay[PART], log_det = 0.0;
    const int64_t share = noises == 1 ? k : 1;
    for (int64_t i = 0; i < noises; i++) {
        Filter f;
        filter_begin(&f, noise + 3 * i, spacing);
        for (int64_t first = 0; first < n; first += PART) {
            const int64_t count = n - first < PART ? n - first : PART;
            double *w = weight + i * n + first;
            filter_gains(&f, time + first, NULL, count, spacing, gain, decay, w, &log_det);
            for (int64_t r = i * share; r < (i + 1) * share; r++)
                mean[r] = kernel_colour(rows + r * n + first, count, gain, decay, w, mean[r]);
        }
    }
}

void sink_begin(Run *r, int mode, const double *noise)
{
    Sink *k = &r->sink;
    const Experiment *e = r->e;
    k->mode = r->mode = mode;
    k->filled = k->first = 0;
    k->cost = k->log_det = 0.0;
    r->sample = 0;
    r->piece = BLOCK;
    if (mode == MODE_TRAJECTORY || filters(r)) return;
    for (int64_t i = 0; i < e->m; i++) filter_begin(&k->filter[i], noise + 3 * i, e->spacing);
}

static void flush_trajectory(Run *r)
{
    Sink *k = &r->sink;
    const int64_t m = r->e->m;
    for (int64_t o = 0; o < m; o++)
        for (int64_t i = 0; i < k->filled; i++)
            k->trajectory[(k->first + i) * m + o] = k->y[o * BLOCK + i];
    for (int64_t o = 0; r->q && o < m; o++)
        for (int64_t i = 0; i < k->filled; i++)
            memcpy(k->sensitivity + ((k->first + i) * m + o) * r->q, k->s + (o * BLOCK + i) * r->ld,
                   sizeof *k->s * (size_t)r->q);
}

static void flush_output(Run *r, int64_t o)
{
    Sink *k = &r->sink;
    const Experiment *e = r->e;
    Filter *f = &k->filter[o];
    const double *measured = e->measured + o * e->n + k->first;
    const int64_t used = kernel_residual(k->y + o * BLOCK, measured, k->filled, k->residual);
    const double *seen = used == k->filled ? NULL : measured;
    if (e->spread) { /* what follows sees readings whose noise is equally large */
        const double *spread = e->spread + o * e->n + k->first;
        for (int64_t i = 0; i < k->filled; i++) {
            if (seen && seen[i] != seen[i]) continue;
            k->log_det += log(spread[i]);
            k->residual[i] /= spread[i];
        }
    }
    if (f->stationary > 0.0) {
        filter_gains(f, e->time + k->first, seen, k->filled, e->spacing, k->gain, k->decay, k->weight, &k->log_det);
        f->mean = kernel_colour(k->residual, k->filled, k->gain, k->decay, k->weight, f->mean);
        k->cost += 0.5 * kernel_square(k->residual, k->filled);
    } else {
        k->log_det += 0.5 * (double)used * (LOG_2PI + log(f->white));
        k->cost += 0.5 * kernel_square(k->residual, k->filled) / f->white;
    }
}

/* The block as it is. */
void sink_pass_on(Run *r)
{
    Sink *k = &r->sink;
    for (int64_t o = 0; k->kept && o < r->e->m; o++)
        memcpy(k->kept + o * r->e->n + k->first, k->y + o * BLOCK, sizeof *k->y * (size_t)k->filled);
    if (k->mode == MODE_TRAJECTORY)
        flush_trajectory(r);
    else
        for (int64_t o = 0; o < r->e->m; o++) flush_output(r, o);
    k->first += k->filled;
    k->filled = 0;
}

int sink_flush(Run *r)
{
    if (!r->sink.filled) return FMI_OK;
    late_to_sink(r);
    const int status = operators_on_outputs(r);
    if (!is_error(status)) sink_pass_on(r);
    return status;
}

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

/* The same as read_sensitivities where the FMU has no function for all columns at once. */
static int read_one_by_one(Run *r, const double *s, int known, double *to, int64_t stride)
{
    const Experiment *e = r->e;
    for (int k = 0; k < r->q; k++) {
        int moves = 0;
        for (int j = 0; j < known; j++) {
            const int column = j < r->n ? 0 : r->known_column[j - r->n];
            r->seed[j] = j < r->n ? s[j * r->ld + k] : column >= 0 ? column == k : input_by(r, -1 - column, k);
            moves |= r->seed[j] != 0.0;
        }
        memset(r->other, 0, sizeof *r->other * (size_t)r->n_other);
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

/* dy/dp where the FMU stands: y_x S + y_p + y_u u_p; the row of output o to to[o * stride]. */
static int read_sensitivities(Run *r, const double *s, double *to, int64_t stride)
{
    const Experiment *e = r->e;
    const int n = r->n;
    for (int i = 0; i < n; i++) r->seed_reference[i] = r->problem->state_reference[i];
    const int known = moving_variables(r, n);
    if (!r->fmu->columns) return read_one_by_one(r, s, known, to, stride);
    const int status = derivative_columns(r, r->other_reference, (size_t)r->n_other, r->seed_reference, (size_t)known,
                                          r->columns);
    if (is_error(status)) return status;
    const double *by = r->columns;
    for (int64_t o = 0; o < e->m; o++) {
        double *row = to + o * stride;
        if (e->output_state[o] >= 0) continue;
        memset(row, 0, sizeof *row * (size_t)r->q);
        if (e->output_kind[o]) continue;
        for (int i = 0; i < n; i++)
            for (int k = 0; by[i] != 0.0 && k < r->q; k++) row[k] += by[i] * s[i * r->ld + k];
        add_moving(r, by + n, known - n, row);
        by += known;
    }
    return FMI_OK;
}

/* Both at a fraction of the step. */
static int read_outputs(Run *r, double t, double fraction, double *y, int64_t y_stride, double *s, int64_t s_stride)
{
    const int n = r->n;
    const int64_t size = (int64_t)n * r->ld;
    for (int i = 0; i < n; i++) kernel_horner(r->dense + i, n, &fraction, 1, r->u + i);
    int status = inputs_exact(r, t);
    if (!is_error(status)) status = read_values(r, t, r->u, y, y_stride);
    if (!is_error(status) && r->q) {
        kernel_dense_rows(r->su, r->sdense, size, &fraction, 1, size, size);
        status = read_sensitivities(r, r->su, s, s_stride);
    }
    return is_error(status) ? status : inputs_as_lines(r);
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
            kernel_combine(s, s, w, NODES, r->piece_s + o * ld, 2 * wide, ld);
        }
    }
    return 1;
}

/* The next `count` samples of the sink's block, at r->fraction of the step. */
static int read_samples(Run *r, const double *time, int64_t count)
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

/* Samples before `limit` (or at it too), from the continuous extension over (r->t, r->t + h). */
int emit_until(Run *r, double h, double limit, int inclusive)
{
    const Experiment *e = r->e;
    Sink *sink = &r->sink;
    const int n = r->n, ld = r->ld;
    const int64_t size = (int64_t)n * ld;
    while (r->sample < e->n) {
        int64_t count = 0;
        const int64_t room = BLOCK - sink->filled;
        const double *time = e->time + r->sample, inverse = h > 0.0 ? 1.0 / h : 0.0;
        const int64_t left = e->n - r->sample < room ? e->n - r->sample : room;
        while (count < left && (time[count] < limit || (inclusive && time[count] <= limit))) {
            const double fraction = (time[count] - r->t) * inverse;
            r->fraction[count++] = fraction > 0.0 ? fraction : 0.0;
        }
        if (!count) return FMI_OK;
        for (int64_t o = 0; o < e->m; o++) {
            const int i = e->output_state[o];
            if (i < 0) continue;
            kernel_horner(r->dense + i, n, r->fraction, count, sink->y + o * BLOCK + sink->filled);
            if (r->q)
                kernel_dense_rows(sink->s + (o * BLOCK + sink->filled) * ld, r->sdense + i * ld, size,
                                  r->fraction, count, r->q, ld);
        }
        if (e->n_other) {
            const int status = read_samples(r, time, count);
            if (is_error(status)) return status;
        }
        sink->filled += count;
        r->sample += count;
        if (sink->filled == BLOCK) {
            const int status = sink_flush(r);
            if (is_error(status)) return status;
        }
    }
    return FMI_OK;
}
