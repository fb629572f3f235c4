/* cotree_jumps.c: evaluation of event functions, and of states and sensitivities after events. */
#include "cotree_jumps.h"

#include <string.h>

#define MODEL (j->run->model)
#define N_STATES (j->run->model->n_states)
#define N_EVENTS (j->hybrid->n_events)
#define N_JUMPS (j->hybrid->n_jumps)
#define N_SENSITIVITIES (j->run->n_blocks - 1)

/* An event that sets no states. */
static const cotree_event no_event = {"", 0, 0, 0, 0, 0, 0, NULL, 0, -1};

/* Relative difference up to which derivatives of event times count as equal. */
#define SHARED_RTOL COTREE_SELECT(1e-9, 1e-4f)

int cotree_is_contact_slip(const cotree_event *event)
{
    return event->kind == COTREE_FRICTION_SLIP && event->n_targets > 2;
}

/* Return whether a model needs impulses: for impacts at rigid stops, or to remove the remaining
 * slip when sliding in a ball joint ends. */
static int has_impulses(const cotree_hybrid *h)
{
    int i;
    for (i = 0; i < h->n_events; ++i) {
        const int kind = h->events[i].kind;
        if (kind == COTREE_STOP_REBOUND || kind == COTREE_FRICTION_TURN) return 1;
    }
    return 0;
}

void cotree_jumps_init(cotree_jumps *j, cotree_run *run, cotree_arena *arena)
{
    const cotree_model *const model = run->model;
    const cotree_hybrid *const h = model->hybrid;
    const int n = model->n_states, m = run->n_blocks - 1, n_values = h->n_events + h->n_jumps;
    const int n_functions = h->n_events + h->n_branches + h->n_quantities;
    int i;
#if COTREE_HAS_CONSTRAINTS
    const cotree_assembly_tables constraints = {.n_coordinates = h->n_coordinates,
                                                .n_speeds = h->n_speeds,
                                                .n_values = h->n_values,
                                                .n_rows = h->n_rows,
                                                .value_rows = h->value_rows,
                                                .n_quaternions = h->n_quaternions,
                                                .quaternions = h->quaternions};
#endif
    j->run = run;
    j->hybrid = h;
    j->values = j->other_values = cotree_arena_reals(arena, n_functions);
    for (i = 0; i < COTREE_RECENT; ++i) {
        j->recent[i].values = cotree_arena_reals(arena, n_functions);
        j->recent[i].rates = cotree_arena_reals(arena, n_values + model->n_algebraic);
        j->recent[i].state_rates = cotree_arena_reals(arena, n);
        j->recent[i].point = cotree_arena_reals(arena, n + model->n_inputs + h->n_branches);
    }
    j->rates = j->recent[0].rates;
    j->state_rates = j->recent[0].state_rates;
    cotree_jumps_forget(j);
    j->before = cotree_arena_reals(arena, run->n_full);
    j->after = cotree_arena_reals(arena, run->n_full);
    j->time_sensitivity = cotree_arena_reals(arena, m);
    j->jump_rates = cotree_arena_reals(arena, n);
    j->value_slopes = cotree_arena_reals(arena, m * n_values);
    j->new_values = cotree_arena_reals(arena, h->n_jumps);
    if (has_impulses(h)) {
        j->w_work = cotree_arena_reals(arena, run->n_full);
        j->packed = cotree_arena_reals(arena, run->n_full);
        j->response = cotree_arena_reals(arena, 2 * run->n_full);
        j->impulse_forces = cotree_arena_reals(arena, 2 * h->n_events * run->n_blocks);
        j->force_slopes = cotree_arena_reals(arena, m * n_values);
    }
#if COTREE_HAS_CONSTRAINTS
    j->constraints = constraints;
    if (model->n_constraints > 0) cotree_assembly_init(&j->assembly, run, &j->constraints, arena);
#endif
}

/* Compute all states and the inputs at w. Move t into the current segment of the run. */
static int complete_point(cotree_run *run, cotree_real *t, const cotree_real *w)
{
    int status;
    *t = cotree_run_inside(run, *t);
    status = cotree_run_find_states(run, *t, w);
    return status != 0 ? status : cotree_run_inputs(run, *t);
}

