/* cotree_job.c: the integration loop over steps, time events, wanted points and events. */
#include "cotree_job.h"
#include "cotree_stepper.h"

#include <string.h>

#define ENGINE (cotree_engine_of(job))
#define STEPPER (job->stepper)

cotree_real cotree_job_sensitivity_atol(const cotree_job *job, int seed)
{
    const cotree_real size = seed < 0 ? COTREE_F(1.0) : COTREE_FABS(job->p[seed]);
    const cotree_real most = COTREE_SELECT(1e100, 1e12f);
    return size > COTREE_F(0.0) ? COTREE_FMIN(job->atol / size, most) : job->atol;
}

void cotree_job_set_tolerances(cotree_job *job, int is_implicit, const cotree_real *sizes,
                               const int *seeds, cotree_real *atols)
{
    const cotree_model *const model = job->model;
    const int n_rates = model->n_states - model->n_algebraic;
    const int n = is_implicit ? model->n_states : n_rates;
    int n_lead = n, k;
#if COTREE_HAS_SENSITIVITIES
    int i, j;
#endif
#if COTREE_HAS_ALGEBRAIC
    if (job->is_extended) n_lead = model->n_states;
#endif
    for (k = 0; k < n_lead; ++k) atols[k] = sizes == NULL ? job->atol : job->atol * sizes[k];
#if COTREE_HAS_SENSITIVITIES
    for (j = 0; job->has_sensitivities && j < model->n_sensitivities; ++j) {
        const cotree_real atol = cotree_job_sensitivity_atol(job, seeds[j]);
        for (i = model->sensitivity_starts[j]; i < model->sensitivity_starts[j + 1]; ++i) {
            const int row = model->sensitivity_rows[i];
            if (row < n) atols[k++] = sizes == NULL ? atol : atol * sizes[row];
        }
    }
#else
    (void)seeds;
#endif
    job->n = k;
    job->atols = atols;
}

cotree_run *cotree_job_begin_run(cotree_job *job, cotree_run *run, int has_sensitivities,
                                 cotree_arena *arena)
{
    cotree_run_init(run, job->model, job->p, cotree_job_prepared(job), job->u, has_sensitivities,
                    arena);
#if COTREE_HAS_INPUTS
    run->n_replaced = job->n_replaced;
    run->replaced = job->replaced;
    run->input_function = job->input_function;
    run->input_context = job->input_context;
#endif
#if COTREE_HAS_HELPER
    run->helper = job->helper;
#endif
#if COTREE_HAS_CONSTRAINTS
    run->is_held = job->is_held;
#endif
    run->atol = job->atol;
    return run;
}

#if COTREE_HAS_EVENTS
static int has_events(const cotree_job *job)
{
    const cotree_hybrid *const hybrid = job->model->hybrid;
    if (hybrid == NULL) return 0;
    if (COTREE_EVENTS_OF(hybrid) > 0) return 1;
    /* Kinks, like events, are only located in forward time. */
    return !job->is_tested && job->breakpoints[job->n_breakpoints - 1] >= job->breakpoints[0];
}

/* Copy the prepared values, which contain the frozen branches, if this job freezes branches. */
static void copy_prepared(cotree_job *job, cotree_arena *arena)
{
    const int n = job->model->n_prepared;
    cotree_real *own;
    int i;
    job->own_k = NULL;
    if (!has_events(job) || job->model->hybrid->n_branches == 0) return;
    own = cotree_arena_reals(arena, n);
    if (arena->base == NULL) return;
    for (i = 0; i < n; ++i) own[i] = job->k[i];
    job->own_k = own;
}

static int interpolate(cotree_real t, cotree_real *w, void *context);

static void init_events(cotree_job *job, cotree_engine *e, cotree_arena *arena)
{
    const cotree_real own = job->breakpoints[job->n_breakpoints - 1] - job->breakpoints[0];
    const cotree_real span = job->span > COTREE_F(0.0) ? job->span : own;
    cotree_events_init(&e->events, e->watched, job->n, span, job->rtol, job->atols, job->atol,
                       interpolate, job, arena);
    e->events.records = job->records;
    if (job->own_k != NULL) {
        e->events.branches = job->own_k + job->model->n_prepared - job->model->hybrid->n_branches;
    }
    job->has_fired = e->events.has_fired;
}
#endif

#if COTREE_HAS_CONSTRAINTS
static void lay_out_singularity(cotree_job *job, cotree_engine *e, cotree_arena *arena)
{
    cotree_singularity spare;
    if (job->constraints == NULL || job->constraints->n_rows == 0 || !job->is_held) return;
    e->singularity = (cotree_singularity *)cotree_arena_alloc(arena, sizeof(spare), &spare);
    cotree_singularity_init(e->singularity, job, e->of_states, arena);
}
#endif

