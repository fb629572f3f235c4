/* Runs one case of the integrator, named by the first argument, and prints numbers, a line each.
 * What they must be is said in test_embedded.py. */
#include "cotree_dopri5.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

struct trap {
    double t;    /* the rate fails beyond it */
    int result;  /* what it returns then; 0 for a rate that is not a number */
    double size; /* the rate fails where |y| is larger, unless zero */
};

static int oscillator(double t, const double *y, double *dy, void *context)
{
    (void)t;
    (void)context;
    dy[0] = y[1];
    dy[1] = -y[0];
    return 0;
}

static int nothing(double t, const double *y, double *dy, void *context)
{
    (void)t;
    (void)y;
    (void)dy;
    (void)context;
    return 0;
}

static int square(double t, const double *y, double *dy, void *context)
{
    (void)t;
    (void)context;
    dy[0] = y[0] * y[0];
    return 0;
}

static int decay(double t, const double *y, double *dy, void *context)
{
    const struct trap *const trap = (const struct trap *)context;
    dy[0] = -100.0 * y[0];
    if (t > trap->t || (trap->size > 0.0 && fabs(y[0]) > trap->size)) {
        if (trap->result == 0) dy[0] = strtod("nan", NULL);
        return trap->result;
    }
    return 0;
}

/* A point on the unit circle, held there. */
struct circle {
    int result;        /* of the projection beyond t = 0.25; 0 for no number, -1 for no failure */
    int n_projections; /* so far */
};

static int turn(double t, const double *y, double *dy, void *context)
{
    (void)context;
    dy[0] = -(1.0 + t) * y[1];
    dy[1] = (1.0 + t) * y[0];
    return 0;
}

static int hold(double t, double *y, void *context)
{
    struct circle *const circle = (struct circle *)context;
    const double length = hypot(y[0], y[1]);
    ++circle->n_projections;
    y[0] /= length;
    y[1] /= length;
    if (t > 0.25 && circle->result == 0) y[0] = strtod("nan", NULL);
    return t > 0.25 && circle->result > 0;
}

static double distance(double t, const double *y)
{
    return hypot(y[0] - cos(t), y[1] + sin(t));
}

/* Equal steps, as the tolerances accept any: errors at the end of steps and between them. */
static void order(int n_steps)
{
    static const double y0[2] = {1.0, 0.0};
    double workspace[COTREE_DOPRI5_WORKSPACE(2)], y[2], at_steps = 0.0, between = 0.0;
    const double h = 4.0 / n_steps;
    cotree_dopri5 d;
    int i, j;
    cotree_dopri5_init(&d, 2, oscillator, NULL, 0.0, y0, 0.5, 1e6, workspace);
    d.step = h;
    for (i = 0; i < n_steps; ++i) {
        cotree_dopri5_step(&d, (i + 1) * h);
        at_steps = fmax(at_steps, distance(d.t, d.y));
        for (j = 1; j < 8; ++j) {
            const double t = d.t_before + j / 8.0 * (d.t - d.t_before);
            cotree_dopri5_interpolate(&d, t, y);
            between = fmax(between, distance(t, y));
        }
    }
    printf("%ld\n%.17g\n%.17g\n", d.n_steps, at_steps, between);
}

/* Error control: errors at 1000 output points and at the end, and the work. */
static void control(double rtol)
{
    static const double y0[2] = {1.0, 0.0};
    double workspace[COTREE_DOPRI5_WORKSPACE(2)], y[2], largest = 0.0;
    cotree_dopri5 d;
    cotree_status status;
    int i = 0;
    status = cotree_dopri5_init(&d, 2, oscillator, NULL, 0.0, y0, rtol, rtol, workspace);
    while (status == COTREE_OK && d.t < 10.0) {
        status = cotree_dopri5_step(&d, 10.0);
        for (; i <= 1000 && 0.01 * i <= d.t; ++i) {
            status = cotree_dopri5_interpolate(&d, 0.01 * i, y);
            largest = fmax(largest, distance(0.01 * i, y));
        }
    }
    printf("%d\n%d\n%.17g\n%.17g\n%ld\n%ld\n%ld\n", (int)status, i, largest, distance(d.t, d.y),
           d.n_steps, d.n_rejected, d.n_evaluations);
}

