"""
Period of a pendulum at large amplitude
=======================================

A pendulum released at 90 degrees swings more slowly than a small one.
"""

import math

import matplotlib.pyplot as plt
from scipy.special import ellipk

import cotree

scene = cotree.Scene("pendulum", gravity=[0, -9.81, 0])
scene.edge("h", "revolute", "ground", "A", axis=[0, 0, 1], initial={"theta": math.pi / 2})
scene.edge("rod", "arm", "A", "B", vector=[0, -1.0, 0])
scene.edge("bob", "rigid_body", "ground", "B", mass=1.0)
scene.event("turns", "h.theta_dot", direction=1)
result = scene.compile().simulate((0, 10), method="dop853", rtol=1e-11, atol=1e-12)

# %%
# The times between passages through rest at the far side are periods. The closed form is the
# complete elliptic integral of the first kind.
period = result.events["turns"].t[1] - result.events["turns"].t[0]
exact = 4.0 * math.sqrt(1.0 / 9.81) * ellipk(math.sin(math.pi / 4) ** 2)
print(f"simulated {period:.9f} s, closed form {exact:.9f} s")
assert abs(period - exact) < 1e-8

result.plot(["h.theta"])
plt.show()
