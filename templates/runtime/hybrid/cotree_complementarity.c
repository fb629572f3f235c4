/* cotree_complementarity.c: the complementarity problem of the rows (cotree_rows.h).
 *
 * The modes of dry friction, of rigid stops and of contacts, and the signs of loads, solve one
 * complementarity problem (F. Pfeiffer, C. Glocker, Multibody Dynamics with Unilateral Contacts,
 * 1996). A friction element that sticks and a stop that is closed have a force within limits. If
 * friction slides, its force is at one of two limits; if a stop is open, its force is at its only
 * limit, zero.
 *
 * The same algorithm solves for forces and accelerations and, in an impact, for impulses and
 * speeds. Only the tolerances and the decision at zero acceleration differ.
 *
 * A trial evaluates the forces and accelerations for one mode set. The forces move from their
 * current values towards those of the trial until the first one reaches a limit: that row slides,
 * or opens. If no force reaches a limit, a row whose acceleration violates its mode sticks, or
 * closes. Only the slacks, the distances to the limits, are stored. If the limits are
 * constant, each pivot decreases a convex quadratic function (primal active-set method: J. Nocedal,
 * S. J. Wright, Numerical Optimization, 2006, section 16.5).
 *
 * If the limits depend on forces, as in contacts with friction and gears with losses, no such
 * function exists, and the problem may have no solution or several. Therefore no mode set is tried
 * twice; if pivoting fails, all mode sets of a small problem are enumerated. */
#include "cotree_events_internal.h"

#if COTREE_HAS_MODES
/* Step fraction of a row that reaches no limit: above 1, so that rows at a limit change first. */
#define FRACTION_NO_LIMIT COTREE_F(2.0)

/* Modulus of the codes of mode sets: a prime; cotree_real represents four times its value
 * exactly. */
#define CODE_MODULUS COTREE_SELECT(1125899906842597.0, 1048573.0f)

/* Maximum number of modes of one row. */
#define MAX_MODES 3

/* Smallest scale of a force, as a fraction of the largest force. At this scale, the relative
 * rounding error is LIMIT_RTOL. */
#define MIN_FORCE_SHARE (ZERO_ROUNDINGS * COTREE_SCAN_ROUNDING / LIMIT_RTOL)

/* List the modes that a row may have. Return their number. */
static int list_allowed_modes(const cotree_row *row, cotree_real *modes)
{
    int n = 0;
    if (row->type != COTREE_ROW_LOAD) modes[n++] = COTREE_F(0.0);
    modes[n++] = row->type == COTREE_ROW_STOP ? row->side : COTREE_F(1.0);
    if (row->type == COTREE_ROW_LOAD || (row->type == COTREE_ROW_FRICTION && row->limits[1] >= 0))
        modes[n++] = -COTREE_F(1.0);
    return n;
}

/* Return the index of the limit (and of the slack) at which the force is in a mode, or -1. */
static int limit_of_mode(const cotree_row *row, cotree_real mode)
{
    if (row->type == COTREE_ROW_LOAD) return -1;
    if (row->type == COTREE_ROW_STOP) return mode == COTREE_F(0.0) ? 0 : -1;
    return mode == COTREE_F(1.0) ? 0 : mode == -COTREE_F(1.0) && row->limits[1] >= 0 ? 1 : -1;
}

/* Return the magnitude of the largest force, or impulse, of a stop. */
cotree_real cotree_largest_stop_force(const cotree_events *e)
{
    const cotree_real *const values = e->is_impact ? e->samples : e->value_scale;
    cotree_real largest = COTREE_F(0.0);
    const cotree_row *row;
    for (row = FIRST_STOP; row < END_OF_ROWS; ++row)
        largest = COTREE_FMAX(largest, COTREE_FABS(values[row->limits[0]]));
    return largest;
}

/* Return the distance of a force from one of its limits. size: the distance between both limits, or
 * the magnitude of a force with one limit. */
