/* Co-simulation by the Rosenbrock method RODAS4 (Hairer and Wanner, Solving ODEs II, section IV.7) with the exact
 * Jacobian, and the location of state events. */
#ifndef AERO_BAYES_RODAS_H
#define AERO_BAYES_RODAS_H
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "events.h"

static void derivatives_at(Model *m, double t, const double *x, double *dx) {
    m->time = t;
    memcpy(group(m, R), x, NX * sizeof *x);
    invalidate(m, DEPENDS_ON_STATE);
    need_derivatives(m);
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
    derivatives_at(m, t, x, f);
    need_jacobian(m);
    for (int i = 0; i < NX; i++)
        for (int j = 0; j < NX; j++) w[j * NX + i] = (i == j ? 1 / (gamma * h) : 0) - group(m, JX)[(size_t)j * NROW + i];
    if (INFO.time_varying) {
        double e = 1e-8 * fmax(fabs(t), 1.0);
        derivatives_at(m, t + e, x, ft);
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
            derivatives_at(m, t + alpha[k] * h, arg, f);
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

static void move_to(Model *m, double t, const double *x) {
    memcpy(group(m, R), x, NX * sizeof *x);
    m->time = t;
    invalidate(m, DEPENDS_ON_STATE);
}
static int crossed(const double *a, const double *b, int n) {
    for (int i = 0; i < n; i++) if ((a[i] > 0) != (b[i] > 0)) return 1;
    return 0;
}
/* The shortest step to (y, h) in which an indicator has changed its sign since (x, t), by bisection. */
static double locate_event(Model *m, double t, const double *x, double h, double *y, const double *z, int n) {
    double low = 0, high = h, try[NXX], now[n];
    memcpy(try, y, NX * sizeof *y);
    while (high - low > 4e-16 * fmax(fabs(t), h)) {
        double middle = 0.5 * (low + high);
        if (middle <= low || middle >= high) break;
        move_to(m, t, x);
        if (NX && rodas(m, t, x, middle, try) < 0) break;
        move_to(m, t + middle, try);
        event_indicators(m, now);
        if (crossed(z, now, n)) {
            high = middle;
            memcpy(y, try, NX * sizeof *y);
        } else {
            low = middle;
        }
    }
    return high;
}

#endif
