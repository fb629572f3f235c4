/* cotree_sundials_start.c: initial slopes, and the size of the first step, for IDA. */
#include "cotree_sundials_internal.h"

#if COTREE_IDA

/* Estimated error of the first step, as a fraction of the tolerance. */
#define FIRST_ERROR 0.01

/* Return a time increment over which difference quotients approximate derivatives. */
static double small_time(const cotree_job *job)
{
    const double *const y = vector_of(job, Y), *const slopes = vector_of(job, SLOPES);
    const double end = job->breakpoints[job->segment + 1];
    const double least = 64.0 * DBL_EPSILON * fmax(fabs(job->t), fabs(end));
    double time = fabs(end - job->t);
    int i;
    for (i = 0; i < job->n; ++i) {
        /* Largest change: at most 1 for states, the tolerance for sensitivities. */
        const double size = fabs(y[i]) + job->atols[i] * fmin(1.0 / job->rtol, 1.0 / job->atol);
        if (fabs(slopes[i]) * time > size) time = size / fabs(slopes[i]);
    }
    return fmin(fmax(sqrt(DBL_EPSILON) * time, least), 0.5 * fabs(end - job->t));
}

/* Evaluate the rates a short time ahead, after an Euler step along the slopes. */
static int evaluate_ahead(cotree_job *job, double time)
{
    double *const moved = vector_of(job, MOVED);
    int i;
    for (i = 0; i < job->n; ++i) moved[i] = vector_of(job, Y)[i] + time * vector_of(job, SLOPES)[i];
    return cotree_bdf_evaluate(job, all_of(job), job->t + time, moved, vector_of(job, RATES));
}

/* Solve for the slopes of the algebraic unknowns in a range of blocks, such that the residuals stay
 * zero. */
static void solve_algebraic_slopes(cotree_job *job, double time, int first, int last)
{
    const double *const before = vector_of(job, BETWEEN), *const rates = vector_of(job, RATES);
    const double *const kinds = vector_of(job, KINDS);
    const int *const firsts = bdf_of(job)->firsts;
    double *const step = vector_of(job, STEP);
    int i, block;
    for (block = first; block < last; ++block) {
        for (i = firsts[block]; i < firsts[block + 1]; ++i) {
            step[i] = kinds[i] > 0.0 ? 0.0 : (rates[i] - before[i]) / time;
        }
        cotree_bdf_solve_block(job, 1.0, block, step);
        for (i = firsts[block]; i < firsts[block + 1]; ++i) {
            if (!(kinds[i] > 0.0) && fabs(step[i]) <= DBL_MAX) vector_of(job, SLOPES)[i] = step[i];
        }
    }
}

/* Return the size of the first step, estimated from the change of the rates. */
static double first_step(const cotree_job *job, double time)
{
    const double *const y = vector_of(job, Y), *const before = vector_of(job, BETWEEN),
                        *const after = vector_of(job, RATES);
    const double length = fabs(job->breakpoints[job->segment + 1] - job->t);
    double sum = 0.0, slope = 0.0, steepest;
    int i;
    for (i = 0; i < job->n; ++i) {
        const double weight = vector_of(job, KINDS)[i] / (job->rtol * fabs(y[i]) + job->atols[i]);
        const double bend = weight * (after[i] - before[i]) / time;
        sum += bend * bend;
        slope += weight * before[i] * weight * before[i];
    }
    steepest = fmax(sqrt(sum / job->n), sqrt(slope / job->n));
    if (!(steepest <= DBL_MAX)) steepest = sqrt(slope / job->n);
    return fmin(sqrt(FIRST_ERROR / fmax(steepest, DBL_MIN)), 1e-3 * length);
}

/* Compute the slopes at a start, including those of algebraic unknowns, and the size of the first
 * step. */
COTREE_PRIVATE int cotree_bdf_find_slopes(cotree_job *job, double *step)
{
    const int n_rates = job->model->n_states - job->model->n_algebraic,
              block = job->model->n_states;
    const int n_blocks = all_of(job)->n_blocks;
    const cotree_shares ones = {1.0, 1.0};
    double *const before = vector_of(job, BETWEEN);
    double time;
    int i, status = cotree_bdf_evaluate(job, all_of(job), job->t, vector_of(job, Y), before);
    if (status != 0) return COTREE_CANNOT_START;
    for (i = 0; i < job->n; ++i) {
        const int has_rate = bdf_of(job)->rows[i] < n_rates;
        vector_of(job, KINDS)[i] = has_rate;
        vector_of(job, SLOPES)[i] = has_rate ? before[i] : 0.0;
    }
    time = cotree_job_ahead(job) * small_time(job);
    if (n_rates < block && cotree_bdf_evaluate_jacobian(job, job->t, vector_of(job, Y)) == 0 &&
        cotree_bdf_form_matrix(job, ones, 1) == 0) {
        if (evaluate_ahead(job, time) == 0) solve_algebraic_slopes(job, time, 0, 1);
        time = cotree_job_ahead(job) * small_time(job);
        if (n_blocks > 1 && evaluate_ahead(job, time) == 0)
            solve_algebraic_slopes(job, time, 1, n_blocks);
    }
    bdf_of(job)->has_matrix = 0;
    time = cotree_job_ahead(job) * small_time(job);
    *step = 0.0;
    if (evaluate_ahead(job, time) == 0)
        *step = cotree_job_ahead(job) * fmax(first_step(job, time), fabs(time));
    job->entry = -1;
    return 0;
}

#endif
