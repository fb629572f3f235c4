/* cotree_rows.c: the rows of a model, and their state at a point. */
#include "cotree_events_internal.h"

#if COTREE_HAS_MODES
/* Fraction by which states are changed to find the magnitude of the terms of gaps, and the fraction
 * by which that change varies from state to state. */
#define TERM_SHARE COTREE_SELECT(1e-7, 1e-3f)

#define GOLDEN_SHARE COTREE_F(0.6180339887498949)

/* Return the type of the row whose first event has the given kind, or -1. */
static int type_of(int kind)
{
    return kind == COTREE_FRICTION_SLIP   ? (int)COTREE_ROW_FRICTION
           : kind == COTREE_FRICTION_LOAD ? (int)COTREE_ROW_LOAD
           : kind == COTREE_STOP_REBOUND  ? (int)COTREE_ROW_STOP
                                          : -1;
}

/* List the rows of one type. Return their number; if rows is NULL, only count them. */
static int list_rows(const cotree_hybrid *h, cotree_row_type type, cotree_row *rows)
{
    int i, n = 0;
    for (i = 0; i < h->n_events; ++i) {
        const cotree_event *const event = h->events + i;
        if (type_of(event->kind) != (int)type) continue;
        if (rows != NULL) {
            static const cotree_row none = {.limits = {-1, -1},
                                            .engaged = -1,
                                            .gaps = {-1, -1},
                                            .slips = {-1, -1, -1},
                                            .impulses = {-1, -1},
                                            .direction_states = {-1, -1, -1},
                                            .speed_states = {-1, -1, -1},
                                            .slide_start = -COTREE_INFINITY,
                                            .struck_events = {-1, -1, -1}};
            rows[n] = none;
            rows[n].type = type;
            rows[n].event = rows[n].slips[0] = i;
            rows[n].mode_state = event->targets[0];
            if (type == COTREE_ROW_STOP) rows[n].speed_states[0] = event->targets[1];
        }
        ++n;
    }
    return n;
}

/* Set the index of an event in the row to which it belongs. */
static void attach_event(cotree_row *row, const cotree_event *event, int i)
{
    int c;
    switch (event->kind) {
    case COTREE_FRICTION_FORWARD:
    case COTREE_STOP_FORCE:
        row->limits[0] = i;
        break;
    case COTREE_FRICTION_BACKWARD:
        row->limits[1] = i;
        break;
    case COTREE_FRICTION_ENGAGED:
        row->engaged = i;
        break;
    case COTREE_FRICTION_TURN:
        /* On a plane, the targets are two modes and two components; in a ball joint, the mode, a
         * change of speed, three components, and another change of speed. */
        for (c = 0; c < event->n_targets / 2; ++c) row->direction_states[c] = event->targets[2 + c];
        row->direction_event = i;
        break;
    case COTREE_FRICTION_FIRST_IMPULSE:
    case COTREE_FRICTION_SECOND_IMPULSE:
        row->impulses[event->kind - COTREE_FRICTION_FIRST_IMPULSE] = i;
        break;
    case COTREE_STOP_UPPER:
    case COTREE_STOP_LOWER:
        row->gaps[event->kind - COTREE_STOP_UPPER] = i;
        break;
    default:
        break;
    }
}

/* Find the stop of friction at a contact, and the states for its changes of speed. */
static void attach_contact(cotree_events *e, cotree_row *row)
{
    const cotree_event *const slip = e->events + row->event;
    cotree_row *stop;
    if (row->type != COTREE_ROW_FRICTION || !cotree_is_contact_slip(slip)) return;
    for (stop = FIRST_STOP; stop < END_OF_ROWS; ++stop) {
        if (stop->mode_state == slip->targets[1]) row->stop = stop;
    }
    row->speed_states[0] = slip->targets[2];
    e->has_contact_friction = 1;
}

/* Find the events that contain the slip of a disc, and the states for its changes of speed. */
static void attach_slips(cotree_events *e, cotree_row *row)
{
    int c;
    if (!cotree_is_disc(row)) return;
    row->slips[1] = row->limits[0];
    if (row->direction_states[2] >= 0) row->slips[2] = row->direction_event;
    for (c = 0; c < COTREE_COMPONENTS && row->slips[c] >= 0; ++c) {
        const cotree_event *const event = e->events + row->slips[c];
        row->speed_states[c] = event->targets[event->n_targets - 1];
    }
    ++e->n_discs;
}

