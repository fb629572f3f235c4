/* cotree_impacts.c: impacts of rigid stops.
 * Part of the runtime of cotree, the same for every model.
 */
#include "cotree_events_internal.h"

#include <float.h>
#include <math.h>
#include <stddef.h>

/* Impacts as one more choice of modes, by the walk that chooses those of motions: impulses are its
 * forces, changes of speeds its accelerations. A stop that is struck holds (its side of the limit)
 * where it takes an impulse, and is free (0) where it takes none. What it presses together sticks
 * (0), slides as it leaves (1 or -1), or takes no impulse (2). All else keeps its mode. */

/* What the kernels are told of modes in an impact: stops that take an impulse have twice the side
 * of their limit, and what sticks there has its own mode. */
#define STRUCK COTREE_F(2.0)
#define STICKS COTREE_F(3.0)

/* Whether a closed stop takes part in an impact. */
static int takes_part(const cotree_events *e, int k)
{
    return e->closed[k - cotree_first_stop(e)] != COTREE_F(0.0) &&
           e->is_struck[k - cotree_first_stop(e)] >= 0;
}

/* Writes what an impact has to know of the modes as they are. */
static cotree_strike strike_of(cotree_events *e)
{
    cotree_strike s;
    int k;
    for (k = 0; k < e->n_modes; ++k) {
        const int own = k - cotree_first_stop(e);
        const cotree_real mode = e->modes[k];
        e->told[k] = own >= 0 ? STRUCK * mode : mode;
        /* Friction that sticks keeps nothing from moving: its force stays finite. */
        if (k < e->n_frictions && mode == COTREE_F(0.0))
            e->told[k] = cotree_is_pressed(e, k) ? STICKS : COTREE_F(1.0);
        if (own >= 0) e->of_impact[own] = mode != COTREE_F(0.0) ? e->rebounds[own] : -1;
    }
    for (k = 0; k < e->n_pressed; ++k) {
        const int i = e->pressed[k];
        e->of_impact[e->n_stops + k] = e->modes[i] == COTREE_F(0.0) ? PLACE(i, STOPS) : -1;
    }
    s.n_modes = e->n_modes;
    s.stride = N_PLACES;
    s.places = e->friction;
    s.modes = e->told;
    s.n_edges = e->n_stops + e->n_pressed;
    s.n_stops = e->n_stops;
    s.n_pulls = e->n_modes - e->n_frictions + 2 * e->n_pressed;
    s.impulses = e->impulses;
    s.rebounds = e->of_impact;
    s.pulls = e->pulls;
    return s;
}

/* Tries an impact: leaves the speeds after it, and its impulses in the place of forces. Returns
 * another number than zero where it has no solution. */
int cotree_try_struck(cotree_events *e, cotree_real t, const cotree_real *w)
{
    const cotree_strike s = strike_of(e);
    int i, status = cotree_jumps_try_strike(&e->jumps, &s, t, w, e->tried);
    if (status == 0) status = cotree_jumps_news(&e->jumps, t, e->tried);
    for (i = 0; i < s.n_pulls && status == 0; ++i) e->looked[e->pulls[i]] = e->jumps.pulls[i];
    return status;
}

static cotree_real largest_impulse(const cotree_events *e)
{
    cotree_real largest = COTREE_F(0.0);
    int i;
    for (i = 0; i < e->n_stops; ++i) largest = COTREE_FMAX(largest, COTREE_FABS(e->jumps.pulls[i]));
    return largest;
}

/* How far a closed stop is off what an impact asks for, as a share; and what it wants. */
cotree_real cotree_misfit(const cotree_events *e, int k, cotree_real *wanted)
{
    const int own = k - cotree_first_stop(e), is_hit = e->modes[k] != COTREE_F(0.0);
    cotree_real least;
    *wanted = is_hit ? COTREE_F(0.0) : e->closed[own];
    /* What opens by less than rounding tells is held by less than that, too. */
    if (is_hit && cotree_gap_of(e, k) == e->faint) return COTREE_F(0.0);
    if (is_hit) {
        const cotree_real impulse = e->looked[PLACE(k, LIFTS)], largest = largest_impulse(e);
        if (cotree_is_rubbing(e, k)) return COTREE_F(0.0); /* it slides before it lets go */
        return impulse < -PULLING * largest ? -impulse / largest : COTREE_F(0.0);
    }
    /* What it opens by is no less than its restitution asks for. */
    least = e->is_struck[own] > 0 ? e->wanted[own] : COTREE_F(0.0);
    return cotree_opening(e, k) < least - COTREE_FMAX(cotree_slack(e, k), AGAINST * e->quickest)
               ? (least - cotree_opening(e, k)) / COTREE_FMAX(e->quickest, COTREE_MIN)
               : COTREE_F(0.0);
}

