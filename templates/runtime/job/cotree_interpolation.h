/* cotree_interpolation.h: factors of Hermite interpolation through the points of several steps.
 *
 * Points are in the order of their times. With the Lagrange basis function l of point i, the
 * polynomial through values and rates has the factor l^2 (1 - 2 (t - t[i]) slope) for the value and
 * l^2 (t - t[i]) for the rate. The polynomial through values only has the factor l.
 *
 * The including file defines a structure cotree_points of n points, with arrays
 *
 *     t        times
 *     inverse  one over t[i] - t[j], for j < i
 *     weights  one over the product of the distances to the others
 *     bends    minus twice the slopes of the basis functions, each at its point */
#ifndef COTREE_INTERPOLATION_H
#define COTREE_INTERPOLATION_H

#include "cotree_limits.h"
#ifndef HOLDS /* defined if the including file computes with vectors */
#include "cotree_numbers.h"
#endif

/* Factors by which an interpolated value depends on the values and rates of all points. */
typedef struct cotree_portions {
    REAL of_y[COTREE_HISTORY_POINTS], of_rate[COTREE_HISTORY_POINTS];
} cotree_portions;

/* Remove the first point in the lanes that the mask selects. */
static inline void cotree_points_shift(cotree_points *p, MASK which)
{
    int i, j;
    for (i = 0; i < COTREE_HISTORY_POINTS - 1; ++i) {
        p->t[i] = cotree_choose(which, p->t[i + 1], p->t[i]);
        for (j = 0; j < i; ++j) {
            p->inverse[i][j] = cotree_choose(which, p->inverse[i + 1][j + 1], p->inverse[i][j]);
        }
    }
}

/* Set the time of the last point in the lanes that the mask selects. */
static inline void cotree_points_set(cotree_points *p, MASK which, int last, REAL t)
{
    int j;
    p->t[last] = cotree_choose(which, t, p->t[last]);
    for (j = 0; j < last; ++j) {
        const REAL inverse = cotree_inverse(p->t[last] - p->t[j]);
        p->inverse[last][j] = cotree_choose(which, inverse, p->inverse[last][j]);
    }
}

/* Compute the weight of one of the first n points and, if rates are used, the slope of its basis
 * function. */
static inline void cotree_points_weigh(cotree_points *p, int n, int uses_rates, int i)
{
    REAL slope = ZERO, weight = ALL(COTREE_F(1.0));
    int j;
    for (j = 0; j < i; ++j) weight *= p->inverse[i][j];
    for (j = i + 1; j < n; ++j) weight *= -p->inverse[j][i];
    p->weights[i] = weight;
    if (!uses_rates) return;
    for (j = 0; j < i; ++j) slope += p->inverse[i][j];
    for (j = i + 1; j < n; ++j) slope -= p->inverse[j][i];
    p->bends[i] = COTREE_F(-2.0) * slope;
}

/* Compute the factors of the points for the solution at a time. */
static inline void cotree_find_portions(const cotree_points *p, int n, int uses_rates, REAL t,
                                        cotree_portions *found)
{
    REAL product = ALL(COTREE_F(1.0));
    int i;
    for (i = 0; i < n; ++i) {
        found->of_y[i] = p->weights[i] * product;
        product *= t - p->t[i];
    }
    product = ALL(COTREE_F(1.0));
    for (i = n - 1; i >= 0; --i) {
        const REAL own = found->of_y[i] * product, square = own * own, distance = t - p->t[i];
        product *= distance;
        found->of_y[i] = own;
        if (!uses_rates) continue;
        found->of_y[i] = square * cotree_fused(p->bends[i], distance, ALL(COTREE_F(1.0)));
        found->of_rate[i] = square * distance;
    }
}

/* Compute the factors of the points in the difference between the polynomial through all points and
 * the one without the farthest point. It is a divided difference of the highest order, or of the
 * two highest orders with rates, written in partial fractions: the product of the distances to the
 * remaining points (of their squares with rates) times the sum over i of weight[i] y[i], or of
 * weight[i]^2 ((1 - 2 e slope[i]) y[i] + e rate[i]) with e = (t[i] - t[far]) + (t - t[far]). */
static inline void cotree_find_differences(const cotree_points *p, int n, int uses_rates, REAL t,
                                           cotree_portions *found)
{
    const REAL to_first = t - p->t[0], to_last = t - p->t[n - 1];
    const MASK is_first = cotree_abs(to_first) > cotree_abs(to_last);
    const REAL far = cotree_choose(is_first, p->t[0], p->t[n - 1]);
    REAL product = cotree_choose(is_first, to_last, to_first);
    int i;
    for (i = 1; i < n - 1; ++i) product *= t - p->t[i];
    for (i = 0; i < n; ++i) {
        const REAL own = p->weights[i] * product, square = own * own;
        const REAL shift = (p->t[i] - far) + (t - far);
        found->of_y[i] = own;
        if (!uses_rates) continue;
        found->of_y[i] = square * cotree_fused(p->bends[i], shift, ALL(COTREE_F(1.0)));
        found->of_rate[i] = square * shift;
    }
}

#endif
