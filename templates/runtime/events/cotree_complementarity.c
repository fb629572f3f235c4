/* cotree_complementarity.c: modes of all unilateral constraints, chosen at once.
 * Part of the runtime of cotree, the same for every model.
 */
#include "cotree_events_internal.h"

#include <float.h>
#include <math.h>
#include <stddef.h>

/* The choice of modes: of dry friction, of rigid stops and contacts, and of the signs of loads, by
 * one walk over all of them.
 *
 * An edge that sticks and a stop that holds are the same here: a force that follows from the
 * motion, within limits. Friction that slides has its force at one of two limits, a stop that is
 * free has it at its only one, which is zero. Trials jump from one set of modes to the next, and
 * forces with them. What decides which edge reaches its limit first is the way between two trials:
 * all forces move from where they are towards those of the new trial, as far as the first limit,
 * whose edge slides, or lets go, there. Where they get there, an edge sticks or a stop holds again
 * whose acceleration is against its mode. So forces never leave their limits, and with constant
 * limits each trial lowers a quadratic function, of which the forces wanted are the least point,
 * until none contradicts (the active-set method for convex quadratic programs, J. Nocedal, S. J.
 * Wright, Numerical Optimization (2006), section 16.5). Only distances to limits are needed.
 *
 * Limits that depend on forces, as those of contacts with friction and of gears with losses, make
 * the problem another one: nothing is lowered, there may be no solution or several, and trials may
 * lead in a circle. The walk is the same then, but that no set of modes is tried twice; where it
 * ends without an answer all sets are tried in turn, if they are few. */

/* The distances of an edge's force to its upper and to its lower limit; a stop has the first one
 * only. */
#define SLACK(k, is_backward) (e->slack[2 * (k) + (is_backward)])

/* Edges that pass a limit change before those that are held back. */
#define BEHIND COTREE_F(2.0)
#define REMAINDER COTREE_SELECT(1125899906842597.0, 1048573.0f)

/* How many modes one edge may have. */
#define MOST_MODES 4

/* Writes the modes that an edge may have, and returns how many. */
static int list_choices(const cotree_events *e, int k, cotree_real *modes)
{
    int n = 0;
    if (cotree_is_load(e, k)) {
        modes[n++] = COTREE_F(1.0);
        modes[n++] = -COTREE_F(1.0);
    } else if (k >= cotree_first_stop(e)) {
        modes[n++] = COTREE_F(0.0);
        modes[n++] = e->closed[k - cotree_first_stop(e)];
    } else {
        if (cotree_is_pressed(e, k)) modes[n++] = COTREE_F(2.0);
        modes[n++] = COTREE_F(0.0);
        modes[n++] = COTREE_F(1.0);
        if (PLACE(k, BACKWARD) >= 0) modes[n++] = -COTREE_F(1.0);
    }
    return n;
}

/* How far an edge is off what its mode asks for, as a share; and the mode that it wants. */
static cotree_real find_contradiction(cotree_events *e, int k, cotree_real t, cotree_real *wanted)
{
    *wanted = -e->modes[k];
    if (e->is_striking)
        return cotree_is_pressed(e, k) ? cotree_misrub(e, k, wanted) : cotree_misfit(e, k, wanted);
    if (k >= cotree_first_stop(e)) return cotree_stop_contradiction(e, k, t, wanted);
    if (cotree_is_load(e, k)) return cotree_load_is_turned(e, k, t);
    return cotree_is_pressed(e, k) ? cotree_pressed_contradiction(e, k, t, wanted)
                                   : cotree_contradiction(e, k, t, wanted);
}

/* Which limit an edge has its force at in a mode: its event; -1: at none. */
static int limit_in(const cotree_events *e, int k, cotree_real mode)
{
    if (cotree_is_load(e, k)) return -1;
    if (k >= cotree_first_stop(e)) return mode == COTREE_F(0.0) ? PLACE(k, LIFTS) : -1;
    return mode == COTREE_F(1.0)    ? PLACE(k, FORWARD)
           : mode == -COTREE_F(1.0) ? PLACE(k, BACKWARD)
                                    : -1;
}

/* Whether the distances of an edge to its limits move with the forces of a trial. */
static int is_moving(const cotree_events *e, int k)
{
    if (!cotree_is_open(e, k) || cotree_is_load(e, k)) return 0;
    if (k >= cotree_first_stop(e)) return e->modes[k] != COTREE_F(0.0);
    return e->modes[k] == COTREE_F(0.0) || cotree_is_pressed(e, k);
}

