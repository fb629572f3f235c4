/* cotree_events.c: events within one integration: found after each step, located, let happen.
 * Part of the runtime of cotree, the same for every model.
 */
#include "cotree_events_internal.h"

#include <float.h>
#include <math.h>
#include <stddef.h>

/* A history whose error is this many times the tolerance is looked at where nothing seems to
 * happen, and one of this many times where something does. */
#define LOOSE COTREE_F(1e3)
#define CLOSE COTREE_F(4.0)

/* At a corner an error has effects of its square only. */
#define CLOSE_TO_CORNER COTREE_F(100.0)

void cotree_events_init(cotree_events *e, cotree_run *run, int n_given, cotree_real span,
                        cotree_real rtol, const cotree_real *atols, cotree_real atol,
                        cotree_visit_function visit, void *context, cotree_room *room)
{
    const cotree_model *const model = run->model;
    const int n = run->n, n_events = model->hybrid->n_events;
    cotree_real *of_local;
    int i, n_frictions, n_stops, n_modes, n_pressed;
    e->w = cotree_take_doubles(room, n);
    e->point = cotree_take_doubles(room, n);
    e->other = cotree_take_doubles(room, n);
    e->slope = cotree_take_doubles(room, n);
    e->sum = cotree_take_doubles(room, n);
    e->narrowed = cotree_take_doubles(room, 2 * n);
    e->scratch = cotree_take_doubles(room, n_given);
    of_local = cotree_take_doubles(room, COTREE_HISTORY_WORKSPACE(n));
    e->g = cotree_take_doubles(room, n_events);
    e->side = cotree_take_doubles(room, n_events);
    e->largest = cotree_take_doubles(room, n_events);
    e->flight = cotree_take_doubles(room, n_events);
    e->way = cotree_take_doubles(room, n_events);
    e->speed = cotree_take_doubles(room, n_events);
    e->bend = cotree_take_doubles(room, n_events);
    e->at_root = cotree_take_doubles(room, n_events);
    e->looked = cotree_take_doubles(room, SAMPLES * n_events);
    e->from = cotree_take_doubles(room, n_events);
    e->since = cotree_take_doubles(room, n_events);
    e->n_ranges = model->hybrid->n_ranges;
    e->n_quantities = model->hybrid->n_quantities;
    if (e->n_ranges > 0) {
        const int n_quantities = e->n_quantities, n_mark = 1 + n_events + 2 * n_quantities;
        e->ranges = cotree_take_doubles(room, N_ENDS * e->n_ranges);
        e->box = cotree_take_doubles(room, N_ENDS * n_quantities);
        e->sampled = cotree_take_doubles(room, SAMPLES * n_quantities);
        e->quantity_pace = cotree_take_doubles(room, n_quantities);
        e->marks = cotree_take_doubles(room, (DEEPEST + 2) * n_mark);
        e->is_open = cotree_take_ints(room, n_events);
        e->is_clear = cotree_take_ints(room, n_events);
    }
    e->pace = cotree_take_doubles(room, n_events);
    e->happened = cotree_take_doubles(room, COTREE_EVENT_CROWD * n_events);
    e->has_fired = cotree_take_ints(room, n_events);
    e->is_found = cotree_take_ints(room, n_events);
    e->is_near = cotree_take_ints(room, n_events);
    e->is_kink = cotree_take_ints(room, n_events);
    e->compared = cotree_take_doubles(room, 6 * run->n_full + model->hybrid->n_pieces);
    e->shift = cotree_take_doubles(room, 2 * n_events);
    e->n_happened = cotree_take_ints(room, n_events);
    cotree_jumps_init(&e->jumps, run, room);
    n_frictions = cotree_list_modes(model->hybrid, COTREE_FRICTION_STOPS, NULL);
    n_stops = cotree_list_modes(model->hybrid, COTREE_STOP_RESTS, NULL);
    n_pressed = cotree_count_pressed(model->hybrid);
    n_modes = n_frictions + cotree_list_modes(model->hybrid, COTREE_FRICTION_LOAD, NULL) + n_stops;
    if (n_modes > 0) {
        e->friction = cotree_take_ints(room, N_PLACES * n_modes);
        e->is_idle = cotree_take_ints(room, n_modes);
        e->resting = cotree_take_ints(room, n_events);
        e->is_passed = cotree_take_ints(room, n_events);
        e->level = cotree_take_doubles(room, n_events);
        e->is_back = cotree_take_ints(room, n_frictions);
        e->left_at = cotree_take_doubles(room, n_frictions);
        e->modes = cotree_take_doubles(room, n_modes);
        e->scale = cotree_take_doubles(room, n_modes);
        e->slack = cotree_take_doubles(room, 2 * n_modes);
        e->tries = cotree_take_doubles(room, N_TRIES);
        e->tried = cotree_take_doubles(room, n);
        e->was = cotree_take_doubles(room, run->n_full);
        e->gaps = cotree_take_doubles(room, n_stops);
        e->later = cotree_take_doubles(room, n_stops);
        e->brisk = cotree_take_doubles(room, n_stops);
        e->closed = cotree_take_doubles(room, n_stops);
        e->speeds = cotree_take_doubles(room, n_stops);
        e->swift = cotree_take_doubles(room, n_stops);
        e->wanted = cotree_take_doubles(room, n_stops);
        e->held = cotree_take_doubles(room, n_events);
        e->is_noted = cotree_take_ints(room, n_events);
        e->has_held = cotree_take_ints(room, n_stops);
        e->is_struck = cotree_take_ints(room, n_stops);
        e->is_slow = cotree_take_ints(room, n_stops);
        e->rebounds = cotree_take_ints(room, n_stops);
        e->of_impact = cotree_take_ints(room, n_stops + n_pressed);
        e->impulses = cotree_take_ints(room, n_stops + n_pressed);
        e->pulls = cotree_take_ints(room, n_modes - n_frictions + 2 * n_pressed);
        e->pressed = cotree_take_ints(room, n_pressed);
        e->presser = cotree_take_ints(room, n_frictions);
        e->slips = cotree_take_doubles(room, n_pressed);
        e->way_of = cotree_take_doubles(room, n_frictions);
        e->chosen = cotree_take_doubles(room, n_modes);
        e->told = cotree_take_doubles(room, n_stops > 0 ? n_modes : 0);
    }
    if (room->base == NULL) return;
    cotree_history_init(&e->local, n, of_local);
    e->run = run;
    e->rows = model->hybrid->events;
    e->n_events = n_events;
    e->n_corners = model->hybrid->n_corners;
    e->n_pieces = model->hybrid->n_pieces;
    e->pieces = NULL;
    e->faced = COTREE_INFINITY;
    e->n = n;
    e->n_given = n_given;
    e->span = COTREE_FABS(span);
    e->rtol = rtol;
    e->atols = atols;
    e->atol = atol;
    e->visit = visit;
    e->context = context;
    e->n_found = 0;
    e->n_fired = e->is_shifted = 0;
    e->is_timed = 0;
    e->stopped = -1;
    e->records = NULL;
    e->n_records = 0;
    e->trouble = 0;
    e->event = 0;
    e->at = e->detail = COTREE_F(0.0);
    e->n_evaluations = 0;
    e->n_frictions = n_frictions;
    e->n_modes = n_modes;
    e->n_stops = n_stops;
    e->n_pressed = n_pressed;
    e->faint = -1;
    e->is_striking = 0;
    if (n_modes > 0) {
        cotree_list_frictions(e, model->hybrid);
        cotree_list_stops(e, model->hybrid);
    }
    for (i = 0; i < n_stops; ++i) e->closed[i] = COTREE_F(0.0);
    for (i = 0; i < n_events && n_modes > 0; ++i) {
        e->is_noted[i] = 0;
        e->held[i] = e->level[i] = COTREE_F(0.0);
        e->resting[i] = e->is_passed[i] = 0;
    }
    e->noise = e->fastest = e->quickest = COTREE_F(0.0);
    for (i = 0; i < n_frictions; ++i) e->left_at[i] = -COTREE_INFINITY;
    for (i = 0; i < n_events; ++i) {
        e->g[i] = e->side[i] = e->largest[i] = e->flight[i] = COTREE_F(0.0);
        e->pace[i] = COTREE_INFINITY;
        e->n_happened[i] = 0;
        e->has_fired[i] = 0;
        e->is_kink[i] = 0;
    }
}

