/* cotree_branches.c: branches of piecewise functions, frozen during a step.
 *
 * Absolute values, selections and tables are smooth within each branch and have kinks between
 * branches. A step freezes the branches at its start and ends at the first kink. */
#include "cotree_events_internal.h"

/* Release all branches, so that their arguments select them. The bands of steep kinks remain,
 * because they apply on both sides. */
void cotree_release_branches(cotree_events *e)
{
    int i;
    for (i = COTREE_EVENTS_OF(e->run->model->hybrid); i < e->n_events && e->branches != NULL; ++i) {
        if (e->events[i].kind == COTREE_KINK) e->branches[e->events[i].branch] = COTREE_F(0.0);
    }
}

/* Return the distance from zero within which the argument of a kink counts as zero. */
static cotree_real band_at_kink(const cotree_events *e, int i, cotree_real t)
{
    return COTREE_FMAX(cotree_zero_band(e, i),
                       COTREE_F(4.0) * cotree_spacing(t) * COTREE_FABS(e->jumps.rates[i]));
}

/* Half-width of a steep kink's band, as a multiple of its argument, that suppresses the root. */
#define SUPPRESSING_RATIO COTREE_SELECT(1e15, 1e10f)

/* Half-width of a steep kink's band, as a fraction of the tolerance, that only keeps the slope of
 * the root finite at zero. */
#define NARROW_SHARE COTREE_F(1e-8)

/* Maximum number of Gauss-Seidel sweeps over the steep kinks whose arguments stay at zero. */
#define MAX_SWEEPS 20

/* Effect of a steep kink's roots on its argument, at the kink: they do not move it, or move it
 * towards zero, or away from zero. */
enum { DRIVES_NEITHER, DRIVES_TO_ZERO, DRIVES_AWAY };

/* Write a point that is n_tolerances error tolerances from w to e->point, with the modes of jumps
 * that are valid there. */
static int step_aside(cotree_events *e, cotree_real t, const cotree_real *w,
                      cotree_real n_tolerances)
{
    cotree_real fraction = COTREE_F(0.0);
    int k, has_new_values = 0, status;
    cotree_copy(e->n, w, e->point);
    for (k = 0; k < e->run->n_rates; ++k) {
        /* Each state changes by a different fraction (multiples of the golden ratio), so that
         * differences of states change, too. */
        fraction += COTREE_F(0.618034);
        if (fraction > COTREE_F(1.0)) fraction -= COTREE_F(1.0);
        e->point[k] +=
            n_tolerances * (COTREE_F(1.0) + fraction) * (e->rtol * COTREE_FABS(w[k]) + e->atol);
    }
    status = cotree_compute_values(e, t, e->point);
    for (k = 0; k < e->n_events && status == 0; ++k) {
        const cotree_event *const row = e->events + k;
        if (row->kind != COTREE_JUMP ||
            !((cotree_real)row->direction * e->jumps.values[k] > COTREE_F(0.0)))
            continue;
        if (!has_new_values) status = cotree_jumps_compute_new_values(&e->jumps, t, e->point);
        has_new_values = 1;
        e->point[row->targets[0]] = cotree_jumps_new_value(&e->jumps, k);
    }
    return status;
}

/* Compute the effect of the roots of a steep kink on the rates of the states, and on the rate of
 * the kink's argument, at a point next to w. Afterwards the band suppresses the roots. */
static int compute_effect(cotree_events *e, int i, cotree_real t, const cotree_real *w,
                          cotree_real n_tolerances, cotree_real *value, cotree_real *effect)
{
    cotree_real *const width = e->branches + e->events[i].branch;
    int k, status = step_aside(e, t, w, n_tolerances);
    *value = e->jumps.values[i];
    *width = -COTREE_F(1.0);
    if (status == 0) status = cotree_compute_rates(e, t, e->point);
    *effect = e->jumps.rates[i];
    cotree_copy(e->run->n_rates, e->jumps.state_rates, e->sum);
    *width = SUPPRESSING_RATIO * (COTREE_FABS(*value) + cotree_tolerance(e, i));
    if (status == 0) status = cotree_compute_rates(e, t, e->point);
    *effect -= e->jumps.rates[i];
    for (k = 0; k < e->run->n_rates; ++k) e->sum[k] -= e->jumps.state_rates[k];
    return status;
}

