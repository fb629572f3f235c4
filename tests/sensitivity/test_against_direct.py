"""Sensitivity graphs against direct differentiation of the assembled equations.

Every joint, constraint and law, in joint and in absolute coordinates, with fields that depend on
parameters; states are projected onto the constraints first. The assembled equations are
differentiated by complex steps, so that nothing that the graphs rest on is used for both sides.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from fast_and_slow import cases
from jointed_scenes import (
    BODY_TREE,
    CHAIN_TREE,
    FIELDS,
    FOUR_BAR_BODIES,
    JOINTS,
    four_bar,
    spatial_chain,
    two_joints,
)

import cotree
from cotree.dag.derivative import tangents, tangents_along
from cotree.dag.evaluate import evaluate
from cotree.dag.nodes import reachable
from cotree.formulation.first_graph import form_first_graph, tree_links
from cotree.program.lower import lower
from cotree.scene.graphs import choose_trees, joint_tree, linear_graphs
from cotree.sensitivity.graphs import form_equations

WANTED = ("a", "b", "g", "m")
TIME = 0.37

# Its square vanishes beside any number: a complex step leaves no error of its own.
STEP = 1e-100

# Both sides are sums of the same products in another order; a few hundred roundings.
CLOSE = {"rtol": 1e-11, "atol": 1e-11}

OWN_AXES = ((), tuple(range(1, 40)))
axes = pytest.mark.parametrize(
    "own_axes",
    [
        pytest.param((), id="parents axes"),
        pytest.param(tuple(range(1, 40)), id="own axes", marks=pytest.mark.slow),
    ],
)


class Assembled:
    """A scene's program with numbers in the place of its symbols."""

    def __init__(self, scene, tree=None, own_axes=(), is_along_tree=False, baumgarte=0.0):
        trees = choose_trees(scene, linear_graphs(scene), tree)
        first = form_first_graph(scene, joint_tree(scene, trees), own_axes, baumgarte)
        if is_along_tree:
            first = replace(first, links=tree_links(first))
        self.equations = form_equations(first, WANTED)
        program = lower(self.equations)
        self.kernels = {k: v.results for k, v in program.kernels.items()}
        self.layout = program.layout
        dag, n = self.equations.dag, len(self.equations.states)
        self.values = {dag.symbol("t", 0): TIME}
        names = [row.name for row in self.equations.parameters]
        self.parameters = {name: dag.symbol("p", i) for i, name in enumerate(names)}
        values = self.equations.parameter_values
        self.values |= dict(zip(self.parameters.values(), values, strict=True))
        s = np.random.default_rng(1).normal(size=len(WANTED) * n)
        self.values |= {dag.symbol("s", i): float(value) for i, value in enumerate(s)}
        for seed in range(12):  # Newton's steps do not close a loop from everywhere
            self.x = 0.7 * np.random.default_rng(seed).normal(size=n)
            self.project()
            if not self.kernels["constraints"] or np.abs(self.of("constraints")).max() < 1e-12:
                return

    def project(self):
        """Take Newton steps, not too long, towards the constraints."""
        self.place()
        for _ in range(30):
            if self.kernels["projection"]:
                step = self.of("projection")
                longest = float(np.abs(step).max())
                self.x = self.x + step * min(1.0, 0.5 / max(longest, 1e-300))
                self.place()
                if longest < 1e-14:
                    return

    def place(self):
        states = zip(self.equations.states, self.x, strict=True)
        self.values |= {state.symbol: float(value) for state, value in states}

    def numbers(self, nodes):
        return np.array([float(np.real(v)) for v in evaluate(list(nodes), self.values)])

    def of(self, kernel):
        return self.numbers(self.kernels[kernel])

    def along(self, kernel, seeds):
        """Differentiate a kernel's results along each seed, by complex steps."""
        nodes = list(self.kernels[kernel])
        order = reachable(nodes, stop=self.values)
        for seed in seeds:
            values = self.values | {
                at: complex(self.values[at], STEP * d) for at, d in seed.items()
            }
            found = evaluate(nodes, values, "complex_", order)
            yield np.array([complex(value).imag for value in found]) / STEP

    @property
    def jacobian(self):
        n, layout = len(self.equations.states), self.layout
        dense, values = np.zeros((n, n)), self.of("jacobian")
        for j in range(n):
            for k in range(layout.column_starts[j], layout.column_starts[j + 1]):
                dense[layout.row_indices[k], j] = values[k]
        return dense

    def seeds(self):
        """Return the seed of each wanted parameter, sensitivities of states taken along."""
        dag, n = self.equations.dag, len(self.equations.states)
        for j, name in enumerate(WANTED):
            states = enumerate(self.equations.states)
            seed = {state.symbol: self.values[dag.symbol("s", j * n + i)] for i, state in states}
            yield seed | {self.parameters[name]: 1.0}


