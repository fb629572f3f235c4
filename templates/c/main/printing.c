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
