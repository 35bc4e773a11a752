/* A law with a step by the sign of a speed, such as dry friction, held on a side of it. The law's share of its step is an
 * input of its own ("direction"): +1 or -1 while the speed has a sign, so that the equations have no corner there. Where the
 * speed comes to zero the law is a set-valued force: the share that keeps the speed at zero is sought, and while it lies
 * between -1 and 1 the model rests (A. F. Filippov, Differential Equations with Discontinuous Righthand Sides, 1988). The
 * forces are affine in the share, so that one step of Newton's method finds it. The speed is a sum of states. */
#include "engine.h"

#define SLACK 1e-12 /* of the sizes of the speed's states: what is no speed, and by how much a share may exceed 1 */

static double speed(const Run *r, const double *x)
{
    const Relay *relay = &r->problem->relay;
    double v = 0.0;
    for (int j = 0; j < relay->n; j++) v += relay->gain[j] * x[relay->state[j]];
    return v;
}

static double speed_of_column(const Run *r, int k)
{
    const Relay *relay = &r->problem->relay;
    double v = 0.0;
    for (int j = 0; j < relay->n; j++) v += relay->gain[j] * r->s[relay->state[j] * r->ld + k];
    return v;
}

static double slack(const Run *r)
{
    const Relay *relay = &r->problem->relay;
    double size = 0.0;
    for (int j = 0; j < relay->n; j++) size += fabs(relay->gain[j]) * state_size(r, relay->state[j], 0.0);
    return SLACK * size;
}

static int give_share(Run *r, double share)
{
    r->share = share;
    return r->fmu->set_real(r->fmu->instance, &r->problem->relay.direction, 1, &share);
}

/* By how much the speed's rate grows with each of m other variables, where the FMU stands. */
static int growth(Run *r, const fmi_reference *known, size_t m, double *out)
{
    const Relay *relay = &r->problem->relay;
    const size_t n = (size_t)relay->n;
    double rows[n * m];
    const int status = plain_columns(r, relay->rate, n, known, m, rows);
    for (size_t k = 0; k < m; k++) {
        out[k] = 0.0;
        for (size_t j = 0; j < n; j++) out[k] += relay->gain[j] * rows[j * m + k];
    }
    return status;
}

/* The share that keeps the speed as it is where the FMU stands; not finite where none does. */
static int find_share(Run *r, double *share)
{
    double by = 0.0;
    int status = r->fmu->get_derivatives(r->fmu->instance, r->derivatives_unused, (size_t)r->n);
    if (!is_error(status)) status = growth(r, &r->problem->relay.direction, 1, &by);
    *share = by < 0.0 ? r->share - speed(r, r->derivatives_unused) / by : copysign(INFINITY, speed(r, r->derivatives_unused));
    return status;
}

/* The FMU was moved: its share follows where the model rests. */
int relay_settle(Run *r)
{
    double share;
    if (r->relay != RELAY_RESTS) return FMI_OK;
    const int status = find_share(r, &share);
    return is_error(status) ? status : give_share(r, share);
}

/* What rest adds to derivatives: the share moves so that the speed stays. A row of m for each of the n. */
int relay_columns(Run *r, const fmi_reference *unknown, size_t n, const fmi_reference *known, size_t m, double *out)
{
    const fmi_reference *direction = &r->problem->relay.direction;
    fmi_reference all[m + 1];
    double by[m + 1], column[n];
    memcpy(all, known, sizeof *all * m);
    all[m] = *direction;
    int status = growth(r, all, m + 1, by);
    if (!is_error(status)) status = plain_columns(r, unknown, n, direction, 1, column);
    for (size_t i = 0; i < n && !is_error(status); i++)
        for (size_t k = 0; k < m; k++) out[i * m + k] -= column[i] * by[k] / by[m];
    return status;
}

/* Positive while the side holds, or while the model rests. */
double relay_margin(const Run *r, const double *x)
{
    return r->relay == RELAY_RESTS ? 1.0 + SLACK - fabs(r->share) : r->side * speed(r, x) + slack(r);
}

