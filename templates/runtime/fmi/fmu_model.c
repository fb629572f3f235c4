/* fmu_model.c: memory, variables and states of an instance.
 * Part of the runtime of cotree, the same for every model.
 */
#include "fmu.h"

#include <float.h>
#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define N_STATES (m->model->n_states)
#define N_RATES (m->model->n_states - m->model->n_algebraic)
#define N_SENSITIVITIES (m->tables->has_sensitivities ? m->model->n_sensitivities : 0)
#define N_FULL (N_STATES * (1 + N_SENSITIVITIES))

/* Limits of the continuation of algebraic unknowns: number of points, and the least share of the
 * path. */
#define MAX_POINTS 1000
#define MIN_SHARE 1e-9

static int n_events_of(const fmu *m)
{
    return m->model->hybrid == NULL ? 0 : m->model->hybrid->n_events;
}

static int largest_int(int a, int b) { return a > b ? a : b; }

/* Allocate the state, in the order in which it is saved. */
static void lay_out_state(fmu *m, cotree_arena *arena)
{
    const cotree_model *const model = m->model;
    m->numbers = cotree_arena_reals(arena, FMU_N_NUMBERS);
    m->z = cotree_arena_reals(arena, N_FULL);
    m->p = cotree_arena_reals(arena, model->n_parameters);
    m->outside = cotree_arena_reals(arena, m->tables->n_inputs);
    m->own_values = cotree_arena_reals(arena, N_STATES);
    m->is_own = cotree_arena_reals(arena, N_STATES);
    m->old = cotree_arena_reals(arena, N_RATES);
    m->event_history = cotree_arena_reals(arena, COTREE_EVENTS_SAVED(n_events_of(m)));
}

static void lay_out(fmu *m, cotree_arena *arena)
{
    const cotree_model *const model = m->model;
    const fmu_tables *const tables = m->tables;
    const int n_events = n_events_of(m), n_sensitivities = N_SENSITIVITIES;
    const cotree_assembly_tables *const rows = tables->start_tables->assembly;
    const int n_rows = rows == NULL ? 0 : model->n_constraints + rows->n_conditions;
    const int n = largest_int(N_STATES, n_rows) + 1;
    m->saved = (double *)cotree_arena_alloc(arena, 0, NULL);
    lay_out_state(m, arena);
    m->n_saved = (size_t)FMU_N_NUMBERS + (size_t)N_FULL + (size_t)model->n_parameters +
                 (size_t)tables->n_inputs + 2 * (size_t)N_STATES + (size_t)N_RATES +
                 (size_t)COTREE_EVENTS_SAVED(n_events);
    m->k = cotree_arena_reals(arena, model->n_prepared + 1);
    m->u = cotree_arena_reals(arena, model->n_inputs + 1);
    m->dx = cotree_arena_reals(arena, N_STATES + 1);
    m->y = cotree_arena_reals(arena, model->n_outputs + 1);
    m->g =
        cotree_arena_reals(arena, n_events + (n_events > 0 ? model->hybrid->n_quantities : 0) + 1);
    m->dy = cotree_arena_reals(arena, model->n_outputs * n_sensitivities + 1);
    m->stops = cotree_arena_reals(arena, tables->n_limits +
                                             tables->n_stops * (3 + 2 * model->n_sensitivities));
    m->partials =
        cotree_arena_reals(arena, tables->partials.starts[tables->partials.n_columns] + 1);
    m->initial = cotree_arena_reals(arena, tables->initial.starts[tables->initial.n_columns] + 1);
    m->moved =
        cotree_arena_reals(arena, tables->constraints.starts[tables->constraints.n_columns] + 1);
    m->seed = cotree_arena_reals(arena, tables->partials.n_columns);
    m->rows = cotree_arena_reals(arena, tables->partials.n_rows + 1);
    m->solved = cotree_arena_reals(arena, 3 * n);
    m->dense = cotree_arena_reals(arena, model->n_algebraic * model->n_algebraic);
    m->work = cotree_arena_reals(arena, N_FULL + 1);
    m->atols = cotree_arena_reals(arena, N_FULL + 1);
    m->turn_tolerances = cotree_arena_reals(arena, n_sensitivities + 1);
    m->before = cotree_arena_reals(arena, N_STATES + 1);
    m->spare = cotree_arena_reals(arena, (int)m->n_saved);
    m->pivots = cotree_arena_ints(arena, n);
    m->known = cotree_arena_ints(arena, n);
    m->records = cotree_arena_reals(arena, COTREE_EVENTS_AT_ONCE(n_events) *
                                               COTREE_EVENTS_RECORD(N_STATES, n_sensitivities));
    cotree_run_init(&m->run, model, m->p, m->k, m->u, 0, arena);
    if (rows != NULL) cotree_assembly_init(&m->assembly, &m->run, rows, arena);
    if (n_events > 0) {
        cotree_events_init(&m->events, &m->run, m->run.n, tables->span, tables->rtol, m->atols,
                           tables->atol, NULL, NULL, arena);
    }
}

