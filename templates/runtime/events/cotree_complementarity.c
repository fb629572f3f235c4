/* cotree_complementarity.c: selection of the modes of all unilateral constraints.
 *
 * The modes of dry friction, of rigid stops and of contacts, and the signs of loads, solve one
 * complementarity problem (F. Pfeiffer, C. Glocker, Multibody Dynamics with Unilateral Contacts,
 * 1996). A friction element that sticks and a stop that is closed have a force within limits. If
 * friction slides, its force is at one of two limits; if a stop is open, its force is at its only
 * limit, zero.
 *
 * The same walk solves for forces and accelerations while modes hold and, in an impact, for
 * impulses and speeds. Only the tolerances differ, and the decision at zero acceleration.
 *
 * A trial evaluates the forces and accelerations for one mode set. The forces move from their
 * current values towards those of the trial until the first one reaches a limit: that constraint
 * slides, or opens. If no force reaches a limit, a constraint whose acceleration violates its mode
 * sticks, or closes. Only the slacks, the distances to the limits, are stored. If the limits are
 * constant, each pivot decreases a convex quadratic function (primal active-set method: J. Nocedal,
 * S. J. Wright, Numerical Optimization, 2006, section 16.5).
 *
 * If the limits depend on forces, as in contacts with friction and gears with losses, no such
 * function exists, and the problem may have no solution or several. Therefore no mode set is tried
 * twice; if pivoting fails, all mode sets of a small problem are enumerated. */
#include "cotree_events_internal.h"

#include <float.h>
#include <math.h>
#include <stddef.h>

#if COTREE_HAS_MODES
/* Slacks of a force: its distances to the forward and the backward limit. A stop has only the
 * first. */
#define SLACK(k, is_backward) (e->slack[2 * (k) + (is_backward)])

/* Step fraction of a constraint that reaches no limit: above 1, so that other constraints change
 * first. */
#define FRACTION_NO_LIMIT COTREE_F(2.0)

/* Modulus of the codes of mode sets: a prime; cotree_real represents four times its value
 * exactly. */
#define CODE_MODULUS COTREE_SELECT(1125899906842597.0, 1048573.0f)

/* Maximum number of modes of one constraint. */
#define MAX_MODES 3

/* Smallest scale of a force, as a fraction of the largest force: its rounding is then below
 * LIMIT_RTOL. */
#define MIN_FORCE_SHARE (ZERO_ROUNDINGS * COTREE_SCAN_ROUNDING / LIMIT_RTOL)

/* List the modes that a constraint may have. Return their number. */
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
        modes[n++] = COTREE_F(0.0);
        modes[n++] = COTREE_F(1.0);
        if (PLACE(k, BACKWARD_LIMIT) >= 0) modes[n++] = -COTREE_F(1.0);
    }
    return n;
}

/* Return whether a constraint holds: friction sticks, or a stop is closed. */
static int is_holding(const cotree_events *e, int k)
{
    return (e->modes[k] != COTREE_F(0.0)) == (k >= cotree_first_stop(e));
}

/* Return the event that represents the limit of the force in the given mode, or -1. */
static int limit_event(const cotree_events *e, int k, cotree_real mode)
{
    if (cotree_is_load(e, k)) return -1;
    if (k >= cotree_first_stop(e)) return mode == COTREE_F(0.0) ? PLACE(k, CONTACT_FORCE) : -1;
    return mode == COTREE_F(1.0)    ? PLACE(k, FORWARD_LIMIT)
           : mode == -COTREE_F(1.0) ? PLACE(k, BACKWARD_LIMIT)
                                    : -1;
}

/* Return the magnitude of the largest force, or impulse, of a stop. */
cotree_real cotree_largest_stop_force(const cotree_events *e)
{
    const cotree_real *const values = e->is_impact ? e->samples : e->value_scale;
    cotree_real largest = COTREE_F(0.0);
    int i;
    for (i = 0; i < e->n_stops; ++i)
        largest = COTREE_FMAX(largest, COTREE_FABS(values[e->force_events[i]]));
    return largest;
}