/* Allocate the memory of the job, or count its bytes. */
static void lay_out_job(cotree_job *job, cotree_arena *arena)
{
    cotree_engine spare, *const e =
                             (cotree_engine *)cotree_arena_alloc(arena, sizeof(spare), &spare);
#if COTREE_HAS_MOVING_BREAKPOINTS
    int i;
#endif
    memset(e, 0, sizeof *e);
#if COTREE_HAS_MOVING_BREAKPOINTS
    for (i = 0; i < 4; ++i) e->work[i] = cotree_arena_reals(arena, job->n);
#endif
    e->w = cotree_arena_reals(arena, job->n);
#if COTREE_HAS_ALGEBRAIC
    e->return_time = -COTREE_INFINITY;
#endif
#if COTREE_HAS_EVENTS || COTREE_HAS_HELPER || COTREE_HAS_CONSTRAINTS || COTREE_HAS_ALGEBRAIC
    e->before = cotree_arena_reals(arena, job->n);
#endif
#if COTREE_HAS_EVENTS
    copy_prepared(job, arena);
#endif
    STEPPER->lay_out(job, e, arena);
#if COTREE_HAS_CONSTRAINTS
    lay_out_singularity(job, e, arena);
#endif
#if COTREE_HAS_EVENTS
    if (has_events(job)) init_events(job, e, arena);
#endif
}

size_t cotree_job_memory(cotree_job *job)
{
    cotree_arena arena = {NULL, 0};
    lay_out_job(job, &arena);
    return arena.used;
}

static void begin_job(cotree_job *job)
{
    cotree_arena arena = {NULL, 0};
    arena.base = (char *)job->memory;
    lay_out_job(job, &arena);
    STEPPER->open(job);
}

/* Return whether a step makes no progress: its length is a few units in the last place. */
static int is_short(cotree_real t_before, cotree_real t, cotree_real origin)
{
    return COTREE_FABS(t - t_before) <=
           COTREE_STALL_SPACINGS * COTREE_EPSILON * COTREE_FABS(t - origin);
}

cotree_real cotree_job_ahead(const cotree_job *job)
{
    return job->breakpoints[job->n_breakpoints - 1] > job->breakpoints[0] ? COTREE_F(1.0)
                                                                          : -COTREE_F(1.0);
}

/* Restrict evaluations to times inside the current segment. */
static void restrict_to_segment(const cotree_job *job, cotree_run *run)
{
    const int is_open = job->segment == 0 && !job->is_start_sharp;
    const int is_last = job->segment == job->n_breakpoints - 2 && !job->is_end_sharp;
    cotree_run_restrict(run, job->breakpoints[job->segment], job->breakpoints[job->segment + 1],
                        job->scale, is_open, is_last);
}

#if COTREE_HAS_ALGEBRAIC
/* Complete a point. At a fold, Newton's method may leave the branch of the accepted unknowns; the
 * accepted unknowns are then used. */
static int complete_on_branch(cotree_job *job, cotree_real t, cotree_real *w, int is_exact)
{
    const int status = STEPPER->complete(job, t, w, is_exact);
    cotree_run *const run = ENGINE->run;
    if (job->model->n_algebraic == 0 || !ENGINE->is_running || t != run->t_branch) return status;
    if (status != COTREE_OK || cotree_run_is_far(run, -1, run->full)) {
        cotree_run_keep(run, job->n, w);
        return COTREE_OK;
    }
    return status;
}
#else
#define complete_on_branch(job, t, w, is_exact) STEPPER->complete(job, t, w, is_exact)
#endif

/* Store a point, projected and with its algebraic unknowns. is_exact: the point is the end of a
 * step. */
static int store_point(cotree_job *job, cotree_real t, cotree_real *w, int is_exact)
{
    const cotree_run *const run = ENGINE->run;
    cotree_real *const row = job->values + (size_t)job->n_kept * (size_t)run->n_full;
    const int status = complete_on_branch(job, t, w, is_exact);
    if (status != COTREE_OK) return status;
    job->times[job->n_kept] = t;
    memcpy(row, run->full, (size_t)run->n_full * sizeof(cotree_real));
    ++job->n_kept;
    return COTREE_OK;
}

/* Store the solution at a time within the last step. */
static int store_at(cotree_job *job, cotree_real t)
{
    cotree_real *w = NULL;
    int is_exact = 0;
    const int status = STEPPER->between(job, t, 0, &w, &is_exact);
    return status != COTREE_OK ? status : store_point(job, t, w, is_exact);
}

/* Store the wanted points up to a time. Without any, all points are wanted: store none here. */
static int store_wanted(cotree_job *job, cotree_real t_end)
{
    int status = COTREE_OK;
    while (job->wanted != NULL && job->n_kept < job->n_wanted && status == COTREE_OK) {
        const cotree_real t = job->wanted[job->n_kept];
        if (cotree_job_ahead(job) * (t - t_end) > COTREE_F(0.0)) break;
        status = store_at(job, t);
    }
    return status;
}

