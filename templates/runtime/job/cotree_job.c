/* cotree_job.c: the loop over steps, corners, wanted points and events, whatever takes the steps.
 * Part of the runtime of cotree, the same for every model and method.
 */
#include "cotree_job.h"
#include "cotree_stepper.h"

#include <float.h>
#include <math.h>
#include <stddef.h>

#define ENGINE (cotree_engine_of(job))
#define STEPPER (job->stepper)

/* Memory. */

cotree_run *cotree_job_begin_run(cotree_job *job, cotree_run *run, int has_sensitivities,
                                 cotree_room *room)
{
    cotree_run_init(run, job->model, job->p, cotree_job_prepared(job), job->u, has_sensitivities,
                    room);
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
    /* Corners are looked for forwards only, as events are. */
    return !job->is_tested && job->corners[job->n_corners - 1] >= job->corners[0];
}

/* Takes the job's own copy of the prepared values, where steps are to hold pieces. */
static void copy_prepared(cotree_job *job, cotree_room *room)
{
    const int n = job->model->n_prepared;
    cotree_real *own;
    int i;
    job->pieces = NULL;
    if (!has_events(job) || job->model->hybrid->n_branches == 0) return;
    own = cotree_take_doubles(room, n);
    if (room->base == NULL) return;
    for (i = 0; i < n; ++i) own[i] = job->k[i];
    job->pieces = own;
}

static int visit(cotree_real t, cotree_real *w, void *context);

/* Begins to watch events from where the job begins. */
static void watch(cotree_job *job, cotree_engine *e, cotree_room *room)
{
    const cotree_real own = job->corners[job->n_corners - 1] - job->corners[0];
    const cotree_real span = job->span > COTREE_F(0.0) ? job->span : own;
    cotree_events_init(&e->events, e->watched, job->n, span, job->rtol, job->atols, job->atol,
                       visit, job, room);
    e->events.records = job->records;
    if (job->pieces != NULL) {
        e->events.branches = job->pieces + job->model->n_prepared - job->model->hybrid->n_branches;
    }
    job->has_fired = e->events.has_fired;
}
#endif

/* Deals the memory out; what is only counted is left alone. */
static void lay_out_job(cotree_job *job, cotree_room *room)
{
    cotree_engine spare, *const e = (cotree_engine *)cotree_take(room, sizeof(spare), &spare);
#if COTREE_HAS_MOVING_CORNERS
    int i;
    for (i = 0; i < 4; ++i) e->room[i] = cotree_take_doubles(room, job->n);
#endif
    e->w = cotree_take_doubles(room, job->n);
    e->origin = COTREE_F(0.0);
    e->is_running = 0;
    e->is_helped = 0;
    e->n_short = 0;
#if COTREE_HAS_EVENTS || COTREE_HAS_HELPER
    e->before = cotree_take_doubles(room, job->n);
#endif
#if COTREE_HAS_EVENTS
    copy_prepared(job, room);
#endif
    STEPPER->lay_out(job, e, room);
#if COTREE_HAS_EVENTS
    if (has_events(job)) watch(job, e, room);
#endif
}

size_t cotree_job_memory(cotree_job *job)
{
    cotree_room room = {NULL, 0};
    lay_out_job(job, &room);
    return room.used;
}

static void begin_job(cotree_job *job)
{
    cotree_room room = {NULL, 0};
    room.base = (char *)job->memory;
    lay_out_job(job, &room);
    STEPPER->open(job);
}

/* Corners. */

/* Steps of a few units in the last place get nowhere; one of them is normal before a corner. */
#define STALL_STEPS COTREE_STALL_STEPS

static int is_short(cotree_real t_before, cotree_real t, cotree_real origin)
{
    return COTREE_FABS(t - t_before) <=
           COTREE_STALL_SPACINGS * COTREE_EPSILON * COTREE_FABS(t - origin);
}

