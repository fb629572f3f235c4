"""A closed loop of bars, and equations by hand that are appended to it."""

from __future__ import annotations

from dataclasses import replace

from cotree import Scene
from cotree.dag.derivative import tangents
from cotree.equations import State


def four_bar(length=1.2, mass=1.1, rocker=None, **close):
    """A loop of four bars in gravity; redundant by two constraints, as every planar one.

    Its third bar has a length, its bodies a mass, and the rocker's joint further fields. What the
    closing joint is given takes the place of the crank's initial speed.
    """
    scene = Scene("four-bar", gravity=[0, -9.81, 0])
    scene.parameter("a", 0.5)
    start = {"theta": 1.0} | ({} if close else {"theta_dot": 2.0})
    scene.edge("crank", "revolute", "ground", "A", axis=[0, 0, 1], initial=start)
    scene.edge("bar1", "arm", "A", "B", vector=["a", 0, 0])
    scene.edge("coupler", "revolute", "B", "C", axis=[0, 0, 1])
    scene.edge("bar2", "arm", "C", "D", vector=[1.5, 0, 0])
    scene.edge("base", "arm", "ground", "E", vector=[1.6, 0, 0])
    scene.edge("rocker", "revolute", "E", "F", axis=[0, 0, 1], **(rocker or {}))
    scene.edge("bar3", "arm", "F", "G", vector=[length, 0, 0])
    scene.edge("close", "revolute", "D", "G", axis=[0, 0, 1], **close)
    for i, node in enumerate("ACF"):
        scene.edge(f"m{i + 1}", "rigid_body", "ground", node, mass=mass, inertia=0.1 * (i + 1))
    return scene


def with_a_network(equations):
    """Append q' = z - q and 0 = z + z^3 - theta, of which the linkage does not know."""
    dag, n = equations.dag, len(equations.states)
    theta, q, z = equations.states[0].symbol, dag.symbol("x", n), dag.symbol("x", n + 1)
    added = [z - q, z + z**3 - theta]
    zero, one = dag.zero, dag.one

    def extended(row, seed):
        along = dict(enumerate(tangents(added, seed), start=n))
        return replace(row, seed=seed, rates={**row.rates, **along})

    seeds = {q: dag.symbol("s", n), z: dag.symbol("s", n + 1)}
    sensitivities = [extended(row, {**row.seed, **seeds}) for row in equations.sensitivities]
    columns = [extended(row, row.seed) for row in equations.columns]
    nothing = replace(columns[0], rates={}, initial={}, forcing=(zero,) * len(equations.forcing))
    columns += [extended(nothing, {symbol: one}) for symbol in (q, z)]
    states = (State("q", "", q, zero), State("z", "", z, one, is_algebraic=True))
    return replace(
        equations,
        states=(*equations.states, *states),
        rates=(*equations.rates, *added),
        sensitivities=tuple(sensitivities),
        columns=tuple(columns),
        n_network_states=1,
    )
