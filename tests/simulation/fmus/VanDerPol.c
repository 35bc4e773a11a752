/* x0' = x1;  x1' = mu ((1 - x0^2) x1) - x0 */
#include "skeleton.h"
static int update(Model *m, Complex *r)
{
    r[DER_X0] = r[X1];
    r[DER_X1] = r[MU] * ((1.0 - r[X0] * r[X0]) * r[X1]) - r[X0];
    return OK;
}
