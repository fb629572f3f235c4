/* cotree_least.h: minimum-norm least-squares solutions for dense matrices of any rank.
 *
 * A = U R Q with orthonormal rows of Q, orthonormal columns of U and a triangular R. Rows whose
 * remainder is below a share of COTREE_RANK count as dependent.
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
    int n_rows, rank;     /* of the matrix factorised last */
    int stride;           /* at least the number of rows */
    cotree_real *rows;    /* stride rows of n_columns: the matrix, which is overwritten */
    cotree_real *basis;   /* Q: rank rows of n_columns */
    cotree_real *lower;   /* U: n_rows rows of stride */
    cotree_real *upper;   /* R: rank rows of stride */
    cotree_real *weights; /* stride */
} cotree_least;

void cotree_least_init(cotree_least *a, int most_rows, int n_columns, cotree_arena *arena);

/* Factorise the first n_rows rows, and return their rank. size: a lower bound of the longest row
 * to which the rank is relative, or 0. */
int cotree_least_factorise(cotree_least *a, int n_rows, cotree_real size);

/* Return the smallest singular value of the rows, 0 if they are dependent; x: n_rows numbers of
 * work space. */
cotree_real cotree_least_smallest(const cotree_least *a, cotree_real *x);

/* Compute x, n_columns entries: the minimiser of |A x + b| of minimum norm. */
void cotree_least_solve(const cotree_least *a, const cotree_real *b, cotree_real *x);

/* Project b onto the complement of the range of A: its entries are b[i * stride]. */
void cotree_least_reject(const cotree_least *a, cotree_real *b, int stride);

COTREE_END_DECLS

#endif
