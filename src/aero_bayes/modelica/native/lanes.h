/* The model's equations over several parameter vectors ("lanes") at a time: what a generated model exports beside FMI's
 * functions. Arrays are [index][lane] with AB_LANES lanes. A lane's results do not depend on its neighbours. */
#ifndef AERO_BAYES_LANES_H
#define AERO_BAYES_LANES_H

enum { AB_LANES_VERSION = 2, AB_LANES = 8 };
enum { AB_BASELINE, AB_AVX2 }; /* instruction sets; AB_AVX2 has fused multiply-add too */

/* Of k (constants of a lane: its parameters and what depends on these alone), time, inputs and states; of the first
 * `lanes` lanes, four or eight. */
typedef void lane_function(int lanes, const double *k, const double *time, const double *u, const double *x, double *out);

typedef struct {
    int version, lanes;
    int nx, nu, constants, ny;
    unsigned first_input, first_output; /* value references of the inputs and of the outputs that are no states */
    int time_varying;                   /* the derivatives depend on time itself */
    lane_function *derivatives;
    lane_function *jacobian; /* df/dx by rows; what is structurally zero is not written */
    lane_function *outputs;
} LaneTable;

/* ``const LaneTable *ab_lanes(int instruction_set)``: NULL where the library has none of it.
 * ``int ab_lanes_constants(void *instance, double *k)``: the constants of one instance, after initialisation. */
typedef const LaneTable *ab_lanes_function(int instruction_set);
typedef int ab_lanes_constants_function(void *instance, double *k);

#endif
