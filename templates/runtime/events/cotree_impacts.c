/* cotree_impacts.c: impacts at rigid stops.
 *
 * An impact is another complementarity problem, solved by cotree_complementarity.c with impulses
 * instead of forces and changes of speed instead of accelerations (J. J. Moreau 1988). The mode of
 * a stop is the side of its limit if the stop has an impulse, else 0. Friction at its contact
 * sticks (0), slides in the direction of the slip after the impact (1 or -1), or has no impulse
 * (2). All other modes are constant. Impacts are repeated until no closed gap has a negative
 * rate. */
#include "cotree_events_internal.h"

#include <float.h>
#include <math.h>
#include <stddef.h>

#if COTREE_HAS_MODES
/* Modes passed to the kernels in an impact. The mode of a stop with an impulse is twice the sign of
 * its limit; friction that sticks at its contact has mode KERNEL_STICKS. */
#define KERNEL_STRUCK COTREE_F(2.0)
#define KERNEL_STICKS COTREE_F(3.0)

/* On planes in space, friction in mode -1 slides in the stored direction. */
#define KERNEL_SLIDES (-COTREE_F(1.0))

/* Return whether a closed stop takes part in the impact. */
static int takes_part(const cotree_events *e, int k)
{
    return e->closed_side[k - cotree_first_stop(e)] != COTREE_F(0.0) &&
           e->impact_role[k - cotree_first_stop(e)] >= 0;
}

/* Return the data of the impact for cotree_jumps.h, with the modes of the trial. */
static cotree_impulse impact_of(cotree_events *e)
{
    cotree_impulse s;
    int k;
    for (k = 0; k < e->n_modes; ++k) {
        const int own = k - cotree_first_stop(e);
        const cotree_real mode = e->modes[k];
        e->kernel_modes[k] = own >= 0 ? KERNEL_STRUCK * mode : mode;
        /* Other sticking friction has a finite force, and hence no impulse. */
        if (k < e->n_frictions && mode == COTREE_F(0.0))
            e->kernel_modes[k] = cotree_is_contact_friction(e, k) ? KERNEL_STICKS : COTREE_F(1.0);
        if (cotree_is_disc(e, k) && mode == COTREE_F(1.0)) e->kernel_modes[k] = KERNEL_SLIDES;
        if (own >= 0)
            e->impact_events[own] = mode != COTREE_F(0.0) ? e->restitution_event[own] : -1;
    }
    for (k = 0; k < e->n_contact_friction; ++k) {
        const int i = e->contact_friction[k];
        const int sticks = e->modes[i] == COTREE_F(0.0);
        e->impact_events[e->n_stops + k] = sticks ? PLACE(i, SLIP) : -1;
#if COTREE_HAS_DISCS
        if (cotree_is_disc(e, i))
            e->impact_events[e->n_stops + e->n_contact_friction + e->disc[i]] =
                sticks ? PLACE(i, FORWARD_LIMIT) : -1;
#endif
    }
    s.is_residual = 0;
    s.n_modes = e->n_modes;
    s.stride = N_PLACES;
    s.places = e->places;
    s.modes = e->kernel_modes;
#if COTREE_HAS_DISCS
    s.n_directions = 2 * e->n_discs;
    s.direction_states = e->direction_states;
    s.directions = e->directions;
#endif
    s.n_edges = e->n_stops + e->n_contact_friction + e->n_discs;
    s.n_stops = e->n_stops;
    s.n_forces = e->n_modes - e->n_frictions + 2 * e->n_contact_friction + e->n_discs;
    s.impulse_states = e->impulse_states;
    s.speed_events = e->impact_events;
    s.force_events = e->force_events;
    return s;
}

/* Evaluate a trial of the impact: the speeds after it and its impulses. Return 0, or nonzero if
 * the impact has no solution. */
