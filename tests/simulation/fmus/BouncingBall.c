/* A ball that falls, and bounces with v -> -e v: state events. */
#include "skeleton.h"
static int update(Model *m, Complex *r)
{
    r[DER_H] = r[V];
    r[DER_V] = r[G];
    return OK;
}
int discrete(Model *m, Events *e)
{
    if (m->r[H] <= 0.0 && m->r[V] < 0.0) {
        m->r[H] = 2.2250738585072014e-308;
        m->r[V] = -m->r[V] * m->r[E];
#ifndef SILENT /* OpenModelica does not say so */
        e->states_changed = 1;
#endif
        if (m->r[V] < 1e-3) m->r[V] = 0.0, m->r[G] = 0.0;
    }
    return OK;
}
void zero_crossings(Model *m, double *z) { z[0] = m->r[H]; }
