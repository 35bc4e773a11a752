/* An FMU made of two: one of which only the binary is known, and the laws around it, compiled from Modelica. Both lie in
 * the resources; which value goes where stands in coupling.txt beside them. To the importer it is one FMI 2.0 model:
 * the states of both behind one another, and directional derivatives by the chain rule.
 *
 * A value reference counts the variables of the description. Values pass a seam from one part to the other: "early" ones
 * are states of the inner FMU that laws at its inputs are given, "into" ones its inputs, "late" ones its outputs. */
#include <stdarg.h>

#include "fmu.h"

#define FMI __attribute__((visibility("default")))
#define TRY(call)                              \
    do {                                       \
        const int status_ = (call);            \
        if (is_error(status_)) return status_;    \
    } while (0)

enum { INNER, LAWS, PARTS };
enum { EARLY, INTO, LATE, SEAMS };
enum { STARTING, INITIALIZING, FIRST_EVENTS, RUNNING };

typedef struct {
    Fmu *fmu;
    fmi_component c;
    char *guid, *resources;
    int nx, nz;
    fmi_reference *state;
} Part;

typedef struct {
    size_t n;
    fmi_reference *from, *to;
    double *value;
} Seam;

typedef struct {
    Part part[PARTS];
    Seam seam[SEAMS];
    size_t n_variables;
    int *owner;
    fmi_reference *reference;
    int *waits, *held; /* inner states that take a start value only once the model runs; whether they have one */
    double *held_value, *rates;
    int phase, fresh;
} Coupling;

/* ---- the parts, as coupling.txt says ---- */

static char *line(FILE *f)
{
    char *text = NULL;
    size_t size = 0;
    const ssize_t n = getline(&text, &size, f);
    if (n > 0 && text[n - 1] == '\n') text[n - 1] = '\0';
    return n > 0 ? text : NULL;
}

static void *numbers(FILE *f, size_t *n, int columns)
{
    int count = 0;
    if (fscanf(f, "%d", &count) != 1 || count < 0) return NULL;
    unsigned *all = calloc((size_t)(count * columns) + 1, sizeof *all);
    for (int i = 0; all && i < count * columns; i++)
        if (fscanf(f, "%u", &all[i]) != 1) return NULL;
    *n = (size_t)count;
    return all;
}

static int read_part(FILE *f, Part *p, const char *folder)
{
    char path[4096], error[256];
    int version;
    if (fscanf(f, "%d %d", &version, &p->nz) != 2) return 1;
    free(line(f));
    char *library = line(f), *resources = line(f);
    p->guid = line(f);
    if (!library || !resources || !p->guid) return 1;
    snprintf(path, sizeof path, "%s/%s", folder, library);
    p->fmu = fmu_open(path, version, error, sizeof error);
    const size_t size = strlen(folder) + strlen(resources) + 16;
    p->resources = malloc(size);
    /* FMI 3.0 asks for a path that ends in a separator, FMI 2.0 for a URI */
    snprintf(p->resources, size, version == 3 ? "%s/%s/" : "file://%s/%s", folder, resources);
    free(library);
    free(resources);
    size_t n;
    p->state = numbers(f, &n, 1);
    p->nx = p->state ? (int)n : 0;
    return !p->fmu || !p->state;
}

