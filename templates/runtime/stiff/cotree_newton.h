/* cotree_newton.h: kernels of a model for implicit methods. */
#ifndef COTREE_NEWTON_H
#define COTREE_NEWTON_H

#include "cotree_abi.h"

/* Maximum number of blocks in one call of solve. */
#define COTREE_NEWTON_BLOCKS 8

/* The linear systems have the matrix shift M - J, with the Jacobian J in compressed columns and a
 * diagonal M: one for states, zero for algebraic unknowns. The pivot order is chosen in advance, so
 * solutions must be checked. */
typedef struct cotree_newton {
    int n_factors;
    int is_autonomous; /* 1: rates depend on neither time nor inputs */
    int n_carried;     /* number of values that curvature writes */
    int n_couplings;   /* number of values that curvature_along writes */
    const int *places; /* indices of the couplings among the sensitivities */
    /* Factorise. NULL if the matrix is structurally singular. */
    void (*factorise)(const cotree_real *values, cotree_real shift, cotree_real *factors);
    /* Solve for adjacent blocks in place. work: COTREE_NEWTON_BLOCKS n_states numbers. */
    void (*solve)(const cotree_real *factors, int n_blocks, cotree_real *b, cotree_real *work);
    /* Compute the time derivatives of all rates, with the inputs of the scene; NULL if they are
     * zero. */
    cotree_sensitivity_kernel time_slope;
    /* curvature computes values at a point; from these, curvature_along computes the derivatives
     * of the sensitivities' rates along a direction of the states. NULL: the derivatives are
     * zero. */
    cotree_sensitivity_kernel curvature;
    cotree_parameter_kernel curvature_along;
} cotree_newton;

#endif
