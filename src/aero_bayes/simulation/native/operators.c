/* Laws at a recorded input, one behind the other, are operators on its signal: what they make of it is found before the
 * simulation, and the model is driven by that. Laws at an output act on its samples. They have no states of their own. A
 * model with such laws has the functions for it (laws/native/coupler.h).
 *
 * Where the input is held, one value a sample is exact. Where it is linear, u(s) over a sample, the states see y(u(s))
 * through a filter, and no more of it than its first moments over the sample: y is replaced by the line with the same two
 * (Legendre) moments, and where y bends much within a sample, as at a corner, by two lines. As u is linear, they are
 * differences of the antiderivatives of y(u) and u y(u), tabulated over the range of the input. The derivatives of y by the
 * law's parameters are treated likewise. An output that the input feeds at once is read with y itself. */
#include "engine.h"

#define BEND 0.02 /* of the range of y */

enum { MOST_INTERVALS = 2048, LEAST_INTERVALS = 256, OF_SAMPLES = 4 };

typedef struct {
    int64_t n;         /* intervals */
    double low, scale; /* of the input; x = scale * (u - low) counts intervals */
    double *first, *second; /* of each node: integrals of g dx and x g dx up to it */
} Table;

/* g(x) = g[0] + t (b + t c) in an interval, by its values at both ends and in the middle. */
static void parabola(const double *g, double *b, double *c)
{
    *c = 2.0 * (g[0] - 2.0 * g[1] + g[2]);
    *b = g[2] - g[0] - *c;
}

static int chain_of(const Run *r, const Signal *s) { return r->problem->operators[s->operator].chain; }

static int64_t interval_of(const Table *table, double x)
{
    const int64_t i = (int64_t)x;
    return i < 0 ? 0 : i >= table->n ? table->n - 1 : i;
}

static double at(const Table *table, const double *g, double x)
{
    double b, c;
    const int64_t i = interval_of(table, x);
    const double t = x - (double)i;
    parabola(g + 2 * i, &b, &c);
    return g[2 * i] + t * (b + t * c);
}

/* Both integrals over the first t of an interval. */
static void integrate(const double *g, double i, double t, double *first, double *second)
{
    double b, c;
    parabola(g, &b, &c);
    *first = t * (g[0] + t * (b / 2.0 + t * c / 3.0));
    *second = i * *first + t * t * (g[0] / 2.0 + t * (b / 3.0 + t * c / 4.0));
}

static void antiderivatives(const Table *table, const double *g)
{
    double first, second;
    table->first[0] = table->second[0] = 0.0;
    for (int64_t i = 0; i < table->n; i++) {
        integrate(g + 2 * i, (double)i, 1.0, &first, &second);
        table->first[i + 1] = table->first[i] + first;
        table->second[i + 1] = table->second[i] + second;
    }
}

static void up_to(const Table *table, const double *g, double x, double *first, double *second)
{
    const int64_t i = interval_of(table, x);
    integrate(g + 2 * i, (double)i, x - (double)i, first, second);
    *first += table->first[i];
    *second += table->second[i];
}

/* Mean of g over a sample in which x moves from a to b, and that of g (2 s - 1) with s from 0 to 1. */
static void moments(const Table *table, const double *g, double a, double b, double *mean, double *tilt)
{
    static const double node[3] = {-0.7745966692414834, 0.0, 0.7745966692414834}, weight[3] = {5.0, 8.0, 5.0};
    const double middle = 0.5 * (a + b), width = b - a;
    *mean = *tilt = 0.0;
    for (int k = 0; k < 3 && fabs(width) < 1.0; k++) { /* the differences would have lost their digits */
        const double value = weight[k] / 18.0 * at(table, g, middle + 0.5 * width * node[k]);
        *mean += value;
        *tilt += node[k] * value;
    }
    if (fabs(width) < 1.0) return;
    double first_a, second_a, first_b, second_b;
    up_to(table, g, a, &first_a, &second_a);
    up_to(table, g, b, &first_b, &second_b);
    *mean = (first_b - first_a) / width;
    *tilt = 2.0 / (width * width) * (second_b - second_a - middle * (first_b - first_a));
}

