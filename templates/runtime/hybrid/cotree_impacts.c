/* cotree_impacts.c: impacts at rigid stops.
 *
 * An impact is another complementarity problem, solved by cotree_complementarity.c with impulses
 * instead of forces and changes of speed instead of accelerations (J. J. Moreau 1988). The mode of
 * a stop is the side of its limit if the stop has an impulse, else 0. Friction at its contact
 * sticks (0), slides in the direction of the slip after the impact (1 or -1), or has no impulse
 * (2). All other modes are constant. Impacts are repeated until no closed gap has a negative
 * rate. */
#include "cotree_events_internal.h"

#if COTREE_HAS_MODES
/* Modes passed to the kernels in an impact. The mode of a stop with an impulse is twice the sign of
 * its limit; friction that sticks at its contact has mode KERNEL_STICKS. */
#define KERNEL_STRUCK COTREE_F(2.0)
#define KERNEL_STICKS COTREE_F(3.0)

/* In an impact in space, friction in mode -1 slides in the stored direction. */
#define KERNEL_SLIDES (-COTREE_F(1.0))

/* Return whether a closed stop takes part in the impact. */
static int takes_part(const cotree_row *stop)
{
    return stop->side != COTREE_F(0.0) && stop->impact_role >= 0;
}

/* Return whether a row is friction in a joint that can be disengaged. Its limit may depend on
 * reactions, which have impulses; the friction itself is a finite force without impulse. */
static int can_disengage(const cotree_row *row)
{
    return row->type == COTREE_ROW_FRICTION && row->stop == NULL && row->engaged >= 0;
}

/* Return the mode that the kernels use for a row in an impact. Friction that is not at a contact
 * has no impulse: it slides, or is disengaged. */
static cotree_real mode_in_impact(const cotree_row *row)
{
    if (row->type == COTREE_ROW_STOP) return KERNEL_STRUCK * row->mode;
    if (can_disengage(row)) return COTREE_FRICTION_FREE;
    if (cotree_is_disc(row) && row->mode == COTREE_F(1.0)) return KERNEL_SLIDES;
    if (row->type == COTREE_ROW_LOAD || row->mode != COTREE_F(0.0)) return row->mode;
    return row->stop != NULL ? KERNEL_STICKS : COTREE_F(1.0);
}

/* Set the modes that the kernels use in the impact, and the events that prescribe changes of speed,
 * for the modes of the trial. */
static void prepare_impulse(cotree_events *e)
{
    cotree_row *row;
    int c;
    for (row = e->rows; row < END_OF_ROWS; ++row) {
        const int is_holding = row->type != COTREE_ROW_LOAD && cotree_is_holding(row);
        row->kernel_mode = mode_in_impact(row);
        for (c = 0; c < COTREE_COMPONENTS; ++c)
            row->struck_events[c] = is_holding ? row->slips[c] : -1;
        if (row->type == COTREE_ROW_STOP && is_holding)
            row->struck_events[0] = row->restitution_event;
    }
}

/* Evaluate a trial of the impact: the speeds after it and its impulses. Return 0, or nonzero if
 * the impact has no solution. */
int cotree_evaluate_impact(cotree_events *e, cotree_real t, const cotree_real *w)
{
    int status;
    prepare_impulse(e);
    status = cotree_jumps_try_impulse(&e->jumps, e->rows, e->n_rows, t, w, e->trial);
    if (status == 0) status = cotree_jumps_compute_new_values(&e->jumps, t, e->trial);
    if (status == 0) cotree_copy(e->n_events, e->jumps.impulse_forces, e->samples);
    return status;
}

/* Return the impulse of a stop, or zero if its gap is not resolved. */
static cotree_real impulse_of(const cotree_events *e, const cotree_row *stop)
{
    return stop->mode == COTREE_F(0.0) || cotree_closed_gap(stop) == e->unresolved_gap
               ? COTREE_F(0.0)
               : e->samples[stop->limits[0]];
}

