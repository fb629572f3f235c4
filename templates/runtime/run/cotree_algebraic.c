/* cotree_algebraic.c: algebraic unknowns: their solution, their sensitivities, the reduced
 * Jacobian. Part of the runtime of cotree, the same for every model.
 */
#include "cotree_run_internal.h"

#include <float.h>
#include <math.h>
#include <stddef.h>

#if COTREE_HAS_ALGEBRAIC
/* Newton's method for algebraic unknowns. It squares its errors, so that after a step below SETTLED
 * nothing but rounding is left. Steps are shortened until the next one is shorter. What cannot be
 * shortened below RESTING is rounding, too. Both are shares of an unknown, or of atol where it is
 * zero. */
#define MOST_NEWTON_STEPS 50
#define LEAST_DAMPING COTREE_F(1e-6)
#define SETTLED COTREE_SELECT(1e-8, 3.5e-04f)
#define RESTING COTREE_SELECT(1e-4, 2.3e-02f)

/* How many of the remembered solutions are tried: the last, and the nearest in time. */
#define MOST_GUESSES 4

/* Writes minus the solution for the right-hand side g. */
int cotree_substitute(const cotree_run *run, const cotree_real *g, cotree_real *step)
{
    const cotree_elimination *const own = &run->elimination;
    const int m = N_ALGEBRAIC;
    int i;
    if (own->solve != NULL) return own->solve(g, step, own->context);
    for (i = 0; i < m; ++i) step[i] = -g[i];
    cotree_lu_solve(&run->matrix, step);
    return 0;
}

/* Evaluates the Jacobian at x and factors its last block. */
int cotree_linearise(cotree_run *run, cotree_real t, const cotree_real *x)
{
    const cotree_model *const model = run->model;
    const int *const starts = model->column_starts;
    const cotree_elimination *const own = &run->elimination;
    const int m = N_ALGEBRAIC, n_rates = N_RATES;
    cotree_real *const matrix = run->matrix.first;
    int i, j, status;
    if (own->linearise != NULL) return own->linearise(t, x, own->context);
    status = model->jacobian(t, x, run->u, run->p, run->k, run->nonzeros);
    if (status != 0) return status;
    for (i = 0; i < m * m; ++i) matrix[i] = COTREE_F(0.0);
    for (j = 0; j < m; ++j) {
        for (i = starts[n_rates + j]; i < starts[n_rates + j + 1]; ++i) {
            const int row = model->row_indices[i];
            if (row >= n_rates) matrix[row - n_rates + j * m] = run->nonzeros[i];
        }
    }
    return cotree_lu_factorise(&run->matrix) == 0 ? 0 : COTREE_SINGULAR;
}

/* The longest entry of a step as a share of the unknown. */
static cotree_real share(const cotree_run *run, const cotree_real *step, const cotree_real *z)
{
    const int m = N_ALGEBRAIC;
    cotree_real largest = COTREE_F(0.0);
    int i;
    for (i = 0; i < m; ++i) {
        const cotree_real size =
            COTREE_FABS(step[i]) / (COTREE_FABS(z[i]) + run->atol + COTREE_MIN);
        if (!(size <= largest)) largest = size; /* nan, too */
    }
    return largest;
}

/* Solves for the algebraic unknowns of x, in place, beginning with those that it has. Returns a
 * positive number where that leads nowhere. */