/* The line with the first two moments of g over a time in which x moves from a to b. */
static void line(const Table *table, const double *g, double a, double b, double time, double *value, double *slope)
{
    double mean, tilt;
    moments(table, g, a, b, &mean, &tilt);
    *value = mean - 3.0 * tilt;
    *slope = 6.0 * tilt / time;
}

/* Lines in all cells, by values of g over the input's range. Samples over which g bends by more than `bend` (a corner, say)
 * are two cells; where it is negative they are split as they were. Returns the number of cells. */
static int64_t fill_linear(const Table *table, const Signal *s, const double *g, double bend, unsigned char *split,
                           int64_t room, double *value)
{
    int64_t n = 1;
    double *slope = value + room;
    antiderivatives(table, g);
    for (int64_t k = 0; k + 1 < s->count; k++, n++) {
        const double a = table->scale * (s->values[k] - table->low), time = s->time[k + 1] - s->time[k];
        const double b = table->scale * (s->values[k + 1] - table->low), middle = 0.5 * (a + b);
        if (bend >= 0.0 || split[k]) {
            line(table, g, a, middle, 0.5 * time, value + n, slope + n);
            line(table, g, middle, b, 0.5 * time, value + n + 1, slope + n + 1);
            if (bend >= 0.0) split[k] = fabs(slope[n + 1] - slope[n]) * time > bend;
        }
        if (split[k])
            n++;
        else
            line(table, g, a, b, time, value + n, slope + n);
    }
    value[0] = at(table, g, table->scale * (s->values[0] - table->low));
    value[n] = at(table, g, table->scale * (s->values[s->count - 1] - table->low));
    slope[n] = 0.0;
    return n + 1;
}

static void lay_cells(const Signal *s, const unsigned char *split, Drive *d)
{
    int64_t n = 1;
    for (int64_t k = 0; k + 1 < s->count; k++) {
        d->time[n++] = s->time[k];
        if (split[k]) d->time[n++] = 0.5 * (s->time[k] + s->time[k + 1]);
    }
    d->time[n] = s->time[s->count - 1];
}

static int apply_linear(Run *r, const Signal *s, Drive *d, int n_known, const fmi_reference *known)
{
    double low = s->values[0], high = low;
    for (int64_t k = 1; k < s->count; k++) low = fmin(low, s->values[k]), high = fmax(high, s->values[k]);
    Table table = {.n = OF_SAMPLES * s->count, .low = low};
    if (table.n > MOST_INTERVALS) table.n = MOST_INTERVALS;
    if (table.n < LEAST_INTERVALS) table.n = LEAST_INTERVALS;
    table.scale = high > low ? (double)table.n / (high - low) : 0.0;
    const size_t points = (size_t)(2 * table.n + 1);
    double *memory = malloc(sizeof *memory * points * (size_t)(4 + n_known) + (size_t)s->count);
    if (!memory) return FMI_ERROR;
    double *u = memory, *g = u + points;
    unsigned char *split = (unsigned char *)(memory + points * (size_t)(4 + n_known));
    table.first = g + points * (size_t)(1 + n_known), table.second = table.first + points;
    for (size_t i = 0; i < points; i++) u[i] = low + (high - low) * (double)i / (double)(points - 1);
    const int status = r->fmu->operator_values(r->fmu->instance, chain_of(r, s), points, u, g, (size_t)n_known, known,
                                               g + points);
    if (!is_error(status)) {
        double least = g[0], most = g[0];
        for (size_t i = 1; i < points; i++) least = fmin(least, g[i]), most = fmax(most, g[i]);
        d->count = fill_linear(&table, s, g, BEND * (most - least), split, d->room, d->value);
        lay_cells(s, split, d);
        for (int k = 0; k < n_known; k++)
            fill_linear(&table, s, g + points * (size_t)(k + 1), -1.0, split, d->room, d->by[k]);
    }
    free(memory);
    return status;
}

