/* cotree_start_unknowns.c: algebraic unknowns and states of storage elements at the start. */
#include "cotree_start_internal.h"

#if COTREE_HAS_ALGEBRAIC
#include "cotree_dense.h"

/* Storage states have converged if their residuals are below this fraction of the terms of their
 * equations; unknowns, if they change by less than this fraction of their magnitude. */
#define SETTLED COTREE_SELECT(1e-12, 1e-05f)

/* A change of the unknowns below this value, but above half the previous one, is a rounding
 * error. */
#define STALLED COTREE_SELECT(1e-4, 2.3e-02f)

/* Bound on the rounding errors of pivots, in units in the last place of the largest entry. */
#define PIVOT_ROUNDING 10

/* Maximum number of iterations over storage states and unknowns. */
#define MOST_ROUNDS 50

/* Solve for the algebraic unknowns of z in place, repeatedly until they do not change: far from the
 * root, a single solution may pass the convergence test too early. */
int cotree_start_complete_states(cotree_start *start, cotree_real t, cotree_real *z)
{
    cotree_run *const run = start->run;
    cotree_real before = COTREE_INFINITY;
    int i, n, is_changed = 1;
    for (n = 0; n < MOST_ROUNDS && is_changed; ++n) {
        cotree_real change = COTREE_F(0.0);
        cotree_run_narrow(run, t, z, start->w);
        if (cotree_run_find_states(run, t, start->w) != 0) return COTREE_START_UNSOLVED;
        for (i = N_RATES; i < N_STATES; ++i) {
            const cotree_real size = COTREE_FABS(run->full[i]) + run->atol;
            change += COTREE_FABS(run->full[i] - z[i]) / size; /* also true for nan */
            z[i] = run->full[i];
        }
        is_changed = !(change <= SETTLED || (change < STALLED && change > COTREE_F(0.5) * before));
        before = change;
    }
    return is_changed ? COTREE_START_UNSOLVED : 0;
}

/* Solve for the algebraic unknowns of z and their sensitivities in place, starting from z. */
static int solve_unknowns(cotree_start *start, cotree_real t, cotree_real *z)
{
    const int status = cotree_start_complete_states(start, t, z);
#if COTREE_HAS_SENSITIVITIES
    cotree_run *const run = start->run;
    int i;
    if (status != 0 || N_SENSITIVITIES == 0) return status;
    cotree_run_narrow(run, t, z, start->w);
    if (cotree_run_find(run, t, start->w) != 0) return COTREE_START_UNSOLVED;
    for (i = N_STATES; i < run->n_full; ++i) z[i] = run->full[i];
#endif
    return status;
}

/* Storage states q = c(v). */

static int content_of(const cotree_start *start, int i) { return start->tables->contents[i]; }

static int unknown_of(const cotree_start *start, int i)
{
    return start->tables->contents[start->tables->n_contents + i];
}

/* Mark the storage states that are computed from their unknowns: those without an initial value,
 * and those whose unknown is set. Return their number. */
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

#if COTREE_HAS_SENSITIVITIES
/* Return whether sensitivity j of a storage state is computed. The sensitivity to its own initial
 * value is prescribed. */
static int is_found_along(const cotree_start *start, int i, int j)
{
    const int seed = start->tables->seeds[j];
    if (seed == -1 - unknown_of(start, i)) return 1;
    return start->is_found[i] && seed != -1 - content_of(start, i);
}
#endif

/* Return the sum of the absolute terms of an equation at x, from its row of the Jacobian. */
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

/* Set the storage states to q = c(v), with v from z. *is_left: 1 if one of them changed by more
 * than rounding. Return a kernel status. */
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

/* Solve for the algebraic unknowns of z and the storage states in turn, in place: a storage state
 * may depend on several unknowns. */
