/* FMI 3.0 Model Exchange and Co-Simulation around a generated model: the functions of FMI 2.0 (fmi2.c), which the
 * linker keeps inside, under the other standard's names. Behind the model's own variables come the time and the event
 * indicators. */
#include <stdarg.h>
#include <stdio.h>

#include "fmi2.c"

#include "fmi3Functions.h"

#define AT_TIME NREAL
#define AT_INDICATOR (NREAL + 1)

typedef struct {
    fmi2Component c;
    fmi3InstanceEnvironment environment;
    fmi3LogMessageCallback log;
} Three;

#define INSIDE ((Three *)c)->c
#define UNUSED(x) (void)(x)

const char *fmi3GetVersion(void) { return fmi3Version; }

static void logged(fmi2ComponentEnvironment e, fmi2String name, fmi2Status status, fmi2String category, fmi2String format, ...) {
    const Three *t = e;
    char text[400];
    va_list args;
    UNUSED(name);
    va_start(args, format);
    vsnprintf(text, sizeof text, format, args);
    va_end(args);
    if (t->log) t->log(t->environment, (fmi3Status)status, category, text);
}

static fmi3Instance instantiate(fmi2Type type, fmi3String name, fmi3String token, fmi3Boolean logging, fmi3InstanceEnvironment environment, fmi3LogMessageCallback log) {
    Three *t = calloc(1, sizeof *t);
    if (!t) return NULL;
    *t = (Three){NULL, environment, log};
    const fmi2CallbackFunctions calls = {logged, calloc, free, NULL, t};
    t->c = fmi2Instantiate(name, type, token, "", &calls, fmi2False, logging);
    if (t->c) return t;
    free(t);
    return NULL;
}
fmi3Instance fmi3InstantiateModelExchange(fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean visible, fmi3Boolean logging, fmi3InstanceEnvironment environment, fmi3LogMessageCallback log) {
    UNUSED(resources); UNUSED(visible);
    return instantiate(fmi2ModelExchange, name, token, logging, environment, log);
}
fmi3Instance fmi3InstantiateCoSimulation(fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean visible, fmi3Boolean logging, fmi3Boolean events, fmi3Boolean early, const fmi3ValueReference required[], size_t n, fmi3InstanceEnvironment environment, fmi3LogMessageCallback log, fmi3IntermediateUpdateCallback update) {
    UNUSED(resources); UNUSED(visible); UNUSED(early); UNUSED(required); UNUSED(n); UNUSED(update);
    if (events) return NULL; /* the description says that there is no event mode here */
    return instantiate(fmi2CoSimulation, name, token, logging, environment, log);
}
fmi3Instance fmi3InstantiateScheduledExecution(fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean visible, fmi3Boolean logging, fmi3InstanceEnvironment environment, fmi3LogMessageCallback log, fmi3ClockUpdateCallback clock, fmi3LockPreemptionCallback lock, fmi3UnlockPreemptionCallback unlock) {
    UNUSED(name); UNUSED(token); UNUSED(resources); UNUSED(visible); UNUSED(logging); UNUSED(environment); UNUSED(log); UNUSED(clock); UNUSED(lock); UNUSED(unlock);
    return NULL;
}
void fmi3FreeInstance(fmi3Instance c) {
    if (!c) return;
    fmi2FreeInstance(INSIDE);
    free(c);
}
fmi3Status fmi3SetDebugLogging(fmi3Instance c, fmi3Boolean on, size_t n, const fmi3String categories[]) { return (fmi3Status)fmi2SetDebugLogging(INSIDE, on, n, categories); }

fmi3Status fmi3EnterInitializationMode(fmi3Instance c, fmi3Boolean defined, fmi3Float64 tolerance, fmi3Float64 start, fmi3Boolean stops, fmi3Float64 stop) {
    fmi2Status status = fmi2SetupExperiment(INSIDE, defined, tolerance, start, stops, stop);
    return (fmi3Status)(status == fmi2OK ? fmi2EnterInitializationMode(INSIDE) : status);
}

#define PLAIN(name) fmi3Status fmi3##name(fmi3Instance c) { return (fmi3Status)fmi2##name(INSIDE); }
PLAIN(ExitInitializationMode)
PLAIN(EnterEventMode)
PLAIN(EnterContinuousTimeMode)
PLAIN(Terminate)
PLAIN(Reset)

static fmi3Status refused(fmi3Instance c, const char *what) { return (fmi3Status)fail(INSIDE, fmi2Error, "%s: not provided", what); }

