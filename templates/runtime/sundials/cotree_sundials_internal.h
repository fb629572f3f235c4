/* cotree_sundials_internal.h: declarations shared by the sources of cotree_sundials.h.
 * Part of the runtime of cotree, the same for every model.
 */
#ifndef COTREE_SUNDIALS_INTERNAL_H
#define COTREE_SUNDIALS_INTERNAL_H

#include "cotree_sundials.h"

#include "cotree_lu.h"
#include "cotree_stepper.h"

/* Nonlinear solvers as SUNDIALS has them. */
typedef int (*cotree_solve)(void *solver, void *start, void *correction, void *weights,
                            double tolerance, int is_matrix_old, void *integrator);
typedef struct cotree_solver_operations {
    int (*type)(void *solver);
    void (*unused[2])(void);
    cotree_solve solve;
    void (*unused_either)(void);
    int (*take_system)(void *solver, void *system);
    void (*unused_too[12])(void);
} cotree_solver_operations;

typedef struct cotree_solver {
    void *content;
    void *python;
    cotree_solver_operations *operations;
    void *context;
} cotree_solver;

#if !COTREE_IDA
#define BDF 2
#endif
#define ONE_STEP 2
#if COTREE_SIMULTANEOUS
#define SIMULTANEOUS 1
#endif

/* What SUNDIALS is told of an iteration: rates that cannot be had there, or nowhere, and no
 * convergence. The first has another number in each version of CVODE, which does not end after an
 * unknown one: it is told as no convergence. */
#if COTREE_IDA
#define RATES_AGAIN 1
#else
#define RATES_AGAIN 902
#endif
#define RATES_FAIL (-8)
#define NOT_CONVERGED 902
#if !COTREE_IDA

/* What CVODE gives after too many of these. */
#define NO_CONVERGENCE (-4)
#endif

/* A function of the integrator: names differ by how they begin. */
#if COTREE_IDA
#define OF(function) IDA##function
#else
#define OF(function) CVode##function
#endif

/* The length of a block of the vector that is integrated: states, with IDA algebraic unknowns, too.
 */
#if COTREE_IDA
#define BLOCK(model) ((model)->n_states)
#else
#define BLOCK(model) ((model)->n_states - (model)->n_algebraic)
#endif

/* What unknowns' own slopes and their rates are multiplied with in the equations of a step. */
typedef struct cotree_shares {
    double of_own, of_rates;
} cotree_shares;

/* SUNDIALS' own vectors: values, slopes, interpolated values, and whether they have slopes. Ours:
 * what the iteration works with; with COTREE_SENSITIVITIES also what the vectors of sensitivities
 * hold, behind that of the states. */
enum {
    Y,
    SLOPES,
    BETWEEN,
    KINDS,
    MOVED,
    RATES,
    STEP,
#if COTREE_SENSITIVITIES
    GIVEN,
    PAST,
    WEIGHTS,
    FOUND,
#endif
    N_VECTORS
};

#if COTREE_SENSITIVITIES
/* What SUNDIALS has of each sensitivity, those that vanish among them. */
enum {
    OWN_VALUES,
#if COTREE_IDA
    OWN_SLOPES,
#endif
    OWN_BETWEEN,
    OWN_TOLERANCES,
    N_KINDS
};

#endif
/* What a job that SUNDIALS runs has in its memory. */
typedef struct cotree_bdf {
    const cotree_sundials_aid *aid;
    const cotree_sundials *sundials;
    double *vectors[N_VECTORS];
    double *ordered, *jacobian, *trial, *entries;
    cotree_lu matrix;   /* of the entries */
    int *rows, *firsts; /* the state of each number in a vector, and where blocks begin */
    void *context;
    void *integrator;
    void *solver;
    void *y;
    void *slopes;
    void *between;
    void *atols;
    void *kinds;
#if COTREE_SENSITIVITIES
    double *apart;      /* the vectors of sensitivities */
    void **pointers;    /* to SUNDIALS' vectors of them */
    void *follower;     /* solves for the sensitivities, where they come after the states */
    int has_rates_next; /* the states' rates at this time have just been solved for */
    double time_of_rates;
#endif
    cotree_shares shares; /* of the matrix */
    double rates[2];      /* of convergence, of states and of sensitivities */
    double size_before;   /* of a correction */
    double bend;          /* of a correction's square, the error after it */
    double slowest;       /* rate of the last iteration, 0 where it had one correction */
    int is_fresh;         /* whether each step has matrices of its own */
    int has_jacobian, has_matrix;
    int has_failed; /* the last iteration */
    int is_turned;  /* the last correction, against what was left */
    long step_of_jacobian, step_of_matrix, step_of_solution;
    double passed, reached; /* its last step, in times that count from where it began last */
    int is_idle;            /* a segment of rounding goes by without it */
} cotree_bdf;

static inline cotree_bdf *bdf_of(const cotree_job *job)
{
    return (cotree_bdf *)cotree_engine_of(job)->own;
}

static inline size_t entries_of_jacobian(const cotree_model *model)
{
    const int n = BLOCK(model);
    const int is_dense_one = n < model->n_states; /* algebraic unknowns are eliminated */
    return is_dense_one ? (size_t)n * (size_t)n : (size_t)model->n_nonzeros;
}

/* Of states and sensitivities. */
static inline cotree_run *all_of(const cotree_job *job) { return cotree_engine_of(job)->run; }

