/* cotree_start.c: initial values, the constraints, algebraic unknowns, modes of jumps.
 * Part of the runtime of cotree, the same for every model.
 */
#include "cotree_start.h"

#if COTREE_HAS_ALGEBRAIC
#include "cotree_dense.h"
#endif
#include "cotree_event_kinds.h"

#include <math.h>
#include <stddef.h>
#include <stdlib.h>
#include <string.h>

/* Redundant values agree to a share of the states that they follow from, or to rounding. */
#define AGREED COTREE_SELECT(1e-8, 3.5e-04f)
#define ROUNDED COTREE_SELECT(1e-12, 1e-05f)

#if COTREE_HAS_ALGEBRAIC
/* Contents are found to this share of the terms of their equations, unknowns if they change by less
 * than this share of themselves. */
#define SETTLED COTREE_SELECT(1e-12, 1e-05f)

/* Speeds below this share of the largest state (or of 1) are zero. */
#define STILL COTREE_SELECT(1e-6, 2.8e-03f)

/* The least rounding of pivots, in units in the last place of the largest entry. */
#define PIVOT_ROUNDING 10
#endif

#if COTREE_HAS_EVENTS
/* Rates are the same on both sides of a jump if they differ by at most this share. */
#define SAME_RATE COTREE_SELECT(1e-12, 1e-05f)
#endif

#if COTREE_HAS_ALGEBRAIC || COTREE_HAS_EVENTS
/* Limits of the iterations over contents and unknowns, and, for each event, over modes. */
#define MOST_ROUNDS 50
#endif

/* The step of finite differences as a share of a parameter, at least of LEAST_SIZE: truncation, of
 * the fourth order, is then as small as rounding. */
#define SHARE COTREE_SELECT(1e-3, 5e-02f)
#define LEAST_SIZE COTREE_F(1e-3)

#define MODEL (start->run->model)
#define N_STATES (start->run->model->n_states)
#define N_RATES (start->run->n_rates)
#define N_SENSITIVITIES (start->run->n_blocks - 1)

void cotree_start_init(cotree_start *start, cotree_run *run, const cotree_start_tables *tables,
                       cotree_arena *arena)
{
    const cotree_model *const model = run->model;
    const cotree_hybrid *const h = model->hybrid;
    const int m = run->n_blocks - 1;
    start->run = run;
    start->tables = tables;
    start->guess = NULL;
    start->is_found = NULL;
    start->event_values = NULL;
    start->n_set = 0;
    start->culprit = start->column = -1;
    start->is_chosen = 0;
    start->is_set = cotree_arena_ints(arena, model->n_states);
    start->given = cotree_arena_reals(arena, model->n_states);
    start->w = cotree_arena_reals(arena, run->n_full);
    if (tables->n_contents > 0) {
        start->is_found = cotree_arena_ints(arena, tables->n_contents);
        start->rates = cotree_arena_reals(arena, run->n_full);
        start->given_slopes = cotree_arena_reals(arena, run->n_full);
    }
#if COTREE_HAS_ALGEBRAIC
    start->matrix = cotree_arena_reals(arena, model->n_algebraic * model->n_algebraic);
    start->pivots = cotree_arena_ints(arena, 2 * model->n_algebraic);
#endif
    if (tables->assembly != NULL) {
        cotree_assembly_init(&start->assembly, run, tables->assembly, arena);
    }
    if (tables->assembly != NULL && m > 0) {
        start->moved = cotree_arena_reals(arena, 2 * model->n_states);
        start->moved_p = cotree_arena_reals(arena, model->n_parameters);
        start->moved_k = cotree_arena_reals(arena, model->n_prepared);
    }
    if (h != NULL) {
        start->event_values =
            cotree_arena_reals(arena, h->n_events + h->n_branches + h->n_quantities);
        start->new_values = cotree_arena_reals(arena, h->n_jumps);
        start->sides = cotree_arena_reals(arena, 3 * model->n_states);
        start->event_slopes = cotree_arena_reals(arena, m * (h->n_events + h->n_jumps));
    }
}

/* Initial values. */

/* Write the initial values that are given, and guesses of the others. */
static int write_states(const cotree_start *start, cotree_real *z)
{
    const cotree_run *const run = start->run;
    const cotree_hybrid *const h = MODEL->hybrid;
    const int status = MODEL->initial(run->p, run->k, z);
    int i;
    if (start->guess != NULL) {
        for (i = N_RATES; i < N_STATES; ++i) z[i] = start->guess[i];
        for (i = 0; h != NULL && i < h->n_events; ++i) {
            const cotree_event *const row = h->events + i;
            if (row->kind > COTREE_JUMP && row->n_targets > 0)
                z[row->targets[0]] = start->guess[row->targets[0]];
        }
    }
    for (i = 0; i < start->n_set && status == 0; ++i) z[start->set[i]] = start->values[i];
    return status;
}

