/* cotree_stepper.h: what takes the steps of a job, and what a job shares with it.
 * Part of the runtime of cotree, the same for every model.
 *
 * The job knows corners, wanted points and events, but no method; a stepper knows nothing else than
 * its method. A new one is one file with a cotree_stepper. Functions return 0 or a cotree_status.
 */
#ifndef COTREE_STEPPER_H
#define COTREE_STEPPER_H

#include "cotree_history.h"
#include "cotree_integrator.h"
#include "cotree_job.h"
#if COTREE_HAS_EVENTS
#include "cotree_events.h"
#endif

#ifdef __cplusplus
extern "C" {
#endif

/* What a job has at the front of its memory. */
typedef struct cotree_engine {
    cotree_run runs[3];    /* those that follow, as many as differ */
    cotree_run *run;       /* of all that is integrated */
    cotree_run *of_states; /* of the states alone, where a stepper has one; else the same */
    cotree_run *watched;   /* what events look at */
#if COTREE_HAS_EVENTS
    cotree_events events;
#endif
#if COTREE_HAS_EVENTS || COTREE_HAS_HELPER
    cotree_real *before; /* where its last step began */
#endif
#if COTREE_HAS_MOVING_CORNERS
    cotree_real *room[4]; /* for what is done between segments; left is to stay there */
#endif
    cotree_real *w;     /* where the job stands, n values */
    cotree_real origin; /* steps are rounding by their distance from it */
    int is_running;     /* whether values within the last step can be had */
    int is_helped;      /* whether w has unknowns of the time behind a corner, not at it */
    int n_short;        /* steps of rounding, one after another */
    void *own;          /* of the stepper */
} cotree_engine;

struct cotree_stepper {
    /* Takes its memory: engine->own, and the runs. Called before engine_of tells the engine. */
    void (*lay_out)(cotree_job *job, cotree_engine *engine, cotree_room *room);
    /* Begins the runs, and writes where the job begins to engine->w. */
    void (*open)(cotree_job *job);
    /* Begins anew from engine->w at job->t, to where the corner ends; moves w onto constraints. */
    int (*begin)(cotree_job *job);
    /* Takes one step towards the end: moves job->t and engine->w, or leaves them. */
    int (*step)(cotree_job *job, cotree_real end);
    /* Gives the time up to which wanted points should be read now. */
    cotree_real (*known)(const cotree_job *job, int is_last);
    /* Gives the values at a time that is known, or, where is_careful, within the last step as
     * accurate as steps are. is_exact: they are those of a step's end. They may be changed. */
    int (*between)(cotree_job *job, cotree_real t, int is_careful, cotree_real **w, int *is_exact);
    /* What cheap values within the last step are read from; NULL: careful ones are cheap. */
    const cotree_history *(*history)(const cotree_job *job);
    /* Completes a point, on the constraints, with its algebraic unknowns: to run->full. */
    int (*complete)(cotree_job *job, cotree_real t, cotree_real *w, int is_exact);
    /* Looks for what a status is due to; may be NULL. */
    void (*blame)(cotree_job *job, int status);
    /* Frees what it holds outside the memory; may be NULL. */
    void (*close)(cotree_job *job);
};

/* Begins a run of a job. */
cotree_run *cotree_job_begin_run(cotree_job *job, cotree_run *run, int has_sensitivities,
                                 cotree_room *room);

/* Inline: steppers ask for it again and again. */
static inline cotree_engine *cotree_engine_of(const cotree_job *job)
{
    return (cotree_engine *)job->memory;
}

/* Gives the prepared values, with the pieces that steps hold. */
static inline const cotree_real *cotree_job_prepared(const cotree_job *job)
{
#if COTREE_HAS_EVENTS
    if (job->pieces != NULL) return job->pieces;
#endif
    return job->k;
}

/* Gives the direction of time, 1 or -1. */
cotree_real cotree_job_ahead(const cotree_job *job);

#ifdef __cplusplus
}
#endif

#endif
