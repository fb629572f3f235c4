"""
Period of a pendulum at large amplitude
=======================================

The period of a pendulum increases with its amplitude. Events locate the turning points. The period
is therefore as accurate as the integration, independent of the spacing of stored points.
"""

import math

import matplotlib.pyplot as plt
import numpy as np
from scipy.special import ellipk

import cotree

scene = cotree.Scene("pendulum", gravity=[0, -9.81, 0])
scene.parameter("theta0", math.pi / 2, unit="rad")
scene.edge("h", "revolute", "ground", "A", axis=[0, 0, 1], initial={"theta": "theta0"})
scene.edge("rod", "arm", "A", "B", vector=[0, -1.0, 0])
scene.edge("bob", "rigid_body", "ground", "B", mass=1.0)
scene.event("turns", "h.theta_dot", direction=1)
model = scene.compile()

# %%
# The closed form is a complete elliptic integral of the first kind.
amplitudes = np.radians(np.arange(10, 171, 10))
periods = []
for amplitude in amplitudes:
    result = model.simulate((0, 10), rtol=1e-11, atol=1e-12, parameters={"theta0": amplitude})
    first, second = result.events["turns"].t[:2]
    periods.append(second - first)
small = 2 * math.pi / math.sqrt(9.81)
exact = small * 2 / math.pi * ellipk(np.sin(amplitudes / 2) ** 2)

grid = np.radians(np.linspace(1, 172, 300))
plt.plot(np.degrees(grid), small * 2 / math.pi * ellipk(np.sin(grid / 2) ** 2), label="closed form")
plt.plot(np.degrees(amplitudes), periods, "o", mfc="none", label="simulated")
plt.axhline(small, color="0.5", lw=1, ls="--", label="of small oscillations")
plt.xlabel("amplitude [deg]")
plt.ylabel("period [s]")
plt.legend()
plt.show()

# %%
# There are about a hundred steps between two turning points, each with an error of about 1e-11.
worst = np.max(np.abs(periods / exact - 1))
print(f"largest relative difference {worst:.1e}")
assert worst < 1e-8
