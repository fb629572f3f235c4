/* cotree_batch.c: runs of the members of a batch, one after another in each thread. */
#if !defined(_WIN32) && !defined(_POSIX_C_SOURCE)
/* For clock_gettime. NOLINTNEXTLINE(bugprone-reserved-identifier,cert-dcl37-c,cert-dcl51-cpp) */
#define _POSIX_C_SOURCE 199309L
#endif

#include "cotree_batch.h"
#include "cotree_columns.h"
#include "cotree_events.h"

#include <limits.h>
#include <string.h>

#if defined(_WIN32)
#include <windows.h>
#else
#include <time.h>
#endif

/* Stage of a worker's current member. */
enum { TAKEN, BEGUN, DONE, CLOSED };

#define NOT_A_NUMBER ((double)NAN)

double cotree_batch_now(void)
{
#if defined(_WIN32)
    LARGE_INTEGER ticks, per_second;
    QueryPerformanceCounter(&ticks);
    QueryPerformanceFrequency(&per_second);
    return (double)ticks.QuadPart / (double)per_second.QuadPart;
#else
    struct timespec at;
    clock_gettime(CLOCK_MONOTONIC, &at);
    return (double)at.tv_sec + 1e-9 * (double)at.tv_nsec;
#endif
}

int cotree_batch_most_threads(void)
{
#if defined(__GNUC__) || defined(__clang__)
    return INT_MAX;
#else
    return 1;
#endif
}

/* Compute the prepared values and the start of a member. */
static int prepare_member(const cotree_batch *batch, int member, double *k, double *z,
                          int *is_dependent)
{
    static const cotree_start_call none;
    const cotree_job *const pattern = batch->pattern;
    const cotree_model *const model = pattern->model;
    cotree_start_call call = none;
    call.model = model;
    call.tables = batch->start_tables;
    call.p = batch->p + (size_t)member * (size_t)model->n_parameters;
    call.k = k;
    call.t = pattern->breakpoints[0];
    call.n_replaced = pattern->n_replaced;
    call.replaced = pattern->replaced;
    call.n_set = batch->n_set;
    call.set = batch->set;
    call.values = batch->set_values + (size_t)member * (size_t)batch->n_set;
    call.has_sensitivities = pattern->has_sensitivities;
    call.z = z;
    if (model->prepare(call.p, k) != 0 || batch->find_start(&call) != 0)
        return COTREE_MEMBER_REFUSED;
    *is_dependent = call.is_dependent;
    return call.is_dependent && batch->if_dependent == 2 ? COTREE_MEMBER_REFUSED : 0;
}

int cotree_batch_prepare(const cotree_batch *batch, int member, double *k, double *z)
{
    int is_dependent = 0;
    return prepare_member(batch, member, k, z, &is_dependent);
}

/* Write the data of the current member to its job, which is a copy of the pattern. */
static int set_member_data(cotree_worker *w)
{
    const cotree_batch *const batch = w->batch;
    const cotree_model *const model = batch->pattern->model;
    const size_t i = (size_t)w->member;
    cotree_job *const job = &w->job;
    int is_dependent = 0, status;
    job->p = batch->p + i * (size_t)model->n_parameters;
    job->k = w->k;
    job->u = w->u;
    job->z = w->z;
    if (batch->atols != NULL) job->atols = batch->atols + i * (size_t)job->n;
    if (batch->turn_tolerances != NULL) {
        job->turn_tolerances = batch->turn_tolerances + i * (size_t)model->n_sensitivities;
    }
    status = prepare_member(batch, w->member, w->k, w->z, &is_dependent);
    if (batch->if_dependent == 1) job->is_strict = is_dependent;
    return status;
}

/* Set up the job of the current member. */
static int begin_member(cotree_worker *w)
{
    const cotree_batch *const batch = w->batch;
    const size_t i = (size_t)w->member;
    cotree_job *const job = &w->job;
    *job = batch->has_given_jobs ? *w->given_job : *batch->pattern;
    job->times = w->times;
    job->values = batch->values + i * (size_t)job->n_wanted * (size_t)batch->n_full;
    job->records = w->records;
    job->most_records = w->most_records;
#if COTREE_HAS_CONSTRAINTS
    job->crossings = NULL; /* only the pattern's array records crossings */
#endif
    job->memory = w->memory;
    memset(w->memory, 0, batch->memory); /* removes data of the previous member */
    return batch->has_given_jobs ? 0 : set_member_data(w);
}

/* Evaluate the inputs at the stored points of a member. Given inputs replace those of the
 * scene. */
