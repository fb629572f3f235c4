/* cotree_events_internal.h: declarations shared by the sources of cotree_events.h.
 * Part of the runtime of cotree, the same for every model.
 */
#ifndef COTREE_EVENTS_INTERNAL_H
#define COTREE_EVENTS_INTERNAL_H

#include "cotree_events.h"

#include <float.h>
#include <math.h>
#include <stddef.h>

/* A step is looked at at both ends and in three points between. */
#define SAMPLES 5

#define CLOSER 2 /* a result: look at the step more closely first */

/* How many times its own rounding that of the terms of a speed may be. */
#define UNSURE COTREE_F(1e3)

/* Rates below this share of that at the crossing are none. */
#define STILL COTREE_SELECT(1e-10, 4.3e-05f)

/* A crossing less deep than this many times the tolerance may as well not take place. */
#define GRAZING COTREE_F(10.0)

/* So many of one event within this share of the span are too many. */
#define CROWDED COTREE_SELECT(1e-9, 1.2e-04f)

/* Intervals that shrink by one ratio, within this share, so often in a row, are a geometric
 * series; the run ends where what is left of it is below this share of the span. A few are enough
 * to call by its name what has become too small for the tolerance. */
#define IN_A_ROW 8

#define SAME_RATIO COTREE_F(0.02)

#define LEFT COTREE_SELECT(1e-6, 2.8e-03f)

#define A_FEW 3

/* Values that two orders of jumps lead to are the same within this share. */
#define SAME COTREE_SELECT(1e-8, 3.5e-04f)

/* How many tolerances beside a point, and how many times as far from zero, the rates on both sides
 * of a jump are compared again; so often it may be as many times more. */
#define ASIDE COTREE_F(100.0)

#define FARTHER COTREE_F(10.0)

#define MOST_ASIDE 4

#define MOST_TRIALS 200

#define MOST_NEWTON_STEPS 12

#define MOST_HALVINGS 50

/* Steps from a start at zero, as a share of the span, by which a value is seen to bend. */
#define BENDING COTREE_SELECT(1e-7, 9.9e-04f)

/* So many numbers has an event among ranges: both ends of its values, and of their rates. */
#define N_ENDS 4

/* How often an interval is halved. */
#define DEEPEST 40

/* What is to be known of a value over an interval. */
enum { UNKNOWN, ONE_WAY, AWAY };

#define AGAIN (-1) /* a result */

/* Where within a step a value passes through zero, and the solution there. */

/* Where an edge's mode is among the states, and its events among all; -1: it has none. */
enum { MODE, STOPS, FORWARD, BACKWARD, GRIP, N_PLACES };

#define PLACE(k, what) (e->friction[(k)*N_PLACES + (what)])

/* Accelerations against a mode are none below this share of what its friction changes them by, and
 * a force at its limit moves on only if it would by this share of the limits over the run. */
#define AGAINST COTREE_F(1e-9)

/* How many times the rounding of a speed counts as zero. */
#define NEAR_ZERO COTREE_F(64.0)

/* Forces this close to a limit, as a share of the limits, are at it: rounding is that of others,
 * which may be larger. */
#define ALMOST COTREE_F(1e-10)

/* What a force accelerates by less than this share of what it would alone is held by others. */
#define BOUND COTREE_F(1e-9)

/* An edge that is let go without an acceleration moves on by the change of that, if it is more than
 * this share of the largest acceleration over the run: rounding is that of all. */
#define LATER COTREE_F(1e-6)

/* Rigid stops: impacts, and what their modes are chosen by, together with those of dry friction.
 *
 * A stop has the mode 0 while it is free, and the side of a limit, 1 or -1, while that holds it. It
 * is struck where a gap is closed and closes further. All that is closed takes part in an impact
 * (Newton's law of impact in the form of J. J. Moreau, 1988): what it gives an impulse leaves with
 * its restitution, or at rest where that is slow enough; what it gives none moves apart no less. */

/* Their events, in the places of those of friction. */
enum { RESTS = STOPS, UPPER, LOWER, LIFTS };

/* An impact gains energy that leaves more than this share of what it turns round. */
#define GAIN COTREE_F(1e-6)

/* So many sets of modes are tried one by one, where changing one at a time does not end. */
#define MOST_CODES 1000

/* Impulses are against their side beyond this share of the largest. */
#define PULLING COTREE_F(1e-9)

/* How many sets of modes are remembered, so that none is tried twice; and the modulus of their
 * numbers, a prime four of which the type of numbers counts exactly. */
#define N_TRIES 256

/* cotree_events.c */
COTREE_PRIVATE int cotree_cross_between(cotree_events *e, int i, cotree_real a, cotree_real b,
                                        cotree_real at_a, cotree_real at_b, int is_turning,
                                        cotree_real *at, cotree_real *from);

