/* cotree_classical.h: the classical Runge-Kutta method of order four. */
#ifndef COTREE_CLASSICAL_H
#define COTREE_CLASSICAL_H

#include "cotree_integrator.h"

/* Take a step from `before` to `after`. trial and slope are work space; the four arrays must not
 * overlap. */
static inline int cotree_take_classical_step(cotree_rate_function rate, void *context, int n,
                                             cotree_real t, cotree_real t_next, cotree_real h,
                                             const cotree_real *before, cotree_real *after,
                                             cotree_real *trial, cotree_real *slope)
{
    /* Fraction of the step at the next stage, and weight of each stage. */
    static const cotree_real share[4] = {COTREE_F(0.5), COTREE_F(0.5), COTREE_F(1.0),
                                         COTREE_F(0.0)},
                             weight[4] = {COTREE_F(1.0), COTREE_F(2.0), COTREE_F(2.0),
                                          COTREE_F(1.0)};
    const cotree_real middle = COTREE_F(0.5) * (t + t_next);
    const cotree_real at[4] = {t, middle, middle, t_next};
    int i, stage;
    for (i = 0; i < n; ++i) {
        trial[i] = before[i];
        after[i] = COTREE_F(0.0);
    }
    for (stage = 0; stage < 4; ++stage) {
        const int status = rate(at[stage], trial, slope, context);
        if (status != 0) return status;
        for (i = 0; i < n; ++i) {
            after[i] += weight[stage] * slope[i];
            trial[i] = before[i] + share[stage] * h * slope[i];
        }
    }
    for (i = 0; i < n; ++i) after[i] = before[i] + h / COTREE_F(6.0) * after[i];
    return 0;
}

#endif
