/* cotree_sundials_sensitivities.c: sensitivities in separate vectors, for CVODES and IDAS.
 *
 * Staggered: one solver solves for the states and, after their error test, another one for the
 * sensitivities. Simultaneous, in CVODES only: the first solver solves for both. IDAS has no error
 * test for simultaneous sensitivities. */
#include "cotree_sundials_internal.h"

#if COTREE_SENSITIVITIES

/* Layout of a SUNDIALS vector, and of an array of vectors. */
typedef struct cotree_vector {
    void *content;
    void *operations;
    void *context;
} cotree_vector;

typedef struct cotree_vectors {
    void **vectors;
    int n;
    int are_own;
} cotree_vectors;

static void **sensitivities_of(const cotree_job *job, int kind)
{
    return bdf_of(job)->pointers + kind * job->model->n_sensitivities;
}

static void **vectors_of(void *several)
{
    const cotree_vectors *const content =
        (const cotree_vectors *)((const cotree_vector *)several)->content;
    return content->vectors;
}

/* Copy vectors to adjacent blocks of an array, starting at block first, without the sensitivities
 * that are identically zero. */
static void gather(const cotree_job *job, void *const *vectors, int first, double *to)
{
    const cotree_bdf *const c = bdf_of(job);
    int i, block;
    for (block = first; block < n_blocks_of(job); ++block) {
        const double *const from = c->sundials->N_VGetArrayPointer(*vectors++);
        for (i = c->firsts[block]; i < c->firsts[block + 1]; ++i) to[i] = from[c->rows[i]];
    }
}

/* Copy blocks back to vectors. Sensitivities that are identically zero get the value `others`. */
static void scatter_among(const cotree_job *job, const double *from, int first, double others,
                          void *const *vectors)
{
    const cotree_bdf *const c = bdf_of(job);
    int i, block;
    for (block = first; block < n_blocks_of(job); ++block) {
        double *const to = c->sundials->N_VGetArrayPointer(*vectors++);
        for (i = 0; i < BLOCK(job->model); ++i) to[i] = others;
        for (i = c->firsts[block]; i < c->firsts[block + 1]; ++i) to[c->rows[i]] = from[i];
    }
}

static void scatter(const cotree_job *job, const double *from, int first, void *const *vectors)
{
    scatter_among(job, from, first, 0.0, vectors);
}

static void copy_block(const cotree_job *job, const double *from, double *to)
{
    int i;
    for (i = 0; i < BLOCK(job->model); ++i) to[i] = from[i];
}

/* Read the equations of the current step for the sensitivities. */
COTREE_PRIVATE int cotree_bdf_gather_system(const cotree_job *job, void *integrator)
{
    const cotree_sundials *const s = bdf_of(job)->sundials;
    void **predicted, **now, **slopes, *data;
    double t, coefficient;
#if !COTREE_IDA
    double gamma;
    const int flag = s->CVodeGetNonlinearSystemDataSens(integrator, &t, &predicted, &now, &gamma,
                                                        &coefficient, &slopes, &data);
#else
    void **slopes_now;
    const int flag = s->IDAGetNonlinearSystemDataSens(integrator, &t, &predicted, &slopes, &now,
                                                      &slopes_now, &coefficient, &data);
#endif
    if (flag != 0) return flag;
    gather(job, predicted, 1, vector_of(job, GIVEN));
    gather(job, slopes, 1, vector_of(job, PAST));
    return 0;
}

/* Solve for the states, and store the data of the sensitivity equations. */
COTREE_PRIVATE int cotree_bdf_solve_states(cotree_job *job, const cotree_system *s,
                                           const double *weights, double tolerance, double *e)
{
    const int status = cotree_bdf_solve_system(job, s, weights, tolerance, e);
    if (status != 0 || !job->has_sensitivities) return status;
    copy_block(job, s->start, vector_of(job, GIVEN));
    copy_block(job, s->slopes, vector_of(job, PAST));
    copy_block(job, e, vector_of(job, FOUND));
    bdf_of(job)->has_rates_next = 1;
    bdf_of(job)->time_of_rates = s->t;
    return 0;
}

