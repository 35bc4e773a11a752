/* A ball that falls, and bounces with v -> -e v: state events. */
#define STATES {0, 2}
#define DERIVATIVES {1, 3}
#include "skeleton.h"
enum { H, DH, V, DV, GRAVITY, E };
static void start(Model *m) { m->r[H] = 1.0, m->r[GRAVITY] = -9.81, m->r[E] = 0.7; }
static int initialize(Model *m) { return OK; }
static int update(Model *m)
{
    m->r[DH] = m->r[V];
    m->r[DV] = m->r[GRAVITY];
    return OK;
}
static int discrete(Model *m, Events *e)
{
    if (m->r[H] <= 0.0 && m->r[V] < 0.0) {
        m->r[H] = 2.2250738585072014e-308;
        m->r[V] = -m->r[V] * m->r[E];
#ifndef SILENT /* OpenModelica does not say so */
        e->states_changed = 1;
#endif
        if (m->r[V] < 1e-3) m->r[V] = 0.0, m->r[GRAVITY] = 0.0;
    }
    return OK;
}
static void zero_crossings(Model *m, double *z) { z[0] = m->r[H]; }
static int derivative(Model *m, unsigned unknown, unsigned known, double *v)
{
    *v = unknown == DH && known == V;
    if (unknown == DV && known == GRAVITY) *v = 1.0;
    return OK;
}
