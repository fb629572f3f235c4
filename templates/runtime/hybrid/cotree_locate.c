/* cotree_locate.c: zeros of event functions within a step, and the solution at these times. */
#include "cotree_events_internal.h"
#include "cotree_classical.h"

typedef cotree_real (*value_function)(cotree_events *e, int i, cotree_real t);

cotree_real cotree_spacing(cotree_real t)
{
    return COTREE_NEXTAFTER(COTREE_FABS(t), COTREE_INFINITY) - COTREE_FABS(t);
}

/* Return the uncertainty of an event function: cotree_tolerance due to the error tolerances, and
 * cotree_rounding_band due to rounding. */
cotree_real cotree_tolerance(const cotree_events *e, int i)
{
    return e->rtol * e->recent_scale[i] + e->atol;
}

cotree_real cotree_rounding_band(const cotree_events *e, int i)
{
    const cotree_real rounding = COTREE_SCAN_ROUNDING * e->value_scale[i];
    if (e->n_rows == 0 || !e->stays_at_zero[i]) return rounding;
    if (e->zero_level[i] > COTREE_F(0.0)) return COTREE_FMAX(rounding, e->zero_level[i]);
    /* A slip rate that has just left zero is only as accurate as its terms, which may be large. A
     * gap is only as accurate as it was when its stop opened. */
    return COTREE_FMAX(TERM_ROUNDINGS * rounding,
                       COTREE_FMAX(cotree_tolerance(e, i), COTREE_F(2.0) * e->gap_at_release[i]));
}

/* Return the magnitude above which an event function counts as nonzero. At a kink or a continuous
 * jump, errors within the tolerance have no effect. */
cotree_real cotree_zero_band(const cotree_events *e, int i)
{
    const cotree_real rounding = cotree_rounding_band(e, i);
    if (!cotree_is_kink(e, i) && !e->is_continuous[i]) return rounding;
    return COTREE_FMAX(COTREE_FMAX(rounding, e->state_error[i]), cotree_tolerance(e, i));
}

/* Return the distance from zero below which extrema are examined. With sensitivities, it includes
 * grazing extrema. */
cotree_real cotree_detection_level(const cotree_events *e, int i)
{
    const int has_grazing = e->run->n_blocks > 1 && !cotree_is_kink(e, i);
    return has_grazing ? GRAZING_TOLERANCES * cotree_tolerance(e, i) : -cotree_zero_band(e, i);
}

/* Return the accuracy to which a kink is located. The remaining error only has second-order
 * effects. */
static cotree_real kink_band(const cotree_events *e, int i)
{
    return COTREE_FMAX(cotree_rounding_band(e, i), COTREE_F(0.1) * cotree_tolerance(e, i));
}

int cotree_fail(cotree_events *e, int event, cotree_real t, int status)
{
    e->event = event;
    e->failure_time = t;
    e->failure = status;
    return status;
}

int cotree_compute_values(cotree_events *e, cotree_real t, const cotree_real *w)
{
    const int status = e->kernel_status = cotree_jumps_values(&e->jumps, t, w);
    return status == 0 ? 0 : cotree_fail(e, 0, t, COTREE_EVENTS_FAILED);
}

int cotree_compute_rates(cotree_events *e, cotree_real t, const cotree_real *w)
{
    const int status = e->kernel_status = cotree_jumps_rates(&e->jumps, t, w);
    return status == 0 ? 0 : cotree_fail(e, 0, t, COTREE_EVENTS_FAILED);
}

int cotree_project(cotree_events *e, cotree_real t, cotree_real *w)
{
#if COTREE_HAS_CONSTRAINTS
    if (!cotree_run_is_constrained(e->run)) return 0;
    t = cotree_run_inside(e->run, t);
    return cotree_run_project(t, w, e->run) == 0 ? 0 : cotree_fail(e, 0, t, COTREE_EVENTS_FAILED);
#else
    (void)e, (void)t, (void)w;
    return 0;
#endif
}

/* Return whether two events belong to the same discontinuous expression. */
int cotree_is_of_same_jump(const cotree_events *e, int i, int k)
{
    return e->events[i].kind == COTREE_JUMP && e->events[k].kind == 1 &&
           e->events[i].targets[0] == e->events[k].targets[0];
}

