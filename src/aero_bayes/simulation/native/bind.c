/* An FMU's library and its functions, FMI 2.0 or 3.0 alike. The FMUs that put laws around another one are made of this
 * file too (laws/native/coupler.c). */
#include <stdio.h>

#include "fmu_library.h"

void fmu_quiet(fmi_environment e, const char *name, int status, const char *category, const char *message, ...)
{
    (void)e, (void)name, (void)status, (void)category, (void)message;
}

/* The functions of FMI 2.0 into f; not 0 where the library lacks one. */
static int fmi2_bind(Fmu *f)
{
    int bad = 0;
#define FIND(where, name) bad |= fmu_symbol(f, "fmi2" name, &f->where)
    SAME_NAMES
    FIND(instantiate, "Instantiate");
    FIND(setup, "SetupExperiment");
    FIND(get_real, "GetReal");
    FIND(set_real, "SetReal");
    FIND(new_discrete, "NewDiscreteStates");
    FIND(get_derivatives, "GetDerivatives");
#undef FIND
    fmu_symbol(f, "fmi2GetDirectionalDerivative", &f->directional);
    fmu_symbol(f, "ab_columns", &f->columns);
    fmu_symbol(f, "fmi2GetInteger", &f->get_integer);
    fmu_symbol(f, "fmi2GetBoolean", &f->get_boolean);
    fmu_symbol(f, "fmi2SetInteger", &f->set_integer);
    fmu_symbol(f, "fmi2SetBoolean", &f->set_boolean);
    return bad;
}

/* Why the library could not be loaded, without its own path, which is that of a temporary copy. */
static void describe_load_error(const Fmu *f, int version, char *error, size_t size)
{
    const char *why = f->library ? NULL : dlerror();
    const size_t length = strlen(f->path);
    if (!why)
        snprintf(error, size, "it lacks functions that FMI %d requires", version);
    else
        snprintf(error, size, "%s", strncmp(why, f->path, length) || why[length] != ':' ? why : why + length + 2);
}

/* NULL where the library cannot be loaded or lacks a function; then `error` tells why. */
Fmu *fmu_open(const char *path, int version, char *error, size_t size)
{
    Fmu *f = calloc(1, sizeof *f);
    if (!f) return NULL;
    f->path = strdup(path);
    f->library = dlopen(path, RTLD_NOW | RTLD_LOCAL);
    if (f->library && !(version == 3 ? fmi3_bind(f) : fmi2_bind(f))) return f;
    describe_load_error(f, version, error, size);
    fmu_shut(f);
    return NULL;
}

void fmu_shut(Fmu *f)
{
    if (f->library) dlclose(f->library);
    free(f->environment);
    free(f->path);
    free(f);
}
