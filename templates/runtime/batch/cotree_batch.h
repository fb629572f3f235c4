/* cotree_batch.h: many runs of one model, which threads take from one counter.
 *
 * A batch holds what its members share, the data of each member by its number, and the results.
 * Each thread has a worker, and calls cotree_batch_work until no member is left. The results of
 * a member depend on its data only, not on the thread or the order. */
#ifndef COTREE_BATCH_H
#define COTREE_BATCH_H

#include "cotree_job.h"
#include "cotree_start.h"

typedef struct cotree_batch cotree_batch;
typedef struct cotree_worker cotree_worker;

struct cotree_batch {
    /* Shared by all members: a job that has not started, of the engine that runs it. */
    const cotree_job *pattern;
    int (*run)(cotree_job *job, long most_steps);
    void (*end)(cotree_job *job);
    size_t memory;     /* bytes of a job */
    long max_steps;    /* of each member; 0: no limit */
    double time_limit; /* [s] */
    double interval;   /* a call returns after this time, [s] */
    int is_watched;    /* 1: members wait if an explicit method finds them stiff */
    int n_full;        /* number of states and sensitivities */
    /* Data of each member, one row each. With has_given_jobs the caller provides the job of each
     * member, since its start needs a search or it has time events of its own. */
    int n_members;
    int has_given_jobs;
    const cotree_start_tables *start_tables;
    int (*find_start)(cotree_start_call *call);
    int if_dependent; /* constraints at the start: 0 no matter, 1 job is_strict, 2 refused */
    const double *p;  /* n_parameters each */
    int n_set;        /* initial values set in place of the model's */
    const int *set;   /* n_set: the states */
    const double *set_values;      /* n_set each */
    const double *atols;           /* n each; NULL: the pattern's */
    const double *turn_tolerances; /* n_sensitivities each; NULL: the pattern's */
    /* Inputs in place of the scene's, for outputs. */
    int n_given;
    const int *given;           /* n_given */
    const double *given_values; /* n_given at each wanted time */
    /* Results of each member, one row each; rows behind the end are nan. */
    double *values; /* n_wanted rows of n_full */
    int n_outputs;  /* number of outputs kept */
    const int *outputs;
    double *output_values; /* n_wanted rows of n_outputs */
    double *output_slopes; /* n_wanted rows of n_sensitivities rows of n_outputs */
    int *ended;            /* COTREE_MEMBER_...; a member is run if it is zero */
    int *n_kept;           /* number of wanted times reached */
    long *n_steps;
    double *seconds;
    double *corrections; /* as in a job */
    /* Shared by the threads. */
    int next;       /* the next member; use cotree_batch_take */
    int is_stopped; /* not zero: all workers return as soon as possible */
    /* Another way to run members, for workers without one at work; NULL: none. Returns like
     * cotree_batch_work, COTREE_BATCH_EMPTY if no member is left. Members that it cannot finish
     * are COTREE_MEMBER_LEFT. */
    int (*lanes)(cotree_worker *worker);
    long most_in_lanes; /* a member is left after so many steps; 0: no limit */
    /* For lanes: start a member, filling k and z, and finish it. Return 0, or how the member
     * ended. */
    int (*prepare)(const cotree_batch *batch, int member, double *k, double *z);
    int (*finish)(cotree_worker *worker, int member, const double *k);
    double (*now)(void); /* returns the time since a fixed moment, [s] */
};

struct cotree_worker {
    cotree_batch *batch;
    int member; /* the current member; -1: none */
    int stage;  /* of the current member; its stepper may be open after its end */
    double begun;
    long watched_from; /* it waits if stiff after this number of steps */
    cotree_job job;
    const cotree_job *given_job; /* the job provided for it */
    void *memory;
    double *k, *u, *z, *times;
    double *inputs, *outputs, *slopes; /* of a member, at the wanted times */
    double *records;                   /* of the events of a member */
    int most_records;
    /* Events of all members: member, event, time and its derivatives. */
    double *events;
    int most_events;
    int n_events;
    void *own; /* memory of lanes */
};

/* How a member ended; those after STOPPED are failures. */
#define COTREE_MEMBER_WAITS 0
#define COTREE_MEMBER_DONE 1
#define COTREE_MEMBER_STOPPED 2    /* by an event */
#define COTREE_MEMBER_FAILED 3     /* see the job */
#define COTREE_MEMBER_REFUSED 4    /* its parameters or start are rejected */
#define COTREE_MEMBER_NO_OUTPUTS 5 /* its outputs cannot be evaluated */
#define COTREE_MEMBER_STIFF 6      /* it waits for another method */
#define COTREE_MEMBER_STEPS 7      /* a budget is used up */
#define COTREE_MEMBER_EVENTS 8
#define COTREE_MEMBER_TIME 9
#define COTREE_MEMBER_LEFT 10 /* by lanes: another worker runs it */

#define COTREE_BATCH_EMPTY 0    /* no member is left */
#define COTREE_BATCH_AGAIN 1    /* call again */
#define COTREE_BATCH_NO_SPACE 2 /* call again with more space for records or events */
/* The member at work has not reached its end: call again with member -1, or, if it waits, with the
 * same to continue. */
#define COTREE_BATCH_UNFINISHED 3
#define COTREE_BATCH_STOPPED 4 /* the batch is stopped, and with it the member at work */
#define COTREE_BATCH_PREPARE 5 /* call again with given_job set, with another member, or -1 */

COTREE_BEGIN_DECLS

/* Run members until none is left or the caller has to act. */
COTREE_EXPORT int cotree_batch_work(cotree_worker *worker);

/* Free what the last job of a worker holds. */
COTREE_EXPORT void cotree_batch_close(cotree_worker *worker);

/* Compute the prepared values and the start of a member. Return 0, or how it ended. */
COTREE_EXPORT int cotree_batch_prepare(const cotree_batch *batch, int member, double *k, double *z);

/* Evaluate the outputs of a member at its first n_kept values; the rest are nan. */
COTREE_EXPORT int cotree_batch_finish(cotree_worker *worker, int member, const double *k);

/* Return the time since a fixed moment, [s]. */
COTREE_EXPORT double cotree_batch_now(void);

/* Return the largest number of threads that may share a batch. */
COTREE_EXPORT int cotree_batch_most_threads(void);

/* Steps between two checks of the clock and of is_stopped. */
#define COTREE_BATCH_STEPS 16

/* Return whether workers have to return. */
static inline int cotree_batch_is_stopped(const cotree_batch *batch)
{
#if defined(__GNUC__) || defined(__clang__)
    return __atomic_load_n(&batch->is_stopped, __ATOMIC_RELAXED);
#else
    return batch->is_stopped;
#endif
}

/* Take the next member to run; -1: none is left. */
static inline int cotree_batch_take(cotree_batch *batch)
{
    for (;;) {
#if defined(__GNUC__) || defined(__clang__)
        const int member = __atomic_fetch_add(&batch->next, 1, __ATOMIC_RELAXED);
#else
        const int member = batch->next++; /* cotree_batch_most_threads() is 1 */
#endif
        if (member >= batch->n_members) return -1;
        if (batch->ended[member] == COTREE_MEMBER_WAITS) return member;
    }
}

COTREE_END_DECLS

#endif
