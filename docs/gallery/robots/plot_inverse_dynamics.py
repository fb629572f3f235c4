"""
Inverse dynamics of an arm
==========================

If a joint has a prescribed ``motion``, its output ``drive`` is the force or torque that the motion
requires. The inverse dynamics of an arm is therefore a scene without states, and no integration is
needed.
"""

import matplotlib.pyplot as plt
import numpy as np

import cotree

L1, L2, m1, m2, g = 0.5, 0.4, 2.0, 1.0, 9.81
swing = {"q1": "0.8*sin(2*t)", "q2": "0.5 - 0.9*cos(3*t)"}

scene = cotree.Scene("inverse-dynamics", gravity=[0, -g, 0])
z = [0, 0, 1]
scene.edge("q1", "revolute", "ground", "A", axis=z, motion=swing["q1"])
scene.edge("l1", "arm", "A", "B", vector=[L1, 0, 0])
scene.edge("p1", "rigid_body", "ground", "B", mass=m1)
scene.edge("q2", "revolute", "B", "C", axis=z, motion=swing["q2"])
scene.edge("l2", "arm", "C", "D", vector=[L2, 0, 0])
scene.edge("p2", "rigid_body", "ground", "D", mass=m2)
scene.output("shoulder", "q1.drive")
scene.output("elbow", "q2.drive")
t = np.linspace(0, 6, 601)
result = scene.compile().simulate((0, 6), t)

for name in ("shoulder", "elbow"):
    plt.plot(t, result[name], label=name)
plt.xlabel("time [s]")
plt.ylabel("torque of the drive [N m]")
plt.legend(loc="lower right", bbox_to_anchor=(1, 1), ncols=2)
plt.show()

# %%
# J. Craig, *Introduction to Robotics*, Eq. 6.58, gives the torques of an arm with two point masses
# in closed form. Both sides consist of a few tens of operations on numbers up to 30 N m, so only
# rounding errors remain.
q1, dq1, ddq1 = 0.8 * np.sin(2 * t), 1.6 * np.cos(2 * t), -3.2 * np.sin(2 * t)
q2, dq2, ddq2 = 0.5 - 0.9 * np.cos(3 * t), 2.7 * np.sin(3 * t), 8.1 * np.cos(3 * t)
elbow = m2 * L2**2 * (ddq1 + ddq2) + m2 * L1 * L2 * np.cos(q2) * ddq1
elbow += m2 * L1 * L2 * np.sin(q2) * dq1**2 + m2 * L2 * g * np.cos(q1 + q2)
shoulder = m2 * L2**2 * (ddq1 + ddq2) + m2 * L1 * L2 * np.cos(q2) * (2 * ddq1 + ddq2)
shoulder += (m1 + m2) * L1**2 * ddq1 - m2 * L1 * L2 * np.sin(q2) * (dq2**2 + 2 * dq1 * dq2)
shoulder += m2 * L2 * g * np.cos(q1 + q2) + (m1 + m2) * L1 * g * np.cos(q1)
error = max(np.max(np.abs(result["shoulder"] - shoulder)), np.max(np.abs(result["elbow"] - elbow)))
print(f"largest torque {np.max(np.abs(shoulder)):.4f} N m, largest difference {error:.1e} N m")
assert error < 1e-12
