static cotree_job job; /* static, so that it is initially zero */
#if COTREE_MAIN_EVENTS
#define RECORD COTREE_EVENTS_RECORD(N_STATES, N_SENSITIVITIES)
#endif

#if COTREE_MAIN_EVENTS && !COTREE_MAIN_PAGE
/* Print the times of events, with their sensitivities. */
static void print_events(void)
{
    FILE *const to = job.n_wanted > 0 ? stderr : out; /* keeps messages out of the rows of values */
    static long counts[N_EVENTS];
    int i;
    for (i = 0; i < job.n_records; ++i) {
        const cotree_real *const row = job.records + i * RECORD;
        const int event = (int)row[1];
        const char *const name = MODEL->hybrid->events[event].name;
#if COTREE_HAS_SENSITIVITIES
        int j;
#endif
        fprintf(to, "%s[%ld] = %#.12g\n", name, counts[event], row[0]);
#if COTREE_HAS_SENSITIVITIES
        for (j = 0; j < N_SENSITIVITIES; ++j) {
            fprintf(to, "d(%s[%ld])/d(%s) = %#.12g\n", name, counts[event], MODEL->sensitivities[j],
                    row[2 + j]);
        }
#endif
        ++counts[event];
    }
    job.n_records = 0;
}

#endif
#if COTREE_MAIN_EVENTS && COTREE_MAIN_PAGE
/* Append the time, the index and the sensitivities of each event to the results of the page. */
static void keep_events(void)
{
    const size_t width = 2 + N_SENSITIVITIES, n = (size_t)(results.n_events + job.n_records);
    cotree_real *const events =
        (cotree_real *)realloc(results.events, LENGTH(n) * width * sizeof(cotree_real));
    int i;
    for (i = 0; events != NULL && i < job.n_records; ++i) {
        memcpy(events + (size_t)results.n_events * width, job.records + i * RECORD,
               width * sizeof(cotree_real));
        ++results.n_events;
    }
    if (events != NULL) results.events = events;
    job.n_records = 0;
}

#endif
/* Print the reason why the job failed. */
static void report(void)
{
#if COTREE_MAIN_TURNS
    if (job.status == COTREE_RUN_TURNED) {
        const int state = job.turned % N_STATES, parameter = job.turned / N_STATES - 1;
        fprintf(stderr,
                "%s: the sensitivity of '%s' to '%s' does not exist from t = %.10g on: "
                "time events coincide there that depend on it differently.\n",
                TITLE, MODEL->states[state].name, MODEL->sensitivities[parameter], job.t);
        return;
    }
#endif
#if COTREE_MAIN_EVENTS
    if (job.status >= COTREE_EVENTS_FAILED) {
        fprintf(stderr, "%s: event '%s' stops the integration at t = %.6g: %s", TITLE,
                MODEL->hybrid->events[job.event].name, job.event_time,
                cotree_events_message(job.status));
        if (job.status == COTREE_EVENTS_ACCUMULATE) {
            fprintf(stderr, " at t = %.10g", job.event_detail);
        }
        fprintf(stderr, ".\n");
        return;
    }
#endif
    fprintf(stderr, "%s: the integration stops at t = %.6g: %s.\n", TITLE, job.t,
            cotree_status_message((cotree_status)job.status));
}

/* Run the job to its end. Only its memory and a list of its breakpoints are allocated; without a
 * heap, arrays of these sizes can replace them. */
