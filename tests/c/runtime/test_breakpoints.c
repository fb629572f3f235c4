/* test_breakpoints.c: times of single and of periodic breakpoints, and their derivatives. */
#include "cotree_breakpoints.h"

#include "check.h"

/* Rounding of times of order 1. */
#define TOLERANCE 1e-15

/* With one sensitivity: a single time; a period in both directions; one that begins at its first
 * time; one that ends there; and one that does not exist. */
static const cotree_real rows[5][5] = {
    {0.7, 0.0, 0.0, 1.0, 0.0},       {0.25, 1.0, 0.0, 0.0, 2.0}, {2.1, 0.5, 1.0, 0.0, 0.0},
    {-1.0, 0.3, -1.0, 0.0, 0.0},     {HUGE_VAL, 0.0, 0.0, 0.0, 0.0},
};

static void check_forwards(void)
{
    const cotree_breakpoints all = {5, 1, rows[0]};
    const double expected[6] = {0.25, 0.7, 1.25, 2.1, 2.25, 2.6};
    double t = 0.0;
    int i;
    for (i = 0; i < 6; ++i) {
        t = cotree_next_breakpoint(&all, t, 2.7);
        CHECK_NEAR(t, expected[i], TOLERANCE * 4.0);
        CHECK(cotree_is_breakpoint(&all, t));
    }
    CHECK_NEAR(cotree_next_breakpoint(&all, t, 2.7), 2.7, 0.0);
    CHECK(!cotree_is_breakpoint(&all, 0.5));
}

static void check_backwards(void)
{
    const cotree_breakpoints all = {5, 1, rows[0]};
    const double expected[5] = {0.25, -0.75, -1.0, -1.3, -1.6};
    double t = 0.5;
    int i;
    for (i = 0; i < 5; ++i) {
        t = cotree_next_breakpoint(&all, t, -1.7);
        CHECK_NEAR(t, expected[i], TOLERANCE * 4.0);
    }
    CHECK_NEAR(cotree_next_breakpoint(&all, t, -1.7), -1.7, 0.0);
}

/* A breakpoint at the end is the end itself, and one within its rounding, too. */
static void check_end(void)
{
    const cotree_breakpoints single = {1, 1, rows[0]};
    CHECK_NEAR(cotree_next_breakpoint(&single, 0.0, 0.7), 0.7, 0.0);
    CHECK_NEAR(cotree_next_breakpoint(&single, 0.0, 0.7 * (1.0 + 1e-15)), 0.7 * (1.0 + 1e-15), 0.0);
    CHECK_NEAR(cotree_next_breakpoint(&single, 0.0, HUGE_VAL), 0.7, 0.0);
    CHECK(cotree_next_breakpoint(&single, 0.7, HUGE_VAL) > 1e300);
}

static void check_largest(void)
{
    const cotree_breakpoints all = {5, 1, rows[0]};
    CHECK_NEAR(cotree_largest_breakpoint(&all, 1.0), 2.1, 0.0);
    CHECK_NEAR(cotree_largest_breakpoint(&all, -9.0), 9.0, 0.0);
}

/* The third time of the period moves by twice the derivative of the period. */
static void check_slopes(void)
{
    const cotree_breakpoints all = {5, 1, rows[0]};
    const cotree_real meeting[2][5] = {{1.0, 0.0, 0.0, 1.0, 0.0}, {1.0, 0.0, 0.0, 4.0, 0.0}};
    const cotree_breakpoints both = {2, 1, meeting[0]};
    cotree_real slope, spread;
    cotree_find_breakpoint_slopes(&all, 2.25, 0, &slope, &spread);
    CHECK_NEAR(slope, 4.0, 0.0);
    CHECK_NEAR(spread, 0.0, 0.0);
    cotree_find_breakpoint_slopes(&both, 1.0, 0, &slope, &spread);
    CHECK_NEAR(spread, 3.0, 0.0);
    cotree_find_breakpoint_slopes(&both, 1.0, 1, &slope, &spread); /* the start does not move */
    CHECK_NEAR(slope, 0.0, 0.0);
    CHECK_NEAR(spread, 4.0, 0.0);
}

/* Lists that exceed a limit are refused before they are made. */
static void check_limits(void)
{
    const cotree_breakpoints all = {5, 1, rows[0]};
    /* 1e9 periods exceed the range of int with four series, and 1e12 with one. */
    const cotree_real dense[4][3] = {
        {0.0, 1e-9, 0.0}, {0.0, 1e-9, 0.0}, {0.0, 1e-9, 0.0}, {0.0, 1e-9, 0.0}};
    const cotree_real densest[1][3] = {{0.5, 1e-12, 1.0}};
    /* Three series of nine million times are more than twenty million. */
    const cotree_real many[3][3] = {
        {0.0, 1.0 / 9e6, 0.0}, {0.0, 1.0 / 9e6, 0.0}, {0.0, 1.0 / 9e6, 0.0}};
    /* Four million times with their derivatives by four parameters are 36 million numbers. */
    const cotree_real wide[1][11] = {{0.0, 1.0 / 4e6}};
    const cotree_breakpoints first = {4, 0, dense[0]}, second = {1, 0, densest[0]},
                             third = {3, 0, many[0]}, fourth = {1, 4, wide[0]};
    cotree_real times[10];
    CHECK(cotree_most_breakpoints(&first, 0.0, 1.0) == -1);
    CHECK(cotree_most_breakpoints(&second, 0.0, 1.0) == -1);
    CHECK(cotree_most_breakpoints(&second, 1.0, 0.0) == -1);
    CHECK(cotree_most_breakpoints(&third, 0.0, 1.0) == -1);
    /* Three series of nine times after the start, which are listed once, and both ends. */
    CHECK(cotree_most_breakpoints(&third, 0.0, 1e-6) >= 3 * 10);
    CHECK(cotree_list_breakpoints(&third, 0.0, 1e-6, times) == 10);
    CHECK(cotree_most_breakpoints(&fourth, 0.0, 1.0) == -1);
    /* The second series begins after this span. */
    CHECK(cotree_list_breakpoints(&second, 0.0, 0.4, times) == 2);
    CHECK(cotree_list_breakpoints(&all, 0.0, 2.7, times) == 8);
    CHECK(cotree_most_breakpoints(&second, 0.0, 0.4) >= 2);
    CHECK(cotree_most_breakpoints(&all, 0.0, 2.7) >= 8);
    CHECK_NEAR(times[7], 2.7, 0.0);
    CHECK_NEAR(cotree_shortest_period(&all), 0.3, 0.0);
}

int main(void)
{
    check_forwards();
    check_backwards();
    check_end();
    check_largest();
    check_slopes();
    check_limits();
    return RESULT;
}
