/* cotree_locate.c: the first zero of an event function within a step, and the solution there.
 * Part of the runtime of cotree, the same for every model.
 */
#include "cotree_events_internal.h"

#include <float.h>
#include <math.h>
#include <stddef.h>

/* Takes a step by the classical Runge-Kutta method of order four. The three arrays of n
 * cotree_reals that it writes, the solution at the end first, differ from each other and from
 * before. */
static int take_classical_step(cotree_rate_function rate, void *context, int n, cotree_real t,
                               cotree_real t_next, cotree_real h, const cotree_real *before,
                               cotree_real *after, cotree_real *trial, cotree_real *slope)
{
    /* Where the next stage is, and what it weighs in the sum. */
    static const cotree_real share[4] = {COTREE_F(0.5), COTREE_F(0.5), COTREE_F(1.0),
                                         COTREE_F(0.0)},
                             weight[4] = {COTREE_F(1.0), COTREE_F(2.0), COTREE_F(2.0),
                                          COTREE_F(1.0)};
    const cotree_real middle = COTREE_F(0.5) * (t + t_next);
    const cotree_real at[4] = {t, middle, middle, t_next};
    int i, stage;
    for (i = 0; i < n; ++i) {
        trial[i] = before[i];
        after[i] = COTREE_F(0.0);
    }
    for (stage = 0; stage < 4; ++stage) {
        const int status = rate(at[stage], trial, slope, context);
        if (status != 0) return status;
        for (i = 0; i < n; ++i) {
            after[i] += weight[stage] * slope[i];
            trial[i] = before[i] + share[stage] * h * slope[i];
        }
    }
    for (i = 0; i < n; ++i) after[i] = before[i] + h / COTREE_F(6.0) * after[i];
    return 0;
}

typedef cotree_real (*value_function)(cotree_events *e, int i, cotree_real t);

cotree_real cotree_spacing(cotree_real t)
{
    return COTREE_NEXTAFTER(COTREE_FABS(t), COTREE_INFINITY) - COTREE_FABS(t);
}

cotree_real cotree_sign_of(cotree_real value)
{
    return value > COTREE_F(0.0)   ? COTREE_F(1.0)
           : value < COTREE_F(0.0) ? -COTREE_F(1.0)
                                   : COTREE_F(0.0);
}

void cotree_copy(int n, const cotree_real *from, cotree_real *to)
{
    int i;
    for (i = 0; i < n; ++i) to[i] = from[i];
}

/* What a value is uncertain by as far as the error test knows, and what of it is rounding. */
cotree_real cotree_tolerance(const cotree_events *e, int i)
{
    return e->rtol * e->recent_scale[i] + e->atol;
}

cotree_real cotree_rounding_band(const cotree_events *e, int i)
{
    const cotree_real rounding = COTREE_SCAN_ROUNDING * e->value_scale[i];
    if (e->n_modes == 0 || !e->stays_at_zero[i]) return rounding;
    if (e->zero_level[i] > COTREE_F(0.0)) return COTREE_FMAX(rounding, e->zero_level[i]);
    /* A speed that has not left zero yet is known as well as its terms, which may be large; a gap
     * that has not, as well as it was held. */
    return COTREE_FMAX(TERM_ROUNDINGS * rounding,
                       COTREE_FMAX(cotree_tolerance(e, i), COTREE_F(2.0) * e->gap_at_release[i]));
}

/* Whether an event is one of dry friction, which has modes for what comes to rest. */
int cotree_is_of_friction(const cotree_events *e, int i)
{
    return e->rows[i].kind >= COTREE_FRICTION_SLIP && e->rows[i].kind <= COTREE_FRICTION_LOAD;
}

int cotree_is_kink(const cotree_events *e, int i) { return e->rows[i].kind == COTREE_KINK; }

/* From where on a value counts as different from zero. At a kink rates are continuous, so that what
 * the error test does not know does no harm. */
cotree_real cotree_zero_band(const cotree_events *e, int i)
{
    const int is_continuous = cotree_is_kink(e, i) || e->is_continuous[i];
    return is_continuous ? COTREE_FMAX(cotree_rounding_band(e, i), cotree_tolerance(e, i))
                         : cotree_rounding_band(e, i);
}

/* How closely a corner is approached: what is left has effects of its square. */
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
    if (!cotree_run_is_constrained(e->run)) return 0;
    t = cotree_run_inside(e->run, t);
    return cotree_run_project(t, w, e->run) == 0 ? 0 : cotree_fail(e, 0, t, COTREE_EVENTS_FAILED);
}