static cotree_real distance_to_limit(const cotree_events *e, const cotree_row *row, int limit,
                                     cotree_real *size)
{
    const cotree_real distance = e->samples[limit];
    if (row->type == COTREE_ROW_STOP) {
        const cotree_real largest = cotree_largest_stop_force(e);
        *size =
            e->is_impact ? largest : COTREE_FMAX(e->value_scale[limit], MIN_FORCE_SHARE * largest);
        return distance;
    }
    if (e->is_impact && cotree_is_disc(row)) {
        const cotree_real a = e->samples[row->impulses[0]], b = e->samples[row->impulses[1]];
        *size = COTREE_SQRT(a * a + b * b);
        return distance - *size;
    }
    *size = row->limits[1] < 0
                ? COTREE_FMAX(COTREE_FABS(distance), e->value_scale[limit])
                : COTREE_FABS(e->samples[row->limits[0]] + e->samples[row->limits[1]]);
    return distance;
}

/* Return the relative amount by which the force of a holding row exceeds one of its limits. */
static cotree_real find_excess(const cotree_events *e, const cotree_row *row, cotree_real t,
                               int limit)
{
    cotree_real size, g = distance_to_limit(e, row, limit, &size), excess;
    excess = -g / COTREE_FMAX(size, COTREE_MIN);
    if (e->is_impact) return excess > IMPULSE_RTOL ? excess : COTREE_F(0.0);
    if (cotree_moving_side(e, limit, t, size) >= COTREE_F(0.0)) return COTREE_F(0.0);
    if (g < -COTREE_FMAX(LIMIT_RTOL * size, e->force_noise)) return excess;
    return row->is_resticking ? COTREE_F(0.0) : COTREE_EPSILON;
}

/* Return the slip rate after an impact in the direction in which friction slides. */
static cotree_real slip_along(const cotree_events *e, const cotree_row *row)
{
    cotree_real slip[COTREE_COMPONENTS];
    cotree_find_slip(e, row, slip);
    return cotree_is_disc(row) ? slip[0] * row->direction[0] + slip[1] * row->direction[1]
                               : row->mode * slip[0];
}

/* Compute the accelerations shortly afterwards if the acceleration of a row that does not hold is
 * zero. */
static int compute_later_accelerations(cotree_events *e, cotree_real t)
{
    cotree_row *row;
    int is_needed = 0;
    for (row = e->rows; row < END_OF_ROWS; ++row) {
        if (row->type == COTREE_ROW_LOAD || !row->is_active || cotree_is_holding(row)) continue;
        is_needed = is_needed ||
                    COTREE_FABS(cotree_acceleration(e, row)) <= cotree_zero_acceleration(e, row);
    }
    if (!is_needed) return 0;
    if (cotree_compute_curvature(e, t, e->trial) != 0) return e->failure;
    for (row = e->rows; row < END_OF_ROWS; ++row)
        row->later_acceleration = cotree_acceleration(e, row);
    return cotree_compute_rates(e, t, e->trial);
}

/* Return the relative amount by which a row that does not hold moves against its mode: by the
 * acceleration of a gap or slip or, in an impact, by the speed after it. At zero acceleration, the
 * rate of change of the acceleration decides. */
static cotree_real find_reversal(cotree_events *e, cotree_row *row)
{
    const int is_stop = row->type == COTREE_ROW_STOP;
    cotree_real zero_level = ACCELERATION_RTOL * e->impact_speed, rate, jerk, largest;
    if (e->is_impact) {
        rate = is_stop ? cotree_gap_rate(e, row) : slip_along(e, row);
        if (is_stop) zero_level = COTREE_FMAX(zero_level, cotree_zero_gap_rate(e, row));
        /* The gap rate must reach the rate that restitution requires. */
        if (is_stop && row->impact_role > 0) rate -= row->required_rate;
        return rate < -zero_level ? -rate / COTREE_FMAX(e->impact_speed, COTREE_MIN)
                                  : COTREE_F(0.0);
    }
    rate = cotree_acceleration(e, row);
    row->acceleration_scale = COTREE_FMAX(row->acceleration_scale, COTREE_FABS(rate));
    zero_level = cotree_zero_acceleration(e, row);
    if (rate < -zero_level) return -rate / row->acceleration_scale;
    if (rate > zero_level) return COTREE_F(0.0);
    largest = cotree_largest_acceleration_scale(e);
    jerk = is_stop ? (row->later_acceleration - rate) / (CURVATURE_STEP_SHARE * e->span)
                   : e->curvature[row->event];
    if (!is_stop) largest = COTREE_FMAX(largest, e->largest_rate);
    return jerk * e->span < -JERK_SHARE * largest ? COTREE_EPSILON : COTREE_F(0.0);
}