void cotree_jumps_forget(cotree_jumps *j) { j->n_recent = j->oldest = 0; }

/* Return the branches of table lookups that are frozen in the prepared values. */
static const cotree_real *frozen_branches(const cotree_jumps *j)
{
    return j->run->k + MODEL->n_prepared - j->hybrid->n_branches;
}

/* Return whether n numbers are the same, including the signs of zeros. */
static int are_same(int n, const cotree_real *a, const cotree_real *b)
{
    return n == 0 || memcmp(a, b, (size_t)n * sizeof(cotree_real)) == 0;
}

/* Return whether a point of an evaluation is x, with the current inputs and branches. */
static int is_at(const cotree_jumps *j, const cotree_real *point, const cotree_real *x)
{
    const int n = N_STATES, n_inputs = MODEL->n_inputs;
    return are_same(n, x, point) && are_same(n_inputs, j->run->u, point + n) &&
           are_same(j->hybrid->n_branches, frozen_branches(j), point + n + n_inputs);
}

/* Return the recent evaluation at a complete point with the current inputs, or NULL. Inline, since
 * there is none in most calls. */
static inline cotree_evaluation *find_evaluation(cotree_jumps *j, cotree_real t,
                                                 const cotree_real *x)
{
    int i;
    for (i = 0; i < j->n_recent; ++i) {
        if (t == j->recent[i].t && is_at(j, j->recent[i].point, x)) return j->recent + i;
    }
    return NULL;
}

/* Replace the oldest evaluation by one at a complete point, without results. */
static cotree_evaluation *begin_evaluation(cotree_jumps *j, cotree_real t, const cotree_real *x)
{
    const int n = N_STATES, n_inputs = MODEL->n_inputs;
    cotree_evaluation *const made = j->recent + j->oldest;
    int i;
    j->oldest = (j->oldest + 1) % COTREE_RECENT;
    if (j->n_recent < COTREE_RECENT) ++j->n_recent;
    made->has_values = made->has_rates = 0;
    made->t = t;
    for (i = 0; i < n; ++i) made->point[i] = x[i];
    for (i = 0; i < n_inputs; ++i) made->point[n + i] = j->run->u[i];
    for (i = 0; i < j->hybrid->n_branches; ++i)
        made->point[n + n_inputs + i] = frozen_branches(j)[i];
    return made;
}

int cotree_jumps_values(cotree_jumps *j, cotree_real t, const cotree_real *w)
{
    cotree_run *const run = j->run;
    cotree_evaluation *found;
    int status = complete_point(run, &t, w);
    if (status != 0) return status;
    found = find_evaluation(j, t, run->full);
    j->values = found == NULL ? j->other_values : found->values;
    if (found != NULL && found->has_values) return 0;
    status = MODEL->events(t, run->full, run->u, run->p, run->k, j->values);
    if (found != NULL) found->has_values = status == 0;
    return status;
}

int cotree_jumps_ranges(cotree_jumps *j, cotree_real t, const cotree_real *box, cotree_real *ranges)
{
    cotree_run *const run = j->run;
    return MODEL->event_ranges(t, run->full, box, run->u, run->p, run->k, ranges);
}

/* Evaluate the rates of all states and event functions at a complete point. */
static int evaluate_rates(cotree_jumps *j, cotree_real t, const cotree_real *x)
{
    cotree_run *const run = j->run;
    const int n_rated = run->n_rates;
    int i, status = MODEL->rhs(t, x, run->u, run->p, run->k, j->state_rates);
    if (status != 0) return status;
    for (i = n_rated; i < N_STATES; ++i) j->state_rates[i] = COTREE_F(0.0);
    status = MODEL->event_rates(t, x, j->state_rates, run->u, run->p, run->k, j->rates);
#if COTREE_HAS_ALGEBRAIC
    if (status != 0 || n_rated == N_STATES) return status;
    /* The rates z' of algebraic unknowns keep the residuals zero: g_x x' + g_t + g_z z' = 0. */
    status = cotree_run_follow(run, t, x, j->rates + N_EVENTS + N_JUMPS, j->state_rates + n_rated);
    if (status != 0) return status;
    status = MODEL->event_rates(t, x, j->state_rates, run->u, run->p, run->k, j->rates);
#endif
    return status;
}

