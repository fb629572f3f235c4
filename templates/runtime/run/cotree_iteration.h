/* cotree_iteration.h: Newton's method with damping.
 * Part of the runtime of cotree, the same for every model.
 *
 * The caller holds the matrix and the steps. With damping, a share of a step is accepted if the
 * next step with the same matrix is shorter (natural monotonicity test: P. Deuflhard, Newton
 * Methods for Nonlinear Problems, Springer 2004, section 3.3). */
#ifndef COTREE_ITERATION_H
#define COTREE_ITERATION_H

#include "cotree_real.h"

COTREE_BEGIN_DECLS

/* A result besides those of the functions: there is no further step, or no share is accepted. */
#define COTREE_NO_STEP 61

/* Limits of the sizes of steps, and of their number. */
typedef struct cotree_newton_limits {
    int max_steps;
    cotree_real rounding; /* a step below it is the last one */
    cotree_real small;    /* so is one below this that is not half the one before */
    /* Of damping: steps below this that cannot be reduced are rounding; the least share. */
    cotree_real stalled, min_share;
} cotree_newton_limits;

typedef struct cotree_iteration {
    /* Compute the step at x, and its size; 0 ends the iteration. is_new: with the matrix of this
     * point, else with that of the last one. */
    int (*step)(const struct cotree_iteration *a, int is_new, cotree_real *size);
    /* Move x from the last point with a new matrix by a share of its step. NULL: there is no
     * damping, and step moves x itself. */
    int (*move)(const struct cotree_iteration *a, cotree_real share);
    void *context;     /* of these functions */
    cotree_real t, *x; /* time, and unknowns */
    const cotree_newton_limits *limits;
    cotree_real size; /* of the last step with a new matrix */
} cotree_iteration;

/* Iterate to a solution. Return 0, a status of the functions, or COTREE_NO_STEP. */
int cotree_iterate(cotree_iteration *a);

COTREE_END_DECLS

#endif
