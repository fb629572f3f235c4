/* cotree_events.c: the search for events after each step of one integration. */
#include "cotree_events_internal.h"

/* Limits of the interpolation error, in tolerances. A step is refined above the first limit if an
 * event function is close to zero, and above the second limit before a crossing is located. */
#define COARSE_TOLERANCES COTREE_F(1e3)
#define FINE_TOLERANCES COTREE_F(4.0)

/* The second limit for kinks. Errors of their times only have second-order effects. */
#define KINK_TOLERANCES COTREE_F(100.0)

void cotree_events_init(cotree_events *e, cotree_run *run, int n_given, cotree_real span,
                        cotree_real rtol, const cotree_real *atols, cotree_real atol,
                        cotree_solution_function visit, void *context, cotree_arena *arena)
{
    const cotree_model *const model = run->model;
    const int n = run->n, n_events = model->hybrid->n_events;
    cotree_real *of_local;
    int i;
    e->w = cotree_arena_reals(arena, n);
    e->point = cotree_arena_reals(arena, n);
    e->other = cotree_arena_reals(arena, n);
    e->slope = cotree_arena_reals(arena, n);
    e->sum = cotree_arena_reals(arena, n);
    e->narrowed = cotree_arena_reals(arena, 2 * n);
    e->scratch = cotree_arena_reals(arena, n_given);
    of_local = cotree_arena_reals(arena, COTREE_HISTORY_WORKSPACE(n));
    e->g = cotree_arena_reals(arena, n_events);
    e->side = cotree_arena_reals(arena, n_events);
    e->value_scale = cotree_arena_reals(arena, n_events);
    e->state_error = cotree_arena_reals(arena, n_events);
    e->recent_scale = cotree_arena_reals(arena, n_events);
    e->crossing_sign = cotree_arena_reals(arena, n_events);
    e->rate_before = cotree_arena_reals(arena, n_events);
    e->curvature = cotree_arena_reals(arena, n_events);
    e->root_time = cotree_arena_reals(arena, n_events);
    e->samples = cotree_arena_reals(arena, SAMPLES * n_events);
    e->from_side = cotree_arena_reals(arena, n_events);
    e->bracket_start = cotree_arena_reals(arena, n_events);
    e->n_ranges = model->hybrid->n_ranges;
    e->n_quantities = model->hybrid->n_quantities;
    if (e->n_ranges > 0) {
        const int n_quantities = e->n_quantities, n_mark = 1 + n_events + 2 * n_quantities;
        e->ranges = cotree_arena_reals(arena, N_BOUNDS * e->n_ranges);
        e->box = cotree_arena_reals(arena, N_BOUNDS * n_quantities);
        e->quantity_samples = cotree_arena_reals(arena, SAMPLES * n_quantities);
        e->quantity_mean_rate = cotree_arena_reals(arena, n_quantities);
        e->stack = cotree_arena_reals(arena, (MAX_DEPTH + 2) * n_mark);
        e->is_candidate = cotree_arena_ints(arena, n_events);
        e->is_excluded = cotree_arena_ints(arena, n_events);
    }
    e->mean_rate = cotree_arena_reals(arena, n_events);
    e->event_times = cotree_arena_reals(arena, COTREE_EVENT_CROWD * n_events);
    e->has_fired = cotree_arena_ints(arena, n_events);
    e->is_found = cotree_arena_ints(arena, n_events);
    e->is_near = cotree_arena_ints(arena, n_events);
    e->is_continuous = cotree_arena_ints(arena, n_events);
    e->both_sides = cotree_arena_reals(arena, 6 * run->n_full + model->hybrid->n_branches);
    e->shift = cotree_arena_reals(arena, 2 * n_events);
    e->n_event_times = cotree_arena_ints(arena, n_events);
    cotree_jumps_init(&e->jumps, run, arena);
    e->events = model->hybrid->events;
    e->n_events = n_events;
    e->n_rows = e->n_frictions = e->n_stops = 0;
#if COTREE_HAS_MODES
    cotree_init_rows(e, run, arena);
#endif
    if (arena->base == NULL) return;
    cotree_history_init(&e->refined, n, of_local);
    e->run = run;
    e->n_kinks = model->hybrid->n_kinks;
    e->n_branches = model->hybrid->n_branches;
    e->has_steep = 0;
    e->branches = NULL;
    e->branch_time = COTREE_INFINITY;
    e->n = n;
    e->n_given = n_given;
    e->span = COTREE_FABS(span);
    e->rtol = rtol;
    e->atols = atols;
    e->atol = atol;
    e->solution = visit;
    e->context = context;
    e->n_found = 0;
    e->n_fired = e->is_mode_changed = 0;
    e->is_time_fixed = 0;
    e->terminal_event = -1;
    e->records = NULL;
    e->n_records = 0;
    e->failure = 0;
    e->event = 0;
    e->failure_time = e->detail = COTREE_F(0.0);
    e->n_evaluations = 0;
    e->unresolved_gap = -1;
    for (i = 0; i < n_events; ++i) {
        e->g[i] = e->side[i] = e->value_scale[i] = e->recent_scale[i] = COTREE_F(0.0);
        e->state_error[i] = COTREE_F(0.0);
        e->has_steep = e->has_steep || e->events[i].kind == COTREE_STEEP_KINK;
        e->mean_rate[i] = COTREE_INFINITY;
        e->n_event_times[i] = 0;
        e->has_fired[i] = 0;
        e->is_continuous[i] = 0;
    }
}

