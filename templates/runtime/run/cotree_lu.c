/* cotree_lu.c: LU factorisation with partial pivoting. */
#include "cotree_lu.h"

static int is_dense(int n, int lower, int upper) { return 2 * lower + upper + 1 >= n; }

size_t cotree_lu_doubles(int n, int lower, int upper)
{
    const int height = is_dense(n, lower, upper) ? n : 2 * lower + upper + 1;
    return (size_t)height * (size_t)n;
}

cotree_lu cotree_lu_of(int n, int lower, int upper, cotree_real *memory, int *pivots)
{
    cotree_lu a;
    a.n = n;
    a.lower = lower;
    a.upper = upper;
    a.pivots = pivots;
    a.first = memory;
    a.stride = n;
    if (!is_dense(n, lower, upper)) {
        /* In banded storage, each column starts one row lower than the previous one. */
        a.first = memory + lower + upper;
        a.stride = 2 * (ptrdiff_t)lower + upper;
    }
    return a;
}

void cotree_lu_load(const cotree_lu *a, cotree_real multiple, const int *starts, const int *rows,
                    const cotree_real *values, int first, int is_transposed)
{
    const int n = a->n;
    int e, i, j;
    for (i = 0; i < n * n; ++i) a->first[i] = COTREE_F(0.0);
    for (j = 0; j < n; ++j) {
        for (e = starts[first + j]; e < starts[first + j + 1]; ++e) {
            i = rows[e] - first;
            if (i < 0 || i >= n) continue;
            a->first[is_transposed ? j + i * n : i + j * n] = multiple * values[e];
        }
    }
}

static int smaller(int a, int b) { return a < b ? a : b; }

int cotree_lu_factorise(const cotree_lu *a)
{
    int i, j, k;
    for (j = 0; j < a->n; ++j) {
        cotree_real *const COTREE_RESTRICT column = a->first + j * a->stride;
        const int last = smaller(a->n - 1, j + a->lower);
        const int right = smaller(a->n - 1, j + a->lower + a->upper);
        int pivot = j;
        cotree_real inverse;
        for (i = j + 1; i <= last; ++i) {
            if (COTREE_FABS(column[i]) > COTREE_FABS(column[pivot])) pivot = i;
        }
        a->pivots[j] = pivot;
        if (!(COTREE_FABS(column[pivot]) > COTREE_F(0.0) &&
              COTREE_FABS(column[pivot]) <= COTREE_MAX))
            return 1;
        inverse = COTREE_F(1.0) / column[pivot];
        column[pivot] = column[j];
        column[j] = inverse; /* the diagonal stores the inverse of the pivot */
        for (i = j + 1; i <= last; ++i) column[i] *= inverse;
        for (k = j + 1; k <= right; ++k) {
            cotree_real *const COTREE_RESTRICT other = a->first + k * a->stride;
            const cotree_real factor = other[pivot];
            other[pivot] = other[j];
            other[j] = factor;
            if (factor == COTREE_F(0.0)) continue;
            for (i = j + 1; i <= last; ++i) other[i] -= factor * column[i];
        }
    }
    return 0;
}

void cotree_lu_solve(const cotree_lu *a, cotree_real *COTREE_RESTRICT b)
{
    int i, j;
    for (j = 0; j < a->n; ++j) {
        const cotree_real *const COTREE_RESTRICT column = a->first + j * a->stride;
        const int last = smaller(a->n - 1, j + a->lower), pivot = a->pivots[j];
        const cotree_real factor = b[pivot];
        b[pivot] = b[j];
        b[j] = factor;
        for (i = j + 1; i <= last; ++i) b[i] -= factor * column[i];
    }
    for (j = a->n - 1; j >= 0; --j) {
        const cotree_real *const COTREE_RESTRICT column = a->first + j * a->stride;
        const int top = j > a->lower + a->upper ? j - a->lower - a->upper : 0;
        b[j] *= column[j];
        for (i = top; i < j; ++i) b[i] -= b[j] * column[i];
    }
}
