/* cotree_modes.c: selection of the modes of all rows at a point.
 *
 * Rows whose slip rate, or gap rate at a closed gap, is zero are active: the complementarity
 * conditions determine their modes (cotree_complementarity.c). Friction of any other row slides in
 * the direction of its slip, and any other stop is open. */
#include "cotree_events_internal.h"

#if COTREE_HAS_MODES
/* Growth factor of the zero level of a force at its limit, applied each time the force crosses zero
 * without effect. */
#define ZERO_LEVEL_GROWTH COTREE_F(10.0)

/* Slips below this speed, [m/s] or [rad/s], end together with another slip: it is ten times the
 * speed below which the direction of sliding in space is not resolved. */
#define UNRESOLVED_SLIP COTREE_F(1e-6)

/* Evaluate the event functions and their rates in the modes of the trial. */
int cotree_evaluate_motion(cotree_events *e, cotree_real t, const cotree_real *w)
{
    int k, status;
    cotree_copy(e->n, w, e->trial);
    cotree_rows_store(e->rows, e->n_rows, 0, e->trial);
    status = cotree_compute_rates(e, t, e->trial);
    if (status == 0) status = cotree_compute_values(e, t, e->trial);
    cotree_copy(e->n_events, e->jumps.values, e->samples);
    if (status == 0) status = cotree_update_scales(e, t, e->trial, e->samples);
    e->largest_rate = COTREE_F(0.0);
    for (k = 0; k < e->run->n_rates; ++k)
        e->largest_rate = cotree_larger(COTREE_FABS(e->jumps.state_rates[k]), e->largest_rate);
    return status;
}

/* Return the sign of an event function. If it is zero within the uncertainty of its time, return
 * the sign of its rate. */
cotree_real cotree_moving_side(const cotree_events *e, int i, cotree_real t, cotree_real size)
{
    const cotree_real rate = e->jumps.rates[i], g = e->samples[i];
    const cotree_real late = COTREE_F(4.0) * cotree_spacing(t) * COTREE_FABS(rate);
    if (COTREE_FABS(g) > COTREE_FMAX(COTREE_FMAX(cotree_rounding_band(e, i), e->force_noise),
                                     COTREE_FMAX(LIMIT_RTOL * size, late)))
        return cotree_sign_of(g);
    return COTREE_FABS(rate) * e->span > COTREE_FMAX(ACCELERATION_RTOL * size, e->atol)
               ? cotree_sign_of(rate)
               : COTREE_F(0.0);
}

/* Return the mode in which a friction row slides at w; 1 if it does not slide. */
static cotree_real sliding_mode(const cotree_row *row, const cotree_real *w)
{
    return w[row->mode_state] == -COTREE_F(1.0) ? -COTREE_F(1.0) : COTREE_F(1.0);
}

/* Evaluate the motion with all stops open and all friction sliding. */
static int evaluate_sliding(cotree_events *e, cotree_real t, const cotree_real *w)
{
    cotree_row *row;
    for (row = e->rows; row < END_OF_ROWS; ++row)
        row->mode = row->type == COTREE_ROW_FRICTION ? sliding_mode(row, w)
                    : row->type == COTREE_ROW_LOAD   ? w[row->mode_state]
                                                     : COTREE_F(0.0);
    return cotree_evaluate_motion(e, t, w);
}

