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
#define FRACTION_NO_LIMIT COTREE_F(2.0)
#define CODE_MODULUS COTREE_SELECT(1125899906842597.0, 1048573.0f)

/* How many modes one edge may have. */
#define MAX_MODES 4

/* Writes the modes that an edge may have, and returns how many. */
static int list_allowed_modes(const cotree_events *e, int k, cotree_real *modes)
{
    int n = 0;
    if (cotree_is_load(e, k)) {
        modes[n++] = COTREE_F(1.0);
        modes[n++] = -COTREE_F(1.0);
    } else if (k >= cotree_first_stop(e)) {
        modes[n++] = COTREE_F(0.0);
        modes[n++] = e->closed_side[k - cotree_first_stop(e)];
    } else {
        if (cotree_is_contact_friction(e, k)) modes[n++] = COTREE_F(2.0);
        modes[n++] = COTREE_F(0.0);
        modes[n++] = COTREE_F(1.0);
        if (PLACE(k, BACKWARD_LIMIT) >= 0) modes[n++] = -COTREE_F(1.0);
    }
    return n;
}

/* How far an edge is off what its mode asks for, as a share; and the mode that it wants. */
static cotree_real find_violation(cotree_events *e, int k, cotree_real t, cotree_real *new_mode)
{
    *new_mode = -e->modes[k];
    if (e->is_impact)
        return cotree_is_contact_friction(e, k) ? cotree_tangential_violation(e, k, new_mode)
                                                : cotree_normal_violation(e, k, new_mode);
    if (k >= cotree_first_stop(e)) return cotree_stop_violation(e, k, t, new_mode);
    if (cotree_is_load(e, k)) return cotree_load_violation(e, k, t);
    return cotree_is_contact_friction(e, k) ? cotree_contact_friction_violation(e, k, t, new_mode)
                                            : cotree_friction_violation(e, k, t, new_mode);
}

/* Which limit an edge has its force at in a mode: its event; -1: at none. */
static int limit_event(const cotree_events *e, int k, cotree_real mode)
{
    if (cotree_is_load(e, k)) return -1;
    if (k >= cotree_first_stop(e)) return mode == COTREE_F(0.0) ? PLACE(k, CONTACT_FORCE) : -1;
    return mode == COTREE_F(1.0)    ? PLACE(k, FORWARD_LIMIT)
           : mode == -COTREE_F(1.0) ? PLACE(k, BACKWARD_LIMIT)
                                    : -1;
}

/* Whether the distances of an edge to its limits move with the forces of a trial. */
static int has_moving_slack(const cotree_events *e, int k)
{
    if (!cotree_may_change(e, k) || cotree_is_load(e, k)) return 0;
    if (k >= cotree_first_stop(e)) return e->modes[k] != COTREE_F(0.0);
    return e->modes[k] == COTREE_F(0.0) || cotree_is_contact_friction(e, k);
}

/* Lets the way begin: with friction halfway between its limits, and without forces of stops. */
static void init_slack(cotree_events *e)
{
    int k;
    for (k = 0; k < e->n_modes; ++k) {
        cotree_real up, width;
        SLACK(k, 0) = SLACK(k, 1) = COTREE_F(0.0);
        if (k >= e->n_frictions || cotree_is_contact_friction(e, k)) continue;
        up = e->samples[PLACE(k, FORWARD_LIMIT)];
        width = PLACE(k, BACKWARD_LIMIT) < 0
                    ? COTREE_F(2.0) * COTREE_FABS(up)
                    : COTREE_FABS(up + e->samples[PLACE(k, BACKWARD_LIMIT)]);
        SLACK(k, 0) = SLACK(k, 1) = COTREE_F(0.5) * width;
    }
}

/* Which share of the way to the last trial an edge goes until it takes the mode that it wants. */
static cotree_real fraction_to_limit(const cotree_events *e, int k, cotree_real new_mode)
{
    const int limit = limit_event(e, k, new_mode);
    cotree_real left, g;
    if (cotree_is_load(e, k)) return COTREE_F(0.0);
    if (limit < 0) return FRACTION_NO_LIMIT;
    left = SLACK(k, new_mode < COTREE_F(0.0));
    g = e->samples[limit];
    return g < COTREE_F(0.0) ? left / (left - g) : COTREE_F(1.0);
}

