/* Steps an FMU 2.0 for Co-Simulation and prints its outputs, on any machine.
 * step_fmu LIBRARY GUID STEPS STEP INPUTS REFERENCE... OUTPUTS REFERENCE...: inputs are 1 + sin(3 t) from step to step. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#ifdef _WIN32
#include <windows.h>
#define OPEN(path) ((void *)LoadLibraryA(path))
#define FIND(library, name) ((void *)GetProcAddress((HMODULE)(library), name))
#else
#include <dlfcn.h>
#define OPEN(path) dlopen(path, RTLD_NOW)
#define FIND(library, name) dlsym(library, name)
#endif
#include "fmi2FunctionTypes.h"

static void message(fmi2ComponentEnvironment e, fmi2String name, fmi2Status s, fmi2String kind, fmi2String text, ...) {
    (void)e; (void)name; (void)s; (void)kind;
    fprintf(stderr, "%s\n", text);
}

#define CHECK(call) do { if ((call) > fmi2Warning) { fprintf(stderr, "failed: %s\n", #call); return 3; } } while (0)
#define GET(type, name) type *name = (type *)FIND(library, #name); if (!name) { fprintf(stderr, "no %s\n", #name); return 2; }

int main(int count, char **argument) {
    void *library = OPEN(argument[1]);
    if (!library) { fprintf(stderr, "%s was not loaded\n", argument[1]); return 2; }
    GET(fmi2InstantiateTYPE, fmi2Instantiate)
    GET(fmi2SetupExperimentTYPE, fmi2SetupExperiment)
    GET(fmi2EnterInitializationModeTYPE, fmi2EnterInitializationMode)
    GET(fmi2ExitInitializationModeTYPE, fmi2ExitInitializationMode)
    GET(fmi2SetRealTYPE, fmi2SetReal)
    GET(fmi2GetRealTYPE, fmi2GetReal)
    GET(fmi2DoStepTYPE, fmi2DoStep)
    fmi2CallbackFunctions call = {message, calloc, free, NULL, NULL};
    int steps = atoi(argument[3]), inputs = atoi(argument[5]), outputs = atoi(argument[6 + inputs]);
    double step = atof(argument[4]);
    (void)count;
    fmi2ValueReference in[64], out[64];
    for (int i = 0; i < inputs; i++) in[i] = (fmi2ValueReference)atoi(argument[6 + i]);
    for (int i = 0; i < outputs; i++) out[i] = (fmi2ValueReference)atoi(argument[7 + inputs + i]);
    fmi2Component one = fmi2Instantiate("one", fmi2CoSimulation, argument[2], "", &call, fmi2False, fmi2False);
    if (!one) return 3;
    CHECK(fmi2SetupExperiment(one, fmi2True, 1e-8, 0.0, fmi2False, 0.0));
    CHECK(fmi2EnterInitializationMode(one));
    CHECK(fmi2ExitInitializationMode(one));
    for (int k = 0; k < steps; k++) {
        double u[64], y[64];
        for (int i = 0; i < inputs; i++) u[i] = 1.0 + sin(3.0 * k * step);
        if (inputs) CHECK(fmi2SetReal(one, in, (size_t)inputs, u));
        CHECK(fmi2DoStep(one, k * step, step, fmi2True));
        CHECK(fmi2GetReal(one, out, (size_t)outputs, y));
        for (int i = 0; i < outputs; i++) printf("%.17g ", y[i]);
        printf("\n");
    }
    return 0;
}
