/* cotree_sundials.c: stepper of a job with the backward differentiation formulas of SUNDIALS.
 *
 * CVODE integrates the states; algebraic unknowns are solved for at each evaluation. IDA integrates
 * states and unknowns. Its error test excludes the unknowns, which are solved for at each stored
 * point. */
#include "cotree_sundials_internal.h"

#include "cotree_limits.h"

#include <string.h>

/* A rounding error of t is negligible if it is below this fraction of rtol times the step. */
#define NEGLIGIBLE_ROUNDING 1e-2

/* List the state index of each vector entry, and the first entry of each block. */
static void list_blocks(const cotree_job *job)
{
    const cotree_model *const model = job->model;
    const cotree_bdf *const c = bdf_of(job);
    int i, j, n = BLOCK(model);
    c->firsts[0] = 0;
    c->firsts[1] = n;
    for (i = 0; i < n; ++i) c->rows[i] = i;
    for (j = 1; j < n_blocks_of(job); ++j) {
        for (i = model->sensitivity_starts[j - 1]; i < model->sensitivity_starts[j]; ++i) {
            if (model->sensitivity_rows[i] < BLOCK(model))
                c->rows[n++] = model->sensitivity_rows[i];
        }
        c->firsts[j + 1] = n;
    }
}

static double *allocate(cotree_arena *arena, size_t n)
{
    return (double *)cotree_arena_alloc(arena, n * sizeof(double), NULL);
}

static void lay_out(cotree_job *job, cotree_engine *e, cotree_arena *arena)
{
    const cotree_sundials_aid *const aid = (const cotree_sundials_aid *)job->aid;
    const int n_states = BLOCK(job->model), has_sensitivities = job->has_sensitivities;
    cotree_bdf spare, *const c = (cotree_bdf *)cotree_arena_alloc(arena, sizeof(spare), &spare);
    int i;
    memset(c, 0, sizeof(*c));
    e->own = c;
    e->run = e->of_states = e->watched =
        cotree_job_begin_run(job, &e->runs[0], has_sensitivities, arena);
    if (has_sensitivities) e->of_states = cotree_job_begin_run(job, &e->runs[1], 0, arena);
    /* Values set by events may violate the constraints, so the run that evaluates events projects
     * them. */
    if (job->model->hybrid != NULL) {
        e->watched = cotree_job_begin_run(job, &e->runs[2], has_sensitivities, arena);
    }
    c->aid = aid;
    c->sundials = aid->sundials;
    for (i = 0; i < N_VECTORS; ++i) c->vectors[i] = cotree_arena_reals(arena, job->n);
    c->ordered = cotree_arena_reals(arena, n_states);
    c->jacobian = allocate(arena, entries_of_jacobian(job->model));
    c->trial = allocate(arena, entries_of_jacobian(job->model));
    c->entries = allocate(arena, cotree_lu_doubles(n_states, aid->lower, aid->upper));
    c->matrix = cotree_lu_of(n_states, aid->lower, aid->upper, c->entries,
                             cotree_arena_ints(arena, n_states));
    c->rows = cotree_arena_ints(arena, job->n);
    c->firsts = cotree_arena_ints(arena, n_blocks_of(job) + 1);
#if COTREE_SENSITIVITIES
    {
        const size_t n = (size_t)N_KINDS * (size_t)job->model->n_sensitivities;
        c->apart = allocate(arena, n * (size_t)n_states);
        c->pointers = (void **)cotree_arena_alloc(arena, n * sizeof(void *), NULL);
        for (i = 0; (size_t)i < n && c->pointers != NULL; ++i) c->pointers[i] = NULL;
    }
#endif
}

COTREE_PRIVATE int cotree_bdf_first_not_finite(const double *values, int n)
{
    double sum = 0.0;
    int i;
    for (i = 0; i < n; ++i) sum += values[i] * 0.0;
    if (sum == 0.0) return -1;
    for (i = 0; i < n - 1; ++i) {
        if (!(fabs(values[i]) <= DBL_MAX)) break;
    }
    return i;
}

