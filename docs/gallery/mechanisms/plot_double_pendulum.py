"""
Double pendulum
===============

The motion of a double pendulum is chaotic and cannot be predicted for long, but its energy is
constant. The remaining change of the energy measures the accuracy of the integration.
"""

import matplotlib.pyplot as plt
import numpy as np

import cotree

scene = cotree.Scene("double-pendulum", gravity=[0, -9.81, 0])
z = [0, 0, 1]
scene.edge("h1", "revolute", "ground", "A", axis=z, initial={"theta": 2.0})
scene.edge("r1", "arm", "A", "B", vector=[0, -1.0, 0])
scene.edge("m1", "rigid_body", "ground", "B", mass=1.0)
scene.edge("h2", "revolute", "B", "C", axis=z, initial={"theta": 0.6})
scene.edge("r2", "arm", "C", "D", vector=[0, -0.8, 0])
scene.edge("m2", "rigid_body", "ground", "D", mass=0.7)
scene.output("x", "D.x")
scene.output("y", "D.y")
scene.output("energy", "energy.kinetic + energy.potential")

t = np.linspace(0, 12, 3001)
result = scene.compile().simulate((0, 12), t, method="dop853", rtol=1e-11, atol=1e-12)

plt.figure(figsize=(5.2, 4.6))
plt.scatter(result["x"], result["y"], c=t, s=2, cmap="viridis")
plt.colorbar(label="time [s]")
plt.plot(0, 0, "k+", ms=9)
plt.axis("equal")
plt.xlabel("x of the tip [m]")
plt.ylabel("y of the tip [m]")
plt.show()

# %%
# Without dampers the energy is conserved. The error of each step is at most 1e-11 of the states,
# which reach 10 rad/s; several hundred steps change the energy by less than 1e-7 J.
drift = np.max(np.abs(result["energy"] - result["energy"][0]))
print(f"energy {result['energy'][0]:.6f} J, largest change {drift:.1e} J")
assert drift < 1e-7
