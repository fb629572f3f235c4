/* cotree_events_internal.h: declarations shared by the sources of cotree_events.h. */
#ifndef COTREE_EVENTS_INTERNAL_H
#define COTREE_EVENTS_INTERNAL_H

#include "cotree_bounds.h"
#include "cotree_events.h"

/* Number of samples of each step: both ends and three points between them. */
#define SAMPLES 5

#define REFINE 2 /* status: the step must be refined first */

/* Bound on the rounding error of a speed that is a sum of large terms, in units in its last
 * place. */
#define TERM_ROUNDINGS COTREE_F(1e3)

/* Rates of an event function below this fraction of its rate before the event count as zero. */
#define ZERO_RATE_SHARE COTREE_SELECT(1e-10, 4.3e-05f)

/* Crossings shallower than this many error tolerances are grazing: they may be numerical errors. */
#define GRAZING_TOLERANCES COTREE_F(10.0)

/* COTREE_EVENT_CROWD events of one kind within this fraction of the span are chatter. */
#define CHATTER_SHARE COTREE_SELECT(1e-9, 1.2e-04f)

/* Events accumulate (Zeno behaviour) if the last SERIES_LENGTH intervals between them form a
 * geometric series, whose ratio varies by less than SERIES_RATIO_RTOL, and the remaining sum of the
 * series is below SERIES_REMAINDER_SHARE of the span. SHORT_SERIES_LENGTH intervals suffice to
 * explain a grazing failure. */
#define SERIES_LENGTH 8

#define SERIES_RATIO_RTOL COTREE_F(0.02)

#define SERIES_REMAINDER_SHARE COTREE_SELECT(1e-6, 2.8e-03f)

#define SHORT_SERIES_LENGTH 3

/* Relative difference below which two values of a state or of a rate count as equal. */
#define SAME_RTOL COTREE_SELECT(1e-8, 3.5e-04f)

/* The rates on both sides of a jump are compared at the event and at a second point,
 * ASIDE_TOLERANCES error tolerances away. The second point moves away by the same factor, at most
 * MAX_ASIDE_POINTS times, until the event function there exceeds ASIDE_VALUE_RATIO times its value
 * at the event. */
#define ASIDE_TOLERANCES COTREE_F(100.0)

#define ASIDE_VALUE_RATIO COTREE_F(10.0)

#define MAX_ASIDE_POINTS 4

#define MAX_ROOT_ITERATIONS 200

#define MAX_NEWTON_STEPS 12

#define MAX_HALVINGS 50

/* Step of the forward difference for second derivatives, as a fraction of the span. */
#define CURVATURE_STEP_SHARE COTREE_SELECT(1e-7, 9.9e-04f)

/* Bounds stored for each range: lower and upper bound of an event function, then of its rate. */
#define N_BOUNDS 4

/* Maximum bisection depth. */
#define MAX_DEPTH 40

/* Results of the interval test: undecided, the rate has one sign, or there is no zero. */
enum { RANGE_UNDECIDED, RANGE_MONOTONE, RANGE_NONZERO };

#define SHORTEN (-1) /* status: the step must be repeated with a shorter length */

/* First stop in the table of rows, in which stops come last, and the end of the table. */
#define FIRST_STOP (END_OF_ROWS - e->n_stops)
#define END_OF_ROWS (e->rows + e->n_rows)

/* Accelerations below this fraction of those caused by friction count as zero. A force at its limit
 * leaves the limit only if it would change by this fraction of the limits within the span. */
#define ACCELERATION_RTOL COTREE_F(1e-9)

/* Values of at most this many rounding errors count as zero. */
#define ZERO_ROUNDINGS COTREE_F(64.0)

/* Forces within this fraction of a limit count as at the limit. This fraction exceeds their
 * rounding error, which scales with the largest force in the system. */
#define LIMIT_RTOL COTREE_F(1e-10)

/* A constraint that opens at zero acceleration separates if its acceleration changes within the
 * span by more than this fraction of the largest acceleration. */