#if COTREE_SIMULTANEOUS
/* Solve for states and sensitivities in one iteration. */
COTREE_PRIVATE int cotree_bdf_solve_simultaneous(cotree_job *job, cotree_system *s, void *weights,
                                                 double tolerance, void *correction)
{
    double *const e = vector_of(job, FOUND);
    int status;
    copy_block(job, s->start, vector_of(job, GIVEN));
    copy_block(job, s->slopes, vector_of(job, PAST));
    s->start = vector_of(job, GIVEN);
    s->slopes = vector_of(job, PAST);
    gather(job, vectors_of(weights), 0, vector_of(job, WEIGHTS));
    cotree_bdf_set_zero(e, job->n);
    status = cotree_bdf_solve_system(job, s, vector_of(job, WEIGHTS), tolerance, e);
    if (status == 0) scatter(job, e, 0, vectors_of(correction));
    return status;
}

#endif
/* Solve for the sensitivities at the solution of the states. */
static int follower_solve(void *solver, void *start, void *correction, void *weights,
                          double tolerance, int is_matrix_old, void *integrator)
{
    cotree_job *const job = (cotree_job *)((cotree_solver *)solver)->content;
    const int n = BLOCK(job->model);
    double *const e = vector_of(job, FOUND);
    cotree_system system;
    int status, is_fresh = 0;
    (void)is_matrix_old, (void)start;
    if (cotree_bdf_read_system(job, integrator, &system) != 0) return RATES_FAIL;
    if (cotree_bdf_gather_system(job, integrator) != 0) return RATES_FAIL;
    system.start = vector_of(job, GIVEN);
    system.slopes = vector_of(job, PAST);
    gather(job, vectors_of(weights), 1, vector_of(job, WEIGHTS));
    cotree_bdf_set_zero(e + n, job->n - n);
    status = cotree_bdf_correct_sensitivities(job, &system, vector_of(job, WEIGHTS), tolerance, e);
    if (status > 0 && !bdf_of(job)->is_fresh) {
        bdf_of(job)->has_failed = 1;
        cotree_bdf_set_zero(e + n, job->n - n);
        status = cotree_bdf_prepare_matrix(job, &system, 1, &is_fresh);
        if (status == 0) {
            status = cotree_bdf_correct_sensitivities(job, &system, vector_of(job, WEIGHTS),
                                                      tolerance, e);
        }
        bdf_of(job)->has_failed = status != 0;
    }
    if (status == 0) status = cotree_bdf_project(job, all_of(job), &system, NULL, e);
    if (status == 0) scatter(job, e, 1, vectors_of(correction));
    return status;
}

#if !COTREE_IDA
/* Compute the rates of all sensitivities, together with those of the states. */
static int sensitivity_rate(int n, double since, void *y, void *dy, void **s, void **ds, void *data,
                            void *work, void *more)
{
    cotree_job *const job = (cotree_job *)data;
    double *const z = vector_of(job, MOVED);
    int status;
    (void)n, (void)dy, (void)work, (void)more;
    copy_block(job, bdf_of(job)->sundials->N_VGetArrayPointer(y), z);
    gather(job, s, 1, z);
    status = cotree_bdf_evaluate(job, all_of(job), clock_at(job, since), z, vector_of(job, RATES));
    if (status == 0) scatter(job, vector_of(job, RATES), 1, ds);
    return status;
}
#else
/* Never called: the nonlinear solver evaluates the residuals. */
static int sensitivity_residual(int n, double t, void *y, void *dy, void *left, void **s, void **ds,
                                void **lefts, void *data, void *work, void *more, void *most)
{
    (void)n, (void)t, (void)y, (void)dy, (void)left, (void)s, (void)ds, (void)lefts, (void)data;
    (void)work, (void)more, (void)most;
    return RATES_FAIL;
}
#endif

/* Create the sensitivity vectors and their solver. */
COTREE_PRIVATE int cotree_bdf_make_sensitivities(cotree_job *job)
{
    cotree_bdf *const c = bdf_of(job);
    const cotree_sundials *const s = c->sundials;
    const int n = BLOCK(job->model);
    int i, kind;
    /* Vectors cloned from this one have fused operations, which reduces the number of calls. */
    if (s->N_VEnableFusedOps_Serial(c->handles[Y], 1) != 0) return COTREE_NO_MEMORY;
    for (kind = 0; kind < N_KINDS; ++kind) {
        void **const vectors = sensitivities_of(job, kind);
        for (i = 0; i < job->model->n_sensitivities; ++i) {
            double *const own = c->apart + (kind * job->model->n_sensitivities + i) * n;
            vectors[i] = s->N_VMake_Serial(n, own, c->context);
            if (vectors[i] == NULL) return COTREE_NO_MEMORY;
            if (s->N_VEnableFusedOps_Serial(vectors[i], 1) != 0) return COTREE_NO_MEMORY;
        }
    }
#if COTREE_SIMULTANEOUS
    if (is_simultaneous(job)) return 0;
#endif
    c->follower = cotree_bdf_make_solver(job, follower_solve);
    return c->follower == NULL ? COTREE_NO_MEMORY : 0;
}