def check(made):
    seeds = [{state.symbol: 1.0} for state in made.equations.states]
    direct = np.array(list(made.along("rhs", seeds))).T
    size = np.abs(direct).max()
    assert np.allclose(made.jacobian / size, direct / size, **CLOSE)
    for kernel, graph in (
        ("rhs", "sensitivity_rhs"),
        ("outputs", "output_sensitivity"),
        ("constraints", "constraint_sensitivity"),
    ):
        if made.kernels[kernel]:
            direct = np.concatenate(list(made.along(kernel, made.seeds())))
            size = 1.0 + np.abs(direct).max()
            assert np.allclose(made.of(graph) / size, direct / size, **CLOSE), graph
    check_constraints(made)


def check_constraints(made):
    """The gradient is that of the rates; accelerations keep values and rates at zero."""
    rows = made.equations.constraints
    if not rows.rows:
        return
    dag, n = made.equations.dag, made.layout.n_coordinates
    assert np.abs(made.of("constraints")).max() < 1e-10, "no state on the constraints was found"
    speeds = made.equations.states[n:]
    by_speed = tangents_along(list(rows.rates), [{v.symbol: dag.one} for v in speeds])
    direct = made.numbers([row.get(i, dag.zero) for row in by_speed for i in range(len(speeds))])
    assert np.allclose(made.of("gradient"), direct, **CLOSE)
    rates = made.of("rhs")
    motion = {
        state.symbol: dag.constant(float(rate))
        for state, rate in zip(made.equations.states, rates, strict=True)
    } | {dag.symbol("t", 0): dag.one}
    held = [value for value in rows.values if value is not None]
    size = 1.0 + np.abs(rates).max()
    assert np.allclose(made.numbers(tangents(held, motion)) / size, 0.0, atol=1e-9)
    assert np.allclose(made.numbers(tangents(list(rows.rates), motion)) / size, 0.0, atol=1e-9)


@pytest.mark.sampled(1)
@axes
@pytest.mark.parametrize("is_inward", [False, True], ids=["outward", "inward"])
@pytest.mark.parametrize("kind", JOINTS)
def test_every_joint_of_a_tree(kind, is_inward, own_axes):
    check(Assembled(two_joints(kind, is_inward), own_axes=own_axes))


# The last body does not reach the point that the others would hold it at; loops of these joints
# are checked against Newton's and Euler's equations in tests/formulation/test_newton_euler.py.
FAR = ("spherical", "revolute", "universal", "weld", "arm", "prismatic", "free", "screw")
# Loops in a plane have some of them too.
IN_PLANE = ("revolute", "prismatic", "slot", "distance", "gear", "knife_edge", "constraint")
NEAR = [kind for kind in FIELDS if kind not in FAR]
TIES = cases(
    [kind for kind in NEAR if kind not in IN_PLANE], [kind for kind in NEAR if kind in IN_PLANE]
)
# What holds or acts on positions and on turns alike.
TIES_OF_BOTH = ["rolling_disc", "knife_edge", "cylindrical", "hardening"]


@pytest.mark.sampled(1)
@axes
@pytest.mark.parametrize("tie", TIES)
def test_every_constraint_and_law(tie, own_axes):
    check(Assembled(spatial_chain(tie), CHAIN_TREE, own_axes))


@pytest.mark.slow
@pytest.mark.parametrize("tie", ["rolling_disc", "bushing", "air_drag", "hardening"])
def test_between_moving_bodies(tie):
    check(Assembled(spatial_chain(tie, "P"), CHAIN_TREE))


@pytest.mark.slow
@pytest.mark.parametrize("tie", ["distance", "slot", "bushing"])
def test_absolute_coordinates_in_space(tie):
    check(Assembled(spatial_chain(tie), BODY_TREE))


