/* What the equations of a coupled FMU are, which is compiled for each form; the rest is the same for all. */
#include "coupler.h"

#ifdef COLUMNS
/* Not of FMI: derivatives of n variables by m others at once, a row for each of the n. All parts have such a function. */
FMI int ab_columns(fmi_component c, const fmi_reference unknown[], size_t n, const fmi_reference known[], size_t m,
                   double out[])
{
    return derivatives_of_all(c, unknown, n, known, m, out);
}
#endif
#ifdef EVENTLESS
/* Not of FMI: tells the engine that the equations hold without events. */
FMI int ab_eventless(void) { return 1; }
#endif
#ifdef LINEAR
/* And that they are linear in states and inputs (1): with 2 added where only those are that are left without operators,
 * with 4 where they are while a law is held on a side. */
FMI int ab_linear(void) { return LINEAR; }
#endif
