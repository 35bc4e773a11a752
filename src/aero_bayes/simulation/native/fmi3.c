/* FMI 3.0 Model Exchange behind the functions of FMI 2.0 that the engine calls: the same ideas under other names, with
 * lengths beside the values and with C's own booleans. Signatures follow "Functional Mock-up Interface 3.0", chapters 2
 * and 3. */
#include "fmu_library.h"

typedef void *Instance;
typedef void (*Log)(void *, int, const char *, const char *);

typedef struct {
    Instance instance;
    double start;
    Instance (*instantiate)(const char *, const char *, const char *, bool, bool, void *, Log);
    void (*free_instance)(Instance);
    int (*enter_initialization)(Instance, bool, double, double, bool, double);
    int (*exit_initialization)(Instance), (*enter_event)(Instance), (*enter_continuous)(Instance), (*reset)(Instance);
    int (*terminate)(Instance);
    int (*get_real)(Instance, const fmi_reference *, size_t, double *, size_t);
    int (*get_integer)(Instance, const fmi_reference *, size_t, int32_t *, size_t);
    int (*get_boolean)(Instance, const fmi_reference *, size_t, bool *, size_t);
    int (*set_real)(Instance, const fmi_reference *, size_t, const double *, size_t);
    int (*set_integer)(Instance, const fmi_reference *, size_t, const int32_t *, size_t);
    int (*set_boolean)(Instance, const fmi_reference *, size_t, const bool *, size_t);
    int (*set_long)(Instance, const fmi_reference *, size_t, const int64_t *, size_t);
    int (*new_discrete)(Instance, bool *, bool *, bool *, bool *, bool *, double *);
    int (*completed)(Instance, bool, bool *, bool *);
    int (*set_time)(Instance, double);
    int (*set_states)(Instance, const double *, size_t);
    int (*get_derivatives)(Instance, double *, size_t), (*get_indicators)(Instance, double *, size_t);
    int (*get_states)(Instance, double *, size_t), (*get_nominals)(Instance, double *, size_t);
    int (*directional)(Instance, const fmi_reference *, size_t, const fmi_reference *, size_t, const double *, size_t,
                       double *, size_t);
} Three;

static void quiet(void *e, int status, const char *category, const char *message)
{
    (void)e, (void)status, (void)category, (void)message;
}

static fmi_component instantiate(const char *name, int type, const char *token, const char *resources,
                                 const fmi_callbacks *c, fmi_boolean visible, fmi_boolean logging)
{
    Three *t = c->environment;
    (void)type, (void)visible, (void)logging;
    t->instance = t->instantiate(name, token, resources, false, false, NULL, quiet);
    return t->instance ? t : NULL;
}

static void free_instance(fmi_component c) { ((Three *)c)->free_instance(((Three *)c)->instance); }

static int setup(fmi_component c, fmi_boolean defined, double tolerance, double start, fmi_boolean ends, double end)
{
    (void)defined, (void)tolerance, (void)ends, (void)end;
    ((Three *)c)->start = start;
    return FMI_OK;
}

static int enter_initialization(fmi_component c)
{
    const Three *t = c;
    return t->enter_initialization(t->instance, false, 0.0, t->start, false, 0.0);
}

#define PLAIN(name) \
    static int name(fmi_component c) { return ((Three *)c)->name(((Three *)c)->instance); }
PLAIN(exit_initialization)
PLAIN(enter_event)
PLAIN(enter_continuous)
PLAIN(reset)
PLAIN(terminate)

#define VECTOR(name, type) \
    static int name(fmi_component c, type *v, size_t n) { return ((Three *)c)->name(((Three *)c)->instance, v, n); }
VECTOR(set_states, const double)
VECTOR(get_derivatives, double)
VECTOR(get_indicators, double)
VECTOR(get_states, double)
VECTOR(get_nominals, double)

#define VALUES(name, type) \
    static int name(fmi_component c, const fmi_reference *vr, size_t n, type *v) \
    { return ((Three *)c)->name(((Three *)c)->instance, vr, n, v, n); }
VALUES(get_real, double)
VALUES(set_real, const double)
VALUES(get_integer, int)
VALUES(set_integer, const int)

#define ONE_BY_ONE(name, type) \
    static int name(fmi_component c, const fmi_reference *vr, size_t n, const int *v) \
    { \
        int status = FMI_OK; \
        for (size_t i = 0; i < n && !is_error(status); i++) { \
            const type one = (type)v[i]; \
            status = ((Three *)c)->name(((Three *)c)->instance, vr + i, 1, &one, 1); \
        } \
        return status; \
    }
ONE_BY_ONE(set_boolean, bool)
ONE_BY_ONE(set_long, int64_t)

static int get_boolean(fmi_component c, const fmi_reference *vr, size_t n, int *v)
{
    int status = FMI_OK;
    for (size_t i = 0; i < n && !is_error(status); i++) {
        bool b = false;
        status = ((Three *)c)->get_boolean(((Three *)c)->instance, vr + i, 1, &b, 1);
        v[i] = b;
    }
    return status;
}

static int new_discrete(fmi_component c, fmi_event_info *info)
{
    bool again = false, stop = false, nominals = false, states = false, next = false;
    const int status =
        ((Three *)c)->new_discrete(((Three *)c)->instance, &again, &stop, &nominals, &states, &next, &info->next_event_time);
    info->new_discrete_states_needed = again;
    info->terminate_simulation = stop;
    info->nominals_changed = nominals;
    info->states_changed = states;
    info->next_event_time_defined = next;
    return status;
}

static int completed(fmi_component c, fmi_boolean keep, fmi_boolean *event, fmi_boolean *stop)
{
    bool enter = false, end = false;
    const int status = ((Three *)c)->completed(((Three *)c)->instance, keep != 0, &enter, &end);
    *event = enter;
    *stop = end;
    return status;
}

static int set_time(fmi_component c, double time) { return ((Three *)c)->set_time(((Three *)c)->instance, time); }

static int directional(fmi_component c, const fmi_reference *unknown, size_t n_unknown, const fmi_reference *known,
                       size_t n_known, const double *seed, double *out)
{
    return ((Three *)c)->directional(((Three *)c)->instance, unknown, n_unknown, known, n_known, seed, n_known, out,
                                     n_unknown);
}

/* Fills f with these; not 0 where the library lacks a function. */
int fmi3_bind(Fmu *f)
{
    Three *t = calloc(1, sizeof *t);
    if (!t) return 1;
    int bad = 0;
#define FIND(where, name) bad |= fmu_symbol(f, "fmi3" name, &t->where), f->where = where
    SAME_NAMES
    FIND(instantiate, "InstantiateModelExchange");
    FIND(get_real, "GetFloat64");
    FIND(get_integer, "GetInt32");
    FIND(get_boolean, "GetBoolean");
    FIND(set_real, "SetFloat64");
    FIND(set_integer, "SetInt32");
    FIND(set_boolean, "SetBoolean");
    FIND(set_long, "SetInt64");
    FIND(new_discrete, "UpdateDiscreteStates");
    FIND(get_derivatives, "GetContinuousStateDerivatives");
#undef FIND
    if (!fmu_symbol(f, "fmi3GetDirectionalDerivative", &t->directional)) f->directional = directional;
    f->environment = t;
    f->setup = setup;
    return bad;
}