static int solve_near(cotree_run *run, cotree_real t, cotree_real *x)
{
    const int m = N_ALGEBRAIC;
    cotree_real *const z = x + N_RATES, *const before = run->newton, *const step = before + m;
    cotree_real *const next = step + m;
    const cotree_real *const g = run->rates + N_RATES;
    int i, n;
    int status = run->model->rhs(t, x, run->u, run->p, run->k, run->rates);
    for (n = 0; n < MOST_NEWTON_STEPS && status == 0; ++n) {
        cotree_real damping = COTREE_F(1.0), size, after;
        status = cotree_linearise(run, t, x);
        if (status != 0) break;
        status = cotree_substitute(run, g, step);
        if (status != 0) break;
        size = share(run, step, z);
        for (i = 0; i < m; ++i) before[i] = z[i];
        for (;;) {
            for (i = 0; i < m; ++i) z[i] = before[i] + damping * step[i];
            status = run->model->rhs(t, x, run->u, run->p, run->k, run->rates);
            if (status != 0 || size <= SETTLED) return status;
            status = cotree_substitute(run, g, next);
            if (status != 0) return status;
            after = share(run, next, before);
            if (size > RESTING) run->bend = COTREE_FMAX(run->bend, COTREE_F(2.0) * after / size);
            if (after <= (COTREE_F(1.0) - COTREE_F(0.25) * damping) * size) break;
            if (damping == COTREE_F(1.0) && size <= RESTING && after <= RESTING) return 0;
            if (damping < LEAST_DAMPING) return 1;
            damping *= COTREE_F(0.5);
        }
    }
    return status != 0 ? status : 1;
}

/* Tells where a solution is that was found so many before the next one. */
static int place_of(const cotree_run *run, int back)
{
    return (run->n_found - back) & (COTREE_RUN_REMEMBERED - 1);
}

/* Remembers the algebraic unknowns of x. */
void cotree_remember(cotree_run *run, cotree_real t, const cotree_real *x)
{
    const int place = place_of(run, 0);
    int i;
    for (i = 0; i < N_ALGEBRAIC; ++i) run->found[place * N_ALGEBRAIC + i] = x[N_RATES + i];
    run->times[place] = t;
    /* Places come in turn, and the number stays within the range of its type. */
    if (++run->n_found == 2 * COTREE_RUN_REMEMBERED) run->n_found = COTREE_RUN_REMEMBERED;
}

/* Tells which solution was found last (rank 0), then which ones at the nearest times. Returns -1
 * where there are no more. */