/* Compute state_rates (of all states) and rates at a complete point. */
static int compute_rates_at(cotree_jumps *j, cotree_real t, const cotree_real *x)
{
    cotree_evaluation *evaluation;
    int status = cotree_run_inputs(j->run, t);
    if (status != 0) return status;
    evaluation = find_evaluation(j, t, x);
    if (evaluation == NULL) evaluation = begin_evaluation(j, t, x);
    j->rates = evaluation->rates;
    j->state_rates = evaluation->state_rates;
    if (evaluation->has_rates) return 0;
    status = evaluate_rates(j, t, x);
    evaluation->has_rates = status == 0;
    return status;
}

int cotree_jumps_rates(cotree_jumps *j, cotree_real t, const cotree_real *w)
{
    int status;
    t = cotree_run_inside(j->run, t);
    status = cotree_run_find_states(j->run, t, w);
    return status != 0 ? status : compute_rates_at(j, t, j->run->full);
}

#if COTREE_HAS_CONSTRAINTS
/* Project the states after an event onto the constraints. */
static int settle_states(cotree_jumps *j, const cotree_event *row, cotree_real t, cotree_real *x)
{
    cotree_run *const run = j->run;
    int i, status;
    if (!cotree_run_is_constrained(run)) return 0;
    status = cotree_run_inputs(run, t);
    for (i = 0; i < N_STATES; ++i) j->assembly.is_kept[i] = 0;
    for (i = 0; i < row->n_prescribed; ++i) j->assembly.is_kept[row->targets[i]] = 1;
    if (status == 0) status = cotree_assembly_normalise(&j->assembly, x);
    if (status != 0 || MODEL->gradient == NULL) return status;
    return cotree_assembly_move(&j->assembly, t, x);
}
#endif

/* Complete the states and sensitivities after an event that has set its targets: project them and
 * add (R_x f- + R_t - f+) t_p. */
static int complete_event(cotree_jumps *j, const cotree_event *row, cotree_real t, cotree_real *w)
{
    cotree_run *const run = j->run;
    cotree_real *const s = j->after + N_STATES;
    const cotree_real *const t_p = j->time_sensitivity;
    int i, n, status;
#if COTREE_HAS_CONSTRAINTS
    const int is_constrained = cotree_run_is_constrained(run);
    cotree_real *const given = run->full; /* states before the projection */
    for (i = 0; i < N_STATES; ++i) given[i] = j->after[i];
    status = settle_states(j, row, t, j->after);
    if (status != 0) return status;
    if (N_SENSITIVITIES > 0 && is_constrained &&
        cotree_assembly_is_chosen(&j->assembly, t, given, j->after)) {
        return COTREE_JUMPS_UNDERDETERMINED;
    }
#else
    (void)row;
#endif
    cotree_run_narrow(run, t, j->after, w);
    status = cotree_run_find_states(run, t, w);
    if (status != 0) return status;
    for (i = 0; i < N_STATES; ++i) j->after[i] = run->full[i];
    if (N_SENSITIVITIES == 0) return 0;
    status = cotree_run_inputs(run, t);
    if (status == 0) status = MODEL->rhs(t, j->after, run->u, run->p, run->k, run->full);
    if (status != 0) return status;
    for (n = 0; n < N_SENSITIVITIES; ++n) {
        cotree_real *const block = s + n * N_STATES;
        for (i = 0; i < run->n_rates; ++i) block[i] += t_p[n] * (j->jump_rates[i] - run->full[i]);
        for (; i < N_STATES; ++i) block[i] = COTREE_F(0.0);
    }
#if COTREE_HAS_CONSTRAINTS
    if (is_constrained)
        status = cotree_assembly_move_sensitivities(&j->assembly, t, j->after, NULL, s);
    if (status != 0) return status;
#endif
    cotree_run_narrow(run, t, j->after, w);
    status = cotree_run_find(run, t, w);
    for (i = 0; i < run->n_full; ++i) j->after[i] = run->full[i];
    return status;
}

/* Return the index of an event's first new value among those of all events. */
static int first_new_value(const cotree_jumps *j, int event)
{
    int i, first = 0;
    for (i = 0; i < event; ++i) first += j->hybrid->events[i].n_targets;
    return first;
}

