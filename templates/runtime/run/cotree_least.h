/* cotree_least.h: least-squares solutions of least length, for dense matrices of any rank.
 * Part of the runtime of cotree, the same for every model.
 *
 * A = U R Q with orthonormal rows of Q and columns of U and a triangular R. What rows reach beyond
 * each other by less than a share of COTREE_RANK is rounding, and counts as dependent.
 *
 *     for each row r, a.rows[r * a.n_columns + i] = entries
 *     cotree_least_factorise(&a, n_rows, size)
 *     cotree_least_solve(&a, b, x)
 */
#ifndef COTREE_LEAST_H
#define COTREE_LEAST_H

#include "cotree_run.h"

#ifdef __cplusplus
extern "C" {
#endif

#define COTREE_RANK COTREE_SELECT(1e-10, 4.3e-05f)

typedef struct cotree_least {
    int n_columns;
    int n_rows, rank;     /* of the matrix factorised last */
    int stride;           /* the largest number of rows */
    cotree_real *rows;    /* stride rows of n_columns: the matrix, which is overwritten */
    cotree_real *basis;   /* Q: rank rows of n_columns */
    cotree_real *lower;   /* U: n_rows rows of stride */
    cotree_real *upper;   /* R: rank rows of stride */
    cotree_real *weights; /* stride */
} cotree_least;

void cotree_least_init(cotree_least *a, int most_rows, int n_columns, cotree_room *room);

/* Factorises the first n_rows rows and returns their rank. size: the longest row of a matrix beside
 * which these count, or 0. */
int cotree_least_factorise(cotree_least *a, int n_rows, cotree_real size);

/* Writes the shortest x, n_columns entries, of those that make A x + b as short as it can be. */
void cotree_least_solve(const cotree_least *a, const cotree_real *b, cotree_real *x);

#ifdef __cplusplus
}
#endif

#endif
