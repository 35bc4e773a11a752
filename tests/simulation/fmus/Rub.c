/* A mass on a spring with dry friction that chatters at rest: its relation keeps its value between events, and each event
 * sends the mass straight back. With SMOOTHLESS there is no relation: the friction jumps inside the equations. */
enum { FORWARD = 50 };
#include "skeleton.h"
static int update(Model *m, Complex *r)
{
    r[DER_S] = r[V];
#ifdef SMOOTHLESS
    const double way = (creal(r[V]) > 0.0) - (creal(r[V]) < 0.0);
#else
    const double way = m->r[FORWARD] ? 1.0 : -1.0;
#endif
    r[DER_V] = -r[K] * r[S] - r[F_C] * way;
    return OK;
}
int discrete(Model *m, Events *e)
{
    m->r[FORWARD] = m->r[V] > 0.0;
    return OK;
}
void zero_crossings(Model *m, double *z) { z[0] = m->r[V] + (m->r[FORWARD] ? 1e-11 : -1e-11); }
