/* test_history.c: interpolation through points with and without rates. */
#include "cotree_history.h"

#include "check.h"

#include <string.h>

/* Rounding of polynomials of order 1. */
#define TOLERANCE 1e-12

static cotree_real memory[COTREE_HISTORY_WORKSPACE(2)];

/* Adds the points i = first, ..., last at times 0.1 i of (t^degree, 3). */
static void add_powers(cotree_history *h, int degree, int first, int last)
{
    int i;
    for (i = first; i <= last; ++i) {
        const double t = 0.1 * i;
        const cotree_real y[2] = {pow(t, degree), 3.0}, rate[2] = {degree * pow(t, degree - 1), 0.0};
        cotree_history_add(h, t, y, rate);
    }
}

/* Through m points with rates the polynomial of degree 2 m - 1 is exact; a constant has no error. */
static void check_degree_with_rates(void)
{
    cotree_real y[2];
    int m;
    for (m = 1; m <= 4; ++m) {
        cotree_history h;
        cotree_history_init(&h, 2, memory);
        add_powers(&h, 2 * m - 1, 5, 4 + m);
        cotree_history_read(&h, 0.63, y);
        CHECK_NEAR(y[0], pow(0.63, 2 * m - 1), TOLERANCE);
        CHECK_NEAR(y[1], 3.0, 0.0);
        cotree_history_read(&h, 0.5, y);
        CHECK_NEAR(y[0], pow(0.5, 2 * m - 1), TOLERANCE);
    }
}

/* Without rates the degree is m - 1. */
static void check_degree_without_rates(void)
{
    cotree_history h;
    cotree_real y[2];
    cotree_history_init(&h, 2, memory);
    h.uses_rates = 0;
    add_powers(&h, 3, 0, 3);
    cotree_history_read(&h, 0.17, y);
    CHECK_NEAR(y[0], 0.17 * 0.17 * 0.17, TOLERANCE);
    add_powers(&h, 4, 4, 4); /* no longer one polynomial */
    cotree_history_read(&h, 0.35, y);
    CHECK(fabs(y[0] - 0.35 * 0.35 * 0.35) > 1e-4);
}

/* The oldest point is removed, in either direction of time. */
static void check_oldest_point(void)
{
    cotree_history h;
    cotree_real y[2];
    cotree_history_init(&h, 2, memory);
    add_powers(&h, 1, -9, -9); /* of another function */
    add_powers(&h, 7, 0, COTREE_HISTORY_POINTS - 1);
    CHECK(h.n_points == COTREE_HISTORY_POINTS);
    CHECK_NEAR(h.t[0], 0.0, 0.0);
    cotree_history_read(&h, 0.26, y);
    CHECK_NEAR(y[0], pow(0.26, 7), TOLERANCE);
}

/* The error is that of the polynomial with one point less, in tolerances. */
static void check_error(void)
{
    const cotree_real atols[2] = {1e-6, 1e-6};
    cotree_history h;
    cotree_real scratch[2];
    cotree_history_init(&h, 2, memory);
    add_powers(&h, 3, 1, 3);
    CHECK_NEAR(cotree_history_error(&h, 1, 0.0, atols, 0, 0, scratch), 0.0, 1e-6);
    cotree_history_init(&h, 2, memory);
    add_powers(&h, 6, 1, 3);
    CHECK(cotree_history_error(&h, 1, 0.0, atols, 0, 0, scratch) > 1.0);
    CHECK_NEAR(cotree_history_error(&h, 1, 0.0, atols, 0, 1, scratch), 0.0, 0.0);
}

int main(void)
{
    memset(memory, 0, sizeof(memory));
    check_degree_with_rates();
    check_degree_without_rates();
    check_oldest_point();
    check_error();
    return RESULT;
}