#if COTREE_IDA
/* Compute the rates of the states, and the residuals in the entries of algebraic unknowns. */
static int rates_at(cotree_run *run, double t, const double *z, double *dz)
{
    const double at = cotree_run_inside(run, t);
    if (run->model->n_algebraic == 0) return cotree_run_rate(t, z, dz, run);
    if (cotree_run_is_constrained(run)) {
        cotree_run_unpack(run, z, run->full);
        cotree_run_pack(run, cotree_run_held(run, at, run->full), run->step);
        z = run->step;
    }
    return cotree_run_packed_rate(run, at, z, dz);
}
#else
static int rates_at(cotree_run *run, double t, const double *z, double *dz)
{
    return cotree_run_rate(t, z, dz, run);
}
#endif

/* Compute the rates of a run. If the result is positive, SUNDIALS tries a shorter step. */
COTREE_PRIVATE int cotree_bdf_evaluate(cotree_job *job, cotree_run *run, double t, const double *z,
                                       double *dz)
{
    const int status = rates_at(run, t, z, dz), n = length_of(job, run);
    int entry;
    ++job->n_evaluations;
    job->kernel_status = status;
    if (status != 0) return status > 0 ? RATES_AGAIN : RATES_FAIL;
    entry = cotree_bdf_first_not_finite(dz, n);
    if (entry < 0) return 0;
    job->entry = entry;
    return RATES_AGAIN;
}

static int solver_solve(void *solver, void *start, void *correction, void *weights,
                        double tolerance, int is_matrix_old, void *integrator)
{
    cotree_job *const job = (cotree_job *)((cotree_solver *)solver)->content;
    const cotree_sundials *const s = bdf_of(job)->sundials;
    cotree_system system;
    (void)is_matrix_old, (void)start;
    if (cotree_bdf_read_system(job, integrator, &system) != 0) return RATES_FAIL;
#if COTREE_SIMULTANEOUS
    if (is_simultaneous(job)) {
        if (cotree_bdf_gather_system(job, integrator) != 0) return RATES_FAIL;
        return cotree_bdf_solve_simultaneous(job, &system, weights, tolerance, correction);
    }
#endif
#if COTREE_SENSITIVITIES
    return cotree_bdf_solve_states(job, &system, s->N_VGetArrayPointer(weights), tolerance,
                                   s->N_VGetArrayPointer(correction));
#else
    return cotree_bdf_solve_system(job, &system, s->N_VGetArrayPointer(weights), tolerance,
                                   s->N_VGetArrayPointer(correction));
#endif
}

#if !COTREE_IDA
static int rate(double since, void *y, void *dy, void *data)
{
    cotree_job *const job = (cotree_job *)data;
    const cotree_sundials *const s = bdf_of(job)->sundials;
    const double t = clock_at(job, since);
#if COTREE_SENSITIVITIES
    /* CVODES calls this function if the rates of sensitivities need those of the states. */
    const int is_known = bdf_of(job)->has_rates_next && bdf_of(job)->time_of_rates == t;
    bdf_of(job)->has_rates_next = 0;
    if (is_known) return 0;
#endif
    return cotree_bdf_evaluate(job, own_run_of(job), t, s->N_VGetArrayPointer(y),
                               s->N_VGetArrayPointer(dy));
}

#else
/* The nonlinear solver evaluates the residuals. IDAS calls this function after they are known. */
static int residual(double since, void *y, void *dy, void *left, void *data)
{
#if COTREE_SENSITIVITIES
    cotree_job *const job = (cotree_job *)data;
    const int is_known =
        bdf_of(job)->has_rates_next && bdf_of(job)->time_of_rates == clock_at(job, since);
    (void)y, (void)dy, (void)left;
    bdf_of(job)->has_rates_next = 0;
    return is_known ? 0 : RATES_FAIL;
#else
    (void)since, (void)y, (void)dy, (void)left, (void)data;
    return RATES_FAIL;
#endif
}