static int read_coupling(Coupling *s, const char *folder)
{
    char path[4096];
    snprintf(path, sizeof path, "%s/coupling.txt", folder);
    FILE *f = fopen(path, "r");
    if (!f) return 1;
    int bad = read_part(f, &s->part[INNER], folder) || read_part(f, &s->part[LAWS], folder);
    size_t n = 0;
    bad = bad || !(s->waits = numbers(f, &n, 1)) || n != (size_t)s->part[INNER].nx;
    for (int k = 0; k < SEAMS && !bad; k++) {
        Seam *seam = &s->seam[k];
        fmi_reference *pairs = numbers(f, &seam->n, 2);
        seam->from = calloc(seam->n + 1, sizeof *seam->from);
        seam->to = calloc(seam->n + 1, sizeof *seam->to);
        seam->value = calloc(seam->n + 1, sizeof *seam->value);
        bad = !pairs;
        for (size_t i = 0; i < seam->n && !bad; i++) seam->from[i] = pairs[2 * i], seam->to[i] = pairs[2 * i + 1];
        free(pairs);
    }
    unsigned *pairs = bad ? NULL : numbers(f, &s->n_variables, 2);
    bad |= !pairs;
    s->owner = calloc(s->n_variables + 1, sizeof *s->owner);
    s->reference = calloc(s->n_variables + 1, sizeof *s->reference);
    for (size_t i = 0; i < s->n_variables && !bad; i++)
        s->owner[i] = (int)pairs[2 * i], s->reference[i] = pairs[2 * i + 1];
    free(pairs);
    fclose(f);
    return bad;
}

/* A file URI (FMI 2.0) as a path. */
static char *path_of(const char *uri)
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

/* ---- what passes between them ---- */

static int pass(Coupling *s, int k, int from, int to)
{
    Seam *seam = &s->seam[k];
    if (!seam->n) return FMI_OK;
    Part *a = &s->part[from], *b = &s->part[to];
    TRY(a->fmu->get_real(a->c, seam->from, seam->n, seam->value));
    return b->fmu->set_real(b->c, seam->to, seam->n, seam->value);
}

/* Inputs of the inner FMU at this instant, then its derivatives (some FMUs solve their loops only then), its outputs. */
static int settle(Coupling *s)
{
    if (s->fresh) return FMI_OK;
    const Part *p = &s->part[INNER];
    TRY(pass(s, EARLY, INNER, LAWS));
    TRY(pass(s, INTO, LAWS, INNER));
    if (s->phase != INITIALIZING && p->nx) TRY(p->fmu->get_derivatives(p->c, s->rates, (size_t)p->nx));
    TRY(pass(s, LATE, INNER, LAWS));
    s->fresh = s->phase == RUNNING;
    return FMI_OK;
}

/* ---- instances ---- */

FMI const char *fmi2GetTypesPlatform(void) { return "default"; }
FMI const char *fmi2GetVersion(void) { return "2.0"; }
FMI int fmi2SetDebugLogging(fmi_component c, fmi_boolean on, size_t n, const char *const categories[])
{
    (void)c, (void)on, (void)n, (void)categories;
    return FMI_OK;
}

FMI void fmi2FreeInstance(fmi_component c)
{
    Coupling *s = c;
    if (!s) return;
    for (int k = 0; k < PARTS; k++) {
        Part *p = &s->part[k];
        if (p->c) p->fmu->free_instance(p->c);
        if (p->fmu) fmu_shut(p->fmu);
        free(p->guid);
        free(p->resources);
        free(p->state);
    }
    for (int k = 0; k < SEAMS; k++) free(s->seam[k].from), free(s->seam[k].to), free(s->seam[k].value);
    free(s->owner);
    free(s->reference);
    free(s->waits);
    free(s->held);
    free(s->held_value);
    free(s->rates);
    free(s);
}

FMI fmi_component fmi2Instantiate(const char *name, int type, const char *guid, const char *resources,
                                  const fmi_callbacks *calls, fmi_boolean visible, fmi_boolean logging)
{
    (void)guid, (void)calls, (void)visible, (void)logging;
    if (type != FMI_MODEL_EXCHANGE || !resources || !name) return NULL;
    Coupling *s = calloc(1, sizeof *s);
    char *folder = path_of(resources);
    int bad = read_coupling(s, folder);
    for (int k = 0; k < PARTS && !bad; k++) {
        Part *p = &s->part[k];
        p->fmu->callbacks = (fmi_callbacks){fmu_quiet, calloc, free, NULL, p->fmu->environment};
        p->c = p->fmu->instantiate(name, type, p->guid, p->resources, &p->fmu->callbacks, 0, 0);
        bad = !p->c;
    }
    free(folder);
    const size_t n = (size_t)s->part[INNER].nx + 1;
    s->held = calloc(n, sizeof *s->held);
    s->held_value = calloc(n, sizeof *s->held_value);
    s->rates = calloc(n, sizeof *s->rates);
    if (!bad) return s;
    fmi2FreeInstance(s);
    return NULL;
}

