/* Reads the problem that native_simulator.py wrote: a stream of 8-byte words, mapped and used in place. The file is our
 * own, in a folder that no model can write to; its magic number changes with its form. */
#include <fcntl.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <unistd.h>

#include "engine.h"

#define SPEC_MAGIC 0x414253504543000CLL

typedef struct Owned {
    struct Owned *next;
} Owned;

typedef struct {
    const char *at;
    int broken; /* the annotations of an FMU cannot be true */
    Problem *problem;
} Reader;

static int64_t integer(Reader *r)
{
    int64_t v;
    memcpy(&v, r->at, 8);
    r->at += 8;
    return v;
}

static double real(Reader *r)
{
    const int64_t bits = integer(r);
    double v;
    memcpy(&v, &bits, 8);
    return v;
}

static const char *text(Reader *r)
{
    const int64_t size = integer(r); /* padded, with its terminating zero */
    const char *s = r->at;
    r->at += size;
    return s;
}

/* The words of an array, and how many there are. */
static const void *array(Reader *r, int64_t *count)
{
    const int64_t size = integer(r);
    const void *p = r->at;
    r->at += 8 * size;
    if (count) *count = size;
    return p;
}

/* The same, NULL where there are none. */
static const double *optional(Reader *r)
{
    int64_t count;
    const double *p = array(r, &count);
    return count ? p : NULL;
}

/* Zeroed memory that goes with the problem; some more than asked for. */
void *own(Problem *p, int64_t count, size_t size)
{
    Owned *block = calloc(1, sizeof *block + (size_t)(count + 1) * size);
    block->next = p->owned;
    p->owned = block;
    return block + 1;
}

static int *integers(Reader *r, int64_t *count)
{
    int64_t size;
    const int64_t *from = array(r, &size);
    int *v = own(r->problem, size, sizeof *v);
    for (int64_t i = 0; i < size; i++) v[i] = (int)from[i];
    if (count) *count = size;
    return v;
}

static fmi_reference *references(Reader *r, int64_t *count) { return (fmi_reference *)integers(r, count); }

/* The uniform sample time, or 0. A rounding of the times to six digits of a step is still called uniform. */
static double uniform(const double *time, int64_t n)
{
    if (n < 3) return 0.0;
    const double dt = (time[n - 1] - time[0]) / (double)(n - 1);
    for (int64_t k = 1; k < n; k++)
        if (fabs(time[k] - time[k - 1] - dt) > 1e-6 * dt) return 0.0;
    return dt;
}

static void find_breaks(Problem *p, Signal *s)
{
    s->breaks = own(p, s->count, sizeof *s->breaks);
    s->n_breaks = 0;
    for (int64_t k = 0; k < s->count; k++) {
        int is = 0;
        if (s->linear && s->count > 1) {
            const double before = k > 0 ? (s->values[k] - s->values[k - 1]) / (s->time[k] - s->time[k - 1]) : 0.0;
            const double after =
                k + 1 < s->count ? (s->values[k + 1] - s->values[k]) / (s->time[k + 1] - s->time[k]) : 0.0;
            is = fabs(after - before) > 1e-9 * (fabs(after) + fabs(before));
        } else if (!s->linear)
            is = k > 0 && s->values[k] != s->values[k - 1];
        if (is) s->breaks[s->n_breaks++] = k;
    }
}

static void read_experiment(Reader *r, Experiment *e, int64_t p)
{
    int64_t count;
    e->time = array(r, &e->n);
    e->spacing = uniform(e->time, e->n);
    e->output_reference = references(r, &e->m);
    e->output_kind = integers(r, NULL);
    e->output_state = integers(r, NULL);
    e->output_operator = integers(r, NULL);
    for (int64_t i = 0; i < e->m; i++) {
        e->n_other += e->output_state[i] < 0;
        e->n_late += comes_late(r->problem, e, i);
        r->broken |= comes_late(r->problem, e, i) && e->output_state[i] < 0;
    }
    e->n_signals = (int)integer(r);
    e->signals = own(r->problem, e->n_signals, sizeof *e->signals);
    for (int i = 0; i < e->n_signals; i++) {
        Signal *s = &e->signals[i];
        s->reference = (fmi_reference)integer(r);
        s->linear = (int)integer(r);
        s->kind = (int)integer(r);
        s->operator = (int)integer(r);
        s->time = array(r, &s->count);
        s->values = array(r, NULL);
    }
    e->start_state = array(r, &count);
    e->n_start = (int)count;
    e->start_value = array(r, NULL);
    e->known_reference = references(r, &e->n_known);
    e->known_value = array(r, NULL);
    e->measured = optional(r);
    e->spread = optional(r);
    e->most_steps = integer(r);
    e->targets = own(r->problem, p, sizeof *e->targets);
    for (int64_t j = 0; j < p; j++) {
        e->targets[j].kind = (int)integer(r);
        e->targets[j].a = integer(r);
        e->targets[j].scale = real(r);
    }
    e->start_matters = own(r->problem, p, 1);
    memset(e->start_matters, -1, (size_t)p + 1);
    for (int i = 0; i < e->n_signals; i++) {
        find_breaks(r->problem, &e->signals[i]);
        e->n_breaks += e->signals[i].n_breaks;
        e->most_breaks += e->signals[i].operator < 0 ? e->signals[i].n_breaks : operator_room(&e->signals[i]);
    }
}

