/* cotree_breakpoints.h: times at which functions of time have a kink or a step.
 * Part of the runtime of cotree, the same for every model.
 */
#ifndef COTREE_BREAKPOINTS_H
#define COTREE_BREAKPOINTS_H

#include "cotree_real.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Rows of 3 + 2 * n_sensitivities numbers: the first time; the period, or zero; 1 if no breakpoint
 * comes before the first, -1 if none comes after it, 0 otherwise; then the derivatives of the first
 * time and of the period by each parameter of sensitivity. A row whose first time is not finite has
 * no breakpoints. */
typedef struct cotree_breakpoints {
    int n, n_sensitivities;
    const cotree_real *rows;
} cotree_breakpoints;

/* Returns the next breakpoint after t towards t_end, or t_end. */
cotree_real cotree_next_breakpoint(const cotree_breakpoints *breakpoints, cotree_real t,
                                   cotree_real t_end);

/* Returns the largest magnitude among t_end and the times that later breakpoints are computed from:
 * breakpoints are known up to its rounding. */
cotree_real cotree_largest_breakpoint(const cotree_breakpoints *breakpoints, cotree_real t_end);

/* Returns whether t is a breakpoint. */
int cotree_is_breakpoint(const cotree_breakpoints *breakpoints, cotree_real t);

/* Writes the derivatives of a breakpoint by the parameters to slopes, and to spreads by how much
 * those of rows that meet there differ. At the start of a run, which does not move, the derivative
 * is zero and the rows differ from that. */
void cotree_find_breakpoint_slopes(const cotree_breakpoints *breakpoints, cotree_real t,
                                   int is_start, cotree_real *slopes, cotree_real *spreads);

#ifdef __cplusplus
}
#endif

#endif
