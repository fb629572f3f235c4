"""
Linear graph of a scene
=======================

Nodes are frames or points, edges are components, and the tree (bold) determines the unknowns. The
cutsets and circuits of the tree are the balance and compatibility equations of the system.
"""

import numpy as np

import cotree

report = cotree.load("slider-pendulum").graph()
figure = report.draw()

# %%
# Each branch of the tree has a cutset: the edges that connect the two parts into which it divides
# the tree. Each chord has a circuit.
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