/* cotree_scan.c */
COTREE_PRIVATE int cotree_is_ranged(const cotree_events *e, int i);
COTREE_PRIVATE const cotree_real *cotree_quantities_of(const cotree_events *e);
COTREE_PRIVATE void cotree_enclose(cotree_events *e, int k, cotree_real low, cotree_real high,
                                   cotree_real bend);
COTREE_PRIVATE void cotree_enclose_rate(cotree_events *e, int k, cotree_real slow, cotree_real fast,
                                        cotree_real bend);
COTREE_PRIVATE int cotree_find_ranges(cotree_events *e, cotree_real t);
COTREE_PRIVATE int cotree_judge(const cotree_events *e, int i, cotree_real side, cotree_real at_a,
                                cotree_real at_b, cotree_real width);
COTREE_PRIVATE int cotree_scan(cotree_events *e, cotree_real *until);

/* cotree_locate.c */
COTREE_PRIVATE cotree_real cotree_spacing(cotree_real t);
COTREE_PRIVATE cotree_real cotree_sign_of(cotree_real value);
COTREE_PRIVATE void cotree_copy(int n, const cotree_real *from, cotree_real *to);
COTREE_PRIVATE cotree_real cotree_tolerance(const cotree_events *e, int i);
COTREE_PRIVATE cotree_real cotree_band(const cotree_events *e, int i);
COTREE_PRIVATE int cotree_is_of_friction(const cotree_events *e, int i);
COTREE_PRIVATE int cotree_is_corner(const cotree_events *e, int i);
COTREE_PRIVATE cotree_real cotree_least_of(const cotree_events *e, int i);
COTREE_PRIVATE int cotree_fail(cotree_events *e, int event, cotree_real t, int status);
COTREE_PRIVATE int cotree_values(cotree_events *e, cotree_real t, const cotree_real *w);
COTREE_PRIVATE int cotree_rates(cotree_events *e, cotree_real t, const cotree_real *w);
COTREE_PRIVATE int cotree_project(cotree_events *e, cotree_real t, cotree_real *w);
COTREE_PRIVATE int cotree_is_of_same_jump(const cotree_events *e, int i, int k);
COTREE_PRIVATE int cotree_is_kink(cotree_events *e, int i, cotree_real t, const cotree_real *w);
COTREE_PRIVATE int cotree_find_bend(cotree_events *e, cotree_real t, const cotree_real *w);
COTREE_PRIVATE int cotree_read(cotree_events *e, cotree_real t, cotree_real *w);
COTREE_PRIVATE cotree_real cotree_locate(cotree_events *e, int i, cotree_real a, cotree_real b,
                                         cotree_real side);
COTREE_PRIVATE cotree_real cotree_time_of(const cotree_events *e, int k);
COTREE_PRIVATE int cotree_note(cotree_events *e, cotree_real t, const cotree_real *w,
                               const cotree_real *g);
COTREE_PRIVATE int cotree_look(cotree_events *e);
COTREE_PRIVATE int cotree_is_any_near(const cotree_events *e);
COTREE_PRIVATE int cotree_look_closer(cotree_events *e);
COTREE_PRIVATE int cotree_find_nearest(const cotree_events *e, int i, cotree_real side);
COTREE_PRIVATE int cotree_find_turn(cotree_events *e, int i, cotree_real a, cotree_real b,
                                    cotree_real before, cotree_real after, cotree_real side,
                                    cotree_real *at, cotree_real *lowest);
COTREE_PRIVATE int cotree_repeat(cotree_events *e, cotree_real t, cotree_real *w);
COTREE_PRIVATE int cotree_arrive(cotree_events *e, cotree_real t, int i, cotree_real side);

/* cotree_branches.c */
COTREE_PRIVATE void cotree_let_pieces_go(cotree_events *e);
COTREE_PRIVATE int cotree_choose_pieces(cotree_events *e, cotree_real t, const cotree_real *w);
COTREE_PRIVATE int cotree_are_corners(const cotree_events *e);
COTREE_PRIVATE int cotree_pass_corners(cotree_events *e, cotree_real t, const cotree_real *w);
COTREE_PRIVATE int cotree_are_pieces_left(const cotree_events *e, const cotree_real *g);
COTREE_PRIVATE int cotree_glance(cotree_events *e);

/* cotree_friction.c */
COTREE_PRIVATE void cotree_record(cotree_events *e, int i, cotree_real t);
COTREE_PRIVATE int cotree_list_modes(const cotree_hybrid *h, int kind, int *places);
COTREE_PRIVATE void cotree_list_frictions(cotree_events *e, const cotree_hybrid *h);
COTREE_PRIVATE int cotree_try_modes(cotree_events *e, cotree_real t, const cotree_real *w);
COTREE_PRIVATE cotree_real cotree_side_now(const cotree_events *e, int i, cotree_real t,
                                           cotree_real size);
