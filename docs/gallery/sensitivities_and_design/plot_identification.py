"""
Parameter identification from a measurement
===========================================

This example fits the stiffness and damping of a mount to a noisy record. SciPy's ``least_squares``
receives the exact Jacobian of the residuals from the model and converges in a few iterations.
"""

import matplotlib.pyplot as plt
import numpy as np
from scipy.optimize import least_squares

import cotree

m, true = 2.0, {"k": 800.0, "c": 6.0}
scene = cotree.Scene("mount")
scene.parameter("k", 500.0, unit="N/m")
scene.parameter("c", 2.0, unit="N s/m")
joint = {"axis": [1, 0, 0], "stiffness": "k", "damping": "c", "initial": {"s_dot": 1.0}}
scene.edge("mount", "prismatic", "ground", "A", **joint)
scene.edge("body", "rigid_body", "ground", "A", mass=m)
model = scene.compile(["k", "c"])

# %%
# The record is the closed form of a damped oscillation with noise of 1 mm.
t = np.linspace(0, 1.5, 151)
decay = true["c"] / (2 * m)
w = np.sqrt(true["k"] / m - decay**2)
noise = 1e-3 * np.random.default_rng(7).standard_normal(t.size)
record = np.exp(-decay * t) * np.sin(w * t) / w + noise


def run(p):
    return model.simulate((0, t[-1]), t, parameters=p, rtol=1e-9, atol=1e-11)


def residual(p):
    return run(p)["mount.s"] - record


def jacobian(p):
    result = run(p)
    return np.column_stack([result.sensitivity("mount.s", name) for name in ("k", "c")])


fit = least_squares(residual, model.default_parameters, jac=jacobian, x_scale=(500.0, 2.0))
spread = 1e-3 * np.sqrt(np.diag(np.linalg.inv(fit.jac.T @ fit.jac)))
for name, value, sigma in zip(("k", "c"), fit.x, spread, strict=True):
    print(f"{name} = {value:.3f} ± {sigma:.3f}, true {true[name]}; {fit.nfev} runs")

plt.plot(t, 1e3 * record, ".", ms=4, color="0.5", label="record")
fine = np.linspace(0, t[-1], 600)
for label, p in (("first guess", model.default_parameters), ("fit", fit.x)):
    curve = model.simulate((0, t[-1]), fine, parameters=p)["mount.s"]
    plt.plot(fine, 1e3 * curve, "--" if label == "first guess" else "-", label=label)
plt.xlabel("time [s]")
plt.ylabel("displacement [mm]")
plt.legend(loc="lower right", bbox_to_anchor=(1, 1), ncols=3)
plt.show()

# %%
# The estimates must be within three standard deviations of the true values. The standard deviations
# follow from the Jacobian and the noise, as in linear regression.
assert np.all(np.abs(fit.x - [true["k"], true["c"]]) < 3 * spread)
