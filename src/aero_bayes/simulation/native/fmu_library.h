/* An FMU's library and its functions under the names of FMI 2.0, whichever version of FMI it is of. Types and signatures
 * follow "Functional Mock-up Interface 2.0", sections 2.1 and 3.2: the part of Model Exchange that the engine calls. */
#ifndef AB_FMU_H
#define AB_FMU_H

#include <dlfcn.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

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

/* In place of a parameter of operators: the value on which they act. */
#define OPERATED ((fmi_reference)-1)

/* What puts an FMU back to its start, see run.c. */
enum { BEGIN_UNKNOWN, BEGIN_RESET, BEGIN_NEW, BEGIN_NOTHING };

typedef struct Fmu {
    struct Fmu *next;
    char *path;
    void *library;
    fmi_component instance;
    fmi_callbacks callbacks;
    void *environment; /* FMI 3.0's own functions */
    int used; /* instance needs a reset before the next run */
    int begin;
    int eventless; /* its equations hold without events: an input may jump without event mode */
    int form;      /* of its equations, where it tells (exponential.h) */
    int instantiated, spent; /* it was instantiated and can be no more in this process */
    fmi_component (*instantiate)(const char *, int, const char *, const char *, const fmi_callbacks *, fmi_boolean,
                                 fmi_boolean);
    void (*free_instance)(fmi_component);
    int (*setup)(fmi_component, fmi_boolean, double, double, fmi_boolean, double);
    int (*enter_initialization)(fmi_component), (*exit_initialization)(fmi_component), (*enter_event)(fmi_component);
    int (*enter_continuous)(fmi_component), (*reset)(fmi_component), (*terminate)(fmi_component);
    int (*get_real)(fmi_component, const fmi_reference *, size_t, double *);
    int (*get_integer)(fmi_component, const fmi_reference *, size_t, int *);
    int (*get_boolean)(fmi_component, const fmi_reference *, size_t, fmi_boolean *);
    int (*set_real)(fmi_component, const fmi_reference *, size_t, const double *);
    int (*set_integer)(fmi_component, const fmi_reference *, size_t, const int *);
    int (*set_boolean)(fmi_component, const fmi_reference *, size_t, const fmi_boolean *);
    int (*set_long)(fmi_component, const fmi_reference *, size_t, const int *); /* enumerations of FMI 3.0 */
    int (*new_discrete)(fmi_component, fmi_event_info *);
    int (*completed)(fmi_component, fmi_boolean, fmi_boolean *, fmi_boolean *);
    int (*set_time)(fmi_component, double);
    int (*set_states)(fmi_component, const double *, size_t);
    int (*get_derivatives)(fmi_component, double *, size_t), (*get_indicators)(fmi_component, double *, size_t);
    int (*get_states)(fmi_component, double *, size_t), (*get_nominals)(fmi_component, double *, size_t);
    int (*directional)(fmi_component, const fmi_reference *, size_t, const fmi_reference *, size_t, const double *,
                       double *);
    int (*columns)(fmi_component, const fmi_reference *, size_t, const fmi_reference *, size_t,
                   double *); /* ab_columns of FMUs of our own: derivatives of several by several at once */
    int (*operators_off)(fmi_component, int); /* of coupled models only (laws/native/coupler.h) */
    int (*operator_values)(fmi_component, int, size_t, const double *, double *, size_t, const fmi_reference *,
                           double *);
} Fmu;

static inline int is_error(int status) { return status != FMI_OK && status != FMI_WARNING; }

/* Stores the address of a function of the FMU's library; not 0 where it has none of that name. */
static inline int fmu_symbol(Fmu *f, const char *name, void *where)
{
    void *s = dlsym(f->library, name);
    memcpy(where, &s, sizeof s);
    return s == NULL;
}

/* The functions that both versions of FMI call by the same name, each found by FIND(where, name). */
#define SAME_NAMES \
    FIND(free_instance, "FreeInstance"); \
    FIND(enter_initialization, "EnterInitializationMode"); \
    FIND(exit_initialization, "ExitInitializationMode"); \
    FIND(enter_event, "EnterEventMode"); \
    FIND(enter_continuous, "EnterContinuousTimeMode"); \
    FIND(reset, "Reset"); \
    FIND(terminate, "Terminate"); \
    FIND(completed, "CompletedIntegratorStep"); \
    FIND(set_time, "SetTime"); \
    FIND(set_states, "SetContinuousStates"); \
    FIND(get_indicators, "GetEventIndicators"); \
    FIND(get_states, "GetContinuousStates"); \
    FIND(get_nominals, "GetNominalsOfContinuousStates");

/* bind.c */
Fmu *fmu_open(const char *path, int version, char *error, size_t size);
void fmu_shut(Fmu *);
void fmu_quiet(fmi_environment, const char *name, int status, const char *category, const char *message, ...);

/* fmi3.c */
int fmi3_bind(Fmu *);

#endif
