/* cotree_start_modes.c: modes of dry friction and of jumps inside expressions at a start. */
#include "cotree_start_internal.h"

#if COTREE_HAS_EVENTS
#if COTREE_HAS_ALGEBRAIC
/* Speeds below this fraction of max(1, largest state) count as zero. */
#define STILL COTREE_SELECT(1e-6, 2.8e-03f)
#endif

/* Rates on both sides of a jump are equal if their relative difference is at most this. */
#define SAME_RATE COTREE_SELECT(1e-12, 1e-05f)

/* Maximum number of mode changes for each event. */
#define MOST_CHANGES 50

int cotree_start_count_events(const cotree_start *start, int kind)
{
    const cotree_hybrid *const h = MODEL->hybrid;
    int i, n = 0;
    for (i = 0; h != NULL && i < h->n_events; ++i) n += h->events[i].kind == kind;
    return n;
}

#if COTREE_HAS_ALGEBRAIC
/* Modes of dry friction on which algebraic unknowns depend. */

/* Set the modes of friction elements that are disengaged, or whose speed contradicts their mode. */
int cotree_start_choose_friction_modes(cotree_start *start, cotree_real t, cotree_real *z)
{
    const cotree_hybrid *const h = MODEL->hybrid;
    const cotree_run *const run = start->run;
    const cotree_real *const values = start->event_values;
    cotree_real *const x = start->w, size = COTREE_F(1.0);
    int i, status;
    for (i = 0; i < N_STATES; ++i) {
        x[i] = z[i];
        size = COTREE_FMAX(size, COTREE_FABS(z[i]));
    }
    for (i = 0; i < h->n_events; ++i) {
        /* The event function is the speed times the mode: mode 1 yields the speed. */
        if (h->events[i].kind == COTREE_FRICTION_SLIP) x[h->events[i].targets[0]] = COTREE_F(1.0);
    }
    status = MODEL->events(t, z, run->u, run->p, run->k, start->event_values);
    for (i = 0; i < h->n_events && status == 0; ++i) {
        if (h->events[i].kind == COTREE_FRICTION_ENGAGED && values[i] <= COTREE_F(0.0))
            x[h->events[i].targets[0]] = COTREE_FRICTION_FREE;
    }
    if (status == 0) status = MODEL->events(t, x, run->u, run->p, run->k, start->event_values);
    for (i = 0; i < h->n_events && status == 0; ++i) {
        const int mode = h->events[i].targets[0];
        if (h->events[i].kind != COTREE_FRICTION_SLIP || start->is_set[mode]) continue;
        if (x[mode] == COTREE_FRICTION_FREE) {
            z[mode] = COTREE_FRICTION_FREE;
        } else if (COTREE_FABS(values[i]) > STILL * size) {
            z[mode] = values[i] > COTREE_F(0.0) ? COTREE_F(1.0) : -COTREE_F(1.0);
        } else if (z[mode] == COTREE_FRICTION_FREE) {
            z[mode] = COTREE_FRICTION_STICKS;
        }
    }
    return status;
}

#endif
/* Modes of jumps. */

/* Return a jump whose mode disagrees with the sign of its event function, and its new mode; -1 if
 * there is none. */
static int find_wrong_mode(cotree_start *start, cotree_real t, const cotree_real *x,
                           cotree_real *mode, int *status)
{
    const cotree_hybrid *const h = MODEL->hybrid;
    const cotree_run *const run = start->run;
    int i, first = 0;
    *status = MODEL->events(t, x, run->u, run->p, run->k, start->event_values);
    if (*status == 0) *status = MODEL->jumps(t, x, run->u, run->p, run->k, start->new_values);
    for (i = 0; i < h->n_events && *status == 0; ++i) {
        const cotree_event *const row = h->events + i;
        const cotree_real side = (cotree_real)row->direction * start->event_values[i];
        if (row->kind == COTREE_JUMP && side > COTREE_F(0.0) &&
            x[row->targets[0]] != start->new_values[first]) {
            *mode = start->new_values[first];
            return i;
        }
        first += row->n_targets;
    }
    return -1;
}

