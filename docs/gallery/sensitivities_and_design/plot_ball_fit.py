"""
Coefficient of restitution from noisy heights
=============================================

A camera records a bouncing ball. This example estimates the initial height and the coefficient of
restitution from the record. The sensitivities are exact, although they jump at the bounces.
"""

import matplotlib.pyplot as plt
import numpy as np

import cotree

scene = cotree.Scene("ball", gravity=[0, 0, -9.81])
scene.parameter("e", 0.7, doc="restitution")
scene.edge("j", "prismatic", "ground", "B", axis=[0, 0, 1], initial={"s": 2.0})
scene.edge("body", "rigid_body", "ground", "B", mass=1.0)
scene.event("hit", "j.s", direction=-1, set={"j.s_dot": "-e*j.s_dot"})

# %%
# The record is simulated: free fall in closed form between the bounces, with noise of 2 cm.
g, e, h = 9.81, 0.8, 1.8
t = np.linspace(0, 3, 61)
fall = np.sqrt(2 * h / g)
begins = fall * np.array([1, 1 + 2 * e, 1 + 2 * e + 2 * e**2, 1 + 2 * e + 2 * e**2 + 2 * e**3])
height = h - g * t**2 / 2
for n, begin in enumerate(begins, start=1):
    since = t - begin
    height = np.where(since > 0, e**n * g * fall * since - g * since**2 / 2, height)
record = {"t": t, "height": height + 0.02 * np.random.default_rng(2).standard_normal(t.size)}

# %%
# The likelihood has many local maxima, in which the bounces occur at other times than in the
# record. A fit with one start may end at one of these. With a restitution below 0.7, the ball would
# come to rest within the record after infinitely many bounces, and such runs fail.
run = cotree.Experiment(record, observables={"height": "j.s"}, noise=0.02)
result = cotree.fit(scene, run, {"e": (0.7, 0.95), "j.s": (1.5, 2.2)}, starts=30)
print(result)

result.plot()
plt.show()

# %%
# The waterfall plot shows how many starts found the best optimum, and the values of the other
# optima.
result.plot_waterfall()
plt.show()

# %%
# The true values are within four standard errors of the estimates.
for name, value in {"e": e, "j.s": h}.items():
    assert abs(result.parameters[name] - value) < 4 * result.standard_errors[name]