int cotree_jumps_compute_new_values(cotree_jumps *j, cotree_real t, const cotree_real *w)
{
    cotree_run *const run = j->run;
    const int status = complete_point(run, &t, w);
    return status != 0 ? status : MODEL->jumps(t, run->full, run->u, run->p, run->k, j->new_values);
}

cotree_real cotree_jumps_new_value(const cotree_jumps *j, int event)
{
    return j->new_values[first_new_value(j, event)];
}

int cotree_jumps_changes_value(const cotree_jumps *j, int event)
{
    return cotree_jumps_new_value(j, event) != j->run->full[j->hybrid->events[event].targets[0]];
}

int cotree_jumps_state_rates(cotree_jumps *j, cotree_real t, const cotree_real *w,
                             cotree_real *rates)
{
    cotree_run *const run = j->run;
    const int status = complete_point(run, &t, w);
    return status != 0 ? status : MODEL->rhs(t, run->full, run->u, run->p, run->k, rates);
}

int cotree_jumps_sides(cotree_jumps *j, int event, cotree_real t, const cotree_real *w,
                       cotree_real *x, cotree_real *now, cotree_real *other)
{
    const cotree_event *const rows = j->hybrid->events;
    const int target = rows[event].targets[0];
    int i, status = cotree_jumps_compute_new_values(j, t, w);
    if (status == 0) status = cotree_jumps_state_rates(j, t, w, now);
    for (i = 0; i < j->run->n_rates; ++i) x[i] = w[i];
    for (i = 0; i < N_EVENTS; ++i) {
        if (rows[i].kind != COTREE_JUMP || rows[i].targets[0] != target) continue;
        if (cotree_jumps_new_value(j, i) != w[target]) x[target] = cotree_jumps_new_value(j, i);
    }
    return status == 0 ? cotree_jumps_state_rates(j, t, x, other) : status;
}

/* Evaluate the states before an event and, for sensitivities, the rates before it. */
static int find_before(cotree_jumps *j, cotree_real t, const cotree_real *w)
{
    const cotree_run *const run = j->run;
    int i, status = cotree_run_find(j->run, t, w);
    for (i = 0; i < run->n_full; ++i) j->before[i] = j->after[i] = run->full[i];
    if (status != 0 || N_SENSITIVITIES == 0) return status;
    status = compute_rates_at(j, t, j->before);
    for (i = 0; i < N_STATES; ++i) j->jump_rates[i] = j->state_rates[i];
    return status;
}

/* As find_before, with the derivatives of the event functions. */
static int evaluate_before(cotree_jumps *j, cotree_real t, const cotree_real *w)
{
    const cotree_run *const run = j->run;
    const cotree_real *const x = j->before;
    const int status = find_before(j, t, w);
    if (status != 0 || N_SENSITIVITIES == 0) return status;
    return MODEL->event_sensitivity(t, x, x + N_STATES, run->u, run->p, run->k, j->value_slopes);
}

int cotree_jumps_move_sensitivities(cotree_jumps *j, int event, const cotree_real *direction,
                                    cotree_real slope, cotree_real t, cotree_real *w)
{
    const int n_values = N_EVENTS + N_JUMPS;
    cotree_run *const run = j->run;
    int i, n, status;
    t = cotree_run_inside(run, t);
    status = evaluate_before(j, t, w);
    for (n = 0; n < N_SENSITIVITIES && status == 0; ++n) {
        const cotree_real fraction = j->value_slopes[n * n_values + event] / slope;
        cotree_real *const block = j->before + (1 + n) * N_STATES;
        for (i = 0; i < run->n_rates; ++i) block[i] -= fraction * direction[i];
    }
    if (status == 0) cotree_run_narrow(run, t, j->before, w);
    return status;
}

int cotree_jumps_depends_on_parameters(cotree_jumps *j, int event, cotree_real t, cotree_real *w,
                                       int *is_dependent)
{
    const int status = evaluate_before(j, cotree_run_inside(j->run, t), w);
    int n;
    *is_dependent = 0;
    for (n = 0; n < N_SENSITIVITIES; ++n) {
        /* If the derivative is nan, the function counts as dependent. */
        if (!(j->value_slopes[n * (N_EVENTS + N_JUMPS) + event] == COTREE_F(0.0)))
            *is_dependent = 1;
    }
    return status;
}

