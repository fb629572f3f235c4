/* cotree_stiff.h: a model as implicit methods need it, with its linear systems.
 * Part of the runtime of cotree, the same for every model.
 *
 * The vector z holds all states, algebraic unknowns included, then their sensitivities parameter by
 * parameter, those left out that vanish at all times: M z' = f(t, z) with a constant M, one for
 * states and zero for algebraic unknowns. A projection brings these back to their equations after
 * each step.
 *
 *     cotree_stiff stiff;
 *     cotree_stiff_init(&stiff, &run, newton, &room);               (after cotree_run_init)
 *     ... a method that takes cotree_stiff_equation(&stiff), and d.project = cotree_stiff_project
 *     cotree_stiff_complete(&stiff, t, z);                          (run.full: with exact unknowns)
 */
#ifndef COTREE_STIFF_H
#define COTREE_STIFF_H

#include "cotree_integrator.h"
#include "cotree_newton.h"
#include "cotree_run.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Matrices up to this size are factorised with row exchanges where the planned pivots do not do. */
#define COTREE_STIFF_DENSE 200

typedef struct cotree_stiff {
    cotree_run *run;
    const cotree_newton *newton;
    long n_exchanged; /* how many matrices were factorised with row exchanges */
    /* The rest belongs to it. */
    cotree_real shift;
    int is_looked_at, is_dense;
    cotree_real *linear;       /* the derivatives that steps are made of */
    const cotree_real *values; /* those that are factorised */
    cotree_real *carried, *couplings, *factors, *work, *given, *left, *right;
    cotree_real
        *alone; /* zeros for the sensitivities of a model whose states are integrated alone */
    cotree_lu dense;
    int *algebraic;
    int n_algebraic; /* of z */
} cotree_stiff;

void cotree_stiff_init(cotree_stiff *stiff, cotree_run *run, const cotree_newton *newton,
                       cotree_room *room);

/* Gives what an integrator takes; its context is the structure. */
cotree_implicit_equation cotree_stiff_equation(cotree_stiff *stiff);

/* Moves a point onto the constraints, and the algebraic unknowns, with their sensitivities, to
 * where they solve their equations; and tells whether there is anything to do. */
int cotree_stiff_is_projected(const cotree_stiff *stiff);
int cotree_stiff_project(cotree_real t, cotree_real *z, void *context);

/* Writes z to run->full, with algebraic unknowns that satisfy their equations to rounding. */
int cotree_stiff_complete(cotree_stiff *stiff, cotree_real t, const cotree_real *z);

#ifdef __cplusplus
}
#endif

#endif
