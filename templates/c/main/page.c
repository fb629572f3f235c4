/* Interface of a page (templates/html/engine.js), which reads and writes the memory of the program. A
 * program runs once; the page starts it again for each run. */
cotree_real *page_parameters(void)
{
#if COTREE_MAIN_PARAMETERS
    memcpy(problem.p, MODEL->parameter_values, sizeof problem.p);
#endif
    return problem.p;
}

/* Replace the initial value of a state. */
void page_initial(int state, cotree_real value)
{
    initial.set[initial.n_set] = state;
    initial.values[initial.n_set] = value;
    ++initial.n_set;
}

/* Collect the stored points in rows of one width: time, states and their sensitivities, outputs and
 * their sensitivities, inputs. */
static int collect_rows(void)
{
    int i, j;
    results.rows = (cotree_real *)calloc((size_t)LENGTH(job.n_kept), WIDTH * sizeof(cotree_real));
    if (results.rows == NULL) return fail("out of memory");
    for (i = 0; i < job.n_kept; ++i) {
        const cotree_real *const z = job.values + (size_t)i * N_UNKNOWNS;
        cotree_real *row = results.rows + (size_t)i * WIDTH;
        if (find_outputs(job.times[i], z) != 0) return EXIT_FAILURE;
        *row++ = job.times[i];
        for (j = 0; j < N_UNKNOWNS; ++j) *row++ = z[j];
        for (j = 0; j < N_OUTPUTS; ++j) *row++ = y[j];
#if COTREE_HAS_SENSITIVITIES
        for (j = 0; j < N_OUTPUTS * N_SENSITIVITIES; ++j) *row++ = dy[j];
#endif
        for (j = 0; j < N_INPUTS; ++j) *row++ = problem.u[j];
        results.n_rows = i + 1;
    }
    return 0;
}

/* Run up to an end time and collect n points. Return 0 on success; after a failure, whose reason is
 * printed, the rows up to the last point remain. */
int page_run(int index, cotree_real t_end, int n)
{
    int has_failed;
#if COTREE_MAIN_METHODS
    method = methods + index;
#else
    (void)index;
#endif
    results.stiff_since = -1;
    if (begin() != 0) return EXIT_FAILURE;
    set_job();
    if (want_points(n, t_end) != 0) return EXIT_FAILURE;
    has_failed = integrate(t_end);
    results.n_steps = (int)job.n_steps;
#if COTREE_MAIN_EXPLICIT
    results.stiff_since = job.n_stiff_steps > COTREE_MOST_STIFF_STEPS ? job.stiff_since : -1;
#endif
    if (collect_rows() != 0) return EXIT_FAILURE;
    return has_failed;
}

cotree_real *page_rows(void)
{
    return results.rows;
}

int page_n_rows(void)
{
    return results.n_rows;
}

int page_n_steps(void)
{
    return results.n_steps;
}

/* Return the time from which an explicit method is much slower than an implicit one; -1: none. */
cotree_real page_stiff_since(void)
{
    return results.stiff_since;
}

/* Return the records of events: time, event, and the derivatives of the time. */
cotree_real *page_events(void)
{
    return results.events;
}

int page_n_events(void)
{
    return results.n_events;
}