/* There and back again, by way of many goals; the steps, compared with those of one goal. */
static void goals(void)
{
    static const double y0[2] = {1.0, 0.0};
    double workspace[COTREE_DOPRI5_WORKSPACE(2)], other_workspace[COTREE_DOPRI5_WORKSPACE(2)];
    cotree_dopri5 d, other;
    int i;
    cotree_dopri5_init(&d, 2, oscillator, NULL, 0.0, y0, 1e-9, 1e-9, workspace);
    cotree_dopri5_init(&other, 2, oscillator, NULL, 0.0, y0, 1e-9, 1e-9, other_workspace);
    for (i = 1; i <= 10; ++i) { /* two integrations by turns */
        cotree_dopri5_integrate(&d, i);
        cotree_dopri5_integrate(&other, i == 10 ? 10.0 : 0.01 * i);
    }
    printf("%.17g\n%.17g\n%ld\n%ld\n", d.t, distance(d.t, d.y), d.n_steps, other.n_steps);
    cotree_dopri5_integrate(&d, 0.0);
    printf("%.17g\n%.17g\n", d.t, distance(d.t, d.y));
}

static void fail(double t, int result, double size, double step)
{
    struct trap trap;
    double y = 1.0, workspace[COTREE_DOPRI5_WORKSPACE(1)];
    cotree_dopri5 d;
    cotree_status status;
    trap.t = t;
    trap.result = result;
    trap.size = size;
    cotree_dopri5_init(&d, 1, decay, &trap, 0.0, &y, 1e-6, 1e-6, workspace);
    d.step = step;
    status = cotree_dopri5_integrate(&d, 1.0);
    printf("%d\n%.17g\n%.17g\n", (int)status, d.t, fabs(d.y[0] - exp(-100.0 * d.t)));
    /* The last good point can be asked for, and nothing else; a second attempt ends alike. */
    printf("%d\n", (int)cotree_dopri5_interpolate(&d, d.t, &y));
    printf("%d\n", (int)cotree_dopri5_interpolate(&d, d.t + 1.0, &y));
    printf("%d\n", (int)cotree_dopri5_integrate(&d, 1.0));
    puts(cotree_status_message(status));
}

static void limits(void)
{
    static const double y0[2] = {1.0, 0.0};
    double bad[2], workspace[COTREE_DOPRI5_WORKSPACE(2)], y[2];
    const double nan = strtod("nan", NULL), inf = strtod("inf", NULL);
    cotree_dopri5 d;
    bad[0] = 1.0;
    bad[1] = nan;
    printf("%d\n", (int)cotree_dopri5_init(&d, -1, oscillator, NULL, 0.0, y0, 1e-6, 0.0, workspace));
    printf("%d\n", (int)cotree_dopri5_init(&d, 2, oscillator, NULL, nan, y0, 1e-6, 0.0, workspace));
    printf("%d\n", (int)cotree_dopri5_init(&d, 2, oscillator, NULL, 0.0, y0, -1.0, 0.0, workspace));
    printf("%d\n", (int)cotree_dopri5_init(&d, 2, oscillator, NULL, 0.0, y0, 1.0, 0.0, workspace));
    printf("%d\n", (int)cotree_dopri5_init(&d, 2, oscillator, NULL, 0.0, y0, 1e-6, nan, workspace));
    printf("%d\n", (int)cotree_dopri5_init(&d, 2, oscillator, NULL, 0.0, bad, 1e-6, 0.0, workspace));
    printf("%d\n", (int)cotree_dopri5_init(&d, 2, oscillator, NULL, 0.0, y0, 1e-6, 0.0, workspace));
    printf("%d\n", (int)cotree_dopri5_integrate(&d, inf));
    printf("%d\n", (int)cotree_dopri5_integrate(&d, nan));
    printf("%d\n", (int)cotree_dopri5_interpolate(&d, 0.0, y)); /* before any step */
    printf("%d\n", (int)cotree_dopri5_integrate(&d, 0.0));      /* nothing to do */
    printf("%d\n", (int)d.n_evaluations);
    d.max_steps = 5;
    printf("%d\n", (int)cotree_dopri5_integrate(&d, 10.0));
    printf("%ld\n", d.n_steps + d.n_rejected);
    d.max_steps = 1000; /* goes on from there */
    printf("%d\n", (int)cotree_dopri5_integrate(&d, 10.0));
    printf("%.17g\n", distance(d.t, d.y));
    d.max_step = 0.125;
    d.max_steps = 1000 + d.n_steps;
    d.n_steps = 0;
    printf("%d\n", (int)cotree_dopri5_integrate(&d, 20.0));
    printf("%ld\n", d.n_steps);
}

