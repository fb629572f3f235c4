"""
Crane with a valve signal at run time
=====================================

This example exports the shipped hydraulic crane with its sensitivity to the load and runs the C
program. Then your own program replaces the main program. It receives a sample of the valve signal
every 10 ms at run time and returns the results.
"""

import io
import shlex
import subprocess
from pathlib import Path
from tempfile import TemporaryDirectory

import matplotlib.pyplot as plt
import numpy as np

import cotree

model = cotree.load("crane").compile(["load"])
work = TemporaryDirectory()
project = model.write(work.name, integrator="rk4", step=0.001)
print(project.command)

# %%
# If you specify a number of points, the exported main program prints a table with the columns of
# ``result.to_csv``.
subprocess.run(shlex.split(project.command), cwd=work.name, check=True)
done = subprocess.run(
    [Path(work.name, "crane"), "4.0", "5"], check=True, capture_output=True, text=True
)
print("\n".join(line[:72] for line in done.stdout.splitlines()))

# %%
# This program replaces ``main.c``. It reads a sample of the valve signal from standard input, takes
# ten steps of 1 ms, and prints the height and its sensitivity. It then waits for the next sample.
# It allocates no memory.
CONTROLLER = r"""
#include "cotree_rk4.h"
#include "cotree_run.h"
#include "crane.h"
#include <stdio.h>
#include <stdlib.h>

#define N (CRANE_N_STATES * (1 + CRANE_N_SENSITIVITIES))

struct ramp { double start, from, to; }; /* of the input, over 10 ms */

static int valve(double t, double *u, void *context)
{
    const struct ramp *const r = (const struct ramp *)context;
    u[0] = r->from + (r->to - r->from) * (t - r->start) / 0.01;
    return 0;
}

int main(void)
{
    static double p[CRANE_N_PARAMETERS], k[CRANE_N_PREPARED], u[1], z[N], w[N];
    static double workspace[COTREE_RK4_WORKSPACE(N)], y[CRANE_N_OUTPUTS], dy[CRANE_N_OUTPUTS];
    static struct ramp ramp;
    static cotree_run run;
    static cotree_rk4 d;
    static cotree_arena arena;
    const cotree_model *const model = crane_abi();
    int i;
    for (i = 0; i < CRANE_N_PARAMETERS; ++i) p[i] = model->parameter_values[i];
    if (crane_prepare(p, k) != 0 || crane_initial(p, k, z) != 0) return 1;
    if (crane_initial_sensitivity(p, k, z + CRANE_N_STATES) != 0) return 1;
    cotree_run_init(&run, model, p, k, u, 1, &arena); /* counts what it needs */
    arena.base = (char *)calloc(1, arena.used);
    if (arena.base == NULL) return 1;
    arena.used = 0;
    cotree_run_init(&run, model, p, k, u, 1, &arena);
    run.input_function = valve;
    run.input_context = &ramp;
    cotree_run_narrow(&run, 0.0, z, w);
    if (cotree_rk4_init(&d, run.n, cotree_run_rate, &run, 0.0, w, 0.001, workspace) != 0) return 1;
    while (scanf("%lf", &ramp.to) == 1) {
        for (i = 0; i < 10; ++i) {
            if (cotree_rk4_step(&d) != COTREE_OK) return 1;
        }
        ramp.start = d.t;
        ramp.from = ramp.to;
        if (cotree_run_complete(&run, d.t, d.y) != 0) return 1;
        u[0] = ramp.to;
        if (crane_outputs(d.t, run.full, u, p, k, y) != 0) return 1;
        if (crane_output_sensitivity(d.t, run.full, run.full + CRANE_N_STATES, u, p, k, dy) != 0) {
            return 1;
        }
        printf("%.17g,%.17g,%.17g\n", d.t, y[0], dy[0]);
        fflush(stdout);
    }
    return 0;
}
"""
Path(work.name, "controller.c").write_text(CONTROLLER, encoding="ascii")
command = project.command.replace("main.c", "controller.c").replace("-o crane", "-o controller")
subprocess.run(shlex.split(command), cwd=work.name, check=True)

times = np.linspace(0.0, 4.0, 401)
opening = 0.8 * np.sin(np.pi * times / 4.0) ** 2  # decided at run time
samples = "\n".join(map(repr, opening[1:].tolist()))
done = subprocess.run(
    [Path(work.name, "controller")], input=samples, check=True, capture_output=True, text=True
)
t, height, by_load = np.loadtxt(io.StringIO(done.stdout), delimiter=",").T
work.cleanup()

# %%
# Python integrates the same signal with another method and a tight tolerance.
result = model.simulate(
    (0, 4), times, inputs={"valve": (times, opening)}, method="dop853", rtol=1e-11, atol=1e-12
)
figure, (top, bottom) = plt.subplots(2, 1, figsize=(7, 5), sharex=True)
top.plot(times, result["height"], label="Python")
top.plot(t[9::20], height[9::20], "o", ms=4, mfc="none", c="0.3", label="C controller")
top.plot(times, opening, lw=1, c="0.6", label="valve")
top.set_ylabel("height [m]")
top.legend(ncols=3, loc="lower right", bbox_to_anchor=(1, 1))
bottom.plot(times, 1e3 * result.sensitivity("height", "load"), c="tab:orange")
bottom.plot(t[9::20], 1e3 * by_load[9::20], "o", ms=4, mfc="none", c="0.3")
bottom.set(xlabel="time [s]", ylabel="∂ height / ∂ load [mm/kg]")
plt.show()

# %%
# The number is the largest difference between the two, relative to the largest value. With steps of
# 1 ms, there are 160 steps in each period of the oscillation of the crane on its oil column.
errors = [
    np.max(np.abs(height - result["height"][1:])) / np.max(np.abs(height)),
    np.max(np.abs(by_load - result.sensitivity("height", "load")[1:])) / np.max(np.abs(by_load)),
]
print(f"height {errors[0]:.1e}, sensitivity {errors[1]:.1e}")
assert max(errors) < 1e-7