/* Of the states alone. */
static inline cotree_run *states_of(const cotree_job *job)
{
    return cotree_engine_of(job)->of_states;
}

#if COTREE_SIMULTANEOUS
/* Whether one iteration has states and sensitivities in it. */
static inline int is_together(const cotree_job *job)
{
    return job->has_sensitivities && bdf_of(job)->aid->corrector == SIMULTANEOUS;
}

#endif
/* Of the vectors of SUNDIALS that the states are in. */
static inline cotree_run *own_run_of(const cotree_job *job)
{
#if COTREE_SENSITIVITIES
    return states_of(job);
#else
    return all_of(job);
#endif
}

/* Of what is solved for at once, before anything else. */
static inline cotree_run *solved_of(const cotree_job *job)
{
#if COTREE_SIMULTANEOUS
    return is_together(job) ? all_of(job) : states_of(job);
#else
    return own_run_of(job);
#endif
}

/* Of the vectors: states, and the sensitivities to each parameter. */
static inline int n_blocks_of(const cotree_job *job)
{
    return job->has_sensitivities ? 1 + job->model->n_sensitivities : 1;
}

/* How many numbers a run's vector has. */
static inline int length_of(const cotree_job *job, const cotree_run *run)
{
    return run->n_blocks > 1 ? job->n : BLOCK(job->model);
}

static inline int is_constrained(const cotree_job *job)
{
    return job->is_held && job->model->n_constraints > 0;
}

static inline double *vector_of(const cotree_job *job, int which)
{
    return bdf_of(job)->vectors[which];
}

/* How many numbers a vector of SUNDIALS has: sensitivities have vectors of their own, or follow the
 * states. */
#if COTREE_SENSITIVITIES
#define VECTOR(job) BLOCK((job)->model)
#else
#define VECTOR(job) ((job)->n)
#endif

/* SUNDIALS' times count from where it began last: late in a run, the rounding of t would add up
 * over its steps, and be longer than its first ones. Here is t at one of them. */
static inline double clock_at(const cotree_job *job, double since)
{
    return cotree_engine_of(job)->origin + since;
}

/* The equations of a step: M (factor * slopes + of_own e) = of_rates rates(t, start + e). */
typedef struct cotree_system {
    double t;
    const double *start;
    const double *slopes;
    double factor; /* of the slopes */
    cotree_shares shares;
} cotree_system;

/* cotree_sundials.c */
COTREE_PRIVATE int cotree_bdf_first_not_finite(const double *values, int n);
COTREE_PRIVATE int cotree_bdf_evaluate(cotree_job *job, cotree_run *run, double t, const double *z,
                                       double *dz);

/* cotree_sundials_newton.c */
COTREE_PRIVATE int cotree_bdf_evaluate_jacobian(cotree_job *job, double t, const double *z);
COTREE_PRIVATE int cotree_bdf_form_matrix(cotree_job *job, cotree_shares shares,
                                          int only_algebraic);
COTREE_PRIVATE void cotree_bdf_solve_block(const cotree_job *job, double share, int block,
                                           double *b);
COTREE_PRIVATE int cotree_bdf_prepare_matrix(cotree_job *job, const cotree_system *s, int is_again,
                                             int *is_fresh);
COTREE_PRIVATE int cotree_bdf_correct_sensitivities(cotree_job *job, const cotree_system *s,
                                                    const double *weights, double tolerance,
                                                    double *e);
COTREE_PRIVATE int cotree_bdf_hold(cotree_job *job, cotree_run *run, const cotree_system *s,
                                   const double *weights, double *e);
COTREE_PRIVATE void cotree_bdf_set_zero(double *e, int n);
COTREE_PRIVATE int cotree_bdf_solve_system(cotree_job *job, const cotree_system *s,
                                           const double *weights, double tolerance, double *e);
COTREE_PRIVATE void *cotree_bdf_make_solver(cotree_job *job, cotree_solve solve);
COTREE_PRIVATE int cotree_bdf_read_system(const cotree_job *job, void *integrator,
                                          cotree_system *system);

/* cotree_sundials_sensitivities.c */
#if COTREE_SENSITIVITIES
COTREE_PRIVATE int cotree_bdf_gather_system(const cotree_job *job, void *integrator);
COTREE_PRIVATE int cotree_bdf_solve_states(cotree_job *job, const cotree_system *s,
                                           const double *weights, double tolerance, double *e);
#if COTREE_SIMULTANEOUS
COTREE_PRIVATE int cotree_bdf_solve_together(cotree_job *job, cotree_system *s, void *weights,
                                             double tolerance, void *correction);
#endif
COTREE_PRIVATE int cotree_bdf_make_sensitivities(cotree_job *job);
COTREE_PRIVATE void cotree_bdf_free_sensitivities(cotree_job *job);
COTREE_PRIVATE int cotree_bdf_start_sensitivities(cotree_job *job);
COTREE_PRIVATE int cotree_bdf_restart_sensitivities(const cotree_job *job);
COTREE_PRIVATE int cotree_bdf_read_sensitivities(const cotree_job *job);
COTREE_PRIVATE int cotree_bdf_read_sensitivities_between(const cotree_job *job, double since);
#endif

/* cotree_sundials_start.c */
#if COTREE_IDA
COTREE_PRIVATE int cotree_bdf_find_slopes(cotree_job *job, double *step);
#endif

#endif