#define BOTH(call)                                            \
    do {                                                      \
        for (int k_ = 0; k_ < PARTS; k_++) {                  \
            const Part *p = &s->part[k_];                     \
            TRY(p->fmu->call);                                \
        }                                                     \
    } while (0)

FMI int fmi2SetupExperiment(fmi_component c, fmi_boolean defined, double tolerance, double start, fmi_boolean ends,
                            double end)
{
    Coupling *s = c;
    BOTH(setup(p->c, defined, tolerance, start, ends, end));
    return FMI_OK;
}

FMI int fmi2EnterInitializationMode(fmi_component c)
{
    Coupling *s = c;
    BOTH(enter_initialization(p->c));
    s->phase = INITIALIZING;
    return FMI_OK;
}

/* The laws stay in initialization until the inner FMU stands at its start: theirs may depend on that. */
FMI int fmi2ExitInitializationMode(fmi_component c)
{
    Coupling *s = c;
    const Part *p = &s->part[INNER];
    TRY(pass(s, EARLY, INNER, LAWS));
    TRY(pass(s, INTO, LAWS, INNER));
    TRY(p->fmu->exit_initialization(p->c));
    s->phase = FIRST_EVENTS;
    return FMI_OK;
}

static int start(Coupling *s)
{
    Part *p = &s->part[INNER], *laws = &s->part[LAWS];
    int any = 0;
    for (int i = 0; i < p->nx; i++) any |= s->held[i];
    if (any) {
        double x[p->nx];
        TRY(p->fmu->get_states(p->c, x, (size_t)p->nx));
        for (int i = 0; i < p->nx; i++)
            if (s->held[i]) x[i] = s->held_value[i];
        TRY(p->fmu->set_states(p->c, x, (size_t)p->nx));
    }
    TRY(settle(s));
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
    Coupling *s = c;
    const Part *p = &s->part[INNER], *laws = &s->part[LAWS];
    TRY(p->fmu->enter_continuous(p->c));
    if (s->phase == FIRST_EVENTS) TRY(start(s));
    s->phase = RUNNING;
    s->fresh = 0;
    return laws->fmu->enter_continuous(laws->c);
}

FMI int fmi2EnterEventMode(fmi_component c)
{
    Coupling *s = c;
    TRY(settle(s));
    BOTH(enter_event(p->c));
    s->fresh = 0;
    return FMI_OK;
}

FMI int fmi2NewDiscreteStates(fmi_component c, fmi_event_info *info)
{
    Coupling *s = c;
    const Part *p = &s->part[INNER], *laws = &s->part[LAWS];
    TRY(settle(s));
    TRY(p->fmu->new_discrete(p->c, info));
    s->fresh = 0;
    if (s->phase != RUNNING) return FMI_OK;
    fmi_event_info more;
    memset(&more, 0, sizeof more);
    TRY(settle(s));
    TRY(laws->fmu->new_discrete(laws->c, &more));
    info->new_discrete_states_needed |= more.new_discrete_states_needed;
    info->states_changed |= more.states_changed;
    if (more.next_event_time_defined &&
        (!info->next_event_time_defined || more.next_event_time < info->next_event_time)) {
        info->next_event_time_defined = 1;
        info->next_event_time = more.next_event_time;
    }
    s->fresh = 0;
    return FMI_OK;
}

FMI int fmi2CompletedIntegratorStep(fmi_component c, fmi_boolean keep, fmi_boolean *event, fmi_boolean *stop)
{
    Coupling *s = c;
    fmi_boolean events = 0, stops = 0;
    TRY(settle(s));
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
    Coupling *s = c;
    BOTH(terminate(p->c));
    return FMI_OK;
}

FMI int fmi2Reset(fmi_component c)
{
    Coupling *s = c;
    s->phase = STARTING;
    s->fresh = 0;
    memset(s->held, 0, sizeof *s->held * (size_t)s->part[INNER].nx);
    BOTH(reset(p->c));
    return FMI_OK;
}

