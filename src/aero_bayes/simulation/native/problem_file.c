/* Reads the problem that problem_file.py wrote: a stream of 8-byte words, mapped and used in place. */
#include <fcntl.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <unistd.h>

#include "lanes.h"

#define SPEC_MAGIC 0x4142535045430007LL

typedef struct {
    const char *at, *end;
    int broken;
} Reader;

static int64_t integer(Reader *r)
{
    if (r->end - r->at < 8) {
        r->broken = 1;
        return 0;
    }
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
    if (size < 8 || size % 8 || r->end - r->at < size || r->at[size - 1] != 0) {
        r->broken = 1;
        return "";
    }
    const char *s = r->at;
    r->at += size;
    return s;
}

static const void *array(Reader *r, int64_t *count)
{
    *count = integer(r);
    if (*count < 0 || (r->end - r->at) / 8 < *count) {
        r->broken = 1;
        *count = 0;
    }
    const void *p = r->at;
    r->at += 8 * *count;
    return p;
}

static fmi_reference *references(Reader *r, int64_t *count)
{
    const int64_t *p = array(r, count);
    fmi_reference *v = malloc(sizeof *v * (size_t)(*count + 1));
    for (int64_t i = 0; i < *count; i++) v[i] = (fmi_reference)p[i];
    return v;
}

static int *integers(Reader *r, int64_t *count)
{
    const int64_t *p = array(r, count);
    int *v = malloc(sizeof *v * (size_t)(*count + 1));
    for (int64_t i = 0; i < *count; i++) v[i] = (int)p[i];
    return v;
}

/* The uniform sample time, or 0. A rounding of the times to six digits of a step is still called uniform. */
static double uniform(const double *time, int64_t n)
{
    if (n < 3) return 0.0;
    const double dt = (time[n - 1] - time[0]) / (double)(n - 1);
    for (int64_t k = 1; k < n; k++)
        if (fabs(time[k] - time[k - 1] - dt) > 1e-6 * dt) return 0.0;
    return dt;
}

