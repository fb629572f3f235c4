"""
Butterworth filter from two stages
==================================

A low-pass filter of fourth order consists of two stages of second order in series. A voltage
follower between them prevents the second stage from loading the first. Both stages are the shipped
part ``rlc-filter``, with the quality factors of a Butterworth filter.
"""

import matplotlib.pyplot as plt
import numpy as np

import cotree

scene = cotree.Scene("butterworth")
scene.parameter("f0", 1000.0, unit="Hz")
scene.input("u", 0.0, unit="V")
scene.edge("source", "voltage_source", "a", "ground", voltage="u")
scene.add("one", "rlc-filter", input="a", output="b", f0="f0", Q=1 / (2 * np.sin(np.pi / 8)))
scene.edge("follower", "voltage_source", "c", "ground", voltage="b.v")
scene.add("two", "rlc-filter", input="c", output="d", f0="f0", Q=1 / (2 * np.sin(3 * np.pi / 8)))
scene.output("v", "d.v")

model = scene.compile(["f0", "two.Q"])
print(scene.summary())
linear = model.linearize()
f = np.geomspace(100, 10_000, 200)
ones, v = np.eye(len(model.states)), model.outputs.index("v")
response = np.array(
    [
        (linear.C @ np.linalg.solve(2j * np.pi * w * ones - linear.A, linear.B) + linear.D)[v, 0]
        for w in f
    ]
)

fig, (left, right) = plt.subplots(1, 2, figsize=(9, 3.6))
left.loglog(f, abs(response))
left.set(xlabel="frequency [Hz]", ylabel="gain", title="two filters in series")
t = np.linspace(0, 2e-3, 400)
result = model.simulate((0, 2e-3), t, inputs={"u": 1.0}, rtol=1e-9)
right.plot(1e3 * t, result["v"], label="step")
slope = model.simulate((0, 2e-3), t, inputs={"u": 1.0}, rtol=1e-9).sensitivity("v", "two.Q")
right.plot(1e3 * t, slope, label="by the quality of the second")
right.set(xlabel="time [ms]", ylabel="voltage [V]", title="a step of one volt")
right.legend()
plt.show()

# %%
# A Butterworth filter of order four has the gain 1/sqrt(1 + (f/f0)^8).
exact = 1 / np.sqrt(1 + (f / 1000.0) ** 8)
print(f"largest difference of the gain {abs(abs(response) - exact).max():.1e}")
assert abs(abs(response) - exact).max() < 1e-9