/* Evaluate the event functions, and update their scales. */
static int evaluate(cotree_events *e, cotree_real t, const cotree_real *w)
{
    int status;
    cotree_jumps_forget(&e->jumps);
    status = cotree_compute_values(e, t, w);
    cotree_copy(e->n_events, e->jumps.values, e->g);
    return status == 0 ? cotree_update_scales(e, t, w, e->g) : status;
}

/* Evaluate the event functions at the start of a run, and the magnitudes of their terms. */
static int evaluate_start(cotree_events *e, cotree_real t, const cotree_real *w)
{
    int status = evaluate(e, t, w);
#if COTREE_HAS_MODES
    if (status == 0) status = cotree_set_term_scales(e, t, w);
#endif
    return status;
}

int cotree_events_begin(cotree_events *e, cotree_real t, cotree_real *w)
{
    int i, n_found = 0, has_curvature = 0, status = evaluate_start(e, t, w);
    if (status == 0) status = cotree_compute_rates(e, t, w);
#if COTREE_HAS_MODES
    if (status != 0) return cotree_fail_start(e, t, w);
#else
    if (status != 0) return status;
#endif
    cotree_copy(e->n_events, e->jumps.rates, e->rate_before);
    for (i = 0; i < e->n_events && status == 0; ++i) {
        const int is_zero = COTREE_FABS(e->g[i]) <= cotree_rounding_band(e, i);
        e->crossing_sign[i] = cotree_sign_of(is_zero ? e->rate_before[i] : e->g[i]);
        if (is_zero && e->rate_before[i] == COTREE_F(0.0) && !cotree_is_kink(e, i)) {
            if (!has_curvature) status = cotree_compute_curvature(e, t, w);
            has_curvature = 1;
            e->crossing_sign[i] = cotree_sign_of(e->curvature[i]);
        }
        e->side[i] = e->crossing_sign[i];
        /* The mode selection handles gaps that are closed at the start. */
        e->is_found[i] = is_zero && !cotree_is_gap(e, i) && !cotree_is_kink(e, i) &&
                         e->events[i].direction != 0 &&
                         (cotree_real)e->events[i].direction == e->crossing_sign[i];
        n_found += e->is_found[i];
    }
#if COTREE_HAS_MODES
    if (status == 0) status = cotree_check_gaps(e, t, e->g);
#endif
    return status == 0 ? cotree_apply_events(e, t, w, n_found, NULL) : status;
}

int cotree_events_resume(cotree_events *e, cotree_real t, cotree_real *w, const cotree_real *slopes)
{
    int i, status = evaluate(e, t, w);
    for (i = 0; i < e->n_events; ++i) e->crossing_sign[i] = -e->side[i];
    e->is_time_fixed = 1;
    if (status == 0) status = cotree_apply_events(e, t, w, 0, slopes);
    e->is_time_fixed = 0;
    return status;
}

int cotree_events_continue(cotree_events *e, cotree_real t, cotree_real *w)
{
    const int status = evaluate(e, t, w);
    e->n_fired = e->is_mode_changed = 0;
    return status == 0 ? cotree_select_branches(e, t, w) : status;
}

