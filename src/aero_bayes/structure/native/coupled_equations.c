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
        if (!s->part[k].off) memcpy(v, s->part[k].nominal, sizeof *v * (size_t)s->part[k].n_nominals);
    return FMI_OK;
}

FMI int fmi2GetDerivatives(fmi_component c, double *v, size_t n)
{
    CoupledFmu *s = c;
    TRY(propagate(s, everything_ready(s)));
    return get_all_derivatives(c, v, n);
}

/* ---- directional derivatives ---- */

static void add_seed(Part *p, fmi_reference reference, double seed)
{
    if (seed == 0.0) return;
    p->known[p->n_known] = reference;
    p->seed[p->n_known++] = seed;
}

/* The same where an earlier transfer may have set it. */
static void set_seed(Part *p, fmi_reference reference, double seed)
{
    for (size_t i = 0; i < p->n_known; i++)
        if (p->known[i] == reference) {
            p->seed[i] = seed;
            return;
        }
    add_seed(p, reference, seed);
}

static int part_derivative(const Part *p, const fmi_reference *unknown, size_t n, double *out)
{
    memset(out, 0, sizeof *out * n);
    if (!n || !p->n_known) return FMI_OK;
    if (!p->fmu->directional) return FMI_ERROR;
    return p->fmu->directional(p->c, unknown, n, p->known, p->n_known, p->seed, out);
}

static int propagate_tangents(CoupledFmu *s, int transfers)
{
    for (int j = 0; j < transfers; j++) {
        const Transfer *o = &s->transfer[j];
        Part *p = &s->part[o->part];
        if (p->off) {
            pass_input(s, o, s->tangent);
            continue;
        }
        if (!o->sets) TRY(part_derivative(p, o->reference, o->n, s->tangent + o->slot));
        for (size_t i = 0; o->sets && i < o->n; i++) {
            double sum = 0.0;
            for (int k = o->first[i]; k < o->first[i + 1]; k++) sum += o->gain[k] * s->tangent[o->source[k]];
            set_seed(p, o->reference[i], sum);
        }
    }
    return FMI_OK;
}

FMI int fmi2GetDirectionalDerivative(fmi_component c, const fmi_reference unknown[], size_t n_unknown,
                                     const fmi_reference known[], size_t n_known, const double seed[], double out[])
{
    CoupledFmu *s = c;
    const size_t passed = (size_t)(s->n_inputs + s->part[0].nx);
    memset(s->tangent, 0, sizeof *s->tangent * passed);
    for (int k = 0; k < s->n_parts; k++) s->part[k].n_known = 0;
    int ready = 0;
    for (size_t i = 0; i < n_unknown; i++) {
        if (unknown[i] >= (fmi_reference)s->n_variables) return FMI_ERROR;
        const Variable *v = &s->variable[unknown[i]];
        if (v->n && s->part[v->part[0]].ready > ready) ready = s->part[v->part[0]].ready;
    }
    TRY(propagate(s, ready));
    for (size_t i = 0; i < n_known; i++) {
        if (known[i] >= (fmi_reference)s->n_variables) return FMI_ERROR;
        const Variable *v = &s->variable[known[i]];
        if (v->slot >= 0) s->tangent[v->slot] += seed[i];
        for (int k = 0; k < v->n; k++) add_seed(&s->part[v->part[k]], v->reference[k], seed[i]);
    }
    TRY(propagate_tangents(s, ready));
    fmi_reference asked[n_unknown + 1];
    double found[n_unknown + 1];
    for (size_t i = 0; i < n_unknown;) { /* variables of one part that follow one another are asked for at once */
        const Variable *v = &s->variable[unknown[i]];
        if (v->slot >= 0 || !v->n) {
            out[i++] = v->slot >= 0 ? s->tangent[v->slot] : 0.0;
            continue;
        }
        const size_t first = i;
        const int part = v->part[0];
        for (; i < n_unknown; i++) {
            v = &s->variable[unknown[i]];
            if (v->slot >= 0 || !v->n || v->part[0] != part) break;
            asked[i - first] = v->reference[0];
        }
        TRY(part_derivative(&s->part[part], asked, i - first, found));
        memcpy(out + first, found, sizeof *out * (i - first));
    }
    return FMI_OK;
}
