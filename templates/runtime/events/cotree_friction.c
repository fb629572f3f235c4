/* cotree_friction.c: modes of dry friction.
 *
 * A friction constraint has mode 0 if it sticks, 1 or -1 if it slides, and 2 if it is disengaged,
 * with one event for each reason to change the mode. Constraints with zero slip rate are active:
 * each starts sticking, slides if its force exceeds a limit, and sticks again if its acceleration
 * opposes its mode. cotree_complementarity.c selects all modes together. */
#include "cotree_events_internal.h"

#include <float.h>
#include <math.h>
#include <stddef.h>

#if COTREE_HAS_MODES
/* Growth factor of the zero level of a force at its limit, applied each time the force crosses zero
 * without effect. */
#define ZERO_LEVEL_GROWTH COTREE_F(10.0)

/* Slips below this speed, [m/s], end together with another slip: it is ten times the speed below
 * which the direction of sliding on a plane is not resolved. */
#define UNRESOLVED_SLIP COTREE_F(1e-6)

/* List the modes whose first event is of the given kind. Return their number; if places is NULL,
 * only count them. */
static int list_modes(const cotree_hybrid *h, int kind, int *places)
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

/* List the modes of friction, of loads and of stops, and the events of each mode. */
static void list_events(cotree_events *e, const cotree_hybrid *h)
{
    int i, k;
    list_modes(h, COTREE_FRICTION_SLIP, e->places);
    list_modes(h, COTREE_FRICTION_LOAD, e->places + e->n_frictions * N_PLACES);
    list_modes(h, COTREE_STOP_REBOUND, e->places + cotree_first_stop(e) * N_PLACES);
    for (i = 0; i < h->n_events; ++i) {
        const int kind = h->events[i].kind, is_gap = kind >= COTREE_STOP_UPPER;
        if (kind <= COTREE_FRICTION_SLIP || kind > COTREE_STOP_FORCE) continue;
        for (k = 0; k < e->n_modes && kind != COTREE_FRICTION_LOAD; ++k) {
            if (PLACE(k, MODE_STATE) != h->events[i].targets[0]) continue;
            PLACE(k, is_gap ? UPPER_GAP + kind - COTREE_STOP_UPPER
                            : SLIP + kind - COTREE_FRICTION_SLIP) = i;
        }
    }
}

