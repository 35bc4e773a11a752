/* States, derivatives and event indicators of the coupled FMU, and its directional derivatives by the chain rule. */
#include "coupler.h"

static int everything_ready(const CoupledFmu *s)
{
    int most = s->part[0].ready;
    for (int k = 1; k < s->n_parts; k++)
        if (s->part[k].nx && s->part[k].ready > most) most = s->part[k].ready;
    return most;
}

FMI int fmi2SetTime(fmi_component c, double time)
{
    CoupledFmu *s = c;
    s->done = 0;
    IN_ALL_PARTS(set_time(p->c, time));
    return FMI_OK;
}

/* A vector of all parts: first the values of the base, then those of the laws. */
#define STACKED(name, function, count, type)                                    \
    static int name(fmi_component c, type *v, size_t n)                          \
    {                                                                            \
        CoupledFmu *s = c;                                                       \
        type *const end = v + n;                                                 \
        for (int k = 0; k < s->n_parts; k++) {                                   \
            const Part *p = &s->part[k];                                         \
            if (end - v < p->count) return FMI_ERROR;                            \
            if (p->count) TRY(p->fmu->function(p->c, v, (size_t)p->count));      \
            v += p->count;                                                       \
        }                                                                        \
        if (v != end) return FMI_ERROR;                                          \
        return FMI_OK;                                                           \
    }
STACKED(set_all_states, set_states, nx, const double)
STACKED(get_all_states, get_states, nx, double)
STACKED(get_all_nominals, get_nominals, nx, double)
STACKED(get_all_indicators, get_indicators, nz, double)
STACKED(get_all_derivatives, get_derivatives, nx, double)

FMI int fmi2SetContinuousStates(fmi_component c, const double *x, size_t n)
{
    CoupledFmu *s = c;
    TRY(set_all_states(c, x, n));
    if (s->part[0].nx) memcpy(s->slot + s->n_inputs, x, sizeof *x * (size_t)s->part[0].nx);
    s->done = 0;
    s->knows_states = 1;
    return FMI_OK;
}

FMI int fmi2GetEventIndicators(fmi_component c, double *z, size_t n)
{
    CoupledFmu *s = c;
    if (!n) return FMI_OK;
    TRY(propagate(s, s->n_transfers));
    return get_all_indicators(c, z, n);
}

FMI int fmi2GetContinuousStates(fmi_component c, double *x, size_t n) { return get_all_states(c, x, n); }

FMI int fmi2GetNominalsOfContinuousStates(fmi_component c, double *v, size_t n)
{
    const CoupledFmu *s = c;
    TRY(get_all_nominals(c, v, n));
    for (int k = 0; k < s->n_parts; v += s->part[k++].nx)
        if (s->part[k].nx) memcpy(v, s->part[k].nominal, sizeof *v * (size_t)s->part[k].n_nominals);
    return FMI_OK;
}

FMI int fmi2GetDerivatives(fmi_component c, double *v, size_t n)
{
    CoupledFmu *s = c;
    TRY(propagate(s, everything_ready(s)));
    return get_all_derivatives(c, v, n);
}

/* ---- derivatives in several directions at once ---- */

/* What a buffer holds is lost where it has to grow. */
static int make_room(Buffer *b, size_t count)
{
    if (count <= b->room) return FMI_OK;
    free(b->v);
    b->v = malloc(sizeof *b->v * count);
    b->room = b->v ? count : 0;
    return b->v ? FMI_OK : FMI_ERROR;
}

/* Nothing moves yet, in so many directions. */
static int begin_directions(CoupledFmu *s, size_t width)
{
    size_t inputs = 0;
    s->width = (int)width;
    for (int k = 0; k < s->n_parts; k++) s->part[k].n_known = s->part[k].n_own = 0;
    for (int j = 0; j < s->n_transfers; j++) inputs += s->transfer[j].sets ? s->transfer[j].n : 0;
    TRY(make_room(&s->tangent, (size_t)s->n_slots * width));
    return make_room(&s->set, inputs * width);
}

/* The derivative of variables of a part in the one direction that is asked for. */
static int part_derivative(const CoupledFmu *s, Part *p, const fmi_reference *unknown, size_t n, double *out)
{
    if (!p->fmu->directional) return FMI_ERROR;
    for (size_t k = p->n_own; k < p->n_known; k++) p->seed[k] = s->set.v[p->column[k]];
    return p->fmu->directional(p->c, unknown, n, p->known, p->n_known, p->seed, out);
}

/* Rows of derivatives of variables of a part in all directions. */
static int part_rows(CoupledFmu *s, Part *p, const fmi_reference *unknown, size_t n, double *out)
{
    const size_t width = (size_t)s->width;
    memset(out, 0, sizeof *out * n * width);
    if (!n || !p->n_known) return FMI_OK;
    if (!p->fmu->columns) return part_derivative(s, p, unknown, n, out);
    TRY(make_room(&s->block, n * p->n_known));
    TRY(p->fmu->columns(p->c, unknown, n, p->known, p->n_known, s->block.v));
    for (size_t i = 0; i < n; i++, out += width) {
        const double *by = s->block.v + i * p->n_known;
        for (size_t k = 0; k < p->n_own; k++) out[p->column[k]] += p->seed[k] * by[k];
        for (size_t k = p->n_own; k < p->n_known; k++) {
            const double *row = s->set.v + p->column[k];
            for (size_t j = 0; by[k] != 0.0 && j < width; j++) out[j] += by[k] * row[j];
        }
    }
    return FMI_OK;
}

