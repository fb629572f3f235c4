/* cotree_fmu_exchange.c: Model Exchange. The importer sets states; events are applied between its
 * steps. */
#include "cotree_fmu_internal.h"

#if COTREE_HAS_EXCHANGE
/* Reject a call unless n is the number of values of the block. */
static int check_numbers(fmu *m, enum fmu_block block, const double *values, size_t n)
{
    const int is_indicator = block == FMU_INDICATORS;
    const int wanted = fmu_size_of(m, is_indicator ? FMU_INDICATORS : FMU_RATES);
    fmu_evaluate(m);
    if (!m->is_exchanged) return fmu_refuse(m, "%s belongs to Model Exchange", m->function);
    if (n > 0 && fmu_check_pointer(m, values) != 0) return 1;
    if (n == (size_t)wanted) return 0;
    return fmu_refuse(m, "there are %d %s, not %lu", wanted,
                      is_indicator ? "event indicators" : "continuous states", (unsigned long)n);
}

int fmu_get_numbers(fmu *m, enum fmu_block block, double *values, size_t n)
{
    size_t i;
    if (check_numbers(m, block, values, n) != 0) return 1;
    for (i = 0; i < n; ++i) {
        if (fmu_get_value(m, (int)block, (int)i, values + i) != 0) return 1;
    }
    return 0;
}

int fmu_set_time(fmu *m, double t)
{
    if (!(fabs(t) <= DBL_MAX)) return fmu_refuse(m, "the time is not a finite number");
    m->numbers[FMU_NOW] = t;
    fmu_invalidate(m);
    return 0;
}

int fmu_set_states(fmu *m, const double *x, size_t n)
{
    size_t i;
    if (check_numbers(m, FMU_STATES, x, n) != 0) return 1;
    for (i = 0; i < n; ++i) {
        if (fabs(x[i]) <= DBL_MAX) continue;
        return fmu_discard(m, "state '%s' is set to a value that is not finite",
                           m->model->states[i].name);
    }
    for (i = 0; i < n; ++i) m->z[i] = x[i];
    fmu_invalidate(m);
    return 0;
}

#if COTREE_HAS_CONSTRAINTS
/* States are projected if a residual of the constraints exceeds this many tolerances. */
#define DRIFT_TOLERANCES 10.0

/* Determine whether the states have drifted off the constraints. */
static int find_drift(fmu *m, int *has_drifted)
{
    double *const found = m->residual;
    double largest = 1.0;
    int i;
    if (fmu_refresh(m, FMU_POINT) != 0) return 1;
    if (m->model->constraints(m->numbers[FMU_NOW], m->z, m->u, m->p, m->k, found) != 0) {
        return fmu_refuse(m, "the constraints cannot be evaluated at t = %.10g",
                          m->numbers[FMU_NOW]);
    }
    for (i = 0; i < N_RATES; ++i) largest = fmax(largest, fabs(m->z[i]));
    for (i = 0; i < m->model->n_constraints; ++i) {
        if (!(fabs(found[i]) <= DRIFT_TOLERANCES * m->numbers[FMU_TOLERANCE] * largest))
            *has_drifted = 1;
    }
    return 0;
}

static int project(fmu *m)
{
    int status;
    m->run.is_held = 1;
    status = cotree_run_project_all(&m->run, m->numbers[FMU_NOW], m->z);
    m->run.is_held = 0;
    if (status == 0) return 0;
    return fmu_refuse(m, "the constraints cannot be satisfied at t = %.10g", m->numbers[FMU_NOW]);
}
#endif

/* Request Event Mode if the states have drifted off the constraints: states may change only
 * there. */
int fmu_complete_step(fmu *m, int *enters_event_mode)
{
    if (fmu_check_pointer(m, enters_event_mode) != 0) return 1;
    *enters_event_mode = 0;
#if COTREE_HAS_CONSTRAINTS
    return find_drift(m, enters_event_mode);
#else
    return 0;
#endif
}