/* Classify how the roots of a steep kink drive its argument, from points on both sides of w. */
static int classify_roots(cotree_events *e, int i, cotree_real t, const cotree_real *w, int *found)
{
    int side, status = 0;
    *found = DRIVES_NEITHER;
    for (side = -1; side <= 1 && status == 0; side += 2) {
        cotree_real value, effect;
        status = compute_effect(e, i, t, w, ASIDE_TOLERANCES * (cotree_real)side, &value, &effect);
        if (effect * value > COTREE_F(0.0)) *found = DRIVES_AWAY;
        if (effect * value < COTREE_F(0.0) && *found == DRIVES_NEITHER) *found = DRIVES_TO_ZERO;
    }
    return status;
}

/* Return whether the argument of a steep kink stays within its zero band over the rest of the span
 * at its current rate. The caller suppresses the roots. */
static int is_at_rest(cotree_events *e, int i, cotree_real t, const cotree_real *w)
{
    return cotree_compute_curvature(e, t, w) == 0 &&
           e->span * COTREE_FABS(e->jumps.rates[i]) <= cotree_zero_band(e, i);
}

/* Set the band of a steep kink near zero. Its roots are regularised within the tolerance if they
 * drive the argument to zero from both sides. The motion is not unique if they drive it away from
 * zero on one side and the other terms of its rate are zero. */
static int set_band(cotree_events *e, int i, cotree_real t, const cotree_real *w)
{
    int found, status = classify_roots(e, i, t, w, &found);
    if (status == 0 && found == DRIVES_AWAY && is_at_rest(e, i, t, w))
        return cotree_fail(e, i, t, COTREE_EVENTS_LEAVES_ROOT);
    e->failure = 0; /* the equations may have no solution at this point */
    e->branches[e->events[i].branch] =
        (status == 0 && found == DRIVES_TO_ZERO ? COTREE_F(1.0) : NARROW_SHARE) *
        cotree_zero_band(e, i);
    return 0;
}

/* Change the sensitivities in the direction in which the roots of a steep kink change the states,
 * until its argument depends on no parameter. The infinite slope of the roots would do so
 * instantly. */
static int settle_at(cotree_events *e, int i, cotree_real t, cotree_real *w)
{
    cotree_real *const width = e->branches + e->events[i].branch, band = *width;
    cotree_real value, effect = COTREE_F(0.0);
    int status = compute_effect(e, i, t, w, ASIDE_TOLERANCES, &value, &effect);
    if (effect == COTREE_F(0.0))
        status = compute_effect(e, i, t, w, -ASIDE_TOLERANCES, &value, &effect);
    *width = band;
    if (status != 0 || effect == COTREE_F(0.0)) return status;
    return cotree_jumps_move_sensitivities(&e->jumps, i, e->sum, effect, t, w);
}

/* Update the sensitivities at the point of the last branch selection for steep kinks whose
 * arguments stay at zero. */
void cotree_settle_sensitivities(cotree_events *e, cotree_real t, cotree_real *w)
{
    const int first = COTREE_EVENTS_OF(e->run->model->hybrid);
    int i, sweep, n_at_rest = 0, status = 0;
    if (e->branches == NULL || e->run->n_blocks == 1) return;
    for (i = first; i < e->n_events; ++i) {
        cotree_real *const width = e->branches + e->events[i].branch, band = *width;
        e->is_near[i] = e->is_near[i] && e->events[i].kind == COTREE_STEEP_KINK &&
                        band > COTREE_SQRT(NARROW_SHARE) * cotree_zero_band(e, i);
        if (!e->is_near[i]) continue;
        *width = SUPPRESSING_RATIO * band;
        e->is_near[i] = is_at_rest(e, i, t, w);
        *width = band;
        n_at_rest += e->is_near[i];
    }
    for (sweep = 0; sweep < (n_at_rest > 1 ? MAX_SWEEPS : n_at_rest); ++sweep) {
        for (i = first; i < e->n_events && status == 0; ++i) {
            if (e->is_near[i]) status = settle_at(e, i, t, w);
        }
    }
    e->failure = 0;
}

