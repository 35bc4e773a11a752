/* Readings that come late: what a sample shows of a state is its value before the delay, from the step that passed there, and
 * the state's rate there makes the derivative by the delay. They are found ahead of the samples that the sink holds, and kept
 * until it takes them. Before the start the state was what it is there. */
#include "engine.h"

/* At the first sample. */
int late_begin(Run *r)
{
    const Experiment *e = r->e;
    int status = FMI_OK;
    for (int64_t o = 0, j = 0; j < e->n_late && !is_error(status); o++) {
        if (!comes_late(r->problem, e, o)) continue;
        const fmi_reference *delay = r->problem->operators[e->output_operator[o]].reference;
        Late *l = &r->late[j];
        *l = (Late){.output = o, .column = -1, .y = r->late_y + j * e->n, .s = r->late_s + j * e->n * r->ld};
        status = r->fmu->get_real(r->fmu->instance, delay, 1, &l->delay);
        l->delay = larger(l->delay, 0.0);
        for (int k = 0; k < r->q; k++) {
            const Target *t = &e->targets[r->active[k]];
            if (t->kind == TARGET_PARAMETER && (fmi_reference)t->a == *delay) l->column = k;
        }
        j++;
    }
    return status;
}

/* An output that shows next what was at a time before `limit`; NULL where there is none. */
Late *late_due(Run *r, double limit, double *time)
{
    const Experiment *e = r->e;
    for (int j = 0; j < e->n_late; j++) {
        Late *l = &r->late[j];
        if (l->next == e->n) continue;
        *time = e->time[l->next] - l->delay;
        if (*time < limit) return l;
    }
    return NULL;
}

/* Its value at a fraction of the continuous extension over h. */
static void take_late(Run *r, Late *l, double fraction, double h)
{
    const int n = r->n, i = r->e->output_state[l->output];
    const double *c = r->dense + i, *time = r->e->time;
    kernel_horner(c, n, &fraction, 1, l->y + l->next);
    if (r->q) {
        double *s = l->s + l->next * r->ld;
        kernel_dense_rows(s, r->sdense + i * r->ld, (int64_t)n * r->ld, &fraction, 1, r->q, r->ld);
        const double change = c[n] + fraction * (2.0 * c[2 * n] + fraction * (3.0 * c[3 * n] + fraction * 4.0 * c[4 * n]));
        if (l->column >= 0 && time[l->next] - l->delay > time[0]) s[l->column] -= change / h;
    }
    l->next++;
}

/* Those before `limit`, over (r->t, r->t + h). */
void late_emit(Run *r, double h, double limit)
{
    double time;
    for (Late *l; (l = late_due(r, limit, &time));) take_late(r, l, larger((time - r->t) / h, 0.0), h);
}

/* One by the states in r->dense, which are those at its time. */
int late_emit_here(Run *r, Late *l, double time)
{
    const int status = l->column < 0 ? FMI_OK : rhs(r, larger(time, r->t), r->dense, r->dense + r->n);
    if (!is_error(status)) take_late(r, l, 0.0, 1.0);
    return status;
}

/* To the samples that the sink holds. */
void late_to_sink(Run *r)
{
    const Sink *k = &r->sink;
    const size_t count = (size_t)k->filled, ld = (size_t)r->ld;
    for (int j = 0; j < r->e->n_late; j++) {
        const Late *l = &r->late[j];
        memcpy(k->y + l->output * BLOCK, l->y + k->first, sizeof *k->y * count);
        if (r->q) memcpy(k->s + l->output * BLOCK * r->ld, l->s + k->first * r->ld, sizeof *k->s * count * ld);
    }
}
