/* No states: y = gain u + offset, and a resource: the number in resources/y.txt. */
#define STATES {0}
#define DERIVATIVES {0}
#include "skeleton.h"
enum { U, Y, GAIN, OFFSET, RESOURCE };
static void start(Model *m) { m->r[GAIN] = 1.0; }
static int initialize(Model *m)
{
    char path[640];
    const char *at = strncmp(m->resources, "file://", 7) ? m->resources : m->resources + 7;
    snprintf(path, sizeof path, "%s/y.txt", at);
    FILE *f = fopen(path, "r");
    if (!f) return ERROR;
    const int got = fscanf(f, "%lf", &m->r[RESOURCE]);
    fclose(f);
    return got == 1 ? OK : ERROR;
}
static int update(Model *m)
{
    m->r[Y] = m->r[GAIN] * m->r[U] + m->r[OFFSET];
    return OK;
}
static int discrete(Model *m, Events *e) { return OK; }
static void zero_crossings(Model *m, double *z) {}
static int derivative(Model *m, unsigned unknown, unsigned known, double *v)
{
    *v = 0.0;
    if (unknown == Y) *v = known == U ? m->r[GAIN] : known == GAIN ? m->r[U] : known == OFFSET;
    return OK;
}