/* Determine whether a friction row is active, and otherwise its mode. */
static int find_slip(cotree_events *e, cotree_row *row, cotree_real t, const cotree_real *w,
                     int fired)
{
    const int i = row->event, is_end = fired >= 0 && e->events[fired].kind == COTREE_FRICTION_SLIP;
    const int is_one_way = row->limits[1] < 0, is_disc = cotree_is_disc(row);
    const cotree_real rate = e->jumps.rates[i], mode = w[row->mode_state];
#if COTREE_HAS_DISCS
    const cotree_real v =
        is_disc ? cotree_disc_speed(e, row, mode) : sliding_mode(row, w) * e->samples[i];
#else
    const cotree_real v = sliding_mode(row, w) * e->samples[i];
#endif
    cotree_real near = ZERO_ROUNDINGS * (COTREE_SCAN_ROUNDING * e->value_scale[i] +
                                         cotree_spacing(t) * COTREE_FABS(rate));
    near = COTREE_FMAX(near, cotree_rounding_band(e, i));
    row->sliding_acceleration = rate;
    row->acceleration_scale = COTREE_FABS(rate);
    /* A one-way clutch whose backward slip rate is below the tolerance is at rest. */
    if (mode == COTREE_F(0.0) || (v < COTREE_F(0.0) && is_one_way))
        near = COTREE_FMAX(near, cotree_tolerance(e, i));
    /* If one contact of a body stops slipping, its other contacts stop at the same time. */
    if (is_end && is_disc) near = COTREE_FMAX(near, UNRESOLVED_SLIP);
    /* The direction of a slip below the tolerance is numerical noise. */
    if (is_disc && fired >= 0 && fired == row->direction_event && e->run->n_blocks == 1)
        near = COTREE_FMAX(near, cotree_tolerance(e, i));
    if (mode == COTREE_F(0.0) && row->stop != NULL)
        near = COTREE_FMAX(near, cotree_gap_rate_error(e));
    row->is_active = i == fired || e->is_stepped_over[i] || COTREE_FABS(v) <= near;
    /* Friction sticks again at the time its slip started if the force reaches its limit but does
     * not exceed it. */
    row->is_resticking = i == fired && t - row->slide_start <= COTREE_F(4.0) * cotree_spacing(t);
    if (row->engaged >= 0 &&
        cotree_moving_side(e, row->engaged, t, e->value_scale[row->engaged]) <= COTREE_F(0.0)) {
        row->is_active = 0;
        row->mode = COTREE_F(2.0);
    } else if (row->stop != NULL) {
        /* The mode of contact friction changes with that of its stop. A sliding contact keeps its
         * direction. */
        row->is_active =
            row->is_active || (mode == COTREE_F(2.0) && COTREE_FABS(v) <= cotree_gap_rate_error(e));
        row->slip_sign = row->is_active ? COTREE_F(0.0) : cotree_sign_of(v);
        row->mode = COTREE_F(2.0);
    } else if (row->is_active) {
        row->mode = COTREE_F(0.0);
    } else {
        row->mode = cotree_sign_of(v);
        if (v < COTREE_F(0.0) && is_one_way)
            return cotree_fail(e, i, t, COTREE_EVENTS_LOCKED_DIRECTION);
    }
    return 0;
}

/* Determine whether a stop is active: it is closed, and its gap rate is zero. */
static void find_gap(cotree_events *e, cotree_row *row)
{
    row->is_active =
        row->side != COTREE_F(0.0) && COTREE_FABS(row->gap_rate) <= cotree_zero_gap_rate(e, row);
    /* The scale is the largest acceleration so far: at this time the forces may be small by
     * chance. */
    row->acceleration_scale = row->largest_acceleration =
        COTREE_FMAX(row->largest_acceleration,
                    COTREE_FABS(cotree_jumps_speed_change_rate(&e->jumps, row->event)));
}

/* Return whether friction may slide in either direction. */
static int is_reversible(const cotree_row *row)
{
    return row->type == COTREE_ROW_FRICTION && (row->is_active || row->stop != NULL);
}

/* Set the mode of a row to sliding in reverse. A disc slides in the opposite direction. */
static void reverse(cotree_row *row, const cotree_real *w)
{
    int c;
    row->mode = cotree_is_disc(row) ? COTREE_F(1.0) : -sliding_mode(row, w);
    for (c = 0; c < COTREE_COMPONENTS; ++c) row->direction[c] = -row->direction[c];
}

/* Add to the acceleration scales the effect of friction: the change of each acceleration when the
 * direction of sliding reverses. */