cotree_real cotree_job_ahead(const cotree_job *job)
{
    return job->corners[job->n_corners - 1] > job->corners[0] ? COTREE_F(1.0) : -COTREE_F(1.0);
}

/* A few roundings of the times of two corners, and of what these are made of. */
static cotree_real margin_between(const cotree_job *job, cotree_real start, cotree_real end)
{
    const cotree_real size =
        COTREE_FMAX(COTREE_FMAX(COTREE_FABS(start), COTREE_FABS(end)), job->scale);
    return COTREE_FMIN(COTREE_F(8.0) * COTREE_EPSILON * size,
                       COTREE_F(0.25) * COTREE_FABS(end - start));
}

/* Keeps times a few roundings within both corners, so that no step meets both sides of a jump,
 * wherever the rounding of its time puts it. */
static void hold_between_corners(const cotree_job *job, cotree_run *run)
{
    const cotree_real start = job->corners[job->corner], end = job->corners[job->corner + 1];
    const cotree_real margin = margin_between(job, start, end);
    const int is_open = job->corner == 0 && !job->is_start_sharp;
    const int is_last = job->corner == job->n_corners - 2 && !job->is_end_sharp;
    const cotree_real first = is_open ? start : start + cotree_job_ahead(job) * margin;
    const cotree_real last = is_last ? end : end - cotree_job_ahead(job) * margin;
    run->low = COTREE_FMIN(first, last);
    run->high = COTREE_FMAX(first, last);
}

/* Points that are kept. */

/* Keeps a point: on the constraints, with its algebraic unknowns. is_exact: of a step's end. */
static int keep(cotree_job *job, cotree_real t, cotree_real *w, int is_exact)
{
    const cotree_run *const run = ENGINE->run;
    cotree_real *const row = job->values + (size_t)job->n_kept * (size_t)run->n_full;
    const int status = STEPPER->complete(job, t, w, is_exact);
    int i;
    if (status != COTREE_OK) return status;
    job->times[job->n_kept] = t;
    for (i = 0; i < run->n_full; ++i) row[i] = run->full[i];
    ++job->n_kept;
    return COTREE_OK;
}

/* Keeps a time that is known. */
static int keep_at(cotree_job *job, cotree_real t)
{
    cotree_real *w = NULL;
    int is_exact = 0;
    const int status = STEPPER->between(job, t, 0, &w, &is_exact);
    return status != COTREE_OK ? status : keep(job, t, w, is_exact);
}

/* Keeps what is wanted up to a time that is known. */
static int keep_wanted(cotree_job *job, cotree_real t_end)
{
    int status = COTREE_OK;
    while (job->n_kept < job->n_wanted && status == COTREE_OK) {
        const cotree_real t = job->wanted[job->n_kept];
        if (cotree_job_ahead(job) * (t - t_end) > COTREE_F(0.0)) break;
        status = keep_at(job, t);
    }
    return status;
}

/* Keeps what a step made known. */
static int keep_step(cotree_job *job, int is_last)
{
    if (job->wanted != NULL) return keep_wanted(job, STEPPER->known(job, is_last));
    /* Steps may be shorter than the rounding of t. */
    if (job->n_kept > 0 && job->times[job->n_kept - 1] == job->t) return COTREE_OK;
    return keep_at(job, job->t);
}

/* Ends. */

/* Writes where the job stands. */
static void finish(cotree_job *job)
{
    const cotree_engine *const e = ENGINE;
    int i;
    if (STEPPER->complete(job, job->t, e->w, 1) == COTREE_OK) {
        for (i = 0; i < e->run->n_full; ++i) job->z[i] = e->run->full[i];
    }
#if COTREE_HAS_CONSTRAINTS
    job->correction = COTREE_FMAX(e->run->correction, e->of_states->correction);
#endif
#if COTREE_HAS_EVENTS
    if (job->watched != NULL && has_events(job)) cotree_events_save(&e->events, job->watched);
#endif
}

