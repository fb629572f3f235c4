/* cotree_breakpoint_sensitivity.c: jumps of sensitivities at time events that depend on
 * parameters. */
#include "cotree_run_internal.h"

#if COTREE_HAS_MOVING_BREAKPOINTS || COTREE_HAS_EVENTS
void cotree_run_from_point(cotree_run *run, cotree_real t, int n, const cotree_real *point,
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

int cotree_run_to_point(cotree_run *run, cotree_real t, const cotree_real *w, int n,
                        cotree_real *point)
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

#if COTREE_HAS_MOVING_BREAKPOINTS
/* Compute the rates on one side of a time event by extrapolation from two times on that side,
 * because steep sources may change within the rounding error of t. */
static int rates_on_side(cotree_run *run, cotree_real t, cotree_real way,
                         cotree_breakpoint_sensitivity *crossing, cotree_real *rates)
{
    int i, status = cotree_run_rate(t, crossing->w, rates, run);
    if (status == 0)
        status = cotree_run_rate(t + COTREE_F(3.0) * way, crossing->w, crossing->work, run);
    for (i = 0; i < run->n && status == 0; ++i) {
        const cotree_real change = crossing->work[i] - rates[i];
        rates[i] -= COTREE_F(0.5) * change;
        crossing->work[i] = change;
    }
    return status;
}

int cotree_run_left_rates(cotree_run *run, cotree_real t, const cotree_real *point, int n,
                          cotree_breakpoint_sensitivity *crossing)
{
    cotree_run_from_point(run, t, n, point, crossing->w);
    return rates_on_side(run, t, -crossing->margin, crossing, crossing->left);
}

/* Find a sensitivity whose jump is undefined: rates jump at coinciding events that the parameter
 * would separate. Return its index in z, or 0. */
static int find_undefined(const cotree_run *run, const cotree_breakpoint_sensitivity *crossing)
{
    const int *const starts = run->model->sensitivity_starts;
    const int *const rows = run->model->sensitivity_rows;
    int i, j, k = run->n_lead;
    for (j = 0; j < run->n_blocks - 1; ++j) {
        for (i = starts[j]; i < starts[j + 1]; ++i) {
            cotree_real jump, allowed;
            if (rows[i] >= N_RATES) continue;
            jump = COTREE_FABS(crossing->left[rows[i]] - crossing->right[rows[i]]);
            allowed = crossing->rtol * COTREE_FABS(crossing->w[k]) + crossing->tolerances[j];
            ++k;
            if (!(jump * crossing->spreads[j] > allowed)) continue;
            if (jump > COTREE_JUMP_NOISE * COTREE_FABS(crossing->work[rows[i]])) {
                return (1 + j) * N_STATES + rows[i];
            }
        }
    }
    return 0;
}

static void shift_sensitivities(const cotree_run *run,
                                const cotree_breakpoint_sensitivity *crossing)
{
    const int *const starts = run->model->sensitivity_starts;
    const int *const rows = run->model->sensitivity_rows;
    cotree_real *s = crossing->w + run->n_lead;
    int i, j;
    for (j = 0; j < run->n_blocks - 1; ++j) {
        for (i = starts[j]; i < starts[j + 1]; ++i) {
            if (rows[i] >= N_RATES) continue;
            *s++ += crossing->slopes[j] * (crossing->left[rows[i]] - crossing->right[rows[i]]);
        }
    }
}

int cotree_run_jump_sensitivities(cotree_run *run, cotree_real t, cotree_real *point, int n,
                                  cotree_breakpoint_sensitivity *crossing)
{
    int status = 0;
    cotree_run_from_point(run, t, n, point, crossing->w);
    /* The states satisfy the constraints on both sides, the sensitivities only after their jump.
     * Integrated unknowns may jump with the rates. */
#if COTREE_HAS_ALGEBRAIC
    if (run->is_extended) status = cotree_run_project(t, crossing->w, run);
#endif
    if (status == 0) status = rates_on_side(run, t, crossing->margin, crossing, crossing->right);
    if (status != 0) return status;
    crossing->undefined = find_undefined(run, crossing);
    if (crossing->undefined > 0) return COTREE_RUN_TURNED;
    shift_sensitivities(run, crossing);
#if COTREE_HAS_CONSTRAINTS
    if (crossing->is_constrained) status = cotree_run_project(t, crossing->w, run);
#endif
    return status != 0 ? status : cotree_run_to_point(run, t, crossing->w, n, point);
}
#endif
