/* cotree_run.c: right-hand side for integrators, with inputs, projection onto the constraints and
 * algebraic unknowns. */
#include "cotree_run_internal.h"

#include <string.h>

void *cotree_arena_alloc(cotree_arena *arena, size_t size, void *spare)
{
    void *const place = arena->base == NULL ? spare : arena->base + arena->used;
    /* The arena keeps the alignment of numbers and pointers. */
    const size_t unit = sizeof(void *) > sizeof(cotree_real) ? sizeof(void *) : sizeof(cotree_real);
    arena->used += (size + unit - 1) / unit * unit;
    return place;
}

cotree_real *cotree_arena_reals(cotree_arena *arena, int n)
{
    return (cotree_real *)cotree_arena_alloc(arena, (size_t)n * sizeof(cotree_real), NULL);
}

int *cotree_arena_ints(cotree_arena *arena, int n)
{
    return (int *)cotree_arena_alloc(arena, (size_t)n * sizeof(int), NULL);
}

void cotree_run_init(cotree_run *run, const cotree_model *model, const cotree_real *p,
                     const cotree_real *k, cotree_real *u, int has_sensitivities,
                     cotree_arena *arena)
{
#if COTREE_HAS_ALGEBRAIC
    const int m = model->n_algebraic;
#endif
#if COTREE_HAS_SENSITIVITIES
    const int n_reached = model->sensitivity_starts[model->n_sensitivities];
    int i;
#endif
    memset(run, 0, sizeof *run);
    run->model = model;
    run->p = p;
    run->k = k;
    run->u = u;
    run->atol = COTREE_F(1e-10);
    run->low = -COTREE_INFINITY;
    run->high = COTREE_INFINITY;
    run->n_blocks = has_sensitivities && model->n_states > 0 ? 1 + model->n_sensitivities : 1;
    run->n_rates = model->n_states - model->n_algebraic;
    run->n_lead = run->n_rates;
    run->n = run->n_rates;
    run->n_packed = model->n_states;
    run->n_full = model->n_states * run->n_blocks;
#if COTREE_HAS_SENSITIVITIES
    for (i = 0; has_sensitivities && i < n_reached; ++i) {
        run->n += model->sensitivity_rows[i] < run->n_rates;
        ++run->n_packed;
    }
#endif
    run->full = cotree_arena_reals(arena, run->n_full);
#if COTREE_HAS_ALGEBRAIC || COTREE_HAS_IMPLICIT || COTREE_HAS_CONSTRAINTS
    run->rates = cotree_arena_reals(arena, run->n_full + model->n_algebraic + 2);
    run->held = cotree_arena_reals(arena, run->n_full);
    run->step = cotree_arena_reals(arena, run->n_full);
#endif
#if COTREE_HAS_CONSTRAINTS
    run->is_held = 1;
    run->is_strict = 1;
    run->residual = cotree_arena_reals(arena, model->n_constraints);
#endif
#if COTREE_HAS_ALGEBRAIC || COTREE_HAS_IMPLICIT
    run->nonzeros = cotree_arena_reals(arena, model->n_nonzeros);
#endif
#if COTREE_HAS_ALGEBRAIC
    run->is_solving = 1;
    run->matrix =
        cotree_lu_of(m, m, m, cotree_arena_reals(arena, m * m), cotree_arena_ints(arena, m));
    run->newton = cotree_arena_reals(arena, 3 * m);
    run->found = cotree_arena_reals(arena, m * COTREE_RUN_REMEMBERED);
    run->times = cotree_arena_reals(arena, COTREE_RUN_REMEMBERED);
    run->branch = cotree_arena_reals(arena, 4 * m);
    run->branch_before = cotree_arena_reals(arena, m);
#endif
}

#if COTREE_HAS_ALGEBRAIC
void cotree_run_extend(cotree_run *run)
{
    run->is_extended = 1;
    run->is_solving = 0;
    run->n += N_STATES - run->n_lead;
    run->n_lead = N_STATES;
}
#endif