static int apply_held(Run *r, const Signal *s, Drive *d, int n_known, const fmi_reference *known)
{
    const size_t n = (size_t)s->count;
    double *rows = malloc(sizeof *rows * n * (size_t)(n_known + 1));
    if (!rows) return FMI_ERROR;
    const int status = r->fmu->operator_values(r->fmu->instance, chain_of(r, s), n, s->values, d->value + 1,
                                               (size_t)n_known, known, rows);
    for (int k = 0; k < n_known; k++) memcpy(d->by[k] + 1, rows + (size_t)k * n, sizeof *rows * n);
    d->value[0] = d->value[1];
    for (int k = 0; k < n_known; k++) d->by[k][0] = d->by[k][1];
    free(rows);
    return status;
}

/* A linear signal as it was recorded: its value and slope, and what the law itself makes of them there, with derivatives by
 * active columns in their order to `by`. */
int operators_at(Run *r, int i, double time, double *value, double *slope, double *by)
{
    const Signal *s = &r->e->signals[i];
    const Drive *d = &r->drive[i];
    const Operator *o = &r->problem->operators[s->operator];
    int64_t k = 0, n_known = 0;
    fmi_reference known[o->n + 1];
    for (int64_t end = s->count - 1; k < end;) {
        const int64_t half = (k + end + 1) / 2;
        if (s->time[half] <= time + r->resolution)
            k = half;
        else
            end = half - 1;
    }
    const int moves = k + 1 < s->count && time >= s->time[0];
    const double rate = moves ? (s->values[k + 1] - s->values[k]) / (s->time[k + 1] - s->time[k]) : 0.0;
    const double u = s->values[k] + rate * (time - s->time[k]), step = 1e-6 * larger(fabs(u), fabs(s->values[k]));
    const double sides[2] = {u - step, u + step};
    double around[2];
    for (int64_t j = 0; j < o->n; j++)
        if (d->column_of[j] >= 0) known[n_known++] = o->reference[j];
    int status = r->fmu->operator_values(r->fmu->instance, chain_of(r, s), 2, sides, around, 0, NULL, NULL);
    if (!is_error(status))
        status = r->fmu->operator_values(r->fmu->instance, chain_of(r, s), 1, &u, value, (size_t)n_known, known, by);
    *slope = step > 0.0 ? rate * (around[1] - around[0]) / (2.0 * step) : 0.0;
    return status;
}

/* The signals as they act, for the parameters that the FMU has now; with their derivatives by active columns where they
 * are wanted. Nothing is done where it would be the same again. */
int operators_apply(Run *r, int with_columns)
{
    const Problem *p = r->problem;
    for (int i = 0; i < r->e->n_signals && p->n_driving; i++) {
        const Signal *s = &r->e->signals[i];
        Drive *d = &r->drive[i];
        if (s->operator < 0) continue;
        const Operator *o = &p->operators[s->operator];
        double now[o->n + 1];
        fmi_reference known[o->n + 1];
        int n_known = 0;
        int status = r->fmu->get_real(r->fmu->instance, o->reference, (size_t)o->n, now);
        if (is_error(status)) return status;
        now[o->n] = o->memory ? r->e->time[0] - r->delay[i] : 0.0;
        for (int64_t j = 0; j < o->n && with_columns; j++)
            if (d->column_of[j] >= 0) known[n_known++] = o->reference[j];
        if (d->holds > (n_known > 0) && !memcmp(now, d->key, sizeof now)) continue;
        d->lines = s->linear && !o->memory;
        if (o->memory)
            memory_apply(o->memory, s, d, now[o->n], now, (int)o->n);
        else
            status = (s->linear ? apply_linear : apply_held)(r, s, d, n_known, known);
        if (is_error(status)) return status;
        memcpy(d->key, now, sizeof now);
        d->holds = 1 + (n_known > 0);
    }
    return FMI_OK;
}

