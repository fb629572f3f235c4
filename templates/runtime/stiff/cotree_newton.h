/* cotree_newton.h: what an implicit method needs of a model besides its kernels.
 * Part of the runtime of cotree, the same for every model.
 */
#ifndef COTREE_NEWTON_H
#define COTREE_NEWTON_H

#include "cotree_abi.h"

#ifdef __cplusplus
extern "C" {
#endif

/* How many blocks are solved for at a time where there are several. */
#define COTREE_NEWTON_BLOCKS 8

/* The matrix is shift M - J: M is one on the diagonal, but zero for algebraic unknowns, and J the
 * Jacobian, whose nonzeros are the values. Pivots are chosen beforehand: look at what comes out. */
typedef struct cotree_newton {
    int n_factors;
    int is_autonomous; /* rates depend on neither time nor inputs */
    int n_carried;     /* values that curvature writes */
    int n_couplings;   /* values that curvature_along writes */
    const int *places; /* of these among the sensitivities */
    /* NULL where the matrix is always singular */
    void (*factorise)(const cotree_real *values, cotree_real shift, cotree_real *factors);
    /* Solves for blocks that follow each other, in place; work: COTREE_NEWTON_BLOCKS n_states. */
    void (*solve)(const cotree_real *factors, int n_blocks, cotree_real *b, cotree_real *work);
    /* The derivatives of all rates by time, where inputs are the scene's own; NULL where they are
     * zero. */
    cotree_sensitivity_kernel time_slope;
    /* How the rates of sensitivities change along a direction of the states; NULL where they don't.
     */
    cotree_sensitivity_kernel curvature;
    cotree_parameter_kernel curvature_along;
} cotree_newton;

#ifdef __cplusplus
}
#endif

#endif
