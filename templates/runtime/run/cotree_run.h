/* cotree_run.h: a model in the form w' = f(t, w) for integrators.
 *
 * w holds the states, then their sensitivities by parameter without those that always vanish.
 * Algebraic unknowns are solved for at each point; if the model has rates for them, they may be
 * part of w (cotree_run_extend between init and narrow). Constraints are satisfied by projection.
 *
 *     cotree_run run;
 *     cotree_arena arena = {NULL, 0};
 *     cotree_run_init(&run, model, p, k, u, 1, &arena);   (arena.used: the bytes needed)
 *     arena.base = memory, arena.used = 0;
 *     cotree_run_init(&run, model, p, k, u, 1, &arena);
 *     cotree_run_narrow(&run, t, z, w);     (z: all states and sensitivities at the start)
 *     ... an integrator with cotree_run_rate, the context &run, and d.project = cotree_run_project
 *     cotree_run_complete(&run, t, w);      (run.full: all states and sensitivities)
 *
 * Nothing is allocated. Only one integration at a time may use a run. */
#ifndef COTREE_RUN_H
#define COTREE_RUN_H

#include "cotree_abi.h"
#include "cotree_limits.h"
#if COTREE_HAS_ALGEBRAIC
#include "cotree_lu.h"
#endif

COTREE_BEGIN_DECLS

/* The number of stored solutions of the algebraic equations that serve as guesses, a power of
 * two. */
#define COTREE_RUN_REMEMBERED 256

/* A piecewise linear function that replaces an input, constant outside its range. */
typedef struct cotree_table_input {
    int input;
    int length;
    const cotree_real *t;
    const cotree_real *u;
} cotree_table_input;

/* Write the inputs that are functions of the caller into u. Return a negative number to stop the
 * integration. */
typedef int (*cotree_input_function)(cotree_real t, cotree_real *u, void *context);

/* A solver of the caller, used if the iterations here fail. It gets all states x and returns 0 if
 * it changed the algebraic unknowns to a solution. */
typedef int (*cotree_find_unknowns)(cotree_real t, cotree_real *x, void *context);
typedef struct cotree_helper {
    cotree_find_unknowns find_unknowns;
    void *context;
} cotree_helper;

/* An arena. While base is NULL, allocations are counted only, and return NULL. */
typedef struct cotree_arena {
    char *base;
    size_t used;
} cotree_arena;

/* Linear systems of the algebraic equations g, if an implicit method provides them: linearise
 * factorises g_z at x; solve computes -g_z^-1 g. They return a status like kernels. */
typedef struct cotree_elimination {
    int (*linearise)(cotree_real t, const cotree_real *x, void *context);
    int (*solve)(const cotree_real *g, cotree_real *step, void *context);
    void *context;
} cotree_elimination;

typedef struct cotree_run {
    const cotree_model *model;
    const cotree_real *p, *k; /* parameters, prepared */
    cotree_real *u;           /* n_inputs */
#if COTREE_HAS_INPUTS
    int n_replaced;
    const cotree_table_input *replaced;
    cotree_input_function input_function; /* NULL: none */
    void *input_context;
#endif
#if COTREE_HAS_HELPER
    const cotree_helper *helper; /* NULL: none */
#endif
#if COTREE_HAS_CONSTRAINTS
    int is_held;            /* 1, the default: constraints are satisfied by projection */
    int is_strict;          /* 1: rates are always evaluated on the constraints, as dependent ones
                             * require; 0: only after failed steps */
    cotree_real correction; /* the largest change of a state by a projection, as a share of the
                               state or of 1 */
#endif
    cotree_real rtol;      /* relative tolerance of algebraic unknowns; 0: to rounding */
    cotree_real atol;      /* absolute tolerance of algebraic unknowns; 1e-10 by default */
    cotree_real low, high; /* bounds of evaluations: the segment without its jumps */
    cotree_real *full;     /* the last complete point */
    int n;                 /* length of w */
    int n_full;            /* entries of z: all states and sensitivities */
    int n_packed;          /* entries of z without sensitivities that vanish */
#if COTREE_HAS_ALGEBRAIC
    cotree_elimination elimination; /* its functions are NULL by default */
#endif
    /* The rest is private. */
    int n_blocks;
    int n_rates; /* states without algebraic unknowns */
    int n_lead;  /* entries of w before the sensitivities */
    cotree_real *rates, *held, *step;
#if COTREE_HAS_ALGEBRAIC
    int is_extended; /* 1: w contains algebraic unknowns */
    int is_solving;  /* 1: these are solved for at each point, even if w contains them */
    int n_far;       /* points with integrated unknowns far from their solution, minus others */
    cotree_real pivot_growth; /* growth of rounding errors by the planned pivots */
    cotree_real bend; /* last correction / radius within which the equations are nearly linear */
    cotree_real *newton, *found, *times;
    cotree_lu matrix; /* of the algebraic equations */
    int n_found;
#endif
#if COTREE_HAS_ALGEBRAIC || COTREE_HAS_IMPLICIT
    cotree_real *nonzeros;
#endif
#if COTREE_HAS_CONSTRAINTS
    cotree_real *residual;
    int n_failed, n_strict;
#endif
} cotree_run;

/* The jump of sensitivities at a time event that depends on parameters, with the rates f before
 * and after it: S+ = S- + (f- - f+) t_p. */