/* Write their sensitivities. A value that is set depends on itself only. */
static int write_sensitivities(const cotree_start *start, cotree_real *s)
{
    const cotree_run *const run = start->run;
    int i, j, status = 0;
    if (N_STATES > 0) status = MODEL->initial_sensitivity(run->p, run->k, s);
    for (i = 0; i < start->n_set && status == 0; ++i) {
        const int state = start->set[i];
        for (j = 0; j < N_SENSITIVITIES; ++j) {
            const int is_own = start->tables->seeds[j] == -1 - state;
            s[j * N_STATES + state] = is_own ? COTREE_F(1.0) : COTREE_F(0.0);
        }
    }
    return status;
}

/* The constraints. */

/* Mark the states that are prescribed: those that are given or set, and those that sensitivities
 * are taken to. */
static void mark_kept(cotree_start *start)
{
    int i;
    for (i = 0; i < N_STATES; ++i) start->is_set[i] = 0;
    for (i = 0; i < start->n_set; ++i) start->is_set[start->set[i]] = 1;
    if (start->tables->assembly == NULL) return;
    for (i = 0; i < N_STATES; ++i)
        start->assembly.is_kept[i] = start->tables->given[i] || start->is_set[i];
    for (i = 0; i < N_SENSITIVITIES; ++i) {
        const int seed = start->tables->seeds[i];
        if (seed < 0) start->assembly.is_kept[-1 - seed] = 1;
    }
    cotree_assembly_hold(&start->assembly, start->is_set);
}

/* Project states onto the constraints, which depend on the model's own inputs only. */
static int assemble(cotree_start *start, cotree_real t, cotree_real *z)
{
    cotree_assembly *const a = &start->assembly;
    const cotree_run *const run = start->run;
    int status = 0;
    a->culprit = a->column = -1;
    if (MODEL->n_inputs > 0) status = MODEL->inputs_of_time(t, run->p, run->k, run->u);
    if (status == 0) status = cotree_assembly_normalise(a, z);
    if (status == 0) status = cotree_assembly_measure(a, t, z);
    return status == 0 ? cotree_assembly_move(a, t, z) : status;
}

/* Compute the states on the constraints for another value of a parameter or state of sensitivity.
 */
static int assemble_aside(cotree_start *start, cotree_real t, int seed, cotree_real value,
                          cotree_real *x)
{
    cotree_run *const run = start->run;
    const cotree_real *const p = run->p, *const k = run->k;
    int i, status = 0;
    if (seed >= 0) {
        for (i = 0; i < MODEL->n_parameters; ++i) start->moved_p[i] = p[i];
        start->moved_p[seed] = value;
        status = MODEL->prepare(start->moved_p, start->moved_k);
        run->p = start->moved_p;
        run->k = start->moved_k;
    }
    if (status == 0) status = write_states(start, x);
    if (seed < 0) x[-1 - seed] = value;
    if (status == 0) status = assemble(start, t, x);
    run->p = p;
    run->k = k;
    return status;
}

/* Differentiate a projection that is one of several, by differences of five points: it depends on
 * the parameters through gradients, whose derivatives no kernel has. */
static int take_differences(cotree_start *start, cotree_real t, cotree_real *z)
{
    static const cotree_real weights[] = {COTREE_F(1.0), -COTREE_F(8.0), COTREE_F(8.0),
                                          -COTREE_F(1.0)};
    static const int places[] = {-2, -1, 1, 2};
    const int *const starts = MODEL->sensitivity_starts, *const rows = MODEL->sensitivity_rows;
    cotree_real *const x = start->moved, *const total = x + N_STATES;
    int i, j, k, status = 0;
    for (j = 0; j < N_SENSITIVITIES && status == 0; ++j) {
        const int seed = start->tables->seeds[j];
        const cotree_real value = seed < 0 ? z[-1 - seed] : start->run->p[seed];
        const cotree_real least = seed < 0 ? COTREE_F(1.0) : LEAST_SIZE;
        const cotree_real step = SHARE * COTREE_FMAX(COTREE_FABS(value), least);
        cotree_real *const s = z + (1 + j) * N_STATES;
        for (i = 0; i < N_STATES; ++i) total[i] = s[i] = COTREE_F(0.0);
        for (k = 0; k < 4 && status == 0; ++k) {
            status = assemble_aside(start, t, seed, value + (cotree_real)places[k] * step, x);
            for (i = 0; i < N_STATES; ++i) total[i] += weights[k] * x[i];
        }
        for (i = starts[j]; i < starts[j + 1]; ++i)
            s[rows[i]] = total[rows[i]] / (COTREE_F(12.0) * step);
    }
    return status;
}

