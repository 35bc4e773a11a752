/* A point on the unit circle at constant speed, by one of its coordinates. Once x, the declared state, has come close to
 * 1, an event after the step puts y in its place. */
#define STATES {0}
#define DERIVATIVES {1}
#define STEP_EVENT
#define STATE(m, i) ((m)->r[(m)->r[OTHER] ? Y : X])
enum { X, DX, Y, OTHER };
#include "skeleton.h"
static void start(Model *m) { m->r[X] = 0.1; }
static int initialize(Model *m) { return OK; }
static double root(double v) { return sqrt(v * v < 1.0 ? 1.0 - v * v : 0.0); }
static int update(Model *m)
{
    double *r = m->r;
    r[r[OTHER] ? X : Y] = root(r[r[OTHER] ? Y : X]);
    r[DX] = r[OTHER] ? -r[X] : r[Y];
    return OK;
}
static int step_event(Model *m) { return m->r[X] > 0.8 && !m->r[OTHER]; }
static int discrete(Model *m, Events *e)
{
    update(m);
    if (step_event(m)) m->r[OTHER] = e->nominals_changed = e->states_changed = 1;
    return OK;
}
static void zero_crossings(Model *m, double *z) {}
static int derivative(Model *m, unsigned unknown, unsigned known, double *v) { return ERROR; }
