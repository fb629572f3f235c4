/* cotree_run.h: a model as integrators need it: one vector w and its rates.
 * Part of the runtime of cotree, the same for every model.
 *
 * w holds the states, then their sensitivities parameter by parameter, those left out that vanish
 * at all times. Algebraic unknowns are left out, too: they are solved for at each point. Or the
 * states have them among them, where the model has rates for them: cotree_run_extend between init
 * and narrow, and d.project; their sensitivities are left out. Constraints are held by projection.
 *
 *     cotree_run run;
 *     cotree_room room = {NULL, 0};
 *     cotree_run_init(&run, model, p, k, u, 1, &room);   (room.used: the bytes that it needs)
 *     room.base = memory, room.used = 0;
 *     cotree_run_init(&run, model, p, k, u, 1, &room);
 *     cotree_run_narrow(&run, z, w);                     (z: all states and sensitivities at the
 * start)
 *     ... an integrator with cotree_run_rate, &run as its context, and d.project =
 * cotree_run_project cotree_run_complete(&run, t, w);                   (run.full: all states and
 * sensitivities)
 *
 * Nothing is allocated; a run is used by one integration at a time.
 */
#ifndef COTREE_RUN_H
#define COTREE_RUN_H

#include "cotree_abi.h"
#include "cotree_limits.h"
#if COTREE_HAS_ALGEBRAIC
#include "cotree_lu.h"
#endif

