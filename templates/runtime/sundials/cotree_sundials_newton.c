/* cotree_sundials_newton.c: nonlinear solver of the BDF methods.
 *
 * Newton's method for M (factor slopes + of_own e) = of_rates rates(t, start + e), with M zero for
 * algebraic unknowns. The states are solved for first. The sensitivities then follow from linear
 * equations at the solution, with the same factorised matrix of_own M - of_rates J. The blocks
 * below the diagonal, which contain second derivatives, are not needed.
 *
 * Matrices are kept over several steps, as CVODE does, or renewed at each step: one matrix for the
 * states and, if the solution is far from the prediction, a second one for the sensitivities, which
 * then need a single correction. */
#include "cotree_sundials_internal.h"

#include "cotree_limits.h"

/* An iteration with new matrices fails if a correction exceeds this fraction of the previous
 * one. */
#define MAX_RATE 0.9

/* At convergence rates up to this, the matrix at the predicted point is also used for the
 * sensitivities. The error after their single correction is this fraction of the correction. */
#define FAST_RATE 0.01

/* Lower bound of the error after a correction, divided by the square of its size in tolerances. */
#define MIN_BEND 0.1

/* Loosest relative tolerance at which iterations with new matrices end. */
#define MAX_RTOL 1e-6

/* Iterations with older matrices end at this fraction of the tolerance of SUNDIALS; with CVODE only
 * if there are sensitivities, whose equations contain the errors of the states. */
#define TIGHTENING 0.1

#if COTREE_IDA
#define MAX_CORRECTIONS 4
#else
#define MAX_CORRECTIONS 3
#endif

/* Number of corrections of sensitivities outside the error test: after a single one, the errors of
 * outdated Jacobians would be visible. */
#define CORRECTIONS 2

/* Maximum age of a Jacobian and of a matrix in steps, unless both are renewed at each step. */
#define OLD_JACOBIAN 50
#define OLD_MATRIX 20

/* A matrix is replaced if its coefficients differ from the current ones by more than FAR_SHARES. If
 * they differ by less than NEAR_SHARES, a failure has another cause. */
#define FAR_SHARES 0.3
#define NEAR_SHARES 0.2

/* Evaluate the Jacobian. If it is not finite at a trial point, keep the previous one, which slows
 * convergence. */
COTREE_PRIVATE int cotree_bdf_evaluate_jacobian(cotree_job *job, double t, const double *z)
{
    cotree_bdf *const c = bdf_of(job);
    const cotree_model *const model = job->model;
    cotree_run *const run = states_of(job);
    const double at = cotree_run_inside(run, t);
    double *const trial = c->trial, *const jacobian = c->jacobian;
    const int size = (int)entries_of_jacobian(model), n = BLOCK(model);
    int i, place, status;
    if (n < model->n_states) {
        status = cotree_run_jacobian(t, z, trial, run);
    } else {
        status = cotree_run_inputs(run, at);
        z = cotree_run_held(run, at, z);
        if (status == 0)
            status = model->jacobian(at, z, job->u, job->p, cotree_job_prepared(job), trial);
    }
    ++job->n_jacobians;
    job->kernel_status = status;
    if (status != 0) return status > 0 ? RATES_AGAIN : RATES_FAIL;
    place = cotree_bdf_first_not_finite(trial, size);
    if (place >= 0) {
        if (n < model->n_states) {
            job->row = place / n;
            job->column = place % n;
        } else {
            job->row = model->row_indices[place];
            for (i = 0; model->column_starts[i + 1] <= place;) ++i;
            job->column = i;
        }
        return c->has_jacobian ? 0 : RATES_AGAIN;
    }
    for (i = 0; i < size; ++i) jacobian[i] = trial[i];
    c->has_jacobian = 1;
    c->step_of_jacobian = job->n_steps;
    return 0;
}

/* Write -share J to the matrix; if only_algebraic is set, without the rows of rates. */
static void write_jacobian(cotree_job *job, const cotree_lu *m, double share, int only_algebraic)
{
    const cotree_model *const model = job->model;
    const int *const places = bdf_of(job)->aid->places;
    const double *const jacobian = bdf_of(job)->jacobian;
    const int n = m->n, n_rates = model->n_states - model->n_algebraic;
    int i, j, e;
    if (n < model->n_states) {
        for (i = 0; i < n; ++i) {
            for (j = 0; j < n; ++j) m->first[i + j * m->stride] = -share * jacobian[i * n + j];
        }
        return;
    }
    for (j = 0; j < n; ++j) {
        double *const entries = m->first + (places != NULL ? places[j] : j) * m->stride;
        for (e = model->column_starts[j]; e < model->column_starts[j + 1]; ++e) {
            i = model->row_indices[e];
            if (only_algebraic && i < n_rates) continue;
            entries[places != NULL ? places[i] : i] = -share * jacobian[e];
        }
    }
}

