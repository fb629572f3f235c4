/* cotree_discs.c: directions of sliding on planes in space.
 *
 * At zero slip a contact starts to slide in the direction d of its acceleration, which itself
 * depends on d. The trial of the sliding mode includes the solution for d. In an impact, d is the
 * direction of the slip after the impact. */
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

static cotree_real dot(const cotree_real *a, const cotree_real *b)
{
    return a[0] * b[0] + a[1] * b[1];
}

static cotree_real length_of(const cotree_real *a) { return COTREE_SQRT(dot(a, a)); }

/* Write a - b to c. */
static void subtract(const cotree_real *a, const cotree_real *b, cotree_real *c)
{
    c[0] = a[0] - b[0];
    c[1] = a[1] - b[1];
}

/* Set a direction to the direction of a vector, unless the vector is zero. */
static void set_direction(cotree_row *row, const cotree_real *along)
{
    const cotree_real length = length_of(along);
    if (!(length > COTREE_F(0.0))) return;
    row->direction[0] = along[0] / length;
    row->direction[1] = along[1] / length;
}

/* Return the slip speed, and set the direction of friction if it slides. */
cotree_real cotree_disc_speed(const cotree_events *e, cotree_row *row, cotree_real mode)
{
    cotree_real slip[2], speed;
    cotree_find_slip(e, row, slip);
    speed = length_of(slip);
    if (mode != COTREE_F(1.0) || dot(slip, row->direction) < LEAST_COSINE * speed)
        set_direction(row, slip);
    return speed;
}

/* Set the direction in which friction starts to slide: the direction of the force or impulse in the
 * last trial, in which it stuck. */
int cotree_begin_sliding(cotree_events *e, cotree_row *row, cotree_real t)
{
    cotree_real force[2];
    int c;
    if (!e->is_impact && cotree_jumps_compute_new_values(&e->jumps, t, e->trial) != 0)
        return cotree_fail(e, row->event, t, COTREE_EVENTS_FAILED);
    for (c = 0; c < 2; ++c)
        force[c] = e->is_impact ? e->samples[row->impulses[c]]
                                : cotree_jumps_target_value(&e->jumps, row->direction_event, 2 + c);
    set_direction(row, force);
    return 0;
}

/* Rotate the direction of one contact towards its slip. Return the magnitude of the change. */
static cotree_real turn(cotree_row *row, int round, const cotree_real *slip)
{
    const cotree_real before[2] = {row->direction[0], row->direction[1]};
    cotree_real change[2], limit = COTREE_F(1.0) / length_of(slip); /* a change of one */
    if (round > 0) {
        /* The slip decreases with the direction by at most the largest slope so far. */
        cotree_real moved[2], distance, fall;
        subtract(before, row->last_direction, moved);
        subtract(slip, row->last_slip, change);
        distance = length_of(moved);
        fall = length_of(change);
        if (fall * limit > distance) limit = distance / fall;
        if (round > 1) limit = COTREE_FMIN(limit, row->gain);
    }
    row->gain = limit;
    cotree_copy(2, before, row->last_direction);
    cotree_copy(2, slip, row->last_slip);
    change[0] = before[0] + row->gain * slip[0];
    change[1] = before[1] + row->gain * slip[1];
    set_direction(row, change);
    subtract(row->direction, before, change);
    return length_of(change);
}

/* Rotate the directions of contacts that start to slide towards their accelerations or, in impacts,
 * towards the slip after the impact. Return whether any direction changed, so that the trial must
 * be evaluated again. */
int cotree_turn_discs(cotree_events *e, int round)
{
    cotree_row *row;
    int c, has_changed = 0;
    if (round >= MAX_TURNS) return 0;
    for (row = e->rows; row < END_OF_ROWS; ++row) {
        cotree_real slip[2], least;
        if (!cotree_is_disc(row) || !row->is_active || row->mode != COTREE_F(1.0)) continue;
        if (e->is_impact) {
            cotree_find_slip(e, row, slip);
            least = ACCELERATION_RTOL * e->impact_speed;
        } else {
            for (c = 0; c < 2; ++c)
                slip[c] = -cotree_jumps_speed_change_rate(&e->jumps,
                                                          c == 0 ? row->event : row->limits[0]);
            least = cotree_zero_acceleration(e, row);
        }
        /* A contact at its limit that does not slide yet keeps the direction of its force. */
        if (length_of(slip) <= least) continue;
        has_changed = turn(row, round, slip) > DIRECTION_TOL || has_changed;
    }
    return has_changed;
}
#endif