/* Sets an input of a part, which an earlier transfer may have set. One that does not move is left out. */
static void set_input(CoupledFmu *s, Part *p, const Transfer *o, size_t i, int *used)
{
    double *row = s->set.v + *used;
    int moves = 0;
    memset(row, 0, sizeof *row * (size_t)s->width);
    for (int k = o->first[i]; k < o->first[i + 1]; k++)
        for (int j = 0; j < s->width; j++) row[j] += o->gain[k] * s->tangent.v[o->source[k] * s->width + j];
    for (int j = 0; j < s->width; j++) moves |= row[j] != 0.0;
    size_t at = p->n_own;
    while (at < p->n_known && p->known[at] != o->reference[i]) at++;
    if (!moves && at == p->n_known) return;
    p->n_known += at == p->n_known;
    p->known[at] = o->reference[i];
    p->column[at] = *used;
    *used += s->width;
}

static int propagate_tangents(CoupledFmu *s, int transfers)
{
    int used = 0;
    for (int j = 0; j < transfers; j++) {
        const Transfer *o = &s->transfer[j];
        Part *p = &s->part[o->part];
        if (p->off) {
            pass_input(s, o, s->tangent.v, s->width);
            continue;
        }
        if (!o->sets) TRY(part_rows(s, p, o->reference, o->n, s->tangent.v + o->slot * s->width));
        for (size_t i = 0; o->sets && i < o->n; i++) set_input(s, p, o, i, &used);
    }
    return FMI_OK;
}

/* Rows of derivatives of variables. Each known variable moves by its seed, or by one: all in the one direction, or each in
 * its own. */
static int all_rows(CoupledFmu *s, const fmi_reference *unknown, size_t n, const fmi_reference *known, size_t n_known,
                    const double *seed, double *out)
{
    const size_t width = (size_t)s->width;
    memset(s->tangent.v, 0, sizeof *s->tangent.v * (size_t)(s->n_inputs + s->part[0].nx) * width);
    int ready = 0;
    for (size_t i = 0; i < n; i++) {
        if (unknown[i] >= (fmi_reference)s->n_variables) return FMI_ERROR;
        const Variable *v = &s->variable[unknown[i]];
        if (v->n && s->part[v->part[0]].ready > ready) ready = s->part[v->part[0]].ready;
    }
    TRY(propagate(s, ready));
    for (size_t i = 0; i < n_known; i++) {
        if (known[i] >= (fmi_reference)s->n_variables) return FMI_ERROR;
        const Variable *v = &s->variable[known[i]];
        const size_t column = width > 1 ? i : 0;
        const double moved = seed ? seed[i] : 1.0;
        if (v->slot >= 0) s->tangent.v[(size_t)v->slot * width + column] += moved;
        for (int k = 0; k < v->n && moved != 0.0; k++) {
            Part *p = &s->part[v->part[k]];
            p->known[p->n_own] = v->reference[k], p->column[p->n_own] = (int)column, p->seed[p->n_own] = moved;
            p->n_known = ++p->n_own;
        }
    }
    TRY(propagate_tangents(s, ready));
    fmi_reference asked[n + 1];
    for (size_t i = 0; i < n;) { /* variables of one part that follow one another are asked for at once */
        const Variable *v = &s->variable[unknown[i]];
        if (v->slot >= 0 || !v->n) {
            if (v->slot >= 0)
                memcpy(out + i * width, s->tangent.v + (size_t)v->slot * width, sizeof *out * width);
            else
                memset(out + i * width, 0, sizeof *out * width);
            i++;
            continue;
        }
        const size_t first = i;
        const int part = v->part[0];
        for (; i < n; i++) {
            v = &s->variable[unknown[i]];
            if (v->slot >= 0 || !v->n || v->part[0] != part) break;
            asked[i - first] = v->reference[0];
        }
        TRY(part_rows(s, &s->part[part], asked, i - first, out + first * width));
    }
    return FMI_OK;
}

FMI int fmi2GetDirectionalDerivative(fmi_component c, const fmi_reference unknown[], size_t n_unknown,
                                     const fmi_reference known[], size_t n_known, const double seed[], double out[])
{
    TRY(begin_directions(c, 1));
    return all_rows(c, unknown, n_unknown, known, n_known, seed, out);
}

int derivatives_of_all(CoupledFmu *s, const fmi_reference unknown[], size_t n, const fmi_reference known[], size_t m,
                       double out[])
{
    TRY(begin_directions(s, m));
    return all_rows(s, unknown, n, known, m, NULL, out);
}
