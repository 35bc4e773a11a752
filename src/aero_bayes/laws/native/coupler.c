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

/* Passes values along a transfer, from one part to the other. */
static int transfer_values(CoupledFmu *s, int k, int from, int to)
{
    Transfer *transfer = &s->transfer[k];
    if (!transfer->n) return FMI_OK;
    Part *a = &s->part[from], *b = &s->part[to];
    TRY(a->fmu->get_real(a->c, transfer->from, transfer->n, transfer->value));
    return b->fmu->set_real(b->c, transfer->to, transfer->n, transfer->value);
}

int propagate(CoupledFmu *s)
{
    if (s->propagated) return FMI_OK;
    const Part *p = &s->part[INNER];
    TRY(transfer_values(s, STATES_TO_LAWS, INNER, LAWS));
    TRY(transfer_values(s, LAWS_TO_INPUTS, LAWS, INNER));
    /* some FMUs solve their algebraic loops only when derivatives are asked for */
    if (s->phase != INITIALIZING && p->nx) TRY(p->fmu->get_derivatives(p->c, s->rates, (size_t)p->nx));
    TRY(transfer_values(s, OUTPUTS_TO_LAWS, INNER, LAWS));
    s->propagated = s->phase == RUNNING;
    return FMI_OK;
}

/* ---- instances and modes ---- */

FMI const char *fmi2GetTypesPlatform(void) { return "default"; }
FMI const char *fmi2GetVersion(void) { return "2.0"; }
FMI int fmi2SetDebugLogging(fmi_component c, fmi_boolean on, size_t n, const char *const categories[])
{
    (void)c, (void)on, (void)n, (void)categories;
    return FMI_OK;
}

FMI void fmi2FreeInstance(fmi_component c)
{
    CoupledFmu *s = c;
    if (!s) return;
    for (int k = 0; k < PARTS; k++) {
        Part *p = &s->part[k];
        if (p->c) p->fmu->free_instance(p->c);
        if (p->fmu) fmu_shut(p->fmu);
        free(p->guid);
        free(p->resources);
        free(p->state);
    }
    for (int k = 0; k < TRANSFERS; k++) free(s->transfer[k].from), free(s->transfer[k].to), free(s->transfer[k].value);
    free(s->owner);
    free(s->reference);
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
    for (int k = 0; k < PARTS && !bad; k++) {
        Part *p = &s->part[k];
        p->fmu->callbacks = (fmi_callbacks){fmu_quiet, calloc, free, NULL, p->fmu->environment};
        p->c = p->fmu->instantiate(name, type, p->guid, p->resources, &p->fmu->callbacks, 0, 0);
        bad = !p->c;
    }
    free(folder);
    const size_t n = (size_t)s->part[INNER].nx + 1;
    s->has_late_start = calloc(n, sizeof *s->has_late_start);
    s->late_start_value = calloc(n, sizeof *s->late_start_value);
    s->rates = calloc(n, sizeof *s->rates);
    if (!bad) return s;
    fmi2FreeInstance(s);
    return NULL;
}

FMI int fmi2SetupExperiment(fmi_component c, fmi_boolean defined, double tolerance, double start, fmi_boolean ends,
                            double end)
{
    CoupledFmu *s = c;
    IN_BOTH_PARTS(setup(p->c, defined, tolerance, start, ends, end));
    return FMI_OK;
}

FMI int fmi2EnterInitializationMode(fmi_component c)
{
    CoupledFmu *s = c;
    IN_BOTH_PARTS(enter_initialization(p->c));
    s->phase = INITIALIZING;
    return FMI_OK;
}

/* The laws stay in initialization mode until the inner FMU has its start values: those of the laws may depend on them. */
FMI int fmi2ExitInitializationMode(fmi_component c)
{
    CoupledFmu *s = c;
    const Part *p = &s->part[INNER];
    TRY(transfer_values(s, STATES_TO_LAWS, INNER, LAWS));
    TRY(transfer_values(s, LAWS_TO_INPUTS, LAWS, INNER));
    TRY(p->fmu->exit_initialization(p->c));
    s->phase = FIRST_EVENTS;
    return FMI_OK;
}

static int finish_initialization(CoupledFmu *s)
{
    Part *p = &s->part[INNER], *laws = &s->part[LAWS];
    int any = 0;
    for (int i = 0; i < p->nx; i++) any |= s->has_late_start[i];
    if (any) {
        double x[p->nx];
        TRY(p->fmu->get_states(p->c, x, (size_t)p->nx));
        for (int i = 0; i < p->nx; i++)
            if (s->has_late_start[i]) x[i] = s->late_start_value[i];
        TRY(p->fmu->set_states(p->c, x, (size_t)p->nx));
    }
    TRY(propagate(s));
    TRY(laws->fmu->exit_initialization(laws->c));
    fmi_event_info info;
    do {
        memset(&info, 0, sizeof info);
        TRY(laws->fmu->new_discrete(laws->c, &info));
    } while (info.new_discrete_states_needed);
    return FMI_OK;
}

