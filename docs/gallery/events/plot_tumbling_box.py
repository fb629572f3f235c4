"""
Tumbling box
============

A box is thrown onto a floor. While a corner is below the surface of the floor, a Hunt-Crossley
contact force and a friction force act on it. The box comes to rest on one of its sides.
"""

import matplotlib.pyplot as plt
import numpy as np

import cotree

g = 9.81
scene = cotree.Scene("tumbling-box", gravity=[0, -g, 0])
scene.parameter("mu", 0.35)
start = {"y": 0.5, "theta": 0.6, "x_dot": 1.2, "theta_dot": -4.0}
scene.rigid_body("box", "ground", "B", mass=1.0, inertia=0.0108, initial=start)
scene.contact(
    "floor",
    "ground",
    "B",
    normal=[0, 1, 0],
    size=[0.3, 0.2, 0],  # a plate has four corners
    stiffness=2e5,
    dissipation=1.0,
    friction="mu",
)
scene.output("force", "floor.force")
t = np.linspace(0, 3, 1501)
model = scene.compile(["mu"])
result = model.simulate((0, 3), t, rtol=1e-8)

fig, axes = plt.subplots(1, 3, figsize=(9, 3.2), width_ratios=[1, 1, 1.2], layout="compressed")
axes[0].plot(t, result["box.y"])
axes[0].set(xlim=(0, 1), xlabel="time [s]", ylabel="height of the centre [m]")
axes[1].semilogy(t, np.maximum(result["force"], 1.0))
axes[1].set(xlim=(0, 1), xlabel="time [s]", ylabel="force of the floor [N]")
axes[2].imshow(result.animate(speed=0.5).frame(12, width=600))
axes[2].axis("off")
plt.show()

# %%
# At rest the floor supports the weight. Two corners are below its surface by (m g / 2 k)^(2/3).
depth = (g / (2 * 2e5)) ** (2 / 3)
side = 0.1 if abs(np.sin(result["box.theta"][-1])) < 0.5 else 0.15
print(f"force {result['force'][-1]:.4f} N; depth {1e3 * (side - result['box.y'][-1]):.4f} mm")
assert abs(result["force"][-1] - g) < 1e-2 * g
assert abs(side - depth - result["box.y"][-1]) < 1e-5

# %%
# The final position depends on friction. Its sensitivity is exact across all impacts.
slope = result.sensitivity("box.x", "mu")[-1]
print(f"it stops at {result['box.x'][-1]:.4f} m; d(x)/d(mu) = {slope:.3f} m")

# %%
# This is the motion:
result.animate(speed=0.5)
