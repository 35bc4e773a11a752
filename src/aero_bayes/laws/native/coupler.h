/* Two FMUs coupled into one FMI 2.0 model: the inner FMU, of which only the binary is known, and the laws around it,
 * compiled from Modelica. Both lie in the resources of the coupled FMU, with coupling.txt, which says which value goes
 * where. The states of the coupled model are those of the inner FMU, then those of the laws.
 *
 * A value reference of the coupled model counts the variables of its description.
 *
 * coupling_file.c reads coupling.txt. coupler.c has instances, modes and values, coupled_equations.c the states, the
 * derivatives and the directional derivatives. */
#ifndef COUPLER_H
#define COUPLER_H

#include <stdarg.h>
#include <stdio.h>

#include "fmu_library.h"

#define FMI __attribute__((visibility("default")))
#define TRY(call)                              \
    do {                                       \
        const int status_ = (call);            \
        if (is_error(status_)) return status_;    \
    } while (0)

enum { INNER, LAWS, PARTS };
enum { STATES_TO_LAWS, LAWS_TO_INPUTS, OUTPUTS_TO_LAWS, TRANSFERS };
enum { STARTING, INITIALIZING, FIRST_EVENTS, RUNNING };

typedef struct {
    Fmu *fmu;
    fmi_component c;
    char *guid, *resources;
    int nx, nz;
    fmi_reference *state;
} Part;

/* Variables of one part whose values are set as variables of the other part. */
typedef struct {
    size_t n;
    fmi_reference *from, *to;
    double *value;
} Transfer;

typedef struct {
    Part part[PARTS];
    Transfer transfer[TRANSFERS];
    size_t n_variables;
    int *owner;               /* by value reference of the coupled model: the part that has the variable */
    fmi_reference *reference; /* and its value reference there */
    int *late_start, *has_late_start; /* inner states whose start value is set once the model runs; if they have one */
    double *late_start_value, *rates;
    int phase, propagated; /* propagated: whether both parts agree at this instant */
} CoupledFmu;

#define IN_BOTH_PARTS(call)                  \
    do {                                     \
        for (int k_ = 0; k_ < PARTS; k_++) { \
            const Part *p = &s->part[k_];    \
            TRY(p->fmu->call);               \
        }                                    \
    } while (0)

/* Reads coupling.txt in a folder and opens both FMUs. Returns 0 if it succeeds. */
int read_coupling(CoupledFmu *s, const char *folder);

/* Evaluates the inner FMU at this instant and passes its values to the laws, unless that is done already. */
int propagate(CoupledFmu *s);

#endif
