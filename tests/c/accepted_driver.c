/* Steps of rodas5 with a model that has algebraic unknowns: how far each accepted point is from solving
 * their equations, and the equations of their sensitivities. */
#include "bridge_rectifier.h"
#include "bridge_rectifier_newton.h"
#include "cotree_rodas5.h"
#include "cotree_stiff.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>

#define N BRIDGE_RECTIFIER_N_STATES
#define N_PACKED (N * (1 + BRIDGE_RECTIFIER_N_SENSITIVITIES))

static REAL p[BRIDGE_RECTIFIER_N_PARAMETERS], k[BRIDGE_RECTIFIER_N_PREPARED + 1];
static REAL u[BRIDGE_RECTIFIER_N_INPUTS + 1];
static cotree_run run;
static cotree_stiff stiff;

static void set_up(cotree_arena *arena)
{
    cotree_run_init(&run, bridge_rectifier_abi(), p, k, u, 1, arena);
    cotree_stiff_init(&stiff, &run, bridge_rectifier_newton(), arena);
}

int main(int argc, char **argv)
{
    static REAL workspace[COTREE_RODAS5_WORKSPACE(N_PACKED)], z[N_PACKED], w[N_PACKED];
    const REAL rtol = argc > 1 ? (REAL)atof(argv[1]) : (REAL)1e-6;
    REAL of_states = 0, of_sensitivities = 0;
    cotree_arena arena = {NULL, 0};
    cotree_status status = COTREE_OK;
    cotree_rodas5 d;
    int i;
    for (i = 0; i < BRIDGE_RECTIFIER_N_PARAMETERS; ++i) p[i] = bridge_rectifier_abi()->parameter_values[i];
    if (bridge_rectifier_prepare(p, k) != 0) return 1;
    set_up(&arena);
    arena.base = (char *)calloc(1, arena.used);
    arena.used = 0;
    set_up(&arena);
    cotree_run_pack(&run, z, w);
    status = cotree_rodas5_init(&d, cotree_stiff_equation(&stiff), 0, w, rtol, rtol / 100, workspace);
    d.project = cotree_stiff_project;
    d.max_step = (REAL)6.25e-4; /* a 32nd of the source's period */
    while (status == COTREE_OK && d.t < (REAL)0.05) {
        status = cotree_rodas5_step(&d, (REAL)0.05);
        for (i = 0; i < stiff.n_algebraic && status == COTREE_OK; ++i) {
            const int place = stiff.algebraic[i];
            const REAL left = (REAL)fabs((double)cotree_rodas5_rate(&d)[place]);
            REAL *const largest = place < N ? &of_states : &of_sensitivities;
            if (!(left <= *largest)) *largest = left;
        }
    }
    printf("%d %ld %.17g %.17g %.17g\n", (int)status, d.n_steps, (double)d.t, (double)of_states,
           (double)of_sensitivities);
    free(arena.base);
    return 0;
}
