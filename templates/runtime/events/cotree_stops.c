/* cotree_stops.c: modes of rigid stops, and of friction at contacts. */
#include "cotree_events_internal.h"

#include <float.h>
#include <math.h>
#include <stddef.h>

#if COTREE_HAS_MODES
/* Fraction by which states are changed to find the magnitude of the terms of gaps, and the fraction
 * by which that change varies from state to state. */
#define TERM_SHARE COTREE_SELECT(1e-7, 1e-3f)

#define GOLDEN_SHARE COTREE_F(0.6180339887498949)

int cotree_first_stop(const cotree_events *e) { return e->n_modes - e->n_stops; }

/* Count the friction constraints whose normal force is the force of a stop. */
int cotree_count_contact_friction(const cotree_hybrid *h)
{
    int i, n = 0;
    for (i = 0; i < h->n_events; ++i) n += cotree_is_contact_slip(h->events + i);
    return n;
}

/* List the friction constraints at contacts, and their stops, which must be listed before. */
static void list_contact_friction(cotree_events *e)
{
    int i, k, n = 0;
    for (k = 0; k < e->n_frictions; ++k) {
        const cotree_event *const row = e->rows + PLACE(k, SLIP);
        e->normal_stop[k] = -1;
        for (i = cotree_first_stop(e); i < e->n_modes && cotree_is_contact_slip(row); ++i) {
            if (PLACE(i, MODE_STATE) == row->targets[1]) e->normal_stop[k] = i;
        }
        if (e->normal_stop[k] < 0) continue;
        e->contact_friction[n] = k;
        e->impulse_states[e->n_stops + n] = row->targets[2];
        e->force_events[e->n_stops + 2 * n] = PLACE(k, FORWARD_LIMIT);
        e->force_events[e->n_stops + 2 * n + 1] = PLACE(k, BACKWARD_LIMIT);
#if COTREE_HAS_DISCS
        if (cotree_is_disc(e, k)) {
            const int own = e->disc[k];
            e->force_events[e->n_stops + 2 * n + 1] = PLACE(k, FIRST_IMPULSE);
            e->force_events[e->n_modes - e->n_frictions + 2 * e->n_contact_friction + own] =
                PLACE(k, SECOND_IMPULSE);
            e->impulse_states[e->n_stops + e->n_contact_friction + own] =
                e->rows[PLACE(k, FORWARD_LIMIT)].targets[2];
        }
#endif
        ++n;
    }
}

void cotree_list_stops(cotree_events *e)
{
    int k;
    for (k = 0; k < e->n_stops; ++k) {
        const int own = cotree_first_stop(e) + k;
        e->impulse_states[k] = e->rows[PLACE(own, REBOUND)].targets[1];
        e->force_events[k] = PLACE(own, CONTACT_FORCE);
        e->largest_opening_speed[k] = e->largest_acceleration[k] = COTREE_F(0.0);
    }
    list_contact_friction(e);
    for (k = e->n_frictions; k < cotree_first_stop(e); ++k) {
        e->force_events[e->n_stops + 2 * e->n_contact_friction + k - e->n_frictions] =
            PLACE(k, SLIP);
    }
}

/* Return whether the normal force of a friction constraint is the force of a stop. */
int cotree_is_contact_friction(const cotree_events *e, int k)
{
    return e->n_contact_friction > 0 && k < e->n_frictions && e->normal_stop[k] >= 0;
}

/* Return whether friction acts in two directions, on a plane in space. */
int cotree_is_disc(const cotree_events *e, int k)
{
    return k < e->n_frictions && PLACE(k, TURN) >= 0;
}

int cotree_is_load(const cotree_events *e, int k)
{
    return k >= e->n_frictions && k < cotree_first_stop(e);
}

/* Return whether this selection may change a mode. In impacts, loads keep their signs. */
int cotree_is_variable(const cotree_events *e, int k)
{
    return cotree_is_load(e, k) ? !e->is_impact : e->is_active[k];
}

/* Return whether a mode may change while all others are constant. */
int cotree_may_change(const cotree_events *e, int k)
{
    /* Friction at a contact has no force while its stop is open. */
    return cotree_is_variable(e, k) &&
           (!cotree_is_contact_friction(e, k) || e->modes[e->normal_stop[k]] != COTREE_F(0.0));
}