/* Count the modes, and allocate and initialise their arrays. */
void cotree_init_modes(cotree_events *e, const cotree_run *run, cotree_arena *arena)
{
    const cotree_hybrid *const h = run->model->hybrid;
    const int n_frictions = list_modes(h, COTREE_FRICTION_SLIP, NULL);
    const int n_stops = list_modes(h, COTREE_STOP_REBOUND, NULL);
    const int n_pressed = cotree_count_contact_friction(h);
    const int n_modes = n_frictions + list_modes(h, COTREE_FRICTION_LOAD, NULL) + n_stops;
#if COTREE_HAS_DISCS
    const int n_discs = cotree_count_discs(h);
#else
    const int n_discs = 0;
#endif
    int i;
    e->n_frictions = n_frictions;
    e->n_discs = n_discs;
    e->n_modes = n_modes;
    e->n_stops = n_stops;
    e->n_contact_friction = n_pressed;
    if (n_modes == 0) return;
    e->places = cotree_arena_ints(arena, N_PLACES * n_modes);
    e->is_active = cotree_arena_ints(arena, n_modes);
    e->stays_at_zero = cotree_arena_ints(arena, e->n_events);
    e->is_stepped_over = cotree_arena_ints(arena, e->n_events);
    e->zero_level = cotree_arena_reals(arena, e->n_events);
    e->is_resticking = cotree_arena_ints(arena, n_frictions);
    e->slide_start = cotree_arena_reals(arena, n_frictions);
    e->modes = cotree_arena_reals(arena, n_modes);
    e->acceleration_scale = cotree_arena_reals(arena, n_modes);
    e->slack = cotree_arena_reals(arena, 2 * n_modes);
    e->tried_codes = cotree_arena_reals(arena, N_TRIED_CODES);
    e->trial = cotree_arena_reals(arena, run->n);
    e->saved_before = cotree_arena_reals(arena, run->n_full);
    e->gaps = cotree_arena_reals(arena, n_stops);
    e->later_acceleration = cotree_arena_reals(arena, n_stops);
    e->largest_acceleration = cotree_arena_reals(arena, n_stops);
    e->closed_side = cotree_arena_reals(arena, n_stops);
    e->opening_speed = cotree_arena_reals(arena, n_stops);
    e->largest_opening_speed = cotree_arena_reals(arena, n_stops);
    e->speed_terms = cotree_arena_reals(arena, n_stops);
    e->required_speed = cotree_arena_reals(arena, n_stops);
    e->gap_at_release = cotree_arena_reals(arena, e->n_events);
    e->is_impact_event = cotree_arena_ints(arena, e->n_events);
    e->was_holding = cotree_arena_ints(arena, n_stops);
    e->impact_role = cotree_arena_ints(arena, n_stops);
    e->ends_at_rest = cotree_arena_ints(arena, n_stops);
    e->restitution_event = cotree_arena_ints(arena, n_stops);
    e->impact_events = cotree_arena_ints(arena, n_stops + n_pressed + n_discs);
    e->impulse_states = cotree_arena_ints(arena, n_stops + n_pressed + n_discs);
    e->force_events = cotree_arena_ints(arena, n_modes - n_frictions + 2 * n_pressed + n_discs);
    e->contact_friction = cotree_arena_ints(arena, n_pressed);
    e->normal_stop = cotree_arena_ints(arena, n_frictions);
    e->slip_speed = cotree_arena_reals(arena, 2 * n_pressed);
#if COTREE_HAS_DISCS
    e->disc = cotree_arena_ints(arena, n_frictions);
    e->direction_states = cotree_arena_ints(arena, 2 * n_discs);
    e->directions = cotree_arena_reals(arena, 2 * n_discs);
    e->saved_directions = cotree_arena_reals(arena, 2 * n_discs);
    e->last_turns = cotree_arena_reals(arena, 5 * n_discs);
#endif
    e->slip_sign = cotree_arena_reals(arena, n_frictions);
    e->saved_modes = cotree_arena_reals(arena, n_modes);
    e->kernel_modes = cotree_arena_reals(arena, n_stops > 0 ? n_modes : 0);
    if (arena->base == NULL) return;
    list_events(e, h);
#if COTREE_HAS_DISCS
    cotree_list_discs(e);
#endif
    cotree_list_stops(e);
    for (i = 0; i < e->n_events; ++i) {
        e->is_impact_event[i] = 0;
        e->gap_at_release[i] = e->zero_level[i] = COTREE_F(0.0);
        e->stays_at_zero[i] = e->is_stepped_over[i] = 0;
    }
    for (i = 0; i < n_stops; ++i) e->closed_side[i] = COTREE_F(0.0);
    for (i = 0; i < n_frictions; ++i) e->slide_start[i] = -COTREE_INFINITY;
    e->is_impact = 0;
    e->force_noise = e->largest_rate = e->impact_speed = COTREE_F(0.0);
}

