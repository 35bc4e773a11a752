/* Instances, modes and values of the coupled FMU. */
#include "coupler.h"

/* A file URI (FMI 2.0) as a path. */
static char *path_of_uri(const char *uri)
{
    if (!strncmp(uri, "file://", 7)) uri += 7;
    char *path = calloc(strlen(uri) + 1, 1), *to = path;
    for (; *uri; uri++) {
        unsigned byte;
        if (*uri == '%' && sscanf(uri + 1, "%2x", &byte) == 1) {
            *to++ = (char)byte;
            uri += 2;
        } else
            *to++ = *uri;
    }
    return path;
}

void pass_input(const CoupledFmu *s, const Transfer *o, double *to, int width)
{
    int k = 0;
    while (s->operators[k].part != o->part) k++;
    for (size_t i = 0; i < o->n && !o->sets; i++)
        memcpy(to + (o->slot + (int)i) * width, to + s->operators[k].input * width, sizeof *to * (size_t)width);
}

static int pass_on(CoupledFmu *s, int k)
{
    const Transfer *o = &s->transfer[k];
    const Part *p = &s->part[o->part];
    if (p->off) {
        pass_input(s, o, s->slot, 1);
        return FMI_OK;
    }
    if (!o->sets) {
        /* some FMUs solve their algebraic loops only when derivatives are asked for */
        if (!o->part && p->nx && s->phase != INITIALIZING && k >= p->ready)
            TRY(p->fmu->get_derivatives(p->c, s->rates, (size_t)p->nx));
        return p->fmu->get_real(p->c, o->reference, o->n, s->slot + o->slot);
    }
    for (size_t i = 0; i < o->n; i++) {
        o->value[i] = 0.0;
        for (int j = o->first[i]; j < o->first[i + 1]; j++) o->value[i] += o->gain[j] * s->slot[o->source[j]];
    }
    return p->fmu->set_real(p->c, o->reference, o->n, o->value);
}

int propagate(CoupledFmu *s, int transfers)
{
    const Part *p = &s->part[0];
    if (!s->knows_states && p->nx) {
        double *x = s->slot + s->n_inputs;
        if (s->phase >= FIRST_EVENTS)
            TRY(p->fmu->get_states(p->c, x, (size_t)p->nx));
        else
            TRY(p->fmu->get_real(p->c, p->state, (size_t)p->nx, x));
    }
    s->knows_states = s->phase == RUNNING;
    if (s->phase != RUNNING) s->done = 0;
    for (; s->done < transfers; s->done++) TRY(pass_on(s, s->done));
    return FMI_OK;
}

/* What holds at this instant is not known any more. */
static void forget(CoupledFmu *s) { s->done = s->knows_states = 0; }

/* ---- instances and modes ---- */

FMI const char *fmi2GetTypesPlatform(void) { return "default"; }
FMI const char *fmi2GetVersion(void) { return "2.0"; }
FMI int fmi2SetDebugLogging(fmi_component c, fmi_boolean on, size_t n, const char *const categories[])
{
    (void)c, (void)on, (void)n, (void)categories;
    return FMI_OK;
}

/* Parameters that the coupled model does not show, and the inputs' start values. */
static int give_values(CoupledFmu *s)
{
    memcpy(s->slot, s->start, sizeof *s->slot * (size_t)s->n_inputs);
    for (int k = 0; k < s->n_parts; k++) {
        const Part *p = &s->part[k];
        if (p->n_given) TRY(p->fmu->set_real(p->c, p->given, p->n_given, p->given_value));
    }
    return FMI_OK;
}

FMI void fmi2FreeInstance(fmi_component c)
{
    CoupledFmu *s = c;
    if (!s) return;
    for (int k = 0; s->part && k < s->n_parts; k++) {
        Part *p = &s->part[k];
        if (p->c) p->fmu->free_instance(p->c);
        if (p->fmu) fmu_shut(p->fmu);
        free(p->guid), free(p->resources), free(p->state), free(p->given), free(p->given_value), free(p->nominal),
            free(p->known), free(p->column), free(p->seed);
    }
    for (int k = 0; k < s->n_transfers; k++) {
        Transfer *o = &s->transfer[k];
        free(o->reference), free(o->first), free(o->source), free(o->gain), free(o->value);
    }
    for (int k = 0; k < s->n_variables; k++) free(s->variable[k].part), free(s->variable[k].reference);
    free(s->part), free(s->transfer), free(s->variable), free(s->operators), free(s->start), free(s->slot);
    free(s->tangent.v), free(s->set.v), free(s->block.v);
    free(s->late_start);
    free(s->has_late_start);
    free(s->late_start_value);
    free(s->rates);
    free(s);
}

