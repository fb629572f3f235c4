"""
Rattleback
==========

A rattleback is an ellipsoid whose principal axes of inertia are slightly rotated relative to the
axes of its surface. If it spins in one direction, it starts to rock, stops and then spins in the
other direction.
"""

import math

import matplotlib.pyplot as plt
import numpy as np

import cotree

# The parameters are from Kane and Levinson, Int. J. Non-Linear Mechanics 17 (1982) 175; SI units.
semiaxes, height, lean, spin = [0.2, 0.03, 0.02], 0.01, math.radians(0.5), -5.0
inertia = [[2e-4, -2e-5, 0.0], [-2e-5, 1.6e-3, 0.0], [0.0, 0.0, 1.7e-3]]


def rattleback(type, **contact):
    """Build a rattleback that begins in a spin, leaning a little; its lowest point is at rest."""
    squares = np.square(semiaxes)
    up = np.array([0.0, math.sin(lean), math.cos(lean)])  # in its axes
    lowest = np.array([0.0, 0.0, height]) - squares * up / math.sqrt(squares @ up**2)
    c, s = math.cos(lean), math.sin(lean)
    turn = np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])
    velocity = turn @ np.cross(lowest, [0.0, 0.0, spin])
    initial = {"z": -(turn @ lowest)[2], "rotation": [lean, 0, 0], "w3": spin}
    initial |= dict(zip(("vx", "vy", "vz"), velocity.tolist(), strict=True))
    scene = cotree.Scene("rattleback", gravity=[0, 0, -9.81])
    scene.edge("body", "rigid_body", "ground", "M", mass=1.0, inertia=inertia, initial=initial)
    scene.edge("up", "arm", "M", "E", vector=[0, 0, height])
    scene.edge("table", type, "ground", "E", normal=[0, 0, 1], semiaxes=semiaxes, **contact)
    scene.output("energy", "energy.kinetic + energy.potential")
    return scene.compile()


# %%
# The example compares two models. In the first, constraints enforce rolling. In the second, the
# body has an elastic contact with friction. It therefore slips at times and loses energy.
t = np.linspace(0, 8, 801)
rolling = rattleback("rolling_ellipsoid").simulate((0, 8), t, rtol=1e-10)
elastic = {"stiffness": 1e7, "dissipation": 0.3, "friction": 1.0, "transition": 1e-5}
touching = rattleback("contact", **elastic).simulate((0, 8), t, rtol=1e-7)

fig, (left, right) = plt.subplots(1, 2, figsize=(9, 4), width_ratios=[1.4, 1], layout="compressed")
left.plot(t, rolling["body.w3"], label="rolls")
left.plot(t, touching["body.w3"], label="touches, with friction")
left.axhline(0.0, color="0.6", lw=0.8)
left.set(xlabel="time [s]", ylabel="spin [rad/s]")
left.legend(loc="upper left")
right.imshow(rolling.animate(speed=1.0).frame(5, width=600))
right.axis("off")
plt.show()

# %%
# In rolling, the energy is conserved.
change = np.ptp(rolling["energy"]) / rolling["energy"][0]
left_over = touching["energy"][-1]
print(f"energy changes by {change:.1e} of itself; on the contact {left_over:.3f} J are left")
assert change < 1e-7

# %%
# The animation shows the body. Drag to rotate the view.
rolling.animate(speed=1.0)
