/* cotree_history.h: interpolation within steps, from the solution and its rate at the ends of
 * several steps.
 *
 * The polynomial through m points with rates has degree 2 m - 1. It needs no further evaluations.
 * In the middle of six points of an integrator of order 8 it is as accurate as these points.
 *
 *     static cotree_real memory[COTREE_HISTORY_WORKSPACE(2)];
 *     cotree_history h;
 *     cotree_history_init(&h, 2, memory);
 *     ... after each step: cotree_history_add(&h, t, y, rate);
 *     ... then: cotree_history_read(&h, at, y);
 *
 * The solution must be smooth between the points: restart after each jump of a rate. */
#ifndef COTREE_HISTORY_H
#define COTREE_HISTORY_H

#include "cotree_integrator.h"

COTREE_BEGIN_DECLS

/* Number of cotree_reals in the workspace for n unknowns. */
#define COTREE_HISTORY_WORKSPACE(n) (2 * COTREE_HISTORY_POINTS * (n))

typedef struct cotree_history {
    int n;
    int n_points;
    int uses_rates; /* 1 (the default): values and rates; 0: values only, degree m - 1 */
    cotree_real t[COTREE_HISTORY_POINTS];
    cotree_real *y[COTREE_HISTORY_POINTS];
    cotree_real *rate[COTREE_HISTORY_POINTS];
    cotree_real inverse[COTREE_HISTORY_POINTS]
                       [COTREE_HISTORY_POINTS]; /* see cotree_interpolation.h */
    cotree_real weights[COTREE_HISTORY_POINTS], bends[COTREE_HISTORY_POINTS];
} cotree_history;

/* Initialise without points. The workspace must outlive the history. */
void cotree_history_init(cotree_history *h, int n, cotree_real *workspace);

/* Add a point after all others in the direction of integration. If there are more than
 * COTREE_HISTORY_POINTS, remove the oldest one. */
void cotree_history_add(cotree_history *h, cotree_real t, const cotree_real *y,
                        const cotree_real *rate);

/* Evaluate the polynomial at a time. There must be at least one point. */
void cotree_history_read(const cotree_history *h, cotree_real t, cotree_real *y);

/* Compute the factors of the values and rates of all points in the polynomial at a time. The factor
 * of the last value is one minus those of the others. */
void cotree_history_portions(const cotree_history *h, cotree_real t, cotree_real *of_y,
                             cotree_real *of_rate);

/* Estimate the interpolation error in the middle between a point and the next one by the difference
 * from the polynomial without the farthest point, an upper bound. Return its weighted root mean
 * square, in tolerances. n_left_out unknowns, from first_left_out on, are excluded. There must be
 * at least two points; scratch holds n values. */
cotree_real cotree_history_error(const cotree_history *h, int interval, cotree_real rtol,
                                 const cotree_real *atols, int first_left_out, int n_left_out,
                                 cotree_real *scratch);

COTREE_END_DECLS

#endif
