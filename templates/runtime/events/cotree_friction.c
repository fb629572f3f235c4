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
 * force is the first to reach its limit, see cotree_complementarity.c, then the one that is furthest off. */

/* What a force at its limit is taken to move by grows so much each time that it passes the limit
 * without consequences. */
#define MORE COTREE_F(10.0)

/* Writes a record. */
void cotree_record(cotree_events *e, int i, cotree_real t)
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
        if (row->is_jump != kind) continue;
        if (places != NULL) {
            int *const own = places + n * N_PLACES;
            own[MODE] = row->targets[0];
            for (k = STOPS + 1; k < N_PLACES; ++k) own[k] = -1;
            own[STOPS] = i;
        }
        ++n;
    }
    return n;
}

/* Lists the modes of edges with friction, then those of loads. */
void cotree_list_frictions(cotree_events *e, const cotree_hybrid *h)
{
    int i, k;
    cotree_list_modes(h, COTREE_FRICTION_STOPS, e->friction);
    cotree_list_modes(h, COTREE_FRICTION_LOAD, e->friction + e->n_frictions * N_PLACES);
    for (i = 0; i < h->n_events; ++i) {
        const int part = h->events[i].is_jump - COTREE_FRICTION_STOPS;
        if (part <= 0 || part >= N_PLACES - STOPS) continue;
        for (k = 0; k < e->n_frictions; ++k) {
            if (PLACE(k, MODE) == h->events[i].targets[0]) PLACE(k, STOPS + part) = i;
        }
    }
}

/* Evaluates what the events look at, and its rates, with the modes as they are tried. */
int cotree_try_modes(cotree_events *e, cotree_real t, const cotree_real *w)
{
    int k, status;
    cotree_copy(e->n, w, e->tried);
    for (k = 0; k < e->n_modes; ++k) e->tried[PLACE(k, MODE)] = e->modes[k];
    status = cotree_values(e, t, e->tried);
    cotree_copy(e->n_events, e->jumps.values, e->looked);
    if (status == 0) status = cotree_note(e, t, e->tried, e->looked);
    if (status == 0) status = cotree_rates(e, t, e->tried);
    e->fastest = COTREE_F(0.0);
    for (k = 0; k < e->run->n_rates; ++k)
        e->fastest = COTREE_FMAX(e->fastest, COTREE_FABS(e->jumps.moving[k]));
    return status;
}

/* On which side of zero a value is: that of its rate where it is at zero, within what its time is
 * uncertain by. */
cotree_real cotree_side_now(const cotree_events *e, int i, cotree_real t, cotree_real size)
{
    const cotree_real rate = e->jumps.rates[i], g = e->looked[i];
    const cotree_real late = COTREE_F(4.0) * cotree_spacing(t) * COTREE_FABS(rate);
    if (COTREE_FABS(g) >
        COTREE_FMAX(COTREE_FMAX(cotree_band(e, i), e->noise), COTREE_FMAX(ALMOST * size, late)))
        return cotree_sign_of(g);
    return COTREE_FABS(rate) * e->span > COTREE_FMAX(AGAINST * size, e->atol) ? cotree_sign_of(rate)
                                                                              : COTREE_F(0.0);
}

/* Tells which edges are idle, and gives the others their modes. */
static int find_idle(cotree_events *e, cotree_real t, const cotree_real *w, int fired)
{
    int k, status;
    for (k = e->n_frictions; k < cotree_first_stop(e); ++k) e->modes[k] = w[PLACE(k, MODE)];
    for (; k < e->n_modes; ++k) e->modes[k] = COTREE_F(0.0);
    for (k = 0; k < e->n_frictions; ++k) e->modes[k] = -COTREE_F(1.0);
    status = cotree_try_modes(e, t, w);
    for (k = 0; k < e->n_frictions; ++k) e->scale[k] = e->jumps.rates[PLACE(k, STOPS)];
    for (k = 0; k < e->n_frictions; ++k) e->modes[k] = COTREE_F(1.0);
    if (status == 0) status = cotree_try_modes(e, t, w);
    for (k = 0; k < e->n_frictions && status == 0; ++k) {
        const int i = PLACE(k, STOPS), grip = PLACE(k, GRIP);
        const cotree_real v = e->looked[i], rate = e->jumps.rates[i], mode = w[PLACE(k, MODE)];
        cotree_real near = NEAR_ZERO * (COTREE_SCAN_ROUNDING * e->largest[i] +
                                        cotree_spacing(t) * COTREE_FABS(rate));
        near = COTREE_FMAX(near, cotree_band(e, i));
        /* The sum is the difference of accelerations: with the mode -1 the sign is the other one.
         */
        e->scale[k] = COTREE_FMAX(COTREE_FABS(e->scale[k] + rate),
                                  COTREE_FMAX(COTREE_FABS(e->scale[k]), COTREE_FABS(rate)));
        /* A one-way clutch that turns backwards by less than a tolerance is at rest. */
        if (mode == COTREE_F(0.0) || (v < COTREE_F(0.0) && PLACE(k, BACKWARD) < 0))
            near = COTREE_FMAX(near, cotree_tolerance(e, i));
        if (mode == COTREE_F(0.0) && cotree_is_pressed(e, k))
            near = COTREE_FMAX(near, cotree_doubt(e));
        e->is_idle[k] = i == fired || e->is_passed[i] || COTREE_FABS(v) <= near;
        /* It stops as it begins to slide: its force reaches the limit, and goes no further. */
        e->is_back[k] = i == fired && t - e->left_at[k] <= COTREE_F(4.0) * cotree_spacing(t);
        if (grip >= 0 && cotree_side_now(e, grip, t, e->largest[grip]) <= COTREE_F(0.0)) {
            e->is_idle[k] = 0;
            e->modes[k] = COTREE_F(2.0);
        } else if (cotree_is_pressed(e, k)) {
            /* It is chosen as its stop is; what slips keeps its way. */
            e->is_idle[k] =
                e->is_idle[k] || (mode == COTREE_F(2.0) && COTREE_FABS(v) <= cotree_doubt(e));
            e->way_of[k] = e->is_idle[k] ? COTREE_F(2.0) : cotree_sign_of(v);
            e->modes[k] = COTREE_F(2.0);
        } else if (e->is_idle[k]) {
            e->modes[k] = COTREE_F(0.0);
        } else {
            e->modes[k] = cotree_sign_of(v);
            if (v < COTREE_F(0.0) && PLACE(k, BACKWARD) < 0)
                status = cotree_fail(e, i, t, COTREE_EVENTS_BACKWARD);
        }
    }
    if (status == 0) cotree_find_idle_stops(e);
    return status;
}