/* Store the points that can be computed after the last step. */
static int store_step(cotree_job *job, int is_last)
{
    if (job->wanted != NULL) return store_wanted(job, STEPPER->known(job, is_last));
    /* If the step is shorter than the rounding of t, this time is already stored. */
    if (job->n_kept > 0 && job->times[job->n_kept - 1] == job->t) return COTREE_OK;
    return store_at(job, job->t);
}

/* Write the current point to the job. */
static void write_result(cotree_job *job)
{
    const cotree_engine *const e = ENGINE;
    int i;
    if (complete_on_branch(job, job->t, e->w, 1) == COTREE_OK) {
        for (i = 0; i < e->run->n_full; ++i) job->z[i] = e->run->full[i];
    }
#if COTREE_HAS_CONSTRAINTS
    job->correction = COTREE_FMAX(e->run->correction, e->of_states->correction);
#endif
#if COTREE_HAS_EVENTS
    if (job->watched != NULL && has_events(job)) cotree_events_save(&e->events, job->watched);
#endif
}

static int fail(cotree_job *job, int status)
{
#if COTREE_HAS_EVENTS
    const cotree_events *const events = &ENGINE->events;
    if (has_events(job)) {
        job->event = events->event;
        job->event_time = events->failure_time;
        job->event_detail = events->detail;
    }
#endif
#if COTREE_HAS_ALGEBRAIC
    /* Without constraints, a projection solves for algebraic unknowns only. */
    if (status == COTREE_PROJECTION_FAILED && job->model->n_constraints == 0)
        status = COTREE_NOT_SOLVED;
#endif
    job->status = status;
    if (STEPPER->blame != NULL) STEPPER->blame(job, status);
    /* Store wanted points before the last valid point. */
    if (ENGINE->is_running) store_wanted(job, job->t);
    write_result(job);
    return COTREE_JOB_FAILED;
}

#if COTREE_HAS_EVENTS
static int stop_at_event(cotree_job *job)
{
    job->event = ENGINE->events.terminal_event;
    write_result(job);
    return COTREE_JOB_STOPPED;
}
#endif

#if COTREE_HAS_HELPER
/* Return whether another method is likely to be faster for a stiff problem. */
static int is_method_change_worthwhile(const cotree_job *job)
{
    const cotree_real left = COTREE_FABS(job->breakpoints[job->n_breakpoints - 1] - job->t);
    return job->is_waiting && job->is_stiff && left > COTREE_MOST_STIFF_STEPS * job->last_step;
}

/* Return to the caller. This or another method can continue from the current point. */
static int return_stiff(cotree_job *job)
{
    const int status = store_wanted(job, job->t);
    if (status != COTREE_OK) return fail(job, status);
    write_result(job);
    return COTREE_JOB_STIFF;
}
#endif

#if COTREE_HAS_MOVING_BREAKPOINTS
/* Return whether the time of a breakpoint, or of one that coincides with it, depends on
 * parameters. */
static int is_moving(const cotree_job *job, int segment)
{
    const int m = job->model->n_sensitivities;
    int j;
    if (job->slopes == NULL || segment == job->n_breakpoints - 1) return 0;
    for (j = segment * m; j < (segment + 1) * m; ++j) {
        if (job->slopes[j] != COTREE_F(0.0) || job->spreads[j] != COTREE_F(0.0)) return 1;
    }
    return 0;
}

/* Return the data of a breakpoint. Its arrays are work space, which is unused between two
 * segments. */
static cotree_breakpoint_sensitivity breakpoint_data(cotree_job *job, int segment)
{
    const cotree_real start = job->breakpoints[segment], end = job->breakpoints[segment + 1];
    const int first = segment * job->model->n_sensitivities;
    const cotree_engine *const e = ENGINE;
    cotree_breakpoint_sensitivity crossing;
    crossing.w = e->work[0];
    crossing.left = e->work[1];
    crossing.right = e->work[2];
    crossing.work = e->work[3];
#if COTREE_HAS_CONSTRAINTS
    crossing.is_constrained = job->is_held && job->model->n_constraints > 0;
#endif
    crossing.slopes = job->slopes + first;
    crossing.spreads = job->spreads + first;
    crossing.tolerances = job->turn_tolerances;
    crossing.rtol = job->rtol;
    crossing.margin = cotree_job_ahead(job) * cotree_run_margin(start, end, job->scale);
    crossing.undefined = 0;
    return crossing;
}

/* Compute the rates at the end of a segment, before its breakpoint. */
static int compute_left_rates(cotree_job *job)
{
    cotree_breakpoint_sensitivity crossing;
    if (!is_moving(job, job->segment + 1)) return 0;
    crossing = breakpoint_data(job, job->segment + 1);
    crossing.margin = cotree_job_ahead(job) *
                      cotree_run_margin(job->breakpoints[job->segment], job->t, job->scale);
    return cotree_run_left_rates(ENGINE->run, job->t, ENGINE->w, job->n, &crossing) != 0
               ? COTREE_NOT_SOLVED
               : 0;
}

/* Apply the jump of the sensitivities at a breakpoint. A point that is stored there is replaced by
 * the point after the jump. */