int cotree_jumps_share_time(const cotree_jumps *j, int a, int b)
{
    int n;
    for (n = 0; n < N_SENSITIVITIES; ++n) {
        const cotree_real *const slopes = j->value_slopes + n * (N_EVENTS + N_JUMPS);
        const cotree_real of_a = slopes[a] * j->rates[b], of_b = slopes[b] * j->rates[a];
        if (!(COTREE_FABS(of_a - of_b) <= SHARED_RTOL * (COTREE_FABS(of_a) + COTREE_FABS(of_b))))
            return 0;
    }
    return 1;
}

/* Compute the derivatives of an event time from those of its event function. */
static void set_time_sensitivity(cotree_jumps *j, int event)
{
    int n;
    for (n = 0; n < N_SENSITIVITIES; ++n) {
        const cotree_real slope = j->value_slopes[n * (N_EVENTS + N_JUMPS) + event];
        /* If the function depends on no parameter, its time is fixed, even at zero rate. */
        j->time_sensitivity[n] = slope == COTREE_F(0.0) ? COTREE_F(0.0) : -slope / j->rates[event];
    }
}

int cotree_jumps_compare_times(cotree_jumps *j, int event, cotree_real t, cotree_real *w,
                               cotree_real t_other, cotree_real *w_other, int *is_same)
{
    int n, status = evaluate_before(j, cotree_run_inside(j->run, t), w);
    if (status != 0) return status;
    set_time_sensitivity(j, event);
    *is_same = 1;
    status = evaluate_before(j, cotree_run_inside(j->run, t_other), w_other);
    for (n = 0; n < N_SENSITIVITIES; ++n) {
        const cotree_real slope = j->value_slopes[n * (N_EVENTS + N_JUMPS) + event];
        const cotree_real time = j->time_sensitivity[n] * j->rates[event];
        if (!(COTREE_FABS(time + slope) <= SHARED_RTOL * (COTREE_FABS(time) + COTREE_FABS(slope))))
            *is_same = 0;
    }
    return status;
}

int cotree_jumps_apply(cotree_jumps *j, int event, cotree_real t, cotree_real *w, int is_time_fixed)
{
    cotree_run *const run = j->run;
    const cotree_event *const row = j->hybrid->events + event;
    const int n_values = N_EVENTS + N_JUMPS, first = first_new_value(j, event);
    int i, n, status;
    t = cotree_run_inside(run, t);
    status = evaluate_before(j, t, w);
    if (status != 0) return status;
    if (row->n_targets > 0) {
        status = MODEL->jumps(t, j->before, run->u, run->p, run->k, j->new_values);
        if (status != 0) return status;
    }
    if (!is_time_fixed) set_time_sensitivity(j, event);
    for (i = 0; i < row->n_targets; ++i) {
        const int target = row->targets[i];
        j->after[target] = j->new_values[first + i];
        if (N_SENSITIVITIES == 0) continue;
        j->jump_rates[target] = j->rates[N_EVENTS + first + i];
        for (n = 0; n < N_SENSITIVITIES; ++n) {
            j->after[(1 + n) * N_STATES + target] =
                j->value_slopes[n * n_values + N_EVENTS + first + i];
        }
    }
    return complete_event(j, row, t, w);
}

void cotree_rows_store(const cotree_row *rows, int n_rows, int is_impact, cotree_real *x)
{
    int c, i;
    for (i = 0; i < n_rows; ++i) {
        x[rows[i].mode_state] = is_impact ? rows[i].kernel_mode : rows[i].mode;
        for (c = 0; c < COTREE_COMPONENTS && rows[i].direction_states[c] >= 0; ++c)
            x[rows[i].direction_states[c]] = rows[i].direction[c];
    }
}

int cotree_jumps_set_modes(cotree_jumps *j, const cotree_row *rows, int n_rows, cotree_real t,
                           cotree_real *w)
{
    int status;
    t = cotree_run_inside(j->run, t);
    status = find_before(j, t, w);
    if (status != 0) return status;
    cotree_rows_store(rows, n_rows, 0, j->after);
    return complete_event(j, &no_event, t, w);
}

