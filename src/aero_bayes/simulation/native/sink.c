/* Where samples go. Outputs that are states are read from the continuous extension; others see outputs.c.
 * Blocks of samples end in a trajectory, a likelihood or Gauss-Newton products. */
#include "engine.h"

void sink_begin(Run *r, int mode, const double *noise)
{
    Sink *k = &r->sink;
    const Experiment *e = r->e;
    k->mode = r->mode = mode;
    k->filled = k->first = 0;
    k->cost = k->log_det = 0.0;
    k->used = 0;
    r->sample = 0;
    r->piece = BLOCK;
    if (mode == MODE_TRAJECTORY || filters(r)) return;
    for (int64_t i = 0; i < e->m; i++) filter_begin(&k->filter[i], noise + 3 * i, e->spacing);
    memset(k->filter_mean, 0, sizeof(double) * (size_t)(e->m * r->ld));
    memset(k->gradient, 0, sizeof(double) * (size_t)r->ld);
    memset(k->hessian, 0, sizeof(double) * (size_t)(r->ld * r->ld));
}

static void flush_trajectory(Run *r)
{
    Sink *k = &r->sink;
    const int64_t m = r->e->m;
    for (int64_t o = 0; o < m; o++)
        for (int64_t i = 0; i < k->filled; i++)
            k->trajectory[(k->first + i) * m + o] = k->y[o * BLOCK + i];
    int sorted = 1;
    for (int j = 0; j < r->q; j++) sorted &= r->order[j] == j;
    for (int64_t o = 0; r->q && o < m; o++)
        for (int64_t i = 0; i < k->filled; i++) {
            const double *from = k->s + (o * BLOCK + i) * r->ld;
            double *to = k->sensitivity + ((k->first + i) * m + o) * r->q;
            if (sorted)
                memcpy(to, from, sizeof *to * (size_t)r->q);
            else
                for (int j = 0; j < r->q; j++) to[r->order[j]] = from[j];
        }
}

static void flush_output(Run *r, int64_t o)
{
    Sink *k = &r->sink;
    const Experiment *e = r->e;
    Filter *f = &k->filter[o];
    const double *measured = e->measured + o * e->n + k->first;
    double *s = k->s + o * BLOCK * r->ld;
    const int64_t used = kernels->residual(k->y + o * BLOCK, measured, k->filled, k->residual);
    const double *seen = used == k->filled ? NULL : measured;
    const int64_t q = r->q;
    double mean = f->mean;
    k->used += used;
    if (e->spread) { /* what follows sees readings whose noise is equally large */
        const double *spread = e->spread + o * e->n + k->first;
        for (int64_t i = 0; i < k->filled; i++) {
            if (seen && seen[i] != seen[i]) continue;
            k->log_det += log(spread[i]);
            k->residual[i] /= spread[i];
            for (int64_t j = 0; j < q; j++) s[i * r->ld + j] /= spread[i];
        }
    }
    if (f->stationary > 0.0) {
        filter_gains(f, e->time + k->first, seen, k->filled, e->spacing, k->gain, k->decay, k->weight, &k->log_det);
        f->mean = kernels->colour(k->residual, k->filled, k->gain, k->decay, k->weight, mean);
        k->cost += 0.5 * kernels->square(k->residual, k->filled);
        if (q) kernels->colour_rows(s, k->filled, q, r->ld, k->gain, k->decay, k->weight, k->filter_mean + o * r->ld);
    } else {
        const double weight = 1.0 / sqrt(f->white);
        k->log_det += 0.5 * (double)used * (1.8378770664093454836 + log(f->white));
        k->cost += 0.5 * kernels->square(k->residual, k->filled) / f->white;
        for (int64_t i = 0; q && i < k->filled; i++) {
            const double w = seen && seen[i] != seen[i] ? 0.0 : weight;
            for (int64_t j = 0; j < q; j++) s[i * r->ld + j] *= w;
            k->residual[i] *= weight;
        }
    }
    if (q) {
        kernels->gradient(k->gradient, s, k->residual, k->filled, q, r->ld);
        kernels->syrk(k->hessian, s, k->filled, q, r->ld);
    }
}

void sink_flush(Run *r)
{
    Sink *k = &r->sink;
    if (!k->filled) return;
    for (int64_t o = 0; k->kept && o < r->e->m; o++)
        memcpy(k->kept + o * r->e->n + k->first, k->y + o * BLOCK, sizeof *k->y * (size_t)k->filled);
    if (k->mode == MODE_TRAJECTORY)
        flush_trajectory(r);
    else
        for (int64_t o = 0; o < r->e->m; o++) flush_output(r, o);
    k->first += k->filled;
    k->filled = 0;
}

/* Samples before `limit` (or at it too), from the continuous extension over (r->t, r->t + h). */
int emit_until(Run *r, double h, double limit, int inclusive)
{
    const Experiment *e = r->e;
    Sink *sink = &r->sink;
    const int n = r->n, ld = r->ld, degree = method->dense;
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
            kernels->horner(r->dense + i, n, degree, r->fraction, count, sink->y + o * BLOCK + sink->filled);
            if (r->q)
                kernels->dense_rows(sink->s + (o * BLOCK + sink->filled) * ld, r->sdense + i * ld, size, degree,
                                    r->fraction, count, r->q, ld);
        }
        if (e->n_other) {
            const int status = read_samples(r, time, count);
            if (is_error(status)) return status;
        }
        sink->filled += count;
        r->sample += count;
        if (sink->filled == BLOCK) sink_flush(r);
    }
    return FMI_OK;
}
