/* x' = -z with the algebraic loop z + z^3 = x + a sin(t), solved by Newton's method; x is reset to 1 where z falls to c. */
#define STATES {0}
#define DERIVATIVES {1}
#define ONLY_DERIVATIVES_SOLVE
#include "skeleton.h"
enum { X, DX, Z, A, C };
static void start(Model *m) { m->r[X] = 1.0, m->r[A] = 0.5, m->r[C] = 0.2; }
static int update(Model *m)
{
    double *r = m->r, right = r[X] + r[A] * sin(m->t);
    for (int i = 0; i < 60; i++) r[Z] -= (r[Z] + r[Z] * r[Z] * r[Z] - right) / (1.0 + 3.0 * r[Z] * r[Z]);
    r[DX] = -r[Z];
    return OK;
}
static int initialize(Model *m) { return update(m); }
static int discrete(Model *m, Events *e)
{
    update(m);
    if (m->r[Z] <= m->r[C]) m->r[X] = 1.0;
    return OK;
}
static void zero_crossings(Model *m, double *z) { z[0] = m->r[Z] - m->r[C]; }
static int derivative(Model *m, unsigned unknown, unsigned known, double *v)
{
    const double slope = 1.0 / (1.0 + 3.0 * m->r[Z] * m->r[Z]);
    *v = known == X ? slope : known == A ? slope * sin(m->t) : 0.0;
    if (unknown == DX) *v = -*v;
    return OK;
}
