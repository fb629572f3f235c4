/* cotree_iteration.h: damped Newton iteration.
 *
 * The caller computes the matrix and the steps. With damping, a fraction of a step is accepted if
 * the next step with the same matrix is shorter (natural monotonicity test: P. Deuflhard, Newton
 * Methods for Nonlinear Problems, Springer 2004, section 3.3). */
#ifndef COTREE_ITERATION_H
#define COTREE_ITERATION_H

#include "cotree_real.h"

COTREE_BEGIN_DECLS

/* Additional status: no step can be computed, or no damped step is accepted. */
#define COTREE_NO_STEP 61

/* Limits of the size and number of steps. */
typedef struct cotree_newton_limits {
    int max_steps;
    cotree_real rounding; /* a step shorter than this is the last one */
    cotree_real small;    /* also the last: a step below this and above half the previous */
    /* stalled: if the iteration cannot progress, steps below this size count as rounding errors.
     * min_share: smallest damping factor. */
    cotree_real stalled, min_share;
} cotree_newton_limits;

typedef struct cotree_iteration {
    /* Compute the Newton step at x and its size; size 0 ends the iteration. is_new: 1 to form the
     * matrix at this point, 0 to use the previous one. */
    int (*step)(const struct cotree_iteration *a, int is_new, cotree_real *size);
    /* Set x to the point of the last new matrix plus a fraction of the step from there. NULL: no
     * damping; step itself updates x. */
    int (*move)(const struct cotree_iteration *a, cotree_real share);
    void *context;     /* argument that is passed to the callbacks */
    cotree_real t, *x; /* time; unknowns, updated at each step */
    const cotree_newton_limits *limits;
    cotree_real size; /* size of the last step with a new matrix */
} cotree_iteration;

/* Iterate to a solution. Return 0, a status of the callbacks, or COTREE_NO_STEP. */
int cotree_iterate(cotree_iteration *a);

COTREE_END_DECLS

#endif