static int solve_contents(cotree_start *start, cotree_real t, cotree_real *z)
{
    int i, n, is_left = 1, status;
    for (i = 0; i < N_STATES; ++i) start->given[i] = z[i];
    status = correct_contents(start, t, z, &is_left);
    is_left = 1;
    for (n = 0; n < MOST_ROUNDS && is_left && status == 0; ++n) {
        status = cotree_start_complete_states(start, t, z);
        if (status != 0) return status;
        for (i = 0; i < start->tables->n_contents; ++i) {
            if (start->is_found[i]) z[unknown_of(start, i)] = start->given[unknown_of(start, i)];
        }
        status = correct_contents(start, t, z, &is_left);
    }
    return status == 0 && is_left ? COTREE_START_UNSOLVED : status;
}

#if COTREE_HAS_SENSITIVITIES
/* Solve for the sensitivities of the unknowns and the storage states. */
static int solve_content_sensitivities(cotree_start *start, cotree_real t, cotree_real *z)
{
    cotree_run *const run = start->run;
    const int n_contents = start->tables->n_contents;
    cotree_real *const given = start->given_slopes; /* derivatives of the unknowns, by column */
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
        if (cotree_run_find(run, t, start->w) != 0) return COTREE_START_UNSOLVED;
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
#endif

/* Solve for algebraic unknowns, storage states and their sensitivities. */
int cotree_start_solve_all(cotree_start *start, cotree_real t, cotree_real *z)
{
    int status;
    if (start->tables->n_contents == 0) return solve_unknowns(start, t, z);
    if (mark_found(start) == 0 && N_SENSITIVITIES == 0) return solve_unknowns(start, t, z);
    status = solve_contents(start, t, z);
#if COTREE_HAS_SENSITIVITIES
    if (status == 0 && N_SENSITIVITIES > 0) status = solve_content_sensitivities(start, t, z);
#endif
    return status;
}

/* Return whether the matrix g_z at x has full rank after its rows and columns are scaled. */
static int is_regular(cotree_start *start, cotree_real t, const cotree_real *x)
{
    const cotree_run *const run = start->run;
    const int *const starts = MODEL->column_starts;
    const int n = MODEL->n_algebraic, n_rounding = n > PIVOT_ROUNDING ? n : PIVOT_ROUNDING;
    cotree_real *const a = run->matrix.first;
    int i, j, k;
    if (MODEL->jacobian(t, x, run->u, run->p, run->k, run->nonzeros) != 0) return 0;
    for (i = starts[N_RATES]; i < starts[N_STATES]; ++i) {
        /* Full rank is assumed if the rank cannot be determined. */
        if (!(COTREE_FABS(run->nonzeros[i]) <= COTREE_MAX)) return 1;
    }
    /* Rows of the array are columns of the matrix or, in the transpose, its rows. */
    cotree_lu_load(&run->matrix, COTREE_F(1.0), starts, MODEL->row_indices, run->nonzeros, N_RATES,
                   1);
    for (k = 0; k < 6; ++k) { /* scale rows and columns alternately, three times */
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

/* Return whether the equations determine the unknowns, at z or at a point near z. Junctions that
 * hardly conduct may make the matrix singular at z alone. */
static int is_determined(cotree_start *start, cotree_real t, const cotree_real *z)
{
    cotree_real *const x = start->w;
    int i, k;
#if COTREE_HAS_HELPER
    if (start->is_trusted) return 1;
#endif
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

/* Solve for algebraic unknowns together with the modes of friction. */
int cotree_start_solve_unknowns(cotree_start *start, cotree_real t, cotree_real *z)
{
    int status = 0;
#if COTREE_HAS_EVENTS
    if (cotree_start_count_events(start, COTREE_FRICTION_SLIP) > 0)
        status = cotree_start_choose_friction_modes(start, t, z);
#endif
    if (status == 0) status = cotree_start_solve_all(start, t, z);
    return status == 0 && !is_determined(start, t, z) ? COTREE_START_UNDETERMINED : status;
}
#endif
