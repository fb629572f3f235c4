static int print_rows(void)
{
    int i;
    print_head();
    for (i = 0; i < job.n_kept; ++i) {
        const cotree_real *const z = job.values + (size_t)i * N_UNKNOWNS;
        if (print_row(job.times[i], z) != 0) return EXIT_FAILURE;
    }
    return fflush(out) == 0 ? 0 : fail("the results cannot be written");
}

int main(int argc, char **argv)
{
    int has_failed = 0;
    const int refused = read_arguments(argc, argv);
    const cotree_real t_end = request.t_end;
    const long n_points = request.n_points;
    if (refused >= 0) return refused;
    if (n_points > 0 && t_end == COTREE_F(0.0)) {
        return refuse("--points", "points need an end time other than 0");
    }
#if COTREE_MAIN_EVENTS
    if (t_end < COTREE_F(0.0)) return refuse("--t-end", "events are located in forward time only");
#endif
    if (begin() != 0) return EXIT_FAILURE;
    out = request.csv == NULL ? stdout : fopen(request.csv, "w");
    if (out == NULL) return refuse(request.csv, "the file cannot be written");
    set_job();
    if (n_points > 0 && want_points(n_points, t_end) != 0) return EXIT_FAILURE;
    if (t_end != COTREE_F(0.0)) has_failed = integrate(t_end);
#if COTREE_MAIN_EXPLICIT
    if (job.n_stiff_steps > COTREE_MOST_STIFF_STEPS) {
        fprintf(stderr,
                "%s: the problem is stiff from t = %.6g on: rodas5 may take far fewer "
                "steps.\n",
                TITLE, job.stiff_since);
    }
#endif
    /* After a failure, the rows up to the last point are printed. */
    if (n_points > 0 && print_rows() != 0) return EXIT_FAILURE;
    if (has_failed) return EXIT_FAILURE;
    if (n_points > 0) return EXIT_SUCCESS;
#if COTREE_MAIN_EVENTS
    fprintf(out, "t = %#.12g\n", job.t);
#endif
    return print_state(job.t, problem.z) == 0 ? EXIT_SUCCESS : EXIT_FAILURE;
}
