/* FMI 2.0 Model Exchange and Co-Simulation around a generated explicit model.
 *
 * The generated part comes first in the same translation unit. It defines
 *   NX, NU, NP, NQ, NY     numbers of states, inputs, free and dependent parameters, outputs that are no state
 *   NK, NROW, NREAL        saved parameter expressions, Jacobian rows (NX + NY + NQ), values
 *   MODEL_GUID, MODEL_NAME, TIME_VARYING
 *   Model                  the instance (see below), and the functions eval_*.
 *
 * Value references index Model.r: states, derivatives, inputs, free parameters, dependent parameters, outputs.
 * The Jacobian is dense, by columns: inputs and states in jx, free parameters in jp; what is structurally zero is
 * never written. Everything is evaluated when it is asked for and kept until something that it needs changes.
 */

enum { AT_X = 0, AT_DX = NX, AT_U = 2 * NX, AT_P = 2 * NX + NU, AT_Q = AT_P + NP, AT_Y = AT_Q + NQ };
enum { FRESH_K = 1, FRESH_DX = 2, FRESH_Y = 4, FRESH_JX = 8, FRESH_JP = 16, FRESH_ALL = 31 };
enum { INSTANTIATED = 1, INITIALIZATION = 2, EVENT = 4, CONTINUOUS = 8, STEPPED = 16, TERMINATED = 32, FAILED = 64 };

typedef struct {
    Model *m;
    fmi2CallbackFunctions call;
    fmi2String name;
    fmi2Boolean logging;
} Instance;

static const char state_key[40] = MODEL_GUID;

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

/* ---- lazy evaluation ---- */

static inline void stale(Model *m, int flags) { m->fresh &= ~flags; }

static inline void need_k(Model *m) {
    if (!(m->fresh & FRESH_K)) { eval_k(m); m->fresh |= FRESH_K; }
}
static inline void need_dx(Model *m) {
    if (!(m->fresh & FRESH_DX)) { need_k(m); eval_dx(m); m->fresh |= FRESH_DX; }
}
static inline void need_y(Model *m) {
    if (!(m->fresh & FRESH_Y)) { need_k(m); eval_y(m); m->fresh |= FRESH_Y; }
}
static inline void need_jx(Model *m) {
    if (!(m->fresh & FRESH_JX)) { need_k(m); eval_jx(m); m->fresh |= FRESH_JX; }
}
static inline void need_jp(Model *m) {
    if (!(m->fresh & FRESH_JP)) { need_k(m); eval_jp(m); m->fresh |= FRESH_JP; }
}

static const int moved = FRESH_DX | FRESH_Y | FRESH_JX | FRESH_JP;

static void reset(Model *m) {
    memset(m, 0, sizeof *m);
    set_defaults(m);
    m->phase = INSTANTIATED;
    m->tolerance = 1e-6;
}

/* ---- instances ---- */

const char *fmi2GetTypesPlatform(void) { return fmi2TypesPlatform; }
const char *fmi2GetVersion(void) { return fmi2Version; }

fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String resources,
                              const fmi2CallbackFunctions *functions, fmi2Boolean visible, fmi2Boolean logging) {
    (void)type; (void)resources; (void)visible;
    if (!functions) return NULL;
    Instance proxy = {NULL, *functions, name ? name : "", logging};
    if (!name || !*name) { fail(&proxy, fmi2Error, "fmi2Instantiate: the instance needs a name"); return NULL; }
    if (!guid || strcmp(guid, MODEL_GUID)) {
        fail(&proxy, fmi2Error, "fmi2Instantiate: guid %s, expected %s", guid ? guid : "(none)", MODEL_GUID);
        return NULL;
    }
    size_t length = strlen(name) + 1;
    Instance *s = calloc(1, sizeof *s);
    Model *m = calloc(1, sizeof *m);
    char *copy = malloc(length);
    if (!s || !m || !copy) {
        free(s); free(m); free(copy);
        fail(&proxy, fmi2Error, "fmi2Instantiate: out of memory");
        return NULL;
    }
    memcpy(copy, name, length);
    *s = (Instance){m, *functions, copy, logging};
    reset(m);
    return s;
}