/* Goes a share of the way to the last trial. */
static void partial_step(cotree_events *e, cotree_real share)
{
    int k, side;
    for (k = 0; k < e->n_modes; ++k) {
        const int is_stop = k >= cotree_first_stop(e);
        if (!has_moving_slack(e, k)) continue;
        for (side = 0; side < 2; ++side) {
            const cotree_real way = side ? -COTREE_F(1.0) : COTREE_F(1.0);
            const int limit = limit_event(e, k, is_stop ? COTREE_F(0.0) : way);
            const cotree_real left = SLACK(k, side);
            if (limit < 0 || (is_stop && side) || (!is_stop && e->modes[k] == way)) continue;
            SLACK(k, side) =
                COTREE_FMAX(left + COTREE_FMIN(share, COTREE_F(1.0)) * (e->samples[limit] - left),
                            COTREE_F(0.0));
        }
    }
}

/* The mode of one edge once another one has its new one: a stop takes along what it presses
 * together, which begins without a force. */
static cotree_real mode_after_change(const cotree_events *e, int i, int k, cotree_real mode)
{
    if (i == k) return mode;
    if (!cotree_is_contact_friction(e, i) || e->normal_stop[i] != k) return e->modes[i];
    return mode == COTREE_F(0.0) ? COTREE_F(2.0) : e->slip_sign[i];
}

/* Gives an edge another mode. */
static void change_mode(cotree_events *e, int k, cotree_real mode)
{
    int i;
    for (i = 0; i < e->n_modes; ++i) e->modes[i] = mode_after_change(e, i, k, mode);
}

/* Gives an edge its mode at the end of the way. */
static void set_mode(cotree_events *e, int k, cotree_real mode)
{
    int i;
    if (limit_event(e, k, mode) >= 0) SLACK(k, mode < COTREE_F(0.0)) = COTREE_F(0.0);
    for (i = 0; i < e->n_contact_friction; ++i) {
        const int own = e->contact_friction[i];
        if (e->normal_stop[own] == k) SLACK(own, 0) = SLACK(own, 1) = COTREE_F(0.0);
    }
    change_mode(e, k, mode);
}

/* A number that tells modes apart, with another one in the place of one of them. */
static cotree_real mode_code(const cotree_events *e, int other, cotree_real mode)
{
    cotree_real number = COTREE_F(0.0);
    int k;
    for (k = 0; k < e->n_modes; ++k) {
        const cotree_real own = other < 0 ? e->modes[k] : mode_after_change(e, k, other, mode);
        number = COTREE_FMOD(COTREE_F(4.0) * number + own + COTREE_F(1.0), CODE_MODULUS);
    }
    return number;
}

/* Notes the modes that are tried now. */
static void record_trial(cotree_events *e)
{
    e->tried_codes[e->n_tried % N_TRIED_CODES] = mode_code(e, -1, COTREE_F(0.0));
    if (++e->n_tried >= 2 * N_TRIED_CODES) e->n_tried -= N_TRIED_CODES;
}

/* Whether modes were tried before, with another one in the place of one of them. */
static int is_tried(const cotree_events *e, int k, cotree_real mode)
{
    const cotree_real number = mode_code(e, k, mode);
    int i;
    for (i = 0; i < e->n_tried && i < N_TRIED_CODES; ++i) {
        if (e->tried_codes[i] == number) return 1;
    }
    return 0;
}

/* Finds a mode of an edge that was not tried beside those of the others. */
static int find_untried_mode(const cotree_events *e, int k, cotree_real *mode)
{
    cotree_real modes[MAX_MODES];
    int i, n = list_allowed_modes(e, k, modes);
    for (i = 0; i < n; ++i) {
        if (is_tried(e, k, modes[i])) continue;
        *mode = modes[i];
        return 1;
    }
    return 0;
}

/* Finds an edge that does not contradict, but leads to modes that were not tried. */
static int find_untried_edge(const cotree_events *e, int *changed, cotree_real *to)
{
    int k;
    for (k = 0; k < e->n_modes; ++k) {
        if (!cotree_may_change(e, k) || !find_untried_mode(e, k, to)) continue;
        *changed = k;
        return 1;
    }
    return 0;
}

/* Finds what the forces of idle edges are uncertain by: each follows from those of the others, and
 * has their rounding even where it is zero itself. */
