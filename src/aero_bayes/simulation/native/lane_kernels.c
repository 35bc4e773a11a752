/* The vector arithmetic of lanes for the processor at hand; for all lanes, and for the first half of them. */
#include <float.h>

#include "lanes.h"

#define TARGET
#define PART 2
#define FN(name) base_##name
#define USED WIDE
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
#include "lanes.inc"
#undef FN
#undef USED
#define FN(name) wide_half_##name
#define USED (WIDE / 2)
#include "lanes.inc"
#define HAVE_WIDE 1
#endif

const LaneKernels *lane_kernels_for(int instructions, int half)
{
#ifdef HAVE_WIDE
    if (instructions == AB_AVX2) return half ? &wide_half_lane_table : &wide_lane_table;
#endif
    return half ? &base_half_lane_table : &base_lane_table;
}