#define JERK_SHARE COTREE_F(1e-6)

/* An impact gains energy if its work exceeds this fraction of impulse times speed. */
#define ENERGY_RTOL COTREE_F(1e-6)

/* Largest number of mode sets that are enumerated if pivoting fails. */
#define MAX_ENUMERATED 1000

/* Impulses below this fraction of the largest impulse count as zero. */
#define IMPULSE_RTOL COTREE_F(1e-9)

/* Length of the ring buffer of mode sets that were tried. */
#define N_TRIED_CODES 256

static inline cotree_real cotree_sign_of(cotree_real value)
{
    return value > COTREE_F(0.0)   ? COTREE_F(1.0)
           : value < COTREE_F(0.0) ? -COTREE_F(1.0)
                                   : COTREE_F(0.0);
}

static inline void cotree_copy(int n, const cotree_real *from, cotree_real *to)
{
    int i;
    for (i = 0; i < n; ++i) to[i] = from[i];
}

/* Return whether an event function belongs to dry friction or to a load. */
static inline int cotree_is_of_friction(const cotree_events *e, int i)
{
    return e->events[i].kind >= COTREE_FRICTION_SLIP && e->events[i].kind <= COTREE_FRICTION_LOAD;
}

/* Return whether an event function is the gap of a stop. */
static inline int cotree_is_gap(const cotree_events *e, int i)
{
    return e->events[i].kind == COTREE_STOP_UPPER || e->events[i].kind == COTREE_STOP_LOWER;
}

/* Return whether an event function stays at zero, so that its sign is a rounding error, such as the
 * slip rate of a constraint that has just started to slide. */
static inline int cotree_stays_at_zero(const cotree_events *e, int i)
{
    return e->n_rows > 0 && e->stays_at_zero[i];
}

static inline int cotree_is_kink(const cotree_events *e, int i)
{
    return e->events[i].kind >= COTREE_KINK;
}

static inline int cotree_has_range(const cotree_events *e, int i)
{
    return e->events[i].range >= 0;
}

/* Return the quantities from the last evaluation. */
static inline const cotree_real *cotree_quantities_of(const cotree_events *e)
{
    return e->jumps.values + e->n_events + e->n_branches;
}

/* Return whether friction acts in several directions, on a plane in space or in a ball joint. */
static inline int cotree_is_disc(const cotree_row *row) { return row->direction_states[0] >= 0; }

/* Return whether a row holds: friction sticks, or a stop is closed. */
static inline int cotree_is_holding(const cotree_row *row)
{
    return (row->mode != COTREE_F(0.0)) == (row->type == COTREE_ROW_STOP);
}

/* Return the gap event of the side at which the stop is closed. */
static inline int cotree_closed_gap(const cotree_row *row)
{
    return row->gaps[row->side > COTREE_F(0.0) ? 0 : 1];
}

/* Return the rate of a closed gap, computed from the change of speed that its events would set. */
static inline cotree_real cotree_gap_rate(const cotree_events *e, const cotree_row *row)
{
    return row->side * cotree_jumps_speed_change(&e->jumps, row->event);
}

/* Defined in cotree_events.c: */
COTREE_PRIVATE int cotree_find_crossing_between(cotree_events *e, int i, cotree_real a,
                                                cotree_real b, cotree_real at_a, cotree_real at_b,
                                                int may_turn, cotree_real *at, cotree_real *from);

/* Defined in cotree_scan.c: */
COTREE_PRIVATE int cotree_compute_ranges(cotree_events *e, cotree_real t);
COTREE_PRIVATE int cotree_classify_range(const cotree_events *e, int i, cotree_real side,
                                         cotree_real at_a, cotree_real at_b, cotree_real width);
COTREE_PRIVATE int cotree_scan_ranges(cotree_events *e, cotree_real *until);