static int add_reversed_accelerations(cotree_events *e, cotree_real t, const cotree_real *w)
{
    cotree_row *row;
    int is_needed = 0, status;
    cotree_save_modes(e);
    for (row = e->rows; row < END_OF_ROWS; ++row) {
        if (!is_reversible(row)) continue;
        reverse(row, w);
        is_needed = 1;
    }
    if (!is_needed) return 0;
    status = cotree_evaluate_motion(e, t, w);
    cotree_restore_modes(e);
    for (row = e->rows; row < END_OF_ROWS; ++row) {
        const cotree_real rate = e->jumps.rates[row->event];
        /* In reverse the slip rate has the opposite sign. */
        if (is_reversible(row))
            row->acceleration_scale =
                COTREE_FMAX(COTREE_FABS(row->sliding_acceleration + rate),
                            COTREE_FMAX(row->acceleration_scale, COTREE_FABS(rate)));
    }
    return status;
}

/* Find the active rows, and set the modes of all other friction rows. */
static int find_active(cotree_events *e, cotree_real t, const cotree_real *w, int fired)
{
    cotree_row *row;
    int status = evaluate_sliding(e, t, w);
#if COTREE_HAS_DISCS
    if (status == 0 && e->n_discs > 0 &&
        cotree_jumps_compute_new_values(&e->jumps, t, e->trial) != 0)
        status = cotree_fail(e, 0, t, COTREE_EVENTS_FAILED);
#endif
    for (row = e->rows; row < END_OF_ROWS && status == 0; ++row) {
        if (row->type == COTREE_ROW_FRICTION) status = find_slip(e, row, t, w, fired);
        if (row->type == COTREE_ROW_STOP) find_gap(e, row);
    }
    return status == 0 ? add_reversed_accelerations(e, t, w) : status;
}

/* Determine whether a force stays at its limit (as if both limits are zero), or a load at zero. The
 * zero level grows each time the force crosses zero without effect. */
static void update_zero_level(cotree_events *e, int i, int may_rest, int is_back, cotree_real t,
                              int fired)
{
    const cotree_real g = COTREE_FABS(e->samples[i]), size = COTREE_FMAX(g, e->value_scale[i]);
    if (!may_rest) {
        e->stays_at_zero[i] = 0;
        e->zero_level[i] = COTREE_F(0.0);
        return;
    }
    e->stays_at_zero[i] = cotree_moving_side(e, i, t, size) == COTREE_F(0.0) ||
                          (is_back && g <= LIMIT_RTOL * size) ||
                          (i == fired && g <= cotree_tolerance(e, i));
    e->zero_level[i] *= i == fired ? ZERO_LEVEL_GROWTH : COTREE_F(1.0);
    e->zero_level[i] = COTREE_FMAX(COTREE_FMAX(e->zero_level[i], TERM_ROUNDINGS * g),
                                   COTREE_FMAX(LIMIT_RTOL * size, cotree_tolerance(e, i)));
    if (!e->stays_at_zero[i]) e->zero_level[i] = COTREE_F(0.0);
}

/* Determine which event functions of a row stay at zero in the selected mode. */
static void update_zero_levels(cotree_events *e, cotree_row *row, cotree_real t, int fired)
{
    const int i = row->event, is_free = row->is_active && !cotree_is_holding(row);
    int c;
    if (row->type == COTREE_ROW_LOAD) update_zero_level(e, i, 1, 0, t, fired);
    if (row->type == COTREE_ROW_FRICTION) {
        e->stays_at_zero[i] = is_free;
        if (is_free) row->slide_start = t;
    }
    for (c = 0; c < 2; ++c) {
        const int gap = row->gaps[c], limit = row->limits[c];
        if (limit >= 0)
            update_zero_level(e, limit, cotree_is_holding(row), row->is_resticking, t, fired);
        if (gap < 0) continue;
        /* The gap of an active stop that opens is still zero. */
        e->stays_at_zero[gap] = is_free && gap == cotree_closed_gap(row);
        e->gap_at_release[gap] = e->stays_at_zero[gap] ? row->gap : COTREE_F(0.0);
    }
}