/* Freeze the branch on one side of a kink; side 0 releases it. */
static void freeze_branch(cotree_events *e, int i, cotree_real side)
{
    const cotree_event *const row = e->events + i;
    if (row->kind == COTREE_STEEP_KINK) {
        e->side[i] = side;
        e->branches[row->branch] = -COTREE_F(1.0);
    } else if (row->direction == 0) {
        e->side[i] = e->branches[row->branch] = side;
    } else if (side == COTREE_F(0.0)) {
        e->branches[row->branch] = COTREE_F(0.0);
    } else if (side == (cotree_real)row->direction) {
        e->branches[row->branch] += side;
    }
}

/* Compute the errors in the arguments of steep kinks that the state tolerances allow. */
static int set_state_errors(cotree_events *e, cotree_real t, const cotree_real *w)
{
    int i, status;
    cotree_copy(e->n_events, e->jumps.values, e->g);
    status = step_aside(e, t, w, COTREE_F(1.0));
    for (i = 0; i < e->n_events; ++i) {
        if (e->events[i].kind == COTREE_STEEP_KINK)
            e->state_error[i] = COTREE_FABS(e->jumps.values[i] - e->g[i]);
    }
    return status == 0 ? cotree_compute_values(e, t, w) : status;
}

/* Select the branches that the motion from a point enters. A branch is not frozen if the rate of
 * its argument is zero, or if it was already selected at this time. */
int cotree_select_branches(cotree_events *e, cotree_real t, const cotree_real *w)
{
    const int first = COTREE_EVENTS_OF(e->run->model->hybrid);
    const int is_again = COTREE_FABS(t - e->branch_time) <= COTREE_F(8.0) * cotree_spacing(t);
    int i, k, has_rates = 1, status;
    if (e->branches == NULL) return 0;
    e->branch_time = t;
    cotree_release_branches(e);
    status = cotree_compute_values(e, t, w);
    if (status == 0 && e->has_steep) status = set_state_errors(e, t, w);
    if (status == 0) {
        for (k = 0; k < e->n_branches; ++k) e->branches[k] = e->jumps.values[e->n_events + k];
        status = cotree_compute_rates(e, t, w);
    }
    for (i = first; i < e->n_events && status == 0; ++i) {
        const cotree_real g = e->jumps.values[i];
        e->is_near[i] = COTREE_FABS(g) <= band_at_kink(e, i, t);
        if (!e->is_near[i] && e->events[i].direction == 0) freeze_branch(e, i, cotree_sign_of(g));
    }
    /* The rate of an argument may depend on the branches of earlier arguments. */
    for (i = first; i < e->n_events && status == 0; ++i) {
        if (!e->is_near[i]) continue;
        if (e->events[i].kind == COTREE_STEEP_KINK) {
            e->side[i] = COTREE_F(0.0);
            status = set_band(e, i, t, w);
            has_rates = 0;
            continue;
        }
        if (!has_rates) status = cotree_compute_rates(e, t, w);
        has_rates = 0;
        freeze_branch(e, i, is_again ? COTREE_F(0.0) : cotree_sign_of(e->jumps.rates[i]));
    }
    if (status == 0) status = cotree_compute_values(e, t, w);
    cotree_copy(e->n_events, e->jumps.values, e->g);
    for (k = 0; k < e->n_quantities; ++k) e->quantity_mean_rate[k] = COTREE_INFINITY;
    for (i = first; i < e->n_events; ++i) {
        if (e->events[i].direction != 0) e->side[i] = -(cotree_real)e->events[i].direction;
        e->mean_rate[i] = COTREE_INFINITY;
    }
    return status;
}

/* Return whether all located events are kinks, so that only branches have to be selected. */
int cotree_are_only_kinks(const cotree_events *e)
{
    int i;
    for (i = 0; i < e->n_events; ++i) {
        if (e->is_found[i] && !cotree_is_kink(e, i)) return 0;
    }
    return e->n_found > 0 && e->n_rows == 0;
}

/* Apply kinks: select the next branches, and update sensitivities and signs. */
int cotree_pass_kinks(cotree_events *e, cotree_real t, cotree_real *w)
{
    int i;
    e->n_fired = e->n_found;
    e->is_mode_changed = 0;
    for (i = 0; i < e->n_events; ++i) e->has_fired[i] = e->is_found[i];
    if (cotree_select_branches(e, t, w) != 0) return e->failure;
    cotree_settle_sensitivities(e, t, w);
    for (i = 0; i < e->n_events; ++i) {
        e->recent_scale[i] = COTREE_FABS(e->g[i]);
        if (!cotree_is_kink(e, i) && e->recent_scale[i] > cotree_rounding_band(e, i))
            e->side[i] = cotree_sign_of(e->g[i]);
    }
    return 0;
}