#if COTREE_HAS_INPUTS
static cotree_real read_table(const cotree_table_input *table, cotree_real t)
{
    const cotree_real *const at = table->t;
    int low = 0, high = table->length - 1;
    if (!(t > at[0])) return table->u[0];
    if (t >= at[high]) return table->u[high];
    while (high - low > 1) {
        const int middle = (low + high) / 2;
        if (t >= at[middle]) {
            low = middle;
        } else {
            high = middle;
        }
    }
    return table->u[low] +
           (table->u[high] - table->u[low]) * ((t - at[low]) / (at[high] - at[low]));
}
#endif

int cotree_run_inputs(cotree_run *run, cotree_real t)
{
#if COTREE_HAS_INPUTS
    int i, status = 0;
    if (run->model->n_inputs == 0) return 0;
    status = run->model->inputs_of_time(t, run->p, run->k, run->u);
    for (i = 0; i < run->n_replaced; ++i) {
        run->u[run->replaced[i].input] = read_table(run->replaced + i, t);
    }
    if (run->input_function == NULL || status != 0) return status;
    return run->input_function(t, run->u, run->input_context);
#else
    (void)run, (void)t;
    return 0;
#endif
}

#if COTREE_HAS_SENSITIVITIES
/* Copy the sensitivities of the first n states, without those that are identically zero. */
void cotree_pack(const cotree_run *run, int n, const cotree_real *s, cotree_real *packed)
{
    const int *const starts = run->model->sensitivity_starts;
    const int *const rows = run->model->sensitivity_rows;
    int i, j;
    for (j = 0; j < run->n_blocks - 1; ++j, s += N_STATES) {
        for (i = starts[j]; i < starts[j + 1]; ++i) {
            if (rows[i] < n) *packed++ = s[rows[i]];
        }
    }
}

/* Expand packed sensitivities of the first n states; other sensitivities become zero. */
static void unpack(const cotree_run *run, int n, const cotree_real *packed, cotree_real *s)
{
    const int *const starts = run->model->sensitivity_starts;
    const int *const rows = run->model->sensitivity_rows;
    int i, j;
    if (n == N_STATES && run->n_packed == run->n_full) {
        memcpy(s, packed, (size_t)(run->n_full - n) * sizeof(cotree_real));
        return;
    }
    for (j = 0; j < run->n_blocks - 1; ++j, s += N_STATES) {
        for (i = 0; i < N_STATES; ++i) s[i] = COTREE_F(0.0);
        for (i = starts[j]; i < starts[j + 1]; ++i) {
            if (rows[i] < n) s[rows[i]] = *packed++;
        }
    }
}
#endif

void cotree_run_pack(const cotree_run *run, const cotree_real *z, cotree_real *packed)
{
    int i;
    for (i = 0; i < N_STATES; ++i) packed[i] = z[i];
#if COTREE_HAS_SENSITIVITIES
    cotree_pack(run, N_STATES, z + N_STATES, packed + N_STATES);
#endif
}

void cotree_run_unpack(const cotree_run *run, const cotree_real *packed, cotree_real *z)
{
    int i;
    for (i = 0; i < N_STATES; ++i) z[i] = packed[i];
#if COTREE_HAS_SENSITIVITIES
    unpack(run, N_STATES, packed + N_STATES, z + N_STATES);
#endif
}

void cotree_run_leave_out(const cotree_run *run, const cotree_real *z, cotree_real *w)
{
    int i;
    for (i = 0; i < run->n_lead; ++i) w[i] = z[i];
#if COTREE_HAS_SENSITIVITIES
    cotree_pack(run, N_RATES, z + N_STATES, w + run->n_lead);
#endif
}

/* Expand w to run->full. Algebraic unknowns that w lacks are taken from the last solution. */
static void expand(cotree_run *run, const cotree_real *w)
{
    const int lead = run->n_lead;
    cotree_real *const z = run->full;
    int i;
    for (i = 0; i < lead; ++i) z[i] = w[i];
#if COTREE_HAS_ALGEBRAIC
    if (lead == N_RATES && N_ALGEBRAIC > 0) {
        const int n = N_RATES, m = N_ALGEBRAIC;
        const cotree_real *const last = run->found + cotree_guess_place(run, COTREE_F(0.0), 0) * m;
        for (i = 0; i < m; ++i) z[n + i] = last[i];
    }
#endif
#if COTREE_HAS_SENSITIVITIES
    unpack(run, N_RATES, w + lead, z + N_STATES);
#endif
}

