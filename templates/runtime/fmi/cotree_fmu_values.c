/* cotree_fmu_values.c: values of an instance at its current state, and its variables. */
#include "cotree_fmu_internal.h"

void fmu_invalidate(fmu *m) { m->valid = 0; }

#if COTREE_HAS_BREAKPOINTS
/* Compute the rows of time events. Periods are positive, or zero for single time events. */
static int update_time_events(fmu *m)
{
    const int n_sensitivities = m->time_events.n_sensitivities, width = 2 + 2 * n_sensitivities;
    double *const rows = m->limits + m->tables->n_limits;
    int i, j;
    if (m->tables->find_time_events(m->p, m->k, m->limits) != 0) {
        return fmu_refuse(m, "the times of time events cannot be computed");
    }
    /* From the last row to the first, because a row is longer than the kernel's result for it. */
    for (i = m->time_events.n - 1; i >= 0; --i) {
        const double *const found = rows + i * width;
        double *const row = rows + i * (width + 1);
        const double first = found[0], period = found[1], sign = period < 0.0 ? -1.0 : 1.0;
        const int is_once = !(fabs(period) <= DBL_MAX) || period == 0.0;
        for (j = 2 * n_sensitivities - 1; j >= 0; --j) row[3 + j] = found[2 + j];
        for (j = 0; j < n_sensitivities; ++j) row[4 + 2 * j] *= is_once ? 0.0 : sign;
        row[2] = sign * (double)m->tables->time_event_starts[i];
        row[1] = is_once ? 0.0 : fabs(period);
        row[0] = first;
    }
    return 0;
}
#endif

int fmu_prepare(fmu *m)
{
    int status;
    if (m->is_prepared) return 0;
    status = m->model->prepare(m->p, m->k);
    if (status < 0 && -1 - status < m->model->n_guards) {
        return fmu_refuse(m, "the parameters violate a condition: %s",
                          m->model->guards[-1 - status]);
    }
    if (status != 0)
        return fmu_refuse(m, "the parameters cannot be used: a linear system is singular");
    m->is_prepared = 1;
#if COTREE_HAS_BREAKPOINTS
    return update_time_events(m);
#else
    return 0;
#endif
}

/* Write the inputs that the importer has set; they replace those of the scene. */
int fmu_write_inputs(double t, double *u, void *context)
{
    const fmu *const m = (const fmu *)context;
    int i;
    (void)t;
    for (i = 0; i < m->tables->n_inputs; ++i) u[m->tables->inputs[i]] = m->outside[i];
    return 0;
}

void fmu_set_up_run(fmu *m)
{
    cotree_run *const run = &m->run;
#if COTREE_HAS_INPUTS
    run->input_function = fmu_write_inputs;
    run->input_context = m;
#endif
#if COTREE_HAS_CONSTRAINTS
    run->is_held = 0;
    run->is_strict = 0;
#endif
#if COTREE_HAS_ALGEBRAIC
    run->n_found = 0;
#endif
    run->low = m->numbers[FMU_LOW];
    run->high = m->numbers[FMU_HIGH];
    run->atol = m->tables->atol;
}

static double now(const fmu *m) { return cotree_run_inside(&m->run, m->numbers[FMU_NOW]); }

/* Limits of the continuation of algebraic unknowns: number of points, and smallest fraction of the
 * path. */
#define MAX_POINTS 1000
#define MIN_SHARE 1e-9

/* Continue the algebraic unknowns along a straight line from the point at which they were solved
 * last, since an importer may try steps that are too long for Newton's method. */
static int continue_unknowns(fmu *m)
{
    const double from = m->numbers[FMU_SOLVED_AT];
    double *const w = m->work;
    double s = 0.0, step = 0.5;
    int i, n;
    if (m->numbers[FMU_IS_SOLVED] == 0.0) return 1;
    for (n = 0; n < MAX_POINTS && s < 1.0 && step > MIN_SHARE; ++n) {
        const double next = s + step < 1.0 ? s + step : 1.0;
        for (i = 0; i < N_RATES; ++i) w[i] = m->old[i] + next * (m->z[i] - m->old[i]);
        if (cotree_run_complete(&m->run, from + next * (now(m) - from), w) == 0) {
            s = next;
            step *= 2.0;
        } else {
            step *= 0.5;
        }
    }
    return s < 1.0;
}

/* Solve for the algebraic unknowns, starting from their last values. */
static int solve_unknowns(fmu *m)
{
    int i;
    cotree_run_narrow(&m->run, now(m), m->z, m->work);
    if (cotree_run_complete(&m->run, now(m), m->work) != 0 && continue_unknowns(m) != 0) {
        return fmu_discard(
            m, "the algebraic equations have no solution near the previous one at t = %.10g",
            m->numbers[FMU_NOW]);
    }
    for (i = 0; i < N_RATES; ++i) m->old[i] = m->z[i];
    for (i = N_RATES; i < N_STATES; ++i) m->z[i] = m->run.full[i];
    m->numbers[FMU_SOLVED_AT] = now(m);
    m->numbers[FMU_IS_SOLVED] = 1.0;
    return 0;
}

