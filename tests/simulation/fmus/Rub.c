/* A mass on a spring with dry friction that chatters at rest: its relation keeps its value between events, and each event
 * sends the mass straight back. With SMOOTHLESS there is no relation: the friction jumps inside the equations. */
#define STATES {0, 2}
#define DERIVATIVES {1, 3}
#include "skeleton.h"
enum { S, DS, V, DV, K, F_C, FORWARD = 50 };
static void start(Model *m) { m->r[S] = 0.1, m->r[K] = 40.0, m->r[F_C] = 0.5; }
static int initialize(Model *m) { return OK; }
static int update(Model *m)
{
    m->r[DS] = m->r[V];
#ifdef SMOOTHLESS
    const double way = (m->r[V] > 0.0) - (m->r[V] < 0.0);
#else
    const double way = m->r[FORWARD] ? 1.0 : -1.0;
#endif
    m->r[DV] = -m->r[K] * m->r[S] - m->r[F_C] * way;
    return OK;
}
static int discrete(Model *m, Events *e)
{
    m->r[FORWARD] = m->r[V] > 0.0;
    return OK;
}
static void zero_crossings(Model *m, double *z) { z[0] = m->r[V] + (m->r[FORWARD] ? 1e-11 : -1e-11); }
static int derivative(Model *m, unsigned unknown, unsigned known, double *v)
{
    *v = unknown == DS && known == V;
    if (unknown == DV && known == S) *v = -m->r[K];
    return OK;
}
