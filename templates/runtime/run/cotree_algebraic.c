/* cotree_algebraic.c: algebraic unknowns z of g(x, z, t) = 0, by Newton's method or an inverse
 * series; their sensitivities; the Jacobian of the rates with z eliminated. */
#include "cotree_run_internal.h"

#if COTREE_HAS_ALGEBRAIC
/* Limits of Newton's method for algebraic unknowns. Step sizes are relative to |unknown| + atol.
 * After a step below CONVERGED_STEP, quadratic convergence leaves only rounding errors. */
#define MAX_NEWTON_STEPS 50
#define MIN_DAMPING COTREE_F(1e-6)
#define CONVERGED_STEP COTREE_SELECT(1e-8, 3.5e-04f)
#define STALLED_STEP COTREE_SELECT(1e-4, 2.3e-02f)

/* Maximum number of stored solutions that are tried as initial guesses: the last one, then those
 * nearest in time. */
#define MAX_GUESSES 4

/* Solve g_z step = -g with the factorised matrix g_z. */
int cotree_solve_linearised(const cotree_run *run, const cotree_real *g, cotree_real *step)
{
    const cotree_elimination *const own = &run->elimination;
    const int m = N_ALGEBRAIC;
    int i;
    if (own->solve != NULL) return own->solve(g, step, own->context);
    for (i = 0; i < m; ++i) step[i] = -g[i];
    cotree_lu_solve(&run->matrix, step);
    return 0;
}

/* Evaluate the Jacobian at x and factorise its last block, g_z. */
static int factorise_algebraic(cotree_run *run, cotree_real t, const cotree_real *x)
{
    const cotree_model *const model = run->model;
    const int status = model->jacobian(t, x, run->u, run->p, run->k, run->nonzeros);
    if (status != 0) return status;
    cotree_lu_load(&run->matrix, COTREE_F(1.0), model->column_starts, model->row_indices,
                   run->nonzeros, N_RATES, 0);
    return cotree_lu_factorise(&run->matrix) == 0 ? 0 : COTREE_SINGULAR;
}

int cotree_linearise(cotree_run *run, cotree_real t, const cotree_real *x)
{
    const cotree_elimination *const own = &run->elimination;
    return own->linearise != NULL ? own->linearise(t, x, own->context)
                                  : factorise_algebraic(run, t, x);
}

/* Compute a Newton step of the algebraic unknowns and its largest relative entry. The ratio of two
 * successive steps estimates the nonlinearity of the equations. */
static int step_of_unknowns(const cotree_iteration *a, int is_new, cotree_real *size)
{
    cotree_run *const run = (cotree_run *)a->context;
    const int m = N_ALGEBRAIC;
    cotree_real *const before = run->newton, *const step = before + (is_new ? m : 2 * m);
    int i, status = is_new ? cotree_linearise(run, a->t, a->x) : 0;
    if (status == 0) status = cotree_solve_linearised(run, run->rates + N_RATES, step);
    if (status != 0) return status;
    *size = COTREE_F(0.0);
    for (i = 0; i < m; ++i) {
        cotree_real share;
        if (is_new) before[i] = a->x[N_RATES + i];
        share = COTREE_FABS(step[i]) / (COTREE_FABS(before[i]) + run->atol + COTREE_MIN);
        if (!(share <= *size)) *size = share; /* also true for nan */
    }
    if (!is_new && a->size > STALLED_STEP)
        run->bend = COTREE_FMAX(run->bend, COTREE_F(2.0) * *size / a->size);
    return 0;
}

static int move_unknowns(const cotree_iteration *a, cotree_real share)
{
    const cotree_run *const run = (const cotree_run *)a->context;
    const cotree_real *const before = run->newton, *const step = before + N_ALGEBRAIC;
    int i;
    for (i = 0; i < N_ALGEBRAIC; ++i) a->x[N_RATES + i] = before[i] + share * step[i];
    return run->model->rhs(a->t, a->x, run->u, run->p, run->k, run->rates);
}

/* Solve for the algebraic unknowns of x in place, starting from their current values. Return a
 * positive number if Newton's method fails. */
