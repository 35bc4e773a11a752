/* Sliding on surfaces: where the states are driven onto a surface from both of its sides, as at rest with dry friction,
 * they stay on it. Rates and outputs there are the combination of both sides whose rates keep the surface's difference
 * as it is (A. F. Filippov, Differential Equations with Discontinuous Righthand Sides, 1988, section 4). On several
 * surfaces at once what each of them changes is added. While the share of the side above stays between 0 and 1 the
 * model slides; beyond it leaves for that side. */
#ifndef AERO_BAYES_SLIDING_H
#define AERO_BAYES_SLIDING_H
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "evaluation.h"

/* How far beyond zero an indicator must be. */
#define LITTLE 1e-11
/* In s: a surface that is reached sooner than this counts as reached. */
#define SOON 1e-9

/* What CONTACT says of a surface. RELEASED: left, with its difference still about zero, of either sign. */
enum { FREE, SLIDING, RELEASED };

static inline int slides(Model *m) {
    int n = 0;
    for (int k = 0; k < INFO.surfaces; k++) n += group(m, CONTACT)[k] == SLIDING;
    return n;
}
static void take_side(Model *m, int k, int above) {
    for (int i = 0; i < INFO.relations; i++)
        if (INFO.surface[i] == k) group(m, REL)[i] = above ? INFO.above[i] : !INFO.above[i];
}
/* Is a relation on the side above its surface, and the difference of its surface, from its own. */
static int is_above(Model *m, int i) { return (group(m, REL)[i] != 0) == INFO.above[i]; }
static double of_surface(int i, double difference) { return INFO.above[i] != INFO.below[i] ? difference : -difference; }

/* Does a relation keep its value whatever the sign of its difference? Ends where that is no longer about zero. */
static int is_held(Model *m, int i, double difference) {
    int k = INFO.surfaces ? INFO.surface[i] : -1;
    if (k < 0 || group(m, CONTACT)[k] == FREE) return 0;
    double d = of_surface(i, difference);
    if (group(m, CONTACT)[k] == SLIDING ? fabs(d) <= group(m, NEAR)[k] : (is_above(m, i) ? d : -d) > -group(m, NEAR)[k]) return 1;
    group(m, CONTACT)[k] = FREE;
    invalidate(m, DEPENDS_ON_STATE);
    return 0;
}

/* The relations and discrete values of an instant, while the sides of surfaces are tried. */
typedef struct {
    double *relations, *discrete;
} Kept;
static void keep(Model *m, Kept *kept) {
    memcpy(kept->relations, group(m, REL), sizeof(double) * INFO.relations);
    memcpy(kept->discrete, group(m, D), sizeof(double) * INFO.nd);
}
static void put_back(Model *m, const Kept *kept) {
    memcpy(group(m, REL), kept->relations, sizeof(double) * INFO.relations);
    memcpy(group(m, D), kept->discrete, sizeof(double) * INFO.nd);
    invalidate(m, DEPENDS_ON_STATE);
}
#define KEEP(m) double kept_relations[INFO.relations + 1], kept_discrete[INFO.nd + 1]; Kept kept = {kept_relations, kept_discrete}; keep(m, &kept)

/* Discrete values without memory for the relations as they stand. */
static void follow_relations(Model *m) {
    double before[INFO.nd + 1];
    invalidate(m, DEPENDS_ON_STATE);
    for (int round = 0, changed = INFO.nd > 0; changed && round < 50; round++) {
        need_loops(m);
        memcpy(before, group(m, D), sizeof(double) * INFO.nd);
        INFO.discrete(m);
        changed = 0;
        for (int i = 0; i < INFO.nd; i++) {
            if (!INFO.instant[i]) group(m, D)[i] = before[i];
            changed |= group(m, D)[i] != before[i];
        }
        if (changed) invalidate(m, DEPENDS_ON_STATE);
    }
}
/* Rates and outputs with the relations as they stand, into R and into rows. */
static void evaluate_side(Model *m, double *rows) {
    follow_relations(m);
    need_loops(m);
    INFO.dx(m);
    INFO.y(m);
    memcpy(rows, group(m, R) + AT_DX, sizeof(double) * NX);
    memcpy(rows + NX, group(m, R) + AT_Y, sizeof(double) * INFO.ny);
}
/* For n surfaces: SIDES has the rates and outputs below all of them, and what each adds with its side above;
 * ``below[i]`` is how fast the difference of the i-th grows below all, ACROSS (by columns) what each adds to it. */