#endif
/* Return the status for a return value of SUNDIALS. Positive values are statuses of cotree. */
static int status_of(cotree_job *job, int flag)
{
    /* Return values of SUNDIALS, and the statuses that they mean. */
    static const int rows[][2] = {
        {-2, COTREE_TOO_TIGHT},
        {-3, COTREE_ERROR_TEST_FAILED},
        {-4, COTREE_NOT_CONVERGED},
        {-8, COTREE_RATE_STOPPED},
        {-42, COTREE_SENSITIVITIES_FAILED},
#if COTREE_IDA
        {-9, COTREE_RATE_FAILED},
        {-12, COTREE_CANNOT_START},
#else
        {-9, COTREE_CANNOT_START},
        {-10, COTREE_RATE_FAILED},
        {-11, COTREE_RATE_FAILED},
        {-41, COTREE_SENSITIVITIES_FAILED},
        {-43, COTREE_SENSITIVITIES_FAILED},
        {-44, COTREE_SENSITIVITIES_FAILED},
#endif
    };
    size_t i;
    if (flag >= 0) return flag;
    job->flag = flag;
#if !COTREE_IDA
    if (flag == NO_CONVERGENCE && (job->kernel_status > 0 || job->entry >= 0 || job->row >= 0)) {
        return COTREE_RATE_FAILED; /* the rates fail at any step size */
    }
#endif
    for (i = 0; i < sizeof rows / sizeof rows[0] && rows[i][0] != flag;) ++i;
    return i < sizeof rows / sizeof rows[0] ? rows[i][1] : COTREE_FLAGGED;
}

static int set_tolerances(cotree_job *job)
{
    cotree_bdf *const c = bdf_of(job);
    c->rtol = job->rtol;
    memcpy(vector_of(job, ATOLS), job->atols, (size_t)job->n * sizeof(double));
    return c->sundials->OF(SVtolerances)(c->integrator, job->rtol, c->handles[ATOLS]);
}

static int create_integrator(cotree_job *job)
{
    cotree_bdf *const c = bdf_of(job);
    const cotree_sundials *const s = c->sundials;
    int flag;
#if !COTREE_IDA
    c->integrator = s->CVodeCreate(BDF, c->context);
    if (c->integrator == NULL) return COTREE_NO_MEMORY;
    flag = s->CVodeInit(c->integrator, rate, 0.0, c->handles[Y]);
#else
    c->integrator = s->IDACreate(c->context);
    if (c->integrator == NULL) return COTREE_NO_MEMORY;
    flag = s->IDAInit(c->integrator, residual, 0.0, c->handles[Y], c->handles[SLOPES]);
#endif
    if (flag == 0) flag = c->sundials->OF(SetUserData)(c->integrator, job);
    if (flag == 0) flag = set_tolerances(job);
#if COTREE_SENSITIVITIES
    if (flag == 0) flag = cotree_bdf_start_sensitivities(job);
#else
    if (flag == 0) flag = c->sundials->OF(SetNonlinearSolver)(c->integrator, c->solver);
#endif
#if !COTREE_IDA
    if (flag == 0) flag = s->CVodeSetMaxHnilWarns(c->integrator, -1);
#else
    if (flag == 0 && job->model->n_algebraic > 0) {
        flag = s->IDASetId(c->integrator, c->handles[KINDS]);
        if (flag == 0) flag = s->IDASetSuppressAlg(c->integrator, 1);
    }
#endif
    if (flag == 0 && job->max_step < DBL_MAX)
        flag = c->sundials->OF(SetMaxStep)(c->integrator, job->max_step);
    return flag;
}

/* Create the vectors and the nonlinear solver. */
static int create_objects(cotree_job *job)
{
    cotree_bdf *const c = bdf_of(job);
    const cotree_sundials *const s = c->sundials;
    int i;
    if (s->SUNContext_Create(0, &c->context) != 0) return COTREE_NO_MEMORY;
    s->SUNContext_ClearErrHandlers(c->context); /* the default handlers print messages */
    for (i = 0; i < N_HANDLES; ++i) {
        c->handles[i] = s->N_VMake_Serial(VECTOR(job), vector_of(job, i), c->context);
        if (c->handles[i] == NULL) return COTREE_NO_MEMORY;
    }
    c->solver = cotree_bdf_make_solver(job, solver_solve);
    if (c->solver == NULL) return COTREE_NO_MEMORY;
#if COTREE_SENSITIVITIES
    if (job->has_sensitivities && cotree_bdf_make_sensitivities(job) != 0) return COTREE_NO_MEMORY;
#endif
    return COTREE_OK;
}

