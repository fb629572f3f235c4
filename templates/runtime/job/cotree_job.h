/* cotree_job.h: an integration that its caller advances by some steps at a time.
 *
 * A job processes corners (its start, time events and its end), wanted points and events; a
 * stepper takes the steps in between. */
#ifndef COTREE_JOB_H
#define COTREE_JOB_H

#include "cotree_run.h"
#if COTREE_HAS_CONSTRAINTS
#include "cotree_start_tables.h"
#endif

/* A method that takes the steps of a job, see cotree_stepper.h. */
typedef struct cotree_stepper cotree_stepper;

/* Callback at the start of each segment between corners, before evaluations in it, with the time
 * and all states and sensitivities: values of tables may change. Return 0 to continue. */
typedef int (*cotree_reach)(cotree_real t, const cotree_real *z, void *context);

typedef struct cotree_job {
    /* The model, its parameters and prepared values. */
    const cotree_model *model;
    const cotree_real *p;
    const cotree_real *k;
    cotree_real *u; /* n_inputs */
#if COTREE_HAS_INPUTS
    int n_replaced;
    const cotree_table_input *replaced;
    cotree_input_function input_function; /* NULL: none */
    cotree_reach reach;                   /* NULL: none */
    void *input_context;
#endif
#if COTREE_HAS_HELPER
    const cotree_helper *helper; /* NULL: none */
    int is_waiting; /* 1: the job returns if the problem is stiff and another method is likely to
                     * be faster */
#endif
    int has_sensitivities;
#if COTREE_HAS_CONSTRAINTS
    int is_held;   /* 1: constraints are satisfied by projection */
    int is_strict; /* 1: rates are evaluated on the constraints, as dependent ones require */
    cotree_real correction; /* the largest correction, as a share of a state or of 1 */
    /* Tables of the constraints, by which singular positions are detected; NULL: none are. */
    const cotree_assembly_tables *constraints;
    /* Records of singular positions that were crossed: time and states where each stretch began.
     * NULL: none are written. n_crossed counts all. */
    cotree_real *crossings;
    int most_crossings;
    int n_crossed;
#endif
#if COTREE_HAS_ALGEBRAIC
    int is_extended; /* 1: algebraic unknowns are integrated */
#endif
    /* The method, and its data: the model's cotree_newton for implicit methods, a
     * cotree_sundials for SUNDIALS. */
    const cotree_stepper *stepper;
    const void *aid;
    /* The problem. */
    int n; /* entries integrated: without sensitivities that vanish, or that belong to algebraic
              unknowns */
    cotree_real rtol;
    const cotree_real *atols; /* n */
    cotree_real atol;         /* absolute tolerances of algebraic unknowns */
    cotree_real max_step;
    int n_corners; /* the start, time events, the end */
    const cotree_real *corners;
    cotree_real scale; /* the largest time from which corners are computed: they round as it does */
    int is_start_sharp, is_end_sharp; /* 1: rates have a kink or jump there, too */
#if COTREE_HAS_MOVING_CORNERS
    /* Derivatives of the times of corners by the parameters, one row each, and the largest
     * difference of these among coinciding events; NULL: zero. */
    const cotree_real *slopes;
    const cotree_real *spreads;
    const cotree_real *turn_tolerances; /* absolute tolerances of sensitivities to each parameter */
    int turned; /* the place in z of a sensitivity that does not exist after this time */
#endif
    /* Stored points: at the wanted times, or after each step if n_wanted is 0. */
    int n_wanted;
    const cotree_real *wanted;
    cotree_real *times;  /* space for one row more than steps, or for the wanted times */
    cotree_real *values; /* all states and sensitivities in each row */
    /* The present point. Fill z and set the rest to zero before the first call. */
    cotree_real *z; /* all states and sensitivities */
    cotree_real t;
    int corner; /* the last one passed */
    int is_begun;
    int n_kept;
    long n_steps;
    long n_rejected;
    long n_evaluations;
    long n_jacobians;
    long n_factorisations;
    int status; /* of a failure: a cotree_status or a cotree_events_status */
#if COTREE_HAS_SUNDIALS
    int flag;      /* of SUNDIALS, if status has no name for it */
    int complaint; /* status of the last kernel called by SUNDIALS */
#endif
    int entry;       /* of a rate that was not finite, or -1 */
    int row, column; /* of an entry of the Jacobian that was not finite, or -1 */
#if COTREE_HAS_EVENTS
    int is_tested; /* 1: kinks that depend on the state are left to the error test */
    /* Records of events, COTREE_EVENTS_RECORD numbers each. The job returns if there is no space
     * for COTREE_EVENTS_AT_ONCE more. NULL: none are written. */
    cotree_real *records;
    int most_records;
    int n_records;
    int most_events;          /* the job returns after so many records; 0: no limit */
    int event;                /* the event that ended the run, or failed */
    cotree_real event_time;   /* time of the failure */
    cotree_real event_detail; /* see cotree_events.h */
    const int *has_fired;
    /* State of the events, COTREE_EVENTS_SAVED numbers, from the job before this one and for the
     * next; NULL: none. is_continued: this job starts at the end of another one. is_changed:
     * states or inputs may have changed there. */
    cotree_real *watched;
    int is_continued, is_changed;
    cotree_real span;   /* span of the whole run, if the job is a part of it; 0: that of its
                         * corners */
    cotree_real *own_k; /* own copy of k with the branches that steps hold; NULL: not needed */
#endif
    void *memory; /* cotree_job_memory(...) bytes */
    int is_stiff; /* stiffness as detected by explicit methods */
    cotree_real stiff_since;
    long n_stiff_steps;
    cotree_real last_step;
} cotree_job;

#define COTREE_JOB_DONE 0
#define COTREE_JOB_MORE 1
#define COTREE_JOB_FAILED 2  /* z and t are the last good point */
#define COTREE_JOB_STOPPED 3 /* by an event */
#define COTREE_JOB_STIFF 4   /* stiff; may be continued */

COTREE_BEGIN_DECLS

/* Set n, and the absolute tolerances to atol times the sizes of the states (NULL: 1), divided for a
 * sensitivity by the size of the parameter at its place in seeds (negative: 1). */
void cotree_job_set_tolerances(cotree_job *job, int is_implicit, const cotree_real *sizes,
                               const int *seeds, cotree_real *atols);

/* Return the absolute tolerance of sensitivities to the parameter at a place, for factors of 1. */
cotree_real cotree_job_sensitivity_atol(const cotree_job *job, int seed);

/* Return the bytes of the job's memory. The model, its stepper and n must be set. */
COTREE_EXPORT size_t cotree_job_memory(cotree_job *job);

/* Take up to most_steps steps; the results do not depend on the number per call. */
COTREE_EXPORT int cotree_job_run(cotree_job *job, long most_steps);

#if COTREE_HAS_EVENTS || COTREE_HAS_HELPER
/* Start the first segment with its events, without a step, in place of the first call of run. */
COTREE_EXPORT int cotree_job_start(cotree_job *job);

#endif
/* Write the present point of a job that is not finished; a finished or waiting job has written
 * it. */
COTREE_EXPORT void cotree_job_sync(cotree_job *job);

#if COTREE_HAS_SUNDIALS
/* Free the resources that a stepper holds outside the memory; those of cotree hold none. */
COTREE_EXPORT void cotree_job_end(cotree_job *job);

#endif
COTREE_END_DECLS

#endif
