#if !COTREE_IMPLICIT
/* Monitor the stability limit after an accepted step. */
static void monitor_stiffness(integrator *d)
{
    cotree_stiffness *const s = &d->stiffness;
    const int is_deciding = s->n_stiff > 0 && !s->is_found;
    cotree_real reach;
    if (s->n == 0 || (!is_deciding && ++s->n_calm < CALM_STEPS)) return;
    s->n_calm = 0;
    reach = stability_ratio(d, d->t - d->t_before);
    if (s->is_found) {
        /* At its stability limit, a method oscillates about the limit or stays there. */
        if (reach == COTREE_F(0.0) || reach > COTREE_F(0.5) * STABLE) s->n_steps += CALM_STEPS;
    } else if (reach > STABLE) {
        if (s->n_stiff == 0) s->since = d->t_before;
        s->n_soft = 0;
        s->is_found = ++s->n_stiff == STIFF_STEPS;
    } else if (is_deciding && ++s->n_soft == SOFT_STEPS) {
        s->n_stiff = s->n_soft = 0;
    }
}

void METHOD(watch)(integrator *d, int n)
{
    d->stiffness.n = n;
    d->stiffness.is_found = 0;
    d->stiffness.since = d->t;
    d->stiffness.n_steps = 0;
    d->stiffness.n_stiff = d->stiffness.n_soft = d->stiffness.n_calm = 0;
}

#endif
/* Initialise at (t, y), with the first arrays of the workspace. */
#if COTREE_IMPLICIT
static cotree_status initialise(integrator *d, int n, cotree_rate_function rate, void *context,
                           cotree_real t, const cotree_real *y, cotree_real rtol, cotree_real atol,
                           cotree_real *workspace)
#else
cotree_status METHOD(init)(integrator *d, int n, cotree_rate_function rate, void *context,
                           cotree_real t, const cotree_real *y, cotree_real rtol, cotree_real atol,
                           cotree_real *workspace)
#endif
{
    int i;
    if (n < 0 || !is_finite(t) || !are_tolerances(rtol, atol) || !are_finite(n, y)) {
        return COTREE_BAD_ARGUMENT;
    }
    d->t = d->t_before = t;
    d->max_step = COTREE_MAX;
    d->max_steps = 1000000;
    d->n_steps = d->n_rejected = d->n_evaluations = 0;
#if COTREE_HAS_CONSTRAINTS || COTREE_HAS_ALGEBRAIC
    d->project = NULL;
    d->farthest = COTREE_INFINITY;
#endif
    d->atols = NULL;
    d->n = n;
    d->has_rate = 0;
    d->rate = rate;
    d->context = context;
    d->rtol = COTREE_FMAX(rtol, LEAST_RTOL);
    d->atol = atol;
    d->now = workspace;
    d->before = workspace + n;
    d->trial = workspace + 2 * n;
    d->raw = workspace + 3 * n;
    for (i = 0; i < STAGES; ++i) d->stages[i] = workspace + (4 + i) * n;
    for (i = 0; i < n; ++i) d->now[i] = y[i];
    d->y = d->now;
    begin_control(d, 0, COTREE_F(0.0));
#if !COTREE_IMPLICIT
#if COTREE_HAS_CONSTRAINTS || COTREE_HAS_ALGEBRAIC
    d->rejected = NULL;
#endif
    METHOD(watch)(d, n);
#endif
    return COTREE_OK;
}

#if COTREE_IMPLICIT
cotree_status METHOD(init)(integrator *d, cotree_implicit_equation equation, cotree_real t,
                           const cotree_real *y, cotree_real rtol, cotree_real atol,
                           cotree_real *workspace)
{
    const int n = equation.n, n_algebraic = equation.n_algebraic;
    cotree_status status = COTREE_BAD_ARGUMENT;
    if (n_algebraic >= 0 && n_algebraic <= n) {
        status = initialise(d, n, equation.rate, equation.context, t, y, rtol, atol, workspace);
    }
    if (status != COTREE_OK) return status;
    d->n_jacobians = d->n_factorisations = 0;
    d->equation = equation;
    d->rates = workspace + (4 + STAGES) * n;
    d->time_slope = d->rates + n;
    d->right = d->time_slope + n;
    d->left = d->right + n;
    d->scales = d->left + n;
    return COTREE_OK;
}
#endif

#define FAILURE_FACTOR COTREE_F(0.25) /* step size factor after a failed right-hand side */

/* Set the end time and the direction of integration. */
static void set_goal(integrator *d, cotree_real t_stop)
{
    d->goal = t_stop;
    d->ahead = t_stop < d->t ? -COTREE_F(1.0) : COTREE_F(1.0);
}