COTREE_PRIVATE int cotree_bdf_form_matrix(cotree_job *job, cotree_shares shares, int only_algebraic)
{
    cotree_bdf *const c = bdf_of(job);
    const cotree_model *const model = job->model;
    const cotree_lu *const m = &c->matrix;
    const size_t size = cotree_lu_doubles(m->n, m->lower, m->upper);
    size_t k;
    int j;
    for (k = 0; k < size; ++k) c->entries[k] = 0.0;
    write_jacobian(job, m, shares.of_rates, only_algebraic);
    for (j = 0; j < model->n_states - model->n_algebraic; ++j) {
        const int place = c->aid->places != NULL ? c->aid->places[j] : j;
        m->first[place + place * m->stride] += shares.of_own;
    }
    ++job->n_factorisations;
    c->shares = shares;
    c->has_matrix = 1;
    c->step_of_matrix = job->n_steps;
    return cotree_lu_factorise(m) != 0 ? NOT_CONVERGED : 0;
}

/* Solve for one block of b, and multiply by a factor that corrects for outdated coefficients of the
 * matrix. Sensitivities that are identically zero remain zero. */
COTREE_PRIVATE void cotree_bdf_solve_block(const cotree_job *job, double share, int block,
                                           double *b)
{
    const cotree_bdf *const c = bdf_of(job);
    const cotree_lu *const m = &c->matrix;
    const int *const places = c->aid->places, *const rows = c->rows;
    const int first = c->firsts[block], end = c->firsts[block + 1];
    double *const whole = c->ordered;
    int i;
    if (places == NULL && end - first == m->n) {
        cotree_lu_solve(m, b + first);
        for (i = first; i < end; ++i) b[i] *= share;
        return;
    }
    for (i = 0; i < m->n && end - first < m->n; ++i) whole[i] = 0.0;
    for (i = first; i < end; ++i) whole[places != NULL ? places[rows[i]] : rows[i]] = b[i];
    if (end > first) cotree_lu_solve(m, whole);
    for (i = first; i < end; ++i) b[i] = share * whole[places != NULL ? places[rows[i]] : rows[i]];
}

/* Return the ratio of the coefficients with which the matrix was formed to the current ones. */
static double share_ratio(const cotree_job *job, const cotree_system *s)
{
    const cotree_shares *const old = &bdf_of(job)->shares;
    return old->of_own / s->shares.of_own * (old->of_rates / s->shares.of_rates);
}

/* Return the minimum weight of a correction with a new matrix, so that loose tolerances do not end
 * an iteration early: above the forward voltage of a junction, each correction is only about one
 * thermal voltage. */
static double least_weight(const cotree_job *job, int i, double value)
{
    return 1.0 / (MAX_RTOL * fabs(value) + job->atols[i]);
}

/* Return the residual of an equation, given the rates. */
static double residual_of(const cotree_system *s, int i, int has_rate, const double *rates,
                          const double *e)
{
    const double own = s->factor * s->slopes[i] + s->shares.of_own * e[i];
    return s->shares.of_rates * rates[i] - (has_rate ? own : 0.0);
}

/* Return whether the corrections of the states oppose their residuals, which exceed the tolerance.
 * According to the matrix, a mode then grows fast, and small corrections do not indicate
 * convergence. e is not corrected yet. */
static int opposes_residual(const cotree_job *job, const cotree_system *s, const double *rates,
                            const double *weights, const double *e)
{
    const int n = job->model->n_states - job->model->n_algebraic;
    const double *const step = vector_of(job, STEP);
    double product = 0.0, squares = 0.0, sum = 0.0;
    int i;
    for (i = 0; i < n; ++i) {
        const double left = residual_of(s, i, 1, rates, e) / s->shares.of_own * weights[i];
        const double share = step[i] * weights[i];
        if (fabs(left) <= 1.0) continue;
        product += left * share;
        squares += share * share;
        sum += left * left;
    }
    return product < -COTREE_OPPOSED_COSINE * sqrt(squares * sum);
}

/* Correct the blocks from first to last - 1 by their residuals, given the rates. Return the sum of
 * squares of the weighted corrections. */