static int evaluate_inputs(cotree_worker *w, int n_points, const double *p, const double *k)
{
    const cotree_batch *const batch = w->batch;
    const cotree_model *const model = batch->pattern->model;
    int i, j, status = 0;
    for (i = 0; i < n_points && status == 0; ++i) {
        double *const u = w->inputs + (size_t)i * (size_t)model->n_inputs;
        const double *const given = batch->given_values + (size_t)i * (size_t)batch->n_given;
        status = model->inputs_of_time(batch->pattern->wanted[i], p, k, u);
        for (j = 0; j < batch->n_given; ++j) u[batch->given[j]] = given[j];
    }
    return status;
}

/* Copy the selected outputs. */
static void copy_outputs(const cotree_batch *batch, int n_rows, const double *all, double *kept)
{
    const size_t n_all = (size_t)batch->pattern->model->n_outputs, n = (size_t)batch->n_outputs;
    size_t i, j;
    for (i = 0; i < (size_t)n_rows; ++i) {
        for (j = 0; j < n; ++j) kept[i * n + j] = all[i * n_all + (size_t)batch->outputs[j]];
    }
}

static void fill_with_nan(double *first, int n_before, int n_rows, size_t width)
{
    size_t i;
    for (i = (size_t)n_before * width; i < (size_t)n_rows * width; ++i) first[i] = NOT_A_NUMBER;
}

int cotree_batch_finish(cotree_worker *w, int member, const double *k)
{
    const cotree_batch *const batch = w->batch;
    const cotree_job *const pattern = batch->pattern;
    const cotree_model *const model = pattern->model;
    const int n_wanted = pattern->n_wanted, n_kept = batch->n_kept[member];
    const int m = pattern->has_sensitivities ? model->n_sensitivities : 0;
    const size_t i = (size_t)member, first = i * (size_t)n_wanted, n = (size_t)batch->n_outputs;
    const double *const p = batch->p + i * (size_t)model->n_parameters;
    double *const z = batch->values + first * (size_t)batch->n_full;
    double *const y = batch->output_values + first * n;
    double *const dy = batch->output_slopes + first * n * (size_t)m;
    int status = 0;
    fill_with_nan(z, n_kept, n_wanted, (size_t)batch->n_full);
    if (batch->n_outputs == 0) return 0;
    if (batch->n_given > 0) status = evaluate_inputs(w, n_kept, p, k);
    if (status != 0 || cotree_columns(model, model->outputs_of_state, NULL, n_kept, pattern->wanted,
                                      z, batch->n_full, NULL, 0, p, k, NULL, batch->n_given > 0,
                                      w->inputs, w->outputs, model->n_outputs) < n_kept)
        return COTREE_MEMBER_NO_OUTPUTS;
    copy_outputs(batch, n_kept, w->outputs, y);
    fill_with_nan(y, n_kept, n_wanted, n);
    if (m == 0) return 0;
    if (cotree_columns(model, NULL, model->output_sensitivity, n_kept, pattern->wanted, z,
                       batch->n_full, z + model->n_states, batch->n_full, p, k, NULL, 1, w->inputs,
                       w->slopes, model->n_outputs * m) < n_kept)
        return COTREE_MEMBER_NO_OUTPUTS;
    copy_outputs(batch, n_kept * m, w->slopes, dy);
    fill_with_nan(dy, n_kept, n_wanted, n * (size_t)m);
    return 0;
}

/* Append the member's events to the worker's events. */
static void append_events(cotree_worker *w)
{
    const cotree_job *const job = &w->job;
    const int n_states = job->model->n_states;
    const int m = job->has_sensitivities ? job->model->n_sensitivities : 0;
    const size_t width = COTREE_EVENTS_RECORD((size_t)n_states, (size_t)m);
    int i, j;
    for (i = 0; i < job->n_records; ++i, ++w->n_events) {
        /* The worker's records may have been reallocated: the pointer in the job may be
         * outdated. */
        const double *const record = w->records + (size_t)i * width;
        double *const row = w->events + (size_t)w->n_events * (size_t)(3 + m);
        row[0] = (double)w->member;
        row[1] = record[1];
        row[2] = record[0];
        for (j = 0; j < m; ++j) row[3 + j] = record[2 + j];
    }
}

/* Store the counters of the job, and the code of its end. */
static void store_counters(cotree_worker *w, int ended)
{
    const cotree_batch *const batch = w->batch;
    const cotree_job *const job = &w->job;
    batch->n_kept[w->member] = job->n_kept;
    batch->n_steps[w->member] = job->n_steps;
    batch->corrections[w->member] = job->correction;
    batch->seconds[w->member] = cotree_batch_now() - w->begun;
    batch->ended[w->member] = ended;
}