typedef struct cotree_corner_sensitivity {
    cotree_real *w, *left, *right,
        *work;                  /* run->n numbers each: a point, rates before and after it, work */
    const cotree_real *slopes;  /* t_p: derivatives of the time by the parameters */
    const cotree_real *spreads; /* the largest difference among coinciding events */
    const cotree_real *tolerances; /* absolute tolerances of the sensitivities to each parameter */
    cotree_real rtol;              /* relative tolerance */
    cotree_real margin; /* distance from the event at which rates are evaluated, with the direction
                           of time */
#if COTREE_HAS_CONSTRAINTS
    int is_constrained; /* 1: constraints are satisfied by projection */
#endif
    int undefined; /* the place in z of a sensitivity that does not exist after the event */
} cotree_corner_sensitivity;

/* A result of cotree_run_jump_sensitivities: rates jump where events coincide that a parameter
 * moves apart. */
#define COTREE_RUN_TURNED 60

/* Allocate bytes in an arena. While bytes are only counted, return spare. */
void *cotree_arena_alloc(cotree_arena *arena, size_t size, void *spare);
cotree_real *cotree_arena_reals(cotree_arena *arena, int n);
int *cotree_arena_ints(cotree_arena *arena, int n);

/* Allocate and initialise. */
void cotree_run_init(cotree_run *run, const cotree_model *model, const cotree_real *p,
                     const cotree_real *k, cotree_real *u, int has_sensitivities,
                     cotree_arena *arena);

/* Make the algebraic unknowns part of w. The model needs extended_rhs, or with sensitivities
 * extended_augmented_rhs, and no input may be replaced. */
void cotree_run_extend(cotree_run *run);

/* Copy z without the sensitivities that vanish, and back with zeros for them. */
void cotree_run_pack(const cotree_run *run, const cotree_real *z, cotree_real *packed);
void cotree_run_unpack(const cotree_run *run, const cotree_real *packed, cotree_real *z);

/* Copy z in the form w: also without algebraic unknowns. */
void cotree_run_leave_out(const cotree_run *run, const cotree_real *z, cotree_real *w);

/* Copy z in the form w, and store the algebraic unknowns as a guess. */
void cotree_run_narrow(cotree_run *run, cotree_real t, const cotree_real *z, cotree_real *w);

/* Convert between w and a point of a stepper, of n entries: run->n, or n_packed with algebraic
 * unknowns, which become guesses. */
void cotree_run_from_point(cotree_run *run, cotree_real t, int n, const cotree_real *point,
                           cotree_real *w);
int cotree_run_to_point(cotree_run *run, cotree_real t, const cotree_real *w, int n,
                        cotree_real *point);

/* Compute run->u, the inputs at a time. */
int cotree_run_inputs(cotree_run *run, cotree_real t);

/* Rate function for integrators; the context is the run. */
int cotree_run_rate(cotree_real t, const cotree_real *w, cotree_real *dw, void *context);
int cotree_run_project(cotree_real t, cotree_real *w, void *context);
void cotree_run_rejected(void *context);

/* Compute the rates of all states and sensitivities, packed, at a time inside the segment;
 * residuals in the places of algebraic unknowns. */
int cotree_run_packed_rate(cotree_run *run, cotree_real t, const cotree_real *z, cotree_real *dz);

/* Project all states and sensitivities, algebraic unknowns included; the same for a packed
 * point. */
int cotree_run_project_all(cotree_run *run, cotree_real t, cotree_real *z);
int cotree_run_project_packed(cotree_run *run, cotree_real t, cotree_real *packed);

/* Solve for the algebraic unknowns of a packed point, near their solution, and for their
 * sensitivities. Return a positive number if Newton's method fails. */
int cotree_run_solve_packed(cotree_run *run, cotree_real t, cotree_real *packed);

/* Return the point at which rates are evaluated: z, or its projection, valid until the next
 * call. */
const cotree_real *cotree_run_held(cotree_run *run, cotree_real t, const cotree_real *z);

/* Compute the Jacobian of the states' rates with algebraic unknowns eliminated: n_rates rows. */
int cotree_run_jacobian(cotree_real t, const cotree_real *w, cotree_real *matrix, void *context);

/* Return whether there are constraints to project onto. */
int cotree_run_is_constrained(const cotree_run *run);

/* Return whether an integrator has to project. */
int cotree_run_is_projected(const cotree_run *run);

/* Compute run->full, all states and sensitivities. */
int cotree_run_complete(cotree_run *run, cotree_real t, const cotree_real *w);

/* Compute run->full, all states and sensitivities; call the helper if the iterations here fail. */
int cotree_run_find(cotree_run *run, cotree_real t, const cotree_real *w);

/* Compute the states of run->full, without sensitivities; call the helper if the iterations here
 * fail. */
int cotree_run_find_states(cotree_run *run, cotree_real t, const cotree_real *w);

/* Return the time nearest to t inside the segment. */
cotree_real cotree_run_inside(const cotree_run *run, cotree_real t);

/* Compute the rates of the algebraic unknowns that keep the residuals zero, if these change at
 * rates g at the states x. */
int cotree_run_follow(cotree_run *run, cotree_real t, const cotree_real *x, const cotree_real *g,
                      cotree_real *rates);

/* Compute the rates before a time event. After low and high are those of the next segment,
 * compute the rates after it, and apply the jump of the sensitivities. A point has n entries:
 * run->n, or n_packed. */
int cotree_run_left_rates(cotree_run *run, cotree_real t, const cotree_real *point, int n,
                          cotree_corner_sensitivity *crossing);
int cotree_run_jump_sensitivities(cotree_run *run, cotree_real t, cotree_real *point, int n,
                                  cotree_corner_sensitivity *crossing);

COTREE_END_DECLS

#endif
