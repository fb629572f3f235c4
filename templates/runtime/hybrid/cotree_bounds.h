/* cotree_bounds.h: bounds of event functions and of their quantities over a step. */
#ifndef COTREE_BOUNDS_H
#define COTREE_BOUNDS_H

#include "cotree_limits.h"
#ifndef HOLDS /* otherwise the including file computes with vectors */
#include "cotree_numbers.h"
#endif

/* Set the bounds of quantity k of n over an interval: the range of its values at both ends,
 * extended by a quarter of its second difference, `bend`. This margin is twice the distance of a
 * parabola from its chord. */
static inline void cotree_set_bounds(REAL *box, int n, int k, REAL low, REAL high, REAL bend)
{
    box[k] = low - COTREE_F(0.25) * bend;
    box[n + k] = high + COTREE_F(0.25) * bend;
}

/* Set the bounds of the rate of a quantity, extended by its second difference over the interval. */
static inline void cotree_set_rate_bounds(REAL *box, int n, int k, REAL slow, REAL fast, REAL bend)
{
    box[2 * n + k] = slow - bend;
    box[3 * n + k] = fast + bend;
}

/* Set the bounds of a quantity and of its rate over a step, from the values a and b at its ends and
 * the mean rate in the previous step. Return the mean rate in this step. */
static inline REAL cotree_set_step_bounds(REAL *box, int n, int k, REAL a, REAL b, REAL step,
                                          REAL mean_rate)
{
    const REAL change = b - a, rate = change / step;
    const REAL bend = COTREE_SCAN_CURVATURE * (cotree_abs(change - step * mean_rate) +
                                               COTREE_SCAN_UNEVEN * cotree_abs(change));
    cotree_set_bounds(box, n, k, cotree_smaller(a, b), cotree_larger(a, b), bend);
    cotree_set_rate_bounds(box, n, k, rate, rate, bend / step);
    return rate;
}

/* Bounds of an event function on one side of zero: its smallest value and the range of its rate,
 * all multiplied by the sign of that side. */
typedef struct cotree_side_range {
    REAL low, slow, fast;
} cotree_side_range;

static inline cotree_side_range cotree_range_on_side(const REAL *range, REAL side)
{
    const MASK is_above = side > COTREE_F(0.0);
    cotree_side_range r;
    r.low = cotree_choose(is_above, range[0], -range[1]);
    r.slow = cotree_choose(is_above, range[2], -range[3]);
    r.fast = cotree_choose(is_above, range[3], -range[2]);
    return r;
}

static inline MASK cotree_is_monotone(cotree_side_range r)
{
    return (r.slow >= COTREE_F(0.0)) | (r.fast <= COTREE_F(0.0));
}

/* Return a lower bound of an event function that has the values a and b at the ends of an interval:
 * the value at which the steepest possible lines through both ends intersect. */
static inline REAL cotree_lower_bound(cotree_side_range r, REAL a, REAL b, REAL width)
{
    return a + r.slow * ((a - b + r.fast * width) / (r.fast - r.slow));
}

/* Return whether an event function that has the values a and b at the ends of a step cannot reach
 * zero within it. Both values must be on the given side, at least `least` from zero. The rate is
 * assumed to be bounded by a multiple of the mean rates of this and the previous step. */
static inline MASK cotree_is_out_of_reach(REAL side, REAL a, REAL b, REAL moved_before, REAL least)
{
    const REAL moved = cotree_abs(b - a), distance = cotree_smaller(side * b, side * a);
    const REAL reach = COTREE_SCAN_REACH * cotree_larger(moved_before, moved);
    return distance > cotree_larger(reach, least);
}

#endif
