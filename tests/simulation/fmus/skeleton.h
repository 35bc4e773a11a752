/* A minimal FMU for test models: Model Exchange and Co-Simulation (by Euler's method with a fixed number of steps, whatever
 * tolerance is asked for). Before it the builder includes the names of the variables, the states with their derivatives,
 * and start values. A model defines update(), and those of the hooks below that it has. Ways of other tools, by define:
 *   FMI3            speaks FMI 3.0
 *   HELD_INPUTS     nothing may be set between events
 *   FIXED           nothing but inputs (references from 40 on) may be set after initialisation
 *   REFUSE          no directional derivatives by parameters
 *   ONLY_STATES     those by parameters are zero, without an error
 *   ONLY_DERIVATIVES_SOLVE  values are brought up to date by fmi2GetDerivatives alone
 *   ONCE            one instance a process
 *   NO_RESET        fmi2Reset fails
 *   IDLE_RESET      fmi2Reset reports success and does nothing
 *   KEPT_START      fmi2Reset goes back to the values at the end of the first initialisation
 *   COUNTED         the first state starts a thousandth higher at every initialisation, counted in memory of the library
 *   COUNTED_BESIDE  the same, counted in the environment, which loading the library anew does not change
 *   TALLY           adds a byte to the file "instances" for every instance
 *   NOISY           prints on every call of fmi2SetTime
 *   SLOPES          steps with inputs that move linearly
 * Variables live in m->r, addressed by their value reference. */
#include <complex.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <tgmath.h>
#include <unistd.h>

typedef struct {
    void (*logger)(void *, const char *, int, const char *, const char *, ...);
    void *(*allocate)(size_t, size_t);
    void (*release)(void *);
    void (*finished)(void *, int);
    void *environment;
} Callbacks;

typedef struct {
    int again, terminate, nominals_changed, states_changed, next_defined;
    double next;
} Events;

enum { SIZE = 64 };
typedef struct {
    double r[SIZE], slope[SIZE], kept[SIZE], t;
    const Callbacks *callbacks;
    char name[64], resources[512];
    bool initializing, initialized, continuous, began;
} Model;

typedef double complex Complex;
enum { OK, WARNING, DISCARD, ERROR, FATAL };

#ifndef STATE /* where a state lives */
#define STATE(m, i) ((m)->r[states[i]])
#endif

/* Derivatives and outputs from states, inputs and time: of complex numbers, whose imaginary parts are small changes. */
static int update(Model *m, Complex *r);
#define HOOK __attribute__((weak))
HOOK int initialize(Model *m); /* at the end of initialisation */
HOOK int discrete(Model *m, Events *e);
HOOK void zero_crossings(Model *m, double *z);
HOOK int step_event(Model *m); /* asked after every step */

#define EXPORTED __attribute__((visibility("default")))
#ifdef FMI3
typedef bool Flag;
#define NAME(two, three) fmi3##three
#define ALSO(n) , size_t n
#define EQUAL(n, other) if ((n) != (other)) return ERROR
#else
typedef int Flag;
#define NAME(two, three) fmi2##two
#define ALSO(n)
#define EQUAL(n, other)
#endif
#define FMI(two, three) EXPORTED int NAME(two, three)
#define BOTH(name) FMI(name, name)

