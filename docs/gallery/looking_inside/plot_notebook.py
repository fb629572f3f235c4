"""
Tables in a notebook
====================

A notebook displays a scene, a model, a result or a linearisation as a table if it is the last line
of a cell. This page shows these tables for a DC motor at a constant voltage.
"""

import numpy as np

import cotree

scene = cotree.Scene("motor")
scene.parameter("R", 1.0, unit="ohm", doc="resistance of the winding")
scene.parameter("k", 0.1, unit="N m/A", doc="torque constant")
scene.input("u", 12.0, unit="V")
scene.edge("V", "voltage_source", "a", "ground", voltage="u")
ports = {"electrical": ["a", "ground"], "shaft": ["ground", "s"]}
scene.edge("M", "dc_motor", **ports, resistance="R", inductance=0.01, constant="k")
scene.edge("J", "rotational_inertia", "ground", "s", inertia=0.001)
scene.edge("b", "rotational_damper", "ground", "s", damping=0.0005)
scene.output("speed", "M.w")
scene

# %%
# A model lists its contents and its methods.
model = scene.compile(["R"])
model

# %%
# A result lists the initial value, the final value and the range of each quantity.
result = model.simulate((0, 0.6), rtol=1e-6)
result

# %%
# Curves are smooth, although the method takes only a few steps.
print(len(result.t), "points")
figure = result.plot(["speed"])

# %%
# A linearisation displays its matrices with the names of states and inputs.
linear = model.linearize()
linear

# %%
# The characteristic polynomial of the motor is L J s² + (R J + L b) s + R b + k².
exact = np.roots([0.01 * 0.001, 1.0 * 0.001 + 0.01 * 0.0005, 1.0 * 0.0005 + 0.1**2])
error = max(abs(linear.eigenvalues - exact[np.lexsort((-exact.imag, -exact.real))]))
print(f"largest error of an eigenvalue {error:.1e} 1/s")
assert error < 1e-9