/* Lets the way begin: with friction halfway between its limits, and without forces of stops. */
static void begin_slack(cotree_events *e)
{
    int k;
    for (k = 0; k < e->n_modes; ++k) {
        cotree_real up, width;
        SLACK(k, 0) = SLACK(k, 1) = COTREE_F(0.0);
        if (k >= e->n_frictions || cotree_is_pressed(e, k)) continue;
        up = e->looked[PLACE(k, FORWARD)];
        width = PLACE(k, BACKWARD) < 0 ? COTREE_F(2.0) * COTREE_FABS(up)
                                       : COTREE_FABS(up + e->looked[PLACE(k, BACKWARD)]);
        SLACK(k, 0) = SLACK(k, 1) = COTREE_F(0.5) * width;
    }
}

/* Which share of the way to the last trial an edge goes until it takes the mode that it wants. */
static cotree_real share_of_way(const cotree_events *e, int k, cotree_real wanted)
{
    const int limit = limit_in(e, k, wanted);
    cotree_real left, g;
    if (cotree_is_load(e, k)) return COTREE_F(0.0);
    if (limit < 0) return BEHIND;
    left = SLACK(k, wanted < COTREE_F(0.0));
    g = e->looked[limit];
    return g < COTREE_F(0.0) ? left / (left - g) : COTREE_F(1.0);
}

/* Goes a share of the way to the last trial. */
static void go_along(cotree_events *e, cotree_real share)
{
    int k, side;
    for (k = 0; k < e->n_modes; ++k) {
        const int is_stop = k >= cotree_first_stop(e);
        if (!is_moving(e, k)) continue;
        for (side = 0; side < 2; ++side) {
            const cotree_real way = side ? -COTREE_F(1.0) : COTREE_F(1.0);
            const int limit = limit_in(e, k, is_stop ? COTREE_F(0.0) : way);
            const cotree_real left = SLACK(k, side);
            if (limit < 0 || (is_stop && side) || (!is_stop && e->modes[k] == way)) continue;
            SLACK(k, side) =
                COTREE_FMAX(left + COTREE_FMIN(share, COTREE_F(1.0)) * (e->looked[limit] - left),
                            COTREE_F(0.0));
        }
    }
}

/* The mode of one edge once another one has its new one: a stop takes along what it presses
 * together, which begins without a force. */
static cotree_real mode_after(const cotree_events *e, int i, int k, cotree_real mode)
{
    if (i == k) return mode;
    if (!cotree_is_pressed(e, i) || e->presser[i] != k) return e->modes[i];
    return mode == COTREE_F(0.0) ? COTREE_F(2.0) : e->way_of[i];
}

/* Gives an edge another mode. */
static void change_mode(cotree_events *e, int k, cotree_real mode)
{
    int i;
    for (i = 0; i < e->n_modes; ++i) e->modes[i] = mode_after(e, i, k, mode);
}

/* Gives an edge its mode at the end of the way. */
static void take_mode(cotree_events *e, int k, cotree_real mode)
{
    int i;
    if (limit_in(e, k, mode) >= 0) SLACK(k, mode < COTREE_F(0.0)) = COTREE_F(0.0);
    for (i = 0; i < e->n_pressed; ++i) {
        const int own = e->pressed[i];
        if (e->presser[own] == k) SLACK(own, 0) = SLACK(own, 1) = COTREE_F(0.0);
    }
    change_mode(e, k, mode);
}

/* A number that tells modes apart, with another one in the place of one of them. */
static cotree_real number_of(const cotree_events *e, int other, cotree_real mode)
{
    cotree_real number = COTREE_F(0.0);
    int k;
    for (k = 0; k < e->n_modes; ++k) {
        const cotree_real own = other < 0 ? e->modes[k] : mode_after(e, k, other, mode);
        number = COTREE_FMOD(COTREE_F(4.0) * number + own + COTREE_F(1.0), REMAINDER);
    }
    return number;
}

/* Notes the modes that are tried now. */
static void note_try(cotree_events *e)
{
    e->tries[e->n_tries % N_TRIES] = number_of(e, -1, COTREE_F(0.0));
    if (++e->n_tries >= 2 * N_TRIES) e->n_tries -= N_TRIES;
}

/* Whether modes were tried before, with another one in the place of one of them. */
static int is_tried(const cotree_events *e, int k, cotree_real mode)
{
    const cotree_real number = number_of(e, k, mode);
    int i;
    for (i = 0; i < e->n_tries && i < N_TRIES; ++i) {
        if (e->tries[i] == number) return 1;
    }
    return 0;
}