fmi3Status fmi3EnterConfigurationMode(fmi3Instance c) { return refused(c, "fmi3EnterConfigurationMode"); }
fmi3Status fmi3ExitConfigurationMode(fmi3Instance c) { return refused(c, "fmi3ExitConfigurationMode"); }
fmi3Status fmi3EnterStepMode(fmi3Instance c) { return refused(c, "fmi3EnterStepMode"); }

/* ---- values ---- */

fmi3Status fmi3GetFloat64(fmi3Instance c, const fmi3ValueReference vr[], size_t n, fmi3Float64 values[], size_t m) {
    Instance *s = INSIDE;
    if (m != n) return (fmi3Status)fail(s, fmi2Error, "fmi3GetFloat64: %zu values for %zu variables", m, n);
    double z[count_indicators() + 1];
    int known = 0;
    for (size_t i = 0; i < n; i++) {
        if (vr[i] < NREAL) {
            fmi2Status status = fmi2GetReal(s, vr + i, 1, values + i);
            if (status != fmi2OK) return (fmi3Status)status;
        } else if (vr[i] == AT_TIME) {
            values[i] = s->m->time;
        } else if (vr[i] < AT_INDICATOR + (unsigned)count_indicators()) {
            if (!known) event_indicators(s->m, z);
            known = 1;
            values[i] = z[vr[i] - AT_INDICATOR];
        } else
            return (fmi3Status)fail(s, fmi2Error, "fmi3GetFloat64: no variable %u", vr[i]);
    }
    return fmi3OK;
}
fmi3Status fmi3SetFloat64(fmi3Instance c, const fmi3ValueReference vr[], size_t n, const fmi3Float64 values[], size_t m) {
    if (m != n) return (fmi3Status)fail(INSIDE, fmi2Error, "fmi3SetFloat64: %zu values for %zu variables", m, n);
    return (fmi3Status)fmi2SetReal(INSIDE, vr, n, values);
}

#define NONE(T)                                                                                                                                 \
    fmi3Status fmi3Get##T(fmi3Instance c, const fmi3ValueReference vr[], size_t n, fmi3##T v[], size_t m) { UNUSED(vr); UNUSED(v); UNUSED(m); return n ? refused(c, "fmi3Get" #T) : fmi3OK; } \
    fmi3Status fmi3Set##T(fmi3Instance c, const fmi3ValueReference vr[], size_t n, const fmi3##T v[], size_t m) { UNUSED(vr); UNUSED(v); UNUSED(m); return n ? refused(c, "fmi3Set" #T) : fmi3OK; }
