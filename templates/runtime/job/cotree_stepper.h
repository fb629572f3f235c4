/* cotree_stepper.h: interface between a job and the method that takes its steps.
 *
 * The job handles breakpoints, wanted points and events. A stepper implements one method in one
 * file. Functions return 0 or a cotree_status. */
#ifndef COTREE_STEPPER_H
#define COTREE_STEPPER_H

#include "cotree_history.h"
#include "cotree_integrator.h"
#include "cotree_job.h"
#if COTREE_HAS_EVENTS
#include "cotree_events.h"
#endif
#if COTREE_HAS_CONSTRAINTS
#include "cotree_singularity.h"
#endif

COTREE_BEGIN_DECLS

/* Header of a job's memory. */
typedef struct cotree_engine {
    cotree_run runs[3];    /* storage for the runs below; several of these pointers may be equal */
    cotree_run *run;       /* run of all integrated entries */
    cotree_run *of_states; /* run of the states only, if the stepper has one; otherwise run */
    cotree_run *watched;   /* run that evaluates event functions */
#if COTREE_HAS_EVENTS
    cotree_events events;
#endif
#if COTREE_HAS_ALGEBRAIC
    cotree_real return_time; /* start of the last step that was repeated */
    cotree_real goal;        /* end of the next step if is_repeated is set */
    int is_repeated;         /* 1: the next step repeats one that failed */
#endif
#if COTREE_HAS_EVENTS || COTREE_HAS_HELPER || COTREE_HAS_CONSTRAINTS || COTREE_HAS_ALGEBRAIC
    cotree_real *before; /* values at the start of the last step */
#endif
#if COTREE_HAS_MOVING_BREAKPOINTS
    cotree_real *work[4]; /* work space between segments; only `left` persists */
#endif
#if COTREE_HAS_CONSTRAINTS
    cotree_singularity *singularity; /* NULL: singular positions are not detected */
#endif
    cotree_real *w;     /* current point of the integration, n entries */
    cotree_real origin; /* time from which the rounding of steps is measured */
    int is_running;     /* 1: the last step can be interpolated */
    int is_helped; /* 1: w has algebraic unknowns that the helper computed after a breakpoint */
    int n_short;   /* number of successive steps at rounding level */
    void *own;     /* data of the stepper */
} cotree_engine;

struct cotree_stepper {
    int is_multistep; /* 1: steps depend on earlier steps */
    /* Allocate engine->own and the runs. cotree_engine_of is not yet available. */
    void (*lay_out)(cotree_job *job, cotree_engine *engine, cotree_arena *arena);
    /* Initialise the runs, and write the start of the job to engine->w. */
    void (*open)(cotree_job *job);
    /* Restart from engine->w at job->t towards the next breakpoint; project w. */
    int (*begin)(cotree_job *job);
    /* Take one step towards the end: advance job->t and engine->w, or leave both unchanged. */
    int (*step)(cotree_job *job, cotree_real end);
    /* Return the time up to which wanted points can be interpolated now. */
    cotree_real (*known)(const cotree_job *job, int is_last);
    /* Compute the solution at a time within the last step. If is_careful is set, it is as accurate
     * as the steps. is_exact: t is the end of a step. The caller may change the values. */
    int (*between)(cotree_job *job, cotree_real t, int is_careful, cotree_real **w, int *is_exact);
    /* Project a point, solve for its algebraic unknowns, and store it in run->full. */
    int (*complete)(cotree_job *job, cotree_real t, cotree_real *w, int is_exact);
    /* Store which entry caused a status; may be NULL. */
    void (*blame)(cotree_job *job, int status);
#if COTREE_HAS_EVENTS
    /* Return the history for interpolation within the last step; NULL: between() is inexpensive. */
    const cotree_history *(*history)(const cotree_job *job);
#endif
#if COTREE_HAS_SUNDIALS
    /* Release resources outside the job's memory; may be NULL. */
    void (*close)(cotree_job *job);
#endif
};

/* Initialise one of a job's runs. */
cotree_run *cotree_job_begin_run(cotree_job *job, cotree_run *run, int has_sensitivities,
                                 cotree_arena *arena);

/* Inline, because it is called very often. */
static inline cotree_engine *cotree_engine_of(const cotree_job *job)
{
    return (cotree_engine *)job->memory;
}

/* Return the prepared values, including the branches frozen during a step. */
static inline const cotree_real *cotree_job_prepared(const cotree_job *job)
{
#if COTREE_HAS_EVENTS
    if (job->own_k != NULL) return job->own_k;
#endif
    return job->k;
}

/* Return the direction of integration, 1 or -1. */
cotree_real cotree_job_ahead(const cotree_job *job);

COTREE_END_DECLS

#endif