static int newton_from_guess(cotree_run *run, cotree_real t, cotree_real *x)
{
    static const cotree_newton_limits limits = {MAX_NEWTON_STEPS, CONVERGED_STEP, COTREE_F(0.0),
                                                STALLED_STEP, MIN_DAMPING};
    cotree_iteration a = {step_of_unknowns, move_unknowns, run, t, x, &limits, COTREE_F(0.0)};
    const int status = run->model->rhs(t, x, run->u, run->p, run->k, run->rates);
    return status != 0 ? status : cotree_iterate(&a);
}

/* Return the index of a stored solution, counted backwards from the next free entry. */
static int guess_place(const cotree_run *run, int back)
{
    return (run->n_found - back) & (COTREE_RUN_REMEMBERED - 1);
}

/* Store the algebraic unknowns of x as a guess. */
void cotree_store_guess(cotree_run *run, cotree_real t, const cotree_real *x)
{
    const int place = guess_place(run, 0);
    int i;
    for (i = 0; i < N_ALGEBRAIC; ++i) run->found[place * N_ALGEBRAIC + i] = x[N_RATES + i];
    run->times[place] = t;
    /* Only the remainder of the count matters once the ring buffer is full, so limit the count. */
    if (++run->n_found == 2 * COTREE_RUN_REMEMBERED) run->n_found = COTREE_RUN_REMEMBERED;
}

/* Return the index of a stored solution, or -1 if there is none. Rank 0 is the last solution; the
 * next ranks are those nearest in time. */
int cotree_guess_place(const cotree_run *run, cotree_real t, int rank)
{
    const int is_full = run->n_found >= COTREE_RUN_REMEMBERED;
    const int n = is_full ? COTREE_RUN_REMEMBERED : run->n_found;
    cotree_real nearest = -COTREE_F(1.0);
    int i, place = guess_place(run, 1);
    for (; rank > 0; --rank) {
        cotree_real least = COTREE_INFINITY;
        place = -1;
        for (i = 0; i < n; ++i) {
            const cotree_real distance = COTREE_FABS(run->times[i] - t);
            if (distance > nearest && distance < least) {
                least = distance;
                place = i;
            }
        }
        if (place < 0) return -1;
        nearest = least;
    }
    return place;
}

/* Solve for the algebraic unknowns of x in place, starting from stored guesses. Return a positive
 * number if all of them fail; a shorter step may succeed. */
static int newton_from_stored_guesses(cotree_run *run, cotree_real t, cotree_real *x)
{
    int i, rank, status = 1;
    for (rank = 0; rank < MAX_GUESSES && status > 0; ++rank) {
        const int place = cotree_guess_place(run, t, rank);
        if (place < 0) break;
        for (i = 0; i < N_ALGEBRAIC; ++i) x[N_RATES + i] = run->found[place * N_ALGEBRAIC + i];
        status = newton_from_guess(run, t, x);
    }
    if (status == 0) cotree_store_guess(run, t, x);
    return status;
}

#if COTREE_HAS_SENSITIVITIES
/* Solve g_z S_z = -(g_x S_x + g_p). The right-hand side is the residual at S_z = 0. */
static int solve_sensitivities(cotree_run *run, cotree_real t)
{
    const cotree_model *const model = run->model;
    cotree_real *const x = run->full, *const packed = run->step;
    int i, j, n, status;
    for (n = 1; n < run->n_blocks; ++n) {
        for (j = 0; j < N_ALGEBRAIC; ++j) x[n * N_STATES + N_RATES + j] = COTREE_F(0.0);
    }
    cotree_pack(run, N_STATES, x + N_STATES, packed);
    status = model->augmented_rhs(t, x, packed, run->u, run->p, run->k, run->held);
    cotree_run_unpack(run, run->held, run->rates);
    if (status == 0) status = cotree_linearise(run, t, x);
    for (n = 1; n < run->n_blocks && status == 0; ++n) {
        cotree_real *const ds = run->rates + n * N_STATES, *const sz = x + n * N_STATES + N_RATES;
        status = cotree_solve_linearised(run, ds + N_RATES, sz);
        for (j = 0; j < N_ALGEBRAIC; ++j) {
            const int *const starts = model->column_starts + N_RATES + j;
            for (i = starts[0]; i < starts[1]; ++i) {
                const int row = model->row_indices[i];
                if (row < N_RATES) ds[row] += run->nonzeros[i] * sz[j];
            }
        }
    }
    return status;
}
#endif

