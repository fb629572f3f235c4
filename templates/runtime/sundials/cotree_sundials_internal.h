/* cotree_sundials_internal.h: declarations shared by the sources of cotree_sundials.h. */
#ifndef COTREE_SUNDIALS_INTERNAL_H
#define COTREE_SUNDIALS_INTERNAL_H

#include "cotree_sundials.h"

#include "cotree_lu.h"
#include "cotree_stepper.h"

/* Interface of a nonlinear solver, as SUNDIALS calls it. */
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

#define ONE_STEP 2
#if COTREE_SIMULTANEOUS
#define SIMULTANEOUS 1
#endif

/* Return values of an iteration: RATES_FAIL if the rates cannot be evaluated with any step size,
 * RATES_AGAIN if a smaller step may succeed, NOT_CONVERGED. CVODE's value for a smaller step
 * differs between versions; as CVODE treats unknown values as failures to converge, NOT_CONVERGED
 * replaces it. OF(name): function of CVODE or IDA without its prefix. BLOCK: number of entries of a
 * block, the states and, with IDA, the algebraic unknowns. */
#define RATES_FAIL (-8)
#define NOT_CONVERGED 902
#if COTREE_IDA
#define RATES_AGAIN 1
#define OF(function) IDA##function
#define BLOCK(model) ((model)->n_states)
#else
#define RATES_AGAIN NOT_CONVERGED
#define OF(function) CVode##function
#define BLOCK(model) ((model)->n_states - (model)->n_algebraic)
#define BDF 2
#define NO_CONVERGENCE (-4) /* return value of CVODE after repeated convergence failures */
#endif

/* Coefficients of the corrections and of the rates in the equations of a step, see
 * cotree_system. */
typedef struct cotree_shares {
    double of_own, of_rates;
} cotree_shares;

/* Vectors of SUNDIALS: values, their derivatives, interpolated values, 1 for entries with a
 * derivative (else 0), absolute tolerances. Then work space of the iteration and, with
 * COTREE_SENSITIVITIES, copies of the sensitivity vectors behind those of the states. */
enum {
    Y,
    SLOPES,
    BETWEEN,
    KINDS,
    ATOLS,
    MOVED,
    RATES,
    STEP,
#if COTREE_SENSITIVITIES
    GIVEN,
    PAST,
    WEIGHTS,
    FOUND,
#endif
    N_VECTORS,
    N_HANDLES = MOVED
};

