"""
Discharge of a battery cell
===========================

A cell with two RC pairs delivers a constant current for ten minutes. When the current is switched
off, the voltage recovers with two time constants. Sensitivities show which parameters a voltage
measurement can identify.
"""

import matplotlib.pyplot as plt
import numpy as np

import cotree

values = {"R0": 0.02, "R1": 0.015, "C1": 2000.0, "R2": 0.03, "C2": 30000.0}
current, stop, capacity = 2.0, 600.0, 2.5 * 3600

scene = cotree.Scene("cell")
for name, value in values.items():
    scene.parameter(name, value)
fields = {"resistance": "R0", "resistance1": "R1", "capacitance1": "C1"}
fields |= {"resistance2": "R2", "capacitance2": "C2", "capacity": capacity}
scene.edge(
    "cell",
    "battery_cell",
    "plus",
    "ground",
    open_circuit_voltage="3 + 1.1*cell.soc",
    initial={"soc": 0.9},
    **fields,
)
scene.edge("load", "current_source", "plus", "ground", current=f"where(t < {stop}, {current}, 0)")
scene.output("voltage", "cell.v")

t = np.linspace(0, 1800, 1801)
result = scene.compile(["R1", "C2"]).simulate((0, 1800), t, rtol=1e-9, atol=1e-11)
fig, (top, bottom) = plt.subplots(2, 1, figsize=(7, 5), sharex=True)
top.plot(t / 60, result["voltage"])
top.set(ylabel="voltage [V]")
for name in ("R1", "C2"):
    values_at = 1e3 * 0.01 * values[name] * result.sensitivity("voltage", name)
    bottom.plot(t / 60, values_at, label=f"one percent more {name}")
bottom.set(xlabel="time [min]", ylabel="change of the voltage [mV]")
bottom.legend()
plt.show()

# %%
# The voltage of each RC pair is exponential. The cell model is that of M. Chen and G. Rincón-Mora,
# *IEEE Transactions on Energy Conversion* 21, 2006, with a linear open-circuit voltage. The
# tolerance of the run is 1e-9.
exact = 3 + 1.1 * (0.9 - current * stop / capacity)
for R, C in ((values["R1"], values["C1"]), (values["R2"], values["C2"])):
    exact -= current * R * (1 - np.exp(-stop / (R * C))) * np.exp(-(1800 - stop) / (R * C))
print(f"after 30 minutes {result['voltage'][-1]:.9f} V, closed form {exact:.9f} V")
assert abs(result["voltage"][-1] - exact) < 1e-8