static int satisfy_constraints(cotree_start *start, cotree_real t, cotree_real *z)
{
    cotree_assembly *const a = &start->assembly;
    int i, status;
    for (i = 0; i < N_STATES; ++i) start->given[i] = z[i];
    status = assemble(start, t, z);
    if (status == 0 && N_SENSITIVITIES > 0) {
        status = cotree_assembly_move_sensitivities(a, t, z, start->tables->seeds, z + N_STATES);
    }
    if (status == 0) status = cotree_assembly_normalise(a, start->given);
    if (status == 0) start->is_chosen = cotree_assembly_is_chosen(a, t, start->given, z);
    start->culprit = a->culprit;
    start->column = a->column;
    if (status == 0 && start->is_chosen && N_SENSITIVITIES > 0)
        status = take_differences(start, t, z);
    return status;
}

#if COTREE_HAS_ALGEBRAIC
/* Algebraic unknowns. */

/* Solve for the algebraic unknowns of z, in place, until nothing changes: a step from a guess far
 * away may look like the last one. */
static int complete_states(cotree_start *start, cotree_real t, cotree_real *z)
{
    cotree_run *const run = start->run;
    const int n_blocks = run->n_blocks, n_full = run->n_full;
    int i, n, is_changed = 1, status = 0;
    run->n_blocks = 1;
    run->n_full = N_STATES;
    for (n = 0; n < MOST_ROUNDS && is_changed && status == 0; ++n) {
        cotree_run_narrow(run, t, z, start->w);
        status = cotree_run_complete(run, t, start->w);
        is_changed = 0;
        for (i = N_RATES; i < N_STATES && status == 0; ++i) {
            const cotree_real size = COTREE_FABS(run->full[i]) + run->atol;
            if (!(COTREE_FABS(run->full[i] - z[i]) <= SETTLED * size)) is_changed = 1;
            z[i] = run->full[i];
        }
    }
    run->n_blocks = n_blocks;
    run->n_full = n_full;
    return status != 0 || is_changed ? COTREE_START_UNSOLVED : 0;
}

/* Solve for the algebraic unknowns of z and their sensitivities, in place; what z holds of the
 * former is the guess. */
static int solve(cotree_start *start, cotree_real t, cotree_real *z)
{
    cotree_run *const run = start->run;
    int i, status = complete_states(start, t, z);
    if (status != 0 || N_SENSITIVITIES == 0) return status;
    cotree_run_narrow(run, t, z, start->w);
    if (cotree_run_complete(run, t, start->w) != 0) return COTREE_START_UNSOLVED;
    for (i = N_STATES; i < run->n_full; ++i) z[i] = run->full[i];
    return 0;
}

/* Contents of storages. */

static int content_of(const cotree_start *start, int i) { return start->tables->contents[i]; }

static int unknown_of(const cotree_start *start, int i)
{
    return start->tables->contents[start->tables->n_contents + i];
}

/* Mark the contents that are found from a variable that follows from each: those that are not
 * given, and those in place of which the variable is set. Return how many there are. */
static int mark_found(cotree_start *start)
{
    int i, n = 0;
    for (i = 0; i < start->tables->n_contents; ++i) {
        const int content = content_of(start, i), unknown = unknown_of(start, i);
        start->is_found[i] =
            !start->is_set[content] && (start->is_set[unknown] || !start->tables->given[content]);
        n += start->is_found[i];
    }
    return n;
}

/* Return whether a content is found for sensitivity j; one to an initial value keeps that value. */
static int is_found_along(const cotree_start *start, int i, int j)
{
    const int seed = start->tables->seeds[j];
    if (seed == -1 - unknown_of(start, i)) return 1;
    return start->is_found[i] && seed != -1 - content_of(start, i);
}

/* Sum the absolute terms of an equation at x, whose row of the Jacobian this is. */
static cotree_real sum_of_terms(const cotree_start *start, int row, const cotree_real *x)
{
    const int *const starts = MODEL->column_starts, *const rows = MODEL->row_indices;
    cotree_real sum = COTREE_F(0.0);
    int i, j;
    for (j = 0; j < N_STATES; ++j) {
        for (i = starts[j]; i < starts[j + 1]; ++i) {
            if (rows[i] == row) sum += COTREE_FABS(start->run->nonzeros[i] * x[j]);
        }
    }
    return sum;
}

/* Solve the equations c(v) - q = 0 for the contents q, with v as in z. Return a status of kernels;
 * is_left is 1 if a content has changed. */