static int jump_sensitivities(cotree_job *job)
{
    cotree_run *const run = ENGINE->run;
    const cotree_real low = run->low, high = run->high;
    cotree_breakpoint_sensitivity crossing;
    int status = 0;
    if (!is_moving(job, job->segment)) return 0;
    crossing = breakpoint_data(job, job->segment);
    if (job->segment == 0) { /* no previous segment: evaluate the rates before the start now */
        run->low = COTREE_FMIN(job->t - crossing.margin, job->t - COTREE_F(3.0) * crossing.margin);
        run->high = COTREE_FMAX(job->t - crossing.margin, job->t - COTREE_F(3.0) * crossing.margin);
        status = cotree_run_left_rates(run, job->t, ENGINE->w, job->n, &crossing);
        run->low = low;
        run->high = high;
    }
    if (status == 0)
        status = cotree_run_jump_sensitivities(run, job->t, ENGINE->w, job->n, &crossing);
    job->turned = crossing.undefined;
    if (status != 0) return status == COTREE_RUN_TURNED ? status : COTREE_NOT_SOLVED;
    if (job->n_kept > 0 && job->times[job->n_kept - 1] == job->t) {
        --job->n_kept;
        status = store_point(job, job->t, ENGINE->w, 1);
    }
    return status;
}
#endif

#if COTREE_HAS_EVENTS
/* Compute the solution at a time within the last step, to locate events. */
static int interpolate(cotree_real t, cotree_real *w, void *context)
{
    cotree_job *const job = (cotree_job *)context;
    cotree_run *const run = ENGINE->watched;
    cotree_real *found = NULL;
    int i, is_exact = 0;
    const int status = STEPPER->between(job, t, 1, &found, &is_exact);
    if (status != COTREE_OK) return status;
    if (job->n != run->n) {
        cotree_run_unpack(run, found, run->full);
        cotree_run_leave_out(run, run->full, w); /* interpolated unknowns are poor guesses */
    } else {
        for (i = 0; i < job->n; ++i) w[i] = found[i];
    }
    return COTREE_OK;
}

static int find_events(cotree_job *job, cotree_real start, cotree_real end)
{
    cotree_engine *const e = ENGINE;
    const cotree_history *const h = STEPPER->history == NULL ? NULL : STEPPER->history(job);
    return cotree_events_find(&e->events, start, e->before, job->t, e->w, end, h);
}

/* Move the job to the point of the events. Compute the algebraic unknowns if the job's points
 * include them. */
static int move_to_events(cotree_job *job, cotree_real t)
{
    const cotree_events *const events = &ENGINE->events;
    const int status = cotree_run_to_point(events->run, t, events->w, job->n, ENGINE->w);
    return status == 0 ? COTREE_OK : COTREE_NOT_SOLVED;
}

/* Store the point after an event instead of the point before it. */
static int store_after_events(cotree_job *job, cotree_real t)
{
    const int is_kept = job->n_kept > 0 && job->times[job->n_kept - 1] == t;
    int status = COTREE_OK;
    if (is_kept) --job->n_kept;
    if (is_kept || job->wanted == NULL) status = store_point(job, t, ENGINE->w, 1);
    while (status == COTREE_OK && job->n_kept < job->n_wanted &&
           cotree_job_ahead(job) * (job->wanted[job->n_kept] - t) <= COTREE_F(0.0)) {
        status = store_point(job, job->wanted[job->n_kept], ENGINE->w, 1);
    }
    return status;
}

/* Return the derivatives of a breakpoint time with respect to the parameters, or NULL if all
 * are zero. */
static const cotree_real *slopes_of(const cotree_job *job, int segment)
{
#if COTREE_HAS_MOVING_BREAKPOINTS
    return job->slopes == NULL ? NULL : job->slopes + segment * job->model->n_sensitivities;
#else
    (void)job, (void)segment;
    return NULL;
#endif
}

static int apply_breakpoint_events(cotree_job *job)
{
    cotree_events *const events = &ENGINE->events;
    cotree_run *const run = events->run;
    const cotree_real t = job->breakpoints[job->segment];
    cotree_real *const w = events->w;
    int status;
    cotree_run_from_point(run, t, job->n, ENGINE->w, w);
#if COTREE_HAS_CONSTRAINTS
    if (cotree_run_is_constrained(run) && cotree_run_project(t, w, run) != 0) {
        return COTREE_NOT_PROJECTED;
    }
#endif
    if (job->segment > 0) {
        status = cotree_events_resume(events, t, w, slopes_of(job, job->segment));
    } else if (!job->is_continued) {
        status = cotree_events_begin(events, t, w);
    } else {
        cotree_events_restore(events, job->watched);
        status = job->is_changed || job->is_start_sharp
                     ? cotree_events_resume(events, t, w, slopes_of(job, 0))
                     : cotree_events_continue(events, t, w);
    }
    if (status == COTREE_OK) status = move_to_events(job, t);
    if (status == COTREE_OK && (events->n_fired > 0 || events->is_mode_changed))
        status = store_after_events(job, t);
    return status;
}