/* Small systems have the kernel algebraic_step, a step of the inverse series of their equations.
 * From extrapolated unknowns, one such step nearly always suffices. */

/* Error of the unknowns in rates, as a fraction of the tolerance. */
#define UNKNOWN_TOLERANCE COTREE_F(1e-3)

/* The remainder of a series is estimated for steps below this fraction of the radius of
 * convergence. */
#define MAX_ESTIMATED_REACH COTREE_F(0.5)

/* Steps longer than this multiple of the radius of convergence are left to the damped
 * iteration. */
#define MAX_REACH COTREE_F(4.0)
#define MAX_SERIES_STEPS 4

/* Maximum growth of rounding errors by planned pivots: half of the digits are lost. */
#define MAX_PIVOT_GROWTH COTREE_SELECT(1e8, 2.9e+03f)

/* Integrated unknowns are far from their solution if a projection changes them by more than
 * FAR_TOLERANCES on average, or if pivots lose more digits than the tolerance permits. The error
 * test would then measure rounding errors, and shorten steps indefinitely. If this occurs MAX_FAR
 * times more often than not, the unknowns are solved for at each point from then on. */
#define FAR_TOLERANCES COTREE_F(10.0)
#define MAX_FAR 20

/* Maximum extrapolation distance, as a multiple of the time between the two solutions. */
#define MAX_EXTRAPOLATION COTREE_F(100.0)

/* Extrapolate the unknowns linearly in time from the two nearest of the last three solutions. */
static void extrapolate(const cotree_run *run, cotree_real t, cotree_real *z)
{
    const cotree_real *const times = run->times;
    int a = guess_place(run, 1), b, i;
    const cotree_real *from = run->found + a * N_ALGEBRAIC, *to = from;
    cotree_real weight = COTREE_F(0.0);
    if (run->n_found >= 3) {
        const int c = guess_place(run, 3);
        const cotree_real of_c = COTREE_FABS(times[c] - t), of_a = COTREE_FABS(times[a] - t);
        cotree_real of_b;
        b = guess_place(run, 2);
        of_b = COTREE_FABS(times[b] - t);
        if (times[a] == times[b]) {
            b = c;
        } else if (times[c] != times[a] && times[c] != times[b]) {
            if (of_b >= of_a) {
                if (of_c < of_b) b = c;
            } else if (of_c < of_a) {
                a = c;
            }
        }
        from = run->found + a * N_ALGEBRAIC;
        to = run->found + b * N_ALGEBRAIC;
        weight = (t - times[a]) / (times[b] - times[a]);
        if (!(COTREE_FABS(weight) <= MAX_EXTRAPOLATION)) weight = COTREE_F(0.0);
    }
    for (i = 0; i < N_ALGEBRAIC; ++i) z[i] = from[i] + weight * (to[i] - from[i]);
}

/* Return whether the planned pivots lost too many digits at the last solution. */
static int has_lost_digits(const cotree_run *run)
{
    return !(run->pivot_growth <= MAX_PIVOT_GROWTH); /* also true for nan */
}

/* Solve for the algebraic unknowns of x in place by series steps, up to an error of goal *
 * (|unknown| + near_zero). Return a positive number if the series fails. */
static int solve_by_series(cotree_run *run, cotree_real t, cotree_real *x, cotree_real goal,
                           cotree_real near_zero)
{
    const int m = N_ALGEBRAIC;
    cotree_real *const z = x + N_RATES;
    const cotree_real *const step = run->rates + N_RATES, *const last = step + m;
    const cotree_real *const reach = last + m, *const doubt = reach + 1;
    cotree_real before = COTREE_INFINITY;
    int i, n;
    for (n = 0; n < MAX_SERIES_STEPS; ++n) {
        cotree_real size = COTREE_F(0.0), rest = COTREE_F(0.0),
                    left; /* sums, unlike maxima, propagate nan and infinity */
        const int status = run->model->algebraic_step(t, x, run->u, run->p, run->k, run->rates);
        if (status != 0) return status;
        for (i = 0; i < m; ++i) {
            const cotree_real scale = COTREE_F(1.0) / (COTREE_FABS(z[i]) + near_zero + COTREE_MIN);
            size += COTREE_FABS(step[i]) * scale;
            rest += COTREE_FABS(last[i]) * scale;
            z[i] += step[i];
        }
        left = size + rest; /* far from the solution, terms may cancel each other */
        if (left <= CONVERGED_STEP) left = COTREE_F(0.0);
        /* Estimate the remainder from the last term and the ratio of successive terms. */
        if (*reach < MAX_ESTIMATED_REACH)
            left = rest * (*reach + COTREE_F(2.0) * rest / (size + COTREE_MIN));
        run->pivot_growth = *doubt;
        run->bend += *reach;
        if (has_lost_digits(run)) return 1;
        if (left <= goal) return 0;
        if (!(*reach <= MAX_REACH && size <= COTREE_F(0.5) * before)) return 1;
        before = size;
    }
    return 1;
}

