/* cotree_dispatch.c: events at one time, and those that they trigger.
 * Part of the runtime of cotree, the same for every model.
 */
#include "cotree_events_internal.h"

#include <float.h>
#include <math.h>
#include <stddef.h>

/* What happens at one time: each event in its turn, and what these make happen. */

/* Whether a value that moves to a side does what its event waits for. */
int cotree_is_wanted(const cotree_events *e, int i, cotree_real side)
{
    const int direction = e->rows[i].direction;
    return direction == 0 || (cotree_real)direction == side;
}

/* When an event happened, the last time for age 0. */
static cotree_real time_ago(const cotree_events *e, int i, int age)
{
    const int place = (e->n_happened[i] - 1 - age) % COTREE_EVENT_CROWD;
    return e->happened[i * COTREE_EVENT_CROWD + place];
}

/* Refuses events whose last n intervals are a geometric series that soon ends. */
static int check_series(cotree_events *e, int i, cotree_real t, int n, cotree_real longest)
{
    cotree_real last, ratio, left;
    int k;
    if (e->n_happened[i] < n + 1) return 0;
    for (k = 0; k < n; ++k) {
        if (!(time_ago(e, i, k) - time_ago(e, i, k + 1) > COTREE_F(0.0))) return 0;
    }
    last = time_ago(e, i, 0) - time_ago(e, i, 1);
    ratio = last / (time_ago(e, i, 1) - time_ago(e, i, 2));
    for (k = 1; k < n - 1; ++k) {
        const cotree_real own = (time_ago(e, i, k) - time_ago(e, i, k + 1)) /
                                (time_ago(e, i, k + 1) - time_ago(e, i, k + 2));
        if (COTREE_FABS(own - ratio) > SAME_RATIO * ratio) return 0;
    }
    if (ratio >= COTREE_F(1.0)) return 0;
    left = last * ratio / (COTREE_F(1.0) - ratio);
    if (!(left <= longest)) return 0;
    e->detail = t + left;
    return cotree_fail(e, i, t, COTREE_EVENTS_ACCUMULATE);
}

/* Refuses events that accumulate. */
static int count(cotree_events *e, int i, cotree_real t)
{
    /* The number stays within the range of its type. */
    if (e->n_happened[i] >= 2 * COTREE_EVENT_CROWD) e->n_happened[i] -= COTREE_EVENT_CROWD;
    e->happened[i * COTREE_EVENT_CROWD + e->n_happened[i] % COTREE_EVENT_CROWD] = t;
    ++e->n_happened[i];
    /* Impacts at a stop end in rest by its rule. */
    if (!cotree_is_gap(e, i) && check_series(e, i, t, IN_A_ROW, LEFT * e->span) != 0)
        return e->trouble;
    if (e->n_happened[i] < COTREE_EVENT_CROWD) return 0;
    e->detail = t - time_ago(e, i, COTREE_EVENT_CROWD - 1);
    return e->detail <= CROWDED * e->span ? cotree_fail(e, i, t, COTREE_EVENTS_CHATTER) : 0;
}

int cotree_refuse_grazing(cotree_events *e, int i, cotree_real t)
{
    if (check_series(e, i, t, A_FEW, COTREE_INFINITY) != 0) {
        if (cotree_is_gap(e, i)) e->trouble = COTREE_EVENTS_FAINT;
        return e->trouble;
    }
    return cotree_fail(e, i, t, COTREE_EVENTS_GRAZE);
}

/* Finds whether a parameter moves what an event looks at. */
static int find_moved(cotree_events *e, int i, cotree_real t, cotree_real *w, int *is_moved)
{
    e->complaint = cotree_jumps_is_moved(&e->jumps, i, t, w, is_moved);
    return e->complaint == 0 ? 0 : cotree_fail(e, i, t, COTREE_EVENTS_FAILED);
}

/* Refuses a crossing that is so shallow that it may as well not take place, where its time moves
 * with a parameter. */
static int check_grazing(cotree_events *e, int i, cotree_real t, cotree_real *w)
{
    cotree_real rate;
    int is_moved;
    if (cotree_rates(e, t, w) != 0) return e->trouble;
    rate = e->jumps.rates[i];
    if (cotree_find_bend(e, t, w) != 0) return e->trouble;
    if (rate != COTREE_F(0.0) &&
        COTREE_F(0.5) * rate * rate > GRAZING * cotree_tolerance(e, i) * COTREE_FABS(e->bend[i]))
        return 0;
    if (find_moved(e, i, t, w, &is_moved) != 0) return e->trouble;
    return is_moved ? cotree_refuse_grazing(e, i, t) : 0;
}

