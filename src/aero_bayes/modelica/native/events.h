/* Events: relations, rounded and discrete values are constant between them; an event is iterated until nothing
 * changes any more. */
#ifndef AERO_BAYES_EVENTS_H
#define AERO_BAYES_EVENTS_H
#include <math.h>
#include <string.h>

#include "sliding.h"

/* Discrete values for the present relations; whether they and the loops come to agree. Earlier values stay in PRE. */
static int iterate_discrete(Model *m) {
    double before[INFO.nd + 1];
    for (int round = 0; round < 50; round++) {
        need_loops(m);
        memcpy(before, group(m, D), sizeof(double) * INFO.nd);
        INFO.discrete(m);
        if (!memcmp(before, group(m, D), sizeof(double) * INFO.nd)) return 1;
        invalidate(m, DEPENDS_ON_STATE);
    }
    return 0;
}
/* Relations and rounded values at this instant; whether any has changed. ``singly``: of relations at most one, and one
   that becomes false before one that becomes true; those that take turns come to rest so. */
static int update_relations(Model *m, int singly) {
    int changed = 0, off = -1, on = -1;
    need_loops(m);
    INFO.watch(m);
    INFO.times(m);
    const double *d = group(m, DIFF);
    for (int i = 0; i < INFO.relations; i++) {
        double value = d[i];
        if (is_held(m, i, value)) continue;
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
    if (changed) invalidate(m, DEPENDS_ON_STATE);
    return changed;
}
/* Whether a when clause is due: what it does goes by the relations before it. */
static int when_is_due(Model *m) {
    const int first = INFO.nd - INFO.conditions;
    return memcmp(group(m, PRE) + first, group(m, D) + first, sizeof(double) * INFO.conditions) != 0;
}
/* Until nothing changes; whether states were set anew, or -1 where it does not end. Relations, discrete values and loops
   come to agree before earlier values give way: friction that comes to rest is stuck, if that holds, before it slides. */
static int iterate_event(Model *m) {
    int states = 0;
    for (int round = 0; round < 200; round++) {
        if (!iterate_discrete(m)) return -1;
        for (int k = 0; k < 50 && !when_is_due(m) && update_relations(m, k > 5); k++)
            if (!iterate_discrete(m)) return -1;
        int changed = INFO.reinit(m);
        states |= changed;
        if (changed) invalidate(m, DEPENDS_ON_STATE);
        changed |= update_relations(m, 0);
        changed |= memcmp(group(m, PRE), group(m, D), sizeof(double) * INFO.nd) != 0;
        memcpy(group(m, PRE), group(m, D), sizeof(double) * INFO.nd);
        if (!changed) return states;
    }
    return -1;
}
static int update_samples(Model *m) {
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
    if (any) invalidate(m, DEPENDS_ON_STATE);
    return any;
}
static void schedule_next_event(Model *m) {
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
/* One event, with what it lets begin or end to slide: a surface that is left changes relations. */
static int settle_event(Model *m) {
    int states = iterate_event(m);
    for (int round = 0; INFO.surfaces && round < 8 && states >= 0 && settle_surfaces(m); round++) {
        int more = iterate_event(m);
        states = more < 0 ? more : states | more;
    }
    return states;
}
static int handle_event(Model *m) {
    if (!INFO.nd && !INFO.relations && !INFO.roundings && !INFO.samples) return 0;
    need_constants(m);
    int fired = update_samples(m), states = settle_event(m);
    if (fired || *group(m, INITIAL)) {
        memset(group(m, SAMPLE), 0, sizeof(double) * INFO.samples);
        *group(m, INITIAL) = 0;
        invalidate(m, DEPENDS_ON_STATE);
        int more = states < 0 ? states : settle_event(m);
        states = more < 0 ? more : states | more;
    }
    schedule_next_event(m);
    return states;
}
/* The first event: conditions that hold already do not become true in it, save those of initial(). */
static int handle_first_event(Model *m) {
    if (!INFO.nd && !INFO.relations && !INFO.roundings && !INFO.samples) return 0;
    double *pre = group(m, PRE), *d = group(m, D);
    const int first = INFO.nd - INFO.conditions;
    memset(group(m, REL), 0, sizeof(double) * INFO.relations);
    memset(group(m, SAMPLE), 0, sizeof(double) * INFO.samples);
    memset(group(m, LAST), 0, sizeof(double) * INFO.samples);
    memset(group(m, CONTACT), 0, sizeof(double) * INFO.surfaces);
    for (int i = first; i < INFO.nd; i++) d[i] = pre[i] = 1;
    *group(m, INITIAL) = 0;
    invalidate(m, DEPENDS_ON_STATE);
    for (int round = 0; round < 100; round++) {
        if (!iterate_discrete(m)) return -1;
        if (!update_relations(m, 0)) break;
    }
    for (int i = first; i < INFO.nd; i++) pre[i] = d[i];
    *group(m, INITIAL) = 1;
    invalidate(m, DEPENDS_ON_STATE);
    return handle_event(m);
}
static int count_indicators(void) {
    int n = 2 * INFO.roundings;
    for (int i = 0; i < INFO.relations; i++) n += !INFO.timed[i];
    return n;
}
/* A relation changes once its difference is beyond zero by a little, so that it does not flicker around it. One that
   slides changes when its surface is left: at once for all relations of the surface, by the indicator of the first. */
static void event_indicators(Model *m, double *z) {
    double told[INFO.surfaces + 1];
    for (int k = 0; k < INFO.surfaces; k++) told[k] = 0;
    if (slides(m)) need_derivatives(m);
    need_loops(m);
    INFO.watch(m);
    const double *d = group(m, DIFF);
    for (int i = 0; i < INFO.relations; i++) {
        if (INFO.timed[i]) continue;
        int k = INFO.surfaces ? INFO.surface[i] : -1;
        if (k >= 0 && group(m, CONTACT)[k] == SLIDING) {
            double share = group(m, SHARE)[k];
            *z++ = told[k] ? 1 : share * (1 - share) + LITTLE;
            told[k] = 1;
            continue;
        }
        double little = k >= 0 && group(m, CONTACT)[k] == RELEASED ? group(m, NEAR)[k] : LITTLE;
        int negative = INFO.below[i] ? group(m, REL)[i] != 0 : group(m, REL)[i] == 0;
        *z++ = d[i] + (negative ? -little : little);
    }
    for (int i = 0; i < INFO.roundings; i++) {
        double a = d[INFO.relations + i], n = group(m, ROUND)[i];
        *z++ = a - n + LITTLE;
        *z++ = n + 1 - a + LITTLE;
    }
}

enum { INSTANTIATED = 1, INITIALIZATION = 2, EVENT = 4, CONTINUOUS = 8, STEPPED = 16, TERMINATED = 32, FAILED = 64 };

static void reset(Model *m) {
    memset(m, 0, MODEL_SIZE);
    INFO.set_defaults(m);
    m->phase = INSTANTIATED;
    m->tolerance = 1e-6;
    m->next_event = INFINITY;
}

/* Initial values that depend on parameters, unless somebody has set them; whether the initial equations are solved. */
static int initialise(Model *m) {
    int solved = 1;
    double relations[INFO.relations + 1];
    need_constants(m);
    for (int round = 0; round < 20; round++) { /* they may depend on which branches are taken */
        memcpy(relations, group(m, REL), sizeof(double) * INFO.relations);
        INFO.start(m);
        invalidate(m, DEPENDS_ON_STATE);
        double *x = group(m, START);
        for (int i = 0; i < INFO.initial.n; i++) x[i] = m->data[INFO.initial_at[i]];
        solved = !INFO.initial.n || solve_block(m, &INFO.initial, x);
        for (int i = 0; i < INFO.initial.n && solved; i++) {
            int at = INFO.initial_at[i];
            if (at >= NX || !group(m, STARTED)[at]) m->data[at] = x[i];
        }
        invalidate(m, DEPENDS_ON_STATE);
        handle_first_event(m);
        if (!memcmp(relations, group(m, REL), sizeof(double) * INFO.relations)) break;
    }
    return solved;
}

#endif
