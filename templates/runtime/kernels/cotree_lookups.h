/* cotree_lookups.h: table lookups in one and two dimensions. */
#ifndef COTREE_LOOKUPS_H
#define COTREE_LOOKUPS_H

#include "cotree_real.h"

/* Name of a scalar function. A file in which vector functions have the plain names defines another
 * name. */
#ifndef COTREE_LOOKUP
#define COTREE_LOOKUP(name) cotree_##name
#endif

/* Return the interval of an axis that contains a number. The outermost intervals extend to
 * infinity. */
static inline int cotree_piece(int n, const cotree_real *x, cotree_real at)
{
    int low = 0, high = n - 1;
    while (high - low > 1) {
        const int middle = (low + high) / 2;
        if (at >= x[middle]) {
            low = middle;
        } else {
            high = middle;
        }
    }
    return low;
}

/* Compute value and slope of a piecewise linear function, which is constant outside its range. */
static inline void COTREE_LOOKUP(table)(int n, const cotree_real *x, const cotree_real *y,
                                        cotree_real at, cotree_real *result)
{
    int low;
    if (at <= x[0] || at >= x[n - 1]) {
        result[0] = at >= x[n - 1] ? y[n - 1] : y[0];
        result[1] = COTREE_F(0.0);
        return;
    }
    low = cotree_piece(n, x, at);
    result[1] = (y[low + 1] - y[low]) / (x[low + 1] - x[low]);
    result[0] = y[low] + result[1] * (at - x[low]);
}

/* Compute value and first to third derivative of a piecewise cubic Hermite function. */
static inline void COTREE_LOOKUP(cubic)(int n, const cotree_real *x, const cotree_real *y,
                                        const cotree_real *slopes, cotree_real at,
                                        cotree_real *result)
{
    const int k = cotree_piece(n, x, at);
    const cotree_real h = x[k + 1] - x[k], s = at - x[k], secant = (y[k + 1] - y[k]) / h;
    const cotree_real b = (COTREE_F(3.0) * secant - COTREE_F(2.0) * slopes[k] - slopes[k + 1]) / h;
    const cotree_real c = (slopes[k] + slopes[k + 1] - COTREE_F(2.0) * secant) / (h * h);
    result[0] = y[k] + s * (slopes[k] + s * (b + s * c));
    result[1] = slopes[k] + s * (COTREE_F(2.0) * b + COTREE_F(3.0) * s * c);
    result[2] = COTREE_F(2.0) * b + COTREE_F(6.0) * s * c;
    result[3] = COTREE_F(6.0) * c;
}

/* Compute value and slope of a piecewise linear function, which is constant outside its range; then
 * both ends and the index of the interval, which is frozen if `held` is nonzero. */
static inline void COTREE_LOOKUP(held_table)(int n, const cotree_real *x, const cotree_real *y,
                                             cotree_real at, cotree_real held, cotree_real *result)
{
    int piece = (int)held - 1;
    if (held == COTREE_F(0.0)) {
        piece = at >= x[n - 1] ? n : 0;
        if (!(at <= x[0]) && !(at >= x[n - 1])) piece = cotree_piece(n, x, at) + 1;
    }
    result[2] = piece == 0 ? at - COTREE_F(1.0) : x[piece - 1];
    result[3] = piece == n ? at + COTREE_F(1.0) : x[piece];
    result[4] = (cotree_real)(piece + 1);
    if (piece == 0 || piece == n) {
        result[0] = piece == 0 ? y[0] : y[n - 1];
        result[1] = COTREE_F(0.0);
        return;
    }
    result[1] = (y[piece] - y[piece - 1]) / (x[piece] - x[piece - 1]);
    result[0] = y[piece - 1] + result[1] * (at - x[piece - 1]);
}

/* Find the interval of an axis: the frozen one if `held` is nonzero, otherwise the one that
 * contains a number. Write both its ends and its index. */
static inline int cotree_held_piece(int n, const cotree_real *x, cotree_real at, cotree_real held,
                                    cotree_real *result)
{
    const int k = held == COTREE_F(0.0) ? cotree_piece(n, x, at) : (int)held - 1;
    result[0] = k == 0 ? at - COTREE_F(1.0) : x[k];
    result[1] = k == n - 2 ? at + COTREE_F(1.0) : x[k + 1];
    result[2] = (cotree_real)(k + 1);
    return k;
}

/* Compute a bilinear function on the intervals i and j, and its derivatives with respect
 * to x, y and both. */
static inline void cotree_bilinear(int m, const cotree_real *x, const cotree_real *y,
                                   const cotree_real *z, int i, int j, cotree_real at,
                                   cotree_real beside, cotree_real *result)
{
    const cotree_real width = x[i + 1] - x[i], height = y[j + 1] - y[j], s = at - x[i],
                      u = beside - y[j];
    const cotree_real *low = z + i * m + j, *high = low + m;
    const cotree_real by_x = (high[0] - low[0]) / width, by_y = (low[1] - low[0]) / height;
    const cotree_real twist = ((high[1] - low[1]) / width - by_x) / height;
    result[0] = low[0] + s * by_x + u * (by_y + s * twist);
    result[1] = by_x + u * twist;
    result[2] = by_y + s * twist;
    result[3] = twist;
}

/* Compute a bilinear function, and its derivatives with respect to x, y and both. */
static inline void COTREE_LOOKUP(plane)(int n, int m, const cotree_real *x, const cotree_real *y,
                                        const cotree_real *z, cotree_real at, cotree_real beside,
                                        cotree_real *result)
{
    const int i = cotree_piece(n, x, at), j = cotree_piece(m, y, beside);
    cotree_bilinear(m, x, y, z, i, j, at, beside, result);
}

/* Compute a bilinear function, and its derivatives with respect to x, y and both; then both ends
 * and the index of the interval on each axis, which is frozen if `held` is nonzero. */
static inline void COTREE_LOOKUP(held_plane)(int n, int m, const cotree_real *x,
                                             const cotree_real *y, const cotree_real *z,
                                             cotree_real at, cotree_real beside, cotree_real held_x,
                                             cotree_real held_y, cotree_real *result)
{
    const int i = cotree_held_piece(n, x, at, held_x, result + 4);
    const int j = cotree_held_piece(m, y, beside, held_y, result + 7);
    cotree_bilinear(m, x, y, z, i, j, at, beside, result);
}

#endif