void cotree_batch_close(cotree_worker *w)
{
    if (w->stage == BEGUN || w->stage == DONE) w->batch->end(&w->job);
    w->stage = CLOSED;
}

/* Finish a member that has reached its end, if there is space for its events. */
static int finish_member(cotree_worker *w)
{
    const cotree_batch *const batch = w->batch;
    int status;
    if (w->n_events + w->job.n_records > w->most_events) return COTREE_BATCH_NO_SPACE;
    status = cotree_batch_finish(w, w->member, w->job.k);
    batch->seconds[w->member] = cotree_batch_now() - w->begun;
    if (status != 0) {
        batch->ended[w->member] = status;
        return COTREE_BATCH_UNFINISHED;
    }
    append_events(w);
    w->member = -1;
    return COTREE_BATCH_AGAIN;
}

static int lacks_space(const cotree_job *job)
{
    if (job->records == NULL) return 0;
    return job->n_records + COTREE_EVENTS_AT_ONCE(COTREE_EVENTS_OF(job->model->hybrid)) >
           job->most_records;
}

/* Return the code of the exceeded limit, tested in the order of a single run; 0: none. */
static int exceeded_budget(const cotree_worker *w)
{
    const cotree_batch *const batch = w->batch;
    const cotree_job *const job = &w->job;
    if (job->most_events > 0 && job->n_records >= job->most_events) return COTREE_MEMBER_EVENTS;
    if (batch->max_steps > 0 && job->n_steps >= batch->max_steps) return COTREE_MEMBER_STEPS;
    if (batch->time_limit > 0.0 && cotree_batch_now() - w->begun > batch->time_limit)
        return COTREE_MEMBER_TIME;
    return 0;
}

/* Return control to the caller, which decides how the member continues. */
static int return_member(cotree_worker *w, int ended)
{
    store_counters(w, ended);
    return COTREE_BATCH_UNFINISHED;
}

/* Take some steps with the current member. */
static int take_steps(cotree_worker *w)
{
    const cotree_batch *const batch = w->batch;
    cotree_job *const job = &w->job;
    long most = COTREE_BATCH_STEPS;
    int result, over;
    job->records = w->records; /* the caller may have reallocated the records */
    job->most_records = w->most_records;
    if (lacks_space(job)) return COTREE_BATCH_NO_SPACE;
    if (batch->max_steps > 0 && batch->max_steps - job->n_steps < most) {
        most = batch->max_steps - job->n_steps;
    }
    w->stage = BEGUN;
    job->is_waiting = batch->is_watched && job->n_steps >= w->watched_from;
    result = batch->run(job, most);
    if (result == COTREE_JOB_FAILED) return return_member(w, COTREE_MEMBER_FAILED);
    if (result == COTREE_JOB_STIFF) return return_member(w, COTREE_MEMBER_STIFF);
    if (result == COTREE_JOB_MORE) {
        over = exceeded_budget(w);
        return over != 0 ? return_member(w, over) : COTREE_BATCH_AGAIN;
    }
    w->stage = DONE;
    store_counters(w, result == COTREE_JOB_STOPPED ? COTREE_MEMBER_STOPPED : COTREE_MEMBER_DONE);
    return finish_member(w);
}

/* Start another member. */
static int take_member(cotree_worker *w)
{
    cotree_batch_close(w);
    w->member = cotree_batch_take(w->batch);
    if (w->member < 0) return COTREE_BATCH_EMPTY;
    w->stage = TAKEN;
    w->watched_from = 0;
    w->begun = cotree_batch_now();
    return w->batch->has_given_jobs ? COTREE_BATCH_PREPARE : COTREE_BATCH_AGAIN;
}

/* Perform the next action. Return COTREE_BATCH_AGAIN if more follow. */
static int next_action(cotree_worker *w)
{
    int ended;
    if (w->member < 0) return take_member(w);
    if (w->stage == DONE) return finish_member(w);
    if (w->stage == BEGUN) return take_steps(w);
    ended = begin_member(w);
    return ended != 0 ? return_member(w, ended) : take_steps(w);
}

int cotree_batch_work(cotree_worker *w)
{
    const cotree_batch *const batch = w->batch;
    const double called = cotree_batch_now();
    int result = COTREE_BATCH_AGAIN;
    if (w->member < 0 && batch->lanes != NULL) return batch->lanes(w);
    while (result == COTREE_BATCH_AGAIN) {
        if (cotree_batch_is_stopped(batch)) return COTREE_BATCH_STOPPED;
        result = next_action(w);
        if (batch->interval > 0.0 && cotree_batch_now() - called > batch->interval) break;
    }
    return result;
}
