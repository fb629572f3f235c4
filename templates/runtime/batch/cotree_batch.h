/* cotree_batch.h: many runs of one model, taken by threads from one counter.
 * Part of the runtime of cotree, the same for every model and method.
 *
 * A batch says what its members share, gives what each has of its own by its number, and takes what
 * comes out of it. Each thread has a worker, and calls cotree_batch_work with it until nothing is
 * left. Results of a member depend on the member alone, whoever runs it and when.
 */
#ifndef COTREE_BATCH_H
#define COTREE_BATCH_H

#include "cotree_job.h"

/* cotree: begin of the part that cffi reads */
typedef struct cotree_batch cotree_batch;
typedef struct cotree_worker cotree_worker;

struct cotree_batch {
    /* What members share: a job that has not begun, of the engine that runs it. */
    const cotree_job *pattern;
    int (*run)(cotree_job *job, long most_steps);
    void (*end)(cotree_job *job);
    size_t memory;     /* bytes of a job's */
    long max_steps;    /* budgets of each; 0: none */
    double time_limit; /* [s] */
    double glance;     /* a call comes back after this time, [s] */
    int is_watched;    /* whether members wait where an explicit method finds them stiff */
    int n_full;        /* all states and sensitivities */
    /* What each has of its own: a row for each member. Where its start has to be searched for, or
     * it has corners of its own, each is asked for: somebody else gives a job that has not begun.
     */
    int n_members;
    int are_asked_for;
    const double *p;          /* n_parameters each */
    int n_set;                /* initial values in place of the model's */
    const int *set;           /* n_set: the states */
    const double *set_values; /* n_set each */
    const int *set_by;   /* n_set: the parameter of sensitivity that is this initial value, or -1 */
    const double *atols; /* n each; NULL: the pattern's */
    const double *turn_tolerances; /* n_sensitivities each; NULL: the pattern's */
    /* Inputs in place of the scene's, as outputs see them. */
    int n_given;
    const int *given;           /* n_given */
    const double *given_values; /* n_given at each wanted time */
    /* What comes out of each: a row for each member, of which those behind its end are not numbers.
     */
    double *values; /* n_wanted rows of n_full */
    int n_outputs;  /* how many are kept */
    const int *outputs;
    double *output_values; /* n_wanted rows of n_outputs */
    double *output_slopes; /* n_wanted rows of n_sensitivities rows of n_outputs */
    int *ended;            /* COTREE_MEMBER_...: where it is not zero, the member is not run */
    int *n_kept;           /* wanted times that were reached */
    long *n_steps;
    double *seconds;
    double *corrections; /* as of a job */
    /* Shared by the threads. */
    int next;       /* the member that is taken next: by cotree_batch_take */
    int is_stopped; /* where that is not zero, all come back as soon as they can */
    /* Another way to run members, for workers that have none in work; NULL: none. It takes as many
     * as it wants, and returns as cotree_batch_work does; COTREE_BATCH_EMPTY where none is left.
     * Members that it cannot bring to their end are to be COTREE_MEMBER_LEFT. */
    int (*lanes)(cotree_worker *worker);
    long most_in_lanes; /* a member that takes so many steps is left; 0: however many it takes */
    /* For it: what begins a member, with k and z to be filled, and ends it. 0: all is well; else
     * the member has ended. */
    int (*prepare)(const cotree_batch *batch, int member, double *k, double *z);
    int (*finish)(cotree_worker *worker, int member, const double *k);
    double (*now)(void); /* the time since some moment, [s] */
};

struct cotree_worker {
    cotree_batch *batch;
    int member; /* the one in work; -1: none */
    int stage;  /* where that stands; it may be in work no longer before its stepper is closed */
    double begun;
    long watched_from; /* the number of steps from which on it waits where it is stiff */
    cotree_job job;
    const cotree_job *asked; /* what was given for it */
    void *memory;
    double *k, *u, *z, *times;
    double *inputs, *outputs, *slopes; /* of a member, at the wanted times */
    double *records;                   /* what happened to a member */
    int most_records;
    /* What happened to all members: member, event, time and its derivatives. */
    double *happened;
    int most_happened;
    int n_happened;
    void *own; /* of lanes */
};
/* cotree: end of the part that cffi reads */

/* How a member ended; that which follows STOPPED is a failure. */
#define COTREE_MEMBER_WAITS 0
#define COTREE_MEMBER_DONE 1
#define COTREE_MEMBER_STOPPED 2 /* by an event */
#define COTREE_MEMBER_FAILED 3  /* the job says why */
#define COTREE_MEMBER_REFUSED 4 /* its parameters or its start */
#define COTREE_MEMBER_UNSWEPT 5 /* its outputs have no values */
#define COTREE_MEMBER_STIFF 6   /* it waits for another method */
#define COTREE_MEMBER_STEPS 7   /* budgets that are spent */
#define COTREE_MEMBER_EVENTS 8
#define COTREE_MEMBER_TIME 9
#define COTREE_MEMBER_LEFT 10 /* lanes have left it: another worker has to run it */

#define COTREE_BATCH_EMPTY 0  /* no member is left */
#define COTREE_BATCH_GLANCE 1 /* call again */
#define COTREE_BATCH_ROOM 2   /* call again with more room for records, or for what happened */
#define COTREE_BATCH_ASK                                                                           \
    3 /* the member in work has not come to its end; call again with -1, or of                     \
       * one that waits with the same, to go on */
#define COTREE_BATCH_STOPPED 4 /* so is that in work, as the batch is stopped */
#define COTREE_BATCH_GIVE 5    /* call again with `asked` filled in, or with another member or -1 */

#ifdef __cplusplus
extern "C" {
#endif

/* Runs members until none is left, or something is to be done that C cannot. */
COTREE_EXPORT int cotree_batch_work(cotree_worker *worker);

/* Frees what the last job of a worker holds. */
COTREE_EXPORT void cotree_batch_close(cotree_worker *worker);

/* Begins a member that is not asked for: prepared values and the start. 0, or how it ended. */
COTREE_EXPORT int cotree_batch_prepare(const cotree_batch *batch, int member, double *k, double *z);

/* Evaluates the outputs of a member whose values up to n_kept are there; the rest are no numbers.
 */
COTREE_EXPORT int cotree_batch_finish(cotree_worker *worker, int member, const double *k);

/* Gives the time since some moment, [s]. */
COTREE_EXPORT double cotree_batch_now(void);

/* How many threads may share a batch. */
COTREE_EXPORT int cotree_batch_most_threads(void);

/* Steps between two looks at the clock and at the flag that stops a batch. */
#define COTREE_BATCH_STEPS 16

/* Tells whether whoever works is to come back. */
static inline int cotree_batch_is_stopped(const cotree_batch *batch)
{
#if defined(__GNUC__) || defined(__clang__)
    return __atomic_load_n(&batch->is_stopped, __ATOMIC_RELAXED);
#else
    return batch->is_stopped;
#endif
}

/* Takes the next member that is to be run; -1: none is left. */
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

#ifdef __cplusplus
}
#endif

#endif