static int integrate(cotree_real t_end)
{
#if COTREE_MAIN_TIME_EVENTS
    static cotree_real tolerances[LENGTH(N_SENSITIVITIES)];
    const int n_breakpoints = cotree_most_breakpoints(&time_events, COTREE_F(0.0), t_end);
    const size_t width = 1 + 2 * N_SENSITIVITIES; /* a time and its derivatives */
    cotree_real *breakpoints = NULL;
#else
    const cotree_real breakpoints[2] = {COTREE_F(0.0), t_end};
#endif
    int result = COTREE_JOB_MORE;
#if COTREE_MAIN_TIME_EVENTS
    if (n_breakpoints < 0) {
        fprintf(stderr,
                "%s: there are too many time events to list: the shortest period is %.6g s. Check "
                "its unit, or choose an earlier end time.\n",
                TITLE, cotree_shortest_period(&time_events));
        return EXIT_FAILURE;
    }
    breakpoints = (cotree_real *)calloc((size_t)n_breakpoints, width * sizeof(cotree_real));
    if (breakpoints == NULL) return fail("out of memory");
    cotree_job_set_breakpoints(&job, &time_events, COTREE_F(0.0), t_end, COTREE_F(0.0), SIZES, SEEDS,
                               breakpoints, tolerances);
#else
    job.n_breakpoints = 2;
    job.breakpoints = breakpoints;
#endif
    if (job.n_wanted == 0) job.wanted = breakpoints; /* not read, but must not be NULL */
    job.memory = calloc(1, cotree_job_memory(&job));
    if (job.memory == NULL) return fail("out of memory");
    while (result == COTREE_JOB_MORE) {
        const int segment = job.segment;
        result = cotree_job_run(&job, MOST_STEPS);
#if COTREE_MAIN_EVENTS
        if (result == COTREE_JOB_MORE && job.segment == segment && job.n_records == 0) {
#else
        if (result == COTREE_JOB_MORE && job.segment == segment) {
#endif
            job.status = COTREE_TOO_MANY_STEPS;
            result = COTREE_JOB_FAILED;
        }
#if COTREE_MAIN_EVENTS && COTREE_MAIN_PAGE
        keep_events();
#endif
#if COTREE_MAIN_EVENTS && !COTREE_MAIN_PAGE
        print_events();
#endif
    }
    free(job.memory);
#if COTREE_MAIN_TIME_EVENTS
    free(breakpoints);
#endif
    if (result == COTREE_JOB_FAILED) report();
    return result == COTREE_JOB_FAILED;
}

/* Allocate evenly spaced times up to the end, at which the job stores points. */
static int want_points(long n, cotree_real t_end)
{
    const size_t row = N_UNKNOWNS, rows = (size_t)n;
    cotree_real *const numbers = (cotree_real *)calloc(rows, (2 + row) * sizeof(cotree_real));
    long i;
    if (numbers == NULL) return fail("out of memory");
    for (i = 0; i < n; ++i) {
        numbers[i] = i == n - 1 ? t_end : t_end * ((cotree_real)i / (cotree_real)(n - 1));
    }
    job.wanted = numbers;
    job.times = numbers + rows;
    job.values = numbers + 2 * rows;
    job.n_wanted = (int)n;
    return 0;
}

/* Set the model, the method and the tolerances of the job. */
static void set_job(void)
{
    static cotree_real atols[LENGTH(N_UNKNOWNS)];
#if COTREE_MAIN_EVENTS
    static cotree_real records[COTREE_EVENTS_AT_ONCE(N_EVENTS) * RECORD];
#endif
    job.model = MODEL;
    job.p = problem.p;
    job.k = problem.k;
    job.u = problem.u;
    job.has_sensitivities = N_SENSITIVITIES > 0;
#if COTREE_MAIN_CONSTRAINTS
    job.is_held = 1;
    job.is_strict = IS_STRICT;
#if COTREE_MAIN_TABLES
    job.constraints = start_tables.assembly;
#endif
#endif
#if COTREE_HAS_ALGEBRAIC
    job.is_extended = IS_EXTENDED && !IS_IMPLICIT;
#endif
    job.stepper = STEPPER;
#if COTREE_HAS_IMPLICIT
    if (IS_IMPLICIT) job.aid = NEWTON;
#endif
    job.rtol = request.rtol;
    job.atol = request.atol;
    cotree_job_set_tolerances(&job, IS_IMPLICIT, SIZES, SEEDS, atols);
    job.max_step = MAX_STEP;
    job.z = problem.z;
#if COTREE_MAIN_EVENTS
    job.records = records;
    job.most_records = COTREE_EVENTS_AT_ONCE(N_EVENTS);
#endif
}