static int give_up(cotree_job *job, int status)
{
#if COTREE_HAS_EVENTS
    const cotree_events *const events = &ENGINE->events;
    if (has_events(job)) {
        job->event = events->event;
        job->event_time = events->failure_time;
        job->event_detail = events->detail;
    }
#endif
    job->status = status;
    if (STEPPER->blame != NULL) STEPPER->blame(job, status);
    /* What is still wanted before the last good point. */
    if (job->wanted != NULL && ENGINE->is_running) keep_wanted(job, job->t);
    finish(job);
    return COTREE_JOB_FAILED;
}

#if COTREE_HAS_EVENTS
static int stop(cotree_job *job)
{
    job->event = ENGINE->events.terminal_event;
    finish(job);
    return COTREE_JOB_STOPPED;
}
#endif

/* Tells whether a stiff problem is worth another method. */
static int is_leaving(const cotree_job *job)
{
    const cotree_real left = COTREE_FABS(job->corners[job->n_corners - 1] - job->t);
    return job->is_waiting && job->is_stiff && left > COTREE_MOST_STIFF_STEPS * job->last_step;
}

/* Stands where another method may go on, or this one. */
static int leave(cotree_job *job)
{
    const int status = job->wanted != NULL ? keep_wanted(job, job->t) : COTREE_OK;
    if (status != COTREE_OK) return give_up(job, status);
    finish(job);
    return COTREE_JOB_STIFF;
}

#if COTREE_HAS_MOVING_CORNERS
/* What sensitivities do at corners whose times depend on parameters. */

/* Tells whether the time of a corner depends on a parameter, or what meets there does. */
static int is_moving(const cotree_job *job, int corner)
{
    const int m = job->model->n_sensitivities;
    int j;
    if (job->slopes == NULL || corner == job->n_corners - 1) return 0;
    for (j = corner * m; j < (corner + 1) * m; ++j) {
        if (job->slopes[j] != COTREE_F(0.0) || job->spreads[j] != COTREE_F(0.0)) return 1;
    }
    return 0;
}

/* Sets up what happens at a corner, in room that nothing else needs between two segments. */
static cotree_turn turn_of(cotree_job *job, int corner)
{
    const cotree_real start = job->corners[corner], end = job->corners[corner + 1];
    const int first = corner * job->model->n_sensitivities;
    const cotree_engine *const e = ENGINE;
    cotree_turn turn;
    turn.w = e->room[0];
    turn.left = e->room[1];
    turn.right = e->room[2];
    turn.again = e->room[3];
#if COTREE_HAS_CONSTRAINTS
    turn.is_constrained = job->is_held && job->model->n_constraints > 0;
#endif
    turn.slopes = job->slopes + first;
    turn.spreads = job->spreads + first;
    turn.tolerances = job->turn_tolerances;
    turn.rtol = job->rtol;
    turn.margin = cotree_job_ahead(job) * margin_between(job, start, end);
    turn.turned = 0;
    return turn;
}

/* Remembers the rates at the end of a segment, before its corner is passed. */
static int leave_segment(cotree_job *job)
{
    cotree_turn turn;
    if (!is_moving(job, job->corner + 1)) return 0;
    turn = turn_of(job, job->corner + 1);
    turn.margin = cotree_job_ahead(job) * margin_between(job, job->corners[job->corner], job->t);
    return cotree_run_leave(ENGINE->run, job->t, ENGINE->w, job->n, &turn) != 0 ? COTREE_NOT_SOLVED
                                                                                : 0;
}

