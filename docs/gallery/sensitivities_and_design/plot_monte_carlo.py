"""
Monte Carlo study with bands
============================

All eight parameters of the paper's slider-pendulum have an uncertainty of 10 %. An ensemble of a
thousand members, spread evenly over the parameter space, shows the distribution of the block's
position. This distribution is compared with a linear estimate from sensitivities.
"""

import time

import matplotlib.pyplot as plt
import numpy as np

import cotree

model = cotree.load("slider-pendulum").compile(cotree.load("slider-pendulum").parameters)
share, n = 0.1, 1024
members = cotree.sample(model, {name: ("relative", share) for name in model.parameters}, n, seed=1)
span = {"t_eval": 201, "rtol": 1e-6, "atol": 1e-8}
model.ensemble((0, 10), {"L": [1.0]}, **span)  # compiles the model once

begun = time.perf_counter()
runs = model.ensemble((0, 10), members, **span)
taken = time.perf_counter() - begun

fig = cotree.bands(runs, ["j1.s", "h2.theta"])
fig.suptitle(f"{n} members with all 8 sensitivities, {1e3 * taken / n:.2f} ms each")
plt.show()

# %%
# A single run at the nominal values gives an estimate, too. To first order, the variance is
# :math:`\sigma^2 = \sum_j (s_j \sigma_j)^2` with the sensitivities :math:`s_j` and the standard
# deviations :math:`\sigma_j` of the parameters. For a uniform distribution within 10 % the standard
# deviation is :math:`0.1\, p_j / \sqrt 3`.
nominal = model.simulate((0, 10), runs["time"].values, rtol=1e-6, atol=1e-8)
deviations = share * np.abs(model.default_parameters) / np.sqrt(3)
slopes = [nominal.sensitivity("j1.s", name) for name in model.parameters]
linear = np.sqrt(sum((s * d) ** 2 for s, d in zip(slopes, deviations, strict=True)))
sampled = runs["j1.s"].std("member")

plt.figure()
plt.plot(runs["time"], sampled, label="members")
plt.plot(runs["time"], linear, "--", label="sensitivities of one run")
plt.xlabel("time [s]")
plt.ylabel("standard deviation of the position [m]")
plt.legend()
plt.show()

# %%
# At first, both agree. Later the members get out of phase. The standard deviation of the ensemble
# then oscillates less than the estimate, which is linear in the phase differences.
early = runs["time"].values < 1.0
apart = np.max(np.abs(sampled.values[early] - linear[early])) / np.max(linear[early])
print(f"{n} members took {taken:.2f} s, {1e3 * taken / n:.2f} ms each")
print(f"in the first second both deviations differ by {100 * apart:.1f} % of the largest")
assert apart < 0.05