/* Return the gap event of the side at which the stop is closed. */
int cotree_closed_gap(const cotree_events *e, int k)
{
    return PLACE(k,
                 e->closed_side[k - cotree_first_stop(e)] > COTREE_F(0.0) ? UPPER_GAP : LOWER_GAP);
}

/* Return the rate of a closed gap, computed from the change of speed that its events would set. */
cotree_real cotree_opening_speed(const cotree_events *e, int k)
{
    return e->closed_side[k - cotree_first_stop(e)] *
           cotree_jumps_speed_change(&e->jumps, PLACE(k, REBOUND));
}

/* Return the uncertainty of gap rates that corresponds to the error tolerance. */
cotree_real cotree_closing_uncertainty(const cotree_events *e)
{
    cotree_real largest = COTREE_F(0.0);
    int k;
    for (k = 0; k < e->n_stops; ++k) largest = COTREE_FMAX(largest, e->largest_opening_speed[k]);
    return e->rtol * largest + e->atol;
}

/* Return the magnitude below which a gap rate counts as zero: the rounding of the largest rate, or
 * of the acceleration times the span, and for a stop that was closed at least the error
 * tolerance. */
cotree_real cotree_zero_opening_speed(const cotree_events *e, int k)
{
    cotree_real largest = COTREE_F(0.0);
    int i;
    for (i = 0; i < e->n_stops; ++i) {
        largest = COTREE_FMAX(largest, COTREE_FMAX(e->largest_opening_speed[i],
                                                   e->span * e->largest_acceleration[i]));
        largest = COTREE_FMAX(largest, e->speed_terms[i]);
    }
    largest *= ZERO_ROUNDINGS * COTREE_SCAN_ROUNDING;
    return e->was_holding[k - cotree_first_stop(e)]
               ? COTREE_FMAX(largest, cotree_closing_uncertainty(e))
               : largest;
}

int cotree_is_closed(const cotree_events *e, int i, cotree_real t, int fired)
{
    const cotree_real near = ZERO_ROUNDINGS * (cotree_rounding_band(e, i) +
                                               cotree_spacing(t) * COTREE_FABS(e->jumps.rates[i]));
    return i >= 0 && (i == fired || e->is_stepped_over[i] || e->samples[i] <= near);
}

/* Set the scales of gaps, of their rates and of slips at the start to the magnitude of their terms:
 * a gap of zero is a difference of lengths, and only as accurate as these. The terms are found by
 * small changes of the states, which differ from state to state so that equal terms do not cancel.
 * The smallest scale of a gap is the length at which the absolute tolerance exceeds the relative
 * one. */
int cotree_set_term_scales(cotree_events *e, cotree_real t, const cotree_real *w)
{
    const cotree_real smallest = e->rtol > COTREE_F(0.0) ? e->atol / e->rtol : COTREE_F(0.0);
    int i, k, status;
    if (e->n_modes == 0) return 0;
    cotree_copy(e->n, w, e->trial);
    for (i = 0; i < e->run->n_rates; ++i) {
        const cotree_real own = COTREE_FMOD(GOLDEN_SHARE * (cotree_real)(i + 1), COTREE_F(1.0));
        e->trial[i] += TERM_SHARE * (COTREE_F(0.5) + own) * w[i];
    }
    status = cotree_jumps_compute_new_values(&e->jumps, t, w);
    for (k = cotree_first_stop(e); k < e->n_modes; ++k)
        e->speed_terms[k - cotree_first_stop(e)] =
            status == 0 ? cotree_jumps_speed_change(&e->jumps, PLACE(k, REBOUND)) : COTREE_F(0.0);
    if (status == 0) status = cotree_compute_values(e, t, e->trial);
    if (status == 0) status = cotree_jumps_compute_new_values(&e->jumps, t, e->trial);
    for (k = cotree_first_stop(e); k < e->n_modes; ++k) {
        cotree_real *const own = e->speed_terms + k - cotree_first_stop(e);
        if (status == 0) *own -= cotree_jumps_speed_change(&e->jumps, PLACE(k, REBOUND));
        *own = status == 0 ? COTREE_FABS(*own) / TERM_SHARE : COTREE_F(0.0);
    }
    for (i = 0; i < e->n_events && status == 0; ++i) {
        const cotree_real change = COTREE_FABS(e->jumps.values[i] - e->g[i]) / TERM_SHARE;
        const int is_gap = cotree_is_gap(e, i);
        if ((is_gap || e->rows[i].kind == COTREE_FRICTION_SLIP) && change <= COTREE_MAX)
            e->value_scale[i] = COTREE_FMAX(e->value_scale[i],
                                            COTREE_FMAX(change, is_gap ? smallest : COTREE_F(0.0)));
    }
    /* If the changed point cannot be evaluated, use the values at the start. */
    e->failure = 0;
    return cotree_compute_values(e, t, w);
}

