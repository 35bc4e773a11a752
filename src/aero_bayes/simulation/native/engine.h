/* Types shared by the engine's files. One idea a file:
 *   problem_file.c reads a problem written by Python (native_simulator.py)
 *   workspace.c    the buffers of a run
 *   bind.c         loads an FMU's binary and finds the functions of FMI 2.0 in it
 *   fmi3.c         the same of FMI 3.0, behind the functions of FMI 2.0
 *   fmu.c          one instance of it, its right-hand side and Jacobian, and its initialisation, to the first sample
 *   probe.c        what an FMU does that its description does not say, and whether its derivatives can be built on
 *   inputs.c       input signals, their delay, and the times at which they break
 *   operators.c    what laws at an input make of its signal
 *   memory.c       the same of laws that remember it
 *   late.c         readings that come late
 *   relay.c        a law that steps by the sign of a speed, held on a side, and rest
 *   rodas.c        the Rosenbrock step, its linear algebra and error estimate
 *   sensitivity.c  forward sensitivities on the same steps
 *   exponential.c  steps with an exact linear part, where the input moves at each sample
 *   columns.c      and the sensitivities over them
 *   phi.c          and their matrices
 *   events.c       event iteration, indicators and their roots
 *   step.c         the steps of a segment between two jumps or events, with error control
 *   run.c          one simulation from initialisation to the last sample, with what happens between two segments
 *   differences.c  sensitivities by internal numerical differentiation, for FMUs without derivatives
 *   sink.c         samples of the outputs, and where they go: a trajectory, or a likelihood with its noise filter
 *   kalman.c       the extended Kalman filter of a model with process noise
 *   batch.c        many runs, handed out from a shared counter, and what a worker tells of its progress
 *   kernels.c      the vector loops
 *   confine.c      what a worker gives up before it loads a model */
#ifndef AB_ENGINE_H
#define AB_ENGINE_H

#include <math.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "exponential.h"
#include "fmu_library.h"

/* The numbers of interface.Outcome. */
enum {
    AB_OK, AB_SOLVER_FAILED, AB_NOT_FINITE, AB_TIMED_OUT, AB_CRASHED, AB_MODEL_ERROR, AB_STATES_ANEW, AB_NOT_REPEATABLE,
    AB_STATES_JUMP, AB_TOO_SLOW
};

enum {
    TARGET_NONE, TARGET_PARAMETER, TARGET_START, TARGET_DELAY, TARGET_DIFFUSION, TARGET_READING_NOISE
};
enum {
    MODE_TRAJECTORY, MODE_LIKELIHOOD,
    MODE_FILTER, MODE_FILTER_LIKELIHOOD, MODE_FILTER_STATES /* with process noise */
};

#define EXPORT __attribute__((visibility("default")))
#define LOG_2PI 1.8378770664093454836
#define BLOCK 256 /* samples held back before a sink sees them */

typedef struct {
    fmi_reference reference;
    int linear; /* 0 hold, 1 linear */
    int kind;   /* 0 real, 1 integer, 2 boolean, 3 integer of 64 bits */
    int operator; /* that acts on it first, or -1 */
    int64_t count;
    const double *time, *values;
    int64_t n_breaks; /* grid indices at which the signal breaks */
    int64_t *breaks;
} Signal;

typedef struct {
    int kind;
    int64_t a;
    double scale; /* a natural size of the column, for differences */
} Target;

/* Laws that act on an input or on an output one after the other, by the parameters that they have in the model. */
typedef struct {
    int chain; /* its number in the FMU */
    int memory; /* of a law that remembers its input, which kind it is */
    int64_t n;
    fmi_reference *reference;
} Operator;

/* A signal as an operator leaves it: lines in cells, the first of which lasts until the signal begins. */
typedef struct {
    double *memory;
    int64_t count, room; /* cells; and for how many there is room */
    double *time, *value, *slope; /* of each cell, at its beginning */
    double *key;    /* parameters for which they hold, and when a law with a memory starts, */
    int holds;      /* if this is not 0; more than 1 where the derivatives hold too */
    int lines;      /* they are in place of something that bends */
    int *column_of; /* of each parameter, or -1 */
    double **by;    /* by each parameter that has a column: values, then slopes of all cells */
    double *by_now; /* the same while outputs are read */
} Drive;