static void evaluate_sides(Model *m, const int *surface, int n, double *below) {
    const int rows = NX + INFO.ny;
    double *first = group(m, SIDES), *across = group(m, ACROSS), *rise = group(m, RISE);
    KEEP(m);
    for (int i = 0; i < n; i++) take_side(m, surface[i], 0);
    evaluate_side(m, first);
    INFO.rise(m);
    for (int i = 0; i < n; i++) below[i] = rise[surface[i]];
    for (int j = 0; j < n; j++) {
        double *other = first + (size_t)(j + 1) * rows;
        take_side(m, surface[j], 1);
        evaluate_side(m, other);
        INFO.rise(m);
        for (int i = 0; i < n; i++) across[j * n + i] = rise[surface[i]] - below[i];
        for (int r = 0; r < rows; r++) other[r] -= first[r];
        take_side(m, surface[j], 0);
    }
    put_back(m, &kept);
}
static double share_value(Model *m, const int *surface, int n, int row) {
    const int rows = NX + INFO.ny;
    const double *side = group(m, SIDES);
    double v = side[row];
    for (int j = 0; j < n; j++) v += group(m, SHARE)[surface[j]] * side[(size_t)(j + 1) * rows + row];
    return v;
}
/* The combination of the sides by the shares, into R. */
static void combine_sides(Model *m, const int *surface, int n) {
    for (int i = 0; i < NX; i++) group(m, R)[AT_DX + i] = share_value(m, surface, n, i);
    for (int i = 0; i < INFO.ny; i++) group(m, R)[AT_Y + i] = share_value(m, surface, n, NX + i);
}
/* Shares between 0 and 1 such that each surface stays where it is or is left for the side that its share says, by
 * projected Gauss-Seidel sweeps; ``moves[i]``: the share of the i-th is sought, else it keeps its own. */
static void bounded_shares(Model *m, const int *surface, int n, const double *below, const int *moves) {
    const double *across = group(m, ACROSS);
    double *share = group(m, SHARE), most = 1;
    for (int sweep = 0; sweep < 500 && most > 1e-14; sweep++) {
        most = 0;
        for (int i = 0; i < n; i++) {
            if (!moves[i]) continue;
            double rise = below[i], old = share[surface[i]];
            for (int j = 0; j < n; j++) rise += across[j * n + i] * share[surface[j]];
            share[surface[i]] = fmin(1, fmax(0, old - rise / across[i * n + i]));
            most = fmax(most, fabs(share[surface[i]] - old));
        }
    }
}
static int list_sliding(Model *m, int *surface) {
    int n = 0;
    for (int k = 0; k < INFO.surfaces; k++) if (group(m, CONTACT)[k] == SLIDING) surface[n++] = k;
    return n;
}
/* Rates and outputs while the model slides. */
static void slide(Model *m) {
    int surface[INFO.surfaces], pivot[INFO.surfaces], moves[INFO.surfaces];
    double right[INFO.surfaces], matrix[INFO.surfaces * INFO.surfaces];
    const int n = list_sliding(m, surface);
    evaluate_sides(m, surface, n, right);
    memcpy(matrix, group(m, ACROSS), sizeof(double) * n * n);
    if (factorise(matrix, pivot, n)) {
        substitute(matrix, pivot, right, n);
        for (int i = 0; i < n; i++) group(m, SHARE)[surface[i]] = -right[i];
    } else { /* surfaces that say the same leave the shares open */
        for (int i = 0; i < n; i++) moves[i] = 1;
        bounded_shares(m, surface, n, right, moves);
    }
    combine_sides(m, surface, n);
    m->fresh |= FRESH_DX | FRESH_Y;
}
static void need_derivatives(Model *m) {
    if (m->fresh & FRESH_DX) return;
    if (slides(m)) { slide(m); return; }
    need_loops(m);
    INFO.dx(m);
    m->fresh |= FRESH_DX;
}
static void need_outputs(Model *m) {
    if (m->fresh & FRESH_Y) return;
    if (slides(m)) { slide(m); return; }
    need_loops(m);
    INFO.y(m);
    m->fresh |= FRESH_Y;
}

/* The Jacobian of rates and outputs while the model slides: that of the sides by their shares, and how the shares move
 * so that the surfaces stay. ``own`` has the derivatives of the surfaces' rise by the columns themselves. */