#if COTREE_SENSITIVITIES
/* Vectors of SUNDIALS for each sensitivity, including the entries that are identically zero. */
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
/* Data of the stepper. */
typedef struct cotree_bdf {
    const cotree_sundials_aid *aid;
    const cotree_sundials *sundials;
    double *vectors[N_VECTORS];
    double *ordered, *jacobian, *trial, *entries;
    cotree_lu matrix;   /* stored in entries */
    int *rows, *firsts; /* state index of each vector entry; first entry of each block */
    void *context;
    void *integrator;
    void *solver;
    void *handles[N_HANDLES]; /* SUNDIALS objects of the first vectors */
    double rtol;              /* relative tolerance set in the integrator */
#if COTREE_SENSITIVITIES
    double *apart;      /* storage of the sensitivity vectors */
    void **pointers;    /* SUNDIALS objects of the sensitivity vectors */
    void *follower;     /* nonlinear solver of staggered sensitivities */
    int has_rates_next; /* 1: the next rates required are the rates at the solution just found */
    double time_of_rates;
#endif
    cotree_shares shares; /* coefficients with which the matrix was formed */
    double rates[2];      /* convergence rates of states and of sensitivities */
    double size_before;   /* norm of the previous correction */
    double bend;          /* error after a correction, divided by the square of its norm */
    double slowest;       /* convergence rate of the last iteration; 0 after a single correction */
    int is_fresh;         /* 1: the matrix is renewed at each step */
    int has_jacobian, has_matrix;
    int has_failed; /* 1: the last iteration failed */
    int is_opposed; /* 1: the last correction opposed the residual */
    long step_of_jacobian, step_of_matrix, step_of_solution;
    double passed, reached; /* start and end of the last step, relative to the origin */
    int is_idle;            /* 1: the segment is as short as rounding and is skipped */
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

/* Return the run with states and sensitivities. */
static inline cotree_run *all_of(const cotree_job *job) { return cotree_engine_of(job)->run; }

/* Return the run with states only. */
static inline cotree_run *states_of(const cotree_job *job)
{
    return cotree_engine_of(job)->of_states;
}

#if COTREE_SIMULTANEOUS
/* Return whether one iteration solves for states and sensitivities. */
static inline int is_simultaneous(const cotree_job *job)
{
    return job->has_sensitivities && bdf_of(job)->aid->corrector == SIMULTANEOUS;
}

#endif
/* Return the run with the entries of SUNDIALS's state vector. */
static inline cotree_run *own_run_of(const cotree_job *job)
{
#if COTREE_SENSITIVITIES
    return states_of(job);
#else
    return all_of(job);
#endif
}

/* Return the run with the entries that the first nonlinear solver computes. */
static inline cotree_run *solved_of(const cotree_job *job)
{
#if COTREE_SIMULTANEOUS
    return is_simultaneous(job) ? all_of(job) : states_of(job);
#else
    return own_run_of(job);
#endif
}

/* Return the number of blocks: states, and sensitivities to each parameter. */
static inline int n_blocks_of(const cotree_job *job)
{
    return job->has_sensitivities ? 1 + job->model->n_sensitivities : 1;
}

/* Return the number of entries of a run's solution vector. */
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

/* Number of entries of the state vector of SUNDIALS. Sensitivities that have separate vectors are
 * not counted. */
#if COTREE_SENSITIVITIES
#define VECTOR(job) BLOCK((job)->model)
#else
#define VECTOR(job) ((job)->n)
#endif

/* Return t for a time of SUNDIALS, which starts at zero after each restart: late in a run the
 * rounding of t would exceed the first steps. */
static inline double clock_at(const cotree_job *job, double since)
{
    return cotree_engine_of(job)->origin + since;
}

/* Equations of a step for the correction e: M (factor slopes + of_own e) = of_rates rates(t, start
 * + e). */
typedef struct cotree_system {
    double t;
    const double *start;
    const double *slopes;
    double factor; /* coefficient of slopes in the equations above */
    cotree_shares shares;
} cotree_system;

/* Defined in cotree_sundials.c: */
COTREE_PRIVATE int cotree_bdf_first_not_finite(const double *values, int n);
COTREE_PRIVATE int cotree_bdf_evaluate(cotree_job *job, cotree_run *run, double t, const double *z,
                                       double *dz);

/* Defined in cotree_sundials_newton.c: */
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
COTREE_PRIVATE int cotree_bdf_project(cotree_job *job, cotree_run *run, const cotree_system *s,
                                      const double *weights, double *e);
COTREE_PRIVATE void cotree_bdf_set_zero(double *e, int n);
COTREE_PRIVATE int cotree_bdf_solve_system(cotree_job *job, const cotree_system *s,
                                           const double *weights, double tolerance, double *e);
COTREE_PRIVATE void *cotree_bdf_make_solver(cotree_job *job, cotree_solve solve);
COTREE_PRIVATE int cotree_bdf_read_system(const cotree_job *job, void *integrator,
                                          cotree_system *system);

/* Defined in cotree_sundials_sensitivities.c: */
#if COTREE_SENSITIVITIES
COTREE_PRIVATE int cotree_bdf_gather_system(const cotree_job *job, void *integrator);
COTREE_PRIVATE int cotree_bdf_solve_states(cotree_job *job, const cotree_system *s,
                                           const double *weights, double tolerance, double *e);
#if COTREE_SIMULTANEOUS
COTREE_PRIVATE int cotree_bdf_solve_simultaneous(cotree_job *job, cotree_system *s, void *weights,
                                                 double tolerance, void *correction);
#endif
COTREE_PRIVATE int cotree_bdf_make_sensitivities(cotree_job *job);
COTREE_PRIVATE void cotree_bdf_free_sensitivities(cotree_job *job);
COTREE_PRIVATE int cotree_bdf_start_sensitivities(cotree_job *job);
COTREE_PRIVATE int cotree_bdf_restart_sensitivities(const cotree_job *job);
COTREE_PRIVATE int cotree_bdf_read_sensitivities(const cotree_job *job);
COTREE_PRIVATE int cotree_bdf_read_sensitivities_between(const cotree_job *job, double since);
#endif

/* Defined in cotree_sundials_start.c: */
#if COTREE_IDA
COTREE_PRIVATE int cotree_bdf_find_slopes(cotree_job *job, double *step);
#endif

#endif
