/* A minimal FMI 2.0 Model Exchange skeleton for test models. A model defines before including it:
 *   N, NZ, STATES, DERIVATIVES (value references), and after it the hooks declared below. Ways of other tools, by define:
 *   HELD_INPUTS     nothing may be set between events
 *   FIXED           nothing but inputs (references from 40 on) may be set after initialisation
 *   ONLY_DERIVATIVES_SOLVE  values are brought up to date by fmi2GetDerivatives alone
 *   STEP_EVENT      step_event() is asked after every step
 *   ONCE            one instance a process
 *   NO_RESET        fmi2Reset fails
 *   IDLE_RESET      fmi2Reset reports success and does nothing
 *   KEPT_START      fmi2Reset goes back to the values at the end of the first initialisation
 *   COUNTED         the first state starts a thousandth higher at every initialisation, counted in memory of the library
 *   COUNTED_BESIDE  the same, counted in the environment, which loading the library anew does not change
 *   TALLY           adds a byte to the file "instances" for every instance
 *   NOISY           prints on every call of fmi2SetTime
 *   FMI3            speaks FMI 3.0
 *   STEPS           co-simulation only, by Euler's method with a fixed number of steps, whatever tolerance is asked for
 *   ONE_SIZE        and said to take steps of one size only
 *   SLOPES          and with inputs that move linearly over a step
 * Variables live in m->r, addressed by their value reference. */
#include <stdarg.h>
#include <stddef.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <math.h>
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

typedef struct {
    double r[64], slope[64];
    double t;
    const Callbacks *callbacks;
    char name[64], resources[512];
    int initializing, initialized, continuous;
    double kept[64];
} Model;

enum { OK, WARNING, DISCARD, ERROR, FATAL };

#ifndef STATE /* where a state lives */
#define STATE(m, i) ((m)->r[states[i]])
#endif
static const unsigned states[] = STATES, derivatives_of[] = DERIVATIVES;

static void start(Model *m);           /* default values */
static int initialize(Model *m);       /* at the end of initialisation */
static int update(Model *m);           /* derivatives and outputs from states, inputs and time */
static int discrete(Model *m, Events *e);
static void zero_crossings(Model *m, double *z);
static int derivative(Model *m, unsigned unknown, unsigned known, double *value); /* partial derivative */
#ifdef STEP_EVENT
static int step_event(Model *m);
#endif

#define EXPORTED __attribute__((visibility("default")))
#ifdef FMI3 /* the functions of FMI 2.0 stay inside, fmi3.h calls them */
#define API static
#else
#define API EXPORTED
#endif

API const char *fmi2GetTypesPlatform(void) { return "default"; }
API const char *fmi2GetVersion(void) { return "2.0"; }
API int fmi2SetDebugLogging(void *c, int on, size_t n, const char *const *what) { return OK; }