int cotree_events_apply_passed(cotree_events *e, cotree_real t, cotree_real *w)
{
#if COTREE_HAS_MODES
    int k, status;
    cotree_jumps_forget(&e->jumps);
    status = cotree_compute_values(e, t, w);
    for (k = 0; k < e->n_events && e->n_rows > 0 && status == 0; ++k) {
        if (cotree_is_gap(e, k) || e->events[k].kind == COTREE_FRICTION_SLIP)
            e->is_stepped_over[k] =
                e->side[k] > COTREE_F(0.0) && e->jumps.values[k] < COTREE_F(0.0);
    }
    if (status == 0) status = cotree_events_resume(e, t, w, NULL);
    for (k = 0; k < e->n_events && e->n_rows > 0; ++k) {
        e->has_fired[k] = e->has_fired[k] || e->is_stepped_over[k];
        e->is_stepped_over[k] = 0;
    }
    return status;
#else
    return cotree_events_resume(e, t, w, NULL);
#endif
}

int cotree_events_select_modes(cotree_events *e, cotree_real t, cotree_real *w)
{
    int status = evaluate_start(e, t, w);
#if COTREE_HAS_MODES
    if (status == 0) status = cotree_check_gaps(e, t, e->g);
    if (status == 0) status = cotree_resolve_modes(e, t, w, -1);
#endif
    return status;
}

void cotree_events_save(const cotree_events *e, cotree_real *to)
{
    const int n = e->n_events;
    int i;
    cotree_copy(n, e->side, to);
    cotree_copy(n, e->value_scale, to + n);
    cotree_copy(n, e->recent_scale, to + 2 * n);
    for (i = 0; i < n; ++i) {
        to[3 * n + i] = (cotree_real)e->n_event_times[i];
        to[4 * n + i] = e->n_rows > 0 ? (cotree_real)e->stays_at_zero[i] : COTREE_F(0.0);
        to[5 * n + i] = e->n_rows > 0 ? e->gap_at_release[i] : COTREE_F(0.0);
        to[6 * n + i] = e->n_rows > 0 ? e->zero_level[i] : COTREE_F(0.0);
    }
    cotree_copy(n * COTREE_EVENT_CROWD, e->event_times, to + 7 * n);
}

void cotree_events_restore(cotree_events *e, const cotree_real *from)
{
    const int n = e->n_events;
    int i;
    cotree_copy(n, from, e->side);
    cotree_copy(n, from + n, e->value_scale);
    cotree_copy(n, from + 2 * n, e->recent_scale);
    for (i = 0; i < n; ++i) {
        e->n_event_times[i] = (int)from[3 * n + i];
        if (e->n_rows == 0) continue;
        e->stays_at_zero[i] = (int)from[4 * n + i];
        e->gap_at_release[i] = from[5 * n + i];
        e->zero_level[i] = from[6 * n + i];
    }
    cotree_copy(n * COTREE_EVENT_CROWD, from + 7 * n, e->event_times);
}

/* Find a crossing of event function i in [a, b], with the values at_a and at_b at the ends. from:
 * its sign at a. Write the time of the crossing to `at` and the sign before it to `from`; without a
 * crossing, write the sign at b. The bracket starts at the last time with a nonzero value of this
 * sign, which is before a if the value at a is zero within rounding. If sensitivities depend on
 * whether an extremum crosses zero, a grazing extremum is a crossing with sign 0. Return NONE,
 * FOUND, a failure, or REFINE if the step must be refined first. */
