"""
A battery pack with one weak cell
=================================

Twelve lithium-ion cells in series carry the same current and heat each other. They belong to the
shipped part ``battery-pack``. One cell has twice the resistance of the others.
"""

import matplotlib.pyplot as plt
import numpy as np

import cotree

scene = cotree.Scene("pack")
scene.parameter("I", 10.0, unit="A")
weak = {"pack.cell5.R0": 0.04}
scene.add("pack", "battery-pack", plus="p", minus="ground", air="air", set=weak)
scene.edge("room", "temperature_source", "air", "ground", temperature=298.15)
scene.edge("load", "current_source", "p", "ground", current="I")
scene.output("voltage", "p.v")

model = scene.compile(["pack.cell5.R0", "pack.R_gap"])
print(scene.summary())
t = np.linspace(0, 2400, 241)
result = model.simulate((0, 2400), t)

fig, (left, right) = plt.subplots(1, 2, figsize=(9, 3.8), width_ratios=[1.3, 1])
cells = np.arange(1, 13)
temperatures = np.array([result[f"pack.cell{i}.temperature"] for i in cells]) - 273.15
for moment in (300, 900, 2400):
    left.plot(cells, temperatures[:, moment // 10], "o-", label=f"{moment // 60} min")
left.set(xlabel="cell", ylabel="temperature [°C]", title="the fifth is weak", xticks=cells)
left.legend()
for parameter in ("pack.cell5.R0", "pack.R_gap"):
    slope = result.sensitivity("pack.cell6.temperature", parameter)
    value = {"pack.cell5.R0": 0.04, "pack.R_gap": 2.0}[parameter]
    right.plot(t / 60, 0.01 * value * slope, label=parameter)
right.set(xlabel="time [min]", ylabel="K per percent", title="temperature of its neighbour")
right.legend()
plt.show()

# %%
# Energy balance: the heat of all cells is stored in the cells or has been released to the air.
heat = np.array([result[f"pack.cell{i}.temperature"][-1] - 298.15 for i in cells])
stored = 45.0 * heat.sum()
lost = np.trapezoid(sum(temperatures[i - 1] + 273.15 - 298.15 for i in cells) / 8.0, t)
current = 10.0
pairs = current**2 * 0.015 * (1 - np.exp(-t / 30.0)) ** 2  # an RC pair from rest
made = np.trapezoid(12 * pairs, t) + current**2 * (11 * 0.02 + 0.04) * t[-1]
print(f"heat made {made:.0f} J, stored {stored:.0f} J, lost {lost:.0f} J")
# The trapezoidal rule with intervals of ten seconds has an error of about 1e-4 here.
assert abs(made - stored - lost) < 3e-4 * made
