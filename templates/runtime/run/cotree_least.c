/* cotree_least.c: complete orthogonal factorisation by modified Gram-Schmidt. */
#include "cotree_least.h"

/* Number of inverse iterations. Each reduces the error by the squared ratio of the smallest
 * singular value to the next one. */
#define MOST_INVERSE 40

/* Number of passes of each projection; the second pass makes the remainder orthogonal up to
 * rounding. */
#define PASSES 2

void cotree_least_init(cotree_least *a, int most_rows, int n_columns, cotree_arena *arena)
{
    a->n_columns = n_columns;
    a->n_rows = a->rank = 0;
    a->stride = most_rows;
    a->rows = cotree_arena_reals(arena, most_rows * n_columns);
    a->basis = cotree_arena_reals(arena, most_rows * n_columns);
    a->lower = cotree_arena_reals(arena, most_rows * most_rows);
    a->upper = cotree_arena_reals(arena, most_rows * most_rows);
    a->weights = cotree_arena_reals(arena, most_rows);
}

static cotree_real product(const cotree_real *x, const cotree_real *y, int n, int stride)
{
    cotree_real sum = COTREE_F(0.0);
    int i;
    for (i = 0; i < n; ++i) sum += x[i * stride] * y[i * stride];
    return sum;
}

/* Continue the factorisation A = L Q. Each step normalises the longest remaining row as the next
 * row of Q and subtracts its component from all rows. */
int cotree_least_extend(cotree_least *a, int first, int end, cotree_real least)
{
    const int n = a->n_columns, stride = a->stride;
    int i, k, r;
    for (; a->rank < a->n_rows && a->rank < n; ++a->rank) {
        cotree_real *const q = a->basis + a->rank * n;
        cotree_real longest = COTREE_F(0.0), length;
        int pivot = first;
        for (r = first; r < end; ++r) {
            length = product(a->rows + r * n, a->rows + r * n, n, 1);
            if (length > longest) {
                longest = length;
                pivot = r;
            }
        }
        length = COTREE_SQRT(longest);
        if (a->rank == 0) least = COTREE_FMAX(least, COTREE_RANK * length);
        if (!(length > least)) break;
        for (i = 0; i < n; ++i) q[i] = a->rows[pivot * n + i] / length;
        for (r = 0; r < a->n_rows; ++r) {
            cotree_real *const row = a->rows + r * n;
            cotree_real whole = COTREE_F(0.0);
            for (k = 0; k < PASSES; ++k) {
                const cotree_real along = product(row, q, n, 1);
                for (i = 0; i < n; ++i) row[i] -= along * q[i];
                whole += along;
            }
            a->lower[r * stride + a->rank] = whole;
        }
        for (i = 0; i < n; ++i) a->rows[pivot * n + i] = COTREE_F(0.0);
    }
    return a->rank;
}

/* Factorise L = U R in place; the columns of L are independent. */
static void factorise_columns(cotree_least *a)
{
    const int stride = a->stride;
    int j, k, pass, r;
    for (j = 0; j < a->rank; ++j) {
        cotree_real *const u = a->lower + j;
        cotree_real length;
        for (k = 0; k < j; ++k) a->upper[k * stride + j] = COTREE_F(0.0);
        for (pass = 0; pass < PASSES; ++pass) {
            for (k = 0; k < j; ++k) {
                const cotree_real along = product(u, a->lower + k, a->n_rows, stride);
                for (r = 0; r < a->n_rows; ++r) u[r * stride] -= along * a->lower[r * stride + k];
                a->upper[k * stride + j] += along;
            }
        }
        length = COTREE_SQRT(product(u, u, a->n_rows, stride));
        for (r = 0; r < a->n_rows; ++r) u[r * stride] /= length;
        a->upper[j * stride + j] = length;
    }
}

int cotree_least_factorise(cotree_least *a, int n_rows, cotree_real size)
{
    a->n_rows = n_rows;
    a->rank = 0;
    cotree_least_extend(a, 0, n_rows, COTREE_RANK * size);
    factorise_columns(a);
    return a->rank;
}

void cotree_least_solve(const cotree_least *a, const cotree_real *b, cotree_real *x)
{
    const int n = a->n_columns, stride = a->stride;
    int i, k, r;
    for (i = 0; i < n; ++i) x[i] = COTREE_F(0.0);
    for (k = a->rank - 1; k >= 0; --k) {
        cotree_real weight = COTREE_F(0.0);
        for (r = 0; r < a->n_rows; ++r) weight -= a->lower[r * stride + k] * b[r];
        for (i = k + 1; i < a->rank; ++i) weight -= a->upper[k * stride + i] * a->weights[i];
        a->weights[k] = weight / a->upper[k * stride + k];
        for (i = 0; i < n; ++i) x[i] += a->weights[k] * a->basis[k * n + i];
    }
}

cotree_real cotree_least_smallest(const cotree_least *a, cotree_real *x)
{
    const int n = a->n_rows, stride = a->stride;
    cotree_real size = COTREE_F(1.0);
    int i, k, step;
    if (a->rank < n) return COTREE_F(0.0);
    for (i = 0; i < n; ++i) x[i] = COTREE_F(1.0) + COTREE_F(0.1) * (cotree_real)(i % 7);
    for (step = 0; step < MOST_INVERSE; ++step) {
        /* Inverse iteration x <- R^-1 R^-T x / |x|; A and R have the same singular values. */
        size = COTREE_SQRT(product(x, x, n, 1));
        for (k = 0; k < n; ++k) {
            cotree_real sum = x[k] / size;
            for (i = 0; i < k; ++i) sum -= a->upper[i * stride + k] * x[i];
            x[k] = sum / a->upper[k * stride + k];
        }
        for (k = n - 1; k >= 0; --k) {
            cotree_real sum = x[k];
            for (i = k + 1; i < n; ++i) sum -= a->upper[k * stride + i] * x[i];
            x[k] = sum / a->upper[k * stride + k];
        }
    }
    size = COTREE_SQRT(product(x, x, n, 1));
    return COTREE_F(1.0) / COTREE_SQRT(size);
}

#if COTREE_HAS_MENDING
void cotree_least_reject(const cotree_least *a, cotree_real *b, int stride)
{
    int k, pass, r;
    for (pass = 0; pass < PASSES; ++pass) {
        for (k = 0; k < a->rank; ++k) {
            cotree_real along = COTREE_F(0.0);
            for (r = 0; r < a->n_rows; ++r) along += b[r * stride] * a->lower[r * a->stride + k];
            for (r = 0; r < a->n_rows; ++r) b[r * stride] -= along * a->lower[r * a->stride + k];
        }
    }
}
#endif
