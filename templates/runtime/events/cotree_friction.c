/* cotree_friction.c: modes of dry friction.
 * Part of the runtime of cotree, the same for every model.
 */
#include "cotree_events_internal.h"

#include <float.h>
#include <math.h>
#include <stddef.h>

/* Dry friction: which of its laws holds, chosen for all edges at once.
 *
 * An edge has a mode, 0 while it sticks, 1 and -1 while it slides, 2 while it is disengaged, and an
 * event for each reason to change it. Edges at zero relative speed are idle: each sticks at first.
 * Where its force would pass a limit it slides to that side; where it would slide backwards against
 * its mode it sticks again; until nothing contradicts. One edge changes at a time: the one whose
 * force is the first to reach its limit, see cotree_complementarity.c, then the one that is
 * furthest off. */

/* What a force at its limit is taken to move by grows so much each time that it passes the limit
 * without consequences. */
#define ZERO_LEVEL_GROWTH COTREE_F(10.0)

/* Writes a record. */
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

/* Lists the modes that one kind of event stands for, from a place on. Returns how many there are;
 * with places NULL nothing is written. */
int cotree_list_modes(const cotree_hybrid *h, int kind, int *places)
{
    int i, k, n = 0;
    for (i = 0; i < h->n_events; ++i) {
        const cotree_event *const row = h->events + i;
        if (row->kind != kind) continue;
        if (places != NULL) {
            int *const own = places + n * N_PLACES;
            own[MODE_STATE] = row->targets[0];
            for (k = SLIP + 1; k < N_PLACES; ++k) own[k] = -1;
            own[SLIP] = i;
        }
        ++n;
    }
    return n;
}

/* Lists the modes of edges with friction, then those of loads. */
void cotree_list_frictions(cotree_events *e, const cotree_hybrid *h)
{
    int i, k;
    cotree_list_modes(h, COTREE_FRICTION_SLIP, e->places);
    cotree_list_modes(h, COTREE_FRICTION_LOAD, e->places + e->n_frictions * N_PLACES);
    for (i = 0; i < h->n_events; ++i) {
        const int part = h->events[i].kind - COTREE_FRICTION_SLIP;
        if (part <= 0 || part >= N_PLACES - SLIP) continue;
        for (k = 0; k < e->n_frictions; ++k) {
            if (PLACE(k, MODE_STATE) == h->events[i].targets[0]) PLACE(k, SLIP + part) = i;
        }
    }
}

/* Evaluates what the events look at, and its rates, with the modes as they are tried. */
int cotree_evaluate_motion(cotree_events *e, cotree_real t, const cotree_real *w)
{
    int k, status;
    cotree_copy(e->n, w, e->trial);
    for (k = 0; k < e->n_modes; ++k) e->trial[PLACE(k, MODE_STATE)] = e->modes[k];
    status = cotree_compute_values(e, t, e->trial);
    cotree_copy(e->n_events, e->jumps.values, e->samples);
    if (status == 0) status = cotree_update_scales(e, t, e->trial, e->samples);
    if (status == 0) status = cotree_compute_rates(e, t, e->trial);
    e->largest_rate = COTREE_F(0.0);
    for (k = 0; k < e->run->n_rates; ++k)
        e->largest_rate = COTREE_FMAX(e->largest_rate, COTREE_FABS(e->jumps.moving[k]));
    return status;
}

/* On which side of zero a value is: that of its rate where it is at zero, within what its time is
 * uncertain by. */
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