/* Looks at the values with which a run begins, and at their rates. */
static int look_at_start(cotree_events *e, cotree_real t, const cotree_real *w)
{
    int status = cotree_values(e, t, w);
    cotree_copy(e->n_events, e->jumps.values, e->g);
    if (status == 0) status = cotree_note(e, t, w, e->g);
    return status == 0 ? cotree_rates(e, t, w) : status;
}

int cotree_events_begin(cotree_events *e, cotree_real t, cotree_real *w)
{
    int i, n_found = 0, is_bent = 0, status = look_at_start(e, t, w);
    /* What cannot stick together has its modes chosen below. */
    if (status != 0 && cotree_let_slide(e, w)) status = look_at_start(e, t, w);
    if (status != 0) return cotree_refuse_start(e, t, w);
    cotree_copy(e->n_events, e->jumps.rates, e->speed);
    for (i = 0; i < e->n_events && status == 0; ++i) {
        const int is_zero = COTREE_FABS(e->g[i]) <= cotree_band(e, i);
        e->way[i] = cotree_sign_of(is_zero ? e->speed[i] : e->g[i]);
        if (is_zero && e->speed[i] == COTREE_F(0.0) && !cotree_is_corner(e, i)) {
            if (!is_bent) status = cotree_find_bend(e, t, w);
            is_bent = 1;
            e->way[i] = cotree_sign_of(e->bend[i]);
        }
        e->side[i] = e->way[i];
        /* Closed gaps begin with an impact, or in rest, as their modes are chosen. */
        e->is_found[i] = is_zero && !cotree_is_gap(e, i) && !cotree_is_corner(e, i) &&
                         e->rows[i].direction != 0 &&
                         (cotree_real)e->rows[i].direction == e->way[i];
        n_found += e->is_found[i];
    }
    if (status == 0) status = cotree_check_gaps(e, t, e->g);
    return status == 0 ? cotree_let_happen(e, t, w, n_found, NULL) : status;
}

