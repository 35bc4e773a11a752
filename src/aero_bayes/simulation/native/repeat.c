/* What puts an FMU back to its start before a run: a reset, or only a new instance? Some FMUs report a reset that they do
 * not do, or keep values in memory that all their instances share. So the first run that differs from the one before it
 * is done twice, after a reset and on a new instance; until then every run has a new one. Equal runs that differ even on
 * new instances are no simulation. */
#include "engine.h"

/* FNV-1a of the parameter vector; never 0. */
static uint64_t hash_values(const Run *r)
{
    uint64_t hash = 14695981039346656037ull;
    const unsigned char *byte = (const unsigned char *)r->values;
    for (size_t i = 0; i < sizeof *r->values * (size_t)r->problem->p; i++) hash = (hash ^ byte[i]) * 1099511628211ull;
    return hash | 1;
}

static int attempt(Run *r, int mode, const double *noise, int begin, double *y)
{
    r->problem->fmu->begin = begin;
    r->sink.kept = y;
    const int outcome = simulate(r, mode, noise);
    r->sink.kept = NULL;
    return outcome;
}

/* To what the solver's tolerance leaves open, of each output's range. */
static int agree(const Run *r, const double *a, const double *b)
{
    const int64_t n = r->e->n;
    for (int64_t o = 0; o < r->e->m; o++, a += n, b += n) {
        double low = INFINITY, high = -INFINITY, away = 0.0;
        for (int64_t i = 0; i < n; i++) {
            low = fmin(low, b[i]), high = fmax(high, b[i]);
            away = larger(away, fabs(a[i] - b[i]));
        }
        const double near = (1e-5 + 10.0 * r->rtol) * (high - low) + 1e-9 * larger(fabs(low), fabs(high));
        if (!(away <= near)) return 0;
    }
    return 1;
}

static int compare(Run *r, int mode, const double *noise)
{
    Fmu *f = r->problem->fmu;
    const int once = r->problem->single_instance;
    double *after = calloc((size_t)(2 * r->e->n * r->e->m + 1), sizeof *after), *anew = after + r->e->n * r->e->m;
    if (!after) return AB_SOLVER_FAILED;
    const int reset = attempt(r, mode, noise, BEGIN_RESET, after);
    int outcome = attempt(r, mode, noise, once ? BEGIN_RESET : BEGIN_NEW, anew);
    if (outcome != AB_OK)
        f->begin = BEGIN_UNKNOWN;
    else if (reset == AB_OK && agree(r, after, anew))
        f->begin = BEGIN_RESET;
    else if (once || attempt(r, mode, noise, BEGIN_NEW, after) != AB_OK || !agree(r, after, anew))
        f->begin = BEGIN_NOTHING;
    free(after);
    return f->begin == BEGIN_NOTHING ? AB_NOT_REPEATABLE : outcome;
}

/* One run into the sink, as simulate, whose result does not depend on the runs before it. */
int run_repeatable(Run *r, int mode, const double *noise)
{
    Problem *p = r->problem;
    if (fmu_load(p)) return AB_MODEL_ERROR;
    if (p->fmu->begin == BEGIN_NOTHING) return AB_NOT_REPEATABLE;
    if (p->fmu->begin != BEGIN_UNKNOWN) return simulate(r, mode, noise);
    const uint64_t hash = hash_values(r);
    if (r->values_hash && r->values_hash != hash) return compare(r, mode, noise);
    const int outcome = simulate(r, mode, noise);
    if (outcome == AB_OK) r->values_hash = hash;
    return outcome;
}
