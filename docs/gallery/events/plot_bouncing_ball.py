"""
Bouncing ball with sensitivities
================================

A ball loses 20 % of its speed at each bounce. The heights and times of later bounces depend on the
coefficient of restitution. Their sensitivities are exact, although the velocity jumps.
"""

import matplotlib.pyplot as plt
import numpy as np

import cotree

g, e, h = 9.81, 0.8, 2.0
scene = cotree.Scene("ball", gravity=[0, 0, -g])
scene.parameter("e", e)
scene.edge("j", "prismatic", "ground", "B", axis=[0, 0, 1], initial={"s": h})
scene.edge("body", "rigid_body", "ground", "B", mass=1.0)
scene.event("hit", "j.s", direction=-1, set={"j.s_dot": "-e*j.s_dot"})
t = np.linspace(0, 4.2, 2101)
result = scene.compile(["e"]).simulate((0, 4.2), t, rtol=1e-10, atol=1e-12)

fig, (top, bottom) = plt.subplots(2, 1, figsize=(7, 5), sharex=True)
top.plot(t, result["j.s"])
top.plot(result.events["hit"].t, 0 * result.events["hit"].t, "o", mfc="none", color="tab:red")
top.set(ylabel="height [m]")
bottom.plot(t, result.sensitivity("j.s", "e"), color="tab:green")
bottom.set(xlabel="time [s]", ylabel="∂ height / ∂ e [m]")
plt.show()

# %%
# The time of bounce n has a closed form: :math:`\sqrt{2h/g}\,(1 + 2e + 2e^2 + \dots +
# 2e^{n-1})`. Between bounces the motion is a parabola, which the method integrates exactly.
powers = np.arange(len(result.events["hit"].t))
fall = np.sqrt(2 * h / g)
times = fall * (2 * np.cumsum(e**powers) - 1)
slopes = fall * 2 * np.cumsum(powers * e ** np.maximum(powers - 1, 0))
time, slope = result.events["hit"].t, result.event_sensitivity("hit", "e")
print(f"fifth bounce at {time[4]:.9f} s, closed form {times[4]:.9f} s")
print(f"its sensitivity {slope[4]:.9f} s, closed form {slopes[4]:.9f} s")
assert np.max(np.abs(time - times)) < 1e-9
assert np.max(np.abs(slope - slopes)) < 1e-8
