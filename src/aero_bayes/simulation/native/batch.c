/* Many runs: tasks (row, experiment) are taken one at a time from a counter that all workers share, and each task's
 * result has a place of its own, so that results do not depend on who computed them. */
#if defined(__x86_64__)
#include <xmmintrin.h>
#endif

#include <time.h>
#include <unistd.h>

#include "engine.h"

enum { TODO = 255 };

/* The clocks, and what a worker tells of its progress: when the run under way began, and its computing time then. */
static int64_t read_clock(clockid_t id)
{
    struct timespec t;
    clock_gettime(id, &t);
    return (int64_t)t.tv_sec * 1000000000 + t.tv_nsec;
}

int64_t now_ns(void) { return read_clock(CLOCK_MONOTONIC); }

int64_t thread_ns(void) { return read_clock(CLOCK_THREAD_CPUTIME_ID); }

typedef struct {
    int64_t task, started, spent; /* started by the clock on the wall, spent in computing time; in ns */
} Slot;

static Slot *watched; /* or NULL: nobody watches */

static void progress_stamp(void)
{
    if (!watched) return;
    __atomic_store_n(&watched->spent, read_clock(CLOCK_PROCESS_CPUTIME_ID), __ATOMIC_RELEASE);
    __atomic_store_n(&watched->started, now_ns(), __ATOMIC_RELEASE);
}

void start_time_limit(Run *r)
{
    const int64_t limit = (int64_t)(1e9 * r->problem->time_limit);
    r->deadline = thread_ns() + limit;
    r->earliest = now_ns() + limit;
    progress_stamp();
}

/* In shared memory; offsets are in bytes from `base`. Written by Python (batches.py). */
typedef struct {
    int64_t next, total, mode, experiments, p, q;
    int64_t noise_row, noise_experiment; /* strides in doubles, zero where broadcast */
    int64_t values, noise, active, outcome, steps, result, result_stride, table;
} Job;

static int all_finite(const double *v, int64_t count)
{
    double sum = 0.0;
    for (int64_t i = 0; i < count; i++) sum += v[i] * 0.0;
    return sum == 0.0;
}

static int is_whole(const Job *job)
{
    return job->mode == MODE_TRAJECTORY || job->mode == MODE_FILTER || job->mode == MODE_FILTER_STATES;
}

/* What a run is to do: its parameter vector and where its outputs go. Returns its noise. */
static const double *set_task(Run *r, char *base, const Job *job, int64_t index)
{
    const int64_t row = index / job->experiments, e = index % job->experiments;
    const int64_t *table = (const int64_t *)(void *)(base + job->table) + 4 * e;
    r->values = (const double *)(void *)(base + job->values) + row * job->p;
    r->sink.trajectory = NULL;
    if (is_whole(job)) {
        r->sink.trajectory = (double *)(void *)(base + table[0]) + row * table[1];
        r->sink.sensitivity = (double *)(void *)(base + table[2]) + row * table[3];
    }
    return (const double *)(void *)(base + job->noise) + row * job->noise_row + e * job->noise_experiment;
}

/* The outcome of a run that came to its end, with what it is reduced to. */
static int close_task(const Run *r, char *base, const Job *job, int64_t index)
{
    const int64_t *table = (const int64_t *)(void *)(base + job->table) + 4 * (index % job->experiments);
    double *result = (double *)(void *)(base + job->result) + index * job->result_stride;
    if (is_whole(job)) /* each row has its place, one after the other */
        return all_finite(r->sink.trajectory, table[1]) && all_finite(r->sink.sensitivity, r->q ? table[3] : 0)
                   ? AB_OK
                   : AB_NOT_FINITE;
    if (job->mode == MODE_FILTER_LIKELIHOOD)
        result[0] = r->kalman->log_likelihood;
    else
        result[0] = -r->sink.cost - r->sink.log_det;
    return all_finite(result, job->result_stride) ? AB_OK : AB_NOT_FINITE;
}

static void count_steps(const Run *r, char *base, const Job *job, int64_t index)
{
    ((int64_t *)(void *)(base + job->steps))[index] = r->taken + r->rejected;
}