/* Tells which edges are idle, and gives the others their modes. */
static int find_active_friction(cotree_events *e, cotree_real t, const cotree_real *w, int fired)
{
    int k, status;
    for (k = e->n_frictions; k < cotree_first_stop(e); ++k) e->modes[k] = w[PLACE(k, MODE_STATE)];
    for (; k < e->n_modes; ++k) e->modes[k] = COTREE_F(0.0);
    for (k = 0; k < e->n_frictions; ++k) e->modes[k] = -COTREE_F(1.0);
    status = cotree_evaluate_motion(e, t, w);
    for (k = 0; k < e->n_frictions; ++k) e->acceleration_scale[k] = e->jumps.rates[PLACE(k, SLIP)];
    for (k = 0; k < e->n_frictions; ++k) e->modes[k] = COTREE_F(1.0);
    if (status == 0) status = cotree_evaluate_motion(e, t, w);
    for (k = 0; k < e->n_frictions && status == 0; ++k) {
        const int i = PLACE(k, SLIP), grip = PLACE(k, ENGAGED);
        const cotree_real v = e->samples[i], rate = e->jumps.rates[i],
                          mode = w[PLACE(k, MODE_STATE)];
        cotree_real near = ZERO_ROUNDINGS * (COTREE_SCAN_ROUNDING * e->value_scale[i] +
                                             cotree_spacing(t) * COTREE_FABS(rate));
        near = COTREE_FMAX(near, cotree_rounding_band(e, i));
        /* The sum is the difference of accelerations: with the mode -1 the sign is the other one.
         */
        e->acceleration_scale[k] =
            COTREE_FMAX(COTREE_FABS(e->acceleration_scale[k] + rate),
                        COTREE_FMAX(COTREE_FABS(e->acceleration_scale[k]), COTREE_FABS(rate)));
        /* A one-way clutch that turns backwards by less than a tolerance is at rest. */
        if (mode == COTREE_F(0.0) || (v < COTREE_F(0.0) && PLACE(k, BACKWARD_LIMIT) < 0))
            near = COTREE_FMAX(near, cotree_tolerance(e, i));
        if (mode == COTREE_F(0.0) && cotree_is_contact_friction(e, k))
            near = COTREE_FMAX(near, cotree_closing_uncertainty(e));
        e->is_active[k] = i == fired || e->is_stepped_over[i] || COTREE_FABS(v) <= near;
        /* It stops as it begins to slide: its force reaches the limit, and goes no further. */
        e->is_resticking[k] =
            i == fired && t - e->slide_start[k] <= COTREE_F(4.0) * cotree_spacing(t);
        if (grip >= 0 && cotree_moving_side(e, grip, t, e->value_scale[grip]) <= COTREE_F(0.0)) {
            e->is_active[k] = 0;
            e->modes[k] = COTREE_F(2.0);
        } else if (cotree_is_contact_friction(e, k)) {
            /* It is chosen as its stop is; what slips keeps its way. */
            e->is_active[k] = e->is_active[k] || (mode == COTREE_F(2.0) &&
                                                  COTREE_FABS(v) <= cotree_closing_uncertainty(e));
            e->slip_sign[k] = e->is_active[k] ? COTREE_F(2.0) : cotree_sign_of(v);
            e->modes[k] = COTREE_F(2.0);
        } else if (e->is_active[k]) {
            e->modes[k] = COTREE_F(0.0);
        } else {
            e->modes[k] = cotree_sign_of(v);
            if (v < COTREE_F(0.0) && PLACE(k, BACKWARD_LIMIT) < 0)
                status = cotree_fail(e, i, t, COTREE_EVENTS_BACKWARD);
        }
    }
    if (status == 0) cotree_find_active_stops(e);
    return status;
}

/* The largest relative acceleration that is none: a share of what friction changes it by, but not
 * less than the rounding of all rates, of which it is a difference. */
cotree_real cotree_slip_rest_tolerance(const cotree_events *e, int k)
{
    return COTREE_FMAX(ACCELERATION_RTOL * e->acceleration_scale[k],
                       TERM_ROUNDINGS * COTREE_SCAN_ROUNDING * e->largest_rate);
}

