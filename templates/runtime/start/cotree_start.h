/* cotree_start.h: states and sensitivities at the start of a run that satisfy all equations.
 *
 * Given initial values are kept. Other coordinates and speeds follow from the constraints,
 * algebraic unknowns from their equations, and modes of jumps inside expressions from their event
 * functions. Sensitivities are the derivatives of these values.
 *
 *     cotree_start_init(&start, &run, &tables, &arena);   (twice: see cotree_run.h)
 *     cotree_start_find(&start, t, z);                   (z: n_full of the run) */
#ifndef COTREE_START_H
#define COTREE_START_H

#include "cotree_assembly.h"
#include "cotree_run.h"
#include "cotree_start_tables.h"

COTREE_BEGIN_DECLS

/* Results besides those of kernels. */
#define COTREE_START_VIOLATED COTREE_ASSEMBLY_VIOLATED /* culprit: a row of the assembly */
#define COTREE_START_STUCK COTREE_ASSEMBLY_STUCK       /* culprit; column: the sensitivity */
#define COTREE_START_CONTRADICTED 103                  /* culprit: a redundant value */
#define COTREE_START_UNSOLVED 104    /* the algebraic equations have no solution */
#define COTREE_START_TURNED_BACK 105 /* culprit: an event whose jump reverses its own condition */
#define COTREE_START_UNDEFINED 106   /* culprit: a state without a finite value */
#define COTREE_START_NO_MEMORY 107
#define COTREE_START_ON_JUMP 109      /* culprit: an event, whose jump a parameter crosses */
#define COTREE_START_UNDETERMINED 108 /* the algebraic equations leave unknowns free */

/* A start in one call. */
typedef struct cotree_start_call {
    const cotree_model *model;
    const cotree_start_tables *tables;
    const cotree_real *p, *k; /* parameters, and their prepared values */
    cotree_real t;
#if COTREE_HAS_INPUTS
    int n_replaced; /* inputs that replace the model's, except in constraints */
    const cotree_table_input *replaced;
#endif
    const cotree_real *guess, *initial; /* as of a start */
    int n_set;
    const int *set;
    const cotree_real *values;
    int has_sensitivities;
    cotree_real *z;      /* result: states, then sensitivities */
    const char *culprit; /* of a failure; "" if unknown */
    int is_chosen;
    int is_dependent; /* whether constraints are dependent at the start, or nearly so */
#if COTREE_HAS_MENDING
    cotree_start_report *report; /* NULL: given values do not change */
#endif
#if COTREE_HAS_HELPER && COTREE_HAS_ALGEBRAIC
    const cotree_helper *helper; /* NULL: none */
    /* NULL: dense factorisations. Otherwise the caller checks that unknowns are determined. */
    const cotree_elimination *elimination;
#endif
} cotree_start_call;

typedef struct cotree_start {
    cotree_run *run;
    const cotree_start_tables *tables;
    /* Guesses of algebraic unknowns and modes of friction and stops, n_states; NULL, after init:
     * the model's own initial values. */
    const cotree_real *guess;
    /* All initial states and sensitivities, including those that are set; NULL, after init: the
     * model's own. */
    const cotree_real *initial;
    /* Initial values that replace the model's; none after init. */
    int n_set;
    const int *set;            /* n_set: the states */
    const cotree_real *values; /* n_set */
    int culprit, column;       /* of a failure; -1: unknown */
    int is_chosen;             /* whether a projection of minimum norm was chosen among several */
#if COTREE_HAS_HELPER && COTREE_HAS_ALGEBRAIC
    int is_trusted; /* 1: unknowns are assumed to be determined */
#endif
    cotree_assembly assembly;
    /* The rest is private. */
    int *is_set, *is_found, *pivots;
    cotree_real *rates, *given_slopes;
    cotree_real *given, *w, *moved, *moved_p, *moved_k, *event_values, *event_slopes, *new_values,
        *sides;
} cotree_start;

void cotree_start_init(cotree_start *start, cotree_run *run, const cotree_start_tables *tables,
                       cotree_arena *arena);

/* Compute the states and sensitivities of the run at the start. Return 0 or a status. Prepared
 * values are those of run->k.
 */
int cotree_start_find(cotree_start *start, cotree_real t, cotree_real *z);

/* Compute the same for a call, in memory that is allocated and freed. Return 0 or a status. */
COTREE_EXPORT int cotree_start_once(cotree_start_call *call);

#if COTREE_HAS_MENDING
/* Compute the gradients of the constraints at the states of a call, see cotree_assembly.h. */
COTREE_EXPORT int cotree_start_gradients(cotree_start_call *call, cotree_real *rows,
                                         cotree_real *weakest);
#endif

/* Return why there is no start, as a clause. */
const char *cotree_start_message(int status);

/* Return the name of the culprit: a constraint, an initial value, an event or a state; "" if
 * unknown. */
const char *cotree_start_culprit(const cotree_start *start, int status);

COTREE_END_DECLS

#endif