/* Whether two events belong to one jump inside an expression. */
int cotree_is_of_same_jump(const cotree_events *e, int i, int k)
{
    return e->rows[i].kind == 1 && e->rows[k].kind == 1 &&
           e->rows[i].targets[0] == e->rows[k].targets[0];
}

/* Writes the change of rates from one side of a jump inside an expression to the other, and their
 * sizes; shift: the change of all values of events; value: that of its own event. */
static int compare_sides(cotree_events *e, int i, cotree_real t, const cotree_real *w,
                         cotree_real *change, cotree_real *size, cotree_real *shift,
                         cotree_real *value)
{
    cotree_real *const x = e->both_sides, *const held = x + 6 * e->run->n_full;
    const int n_pieces = e->branches == NULL ? 0 : e->n_branches;
    int k, status;
    /* Pieces belong to one side. */
    cotree_copy(n_pieces, e->branches, held);
    for (k = 0; k < n_pieces; ++k) e->branches[k] = COTREE_F(0.0);
    status = cotree_jumps_sides(&e->jumps, i, t, w, x, change, size);
    cotree_copy(n_pieces, held, e->branches);
    for (k = 0; k < e->run->n_rates; ++k) {
        const cotree_real now = change[k], other = size[k];
        change[k] = other - now;
        size[k] = COTREE_FMAX(COTREE_FABS(now), COTREE_FABS(other));
    }
    if (status == 0) status = cotree_jumps_values(&e->jumps, t, x);
    cotree_copy(e->n_events, e->jumps.values, shift);
    if (status == 0) status = cotree_jumps_values(&e->jumps, t, w);
    for (k = 0; k < e->n_events; ++k) {
        const int mode = e->rows[k].subtracts_mode ? e->rows[k].targets[0] : 0;
        shift[k] -= e->jumps.values[k];
        /* A value that counts from its mode changes with it, whatever it is the value of. */
        if (e->rows[k].subtracts_mode) shift[k] += x[mode] - w[mode];
    }
    *value = e->jumps.values[i];
    return status;
}

/* Whether a change at w vanishes where the value of a jump's event is zero: there it is
 * extrapolated from w and a point aside, at which the value is larger by one over share. Written so
 * that nan counts as a jump. */
static int vanishes_at_surface(cotree_real change, cotree_real aside, cotree_real share,
                               cotree_real least)
{
    const cotree_real at_zero = change - share * (aside - change);
    return COTREE_FMIN(COTREE_FABS(change), COTREE_FABS(at_zero)) <=
           COTREE_FMAX(least, COTREE_FABS(aside) / ASIDE_TOLERANCES);
}

/* Whether a jump inside an expression changes no rate, and no condition of a jump, where its value
 * is zero, close to w. The point aside is ever farther off until its value is by far, or there are
 * no rates: the change at w then stands for that at zero. */
int cotree_is_continuous(cotree_events *e, int i, cotree_real t, const cotree_real *w)
{
    const int n = e->run->n_rates, stride = e->run->n_full;
    cotree_real *const change = e->both_sides + stride, *const size = change + stride;
    cotree_real *const point = size + stride, *const aside = point + stride,
                       *const size_aside = aside + stride;
    cotree_real *const shift = e->shift, *const shift_aside = e->shift + e->n_events;
    cotree_real far = COTREE_F(1.0), g, g_aside = COTREE_F(0.0), share = COTREE_F(0.0);
    int k, m, status, is_same = 1, is_finite = 1;
    if (e->rows[i].kind != 1) return 0;
    status = compare_sides(e, i, t, w, change, size, shift, &g);
    for (m = 0; m < MAX_ASIDE_POINTS && status == 0; ++m) {
        far *= ASIDE_TOLERANCES;
        for (k = 0; k < n; ++k) {
            /* By different shares, so that differences of states change. What rests may be a mode.
             */
            const cotree_real known = e->rtol * COTREE_FABS(w[k]) + e->atol;
            point[k] =
                size[k] == COTREE_F(0.0) ? w[k] : w[k] + far * (cotree_real)(1 + k % 7) * known;
        }
        status = compare_sides(e, i, t, point, aside, size_aside, shift_aside, &g_aside);
        for (k = 0; k < n; ++k) is_finite = is_finite && COTREE_FABS(aside[k]) <= COTREE_MAX;
        if (!is_finite || COTREE_FABS(g_aside - g) >= ASIDE_VALUE_RATIO * COTREE_FABS(g)) break;
    }
    if (status == 0 && !is_finite) {
        cotree_copy(n, change, aside);
        cotree_copy(e->n_events, shift, shift_aside);
    }
    if (is_finite && g_aside != g) share = g / (g_aside - g);
    for (k = 0; k < n && status == 0; ++k) {
        const cotree_real least = (e->rtol * COTREE_FABS(w[k]) + e->atol) / e->span;
        is_same = is_same && vanishes_at_surface(change[k], aside[k], share,
                                                 COTREE_FMAX(least, SAME_RTOL * size[k]));
    }
    for (k = 0; k < e->n_events && status == 0; ++k) {
        if (e->rows[k].kind != 1) continue;
        is_same =
            is_same && vanishes_at_surface(shift[k], shift_aside[k], share, cotree_tolerance(e, k));
    }
    for (k = 0; k < e->n_events && status == 0; ++k) {
        if (cotree_is_of_same_jump(e, i, k)) e->is_continuous[k] = is_same;
    }
    return status == 0 && is_same;
}

