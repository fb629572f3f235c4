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
#if COTREE_MAIN_PAGE
    call.n_set = initial.n_set;
    call.set = initial.set;
    call.values = initial.values;
#endif
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
#if COTREE_MAIN_PAGE && !COTREE_MAIN_START && !COTREE_MAIN_TABLES
/* Replace initial values. They are numbers, so they do not depend on parameters. */
static void set_initial(void)
{
    int i;
    for (i = 0; i < initial.n_set; ++i) {
        const int state = initial.set[i];
#if COTREE_HAS_SENSITIVITIES
        int j;
#endif
        problem.z[state] = initial.values[i];
#if COTREE_HAS_SENSITIVITIES
        for (j = 0; j < N_SENSITIVITIES; ++j) {
            if (SEEDS[j] >= 0) problem.z[(1 + j) * N_STATES + state] = COTREE_F(0.0);
        }
#endif
    }
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
#if COTREE_MAIN_PAGE
    set_initial();
#endif
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

