/* cotree_lane_lookups.h: table lookups for each lane of a vector.
 *
 * The including file defines LANES, the number of doubles in a vector, and the type VECTOR. */
#ifndef COTREE_LANE_LOOKUPS_H
#define COTREE_LANE_LOOKUPS_H

#define COTREE_LOOKUP(name) cotree_one_##name
#include "cotree_lookups.h"

static inline void cotree_table(int n, const double *x, const double *y, VECTOR at, VECTOR *result)
{
    int lane, i;
    for (lane = 0; lane < LANES; ++lane) {
        double one[2];
        cotree_one_table(n, x, y, at[lane], one);
        for (i = 0; i < 2; ++i) result[i][lane] = one[i];
    }
}

static inline void cotree_cubic(int n, const double *x, const double *y, const double *slopes,
                                VECTOR at, VECTOR *result)
{
    int lane, i;
    for (lane = 0; lane < LANES; ++lane) {
        double one[4];
        cotree_one_cubic(n, x, y, slopes, at[lane], one);
        for (i = 0; i < 4; ++i) result[i][lane] = one[i];
    }
}

static inline void cotree_plane(int n, int m, const double *x, const double *y, const double *z,
                                VECTOR at, VECTOR beside, VECTOR *result)
{
    int lane, i;
    for (lane = 0; lane < LANES; ++lane) {
        double one[4];
        cotree_one_plane(n, m, x, y, z, at[lane], beside[lane], one);
        for (i = 0; i < 4; ++i) result[i][lane] = one[i];
    }
}

static inline void cotree_held_table(int n, const double *x, const double *y, VECTOR at,
                                     VECTOR held, VECTOR *result)
{
    int lane, i;
    for (lane = 0; lane < LANES; ++lane) {
        double one[5];
        cotree_one_held_table(n, x, y, at[lane], held[lane], one);
        for (i = 0; i < 5; ++i) result[i][lane] = one[i];
    }
}

static inline void cotree_held_plane(int n, int m, const double *x, const double *y,
                                     const double *z, VECTOR at, VECTOR beside, VECTOR held_x,
                                     VECTOR held_y, VECTOR *result)
{
    int lane, i;
    for (lane = 0; lane < LANES; ++lane) {
        double one[10];
        cotree_one_held_plane(n, m, x, y, z, at[lane], beside[lane], held_x[lane], held_y[lane],
                              one);
        for (i = 0; i < 10; ++i) result[i][lane] = one[i];
    }
}

#endif
