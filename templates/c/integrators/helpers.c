/* Return whether tolerances are valid. A relative tolerance of one would accept any error. */
static int are_tolerances(cotree_real rtol, cotree_real atol)
{
    return rtol >= COTREE_F(0.0) && rtol < COTREE_F(1.0) && atol >= COTREE_F(0.0) &&
           is_finite(atol);
}

static cotree_status evaluate(integrator *d, cotree_real t, const cotree_real *y, cotree_real *dy)
{
    const int result = d->rate(t, y, dy, d->context);
    ++d->n_evaluations;
    return status_of(result);
}

/* Evaluate the rates at the start of a step. Return an error if they are not finite. */
static cotree_status begin_at(integrator *d, cotree_real t, const cotree_real *y, cotree_real *dy)
{
    const cotree_status status = evaluate(d, t, y, dy);
    if (status == COTREE_OK && !are_finite(N, dy)) return COTREE_RATE_NOT_FINITE;
    return status;
}

#if COTREE_HAS_CONSTRAINTS || COTREE_HAS_ALGEBRAIC
/* Project the solution at t in place; on failure it is unchanged. */
static cotree_status project(integrator *d, cotree_real t)
{
    int i;
    if (d->project == NULL) return COTREE_OK;
    for (i = 0; i < N; ++i) d->trial[i] = d->now[i];
    if (d->project(t, d->trial, d->context) != 0) return COTREE_PROJECTION_FAILED;
    if (!are_finite(N, d->trial)) return COTREE_PROJECTION_FAILED;
    for (i = 0; i < N; ++i) d->now[i] = d->trial[i];
    return COTREE_OK;
}

#if COTREE_IMPLICIT
#define ROUNDS 3 /* failures after which a move is a rounding error: the step is 1/64 as long */

/* Return whether a projection moved the algebraic unknowns so far that the error estimate is
 * unreliable. shares: the moves in units of the tolerance; they are reset to zero. A move that does
 * not decrease in ROUNDS shorter steps is a rounding error. */
static int is_off_equations(integrator *d, cotree_real *shares)
{
    const int *const places = d->equation.algebraic, n = d->equation.n_algebraic;
    cotree_real sum = COTREE_F(0.0);
    int i;
    for (i = 0; i < n; ++i) {
        sum += shares[places[i]] * shares[places[i]];
        shares[places[i]] = COTREE_F(0.0);
    }
    if (!(sum > (cotree_real)N) || d->equation.is_bent == NULL) return 0;
    if (!d->equation.is_bent(d->context)) return 0;
    if (++d->n_astray == 1) d->first_correction = sum;
    return d->n_astray <= ROUNDS || sum < COTREE_F(0.25) * d->first_correction;
}

#endif
/* Project the end of a step. Fail if the projection moves it by more than the limit. */
static cotree_status project_end(integrator *d, cotree_real t)
{
    cotree_status status;
    cotree_real sum = COTREE_F(0.0);
    int i;
#if COTREE_IMPLICIT
    if (d->project == NULL) return project(d, t);
#else
    if (d->project == NULL || d->farthest == COTREE_INFINITY) return project(d, t);
#endif
    for (i = 0; i < N; ++i) d->raw[i] = d->now[i];
    status = project(d, t);
    if (status != COTREE_OK) return status;
    for (i = 0; i < N; ++i) {
        const cotree_real size = cotree_larger(COTREE_FABS(d->now[i]), COTREE_FABS(d->raw[i]));
        d->trial[i] = (d->now[i] - d->raw[i]) / tolerance(d, i, size);
    }
#if COTREE_IMPLICIT
    if (is_off_equations(d, d->trial)) return COTREE_PROJECTION_FAILED;
#endif
    for (i = 0; i < N; ++i) sum += d->trial[i] * d->trial[i];
    return sum > d->farthest * d->farthest * (cotree_real)N ? COTREE_PROJECTION_FAILED : status;
}
#endif
