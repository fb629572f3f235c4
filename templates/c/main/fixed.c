/* The model as the right-hand side for the integrator. */
static cotree_run run;
#if COTREE_HAS_IMPLICIT
static cotree_stiff stiff;
#endif

/* Initialise the run in an arena; if it has no memory, only count the bytes. */
static void begin_run(cotree_arena *arena)
{
    cotree_run_init(&run, MODEL, problem.p, problem.k, problem.u, 1, arena);
    run.atol = request.atol;
#if COTREE_HAS_IMPLICIT
    cotree_stiff_init(&stiff, &run, NEWTON, arena);
#endif
}

/* Compute run.full, all states and sensitivities, at the current point of the integrator. */
static int complete(const integrator *d)
{
#if COTREE_HAS_IMPLICIT
    const int status = cotree_stiff_complete(&stiff, d->t, d->y);
#else
    const int status = cotree_run_complete(&run, d->t, d->y);
#endif
    return status == 0 ? 0 : fail("the algebraic equations cannot be solved");
}

/* Initialise the integrator at the start. */
static cotree_status set_up(integrator *d, cotree_real step)
{
    static cotree_real w[LENGTH(N_UNKNOWNS)], workspace[LENGTH(WORKSPACE(N_UNKNOWNS))];
    cotree_status status;
#if COTREE_HAS_IMPLICIT
    cotree_run_pack(&run, problem.z, w);
    status = METHOD(init)(d, cotree_stiff_equation(&stiff), COTREE_F(0.0), w, step, workspace);
#if COTREE_MAIN_CONSTRAINTS
    d->project = cotree_stiff_project;
#endif
#else
    run.rtol = request.rtol;
#if COTREE_MAIN_EXTENDED
    cotree_run_extend(&run);
#endif
    cotree_run_narrow(&run, COTREE_F(0.0), problem.z, w);
    status = METHOD(init)(d, run.n, cotree_run_rate, &run, COTREE_F(0.0), w, step, workspace);
#if COTREE_MAIN_CONSTRAINTS
    run.is_strict = IS_STRICT;
#endif
#if COTREE_MAIN_CONSTRAINTS || COTREE_MAIN_EXTENDED
    d->project = cotree_run_project;
#endif
#endif
    return status;
}

/* Return the index of the step that is nearest to a point of the table. */
static long step_of(long row, long n_points, long n)
{
    const cotree_real ratio = (cotree_real)row * (cotree_real)n / (cotree_real)(n_points - 1);
    return (long)(ratio + COTREE_F(0.5));
}

int main(int argc, char **argv)
{
    static integrator d;
    static cotree_arena arena; /* static, so that it is initially empty */
    cotree_real steps;
    cotree_status status;
    long i, n, row = 0;
    const int refused = read_arguments(argc, argv);
    const cotree_real t_end = request.t_end;
    const long n_points = request.n_points;
    if (refused >= 0) return refused;
    if (begin() != 0) return EXIT_FAILURE;
    out = request.csv == NULL ? stdout : fopen(request.csv, "w");
    if (out == NULL) return refuse(request.csv, "the file cannot be written");
    steps =
        COTREE_FLOOR(COTREE_FABS(t_end / request.step) + COTREE_F(0.5)); /* rounded to the nearest integer */
    if (!(steps < COTREE_F(1e9))) return fail("there are too many steps to the end time");
    n = (long)steps;
    begin_run(&arena);
    /* This is the only allocation; without a heap, an array of this size can replace it. */
    arena.base = (char *)calloc(1, arena.used);
    if (arena.base == NULL) return fail("out of memory");
    arena.used = 0;
    begin_run(&arena);
    status = set_up(&d, t_end < COTREE_F(0.0) ? -request.step : request.step);
    if (n_points > n + 1) return fail("there are fewer steps than points");
    if (n_points > 0) print_head();
    for (i = 0; i <= n && status == COTREE_OK; ++i) {
        /* Each row of the table contains the step that is nearest to its time. */
        if (row < n_points && i == step_of(row, n_points, n)) {
            if (complete(&d) != 0 || print_row(d.t, run.full) != 0) return EXIT_FAILURE;
            ++row;
        }
        if (i < n) status = METHOD(step)(&d);
    }
    if (status != COTREE_OK) {
        fprintf(stderr, "%s: the integration stops at t = %.6g: %s.\n", TITLE, d.t,
                cotree_status_message(status));
        return EXIT_FAILURE;
    }
    if (n_points > 0) {
        return fflush(out) == 0 ? EXIT_SUCCESS : fail("the results cannot be written");
    }
    if (complete(&d) != 0) return EXIT_FAILURE;
    return print_state(d.t, run.full) == 0 ? EXIT_SUCCESS : EXIT_FAILURE;
}
