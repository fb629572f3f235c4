/* cotree_impulse.c: changes of states and sensitivities in an impact.
 *
 * In an impact the equation of a constraint prescribes its change of speed instead of its
 * acceleration. The change of each state is the difference of two rates, evaluated with the
 * prescribed change and with zero: finite forces cancel in the difference. States without inertia
 * do not change. The changes of the sensitivities are computed in the same way from their rates. */
#include "cotree_jumps_internal.h"

/* Return the index of an event's last new value, its change of speed, among all new values. */
static int speed_change_index(const cotree_jumps *j, int event)
{
    return cotree_first_new_value(j, event) + j->hybrid->events[event].n_targets - 1;
}

/* Write the prescribed changes of speed and their sensitivities to z; if is_struck is 0, write
 * zeros. */
static void set_required_changes(cotree_jumps *j, const cotree_row *rows, int n_rows, int is_struck,
                                 cotree_real *z)
{
    const cotree_real *const t_p = j->time_sensitivity;
    const int n_values = N_EVENTS + N_JUMPS;
    int c, i, n;
    for (i = 0; i < n_rows; ++i) {
        for (c = 0; c < COTREE_COMPONENTS && rows[i].speed_states[c] >= 0; ++c) {
            const int event = is_struck ? rows[i].struck_events[c] : -1;
            const int index = event < 0 ? -1 : speed_change_index(j, event);
            cotree_real *change = z + rows[i].speed_states[c];
            *change = index < 0 ? COTREE_F(0.0) : j->new_values[index];
            for (n = 0; n < N_SENSITIVITIES; ++n) {
                change += N_STATES;
                /* The time of the impact also depends on the parameters. */
                *change = index < 0 ? COTREE_F(0.0)
                                    : j->value_slopes[n * n_values + N_EVENTS + index] +
                                          j->rates[N_EVENTS + index] * t_p[n];
            }
        }
    }
}

/* Compute the rates of all states and sensitivities at z, and the event functions, of which some
 * are forces, with their derivatives. */
static int evaluate_response(cotree_jumps *j, cotree_real t, const cotree_real *z,
                             cotree_real *rates, cotree_real *forces)
{
    cotree_run *const run = j->run;
    const int n_values = N_EVENTS + N_JUMPS;
    int i, n, status;
    cotree_run_narrow(run, t, z, j->w_work);
    status = cotree_run_find(run, t, j->w_work);
    if (status != 0) return status;
    cotree_run_pack(run, run->full, j->w_work);
    status = cotree_run_packed_rate(run, t, j->w_work, j->packed);
    if (status != 0) return status;
    cotree_run_unpack(run, j->packed, rates);
    status = MODEL->events(t, run->full, run->u, run->p, run->k, j->values);
    for (i = 0; i < N_EVENTS; ++i) forces[i] = j->values[i];
    if (status != 0 || N_SENSITIVITIES == 0) return status;
    status = MODEL->event_sensitivity(t, run->full, run->full + N_STATES, run->u, run->p, run->k,
                                      j->force_slopes);
    for (n = 0; n < N_SENSITIVITIES; ++n) {
        for (i = 0; i < N_EVENTS; ++i)
            forces[(1 + n) * N_EVENTS + i] = j->force_slopes[n * n_values + i];
    }
    return status;
}

static void restore_modes(const cotree_row *rows, int n_rows, const cotree_real *from,
                          cotree_real *z)
{
    int c, i;
    for (i = 0; i < n_rows; ++i) {
        z[rows[i].mode_state] = from[rows[i].mode_state];
        for (c = 0; c < COTREE_COMPONENTS && rows[i].direction_states[c] >= 0; ++c)
            z[rows[i].direction_states[c]] = from[rows[i].direction_states[c]];
    }
}

/* Change the states and sensitivities j->after by the impact. On entry, the sensitivities include
 * the change of the impact's time. */
