/* test_lu.c: solutions with dense and banded matrices, row exchanges, and singular matrices. */
#include "cotree_lu.h"

#include "check.h"

#include <stdlib.h>

/* Rounding of systems of this size with entries of order 1. */
#define TOLERANCE 1e-13

/* An entry of a matrix; its diagonal is small, so that rows are exchanged. */
static double entry(int i, int j)
{
    return i == j ? 0.01 * (i + 1) : sin(1.0 + 3.0 * i + 7.0 * j);
}

/* Solves with the entries within the bandwidths for a right-hand side of the solution 1, 2, ... */
static void check_solution(int n, int lower, int upper)
{
    const size_t size = cotree_lu_doubles(n, lower, upper);
    double *const memory = (double *)calloc(size, sizeof(double));
    double *const b = (double *)calloc((size_t)n, sizeof(double));
    int *const pivots = (int *)calloc((size_t)n, sizeof(int));
    const cotree_lu a = cotree_lu_of(n, lower, upper, memory, pivots);
    int i, j;
    for (j = 0; j < n; ++j) {
        for (i = 0; i < n; ++i) {
            if (i - j > lower || j - i > upper) continue;
            a.first[i + j * a.stride] = entry(i, j);
            b[i] += entry(i, j) * (j + 1);
        }
    }
    CHECK(cotree_lu_factorise(&a) == 0);
    cotree_lu_solve(&a, b);
    for (i = 0; i < n; ++i) CHECK_NEAR(b[i], i + 1.0, TOLERANCE * n * n);
    free(memory);
    free(b);
    free(pivots);
}

/* A band takes less memory than a dense matrix, if it is narrow. */
static void check_sizes(void)
{
    CHECK(cotree_lu_doubles(10, 9, 9) == 100);
    CHECK(cotree_lu_doubles(10, 10, 10) == 100);
    CHECK(cotree_lu_doubles(10, 1, 1) == 40); /* with a diagonal for the fill-in of exchanges */
}

/* A zero column, dependent rows, and an entry that is not finite. */
static void check_singular(void)
{
    double zero_column[4] = {0.0, 0.0, 1.0, 1.0}, dependent[4] = {1.0, 2.0, 2.0, 4.0};
    double infinite[4] = {HUGE_VAL, 1.0, 1.0, 1.0}, nan[4] = {HUGE_VAL - HUGE_VAL, 1.0, 1.0, 1.0};
    double *const all[4] = {zero_column, dependent, infinite, nan};
    int pivots[2], i;
    for (i = 0; i < 4; ++i) {
        const cotree_lu a = cotree_lu_of(2, 1, 1, all[i], pivots);
        CHECK(cotree_lu_factorise(&a) == 1);
    }
}

int main(void)
{
    check_sizes();
    check_solution(1, 0, 0);
    check_solution(3, 2, 2);
    check_solution(12, 11, 11);
    check_solution(12, 1, 1);
    check_solution(12, 2, 1);
    check_solution(12, 1, 3);
    check_singular();
    return RESULT;
}
