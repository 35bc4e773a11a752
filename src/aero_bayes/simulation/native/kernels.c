/* The vector loops, and the arithmetic of lanes (all of them, and the first half), for the processor at hand. */
#include <float.h>

#include "lanes.h"

typedef double Four __attribute__((vector_size(32), aligned(8), may_alias));

#define TARGET
#define PART 2
#define FN(name) base_##name
#define USED WIDE
#include "kernels.inc"
#include "lanes.inc"
#undef FN
#undef USED
#define FN(name) base_half_##name
#define USED (WIDE / 2)
#include "lanes.inc"
#undef FN
#undef USED
#undef TARGET
#undef PART

#if defined(__x86_64__) && defined(__GNUC__)
#define TARGET __attribute__((target("avx2,fma")))
#define PART 4
#define FN(name) wide_##name
#define USED WIDE
#include "kernels.inc"
#include "lanes.inc"
#undef FN
#undef USED
#define FN(name) wide_half_##name
#define USED (WIDE / 2)
#include "lanes.inc"
#define HAVE_WIDE 1
#endif

const Kernels *kernels = &base_table;

/* AERO_BAYES_INSTRUCTIONS=baseline in the environment keeps to what every processor has, for tests. */
int has_wide(void)
{
#ifdef HAVE_WIDE
    const char *asked = getenv("AERO_BAYES_INSTRUCTIONS");
    __builtin_cpu_init();
    return !(asked && !strcmp(asked, "baseline")) && __builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma");
#else
    return 0;
#endif
}

void kernels_choose(void)
{
    kernels = &base_table;
#ifdef HAVE_WIDE
    if (has_wide()) kernels = &wide_table;
#endif
}

const LaneKernels *lane_kernels_for(int half)
{
#ifdef HAVE_WIDE
    if (has_wide()) return half ? &wide_half_lane_table : &wide_lane_table;
#endif
    return half ? &base_half_lane_table : &base_lane_table;
}