static int apply_found_events(cotree_job *job)
{
    cotree_events *const events = &ENGINE->events;
    int status = store_wanted(job, events->t - cotree_job_ahead(job) * events->margin);
    job->t = events->t;
#if COTREE_HAS_ALGEBRAIC
    ENGINE->run->t_branch = -COTREE_INFINITY; /* the unknowns may jump */
#endif
    if (status == COTREE_OK) status = move_to_events(job, job->t);
    if (status == COTREE_OK) status = cotree_events_apply(events);
    if (status == COTREE_OK) status = move_to_events(job, job->t);
    return status == COTREE_OK ? store_after_events(job, job->t) : status;
}
#endif

static int restart_stepper(cotree_job *job)
{
    int status;
    ENGINE->n_short = 0;
    status = STEPPER->begin(job);
    ENGINE->is_running = status == COTREE_OK;
#if COTREE_HAS_ALGEBRAIC
    if (status == COTREE_OK && job->model->n_algebraic > 0) {
        if (ENGINE->is_repeated && cotree_run_is_far(ENGINE->run, job->n, ENGINE->w))
            return COTREE_FOLD;
        cotree_run_accept(ENGINE->run, job->t, job->n, ENGINE->w);
    }
#endif
    ENGINE->is_helped = 0;
    return status;
}

/* Restart the stepper after a breakpoint or an event. */
static int restart(cotree_job *job)
{
#if COTREE_HAS_CONSTRAINTS
    cotree_singularity *const s = ENGINE->singularity;
    if (s != NULL) cotree_singularity_restart(s, STEPPER->is_multistep);
#endif
    return restart_stepper(job);
}

#if COTREE_HAS_ALGEBRAIC && COTREE_HAS_HELPER
/* Solve for the algebraic unknowns after a breakpoint with the caller's solver, since the stored
 * guesses may be too far away. Return whether the integration can restart with them. */
static int solve_with_helper(cotree_job *job)
{
    cotree_engine *const e = ENGINE;
    const cotree_real t = cotree_run_inside(e->run, job->t);
    if (job->helper == NULL || job->model->n_algebraic == 0) return 0;
    if (job->t != job->breakpoints[job->segment]) return 0;
    if (STEPPER->complete(job, t, e->w, 1) != COTREE_OK) return 0;
    if (e->of_states != e->run) cotree_run_narrow(e->of_states, t, e->run->full, e->before);
    if (job->n != e->run->n) {
        cotree_run_pack(e->run, e->run->full, e->w);
    } else {
        cotree_run_leave_out(e->run, e->run->full, e->w);
    }
    e->is_helped = 1;
    return 1;
}
#endif

#if COTREE_HAS_INPUTS
/* Call reach at the start of a segment, with the end point of the previous segment. */
static int call_reach(cotree_job *job, int is_first)
{
    cotree_engine *const e = ENGINE;
    const cotree_real *z = job->z;
    if (job->reach == NULL) return COTREE_OK;
    if (!is_first) {
        const int status = STEPPER->complete(job, job->t, e->w, 1);
        if (status != COTREE_OK) return status;
        z = e->run->full;
    }
    return job->reach(job->t, z, job->input_context) == 0 ? COTREE_OK : COTREE_RATE_STOPPED;
}
#endif

/* Start a segment: apply jumps of sensitivities and events, and restart the stepper. */
static int begin_segment(cotree_job *job)
{
    const int is_first = job->segment == 0;
    int status = COTREE_OK;
    if (is_first) begin_job(job);
#if COTREE_HAS_INPUTS
    status = call_reach(job, is_first);
    if (status != COTREE_OK) return status;
#endif
    ENGINE->is_running = 0;
    restrict_to_segment(job, ENGINE->run);
    restrict_to_segment(job, ENGINE->of_states);
#if COTREE_HAS_MOVING_BREAKPOINTS
    status = jump_sensitivities(job);
#if COTREE_HAS_ALGEBRAIC && COTREE_HAS_HELPER
    if (status != COTREE_OK && solve_with_helper(job)) status = jump_sensitivities(job);
#endif
#endif
#if COTREE_HAS_EVENTS
    if (status == COTREE_OK && has_events(job)) {
        restrict_to_segment(job, ENGINE->watched);
        status = apply_breakpoint_events(job);
        if (ENGINE->events.terminal_event >= 0) return status;
    }
#endif
    if (status == COTREE_OK) {
        status = restart(job);
#if COTREE_HAS_ALGEBRAIC && COTREE_HAS_HELPER
        if (status != COTREE_OK && solve_with_helper(job)) status = restart(job);
#endif
    }
    if (status == COTREE_OK && is_first && (job->n_kept == 0 || job->wanted != NULL)) {
        status = store_step(job, 0);
    }
    return status;
}

