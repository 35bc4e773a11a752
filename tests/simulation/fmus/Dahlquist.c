/* x' = -k x + a cos(w t) + b u;  y = 2 x + 3 u + c;  x(0) = x0, or g when g is not zero (a calculated start). */
#include "skeleton.h"
int initialize(Model *m)
{
    if (m->r[G] != 0.0) m->r[X] = m->r[G];
    return OK;
}
static int update(Model *m, Complex *r)
{
    r[DER_X] = -r[K] * r[X] + r[A] * cos(r[W] * m->t) + r[B] * r[U];
    r[Y] = 2.0 * r[X] + 3.0 * r[U] + r[C];
    return OK;
}
