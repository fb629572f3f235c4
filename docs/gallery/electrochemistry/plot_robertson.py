"""
Robertson's reaction over eleven decades of time
================================================

Robertson's problem is a classic test of stiff solvers. The rates of its three reactions differ by
nine orders of magnitude. Species and reactions are components, so sensitivities to the rate
constants are available.
"""

import matplotlib.pyplot as plt
import numpy as np

import cotree

scene = cotree.Scene("robertson")
for name, value in {"k1": 0.04, "k2": 3e7, "k3": 1e4}.items():
    scene.parameter(name, value)
for name, amount in {"A": 1.0, "B": 0.0, "C": 0.0}.items():
    scene.edge(name, "species", name, "ground", volume=1.0, initial={"c": amount})
scene.edge("R1", "reaction", reactants=["A"], products=["B"], rate="k1")
scene.edge("R2", "reaction", reactants=["B", "B"], products=["B", "C"], rate="k2")
scene.edge("R3", "reaction", reactants=["B", "C"], products=["A", "C"], rate="k3")

t = np.concatenate([[0], np.geomspace(1e-6, 1e11, 400)])
result = scene.compile(["k1"]).simulate((0, 1e11), t, method="rodas5", rtol=1e-9, atol=1e-18)

plt.semilogx(t[1:], result["A.c"][1:], label="A")
plt.semilogx(t[1:], 1e4 * result["B.c"][1:], label="10⁴ B")
plt.semilogx(t[1:], result["C.c"][1:], label="C")
plt.semilogx(t[1:], 0.1 * result.sensitivity("C.c", "k1")[1:], "--", lw=1, label="0.1 ∂C/∂k1")
plt.xlabel("time [s]")
plt.ylabel("concentration [mol/m³]")
plt.legend(loc="center left")
plt.show()

# %%
# The *Test Set for Initial Value Problem Solvers* (F. Mazzia and C. Magherini, Bari, release 2.4,
# problem ``rober``) gives A = 2.083340149701255e-8 at the end. Local errors of 1e-9 per step are
# amplified, because A falls by a factor of fifty million.
print(f"A at the end {result['A.c'][-1]:.8e}, published 2.08334015e-08")
assert abs(result["A.c"][-1] / 2.083340149701255e-8 - 1) < 1e-6