/* Finds a mode of an edge that was not tried beside those of the others. */
static int find_choice(const cotree_events *e, int k, cotree_real *mode)
{
    cotree_real modes[MOST_MODES];
    int i, n = list_choices(e, k, modes);
    for (i = 0; i < n; ++i) {
        if (is_tried(e, k, modes[i])) continue;
        *mode = modes[i];
        return 1;
    }
    return 0;
}

/* Finds an edge that does not contradict, but leads to modes that were not tried. */
static int find_untried(const cotree_events *e, int *changed, cotree_real *to)
{
    int k;
    for (k = 0; k < e->n_modes; ++k) {
        if (!cotree_is_open(e, k) || !find_choice(e, k, to)) continue;
        *changed = k;
        return 1;
    }
    return 0;
}

/* Finds what the forces of idle edges are uncertain by: each follows from those of the others, and
 * has their rounding even where it is zero itself. */
static void find_noise(cotree_events *e)
{
    cotree_real largest = COTREE_F(0.0);
    int k, what;
    for (k = 0; k < e->n_frictions; ++k) {
        for (what = FORWARD; what <= BACKWARD && e->is_idle[k]; ++what) {
            if (PLACE(k, what) >= 0)
                largest = COTREE_FMAX(largest, COTREE_FABS(e->looked[PLACE(k, what)]));
        }
    }
    e->noise = COTREE_SCAN_ROUNDING * largest;
}

/* Evaluates forces and accelerations, or impulses and speeds, with the modes as they are. */
static int try_choice(cotree_events *e, cotree_real t, const cotree_real *w)
{
    return e->is_striking ? cotree_try_struck(e, t, w) : cotree_try_modes(e, t, w);
}

/* Finds what contradictions are found by besides these. */
static int look_further(cotree_events *e, cotree_real t)
{
    if (e->is_striking) return 0;
    find_noise(e);
    return cotree_look_later(e, t);
}

/* Finds what contradicts the modes as they are tried, and which mode changes first. Returns whether
 * anything contradicts; changed is -1 where all that could change leads back. */
static int find_change(cotree_events *e, cotree_real t, int *changed, cotree_real *to)
{
    cotree_real first = COTREE_F(0.0), most = COTREE_F(0.0);
    int k, is_wrong = 0;
    *changed = -1;
    for (k = 0; k < e->n_modes; ++k) {
        cotree_real wanted, off, share;
        if (!cotree_is_open(e, k)) continue;
        off = find_contradiction(e, k, t, &wanted);
        if (!(off > COTREE_F(0.0))) continue;
        is_wrong = 1;
        share = share_of_way(e, k, wanted);
        if (is_tried(e, k, wanted)) {
            /* Limits that depend on forces may lead in a circle: another mode is left. */
            share = BEHIND + COTREE_F(1.0);
            if (!find_choice(e, k, &wanted)) continue;
        }
        if (*changed >= 0 && (share > first || (share == first && off <= most))) continue;
        *changed = k;
        *to = wanted;
        first = share;
        most = off;
    }
    if (*changed >= 0) go_along(e, first);
    return is_wrong;
}

/* Tells whether nothing contradicts the modes as they are; what has no solution is none. */
static int are_consistent(cotree_events *e, cotree_real t, const cotree_real *w)
{
    cotree_real wanted;
    int k;
    if (try_choice(e, t, w) != 0 || look_further(e, t) != 0) {
        e->trouble = 0;
        return 0;
    }
    for (k = 0; k < e->n_modes; ++k) {
        if (cotree_is_open(e, k) && find_contradiction(e, k, t, &wanted) > COTREE_F(0.0)) return 0;
    }
    return 1;
}

/* Takes the set of modes that has a number, among all those that may be chosen. */
static void take_code(cotree_events *e, int code)
{
    cotree_real modes[MOST_MODES];
    int k;
    /* Stops come first, so that what they press together follows them, unless it is open itself. */
    for (k = e->n_modes - 1; k >= 0; --k) {
        int n;
        if (!cotree_is_chosen(e, k)) continue;
        n = list_choices(e, k, modes);
        if (cotree_is_open(e, k)) change_mode(e, k, modes[code % n]);
        code /= n;
    }
}