static double correct(cotree_job *job, const cotree_system *s, int first, int last,
                      const double *rates, const double *weights, double *e)
{
    const int n_rates = job->model->n_states - job->model->n_algebraic;
    const double share = 2.0 / (1.0 + 1.0 / share_ratio(job, s));
    const int *const firsts = bdf_of(job)->firsts, *const rows = bdf_of(job)->rows;
    const int is_fresh = bdf_of(job)->is_fresh;
    double *const step = vector_of(job, STEP);
    double sum = 0.0;
    int i, block;
    for (block = first; block < last; ++block) {
        for (i = firsts[block]; i < firsts[block + 1]; ++i) {
            step[i] = residual_of(s, i, rows[i] < n_rates, rates, e);
        }
        cotree_bdf_solve_block(job, share, block, step);
        if (block == 0) bdf_of(job)->is_opposed = opposes_residual(job, s, rates, weights, e);
        for (i = firsts[block]; i < firsts[block + 1]; ++i) {
            const double least = is_fresh ? least_weight(job, i, s->start[i]) : weights[i];
            const double size = step[i] * fmax(weights[i], least);
            e[i] += step[i];
            sum += size * size;
        }
    }
    return sum;
}

/* Return 1 if the n-th correction ends the iteration, or -1 if the iteration diverges. */
static int has_converged(cotree_bdf *c, int which, int n, double size, double tolerance)
{
    double *const rate = c->rates + which;
    if (n > 0) *rate = fmax(0.3 * *rate, size / c->size_before);
    if (size * fmin(1.0, *rate) <= tolerance) return 1;
    if (n > 0 && size > 2.0 * c->size_before) return -1;
    c->size_before = size;
    return 0;
}

/* As has_converged, but with a new matrix, for which convergence is quadratic. */
static int has_converged_quadratically(cotree_bdf *c, int n, double size, double tolerance)
{
    if (n > 0) {
        const double rate = size / c->size_before;
        if (!(rate <= MAX_RATE)) return -1;
        c->bend = fmax(rate / c->size_before, MIN_BEND);
        c->slowest = fmax(c->slowest, rate);
    }
    c->size_before = size;
    return c->bend * size * size <= tolerance;
}

/* Update the matrix if it is outdated. is_again: an attempt with it has failed in this step. */
COTREE_PRIVATE int cotree_bdf_prepare_matrix(cotree_job *job, const cotree_system *s, int is_again,
                                             int *is_fresh)
{
    cotree_bdf *const c = bdf_of(job);
    const double moved = c->has_matrix ? fabs(1.0 / share_ratio(job, s) - 1.0) : 0.0;
    const int is_old = c->is_fresh || job->n_steps >= c->step_of_matrix + OLD_MATRIX;
    if (c->has_matrix && !is_again && !c->has_failed && moved <= FAR_SHARES && !is_old) {
        return 0;
    }
    if (c->has_failed || !c->has_jacobian || c->is_fresh ||
        job->n_steps > c->step_of_jacobian + OLD_JACOBIAN) {
        const int status = cotree_bdf_evaluate_jacobian(job, s->t, s->start);
        if (status != 0) return status;
        *is_fresh = 1;
    }
    c->rates[0] = c->rates[1] = 1.0;
    return cotree_bdf_form_matrix(job, s->shares, 0);
}

/* Apply corrections to blocks, and return their size in the norm of the error test. */
static double size_of_corrections(cotree_job *job, const cotree_system *s, int first, int last,
                                  const double *rates, const double *weights, double *e)
{
#if COTREE_SENSITIVITIES
    /* For blocks in separate vectors, the norm is the largest of their norms. */
    double largest = 0.0;
    int block;
    for (block = first; block < last; ++block) {
        const double sum = correct(job, s, block, block + 1, rates, weights, e);
        if (!(sum <= DBL_MAX)) return sum;
        largest = fmax(largest, sum);
    }
    return sqrt(largest / BLOCK(job->model));
#else
    /* The norm over all entries, even if sensitivities are outside the test. */
    const int are_all = first > 0 || bdf_of(job)->aid->are_followed;
    const int count = are_all ? job->n : BLOCK(job->model);
    return sqrt(correct(job, s, first, last, rates, weights, e) / count);
#endif
}

/* Iterate from block first on: the states alone, the sensitivities at the solution of the states,
 * or all blocks with the matrix of the states. In the last case the residuals of the sensitivities
 * change with the states, so that one more correction follows if the sensitivities are outside the
 * test. */
