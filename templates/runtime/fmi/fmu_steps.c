/* fmu_steps.c: Co-Simulation with one job for each communication step.
 * Part of the runtime of cotree, the same for every model. */
#include "fmu.h"

#include <float.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#define N_STATES (m->model->n_states)
#define N_SENSITIVITIES (m->tables->has_sensitivities ? m->model->n_sensitivities : 0)

/* Relative tolerance of the start time of a step: importers accumulate rounding. */
#define TIME_RTOL 1e-9

static int replace_inputs(double t, double *u, void *context)
{
    const fmu *const m = (const fmu *)context;
    int i;
    (void)t;
    for (i = 0; i < m->tables->n_inputs; ++i) u[m->tables->inputs[i]] = m->outside[i];
    return 0;
}

/* Return the scale of a parameter of sensitivity; 1 for an initial value. */
static double size_of(const fmu *m, int j)
{
    const int seed = m->tables->start_tables->seeds[j];
    return seed < 0 ? 1.0 : fabs(m->p[seed]);
}

static double atol_of(const fmu *m)
{
    return m->tables->atol * (m->numbers[FMU_TOLERANCE] / m->tables->rtol);
}

static double atol_of_slope(const fmu *m, int j)
{
    const double size = size_of(m, j);
    return size > 0.0 ? fmin(atol_of(m) / size, 1e100) : atol_of(m);
}

static double factor_of(const fmu *m, int state)
{
    return m->tables->sizes == NULL ? 1.0 : m->tables->sizes[state];
}

/* Set the absolute tolerances of the entries that are integrated; return their number. */
static int set_tolerances(fmu *m)
{
    const fmu_tables *const tables = m->tables;
    const cotree_model *const model = m->model;
    const int n_rates = N_STATES - model->n_algebraic;
    const int n_states = tables->is_implicit || tables->is_extended ? N_STATES : n_rates;
    const int n = tables->is_implicit ? N_STATES : n_rates; /* sensitivities */
    int i, j, k = 0;
    for (i = 0; i < n_states; ++i) m->atols[k++] = atol_of(m) * factor_of(m, i);
    for (j = 0; j < N_SENSITIVITIES; ++j) {
        for (i = model->sensitivity_starts[j]; i < model->sensitivity_starts[j + 1]; ++i) {
            const int row = model->sensitivity_rows[i];
            if (row < n) m->atols[k++] = atol_of_slope(m, j) * factor_of(m, row);
        }
    }
    return k;
}

static int reserve_corners(fmu *m, size_t n)
{
    const size_t width = 1 + 2 * (size_t)N_SENSITIVITIES;
    double *more;
    if (n <= m->n_corners) return 0;
    more = (double *)realloc(m->corners, 2 * n * width * sizeof(double));
    if (more == NULL) return fmu_refuse(m, "there is no memory");
    m->corners = more;
    m->n_corners = 2 * n;
    return 0;
}

/* List the corners: the start, time events and the end. */
static int list_corners(fmu *m, double t, double end, cotree_job *job)
{
    const size_t n_sensitivities = (size_t)N_SENSITIVITIES;
    const double begin = t;
    size_t i, n = 0;
    for (;;) {
        if (reserve_corners(m, n + 1) != 0) return 1;
        m->corners[n++] = t;
        if (t == end) break;
        t = fmu_next_stop(m, t, end);
    }
    job->corners = m->corners;
    job->n_corners = (int)n;
    job->scale = fmu_largest_stop(m, end);
    job->is_start_sharp = fmu_is_stop(m, begin);
    job->is_end_sharp = fmu_is_stop(m, end);
    if (n_sensitivities == 0 || m->tables->n_stops == 0) return 0;
    m->slopes = m->corners + m->n_corners;
    m->spreads = m->slopes + m->n_corners * n_sensitivities;
    for (i = 0; i < n; ++i) {
        const double at = m->corners[i];
        fmu_stop_slopes(m, at, at == m->numbers[FMU_BEGIN], m->slopes + i * n_sensitivities,
                        m->spreads + i * n_sensitivities);
    }
    for (i = 0; i < n_sensitivities; ++i) {
        double least = 1.0;
        int k;
        for (k = 0; k < N_STATES; ++k) least = fmin(least, factor_of(m, k));
        m->turn_tolerances[i] = least * atol_of_slope(m, (int)i);
    }
    job->slopes = m->slopes;
    job->spreads = m->spreads;
    job->turn_tolerances = m->turn_tolerances;
    return 0;
}

