/* cotree_start_tables.h: tables of a model for its consistent initial conditions. */
#ifndef COTREE_START_TABLES_H
#define COTREE_START_TABLES_H

#include "cotree_abi.h"

/* Rows are numbered in this order: constraints on coordinates, constraints on speeds, conditions at
 * the start. */
typedef struct cotree_assembly_tables {
    int n_coordinates;     /* number of coordinates, the first states */
    int n_speeds;          /* number of speeds, the next states */
    int n_values;          /* number of constraints on coordinates */
    int n_rows;            /* number of constraints on speeds, and of rows of the gradient */
    const int *value_rows; /* n_values: index of its derivative among the constraints on speeds */
    int n_quaternions;
    const int *quaternions; /* first state of each quaternion */
    /* Conditions: initial values of variables that are not states. After the start n_conditions is
     * 0 and the pointers are NULL. */
    int n_conditions;
    const int *is_rate; /* n_conditions: 1 if on speeds, 0 if on coordinates */
    int n_start;        /* number of results of the start kernel, conditions first */
    /* Names and units of the rows, for scaling and messages. NULL: all rows have the same unit. */
    const cotree_quantity *rows;
    int n_groups;
    const int *groups; /* n_rows + n_conditions: group of each row, one per edge and unit */
} cotree_assembly_tables;

typedef struct cotree_start_tables {
    const cotree_assembly_tables *assembly; /* NULL: no constraints and no conditions */
    const int *given; /* n_states: 1 if the model prescribes the initial value of the state */
    const int *seeds; /* n_sensitivities: parameter i as i, initial value of state i as -1 - i */
    /* Storage states q = c(v), such as charges, each of an algebraic unknown v. */
    int n_contents;
    const int *contents; /* n_contents states q, then their n_contents unknowns v */
    /* Redundant initial values, which other initial values determine. The last 2 n_redundant
     * results of the start kernel are the determined values, then the prescribed values. */
    int n_redundant;
    const cotree_quantity *redundant;
    const int *redundant_starts; /* n_redundant + 1 offsets into redundant_states */
    const int *redundant_states; /* indices of the states that determine each redundant value */
} cotree_start_tables;

/* Report on prescribed values that had to change to satisfy the constraints. Entries are for the
 * states, then for the conditions. Arrays must be zero before a start. */
typedef struct cotree_start_report {
    const int *ranks; /* rank of each value; the highest rank changes first, rank 0 last */
    /* Results. */
    int is_moved;       /* 1: a value changed noticeably, or its change depends on a parameter */
    int level, column;  /* after a failure: 0 coordinates, 1 speeds; index of the sensitivity */
    cotree_real length; /* characteristic length of the mechanism, [m] */
    cotree_real *before, *after; /* n_states: values as prescribed, and after the projection */
    /* Dimensionless changes of the prescribed states, then of all rows. */
    cotree_real *changes;
    cotree_real *left; /* residuals of all rows after a failure, dimensionless */
    int *follows; /* for each sensitivity and value: 1 if the value changes with the parameter */
} cotree_start_report;

#endif
