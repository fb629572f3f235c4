/* cotree_stiff.h: a model in the form M z' = f(t, z) for implicit methods, with its linear systems.
 *
 * z holds all states, including algebraic unknowns, then their sensitivities by parameter without
 * those that are identically zero. M is diagonal: one for states, zero for algebraic unknowns. A
 * projection after each step solves the algebraic equations.
 *
 *     cotree_stiff stiff;
 *     cotree_stiff_init(&stiff, &run, newton, &arena);          (after cotree_run_init)
 *     ... a method with cotree_stiff_equation(&stiff), and d.project = cotree_stiff_project
 *     cotree_stiff_complete(&stiff, t, z);                     (run.full: with exact unknowns) */
#ifndef COTREE_STIFF_H
#define COTREE_STIFF_H

#include "cotree_integrator.h"
#include "cotree_lu.h"
#include "cotree_newton.h"
#include "cotree_run.h"

COTREE_BEGIN_DECLS

/* Largest number of rows of a matrix that is factorised with row exchanges if the planned pivots
 * fail. */
#define COTREE_STIFF_DENSE 200

typedef struct cotree_stiff {
    cotree_run *run;
    const cotree_newton *newton;
    long n_exchanged; /* number of factorisations with row exchanges */
    /* The rest is private. */
    cotree_real shift;
    int is_checked, is_dense;
    cotree_real *linear;       /* derivatives at the start of a step */
    const cotree_real *values; /* derivatives that were factorised last */
    cotree_real *carried, *couplings, *factors, *work, *given, *residual, *right;
    cotree_real *zero_sensitivities; /* zeros, used if only the states are integrated */
    cotree_lu dense;
    int *algebraic;
    int n_algebraic; /* number of entries of z that are algebraic unknowns */
} cotree_stiff;

void cotree_stiff_init(cotree_stiff *stiff, cotree_run *run, const cotree_newton *newton,
                       cotree_arena *arena);

/* Return the equation for an integrator. Its context is the cotree_stiff. */
cotree_implicit_equation cotree_stiff_equation(cotree_stiff *stiff);

/* Return whether points must be projected. cotree_stiff_project projects a point onto the
 * constraints, and its algebraic unknowns and their sensitivities onto their equations. */
int cotree_stiff_is_projected(const cotree_stiff *stiff);
int cotree_stiff_project(cotree_real t, cotree_real *z, void *context);

/* Write z to run->full, with algebraic unknowns that satisfy their equations up to rounding. */
int cotree_stiff_complete(cotree_stiff *stiff, cotree_real t, const cotree_real *z);

COTREE_END_DECLS

#endif
