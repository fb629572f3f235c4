"""
Stick-slip motion of a block on a belt
======================================

A belt moves a block against a spring. The block sticks until the spring force reaches the maximum
static friction. It then slides back and sticks again. Such limit cycles cause the sound of brakes
and bowed strings. Sticking and sliding are modes of one edge. Sensitivities are exact across each
change of the mode.
"""

import matplotlib.pyplot as plt
import numpy as np

import cotree

m, k, F, Fs, v = 1.0, 10.0, 1.0, 1.6, 0.5

scene = cotree.Scene("belt")
for name, value in {"F": F, "Fs": Fs, "v": v}.items():
    scene.parameter(name, value)
scene.edge("mass", "translational_mass", "ground", "A", mass=m, initial={"v": "v"})
scene.edge("spring", "translational_spring", "ground", "A", stiffness=k)
scene.edge("drive", "velocity_source", "ground", "belt", velocity="v")
scene.edge("rub", "translational_dry_friction", "belt", "A", force="F", breakaway="Fs")
scene.output("force", "rub.f")

t = np.linspace(0, 8, 1601)
result = scene.compile(["F", "v"]).simulate((0, 8), t, rtol=1e-10, atol=1e-12)

fig, axes = plt.subplots(3, 1, figsize=(7, 6.5), sharex=True)
axes[0].plot(t, result["mass.v"], label="block")
axes[0].axhline(v, color="0.6", lw=1, label="belt")
axes[0].set(ylabel="velocity [m/s]")
axes[0].legend(loc="lower right")
axes[1].plot(t, -result["force"], color="tab:red")
axes[1].set(ylabel="friction on\nthe block [N]")
axes[2].plot(t, result.sensitivity("mass.v", "v"), color="tab:green")
axes[2].set(xlabel="time [s]", ylabel="∂ velocity / ∂ v")
starts, ends = result.events["rub slips backwards"].t, [*result.events["rub stops"].t, t[-1]]
for axis in axes:
    for start, end in zip(starts, ends, strict=True):
        axis.axvspan(start, end, color="0.93", zorder=0)
plt.show()

# %%
# While the block slides (shaded), it oscillates about F/k. It starts at a distance of (Fs − F)/k
# with the speed of the belt and slides until it has this speed again. While it sticks, the length
# of the spring changes at the rate v.
w, lead = np.sqrt(k / m), (Fs - F) / k
period = 2 * (np.pi - np.arctan(lead * w / v)) / w + 2 * lead / v
print(f"period {np.diff(starts)[0]:.9f} s, closed form {period:.9f} s")
assert np.max(np.abs(np.diff(starts) - period)) < 1e-9
# The first slip is at Fs/(k v). Its derivative with respect to v is minus this time divided by v.
slope = result.event_sensitivity("rub slips backwards", "v")[0]
print(f"first slip by v: {slope:.9f} s²/m, closed form {-Fs / (k * v**2):.9f} s²/m")
assert abs(slope + Fs / (k * v**2)) < 1e-9
