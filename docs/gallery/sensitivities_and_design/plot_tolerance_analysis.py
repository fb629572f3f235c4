"""
Tolerance analysis of a filter
==============================

The resistors of a filter have a tolerance of 5 %, and its capacitors have a tolerance of 10 %. With
the sensitivities to all parts, a single run gives the resulting spread of the step response. A
Monte Carlo study with a thousand runs confirms it.
"""

import matplotlib.pyplot as plt
import numpy as np

import cotree

parts = {"R1": (1e3, 0.05), "R2": (2.2e3, 0.05), "C1": (1e-6, 0.1), "C2": (4.7e-7, 0.1)}
scene = cotree.Scene("filter")
for name, (value, _) in parts.items():
    scene.parameter(name, value)
scene.edge("V", "voltage_source", "s", "ground", voltage=1.0)
scene.edge("R1", "resistor", "s", "a", resistance="R1")
scene.edge("C1", "capacitor", "a", "ground", capacitance="C1")
scene.edge("R2", "resistor", "a", "b", resistance="R2")
scene.edge("C2", "capacitor", "b", "ground", capacitance="C2")

t = np.linspace(0, 12e-3, 121)
model = scene.compile(list(parts))
result = model.simulate((0, 12e-3), t)
each = [v * tolerance / 3 * result.sensitivity("C2.v", n) for n, (v, tolerance) in parts.items()]
sigma = np.sqrt(np.sum(np.square(each), axis=0))  # tolerances are three standard deviations

# %%
# The Monte Carlo study does not use sensitivities:
plain = scene.compile()
nominal = np.array([value for value, _ in parts.values()])
deviation = np.array([value * tolerance / 3 for value, tolerance in parts.values()])
draws = nominal + deviation * np.random.default_rng(1).standard_normal((1000, len(parts)))
runs = np.array([plain.simulate((0, 12e-3), t, parameters=p)["C2.v"] for p in draws])

plt.plot(1e3 * t, result["C2.v"], color="k", lw=1, label="as drawn")
band = 3 * sigma
plt.fill_between(
    1e3 * t, result["C2.v"] - band, result["C2.v"] + band, alpha=0.3, label="by sensitivities"
)
low, high = np.percentile(runs, [0.135, 99.865], axis=0)
plt.plot(1e3 * t, np.transpose([low, high]), "--", color="tab:red", lw=1)
plt.plot([], [], "--", color="tab:red", lw=1, label="1000 runs")
plt.xlabel("time [ms]")
plt.ylabel("voltage of C2 [V]")
plt.legend(loc="lower right")
plt.show()

# %%
# The standard deviation of 1000 samples has a relative uncertainty of
# :math:`1/\sqrt{2 \cdot 1000}`, 2.2 %. The test allows four times this value, and 1 % for terms of
# second order.
at = np.argmax(sigma)
chance = np.std(runs[:, at])
print(f"at {1e3 * t[at]:.1f} ms: {sigma[at]:.5f} V by sensitivities, {chance:.5f} V by 1000 runs")
assert abs(chance / sigma[at] - 1) < 4 * 0.022 + 0.01
