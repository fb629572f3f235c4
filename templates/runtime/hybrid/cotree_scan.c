/* cotree_scan.c: interval bounds of nonlinear event functions, and the search for their zeros.
 *
 * The kernel event_ranges bounds an event function and its rate over an interval, given bounds of
 * the quantities on which it depends. The intervals of a step are bisected until, in each one, the
 * function has no zero or its rate has one sign. Its signs at both ends then show whether it
 * crosses zero. */
#include "cotree_events_internal.h"

/* Set the bounds of all quantities between two points, given their second differences. */
static void set_bounds_between(cotree_events *e, const cotree_real *a, const cotree_real *b,
                               const cotree_real *bends, cotree_real width)
{
    int k;
    for (k = 0; k < e->n_quantities; ++k) {
        const cotree_real slope = (b[k] - a[k]) / width;
        cotree_set_bounds(e->box, e->n_quantities, k, cotree_smaller(a[k], b[k]),
                          cotree_larger(a[k], b[k]), bends[k]);
        cotree_set_rate_bounds(e->box, e->n_quantities, k, slope, slope, bends[k] / width);
    }
}

/* Compute the ranges over an interval. All values except quantities are those at the last
 * evaluation. */
int cotree_compute_ranges(cotree_events *e, cotree_real t)
{
    const int status = e->kernel_status = cotree_jumps_ranges(&e->jumps, t, e->box, e->ranges);
    return status == 0 ? 0 : cotree_fail(e, 0, t, COTREE_EVENTS_FAILED);
}

/* Classify an event function over an interval of the given width, from its range and its values at
 * both ends. If any of these is nan, the function is undecided. */
int cotree_classify_range(const cotree_events *e, int i, cotree_real side, cotree_real at_a,
                          cotree_real at_b, cotree_real width)
{
    const cotree_side_range r =
        cotree_range_on_side(e->ranges + N_BOUNDS * e->events[i].range, side);
    const cotree_real least = cotree_detection_level(e, i), a = side * at_a, b = side * at_b;
    if (r.low > least) return RANGE_NONZERO;
    if (cotree_is_monotone(r)) return RANGE_MONOTONE;
    if (b > least && cotree_lower_bound(r, a, b, width) > least) return RANGE_NONZERO;
    return RANGE_UNDECIDED;
}

/* Maximum number of bisections in a step. If more are needed, the step is repeated up to the end of
 * the decided intervals. */
#define MAX_DIVISIONS 500

/* At this bisection depth, a zero between values of opposite sign can be located. */
#define LOCATABLE_DEPTH 16

/* A step is repeated only if it keeps at least this fraction of its length. */
#define MIN_PROGRESS_SHARE COTREE_F(1e-3)

/* An entry of the stack describes one end of an interval: the time, the values, the quantities, and
 * their second differences. */
#define ENTRY(e, depth) ((e)->stack + (depth) * (1 + (e)->n_events + 2 * (e)->n_quantities))
#define N_ENTRY(e) (1 + (e)->n_events + 2 * (e)->n_quantities)
#define VALUES_OF(mark) ((mark) + 1)
#define QUANTITIES_OF(e, mark) ((mark) + 1 + (e)->n_events)
#define BENDS_OF(e, mark) ((mark) + 1 + (e)->n_events + (e)->n_quantities)

static void set_entry(const cotree_events *e, cotree_real *mark, cotree_real t,
                      const cotree_real *g, const cotree_real *quantities)
{
    mark[0] = t;
    cotree_copy(e->n_events, g, VALUES_OF(mark));
    cotree_copy(e->n_quantities, quantities, QUANTITIES_OF(e, mark));
}

/* Set a stack entry from sample k. Each second difference is the larger one of the two at the ends
 * of the interval before the sample. */
static void set_sample_entry(const cotree_events *e, cotree_real *mark, int k)
{
    const cotree_real *const q = e->quantity_samples;
    const int n = e->n_quantities;
    int i, m;
    set_entry(e, mark, cotree_sample_time(e, k), e->samples + k * e->n_events, q + k * n);
    for (i = 0; i < n; ++i) {
        cotree_real bend = COTREE_F(0.0);
        for (m = k - 1; m <= k; ++m) {
            if (m < 1 || m > SAMPLES - 2) continue;
            bend =
                cotree_larger(bend, COTREE_FABS(q[(m - 1) * n + i] - COTREE_F(2.0) * q[m * n + i] +
                                                q[(m + 1) * n + i]));
        }
        BENDS_OF(e, mark)[i] = bend;
    }
}

