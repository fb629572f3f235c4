/* cotree_batch.h: many runs of one model, distributed over threads.
 *
 * A batch holds the data common to all members, the data of each member by its index, and the
 * results. Each thread owns a worker and calls cotree_batch_work until no member is left. The
 * results of a member depend only on its data, not on the thread or the order. */
#ifndef COTREE_BATCH_H
#define COTREE_BATCH_H

#include "cotree_job.h"
#include "cotree_start.h"

typedef struct cotree_batch cotree_batch;
typedef struct cotree_worker cotree_worker;

struct cotree_batch {
    /* Common to all members: a job that has not started (the pattern), and the functions that run
     * and end a job. */
    const cotree_job *pattern;
    int (*run)(cotree_job *job, long most_steps);
    void (*end)(cotree_job *job);
    size_t memory;     /* size of a job's memory, [bytes] */
    long max_steps;    /* limit for each member; 0: unlimited */
    double time_limit; /* wall-clock limit for each member, [s] */
    double interval;   /* a call returns to the caller after this time, [s] */
    int is_watched;    /* 1: members that an explicit method finds stiff are returned */
    int n_full;        /* number of states and sensitivities */
    /* Data of the members, one row each. If has_given_jobs is set, the caller provides the job of
     * each member: its start needs a search, or its time events differ. */
    int n_members;
    int has_given_jobs;
    const cotree_start_tables *start_tables;
    int (*find_start)(cotree_start_call *call);
    int if_dependent; /* if constraints are dependent at the start: 0 ignore, 1 set job is_strict, 2
                         reject */
    const double *p;  /* n_parameters values in each row */
    int n_set;        /* number of initial values that replace the model's */
    const int *set;   /* n_set state indices */
    const double *set_values;      /* n_set values in each row */
    const double *atols;           /* n absolute tolerances in each row; NULL: as in the pattern */
    const double *turn_tolerances; /* n_sensitivities in each row; NULL: as in the pattern */
    /* Inputs that replace the scene's inputs in the evaluation of outputs. */
    int n_given;
    const int *given;           /* n_given input indices */
    const double *given_values; /* n_given values at each wanted time */
    /* Results of the members, one row each. Rows after the end of a run are nan. */
    double *values; /* n_wanted rows of n_full */
    int n_outputs;  /* number of outputs kept */
    const int *outputs;
    double *output_values; /* n_wanted rows of n_outputs */
    double *output_slopes; /* n_wanted rows of n_sensitivities rows of n_outputs */
    int *ended;            /* a COTREE_MEMBER_ code; members with code zero are run */
    int *n_kept;           /* number of wanted times reached */
    long *n_steps;
    double *seconds;
    double *corrections; /* largest corrections by projections, see cotree_job */
    /* Shared by all threads. */
    int next;       /* next member to run; access it through cotree_batch_take */
    int is_stopped; /* nonzero: all workers return as soon as possible */
    /* Run several members at once, one in each SIMD lane, in a worker without a current member;
     * NULL: not available. Return a code of cotree_batch_work; COTREE_BATCH_EMPTY: no member is
     * left. Members that cannot be finished get the code COTREE_MEMBER_LEFT. */
    int (*lanes)(cotree_worker *worker);
    long most_in_lanes; /* maximum number of steps of a member in `lanes`; 0: no limit */
    /* Used by `lanes`: compute k and z at the start of a member; finish a member. Both return 0, or
     * the code of the member's failure. */
    int (*prepare)(const cotree_batch *batch, int member, double *k, double *z);
    int (*finish)(cotree_worker *worker, int member, const double *k);
    double (*now)(void); /* returns the time of a monotonic clock, [s] */
};

