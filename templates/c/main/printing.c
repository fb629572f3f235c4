/* Stream to which values are printed. */
static FILE *out;

static int fail(const char *what)
{
    fprintf(stderr, "%s: %s.\n", TITLE, what);
    return EXIT_FAILURE;
}

/* Report an invalid argument. */
static int refuse(const char *argument, const char *why)
{
    fprintf(stderr, "%s: %s: %s.\n", TITLE, argument, why);
    return 2;
}

#if COTREE_MAIN_TABLES
/* Compute states and sensitivities that satisfy all equations and keep the prescribed values. */
static int find_start(void)
{
    static cotree_start_call call; /* static, so that it is initially zero */
    int status;
    call.model = MODEL;
    call.tables = &start_tables;
    call.p = problem.p;
    call.k = problem.k;
#if COTREE_MAIN_GUESS
    call.guess = guess;
#endif
    call.has_sensitivities = N_SENSITIVITIES > 0;
    call.z = problem.z;
    call.culprit = "";
    status = cotree_start_once(&call);
    if (status == 0) return 0;
    fprintf(stderr, "%s: there is no start: %s", TITLE, cotree_start_message(status));
    if (call.culprit[0] != '\0') fprintf(stderr, ": %s", call.culprit);
    fprintf(stderr, ".\n");
    return EXIT_FAILURE;
}

#endif
/* Compute the prepared values, and the initial states and sensitivities. */
static int begin(void)
{
    int status = MODEL->prepare(problem.p, problem.k);
#if COTREE_MAIN_GUARDS
    if (status < 0) return fail(MODEL->guards[-1 - status]);
#endif
    if (status != 0) return fail("the constants that depend on parameters cannot be computed");
#if COTREE_MAIN_START
    memcpy(problem.z, start, sizeof start);
#endif
#if COTREE_MAIN_TABLES
    status = find_start();
#endif
#if !COTREE_MAIN_START && !COTREE_MAIN_TABLES
    status = MODEL->initial(problem.p, problem.k, problem.z);
#if COTREE_HAS_SENSITIVITIES
    if (status == 0) {
        status = MODEL->initial_sensitivity(problem.p, problem.k, problem.z + N_STATES);
    }
#endif
    if (status != 0) return fail("the initial state cannot be computed");
#endif
    return status;
}

static cotree_real y[LENGTH(N_OUTPUTS)];
#if COTREE_HAS_SENSITIVITIES
static cotree_real dy[LENGTH(N_OUTPUTS * N_SENSITIVITIES)];
#endif

/* Compute inputs and outputs at a time, and the sensitivities of the outputs. */
static int find_outputs(cotree_real t, const cotree_real *z)
{
    int status = 0;
#if COTREE_HAS_INPUTS
    status = MODEL->inputs_of_time(t, problem.p, problem.k, problem.u);
#endif
    if (status == 0 && N_OUTPUTS > 0) {
        status = MODEL->outputs_of_state(t, z, problem.u, problem.p, problem.k, y);
    }
#if COTREE_HAS_SENSITIVITIES
    if (status == 0 && N_OUTPUTS > 0) {
        status = MODEL->output_sensitivity(t, z, z + N_STATES, problem.u, problem.p, problem.k, dy);
    }
#endif
    return status == 0 ? 0 : fail("the outputs cannot be computed");
}

static void print_values(const cotree_quantity *names, int n, const cotree_real *values)
{
    int i;
    for (i = 0; i < n; ++i) fprintf(out, "%s = %#.12g\n", names[i].name, values[i]);
}

#if COTREE_HAS_SENSITIVITIES
static void print_slopes(const cotree_quantity *names, int n, const cotree_real *values)
{
    int i, j;
    for (j = 0; j < N_SENSITIVITIES; ++j) {
        for (i = 0; i < n; ++i) {
            fprintf(out, "d(%s)/d(%s) = %#.12g\n", names[i].name, MODEL->sensitivities[j],
                    values[j * n + i]);
        }
    }
}

#endif
/* Print states and outputs at one time, each followed by its sensitivities. */
static int print_state(cotree_real t, const cotree_real *z)
{
    print_values(MODEL->states, N_STATES, z);
#if COTREE_HAS_SENSITIVITIES
    print_slopes(MODEL->states, N_STATES, z + N_STATES);
#endif
    if (find_outputs(t, z) != 0) return EXIT_FAILURE;
    print_values(MODEL->outputs, N_OUTPUTS, y);
#if COTREE_HAS_SENSITIVITIES
    print_slopes(MODEL->outputs, N_OUTPUTS, dy);
#endif
    return fflush(out) == 0 ? 0 : fail("the results cannot be written");
}

static void print_titles(const cotree_quantity *names, int n)
{
    int i;
    for (i = 0; i < n; ++i) fprintf(out, ",%s", names[i].name);
}

static void print_cells(const cotree_real *values, int n)
{
    int i;
    for (i = 0; i < n; ++i) fprintf(out, ",%.17g", values[i]);
}

#if COTREE_HAS_SENSITIVITIES
static void print_slope_titles(const cotree_quantity *names, int n)
{
    int i, j;
    for (i = 0; i < n; ++i) {
        for (j = 0; j < N_SENSITIVITIES; ++j) {
            fprintf(out, ",d(%s)/d(%s)", names[i].name, MODEL->sensitivities[j]);
        }
    }
}

/* Print sensitivities, which are stored parameter by parameter. */
static void print_slope_cells(const cotree_real *values, int n)
{
    int i, j;
    for (i = 0; i < n; ++i) {
        for (j = 0; j < N_SENSITIVITIES; ++j) fprintf(out, ",%.17g", values[j * n + i]);
    }
}

#endif
/* Print the header of a table of comma-separated values. */
static void print_head(void)
{
    fprintf(out, "t");
    print_titles(MODEL->states, N_STATES);
    print_titles(MODEL->outputs, N_OUTPUTS);
    print_titles(MODEL->inputs, N_INPUTS);
#if COTREE_HAS_SENSITIVITIES
    print_slope_titles(MODEL->states, N_STATES);
    print_slope_titles(MODEL->outputs, N_OUTPUTS);
#endif
    fprintf(out, "\n");
}

/* Print a row of the table. 17 digits identify every number uniquely. */
static int print_row(cotree_real t, const cotree_real *z)
{
    if (find_outputs(t, z) != 0) return EXIT_FAILURE;
    fprintf(out, "%.17g", t);
    print_cells(z, N_STATES);
    print_cells(y, N_OUTPUTS);
    print_cells(problem.u, N_INPUTS);
#if COTREE_HAS_SENSITIVITIES
    print_slope_cells(z + N_STATES, N_STATES);
    print_slope_cells(dy, N_OUTPUTS);
#endif
    fprintf(out, "\n");
    return ferror(out) ? fail("the results cannot be written") : 0;
}