int cotree_evaluate_impact(cotree_events *e, cotree_real t, const cotree_real *w)
{
    const cotree_impulse s = impact_of(e);
    int i, status = cotree_jumps_try_impulse(&e->jumps, &s, t, w, e->trial);
    if (status == 0) status = cotree_jumps_compute_new_values(&e->jumps, t, e->trial);
    for (i = 0; i < s.n_forces && status == 0; ++i)
        e->samples[e->force_events[i]] = e->jumps.impulse_forces[i];
    return status;
}

/* Write both components of the slip after the impact. */
void cotree_find_slip(const cotree_events *e, int k, cotree_real *slip)
{
    slip[0] = -cotree_jumps_speed_change(&e->jumps, PLACE(k, SLIP));
    slip[1] = COTREE_F(0.0);
#if COTREE_HAS_DISCS
    if (cotree_is_disc(e, k)) cotree_slip_vector(e, k, slip);
#endif
}

/* Return whether the impulse of a stop exceeds rounding. An unresolved gap has no such impulse. */
static int has_resolved_impulse(const cotree_events *e, int k)
{
    return e->modes[k] != COTREE_F(0.0) && cotree_closed_gap(e, k) != e->unresolved_gap;
}

/* Return whether the impact gains energy, which Newton's impact law allows with friction. */
static int gains_energy(const cotree_events *e)
{
    cotree_real work = COTREE_F(0.0), size = COTREE_F(0.0);
    int k;
    for (k = cotree_first_stop(e); k < e->n_modes; ++k) {
        const cotree_real impulse =
            has_resolved_impulse(e, k) ? e->samples[PLACE(k, CONTACT_FORCE)] : COTREE_F(0.0);
        work += COTREE_F(0.5) * impulse *
                (e->opening_speed[k - cotree_first_stop(e)] + cotree_opening_speed(e, k));
        size += COTREE_FABS(impulse) * e->impact_speed;
    }
    for (k = 0; k < e->n_contact_friction; ++k) {
        const int i = e->contact_friction[k];
        const cotree_real *const before = e->slip_speed + 2 * k;
        cotree_real impulse[2] = {COTREE_F(0.0), COTREE_F(0.0)}, after[2];
        if (!has_resolved_impulse(e, e->normal_stop[i])) continue;
        if (!cotree_is_disc(e, i) && e->modes[i] != COTREE_F(0.0)) continue;
        cotree_find_slip(e, i, after);
#if COTREE_HAS_DISCS
        if (cotree_is_disc(e, i)) cotree_friction_impulse(e, i, impulse);
#endif
        if (!cotree_is_disc(e, i))
            impulse[0] = COTREE_F(0.5) * (e->samples[PLACE(i, BACKWARD_LIMIT)] -
                                          e->samples[PLACE(i, FORWARD_LIMIT)]);
        work -= COTREE_F(0.5) *
                (impulse[0] * (before[0] + after[0]) + impulse[1] * (before[1] + after[1]));
    }
    return work > ENERGY_RTOL * size;
}

/* Return a load that the impact changes, or -1. The laws of gear losses only apply to forces, since
 * the slip of the teeth may reverse during an impact. */
static int find_lossy_load(const cotree_events *e)
{
    const cotree_real least = IMPULSE_RTOL * cotree_largest_stop_force(e);
    int k;
    for (k = e->n_frictions; k < cotree_first_stop(e); ++k) {
        if (COTREE_FABS(e->samples[PLACE(k, SLIP)]) > least) return k;
    }
    return -1;
}

