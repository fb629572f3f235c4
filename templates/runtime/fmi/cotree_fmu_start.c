/* cotree_fmu_start.c: initialization with consistent states, and derivatives of the initial
 * states. */
#include "cotree_fmu_internal.h"

int fmu_set_up(fmu *m, const double *tolerance, double t, double end)
{
    const double rtol = tolerance == NULL ? m->tables->rtol : *tolerance;
    if (!(fabs(t) <= DBL_MAX)) return fmu_refuse(m, "the start time is not a finite number");
    if (!(end > t)) {
        return fmu_refuse(m, "the stop time %.10g is not after the start time %.10g", end, t);
    }
    if (!(rtol > 0.0 && rtol < 1.0)) {
        return fmu_refuse(m, "the tolerance %g is not between 0 and 1", rtol);
    }
    m->numbers[FMU_NOW] = m->numbers[FMU_BEGIN] = t;
    m->numbers[FMU_END] = end;
    m->numbers[FMU_TOLERANCE] = rtol;
    m->numbers[FMU_IS_SET_UP] = 1.0;
    return 0;
}

int fmu_enter_initialization(fmu *m)
{
    if (m->numbers[FMU_IS_SET_UP] == 0.0) {
        return fmu_refuse(m, "%s needs the start time: call fmi2SetupExperiment first",
                          m->function);
    }
    m->numbers[FMU_IS_STARTED] = 0.0;
    fmu_invalidate(m);
    fmu_enter(m, FMU_INITIALIZATION);
    return 0;
}

/* Return whether a state without a value from the importer starts from its value in the tables. */
static int starts_from_table(const fmu *m, int state)
{
    const fmu_tables *const tables = m->tables;
    return state >= N_RATES || tables->is_at_rest ||
           (tables->is_found && !tables->start_tables->given[state]);
}

/* Write the prescribed initial values, and guesses for all other states. */
static int write_initial_values(fmu *m, double *z)
{
    int i;
    for (i = 0; m->tables->is_at_rest && i < m->model->n_parameters; ++i) {
        if (m->p[i] == m->model->parameter_values[i]) continue;
        return fmu_refuse(m,
                          "the simulation starts at an operating point that was found for the "
                          "default parameters: '%s' can be set after the initialization only",
                          m->model->parameters[i].name);
    }
    if (m->model->initial(m->p, m->k, z) != 0)
        return fmu_refuse(m, "the initial states have no values");
    for (i = 0; i < N_STATES; ++i) {
        if (starts_from_table(m, i)) z[i] = m->tables->start[i];
        if (m->is_own[i] != 0.0) z[i] = m->own_values[i];
    }
    return 0;
}

/* List the states whose initial values are prescribed: those that the importer set, and those of
 * storage elements, which are not computed again for other parameters. */
static void list_prescribed(fmu *m, const double *initial)
{
    const cotree_start_tables *const tables = m->tables->start_tables;
    int i, j, n = 0;
    for (i = 0; i < N_STATES; ++i) {
        int is_set = m->is_own[i] != 0.0;
        for (j = 0; j < tables->n_contents; ++j)
            is_set = is_set || (tables->contents[j] == i && starts_from_table(m, i));
        if (!is_set) continue;
        m->set[n] = i;
        m->set_values[n++] = initial[i];
    }
    m->start.n_set = n;
    m->start.set = m->set;
    m->start.values = m->set_values;
}

/* Find states that satisfy all equations, near the initial values. */
static int find_start(fmu *m, const double *initial)
{
    cotree_start *const start = &m->start;
    int status;
    fmu_set_up_run(m);
    list_prescribed(m, initial);
    start->initial = initial;
    status = cotree_start_find(start, m->numbers[FMU_NOW], m->z);
    m->numbers[FMU_IS_CHOSEN] = (double)start->is_chosen;
    if (status == 0) return 0;
    return fmu_refuse(m, "there is no start: %s ('%s')", cotree_start_message(status),
                      cotree_start_culprit(start, status));
}

/* Select the modes of dry friction and rigid stops. The start may contain an impact. */
static int select_modes(fmu *m)
{
    cotree_events *const e = fmu_events(m);
    const double t = m->numbers[FMU_NOW];
    int i, status;
    cotree_run_narrow(&m->run, t, m->z, m->work);
    cotree_events_restore(e, m->event_history); /* removes the event history of an earlier run */
    fmu_set_projection(m, 1);
    status = cotree_events_select_modes(e, t, m->work);
    fmu_set_projection(m, 0);
    if (status != 0) {
        return fmu_refuse(m, "event '%s' stops the initialization at t = %.10g: %s",
                          e->events[e->event].name, t, cotree_events_message(status));
    }
    for (i = 0; i < e->n_events; ++i) {
        if (e->events[i].kind > COTREE_JUMP)
            m->z[e->events[i].targets[0]] = m->work[e->events[i].targets[0]];
    }
    for (i = 0; i < N_RATES && e->n_stops > 0; ++i) m->z[i] = m->work[i];
    fmu_invalidate(m);
    return fmu_refresh(m, FMU_POINT);
}

static int start_sensitivities(fmu *m)
{
    int i, j;
    for (j = 0; j < N_SENSITIVITIES; ++j) {
        const int seed = m->tables->start_tables->seeds[j];
        double *const s = m->z + N_STATES * (1 + j);
        for (i = 0; i < m->tables->partials.n_columns; ++i) m->seed[i] = 0.0;
        m->seed[seed < 0 ? -1 - seed : N_STATES + m->tables->n_inputs + seed] = 1.0;
        if (fmu_move_start(m, NULL, m->seed) != 0) return 1;
        for (i = 0; i < N_STATES; ++i) s[i] = i < N_RATES ? m->seed[i] : 0.0;
    }
    return 0;
}

