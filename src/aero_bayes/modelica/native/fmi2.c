/* FMI 2.0 around a generated model (model.h): instances, values, derivatives and Model Exchange; and its co-simulation in
 * fmi2_cosimulation.h. It is one translation unit, so that all but the functions of FMI stays inside. */
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "fmi2Functions.h"

#include "events.h"
#include "engine.h"

typedef struct {
    Model *m;
    fmi2CallbackFunctions call;
    fmi2String name;
    fmi2Boolean logging;
    Run *steps; /* of co-simulation, once it has taken one */
} Instance;

static fmi2Status fail(Instance *s, fmi2Status status, const char *format, ...) {
    if (s->call.logger && (s->logging || status >= fmi2Error)) {
        char text[400];
        va_list args;
        va_start(args, format);
        vsnprintf(text, sizeof text, format, args);
        va_end(args);
        s->call.logger(s->call.componentEnvironment, s->name, status, status >= fmi2Error ? "logStatusError" : "logStatusWarning", "%s", text);
    }
    return status;
}

/* ---- instances ---- */

/* What the last evaluation says: discard where a loop has no solution, a warning where an assertion fails. */
static fmi2Status evaluation_status(Instance *s) {
    if (clear_failure(s->m)) return fail(s, fmi2Discard, "an algebraic loop has no solution at t = %g", s->m->time);
    return fmi2OK;
}
static void check_assertions(Instance *s) {
    if (!INFO.assertions) return;
    unsigned char bad[INFO.assertions];
    need_loops(s->m);
    if (!INFO.violated(s->m, bad)) return;
    for (int i = 0; i < INFO.assertions; i++)
        if (bad[i]) fail(s, fmi2Warning, "t = %g: %s", s->m->time, INFO.message[i]);
}

const char *fmi2GetTypesPlatform(void) { return fmi2TypesPlatform; }
const char *fmi2GetVersion(void) { return fmi2Version; }

fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String resources,
                              const fmi2CallbackFunctions *functions, fmi2Boolean visible, fmi2Boolean logging) {
    (void)type; (void)resources; (void)visible;
    if (!functions) return NULL;
    Instance proxy = {NULL, *functions, name ? name : "", logging, NULL};
    if (!name || !*name) { fail(&proxy, fmi2Error, "fmi2Instantiate: the instance needs a name"); return NULL; }
    if (!guid || strcmp(guid, INFO.guid)) {
        fail(&proxy, fmi2Error, "fmi2Instantiate: guid %s, expected %s", guid ? guid : "(none)", INFO.guid);
        return NULL;
    }
    size_t length = strlen(name) + 1;
    Instance *s = calloc(1, sizeof *s);
    Model *m = calloc(1, MODEL_SIZE);
    char *copy = malloc(length);
    if (!s || !m || !copy) {
        free(s); free(m); free(copy);
        fail(&proxy, fmi2Error, "fmi2Instantiate: out of memory");
        return NULL;
    }
    memcpy(copy, name, length);
    *s = (Instance){m, *functions, copy, logging, NULL};
    reset(m);
    return s;
}

void fmi2FreeInstance(fmi2Component c) {
    Instance *s = c;
    if (!s) return;
    close_steps(s->steps);
    free(s->m);
    free((void *)s->name);
    free(s);
}

fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean on, size_t n, const fmi2String categories[]) {
    (void)n; (void)categories;
    ((Instance *)c)->logging = on;
    return fmi2OK;
}

fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean tolerance_defined, fmi2Real tolerance, fmi2Real start,
                               fmi2Boolean stop_defined, fmi2Real stop) {
    Instance *s = c;
    (void)stop_defined; (void)stop;
    if (s->m->phase != INSTANTIATED) return fail(s, fmi2Error, "fmi2SetupExperiment: only before initialisation");
    if (tolerance_defined && tolerance > 0) s->m->tolerance = tolerance;
    s->m->time = start;
    invalidate(s->m, DEPENDS_ON_STATE);
    return fmi2OK;
}

fmi2Status fmi2EnterInitializationMode(fmi2Component c) {
    Instance *s = c;
    if (s->m->phase != INSTANTIATED) return fail(s, fmi2Error, "fmi2EnterInitializationMode: only after instantiation or reset");
    s->m->phase = INITIALIZATION;
    return fmi2OK;
}

