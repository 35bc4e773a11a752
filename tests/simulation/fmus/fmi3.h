/* FMI 3.0 in terms of the skeleton's FMI 2.0. */
#include <stdbool.h>
#include <stdint.h>

typedef void (*Log)(void *, int, const char *, const char *);
static Callbacks no_callbacks;
static double start_time;

EXPORTED const char *fmi3GetVersion(void) { return "3.0"; }
static void *make(const char *name, const char *path)
{
    static char uri[600];
    snprintf(uri, sizeof uri, "file://%s", path ? path : "");
    return fmi2Instantiate(name, 0, "", uri, &no_callbacks, 0, 0);
}
EXPORTED void *fmi3InstantiateModelExchange(const char *name, const char *token, const char *path, bool visible,
                                            bool logging, void *environment, Log log)
{
    return make(name, path);
}
EXPORTED void fmi3FreeInstance(void *c) { fmi2FreeInstance(c); }
EXPORTED int fmi3EnterInitializationMode(void *c, bool td, double tolerance, double start, bool ed, double end)
{
    fmi2SetupExperiment(c, td, tolerance, start, ed, end);
    return fmi2EnterInitializationMode(c);
}
EXPORTED int fmi3ExitInitializationMode(void *c) { return fmi2ExitInitializationMode(c); }
EXPORTED int fmi3EnterEventMode(void *c) { return fmi2EnterEventMode(c); }
EXPORTED int fmi3EnterContinuousTimeMode(void *c) { return fmi2EnterContinuousTimeMode(c); }
EXPORTED int fmi3Reset(void *c) { return fmi2Reset(c); }
EXPORTED int fmi3Terminate(void *c) { return OK; }
EXPORTED int fmi3GetFloat64(void *c, const unsigned *vr, size_t n, double *v, size_t nv)
{
    return n == nv ? fmi2GetReal(c, vr, n, v) : ERROR;
}
EXPORTED int fmi3SetFloat64(void *c, const unsigned *vr, size_t n, const double *v, size_t nv)
{
    return n == nv ? fmi2SetReal(c, vr, n, v) : ERROR;
}
EXPORTED int fmi3GetInt32(void *c, const unsigned *vr, size_t n, int32_t *v, size_t nv)
{
    return fmi2GetInteger(c, vr, n, v);
}
EXPORTED int fmi3GetBoolean(void *c, const unsigned *vr, size_t n, bool *v, size_t nv)
{
    for (size_t i = 0; i < n; i++) v[i] = ((Model *)c)->r[vr[i]] != 0.0;
    return OK;
}
EXPORTED int fmi3UpdateDiscreteStates(void *c, bool *again, bool *stop, bool *nominals, bool *states, bool *next,
                                      double *time)
{
    Events e;
    const int status = fmi2NewDiscreteStates(c, &e);
    *again = e.again, *stop = e.terminate, *nominals = e.nominals_changed, *states = e.states_changed;
    *next = e.next_defined, *time = e.next;
    return status;
}
EXPORTED int fmi3CompletedIntegratorStep(void *c, bool keep, bool *event, bool *stop)
{
    int enter, end;
    const int status = fmi2CompletedIntegratorStep(c, keep, &enter, &end);
    *event = enter, *stop = end;
    return status;
}
EXPORTED int fmi3SetTime(void *c, double t) { return fmi2SetTime(c, t); }
EXPORTED int fmi3SetContinuousStates(void *c, const double *x, size_t n) { return fmi2SetContinuousStates(c, x, n); }
EXPORTED int fmi3GetContinuousStateDerivatives(void *c, double *x, size_t n) { return fmi2GetDerivatives(c, x, n); }
EXPORTED int fmi3GetEventIndicators(void *c, double *z, size_t n) { return fmi2GetEventIndicators(c, z, n); }
EXPORTED int fmi3GetContinuousStates(void *c, double *x, size_t n) { return fmi2GetContinuousStates(c, x, n); }
EXPORTED int fmi3GetNominalsOfContinuousStates(void *c, double *x, size_t n)
{
    return fmi2GetNominalsOfContinuousStates(c, x, n);
}
EXPORTED int fmi3GetDirectionalDerivative(void *c, const unsigned *unknown, size_t nu, const unsigned *known, size_t nk,
                                          const double *seed, size_t ns, double *out, size_t no)
{
    return nk == ns && nu == no ? fmi2GetDirectionalDerivative(c, unknown, nu, known, nk, seed, out) : ERROR;
}
#define MISSING(name) EXPORTED int fmi3##name(void) { return ERROR; } /* FMPy looks for all of them */
#ifdef STEPS
EXPORTED void *fmi3InstantiateCoSimulation(const char *name, const char *token, const char *path, bool visible,
                                           bool logging, bool events, bool early, const unsigned *vr, size_t n,
                                           void *environment, Log log, void *update)
{
    return make(name, path);
}
EXPORTED int fmi3DoStep(void *c, double t, double h, bool keep, bool *event, bool *stop, bool *early, double *reached)
{
    *event = *stop = *early = false;
    *reached = t + h;
    return fmi2DoStep(c, t, h, keep);
}
#else
MISSING(InstantiateCoSimulation) MISSING(DoStep)
#endif
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
