/* cotree_fmu_steps.c: Co-Simulation with one job for each communication step. */
#include "cotree_fmu_internal.h"

#if COTREE_HAS_STEPS
/* Relative tolerance of the start time of a step: importers accumulate rounding errors. */
#define TIME_RTOL 1e-9

/* Set the breakpoints of a job: the start, time events and the end. */
static int set_breakpoints(fmu *m, double t, double end, cotree_job *job)
{
#if COTREE_HAS_BREAKPOINTS
    const int n = cotree_most_breakpoints(&m->time_events, t, end);
    if (n < 0) {
        m->may_discard = 1; /* a shorter step may succeed */
        return fmu_discard(m,
                           "the step has too many time events to list: the shortest period is "
                           "%.6g s; check its unit, or take shorter steps",
                           cotree_shortest_period(&m->time_events));
    }
    if ((size_t)n > m->n_breakpoints) {
        const size_t width = 1 + 2 * (size_t)N_SENSITIVITIES;
        double *const more =
            (double *)realloc(m->breakpoints, 2 * (size_t)n * width * sizeof(double));
        if (more == NULL) return fmu_refuse(m, "out of memory");
        m->breakpoints = more;
        m->n_breakpoints = 2 * (size_t)n;
    }
    cotree_job_set_breakpoints(job, &m->time_events, t, end, m->numbers[FMU_BEGIN],
                               m->tables->sizes, m->tables->start_tables->seeds, m->breakpoints,
                               m->turn_tolerances);
#else
    m->breakpoints[0] = t;
    m->breakpoints[1] = end;
    job->breakpoints = m->breakpoints;
    job->n_breakpoints = 2;
    job->scale = fabs(end);
#endif
    return 0;
}

/* Return the maximum step size that resolves all pulses. Bounds of zero or nan are ignored. */
static double longest_step(const fmu *m)
{
    double longest = DBL_MAX;
#if COTREE_HAS_BREAKPOINTS
    int i;
    for (i = 0; i < m->tables->n_limits; ++i) {
        const double limit = fabs(m->limits[i]);
        if (limit > 0.0 && limit < longest) longest = limit;
    }
#else
    (void)m;
#endif
    return longest;
}

static void set_up_events(fmu *m, cotree_job *job)
{
    job->records = m->records;
    job->most_records = COTREE_EVENTS_AT_ONCE(N_EVENTS);
    job->watched = m->event_history;
    job->is_continued = m->numbers[FMU_IS_BEGUN] != 0.0;
    job->is_changed = m->numbers[FMU_IS_CHANGED] != 0.0;
    job->span = fmu_span(m);
    job->most_events = m->returns_early ? 1 : 0;
}

static int set_up_job(fmu *m, cotree_job *job, double t, double end)
{
    const fmu_tables *const tables = m->tables;
    size_t n_bytes;
    memset(job, 0, sizeof(*job));
    job->model = m->model;
    job->p = m->p;
    job->k = m->k;
    job->u = m->u;
#if COTREE_HAS_INPUTS
    job->input_function = tables->n_inputs > 0 ? fmu_write_inputs : NULL;
    job->input_context = m;
#endif
    job->has_sensitivities = N_SENSITIVITIES > 0;
#if COTREE_HAS_CONSTRAINTS
    job->is_held = 1;
    job->is_strict = tables->is_strict;
    job->constraints = tables->start_tables->assembly;
#endif
#if COTREE_HAS_ALGEBRAIC
    job->is_extended = tables->is_extended;
#endif
    job->stepper = tables->stepper();
    job->aid = tables->aid == NULL ? NULL : tables->aid();
    job->rtol = m->numbers[FMU_TOLERANCE];
    job->atol = tables->atol * (job->rtol / tables->rtol);
    cotree_job_set_tolerances(job, tables->is_implicit, tables->sizes, tables->start_tables->seeds,
                              m->atols);
    job->max_step = longest_step(m);
    job->z = m->z;
    job->t = t;
#if COTREE_HAS_EVENTS
    set_up_events(m, job);
#endif
    if (set_breakpoints(m, t, end, job) != 0) return 1;
    job->wanted = job->breakpoints; /* not read, since n_wanted is zero, but must not be NULL */
    n_bytes = cotree_job_memory(job);
    if (n_bytes > m->n_job_memory) {
        free(m->job_memory);
        m->job_memory = malloc(n_bytes);
        m->n_job_memory = m->job_memory == NULL ? 0 : n_bytes;
        if (m->job_memory == NULL) return fmu_refuse(m, "out of memory");
    }
    memset(m->job_memory, 0, n_bytes); /* removes data of the previous step */
    job->memory = m->job_memory;
    return 0;
}

/* Log why a job failed. n_events: number of events in the step. */
static int log_failure(fmu *m, const cotree_job *job, long n_events)
{
    if (job->status == COTREE_TOO_MANY_STEPS) {
        const int is_eventful = n_events >= m->tables->most_events;
        return fmu_discard(m, "the step stops at t = %.10g: the limit of %ld %s is reached", job->t,
                           is_eventful ? m->tables->most_events : m->tables->most_steps,
                           is_eventful ? "events" : "integrator steps");
    }
#if COTREE_HAS_MOVING_BREAKPOINTS
    if (job->status == COTREE_RUN_TURNED) {
        return fmu_discard(
            m,
            "the sensitivity of '%s' to '%s' does not exist from t = %.10g on: time events "
            "coincide there that depend on it differently",
            m->model->states[job->turned % N_STATES].name,
            m->model->sensitivities[job->turned / N_STATES - 1], job->t);
    }
#endif
#if COTREE_HAS_EVENTS
    if (job->status >= COTREE_EVENTS_FAILED) {
        return fmu_discard(m, "event '%s' stops the simulation at t = %.10g: %s",
                           m->model->hybrid->events[job->event].name, job->event_time,
                           cotree_events_message(job->status));
    }
#endif
    return fmu_discard(m, "the simulation stops at t = %.10g: %s", job->t,
                       cotree_status_message((cotree_status)job->status));
}