/* The speed at which friction leaves an impact. */
static cotree_real leaving(const cotree_events *e, int k)
{
    return -cotree_jumps_rebound(&e->jumps, PLACE(k, STOPS));
}

/* How far friction is off what an impact asks for, as a share, and what it wants to be: it sticks
 * where its impulse stays within the limits, or slides the way that it leaves. */
cotree_real cotree_misrub(const cotree_events *e, int k, cotree_real *wanted)
{
    const cotree_real up = e->looked[PLACE(k, FORWARD)], down = e->looked[PLACE(k, BACKWARD)];
    const cotree_real least = AGAINST * e->quickest, speed = leaving(e, k);
    if (e->modes[k] == COTREE_F(0.0)) {
        const cotree_real over = -COTREE_FMIN(up, down), width = up + down;
        *wanted = up < down ? COTREE_F(1.0) : -COTREE_F(1.0);
        if (e->looked[PLACE(e->presser[k], LIFTS)] < COTREE_F(0.0)) return COTREE_F(1.0);
        return over > PULLING * width ? over / COTREE_FMAX(width, COTREE_MIN) : COTREE_F(0.0);
    }
    *wanted = COTREE_F(0.0);
    if (e->looked[PLACE(e->presser[k], LIFTS)] < COTREE_F(0.0)) return COTREE_F(0.0);
    /* Without an impulse: where another one holds the same thing, none has to. */
    if (e->modes[k] == COTREE_F(2.0))
        return COTREE_FABS(speed) > least ? COTREE_FABS(speed) / e->quickest : COTREE_F(0.0);
    return speed * e->modes[k] < -least ? -speed * e->modes[k] / e->quickest : COTREE_F(0.0);
}

/* Whether an impact leaves more energy than there was, which Newton's law of impact may where there
 * is friction. */
static int is_gaining(const cotree_events *e)
{
    cotree_real work = COTREE_F(0.0), size = COTREE_F(0.0);
    int k;
    for (k = cotree_first_stop(e); k < e->n_modes; ++k) {
        const cotree_real impulse =
            e->modes[k] != COTREE_F(0.0) ? e->looked[PLACE(k, LIFTS)] : COTREE_F(0.0);
        work +=
            COTREE_F(0.5) * impulse * (e->speeds[k - cotree_first_stop(e)] + cotree_opening(e, k));
        size += COTREE_FABS(impulse) * e->quickest;
    }
    for (k = 0; k < e->n_pressed; ++k) {
        const int i = e->pressed[k];
        const cotree_real up = e->looked[PLACE(i, FORWARD)], down = e->looked[PLACE(i, BACKWARD)];
        if (e->modes[e->presser[i]] == COTREE_F(0.0) || e->modes[i] != COTREE_F(0.0)) continue;
        work -= COTREE_F(0.25) * (down - up) * (e->slips[k] + leaving(e, i));
    }
    return work > GAIN * size;
}

/* Finds a load that an impact changes: the laws of its losses hold for forces, while which way
 * teeth slide may change within an impact. Returns its edge, or -1. */
static int find_lossy(const cotree_events *e)
{
    int k;
    for (k = e->n_frictions; k < cotree_first_stop(e); ++k) {
        if (COTREE_FABS(e->looked[PLACE(k, STOPS)]) > PULLING * largest_impulse(e)) return k;
    }
    return -1;
}

/* Impacts of rigid stops, one after the other, until nothing that is closed closes further. */