/* Return the work of friction at a contact in the impact. */
static cotree_real friction_work(const cotree_events *e, const cotree_row *row)
{
    cotree_real impulse[2], after[COTREE_COMPONENTS];
    if (impulse_of(e, row->stop) == COTREE_F(0.0)) return COTREE_F(0.0);
    cotree_find_slip(e, row, after);
    if (cotree_is_disc(row)) {
        impulse[0] = e->samples[row->impulses[0]];
        impulse[1] = e->samples[row->impulses[1]];
    } else {
        impulse[0] = COTREE_F(0.5) * (e->samples[row->limits[1]] - e->samples[row->limits[0]]);
        impulse[1] = COTREE_F(0.0);
        if (row->mode != COTREE_F(0.0)) return COTREE_F(0.0);
    }
    return -COTREE_F(0.5) * (impulse[0] * (row->slip_speed[0] + after[0]) +
                             impulse[1] * (row->slip_speed[1] + after[1]));
}

/* Return whether the impact gains energy, which Newton's impact law allows with friction. */
static int gains_energy(const cotree_events *e)
{
    cotree_real work = COTREE_F(0.0), size = COTREE_F(0.0);
    const cotree_row *row;
    for (row = e->rows; row < END_OF_ROWS; ++row) {
        if (row->stop != NULL) work += friction_work(e, row);
        if (row->type != COTREE_ROW_STOP) continue;
        work += COTREE_F(0.5) * impulse_of(e, row) * (row->gap_rate + cotree_gap_rate(e, row));
        size += COTREE_FABS(impulse_of(e, row)) * e->impact_speed;
    }
    return work > ENERGY_RTOL * size;
}

/* Return a load that the impact changes, or NULL. The laws of gear losses only apply to forces,
 * since the slip of the teeth may reverse during an impact. */
static const cotree_row *find_lossy_load(const cotree_events *e)
{
    const cotree_real least = IMPULSE_RTOL * cotree_largest_stop_force(e);
    const cotree_row *row;
    for (row = e->rows; row < END_OF_ROWS; ++row) {
        if (row->type == COTREE_ROW_LOAD && COTREE_FABS(e->samples[row->event]) > least) return row;
    }
    return NULL;
}

/* Evaluate the motion. The mode of each stop is `factor` times the side at which it is closed; the
 * modes of all other rows are those at w. */
static int evaluate_stops(cotree_events *e, cotree_real t, const cotree_real *w, cotree_real factor)
{
    cotree_row *row;
    for (row = e->rows; row < END_OF_ROWS; ++row)
        row->mode = row->type == COTREE_ROW_STOP ? factor * row->side : w[row->mode_state];
    return cotree_evaluate_motion(e, t, w);
}

/* Return the largest gap of a stop that is closed at w. It is an error of the integration. */
static cotree_real largest_closed_gap(const cotree_events *e, const cotree_real *w)
{
    cotree_real largest = COTREE_F(0.0);
    const cotree_row *row;
    for (row = FIRST_STOP; row < END_OF_ROWS; ++row) {
        const cotree_real mode = w[row->mode_state];
        if (mode == COTREE_F(0.0)) continue;
        largest =
            COTREE_FMAX(largest, COTREE_FABS(e->samples[row->gaps[mode > COTREE_F(0.0) ? 0 : 1]]));
    }
    return largest;
}

/* Return whether a gap is closed at the last evaluation. gap_error: error of gaps that are held
 * closed. */