/* Compute inputs and algebraic unknowns at the current state. */
static int compute_point(fmu *m)
{
    fmu_set_up_run(m);
#if COTREE_HAS_ALGEBRAIC
    if (solve_unknowns(m) != 0) return 1;
#endif
    if (cotree_run_inputs(&m->run, now(m)) == 0) return 0;
    return fmu_discard(m, "the inputs cannot be computed at t = %.10g", m->numbers[FMU_NOW]);
}

static int evaluate(fmu *m, int what)
{
    const cotree_model *const model = m->model;
    const double t = now(m);
    switch (what) {
    case FMU_HAS_RATES:
        return model->rhs(t, m->z, m->u, m->p, m->k, m->dx);
    case FMU_HAS_OUTPUTS:
        if (model->outputs_of_state == NULL) return 0;
        return model->outputs_of_state(t, m->z, m->u, m->p, m->k, m->y);
    case FMU_HAS_INDICATORS:
        return model->events(t, m->z, m->u, m->p, m->k, m->g);
    case FMU_HAS_PARTIALS:
        return m->tables->find_partials(t, m->z, m->u, m->p, m->k, m->partials);
    default:
        if (model->output_sensitivity == NULL) return 0;
        return model->output_sensitivity(t, m->z, m->z + N_STATES, m->u, m->p, m->k, m->dy);
    }
}

/* Discard rates and event indicators that are not finite; integrators would propagate them. */
static int check_finite(fmu *m, int what)
{
    const int is_rate = what == FMU_HAS_RATES;
    const double *const values = is_rate ? m->dx : m->g;
    const int n = is_rate                      ? N_RATES
                  : what == FMU_HAS_INDICATORS ? fmu_size_of(m, FMU_INDICATORS)
                                               : 0;
    int i;
    for (i = 0; i < n; ++i) {
        const char *name = is_rate ? m->model->states[i].name : "";
        if (fabs(values[i]) <= DBL_MAX) continue;
#if COTREE_HAS_EVENTS
        if (!is_rate) name = m->model->hybrid->events[i].name;
#endif
        return fmu_discard(m, "the %s '%s' is not finite at t = %.10g",
                           is_rate ? "derivative of state" : "indicator of event", name,
                           m->numbers[FMU_NOW]);
    }
    return 0;
}

int fmu_refresh(fmu *m, int what)
{
    int bit;
    if (fmu_prepare(m) != 0) return 1;
    if ((m->mode & (FMU_INSTANTIATED | FMU_INITIALIZATION)) != 0 &&
        m->numbers[FMU_IS_STARTED] == 0.0) {
        if (fmu_start(m) != 0) return 1;
    }
    if ((m->valid & FMU_POINT) == 0) {
        if (compute_point(m) != 0) return 1;
        m->valid |= FMU_POINT;
    }
    for (bit = FMU_HAS_RATES; bit <= FMU_HAS_SLOPES; bit *= 2) {
        if ((what & bit) == 0 || (m->valid & bit) != 0) continue;
        if (evaluate(m, bit) != 0) {
            return fmu_discard(
                m, "the model cannot be evaluated at t = %.10g: a linear system is singular",
                m->numbers[FMU_NOW]);
        }
        if (check_finite(m, bit) != 0) return 1;
        m->valid |= bit;
    }
    return 0;
}

void fmu_set_projection(fmu *m, int is_held)
{
#if COTREE_HAS_CONSTRAINTS
    m->run.is_held = is_held;
#else
    (void)m, (void)is_held;
#endif
}

double fmu_span(const fmu *m)
{
    const double end = m->numbers[FMU_END];
    return end <= DBL_MAX ? end - m->numbers[FMU_BEGIN] : m->tables->span;
}

cotree_events *fmu_events(fmu *m)
{
    cotree_events *const e = &m->events;
    e->terminal_event = -1;
    e->failure = 0;
    e->rtol = m->numbers[FMU_TOLERANCE];
    e->atol = m->tables->atol;
    e->span = fmu_span(m);
    return e;
}

/* Variables. */

int fmu_find(const fmu *m, unsigned reference, int *index)
{
    int block;
    for (block = 0; block < FMU_N_BLOCKS; ++block) {
        if (reference < (unsigned)m->offsets[block + 1]) {
            *index = (int)reference - m->offsets[block];
            return block;
        }
    }
    return -1;
}

int fmu_size_of(const fmu *m, enum fmu_block block)
{
    return m->offsets[block + 1] - m->offsets[block];
}

/* Each continuous state has one rate. */
int fmu_count_numbers(fmu *m, enum fmu_block block, size_t *n)
{
    if (fmu_check_pointer(m, n) != 0) return 1;
    *n = (size_t)fmu_size_of(m, block == FMU_STATES ? FMU_RATES : block);
    return 0;
}

/* Compute the data that the values of a block require. Before initialization, only variables that
 * may be set have values. */
