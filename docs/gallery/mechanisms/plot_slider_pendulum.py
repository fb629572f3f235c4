"""
Slider-pendulum with sensitivities
==================================

A block on a guide is attached to a spring, and a rod is hinged to the block. This is the example of
Banerjee and McPhee, *Graph-Theoretic Modelling and Sensitivity Analysis of Dynamic Systems*. cotree
forms the governing equations, Eq. (8), and the sensitivity equations, Eq. (9), from the linear
graph.
"""

import numpy as np
from scipy.integrate import solve_ivp

import cotree

scene = cotree.Scene("slider-pendulum", gravity=[0, "-g", 0])
values = {"m1": 1.0, "m2": 5.0, "L": 1.0, "r": 0.03, "zeta": 10.0, "k": 50.0, "s0": 0.5, "g": 9.81}
units = {"L": "m", "r": "m", "s0": "m"}
for name, value in values.items():
    scene.parameter(name, value, unit=units.get(name, ""))
x, z = [1, 0, 0], [0, 0, 1]
scene.edge("j1", "prismatic", "ground", "A", axis=x, initial={"s": 0.5, "s_dot": 1.0})
scene.edge("m5", "rigid_body", "ground", "A", mass="m1")
scene.edge("spring", "spring", "ground", "A", axis=x, stiffness="k", free_length="s0")
scene.edge("h2", "revolute", "A", "B", axis=z, damping="zeta")
scene.edge("r4", "arm", "B", "C", vector=[0, "-L/2", 0])
scene.edge("m6", "rigid_body", "ground", "C", mass="m2", inertia="m2*(r**2/4 + L**2/12)")

model = scene.compile(sensitivities=["L"])
result = model.simulate((0, 10), np.linspace(0, 10, 501), rtol=1e-10, atol=1e-12)

# %%
# The curves on the left are those of Fig. 5 of the paper. The sensitivity of s is that of Fig. 6.
figure = result.plot(["j1.s", "h2.theta", "d(j1.s)/d(L)", "d(h2.theta)/d(L)"])

# %%
# SciPy integrates Eq. (8) of the paper, which was entered by hand. Both runs give the same position
# of the block after 10 s. Their error per step is 1e-10, so nine digits must agree.
m1, m2, L, r, zeta, k, s0, g = values.values()


def eq8(_t, y):
    s, theta, s_dot, theta_dot = y
    coupling = m2 * L / 2 * np.cos(theta)
    mass = [[m1 + m2, coupling], [coupling, m2 * (r**2 / 4 + L**2 / 3)]]
    force = m2 * L / 2 * np.sin(theta) * theta_dot**2 - k * (s - s0)
    torque = -m2 * g * L / 2 * np.sin(theta) - zeta * theta_dot
    return [s_dot, theta_dot, *np.linalg.solve(mass, [force, torque])]


by_hand = solve_ivp(eq8, (0, 10), [0.5, 0, 1, 0], method="DOP853", rtol=1e-11, atol=1e-12)
print(f"s(10) = {result['j1.s'][-1]:.10f} m, by hand {by_hand.y[0, -1]:.10f} m")
assert abs(result["j1.s"][-1] - by_hand.y[0, -1]) < 1e-9
