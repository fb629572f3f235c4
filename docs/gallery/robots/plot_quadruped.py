"""
Quadruped built from four legs
==============================

The leg is defined once and added four times. The shipped part ``quadruped-leg`` has two links,
springs at the hip and the knee, and a foot on the ground. The trunk falls from a small height. The
hips are then driven, and the trunk oscillates.
"""

import matplotlib.pyplot as plt
import numpy as np

import cotree

scene = cotree.Scene("quadruped", gravity=[0, 0, -9.81])
scene.parameter("sway", 12.0, unit="N m", doc="torque of the hips")
scene.input("beat", "where(t < 1, 0, sin(6*(t - 1)))")
corners = {"fl": (0.25, 0.15), "fr": (0.25, -0.15), "hl": (-0.25, 0.15), "hr": (-0.25, -0.15)}
for leg, (x, y) in corners.items():
    scene.add(leg, "quadruped-leg", hip=f"hip_{leg}", tau_hip="sway*beat")
    scene.edge(f"to_{leg}", "arm", "trunk", f"hip_{leg}", vector=[x, y, 0])
scene.edge("base", "free", "ground", "trunk", initial={"z": 0.55})
scene.edge("body", "rigid_body", "ground", "trunk", mass=10.0, inertia=[0.1, 0.3, 0.35])

model = scene.compile(["fl.k"])
print(scene.summary())
t = np.linspace(0, 3, 301)
result = model.simulate((0, 3), t)

fig, (left, right) = plt.subplots(1, 2, figsize=(9, 4), width_ratios=[1.3, 1])
for leg, name in (("fl", "front left"), ("hl", "hind left")):
    left.plot(t, result[f"{leg}.load"], label=name)
left.set(xlabel="time [s]", ylabel="load on the foot [N]", ylim=(0, 150))
left.legend()
right.imshow(result.animate().frame(20, width=600, height=600))
right.axis("off")
plt.show()

# %%
# At rest the feet support the weight of the trunk and the four legs.
weight = 9.81 * (10.0 + 4 * (1.2 + 0.4))
still = model.simulate((0, 12), [0, 12], inputs={"beat": 0.0})
load = sum(still[f"{leg}.load"][-1] for leg in corners)
print(f"load on all feet {load:.4f} N, weight {weight:.4f} N")
assert abs(load - weight) < 1e-2

# %%
# The animation shows the whole motion:
result.animate()