static void compute_force_noise(cotree_events *e)
{
    cotree_real largest = COTREE_F(0.0);
    int k, what;
    for (k = 0; k < e->n_frictions; ++k) {
        for (what = FORWARD_LIMIT; what <= BACKWARD_LIMIT && e->is_active[k]; ++what) {
            if (PLACE(k, what) >= 0)
                largest = COTREE_FMAX(largest, COTREE_FABS(e->samples[PLACE(k, what)]));
        }
    }
    e->force_noise = COTREE_SCAN_ROUNDING * largest;
}

/* Evaluates forces and accelerations, or impulses and speeds, with the modes as they are. */
static int evaluate_modes(cotree_events *e, cotree_real t, const cotree_real *w)
{
    return e->is_impact ? cotree_evaluate_impact(e, t, w) : cotree_evaluate_motion(e, t, w);
}

/* Finds what contradictions are found by besides these. */
static int evaluate_trial(cotree_events *e, cotree_real t)
{
    if (e->is_impact) return 0;
    compute_force_noise(e);
    return cotree_compute_later_accelerations(e, t);
}

/* Finds what contradicts the modes as they are tried, and which mode changes first. Returns whether
 * anything contradicts; changed is -1 where all that could change leads back. */
static int find_pivot(cotree_events *e, cotree_real t, int *changed, cotree_real *to)
{
    cotree_real first = COTREE_F(0.0), most = COTREE_F(0.0);
    int k, is_wrong = 0;
    *changed = -1;
    for (k = 0; k < e->n_modes; ++k) {
        cotree_real new_mode, off, share;
        if (!cotree_may_change(e, k)) continue;
        off = find_violation(e, k, t, &new_mode);
        if (!(off > COTREE_F(0.0))) continue;
        is_wrong = 1;
        share = fraction_to_limit(e, k, new_mode);
        if (is_tried(e, k, new_mode)) {
            /* Limits that depend on forces may lead in a circle: another mode is left. */
            share = FRACTION_NO_LIMIT + COTREE_F(1.0);
            if (!find_untried_mode(e, k, &new_mode)) continue;
        }
        if (*changed >= 0 && (share > first || (share == first && off <= most))) continue;
        *changed = k;
        *to = new_mode;
        first = share;
        most = off;
    }
    if (*changed >= 0) partial_step(e, first);
    return is_wrong;
}

/* Tells whether nothing contradicts the modes as they are; what has no solution is none. */
static int are_consistent(cotree_events *e, cotree_real t, const cotree_real *w)
{
    cotree_real new_mode;
    int k;
    if (evaluate_modes(e, t, w) != 0 || evaluate_trial(e, t) != 0) {
        e->failure = 0;
        return 0;
    }
    for (k = 0; k < e->n_modes; ++k) {
        if (cotree_may_change(e, k) && find_violation(e, k, t, &new_mode) > COTREE_F(0.0)) return 0;
    }
    return 1;
}

/* Takes the set of modes that has a number, among all those that may be chosen. */
static void decode_modes(cotree_events *e, int code)
{
    cotree_real modes[MAX_MODES];
    int k;
    /* Stops come first, so that what they press together follows them, unless it is open itself. */
    for (k = e->n_modes - 1; k >= 0; --k) {
        int n;
        if (!cotree_is_variable(e, k)) continue;
        n = list_allowed_modes(e, k, modes);
        if (cotree_may_change(e, k)) change_mode(e, k, modes[code % n]);
        code /= n;
    }
}

/* Tries all sets of modes in turn, where they are few. Returns whether nothing contradicts one. */
static int enumerate_modes(cotree_events *e, cotree_real t, const cotree_real *w)
{
    cotree_real modes[MAX_MODES];
    int k, code, n_codes = 1;
    for (k = 0; k < e->n_modes && n_codes <= MAX_ENUMERATED; ++k) {
        if (cotree_is_variable(e, k)) n_codes *= list_allowed_modes(e, k, modes);
    }
    for (code = 0; n_codes <= MAX_ENUMERATED && code < n_codes; ++code) {
        decode_modes(e, code);
        if (are_consistent(e, t, w)) return 1;
    }
    return 0;
}

