"""
Work-precision diagram of a scene
=================================

The fastest method for a required accuracy depends on the scene, the sensitivities and the machine.
``cotree.bench`` measures all methods at several tolerances, with respect to a reference on which
two methods agree.
"""

import numpy as np

import cotree

methods = ["dopri5", "dop853", "rodas5", "LSODA"]
tolerances = [1e-4, 1e-6, 1e-8, 1e-10]
report = cotree.bench("spring-mass-damper", ["k"], methods, tolerances, repeats=5, t_end=1.0)
print(report.summary())

figure = report.plot()

# %%
# The error of a method of order :math:`p` is proportional to a power of the tolerance. The exponent
# is between :math:`p/(p + 1)` and one (E. Hairer, S. P. Nørsett, G. Wanner, *Solving Ordinary
# Differential Equations I*, section II.4). If the tolerance is divided by 100, the error decreases
# by a factor of 10 to 1000.
errors = [row.error for row in report.rows if row.method == "dopri5"]
ratios = np.divide(errors[:-1], errors[1:])
print("errors of dopri5", *(f"{error:.1e}" for error in errors))
assert np.all((ratios > 10) & (ratios < 1000))
