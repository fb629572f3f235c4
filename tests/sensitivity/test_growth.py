"""Loops side by side: every body meets two constraints, and deriving them looks at no others."""

from __future__ import annotations

import sys

import cotree
from cotree.formulation.first_graph import form_first_graph, tree_links
from cotree.pipeline import trees_to_try
from cotree.program.solved import factorise_bordered
from cotree.sensitivity.graphs import form_equations


def windows(n):
    """A row of n windows of five bars, each bar in the tree: 3 (2 n + 1) speeds."""
    scene = cotree.Scene("windows", gravity=[0, -9.81, 0])
    scene.parameter("L", 1.0)
    tree = []

    def bar(name, node):
        scene.edge(f"{name}_middle", "arm", node, f"{name}_C", vector=["L/2", 0, 0])
        scene.edge(f"{name}_whole", "arm", node, f"{name}_E", vector=["L", 0, 0])
        scene.edge(name, "rigid_body", "ground", f"{name}_C", mass=1.0, inertia="L*L/12")
        tree.extend([name, f"{name}_middle", f"{name}_whole"])

    for i in range(n + 1):
        scene.edge(f"place{i}", "arm", "ground", f"G{i}", vector=[float(i), 0, 0])
        tree.append(f"place{i}")
        scene.edge(f"a{i}", "revolute", f"G{i}", f"v{i}", axis=[0, 0, 1])
        bar(f"V{i}", f"v{i}")
    for i in range(n):
        scene.edge(f"b{i}", "revolute", f"V{i}_E", f"h{i}", axis=[0, 0, 1])
        bar(f"H{i}", f"h{i}")
        scene.edge(f"c{i}", "revolute", f"H{i}_E", f"V{i + 1}_E", axis=[0, 0, 1])
    return scene, tree


def n_calls(act, *arguments):
    """Count the calls of Python's functions: no clock, so that a busy machine changes nothing."""
    count = 0

    def seen(_, event, __):
        nonlocal count
        count += event == "call"

    sys.setprofile(seen)
    try:
        act(*arguments)
    finally:
        sys.setprofile(None)
    return count


def test_deriving_and_eliminating_grow_with_what_is_coupled():
    """From 2 windows to 6 there are 2.6 times the bars, and about 3 times the work."""
    derived, eliminated = [], []
    for n in (2, 6):
        scene, tree = windows(n)
        first = form_first_graph(scene, trees_to_try(scene, tree)[0])
        parts = (first.system.dag, first.matrix, first.is_safe, first.constraints.sizes)
        derived.append(n_calls(form_equations, first, ["L"]))
        eliminated.append(n_calls(factorise_bordered, *parts, tree_links(first)))
    # Where every column looked at every constraint these were 6 times and more.
    assert derived[1] < 4.0 * derived[0]
    assert eliminated[1] < 4.0 * eliminated[0]
