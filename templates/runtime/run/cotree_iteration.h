/* cotree_iteration.h: Newton's method with damping.
 *
 * The caller holds the matrix and the steps. With damping, a share of a step is accepted if the
 * next step with the same matrix is shorter (natural monotonicity test: P. Deuflhard, Newton
 * Methods for Nonlinear Problems, Springer 2004, section 3.3). */
#ifndef COTREE_ITERATION_H
#define COTREE_ITERATION_H

#include "cotree_real.h"

COTREE_BEGIN_DECLS

/* Result in addition to those of the callbacks: no further step exists, or no damped step is
 * accepted. */
#define COTREE_NO_STEP 61

/* Limits of step sizes, and of the number of steps. */
typedef struct cotree_newton_limits {
    int max_steps;
    cotree_real rounding; /* a step below this is the last one */
    cotree_real small;    /* so is a step below this that is not half the previous one */
    /* Limits of damping: steps below `stalled` that cannot be reduced are rounding; `min_share`
     * is the smallest damping factor. */
    cotree_real stalled, min_share;
} cotree_newton_limits;

typedef struct cotree_iteration {
    /* Compute the step at x, and its size; 0 ends the iteration. is_new: with the matrix of this
     * point, else with that of the last one. */
    int (*step)(const struct cotree_iteration *a, int is_new, cotree_real *size);
    /* Move x from the last point with a new matrix by a fraction of its step. NULL: no damping;
     * step moves x itself. */
    int (*move)(const struct cotree_iteration *a, cotree_real share);
    void *context;     /* passed to the callbacks */
    cotree_real t, *x; /* time, and unknowns */
    const cotree_newton_limits *limits;
    cotree_real size; /* size of the last step with a new matrix */
} cotree_iteration;

/* Iterate to a solution. Return 0, a status of the functions, or COTREE_NO_STEP. */
int cotree_iterate(cotree_iteration *a);

COTREE_END_DECLS

#endif