int cotree_start_choose_jump_modes(cotree_start *start, cotree_real t, cotree_real *z)
{
    const int most = MOST_CHANGES * cotree_start_count_events(start, COTREE_JUMP);
    int n, status = 0;
    if (start->event_values == NULL) return 0;
    for (n = 0; n < most; ++n) {
        cotree_real mode = COTREE_F(0.0);
        const int event = find_wrong_mode(start, t, z, &mode, &status);
        if (status != 0 || event < 0) return status;
        z[MODEL->hybrid->events[event].targets[0]] = mode;
        start->culprit = event;
#if COTREE_HAS_ALGEBRAIC
        if (MODEL->n_algebraic > 0) status = cotree_start_solve_all(start, t, z);
#endif
        if (status != 0) return status;
    }
    return most > 0 ? COTREE_START_REVERSED : 0;
}

#if COTREE_HAS_SENSITIVITIES
/* Compute the rates at z with the given value of a mode. */
static int rates_on_side(cotree_start *start, cotree_real t, const cotree_real *z, int mode,
                         cotree_real value, cotree_real *rates)
{
    const cotree_run *const run = start->run;
    cotree_real *const x = start->sides;
    int i, status = 0;
    for (i = 0; i < N_STATES; ++i) x[i] = z[i];
    x[mode] = value;
#if COTREE_HAS_ALGEBRAIC
    if (MODEL->n_algebraic > 0) status = cotree_start_complete_states(start, t, x);
#endif
    return status == 0 ? MODEL->rhs(t, x, run->u, run->p, run->k, rates) : status;
}

/* Return COTREE_START_ON_JUMP if the rates differ between the two values of a mode at one of its
 * events. */
static int compare_sides(cotree_start *start, cotree_real t, const cotree_real *z, int mode)
{
    const cotree_hybrid *const h = MODEL->hybrid;
    cotree_real *const one = start->sides + N_STATES, *const other = one + N_STATES;
    int first = 0, i, j, n_sides = 0, status = 0;
    for (i = 0; i < h->n_events && status == 0; ++i) {
        const cotree_event *const row = h->events + i;
        if (row->n_targets == 1 && row->targets[0] == mode) {
            status = rates_on_side(start, t, z, mode, start->new_values[first],
                                   n_sides == 0 ? one : other);
            for (j = 0; j < N_STATES && n_sides > 0 && status == 0; ++j) {
                const cotree_real size = COTREE_FMAX(COTREE_FABS(one[j]), COTREE_FABS(other[j]));
                if (COTREE_FABS(one[j] - other[j]) > SAME_RATE * size)
                    status = COTREE_START_ON_JUMP;
            }
            ++n_sides;
        }
        first += row->n_targets;
    }
    return status;
}

/* Return COTREE_START_ON_JUMP if the rates jump at z and the jump moves with a parameter, so that
 * no sensitivities exist. */
int cotree_start_check_jumps(cotree_start *start, cotree_real t, const cotree_real *z)
{
    const cotree_hybrid *const h = MODEL->hybrid;
    const cotree_run *const run = start->run;
    const cotree_real *const values = start->event_values, *const slopes = start->event_slopes;
    int i, j, status;
    if (N_SENSITIVITIES == 0 || cotree_start_count_events(start, COTREE_JUMP) == 0) return 0;
    status = MODEL->events(t, z, run->u, run->p, run->k, start->event_values);
    if (status == 0) status = MODEL->jumps(t, z, run->u, run->p, run->k, start->new_values);
    if (status == 0)
        status = MODEL->event_sensitivity(t, z, z + N_STATES, run->u, run->p, run->k,
                                          start->event_slopes);
    for (i = 0; i < h->n_events && status == 0; ++i) {
        int moving = -1;
        if (h->events[i].kind != COTREE_JUMP || values[i] != COTREE_F(0.0)) continue;
        for (j = N_SENSITIVITIES - 1; j >= 0; --j) {
            /* nan counts as nonzero. */
            if (!(slopes[j * (h->n_events + h->n_jumps) + i] == COTREE_F(0.0))) moving = j;
        }
        start->culprit = i;
        start->column = moving;
        if (moving >= 0) status = compare_sides(start, t, z, h->events[i].targets[0]);
    }
    return status;
}
#endif
#endif