/* Lets sensitivities jump behind a corner; what is kept there is what holds behind it. */
static int enter_segment(cotree_job *job)
{
    cotree_run *const run = ENGINE->run;
    const cotree_real low = run->low, high = run->high;
    cotree_turn turn;
    int status = 0;
    if (!is_moving(job, job->corner)) return 0;
    turn = turn_of(job, job->corner);
    if (job->corner == 0) { /* nothing was before: the rates just before it are taken here */
        run->low = COTREE_FMIN(job->t - turn.margin, job->t - COTREE_F(3.0) * turn.margin);
        run->high = COTREE_FMAX(job->t - turn.margin, job->t - COTREE_F(3.0) * turn.margin);
        status = cotree_run_leave(run, job->t, ENGINE->w, job->n, &turn);
        run->low = low;
        run->high = high;
    }
    if (status == 0) status = cotree_run_enter(run, job->t, ENGINE->w, job->n, &turn);
    job->turned = turn.turned;
    if (status != 0) return status == COTREE_RUN_TURNED ? status : COTREE_NOT_SOLVED;
    if (job->n_kept > 0 && job->times[job->n_kept - 1] == job->t) {
        --job->n_kept;
        status = keep(job, job->t, ENGINE->w, 1);
    }
    return status;
}
#endif

#if COTREE_HAS_EVENTS
/* What events do to a job. */