/* update() with one variable changed a little, or none (-1). */
static int changed(Model *m, int known, double change, Complex *r)
{
    for (int i = 0; i < SIZE; i++) r[i] = m->r[i] + (i == known) * change * _Complex_I;
    return update(m, r);
}
static int refresh(Model *m)
{
    Complex r[SIZE];
    const int status = changed(m, -1, 0.0, r);
    for (int i = 0; i < SIZE; i++) m->r[i] = creal(r[i]);
    return status;
}
static int refresh_if_asked(Model *m)
{
#ifdef ONLY_DERIVATIVES_SOLVE
    return OK;
#endif
    return m->initialized ? refresh(m) : OK;
}
static int reset(Model *m)
{
    memcpy(m->r, starts, sizeof m->r);
    memset(m->slope, 0, sizeof m->slope);
    m->initializing = m->initialized = m->continuous = false;
    return OK;
}
static void *make(const char *name, const char *resources, const Callbacks *callbacks)
{
#ifdef ONCE
    static int instances;
    if (instances++) return NULL;
#endif
#ifdef TALLY
    FILE *tally = fopen("instances", "a");
    if (tally) fputc('1', tally), fclose(tally);
#endif
    Model *m = calloc(1, sizeof *m);
    m->callbacks = callbacks;
    snprintf(m->name, sizeof m->name, "%s", name);
    if (resources && !strncmp(resources, "file://", 7)) resources += 7;
    snprintf(m->resources, sizeof m->resources, "%s", resources ? resources : "");
    reset(m);
    return m;
}
EXPORTED void NAME(FreeInstance, FreeInstance)(void *c) { free(c); }
static int begin(Model *m)
{
    m->initializing = true;
    return OK;
}
BOTH(ExitInitializationMode)(void *c)
{
    Model *m = c;
    m->initialized = true;
#ifdef KEPT_START
    if (m->began) {
        memcpy(m->r, m->kept, sizeof m->r);
        return OK;
    }
#endif
    const int status = initialize ? initialize(m) : OK;
#ifdef COUNTED
    static int count;
    STATE(m, 0) += 1e-3 * count++;
#endif
#ifdef COUNTED_BESIDE
    char text[16];
    const int count = getenv("COUNT") ? atoi(getenv("COUNT")) : 0;
    snprintf(text, sizeof text, "%d", count + 1);
    setenv("COUNT", text, 1);
    STATE(m, 0) += 1e-3 * count;
#endif
    m->began = true;
    memcpy(m->kept, m->r, sizeof m->r);
    return status;
}
BOTH(Terminate)(void *c) { return OK; }
BOTH(Reset)(void *c)
{
#ifdef NO_RESET
    return ERROR;
#endif
#ifdef IDLE_RESET
    return OK;
#endif
    return reset(c);
}
FMI(GetReal, GetFloat64)(void *c, const unsigned *vr, size_t n, double *v ALSO(nv))
{
    EQUAL(n, nv);
    const int status = refresh_if_asked(c);
    for (size_t i = 0; i < n; i++) v[i] = ((Model *)c)->r[vr[i]];
    return status;
}
FMI(GetInteger, GetInt32)(void *c, const unsigned *vr, size_t n, int *v ALSO(nv))
{
    for (size_t i = 0; i < n; i++) v[i] = (int)((Model *)c)->r[vr[i]];
    return OK;
}
BOTH(GetBoolean)(void *c, const unsigned *vr, size_t n, Flag *v ALSO(nv))
{
    for (size_t i = 0; i < n; i++) v[i] = ((Model *)c)->r[vr[i]] != 0.0;
    return OK;
}
FMI(SetReal, SetFloat64)(void *c, const unsigned *vr, size_t n, const double *v ALSO(nv))
{
    EQUAL(n, nv);
#ifdef HELD_INPUTS /* as a discrete input may: set in event mode only */
    if (((Model *)c)->continuous) return ERROR;
#endif
#ifdef FIXED
    for (size_t i = 0; i < n; i++)
        if (((Model *)c)->initializing && vr[i] < 40) return ERROR;
#endif
    for (size_t i = 0; i < n; i++) ((Model *)c)->r[vr[i]] = v[i];
    return OK;
}
static bool is_state(unsigned reference)
{
    for (size_t i = 0; i < sizeof states / sizeof *states; i++)
        if (states[i] == reference) return true;
    return false;
}
BOTH(GetDirectionalDerivative)(void *c, const unsigned *unknown, size_t nu, const unsigned *known, size_t nk,
                               const double *dv ALSO(nd), double *out ALSO(no))
{
    EQUAL(nk, nd);
    EQUAL(nu, no);
    const double change = 1e-30;
    memset(out, 0, nu * sizeof *out);
    for (size_t k = 0; k < nk; k++) {
#ifdef REFUSE
        if (!is_state(known[k]) && known[k] != U) return ERROR;
#endif
#ifdef ONLY_STATES
        if (!is_state(known[k])) continue;
#endif
        Complex r[SIZE];
        const int status = changed(c, known[k], change, r);
        if (status > WARNING) return status;
        for (size_t i = 0; i < nu; i++) out[i] += cimag(r[unknown[i]]) / change * dv[k];
    }
    return OK;
}
BOTH(EnterEventMode)(void *c) { return ((Model *)c)->continuous = false; }
BOTH(EnterContinuousTimeMode)(void *c)
{
    ((Model *)c)->continuous = true;
    return OK;
}
static int iterate(Model *m, Events *e)
{
    memset(e, 0, sizeof *e);
    return discrete ? discrete(m, e) : OK;
}
BOTH(CompletedIntegratorStep)(void *c, Flag keep, Flag *event, Flag *stop)
{
    *event = step_event && step_event(c);
    *stop = false;
    return OK;
}
BOTH(SetTime)(void *c, double t)
{
#ifdef NOISY
    for (int i = 0; i < 20; i++) fprintf(i % 2 ? stdout : stderr, "t = %g\n", t);
#endif
    ((Model *)c)->t = t;
    return OK;
}
BOTH(SetContinuousStates)(void *c, const double *x, size_t n)
{
    for (size_t i = 0; i < n; i++) STATE((Model *)c, i) = x[i];
    return OK;
}
FMI(GetDerivatives, GetContinuousStateDerivatives)(void *c, double *x, size_t n)
{
    const int status = refresh(c);
    for (size_t i = 0; i < n; i++) x[i] = ((Model *)c)->r[derivatives[i]];
    return status;
}
BOTH(GetEventIndicators)(void *c, double *z, size_t n)
{
    const int status = refresh_if_asked(c);
    if (n) zero_crossings(c, z);
    return status;
}
BOTH(GetContinuousStates)(void *c, double *x, size_t n)
{
    for (size_t i = 0; i < n; i++) x[i] = STATE((Model *)c, i);
    return OK;
}
BOTH(GetNominalsOfContinuousStates)(void *c, double *x, size_t n)
{
    for (size_t i = 0; i < n; i++) x[i] = 1.0;
    return OK;
}
static int step(Model *m, double t, double h)
{
    for (int k = 0; k < 20; k++) {
        m->t = t + h * k / 20;
        const int status = refresh(m);
        if (status > WARNING) return status;
        for (size_t i = 0; i < sizeof states / sizeof *states; i++) m->r[states[i]] += h / 20 * m->r[derivatives[i]];
        for (int i = 0; i < SIZE; i++) m->r[i] += h / 20 * m->slope[i];
    }
    m->t = t + h;
    return OK;
}