int cotree_events_resume(cotree_events *e, cotree_real t, cotree_real *w, const cotree_real *slopes)
{
    int i, status = cotree_values(e, t, w);
    cotree_copy(e->n_events, e->jumps.values, e->g);
    if (status == 0) status = cotree_note(e, t, w, e->g);
    for (i = 0; i < e->n_events; ++i) e->way[i] = -e->side[i];
    e->is_timed = 1;
    if (status == 0) status = cotree_let_happen(e, t, w, 0, slopes);
    e->is_timed = 0;
    return status;
}

int cotree_events_go_on(cotree_events *e, cotree_real t, cotree_real *w)
{
    int status = cotree_values(e, t, w);
    cotree_copy(e->n_events, e->jumps.values, e->g);
    if (status == 0) status = cotree_note(e, t, w, e->g);
    e->n_fired = e->is_shifted = 0;
    return status == 0 ? cotree_choose_pieces(e, t, w) : status;
}

int cotree_events_arrive(cotree_events *e, cotree_real t, cotree_real *w)
{
    int k, status = cotree_values(e, t, w);
    for (k = 0; k < e->n_frictions && status == 0; ++k) {
        const int i = PLACE(k, STOPS);
        e->is_passed[i] = e->side[i] > COTREE_F(0.0) && e->jumps.values[i] < COTREE_F(0.0);
    }
    for (k = 0; k < e->n_events && e->n_stops > 0 && status == 0; ++k) {
        if (cotree_is_gap(e, k))
            e->is_passed[k] = e->side[k] > COTREE_F(0.0) && e->jumps.values[k] < COTREE_F(0.0);
    }
    if (status == 0) status = cotree_events_resume(e, t, w, NULL);
    for (k = 0; k < e->n_events && e->n_modes > 0; ++k) {
        e->has_fired[k] = e->has_fired[k] || e->is_passed[k];
        e->is_passed[k] = 0;
    }
    return status;
}

