/* cotree_discs.c: friction on planes in space.
 *
 * The friction force of a contact on a plane has two components, whose magnitude is limited. The
 * contact has one mode: it sticks, or it slides in the direction of its slip. At zero slip a
 * contact starts to slide in the direction d of its acceleration, which itself depends on d. The
 * trial of the sliding mode includes the solution for d. In an impact, d is the direction of the
 * slip after the impact. */
#include "cotree_events_internal.h"

#include <float.h>
#include <math.h>
#include <stddef.h>

#if COTREE_HAS_DISCS
/* Maximum number of iterations for the sliding directions. */
#define MAX_TURNS 200

/* Convergence tolerance of the sliding directions. */
#define DIRECTION_TOL COTREE_SELECT(1e-14, 1e-6f)

/* A direction is reset if the cosine of its angle to the slip is below this, that is, beyond 60
 * degrees. */
#define LEAST_COSINE COTREE_F(0.5)

int cotree_count_discs(const cotree_hybrid *h)
{
    int i, n = 0;
    for (i = 0; i < h->n_events; ++i) n += h->events[i].kind == COTREE_FRICTION_TURN;
    return n;
}

/* Return the two components of the sliding direction. */
static cotree_real *direction_of(const cotree_events *e, int k)
{
    return e->directions + 2 * e->disc[k];
}

static cotree_real dot(const cotree_real *a, const cotree_real *b)
{
    return a[0] * b[0] + a[1] * b[1];
}

static cotree_real length_of(const cotree_real *a) { return COTREE_SQRT(dot(a, a)); }

/* Set a direction to the direction of a vector, unless the vector is zero. */
static void set_direction(const cotree_events *e, int k, const cotree_real *along)
{
    const cotree_real length = length_of(along);
    if (!(length > COTREE_F(0.0))) return;
    direction_of(e, k)[0] = along[0] / length;
    direction_of(e, k)[1] = along[1] / length;
}

/* List the friction constraints on planes in space. */
void cotree_list_discs(cotree_events *e)
{
    int k, n = 0;
    for (k = 0; k < e->n_frictions; ++k) {
        e->disc[k] = -1;
        if (!cotree_is_disc(e, k)) continue;
        e->direction_states[2 * n] = e->rows[PLACE(k, TURN)].targets[2];
        e->direction_states[2 * n + 1] = e->rows[PLACE(k, TURN)].targets[3];
        e->disc[k] = n++;
    }
}

/* Copy the directions of sliding from the states, or to the states. */
void cotree_load_directions(cotree_events *e, const cotree_real *w)
{
    int i;
    for (i = 0; i < 2 * e->n_discs; ++i) e->directions[i] = w[e->direction_states[i]];
}

void cotree_store_directions(const cotree_events *e, cotree_real *w)
{
    int i;
    for (i = 0; i < 2 * e->n_discs; ++i) w[e->direction_states[i]] = e->directions[i];
}

/* Write both components of the slip from the last evaluation of new values. */
void cotree_slip_vector(const cotree_events *e, int k, cotree_real *slip)
{
    slip[0] = -cotree_jumps_speed_change(&e->jumps, PLACE(k, SLIP));
    slip[1] = -cotree_jumps_speed_change(&e->jumps, PLACE(k, FORWARD_LIMIT));
}

/* Write both components of the slip acceleration from the last evaluation. */
static void slip_acceleration(const cotree_events *e, int k, cotree_real *rate)
{
    rate[0] = -cotree_jumps_speed_change_rate(&e->jumps, PLACE(k, SLIP));
    rate[1] = -cotree_jumps_speed_change_rate(&e->jumps, PLACE(k, FORWARD_LIMIT));
}

/* Write both components of the friction impulse of a contact that sticks in an impact. */
void cotree_friction_impulse(const cotree_events *e, int k, cotree_real *impulse)
{
    impulse[0] = e->samples[PLACE(k, FIRST_IMPULSE)];
    impulse[1] = e->samples[PLACE(k, SECOND_IMPULSE)];
}

/* Return the slip speed, and set the direction of friction if it slides. */
cotree_real cotree_disc_speed(cotree_events *e, int k, cotree_real mode)
{
    cotree_real slip[2], speed;
    cotree_slip_vector(e, k, slip);
    speed = length_of(slip);
    if (mode != COTREE_F(1.0) || dot(slip, direction_of(e, k)) < LEAST_COSINE * speed)
        set_direction(e, k, slip);
    return speed;
}

/* Set the direction in which friction starts to slide: the direction of the force or impulse in the
 * last trial, in which it stuck. */
int cotree_begin_sliding(cotree_events *e, int k, cotree_real t)
{
    cotree_real force[2];
    if (e->is_impact) {
        cotree_friction_impulse(e, k, force);
    } else {
        if (cotree_jumps_compute_new_values(&e->jumps, t, e->trial) != 0)
            return cotree_fail(e, PLACE(k, SLIP), t, COTREE_EVENTS_FAILED);
        force[0] = cotree_jumps_target_value(&e->jumps, PLACE(k, TURN), 2);
        force[1] = cotree_jumps_target_value(&e->jumps, PLACE(k, TURN), 3);
    }
    set_direction(e, k, force);
    return 0;
}

/* Rotate the direction of one contact towards its slip. gain: change of the direction per unit of
 * slip. Return the magnitude of the change. */
static cotree_real turn(cotree_events *e, int k, int round, const cotree_real *slip)
{
    cotree_real *const own = direction_of(e, k), *const last = e->last_turns + 5 * e->disc[k];
    const cotree_real length = length_of(slip), before[2] = {own[0], own[1]};
    cotree_real change[2], limit, *const gain = last + 4;
    change[0] = slip[0] - last[2];
    change[1] = slip[1] - last[3];
    /* The direction changes by at most one. */
    limit = COTREE_F(1.0) / length;
    if (round > 0) {
        /* The slip decreases with the direction by at most the largest slope so far. */
        const cotree_real moved[2] = {own[0] - last[0], own[1] - last[1]};
        const cotree_real way = length_of(moved), fall = length_of(change);
        if (fall * limit > way) limit = way / fall;
        if (round > 1) limit = COTREE_FMIN(limit, *gain);
    }
    *gain = limit;
    last[0] = before[0];
    last[1] = before[1];
    last[2] = slip[0];
    last[3] = slip[1];
    change[0] = before[0] + *gain * slip[0];
    change[1] = before[1] + *gain * slip[1];
    set_direction(e, k, change);
    change[0] = own[0] - before[0];
    change[1] = own[1] - before[1];
    return length_of(change);
}

/* Rotate the directions of contacts that start to slide towards their accelerations or, in impacts,
 * towards the slip after the impact. Return whether any direction changed, so that the trial must
 * be evaluated again. */
int cotree_turn_discs(cotree_events *e, int round)
{
    int k, is_changed = 0;
    if (round >= MAX_TURNS) return 0;
    for (k = 0; k < e->n_frictions && e->n_discs > 0; ++k) {
        cotree_real slip[2], least;
        if (!cotree_is_disc(e, k) || !e->is_active[k] || e->modes[k] != COTREE_F(1.0)) continue;
        if (e->is_impact) {
            cotree_slip_vector(e, k, slip);
            least = ACCELERATION_RTOL * e->impact_speed;
        } else {
            slip_acceleration(e, k, slip);
            least = cotree_slip_rest_tolerance(e, k);
        }
        /* A contact at its limit that does not slide yet keeps the direction of its force. */
        if (length_of(slip) <= least) continue;
        is_changed = turn(e, k, round, slip) > DIRECTION_TOL || is_changed;
    }
    return is_changed;
}
#endif