/* Compute the changes of all rates (with their magnitudes) and event functions across a jump, and
 * the value of the jump's event function. */
static int compare_sides(cotree_events *e, int i, cotree_real t, const cotree_real *w,
                         cotree_real *change, cotree_real *size, cotree_real *shift,
                         cotree_real *value)
{
    cotree_real *const x = e->both_sides, *const frozen = x + 6 * e->run->n_full;
    const int n_frozen = e->branches == NULL ? 0 : e->n_branches;
    int k, status;
    /* The frozen branches are only valid on the current side. */
    cotree_copy(n_frozen, e->branches, frozen);
    cotree_release_branches(e);
    status = cotree_jumps_sides(&e->jumps, i, t, w, x, change, size);
    cotree_copy(n_frozen, frozen, e->branches);
    for (k = 0; k < e->run->n_rates; ++k) {
        const cotree_real now = change[k], other = size[k];
        change[k] = other - now;
        size[k] = COTREE_FMAX(COTREE_FABS(now), COTREE_FABS(other));
    }
    if (status == 0) status = cotree_jumps_values(&e->jumps, t, x);
    cotree_copy(e->n_events, e->jumps.values, shift);
    if (status == 0) status = cotree_jumps_values(&e->jumps, t, w);
    for (k = 0; k < e->n_events; ++k) {
        const int mode = e->events[k].subtracts_mode ? e->events[k].targets[0] : 0;
        shift[k] -= e->jumps.values[k];
        /* The function is a value minus a mode: count only the change of the value. */
        if (e->events[k].subtracts_mode) shift[k] += x[mode] - w[mode];
    }
    *value = e->jumps.values[i];
    return status;
}

/* Return whether a change, extrapolated from w and a second point, is zero at the switching
 * surface. fraction: g / (g_aside - g). A nan counts as a jump. */
static int vanishes_at_surface(cotree_real change, cotree_real aside, cotree_real fraction,
                               cotree_real least)
{
    const cotree_real at_zero = change - fraction * (aside - change);
    return COTREE_FMIN(COTREE_FABS(change), COTREE_FABS(at_zero)) <=
           COTREE_FMAX(least, COTREE_FABS(aside) / ASIDE_TOLERANCES);
}

/* Return whether a jump is continuous at its switching surface near w: no rate and no event
 * function of another jump changes. The second point moves away until its value of the event
 * function dominates. If the rates are not finite there, the change at w is used. */
int cotree_is_continuous(cotree_events *e, int i, cotree_real t, const cotree_real *w)
{
    const int n = e->run->n_rates, stride = e->run->n_full;
    cotree_real *const change = e->both_sides + stride, *const size = change + stride;
    cotree_real *const point = size + stride, *const aside = point + stride,
                       *const size_aside = aside + stride;
    cotree_real *const shift = e->shift, *const shift_aside = e->shift + e->n_events;
    cotree_real n_tolerances = COTREE_F(1.0), g, g_aside = COTREE_F(0.0), fraction = COTREE_F(0.0);
    int k, m, status, is_same = 1, is_finite = 1;
    if (e->events[i].kind != COTREE_JUMP) return 0;
    status = compare_sides(e, i, t, w, change, size, shift, &g);
    for (m = 0; m < MAX_ASIDE_POINTS && status == 0; ++m) {
        n_tolerances *= ASIDE_TOLERANCES;
        for (k = 0; k < n; ++k) {
            /* Each state changes by a different fraction, so that differences of states change,
             * too. States without a rate may be modes, so they are not changed. */
            const cotree_real known = e->rtol * COTREE_FABS(w[k]) + e->atol;
            point[k] = size[k] == COTREE_F(0.0)
                           ? w[k]
                           : w[k] + n_tolerances * (cotree_real)(1 + k % 7) * known;
        }
        status = compare_sides(e, i, t, point, aside, size_aside, shift_aside, &g_aside);
        for (k = 0; k < n; ++k) is_finite = is_finite && COTREE_FABS(aside[k]) <= COTREE_MAX;
        if (!is_finite || COTREE_FABS(g_aside - g) >= ASIDE_VALUE_RATIO * COTREE_FABS(g)) break;
    }
    if (status == 0 && !is_finite) {
        cotree_copy(n, change, aside);
        cotree_copy(e->n_events, shift, shift_aside);
    }
    if (is_finite && g_aside != g) fraction = g / (g_aside - g);
    for (k = 0; k < n && status == 0; ++k) {
        const cotree_real least = (e->rtol * COTREE_FABS(w[k]) + e->atol) / e->span;
        is_same = is_same && vanishes_at_surface(change[k], aside[k], fraction,
                                                 COTREE_FMAX(least, SAME_RTOL * size[k]));
    }
    for (k = 0; k < e->n_events && status == 0; ++k) {
        if (e->events[k].kind != COTREE_JUMP) continue;
        is_same = is_same &&
                  vanishes_at_surface(shift[k], shift_aside[k], fraction, cotree_tolerance(e, k));
    }
    for (k = 0; k < e->n_events && status == 0; ++k) {
        if (cotree_is_of_same_jump(e, i, k)) e->is_continuous[k] = is_same;
    }
    return status == 0 && is_same;
}

