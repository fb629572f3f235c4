/* cotree_adjoint.h: the derivatives of an objective of a run, in reverse mode.
 *
 * The objective depends on outputs at certain times (readings). The steps of the run are given: a
 * time and all states at the end of each (the tape). The reverse sweep starts at the end of the
 * run. For each step it computes the stages of an explicit Runge-Kutta method again, then the
 * transposed stages in reverse order. Step sizes count as constants, so the result is the exact
 * derivative of the values that the steps and their interpolation compute.
 *
 *     set all fields of the structure up to parameters
 *     a->memory = ...;                     (cotree_adjoint_memory(a) bytes)
 *     cotree_adjoint_read(a);              (a->values: the states at the readings)
 *     ... write the derivatives of the objective with respect to the outputs to a->weights
 *     cotree_adjoint_sweep(a);             (a->states, a->parameters: the derivatives) */
#ifndef COTREE_ADJOINT_H
#define COTREE_ADJOINT_H

#include "cotree_run.h"

COTREE_BEGIN_DECLS

/* Kernels in reverse mode: s contains weights of the results of another kernel. Results are the
 * derivatives of the weighted sum with respect to the states, then to the sources: parameters and
 * prepared values. The last kernel converts weights of the sources to derivatives with respect to
 * the parameters. */
typedef struct cotree_adjoint_kernels {
    int n_sources;
    int n_parameters; /* number of parameters of the last kernel */
    cotree_sensitivity_kernel rates, outputs, initial, sources;
} cotree_adjoint_kernels;

/* An explicit Runge-Kutta method. */
typedef struct cotree_explicit_method {
    int n_stages;
    const cotree_real *nodes;    /* time of each stage, as a fraction of the step */
    const cotree_real *stages;   /* n_stages rows: weights of the earlier stages in each stage */
    const cotree_real *solution; /* weights of the stages in the solution */
} cotree_explicit_method;

typedef struct cotree_adjoint {
    const cotree_model *model;
    const cotree_adjoint_kernels *kernels;
    const cotree_explicit_method *method;
    const cotree_real *p, *k;
    cotree_real *u; /* n_inputs values, overwritten */
#if COTREE_HAS_INPUTS
    int n_replaced; /* number of inputs replaced by tables */
    const cotree_table_input *replaced;
#endif
    cotree_real rtol;
    const cotree_real *atols; /* absolute tolerance of each state */
    /* The tape. Each segment between breakpoints has its own rows; rows at breakpoints belong to
     * both segments. */
    const cotree_real *t; /* time of each row */
    const cotree_real *y; /* n_states numbers for each row */
    int n_segments;
    const cotree_real *breakpoints;   /* n_segments + 1 times */
    const int *rows;                  /* n_segments + 1 rows: first row of each segment, last row */
    cotree_real scale;                /* largest time from which breakpoints are computed */
    int is_start_sharp, is_end_sharp; /* 1: rates also have a kink or jump at this end */
    /* The readings, in the direction of integration. */
    int n_readings;
    const cotree_real *times;
    cotree_real *values; /* n_states numbers for each reading, written by cotree_adjoint_read */
    const cotree_real *weights; /* n_outputs derivatives of the objective for each reading */
    const int *is_free;         /* 1: the initial state depends on parameters as in the scene */
    cotree_real *states;        /* result: derivatives with respect to the initial states */
    cotree_real *parameters;    /* result: derivatives with respect to the parameters */
    void *memory;
} cotree_adjoint;

/* Return the number of bytes of the memory. */
COTREE_EXPORT size_t cotree_adjoint_memory(const cotree_adjoint *a);

/* Compute the states at the readings. Return 0 or the status of a kernel. */
COTREE_EXPORT int cotree_adjoint_read(cotree_adjoint *a);

/* Compute the derivatives. Return 0 or the status of a kernel. */
COTREE_EXPORT int cotree_adjoint_sweep(cotree_adjoint *a);

COTREE_END_DECLS

#endif
