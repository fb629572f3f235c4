/* fmu_exchange.c: Model Exchange: the importer sets states, and events are applied between its
 * steps.
 * Part of the runtime of cotree, the same for every model. */
#include "fmu.h"

#include <float.h>
#include <math.h>

#define N_STATES (m->model->n_states)
#define N_RATES (m->model->n_states - m->model->n_algebraic)

/* States are projected if a residual of the constraints exceeds this many tolerances. */
#define DRIFT_TOLERANCES 10.0

static int check_length(const fmu *m, size_t n, int wanted, const char *what)
{
    if (n == (size_t)wanted) return 0;
    return fmu_refuse(m, "there are %d %s, not %lu", wanted, what, (unsigned long)n);
}

int fmu_set_time(fmu *m, double t)
{
    if (!(fabs(t) <= DBL_MAX)) return fmu_refuse(m, "the time is no finite number");
    m->numbers[FMU_NOW] = t;
    fmu_invalidate(m);
    return 0;
}

int fmu_set_states(fmu *m, const double *x, size_t n)
{
    int i;
    if (check_length(m, n, N_RATES, "continuous states") != 0) return 1;
    for (i = 0; i < N_RATES; ++i) {
        if (!(fabs(x[i]) <= DBL_MAX)) {
            return fmu_discard(m, "state '%s' is set to a value that is not finite",
                               m->model->states[i].name);
        }
    }
    for (i = 0; i < N_RATES; ++i) m->z[i] = x[i];
    fmu_invalidate(m);
    return 0;
}

int fmu_get_states(fmu *m, double *x, size_t n)
{
    int i;
    if (check_length(m, n, N_RATES, "continuous states") != 0) return 1;
    if (fmu_refresh(m, FMU_POINT) != 0) return 1;
    for (i = 0; i < N_RATES; ++i) x[i] = m->z[i];
    return 0;
}

int fmu_get_rates(fmu *m, double *dx, size_t n)
{
    int i;
    if (check_length(m, n, N_RATES, "continuous states") != 0) return 1;
    if (fmu_refresh(m, FMU_HAS_RATES) != 0) return 1;
    for (i = 0; i < N_RATES; ++i) dx[i] = m->dx[i];
    return 0;
}

int fmu_get_indicators(fmu *m, double *g, size_t n)
{
    const int n_events = m->model->hybrid == NULL ? 0 : m->model->hybrid->n_events;
    int i;
    if (check_length(m, n, n_events, "event indicators") != 0) return 1;
    if (n_events == 0) return 0;
    if (fmu_refresh(m, FMU_HAS_INDICATORS) != 0) return 1;
    for (i = 0; i < n_events; ++i) g[i] = m->g[i];
    return 0;
}

int fmu_get_nominals(fmu *m, double *sizes, size_t n)
{
    int i;
    if (check_length(m, n, N_RATES, "continuous states") != 0) return 1;
    for (i = 0; i < N_RATES; ++i) sizes[i] = m->tables->sizes == NULL ? 1.0 : m->tables->sizes[i];
    return 0;
}

/* Request Event Mode if the states have drifted from the constraints: they may be projected
 * there. */
int fmu_complete_step(fmu *m, int *enters_event_mode)
{
    double *const found = m->solved;
    double largest = 1.0;
    int i;
    *enters_event_mode = 0;
    if (m->model->n_constraints == 0) return 0;
    if (fmu_refresh(m, FMU_POINT) != 0) return 1;
    if (m->model->constraints(m->numbers[FMU_NOW], m->z, m->u, m->p, m->k, found) != 0) {
        return fmu_refuse(m, "the constraints have no values at t = %.10g", m->numbers[FMU_NOW]);
    }
    for (i = 0; i < N_RATES; ++i) largest = fmax(largest, fabs(m->z[i]));
    for (i = 0; i < m->model->n_constraints; ++i) {
        if (!(fabs(found[i]) <= DRIFT_TOLERANCES * m->numbers[FMU_TOLERANCE] * largest))
            *enters_event_mode = 1;
    }
    return 0;
}

