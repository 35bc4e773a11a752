/* The functions of FMI 2.0 Model Exchange, as the engine calls them. */
#include "fmu_library.h"

/* Fills f with them; not 0 where the library lacks a function. */
int fmi2_bind(Fmu *f)
{
    int bad = 0;
#define FIND(where, name) bad |= fmu_symbol(f, "fmi2" name, &f->where)
    FIND(instantiate, "Instantiate");
    FIND(free_instance, "FreeInstance");
    FIND(setup, "SetupExperiment");
    FIND(enter_initialization, "EnterInitializationMode");
    FIND(exit_initialization, "ExitInitializationMode");
    FIND(enter_event, "EnterEventMode");
    FIND(enter_continuous, "EnterContinuousTimeMode");
    FIND(reset, "Reset");
    FIND(terminate, "Terminate");
    FIND(get_real, "GetReal");
    FIND(set_real, "SetReal");
    FIND(new_discrete, "NewDiscreteStates");
    FIND(completed, "CompletedIntegratorStep");
    FIND(set_time, "SetTime");
    FIND(set_states, "SetContinuousStates");
    FIND(get_derivatives, "GetDerivatives");
    FIND(get_indicators, "GetEventIndicators");
    FIND(get_states, "GetContinuousStates");
    FIND(get_nominals, "GetNominalsOfContinuousStates");
#undef FIND
    fmu_symbol(f, "fmi2GetDirectionalDerivative", &f->directional);
    fmu_symbol(f, "fmi2GetInteger", &f->get_integer);
    fmu_symbol(f, "fmi2GetBoolean", &f->get_boolean);
    return bad;
}