/* Solve for the algebraic unknowns of run->full in place. The iteration starts from their values if
 * is_near is set, otherwise from an extrapolation. *is_wide: 1 if the rates computed last contain
 * residuals. */
int cotree_solve_unknowns(cotree_run *run, cotree_real t, int is_near, cotree_real goal,
                          cotree_real near_zero, int *is_wide)
{
    cotree_real *const x = run->full, *const z = x + N_RATES, *const guess = run->step;
    int i, status = 1;
    if (is_near) {
        for (i = 0; i < N_ALGEBRAIC; ++i) guess[i] = z[i];
    } else {
        extrapolate(run, t, z);
    }
    *is_wide = 0;
    run->bend = COTREE_F(0.0);
    if (run->model->algebraic_step != NULL) status = solve_by_series(run, t, x, goal, near_zero);
    if (status > 0) {
        *is_wide = 1;
        if (is_near) {
            for (i = 0; i < N_ALGEBRAIC; ++i) z[i] = guess[i];
            status = newton_from_guess(run, t, x);
        }
        if (status > 0) {
            status = newton_from_stored_guesses(run, t, x);
            run->bend = COTREE_INFINITY;
            return status;
        }
    }
    if (status == 0) cotree_store_guess(run, t, x);
    return status;
}

#if COTREE_HAS_SENSITIVITIES
/* Solve for the sensitivities of the unknowns in run->full. s: sensitivities of the states. */
int cotree_solve_unknown_sensitivities(cotree_run *run, cotree_real t, const cotree_real *s)
{
    const cotree_model *const model = run->model;
    cotree_real *unknowns = run->full + N_STATES + N_RATES;
    int i, j, status;
    if (model->algebraic_sensitivity == NULL || has_lost_digits(run))
        return solve_sensitivities(run, t);
    status = model->algebraic_sensitivity(t, run->full, s, run->u, run->p, run->k, run->rates);
    for (j = 0; j < run->n_blocks - 1; ++j) {
        for (i = 0; i < N_ALGEBRAIC; ++i) unknowns[i] = run->rates[j * N_ALGEBRAIC + i];
        unknowns += N_STATES;
    }
    return status;
}
#endif

/* Compute rates while solving for the unknowns at each point; unknowns in w have zero rates. */
int cotree_reduced_rate(cotree_run *run, cotree_real t, const cotree_real *w, cotree_real *dw)
{
#if COTREE_HAS_SENSITIVITIES
    const cotree_model *const model = run->model;
#endif
    const cotree_real *const rates = run->rates;
    const cotree_real goal = UNKNOWN_TOLERANCE * run->rtol;
    const int is_rounding = !(goal > ROUNDING), n = N_RATES, lead = run->n_lead;
    int i, is_wide = 0;
    int status = cotree_prepare_point(run, t, w);
    if (status == 0) {
        status = cotree_solve_unknowns(run, t, 0, is_rounding ? ROUNDING : goal,
                                       is_rounding ? run->atol : run->atol / run->rtol, &is_wide);
    }
#if COTREE_HAS_SENSITIVITIES
    if (status == 0 && run->n_blocks > 1) {
        is_wide = model->extended_augmented_rhs == NULL || has_lost_digits(run);
        status = is_wide ? solve_sensitivities(run, t)
                         : model->extended_augmented_rhs(t, run->full, w + lead, run->u, run->p,
                                                         run->k, run->rates);
    }
#endif
    if (status != 0) return status;
    if (is_wide) {
        cotree_run_leave_out(run, rates, dw);
    } else {
        for (i = 0; i < n; ++i) dw[i] = rates[i];
        for (i = lead; i < run->n; ++i) dw[i] = rates[N_STATES - lead + i];
    }
    for (i = n; i < lead; ++i) dw[i] = COTREE_F(0.0);
    return 0;
}

