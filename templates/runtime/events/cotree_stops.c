/* cotree_stops.c: modes of rigid stops, and of friction whose limits follow from their forces.
 * Part of the runtime of cotree, the same for every model.
 */
#include "cotree_events_internal.h"

#include <float.h>
#include <math.h>
#include <stddef.h>

/* Rounding of a force is that of all, which are this much larger at most. */
#define OWN_SHARE (NEAR_ZERO * COTREE_SCAN_ROUNDING / ALMOST)

int cotree_first_stop(const cotree_events *e) { return e->n_modes - e->n_stops; }

/* Counts the edges with friction that stops press together. */
int cotree_count_pressed(const cotree_hybrid *h)
{
    int i, n = 0;
    for (i = 0; i < h->n_events; ++i) {
        n += h->events[i].is_jump == COTREE_FRICTION_STOPS && h->events[i].n_targets > 2;
    }
    return n;
}

/* Finds out which friction is pressed by which stop, once these are listed. */
static void list_pressed(cotree_events *e)
{
    int i, k, n = 0;
    for (k = 0; k < e->n_frictions; ++k) {
        const cotree_event *const row = e->rows + PLACE(k, STOPS);
        e->presser[k] = -1;
        for (i = cotree_first_stop(e); i < e->n_modes && row->n_targets > 2; ++i) {
            if (PLACE(i, MODE) == row->targets[1]) e->presser[k] = i;
        }
        if (e->presser[k] < 0) continue;
        e->pressed[n] = k;
        e->impulses[e->n_stops + n] = row->targets[2];
        e->pulls[e->n_stops + 2 * n] = PLACE(k, FORWARD);
        e->pulls[e->n_stops + 2 * n + 1] = PLACE(k, BACKWARD);
        ++n;
    }
}

void cotree_list_stops(cotree_events *e, const cotree_hybrid *h)
{
    int i, k;
    cotree_list_modes(h, COTREE_STOP_RESTS, e->friction + cotree_first_stop(e) * N_PLACES);
    for (i = 0; i < h->n_events; ++i) {
        const int part = h->events[i].is_jump;
        if (part < COTREE_STOP_UPPER || part > COTREE_STOP_LIFTS) continue;
        for (k = cotree_first_stop(e); k < e->n_modes; ++k) {
            if (PLACE(k, MODE) != h->events[i].targets[0]) continue;
            PLACE(k, UPPER + part - COTREE_STOP_UPPER) = i;
        }
    }
    for (k = 0; k < e->n_stops; ++k) {
        const int own = cotree_first_stop(e) + k;
        e->impulses[k] = e->rows[PLACE(own, RESTS)].targets[1];
        e->pulls[k] = PLACE(own, LIFTS);
        e->swift[k] = e->brisk[k] = COTREE_F(0.0);
    }
    list_pressed(e);
    for (k = e->n_frictions; k < cotree_first_stop(e); ++k) {
        e->pulls[e->n_stops + 2 * e->n_pressed + k - e->n_frictions] = PLACE(k, STOPS);
    }
}

/* Whether a stop presses an edge with friction together. */
int cotree_is_pressed(const cotree_events *e, int k)
{
    return e->n_pressed > 0 && k < e->n_frictions && e->presser[k] >= 0;
}

int cotree_is_load(const cotree_events *e, int k)
{
    return k >= e->n_frictions && k < cotree_first_stop(e);
}

/* Whether the mode of an edge is among those to be chosen. Loads keep their signs in impacts. */
int cotree_is_chosen(const cotree_events *e, int k)
{
    return cotree_is_load(e, k) ? !e->is_striking : e->is_idle[k];
}

/* Whether it may be another one beside the others as they are now. */
int cotree_is_open(const cotree_events *e, int k)
{
    /* Friction that a stop presses together waits for that to hold. */
    return cotree_is_chosen(e, k) &&
           (!cotree_is_pressed(e, k) || e->modes[e->presser[k]] != COTREE_F(0.0));
}

/* The event that looks at the gap on the side that is closed. */
int cotree_gap_of(const cotree_events *e, int k)
{
    return PLACE(k, e->closed[k - cotree_first_stop(e)] > COTREE_F(0.0) ? UPPER : LOWER);
}

/* The speed at which the gap of a closed stop opens, of what events would set it by. */
cotree_real cotree_opening(const cotree_events *e, int k)
{
    return e->closed[k - cotree_first_stop(e)] * cotree_jumps_rebound(&e->jumps, PLACE(k, RESTS));
}

/* What opening speeds are uncertain by, as far as the error test knows. */
cotree_real cotree_doubt(const cotree_events *e)
{
    cotree_real largest = COTREE_F(0.0);
    int k;
    for (k = 0; k < e->n_stops; ++k) largest = COTREE_FMAX(largest, e->swift[k]);
    return e->rtol * largest + e->atol;
}

/* Opening speeds below this are rounding, which is that of all, or what accelerations that vanish
 * have made of theirs, or what a stop that held has been left by the tolerance. */