/* Find the closed gaps and their rates. */
static int find_closed_gaps(cotree_events *e, cotree_real t, const cotree_real *w, int fired)
{
    int k, status;
    for (k = 0; k < cotree_first_stop(e); ++k) e->modes[k] = w[PLACE(k, MODE_STATE)];
    for (; k < e->n_modes; ++k) e->modes[k] = COTREE_F(0.0);
    status = cotree_evaluate_motion(e, t, w);
    if (status == 0 && cotree_jumps_compute_new_values(&e->jumps, t, e->trial) != 0) {
        status = cotree_fail(e, 0, t, COTREE_EVENTS_FAILED);
    }
    for (k = cotree_first_stop(e); k < e->n_modes && status == 0; ++k) {
        const int own = k - cotree_first_stop(e);
        const cotree_real mode = w[PLACE(k, MODE_STATE)];
        e->was_holding[own] = mode != COTREE_F(0.0);
        e->closed_side[own] = mode;
        if (mode == COTREE_F(0.0)) {
            if (PLACE(k, UPPER_GAP) >= 0 && cotree_is_closed(e, PLACE(k, UPPER_GAP), t, fired))
                e->closed_side[own] = COTREE_F(1.0);
            else if (PLACE(k, LOWER_GAP) >= 0 && cotree_is_closed(e, PLACE(k, LOWER_GAP), t, fired))
                e->closed_side[own] = -COTREE_F(1.0);
        }
        e->gaps[own] = e->closed_side[own] == COTREE_F(0.0)
                           ? COTREE_F(0.0)
                           : COTREE_FABS(e->samples[cotree_closed_gap(e, k)]);
        e->opening_speed[own] = cotree_opening_speed(e, k);
        e->largest_opening_speed[own] =
            COTREE_FMAX(e->largest_opening_speed[own],
                        COTREE_FABS(cotree_jumps_speed_change(&e->jumps, PLACE(k, REBOUND))));
    }
    return status;
}

/* Set the role of each stop: 1 if the impact starts there, 0 if not. A closed gap takes no part if
 * it opens (-2), or if sensitivities distinguish the time at which it closes from that of this
 * event (-1). Return the number of stops with role 1. */
static int find_impact_roles(cotree_events *e, int fired)
{
    const int is_own = e->run->n_blocks > 1 && fired >= 0 && cotree_is_gap(e, fired);
    int k, n = 0;
    for (k = cotree_first_stop(e); k < e->n_modes; ++k) {
        const int own = k - cotree_first_stop(e);
        const int is_faint =
            e->closed_side[own] != COTREE_F(0.0) && cotree_closed_gap(e, k) == e->unresolved_gap;
        e->impact_role[own] =
            is_faint || (e->closed_side[own] != COTREE_F(0.0) &&
                         e->opening_speed[own] < -cotree_zero_opening_speed(e, k));
        if (!is_faint && e->opening_speed[own] > COTREE_FMAX(cotree_zero_opening_speed(e, k),
                                                             cotree_closing_uncertainty(e)))
            e->impact_role[own] = -2;
        if (is_own && cotree_closed_gap(e, k) != fired && e->impact_role[own] > 0) {
            e->impact_role[own] = e->opening_speed[own] < -cotree_closing_uncertainty(e) ? -1 : 0;
        }
        n += e->impact_role[own] > 0;
    }
    return n;
}

/* Select the events whose targets include the changes of speed: those of restitution or, if the
 * rebound speed is below the threshold, those of rest. */
static int select_restitution_events(cotree_events *e, cotree_real t, const cotree_real *w)
{
    int k, status;
    for (k = cotree_first_stop(e); k < e->n_modes; ++k)
        e->modes[k] = COTREE_F(2.0) * e->closed_side[k - cotree_first_stop(e)];
    status = cotree_evaluate_motion(e, t, w);
    for (k = cotree_first_stop(e); k < e->n_modes && status == 0; ++k) {
        const int own = k - cotree_first_stop(e);
        const int is_slow =
            e->samples[PLACE(k, REBOUND)] <= COTREE_F(0.0) ||
            (e->closed_side[own] != COTREE_F(0.0) && cotree_closed_gap(e, k) == e->unresolved_gap);
        e->ends_at_rest[own] = e->impact_role[own] > 0 && is_slow;
        e->restitution_event[own] =
            e->impact_role[own] > 0 && !is_slow ? cotree_closed_gap(e, k) : PLACE(k, REBOUND);
    }
    return status;
}

