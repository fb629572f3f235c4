/* cotree_stiff.c: the linear systems (shift M - J) x = b of implicit methods. */
#include "cotree_stiff.h"

typedef cotree_stiff cotree_systems;
#include "cotree_systems.h"

#define N_STATES (stiff->run->model->n_states)
#define N_ALGEBRAIC (stiff->run->model->n_algebraic)
#define N_RATES (stiff->run->n_rates)
#define MODEL (stiff->run->model)

/* List the indices of algebraic unknowns and of their sensitivities. */
static void list_algebraic(cotree_stiff *stiff)
{
    const int *const rows = MODEL->sensitivity_rows;
    int i, n = 0;
    for (i = 0; i < stiff->run->n_packed && N_ALGEBRAIC > 0; ++i) {
        if ((i < N_STATES ? i : rows[i - N_STATES]) >= N_RATES) stiff->algebraic[n++] = i;
    }
    stiff->n_algebraic = n;
}

static int rate(cotree_real t, const cotree_real *z, cotree_real *dz, void *context)
{
    cotree_run *const run = ((cotree_stiff *)context)->run;
    return cotree_run_packed_rate(run, cotree_run_inside(run, t), z, dz);
}

/* Return the number of sensitivities, of all states, that are not identically zero. */
static int n_reached(const cotree_model *model)
{
    return model->sensitivity_starts[model->n_sensitivities];
}

/* Compute the time derivatives of the rates. */
static int time_slope(cotree_real t, const cotree_real *z, cotree_real *dz, void *context)
{
    const cotree_stiff *const stiff = (const cotree_stiff *)context;
    cotree_run *const run = stiff->run;
    int i, status;
    if (stiff->newton->time_slope == NULL) {
        for (i = 0; i < run->n_packed; ++i) dz[i] = COTREE_F(0.0);
        return 0;
    }
    t = cotree_run_inside(run, t);
    status = cotree_run_inputs(run, t);
    if (status != 0) return status;
    if (stiff->zero_sensitivities == NULL) {
        return stiff->newton->time_slope(t, z, z + N_STATES, run->u, run->p, run->k, dz);
    }
    /* The kernel includes sensitivities: pass zeros, and discard its results for them. */
    status = stiff->newton->time_slope(t, z, stiff->zero_sensitivities, run->u, run->p, run->k,
                                       stiff->zero_sensitivities + n_reached(MODEL));
    for (i = 0; i < run->n_packed; ++i) dz[i] = stiff->zero_sensitivities[n_reached(MODEL) + i];
    return status;
}

static int evaluate_jacobian(cotree_stiff *stiff, cotree_real t, const cotree_real *z,
                             cotree_real *values)
{
    cotree_run *const run = stiff->run;
    const int status = cotree_run_inputs(run, t);
    if (status != 0) return status;
    return MODEL->jacobian(t, z, run->u, run->p, run->k, values);
}

/* Evaluate and store the derivatives at z that the linear systems contain. */
static int linearise(cotree_real t, const cotree_real *z, void *context)
{
    cotree_stiff *const stiff = (cotree_stiff *)context;
    cotree_run *const run = stiff->run;
    int status;
    t = cotree_run_inside(run, t);
    status = evaluate_jacobian(stiff, t, z, stiff->linear);
    if (status != 0 || run->n_blocks == 1 || stiff->newton->curvature == NULL) return status;
    return stiff->newton->curvature(t, z, z + N_STATES, run->u, run->p, run->k, stiff->carried);
}

/* Factorise the matrix with row exchanges. */
static int factorise_dense(cotree_stiff *stiff)
{
    const int n = N_STATES;
    int i;
    if (n > COTREE_STIFF_DENSE) return COTREE_SINGULAR;
    ++stiff->n_exchanged;
    stiff->is_dense = 1;
    cotree_lu_load(&stiff->dense, -COTREE_F(1.0), MODEL->column_starts, MODEL->row_indices,
                   stiff->values, 0, 0);
    for (i = 0; i < N_RATES; ++i) stiff->dense.first[i + i * n] += stiff->shift;
    return cotree_lu_factorise(&stiff->dense) == 0 ? 0 : COTREE_SINGULAR;
}

static int factorise_values(cotree_stiff *stiff, const cotree_real *values, cotree_real shift)
{
    stiff->values = values;
    stiff->shift = shift;
    stiff->is_dense = 0;
    stiff->is_checked = 0;
    if (stiff->newton->factorise == NULL) return COTREE_SINGULAR;
    stiff->newton->factorise(values, shift, stiff->factors);
    return 0;
}

