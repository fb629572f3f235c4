"""
Shuffle of a drive line
=======================

A sudden increase of the engine torque twists the half shafts. The car then oscillates against the
engine, which is called shuffle. The part ``drive-line`` contains all components from the flywheel
to the road.
"""

import matplotlib.pyplot as plt
import numpy as np

import cotree

scene = cotree.Scene("car")
scene.parameter("m", 1350.0, unit="kg")
scene.parameter("T", 120.0, unit="N m")
scene.add("line", "drive-line", engine="crank", vehicle="road")
scene.edge("car", "translational_mass", "ground", "road", mass="m")
scene.edge("engine", "torque_source", "ground", "crank", torque="T")
scene.output("speed", "road.v")

model = scene.compile(["line.k_shaft", "line.d_shaft"])
print(scene.summary())
t = np.linspace(0, 2.0, 500)
result = model.simulate((0, 2.0), t, rtol=1e-9)

fig, (left, right) = plt.subplots(1, 2, figsize=(9, 3.6))
left.plot(t, abs(result["line.shaft_torque"]), label="half shafts")
left.plot(t, 12.5 * abs(result["line.clutch_torque"]), label="clutch, times the ratio")
left.set(xlabel="time [s]", ylabel="torque [N m]")
left.legend()
right.plot(t, result["speed"], label="speed [m/s]")
right.plot(
    t, 1e4 * result.sensitivity("speed", "line.k_shaft"), label="by the stiffness, 1e4 times"
)
right.set(xlabel="time [s]")
right.legend()
plt.show()

# %%
# After the oscillation has decayed, all inertias rotate together, and the torque at the wheel
# accelerates their total mass.
ratio, radius, T = 12.5, 0.31, 120.0
mass = 1350.0 + (2.4 + ratio**2 * (0.18 + 0.012)) / radius**2
late = model.simulate((0, 10.0), [9.0, 10.0], rtol=1e-9)["speed"]
print(f"acceleration {late[1] - late[0]:.6f} m/s^2, in theory {T * ratio / radius / mass:.6f}")
assert abs(late[1] - late[0] - T * ratio / radius / mass) < 1e-5
