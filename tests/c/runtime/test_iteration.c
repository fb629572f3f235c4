/* test_iteration.c: Newton's method with and without damping, and its results. */
#include "cotree_iteration.h"

#include "check.h"

#include <stddef.h>

/* Newton's method stops at rounding. */
#define TOLERANCE 1e-15

typedef struct equation {
    double before, step;
    int n_matrices;
    double slope;
} equation;

/* atan(x) = 0: whole steps diverge beyond 1.39. */
static int damped_step(const cotree_iteration *a, int is_new, cotree_real *size)
{
    equation *const e = (equation *)a->context;
    const double x = *a->x;
    if (is_new) {
        e->before = x;
        e->slope = 1.0 / (1.0 + x * x);
        e->step = -atan(x) / e->slope;
        ++e->n_matrices;
    }
    *size = fabs(atan(x) / e->slope);
    return 0;
}

static int move(const cotree_iteration *a, cotree_real share)
{
    const equation *const e = (const equation *)a->context;
    *a->x = e->before + share * e->step;
    return 0;
}

/* Against every step. */
static int refuse(const cotree_iteration *a, cotree_real share)
{
    const equation *const e = (const equation *)a->context;
    *a->x = e->before - share * e->step;
    return 0;
}

/* x^2 = t by whole steps. */
static int whole_step(const cotree_iteration *a, int is_new, cotree_real *size)
{
    const double step = (a->t - *a->x * *a->x) / (2.0 * *a->x);
    CHECK(is_new);
    *a->x += step;
    *size = fabs(step);
    return 0;
}

static int failing_step(const cotree_iteration *a, int is_new, cotree_real *size)
{
    (void)a, (void)is_new;
    *size = 1.0;
    return 2;
}

int main(void)
{
    static const cotree_newton_limits limits = {50, 1e-15, 1e-8, 1e-4, 1e-6};
    static const cotree_newton_limits few = {2, 1e-15, 1e-8, 1e-4, 1e-6};
    equation e = {0.0, 0.0, 0, 0.0};
    double x = 20.0;
    cotree_iteration a = {damped_step, move, NULL, 2.0, NULL, &limits, 0.0};
    a.context = &e;
    a.x = &x;
    CHECK(cotree_iterate(&a) == 0);
    CHECK_NEAR(x, 0.0, TOLERANCE);
    CHECK(e.n_matrices < 15);
    x = 20.0;
    a.move = refuse;
    CHECK(cotree_iterate(&a) == COTREE_NO_STEP);
    x = 1.0;
    a.step = whole_step;
    a.move = NULL;
    CHECK(cotree_iterate(&a) == 0);
    CHECK_NEAR(x, 1.4142135623730951, TOLERANCE);
    x = 100.0;
    a.limits = &few;
    CHECK(cotree_iterate(&a) == COTREE_NO_STEP);
    a.step = failing_step;
    CHECK(cotree_iterate(&a) == 2);
    return RESULT;
}
