"""
Hydraulic cylinder with compressible oil
========================================

A pump moves oil through a narrow line into a cylinder, which lifts a mass. Because oil is
compressible, the mass oscillates on the oil column. The frequency of this oscillation limits the
bandwidth of such a drive.
"""

import matplotlib.pyplot as plt
import numpy as np

import cotree

p0, area, mass, R, volume, modulus = 80e5, 2e-3, 1200.0, 6e10, 8e-4, 1.4e9

scene = cotree.Scene("lift")
scene.edge("pump", "pressure_source", "s", "ground", pressure=p0)
scene.edge("line", "hydraulic_resistor", "s", "c", resistance=R)
weight = 9.81 * mass
scene.edge(
    "oil", "accumulator", "c", "ground", capacity=volume / modulus, initial={"p": weight / area}
)
scene.edge(
    "cylinder", "hydraulic_cylinder", chamber=["c", "ground"], rod=["ground", "x"], area=area
)
scene.edge("load", "translational_mass", "ground", "x", mass=mass)
scene.edge("weight", "force_source", "ground", "x", force=-weight)
model = scene.compile()
t = np.linspace(0, 0.5, 1001)
result = model.simulate((0, 0.5), t)

fig, (top, bottom) = plt.subplots(2, 1, figsize=(7, 5), sharex=True)
top.plot(t, 1e-5 * result["oil.p"])
top.set(ylabel="pressure [bar]")
bottom.plot(t, 1e3 * result["load.v"], color="tab:orange")
bottom.set(xlabel="time [s]", ylabel="speed of the mass [mm/s]")
plt.show()

# %%
# The undamped natural frequency is :math:`A/\sqrt{C m}`, and the decay rate is :math:`1/(2 R C)`
# (H. E. Merritt, *Hydraulic Control Systems*, chapter 6). The differences are only rounding errors.
poles = np.linalg.eigvals(model.linearize().A)
C = volume / modulus
found, exact = abs(poles[0]), area / np.sqrt(C * mass)
print(f"natural frequency {found:.9f} rad/s, closed form {exact:.9f} rad/s")
assert abs(found - exact) < 1e-9 * exact
assert abs(poles[0].real + 1 / (2 * R * C)) < 1e-9 * exact
