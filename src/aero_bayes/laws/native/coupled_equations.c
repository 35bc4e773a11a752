/* States, derivatives and event indicators of the coupled FMU, and its directional derivatives by the chain rule. */
#include "coupler.h"

FMI int fmi2SetTime(fmi_component c, double time)
{
    CoupledFmu *s = c;
    s->propagated = 0;
    IN_BOTH_PARTS(set_time(p->c, time));
    return FMI_OK;
}

/* A vector of both parts: first the values of the inner FMU, then those of the laws. */
#define STACKED(name, function, count, type, ...)                                     \
    FMI int name(fmi_component c, type *v, size_t n)                                  \
    {                                                                                 \
        CoupledFmu *s = c;                                                              \
        if (n != (size_t)(s->part[INNER].count + s->part[LAWS].count)) return FMI_ERROR; \
        __VA_ARGS__;                                                                  \
        for (int k = 0; k < PARTS; k++) {                                             \
            const Part *p = &s->part[k];                                              \
            if (p->count) TRY(p->fmu->function(p->c, v, (size_t)p->count));           \
            v += p->count;                                                            \
        }                                                                             \
        return FMI_OK;                                                                \
    }
STACKED(fmi2SetContinuousStates, set_states, nx, const double, s->propagated = 0)
STACKED(fmi2GetContinuousStates, get_states, nx, double, )
STACKED(fmi2GetNominalsOfContinuousStates, get_nominals, nx, double, )
STACKED(fmi2GetEventIndicators, get_indicators, nz, double, TRY(propagate(s)))

FMI int fmi2GetDerivatives(fmi_component c, double *v, size_t n)
{
    CoupledFmu *s = c;
    const Part *p = &s->part[INNER], *laws = &s->part[LAWS];
    if (n != (size_t)(p->nx + laws->nx)) return FMI_ERROR;
    TRY(propagate(s));
    memcpy(v, s->rates, sizeof *v * (size_t)p->nx);
    return laws->nx ? laws->fmu->get_derivatives(laws->c, v + p->nx, (size_t)laws->nx) : FMI_OK;
}

/* ---- directional derivatives ---- */

typedef struct {
    size_t n;
    fmi_reference *reference;
    double *seed;
} Seeds;

static void add_seed(Seeds *known, fmi_reference reference, double seed)
{
    if (seed == 0.0) return;
    known->reference[known->n] = reference;
    known->seed[known->n++] = seed;
}

static double seed_of(const Seeds *known, fmi_reference reference)
{
    double sum = 0.0;
    for (size_t i = 0; i < known->n; i++)
        if (known->reference[i] == reference) sum += known->seed[i];
    return sum;
}

static int is_state(const Part *p, fmi_reference reference)
{
    for (int i = 0; i < p->nx; i++)
        if (p->state[i] == reference) return 1;
    return 0;
}

/* out = d unknown / d known * seed, in one part. The derivative of a state with respect to itself is one. */
static int part_derivative(const Part *p, const fmi_reference *unknown, size_t n, const Seeds *known, double *out)
{
    fmi_reference asked[n + 1];
    double found[n + 1];
    size_t count = 0;
    for (size_t i = 0; i < n; i++) {
        out[i] = 0.0;
        if (is_state(p, unknown[i]))
            out[i] = seed_of(known, unknown[i]);
        else
            asked[count++] = unknown[i];
    }
    if (!count || !known->n) return FMI_OK;
    if (!p->fmu->directional) return FMI_ERROR;
    TRY(p->fmu->directional(p->c, asked, count, known->reference, known->n, known->seed, found));
    for (size_t i = n; i-- > 0;)
        if (!is_state(p, unknown[i])) out[i] = found[--count];
    return FMI_OK;
}

FMI int fmi2GetDirectionalDerivative(fmi_component c, const fmi_reference unknown[], size_t n_unknown,
                                     const fmi_reference known[], size_t n_known, const double seed[], double out[])
{
    CoupledFmu *s = c;
    const Transfer *to_laws = &s->transfer[STATES_TO_LAWS], *to_inputs = &s->transfer[LAWS_TO_INPUTS], *from_outputs = &s->transfer[OUTPUTS_TO_LAWS];
    TRY(propagate(s));
    const size_t capacity = n_known + to_laws->n + to_inputs->n + from_outputs->n + 1;
    fmi_reference references[PARTS][capacity], asked[n_unknown + 1];
    double seeds[PARTS][capacity], found[n_unknown + 1];
    Seeds by[PARTS];
    for (int k = 0; k < PARTS; k++) by[k] = (Seeds){0, references[k], seeds[k]};
    for (size_t i = 0; i < n_known; i++) {
        if (known[i] >= s->n_variables) return FMI_ERROR;
        add_seed(&by[s->owner[known[i]]], s->reference[known[i]], seed[i]);
    }
    for (size_t i = 0; i < to_laws->n; i++) add_seed(&by[LAWS], to_laws->to[i], seed_of(&by[INNER], to_laws->from[i]));
    TRY(part_derivative(&s->part[LAWS], to_inputs->from, to_inputs->n, &by[LAWS], to_inputs->value));
    for (size_t i = 0; i < to_inputs->n; i++) add_seed(&by[INNER], to_inputs->to[i], to_inputs->value[i]);
    size_t of_laws = 0;
    for (size_t i = 0; i < n_unknown; i++) of_laws += unknown[i] < s->n_variables && s->owner[unknown[i]] == LAWS;
    if (of_laws) TRY(part_derivative(&s->part[INNER], from_outputs->from, from_outputs->n, &by[INNER], from_outputs->value));
    for (size_t i = 0; i < from_outputs->n && of_laws; i++) add_seed(&by[LAWS], from_outputs->to[i], from_outputs->value[i]);
    for (int k = 0; k < PARTS; k++) {
        size_t count = 0;
        for (size_t i = 0; i < n_unknown; i++) {
            if (unknown[i] >= s->n_variables) return FMI_ERROR;
            if (s->owner[unknown[i]] == k) asked[count++] = s->reference[unknown[i]];
        }
        TRY(part_derivative(&s->part[k], asked, count, &by[k], found));
        count = 0;
        for (size_t i = 0; i < n_unknown; i++)
            if (s->owner[unknown[i]] == k) out[i] = found[count++];
    }
    return FMI_OK;
}