int cotree_events_choose(cotree_events *e, cotree_real t, cotree_real *w)
{
    int status = cotree_values(e, t, w);
    cotree_copy(e->n_events, e->jumps.values, e->g);
    if (status == 0) status = cotree_note(e, t, w, e->g);
    if (status == 0) status = cotree_check_gaps(e, t, e->g);
    return status == 0 ? cotree_settle_modes(e, t, w, -1) : status;
}

void cotree_events_keep(const cotree_events *e, cotree_real *to)
{
    const int n = e->n_events;
    int i;
    cotree_copy(n, e->side, to);
    cotree_copy(n, e->largest, to + n);
    cotree_copy(n, e->flight, to + 2 * n);
    for (i = 0; i < n; ++i) {
        to[3 * n + i] = (cotree_real)e->n_happened[i];
        to[4 * n + i] = e->n_modes > 0 ? (cotree_real)e->resting[i] : COTREE_F(0.0);
        to[5 * n + i] = e->n_modes > 0 ? e->held[i] : COTREE_F(0.0);
        to[6 * n + i] = e->n_modes > 0 ? e->level[i] : COTREE_F(0.0);
    }
    cotree_copy(n * COTREE_EVENT_CROWD, e->happened, to + 7 * n);
}

void cotree_events_recall(cotree_events *e, const cotree_real *from)
{
    const int n = e->n_events;
    int i;
    cotree_copy(n, from, e->side);
    cotree_copy(n, from + n, e->largest);
    cotree_copy(n, from + 2 * n, e->flight);
    for (i = 0; i < n; ++i) {
        e->n_happened[i] = (int)from[3 * n + i];
        if (e->n_modes == 0) continue;
        e->resting[i] = (int)from[4 * n + i];
        e->held[i] = from[5 * n + i];
        e->level[i] = from[6 * n + i];
    }
    cotree_copy(n * COTREE_EVENT_CROWD, from + 7 * n, e->happened);
}

/* Finds a crossing of one value between two times, where it has these values: when, and the side
 * that it comes from, which is that of the beginning before, and that of the end if there is none.
 * The way to a crossing begins where the value was on that side last, which may be before a: at a
 * it may be at zero already, as far as rounding tells. Returns NONE, FOUND, or why not; CLOSER
 * where it has to be looked at more closely first. */
