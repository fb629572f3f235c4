"""
Draining tank
=============

Water leaves a tank through a hole in its bottom (Torricelli's law). An event locates the time at
which the water reaches a given level. The sensitivity of this time shows the effect of a larger
hole.
"""

import math

import matplotlib.pyplot as plt
import numpy as np

import cotree

A, a, h0, h1, g = 0.5, 0.002, 2.0, 0.1, 9.81

scene = cotree.Scene("draining")
scene.parameter("a", a, unit="m^2")
scene.edge("T", "tank", "n", "ground", area=A, initial={"p": 1000 * g * h0})
scene.edge("hole", "orifice", "n", "ground", area="a", coefficient=1.0)
scene.output("h", f"n.p/{1000 * g}")
scene.event("low", f"n.p - {1000 * g * h1}", direction=-1)
model = scene.compile(["a"])

t = np.linspace(0, 150, 601)
for area in (0.0016, a, 0.0025):
    result = model.simulate((0, 150), t, rtol=1e-9, atol=1e-6, parameters={"a": area})
    plt.plot(t, result["h"], label=f"hole of {1e4 * area:.0f} cm²")
    plt.plot(result.events["low"].t, [h1] * len(result.events["low"].t), "o", mfc="none", c="0.3")
plt.xlabel("time [s]")
plt.ylabel("level [m]")
plt.legend()
plt.show()

# %%
# The level is proportional to the square of the remaining time. The time and its derivative with
# respect to the area therefore have closed forms (see any textbook of hydraulics). The orifice
# follows Torricelli's law exactly above 1 Pa.
result = model.simulate((0, 150), rtol=1e-10, atol=1e-6)
exact = A / a * math.sqrt(2 / g) * (math.sqrt(h0) - math.sqrt(h1))
time, slope = result.events["low"].t[0], result.event_sensitivity("low", "a")[0]
print(f"at {time:.6f} s, closed form {exact:.6f} s")
print(f"a cm² more: {1e-4 * slope:.6f} s, closed form {-1e-4 * exact / a:.6f} s")
assert abs(time - exact) < 1e-7 * exact  # rtol 1e-10 in each of about a hundred steps
assert abs(slope + exact / a) < 1e-6 * exact / a
