/* cotree_dispatch.c: application of simultaneous events, and of the events that they trigger. */
#include "cotree_events_internal.h"

/* Return whether a crossing towards the given side has the direction of the event. */
int cotree_is_in_direction(const cotree_events *e, int i, cotree_real side)
{
    const int direction = e->events[i].direction;
    return direction == 0 || (cotree_real)direction == side;
}

/* Return a past time of an event; age 0 is the latest time. */
static cotree_real recent_event_time(const cotree_events *e, int i, int age)
{
    const int slot = (e->n_event_times[i] - 1 - age) % COTREE_EVENT_CROWD;
    return e->event_times[i * COTREE_EVENT_CROWD + slot];
}

/* Fail if the last n intervals between the times of an event form a geometric series whose limit is
 * at most `longest` after t. */
static int check_series(cotree_events *e, int i, cotree_real t, int n, cotree_real longest)
{
    cotree_real last, ratio, remaining;
    int k;
    if (e->n_event_times[i] < n + 1) return 0;
    for (k = 0; k < n; ++k) {
        if (!(recent_event_time(e, i, k) - recent_event_time(e, i, k + 1) > COTREE_F(0.0)))
            return 0;
    }
    last = recent_event_time(e, i, 0) - recent_event_time(e, i, 1);
    ratio = last / (recent_event_time(e, i, 1) - recent_event_time(e, i, 2));
    for (k = 1; k < n - 1; ++k) {
        const cotree_real other_ratio =
            (recent_event_time(e, i, k) - recent_event_time(e, i, k + 1)) /
            (recent_event_time(e, i, k + 1) - recent_event_time(e, i, k + 2));
        if (COTREE_FABS(other_ratio - ratio) > SERIES_RATIO_RTOL * ratio) return 0;
    }
    if (ratio >= COTREE_F(1.0)) return 0;
    remaining = last * ratio / (COTREE_F(1.0) - ratio);
    if (!(remaining <= longest)) return 0;
    e->detail = t + remaining;
    return cotree_fail(e, i, t, COTREE_EVENTS_ACCUMULATE);
}

/* Store the time of an event. Fail if its times accumulate, or if they are too close together. */
static int count_event(cotree_events *e, int i, cotree_real t)
{
    /* Keep the count within the range of int. */
    if (e->n_event_times[i] >= 2 * COTREE_EVENT_CROWD) e->n_event_times[i] -= COTREE_EVENT_CROWD;
    e->event_times[i * COTREE_EVENT_CROWD + e->n_event_times[i] % COTREE_EVENT_CROWD] = t;
    ++e->n_event_times[i];
    /* Series of impacts at a stop, and of slips at its contact, end at the rest threshold. */
    if (!cotree_is_gap(e, i) && !cotree_is_contact_slip(e->events + i) &&
        check_series(e, i, t, SERIES_LENGTH, SERIES_REMAINDER_SHARE * e->span) != 0)
        return e->failure;
    if (e->n_event_times[i] < COTREE_EVENT_CROWD) return 0;
    e->detail = t - recent_event_time(e, i, COTREE_EVENT_CROWD - 1);
    return e->detail <= CHATTER_SHARE * e->span ? cotree_fail(e, i, t, COTREE_EVENTS_CHATTER) : 0;
}

int cotree_fail_grazing(cotree_events *e, int i, cotree_real t)
{
    if (check_series(e, i, t, SHORT_SERIES_LENGTH, COTREE_INFINITY) != 0) {
        if (cotree_is_gap(e, i)) e->failure = COTREE_EVENTS_BELOW_TOLERANCE;
        return e->failure;
    }
    return cotree_fail(e, i, t, COTREE_EVENTS_GRAZING);
}

/* Determine whether an event function depends on a sensitivity parameter. */
static int find_dependence(cotree_events *e, int i, cotree_real t, cotree_real *w,
                           int *is_dependent)
{
    e->kernel_status = cotree_jumps_depends_on_parameters(&e->jumps, i, t, w, is_dependent);
    return e->kernel_status == 0 ? 0 : cotree_fail(e, i, t, COTREE_EVENTS_FAILED);
}

/* Fail if a crossing whose time depends on a parameter is grazing: its depth is below the error
 * tolerance. */
