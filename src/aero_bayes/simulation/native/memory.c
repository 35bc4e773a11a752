/* Laws at a recorded input that remember it: a rate limit, and a play. What they make of a signal that is held or moves
 * linearly between its samples is lines again, two in a sample at most. They are found one after the other, and exactly;
 * with them their derivatives by the law's parameters, whose cells end where the law changes over. */
#include "engine.h"

enum { MOST_PARAMETERS = 3 };

typedef struct {
    Drive *d;
    const double *p;    /* of a rate limit: inverse of the rate, start; of a play: share, half width, start */
    int row[MOST_PARAMETERS];
    double z, dz[MOST_PARAMETERS]; /* what is remembered, and its derivatives */
} Scan;

/* A part of the signal in which it is a line. */
typedef struct {
    double begin, end, u, slope, u_end;
} Piece;

static void add_cell(Scan *s, double time, double value, double slope, const double *by, const double *by_slope)
{
    Drive *d = s->d;
    const int64_t k = d->count++;
    d->time[k] = time, d->value[k] = value, d->slope[k] = slope;
    for (int j = 0; j < MOST_PARAMETERS; j++)
        if (s->row[j] >= 0) d->by[s->row[j]][k] = by[j], d->by[s->row[j]][d->room + k] = by_slope[j];
}

/* The output goes to the input as fast as it may, and then with it as long as it can follow. A start that is the input
 * itself has no slope: its effect grows with its square. A fit would never leave it, so there the slope is that of a start
 * which is used up within the first sample. */
static void limit_rate(Scan *s, const Piece *piece)
{
    const double rate = s->p[0] > 0.0 ? 1.0 / s->p[0] : INFINITY, su = piece->slope;
    double t = piece->begin, u = piece->u;
    if (rate == INFINITY) s->z = u, s->dz[1] = 0.0;
    for (;;) {
        const double gap = u - s->z;
        if (gap == 0.0 && fabs(su) <= rate) {
            const double time = piece->end - t;
            const double by[MOST_PARAMETERS] = {0.0, s->dz[1]}, by_slope[MOST_PARAMETERS] = {0.0, -s->dz[1] / time};
            add_cell(s, t, u, su, by, by_slope);
            memset(s->dz, 0, sizeof s->dz);
            s->z = piece->u_end;
            return;
        }
        const double side = copysign(1.0, gap != 0.0 ? gap : su), slope = side * rate, closing = rate - side * su;
        const double by_slope[MOST_PARAMETERS] = {-slope * rate};
        const double time = closing > 0.0 ? fmin(fabs(gap) / closing, piece->end - t) : piece->end - t;
        add_cell(s, t, s->z, slope, s->dz, by_slope);
        for (int j = 0; j < MOST_PARAMETERS; j++) s->dz[j] += by_slope[j] == 0.0 ? 0.0 : by_slope[j] * time;
        if (t + time >= piece->end) {
            s->z += slope * time;
            return;
        }
        /* it meets the input, at a time that moves with what the output was */
        const double after = fabs(su) <= rate ? su : copysign(rate, su);
        for (int j = 0; j < MOST_PARAMETERS; j++) s->dz[j] *= after == su ? 0.0 : 1.0 + (slope - after) / (su - slope);
        t += time, u += su * time, s->z = u;
    }
}

/* A share of the input rests until the rest of the play is used up, and is pushed along from there. */
static void play(Scan *s, const Piece *piece)
{
    const double share = s->p[0], width = s->p[1], su = piece->slope, gap = piece->u - s->z;
    if (fabs(gap) > width) { /* what lies beyond is pushed at once */
        s->z = piece->u - copysign(width, gap);
        s->dz[0] = s->dz[2] = 0.0, s->dz[1] = -copysign(1.0, gap);
    }
    const double side = copysign(1.0, su), within = piece->u - s->z;
    const double time = su != 0.0 ? fmax(width - side * within, 0.0) / fabs(su) : INFINITY;
    if (time > 0.0) {
        const double by[] = {share * s->dz[0] - within, share * s->dz[1], share * s->dz[2]};
        add_cell(s, piece->begin, piece->u - share * within, su * (1.0 - share), by, (const double[]){-su, 0.0, 0.0});
    }
    if (piece->begin + time >= piece->end) return;
    const double by[] = {-side * width, -side * share, 0.0};
    add_cell(s, piece->begin + time, piece->u + su * time - share * side * width, su, by, (const double[]){0.0, 0.0, 0.0});
    s->z = piece->u_end - side * width;
    s->dz[0] = s->dz[2] = 0.0, s->dz[1] = -side;
}

/* Value of a recorded signal in the interval that begins with sample k, or before the first. */
static double value_in(const Signal *s, int64_t k, double time)
{
    if (k < 0 || k + 1 >= s->count || !s->linear) return s->values[k < 0 ? 0 : k];
    return s->values[k] + (s->values[k + 1] - s->values[k]) * (time - s->time[k]) / (s->time[k + 1] - s->time[k]);
}

/* Fills the cells from a time on, where the law has its start. `p` are its parameters in their order. */
void memory_apply(int kind, const Signal *s, Drive *d, double begin, const double *p, int n)
{
    Scan scan = {.d = d, .p = p};
    int rows = 0;
    for (int j = 0; j < MOST_PARAMETERS; j++) scan.row[j] = j < n && d->column_of[j] >= 0 ? rows++ : -1;
    int64_t k = -1;
    while (k + 1 < s->count && s->time[k + 1] <= begin) k++;
    const int start = kind == RATE_LIMIT ? 1 : 2;
    scan.z = value_in(s, k, begin) + (start < n ? p[start] : 0.0);
    scan.dz[start] = 1.0;
    d->count = 0;
    for (double from = begin; k < s->count; k++) {
        const int last = k + 1 >= s->count;
        const double to = last ? INFINITY : s->time[k + 1], u = value_in(s, k, from);
        const int moves = s->linear && k >= 0 && !last;
        const Piece piece = {from, to, u, moves ? (s->values[k + 1] - s->values[k]) / (s->time[k + 1] - s->time[k]) : 0.0,
                             moves ? s->values[k + 1] : u};
        (kind == RATE_LIMIT ? limit_rate : play)(&scan, &piece);
        from = to;
        if (last) break;
    }
}