/* ---- values ---- */

FMI int fmi2GetReal(fmi_component c, const fmi_reference vr[], size_t n, double value[])
{
    Coupling *s = c;
    if (s->phase != STARTING) TRY(settle(s));
    for (size_t i = 0; i < n; i++) {
        if (vr[i] >= s->n_variables) return FMI_ERROR;
        const Part *p = &s->part[s->owner[vr[i]]];
        TRY(p->fmu->get_real(p->c, &s->reference[vr[i]], 1, &value[i]));
    }
    return FMI_OK;
}

/* Whether a start value has to wait until the inner FMU runs. */
static int waits(Coupling *s, fmi_reference vr, double value)
{
    const Part *p = &s->part[INNER];
    for (int i = 0; i < p->nx; i++)
        if (s->owner[vr] == INNER && s->waits[i] && p->state[i] == s->reference[vr]) {
            s->held[i] = 1;
            s->held_value[i] = value;
            return 1;
        }
    return 0;
}

FMI int fmi2SetReal(fmi_component c, const fmi_reference vr[], size_t n, const double value[])
{
    Coupling *s = c;
    s->fresh = 0;
    for (size_t i = 0; i < n; i++) {
        if (vr[i] >= s->n_variables) return FMI_ERROR;
        if (s->phase < FIRST_EVENTS && waits(s, vr[i], value[i])) continue;
        const Part *p = &s->part[s->owner[vr[i]]];
        TRY(p->fmu->set_real(p->c, &s->reference[vr[i]], 1, &value[i]));
    }
    return FMI_OK;
}

#define GET_DISCRETE(name, function)                                                             \
    FMI int name(fmi_component c, const fmi_reference vr[], size_t n, int value[])              \
    {                                                                                           \
        Coupling *s = c;                                                                        \
        const Part *p = &s->part[INNER];                                                        \
        if (s->phase != STARTING) TRY(settle(s));                                               \
        for (size_t i = 0; i < n; i++) {                                                        \
            if (vr[i] >= s->n_variables || s->owner[vr[i]] != INNER || !p->fmu->function) return FMI_ERROR; \
            TRY(p->fmu->function(p->c, &s->reference[vr[i]], 1, &value[i]));                    \
        }                                                                                       \
        return FMI_OK;                                                                          \
    }
GET_DISCRETE(fmi2GetInteger, get_integer)
GET_DISCRETE(fmi2GetBoolean, get_boolean)

#define REFUSED(name, ...) \
    FMI int name(fmi_component c, __VA_ARGS__) { return FMI_ERROR; }
_Pragma("GCC diagnostic push") _Pragma("GCC diagnostic ignored \"-Wunused-parameter\"")
REFUSED(fmi2SetInteger, const fmi_reference vr[], size_t n, const int value[])
REFUSED(fmi2SetBoolean, const fmi_reference vr[], size_t n, const int value[])
REFUSED(fmi2SetString, const fmi_reference vr[], size_t n, const char *const value[])
REFUSED(fmi2GetString, const fmi_reference vr[], size_t n, const char *value[])
REFUSED(fmi2GetFMUstate, void **state)
REFUSED(fmi2SetFMUstate, void *state)
REFUSED(fmi2FreeFMUstate, void **state)
REFUSED(fmi2SerializedFMUstateSize, void *state, size_t *size)
REFUSED(fmi2SerializeFMUstate, void *state, char bytes[], size_t size)
REFUSED(fmi2DeSerializeFMUstate, const char bytes[], size_t size, void **state)
_Pragma("GCC diagnostic pop")

/* ---- the equations ---- */

FMI int fmi2SetTime(fmi_component c, double time)
{
    Coupling *s = c;
    s->fresh = 0;
    BOTH(set_time(p->c, time));
    return FMI_OK;
}