static int correct_contents(cotree_start *start, cotree_real t, cotree_real *z, int *is_left)
{
    const cotree_run *const run = start->run;
    int i, status = MODEL->rhs(t, z, run->u, run->p, run->k, start->rates);
    if (status == 0) status = MODEL->jacobian(t, z, run->u, run->p, run->k, run->nonzeros);
    *is_left = 0;
    for (i = 0; i < start->tables->n_contents && status == 0; ++i) {
        const int row = unknown_of(start, i);
        const cotree_real left = start->rates[row];
        if (!start->is_found[i]) continue;
        z[content_of(start, i)] += left;
        if (!(COTREE_FABS(left) <= SETTLED * sum_of_terms(start, row, z))) *is_left = 1;
    }
    return status;
}

/* Solve for the algebraic unknowns of z and for the contents that given ones determine, in place.
 * Rounds are repeated if a content depends on other unknowns, too. */
static int solve_contents(cotree_start *start, cotree_real t, cotree_real *z)
{
    int i, n, is_left = 1, status;
    for (i = 0; i < N_STATES; ++i) start->given[i] = z[i];
    status = correct_contents(start, t, z, &is_left);
    is_left = 1;
    for (n = 0; n < MOST_ROUNDS && is_left && status == 0; ++n) {
        status = complete_states(start, t, z);
        if (status != 0) return status;
        for (i = 0; i < start->tables->n_contents; ++i) {
            if (start->is_found[i]) z[unknown_of(start, i)] = start->given[unknown_of(start, i)];
        }
        status = correct_contents(start, t, z, &is_left);
    }
    return status == 0 && is_left ? COTREE_START_UNSOLVED : status;
}

/* Solve for the sensitivities of the same. */
static int solve_content_sensitivities(cotree_start *start, cotree_real t, cotree_real *z)
{
    cotree_run *const run = start->run;
    const int n_contents = start->tables->n_contents;
    cotree_real *const given = start->given_slopes; /* those of the unknowns, column by column */
    int i, j, n, is_left = 1, status = 0;
    for (j = 0; j < N_SENSITIVITIES; ++j) {
        cotree_real *const s = z + (1 + j) * N_STATES;
        for (i = 0; i < n_contents; ++i) {
            given[j * n_contents + i] = s[unknown_of(start, i)];
            if (is_found_along(start, i, j)) s[content_of(start, i)] = COTREE_F(0.0);
        }
    }
    for (n = 0; n < MOST_ROUNDS && is_left && status == 0; ++n) {
        is_left = 0;
        cotree_run_narrow(run, t, z, start->w);
        if (cotree_run_complete(run, t, start->w) != 0) return COTREE_START_UNSOLVED;
        for (j = 0; j < N_SENSITIVITIES; ++j) {
            cotree_real *const s = z + (1 + j) * N_STATES;
            for (i = N_RATES; i < N_STATES; ++i) s[i] = run->full[(1 + j) * N_STATES + i];
            for (i = 0; i < n_contents; ++i) {
                if (is_found_along(start, i, j))
                    s[unknown_of(start, i)] = given[j * n_contents + i];
            }
        }
        cotree_run_pack(run, z, start->w);
        status =
            MODEL->augmented_rhs(t, z, start->w + N_STATES, run->u, run->p, run->k, start->rates);
        if (status != 0) break;
        cotree_run_unpack(run, start->rates, run->full);
        for (j = 0; j < N_SENSITIVITIES; ++j) {
            cotree_real *const s = z + (1 + j) * N_STATES;
            for (i = 0; i < n_contents; ++i) {
                const cotree_real left = run->full[(1 + j) * N_STATES + unknown_of(start, i)];
                if (!is_found_along(start, i, j)) continue;
                s[content_of(start, i)] += left;
                if (!(COTREE_FABS(left) <=
                      SETTLED * COTREE_FABS(s[content_of(start, i)]) + COTREE_MIN))
                    is_left = 1;
            }
        }
    }
    return status == 0 && is_left ? COTREE_START_UNSOLVED : status;
}

/* Solve for algebraic unknowns, contents and their sensitivities. */
static int solve_all(cotree_start *start, cotree_real t, cotree_real *z)
{
    int status;
    if (start->tables->n_contents == 0) return solve(start, t, z);
    if (mark_found(start) == 0 && N_SENSITIVITIES == 0) return solve(start, t, z);
    status = solve_contents(start, t, z);
    if (status != 0 || N_SENSITIVITIES == 0) return status;
    return solve_content_sensitivities(start, t, z);
}

