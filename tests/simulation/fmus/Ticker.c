/* No states: a counter that a time event raises every `period`, and y = the counter plus the time. */
#define STATES {0}
#define DERIVATIVES {0}
#include "skeleton.h"
enum { COUNT, Y, PERIOD };
static void start(Model *m) { m->r[PERIOD] = 0.3; }
static int initialize(Model *m) { return OK; }
static int update(Model *m)
{
    m->r[Y] = m->r[COUNT] + m->t;
    return OK;
}
static int discrete(Model *m, Events *e)
{
    while (m->t >= (m->r[COUNT] + 1.0) * m->r[PERIOD] - 1e-12) m->r[COUNT] += 1.0;
    e->next_defined = 1;
    e->next = (m->r[COUNT] + 1.0) * m->r[PERIOD];
    return OK;
}
static void zero_crossings(Model *m, double *z) {}
static int derivative(Model *m, unsigned unknown, unsigned known, double *v)
{
    *v = 0.0;
    return OK;
}