static int check_grazing(cotree_events *e, int i, cotree_real t, cotree_real *w)
{
    cotree_real rate;
    int is_dependent;
    if (cotree_compute_rates(e, t, w) != 0) return e->failure;
    rate = e->jumps.rates[i];
    if (cotree_compute_curvature(e, t, w) != 0) return e->failure;
    if (rate != COTREE_F(0.0) && COTREE_F(0.5) * rate * rate > GRAZING_TOLERANCES *
                                                                   cotree_tolerance(e, i) *
                                                                   COTREE_FABS(e->curvature[i]))
        return 0;
    if (find_dependence(e, i, t, w, &is_dependent) != 0) return e->failure;
    return is_dependent ? cotree_fail_grazing(e, i, t) : 0;
}

/* Write the record of an event. */
void cotree_write_record(cotree_events *e, int i, cotree_real t)
{
    const int n = e->run->model->n_states, m = e->run->n_blocks - 1;
    cotree_real *row;
    if (e->records == NULL) return;
    row = e->records + (size_t)e->n_records * COTREE_EVENTS_RECORD((size_t)n, (size_t)m);
    row[0] = t;
    row[1] = (cotree_real)i;
    cotree_copy(m, e->jumps.time_sensitivity, row + 2);
    cotree_copy(n, e->jumps.before, row + 2 + m);
    cotree_copy(n, e->jumps.after, row + 2 + m + n);
    ++e->n_records;
}

/* Apply one event at w. */
static int apply_event(cotree_events *e, int i, cotree_real t, cotree_real *w, int is_time_fixed)
{
    const int is_smooth = cotree_is_continuous(e, i, t, w);
    int k, status = count_event(e, i, t);
    if (status == 0 && e->run->n_blocks > 1 && !is_time_fixed) status = check_grazing(e, i, t, w);
    if (status != 0) {
        /* If the rates are continuous, the event time and the number of crossings have no
         * effect. */
        if (status == COTREE_EVENTS_FAILED || !is_smooth) return status;
        is_time_fixed = 1;
        e->failure = 0;
    }
    status = cotree_jumps_apply(&e->jumps, i, t, w, is_time_fixed);
#if COTREE_HAS_CONSTRAINTS
    if (status == COTREE_JUMPS_CONTRADICT) e->detail = (cotree_real)e->jumps.assembly.culprit;
#endif
    if (status == COTREE_JUMPS_CONTRADICT) return cotree_fail(e, i, t, COTREE_EVENTS_CONTRADICT);
    if (status == COTREE_JUMPS_UNDERDETERMINED)
        return cotree_fail(e, i, t, COTREE_EVENTS_UNDERDETERMINED);
    if (status != 0) return cotree_fail(e, i, t, COTREE_EVENTS_FAILED);
#if COTREE_HAS_MODES
    if (cotree_resolve_modes(e, t, w, i) != 0) return e->failure;
#endif
    for (k = 0; k < e->run->n_full; ++k) {
        if (!(COTREE_FABS(e->jumps.after[k]) <= COTREE_MAX)) {
            return cotree_fail(e, i, t, COTREE_EVENTS_SET_NOT_FINITE);
        }
    }
    e->has_fired[i] = 1;
    if (e->events[i].is_terminal) e->terminal_event = i;
    cotree_write_record(e, i, t);
    return 0;
}

/* Return whether an event, or the opposite event of the same jump, was just applied: its function
 * is then zero within the error tolerance. */
static int has_just_fired(const cotree_events *e, int i)
{
    int k;
    for (k = i > 0 ? i - 1 : 0; k <= i + 1 && k < e->n_events; ++k) {
        if (!e->has_fired[k]) continue;
        if (k == i) return 1;
        if (cotree_is_of_same_jump(e, i, k)) return 1;
    }
    return 0;
}

/* Set the direction in which a jump is crossed, for both of its events. */
void cotree_set_crossing_sign(cotree_events *e, int i, cotree_real sign)
{
    int k;
    for (k = 0; k < e->n_events; ++k) {
        if (k == i || cotree_is_of_same_jump(e, i, k)) e->crossing_sign[k] = sign;
    }
}

/* Return whether the second derivative of an event function at zero exceeds rounding, at the last
 * evaluation. */
int cotree_has_curvature(const cotree_events *e, int i)
{
    return COTREE_FABS(e->curvature[i]) * e->span > ZERO_RATE_SHARE * e->rate_before[i];
}

/* Write the sign of each event function to samples. If a function is zero, its sign is that of its
 * rate or, for jumps at zero rate, of its second derivative. */