fmi2Status fmi2ExitInitializationMode(fmi2Component c) {
    Instance *s = c;
    if (s->m->phase != INITIALIZATION) return fail(s, fmi2Error, "fmi2ExitInitializationMode: not in initialisation mode");
    int solved = initialise(s->m);
    s->m->phase = EVENT;
    if (!solved) return fail(s, fmi2Discard, "the initial equations have no solution near the start values");
    return evaluation_status(s);
}

fmi2Status fmi2Terminate(fmi2Component c) {
    ((Instance *)c)->m->phase = TERMINATED;
    return fmi2OK;
}

fmi2Status fmi2Reset(fmi2Component c) {
    reset(((Instance *)c)->m);
    begin_steps(((Instance *)c)->steps);
    return fmi2OK;
}

/* ---- values ---- */

/* An input that was held at two instants of a step at least and moves then has jumped without an event: the importer's
 * method with several steps is asked to begin anew. One that moves with time all along has not. */
static void note_moved_input(Model *m) {
    m->input_jumped |= m->evaluations > 1;
    m->evaluations = 0;
    m->evaluated_at = NAN;
}
static void note_evaluation(Model *m) {
    if (m->phase != CONTINUOUS || m->evaluated_at == m->time) return;
    m->evaluated_at = m->time;
    m->evaluations++;
}

fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2Real value[]) {
    Instance *s = c;
    Model *m = s->m;
    if (m->phase == INITIALIZATION) initialise(m);
    for (size_t i = 0; i < n; i++) {
        unsigned v = vr[i];
        if (v >= NREAL) return fail(s, fmi2Error, "fmi2GetReal: no variable with value reference %u", v);
        if (v >= AT_Y) need_outputs(m);
        else if (v >= AT_Q) need_constants(m);
        else if (v >= AT_DX && v < AT_U) need_derivatives(m);
        value[i] = group(m, R)[v];
    }
    return evaluation_status(s);
}

fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Real value[]) {
    Instance *s = c;
    Model *m = s->m;
    for (size_t i = 0; i < n; i++) {
        unsigned v = vr[i];
        if (v < AT_DX) {
            /* Until initialisation ends it is a start value; later, as some importers (CasADi) want it, the state itself. */
            if (m->phase & (INSTANTIATED | INITIALIZATION)) group(m, STARTED)[v] = 1;
            invalidate(m, DEPENDS_ON_STATE);
        } else if (v >= AT_U && v < AT_P) {
            if (m->phase == CONTINUOUS && value[i] != group(m, R)[v]) note_moved_input(m);
            invalidate(m, DEPENDS_ON_STATE);
        } else if (v >= AT_P && v < AT_Q) {
            invalidate(m, FRESH_ALL);
        } else {
            return fail(s, fmi2Error, "fmi2SetReal: the variable with value reference %u cannot be set", v);
        }
        group(m, R)[v] = value[i];
    }
    return fmi2OK;
}

static fmi2Status no_such_variables(fmi2Component c, size_t n, const char *what) {
    return n ? fail(c, fmi2Error, "%s: the model has no such variables", what) : fmi2OK;
}
fmi2Status fmi2GetInteger(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2Integer value[]) { (void)vr; (void)value; return no_such_variables(c, n, "fmi2GetInteger"); }
fmi2Status fmi2SetInteger(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Integer value[]) { (void)vr; (void)value; return no_such_variables(c, n, "fmi2SetInteger"); }
fmi2Status fmi2GetBoolean(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2Boolean value[]) { (void)vr; (void)value; return no_such_variables(c, n, "fmi2GetBoolean"); }
fmi2Status fmi2SetBoolean(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Boolean value[]) { (void)vr; (void)value; return no_such_variables(c, n, "fmi2SetBoolean"); }
fmi2Status fmi2GetString(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2String value[]) { (void)vr; (void)value; return no_such_variables(c, n, "fmi2GetString"); }
fmi2Status fmi2SetString(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2String value[]) { (void)vr; (void)value; return no_such_variables(c, n, "fmi2SetString"); }

/* ---- directional derivatives ---- */

