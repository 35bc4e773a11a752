/* x' = 1 - x + b cos(4 t) from t = 1 on (a time event switches it on); a callback a step that asks for an event: always
 * with ALWAYS, else where x has passed the ceiling, below which the event brings it back to nothing. */
enum { ON = 50 };
#include "skeleton.h"
static int update(Model *m, Complex *r)
{
    r[DER_X] = 1.0 - r[X] + m->r[ON] * r[B] * cos(4.0 * m->t);
    return OK;
}
int step_event(Model *m)
{
#ifdef ALWAYS
    return 1;
#endif
    return m->r[X] > m->r[CEILING];
}
int discrete(Model *m, Events *e)
{
    if (m->t >= 1.0) m->r[ON] = 1.0;
    if (m->r[X] > m->r[CEILING]) m->r[X] = 0.0;
    e->next_defined = !m->r[ON];
    e->next = 1.0;
    return OK;
}