int fmu_start(fmu *m)
{
    int status;
    if (fmu_prepare(m) != 0) return 1;
    m->run.low = m->numbers[FMU_LOW] = -HUGE_VAL;
    m->run.high = m->numbers[FMU_HIGH] = HUGE_VAL;
    fmu_invalidate(m);
    m->numbers[FMU_IS_STARTED] = 1.0; /* prevents recursion: fmu_refresh calls this function */
#if COTREE_HAS_START
    status = write_initial_values(m, m->work);
    if (status == 0) status = find_start(m, m->work);
#else
    status = write_initial_values(m, m->z);
#endif
    if (status == 0) status = fmu_refresh(m, FMU_POINT);
#if COTREE_HAS_EVENTS
    if (status == 0) status = select_modes(m);
#endif
#if COTREE_HAS_SENSITIVITIES
    if (status == 0) status = start_sensitivities(m);
#endif
    if (status != 0) m->numbers[FMU_IS_STARTED] = 0.0;
    fmu_invalidate(m);
    return status;
}

int fmu_exit_initialization(fmu *m)
{
    int status = m->numbers[FMU_IS_STARTED] == 0.0 ? fmu_start(m) : 0;
    if (status == 0) status = fmu_refresh(m, FMU_POINT | FMU_HAS_RATES | FMU_HAS_OUTPUTS);
    m->numbers[FMU_IS_CHANGED] = 0.0;
    m->numbers[FMU_IS_BEGUN] = 0.0;
#if COTREE_HAS_EVENTS && COTREE_HAS_STEPS
    if (status == 0 && !m->is_exchanged) status = fmu_enter_steps(m);
#endif
    if (status == 0) fmu_enter(m, m->is_exchanged ? FMU_EVENT : FMU_STEP);
    return status;
}

/* Compute the entries of a direction for the states of one level that are not prescribed. */
static int complete_direction(fmu *m, double *seed, int level)
{
    const cotree_assembly_tables *const rows = m->start.tables->assembly;
    const fmu_pattern *const c = &m->tables->constraints;
    const int n_held = rows->n_values + rows->n_rows, n = n_held + rows->n_conditions;
    double *const rates = m->residual;
    int i, j;
    for (i = 0; i < n; ++i) rates[i] = 0.0;
    for (j = 0; j < c->n_columns; ++j) {
        for (i = c->starts[j]; i < c->starts[j + 1]; ++i) {
            /* The rows of quaternion norms are between the constraints and the conditions. */
            const int row = c->rows[i], last = row - rows->n_quaternions;
            if (row >= n_held && row < n_held + rows->n_quaternions) continue;
            rates[row < n_held ? row : last] += m->moved[i] * seed[j];
        }
    }
    if (cotree_assembly_follow(&m->start.assembly, m->numbers[FMU_NOW], m->z, level, rates, seed) !=
        0) {
        return fmu_refuse(m, "the start has no such derivative: no change of the other states "
                             "satisfies the constraints to first order");
    }
    return 0;
}

/* Compute the entries of a direction for the states that are not prescribed. */
static int complete_directions(fmu *m, const int *is_known, double *seed)
{
    cotree_assembly *const a = &m->start.assembly;
    int i, status;
    if (m->tables->start_tables->assembly == NULL) return 0;
    if (m->numbers[FMU_IS_CHOSEN] != 0.0) {
        return fmu_refuse(m, "the start is one of several projections and has no derivatives: set "
                             "initial values that satisfy the constraints");
    }
    if (fmu_refresh(m, FMU_POINT) != 0) return 1;
    if (m->tables->find_constraints(m->numbers[FMU_NOW], m->z, m->u, m->p, m->k, m->moved) != 0) {
        return fmu_refuse(m, "the constraints have no derivatives");
    }
    for (i = 0; i < N_STATES; ++i) {
        m->start.is_set[i] = m->is_own[i] != 0.0;
        a->is_kept[i] = m->start.is_set[i] || m->tables->start_tables->given[i] ||
                        (is_known != NULL && is_known[i]);
    }
    cotree_assembly_hold(a, m->start.is_set);
    cotree_assembly_turn(a, m->z, seed);
    status = complete_direction(m, seed, 0);
    return status != 0 ? 1 : complete_direction(m, seed, 1);
}

/* Compute the entries of a direction for the states that are not prescribed from its entries for
 * prescribed states, inputs and parameters. is_known: states whose entries are given; NULL: the
 * states that were set. */
int fmu_move_start(fmu *m, const int *is_known, double *seed)
{
    const fmu_tables *const tables = m->tables;
    const fmu_pattern *const initial = &tables->initial;
    double *const of_p = seed + N_STATES + tables->n_inputs;
    int i, j;
    if (tables->is_at_rest) {
        for (j = 0; j < m->model->n_parameters; ++j) {
            if (of_p[j] != 0.0)
                return fmu_refuse(
                    m, "an operating point has no derivatives with respect to parameters");
        }
    }
    if (tables->find_initial != NULL && tables->find_initial(m->p, m->k, m->initial) != 0) {
        return fmu_refuse(m, "the initial states have no derivatives");
    }
    for (j = 0; j < initial->n_columns; ++j) {
        if (of_p[j] == 0.0) continue;
        for (i = initial->starts[j]; i < initial->starts[j + 1]; ++i) {
            const int row = initial->rows[i];
            const int is_fixed = m->is_own[row] != 0.0 || (is_known != NULL && is_known[row]);
            if (starts_from_table(m, row) || is_fixed) continue;
            seed[row] += m->initial[i] * of_p[j];
        }
    }
#if COTREE_HAS_START
    return complete_directions(m, is_known, seed);
#else
    return 0;
#endif
}