/* Finds out which gaps are closed, and how fast these open. */
static int find_closed(cotree_events *e, cotree_real t, const cotree_real *w, int fired)
{
    int k, status;
    for (k = 0; k < cotree_first_stop(e); ++k) e->modes[k] = w[PLACE(k, MODE)];
    for (; k < e->n_modes; ++k) e->modes[k] = COTREE_F(0.0);
    status = cotree_try_modes(e, t, w);
    if (status == 0 && cotree_jumps_news(&e->jumps, t, e->tried) != 0) {
        status = cotree_fail(e, 0, t, COTREE_EVENTS_FAILED);
    }
    for (k = cotree_first_stop(e); k < e->n_modes && status == 0; ++k) {
        const int own = k - cotree_first_stop(e);
        const cotree_real mode = w[PLACE(k, MODE)];
        e->has_held[own] = mode != COTREE_F(0.0);
        e->closed[own] = mode;
        if (mode == COTREE_F(0.0)) {
            if (PLACE(k, UPPER) >= 0 && cotree_is_closed(e, PLACE(k, UPPER), t, fired))
                e->closed[own] = COTREE_F(1.0);
            else if (PLACE(k, LOWER) >= 0 && cotree_is_closed(e, PLACE(k, LOWER), t, fired))
                e->closed[own] = -COTREE_F(1.0);
        }
        e->gaps[own] = e->closed[own] == COTREE_F(0.0)
                           ? COTREE_F(0.0)
                           : COTREE_FABS(e->looked[cotree_gap_of(e, k)]);
        e->speeds[own] = cotree_opening(e, k);
        e->swift[own] = COTREE_FMAX(e->swift[own],
                                    COTREE_FABS(cotree_jumps_rebound(&e->jumps, PLACE(k, RESTS))));
    }
    return status;
}

/* Tells which stops an impact begins at (1), which closed ones take no part because they open (-2),
 * or because their gaps close with it where parameters move its time, and have times of their own
 * (-1). */
static int find_struck(cotree_events *e, int fired)
{
    const int is_own = e->run->n_blocks > 1 && fired >= 0 && cotree_is_gap(e, fired);
    int k, n = 0;
    for (k = cotree_first_stop(e); k < e->n_modes; ++k) {
        const int own = k - cotree_first_stop(e);
        const int is_faint = e->closed[own] != COTREE_F(0.0) && cotree_gap_of(e, k) == e->faint;
        e->is_struck[own] =
            is_faint || (e->closed[own] != COTREE_F(0.0) && e->speeds[own] < -cotree_slack(e, k));
        if (!is_faint && e->speeds[own] > COTREE_FMAX(cotree_slack(e, k), cotree_doubt(e)))
            e->is_struck[own] = -2;
        if (is_own && cotree_gap_of(e, k) != fired && e->is_struck[own] > 0) {
            e->is_struck[own] = e->speeds[own] < -cotree_doubt(e) ? -1 : 0;
        }
        n += e->is_struck[own] > 0;
    }
    return n;
}

/* Says which events give the changes of speeds: those of impacts, or of rest where these leave too
 * little. */
static int find_rebounds(cotree_events *e, cotree_real t, const cotree_real *w)
{
    int k, status;
    for (k = cotree_first_stop(e); k < e->n_modes; ++k)
        e->modes[k] = COTREE_F(2.0) * e->closed[k - cotree_first_stop(e)];
    status = cotree_try_modes(e, t, w);
    for (k = cotree_first_stop(e); k < e->n_modes && status == 0; ++k) {
        const int own = k - cotree_first_stop(e);
        const int is_slow = e->looked[PLACE(k, RESTS)] <= COTREE_F(0.0) ||
                            (e->closed[own] != COTREE_F(0.0) && cotree_gap_of(e, k) == e->faint);
        e->is_slow[own] = e->is_struck[own] > 0 && is_slow;
        e->rebounds[own] =
            e->is_struck[own] > 0 && !is_slow ? cotree_gap_of(e, k) : PLACE(k, RESTS);
    }
    return status;
}