/* Takes a short step, forwards or back, onto the constraints. result must not be w. */
static int take_short_step(cotree_events *e, cotree_real t, const cotree_real *w, cotree_real step,
                           cotree_real *result)
{
    const int status = take_classical_step(cotree_run_rate, e->run, e->n, t, t + step, step, w,
                                           result, e->scratch, e->slope);
    e->n_evaluations += 4;
    if (status != 0) return cotree_fail(e, 0, t, COTREE_EVENTS_FAILED);
    return cotree_project(e, t + step, result);
}

/* Writes second time derivatives, by differences; only their sizes matter. */
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

/* Writes the states within the last step; of a history, without sensitivities. */
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

/* By how much a value has to pass zero: where it stayed there, by more than it moves there. */
static cotree_real crossing_margin(const cotree_events *e, int i)
{
    return e->n_frictions > 0 && e->stays_at_zero[i] ? e->zero_level[i] : COTREE_F(0.0);
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

/* The value at a time that one short step from the start of the last step reaches; leaves the
 * point. */
static cotree_real value_after_step(cotree_events *e, int i, cotree_real t)
{
    const cotree_real step = t - e->t_before;
    if (take_short_step(e, e->t_before, e->start, step, e->other) != 0) return COTREE_F(0.0);
    return cotree_compute_values(e, t, e->other) == 0 ? e->jumps.values[i] + crossing_margin(e, i)
                                                      : COTREE_F(0.0);
}

/* Finds where sign times a function, positive at a and not at b, becomes zero: on b's side, to a
 * few roundings, or as close as a corner need be known. Halving each third time bounds how long
 * false position takes. */
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

/* Finds the root of a value between a, on one side of it, and b. */
cotree_real cotree_locate_root(cotree_events *e, int i, cotree_real a, cotree_real b,
                               cotree_real side)
{
    cotree_real from = a, width = b - a;
    int n;
    /* The way back to a start at zero, of which rounding has the wrong sign. */
    for (n = 0; n < MAX_HALVINGS && e->failure == 0; ++n) {
        if (side * value_at(e, i, from) > COTREE_F(0.0))
            return find_root(e, value_at, i, side, from, b);
        width *= COTREE_F(0.5);
        from = a + width;
    }
    return a;
}

cotree_real cotree_sample_time(const cotree_events *e, int k)
{
    return k == SAMPLES - 1 ? e->t_after
                            : e->t_before + (cotree_real)k / (cotree_real)(SAMPLES - 1) *
                                                (e->t_after - e->t_before);
}

/* Takes notice of values. The rounding of those that count from a mode is that of the mode, too. */
int cotree_update_scales(cotree_events *e, cotree_real t, const cotree_real *w,
                         const cotree_real *g)
{
    int i;
    for (i = 0; i < e->n_events; ++i) {
        const cotree_real counted =
            e->rows[i].subtracts_mode ? COTREE_FABS(w[e->rows[i].targets[0]]) : COTREE_F(0.0);
        if (!(COTREE_FABS(g[i]) <= COTREE_MAX)) {
            if (cotree_is_kink(e, i)) continue;
            return cotree_fail(e, i, t, COTREE_EVENTS_NOT_FINITE);
        }
        e->value_scale[i] = COTREE_FMAX(e->value_scale[i], COTREE_FABS(g[i]) + counted);
        e->recent_scale[i] = COTREE_FMAX(e->recent_scale[i], COTREE_FABS(g[i]));
    }
    return 0;
}

/* Looks at the last step in a few points. Where the polynomial may be far off, as among the first,
 * very short steps after a restart, nothing is learnt from it about the sizes of values. */
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

/* Whether any value that was looked at may come to zero within the step. */
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
        if (COTREE_FMIN(COTREE_FABS(low), COTREE_FABS(high)) <= COTREE_SCAN_FAR * (high - low))
            return 1;
    }
    return 0;
}