/* Does a column delay this signal? Its a is the signal's index, or negative for all of them. */
static inline int delays(const Target *t, int signal)
{
    return t->kind == TARGET_DELAY && (t->a < 0 || t->a == signal);
}

typedef struct {
    int64_t n, m;
    const double *time;
    const double *measured; /* m rows of n, or NULL */
    const double *spread;   /* m rows of n: sd of each reading's noise over that of its output; or NULL for one */
    const double *reading_sd, *start_sd; /* of each output and of each initial value, with process noise */
    double spacing;         /* uniform sample time, or 0 */
    fmi_reference *output_reference;
    int *output_kind;  /* 0 real, 1 integer, 2 boolean */
    int *output_state; /* index of the state that the output is, or -1 */
    int *output_operator; /* that acts on what is read of it, or -1 */
    int n_other;       /* outputs that must be asked of the FMU */
    int n_late;        /* outputs that come late */
    int n_signals;
    Signal *signals;
    int n_start;
    const int64_t *start_state;
    const double *start_value;
    int64_t n_known; /* parameters that are known in this run */
    fmi_reference *known_reference;
    const double *known_value;
    Target *targets; /* one a column */
    int64_t most_breaks; /* where operators act */
    int64_t n_breaks, most_steps; /* steps that a run may take, or 0 for as many as it needs */
    signed char *start_matters; /* per column: whether x(t0) depends on it; -1 not known yet */
} Experiment;

/* A law that steps by the sign of a speed, a sum of states; without states there is none. */
typedef struct {
    int n;
    int *state;
    fmi_reference *rate; /* the derivative of each */
    const double *gain;
    fmi_reference held, direction; /* inputs of the law: is its step held, and at which value */
} Relay;

typedef struct {
    void *map; /* the mapped spec file */
    struct Owned *owned; /* memory that is freed with the problem */
    size_t map_size;
    const char *library, *resources, *guid, *name;
    int version; /* of FMI */
    int has_directional, step_callback;
    int single_instance; /* it can be instantiated only once in a process */
    int n, nz; /* states, event indicators */
    fmi_reference *state_reference, *derivative_reference;
    int *state_settable; /* its start value may be set before initialisation */
    int n_colors;
    int *color;                  /* of each state */
    int *column_start, *row;     /* sparsity of df/dx by columns */
    int parameter_directional;   /* -1 not tried, 0 refused, 1 accepted */
    int probed, derivatives_first; /* nothing may be read before the derivatives */
    int64_t n_fixed;
    fmi_reference *fixed_reference;
    const double *fixed_value;
    const double *diffusion; /* of each state, where there is process noise */
    double rtol, atol, time_limit;
    int64_t max_steps;
    int64_t n_operators, n_driving; /* the first of them act on recorded inputs */
    int delays;             /* one of them delays a reading */
    Operator *operators;
    Relay relay;
    int64_t p, n_experiments;
    Experiment *experiments;
    Fmu *fmu;
    char load_error[512]; /* why the library could not be loaded */
    struct Run **runs; /* buffers of the last batch, one an experiment */
    int64_t runs_q, *runs_active;
} Problem;

/* An output that shows a state as it was before a delay. */
typedef struct {
    int64_t output, next; /* its next sample that is not known yet */
    int column;           /* of the delay, or -1 */
    double delay, *y, *s; /* values of all samples, and their derivatives */
} Late;

/* One output's noise, as the filter needs it. */
typedef struct {
    double white, stationary, tau; /* variances and s */
    double phi;                    /* exp(-spacing / tau) on a uniform grid */
    double p_steady;               /* steady prior variance of the coloured part */
    double mean, variance;         /* predicted state of the coloured part */
    int steady, first;
    double last_time, last_dt, last_phi;
} Filter;

typedef struct {
    int mode;
    const Experiment *e;
    int q, ld; /* active columns, padded leading dimension */
    int64_t filled, first; /* block: count, index of its first sample */
    double *y;             /* m x BLOCK */
    double *s;             /* m x BLOCK x ld */
    double *trajectory, *sensitivity;
    double *kept; /* m x n outputs kept beside, or NULL */
    Filter *filter;
    double cost, log_det;
    double *residual, *gain, *decay, *weight;
} Sink;

