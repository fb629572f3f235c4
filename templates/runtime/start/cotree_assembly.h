/* cotree_assembly.h: positions and velocities on the constraints of a mechanism.
 * Part of the runtime of cotree, the same for every model.
 *
 * States that are marked in is_kept stay, and the others move by Gauss-Newton steps of least
 * length: coordinates first, then speeds. Turns count in radians and shifts in units of length, so
 * that results do not depend on units. Sensitivities follow to first order.
 *
 *     cotree_assembly_init(&a, &run, &tables, &room);    (twice: see cotree_run.h)
 *     a.is_kept[i] = ..., run.u = inputs
 *     cotree_assembly_measure(&a, t, x);                 (a start; after events a.length is 1)
 *     cotree_assembly_move(&a, t, x);
 *     cotree_assembly_move_sensitivities(&a, t, x, s);
 */
#ifndef COTREE_ASSEMBLY_H
#define COTREE_ASSEMBLY_H

#include "cotree_least.h"
#include "cotree_run.h"
#include "cotree_start_tables.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Results besides those of kernels. */
#define COTREE_ASSEMBLY_VIOLATED 100 /* what is kept contradicts the constraints */
#define COTREE_ASSEMBLY_STUCK 102    /* no motion follows a parameter: what is kept has to change */

typedef struct cotree_assembly {
    cotree_run *run;
    const cotree_assembly_tables *tables;
    int *is_kept;       /* n_states: states that stay */
    int holds[2];       /* whether conditions on coordinates and on speeds hold; 1 after init */
    cotree_real length; /* that a turn of one radian counts as, [m]; 1 after init */
    int culprit;        /* the row that is violated most, after a failure; -1: none */
    int column;         /* the sensitivity that nothing follows */
    /* The rest belongs to the assembly. */
    int n_own, *places, *is_free;
    cotree_real *residual, *conditions, *gradient, *start_gradient, *slopes, *start_slopes;
    cotree_real *values, *step, *change, *best, *trial, *aside, *parts;
    cotree_least least;
} cotree_assembly;

/* Has sensitivities where the run has. */
void cotree_assembly_init(cotree_assembly *a, cotree_run *run, const cotree_assembly_tables *tables,
                          cotree_room *room);

/* Sets length to what a turn moves for what a shift does, in the middle of all constraints. */
int cotree_assembly_measure(cotree_assembly *a, cotree_real t, const cotree_real *x);

/* Conditions on coordinates hold unless all of these are set, and so do those on speeds. */
void cotree_assembly_hold(cotree_assembly *a, const int *is_set);

/* Scales quaternions to the norm one. Returns COTREE_ASSEMBLY_VIOLATED where one is zero. */
int cotree_assembly_normalise(const cotree_assembly *a, cotree_real *x);

/* Moves the states that are not kept onto the constraints. */
int cotree_assembly_move(cotree_assembly *a, cotree_real t, cotree_real *x);

/* Whether the least of several moves was taken from one point to another. */
int cotree_assembly_is_chosen(cotree_assembly *a, cotree_real t, const cotree_real *from,
                              const cotree_real *to);

/* Adds to the sensitivities s at x, as they are given, what the states that are not kept follow
 * with. seeds: for each sensitivity a parameter, or -1 less a state, along which conditions do not
 * hold; NULL: constraints alone hold, and what cannot be followed is left. */
int cotree_assembly_move_sensitivities(cotree_assembly *a, cotree_real t, const cotree_real *x,
                                       const int *seeds, cotree_real *s);

/* Takes out of a direction of the states at x what changes norms of quaternions. */
void cotree_assembly_turn(const cotree_assembly *a, const cotree_real *x, cotree_real *direction);

/* Adds to a direction of the states at x what those that are not kept follow with at one level: 0
 * coordinates, 1 speeds. rates: changes of all rows along the direction. */
int cotree_assembly_follow(cotree_assembly *a, cotree_real t, const cotree_real *x, int level,
                           const cotree_real *rates, cotree_real *direction);

#ifdef __cplusplus
}
#endif

#endif
