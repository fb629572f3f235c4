"""
Disc rolling in a circle
========================

A disc leans inwards and rolls in a circle without slip. One holonomic constraint determines its
height, and two nonholonomic constraints determine its velocity. Multipliers enforce all three. The
animation is drawn from the graph.
"""

import math

import matplotlib.pyplot as plt
import numpy as np

import cotree

m, R, g = 2.0, 0.4, 9.81
A, C = m * R**2 / 4, m * R**2 / 2  # across the disc and about its axis
lean, turn = math.radians(25), 2.0  # from the vertical [rad], about the vertical [rad/s]

# %%
# In steady rolling the balance of moments about the centre gives the spin as a function of the lean
# angle and the rate of turn (for example Neimark and Fufaev, *Dynamics of Nonholonomic Systems*):
#
# .. math:: (C + m R^2)\,\omega\,\Omega\cos\varphi = (m g R - A\,\Omega^2\cos\varphi)\sin\varphi
spin = (m * g * R - A * turn**2 * math.cos(lean)) * math.tan(lean) / ((C + m * R**2) * turn)

scene = cotree.Scene("rolling-disc", gravity=[0, 0, -g])
start = {"z": R * math.cos(lean), "rotation": [-lean, 0, 0]}
start |= {"vx": R * spin, "w2": spin, "w3": turn * math.cos(lean)}
scene.edge("disc", "rigid_body", "ground", "P", mass=m, inertia=[A, C, A], initial=start)
scene.edge("contact", "rolling_disc", "ground", "P", normal=[0, 0, 1], axis=[0, 1, 0], radius=R)
scene.output("x", "P.x")
scene.output("y", "P.y")
period = 2 * math.pi / turn
t = np.linspace(0, period, 401)
result = scene.compile().simulate((0, period), t, rtol=1e-11, atol=1e-12)

fig, (left, right) = plt.subplots(1, 2, figsize=(9, 4), width_ratios=[1, 1.4], layout="compressed")
left.plot(result["x"], result["y"])
left.plot(0, R * spin / turn, "k+", ms=9)
left.set(xlabel="x [m]", ylabel="y [m]", aspect="equal", title="path of the centre, axis (+)")
right.imshow(result.animate(speed=1.0).frame(40, width=800))
right.axis("off")
plt.show()

# %%
# The distance between the centre and the axis of the circle is constant. The run takes about a
# hundred steps, with errors of 1e-11 each.
radius = np.hypot(result["x"], result["y"] - R * spin / turn)
print(f"radius {R * spin / turn:.9f} m, simulated {radius.min():.9f} to {radius.max():.9f} m")
assert np.max(np.abs(radius - R * spin / turn)) < 1e-8

# %%
# The animation shows the disc. Drag to rotate the view.
result.animate(speed=1.0)
