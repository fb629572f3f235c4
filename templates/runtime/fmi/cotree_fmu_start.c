/* cotree_fmu_start.c: initialization with a consistent start, and its derivatives.
 * Part of the runtime of cotree, the same for every model. */
#include "cotree_fmu_internal.h"

int fmu_set_up(void *instance, const char *function, const double *tolerance, double t, double end)
{
    fmu *const m = fmu_call(instance, function, FMU_INSTANTIATED);
    double rtol;
    int result = 0;
    if (m == NULL) return FMU_ERROR;
    rtol = tolerance == NULL ? m->tables->rtol : *tolerance;
    if (!(fabs(t) <= DBL_MAX)) {
        result = fmu_refuse(m, "the start time is no finite number");
    } else if (!(end > t)) {
        result = fmu_refuse(m, "the stop time %.10g is not after the start time %.10g", end, t);
    } else if (!(rtol > 0.0 && rtol < 1.0)) {
        result = fmu_refuse(m, "the tolerance %g is not between 0 and 1", rtol);
    }
    if (result != 0) return FMU_ERROR;
    m->numbers[FMU_NOW] = m->numbers[FMU_BEGIN] = t;
    m->numbers[FMU_END] = end;
    m->numbers[FMU_TOLERANCE] = rtol;
    m->numbers[FMU_IS_SET_UP] = 1.0;
    return FMU_OK;
}

int fmu_enter_initialization(void *instance, const char *function)
{
    fmu *const m = fmu_call(instance, function, FMU_INSTANTIATED);
    if (m == NULL) return FMU_ERROR;
    if (m->numbers[FMU_IS_SET_UP] == 0.0) {
        fmu_refuse(m, "%s needs the start time: call fmi2SetupExperiment first", function);
        return FMU_ERROR;
    }
    m->numbers[FMU_IS_STARTED] = 0.0;
    fmu_invalidate(m);
    fmu_enter(m, FMU_INITIALIZATION);
    return FMU_OK;
}

/* Write the prescribed initial values, and guesses of the others. */
static int write_initial_values(fmu *m)
{
    const fmu_tables *const tables = m->tables;
    int i;
    if (tables->is_at_rest) {
        for (i = 0; i < m->model->n_parameters; ++i) {
            if (m->p[i] == m->model->parameter_values[i]) continue;
            return fmu_refuse(m,
                              "the simulation starts at an operating point that was found for the "
                              "default parameters: '%s' can be set after the initialization only",
                              m->model->parameters[i].name);
        }
    }
    if (m->model->initial(m->p, m->k, m->z) != 0)
        return fmu_refuse(m, "the initial states have no values");
    for (i = 0; i < N_STATES; ++i) {
        const int is_found =
            tables->is_at_rest || (tables->is_found && !tables->start_tables->given[i]);
        if (i >= N_RATES || is_found) m->z[i] = tables->start[i];
        if (m->is_own[i] != 0.0) m->z[i] = m->own_values[i];
    }
    return 0;
}

#if COTREE_HAS_CONDITIONS
/* Mark prescribed states: with given or set initial values, and those of is_known unless NULL.
 * Conditions hold unless all coordinates, or all speeds, are set. */
static void mark_prescribed(fmu *m, const int *is_known)
{
    cotree_assembly *const a = &m->assembly;
    int i;
    for (i = 0; i < N_STATES; ++i) m->is_set[i] = m->is_own[i] != 0.0;
    cotree_assembly_hold(a, m->is_set);
    for (i = 0; i < N_STATES; ++i) {
        a->is_kept[i] = m->is_own[i] != 0.0 || m->tables->start_tables->given[i] ||
                        (is_known != NULL && is_known[i]);
    }
}

/* Project the states that are not prescribed onto the constraints. */
static int assemble(fmu *m)
{
    cotree_assembly *const a = &m->assembly;
    const double t = m->numbers[FMU_NOW];
    int i, status;
    m->numbers[FMU_IS_CHOSEN] = 0.0;
    fmu_set_up_run(m);
    if (cotree_run_inputs(&m->run, t) != 0) return fmu_refuse(m, "the inputs have no values");
    mark_prescribed(m, NULL);
    status = cotree_assembly_normalise(a, m->z);
    for (i = 0; i < N_STATES; ++i) m->work[i] = m->z[i];
    if (status == 0) status = cotree_assembly_measure(a, t, m->z);
    if (status == 0) status = cotree_assembly_move(a, t, m->z);
    if (status == COTREE_ASSEMBLY_VIOLATED && a->culprit >= 0) {
        return fmu_refuse(m,
                          "the initial values violate the constraints, and what is given leaves no "
                          "way to mend that: '%s' is not met, so change initial values or "
                          "parameters",
                          a->tables->rows[a->culprit].name);
    }
    if (status != 0) {
        return fmu_refuse(m, "the constraints have no values at the initial states");
    }
    m->numbers[FMU_IS_CHOSEN] = (double)cotree_assembly_is_chosen(a, t, m->work, m->z);
    return 0;
}
#endif