/* Free the SUNDIALS objects that exist; may be called at any time. */
static void close(cotree_job *job)
{
    cotree_bdf *const c = bdf_of(job);
    int i;
    if (c == NULL) return; /* no integrator was opened */
    if (c->integrator != NULL) c->sundials->OF(Free)(&c->integrator);
    if (c->solver != NULL) c->sundials->SUNNonlinSolFreeEmpty(c->solver);
#if COTREE_SENSITIVITIES
    cotree_bdf_free_sensitivities(job);
#endif
    for (i = 0; i < N_HANDLES; ++i) {
        if (c->handles[i] != NULL) c->sundials->N_VDestroy(c->handles[i]);
        c->handles[i] = NULL;
    }
    if (c->context != NULL) c->sundials->SUNContext_Free(&c->context);
    c->integrator = c->solver = c->context = NULL;
}

/* Start or restart the integrator at the current values. */
static int start(cotree_job *job, double end)
{
    cotree_bdf *const c = bdf_of(job);
    const cotree_sundials *const s = c->sundials;
    const int is_first = c->context == NULL;
    int flag = is_first ? create_objects(job) : 0;
#if COTREE_IDA
    double length = 0.0;
    if (flag == 0) flag = cotree_bdf_find_slopes(job, &length);
#endif
    if (flag == 0 && is_first) flag = create_integrator(job);
    if (flag == 0 && !is_first) {
#if COTREE_IDA
        flag = s->IDAReInit(c->integrator, 0.0, c->handles[Y], c->handles[SLOPES]);
#else
        flag = s->CVodeReInit(c->integrator, 0.0, c->handles[Y]);
#endif
        if (flag == 0 && c->rtol != job->rtol) flag = set_tolerances(job);
#if COTREE_SENSITIVITIES
        if (flag == 0) flag = cotree_bdf_restart_sensitivities(job);
#endif
    }
#if COTREE_IDA
    if (flag == 0) flag = c->sundials->OF(SetInitStep)(c->integrator, length);
#endif
    return flag != 0
               ? flag
               : c->sundials->OF(SetStopTime)(c->integrator, end - cotree_engine_of(job)->origin);
}

static int take_step(const cotree_job *job, double end, double *t)
{
    const cotree_bdf *const c = bdf_of(job);
#if !COTREE_IDA
    const int flag = c->sundials->CVode(c->integrator, end, c->handles[Y], t, ONE_STEP);
#else
    const int flag =
        c->sundials->IDASolve(c->integrator, end, t, c->handles[Y], c->handles[SLOPES], ONE_STEP);
#endif
#if COTREE_SENSITIVITIES
    return flag < 0 ? flag : cotree_bdf_read_sensitivities(job);
#else
    return flag;
#endif
}

static int read_between(const cotree_job *job, double t)
{
    const cotree_bdf *const c = bdf_of(job);
    const double low = fmin(c->passed, c->reached), high = fmax(c->passed, c->reached);
    const double since = fmin(fmax(t - cotree_engine_of(job)->origin, low), high);
    const int flag = c->sundials->OF(GetDky)(c->integrator, since, 0, c->handles[BETWEEN]);
#if COTREE_SENSITIVITIES
    return flag != 0 ? flag : cotree_bdf_read_sensitivities_between(job, since);
#else
    return flag;
#endif
}