int cotree_cross_between(cotree_events *e, int i, cotree_real a, cotree_real b, cotree_real at_a,
                         cotree_real at_b, int is_turning, cotree_real *at, cotree_real *from)
{
    const cotree_real side = *from, least = cotree_least_of(e, i);
    const cotree_real sign = COTREE_FABS(at_b) > least ? cotree_sign_of(at_b) : COTREE_F(0.0);
    cotree_real turn, lowest;
    if (side * at_a > COTREE_F(0.0)) e->since[i] = a;
    if (is_turning && side != COTREE_F(0.0) &&
        cotree_find_turn(e, i, a, b, side * at_a, side * at_b, side, &turn, &lowest)) {
        if (!e->is_close) return CLOSER;
        if (e->trouble != 0) return e->trouble;
        if (e->run->n_blocks > 1 && !cotree_is_corner(e, i) &&
            COTREE_FABS(lowest) <= GRAZING * cotree_tolerance(e, i) &&
            (cotree_read(e, turn, e->point) != 0 || !cotree_is_kink(e, i, turn, e->point))) {
            return e->trouble != 0 ? e->trouble : cotree_refuse_grazing(e, i, turn);
        }
        if (lowest < -least) {
            const int is_first = cotree_is_wanted(e, i, -side);
            *from = is_first ? side : -side;
            *at = is_first ? cotree_locate(e, i, e->since[i], turn, side)
                           : cotree_locate(e, i, turn, b, -side);
            return e->trouble != 0 ? e->trouble : COTREE_EVENTS_FOUND;
        }
    }
    if (e->trouble != 0) return e->trouble;
    if (sign != COTREE_F(0.0) && side != COTREE_F(0.0) && sign != side &&
        cotree_is_wanted(e, i, sign)) {
        /* Polynomials have speeds near zero to the tolerance of their terms only. */
        const int is_close = e->is_close || (cotree_is_corner(e, i) && e->error <= CLOSE_TO_CORNER);
        if (!is_close || (cotree_is_resting(e, i) && !e->is_visited)) return CLOSER;
        *at = cotree_locate(e, i, e->since[i], b, side);
        return e->trouble != 0 ? e->trouble : COTREE_EVENTS_FOUND;
    }
    if (sign != COTREE_F(0.0)) *from = sign;
    return COTREE_EVENTS_NONE;
}

/* Finds the first crossing of one value among the samples; returns as above. */
static int find_crossing(cotree_events *e, int i)
{
    const cotree_real *const g = e->looked + i;
    const cotree_real least = cotree_least_of(e, i);
    const int n = e->n_events;
    cotree_real side = COTREE_F(0.0);
    int k, nearest = SAMPLES, found = COTREE_EVENTS_NONE;
    e->from[i] = e->side[i];
    e->since[i] = e->t_before;
    for (k = 1; k < SAMPLES && found == COTREE_EVENTS_NONE; ++k) {
        if (side != e->from[i]) {
            side = e->from[i];
            nearest = cotree_is_resting(e, i) ? SAMPLES : cotree_find_nearest(e, i, side);
        }
        if (k != nearest && k != nearest + 1 && side * g[k * n] > least) continue;
        found = cotree_cross_between(e, i, cotree_time_of(e, k - 1), cotree_time_of(e, k),
                                     g[(k - 1) * n], g[k * n], k == nearest || k == nearest + 1,
                                     e->at_root + i, e->from + i);
    }
    return found;
}

/* Finds the crossings of all values; returns as above. AGAIN: there is none before at_root of any.
 */
static int search(cotree_events *e, int *first, cotree_real *until)
{
    int i, status = COTREE_EVENTS_NONE;
    *until = COTREE_INFINITY;
    if (e->n_ranges > 0) {
        const int found = cotree_scan(e, until);
        if (found > COTREE_EVENTS_FOUND) return found;
    }
    for (i = 0; i < e->n_events; ++i) {
        if (e->n_ranges == 0 || !e->is_open[i]) {
            const int found = find_crossing(e, i);
            if (found > COTREE_EVENTS_FOUND) return found;
            e->is_found[i] = found == COTREE_EVENTS_FOUND;
        }
        if (!e->is_found[i] || e->at_root[i] > *until) continue;
        if (status == COTREE_EVENTS_NONE || e->at_root[i] < e->at_root[*first]) {
            *first = i;
            status = COTREE_EVENTS_FOUND;
        }
    }
    return status == COTREE_EVENTS_NONE && *until < COTREE_INFINITY ? AGAIN : status;
}