/* Continue after the end of a step or after an event. At a breakpoint, enter the next segment. */
static int end_step(cotree_job *job)
{
    if (job->t == job->breakpoints[job->segment + 1]) {
#if COTREE_HAS_MOVING_BREAKPOINTS
        const int status = compute_left_rates(job);
        if (status != COTREE_OK) return fail(job, status);
#endif
        ++job->segment;
        job->is_begun = 0;
    }
    if (job->segment < job->n_breakpoints - 1) return COTREE_JOB_MORE;
    write_result(job);
    return COTREE_JOB_DONE;
}

#if COTREE_HAS_EVENTS
static int continue_after_events(cotree_job *job)
{
    int status = apply_found_events(job);
    if (status != COTREE_OK) return fail(job, status);
    if (ENGINE->events.terminal_event >= 0) return stop_at_event(job);
    if (job->t != job->breakpoints[job->segment + 1]) status = restart(job);
    return status == COTREE_OK ? end_step(job) : fail(job, status);
}

/* Reject the last step because its events or stored points failed. */
static int reject_step(cotree_job *job, cotree_real start, int status)
{
    job->t = start;
    memcpy(ENGINE->w, ENGINE->before, (size_t)job->n * sizeof(cotree_real));
    return fail(job, status);
}
#endif

#if COTREE_HAS_ALGEBRAIC
/* Return whether the algebraic unknowns jumped to another solution within the last step. Accept
 * them if they did not. */
static int is_beyond_fold(cotree_job *job)
{
    cotree_engine *const e = ENGINE;
    cotree_run *const run = e->run;
    if (job->model->n_algebraic == 0) return 0;
    if (cotree_run_is_far(run, job->n, e->w) &&
        !cotree_run_is_continuous(run, job->t, job->n, e->before, e->w))
        return 1;
    cotree_run_accept(run, job->t, job->n, e->w);
    return 0;
}

/* Return to the start of the last step and to its algebraic unknowns, because trial steps may have
 * found other solutions. */
static void return_to(cotree_job *job, cotree_real start)
{
    cotree_engine *const e = ENGINE;
    cotree_run *const runs[3] = {e->run, e->of_states, e->watched};
    int i;
    job->t = start;
    memcpy(e->w, e->before, (size_t)job->n * sizeof(cotree_real));
    for (i = 0; i < 3 && job->model->n_algebraic > 0; ++i)
        cotree_run_return(runs[i], start, e->run->branch);
}

/* Repeat a failed step towards another goal. status: reason of the failure. */
static int restart_towards(cotree_job *job, cotree_real goal, int status)
{
    int result = store_wanted(job, job->t);
    ENGINE->is_repeated = 1;
    ENGINE->goal = goal;
    if (result == COTREE_OK) result = restart(job);
#if COTREE_HAS_SUNDIALS
    job->flag = 0;
#endif
    if (result == COTREE_OK) return COTREE_JOB_MORE;
    return fail(job, result == COTREE_FOLD ? COTREE_FOLD : status);
}

/* Return the minimum length of a step towards a fold. */
static cotree_real shortest_to_fold(const cotree_job *job)
{
    const cotree_real span = job->breakpoints[job->n_breakpoints - 1] - job->breakpoints[0];
    return COTREE_SELECT(1e-9, 1e-5f) * COTREE_FABS(span);
}

/* After a step that ended beyond a fold, retry with a quarter of its length, or fail. */
static int return_before_fold(cotree_job *job, cotree_real start)
{
    const cotree_real length = COTREE_F(0.25) * (job->t - start);
    return_to(job, start);
    if (COTREE_FABS(length) <= shortest_to_fold(job)) return fail(job, COTREE_FOLD);
    return restart_towards(job, start + length, COTREE_FOLD);
}

/* Repeat a failed step once with the algebraic unknowns at its start, or fail. */
static int repeat_step(cotree_job *job, cotree_real start, int status)
{
    if (job->model->n_algebraic > 0) {
        const cotree_real moved = COTREE_FABS(start - ENGINE->return_time);
        const int is_last = moved <= shortest_to_fold(job) || status == COTREE_RATE_STOPPED;
        ENGINE->return_time = start;
        return_to(job, start);
        if (!is_last) return restart_towards(job, job->breakpoints[job->segment + 1], status);
    }
    return fail(job, status);
}
#else
#define repeat_step(job, start, status) ((void)(start), fail(job, status))
#endif

#if COTREE_HAS_CONSTRAINTS
/* Store the wanted points of the last step, enter a singular stretch and restart. */
static int change_stretch(cotree_job *job, cotree_stretch stretch)
{
    int status = ENGINE->is_running ? store_wanted(job, job->t) : COTREE_OK;
    if (status != COTREE_OK) return fail(job, status);
    cotree_singularity_enter(ENGINE->singularity, job, stretch, cotree_job_ahead(job));
    status = restart_stepper(job);
    return status == COTREE_OK ? COTREE_JOB_MORE : fail(job, status);
}

