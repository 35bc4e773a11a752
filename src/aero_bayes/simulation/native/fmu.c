/* One FMU in this process: its library, its single instance, and the calls of Model Exchange. The instance is
 * reset and reused where that is enough (run.c), since some FMUs die after about a thousand instantiations. */
#include <float.h>

#include "engine.h"

static Fmu *loaded; /* a library is loaded once and serves every problem on it */

/* Not 0 where the library cannot be loaded. */
int fmu_load(Problem *p)
{
    for (Fmu *f = loaded; f && !p->fmu; f = f->next)
        if (!strcmp(f->path, p->library)) p->fmu = f;
    if (p->fmu) return 0;
    if (!(p->fmu = fmu_open(p->library, p->version, p->load_error, sizeof p->load_error))) return 1;
    int (*mark)(void); /* a function that is exported for such models alone */
    fmu_symbol(p->fmu, "ab_operators_off", &p->fmu->operators_off);
    fmu_symbol(p->fmu, "ab_operator_values", &p->fmu->operator_values);
    p->fmu->eventless = !p->nz && !p->step_callback && !fmu_symbol(p->fmu, "ab_eventless", &mark);
    if (p->fmu->eventless) p->fmu->form = fmu_symbol(p->fmu, "ab_linear", &mark) ? OTHER_FORM : mark();
    p->fmu->next = loaded;
    loaded = p->fmu;
    return 0;
}

/* After a fatal error nothing of the instance may be touched again, not even to free it. */
static void fmu_discard(Fmu *f)
{
    f->instance = NULL;
    f->used = 0;
}

static int fmu_instantiate(Problem *p)
{
    Fmu *f = p->fmu;
    f->callbacks = (fmi_callbacks){fmu_quiet, calloc, free, NULL, f->environment};
    f->instance = f->instantiate(p->name, FMI_MODEL_EXCHANGE, p->guid, p->resources, &f->callbacks, 0, 0);
    f->used = 0;
    if (!f->instance && f->instantiated) f->spent = 1;
    f->instantiated |= f->instance != NULL;
    return f->instance == NULL;
}

/* Loads, instantiates or resets: the instance is in its first mode afterwards. */
int fmu_ready(Problem *p)
{
    if (fmu_load(p)) return AB_MODEL_ERROR;
    Fmu *f = p->fmu;
    const int anew = f->begin == BEGIN_NEW || (f->begin == BEGIN_UNKNOWN && !p->single_instance);
    if (p->has_directional && !f->directional) p->has_directional = p->parameter_directional = 0;
    if (f->instance && f->used) {
        const int status = anew ? FMI_ERROR : f->reset(f->instance);
        if (status == FMI_FATAL)
            fmu_discard(f);
        else if (is_error(status)) {
            f->free_instance(f->instance);
            f->instance = NULL;
        }
    }
    if (!f->instance && fmu_instantiate(p)) return AB_MODEL_ERROR;
    f->used = 1;
    if (f->operators_off) return outcome_of(f, f->operators_off(f->instance, (p->n_driving > 0) + 2 * p->delays));
    return p->n_operators ? AB_MODEL_ERROR : AB_OK;
}

int outcome_of(Fmu *f, int status)
{
    if (status == FMI_FATAL) fmu_discard(f);
    return is_error(status) ? AB_MODEL_ERROR : AB_OK;
}

static int move_to(Run *r, double t, const double *x)
{
    Fmu *f = r->fmu;
    int status = f->set_time(f->instance, t);
    r->at = t;
    if (r->any_slope && !is_error(status)) status = inputs_apply(r, t);
    if (r->n && !is_error(status)) status = f->set_states(f->instance, x, (size_t)r->n);
    return is_error(status) ? status : relay_settle(r);
}

/* Some FMUs solve their algebraic loops only when the derivatives are asked for. */
int set_point(Run *r, double t, const double *x)
{
    const int status = move_to(r, t, x);
    if (is_error(status) || !r->problem->derivatives_first) return status;
    return r->fmu->get_derivatives(r->fmu->instance, r->derivatives_unused, (size_t)r->n);
}

int rhs(Run *r, double t, const double *x, double *out)
{
    const int status = move_to(r, t, x);
    if (is_error(status) || !r->n) return status;
    return r->fmu->get_derivatives(r->fmu->instance, out, (size_t)r->n);
}

