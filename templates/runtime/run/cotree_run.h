/* cotree_run.h: a model in the form w' = f(t, w) for integrators.
 *
 * w holds the states, then their sensitivities by parameter without those that always vanish.
 * Algebraic unknowns are solved for at each point, or are part of w if the model has rates for
 * them (call cotree_run_extend between init and narrow). Projection satisfies constraints.
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
 * No memory is allocated. Only one integration at a time may use a run. */
#ifndef COTREE_RUN_H
#define COTREE_RUN_H

#include "cotree_abi.h"
#include "cotree_limits.h"
#if COTREE_HAS_ALGEBRAIC
#include "cotree_lu.h"
#endif

COTREE_BEGIN_DECLS

/* Number of stored solutions of the algebraic equations, used as initial guesses; a power of
 * two. */
#define COTREE_RUN_REMEMBERED 256

/* A piecewise linear function of time that replaces an input; constant outside its range. */
typedef struct cotree_table_input {
    int input;
    int length;
    const cotree_real *t;
    const cotree_real *u;
} cotree_table_input;

/* Callback that writes inputs to u. Return a negative number to stop the integration. */
typedef int (*cotree_input_function)(cotree_real t, cotree_real *u, void *context);

/* Solver provided by the caller, used if the iterations of this file fail. It receives all states
 * x, writes a solution for the algebraic unknowns among them, and returns 0 if it found one. */
typedef int (*cotree_find_unknowns)(cotree_real t, cotree_real *x, void *context);
typedef struct cotree_helper {
    cotree_find_unknowns find_unknowns;
    void *context;
} cotree_helper;

/* A memory arena. If base is NULL, allocations only count their bytes and return NULL. */
typedef struct cotree_arena {
    char *base;
    size_t used;
} cotree_arena;

/* Linear solver for the algebraic equations g, which an implicit method may provide: linearise
 * factorises g_z at x; solve computes -g_z^-1 g. Both return a kernel status. */
typedef struct cotree_elimination {
    int (*linearise)(cotree_real t, const cotree_real *x, void *context);
    int (*solve)(const cotree_real *g, cotree_real *step, void *context);
    void *context;
} cotree_elimination;

typedef struct cotree_run {
    const cotree_model *model;
    const cotree_real *p, *k; /* parameters, and the values prepared from them */
    cotree_real *u;           /* n_inputs values at the last time evaluated */
#if COTREE_HAS_INPUTS
    int n_replaced;
    const cotree_table_input *replaced;
    cotree_input_function input_function; /* inputs computed by the caller; NULL: none */
    void *input_context;
#endif
#if COTREE_HAS_HELPER
    const cotree_helper *helper; /* the caller's solver for algebraic unknowns, or NULL */
#endif
#if COTREE_HAS_CONSTRAINTS
    int is_held;   /* 1, the default: constraints are satisfied by projection */
    int is_strict; /* 1: rates are always evaluated at projected points, as dependent constraints
                      require; 0: only after failed steps */
    cotree_real correction; /* largest change of a state x by a projection, over max(1, |x|) */
#endif
    cotree_real rtol;      /* relative tolerance of algebraic unknowns; 0: up to rounding */
    cotree_real atol;      /* absolute tolerance of algebraic unknowns; 1e-10 by default */
    cotree_real low, high; /* bounds of evaluation times, just inside the time events */
    cotree_real *full;     /* all states and sensitivities at the last completed point */
    int n;                 /* number of entries of w */
    int n_full;            /* number of entries of z, all states and sensitivities */
    int n_packed;          /* number of entries of z without sensitivities that always vanish */
#if COTREE_HAS_ALGEBRAIC
    cotree_elimination elimination; /* optional linear solver; its functions are NULL by default */
#endif
    /* The rest is private. */
    int n_blocks;
    int n_rates; /* number of states without algebraic unknowns */
    int n_lead;  /* number of entries of w before the sensitivities */
#if COTREE_HAS_ALGEBRAIC
    int is_extended; /* 1: w contains algebraic unknowns */
    int is_solving;  /* 1: unknowns are solved for at each point, even if w contains them */
    int n_far; /* number of points far from the algebraic solution minus number of other points */
    cotree_real pivot_growth; /* growth of rounding errors by the planned pivot order */
    cotree_real bend;         /* last correction over the radius of convergence */
    cotree_real *newton, *found, *times;
    cotree_real *branch;  /* unknowns at the end of the last accepted step, then work space */
    cotree_real t_branch; /* time of the last accepted step */
    cotree_real *branch_before, t_before; /* unknowns and time one step earlier */
    cotree_lu matrix;                     /* matrix of the algebraic equations */
    int n_found;
#endif
#if COTREE_HAS_ALGEBRAIC || COTREE_HAS_IMPLICIT
    cotree_real *nonzeros;
#endif
#if COTREE_HAS_ALGEBRAIC || COTREE_HAS_IMPLICIT || COTREE_HAS_CONSTRAINTS
    cotree_real *rates, *held, *step;
#endif
#if COTREE_HAS_CONSTRAINTS
    cotree_real *residual;
    int n_failed, n_strict;
#endif
} cotree_run;

