"""
A C project without Python
==========================

A typical task in embedded programming is to export a model as C, build it with a C99 compiler, run
it and compare its results with those of Python. The kernels of the model allocate no memory and
keep no state.
"""

import shlex
import subprocess
from pathlib import Path
from tempfile import TemporaryDirectory

import matplotlib.pyplot as plt
import numpy as np

import cotree

scene = cotree.load("slider-pendulum")
model = scene.compile(["L"])


def values(program: Path, t_end: float) -> dict[str, float]:
    """Run the program up to a time, and read the lines ``name = value`` that it prints."""
    done = subprocess.run([program, repr(t_end)], check=True, capture_output=True, text=True)
    return {name: float(value) for name, _, value in map(str.split, done.stdout.splitlines())}


t = np.linspace(0.5, 10, 20)
with TemporaryDirectory() as folder:
    project = model.write(folder, integrator="dopri5")
    print("files:  ", *sorted(file.name for file in project.files))
    print("command:", project.command)
    subprocess.run(shlex.split(project.command), cwd=folder, check=True)
    ends = [values(Path(folder, "slider_pendulum"), float(end)) for end in t]
print("prints: ", *ends[-1])

# %%
# Python runs the same method with the same tolerances.
result = model.simulate((0, 10), np.linspace(0, 10, 801), method="dopri5", rtol=1e-8, atol=1e-10)
last = model.simulate((0, 10), method="dopri5", rtol=1e-8, atol=1e-10)
for name, label in (("j1.s", "s [m]"), ("d(j1.s)/d(L)", "∂s/∂L [m/m]")):
    (line,) = plt.plot(result.t, result.columns()[name], label=label)
    plt.plot(t, [end[name] for end in ends], "o", ms=5, mfc="none", c=line.get_color())
plt.plot([], [], "o", ms=5, mfc="none", c="0.3", label="C program")
plt.xlabel("time [s]")
plt.ylabel("position and its sensitivity")
plt.legend(loc="lower right", bbox_to_anchor=(1, 1), ncols=3)
plt.show()

# %%
# Both programs take the same steps. The C program prints twelve digits, and all of them are
# compared.
error = max(abs(last.columns()[name][-1] - ends[-1][name]) for name in ("j1.s", "d(j1.s)/d(L)"))
print(f"largest difference at the end {error:.1e}")
assert error < 1e-11