static void find_offsets(fmu *m)
{
    const cotree_model *const model = m->model;
    const int n_sensitivities = N_SENSITIVITIES;
    int counts[FMU_N_BLOCKS];
    int i;
    counts[FMU_TIME] = 1;
    counts[FMU_STATES] = N_STATES;
    counts[FMU_RATES] = N_RATES;
    counts[FMU_PARAMETERS] = model->n_parameters;
    counts[FMU_INPUTS] = m->tables->n_inputs;
    counts[FMU_SIGNALS] = model->n_inputs - m->tables->n_inputs;
    counts[FMU_OUTPUTS] = model->n_outputs;
    counts[FMU_INDICATORS] = n_events_of(m);
    counts[FMU_OUTPUT_SLOPES] = model->n_outputs * n_sensitivities;
    counts[FMU_STATE_SLOPES] = N_STATES * n_sensitivities;
    m->offsets[0] = 0;
    for (i = 0; i < FMU_N_BLOCKS; ++i) m->offsets[i + 1] = m->offsets[i] + counts[i];
}

/* Reset the instance to its instantiation. */
void fmu_reset(fmu *m)
{
    const cotree_model *const model = m->model;
    size_t i;
    int j;
    for (i = 0; i < m->n_saved; ++i) m->saved[i] = 0.0;
    for (j = 0; j < model->n_parameters; ++j) m->p[j] = model->parameter_values[j];
    for (j = 0; j < m->tables->n_inputs; ++j) m->outside[j] = m->tables->values[j];
    for (j = 0; j < N_STATES; ++j) m->z[j] = m->tables->start[j];
    m->numbers[FMU_END] = HUGE_VAL;
    m->numbers[FMU_TOLERANCE] = m->tables->rtol;
    m->numbers[FMU_LOW] = -HUGE_VAL;
    m->numbers[FMU_HIGH] = HUGE_VAL;
    m->numbers[FMU_NEXT] = HUGE_VAL;
    m->is_prepared = 0;
    fmu_invalidate(m);
    fmu_enter(m, FMU_INSTANTIATED);
}

fmu *fmu_new(const fmu_tables *tables, int is_exchanged, int returns_early, fmu_logger logger,
             void *environment)
{
    cotree_arena arena = {NULL, 0};
    fmu *const m = (fmu *)calloc(1, sizeof(fmu));
    if (m == NULL) return NULL;
    m->tables = tables;
    m->model = tables->model();
    m->is_exchanged = is_exchanged;
    m->returns_early = returns_early;
    m->logger = logger;
    m->environment = environment;
    lay_out(m, &arena);
    m->memory = calloc(1, arena.used);
    if (m->memory == NULL) {
        free(m);
        return NULL;
    }
    arena.base = (char *)m->memory;
    arena.used = 0;
    lay_out(m, &arena);
    find_offsets(m);
    fmu_reset(m);
    return m;
}

void fmu_free(fmu *m)
{
    if (m == NULL) return;
    free(m->job_memory);
    free(m->corners);
    free(m->memory);
    free(m);
}

static void log_message(const fmu *m, enum fmu_severity severity, const char *format,
                        va_list arguments)
{
    char message[1024];
    if (m->logger == NULL) return;
    if (vsnprintf(message, sizeof(message), format, arguments) < 0) return;
    m->logger(m->environment, severity, message);
}