void cotree_run_narrow(cotree_run *run, cotree_real t, const cotree_real *z, cotree_real *w)
{
#if COTREE_HAS_ALGEBRAIC
    if (N_ALGEBRAIC > 0) cotree_store_guess(run, t, z);
#else
    (void)t;
#endif
    cotree_run_leave_out(run, z, w);
}

#if COTREE_HAS_ALGEBRAIC
/* Expand a point to run->full, project it, and compute the inputs at its time. */
int cotree_prepare_point(cotree_run *run, cotree_real t, const cotree_real *w)
{
    expand(run, w);
#if COTREE_HAS_CONSTRAINTS
    if (cotree_run_is_constrained(run)) {
        const cotree_real *const point = cotree_run_held(run, t, run->full);
        int i;
        for (i = 0; i < run->n_full; ++i) run->full[i] = point[i];
    }
#endif
    return cotree_run_inputs(run, t);
}
#endif

int cotree_run_complete(cotree_run *run, cotree_real t, const cotree_real *w)
{
#if COTREE_HAS_ALGEBRAIC
    int is_wide, status;
    if (N_ALGEBRAIC == 0) {
        expand(run, w);
        return 0;
    }
    status = cotree_prepare_point(run, t, w);
    if (status == 0)
        status = cotree_solve_unknowns(run, t, !run->is_solving, ROUNDING, run->atol, &is_wide);
#if COTREE_HAS_SENSITIVITIES
    if (status == 0 && run->n_blocks > 1) {
        status = cotree_solve_unknown_sensitivities(run, t, w + run->n_lead);
    }
#endif
    return status;
#else
    (void)t;
    expand(run, w);
    return 0;
#endif
}

#if COTREE_HAS_ALGEBRAIC
void cotree_run_keep(cotree_run *run, int n, const cotree_real *w)
{
    int i;
    if (n != run->n) {
        cotree_run_unpack(run, w, run->full);
        return;
    }
    expand(run, w);
    for (i = 0; i < N_ALGEBRAIC; ++i) run->full[N_RATES + i] = run->branch[i];
#if COTREE_HAS_SENSITIVITIES
    if (run->n_blocks > 1 && cotree_run_inputs(run, run->t_branch) == 0)
        (void)cotree_solve_unknown_sensitivities(run, run->t_branch, w + run->n_lead);
#endif
}
#endif

#if COTREE_HAS_HELPER && COTREE_HAS_ALGEBRAIC
int cotree_run_find(cotree_run *run, cotree_real t, const cotree_real *w)
{
    const cotree_helper *const helper = run->helper;
    int status = cotree_run_complete(run, t, w);
    if (status <= 0 || N_ALGEBRAIC == 0 || helper == NULL) return status;
    status = cotree_prepare_point(run, t, w);
    if (status == 0) status = helper->find_unknowns(t, run->full, helper->context);
    if (status != 0) return status;
    cotree_store_guess(run, t, run->full);
#if COTREE_HAS_SENSITIVITIES
    if (run->n_blocks > 1) {
        status = cotree_solve_unknown_sensitivities(run, t, w + run->n_lead);
    }
#endif
    return status;
}
#endif

#if COTREE_HAS_ALGEBRAIC || COTREE_HAS_EVENTS
int cotree_run_find_states(cotree_run *run, cotree_real t, const cotree_real *w)
{
    const int n_blocks = run->n_blocks, n_full = run->n_full;
    int status;
    run->n_blocks = 1;
    run->n_full = N_STATES;
    status = cotree_run_find(run, t, w);
    run->n_blocks = n_blocks;
    run->n_full = n_full;
    return status;
}
#endif

cotree_real cotree_run_margin(cotree_real start, cotree_real end, cotree_real scale)
{
    const cotree_real size = COTREE_FMAX(COTREE_FMAX(COTREE_FABS(start), COTREE_FABS(end)), scale);
    return COTREE_FMIN(COTREE_F(8.0) * COTREE_EPSILON * size,
                       COTREE_F(0.25) * COTREE_FABS(end - start));
}

