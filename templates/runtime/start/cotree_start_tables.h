/* cotree_start_tables.h: what a consistent start needs to know of a model besides its kernels.
 * Part of the runtime of cotree, the same for every model.
 */
#ifndef COTREE_START_TABLES_H
#define COTREE_START_TABLES_H

#include "cotree_abi.h"

#ifdef __cplusplus
extern "C" {
#endif

/* cotree: begin of the part that cffi reads */
/* Rows are the constraints of coordinates, then those of speeds, then the conditions of a start. */
typedef struct cotree_assembly_tables {
    int n_coordinates;     /* the first states */
    int n_speeds;          /* the next ones */
    int n_values;          /* constraints of coordinates */
    int n_rows;            /* constraints of speeds, as many as the gradient has rows */
    const int *value_rows; /* n_values: the constraints of speeds that are their rates */
    int n_quaternions;
    const int *quaternions; /* the first state of each */
    /* Initial values of what is no state: 0 and NULL after the start. */
    int n_conditions;
    const int *is_rate; /* n_conditions: whether speeds satisfy it, not coordinates */
    int n_start;        /* results of the kernel start, conditions first */
    /* For units and messages; NULL: all rows count alike. */
    const cotree_quantity *rows;
    int n_groups;
    const int *groups; /* n_rows + n_conditions: rows of one edge and one unit have one number */
} cotree_assembly_tables;

typedef struct cotree_start_tables {
    const cotree_assembly_tables *assembly; /* NULL: no constraints and no conditions */
    const int *given; /* n_states: whether the model gives the initial value */
    const int *seeds; /* n_sensitivities: a parameter, or -1 less a state */
    /* Contents of storages, found from a variable that follows from each. */
    int n_contents;
    const int *contents; /* n_contents states, then as many algebraic unknowns */
    /* Initial values that follow from those of states: the last 2 n_redundant results of the kernel
     * start are what they follow as, then what they are given as. */
    int n_redundant;
    const cotree_quantity *redundant;
    const int *redundant_starts; /* n_redundant + 1 */
    const int *redundant_states; /* that each follows from */
} cotree_start_tables;
/* cotree: end of the part that cffi reads */

#ifdef __cplusplus
}
#endif

#endif
