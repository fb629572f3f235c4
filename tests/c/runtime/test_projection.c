/* test_projection.c: states of a point on the unit circle are brought back onto its constraints. */
#include "cotree_run.h"

#include "check.h"

#include <stdlib.h>

/* Newton's method stops at rounding. */
#define TOLERANCE 1e-14

/* The position on the circle; the velocity along it. */
static int constraints(double t, const double *x, const double *u, const double *p, const double *k,
                       double *c)
{
    (void)t, (void)u, (void)p, (void)k;
    c[0] = 0.5 * (x[0] * x[0] + x[1] * x[1] - 1.0);
    c[1] = x[0] * x[2] + x[1] * x[3];
    return 0;
}

/* A Newton step: positions and velocities move along the radius. */
static int projection(double t, const double *x, const double *u, const double *p, const double *k,
                      double *dx)
{
    const double square = x[0] * x[0] + x[1] * x[1];
    double c[2];
    constraints(t, x, u, p, k, c);
    if (square == 0.0) return COTREE_SINGULAR;
    dx[0] = -c[0] / square * x[0];
    dx[1] = -c[0] / square * x[1];
    dx[2] = -c[1] / square * x[0];
    dx[3] = -c[1] / square * x[1];
    return 0;
}

static const int sensitivity_starts[1] = {0};

static cotree_model circle(void)
{
    cotree_model model = {0};
    model.n_states = 4;
    model.n_constraints = 2;
    model.sensitivity_starts = sensitivity_starts;
    model.constraints = constraints;
    model.projection = projection;
    return model;
}

/* Makes a run in memory of just the size that was counted. */
static void *begin(cotree_run *run, const cotree_model *model)
{
    cotree_arena arena = {NULL, 0};
    size_t counted;
    cotree_run_init(run, model, NULL, NULL, NULL, 0, &arena);
    counted = arena.used;
    arena.base = (char *)malloc(counted);
    arena.used = 0;
    cotree_run_init(run, model, NULL, NULL, NULL, 0, &arena);
    CHECK(arena.used == counted);
    return arena.base;
}

static void check_point(cotree_run *run, double x, double y, double vx, double vy)
{
    const double length = sqrt(x * x + y * y), along = (-y * vx + x * vy) / length;
    double w[4] = {x, y, vx, vy};
    CHECK(cotree_run_project(0.0, w, run) == 0);
    CHECK_NEAR(w[0], x / length, TOLERANCE);
    CHECK_NEAR(w[1], y / length, TOLERANCE);
    CHECK_NEAR(w[2], -along * y / length, TOLERANCE);
    CHECK_NEAR(w[3], along * x / length, TOLERANCE);
}

int main(void)
{
    const cotree_model model = circle();
    cotree_run run;
    void *const memory = begin(&run, &model);
    double centre[4] = {0.0, 0.0, 1.0, 0.0};
    CHECK(cotree_run_is_constrained(&run));
    check_point(&run, 0.6, 0.8, -0.8, 0.6); /* on the constraints */
    CHECK(run.correction < 1e-15);
    check_point(&run, 0.601, 0.8, -0.8, 0.61);
    /* The radial part of the velocity, 0.0072, times the direction's second entry, 0.7995. */
    CHECK_NEAR(run.correction, 0.00575, 1e-5);
    check_point(&run, 3.0, -2.0, 1.0, 5.0);
    CHECK(cotree_run_project(0.0, centre, &run) == COTREE_SINGULAR);
    run.is_held = 0;
    CHECK(!cotree_run_is_constrained(&run));
    free(memory);
    return RESULT;
}
