/* cotree_integrator.h: types shared by all integrators. */
#ifndef COTREE_INTEGRATOR_H
#define COTREE_INTEGRATOR_H

#include "cotree_limits.h"

/* Compute dy = y'. Return 0; a positive number if a smaller step may succeed; a negative number to
 * stop the integration. context is the pointer passed to init. */
typedef int (*cotree_rate_function)(cotree_real t, const cotree_real *y, cotree_real *dy,
                                    void *context);

/* Project y onto the set of admissible solutions at t. Return 0, or another number on failure; a
 * smaller step is then tried. context is the pointer passed to init. */
typedef int (*cotree_projection_function)(cotree_real t, cotree_real *y, void *context);

/* Callback after a rejected step, before a shorter step is tried. */
typedef void (*cotree_rejection_function)(void *context);

/* The equation M y' = f(t, y) for implicit methods. The diagonal matrix M has zeros for algebraic
 * unknowns and ones elsewhere. Functions return the statuses of a rate function. */
typedef struct cotree_implicit_equation {
    int n; /* number of entries of y */
    int n_algebraic;
    const int *algebraic; /* n_algebraic: indices of the algebraic unknowns in y */
    int is_autonomous;    /* 1: f does not depend on t */
    cotree_rate_function rate;
    cotree_rate_function time_slope; /* df/dt; NULL: a finite difference is used */
    /* Evaluate and store the Jacobian J of f at a point. */
    int (*linearise)(cotree_real t, const cotree_real *y, void *context);
    /* Factorise shift M - J. */
    int (*factorise)(cotree_real shift, void *context);
    /* Solve in place with the full Jacobian of f, including second derivatives for
     * sensitivities. */
    int (*solve)(cotree_real *u, void *context);
    /* follow computes the changes of the algebraic unknowns if the other entries change by u.
     * is_bent returns whether the last projection moved the algebraic unknowns beyond the range in
     * which their equations are nearly linear. NULL unless projections solve for these unknowns. */
    int (*follow)(cotree_real *u, void *context);
    int (*is_bent)(void *context);
    void *context;
} cotree_implicit_equation;

/* Stiffness detection of an explicit method. */
typedef struct cotree_stiffness {
    int n;             /* the first n unknowns are monitored; 0: none */
    int is_found;      /* 1: stability limits the steps; an implicit method may need far fewer */
    cotree_real since; /* time from which stability limits the steps */
    long n_steps;      /* approximate number of limited steps since the detection */
    int n_stiff, n_soft, n_calm;
} cotree_stiffness;

/* Statuses of an integrator; cotree_status_message describes them. */
typedef enum cotree_status {
    COTREE_OK = 0,
    COTREE_BAD_ARGUMENT = 1,
    COTREE_TOO_MANY_STEPS = 2,  /* max_steps were tried in one call of integrate */
    COTREE_STEP_TOO_SMALL = 3,  /* the tolerances require steps below the resolution of t */
    COTREE_RATE_FAILED = 4,     /* the rates cannot be evaluated, with any step size */
    COTREE_RATE_NOT_FINITE = 5, /* a rate is not finite, with any step size */
    COTREE_RATE_STOPPED = 6,    /* the right-hand side returned a negative number */
#if COTREE_HAS_CONSTRAINTS || COTREE_HAS_ALGEBRAIC
    COTREE_PROJECTION_FAILED = 7, /* the projection fails, with any step size */
    COTREE_NOT_PROJECTED = 11,    /* the projection fails at a point to be stored */
#endif
#if COTREE_HAS_SUNDIALS
    COTREE_NO_MEMORY = 8,
    COTREE_NOT_FINITE = 9,
    COTREE_CANNOT_START = 12,
    COTREE_TOO_TIGHT = 13,
    COTREE_ERROR_TEST_FAILED = 14,
    COTREE_NOT_CONVERGED = 15,
    COTREE_SENSITIVITIES_FAILED = 16,
    COTREE_FLAGGED = 17,
#endif
#if COTREE_HAS_ALGEBRAIC
    COTREE_FOLD = 18, /* the algebraic unknowns reach a fold, or would jump to another solution */
#endif
    COTREE_NOT_SOLVED = 10 /* algebraic unknowns, or values that depend on them, cannot be found */
} cotree_status;

/* A status and its description. */
typedef struct cotree_message {
    int status;
    const char *text;
} cotree_message;

/* Return the description of a status. The last row, with a negative status, describes others. */
static inline const char *cotree_find_message(const cotree_message *rows, int status)
{
    while (rows->status >= 0 && rows->status != status) ++rows;
    return rows->text;
}

COTREE_BEGIN_DECLS

/* Return the description of a status as a clause. */
const char *cotree_status_message(cotree_status status);

COTREE_END_DECLS

#endif