/* A matrix by rows without its zeros; for factors the rows of L, then those of U, the diagonal's reciprocals apart. */
typedef struct {
    int n, pivoted;
    int *start, *col;
    double *val, *diagonal;
} Sparse;

typedef struct {
    double time;
    int jump; /* a held value changes here (else only a slope) */
} Break;

/* Mean and covariance of the states; the mean is r->x. Matrices are n x n by rows. */
typedef struct {
    double *memory;
    double *p, *f;                /* covariance, transition since the last sample */
    double *phi, *q;              /* of one step */
    double *middle, *end;         /* Jacobians */
    double *omega, *noise, *term, *work, *power, *part, *spare;
    double *drift;                /* of one step: what a constant slope of one adds to the states, over its length */
    double *last_omega, *last_noise; /* exponents of the last transition */
    double *rate;                 /* variance that each state gains in a second */
    double *x, *before, *gain, *slope;
    double *variance, *y, *h;     /* of the readings, outputs and their slopes by the states (m x n) */
    double log_likelihood;
    double reach;  /* steps of the linearisation are not tried beyond */
    int begun;     /* there is a last transition */
} Kalman;

/* Everything one run needs; buffers are allocated once for a problem's experiment and reused. */
typedef struct Run {
    Problem *problem;
    Experiment *e;
    Fmu *fmu;
    uint64_t values_hash; /* of its last parameter vector, 0 for none */
    const double *values; /* a parameter vector, or NULL for the model's own */
    int n, nz, status, mode, form;
    double rtol, atol;
    Kalman *kalman; /* of modes with process noise */
    Exponential *exponential;
    /* the step */
    double t, t_end, resolution;
    double *x, *x1, *f, *f1, *ft, *u, *r, *derivatives_unused, *nominal, *largest, *jac, *lu, *k, *dense;
    int *pivot;
    Sparse factors;
    double *seed, *column, *columns, *start_value;
    fmi_reference *seed_reference, *start_reference;
    int *known_column; /* of each variable by which derivatives are asked for: a column, or -1 less a signal */
    double *z0, *z1, *z2, *z_try, next_event;
    int time_dependent, events_seen, nominals_changed;
    int relay; /* what a law held on a side does */
    double side, share;
    int64_t taken, rejected;
    int64_t deadline, earliest; /* in this thread's computing time, and by the clock: no sooner */
    /* inputs */
    double *delay, *u_before; /* of each signal; its value before a jump */
    int64_t *cell;
    double *u0, *slope, u_time, *u_now; /* value and slope of each signal in this segment */
    fmi_reference *u_reference, *u_real; /* of each signal, and of the real ones */
    int any_slope, any_linear;
    double at; /* time at which the FMU stands */
    int exact; /* inputs are what the law gives, not the lines in their place */
    Drive *drive; /* of each signal, where there are operators */
    double **row_of; /* of each signal and column: its derivatives, or NULL */
    Break *breaks;
    int64_t n_breaks, next_break;
    /* sensitivities: rows of ld */
    int q, ld, sensitive, begins_sensitive;
    const int64_t *active;
    Target *column_target;
    double *s, *s1, *sv, *su, *sdense, *s0;
    double *a_node, *b_node, *b_now, *g_dot, *a_packed;
    double *s_largest; /* the largest that each column has been */
    Sparse a_now;
    /* samples */
    Late *late;
    double *late_y, *late_s;
    int64_t sample;
    Sink sink;
    double *other, *fraction;
    int64_t piece; /* samples that are tried at once with a polynomial */
    double *piece_y, *piece_s;
    int64_t n_other; /* real outputs that are no states */
    fmi_reference *other_reference;
    /* recorded steps, for internal numerical differentiation */
    int record, replay;
    double *steps;
    int64_t n_steps, cap_steps, at_step;
    double *event_times; /* of state events */
    int64_t n_events, cap_events;
    void *memory;
} Run;