/* How far an idle edge is off what its mode asks for, as a share; and the mode that it wants. */
cotree_real cotree_friction_violation(cotree_events *e, int k, cotree_real t, cotree_real *new_mode)
{
    const int forward = PLACE(k, FORWARD_LIMIT), backward = PLACE(k, BACKWARD_LIMIT),
              i = PLACE(k, SLIP);
    const cotree_real rate = e->jumps.rates[i];
    cotree_real up, down, width, largest = COTREE_F(0.0);
    int n;
    if (e->modes[k] != COTREE_F(0.0)) {
        const cotree_real size = e->acceleration_scale[k] =
            COTREE_FMAX(e->acceleration_scale[k], COTREE_FABS(rate));
        const cotree_real none = cotree_slip_rest_tolerance(e, k);
        *new_mode = COTREE_F(0.0);
        if (rate < -none) return -rate / size;
        if (rate > none) return COTREE_F(0.0);
        largest = e->largest_rate;
        for (n = 0; n < e->n_frictions; ++n)
            largest = COTREE_FMAX(largest, e->acceleration_scale[n]);
        return e->curvature[i] * e->span < -JERK_SHARE * largest ? COTREE_EPSILON : COTREE_F(0.0);
    }
    up = e->samples[forward];
    down = backward < 0 ? COTREE_INFINITY : e->samples[backward];
    /* Faces that begin to be pressed together have a negative one, by rounding. */
    width = backward < 0 ? COTREE_FMAX(COTREE_FABS(up), e->value_scale[forward])
                         : COTREE_FABS(up + down);
    if (cotree_moving_side(e, forward, t, width) < COTREE_F(0.0)) {
        *new_mode = COTREE_F(1.0);
        if (up < -COTREE_FMAX(LIMIT_RTOL * width, e->force_noise)) return -up / width;
        return e->is_resticking[k] ? COTREE_F(0.0) : COTREE_EPSILON;
    }
    if (backward >= 0 && cotree_moving_side(e, backward, t, width) < COTREE_F(0.0)) {
        *new_mode = -COTREE_F(1.0);
        if (down < -COTREE_FMAX(LIMIT_RTOL * width, e->force_noise)) return -down / width;
        return e->is_resticking[k] ? COTREE_F(0.0) : COTREE_EPSILON;
    }
    return COTREE_F(0.0);
}

/* One where the sign of a load is another one than its laws stand for, as a share. */
cotree_real cotree_load_violation(const cotree_events *e, int k, cotree_real t)
{
    const int i = PLACE(k, SLIP);
    return cotree_moving_side(e, i, t, e->value_scale[i]) < COTREE_F(0.0) ? COTREE_F(1.0)
                                                                          : COTREE_F(0.0);
}

/* Evaluates how accelerations change where an edge is let go without any. */
int cotree_compute_later_accelerations(cotree_events *e, cotree_real t)
{
    int k, is_needed = 0;
    for (k = 0; k < e->n_frictions; ++k) {
        const cotree_real rate = COTREE_FABS(e->jumps.rates[PLACE(k, SLIP)]);
        is_needed = is_needed || (e->is_active[k] && e->modes[k] != COTREE_F(0.0) &&
                                  rate <= cotree_slip_rest_tolerance(e, k));
    }
    for (k = cotree_first_stop(e); k < e->n_modes; ++k)
        is_needed = is_needed || cotree_is_marginally_open(e, k);
    if (!is_needed) return 0;
    if (cotree_compute_curvature(e, t, e->trial) != 0) return e->failure;
    cotree_store_later_accelerations(e);
    return cotree_compute_rates(e, t, e->trial);
}

/* Whether an event looks at the speed of an edge that has not left zero since it began to slide:
 * no more than rounding says where it is. */
int cotree_stays_at_zero(const cotree_events *e, int i)
{
    return e->n_modes > 0 && e->stays_at_zero[i];
}

/* Notes whether a force stays at its limit, as it does where both limits are zero, or a load at
 * zero. How far rounding moves it there shows only as it passes without consequences. */
static void update_zero_level(cotree_events *e, int i, int may_rest, int is_back, cotree_real t,
                              int fired)
{
    const cotree_real g = COTREE_FABS(e->samples[i]), size = COTREE_FMAX(g, e->value_scale[i]);
    e->stays_at_zero[i] = may_rest && (cotree_moving_side(e, i, t, size) == COTREE_F(0.0) ||
                                       (is_back && g <= LIMIT_RTOL * size) ||
                                       (i == fired && g <= cotree_tolerance(e, i)));
    e->zero_level[i] *= i == fired ? ZERO_LEVEL_GROWTH : COTREE_F(1.0);
    e->zero_level[i] = COTREE_FMAX(COTREE_FMAX(e->zero_level[i], TERM_ROUNDINGS * g),
                                   COTREE_FMAX(LIMIT_RTOL * size, cotree_tolerance(e, i)));
    if (!e->stays_at_zero[i]) e->zero_level[i] = COTREE_F(0.0);
}