static int complete(cotree_job *job, double t, double *w, int is_exact)
{
    cotree_run *const run = all_of(job);
    int i;
#if COTREE_IDA
    double *const z = w;
    w = vector_of(job, STEP);
    cotree_run_unpack(run, z, run->full);
    cotree_run_narrow(run, t, run->full, w); /* uses the interpolated unknowns as a guess */
#endif
    /* A projection leaves a residual proportional to the square of its last correction and to the
     * speeds: repeat it once. */
    for (i = is_exact ? 1 : 0; i < 2 && is_constrained(job); ++i) {
        if (cotree_run_project(t, w, run) != 0) return COTREE_NOT_PROJECTED;
    }
#if COTREE_IDA
    if (cotree_run_complete(run, t, w) == 0) return 0;
    /* Extrapolated voltages are poor guesses if junctions start to conduct: use the current
     * point. */
    cotree_run_unpack(run, cotree_engine_of(job)->w, run->full);
    cotree_run_narrow(run, job->t, run->full, vector_of(job, MOVED));
#endif
    return cotree_run_find(run, t, w) != 0 ? COTREE_NOT_SOLVED : COTREE_OK;
}

/* Return whether the rounding error of the end time of the last step is significant. */
static int is_rounding_significant(const cotree_job *job)
{
    const cotree_bdf *const c = bdf_of(job);
    const double rounding = job->t - cotree_engine_of(job)->origin - c->reached;
    return fabs(rounding) > NEGLIGIBLE_ROUNDING * job->rtol * fabs(c->reached - c->passed);
}

/* The interpolation of BDF methods is as accurate as their steps, so is_careful has no effect. */
static int between(cotree_job *job, double t, int is_careful, double **w, int *is_exact)
{
    (void)is_careful;
    *is_exact = bdf_of(job)->is_idle || (t == job->t && !is_rounding_significant(job));
    *w = *is_exact ? cotree_engine_of(job)->w : vector_of(job, BETWEEN);
    return *is_exact ? COTREE_OK : status_of(job, read_between(job, t));
}

static double known(const cotree_job *job, int is_last)
{
    (void)is_last;
    return job->t;
}

/* With sensitivities, matrices are renewed at each step if a factorisation takes at most this many
 * multiplications. This saves a quarter of the steps and a third of the evaluations for HIRES and
 * for Robertson's reactions. */
#define FEW_MULTIPLICATIONS 8000.0

#if COTREE_IDA
/* The corresponding limit for models with algebraic unknowns. */
#define MANY_MULTIPLICATIONS 3e7
#endif

/* Return whether each step renews its matrices because they are cheap to factorise: with CVODE for
 * sensitivities, with IDA also for junctions, whose slopes change by orders of magnitude within a
 * step. */
static int has_cheap_matrices(const cotree_job *job)
{
    const cotree_sundials_aid *const aid = bdf_of(job)->aid;
    const double n = BLOCK(job->model), lower = aid->lower, upper = aid->upper;
    const double multiplications = n * lower * (lower + upper);
#if !COTREE_IDA
    return job->has_sensitivities && multiplications <= FEW_MULTIPLICATIONS;
#else
    const int has_algebraic = job->model->n_algebraic > 0;
    return multiplications <= (has_algebraic ? MANY_MULTIPLICATIONS : FEW_MULTIPLICATIONS);
#endif
}

/* Set whether rates are evaluated at projected points: only if constraints are dependent, or near
 * singular positions. Steps always end on the constraints. */
static void set_rate_projection(const cotree_job *job)
{
    cotree_engine *const e = cotree_engine_of(job);
    if (e->watched != e->run) e->watched->is_strict = job->is_strict;
    e->run->is_held = e->run->is_strict = job->is_held && job->is_strict;
    e->of_states->is_held = e->of_states->is_strict = e->run->is_held;
}

static void open(cotree_job *job)
{
    cotree_engine *const e = cotree_engine_of(job);
    double *const w = vector_of(job, STEP);
    list_blocks(job);
    bdf_of(job)->is_fresh = has_cheap_matrices(job);
#if COTREE_SIMULTANEOUS
    if (is_simultaneous(job)) bdf_of(job)->is_fresh = 0;
#endif
    set_rate_projection(job);
    if (e->watched != e->run) {
        e->watched->rtol = job->rtol;
        cotree_run_narrow(e->watched, job->t, job->z, w);
    }
    if (e->of_states != e->run) cotree_run_narrow(e->of_states, job->t, job->z, w);
#if !COTREE_IDA
    cotree_run_narrow(e->run, job->t, job->z, e->w);
#else
    cotree_run_narrow(e->run, job->t, job->z, w);
    cotree_run_pack(e->run, job->z, e->w);
#endif
}

