/* A point on the unit circle at constant speed, by one of its coordinates. Once x, the declared state, has come close to
 * 1, an event after the step puts y in its place. */
enum { OTHER = 50 };
#define STATE(m, i) ((m)->r[(m)->r[OTHER] ? Y : X])
#include "skeleton.h"
static int update(Model *m, Complex *r)
{
    const double seen = creal(r[r[OTHER] ? Y : X]);
    r[r[OTHER] ? X : Y] = sqrt(seen * seen < 1.0 ? 1.0 - seen * seen : 0.0);
    r[DER_X] = r[OTHER] ? -r[X] : r[Y];
    return OK;
}
int step_event(Model *m) { return m->r[X] > 0.8 && !m->r[OTHER]; }
int discrete(Model *m, Events *e)
{
    refresh(m);
    if (step_event(m)) m->r[OTHER] = e->nominals_changed = e->states_changed = 1;
    return OK;
}
