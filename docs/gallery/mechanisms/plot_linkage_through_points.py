"""
A linkage through three points
==============================

A point on the coupler of a four-bar linkage must pass through three given points at given times.
The crank turns at a constant speed, and the linkage should be as light as possible.
``cotree.optimise`` chooses seven lengths and angles. They satisfy six conditions exactly, and the
remaining degree of freedom minimises the lengths of the bars. The gradients are sensitivities of
the closed loop. If the linkage cannot be assembled with certain lengths, the optimiser takes a
shorter step.
"""

import matplotlib.pyplot as plt
import numpy as np

import cotree

z = [0, 0, 1]
scene = cotree.Scene("path", gravity=[0, -9.81, 0])
start = {"a": 1.0, "b": 2.2, "c": 2.0, "d": 2.5, "u": 1.1, "v": 0.9, "phase": 0.6}
for name, value in start.items():
    scene.parameter(name, value)
scene.edge("base", "arm", "ground", "D", vector=["d", 0, 0])
scene.edge("pin1", "revolute", "ground", "A", axis=z, motion="phase + t")  # 1 rad/s
scene.edge("crank", "arm", "A", "B", vector=["a", 0, 0])
scene.edge("pin2", "revolute", "B", "B2", axis=z)
scene.edge("coupler", "arm", "B2", "C", vector=["b", 0, 0])
scene.edge("rib", "arm", "B2", "P", vector=["u", "v", 0])  # the guided point
scene.edge("pin4", "revolute", "D", "D2", axis=z)
scene.edge("rocker", "arm", "D2", "C2", vector=[0, "c", 0])
scene.edge("pin3", "revolute", "C", "C2", axis=z)  # closes the loop
for node in ("B", "C", "C2"):
    scene.edge(f"m{node}", "rigid_body", "ground", node, mass=1.0, inertia=0.1)
scene.output("x", "P.x")
scene.output("y", "P.y")

points = {0.5: (1.2, 2.0), 1.5: (0.4, 2.0), 2.5: (-0.3, 1.5)}  # by time [s], in metres
through = [
    f"at({t}, {name}) == {value}"
    for t, place in points.items()
    for name, value in zip("xy", place, strict=True)
]
over = {
    "a": (0.3, 2),
    "b": (1, 4),
    "c": (1, 4),
    "d": (1, 4),
    "u": (0, 3),
    "v": (0, 2),
    "phase": (-1, 2),
}
found = cotree.optimise(scene, "a + b + c", over, through, t_span=(0, 6.3))
print(found.summary())

t = np.linspace(0, 6.3, 600)
fig, ax = plt.subplots(figsize=(6, 4))
for values, style, label in (
    (start, {"ls": "--", "color": "gray"}, "before"),
    (found.parameters, {"color": "tab:blue"}, "optimised"),
):
    run = scene.compile().simulate((0, 6.3), t, parameters=values)
    ax.plot(run["x"], run["y"], label=label, **style)
ax.plot(*np.transpose(list(points.values())), "o", color="tab:red", label="given points")
for (time, place), side in zip(points.items(), ("left", "right", "right"), strict=True):
    apart = (6 if side == "left" else -6, 6)
    ax.annotate(f"{time} s", place, xytext=apart, textcoords="offset points", ha=side)
ax.set(xlabel="x [m]", ylabel="y [m]", aspect="equal")
ax.legend()
plt.show()

# %%
# A run whose output times are the three given times shows the distances from the points.
check = found.model.simulate((0, 2.5), sorted(points), parameters=found.parameters)
missed = max(
    abs(check[name] - [points[t][i] for t in sorted(points)]).max() for i, name in enumerate("xy")
)
print(f"largest distance along an axis: {missed:.1e} m")
assert found.success
assert missed < 1e-6