/* Defined in cotree_locate.c: */
COTREE_PRIVATE cotree_real cotree_spacing(cotree_real t);
COTREE_PRIVATE cotree_real cotree_tolerance(const cotree_events *e, int i);
COTREE_PRIVATE cotree_real cotree_rounding_band(const cotree_events *e, int i);
COTREE_PRIVATE cotree_real cotree_zero_band(const cotree_events *e, int i);
COTREE_PRIVATE cotree_real cotree_detection_level(const cotree_events *e, int i);
COTREE_PRIVATE int cotree_fail(cotree_events *e, int event, cotree_real t, int status);
COTREE_PRIVATE int cotree_compute_values(cotree_events *e, cotree_real t, const cotree_real *w);
COTREE_PRIVATE int cotree_compute_rates(cotree_events *e, cotree_real t, const cotree_real *w);
COTREE_PRIVATE int cotree_project(cotree_events *e, cotree_real t, cotree_real *w);
COTREE_PRIVATE int cotree_is_of_same_jump(const cotree_events *e, int i, int k);
COTREE_PRIVATE int cotree_is_continuous(cotree_events *e, int i, cotree_real t,
                                        const cotree_real *w);
COTREE_PRIVATE cotree_real cotree_side_after(cotree_events *e, int i, cotree_real t,
                                             const cotree_real *w);
COTREE_PRIVATE int cotree_compute_curvature(cotree_events *e, cotree_real t, const cotree_real *w);
COTREE_PRIVATE int cotree_interpolate(cotree_events *e, cotree_real t, cotree_real *w);
COTREE_PRIVATE cotree_real cotree_locate_root(cotree_events *e, int i, cotree_real a, cotree_real b,
                                              cotree_real side);
COTREE_PRIVATE cotree_real cotree_sample_time(const cotree_events *e, int k);
COTREE_PRIVATE int cotree_update_scales(cotree_events *e, cotree_real t, const cotree_real *w,
                                        const cotree_real *g);
COTREE_PRIVATE int cotree_sample_step(cotree_events *e);
COTREE_PRIVATE int cotree_may_cross(const cotree_events *e);
COTREE_PRIVATE int cotree_refine_step(cotree_events *e);
COTREE_PRIVATE int cotree_find_nearest_sample(const cotree_events *e, int i, cotree_real side);
COTREE_PRIVATE int cotree_find_extremum(cotree_events *e, int i, cotree_real a, cotree_real b,
                                        cotree_real before, cotree_real after, cotree_real side,
                                        cotree_real *at, cotree_real *lowest);
COTREE_PRIVATE int cotree_solution_at(cotree_events *e, cotree_real t, cotree_real *w);
COTREE_PRIVATE int cotree_moves_extremum(cotree_events *e, int i, cotree_real t, cotree_real *w,
                                         cotree_real side);
COTREE_PRIVATE int cotree_refine_root(cotree_events *e, cotree_real t, int i, cotree_real side);

/* Defined in cotree_branches.c: */
COTREE_PRIVATE void cotree_release_branches(cotree_events *e);
COTREE_PRIVATE int cotree_select_branches(cotree_events *e, cotree_real t, const cotree_real *w);
COTREE_PRIVATE int cotree_are_only_kinks(const cotree_events *e);
COTREE_PRIVATE void cotree_settle_sensitivities(cotree_events *e, cotree_real t, cotree_real *w);
COTREE_PRIVATE int cotree_pass_kinks(cotree_events *e, cotree_real t, cotree_real *w);
COTREE_PRIVATE int cotree_enters_band(const cotree_events *e, const cotree_real *g);
COTREE_PRIVATE int cotree_has_left_branch(const cotree_events *e, const cotree_real *g);
COTREE_PRIVATE int cotree_cheap_crossing_test(cotree_events *e);

