"""
Collision of two pendulums
==========================

A pendulum falls and hits a second pendulum at rest. ``impact`` is an event whose impulse follows
from the masses and constraints. You specify only the coefficient of restitution.
"""

import math

import matplotlib.pyplot as plt
import numpy as np

import cotree

g, length, m1, m2, e, start = 9.81, 1.0, 1.0, 2.0, 0.7, math.radians(-50)

scene = cotree.Scene("collision", gravity=[0, -g, 0])
for k, mass, angle in ((1, m1, start), (2, m2, 0.0)):
    scene.edge(f"h{k}", "revolute", "ground", f"A{k}", axis=[0, 0, 1], initial={"theta": angle})
    scene.edge(f"r{k}", "arm", f"A{k}", f"B{k}", vector=[0, -length, 0])
    scene.edge(f"b{k}", "rigid_body", "ground", f"B{k}", mass=mass)
# The balls are small and hang side by side, so the gap is the angle between the pendulums.
scene.event("hit", "h2.theta - h1.theta", direction=-1, impact={"restitution": e})
t = np.linspace(0, 4, 2001)
model = scene.compile()
result = model.simulate((0, 4), t, rtol=1e-10, atol=1e-12)

for k in (1, 2):
    plt.plot(t, np.degrees(result[f"h{k}.theta"]), label=f"pendulum {k}")
for time in result.events["hit"].t:
    plt.axvline(time, color="0.6", lw=0.8)
plt.xlabel("time [s]")
plt.ylabel("angle [deg]")
plt.legend(loc="lower right", bbox_to_anchor=(1, 1), ncols=2)
plt.show()

# %%
# The balance of angular momentum and Newton's law of restitution give the speed of the second
# pendulum. The conservation of energy gives the speed of the first pendulum before the impact. The
# tolerance of the run is 1e-10.
before = math.sqrt(2 * g / length * (1 - math.cos(start)))
exact = m1 * (1 + e) / (m1 + m2) * before
after = result.events["hit"].y_after[model.states.index("h2.theta_dot"), 0]
print(f"second pendulum after the first hit {after:.9f} rad/s, closed form {exact:.9f} rad/s")
assert abs(after - exact) < 1e-8