/* Return whether the normal force or impulse of a contact is tensile. */
static int is_tensile(const cotree_events *e, const cotree_row *stop, cotree_real t)
{
    const int force = stop->limits[0];
    return (e->is_impact ? e->samples[force] : cotree_moving_side(e, force, t, COTREE_F(0.0))) <
           COTREE_F(0.0);
}

/* Return whether any friction at a stop sticks: it must slide before the stop opens. */
static int has_sticking_contact(const cotree_events *e, const cotree_row *stop)
{
    const cotree_row *row;
    for (row = e->rows; row < END_OF_ROWS; ++row) {
        if (row->stop == stop && row->mode == COTREE_F(0.0)) return 1;
    }
    return 0;
}

/* Return the relative amount by which a row violates its current mode, and the mode that removes
 * the violation. */
static cotree_real find_violation(cotree_events *e, cotree_row *row, cotree_real t,
                                  cotree_real *new_mode)
{
    const int is_stop = row->type == COTREE_ROW_STOP;
    cotree_real modes[MAX_MODES], excess;
    int i, n;
    *new_mode = -row->mode;
    if (row->type == COTREE_ROW_LOAD)
        return cotree_moving_side(e, row->event, t, e->value_scale[row->event]) < COTREE_F(0.0)
                   ? COTREE_F(1.0)
                   : COTREE_F(0.0);
    if (row->stop != NULL) {
        if (!e->is_impact)
            row->acceleration_scale =
                COTREE_FMAX(row->acceleration_scale, cotree_largest_acceleration_scale(e));
        if (is_tensile(e, row->stop, t)) {
            /* The friction must slide before its stop opens. */
            *new_mode =
                cotree_is_disc(row) || e->samples[row->limits[0]] < e->samples[row->limits[1]]
                    ? COTREE_F(1.0)
                    : -COTREE_F(1.0);
            return cotree_is_holding(row) ? COTREE_F(1.0) : COTREE_F(0.0);
        }
    }
    row->reversal = COTREE_F(0.0);
    if (!cotree_is_holding(row)) {
        *new_mode = is_stop ? row->side : COTREE_F(0.0);
        return row->reversal = find_reversal(e, row);
    }
    /* The sign of the impulse at an unresolved gap is a rounding error. */
    if (is_stop && (has_sticking_contact(e, row) ||
                    (e->is_impact && cotree_closed_gap(row) == e->unresolved_gap)))
        return COTREE_F(0.0);
    n = list_allowed_modes(row, modes);
    for (i = 0; i < n; ++i) {
        const int side = limit_of_mode(row, modes[i]);
        *new_mode = modes[i];
        if (side < 0) continue;
        excess = find_excess(e, row, t, row->limits[side]);
        if (excess > COTREE_F(0.0)) return excess;
    }
    return COTREE_F(0.0);
}

/* Initialise the slacks: friction forces are midway between their limits, and forces of stops and
 * of friction at contacts are zero. */
static void init_slack(cotree_events *e)
{
    cotree_row *row;
    for (row = e->rows; row < END_OF_ROWS; ++row) {
        cotree_real up, width;
        row->slack[0] = row->slack[1] = COTREE_F(0.0);
        if (row->type != COTREE_ROW_FRICTION || row->stop != NULL) continue;
        up = e->samples[row->limits[0]];
        width = row->limits[1] < 0 ? COTREE_F(2.0) * COTREE_FABS(up)
                                   : COTREE_FABS(up + e->samples[row->limits[1]]);
        row->slack[0] = row->slack[1] = COTREE_F(0.5) * width;
    }
}

/* Return the fraction of the step to the trial forces at which a row changes its mode. */
static cotree_real fraction_to_limit(const cotree_events *e, const cotree_row *row,
                                     cotree_real new_mode)
{
    const int side = limit_of_mode(row, new_mode);
    cotree_real g;
    if (row->type == COTREE_ROW_LOAD) return COTREE_F(0.0);
    if (side < 0) return FRACTION_NO_LIMIT;
    g = e->samples[row->limits[side]];
    return g < COTREE_F(0.0) ? row->slack[side] / (row->slack[side] - g) : COTREE_F(1.0);
}

