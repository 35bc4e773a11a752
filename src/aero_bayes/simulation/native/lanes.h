/* Several runs at a time, one in each lane of a vector register, for FMUs that carry their equations in this form
 * (modelica/native/lanes.h). Each lane has its own time, step size, error control and inputs; only the arithmetic of a step
 * is shared, so that what a lane computes does not depend on its neighbours. */
#ifndef AB_LANES_ENGINE_H
#define AB_LANES_ENGINE_H

#include "../../modelica/native/lanes.h"
#include "engine.h"

enum { WIDE = AB_LANES };

/* What one lane does; its Run has inputs, samples and the sink, as in a single run. */
typedef struct Lane {
    struct Lanes *all;
    int at;        /* its index */
    Run *run;      /* NULL while it is idle */
    Run **buffers; /* one an experiment */
    double *constants; /* of this lane in every lane of a vector, for outputs that are no states */
    Segment segment;
    int inside, last, stale; /* the segment was entered; the step ends it; the lane has no sound numbers */
    int ended, outcome;
} Lane;

typedef struct LaneKernels LaneKernels;

/* Arrays are [index][lane]. */
typedef struct Lanes {
    Problem *problem;
    const LaneTable *model;
    const LaneKernels *kernels[2]; /* for all lanes, and for the first half of them */
    ab_lanes_constants_function *constants;
    int n, nu, moves; /* states, inputs; the derivatives move with time, or inputs do */
    Lane lane[WIDE];
    void *memory;
    double *k, *u, *u0, *slope, *u_time;
    double *time, *h, *over_h, *later, *error, *growth, *norm;
    double *x, *x1, *f, *ft, *point, *value, *jac, *lu, *inverse, *stage, *dense, *largest, *nominal;
    int64_t *accepted; /* all bits of a lane or none */
    int *pivot, pivoted;
    char *there; /* entries of df/dx and of the factors without exchanges */
    int *lower_start, *lower, *upper_start, *upper; /* columns of the factors' rows without exchanges */
    double *constant; /* of one lane */
    double *output_u, *output_x, *output; /* for outputs that are no states */
    fmi_reference *input_reference;
} Lanes;

/* The vector arithmetic for one instruction set, see lanes.inc. */
struct LaneKernels {
    int lanes;
    void (*inputs)(const Lanes *, const double *time);
    void (*slope_sizes)(Lanes *);
    void (*step)(Lanes *);
    void (*dense)(Lanes *);
    void (*accept)(Lanes *);
};

/* kernels.c */
const LaneKernels *lane_kernels_for(int half);

/* lanes.c */
Lanes *lanes_of(Problem *);
void lanes_close(Lanes *);
Run *lane_buffers(Lanes *, int lane, int64_t experiment);
int lane_begin(Lanes *, int lane, Run *, int mode, const double *noise);
void lanes_advance(Lanes *);
int lane_values(Run *, double t, const double *x, double *y, int64_t stride);

#endif