/* Notes which values stay at zero once modes are chosen. */
static void update_zero_levels(cotree_events *e, cotree_real t, int fired)
{
    int k, what;
    for (k = 0; k < e->n_frictions; ++k) {
        const int i = PLACE(k, SLIP), sticks = e->modes[k] == COTREE_F(0.0);
        e->stays_at_zero[i] = e->is_active[k] && !sticks;
        if (e->stays_at_zero[i]) e->slide_start[k] = t;
        for (what = FORWARD_LIMIT; what <= BACKWARD_LIMIT; ++what) {
            if (PLACE(k, what) < 0) continue;
            update_zero_level(e, PLACE(k, what), sticks, e->is_resticking[k], t, fired);
        }
    }
    for (; k < cotree_first_stop(e); ++k) update_zero_level(e, PLACE(k, SLIP), 1, 0, t, fired);
    for (; k < e->n_modes; ++k) cotree_update_open_gaps(e, k);
}

/* Chooses all modes at w, after an event or where something else jumps; they change as the last
 * event happens. */
int cotree_resolve_modes(cotree_events *e, cotree_real t, cotree_real *w, int fired)
{
    int k, is_changed = 0, status;
    if (e->n_modes == 0) return 0;
    cotree_copy(e->run->n_full, e->jumps.before, e->saved_before);
    e->force_noise = COTREE_F(0.0);
    status = cotree_resolve_impacts(e, t, w, fired);
    if (status == 0) status = find_active_friction(e, t, w, fired);
    if (status == 0) status = cotree_select_modes(e, t, w);
    if (status != 0) return status;
    for (k = 0; k < e->n_modes; ++k)
        is_changed = is_changed || e->modes[k] != w[PLACE(k, MODE_STATE)];
    update_zero_levels(e, t, fired);
    if (is_changed) {
        e->is_mode_changed = 1;
        status = cotree_jumps_shift(&e->jumps, t, w, e->n_modes, e->places, N_PLACES, e->modes);
    }
    if (e->n_stops > 0 ? fired >= 0 : is_changed)
        cotree_copy(e->run->n_full, e->saved_before, e->jumps.before);
    if (status == 0) cotree_record_impacts(e, t, fired);
    return status == 0 ? 0 : cotree_fail(e, PLACE(0, SLIP), t, COTREE_EVENTS_FAILED);
}

/* Whether an event belongs to an edge whose mode was chosen last, together with others. */
int cotree_was_selected(const cotree_events *e, int i)
{
    int k, what;
    for (k = 0; k < e->n_frictions; ++k) {
        for (what = SLIP; what <= BACKWARD_LIMIT; ++what) {
            if (PLACE(k, what) == i) return e->is_active[k];
        }
    }
    return 0;
}

/* Sets the sides from which the events of friction, and of gaps that are closed but free, come
 * next. */
void cotree_update_mode_sides(cotree_events *e, const cotree_real *w)
{
    int k;
    for (k = 0; k < cotree_first_stop(e); ++k) {
        const int grip = PLACE(k, ENGAGED);
        int what;
        for (what = SLIP; what <= BACKWARD_LIMIT; ++what) {
            const int i = PLACE(k, what);
            if (i >= 0 && e->stays_at_zero[i]) e->side[i] = COTREE_F(1.0);
        }
        if (grip >= 0 && e->side[grip] == COTREE_F(0.0)) e->side[grip] = -COTREE_F(1.0);
    }
    for (; k < e->n_modes; ++k) {
        const int gap = cotree_closed_gap(e, k), is_free = w[PLACE(k, MODE_STATE)] == COTREE_F(0.0);
        if (e->closed_side[k - cotree_first_stop(e)] == COTREE_F(0.0)) continue;
        /* It may be below zero, as far as closed gaps are. */
        if (e->stays_at_zero[gap] || (is_free && !e->is_stepped_over[gap]))
            e->side[gap] = COTREE_F(1.0);
    }
}
