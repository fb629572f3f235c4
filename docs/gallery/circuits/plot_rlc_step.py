"""
Step response of a series resonant circuit
==========================================

This example computes the response of a series RLC circuit to a voltage step. The smaller the
resistance, the larger the overshoot. The model is compiled once and simulated with several
resistances.
"""

import math

import matplotlib.pyplot as plt
import numpy as np

import cotree

L, C = 10e-3, 1e-6
scene = cotree.Scene("rlc")
scene.parameter("R", 40.0, unit="ohm")
scene.edge("V", "voltage_source", "a", "ground", voltage=1.0)
scene.edge("R1", "resistor", "a", "b", resistance="R")
scene.edge("L1", "inductor", "b", "c", inductance=L)
scene.edge("C1", "capacitor", "c", "ground", capacitance=C)
scene.event("peak", "L1.i", direction=-1)
model = scene.compile()

t = np.linspace(0, 2e-3, 801)
for R in (20.0, 40.0, 80.0, 200.0):
    result = model.simulate((0, 2e-3), t, parameters={"R": R}, rtol=1e-10, atol=1e-12)
    plt.plot(1e3 * t, result["C1.v"], label=f"{R:.0f} Ω")
    if R == 40.0:
        peak = result.events["peak"].y_after[model.states.index("C1.v"), 0]
plt.xlabel("time [ms]")
plt.ylabel("voltage of the capacitor [V]")
plt.legend()
plt.show()

# %%
# The overshoot of a system of second order is :math:`\exp(-\pi\zeta/\sqrt{1-\zeta^2})` (K. Ogata,
# *Modern Control Engineering*, section 5.3). An event locates the peak, which is usually between
# two steps. The run has an rtol of 1e-10.
damping = 40.0 / 2 * math.sqrt(C / L)
exact = 1 + math.exp(-math.pi * damping / math.sqrt(1 - damping**2))
print(f"peak {peak:.9f} V, closed form {exact:.9f} V")
assert abs(peak - exact) < 1e-8
