/* Prints the largest errors of rodas4 at the ends of steps and between, on x'' = -x and its
 * sensitivity to the square of the frequency. */
#include "cotree_rodas4.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>

static int rate(double t, const double *z, double *dz, void *context)
{
    (void)t;
    (void)context;
    dz[0] = z[1];
    dz[1] = -z[0];
    dz[2] = z[3];
    dz[3] = -z[2] - z[0];
    return 0;
}

static int linearise(double t, const double *z, void *context)
{
    (void)t;
    (void)z;
    (void)context;
    return 0; /* derivatives are constant */
}

static int factorise(double shift, void *context)
{
    *(double *)context = shift;
    return 0;
}

/* (shift - J) x = b, J = [0 1; -1 0] */
static void solve_block(double shift, double *b)
{
    const double size = shift * shift + 1.0, first = (shift * b[0] + b[1]) / size;
    b[1] = (shift * b[1] - b[0]) / size;
    b[0] = first;
}

static int solve(double *u, void *context)
{
    const double shift = *(double *)context;
    solve_block(shift, u);
    u[3] -= u[0]; /* the sensitivity's rate depends on the state */
    solve_block(shift, u + 2);
    return 0;
}

static double distance(double t, const double *z)
{
    return fmax(fabs(z[0] - cos(t)), fabs(z[2] + 0.5 * t * sin(t)));
}

int main(int argc, char **argv)
{
    static double workspace[COTREE_RODAS4_WORKSPACE(4)], shift;
    const cotree_implicit_equation equation = {4,         0,     NULL, 1,    rate,  NULL, linearise,
                                               factorise, solve, NULL, NULL, &shift};
    static const double start[4] = {1.0, 0.0, 0.0, 0.0};
    const double rtol = argc > 1 ? atof(argv[1]) : 1e-6;
    double z[4], at_ends = 0.0, between = 0.0;
    cotree_rodas4 d;
    cotree_status status = cotree_rodas4_init(&d, equation, 0.0, start, rtol, rtol, workspace);
    while (status == COTREE_OK && d.t < 5.0) {
        int i;
        status = cotree_rodas4_step(&d, 5.0);
        at_ends = fmax(at_ends, distance(d.t, d.y));
        for (i = 0; i <= 4; ++i) {
            const double t = d.t_before + 0.25 * i * (d.t - d.t_before);
            if (cotree_rodas4_interpolate(&d, i < 4 ? t : d.t, z) != COTREE_OK) return EXIT_FAILURE;
            between = fmax(between, distance(i < 4 ? t : d.t, z));
        }
    }
    printf("%d %.17g %.17g\n", (int)status, at_ends, between);
    printf("%d\n", (int)cotree_rodas4_interpolate(&d, d.t + 1.0, z));
    return EXIT_SUCCESS;
}
