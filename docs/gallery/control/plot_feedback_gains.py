"""
Feedback as an input, with sensitivities to its gains
=====================================================

This example adds a regulator to a shipped scene without changing the scene. The control law is
passed to the run as an input, and its gains are parameters. The compiled closed loop has
sensitivities to the gains.
"""

import matplotlib.pyplot as plt
import numpy as np
from scipy.linalg import expm, solve_continuous_are

import cotree

scene = cotree.load("cart-pole")
model = scene.compile()
print(model.states)

# %%
# The pendulum is upright at zero. The model is linearised about this point. A linear quadratic
# regulator gives the gains of a state feedback.
linear = model.linearize(y=np.zeros(4))
Q, R = np.diag([1.0, 10.0, 0.1, 0.1]), np.array([[0.1]])
P = solve_continuous_are(linear.A, linear.B, Q, R)
K = np.linalg.solve(R, linear.B.T @ P)[0]
names = ["k_x", "k_angle", "k_v", "k_omega"]
gains = dict(zip(names, K.tolist(), strict=True))
print({name: round(value, 3) for name, value in gains.items()})

# %%
# The law contains states and gains. Because the scene does not declare the gains, their values are
# passed as parameters of the run. The expression is compiled into the model when it is first used.
law = " ".join(f"- {k}*{x}" for k, x in zip(names, model.states, strict=True))
print("push =", law)
t = np.linspace(0, 5, 251)
tilted = {"hinge.theta": np.radians(20)}
run = model.simulate((0, 5), t, inputs={"push": law}, parameters=gains, initial=tilted)
assert abs(run["hinge.theta"][-1]) < 1e-3  # ten time constants of 0.5 s

# %%
# For sensitivities to a gain, the closed loop is compiled as a separate scene without an input. Its
# poles are the eigenvalues of :math:`A - B K`.
closed = scene.with_inputs({"push": law}, gains).compile(["k_angle"])
A_closed = linear.A - linear.B @ K[None, :]
assert np.max(np.abs(closed.linearize(y=np.zeros(4)).A - A_closed)) < 1e-12  # rounding
nonlinear = closed.simulate((0, 5), t, initial=tilted)

# %%
# Near the upright position, the solution has a closed form. The states satisfy :math:`x' = (A - B
# K) x`. The sensitivity :math:`s` to the second gain satisfies :math:`s' = (A - B K) s - B x_2`. A
# single matrix exponential gives both.
n, second = 4, np.eye(4)[[1]]
both = np.block([[A_closed, np.zeros((n, n))], [-linear.B @ second, A_closed]])
start = np.concatenate([second[0] * 1e-4, np.zeros(n)])
exact = np.array([(expm(both * at) @ start)[n] for at in t])
near = closed.simulate((0, 5), t, initial={"hinge.theta": 1e-4}, rtol=1e-10, atol=1e-14)
found = near.sensitivity("rail.s", "k_angle")
worst = np.max(np.abs(found - exact)) / np.max(np.abs(exact))
print(f"d(rail.s)/d(k_angle): largest difference from the closed form {worst:.1e} of its size")
assert worst < 1e-7  # terms of third order: the square of the angle, times ten

fig, (top, bottom) = plt.subplots(2, 1, figsize=(7, 5), sharex=True)
top.plot(t, np.degrees(nonlinear["hinge.theta"]), label="angle of the rod [deg]")
top.plot(t, 100 * nonlinear["rail.s"], label="position of the cart [cm]")
top.plot(t, nonlinear["push"], label="force on the cart [N]")
top.legend()
scale = np.radians(20) / 1e-4
bottom.plot(t, 1e3 * nonlinear.sensitivity("rail.s", "k_angle"), label="from 20°")
bottom.plot(t, 1e3 * scale * exact, "--", label="linear closed form")
bottom.set(xlabel="time [s]", ylabel="by k_angle [mm per N/rad]")
bottom.legend()
plt.show()
