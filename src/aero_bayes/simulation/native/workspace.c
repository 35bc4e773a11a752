/* The buffers of a run: one block of memory for each experiment of a problem, kept from run to run. */
#include "engine.h"

#define REALS(count) take(a, (size_t)(count), sizeof(double))
#define PART(type, count) take(a, (size_t)(count), sizeof(type))

static void lay_out(Run *r, Arena *a)
{
    const Problem *problem = r->problem;
    const Experiment *e = r->e;
    const size_t n = (size_t)r->n, nz = (size_t)r->nz + 1, m = (size_t)e->m, ld = (size_t)r->ld, q = (size_t)r->q;
    const size_t inputs = (size_t)e->n_signals, columns = (size_t)problem->p;
    r->x = REALS(n), r->x1 = REALS(n), r->f = REALS(n), r->f1 = REALS(n), r->ft = REALS(n), r->u = REALS(n);
    r->r = REALS(n), r->derivatives_unused = REALS(n), r->nominal = REALS(n), r->largest = REALS(n), r->column = REALS(n);
    r->jac = REALS(n * n), r->lu = REALS(n * n), r->k = REALS(8 * n), r->dense = REALS(5 * n);
    r->pivot = PART(int, n);
    r->factors.start = PART(int, 2 * n + 1), r->factors.col = PART(int, n * n);
    r->factors.val = REALS(n * n), r->factors.diagonal = REALS(n);
    r->seed = REALS(n + inputs + q + 1);
    r->seed_reference = PART(fmi_reference, n + inputs + q + 1), r->known_column = PART(int, inputs + q);
    r->columns = REALS((n + m) * (n + inputs + q));
    const size_t starts = (size_t)(problem->n_fixed + e->n_known) + (size_t)e->n_start + columns + 3;
    r->start_value = REALS(starts);
    r->start_reference = PART(fmi_reference, starts);
    r->z0 = REALS(nz), r->z1 = REALS(nz), r->z2 = REALS(nz), r->z_try = REALS(nz);
    r->cell = PART(int64_t, inputs);
    r->u0 = REALS(inputs), r->slope = REALS(inputs), r->u_now = REALS(inputs);
    r->delay = REALS(inputs), r->u_before = REALS(inputs);
    r->u_reference = PART(fmi_reference, inputs), r->u_real = PART(fmi_reference, inputs);
    r->breaks = PART(Break, e->most_breaks);
    r->column_target = PART(Target, q);
    r->s0 = REALS(n * q);
    if (q) {
        r->s = REALS(n * ld), r->s1 = REALS(n * ld), r->su = REALS(n * ld), r->g_dot = REALS(n * ld);
        r->s_largest = REALS(ld);
        r->sv = REALS(8 * n * ld), r->sdense = REALS(5 * n * ld);
        r->a_node = REALS(4 * n * n), r->b_node = REALS(4 * n * ld), r->b_now = REALS(n * ld);
        r->a_packed = REALS(4 * n * n);
        r->a_now.start = PART(int, n + 1), r->a_now.col = PART(int, n * n), r->a_now.val = REALS(n * n);
    }
    const size_t late = (size_t)e->n_late * (size_t)e->n;
    r->late = PART(Late, e->n_late), r->late_y = REALS(late), r->late_s = REALS(late * ld);
    r->other = REALS(m), r->fraction = REALS(BLOCK);
    r->piece_y = REALS(PIECE_POINTS * m), r->piece_s = REALS(PIECE_POINTS * m * ld);
    r->other_reference = PART(fmi_reference, m);
    Sink *k = &r->sink;
    k->y = REALS(m * BLOCK);
    k->s = REALS(m * BLOCK * ld);
    k->filter = PART(Filter, m);
    k->residual = REALS(BLOCK), k->gain = REALS(BLOCK), k->decay = REALS(BLOCK), k->weight = REALS(BLOCK);
}

Run *run_open(Problem *problem, Experiment *e, int q, const int64_t *active)
{
    Run *r = calloc(1, sizeof *r);
    if (!r) return NULL;
    r->problem = problem;
    r->e = e;
    r->n = problem->n;
    r->nz = problem->nz;
    r->q = q;
    r->ld = (q + 3) / 4 * 4;
    r->rtol = problem->rtol;
    r->atol = problem->atol;
    int64_t *columns = malloc(sizeof *columns * (size_t)(q + 1));
    Arena arena = {NULL, 0};
    lay_out(r, &arena);
    void *memory = NULL;
    if (!columns || posix_memalign(&memory, 64, arena.used + 64)) {
        free(columns);
        free(r);
        return NULL;
    }
    memset(memory, 0, arena.used + 64);
    if (q) memcpy(columns, active, sizeof *columns * (size_t)q);
    r->active = columns;
    r->memory = memory;
    if (!operators_open(r)) {
        run_close(r);
        return NULL;
    }
    arena = (Arena){memory, 0};
    lay_out(r, &arena);
    for (int64_t o = 0; o < e->m; o++)
        if (e->output_state[o] < 0 && e->output_kind[o] == 0) r->other_reference[r->n_other++] = e->output_reference[o];
    return r;
}

void run_close(Run *r)
{
    if (!r) return;
    operators_close(r);
    kalman_close(r->kalman);
    exponential_close(r->exponential);
    free((void *)r->active);
    free(r->steps);
    free(r->event_times);
    free(r->memory);
    free(r);
}

void problem_close_runs(Problem *p)
{
    for (int64_t i = 0; p->runs && i < p->n_experiments; i++) run_close(p->runs[i]);
    free(p->runs);
    free(p->runs_active);
    p->runs = NULL;
    p->runs_active = NULL;
}

Run *problem_run(Problem *p, int64_t e, int64_t q, const int64_t *active)
{
    if (!p->runs || p->runs_q != q || memcmp(p->runs_active, active, sizeof *active * (size_t)q) != 0) {
        problem_close_runs(p);
        p->runs = calloc((size_t)p->n_experiments + 1, sizeof *p->runs);
        p->runs_active = malloc(sizeof *active * (size_t)(q + 1));
        memcpy(p->runs_active, active, sizeof *active * (size_t)q);
        p->runs_q = q;
    }
    if (!p->runs[e]) p->runs[e] = run_open(p, &p->experiments[e], (int)q, active);
    return p->runs[e];
}