int cotree_find_crossing_between(cotree_events *e, int i, cotree_real a, cotree_real b,
                                 cotree_real at_a, cotree_real at_b, int may_turn, cotree_real *at,
                                 cotree_real *from)
{
    const cotree_real side = *from, least = cotree_zero_band(e, i);
    const cotree_real sign = COTREE_FABS(at_b) > least ? cotree_sign_of(at_b) : COTREE_F(0.0);
    cotree_real t_extremum, lowest;
    if (side * at_a > COTREE_F(0.0)) e->bracket_start[i] = a;
    if (may_turn && side != COTREE_F(0.0) &&
        cotree_find_extremum(e, i, a, b, side * at_a, side * at_b, side, &t_extremum, &lowest)) {
        if (!e->is_fine) return REFINE;
        if (e->failure != 0) return e->failure;
        if (e->run->n_blocks > 1 && !cotree_is_kink(e, i) &&
            COTREE_FABS(lowest) <= GRAZING_TOLERANCES * cotree_tolerance(e, i) &&
            (cotree_solution_at(e, t_extremum, e->w) != 0 ||
             (cotree_moves_extremum(e, i, t_extremum, e->w, side) &&
              !cotree_is_continuous(e, i, t_extremum, e->w)))) {
            *at = t_extremum;
            *from = COTREE_F(0.0);
            return e->failure != 0 ? e->failure : COTREE_EVENTS_FOUND;
        }
        if (lowest < -least) {
            const int is_first = cotree_is_in_direction(e, i, -side);
            *from = is_first ? side : -side;
            *at = is_first ? cotree_locate_root(e, i, e->bracket_start[i], t_extremum, side)
                           : cotree_locate_root(e, i, t_extremum, b, -side);
            return e->failure != 0 ? e->failure : COTREE_EVENTS_FOUND;
        }
    }
    if (e->failure != 0) return e->failure;
    if (sign != COTREE_F(0.0) && side != COTREE_F(0.0) && sign != side &&
        cotree_is_in_direction(e, i, sign)) {
        /* Interpolated speeds near zero are only accurate to the tolerance of their terms. */
        const int is_close =
            e->is_fine || (cotree_is_kink(e, i) && e->history_error <= KINK_TOLERANCES);
        if (!is_close || (cotree_stays_at_zero(e, i) && !e->is_refined)) return REFINE;
        *at = cotree_locate_root(e, i, e->bracket_start[i], b, side);
        return e->failure != 0 ? e->failure : COTREE_EVENTS_FOUND;
    }
    if (sign != COTREE_F(0.0)) *from = sign;
    return COTREE_EVENTS_NONE;
}

/* Find the first crossing of one event function between the samples. Return a status of
 * cotree_find_crossing_between. */
static int find_crossing(cotree_events *e, int i)
{
    const cotree_real *const g = e->samples + i;
    const cotree_real least = cotree_zero_band(e, i);
    const int n = e->n_events;
    cotree_real side = COTREE_F(0.0);
    int k, nearest = SAMPLES, found = COTREE_EVENTS_NONE;
    e->from_side[i] = e->side[i];
    e->bracket_start[i] = e->t_before;
    for (k = 1; k < SAMPLES && found == COTREE_EVENTS_NONE; ++k) {
        if (side != e->from_side[i]) {
            side = e->from_side[i];
            nearest = cotree_stays_at_zero(e, i) ? SAMPLES : cotree_find_nearest_sample(e, i, side);
        }
        if (k != nearest && k != nearest + 1 && side * g[k * n] > least) continue;
        found = cotree_find_crossing_between(
            e, i, cotree_sample_time(e, k - 1), cotree_sample_time(e, k), g[(k - 1) * n], g[k * n],
            k == nearest || k == nearest + 1, e->root_time + i, e->from_side + i);
    }
    return found;
}

/* Find the first crossing of all event functions. Return a status of find_crossing, or SHORTEN if
 * there is no crossing before `until` and later times are undecided. */
static int find_crossings(cotree_events *e, int *first, cotree_real *until)
{
    int i, status = COTREE_EVENTS_NONE;
    *until = COTREE_INFINITY;
    if (e->n_ranges > 0) {
        const int found = cotree_scan_ranges(e, until);
        if (found > COTREE_EVENTS_FOUND) return found;
    }
    for (i = 0; i < e->n_events; ++i) {
        if (e->n_ranges == 0 || !e->is_candidate[i]) {
            const int found = find_crossing(e, i);
            if (found > COTREE_EVENTS_FOUND) return found;
            e->is_found[i] = found == COTREE_EVENTS_FOUND;
        }
        if (!e->is_found[i] || e->root_time[i] > *until) continue;
        if (status == COTREE_EVENTS_NONE || e->root_time[i] < e->root_time[*first]) {
            *first = i;
            status = COTREE_EVENTS_FOUND;
        }
    }
    return status == COTREE_EVENTS_NONE && *until < COTREE_INFINITY ? SHORTEN : status;
}

/* Find the event functions that are zero at the end of the step within the uncertainty of its
 * time. */