static int do_task(Problem *p, char *base, const Job *job, int64_t index)
{
    const int64_t *active = (const int64_t *)(void *)(base + job->active);
    Run *r = problem_run(p, index % job->experiments, job->q, active);
    if (!r) return AB_SOLVER_FAILED;
    const double *noise = set_task(r, base, job, index);
    const int outcome = all_finite(r->values, job->p) ? run_repeatable(r, (int)job->mode, noise) : AB_NOT_FINITE;
    count_steps(r, base, job, index);
    return outcome ? outcome : close_task(r, base, job, index);
}

EXPORT Problem *ab_open(const char *path, char *error, size_t size)
{
    return problem_open(path, error, size);
}

EXPORT void ab_close(Problem *p) { problem_close(p); }

static int64_t memory_limit; /* bytes of this process's own memory, 0 for any */

EXPORT void ab_limit(int64_t bytes) { memory_limit = bytes; }

/* Has the model's code left more memory behind than is allowed? Looked at every few runs, so that every life of a
 * worker gets some done. */
static int leaks(void)
{
    enum { EVERY = 64 };
    static int runs;
    if (memory_limit <= 0 || ++runs % EVERY) return 0;
    long total, resident = 0, shared = 0;
    FILE *f = fopen("/proc/self/statm", "r");
    if (!f) return 0;
    const int read = fscanf(f, "%ld %ld %ld", &total, &resident, &shared);
    fclose(f);
    return read == 3 && (int64_t)(resident - shared) * sysconf(_SC_PAGESIZE) > memory_limit;
}

/* The next task without an outcome, or -1; `first` (or -1) goes before all others. */
static int64_t next_task(const char *base, Job *job, int64_t *first)
{
    const unsigned char *outcome = (const unsigned char *)base + job->outcome;
    for (;;) {
        const int64_t index = *first >= 0 ? *first : __atomic_fetch_add(&job->next, 1, __ATOMIC_RELAXED);
        *first = -1;
        if (index >= job->total) return -1;
        if (outcome[index] == TODO) return index;
    }
}

static void work_at(Slot *mine, int64_t index)
{
    progress_stamp();
    __atomic_store_n(&mine->task, index, __ATOMIC_RELEASE);
}

static int run_singly(Problem *p, char *base, Job *job, Slot *mine, int64_t first)
{
    unsigned char *outcome = (unsigned char *)base + job->outcome;
    for (int64_t index; (index = next_task(base, job, &first)) >= 0;) {
        work_at(mine, index);
        const int result = do_task(p, base, job, index);
        if (p->load_error[0]) {
            *mine = (Slot){.task = -1};
            return 2;
        }
        if (p->fmu && p->fmu->spent) return 1;
        outcome[index] = (unsigned char)result;
        __atomic_store_n(&mine->task, -1, __ATOMIC_RELEASE);
        if (leaks()) return 1;
    }
    return 0;
}

/* Works until no task is left (0), until this process can do no more (1): its memory is full, or the FMU was
 * instantiated as often as it can be; the task that met this stays in the slot, undone; or until the FMU cannot be
 * loaded (2), see ab_load_error. `first` (or -1) is a task to do before asking for more. */
EXPORT int ab_batch(Problem *p, char *base, Job *job, Slot *mine, int64_t first)
{
#if defined(__x86_64__)
    const unsigned int mode = _mm_getcsr();
    _mm_setcsr(mode | 0x8040); /* denormal numbers are zero: a decayed sensitivity must not cost a hundredfold */
#endif
    watched = mine;
    const int full = run_singly(p, base, job, mine, first);
    watched = NULL;
#if defined(__x86_64__)
    _mm_setcsr(mode);
#endif
    return full;
}

EXPORT const char *ab_load_error(const Problem *p) { return p->load_error; }

/* The next task of a job, for runs that are not the engine's. */
EXPORT int64_t ab_take(Job *job) { return __atomic_fetch_add(&job->next, 1, __ATOMIC_RELAXED); }

/* Python looks for this name in an extension module; the library is used through ctypes instead. */
EXPORT void *PyInit__engine(void) { return NULL; }