/* problem_file.c */
Problem *problem_open(const char *path, char *error, size_t size);
void problem_close(Problem *);
void *own(Problem *, int64_t count, size_t size);

/* fmu.c */
int fmu_load(Problem *);
int fmu_ready(Problem *);
int outcome_of(Fmu *, int status);
int rhs(Run *, double t, const double *x, double *f);
int set_point(Run *, double t, const double *x);
int jacobian(Run *, double t, const double *x, const double *f, double *jac);
int plain_columns(Run *, const fmi_reference *unknown, size_t n, const fmi_reference *known, size_t m, double *out);
int derivative_columns(Run *, const fmi_reference *unknown, size_t n, const fmi_reference *known, size_t m, double *out);
int directional_column(Run *, fmi_reference known, double *column);
int initialise(Run *);
int read_nominals(Run *);

/* inputs.c */
void inputs_delay(Run *);
void inputs_prepare(Run *);
int inputs_pass(Run *, int *kink);
void inputs_enter(Run *, double t);
double inputs_before(const Run *, int signal);
int inputs_exact(Run *, double t);
int inputs_as_lines(Run *);
double input_by(const Run *, int signal, int column);
int inputs_apply(Run *, double t);
int inputs_jump(Run *, double t);

/* operators.c */
int operators_open(Run *);
static inline int64_t operator_room(const Signal *s) { return 2 * s->count + 2; }
void operators_close(Run *);
int operators_apply(Run *, int with_columns);
int operators_at(Run *, int signal, double time, double *value, double *slope, double *by);
int acts_apart(const Problem *, const Target *);
int operators_on_outputs(Run *);
/* Are lines in place of what an operator makes of a signal? */
static inline int has_lines(const Run *r, int i) { return r->drive && r->drive[i].lines; }
static inline int is_driven(const Run *r, int signal) { return r->drive && r->drive[signal].count > 0; }

/* memory.c */
enum { WITHOUT_MEMORY, RATE_LIMIT, PLAY, DELAY };
void memory_apply(int kind, const Signal *, Drive *, double begin, const double *parameters, int n);

/* late.c */
static inline int comes_late(const Problem *p, const Experiment *e, int64_t output)
{
    return e->output_operator[output] >= 0 && p->operators[e->output_operator[output]].memory == DELAY;
}
int late_begin(Run *);
Late *late_due(Run *, double limit, double *time);
void late_emit(Run *, double h, double limit);
int late_emit_here(Run *, Late *, double time);
void late_to_sink(Run *);

/* relay.c */
enum { RELAY_FREE, RELAY_SLIDES, RELAY_RESTS };
static inline int relay_is_held(const Problem *p) { return p->relay.n && p->fmu->eventless && p->has_directional; }
int relay_begin(Run *);
int relay_settle(Run *);
int relay_columns(Run *, const fmi_reference *unknown, size_t n, const fmi_reference *known, size_t m, double *out);
double relay_margin(const Run *, const double *x);
int relay_columns_begin(Run *);
int relay_jump(Run *);
int relay_turn(Run *);
int relay_turns(const Run *, double *const *x);

/* rodas.c */
enum { STAGES = 8 };
typedef struct {
    double gamma;
    double a[STAGES][STAGES], c[STAGES][STAGES], alpha[STAGES], d[STAGES], H[3][STAGES];
} Method;
extern const Method rodas5p;
double rodas_step(Run *, double h, const double *ft);
void continuous_extension(double *c, int64_t stride, const double *x, const double *x1, const double *k, int64_t count);
double scaled_norm(const Run *, const double *v, const double *x, const double *x1);
double first_step(Run *, double limit);

/* sensitivity.c */
int sensitivity_begin(Run *);
int delay_jump(Run *, int *);
int sensitivity_node(Run *, int node, double t, const double *x, const double *jac);
int moving_variables(Run *, int known);
void add_moving(const Run *, const double *by, int count, double *row);
int sensitivity_slopes(Run *, double *b);
double sensitivity_error(Run *, const double *v);
double sensitivity_step(Run *, double h, double root);

/* events.c */
int event_iterate(Run *);
int indicators(Run *, double t, const double *x, double *z);
int crossed(const double *z0, const double *z1, int nz);
double find_event(Run *, double h);
void remember_event(Run *);