/* Return whether the matrix g_z at x, with rows and columns scaled, has full rank. */
static int is_regular(cotree_start *start, cotree_real t, const cotree_real *x)
{
    const cotree_run *const run = start->run;
    const int *const starts = MODEL->column_starts, *const rows = MODEL->row_indices;
    const int n = MODEL->n_algebraic, n_rounding = n > PIVOT_ROUNDING ? n : PIVOT_ROUNDING;
    cotree_real *const a = start->matrix;
    int i, j, k;
    if (MODEL->jacobian(t, x, run->u, run->p, run->k, run->nonzeros) != 0) return 0;
    for (i = 0; i < n * n; ++i) a[i] = COTREE_F(0.0);
    for (j = 0; j < n; ++j) {
        for (i = starts[N_RATES + j]; i < starts[N_RATES + j + 1]; ++i) {
            if (!(COTREE_FABS(run->nonzeros[i]) <= COTREE_MAX)) return 1; /* the rank is unknown */
            if (rows[i] >= N_RATES) a[(rows[i] - N_RATES) * n + j] = run->nonzeros[i];
        }
    }
    for (k = 0; k < 6; ++k) { /* rows and columns, three times */
        const int along = k % 2 == 0 ? 1 : n, across = k % 2 == 0 ? n : 1;
        for (i = 0; i < n; ++i) {
            cotree_real size = COTREE_F(0.0);
            for (j = 0; j < n; ++j)
                size = COTREE_FMAX(size, COTREE_FABS(a[i * across + j * along]));
            for (j = 0; j < n && size > COTREE_F(0.0); ++j) a[i * across + j * along] /= size;
        }
    }
    return cotree_factorise(n, COTREE_F(0.0), (cotree_real)n_rounding * COTREE_EPSILON, a,
                            start->pivots, start->pivots + n) == n;
}

/* Return whether the equations determine the unknowns: at z, or near it. Junctions that hardly
 * conduct may leave a singular matrix at z alone. */
static int is_determined(cotree_start *start, cotree_real t, const cotree_real *z)
{
    cotree_real *const x = start->w;
    int i, k;
    for (k = 0; k < 3; ++k) {
        const cotree_real away = k == 0 ? COTREE_F(0.0) : k == 1 ? COTREE_F(1.0) : -COTREE_F(1.0);
        for (i = 0; i < N_STATES; ++i) x[i] = z[i];
        for (i = N_RATES; i < N_STATES; ++i)
            x[i] += away * COTREE_FABS(cotree_pseudo_random(i)) *
                    COTREE_FMAX(COTREE_F(1.0), COTREE_FABS(z[i]));
        if (is_regular(start, t, x)) return 1;
    }
    return 0;
}

/* Modes of dry friction on which algebraic unknowns depend. */

/* Set the modes of friction that is disengaged, or moves in contradiction to its mode. */
static int choose_friction_modes(cotree_start *start, cotree_real t, cotree_real *z)
{
    const cotree_hybrid *const h = MODEL->hybrid;
    const cotree_run *const run = start->run;
    const cotree_real *const values = start->event_values;
    cotree_real *const x = start->w, size = COTREE_F(1.0);
    int i, status;
    for (i = 0; i < N_STATES; ++i) {
        x[i] = z[i];
        size = COTREE_FMAX(size, COTREE_FABS(z[i]));
    }
    for (i = 0; i < h->n_events; ++i) {
        /* The event function is the speed times the mode. */
        if (h->events[i].kind == COTREE_FRICTION_SLIP) x[h->events[i].targets[0]] = COTREE_F(1.0);
    }
    status = MODEL->events(t, z, run->u, run->p, run->k, start->event_values);
    for (i = 0; i < h->n_events && status == 0; ++i) {
        if (h->events[i].kind == COTREE_FRICTION_ENGAGED && values[i] <= COTREE_F(0.0))
            x[h->events[i].targets[0]] = COTREE_FRICTION_FREE;
    }
    if (status == 0) status = MODEL->events(t, x, run->u, run->p, run->k, start->event_values);
    for (i = 0; i < h->n_events && status == 0; ++i) {
        const int mode = h->events[i].targets[0];
        if (h->events[i].kind != COTREE_FRICTION_SLIP || start->is_set[mode]) continue;
        if (x[mode] == COTREE_FRICTION_FREE) {
            z[mode] = COTREE_FRICTION_FREE;
        } else if (COTREE_FABS(values[i]) > STILL * size) {
            z[mode] = values[i] > COTREE_F(0.0) ? COTREE_F(1.0) : -COTREE_F(1.0);
        } else if (z[mode] == COTREE_FRICTION_FREE) {
            z[mode] = COTREE_FRICTION_STICKS;
        }
    }
    return status;
}

/* Let all friction that sticks slide forwards: sticking friction may be redundant. Return whether
 * there is any. */