#if COTREE_HAS_EVENTS
/* The largest number of mode changes of jumps. */
#define MAX_MODE_CHANGES 100

/* Select the modes of dry friction and rigid stops; the start may contain an impact. */
static int select_modes(fmu *m)
{
    cotree_events *const e = fmu_events(m);
    const double t = m->numbers[FMU_NOW];
    int i, status;
    cotree_run_narrow(&m->run, t, m->z, m->work);
    cotree_events_restore(e, m->event_history); /* without the history of an earlier run */
    fmu_hold(m, 1);
    status = cotree_events_select_modes(e, t, m->work);
    fmu_hold(m, 0);
    if (status != 0) {
        return fmu_refuse(m, "event '%s' stops the initialization at t = %.10g: %s",
                          e->rows[e->event].name, t, cotree_events_message(status));
    }
    for (i = 0; i < e->n_events; ++i) {
        if (e->rows[i].kind > COTREE_JUMP)
            m->z[e->rows[i].targets[0]] = m->work[e->rows[i].targets[0]];
    }
    for (i = 0; i < N_RATES && e->n_stops > 0; ++i) m->z[i] = m->work[i];
    fmu_invalidate(m);
    return fmu_refresh(m, FMU_POINT);
}

/* Set the modes of jumps to the sides of their values. */
static int initialize_jump_modes(fmu *m)
{
    const cotree_hybrid *const hybrid = m->model->hybrid;
    const double t = m->numbers[FMU_NOW];
    int round, i, is_changed = 1;
    for (round = 0; is_changed && round < MAX_MODE_CHANGES; ++round) {
        is_changed = 0;
        m->valid = 0;
        if (fmu_refresh(m, FMU_HAS_INDICATORS) != 0) return 1;
        for (i = 0; i < hybrid->n_events; ++i) {
            const cotree_event *const row = hybrid->events + i;
            if (row->kind != COTREE_JUMP || !(m->g[i] * (double)row->direction > 0.0)) continue;
            cotree_run_narrow(&m->run, t, m->z, m->work);
            if (cotree_jumps_compute_new_values(&m->events.jumps, t, m->work) != 0) {
                return fmu_refuse(m, "event '%s' has no values at the start", row->name);
            }
            if (!cotree_jumps_changes_value(&m->events.jumps, i)) continue;
            m->z[row->targets[0]] = cotree_jumps_new_value(&m->events.jumps, i);
            is_changed = 1;
            break;
        }
    }
    if (is_changed) return fmu_refuse(m, "jumps make each other happen at the start");
    return select_modes(m);
}
#endif

#if COTREE_HAS_SENSITIVITIES
/* Compute the sensitivities at the start. */
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
#endif

int fmu_start(fmu *m)
{
    int status;
    if (fmu_prepare(m) != 0) return 1;
    m->run.low = m->numbers[FMU_LOW] = -HUGE_VAL;
    m->run.high = m->numbers[FMU_HIGH] = HUGE_VAL;
    fmu_invalidate(m);
    m->numbers[FMU_IS_STARTED] = 1.0; /* prevents recursion: refresh would call this function */
    status = write_initial_values(m);
#if COTREE_HAS_CONDITIONS
    if (status == 0) status = assemble(m);
#endif
    if (status == 0) status = fmu_refresh(m, FMU_POINT);
#if COTREE_HAS_EVENTS
    if (status == 0) status = initialize_jump_modes(m);
#endif
#if COTREE_HAS_SENSITIVITIES
    if (status == 0) status = start_sensitivities(m);
#endif
    if (status != 0) m->numbers[FMU_IS_STARTED] = 0.0;
    fmu_invalidate(m);
    return status;
}

