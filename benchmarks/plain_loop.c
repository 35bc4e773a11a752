/* The floor of bench_engine.py: the AERO written by hand in C, integrated with a fixed step by the classical Runge-Kutta
 * method, nothing else. Inputs are held from sample to sample. */

/* AERO: current and speed of motor 1, angle, rate, current and speed of motor 2; R L c J k_d k_t J_p D_p K_sp D_t */
static inline void aero(const double *x, double u, const double *p, double *f)
{
    const double size_1 = x[1] * (x[1] < 0.0 ? -x[1] : x[1]), size_2 = x[5] * (x[5] < 0.0 ? -x[5] : x[5]);
    f[0] = (u - p[0] * x[0] - p[2] * x[1]) / p[1];
    f[1] = (p[2] * x[0] - p[4] * size_1) / p[3];
    f[2] = x[3];
    f[3] = (p[9] * p[5] * (size_1 - size_2) - p[7] * x[3] - p[8] * x[2]) / p[6];
    f[4] = (-u - p[0] * x[4] - p[2] * x[5]) / p[1];
    f[5] = (p[2] * x[4] - p[4] * size_2) / p[3];
}

/* `rows` samples into out, with `parts` steps between two of them. */
void aero_loop(long rows, const double *t, const double *u, const double *p, long parts, double *out)
{
    double x[6] = {0}, a[6], b[6], c[6], d[6], y[6];
    for (long row = 0; row < rows; row++) {
        for (int i = 0; i < 3; i++) out[3 * row + i] = x[i];
        if (row + 1 == rows) break;
        const double h = (t[row + 1] - t[row]) / (double)parts, v = u[row];
        for (long part = 0; part < parts; part++) {
            aero(x, v, p, a);
            for (int i = 0; i < 6; i++) y[i] = x[i] + 0.5 * h * a[i];
            aero(y, v, p, b);
            for (int i = 0; i < 6; i++) y[i] = x[i] + 0.5 * h * b[i];
            aero(y, v, p, c);
            for (int i = 0; i < 6; i++) y[i] = x[i] + h * c[i];
            aero(y, v, p, d);
            for (int i = 0; i < 6; i++) x[i] += h / 6.0 * (a[i] + 2.0 * (b[i] + c[i]) + d[i]);
        }
    }
}
