"""
Equations in LaTeX
==================

cotree returns its equations as text, as LaTeX or as SymPy expressions. The equations of the
slider-pendulum are Eq. (8) of Banerjee and McPhee. The equations of its sensitivity graph are Eq.
(9).
"""

import matplotlib.pyplot as plt
import sympy as sp

import cotree

equations = cotree.load("slider-pendulum").equations(sensitivities=["L"])
print(equations)

# %%
# The LaTeX text is an ``align`` environment. The figure shows two of its lines.
body = equations.latex().split(r"\begin{align}")[1].split(r"\end{align}")[0]
rows = [row.replace("&", "").strip(" ,\n") for row in body.split(r"\\")]
figure = plt.figure(figsize=(7.5, 1.7))
for number, row in enumerate(rows[:2]):
    text = row.rstrip(",. ").replace(r"\frac", r"\dfrac")
    figure.text(0.02, 0.7 - 0.45 * number, f"${text}$", fontsize=13)
plt.show()

# %%
# Eq. (8) is copied from the paper. SymPy compares the expressions symbolically: the difference is
# exactly zero.
symbol = equations.symbols
s, theta, theta_dot = (symbol[name] for name in ("j1.s", "h2.theta", "h2.theta_dot"))
s_ddot, theta_ddot = symbol["j1.s_ddot"], symbol["h2.theta_ddot"]
m1, m2, L, r, zeta, k, s0, g = (symbol[n] for n in ("m1", "m2", "L", "r", "zeta", "k", "s0", "g"))
first = m2 * (r**2 / 4 + L**2 / 3) * theta_ddot + m2 * (L / 2) * sp.cos(theta) * s_ddot
first += m2 * g * (L / 2) * sp.sin(theta) + zeta * theta_dot
second = m2 * (L / 2) * sp.cos(theta) * theta_ddot + (m1 + m2) * s_ddot
second += -m2 * (L / 2) * sp.sin(theta) * theta_dot**2 + k * (s - s0)
left = [equation.lhs - equation.rhs for equation in equations.governing]
differences = [sp.simplify(left[0] - second), sp.simplify(left[1] - first)]
print("differences:", differences)
assert differences == [0, 0]