struct cotree_worker {
    cotree_batch *batch;
    int member; /* the current member; -1: none */
    int stage;  /* stage of the current member; its stepper may still be open after its end */
    double begun;
    long watched_from; /* stiffness is checked after this number of steps */
    cotree_job job;
    const cotree_job *given_job; /* job that the caller provides for the member */
    void *memory;
    double *k, *u, *z, *times;
    double *inputs, *outputs, *slopes; /* work space for one member, at the wanted times */
    double *records;                   /* event records of one member */
    int most_records;
    /* Events of all members. Each row: member, event, time and derivatives of the time. */
    double *events;
    int most_events;
    int n_events;
    void *own; /* memory block for `lanes` */
};

/* How a member ended. Codes above COTREE_MEMBER_STOPPED are failures. */
#define COTREE_MEMBER_WAITS 0
#define COTREE_MEMBER_DONE 1
#define COTREE_MEMBER_STOPPED 2    /* terminal event */
#define COTREE_MEMBER_FAILED 3     /* the integration failed; the status is in the job */
#define COTREE_MEMBER_REFUSED 4    /* parameters or start were rejected */
#define COTREE_MEMBER_NO_OUTPUTS 5 /* outputs cannot be evaluated */
#define COTREE_MEMBER_STIFF 6      /* stiff: left to an implicit method */
#define COTREE_MEMBER_STEPS 7      /* step limit reached */
#define COTREE_MEMBER_EVENTS 8
#define COTREE_MEMBER_TIME 9
#define COTREE_MEMBER_LEFT 10 /* returned by `lanes`, to be run by scalar code */

#define COTREE_BATCH_EMPTY 0    /* no member is left */
#define COTREE_BATCH_AGAIN 1    /* more members may be left: call again */
#define COTREE_BATCH_NO_SPACE 2 /* call again with more space for records or events */
/* The current member is unfinished: call again with member = -1 to start another one or, if it
 * waits, with the same member to continue. */
#define COTREE_BATCH_UNFINISHED 3
#define COTREE_BATCH_STOPPED 4 /* the batch was stopped, and the current member with it */
#define COTREE_BATCH_PREPARE 5 /* call again with given_job set, or with another member or -1 */

COTREE_BEGIN_DECLS

/* Run members until none is left or the caller must act. */
COTREE_EXPORT int cotree_batch_work(cotree_worker *worker);

/* Release the resources of a worker's last job. */
COTREE_EXPORT void cotree_batch_close(cotree_worker *worker);

/* Compute the prepared values and the start of a member. Return 0, or the code of its failure. */
COTREE_EXPORT int cotree_batch_prepare(const cotree_batch *batch, int member, double *k, double *z);

/* Evaluate the outputs of a member at its first n_kept stored times; the remaining rows are nan. */
COTREE_EXPORT int cotree_batch_finish(cotree_worker *worker, int member, const double *k);

/* Return the time of a monotonic clock, [s]. */
COTREE_EXPORT double cotree_batch_now(void);

/* Return the maximum number of threads for a batch: 1 without atomic operations. */
COTREE_EXPORT int cotree_batch_most_threads(void);

/* Number of steps between two checks of the clock and is_stopped. */
#define COTREE_BATCH_STEPS 16

/* Return whether workers must stop. */
static inline int cotree_batch_is_stopped(const cotree_batch *batch)
{
#if defined(__GNUC__) || defined(__clang__)
    return __atomic_load_n(&batch->is_stopped, __ATOMIC_RELAXED);
#else
    return batch->is_stopped;
#endif
}

/* Return the index of the next member to run, or -1 if none is left. */
static inline int cotree_batch_take(cotree_batch *batch)
{
    for (;;) {
#if defined(__GNUC__) || defined(__clang__)
        const int member = __atomic_fetch_add(&batch->next, 1, __ATOMIC_RELAXED);
#else
        const int member = batch->next++; /* single-threaded: cotree_batch_most_threads() is 1 */
#endif
        if (member >= batch->n_members) return -1;
        if (batch->ended[member] == COTREE_MEMBER_WAITS) return member;
    }
}

COTREE_END_DECLS

#endif
