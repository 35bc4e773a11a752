/* The vector loops for the processor at hand. */
#include <float.h>

#include "engine.h"

typedef double Four __attribute__((vector_size(32), aligned(8), may_alias));

#define TARGET
#define PART 2
#define FN(name) base_##name
#include "kernels.inc"
#undef FN
#undef TARGET
#undef PART

#if defined(__x86_64__) && defined(__GNUC__)
#define TARGET __attribute__((target("avx2,fma")))
#define PART 4
#define FN(name) wide_##name
#include "kernels.inc"
#define HAVE_WIDE 1
#endif

const Kernels *kernels = &base_table;

/* AERO_BAYES_INSTRUCTIONS=baseline in the environment keeps to what every processor has, for tests. */
void kernels_choose(void)
{
    kernels = &base_table;
#ifdef HAVE_WIDE
    const char *asked = getenv("AERO_BAYES_INSTRUCTIONS");
    __builtin_cpu_init();
    const int there = __builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma");
    if (there && !(asked && !strcmp(asked, "baseline"))) kernels = &wide_table;
#endif
}
