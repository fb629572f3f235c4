/* cotree_integrator.h: what the integrators of cotree share.
 * Part of the runtime of cotree, the same for every model.
 */
#ifndef COTREE_INTEGRATOR_H
#define COTREE_INTEGRATOR_H

#include "cotree_limits.h"

/* Writes y' to dy. Returns 0; a positive number if a smaller step may help; a negative one to stop
 * the integration. context is what init was given. */
typedef int (*cotree_rate_function)(cotree_real t, const cotree_real *y, cotree_real *dy,
                                    void *context);

/* Moves y to where a solution may be at t. Returns 0; or another number if it cannot, for a smaller
 * step to be tried. context is what init was given. */
typedef int (*cotree_projection_function)(cotree_real t, cotree_real *y, void *context);

/* Is told that a step failed and is tried again, shorter. */
typedef void (*cotree_rejection_function)(void *context);

/* M y' = f(t, y) as implicit methods need it. M is one on its diagonal, but zero for algebraic
 * unknowns. Functions return as a rate does. */
typedef struct cotree_implicit_equation {
    int n; /* of y */
    int n_algebraic;
    const int *algebraic; /* n_algebraic: their places in y */
    int is_autonomous;    /* f does not depend on t */
    cotree_rate_function rate;
    cotree_rate_function time_slope; /* derivatives of f by t; NULL: by a difference */
    /* Keeps the derivatives of f at a point, for what follows. */
    int (*linearise)(cotree_real t, const cotree_real *y, void *context);
    /* Factors shift M - J. */
    int (*factorise)(cotree_real shift, void *context);
    /* Solves with all derivatives of f in place of J; in place. */
    int (*solve)(cotree_real *u, void *context);
    /* Of algebraic unknowns that a projection brings back to their equations: writes by how much
     * they change where the others change by u; and tells whether the last projection went farther
     * than the equations are nearly linear. NULL where no projection does. */
    int (*follow)(cotree_real *u, void *context);
    int (*is_bent)(void *context);
    void *context;
} cotree_implicit_equation;

/* What an explicit method finds out about the steps that it took. */
typedef struct cotree_stiffness {
    int n;        /* of the first unknowns, which it looks at; 0: it does not look */
    int is_found; /* steps are as short as stability asks: an implicit method may take far fewer */
    cotree_real since; /* the time from which on they are */
    long n_steps;      /* about how many were so since it was found */
    int n_stiff, n_soft, n_calm;
} cotree_stiffness;

typedef enum cotree_status {
    COTREE_OK = 0,           /* all is well */
    COTREE_BAD_ARGUMENT = 1, /* a size, time, tolerance or initial value is out of range */
    COTREE_TOO_MANY_STEPS =
        2, /* too many steps are needed: max_steps were tried in one call of integrate */
    COTREE_STEP_TOO_SMALL = 3, /* the step size fell to rounding level: the tolerances ask for steps
                                  below the resolution of t */
    COTREE_RATE_FAILED = 4,    /* the right-hand side fails: however small the step */
    COTREE_RATE_NOT_FINITE = 5, /* the right-hand side is not finite: however small the step */
    COTREE_RATE_STOPPED =
        6, /* the right-hand side stopped the integration: it returned a negative number */
    COTREE_PROJECTION_FAILED = 7, /* the projection onto the constraints fails, or moves a step by
                                     many tolerances: however small the step */
    COTREE_NO_MEMORY = 8,         /* SUNDIALS got no memory */
    COTREE_NOT_FINITE = 9,        /* the solution is no longer finite */
    COTREE_NOT_SOLVED = 10,    /* the algebraic unknowns cannot be solved for: or what needs them */
    COTREE_NOT_PROJECTED = 11, /* the constraints cannot be met: where a point is kept */
    COTREE_CANNOT_START = 12,  /* it cannot start */
    COTREE_TOO_TIGHT = 13,     /* the tolerances are too tight for double precision */
    COTREE_ERROR_TEST_FAILED =
        14, /* the error test fails again and again, or the step size fell to its least */
    COTREE_NOT_CONVERGED =
        15, /* Newton's method fails again and again, or the step size fell to its least */
    COTREE_SENSITIVITIES_FAILED = 16, /* the rates of sensitivities fail */
    COTREE_FLAGGED = 17               /* the integrator gives a flag of its own */
} cotree_status;

#ifdef __cplusplus
extern "C" {
#endif

/* Says what a status means, as the end of a sentence. */
const char *cotree_status_message(cotree_status status);

#ifdef __cplusplus
}
#endif

#endif