/* The column of the Jacobian by a variable; NULL where there is none. */
static const double *jacobian_column(Model *m, unsigned k) {
    if (k < AT_DX || (k >= AT_U && k < AT_P)) {
        need_jacobian(m);
        return group(m, JX) + (size_t)(k < AT_DX ? k : k - NX) * NROW;
    }
    if (k < AT_P || k >= AT_Q) return NULL;
    need_parameter_jacobian(m);
    return group(m, JP) + (size_t)(k - AT_P) * NROW;
}
/* The row of a variable in it, or -1. */
static int jacobian_row(unsigned v) {
    if (v >= AT_DX && v < AT_U) return (int)(v - AT_DX);
    if (v >= AT_Y && v < NREAL) return (int)(v - AT_Y) + NX;
    return v >= AT_Q && v < AT_Y ? (int)(v - AT_Q) + NX + INFO.ny : -1;
}

/* Not of FMI: derivatives of n variables by `columns` others at once, a row for each of the n. */
__attribute__((visibility("default"))) fmi2Status ab_columns(fmi2Component c, const fmi2ValueReference unknown[], size_t n,
                                                             const fmi2ValueReference known[], size_t columns,
                                                             fmi2Real result[]) {
    Instance *s = c;
    if (s->m->phase == INITIALIZATION) initialise(s->m);
    for (size_t j = 0; j < columns; j++) {
        const double *column = jacobian_column(s->m, known[j]);
        if (!column) return fail(s, fmi2Error, "fmi2GetDirectionalDerivative: no derivative by value reference %u", known[j]);
        for (size_t i = 0; i < n; i++) {
            const int row = jacobian_row(unknown[i]);
            if (row < 0 && unknown[i] >= AT_DX)
                return fail(s, fmi2Error, "fmi2GetDirectionalDerivative: no derivative of value reference %u", unknown[i]);
            result[i * columns + j] = row < 0 ? unknown[i] == known[j] : column[row];
        }
    }
    return fmi2OK;
}

fmi2Status fmi2GetDirectionalDerivative(fmi2Component c, const fmi2ValueReference unknown[], size_t n_unknown,
                                        const fmi2ValueReference known[], size_t n_known, const fmi2Real seed[],
                                        fmi2Real result[]) {
    double by[n_unknown + 1];
    for (size_t i = 0; i < n_unknown; i++) result[i] = 0;
    for (size_t j = 0; j < n_known; j++) {
        const fmi2Status status = ab_columns(c, unknown, n_unknown, known + j, 1, by);
        if (status != fmi2OK) return status;
        for (size_t i = 0; i < n_unknown && seed[j] != 0; i++) result[i] += seed[j] * by[i];
    }
    return fmi2OK;
}

/* ---- model exchange ---- */

fmi2Status fmi2EnterEventMode(fmi2Component c) {
    Instance *s = c;
    if (!(s->m->phase & (CONTINUOUS | EVENT))) return fail(s, fmi2Error, "fmi2EnterEventMode: not in continuous-time mode");
    s->m->phase = EVENT;
    s->m->input_jumped = s->m->evaluations = 0;
    return fmi2OK;
}
fmi2Status fmi2NewDiscreteStates(fmi2Component c, fmi2EventInfo *info) {
    Instance *s = c;
    check_assertions(s);
    int states = handle_event(s->m);
    *info = (fmi2EventInfo){fmi2False, fmi2False, fmi2False, states > 0, isfinite(s->m->next_event), s->m->next_event};
    if (states < 0) return fail(s, fmi2Error, "the event at t = %g does not come to an end", s->m->time);
    return evaluation_status(s);
}
fmi2Status fmi2EnterContinuousTimeMode(fmi2Component c) {
    Instance *s = c;
    if (s->m->phase != EVENT) return fail(s, fmi2Error, "fmi2EnterContinuousTimeMode: not in event mode");
    s->m->phase = CONTINUOUS;
    return fmi2OK;
}
fmi2Status fmi2CompletedIntegratorStep(fmi2Component c, fmi2Boolean no_set_state, fmi2Boolean *event, fmi2Boolean *end) {
    (void)no_set_state;
    Model *m = ((Instance *)c)->m;
    *event = m->input_jumped;
    *end = fmi2False;
    m->input_jumped = 0;
    check_assertions(c);
    return fmi2OK;
}
fmi2Status fmi2SetTime(fmi2Component c, fmi2Real time) {
    Model *m = ((Instance *)c)->m;
    if (INFO.time_varying && m->time != time) invalidate(m, DEPENDS_ON_STATE);
    m->time = time;
    return fmi2OK;
}
fmi2Status fmi2SetContinuousStates(fmi2Component c, const fmi2Real x[], size_t n) {
    Instance *s = c;
    if (n != NX) return fail(s, fmi2Error, "fmi2SetContinuousStates: %zu states, the model has %d", n, NX);
    for (int i = 0; i < NX; i++) group(s->m, R)[i] = x[i];
    invalidate(s->m, DEPENDS_ON_STATE);
    return fmi2OK;
}
fmi2Status fmi2GetContinuousStates(fmi2Component c, fmi2Real x[], size_t n) {
    Instance *s = c;
    if (n != NX) return fail(s, fmi2Error, "fmi2GetContinuousStates: %zu states, the model has %d", n, NX);
    if (s->m->phase == INITIALIZATION) initialise(s->m);
    for (int i = 0; i < NX; i++) x[i] = group(s->m, R)[i];
    return fmi2OK;
}
fmi2Status fmi2GetNominalsOfContinuousStates(fmi2Component c, fmi2Real x[], size_t n) {
    Instance *s = c;
    if (n != NX) return fail(s, fmi2Error, "fmi2GetNominalsOfContinuousStates: %zu states, the model has %d", n, NX);
    for (int i = 0; i < NX; i++) x[i] = INFO.nominal[i];
    return fmi2OK;
}
fmi2Status fmi2GetDerivatives(fmi2Component c, fmi2Real dx[], size_t n) {
    Instance *s = c;
    if (n != NX) return fail(s, fmi2Error, "fmi2GetDerivatives: %zu states, the model has %d", n, NX);
    note_evaluation(s->m);
    need_derivatives(s->m);
    for (int i = 0; i < NX; i++) dx[i] = group(s->m, R)[AT_DX + i];
    return evaluation_status(s);
}
fmi2Status fmi2GetEventIndicators(fmi2Component c, fmi2Real z[], size_t n) {
    Instance *s = c;
    if ((int)n != count_indicators()) return fail(s, fmi2Error, "fmi2GetEventIndicators: the model has %d", count_indicators());
    if (n) event_indicators(s->m, z);
    return evaluation_status(s);
}