/* Project integrated unknowns onto their equations. */
int cotree_project_unknowns(cotree_run *run, cotree_real t, cotree_real *w)
{
    const cotree_real goal = COTREE_FMAX(ROUNDING, UNKNOWN_TOLERANCE * run->rtol);
    cotree_real moved = COTREE_F(0.0);
    int i, is_wide, is_far, status = cotree_prepare_point(run, t, w);
    if (status == 0)
        status = cotree_solve_unknowns(run, t, !run->is_solving, goal, run->atol, &is_wide);
    if (status != 0) return status;
    for (i = N_RATES; i < N_STATES; ++i) {
        const cotree_real found = run->full[i];
        moved +=
            COTREE_FABS(found - w[i]) / (run->rtol * COTREE_FABS(found) + run->atol + COTREE_MIN);
        w[i] = found;
    }
    is_far = moved > FAR_TOLERANCES * (cotree_real)N_ALGEBRAIC ||
             COTREE_EPSILON * run->pivot_growth > run->rtol;
    run->n_far += is_far ? 1 : run->n_far > 0 ? -1 : 0;
    if (run->n_far > MAX_FAR) run->is_solving = 1;
    return 0;
}

/* A branch of solutions ends at a fold, where it meets another branch. Beyond the fold, Newton's
 * method may find a third branch. Unknowns are therefore tracked through a step if they change by
 * more than the fraction NEAR of their size and by more than NEAR_TOLERANCES tolerances. */
#define NEAR COTREE_F(0.1)
#define NEAR_TOLERANCES COTREE_F(1e3)

/* The last change of the unknowns predicts their change in a step at most this many times as
 * long. */
#define MAX_STEP_RATIO COTREE_F(6.0)

/* Maximum number of bisections of a step. A junction that begins to conduct needs many, since its
 * voltage changes logarithmically. */
#define MAX_BISECTIONS 50

static cotree_real size_of_unknown(const cotree_run *run, cotree_real before, cotree_real after)
{
    return COTREE_FABS(before) + COTREE_FABS(after) + NEAR_TOLERANCES * run->atol / NEAR;
}

/* Return the algebraic unknowns of a point with n entries; without any, those last solved for. */
static const cotree_real *unknowns_of(const cotree_run *run, int n, const cotree_real *w)
{
    if (n != run->n || run->n_lead > N_RATES) return w + N_RATES;
    return run->found + guess_place(run, 1) * N_ALGEBRAIC;
}

void cotree_run_accept(cotree_run *run, cotree_real t, int n, const cotree_real *w)
{
    const cotree_real *const z = unknowns_of(run, n, w);
    cotree_real *const COTREE_RESTRICT now = run->branch, *const COTREE_RESTRICT old =
                                                              run->branch_before;
    const int m = N_ALGEBRAIC;
    int i;
    for (i = 0; i < m; ++i) {
        old[i] = now[i];
        now[i] = z[i];
    }
    run->t_before = run->t_branch;
    run->t_branch = t;
}

/* Return whether algebraic unknowns differ much from the last accepted ones. */
static int are_far(const cotree_run *run, const cotree_real *z)
{
    const cotree_real *const before = run->branch;
    const cotree_real near_zero = NEAR_TOLERANCES * run->atol;
    const int m = N_ALGEBRAIC;
    int i;
    for (i = 0; i < m; ++i) {
        const cotree_real size = COTREE_FABS(before[i]) + COTREE_FABS(z[i]);
        if (COTREE_FABS(z[i] - before[i]) > NEAR * size + near_zero) return 1;
    }
    return 0;
}

int cotree_run_is_far(const cotree_run *run, int n, const cotree_real *w)
{
    return are_far(run, unknowns_of(run, n, w));
}

void cotree_forget_far_guesses(cotree_run *run)
{
    if (are_far(run, run->found + guess_place(run, 1) * N_ALGEBRAIC))
        cotree_run_return(run, run->t_branch, run->branch);
}

/* Return whether the unknowns continue their last change: a linear extrapolation errs by at most
 * half of the change of each unknown that is far from its accepted value. */
