"""
Inverted pendulum with a linear quadratic regulator
===================================================

This is a typical task of control engineering: linearise a pendulum on a cart about its upright
position, design a state feedback with SciPy and simulate the nonlinear closed loop far from that
position.
"""

import matplotlib.pyplot as plt
import numpy as np
from scipy.linalg import solve_continuous_are

import cotree

M, m, length, g = 1.0, 0.2, 0.5, 9.81


def cart_pole(force: str) -> cotree.Scene:
    """Draw a cart with a rod that stands upright at the angle zero."""
    scene = cotree.Scene("cart-pole", gravity=[0, -g, 0])
    scene.input("push", 0.0, unit="N")
    scene.edge("rail", "prismatic", "ground", "A", axis=[1, 0, 0], force=force)
    scene.edge("cart", "rigid_body", "ground", "A", mass=M)
    scene.edge("hinge", "revolute", "A", "B", axis=[0, 0, 1])
    scene.edge("rod", "arm", "B", "C", vector=[0, length, 0])
    scene.edge("bob", "rigid_body", "ground", "C", mass=m)
    return scene


# %%
# The unstable pole of the open loop follows from the matrices of balance systems in K. J. Åström
# and R. M. Murray, *Feedback Systems* (here without friction and with a point mass).
linear = cart_pole("push").compile().linearize(reduced=True)
print(linear.states, linear.summary(), sep="\n")
unstable = np.max(np.linalg.eigvals(linear.A).real)
exact = np.sqrt((M + m) * g / (M * length))
print(f"unstable pole {unstable:.9f} 1/s, closed form {exact:.9f} 1/s")
assert abs(unstable - exact) < 1e-12  # rounding of an eigenvalue of four by four numbers

# %%
# In the cost function of the regulator, 1 m of the cart has the same weight as 0.3 rad of the rod
# or 3 N of the drive.
Q, R = np.diag([1.0, 10.0, 0.1, 0.1]), np.array([[0.1]])
P = solve_continuous_are(linear.A, linear.B, Q, R)
K = np.linalg.solve(R, linear.B.T @ P)[0]
print("gains", K.round(4))

# %%
# The closed loop is the same scene, with the feedback as the force on the cart. Its poles are
# those of :math:`A - B K`.
law = " - ".join(["push", *(f"{k:.17g}*({x})" for k, x in zip(K, linear.states, strict=True))])
model = cart_pole(law).compile()
poles = np.sort_complex(np.linalg.eigvals(model.linearize(reduced=True).A))
designed = np.sort_complex(np.linalg.eigvals(linear.A - linear.B @ K[None, :]))
print("poles", poles.round(4))
assert np.max(np.abs(poles - designed)) < 1e-9  # rounding, amplified by the condition of the poles

t = np.linspace(0, 5, 501)
fig, (top, bottom) = plt.subplots(2, 1, figsize=(7, 5), sharex=True)
for degrees in (5, 20, 40):
    result = model.simulate((0, 5), t, initial={"hinge.theta": np.radians(degrees)})
    top.plot(t, np.degrees(result["hinge.theta"]), label=f"from {degrees}°")
    bottom.plot(t, result["rail.s"])
top.set(ylabel="angle of the rod [deg]")
bottom.set(xlabel="time [s]", ylabel="position of the cart [m]")
top.legend()
plt.show()
