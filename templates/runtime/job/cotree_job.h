/* cotree_job.h: an integration that is driven from outside, some steps at a time.
 * Part of the runtime of cotree, the same for every model.
 *
 * A job goes through corners, wanted points and events; a stepper takes the steps in between.
 */
#ifndef COTREE_JOB_H
#define COTREE_JOB_H

#include "cotree_run.h"

#include <stddef.h>

/* cotree: begin of the part that cffi reads */
/* A method that takes the steps of a job; cotree_stepper.h says what that is. */
typedef struct cotree_stepper cotree_stepper;

#if COTREE_HAS_INPUTS
/* Is told the time and all states and sensitivities where a segment between corners begins, before
 * anything is evaluated in it: values of tables may change. 0: go on. */
typedef int (*cotree_reach)(cotree_real t, const cotree_real *z, void *context);
#endif

typedef struct cotree_job {
    /* The model and its parameters, prepared. */
    const cotree_model *model;
    const cotree_real *p;
    const cotree_real *k;
    cotree_real *u; /* n_inputs */
#if COTREE_HAS_INPUTS
    int n_replaced;
    const cotree_table_input *replaced;
    cotree_input_function input_function; /* NULL: none */
    cotree_reach reach;                   /* NULL: nobody */
    void *input_context;
#endif
#if COTREE_HAS_HELPER
    const cotree_helper *helper; /* NULL: nobody */
#endif
    int has_sensitivities;
#if COTREE_HAS_CONSTRAINTS
    int is_held;            /* to the constraints */
    int is_strict;          /* rates, too, as dependent constraints need */
    cotree_real correction; /* the largest one, as a share of a state or of 1 */
#endif
#if COTREE_HAS_ALGEBRAIC
    int is_extended; /* algebraic unknowns are integrated, too */
#endif
    /* The method, and what it needs besides: of implicit methods the model's cotree_newton, of
     * SUNDIALS a cotree_sundials. */
    const cotree_stepper *stepper;
    const void *aid;
    /* The problem. */
    int n; /* what is integrated: no sensitivities that vanish, nor those of algebraic unknowns */
    cotree_real rtol;
    const cotree_real *atols; /* n */
    cotree_real atol;         /* of algebraic unknowns */
    cotree_real max_step;
    int n_corners; /* start, breakpoints and end */
    const cotree_real *corners;
    cotree_real scale; /* the largest time that these are made of, whose rounding they have */
    int is_start_sharp, is_end_sharp; /* whether rates have a kink or jump there, too */
#if COTREE_HAS_MOVING_CORNERS
    /* How the times of corners depend on the parameters, a row for each corner, and by how much
     * that differs among all that meets there; NULL: not at all. */
    const cotree_real *slopes;
    const cotree_real *spreads;
    const cotree_real *turn_tolerances; /* of sensitivities to each parameter */
    int turned; /* the place in z of a sensitivity that does not exist from here on */
#endif
    /* What is kept: at the wanted times, or where there are none, after each step. */
    int n_wanted;
    const cotree_real *wanted;
    cotree_real *times;  /* room for one row more than there will be steps, or for what is wanted */
    cotree_real *values; /* all states and sensitivities each */
    /* Where it is. Fill z and set the rest to zero before the first call. */
    cotree_real *z; /* all states and sensitivities */
    cotree_real t;
    int corner; /* the one that it comes from */
    int is_begun;
    int n_kept;
    long n_steps;
    long n_rejected;
    long n_evaluations;
    long n_jacobians;
    long n_factorisations;
    int status;      /* where it failed: a cotree_status, or of an event; see cotree_events.h */
    int flag;        /* of SUNDIALS, for which status has no name */
    int complaint;   /* of the kernel that SUNDIALS asked last */
    int entry;       /* of the rate that was not a number, or -1 */
    int row, column; /* of what was not a number in the Jacobian, or -1 */
#if COTREE_HAS_EVENTS
    int is_tested; /* the error test is to find corners of the rates that depend on the state */
    /* Events: what happened, a record of COTREE_EVENTS_RECORD cotree_reals each, if there is room
     * for COTREE_EVENTS_AT_ONCE more; else the job waits for more room. NULL: of no interest. */
    cotree_real *records;
    int most_records;
    int n_records;
    int most_events;          /* where that many are recorded, the job waits; 0: however many */
    int event;                /* that which ended the run, or failed */
    cotree_real event_time;   /* when it failed */
    cotree_real event_detail; /* see cotree_events.h */
    const int *has_fired;
    /* What events know, COTREE_EVENTS_SAVED cotree_reals, from the job before this one and for the
     * one after it; NULL: of no interest. is_continued: there is one before, and nothing changed
     * where it ended; is_changed: something may have. */
    cotree_real *watched;
    int is_continued, is_changed;
    cotree_real span;    /* of the whole run that the job is a part of; 0: that of its corners */
    cotree_real *pieces; /* the job's own copy of k, with the pieces that its steps hold; NULL: it
                            needs none */
#endif
    void *memory; /* cotree_job_memory(...) bytes */
    /* Of explicit methods: whether the job waits where the problem is stiff and worth another one.
     */
    int is_waiting;
    int is_stiff;
    cotree_real stiff_since;
    long n_stiff_steps;
    cotree_real last_step;
} cotree_job;
/* cotree: end of the part that cffi reads */

#define COTREE_JOB_DONE 0
#define COTREE_JOB_MORE 1
#define COTREE_JOB_FAILED 2  /* z and t are the last good point */
#define COTREE_JOB_STOPPED 3 /* by an event */
#define COTREE_JOB_STIFF 4   /* it may go on */

#ifdef __cplusplus
extern "C" {
#endif

/* How many bytes the memory of a job has, once the model, its stepper and n are filled in. */
COTREE_EXPORT size_t cotree_job_memory(cotree_job *job);

/* Takes some steps. How many at once changes nothing. */
COTREE_EXPORT int cotree_job_run(cotree_job *job, long most_steps);

#if COTREE_HAS_EVENTS || COTREE_HAS_HELPER
/* Processes the events at the start, in place of the first call, and takes no step. */
COTREE_EXPORT int cotree_job_start(cotree_job *job);

#endif
/* Writes where a job stands that has more to do: nobody may go on from here. A job that has ended
 * or waits has written it. */
COTREE_EXPORT void cotree_job_stand(cotree_job *job);

/* Frees what a stepper holds outside the memory; cotree's own hold nothing. */
COTREE_EXPORT void cotree_job_end(cotree_job *job);

#ifdef __cplusplus
}
#endif

#endif
