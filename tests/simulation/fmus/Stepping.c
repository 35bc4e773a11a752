/* x' = 1 - x + b cos(4 t) from t = 1 on (a time event switches it on); a callback a step that asks for an event: always
 * with ALWAYS, else where x has passed the ceiling, below which the event brings it back to nothing. */
#define STATES {0}
#define DERIVATIVES {1}
#define STEP_EVENT
#include "skeleton.h"
enum { X, DX, B, CEILING, ON };
static void start(Model *m) { m->r[CEILING] = 10.0; }
static int initialize(Model *m) { return OK; }
static int update(Model *m)
{
    m->r[DX] = 1.0 - m->r[X] + (m->r[ON] ? m->r[B] * cos(4.0 * m->t) : 0.0);
    return OK;
}
static int step_event(Model *m)
{
#ifdef ALWAYS
    return 1;
#endif
    return m->r[X] > m->r[CEILING];
}
static int discrete(Model *m, Events *e)
{
    if (m->t >= 1.0) m->r[ON] = 1.0;
    if (m->r[X] > m->r[CEILING]) m->r[X] = 0.0;
    e->next_defined = !m->r[ON];
    e->next = 1.0;
    return OK;
}
static void zero_crossings(Model *m, double *z) {}
static int derivative(Model *m, unsigned unknown, unsigned known, double *v)
{
    *v = unknown == DX ? known == X ? -1.0 : known == B && m->r[ON] ? cos(4.0 * m->t) : 0.0 : 0.0;
    return OK;
}
