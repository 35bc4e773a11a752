/* Lazy evaluation: what is asked for is computed once and kept until something that it needs changes. */
#ifndef AERO_BAYES_EVALUATION_H
#define AERO_BAYES_EVALUATION_H
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "algebraic_loops.h"

enum { FRESH_K = 1, FRESH_DX = 2, FRESH_Y = 4, FRESH_JX = 8, FRESH_JP = 16, FRESH_W = 32, FRESH_ALL = 63 };
/* What a change of time, states, inputs or discrete values makes old. */
enum { DEPENDS_ON_STATE = FRESH_DX | FRESH_Y | FRESH_JX | FRESH_JP | FRESH_W };

static inline void invalidate(Model *m, int flags) { m->fresh &= ~flags; }

static inline void need_constants(Model *m) {
    if (m->fresh & FRESH_K) return;
    INFO.k(m);
    m->fresh |= FRESH_K;
}
/* A loop without a solution says so to the importer, and the next attempt starts from the start values. */
static int clear_failure(Model *m) {
    if (!m->failed) return 0;
    m->failed = 0;
    invalidate(m, DEPENDS_ON_STATE);
    Model *other = calloc(1, MODEL_SIZE);
    if (other) {
        INFO.set_defaults(other);
        memcpy(group(m, W), group(other, W), sizeof(double) * INFO.nw);
        free(other);
    }
    return 1;
}
static inline void need_loops(Model *m) {
    if (m->fresh & FRESH_W) return;
    need_constants(m);
    clear_failure(m); /* with other relations than before it may have one */
    for (int i = 0; i < INFO.blocks; i++)
        if (!solve_block(m, INFO.block + i, group(m, W) + INFO.block[i].first)) {
            m->failed = 1;
            for (int k = 0; k < INFO.nw; k++) group(m, W)[k] = NAN;
            break;
        }
    m->fresh |= FRESH_W;
}

/* Adds what the loops' unknowns pass on: dw/dv = -FW^-1 FV for every column v of the Jacobian. */
static void add_loop_derivatives(Model *m, double *jacobian, const double *by, int columns) {
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
/* The Jacobian by inputs and states with the relations as they stand. What is structurally zero is never written: it is
   cleared where something else may have been there. */
static void plain_jacobian(Model *m) {
    need_loops(m);
    const int columns = INFO.nx + INFO.nu;
    if (INFO.nw || INFO.surfaces) memset(group(m, JX), 0, sizeof(double) * NROW * columns);
    INFO.jx(m);
    if (INFO.nw) {
        INFO.jw(m);
        add_loop_derivatives(m, group(m, JX), group(m, FX), columns);
    }
}
static void plain_parameter_jacobian(Model *m) {
    need_loops(m);
    if (INFO.nw || INFO.surfaces) memset(group(m, JP), 0, sizeof(double) * NROW * INFO.np);
    INFO.jp(m);
    if (INFO.nw) {
        INFO.jw(m);
        INFO.fp(m);
        add_loop_derivatives(m, group(m, JP), group(m, FP), INFO.np);
    }
}

#endif