@pytest.mark.sampled(2)
@pytest.mark.parametrize("tree", [None, FOUR_BAR_BODIES], ids=["joints", "bodies"])
@pytest.mark.parametrize("tie", IN_PLANE)
def test_planar_loops(tie, tree):
    check(Assembled(four_bar(tie), tree))


BARS, BAR_ARMS = ["A", "B", "C"], ["la", "ca", "lb", "cb", "lc", "cc", "g0"]
CHAIN_ARMS = ["la", "lb", "lc", "g0"]


def separate(translation, rotation, arms):
    return {"translation": [*translation, *arms], "rotation": [*rotation, *arms]}


@pytest.mark.parametrize("tie", ["revolute", "prismatic", "gear", "knife_edge"])
def test_loops_with_trees_of_their_own_for_rotation(tie):
    check(Assembled(four_bar(tie), separate(BARS, ["ba", "bb", "C"], BAR_ARMS)))


@pytest.mark.sampled(1)
@pytest.mark.parametrize(
    ("translation", "rotation"),
    [(["ba", "bb", "bc"], BARS), (BARS, ["A", "B", "tie"]), (["A", "B", "tie"], BARS)],
    ids=["bodies-joints", "turned by the tie", "placed by the tie"],
)
def test_separate_trees_of_a_loop(translation, rotation):
    check(Assembled(four_bar("revolute"), separate(translation, rotation, BAR_ARMS)))


@pytest.mark.slow
@pytest.mark.parametrize(
    "tie", ["bushing", *(pytest.param(tie, marks=pytest.mark.slow) for tie in TIES_OF_BOTH)]
)
def test_separate_trees_in_space(tie):
    mixed = separate(["A", "bb", "C"], ["ba", "B", "bc"], CHAIN_ARMS)
    check(Assembled(spatial_chain(tie), mixed))


@pytest.mark.sampled(1)
@pytest.mark.parametrize("is_inward", [False, True], ids=["outward", "inward"])
@pytest.mark.parametrize(
    "kind",
    [
        "prismatic",
        "spherical",
        *(pytest.param(k, marks=pytest.mark.slow) for k in ("cylindrical", "universal", "planar")),
    ],
)
def test_every_joint_of_separate_trees(kind, is_inward):
    joints, bodies, arms = ["j1", "j2"], ["b1", "b2"], ["w0", "w1", "w2"]
    scene = two_joints(kind, is_inward)
    check(Assembled(scene, separate(joints, bodies, arms)))
    check(Assembled(scene, separate(bodies, joints, arms)))


@pytest.mark.parametrize(
    ("scene", "tree"),
    [
        pytest.param(four_bar("revolute"), None, id="four-bar"),
        pytest.param(spatial_chain("distance"), CHAIN_TREE, id="space", marks=pytest.mark.slow),
    ],
)
def test_elimination_along_the_tree_is_the_same(scene, tree):
    for own_axes in OWN_AXES:
        by_matrix = Assembled(scene, tree, own_axes)
        along = Assembled(scene, tree, own_axes, is_along_tree=True)
        for kernel in ("rhs", "jacobian", "sensitivity_rhs", "outputs", "output_sensitivity"):
            expected = by_matrix.of(kernel)
            size = 1.0 + np.abs(expected).max()
            assert np.allclose(along.of(kernel) / size, expected / size, **CLOSE)


def test_stabilised_constraints_decay_as_baumgarte_says():
    rate = 3.0
    made = Assembled(four_bar("distance"), baumgarte=rate)
    made.x = made.x + 1e-3
    made.place()
    dag, rows = made.equations.dag, made.equations.constraints
    motion = {
        state.symbol: dag.constant(float(value))
        for state, value in zip(made.equations.states, made.of("rhs"), strict=True)
    } | {dag.symbol("t", 0): dag.one}
    (acceleration,) = made.numbers(tangents(list(rows.rates), motion))
    (value,), (speed,) = made.numbers(list(rows.values)), made.numbers(list(rows.rates))
    assert acceleration == pytest.approx(-2 * rate * speed - rate**2 * value, rel=1e-10)


def test_the_angle_of_a_chord_in_space_is_refused_where_it_matters():
    scene = spatial_chain("revolute")
    scene.edges["tie"].fields["stiffness"] = scene.edges["la"].fields["vector"][0]
    with pytest.raises(cotree.FormulationError, match="joint 'tie'"):
        Assembled(scene, CHAIN_TREE)
