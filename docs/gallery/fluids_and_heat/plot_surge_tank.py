"""
Surge tank of a power station
=============================

After the turbines of a power station are shut down, the water in the supply tunnel flows into the
surge tank and oscillates. The maximum level determines the required height of the tank.
"""

import matplotlib.pyplot as plt
import numpy as np
from scipy.linalg import expm
from scipy.optimize import brentq

import cotree

rho, g = 1000.0, 9.81
A, length, As, rf, H0, Q0 = 10.0, 2000.0, 80.0, 0.4, 50.0, 20.0

scene = cotree.Scene("surge-tank")
scene.parameter("As", As, unit="m^2")
scene.edge("lake", "pressure_source", "lake", "ground", pressure=rho * g * H0)
scene.edge(
    "tunnel",
    "pipe",
    "lake",
    "shaft",
    resistance=rho * g * rf,
    inertance=rho * length / A,
    initial={"q": Q0},
)
scene.edge("tank", "tank", "shaft", "ground", area="As", initial={"p": rho * g * (H0 - rf * Q0)})
scene.output("level", f"shaft.p/{rho * g}")
scene.event("highest", "tunnel.q", direction=-1)

model = scene.compile(["As"])
t = np.linspace(0, 600, 1201)
result = model.simulate((0, 600), t, rtol=1e-10, atol=1e-8)

fig, (top, bottom) = plt.subplots(2, 1, figsize=(7, 5), sharex=True)
top.plot(t, result["level"])
top.axhline(H0, color="0.5", lw=1, ls="--", label="lake")
top.set(ylabel="level in the tank [m]")
top.legend()
bottom.plot(t, result.sensitivity("level", "As"), color="tab:green")
bottom.set(xlabel="time [s]", ylabel="∂ level / ∂ area [m/m²]")
plt.show()

# %%
# The matrix exponential solves the two linear equations in closed form. The level has its maximum
# when the flow is zero. The tolerance of the run is 1e-10.
system = np.array([[-g * A / length * rf, -g * A / length], [1 / As, 0.0]])
start = np.array([Q0, -rf * Q0])  # flow, and level above the lake's
peak = brentq(lambda t: (expm(system * t) @ start)[0], 50, 120, xtol=1e-12)
exact = H0 + (expm(system * peak) @ start)[1]
found = result.events["highest"].y_after[model.states.index("tank.p"), 0] / (rho * g)
print(f"highest level {found:.8f} m, closed form {exact:.8f} m")
assert abs(found - exact) < 1e-7
