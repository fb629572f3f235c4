/* An own loop around a generated model: the classical Runge-Kutta method up to two seconds, with
 * another length of the rod. It is built in double and in single precision, for this machine and
 * for a microcontroller. */
#include "slider_pendulum.h"

#include <stddef.h>
#include <stdio.h>

enum { N = SLIDER_PENDULUM_N_STATES, STEPS = 2000 };

static cotree_real p[] = SLIDER_PENDULUM_DEFAULTS;
static cotree_real k[SLIDER_PENDULUM_N_PREPARED];

static const cotree_real h = (cotree_real)2 / STEPS;

/* Takes a part of a step along a slope, and the slope where it ends. */
static int stage(cotree_real t, const cotree_real *x, cotree_real part, const cotree_real *slope,
                 cotree_real *next)
{
    cotree_real at[N];
    int i;
    for (i = 0; i < N; ++i) at[i] = x[i] + part * slope[i];
    return slider_pendulum_rhs(t + part, at, NULL, p, k, next);
}

static int step(cotree_real t, cotree_real *x)
{
    cotree_real a[N], b[N], c[N], d[N];
    int i, status = slider_pendulum_rhs(t, x, NULL, p, k, a);
    if (status == 0) status = stage(t, x, h / 2, a, b);
    if (status == 0) status = stage(t, x, h / 2, b, c);
    if (status == 0) status = stage(t, x, h, c, d);
    for (i = 0; i < N; ++i) x[i] += h / 6 * (a[i] + 2 * b[i] + 2 * c[i] + d[i]);
    return status;
}

int main(void)
{
    cotree_real x[N];
    int i;
    p[SLIDER_PENDULUM_PARAMETER_L] = (cotree_real)1.25;
    if (slider_pendulum_prepare(p, k) != 0) return 1;
    if (slider_pendulum_initial(p, k, x) != 0) return 1;
    for (i = 0; i < STEPS; ++i) {
        if (step((cotree_real)i * h, x) != 0) return 1;
    }
    printf("s = %.15g\n", (double)x[SLIDER_PENDULUM_STATE_j1_s]);
    printf("theta = %.15g\n", (double)x[SLIDER_PENDULUM_STATE_h2_theta]);
    return 0;
}
