/* No states: a counter that a time event raises every `period`, and y = the counter plus the time. */
#include "skeleton.h"
static int update(Model *m, Complex *r)
{
    r[Y] = r[COUNT] + m->t;
    return OK;
}
int discrete(Model *m, Events *e)
{
    while (m->t >= (m->r[COUNT] + 1.0) * m->r[PERIOD] - 1e-12) m->r[COUNT] += 1.0;
    e->next_defined = 1;
    e->next = (m->r[COUNT] + 1.0) * m->r[PERIOD];
    return OK;
}