/* Take a short step, forwards or backwards, and project its end onto the constraints. result must
 * not be w. */
static int take_short_step(cotree_events *e, cotree_real t, const cotree_real *w, cotree_real step,
                           cotree_real *result)
{
    const int status = cotree_take_classical_step(cotree_run_rate, e->run, e->n, t, t + step, step,
                                                  w, result, e->scratch, e->slope);
    e->n_evaluations += 4;
    if (status != 0) return cotree_fail(e, 0, t, COTREE_EVENTS_FAILED);
    return cotree_project(e, t + step, result);
}

/* Return whether a short step from w to other is stable: the rate at its end predicts the change in
 * the step, with an error within the change or the tolerance. In a stiff equation the error grows
 * with each stage. */
static int is_stable_step(const cotree_events *e, const cotree_real *w, cotree_real step)
{
    int i;
    for (i = 0; i < e->n; ++i) {
        const cotree_real change = e->other[i] - w[i], error = step * e->slope[i] - change;
        const cotree_real least = e->rtol * COTREE_FABS(w[i]) + e->atol;
        if (!(COTREE_FABS(error) <= COTREE_FABS(change) + least)) return 0; /* also for nan */
    }
    return 1;
}

/* Return the sign of an event function that is zero at w, after a short step from w: the rate at w
 * may belong to a branch that ends there. If the value remains near zero, return the sign of the
 * rate. */
cotree_real cotree_side_after(cotree_events *e, int i, cotree_real t, const cotree_real *w)
{
    cotree_real far, near, rate, step = CURVATURE_STEP_SHARE * e->span;
    if (cotree_compute_values(e, t, w) != 0 || cotree_compute_rates(e, t, w) != 0)
        return COTREE_F(0.0);
    near = COTREE_FMAX(COTREE_FABS(e->jumps.values[i]), cotree_rounding_band(e, i));
    /* The step must exceed rounding errors of the states, which the event function may amplify. */
    far = COTREE_FMAX(COTREE_F(4.0) * near, cotree_tolerance(e, i));
    rate = e->jumps.rates[i];
    if (far < step * COTREE_FABS(rate)) step = far / COTREE_FABS(rate);
    if (take_short_step(e, t, w, step, e->other) != 0) return COTREE_F(0.0);
    if (!is_stable_step(e, w, step)) return cotree_sign_of(rate);
    if (cotree_compute_values(e, t + step, e->other) != 0) return COTREE_F(0.0);
    return COTREE_FABS(e->jumps.values[i]) > near ? cotree_sign_of(e->jumps.values[i])
                                                  : cotree_sign_of(rate);
}

/* Compute the second time derivatives of all event functions by forward differences. */
int cotree_compute_curvature(cotree_events *e, cotree_real t, const cotree_real *w)
{
    const cotree_real step = CURVATURE_STEP_SHARE * e->span;
    int i, status = cotree_compute_rates(e, t, w);
    cotree_copy(e->n_events, e->jumps.rates, e->curvature);
    if (status == 0) status = take_short_step(e, t, w, step, e->other);
    if (status == 0) status = cotree_compute_rates(e, t + step, e->other);
    for (i = 0; i < e->n_events; ++i)
        e->curvature[i] = (e->jumps.rates[i] - e->curvature[i]) / step;
    return status;
}

