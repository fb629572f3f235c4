"""
Parameter map on a grid
=======================

This example computes the amplitude and the decay of the slider-pendulum's motion for a grid of
damping and stiffness values. Each cell of the grid is one run.
"""

import time

import matplotlib.pyplot as plt
import numpy as np

import cotree

model = cotree.load("slider-pendulum").compile(["k"])
grid = cotree.grid(zeta=np.linspace(0.0, 4.0, 33), k=np.geomspace(20, 500, 49))
span = {"t_eval": 401, "rtol": 1e-6, "atol": 1e-8}
model.ensemble((0, 10), {"k": [50.0]}, **span)  # compiles the model once

begun = time.perf_counter()
runs = model.ensemble((0, 10), grid, **span)
taken = time.perf_counter() - begun

fig, (left, right) = plt.subplots(1, 2, figsize=(10, 4), layout="constrained")
cotree.heat_map(runs, "h2.theta", of="max", ax=left)
cotree.heat_map(runs, "d(h2.theta)/d(k)", time=2.0, ax=right)
fig.suptitle(f"{len(grid)} members in {taken:.2f} s")
plt.show()

# %%
# The result is a Dataset of xarray. Its dimensions are the axes of the grid. The next line computes
# the amplitude of the rod in the last three seconds, relative to the largest amplitude.
later = runs["h2.theta"].where(runs["time"] > 7)
runs["swing left"] = (later.max("time") / runs["h2.theta"].max("time")).drop_attrs(deep=False)
fig = cotree.heat_map(runs, "swing left")
plt.show()

# %%
# Each cell agrees with a single run to within rounding errors.
cell = runs.sel(zeta=2.0).isel(k=24)
alone = model.simulate(
    (0, 10),
    runs["time"].values,
    runs.attrs["method"],
    1e-6,
    1e-8,
    {"zeta": 2.0, "k": float(cell["k"])},
)
apart = float(np.max(np.abs(alone["j1.s"] - cell["j1.s"].values)))
print(f"{len(grid)} members took {taken:.2f} s, {1e3 * taken / len(grid):.2f} ms each")
print(f"a cell and a single run differ by {apart:.1g} m")
assert apart < 1e-9
