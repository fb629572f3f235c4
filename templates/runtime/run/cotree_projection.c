/* cotree_projection.c: projection of states and sensitivities on the constraints.
 * Part of the runtime of cotree, the same for every model.
 */
#include "cotree_run_internal.h"

#include <float.h>
#include <math.h>
#include <stddef.h>

#if COTREE_HAS_CONSTRAINTS || COTREE_HAS_EVENTS
int cotree_run_is_constrained(const cotree_run *run)
{
#if COTREE_HAS_CONSTRAINTS
    return run->is_held && run->model->n_constraints > 0;
#else
    (void)run;
    return 0;
#endif
}
#endif

#if COTREE_HAS_CONSTRAINTS
/* The projection. A correction of a few units in the last place is rounding. So is one below SMALL
 * that no longer halves, since Newton's method squares its errors; but speeds see the coordinates'
 * correction in the next step only. Residuals, in the constraints' own units, above FLOOR times the
 * largest state (or 1) are not met. */
#define MOST_STEPS COTREE_MOST_PROJECTIONS
#define SMALL COTREE_SMALL_CORRECTION
#define FLOOR COTREE_LARGEST_RESIDUAL

/* Of how many points rates are taken on the constraints once a step failed that many times, or was
 * farther from them than so many relative tolerances. */
#define STRICT_POINTS 100
#define MOST_FAILURES 3
#define FARTHEST_OFF COTREE_F(1e3)

/* Takes Newton steps with the states until only rounding is left. Residuals would not do to stop
 * by: near a singular configuration they are squares of the distance that is left. */
static int project_states(cotree_run *run, cotree_real t, cotree_real *x)
{
    cotree_real *const dx = run->step;
    cotree_real previous = COTREE_INFINITY;
    int i, n;
    for (n = 0; n < MOST_STEPS; ++n) {
        cotree_real size = COTREE_F(0.0);
        const int status = run->model->projection(t, x, run->u, run->p, run->k, dx);
        if (status != 0) return status;
        for (i = 0; i < N_STATES; ++i) {
            size = COTREE_FMAX(size,
                               COTREE_FABS(dx[i]) / COTREE_FMAX(COTREE_F(1.0), COTREE_FABS(x[i])));
            x[i] += dx[i];
        }
        if (size <= ROUNDING || (size < SMALL && size > COTREE_F(0.5) * previous)) break;
        previous = size;
    }
    return 0;
}

/* Returns 0 where the states satisfy the constraints. */
static int check_constraints(cotree_run *run, cotree_real t, const cotree_real *x)
{
    cotree_real largest = COTREE_F(1.0);
    int i;
    const int status = run->model->constraints(t, x, run->u, run->p, run->k, run->residual);
    if (status != 0) return status;
    for (i = 0; i < N_STATES; ++i) largest = COTREE_FMAX(largest, COTREE_FABS(x[i]));
    if (largest > COTREE_MAX) return 1; /* it would make every residual acceptable */
    for (i = 0; i < run->model->n_constraints; ++i) {
        if (!(COTREE_FABS(run->residual[i]) <= FLOOR * largest)) return 1;
    }
    return 0;
}

/* Moves the states, as little as their inertia allows, and then the sensitivities, onto the
 * constraints. */
static int project(cotree_run *run, cotree_real t, cotree_real *z)
{
#if COTREE_HAS_SENSITIVITIES
    const cotree_model *const model = run->model;
    int n;
#endif
    int status;
    t = cotree_run_inside(run, t); /* at a corner constraints are those of its own side */
    status = cotree_run_inputs(run, t);
    if (status == 0) status = project_states(run, t, z);
    if (status == 0) status = check_constraints(run, t, z);
#if COTREE_HAS_SENSITIVITIES
    /* The speeds' sensitivities see the coordinates' new ones in the second step only. */
    for (n = 0; n < 2 && status == 0 && run->n_blocks > 1; ++n) {
        cotree_real *const s = z + N_STATES;
        int i;
        status = model->sensitivity_projection(t, z, s, run->u, run->p, run->k, run->step);
        if (status != 0) break;
        for (i = 0; i < run->n_full - N_STATES; ++i) s[i] += run->step[i];
    }
#endif
    return status;
}

int cotree_run_project_all(cotree_run *run, cotree_real t, cotree_real *z)
{
    int i, status;
    for (i = 0; i < run->n_full; ++i) run->held[i] = z[i];
    status = project(run, t, run->held);
    if (status != 0) return status;
    for (i = 0; i < run->n_rates; ++i) {
        const cotree_real change =
            COTREE_FABS(run->held[i] - z[i]) / COTREE_FMAX(COTREE_F(1.0), COTREE_FABS(z[i]));
        run->correction = COTREE_FMAX(run->correction, change);
        if (change > FARTHEST_OFF * run->rtol) run->n_strict = STRICT_POINTS;
    }
    for (i = 0; i < run->n_full; ++i) z[i] = run->held[i];
    return 0;
}

int cotree_run_project_packed(cotree_run *run, cotree_real t, cotree_real *packed)
{
    int status;
    cotree_run_unpack(run, packed, run->full);
    status = cotree_run_project_all(run, t, run->full);
    if (status == 0) cotree_run_pack(run, run->full, packed);
    return status;
}

void cotree_run_rejected(void *context)
{
    cotree_run *const run = (cotree_run *)context;
    if (++run->n_failed > MOST_FAILURES) run->n_strict = STRICT_POINTS;
}

/* Off the constraints rates grow without bound towards a singular configuration, where steps fail,
 * so they are taken at the projected point; far from the constraints, where there is none, at the
 * point itself. Elsewhere it costs more than it gains. */
int cotree_are_rates_held(const cotree_run *run)
{
    if (!cotree_run_is_constrained(run) || run->model->gradient == NULL) return 0;
    return run->is_strict || run->n_strict > 0;
}

const cotree_real *cotree_run_held(cotree_run *run, cotree_real t, const cotree_real *z)
{
    int i;
    if (!cotree_are_rates_held(run)) return z;
    for (i = 0; i < run->n_full; ++i) run->held[i] = z[i];
    return project(run, t, run->held) == 0 ? run->held : z;
}
#endif