void problem_close(Problem *p)
{
    if (!p) return;
    problem_close_runs(p);
    for (Owned *block = p->owned, *next; block; block = next) {
        next = block->next;
        free(block);
    }
    if (p->map) munmap(p->map, p->map_size);
    free(p);
}

/* All that the file tells behind its magic number. */
static void read_problem(Reader *r, Problem *p)
{
    int64_t count;
    p->library = text(r);
    p->resources = text(r);
    p->guid = text(r);
    p->name = text(r);
    p->version = (int)integer(r);
    p->has_directional = (int)integer(r);
    p->step_callback = (int)integer(r);
    p->single_instance = (int)integer(r);
    p->parameter_directional = p->has_directional ? -1 : 0;
    p->nz = (int)integer(r);
    p->state_reference = references(r, &count);
    p->n = (int)count;
    p->derivative_reference = references(r, NULL);
    p->state_settable = integers(r, NULL);
    p->n_colors = (int)integer(r);
    p->color = integers(r, NULL);
    p->column_start = integers(r, NULL);
    p->row = integers(r, NULL);
    p->fixed_reference = references(r, &p->n_fixed);
    p->fixed_value = array(r, NULL);
    p->rtol = real(r);
    p->atol = real(r);
    p->max_steps = integer(r);
    p->time_limit = real(r);
    p->n_operators = integer(r);
    p->operators = own(p, p->n_operators, sizeof *p->operators);
    p->n_driving = integer(r);
    for (int64_t k = 0; k < p->n_operators; k++) {
        p->operators[k].chain = (int)integer(r);
        p->operators[k].memory = (int)integer(r);
        p->operators[k].reference = references(r, &p->operators[k].n);
        if (p->operators[k].memory == DELAY) p->delays = 1, r->broken |= p->operators[k].n < 1;
    }
    p->relay.state = integers(r, &count);
    p->relay.n = (int)count;
    p->relay.gain = array(r, NULL);
    p->relay.held = (fmi_reference)integer(r), p->relay.direction = (fmi_reference)integer(r);
    p->relay.rate = own(p, count, sizeof *p->relay.rate);
    for (int j = 0; j < p->relay.n; j++) {
        const int state = p->relay.state[j];
        if (state < 0 || state >= p->n)
            r->broken = 1;
        else
            p->relay.rate[j] = p->derivative_reference[state];
    }
    p->p = integer(r);
    p->n_experiments = integer(r);
    p->experiments = own(p, p->n_experiments, sizeof *p->experiments);
    for (int64_t i = 0; i < p->n_experiments; i++) read_experiment(r, &p->experiments[i], p->p);
    if (!integer(r)) return;
    p->diffusion = array(r, NULL);
    for (int64_t i = 0; i < p->n_experiments; i++) {
        p->experiments[i].start_sd = array(r, NULL);
        p->experiments[i].reading_sd = array(r, NULL);
    }
}

Problem *problem_open(const char *path, char *error, size_t size)
{
    Problem *p = calloc(1, sizeof *p);
    const int fd = open(path, O_RDONLY | O_CLOEXEC);
    struct stat st;
    if (fd < 0 || fstat(fd, &st) || st.st_size < 16) {
        snprintf(error, size, "cannot read the problem at %s", path);
        if (fd >= 0) close(fd);
        free(p);
        return NULL;
    }
    p->map_size = (size_t)st.st_size;
    p->map = mmap(NULL, p->map_size, PROT_READ, MAP_SHARED, fd, 0);
    close(fd);
    if (p->map == MAP_FAILED) {
        snprintf(error, size, "cannot map the problem at %s", path);
        free(p);
        return NULL;
    }
    Reader r = {p->map, 0, p};
    r.broken = integer(&r) != SPEC_MAGIC;
    if (!r.broken) read_problem(&r, p);
    if (!r.broken) return p;
    snprintf(error, size, "the problem at %s is damaged", path);
    problem_close(p);
    return NULL;
}