int cotree_guess_place(const cotree_run *run, cotree_real t, int rank)
{
    const int is_full = run->n_found >= COTREE_RUN_REMEMBERED;
    const int n = is_full ? COTREE_RUN_REMEMBERED : run->n_found;
    cotree_real nearest = -COTREE_F(1.0);
    int i, place = place_of(run, 1);
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

/* Solves for the algebraic unknowns of x, in place, beginning with those found last, then with
 * those found at the nearest times. Returns a positive number where that leads nowhere: a shorter
 * step may. */
static int solve_algebraic(cotree_run *run, cotree_real t, cotree_real *x)
{
    int i, rank, status = 1;
    for (rank = 0; rank < MOST_GUESSES && status > 0; ++rank) {
        const int place = cotree_guess_place(run, t, rank);
        if (place < 0) break;
        for (i = 0; i < N_ALGEBRAIC; ++i) x[N_RATES + i] = run->found[place * N_ALGEBRAIC + i];
        status = solve_near(run, t, x);
    }
    if (status == 0) cotree_remember(run, t, x);
    return status;
}

#if COTREE_HAS_SENSITIVITIES
/* g_z S_z = -(g_x S_x + g_p): the residuals where S_z is zero are the right-hand side. */
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
        status = cotree_substitute(run, ds + N_RATES, sz);
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

/* Straight-line kernels in the place of loops. Each evaluation begins with unknowns extrapolated in
 * time; one step by the model's series leads, nearly always, close enough. */

/* Errors of unknowns are kept below this share of the tolerance: rates tell states of them. */
#define CLOSE_ENOUGH COTREE_F(1e-3)

/* Series that reach farther than this part of where they fail say nothing of what they leave. */
#define LONGEST_REACH COTREE_F(0.5)

/* Steps that bend the functions more than this are left to the damped iteration. */
#define FARTHEST_REACH COTREE_F(4.0)
#define MOST_SERIES 4

/* What pivots may lose: half of the digits. */
#define MOST_DOUBT COTREE_SELECT(1e8, 2.9e+03f)

/* Integrated unknowns are lost where a projection moves them by more than FAR tolerances each, and
 * where pivots lose more digits than the tolerance leaves: an error test of what rounding decides
 * shortens steps without end. Where that happens MOST_FAR times more often than not, unknowns are
 * solved for at each point from there on. */
#define FAR COTREE_F(10.0)
#define MOST_FAR 20

/* Extrapolation over more than so many times the distance of what is known is none. */
#define FARTHEST COTREE_F(100.0)

/* Writes unknowns on the straight line through two of the last three solutions, those nearest. */
static void predict(const cotree_run *run, cotree_real t, cotree_real *z)
{
    const cotree_real *const times = run->times;
    int a = place_of(run, 1), b, i;
    const cotree_real *from = run->found + a * N_ALGEBRAIC, *to = from;
    cotree_real weight = COTREE_F(0.0);
    if (run->n_found >= 3) {
        const int c = place_of(run, 3);
        const cotree_real of_c = COTREE_FABS(times[c] - t), of_a = COTREE_FABS(times[a] - t);
        cotree_real of_b;
        b = place_of(run, 2);
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
        if (!(COTREE_FABS(weight) <= FARTHEST)) weight = COTREE_F(0.0);
    }
    for (i = 0; i < N_ALGEBRAIC; ++i) z[i] = from[i] + weight * (to[i] - from[i]);
}

/* Tells whether kernels, which exchange no rows, lost what they solve for at the last solution. */
static int is_lost(const cotree_run *run) { return !(run->doubt <= MOST_DOUBT); /* nan, too */ }

/* Solves for the algebraic unknowns of x, in place, to a share of themselves, or of near_zero where
 * they are zero; leaves the rates. Returns a positive number where series do not lead there. */
static int follow(cotree_run *run, cotree_real t, cotree_real *x, cotree_real goal,
                  cotree_real near_zero)
{
    const int m = N_ALGEBRAIC;
    cotree_real *const z = x + N_RATES;
    const cotree_real *const step = run->rates + N_RATES, *const last = step + m;
    const cotree_real *const reach = last + m, *const doubt = reach + 1;
    cotree_real before = COTREE_INFINITY;
    int i, n;
    for (n = 0; n < MOST_SERIES; ++n) {
        cotree_real size = COTREE_F(0.0), rest = COTREE_F(0.0),
                    left; /* sums, so that nan and infinity show */
        const int status = run->model->algebraic_step(t, x, run->u, run->p, run->k, run->rates);
        if (status != 0) return status;
        for (i = 0; i < m; ++i) {
            const cotree_real share = COTREE_F(1.0) / (COTREE_FABS(z[i]) + near_zero + COTREE_MIN);
            size += COTREE_FABS(step[i]) * share;
            rest += COTREE_FABS(last[i]) * share;
            z[i] += step[i];
        }
        left = size <= SETTLED ? COTREE_F(0.0) : size;
        /* Terms shrink by no less than the ratio of the first two, or as those of functions do. */
        if (*reach < LONGEST_REACH)
            left = rest * (*reach + COTREE_F(2.0) * rest / (size + COTREE_MIN));
        run->doubt = *doubt;
        run->bend += *reach;
        if (is_lost(run)) return 1;
        if (left <= goal) return 0;
        if (!(*reach <= FARTHEST_REACH && size <= COTREE_F(0.5) * before)) return 1;
        before = size;
    }
    return 1;
}

/* Solves for the algebraic unknowns of run->full, in place. Integrated ones are near them; others
 * begin where those before lead. Says whether the rates that it leaves have residuals among them.
 */
int cotree_solve_unknowns(cotree_run *run, cotree_real t, int is_near, cotree_real goal,
                          cotree_real near_zero, int *is_wide)
{
    cotree_real *const x = run->full, *const z = x + N_RATES, *const guess = run->step;
    int i, status = 1;
    if (is_near) {
        for (i = 0; i < N_ALGEBRAIC; ++i) guess[i] = z[i];
    } else {
        predict(run, t, z);
    }
    *is_wide = 0;
    run->bend = COTREE_F(0.0);
    if (run->model->algebraic_step != NULL) status = follow(run, t, x, goal, near_zero);
    if (status > 0) {
        *is_wide = 1;
        if (is_near) {
            for (i = 0; i < N_ALGEBRAIC; ++i) z[i] = guess[i];
            status = solve_near(run, t, x);
        }
        if (status > 0) {
            status = solve_algebraic(run, t, x);
            run->bend = COTREE_INFINITY;
            return status;
        }
    }
    if (status == 0) cotree_remember(run, t, x);
    return status;
}

#if COTREE_HAS_SENSITIVITIES
/* Solves for the sensitivities of the unknowns, in run->full; s are those of the states alone. */
int cotree_solve_unknown_sensitivities(cotree_run *run, cotree_real t, const cotree_real *s)
{
    const cotree_model *const model = run->model;
    cotree_real *unknowns = run->full + N_STATES + N_RATES;
    int i, j, status;
    if (model->algebraic_sensitivity == NULL || is_lost(run)) return solve_sensitivities(run, t);
    status = model->algebraic_sensitivity(t, run->full, s, run->u, run->p, run->k, run->rates);
    for (j = 0; j < run->n_blocks - 1; ++j) {
        for (i = 0; i < N_ALGEBRAIC; ++i) unknowns[i] = run->rates[j * N_ALGEBRAIC + i];
        unknowns += N_STATES;
    }
    return status;
}
#endif

/* Finds rates where unknowns are solved for at each point. Where w holds some, they stay. */
int cotree_reduced_rate(cotree_run *run, cotree_real t, const cotree_real *w, cotree_real *dw)
{
#if COTREE_HAS_SENSITIVITIES
    const cotree_model *const model = run->model;
#endif
    const cotree_real *const rates = run->rates;
    const cotree_real goal = CLOSE_ENOUGH * run->rtol;
    const int is_rounding = !(goal > ROUNDING), n = N_RATES, lead = run->n_lead;
    int i, is_wide = 0;
    int status = cotree_begin_point(run, t, w);
    if (status == 0) {
        status = cotree_solve_unknowns(run, t, 0, is_rounding ? ROUNDING : goal,
                                       is_rounding ? run->atol : run->atol / run->rtol, &is_wide);
    }
#if COTREE_HAS_SENSITIVITIES
    if (status == 0 && run->n_blocks > 1) {
        is_wide = model->extended_augmented_rhs == NULL || is_lost(run);
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

/* Finds rates where unknowns are integrated. */
int cotree_extended_rate(cotree_run *run, cotree_real t, const cotree_real *w, cotree_real *dw)
{
    const cotree_model *const model = run->model;
    const int status = cotree_run_inputs(run, t);
    if (status != 0) return status;
#if COTREE_HAS_SENSITIVITIES
    if (run->n_blocks > 1) {
        return model->extended_augmented_rhs(t, w, w + N_STATES, run->u, run->p, run->k, dw);
    }
#endif
    return model->extended_rhs(t, w, run->u, run->p, run->k, dw);
}

/* Brings integrated unknowns back to where they solve their equations. */
int cotree_project_unknowns(cotree_run *run, cotree_real t, cotree_real *w)
{
    const cotree_real goal = COTREE_FMAX(ROUNDING, CLOSE_ENOUGH * run->rtol);
    cotree_real moved = COTREE_F(0.0);
    int i, is_wide, is_far, status = cotree_begin_point(run, t, w);
    if (status == 0)
        status = cotree_solve_unknowns(run, t, !run->is_solving, goal, run->atol, &is_wide);
    if (status != 0) return status;
    for (i = N_RATES; i < N_STATES; ++i) {
        const cotree_real found = run->full[i];
        moved +=
            COTREE_FABS(found - w[i]) / (run->rtol * COTREE_FABS(found) + run->atol + COTREE_MIN);
        w[i] = found;
    }
    is_far = moved > FAR * (cotree_real)N_ALGEBRAIC || COTREE_EPSILON * run->doubt > run->rtol;
    run->n_far += is_far ? 1 : run->n_far > 0 ? -1 : 0;
    if (run->n_far > MOST_FAR) run->is_solving = 1;
    return 0;
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
/* Subtracts f_z g_z^-1 g_x, column by column; the matrix of g_z is factorised. */
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
        (void)cotree_substitute(run, g, slope); /* - g_z^-1 g_x */
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