/* Tries all sets of modes in turn, where they are few. Returns whether nothing contradicts one. */
static int try_all_modes(cotree_events *e, cotree_real t, const cotree_real *w)
{
    cotree_real modes[MOST_MODES];
    int k, code, n_codes = 1;
    for (k = 0; k < e->n_modes && n_codes <= MOST_CODES; ++k) {
        if (cotree_is_chosen(e, k)) n_codes *= list_choices(e, k, modes);
    }
    for (code = 0; n_codes <= MOST_CODES && code < n_codes; ++code) {
        take_code(e, code);
        if (are_consistent(e, t, w)) return 1;
    }
    return 0;
}

/* Ends the run with the names of the edges, among some, whose modes are to be chosen. */
static int refuse_modes(cotree_events *e, cotree_real t, int from, int end, int status)
{
    int i, k, first = -1;
    for (i = 0; i < e->n_events; ++i) e->has_fired[i] = 0;
    for (k = from; k < end; ++k) {
        if (cotree_is_load(e, k)) continue;
        e->has_fired[PLACE(k, STOPS)] = e->is_idle[k];
        if (e->is_idle[k] && first < 0) first = k;
    }
    return cotree_fail(e, PLACE(first < 0 ? from : first, STOPS), t, status);
}

/* Ends the run where equations cannot be solved with the first modes of all. */
static int refuse_shared(cotree_events *e, cotree_real t)
{
    int k, n_idle = 0;
    for (k = 0; k < e->n_frictions; ++k) n_idle += e->is_idle[k];
    /* Edges that stick share their forces, and the loss of a gear depends on how. */
    if (e->complaint != COTREE_SINGULAR || n_idle == 0) return e->trouble;
    return refuse_modes(e, t, 0, e->n_frictions, COTREE_EVENTS_SHARED);
}

/* Ends the run where equations cannot be solved with the modes that it begins with. */
int cotree_refuse_start(cotree_events *e, cotree_real t, const cotree_real *w)
{
    int k;
    for (k = 0; k < e->n_frictions; ++k) e->is_idle[k] = w[PLACE(k, MODE)] == COTREE_F(0.0);
    return refuse_shared(e, t);
}

/* Whether any gear has losses, which depend on its load. */
static int has_losses(const cotree_events *e) { return e->n_frictions < cotree_first_stop(e); }

/* Lets all that sticks at the start slide; returns whether that is anything, and no losses depend
 * on it. */
int cotree_let_slide(cotree_events *e, cotree_real *w)
{
    int k, n = 0;
    if (has_losses(e)) return 0;
    for (k = 0; k < e->n_frictions; ++k) {
        if (w[PLACE(k, MODE)] != COTREE_F(0.0)) continue;
        w[PLACE(k, MODE)] = COTREE_F(1.0);
        ++n;
    }
    if (n > 0) e->trouble = 0;
    return n > 0;
}

/* Lets all idle stops hold, or all go. Returns whether any mode has changed. */
static int hold_stops(cotree_events *e, int is_held)
{
    int k, is_changed = 0;
    for (k = cotree_first_stop(e); k < e->n_modes; ++k) {
        const cotree_real mode = is_held ? e->closed[k - cotree_first_stop(e)] : COTREE_F(0.0);
        if (!e->is_idle[k] || e->modes[k] == mode) continue;
        change_mode(e, k, mode);
        is_changed = 1;
    }
    return is_changed;
}

/* Whether other sets of modes may do where the first has no solution: where all that hold the same
 * thing stick, or a force moves nothing as at a dead centre, others slide at their limits. The
 * losses of gears would depend on which. */
static int are_others_left(const cotree_events *e)
{
    int k, n_idle = 0;
    for (k = 0; k < e->n_frictions; ++k) n_idle += e->is_idle[k];
    return e->is_striking || (e->complaint == COTREE_SINGULAR && n_idle > 0 && !has_losses(e));
}

/* Whether forces of friction may be algebraic unknowns, which several edges that hold the same
 * thing would leave open; n edges are idle. */
static int may_be_open(const cotree_events *e, int n)
{
    return n > 1 && !e->is_striking && e->run->model->n_algebraic > 0 && !has_losses(e) &&
           e->n_pressed == 0;
}

/* Lets stick, one after the other, what the others that stick leave an acceleration; the rest is
 * held by these, and has the force of its limit. */
static int begin_apart(cotree_events *e, cotree_real t, const cotree_real *w)
{
    int k, round, status;
    for (k = 0; k < e->n_frictions; ++k) e->modes[k] = e->is_idle[k] ? COTREE_F(1.0) : e->modes[k];
    for (round = 0; round < e->n_frictions; ++round) {
        status = cotree_try_modes(e, t, w);
        if (status != 0) return status;
        for (k = 0; k < e->n_frictions; ++k) {
            const cotree_real rate = COTREE_FABS(e->jumps.rates[PLACE(k, STOPS)]);
            if (e->is_idle[k] && e->modes[k] != COTREE_F(0.0) &&
                rate > cotree_no_acceleration(e, k))
                break;
        }
        if (k == e->n_frictions) return 0;
        e->modes[k] = COTREE_F(0.0);
    }
    return 0;
}