/* Ends the run with the names of the edges, among some, whose modes are to be chosen. */
static int fail_modes(cotree_events *e, cotree_real t, int from, int end, int status)
{
    int i, k, first = -1;
    for (i = 0; i < e->n_events; ++i) e->has_fired[i] = 0;
    for (k = from; k < end; ++k) {
        if (cotree_is_load(e, k)) continue;
        e->has_fired[PLACE(k, SLIP)] = e->is_active[k];
        if (e->is_active[k] && first < 0) first = k;
    }
    return cotree_fail(e, PLACE(first < 0 ? from : first, SLIP), t, status);
}

/* Ends the run where equations cannot be solved with the first modes of all. */
static int fail_indeterminate(cotree_events *e, cotree_real t)
{
    int k, n_idle = 0;
    for (k = 0; k < e->n_frictions; ++k) n_idle += e->is_active[k];
    /* Edges that stick share their forces, and the loss of a gear depends on how. */
    if (e->kernel_status != COTREE_SINGULAR || n_idle == 0) return e->failure;
    return fail_modes(e, t, 0, e->n_frictions, COTREE_EVENTS_SHARED);
}

/* Ends the run where equations cannot be solved with the modes that it begins with. */
int cotree_fail_start(cotree_events *e, cotree_real t, const cotree_real *w)
{
    int k;
    for (k = 0; k < e->n_frictions; ++k) e->is_active[k] = w[PLACE(k, MODE_STATE)] == COTREE_F(0.0);
    return fail_indeterminate(e, t);
}

/* Whether any gear has losses, which depend on its load. */
static int has_losses(const cotree_events *e) { return e->n_frictions < cotree_first_stop(e); }

/* Lets all that sticks at the start slide; returns whether that is anything, and no losses depend
 * on it. */
int cotree_release_sticking(cotree_events *e, cotree_real *w)
{
    int k, n = 0;
    if (has_losses(e)) return 0;
    for (k = 0; k < e->n_frictions; ++k) {
        if (w[PLACE(k, MODE_STATE)] != COTREE_F(0.0)) continue;
        w[PLACE(k, MODE_STATE)] = COTREE_F(1.0);
        ++n;
    }
    if (n > 0) e->failure = 0;
    return n > 0;
}

/* Lets all idle stops hold, or all go. Returns whether any mode has changed. */
static int close_stops(cotree_events *e, int is_held)
{
    int k, is_changed = 0;
    for (k = cotree_first_stop(e); k < e->n_modes; ++k) {
        const cotree_real mode = is_held ? e->closed_side[k - cotree_first_stop(e)] : COTREE_F(0.0);
        if (!e->is_active[k] || e->modes[k] == mode) continue;
        change_mode(e, k, mode);
        is_changed = 1;
    }
    return is_changed;
}

/* Whether other sets of modes may do where the first has no solution: where all that hold the same
 * thing stick, or a force moves nothing as at a dead centre, others slide at their limits. The
 * losses of gears would depend on which. */
static int may_have_other_modes(const cotree_events *e)
{
    int k, n_idle = 0;
    for (k = 0; k < e->n_frictions; ++k) n_idle += e->is_active[k];
    return e->is_impact || (e->kernel_status == COTREE_SINGULAR && n_idle > 0 && !has_losses(e));
}

/* Whether forces of friction may be algebraic unknowns, which several edges that hold the same
 * thing would leave open; n edges are idle. */
static int may_be_indeterminate(const cotree_events *e, int n)
{
    return n > 1 && !e->is_impact && e->run->model->n_algebraic > 0 && !has_losses(e) &&
           e->n_contact_friction == 0;
}

/* Lets stick, one after the other, what the others that stick leave an acceleration; the rest is
 * held by these, and has the force of its limit. */
static int init_sequentially(cotree_events *e, cotree_real t, const cotree_real *w)
{
    int k, round, status;
    for (k = 0; k < e->n_frictions; ++k)
        e->modes[k] = e->is_active[k] ? COTREE_F(1.0) : e->modes[k];
    for (round = 0; round < e->n_frictions; ++round) {
        status = cotree_evaluate_motion(e, t, w);
        if (status != 0) return status;
        for (k = 0; k < e->n_frictions; ++k) {
            const cotree_real rate = COTREE_FABS(e->jumps.rates[PLACE(k, SLIP)]);
            if (e->is_active[k] && e->modes[k] != COTREE_F(0.0) &&
                rate > cotree_slip_rest_tolerance(e, k))
                break;
        }
        if (k == e->n_frictions) return 0;
        e->modes[k] = COTREE_F(0.0);
    }
    return 0;
}

