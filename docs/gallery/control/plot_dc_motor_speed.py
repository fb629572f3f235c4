"""
Speed control of a direct current motor
=======================================

This scene contains a DC motor, its load and a PI controller. The integral part of the controller is
a capacitor. Its charging current is proportional to the control error.
"""

import matplotlib.pyplot as plt
import numpy as np

import cotree

R, L, K, J, d = 0.5, 1.5e-3, 0.05, 2.5e-4, 1e-4
kp, ki = 0.2, 5.0

scene = cotree.Scene("speed-control")
scene.input("wanted", [[0.0, 0.1, 0.1001], [0.0, 0.0, 100.0]], unit="rad/s")
scene.input("load", [[0.0, 0.6, 0.6001], [0.0, 0.0, 0.5]], unit="N m")
scene.edge("V", "voltage_source", "p", "ground", voltage=f"{kp}*(wanted - shaft.w) + {ki}*memory.v")
scene.edge(
    "M",
    "dc_motor",
    electrical=["p", "ground"],
    shaft=["ground", "shaft"],
    resistance=R,
    inductance=L,
    constant=K,
)
scene.edge("rotor", "rotational_inertia", "ground", "shaft", inertia=J)
scene.edge("bearing", "rotational_damper", "ground", "shaft", damping=d)
scene.edge("torque", "torque_source", "ground", "shaft", torque="-load")
scene.edge("error", "current_source", "ground", "sum", current="wanted - shaft.w")
scene.edge("memory", "capacitor", "sum", "ground", capacitance=1.0)
scene.allow("dimension:error")  # the current in the controller represents a speed
model = scene.compile()
t = np.linspace(0, 1.1, 1101)
result = model.simulate((0, 1.1), t)

fig, (top, bottom) = plt.subplots(2, 1, figsize=(7, 5), sharex=True)
top.plot(t, result["rotor.w"], label="speed")
top.plot(t, result["wanted"], "--", color="0.5", lw=1, label="wanted")
top.set(ylabel="speed [rad/s]")
top.legend(loc="lower right")
bottom.plot(t, result["M.i"], color="tab:orange")
bottom.set(xlabel="time [s]", ylabel="current [A]")
plt.show()

# %%
# The poles are the roots of the textbook's characteristic polynomial (for example K. Ogata,
# *Modern Control Engineering*, on servo systems). They differ by rounding errors only.
poles = np.sort_complex(np.linalg.eigvals(model.linearize().A))
exact = np.sort_complex(np.roots([L * J, L * d + R * J, R * d + K**2 + K * kp, K * ki]))
print("poles", poles.round(4), "closed form", exact.round(4))
assert np.max(np.abs(poles - exact)) < 1e-9 * np.max(np.abs(exact))
