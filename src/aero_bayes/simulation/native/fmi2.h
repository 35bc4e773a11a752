/* The part of the FMI 2.0 C interface (Model Exchange) that the engine calls.
 * Types and signatures follow "Functional Mock-up Interface 2.0", sections 2.1 and 3.2. */
#ifndef AB_FMI2_H
#define AB_FMI2_H

#include <stddef.h>

typedef void *fmi_component;
typedef void *fmi_environment;
typedef unsigned int fmi_reference;
typedef int fmi_boolean;

enum { FMI_OK, FMI_WARNING, FMI_DISCARD, FMI_ERROR, FMI_FATAL, FMI_PENDING };
enum { FMI_MODEL_EXCHANGE = 0 };

typedef struct {
    void (*logger)(fmi_environment, const char *, int, const char *, const char *, ...);
    void *(*allocate)(size_t, size_t);
    void (*release)(void *);
    void (*step_finished)(fmi_environment, int);
    fmi_environment environment;
} fmi_callbacks;

typedef struct {
    fmi_boolean new_discrete_states_needed;
    fmi_boolean terminate_simulation;
    fmi_boolean nominals_changed;
    fmi_boolean states_changed;
    fmi_boolean next_event_time_defined;
    double next_event_time;
} fmi_event_info;

typedef fmi_component (*fmi_instantiate)(const char *, int, const char *, const char *, const fmi_callbacks *,
                                         fmi_boolean, fmi_boolean);
typedef void (*fmi_free_instance)(fmi_component);
typedef int (*fmi_setup)(fmi_component, fmi_boolean, double, double, fmi_boolean, double);
typedef int (*fmi_plain)(fmi_component);
typedef int (*fmi_get_real)(fmi_component, const fmi_reference *, size_t, double *);
typedef int (*fmi_get_integer)(fmi_component, const fmi_reference *, size_t, int *);
typedef int (*fmi_set_real)(fmi_component, const fmi_reference *, size_t, const double *);
typedef int (*fmi_new_discrete)(fmi_component, fmi_event_info *);
typedef int (*fmi_completed)(fmi_component, fmi_boolean, fmi_boolean *, fmi_boolean *);
typedef int (*fmi_set_time)(fmi_component, double);
typedef int (*fmi_set_vector)(fmi_component, const double *, size_t);
typedef int (*fmi_get_vector)(fmi_component, double *, size_t);
typedef int (*fmi_directional)(fmi_component, const fmi_reference *, size_t, const fmi_reference *, size_t,
                               const double *, double *);

#endif
