/* cotree_discs.c: directions of sliding on planes in space and in ball joints.
 *
 * At zero slip, friction starts to slide in the direction d of its acceleration, which itself
 * depends on d. The trial of the sliding mode includes the solution for d. In an impact, d is the
 * direction of the slip after the impact. */
#include "cotree_events_internal.h"

#if COTREE_HAS_DISCS
/* Maximum number of iterations for the sliding directions. */
#define MAX_ROTATIONS 200

/* Convergence tolerance of the sliding directions. */
#define DIRECTION_TOL COTREE_SELECT(1e-14, 1e-6f)

/* A direction is set to that of the slip if the cosine of the angle between both is below this
 * value (60 degrees). */
#define LEAST_COSINE COTREE_F(0.5)

static cotree_real dot(const cotree_real *a, const cotree_real *b)
{
    cotree_real sum = COTREE_F(0.0);
    int c;
    for (c = 0; c < COTREE_COMPONENTS; ++c) sum += a[c] * b[c];
    return sum;
}

static cotree_real length_of(const cotree_real *a) { return COTREE_SQRT(dot(a, a)); }

/* Write a + factor b to sum. */
static void add(const cotree_real *a, cotree_real factor, const cotree_real *b, cotree_real *sum)
{
    int c;
    for (c = 0; c < COTREE_COMPONENTS; ++c) sum[c] = a[c] + factor * b[c];
}

/* Set a direction to the direction of a vector, unless the vector is zero. */
static void set_direction(cotree_row *row, const cotree_real *along)
{
    const cotree_real length = length_of(along);
    int c;
    if (!(length > COTREE_F(0.0))) return;
    for (c = 0; c < COTREE_COMPONENTS; ++c) row->direction[c] = along[c] / length;
}

/* Return the slip speed. Set the direction of friction if it did not slide or deviates too much. */
cotree_real cotree_disc_speed(const cotree_events *e, cotree_row *row, cotree_real mode)
{
    cotree_real slip[COTREE_COMPONENTS], speed;
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
    cotree_real force[COTREE_COMPONENTS] = {COTREE_F(0.0)};
    int c;
    if (!e->is_impact && cotree_jumps_compute_new_values(&e->jumps, t, e->trial) != 0)
        return cotree_fail(e, row->event, t, COTREE_EVENTS_FAILED);
    for (c = 0; c < COTREE_COMPONENTS && row->direction_states[c] >= 0; ++c)
        force[c] = e->is_impact ? e->samples[row->impulses[c]]
                                : cotree_jumps_target_value(&e->jumps, row->direction_event, 2 + c);
    set_direction(row, force);
    return 0;
}

/* Rotate the direction of one row towards its slip. Return the magnitude of the change. */
static cotree_real rotate_direction(cotree_row *row, int round, const cotree_real *slip)
{
    cotree_real change[COTREE_COMPONENTS];
    cotree_real limit = COTREE_F(1.0) / length_of(slip); /* change of length one */
    if (round > 0) {
        /* Limit the gain by the inverse of the largest slope of the slip over the direction. */
        cotree_real distance, fall;
        add(row->direction, -COTREE_F(1.0), row->last_direction, change);
        distance = length_of(change);
        add(slip, -COTREE_F(1.0), row->last_slip, change);
        fall = length_of(change);
        if (fall * limit > distance) limit = distance / fall;
        if (round > 1) limit = COTREE_FMIN(limit, row->gain);
    }
    row->gain = limit;
    cotree_copy(COTREE_COMPONENTS, row->direction, row->last_direction);
    cotree_copy(COTREE_COMPONENTS, slip, row->last_slip);
    add(row->direction, row->gain, slip, change);
    set_direction(row, change);
    add(row->direction, -COTREE_F(1.0), row->last_direction, change);
    return length_of(change);
}

/* Rotate the directions of contacts that start to slide towards their accelerations or, in impacts,
 * towards the slip after the impact. Return whether any direction changed, so that the trial must
 * be evaluated again. */
int cotree_rotate_directions(cotree_events *e, int round)
{
    cotree_row *row;
    int c, has_changed = 0;
    if (round >= MAX_ROTATIONS) return 0;
    for (row = e->rows; row < END_OF_ROWS; ++row) {
        cotree_real slip[COTREE_COMPONENTS], least;
        if (!cotree_is_disc(row) || !row->is_active || row->mode != COTREE_F(1.0)) continue;
        if (e->is_impact) {
            cotree_find_slip(e, row, slip);
            least = ACCELERATION_RTOL * e->impact_speed;
        } else {
            for (c = 0; c < COTREE_COMPONENTS; ++c)
                slip[c] = row->slips[c] < 0
                              ? COTREE_F(0.0)
                              : -cotree_jumps_speed_change_rate(&e->jumps, row->slips[c]);
            least = cotree_zero_acceleration(e, row);
        }
        /* A contact at its limit that does not slide yet keeps the direction of its force. */
        if (length_of(slip) <= least) continue;
        has_changed = rotate_direction(row, round, slip) > DIRECTION_TOL || has_changed;
    }
    return has_changed;
}
#endif
