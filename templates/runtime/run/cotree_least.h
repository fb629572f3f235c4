/* cotree_least.h: minimum-norm least-squares solutions for dense matrices of any rank.
 *
 * A = U R Q, in which U has orthonormal columns, R is triangular and Q has orthonormal rows. A row
 * is dependent if its remainder is below COTREE_RANK times the longest row.
 *
 *     for each row r, a.rows[r * a.n_columns + i] = entries
 *     cotree_least_factorise(&a, n_rows, size)
 *     cotree_least_solve(&a, b, x) */
#ifndef COTREE_LEAST_H
#define COTREE_LEAST_H

#include "cotree_run.h"

COTREE_BEGIN_DECLS

#define COTREE_RANK COTREE_SELECT(1e-10, 4.3e-05f)

typedef struct cotree_least {
    int n_columns;
    int n_rows, rank;  /* size and rank of the matrix factorised last */
    int stride;        /* length of the rows of U and R, at least the largest number of rows */
    cotree_real *rows; /* the matrix, rows of n_columns numbers; overwritten by the factorisation */
    cotree_real *basis;   /* Q: `rank` orthonormal rows of n_columns numbers */
    cotree_real *lower;   /* U: n_rows rows of stride numbers */
    cotree_real *upper;   /* R: upper triangle, rank rows of stride numbers */
    cotree_real *weights; /* work space of stride numbers */
} cotree_least;

void cotree_least_init(cotree_least *a, int most_rows, int n_columns, cotree_arena *arena);

/* Factorise the first n_rows rows, and return their rank. The rank is relative to the longest row,
 * or to size if that is larger. */
int cotree_least_factorise(cotree_least *a, int n_rows, cotree_real size);

/* Continue a factorisation with the rows from first to end - 1 that are independent of those
 * already factorised: with remainders above least or, for the first one, above COTREE_RANK times
 * its own length. Return the rank. */
int cotree_least_extend(cotree_least *a, int first, int end, cotree_real least);

/* Return the smallest singular value of the rows, or 0 if they are dependent. x: work space of
 * n_rows numbers. */
cotree_real cotree_least_smallest(const cotree_least *a, cotree_real *x);

/* Compute x of n_columns entries, the minimiser of |A x + b| with minimum norm. */
void cotree_least_solve(const cotree_least *a, const cotree_real *b, cotree_real *x);

/* Project b, with entries b[i * stride], onto the orthogonal complement of the range of A. */
void cotree_least_reject(const cotree_least *a, cotree_real *b, int stride);

COTREE_END_DECLS

#endif
