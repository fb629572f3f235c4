/* cotree_dense.h: small dense linear systems of any rank, by elimination with complete
 * pivoting. */
#ifndef COTREE_DENSE_H
#define COTREE_DENSE_H

#include "cotree_real.h"

/* Value of rows[0] of a matrix that was factorised without exchanges. */
#define COTREE_NOT_EXCHANGED (-1)

/* Factorise a in place by elimination with complete pivoting. rows[k] and columns[k] are the row
 * and the column exchanged with k. Return the rank: pivots below tolerance * max(reference,
 * largest entry) count as zero. */
static inline int cotree_factorise(int n, cotree_real reference, cotree_real tolerance,
                                   cotree_real *a, int *rows, int *columns)
{
    int i, j, k;
    cotree_real largest = reference;
    for (i = 0; i < n * n; ++i) {
        if (COTREE_FABS(a[i]) > largest) largest = COTREE_FABS(a[i]);
    }
    /* Initialise all entries, because callers copy them even if the matrix is singular. */
    for (k = 0; k < n; ++k) rows[k] = columns[k] = k;
    for (k = 0; k < n; ++k) {
        cotree_real best = COTREE_F(0.0);
        for (i = k; i < n; ++i) {
            for (j = k; j < n; ++j) {
                if (COTREE_FABS(a[i * n + j]) > best) {
                    best = COTREE_FABS(a[i * n + j]);
                    rows[k] = i;
                    columns[k] = j;
                }
            }
        }
        if (!(best > tolerance * largest)) return k;
        for (j = 0; j < n; ++j) {
            const cotree_real entry = a[k * n + j];
            a[k * n + j] = a[rows[k] * n + j];
            a[rows[k] * n + j] = entry;
        }
        for (i = 0; i < n; ++i) {
            const cotree_real entry = a[i * n + k];
            a[i * n + k] = a[i * n + columns[k]];
            a[i * n + columns[k]] = entry;
        }
        for (i = k + 1; i < n; ++i) {
            a[i * n + k] /= a[k * n + k];
            for (j = k + 1; j < n; ++j) a[i * n + j] -= a[i * n + k] * a[k * n + j];
        }
    }
    return n;
}

/* Write an orthonormal basis of the null space to the rows without a pivot. columns: output of
 * cotree_factorise. Return whether the first n_determined unknowns are determined: their entries in
 * the basis are below 1e-9, or 1.2e-4 in single precision. */
static inline int cotree_complete(int n, int n_determined, int rank, cotree_real *a,
                                  const int *columns)
{
    int i, j, k, accepted = 1;
    for (k = rank; k < n; ++k) {
        cotree_real *free = a + k * n;
        cotree_real length = COTREE_F(0.0);
        for (i = 0; i < n; ++i) free[i] = i == k ? COTREE_F(1.0) : COTREE_F(0.0);
        for (i = rank - 1; i >= 0; --i) {
            free[i] = -a[i * n + k];
            for (j = i + 1; j < rank; ++j) free[i] -= a[i * n + j] * free[j];
            free[i] /= a[i * n + i];
        }
        for (j = rank; j < k; ++j) {
            cotree_real along = COTREE_F(0.0);
            for (i = 0; i < n; ++i) along += free[i] * a[j * n + i];
            for (i = 0; i < n; ++i) free[i] -= along * a[j * n + i];
        }
        for (i = 0; i < n; ++i) length += free[i] * free[i];
        length = COTREE_SQRT(length);
        for (i = 0; i < n; ++i) free[i] /= length;
        for (i = 0; i < n; ++i) {
            int place = i; /* index of unknown i among the exchanged columns */
            for (j = 0; j < rank; ++j) {
                if (place == j) {
                    place = columns[j];
                } else if (place == columns[j]) {
                    place = j;
                }
            }
            if (i < n_determined && COTREE_FABS(free[place]) > COTREE_SELECT(1e-9, 1.2e-04f))
                accepted = 0;
        }
    }
    return accepted;
}

/* Solve for one right-hand side in place. If the rank is deficient, the result is the minimum-norm
 * solution. */
static inline void cotree_substitute(int n, int rank, const cotree_real *a, const int *rows,
                                     const int *columns, cotree_real *x)
{
    int i, k;
    for (k = 0; k < rank; ++k) {
        const cotree_real entry = x[k];
        x[k] = x[rows[k]]; /* NOLINT(clang-analyzer-core*): the rank is from 0 to n */
        x[rows[k]] = entry;
    }
    for (k = 0; k < rank; ++k) {
        for (i = k + 1; i < n; ++i) x[i] -= a[i * n + k] * x[k];
    }
    for (k = rank; k < n; ++k) x[k] = COTREE_F(0.0);
    for (k = rank - 1; k >= 0; --k) {
        x[k] /= a[k * n + k];
        for (i = 0; i < k; ++i) x[i] -= a[i * n + k] * x[k];
    }
    for (k = rank; k < n; ++k) {
        cotree_real along = COTREE_F(0.0);
        /* NOLINTNEXTLINE(clang-analyzer-core*): the rank is from 0 to n */
        for (i = 0; i < n; ++i) along += x[i] * a[k * n + i];
        for (i = 0; i < n; ++i) x[i] -= along * a[k * n + i];
    }
    for (k = rank - 1; k >= 0; --k) {
        const cotree_real entry = x[k];
        x[k] = x[columns[k]];
        x[columns[k]] = entry;
    }
}

/* Divide rows and columns by the square roots of their sizes, and store the inverse roots. The
 * factor of a zero row is zero: in some positions no motion changes a constraint. */
static inline void cotree_scale(int n, cotree_real *sizes, cotree_real *a)
{
    int i, j;
    for (i = 0; i < n; ++i)
        sizes[i] =
            sizes[i] == COTREE_F(0.0) ? COTREE_F(0.0) : COTREE_F(1.0) / COTREE_SQRT(sizes[i]);
    for (i = 0; i < n; ++i) {
        for (j = 0; j < n; ++j) a[i * n + j] *= sizes[i] * sizes[j];
    }
}

static inline void cotree_multiply(int n, const cotree_real *scales, cotree_real *x)
{
    int i;
    for (i = 0; i < n; ++i) x[i] *= scales[i];
}

#endif