/* Finds what lies at zero at the end of a step, but for what cannot be told from it. */
static int find_ahead(cotree_events *e, int *first)
{
    const cotree_real *const g = e->looked + (SAMPLES - 1) * e->n_events;
    const cotree_real soon = COTREE_SELECT(1e-9, 1.2e-04f) * COTREE_FABS(e->t_after - e->t_before) +
                             COTREE_F(4.0) * cotree_spacing(e->t_after);
    int i, is_known = 0, status = COTREE_EVENTS_NONE;
    for (i = 0; i < e->n_events; ++i) {
        const cotree_real side = e->side[i];
        cotree_real rate;
        if (side == COTREE_F(0.0) || side * g[i] < COTREE_F(0.0) ||
            COTREE_FABS(g[i]) > cotree_tolerance(e, i))
            continue;
        if (!cotree_is_wanted(e, i, -side) || cotree_is_resting(e, i)) continue;
        if (!is_known && cotree_rates(e, e->t_after, e->end) != 0) return e->trouble;
        is_known = 1;
        rate = e->jumps.rates[i];
        if (rate * side >= COTREE_F(0.0) || COTREE_FABS(g[i]) > soon * COTREE_FABS(rate)) continue;
        e->is_found[i] = 1;
        e->at_root[i] = e->t_after;
        e->from[i] = side;
        if (status == COTREE_EVENTS_NONE) *first = i;
        status = COTREE_EVENTS_FOUND;
    }
    return status;
}

/* Says by how much the time of an event is uncertain. */
static int find_margin(cotree_events *e, int i)
{
    cotree_real rate, known;
    if (cotree_rates(e, e->t, e->w) != 0) return e->trouble;
    rate = COTREE_FABS(e->jumps.rates[i]);
    known = rate > COTREE_F(0.0) ? cotree_tolerance(e, i) / rate : COTREE_INFINITY;
    e->margin =
        COTREE_FMAX(COTREE_F(4.0) * cotree_spacing(e->t),
                    COTREE_FMIN(known, COTREE_F(1e-3) * COTREE_FABS(e->t_after - e->t_before)));
    return 0;
}

/* Adds to what was found all that is at zero there, too, on its way through: a step that ends there
 * may show one of two events at once beyond rounding, and the other within. */
static int find_others(cotree_events *e)
{
    int i;
    if (cotree_values(e, e->t, e->w) != 0) return e->trouble;
    for (i = 0; i < e->n_events; ++i) {
        const cotree_real side = e->side[i];
        const int is_passing =
            COTREE_FABS(e->jumps.values[i]) <= cotree_band(e, i) && !cotree_is_resting(e, i) &&
            side * e->jumps.rates[i] < COTREE_F(0.0) && cotree_is_wanted(e, i, -side);
        e->is_found[i] = e->is_found[i] || is_passing;
    }
    return 0;
}

/* Gives a point that a step ends in as w; its algebraic unknowns are guesses from now on. */
static const cotree_real *without_unknowns(cotree_events *e, cotree_real t,
                                           const cotree_real *given, cotree_real *w)
{
    if (e->n_given == e->n) return given;
    cotree_run_take(e->run, t, e->n_given, given, w);
    return w;
}

/* Whether a value that rested at zero went to a side where its mode should be another one. Where
 * rates are the same on both sides, the mode changes where the step began. */
static int is_left_behind(cotree_events *e, int i, cotree_real side)
{
    int k;
    if (e->rows[i].is_jump != 1 || e->side[i] != COTREE_F(0.0) || !cotree_is_wanted(e, i, side))
        return 0;
    if (cotree_jumps_news(&e->jumps, e->t_after, e->end) != 0) {
        return cotree_fail(e, 0, e->t_after, COTREE_EVENTS_FAILED);
    }
    if (!cotree_jumps_is_due(&e->jumps, i)) return 0;
    if (!cotree_is_kink(e, i, e->t_before, e->start))
        return cotree_fail(e, i, e->t_after, COTREE_EVENTS_LEAVE);
    for (k = 0; k < e->n_events; ++k) e->is_found[k] = k == i;
    e->n_found = 1;
    e->t = e->t_before;
    cotree_copy(e->n, e->start, e->w);
    return 1;
}