static int iterate(cotree_job *job, cotree_run *run, const cotree_system *s, int first,
                   const double *weights, double tolerance, double *e)
{
    cotree_bdf *const c = bdf_of(job);
    const int n_blocks = run->n_blocks, length = length_of(job, run);
    const int are_followed = c->aid->are_followed && n_blocks > 1;
    const int n_tested = first == 0 && are_followed ? 1 : n_blocks;
    double *const moved = vector_of(job, MOVED), *const rates = vector_of(job, RATES);
    int i, n, found, status;
    for (n = 0; n < MAX_CORRECTIONS; ++n) {
        double size;
        for (i = 0; i < length; ++i) moved[i] = s->start[i] + e[i];
        status = cotree_bdf_evaluate(job, run, s->t, moved, rates);
        if (status != 0) return status;
        size = size_of_corrections(job, s, first, n_tested, rates, weights, e);
        if (n_tested < n_blocks) correct(job, s, n_tested, n_blocks, rates, weights, e);
        if (first > 0 && c->is_fresh) return 0;
        found = first > 0 && are_followed ? 1
                : c->is_fresh             ? has_converged_quadratically(c, n, size, tolerance)
                                          : has_converged(c, first, n, size, tolerance);
        if (found < 0 || (found > 0 && c->is_opposed)) break;
        if (found > 0 && (!are_followed || n + 1 >= CORRECTIONS)) return 0;
    }
    return NOT_CONVERGED;
}

static int correct_states(cotree_job *job, const cotree_system *s, const double *weights,
                          double tolerance, double *e)
{
    bdf_of(job)->slowest = 0.0;
#if COTREE_SENSITIVITIES
    return iterate(job, solved_of(job), s, 0, weights, tolerance, e);
#else
    return iterate(job, states_of(job), s, 0, weights, tolerance, e);
#endif
}

COTREE_PRIVATE int cotree_bdf_correct_sensitivities(cotree_job *job, const cotree_system *s,
                                                    const double *weights, double tolerance,
                                                    double *e)
{
    cotree_bdf *const c = bdf_of(job);
    double *const moved = vector_of(job, MOVED);
    int i;
    if (c->is_fresh && c->slowest > FAST_RATE) {
        int status;
        for (i = 0; i < BLOCK(job->model); ++i) moved[i] = s->start[i] + e[i];
        status = cotree_bdf_evaluate_jacobian(job, s->t, moved);
        if (status == 0) status = cotree_bdf_form_matrix(job, s->shares, 0);
        if (status != 0) return status;
    }
    return iterate(job, all_of(job), s, 1, weights, tolerance, e);
}

/* Project the solution onto the constraints. Fail if the projection changes it by too much. */
COTREE_PRIVATE int cotree_bdf_project(cotree_job *job, cotree_run *run, const cotree_system *s,
                                      const double *weights, double *e)
{
    double *const moved = vector_of(job, MOVED);
    const double known = run->correction;
    const int n = length_of(job, run);
    double sum = 0.0;
    int i;
    if (!is_constrained(job)) return 0;
    for (i = 0; i < n; ++i) moved[i] = s->start[i] + e[i];
#if COTREE_IDA
    if (cotree_run_project_packed(run, s->t, moved) != 0) return NOT_CONVERGED;
#else
    if (cotree_run_project(s->t, moved, run) != 0) return NOT_CONVERGED;
#endif
    for (i = 0; i < n; ++i) {
        const double change = moved[i] - s->start[i] - e[i];
        const double share = weights == NULL ? 0.0 : change * weights[i];
        e[i] += change;
        sum += share * share;
    }
    if (sum <= COTREE_MAX_PROJECTION * COTREE_MAX_PROJECTION * n) return 0;
    run->correction = known; /* keeps the old value, because the step is rejected */
    return NOT_CONVERGED;
}

/* Solve for the correction e, starting from its current value. */
static int correct_all(cotree_job *job, const cotree_system *s, const double *weights,
                       double tolerance, double *e)
{
#if COTREE_SENSITIVITIES
    const int status = correct_states(job, s, weights, tolerance, e);
#else
    int status = correct_states(job, s, weights, tolerance, e);
    if (status == 0 && job->has_sensitivities) {
        status = cotree_bdf_correct_sensitivities(job, s, weights, tolerance, e);
    }
#endif
    return status != 0 ? status : cotree_bdf_project(job, solved_of(job), s, weights, e);
}

COTREE_PRIVATE void cotree_bdf_set_zero(double *e, int n)
{
    int i;
    for (i = 0; i < n; ++i) e[i] = 0.0;
}

#if COTREE_IDA
/* Start from algebraic unknowns that solve their equations at the predicted states. Predicted
 * unknowns may be far from a solution where junctions start to conduct. */