cotree_real cotree_slack(const cotree_events *e, int k)
{
    cotree_real largest = COTREE_F(0.0);
    int i;
    for (i = 0; i < e->n_stops; ++i) {
        largest = COTREE_FMAX(largest, COTREE_FMAX(e->swift[i], e->span * e->brisk[i]));
    }
    largest *= NEAR_ZERO * COTREE_SCAN_ROUNDING;
    return e->has_held[k - cotree_first_stop(e)] ? COTREE_FMAX(largest, cotree_doubt(e)) : largest;
}

/* Whether an event looks at the gap of a stop. */
int cotree_is_gap(const cotree_events *e, int i)
{
    return e->rows[i].is_jump == COTREE_STOP_UPPER || e->rows[i].is_jump == COTREE_STOP_LOWER;
}

int cotree_is_closed(const cotree_events *e, int i, cotree_real t, int fired)
{
    const cotree_real near =
        NEAR_ZERO * (cotree_band(e, i) + cotree_spacing(t) * COTREE_FABS(e->jumps.rates[i]));
    return i >= 0 && (i == fired || e->is_passed[i] || e->looked[i] <= near);
}

/* Refuses a start beyond a limit. */
int cotree_check_gaps(cotree_events *e, cotree_real t, const cotree_real *g)
{
    int i;
    for (i = 0; i < e->n_events; ++i) {
        if (cotree_is_gap(e, i) && g[i] < -cotree_band(e, i))
            return cotree_fail(e, i, t, COTREE_EVENTS_BEYOND);
    }
    return 0;
}

/* Whether what a stop presses together sticks: its force has no limit yet. */
int cotree_is_rubbing(const cotree_events *e, int k)
{
    int i;
    for (i = 0; i < e->n_pressed; ++i) {
        if (e->presser[e->pressed[i]] == k && e->modes[e->pressed[i]] == COTREE_F(0.0)) return 1;
    }
    return 0;
}

/* The acceleration at which the gap of a closed stop opens, where rates were evaluated last. */
cotree_real cotree_parting(const cotree_events *e, int k)
{
    return e->closed[k - cotree_first_stop(e)] *
           cotree_jumps_rebound_rate(&e->jumps, PLACE(k, RESTS));
}

/* Tells which closed stops are idle, at the speeds and accelerations of the modes that are tried.
 */
void cotree_find_idle_stops(cotree_events *e)
{
    int k;
    for (k = cotree_first_stop(e); k < e->n_modes; ++k) {
        const int own = k - cotree_first_stop(e);
        cotree_real rate;
        e->is_idle[k] =
            e->closed[own] != COTREE_F(0.0) && COTREE_FABS(e->speeds[own]) <= cotree_slack(e, k);
        e->modes[k] = COTREE_F(0.0);
        /* Forces are as small as they are beside those of other times, and so are accelerations. */
        rate = COTREE_FABS(cotree_jumps_rebound_rate(&e->jumps, PLACE(k, RESTS)));
        e->scale[k] = e->brisk[own] = COTREE_FMAX(e->brisk[own], rate);
    }
}

static cotree_real largest_scale(const cotree_events *e)
{
    cotree_real largest = COTREE_F(0.0);
    int k;
    for (k = 0; k < e->n_modes; ++k) {
        if (k < e->n_frictions || k >= cotree_first_stop(e))
            largest = COTREE_FMAX(largest, e->scale[k]);
    }
    return largest;
}

/* Accelerations below this are none; rounding is that of all. */
cotree_real cotree_still(const cotree_events *e, int k)
{
    return COTREE_FMAX(AGAINST * e->scale[k], NEAR_ZERO * COTREE_SCAN_ROUNDING * largest_scale(e));
}

/* Whether a closed stop is free without an acceleration, so that the change of that decides. */
int cotree_is_parting(const cotree_events *e, int k)
{
    return e->is_idle[k] && e->modes[k] == COTREE_F(0.0) &&
           COTREE_FABS(cotree_parting(e, k)) <= cotree_still(e, k);
}

/* Notes accelerations a little later, as find_bend has left them. */
void cotree_note_later(cotree_events *e)
{
    int k;
    for (k = cotree_first_stop(e); k < e->n_modes; ++k) {
        if (e->is_idle[k]) e->later[k - cotree_first_stop(e)] = cotree_parting(e, k);
    }
}

/* Notes whether a gap is closed that may open, and how far from zero it is. */
void cotree_note_parting(cotree_events *e, int k)
{
    const int is_free = e->is_idle[k] && e->modes[k] == COTREE_F(0.0),
              own = k - cotree_first_stop(e);
    int what;
    for (what = UPPER; what <= LOWER; ++what) {
        const int i = PLACE(k, what);
        if (i < 0) continue;
        e->resting[i] = is_free && i == cotree_gap_of(e, k);
        e->held[i] = e->resting[i] ? e->gaps[own] : COTREE_F(0.0);
    }
}