static void slide_jacobian(Model *m, enum Group to, int columns, void (*plain)(Model *), enum Group own) {
    const int rows = NX + INFO.ny, all = INFO.surfaces;
    int surface[all], pivot[all];
    double matrix[all * all], move[all], rest = 1, *jacobian = group(m, to);
    double *sum = calloc((size_t)NROW * columns + 1, sizeof *sum);
    const int n = list_sliding(m, surface);
    const int other = m->fresh & (FRESH_JX | FRESH_JP);
    if (!sum) { m->failed = 1; return; }
    invalidate(m, DEPENDS_ON_STATE);
    slide(m);
    memcpy(matrix, group(m, ACROSS), sizeof(double) * n * n);
    INFO.rise_slopes(m);
    KEEP(m);
    for (int i = 0; i < n; i++) { take_side(m, surface[i], 0); rest -= group(m, SHARE)[surface[i]]; }
    for (int j = -1; j < n; j++) {
        if (j >= 0) take_side(m, surface[j], 1);
        follow_relations(m);
        plain(m);
        const double weight = j < 0 ? rest : group(m, SHARE)[surface[j]];
        for (size_t i = 0; i < (size_t)NROW * columns; i++) sum[i] += weight * jacobian[i];
        if (j >= 0) take_side(m, surface[j], 0);
    }
    put_back(m, &kept);
    const int open = !factorise(matrix, pivot, n);
    for (int c = 0; c < columns && !open; c++) {
        double *column = sum + (size_t)c * NROW;
        for (int i = 0; i < n; i++) {
            move[i] = -group(m, own)[c * all + surface[i]];
            for (int s = 0; s < NX; s++) move[i] -= group(m, RISE_RATE)[s * all + surface[i]] * column[s];
        }
        substitute(matrix, pivot, move, n);
        for (int j = 0; j < n; j++)
            for (int r = 0; r < rows; r++) column[r] += group(m, SIDES)[(size_t)(j + 1) * rows + r] * move[j];
    }
    memcpy(jacobian, sum, sizeof *sum * NROW * columns);
    free(sum);
    combine_sides(m, surface, n);
    m->fresh |= FRESH_DX | FRESH_Y | other;
}
static void need_jacobian(Model *m) {
    if (m->fresh & FRESH_JX) return;
    if (slides(m)) slide_jacobian(m, JX, NX + INFO.nu, plain_jacobian, RISE_X);
    else plain_jacobian(m);
    m->fresh |= FRESH_JX;
}
static void need_parameter_jacobian(Model *m) {
    need_constants(m);
    if (m->fresh & FRESH_JP) return;
    if (slides(m)) slide_jacobian(m, JP, INFO.np, plain_parameter_jacobian, RISE_P);
    else plain_parameter_jacobian(m);
    m->fresh |= FRESH_JP;
}

/* ---- which surfaces the model slides on ---- */

/* The surfaces' differences at this instant, and which side their relations are on. */
static void read_surfaces(Model *m, double *difference, int *above) {
    need_loops(m);
    INFO.watch(m);
    for (int i = INFO.relations - 1; i >= 0; i--)
        if (INFO.surface[i] >= 0) {
            difference[INFO.surface[i]] = of_surface(i, group(m, DIFF)[i]);
            above[INFO.surface[i]] = is_above(m, i);
        }
}
/* In an event: which of the surfaces whose difference is about zero the model slides on; whether a relation has changed,
 * because one of them is left. */
static int settle_surfaces(Model *m) {
    const int all = INFO.surfaces;
    int surface[all], above[all], moves[all], slid[all], n = 0, changed = 0;
    double difference[all], below[all], near[all], *contact = group(m, CONTACT), *share = group(m, SHARE);
    read_surfaces(m, difference, above);
    for (int k = 0; k < all; k++) {
        slid[k] = contact[k] == SLIDING;
        if (fabs(difference[k]) <= 1e-2) { surface[n++] = k; continue; } /* a first look: near goes by the rise */
        contact[k] = FREE;
        changed |= slid[k];
    }
    invalidate(m, DEPENDS_ON_STATE);
    if (!n) return changed;
    evaluate_sides(m, surface, n, below);
    for (int i = 0; i < n; i++) {
        const int k = surface[i];
        const double across = group(m, ACROSS)[i * n + i];
        near[i] = 2.1 * LITTLE + (SOON + 1e-14 * fabs(m->time)) * fmax(fabs(below[i]), fabs(below[i] + across));
        moves[i] = across < 0 && fabs(difference[k]) <= near[i];
        share[k] = moves[i] ? 0.5 : above[k];
        if (moves[i]) continue;
        contact[k] = FREE;
        changed |= slid[k];
    }
    bounded_shares(m, surface, n, below, moves);
    for (int i = 0; i < n; i++) {
        const int k = surface[i], inside = share[k] > 0 && share[k] < 1;
        if (!moves[i]) continue;
        if (inside) {
            contact[k] = SLIDING;
            group(m, NEAR)[k] = near[i];
        } else if (contact[k] == SLIDING) {
            contact[k] = RELEASED;
            group(m, NEAR)[k] = 2 * fabs(difference[k]) + LITTLE;
            take_side(m, k, share[k] > 0.5);
            changed = 1;
        } else if (contact[k] == RELEASED && above[k] != (share[k] > 0.5))
            contact[k] = FREE;
    }
    invalidate(m, DEPENDS_ON_STATE);
    return changed;
}

#endif