/* Jump of the sensitivities at a time event that depends on parameters, with the rates f before and
 * after the event: S+ = S- + (f- - f+) t_p. */
typedef struct cotree_breakpoint_sensitivity {
    cotree_real *w, *left, *right,
        *work; /* run->n numbers each: a point, the rates before and after the event, work */
    const cotree_real *slopes;     /* parameter derivatives of the event time */
    const cotree_real *spreads;    /* largest difference of slopes among coinciding events */
    const cotree_real *tolerances; /* absolute tolerances of the sensitivities to each parameter */
    cotree_real rtol;              /* relative tolerance of the sensitivities */
    cotree_real margin; /* signed distance from the event, in the direction of integration, at which
                           the rates are evaluated */
#if COTREE_HAS_CONSTRAINTS
    int is_constrained; /* 1: constraints are satisfied by projection */
#endif
    int undefined; /* index in z of a sensitivity that is undefined after the event */
} cotree_breakpoint_sensitivity;

/* Status of cotree_run_jump_sensitivities: rates jump at coinciding time events that a parameter
 * would separate. */
#define COTREE_RUN_TURNED 60

/* Allocate bytes in an arena. If base is NULL, only count them and return spare. */
void *cotree_arena_alloc(cotree_arena *arena, size_t size, void *spare);
cotree_real *cotree_arena_reals(cotree_arena *arena, int n);
int *cotree_arena_ints(cotree_arena *arena, int n);

/* Initialise a run; its arrays are allocated in the arena. */
void cotree_run_init(cotree_run *run, const cotree_model *model, const cotree_real *p,
                     const cotree_real *k, cotree_real *u, int has_sensitivities,
                     cotree_arena *arena);

/* Make the algebraic unknowns part of w. The model needs the kernel extended_rhs, or
 * extended_augmented_rhs with sensitivities, and no input may be replaced. */
void cotree_run_extend(cotree_run *run);

/* Copy z without the sensitivities that always vanish, and back with zeros for them. */
void cotree_run_pack(const cotree_run *run, const cotree_real *z, cotree_real *packed);
void cotree_run_unpack(const cotree_run *run, const cotree_real *packed, cotree_real *z);

/* Copy z to the layout of w, without storing a guess. */
void cotree_run_leave_out(const cotree_run *run, const cotree_real *z, cotree_real *w);

/* Copy z to the layout of w, and store the algebraic unknowns as a guess. */
void cotree_run_narrow(cotree_run *run, cotree_real t, const cotree_real *z, cotree_real *w);

/* Convert between w and a point of a stepper, which has n entries: run->n, or n_packed with
 * algebraic unknowns. Store the unknowns as guesses. */
void cotree_run_from_point(cotree_run *run, cotree_real t, int n, const cotree_real *point,
                           cotree_real *w);
int cotree_run_to_point(cotree_run *run, cotree_real t, const cotree_real *w, int n,
                        cotree_real *point);

/* Compute the inputs at a time into run->u. */
int cotree_run_inputs(cotree_run *run, cotree_real t);

/* Rate, projection and rejection functions for integrators. The context is the run. */
int cotree_run_rate(cotree_real t, const cotree_real *w, cotree_real *dw, void *context);
int cotree_run_project(cotree_real t, cotree_real *w, void *context);
void cotree_run_rejected(void *context);

/* Compute the packed rates of all states and sensitivities at a time inside the segment; entries of
 * algebraic unknowns are residuals. */