static int correct_from_solved_unknowns(cotree_job *job, const cotree_system *s,
                                        const double *weights, double tolerance, double *e)
{
    cotree_run *const run = states_of(job);
    double *const w = vector_of(job, STEP), *const moved = vector_of(job, MOVED);
    const int n = length_of(job, solved_of(job));
    int i, status;
    cotree_run_narrow(run, job->t, cotree_engine_of(job)->w,
                      w); /* guesses for the unknowns from the current point */
    for (i = 0; i < run->n_rates; ++i) w[i] = s->start[i];
    if (cotree_run_complete(run, s->t, w) != 0) return NOT_CONVERGED;
    cotree_bdf_set_zero(e, n);
    for (i = 0; i < run->n_full; ++i) {
        moved[i] = run->full[i];
        e[i] = moved[i] - s->start[i];
    }
    status = cotree_bdf_evaluate_jacobian(job, s->t, moved);
    if (status == 0) status = cotree_bdf_form_matrix(job, s->shares, 0);
    return status != 0 ? status : correct_all(job, s, weights, tolerance, e);
}

#endif
/* Solve the equations of a step with the current matrix; if that fails, with a new one. */
COTREE_PRIVATE int cotree_bdf_solve_system(cotree_job *job, const cotree_system *s,
                                           const double *weights, double tolerance, double *e)
{
    cotree_bdf *const c = bdf_of(job);
#if COTREE_IDA
    const int is_tightened = !c->is_fresh;
#else
    const int is_tightened = !c->is_fresh && job->has_sensitivities;
#endif
    int is_fresh = 0;
    int status = cotree_bdf_prepare_matrix(job, s, c->step_of_solution == job->n_steps, &is_fresh);
    if (is_tightened) tolerance *= TIGHTENING;
    c->step_of_solution = job->n_steps;
    if (status == 0) status = correct_all(job, s, weights, tolerance, e);
    if (status > 0 && !is_fresh) {
        c->has_failed = fabs(1.0 / share_ratio(job, s) - 1.0) < NEAR_SHARES;
        cotree_bdf_set_zero(e, length_of(job, solved_of(job)));
        status = cotree_bdf_prepare_matrix(job, s, 1, &is_fresh);
        if (status == 0) status = correct_all(job, s, weights, tolerance, e);
    }
#if COTREE_IDA
    if (status > 0 && job->model->n_algebraic > 0) {
        status = correct_from_solved_unknowns(job, s, weights, tolerance, e);
    }
#endif
    c->has_failed = status != 0;
    return status;
}

static int solver_type(void *solver)
{
    (void)solver;
    return 0; /* the type SUNNONLINEARSOLVER_ROOTFIND */
}

static int solver_take_system(void *solver, void *system)
{
    (void)solver, (void)system;
    return 0;
}

/* Return a nonlinear solver for SUNDIALS, or NULL if memory is exhausted. */
COTREE_PRIVATE void *cotree_bdf_make_solver(cotree_job *job, cotree_solve solve)
{
    const cotree_bdf *const c = bdf_of(job);
    cotree_solver *const solver = (cotree_solver *)c->sundials->SUNNonlinSolNewEmpty(c->context);
    if (solver == NULL) return NULL;
    solver->content = job;
    solver->operations->type = solver_type;
    solver->operations->take_system = solver_take_system;
    solver->operations->solve = solve;
    return solver;
}

/* Read the equations of the current step, without those of sensitivities in separate vectors. */
COTREE_PRIVATE int cotree_bdf_read_system(const cotree_job *job, void *integrator,
                                          cotree_system *system)
{
    const cotree_sundials *const s = bdf_of(job)->sundials;
    void *predicted, *slopes, *now, *data;
#if !COTREE_IDA
    void *rates;
    double gamma;
    const int flag = s->CVodeGetNonlinearSystemData(
        integrator, &system->t, &predicted, &now, &rates, &gamma, &system->factor, &slopes, &data);
    if (flag != 0) return flag;
    system->shares.of_own = 1.0;
    system->shares.of_rates = gamma;
#else
    void *slopes_now, *left;
    const int flag =
        s->IDAGetNonlinearSystemData(integrator, &system->t, &predicted, &slopes, &now, &slopes_now,
                                     &left, &system->shares.of_own, &data);
    if (flag != 0) return flag;
    system->factor = system->shares.of_rates = 1.0;
#endif
    system->t = clock_at(job, system->t);
    system->start = s->N_VGetArrayPointer(predicted);
    system->slopes = s->N_VGetArrayPointer(slopes);
    return 0;
}