/* Find the current segment between time events, within which rates must be evaluated. */
static void find_segment(fmu *m)
{
    const double t = m->numbers[FMU_NOW],
                 next = cotree_next_breakpoint(&m->time_events, t, HUGE_VAL);
    const int is_last = !(next <= DBL_MAX);
    const double size =
        fmax(fabs(t), is_last ? 0.0 : cotree_largest_breakpoint(&m->time_events, next));
    const double margin = fmin(8.0 * DBL_EPSILON * size, is_last ? HUGE_VAL : 0.25 * (next - t));
    m->numbers[FMU_NEXT] = next;
    m->numbers[FMU_LOW] = cotree_is_breakpoint(&m->time_events, t) ? t + margin : -HUGE_VAL;
    m->numbers[FMU_HIGH] = is_last ? HUGE_VAL : next - margin;
    m->run.low = m->numbers[FMU_LOW];
    m->run.high = m->numbers[FMU_HIGH];
    fmu_invalidate(m);
}

static int apply_events(fmu *m, fmu_event_info *news)
{
    cotree_events *const e = fmu_events(m);
    const double t = m->numbers[FMU_NOW];
    double *const w = m->work;
    int i, status;
    fmu_set_projection(m, 1);
    cotree_run_narrow(&m->run, t, m->z, w);
    cotree_events_restore(e, m->event_history); /* the history is empty before the first update */
    if (m->numbers[FMU_IS_BEGUN] == 0.0) {
        status = cotree_events_begin(e, t, w);
    } else if (m->numbers[FMU_IS_CHANGED] != 0.0 || cotree_is_breakpoint(&m->time_events, t)) {
        status = cotree_events_resume(e, t, w, NULL); /* speeds may be discontinuous here */
    } else {
        status = cotree_events_apply_passed(e, t, w);
    }
    fmu_set_projection(m, 0);
    if (status != 0) {
        return fmu_refuse(m, "event '%s' stops the simulation at t = %.10g: %s",
                          m->model->hybrid->events[e->event].name, e->failure_time,
                          cotree_events_message(status));
    }
    cotree_events_save(e, m->event_history);
    if (cotree_run_complete(&m->run, t, w) != 0) {
        return fmu_refuse(m, "the algebraic unknowns cannot be solved for at t = %.10g", t);
    }
    for (i = 0; i < N_STATES; ++i) m->z[i] = m->run.full[i];
    news->terminates = e->terminal_event >= 0;
    for (i = 0; i < e->n_events; ++i) {
        if (e->has_fired[i]) fmu_log(m, FMU_OK, "event '%s' at t = %.10g", e->events[i].name, t);
    }
    return 0;
}

/* Process time events, constraints and events at the current point. */
static int update(fmu *m, fmu_event_info *news)
{
    int i, status = 0;
    news->terminates = news->are_states_changed = 0;
    if (fmu_prepare(m) != 0) return 1;
    find_segment(m);
    if (fmu_refresh(m, FMU_POINT) != 0) return 1;
    for (i = 0; i < N_RATES; ++i) m->before[i] = m->z[i];
#if COTREE_HAS_CONSTRAINTS
    status = project(m);
#endif
#if COTREE_HAS_EVENTS
    if (status == 0) status = apply_events(m, news);
#endif
    fmu_invalidate(m);
    if (status != 0) return status;
    m->numbers[FMU_IS_BEGUN] = 1.0;
    m->numbers[FMU_IS_CHANGED] = 0.0;
    for (i = 0; i < N_RATES; ++i) {
        if (m->z[i] != m->before[i]) news->are_states_changed = 1;
    }
    news->has_next = m->numbers[FMU_NEXT] <= DBL_MAX;
    news->next = news->has_next ? m->numbers[FMU_NEXT] : 0.0;
    return 0;
}

int fmu_enter_event_mode(fmu *m)
{
    fmu_enter(m, FMU_EVENT);
    return 0;
}

int fmu_update(fmu *m, fmu_event_info *news)
{
    return fmu_check_pointer(m, news) != 0 ? 1 : update(m, news);
}

/* Leave Event Mode. If no update was requested, perform one first. */
int fmu_leave_event_mode(fmu *m)
{
    fmu_event_info news;
    int status = m->numbers[FMU_IS_BEGUN] == 0.0 ? update(m, &news) : 0;
    if (status == 0) status = fmu_prepare(m);
    if (status == 0) fmu_enter(m, FMU_CONTINUOUS);
    return status;
}
#endif
