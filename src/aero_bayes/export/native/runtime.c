/* FMI 2.0 Model Exchange and Co-Simulation around a generated model (model.h).
 *
 * Everything is evaluated when it is asked for and kept until something that it needs changes. Relations, rounded and
 * discrete values are constant between events; an event is iterated here until nothing changes any more.
 */
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "fmi2Functions.h"
#include "model.h"

#define INFO model_info
#define MODEL_SIZE (sizeof(Model) + sizeof(double) * INFO.size)
#define KEY 40 /* bytes of the model's guid before a serialized state */
#define NX INFO.nx
#define NXX (INFO.nx + 1)
#define AT_DX (unsigned)INFO.nx
#define AT_U (2 * AT_DX)
#define AT_P (AT_U + INFO.nu)
#define AT_Q (AT_P + INFO.np)
#define AT_Y (AT_Q + INFO.nq)
#define NREAL (AT_Y + INFO.ny)
#define NROW (INFO.nx + INFO.ny + INFO.nq)

enum { FRESH_K = 1, FRESH_DX = 2, FRESH_Y = 4, FRESH_JX = 8, FRESH_JP = 16, FRESH_W = 32, FRESH_ALL = 63 };
enum { INSTANTIATED = 1, INITIALIZATION = 2, EVENT = 4, CONTINUOUS = 8, STEPPED = 16, TERMINATED = 32, FAILED = 64 };

