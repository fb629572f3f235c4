/* cotree_lu.h: linear systems with a dense or a banded matrix, by elimination with row exchanges.
 * Part of the runtime of cotree, the same for every model.
 */
#ifndef COTREE_LU_H
#define COTREE_LU_H

#include "cotree_abi.h"

#include <stddef.h>

#ifdef __cplusplus
extern "C" {
#endif

/* A square matrix with two bandwidths, and room for the rows that pivoting brings up: entry (i, j)
 * is at first[i + j * stride]. With the bandwidths n or n - 1 it is dense. */
typedef struct cotree_lu {
    int n, lower, upper;
    ptrdiff_t stride;
    cotree_real *first;
    int *pivots;
} cotree_lu;

/* How many cotree_reals it needs. */
size_t cotree_lu_doubles(int n, int lower, int upper);

/* The matrix in its memory, and n ints for its pivots. */
cotree_lu cotree_lu_of(int n, int lower, int upper, cotree_real *memory, int *pivots);

/* Factorises in place. Returns 0, or 1 if the matrix is singular. */
int cotree_lu_factorise(const cotree_lu *a);

/* Solves in place, once it is factorised. */
void cotree_lu_solve(const cotree_lu *a, cotree_real *b);

#ifdef __cplusplus
}
#endif

#endif
