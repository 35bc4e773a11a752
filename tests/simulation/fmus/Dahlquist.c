/* x' = -k x + a cos(w t) + b u;  y = 2 x + 3 u + c;  x(0) = x0, or g when g is not zero (a calculated start). */
#define STATES {0}
#define DERIVATIVES {1}
#include "skeleton.h"
enum { X, DX, K, A, W, B, U, Y, C, G };
static void start(Model *m) { m->r[X] = 1.0, m->r[K] = 1.0, m->r[B] = 1.0, m->r[W] = 1.0; }
static int initialize(Model *m)
{
    if (m->r[G] != 0.0) m->r[X] = m->r[G];
    return OK;
}
static int update(Model *m)
{
    double *r = m->r;
    r[DX] = -r[K] * r[X] + r[A] * cos(r[W] * m->t) + r[B] * r[U];
    r[Y] = 2.0 * r[X] + 3.0 * r[U] + r[C];
    return OK;
}
static int discrete(Model *m, Events *e) { return OK; }
static void zero_crossings(Model *m, double *z) {}
static int derivative(Model *m, unsigned unknown, unsigned known, double *v)
{
    const double *r = m->r;
#ifdef REFUSE
    if (known != X && known != U) return ERROR;
#endif
    if (unknown == DX)
        *v = known == X ? -r[K] : known == K ? -r[X] : known == A ? cos(r[W] * m->t)
             : known == W ? -r[A] * m->t * sin(r[W] * m->t) : known == B ? r[U] : known == U ? r[B] : 0.0;
    else if (unknown == Y)
        *v = known == X ? 2.0 : known == U ? 3.0 : known == C ? 1.0 : 0.0;
    else
        return ERROR;
    return OK;
}
