/* fmu_slopes.c: directional and adjoint derivatives of an instance.
 * Part of the runtime of cotree, the same for every model.
 *
 * With the rates f, the residuals g of the algebraic unknowns z, and any other unknown h, the
 * derivatives by the knowns v are z_v = -g_z^-1 g_v and h_v + h_z z_v. During initialization,
 * states computed from parameters depend on these. */
#include "fmu.h"

#include "cotree_lu.h"

#include <stddef.h>

#define N_STATES (m->model->n_states)
#define N_RATES (m->model->n_states - m->model->n_algebraic)
#define N_ALGEBRAIC (m->model->n_algebraic)

/* Return the column of a known, or -1. */
static int column_of(const fmu *m, unsigned reference)
{
    const fmu_tables *const tables = m->tables;
    int index = 0;
    const int block = fmu_find(m, reference, &index);
    switch (block) {
    case FMU_STATES:
        return index < N_RATES ? index : -1;
    case FMU_INPUTS:
        return N_STATES + index;
    case FMU_PARAMETERS:
        return N_STATES + tables->n_inputs + index;
    case FMU_TIME:
        return N_STATES + tables->n_inputs + m->model->n_parameters;
    default:
        return -1;
    }
}

/* Return the row of an unknown, or -1; states are the last rows. */
static int row_of(const fmu *m, unsigned reference)
{
    const int n_events = m->offsets[FMU_INDICATORS + 1] - m->offsets[FMU_INDICATORS];
    const int n_outputs = m->model->n_outputs;
    int index = 0;
    switch (fmu_find(m, reference, &index)) {
    case FMU_RATES:
        return index;
    case FMU_OUTPUTS:
        return N_STATES + index;
    case FMU_INDICATORS:
        return N_STATES + n_outputs + index;
    case FMU_SIGNALS:
        return N_STATES + n_outputs + n_events + index;
    case FMU_STATES:
        return m->tables->partials.n_rows + index;
    default:
        return -1;
    }
}

static int check_variables(const fmu *m, const unsigned *unknowns, size_t n_unknowns,
                           const unsigned *knowns, size_t n_knowns)
{
    const int is_start = m->mode == FMU_INITIALIZATION;
    size_t i;
    for (i = 0; i < n_unknowns; ++i) {
        const int row = row_of(m, unknowns[i]);
        const int state = row - m->tables->partials.n_rows;
        if (row < 0 || (state >= 0 && state < N_RATES && !is_start)) {
            return fmu_refuse(m, "variable %u is no unknown with derivatives in %s", unknowns[i],
                              fmu_mode_name(m));
        }
    }
    for (i = 0; i < n_knowns; ++i) {
        if (column_of(m, knowns[i]) < 0) {
            return fmu_refuse(m, "variable %u is no known in %s", knowns[i], fmu_mode_name(m));
        }
    }
    return 0;
}

/* Factorise the matrix of the algebraic equations, or its transpose. */
static int factorise(fmu *m, int is_transposed, cotree_lu *lu)
{
    const fmu_pattern *const p = &m->tables->partials;
    const int n = N_ALGEBRAIC;
    int i, j;
    *lu = cotree_lu_of(n, n, n, m->dense, m->pivots);
    for (i = 0; i < n * n; ++i) m->dense[i] = 0.0;
    for (j = 0; j < n; ++j) {
        for (i = p->starts[N_RATES + j]; i < p->starts[N_RATES + j + 1]; ++i) {
            const int row = p->rows[i] - N_RATES;
            if (row < 0 || row >= n) continue;
            m->dense[is_transposed ? j + row * n : row + j * n] = m->partials[i];
        }
    }
    if (cotree_lu_factorise(lu) == 0) return 0;
    return fmu_discard(m, "the algebraic equations are singular at t = %.10g", m->numbers[FMU_NOW]);
}

/* Add the columns from first to last, times a direction, to the rows. */
static void multiply(fmu *m, int first, int last, const double *seed)
{
    const fmu_pattern *const p = &m->tables->partials;
    int i, j;
    for (j = first; j < last; ++j) {
        if (seed[j] == 0.0) continue;
        for (i = p->starts[j]; i < p->starts[j + 1]; ++i)
            m->rows[p->rows[i]] += m->partials[i] * seed[j];
    }
}

/* Compute the derivatives of all rows, and of the algebraic unknowns, along m->seed. */
static int propagate(fmu *m, const int *is_known)
{
    const fmu_pattern *const p = &m->tables->partials;
    cotree_lu lu;
    int i;
    if (m->mode == FMU_INITIALIZATION && fmu_move_start(m, is_known, m->seed) != 0) return 1;
    for (i = 0; i < p->n_rows; ++i) m->rows[i] = 0.0;
    for (i = N_RATES; i < N_STATES; ++i) m->seed[i] = 0.0;
    multiply(m, 0, p->n_columns, m->seed);
    if (N_ALGEBRAIC == 0) return 0;
    if (factorise(m, 0, &lu) != 0) return 1;
    for (i = 0; i < N_ALGEBRAIC; ++i) m->solved[i] = -m->rows[N_RATES + i];
    cotree_lu_solve(&lu, m->solved);
    for (i = 0; i < N_ALGEBRAIC; ++i) m->seed[N_RATES + i] = m->solved[i];
    multiply(m, N_RATES, N_STATES, m->seed);
    return 0;
}

