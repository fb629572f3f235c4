/* cotree_newton.h: kernels of a model for implicit methods. */
#ifndef COTREE_NEWTON_H
#define COTREE_NEWTON_H

#include "cotree_abi.h"

/* The largest number of blocks in one call of solve. */
#define COTREE_NEWTON_BLOCKS 8

/* The matrix is shift M - J, with the Jacobian J in compressed columns and a diagonal M: one for
 * states, zero for algebraic unknowns. The order of pivots is planned, so that the solution
 * needs a check. */
typedef struct cotree_newton {
    int n_factors;
    int is_autonomous; /* rates depend on neither time nor inputs */
    int n_carried;     /* values that curvature writes */
    int n_couplings;   /* values that curvature_along writes */
    const int *places; /* places of couplings among the sensitivities */
    /* NULL if the matrix is structurally singular */
    void (*factorise)(const cotree_real *values, cotree_real shift, cotree_real *factors);
    /* Solve for adjacent blocks in place; work: COTREE_NEWTON_BLOCKS n_states numbers. */
    void (*solve)(const cotree_real *factors, int n_blocks, cotree_real *b, cotree_real *work);
    /* Time derivatives of all rates, with the scene's own inputs; NULL if they are zero. */
    cotree_sensitivity_kernel time_slope;
    /* Derivatives of the rates of sensitivities along a direction of the states; NULL if zero. */
    cotree_sensitivity_kernel curvature;
    cotree_parameter_kernel curvature_along;
} cotree_newton;

#endif
