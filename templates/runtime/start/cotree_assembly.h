/* cotree_assembly.h: projection of coordinates and speeds onto the constraints of a mechanism.
 *
 * States marked in is_kept are prescribed. The others change by minimum-norm Gauss-Newton steps:
 * coordinates first, then speeds. Rotations are measured in radians and translations in units of a
 * characteristic length, so that the results do not depend on units. Sensitivities follow from the
 * linearised constraints.
 *
 *     cotree_assembly_init(&a, &run, &tables, &arena);    (twice: see cotree_run.h)
 *     a.is_kept[i] = ..., run.u = inputs
 *     cotree_assembly_measure(&a, t, x);                 (at a start; after events a.length is 1)
 *     cotree_assembly_move(&a, t, x);
 *     cotree_assembly_move_sensitivities(&a, t, x, seeds, s); */
#ifndef COTREE_ASSEMBLY_H
#define COTREE_ASSEMBLY_H

#include "cotree_iteration.h"
#include "cotree_least.h"
#include "cotree_run.h"
#include "cotree_start_tables.h"

COTREE_BEGIN_DECLS

/* Statuses in addition to those of kernels. */
#define COTREE_ASSEMBLY_VIOLATED 100 /* prescribed states violate the constraints */
#define COTREE_ASSEMBLY_STUCK                                                                      \
    102 /* a sensitivity is undefined: prescribed states would have to change */

typedef struct cotree_assembly {
    cotree_run *run;
    const cotree_assembly_tables *tables;
    int *is_kept;       /* n_states: 1 if the state is prescribed */
    int holds[2];       /* include conditions on coordinates [0] and on speeds [1]; 1 by default */
    cotree_real length; /* characteristic length that corresponds to one radian, [m]; default 1 */
    int culprit;        /* after a failure: row with the largest residual, or -1 */
    int column;         /* index of the sensitivity that is undefined */
    /* The rest is private. */
    int n_own, *places;
    int *value_of;              /* n_speeds: prescribed state that fixes the direction, or -1 */
    int level;                  /* level of the current assembly: 0 coordinates, 1 speeds */
    cotree_real left, smallest; /* largest residual at the current point; minimum of these so far */
    cotree_real *residual, *conditions, *gradient, *start_gradient, *slopes, *start_slopes;
    cotree_real *values, *step, *change, *best, *trial, *aside, *parts;
    cotree_real longest; /* norm of the longest gradient factorised last */
    cotree_least least;
#if COTREE_HAS_MENDING
    /* Prescribed values that may change if the constraints cannot be satisfied otherwise. */
    cotree_start_report *report; /* reports changes; NULL: prescribed values may not change */
    int is_mended[2];            /* 1: prescribed values of this level have changed */
    int is_probe;                /* 1: evaluates a point next to the start, without a report */
    int has_way, n_chosen;
    int *is_giving;  /* n_speeds: 1 if the prescribed value of this direction changes */
    int *is_dropped; /* n_conditions: 1 if the condition is dropped */
    int *candidates, *is_chosen;
    cotree_real *target, *extra, *found;
    cotree_least given, span; /* span: changes of the residuals by all prescribed values */
#endif
} cotree_assembly;

/* Initialise. The run determines whether sensitivities are computed. */
void cotree_assembly_init(cotree_assembly *a, cotree_run *run, const cotree_assembly_tables *tables,
                          cotree_arena *arena);

/* Allow prescribed values to change, highest rank first, if the constraints cannot be satisfied
 * otherwise. */
void cotree_assembly_report_to(cotree_assembly *a, cotree_start_report *report,
                               cotree_arena *arena);

/* Compute a->length, the median lever arm (ratio of translation to rotation) in the constraint
 * gradients. */
int cotree_assembly_measure(cotree_assembly *a, cotree_real t, const cotree_real *x);

/* Choose the included conditions: those on coordinates unless all coordinates are prescribed, and
 * those on speeds unless all speeds are prescribed. */
void cotree_assembly_hold(cotree_assembly *a, const int *is_set);

/* Return the n-th of a fixed sequence of pseudo-random numbers, uniformly distributed with mean
 * zero and standard deviation one. */
cotree_real cotree_pseudo_random(int n);

/* Return whether constraints at x are dependent, or so nearly dependent that rates must be
 * evaluated at projected points. */
int cotree_assembly_is_dependent(cotree_assembly *a, cotree_real t, const cotree_real *x);

/* Compute the gradients of the constraints on speeds, in rows of n_speeds, scaled so that the
 * longest of each group has norm one, and the singular value below which they count as nearly
 * dependent. */
int cotree_assembly_gradients(cotree_assembly *a, cotree_real t, const cotree_real *x,
                              cotree_real *rows, cotree_real *weakest);

/* Normalise quaternions. Return COTREE_ASSEMBLY_VIOLATED if one is zero. */
int cotree_assembly_normalise(const cotree_assembly *a, cotree_real *x);

/* Project the states that are not prescribed onto the constraints. */
int cotree_assembly_move(cotree_assembly *a, cotree_real t, cotree_real *x);

/* Return whether the projection from one point to another is ambiguous because free directions
 * outnumber independent rows. */
int cotree_assembly_is_chosen(cotree_assembly *a, cotree_real t, const cotree_real *from,
                              const cotree_real *to);

/* Compute the sensitivities s of the free states from the sensitivities of the prescribed states.
 * seeds: for each sensitivity a parameter index, or -1 - i for the initial value of state i, for
 * which conditions are excluded. seeds = NULL: only constraints are included, and undefined
 * derivatives are ignored. */
int cotree_assembly_move_sensitivities(cotree_assembly *a, cotree_real t, const cotree_real *x,
                                       const int *seeds, cotree_real *s);

/* Remove the components along quaternions, which would change norms, from a direction of the
 * states at x. */
void cotree_assembly_turn(const cotree_assembly *a, const cotree_real *x, cotree_real *direction);

/* Compute the entries of a direction for the free states of one level (0 coordinates, 1 speeds) at
 * the states x. rates: changes of all rows along the direction. */
int cotree_assembly_follow(cotree_assembly *a, cotree_real t, const cotree_real *x, int level,
                           const cotree_real *rates, cotree_real *direction);

COTREE_END_DECLS

#endif
