/* An FMU's library and its functions under the names of FMI 2.0, whichever version of FMI it is of. */
#ifndef AB_FMU_H
#define AB_FMU_H

#include <dlfcn.h>
#include <stdlib.h>
#include <string.h>

#include "fmi2.h"

/* What puts an FMU back to its start, see repeat.c. */
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
    int instantiated, spent; /* it was instantiated and can be no more in this process */
    fmi_instantiate instantiate;
    fmi_free_instance free_instance;
    fmi_setup setup;
    fmi_plain enter_initialization, exit_initialization, enter_event, enter_continuous, reset, terminate;
    fmi_get_real get_real;
    fmi_get_integer get_integer, get_boolean;
    fmi_set_real set_real;
    fmi_new_discrete new_discrete;
    fmi_completed completed;
    fmi_set_time set_time;
    fmi_set_vector set_states;
    fmi_get_vector get_derivatives, get_indicators, get_states, get_nominals;
    fmi_directional directional;
} Fmu;

static inline int is_error(int status) { return status != FMI_OK && status != FMI_WARNING; }

/* Stores the address of a function of the FMU's library; not 0 where it has none of that name. */
static inline int fmu_symbol(Fmu *f, const char *name, void *where)
{
    void *s = dlsym(f->library, name);
    memcpy(where, &s, sizeof s);
    return s == NULL;
}

/* bind.c */
Fmu *fmu_open(const char *path, int version, char *error, size_t size);
void fmu_shut(Fmu *);
void fmu_quiet(fmi_environment, const char *name, int status, const char *category, const char *message, ...);

/* fmi2.c */
int fmi2_bind(Fmu *);

/* fmi3.c */
int fmi3_bind(Fmu *);

#endif