/* Lets one event happen at w. */
static int fire(cotree_events *e, int i, cotree_real t, cotree_real *w, int is_time_fixed)
{
    const int is_smooth = cotree_is_kink(e, i, t, w);
    int k, status = count(e, i, t);
    if (status == 0 && e->run->n_blocks > 1 && !is_time_fixed) status = check_grazing(e, i, t, w);
    if (status != 0) {
        /* Where no rate jumps, it does not matter when it happens, or how often. */
        if (status == COTREE_EVENTS_FAILED || !is_smooth) return status;
        is_time_fixed = 1;
        e->trouble = 0;
    }
    status = cotree_jumps_apply(&e->jumps, i, t, w, is_time_fixed);
    if (status == COTREE_JUMPS_CONTRADICT) return cotree_fail(e, i, t, COTREE_EVENTS_CONTRADICT);
    if (status == COTREE_JUMPS_CHOOSE) return cotree_fail(e, i, t, COTREE_EVENTS_CHOOSE);
    if (status != 0) return cotree_fail(e, i, t, COTREE_EVENTS_FAILED);
    if (cotree_settle_modes(e, t, w, i) != 0) return e->trouble;
    for (k = 0; k < e->run->n_full; ++k) {
        if (!(COTREE_FABS(e->jumps.after[k]) <= COTREE_MAX)) {
            return cotree_fail(e, i, t, COTREE_EVENTS_SET_NOT_FINITE);
        }
    }
    e->has_fired[i] = 1;
    if (e->rows[i].is_stop) e->stopped = i;
    cotree_record(e, i, t);
    return 0;
}

/* Whether an event, or the other one of the same jump inside an expression, which stands beside it,
 * happens now: what it looks at is as far from zero as the error test knows. */
static int is_just_set(const cotree_events *e, int i)
{
    int k;
    for (k = i > 0 ? i - 1 : 0; k <= i + 1 && k < e->n_events; ++k) {
        if (!e->has_fired[k]) continue;
        if (k == i) return 1;
        if (cotree_is_of_same_jump(e, i, k)) return 1;
    }
    return 0;
}

/* Says which way the value of a jump moves, whatever its rate is: that of both its events. */
void cotree_face(cotree_events *e, int i, cotree_real way)
{
    int k;
    for (k = 0; k < e->n_events; ++k) {
        if (k == i || cotree_is_of_same_jump(e, i, k)) e->way[k] = way;
    }
}

/* Whether a value at zero has no rate, but a second derivative beyond rounding, as find_bend left
 * it. */
int cotree_is_bent(const cotree_events *e, int i)
{
    return COTREE_FABS(e->bend[i]) * e->span > STILL * e->speed[i];
}

/* Writes on which side of zero values are, those at zero by where they move, to looked. Jumps
 * inside expressions that have no rate there move as their second derivative says. */
static int find_sides(cotree_events *e, cotree_real t, const cotree_real *w)
{
    int i, is_known = 0, status = cotree_values(e, t, w);
    cotree_copy(e->n_events, e->jumps.values, e->g);
    if (status == 0) status = cotree_note(e, t, w, e->g);
    if (status == 0) status = cotree_rates(e, t, w);
    for (i = 0; i < e->n_events; ++i) {
        const cotree_real rate = e->jumps.rates[i];
        const cotree_real near = is_just_set(e, i)
                                     ? COTREE_FMAX(cotree_band(e, i), cotree_tolerance(e, i))
                                     : cotree_band(e, i);
        e->looked[i] =
            COTREE_FABS(rate) > STILL * e->speed[i] ? cotree_sign_of(rate) : COTREE_F(0.0);
        if (COTREE_FABS(e->g[i]) > near)
            e->looked[i] = cotree_sign_of(e->g[i]);
        else if (cotree_is_resting(e, i))
            e->looked[i] = e->side[i];
        else if (e->is_kink[i] && is_just_set(e, i))
            e->looked[i] = e->way[i];
    }
    for (i = 0; i < e->n_events && status == 0; ++i) {
        if (e->rows[i].is_jump != 1 || e->looked[i] != COTREE_F(0.0)) continue;
        if (!is_known) status = cotree_find_bend(e, t, w);
        is_known = 1;
        if (status == 0 && cotree_is_bent(e, i)) e->looked[i] = cotree_sign_of(e->bend[i]);
    }
    return status;
}

/* Lets the jumps that were found happen in one order or the other, at a copy. */
static int fire_jumps(cotree_events *e, cotree_real t, cotree_real *w, int is_reverse)
{
    int k, status = 0;
    for (k = 0; k < e->n_events && status == 0; ++k) {
        const int i = is_reverse ? e->n_events - 1 - k : k;
        if (!e->is_found[i] || e->rows[i].is_jump != 1) continue;
        status = cotree_jumps_apply(&e->jumps, i, t, w, 0);
    }
    return status;
}