/* Find the segment between time events: no evaluation may lie beyond either of them. */
static void find_segment(fmu *m)
{
    const double t = m->numbers[FMU_NOW], next = fmu_next_stop(m, t, HUGE_VAL);
    const int is_last = !(next <= DBL_MAX);
    const double size = fmax(fabs(t), is_last ? 0.0 : fmu_largest_stop(m, next));
    const double margin = fmin(8.0 * DBL_EPSILON * size, is_last ? HUGE_VAL : 0.25 * (next - t));
    m->numbers[FMU_NEXT] = next;
    m->numbers[FMU_LOW] = fmu_is_stop(m, t) ? t + margin : -HUGE_VAL;
    m->numbers[FMU_HIGH] = is_last ? HUGE_VAL : next - margin;
    m->run.low = m->numbers[FMU_LOW];
    m->run.high = m->numbers[FMU_HIGH];
    fmu_invalidate(m);
}

static int project(fmu *m)
{
    int status;
    if (m->model->n_constraints == 0) return 0;
    m->run.is_held = 1;
    status = cotree_run_project_all(&m->run, m->numbers[FMU_NOW], m->z);
    m->run.is_held = 0;
    if (status == 0) return 0;
    return fmu_refuse(m, "the constraints cannot be satisfied at t = %.10g", m->numbers[FMU_NOW]);
}

/* Apply events at the present point. */
static int apply_events(fmu *m, fmu_event_info *news)
{
    cotree_events *const e = fmu_events(m);
    const double t = m->numbers[FMU_NOW];
    double *const w = m->work;
    int i, status;
    m->run.is_held = 1;
    cotree_run_narrow(&m->run, t, m->z, w);
    cotree_events_restore(e, m->event_history); /* zeros before the first update */
    if (m->numbers[FMU_IS_BEGUN] == 0.0) {
        status = cotree_events_begin(e, t, w);
    } else if (m->numbers[FMU_IS_CHANGED] != 0.0 || fmu_is_stop(m, t)) {
        status = cotree_events_resume(e, t, w, NULL); /* speeds may have jumped */
    } else {
        status = cotree_events_apply_passed(e, t, w);
    }
    m->run.is_held = 0;
    if (status != 0) {
        return fmu_refuse(m, "event '%s' stops the simulation at t = %.10g: %s",
                          m->model->hybrid->events[e->event].name, e->failure_time,
                          cotree_events_message(status));
    }
    cotree_events_save(e, m->event_history);
    if (cotree_run_find_states(&m->run, t, w) != 0) {
        return fmu_refuse(m, "no values of the algebraic unknowns are found at t = %.10g", t);
    }
    for (i = 0; i < N_STATES; ++i) m->z[i] = m->run.full[i];
    news->terminates = e->terminal_event >= 0;
    for (i = 0; i < e->n_events; ++i) {
        if (e->has_fired[i]) fmu_log(m, FMU_NOTE, "event '%s' at t = %.10g", e->rows[i].name, t);
    }
    return 0;
}

int fmu_update(fmu *m, fmu_event_info *news)
{
    int i, status;
    news->terminates = news->are_states_changed = 0;
    if (fmu_prepare(m) != 0) return 1;
    find_segment(m);
    if (fmu_refresh(m, FMU_POINT) != 0) return 1;
    for (i = 0; i < N_RATES; ++i) m->before[i] = m->z[i];
    status = project(m);
    if (status == 0 && m->model->hybrid != NULL) status = apply_events(m, news);
    fmu_invalidate(m);
    if (status != 0) return status;
    m->numbers[FMU_IS_BEGUN] = 1.0;
    m->numbers[FMU_IS_CHANGED] = 0.0;
    for (i = 0; i < N_RATES; ++i) {
        if (m->z[i] != m->before[i]) news->are_states_changed = 1;
    }
    news->next = m->numbers[FMU_NEXT];
    news->has_next = news->next <= DBL_MAX;
    return 0;
}

/* Leave Event Mode, after an update if there was none. */
int fmu_leave_event_mode(fmu *m)
{
    fmu_event_info news;
    if (m->numbers[FMU_IS_BEGUN] == 0.0 && fmu_update(m, &news) != 0) return 1;
    if (fmu_prepare(m) != 0) return 1;
    fmu_enter(m, FMU_CONTINUOUS);
    return 0;
}
