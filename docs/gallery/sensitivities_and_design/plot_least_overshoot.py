"""
Damper with the smallest overshoot
==================================

A car drives onto a step. With a weak damper the body oscillates on the suspension. With a strong
damper it oscillates on the tyre, which has little damping. A damper between these extremes gives
the smallest overshoot. The objective ``maximum(...)`` is the peak over time. Its derivative is the
sensitivity at the time of the peak.
"""

import matplotlib.pyplot as plt
import numpy as np

import cotree

h = 0.05  # height of the step [m]; positions count from the upper level
scene = cotree.Scene("quarter-car")
scene.parameter("c", 500.0, unit="N s/m")
scene.edge("body", "translational_mass", "ground", "B", mass=300.0)
scene.edge("wheel", "translational_mass", "ground", "W", mass=40.0)
scene.edge("tyre", "translational_spring", "ground", "W", stiffness=1.5e5, initial={"s": -h})
scene.edge("spring", "translational_spring", "W", "B", stiffness=2e4)
scene.edge("damper", "translational_damper", "W", "B", damping="c")
scene.output("x", f"{h} + tyre.s + spring.s")
found = cotree.optimise(scene, "maximum(x)", {"c": (300, 2e4, "log")}, t_span=(0, 1.5))
print(found.summary())

t, model = np.linspace(0, 1.5, 401), scene.compile()
fig, (left, right) = plt.subplots(1, 2, figsize=(9, 3.6), layout="constrained")
for c in (500.0, found["c"], 1e4):
    left.plot(t, model.simulate((0, 1.5), t, parameters={"c": c})["x"], label=f"{c:.0f} N s/m")
left.axhline(h, color="gray", lw=0.8)
left.set(xlabel="t [s]", ylabel="height of the body [m]")
left.legend()
grid = np.geomspace(300, 2e4, 60)
peaks = model.ensemble((0, 1.5), cotree.grid(c=grid), t_eval=t, outputs=["x"])["x"].max("time")
right.semilogx(grid, peaks, label="scan")
tried = [(row.parameters["c"], row.objective) for row in found.history]
right.plot(*np.transpose(tried), "o", ms=4, color="tab:red", label="points that were tried")
right.set(xlabel="damping [N s/m]", ylabel="highest position [m]")
right.legend()
plt.show()


# %%
# For comparison, the linear equations are solved by eigenvectors for a fine grid of dampings. The
# minimum is at the same value.
def peak(c, mb=300.0, mw=40.0, kt=1.5e5, ks=2e4):
    """Return the highest position of the body on a step at t = 0."""
    k = np.array([[ks / mb, -ks / mb], [-ks / mw, (ks + kt) / mw]])
    d = c * np.array([[1 / mb, -1 / mb], [-1 / mw, 1 / mw]])
    values, vectors = np.linalg.eig(np.block([[np.zeros((2, 2)), np.eye(2)], [-k, -d]]))
    weights = vectors[0] * np.linalg.solve(vectors, [-h, -h, 0, 0])
    fine = np.linspace(0, 1.5, 30001)
    return h + (weights * np.exp(np.outer(fine, values))).sum(axis=1).real.max()


fine = found["c"] * np.linspace(0.99, 1.01, 201)
best = fine[np.argmin([peak(c) for c in fine])]
print(
    f"c = {found['c']:.2f} N s/m, by the scan {best:.2f}, overshoot {found.objective / h - 1:.2%}"
)
assert found.success
assert abs(found["c"] - best) < 2e-4 * best
assert abs(found.objective - peak(found["c"])) < 1e-8
