/* Linear equations by LU factorisation. */
#ifndef AERO_BAYES_LINEAR_EQUATIONS_H
#define AERO_BAYES_LINEAR_EQUATIONS_H
#include <math.h>

/* LU by columns of an n by n matrix, with partial pivoting; 0 where it is singular. */
static int factorise(double *a, int *pivot, int n) {
    for (int k = 0; k < n; k++) {
        int p = k;
        for (int i = k + 1; i < n; i++) if (fabs(a[k * n + i]) > fabs(a[k * n + p])) p = i;
        pivot[k] = p;
        if (!(fabs(a[k * n + p]) > 0)) return 0;
        if (p != k) for (int j = 0; j < n; j++) { double t = a[j * n + k]; a[j * n + k] = a[j * n + p]; a[j * n + p] = t; }
        for (int i = k + 1; i < n; i++) a[k * n + i] /= a[k * n + k];
        for (int j = k + 1; j < n; j++) {
            double f = a[j * n + k];
            if (f != 0) for (int i = k + 1; i < n; i++) a[j * n + i] -= f * a[k * n + i];
        }
    }
    return 1;
}
static void substitute(const double *a, const int *pivot, double *b, int n) {
    for (int k = 0; k < n; k++) { double t = b[pivot[k]]; b[pivot[k]] = b[k]; b[k] = t; }
    for (int j = 0; j < n; j++) for (int i = j + 1; i < n; i++) b[i] -= a[j * n + i] * b[j];
    for (int j = n - 1; j >= 0; j--) {
        b[j] /= a[j * n + j];
        for (int i = 0; i < j; i++) b[i] -= a[j * n + i] * b[j];
    }
}

#endif