int fmu_exit_initialization(void *instance, const char *function)
{
    fmu *const m = fmu_call(instance, function, FMU_INITIALIZATION);
    int status;
    if (m == NULL) return FMU_ERROR;
    status = m->numbers[FMU_IS_STARTED] == 0.0 ? fmu_start(m) : 0;
    if (status == 0) status = fmu_refresh(m, FMU_POINT | FMU_HAS_RATES | FMU_HAS_OUTPUTS);
    m->numbers[FMU_IS_CHANGED] = 0.0;
    m->numbers[FMU_IS_BEGUN] = 0.0;
#if COTREE_HAS_EVENTS && COTREE_HAS_STEPS
    if (status == 0 && !m->is_exchanged) status = fmu_enter_steps(m);
#endif
    if (status == 0) fmu_enter(m, m->is_exchanged ? FMU_EVENT : FMU_STEP);
    return fmu_status(m, status);
}

#if COTREE_HAS_CONDITIONS
/* Complete a direction by the states of one level that are not prescribed. */
static int complete_direction(fmu *m, double *seed, int level)
{
    const cotree_assembly_tables *const rows = m->assembly.tables;
    const fmu_pattern *const c = &m->tables->constraints;
    const int n_held = rows->n_values + rows->n_rows, n = n_held + rows->n_conditions;
    double *const rates = m->residual;
    int i, j;
    for (i = 0; i < n; ++i) rates[i] = 0.0;
    for (j = 0; j < c->n_columns; ++j) {
        for (i = c->starts[j]; i < c->starts[j + 1]; ++i) {
            /* Rows of quaternion norms lie between constraints and conditions. */
            const int row = c->rows[i], last = row - rows->n_quaternions;
            if (row >= n_held && row < n_held + rows->n_quaternions) continue;
            rates[row < n_held ? row : last] += m->moved[i] * seed[j];
        }
    }
    if (cotree_assembly_follow(&m->assembly, m->numbers[FMU_NOW], m->z, level, rates, seed) != 0) {
        return fmu_refuse(
            m, "the start has no such derivative: no motion makes up for what it changes "
               "of the constraints");
    }
    return 0;
}

/* Complete a direction by the states that are not prescribed. */
static int complete_directions(fmu *m, const int *is_known, double *seed)
{
    if (m->numbers[FMU_IS_CHOSEN] != 0.0) {
        return fmu_refuse(m, "the start is the least of several moves and has no derivatives: give "
                             "initial values that satisfy the constraints");
    }
    if (fmu_refresh(m, FMU_POINT) != 0) return 1;
    if (m->tables->find_constraints(m->numbers[FMU_NOW], m->z, m->u, m->p, m->k, m->moved) != 0) {
        return fmu_refuse(m, "the constraints have no derivatives");
    }
    mark_prescribed(m, is_known);
    cotree_assembly_turn(&m->assembly, m->z, seed);
    return complete_direction(m, seed, 0) != 0 ? 1 : complete_direction(m, seed, 1);
}
#endif

/* Complete a direction of prescribed states, inputs and parameters by the other states.
 * is_known: states whose own entry is prescribed; NULL: only those that were set. */
int fmu_move_start(fmu *m, const int *is_known, double *seed)
{
    const fmu_tables *const tables = m->tables;
    const fmu_pattern *const initial = &tables->initial;
    double *const of_p = seed + N_STATES + tables->n_inputs;
    int i, j;
    if (tables->is_at_rest) {
        for (j = 0; j < m->model->n_parameters; ++j) {
            if (of_p[j] != 0.0)
                return fmu_refuse(m, "an operating point has no derivatives by parameters");
        }
    }
    if (tables->find_initial != NULL && tables->find_initial(m->p, m->k, m->initial) != 0) {
        return fmu_refuse(m, "the initial states have no derivatives");
    }
    for (j = 0; j < initial->n_columns; ++j) {
        if (of_p[j] == 0.0) continue;
        for (i = initial->starts[j]; i < initial->starts[j + 1]; ++i) {
            const int row = initial->rows[i];
            const int is_found = tables->is_found && !tables->start_tables->given[row];
            const int is_fixed = m->is_own[row] != 0.0 || (is_known != NULL && is_known[row]);
            if (row >= N_RATES || is_found || is_fixed) continue;
            seed[row] += m->initial[i] * of_p[j];
        }
    }
#if COTREE_HAS_CONDITIONS
    return complete_directions(m, is_known, seed);
#else
    return 0;
#endif
}