void fmi2FreeInstance(fmi2Component c) {
    Instance *s = c;
    if (!s) return;
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
    stale(s->m, moved);
    return fmi2OK;
}

fmi2Status fmi2EnterInitializationMode(fmi2Component c) {
    Instance *s = c;
    if (s->m->phase != INSTANTIATED) return fail(s, fmi2Error, "fmi2EnterInitializationMode: only after instantiation or reset");
    s->m->phase = INITIALIZATION;
    return fmi2OK;
}

/* initial values that depend on parameters, unless somebody has set them */
static void start_states(Model *m) {
    need_k(m);
    eval_start(m);
    stale(m, moved);
}

fmi2Status fmi2ExitInitializationMode(fmi2Component c) {
    Instance *s = c;
    if (s->m->phase != INITIALIZATION) return fail(s, fmi2Error, "fmi2ExitInitializationMode: not in initialisation mode");
    start_states(s->m);
    s->m->phase = EVENT;
    return fmi2OK;
}

fmi2Status fmi2Terminate(fmi2Component c) {
    ((Instance *)c)->m->phase = TERMINATED;
    return fmi2OK;
}

fmi2Status fmi2Reset(fmi2Component c) {
    reset(((Instance *)c)->m);
    return fmi2OK;
}

/* ---- values ---- */

fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2Real value[]) {
    Instance *s = c;
    Model *m = s->m;
    if (m->phase == INITIALIZATION) start_states(m);
    for (size_t i = 0; i < n; i++) {
        unsigned v = vr[i];
        if (v >= NREAL) return fail(s, fmi2Error, "fmi2GetReal: no variable with value reference %u", v);
        if (v >= AT_Y) need_y(m);
        else if (v >= AT_Q) need_k(m);
        else if (v >= AT_DX && v < AT_U) need_dx(m);
        value[i] = m->r[v];
    }
    return fmi2OK;
}

fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Real value[]) {
    Instance *s = c;
    Model *m = s->m;
    for (size_t i = 0; i < n; i++) {
        unsigned v = vr[i];
        if (v < AT_DX) {
            /* Until initialisation ends it is a start value; later, as some importers (CasADi) want it, the state itself. */
            if (m->phase & (INSTANTIATED | INITIALIZATION)) m->started[v] = 1;
            stale(m, moved);
        } else if (v >= AT_U && v < AT_P) {
            stale(m, moved);
        } else if (v >= AT_P && v < AT_Q) {
            stale(m, FRESH_ALL);
        } else {
            return fail(s, fmi2Error, "fmi2SetReal: the variable with value reference %u cannot be set", v);
        }
        m->r[v] = value[i];
    }
    return fmi2OK;
}

static fmi2Status none(fmi2Component c, size_t n, const char *what) {
    return n ? fail(c, fmi2Error, "%s: the model has no such variables", what) : fmi2OK;
}
fmi2Status fmi2GetInteger(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2Integer value[]) { (void)vr; (void)value; return none(c, n, "fmi2GetInteger"); }
fmi2Status fmi2SetInteger(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Integer value[]) { (void)vr; (void)value; return none(c, n, "fmi2SetInteger"); }
fmi2Status fmi2GetBoolean(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2Boolean value[]) { (void)vr; (void)value; return none(c, n, "fmi2GetBoolean"); }
fmi2Status fmi2SetBoolean(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Boolean value[]) { (void)vr; (void)value; return none(c, n, "fmi2SetBoolean"); }
fmi2Status fmi2GetString(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2String value[]) { (void)vr; (void)value; return none(c, n, "fmi2GetString"); }
fmi2Status fmi2SetString(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2String value[]) { (void)vr; (void)value; return none(c, n, "fmi2SetString"); }

/* ---- state of the FMU ---- */

