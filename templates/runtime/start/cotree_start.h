/* cotree_start.h: states and sensitivities that satisfy all equations at the start of a run.
 *
 * Prescribed initial values are kept. The other coordinates and speeds follow from the constraints,
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

/* Statuses in addition to those of kernels, with the meaning of culprit and column. */
#define COTREE_START_VIOLATED COTREE_ASSEMBLY_VIOLATED /* culprit: the violated row */
#define COTREE_START_STUCK COTREE_ASSEMBLY_STUCK       /* culprit: a row; column: a sensitivity */
#define COTREE_START_CONTRADICTED 103 /* culprit: a redundant value that disagrees */
#define COTREE_START_UNSOLVED 104     /* the algebraic equations have no solution */
#define COTREE_START_REVERSED 105     /* culprit: an event whose jump reverses its own condition */
#define COTREE_START_UNDEFINED 106    /* culprit: a state without a finite value */
#define COTREE_START_NO_MEMORY 107
#define COTREE_START_ON_JUMP 109      /* culprit: an event whose jump depends on a parameter */
#define COTREE_START_UNDETERMINED 108 /* the algebraic equations do not determine all unknowns */

/* Arguments and results of cotree_start_once. */
typedef struct cotree_start_call {
    const cotree_model *model;
    const cotree_start_tables *tables;
    const cotree_real *p, *k; /* parameters and their prepared values */
    cotree_real t;
#if COTREE_HAS_INPUTS
    int n_replaced; /* number of inputs replaced by tables, except in constraints */
    const cotree_table_input *replaced;
#endif
    const cotree_real *guess, *initial; /* as in cotree_start */
    int n_set;
    const int *set;
    const cotree_real *values;
    int has_sensitivities;
    cotree_real *z;      /* result: states, then sensitivities */
    const char *culprit; /* name of the cause of a failure; "" if unknown */
    int column;          /* sensitivity that causes a failure; -1: unknown */
    int is_chosen;
    int is_dependent; /* 1: constraints are (nearly) dependent at the start */
#if COTREE_HAS_MENDING
    cotree_start_report *report; /* reports changes; NULL: prescribed values may not change */
    /* Result, or NULL: 1 for each redundant value, then for each of its derivatives, that
     * contradicts the states. */
    int *contradictions;
#endif
#if COTREE_HAS_HELPER && COTREE_HAS_ALGEBRAIC
    const cotree_helper *helper; /* the caller's solver for algebraic unknowns, or NULL */
    /* NULL: dense factorisations are used. Otherwise the caller checks that unknowns are
     * determined. */
    const cotree_elimination *elimination;
#endif
} cotree_start_call;

typedef struct cotree_start {
    cotree_run *run;
    const cotree_start_tables *tables;
    /* Guesses for algebraic unknowns and for modes of friction and stops, n_states entries. NULL,
     * the default: the initial values of the model. */
    const cotree_real *guess;
    /* All initial states and sensitivities, including prescribed ones. NULL, the default: the
     * initial values of the model. */
    const cotree_real *initial;
    /* Initial values that replace the model's; by default none. */
    int n_set;
    const int *set;            /* n_set indices of states whose initial values are set */
    const cotree_real *values; /* n_set initial values */
    int culprit, column;       /* cause of a failure; -1: unknown */
    int is_chosen;             /* 1: the projection is ambiguous; one of several was chosen */
#if COTREE_HAS_HELPER && COTREE_HAS_ALGEBRAIC
    int is_trusted; /* 1: unknowns are assumed to be determined */
#endif
#if COTREE_HAS_MENDING
    int *contradictions; /* as in cotree_start_call */
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

/* Compute the states and sensitivities of the run at the start, with the prepared values run->k.
 * Return 0 or a status. */
int cotree_start_find(cotree_start *start, cotree_real t, cotree_real *z);

/* Compute the start of a call, in memory that is allocated and freed. Return 0 or a status. */
COTREE_EXPORT int cotree_start_once(cotree_start_call *call);

#if COTREE_HAS_MENDING
/* Compute the gradients of the constraints at the states of a call, see cotree_assembly.h. */
COTREE_EXPORT int cotree_start_gradients(cotree_start_call *call, cotree_real *rows,
                                         cotree_real *weakest);
#endif

/* Return the reason of a failure as a clause. */
const char *cotree_start_message(int status);

/* Return the name of the constraint, initial value, event or state that caused a failure; "" if
 * unknown. */
const char *cotree_start_culprit(const cotree_start *start, int status);

COTREE_END_DECLS

#endif