/* Mark the states among the knowns. */
static void mark_known_states(const fmu *m, const unsigned *knowns, size_t n_knowns, int *is_known)
{
    size_t i;
    int j;
    for (j = 0; j < N_STATES; ++j) is_known[j] = 0;
    for (i = 0; i < n_knowns; ++i) {
        const int column = column_of(m, knowns[i]);
        if (column < N_STATES) is_known[column] = 1;
    }
}

static double value_of_row(const fmu *m, int row)
{
    const int n_rows = m->tables->partials.n_rows;
    return row < n_rows ? m->rows[row] : m->seed[row - n_rows];
}

static void clear_seed(fmu *m)
{
    int i;
    for (i = 0; i < m->tables->partials.n_columns; ++i) m->seed[i] = 0.0;
}

int fmu_directional(fmu *m, const unsigned *unknowns, size_t n_unknowns, const unsigned *knowns,
                    size_t n_knowns, const double *seed, double *sensitivity)
{
    size_t i;
    if (check_variables(m, unknowns, n_unknowns, knowns, n_knowns) != 0) return 1;
    if (fmu_refresh(m, FMU_POINT | FMU_HAS_PARTIALS) != 0) return 1;
    clear_seed(m);
    for (i = 0; i < n_knowns; ++i) m->seed[column_of(m, knowns[i])] += seed[i];
    mark_known_states(m, knowns, n_knowns, m->known);
    if (propagate(m, m->known) != 0) return 1;
    for (i = 0; i < n_unknowns; ++i) sensitivity[i] = value_of_row(m, row_of(m, unknowns[i]));
    return 0;
}

/* Compute adjoint derivatives during initialization, one known at a time. */
static int adjoint_by_columns(fmu *m, const unsigned *unknowns, size_t n_unknowns,
                              const unsigned *knowns, size_t n_knowns, const double *seed,
                              double *sensitivity)
{
    size_t i, k;
    mark_known_states(m, knowns, n_knowns, m->known);
    for (k = 0; k < n_knowns; ++k) {
        clear_seed(m);
        m->seed[column_of(m, knowns[k])] = 1.0;
        if (propagate(m, m->known) != 0) return 1;
        sensitivity[k] = 0.0;
        for (i = 0; i < n_unknowns; ++i) {
            sensitivity[k] += seed[i] * value_of_row(m, row_of(m, unknowns[i]));
        }
    }
    return 0;
}

static double weighted_column(const fmu *m, int column)
{
    const fmu_pattern *const p = &m->tables->partials;
    double sum = 0.0;
    int i;
    for (i = p->starts[column]; i < p->starts[column + 1]; ++i)
        sum += m->partials[i] * m->rows[p->rows[i]];
    return sum;
}

int fmu_adjoint(fmu *m, const unsigned *unknowns, size_t n_unknowns, const unsigned *knowns,
                size_t n_knowns, const double *seed, double *sensitivity)
{
    const int n_rows = m->tables->partials.n_rows;
    cotree_lu lu;
    size_t i;
    int j;
    if (check_variables(m, unknowns, n_unknowns, knowns, n_knowns) != 0) return 1;
    if (fmu_refresh(m, FMU_POINT | FMU_HAS_PARTIALS) != 0) return 1;
    if (m->mode == FMU_INITIALIZATION) {
        return adjoint_by_columns(m, unknowns, n_unknowns, knowns, n_knowns, seed, sensitivity);
    }
    for (j = 0; j < n_rows; ++j) m->rows[j] = 0.0;
    for (j = 0; j < N_ALGEBRAIC; ++j) m->solved[j] = 0.0;
    for (i = 0; i < n_unknowns; ++i) {
        const int row = row_of(m, unknowns[i]);
        if (row < n_rows) {
            m->rows[row] += seed[i];
        } else {
            m->solved[row - n_rows - N_RATES] += seed[i];
        }
    }
    if (N_ALGEBRAIC > 0) {
        /* Weights of the residuals: -g_z^-T times the weights of the algebraic unknowns. */
        for (j = 0; j < N_ALGEBRAIC; ++j) m->solved[j] += weighted_column(m, N_RATES + j);
        if (factorise(m, 1, &lu) != 0) return 1;
        cotree_lu_solve(&lu, m->solved);
        for (j = 0; j < N_ALGEBRAIC; ++j) m->rows[N_RATES + j] = -m->solved[j];
    }
    for (i = 0; i < n_knowns; ++i) sensitivity[i] = weighted_column(m, column_of(m, knowns[i]));
    return 0;
}