#define MISSING(name) BOTH(name)(void) { return ERROR; } /* FMPy looks for all of them */
#ifdef FMI3
EXPORTED const char *fmi3GetVersion(void) { return "3.0"; }
EXPORTED void *fmi3InstantiateModelExchange(const char *name, const char *token, const char *path)
{
    return make(name, path, NULL);
}
EXPORTED void *fmi3InstantiateCoSimulation(const char *name, const char *token, const char *path)
{
    return make(name, path, NULL);
}
EXPORTED int fmi3EnterInitializationMode(void *c, bool td, double tolerance, double start, bool ed, double end)
{
    ((Model *)c)->t = start;
    return begin(c);
}
EXPORTED int fmi3UpdateDiscreteStates(void *c, bool *again, bool *stop, bool *nominals, bool *states, bool *next,
                                      double *time)
{
    Events e;
    const int status = iterate(c, &e);
    *again = e.again, *stop = e.terminate, *nominals = e.nominals_changed, *states = e.states_changed;
    *next = e.next_defined, *time = e.next;
    return status;
}
EXPORTED int fmi3DoStep(void *c, double t, double h, bool keep, bool *event, bool *stop, bool *early, double *reached)
{
    *event = *stop = *early = false;
    *reached = t + h;
    return step(c, t, h);
}
MISSING(ActivateModelPartition) MISSING(DeserializeFMUState) MISSING(EnterConfigurationMode) MISSING(EnterStepMode)
MISSING(EvaluateDiscreteStates) MISSING(ExitConfigurationMode) MISSING(FreeFMUState) MISSING(GetAdjointDerivative)
MISSING(GetBinary) MISSING(GetClock) MISSING(GetFMUState) MISSING(GetFloat32) MISSING(GetInt16) MISSING(GetInt64)
MISSING(GetInt8) MISSING(GetIntervalDecimal) MISSING(GetIntervalFraction) MISSING(GetNumberOfContinuousStates)
MISSING(GetNumberOfEventIndicators) MISSING(GetNumberOfVariableDependencies) MISSING(GetOutputDerivatives)
MISSING(GetShiftDecimal) MISSING(GetShiftFraction) MISSING(GetString) MISSING(GetUInt16) MISSING(GetUInt32)
MISSING(GetUInt64) MISSING(GetUInt8) MISSING(GetVariableDependencies) MISSING(InstantiateScheduledExecution)
MISSING(SerializeFMUState) MISSING(SerializedFMUStateSize) MISSING(SetBinary) MISSING(SetBoolean) MISSING(SetClock)
MISSING(SetDebugLogging) MISSING(SetFMUState) MISSING(SetFloat32) MISSING(SetInt16) MISSING(SetInt32)
MISSING(SetInt64) MISSING(SetInt8) MISSING(SetIntervalDecimal) MISSING(SetIntervalFraction) MISSING(SetShiftDecimal)
MISSING(SetShiftFraction) MISSING(SetString) MISSING(SetUInt16) MISSING(SetUInt32) MISSING(SetUInt64)
MISSING(SetUInt8)
#else
EXPORTED const char *fmi2GetTypesPlatform(void) { return "default"; }
EXPORTED const char *fmi2GetVersion(void) { return "2.0"; }
EXPORTED int fmi2SetDebugLogging(void) { return OK; }
EXPORTED void *fmi2Instantiate(const char *name, int type, const char *guid, const char *resources, const Callbacks *f)
{
    return make(name, resources, f);
}
EXPORTED int fmi2SetupExperiment(void *c, int td, double tolerance, double start, int ed, double end)
{
    ((Model *)c)->t = start;
    return OK;
}
EXPORTED int fmi2EnterInitializationMode(void *c) { return begin(c); }
EXPORTED int fmi2NewDiscreteStates(void *c, Events *e) { return iterate(c, e); }
EXPORTED int fmi2DoStep(void *c, double t, double h, int keep) { return step(c, t, h); }
EXPORTED int fmi2SetRealInputDerivatives(void *c, const unsigned *vr, size_t n, const int *order, const double *v)
{
#ifndef SLOPES
    return ERROR;
#endif
    for (size_t i = 0; i < n; i++) ((Model *)c)->slope[vr[i]] = v[i];
    return OK;
}
MISSING(GetString) MISSING(SetInteger) MISSING(SetBoolean) MISSING(SetString) MISSING(GetFMUstate) MISSING(SetFMUstate)
MISSING(FreeFMUstate) MISSING(SerializedFMUstateSize) MISSING(SerializeFMUstate) MISSING(DeSerializeFMUstate)
MISSING(GetRealOutputDerivatives) MISSING(CancelStep) MISSING(GetStatus) MISSING(GetRealStatus)
MISSING(GetIntegerStatus) MISSING(GetBooleanStatus) MISSING(GetStringStatus)
#endif