/* Refuses jumps at once, where parameters move any, and it matters which comes first: nothing there
 * has sensitivities. */
static int check_order(cotree_events *e, cotree_real t, cotree_real *w)
{
    int i, first = -1, n_jumps = 0, is_moved = 0;
    for (i = 0; i < e->n_events && e->run->n_blocks > 1; ++i) {
        if (!e->is_found[i] || e->rows[i].is_jump != 1) continue;
        if (!is_moved && find_moved(e, i, t, w, &is_moved) != 0) return e->trouble;
        if (first < 0) first = i;
        ++n_jumps;
    }
    if (n_jumps < 2 || !is_moved) return 0;
    cotree_copy(e->n, w, e->other);
    cotree_copy(e->n, w, e->sum);
    if (fire_jumps(e, t, e->other, 0) != 0 || fire_jumps(e, t, e->sum, 1) != 0) {
        return cotree_fail(e, first, t, COTREE_EVENTS_FAILED);
    }
    for (i = 0; i < e->n; ++i) {
        const cotree_real size = COTREE_FMAX(COTREE_FABS(e->other[i]), COTREE_FABS(e->sum[i]));
        if (COTREE_FABS(e->other[i] - e->sum[i]) > SAME * size + e->atol) {
            return cotree_fail(e, first, t, COTREE_EVENTS_PART);
        }
    }
    return 0;
}

/* Lets what was found happen, each moving its way. */
static int fire_found(cotree_events *e, cotree_real t, cotree_real *w)
{
    int i, n_fired = 0, status = check_order(e, t, w);
    if (status == 0) status = cotree_values(e, t, w);
    for (i = 0; i < e->n_events; ++i) {
        /* What is at zero passes it, whether it is an event in that direction or not. */
        if (COTREE_FABS(e->jumps.values[i]) <= cotree_band(e, i)) e->side[i] = e->way[i];
    }
    for (i = 0; i < e->n_events && status == 0; ++i) {
        if (!e->is_found[i]) continue;
        if (cotree_is_corner(e, i)) {
            e->has_fired[i] = 1;
            continue;
        }
        if (n_fired > 0) {
            status = cotree_rates(e, t, w);
            if (!(e->jumps.rates[i] * e->way[i] > COTREE_F(0.0)))
                continue; /* another one turned it round */
            if (cotree_has_chosen(e, i)) continue;
        }
        if (status == 0) status = fire(e, i, t, w, 0);
        if (status == 0) status = find_sides(e, t, w);
        e->side[i] = e->looked[i];
        ++n_fired;
    }
    return status;
}

/* Ends the run where events make each other happen, those found in the last rounds: where all are
 * jumps, nothing crosses these. Where no rate jumps, then and a little later, any of their modes
 * will do. */
static int fail_endless(cotree_events *e, cotree_real t, const cotree_real *w)
{
    const cotree_real later = t + BENDING * e->span;
    int i, first = -1, are_jumps = 1, are_kinks = 1;
    if (cotree_find_bend(e, t, w) != 0) return e->trouble;
    for (i = 0; i < e->n_events; ++i) {
        if (!e->is_found[i]) continue;
        are_kinks =
            are_kinks && cotree_is_kink(e, i, t, w) && cotree_is_kink(e, i, later, e->other);
    }
    for (i = 0; i < e->n_events && are_kinks; ++i) e->side[i] = e->looked[i];
    if (are_kinks) return 0;
    for (i = 0; i < e->n_events; ++i) {
        e->has_fired[i] = e->is_found[i];
        if (!e->is_found[i]) continue;
        if (first < 0) first = i;
        are_jumps = are_jumps && e->rows[i].is_jump == 1;
    }
    return cotree_fail(e, first, t, are_jumps ? COTREE_EVENTS_SLIDE : COTREE_EVENTS_ENDLESS);
}

/* Whether the mode of a jump inside an expression contradicts the side that its value is on: what
 * happened changed the value, or it rested at zero and leaves to that side. */
static int is_contradicted(const cotree_events *e, int i)
{
    return e->rows[i].is_jump == 1 && e->looked[i] == (cotree_real)e->rows[i].direction &&
           cotree_jumps_is_due(&e->jumps, i);
}

/* Refuses what rested at a jump and leaves it now where nothing decides when. */
static int check_leaving(cotree_events *e, int i, cotree_real t, const cotree_real *w)
{
    int k, is_timed = e->is_timed || e->run->n_blocks == 1 || e->side[i] != COTREE_F(0.0);
    for (k = 0; k < e->n_events; ++k) is_timed = is_timed || e->has_fired[k];
    return is_timed || cotree_is_kink(e, i, t, w) ? 0 : cotree_fail(e, i, t, COTREE_EVENTS_LEAVE);
}

