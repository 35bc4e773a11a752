/* The vector arithmetic of lanes for the processor at hand. */
#include <float.h>

#include "lanes.h"

#define FN(name) base_##name
#define TARGET
#define PART 2
#include "lanes.inc"
#undef FN
#undef TARGET
#undef PART

#if defined(__x86_64__) && defined(__GNUC__)
#define FN(name) wide_##name
#define TARGET __attribute__((target("avx2,fma")))
#define PART 4
#include "lanes.inc"
#define HAVE_WIDE 1
#endif

const LaneKernels *lane_kernels_for(int instructions)
{
#ifdef HAVE_WIDE
    if (instructions == AB_AVX2) return &wide_lane_table;
#endif
    return instructions == AB_BASELINE ? &base_lane_table : NULL;
}