/* A segment at rounding level is skipped if it is also below this fraction of the span. */
#define NEGLIGIBLE 1e-9

static int is_rounding(const cotree_job *job, double length, double t)
{
    const double distance = fabs(t - cotree_engine_of(job)->origin);
    return fabs(length) <= COTREE_STALL_SPACINGS * DBL_EPSILON * distance;
}

static int is_negligible(const cotree_job *job, double length)
{
    const double span = job->breakpoints[job->n_breakpoints - 1] - job->breakpoints[0];
    return fabs(length) <= COTREE_STALL_SPACINGS * DBL_EPSILON * fabs(job->t) &&
           fabs(length) <= NEGLIGIBLE * fabs(span);
}

/* Restart at the current point, after a jump of inputs or an event. */
static int begin(cotree_job *job)
{
    cotree_engine *const e = cotree_engine_of(job);
    cotree_bdf *const c = bdf_of(job);
    double *const y = vector_of(job, Y);
    const double end = job->breakpoints[job->segment + 1];
    int i, status;
    set_rate_projection(job);
    c->has_jacobian = c->has_matrix = c->has_failed = 0;
    c->step_of_solution = -1;
    c->bend = 1.0;
    /* Use the unknowns after the last event as guesses. */
    if (e->watched != e->run && job->model->n_algebraic > 0) {
        cotree_run_narrow(e->of_states, job->t, e->watched->full, vector_of(job, STEP));
        cotree_run_narrow(e->run, job->t, e->watched->full, vector_of(job, STEP));
    }
    status = complete(job, e->is_helped ? cotree_run_inside(e->run, job->t) : job->t, e->w, 0);
    if (status != COTREE_OK) return status;
#if !COTREE_IDA
    cotree_run_leave_out(e->run, e->run->full, y);
#else
    cotree_run_pack(e->run, e->run->full, y);
#endif
    for (i = 0; i < job->n; ++i) e->w[i] = y[i];
    c->is_idle = is_negligible(job, end - job->t);
    if (c->is_idle) return COTREE_OK;
    e->origin = job->t;
    c->passed = c->reached = 0.0;
    return status_of(job, start(job, end));
}

/* Take one step. A step at rounding level is skipped. */
static int step(cotree_job *job, double end)
{
    cotree_engine *const e = cotree_engine_of(job);
    cotree_bdf *const c = bdf_of(job);
    const double *const y = vector_of(job, Y);
    const double whole = end - e->origin;
    double since = c->reached, t = end;
    int i;
    if (!c->is_idle && !is_rounding(job, end - job->t, end)) {
        const int flag = take_step(job, whole, &since);
        c->passed = c->reached;
        c->reached = since;
        if (flag < 0) return status_of(job, flag);
        if (since != whole) {
            t = clock_at(job, since);
            /* The rounded time must be before the end and within the step. */
            if (fabs(t - e->origin) > fabs(since) || t == end) t = nextafter(t, e->origin);
        }
    }
    if (cotree_bdf_first_not_finite(y, job->n) >= 0) return COTREE_NOT_FINITE;
    job->t = t;
    for (i = 0; i < job->n; ++i) e->w[i] = y[i];
    return COTREE_OK;
}

static const cotree_stepper stepper = {
    .is_multistep = 1,
    .lay_out = lay_out,
    .open = open,
    .begin = begin,
    .step = step,
    .known = known,
    .between = between,
    .complete = complete,
    .close = close,
};

#if COTREE_IDA
#if COTREE_SENSITIVITIES
const cotree_stepper *cotree_idas_stepper(void)
#else
const cotree_stepper *cotree_ida_stepper(void)
#endif
#else
#if COTREE_SENSITIVITIES
const cotree_stepper *cotree_cvodes_stepper(void)
#else
const cotree_stepper *cotree_cvode_stepper(void)
#endif
#endif
{
    return &stepper;
}