/* A projected solution: drift, error and work; how far what is interpolated is from both ends. */
static void project(int is_held)
{
    static const double y0[2] = {1.1, 0.0};
    double workspace[COTREE_DOPRI5_WORKSPACE(2)], y[2], dy[2], drift = 0.0, gap = 0.0, slope = 0.0;
    struct circle circle;
    cotree_dopri5 d;
    cotree_status status;
    circle.result = -1;
    circle.n_projections = 0;
    status = cotree_dopri5_init(&d, 2, turn, &circle, 0.0, y0, 1e-5, 1e-5, workspace);
    if (is_held) d.project = hold;
    while (status == COTREE_OK && d.t < 3.0) {
        status = cotree_dopri5_step(&d, 3.0);
        drift = fmax(drift, fabs(hypot(d.y[0], d.y[1]) - 1.0));
        cotree_dopri5_interpolate(&d, d.t, y);
        gap = fmax(gap, hypot(y[0] - d.y[0], y[1] - d.y[1]));
        /* The first rate of the next step. */
        turn(d.t, d.y, dy, NULL);
        slope = fmax(slope, hypot(dy[0] - d.stages[COTREE_DOPRI5_STAGES - 1][0],
                                  dy[1] - d.stages[COTREE_DOPRI5_STAGES - 1][1]));
    }
    printf("%d\n%.17g\n%.17g\n%.17g\n", (int)status, drift, gap, slope);
    /* The angle at t is t + t^2 / 2. */
    printf("%.17g\n", hypot(d.y[0] - cos(7.5), d.y[1] - sin(7.5)));
    printf("%ld\n%ld\n%d\n", d.n_steps, d.n_rejected, circle.n_projections);
    printf("%ld\n", d.n_evaluations);
}

static void fail_to_project(double t, int result)
{
    static const double y0[2] = {1.0, 0.0};
    double workspace[COTREE_DOPRI5_WORKSPACE(2)];
    struct circle circle;
    cotree_dopri5 d;
    cotree_status status;
    circle.result = result;
    circle.n_projections = 0;
    cotree_dopri5_init(&d, 2, turn, &circle, t, y0, 1e-6, 1e-6, workspace);
    d.project = hold;
    status = cotree_dopri5_integrate(&d, 1.0);
    printf("%d\n%.17g\n%.17g\n", (int)status, d.t, hypot(d.y[0], d.y[1]));
    printf("%d\n", (int)cotree_dopri5_integrate(&d, 1.0));
    puts(cotree_status_message(status));
}

/* No equations at all, and one whose solution ends at t = 1. */
static void extremes(void)
{
    static const double one = 1.0;
    double workspace[COTREE_DOPRI5_WORKSPACE(1)];
    cotree_dopri5 d;
    cotree_dopri5_init(&d, 0, nothing, NULL, 0.0, NULL, 1e-6, 1e-6, workspace);
    printf("%d\n", (int)cotree_dopri5_integrate(&d, 10.0));
    printf("%.17g\n", d.t);
    cotree_dopri5_init(&d, 1, square, NULL, 0.0, &one, 1e-6, 1e-6, workspace);
    printf("%d\n", (int)cotree_dopri5_integrate(&d, 2.0));
    printf("%.17g\n", d.t);
}

int main(int argc, char **argv)
{
    const char *const name = argc > 1 ? argv[1] : "";
    if (strcmp(name, "order") == 0) order(atoi(argv[2]));
    if (strcmp(name, "control") == 0) control(atof(argv[2]));
    if (strcmp(name, "goals") == 0) goals();
    if (strcmp(name, "limits") == 0) limits();
    if (strcmp(name, "project") == 0) project(atoi(argv[2]));
    if (strcmp(name, "fail_to_project") == 0) fail_to_project(atof(argv[2]), atoi(argv[3]));
    if (strcmp(name, "extremes") == 0) extremes();
    if (strcmp(name, "fail") == 0) fail(atof(argv[2]), atoi(argv[3]), atof(argv[4]), atof(argv[5]));
    return 0;
}
