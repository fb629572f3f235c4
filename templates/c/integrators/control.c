static REAL smallest_step(REAL t) { return LEAST_SPACINGS * cotree_abs(t) + COTREE_MIN; }

/* Return the tolerance of a value. It is at least COTREE_MIN, which avoids a division by zero if
 * atol and y are zero. */
static inline REAL tolerance(const integrator *d, int i, REAL size)
{
    return cotree_fused(ALL(d->rtol), size, ATOL(d, i)) + COTREE_MIN;
}

/* Return the weighted root mean square norm of v, with the tolerances at y. */
static REAL norm(const integrator *d, const REAL *v, const REAL *y)
{
    REAL sum = ZERO;
    int i;
    for (i = 0; i < N; ++i) {
        const REAL share = cotree_over(v[i], tolerance(d, i, cotree_abs(y[i])));
        sum = cotree_fused(share, share, sum);
    }
    return cotree_sqrt(sum / COUNT);
}

/* Step size control (E. Hairer, S. P. Norsett, G. Wanner, Solving Ordinary Differential Equations
 * I, second edition, section II.4). Errors are mean squares. */

/* Initialise the step size control with the size of the first step. */
static void begin_control(course *on, int lane, cotree_real step)
{
    (void)lane;
    LANE(on->step, lane) = step;
    LANE(on->largest_factor, lane) = LARGEST_FACTOR;
#if COTREE_IMPLICIT
    LANE(on->is_first, lane) = HOLDS;
#else
    LANE(on->last_error, lane) = LEAST_LAST_ERROR;
#endif
#if COTREE_TWO_ERRORS
    LANE(on->last_rough, lane) = COTREE_INFINITY;
    LANE(on->last_size, lane) = COTREE_F(1.0);
    LANE(on->is_confirmed, lane) = 0;
#endif
}

/* Set the end of the next step. */
static void plan(integrator *d)
{
    course *const on = ON(d);
    const REAL distance = d->goal - on->t;
    on->step = cotree_smaller(on->step, ALL(d->max_step));
    d->lands = STRETCH * on->step >= cotree_abs(distance);
    d->t_new = cotree_choose(d->lands, d->goal, on->t + d->ahead * on->step);
    d->h = d->t_new - on->t; /* differs from step by rounding errors late in a run */
}

/* Return whether the error of the trial step is within the tolerance and not small by
 * coincidence. */
static MASK is_passed(integrator *d)
{
    const MASK is_small = d->error <= COTREE_F(1.0);
#if COTREE_TWO_ERRORS
    /* The error may be small by coincidence if the second estimate exceeds the tolerance and its
     * prediction from the last step. A step of different size must then confirm it. */
    const course *const on = ON(d);
    const REAL ratio = d->h / on->last_size, square = ratio * ratio, fourth = square * square;
    const REAL expected = SUDDEN * SUDDEN * on->last_rough * (fourth * fourth);
    const MASK is_sudden = d->rough > cotree_larger(ALL(COTREE_F(1.0)), expected);
    d->is_doubted = is_small & NOT(on->is_confirmed) & is_sudden;
#endif
#if COTREE_IMPLICIT || COTREE_TWO_ERRORS
    return is_small & NOT(d->is_doubted);
#else
    return is_small;
#endif
}

/* Choose the next step size from the error of the trial step. */
static void choose_step(integrator *d, MASK accepted)
{
    course *const on = ON(d);
    /* The lower bound of the error avoids a division by zero. */
    const REAL error = cotree_log(cotree_larger(ALL(COTREE_F(1e-20)), d->error));
#if COTREE_IMPLICIT
    const REAL share = cotree_exp(-COTREE_F(0.5) * EXPONENT * error);
#else
    const MASK is_small = d->error <= COTREE_F(1.0);
    const REAL slope =
        cotree_choose(is_small, ALL(COTREE_F(0.5) * (COTREE_F(0.75) * MEMORY - EXPONENT)),
                      ALL(-COTREE_F(0.5) * EXPONENT));
    const REAL memory = cotree_choose(is_small, COTREE_F(0.5) * MEMORY * on->last_error, ZERO);
    const REAL share = cotree_exp(slope * error + memory);
#endif
    REAL factor = cotree_larger(SAFETY * share, ALL(LEAST_FACTOR)), next;
    factor = cotree_smaller(factor, on->largest_factor);
#if COTREE_IMPLICIT
    factor = cotree_choose(d->is_doubted, ALL(LEAST_FACTOR), factor);
#endif
#if COTREE_TWO_ERRORS
    factor = cotree_choose(d->is_doubted, ALL(COTREE_F(0.5)), factor);
#endif
    next = cotree_abs(d->h) * factor;
    /* A step that was shortened to end at the goal does not limit the next step. */
    on->step = cotree_choose(accepted & d->lands, cotree_larger(on->step, next), next);
    on->largest_factor = cotree_choose(accepted, ALL(LARGEST_FACTOR), ALL(COTREE_F(1.0)));
#if COTREE_IMPLICIT
    on->is_first &= NOT(accepted);
#else
    on->last_error =
        cotree_choose(accepted, cotree_larger(error, ALL(LEAST_LAST_ERROR)), on->last_error);
#endif
#if COTREE_TWO_ERRORS
    on->last_rough = cotree_choose(accepted, d->rough, on->last_rough);
    on->last_size = cotree_choose(accepted, d->h, on->last_size);
    on->is_confirmed = NOT(accepted) & (on->is_confirmed | d->is_doubted);
#endif
}