/* Writes the solution within the last step. */
static int visit(cotree_real t, cotree_real *w, void *context)
{
    cotree_job *const job = (cotree_job *)context;
    cotree_run *const run = ENGINE->watched;
    cotree_real *found = NULL;
    int i, is_exact = 0;
    const int status = STEPPER->between(job, t, 1, &found, &is_exact);
    if (status != COTREE_OK) return status;
    if (job->n != run->n) {
        cotree_run_unpack(run, found, run->full);
        cotree_run_leave_out(run, run->full, w); /* unknowns of polynomials are no guesses */
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

/* Puts the job where the events are, with algebraic unknowns where it has them. */
static int follow_events(cotree_job *job, cotree_real t)
{
    const cotree_events *const events = &ENGINE->events;
    const int status = cotree_run_give(events->run, t, events->w, job->n, ENGINE->w);
    return status == 0 ? COTREE_OK : COTREE_NOT_SOLVED;
}

/* Keeps what an event leaves, in place of what was before it. */
static int keep_after(cotree_job *job, cotree_real t)
{
    const int is_kept = job->n_kept > 0 && job->times[job->n_kept - 1] == t;
    int status = COTREE_OK;
    if (is_kept) --job->n_kept;
    if (is_kept || job->wanted == NULL) status = keep(job, t, ENGINE->w, 1);
    while (status == COTREE_OK && job->n_kept < job->n_wanted &&
           cotree_job_ahead(job) * (job->wanted[job->n_kept] - t) <= COTREE_F(0.0)) {
        status = keep(job, job->wanted[job->n_kept], ENGINE->w, 1);
    }
    return status;
}

/* Returns the derivatives of a corner's time by the parameters; NULL if it depends on none. */
static const cotree_real *slopes_of(const cotree_job *job, int corner)
{
#if COTREE_HAS_MOVING_CORNERS
    return job->slopes == NULL ? NULL : job->slopes + corner * job->model->n_sensitivities;
#else
    (void)job, (void)corner;
    return NULL;
#endif
}

/* Lets happen what does at a corner. */
static int look_at_corner(cotree_job *job)
{
    cotree_events *const events = &ENGINE->events;
    cotree_run *const run = events->run;
    const cotree_real t = job->corners[job->corner];
    cotree_real *const w = events->w;
    int status;
    cotree_run_take(run, t, job->n, ENGINE->w, w);
#if COTREE_HAS_CONSTRAINTS
    if (cotree_run_is_constrained(run) && cotree_run_project(t, w, run) != 0) {
        return COTREE_NOT_PROJECTED;
    }
#endif
    if (job->corner > 0) {
        status = cotree_events_resume(events, t, w, slopes_of(job, job->corner));
    } else if (!job->is_continued) {
        status = cotree_events_begin(events, t, w);
    } else {
        cotree_events_restore(events, job->watched);
        status = job->is_changed || job->is_start_sharp
                     ? cotree_events_resume(events, t, w, slopes_of(job, 0))
                     : cotree_events_continue(events, t, w);
    }
    if (status == COTREE_OK) status = follow_events(job, t);
    if (status == COTREE_OK && (events->n_fired > 0 || events->is_mode_changed))
        status = keep_after(job, t);
    return status;
}

/* Lets happen what was found within the last step. */
static int let_happen(cotree_job *job)
{
    cotree_events *const events = &ENGINE->events;
    int status = COTREE_OK;
    if (job->wanted != NULL) {
        status = keep_wanted(job, events->t - cotree_job_ahead(job) * events->margin);
    }
    job->t = events->t;
    if (status == COTREE_OK) status = follow_events(job, job->t);
    if (status == COTREE_OK) status = cotree_events_apply(events);
    if (status == COTREE_OK) status = follow_events(job, job->t);
    return status == COTREE_OK ? keep_after(job, job->t) : status;
}
#endif

/* The loop. */

static int restart(cotree_job *job)
{
    int status;
    ENGINE->n_short = 0;
    status = STEPPER->begin(job);
    ENGINE->is_running = status == COTREE_OK;
    ENGINE->is_helped = 0;
    return status;
}

#if COTREE_HAS_ALGEBRAIC && COTREE_HAS_HELPER
/* Finds algebraic unknowns behind a corner with help: they may have jumped too far there for what
 * is near to lead to them. Tells whether integration may begin anew with them. */
static int ask_for_unknowns(cotree_job *job)
{
    cotree_engine *const e = ENGINE;
    const cotree_real t = cotree_run_inside(e->run, job->t);
    if (job->helper == NULL || job->model->n_algebraic == 0) return 0;
    if (job->t != job->corners[job->corner]) return 0;
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
/* Says that a segment begins, from the point that the one before it left. */
static int tell_reach(cotree_job *job, int is_first)
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

/* Stands at a corner, where rates and with them sensitivities may jump, and events happen. */
static int begin_segment(cotree_job *job)
{
    const int is_first = job->corner == 0;
    int status = COTREE_OK;
    if (is_first) begin_job(job);
#if COTREE_HAS_INPUTS
    status = tell_reach(job, is_first);
    if (status != COTREE_OK) return status;
#endif
    ENGINE->is_running = 0;
    hold_between_corners(job, ENGINE->run);
    hold_between_corners(job, ENGINE->of_states);
#if COTREE_HAS_MOVING_CORNERS
    status = enter_segment(job);
#if COTREE_HAS_ALGEBRAIC && COTREE_HAS_HELPER
    if (status != COTREE_OK && ask_for_unknowns(job)) status = enter_segment(job);
#endif
#endif
#if COTREE_HAS_EVENTS
    if (status == COTREE_OK && has_events(job)) {
        hold_between_corners(job, ENGINE->watched);
        status = look_at_corner(job);
        if (ENGINE->events.terminal_event >= 0) return status;
    }
#endif
    if (status == COTREE_OK) {
        status = restart(job);
#if COTREE_HAS_ALGEBRAIC && COTREE_HAS_HELPER
        if (status != COTREE_OK && ask_for_unknowns(job)) status = restart(job);
#endif
    }
    if (status == COTREE_OK && is_first && (job->n_kept == 0 || job->wanted != NULL)) {
        status = keep_step(job, 0);
    }
    return status;
}

/* Goes on behind the end of a step, or of what an event left of it. */
static int pass_end(cotree_job *job)
{
    if (job->t == job->corners[job->corner + 1]) {
#if COTREE_HAS_MOVING_CORNERS
        const int status = leave_segment(job);
        if (status != COTREE_OK) return give_up(job, status);
#endif
        ++job->corner;
        job->is_begun = 0;
    }
    if (job->corner < job->n_corners - 1) return COTREE_JOB_MORE;
    finish(job);
    return COTREE_JOB_DONE;
}

#if COTREE_HAS_EVENTS
/* Goes on from what an event leaves. */
static int go_on_from_event(cotree_job *job)
{
    int status = let_happen(job);
    if (status != COTREE_OK) return give_up(job, status);
    if (ENGINE->events.terminal_event >= 0) return stop(job);
    if (job->t != job->corners[job->corner + 1]) status = restart(job);
    return status == COTREE_OK ? pass_end(job) : give_up(job, status);
}

/* Takes back the last step, for which something else failed. */
static int refuse_step(cotree_job *job, cotree_real start, int status)
{
    int i;
    job->t = start;
    for (i = 0; i < job->n; ++i) ENGINE->w[i] = ENGINE->before[i];
    return give_up(job, status);
}
#endif

/* Takes one step, and the corner at its end. */
static int advance(cotree_job *job)
{
    cotree_engine *const e = ENGINE;
    const cotree_real start = job->t, end = job->corners[job->corner + 1];
    int status, is_last;
#if COTREE_HAS_EVENTS
    if (has_events(job)) {
        int i;
        for (i = 0; i < job->n; ++i) e->before[i] = e->w[i];
    }
#endif
    status = STEPPER->step(job, end);
    if (status != COTREE_OK) return give_up(job, status);
    ++job->n_steps;
    job->last_step = COTREE_FABS(job->t - start);
    is_last = job->t == end;
    e->n_short = is_short(start, job->t, e->origin) ? e->n_short + 1 : 0;
    if (e->n_short == 0) job->entry = job->row = job->column = -1; /* it has found its way */
#if COTREE_HAS_EVENTS
    if (has_events(job)) {
        const int found = find_events(job, start, end);
        if (found == COTREE_EVENTS_FOUND) return go_on_from_event(job);
        if (found != COTREE_EVENTS_NONE) return refuse_step(job, start, found);
    }
#endif
    status = keep_step(job, is_last);
    if (status != COTREE_OK) return give_up(job, status);
    if (!is_last && e->n_short >= STALL_STEPS) return give_up(job, COTREE_STEP_TOO_SMALL);
    if (!is_last && is_leaving(job)) return leave(job);
    return pass_end(job);
}

/* Takes one step, or what begins a segment before it. */
static int go_on(cotree_job *job)
{
    int result;
    if (!job->is_begun) {
        const int status = begin_segment(job);
        if (status != COTREE_OK) return give_up(job, status);
#if COTREE_HAS_EVENTS
        if (has_events(job) && ENGINE->events.terminal_event >= 0) return stop(job);
#endif
        job->is_begun = 1;
    }
    result = advance(job);
#if COTREE_HAS_ALGEBRAIC && COTREE_HAS_HELPER
    if (result == COTREE_JOB_FAILED && ask_for_unknowns(job)) {
        const int status = restart(job);
        result = status == COTREE_OK ? advance(job) : give_up(job, status);
    }
#endif
    return result;
}

#if COTREE_HAS_EVENTS
/* Tells the events where to write; those of a job that has not begun are still to be laid out. */
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
        result = go_on(job);
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
    int status;
#if COTREE_HAS_EVENTS
    if (has_events(job)) open_records(job);
#endif
    status = begin_segment(job);
#if COTREE_HAS_EVENTS
    if (has_events(job)) job->n_records = ENGINE->events.n_records;
#endif
    if (status != COTREE_OK) return give_up(job, status);
#if COTREE_HAS_EVENTS
    if (has_events(job) && ENGINE->events.terminal_event >= 0) return stop(job);
#endif
    job->is_begun = 1;
    finish(job);
    return COTREE_JOB_MORE;
}
#endif

void cotree_job_stand(cotree_job *job)
{
    if (job->memory != NULL && job->n_steps > 0) finish(job);
}

void cotree_job_end(cotree_job *job)
{
    if (STEPPER->close != NULL) STEPPER->close(job);
}
