/* The clocks, and what a worker tells of its progress: when the run under way began, and its computing time then. */
#include <time.h>

#include "engine.h"

static int64_t read_clock(clockid_t id)
{
    struct timespec t;
    clock_gettime(id, &t);
    return (int64_t)t.tv_sec * 1000000000 + t.tv_nsec;
}

int64_t now_ns(void) { return read_clock(CLOCK_MONOTONIC); }

int64_t process_ns(void) { return read_clock(CLOCK_PROCESS_CPUTIME_ID); }

int64_t thread_ns(void) { return read_clock(CLOCK_THREAD_CPUTIME_ID); }

static Slot *watched;

void progress_to(Slot *slot) { watched = slot; }

void progress_stamp(void)
{
    if (!watched) return;
    __atomic_store_n(&watched->spent, process_ns(), __ATOMIC_RELEASE);
    __atomic_store_n(&watched->started, now_ns(), __ATOMIC_RELEASE);
}

void start_time_limit(Run *r)
{
    const int64_t limit = (int64_t)(1e9 * r->problem->time_limit);
    r->deadline = thread_ns() + limit;
    r->earliest = now_ns() + limit;
    progress_stamp();
}
