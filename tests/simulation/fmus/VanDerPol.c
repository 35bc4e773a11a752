/* x0' = x1;  x1' = mu ((1 - x0^2) x1) - x0 */
#define STATES {0, 2}
#define DERIVATIVES {1, 3}
#include "skeleton.h"
enum { X0, D0, X1, D1, MU };
static void start(Model *m) { m->r[X0] = 2.0, m->r[MU] = 1.0; }
static int initialize(Model *m) { return OK; }
static int update(Model *m)
{
    double *r = m->r;
    r[D0] = r[X1];
    r[D1] = r[MU] * ((1.0 - r[X0] * r[X0]) * r[X1]) - r[X0];
    return OK;
}
static int discrete(Model *m, Events *e) { return OK; }
static void zero_crossings(Model *m, double *z) {}
static int derivative(Model *m, unsigned unknown, unsigned known, double *v)
{
    const double *r = m->r;
    if (unknown == D0)
        *v = known == X1 ? 1.0 : 0.0;
    else
        *v = known == X0   ? -2.0 * r[MU] * r[X0] * r[X1] - 1.0
             : known == X1 ? r[MU] * (1.0 - r[X0] * r[X0])
#ifndef ONLY_STATES /* zero, and no error, for parameters */
             : known == MU ? (1.0 - r[X0] * r[X0]) * r[X1]
#endif
                           : 0.0;
    return OK;
}