/* Defined in cotree_rows.c: */
COTREE_PRIVATE void cotree_init_rows(cotree_events *e, const cotree_run *run, cotree_arena *arena);
COTREE_PRIVATE int cotree_is_variable(const cotree_events *e, const cotree_row *row);
COTREE_PRIVATE int cotree_may_change(const cotree_events *e, const cotree_row *row);
COTREE_PRIVATE cotree_real cotree_acceleration(const cotree_events *e, const cotree_row *row);
COTREE_PRIVATE cotree_real cotree_gap_rate_error(const cotree_events *e);
COTREE_PRIVATE cotree_real cotree_zero_gap_rate(const cotree_events *e, const cotree_row *row);
COTREE_PRIVATE cotree_real cotree_largest_acceleration_scale(const cotree_events *e);
COTREE_PRIVATE cotree_real cotree_zero_acceleration(const cotree_events *e, const cotree_row *row);
COTREE_PRIVATE void cotree_find_slip(const cotree_events *e, const cotree_row *row,
                                     cotree_real *slip);
COTREE_PRIVATE int cotree_set_term_scales(cotree_events *e, cotree_real t, const cotree_real *w);
COTREE_PRIVATE int cotree_check_gaps(cotree_events *e, cotree_real t, const cotree_real *g);

/* Defined in cotree_modes.c: */
COTREE_PRIVATE int cotree_evaluate_motion(cotree_events *e, cotree_real t, const cotree_real *w);
COTREE_PRIVATE cotree_real cotree_moving_side(const cotree_events *e, int i, cotree_real t,
                                              cotree_real size);
COTREE_PRIVATE int cotree_resolve_modes(cotree_events *e, cotree_real t, cotree_real *w, int fired);
COTREE_PRIVATE int cotree_was_selected(const cotree_events *e, int i);
COTREE_PRIVATE void cotree_update_mode_sides(cotree_events *e, const cotree_real *w);

#if COTREE_HAS_DISCS
/* Defined in cotree_discs.c: */
COTREE_PRIVATE cotree_real cotree_disc_speed(const cotree_events *e, cotree_row *row,
                                             cotree_real mode);
COTREE_PRIVATE int cotree_begin_sliding(cotree_events *e, cotree_row *row, cotree_real t);
COTREE_PRIVATE int cotree_rotate_directions(cotree_events *e, int round);
#endif

/* Defined in cotree_complementarity.c: */
COTREE_PRIVATE cotree_real cotree_largest_stop_force(const cotree_events *e);
COTREE_PRIVATE void cotree_save_modes(cotree_events *e);
COTREE_PRIVATE void cotree_restore_modes(cotree_events *e);
COTREE_PRIVATE int cotree_fail_start(cotree_events *e, cotree_real t, const cotree_real *w);
COTREE_PRIVATE int cotree_solve_modes(cotree_events *e, cotree_real t, const cotree_real *w);
COTREE_PRIVATE int cotree_select_modes(cotree_events *e, cotree_real t, const cotree_real *w);

/* Defined in cotree_impacts.c: */
COTREE_PRIVATE int cotree_evaluate_impact(cotree_events *e, cotree_real t, const cotree_real *w);
COTREE_PRIVATE void cotree_record_impacts(cotree_events *e, cotree_real t, int fired);
COTREE_PRIVATE int cotree_resolve_impacts(cotree_events *e, cotree_real t, cotree_real *w,
                                          int fired);

#if COTREE_HAS_DISCS
COTREE_PRIVATE int cotree_end_slips(cotree_events *e, cotree_real t, cotree_real *w);
#endif

/* Defined in cotree_dispatch.c: */
COTREE_PRIVATE void cotree_write_record(cotree_events *e, int i, cotree_real t);
COTREE_PRIVATE int cotree_is_in_direction(const cotree_events *e, int i, cotree_real side);
COTREE_PRIVATE int cotree_fail_grazing(cotree_events *e, int i, cotree_real t);
COTREE_PRIVATE void cotree_set_crossing_sign(cotree_events *e, int i, cotree_real sign);
COTREE_PRIVATE int cotree_has_curvature(const cotree_events *e, int i);
COTREE_PRIVATE int cotree_apply_events(cotree_events *e, cotree_real t, cotree_real *w, int n_found,
                                       const cotree_real *slopes);

#endif