/* ---- the state of an FMU: kept, set, and as bytes ---- */

#define KEY 40 /* bytes of the model's guid before a serialized state */

fmi2Status fmi2GetFMUstate(fmi2Component c, fmi2FMUstate *state) {
    Instance *s = c;
    if (!*state) *state = malloc(MODEL_SIZE);
    if (!*state) return fail(s, fmi2Error, "fmi2GetFMUstate: out of memory");
    memcpy(*state, s->m, MODEL_SIZE);
    begin_steps(s->steps);
    return fmi2OK;
}
fmi2Status fmi2SetFMUstate(fmi2Component c, fmi2FMUstate state) {
    Instance *s = c;
    if (!state) return fail(s, fmi2Error, "fmi2SetFMUstate: no state");
    memcpy(s->m, state, MODEL_SIZE);
    begin_steps(s->steps);
    return fmi2OK;
}
fmi2Status fmi2FreeFMUstate(fmi2Component c, fmi2FMUstate *state) {
    (void)c;
    if (state) { free(*state); *state = NULL; }
    return fmi2OK;
}
fmi2Status fmi2SerializedFMUstateSize(fmi2Component c, fmi2FMUstate state, size_t *size) {
    (void)c; (void)state;
    *size = KEY + MODEL_SIZE;
    return fmi2OK;
}
fmi2Status fmi2SerializeFMUstate(fmi2Component c, fmi2FMUstate state, fmi2Byte bytes[], size_t size) {
    if (!state || size < KEY + MODEL_SIZE) return fail(c, fmi2Error, "fmi2SerializeFMUstate: the buffer is too small");
    memset(bytes, 0, KEY);
    strncpy(bytes, INFO.guid, KEY);
    memcpy(bytes + KEY, state, MODEL_SIZE);
    return fmi2OK;
}
fmi2Status fmi2DeSerializeFMUstate(fmi2Component c, const fmi2Byte bytes[], size_t size, fmi2FMUstate *state) {
    Instance *s = c;
    if (size != KEY + MODEL_SIZE || strncmp(bytes, INFO.guid, KEY))
        return fail(s, fmi2Error, "fmi2DeSerializeFMUstate: not a state of this model");
    if (!*state) *state = malloc(MODEL_SIZE);
    if (!*state) return fail(s, fmi2Error, "fmi2DeSerializeFMUstate: out of memory");
    memcpy(*state, bytes + KEY, MODEL_SIZE);
    return fmi2OK;
}

#include "fmi2_cosimulation.h"