/* Initialise the trial: impulses at all stops where the impact starts, with sticking friction. */
static void init_impact(cotree_events *e)
{
    int k;
    e->impact_speed = COTREE_F(0.0);
    for (k = 0; k < cotree_first_stop(e); ++k) e->is_active[k] = 0;
    for (; k < e->n_modes; ++k) {
        const int own = k - cotree_first_stop(e);
        e->is_active[k] = takes_part(e, k);
        e->modes[k] = e->impact_role[own] > 0 ? e->closed_side[own] : COTREE_F(0.0);
        e->required_speed[own] =
            e->opening_speed[own] -
            e->closed_side[own] * cotree_jumps_speed_change(&e->jumps, e->restitution_event[own]);
        e->impact_speed = COTREE_FMAX(e->impact_speed, COTREE_FABS(e->opening_speed[own]));
    }
    for (k = 0; k < e->n_contact_friction; ++k) {
        const int i = e->contact_friction[k];
        e->is_active[i] = takes_part(e, e->normal_stop[i]);
        e->slip_sign[i] = COTREE_F(0.0);
        e->modes[i] = e->modes[e->normal_stop[i]] == COTREE_F(0.0) ? COTREE_F(2.0) : COTREE_F(0.0);
        cotree_find_slip(e, i, e->slip_speed + 2 * k);
        e->impact_speed = COTREE_FMAX(e->impact_speed, COTREE_FABS(e->slip_speed[2 * k]) +
                                                           COTREE_FABS(e->slip_speed[2 * k + 1]));
    }
}

/* Determine which stops have an impulse, and the modes of friction at their contacts. */
static int solve_impact(cotree_events *e, cotree_real t, const cotree_real *w)
{
    int status, lossy;
    init_impact(e);
    e->is_impact = 1;
    status = cotree_solve_modes(e, t, w);
    lossy = status == 0 ? find_lossy_load(e) : -1;
    e->is_impact = 0;
    if (lossy >= 0) return cotree_fail(e, PLACE(lossy, SLIP), t, COTREE_EVENTS_LOSSY_IMPACT);
    if (status != 0 || e->n_contact_friction == 0 || !gains_energy(e)) return status;
    return cotree_fail(e, PLACE(cotree_first_stop(e), REBOUND), t, COTREE_EVENTS_ENERGY_GAIN);
}

/* Fail if an impact changes the rate of a gap that closes at a different time for other parameters:
 * the result depends on the order of the two impacts, so that sensitivities do not exist. Uses the
 * speeds of the last trial. */
static int check_independent(cotree_events *e, cotree_real t)
{
    int k;
    for (k = cotree_first_stop(e); k < e->n_modes; ++k) {
        const int own = k - cotree_first_stop(e);
        const cotree_real after = cotree_opening_speed(e, k),
                          change = after - e->opening_speed[own];
        const int is_changed =
            e->impact_role[own] == -1 && COTREE_FABS(change) > cotree_zero_opening_speed(e, k);
        const int is_turned = e->impact_role[own] == -2 && after < -cotree_closing_uncertainty(e);
        if (e->run->n_blocks > 1 && (is_changed || is_turned)) {
            return cotree_fail(e, cotree_closed_gap(e, k), t, COTREE_EVENTS_COUPLED_IMPACTS);
        }
    }
    return 0;
}

/* Apply an impulse as part of the last event. A failure names the first event of mode k. */
static int apply_impulse(cotree_events *e, const cotree_impulse *s, cotree_real t, cotree_real *w,
                         int k)
{
    return cotree_jumps_apply_impulse(&e->jumps, s, t, w) == 0
               ? 0
               : cotree_fail(e, PLACE(k, SLIP), t, COTREE_EVENTS_FAILED);
}

#if COTREE_HAS_DISCS
/* Return whether friction on a plane in space has just stopped slipping. */
static int ends_slip(const cotree_events *e, int k, const cotree_real *w)
{
    return cotree_is_disc(e, k) && e->modes[k] == COTREE_F(0.0) &&
           w[PLACE(k, MODE_STATE)] == COTREE_F(1.0);
}

/* By an impulse, remove the slip that remains when sliding on a plane in space ends. At very low
 * speeds the direction of the slip is not resolved, and its two components do not vanish
 * together. */
