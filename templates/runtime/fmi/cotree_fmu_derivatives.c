/* cotree_fmu_derivatives.c: directional and adjoint derivatives of an instance.
 *
 * f are the rates, g the residuals of the algebraic unknowns z, and h any other unknown. The
 * derivatives with respect to the knowns v are z_v = -g_z^-1 g_v and h_v + h_z z_v. During
 * initialization, states that are computed from parameters also contribute. */
#include "cotree_fmu_internal.h"

/* Return the column of a known variable, or -1 if it has none. */
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

/* Return the row of an unknown of the FMU, or -1 if it has none. States are the last rows. */
static int row_of(const fmu *m, unsigned reference)
{
    const int n_events = fmu_size_of(m, FMU_INDICATORS);
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

static int check_variables(const fmu *m, const fmu_direction *d)
{
    const int is_start = m->mode == FMU_INITIALIZATION;
    size_t i;
    for (i = 0; i < d->n_unknowns; ++i) {
        const int row = row_of(m, d->unknowns[i]);
        const int state = row - m->tables->partials.n_rows;
        if (row < 0 || (state >= 0 && state < N_RATES && !is_start)) {
            return fmu_refuse(m, "variable %u is not an unknown with derivatives in %s",
                              d->unknowns[i], fmu_mode_name(m));
        }
    }
    for (i = 0; i < d->n_knowns; ++i) {
        if (column_of(m, d->knowns[i]) < 0)
            return fmu_refuse(m, "variable %u is not a known in %s", d->knowns[i],
                              fmu_mode_name(m));
    }
    return 0;
}

/* Start a call: reject missing arrays, a seed or result whose length is not n_seed or n_result, and
 * variables without derivatives. Then evaluate the partial derivatives. */
static int begin(fmu *m, const fmu_direction *d, size_t n_seed, size_t n_result)
{
    fmu_evaluate(m);
    if (d->n_seed != n_seed || d->n_result != n_result)
        return fmu_refuse(m, "%s: every variable has one value", m->function);
    if ((d->n_unknowns > 0 && d->unknowns == NULL) || (d->n_knowns > 0 && d->knowns == NULL) ||
        (n_seed > 0 && d->seed == NULL) || (n_result > 0 && d->result == NULL))
        return fmu_check_pointer(m, NULL);
    if (check_variables(m, d) != 0) return 1;
    return fmu_refresh(m, FMU_POINT | FMU_HAS_PARTIALS);
}

#if COTREE_HAS_ALGEBRAIC
/* Factorise the matrix g_z of the algebraic equations, or its transpose. */
static int factorise(fmu *m, int is_transposed, cotree_lu *lu)
{
    const fmu_pattern *const p = &m->tables->partials;
    const int n = N_ALGEBRAIC;
    *lu = cotree_lu_of(n, n, n, m->dense, m->pivots);
    cotree_lu_load(lu, 1.0, p->starts, p->rows, m->partials, N_RATES, is_transposed);
    if (cotree_lu_factorise(lu) == 0) return 0;
    return fmu_discard(m, "the algebraic equations are singular at t = %.10g", m->numbers[FMU_NOW]);
}

#endif

/* Add the columns from first to last - 1, multiplied by their seeds, to the rows. */
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

/* Return the sum of a column's entries, each multiplied by its row's weight. */
static double weighted_column(const fmu *m, int column)
{
    const fmu_pattern *const p = &m->tables->partials;
    double sum = 0.0;
    int i;
    for (i = p->starts[column]; i < p->starts[column + 1]; ++i)
        sum += m->partials[i] * m->rows[p->rows[i]];
    return sum;
}

/* Compute the derivatives of the algebraic unknowns along m->seed, and add their contributions to
 * all rows. */
static int propagate_unknowns(fmu *m)
{
    cotree_lu lu;
    int i;
    if (factorise(m, 0, &lu) != 0) return 1;
    for (i = 0; i < N_ALGEBRAIC; ++i) m->solved[i] = -m->rows[N_RATES + i];
    cotree_lu_solve(&lu, m->solved);
    for (i = 0; i < N_ALGEBRAIC; ++i) m->seed[N_RATES + i] = m->solved[i];
    multiply(m, N_RATES, N_STATES, m->seed);
    return 0;
}

/* Compute the weights of the residuals: -g_z^-T times the weights of the algebraic unknowns. */
static int weigh_residuals(fmu *m)
{
    cotree_lu lu;
    int j;
    for (j = 0; j < N_ALGEBRAIC; ++j) m->solved[j] += weighted_column(m, N_RATES + j);
    if (factorise(m, 1, &lu) != 0) return 1;
    cotree_lu_solve(&lu, m->solved);
    for (j = 0; j < N_ALGEBRAIC; ++j) m->rows[N_RATES + j] = -m->solved[j];
    return 0;
}

/* Compute the derivatives of all rows, and of the algebraic unknowns, along m->seed. */
static int propagate(fmu *m)
{
    const fmu_pattern *const p = &m->tables->partials;
    int i;
    if (m->mode == FMU_INITIALIZATION && fmu_move_start(m, m->known, m->seed) != 0) return 1;
    for (i = 0; i < p->n_rows; ++i) m->rows[i] = 0.0;
    for (i = N_RATES; i < N_STATES; ++i) m->seed[i] = 0.0;
    multiply(m, 0, p->n_columns, m->seed);
#if COTREE_HAS_ALGEBRAIC
    return propagate_unknowns(m);
#else
    return 0;
#endif
}

static void mark_known_states(fmu *m, const fmu_direction *d)
{
    size_t i;
    int j;
    for (j = 0; j < N_STATES; ++j) m->known[j] = 0;
    for (i = 0; i < d->n_knowns; ++i) {
        const int column = column_of(m, d->knowns[i]);
        if (column < N_STATES) m->known[column] = 1;
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

int fmu_directional(fmu *m, const fmu_direction *d)
{
    size_t i;
    if (begin(m, d, d->n_knowns, d->n_unknowns) != 0) return 1;
    clear_seed(m);
    for (i = 0; i < d->n_knowns; ++i) m->seed[column_of(m, d->knowns[i])] += d->seed[i];
    mark_known_states(m, d);
    if (propagate(m) != 0) return 1;
    for (i = 0; i < d->n_unknowns; ++i) d->result[i] = value_of_row(m, row_of(m, d->unknowns[i]));
    return 0;
}

/* Compute adjoint derivatives during initialization from one directional derivative per known
 * variable. */
static int adjoint_by_columns(fmu *m, const fmu_direction *d)
{
    size_t i, k;
    mark_known_states(m, d);
    for (k = 0; k < d->n_knowns; ++k) {
        clear_seed(m);
        m->seed[column_of(m, d->knowns[k])] = 1.0;
        if (propagate(m) != 0) return 1;
        d->result[k] = 0.0;
        for (i = 0; i < d->n_unknowns; ++i)
            d->result[k] += d->seed[i] * value_of_row(m, row_of(m, d->unknowns[i]));
    }
    return 0;
}

/* Compute adjoint derivatives from the weights of the unknown variables. */
static int adjoint_by_rows(fmu *m, const fmu_direction *d)
{
    const int n_rows = m->tables->partials.n_rows;
    size_t i;
    int j;
    for (j = 0; j < n_rows; ++j) m->rows[j] = 0.0;
#if COTREE_HAS_ALGEBRAIC
    for (j = 0; j < N_ALGEBRAIC; ++j) m->solved[j] = 0.0;
#endif
    for (i = 0; i < d->n_unknowns; ++i) {
        const int row = row_of(m, d->unknowns[i]);
        if (row < n_rows) m->rows[row] += d->seed[i];
#if COTREE_HAS_ALGEBRAIC
        if (row >= n_rows) m->solved[row - n_rows - N_RATES] += d->seed[i];
#endif
    }
#if COTREE_HAS_ALGEBRAIC
    if (weigh_residuals(m) != 0) return 1;
#endif
    for (i = 0; i < d->n_knowns; ++i) d->result[i] = weighted_column(m, column_of(m, d->knowns[i]));
    return 0;
}

int fmu_adjoint(fmu *m, const fmu_direction *d)
{
    if (begin(m, d, d->n_unknowns, d->n_knowns) != 0) return 1;
    return m->mode == FMU_INITIALIZATION ? adjoint_by_columns(m, d) : adjoint_by_rows(m, d);
}
