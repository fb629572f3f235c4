"""
Verification of a recommended method
====================================

This example finds the fastest method for an error of 1e-6 of the states and sensitivities of a
given scene. It then verifies the errors in the report. The scene is a mass on a spring, whose
motion and sensitivity have a closed form.
"""

import matplotlib.pyplot as plt
import numpy as np

import cotree

scene = cotree.Scene("oscillator")
scene.parameter("k", 9.0, unit="N/m")
scene.edge("j", "prismatic", "ground", "A", axis=[1, 0, 0], stiffness="k", initial={"s": 1.0})
scene.edge("body", "rigid_body", "ground", "A", mass=1.0)

methods, tolerances = ["dopri5", "dop853", "rodas5"], [1e-4, 1e-6, 1e-8, 1e-10]
report = cotree.bench(scene, ["k"], methods, tolerances, repeats=5, t_end=10.0)
best = report.recommended(1e-6)
print(f"recommended for 1e-6: {best.method} at rtol {best.rtol:g}, atol {best.atol:g}")

# %%
# Every run of the report is repeated at new times. The results are compared with s = cos(ω t),
# ω² = k / m, and ∂s/∂k = −t sin(ω t) / (2 ω).
model = scene.compile(["k"])
t = np.sort(np.random.default_rng(1).uniform(0, 10, 500))
exact = np.array([np.cos(3 * t), -t * np.sin(3 * t) / 6])


def true_error(row) -> float:
    """Largest error of position and sensitivity, as a share of their size or of one."""
    run = model.simulate((0, 10), t, method=row.method, rtol=row.rtol, atol=row.atol)
    found = np.array([run["j.s"], run.sensitivity("j.s", "k")])
    return np.max(np.abs(found - exact) / np.maximum(1, np.max(np.abs(exact), axis=1))[:, None])


errors = {(row.method, row.rtol): true_error(row) for row in report.rows if row.success}
for method, marker in zip(methods, "osd", strict=True):
    rows = [row for row in report.rows if row.method == method and row.success]
    x = [errors[row.method, row.rtol] for row in rows]
    plt.loglog(x, [1e3 * row.seconds for row in rows], marker=marker, mfc="none", label=method)
chosen = errors[best.method, best.rtol]
plt.loglog(chosen, 1e3 * best.seconds, "o", ms=14, mfc="none", c="0.3", label="recommended")
plt.axvline(1e-6, c="0.7", lw=1)
plt.gca().invert_xaxis()
plt.xlabel("true error")
plt.ylabel("time of a run [ms]")
plt.legend()
plt.show()

# %%
# The recommended run has the requested accuracy.
print(f"true error {chosen:.1e}")
assert chosen <= 1e-6