/* Factorise with the stored derivatives; Newton's method may have factorised another matrix. */
static int factorise(cotree_real shift, void *context)
{
    cotree_stiff *const stiff = (cotree_stiff *)context;
    return factorise_values(stiff, stiff->linear, shift);
}

static inline void cotree_solve_blocks(const cotree_stiff *stiff, int n_blocks, cotree_real *x)
{
    if (!stiff->is_dense) {
        stiff->newton->solve(stiff->factors, n_blocks, x, stiff->work);
        return;
    }
    for (; n_blocks > 0; --n_blocks, x += N_STATES) cotree_lu_solve(&stiff->dense, x);
}

/* Solve for the states. Check the first solution with new factors; if it is inaccurate, factorise
 * with row exchanges. */
static int solve_states(cotree_stiff *stiff, cotree_real *x)
{
    const int is_known = stiff->is_dense || stiff->is_checked;
    int i, status;
    for (i = 0; i < N_STATES && !is_known; ++i) stiff->given[i] = x[i];
    cotree_solve_blocks(stiff, 1, x);
    if (is_known) return 0;
    stiff->is_checked = 1;
    if (cotree_is_solution(N_STATES, N_RATES, MODEL->column_starts, MODEL->row_indices,
                           stiff->values, stiff->shift, stiff->given, x, stiff->residual,
                           stiff->work)) {
        return 0;
    }
    status = factorise_dense(stiff);
    if (status != 0) return status;
    for (i = 0; i < N_STATES; ++i) x[i] = stiff->given[i];
    cotree_solve_blocks(stiff, 1, x);
    return 0;
}

/* Solve for all blocks. The solution of the states contributes to the right-hand sides of the
 * sensitivities. */
static int solve(cotree_real *u, void *context)
{
    cotree_stiff *const stiff = (cotree_stiff *)context;
    const cotree_newton *const newton = stiff->newton;
    cotree_real *const s = u + N_STATES;
    int i, status = solve_states(stiff, u);
    if (status != 0 || stiff->run->n_blocks == 1) return status;
    if (newton->curvature_along != NULL) {
        status = newton->curvature_along(u, stiff->carried, stiff->couplings);
        if (status != 0) return status;
        for (i = 0; i < newton->n_couplings; ++i) s[newton->places[i]] += stiff->couplings[i];
    }
    cotree_solve_sensitivities(stiff, N_STATES, stiff->run->n_blocks - 1, MODEL->sensitivity_starts,
                               MODEL->sensitivity_rows, s, stiff->residual);
    return 0;
}

#if COTREE_HAS_ALGEBRAIC
/* Error estimates are valid if the algebraic equations are nearly linear within the correction of a
 * step: it must be at most this fraction of the distance over which their slopes change. At 0.5 the
 * error of the diode bridge is twelve tolerances. */
#define LINEAR_SHARE COTREE_F(0.2)

/* Shift so large that the states do not change. */
#define FIXING_SHIFT COTREE_SELECT(1e150, 1.0e+19f)

/* Factorise for Newton's method on the algebraic unknowns, with the planned pivots. The shift keeps
 * the states constant. */
static int linearise_algebraic(cotree_real t, const cotree_real *x, void *context)
{
    cotree_stiff *const stiff = (cotree_stiff *)context;
    cotree_real *const values = stiff->run->nonzeros;
    const int status = evaluate_jacobian(stiff, t, x, values);
    return status != 0 ? status : factorise_values(stiff, values, FIXING_SHIFT);
}

/* Compute the changes of the algebraic unknowns that follow from the changes u of the other
 * entries, which the shift keeps constant. */
static int follow(cotree_real *u, void *context)
{
    cotree_stiff *const stiff = (cotree_stiff *)context;
    const int n = stiff->run->n_packed;
    int i, status = factorise(FIXING_SHIFT, stiff);
    for (i = 0; i < n; ++i) u[i] *= FIXING_SHIFT;
    for (i = 0; i < stiff->n_algebraic; ++i) u[stiff->algebraic[i]] = COTREE_F(0.0);
    return status != 0 ? status : solve(u, stiff);
}

/* Return whether the last correction of the algebraic unknowns left the range in which their
 * equations are nearly linear. */
static int is_bent(void *context)
{
    return !(((cotree_stiff *)context)->run->bend <= LINEAR_SHARE);
}

static int solve_algebraic(const cotree_real *g, cotree_real *step, void *context)
{
    cotree_stiff *const stiff = (cotree_stiff *)context;
    cotree_real *const x = stiff->right;
    int i, status;
    for (i = 0; i < N_STATES; ++i) x[i] = i < N_RATES ? COTREE_F(0.0) : g[i - N_RATES];
    status = solve_states(stiff, x);
    for (i = 0; i < N_ALGEBRAIC; ++i) step[i] = x[N_RATES + i];
    return status;
}
#endif

