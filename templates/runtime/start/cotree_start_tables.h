/* cotree_start_tables.h: tables of a model for its consistent start. */
#ifndef COTREE_START_TABLES_H
#define COTREE_START_TABLES_H

#include "cotree_abi.h"

/* Rows are the constraints of coordinates, then those of speeds, then the conditions of a start. */
typedef struct cotree_assembly_tables {
    int n_coordinates;     /* coordinates are the first states */
    int n_speeds;          /* speeds follow them */
    int n_values;          /* number of constraints of coordinates */
    int n_rows;            /* number of constraints of speeds, and rows of the gradient */
    const int *value_rows; /* n_values: the constraints of speeds that are their time derivatives */
    int n_quaternions;
    const int *quaternions; /* the first state of each */
    /* Conditions: initial values of variables that are not states. 0 and NULL after the start. */
    int n_conditions;
    const int *is_rate; /* n_conditions: 1 if it constrains speeds, 0 coordinates */
    int n_start;        /* results of the kernel start; conditions come first */
    /* For units and messages; NULL: all rows have the same unit. */
    const cotree_quantity *rows;
    int n_groups;
    const int *groups; /* n_rows + n_conditions: one number for each edge and unit */
} cotree_assembly_tables;

typedef struct cotree_start_tables {
    const cotree_assembly_tables *assembly; /* NULL: no constraints and no conditions */
    const int *given; /* n_states: 1 if the model prescribes the initial value */
    const int *seeds; /* n_sensitivities: a parameter, or -1 less a state */
    /* States of storages, each of which is computed from an algebraic unknown. */
    int n_contents;
    const int *contents; /* n_contents states, then as many algebraic unknowns */
    /* Redundant initial values: the last 2 n_redundant results of the kernel start are the
     * values that follow from those of states, then the given values. */
    int n_redundant;
    const cotree_quantity *redundant;
    const int *redundant_starts; /* n_redundant + 1 */
    const int *redundant_states; /* states from which each follows */
} cotree_start_tables;

/* Report on given values that change if the constraints cannot be satisfied otherwise. Values
 * are states, then conditions; arrays are zero before a start. */
typedef struct cotree_start_report {
    const int *ranks; /* values: those of higher ranks change first; 0: last */
    /* Results. */
    int is_moved;                /* 1: values changed noticeably, or change with a parameter */
    int level, column;           /* of a failure: 0 coordinates, 1 speeds; the sensitivity */
    cotree_real length;          /* the characteristic length, [m] */
    cotree_real *before, *after; /* n_states: as given, and after the projection */
    /* Dimensionless changes: of given states, then of all rows. */
    cotree_real *changes;
    cotree_real *left; /* all rows: dimensionless residuals of a failure */
    int *follows;      /* values of each sensitivity: 1 if they change with its parameter */
} cotree_start_report;

#endif