/* What laws at outputs make of the samples that the sink holds, in their place, and of their sensitivities. */
int operators_on_outputs(Run *r)
{
    const Experiment *e = r->e;
    const Sink *sink = &r->sink;
    const size_t count = (size_t)sink->filled;
    for (int64_t o = 0; o < e->m; o++) {
        if (e->output_operator[o] < 0) continue;
        const Operator *op = &r->problem->operators[e->output_operator[o]];
        double *y = sink->y + o * BLOCK, *s = sink->s + o * BLOCK * r->ld, acted[BLOCK], by[count * (size_t)(op->n + 1)];
        fmi_reference known[op->n + 1];
        int column[op->n + 1], n_known = 0;
        known[n_known++] = OPERATED; /* the reading itself */
        for (int64_t j = 0; j < op->n; j++)
            for (int k = 0; k < r->q; k++) {
                const Target *t = &e->targets[r->active[k]];
                if (t->kind != TARGET_PARAMETER || (fmi_reference)t->a != op->reference[j]) continue;
                column[n_known] = k;
                known[n_known++] = op->reference[j];
            }
        const int status = r->fmu->operator_values(r->fmu->instance, op->chain, count, y, acted,
                                                   r->q ? (size_t)n_known : 0, known, by);
        if (is_error(status)) return status;
        memcpy(y, acted, sizeof *y * count);
        for (size_t i = 0; r->q && i < count; i++, s += r->ld) {
            for (int k = 0; k < r->q; k++) s[k] *= by[i];
            for (int j = 1; j < n_known; j++) s[column[j]] += by[(size_t)j * count + i];
        }
    }
    return FMI_OK;
}

/* Does a column set a parameter of an operator? Then the FMU's derivatives by it are zero. */
int acts_apart(const Problem *p, const Target *t)
{
    int found = 0;
    for (int64_t k = 0; k < p->n_operators && t->kind == TARGET_PARAMETER; k++)
        for (int64_t j = 0; j < p->operators[k].n; j++)
            found |= p->operators[k].reference[j] == (fmi_reference)t->a;
    return found;
}

/* Memory for them. */
int operators_open(Run *r)
{
    const Experiment *e = r->e;
    if (!r->problem->n_driving) return 1;
    r->drive = calloc((size_t)e->n_signals + 1, sizeof *r->drive);
    r->row_of = calloc((size_t)(e->n_signals * r->q) + 1, sizeof *r->row_of);
    if (!r->drive || !r->row_of) return 0;
    for (int i = 0; i < e->n_signals; i++) {
        const Signal *s = &e->signals[i];
        Drive *d = &r->drive[i];
        if (s->operator < 0) continue;
        const Operator *o = &r->problem->operators[s->operator];
        int rows = 0;
        d->count = s->count + 1, d->room = operator_room(s);
        d->column_of = malloc(sizeof *d->column_of * (size_t)(o->n + 1));
        d->by = calloc((size_t)o->n + 1, sizeof *d->by);
        if (!d->column_of || !d->by) return 0;
        for (int64_t j = 0; j < o->n; j++) {
            d->column_of[j] = -1;
            for (int k = 0; k < r->q; k++) {
                const Target *t = &e->targets[r->active[k]];
                if (t->kind == TARGET_PARAMETER && (fmi_reference)t->a == o->reference[j]) d->column_of[j] = k;
            }
            rows += d->column_of[j] >= 0;
        }
        d->memory = calloc((size_t)(d->room * (3 + 2 * rows) + 2 * o->n + 2), sizeof *d->memory);
        if (!d->memory) return 0;
        d->time = d->memory, d->value = d->time + d->room, d->slope = d->value + d->room;
        d->key = d->slope + d->room;
        memcpy(d->time + 1, s->time, sizeof *s->time * (size_t)s->count);
        d->time[0] = s->time[0];
        d->by_now = d->key + o->n + 1;
        double *next = d->by_now + o->n;
        for (int64_t j = 0, row = 0; j < o->n; j++) {
            if (d->column_of[j] < 0) continue;
            r->row_of[i * r->q + d->column_of[j]] = d->by[row++] = next;
            next += 2 * d->room;
        }
    }
    return 1;
}

void operators_close(Run *r)
{
    for (int i = 0; r->drive && i < r->e->n_signals; i++)
        free(r->drive[i].memory), free(r->drive[i].column_of), free(r->drive[i].by);
    free(r->drive);
    free(r->row_of);
}