/* Compute the first step size, unless the caller has set it. */
cotree_status METHOD(begin)(integrator *d, cotree_real t_stop)
{
#if COTREE_IMPLICIT
    cotree_real *const rate = d->rates, *const there = d->right;
#else
    cotree_real *const rate = d->stages[LAST], *const there = d->stages[0];
#endif
    cotree_status status = COTREE_OK;
#if COTREE_HAS_CONSTRAINTS || COTREE_HAS_ALGEBRAIC
    status = project(d, d->t);
#endif
    if (status == COTREE_OK) status = begin_at(d, d->t, d->now, rate);
    if (status != COTREE_OK) return status;
    d->has_rate = 1;
#if COTREE_IMPLICIT
    d->is_first = 1;
#endif
    if (d->step > COTREE_F(0.0)) return COTREE_OK;
    set_goal(d, t_stop);
    return first_step(d, d->now, rate, there, &d->step);
}

/* Accept the trial step: advance to its end. */
static void accept(integrator *d)
{
#if COTREE_IMPLICIT
    cotree_real *const rates = d->rates;
    d->rates = d->right;
    d->right = rates;
#endif
    d->t = d->t_new;
    ++d->n_steps;
#if !COTREE_IMPLICIT
    monitor_stiffness(d);
#endif
}

#if COTREE_HAS_SENSITIVITIES
/* Return whether the last trial step is accepted in spite of its error, because rounding of the
 * time hardly permits a shorter one. If the argument of a root reaches zero, sensitivities change
 * like the root of the time, so that their error is the root of a rounding error. */
static int is_shortest(const integrator *d)
{
    const cotree_real most = COTREE_FMIN(LARGEST_ERROR, LARGEST_SHARE / d->rtol);
    /* If t is large, even the smallest step may be long compared with the remaining time. */
    const cotree_real longest = COTREE_FMIN(SHORTEST_SIZE * smallest_step(d->t),
                                            SHORTEST_PART * COTREE_FABS(d->goal - d->t));
    return COTREE_FABS(d->h) <= longest && d->error <= most * most;
}
#endif

/* Try steps until one is accepted. */
static cotree_status take_step(integrator *d)
{
    cotree_status trouble = COTREE_STEP_TOO_SMALL;
    d->largest_factor = LARGEST_FACTOR;
#if COTREE_TWO_ERRORS
    d->is_confirmed = 0;
#endif
#if COTREE_IMPLICIT
    d->n_astray = 0;
    trouble = linearise(d);
    if (trouble != COTREE_OK) return trouble;
    trouble = COTREE_STEP_TOO_SMALL;
#endif
    for (plan(d); d->step > smallest_step(d->t); plan(d)) {
        cotree_status status = attempt(d);
        int is_accepted = 0;
        if (status == COTREE_OK) status = check(d);
#if COTREE_HAS_SENSITIVITIES
        if (status == COTREE_OK && (is_passed(d) || is_shortest(d))) {
#else
        if (status == COTREE_OK && is_passed(d)) {
#endif
            status = complete_step(d, d->t_new);
            is_accepted = status == COTREE_OK;
        }
        if (status == COTREE_OK) {
            choose_step(d, is_accepted);
#if COTREE_HAS_SENSITIVITIES
            if (is_accepted && d->error > COTREE_F(1.0)) d->step = COTREE_FABS(d->h);
#endif
            trouble = COTREE_STEP_TOO_SMALL;
        } else {
            d->step = FAILURE_FACTOR * COTREE_FABS(d->h);
            d->largest_factor = COTREE_F(1.0);
            trouble = status;
        }
        if (is_accepted) {
            accept(d);
            return COTREE_OK;
        }
        ++d->n_rejected;
#if !COTREE_IMPLICIT
#if COTREE_HAS_CONSTRAINTS || COTREE_HAS_ALGEBRAIC
        if (d->rejected != NULL) d->rejected(d->context);
#endif
#endif
        if (status == COTREE_RATE_STOPPED) break;
    }
    return trouble;
}

cotree_status METHOD(step)(integrator *d, cotree_real t_stop)
{
    const cotree_real distance = t_stop - d->t;
    cotree_status status = COTREE_OK;
    cotree_real planned;
    if (!is_finite(distance)) return COTREE_BAD_ARGUMENT;
    if (distance == COTREE_F(0.0)) return COTREE_OK;
    if (!d->has_rate || d->step <= COTREE_F(0.0)) status = METHOD(begin)(d, t_stop);
    if (status != COTREE_OK) return status;
    planned = d->step;
    d->t_before = d->t;
    swap_ends(d);
    set_goal(d, t_stop);
    status = take_step(d);
    if (status != COTREE_OK) {
        swap_ends(d);
        d->step = planned; /* discard the step size of the first attempt */
    }
    return status;
}

cotree_status METHOD(integrate)(integrator *d, cotree_real t_end)
{
    const long n_before = d->n_steps + d->n_rejected;
    while (d->t != t_end) {
        cotree_status status;
        if (d->n_steps + d->n_rejected - n_before >= d->max_steps) return COTREE_TOO_MANY_STEPS;
        status = METHOD(step)(d, t_end);
        if (status != COTREE_OK) return status;
    }
    return COTREE_OK;
}
