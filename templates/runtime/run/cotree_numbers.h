/* cotree_numbers.h: the arithmetic in which methods are written, for one number at a time. Files
 * that compute with vectors, one run in each lane, define the same names for these. */
#ifndef COTREE_NUMBERS_H
#define COTREE_NUMBERS_H

#include "cotree_real.h"

typedef cotree_real REAL;
typedef int MASK; /* a condition */

#define HOLDS 1
#define NOT(mask) (!(mask))
#define LANE(numbers, lane) (numbers)
#define ALL(number) (number) /* the same number in each lane */
#define ZERO COTREE_F(0.0)

#define cotree_any(mask) (mask)
#define cotree_either(mask, a, b) ((mask) ? (a) : (b)) /* of masks */
#define cotree_choose(mask, a, b) ((mask) ? (a) : (b)) /* of numbers */
#define cotree_fused(a, b, c) ((a) * (b) + (c))
#define cotree_over(a, b) ((a) / (b))
#define cotree_inverse(x) (COTREE_F(1.0) / (x))
#define cotree_abs(x) COTREE_FABS(x)
#define cotree_sqrt(x) COTREE_SQRT(x)
#define cotree_exp(x) COTREE_EXP(x)
#define cotree_log(x) COTREE_LOG(x)

/* Return b if either is a nan. Unlike fmax and fmin these may become one instruction. */
static inline REAL cotree_larger(REAL a, REAL b) { return a > b ? a : b; }

static inline REAL cotree_smaller(REAL a, REAL b) { return a < b ? a : b; }

#endif
