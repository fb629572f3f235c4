/* cotree_lu.h: solution of linear systems with dense or banded matrices by LU factorisation with
 * partial pivoting. */
#ifndef COTREE_LU_H
#define COTREE_LU_H

#include "cotree_abi.h"

#include <stddef.h>

COTREE_BEGIN_DECLS

/* A square matrix with lower and upper bandwidth, and space for the fill-in of row exchanges. Entry
 * (i, j) is first[i + j * stride]. A dense matrix has bandwidths n or n - 1. */
typedef struct cotree_lu {
    int n, lower, upper;
    ptrdiff_t stride;
    cotree_real *first;
    int *pivots;
} cotree_lu;

/* Return the number of entries to allocate. */
size_t cotree_lu_doubles(int n, int lower, int upper);

/* Return a matrix that uses the caller's memory, with n ints for its pivots. */
cotree_lu cotree_lu_of(int n, int lower, int upper, cotree_real *memory, int *pivots);

/* Set a dense matrix to the given multiple of a square block of a matrix in compressed columns, or
 * of its transpose. `first` is the first row and the first column of the block. */
void cotree_lu_load(const cotree_lu *a, cotree_real multiple, const int *starts, const int *rows,
                    const cotree_real *values, int first, int is_transposed);

/* Factorise in place. Return 0, or 1 if the matrix is singular. */
int cotree_lu_factorise(const cotree_lu *a);

/* Solve in place with the factorised matrix. */
void cotree_lu_solve(const cotree_lu *a, cotree_real *b);

COTREE_END_DECLS

#endif
