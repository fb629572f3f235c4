"""
Choice of the next measurements
===============================

An enzyme converts a substrate at a rate that saturates. Early samples contain little information
about the Michaelis-Menten constant. Exact sensitivities predict the best times of the next samples
and the expected gain in accuracy.
"""

import matplotlib.pyplot as plt
import numpy as np
from scipy.special import lambertw

import cotree

scene = cotree.Scene("enzyme")
scene.parameter("V", 1.0, unit="mol/(m^3 s)", doc="largest rate")
scene.parameter("K", 1.0, unit="mol/m^3", doc="constant of Michaelis and Menten")
scene.edge("S", "species", "S", "ground", volume=1.0, initial={"c": 10.0})
scene.edge("P", "species", "P", "ground", volume=1.0)
scene.edge("E", "reaction", reactants=["S"], products=["P"], rate="V/(K + S.c)")

# %%
# The data are 16 samples within the first six seconds. They come from the closed form of S. Schnell
# and C. Mendoza (*Journal of Theoretical Biology* 187, 1997), with noise of 0.1 mol/m³.
true, noise, rng = {"V": 1.2, "K": 1.5}, 0.1, np.random.default_rng(0)


def exact(t):
    return true["K"] * lambertw(10 / true["K"] * np.exp((10 - true["V"] * t) / true["K"])).real


def fit(t, values):
    run = cotree.Experiment({"t": t, "S.c": values}, noise=noise)
    return cotree.fit(scene, run, {"V": (0.1, 10, "log"), "K": (0.01, 100, "log")})


t = np.linspace(0.375, 6, 16)
samples = exact(t) + noise * rng.standard_normal(t.size)
before = fit(t, samples)
print(before)

# %%
# Three more samples are possible at 80 candidate times. They should minimise the confidence
# interval of K. The best times are late, when little substrate is left.
plan = before.next_measurements({"S.c": np.linspace(0.25, 20, 80)}, 3, criterion="K", repeat=False)
print(plan)

# %%
# The three samples are added, and all samples are fitted together.
later = np.sort([row.t for row in plan])
new = exact(later) + noise * rng.standard_normal(later.size)
after = fit(np.append(t, later), np.append(samples, new))
print(after)

# %%
# The figure shows profile likelihoods of K, whose confidence intervals end at the intersections
# with the limit. It also shows predictions with 95 % bands. These bands are computed from random
# draws, because before the additional samples they are too wide for a linear approximation.
fine = np.linspace(0, 20, 161)
fig, (left, right) = plt.subplots(1, 2, figsize=(10, 4), layout="constrained")
profiles = {}
for label, result, color in (("before", before, "C0"), ("after", after, "C1")):
    profile = profiles[label] = result.profile("K")
    low, high = profile.interval
    print(f"K {label}: {low:.3g} to {high:.3g} mol/m³")
    left.semilogx(profile.values, profile.rise, ".", color=color)
    left.semilogx(*profile.curve(), color=color, label=label)
    band = result.bands("S.c", fine, draws=400)
    right.fill_between(fine, band.lower, band.upper, color=color, alpha=0.3, label=label)
    right.plot(fine, band.value, color=color)
left.axhline(profile.limit, color="0.4", lw=1, ls="--", label="limit of 95 %")
left.axvline(true["K"], color="0.4", lw=1, ls=":", label="true")
left.set(xlabel="K [mol/m³]", ylabel="increase of 2 × objective", ylim=(0, 8))
right.plot(t, samples, "k.", ms=4, label="first samples")
right.plot(later, new, "kD", ms=5, mfc="w", label="proposed samples")
right.set(xlabel="time [s]", ylabel="substrate [mol/m³]")
left.legend()
right.legend()
plt.show()

# %%
# Both intervals contain the true value. The relative standard error of K is now small.
for profile in profiles.values():
    assert profile.interval[0] < true["K"] < profile.interval[1]
errors = {
    "before": before.standard_errors["K"] / before.parameters["K"],
    "promised": plan[-1].errors["K"] / before.parameters["K"],
    "after": after.standard_errors["K"] / after.parameters["K"],
}
print(", ".join(f"{name} {value:.3f}" for name, value in errors.items()))
assert errors["after"] < 0.2 < 1.0 < errors["before"]
