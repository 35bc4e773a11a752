/* One run with sensitivities: forward ones on the steps of the run where the FMU has derivatives and no event moves the
 * states, else by differences of whole runs. */
#include "engine.h"

/* Are the FMU's directional derivatives with respect to every target of the problem right? Tried once. */
static int can_differentiate(Run *r)
{
    Problem *p = r->problem;
    if (fmu_ready(p) != AB_OK || !p->has_directional) return 0;
    for (int64_t i = 0; i < p->n_experiments && p->parameter_directional < 0; i++) {
        Run *other = problem_run(p, i, p->runs_q, p->runs_active);
        if (!other || !derivatives_are_right(other)) p->parameter_directional = 0;
    }
    if (p->parameter_directional < 0) p->parameter_directional = 1;
    return p->parameter_directional;
}

/* One run into the sink, with sensitivities where there are active columns. */
int simulate(Run *r, int mode, const double *noise)
{
    start_time_limit(r);
    probe(r);
    sink_begin(r, mode, noise);
    if (filters(r) && !kalman_open(r)) return AB_SOLVER_FAILED;
    if (!r->q) return run_once(r);
    if (filters(r)) return run_differences(r);
    int outcome = NEED_DIFFERENCES;
    if (can_differentiate(r)) {
        if ((outcome = start_sensitivities(r))) return outcome;
        sink_begin(r, mode, noise);
        outcome = run_once(r);
    }
    if (outcome != NEED_DIFFERENCES) return outcome;
    sink_begin(r, mode, noise);
    return run_differences(r);
}