void cotree_stiff_init(cotree_stiff *stiff, cotree_run *run, const cotree_newton *newton,
                       cotree_arena *arena)
{
    const int n = run->model->n_states, n_dense = n <= COTREE_STIFF_DENSE ? n : 0;
    stiff->run = run;
    stiff->newton = newton;
    stiff->n_exchanged = 0;
    stiff->linear = cotree_arena_reals(arena, run->model->n_nonzeros);
    stiff->values = stiff->linear;
    stiff->carried = cotree_arena_reals(arena, newton->n_carried);
    stiff->couplings = cotree_arena_reals(arena, newton->n_couplings);
    stiff->factors = cotree_arena_reals(arena, newton->n_factors);
    stiff->work = cotree_arena_reals(arena, COTREE_NEWTON_BLOCKS * n);
    stiff->given = cotree_arena_reals(arena, n);
    stiff->residual = cotree_arena_reals(arena, n);
    stiff->right = cotree_arena_reals(arena, n);
    stiff->dense =
        cotree_lu_of(n_dense, n_dense, n_dense, cotree_arena_reals(arena, n_dense * n_dense),
                     cotree_arena_ints(arena, n_dense));
    stiff->zero_sensitivities = NULL;
    if (run->n_blocks == 1 && n_reached(run->model) > 0) {
        const int n_zeros = n_reached(run->model), n_all = 2 * n_zeros + n;
        int i;
        stiff->zero_sensitivities = cotree_arena_reals(arena, n_all);
        for (i = 0; arena->base != NULL && i < n_zeros; ++i)
            stiff->zero_sensitivities[i] = COTREE_F(0.0);
    }
    stiff->algebraic = cotree_arena_ints(arena, run->model->n_algebraic * run->n_blocks);
    if (stiff->algebraic != NULL) list_algebraic(stiff);
#if COTREE_HAS_ALGEBRAIC
    run->elimination.linearise = linearise_algebraic;
    run->elimination.solve = solve_algebraic;
    run->elimination.context = stiff;
#endif
}

cotree_implicit_equation cotree_stiff_equation(cotree_stiff *stiff)
{
#if COTREE_HAS_INPUTS
    const cotree_run *const run = stiff->run;
    /* Replaced inputs have unknown time derivatives. */
    const int is_replaced = run->n_replaced > 0 || run->input_function != NULL;
#else
    const int is_replaced = 0;
#endif
    cotree_implicit_equation equation;
    equation.n = stiff->run->n_packed;
    equation.n_algebraic = stiff->n_algebraic;
    equation.algebraic = stiff->algebraic;
    equation.is_autonomous = stiff->newton->is_autonomous;
    equation.rate = rate;
    equation.time_slope = is_replaced ? NULL : time_slope;
    equation.linearise = linearise;
    equation.factorise = factorise;
    equation.solve = solve;
#if COTREE_HAS_ALGEBRAIC
    equation.follow = follow;
    equation.is_bent = is_bent;
#else
    equation.follow = NULL;
    equation.is_bent = NULL;
#endif
    equation.context = stiff;
    return equation;
}

#if COTREE_HAS_CONSTRAINTS || COTREE_HAS_ALGEBRAIC
int cotree_stiff_is_projected(const cotree_stiff *stiff)
{
    return stiff->n_algebraic > 0 || cotree_run_is_projected(stiff->run);
}

int cotree_stiff_project(cotree_real t, cotree_real *z, void *context)
{
    cotree_run *const run = ((cotree_stiff *)context)->run;
    int status = 0;
    t = cotree_run_inside(run, t);
#if COTREE_HAS_CONSTRAINTS
    if (cotree_run_is_constrained(run)) status = cotree_run_project_packed(run, t, z);
#endif
#if COTREE_HAS_ALGEBRAIC
    if (status == 0 && run->model->n_algebraic > 0) status = cotree_run_solve_packed(run, t, z);
#endif
    return status;
}
#endif

int cotree_stiff_complete(cotree_stiff *stiff, cotree_real t, const cotree_real *z)
{
    cotree_run *const run = stiff->run;
    cotree_run_unpack(run, z, run->full);
    if (N_ALGEBRAIC == 0) return 0;
    /* Between steps, unknowns may be inaccurate. If Newton's method fails from them, it tries other
     * guesses. */
    cotree_run_narrow(run, t, run->full, run->step);
    return cotree_run_find(run, t, run->step);
}