static cotree_real largest_force(const cotree_events *e)
{
    cotree_real largest = COTREE_F(0.0);
    int k;
    for (k = 0; k < e->n_stops; ++k) largest = COTREE_FMAX(largest, e->largest[e->pulls[k]]);
    return largest;
}

/* How far an idle stop is off what its mode asks for, as a share; and the mode that it wants. */
cotree_real cotree_stop_contradiction(cotree_events *e, int k, cotree_real t, cotree_real *wanted)
{
    const int own = k - cotree_first_stop(e), force = PLACE(k, LIFTS);
    cotree_real rate;
    if (e->modes[k] != COTREE_F(0.0)) {
        const cotree_real size = COTREE_FMAX(e->largest[force], OWN_SHARE * largest_force(e));
        *wanted = COTREE_F(0.0);
        if (cotree_side_now(e, force, t, size) >= COTREE_F(0.0) || cotree_is_rubbing(e, k))
            return COTREE_F(0.0);
        return COTREE_FMAX(-e->looked[force] / COTREE_FMAX(size, COTREE_MIN), COTREE_EPSILON);
    }
    *wanted = e->closed[own];
    rate = cotree_parting(e, k);
    e->scale[k] = COTREE_FMAX(e->scale[k], COTREE_FABS(rate));
    if (rate < -cotree_still(e, k)) return -rate / e->scale[k];
    if (rate > cotree_still(e, k)) return COTREE_F(0.0);
    rate = (e->later[own] - rate) / (BENDING * e->span);
    return rate * e->span < -LATER * largest_scale(e) ? COTREE_EPSILON : COTREE_F(0.0);
}

/* Friction that stops press together, as at contacts: its limits move with the force of its stop.
 * At first no force holds it, mode 2; where another one holds the same thing, none has to. */

/* How far such friction is off what its mode asks for, as a share; and the mode that it wants. */
cotree_real cotree_pressed_contradiction(cotree_events *e, int k, cotree_real t,
                                         cotree_real *wanted)
{
    const cotree_real rate = cotree_jumps_rebound_rate(&e->jumps, PLACE(k, STOPS));
    e->scale[k] = COTREE_FMAX(e->scale[k], largest_scale(e));
    if (e->modes[k] == COTREE_F(2.0)) {
        *wanted = COTREE_F(0.0);
        return COTREE_FABS(rate) > cotree_still(e, k) ? COTREE_FABS(rate) / e->scale[k]
                                                      : COTREE_F(0.0);
    }
    if (cotree_side_now(e, PLACE(e->presser[k], LIFTS), t, COTREE_F(0.0)) < COTREE_F(0.0)) {
        /* What sticks slides before its stop lets go. */
        *wanted = e->looked[PLACE(k, FORWARD)] < e->looked[PLACE(k, BACKWARD)] ? COTREE_F(1.0)
                                                                               : -COTREE_F(1.0);
        return e->modes[k] == COTREE_F(0.0) ? COTREE_F(1.0) : COTREE_F(0.0);
    }
    return cotree_contradiction(e, k, t, wanted);
}

/* Writes the acceleration along an edge with friction, pushed by a force. */
static int push(cotree_events *e, cotree_real t, int which, cotree_real force,
                cotree_real *acceleration)
{
    const int i = e->pressed[which], impulse = e->impulses[e->n_stops + which];
    int status;
    e->tried[impulse] = force;
    status = cotree_rates(e, t, e->tried);
    e->tried[impulse] = COTREE_F(0.0);
    *acceleration = -cotree_jumps_rebound_rate(&e->jumps, PLACE(i, STOPS));
    return status;
}

/* How much a force on an edge with friction accelerates it, in the modes that are tried. */
static int find_slope(cotree_events *e, cotree_real t, int which, cotree_real *slope)
{
    cotree_real without, with;
    int k;
    for (k = 0; k < e->n_modes; ++k) e->tried[PLACE(k, MODE)] = e->modes[k];
    if (push(e, t, which, COTREE_F(0.0), &without) != 0 ||
        push(e, t, which, COTREE_F(1.0), &with) != 0) {
        return e->trouble;
    }
    *slope = COTREE_FABS(with - without);
    return 0;
}

/* Lets stick what no force has to hold now, but for what others hold already: a force would do
 * nothing there. */
int cotree_bind_pressed(cotree_events *e, cotree_real t)
{
    int k, n;
    for (n = 0; n < e->n_pressed; ++n) {
        cotree_real alone, among;
        k = e->pressed[n];
        if (!cotree_is_open(e, k) || e->modes[k] != COTREE_F(2.0)) continue;
        if (find_slope(e, t, n, &among) != 0) return e->trouble;
        cotree_copy(e->n_modes, e->modes, e->chosen);
        for (k = 0; k < e->n_pressed; ++k) e->modes[e->pressed[k]] = COTREE_F(2.0);
        if (find_slope(e, t, n, &alone) != 0) return e->trouble;
        cotree_copy(e->n_modes, e->chosen, e->modes);
        if (among > BOUND * alone) e->modes[e->pressed[n]] = COTREE_F(0.0);
    }
    return 0;
}