/* Fail if a gap is negative at the start. */
int cotree_check_gaps(cotree_events *e, cotree_real t, const cotree_real *g)
{
    int i;
    for (i = 0; i < e->n_events; ++i) {
        if (cotree_is_gap(e, i) && g[i] < -cotree_rounding_band(e, i))
            return cotree_fail(e, i, t, COTREE_EVENTS_NEGATIVE_GAP);
    }
    return 0;
}

/* Return whether the friction at a stop sticks, so that its normal force has no limit yet. */
int cotree_has_sticking_contact(const cotree_events *e, int k)
{
    int i;
    for (i = 0; i < e->n_contact_friction; ++i) {
        if (e->normal_stop[e->contact_friction[i]] == k &&
            e->modes[e->contact_friction[i]] == COTREE_F(0.0))
            return 1;
    }
    return 0;
}

/* Return the acceleration of a closed gap, from the last evaluation of rates. */
cotree_real cotree_separation_acceleration(const cotree_events *e, int k)
{
    return e->closed_side[k - cotree_first_stop(e)] *
           cotree_jumps_speed_change_rate(&e->jumps, PLACE(k, REBOUND));
}

/* Find the active stops, which are closed with zero gap rate. Set their modes to open, and update
 * their accelerations. */
void cotree_find_active_stops(cotree_events *e)
{
    int k;
    for (k = cotree_first_stop(e); k < e->n_modes; ++k) {
        const int own = k - cotree_first_stop(e);
        cotree_real rate;
        e->is_active[k] = e->closed_side[own] != COTREE_F(0.0) &&
                          COTREE_FABS(e->opening_speed[own]) <= cotree_zero_opening_speed(e, k);
        e->modes[k] = COTREE_F(0.0);
        /* The scale is the largest acceleration so far: at this time the forces may be small by
         * chance. */
        rate = COTREE_FABS(cotree_jumps_speed_change_rate(&e->jumps, PLACE(k, REBOUND)));
        e->acceleration_scale[k] = e->largest_acceleration[own] =
            COTREE_FMAX(e->largest_acceleration[own], rate);
    }
}

cotree_real cotree_largest_acceleration_scale(const cotree_events *e)
{
    cotree_real largest = COTREE_F(0.0);
    int k;
    for (k = 0; k < e->n_modes; ++k) {
        if (k < e->n_frictions || k >= cotree_first_stop(e))
            largest = COTREE_FMAX(largest, e->acceleration_scale[k]);
    }
    return largest;
}

/* Return the magnitude below which a gap acceleration counts as zero: the rounding of the largest
 * acceleration. */
cotree_real cotree_rest_tolerance(const cotree_events *e, int k)
{
    return COTREE_FMAX(ACCELERATION_RTOL * e->acceleration_scale[k],
                       ZERO_ROUNDINGS * COTREE_SCAN_ROUNDING *
                           cotree_largest_acceleration_scale(e));
}

/* Set whether a closed gap is free to open, and its distance from zero. */
void cotree_update_open_gaps(cotree_events *e, int k)
{
    const int is_free = e->is_active[k] && e->modes[k] == COTREE_F(0.0),
              own = k - cotree_first_stop(e);
    int what;
    for (what = UPPER_GAP; what <= LOWER_GAP; ++what) {
        const int i = PLACE(k, what);
        if (i < 0) continue;
        e->stays_at_zero[i] = is_free && i == cotree_closed_gap(e, k);
        e->gap_at_release[i] = e->stays_at_zero[i] ? e->gaps[own] : COTREE_F(0.0);
    }
}
#endif
