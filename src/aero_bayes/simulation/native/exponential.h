/* Types and functions of the exponential steps (exponential.c, phi.c), which the engine and the co-simulation of exported
 * FMUs share: each has an "engine.h" with its own Run, rhs() and jacobian(). */
#ifndef AB_EXPONENTIAL_H
#define AB_EXPONENTIAL_H

#include <stddef.h>

struct Run;

static inline double larger(double a, double b) { return a > b ? a : b; }

/* Hands out parts of one block of memory, each on a 64-byte line; the first pass (base NULL) only measures. */
typedef struct {
    char *base;
    size_t used;
} Arena;

static inline void *take(Arena *a, size_t count, size_t size)
{
    const size_t at = a->used;
    a->used += (count * size + 127) / 64 * 64;
    return a->base ? a->base + at : NULL;
}

/* Least size of a state of which no nominal value is known: what is smaller may be rounding. */
#define LEAST_SIZE 1e-6

/* Exponential steps (exponential.c). Matrices are n x n by columns of `rows`, vectors of `rows`. */
enum { NODES_X = 3, MOST_TABLES = 6, MOST_INSIDE = 3, MOST_STATES = 32 };
/* Of a model's equations: linear in states and inputs, with constant coefficients (ab_linear() of the FMU), where operators
 * act on its inputs, or where a law is held on a side; or known not to be. */
enum { UNKNOWN_FORM, LINEAR_FORM = 1, WITH_OPERATORS = 2, WITH_RELAY = 4, OTHER_FORM = 8 };
/* How a step tells of itself: its rounds of corrections, or that only its end was looked at, and whether its Jacobian is
 * its own. */
enum { ONLY_END = 7, RENEWED = 8 };

/* A matrix by columns of `rows`, and its derivatives along several parameters: each column is n rows of `ld`. */
typedef struct {
    double *value, *slopes;
} Matrix;

/* A linear system x' = A x; ld is 0 where no derivatives are wanted. */
typedef struct {
    int n, rows, ld;
    Matrix a, work; /* work: eight matrices */
} Linear;

/* What the linear part does up to a fraction of the step. */
typedef struct {
    double theta;
    Matrix transition;       /* e^(theta h A), and the integrals of phi.c behind it */
    Matrix of_slope, of_ramp; /* of a constant slope, and of one that grows from zero by one over the step */
    Matrix of_node[NODES_X]; /* of the remainder at each point */
} Flow;

typedef struct {
    double h;
    Flow node[NODES_X], between, inside[MOST_INSIDE]; /* up to the points, and to samples within the step */
    int n_inside;
    double *of_slope, *of_ramp, *of_nodes; /* the same for all points at once, by columns of all_rows */
} StepTable;

typedef struct {
    void *memory;
    int rows, all_rows, n_tables; /* all_rows: those of a column for all points */
    int known, stale, age; /* of the kept Jacobian; steps since it was taken */
    int linear_model;      /* the last step left no remainder */
    int carried;           /* of a linear model: the slopes of the columns are known from the step before */
    int failed;            /* the last step that was tried, so that the other method took over */
    int corners;           /* steps have failed in this run */
    int rounds, ramps;
    double contraction; /* of the corrections, or -1 */
    double error, worst; /* of the last step; of this segment's */
    int level, since_longer; /* halvings of a segment; segments since fewer were tried */
    Linear system;
    double *b; /* Jacobian by the inputs */
    /* at all points, one behind the other: states, states of the linearisation, remainders; and the same point by point */
    double *points, *linear, *remainders, *x[NODES_X], *d[NODES_X];
    double *x0, *f0, *ramp, *v, *change, *end, *first, *second, *middle, *weight; /* weight: one over the tolerance */
    StepTable table[MOST_TABLES], *now;
    /* sensitivities: is there room for them; have the last ones no remainder; is it left out */
    int columns, linear_columns, bare_columns;
    double *nearness[NODES_X];             /* Jacobian at the points less A */
    double *g[NODES_X], *s_linear[NODES_X]; /* of the points: remainders, columns without them */
    double *s_slope, *s_ramp;              /* their slope at the beginning, and what it grows by with time alone */
} Exponential;

/* phi.c */
void phi_flow(const Linear *, Matrix flow, double h, double theta);
void phi_follow(const Linear *, Matrix to, double a, Matrix first, Matrix then);
Matrix matrix_at(const Linear *, Matrix first, int k);
double phi_norm(const Linear *);

/* exponential.c */
double state_size(const struct Run *, int state, double now);
/* Points of the parabola, and its value at the step's beginning by those at the points. */
static const double point_of[NODES_X] = {1.0 / 6.0, 2.0 / 3.0, 1.0};
static const double at_start[NODES_X] = {1.6, -1.0, 0.4};
#define CLOSE_TO_LINEAR 1e-3 /* a remainder, in units of the tolerance, that does not count */
#define OFF_PARABOLA 0.3     /* error at the end by the parabola's defect at the beginning: at least that of a kink */
int exponential_open(struct Run *);
void exponential_close(Exponential *);
void exponential_begin(struct Run *);
void exponential_ready(struct Run *);
double exponential_step(struct Run *, double span, double left, double *recorded);
Flow *flow_inside(struct Run *, StepTable *, double theta);
void state_at(const struct Run *, const Flow *, double *to);

#endif