static int is_closed(const cotree_events *e, int i, cotree_real t, int fired, cotree_real gap_error)
{
    cotree_real near, rate;
    if (i < 0) return 0; /* the stop has no such limit */
    rate = e->jumps.rates[i];
    near = ZERO_ROUNDINGS * (cotree_rounding_band(e, i) + cotree_spacing(t) * COTREE_FABS(rate));
    /* The time at which a gap closes is uncertain by its error divided by its rate: within this
     * time of an impact, both are simultaneous. */
    if (fired >= 0 && cotree_is_gap(e, fired) && rate < -cotree_gap_rate_error(e))
        near = COTREE_FMAX(near, COTREE_FMAX(cotree_tolerance(e, i), gap_error));
    return i == fired || e->is_stepped_over[i] || e->samples[i] <= near;
}

/* Find the closed gaps and their rates. */
static int find_closed_gaps(cotree_events *e, cotree_real t, const cotree_real *w, int fired,
                            int round)
{
    cotree_row *row;
    int status = evaluate_stops(e, t, w, COTREE_F(0.0));
    const cotree_real gap_error = GRAZING_TOLERANCES * largest_closed_gap(e, w);
    if (status == 0 && cotree_jumps_compute_new_values(&e->jumps, t, e->trial) != 0)
        status = cotree_fail(e, 0, t, COTREE_EVENTS_FAILED);
    for (row = FIRST_STOP; row < END_OF_ROWS && status == 0; ++row) {
        row->was_closed = w[row->mode_state] != COTREE_F(0.0);
        /* A gap that takes part in the impact remains closed until the impact ends. */
        if (row->was_closed || round == 0) row->side = w[row->mode_state];
        if (row->side == COTREE_F(0.0) && is_closed(e, row->gaps[0], t, fired, gap_error))
            row->side = COTREE_F(1.0);
        else if (row->side == COTREE_F(0.0) && is_closed(e, row->gaps[1], t, fired, gap_error))
            row->side = -COTREE_F(1.0);
        row->gap = row->side == COTREE_F(0.0) ? COTREE_F(0.0)
                                              : COTREE_FABS(e->samples[cotree_closed_gap(row)]);
        row->gap_rate = cotree_gap_rate(e, row);
        row->largest_rate = COTREE_FMAX(
            row->largest_rate, COTREE_FABS(cotree_jumps_speed_change(&e->jumps, row->event)));
    }
    return status;
}

/* Return whether a gap separates after an impact at a speed below rounding. */
static int is_unresolved(const cotree_events *e, const cotree_row *stop)
{
    return stop->side != COTREE_F(0.0) && cotree_closed_gap(stop) == e->unresolved_gap;
}

/* Set the role of each stop. 1: the impact starts there; 0: it may have an impulse; -1: it has
 * none, because with sensitivities its impact is a separate event; -2: it has none, because it
 * opens. Return the number of stops with role 1. */
static int find_impact_roles(cotree_events *e, int fired)
{
    const int is_separate = e->run->n_blocks > 1 && fired >= 0 && cotree_is_gap(e, fired);
    const cotree_real error = cotree_gap_rate_error(e);
    cotree_row *row;
    int n = 0;
    for (row = FIRST_STOP; row < END_OF_ROWS; ++row) {
        const cotree_real least = cotree_zero_gap_rate(e, row), rate = row->gap_rate;
        row->impact_role = is_unresolved(e, row) || (row->side != COTREE_F(0.0) && rate < -least);
        if (!is_unresolved(e, row) && rate > COTREE_FMAX(least, error)) row->impact_role = -2;
        if (is_separate && cotree_closed_gap(row) != fired && row->impact_role > 0)
            row->impact_role = rate < -error ? -1 : 0;
        n += row->impact_role > 0;
    }
    return n;
}

/* Select the event that prescribes the change of speed at each stop: that of restitution or, if the
 * rebound speed is below the rest threshold, that of rest. */
static int select_restitution_events(cotree_events *e, cotree_real t, const cotree_real *w)
{
    cotree_row *row;
    const int status = evaluate_stops(e, t, w, COTREE_F(2.0));
    for (row = FIRST_STOP; row < END_OF_ROWS && status == 0; ++row) {
        const int is_slow = e->samples[row->event] <= COTREE_F(0.0) || is_unresolved(e, row);
        row->ends_at_rest = row->impact_role > 0 && is_slow;
        row->restitution_event =
            row->impact_role > 0 && !is_slow ? cotree_closed_gap(row) : row->event;
    }
    return status;
}