/* Finds what happens first, once the step has been looked at. */
static int find_first(cotree_events *e)
{
    const cotree_real *const g = e->looked + (SAMPLES - 1) * e->n_events;
    cotree_real until;
    int i, first = 0, is_ahead, found, status;
    found = search(e, &first, &until);
    if (found == CLOSER) {
        status = cotree_look_closer(e);
        if (status != 0) return status;
        found = search(e, &first, &until);
    }
    if (found == AGAIN) {
        e->t = until;
        status = cotree_repeat(e, until, e->w);
        return status == 0 && cotree_project(e, until, e->w) == 0 ? COTREE_EVENTS_FOUND
                                                                  : e->trouble;
    }
    is_ahead = found == COTREE_EVENTS_NONE;
    if (is_ahead) found = find_ahead(e, &first);
    if (found > COTREE_EVENTS_FOUND) return found;
    if (found == COTREE_EVENTS_FOUND) {
        const int is_crossing = cotree_arrive(e, e->at_root[first], first, e->from[first]);
        if (e->trouble != 0) return e->trouble;
        if (is_crossing) {
            if (find_margin(e, first) != 0) return e->trouble;
            for (i = 0; i < e->n_events; ++i) {
                const int is_now = e->is_found[i] && e->at_root[i] <= e->t + e->margin;
                /* Friction that sticks keeps the speed that is left, so that it has to stop by
                 * itself. */
                e->is_found[i] = i == first || (is_now && !cotree_is_of_friction(e, i));
                /* It may have passed zero the other way before, which nothing waited for. */
                if (e->is_found[i]) e->side[i] = e->from[i];
            }
            if (find_others(e) != 0) return e->trouble;
            for (i = 0; i < e->n_events; ++i) e->n_found += e->is_found[i];
            return COTREE_EVENTS_FOUND;
        }
        if (!is_ahead) return COTREE_EVENTS_FOUND; /* the step goes on anew, without an event */
    }
    cotree_copy(e->n_events, g, e->g);
    for (i = 0; i < e->n_events; ++i) {
        if (COTREE_FABS(g[i]) <= cotree_least_of(e, i) || cotree_is_corner(e, i)) continue;
        if (is_left_behind(e, i, cotree_sign_of(g[i]))) {
            return e->trouble != 0 ? e->trouble : COTREE_EVENTS_FOUND;
        }
        e->side[i] = cotree_sign_of(g[i]);
        if (e->n_modes > 0) e->resting[i] = 0;
    }
    if (cotree_are_pieces_left(e, g) && cotree_choose_pieces(e, e->t_after, e->end) != 0)
        return e->trouble;
    return COTREE_EVENTS_NONE;
}

int cotree_events_find(cotree_events *e, cotree_real t_before, const cotree_real *start,
                       cotree_real t_after, const cotree_real *end, cotree_real t_end,
                       const cotree_history *h)
{
    cotree_real error = COTREE_F(0.0);
    int status;
    e->t_before = t_before;
    e->t_after = t_after;
    e->start = without_unknowns(e, t_before, start, e->narrowed);
    e->end = without_unknowns(e, t_after, end, e->narrowed + e->n);
    e->t_end = t_end;
    e->n_found = 0;
    e->margin = COTREE_F(0.0);
    e->h = h;
    if (h != NULL) {
        error = cotree_history_error(h, h->n_points - 2, e->rtol, e->atols, 0, 0, e->scratch);
    }
    e->error = error;
    e->is_close = error <= CLOSE;
    e->is_visited = h == NULL;
    e->is_rough = !(error <= LOOSE);
    if (e->n_corners == e->n_events) {
        status = cotree_glance(e);
        if (status != CLOSER) return status;
    }
    status = cotree_look(e);
    if (status == 0 && e->is_rough && cotree_is_any_near(e)) status = cotree_look_closer(e);
    return status == 0 ? find_first(e) : status;
}