void fmu_log(const fmu *m, enum fmu_severity severity, const char *format, ...)
{
    va_list arguments;
    va_start(arguments, format);
    log_message(m, severity, format, arguments);
    va_end(arguments);
}

int fmu_refuse(const fmu *m, const char *format, ...)
{
    va_list arguments;
    va_start(arguments, format);
    log_message(m, FMU_ERROR, format, arguments);
    va_end(arguments);
    return 1;
}

int fmu_discard(fmu *m, const char *format, ...)
{
    va_list arguments;
    va_start(arguments, format);
    log_message(m, m->may_discard ? FMU_DISCARD : FMU_ERROR, format, arguments);
    va_end(arguments);
    m->is_discarded = m->may_discard;
    return 1;
}

const char *fmu_mode_name(const fmu *m)
{
    switch (m->mode) {
    case FMU_INSTANTIATED:
        return "the state Instantiated";
    case FMU_INITIALIZATION:
        return "Initialization Mode";
    case FMU_EVENT:
        return "Event Mode";
    case FMU_CONTINUOUS:
        return "Continuous-Time Mode";
    case FMU_STEP:
        return "Step Mode";
    case FMU_FAILED:
        return "the state Step Failed";
    default:
        return "the state Terminated";
    }
}

int fmu_check(fmu *m, const char *function, int modes)
{
    m->may_discard = m->is_discarded = 0;
    if ((m->mode & modes) != 0) return 0;
    return fmu_refuse(m, "%s is not allowed in %s", function, fmu_mode_name(m));
}

void fmu_enter(fmu *m, int mode)
{
    m->mode = mode;
    m->numbers[FMU_MODE] = (double)mode;
}

void fmu_invalidate(fmu *m) { m->valid = 0; }

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
    return fmu_find_stops(m);
}

/* Write the inputs that the importer has set over those of the scene. */
static int write_inputs(double t, double *u, void *context)
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
    run->input_function = write_inputs;
    run->input_context = m;
    run->is_held = 0;
    run->is_strict = 0;
    run->low = m->numbers[FMU_LOW];
    run->high = m->numbers[FMU_HIGH];
    run->atol = m->tables->atol;
    run->n_found = 0;
}

static double now(const fmu *m) { return cotree_run_inside(&m->run, m->numbers[FMU_NOW]); }

/* Continue the algebraic unknowns along the straight line from the point at which they were
 * found last. An importer may try steps too long for Newton's method. */
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
        if (cotree_run_find_states(&m->run, from + next * (now(m) - from), w) == 0) {
            s = next;
            step *= 2.0;
        } else {
            step *= 0.5;
        }
    }
    return s < 1.0;
}