FMI fmi_component fmi2Instantiate(const char *name, int type, const char *guid, const char *resources,
                                  const fmi_callbacks *calls, fmi_boolean visible, fmi_boolean logging)
{
    (void)guid, (void)calls, (void)visible, (void)logging;
    if (type != FMI_MODEL_EXCHANGE || !resources || !name) return NULL;
    CoupledFmu *s = calloc(1, sizeof *s);
    char *folder = path_of_uri(resources);
    int bad = read_coupling(s, folder);
    for (int k = 0; k < s->n_parts && !bad; k++) {
        Part *p = &s->part[k];
        p->fmu->callbacks = (fmi_callbacks){fmu_quiet, calloc, free, NULL, p->fmu->environment};
        p->c = p->fmu->instantiate(name, type, p->guid, p->resources, &p->fmu->callbacks, 0, 0);
        bad = !p->c;
    }
    free(folder);
    bad = bad || is_error(give_values(s));
    if (!bad) return s;
    fmi2FreeInstance(s);
    return NULL;
}

FMI int fmi2SetupExperiment(fmi_component c, fmi_boolean defined, double tolerance, double start, fmi_boolean ends,
                            double end)
{
    CoupledFmu *s = c;
    IN_ALL_PARTS(setup(p->c, defined, tolerance, start, ends, end));
    return FMI_OK;
}

FMI int fmi2EnterInitializationMode(fmi_component c)
{
    CoupledFmu *s = c;
    IN_ALL_PARTS(enter_initialization(p->c));
    s->phase = INITIALIZING;
    return FMI_OK;
}

/* The laws stay in initialization mode until the base has its start values: those of the laws may depend on them. */
FMI int fmi2ExitInitializationMode(fmi_component c)
{
    CoupledFmu *s = c;
    const Part *p = &s->part[0];
    TRY(propagate(s, p->ready));
    TRY(p->fmu->exit_initialization(p->c));
    s->phase = FIRST_EVENTS;
    return FMI_OK;
}

static int finish_initialization(CoupledFmu *s)
{
    Part *base = &s->part[0];
    int any = 0;
    for (int i = 0; i < base->nx; i++) any |= s->has_late_start[i];
    if (any) {
        double x[base->nx];
        TRY(base->fmu->get_states(base->c, x, (size_t)base->nx));
        for (int i = 0; i < base->nx; i++)
            if (s->has_late_start[i]) x[i] = s->late_start_value[i];
        TRY(base->fmu->set_states(base->c, x, (size_t)base->nx));
    }
    TRY(propagate(s, s->n_transfers));
    for (int k = 1; k < s->n_parts; k++) {
        const Part *p = &s->part[k];
        TRY(p->fmu->exit_initialization(p->c));
        fmi_event_info info;
        do {
            memset(&info, 0, sizeof info);
            TRY(p->fmu->new_discrete(p->c, &info));
        } while (info.new_discrete_states_needed);
        TRY(p->fmu->enter_continuous(p->c));
    }
    return FMI_OK;
}

FMI int fmi2EnterContinuousTimeMode(fmi_component c)
{
    CoupledFmu *s = c;
    const Part *base = &s->part[0];
    TRY(base->fmu->enter_continuous(base->c));
    if (s->phase == FIRST_EVENTS)
        TRY(finish_initialization(s));
    else
        for (int k = 1; k < s->n_parts; k++) TRY(s->part[k].fmu->enter_continuous(s->part[k].c));
    s->phase = RUNNING;
    forget(s);
    return FMI_OK;
}

FMI int fmi2EnterEventMode(fmi_component c)
{
    CoupledFmu *s = c;
    TRY(propagate(s, s->n_transfers));
    IN_ALL_PARTS(enter_event(p->c));
    forget(s);
    return FMI_OK;
}

FMI int fmi2NewDiscreteStates(fmi_component c, fmi_event_info *info)
{
    CoupledFmu *s = c;
    const Part *base = &s->part[0];
    TRY(propagate(s, s->n_transfers));
    TRY(base->fmu->new_discrete(base->c, info));
    forget(s);
    if (s->phase != RUNNING) return FMI_OK;
    TRY(propagate(s, s->n_transfers));
    for (int k = 1; k < s->n_parts; k++) {
        fmi_event_info more;
        memset(&more, 0, sizeof more);
        TRY(s->part[k].fmu->new_discrete(s->part[k].c, &more));
        info->new_discrete_states_needed |= more.new_discrete_states_needed;
        info->states_changed |= more.states_changed;
        if (more.next_event_time_defined &&
            (!info->next_event_time_defined || more.next_event_time < info->next_event_time)) {
            info->next_event_time_defined = 1;
            info->next_event_time = more.next_event_time;
        }
    }
    forget(s);
    return FMI_OK;
}

