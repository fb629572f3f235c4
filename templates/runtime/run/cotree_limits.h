/* cotree_limits.h: tolerances and limits of several files. The first ones are also in class Limits
 * of tolerances.py. */
#ifndef COTREE_LIMITS_H
#define COTREE_LIMITS_H

#include "cotree_real.h"

/* A step fails if projection changes its end by more than this many tolerances on average. */
#define COTREE_MAX_PROJECTION COTREE_F(10.0)

/* Near singular positions, projection amplifies rounding errors. At relative tolerances below this
 * value, a step there may be changed by more than COTREE_MAX_PROJECTION tolerances. */
#define COTREE_ENLARGED_ROUNDING COTREE_SELECT(1e-8, 3.5e-04f)

/* A correction opposes its residual if the cosine of the angle between them is below the negative
 * of this value. */
#define COTREE_OPPOSED_COSINE COTREE_F(0.7)

/* Maximum number of steps of a projection, and limit of small corrections. A small correction that
 * is more than half the previous one is a rounding error, because Newton's method converges
 * quadratically. */
#define COTREE_MOST_PROJECTIONS 10
#define COTREE_SMALL_CORRECTION COTREE_SELECT(1e-08, 3.5e-04f)

/* Constraints are violated if a residual, in its unit, exceeds this fraction of max(1, largest
 * state). At a tolerance of 1e-8, trial steps near singular configurations do not exceed it. */
#define COTREE_LARGEST_RESIDUAL COTREE_SELECT(1e-06, 2.8e-03f)

/* Rates jump at a breakpoint if their difference across it exceeds their change over the same time
 * on one side by this factor. Smaller differences are due to rounding of the time. */
#define COTREE_JUMP_NOISE COTREE_F(1000.0)

/* A step of at most COTREE_STALL_SPACINGS units in the last place of the time makes no progress.
 * One such step may occur before a breakpoint; COTREE_STALL_STEPS of them in a row are a stall. */
#define COTREE_STALL_SPACINGS 16
#define COTREE_STALL_STEPS 5

/* A stiff run changes its method only if more than this many steps remain, because the other method
 * must first be compiled and needs a few hundred steps and matrices itself. */
#define COTREE_MOST_STIFF_STEPS 1000

/* Number of points of the interpolation polynomial, and maximum estimated error of interpolation
 * in tolerances, for explicit methods. */
#define COTREE_HISTORY_POINTS 6
#define COTREE_HISTORY_DOUBT COTREE_F(4.0)

/* The same maximum for all methods. Implicit methods are interpolated without rates. */
#define COTREE_DOUBT(uses_rates) ((uses_rates) ? COTREE_HISTORY_DOUBT : COTREE_F(1.0))

/* Planned pivots are accepted if the solution is exact for a matrix whose entries differ by at
 * most this fraction (backward error). */
#define COTREE_PLANNED_PIVOTS COTREE_SELECT(1e-10, 4.3e-05f)

/* Maximum length of a chain of simultaneous events that trigger each other. */
#define COTREE_EVENT_ROUNDS 50

/* Number of past times stored for each event. If all of them lie within a billionth of the span,
 * the event chatters. */
#define COTREE_EVENT_CROWD 100

/* In the search for zeros of event functions, values below this fraction of the largest value are
 * rounding errors. */
#define COTREE_SCAN_ROUNDING (COTREE_F(16.0) * COTREE_EPSILON)

/* An event function may touch zero within a step only if its distance from zero is at most this
 * many times its range in the step. */
#define COTREE_SCAN_REACH COTREE_F(2.0)

/* The second difference of a quantity over a step is at most COTREE_SCAN_CURVATURE times the
 * difference of its changes in this and the previous step, plus COTREE_SCAN_UNEVEN times its
 * change. */
#define COTREE_SCAN_CURVATURE COTREE_F(2.0)
#define COTREE_SCAN_UNEVEN COTREE_F(0.1)

#endif
