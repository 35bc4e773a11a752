/* A counter that a time event raises every 0.3 s, and an integrator of it; at t = 2 a jump of the state by `kick`. */
enum { KICKED = 50 };
#include "skeleton.h"
static int update(Model *m, Complex *r)
{
    r[DER_X] = r[COUNTER];
    return OK;
}
int discrete(Model *m, Events *e)
{
    while (m->t >= m->r[COUNTER] * m->r[PERIOD] - 1e-12) m->r[COUNTER] += 1.0;
    if (m->t >= 2.0 - 1e-12 && !m->r[KICKED]) {
        m->r[KICKED] = 1.0;
        m->r[X] += m->r[KICK];
        e->states_changed = m->r[KICK] != 0.0;
        e->again = 1;
    }
    e->next_defined = 1;
    e->next = m->r[COUNTER] * m->r[PERIOD];
    if (!m->r[KICKED] && e->next > 2.0) e->next = 2.0;
    return OK;
}