/* Move the forces by a fraction of the step to the trial forces. */
static void partial_step(cotree_events *e, cotree_real fraction)
{
    cotree_row *row;
    int side;
    for (row = e->rows; row < END_OF_ROWS; ++row) {
        if (row->type == COTREE_ROW_LOAD || !cotree_may_change(e, row)) continue;
        if (!cotree_is_holding(row) && row->stop == NULL) continue;
        for (side = 0; side < 2; ++side) {
            cotree_real *const slack = row->slack + side;
            if (row->limits[side] < 0 || limit_of_mode(row, row->mode) == side) continue;
            *slack = COTREE_FMAX(*slack + COTREE_FMIN(fraction, COTREE_F(1.0)) *
                                              (e->samples[row->limits[side]] - *slack),
                                 COTREE_F(0.0));
        }
    }
}

/* Return the mode of a row after the row `changed` enters a mode. The friction at a contact changes
 * with its stop. */
static cotree_real mode_after_change(const cotree_row *row, const cotree_row *changed,
                                     cotree_real mode)
{
    if (row == changed) return mode;
    if (changed == NULL || row->stop != changed) return row->mode;
    return mode == COTREE_F(0.0) ? COTREE_F(2.0) : row->slip_sign;
}

/* Set a mode of the trial and, for a stop, the modes of the friction at its contact. */
static void change_mode(cotree_events *e, cotree_row *changed, cotree_real mode)
{
    cotree_row *row;
    for (row = e->rows; row < END_OF_ROWS; ++row) row->mode = mode_after_change(row, changed, mode);
}

/* Set the new mode of a row that has reached its limit, and reset its slack. */
static void set_mode(cotree_events *e, cotree_row *changed, cotree_real mode)
{
    const int side = limit_of_mode(changed, mode);
    cotree_row *row;
    if (side >= 0) changed->slack[side] = COTREE_F(0.0);
    for (row = e->rows; row < END_OF_ROWS; ++row) {
        if (row->stop == changed) row->slack[0] = row->slack[1] = COTREE_F(0.0);
    }
    change_mode(e, changed, mode);
}

/* Save the modes of the trial, or restore them. */
void cotree_save_modes(cotree_events *e)
{
    cotree_row *row;
    for (row = e->rows; row < END_OF_ROWS; ++row) {
        row->saved_mode = row->mode;
        cotree_copy(COTREE_COMPONENTS, row->direction, row->saved_direction);
    }
}

void cotree_restore_modes(cotree_events *e)
{
    cotree_row *row;
    for (row = e->rows; row < END_OF_ROWS; ++row) {
        row->mode = row->saved_mode;
        cotree_copy(COTREE_COMPONENTS, row->saved_direction, row->direction);
    }
}

/* Return a code that identifies the current mode set. If `changed` is not NULL, its mode is
 * replaced. */
static cotree_real mode_code(const cotree_events *e, const cotree_row *changed, cotree_real mode)
{
    cotree_real code = COTREE_F(0.0);
    const cotree_row *row;
    for (row = e->rows; row < END_OF_ROWS; ++row)
        code = COTREE_FMOD(COTREE_F(4.0) * code + mode_after_change(row, changed, mode) +
                               COTREE_F(1.0),
                           CODE_MODULUS);
    return code;
}

/* Return whether a stop must close in the impact as much as another one: rounding does not decide
 * which of them closes. */
static int closes_together(const cotree_events *e, const cotree_row *row, const cotree_row *changed)
{
    return e->is_impact && changed->type == COTREE_ROW_STOP && cotree_may_change(e, row) &&
           changed->reversal > COTREE_F(0.0) &&
           COTREE_FABS(row->reversal - changed->reversal) <= IMPULSE_RTOL * changed->reversal;
}

/* Store the code of the current mode set. */
static void record_trial(cotree_events *e)
{
    e->tried_codes[e->n_tried % N_TRIED_CODES] = mode_code(e, NULL, COTREE_F(0.0));
    if (++e->n_tried >= 2 * N_TRIED_CODES) e->n_tried -= N_TRIED_CODES;
}

