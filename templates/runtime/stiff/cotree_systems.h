/* cotree_systems.h: linear systems (shift M - J) x = b of a model and of its sensitivities.
 *
 * The including file defines cotree_systems and cotree_solve_blocks. J is stored in compressed
 * columns: starts of the columns, then the row of each value. */
#ifndef COTREE_SYSTEMS_H
#define COTREE_SYSTEMS_H

#include "cotree_limits.h"
#ifndef HOLDS /* otherwise the including file computes with vectors */
#include "cotree_numbers.h"
#endif

/* Solve in place for n_blocks adjacent blocks, each as long as the states. */
static inline void cotree_solve_blocks(const cotree_systems *systems, int n_blocks, REAL *x);

/* Return whether x solves the system up to small relative changes of the entries of its matrix. M
 * is one in the first n_rates of n rows, otherwise zero. residual and size: work space of n
 * numbers. */
static inline MASK cotree_is_solution(int n, int n_rates, const int *starts, const int *rows,
                                      const REAL *values, REAL shift, const REAL *b, const REAL *x,
                                      REAL *residual, REAL *size)
{
    MASK found = NOT((MASK)ZERO);
    int i, j;
    for (i = 0; i < n; ++i) {
        const REAL own = i < n_rates ? shift * x[i] : ZERO;
        residual[i] = own - b[i];
        size[i] = cotree_abs(own) + cotree_abs(b[i]);
    }
    for (j = 0; j < n; ++j) {
        for (i = starts[j]; i < starts[j + 1]; ++i) {
            const REAL part = values[i] * x[j];
            residual[rows[i]] -= part;
            size[rows[i]] += cotree_abs(part);
        }
    }
    for (i = 0; i < n; ++i) {
        found &= cotree_abs(residual[i]) <=
                 cotree_fused(ALL(COTREE_PLANNED_PIVOTS), size[i], ALL(COTREE_MIN));
    }
    return found;
}

/* Solve for the sensitivities to each parameter. starts and rows list those that are not
 * identically zero. whole: work space of n numbers. */
static inline void cotree_solve_sensitivities(const cotree_systems *systems, int n,
                                              int n_parameters, const int *starts, const int *rows,
                                              REAL *s, REAL *whole)
{
    int i, j = 0;
    while (j < n_parameters) {
        const int first = starts[j], n_own = starts[j + 1] - first;
        REAL *const own = s + first;
        int n_whole = 0; /* number of adjacent blocks without zeros, which are solved in one call */
        while (j + n_whole < n_parameters && starts[j + n_whole + 1] - starts[j + n_whole] == n) {
            ++n_whole;
        }
        j += n_whole > 0 ? n_whole : 1;
        if (n_whole > 0) {
            cotree_solve_blocks(systems, n_whole, own);
        } else if (n_own > 0) {
            for (i = 0; i < n; ++i) whole[i] = ZERO;
            for (i = 0; i < n_own; ++i) whole[rows[first + i]] = own[i];
            cotree_solve_blocks(systems, 1, whole);
            for (i = 0; i < n_own; ++i) own[i] = whole[rows[first + i]];
        }
    }
}

#endif
