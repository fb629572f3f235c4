/* cotree_limits.h: limits that several files share. Python has those of the first part in
 * tolerances.py, too.
 * Part of the runtime of cotree, the same for every model.
 */
#ifndef COTREE_LIMITS_H
#define COTREE_LIMITS_H

#include "cotree_real.h"

/* A step whose end constraints would move by so many tolerances, in the mean, has failed. */
#define COTREE_FARTHEST COTREE_F(10.0)

/* The cosine of corrections that go against what is left of the equations that they solve. */
#define COTREE_TURNED COTREE_F(0.7)

/* Steps of a projection at most. One below ``small_correction`` that no longer halves is
 * rounding, since Newton's method squares its errors. */
#define COTREE_MOST_PROJECTIONS 10

#define COTREE_SMALL_CORRECTION COTREE_SELECT(1e-08, 3.5e-04f)

/* Residuals, in the constraints' own units, above this share of the largest state (or of 1) are
 * not met. Near a singular configuration, along what the constraints hardly see, those of trial
 * steps at a tolerance of 1e-8 still lie below it. */
#define COTREE_LARGEST_RESIDUAL COTREE_SELECT(1e-06, 2.8e-03f)

/* Rates jump where they differ by more than this many times what they change by within as much
 * time on one side of a breakpoint: that is rounding of its time. */
#define COTREE_NOISE COTREE_F(1000.0)

/* Steps of a few units in the last place get nowhere; one of them is normal before a
 * breakpoint, so many in a row are not. */
#define COTREE_STALL_SPACINGS 16

#define COTREE_STALL_STEPS 5

/* Of a stiff problem fewer steps than these are not worth another method, which takes some
 * hundred steps and evaluations of matrices, too, and has to be made. */
#define COTREE_MOST_STIFF_STEPS 1000

/* How often one event may make others happen at the same time. */
#define COTREE_EVENT_ROUNDS 50

/* Points of a run that interpolation reads from. Estimated errors of what an explicit method
 * reads are kept below so many tolerances. */
#define COTREE_HISTORY_POINTS 6

#define COTREE_HISTORY_DOUBT COTREE_F(4.0)

/* Planned pivots do where they solve a system that differs from the true one by at most this
 * share of each entry. */
#define COTREE_PLANNED_PIVOTS COTREE_SELECT(1e-10, 4.3e-05f)

/* So many of one event within a billionth of the span are too many. */
#define COTREE_EVENT_CROWD 100

/* The search for switches. Values of event functions below this share of the largest are rounding.
 */
#define COTREE_SCAN_ROUNDING (COTREE_F(16.0) * COTREE_EPSILON)

/* Values more times their range in a step away from zero than this do not turn round there. */
#define COTREE_SCAN_FAR COTREE_F(2.0)

/* Between both ends of a step a quantity bends by no more than so many times what its change
 * differs by from that of the step before, with this share of it. */
#define COTREE_SCAN_BENT COTREE_F(2.0)
#define COTREE_SCAN_UNEVEN COTREE_F(0.1)

#endif
