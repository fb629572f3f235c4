/* cotree_projection.c: projection of states and sensitivities onto the constraints. */
#include "cotree_run_internal.h"

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
/* After more than MAX_FAILURES failed steps in a row, or a correction of more than MAX_DRIFT
 * relative tolerances, rates are evaluated at projected points until STRICT_POINTS steps are
 * projected. */
#define STRICT_POINTS 100
#define MAX_FAILURES 3
#define MAX_DRIFT COTREE_F(1e3)

static int step_of_states(const cotree_iteration *a, int is_new, cotree_real *size)
{
    const cotree_run *const run = (const cotree_run *)a->context;
    cotree_real *const x = a->x;
    const cotree_real *const dx = run->step;
    const int status = run->model->projection(a->t, x, run->u, run->p, run->k, run->step);
    cotree_real largest = COTREE_F(0.0);
    int i;
    (void)is_new;
    if (status != 0) return status;
    for (i = 0; i < N_STATES; ++i) {
        largest = COTREE_FMAX(largest,
                              COTREE_FABS(dx[i]) / COTREE_FMAX(COTREE_F(1.0), COTREE_FABS(x[i])));
        x[i] += dx[i];
    }
    *size = largest;
    return 0;
}

/* Take Newton steps of the states until they are at rounding level; speeds converge one step after
 * the coordinates. Residuals are not tested: near a singular configuration they are proportional
 * to the square of the distance. */
static int project_states(cotree_run *run, cotree_real t, cotree_real *x)
{
    static const cotree_newton_limits limits = {
        COTREE_MOST_PROJECTIONS, ROUNDING, COTREE_SMALL_CORRECTION, COTREE_F(0.0), COTREE_F(0.0)};
    cotree_iteration a = {step_of_states, NULL, run, t, x, &limits, COTREE_F(0.0)};
    const int status = cotree_iterate(&a);
    return status == COTREE_NO_STEP ? 0 : status;
}

/* Return 0 if the states satisfy the constraints. */
static int check_constraints(cotree_run *run, cotree_real t, const cotree_real *x)
{
    cotree_real largest = COTREE_F(1.0);
    int i;
    const int status = run->model->constraints(t, x, run->u, run->p, run->k, run->residual);
    if (status != 0) return status;
    for (i = 0; i < N_STATES; ++i) largest = COTREE_FMAX(largest, COTREE_FABS(x[i]));
    if (largest > COTREE_MAX) return 1; /* an infinite state would accept every residual */
    for (i = 0; i < run->model->n_constraints; ++i) {
        if (!(COTREE_FABS(run->residual[i]) <= COTREE_LARGEST_RESIDUAL * largest)) return 1;
    }
    return 0;
}

/* Project the states, weighted by their inertia, and then the sensitivities. */
static int project_point(cotree_run *run, cotree_real t, cotree_real *z)
{
#if COTREE_HAS_SENSITIVITIES
    const cotree_model *const model = run->model;
    int n;
#endif
    int status;
    t = cotree_run_inside(run, t); /* at a time event, use the constraints of this segment */
    status = cotree_run_inputs(run, t);
    if (status == 0) status = project_states(run, t, z);
    if (status == 0) status = check_constraints(run, t, z);
#if COTREE_HAS_SENSITIVITIES
    /* Sensitivities of speeds converge one step after sensitivities of coordinates. */
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
    status = project_point(run, t, run->held);
    if (status != 0) return status;
    for (i = 0; i < run->n_rates; ++i) {
        const cotree_real change =
            COTREE_FABS(run->held[i] - z[i]) / COTREE_FMAX(COTREE_F(1.0), COTREE_FABS(z[i]));
        run->correction = COTREE_FMAX(run->correction, change);
        if (change > MAX_DRIFT * run->rtol) run->n_strict = STRICT_POINTS;
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

void cotree_count_failure(cotree_run *run)
{
    if (++run->n_failed > MAX_FAILURES) run->n_strict = STRICT_POINTS;
}

/* Return whether rates are evaluated at projected points. Near singular configurations, rates off
 * the constraints grow without bound and steps fail; elsewhere projection costs more than it
 * saves. */
int cotree_are_rates_projected(const cotree_run *run)
{
    if (!cotree_run_is_constrained(run) || run->model->gradient == NULL) return 0;
    return run->is_strict || run->n_strict > 0;
}

const cotree_real *cotree_run_held(cotree_run *run, cotree_real t, const cotree_real *z)
{
    int i;
    if (!cotree_are_rates_projected(run)) return z;
    for (i = 0; i < run->n_full; ++i) run->held[i] = z[i];
    return project_point(run, t, run->held) == 0 ? run->held : z;
}
#endif
