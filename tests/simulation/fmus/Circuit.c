/* A ladder of three L-R-C sections (stiff: L/R = 10 us, RC = 10 ms), driven by u:
 * L i_k' = v_(k-1) - R i_k - v_k;  C v_k' = i_k - i_(k+1) - G v_k.  Output: the last voltage, and what u delivers. */
#include "skeleton.h"
static int update(Model *m, Complex *r)
{
    for (int k = 0; k < 3; k++) {
        const Complex i = r[I0 + 4 * k], v = r[V0 + 4 * k];
        r[DER_I0 + 4 * k] = ((k ? r[V0 + 4 * k - 4] : r[U]) - r[R] * i - v) / r[L];
        r[DER_V0 + 4 * k] = (i - (k < 2 ? r[I0 + 4 * k + 4] : 0.0) - r[G] * v) / r[C];
    }
    r[POWER] = r[U] * r[I0];
    return OK;
}