NONE(Float32)
NONE(Int8)
NONE(UInt8)
NONE(Int16)
NONE(UInt16)
NONE(Int32)
NONE(UInt32)
NONE(Int64)
NONE(UInt64)
NONE(Boolean)
NONE(String)
fmi3Status fmi3GetBinary(fmi3Instance c, const fmi3ValueReference vr[], size_t n, size_t sizes[], fmi3Binary v[], size_t m) { UNUSED(vr); UNUSED(sizes); UNUSED(v); UNUSED(m); return n ? refused(c, "fmi3GetBinary") : fmi3OK; }
fmi3Status fmi3SetBinary(fmi3Instance c, const fmi3ValueReference vr[], size_t n, const size_t sizes[], const fmi3Binary v[], size_t m) { UNUSED(vr); UNUSED(sizes); UNUSED(v); UNUSED(m); return n ? refused(c, "fmi3SetBinary") : fmi3OK; }
fmi3Status fmi3GetClock(fmi3Instance c, const fmi3ValueReference vr[], size_t n, fmi3Clock v[]) { UNUSED(vr); UNUSED(v); return n ? refused(c, "fmi3GetClock") : fmi3OK; }
fmi3Status fmi3SetClock(fmi3Instance c, const fmi3ValueReference vr[], size_t n, const fmi3Clock v[]) { UNUSED(vr); UNUSED(v); return n ? refused(c, "fmi3SetClock") : fmi3OK; }
fmi3Status fmi3GetIntervalDecimal(fmi3Instance c, const fmi3ValueReference vr[], size_t n, fmi3Float64 v[], fmi3IntervalQualifier q[]) { UNUSED(vr); UNUSED(n); UNUSED(v); UNUSED(q); return refused(c, "fmi3GetIntervalDecimal"); }
fmi3Status fmi3GetIntervalFraction(fmi3Instance c, const fmi3ValueReference vr[], size_t n, fmi3UInt64 v[], fmi3UInt64 r[], fmi3IntervalQualifier q[]) { UNUSED(vr); UNUSED(n); UNUSED(v); UNUSED(r); UNUSED(q); return refused(c, "fmi3GetIntervalFraction"); }
fmi3Status fmi3GetShiftDecimal(fmi3Instance c, const fmi3ValueReference vr[], size_t n, fmi3Float64 v[]) { UNUSED(vr); UNUSED(n); UNUSED(v); return refused(c, "fmi3GetShiftDecimal"); }
fmi3Status fmi3GetShiftFraction(fmi3Instance c, const fmi3ValueReference vr[], size_t n, fmi3UInt64 v[], fmi3UInt64 r[]) { UNUSED(vr); UNUSED(n); UNUSED(v); UNUSED(r); return refused(c, "fmi3GetShiftFraction"); }
fmi3Status fmi3SetIntervalDecimal(fmi3Instance c, const fmi3ValueReference vr[], size_t n, const fmi3Float64 v[]) { UNUSED(vr); UNUSED(n); UNUSED(v); return refused(c, "fmi3SetIntervalDecimal"); }
fmi3Status fmi3SetIntervalFraction(fmi3Instance c, const fmi3ValueReference vr[], size_t n, const fmi3UInt64 v[], const fmi3UInt64 r[]) { UNUSED(vr); UNUSED(n); UNUSED(v); UNUSED(r); return refused(c, "fmi3SetIntervalFraction"); }
fmi3Status fmi3SetShiftDecimal(fmi3Instance c, const fmi3ValueReference vr[], size_t n, const fmi3Float64 v[]) { UNUSED(vr); UNUSED(n); UNUSED(v); return refused(c, "fmi3SetShiftDecimal"); }
fmi3Status fmi3SetShiftFraction(fmi3Instance c, const fmi3ValueReference vr[], size_t n, const fmi3UInt64 v[], const fmi3UInt64 r[]) { UNUSED(vr); UNUSED(n); UNUSED(v); UNUSED(r); return refused(c, "fmi3SetShiftFraction"); }
fmi3Status fmi3ActivateModelPartition(fmi3Instance c, fmi3ValueReference clock, fmi3Float64 time) { UNUSED(clock); UNUSED(time); return refused(c, "fmi3ActivateModelPartition"); }
fmi3Status fmi3GetNumberOfVariableDependencies(fmi3Instance c, fmi3ValueReference vr, size_t *n) { UNUSED(vr); *n = 0; return refused(c, "fmi3GetNumberOfVariableDependencies"); }
fmi3Status fmi3GetVariableDependencies(fmi3Instance c, fmi3ValueReference vr, size_t of[], fmi3ValueReference on[], size_t at[], fmi3DependencyKind kind[], size_t n) { UNUSED(vr); UNUSED(of); UNUSED(on); UNUSED(at); UNUSED(kind); UNUSED(n); return refused(c, "fmi3GetVariableDependencies"); }
fmi3Status fmi3GetAdjointDerivative(fmi3Instance c, const fmi3ValueReference unknown[], size_t n, const fmi3ValueReference known[], size_t m, const fmi3Float64 seed[], size_t k, fmi3Float64 out[], size_t l) { UNUSED(unknown); UNUSED(n); UNUSED(known); UNUSED(m); UNUSED(seed); UNUSED(k); UNUSED(out); UNUSED(l); return refused(c, "fmi3GetAdjointDerivative"); }
fmi3Status fmi3GetOutputDerivatives(fmi3Instance c, const fmi3ValueReference vr[], size_t n, const fmi3Int32 order[], fmi3Float64 v[], size_t m) { UNUSED(vr); UNUSED(order); UNUSED(v); UNUSED(m); return n ? refused(c, "fmi3GetOutputDerivatives") : fmi3OK; }

fmi3Status fmi3GetDirectionalDerivative(fmi3Instance c, const fmi3ValueReference unknown[], size_t n, const fmi3ValueReference known[], size_t m, const fmi3Float64 seed[], size_t k, fmi3Float64 out[], size_t l) {
    if (k != m || l != n) return (fmi3Status)fail(INSIDE, fmi2Error, "fmi3GetDirectionalDerivative: sizes do not match");
    return (fmi3Status)fmi2GetDirectionalDerivative(INSIDE, unknown, n, known, m, seed, out);
}

/* ---- state of the FMU ---- */