static int is_near_singularity(cotree_job *job)
{
    cotree_engine *const e = ENGINE;
    if (STEPPER->complete(job, job->t, e->w, 1) != COTREE_OK) return 0;
    return cotree_singularity_is_near(e->singularity, job->t, e->run->full);
}

/* Record the start of a stretch with loosened tolerances. */
static void record_crossing(cotree_job *job)
{
    const int n = job->model->n_states;
    if (job->crossings != NULL && job->n_crossed < job->most_crossings) {
        cotree_real *const row = job->crossings + job->n_crossed * (1 + n);
        int i;
        row[0] = job->t;
        for (i = 0; i < n; ++i) row[1 + i] = ENGINE->run->full[i];
    }
    ++job->n_crossed;
}

/* Return the nearer of the ends of the segment and of the stretch. */
static cotree_real step_goal(const cotree_job *job, cotree_real end)
{
    const cotree_singularity *const s = ENGINE->singularity;
    if (s->stretch == COTREE_ORDINARY) return end;
    return cotree_job_ahead(job) * (end - s->end) > COTREE_F(0.0) ? s->end : end;
}

/* Reset the job to an earlier point. */
static void move_back(cotree_job *job, cotree_real t, const cotree_real *w)
{
    int i;
    for (i = 0; i < job->n; ++i) ENGINE->w[i] = w[i];
    job->t = t;
    while (job->n_kept > 0 &&
           cotree_job_ahead(job) * (job->times[job->n_kept - 1] - t) > COTREE_F(0.0)) {
        --job->n_kept;
    }
}

/* Enter a stretch near a singular position. A stretch with loosened tolerances begins where the
 * projected rates began, since rounding errors are smaller there. */
static int enter_stretch(cotree_job *job, cotree_stretch stretch)
{
    cotree_singularity *const s = ENGINE->singularity;
    int i;
    if (stretch == COTREE_STRICT) {
        s->start = job->t;
        for (i = 0; i < job->n; ++i) s->w[i] = ENGINE->w[i];
        s->has_start = 1;
        return change_stretch(job, stretch);
    }
    if (s->has_start) move_back(job, s->start, s->w);
    record_crossing(job);
    return change_stretch(job, stretch);
}

/* After a failed step near a singular position, enter a stretch; elsewhere fail. */
static int retry_near_singularity(cotree_job *job, cotree_real start, int status)
{
    const cotree_singularity *const s = ENGINE->singularity;
    if (s != NULL && status != COTREE_RATE_STOPPED) {
        const cotree_stretch next = cotree_singularity_next(s, job);
        if (next != s->stretch && is_near_singularity(job)) return enter_stretch(job, next);
    }
    return repeat_step(job, start, status);
}

/* If the step from start is short near a singular position, undo it and enter a stretch with
 * projected rates. Return COTREE_JOB_DONE if the step is kept. */
static int undo_short_step(cotree_job *job, cotree_real start)
{
    cotree_engine *const e = ENGINE;
    cotree_singularity *const s = e->singularity;
    s->next = cotree_singularity_watch(s, job, STEPPER->is_multistep);
    if (s->next != COTREE_STRICT || s->stretch == COTREE_STRICT) return COTREE_JOB_DONE;
    if (!is_near_singularity(job)) return COTREE_JOB_DONE;
    move_back(job, start, e->before);
    --job->n_steps;
    ++job->n_rejected;
    return enter_stretch(job, COTREE_STRICT);
}

/* Before a step, loosen the tolerances if steps remain short near a singular position, or leave a
 * stretch at its end. Return COTREE_JOB_DONE if nothing changes. */
static int begin_watched_step(cotree_job *job)
{
    cotree_engine *const e = ENGINE;
    const cotree_singularity *const s = e->singularity;
    if (s->next == COTREE_LOOSE && s->stretch != COTREE_LOOSE && is_near_singularity(job)) {
        return enter_stretch(job, COTREE_LOOSE);
    }
    if (s->stretch == COTREE_ORDINARY) return COTREE_JOB_DONE;
    if (cotree_job_ahead(job) * (s->end - job->t) > COTREE_F(0.0)) return COTREE_JOB_DONE;
    return change_stretch(job, COTREE_ORDINARY);
}
#endif

