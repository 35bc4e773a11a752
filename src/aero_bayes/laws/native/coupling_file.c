/* Reads coupling.txt, which laws/fmu_coupling.py writes. */
#include "coupler.h"

static char *line(FILE *f)
{
    char *text = NULL;
    size_t size = 0;
    const ssize_t n = getline(&text, &size, f);
    if (n > 0 && text[n - 1] == '\n') text[n - 1] = '\0';
    return n > 0 ? text : NULL;
}

static void *numbers(FILE *f, size_t *n, int columns)
{
    int count = 0;
    if (fscanf(f, "%d", &count) != 1 || count < 0) return NULL;
    unsigned *all = calloc((size_t)(count * columns) + 1, sizeof *all);
    for (int i = 0; all && i < count * columns; i++)
        if (fscanf(f, "%u", &all[i]) != 1) return NULL;
    *n = (size_t)count;
    return all;
}

static int read_part(FILE *f, Part *p, const char *folder)
{
    char path[4096], error[256];
    int version;
    if (fscanf(f, "%d %d", &version, &p->nz) != 2) return 1;
    free(line(f));
    char *library = line(f), *resources = line(f);
    p->guid = line(f);
    if (!library || !resources || !p->guid) return 1;
    snprintf(path, sizeof path, "%s/%s", folder, library);
    p->fmu = fmu_open(path, version, error, sizeof error);
    const size_t size = strlen(folder) + strlen(resources) + 16;
    p->resources = malloc(size);
    /* FMI 3.0 asks for a path that ends in a separator, FMI 2.0 for a URI */
    snprintf(p->resources, size, version == 3 ? "%s/%s/" : "file://%s/%s", folder, resources);
    free(library);
    free(resources);
    size_t n;
    p->state = numbers(f, &n, 1);
    p->nx = p->state ? (int)n : 0;
    return !p->fmu || !p->state;
}

int read_coupling(CoupledFmu *s, const char *folder)
{
    char path[4096];
    snprintf(path, sizeof path, "%s/coupling.txt", folder);
    FILE *f = fopen(path, "r");
    if (!f) return 1;
    int bad = read_part(f, &s->part[INNER], folder) || read_part(f, &s->part[LAWS], folder);
    size_t n = 0;
    bad = bad || !(s->late_start = numbers(f, &n, 1)) || n != (size_t)s->part[INNER].nx;
    for (int k = 0; k < TRANSFERS && !bad; k++) {
        Transfer *transfer = &s->transfer[k];
        fmi_reference *pairs = numbers(f, &transfer->n, 2);
        transfer->from = calloc(transfer->n + 1, sizeof *transfer->from);
        transfer->to = calloc(transfer->n + 1, sizeof *transfer->to);
        transfer->value = calloc(transfer->n + 1, sizeof *transfer->value);
        bad = !pairs;
        for (size_t i = 0; i < transfer->n && !bad; i++) transfer->from[i] = pairs[2 * i], transfer->to[i] = pairs[2 * i + 1];
        free(pairs);
    }
    unsigned *pairs = bad ? NULL : numbers(f, &s->n_variables, 2);
    bad |= !pairs;
    s->owner = calloc(s->n_variables + 1, sizeof *s->owner);
    s->reference = calloc(s->n_variables + 1, sizeof *s->reference);
    for (size_t i = 0; i < s->n_variables && !bad; i++)
        s->owner[i] = (int)pairs[2 * i], s->reference[i] = pairs[2 * i + 1];
    free(pairs);
    fclose(f);
    return bad;
}
