/* Reads coupling.txt. */
#include "coupler.h"

static char *line(FILE *f)
{
    char *text = NULL;
    size_t size = 0;
    const ssize_t n = getline(&text, &size, f);
    if (n > 0 && text[n - 1] == '\n') text[n - 1] = '\0';
    return n > 0 ? text : NULL;
}

static int number(FILE *f, int *broken)
{
    int v = 0;
    if (fscanf(f, "%d", &v) != 1) *broken = 1;
    return v;
}

static double real(FILE *f, int *broken)
{
    double v = 0.0;
    if (fscanf(f, "%lf", &v) != 1) *broken = 1;
    return v;
}

static int count(FILE *f, int *broken)
{
    const int n = number(f, broken);
    if (n >= 0 && n < 1 << 24) return n;
    *broken = 1;
    return 0;
}

static void read_part(FILE *f, Part *p, const char *folder, int *broken)
{
    char path[4096], error[256];
    const int version = number(f, broken);
    p->nz = count(f, broken);
    p->ready = count(f, broken);
    free(line(f));
    char *library = line(f), *resources = line(f);
    p->guid = line(f);
    *broken |= !library || !resources || !p->guid;
    if (*broken) return;
    snprintf(path, sizeof path, "%s/%s", folder, library);
    p->fmu = fmu_open(path, version, error, sizeof error);
    const size_t size = strlen(folder) + strlen(resources) + 16;
    p->resources = malloc(size);
    /* FMI 3.0 asks for a path that ends in a separator, FMI 2.0 for a URI */
    snprintf(p->resources, size, version == 3 ? "%s/%s/" : "file://%s/%s", folder, resources);
    free(library);
    free(resources);
    *broken |= !p->fmu;
    p->nx = p->all_nx = count(f, broken);
    p->state = calloc((size_t)p->nx + 1, sizeof *p->state);
    for (int i = 0; i < p->nx; i++) p->state[i] = (fmi_reference)number(f, broken);
    p->n_given = (size_t)count(f, broken);
    p->given = calloc(p->n_given + 1, sizeof *p->given);
    p->given_value = calloc(p->n_given + 1, sizeof *p->given_value);
    for (size_t i = 0; i < p->n_given; i++) {
        p->given[i] = (fmi_reference)number(f, broken);
        p->given_value[i] = real(f, broken);
    }
    p->n_nominals = count(f, broken);
    p->nominal = calloc((size_t)p->n_nominals + 1, sizeof *p->nominal);
    for (int i = 0; i < p->n_nominals; i++) p->nominal[i] = real(f, broken);
    *broken |= p->n_nominals && p->n_nominals != p->nx;
}

static void read_transfer(FILE *f, Transfer *o, const CoupledFmu *s, int *broken)
{
    o->part = count(f, broken);
    o->slot = number(f, broken);
    o->sets = o->slot < 0;
    o->n = (size_t)count(f, broken);
    *broken |= o->part >= s->n_parts || (!o->sets && o->slot + (int)o->n > s->n_slots);
    if (*broken) return;
    o->reference = calloc(o->n + 1, sizeof *o->reference);
    o->value = calloc(o->n + 1, sizeof *o->value);
    o->first = calloc(o->n + 1, sizeof *o->first);
    for (size_t i = 0; i < o->n; i++) {
        o->reference[i] = (fmi_reference)number(f, broken);
        if (!o->sets) continue;
        const int begin = o->first[i], end = o->first[i + 1] = begin + count(f, broken);
        o->source = realloc(o->source, sizeof *o->source * (size_t)(end + 1));
        o->gain = realloc(o->gain, sizeof *o->gain * (size_t)(end + 1));
        for (int k = begin; k < end; k++) {
            o->source[k] = count(f, broken);
            o->gain[k] = real(f, broken);
            *broken |= o->source[k] >= s->n_slots;
        }
    }
}

static void read_variable(FILE *f, Variable *v, const CoupledFmu *s, int *broken)
{
    v->slot = number(f, broken);
    v->n = count(f, broken);
    *broken |= v->slot >= s->n_slots;
    v->part = calloc((size_t)v->n + 1, sizeof *v->part);
    v->reference = calloc((size_t)v->n + 1, sizeof *v->reference);
    for (int k = 0; k < v->n; k++) {
        v->part[k] = count(f, broken);
        v->reference[k] = (fmi_reference)number(f, broken);
        *broken |= v->part[k] >= s->n_parts;
    }
}

int read_coupling(CoupledFmu *s, const char *folder)
{
    char path[4096];
    snprintf(path, sizeof path, "%s/coupling.txt", folder);
    FILE *f = fopen(path, "r");
    if (!f) return 1;
    int broken = 0;
    const int n_parts = count(f, &broken);
    s->n_inputs = count(f, &broken);
    s->n_slots = count(f, &broken);
    const int n_transfers = count(f, &broken), n_variables = count(f, &broken);
    s->part = calloc((size_t)n_parts + 1, sizeof *s->part);
    s->transfer = calloc((size_t)n_transfers + 1, sizeof *s->transfer);
    s->variable = calloc((size_t)n_variables + 1, sizeof *s->variable);
    s->slot = calloc((size_t)s->n_slots + 1, sizeof *s->slot);
    s->start = calloc((size_t)s->n_inputs + 1, sizeof *s->start);
    for (int i = 0; i < s->n_inputs; i++) s->start[i] = real(f, &broken);
    for (; s->n_parts < n_parts && !broken; s->n_parts++) read_part(f, &s->part[s->n_parts], folder, &broken);
    const int n = broken || !n_parts ? 0 : s->part[0].nx;
    broken |= !n_parts || s->n_inputs + n > s->n_slots;
    s->late_start = calloc((size_t)n + 1, sizeof *s->late_start);
    s->has_late_start = calloc((size_t)n + 1, sizeof *s->has_late_start);
    s->late_start_value = calloc((size_t)n + 1, sizeof *s->late_start_value);
    s->rates = calloc((size_t)n + 1, sizeof *s->rates);
    for (int i = 0; i < n; i++) s->late_start[i] = number(f, &broken);
    size_t most = 1;
    for (; s->n_transfers < n_transfers && !broken; s->n_transfers++) {
        read_transfer(f, &s->transfer[s->n_transfers], s, &broken);
        most += s->transfer[s->n_transfers].n;
    }
    for (; s->n_variables < n_variables && !broken; s->n_variables++) {
        read_variable(f, &s->variable[s->n_variables], s, &broken);
        most += (size_t)s->variable[s->n_variables].n;
    }
    const int n_operators = count(f, &broken);
    s->operators = calloc((size_t)n_operators + 1, sizeof *s->operators);
    for (; s->n_operators < n_operators && !broken; s->n_operators++) {
        Operator *o = &s->operators[s->n_operators];
        o->chain = count(f, &broken), o->part = count(f, &broken), o->input = number(f, &broken);
        o->u = (fmi_reference)number(f, &broken), o->y = (fmi_reference)number(f, &broken);
        broken |= o->part >= s->n_parts || o->input >= s->n_inputs;
    }
    for (int k = 0; k < s->n_parts; k++) {
        s->part[k].known = calloc(most, sizeof *s->part[k].known);
        s->part[k].column = calloc(most, sizeof *s->part[k].column);
        s->part[k].seed = calloc(most, sizeof *s->part[k].seed);
    }
    fclose(f);
    return broken;
}
