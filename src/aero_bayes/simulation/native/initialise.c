/* Initialisation: from a fresh instance of the FMU to continuous-time mode at the first sample. */
#include <float.h>

#include "engine.h"

/* What must be set before initialisation: held parameters, start values, this run's columns. */
static size_t start_values(Run *r)
{
    const Problem *p = r->problem;
    const Experiment *e = r->e;
    fmi_reference *ref = r->start_reference;
    double *value = r->start_value;
    size_t count = 0;
    for (int64_t i = 0; i < p->n_fixed; i++) {
        ref[count] = p->fixed_reference[i];
        value[count++] = p->fixed_value[i];
    }
    for (int64_t i = 0; i < e->n_known; i++) {
        ref[count] = e->known_reference[i];
        value[count++] = e->known_value[i];
    }
    for (int i = 0; i < e->n_start; i++)
        if (p->state_settable[e->start_state[i]]) {
            ref[count] = p->state_reference[e->start_state[i]];
            value[count++] = e->start_value[i];
        }
    for (int64_t j = 0; r->values && j < p->p; j++) {
        const Target *t = &e->targets[j];
        if (t->kind == TARGET_PARAMETER)
            ref[count] = (fmi_reference)t->a;
        else if (t->kind == TARGET_START && p->state_settable[t->a])
            ref[count] = p->state_reference[t->a];
        else
            continue;
        value[count++] = r->values[j];
    }
    return count;
}

/* Start values of states that initialisation did not take over. */
static int override_states(Run *r)
{
    const Experiment *e = r->e;
    int differs = 0;
    for (int i = 0; i < e->n_start; i++) {
        double *x = &r->x[e->start_state[i]];
        differs |= *x != e->start_value[i];
        *x = e->start_value[i];
    }
    for (int64_t j = 0; r->values && j < r->problem->p; j++)
        if (e->targets[j].kind == TARGET_START) {
            double *x = &r->x[e->targets[j].a];
            differs |= *x != r->values[j];
            *x = r->values[j];
        }
    return differs;
}

int read_nominals(Run *r)
{
    const int status = r->fmu->get_nominals(r->fmu->instance, r->nominal, (size_t)r->n);
    for (int i = 0; i < r->n; i++) {
        const double v = fabs(r->nominal[i]);
        r->nominal[i] = !is_error(status) && v > 0.0 && v < DBL_MAX ? v : 1.0;
    }
    return status == FMI_FATAL ? status : FMI_OK;
}

#define TRY(call)                                  \
    do {                                           \
        const int outcome_ = outcome_of(f, (call)); \
        if (outcome_) return outcome_;             \
    } while (0)

/* From a fresh instance into continuous-time mode at the first sample, states in r->x. Returns an outcome. */
int initialise(Run *r)
{
    Problem *p = r->problem;
    Experiment *e = r->e;
    const int outcome = fmu_ready(p);
    if (outcome) return outcome;
    Fmu *f = r->fmu = p->fmu;
    r->t = e->time[0];
    const size_t count = start_values(r);
    inputs_prepare(r);
    TRY(f->setup(f->instance, 0, 0.0, r->t, 0, 0.0));
    if (count) TRY(f->set_real(f->instance, r->start_reference, count, r->start_value));
    if (e->n_signals) TRY(inputs_apply(r, r->t));
    TRY(f->enter_initialization(f->instance));
    TRY(f->exit_initialization(f->instance));
    TRY(event_iterate(r));
    TRY(f->enter_continuous(f->instance));
    if (!r->n) return AB_OK;
    TRY(f->get_states(f->instance, r->x, (size_t)r->n));
    if (override_states(r)) TRY(f->set_states(f->instance, r->x, (size_t)r->n));
    TRY(read_nominals(r));
    for (int i = 0; i < r->n; i++)
        if (!isfinite(r->x[i])) return AB_NOT_FINITE;
    return AB_OK;
}
