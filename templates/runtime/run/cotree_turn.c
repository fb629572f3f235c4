/* cotree_turn.c: jumps of sensitivities at corners whose times depend on parameters.
 * Part of the runtime of cotree, the same for every model.
 */
#include "cotree_run_internal.h"

#include <float.h>
#include <math.h>
#include <stddef.h>

#if COTREE_HAS_MOVING_CORNERS
/* Rates jump where they differ by more than this many times what they change by within as much time
 * on one side of a corner: that is rounding of its time. */
#define NOISE COTREE_JUMP_NOISE
#endif

#if COTREE_HAS_MOVING_CORNERS || COTREE_HAS_EVENTS
void cotree_run_take(cotree_run *run, cotree_real t, int n, const cotree_real *point,
                     cotree_real *w)
{
    int i;
    if (n != run->n) {
        cotree_run_unpack(run, point, run->full);
        cotree_run_narrow(run, t, run->full, w);
        return;
    }
    for (i = 0; i < n; ++i) w[i] = point[i];
}

int cotree_run_give(cotree_run *run, cotree_real t, const cotree_real *w, int n, cotree_real *point)
{
    int i, status = 0;
    if (n != run->n) {
        status = cotree_run_complete(run, cotree_run_inside(run, t), w);
        if (status == 0) cotree_run_pack(run, run->full, point);
        return status;
    }
    for (i = 0; i < n; ++i) point[i] = w[i];
    return status;
}
#endif

#if COTREE_HAS_MOVING_CORNERS
/* Gives the rates at a corner as they are on one side of it, from those at two times there: a
 * source with steep edges changes within rounding of t. */
static int rates_beside(cotree_run *run, cotree_real t, cotree_real way, cotree_turn *turn,
                        cotree_real *rates)
{
    int i, status = cotree_run_rate(t, turn->w, rates, run);
    if (status == 0) status = cotree_run_rate(t + COTREE_F(3.0) * way, turn->w, turn->again, run);
    for (i = 0; i < run->n && status == 0; ++i) {
        const cotree_real change = turn->again[i] - rates[i];
        rates[i] -= COTREE_F(0.5) * change;
        turn->again[i] = change;
    }
    return status;
}

int cotree_run_leave(cotree_run *run, cotree_real t, const cotree_real *point, int n,
                     cotree_turn *turn)
{
    cotree_run_take(run, t, n, point, turn->w);
    return rates_beside(run, t, -turn->margin, turn, turn->left);
}

/* Finds a sensitivity that jumps by an amount that nothing decides: its state and parameter as a
 * place in z, or zero. */
static int find_turned(const cotree_run *run, const cotree_turn *turn)
{
    const int *const starts = run->model->sensitivity_starts;
    const int *const rows = run->model->sensitivity_rows;
    int i, j, k = run->n_lead;
    for (j = 0; j < run->n_blocks - 1; ++j) {
        for (i = starts[j]; i < starts[j + 1]; ++i) {
            cotree_real jump, allowed;
            if (rows[i] >= N_RATES) continue;
            jump = COTREE_FABS(turn->left[rows[i]] - turn->right[rows[i]]);
            allowed = turn->rtol * COTREE_FABS(turn->w[k]) + turn->tolerances[j];
            ++k;
            if (!(jump * turn->spreads[j] > allowed)) continue;
            if (jump > NOISE * COTREE_FABS(turn->again[rows[i]])) {
                return (1 + j) * N_STATES + rows[i];
            }
        }
    }
    return 0;
}

static void shift_sensitivities(const cotree_run *run, const cotree_turn *turn)
{
    const int *const starts = run->model->sensitivity_starts;
    const int *const rows = run->model->sensitivity_rows;
    cotree_real *s = turn->w + run->n_lead;
    int i, j;
    for (j = 0; j < run->n_blocks - 1; ++j) {
        for (i = starts[j]; i < starts[j + 1]; ++i) {
            if (rows[i] >= N_RATES) continue;
            *s++ += turn->slopes[j] * (turn->left[rows[i]] - turn->right[rows[i]]);
        }
    }
}

int cotree_run_enter(cotree_run *run, cotree_real t, cotree_real *point, int n, cotree_turn *turn)
{
    int status = 0;
    cotree_run_take(run, t, n, point, turn->w);
    /* Constraints hold for states on both sides, but for sensitivities as before it until they
     * jump; integrated unknowns may jump with the rates. */
#if COTREE_HAS_ALGEBRAIC
    if (run->is_extended) status = cotree_run_project(t, turn->w, run);
#endif
    if (status == 0) status = rates_beside(run, t, turn->margin, turn, turn->right);
    if (status != 0) return status;
    turn->turned = find_turned(run, turn);
    if (turn->turned > 0) return COTREE_RUN_TURNED;
    shift_sensitivities(run, turn);
#if COTREE_HAS_CONSTRAINTS
    if (turn->is_constrained) status = cotree_run_project(t, turn->w, run);
#endif
    return status != 0 ? status : cotree_run_give(run, t, turn->w, n, point);
}
#endif
