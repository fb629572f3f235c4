"""
A motor drive fitted to two records
===================================

A DC motor drives a flywheel. The motor constant, the inertia and the friction are estimated from
two noisy records of speed and current. The voltage is a step in the first record and a wave in the
second. The standard deviation of the noise is unknown.
"""

import matplotlib.pyplot as plt
import numpy as np

import cotree

scene = cotree.Scene("motor-drive")
scene.parameter("K", 0.05, unit="N m/A", doc="motor constant")
scene.parameter("J", 2.5e-4, unit="kg m^2", doc="inertia")
scene.parameter("d", 1e-4, unit="N m s/rad", doc="friction of the bearing")
scene.input("voltage", 12.0, unit="V")
scene.edge("V", "voltage_source", "p", "ground", voltage="voltage")
ports = {"electrical": ["p", "ground"], "shaft": ["ground", "shaft"]}
scene.edge("M", "dc_motor", **ports, resistance=0.5, inductance=1.5e-3, constant="K")
scene.edge("rotor", "rotational_inertia", "ground", "shaft", inertia="J")
scene.edge("bearing", "rotational_damper", "ground", "shaft", damping="d")

# %%
# Simulated records replace measurements: they are runs with other parameters, with noise of 20 rpm
# and 0.3 A.
true = {"K": 0.06, "J": 3e-4, "d": 2e-4}
model, t, rng = scene.compile(), np.linspace(0, 0.5, 51), np.random.default_rng(4)


def record(voltage):
    run = model.simulate((0, 0.5), t, parameters=true, inputs={"voltage": voltage})
    noise = rng.standard_normal((2, t.size))
    return {
        "time": t,
        "speed [rpm]": run["rotor.w"] * 30 / np.pi + 20 * noise[0],
        "current [A]": run["M.i"] + 0.3 * noise[1],
    }


# %%
# The fit needs one experiment for each record, the quantities that the columns measure, and bounds.
voltages = [12.0, "6 + 4*sin(20*t)"]
experiments = [
    cotree.Experiment(
        record(voltage),
        inputs={"voltage": voltage},
        observables={"speed": "rotor.w", "current": "M.i"},
    )
    for voltage in voltages
]
result = cotree.fit(
    scene,
    experiments,
    parameters={"K": (0.01, 1, "log"), "J": (1e-5, 1e-2, "log"), "d": (1e-6, 1e-2, "log")},
)
print(result)

# %%
# The figure shows the data with the computed curves, and the residuals.
result.plot()
plt.show()

# %%
# All starts find the same optimum.
result.plot_waterfall()
plt.show()

# %%
# Each true value is within four standard errors of its estimate. In 16,000 such intervals, all but
# one contain the true value.
for name, value in true.items():
    error = result.standard_errors[name]
    print(f"{name} = {result.parameters[name]:.5g} ± {error:.2g}, true {value:g}")
    assert abs(result.parameters[name] - value) < 4 * error
assert all(start.is_converged for start in result.starts)