/* The largest relative acceleration that is none: a share of what friction changes it by, but not
 * less than the rounding of all rates, of which it is a difference. */
cotree_real cotree_no_acceleration(const cotree_events *e, int k)
{
    return COTREE_FMAX(AGAINST * e->scale[k], UNSURE * COTREE_SCAN_ROUNDING * e->fastest);
}

/* How far an idle edge is off what its mode asks for, as a share; and the mode that it wants. */
cotree_real cotree_contradiction(cotree_events *e, int k, cotree_real t, cotree_real *wanted)
{
    const int forward = PLACE(k, FORWARD), backward = PLACE(k, BACKWARD), i = PLACE(k, STOPS);
    const cotree_real rate = e->jumps.rates[i];
    cotree_real up, down, width, largest = COTREE_F(0.0);
    int n;
    if (e->modes[k] != COTREE_F(0.0)) {
        const cotree_real size = e->scale[k] = COTREE_FMAX(e->scale[k], COTREE_FABS(rate));
        const cotree_real none = cotree_no_acceleration(e, k);
        *wanted = COTREE_F(0.0);
        if (rate < -none) return -rate / size;
        if (rate > none) return COTREE_F(0.0);
        largest = e->fastest;
        for (n = 0; n < e->n_frictions; ++n) largest = COTREE_FMAX(largest, e->scale[n]);
        return e->bend[i] * e->span < -LATER * largest ? COTREE_EPSILON : COTREE_F(0.0);
    }
    up = e->looked[forward];
    down = backward < 0 ? COTREE_INFINITY : e->looked[backward];
    /* Faces that begin to be pressed together have a negative one, by rounding. */
    width =
        backward < 0 ? COTREE_FMAX(COTREE_FABS(up), e->largest[forward]) : COTREE_FABS(up + down);
    if (cotree_side_now(e, forward, t, width) < COTREE_F(0.0)) {
        *wanted = COTREE_F(1.0);
        if (up < -COTREE_FMAX(ALMOST * width, e->noise)) return -up / width;
        return e->is_back[k] ? COTREE_F(0.0) : COTREE_EPSILON;
    }
    if (backward >= 0 && cotree_side_now(e, backward, t, width) < COTREE_F(0.0)) {
        *wanted = -COTREE_F(1.0);
        if (down < -COTREE_FMAX(ALMOST * width, e->noise)) return -down / width;
        return e->is_back[k] ? COTREE_F(0.0) : COTREE_EPSILON;
    }
    return COTREE_F(0.0);
}

/* One where the sign of a load is another one than its laws stand for, as a share. */
cotree_real cotree_load_is_turned(const cotree_events *e, int k, cotree_real t)
{
    const int i = PLACE(k, STOPS);
    return cotree_side_now(e, i, t, e->largest[i]) < COTREE_F(0.0) ? COTREE_F(1.0) : COTREE_F(0.0);
}

/* Evaluates how accelerations change where an edge is let go without any. */
int cotree_look_later(cotree_events *e, cotree_real t)
{
    int k, is_needed = 0;
    for (k = 0; k < e->n_frictions; ++k) {
        const cotree_real rate = COTREE_FABS(e->jumps.rates[PLACE(k, STOPS)]);
        is_needed = is_needed || (e->is_idle[k] && e->modes[k] != COTREE_F(0.0) &&
                                  rate <= cotree_no_acceleration(e, k));
    }
    for (k = cotree_first_stop(e); k < e->n_modes; ++k)
        is_needed = is_needed || cotree_is_parting(e, k);
    if (!is_needed) return 0;
    if (cotree_find_bend(e, t, e->tried) != 0) return e->trouble;
    cotree_note_later(e);
    return cotree_rates(e, t, e->tried);
}