/* Take one step. If it ends at a breakpoint, enter the next segment. */
static int advance(cotree_job *job)
{
    cotree_engine *const e = ENGINE;
    const cotree_real start = job->t, end = job->breakpoints[job->segment + 1];
    cotree_real goal = end;
    int status, is_last;
#if COTREE_HAS_EVENTS || COTREE_HAS_CONSTRAINTS || COTREE_HAS_ALGEBRAIC
    memcpy(e->before, e->w, (size_t)job->n * sizeof(cotree_real));
#endif
#if COTREE_HAS_CONSTRAINTS
    if (e->singularity != NULL) {
        const int result = begin_watched_step(job);
        if (result != COTREE_JOB_DONE) return result;
        goal = step_goal(job, end);
    }
#endif
#if COTREE_HAS_ALGEBRAIC
    if (e->is_repeated) goal = e->goal;
    e->is_repeated = 0;
#endif
    status = STEPPER->step(job, goal);
#if COTREE_HAS_CONSTRAINTS
    if (status != COTREE_OK) return retry_near_singularity(job, start, status);
#else
    if (status != COTREE_OK) return repeat_step(job, start, status);
#endif
#if COTREE_HAS_ALGEBRAIC
    if (is_beyond_fold(job)) return return_before_fold(job, start);
#endif
    ++job->n_steps;
    job->last_step = COTREE_FABS(job->t - start);
    is_last = job->t == end;
    e->n_short = is_short(start, job->t, e->origin) ? e->n_short + 1 : 0;
    if (e->n_short == 0)
        job->entry = job->row = job->column = -1; /* clears an earlier failure that was resolved */
#if COTREE_HAS_CONSTRAINTS
    if (e->singularity != NULL && !is_last) {
        const int result = undo_short_step(job, start);
        if (result != COTREE_JOB_DONE) return result;
    }
#endif
#if COTREE_HAS_EVENTS
    if (has_events(job)) {
        int found = find_events(job, start, end);
        if (found == COTREE_EVENTS_FOUND) return continue_after_events(job);
        if (found == COTREE_EVENTS_NONE && e->events.leaves_branch) {
            status = store_wanted(job, job->t);
            if (status != COTREE_OK) return fail(job, status);
            found = cotree_events_change_branches(&e->events);
        }
        if (found != COTREE_EVENTS_NONE) return reject_step(job, start, found);
    }
#endif
    status = store_step(job, is_last);
    if (status != COTREE_OK) return fail(job, status);
    if (!is_last && e->n_short >= COTREE_STALL_STEPS) return fail(job, COTREE_STEP_TOO_SMALL);
#if COTREE_HAS_HELPER
    if (!is_last && is_method_change_worthwhile(job)) return return_stiff(job);
#endif
    return end_step(job);
}

/* Start a segment; the job may end at its first point. */
static int enter_segment(cotree_job *job)
{
    const int status = begin_segment(job);
    if (status != COTREE_OK) return fail(job, status);
#if COTREE_HAS_EVENTS
    if (has_events(job) && ENGINE->events.terminal_event >= 0) return stop_at_event(job);
#endif
    job->is_begun = 1;
    return COTREE_JOB_MORE;
}

/* Take one step, in a new segment if none has been started. */
static int next_step(cotree_job *job)
{
    int result = job->is_begun ? COTREE_JOB_MORE : enter_segment(job);
    if (result != COTREE_JOB_MORE) return result;
    result = advance(job);
#if COTREE_HAS_ALGEBRAIC && COTREE_HAS_HELPER
    if (result == COTREE_JOB_FAILED && solve_with_helper(job)) {
        const int status = restart(job);
        result = status == COTREE_OK ? advance(job) : fail(job, status);
    }
#endif
    return result;
}

#if COTREE_HAS_EVENTS
/* Write the records of events to the job. The events exist once the job has started. */
static void open_records(cotree_job *job)
{
    cotree_events *const events = &ENGINE->events;
    events->records = job->records;
    events->n_records = job->n_records;
    events->n_evaluations = 0;
}
#endif

int cotree_job_run(cotree_job *job, long most_steps)
{
#if COTREE_HAS_EVENTS
    const int n_at_once =
        has_events(job) ? COTREE_EVENTS_AT_ONCE(COTREE_EVENTS_OF(job->model->hybrid)) : 0;
#endif
    int result = COTREE_JOB_MORE;
    long i;
    for (i = 0; i < most_steps && result == COTREE_JOB_MORE; ++i) {
#if COTREE_HAS_EVENTS
        if (job->records != NULL && job->n_records + n_at_once > job->most_records) break;
        if (job->most_events > 0 && job->n_records >= job->most_events) break;
        if (has_events(job)) open_records(job);
#endif
        result = next_step(job);
#if COTREE_HAS_EVENTS
        if (has_events(job)) {
            job->n_records = ENGINE->events.n_records;
            job->n_evaluations += ENGINE->events.n_evaluations;
        }
#endif
    }
    return result;
}

#if COTREE_HAS_EVENTS || COTREE_HAS_HELPER
int cotree_job_start(cotree_job *job)
{
    int result;
#if COTREE_HAS_EVENTS
    if (has_events(job)) open_records(job);
#endif
    result = enter_segment(job);
#if COTREE_HAS_EVENTS
    if (has_events(job)) job->n_records = ENGINE->events.n_records;
#endif
    if (result == COTREE_JOB_MORE) write_result(job);
    return result;
}
#endif

void cotree_job_sync(cotree_job *job)
{
    if (job->memory != NULL && job->n_steps > 0) write_result(job);
}

#if COTREE_HAS_SUNDIALS
void cotree_job_end(cotree_job *job)
{
    if (STEPPER->close != NULL) STEPPER->close(job);
}
#endif