COTREE_PRIVATE cotree_real cotree_no_acceleration(const cotree_events *e, int k);
COTREE_PRIVATE cotree_real cotree_contradiction(cotree_events *e, int k, cotree_real t,
                                                cotree_real *wanted);
COTREE_PRIVATE cotree_real cotree_load_is_turned(const cotree_events *e, int k, cotree_real t);
COTREE_PRIVATE int cotree_look_later(cotree_events *e, cotree_real t);
COTREE_PRIVATE int cotree_is_resting(const cotree_events *e, int i);
COTREE_PRIVATE int cotree_settle_modes(cotree_events *e, cotree_real t, cotree_real *w, int fired);
COTREE_PRIVATE int cotree_has_chosen(const cotree_events *e, int i);
COTREE_PRIVATE void cotree_face_modes(cotree_events *e, const cotree_real *w);

/* cotree_stops.c */
COTREE_PRIVATE int cotree_first_stop(const cotree_events *e);
COTREE_PRIVATE int cotree_count_pressed(const cotree_hybrid *h);
COTREE_PRIVATE void cotree_list_stops(cotree_events *e, const cotree_hybrid *h);
COTREE_PRIVATE int cotree_is_pressed(const cotree_events *e, int k);
COTREE_PRIVATE int cotree_is_load(const cotree_events *e, int k);
COTREE_PRIVATE int cotree_is_chosen(const cotree_events *e, int k);
COTREE_PRIVATE int cotree_is_open(const cotree_events *e, int k);
COTREE_PRIVATE int cotree_gap_of(const cotree_events *e, int k);
COTREE_PRIVATE cotree_real cotree_opening(const cotree_events *e, int k);
COTREE_PRIVATE cotree_real cotree_doubt(const cotree_events *e);
COTREE_PRIVATE cotree_real cotree_slack(const cotree_events *e, int k);
COTREE_PRIVATE int cotree_is_gap(const cotree_events *e, int i);
COTREE_PRIVATE int cotree_is_closed(const cotree_events *e, int i, cotree_real t, int fired);
COTREE_PRIVATE int cotree_check_gaps(cotree_events *e, cotree_real t, const cotree_real *g);
COTREE_PRIVATE int cotree_is_rubbing(const cotree_events *e, int k);
COTREE_PRIVATE cotree_real cotree_parting(const cotree_events *e, int k);
COTREE_PRIVATE void cotree_find_idle_stops(cotree_events *e);
COTREE_PRIVATE cotree_real cotree_still(const cotree_events *e, int k);
COTREE_PRIVATE int cotree_is_parting(const cotree_events *e, int k);
COTREE_PRIVATE void cotree_note_later(cotree_events *e);
COTREE_PRIVATE void cotree_note_parting(cotree_events *e, int k);
COTREE_PRIVATE cotree_real cotree_stop_contradiction(cotree_events *e, int k, cotree_real t,
                                                     cotree_real *wanted);
COTREE_PRIVATE cotree_real cotree_pressed_contradiction(cotree_events *e, int k, cotree_real t,
                                                        cotree_real *wanted);
COTREE_PRIVATE int cotree_bind_pressed(cotree_events *e, cotree_real t);

/* cotree_complementarity.c */
COTREE_PRIVATE int cotree_refuse_start(cotree_events *e, cotree_real t, const cotree_real *w);
COTREE_PRIVATE int cotree_let_slide(cotree_events *e, cotree_real *w);
COTREE_PRIVATE int cotree_choose(cotree_events *e, cotree_real t, const cotree_real *w);
COTREE_PRIVATE int cotree_choose_modes(cotree_events *e, cotree_real t, const cotree_real *w);

/* cotree_impacts.c */
COTREE_PRIVATE int cotree_try_struck(cotree_events *e, cotree_real t, const cotree_real *w);
COTREE_PRIVATE cotree_real cotree_misfit(const cotree_events *e, int k, cotree_real *wanted);
COTREE_PRIVATE cotree_real cotree_misrub(const cotree_events *e, int k, cotree_real *wanted);
COTREE_PRIVATE void cotree_record_impacts(cotree_events *e, cotree_real t, int fired);
COTREE_PRIVATE int cotree_settle_impacts(cotree_events *e, cotree_real t, cotree_real *w,
                                         int fired);

/* cotree_dispatch.c */
COTREE_PRIVATE int cotree_is_wanted(const cotree_events *e, int i, cotree_real side);
COTREE_PRIVATE int cotree_refuse_grazing(cotree_events *e, int i, cotree_real t);
COTREE_PRIVATE void cotree_face(cotree_events *e, int i, cotree_real way);
COTREE_PRIVATE int cotree_is_bent(const cotree_events *e, int i);
COTREE_PRIVATE int cotree_let_happen(cotree_events *e, cotree_real t, cotree_real *w, int n_found,
                                     const cotree_real *slopes);

#endif
