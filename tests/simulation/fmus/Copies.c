/* h' = w v, v' = -w h, written as OpenModelica writes outputs that are states: h and v have references of their own. Beside
 * them outputs that only look like copies: `scaled` = k v with k = 1, `clipped` = max(v, 0), `driven` = h + u. */
#include "skeleton.h"
static int update(Model *m, Complex *r)
{
    const Complex h = r[D_OUTPUTALIAS_H], v = r[V_INSIDE];
    r[DER_D_OUTPUTALIAS_H] = r[W] * v;
    r[DER_V_INSIDE] = -r[W] * h;
    r[H] = h;
    r[V] = v;
    r[SCALED] = r[K] * v;
    r[CLIPPED] = creal(v) > 0.0 ? v : 0.0;
    r[DRIVEN] = h + r[U];
    return OK;
}