/* One vector of both parts, the inner one's first. */
#define STACKED(name, function, count, type, ...)                                     \
    FMI int name(fmi_component c, type *v, size_t n)                                  \
    {                                                                                 \
        Coupling *s = c;                                                              \
        if (n != (size_t)(s->part[INNER].count + s->part[LAWS].count)) return FMI_ERROR; \
        __VA_ARGS__;                                                                  \
        for (int k = 0; k < PARTS; k++) {                                             \
            const Part *p = &s->part[k];                                              \
            if (p->count) TRY(p->fmu->function(p->c, v, (size_t)p->count));           \
            v += p->count;                                                            \
        }                                                                             \
        return FMI_OK;                                                                \
    }
STACKED(fmi2SetContinuousStates, set_states, nx, const double, s->fresh = 0)
STACKED(fmi2GetContinuousStates, get_states, nx, double, )
STACKED(fmi2GetNominalsOfContinuousStates, get_nominals, nx, double, )
STACKED(fmi2GetEventIndicators, get_indicators, nz, double, TRY(settle(s)))

FMI int fmi2GetDerivatives(fmi_component c, double *v, size_t n)
{
    Coupling *s = c;
    const Part *p = &s->part[INNER], *laws = &s->part[LAWS];
    if (n != (size_t)(p->nx + laws->nx)) return FMI_ERROR;
    TRY(settle(s));
    memcpy(v, s->rates, sizeof *v * (size_t)p->nx);
    return laws->nx ? laws->fmu->get_derivatives(laws->c, v + p->nx, (size_t)laws->nx) : FMI_OK;
}

/* ---- directional derivatives by the chain rule ---- */

typedef struct {
    size_t n;
    fmi_reference *reference;
    double *seed;
} Known;

static void know(Known *known, fmi_reference reference, double seed)
{
    if (seed == 0.0) return;
    known->reference[known->n] = reference;
    known->seed[known->n++] = seed;
}

static double seed_of(const Known *known, fmi_reference reference)
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

/* out = d unknown / d known * seed; a state asked for is its own seed. */
static int derive(const Part *p, const fmi_reference *unknown, size_t n, const Known *known, double *out)
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
    Coupling *s = c;
    const Seam *early = &s->seam[EARLY], *into = &s->seam[INTO], *late = &s->seam[LATE];
    TRY(settle(s));
    const size_t room = n_known + early->n + into->n + late->n + 1;
    fmi_reference references[PARTS][room], asked[n_unknown + 1];
    double seeds[PARTS][room], found[n_unknown + 1];
    Known by[PARTS];
    for (int k = 0; k < PARTS; k++) by[k] = (Known){0, references[k], seeds[k]};
    for (size_t i = 0; i < n_known; i++) {
        if (known[i] >= s->n_variables) return FMI_ERROR;
        know(&by[s->owner[known[i]]], s->reference[known[i]], seed[i]);
    }
    for (size_t i = 0; i < early->n; i++) know(&by[LAWS], early->to[i], seed_of(&by[INNER], early->from[i]));
    TRY(derive(&s->part[LAWS], into->from, into->n, &by[LAWS], into->value));
    for (size_t i = 0; i < into->n; i++) know(&by[INNER], into->to[i], into->value[i]);
    size_t of_laws = 0;
    for (size_t i = 0; i < n_unknown; i++) of_laws += unknown[i] < s->n_variables && s->owner[unknown[i]] == LAWS;
    if (of_laws) TRY(derive(&s->part[INNER], late->from, late->n, &by[INNER], late->value));
    for (size_t i = 0; i < late->n && of_laws; i++) know(&by[LAWS], late->to[i], late->value[i]);
    for (int k = 0; k < PARTS; k++) {
        size_t count = 0;
        for (size_t i = 0; i < n_unknown; i++) {
            if (unknown[i] >= s->n_variables) return FMI_ERROR;
            if (s->owner[unknown[i]] == k) asked[count++] = s->reference[unknown[i]];
        }
        TRY(derive(&s->part[k], asked, count, &by[k], found));
        count = 0;
        for (size_t i = 0; i < n_unknown; i++)
            if (s->owner[unknown[i]] == k) out[i] = found[count++];
    }
    return FMI_OK;
}
