/* x' = -z with the algebraic loop z + z^3 = x + a sin(t), solved by Newton's method; x is reset to 1 where z falls to c. */
#define ONLY_DERIVATIVES_SOLVE
#include "skeleton.h"
static int update(Model *m, Complex *r)
{
    const Complex right = r[X] + r[A] * sin(m->t);
    for (int i = 0; i < 60; i++) r[Z] -= (r[Z] + r[Z] * r[Z] * r[Z] - right) / (1.0 + 3.0 * r[Z] * r[Z]);
    r[DER_X] = -r[Z];
    return OK;
}
int initialize(Model *m) { return refresh(m); }
int discrete(Model *m, Events *e)
{
    refresh(m);
    if (m->r[Z] <= m->r[C]) m->r[X] = 1.0;
    return OK;
}
void zero_crossings(Model *m, double *z) { z[0] = m->r[Z] - m->r[C]; }
