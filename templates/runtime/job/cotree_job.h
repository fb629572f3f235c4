/* cotree_job.h: an integration that advances by several steps at each call.
 *
 * A job processes breakpoints (its start, time events and its end), wanted points and events. A
 * stepper takes the steps between them. */
#ifndef COTREE_JOB_H
#define COTREE_JOB_H

#include "cotree_run.h"
#if COTREE_HAS_CONSTRAINTS
#include "cotree_start_tables.h"
#endif

/* An integration method, see cotree_stepper.h. */
typedef struct cotree_stepper cotree_stepper;

/* Callback at the start of each segment between breakpoints, before the segment is evaluated, with
 * the time and all states and sensitivities. It may change the values of tables. Return 0 to
 * continue. */
typedef int (*cotree_reach)(cotree_real t, const cotree_real *z, void *context);

typedef struct cotree_job {
    /* The model, its parameters and prepared values. */
    const cotree_model *model;
    const cotree_real *p;
    const cotree_real *k;
    cotree_real *u; /* n_inputs values, written by the job */
#if COTREE_HAS_INPUTS
    int n_replaced;
    const cotree_table_input *replaced;
    cotree_input_function input_function; /* inputs computed by the caller; NULL: none */
    cotree_reach reach;                   /* called at the start of each segment; NULL: none */
    void *input_context;
#endif
#if COTREE_HAS_HELPER
    const cotree_helper *helper; /* the caller's solver for algebraic unknowns, or NULL */
    int is_waiting; /* 1: the job returns if the problem is stiff and another method is likely to be
                       faster */
#endif
    int has_sensitivities;
#if COTREE_HAS_CONSTRAINTS
    int is_held;   /* 1: constraints are satisfied by projection */
    int is_strict; /* 1: rates are evaluated at points projected onto the constraints, as dependent
                      constraints require */
    cotree_real correction; /* largest correction by a projection, relative to max(1, |state|) */
    /* Constraint tables for the detection of singular positions; NULL: they are not detected. */
    const cotree_assembly_tables *constraints;
    /* Records of the singular positions crossed: the time and the states at the start of each
     * stretch. NULL: not recorded. n_crossed counts all of them. */
    cotree_real *crossings;
    int most_crossings;
    int n_crossed;
#endif
#if COTREE_HAS_ALGEBRAIC
    int is_extended; /* 1: algebraic unknowns are integrated with the states */
#endif
    /* The method and its data: the model's cotree_newton for implicit methods, a cotree_sundials
     * for SUNDIALS. */
    const cotree_stepper *stepper;
    const void *aid;
    /* Problem. */
    int n; /* number of integrated entries: without sensitivities that vanish or belong to algebraic
              unknowns */
    cotree_real rtol;
    const cotree_real *atols; /* absolute tolerance of each of the n entries */
    cotree_real atol;         /* absolute tolerance of algebraic unknowns */
    cotree_real max_step;
    int n_breakpoints; /* number of breakpoints: the start, time events, the end */
    const cotree_real *breakpoints;
    cotree_real scale;                /* largest time from which breakpoints are computed */
    int is_start_sharp, is_end_sharp; /* 1: rates also have a kink or jump at this end */
#if COTREE_HAS_MOVING_BREAKPOINTS
    /* Derivatives of the breakpoint times with respect to the parameters, one row for each
     * breakpoint, and their largest differences among coinciding time events. NULL: zero. */
    const cotree_real *slopes;
    const cotree_real *spreads;
    const cotree_real *turn_tolerances; /* absolute tolerances of the sensitivities, by parameter */
    int turned; /* index in z of a sensitivity that is undefined after this time */
#endif
    /* Points are stored at the wanted times, or after each step if n_wanted is 0. */
    int n_wanted;
    const cotree_real *wanted;
    cotree_real *times;  /* space for the number of steps plus one, or for n_wanted times */
    cotree_real *values; /* one row for each stored time: all states and sensitivities */
    /* The current point. Before the first call, write z and set the other fields to zero. */
    cotree_real *z; /* all states and sensitivities at the time t */
    cotree_real t;
    int segment; /* index of the current segment, which begins at the breakpoint of this index */
    int is_begun;
    int n_kept;
    long n_steps;
    long n_rejected;
    long n_evaluations;
    long n_jacobians;
    long n_factorisations;
    int status; /* status of a failure: a cotree_status or a cotree_events_status */
#if COTREE_HAS_SUNDIALS
    int flag;          /* return value of SUNDIALS, if no status corresponds to it */
    int kernel_status; /* status of the last kernel called by SUNDIALS */
#endif
    int entry;       /* index of a rate that was not finite, or -1 */
    int row, column; /* position of a Jacobian entry that was not finite, or -1 */
#if COTREE_HAS_EVENTS
    int is_tested; /* 1: state-dependent kinks are not located but left to the error test */
    /* Records of events, COTREE_EVENTS_RECORD numbers each. The job returns if fewer than
     * COTREE_EVENTS_AT_ONCE are free. NULL: not recorded. */
    cotree_real *records;
    int most_records;
    int n_records;
    int most_events;          /* the job returns after this number of records; 0: no limit */
    int event;                /* index of the event that ended the run or failed */
    cotree_real event_time;   /* time at which the event failed */
    cotree_real event_detail; /* detail of the failure, see cotree_events_status */
    const int *has_fired;
    /* History of the events, COTREE_EVENTS_SAVED numbers: read if the job continues another one,
     * and written at its end. NULL: none. is_continued: the job starts where another one ended.
     * is_changed: states or inputs may have changed there. */
    cotree_real *watched;
    int is_continued, is_changed;
    cotree_real span;   /* time span of the whole run; 0: time span of the job */
    cotree_real *own_k; /* copy of k with the branches frozen during a step; NULL: not needed */
#endif
    void *memory; /* work space of cotree_job_memory() bytes */
    int is_stiff; /* 1: an explicit method has detected stiffness */
    cotree_real stiff_since;
    long n_stiff_steps;
    cotree_real last_step;
} cotree_job;