/* Impacts.
 *
 * In an impact the equation of a constraint prescribes its change of speed instead of its
 * acceleration. The change of each state is the difference of two rates, evaluated with the
 * prescribed change and with zero: finite forces cancel in the difference. States without inertia
 * do not change. The changes of the sensitivities are computed in the same way from their rates. */

/* Return the index of an event's last new value, its change of speed, among all new values. */
static int speed_change_index(const cotree_jumps *j, int event)
{
    return first_new_value(j, event) + j->hybrid->events[event].n_targets - 1;
}

/* Write the prescribed changes of speed and their sensitivities to z; if is_struck is 0, write
 * zeros. */
static void set_required_changes(cotree_jumps *j, const cotree_row *rows, int n_rows, int is_struck,
                                 cotree_real *z)
{
    const cotree_real *const t_p = j->time_sensitivity;
    const int n_values = N_EVENTS + N_JUMPS;
    int c, i, n;
    for (i = 0; i < n_rows; ++i) {
        for (c = 0; c < COTREE_COMPONENTS && rows[i].speed_states[c] >= 0; ++c) {
            const int event = is_struck ? rows[i].struck_events[c] : -1;
            const int index = event < 0 ? -1 : speed_change_index(j, event);
            cotree_real *change = z + rows[i].speed_states[c];
            *change = index < 0 ? COTREE_F(0.0) : j->new_values[index];
            for (n = 0; n < N_SENSITIVITIES; ++n) {
                change += N_STATES;
                /* The time of the impact also depends on the parameters. */
                *change = index < 0 ? COTREE_F(0.0)
                                    : j->value_slopes[n * n_values + N_EVENTS + index] +
                                          j->rates[N_EVENTS + index] * t_p[n];
            }
        }
    }
}

/* Compute the rates of all states and sensitivities at z, and the event functions, of which some
 * are forces, with their derivatives. */
static int evaluate_response(cotree_jumps *j, cotree_real t, const cotree_real *z,
                             cotree_real *rates, cotree_real *forces)
{
    cotree_run *const run = j->run;
    const int n_values = N_EVENTS + N_JUMPS;
    int i, n, status;
    cotree_run_narrow(run, t, z, j->w_work);
    status = cotree_run_find(run, t, j->w_work);
    if (status != 0) return status;
    cotree_run_pack(run, run->full, j->w_work);
    status = cotree_run_packed_rate(run, t, j->w_work, j->packed);
    if (status != 0) return status;
    cotree_run_unpack(run, j->packed, rates);
    j->values = j->other_values;
    status = MODEL->events(t, run->full, run->u, run->p, run->k, j->values);
    for (i = 0; i < N_EVENTS; ++i) forces[i] = j->values[i];
    if (status != 0 || N_SENSITIVITIES == 0) return status;
    status = MODEL->event_sensitivity(t, run->full, run->full + N_STATES, run->u, run->p, run->k,
                                      j->force_slopes);
    for (n = 0; n < N_SENSITIVITIES; ++n) {
        for (i = 0; i < N_EVENTS; ++i)
            forces[(1 + n) * N_EVENTS + i] = j->force_slopes[n * n_values + i];
    }
    return status;
}

static void restore_modes(const cotree_row *rows, int n_rows, const cotree_real *from,
                          cotree_real *z)
{
    int c, i;
    for (i = 0; i < n_rows; ++i) {
        z[rows[i].mode_state] = from[rows[i].mode_state];
        for (c = 0; c < COTREE_COMPONENTS && rows[i].direction_states[c] >= 0; ++c)
            z[rows[i].direction_states[c]] = from[rows[i].direction_states[c]];
    }
}

/* Change the states and sensitivities j->after by the impact. On entry, the sensitivities include
 * the change of the impact's time. */