int cotree_events_happen(cotree_events *e)
{
    int i, is_first = 1, status;
    if (cotree_are_corners(e)) return cotree_pass_corners(e, e->t, e->w);
    status = cotree_rates(e, e->t, e->w);
    for (i = 0; i < e->n_events; ++i) e->way[i] = cotree_sign_of(e->jumps.rates[i]);
    for (i = 0; i < e->n_events && status == 0 && e->n_found > 0; ++i) {
        if (!e->is_found[i] || !is_first || cotree_is_corner(e, i)) continue;
        is_first = 0;
        if (!(e->way[i] * e->side[i] > COTREE_F(0.0))) continue;
        /* It left zero by less than rounding; dry friction has modes for that, and an impact that
         * does so leaves nothing. At a kink the step says where it goes. */
        if (cotree_is_gap(e, i))
            e->faint = i;
        else if (cotree_is_kink(e, i, e->t, e->w))
            cotree_face(e, i, -e->side[i]);
        else if (!cotree_is_of_friction(e, i))
            status = cotree_fail(e, i, e->t, COTREE_EVENTS_REST);
    }
    if (status == 0) status = cotree_let_happen(e, e->t, e->w, e->n_found, NULL);
    e->faint = -1;
    return status;
}

const char *cotree_events_message(int status)
{
    switch (status) {
    case COTREE_EVENTS_FAILED:
        return "its equations cannot be evaluated";
    case COTREE_EVENTS_NOT_FINITE:
        return "what it looks at is not finite";
    case COTREE_EVENTS_SET_NOT_FINITE:
        return "what it sets is not finite";
    case COTREE_EVENTS_CONTRADICT:
        return "what it sets contradicts the constraints";
    case COTREE_EVENTS_CHOOSE:
        return "what it sets leaves a choice, which has no sensitivities";
    case COTREE_EVENTS_REST:
        return "it leaves no speed away from zero, and the motion goes on through it";
    case COTREE_EVENTS_GRAZE:
        return "it only just touches zero, where nothing has sensitivities";
    case COTREE_EVENTS_ACCUMULATE:
        return "it happens ever faster, and accumulates";
    case COTREE_EVENTS_CHATTER:
        return "it happens too often: it chatters";
    case COTREE_EVENTS_ENDLESS:
        return "it and others make each other happen without end";
    case COTREE_EVENTS_SLIDE:
        return "what jumps is driven back to the jump from either side";
    case COTREE_EVENTS_LEAVE:
        return "what rested at the jump leaves it, to either side";
    case COTREE_EVENTS_PART:
        return "jumps at once have no derivative, since either may come first";
    case COTREE_EVENTS_MODES:
        return "no modes of dry friction and rigid stops agree with each other";
    case COTREE_EVENTS_SHARED:
        return "how friction that sticks shares forces is open, though losses depend on it";
    case COTREE_EVENTS_BACKWARD:
        return "a one-way clutch turns the way that it locks";
    case COTREE_EVENTS_BEYOND:
        return "a rigid stop begins beyond its limit";
    case COTREE_EVENTS_IMPACT:
        return "no impulses of rigid stops agree with each other";
    case COTREE_EVENTS_TOGETHER:
        return "gaps that close at once act on each other, so that either order has other "
               "sensitivities";
    case COTREE_EVENTS_GAINS:
        return "the impact would leave more energy than there was";
    case COTREE_EVENTS_SEVERAL:
        return "a contact may hold or let go: friction allows both";
    case COTREE_EVENTS_LOSSY:
        return "an impact passes a gear with losses, which has no law of impact";
    case COTREE_EVENTS_FAINT:
        return "its impacts are too small for the tolerance";
    }
    return "the status is unknown";
}