static int find_at_end(cotree_events *e, int *first)
{
    const cotree_real *const g = e->samples + (SAMPLES - 1) * e->n_events;
    const cotree_real soon = COTREE_SELECT(1e-9, 1.2e-04f) * COTREE_FABS(e->t_after - e->t_before) +
                             COTREE_F(4.0) * cotree_spacing(e->t_after);
    int i, has_rates = 0, status = COTREE_EVENTS_NONE;
    for (i = 0; i < e->n_events; ++i) {
        const cotree_real side = e->side[i];
        cotree_real rate;
        if (side == COTREE_F(0.0) || side * g[i] < COTREE_F(0.0) ||
            COTREE_FABS(g[i]) > cotree_tolerance(e, i))
            continue;
        if (!cotree_is_in_direction(e, i, -side) || cotree_stays_at_zero(e, i)) continue;
        if (!has_rates && cotree_compute_rates(e, e->t_after, e->end) != 0) return e->failure;
        has_rates = 1;
        rate = e->jumps.rates[i];
        if (rate * side >= COTREE_F(0.0) || COTREE_FABS(g[i]) > soon * COTREE_FABS(rate)) continue;
        has_rates = 0;
        if (side * cotree_side_after(e, i, e->t_after, e->end) > COTREE_F(0.0)) continue;
        e->is_found[i] = 1;
        e->root_time[i] = e->t_after;
        e->from_side[i] = side;
        if (status == COTREE_EVENTS_NONE) *first = i;
        status = COTREE_EVENTS_FOUND;
    }
    return status;
}

/* Compute the time uncertainty of an event. */
static int compute_margin(cotree_events *e, int i)
{
    cotree_real rate, known;
    if (cotree_compute_rates(e, e->t, e->w) != 0) return e->failure;
    rate = COTREE_FABS(e->jumps.rates[i]);
    known = rate > COTREE_F(0.0) ? cotree_tolerance(e, i) / rate : COTREE_INFINITY;
    e->margin =
        COTREE_FMAX(COTREE_F(4.0) * cotree_spacing(e->t),
                    COTREE_FMIN(known, COTREE_F(1e-3) * COTREE_FABS(e->t_after - e->t_before)));
    return 0;
}

/* Add the other events that cross zero at the located point. At the end of a step, one of two
 * simultaneous events may be just outside the rounding band and the other one within it. */
static int add_simultaneous(cotree_events *e)
{
    int i;
    if (cotree_compute_values(e, e->t, e->w) != 0) return e->failure;
    for (i = 0; i < e->n_events; ++i) {
        const cotree_real side = e->side[i];
        e->is_near[i] = COTREE_FABS(e->jumps.values[i]) <= cotree_rounding_band(e, i) &&
                        !cotree_stays_at_zero(e, i) && side * e->jumps.rates[i] < COTREE_F(0.0) &&
                        cotree_is_in_direction(e, i, -side);
    }
    for (i = 0; i < e->n_events; ++i) {
        if (e->is_near[i] && !e->is_found[i])
            e->is_found[i] = e->side[i] * cotree_side_after(e, i, e->t, e->w) < COTREE_F(0.0);
    }
    return e->failure;
}

/* Return the point at an end of a step in the layout of w. Its algebraic unknowns become
 * guesses. */
static const cotree_real *reduced_point(cotree_events *e, cotree_real t, const cotree_real *given,
                                        cotree_real *w)
{
    if (e->n_given == e->n) return given;
    cotree_run_from_point(e->run, t, e->n_given, given, w);
    return w;
}

/* Return whether a value that was zero has moved to a side that requires another mode. If rates
 * agree on both sides, the mode is changed at the start of the step. */
static int has_left_surface(cotree_events *e, int i, cotree_real side)
{
    int k;
    if (e->events[i].kind != COTREE_JUMP || e->side[i] != COTREE_F(0.0) ||
        !cotree_is_in_direction(e, i, side))
        return 0;
    if (cotree_jumps_compute_new_values(&e->jumps, e->t_after, e->end) != 0) {
        return cotree_fail(e, 0, e->t_after, COTREE_EVENTS_FAILED);
    }
    if (!cotree_jumps_changes_value(&e->jumps, i)) return 0;
    if (!cotree_is_continuous(e, i, e->t_before, e->start))
        return cotree_fail(e, i, e->t_after, COTREE_EVENTS_LEAVES_JUMP);
    for (k = 0; k < e->n_events; ++k) e->is_found[k] = k == i;
    e->n_found = 1;
    e->t = e->t_before;
    cotree_copy(e->n, e->start, e->w);
    return 1;
}

