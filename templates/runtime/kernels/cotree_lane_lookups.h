/* cotree_lane_lookups.h: table lookups for each lane of a vector.
 *
 * The including file defines LANES, the number of doubles in a vector, and the type VECTOR. */
#ifndef COTREE_LANE_LOOKUPS_H
#define COTREE_LANE_LOOKUPS_H

#define COTREE_LOOKUP(name) cotree_one_##name
#include "cotree_lookups.h"

/* Define the lookup of a vector by the scalar one of each lane. */
#define COTREE_EACH_LANE(name, n_results, parameters, arguments)                                   \
    static inline void cotree_##name parameters                                                    \
    {                                                                                              \
        int lane, i;                                                                               \
        for (lane = 0; lane < LANES; ++lane) {                                                     \
            double one[n_results];                                                                 \
            cotree_one_##name arguments;                                                           \
            for (i = 0; i < (n_results); ++i) result[i][lane] = one[i];                            \
        }                                                                                          \
    }

COTREE_EACH_LANE(table, 2, (int n, const double *x, const double *y, VECTOR at, VECTOR *result),
                 (n, x, y, at[lane], one))
COTREE_EACH_LANE(cubic, 4,
                 (int n, const double *x, const double *y, const double *slopes, VECTOR at,
                  VECTOR *result),
                 (n, x, y, slopes, at[lane], one))
COTREE_EACH_LANE(plane, 4,
                 (int n, int m, const double *x, const double *y, const double *z, VECTOR at,
                  VECTOR beside, VECTOR *result),
                 (n, m, x, y, z, at[lane], beside[lane], one))
COTREE_EACH_LANE(held_table, 5,
                 (int n, const double *x, const double *y, VECTOR at, VECTOR held, VECTOR *result),
                 (n, x, y, at[lane], held[lane], one))
COTREE_EACH_LANE(held_plane, 10,
                 (int n, int m, const double *x, const double *y, const double *z, VECTOR at,
                  VECTOR beside, VECTOR held_x, VECTOR held_y, VECTOR *result),
                 (n, m, x, y, z, at[lane], beside[lane], held_x[lane], held_y[lane], one))

#endif