#define COTREE_JOB_DONE 0
#define COTREE_JOB_MORE 1
#define COTREE_JOB_FAILED 2  /* the job failed; z and t are the last valid point */
#define COTREE_JOB_STOPPED 3 /* a terminal event ended the run */
#define COTREE_JOB_STIFF 4   /* an explicit method found stiffness; the job may continue */

COTREE_BEGIN_DECLS

/* Set n and the absolute tolerances: atol times the size of the state (1 if sizes is NULL). The
 * tolerance of a sensitivity is divided by the magnitude of its parameter, p[seeds[i]]; by 1 if
 * seeds[i] is negative. */
void cotree_job_set_tolerances(cotree_job *job, int is_implicit, const cotree_real *sizes,
                               const int *seeds, cotree_real *atols);

/* Return the absolute tolerance of the sensitivities to one parameter, for states of size 1. */
cotree_real cotree_job_sensitivity_atol(const cotree_job *job, int seed);

/* Return the number of bytes of the job's memory. The model, the stepper and n must be set. */
COTREE_EXPORT size_t cotree_job_memory(cotree_job *job);

/* Take up to most_steps steps; this number does not affect the results. */
COTREE_EXPORT int cotree_job_run(cotree_job *job, long most_steps);

#if COTREE_HAS_EVENTS || COTREE_HAS_HELPER
/* Start the first segment and apply its events, without a step. Optional, before
 * cotree_job_run. */
COTREE_EXPORT int cotree_job_start(cotree_job *job);

#endif
/* Write the current point of an unfinished job to z and t. */
COTREE_EXPORT void cotree_job_sync(cotree_job *job);

#if COTREE_HAS_SUNDIALS
/* Free the resources of a stepper outside the job's memory. Only SUNDIALS has such resources. */
COTREE_EXPORT void cotree_job_end(cotree_job *job);

#endif
COTREE_END_DECLS

#endif