fmi2Status fmi2GetFMUstate(fmi2Component c, fmi2FMUstate *state) {
    Instance *s = c;
    if (!*state) *state = malloc(sizeof(Model));
    if (!*state) return fail(s, fmi2Error, "fmi2GetFMUstate: out of memory");
    memcpy(*state, s->m, sizeof(Model));
    return fmi2OK;
}
fmi2Status fmi2SetFMUstate(fmi2Component c, fmi2FMUstate state) {
    Instance *s = c;
    if (!state) return fail(s, fmi2Error, "fmi2SetFMUstate: no state");
    memcpy(s->m, state, sizeof(Model));
    return fmi2OK;
}
fmi2Status fmi2FreeFMUstate(fmi2Component c, fmi2FMUstate *state) {
    (void)c;
    if (state) { free(*state); *state = NULL; }
    return fmi2OK;
}
fmi2Status fmi2SerializedFMUstateSize(fmi2Component c, fmi2FMUstate state, size_t *size) {
    (void)c; (void)state;
    *size = sizeof state_key + sizeof(Model);
    return fmi2OK;
}
fmi2Status fmi2SerializeFMUstate(fmi2Component c, fmi2FMUstate state, fmi2Byte bytes[], size_t size) {
    if (!state || size < sizeof state_key + sizeof(Model)) return fail(c, fmi2Error, "fmi2SerializeFMUstate: the buffer is too small");
    memcpy(bytes, state_key, sizeof state_key);
    memcpy(bytes + sizeof state_key, state, sizeof(Model));
    return fmi2OK;
}
fmi2Status fmi2DeSerializeFMUstate(fmi2Component c, const fmi2Byte bytes[], size_t size, fmi2FMUstate *state) {
    Instance *s = c;
    if (size != sizeof state_key + sizeof(Model) || memcmp(bytes, state_key, sizeof state_key))
        return fail(s, fmi2Error, "fmi2DeSerializeFMUstate: not a state of this model");
    if (!*state) *state = malloc(sizeof(Model));
    if (!*state) return fail(s, fmi2Error, "fmi2DeSerializeFMUstate: out of memory");
    memcpy(*state, bytes + sizeof state_key, sizeof(Model));
    return fmi2OK;
}

/* ---- directional derivatives ---- */

fmi2Status fmi2GetDirectionalDerivative(fmi2Component c, const fmi2ValueReference unknown[], size_t n_unknown,
                                        const fmi2ValueReference known[], size_t n_known, const fmi2Real seed[],
                                        fmi2Real result[]) {
    Instance *s = c;
    Model *m = s->m;
    if (m->phase == INITIALIZATION) start_states(m);
    for (size_t i = 0; i < n_unknown; i++) result[i] = 0;
    for (size_t j = 0; j < n_known; j++) {
        unsigned k = known[j];
        const double *column;
        if (k < AT_DX) { need_jx(m); column = m->jx + (size_t)k * NROW; }
        else if (k >= AT_U && k < AT_P) { need_jx(m); column = m->jx + (size_t)(k - NX) * NROW; }
        else if (k >= AT_P && k < AT_Q) { need_jp(m); column = m->jp + (size_t)(k - AT_P) * NROW; }
        else return fail(s, fmi2Error, "fmi2GetDirectionalDerivative: no derivative by value reference %u", k);
        if (seed[j] == 0) continue;
        for (size_t i = 0; i < n_unknown; i++) {
            unsigned v = unknown[i];
            if (v >= AT_DX && v < AT_U) result[i] += seed[j] * column[v - AT_DX];
            else if (v >= AT_Q && v < NREAL) result[i] += seed[j] * column[v - AT_Q + NX];
            else if (v < AT_DX) result[i] += v == k ? seed[j] : 0;
            else return fail(s, fmi2Error, "fmi2GetDirectionalDerivative: no derivative of value reference %u", v);
        }
    }
    return fmi2OK;
}

/* ---- model exchange ---- */