static int evaluate_block(fmu *m, int block, int index)
{
    /* One entry for each block; the last one is for nominal values. */
    static const int needs[] = {0,
                                FMU_POINT,
                                FMU_HAS_RATES,
                                0,
                                0,
                                FMU_POINT,
                                FMU_HAS_OUTPUTS,
                                FMU_HAS_INDICATORS,
                                FMU_HAS_SLOPES,
                                FMU_POINT,
                                0};
    if (needs[block] == 0) return 0;
    if (m->mode == FMU_INSTANTIATED) {
        if (block == FMU_STATES && m->numbers[FMU_IS_STARTED] == 0.0) return 0;
        return fmu_refuse(m, "variable %d has no value before Initialization Mode",
                          m->offsets[block] + index);
    }
    /* After the end of the simulation, values are those at the end. */
    return fmu_refresh(m, needs[block]);
}

static double read_value(const fmu *m, int block, int index)
{
    switch (block) {
    case FMU_TIME:
        return m->numbers[FMU_NOW];
    case FMU_STATES:
        if (m->mode == FMU_INSTANTIATED && m->is_own[index] != 0.0) return m->own_values[index];
        return m->z[index];
    case FMU_RATES:
        return m->dx[index];
    case FMU_PARAMETERS:
        return m->p[index];
    case FMU_INPUTS:
        return m->outside[index];
    case FMU_SIGNALS:
        return m->u[m->tables->signals[index]];
    case FMU_OUTPUTS:
        return m->y[index];
    case FMU_INDICATORS:
        return m->g[index];
    case FMU_OUTPUT_SLOPES:
        return m->dy[index];
    case FMU_STATE_SLOPES:
        return m->z[N_STATES + index];
    default:
        return m->tables->sizes == NULL ? 1.0 : m->tables->sizes[index];
    }
}

int fmu_get_value(fmu *m, int block, int index, double *value)
{
    if (evaluate_block(m, block, index) != 0) return 1;
    *value = read_value(m, block, index);
    return 0;
}

/* Reject missing arrays, and arrays of different lengths. */
static int check_arrays(const fmu *m, const unsigned *references, size_t n, const double *values,
                        size_t n_values)
{
    if (n != n_values) return fmu_refuse(m, "%s: every variable has one value", m->function);
    return n > 0 && (fmu_check_pointer(m, references) || fmu_check_pointer(m, values));
}

int fmu_get(fmu *m, const unsigned *references, size_t n, double *values, size_t n_values)
{
    size_t i;
    fmu_evaluate(m);
    if (check_arrays(m, references, n, values, n_values) != 0) return 1;
    for (i = 0; i < n; ++i) {
        int index = 0;
        const int block = fmu_find(m, references[i], &index);
        if (block < 0) return fmu_refuse(m, "there is no variable %u", references[i]);
        if (fmu_get_value(m, block, index, values + i) != 0) return 1;
    }
    return 0;
}

/* Reject variables and values that may not be set. */
static int check_set(const fmu *m, unsigned reference, double value)
{
    int index = 0;
    const int block = fmu_find(m, reference, &index);
    const int is_early = (m->mode & (FMU_INSTANTIATED | FMU_INITIALIZATION)) != 0;
    if (block < 0) return fmu_refuse(m, "there is no variable %u", reference);
    if (!(fabs(value) <= DBL_MAX))
        return fmu_refuse(m, "variable %u is set to a value that is not finite", reference);
    if (block == FMU_INPUTS) return 0;
    /* The standard allows changes of parameters only in Event Mode, and most importers follow it.
     * CasADi sets parameters at every evaluation, and integrates again for other values. */
    if (block == FMU_PARAMETERS) return 0;
    /* Some importers set individual states as if they were marked for reinitialisation. */
    if (block == FMU_STATES && index < N_RATES && (is_early || m->is_exchanged)) return 0;
    if (block == FMU_STATES && index < N_RATES) {
        return fmu_refuse(m, "state '%s' cannot be set in %s", m->model->states[index].name,
                          fmu_mode_name(m));
    }
    return fmu_refuse(m, "variable %u is calculated and cannot be set", reference);
}

static void set_value(fmu *m, unsigned reference, double value)
{
    int index = 0;
    const int block = fmu_find(m, reference, &index);
    if (block == FMU_PARAMETERS || block == FMU_INPUTS) {
        double *const place = block == FMU_PARAMETERS ? m->p + index : m->outside + index;
        if (*place == value) return;
        *place = value;
        m->numbers[FMU_IS_CHANGED] = 1.0;
        if (block == FMU_PARAMETERS) m->is_prepared = 0;
    } else if ((m->mode & FMU_RUNNING) != 0) {
        m->z[index] = value;
    } else {
        m->own_values[index] = value;
        m->is_own[index] = 1.0;
    }
    m->numbers[FMU_IS_STARTED] = 0.0;
    fmu_invalidate(m);
}

int fmu_set(fmu *m, const unsigned *references, size_t n, const double *values, size_t n_values)
{
    size_t i;
    if (check_arrays(m, references, n, values, n_values) != 0) return 1;
    for (i = 0; i < n; ++i) {
        if (check_set(m, references[i], values[i]) != 0) return 1;
    }
    for (i = 0; i < n; ++i) set_value(m, references[i], values[i]);
    return 0;
}