static int compute_sides(cotree_events *e, cotree_real t, const cotree_real *w)
{
    int i, has_curvature = 0, status = cotree_compute_values(e, t, w);
    cotree_copy(e->n_events, e->jumps.values, e->g);
    if (status == 0) status = cotree_update_scales(e, t, w, e->g);
    if (status == 0) status = cotree_compute_rates(e, t, w);
    for (i = 0; i < e->n_events; ++i) {
        const cotree_real rate = e->jumps.rates[i];
        const cotree_real near =
            has_just_fired(e, i) ? COTREE_FMAX(cotree_rounding_band(e, i), cotree_tolerance(e, i))
                                 : cotree_rounding_band(e, i);
        e->is_near[i] = 0;
        e->samples[i] = COTREE_FABS(rate) > ZERO_RATE_SHARE * e->rate_before[i]
                            ? cotree_sign_of(rate)
                            : COTREE_F(0.0);
        if (COTREE_FABS(e->g[i]) > near)
            e->samples[i] = cotree_sign_of(e->g[i]);
        else if (cotree_stays_at_zero(e, i))
            e->samples[i] = e->side[i];
        else if (e->is_continuous[i] && has_just_fired(e, i))
            e->samples[i] = e->crossing_sign[i];
        else
            e->is_near[i] = e->events[i].kind == COTREE_JUMP &&
                            e->samples[i] == (cotree_real)e->events[i].direction;
    }
    for (i = 0; i < e->n_events && status == 0; ++i) {
        if (!e->is_near[i]) continue;
        e->samples[i] = cotree_side_after(e, i, t, w);
        status = e->failure;
    }
    for (i = 0; i < e->n_events && status == 0; ++i) {
        if (e->events[i].kind != COTREE_JUMP || e->samples[i] != COTREE_F(0.0)) continue;
        if (!has_curvature) status = cotree_compute_curvature(e, t, w);
        has_curvature = 1;
        if (status == 0 && cotree_has_curvature(e, i))
            e->samples[i] = cotree_sign_of(e->curvature[i]);
    }
    return status;
}

/* Apply the located jumps to a copy of w, in forward or reverse order. */
static int apply_jumps(cotree_events *e, cotree_real t, cotree_real *w, int is_reverse)
{
    int k, status = 0;
    for (k = 0; k < e->n_events && status == 0; ++k) {
        const int i = is_reverse ? e->n_events - 1 - k : k;
        if (!e->is_found[i] || e->events[i].kind != COTREE_JUMP) continue;
        status = cotree_jumps_apply(&e->jumps, i, t, w, 0);
    }
    return status;
}

/* Fail if simultaneous jumps do not commute and a parameter separates their times, since
 * sensitivities then do not exist. */
static int check_order(cotree_events *e, cotree_real t, cotree_real *w)
{
    int i, first = -1, are_apart = 0, is_dependent;
    for (i = 0; i < e->n_events && e->run->n_blocks > 1; ++i) {
        if (!e->is_found[i] || e->events[i].kind != COTREE_JUMP) continue;
        if (first < 0) {
            first = i;
            if (find_dependence(e, i, t, w, &is_dependent) != 0) return e->failure;
        }
        are_apart = are_apart || !cotree_jumps_share_time(&e->jumps, first, i);
    }
    if (!are_apart) return 0;
    cotree_copy(e->n, w, e->other);
    cotree_copy(e->n, w, e->sum);
    if (apply_jumps(e, t, e->other, 0) != 0 || apply_jumps(e, t, e->sum, 1) != 0) {
        return cotree_fail(e, first, t, COTREE_EVENTS_FAILED);
    }
    for (i = 0; i < e->n; ++i) {
        const cotree_real size = COTREE_FMAX(COTREE_FABS(e->other[i]), COTREE_FABS(e->sum[i]));
        if (COTREE_FABS(e->other[i] - e->sum[i]) > SAME_RTOL * size + e->atol) {
            return cotree_fail(e, first, t, COTREE_EVENTS_NOT_COMMUTING);
        }
    }
    return 0;
}

/* Apply the located events, each in the direction of its crossing. n_fired: the number of events
 * applied. e->side contains the signs after the last event. */