static int compute_impact(cotree_jumps *j, const cotree_row *rows, int n_rows, int is_residual,
                          cotree_real t)
{
    cotree_run *const run = j->run;
    const int n_forces = N_EVENTS * run->n_blocks;
    cotree_real *const with = j->response, *const without = with + run->n_full;
    cotree_real *const forces = j->impulse_forces, *const finite_forces = forces + n_forces;
    int c, i, n, status;
    cotree_rows_store(rows, n_rows, 1, j->after);
    set_required_changes(j, rows, n_rows, 1, j->after);
    status = evaluate_response(j, t, j->after, with, forces);
    set_required_changes(j, rows, n_rows, 0, j->after);
    if (status == 0) status = evaluate_response(j, t, j->after, without, finite_forces);
    if (status != 0) return status;
    for (i = 0; i < n_forces; ++i) forces[i] -= finite_forces[i];
    for (n = 0; n < run->n_blocks; ++n) {
        cotree_real *const block = j->after + n * N_STATES;
        for (i = 0; i < run->n_rates; ++i)
            block[i] += with[n * N_STATES + i] - without[n * N_STATES + i];
        for (i = 0; i < n_rows; ++i) {
            const cotree_row *const row = rows + i;
            const int has_impulse = row->type == COTREE_ROW_STOP && row->struck_events[0] >= 0;
            for (c = 0; c < COTREE_COMPONENTS && row->speed_states[c] >= 0; ++c) {
                const int state = row->speed_states[c];
                /* The stored impulse does not have the sign of the stop's side. */
                block[state] = has_impulse ? forces[n * N_EVENTS + row->limits[0]] : COTREE_F(0.0);
                if (is_residual) block[state] = j->before[n * N_STATES + state];
            }
        }
    }
    restore_modes(rows, n_rows, j->before, j->after);
    return 0;
}

int cotree_jumps_try_impulse(cotree_jumps *j, const cotree_row *rows, int n_rows, cotree_real t,
                             const cotree_real *w, cotree_real *after)
{
    cotree_run *const run = j->run;
    const int n_blocks = run->n_blocks, n_full = run->n_full;
    int i, status;
    t = cotree_run_inside(run, t);
    run->n_blocks = 1;
    run->n_full = N_STATES;
    status = cotree_run_find(run, t, w);
    for (i = 0; i < N_STATES; ++i) j->before[i] = j->after[i] = run->full[i];
    if (status == 0) status = cotree_run_inputs(run, t);
    if (status == 0) status = MODEL->jumps(t, j->before, run->u, run->p, run->k, j->new_values);
    if (status == 0) status = compute_impact(j, rows, n_rows, 0, t);
    if (status == 0) cotree_run_narrow(run, t, j->after, after);
    run->n_blocks = n_blocks;
    run->n_full = n_full;
    return status;
}

int cotree_jumps_apply_impulse(cotree_jumps *j, const cotree_row *rows, int n_rows, int is_residual,
                               cotree_real t, cotree_real *w)
{
    cotree_run *const run = j->run;
    cotree_real *const x = j->before;
    int i, n, status;
    t = cotree_run_inside(run, t);
    status = cotree_find_before(j, t, w);
    if (status == 0) status = MODEL->jumps(t, x, run->u, run->p, run->k, j->new_values);
    if (status == 0 && N_SENSITIVITIES > 0) {
        status =
            MODEL->event_sensitivity(t, x, x + N_STATES, run->u, run->p, run->k, j->value_slopes);
    }
    if (status != 0) return status;
    for (n = 0; n < N_SENSITIVITIES; ++n) {
        cotree_real *const block = j->after + (1 + n) * N_STATES;
        for (i = 0; i < run->n_rates; ++i) block[i] += j->time_sensitivity[n] * j->state_rates[i];
    }
    status = compute_impact(j, rows, n_rows, is_residual, t);
    /* The sensitivities already include the rates before the impact. */
    for (i = 0; i < N_STATES; ++i) j->state_rates[i] = COTREE_F(0.0);
    return status == 0 ? cotree_complete_event(j, &no_event, t, w) : status;
}

cotree_real cotree_jumps_target_value(const cotree_jumps *j, int event, int target)
{
    return j->new_values[cotree_first_new_value(j, event) + target];
}

cotree_real cotree_jumps_speed_change(const cotree_jumps *j, int event)
{
    return j->new_values[speed_change_index(j, event)];
}

cotree_real cotree_jumps_speed_change_rate(const cotree_jumps *j, int event)
{
    return j->rates[N_EVENTS + speed_change_index(j, event)];
}