static void find_breaks(Signal *s, const char *touched)
{
    s->breaks = malloc(sizeof *s->breaks * (size_t)(s->count + 1));
    s->n_breaks = 0;
    for (int64_t k = 0; k < s->count; k++) {
        int is = touched[k] || (k > 0 && touched[k - 1]) || (s->linear && k + 1 < s->count && touched[k + 1]);
        if (!is && s->linear && s->count > 1) {
            const double before = k > 0 ? (s->values[k] - s->values[k - 1]) / (s->time[k] - s->time[k - 1]) : 0.0;
            const double after =
                k + 1 < s->count ? (s->values[k + 1] - s->values[k]) / (s->time[k + 1] - s->time[k]) : 0.0;
            is = fabs(after - before) > 1e-9 * (fabs(after) + fabs(before));
        } else if (!is && !s->linear)
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
    e->output_kind = integers(r, &count);
    r->broken |= count != e->m;
    e->output_state = integers(r, &count);
    r->broken |= count != e->m;
    e->n_other = 0;
    for (int64_t i = 0; i < e->m && !r->broken; i++) e->n_other += e->output_state[i] < 0;
    e->n_signals = (int)integer(r);
    if (r->broken || e->n_signals < 0 || e->n_signals > 1000000) {
        r->broken = 1;
        e->n_signals = 0;
        return;
    }
    e->signals = calloc((size_t)e->n_signals + 1, sizeof *e->signals);
    for (int i = 0; i < e->n_signals; i++) {
        Signal *s = &e->signals[i];
        s->reference = (fmi_reference)integer(r);
        s->linear = (int)integer(r);
        s->time = array(r, &s->count);
        s->values = array(r, &count);
        r->broken |= count != s->count || count < 1;
    }
    e->start_state = (int64_t *)array(r, &count);
    e->n_start = (int)count;
    e->start_value = array(r, &count);
    r->broken |= count != e->n_start;
    e->known_reference = references(r, &e->n_known);
    e->known_value = array(r, &count);
    r->broken |= count != e->n_known;
    e->measured = array(r, &count);
    r->broken |= count != 0 && count != e->n * e->m;
    if (count == 0) e->measured = NULL;
    e->spread = array(r, &count);
    r->broken |= count != 0 && count != e->n * e->m;
    if (count == 0) e->spread = NULL;
    e->most_steps = integer(r);
    e->targets = calloc((size_t)p + 1, sizeof *e->targets);
    for (int64_t j = 0; j < p; j++) {
        e->targets[j].kind = (int)integer(r);
        e->targets[j].a = integer(r);
        e->targets[j].b = integer(r);
        e->targets[j].scale = real(r);
    }
    e->start_matters = malloc((size_t)p + 1);
    memset(e->start_matters, -1, (size_t)p + 1);
    if (r->broken) return;
    for (int i = 0; i < e->n_signals; i++) {
        Signal *s = &e->signals[i];
        char *touched = calloc((size_t)s->count + 1, 1);
        for (int64_t j = 0; j < p; j++)
            if (e->targets[j].kind == TARGET_INPUT && e->targets[j].a == i) {
                if (e->targets[j].b < 0 || e->targets[j].b >= s->count)
                    r->broken = 1;
                else
                    touched[e->targets[j].b] = 1;
            }
        find_breaks(s, touched);
        e->n_breaks += s->n_breaks;
        free(touched);
    }
}

void problem_close(Problem *p)
{
    if (!p) return;
    problem_close_runs(p);
    lanes_close(p->lanes);
    for (int64_t i = 0; p->experiments && i < p->n_experiments; i++) {
        Experiment *e = &p->experiments[i];
        for (int j = 0; e->signals && j < e->n_signals; j++) free(e->signals[j].breaks);
        free(e->signals);
        free(e->output_reference);
        free(e->output_kind);
        free(e->output_state);
        free(e->known_reference);
        free(e->targets);
        free(e->start_matters);
    }
    free(p->experiments);
    free(p->state_reference);
    free(p->derivative_reference);
    free(p->state_settable);
    free(p->color);
    free(p->column_start);
    free(p->row);
    free(p->fixed_reference);
    if (p->map) munmap(p->map, p->map_size);
    free(p);
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
    Reader r = {p->map, (const char *)p->map + p->map_size, 0};
    int64_t count;
    r.broken |= integer(&r) != SPEC_MAGIC;
    p->library = text(&r);
    p->resources = text(&r);
    p->guid = text(&r);
    p->name = text(&r);
    p->version = (int)integer(&r);
    p->has_directional = (int)integer(&r);
    p->step_callback = (int)integer(&r);
    p->single_instance = (int)integer(&r);
    p->parameter_directional = p->has_directional ? -1 : 0;
    p->nz = (int)integer(&r);
    p->state_reference = references(&r, &count);
    p->n = (int)count;
    p->derivative_reference = references(&r, &count);
    r.broken |= count != p->n;
    p->state_settable = integers(&r, &count);
    r.broken |= count != p->n;
    p->n_colors = (int)integer(&r);
    p->color = integers(&r, &count);
    r.broken |= count != p->n;
    p->column_start = integers(&r, &count);
    r.broken |= count != p->n + 1;
    p->row = integers(&r, &count);
    p->fixed_reference = references(&r, &p->n_fixed);
    p->fixed_value = array(&r, &count);
    r.broken |= count != p->n_fixed;
    p->rtol = real(&r);
    p->atol = real(&r);
    p->max_steps = integer(&r);
    p->time_limit = real(&r);
    p->p = integer(&r);
    p->n_experiments = integer(&r);
    if (r.broken || p->p < 0 || p->n_experiments < 0 || p->n_experiments > (1 << 24)) {
        snprintf(error, size, "the problem at %s is damaged", path);
        p->n_experiments = 0;
        problem_close(p);
        return NULL;
    }
    p->experiments = calloc((size_t)p->n_experiments + 1, sizeof *p->experiments);
    for (int64_t i = 0; i < p->n_experiments && !r.broken; i++) read_experiment(&r, &p->experiments[i], p->p);
    if (integer(&r)) {
        p->diffusion = array(&r, &count);
        r.broken |= count != p->n;
        for (int64_t i = 0; i < p->n_experiments && !r.broken; i++) {
            p->experiments[i].start_sd = array(&r, &count);
            r.broken |= count != p->n;
            p->experiments[i].reading_sd = array(&r, &count);
            r.broken |= count != p->experiments[i].m;
        }
    }
    if (r.broken) {
        snprintf(error, size, "the problem at %s is damaged", path);
        problem_close(p);
        return NULL;
    }
    return p;
}