static int apply_found(cotree_events *e, cotree_real t, cotree_real *w, int *n_fired)
{
    int i, status = check_order(e, t, w);
    if (status == 0) status = cotree_compute_values(e, t, w);
    for (i = 0; i < e->n_events; ++i) {
        /* A function that is zero counts as having crossed zero. */
        if (COTREE_FABS(e->jumps.values[i]) <= cotree_rounding_band(e, i) &&
            (e->events[i].kind >= COTREE_JUMP || e->crossing_sign[i] != COTREE_F(0.0)))
            e->side[i] = e->crossing_sign[i];
        e->has_fired[i] = e->is_found[i] && cotree_is_kink(e, i);
    }
    for (i = 0; i < e->n_events && status == 0; ++i) {
        if (!e->is_found[i] || cotree_is_kink(e, i)) continue;
        if (*n_fired > 0) {
            status = cotree_compute_rates(e, t, w);
            if (!(e->jumps.rates[i] * e->crossing_sign[i] > COTREE_F(0.0)))
                continue; /* an earlier event reversed the crossing */
#if COTREE_HAS_MODES
            if (cotree_was_selected(e, i)) continue;
#endif
        }
        if (status == 0) status = apply_event(e, i, t, w, 0);
        if (status == 0) status = compute_sides(e, t, w);
        e->side[i] = e->samples[i];
        ++*n_fired;
    }
    return status;
}

/* Set the failure of an endless cascade, and mark the events of the last rounds. If all are jumps,
 * the motion slides along a switching surface. If no rate jumps, now or shortly afterwards, all
 * modes are valid and there is no failure. */
static int fail_cascade(cotree_events *e, cotree_real t, const cotree_real *w)
{
    const cotree_real later = t + CURVATURE_STEP_SHARE * e->span;
    int i, first = -1, are_jumps = 1, are_kinks = 1;
    if (cotree_compute_curvature(e, t, w) != 0) return e->failure;
    for (i = 0; i < e->n_events; ++i) {
        if (!e->is_found[i]) continue;
        are_kinks = are_kinks && cotree_is_continuous(e, i, t, w) &&
                    cotree_is_continuous(e, i, later, e->other);
    }
    for (i = 0; i < e->n_events && are_kinks; ++i) e->side[i] = e->samples[i];
    if (are_kinks) return 0;
    for (i = 0; i < e->n_events; ++i) {
        e->has_fired[i] = e->is_found[i];
        if (!e->is_found[i]) continue;
        if (first < 0) first = i;
        are_jumps = are_jumps && e->events[i].kind == COTREE_JUMP;
    }
    return cotree_fail(e, first, t, are_jumps ? COTREE_EVENTS_SLIDING : COTREE_EVENTS_CASCADE);
}

/* Return whether the mode of a jump disagrees with the sign of its function, because an event
 * changed the value or the value leaves zero. */
static int is_mode_wrong(const cotree_events *e, int i)
{
    return e->events[i].kind == COTREE_JUMP &&
           e->samples[i] == (cotree_real)e->events[i].direction &&
           cotree_jumps_changes_value(&e->jumps, i);
}

/* Fail if a value leaves a switching surface at an undetermined time. */
static int check_leaving(cotree_events *e, int i, cotree_real t, const cotree_real *w)
{
    int k, is_timed = e->is_time_fixed || e->run->n_blocks == 1 || e->side[i] != COTREE_F(0.0);
    for (k = 0; k < e->n_events; ++k) is_timed = is_timed || e->has_fired[k];
    return is_timed || cotree_is_continuous(e, i, t, w)
               ? 0
               : cotree_fail(e, i, t, COTREE_EVENTS_LEAVES_JUMP);
}

/* Return whether an earlier event or a time event determines the time. Kinks do not count, because
 * their times have no effect: all rates are continuous. */
static int has_fixed_time(const cotree_events *e)
{
    int k, is_fixed = e->is_time_fixed;
    for (k = 0; k < e->n_events; ++k)
        is_fixed = is_fixed || (e->has_fired[k] && !cotree_is_kink(e, k));
    return is_fixed;
}

/* Return whether another event, or an input, has set the function of a scene's event to zero, with
 * zero rate. The event occurs if the function then leaves zero to the other side. */
static int has_jumped_to_zero(const cotree_events *e, int i)
{
    return e->events[i].kind < COTREE_JUMP && e->samples[i] == COTREE_F(0.0) && !e->has_fired[i];
}