/* Count the rows, and allocate and initialise them. */
void cotree_init_rows(cotree_events *e, const cotree_run *run, cotree_arena *arena)
{
    const cotree_hybrid *const h = run->model->hybrid;
    const int n_frictions = list_rows(h, COTREE_ROW_FRICTION, NULL);
    const int n_loads = list_rows(h, COTREE_ROW_LOAD, NULL);
    cotree_row *row;
    int i;
    e->n_frictions = n_frictions;
    e->n_stops = list_rows(h, COTREE_ROW_STOP, NULL);
    e->n_rows = n_frictions + n_loads + e->n_stops;
    e->n_discs = e->has_contact_friction = 0;
    e->rows = (cotree_row *)cotree_arena_alloc(arena, (size_t)e->n_rows * sizeof(cotree_row), NULL);
    if (e->n_rows == 0) return;
    e->stays_at_zero = cotree_arena_ints(arena, e->n_events);
    e->is_stepped_over = cotree_arena_ints(arena, e->n_events);
    e->zero_level = cotree_arena_reals(arena, e->n_events);
    e->gap_at_release = cotree_arena_reals(arena, e->n_events);
    e->is_impact_event = cotree_arena_ints(arena, e->n_events);
    e->trial = cotree_arena_reals(arena, run->n);
    e->saved_before = cotree_arena_reals(arena, run->n_full);
    e->tried_codes = cotree_arena_reals(arena, N_TRIED_CODES);
    if (arena->base == NULL) return;
    list_rows(h, COTREE_ROW_FRICTION, e->rows);
    list_rows(h, COTREE_ROW_LOAD, e->rows + n_frictions);
    list_rows(h, COTREE_ROW_STOP, e->rows + n_frictions + n_loads);
    for (row = e->rows; row < END_OF_ROWS; ++row) {
        for (i = 0; i < e->n_events; ++i) {
            const cotree_event *const event = e->events + i;
            if (event->n_targets > 0 && event->targets[0] == row->mode_state)
                attach_event(row, event, i);
        }
        attach_contact(e, row);
        attach_slips(e, row);
    }
    for (i = 0; i < e->n_events; ++i) {
        e->is_impact_event[i] = e->stays_at_zero[i] = e->is_stepped_over[i] = 0;
        e->gap_at_release[i] = e->zero_level[i] = COTREE_F(0.0);
    }
    e->is_impact = 0;
    e->force_noise = e->largest_rate = e->impact_speed = COTREE_F(0.0);
}

/* Return whether this selection may change a mode. In impacts, loads keep their signs. */
int cotree_is_variable(const cotree_events *e, const cotree_row *row)
{
    return row->type == COTREE_ROW_LOAD ? !e->is_impact : row->is_active;
}

/* Return whether a mode may change while all others are constant. */
int cotree_may_change(const cotree_events *e, const cotree_row *row)
{
    /* Friction at a contact has no force while its stop is open. */
    return cotree_is_variable(e, row) && (row->stop == NULL || row->stop->mode != COTREE_F(0.0));
}

/* Return the acceleration of a slip or of a closed gap, from the last evaluation of rates. */
cotree_real cotree_acceleration(const cotree_events *e, const cotree_row *row)
{
    return row->type == COTREE_ROW_STOP
               ? row->side * cotree_jumps_speed_change_rate(&e->jumps, row->event)
               : e->jumps.rates[row->event];
}

/* Return the uncertainty of gap rates that corresponds to the error tolerance. */
cotree_real cotree_gap_rate_error(const cotree_events *e)
{
    cotree_real largest = COTREE_F(0.0);
    const cotree_row *row;
    for (row = e->rows; row < END_OF_ROWS; ++row) largest = COTREE_FMAX(largest, row->largest_rate);
    return e->rtol * largest + e->atol;
}

/* Return the magnitude below which a gap rate counts as zero: the rounding of the largest rate, or
 * of the acceleration times the span, and for a stop that was closed at least the error
 * tolerance. */