/* Return the longest step, which resolves all pulses. A limit of zero or nan is no limit. */
static double longest_step(const fmu *m)
{
    double longest = DBL_MAX;
    int i;
    for (i = 0; i < m->tables->n_limits; ++i) {
        const double limit = fabs(m->stops[i]);
        if (limit > 0.0 && limit < longest) longest = limit;
    }
    return longest;
}

static int set_up_job(fmu *m, cotree_job *job, double t, double end)
{
    const fmu_tables *const tables = m->tables;
    const int n_events = m->model->hybrid == NULL ? 0 : m->model->hybrid->n_events;
    size_t n_bytes;
    memset(job, 0, sizeof(*job));
    job->model = m->model;
    job->p = m->p;
    job->k = m->k;
    job->u = m->u;
    job->input_function = tables->n_inputs > 0 ? replace_inputs : NULL;
    job->input_context = m;
    job->has_sensitivities = N_SENSITIVITIES > 0;
    job->is_held = 1;
    job->is_strict = tables->is_strict;
    job->constraints = tables->start_tables->assembly;
    job->is_extended = tables->is_extended;
    job->stepper = tables->stepper();
    job->aid = tables->aid == NULL ? NULL : tables->aid();
    job->n = set_tolerances(m);
    job->rtol = m->numbers[FMU_TOLERANCE];
    job->atol = atol_of(m);
    job->atols = m->atols;
    job->max_step = longest_step(m);
    job->z = m->z;
    job->t = t;
    if (n_events > 0) {
        job->records = m->records;
        job->most_records = COTREE_EVENTS_AT_ONCE(n_events);
        job->watched = m->event_history;
        job->is_continued = m->numbers[FMU_IS_BEGUN] != 0.0;
        job->is_changed = m->numbers[FMU_IS_CHANGED] != 0.0;
        job->span = fmu_span(m);
        job->most_events = m->returns_early ? 1 : 0;
    }
    if (list_corners(m, t, end, job) != 0) return 1;
    job->wanted = job->corners; /* not read: n_wanted is zero */
    n_bytes = cotree_job_memory(job);
    if (n_bytes > m->n_job_memory) {
        free(m->job_memory);
        m->job_memory = malloc(n_bytes);
        m->n_job_memory = m->job_memory == NULL ? 0 : n_bytes;
        if (m->job_memory == NULL) return fmu_refuse(m, "there is no memory");
    }
    memset(m->job_memory, 0, n_bytes); /* no data of the previous step remain */
    job->memory = m->job_memory;
    return 0;
}

/* Log why a job failed. */
static int log_failure(fmu *m, const cotree_job *job, int is_eventful)
{
    if (job->status == COTREE_TOO_MANY_STEPS) {
        return fmu_discard(m, "the step stops at t = %.10g: the limit of %ld %s is reached", job->t,
                           is_eventful ? m->tables->most_events : m->tables->most_steps,
                           is_eventful ? "events" : "integrator steps");
    }
    if (job->status == COTREE_RUN_TURNED) {
        return fmu_discard(
            m,
            "the sensitivity of '%s' to '%s' does not exist from t = %.10g on: stops meet "
            "there that move differently with it",
            m->model->states[job->turned % N_STATES].name,
            m->model->sensitivities[job->turned / N_STATES - 1], job->t);
    }
    if (job->status >= COTREE_EVENTS_FAILED) {
        return fmu_discard(m, "event '%s' stops the simulation at t = %.10g: %s",
                           m->model->hybrid->events[job->event].name, job->event_time,
                           cotree_events_message(job->status));
    }
    return fmu_discard(m, "the simulation stops at t = %.10g: %s", job->t,
                       cotree_status_message((cotree_status)job->status));
}