/* Return whether a step that started outside the band of a steep kink ended within it. */
int cotree_enters_band(const cotree_events *e, const cotree_real *g)
{
    int i;
    for (i = COTREE_EVENTS_OF(e->run->model->hybrid); i < e->n_events && e->branches != NULL; ++i) {
        if (e->events[i].kind == COTREE_STEEP_KINK && e->side[i] != COTREE_F(0.0) &&
            COTREE_FABS(g[i]) <= cotree_zero_band(e, i))
            return 1;
    }
    return 0;
}

/* An argument has left the band of a steep kink beyond this multiple of the half-width. */
#define LEAVING_RATIO COTREE_F(4.0)

/* Return whether branches must be selected after a step: its end is beyond a frozen branch, or an
 * argument whose branch is not frozen has left its zero band. */
int cotree_has_left_branch(const cotree_events *e, const cotree_real *g)
{
    int i;
    for (i = COTREE_EVENTS_OF(e->run->model->hybrid); i < e->n_events && e->branches != NULL; ++i) {
        if (e->side[i] * g[i] < COTREE_F(0.0)) return 1;
        /* A table whose interval is not frozen always needs a selection. */
        if (e->events[i].direction != 0 && e->branches[e->events[i].branch] == COTREE_F(0.0))
            return 1;
        if (e->side[i] == COTREE_F(0.0) &&
            COTREE_FABS(g[i]) >
                (e->events[i].kind == COTREE_STEEP_KINK ? LEAVING_RATIO : COTREE_F(1.0)) *
                    cotree_zero_band(e, i))
            return 1;
    }
    return 0;
}

/* Bound the quantities of nonlinear event functions over a step, from their values at both ends and
 * their mean rates in the previous step. */
static int bound_quantities(cotree_events *e)
{
    const cotree_real step = e->t_after - e->t_before;
    int k, status = cotree_compute_values(e, e->t_before, e->start);
    cotree_copy(e->n_quantities, cotree_quantities_of(e), e->quantity_samples);
    if (status == 0) status = cotree_compute_values(e, e->t_after, e->end);
    for (k = 0; k < e->n_quantities && status == 0; ++k) {
        e->quantity_mean_rate[k] =
            cotree_set_step_bounds(e->box, e->n_quantities, k, e->quantity_samples[k],
                                   cotree_quantities_of(e)[k], step, e->quantity_mean_rate[k]);
    }
    return status == 0 ? cotree_compute_ranges(e, e->t_after) : status;
}

/* Test only the end of the step. Return REFINE if, judging by the changes over this and the
 * previous step, a kink may have been reached. */
int cotree_cheap_crossing_test(cotree_events *e)
{
    const cotree_real step = COTREE_FABS(e->t_after - e->t_before);
    int i, is_far = 1;
    int status =
        e->n_ranges > 0 ? bound_quantities(e) : cotree_compute_values(e, e->t_after, e->end);
    if (status != 0) return status;
    for (i = 0; i < e->n_events; ++i) {
        const cotree_real g = e->jumps.values[i], side = e->side[i];
        const cotree_real least = cotree_zero_band(e, i), moved_before = step * e->mean_rate[i];
        if (e->branches == NULL) break;
        if (cotree_has_range(e, i)) {
            is_far = is_far && COTREE_FMIN(side * g, side * e->g[i]) > least &&
                     cotree_classify_range(e, i, side, e->g[i], g, step) != RANGE_UNDECIDED;
        } else {
            is_far = is_far && cotree_is_out_of_reach(side, e->g[i], g, moved_before, least);
        }
        is_far = is_far && e->branches[e->events[i].branch] != COTREE_F(0.0);
        e->mean_rate[i] = COTREE_FABS(g - e->g[i]) / step;
    }
    if (!is_far) return REFINE;
    status = cotree_update_scales(e, e->t_after, e->end, e->jumps.values);
    cotree_copy(e->n_events, e->jumps.values, e->g);
    return status;
}
