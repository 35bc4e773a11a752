/* Event mode: iteration of discrete states, event indicators and their roots on the continuous extension. */
#include <float.h>

#include "engine.h"

enum { MOST_ITERATIONS = 1000 };

/* A state event at r->t, whose time moves with the parameters. */
void remember_event(Run *r)
{
    r->events_seen = 1;
    if (r->n_events == r->cap_events) {
        r->cap_events = 2 * r->cap_events + 64;
        r->event_times = realloc(r->event_times, sizeof *r->event_times * (size_t)r->cap_events);
    }
    r->event_times[r->n_events++] = r->t;
}

/* fmi2NewDiscreteStates until nothing changes; the instance is in event mode. */
int event_iterate(Run *r)
{
    Fmu *f = r->fmu;
    fmi_event_info info;
    r->nominals_changed = 0;
    int rounds = 0;
    do {
        memset(&info, 0, sizeof info);
        const int status = f->new_discrete(f->instance, &info);
        if (is_error(status)) return status;
        r->nominals_changed |= info.nominals_changed;
        if (info.terminate_simulation || ++rounds > MOST_ITERATIONS) return FMI_ERROR;
    } while (info.new_discrete_states_needed);
    r->next_event = info.next_event_time_defined ? info.next_event_time : INFINITY;
    return FMI_OK;
}

int indicators(Run *r, double t, const double *x, double *z)
{
    const int status = set_point(r, t, x);
    if (r->relay != RELAY_FREE) z[r->nz - 1] = relay_margin(r, x);
    return is_error(status) || !r->problem->nz ? status : r->fmu->get_indicators(r->fmu->instance, z, (size_t)r->problem->nz);
}

int crossed(const double *z0, const double *z1, int nz)
{
    for (int i = 0; i < nz; i++)
        if ((z0[i] > 0.0) != (z1[i] > 0.0)) return 1;
    return 0;
}

static int indicators_at(Run *r, double h, double fraction, double *z)
{
    for (int i = 0; i < r->n; i++) kernel_horner(r->dense + i, r->n, &fraction, 1, r->u + i);
    return indicators(r, r->t + fraction * h, r->u, z);
}

/* Earliest fraction in (0, 1] of the step just after an indicator changed its sign, or 2; r->status tells of errors.
 * The indicators at the start of the step are in r->z0. The state at the root is left in r->u. */
double find_event(Run *r, double h)
{
    static const double probe[] = {1.0 / 3.0, 2.0 / 3.0, 1.0}; /* two crossings within a third are missed */
    double lo = 0.0, hi = 2.0;
    r->status = FMI_OK;
    for (int k = 0; k < 3; k++) {
        r->status = indicators_at(r, h, probe[k], r->z1);
        if (is_error(r->status)) return 2.0;
        if (crossed(r->z0, r->z1, r->nz)) {
            hi = probe[k];
            break;
        }
        lo = probe[k];
    }
    if (hi > 1.0) return hi;
    r->status = indicators_at(r, h, lo, r->z2);
    if (is_error(r->status)) return 2.0;
    /* z2 at lo, z1 at hi: probe just below and just above the earliest secant root, and bisect every third time */
    const double narrow = fmax(4.0 * DBL_EPSILON * fabs(r->t) / h, 1e-14);
    for (int round = 0; round < 150 && hi - lo > narrow; round++) {
        const double width = hi - lo;
        double fraction = 0.5 * (lo + hi);
        if (round % 3 != 2) {
            double first = 1.0;
            for (int i = 0; i < r->nz; i++)
                if ((r->z2[i] > 0.0) != (r->z1[i] > 0.0)) first = fmin(first, r->z2[i] / (r->z2[i] - r->z1[i]));
            const double margin = fmax(0.45 * narrow, fmin(0.1, width) * width);
            const double guess = lo + first * width + (round % 3 == 0 ? -margin : margin);
            if (guess > lo && guess < hi) fraction = guess;
        }
        r->status = indicators_at(r, h, fraction, r->z_try);
        if (is_error(r->status)) return 2.0;
        const int after = crossed(r->z0, r->z_try, r->nz);
        if (after)
            hi = fraction;
        else
            lo = fraction;
        memcpy(after ? r->z1 : r->z2, r->z_try, sizeof(double) * (size_t)r->nz);
    }
    r->status = indicators_at(r, h, hi, r->z1);
    return hi;
}
