/* Several FMUs coupled into one FMI 2.0 model: a base, and the laws that are attached to it, each an FMU of its own. All
 * lie in the resources of the coupled FMU, with coupling.txt, which says which value goes where (laws/coupled_fmu.py
 * writes it). The states of the coupled model are those of the base, then those of the laws.
 *
 * Values pass through slots: first the inputs of the coupled model, then the base's states, then what transfers get. A
 * transfer gets variables of a part into slots, or sets inputs of a part to sums of slots. They stand in an order in which each finds
 * what it needs; derivatives take the same way by the chain rule. A value reference of the coupled model counts the
 * variables of its description.
 *
 * Laws may act on an input of the coupled model, one on what the other makes of it, and read nothing else: a chain of
 * operators. An importer that knows of it may apply it to the whole signal beforehand and switch it off here
 * (ab_operators_off): the input is then what the laws would make of it, and they have no equations. Likewise laws without
 * states may act on an output: an importer may read what they act on, and apply the chain to all samples. The first law of
 * such a chain may be a delay, for an importer that reads earlier what it acts on.
 *
 * coupling_file.c reads coupling.txt. coupler.c has instances, modes and values, coupled_equations.c the states, the
 * derivatives and the directional derivatives. */
#ifndef COUPLER_H
#define COUPLER_H

#include <stdio.h>

#include "fmu_library.h"

#define FMI __attribute__((visibility("default")))
#define TRY(call)                              \
    do {                                       \
        const int status_ = (call);            \
        if (is_error(status_)) return status_; \
    } while (0)

enum { STARTING, INITIALIZING, FIRST_EVENTS, RUNNING };
enum { AT_OUTPUT = -1, DELAYS_OUTPUT = -2 };

typedef struct {
    Fmu *fmu;
    fmi_component c;
    char *guid, *resources;
    int nx, nz;
    int all_nx; /* its states while it is not switched off */
    int off;
    int ready; /* transfers after which all its inputs are set */
    fmi_reference *state;
    size_t n_given; /* parameters that it has beside those of the coupled model */
    fmi_reference *given;
    double *given_value;
    int n_nominals; /* of its states, where the FMU's own do not count */
    double *nominal;
    size_t n_known, n_own; /* variables by which derivatives are asked for: first those that are seeds themselves */
    fmi_reference *known;
    int *column;  /* of a seed; of an input that is set, where its row of tangents begins */
    double *seed; /* of a seed; of others where all move in one direction */
} Part;

typedef struct {
    int part, sets;
    size_t n;
    fmi_reference *reference;
    int slot;        /* of the first value that it gets */
    int *first;      /* of each input that it sets: its terms */
    int *source;     /* and of each term, the slot */
    double *gain;    /* and the factor */
    double *value;
} Transfer;

typedef struct {
    int slot; /* where its value is, or -1 */
    int n;
    int *part; /* whose variables it stands for */
    fmi_reference *reference;
} Variable;

typedef struct {
    int chain, part, input; /* the chain that it belongs to, its law, and the input of the coupled model, or one of: */
    fmi_reference u, y;
} Operator;

/* Numbers, as many as were needed at once so far. */
typedef struct {
    double *v;
    size_t room;
} Buffer;

typedef struct {
    int n_parts, n_inputs, n_operators, n_slots, n_transfers, n_variables;
    Part *part; /* the base is the first */
    Transfer *transfer;
    Variable *variable;
    Operator *operators;
    double *start;                    /* of the inputs */
    double *slot;
    int width;                        /* directions of derivatives that are found at once */
    Buffer tangent, set, block;       /* derivatives of slots and of inputs that are set, a row each; those of a part */
    int *late_start, *has_late_start; /* states of the base whose start value is set once the model runs; if they have one */
    double *late_start_value, *rates;
    int phase, done, knows_states; /* done: transfers that hold at this instant */
} CoupledFmu;

#define IN_ALL_PARTS(call)                           \
    do {                                             \
        for (int k_ = 0; k_ < s->n_parts; k_++) {    \
            const Part *p = &s->part[k_];            \
            TRY(p->fmu->call);                       \
        }                                            \
    } while (0)

/* Reads coupling.txt in a folder and opens all FMUs. Returns 0 if it succeeds. */
int read_coupling(CoupledFmu *s, const char *folder);

/* Passes values on until so many transfers hold at this instant. */
int propagate(CoupledFmu *s, int transfers);

/* Derivatives of n variables by m others, a row for each of the n. */
int derivatives_of_all(CoupledFmu *s, const fmi_reference unknown[], size_t n, const fmi_reference known[], size_t m,
                       double out[]);

/* Rows of values, or of tangents, of what a transfer would get from a law that is switched off: that of its input. */
void pass_input(const CoupledFmu *s, const Transfer *o, double *to, int width);

#endif