/* Lets the choice of an impact begin: all that is struck takes an impulse, and friction none. */
static void begin_impact(cotree_events *e)
{
    int k;
    e->quickest = COTREE_F(0.0);
    for (k = 0; k < cotree_first_stop(e); ++k) e->is_idle[k] = 0;
    for (; k < e->n_modes; ++k) {
        const int own = k - cotree_first_stop(e);
        e->is_idle[k] = takes_part(e, k);
        e->modes[k] = e->is_struck[own] > 0 ? e->closed[own] : COTREE_F(0.0);
        e->wanted[own] =
            e->speeds[own] - e->closed[own] * cotree_jumps_rebound(&e->jumps, e->rebounds[own]);
        e->quickest = COTREE_FMAX(e->quickest, COTREE_FABS(e->speeds[own]));
    }
    for (k = 0; k < e->n_pressed; ++k) {
        const int i = e->pressed[k];
        e->is_idle[i] = takes_part(e, e->presser[i]);
        e->modes[i] = e->way_of[i] = COTREE_F(2.0);
        e->slips[k] = leaving(e, i);
        e->quickest = COTREE_FMAX(e->quickest, COTREE_FABS(e->slips[k]));
    }
}

/* Finds which of the closed stops take an impulse, and what friction there does. */
static int choose_struck(cotree_events *e, cotree_real t, const cotree_real *w)
{
    int status, lossy;
    begin_impact(e);
    e->is_striking = 1;
    status = cotree_choose(e, t, w);
    e->is_striking = 0;
    lossy = status == 0 ? find_lossy(e) : -1;
    if (lossy >= 0) return cotree_fail(e, PLACE(lossy, STOPS), t, COTREE_EVENTS_LOSSY);
    if (status != 0 || e->n_pressed == 0 || !is_gaining(e)) return status;
    return cotree_fail(e, PLACE(cotree_first_stop(e), RESTS), t, COTREE_EVENTS_GAINS);
}

/* Refuses an impact that changes what closes with it: which comes first decides, and sensitivities
 * have no order. The speeds after it are those that were tried last. */
static int check_apart(cotree_events *e, cotree_real t)
{
    int k;
    for (k = cotree_first_stop(e); k < e->n_modes; ++k) {
        const int own = k - cotree_first_stop(e);
        const cotree_real after = cotree_opening(e, k), change = after - e->speeds[own];
        const int is_changed = e->is_struck[own] == -1 && COTREE_FABS(change) > cotree_slack(e, k);
        const int is_turned = e->is_struck[own] == -2 && after < -cotree_doubt(e);
        if (e->run->n_blocks > 1 && (is_changed || is_turned)) {
            return cotree_fail(e, cotree_gap_of(e, k), t, COTREE_EVENTS_TOGETHER);
        }
    }
    return 0;
}

/* Notes which events an impact is. */
static void note_impact(cotree_events *e)
{
    int k;
    for (k = cotree_first_stop(e); k < e->n_modes; ++k) {
        const int own = k - cotree_first_stop(e);
        if (e->is_struck[own] <= 0) continue;
        e->is_noted[cotree_gap_of(e, k)] = 1;
        if (e->is_slow[own]) e->is_noted[PLACE(k, RESTS)] = 1;
    }
}

/* Records what impacts were, besides the event that is recorded anyway. */
void cotree_record_impacts(cotree_events *e, cotree_real t, int fired)
{
    int i;
    for (i = 0; i < e->n_events && e->n_stops > 0; ++i) {
        if (e->is_noted[i] && i != fired) {
            e->has_fired[i] = 1;
            cotree_record(e, i, t);
        }
        e->is_noted[i] = 0;
    }
}

/* Lets impacts happen at w, until nothing that is closed closes further. */
int cotree_settle_impacts(cotree_events *e, cotree_real t, cotree_real *w, int fired)
{
    int round;
    for (round = 0; e->n_stops > 0 && round < COTREE_EVENT_ROUNDS; ++round) {
        cotree_strike s;
        int status = find_closed(e, t, w, fired);
        if (status != 0) return status;
        if (find_struck(e, fired) == 0) return 0;
        status = find_rebounds(e, t, w);
        if (status == 0 && cotree_jumps_news(&e->jumps, t, w) != 0) {
            status = cotree_fail(e, PLACE(cotree_first_stop(e), RESTS), t, COTREE_EVENTS_FAILED);
        }
        if (status == 0) status = choose_struck(e, t, w);
        if (status == 0) status = check_apart(e, t);
        if (status != 0) return status;
        s = strike_of(e);
        if (cotree_jumps_strike(&e->jumps, &s, t, w) != 0) {
            return cotree_fail(e, PLACE(cotree_first_stop(e), RESTS), t, COTREE_EVENTS_FAILED);
        }
        note_impact(e);
    }
    return 0;
}
