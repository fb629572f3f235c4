"""
Frequency response of an active filter
======================================

The circuit is a Sallen-Key low-pass filter with an ideal operational amplifier. The matrices A, B,
C and D of the linearised model give its frequency response in a few lines of NumPy.
"""

import math

import matplotlib.pyplot as plt
import numpy as np

import cotree

R, C2, f0 = 10e3, 1e-9, 1 / (2 * math.pi * 10e3 * 1e-9 * math.sqrt(2))

scene = cotree.Scene("sallen-key")
scene.input("u", 0.0, unit="V")
scene.edge("V", "voltage_source", "s", "ground", voltage="u")
scene.edge("R1", "resistor", "s", "a", resistance=R)
scene.edge("R2", "resistor", "a", "b", resistance=R)
scene.edge("C1", "capacitor", "a", "out", capacitance=2 * C2)
scene.edge("C2", "capacitor", "b", "ground", capacitance=C2)
scene.edge("A1", "ideal_op_amp", "b", "out", "out")  # plus, minus, output
scene.output("y", "out.v")
linear = scene.compile().linearize()


def response(frequency: float) -> complex:
    """Evaluate C (s - A)^-1 B + D at s = 2 pi j f."""
    s = 2j * math.pi * frequency * np.eye(len(linear.A))
    return (linear.C @ np.linalg.solve(s - linear.A, linear.B) + linear.D)[0, 0]


frequencies = np.geomspace(100, 1e6, 400)
values = np.array([response(f) for f in frequencies])
fig, (top, bottom) = plt.subplots(2, 1, figsize=(7, 5), sharex=True)
top.semilogx(frequencies, 20 * np.log10(np.abs(values)))
top.plot(f0, 20 * np.log10(abs(response(f0))), "o", mfc="none", color="tab:red")
top.set(ylabel="gain [dB]")
bottom.semilogx(frequencies, np.degrees(np.unwrap(np.angle(values))))
bottom.set(xlabel="frequency [Hz]", ylabel="phase [deg]")
plt.show()

# %%
# With C1 = 2 C2 this is a Butterworth filter, whose gain at the corner frequency is :math:`1/\sqrt
# 2` (U. Tietze and Ch. Schenk, *Electronic Circuits*, on active filters). Nothing is integrated,
# so only rounding errors remain.
gain = abs(response(f0))
print(f"gain at {f0:.1f} Hz: {gain:.12f}, closed form {1 / math.sqrt(2):.12f}")
assert abs(gain - 1 / math.sqrt(2)) < 1e-12