/* Apply triggered events until no event function changes sign. */
static int process_cascade(cotree_events *e, cotree_real t, cotree_real *w)
{
    int i, round, status = 0, has_jumps = 0;
    for (i = 0; i < e->n_events; ++i) has_jumps = has_jumps || e->events[i].kind == COTREE_JUMP;
    for (round = 0; round < COTREE_EVENT_ROUNDS; ++round) {
        int first = -1;
        if (has_jumps && cotree_jumps_compute_new_values(&e->jumps, t, w) != 0)
            return cotree_fail(e, 0, t, COTREE_EVENTS_FAILED);
        for (i = 0; i < e->n_events && round == COTREE_EVENT_ROUNDS / 2; ++i) e->is_found[i] = 0;
        for (i = 0; i < e->n_events; ++i) {
            const int is_crossed = e->events[i].kind != COTREE_JUMP && !cotree_is_kink(e, i) &&
                                   e->samples[i] * e->side[i] < COTREE_F(0.0) &&
                                   cotree_is_in_direction(e, i, e->samples[i]);
            if (is_crossed || is_mode_wrong(e, i)) {
                if (first < 0) first = i;
            } else if (!has_jumped_to_zero(e, i)) {
                e->side[i] = e->samples[i];
            }
        }
        if (first < 0) return 0;
        if (e->events[first].kind == COTREE_JUMP && check_leaving(e, first, t, w) != 0)
            return e->failure;
        e->is_found[first] = 1;
        status = apply_event(e, first, t, w, has_fixed_time(e));
        if (status == 0) status = compute_sides(e, t, w);
        if (status != 0) return status;
        e->side[first] = e->samples[first];
    }
    return fail_cascade(e, t, w);
}

/* Fail if an event function stays at zero with zero rate but has a nonzero second derivative. */
static int check_rest(cotree_events *e, int i, cotree_real t, const cotree_real *w)
{
    /* The mode selection covers friction and gaps, and process_cascade covers jumps. */
    if (e->side[i] != COTREE_F(0.0) || e->terminal_event >= 0 || cotree_stays_at_zero(e, i) ||
        cotree_is_of_friction(e, i))
        return 0;
    if (e->events[i].kind == COTREE_JUMP) return 0;
    if (cotree_compute_curvature(e, t, w) != 0) return e->failure;
    if (!(e->curvature[i] * e->crossing_sign[i] > COTREE_F(0.0) && cotree_has_curvature(e, i)))
        return 0;
    return cotree_fail(e, i, t, COTREE_EVENTS_REST_AT_ZERO);
}

/* Apply the located events at w, then the events that they trigger. slopes: derivatives of the time
 * with respect to the parameters if no event determines it; NULL: zeros. */
int cotree_apply_events(cotree_events *e, cotree_real t, cotree_real *w, int n_found,
                        const cotree_real *slopes)
{
    int i, n_fired = 0, status = cotree_compute_rates(e, t, w);
    e->n_fired = e->is_mode_changed = 0;
    /* The events may move arguments to other branches. */
    cotree_release_branches(e);
    for (i = 0; i < e->n_events; ++i) {
        e->has_fired[i] = 0;
        e->rate_before[i] = COTREE_FABS(e->jumps.rates[i]);
    }
    for (i = 0; i < e->run->n_blocks - 1; ++i) {
        e->jumps.time_sensitivity[i] = slopes == NULL ? COTREE_F(0.0) : slopes[i];
    }
#if COTREE_HAS_MODES
    if (status == 0 && n_found == 0) status = cotree_resolve_modes(e, t, w, -1);
#endif
    if (status == 0 && n_found > 0) status = apply_found(e, t, w, &n_fired);
    if (status == 0 && n_fired == 0) status = compute_sides(e, t, w);
    if (status == 0) status = process_cascade(e, t, w);
    for (i = 0; i < e->n_events && status == 0; ++i) {
        e->n_fired += e->has_fired[i];
        if (e->has_fired[i] && !cotree_is_kink(e, i)) status = check_rest(e, i, t, w);
    }
#if COTREE_HAS_MODES
    cotree_update_mode_sides(e, w);
#endif
    if (status == 0) status = cotree_select_branches(e, t, w);
    if (status == 0) cotree_settle_sensitivities(e, t, w);
    if (status == 0 && e->n_fired > 0) {
        for (i = 0; i < e->n_events; ++i) e->recent_scale[i] = COTREE_FABS(e->g[i]);
    }
    return status;
}