FMI int fmi2EnterContinuousTimeMode(fmi_component c)
{
    CoupledFmu *s = c;
    const Part *p = &s->part[INNER], *laws = &s->part[LAWS];
    TRY(p->fmu->enter_continuous(p->c));
    if (s->phase == FIRST_EVENTS) TRY(finish_initialization(s));
    s->phase = RUNNING;
    s->propagated = 0;
    return laws->fmu->enter_continuous(laws->c);
}

FMI int fmi2EnterEventMode(fmi_component c)
{
    CoupledFmu *s = c;
    TRY(propagate(s));
    IN_BOTH_PARTS(enter_event(p->c));
    s->propagated = 0;
    return FMI_OK;
}

FMI int fmi2NewDiscreteStates(fmi_component c, fmi_event_info *info)
{
    CoupledFmu *s = c;
    const Part *p = &s->part[INNER], *laws = &s->part[LAWS];
    TRY(propagate(s));
    TRY(p->fmu->new_discrete(p->c, info));
    s->propagated = 0;
    if (s->phase != RUNNING) return FMI_OK;
    fmi_event_info more;
    memset(&more, 0, sizeof more);
    TRY(propagate(s));
    TRY(laws->fmu->new_discrete(laws->c, &more));
    info->new_discrete_states_needed |= more.new_discrete_states_needed;
    info->states_changed |= more.states_changed;
    if (more.next_event_time_defined &&
        (!info->next_event_time_defined || more.next_event_time < info->next_event_time)) {
        info->next_event_time_defined = 1;
        info->next_event_time = more.next_event_time;
    }
    s->propagated = 0;
    return FMI_OK;
}

FMI int fmi2CompletedIntegratorStep(fmi_component c, fmi_boolean keep, fmi_boolean *event, fmi_boolean *stop)
{
    CoupledFmu *s = c;
    fmi_boolean events = 0, stops = 0;
    TRY(propagate(s));
    for (int k = 0; k < PARTS; k++) {
        const Part *p = &s->part[k];
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
    IN_BOTH_PARTS(terminate(p->c));
    return FMI_OK;
}

FMI int fmi2Reset(fmi_component c)
{
    CoupledFmu *s = c;
    s->phase = STARTING;
    s->propagated = 0;
    memset(s->has_late_start, 0, sizeof *s->has_late_start * (size_t)s->part[INNER].nx);
    IN_BOTH_PARTS(reset(p->c));
    return FMI_OK;
}

/* ---- values ---- */

FMI int fmi2GetReal(fmi_component c, const fmi_reference vr[], size_t n, double value[])
{
    CoupledFmu *s = c;
    if (s->phase != STARTING) TRY(propagate(s));
    for (size_t i = 0; i < n; i++) {
        if (vr[i] >= s->n_variables) return FMI_ERROR;
        const Part *p = &s->part[s->owner[vr[i]]];
        TRY(p->fmu->get_real(p->c, &s->reference[vr[i]], 1, &value[i]));
    }
    return FMI_OK;
}

/* Keeps the start value of a state that the inner FMU does not accept before it runs. Returns whether it did. */
static int defer_start(CoupledFmu *s, fmi_reference vr, double value)
{
    const Part *p = &s->part[INNER];
    for (int i = 0; i < p->nx; i++)
        if (s->owner[vr] == INNER && s->late_start[i] && p->state[i] == s->reference[vr]) {
            s->has_late_start[i] = 1;
            s->late_start_value[i] = value;
            return 1;
        }
    return 0;
}

FMI int fmi2SetReal(fmi_component c, const fmi_reference vr[], size_t n, const double value[])
{
    CoupledFmu *s = c;
    s->propagated = 0;
    for (size_t i = 0; i < n; i++) {
        if (vr[i] >= s->n_variables) return FMI_ERROR;
        if (s->phase < FIRST_EVENTS && defer_start(s, vr[i], value[i])) continue;
        const Part *p = &s->part[s->owner[vr[i]]];
        TRY(p->fmu->set_real(p->c, &s->reference[vr[i]], 1, &value[i]));
    }
    return FMI_OK;
}

#define GET_DISCRETE(name, function)                                                             \
    FMI int name(fmi_component c, const fmi_reference vr[], size_t n, int value[])              \
    {                                                                                           \
        CoupledFmu *s = c;                                                                        \
        const Part *p = &s->part[INNER];                                                        \
        if (s->phase != STARTING) TRY(propagate(s));                                               \
        for (size_t i = 0; i < n; i++) {                                                        \
            if (vr[i] >= s->n_variables || s->owner[vr[i]] != INNER || !p->fmu->function) return FMI_ERROR; \
            TRY(p->fmu->function(p->c, &s->reference[vr[i]], 1, &value[i]));                    \
        }                                                                                       \
        return FMI_OK;                                                                          \
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
