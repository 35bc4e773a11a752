/* What a generated model gives to the FMI 2.0 runtime: sizes, where each group of values lies, and functions.
 *
 * Value references index the group R: states, derivatives, inputs, free parameters, dependent parameters, outputs.
 * The Jacobian is dense, by columns: inputs and states in JX, free parameters in JP; what is structurally zero is
 * never written. W are the unknowns of algebraic loops, D the discrete values (conditions of when clauses last).
 */
#ifndef AERO_BAYES_MODEL_H
#define AERO_BAYES_MODEL_H
#include <math.h>

enum Group { R, K, W, D, PRE, REL, ROUND, SAMPLE, LAST, INITIAL, STARTED, JX, JP, JW, FW, FX, FP, DIFF, TICK, DUE, SLOPE, START,
             RISE, RISE_RATE, RISE_X, RISE_P, SIDES, ACROSS, SHARE, CONTACT, NEAR, GROUPS };

typedef struct Model {
    double time, tolerance, step, next_event, evaluated_at;
    int fresh, phase, failed;
    int evaluations, input_jumped; /* instants at which the derivatives were asked for since an input moved */
    double data[];
} Model;

typedef struct {
    int first, n;
    void (*residual)(const Model *m, double *f, double *j); /* j by columns, cleared before */
    int linear; /* in its unknowns */
} Block;

typedef struct {
    const char *guid;
    int nx, nu, np, nq, ny, nw, nd, conditions, relations, roundings, samples, blocks, surfaces, assertions, time_varying, size;
    int at[GROUPS];
    const double *nominal;
    const unsigned char *below, *timed; /* of relations: which side of zero they hold on; known in advance */
    const int *surface;          /* of relations: the surface that they change on, or -1 */
    const unsigned char *above;  /* of relations: whether they hold where the surface's difference is positive */
    const unsigned char *instant; /* of discrete values: whether they follow from relations of the same instant */
    const Block *block;
    Block initial; /* initial equations in START, copies of the values at initial_at */
    const int *initial_at;
    const char *const *message;
    void (*set_defaults)(Model *m);
    void (*start)(Model *m);
    void (*k)(Model *m);
    void (*dx)(Model *m);
    void (*y)(Model *m);
    void (*jx)(Model *m);
    void (*jp)(Model *m);
    void (*jw)(Model *m);   /* JW, FW and FX */
    void (*fp)(Model *m);
    void (*discrete)(Model *m); /* D anew */
    int (*reinit)(Model *m);    /* states anew; whether any is */
    void (*watch)(Model *m);    /* DIFF: differences of relations, arguments of roundings */
    void (*times)(Model *m);    /* TICK: start and interval of samples; DUE, SLOPE: instants of timed relations */
    void (*rise)(Model *m);     /* RISE: how fast the surfaces' differences grow, by the derivatives in R */
    void (*rise_slopes)(Model *m); /* its derivatives by these, by states and inputs, and by parameters */
    int (*violated)(Model *m, unsigned char *bad);
} Info;

extern const Info model_info;

/* Sizes of the model, and the value references that its groups of variables begin at. */
#define INFO model_info
#define MODEL_SIZE (sizeof(Model) + sizeof(double) * INFO.size)
#define NX INFO.nx
#define NXX (INFO.nx + 1)
#define AT_DX (unsigned)INFO.nx
#define AT_U (2 * AT_DX)
#define AT_P (AT_U + INFO.nu)
#define AT_Q (AT_P + INFO.np)
#define AT_Y (AT_Q + INFO.nq)
#define NREAL (AT_Y + INFO.ny)
#define NROW (INFO.nx + INFO.ny + INFO.nq)

static inline double *group(Model *m, enum Group g) { return m->data + INFO.at[g]; }
#endif
