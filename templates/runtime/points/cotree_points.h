/* cotree_points.h: arguments of a kernel that evaluates many points in SIMD lanes. */
#ifndef COTREE_POINTS_H
#define COTREE_POINTS_H

#include "cotree_abi.h"

/* Arrays of points have one row of n_points numbers for each value. */
typedef struct cotree_points {
    int n_points;
    int has_own; /* 1: p has one row for each parameter; 0: all points share p and k */
    cotree_prepare_kernel prepare;
    const int *s_rows, *rows; /* rows of s that the kernel reads, and rows of its results */
    const double *t, *x, *s, *p, *k;
    const double *u; /* NULL: the inputs of the scene */
    double *results;
} cotree_points;

#endif