/* Takes the step anew in quarters, and looks at these. */
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
        if (status != 0) return cotree_sample_step(e); /* what there is has to do */
        cotree_history_add(&e->refined, t, e->point, e->slope);
    }
    cotree_history_add(&e->refined, h->t[last], e->end, h->rate[last]);
    e->h = &e->refined;
    e->is_coarse = 0;
    return cotree_sample_step(e);
}

/* Finds the sample in which a value on one side of zero is nearest to it, beside which it may turn
 * round there; SAMPLES: it does not come near. */
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
    return low > COTREE_SCAN_FAR * (high - low) ? SAMPLES : nearest;
}

/* Where a value on one side of zero turns round between two times, writes when and how far off.
 * Returns whether it does and may come to zero there. */
int cotree_find_extremum(cotree_events *e, int i, cotree_real a, cotree_real b, cotree_real before,
                         cotree_real after, cotree_real side, cotree_real *at, cotree_real *lowest)
{
    cotree_real left, right;
    if (after <= COTREE_F(0.0) || before < COTREE_F(0.0)) return 0;
    left = side * rate_at(e, i, a);
    right = side * rate_at(e, i, b);
    if (!(left < COTREE_F(0.0) && right > COTREE_F(0.0))) return 0;
    /* The tangents must meet below zero: the value does not come lower where it is convex. */
    if (before / -left + after / right > b - a) return 0;
    if (!e->is_fine) return 1;
    *at = find_root(e, rate_at, i, -side, a, b);
    *lowest = side * value_at(e, i, *at);
    return 1;
}

/* Repeats the last step as far as t. */
int cotree_solution_at(cotree_events *e, cotree_real t, cotree_real *w)
{
    if (t == e->t_before || t == e->t_after) {
        cotree_copy(e->n, t == e->t_before ? e->start : e->end, w);
        return 0;
    }
    return e->solution(t, w, e->context) == 0 ? 0 : cotree_fail(e, 0, t, COTREE_EVENTS_FAILED);
}

/* Takes Newton steps onto the root itself, with steps of the motion. Returns whether they get
 * there. */
static int polish_root(cotree_events *e, int i, cotree_real side)
{
    const cotree_real width = COTREE_F(0.1) * (e->t_after - e->t_before),
                      margin = crossing_margin(e, i);
    const cotree_real least = cotree_is_kink(e, i) ? kink_band(e, i) : cotree_rounding_band(e, i);
    const cotree_real near = margin > COTREE_F(0.0) ? COTREE_F(1e-3) * margin : least;
    cotree_real t = e->t;
    int n;
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
        if (COTREE_FABS(g) <= near || COTREE_FABS(g / rate) <= cotree_spacing(t))
            step = COTREE_F(0.0);
        if (step == COTREE_F(0.0)) {
            e->t = t;
            cotree_copy(e->n, e->point, e->w);
            return 1;
        }
        if (take_short_step(e, t, e->point, step, e->other) != 0) return 0;
        cotree_copy(e->n, e->other, e->point);
        t += step;
    }
    return 0;
}

/* Finds a crossing so soon after the start that what a step is read from does not show it well.
 * Returns whether the motion crosses. */
static int find_root_near_start(cotree_events *e, int i, cotree_real side)
{
    cotree_real width = e->t_after - e->t_before;
    int n;
    for (n = 0; n < MAX_HALVINGS && e->failure == 0; ++n) {
        if (side * value_after_step(e, i, e->t_before + width) > COTREE_F(0.0)) {
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

/* Goes to a crossing, as accurately as steps are. Returns whether the motion, seen closely,
 * crosses. */
int cotree_refine_root(cotree_events *e, cotree_real t, int i, cotree_real side)
{
    e->t = t;
    if (cotree_solution_at(e, t, e->w) != 0 || cotree_project(e, t, e->w) != 0) return 0;
    if (polish_root(e, i, side) || e->failure != 0) return e->failure == 0;
    /* A step so short that its error hides the value: what the method itself says is taken. */
    if (cotree_compute_rates(e, e->t, e->w) != 0) return 0;
    if (side * e->jumps.rates[i] < COTREE_F(0.0)) return 1;
    return find_root_near_start(e, i, side);
}
