/* test_dense.c: linear equations of full and of lower rank, by complete pivoting. */
#include "cotree_dense.h"

#include "check.h"

#include <string.h>

/* Rounding of three equations with entries of order 10. */
#define TOLERANCE 1e-13

/* Pivots below this share of the largest entry count as zero. */
#define SINGULAR 1e-10

static const double full[9] = {0.0, 2.0, 1.0, 1.0, -3.0, 4.0, 5.0, 6.0, 7.0};

static void check_full_rank(void)
{
    double a[9], x[3] = {7.0, 7.0, 38.0}; /* of the solution 1, 2, 3 */
    int rows[3], columns[3];
    memcpy(a, full, sizeof(a));
    CHECK(cotree_factorise(3, 0.0, SINGULAR, a, rows, columns) == 3);
    cotree_substitute(3, 3, a, rows, columns, x);
    CHECK_NEAR(x[0], 1.0, TOLERANCE);
    CHECK_NEAR(x[1], 2.0, TOLERANCE);
    CHECK_NEAR(x[2], 3.0, TOLERANCE);
}

/* Three planes through one line: of the solutions that of least norm is found. */
static void check_least_norm(void)
{
    double a[9] = {1.0, 1.0, 1.0, 2.0, 2.0, 2.0, 1.0, -1.0, 0.0}, x[3] = {6.0, 12.0, 0.0};
    int rows[3], columns[3];
    const int rank = cotree_factorise(3, 0.0, SINGULAR, a, rows, columns);
    CHECK(rank == 2);
    CHECK(cotree_complete(3, 0, rank, a, columns) == 1);
    cotree_substitute(3, rank, a, rows, columns, x);
    CHECK_NEAR(x[0], 2.0, TOLERANCE);
    CHECK_NEAR(x[1], 2.0, TOLERANCE);
    CHECK_NEAR(x[2], 2.0, TOLERANCE);
}

/* Unknowns that the equations determine, though others are free. */
static void check_determined(void)
{
    const double shared[9] = {1.0, 0.0, 0.0, 0.0, 1.0, 1.0, 0.0, 2.0, 2.0};
    double a[9];
    int rows[3], columns[3], n_determined;
    for (n_determined = 0; n_determined <= 3; ++n_determined) {
        int rank;
        memcpy(a, shared, sizeof(a));
        rank = cotree_factorise(3, 0.0, SINGULAR, a, rows, columns);
        CHECK(rank == 2);
        CHECK(cotree_complete(3, n_determined, rank, a, columns) == (n_determined <= 1));
    }
}

/* A matrix below the reference size is one of rank zero, whose solution is zero. */
static void check_reference(void)
{
    double a[4] = {1e-12, 0.0, 0.0, 1e-12}, x[2] = {1.0, 1.0};
    int rows[2], columns[2];
    CHECK(cotree_factorise(2, 1.0, SINGULAR, a, rows, columns) == 0);
    CHECK(cotree_complete(2, 0, 0, a, columns) == 1);
    cotree_substitute(2, 0, a, rows, columns, x);
    CHECK_NEAR(x[0], 0.0, 0.0);
    CHECK_NEAR(x[1], 0.0, 0.0);
}

/* Scales are one over the roots of sizes; a size of zero has the scale zero. */
static void check_scales(void)
{
    double sizes[2] = {4.0, 0.0}, a[4] = {4.0, 1.0, 1.0, 0.0}, x[2] = {2.0, 2.0};
    cotree_scale(2, sizes, a);
    CHECK_NEAR(sizes[0], 0.5, 0.0);
    CHECK_NEAR(sizes[1], 0.0, 0.0);
    CHECK_NEAR(a[0], 1.0, 0.0);
    cotree_multiply(2, sizes, x);
    CHECK_NEAR(x[0], 1.0, 0.0);
}

int main(void)
{
    check_full_rank();
    check_least_norm();
    check_determined();
    check_reference();
    check_scales();
    return RESULT;
}