int cotree_run_packed_rate(cotree_run *run, cotree_real t, const cotree_real *z, cotree_real *dz);

/* Project all states and sensitivities, including algebraic unknowns, at a full or at a packed
 * point. */
int cotree_run_project_all(cotree_run *run, cotree_real t, cotree_real *z);
int cotree_run_project_packed(cotree_run *run, cotree_real t, cotree_real *packed);

/* Solve for the algebraic unknowns of a packed point that is near their solution, and for their
 * sensitivities. Return a positive number if Newton's method fails. */
int cotree_run_solve_packed(cotree_run *run, cotree_real t, cotree_real *packed);

/* Return the point at which rates are evaluated: z or its projection, valid until the next call. */
const cotree_real *cotree_run_held(cotree_run *run, cotree_real t, const cotree_real *z);

/* Compute the n_rates rows of the Jacobian of the rates, with algebraic unknowns eliminated. */
int cotree_run_jacobian(cotree_real t, const cotree_real *w, cotree_real *matrix, void *context);

/* Return whether the model has constraints that the run satisfies by projection. */
int cotree_run_is_constrained(const cotree_run *run);

/* Return whether integrators must call cotree_run_project after each step. */
int cotree_run_is_projected(const cotree_run *run);

/* Compute all states and sensitivities at w into run->full. */
int cotree_run_complete(cotree_run *run, cotree_real t, const cotree_real *w);

#if COTREE_HAS_HELPER && COTREE_HAS_ALGEBRAIC
/* As cotree_run_complete, but call the helper if the iterations fail. */
int cotree_run_find(cotree_run *run, cotree_real t, const cotree_real *w);
#else
#define cotree_run_find cotree_run_complete
#endif

/* As cotree_run_find, without sensitivities. */
int cotree_run_find_states(cotree_run *run, cotree_real t, const cotree_real *w);

/* Return a bound on the rounding errors of two breakpoint times, and of the times up to scale from
 * which they are computed. */
cotree_real cotree_run_margin(cotree_real start, cotree_real end, cotree_real scale);

/* Restrict evaluations to times a few roundings inside two breakpoints. Then no step evaluates
 * rates on both sides of a jump, for any rounding of its time. Ends that are open are no
 * breakpoints of the rates. */
void cotree_run_restrict(cotree_run *run, cotree_real start, cotree_real end, cotree_real scale,
                         int is_start_open, int is_end_open);

/* Return the time nearest to t inside the segment. */
cotree_real cotree_run_inside(const cotree_run *run, cotree_real t);

/* Accept the algebraic unknowns at the end of a step, a point w with n entries, or of the last
 * solution if w has none. cotree_run_is_far returns whether they differ much from the last
 * accepted unknowns. */
void cotree_run_accept(cotree_run *run, cotree_real t, int n, const cotree_real *w);
int cotree_run_is_far(const cotree_run *run, int n, const cotree_real *w);

/* Return whether solutions within the step connect the algebraic unknowns at its end, a point with
 * n entries, with the last accepted unknowns. Otherwise they jumped. */
int cotree_run_is_continuous(cotree_run *run, cotree_real t, int n, const cotree_real *before,
                             const cotree_real *after);

/* Compute run->full at the end of the last accepted step, with the unknowns accepted there. */
void cotree_run_keep(cotree_run *run, int n, const cotree_real *w);

/* Replace all stored guesses of the algebraic unknowns. */
void cotree_run_return(cotree_run *run, cotree_real t, const cotree_real *unknowns);

/* Compute the rates of the algebraic unknowns that keep their residuals zero. g: rates of the
 * residuals at the states x for constant unknowns. */
int cotree_run_follow(cotree_run *run, cotree_real t, const cotree_real *x, const cotree_real *g,
                      cotree_real *rates);

/* Jump of the sensitivities at a time event, in two calls. First compute the rates before the
 * event. Then, after low and high are set to the next segment, compute the rates after it and apply
 * the jump. A point has n entries: run->n, or n_packed. */
int cotree_run_left_rates(cotree_run *run, cotree_real t, const cotree_real *point, int n,
                          cotree_breakpoint_sensitivity *crossing);
int cotree_run_jump_sensitivities(cotree_run *run, cotree_real t, cotree_real *point, int n,
                                  cotree_breakpoint_sensitivity *crossing);

COTREE_END_DECLS

#endif