static int release_friction(const cotree_start *start, cotree_real *z)
{
    const cotree_hybrid *const h = MODEL->hybrid;
    int i, n = 0;
    for (i = 0; i < h->n_events; ++i) {
        cotree_real *const mode = z + h->events[i].targets[0];
        if (h->events[i].kind != COTREE_FRICTION_SLIP || *mode != COTREE_FRICTION_STICKS) continue;
        *mode = COTREE_F(1.0);
        ++n;
    }
    return n > 0;
}

/* Solve with modes of friction. */
static int solve_with_friction(cotree_start *start, cotree_real t, cotree_real *z)
{
    const cotree_hybrid *const h = MODEL->hybrid;
    int i, is_rubbing = 0, status = 0;
    for (i = 0; h != NULL && i < h->n_events; ++i)
        is_rubbing = is_rubbing || h->events[i].kind == COTREE_FRICTION_SLIP;
    if (is_rubbing) status = choose_friction_modes(start, t, z);
    if (status == 0) status = solve_all(start, t, z);
    if (status == 0 && !is_determined(start, t, z)) status = COTREE_START_UNDETERMINED;
    if (status == 0 || !is_rubbing || !release_friction(start, z)) return status;
    return solve_all(start, t, z);
}

#endif
#if COTREE_HAS_EVENTS
/* Modes of jumps. */

static int is_jumping(const cotree_start *start)
{
    const cotree_hybrid *const h = MODEL->hybrid;
    int i, n = 0;
    for (i = 0; h != NULL && i < h->n_events; ++i) n += h->events[i].kind == COTREE_JUMP;
    return n;
}

/* Return a jump whose mode contradicts the sign of its event function, with the new mode; -1 if
 * there is none. */
static int find_wrong_mode(cotree_start *start, cotree_real t, const cotree_real *x,
                           cotree_real *mode, int *status)
{
    const cotree_hybrid *const h = MODEL->hybrid;
    const cotree_run *const run = start->run;
    int i, first = 0;
    *status = MODEL->events(t, x, run->u, run->p, run->k, start->event_values);
    if (*status == 0) *status = MODEL->jumps(t, x, run->u, run->p, run->k, start->new_values);
    for (i = 0; i < h->n_events && *status == 0; ++i) {
        const cotree_event *const row = h->events + i;
        const cotree_real side = (cotree_real)row->direction * start->event_values[i];
        if (row->kind == COTREE_JUMP && side > COTREE_F(0.0) &&
            x[row->targets[0]] != start->new_values[first]) {
            *mode = start->new_values[first];
            return i;
        }
        first += row->n_targets;
    }
    return -1;
}

static int choose_jump_modes(cotree_start *start, cotree_real t, cotree_real *z)
{
    const int most = MOST_ROUNDS * is_jumping(start);
    int n, status = 0;
    if (start->event_values == NULL) return 0;
    for (n = 0; n < most; ++n) {
        cotree_real mode = COTREE_F(0.0);
        const int event = find_wrong_mode(start, t, z, &mode, &status);
        if (status != 0 || event < 0) return status;
        z[MODEL->hybrid->events[event].targets[0]] = mode;
        start->culprit = event;
#if COTREE_HAS_ALGEBRAIC
        if (MODEL->n_algebraic > 0) status = solve_all(start, t, z);
#endif
        if (status != 0) return status;
    }
    return most > 0 ? COTREE_START_TURNED_BACK : 0;
}

/* Compute the rates at z with another value of a mode. */
static int rates_on_side(cotree_start *start, cotree_real t, const cotree_real *z, int mode,
                         cotree_real value, cotree_real *rates)
{
    const cotree_run *const run = start->run;
    cotree_real *const x = start->sides;
    int i, status = 0;
    for (i = 0; i < N_STATES; ++i) x[i] = z[i];
    x[mode] = value;
#if COTREE_HAS_ALGEBRAIC
    if (MODEL->n_algebraic > 0) status = complete_states(start, t, x);
#endif
    return status == 0 ? MODEL->rhs(t, x, run->u, run->p, run->k, rates) : status;
}

/* Return COTREE_START_ON_JUMP if the rates differ between the events of a mode: its sides. */
static int compare_sides(cotree_start *start, cotree_real t, const cotree_real *z, int mode)
{
    const cotree_hybrid *const h = MODEL->hybrid;
    cotree_real *const one = start->sides + N_STATES, *const other = one + N_STATES;
    int first = 0, i, j, n_sides = 0, status = 0;
    for (i = 0; i < h->n_events && status == 0; ++i) {
        const cotree_event *const row = h->events + i;
        if (row->n_targets == 1 && row->targets[0] == mode) {
            status = rates_on_side(start, t, z, mode, start->new_values[first],
                                   n_sides == 0 ? one : other);
            for (j = 0; j < N_STATES && n_sides > 0 && status == 0; ++j) {
                const cotree_real size = COTREE_FMAX(COTREE_FABS(one[j]), COTREE_FABS(other[j]));
                if (COTREE_FABS(one[j] - other[j]) > SAME_RATE * size)
                    status = COTREE_START_ON_JUMP;
            }
            ++n_sides;
        }
        first += row->n_targets;
    }
    return status;
}

