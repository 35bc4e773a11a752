/* h' = v, v' = -h, written as OpenModelica writes outputs that are states: h and v have references of their own. Beside
 * them outputs that only look like copies: `scaled` = k v with k = 1, `clipped` = max(v, 0), `driven` = h + u. */
#define STATES {0, 2}
#define DERIVATIVES {1, 3}
#include "skeleton.h"
enum { H, DH, V, DV, COPY_H, COPY_V, K, SCALED, CLIPPED, W, DRIVEN, U = 40 };
static void start(Model *m) { m->r[H] = 0.5, m->r[V] = 1.0, m->r[K] = 1.0, m->r[W] = 1.0; }
static int initialize(Model *m) { return OK; }
static int update(Model *m)
{
    double *r = m->r;
    r[DH] = r[W] * r[V];
    r[DV] = -r[W] * r[H];
    r[COPY_H] = r[H];
    r[COPY_V] = r[V];
    r[SCALED] = r[K] * r[V];
    r[CLIPPED] = r[V] > 0.0 ? r[V] : 0.0;
    r[DRIVEN] = r[H] + r[U];
    return OK;
}
static int discrete(Model *m, Events *e) { return OK; }
static void zero_crossings(Model *m, double *z) {}
static int derivative(Model *m, unsigned unknown, unsigned known, double *v)
{
    const double *r = m->r;
    *v = 0.0;
    if (unknown == DH) *v = known == V ? r[W] : known == W ? r[V] : 0.0;
    if (unknown == DV) *v = known == H ? -r[W] : known == W ? -r[H] : 0.0;
    if (unknown == COPY_H) *v = known == H;
    if (unknown == COPY_V) *v = known == V;
    if (unknown == SCALED) *v = known == V ? r[K] : known == K ? r[V] : 0.0;
    if (unknown == CLIPPED) *v = known == V && r[V] > 0.0;
    if (unknown == DRIVEN) *v = known == H || known == U;
    return OK;
}
