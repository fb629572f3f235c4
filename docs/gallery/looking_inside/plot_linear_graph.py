"""
Linear graph of a scene
=======================

The nodes of a linear graph are frames or points, and its edges are components. The tree (bold)
determines the unknowns. The f-cutsets of the tree give the balance equations, and its f-circuits
give the compatibility equations.
"""

import numpy as np

import cotree

report = cotree.load("slider-pendulum").graph()
figure = report.draw()

# %%
# If a branch is removed, the tree falls into two parts. The f-cutset of the branch consists of all
# edges between these parts. Each chord defines an f-circuit.
print(report.f_cutset["translation"].summary())
print(report.f_circuit["translation"].summary())

# %%
# By the orthogonality theorem the rows of both matrices are orthogonal (H. E. Koenig, Y. Tokad, H.
# K. Kesavan, *Analysis of Discrete Physical Systems*). The entries are integers, so the products
# are exactly zero.
for domain in report.graphs:
    cutsets, circuits = report.f_cutset[domain], report.f_circuit[domain]
    assert cutsets.columns == circuits.columns
    product = cutsets.matrix @ circuits.matrix.T
    print(domain, "largest entry of the product:", np.max(np.abs(product)))
    assert not product.any()