/* Walks until nothing contradicts the modes of n edges. Returns FOUND then, NONE where the walk
 * ends without that, and why it cannot be begun. */
static int walk(cotree_events *e, cotree_real t, const cotree_real *w, int n)
{
    int round, is_begun = 0, is_lost = 0, changed = -1;
    cotree_real to = COTREE_F(0.0);
    e->n_tries = 0;
    if (may_be_open(e, n) && begin_apart(e, t, w) != 0) return e->trouble;
    for (round = 0; round <= COTREE_FRICTION_ROUNDS(n); ++round) {
        note_try(e);
        if (try_choice(e, t, w) != 0) {
            /* Forces that nothing tells apart: these modes are none, and others are tried. */
            if (changed >= 0)
                cotree_copy(e->n_modes, e->chosen, e->modes);
            else if (!hold_stops(e, 0))
                is_lost = 1;
            if (is_lost && !are_others_left(e)) return refuse_shared(e, t);
            e->trouble = 0;
            if (is_lost) return COTREE_EVENTS_NONE;
            changed = -1;
            continue;
        }
        if (!is_begun) begin_slack(e);
        is_begun = 1;
        if (look_further(e, t) != 0) return e->trouble;
        if (!find_change(e, t, &changed, &to)) return COTREE_EVENTS_FOUND;
        if (changed < 0 && !find_untried(e, &changed, &to)) break;
        cotree_copy(e->n_modes, e->modes, e->chosen);
        take_mode(e, changed, to);
    }
    return COTREE_EVENTS_NONE;
}

/* Chooses modes, from those that there are, until nothing contradicts. */
int cotree_choose(cotree_events *e, cotree_real t, const cotree_real *w)
{
    int k, status, n = 0;
    for (k = 0; k < e->n_modes; ++k) n += cotree_is_chosen(e, k);
    if (n == 0) return 0;
    status = walk(e, t, w, n);
    if (status == COTREE_EVENTS_FOUND || (status == COTREE_EVENTS_NONE && try_all_modes(e, t, w)))
        return 0;
    if (status != COTREE_EVENTS_NONE) return status;
    if (e->is_striking)
        return refuse_modes(e, t, cotree_first_stop(e), e->n_modes, COTREE_EVENTS_IMPACT);
    return refuse_modes(e, t, 0, e->n_modes, COTREE_EVENTS_MODES);
}

/* Refuses a choice of modes beside which there is another one, as friction allows that is strong
 * enough: a stop may then hold, or let go. */
static int check_only(cotree_events *e, cotree_real t, const cotree_real *w)
{
    int k;
    for (k = cotree_first_stop(e); k < e->n_modes; ++k) {
        const cotree_real mode = e->modes[k];
        if (!e->is_idle[k]) continue;
        cotree_copy(e->n_modes, e->modes, e->chosen);
        change_mode(e, k,
                    mode == COTREE_F(0.0) ? e->closed[k - cotree_first_stop(e)] : COTREE_F(0.0));
        if (are_consistent(e, t, w)) {
            const int is_free = mode != COTREE_F(0.0);
            const cotree_real part = is_free ? cotree_parting(e, k) : e->looked[PLACE(k, LIFTS)];
            const cotree_real least =
                is_free ? cotree_still(e, k) : ALMOST * e->largest[PLACE(k, LIFTS)];
            if (part > least) return cotree_fail(e, PLACE(k, RESTS), t, COTREE_EVENTS_SEVERAL);
        }
        cotree_copy(e->n_modes, e->chosen, e->modes);
    }
    return cotree_try_modes(e, t, w);
}

/* Chooses the modes of the idle edges and stops, and the signs of loads. */
int cotree_choose_modes(cotree_events *e, cotree_real t, const cotree_real *w)
{
    int status;
    /* As friction sticks at first, stops hold: what holds on keeps what rubs from slipping. */
    hold_stops(e, 1);
    status = cotree_choose(e, t, w);
    if (status == 0 && e->n_pressed > 0) status = cotree_bind_pressed(e, t);
    return status == 0 && e->n_pressed > 0 ? check_only(e, t, w) : status;
}
