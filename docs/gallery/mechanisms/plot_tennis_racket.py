"""
Tennis racket theorem
=====================

A free body that spins about its intermediate principal axis flips over periodically without any
applied torque (the tennis racket theorem, or Dzhanibekov effect). The period is an elliptic
integral.
"""

import math

import matplotlib.pyplot as plt
import numpy as np
from scipy.special import ellipk

import cotree

I1, I2, I3 = 1e-3, 2e-3, 2.6e-3  # kg m^2
w = np.array([0.1, 8.0, 0.05])  # rad/s

scene = cotree.Scene("racket")
start = dict(zip(["w1", "w2", "w3"], w.tolist(), strict=True))
scene.edge("body", "rigid_body", "ground", "P", mass=0.3, inertia=[I1, I2, I3], initial=start)
scene.event("over", "body.w2", direction=-1)
t = np.linspace(0, 14, 1401)
result = scene.compile().simulate((0, 14), t, method="dop853", rtol=1e-11, atol=1e-12)

fig, (left, right) = plt.subplots(1, 2, figsize=(9, 4), width_ratios=[1.4, 1])
for name in ("w1", "w2", "w3"):
    left.plot(t, result[f"body.{name}"], label=name)
left.set(xlabel="time [s]", ylabel="angular velocity along the body's axes [rad/s]")
left.legend(loc="lower right", bbox_to_anchor=(1, 1), ncols=3)
right.imshow(result.animate(speed=1.0).frame(10, width=500, height=500))
right.axis("off")
plt.show()

# %%
# Landau and Lifshitz (*Mechanics*, section 37) give the period as a function of the energy and the
# angular momentum. A period takes a few tens of steps with errors of 1e-11 each. The motion near
# the unstable axis amplifies these errors by a factor of 100.
energy2 = I1 * w[0] ** 2 + I2 * w[1] ** 2 + I3 * w[2] ** 2  # twice the energy
momentum2 = (I1 * w[0]) ** 2 + (I2 * w[1]) ** 2 + (I3 * w[2]) ** 2
first, second = (I1, I3) if momentum2 > energy2 * I2 else (I3, I1)
rate2 = (second - I2) * (momentum2 - energy2 * first) / (I1 * I2 * I3)
modulus = (I2 - first) * (energy2 * second - momentum2)
modulus /= (second - I2) * (momentum2 - energy2 * first)
period = 4 * ellipk(modulus) / math.sqrt(rate2)
simulated = np.diff(result.events["over"].t)[0]
print(f"period {simulated:.8f} s, closed form {period:.8f} s")
assert abs(simulated - period) < 1e-7 * period

# %%
# The animation shows the body as a box of the same inertia:
result.animate(speed=1.0)