/* Interpolate the states, but not the sensitivities, within the last step. */
int cotree_interpolate(cotree_events *e, cotree_real t, cotree_real *w)
{
    const int n = e->run->n_rates;
    if (t == e->t_before || t == e->t_after) {
        cotree_copy(n, t == e->t_before ? e->start : e->end, w);
    } else if (e->h == NULL) {
        if (e->solution(t, w, e->context) != 0) return cotree_fail(e, 0, t, COTREE_EVENTS_FAILED);
    } else {
        cotree_history view = *e->h;
        view.n = n;
        cotree_history_read(&view, t, w);
    }
    return 0;
}

/* Return the distance by which an event function must cross zero to count as crossed: for a force
 * at its limit, its zero level; for a slip that stays at zero, its rounding band. */
static cotree_real crossing_margin(const cotree_events *e, int i)
{
    if (e->n_rows == 0 || !e->stays_at_zero[i]) return COTREE_F(0.0);
    return e->events[i].kind == COTREE_FRICTION_SLIP ? cotree_rounding_band(e, i)
                                                     : e->zero_level[i];
}

static cotree_real value_at(cotree_events *e, int i, cotree_real t)
{
    if (cotree_interpolate(e, t, e->point) != 0) return COTREE_F(0.0);
    return cotree_compute_values(e, t, e->point) == 0 ? e->jumps.values[i] + crossing_margin(e, i)
                                                      : COTREE_F(0.0);
}

static cotree_real rate_at(cotree_events *e, int i, cotree_real t)
{
    if (cotree_interpolate(e, t, e->point) != 0) return COTREE_F(0.0);
    return cotree_compute_rates(e, t, e->point) == 0 ? e->jumps.rates[i] : COTREE_F(0.0);
}

/* Return the value at t, computed by one short step from the start of the last step. Write the
 * point to e->other. */
static cotree_real value_after_step(cotree_events *e, int i, cotree_real t)
{
    const cotree_real step = t - e->t_before;
    if (take_short_step(e, e->t_before, e->start, step, e->other) != 0) return COTREE_F(0.0);
    return cotree_compute_values(e, t, e->other) == 0 ? e->jumps.values[i] + crossing_margin(e, i)
                                                      : COTREE_F(0.0);
}

/* Return the zero of sign times f between a, where it is positive, and b, where it is not. The
 * result is on the side of b, accurate to a few roundings or to the band of a kink. Illinois method
 * (false position); every third iteration bisects, which bounds the number of iterations. */
static cotree_real find_root(cotree_events *e, value_function f, int i, cotree_real sign,
                             cotree_real a, cotree_real b)
{
    const cotree_real enough =
        cotree_is_kink(e, i) && f != rate_at ? kink_band(e, i) : COTREE_F(0.0);
    cotree_real at_a = sign * f(e, i, a), at_b = sign * f(e, i, b), found = at_b;
    int n, same = 0;
    for (n = 0; n < MAX_ROOT_ITERATIONS && e->failure == 0; ++n) {
        cotree_real t = a + (b - a) * (at_a / (at_a - at_b)), value;
        if (COTREE_FABS(b - a) <= COTREE_F(4.0) * cotree_spacing(b) || found >= -enough) break;
        if (n % 3 == 2 || !(t > COTREE_FMIN(a, b) && t < COTREE_FMAX(a, b)))
            t = COTREE_F(0.5) * (a + b);
        if (t == a || t == b) break;
        value = sign * f(e, i, t);
        if (value > COTREE_F(0.0)) {
            a = t;
            at_a = value;
            if (same == 1) at_b *= COTREE_F(0.5);
            same = 1;
        } else {
            b = t;
            at_b = found = value;
            if (same == -1) at_a *= COTREE_F(0.5);
            same = -1;
        }
    }
    return b;
}

/* Locate the zero of an event function between a, where its sign is `side`, and b. */
cotree_real cotree_locate_root(cotree_events *e, int i, cotree_real a, cotree_real b,
                               cotree_real side)
{
    const cotree_real least = cotree_rounding_band(e, i), at_a = side * value_at(e, i, a);
    cotree_real from = a, width = b - a, value = at_a;
    int n;
    /* If the value starts at zero, its sign is due to rounding: move towards b. */
    for (n = 0; n < MAX_HALVINGS && e->failure == 0; ++n) {
        if (value > least) return find_root(e, value_at, i, side, from, b);
        width *= COTREE_F(0.5);
        from = a + width;
        value = side * value_at(e, i, from);
    }
    return at_a > COTREE_F(0.0) ? find_root(e, value_at, i, side, a, b) : a;
}

