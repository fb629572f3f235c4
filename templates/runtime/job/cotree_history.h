/* cotree_history.h: points between steps, read from the solution and its rate at several of them.
 * Part of the runtime of cotree, the same for every model.
 *
 * Through m points with rates goes one polynomial of degree 2 m - 1. It costs no evaluations, and
 * in the middle of six points of an integrator of order 8 it is as accurate as they are.
 *
 *     static cotree_real memory[COTREE_HISTORY_WORKSPACE(2)];
 *     cotree_history h;
 *     cotree_history_init(&h, 2, memory);
 *     ... after each step: cotree_history_add(&h, t, y, rate);
 *     ... then: cotree_history_read(&h, at, y);
 *
 * The solution must be smooth among the points: begin anew after each jump of a rate.
 */
#ifndef COTREE_HISTORY_H
#define COTREE_HISTORY_H

#include "cotree_integrator.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Number of cotree_reals that n unknowns need. */
#define COTREE_HISTORY_WORKSPACE(n) (2 * COTREE_HISTORY_POINTS * (n))

typedef struct cotree_history {
    int n;
    int n_points;
    int uses_rates; /* 1 unless you say otherwise; without them the degree is m - 1 */
    cotree_real t[COTREE_HISTORY_POINTS];
    cotree_real *y[COTREE_HISTORY_POINTS];
    cotree_real *rate[COTREE_HISTORY_POINTS];
    cotree_real inverse[COTREE_HISTORY_POINTS][COTREE_HISTORY_POINTS]; /* see cotree_interpolation.h */
    cotree_real weights[COTREE_HISTORY_POINTS], bends[COTREE_HISTORY_POINTS];
} cotree_history;

/* Begins without points. The workspace is used as long as the history is. */
void cotree_history_init(cotree_history *h, int n, cotree_real *workspace);

/* Adds a point later than all others in the direction of integration; the oldest one may leave. */
void cotree_history_add(cotree_history *h, cotree_real t, const cotree_real *y,
                        const cotree_real *rate);

/* Writes the polynomial through all points at a time; n_points must not be zero. */
void cotree_history_read(const cotree_history *h, cotree_real t, cotree_real *y);

/* Gives how far the polynomial without the point farthest from the middle between a point and the
 * next is from the one through all points there, more than the error of that: as the root mean
 * square of its shares in the tolerances. n_left_out unknowns from the first one on do not count.
 * There must be two points at least; scratch holds n values. */
cotree_real cotree_history_error(const cotree_history *h, int interval, cotree_real rtol,
                                 const cotree_real *atols, int first_left_out, int n_left_out,
                                 cotree_real *scratch);

#ifdef __cplusplus
}
#endif

#endif
