/* cotree_impulse.c: changes of states and sensitivities in an impact.
 *
 * In an impact the equation of a constraint prescribes its change of speed instead of its
 * acceleration. The change of each state is the difference of two rates, evaluated with the
 * prescribed change and with zero: finite forces cancel in the difference. States without inertia
 * do not change. The changes of the sensitivities are computed in the same way from their rates. */
#include "cotree_jumps_internal.h"

/* Return the index of an event's last new value, its change of speed, among all new values. */
static int speed_change_place(const cotree_jumps *j, int event)
{
    return cotree_first_new_value(j, event) + j->hybrid->events[event].n_targets - 1;
}

/* Write the prescribed changes of speed and their sensitivities to z; if is_struck is 0, write
 * zeros. */
static void set_required_changes(cotree_jumps *j, const cotree_impulse *s, int is_struck,
                                 cotree_real *z)
{
    const cotree_real *const t_p = j->time_sensitivity;
    const int n_values = N_EVENTS + N_JUMPS;
    int i, n;
    for (i = 0; i < s->n_edges; ++i) {
        const int at =
            is_struck && s->speed_events[i] >= 0 ? speed_change_place(j, s->speed_events[i]) : -1;
        cotree_real *own = z + s->impulse_states[i];
        *own = at < 0 ? COTREE_F(0.0) : j->new_values[at];
        for (n = 0; n < N_SENSITIVITIES; ++n) {
            own += N_STATES;
            /* The time of the impact also depends on the parameters. */
            *own = at < 0 ? COTREE_F(0.0)
                          : j->value_slopes[n * n_values + N_EVENTS + at] +
                                j->rates[N_EVENTS + at] * t_p[n];
        }
    }
}

/* Compute the rates of all states and sensitivities at z, and the forces with their derivatives. */
static int evaluate_response(cotree_jumps *j, const cotree_impulse *s, cotree_real t,
                             const cotree_real *z, cotree_real *rates, cotree_real *forces)
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
    for (i = 0; i < s->n_forces; ++i) forces[i] = j->values[s->force_events[i]];
    if (status != 0 || N_SENSITIVITIES == 0) return status;
    status = MODEL->event_sensitivity(t, run->full, run->full + N_STATES, run->u, run->p, run->k,
                                      j->force_slopes);
    for (n = 0; n < N_SENSITIVITIES; ++n) {
        for (i = 0; i < s->n_forces; ++i) {
            forces[(1 + n) * s->n_forces + i] = j->force_slopes[n * n_values + s->force_events[i]];
        }
    }
    return status;
}

/* Compute the point `after` from `before`, whose sensitivities are those at the time of the
 * impact. */
static int compute_impact(cotree_jumps *j, const cotree_impulse *s, cotree_real t)
{
    cotree_run *const run = j->run;
    const int n_forces = s->n_forces * run->n_blocks;
    cotree_real *const with = j->response, *const without = with + run->n_full;
    cotree_real *const forces = j->impulse_forces, *const idle = forces + n_forces;
    int i, n, status;
    for (i = 0; i < s->n_modes; ++i) j->after[s->places[i * s->stride]] = s->modes[i];
#if COTREE_HAS_DISCS
    for (i = 0; i < s->n_directions; ++i) j->after[s->direction_states[i]] = s->directions[i];
#endif
    set_required_changes(j, s, 1, j->after);
    status = evaluate_response(j, s, t, j->after, with, forces);
    set_required_changes(j, s, 0, j->after);
    if (status == 0) status = evaluate_response(j, s, t, j->after, without, idle);
    if (status != 0) return status;
    for (n = 0; n < run->n_blocks; ++n) {
        cotree_real *const own = j->after + n * N_STATES;
        for (i = 0; i < run->n_rates; ++i) {
            own[i] += with[n * N_STATES + i] - without[n * N_STATES + i];
        }
        for (i = 0; i < s->n_forces; ++i) forces[n * s->n_forces + i] -= idle[n * s->n_forces + i];
        for (i = 0; i < s->n_edges; ++i) {
            const int has_impulse = i < s->n_stops && s->speed_events[i] >= 0;
            const int at = s->impulse_states[i];
            /* Unlike these forces, impulses are not multiplied by the sign of the side. */
            own[at] = has_impulse ? forces[n * s->n_forces + i] : COTREE_F(0.0);
            if (s->is_residual) own[at] = j->before[n * N_STATES + at];
        }
    }
    for (i = 0; i < s->n_modes; ++i) {
        const int place = s->places[i * s->stride];
        j->after[place] = j->before[place];
    }
#if COTREE_HAS_DISCS
    for (i = 0; i < s->n_directions; ++i)
        j->after[s->direction_states[i]] = j->before[s->direction_states[i]];
#endif
    return 0;
}

int cotree_jumps_try_impulse(cotree_jumps *j, const cotree_impulse *s, cotree_real t,
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
    if (status == 0) status = compute_impact(j, s, t);
    if (status == 0) cotree_run_narrow(run, t, j->after, after);
    run->n_blocks = n_blocks;
    run->n_full = n_full;
    return status;
}

int cotree_jumps_apply_impulse(cotree_jumps *j, const cotree_impulse *s, cotree_real t,
                               cotree_real *w)
{
    cotree_run *const run = j->run;
    cotree_real *const x = j->before;
    int i, n, status;
    t = cotree_run_inside(run, t);
    status = cotree_run_find(run, t, w);
    for (i = 0; i < run->n_full; ++i) j->before[i] = j->after[i] = run->full[i];
    if (status == 0) status = cotree_compute_rates_at(j, t, x);
    if (status == 0) status = MODEL->jumps(t, x, run->u, run->p, run->k, j->new_values);
    if (status == 0 && N_SENSITIVITIES > 0) {
        status =
            MODEL->event_sensitivity(t, x, x + N_STATES, run->u, run->p, run->k, j->value_slopes);
    }
    if (status != 0) return status;
    for (n = 0; n < N_SENSITIVITIES; ++n) {
        cotree_real *const own = j->after + (1 + n) * N_STATES;
        for (i = 0; i < run->n_rates; ++i) own[i] += j->time_sensitivity[n] * j->state_rates[i];
    }
    status = compute_impact(j, s, t);
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
    return j->new_values[speed_change_place(j, event)];
}

cotree_real cotree_jumps_speed_change_rate(const cotree_jumps *j, int event)
{
    return j->rates[N_EVENTS + speed_change_place(j, event)];
}
