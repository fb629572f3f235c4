/* cotree_strike.c: impulsive changes of states and sensitivities.
 * Part of the runtime of cotree, the same for every model.
 */
#include "cotree_jumps_internal.h"

#include <float.h>
#include <math.h>
#include <stddef.h>

/* Impacts of edges that hold. In an impact the equation of an edge asks for a change of its speed
 * in place of an acceleration, so that the rates of all states, less those at a change of zero, are
 * what the impact changes them by: forces that stay finite drop out. What has no inertia has no
 * such rate. Sensitivities follow in the same way from their rates. */

/* Finds where among the new values of all that is which an event changes a speed by: its last one.
 */
static int rebound_of(const cotree_jumps *j, int event)
{
    return cotree_place_of(j, event) + j->hybrid->events[event].n_targets - 1;
}

/* Writes what is wanted of the changes, zeros where it is of no change, to z. */
static void ask(cotree_jumps *j, const cotree_strike *s, int is_struck, cotree_real *z)
{
    const cotree_real *const t_p = j->time_sensitivity;
    const int n_values = N_EVENTS + N_JUMPS;
    int i, n;
    for (i = 0; i < s->n_edges; ++i) {
        const int at = is_struck && s->rebounds[i] >= 0 ? rebound_of(j, s->rebounds[i]) : -1;
        cotree_real *own = z + s->impulses[i];
        *own = at < 0 ? COTREE_F(0.0) : j->set[at];
        for (n = 0; n < N_SENSITIVITIES; ++n) {
            own += N_STATES;
            /* As the time of the impact moves, too. */
            *own = at < 0
                       ? COTREE_F(0.0)
                       : j->slopes[n * n_values + N_EVENTS + at] + j->rates[N_EVENTS + at] * t_p[n];
        }
    }
}

/* Writes the rates at z, of all states and sensitivities, and the forces of the edges with theirs.
 */
static int respond(cotree_jumps *j, const cotree_strike *s, cotree_real t, const cotree_real *z,
                   cotree_real *rates, cotree_real *pulls)
{
    cotree_run *const run = j->run;
    const int n_values = N_EVENTS + N_JUMPS;
    int i, n, status;
    cotree_run_narrow(run, t, z, j->narrow);
    status = cotree_run_find(run, t, j->narrow);
    if (status != 0) return status;
    cotree_run_pack(run, run->full, j->narrow);
    status = cotree_run_packed_rate(run, t, j->narrow, j->packed);
    if (status != 0) return status;
    cotree_run_unpack(run, j->packed, rates);
    status = MODEL->events(t, run->full, run->u, run->p, run->k, j->values);
    for (i = 0; i < s->n_pulls; ++i) pulls[i] = j->values[s->pulls[i]];
    if (status != 0 || N_SENSITIVITIES == 0) return status;
    status = MODEL->event_sensitivity(t, run->full, run->full + N_STATES, run->u, run->p, run->k,
                                      j->pull_slopes);
    for (n = 0; n < N_SENSITIVITIES; ++n) {
        for (i = 0; i < s->n_pulls; ++i) {
            pulls[(1 + n) * s->n_pulls + i] = j->pull_slopes[n * n_values + s->pulls[i]];
        }
    }
    return status;
}

/* Writes to after what an impact makes of before, whose sensitivities are those at its time. */
static int collide(cotree_jumps *j, const cotree_strike *s, cotree_real t)
{
    cotree_run *const run = j->run;
    const int n_pulls = s->n_pulls * run->n_blocks;
    cotree_real *const with = j->response, *const without = with + run->n_full;
    cotree_real *const pulls = j->pulls, *const idle = pulls + n_pulls;
    int i, n, status;
    for (i = 0; i < s->n_modes; ++i) j->after[s->places[i * s->stride]] = s->modes[i];
    ask(j, s, 1, j->after);
    status = respond(j, s, t, j->after, with, pulls);
    ask(j, s, 0, j->after);
    if (status == 0) status = respond(j, s, t, j->after, without, idle);
    if (status != 0) return status;
    for (n = 0; n < run->n_blocks; ++n) {
        cotree_real *const own = j->after + n * N_STATES;
        for (i = 0; i < run->n_rates; ++i) {
            own[i] += with[n * N_STATES + i] - without[n * N_STATES + i];
        }
        for (i = 0; i < s->n_pulls; ++i) pulls[n * s->n_pulls + i] -= idle[n * s->n_pulls + i];
        for (i = 0; i < s->n_edges; ++i) {
            const int is_told = i < s->n_stops && s->rebounds[i] >= 0;
            /* The side of the limit, which forces have here, gives impulses no sign. */
            own[s->impulses[i]] = is_told ? pulls[n * s->n_pulls + i] : COTREE_F(0.0);
        }
    }
    for (i = 0; i < s->n_modes; ++i) {
        const int place = s->places[i * s->stride];
        j->after[place] = j->before[place];
    }
    return 0;
}

int cotree_jumps_try_strike(cotree_jumps *j, const cotree_strike *s, cotree_real t,
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
    if (status == 0) status = MODEL->jumps(t, j->before, run->u, run->p, run->k, j->set);
    if (status == 0) status = collide(j, s, t);
    if (status == 0) cotree_run_narrow(run, t, j->after, after);
    run->n_blocks = n_blocks;
    run->n_full = n_full;
    return status;
}

int cotree_jumps_strike(cotree_jumps *j, const cotree_strike *s, cotree_real t, cotree_real *w)
{
    cotree_run *const run = j->run;
    cotree_real *const x = j->before;
    int i, n, status;
    t = cotree_run_inside(run, t);
    status = cotree_run_find(run, t, w);
    for (i = 0; i < run->n_full; ++i) j->before[i] = j->after[i] = run->full[i];
    if (status == 0) status = cotree_differentiate(j, t, x);
    if (status == 0) status = MODEL->jumps(t, x, run->u, run->p, run->k, j->set);
    if (status == 0 && N_SENSITIVITIES > 0) {
        status = MODEL->event_sensitivity(t, x, x + N_STATES, run->u, run->p, run->k, j->slopes);
    }
    if (status != 0) return status;
    for (n = 0; n < N_SENSITIVITIES; ++n) {
        cotree_real *const own = j->after + (1 + n) * N_STATES;
        for (i = 0; i < run->n_rates; ++i) own[i] += j->time_sensitivity[n] * j->moving[i];
    }
    status = collide(j, s, t);
    /* What the motion before it has to do with the time is among the sensitivities already. */
    for (i = 0; i < N_STATES; ++i) j->moving[i] = COTREE_F(0.0);
    return status == 0 ? cotree_finish(j, &none, t, w) : status;
}

cotree_real cotree_jumps_rebound(const cotree_jumps *j, int event)
{
    return j->set[rebound_of(j, event)];
}

cotree_real cotree_jumps_rebound_rate(const cotree_jumps *j, int event)
{
    return j->rates[N_EVENTS + rebound_of(j, event)];
}