static int compute_impact(cotree_jumps *j, const cotree_row *rows, int n_rows, int is_residual,
                          cotree_real t)
{
    cotree_run *const run = j->run;
    const int n_forces = N_EVENTS * run->n_blocks;
    cotree_real *const with = j->response, *const without = with + run->n_full;
    cotree_real *const forces = j->impulse_forces, *const finite_forces = forces + n_forces;
    int c, i, n, status;
    cotree_rows_store(rows, n_rows, 1, j->after);
    set_required_changes(j, rows, n_rows, 1, j->after);
    status = evaluate_response(j, t, j->after, with, forces);
    set_required_changes(j, rows, n_rows, 0, j->after);
    if (status == 0) status = evaluate_response(j, t, j->after, without, finite_forces);
    if (status != 0) return status;
    for (i = 0; i < n_forces; ++i) forces[i] -= finite_forces[i];
    for (n = 0; n < run->n_blocks; ++n) {
        cotree_real *const block = j->after + n * N_STATES;
        for (i = 0; i < run->n_rates; ++i)
            block[i] += with[n * N_STATES + i] - without[n * N_STATES + i];
        for (i = 0; i < n_rows; ++i) {
            const cotree_row *const row = rows + i;
            const int has_impulse = row->type == COTREE_ROW_STOP && row->struck_events[0] >= 0;
            for (c = 0; c < COTREE_COMPONENTS && row->speed_states[c] >= 0; ++c) {
                const int state = row->speed_states[c];
                /* The stored impulse does not have the sign of the stop's side. */
                block[state] = has_impulse ? forces[n * N_EVENTS + row->limits[0]] : COTREE_F(0.0);
                if (is_residual) block[state] = j->before[n * N_STATES + state];
            }
        }
    }
    restore_modes(rows, n_rows, j->before, j->after);
    return 0;
}

int cotree_jumps_try_impulse(cotree_jumps *j, const cotree_row *rows, int n_rows, cotree_real t,
                             const cotree_real *w, cotree_real *after)
{
    cotree_run *const run = j->run;
    const int n_blocks = run->n_blocks, n_full = run->n_full;
    int i, status;
    t = cotree_run_inside(run, t);
    run->n_blocks = 1;
    run->n_full = N_STATES;
    status = cotree_run_find(run, t, w);
    for (i = 0; i < N_STATES; ++i) j->before[i] = j->after[i] = run->full[i];
    if (status == 0) status = cotree_run_inputs(run, t);
    if (status == 0) status = MODEL->jumps(t, j->before, run->u, run->p, run->k, j->new_values);
    if (status == 0) status = compute_impact(j, rows, n_rows, 0, t);
    if (status == 0) cotree_run_narrow(run, t, j->after, after);
    run->n_blocks = n_blocks;
    run->n_full = n_full;
    return status;
}

int cotree_jumps_apply_impulse(cotree_jumps *j, const cotree_row *rows, int n_rows, int is_residual,
                               cotree_real t, cotree_real *w)
{
    cotree_run *const run = j->run;
    cotree_real *const x = j->before;
    int i, n, status;
    t = cotree_run_inside(run, t);
    status = find_before(j, t, w);
    if (status == 0) status = MODEL->jumps(t, x, run->u, run->p, run->k, j->new_values);
    if (status == 0 && N_SENSITIVITIES > 0) {
        status =
            MODEL->event_sensitivity(t, x, x + N_STATES, run->u, run->p, run->k, j->value_slopes);
    }
    if (status != 0) return status;
    for (n = 0; n < N_SENSITIVITIES; ++n) {
        cotree_real *const block = j->after + (1 + n) * N_STATES;
        for (i = 0; i < run->n_rates; ++i) block[i] += j->time_sensitivity[n] * j->jump_rates[i];
    }
    status = compute_impact(j, rows, n_rows, is_residual, t);
    /* The sensitivities already include the rates before the impact. */
    for (i = 0; i < N_STATES; ++i) j->jump_rates[i] = COTREE_F(0.0);
    return status == 0 ? complete_event(j, &no_event, t, w) : status;
}

cotree_real cotree_jumps_target_value(const cotree_jumps *j, int event, int target)
{
    return j->new_values[first_new_value(j, event) + target];
}

cotree_real cotree_jumps_speed_change(const cotree_jumps *j, int event)
{
    return j->new_values[speed_change_index(j, event)];
}

cotree_real cotree_jumps_speed_change_rate(const cotree_jumps *j, int event)
{
    return j->rates[N_EVENTS + speed_change_index(j, event)];
}