/* Find the first events in a sampled step. */
static int find_first_event(cotree_events *e)
{
    const cotree_real *const g = e->samples + (SAMPLES - 1) * e->n_events;
    cotree_real until;
    int i, first = 0, is_ahead, found, status;
    found = find_crossings(e, &first, &until);
    if (found == REFINE) {
        status = cotree_refine_step(e);
        if (status != 0) return status;
        found = find_crossings(e, &first, &until);
    }
    if (found == SHORTEN) {
        e->t = until;
        status = cotree_solution_at(e, until, e->w);
        return status == 0 && cotree_project(e, until, e->w) == 0 ? COTREE_EVENTS_FOUND
                                                                  : e->failure;
    }
    is_ahead = found == COTREE_EVENTS_NONE;
    if (is_ahead) found = find_at_end(e, &first);
    if (found > COTREE_EVENTS_FOUND) return found;
    if (found == COTREE_EVENTS_FOUND) {
        int is_crossing;
        if (e->from_side[first] == COTREE_F(0.0))
            return cotree_fail_grazing(e, first, e->root_time[first]);
        is_crossing = cotree_refine_root(e, e->root_time[first], first, e->from_side[first]);
        if (e->failure != 0) return e->failure;
        if (is_crossing) {
            if (compute_margin(e, first) != 0) return e->failure;
            for (i = 0; i < e->n_events; ++i) {
                const int is_now = e->is_found[i] && e->root_time[i] <= e->t + e->margin;
                if (is_now && e->from_side[i] == COTREE_F(0.0))
                    return cotree_fail_grazing(e, i, e->root_time[i]);
                /* Each slip must end separately, because sticking friction keeps a remaining
                 * speed. */
                e->is_found[i] = i == first || (is_now && !cotree_is_of_friction(e, i));
                /* The value may have crossed zero in the other direction before, without an
                 * event. */
                if (e->is_found[i]) e->side[i] = e->from_side[i];
            }
            if (add_simultaneous(e) != 0) return e->failure;
            for (i = 0; i < e->n_events; ++i) e->n_found += e->is_found[i];
            return COTREE_EVENTS_FOUND;
        }
        if (!is_ahead) return COTREE_EVENTS_FOUND; /* the integration restarts without an event */
    }
    cotree_copy(e->n_events, g, e->g);
    for (i = 0; i < e->n_events; ++i) {
        if (COTREE_FABS(g[i]) <= cotree_zero_band(e, i) || cotree_is_kink(e, i)) continue;
        if (has_left_surface(e, i, cotree_sign_of(g[i]))) {
            return e->failure != 0 ? e->failure : COTREE_EVENTS_FOUND;
        }
        e->side[i] = cotree_sign_of(g[i]);
        if (e->n_rows > 0) e->stays_at_zero[i] = 0;
    }
    if (cotree_enters_band(e, g)) {
        e->t = e->t_after;
        cotree_copy(e->n, e->end, e->w);
        return COTREE_EVENTS_FOUND;
    }
    e->leaves_branch = cotree_has_left_branch(e, g);
    return COTREE_EVENTS_NONE;
}

int cotree_events_change_branches(cotree_events *e)
{
    return cotree_select_branches(e, e->t_after, e->end) != 0 ? e->failure : COTREE_EVENTS_NONE;
}

int cotree_events_find(cotree_events *e, cotree_real t_before, const cotree_real *start,
                       cotree_real t_after, const cotree_real *end, cotree_real t_end,
                       const cotree_history *h)
{
    cotree_real error = COTREE_F(0.0);
    int status;
    cotree_jumps_forget(&e->jumps);
    e->t_before = t_before;
    e->t_after = t_after;
    e->start = reduced_point(e, t_before, start, e->narrowed);
    e->end = reduced_point(e, t_after, end, e->narrowed + e->n);
    e->t_end = t_end;
    e->n_found = 0;
    e->leaves_branch = 0;
    e->margin = COTREE_F(0.0);
    e->h = h;
    if (h != NULL) {
        error = cotree_history_error(h, h->n_points - 2, e->rtol, e->atols, 0, 0, e->scratch);
    }
    e->history_error = error;
    e->is_fine = error <= FINE_TOLERANCES;
    e->is_refined = h == NULL;
    e->is_coarse = !(error <= COARSE_TOLERANCES);
    if (e->n_kinks == e->n_events) {
        status = cotree_cheap_crossing_test(e);
        if (status != REFINE) return status;
    }
    status = cotree_sample_step(e);
    if (status == 0 && e->is_coarse && cotree_may_cross(e)) status = cotree_refine_step(e);
    return status == 0 ? find_first_event(e) : status;
}