static int are_predicted(const cotree_run *run, cotree_real t, const cotree_real *z)
{
    const cotree_real ratio = (t - run->t_branch) / (run->t_branch - run->t_before);
    int i;
    if (!(ratio > COTREE_F(0.0) && ratio <= MAX_STEP_RATIO)) return 0;
    for (i = 0; i < N_ALGEBRAIC; ++i) {
        const cotree_real before = run->branch[i], change = z[i] - before;
        const cotree_real error = change - ratio * (before - run->branch_before[i]);
        if (COTREE_FABS(error) <= COTREE_F(0.5) * COTREE_FABS(change)) continue;
        if (COTREE_FABS(change) > NEAR * size_of_unknown(run, before, z[i])) return 0;
    }
    return 1;
}

/* Return the largest difference between two solutions, relative to sizes. */
static cotree_real solution_distance(int m, const cotree_real *a, const cotree_real *b,
                                     const cotree_real *sizes)
{
    cotree_real largest = COTREE_F(0.0);
    int i;
    for (i = 0; i < m; ++i) largest = COTREE_FMAX(largest, COTREE_FABS(a[i] - b[i]) / sizes[i]);
    return largest;
}

/* Solve for the unknowns at the fraction s of a step, starting from `low`. */
static int solve_within(cotree_run *run, cotree_real t, const cotree_real *before,
                        const cotree_real *after, cotree_real s, const cotree_real *low)
{
    cotree_real *const x = run->full;
    const cotree_real at = run->t_branch + s * (t - run->t_branch);
    int i, status = cotree_run_inputs(run, cotree_run_inside(run, at));
    for (i = 0; i < N_RATES; ++i) x[i] = before[i] + s * (after[i] - before[i]);
    for (i = 0; i < N_ALGEBRAIC; ++i) x[N_RATES + i] = low[i];
    return status != 0 ? status : newton_from_guess(run, cotree_run_inside(run, at), x);
}

/* Return the sign of the determinant of g_z, or 0 if it is singular. */
static int sign_of_determinant(cotree_run *run, cotree_real t, const cotree_real *x)
{
    const cotree_lu *const a = &run->matrix;
    int j, sign = factorise_algebraic(run, t, x) == 0;
    for (j = 0; j < a->n; ++j) {
        if ((a->first[j + j * a->stride] < COTREE_F(0.0)) != (a->pivots[j] != j)) sign = -sign;
    }
    return sign;
}

/* Number of points at which is_folded computes the determinant, each at half the distance of the
 * previous one. */
#define MAX_HALVINGS 30

/* Return whether the determinant of g_z changes sign on the line between two solutions. If the
 * first solution is at a fold, the sign changes near it. */
static int is_folded(cotree_run *run, cotree_real t, const cotree_real *low,
                     const cotree_real *high)
{
    cotree_real *const x = run->full, share = COTREE_F(1.0);
    int i, k, first = 0;
    for (k = 0; k < MAX_HALVINGS; ++k) {
        int sign;
        for (i = 0; i < N_ALGEBRAIC; ++i) x[N_RATES + i] = low[i] + share * (high[i] - low[i]);
        sign = sign_of_determinant(run, t, x);
        if (sign * first < 0) return 1;
        if (sign != 0) first = sign;
        share *= COTREE_F(0.5);
    }
    return 0;
}

int cotree_run_is_continuous(cotree_run *run, cotree_real t, int n, const cotree_real *before,
                             const cotree_real *after)
{
    const int m = N_ALGEBRAIC;
    const cotree_real *const z = run->full + N_RATES, *const end = unknowns_of(run, n, after);
    cotree_real *const low = run->branch + m, *const high = low + m, *const sizes = high + m;
    cotree_real from = COTREE_F(0.0), to = COTREE_F(1.0), all, rest;
    int i, k;
#if COTREE_HAS_INPUTS
    if (run->input_function != NULL) return 1; /* the caller's inputs may be discontinuous */
#endif
    if (are_predicted(run, t, end)) return 1;
    for (i = 0; i < m; ++i) {
        high[i] = end[i];
        low[i] = run->branch[i];
        sizes[i] = size_of_unknown(run, low[i], high[i]);
    }
    all = rest = solution_distance(m, low, high, sizes);
    for (k = 0; k < MAX_BISECTIONS && rest > COTREE_F(0.5) * all; ++k) {
        const cotree_real s = COTREE_F(0.5) * (from + to);
        int is_low = 0;
        if (solve_within(run, t, before, after, s, low) == 0) {
            const cotree_real first = solution_distance(m, low, z, sizes);
            const cotree_real last = solution_distance(m, z, high, sizes);
            is_low = last > first;
            rest = COTREE_FMAX(first, last);
            for (i = 0; i < m; ++i) (is_low ? low : high)[i] = z[i];
        }
        if (is_low) {
            from = s;
        } else {
            to = s;
        }
    }
    return rest <= COTREE_F(0.5) * all || !is_folded(run, cotree_run_inside(run, t), low, high);
}

