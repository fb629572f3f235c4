/* test_algebraic.c: an algebraic unknown is solved for, and eliminated from rates and Jacobian.
 *
 * x' = -x + z and 0 = z^3 + z - x: z is a monotonic function of x. */
#include "cotree_run.h"

#include "check.h"

#include <stdlib.h>

/* The residual is met to rounding. */
#define TOLERANCE 1e-14

static int rhs(double t, const double *x, const double *u, const double *p, const double *k,
               double *dx)
{
    (void)t, (void)u, (void)p, (void)k;
    dx[0] = -x[0] + x[1];
    dx[1] = x[1] * x[1] * x[1] + x[1] - x[0];
    return 0;
}

static int jacobian(double t, const double *x, const double *u, const double *p, const double *k,
                    double *values)
{
    (void)t, (void)u, (void)p, (void)k;
    values[0] = -1.0;
    values[1] = -1.0;
    values[2] = 1.0;
    values[3] = 3.0 * x[1] * x[1] + 1.0;
    return 0;
}

/* A residual that cannot be evaluated. */
static int failing_rhs(double t, const double *x, const double *u, const double *p, const double *k,
                       double *dx)
{
    (void)t, (void)x, (void)u, (void)p, (void)k;
    dx[0] = dx[1] = 0.0;
    return COTREE_FAILED_CALL;
}

static const int column_starts[3] = {0, 2, 4}, row_indices[4] = {0, 1, 0, 1};
static const int sensitivity_starts[1] = {0};

static cotree_model cubic(void)
{
    cotree_model model = {0};
    model.n_states = 2;
    model.n_algebraic = 1;
    model.n_nonzeros = 4;
    model.column_starts = column_starts;
    model.row_indices = row_indices;
    model.sensitivity_starts = sensitivity_starts;
    model.rhs = rhs;
    model.jacobian = jacobian;
    return model;
}

/* Finds z at x = z^3 + z, from a guess. */
static void check_solution(cotree_run *run, double z, double guess)
{
    const double x = z * z * z + z, all[2] = {x, guess};
    double w[1], rate[1], matrix[1];
    cotree_run_narrow(run, 0.0, all, w);
    CHECK_NEAR(w[0], x, 0.0);
    CHECK(cotree_run_complete(run, 0.0, w) == 0);
    CHECK_NEAR(run->full[0], x, 0.0);
    CHECK_NEAR(run->full[1], z, TOLERANCE * (1.0 + fabs(z)));
    CHECK(cotree_run_rate(0.0, w, rate, run) == 0);
    CHECK_NEAR(rate[0], z - x, TOLERANCE * (1.0 + fabs(x)));
    CHECK(cotree_run_jacobian(0.0, w, matrix, run) == 0);
    CHECK_NEAR(matrix[0], -1.0 + 1.0 / (3.0 * z * z + 1.0), 1e-12);
}

int main(void)
{
    cotree_model model = cubic();
    cotree_arena arena = {NULL, 0};
    cotree_run run;
    void *memory;
    double w[1] = {2.0};
    cotree_run_init(&run, &model, NULL, NULL, NULL, 0, &arena);
    memory = malloc(arena.used);
    arena.base = (char *)memory;
    arena.used = 0;
    cotree_run_init(&run, &model, NULL, NULL, NULL, 0, &arena);
    CHECK(run.n == 1);
    check_solution(&run, 0.5, 0.5);
    check_solution(&run, 0.5, 0.4);
    check_solution(&run, 2.0, 0.5); /* far: steps are damped */
    check_solution(&run, -3.0, 10.0);
    model.rhs = failing_rhs;
    CHECK(cotree_run_complete(&run, 0.0, w) == COTREE_FAILED_CALL);
    free(memory);
    return RESULT;
}
