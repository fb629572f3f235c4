"""
Optimal damping with exact gradients
====================================

The optimal damper minimises the integral of the squared displacement of a mass. A capacitor
computes the integral, and the sensitivity of its voltage is the gradient. SciPy's ``minimize``
receives both from one run.
"""

import math

import matplotlib.pyplot as plt
import numpy as np
from scipy.optimize import minimize

import cotree

m, k = 1.5, 60.0
scene = cotree.Scene("damper")
scene.parameter("c", 3.0, unit="N s/m")
joint = {"axis": [1, 0, 0], "stiffness": k, "damping": "c", "initial": {"s": 1.0}}
scene.edge("j", "prismatic", "ground", "A", **joint)
scene.edge("body", "rigid_body", "ground", "A", mass=m)
scene.edge("square", "current_source", "ground", "sum", current="j.s**2")
scene.edge("cost", "capacitor", "sum", "ground", capacitance=1.0)
model = scene.compile(["c"])

seen = []


def cost(x):
    """Return the integral and its derivative with respect to the damping."""
    result = model.simulate((0, 40), method="dop853", rtol=1e-10, atol=1e-12, parameters=x)
    value, slope = result["cost.v"][-1], result.sensitivity("cost.v", "c")[-1]
    seen.append((x[0], value, slope))
    return value, np.array([slope])


found = minimize(cost, [3.0], jac=True, method="L-BFGS-B", options={"ftol": 1e-15, "gtol": 1e-9})

w = math.sqrt(k / m)
grid = np.linspace(2.5, 25, 300)
ratio = grid / (2 * math.sqrt(k * m))
plt.plot(grid, (ratio + 1 / (4 * ratio)) / w, label="closed form")
c, value, slope = np.array(seen).T
for at in range(min(4, len(c))):
    near = c[at] + np.array([-1.0, 1.0])
    plt.plot(near, value[at] + slope[at] * (near - c[at]), color="tab:red", lw=2.5, alpha=0.6)
plt.plot(c, value, "o", ms=5, color="tab:red", label="runs, with their gradients")
plt.xlabel("damping [N s/m]")
plt.ylabel("integral of s² [m² s]")
plt.legend()
plt.show()

# %%
# The integral is :math:`(\zeta + 1/(4\zeta))/\omega`. Its minimum is at :math:`\zeta = 1/2`, which
# means :math:`c = \sqrt{k m}` (K. Ogata, *Modern Control Engineering*, on the integral of squared
# error). The optimiser stops at a gradient of 1e-9. With a curvature of 2e-3 the damping is then
# accurate to 1e-6.
exact = math.sqrt(k * m)
print(f"c = {found.x[0]:.7f} N s/m after {found.nfev} runs, closed form {exact:.7f} N s/m")
assert abs(found.x[0] - exact) < 1e-5