/* Return the distance of a force from one of its limits. size: the width of the limits, or the
 * magnitude of a force that has only one. */
static cotree_real distance_to_limit(const cotree_events *e, int k, int limit, cotree_real *size)
{
    const int backward = PLACE(k, BACKWARD_LIMIT);
    const cotree_real up = e->samples[limit];
    if (k >= cotree_first_stop(e)) {
        const cotree_real largest = cotree_largest_stop_force(e);
        *size =
            e->is_impact ? largest : COTREE_FMAX(e->value_scale[limit], MIN_FORCE_SHARE * largest);
        return up;
    }
#if COTREE_HAS_DISCS
    if (e->is_impact && cotree_is_disc(e, k)) {
        cotree_real impulse[2];
        cotree_friction_impulse(e, k, impulse);
        *size = COTREE_SQRT(impulse[0] * impulse[0] + impulse[1] * impulse[1]);
        return up - *size;
    }
#endif
    *size = backward < 0 ? COTREE_FMAX(COTREE_FABS(up), e->value_scale[limit])
                         : COTREE_FABS(e->samples[PLACE(k, FORWARD_LIMIT)] + e->samples[backward]);
    return up;
}

/* Return the relative amount by which the force of a holding constraint exceeds one of its
 * limits. */
static cotree_real find_excess(const cotree_events *e, int k, cotree_real t, int limit)
{
    cotree_real size, g = distance_to_limit(e, k, limit, &size), excess;
    excess = -g / COTREE_FMAX(size, COTREE_MIN);
    if (e->is_impact) return excess > IMPULSE_RTOL ? excess : COTREE_F(0.0);
    if (cotree_moving_side(e, limit, t, size) >= COTREE_F(0.0)) return COTREE_F(0.0);
    if (g < -COTREE_FMAX(LIMIT_RTOL * size, e->force_noise)) return excess;
    return k < e->n_frictions && e->is_resticking[k] ? COTREE_F(0.0) : COTREE_EPSILON;
}

/* Return the slip rate after an impact in the direction in which friction slides. */
static cotree_real slip_along(const cotree_events *e, int k)
{
    cotree_real slip[2];
    cotree_find_slip(e, k, slip);
#if COTREE_HAS_DISCS
    if (cotree_is_disc(e, k)) {
        const cotree_real *const along = e->directions + 2 * e->disc[k];
        return slip[0] * along[0] + slip[1] * along[1];
    }
#endif
    return e->modes[k] * slip[0];
}

/* Return the acceleration of a gap or slip, and the magnitude below which it counts as zero. */
static cotree_real acceleration_of(const cotree_events *e, int k)
{
    return k >= cotree_first_stop(e) ? cotree_separation_acceleration(e, k)
                                     : e->jumps.rates[PLACE(k, SLIP)];
}

static cotree_real zero_acceleration(const cotree_events *e, int k)
{
    return k >= cotree_first_stop(e) ? cotree_rest_tolerance(e, k)
                                     : cotree_slip_rest_tolerance(e, k);
}

/* Evaluate the rates of change of accelerations if one of them is zero although its constraint does
 * not hold. */
static int compute_later_accelerations(cotree_events *e, cotree_real t)
{
    int k, is_needed = 0;
    for (k = 0; k < e->n_modes; ++k) {
        if (cotree_is_load(e, k) || !e->is_active[k] || is_holding(e, k)) continue;
        is_needed = is_needed || COTREE_FABS(acceleration_of(e, k)) <= zero_acceleration(e, k);
    }
    if (!is_needed) return 0;
    if (cotree_compute_curvature(e, t, e->trial) != 0) return e->failure;
    for (k = cotree_first_stop(e); k < e->n_modes; ++k)
        e->later_acceleration[k - cotree_first_stop(e)] = acceleration_of(e, k);
    return cotree_compute_rates(e, t, e->trial);
}

/* Return the relative amount by which a constraint that does not hold moves against its mode: the
 * acceleration of a gap or slip or, in an impact, the speed after it beyond the required one. At
 * zero acceleration its rate of change is decisive. */
