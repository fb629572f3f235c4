/* Choose the size of the first step from the rates of the solution and from their change over an
 * Euler step. Hairer, Norsett, Wanner, section II.4. */
static cotree_status first_step(integrator *d, const REAL *y, const REAL *rate, REAL *there,
                                REAL *found)
{
    const REAL size = norm(d, y, y), t = ON(d)->t;
    REAL slope = norm(d, rate, y), step, better;
    cotree_status status;
    int i;
    step = cotree_choose((size < COTREE_F(1e-5)) | (slope < COTREE_F(1e-5)), ALL(COTREE_F(1e-6)),
                         COTREE_F(0.01) * (size / slope));
    step = cotree_smaller(step, cotree_abs(d->goal - t));
    for (i = 0; i < N; ++i) d->trial[i] = y[i] + d->ahead * step * rate[i];
    status = begin_at(d, t + d->ahead * step, d->trial, there);
    if (status == COTREE_RATE_STOPPED) return status;
    if (status == COTREE_OK) {
        for (i = 0; i < N; ++i) d->trial[i] = there[i] - rate[i];
        slope = cotree_larger(slope, norm(d, d->trial, y) / step); /* second derivative */
        better = cotree_choose(slope <= COTREE_F(1e-15),
                               cotree_larger(ALL(COTREE_F(1e-6)), COTREE_F(1e-3) * step),
                               cotree_exp(EXPONENT * cotree_log(COTREE_F(0.01) / slope)));
        step = cotree_smaller(COTREE_F(100.0) * step, better);
    }
    /* Smaller steps are below the resolution of t. */
    *found = cotree_larger(step, COTREE_F(2.0) * smallest_step(t));
    return COTREE_OK;
}
