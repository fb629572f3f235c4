"""
Delay of a wire modelled as an RC ladder
========================================

A wire on a chip behaves like a ladder of many resistors and capacitors, which this script builds in
a loop. Elmore's delay, the first moment of the impulse response, has a closed form for any number
of stages.
"""

import matplotlib.pyplot as plt
import numpy as np

import cotree

N, R, C = 60, 5.0, 20e-15  # stages, ohm and farad of each

scene = cotree.Scene("ladder")
scene.edge("V", "voltage_source", "n0", "ground", voltage=1.0)
for k in range(1, N + 1):
    scene.edge(f"R{k}", "resistor", f"n{k - 1}", f"n{k}", resistance=R)
    scene.edge(f"C{k}", "capacitor", f"n{k}", "ground", capacitance=C)
# A separate capacitor integrates the difference between the final and the present voltage.
scene.edge("lack", "current_source", "ground", "sum", current=f"1e9*(1 - n{N}.v)")
scene.edge("area", "capacitor", "sum", "ground", capacitance=1.0)

tau = R * C * N**2
t = np.linspace(0, 10 * tau, 1001)
result = scene.compile().simulate((0, t[-1]), t, method="rodas5", rtol=1e-9, atol=1e-11)

for k in (6, 18, 36, 60):
    plt.plot(1e9 * t, result[f"C{k}.v"], label=f"stage {k}")
delay = 1e-9 * result["area.v"][-1]
plt.axvline(1e9 * delay, color="0.4", lw=1, ls="--", label="Elmore's delay")
plt.xlim(0, 2.5e9 * tau)
plt.xlabel("time [ns]")
plt.ylabel("voltage [V]")
plt.legend()
plt.show()

# %%
# The delay is the sum of the products of each capacitance and the resistance in front of it,
# :math:`R C N (N + 1) / 2` (W. C. Elmore, *Journal of Applied Physics* 19, 1948). At the end of
# the run the slowest mode has decayed to :math:`\exp(-24)`, 4e-11. The tolerance of the run is
# 1e-9.
exact = R * C * N * (N + 1) / 2
print(f"delay {1e9 * delay:.8f} ns, closed form {1e9 * exact:.8f} ns")
assert abs(delay / exact - 1) < 1e-7