/* Return whether a row has another mode or direction than at w. */
static int is_changed(const cotree_row *row, const cotree_real *w)
{
    int c, is_rotated = 0;
    for (c = 0; c < COTREE_COMPONENTS && row->direction_states[c] >= 0; ++c)
        is_rotated = is_rotated || row->direction[c] != w[row->direction_states[c]];
    return is_rotated || row->mode != w[row->mode_state];
}

/* Resolve impacts and select all modes at w, after an event or a jump of inputs. Changes of mode
 * are attributed to the last event. */
int cotree_resolve_modes(cotree_events *e, cotree_real t, cotree_real *w, int fired)
{
    cotree_row *row;
    int c, status, has_changed = 0, has_switched = 0, stopped = -1;
    if (e->n_rows == 0) return 0;
    cotree_copy(e->run->n_full, e->jumps.before, e->saved_before);
    for (row = e->rows; row < END_OF_ROWS; ++row) {
        for (c = 0; c < COTREE_COMPONENTS && row->direction_states[c] >= 0; ++c)
            row->direction[c] = w[row->direction_states[c]];
    }
    e->force_noise = COTREE_F(0.0);
    status = cotree_resolve_impacts(e, t, w, fired);
    if (status == 0) status = find_active(e, t, w, fired);
    if (status == 0) status = cotree_select_modes(e, t, w);
#if COTREE_HAS_DISCS
    if (status == 0) status = cotree_end_slips(e, t, w);
#endif
    if (status != 0) return status;
    for (row = e->rows; row < END_OF_ROWS; ++row) {
        update_zero_levels(e, row, t, fired);
        has_switched = has_switched || row->mode != w[row->mode_state];
        has_changed = has_changed || is_changed(row, w);
        if (cotree_is_disc(row) && fired == row->direction_event && row->mode == COTREE_F(0.0))
            stopped = row->event;
    }
    if (has_switched) e->is_mode_changed = 1;
    if (has_changed) status = cotree_jumps_set_modes(&e->jumps, e->rows, e->n_rows, t, w);
    if (e->n_stops > 0 ? fired >= 0 : has_switched)
        cotree_copy(e->run->n_full, e->saved_before, e->jumps.before);
    if (status == 0) cotree_record_impacts(e, t, fired);
    if (status == 0 && stopped >= 0) {
        /* If the direction of a slip below the tolerance turns, the slip ends, too. */
        e->has_fired[stopped] = 1;
        cotree_write_record(e, stopped, t);
    }
    return status == 0 ? 0 : cotree_fail(e, e->rows->event, t, COTREE_EVENTS_FAILED);
}

/* Return whether an event belongs to a friction row that was active in the last selection. */
int cotree_was_selected(const cotree_events *e, int i)
{
    const cotree_row *row;
    for (row = e->rows; row < END_OF_ROWS; ++row) {
        if (row->type != COTREE_ROW_FRICTION) continue;
        if (i == row->event || i == row->limits[0] || i == row->limits[1]) return row->is_active;
    }
    return 0;
}

/* Set the signs of event functions that stay at zero: those of friction and loads, and gaps of
 * stops that may open. */
void cotree_update_mode_sides(cotree_events *e, const cotree_real *w)
{
    const cotree_row *row;
    for (row = e->rows; row < END_OF_ROWS; ++row) {
        const int gap = cotree_closed_gap(row), engaged = row->engaged;
        int c;
        for (c = 0; c < 2 && row->limits[c] >= 0; ++c) {
            if (e->stays_at_zero[row->limits[c]]) e->side[row->limits[c]] = COTREE_F(1.0);
        }
        if (row->type == COTREE_ROW_STOP) {
            /* The gap may be negative within the tolerance of closed gaps. */
            if (row->side != COTREE_F(0.0) &&
                (e->stays_at_zero[gap] ||
                 (w[row->mode_state] == COTREE_F(0.0) && !e->is_stepped_over[gap])))
                e->side[gap] = COTREE_F(1.0);
            continue;
        }
        if (e->stays_at_zero[row->event]) e->side[row->event] = COTREE_F(1.0);
        if (engaged >= 0 && e->side[engaged] == COTREE_F(0.0)) e->side[engaged] = -COTREE_F(1.0);
    }
}
#endif