/* Which side holds from (r->t, r->x), where the speed is about zero, or whether the model rests. */
static int take_side(Run *r)
{
    double share;
    int status = set_point(r, r->t, r->x);
    if (!is_error(status)) status = find_share(r, &share);
    if (is_error(status)) return status;
    const int rests = fabs(share) <= 1.0;
    if (r->exponential && (rests || r->relay == RELAY_RESTS)) r->exponential->known = 0; /* other equations */
    r->relay = rests ? RELAY_RESTS : RELAY_SLIDES;
    if (!rests) r->side = share > 0.0 ? 1.0 : -1.0;
    status = give_share(r, rests ? share : r->side);
    return is_error(status) ? status : indicators(r, r->t, r->x, r->z0);
}

/* At the first sample. */
int relay_begin(Run *r)
{
    if (!relay_is_held(r->problem)) return FMI_OK;
    const double v = speed(r, r->x);
    r->nz = r->problem->nz + 1;
    r->relay = RELAY_SLIDES;
    if (fabs(v) <= slack(r)) return take_side(r);
    r->side = v > 0.0 ? 1.0 : -1.0;
    return give_share(r, r->side);
}

/* Each column jumps along `slope`, which changes the speed's rate by `rate`, by as much as it moves the speed. */
static void jump_columns(Run *r, const double *slope, double rate)
{
    for (int k = 0; k < r->q && rate != 0.0; k++) {
        const double share = speed_of_column(r, k) / rate;
        for (int i = 0; i < r->n; i++) r->s[i * r->ld + k] -= slope[i] * share;
    }
}

/* Of a run that begins at rest: a speed that it would have begun with is lost at once, by an impulse of the law. */
int relay_columns_begin(Run *r)
{
    const Problem *p = r->problem;
    if (r->relay != RELAY_RESTS) return FMI_OK;
    int status = set_point(r, r->t, r->x);
    if (!is_error(status))
        status = plain_columns(r, p->derivative_reference, (size_t)r->n, &p->relay.direction, 1, r->u);
    if (!is_error(status)) jump_columns(r, r->u, speed(r, r->u));
    return status;
}

/* Inputs have jumped: does the model still rest? */
int relay_jump(Run *r)
{
    if (r->relay != RELAY_RESTS) return FMI_OK;
    const int status = set_point(r, r->t, r->x);
    return is_error(status) || fabs(r->share) <= 1.0 ? status : take_side(r);
}

/* The margin has changed its sign at (r->t, r->x). Sensitivities jump as the time of it moves with the columns, where the
 * slope of the states does. */
int relay_turn(Run *r)
{
    double *before = r->f, *after = r->f1;
    const int slid = r->relay == RELAY_SLIDES;
    int status = slid && r->sensitive ? rhs(r, r->t, r->x, before) : FMI_OK;
    if (!is_error(status)) status = take_side(r);
    if (is_error(status) || !slid || !r->sensitive) return status;
    status = rhs(r, r->t, r->x, after);
    const double rate = speed(r, before);
    for (int i = 0; i < r->n; i++) before[i] -= after[i];
    if (!is_error(status)) jump_columns(r, before, rate);
    return status;
}

/* May the speed have changed its sign twice between two points of an exponential step? By a parabola through three of
 * them: its beginning and the points. */
int relay_turns(const Run *r, double *const *x)
{
    static const double at[NODES_X + 1] = {0.0, 1.0 / 6.0, 2.0 / 3.0, 1.0};
    if (r->relay != RELAY_SLIDES) return 0;
    double v[NODES_X + 1] = {r->side * speed(r, r->x)};
    for (int j = 0; j < NODES_X; j++) v[j + 1] = r->side * speed(r, x[j]);
    for (int first = 0; first < 2; first++) {
        const double *t = at + first, *y = v + first;
        const double d1 = (y[1] - y[0]) / (t[1] - t[0]), d2 = (y[2] - y[1]) / (t[2] - t[1]), c = (d2 - d1) / (t[2] - t[0]);
        if (!(c > 0.0)) continue;
        const double lowest = 0.5 * (t[0] + t[1] - d1 / c);
        if (lowest <= t[0] || lowest >= t[2]) continue;
        if (y[0] + (lowest - t[0]) * (d1 + c * (lowest - t[1])) < 0.0) return 1;
    }
    return 0;
}