typedef struct {
    Model *m;
    fmi2CallbackFunctions call;
    fmi2String name;
    fmi2Boolean logging;
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

/* ---- linear equations ---- */

static inline double *group(Model *m, enum Group g) { return m->data + INFO.at[g]; }

/* LU by columns of an n by n matrix, with partial pivoting; 0 where it is singular. */
static int factorise(double *a, int *pivot, int n) {
    for (int k = 0; k < n; k++) {
        int p = k;
        for (int i = k + 1; i < n; i++) if (fabs(a[k * n + i]) > fabs(a[k * n + p])) p = i;
        pivot[k] = p;
        if (!(fabs(a[k * n + p]) > 0)) return 0;
        if (p != k) for (int j = 0; j < n; j++) { double t = a[j * n + k]; a[j * n + k] = a[j * n + p]; a[j * n + p] = t; }
        for (int i = k + 1; i < n; i++) a[k * n + i] /= a[k * n + k];
        for (int j = k + 1; j < n; j++) {
            double f = a[j * n + k];
            if (f != 0) for (int i = k + 1; i < n; i++) a[j * n + i] -= f * a[k * n + i];
        }
    }
    return 1;
}
static void substitute(const double *a, const int *pivot, double *b, int n) {
    for (int k = 0; k < n; k++) { double t = b[pivot[k]]; b[pivot[k]] = b[k]; b[k] = t; }
    for (int j = 0; j < n; j++) for (int i = j + 1; i < n; i++) b[i] -= a[j * n + i] * b[j];
    for (int j = n - 1; j >= 0; j--) {
        b[j] /= a[j * n + j];
        for (int i = 0; i < j; i++) b[i] -= a[j * n + i] * b[j];
    }
}

/* ---- algebraic loops: Newton with the exact Jacobian ---- */

/* Residual and Jacobian at w. */
static void residual(Model *m, const Block *b, double *f, double *j) {
    memset(j, 0, sizeof *j * b->n * b->n);
    b->residual(m, f, j);
}
/* The largest entry of each row of the Jacobian. */
static void rows(const double *j, int n, double *row) {
    for (int i = 0; i < n; i++) {
        row[i] = 0;
        for (int k = 0; k < n; k++) row[i] = fmax(row[i], fabs(j[k * n + i]));
        if (!(row[i] > 0)) row[i] = 1;
    }
}
/* The largest residual, each relative to its row: those of one place, as a slope that changes changes no progress. */
static double largest(const double *f, const double *row, int n) {
    double worst = 0;
    for (int i = 0; i < n; i++) {
        double e = fabs(f[i]) / row[i];
        if (!(e <= worst)) worst = e;
    }
    return worst;
}
/* The Newton step into f; 2 where the equations leave it open and it is the shortest, 0 where there is none. */
static int newton_step(double *j, double *f, int n) {
    double a[n * n], right[n], ridge = 0;
    int pivot[n];
    memcpy(a, j, sizeof a);
    if (factorise(a, pivot, n)) {
        substitute(a, pivot, f, n);
        return 1;
    }
    for (int i = 0; i < n; i++) {
        right[i] = 0;
        for (int r = 0; r < n; r++) right[i] += j[i * n + r] * f[r];
        for (int k = 0; k < n; k++) {
            a[k * n + i] = 0;
            for (int r = 0; r < n; r++) a[k * n + i] += j[i * n + r] * j[k * n + r];
        }
        ridge = fmax(ridge, a[i * n + i]);
    }
    for (int i = 0; i < n; i++) a[i * n + i] += 1e-12 * ridge;
    if (!factorise(a, pivot, n)) return 0;
    substitute(a, pivot, right, n);
    memcpy(f, right, sizeof right);
    return 2;
}
static int solve_block(Model *m, const Block *b, double *w) {
    const int n = b->n;
    double f[n], j[n * n], old[n], row[n];
    residual(m, b, f, j);
    for (int round = 0; round < 100; round++) {
        rows(j, n, row);
        const double size = largest(f, row, n);
        int found = isfinite(size) ? newton_step(j, f, n) : 0;
        if (!found) return 0;
        memcpy(old, w, sizeof old);
        int done = 1, near = 1;
        for (int i = 0; i < n; i++) {
            done &= fabs(f[i]) <= 1e-13 * fabs(w[i]) + 1e-300;
            near &= fabs(f[i]) <= 1e-9 * fabs(w[i]) + 1e-12;
        }
        double step[n], share = 1, next = 0;
        memcpy(step, f, sizeof step);
        for (int halved = 0; halved < 12; halved++, share *= 0.5) {
            for (int i = 0; i < n; i++) w[i] = old[i] - share * step[i];
            residual(m, b, f, j);
            next = largest(f, row, n);
            if (next <= (1 - 1e-3 * share) * size || near || b->linear) break; /* no circling */
        }
        if (!isfinite(next)) return 0;
        if (found == 2) { /* two locked brakes on one shaft share the load as they like, if they agree */
            double most = 1;
            for (int i = 0; i < n; i++) most = fmax(most, fabs(w[i]));
            if (next <= 1e-10 * most) return 1;
            if (done) return 0;
        } else if (b->linear && round) return 1; /* solved and refined once: what is left is rounding, however small w is */
        if (done || next == 0 || (near && round > 2 && next >= 0.5 * size)) return 1;
    }
    return 0;
}

/* ---- lazy evaluation ---- */

static inline void stale(Model *m, int flags) { m->fresh &= ~flags; }

static const int moved = FRESH_DX | FRESH_Y | FRESH_JX | FRESH_JP | FRESH_W;

static inline void need_k(Model *m) {
    if (!(m->fresh & FRESH_K)) { INFO.k(m); m->fresh |= FRESH_K; }
}
/* A loop without a solution says so to the importer, and the next attempt starts from the start values. */
static int failed(Model *m) {
    if (!m->failed) return 0;
    m->failed = 0;
    stale(m, moved);
    Model *other = calloc(1, MODEL_SIZE);
    if (other) {
        INFO.set_defaults(other);
        memcpy(group(m, W), group(other, W), sizeof(double) * INFO.nw);
        free(other);
    }
    return 1;
}
static inline void need_w(Model *m) {
    if (m->fresh & FRESH_W) return;
    need_k(m);
    failed(m); /* with other relations than before it may have one */
    for (int i = 0; i < INFO.blocks; i++)
        if (!solve_block(m, INFO.block + i, group(m, W) + INFO.block[i].first)) {
            m->failed = 1;
            for (int k = 0; k < INFO.nw; k++) group(m, W)[k] = NAN;
            break;
        }
    m->fresh |= FRESH_W;
}
static inline void need_dx(Model *m) {
    if (!(m->fresh & FRESH_DX)) { need_w(m); INFO.dx(m); m->fresh |= FRESH_DX; }
}
static inline void need_y(Model *m) {
    if (!(m->fresh & FRESH_Y)) { need_w(m); INFO.y(m); m->fresh |= FRESH_Y; }
}

/* Adds what the loops' unknowns pass on: dw/dv = -FW^-1 FV for every column v of the Jacobian. */
static void pass_on(Model *m, double *jacobian, const double *by, int columns) {
    const int n = INFO.nw, rows = NROW;
    double a[n * n], s[n];
    int pivot[n];
    memcpy(a, group(m, FW), sizeof a);
    if (!factorise(a, pivot, n)) return;
    for (int c = 0; c < columns; c++) {
        for (int i = 0; i < n; i++) s[i] = -by[(size_t)c * n + i];
        substitute(a, pivot, s, n);
        for (int k = 0; k < n; k++)
            for (int i = 0; i < rows; i++) jacobian[(size_t)c * rows + i] += group(m, JW)[(size_t)k * rows + i] * s[k];
    }
}
static void need_jx(Model *m) {
    if (m->fresh & FRESH_JX) return;
    need_w(m);
    const int rows = INFO.nx + INFO.ny + INFO.nq, columns = INFO.nx + INFO.nu;
    if (INFO.nw) memset(group(m, JX), 0, sizeof(double) * rows * columns);
    INFO.jx(m);
    if (INFO.nw) {
        INFO.jw(m);
        pass_on(m, group(m, JX), group(m, FX), columns);
    }
    m->fresh |= FRESH_JX;
}
static void need_jp(Model *m) {
    if (m->fresh & FRESH_JP) return;
    need_w(m);
    if (INFO.nw) memset(group(m, JP), 0, sizeof(double) * NROW * INFO.np);
    INFO.jp(m);
    if (INFO.nw) {
        INFO.jw(m);
        INFO.fp(m);
        pass_on(m, group(m, JP), group(m, FP), INFO.np);
    }
    m->fresh |= FRESH_JP;
}

static void reset(Model *m) {
    memset(m, 0, MODEL_SIZE);
    INFO.set_defaults(m);
    m->phase = INSTANTIATED;
    m->tolerance = 1e-6;
    m->next_event = INFINITY;
}

/* ---- events ---- */

/* Discrete values for the present relations; whether they and the loops come to agree. Earlier values stay in PRE. */
static int settle(Model *m) {
    double before[INFO.nd + 1];
    for (int round = 0; round < 50; round++) {
        need_w(m);
        memcpy(before, group(m, D), sizeof(double) * INFO.nd);
        INFO.discrete(m);
        if (!memcmp(before, group(m, D), sizeof(double) * INFO.nd)) return 1;
        stale(m, moved);
    }
    return 0;
}
/* Relations and rounded values at this instant; whether any has changed. ``singly``: of relations at most one, and one
   that becomes false before one that becomes true; those that take turns come to rest so. */
static int refresh(Model *m, int singly) {
    int changed = 0, off = -1, on = -1;
    need_w(m);
    INFO.watch(m);
    INFO.times(m);
    const double *d = group(m, DIFF);
    for (int i = 0; i < INFO.relations; i++) {
        double value = d[i];
        if (INFO.timed[i]) value += group(m, SLOPE)[i] * 1e-12 * fmax(1, fabs(m->time));
        double now = INFO.below[i] ? value < 0 : value > 0;
        if (now == group(m, REL)[i]) continue;
        changed = 1;
        if (!singly) group(m, REL)[i] = now;
        else if (now == 0 && off < 0) off = i;
        else if (now != 0 && on < 0) on = i;
    }
    if (off >= 0) group(m, REL)[off] = 0;
    else if (on >= 0) group(m, REL)[on] = 1;
    for (int i = 0; i < INFO.roundings; i++) {
        double now = floor(d[INFO.relations + i]);
        changed |= now != group(m, ROUND)[i];
        group(m, ROUND)[i] = now;
    }
    if (changed) stale(m, moved);
    return changed;
}
/* Whether a when clause is due: what it does goes by the relations before it. */
static int fires(Model *m) {
    const int first = INFO.nd - INFO.conditions;
    return memcmp(group(m, PRE) + first, group(m, D) + first, sizeof(double) * INFO.conditions) != 0;
}
/* Until nothing changes; whether states were set anew, or -1 where it does not end. Relations, discrete values and loops
   come to agree before earlier values give way: friction that comes to rest is stuck, if that holds, before it slides. */
static int iterate(Model *m) {
    int states = 0;
    for (int round = 0; round < 200; round++) {
        if (!settle(m)) return -1;
        for (int k = 0; k < 50 && !fires(m) && refresh(m, k > 5); k++)
            if (!settle(m)) return -1;
        int changed = INFO.reinit(m);
        states |= changed;
        if (changed) stale(m, moved);
        changed |= refresh(m, 0);
        changed |= memcmp(group(m, PRE), group(m, D), sizeof(double) * INFO.nd) != 0;
        memcpy(group(m, PRE), group(m, D), sizeof(double) * INFO.nd);
        if (!changed) return states;
    }
    return -1;
}
static int fire(Model *m) {
    int any = 0;
    INFO.times(m);
    for (int i = 0; i < INFO.samples; i++) {
        double start = group(m, TICK)[2 * i], interval = group(m, TICK)[2 * i + 1];
        double k = round((m->time - start) / interval);
        int now = k >= 0 && k > group(m, LAST)[i] - 1 && fabs(m->time - start - k * interval) <= 1e-9 * interval;
        if (now) group(m, LAST)[i] = k + 1;
        group(m, SAMPLE)[i] = now;
        any |= now;
    }
    if (any) stale(m, moved);
    return any;
}
static void next_event(Model *m) {
    m->next_event = INFINITY;
    INFO.times(m);
    for (int i = 0; i < INFO.samples; i++) {
        double start = group(m, TICK)[2 * i], interval = group(m, TICK)[2 * i + 1];
        double k = fmax(group(m, LAST)[i], ceil((m->time - start) / interval - 1e-9));
        m->next_event = fmin(m->next_event, start + k * interval);
    }
    for (int i = 0; i < INFO.relations; i++)
        if (INFO.timed[i] && group(m, DUE)[i] > m->time + 1e-12 * fmax(1, fabs(m->time)))
            m->next_event = fmin(m->next_event, group(m, DUE)[i]);
}
static int event(Model *m) {
    if (!INFO.nd && !INFO.relations && !INFO.roundings && !INFO.samples) return 0;
    need_k(m);
    int fired = fire(m), states = iterate(m);
    if (fired || *group(m, INITIAL)) {
        memset(group(m, SAMPLE), 0, sizeof(double) * INFO.samples);
        *group(m, INITIAL) = 0;
        stale(m, moved);
        int more = states < 0 ? states : iterate(m);
        states = more < 0 ? more : states | more;
    }
    next_event(m);
    return states;
}
/* The first event: conditions that hold already do not become true in it, save those of initial(). */
static int first_event(Model *m) {
    if (!INFO.nd && !INFO.relations && !INFO.roundings && !INFO.samples) return 0;
    double *pre = group(m, PRE), *d = group(m, D);
    const int first = INFO.nd - INFO.conditions;
    memset(group(m, REL), 0, sizeof(double) * INFO.relations);
    memset(group(m, SAMPLE), 0, sizeof(double) * INFO.samples);
    memset(group(m, LAST), 0, sizeof(double) * INFO.samples);
    for (int i = first; i < INFO.nd; i++) d[i] = pre[i] = 1;
    *group(m, INITIAL) = 0;
    stale(m, moved);
    for (int round = 0; round < 100; round++) {
        if (!settle(m)) return -1;
        if (!refresh(m, 0)) break;
    }
    for (int i = first; i < INFO.nd; i++) pre[i] = d[i];
    *group(m, INITIAL) = 1;
    stale(m, moved);
    return event(m);
}
static int indicators(void) {
    int n = 2 * INFO.roundings;
    for (int i = 0; i < INFO.relations; i++) n += !INFO.timed[i];
    return n;
}
/* A relation changes once its difference is beyond zero by a little, so that it does not flicker around it. */
static void indicate(Model *m, double *z) {
    const double little = 1e-11;
    need_w(m);
    INFO.watch(m);
    const double *d = group(m, DIFF);
    for (int i = 0; i < INFO.relations; i++) {
        if (INFO.timed[i]) continue;
        int negative = INFO.below[i] ? group(m, REL)[i] != 0 : group(m, REL)[i] == 0;
        *z++ = d[i] + (negative ? -little : little);
    }
    for (int i = 0; i < INFO.roundings; i++) {
        double a = d[INFO.relations + i], n = group(m, ROUND)[i];
        *z++ = a - n + little;
        *z++ = n + 1 - a + little;
    }
}

/* ---- instances ---- */

/* What the last evaluation says: discard where a loop has no solution, a warning where an assertion fails. */
static fmi2Status checked(Instance *s) {
    if (failed(s->m)) return fail(s, fmi2Discard, "an algebraic loop has no solution at t = %g", s->m->time);
    return fmi2OK;
}
static void check_assertions(Instance *s) {
    if (!INFO.assertions) return;
    unsigned char bad[INFO.assertions];
    need_w(s->m);
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
    Instance proxy = {NULL, *functions, name ? name : "", logging};
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

/* Initial values that depend on parameters, unless somebody has set them; whether the initial equations are solved. */
static int start_states(Model *m) {
    int solved = 1;
    double relations[INFO.relations + 1];
    need_k(m);
    for (int round = 0; round < 20; round++) { /* they may depend on which branches are taken */
        memcpy(relations, group(m, REL), sizeof(double) * INFO.relations);
        INFO.start(m);
        stale(m, moved);
        double *x = group(m, START);
        for (int i = 0; i < INFO.initial.n; i++) x[i] = m->data[INFO.initial_at[i]];
        solved = !INFO.initial.n || solve_block(m, &INFO.initial, x);
        for (int i = 0; i < INFO.initial.n && solved; i++) {
            int at = INFO.initial_at[i];
            if (at >= NX || !group(m, STARTED)[at]) m->data[at] = x[i];
        }
        stale(m, moved);
        first_event(m);
        if (!memcmp(relations, group(m, REL), sizeof(double) * INFO.relations)) break;
    }
    return solved;
}

fmi2Status fmi2ExitInitializationMode(fmi2Component c) {
    Instance *s = c;
    if (s->m->phase != INITIALIZATION) return fail(s, fmi2Error, "fmi2ExitInitializationMode: not in initialisation mode");
    int solved = start_states(s->m);
    s->m->phase = EVENT;
    if (!solved) return fail(s, fmi2Discard, "the initial equations have no solution near the start values");
    return checked(s);
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
        value[i] = group(m, R)[v];
    }
    return checked(s);
}

fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Real value[]) {
    Instance *s = c;
    Model *m = s->m;
    for (size_t i = 0; i < n; i++) {
        unsigned v = vr[i];
        if (v < AT_DX) {
            /* Until initialisation ends it is a start value; later, as some importers (CasADi) want it, the state itself. */
            if (m->phase & (INSTANTIATED | INITIALIZATION)) group(m, STARTED)[v] = 1;
            stale(m, moved);
        } else if (v >= AT_U && v < AT_P) {
            stale(m, moved);
        } else if (v >= AT_P && v < AT_Q) {
            stale(m, FRESH_ALL);
        } else {
            return fail(s, fmi2Error, "fmi2SetReal: the variable with value reference %u cannot be set", v);
        }
        group(m, R)[v] = value[i];
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
    if (!*state) *state = malloc(MODEL_SIZE);
    if (!*state) return fail(s, fmi2Error, "fmi2GetFMUstate: out of memory");
    memcpy(*state, s->m, MODEL_SIZE);
    return fmi2OK;
}
fmi2Status fmi2SetFMUstate(fmi2Component c, fmi2FMUstate state) {
    Instance *s = c;
    if (!state) return fail(s, fmi2Error, "fmi2SetFMUstate: no state");
    memcpy(s->m, state, MODEL_SIZE);
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
        if (k < AT_DX) { need_jx(m); column = group(m, JX) + (size_t)k * NROW; }
        else if (k >= AT_U && k < AT_P) { need_jx(m); column = group(m, JX) + (size_t)(k - NX) * NROW; }
        else if (k >= AT_P && k < AT_Q) { need_jp(m); column = group(m, JP) + (size_t)(k - AT_P) * NROW; }
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
    Instance *s = c;
    check_assertions(s);
    int states = event(s->m);
    *info = (fmi2EventInfo){fmi2False, fmi2False, fmi2False, states > 0, isfinite(s->m->next_event), s->m->next_event};
    if (states < 0) return fail(s, fmi2Error, "the event at t = %g does not come to an end", s->m->time);
    return checked(s);
}
fmi2Status fmi2EnterContinuousTimeMode(fmi2Component c) {
    Instance *s = c;
    if (s->m->phase != EVENT) return fail(s, fmi2Error, "fmi2EnterContinuousTimeMode: not in event mode");
    s->m->phase = CONTINUOUS;
    return fmi2OK;
}
fmi2Status fmi2CompletedIntegratorStep(fmi2Component c, fmi2Boolean no_set_state, fmi2Boolean *event, fmi2Boolean *end) {
    (void)no_set_state;
    *event = fmi2False;
    *end = fmi2False;
    check_assertions(c);
    return fmi2OK;
}
fmi2Status fmi2SetTime(fmi2Component c, fmi2Real time) {
    Model *m = ((Instance *)c)->m;
    if (INFO.time_varying && m->time != time) stale(m, moved);
    m->time = time;
    return fmi2OK;
}
fmi2Status fmi2SetContinuousStates(fmi2Component c, const fmi2Real x[], size_t n) {
    Instance *s = c;
    if (n != NX) return fail(s, fmi2Error, "fmi2SetContinuousStates: %zu states, the model has %d", n, NX);
    for (int i = 0; i < NX; i++) group(s->m, R)[i] = x[i];
    stale(s->m, moved);
    return fmi2OK;
}
fmi2Status fmi2GetContinuousStates(fmi2Component c, fmi2Real x[], size_t n) {
    Instance *s = c;
    if (n != NX) return fail(s, fmi2Error, "fmi2GetContinuousStates: %zu states, the model has %d", n, NX);
    if (s->m->phase == INITIALIZATION) start_states(s->m);
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
    need_dx(s->m);
    for (int i = 0; i < NX; i++) dx[i] = group(s->m, R)[AT_DX + i];
    return checked(s);
}
fmi2Status fmi2GetEventIndicators(fmi2Component c, fmi2Real z[], size_t n) {
    Instance *s = c;
    if ((int)n != indicators()) return fail(s, fmi2Error, "fmi2GetEventIndicators: the model has %d", indicators());
    if (n) indicate(s->m, z);
    return checked(s);
}

/* ---- co-simulation: RODAS4 (Hairer and Wanner, Solving ODEs II, section IV.7) with the exact Jacobian ---- */

static void rhs(Model *m, double t, const double *x, double *dx) {
    m->time = t;
    memcpy(group(m, R), x, NX * sizeof *x);
    stale(m, moved);
    need_dx(m);
    memcpy(dx, group(m, R) + AT_DX, NX * sizeof *dx);
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
    double *w = malloc(sizeof *w * NXX * NXX), u[6][NXX], f[NXX], ft[NXX], arg[NXX]; /* the stack is too small for w */
    int pivot[NXX];
    if (!w) return -1;
    memset(ft, 0, sizeof ft);
    rhs(m, t, x, f);
    need_jx(m);
    for (int i = 0; i < NX; i++)
        for (int j = 0; j < NX; j++) w[j * NX + i] = (i == j ? 1 / (gamma * h) : 0) - group(m, JX)[(size_t)j * NROW + i];
    if (INFO.time_varying) {
        double e = 1e-8 * fmax(fabs(t), 1.0);
        rhs(m, t + e, x, ft);
        for (int i = 0; i < NX; i++) ft[i] = (ft[i] - f[i]) / e;
    }
    if (!factorise(w, pivot, NX)) {
        free(w);
        return -1;
    }
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
        substitute(w, pivot, u[k], NX);
        if (k == 5) for (int i = 0; i < NX; i++) y[i] = arg[i] + u[5][i];
    }
    free(w);
    double worst = 0;
    for (int i = 0; i < NX; i++) {
        /* small against the nominal value, which is 1 where nobody states it: fluxes and charges are far smaller */
        double scale = m->tolerance * (1e-3 * fabs(INFO.nominal[i]) + fmax(fabs(x[i]), fabs(y[i])));
        double e = fabs(u[5][i]) / scale;
        if (!(e <= worst)) worst = e;
    }
    return isfinite(worst) ? worst : -1;
}