cotree_real cotree_sample_time(const cotree_events *e, int k)
{
    return k == SAMPLES - 1 ? e->t_after
                            : e->t_before + (cotree_real)k / (cotree_real)(SAMPLES - 1) *
                                                (e->t_after - e->t_before);
}

/* Update the scales of the event functions. A value minus a mode has the rounding error of the
 * mode. */
int cotree_update_scales(cotree_events *e, cotree_real t, const cotree_real *w,
                         const cotree_real *g)
{
    int i;
    for (i = 0; i < e->n_events; ++i) {
        const cotree_real mode =
            e->events[i].subtracts_mode ? COTREE_FABS(w[e->events[i].targets[0]]) : COTREE_F(0.0);
        if (!(COTREE_FABS(g[i]) <= COTREE_MAX)) {
            if (cotree_is_kink(e, i)) continue;
            return cotree_fail(e, i, t, COTREE_EVENTS_NOT_FINITE);
        }
        e->value_scale[i] = cotree_larger(e->value_scale[i], COTREE_FABS(g[i]) + mode);
        e->recent_scale[i] = cotree_larger(e->recent_scale[i], COTREE_FABS(g[i]));
    }
    return 0;
}

/* Sample the event functions in the last step. The scales are not updated if interpolation is
 * inaccurate, as in the first short steps after a restart. */
int cotree_sample_step(cotree_events *e)
{
    int k, status = 0;
    if (e->n_quantities > 0) {
        status = cotree_compute_values(e, e->t_before, e->start);
        cotree_copy(e->n_quantities, cotree_quantities_of(e), e->quantity_samples);
    }
    cotree_copy(e->n_events, e->g, e->samples);
    for (k = 1; k < SAMPLES && status == 0; ++k) {
        const cotree_real t = cotree_sample_time(e, k);
        status = cotree_interpolate(e, t, e->point);
        if (status == 0) status = cotree_compute_values(e, t, e->point);
        cotree_copy(e->n_events, e->jumps.values, e->samples + k * e->n_events);
        if (e->n_quantities > 0)
            cotree_copy(e->n_quantities, cotree_quantities_of(e),
                        e->quantity_samples + k * e->n_quantities);
        if (status != 0 || (e->is_coarse && k < SAMPLES - 1)) continue;
        status = cotree_update_scales(e, t, e->point, e->samples + k * e->n_events);
    }
    return status;
}

/* Return whether any sampled event function may reach zero within the step. */
int cotree_may_cross(const cotree_events *e)
{
    int i, k;
    for (i = 0; i < e->n_events; ++i) {
        cotree_real low = e->samples[i], high = low;
        for (k = 1; k < SAMPLES; ++k) {
            low = COTREE_FMIN(low, e->samples[k * e->n_events + i]);
            high = COTREE_FMAX(high, e->samples[k * e->n_events + i]);
        }
        if (low <= COTREE_F(0.0) && high >= COTREE_F(0.0)) return 1;
        if (COTREE_FMIN(COTREE_FABS(low), COTREE_FABS(high)) <= COTREE_SCAN_REACH * (high - low))
            return 1;
    }
    return 0;
}

/* Repeat the step in four quarters, and sample their ends. */
int cotree_refine_step(cotree_events *e)
{
    const cotree_history *const h = e->h;
    const int last = h->n_points - 1;
    int i, k;
    e->is_fine = e->is_refined = 1;
    cotree_history_init(&e->refined, e->n, e->refined.y[0]);
    e->refined.uses_rates = h->uses_rates;
    cotree_history_add(&e->refined, h->t[last - 1], e->start, h->rate[last - 1]);
    for (k = 1; k < SAMPLES - 1; ++k) {
        const cotree_real t = cotree_sample_time(e, k);
        int status = e->solution(t, e->point, e->context);
        for (i = 0; i < e->n; ++i) e->slope[i] = COTREE_F(0.0);
        if (status == 0 && h->uses_rates) {
            ++e->n_evaluations;
            status = cotree_run_rate(t, e->point, e->slope, e->run);
        }
        /* If the integration fails, use the coarse samples. */
        if (status != 0) return cotree_sample_step(e);
        cotree_history_add(&e->refined, t, e->point, e->slope);
    }
    cotree_history_add(&e->refined, h->t[last], e->end, h->rate[last]);
    e->h = &e->refined;
    e->is_coarse = 0;
    return cotree_sample_step(e);
}