static cotree_real find_reversal(cotree_events *e, int k)
{
    const int is_stop = k >= cotree_first_stop(e), own = k - cotree_first_stop(e);
    cotree_real none = ACCELERATION_RTOL * e->impact_speed, rate, jerk, largest;
    if (e->is_impact) {
        rate = is_stop ? cotree_opening_speed(e, k) : slip_along(e, k);
        if (is_stop) none = COTREE_FMAX(none, cotree_zero_opening_speed(e, k));
        /* The gap rate must reach the rate that restitution requires. */
        if (is_stop && e->impact_role[own] > 0) rate -= e->required_speed[own];
        return rate < -none ? -rate / COTREE_FMAX(e->impact_speed, COTREE_MIN) : COTREE_F(0.0);
    }
    rate = acceleration_of(e, k);
    e->acceleration_scale[k] = COTREE_FMAX(e->acceleration_scale[k], COTREE_FABS(rate));
    none = zero_acceleration(e, k);
    if (rate < -none) return -rate / e->acceleration_scale[k];
    if (rate > none) return COTREE_F(0.0);
    largest = cotree_largest_acceleration_scale(e);
    jerk = is_stop ? (e->later_acceleration[own] - rate) / (CURVATURE_STEP_SHARE * e->span)
                   : e->curvature[PLACE(k, SLIP)];
    if (!is_stop) largest = COTREE_FMAX(largest, e->largest_rate);
    return jerk * e->span < -JERK_SHARE * largest ? COTREE_EPSILON : COTREE_F(0.0);
}

/* Return whether the normal force or impulse of a contact is tensile. */
static int is_tensile(const cotree_events *e, int stop, cotree_real t)
{
    const int force = PLACE(stop, CONTACT_FORCE);
    return (e->is_impact ? e->samples[force] : cotree_moving_side(e, force, t, COTREE_F(0.0))) <
           COTREE_F(0.0);
}

/* Return the relative amount by which a constraint violates its current mode, and the mode that
 * removes the violation. */
static cotree_real find_violation(cotree_events *e, int k, cotree_real t, cotree_real *new_mode)
{
    const int is_stop = k >= cotree_first_stop(e);
    cotree_real modes[MAX_MODES], excess;
    int i, n;
    *new_mode = -e->modes[k];
    if (cotree_is_load(e, k)) {
        i = PLACE(k, SLIP);
        return cotree_moving_side(e, i, t, e->value_scale[i]) < COTREE_F(0.0) ? COTREE_F(1.0)
                                                                              : COTREE_F(0.0);
    }
    if (cotree_is_contact_friction(e, k)) {
        if (!e->is_impact)
            e->acceleration_scale[k] =
                COTREE_FMAX(e->acceleration_scale[k], cotree_largest_acceleration_scale(e));
        if (is_tensile(e, e->normal_stop[k], t)) {
            /* A sticking contact slides before its stop opens. */
            *new_mode = cotree_is_disc(e, k) || e->samples[PLACE(k, FORWARD_LIMIT)] <
                                                    e->samples[PLACE(k, BACKWARD_LIMIT)]
                            ? COTREE_F(1.0)
                            : -COTREE_F(1.0);
            return is_holding(e, k) ? COTREE_F(1.0) : COTREE_F(0.0);
        }
    }
    if (!is_holding(e, k)) {
        *new_mode = is_stop ? e->closed_side[k - cotree_first_stop(e)] : COTREE_F(0.0);
        return find_reversal(e, k);
    }
    /* In an impact, an unresolved gap opens, and closes again, at a speed below rounding. */
    if (is_stop && (cotree_has_sticking_contact(e, k) ||
                    (e->is_impact && cotree_closed_gap(e, k) == e->unresolved_gap)))
        return COTREE_F(0.0);
    n = list_allowed_modes(e, k, modes);
    for (i = 0; i < n; ++i) {
        *new_mode = modes[i];
        if (limit_event(e, k, modes[i]) < 0) continue;
        excess = find_excess(e, k, t, limit_event(e, k, modes[i]));
        if (excess > COTREE_F(0.0)) return excess;
    }
    return COTREE_F(0.0);
}