API void *fmi2Instantiate(const char *name, int type, const char *guid, const char *resources, const Callbacks *f,
                          int visible, int logging)
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
    m->callbacks = f;
    snprintf(m->name, sizeof m->name, "%s", name);
    snprintf(m->resources, sizeof m->resources, "%s", resources ? resources : "");
    start(m);
    return m;
}
API void fmi2FreeInstance(void *c) { free(c); }
API int fmi2SetupExperiment(void *c, int td, double tol, double t0, int sd, double t1)
{
    ((Model *)c)->t = t0;
    return OK;
}
API int fmi2EnterInitializationMode(void *c)
{
    ((Model *)c)->initializing = 1;
    return OK;
}
API int fmi2ExitInitializationMode(void *c)
{
    Model *m = c;
#ifdef KEPT_START
    if (m->kept[63]) {
        memcpy(m->r, m->kept, sizeof m->r);
        m->initialized = 1;
        return OK;
    }
#endif
    const int status = initialize(m);
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
    m->initialized = 1;
    m->r[63] = 1.0;
    memcpy(m->kept, m->r, sizeof m->r);
    return status;
}
API int fmi2Terminate(void *c) { return OK; }
API int fmi2Reset(void *c)
{
    Model *m = c;
#ifdef NO_RESET
    return ERROR;
#endif
#ifdef IDLE_RESET
    return OK;
#endif
    memset(m->r, 0, sizeof m->r);
    memset(m->slope, 0, sizeof m->slope);
    m->initializing = m->initialized = m->continuous = 0;
    start(m);
    return OK;
}
API int fmi2GetReal(void *c, const unsigned *vr, size_t n, double *v)
{
    Model *m = c;
#ifdef ONLY_DERIVATIVES_SOLVE
    const int status = OK;
#else
    const int status = m->initialized ? update(m) : OK;
#endif
    for (size_t i = 0; i < n; i++) v[i] = m->r[vr[i]];
    return status;
}
API int fmi2GetInteger(void *c, const unsigned *vr, size_t n, int *v)
{
    for (size_t i = 0; i < n; i++) v[i] = (int)((Model *)c)->r[vr[i]];
    return OK;
}
API int fmi2GetBoolean(void *c, const unsigned *vr, size_t n, int *v) { return fmi2GetInteger(c, vr, n, v); }
API int fmi2GetString(void *c, const unsigned *vr, size_t n, const char **v) { return ERROR; }
API int fmi2SetReal(void *c, const unsigned *vr, size_t n, const double *v)
{
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
API int fmi2SetInteger(void *c, const unsigned *vr, size_t n, const int *v) { return ERROR; }
API int fmi2SetBoolean(void *c, const unsigned *vr, size_t n, const int *v) { return ERROR; }
API int fmi2SetString(void *c, const unsigned *vr, size_t n, const char *const *v) { return ERROR; }
API int fmi2GetFMUstate(void *c, void **s) { return ERROR; }
API int fmi2SetFMUstate(void *c, void *s) { return ERROR; }
API int fmi2FreeFMUstate(void *c, void **s) { return ERROR; }
API int fmi2SerializedFMUstateSize(void *c, void *s, size_t *n) { return ERROR; }
API int fmi2SerializeFMUstate(void *c, void *s, char *d, size_t n) { return ERROR; }
API int fmi2DeSerializeFMUstate(void *c, const char *d, size_t n, void **s) { return ERROR; }
#ifndef OWN_DIRECTIONAL
API int fmi2GetDirectionalDerivative(void *c, const unsigned *unknown, size_t nu, const unsigned *known, size_t nk,
                                     const double *dv, double *out)
{
    for (size_t i = 0; i < nu; i++) {
        out[i] = 0.0;
        for (size_t k = 0; k < nk; k++) {
            double v = 0.0;
            const int status = derivative(c, unknown[i], known[k], &v);
            if (status > WARNING) return status;
            out[i] += v * dv[k];
        }
    }
    return OK;
}
#endif
API int fmi2EnterEventMode(void *c) { return ((Model *)c)->continuous = 0; }
API int fmi2NewDiscreteStates(void *c, Events *e)
{
    memset(e, 0, sizeof *e);
    return discrete(c, e);
}
API int fmi2EnterContinuousTimeMode(void *c) { return ((Model *)c)->continuous = 1, OK; }
API int fmi2CompletedIntegratorStep(void *c, int keep, int *event, int *stop)
{
    *event = *stop = 0;
#ifdef STEP_EVENT
    *event = step_event(c);
#endif
    return OK;
}
API int fmi2SetTime(void *c, double t)
{
#ifdef NOISY
    for (int i = 0; i < 20; i++) fprintf(i % 2 ? stdout : stderr, "t = %g\n", t);
#endif
    ((Model *)c)->t = t;
    return OK;
}
API int fmi2SetContinuousStates(void *c, const double *x, size_t n)
{
    for (size_t i = 0; i < n; i++) STATE((Model *)c, i) = x[i];
    return OK;
}
API int fmi2GetDerivatives(void *c, double *x, size_t n)
{
    const int status = update(c);
    for (size_t i = 0; i < n; i++) x[i] = ((Model *)c)->r[derivatives_of[i]];
    return status;
}
API int fmi2GetEventIndicators(void *c, double *z, size_t n)
{
#ifdef ONLY_DERIVATIVES_SOLVE
    const int status = OK;
#else
    const int status = update(c);
#endif
    if (n) zero_crossings(c, z);
    return status;
}
API int fmi2GetContinuousStates(void *c, double *x, size_t n)
{
    for (size_t i = 0; i < n; i++) x[i] = STATE((Model *)c, i);
    return OK;
}
API int fmi2GetNominalsOfContinuousStates(void *c, double *x, size_t n)
{
    for (size_t i = 0; i < n; i++) x[i] = 1.0;
    return OK;
}
#ifdef STEPS
API int fmi2DoStep(void *c, double t, double h, int keep)
{
    Model *m = c;
    const size_t n = sizeof states / sizeof *states;
    for (int k = 0; k < 20; k++) {
        m->t = t + h * k / 20;
        const int status = update(m);
        if (status > WARNING) return status;
        for (size_t i = 0; i < n; i++) m->r[states[i]] += h / 20 * m->r[derivatives_of[i]];
        for (int i = 0; i < 64; i++) m->r[i] += h / 20 * m->slope[i];
    }
    m->t = t + h;
    return OK;
}
API int fmi2SetRealInputDerivatives(void *c, const unsigned *vr, size_t n, const int *order, const double *v)
{
#ifdef SLOPES
    for (size_t i = 0; i < n; i++) ((Model *)c)->slope[vr[i]] = v[i];
    return OK;
#else
    return ERROR;
#endif
}
API int fmi2GetRealOutputDerivatives(void *c, const unsigned *vr, size_t n, const int *order, double *v) { return ERROR; }
API int fmi2CancelStep(void *c) { return ERROR; }
API int fmi2GetStatus(void *c, int kind, int *v) { return ERROR; }
API int fmi2GetRealStatus(void *c, int kind, double *v) { return ERROR; }
API int fmi2GetIntegerStatus(void *c, int kind, int *v) { return ERROR; }
API int fmi2GetBooleanStatus(void *c, int kind, int *v) { return ERROR; }
API int fmi2GetStringStatus(void *c, int kind, const char **v) { return ERROR; }
#endif
#ifdef FMI3
#include "fmi3.h"
#endif
