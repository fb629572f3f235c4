/* cotree_assembly.h: projection of coordinates and speeds onto the constraints of a mechanism.
 *
 * States marked in is_kept are prescribed. The others change by minimum-norm Gauss-Newton steps:
 * coordinates first, then speeds. Rotations are measured in radians and translations in units of
 * a characteristic length, so that the results do not depend on units. Sensitivities follow to
 * first order.
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

/* Results in addition to those of kernels. */
#define COTREE_ASSEMBLY_VIOLATED 100 /* prescribed states contradict the constraints */
#define COTREE_ASSEMBLY_STUCK                                                                      \
    102 /* a derivative does not exist, since prescribed states would have to change */

typedef struct cotree_assembly {
    cotree_run *run;
    const cotree_assembly_tables *tables;
    int *is_kept;       /* n_states: 1 for prescribed states */
    int holds[2];       /* 1, the default: conditions on coordinates, and on speeds, are included */
    cotree_real length; /* characteristic length of a rotation by one radian, [m]; 1 by default */
    int culprit;        /* after a failure: the row with the largest residual; -1: none */
    int column;         /* the sensitivity that does not exist */
    /* The rest is private. */
    int n_own, *places, *is_free;
    int level; /* present level of the iteration */
    cotree_real left,
        smallest; /* its largest residual at the present point, and the smallest of those */
    cotree_real *residual, *conditions, *gradient, *start_gradient, *slopes, *start_slopes;
    cotree_real *values, *step, *change, *best, *trial, *aside, *parts;
    cotree_real longest; /* row of the gradients factorised last */
    cotree_least least;
#if COTREE_HAS_MENDING
    /* For given values that may change if the constraints cannot be satisfied otherwise. */
    cotree_start_report *report; /* NULL: they may not change */
    int is_mended[2];            /* whether those of a level have changed */
    int is_probe;                /* 1: at a point next to a start, without a report */
    int has_way, n_chosen;
    int *is_giving;  /* n_speeds: directions whose given values change */
    int *is_dropped; /* n_conditions: those that are dropped */
    int *value_of;   /* n_speeds: the value that fixes a direction, or -1 */
    int *candidates, *is_chosen;
    cotree_real *moves, *spanned, *target, *extra, *found;
    cotree_least given;
#endif
} cotree_assembly;

/* Initialise. The run decides whether there are sensitivities. */
void cotree_assembly_init(cotree_assembly *a, cotree_run *run, const cotree_assembly_tables *tables,
                          cotree_arena *arena);

/* Allow given values to change, those of the highest rank first, if the constraints cannot be
 * satisfied otherwise. */
void cotree_assembly_report_to(cotree_assembly *a, cotree_start_report *report,
                               cotree_arena *arena);

/* Compute length, the median lever arm (translation per rotation) of the constraint gradients. */
int cotree_assembly_measure(cotree_assembly *a, cotree_real t, const cotree_real *x);

/* Set whether conditions are included: those on coordinates unless all coordinates are set,
 * those on speeds likewise. */
void cotree_assembly_hold(cotree_assembly *a, const int *is_set);

/* Return the n-th of pseudo-random numbers, uniformly distributed with mean zero and standard
 * deviation one. */
cotree_real cotree_pseudo_random(int n);

/* Return whether constraints are dependent at x, or so nearly that rates are evaluated on them. */
int cotree_assembly_is_dependent(cotree_assembly *a, cotree_real t, const cotree_real *x);

/* Compute the gradients of the constraints of speeds, rows of n_speeds, scaled to a largest norm
 * of one per group, and the singular value below which they are nearly dependent. */
int cotree_assembly_gradients(cotree_assembly *a, cotree_real t, const cotree_real *x,
                              cotree_real *rows, cotree_real *weakest);

/* Normalise quaternions. Return COTREE_ASSEMBLY_VIOLATED if one is zero. */
int cotree_assembly_normalise(const cotree_assembly *a, cotree_real *x);

/* Project the states that are not prescribed onto the constraints. */
int cotree_assembly_move(cotree_assembly *a, cotree_real t, cotree_real *x);

/* Return whether the projection between two points was one of several. */
int cotree_assembly_is_chosen(cotree_assembly *a, cotree_real t, const cotree_real *from,
                              const cotree_real *to);

/* Complete the sensitivities s at x, which are prescribed for some states, by those of the
 * others. seeds: for each sensitivity a parameter, or -1 less a state, for which conditions are
 * not included; or NULL: only constraints are included, and derivatives that do not exist are
 * ignored. */
int cotree_assembly_move_sensitivities(cotree_assembly *a, cotree_real t, const cotree_real *x,
                                       const int *seeds, cotree_real *s);

/* Remove from a direction of the states at x the changes of quaternion norms. */
void cotree_assembly_turn(const cotree_assembly *a, const cotree_real *x, cotree_real *direction);

/* Complete a direction of the states at x by those that are not prescribed, at one level: 0
 * coordinates, 1 speeds. rates: changes of all rows along the direction. */
int cotree_assembly_follow(cotree_assembly *a, cotree_real t, const cotree_real *x, int level,
                           const cotree_real *rates, cotree_real *direction);

COTREE_END_DECLS

#endif
