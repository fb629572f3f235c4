/* cotree_numbers.h: scalar arithmetic of the integration methods. Ensembles, which run one member
 * in each lane of a vector, define the same names for vectors. */
#ifndef COTREE_NUMBERS_H
#define COTREE_NUMBERS_H

#include "cotree_real.h"

typedef cotree_real REAL;
typedef int MASK; /* result of a comparison */

#define HOLDS 1
#define NOT(mask) (!(mask))
#define LANE(numbers, lane) (numbers)
#define ALL(number) (number) /* broadcasts a number to all lanes */
#define ZERO COTREE_F(0.0)

#define cotree_any(mask) (mask)
#define cotree_either(mask, a, b) ((mask) ? (a) : (b)) /* selects one of two masks */
#define cotree_choose(mask, a, b) ((mask) ? (a) : (b)) /* selects one of two numbers */
#define cotree_fused(a, b, c) ((a) * (b) + (c))
#define cotree_over(a, b) ((a) / (b))
#define cotree_inverse(x) (COTREE_F(1.0) / (x))
#define cotree_abs(x) COTREE_FABS(x)
#define cotree_sqrt(x) COTREE_SQRT(x)
#define cotree_exp(x) COTREE_EXP(x)
#define cotree_log(x) COTREE_LOG(x)

/* Return the larger number, or b if either is nan. Unlike fmax, this is one instruction. */
static inline REAL cotree_larger(REAL a, REAL b) { return a > b ? a : b; }

static inline REAL cotree_smaller(REAL a, REAL b) { return a < b ? a : b; }

#endif