int cotree_end_slips(cotree_events *e, cotree_real t, cotree_real *w)
{
    cotree_impulse s;
    int k, is_needed = 0;
    for (k = 0; k < e->n_frictions; ++k) is_needed = is_needed || ends_slip(e, k, w);
    if (!is_needed) return 0;
    s = impact_of(e);
    s.is_residual = 1;
    for (k = 0; k < s.n_edges; ++k) e->impact_events[k] = -1;
    for (k = 0; k < e->n_modes; ++k) {
        const int is_own = ends_slip(e, k, w);
        /* Closed stops stay closed; all other speeds across sticking edges remain constant. */
        e->kernel_modes[k] = is_own ? KERNEL_STICKS : e->modes[k];
    }
    for (k = 0; k < e->n_contact_friction; ++k) {
        const int i = e->contact_friction[k];
        if (!ends_slip(e, i, w)) continue;
        e->impact_events[e->n_stops + k] = PLACE(i, SLIP);
        e->impact_events[e->n_stops + e->n_contact_friction + e->disc[i]] = PLACE(i, FORWARD_LIMIT);
    }
    return apply_impulse(e, &s, t, w, 0);
}
#endif

/* Mark the events of an impact. */
static void mark_impact_events(cotree_events *e)
{
    int k;
    for (k = cotree_first_stop(e); k < e->n_modes; ++k) {
        const int own = k - cotree_first_stop(e);
        if (e->impact_role[own] <= 0) continue;
        e->is_impact_event[cotree_closed_gap(e, k)] = 1;
        if (e->ends_at_rest[own]) e->is_impact_event[PLACE(k, REBOUND)] = 1;
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

/* Return whether a gap that was closed until now has a nonzero rate. */
static int has_residues(const cotree_events *e)
{
    int i;
    for (i = 0; i < e->n_stops; ++i) {
        if (e->was_holding[i] && e->opening_speed[i] != COTREE_F(0.0)) return 1;
    }
    return 0;
}

/* Remove the rates of gaps that were closed until t, and the slips of contacts that stuck, by an
 * impulse. They are integration errors, since only forces have acted. Otherwise a gap that opens at
 * zero acceleration would close again at the speed of the error. */
static int remove_residues(cotree_events *e, cotree_real t, cotree_real *w)
{
    const int first = cotree_first_stop(e);
    cotree_impulse s;
    int k;
    for (k = 0; k < e->n_modes; ++k) e->modes[k] = w[PLACE(k, MODE_STATE)];
    for (k = first; k < e->n_modes; ++k) e->restitution_event[k - first] = PLACE(k, REBOUND);
    s = impact_of(e);
    s.is_residual = 1;
    return apply_impulse(e, &s, t, w, first);
}

/* Repeat impacts at w until no closed gap has a negative rate. */
int cotree_resolve_impacts(cotree_events *e, cotree_real t, cotree_real *w, int fired)
{
    /* Events of the model itself, of kind 0, may set speeds; others cannot. */
    const int is_of_forces = fired >= 0 && e->rows[fired].kind != 0;
    int round;
    for (round = 0; e->n_stops > 0 && round < COTREE_EVENT_ROUNDS; ++round) {
        cotree_impulse s;
        int status = find_closed_gaps(e, t, w, fired);
        if (status == 0 && round == 0 && is_of_forces && has_residues(e)) {
            status = remove_residues(e, t, w);
            if (status == 0) status = find_closed_gaps(e, t, w, fired);
        }
        if (status != 0) return status;
        if (find_impact_roles(e, fired) == 0) return 0;
        status = select_restitution_events(e, t, w);
        if (status == 0 && cotree_jumps_compute_new_values(&e->jumps, t, w) != 0) {
            status = cotree_fail(e, PLACE(cotree_first_stop(e), REBOUND), t, COTREE_EVENTS_FAILED);
        }
        if (status == 0) status = solve_impact(e, t, w);
        if (status == 0) status = check_independent(e, t);
        if (status != 0) return status;
        s = impact_of(e);
        if (apply_impulse(e, &s, t, w, cotree_first_stop(e)) != 0) return e->failure;
        mark_impact_events(e);
    }
    return 0;
}
#endif