void cotree_run_restrict(cotree_run *run, cotree_real start, cotree_real end, cotree_real scale,
                         int is_start_open, int is_end_open)
{
    const cotree_real margin = cotree_run_margin(start, end, scale);
    const cotree_real inwards = end > start ? margin : -margin;
    const cotree_real first = is_start_open ? start : start + inwards;
    const cotree_real last = is_end_open ? end : end - inwards;
    run->low = COTREE_FMIN(first, last);
    run->high = COTREE_FMAX(first, last);
}

cotree_real cotree_run_inside(const cotree_run *run, cotree_real t)
{
    return t < run->low ? run->low : t > run->high ? run->high : t;
}

#if COTREE_HAS_ALGEBRAIC
int cotree_run_follow(cotree_run *run, cotree_real t, const cotree_real *x, const cotree_real *g,
                      cotree_real *rates)
{
    int status = cotree_run_inputs(run, t);
    if (status == 0) status = cotree_linearise(run, t, x);
    return status != 0 ? status : cotree_solve_linearised(run, g, rates);
}
#endif

/* Compute the rates with one of two kernels. Inline, because it is short and called very often. */
static inline int rate_by(cotree_run *run, cotree_state_kernel of_states,
                          cotree_sensitivity_kernel of_all, cotree_real t, const cotree_real *z,
                          cotree_real *dz)
{
    const int status = cotree_run_inputs(run, t);
    if (status != 0) return status;
#if COTREE_HAS_SENSITIVITIES
    if (run->n_blocks > 1) return of_all(t, z, z + N_STATES, run->u, run->p, run->k, dz);
#else
    (void)of_all;
#endif
    return of_states(t, z, run->u, run->p, run->k, dz);
}

#if COTREE_HAS_IMPLICIT || COTREE_HAS_EVENTS
int cotree_run_packed_rate(cotree_run *run, cotree_real t, const cotree_real *z, cotree_real *dz)
{
    return rate_by(run, run->model->rhs, run->model->augmented_rhs, t, z, dz);
}
#endif

int cotree_run_rate(cotree_real t, const cotree_real *w, cotree_real *dw, void *context)
{
    cotree_run *const run = (cotree_run *)context;
    const cotree_model *const model = run->model;
    t = cotree_run_inside(run, t);
#if COTREE_HAS_ALGEBRAIC
    /* Integrated unknowns have rates. */
    if (!run->is_solving)
        return rate_by(run, model->extended_rhs, model->extended_augmented_rhs, t, w, dw);
    if (N_ALGEBRAIC > 0) return cotree_reduced_rate(run, t, w, dw);
#endif
#if COTREE_HAS_CONSTRAINTS
    if (cotree_are_rates_projected(run)) {
        expand(run, w);
        cotree_run_leave_out(run, cotree_run_held(run, t, run->full), run->step);
        w = run->step;
    }
#endif
    return rate_by(run, model->rhs, model->augmented_rhs, t, w, dw);
}

#if COTREE_HAS_CONSTRAINTS || COTREE_HAS_ALGEBRAIC
void cotree_run_rejected(void *context)
{
    cotree_run *const run = (cotree_run *)context;
#if COTREE_HAS_CONSTRAINTS
    cotree_count_failure(run);
#endif
#if COTREE_HAS_ALGEBRAIC
    if (N_ALGEBRAIC > 0) cotree_forget_far_guesses(run);
#endif
}

int cotree_run_is_projected(const cotree_run *run)
{
#if COTREE_HAS_ALGEBRAIC
    if (run->is_extended) return 1;
#endif
#if COTREE_HAS_CONSTRAINTS
    return cotree_run_is_constrained(run);
#else
    return 0;
#endif
}

int cotree_run_project(cotree_real t, cotree_real *w, void *context)
{
    cotree_run *const run = (cotree_run *)context;
    int status = 0;
#if COTREE_HAS_ALGEBRAIC
    if (run->is_extended) return cotree_project_unknowns(run, cotree_run_inside(run, t), w);
#endif
#if COTREE_HAS_CONSTRAINTS
    run->n_failed = 0;
    if (run->n_strict > 0) --run->n_strict;
    expand(run, w);
    status = cotree_run_project_all(run, t, run->full);
    if (status == 0) cotree_run_leave_out(run, run->full, w);
#endif
    return status;
}
#endif
