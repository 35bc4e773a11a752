/* x' = v, v' = -k x: an oscillator watched by outputs that are no states: one linear, one smooth, one with a kink at d,
 * one with a bump of this width at d. */
#include "skeleton.h"
static int update(Model *m, Complex *r)
{
    const Complex away = (r[X] - r[D]) / r[WIDTH];
    r[DER_X] = r[V];
    r[DER_V] = -r[K] * r[X];
    r[LINEAR] = 3.0 * r[X] + r[V] + r[D];
    r[SMOOTH] = exp(r[X] * r[V]);
    r[KINK] = creal(away) > 0.0 ? r[X] - r[D] : 0.0;
    r[BUMP] = 1.0 / (1.0 + away * away);
    return OK;
}