fmi2Status fmi2EnterEventMode(fmi2Component c) {
    Instance *s = c;
    if (!(s->m->phase & (CONTINUOUS | EVENT))) return fail(s, fmi2Error, "fmi2EnterEventMode: not in continuous-time mode");
    s->m->phase = EVENT;
    return fmi2OK;
}
fmi2Status fmi2NewDiscreteStates(fmi2Component c, fmi2EventInfo *info) {
    (void)c;
    *info = (fmi2EventInfo){fmi2False, fmi2False, fmi2False, fmi2False, fmi2False, 0};
    return fmi2OK;
}
fmi2Status fmi2EnterContinuousTimeMode(fmi2Component c) {
    Instance *s = c;
    if (s->m->phase != EVENT) return fail(s, fmi2Error, "fmi2EnterContinuousTimeMode: not in event mode");
    s->m->phase = CONTINUOUS;
    return fmi2OK;
}
fmi2Status fmi2CompletedIntegratorStep(fmi2Component c, fmi2Boolean no_set_state, fmi2Boolean *event, fmi2Boolean *end) {
    (void)c; (void)no_set_state;
    *event = fmi2False;
    *end = fmi2False;
    return fmi2OK;
}
fmi2Status fmi2SetTime(fmi2Component c, fmi2Real time) {
    Model *m = ((Instance *)c)->m;
    if (TIME_VARYING && m->time != time) stale(m, moved);
    m->time = time;
    return fmi2OK;
}
fmi2Status fmi2SetContinuousStates(fmi2Component c, const fmi2Real x[], size_t n) {
    Instance *s = c;
    if (n != NX) return fail(s, fmi2Error, "fmi2SetContinuousStates: %zu states, the model has %d", n, NX);
    for (int i = 0; i < NX; i++) s->m->r[i] = x[i];
    stale(s->m, moved);
    return fmi2OK;
}
fmi2Status fmi2GetContinuousStates(fmi2Component c, fmi2Real x[], size_t n) {
    Instance *s = c;
    if (n != NX) return fail(s, fmi2Error, "fmi2GetContinuousStates: %zu states, the model has %d", n, NX);
    if (s->m->phase == INITIALIZATION) start_states(s->m);
    for (int i = 0; i < NX; i++) x[i] = s->m->r[i];
    return fmi2OK;
}
fmi2Status fmi2GetNominalsOfContinuousStates(fmi2Component c, fmi2Real x[], size_t n) {
    Instance *s = c;
    if (n != NX) return fail(s, fmi2Error, "fmi2GetNominalsOfContinuousStates: %zu states, the model has %d", n, NX);
    for (int i = 0; i < NX; i++) x[i] = nominal[i];
    return fmi2OK;
}
fmi2Status fmi2GetDerivatives(fmi2Component c, fmi2Real dx[], size_t n) {
    Instance *s = c;
    if (n != NX) return fail(s, fmi2Error, "fmi2GetDerivatives: %zu states, the model has %d", n, NX);
    need_dx(s->m);
    for (int i = 0; i < NX; i++) dx[i] = s->m->r[AT_DX + i];
    return fmi2OK;
}
fmi2Status fmi2GetEventIndicators(fmi2Component c, fmi2Real z[], size_t n) {
    (void)z;
    return n ? fail(c, fmi2Error, "fmi2GetEventIndicators: the model has none") : fmi2OK;
}

/* ---- co-simulation: RODAS4 (Hairer and Wanner, Solving ODEs II, section IV.7) with the exact Jacobian ---- */