static void go(Model *m, double t, const double *x) {
    memcpy(group(m, R), x, NX * sizeof *x);
    m->time = t;
    stale(m, moved);
}
static int crossed(const double *a, const double *b, int n) {
    for (int i = 0; i < n; i++) if ((a[i] > 0) != (b[i] > 0)) return 1;
    return 0;
}
/* The shortest step to (y, h) in which an indicator has changed its sign since (x, t), by bisection. */
static double locate(Model *m, double t, const double *x, double h, double *y, const double *z, int n) {
    double low = 0, high = h, try[NXX], now[n];
    memcpy(try, y, NX * sizeof *y);
    while (high - low > 4e-16 * fmax(fabs(t), h)) {
        double middle = 0.5 * (low + high);
        if (middle <= low || middle >= high) break;
        go(m, t, x);
        if (NX && rodas(m, t, x, middle, try) < 0) break;
        go(m, t + middle, try);
        indicate(m, now);
        if (crossed(z, now, n)) {
            high = middle;
            memcpy(y, try, NX * sizeof *y);
        } else {
            low = middle;
        }
    }
    return high;
}

fmi2Status fmi2DoStep(fmi2Component c, fmi2Real start, fmi2Real size, fmi2Boolean no_set_state) {
    Instance *s = c;
    Model *m = s->m;
    (void)no_set_state;
    if (!(m->phase & (EVENT | STEPPED))) return fail(s, fmi2Error, "fmi2DoStep: the model is not initialised");
    if (!(size > 0)) return fail(s, fmi2Error, "fmi2DoStep: step size %g", size);
    m->phase = STEPPED;
    const int nz = indicators();
    double end = start + size, t = start, x[NXX], y[NXX], z[nz + 1], now_z[nz + 1];
    memset(y, 0, sizeof y);
    m->time = start;
    stale(m, moved);
    int status = event(m); /* inputs may have jumped */
    memcpy(x, group(m, R), NX * sizeof *x);
    double h = m->step > 0 ? m->step : size * 1e-3, since = start;
    int events = 0;
    if (nz) indicate(m, z);
    for (long count = 0; (NX > 0 || nz || isfinite(m->next_event)) && t < end && status >= 0; count++) {
        /* an event due at the end belongs to this step: its values are those after it */
        double due = m->next_event, stop = fmin(end, due), left = stop - t;
        int last = h >= left * (1 - 1e-12) || NX == 0;
        double now = last ? left : h > 0.5 * left ? 0.5 * left : h;
        double e = NX ? rodas(m, t, x, now, y) : 0;
        double grow = e < 0 ? 0.1 : fmin(5, fmax(0.2, 0.9 * pow(fmax(e, 1e-10), -0.25)));
        if (e >= 0 && e <= 1) {
            int at_event = last && due <= end + 1e-12 * fmax(1, fabs(end)), found = 0;
            double taken = now;
            if (nz) {
                go(m, t + now, y);
                indicate(m, now_z);
                found = crossed(z, now_z, nz);
                if (found) taken = locate(m, t, x, now, y, z, nz);
            }
            t = found ? t + taken : last ? stop : t + now;
            memcpy(x, y, NX * sizeof *x);
            h = last && now * grow < h ? h : now * grow;
            if (found || at_event) {
                if (t - since > 1e-9 * fmax(1, fabs(t))) { since = t; events = 0; }
                if (++events > 10000) {
                    m->phase = FAILED;
                    return fail(s, fmi2Error, "fmi2DoStep: events without end at t = %g", t);
                }
                go(m, t, x);
                status = event(m);
                memcpy(x, group(m, R), NX * sizeof *x);
            }
            if (nz) { go(m, t, x); indicate(m, z); }
        } else {
            h = now * fmin(grow, 0.9);
            if (!(h > 1e-14 * fmax(fabs(t), size)) || count > 10000000) {
                go(m, t, x);
                m->phase = FAILED;
                return fail(s, fmi2Error, "fmi2DoStep: the solver cannot pass t = %g", t);
            }
        }
    }
    m->step = h;
    go(m, status < 0 ? t : end, x);
    if (status < 0) {
        m->phase = FAILED;
        return fail(s, fmi2Error, "fmi2DoStep: the event at t = %g does not come to an end", t);
    }
    check_assertions(s);
    m->failed = 0;
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