/* Return whether the mode set with one mode replaced was tried before. */
static int is_tried(const cotree_events *e, const cotree_row *row, cotree_real mode)
{
    const cotree_real code = mode_code(e, row, mode);
    int i;
    for (i = 0; i < e->n_tried && i < N_TRIED_CODES; ++i) {
        if (e->tried_codes[i] == code) return 1;
    }
    return 0;
}

/* Find a mode of a row that was not tried together with the current modes of the other rows. */
static int find_untried_mode(const cotree_events *e, const cotree_row *row, cotree_real *mode)
{
    cotree_real modes[MAX_MODES];
    int i, n = list_allowed_modes(row, modes);
    for (i = 0; i < n; ++i) {
        if (is_tried(e, row, modes[i])) continue;
        *mode = modes[i];
        return 1;
    }
    return 0;
}

/* Return a consistent row whose change of mode leads to an untried mode set, or NULL. */
static cotree_row *find_untried_row(const cotree_events *e, cotree_real *to_mode)
{
    cotree_row *row;
    for (row = e->rows; row < END_OF_ROWS; ++row) {
        if (cotree_may_change(e, row) && find_untried_mode(e, row, to_mode)) return row;
    }
    return NULL;
}

/* Compute the rounding error of the active rows' forces. It is the rounding error of the largest
 * force, since the forces are coupled. */
static void compute_force_noise(cotree_events *e)
{
    cotree_real largest = COTREE_F(0.0);
    const cotree_row *row;
    int c;
    for (row = e->rows; row < END_OF_ROWS; ++row) {
        if (row->type != COTREE_ROW_FRICTION || !row->is_active) continue;
        for (c = 0; c < 2 && row->limits[c] >= 0; ++c)
            largest = COTREE_FMAX(largest, COTREE_FABS(e->samples[row->limits[c]]));
    }
    e->force_noise = COTREE_SCAN_ROUNDING * largest;
}

