/* x' = v, v' = -k x: an oscillator watched by outputs that are no states: one linear, one smooth, one with a kink at d,
 * one with a bump of width w at d. */
#define STATES {0, 2}
#define DERIVATIVES {1, 3}
#include "skeleton.h"
enum { X, DX, V, DV, K, D, WIDTH, LINEAR, SMOOTH, KINK, BUMP };
static void start(Model *m) { m->r[X] = 1.0, m->r[K] = 1.0, m->r[D] = 0.3, m->r[WIDTH] = 0.02; }
static int initialize(Model *m) { return OK; }
static int update(Model *m)
{
    double *r = m->r;
    const double away = (r[X] - r[D]) / r[WIDTH];
    r[DX] = r[V];
    r[DV] = -r[K] * r[X];
    r[LINEAR] = 3.0 * r[X] + r[V] + r[D];
    r[SMOOTH] = exp(r[X] * r[V]);
    r[KINK] = r[X] > r[D] ? r[X] - r[D] : 0.0;
    r[BUMP] = 1.0 / (1.0 + away * away);
    return OK;
}
static int discrete(Model *m, Events *e) { return OK; }
static void zero_crossings(Model *m, double *z) {}
static int derivative(Model *m, unsigned unknown, unsigned known, double *v)
{
    const double *r = m->r;
    const double away = (r[X] - r[D]) / r[WIDTH], slope = -2.0 * away * r[BUMP] * r[BUMP] / r[WIDTH];
    *v = 0.0;
    switch (unknown) {
    case DX: *v = known == V; break;
    case DV: *v = known == X ? -r[K] : known == K ? -r[X] : 0.0; break;
    case LINEAR: *v = known == X ? 3.0 : known == V || known == D; break;
    case SMOOTH: *v = known == X ? r[V] * r[SMOOTH] : known == V ? r[X] * r[SMOOTH] : 0.0; break;
    case KINK: *v = r[X] <= r[D] ? 0.0 : known == X ? 1.0 : known == D ? -1.0 : 0.0; break;
    case BUMP: *v = known == X ? slope : known == D ? -slope : known == WIDTH ? -slope * away : 0.0; break;
    default: return ERROR;
    }
    return OK;
}