/* Initialise the trial: impulses at all stops where the impact starts, with sticking friction. */
static void init_impact(cotree_events *e)
{
    cotree_row *row;
    e->impact_speed = COTREE_F(0.0);
    for (row = e->rows; row < END_OF_ROWS; ++row) {
        row->is_active = row->type == COTREE_ROW_STOP && takes_part(row);
        if (row->type != COTREE_ROW_STOP) continue;
        row->mode = row->impact_role > 0 ? row->side : COTREE_F(0.0);
        row->required_rate = row->gap_rate - row->side * cotree_jumps_speed_change(
                                                             &e->jumps, row->restitution_event);
        e->impact_speed = COTREE_FMAX(e->impact_speed, COTREE_FABS(row->gap_rate));
    }
    for (row = e->rows; row < END_OF_ROWS; ++row) {
        if (row->stop == NULL) continue;
        row->is_active = takes_part(row->stop);
        row->slip_sign = COTREE_F(0.0);
        row->mode = row->stop->mode == COTREE_F(0.0) ? COTREE_F(2.0) : COTREE_F(0.0);
        cotree_find_slip(e, row, row->slip_speed);
        e->impact_speed = COTREE_FMAX(e->impact_speed, COTREE_FABS(row->slip_speed[0]) +
                                                           COTREE_FABS(row->slip_speed[1]));
    }
}

/* Determine which stops have an impulse, and the modes of friction at their contacts. */
static int solve_impact(cotree_events *e, cotree_real t, const cotree_real *w)
{
    const cotree_row *lossy;
    int status;
    init_impact(e);
    e->is_impact = 1;
    status = cotree_solve_modes(e, t, w);
    lossy = status == 0 ? find_lossy_load(e) : NULL;
    e->is_impact = 0;
    if (lossy != NULL) return cotree_fail(e, lossy->event, t, COTREE_EVENTS_LOSSY_IMPACT);
    if (status != 0 || !e->has_contact_friction || !gains_energy(e)) return status;
    return cotree_fail(e, FIRST_STOP->event, t, COTREE_EVENTS_ENERGY_GAIN);
}

/* Fail if an impact changes the rate of a gap that closes at a different time for other parameters:
 * the result depends on the order of the two impacts, so that sensitivities do not exist. Uses the
 * speeds of the last trial. */
static int check_independent(cotree_events *e, cotree_real t)
{
    const cotree_row *row;
    for (row = FIRST_STOP; row < END_OF_ROWS && e->run->n_blocks > 1; ++row) {
        const cotree_real after = cotree_gap_rate(e, row);
        if ((row->impact_role == -1 &&
             COTREE_FABS(after - row->gap_rate) > cotree_zero_gap_rate(e, row)) ||
            (row->impact_role == -2 && after < -cotree_gap_rate_error(e)))
            return cotree_fail(e, cotree_closed_gap(row), t, COTREE_EVENTS_COUPLED_IMPACTS);
    }
    return 0;
}

/* Apply an impulse as part of the last event. */
static int apply_impulse(cotree_events *e, int is_residual, cotree_real t, cotree_real *w)
{
    return cotree_jumps_apply_impulse(&e->jumps, e->rows, e->n_rows, is_residual, t, w) == 0
               ? 0
               : cotree_fail(e, e->rows->event, t, COTREE_EVENTS_FAILED);
}

#if COTREE_HAS_DISCS
/* Remove the slip that remains when sliding in space ends, by an impulse. At very low speeds the
 * direction of the slip is not resolved, and its components do not vanish together. */