static int lu(double *a, int *pivot) {
    for (int k = 0; k < NX; k++) {
        int p = k;
        for (int i = k + 1; i < NX; i++) if (fabs(a[i * NXX + k]) > fabs(a[p * NXX + k])) p = i;
        pivot[k] = p;
        if (!(fabs(a[p * NXX + k]) > 0)) return 0;
        if (p != k) for (int j = 0; j < NX; j++) { double t = a[k * NXX + j]; a[k * NXX + j] = a[p * NXX + j]; a[p * NXX + j] = t; }
        for (int i = k + 1; i < NX; i++) {
            double f = a[i * NXX + k] /= a[k * NXX + k];
            if (f != 0) for (int j = k + 1; j < NX; j++) a[i * NXX + j] -= f * a[k * NXX + j];
        }
    }
    return 1;
}
static void solve(const double *a, const int *pivot, double *b) {
    for (int k = 0; k < NX; k++) {
        double t = b[pivot[k]]; b[pivot[k]] = b[k]; b[k] = t;
    }
    for (int i = 0; i < NX; i++) for (int j = 0; j < i; j++) b[i] -= a[i * NXX + j] * b[j];
    for (int i = NX - 1; i >= 0; i--) {
        for (int j = i + 1; j < NX; j++) b[i] -= a[i * NXX + j] * b[j];
        b[i] /= a[i * NXX + i];
    }
}

static void rhs(Model *m, double t, const double *x, double *dx) {
    m->time = t;
    memcpy(m->r, x, NX * sizeof *x);
    stale(m, moved);
    need_dx(m);
    memcpy(dx, m->r + AT_DX, NX * sizeof *dx);
}

/* One step of size h from (t, x) to y; returns the error relative to the tolerance, or a negative number. */
static double rodas(Model *m, double t, const double *x, double h, double *y) {
    static const double gamma = 0.25;
    static const double alpha[6] = {0, 0.386, 0.21, 0.63, 1, 1};
    static const double d[6] = {0.25, -0.1043, 0.1035, -0.03620000000000023, 0, 0};
    static const double a[6][5] = {
        {0}, {1.544}, {0.9466785280815826, 0.2557011698983284},
        {3.314825187068521, 2.896124015972201, 0.9986419139977817},
        {1.221224509226641, 6.019134481288629, 12.53708332932087, -0.6878860361058950},
        {1.221224509226641, 6.019134481288629, 12.53708332932087, -0.6878860361058950, 1}};
    static const double c[6][5] = {
        {0}, {-5.6688}, {-2.430093356833875, -0.2063599157091915},
        {-0.1073529058151375, -9.594562251023355, -20.47028614809616},
        {7.496443313967647, -10.24680431464352, -33.99990352819905, 11.70890893206160},
        {8.083246795921522, -7.981132988064893, -31.52159432874371, 16.31930543123136, -6.058818238834054}};
    double w[NXX * NXX], u[6][NXX], f[NXX], ft[NXX] = {0}, arg[NXX];
    int pivot[NXX];
    rhs(m, t, x, f);
    need_jx(m);
    for (int i = 0; i < NX; i++)
        for (int j = 0; j < NX; j++) w[i * NXX + j] = (i == j ? 1 / (gamma * h) : 0) - m->jx[(size_t)j * NROW + i];
    if (TIME_VARYING) {
        double e = 1e-8 * fmax(fabs(t), 1.0);
        rhs(m, t + e, x, ft);
        for (int i = 0; i < NX; i++) ft[i] = (ft[i] - f[i]) / e;
    }
    if (!lu(w, pivot)) return -1;
    memcpy(y, x, NX * sizeof *x);
    for (int k = 0; k < 6; k++) {
        if (k) {
            for (int i = 0; i < NX; i++) {
                arg[i] = x[i];
                for (int j = 0; j < k; j++) arg[i] += a[k][j] * u[j][i];
            }
            rhs(m, t + alpha[k] * h, arg, f);
        }
        for (int i = 0; i < NX; i++) {
            u[k][i] = f[i] + h * d[k] * ft[i];
            for (int j = 0; j < k; j++) u[k][i] += c[k][j] / h * u[j][i];
        }
        solve(w, pivot, u[k]);
        if (k == 5) for (int i = 0; i < NX; i++) y[i] = arg[i] + u[5][i];
    }
    double worst = 0;
    for (int i = 0; i < NX; i++) {
        double scale = m->tolerance * (fabs(nominal[i]) + fmax(fabs(x[i]), fabs(y[i])));
        double e = fabs(u[5][i]) / scale;
        if (!(e <= worst)) worst = e;
    }
    return isfinite(worst) ? worst : -1;
}

