/* Read a finite number that occupies the whole text. */
static int read_number(const char *text, cotree_real *value)
{
    char *end;
    *value = COTREE_STRTOD(text, &end);
    return end != text && *end == '\0' && COTREE_FABS(*value) <= COTREE_MAX;
}

/* Read a number that is at least `least` and below `end`. */
static int read_within(const char *text, cotree_real *value, cotree_real least, cotree_real end,
                       const char *why)
{
    const int is_read = read_number(text, value) && *value >= least && *value < end;
    return is_read ? 0 : refuse(text, why);
}

#if COTREE_MAIN_PARAMETERS
/* Set a parameter: NAME=VALUE. */
static int set_parameter(const char *text)
{
    const char *const equals = strchr(text, '=');
    size_t length;
    cotree_real value;
    int i;
    if (equals == NULL) return refuse(text, "write --set NAME=VALUE");
    if (!read_number(equals + 1, &value)) return refuse(text, "the value is not a finite number");
    length = (size_t)(equals - text);
    for (i = 0; i < N_PARAMETERS; ++i) {
        const char *const name = MODEL->parameters[i].name;
        if (strlen(name) == length && strncmp(name, text, length) == 0) break;
    }
    if (i == N_PARAMETERS) return refuse(text, "there is no such parameter; --help lists them");
#if COTREE_MAIN_HELD
    if (is_held[i] && value != problem.p[i]) {
        return refuse(text, "a time or the start of this model is computed for the value in the "
                            "scene, so change it there and generate the project again");
    }
#endif
    problem.p[i] = value;
    return 0;
}

#endif
#if COTREE_MAIN_METHODS
static int choose_method(const char *name)
{
    size_t i;
    for (i = 0; i < sizeof methods / sizeof methods[0]; ++i) {
        method = methods + i;
        if (strcmp(method->name, name) == 0) return 0;
    }
    return refuse(name, "this method is not compiled in; choose one of " METHODS);
}

#endif
static int print_help(void)
{
#if COTREE_MAIN_PARAMETERS
    int i;
#endif
    printf("%s: integrates the model and prints its final state, or a table over time.\n\n"
           "usage: " PROGRAM " [options] [end time [points]]\n\n"
#if COTREE_MAIN_PARAMETERS
           "  --set NAME=VALUE  value of a parameter\n"
#endif
           "  --t-end T         end time (%g)\n"
           "  --points N        number of evenly spaced times to print\n"
           "  --csv FILE        file for the table, as comma-separated values (%d points)\n",
           TITLE, request.t_end, N_POINTS);
#if COTREE_MAIN_METHODS
    printf("  --method NAME     " METHODS "\n");
#endif
#if COTREE_MAIN_FIXED
    printf("  --step H          step size (%g)\n", request.step);
#endif
#if COTREE_MAIN_RTOL
    printf("  --rtol R          relative tolerance (%g)\n", request.rtol);
#endif
    printf("  --atol A          absolute tolerance (%g)\n", request.atol);
#if COTREE_MAIN_PARAMETERS
    printf("\nparameters:\n");
    for (i = 0; i < N_PARAMETERS; ++i) {
        printf("  %s = %.12g %s\n", MODEL->parameters[i].name, MODEL->parameter_values[i],
               MODEL->parameters[i].unit);
    }
#endif
    return fflush(stdout) == 0 ? EXIT_SUCCESS : EXIT_FAILURE;
}

static int read_end(const char *text)
{
    return read_within(text, &request.t_end, -COTREE_MAX, COTREE_INFINITY,
                       "the end time is not a finite number");
}

static int read_points(const char *text)
{
    char *end;
    request.n_points = strtol(text, &end, 10);
    if (end == text || *end != '\0' || request.n_points < 2 || request.n_points > 100000000) {
        return refuse(text, "the number of points must be an integer of at least 2");
    }
    return 0;
}

/* Read an option that has a value. */
static int read_option(const char *option, const char *value)
{
    if (strcmp(option, "--t-end") == 0) return read_end(value);
    if (strcmp(option, "--points") == 0) return read_points(value);
#if COTREE_MAIN_PARAMETERS
    if (strcmp(option, "--set") == 0) return set_parameter(value);
#endif
#if COTREE_MAIN_METHODS
    if (strcmp(option, "--method") == 0) return choose_method(value);
#endif
    if (strcmp(option, "--csv") == 0) {
        request.csv = value;
        return 0;
    }
#if COTREE_MAIN_FIXED
    if (strcmp(option, "--step") == 0) {
        return read_within(value, &request.step, COTREE_MIN, COTREE_INFINITY,
                           "the step size must be positive");
    }
#endif
#if COTREE_MAIN_RTOL
    if (strcmp(option, "--rtol") == 0) {
        return read_within(value, &request.rtol, COTREE_MIN, COTREE_F(1.0),
                           "the relative tolerance must be between 0 and 1");
    }
#endif
    if (strcmp(option, "--atol") == 0) {
        return read_within(value, &request.atol, COTREE_F(0.0), COTREE_INFINITY,
                           "the absolute tolerance must not be negative");
    }
    return refuse(option, "there is no such option; --help lists them");
}

/* Read the parameters and the request. Return -1 to continue, otherwise the exit code. */
static int read_arguments(int argc, char **argv)
{
    int i, n_plain = 0, status = 0;
#if COTREE_MAIN_PARAMETERS
    memcpy(problem.p, MODEL->parameter_values, sizeof problem.p);
#endif
    for (i = 1; i < argc && status == 0; ++i) {
        if (strcmp(argv[i], "--help") == 0) return print_help();
        if (strncmp(argv[i], "--", 2) == 0) {
            if (i + 1 == argc) return refuse(argv[i], "its value is missing");
            status = read_option(argv[i], argv[i + 1]);
            ++i;
        } else if (n_plain < 2) {
            status = n_plain == 0 ? read_end(argv[i]) : read_points(argv[i]);
            ++n_plain;
        } else {
            return refuse(argv[i], "only the end time and the number of points have no option");
        }
    }
    if (status != 0) return status;
    if (request.csv != NULL && request.n_points == 0) request.n_points = N_POINTS;
    return -1;
}
