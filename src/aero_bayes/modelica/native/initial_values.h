/* An instance's phases, its reset, and its initial values: those that depend on parameters, and initial equations. */
#ifndef AERO_BAYES_INITIAL_VALUES_H
#define AERO_BAYES_INITIAL_VALUES_H
#include <string.h>

#include "events.h"

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