/* Return whether the slacks of a constraint change with the forces. */
static int has_moving_slack(const cotree_events *e, int k)
{
    if (!cotree_may_change(e, k) || cotree_is_load(e, k)) return 0;
    return is_holding(e, k) || cotree_is_contact_friction(e, k);
}

/* Initialise the slacks: friction forces are midway between their limits, and forces of stops are
 * zero. */
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

/* Return the fraction of the step to the trial forces at which a constraint changes its mode. */
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

/* Move the forces by a fraction of the step to the trial forces. */
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

/* Return the mode of constraint i after constraint k has changed. The friction at a contact changes
 * with its stop. */
static cotree_real mode_after_change(const cotree_events *e, int i, int k, cotree_real mode)
{
    if (i == k) return mode;
    if (!cotree_is_contact_friction(e, i) || e->normal_stop[i] != k) return e->modes[i];
    return mode == COTREE_F(0.0) ? COTREE_F(2.0) : e->slip_sign[i];
}

/* Set a mode of the trial and, for a stop, the modes of the friction at its contact. */
static void change_mode(cotree_events *e, int k, cotree_real mode)
{
    int i;
    for (i = 0; i < e->n_modes; ++i) e->modes[i] = mode_after_change(e, i, k, mode);
}

/* Set the new mode of a constraint that has reached its limit, and reset its slack. */
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

/* Return a code that identifies the current mode set. If `other` is not -1, its mode is
 * replaced. */
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

/* Store the code of the current mode set. */
static void record_trial(cotree_events *e)
{
    e->tried_codes[e->n_tried % N_TRIED_CODES] = mode_code(e, -1, COTREE_F(0.0));
    if (++e->n_tried >= 2 * N_TRIED_CODES) e->n_tried -= N_TRIED_CODES;
}

/* Return whether the mode set with one mode replaced was tried before. */
static int is_tried(const cotree_events *e, int k, cotree_real mode)
{
    const cotree_real number = mode_code(e, k, mode);
    int i;
    for (i = 0; i < e->n_tried && i < N_TRIED_CODES; ++i) {
        if (e->tried_codes[i] == number) return 1;
    }
    return 0;
}

/* Find a mode of a constraint that was not tried together with the current modes of the others. */
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

/* Find a consistent constraint whose change of mode leads to an untried mode set. */
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

/* Compute the rounding error of the active constraints' forces. It is the rounding error of the
 * largest force, since the forces are coupled. */
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

/* Evaluate the trial: forces and accelerations or, in an impact, impulses and speeds. */
static int evaluate_modes(cotree_events *e, cotree_real t, const cotree_real *w)
{
#if COTREE_HAS_DISCS
    int round, status, is_turned = 1;
    for (round = 0; is_turned; ++round) {
        status = e->is_impact ? cotree_evaluate_impact(e, t, w) : cotree_evaluate_motion(e, t, w);
        is_turned = status == 0 && cotree_turn_discs(e, round);
    }
    return status;
#else
    return e->is_impact ? cotree_evaluate_impact(e, t, w) : cotree_evaluate_motion(e, t, w);
#endif
}

/* Evaluate the second-order conditions of the consistency test. */
static int evaluate_trial(cotree_events *e, cotree_real t)
{
    if (e->is_impact) return 0;
    compute_force_noise(e);
    return compute_later_accelerations(e, t);
}

/* Find the constraint whose mode changes first (*changed = -1 if only mode sets that were tried
 * follow), and take the step to its limit. Return whether any constraint is violated. */
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
            /* Limits that depend on forces can cause cycling: use an untried mode. */
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

/* Return whether the trial can be solved and its solution is consistent with its modes. */
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

/* Set the modes to the combination with the given number. */
static void decode_modes(cotree_events *e, int code)
{
    cotree_real modes[MAX_MODES];
    int k;
    /* Set the modes of stops, which come last, before those of the friction at their contacts. */
    for (k = e->n_modes - 1; k >= 0; --k) {
        int n;
        if (!cotree_is_variable(e, k)) continue;
        n = list_allowed_modes(e, k, modes);
        if (cotree_may_change(e, k)) change_mode(e, k, modes[code % n]);
        code /= n;
    }
}

