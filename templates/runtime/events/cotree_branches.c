/* cotree_branches.c: branches of piecewise functions, held during a step.
 * Part of the runtime of cotree, the same for every model.
 *
 * Absolute values, selections and tables are smooth within a branch and have kinks between two.
 * A step holds the branches that it starts on, and ends at the first kink. */
#include "cotree_events_internal.h"

#include <float.h>
#include <math.h>
#include <stddef.h>

/* Release all branches: each follows from the value. */
void cotree_release_branches(cotree_events *e)
{
    int k;
    for (k = 0; k < e->n_branches && e->branches != NULL; ++k) e->branches[k] = COTREE_F(0.0);
}

/* Return the distance from zero at which a value counts as at its kink. */
static cotree_real band_at_kink(const cotree_events *e, int i, cotree_real t)
{
    return COTREE_FMAX(cotree_zero_band(e, i),
                       COTREE_F(4.0) * cotree_spacing(t) * COTREE_FABS(e->jumps.rates[i]));
}

/* Freeze the branch on one side of a kink; side 0 releases it. */
static void freeze_branch(cotree_events *e, int i, cotree_real side)
{
    const cotree_event *const row = e->rows + i;
    if (row->direction == 0) {
        e->side[i] = e->branches[row->branch] = side;
    } else if (side == COTREE_F(0.0)) {
        e->branches[row->branch] = COTREE_F(0.0);
    } else if (side == (cotree_real)row->direction) {
        e->branches[row->branch] += side;
    }
}

/* Select the branches of the motion that leaves a point. Those of values with zero rate stay
 * released, and those selected before at the same time. */
int cotree_select_branches(cotree_events *e, cotree_real t, const cotree_real *w)
{
    const int first = COTREE_EVENTS_OF(e->run->model->hybrid);
    const int is_again = COTREE_FABS(t - e->branch_time) <= COTREE_F(8.0) * cotree_spacing(t);
    int i, k, is_known = 1, status;
    if (e->branches == NULL) return 0;
    e->branch_time = t;
    cotree_release_branches(e);
    status = cotree_compute_values(e, t, w);
    if (status == 0) {
        for (k = 0; k < e->n_branches; ++k) e->branches[k] = e->jumps.values[e->n_events + k];
        status = cotree_compute_rates(e, t, w);
    }
    for (i = first; i < e->n_events && status == 0; ++i) {
        const cotree_real g = e->jumps.values[i];
        e->is_near[i] = COTREE_FABS(g) <= band_at_kink(e, i, t);
        if (!e->is_near[i] && e->rows[i].direction == 0) freeze_branch(e, i, cotree_sign_of(g));
    }
    /* The rate of a value may depend on the branches of earlier values. */
    for (i = first; i < e->n_events && status == 0; ++i) {
        if (!e->is_near[i]) continue;
        if (!is_known) status = cotree_compute_rates(e, t, w);
        is_known = 0;
        freeze_branch(e, i, is_again ? COTREE_F(0.0) : cotree_sign_of(e->jumps.rates[i]));
    }
    if (status == 0) status = cotree_compute_values(e, t, w);
    cotree_copy(e->n_events, e->jumps.values, e->g);
    for (k = 0; k < e->n_quantities; ++k) e->quantity_mean_rate[k] = COTREE_INFINITY;
    for (i = first; i < e->n_events; ++i) {
        if (e->rows[i].direction != 0) e->side[i] = -(cotree_real)e->rows[i].direction;
        e->mean_rate[i] = COTREE_INFINITY;
    }
    return status;
}

/* Return whether only kinks were found and no modes have to be selected. */
int cotree_are_only_kinks(const cotree_events *e)
{
    int i;
    for (i = 0; i < e->n_events; ++i) {
        if (e->is_found[i] && !cotree_is_kink(e, i)) return 0;
    }
    return e->n_found > 0 && e->n_modes == 0;
}

/* Enter the next branches where no other event is due. */
int cotree_pass_kinks(cotree_events *e, cotree_real t, const cotree_real *w)
{
    int i;
    e->n_fired = e->n_found;
    e->is_mode_changed = 0;
    for (i = 0; i < e->n_events; ++i) e->has_fired[i] = e->is_found[i];
    if (cotree_select_branches(e, t, w) != 0) return e->failure;
    for (i = 0; i < e->n_events; ++i) {
        e->recent_scale[i] = COTREE_FABS(e->g[i]);
        if (!cotree_is_kink(e, i) && e->recent_scale[i] > cotree_rounding_band(e, i))
            e->side[i] = cotree_sign_of(e->g[i]);
    }
    return 0;
}

/* Return whether a step ended beyond a held branch, within the tolerance, or held none. */
int cotree_has_left_branch(const cotree_events *e, const cotree_real *g)
{
    int i;
    for (i = COTREE_EVENTS_OF(e->run->model->hybrid); i < e->n_events && e->branches != NULL; ++i) {
        if (e->side[i] * g[i] < COTREE_F(0.0)) return 1;
        /* A table that is not held is never beyond its branch. */
        if (e->rows[i].direction != 0 && e->branches[e->rows[i].branch] == COTREE_F(0.0)) return 1;
        if (e->side[i] == COTREE_F(0.0) && COTREE_FABS(g[i]) > cotree_zero_band(e, i)) return 1;
    }
    return 0;
}

/* Bound the quantities of nonlinear event functions over a step, from both ends and the mean
 * rates of the step before. */
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

/* Test the end of the step alone. Return REFINE if a kink may be reached, from the change in
 * this step and the mean rate in the last one. */
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
        is_far = is_far && e->branches[e->rows[i].branch] != COTREE_F(0.0);
        e->mean_rate[i] = COTREE_FABS(g - e->g[i]) / step;
    }
    if (!is_far) return REFINE;
    status = cotree_update_scales(e, e->t_after, e->end, e->jumps.values);
    cotree_copy(e->n_events, e->jumps.values, e->g);
    return status;
}