/* Evaluate the event functions and their rates in the modes of the trial. */
int cotree_evaluate_motion(cotree_events *e, cotree_real t, const cotree_real *w)
{
    int k, status;
    cotree_copy(e->n, w, e->trial);
    for (k = 0; k < e->n_modes; ++k) e->trial[PLACE(k, MODE_STATE)] = e->modes[k];
#if COTREE_HAS_DISCS
    cotree_store_directions(e, e->trial);
#endif
    status = cotree_compute_values(e, t, e->trial);
    cotree_copy(e->n_events, e->jumps.values, e->samples);
    if (status == 0) status = cotree_update_scales(e, t, e->trial, e->samples);
    if (status == 0) status = cotree_compute_rates(e, t, e->trial);
    e->largest_rate = COTREE_F(0.0);
    for (k = 0; k < e->run->n_rates; ++k)
        e->largest_rate = COTREE_FMAX(e->largest_rate, COTREE_FABS(e->jumps.state_rates[k]));
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

/* Find the active friction constraints, and set the modes of the others. */
static int find_active_friction(cotree_events *e, cotree_real t, const cotree_real *w, int fired)
{
    const int is_end = fired >= 0 && e->rows[fired].kind == COTREE_FRICTION_SLIP;
    int k, status;
    for (k = e->n_frictions; k < cotree_first_stop(e); ++k) e->modes[k] = w[PLACE(k, MODE_STATE)];
    for (; k < e->n_modes; ++k) e->modes[k] = COTREE_F(0.0);
    for (k = 0; k < e->n_frictions; ++k) e->modes[k] = -COTREE_F(1.0);
    status = cotree_evaluate_motion(e, t, w);
    for (k = 0; k < e->n_frictions; ++k) e->acceleration_scale[k] = e->jumps.rates[PLACE(k, SLIP)];
    for (k = 0; k < e->n_frictions; ++k) e->modes[k] = COTREE_F(1.0);
    if (status == 0) status = cotree_evaluate_motion(e, t, w);
#if COTREE_HAS_DISCS
    if (status == 0 && e->n_discs > 0 &&
        cotree_jumps_compute_new_values(&e->jumps, t, e->trial) != 0)
        status = cotree_fail(e, 0, t, COTREE_EVENTS_FAILED);
#endif
    for (k = 0; k < e->n_frictions && status == 0; ++k) {
        const int i = PLACE(k, SLIP), grip = PLACE(k, ENGAGED);
        const cotree_real rate = e->jumps.rates[i], mode = w[PLACE(k, MODE_STATE)];
#if COTREE_HAS_DISCS
        const cotree_real v = cotree_is_disc(e, k) ? cotree_disc_speed(e, k, mode) : e->samples[i];
#else
        const cotree_real v = e->samples[i];
#endif
        cotree_real near = ZERO_ROUNDINGS * (COTREE_SCAN_ROUNDING * e->value_scale[i] +
                                             cotree_spacing(t) * COTREE_FABS(rate));
        near = COTREE_FMAX(near, cotree_rounding_band(e, i));
        /* In mode -1 the slip rate has the opposite sign: the sum is the difference of the
         * accelerations. */
        e->acceleration_scale[k] =
            COTREE_FMAX(COTREE_FABS(e->acceleration_scale[k] + rate),
                        COTREE_FMAX(COTREE_FABS(e->acceleration_scale[k]), COTREE_FABS(rate)));
        /* A one-way clutch whose backward slip rate is below a tolerance is at rest. */
        if (mode == COTREE_F(0.0) || (v < COTREE_F(0.0) && PLACE(k, BACKWARD_LIMIT) < 0))
            near = COTREE_FMAX(near, cotree_tolerance(e, i));
        /* All contacts of one body stop slipping together. */
        if (is_end && cotree_is_disc(e, k)) near = COTREE_FMAX(near, UNRESOLVED_SLIP);
        if (mode == COTREE_F(0.0) && cotree_is_contact_friction(e, k))
            near = COTREE_FMAX(near, cotree_closing_uncertainty(e));
        e->is_active[k] = i == fired || e->is_stepped_over[i] || COTREE_FABS(v) <= near;
        /* Friction sticks again when its slip starts: the force reaches its limit, but does not
         * exceed it. */
        e->is_resticking[k] =
            i == fired && t - e->slide_start[k] <= COTREE_F(4.0) * cotree_spacing(t);
        if (grip >= 0 && cotree_moving_side(e, grip, t, e->value_scale[grip]) <= COTREE_F(0.0)) {
            e->is_active[k] = 0;
            e->modes[k] = COTREE_F(2.0);
        } else if (cotree_is_contact_friction(e, k)) {
            /* The mode of contact friction changes with that of its stop. A sliding contact keeps
             * its direction. */
            e->is_active[k] = e->is_active[k] || (mode == COTREE_F(2.0) &&
                                                  COTREE_FABS(v) <= cotree_closing_uncertainty(e));
            e->slip_sign[k] = e->is_active[k] ? COTREE_F(0.0) : cotree_sign_of(v);
            e->modes[k] = COTREE_F(2.0);
        } else if (e->is_active[k]) {
            e->modes[k] = COTREE_F(0.0);
        } else {
            e->modes[k] = cotree_sign_of(v);
            if (v < COTREE_F(0.0) && PLACE(k, BACKWARD_LIMIT) < 0)
                status = cotree_fail(e, i, t, COTREE_EVENTS_LOCKED_DIRECTION);
        }
    }
    if (status == 0) cotree_find_active_stops(e);
    return status;
}

/* Return the magnitude below which a slip acceleration counts as zero: a fraction of the
 * accelerations caused by friction, but at least the rounding of the largest rate, since it is a
 * difference of rates. */
cotree_real cotree_slip_rest_tolerance(const cotree_events *e, int k)
{
    return COTREE_FMAX(ACCELERATION_RTOL * e->acceleration_scale[k],
                       TERM_ROUNDINGS * COTREE_SCAN_ROUNDING * e->largest_rate);
}

/* Set whether a force stays at its limit, as it does if both limits are zero, and for a load at
 * zero. The zero level grows each time the force crosses zero without effect. */
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

/* Determine which event functions stay at zero with the selected modes. */
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

/* Resolve impacts and select all modes at w, after an event or a jump of inputs. Changes of mode
 * are attributed to the last event. */
int cotree_resolve_modes(cotree_events *e, cotree_real t, cotree_real *w, int fired)
{
    int k, is_changed = 0, status;
#if COTREE_HAS_DISCS
    int is_turned = 0;
#endif
    if (e->n_modes == 0) return 0;
    cotree_copy(e->run->n_full, e->jumps.before, e->saved_before);
#if COTREE_HAS_DISCS
    cotree_load_directions(e, w);
#endif
    e->force_noise = COTREE_F(0.0);
    status = cotree_resolve_impacts(e, t, w, fired);
    if (status == 0) status = find_active_friction(e, t, w, fired);
    if (status == 0) status = cotree_select_modes(e, t, w);
#if COTREE_HAS_DISCS
    if (status == 0) status = cotree_end_slips(e, t, w);
#endif
    if (status != 0) return status;
    for (k = 0; k < e->n_modes; ++k)
        is_changed = is_changed || e->modes[k] != w[PLACE(k, MODE_STATE)];
    update_zero_levels(e, t, fired);
#if COTREE_HAS_DISCS
    for (k = 0; k < 2 * e->n_discs; ++k)
        is_turned = is_turned || e->directions[k] != w[e->direction_states[k]];
    if (is_turned)
        status = cotree_jumps_set_modes(&e->jumps, t, w, 2 * e->n_discs, e->direction_states, 1,
                                        e->directions);
#endif
    if (is_changed) {
        e->is_mode_changed = 1;
        if (status == 0)
            status =
                cotree_jumps_set_modes(&e->jumps, t, w, e->n_modes, e->places, N_PLACES, e->modes);
    }
    if (e->n_stops > 0 ? fired >= 0 : is_changed)
        cotree_copy(e->run->n_full, e->saved_before, e->jumps.before);
    if (status == 0) cotree_record_impacts(e, t, fired);
    return status == 0 ? 0 : cotree_fail(e, PLACE(0, SLIP), t, COTREE_EVENTS_FAILED);
}

/* Return whether an event belongs to a friction constraint in the last mode selection. */
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

/* Set the signs of the event functions of friction, and of gaps that are closed but free to
 * open. */
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
        /* The gap may be negative within the tolerance of closed gaps. */
        if (e->stays_at_zero[gap] || (is_free && !e->is_stepped_over[gap]))
            e->side[gap] = COTREE_F(1.0);
    }
}
#endif