/* Set the stack entry of an interval's midpoint. The second differences of both halves are a
 * quarter of those of the interval. They may decrease faster, but not below a sixteenth. */
static int set_middle_entry(cotree_events *e, const cotree_real *left, cotree_real *right,
                            cotree_real *middle)
{
    const cotree_real t = COTREE_F(0.5) * (left[0] + right[0]);
    const cotree_real *const a = QUANTITIES_OF(e, left), *const b = QUANTITIES_OF(e, right);
    int k, status = cotree_interpolate(e, t, e->point);
    if (status == 0) status = cotree_compute_values(e, t, e->point);
    set_entry(e, middle, t, e->jumps.values, cotree_quantities_of(e));
    for (k = 0; k < e->n_quantities; ++k) {
        const cotree_real bend =
            COTREE_FABS(a[k] - COTREE_F(2.0) * QUANTITIES_OF(e, middle)[k] + b[k]);
        BENDS_OF(e, middle)[k] = COTREE_FMAX(bend, COTREE_F(0.0625) * BENDS_OF(e, right)[k]);
        BENDS_OF(e, right)[k] = BENDS_OF(e, middle)[k];
    }
    return status;
}

/* Return whether an event function is zero over the whole interval of its last range, as the
 * distance of a sliding friction force from its limit is. */
static int is_zero_over_range(const cotree_events *e, int i)
{
    const cotree_real *const r = e->ranges + N_BOUNDS * e->events[i].range;
    return r[0] == COTREE_F(0.0) && r[1] == COTREE_F(0.0) && r[2] == COTREE_F(0.0) &&
           r[3] == COTREE_F(0.0);
}

/* List the event functions that may cross zero within the step, according to their bounds over it.
 * Return their number. */
static int list_candidates(cotree_events *e)
{
    const cotree_real *const q = e->quantity_samples, *const last =
                                                          e->samples + (SAMPLES - 1) * e->n_events;
    const cotree_real width = (e->t_after - e->t_before) / (cotree_real)(SAMPLES - 1);
    const int n = e->n_quantities;
    int i, k, n_open = 0;
    for (i = 0; i < n; ++i) {
        cotree_real low = q[i], high = q[i], slow = COTREE_INFINITY, fast = -COTREE_INFINITY,
                    bend = COTREE_F(0.0);
        for (k = 1; k < SAMPLES; ++k) {
            const cotree_real value = q[k * n + i], step = value - q[(k - 1) * n + i];
            low = cotree_smaller(low, value);
            high = cotree_larger(high, value);
            slow = cotree_smaller(slow, step);
            fast = cotree_larger(fast, step);
            if (k > 1)
                bend = cotree_larger(bend,
                                     COTREE_FABS(step - q[(k - 1) * n + i] + q[(k - 2) * n + i]));
        }
        cotree_set_bounds(e->box, n, i, low, high, bend);
        cotree_set_rate_bounds(e->box, n, i, slow / width, fast / width, bend / width);
    }
    if (cotree_compute_ranges(e, e->t_after) != 0) return 0;
    for (i = 0; i < e->n_events; ++i) {
        const cotree_real side = e->side[i];
        e->is_candidate[i] = cotree_has_range(e, i) && !cotree_stays_at_zero(e, i);
        if (!e->is_candidate[i]) continue;
        e->is_found[i] = 0;
        e->from_side[i] = side;
        e->bracket_start[i] = e->t_before;
        if (side == COTREE_F(0.0)
                ? is_zero_over_range(e, i)
                : cotree_classify_range(e, i, side, e->g[i], last[i], e->t_after - e->t_before) ==
                      RANGE_NONZERO) {
            e->is_excluded[i] = 1;
        } else {
            ++n_open;
        }
    }
    return n_open;
}