/* Return the sample that is nearest to zero on one side, if an extremum near it may cross zero,
 * else SAMPLES. */
int cotree_find_nearest_sample(const cotree_events *e, int i, cotree_real side)
{
    const cotree_real *const g = e->samples + i;
    const int n = e->n_events;
    cotree_real low = COTREE_INFINITY, high = -COTREE_INFINITY;
    int nearest = 0, m;
    for (m = 0; m < SAMPLES; ++m) {
        if (side * g[m * n] < low) nearest = m;
        low = COTREE_FMIN(low, side * g[m * n]);
        high = COTREE_FMAX(high, side * g[m * n]);
    }
    return low > COTREE_SCAN_REACH * (high - low) ? SAMPLES : nearest;
}

/* Find an extremum of an event function between two times, and its distance from zero. Return
 * whether there is an extremum that may reach zero. */
int cotree_find_extremum(cotree_events *e, int i, cotree_real a, cotree_real b, cotree_real before,
                         cotree_real after, cotree_real side, cotree_real *at, cotree_real *lowest)
{
    const cotree_real least = COTREE_FMAX(cotree_detection_level(e, i), COTREE_F(0.0));
    cotree_real left, right;
    if (after <= COTREE_F(0.0) || before < COTREE_F(0.0)) return 0;
    left = side * rate_at(e, i, a);
    right = side * rate_at(e, i, b);
    if (!(left < COTREE_F(0.0) && right > COTREE_F(0.0))) return 0;
    /* The tangents at both ends bound a convex function from below: they must intersect below
     * `least`. */
    if ((before - least) / -left + (after - least) / right > b - a) return 0;
    if (!e->is_fine) return 1;
    *at = find_root(e, rate_at, i, -side, a, b);
    *lowest = side * value_at(e, i, *at);
    return 1;
}

/* Compute the solution at t within the last step. */
int cotree_solution_at(cotree_events *e, cotree_real t, cotree_real *w)
{
    if (t == e->t_before || t == e->t_after) {
        cotree_copy(e->n, t == e->t_before ? e->start : e->end, w);
        return 0;
    }
    return e->solution(t, w, e->context) == 0 ? 0 : cotree_fail(e, 0, t, COTREE_EVENTS_FAILED);
}

/* Return the rate of an event function, times `side`, one short step from w. Write the point to
 * result. */
static cotree_real rate_beside(cotree_events *e, int i, cotree_real t, const cotree_real *w,
                               cotree_real step, cotree_real side, cotree_real *result)
{
    if (take_short_step(e, t, w, step, result) != 0) return COTREE_F(0.0);
    return cotree_compute_rates(e, t + step, result) == 0 ? side * e->jumps.rates[i]
                                                          : COTREE_F(0.0);
}

/* Return whether the value at an extremum near w depends on a parameter. At a kink it does not if
 * the zeros on both sides have the same derivatives of time; at a smooth extremum, if its
 * derivatives are zero. */
int cotree_moves_extremum(cotree_events *e, int i, cotree_real t, cotree_real *w, cotree_real side)
{
    cotree_real low, high = COTREE_F(8.0) * cotree_spacing(t);
    int n, is_same = 0;
    for (n = 0; n < MAX_HALVINGS && e->failure == 0; ++n) {
        if (rate_beside(e, i, t, w, -high, side, e->point) < COTREE_F(0.0) &&
            rate_beside(e, i, t, w, high, side, e->other) > COTREE_F(0.0))
            break;
        high *= COTREE_F(2.0);
    }
    low = -high;
    for (; n < MAX_HALVINGS && high - low > COTREE_F(16.0) * cotree_spacing(t); ++n) {
        const cotree_real middle = COTREE_F(0.5) * (low + high);
        if (rate_beside(e, i, t, w, middle, side, e->point) < COTREE_F(0.0))
            low = middle;
        else
            high = middle;
    }
    if (take_short_step(e, t, w, low, e->point) != 0 ||
        take_short_step(e, t, w, high, e->other) != 0)
        return 1;
    e->kernel_status =
        cotree_jumps_compare_times(&e->jumps, i, t + low, e->point, t + high, e->other, &is_same);
    return e->kernel_status != 0 || !is_same;
}