/* Whether something decides the time of what happens now: an event before it, or a breakpoint. What
 * holds at a corner is continuous, and makes nothing happen. */
static int is_time_decided(const cotree_events *e)
{
    int k, is_decided = e->is_timed;
    for (k = 0; k < e->n_events; ++k)
        is_decided = is_decided || (e->has_fired[k] && !cotree_is_corner(e, k));
    return is_decided;
}

/* Lets happen what jumped through zero, again and again. */
static int fire_others(cotree_events *e, cotree_real t, cotree_real *w)
{
    int i, round, has_jumps = 0;
    for (i = 0; i < e->n_events; ++i) has_jumps = has_jumps || e->rows[i].is_jump == 1;
    for (round = 0; round < COTREE_EVENT_ROUNDS; ++round) {
        int first = -1, status = find_sides(e, t, w);
        if (status == 0 && has_jumps && cotree_jumps_news(&e->jumps, t, w) != 0) {
            status = cotree_fail(e, 0, t, COTREE_EVENTS_FAILED);
        }
        if (status != 0) return status;
        for (i = 0; i < e->n_events && round == COTREE_EVENT_ROUNDS / 2; ++i) e->is_found[i] = 0;
        for (i = 0; i < e->n_events; ++i) {
            const int is_crossed = e->rows[i].is_jump != 1 && !cotree_is_corner(e, i) &&
                                   e->looked[i] * e->side[i] < COTREE_F(0.0) &&
                                   cotree_is_wanted(e, i, e->looked[i]);
            if (is_crossed || is_contradicted(e, i)) {
                if (first < 0) first = i;
            } else {
                e->side[i] = e->looked[i];
            }
        }
        if (first < 0) return 0;
        if (e->rows[first].is_jump == 1 && check_leaving(e, first, t, w) != 0) return e->trouble;
        e->is_found[first] = 1;
        status = fire(e, first, t, w, is_time_decided(e));
        if (status == 0) status = find_sides(e, t, w);
        if (status != 0) return status;
        e->side[first] = e->looked[first];
    }
    return fail_endless(e, t, w);
}

/* Refuses what is left at zero without a speed, but pushed on through it. */
static int check_rest(cotree_events *e, int i, cotree_real t, const cotree_real *w)
{
    /* Where modes were chosen, what comes next was looked at; dry friction has modes for what comes
     * to rest, and a jump inside an expression has been asked where it goes on. */
    if (e->side[i] != COTREE_F(0.0) || e->stopped >= 0 || cotree_is_resting(e, i) ||
        cotree_is_of_friction(e, i))
        return 0;
    if (e->rows[i].is_jump == 1) return 0;
    if (cotree_find_bend(e, t, w) != 0) return e->trouble;
    if (!(e->bend[i] * e->way[i] > COTREE_F(0.0) && cotree_is_bent(e, i))) return 0;
    return cotree_fail(e, i, t, COTREE_EVENTS_REST);
}

/* Lets events happen at w, each moving its way, then those that these make happen. Where nothing
 * else decides their time, it has slopes by the parameters; NULL: none. */
int cotree_let_happen(cotree_events *e, cotree_real t, cotree_real *w, int n_found,
                      const cotree_real *slopes)
{
    int i, status = cotree_rates(e, t, w);
    e->n_fired = e->is_shifted = 0;
    /* What jumps takes values to other pieces. */
    cotree_let_pieces_go(e);
    for (i = 0; i < e->n_events; ++i) {
        e->has_fired[i] = 0;
        e->speed[i] = COTREE_FABS(e->jumps.rates[i]);
    }
    for (i = 0; i < e->run->n_blocks - 1; ++i) {
        e->jumps.time_sensitivity[i] = slopes == NULL ? COTREE_F(0.0) : slopes[i];
    }
    if (status == 0 && n_found == 0) status = cotree_settle_modes(e, t, w, -1);
    if (status == 0 && n_found > 0) status = fire_found(e, t, w);
    if (status == 0) status = fire_others(e, t, w);
    for (i = 0; i < e->n_events && status == 0; ++i) {
        e->n_fired += e->has_fired[i];
        if (e->has_fired[i] && !cotree_is_corner(e, i)) status = check_rest(e, i, t, w);
    }
    cotree_face_modes(e, w);
    if (status == 0) status = cotree_choose_pieces(e, t, w);
    if (status == 0 && e->n_fired > 0) {
        for (i = 0; i < e->n_events; ++i) e->flight[i] = COTREE_FABS(e->g[i]);
    }
    return status;
}
