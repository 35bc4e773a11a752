/* The floor of bench_moving.py: the models of its rows written by hand in C, integrated with a fixed step by the classical
 * Runge-Kutta method, nothing else. Inputs are held from sample to sample. */

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

static inline void aero_outputs(const double *x, double u, const double *p, double *y)
{
    (void)u, (void)p;
    y[0] = x[0], y[1] = x[1], y[2] = x[2];
}

/* coil: current; L R */
static inline void coil(const double *x, double u, const double *p, double *f) { f[0] = (u - p[1] * x[0]) / p[0]; }

static inline void first_state(const double *x, double u, const double *p, double *y)
{
    (void)u, (void)p;
    y[0] = x[0];
}

/* battery: charge; E_0 k R */
static inline void battery(const double *x, double u, const double *p, double *f)
{
    (void)x, (void)p;
    f[0] = u;
}

static inline void battery_outputs(const double *x, double u, const double *p, double *y)
{
    y[0] = p[0] - p[1] * x[0] - p[2] * u;
}

/* cart: position and velocity; m k d */
static inline void cart(const double *x, double u, const double *p, double *f)
{
    f[0] = x[1];
    f[1] = (u - p[1] * x[0] - p[2] * x[1]) / p[0];
}

/* `rows` samples into out, with `parts` steps between two of them. */
#define LOOP(model, outputs, N, M)                                                                           \
    void model##_loop(long rows, const double *t, const double *u, const double *p, long parts, double *out) \
    {                                                                                                        \
        double x[N] = {0}, a[N], b[N], c[N], d[N], y[N];                                                     \
        for (long row = 0; row < rows; row++) {                                                              \
            outputs(x, u[row], p, out + row * M);                                                            \
            if (row + 1 == rows) break;                                                                      \
            const double h = (t[row + 1] - t[row]) / (double)parts, v = u[row];                              \
            for (long part = 0; part < parts; part++) {                                                      \
                model(x, v, p, a);                                                                           \
                for (int i = 0; i < N; i++) y[i] = x[i] + 0.5 * h * a[i];                                    \
                model(y, v, p, b);                                                                           \
                for (int i = 0; i < N; i++) y[i] = x[i] + 0.5 * h * b[i];                                    \
                model(y, v, p, c);                                                                           \
                for (int i = 0; i < N; i++) y[i] = x[i] + h * c[i];                                          \
                model(y, v, p, d);                                                                           \
                for (int i = 0; i < N; i++) x[i] += h / 6.0 * (a[i] + 2.0 * (b[i] + c[i]) + d[i]);           \
            }                                                                                                \
        }                                                                                                    \
    }

LOOP(aero, aero_outputs, 6, 3)
LOOP(coil, first_state, 1, 1)
LOOP(battery, battery_outputs, 1, 1)
LOOP(cart, first_state, 2, 1)
