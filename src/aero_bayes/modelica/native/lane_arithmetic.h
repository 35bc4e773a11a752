/* Arithmetic of generated lane functions: vectors of WIDTH lanes, written in the vector extensions of GCC and Clang.
 * Included once for each instruction set, with WIDTH defined. Elementary functions are those of the C library, lane by
 * lane, so that results are those of a single run. */
#include <math.h>

#include "lanes.h"

#ifndef AERO_BAYES_LANE_ARITHMETIC_H
#define AERO_BAYES_LANE_ARITHMETIC_H
#define LOAD(a, i) (*(const Vector *)((a) + (i) * AB_LANES + lane))
#define STORE(a, i) (*(Vector *)((a) + (i) * AB_LANES + lane))
#define SPLAT(x) ((Vector){0} + (x))
#define CHOOSE(mask, a, b) ((Vector)(((mask) & (Mask)(a)) | (~(mask) & (Mask)(b))))
#define MAGNITUDE(a) ((Vector)((Mask)(a) & 0x7fffffffffffffffLL))
#define EACH(f, a) ({ const Vector a_ = (a); Vector r_; for (int i_ = 0; i_ < WIDTH; i_++) r_[i_] = f(a_[i_]); r_; })
#define EACH_OF_TWO(f, a, b) ({ const Vector a_ = (a), b_ = (b); Vector r_; for (int i_ = 0; i_ < WIDTH; i_++) r_[i_] = f(a_[i_], b_[i_]); r_; })
#endif