/* sink.c */
enum { PIECE_POINTS = 11 };
int read_values(Run *, double t, const double *x, double *y, int64_t stride);
void sink_begin(Run *, int mode, const double *noise);
int emit_until(Run *, double h, double limit, int inclusive);
int sink_flush(Run *);
void sink_pass_on(Run *);

/* kalman.c */
static inline int filters(const Run *r) { return r->mode >= MODE_FILTER; }
int kalman_open(Run *);
void kalman_close(Kalman *);
int64_t kalman_width(const Experiment *, int n, int mode);
void kalman_begin(Run *);
double kalman_next(const Run *);
int kalman_step(Run *, double h, double fraction);
int kalman_linearised(Run *, double h, int forced);
void kalman_advance(Run *, double h);
int kalman_read(Run *, int *finite);

/* Do inputs move at each sample, or nearly so? */
static inline int moves_at_samples(const Experiment *e) { return e->n_breaks * (MOST_INSIDE + 1) >= e->n; }

/* Of the equations that are left where operators act and a law is held. */
static inline int form_of(const Problem *p)
{
    const int form = p->fmu->form;
    if ((form & WITH_OPERATORS && !p->n_driving) || (form & WITH_RELAY && !relay_is_held(p))) return OTHER_FORM;
    return form & LINEAR_FORM ? LINEAR_FORM : form;
}

/* Are exponential steps tried? Of a linear model also from sample to sample of a uniform grid while inputs rest. */
static inline int may_be_exponential(const Problem *p, const Experiment *e)
{
    return p->n <= MOST_STATES && (moves_at_samples(e) || (form_of(p) == LINEAR_FORM && e->spacing > 0.0));
}

/* columns.c */
int columns_renew(Run *);
double columns_step(Run *);
void columns_at(const Run *, const Flow *, double *s);

/* step.c */
typedef struct {
    double end;        /* of the segment */
    double begin;
    double h;          /* size of the next step */
    int fresh;         /* no step size is known */
    int have_f, have_jac, have_node;
    int event;         /* a state or step event ended the segment early */
    int asked;         /* a step event: the FMU asked for it after a step */
    int idle;          /* and nothing came of it */
} Segment;
void note_sizes(Run *);
void remember_step(Run *, double fraction);
int exceeds_limits(Run *);
int integrate_segment(Run *, Segment *);

/* run.c */
int run_once(Run *);
int run_repeatable(Run *, int mode, const double *noise);

/* probe.c */
int derivatives_are_right(Run *);
void probe(Run *);

/* differences.c */
int own_values(Run *, double *trial);
int start_sensitivities(Run *);
int run_differences(Run *);

/* workspace.c */
Run *run_open(Problem *, Experiment *, int q, const int64_t *active);
void run_close(Run *);
Run *problem_run(Problem *, int64_t experiment, int64_t q, const int64_t *active);
void problem_close_runs(Problem *);

/* batch.c */
int64_t now_ns(void);    /* by the clock on the wall */
int64_t thread_ns(void); /* computed by this thread */
void start_time_limit(Run *);

/* kernels.c */
void kernel_horner(const double *c, int stride, const double *fraction, int64_t count, double *out);
void kernel_combine(double *out, const double *base, const double *w, int terms, const double *v, int64_t stride,
                    int64_t count);
void kernel_multiply(double *out, const Sparse *a, const double *s, int64_t q, int64_t ld);
void kernel_solve(const Sparse *lu, const int *pivot, double *b, int64_t q, int64_t ld);
void kernel_dense_rows(double *out, const double *c, int64_t stride, const double *fraction, int64_t count, int64_t q,
                       int64_t ld);
int64_t kernel_residual(const double *y, const double *measured, int64_t count, double *r);
double kernel_square(const double *r, int64_t count);
double kernel_colour(double *r, int64_t count, const double *gain, const double *decay, const double *weight,
                     double mean);
void kernel_product(double *c, const double *a, const double *b, int n);
void kernel_apply(double *out, const double *m, const double *v, int n, int rows);
void kernel_apply_rows(double *out, const double *m, const double *s, int n, int rows, int64_t q, int64_t ld);

#endif