/* Solve for the algebraic unknowns, starting from the last ones. */
static int solve_unknowns(fmu *m)
{
    int i;
    cotree_run_narrow(&m->run, now(m), m->z, m->work);
    if (cotree_run_find_states(&m->run, now(m), m->work) != 0 && continue_unknowns(m) != 0) {
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

/* Compute inputs and algebraic unknowns. */
static int compute_point(fmu *m)
{
    int status;
    fmu_set_up_run(m);
    if (m->model->n_algebraic > 0 && solve_unknowns(m) != 0) return 1;
    status = cotree_run_inputs(&m->run, now(m));
    return status == 0
               ? 0
               : fmu_discard(m, "the inputs have no values at t = %.10g", m->numbers[FMU_NOW]);
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

/* Discard rates and event indicators that are not finite: integrators would propagate them. */
static int check_finite(fmu *m, int what)
{
    const int is_rate = what == FMU_HAS_RATES;
    const double *const values = is_rate ? m->dx : m->g;
    const int n = is_rate ? N_RATES : what == FMU_HAS_INDICATORS ? n_events_of(m) : 0;
    int i;
    for (i = 0; i < n; ++i) {
        if (fabs(values[i]) <= DBL_MAX) continue;
        return fmu_discard(m, "the %s '%s' is not finite at t = %.10g",
                           is_rate ? "derivative of state" : "indicator of event",
                           is_rate ? m->model->states[i].name : m->model->hybrid->events[i].name,
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

/* Compute the values of a block. Before initialization only variables that may be set have
 * values. */
static int evaluate_block(fmu *m, int block, int index)
{
    static const int needs[FMU_N_BLOCKS] = {0,
                                            FMU_POINT,
                                            FMU_HAS_RATES,
                                            0,
                                            0,
                                            FMU_POINT,
                                            FMU_HAS_OUTPUTS,
                                            FMU_HAS_INDICATORS,
                                            FMU_HAS_SLOPES,
                                            FMU_POINT};
    if (needs[block] == 0) return 0;
    if (m->mode == FMU_INSTANTIATED) {
        if (block == FMU_STATES && m->numbers[FMU_IS_STARTED] == 0.0) return 0;
        return fmu_refuse(m, "variable %d has no value before Initialization Mode",
                          m->offsets[block] + index);
    }
    /* After the end, values are those at the end. */
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
    default:
        return m->z[N_STATES + index];
    }
}

int fmu_get(fmu *m, const unsigned *references, size_t n, double *values)
{
    size_t i;
    for (i = 0; i < n; ++i) {
        int index = 0;
        const int block = fmu_find(m, references[i], &index);
        if (block < 0) return fmu_refuse(m, "there is no variable %u", references[i]);
        if (evaluate_block(m, block, index) != 0) return 1;
        values[i] = read_value(m, block, index);
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
        return fmu_refuse(m, "variable %u is set to no finite number", reference);
    if (block == FMU_INPUTS) return 0;
    /* The standard allows changes of parameters in Event Mode only, and importers that follow it
     * set them nowhere else. CasADi sets them at every evaluation, and integrates again for
     * other values. */
    if (block == FMU_PARAMETERS) return 0;
    /* Some importers set single states, like a state that may be reinitialized. */
    if (block == FMU_STATES && index < N_RATES && (is_early || m->is_exchanged)) return 0;
    if (block == FMU_STATES && index < N_RATES) {
        return fmu_refuse(m, "state '%s' cannot be set in %s", m->model->states[index].name,
                          fmu_mode_name(m));
    }
    return fmu_refuse(m, "variable %u is calculated and cannot be set", reference);
}

int fmu_set(fmu *m, const unsigned *references, size_t n, const double *values)
{
    size_t i;
    for (i = 0; i < n; ++i) {
        if (check_set(m, references[i], values[i]) != 0) return 1;
    }
    for (i = 0; i < n; ++i) {
        int index = 0;
        const int block = fmu_find(m, references[i], &index);
        double *const place = block == FMU_PARAMETERS ? m->p
                              : block == FMU_INPUTS   ? m->outside
                                                      : NULL;
        if (place == NULL && (m->mode & FMU_RUNNING) != 0) {
            m->z[index] = values[i];
        } else if (place == NULL) {
            m->own_values[index] = values[i];
            m->is_own[index] = 1.0;
        } else {
            if (place[index] == values[i]) continue;
            place[index] = values[i];
            m->numbers[FMU_IS_CHANGED] = 1.0;
            if (block == FMU_PARAMETERS) m->is_prepared = 0;
        }
        m->numbers[FMU_IS_STARTED] = 0.0;
        fmu_invalidate(m);
    }
    return 0;
}

size_t fmu_state_size(const fmu *m) { return m->n_saved; }

void fmu_save_state(const fmu *m, double *to) { memcpy(to, m->saved, m->n_saved * sizeof(double)); }

/* Return whether an instance of this kind has a mode. */
static int is_mode(const fmu *m, double mode)
{
    int bit;
    for (bit = FMU_INSTANTIATED; bit <= FMU_FAILED; bit *= 2) {
        const int is_own = bit == FMU_STEP || bit == FMU_FAILED        ? !m->is_exchanged
                           : bit == FMU_EVENT || bit == FMU_CONTINUOUS ? m->is_exchanged
                                                                       : 1;
        if (is_own && mode == (double)bit) return 1;
    }
    return 0;
}

int fmu_restore_state(fmu *m, const double *from, size_t n)
{
    if (n != m->n_saved) return fmu_refuse(m, "this is no state of this model");
    if (!is_mode(m, from[FMU_MODE])) return fmu_refuse(m, "this is no state of such an instance");
    memcpy(m->saved, from, n * sizeof(double));
    m->mode = (int)m->numbers[FMU_MODE];
    m->is_prepared = 0;
    fmu_invalidate(m);
    return 0;
}