void cotree_run_return(cotree_run *run, cotree_real t, const cotree_real *unknowns)
{
    int i;
    for (i = 0; i < N_ALGEBRAIC; ++i) run->full[N_RATES + i] = unknowns[i];
    run->n_found = 0;
    cotree_store_guess(run, t, run->full);
}

int cotree_run_solve_packed(cotree_run *run, cotree_real t, cotree_real *packed)
{
    int is_wide, status;
    cotree_run_unpack(run, packed, run->full);
    status = cotree_run_inputs(run, t);
    if (status == 0) status = cotree_solve_unknowns(run, t, 1, ROUNDING, run->atol, &is_wide);
#if COTREE_HAS_SENSITIVITIES
    if (status == 0 && run->n_blocks > 1) {
        cotree_run_leave_out(run, run->full, run->held);
        status = cotree_solve_unknown_sensitivities(run, t, run->held + run->n_lead);
    }
#endif
    if (status == 0) cotree_run_pack(run, run->full, packed);
    return status;
}

#if COTREE_HAS_IMPLICIT
/* Subtract f_z g_z^-1 g_x from the matrix, column by column. g_z is already factorised. */
static void eliminate(cotree_run *run, cotree_real *matrix)
{
    const int *const starts = run->model->column_starts, *const rows = run->model->row_indices;
    cotree_real *const g = run->newton, *const slope = g + N_ALGEBRAIC;
    int i, j, k;
    for (j = 0; j < N_RATES; ++j) {
        int is_zero = 1;
        for (i = 0; i < N_ALGEBRAIC; ++i) g[i] = COTREE_F(0.0);
        for (i = starts[j]; i < starts[j + 1]; ++i) {
            if (rows[i] >= N_RATES) {
                g[rows[i] - N_RATES] = run->nonzeros[i];
                is_zero = 0;
            }
        }
        if (is_zero) continue;
        (void)cotree_solve_linearised(run, g, slope); /* derivatives of the unknowns, -g_z^-1 g_x */
        for (k = 0; k < N_ALGEBRAIC; ++k) {
            for (i = starts[N_RATES + k]; i < starts[N_RATES + k + 1]; ++i) {
                if (rows[i] < N_RATES) matrix[rows[i] * N_RATES + j] += run->nonzeros[i] * slope[k];
            }
        }
    }
}
#endif
#endif

#if COTREE_HAS_IMPLICIT
int cotree_run_jacobian(cotree_real t, const cotree_real *w, cotree_real *matrix, void *context)
{
    cotree_run *const run = (cotree_run *)context;
    const cotree_model *const model = run->model;
    const int *const starts = model->column_starts, *const rows = model->row_indices;
    int i, j, status;
    t = cotree_run_inside(run, t);
    status = cotree_run_complete(run, t, w);
    if (status == 0) status = cotree_run_inputs(run, t);
#if COTREE_HAS_ALGEBRAIC
    if (status == 0 && N_ALGEBRAIC > 0) status = cotree_linearise(run, t, run->full);
#endif
    if (status == 0 && N_ALGEBRAIC == 0) {
        status = model->jacobian(t, run->full, run->u, run->p, run->k, run->nonzeros);
    }
    if (status != 0) return status;
    for (i = 0; i < N_RATES * N_RATES; ++i) matrix[i] = COTREE_F(0.0);
    for (j = 0; j < N_RATES; ++j) {
        for (i = starts[j]; i < starts[j + 1]; ++i) {
            if (rows[i] < N_RATES) matrix[rows[i] * N_RATES + j] = run->nonzeros[i];
        }
    }
#if COTREE_HAS_ALGEBRAIC
    if (N_ALGEBRAIC > 0) eliminate(run, matrix);
#endif
    return 0;
}
#endif