/* Walks until nothing contradicts the modes of n edges. Returns FOUND then, NONE where the walk
 * ends without that, and why it cannot be begun. */
static int solve_complementarity(cotree_events *e, cotree_real t, const cotree_real *w, int n)
{
    int round, is_begun = 0, is_lost = 0, changed = -1;
    cotree_real to = COTREE_F(0.0);
    e->n_tried = 0;
    if (may_be_indeterminate(e, n) && init_sequentially(e, t, w) != 0) return e->failure;
    for (round = 0; round <= COTREE_FRICTION_ROUNDS(n); ++round) {
        record_trial(e);
        if (evaluate_modes(e, t, w) != 0) {
            /* Forces that nothing tells apart: these modes are none, and others are tried. */
            if (changed >= 0)
                cotree_copy(e->n_modes, e->saved_modes, e->modes);
            else if (!close_stops(e, 0))
                is_lost = 1;
            if (is_lost && !may_have_other_modes(e)) return fail_indeterminate(e, t);
            e->failure = 0;
            if (is_lost) return COTREE_EVENTS_NONE;
            changed = -1;
            continue;
        }
        if (!is_begun) init_slack(e);
        is_begun = 1;
        if (evaluate_trial(e, t) != 0) return e->failure;
        if (!find_pivot(e, t, &changed, &to)) return COTREE_EVENTS_FOUND;
        if (changed < 0 && !find_untried_edge(e, &changed, &to)) break;
        cotree_copy(e->n_modes, e->modes, e->saved_modes);
        set_mode(e, changed, to);
    }
    return COTREE_EVENTS_NONE;
}

/* Chooses modes, from those that there are, until nothing contradicts. */
int cotree_solve_modes(cotree_events *e, cotree_real t, const cotree_real *w)
{
    int k, status, n = 0;
    for (k = 0; k < e->n_modes; ++k) n += cotree_is_variable(e, k);
    if (n == 0) return 0;
    status = solve_complementarity(e, t, w, n);
    if (status == COTREE_EVENTS_FOUND || (status == COTREE_EVENTS_NONE && enumerate_modes(e, t, w)))
        return 0;
    if (status != COTREE_EVENTS_NONE) return status;
    if (e->is_impact)
        return fail_modes(e, t, cotree_first_stop(e), e->n_modes, COTREE_EVENTS_IMPACT);
    return fail_modes(e, t, 0, e->n_modes, COTREE_EVENTS_MODES);
}

/* Refuses a choice of modes beside which there is another one, as friction allows that is strong
 * enough: a stop may then hold, or let go. */
static int check_unique(cotree_events *e, cotree_real t, const cotree_real *w)
{
    int k;
    for (k = cotree_first_stop(e); k < e->n_modes; ++k) {
        const cotree_real mode = e->modes[k];
        if (!e->is_active[k]) continue;
        cotree_copy(e->n_modes, e->modes, e->saved_modes);
        change_mode(
            e, k, mode == COTREE_F(0.0) ? e->closed_side[k - cotree_first_stop(e)] : COTREE_F(0.0));
        if (are_consistent(e, t, w)) {
            const int is_free = mode != COTREE_F(0.0);
            const cotree_real part = is_free ? cotree_separation_acceleration(e, k)
                                             : e->samples[PLACE(k, CONTACT_FORCE)];
            const cotree_real least = is_free
                                          ? cotree_rest_tolerance(e, k)
                                          : LIMIT_RTOL * e->value_scale[PLACE(k, CONTACT_FORCE)];
            if (part > least) return cotree_fail(e, PLACE(k, REBOUND), t, COTREE_EVENTS_SEVERAL);
        }
        cotree_copy(e->n_modes, e->saved_modes, e->modes);
    }
    return cotree_evaluate_motion(e, t, w);
}

/* Chooses the modes of the idle edges and stops, and the signs of loads. */
int cotree_select_modes(cotree_events *e, cotree_real t, const cotree_real *w)
{
    int status;
    /* As friction sticks at first, stops hold: what holds on keeps what rubs from slipping. */
    close_stops(e, 1);
    status = cotree_solve_modes(e, t, w);
    if (status == 0 && e->n_contact_friction > 0) status = cotree_stick_unloaded_contacts(e, t);
    return status == 0 && e->n_contact_friction > 0 ? check_unique(e, t, w) : status;
}