/* Log the events, except for jumps. Return their number. */
static int log_events(const fmu *m, cotree_job *job)
{
    const int width = COTREE_EVENTS_RECORD(N_STATES, N_SENSITIVITIES);
    int i, n_told = 0;
    for (i = 0; i < job->n_records; ++i) {
        const cotree_event *const row = m->model->hybrid->events + (int)job->records[i * width + 1];
        if (row->kind == COTREE_JUMP) continue;
        fmu_log(m, FMU_NOTE, "event '%s' at t = %.10g", row->name, job->records[i * width]);
        ++n_told;
    }
    job->n_records = 0;
    return n_told;
}

/* Integrate to the end of the step, or to the first event, within the budgets. */
static int run_job(fmu *m, cotree_job *job, long *n_events)
{
    int result = COTREE_JOB_MORE, has_told = 0;
    while (result == COTREE_JOB_MORE) {
        result = cotree_job_run(job, m->tables->most_steps - job->n_steps);
        *n_events += job->n_records;
        if (log_events(m, job) > 0) has_told = 1;
        if (result != COTREE_JOB_MORE) break;
        if (m->returns_early && has_told) {
            cotree_job_sync(job);
            break;
        }
        if (job->n_steps >= m->tables->most_steps || *n_events >= m->tables->most_events) {
            job->status = COTREE_TOO_MANY_STEPS;
            cotree_job_sync(job);
            result = COTREE_JOB_FAILED;
        }
    }
    return result;
}

/* Copy the results of a job, up to the time that it has reached. */
static void copy_results(fmu *m, const cotree_job *job, int result)
{
    m->numbers[FMU_NOW] = job->t;
    m->numbers[FMU_IS_BEGUN] = 1.0;
    m->numbers[FMU_IS_CHANGED] = 0.0;
    m->numbers[FMU_HAS_ENDED] = (double)(result == COTREE_JOB_STOPPED);
    fmu_invalidate(m);
}

int fmu_enter_steps(fmu *m)
{
    const double t = m->numbers[FMU_NOW];
    cotree_job job;
    int result;
    if (set_up_job(m, &job, t, fmu_next_stop(m, t, t + fmu_span(m))) != 0) return 1;
    result = cotree_job_start(&job);
    log_events(m, &job);
    copy_results(m, &job, result);
    return result == COTREE_JOB_FAILED ? log_failure(m, &job, 0) : 0;
}

static int check_step(const fmu *m, double t, double step)
{
    const double at = m->numbers[FMU_NOW], end = m->numbers[FMU_END];
    if (!(step > 0.0 && step <= DBL_MAX)) {
        return fmu_refuse(m, "the step size %g is no positive number", step);
    }
    if (!(fabs(t - at) <= TIME_RTOL * fmax(1.0, fabs(at)))) {
        return fmu_refuse(m, "the step begins at t = %.10g, but the instance is at t = %.10g", t,
                          at);
    }
    if (!(t + step <= end + TIME_RTOL * fmax(1.0, fabs(end)))) {
        return fmu_refuse(m, "the step ends at t = %.10g, after the stop time %.10g", t + step,
                          end);
    }
    return 0;
}

int fmu_step(fmu *m, double t, double step, int *is_early, double *reached)
{
    const double end = t + step;
    cotree_job job;
    long n_events = 0;
    int result;
    *is_early = 0;
    *reached = m->numbers[FMU_NOW];
    if (check_step(m, t, step) != 0 || fmu_prepare(m) != 0) return 1;
    if (!(end > t)) return fmu_refuse(m, "the step size %g is below the rounding of t", step);
    if (m->numbers[FMU_HAS_ENDED] != 0.0) {
        *is_early = m->returns_early;
        return 0;
    }
    /* New inputs or parameters may move algebraic unknowns beyond the convergence of the
     * integrator. */
    if (m->numbers[FMU_IS_CHANGED] != 0.0 && fmu_refresh(m, FMU_POINT) != 0) return 1;
    if (set_up_job(m, &job, t, end) != 0) return 1;
    result = run_job(m, &job, &n_events);
    copy_results(m, &job, result);
    *reached = job.t;
    *is_early = m->returns_early && job.t != end; /* else an event ended the simulation */
    if (result != COTREE_JOB_FAILED) return 0;
    /* If a part of the step was computed, a shorter step succeeds. */
    m->may_discard = job.t > t;
    return log_failure(m, &job, n_events >= m->tables->most_events);
}
