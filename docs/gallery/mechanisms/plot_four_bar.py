"""
Four-bar linkage and its coupler curve
======================================

Three bars and the ground form a closed loop. The tree contains three of the four pins. Multipliers
and projection enforce the two constraints of the fourth pin. The figure shows the path of a point
of the coupler.
"""

import math

import matplotlib.pyplot as plt
import numpy as np

import cotree

a, b, c, d = 1.0, 2.2, 2.0, 2.5  # crank, coupler, rocker, base [m]
z = [0, 0, 1]
scene = cotree.Scene("four-bar", gravity=[0, -9.81, 0])
scene.edge("base", "arm", "ground", "D", vector=[d, 0, 0])
scene.edge("pin1", "revolute", "ground", "A", axis=z, initial={"theta": 1.0, "theta_dot": 5.0})
scene.edge("crank", "arm", "A", "B", vector=[a, 0, 0])
scene.edge("pin2", "revolute", "B", "B2", axis=z)
scene.edge("coupler", "arm", "B2", "C", vector=[b, 0, 0])
scene.edge("rib", "arm", "B2", "P", vector=[b / 2, 0.9, 0])  # the point whose path is drawn
scene.edge("pin4", "revolute", "D", "D2", axis=z)
scene.edge("rocker", "arm", "D2", "C2", vector=[0, c, 0])  # upright at zero
scene.edge("pin3", "revolute", "C", "C2", axis=z)  # closes the loop
for node in ("B", "C", "C2"):
    scene.edge(f"m{node}", "rigid_body", "ground", node, mass=1.0, inertia=0.1)
scene.output("x", "P.x")
scene.output("y", "P.y")

t = np.linspace(0, 3, 1501)
result = scene.compile().simulate((0, 3), t, rtol=1e-10, atol=1e-12)

fig, (left, right) = plt.subplots(1, 2, figsize=(9, 3.8))
left.plot(result["x"], result["y"], label="coupler point")
crank, rocker = result["pin1.theta"], result["pin4.theta"] + math.pi / 2
left.plot(a * np.cos(crank), a * np.sin(crank), lw=1, label="crank")
left.plot(d + c * np.cos(rocker), c * np.sin(rocker), lw=1, label="rocker")
left.set(xlabel="x [m]", ylabel="y [m]", aspect="equal")
left.legend(loc="upper center", bbox_to_anchor=(0.5, 1.16), ncols=3, fontsize=9)
right.plot(np.degrees(crank), np.degrees(rocker))
right.set(xlabel="angle of the crank [deg]", ylabel="angle of the rocker [deg]")
plt.show()

# %%
# Freudenstein's equation gives the angle of the rocker as a function of the crank angle in closed
# form (R. L. Norton, *Design of Machinery*, Eq. 4.10). Projection keeps the loop closed, so both
# sides differ by rounding errors only.
k1, k2, k3 = d / a, d / c, (a**2 - b**2 + c**2 + d**2) / (2 * a * c)
p = np.cos(crank) - k1 - k2 * np.cos(crank) + k3
q = -2 * np.sin(crank)
s = k1 - (k2 + 1) * np.cos(crank) + k3
freudenstein = 2 * np.arctan2(-q - np.sqrt(q**2 - 4 * p * s), 2 * p)
error = np.max(np.abs(np.sin((rocker - freudenstein) / 2)))
print(f"largest difference {2 * error:.1e} rad over {crank[-1] / (2 * math.pi):.1f} turns")
assert error < 1e-10