/* Return COTREE_START_ON_JUMP if the rates jump at z, and a parameter moves the jump: then there
 * are no sensitivities. */
static int check_jumps(cotree_start *start, cotree_real t, const cotree_real *z)
{
    const cotree_hybrid *const h = MODEL->hybrid;
    const cotree_run *const run = start->run;
    const cotree_real *const values = start->event_values, *const slopes = start->event_slopes;
    int i, j, status;
    if (N_SENSITIVITIES == 0 || is_jumping(start) == 0 || values == NULL) return 0;
    status = MODEL->events(t, z, run->u, run->p, run->k, start->event_values);
    if (status == 0) status = MODEL->jumps(t, z, run->u, run->p, run->k, start->new_values);
    if (status == 0)
        status = MODEL->event_sensitivity(t, z, z + N_STATES, run->u, run->p, run->k,
                                          start->event_slopes);
    for (i = 0; i < h->n_events && status == 0; ++i) {
        int is_moved = 0;
        if (h->events[i].kind != COTREE_JUMP || values[i] != COTREE_F(0.0)) continue;
        for (j = 0; j < N_SENSITIVITIES; ++j) {
            /* A nan counts as a dependence. */
            if (!(slopes[j * (h->n_events + h->n_jumps) + i] == COTREE_F(0.0))) is_moved = 1;
        }
        start->culprit = i;
        if (is_moved) status = compare_sides(start, t, z, h->events[i].targets[0]);
    }
    return status;
}

#endif
/* Checks. */

/* Return whether a redundant value agrees with what follows from the states x, or their
 * sensitivities to a parameter of this size. */
static int is_agreed(const cotree_start *start, int row, const cotree_real *values,
                     const cotree_real *x, cotree_real parameter)
{
    const cotree_start_tables *const tables = start->tables;
    const cotree_real follows = parameter * values[row];
    const cotree_real given = parameter * values[tables->n_redundant + row];
    cotree_real size = COTREE_FMAX(COTREE_FABS(follows), COTREE_FABS(given));
    int i;
    for (i = tables->redundant_starts[row]; i < tables->redundant_starts[row + 1]; ++i) {
        const int state = tables->redundant_states[i];
        if (start->is_set[state]) return 1; /* what follows from it is free */
        size = COTREE_FMAX(size, COTREE_FABS(parameter * x[state]));
    }
    return COTREE_FABS(follows - given) <= AGREED * size + ROUNDED;
}

static int check_redundant(cotree_start *start, cotree_real t, const cotree_real *z)
{
    const cotree_start_tables *const tables = start->tables;
    const cotree_run *const run = start->run;
    const int n = tables->n_redundant;
    const cotree_real *values = start->assembly.conditions;
    int first, i, j, status;
    if (n == 0 || values == NULL) return 0;
    first = tables->assembly->n_start - 2 * n;
    status = MODEL->start(t, z, run->u, run->p, run->k, start->assembly.conditions);
    if (status == 0 && N_SENSITIVITIES > 0)
        status = MODEL->start_sensitivity(t, z, z + N_STATES, run->u, run->p, run->k,
                                          start->assembly.start_slopes);
    for (j = 0; j <= N_SENSITIVITIES && status == 0; ++j) {
        const int seed = j > 0 ? tables->seeds[j - 1] : -1;
        /* Zero: all agrees, since what is redundant follows a state's own initial value. */
        const cotree_real size = j == 0     ? COTREE_F(1.0)
                                 : seed < 0 ? COTREE_F(0.0)
                                            : COTREE_FMAX(COTREE_FABS(run->p[seed]), LEAST_SIZE);
        if (j > 0) values = start->assembly.start_slopes + (j - 1) * tables->assembly->n_start;
        for (i = 0; i < n && status == 0; ++i) {
            if (is_agreed(start, i, values + first, z + j * N_STATES, size)) continue;
            start->culprit = i;
            status = COTREE_START_CONTRADICTED;
        }
    }
    return status;
}

static int check_finite(cotree_start *start, const cotree_real *z)
{
    int i;
    for (i = 0; i < start->run->n_full; ++i) {
        if (COTREE_FABS(z[i]) <= COTREE_MAX) continue;
        start->culprit = i % N_STATES;
        return COTREE_START_UNDEFINED;
    }
    return 0;
}

