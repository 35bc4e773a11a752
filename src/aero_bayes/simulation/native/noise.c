/* Gaussian noise of one output: white plus an Ornstein-Uhlenbeck process, as a scalar innovations (Kalman) filter.
 * State space form of a first-order process: S. Sarkka, Bayesian Filtering and Smoothing (2013), ch. 4; on a uniform
 * grid the gain converges to its steady value, which the discrete Riccati equation gives in closed form. */
#include "engine.h"

#define LOG_2PI 1.8378770664093454836

void filter_begin(Filter *f, const double *noise, double spacing)
{
    memset(f, 0, sizeof *f);
    f->white = noise[0] * noise[0];
    f->stationary = noise[1] * noise[1];
    f->tau = noise[2];
    if (!(f->tau > 0.0) && f->stationary > 0.0) { /* no memory: just more white noise */
        f->white += f->stationary;
        f->stationary = 0.0;
    }
    f->variance = f->stationary;
    f->first = 1;
    f->phi = spacing > 0.0 && f->stationary > 0.0 ? exp(-spacing / f->tau) : 0.0;
    f->p_steady = -1.0;
    if (spacing > 0.0 && f->stationary > 0.0) {
        /* P = phi^2 P R / (P + R) + Q  =>  P^2 + P (R - phi^2 R - Q) - Q R = 0 */
        const double r = f->white, q = -f->stationary * expm1(-2.0 * spacing / f->tau);
        const double b = r * -expm1(-2.0 * spacing / f->tau) - q;
        const double root = sqrt(b * b + 4.0 * q * r);
        f->p_steady = b > 0.0 ? 2.0 * q * r / (b + root) : 0.5 * (root - b);
    }
}

/* Gains for the next samples; `measured` may be NULL for "all there". Returns the number of samples used. */
int64_t filter_gains(Filter *f, const double *time, const double *measured, int64_t count, double spacing,
                     double *gain, double *decay, double *weight, double *log_det)
{
    int64_t used = 0, k = 0;
    double sum = 0.0;
    while (k < count) {
        if (f->steady && spacing > 0.0) {
            const double total = f->p_steady + f->white, g = f->p_steady / total, w = 1.0 / sqrt(total);
            const int64_t from = k;
            while (k < count && !(measured && measured[k] != measured[k])) {
                gain[k] = g;
                decay[k] = f->phi;
                weight[k] = w;
                k++;
            }
            used += k - from;
            sum += 0.5 * (double)(k - from) * (LOG_2PI + log(total));
            f->variance = f->p_steady * f->white / total;
            if (k == count) break;
            f->steady = 0;
        }
        double phi = f->phi, p = f->variance;
        if (f->first) {
            phi = 0.0;
            p = f->stationary;
            f->first = 0;
        } else {
            if (!(spacing > 0.0)) {
                const double dt = time[k] - f->last_time;
                if (dt != f->last_dt) {
                    f->last_dt = dt;
                    f->last_phi = exp(-dt / f->tau);
                }
                phi = f->last_phi;
            }
            p = phi * phi * p + f->stationary * (1.0 - phi * phi);
        }
        if (!(spacing > 0.0)) f->last_time = time[k];
        decay[k] = phi;
        if (measured && measured[k] != measured[k]) {
            gain[k] = weight[k] = 0.0;
            f->variance = p;
        } else {
            const double total = p + f->white;
            gain[k] = p / total;
            weight[k] = 1.0 / sqrt(total);
            sum += 0.5 * (LOG_2PI + log(total));
            used++;
            f->variance = p * f->white / total;
            if (f->p_steady >= 0.0 && fabs(p - f->p_steady) <= 1e-14 * f->p_steady) f->steady = 1;
        }
        k++;
    }
    *log_det += sum;
    return used;
}

/* Rows (k, n) in place to innovations over their standard deviation, whose inverse goes to weight (noises, n). Either
 * one noise holds for all rows or each row has its own; `mean` is k zeros. Times count where spacing is zero. */
__attribute__((visibility("default"))) void ab_whiten(const double *time, double spacing, int64_t n,
                                                      const double *noise, int64_t noises, double *rows, int64_t k,
                                                      double *mean, double *weight)
{
    enum { PART = 512 };
    double gain[PART], decay[PART], log_det = 0.0;
    const int64_t share = noises == 1 ? k : 1;
    kernels_choose();
    for (int64_t i = 0; i < noises; i++) {
        Filter f;
        filter_begin(&f, noise + 3 * i, spacing);
        for (int64_t first = 0; first < n; first += PART) {
            const int64_t count = n - first < PART ? n - first : PART;
            double *w = weight + i * n + first;
            filter_gains(&f, time + first, NULL, count, spacing, gain, decay, w, &log_det);
            for (int64_t r = i * share; r < (i + 1) * share; r++)
                mean[r] = kernels->colour(rows + r * n + first, count, gain, decay, w, mean[r]);
        }
    }
}
