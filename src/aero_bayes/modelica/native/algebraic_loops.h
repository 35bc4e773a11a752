/* Algebraic loops, solved by Newton's method with the exact Jacobian and a line search. */
#ifndef AERO_BAYES_ALGEBRAIC_LOOPS_H
#define AERO_BAYES_ALGEBRAIC_LOOPS_H
#include <math.h>
#include <string.h>

#include "model.h"

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

/* Residual and Jacobian at w. */
static void residual(Model *m, const Block *b, double *f, double *j) {
    memset(j, 0, sizeof *j * b->n * b->n);
    b->residual(m, f, j);
}
/* The largest entry of each row of the Jacobian. */
static void row_scales(const double *j, int n, double *row) {
    for (int i = 0; i < n; i++) {
        row[i] = 0;
        for (int k = 0; k < n; k++) row[i] = fmax(row[i], fabs(j[k * n + i]));
        if (!(row[i] > 0)) row[i] = 1;
    }
}
/* The largest residual, each relative to its row: those of one place, as a slope that changes changes no progress. */
static double largest_residual(const double *f, const double *row, int n) {
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
        row_scales(j, n, row);
        const double size = largest_residual(f, row, n);
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
            next = largest_residual(f, row, n);
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

#endif