/* Return whether any event function requires that an interval be bisected. */
static int must_divide(cotree_events *e, const cotree_real *left, const cotree_real *right,
                       int depth)
{
    const cotree_real width = right[0] - left[0];
    int i, is_any = 0;
    set_bounds_between(e, QUANTITIES_OF(e, left), QUANTITIES_OF(e, right), BENDS_OF(e, right),
                       width);
    if (cotree_compute_ranges(e, right[0]) != 0) return 0;
    for (i = 0; i < e->n_events; ++i) {
        const cotree_real at_end = e->from_side[i] * VALUES_OF(right)[i];
        e->is_near[i] = 0;
        if (!e->is_candidate[i] || e->is_excluded[i] || e->from_side[i] == COTREE_F(0.0)) continue;
        if (depth >= LOCATABLE_DEPTH && at_end < -cotree_zero_band(e, i)) continue;
        e->is_near[i] = cotree_classify_range(e, i, e->from_side[i], VALUES_OF(left)[i],
                                              VALUES_OF(right)[i], width) == RANGE_UNDECIDED;
        is_any = is_any || e->is_near[i];
    }
    return is_any;
}

/* Find the crossings in an interval that is decided, or too short to bisect. */
static int cross_interval(cotree_events *e, const cotree_real *left, const cotree_real *right)
{
    int i, found = COTREE_EVENTS_NONE;
    for (i = 0; i < e->n_events; ++i) {
        int status;
        if (!e->is_candidate[i] || e->is_excluded[i]) continue;
        status = cotree_find_crossing_between(e, i, left[0], right[0], VALUES_OF(left)[i],
                                              VALUES_OF(right)[i], e->is_near[i], e->root_time + i,
                                              e->from_side + i);
        if (status > COTREE_EVENTS_FOUND) return status;
        e->is_found[i] = status == COTREE_EVENTS_FOUND;
        if (e->is_found[i]) found = COTREE_EVENTS_FOUND;
    }
    return found;
}

/* Return whether all values are on their previous side by more than the tolerance, so that a step
 * may start there. */
static int is_before_crossings(const cotree_events *e, const cotree_real *mark)
{
    int i;
    for (i = 0; i < e->n_events; ++i) {
        if (!e->is_candidate[i] || e->from_side[i] == COTREE_F(0.0)) continue;
        if (!(e->from_side[i] * VALUES_OF(mark)[i] > cotree_tolerance(e, i))) return 0;
    }
    return 1;
}

/* Find the first crossings of nonlinear event functions in a step. Return a status of
 * find_crossings: SHORTEN if there is no crossing before `until` and later intervals are
 * undecided. */
int cotree_scan_ranges(cotree_events *e, cotree_real *until)
{
    cotree_real *const left = ENTRY(e, MAX_DEPTH + 1);
    int k, n_divisions = 0, found = COTREE_EVENTS_NONE;
    for (k = 0; k < e->n_events; ++k) e->is_excluded[k] = e->is_candidate[k] = 0;
    if (list_candidates(e) == 0) return e->failure;
    if (e->is_coarse) return REFINE;
    set_sample_entry(e, left, 0);
    for (k = 1; k < SAMPLES && found == COTREE_EVENTS_NONE; ++k) {
        int depth = 0;
        set_sample_entry(e, ENTRY(e, 0), k);
        while (depth >= 0 && found == COTREE_EVENTS_NONE) {
            cotree_real *const right = ENTRY(e, depth);
            const int is_too_short =
                right[0] - left[0] <= COTREE_F(16.0) * cotree_spacing(right[0]);
            const int is_unknown = must_divide(e, left, right, depth);
            if (e->failure != 0) return e->failure;
            if (is_unknown && depth < MAX_DEPTH && !is_too_short) {
                if (n_divisions++ < MAX_DIVISIONS) {
                    if (set_middle_entry(e, left, right, ENTRY(e, ++depth)) != 0) return e->failure;
                    continue;
                }
                *until = left[0];
                if (*until - e->t_before > MIN_PROGRESS_SHARE * (e->t_after - e->t_before) &&
                    is_before_crossings(e, left)) {
                    return SHORTEN;
                }
            }
            *until = COTREE_INFINITY;
            found = cross_interval(e, left, right);
            cotree_copy(N_ENTRY(e), right, left);
            --depth;
        }
    }
    return found;
}