FMI int fmi2CompletedIntegratorStep(fmi_component c, fmi_boolean keep, fmi_boolean *event, fmi_boolean *stop)
{
    CoupledFmu *s = c;
    fmi_boolean events = 0, stops = 0;
    TRY(propagate(s, s->n_transfers));
    for (int k = 0; k < s->n_parts; k++) {
        const Part *p = &s->part[k];
        if (p->off) continue;
        TRY(p->fmu->completed(p->c, keep, event, stop));
        events |= *event;
        stops |= *stop;
    }
    *event = events;
    *stop = stops;
    return FMI_OK;
}

FMI int fmi2Terminate(fmi_component c)
{
    CoupledFmu *s = c;
    IN_ALL_PARTS(terminate(p->c));
    return FMI_OK;
}

FMI int fmi2Reset(fmi_component c)
{
    CoupledFmu *s = c;
    s->phase = STARTING;
    forget(s);
    memset(s->has_late_start, 0, sizeof *s->has_late_start * (size_t)s->part[0].nx);
    IN_ALL_PARTS(reset(p->c));
    return give_values(s);
}

/* ---- values ---- */

FMI int fmi2GetReal(fmi_component c, const fmi_reference vr[], size_t n, double value[])
{
    CoupledFmu *s = c;
    for (size_t i = 0; i < n; i++) {
        if (vr[i] >= (fmi_reference)s->n_variables) return FMI_ERROR;
        const Variable *v = &s->variable[vr[i]];
        if (!v->n) {
            value[i] = s->slot[v->slot];
            continue;
        }
        const Part *p = &s->part[v->part[0]];
        if (s->phase != STARTING) TRY(propagate(s, p->ready));
        TRY(p->fmu->get_real(p->c, &v->reference[0], 1, &value[i]));
    }
    return FMI_OK;
}

/* Keeps the start value of a state that the base does not accept before it runs. Returns whether it did. */
static int defer_start(CoupledFmu *s, const Variable *v, double value)
{
    const int i = v->slot - s->n_inputs;
    if (i < 0 || i >= s->part[0].nx || !s->late_start[i]) return 0;
    s->has_late_start[i] = 1;
    s->late_start_value[i] = value;
    return 1;
}

FMI int fmi2SetReal(fmi_component c, const fmi_reference vr[], size_t n, const double value[])
{
    CoupledFmu *s = c;
    int states = 0;
    for (size_t i = 0; i < n; i++) {
        if (vr[i] >= (fmi_reference)s->n_variables) return FMI_ERROR;
        const Variable *v = &s->variable[vr[i]];
        if (s->phase < FIRST_EVENTS && defer_start(s, v, value[i])) continue;
        if (!v->n) s->slot[v->slot] = value[i];
        states |= v->n > 0;
        for (int k = 0; k < v->n; k++) {
            const Part *p = &s->part[v->part[k]];
            TRY(p->fmu->set_real(p->c, &v->reference[k], 1, &value[i]));
        }
    }
    s->done = 0;
    if (states) s->knows_states = 0;
    return FMI_OK;
}

#define GET_DISCRETE(name, function)                                                                                  \
    FMI int name(fmi_component c, const fmi_reference vr[], size_t n, int value[])                                    \
    {                                                                                                                 \
        CoupledFmu *s = c;                                                                                            \
        const Part *p = &s->part[0];                                                                                  \
        if (s->phase != STARTING) TRY(propagate(s, p->ready));                                                        \
        for (size_t i = 0; i < n; i++) {                                                                              \
            const Variable *v = vr[i] < (fmi_reference)s->n_variables ? &s->variable[vr[i]] : NULL;                   \
            if (!v || !v->n || v->part[0] || !p->fmu->function) return FMI_ERROR;                                     \
            TRY(p->fmu->function(p->c, &v->reference[0], 1, &value[i]));                                              \
        }                                                                                                             \
        return FMI_OK;                                                                                                \
    }
GET_DISCRETE(fmi2GetInteger, get_integer)
GET_DISCRETE(fmi2GetBoolean, get_boolean)