/* df/dx by rows at (t, x), where f was just evaluated: directional derivatives, several structurally independent
 * columns at a time (Curtis, Powell, Reid 1974), or forward differences likewise. */
int jacobian(Run *r, double t, const double *x, const double *f, double *jac)
{
    const Problem *p = r->problem;
    const int n = r->n;
    if (p->has_directional && (r->fmu->columns || r->relay == RELAY_RESTS))
        return derivative_columns(r, p->derivative_reference, (size_t)n, p->state_reference, (size_t)n, jac);
    memset(jac, 0, sizeof *jac * (size_t)(n * n));
    for (int color = 0; color < p->n_colors; color++) {
        size_t known = 0;
        int status;
        if (p->has_directional) {
            for (int j = 0; j < n; j++)
                if (p->color[j] == color) {
                    r->seed_reference[known] = p->state_reference[j];
                    r->seed[known++] = 1.0;
                }
            status = r->fmu->directional(r->fmu->instance, p->derivative_reference, (size_t)n, r->seed_reference,
                                         known, r->seed, r->column);
        } else {
            for (int j = 0; j < n; j++) {
                r->seed[j] = x[j];
                if (p->color[j] == color) {
                    const double step = 1.5e-8 * fmax(fabs(x[j]), r->nominal[j]);
                    r->seed[j] = x[j] + (f[j] < 0.0 ? -step : step);
                }
            }
            status = rhs(r, t, r->seed, r->column);
        }
        if (is_error(status)) return status;
        for (int j = 0; j < n; j++)
            if (p->color[j] == color) {
                const double scale = p->has_directional ? 1.0 : 1.0 / (r->seed[j] - x[j]);
                for (int k = p->column_start[j]; k < p->column_start[j + 1]; k++) {
                    const int i = p->row[k];
                    jac[i * n + j] = p->has_directional ? r->column[i] : (r->column[i] - f[i]) * scale;
                }
            }
    }
    return FMI_OK;
}

/* Derivatives of n variables by m others as the FMU tells them: a row for each of the n. */
int plain_columns(Run *r, const fmi_reference *unknown, size_t n, const fmi_reference *known, size_t m, double *out)
{
    const Fmu *f = r->fmu;
    if (!n || !m) return FMI_OK;
    if (f->columns) return f->columns(f->instance, unknown, n, known, m, out);
    const double one = 1.0;
    double column[n];
    for (size_t k = 0; k < m; k++) {
        const int status = f->directional(f->instance, unknown, n, &known[k], 1, &one, column);
        if (is_error(status)) return status;
        for (size_t i = 0; i < n; i++) out[i * m + k] = column[i];
    }
    return FMI_OK;
}

/* The same where the model stands. */
int derivative_columns(Run *r, const fmi_reference *unknown, size_t n, const fmi_reference *known, size_t m, double *out)
{
    const int status = plain_columns(r, unknown, n, known, m, out);
    return n && m && r->relay == RELAY_RESTS && !is_error(status) ? relay_columns(r, unknown, n, known, m, out) : status;
}

int directional_column(Run *r, fmi_reference known, double *column)
{
    return derivative_columns(r, r->problem->derivative_reference, (size_t)r->n, &known, 1, column);
}

/* What must be set before initialisation: held parameters, start values, this run's columns. */
static size_t start_values(Run *r)
{
    const Problem *p = r->problem;
    const Experiment *e = r->e;
    fmi_reference *ref = r->start_reference;
    double *value = r->start_value;
    size_t count = 0;
    if (relay_is_held(p)) {
        ref[count] = p->relay.held, value[count++] = 1.0;
        ref[count] = p->relay.direction, value[count++] = 0.0;
    }
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
    r->relay = RELAY_FREE;
    r->share = 0.0;
    r->nz = p->nz;
    const size_t count = start_values(r);
    TRY(f->setup(f->instance, 0, 0.0, r->t, 0, 0.0));
    if (count) TRY(f->set_real(f->instance, r->start_reference, count, r->start_value));
    inputs_delay(r);
    TRY(operators_apply(r, r->begins_sensitive));
    inputs_prepare(r);
    if (e->n_signals) TRY(inputs_jump(r, r->t));
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
