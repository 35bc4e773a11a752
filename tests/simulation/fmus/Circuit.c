/* A ladder of three L-R-C sections (stiff: L/R = 10 us, RC = 10 ms), driven by u:
 * L i_k' = v_(k-1) - R i_k - v_k;  C v_k' = i_k - i_(k+1) - G v_k.  Output: the last voltage, and what u delivers. */
#define STATES {0, 2, 4, 6, 8, 10}
#define DERIVATIVES {1, 3, 5, 7, 9, 11}
#include "skeleton.h"
enum { U = 12, R, L, C, G, POWER };
static void start(Model *m) { m->r[R] = 10.0, m->r[L] = 1e-4, m->r[C] = 1e-3, m->r[G] = 1e-3; }
static int initialize(Model *m) { return OK; }
static double current(const double *r, int k) { return k < 3 ? r[4 * k] : 0.0; }
static double voltage(const double *r, int k) { return k < 0 ? r[U] : r[4 * k + 2]; }
static int update(Model *m)
{
    double *r = m->r;
    for (int k = 0; k < 3; k++) {
        r[4 * k + 1] = (voltage(r, k - 1) - r[R] * current(r, k) - voltage(r, k)) / r[L];
        r[4 * k + 3] = (current(r, k) - current(r, k + 1) - r[G] * voltage(r, k)) / r[C];
    }
    r[POWER] = r[U] * r[0];
    return OK;
}
static int discrete(Model *m, Events *e) { return OK; }
static void zero_crossings(Model *m, double *z) {}
static int derivative(Model *m, unsigned unknown, unsigned known, double *v)
{
    const double *r = m->r;
    *v = 0.0;
    if (unknown == POWER) {
        *v = known == U ? r[0] : known == 0 ? r[U] : 0.0;
        return OK;
    }
    if (unknown > 11 || !(unknown & 1)) return ERROR;
    const int k = unknown / 4, is_current = unknown % 4 == 1;
    if (is_current) {
        if (known == 4u * k) *v = -r[R] / r[L];
        if (known == 4u * k + 2) *v = -1.0 / r[L];
        if (k == 0 ? known == U : known == 4u * k - 2) *v = 1.0 / r[L];
        if (known == R) *v = -current(r, k) / r[L];
        if (known == L) *v = -(voltage(r, k - 1) - r[R] * current(r, k) - voltage(r, k)) / (r[L] * r[L]);
    } else {
        if (known == 4u * k) *v = 1.0 / r[C];
        if (k < 2 && known == 4u * k + 4) *v = -1.0 / r[C];
        if (known == 4u * k + 2) *v = -r[G] / r[C];
        if (known == G) *v = -voltage(r, k) / r[C];
        if (known == C) *v = -(current(r, k) - current(r, k + 1) - r[G] * voltage(r, k)) / (r[C] * r[C]);
    }
    return OK;
}