#define UNSUPPORTED(name, ...) \
    FMI int name(fmi_component c, __VA_ARGS__) { return FMI_ERROR; }
_Pragma("GCC diagnostic push") _Pragma("GCC diagnostic ignored \"-Wunused-parameter\"")
UNSUPPORTED(fmi2SetInteger, const fmi_reference vr[], size_t n, const int value[])
UNSUPPORTED(fmi2SetBoolean, const fmi_reference vr[], size_t n, const int value[])
UNSUPPORTED(fmi2SetString, const fmi_reference vr[], size_t n, const char *const value[])
UNSUPPORTED(fmi2GetString, const fmi_reference vr[], size_t n, const char *value[])
UNSUPPORTED(fmi2GetFMUstate, void **state)
UNSUPPORTED(fmi2SetFMUstate, void *state)
UNSUPPORTED(fmi2FreeFMUstate, void **state)
UNSUPPORTED(fmi2SerializedFMUstateSize, void *state, size_t *size)
UNSUPPORTED(fmi2SerializeFMUstate, void *state, char bytes[], size_t size)
UNSUPPORTED(fmi2DeSerializeFMUstate, const char bytes[], size_t size, void **state)
_Pragma("GCC diagnostic pop")

/* Not of FMI: switches all operators on inputs off (1), or the states of delays of outputs (2), or on again. Before
 * initialisation. */
FMI int ab_operators_off(fmi_component c, int off)
{
    CoupledFmu *s = c;
    for (int k = 0; k < s->n_operators; k++) {
        const int input = s->operators[k].input;
        Part *p = &s->part[s->operators[k].part];
        if (input == AT_OUTPUT) continue;
        p->off = input >= 0 && off & 1;
        p->nx = p->off || (input == DELAYS_OUTPUT && off & 2) ? 0 : p->all_nx;
    }
    return FMI_OK;
}

/* Of one variable of a part by m others. */
static int derivatives_by(const Part *p, const fmi_reference *unknown, const fmi_reference *known, size_t m, double *by)
{
    const double one = 1.0;
    if (p->fmu->columns) return p->fmu->columns(p->c, unknown, 1, known, m, by);
    for (size_t j = 0; j < m; j++) TRY(p->fmu->directional(p->c, unknown, 1, known + j, 1, &one, by + j));
    return FMI_OK;
}

/* What a law makes of values, in their place; and of their derivatives by parameters of the coupled model. */
static int operate(const CoupledFmu *s, const Operator *o, size_t n, double *y, size_t n_known, const fmi_reference *known,
                   double *slopes)
{
    const Part *p = &s->part[o->part];
    fmi_reference own[n_known + 1]; /* the value, then parameters of this law */
    size_t of[n_known + 1], m = 0;
    double by[n_known + 1];
    own[m++] = o->u;
    for (size_t k = 0; k < n_known; k++) {
        const Variable *v = known[k] == OPERATED ? NULL : &s->variable[known[k]];
        int j = 0;
        while (v && j < v->n && v->part[j] != o->part) j++;
        if (!v || j == v->n) continue;
        of[m] = k;
        own[m++] = v->reference[j];
    }
    for (size_t i = 0; i < n; i++) {
        TRY(p->fmu->set_real(p->c, &o->u, 1, y + i));
        TRY(p->fmu->get_real(p->c, &o->y, 1, y + i));
        if (!n_known) continue;
        TRY(derivatives_by(p, &o->y, own, m, by));
        for (size_t k = 0; k < n_known; k++) slopes[k * n + i] *= by[0];
        for (size_t j = 1; j < m; j++) slopes[of[j] * n + i] += by[j];
    }
    return FMI_OK;
}

/* Not of FMI: what a chain of operators without states makes of n values, to y; and its derivatives by parameters of the
 * coupled model, or by the values themselves (OPERATED), to one row of n for each of them. */
FMI int ab_operator_values(fmi_component c, int chain, size_t n, const double *u, double *y, size_t n_known,
                           const fmi_reference *known, double *slopes)
{
    const CoupledFmu *s = c;
    memcpy(y, u, sizeof *y * n);
    for (size_t k = 0; k < n_known; k++)
        for (size_t i = 0; i < n; i++) slopes[k * n + i] = known[k] == OPERATED;
    for (int k = 0; k < s->n_operators; k++)
        if (s->operators[k].chain == chain && s->operators[k].input != DELAYS_OUTPUT)
            TRY(operate(s, &s->operators[k], n, y, n_known, known, slopes));
    return FMI_OK;
}