/* Evaluate the trial: forces and accelerations or, in an impact, impulses and speeds. */
static int evaluate_modes(cotree_events *e, cotree_real t, const cotree_real *w)
{
#if COTREE_HAS_DISCS
    int round, status, is_rotated = 1;
    for (round = 0; is_rotated; ++round) {
        status = e->is_impact ? cotree_evaluate_impact(e, t, w) : cotree_evaluate_motion(e, t, w);
        is_rotated = status == 0 && cotree_rotate_directions(e, round);
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

/* Find the row that reaches its limit first, and move the forces there. `changed` is NULL if all
 * changes lead to mode sets that were tried. Return whether any row violates its mode. */
static int find_pivot(cotree_events *e, cotree_real t, cotree_row **changed, cotree_real *to_mode)
{
    cotree_real smallest_fraction = COTREE_F(0.0), largest_violation = COTREE_F(0.0);
    cotree_row *row;
    int has_violation = 0;
    *changed = NULL;
    for (row = e->rows; row < END_OF_ROWS; ++row) {
        cotree_real new_mode, violation, fraction;
        if (!cotree_may_change(e, row)) continue;
        violation = find_violation(e, row, t, &new_mode);
        if (!(violation > COTREE_F(0.0))) continue;
        has_violation = 1;
        fraction = fraction_to_limit(e, row, new_mode);
        if (is_tried(e, row, new_mode)) {
            /* Limits that depend on forces can cause cycling: use an untried mode. */
            fraction = FRACTION_NO_LIMIT + COTREE_F(1.0);
            if (!find_untried_mode(e, row, &new_mode)) continue;
        }
        if (*changed != NULL && (fraction > smallest_fraction ||
                                 (fraction == smallest_fraction && violation <= largest_violation)))
            continue;
        *changed = row;
        *to_mode = new_mode;
        smallest_fraction = fraction;
        largest_violation = violation;
    }
    if (*changed != NULL) partial_step(e, smallest_fraction);
    return has_violation;
}

/* Return whether the trial can be solved and its solution is consistent with its modes. */
static int are_consistent(cotree_events *e, cotree_real t, const cotree_real *w)
{
    cotree_real new_mode;
    cotree_row *row;
    if (evaluate_modes(e, t, w) != 0 || evaluate_trial(e, t) != 0) {
        e->failure = 0;
        return 0;
    }
    for (row = e->rows; row < END_OF_ROWS; ++row) {
        if (cotree_may_change(e, row) && find_violation(e, row, t, &new_mode) > COTREE_F(0.0))
            return 0;
    }
    return 1;
}

/* Set the modes to the combination with the given number. */
static void decode_modes(cotree_events *e, int code)
{
    cotree_real modes[MAX_MODES];
    int k;
    /* Set the modes of stops, which come last, before those of the friction at their contacts. */
    for (k = e->n_rows - 1; k >= 0; --k) {
        cotree_row *const row = e->rows + k;
        int n;
        if (!cotree_is_variable(e, row)) continue;
        n = list_allowed_modes(row, modes);
        if (cotree_may_change(e, row)) change_mode(e, row, modes[code % n]);
        code /= n;
    }
}

/* Enumerate all mode sets if there are few. Return whether one is consistent. */
static int enumerate_modes(cotree_events *e, cotree_real t, const cotree_real *w)
{
    cotree_real modes[MAX_MODES];
    const cotree_row *row;
    int code, n_codes = 1;
    for (row = e->rows; row < END_OF_ROWS && n_codes <= MAX_ENUMERATED; ++row) {
        if (cotree_is_variable(e, row)) n_codes *= list_allowed_modes(row, modes);
    }
    for (code = 0; n_codes <= MAX_ENUMERATED && code < n_codes; ++code) {
        decode_modes(e, code);
        if (are_consistent(e, t, w)) return 1;
    }
    return 0;
}

/* Set a failure, and mark the active rows of the given types as its cause. */
static int fail_modes(cotree_events *e, cotree_real t, int has_friction, int has_stops, int status)
{
    const cotree_row *row, *first = NULL;
    int i;
    for (i = 0; i < e->n_events; ++i) e->has_fired[i] = 0;
    for (row = e->rows; row < END_OF_ROWS; ++row) {
        if (row->type == COTREE_ROW_FRICTION ? !has_friction
                                             : row->type == COTREE_ROW_LOAD || !has_stops)
            continue;
        e->has_fired[row->event] = row->is_active;
        if (first == NULL || (row->is_active && !first->is_active)) first = row;
    }
    return cotree_fail(e, first == NULL ? e->rows->event : first->event, t, status);
}

/* Set the failure for equations that are singular in the first trial of the mode selection. */
static int fail_indeterminate(cotree_events *e, cotree_real t)
{
    const cotree_row *row;
    int n_sticking = 0;
    for (row = e->rows; row < END_OF_ROWS; ++row)
        n_sticking += row->type == COTREE_ROW_FRICTION && row->is_active;
    /* The matrix is singular if a gear's loss depends on forces that several sticking rows
     * share. */
    if (e->kernel_status != COTREE_SINGULAR || n_sticking == 0) return e->failure;
    return fail_modes(e, t, 1, 0, COTREE_EVENTS_INDETERMINATE);
}

/* Set the failure for equations that are singular with the modes at the start. */
int cotree_fail_start(cotree_events *e, cotree_real t, const cotree_real *w)
{
    cotree_row *row;
    for (row = e->rows; row < END_OF_ROWS; ++row) {
        if (row->type == COTREE_ROW_FRICTION) row->is_active = w[row->mode_state] == COTREE_F(0.0);
    }
    return fail_indeterminate(e, t);
}

/* Close or open all active stops. Return whether any mode changed. */
static int set_stops(cotree_events *e, int is_closed)
{
    cotree_row *row;
    int is_changed = 0;
    for (row = FIRST_STOP; row < END_OF_ROWS; ++row) {
        const cotree_real mode = is_closed ? row->side : COTREE_F(0.0);
        if (!row->is_active || row->mode == mode) continue;
        change_mode(e, row, mode);
        is_changed = 1;
    }
    return is_changed;
}

/* Change the modes of n variable rows until they are consistent. Return FOUND, NONE if pivoting
 * ends without a solution, or the failure of the first trial. */
static int solve_complementarity(cotree_events *e, cotree_real t, const cotree_real *w, int n)
{
    int round, has_slack = 0, is_singular = 0;
    cotree_row *row, *changed = NULL;
    cotree_real to_mode = COTREE_F(0.0);
    e->n_tried = 0;
    for (round = 0; round <= COTREE_FRICTION_ROUNDS(n); ++round) {
        record_trial(e);
        if (evaluate_modes(e, t, w) != 0) {
            /* The trial was singular (the forces are not unique): discard this mode set. */
            if (changed != NULL)
                cotree_restore_modes(e);
            else if (!set_stops(e, 0))
                is_singular = 1;
            if (is_singular && !e->is_impact) return fail_indeterminate(e, t);
            e->failure = 0;
            if (is_singular) return COTREE_EVENTS_NONE;
            changed = NULL;
            continue;
        }
        if (!has_slack) init_slack(e);
        has_slack = 1;
        if (evaluate_trial(e, t) != 0) return e->failure;
        if (!find_pivot(e, t, &changed, &to_mode)) return COTREE_EVENTS_FOUND;
        if (changed == NULL) changed = find_untried_row(e, &to_mode);
        if (changed == NULL) break;
        cotree_save_modes(e);
#if COTREE_HAS_DISCS
        if (cotree_is_disc(changed) && to_mode == COTREE_F(1.0) &&
            cotree_begin_sliding(e, changed, t) != 0)
            return e->failure;
#endif
        set_mode(e, changed, to_mode);
        for (row = FIRST_STOP; row < END_OF_ROWS; ++row) {
            if (row != changed && closes_together(e, row, changed)) set_mode(e, row, row->side);
        }
    }
    return COTREE_EVENTS_NONE;
}

/* Select the modes of all variable rows by pivoting; if that fails, by enumeration. */
int cotree_solve_modes(cotree_events *e, cotree_real t, const cotree_real *w)
{
    const cotree_row *row;
    int status, n = 0;
    for (row = e->rows; row < END_OF_ROWS; ++row) n += cotree_is_variable(e, row);
    if (n == 0) return 0;
    status = solve_complementarity(e, t, w, n);
    if (status == COTREE_EVENTS_FOUND || (status == COTREE_EVENTS_NONE && enumerate_modes(e, t, w)))
        return 0;
    if (status != COTREE_EVENTS_NONE) return status;
    if (e->is_impact) return fail_modes(e, t, 0, 1, COTREE_EVENTS_NO_IMPULSES);
    return fail_modes(e, t, 1, 1, COTREE_EVENTS_NO_MODES);
}

/* Return whether the acceleration of an open stop, or the force of a closed one, exceeds rounding
 * in the last trial. */
static int is_resolved(const cotree_events *e, const cotree_row *stop)
{
    return stop->mode == COTREE_F(0.0)
               ? cotree_acceleration(e, stop) > cotree_zero_acceleration(e, stop)
               : e->samples[stop->limits[0]] > LIMIT_RTOL * e->value_scale[stop->limits[0]];
}

/* Fail if the solution is not unique: with strong friction, a stop may both stay closed and open
 * (Painleve paradox). */
static int check_unique(cotree_events *e, cotree_real t, const cotree_real *w)
{
    cotree_row *row;
    for (row = FIRST_STOP; row < END_OF_ROWS; ++row) {
        if (!row->is_active) continue;
        cotree_save_modes(e);
        change_mode(e, row, row->mode == COTREE_F(0.0) ? row->side : COTREE_F(0.0));
        if (are_consistent(e, t, w) && is_resolved(e, row))
            return cotree_fail(e, row->event, t, COTREE_EVENTS_NOT_UNIQUE);
        cotree_restore_modes(e);
    }
    return cotree_evaluate_motion(e, t, w);
}

/* Select the modes of active friction and stops, and the signs of loads. */
int cotree_select_modes(cotree_events *e, cotree_real t, const cotree_real *w)
{
    int status;
    /* Start with all contacts closed and all friction sticking. */
    set_stops(e, 1);
    status = cotree_solve_modes(e, t, w);
    return status == 0 && e->has_contact_friction ? check_unique(e, t, w) : status;
}
#endif
