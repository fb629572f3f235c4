"""
Fixed steps for a microcontroller
=================================

Real-time systems need a known computation time and therefore fixed steps. ``write`` can export the
classical Runge-Kutta method with fixed steps. This example compiles it for four step sizes and
measures the error.
"""

import shlex
import subprocess
from pathlib import Path
from tempfile import TemporaryDirectory

import matplotlib.pyplot as plt
import numpy as np

import cotree

scene = cotree.Scene("oscillator")
scene.edge("j", "prismatic", "ground", "A", axis=[1, 0, 0], stiffness=9.0, initial={"s": 1.0})
scene.edge("body", "rigid_body", "ground", "A", mass=1.0)
scene.simulation(t_end=4.0)
model = scene.compile()

steps = 0.1 / 2.0 ** np.arange(4)
errors = []
for step in steps:
    with TemporaryDirectory() as folder:
        project = model.write(folder, integrator="rk4", step=float(step))
        quickly = project.command.replace("-O2", "-O0")  # it is compiled four times here
        subprocess.run(shlex.split(quickly), cwd=folder, check=True)
        program = Path(folder, "oscillator")
        done = subprocess.run([program], check=True, capture_output=True, text=True)
    end = dict(line.split(" = ") for line in done.stdout.splitlines())
    errors.append(abs(float(end["j.s"]) - np.cos(3 * 4.0)))

plt.loglog(steps, errors, "o-", mfc="none", label="compiled C")
plt.loglog(steps, errors[-1] * (steps / steps[-1]) ** 4, "--", color="0.5", lw=1, label="order 4")
plt.minorticks_off()
plt.xticks(steps, [f"{step:g}" for step in steps])
plt.xlabel("length of a step [s]")
plt.ylabel("error at the end [m]")
plt.legend()
plt.show()

# %%
# The exact motion is a cosine. The method has order four (W. Kutta, 1901). If the step is halved,
# the error decreases by a factor of 16, up to terms of higher order.
order = np.log2(errors[-2] / errors[-1])
print(f"order {order:.3f}, theory 4")
assert abs(order - 4) < 0.1