/* Log the events except jumps. Return their number. */
static int log_events(const fmu *m, cotree_job *job)
{
    const int width = COTREE_EVENTS_RECORD(N_STATES, N_SENSITIVITIES);
    int i, n_logged = 0;
    for (i = 0; i < job->n_records; ++i) {
        const cotree_event *const row = m->model->hybrid->events + (int)job->records[i * width + 1];
        if (row->kind == COTREE_JUMP) continue;
        fmu_log(m, FMU_OK, "event '%s' at t = %.10g", row->name, job->records[i * width]);
        ++n_logged;
    }
    job->n_records = 0;
    return n_logged;
}

/* Integrate to the end of the step or to the first event, within the limits of steps and events. */
static int run_job(fmu *m, cotree_job *job, long *n_events)
{
    int result = COTREE_JOB_MORE;
    while (result == COTREE_JOB_MORE) {
        int has_logged = 0;
        result = cotree_job_run(job, m->tables->most_steps - job->n_steps);
#if COTREE_HAS_EVENTS
        *n_events += job->n_records;
        has_logged = log_events(m, job) > 0;
#endif
        if (result != COTREE_JOB_MORE) break;
        if (m->returns_early && has_logged) {
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
    if (set_up_job(m, &job, t, cotree_next_breakpoint(&m->time_events, t, t + fmu_span(m))) != 0)
        return 1;
    result = cotree_job_start(&job);
    log_events(m, &job);
    copy_results(m, &job, result);
    return result == COTREE_JOB_FAILED ? log_failure(m, &job, 0) : 0;
}

static int check_step(const fmu *m, double t, double step)
{
    const double at = m->numbers[FMU_NOW], end = m->numbers[FMU_END];
    if (!(step > 0.0 && step <= DBL_MAX)) {
        return fmu_refuse(m, "the step size %g is not a positive number", step);
    }
    if (!(fabs(t - at) <= TIME_RTOL * fmax(1.0, fabs(at)))) {
        return fmu_refuse(m, "the step begins at t = %.10g, but the instance is at t = %.10g", t,
                          at);
    }
    if (!(t + step <= end + TIME_RTOL * fmax(1.0, fabs(end)))) {
        return fmu_refuse(m, "the step ends at t = %.10g, after the stop time %.10g", t + step,
                          end);
    }
    if (!(t + step > t)) return fmu_refuse(m, "the step size %g is below the rounding of t", step);
    return 0;
}

static int take_step(fmu *m, double t, double step, fmu_progress *progress)
{
    const double end = t + step;
    cotree_job job;
    long n_events = 0;
    int result;
    if (check_step(m, t, step) != 0 || fmu_prepare(m) != 0) return 1;
    if (m->numbers[FMU_HAS_ENDED] != 0.0) {
        progress->is_early = m->returns_early;
        return 0;
    }
    /* New inputs or parameters may change the algebraic unknowns so far that the integrator does
     * not converge: solve for them first. */
    if (m->numbers[FMU_IS_CHANGED] != 0.0 && fmu_refresh(m, FMU_POINT) != 0) return 1;
    if (set_up_job(m, &job, t, end) != 0) return 1;
    result = run_job(m, &job, &n_events);
    copy_results(m, &job, result);
    progress->reached = job.t;
    /* The step ended early. If the importer accepts no early return, a terminal event ended it. */
    progress->is_early = m->returns_early && job.t != end;
    if (result != COTREE_JOB_FAILED) return 0;
    /* If a part of the step was computed, a shorter step may succeed. */
    m->may_discard = job.t > t;
    return log_failure(m, &job, n_events);
}

int fmu_step(fmu *m, double t, double step, fmu_progress *progress)
{
    int result;
    if (fmu_check_pointer(m, progress) != 0) return 1;
    memcpy(m->spare, m->saved, m->n_saved * sizeof(double));
    progress->reached = m->numbers[FMU_NOW];
    progress->is_early = 0;
    result = take_step(m, t, step, progress);
    progress->terminates = m->numbers[FMU_HAS_ENDED] != 0.0;
    if (m->importer.version == 2 && progress->terminates) {
        m->may_discard = 1;
        result = fmu_discard(m, "the simulation ends at t = %.10g", progress->reached);
    }
    if (m->is_discarded && m->importer.version == 2) {
        /* The step has failed: the importer may only query the time reached, and then restore a
         * saved state or terminate. */
        fmu_enter(m, FMU_FAILED);
    } else if (m->is_discarded) {
        /* The state is unchanged, so that a shorter step may follow. */
        fmu_restore(m, m->spare);
    }
    return result;
}

int fmu_get_progress(fmu *m, int is_known, double *reached, int *has_ended)
{
    if (!is_known) {
        m->may_discard = 1;
        return fmu_discard(m, "%s: there is no such status, since steps are never pending",
                           m->function);
    }
    if (reached == NULL && fmu_check_pointer(m, has_ended) != 0) return 1;
    if (reached != NULL) {
        *reached = m->numbers[FMU_NOW];
    } else {
        *has_ended = m->numbers[FMU_HAS_ENDED] != 0.0;
    }
    return 0;
}
#endif