/* Free the sensitivity vectors and their solver; may be called at any time. */
COTREE_PRIVATE void cotree_bdf_free_sensitivities(cotree_job *job)
{
    cotree_bdf *const c = bdf_of(job);
    const cotree_sundials *const s = c->sundials;
    const int n = job->has_sensitivities ? N_KINDS * job->model->n_sensitivities : 0;
    int i;
    if (c->follower != NULL) s->SUNNonlinSolFreeEmpty(c->follower);
    c->follower = NULL;
    for (i = 0; i < n; ++i) {
        if (c->pointers[i] != NULL) s->N_VDestroy(c->pointers[i]);
        c->pointers[i] = NULL;
    }
}

/* Copy the initial sensitivities to the vectors. */
static void scatter_start(const cotree_job *job)
{
    scatter(job, vector_of(job, Y), 1, sensitivities_of(job, OWN_VALUES));
#if COTREE_IDA
    scatter(job, vector_of(job, SLOPES), 1, sensitivities_of(job, OWN_SLOPES));
#endif
}

COTREE_PRIVATE int cotree_bdf_start_sensitivities(cotree_job *job)
{
    cotree_bdf *const c = bdf_of(job);
    const cotree_sundials *const s = c->sundials;
    void **const values = sensitivities_of(job, OWN_VALUES);
    const int n = job->model->n_sensitivities;
    int flag;
    if (!job->has_sensitivities) return s->OF(SetNonlinearSolver)(c->integrator, c->solver);
    scatter_start(job);
    scatter_among(job, job->atols, 1, 1.0, sensitivities_of(job, OWN_TOLERANCES));
#if !COTREE_IDA
    flag = s->CVodeSensInit(c->integrator, n, c->aid->corrector, sensitivity_rate, values);
#else
    flag = s->IDASensInit(c->integrator, n, c->aid->corrector, sensitivity_residual, values,
                          sensitivities_of(job, OWN_SLOPES));
#endif
    if (flag == 0) {
        flag = s->OF(SensSVtolerances)(c->integrator, job->rtol,
                                       sensitivities_of(job, OWN_TOLERANCES));
    }
    if (flag == 0) flag = s->OF(SetSensErrCon)(c->integrator, !c->aid->are_followed);
    if (flag != 0) return flag;
#if COTREE_SIMULTANEOUS
    if (is_simultaneous(job)) return s->CVodeSetNonlinearSolverSensSim(c->integrator, c->solver);
#endif
    flag = s->OF(SetNonlinearSolver)(c->integrator, c->solver);
    if (flag == 0) flag = s->OF(SetNonlinearSolverSensStg)(c->integrator, c->follower);
    return flag;
}

COTREE_PRIVATE int cotree_bdf_restart_sensitivities(const cotree_job *job)
{
    const cotree_bdf *const c = bdf_of(job);
    void **const values = sensitivities_of(job, OWN_VALUES);
    if (!job->has_sensitivities) return 0;
    scatter_start(job);
#if COTREE_IDA
    return c->sundials->IDASensReInit(c->integrator, c->aid->corrector, values,
                                      sensitivities_of(job, OWN_SLOPES));
#else
    return c->sundials->CVodeSensReInit(c->integrator, c->aid->corrector, values);
#endif
}

/* Read the sensitivities at the end of the last step. */
COTREE_PRIVATE int cotree_bdf_read_sensitivities(const cotree_job *job)
{
    const cotree_bdf *const c = bdf_of(job);
    void **const values = sensitivities_of(job, OWN_VALUES);
    double t;
    int flag;
    if (!job->has_sensitivities) return 0;
    flag = c->sundials->OF(GetSens)(c->integrator, &t, values);
    gather(job, values, 1, vector_of(job, Y));
    return flag;
}

/* Read the sensitivities at a time within the last step. */
COTREE_PRIVATE int cotree_bdf_read_sensitivities_between(const cotree_job *job, double since)
{
    const cotree_bdf *const c = bdf_of(job);
    void **const values = sensitivities_of(job, OWN_BETWEEN);
    int flag;
    if (!job->has_sensitivities) return 0;
    flag = c->sundials->OF(GetSensDky)(c->integrator, since, 0, values);
    gather(job, values, 1, vector_of(job, BETWEEN));
    return flag;
}

#endif