fmi2Status fmi2DoStep(fmi2Component c, fmi2Real start, fmi2Real size, fmi2Boolean no_set_state) {
    Instance *s = c;
    Model *m = s->m;
    (void)no_set_state;
    if (!(m->phase & (EVENT | STEPPED))) return fail(s, fmi2Error, "fmi2DoStep: the model is not initialised");
    if (!(size > 0)) return fail(s, fmi2Error, "fmi2DoStep: step size %g", size);
    m->phase = STEPPED;
    double end = start + size, t = start, x[NXX], y[NXX];
    memcpy(x, m->r, NX * sizeof *x);
    double h = m->step > 0 ? m->step : size * 1e-3;
    for (long count = 0; NX > 0 && t < end; count++) {
        double left = end - t;
        int last = h >= left * (1 - 1e-12);
        double now = last ? left : h > 0.5 * left ? 0.5 * left : h;
        double e = rodas(m, t, x, now, y);
        double grow = e < 0 ? 0.1 : fmin(5, fmax(0.2, 0.9 * pow(fmax(e, 1e-10), -0.25)));
        if (e >= 0 && e <= 1) {
            t = last ? end : t + now;
            memcpy(x, y, NX * sizeof *x);
            h = last && now * grow < h ? h : now * grow;
        } else {
            h = now * fmin(grow, 0.9);
            if (!(h > 1e-14 * fmax(fabs(t), size)) || count > 10000000) {
                memcpy(m->r, x, NX * sizeof *x);
                m->time = t;
                stale(m, moved);
                m->phase = FAILED;
                return fail(s, fmi2Error, "fmi2DoStep: the solver cannot pass t = %g", t);
            }
        }
    }
    m->step = h;
    memcpy(m->r, x, NX * sizeof *x);
    m->time = end;
    stale(m, moved);
    return fmi2OK;
}

fmi2Status fmi2CancelStep(fmi2Component c) { return fail(c, fmi2Error, "fmi2CancelStep: steps are synchronous"); }
fmi2Status fmi2SetRealInputDerivatives(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Integer order[], const fmi2Real value[]) {
    (void)vr; (void)order; (void)value;
    return n ? fail(c, fmi2Error, "fmi2SetRealInputDerivatives: inputs are held over a step") : fmi2OK;
}
fmi2Status fmi2GetRealOutputDerivatives(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Integer order[], fmi2Real value[]) {
    (void)vr; (void)order; (void)value;
    return n ? fail(c, fmi2Error, "fmi2GetRealOutputDerivatives: not provided") : fmi2OK;
}
fmi2Status fmi2GetStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Status *value) { (void)kind; (void)value; return fail(c, fmi2Discard, "fmi2GetStatus: steps are synchronous"); }
fmi2Status fmi2GetRealStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Real *value) {
    if (kind == fmi2LastSuccessfulTime) { *value = ((Instance *)c)->m->time; return fmi2OK; }
    return fail(c, fmi2Discard, "fmi2GetRealStatus: not provided");
}
fmi2Status fmi2GetIntegerStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Integer *value) { (void)kind; (void)value; return fail(c, fmi2Discard, "fmi2GetIntegerStatus: not provided"); }
fmi2Status fmi2GetBooleanStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Boolean *value) {
    if (kind == fmi2Terminated) { *value = fmi2False; return fmi2OK; }
    return fail(c, fmi2Discard, "fmi2GetBooleanStatus: not provided");
}
fmi2Status fmi2GetStringStatus(fmi2Component c, const fmi2StatusKind kind, fmi2String *value) { (void)kind; (void)value; return fail(c, fmi2Discard, "fmi2GetStringStatus: not provided"); }