/* Enumerate all mode sets if there are few. Return whether one is consistent. */
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

/* Set a failure, and mark the active constraints in a range as its cause. */
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

/* Set the failure for equations that are singular in the first trial of the mode selection. */
static int fail_indeterminate(cotree_events *e, cotree_real t)
{
    int k, n_idle = 0;
    for (k = 0; k < e->n_frictions; ++k) n_idle += e->is_active[k];
    /* The loss of a gear depends on forces that are shared by several sticking constraints. */
    if (e->kernel_status != COTREE_SINGULAR || n_idle == 0) return e->failure;
    return fail_modes(e, t, 0, e->n_frictions, COTREE_EVENTS_INDETERMINATE);
}

/* Set the failure for equations that are singular with the modes at the start. */
int cotree_fail_start(cotree_events *e, cotree_real t, const cotree_real *w)
{
    int k;
    for (k = 0; k < e->n_frictions; ++k) e->is_active[k] = w[PLACE(k, MODE_STATE)] == COTREE_F(0.0);
    return fail_indeterminate(e, t);
}

/* Close or open all active stops. Return whether any mode changed. */
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

/* Change modes until the modes of n unilateral constraints are consistent. Return FOUND, NONE if
 * pivoting ends without a solution, or the failure of the first trial. */
static int solve_complementarity(cotree_events *e, cotree_real t, const cotree_real *w, int n)
{
    int round, is_begun = 0, is_lost = 0, changed = -1;
    cotree_real to = COTREE_F(0.0);
    e->n_tried = 0;
    for (round = 0; round <= COTREE_FRICTION_ROUNDS(n); ++round) {
        record_trial(e);
        if (evaluate_modes(e, t, w) != 0) {
            /* The trial was singular (the forces are not unique): discard this mode set. */
            if (changed >= 0)
                cotree_copy(e->n_modes, e->saved_modes, e->modes);
            else if (!close_stops(e, 0))
                is_lost = 1;
            if (is_lost && !e->is_impact) return fail_indeterminate(e, t);
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
#if COTREE_HAS_DISCS
        if (cotree_is_disc(e, changed) && to == COTREE_F(1.0) &&
            cotree_begin_sliding(e, changed, t) != 0)
            return e->failure;
#endif
        set_mode(e, changed, to);
    }
    return COTREE_EVENTS_NONE;
}

/* Select the modes of all variable constraints by pivoting; if that fails, by enumeration. */
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
        return fail_modes(e, t, cotree_first_stop(e), e->n_modes, COTREE_EVENTS_NO_IMPULSES);
    return fail_modes(e, t, 0, e->n_modes, COTREE_EVENTS_NO_MODES);
}

/* Fail if the solution is not unique: with strong friction, a stop may both stay closed and open
 * (Painleve paradox). */
static int check_unique(cotree_events *e, cotree_real t, const cotree_real *w)
{
    int k;
#if COTREE_HAS_DISCS
    cotree_copy(2 * e->n_discs, e->directions, e->saved_directions);
#endif
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
            if (part > least) return cotree_fail(e, PLACE(k, REBOUND), t, COTREE_EVENTS_NOT_UNIQUE);
        }
        cotree_copy(e->n_modes, e->saved_modes, e->modes);
#if COTREE_HAS_DISCS
        cotree_copy(2 * e->n_discs, e->saved_directions, e->directions);
#endif
    }
    return cotree_evaluate_motion(e, t, w);
}

/* Select the modes of active friction and stops, and the signs of loads. */
int cotree_select_modes(cotree_events *e, cotree_real t, const cotree_real *w)
{
    int status;
    /* Start with all contacts closed and all friction sticking. */
    close_stops(e, 1);
    status = cotree_solve_modes(e, t, w);
    return status == 0 && e->n_contact_friction > 0 ? check_unique(e, t, w) : status;
}
#endif