cotree_real cotree_zero_gap_rate(const cotree_events *e, const cotree_row *row)
{
    cotree_real largest = COTREE_F(0.0);
    const cotree_row *other;
    for (other = e->rows; other < END_OF_ROWS; ++other) {
        largest = COTREE_FMAX(
            largest, COTREE_FMAX(other->largest_rate, e->span * other->largest_acceleration));
        largest = COTREE_FMAX(largest, other->rate_terms);
    }
    largest *= ZERO_ROUNDINGS * COTREE_SCAN_ROUNDING;
    return row->was_closed ? COTREE_FMAX(largest, cotree_gap_rate_error(e)) : largest;
}

/* Return the largest scale of the accelerations of slips and gaps. */
cotree_real cotree_largest_acceleration_scale(const cotree_events *e)
{
    cotree_real largest = COTREE_F(0.0);
    const cotree_row *row;
    for (row = e->rows; row < END_OF_ROWS; ++row)
        largest = COTREE_FMAX(largest, row->acceleration_scale);
    return largest;
}

/* Return the magnitude below which an acceleration counts as zero: a fraction of its scale, but at
 * least the rounding of the largest term. A slip acceleration is a difference of rates. */
cotree_real cotree_zero_acceleration(const cotree_events *e, const cotree_row *row)
{
    return COTREE_FMAX(ACCELERATION_RTOL * row->acceleration_scale,
                       row->type == COTREE_ROW_STOP
                           ? ZERO_ROUNDINGS * COTREE_SCAN_ROUNDING *
                                 cotree_largest_acceleration_scale(e)
                           : TERM_ROUNDINGS * COTREE_SCAN_ROUNDING * e->largest_rate);
}

/* Write the components of the slip from the last evaluation of new values. */
void cotree_find_slip(const cotree_events *e, const cotree_row *row, cotree_real *slip)
{
    int c;
    for (c = 0; c < COTREE_COMPONENTS; ++c)
        slip[c] = row->slips[c] < 0 ? COTREE_F(0.0)
                                    : -cotree_jumps_speed_change(&e->jumps, row->slips[c]);
}

/* Set the scales of gaps, of their rates and of slips at the start to the magnitude of their terms:
 * a gap of zero is a difference of lengths, and only as accurate as these. The terms are found by
 * small changes of the states, which differ from state to state so that equal terms do not cancel.
 * The smallest scale of a gap is the length at which the absolute tolerance exceeds the relative
 * one. */
int cotree_set_term_scales(cotree_events *e, cotree_real t, const cotree_real *w)
{
    const cotree_real smallest = e->rtol > COTREE_F(0.0) ? e->atol / e->rtol : COTREE_F(0.0);
    cotree_row *row;
    int i, status;
    if (e->n_rows == 0) return 0;
    cotree_copy(e->n, w, e->trial);
    for (i = 0; i < e->run->n_rates; ++i) {
        const cotree_real fraction =
            COTREE_FMOD(GOLDEN_SHARE * (cotree_real)(i + 1), COTREE_F(1.0));
        e->trial[i] += TERM_SHARE * (COTREE_F(0.5) + fraction) * w[i];
    }
    status = cotree_jumps_compute_new_values(&e->jumps, t, w);
    for (row = FIRST_STOP; row < END_OF_ROWS; ++row)
        row->rate_terms =
            status == 0 ? cotree_jumps_speed_change(&e->jumps, row->event) : COTREE_F(0.0);
    if (status == 0) status = cotree_compute_values(e, t, e->trial);
    if (status == 0) status = cotree_jumps_compute_new_values(&e->jumps, t, e->trial);
    for (row = FIRST_STOP; row < END_OF_ROWS; ++row) {
        if (status == 0) row->rate_terms -= cotree_jumps_speed_change(&e->jumps, row->event);
        row->rate_terms = status == 0 ? COTREE_FABS(row->rate_terms) / TERM_SHARE : COTREE_F(0.0);
    }
    for (i = 0; i < e->n_events && status == 0; ++i) {
        const cotree_real change = COTREE_FABS(e->jumps.values[i] - e->g[i]) / TERM_SHARE;
        const int is_gap = cotree_is_gap(e, i);
        if ((is_gap || e->events[i].kind == COTREE_FRICTION_SLIP) && change <= COTREE_MAX)
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
#endif
