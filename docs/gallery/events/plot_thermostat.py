"""
Thermostat with hysteresis
==========================

A heater switches on below 19 °C and off above 21 °C. Its switching state is a *mode*, which is a
number that only events change.
"""

import math

import matplotlib.pyplot as plt
import numpy as np

import cotree

C, R, power, outside = 4e5, 0.02, 1500.0, 278.15  # J/K, K/W, W, K
low, high = 292.15, 294.15

scene = cotree.Scene("thermostat")
scene.mode("heating", 1)
scene.edge("room", "heat_capacitor", "room", "ground", capacity=C, initial={"T": low})
scene.edge("wall", "thermal_resistor", "room", "air", resistance=R)
scene.edge("air", "temperature_source", "air", "ground", temperature=outside)
scene.edge("heater", "heat_source", "ground", "room", heat_flow=f"{power}*heating")
scene.event("off", f"room.T - {high}", direction=1, set={"heating": 0})
scene.event("on", f"room.T - {low}", direction=-1, set={"heating": 1})
hours = 4.0
t = np.linspace(0, 3600 * hours, 2001)
result = scene.compile().simulate((0, t[-1]), t, rtol=1e-10, atol=1e-10)

fig, (top, bottom) = plt.subplots(
    2, 1, figsize=(7, 4.6), sharex=True, gridspec_kw={"height_ratios": [3, 1]}
)
top.plot(t / 3600, result["room.T"] - 273.15)
top.set(ylabel="temperature [°C]")
bottom.plot(t / 3600, result["heating"], drawstyle="steps-post", color="tab:red")
bottom.set(xlabel="time [h]", ylabel="heating", yticks=[0, 1])
plt.show()

# %%
# The temperature is exponential during heating and cooling, and the period is the sum of both
# durations. Events are located to the rounding error of the temperature, 6e-14 K, at rates of 1e-3
# K/s. The tolerance of the run is 1e-10.
warm = outside + R * power
period = R * C * math.log((warm - low) / (warm - high))
period += R * C * math.log((high - outside) / (low - outside))
found = np.diff(result.events["on"].t)
print(f"period {found[0]:.7f} s, closed form {period:.7f} s")
assert np.max(np.abs(found - period)) < 1e-5
