/* cotree_breakpoints.h: time events, at which functions of time have a kink or a jump. */
#ifndef COTREE_BREAKPOINTS_H
#define COTREE_BREAKPOINTS_H

#include "cotree_real.h"
#if COTREE_HAS_STEPS
#include "cotree_job.h"
#endif

COTREE_BEGIN_DECLS

/* Series of breakpoints, one row of 3 + 2 * n_sensitivities numbers each: the first time; the
 * period, or zero; 1 if there is no breakpoint before the first time, -1 if there is none after
 * it, 0 otherwise; then the derivatives of the first time and of the period with respect to the
 * sensitivity parameters. A row whose first time is not finite has no breakpoints. */
typedef struct cotree_breakpoints {
    int n, n_sensitivities;
    const cotree_real *rows;
} cotree_breakpoints;

/* Return the next breakpoint after t towards t_end, or t_end if there is none. */
cotree_real cotree_next_breakpoint(const cotree_breakpoints *breakpoints, cotree_real t,
                                   cotree_real t_end);

/* Return the largest magnitude of t_end and of the first times of periodic series, which
 * determines the rounding errors of breakpoints. */
cotree_real cotree_largest_breakpoint(const cotree_breakpoints *breakpoints, cotree_real t_end);

/* Return whether t is a breakpoint. */
int cotree_is_breakpoint(const cotree_breakpoints *breakpoints, cotree_real t);

/* Compute slopes, the derivatives of a breakpoint time with respect to the parameters, and spreads,
 * the largest differences among the rows that coincide there. The start of a run is fixed: its
 * derivatives are zero, and spreads are the differences from zero. */
void cotree_find_breakpoint_slopes(const cotree_breakpoints *breakpoints, cotree_real t,
                                   int is_start, cotree_real *slopes, cotree_real *spreads);

#if COTREE_HAS_STEPS
/* The largest number of breakpoints of one series and of a run, and of numbers stored for them.
 * More breakpoints indicate wrong units. */
#define COTREE_MOST_OF_SERIES 10000000
#define COTREE_MOST_BREAKPOINTS 20000000
#define COTREE_MOST_BREAKPOINT_NUMBERS 30000000

/* Return the shortest period, or zero if there is none. */
cotree_real cotree_shortest_period(const cotree_breakpoints *breakpoints);

/* Return an upper bound of the number of breakpoints from t to t_end, including both, or -1 if one
 * of the limits above is exceeded. */
int cotree_most_breakpoints(const cotree_breakpoints *breakpoints, cotree_real t,
                            cotree_real t_end);

/* Write t, the breakpoints after t and t_end to times. Return their number, which is at most
 * cotree_most_breakpoints. */
int cotree_list_breakpoints(const cotree_breakpoints *breakpoints, cotree_real t, cotree_real t_end,
                            cotree_real *times);

/* Set the breakpoints of a job from t to t_end, after its tolerances. memory has space for their
 * times, and for their derivatives if they depend on parameters: cotree_most_breakpoints times
 * (1 + 2 n_sensitivities) numbers. begin: fixed start of the run. sizes and seeds: as for
 * cotree_job_set_tolerances. tolerances: space for n_sensitivities numbers. */
void cotree_job_set_breakpoints(cotree_job *job, const cotree_breakpoints *breakpoints,
                                cotree_real t, cotree_real t_end, cotree_real begin,
                                const cotree_real *sizes, const int *seeds, cotree_real *memory,
                                cotree_real *tolerances);
#endif

COTREE_END_DECLS

#endif
