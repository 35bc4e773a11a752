/* No states: y = gain u + offset, and a resource: the number in resources/y.txt. */
#include "skeleton.h"
int initialize(Model *m)
{
    char path[640];
    snprintf(path, sizeof path, "%s/y.txt", m->resources);
    FILE *f = fopen(path, "r");
    if (!f) return ERROR;
    const int got = fscanf(f, "%lf", &m->r[RESOURCE]);
    fclose(f);
    return got == 1 ? OK : ERROR;
}
static int update(Model *m, Complex *r)
{
    r[Y] = r[GAIN] * r[U] + r[OFFSET];
    return OK;
}
