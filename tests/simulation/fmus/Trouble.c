/* x' = -x, and every kind of misbehaviour, chosen by the parameter `mode`. */
#define STATES {0}
#define DERIVATIVES {1}
#include "skeleton.h"
enum { X, DX, MODE };
enum { FINE, CRASH, HANG, FAIL, REJECT, FLOOD, NOT_A_NUMBER, REFUSE_START, EVENTS_FOREVER, GONE, FATALLY, STIFFEN, BLOW_UP, LEAK };
static int flooded;
static void start(Model *m) { m->r[X] = 1.0; }
static int initialize(Model *m)
{
    if (m->r[MODE] == REFUSE_START) return ERROR;
    if (m->r[MODE] == LEAK)
        for (volatile char *kept = malloc(1 << 20), *at = kept; at && at < kept + (1 << 20); at += 4096) *at = 1;
    return OK;
}
static int update(Model *m)
{
    m->r[DX] = -m->r[X];
    const int late = m->t > 0.5;
    switch ((int)m->r[MODE]) {
    case CRASH:
        if (late) *(volatile int *)8 = 1;
        break;
    case HANG:
        while (late) usleep(1000);
        break;
    case FAIL:
        return late ? ERROR : OK;
    case REJECT:
        return late ? DISCARD : OK;
    case FLOOD:
        for (int i = 0; i < 100; i++) {
            m->callbacks->logger(m->callbacks->environment, m->name, ERROR, "error", "flood %d", flooded++);
            printf("flood %d\n", flooded);
            fprintf(stderr, "flood %d\n", flooded);
        }
        break;
    case NOT_A_NUMBER:
        if (late) m->r[DX] = NAN;
        break;
    case GONE:
        if (late) exit(0);
        break;
    case FATALLY:
        return late ? FATAL : OK;
    case STIFFEN: /* never smooth: no step is small enough */
        m->r[DX] = sin(1e18 * m->t) * 1e30;
        break;
    case BLOW_UP:
        m->r[DX] = 1.0 + m->r[X] * m->r[X];
        break;
    }
    return OK;
}
static int discrete(Model *m, Events *e)
{
    e->again = m->r[MODE] == EVENTS_FOREVER;
    return OK;
}
static void zero_crossings(Model *m, double *z) {}
static int derivative(Model *m, unsigned unknown, unsigned known, double *v)
{
    *v = unknown == DX && known == X ? -1.0 : 0.0;
    return OK;
}