#ifdef __cplusplus
extern "C" {
#endif

#if COTREE_HAS_ALGEBRAIC
/* How many solutions of algebraic equations are remembered as guesses, a power of two. */
#define COTREE_RUN_REMEMBERED 256

#endif
/* cotree: begin of the part that cffi reads */
#if COTREE_HAS_INPUTS
/* A piecewise linear function in place of an input, constant outside its range. */
typedef struct cotree_table_input {
    int input;
    int length;
    const cotree_real *t;
    const cotree_real *u;
} cotree_table_input;

/* Writes the inputs that are functions of another program into u. A negative result stops the
 * integration. */
typedef int (*cotree_input_function)(cotree_real t, cotree_real *u, void *context);

#endif
#if COTREE_HAS_HELPER
/* Another program that looks farther than iterations here do. Each function gets all states x and
 * returns 0 where it changed them to a solution: the algebraic unknowns among them, or whatever is
 * not kept, so that constraints hold. */
typedef int (*cotree_find_unknowns)(cotree_real t, cotree_real *x, void *context);
typedef int (*cotree_find_states)(cotree_real t, cotree_real *x, const int *kept, int n_kept,
                                  void *context);
typedef struct cotree_helper {
    cotree_find_unknowns find_unknowns;
    cotree_find_states find_states;
    void *context;
} cotree_helper;
#endif
/* cotree: end of the part that cffi reads */

/* Memory that is dealt out. While base is NULL nothing is: then it is counted what is needed. */
typedef struct cotree_room {
    char *base;
    size_t used;
} cotree_room;

#if COTREE_HAS_ALGEBRAIC
/* Linear systems of the algebraic equations g, where something knows better than a dense matrix:
 * writes the nonzeros of the Jacobian at x to the run's, and solves -g_z step = g. Functions return
 * as kernels do. */
typedef struct cotree_elimination {
    int (*linearise)(cotree_real t, const cotree_real *x, void *context);
    int (*solve)(const cotree_real *g, cotree_real *step, void *context);
    void *context;
} cotree_elimination;

#endif
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
    const cotree_helper *helper; /* NULL: nobody */
#endif
#if COTREE_HAS_CONSTRAINTS
    int is_held;   /* to the constraints; 1 unless you say otherwise */
    int is_strict; /* rates, too, always, as dependent constraints need; 0: where steps fail */
    cotree_real
        correction; /* the largest change of a state by a projection, as a share of it or of 1 */
#endif
    cotree_real rtol; /* of the integration: algebraic unknowns are as good; 0: to rounding */
    cotree_real atol; /* algebraic unknowns near zero are known to this; 1e-10 unless you say so */
    cotree_real low, high; /* the times that rates are asked for, between two jumps */
    cotree_real *full;     /* what complete found */
    int n;                 /* length of w */
    int n_full;            /* of z */
    int n_packed;          /* of z without sensitivities that vanish */
#if COTREE_HAS_ALGEBRAIC
    cotree_elimination elimination; /* of NULL unless you say so */
#endif
    /* The rest belongs to the run. */
    int n_blocks;
    int n_rates; /* of the states; algebraic unknowns have none */
    int n_lead;  /* of w, before the sensitivities */
    cotree_real *rates, *held, *step;
#if COTREE_HAS_ALGEBRAIC
    int is_extended;   /* it holds algebraic unknowns */
    int is_solving;    /* for these at each point, whether it holds them or not */
    int n_far;         /* how often these were lost */
    cotree_real doubt; /* about them: what pivots lost */
    cotree_real bend;  /* how far their last solution was, as a part of where the equations bend */
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

#if COTREE_HAS_MOVING_CORNERS
/* A corner: a time at which rates have a kink or jump, and which parameters move. */
typedef struct cotree_turn {
    cotree_real *w, *left, *right,
        *again;                    /* n of the run each: a point, and rates before and behind */
    const cotree_real *slopes;     /* derivatives of its time by the parameters */
    const cotree_real *spreads;    /* by how much these differ among all that meets there */
    const cotree_real *tolerances; /* what sensitivities to each parameter may err by */
    cotree_real rtol;              /* and as a share of themselves */
    cotree_real margin; /* how far behind the corner rates are taken, with time's direction */
    int is_constrained;
    int turned; /* the place in z of a sensitivity that does not exist from there on */
} cotree_turn;

/* A result of cotree_run_enter: rates jump where corners meet that a parameter moves apart. */
#define COTREE_RUN_TURNED 60

#endif
/* Takes bytes of a room; spare while they are only counted. */
void *cotree_take(cotree_room *room, size_t size, void *spare);
cotree_real *cotree_take_doubles(cotree_room *room, int n);
int *cotree_take_ints(cotree_room *room, int n);

/* Takes its memory, and stands ready. */
void cotree_run_init(cotree_run *run, const cotree_model *model, const cotree_real *p,
                     const cotree_real *k, cotree_real *u, int has_sensitivities,
                     cotree_room *room);

#if COTREE_HAS_ALGEBRAIC
/* Has algebraic unknowns integrated. The model needs extended_rhs for it, or with sensitivities
 * extended_augmented_rhs, and no input may be replaced. */
void cotree_run_extend(cotree_run *run);
#endif
/* Leaves sensitivities that vanish out of z, and puts zero in their places. */
void cotree_run_pack(const cotree_run *run, const cotree_real *z, cotree_real *packed);
void cotree_run_unpack(const cotree_run *run, const cotree_real *packed, cotree_real *z);

/* Leaves the algebraic unknowns of z out, too. */
void cotree_run_leave_out(const cotree_run *run, const cotree_real *z, cotree_real *w);

/* The same, and begins with them as guesses. */
void cotree_run_narrow(cotree_run *run, cotree_real t, const cotree_real *z, cotree_real *w);

#if COTREE_HAS_MOVING_CORNERS || COTREE_HAS_EVENTS
/* Takes a point as a stepper has it, of n entries: run->n, or n_packed with algebraic unknowns
 * among them, which become guesses; and gives w as such a point. */
void cotree_run_take(cotree_run *run, cotree_real t, int n, const cotree_real *point,
                     cotree_real *w);
int cotree_run_give(cotree_run *run, cotree_real t, const cotree_real *w, int n,
                    cotree_real *point);

#endif
/* Writes the inputs at a time to run->u. */
int cotree_run_inputs(cotree_run *run, cotree_real t);

/* For integrators; context is the run. */
int cotree_run_rate(cotree_real t, const cotree_real *w, cotree_real *dw, void *context);
#if COTREE_HAS_CONSTRAINTS || COTREE_HAS_ALGEBRAIC
int cotree_run_project(cotree_real t, cotree_real *w, void *context);
#endif
#if COTREE_HAS_CONSTRAINTS
void cotree_run_rejected(void *context);
#endif

#if COTREE_HAS_IMPLICIT || COTREE_HAS_EVENTS
/* The rates of all states and sensitivities, packed, at a time inside; of algebraic unknowns
 * residuals. */
int cotree_run_packed_rate(cotree_run *run, cotree_real t, const cotree_real *z, cotree_real *dz);

#endif
#if COTREE_HAS_CONSTRAINTS
/* Projects all states and sensitivities, algebraic unknowns included; and the same packed. */
int cotree_run_project_all(cotree_run *run, cotree_real t, cotree_real *z);
int cotree_run_project_packed(cotree_run *run, cotree_real t, cotree_real *packed);

#endif
#if COTREE_HAS_ALGEBRAIC
/* Solves for the algebraic unknowns of a packed point, which are near their solution, and then for
 * their sensitivities. Returns a positive number where that leads nowhere. */
int cotree_run_solve_packed(cotree_run *run, cotree_real t, cotree_real *packed);

#endif
#if COTREE_HAS_CONSTRAINTS
/* Gives the point, of all states and sensitivities, that rates are taken at: z, or on the
 * constraints next to it, until the next call. */
const cotree_real *cotree_run_held(cotree_run *run, cotree_real t, const cotree_real *z);

#endif
#if COTREE_HAS_IMPLICIT
/* Writes the derivatives of the states' rates by the states, algebraic unknowns eliminated: n_rates
 * rows. */
int cotree_run_jacobian(cotree_real t, const cotree_real *w, cotree_real *matrix, void *context);

#endif
#if COTREE_HAS_CONSTRAINTS || COTREE_HAS_EVENTS
/* Whether there are constraints to project on. */
int cotree_run_is_constrained(const cotree_run *run);

#endif
#if COTREE_HAS_CONSTRAINTS || COTREE_HAS_ALGEBRAIC
/* Whether an integrator has to project. */
int cotree_run_is_projected(const cotree_run *run);

#endif
/* Writes all states and sensitivities to run->full. */
int cotree_run_complete(cotree_run *run, cotree_real t, const cotree_real *w);

/* The same; what cannot be solved for here, the helper is asked for. */
int cotree_run_find(cotree_run *run, cotree_real t, const cotree_real *w);

#if COTREE_HAS_EVENTS || COTREE_HAS_HELPER
/* The same, all states alone. */
int cotree_run_find_states(cotree_run *run, cotree_real t, const cotree_real *w);

#endif
/* Gives the time nearest to t that rates are asked for. */
cotree_real cotree_run_inside(const cotree_run *run, cotree_real t);

#if COTREE_HAS_ALGEBRAIC
/* Where the residuals at the states x change at rates g, writes the rates of algebraic unknowns
 * that make up for it. */
int cotree_run_follow(cotree_run *run, cotree_real t, const cotree_real *x, const cotree_real *g,
                      cotree_real *rates);

#endif
#if COTREE_HAS_MOVING_CORNERS
/* Takes the rates at the end of what comes before a corner; behind it, after low and high are those
 * of what follows, lets sensitivities jump by what rates did, times the slopes. A point has n
 * entries: run->n, or n_packed. */
int cotree_run_leave(cotree_run *run, cotree_real t, const cotree_real *point, int n,
                     cotree_turn *turn);
int cotree_run_enter(cotree_run *run, cotree_real t, cotree_real *point, int n, cotree_turn *turn);

#endif
#ifdef __cplusplus
}
#endif

#endif