/* Largest error of a root's time that is due to rounding of the states, in units in the last
 * place. */
#define RESIDUAL_SPACINGS COTREE_F(64.0)

/* Refine a root by Newton's method, with short steps of the solution. Return whether it
 * converges. */
static int polish_root(cotree_events *e, int i, cotree_real side)
{
    const cotree_real width = COTREE_F(0.1) * (e->t_after - e->t_before),
                      margin = crossing_margin(e, i);
    const cotree_real least = cotree_is_kink(e, i) ? kink_band(e, i) : cotree_rounding_band(e, i);
    const cotree_real near = margin > COTREE_F(0.0) ? COTREE_F(1e-3) * margin : least;
    cotree_real t = e->t, last = COTREE_INFINITY;
    int n, is_rounding;
    cotree_copy(e->n, e->w, e->point);
    for (n = 0; n < MAX_NEWTON_STEPS; ++n) {
        cotree_real g, rate, step, low, high;
        if (cotree_compute_values(e, t, e->point) != 0 || cotree_compute_rates(e, t, e->point) != 0)
            return 0;
        g = e->jumps.values[i] + margin;
        rate = e->jumps.rates[i];
        if (rate == COTREE_F(0.0) || side * rate > COTREE_F(0.0)) return 0;
        step = -g / rate;
        low = COTREE_FMAX(e->t_before - t, -width);
        high = COTREE_FMIN(e->t_end - t, width);
        step = COTREE_FMIN(COTREE_FMAX(step, low), high);
        /* Rounding of the states may leave a residual that no step reduces. */
        is_rounding = COTREE_FABS(g) >= last &&
                      COTREE_FABS(g / rate) <= RESIDUAL_SPACINGS * cotree_spacing(t);
        last = COTREE_FABS(g);
        if (is_rounding || last <= near || COTREE_FABS(g / rate) <= cotree_spacing(t))
            step = COTREE_F(0.0);
        if (step == COTREE_F(0.0)) {
            e->t = t;
            cotree_copy(e->n, e->point, e->w);
            return 1;
        }
        if (take_short_step(e, t, e->point, step, e->other) != 0) return 0;
        if (!is_stable_step(e, e->point, step)) return 0;
        cotree_copy(e->n, e->other, e->point);
        t += step;
    }
    return 0;
}

/* Find a root that is so close to the start of the step that interpolation does not resolve it.
 * Return whether there is one. If no short step resolves it either, use the integrator's
 * solution. */
static int find_root_near_start(cotree_events *e, int i, cotree_real side)
{
    cotree_real width = e->t_after - e->t_before;
    int n;
    for (n = 0; n < MAX_HALVINGS && e->failure == 0; ++n) {
        const cotree_real value = value_after_step(e, i, e->t_before + width);
        if (n == 0 && !is_stable_step(e, e->start, width)) return e->failure == 0;
        if (side * value > COTREE_F(0.0)) {
            e->t = e->t_after;
            if (n > 0) {
                e->t = find_root(e, value_after_step, i, side, e->t_before + width,
                                 e->t_before + COTREE_F(2.0) * width);
            }
            value_after_step(e, i, e->t);
            cotree_copy(e->n, e->other, e->w);
            return n > 0;
        }
        width *= COTREE_F(0.5);
    }
    e->t = e->t_before;
    cotree_copy(e->n, e->start, e->w);
    return 1;
}

/* Compute the time and the solution at a crossing to the accuracy of the steps. Return whether the
 * event function crosses zero there. */
int cotree_refine_root(cotree_events *e, cotree_real t, int i, cotree_real side)
{
    e->t = t;
    if (cotree_solution_at(e, t, e->w) != 0 || cotree_project(e, t, e->w) != 0) return 0;
    if (polish_root(e, i, side) || e->failure != 0) return e->failure == 0;
    /* In a very short step the value is below its error: accept the integrator's solution. */
    if (cotree_compute_rates(e, e->t, e->w) != 0) return 0;
    if (side * e->jumps.rates[i] < COTREE_F(0.0)) return 1;
    return find_root_near_start(e, i, side);
}