/* Whether an event looks at the speed of an edge that has not left zero since it began to slide:
 * no more than rounding says where it is. */
int cotree_is_resting(const cotree_events *e, int i) { return e->n_modes > 0 && e->resting[i]; }

/* Notes whether a force stays at its limit, as it does where both limits are zero, or a load at
 * zero. How far rounding moves it there shows only as it passes without consequences. */
static void rest_at_zero(cotree_events *e, int i, int may_rest, int is_back, cotree_real t,
                         int fired)
{
    const cotree_real g = COTREE_FABS(e->looked[i]), size = COTREE_FMAX(g, e->largest[i]);
    e->resting[i] = may_rest && (cotree_side_now(e, i, t, size) == COTREE_F(0.0) ||
                                 (is_back && g <= ALMOST * size) ||
                                 (i == fired && g <= cotree_tolerance(e, i)));
    e->level[i] *= i == fired ? MORE : COTREE_F(1.0);
    e->level[i] = COTREE_FMAX(COTREE_FMAX(e->level[i], UNSURE * g),
                              COTREE_FMAX(ALMOST * size, cotree_tolerance(e, i)));
    if (!e->resting[i]) e->level[i] = COTREE_F(0.0);
}

/* Notes which values stay at zero once modes are chosen. */
static void note_rests(cotree_events *e, cotree_real t, int fired)
{
    int k, what;
    for (k = 0; k < e->n_frictions; ++k) {
        const int i = PLACE(k, STOPS), sticks = e->modes[k] == COTREE_F(0.0);
        e->resting[i] = e->is_idle[k] && !sticks;
        if (e->resting[i]) e->left_at[k] = t;
        for (what = FORWARD; what <= BACKWARD; ++what) {
            if (PLACE(k, what) < 0) continue;
            rest_at_zero(e, PLACE(k, what), sticks, e->is_back[k], t, fired);
        }
    }
    for (; k < cotree_first_stop(e); ++k) rest_at_zero(e, PLACE(k, STOPS), 1, 0, t, fired);
    for (; k < e->n_modes; ++k) cotree_note_parting(e, k);
}

/* Chooses all modes at w, after an event or where something else jumps; they change as the last
 * event happens. */
int cotree_settle_modes(cotree_events *e, cotree_real t, cotree_real *w, int fired)
{
    int k, is_changed = 0, status;
    if (e->n_modes == 0) return 0;
    cotree_copy(e->run->n_full, e->jumps.before, e->was);
    e->noise = COTREE_F(0.0);
    status = cotree_settle_impacts(e, t, w, fired);
    if (status == 0) status = find_idle(e, t, w, fired);
    if (status == 0) status = cotree_choose_modes(e, t, w);
    if (status != 0) return status;
    for (k = 0; k < e->n_modes; ++k) is_changed = is_changed || e->modes[k] != w[PLACE(k, MODE)];
    note_rests(e, t, fired);
    if (is_changed) {
        e->is_shifted = 1;
        status = cotree_jumps_shift(&e->jumps, t, w, e->n_modes, e->friction, N_PLACES, e->modes);
    }
    if (e->n_stops > 0 ? fired >= 0 : is_changed)
        cotree_copy(e->run->n_full, e->was, e->jumps.before);
    if (status == 0) cotree_record_impacts(e, t, fired);
    return status == 0 ? 0 : cotree_fail(e, PLACE(0, STOPS), t, COTREE_EVENTS_FAILED);
}

/* Whether an event belongs to an edge whose mode was chosen last, together with others. */
int cotree_has_chosen(const cotree_events *e, int i)
{
    int k, what;
    for (k = 0; k < e->n_frictions; ++k) {
        for (what = STOPS; what <= BACKWARD; ++what) {
            if (PLACE(k, what) == i) return e->is_idle[k];
        }
    }
    return 0;
}

/* Sets the sides from which the events of friction, and of gaps that are closed but free, come
 * next. */
void cotree_face_modes(cotree_events *e, const cotree_real *w)
{
    int k;
    for (k = 0; k < cotree_first_stop(e); ++k) {
        const int grip = PLACE(k, GRIP);
        int what;
        for (what = STOPS; what <= BACKWARD; ++what) {
            const int i = PLACE(k, what);
            if (i >= 0 && e->resting[i]) e->side[i] = COTREE_F(1.0);
        }
        if (grip >= 0 && e->side[grip] == COTREE_F(0.0)) e->side[grip] = -COTREE_F(1.0);
    }
    for (; k < e->n_modes; ++k) {
        const int gap = cotree_gap_of(e, k), is_free = w[PLACE(k, MODE)] == COTREE_F(0.0);
        if (e->closed[k - cotree_first_stop(e)] == COTREE_F(0.0)) continue;
        /* It may be below zero, as far as closed gaps are. */
        if (e->resting[gap] || (is_free && !e->is_passed[gap])) e->side[gap] = COTREE_F(1.0);
    }
}