int cotree_events_apply(cotree_events *e)
{
    int i, is_first = 1, status;
    if (cotree_are_only_kinks(e)) return cotree_pass_kinks(e, e->t, e->w);
    status = cotree_compute_rates(e, e->t, e->w);
    for (i = 0; i < e->n_events; ++i) e->crossing_sign[i] = cotree_sign_of(e->jumps.rates[i]);
    for (i = 0; i < e->n_events && status == 0 && e->n_found > 0; ++i) {
        if (!e->is_found[i] || !is_first || cotree_is_kink(e, i)) continue;
        is_first = 0;
        if (!(e->crossing_sign[i] * e->side[i] > COTREE_F(0.0))) continue;
        /* The rate points away from zero, so the value crossed it only by rounding. For friction,
         * the mode selection handles this; after an impact, the gap has no speed; at a continuous
         * jump the step determines the side. */
        if (cotree_is_gap(e, i))
            e->unresolved_gap = i;
        else if (cotree_is_continuous(e, i, e->t, e->w))
            cotree_set_crossing_sign(e, i, -e->side[i]);
        else if (!cotree_is_of_friction(e, i))
            status = cotree_fail(e, i, e->t, COTREE_EVENTS_REST_AT_ZERO);
    }
    if (status == 0) status = cotree_apply_events(e, e->t, e->w, e->n_found, NULL);
    e->unresolved_gap = -1;
    return status;
}

const char *cotree_events_message(int status)
{
    static const cotree_message messages[] = {
        {COTREE_EVENTS_FAILED, "its equations cannot be evaluated"},
        {COTREE_EVENTS_NOT_FINITE, "its event function is not finite"},
        {COTREE_EVENTS_SET_NOT_FINITE, "its new values are not finite"},
        {COTREE_EVENTS_CONTRADICT, "its new values contradict the constraints"},
        {COTREE_EVENTS_UNDERDETERMINED,
         "its new values do not determine all states, so that sensitivities do not exist"},
        {COTREE_EVENTS_REST_AT_ZERO,
         "it leaves no speed away from zero, so that the motion continues through it"},
        {COTREE_EVENTS_GRAZING,
         "its function only touches zero, so that sensitivities do not exist"},
        {COTREE_EVENTS_ACCUMULATE, "it recurs ever faster and accumulates"},
        {COTREE_EVENTS_CHATTER, "it occurs too often within a short time (chattering)"},
        {COTREE_EVENTS_CASCADE, "it and other events trigger each other without end"},
        {COTREE_EVENTS_SLIDING,
         "the motion is driven towards a jump from both sides, and slides along it"},
        {COTREE_EVENTS_LEAVES_JUMP,
         "a value leaves the jump at which it rested, and its direction is not determined"},
        {COTREE_EVENTS_NOT_COMMUTING,
         "the motion depends on the order of simultaneous jumps, so that sensitivities do "
         "not exist"},
        {COTREE_EVENTS_NO_MODES, "dry friction and rigid stops have no consistent modes"},
        {COTREE_EVENTS_INDETERMINATE,
         "the losses of a gear depend on forces of sticking friction, which are not unique"},
        {COTREE_EVENTS_LOCKED_DIRECTION, "a one-way clutch turns in its locked direction"},
        {COTREE_EVENTS_NEGATIVE_GAP, "the gap of a rigid stop is negative at the start"},
        {COTREE_EVENTS_NO_IMPULSES, "rigid stops have no consistent impulses"},
        {COTREE_EVENTS_COUPLED_IMPACTS,
         "the motion depends on the order of simultaneous impacts, so that sensitivities do "
         "not exist"},
        {COTREE_EVENTS_ENERGY_GAIN, "the impact would increase the energy"},
        {COTREE_EVENTS_NOT_UNIQUE,
         "friction allows a contact both to stay closed and to open, so that the motion is "
         "not unique"},
        {COTREE_EVENTS_LOSSY_IMPACT,
         "an impact acts through a gear with losses, whose laws hold only for steady forces"},
        {COTREE_EVENTS_LEAVES_ROOT,
         "a root with an infinite slope drives its argument away from zero, where it rested"},
        {COTREE_EVENTS_BELOW_TOLERANCE, "its impacts are slower than the error tolerance resolves"},
        {-1, "the status is unknown"},
    };
    return cotree_find_message(messages, status);
}