int cotree_end_slips(cotree_events *e, cotree_real t, cotree_real *w)
{
    cotree_row *row;
    int c, is_needed = 0;
    for (row = e->rows; row < END_OF_ROWS; ++row) {
        const int ends_slip = cotree_is_disc(row) && row->mode == COTREE_F(0.0) &&
                              w[row->mode_state] == COTREE_F(1.0);
        /* The impulse changes no other speed across a sticking edge or a closed stop. */
        row->kernel_mode = ends_slip ? KERNEL_STICKS : row->mode;
        if (row->mode != COTREE_F(0.0) && can_disengage(row))
            row->kernel_mode = COTREE_FRICTION_FREE;
        for (c = 0; c < COTREE_COMPONENTS; ++c)
            row->struck_events[c] = ends_slip ? row->slips[c] : -1;
        is_needed = is_needed || ends_slip;
    }
    return is_needed ? apply_impulse(e, 1, t, w) : 0;
}
#endif

/* Mark the events of an impact. */
static void mark_impact_events(cotree_events *e)
{
    const cotree_row *row;
    for (row = FIRST_STOP; row < END_OF_ROWS; ++row) {
        if (row->impact_role <= 0) continue;
        e->is_impact_event[cotree_closed_gap(row)] = 1;
        if (row->ends_at_rest) e->is_impact_event[row->event] = 1;
    }
}

/* Record the impacts, except the event that the caller records. */
void cotree_record_impacts(cotree_events *e, cotree_real t, int fired)
{
    int i;
    for (i = 0; i < e->n_events && e->n_stops > 0; ++i) {
        if (e->is_impact_event[i] && i != fired) {
            e->has_fired[i] = 1;
            cotree_write_record(e, i, t);
        }
        e->is_impact_event[i] = 0;
    }
}

/* Apply an impulse that removes the residual speeds of gaps that were closed, and of contacts that
 * stuck, before t. These speeds are integration errors, because only forces have acted. Without the
 * impulse, a gap that opens at zero acceleration could close again. */
static int remove_residues(cotree_events *e, cotree_real t, cotree_real *w, int fired)
{
    cotree_row *row;
    int is_needed = 0;
    for (row = FIRST_STOP; row < END_OF_ROWS; ++row)
        is_needed = is_needed || (row->was_closed && row->gap_rate != COTREE_F(0.0));
    if (!is_needed) return 0;
    for (row = e->rows; row < END_OF_ROWS; ++row) {
        row->mode = w[row->mode_state];
        if (row->type == COTREE_ROW_STOP) row->restitution_event = row->event;
    }
    prepare_impulse(e);
    return apply_impulse(e, 1, t, w) != 0 ? e->failure : find_closed_gaps(e, t, w, fired, 0);
}

/* Repeat impacts at w until no closed gap has a negative rate. */
int cotree_resolve_impacts(cotree_events *e, cotree_real t, cotree_real *w, int fired)
{
    /* Only events of the scene (kind 0) may set speeds; all others only change forces. */
    const int is_of_forces = fired >= 0 && e->events[fired].kind != 0;
    int round;
    for (round = 0; e->n_stops > 0 && round < COTREE_EVENT_ROUNDS; ++round) {
        int status = find_closed_gaps(e, t, w, fired, round);
        if (status == 0 && round == 0 && is_of_forces) status = remove_residues(e, t, w, fired);
        if (status != 0) return status;
        if (find_impact_roles(e, fired) == 0) return 0;
        status = select_restitution_events(e, t, w);
        if (status == 0 && cotree_jumps_compute_new_values(&e->jumps, t, w) != 0)
            status = cotree_fail(e, FIRST_STOP->event, t, COTREE_EVENTS_FAILED);
        if (status == 0) status = solve_impact(e, t, w);
        if (status == 0) status = check_independent(e, t);
        if (status != 0) return status;
        prepare_impulse(e);
        if (apply_impulse(e, 0, t, w) != 0) return e->failure;
        mark_impact_events(e);
    }
    return 0;
}
#endif