fmi3Status fmi3GetFMUState(fmi3Instance c, fmi3FMUState *state) { return (fmi3Status)fmi2GetFMUstate(INSIDE, state); }
fmi3Status fmi3SetFMUState(fmi3Instance c, fmi3FMUState state) { return (fmi3Status)fmi2SetFMUstate(INSIDE, state); }
fmi3Status fmi3FreeFMUState(fmi3Instance c, fmi3FMUState *state) { return (fmi3Status)fmi2FreeFMUstate(INSIDE, state); }
fmi3Status fmi3SerializedFMUStateSize(fmi3Instance c, fmi3FMUState state, size_t *size) { return (fmi3Status)fmi2SerializedFMUstateSize(INSIDE, state, size); }
fmi3Status fmi3SerializeFMUState(fmi3Instance c, fmi3FMUState state, fmi3Byte bytes[], size_t size) { return (fmi3Status)fmi2SerializeFMUstate(INSIDE, state, (fmi2Byte *)bytes, size); }
fmi3Status fmi3DeserializeFMUState(fmi3Instance c, const fmi3Byte bytes[], size_t size, fmi3FMUState *state) { return (fmi3Status)fmi2DeSerializeFMUstate(INSIDE, (const fmi2Byte *)bytes, size, state); }

/* ---- model exchange ---- */

fmi3Status fmi3EvaluateDiscreteStates(fmi3Instance c) { UNUSED(c); return fmi3OK; }
fmi3Status fmi3UpdateDiscreteStates(fmi3Instance c, fmi3Boolean *again, fmi3Boolean *stop, fmi3Boolean *nominals, fmi3Boolean *states, fmi3Boolean *defined, fmi3Float64 *time) {
    fmi2EventInfo info = {0};
    fmi2Status status = fmi2NewDiscreteStates(INSIDE, &info);
    *again = info.newDiscreteStatesNeeded;
    *stop = info.terminateSimulation;
    *nominals = info.nominalsOfContinuousStatesChanged;
    *states = info.valuesOfContinuousStatesChanged;
    *defined = info.nextEventTimeDefined;
    *time = info.nextEventTime;
    return (fmi3Status)status;
}
fmi3Status fmi3CompletedIntegratorStep(fmi3Instance c, fmi3Boolean keep, fmi3Boolean *enter, fmi3Boolean *stop) {
    fmi2Boolean event = fmi2False, end = fmi2False;
    fmi2Status status = fmi2CompletedIntegratorStep(INSIDE, keep, &event, &end);
    *enter = event;
    *stop = end;
    return (fmi3Status)status;
}
fmi3Status fmi3SetTime(fmi3Instance c, fmi3Float64 time) { return (fmi3Status)fmi2SetTime(INSIDE, time); }
fmi3Status fmi3SetContinuousStates(fmi3Instance c, const fmi3Float64 x[], size_t n) { return (fmi3Status)fmi2SetContinuousStates(INSIDE, x, n); }
fmi3Status fmi3GetContinuousStates(fmi3Instance c, fmi3Float64 x[], size_t n) { return (fmi3Status)fmi2GetContinuousStates(INSIDE, x, n); }
fmi3Status fmi3GetNominalsOfContinuousStates(fmi3Instance c, fmi3Float64 x[], size_t n) { return (fmi3Status)fmi2GetNominalsOfContinuousStates(INSIDE, x, n); }
fmi3Status fmi3GetContinuousStateDerivatives(fmi3Instance c, fmi3Float64 dx[], size_t n) { return (fmi3Status)fmi2GetDerivatives(INSIDE, dx, n); }
fmi3Status fmi3GetEventIndicators(fmi3Instance c, fmi3Float64 z[], size_t n) { return (fmi3Status)fmi2GetEventIndicators(INSIDE, z, n); }
fmi3Status fmi3GetNumberOfEventIndicators(fmi3Instance c, size_t *n) { UNUSED(c); *n = (size_t)count_indicators(); return fmi3OK; }
fmi3Status fmi3GetNumberOfContinuousStates(fmi3Instance c, size_t *n) { UNUSED(c); *n = (size_t)NX; return fmi3OK; }

/* ---- co-simulation ---- */

fmi3Status fmi3DoStep(fmi3Instance c, fmi3Float64 start, fmi3Float64 size, fmi3Boolean keep, fmi3Boolean *event, fmi3Boolean *stop, fmi3Boolean *early, fmi3Float64 *last) {
    Instance *s = INSIDE;
    fmi2Status status = fmi2DoStep(s, start, size, keep);
    *event = *stop = *early = fmi3False;
    *last = s->m->time;
    return (fmi3Status)status;
}

__attribute__((visibility("default"))) int ab_lanes_constants_fmi3(void *c, double *k) { return ab_lanes_constants(INSIDE, k); }