int cotree_start_find(cotree_start *start, cotree_real t, cotree_real *z)
{
    cotree_run *const run = start->run;
    int status;
    start->culprit = start->column = -1;
    start->is_chosen = 0;
    mark_kept(start);
    status = write_states(start, z);
    if (status == 0 && N_SENSITIVITIES > 0) status = write_sensitivities(start, z + N_STATES);
    if (status == 0 && start->tables->assembly != NULL) status = satisfy_constraints(start, t, z);
    if (status == 0) status = cotree_run_inputs(run, t);
#if COTREE_HAS_ALGEBRAIC
    if (status == 0 && MODEL->n_algebraic > 0) status = solve_with_friction(start, t, z);
#endif
#if COTREE_HAS_EVENTS
    if (status == 0) status = choose_jump_modes(start, t, z);
    if (status == 0) status = check_jumps(start, t, z);
#endif
    if (status == 0) status = check_redundant(start, t, z);
    return status == 0 ? check_finite(start, z) : status;
}

/* Initialise a run and a start for a call. */
static void set_up(const cotree_start_call *call, cotree_run *run, cotree_start *start,
                   cotree_arena *arena)
{
    cotree_real *const u = cotree_arena_reals(arena, call->model->n_inputs + 1);
    cotree_run_init(run, call->model, call->p, call->k, u, call->has_sensitivities, arena);
    cotree_start_init(start, run, call->tables, arena);
#if COTREE_HAS_INPUTS
    run->n_replaced = call->n_replaced;
    run->replaced = call->replaced;
#endif
    start->guess = call->guess;
    start->n_set = call->n_set;
    start->set = call->set;
    start->values = call->values;
}

/* Return whether initial values have no equations to satisfy. */
static int is_plain(const cotree_start *start)
{
    return start->tables->assembly == NULL && MODEL->n_algebraic == 0 && MODEL->hybrid == NULL;
}

int cotree_start_once(cotree_start_call *call)
{
    cotree_run run;
    cotree_start start;
    cotree_arena arena = {NULL, 0};
    int status;
    memset(&run, 0, sizeof run);
    memset(&start, 0, sizeof start);
    set_up(call, &run, &start, &arena);
    if (is_plain(&start)) {
        status = write_states(&start, call->z);
        if (status == 0 && call->has_sensitivities)
            status = write_sensitivities(&start, call->z + call->model->n_states);
        return status == 0 ? check_finite(&start, call->z) : status;
    }
    arena.base = (char *)calloc(1, arena.used);
    if (arena.base == NULL) return COTREE_START_NO_MEMORY;
    arena.used = 0;
    set_up(call, &run, &start, &arena);
    status = cotree_start_find(&start, call->t, call->z);
    call->culprit = cotree_start_culprit(&start, status);
    call->is_chosen = start.is_chosen;
    call->is_dependent = status == 0 && call->tables->assembly != NULL &&
                         cotree_assembly_is_dependent(&start.assembly, call->t, call->z);
    free(arena.base);
    return status;
}

const char *cotree_start_message(int status)
{
    switch (status) {
    case COTREE_START_VIOLATED:
        return "the initial values violate the constraints, and what is given leaves no way to "
               "mend "
               "that";
    case COTREE_START_STUCK:
        return "no motion follows a parameter of sensitivity to first order, where given values "
               "stay";
    case COTREE_START_CONTRADICTED:
        return "initial values contradict each other";
    case COTREE_START_UNSOLVED:
        return "the algebraic equations have no solution near the guess";
    case COTREE_START_UNDETERMINED:
        return "the algebraic equations do not determine all unknowns";
    case COTREE_START_TURNED_BACK:
        return "a jump turns back what it looks at";
    case COTREE_START_NO_MEMORY:
        return "there is no memory";
    case COTREE_START_ON_JUMP:
        return "the start lies on a jump that a parameter moves: there are no sensitivities";
    case COTREE_START_UNDEFINED:
        return "an initial value is not finite";
    default:
        return "a linear system is singular at the initial values";
    }
}

const char *cotree_start_culprit(const cotree_start *start, int status)
{
    const int i = start->culprit;
    if (i < 0) return "";
    switch (status) {
    case COTREE_START_VIOLATED:
    case COTREE_START_STUCK:
        return start->tables->assembly->rows == NULL ? "" : start->tables->assembly->rows[i].name;
    case COTREE_START_CONTRADICTED:
        return start->tables->redundant[i].name;
    case COTREE_START_TURNED_BACK:
    case COTREE_START_ON_JUMP:
        return MODEL->hybrid->events[i].name;
    case COTREE_START_UNDEFINED:
        return MODEL->states[i].name;
    default:
        return "";
    }
}
