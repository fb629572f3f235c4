"""Properties of every scene: balances of momentum and energy, and independence of the frame."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from bare_models import evaluated
from fast_and_slow import cases, seeds
from newton_euler import NewtonEuler
from random_scenes import random_loop, random_mechanism, random_scene
from scene_kinematics import COORDINATES, turn
from scene_values import numbers

from cotree import Scene
from cotree.dag.evaluate import evaluate
from cotree.formulation.first_graph import form_first_graph
from cotree.pipeline import draw_graphs
from cotree.scene.expressions import parse
from cotree.scene.graphs import joint_tree

# Sums of a few hundred products, each rounded to 1e-16 of terms no larger than the scale;
# accelerations carry the same roundings times a mass matrix' few decades of condition.
RELATIVE = 1e-11

NODE = ("x", "y", "z", "vx", "vy", "vz", "ax", "ay", "az", "wx", "wy", "wz")
NODE += ("alphax", "alphay", "alphaz", *(f"r{i}{k}" for i in "123" for k in "123"))
WRENCH = ("fx", "fy", "fz", "tx", "ty", "tz")
RIGID = ("arm", "weld")
SILENT = (*RIGID, "rigid_body")
DRIVES = ("torque", "force")


def joints_and_arms(scene):
    return [n for n, e in scene.edges.items() if e.component.name in COORDINATES and n != "tie"]


def with_edges(scene, edges, **changes):
    copy = Scene(scene.name)
    vars(copy).update(vars(scene), edges=edges, outputs={}, **changes)
    return copy


def parameter_values(scene):
    return {name: row.value for name, row in scene.parameters.items()}


def observe_all(scene):
    """Observe every node and what every edge exerts."""
    scene = with_edges(scene, scene.edges)
    for node in scene.nodes[1:]:
        for key in NODE:
            scene.output(f"{node}_{key}", f"{node}.{key}")
    for name, edge in scene.edges.items():
        for key in WRENCH if edge.component.name not in SILENT else ():
            scene.output(f"{name}_{key}", f"{name}.{key}")
    return scene


class Observed:
    """Vectors of nodes and edges at one time; the ground is at rest."""

    def __init__(self, scene, value_by_name):
        self.scene, self.values = scene, value_by_name

    def vector(self, owner, kind=""):
        return np.array([self.values.get(f"{owner}_{kind}{k}", 0.0) for k in "xyz"])

    def bodies(self):
        """Node, mass and inertia about the ground's axes of every body."""
        known = parameter_values(self.scene)
        for edge in self.scene.edges.values():
            if edge.component.name == "rigid_body":
                node = edge.nodes[1]
                own = np.asarray(numbers(edge.fields["inertia"], known))
                tensor = own if own.ndim == 2 else np.diag(np.broadcast_to(own, 3))
                rows = [[self.values[f"{node}_r{i}{k}"] for k in "123"] for i in "123"]
                mass, axes = numbers(edge.fields["mass"], known), np.array(rows)
                yield node, mass, axes @ tensor @ axes.T

    def momenta(self):
        """Linear and angular momentum about the ground's origin, one after the other."""
        total = np.zeros(6)
        for node, mass, inertia in self.bodies():
            push = mass * self.vector(node, "v")
            total[:3] += push
            total[3:] += np.cross(self.vector(node), push) + inertia @ self.vector(node, "w")
        return total

    def balances(self):
        """Terms of force and moment about the ground's origin, of each cluster of arms."""
        of, known = clusters(self.scene), parameter_values(self.scene)
        gravity, terms = numbers(self.scene.gravity, known), {}

        def add(node, force, torque=0.0):
            moment = np.cross(self.vector(node), force) + torque
            terms.setdefault(of[node], []).append(np.concatenate([force, moment]))

        for node, mass, inertia in self.bodies():
            omega = self.vector(node, "w")
            turned = inertia @ self.vector(node, "alpha") + np.cross(omega, inertia @ omega)
            add(node, mass * (gravity - self.vector(node, "a")), -turned)
        for name, edge in self.scene.edges.items():
            if edge.component.name in SILENT:
                continue
            first, second = edge.nodes
            force, torque = self.vector(name, "f"), self.vector(name, "t")
            add(second, force, torque)
            # The first node's body gets the opposite, at the second node's place.
            lever = self.vector(second) - self.vector(first)
            add(first, -force, -torque - np.cross(lever, force))
        terms.pop(of["ground"], None)
        return {cluster: np.array(rows) for cluster, rows in terms.items()}


def clusters(scene):
    """One node for each set of nodes that arms and welds join."""
    of = {node: node for node in scene.nodes}
    for edge in scene.edges.values():
        if edge.component.name in RIGID:
            old, new = of[edge.nodes[1]], of[edge.nodes[0]]
            of = {node: new if cluster == old else cluster for node, cluster in of.items()}
    return of


# ---- the mass matrix


@pytest.mark.sampled(5)
@pytest.mark.parametrize("seed", seeds(7, 20))
def test_the_mass_matrix_is_that_of_the_kinetic_energy(seed):
    scene = random_mechanism(seed)
    tree = joints_and_arms(scene)
    check_mass_matrix(scene, tree, NewtonEuler(scene, tree).start, seed)


@pytest.mark.sampled(2)
@pytest.mark.parametrize("seed", seeds(4, 6))
def test_the_mass_matrix_of_a_loop_is_that_of_its_tree(seed):
    scene, tree = random_loop(seed)
    check_mass_matrix(scene, tree, NewtonEuler(scene, tree).start, seed)


def check_mass_matrix(scene, tree, start, seed):
    oracle = NewtonEuler(scene, tree)
    rng = np.random.default_rng(seed)
    q = oracle.moved(oracle.split(start)[0], rng.uniform(-0.5, 0.5, len(oracle.rates)))
    joint = joint_tree(scene, draw_graphs(scene, tree)[1])
    n = len(oracle.rates)
    for own_axes in ((), tuple(range(1, 40))):
        first = form_first_graph(scene, joint, own_axes)
        state = [*q, *rng.uniform(-1.0, 1.0, n)]
        values = {s.symbol: float(v) for s, v in zip(first.states, state, strict=True)}
        for name, symbol in first.system.parameters.items():
            values[symbol] = scene.parameters[name].value
        matrix = np.array([evaluate(row[:n], values) for row in first.matrix[:n]])
        assert np.array_equal(matrix, matrix.T)
        assert np.linalg.eigvalsh(matrix).min() > 0.0
        expected = oracle.mass_matrix(q)
        assert np.allclose(matrix, expected, rtol=0, atol=1e-13 * np.abs(expected).max())


# ---- action and reaction


@pytest.mark.sampled(2)
@pytest.mark.parametrize("seed", seeds(4, 10))
def test_what_edges_exert_moves_every_body_of_a_tree(seed):
    scene = random_mechanism(seed, n_bodies=3)
    check_balances(scene, joints_and_arms(scene))


@pytest.mark.parametrize("seed", seeds(2, 6))
def test_what_edges_exert_moves_every_body_of_a_loop(seed):
    check_balances(*random_loop(seed))


@pytest.mark.parametrize("seed", seeds(1, 3))
def test_what_edges_exert_moves_every_body_of_a_plane_loop(seed):
    check_balances(*random_loop(seed, is_planar=True))


# Other seeds have springs about joints whose angle a chord does not know.
@pytest.mark.parametrize("seed", cases([0], [1, 3, 4, 8, 9]))
def test_what_edges_exert_moves_every_body_in_absolute_coordinates(seed):
    scene = random_scene(seed, 2)
    bodies = [n for n, e in scene.edges.items() if e.component.name in SILENT]
    check_balances(scene, bodies)


def check_balances(scene, tree):
    """Newton's and Euler's law of each cluster, and so of the whole."""
    scene = observe_all(scene)
    model = evaluated(scene, tree)
    found = model.output_values(0.3, model.start(0.3).y)
    balances = Observed(scene, dict(zip(model.outputs, found, strict=True))).balances()
    assert len(balances) >= 2
    for name, terms in balances.items():
        scale = np.abs(terms).sum(axis=0).max()
        assert np.abs(terms.sum(axis=0)).max() <= RELATIVE * scale, name


def floating():
    """Three bodies in free space that only act on each other, by joints and by laws."""
    scene = Scene("floating")
    tensor = [[0.5, 0.02, -0.03], [0.02, 0.4, 0.01], [-0.03, 0.01, 0.6]]
    start = {"x": 0.2, "y": -0.1, "vx": 0.4, "vz": -0.3, "w1": 1.0, "w2": -0.5, "w3": 0.7}
    scene.edge("m0", "rigid_body", "ground", "P", mass=2.0, inertia=tensor, initial=start)
    scene.edge("a0", "arm", "P", "H", vector=[0.3, 0.2, 0.1])
    scene.edge("ball", "spherical", "H", "K", initial={"rotation": [0.4, -0.3, 0.2], "w2": 2.0})
    scene.edge("a1", "arm", "K", "Q", vector=[0.0, 0.4, -0.2])
    scene.edge("m1", "rigid_body", "ground", "Q", mass=1.0, inertia=[0.1, 0.15, 0.2])
    scene.edge("pin", "revolute", "Q", "R", axis=[1, 0.5, 0], stiffness=2.0, damping=0.1)
    scene.edge("a2", "arm", "R", "S", vector=[0.5, 0.0, 0.1])
    scene.edge("m2", "rigid_body", "ground", "S", mass=0.7, inertia=[0.1, 0.1, 0.05])
    away = {"x": -1.0, "z": 0.5, "vy": 0.2, "w3": -1.0, "rotation": [0.1, 0.2, 0.3]}
    scene.edge("m3", "rigid_body", "ground", "T", mass=1.5, inertia=[0.3, 0.2, 0.2], initial=away)
    scene.edge("line", "spring", "T", "H", stiffness=8.0, free_length=0.4, damping=0.3)
    scene.edge("guide", "damper", "T", "S", axis=[0.3, 1, 0], damping=0.5)
    scene.edge("push", "force", "T", "Q", force=["sin(3*t)", 0.2, 0.1])
    scene.edge("twist", "torque", "S", "T", torque=[0.1, "cos(t)", 0])
    return observe_all(scene)


@pytest.mark.slow
@pytest.mark.compiler
def test_momenta_are_constant_where_only_internal_forces_act():
    scene = floating()
    model = scene.compile(optimize="-O0")
    times = np.linspace(0.0, 2.0, 9)
    result = model.simulate((0.0, 2.0), times, "dop853", rtol=1e-13, atol=1e-13, throw=True)
    rows = result.output_values.T
    momenta = [
        Observed(scene, dict(zip(result.outputs, row, strict=True))).momenta() for row in rows
    ]
    # Laws change each body's momentum by some units. Steps, of which there are some hundreds,
    # err by 1e-13 each.
    assert np.ptp(momenta, axis=0).max() <= 1e-10
    assert np.ptp(result["S_vx"]) > 0.1


# ---- frames


def drawn_from(scene, rotation):
    """The scene on a base that is turned in the ground, with gravity turned as well."""
    gravity = numbers(scene.gravity, parameter_values(scene))
    copy = Scene(scene.name, gravity=(rotation @ gravity).tolist())
    copy.edge("turned", "arm", "ground", "base", vector=[0, 0, 0], rotation=rotation.tolist())
    edges = dict(copy.edges)
    for name, edge in scene.edges.items():
        ends = tuple("base" if node == "ground" else node for node in edge.nodes)
        is_body = edge.component.name == "rigid_body"
        edges[name] = edge if is_body else replace(edge, nodes=ends)
    return with_edges(scene, edges, gravity=copy.gravity)


def with_scalars(scene):
    """Observe what no frame changes; the scene's first and last nodes are a distance apart."""
    near, far = scene.nodes[-1], next(n for n in scene.nodes if n.startswith("C"))
    scene.output("kinetic", "energy.kinetic")
    apart = " + ".join(f"({near}.{k} - {far}.{k})**2" for k in "xyz")
    scene.output("apart", f"sqrt({apart})")
    return scene


@pytest.mark.sampled(2)
@pytest.mark.parametrize("seed", seeds(3, 10))
def test_a_tree_moves_the_same_in_every_frame(seed):
    check_frames(random_mechanism(seed, n_bodies=3), None, seed)


@pytest.mark.parametrize("seed", seeds(1, 6))
def test_a_loop_moves_the_same_in_every_frame(seed):
    check_frames(*random_loop(seed), seed)


def check_frames(scene, tree, seed):
    tree = tree or joints_and_arms(scene)
    rotation = turn(np.random.default_rng(seed).normal(size=3), 1.0 + seed)
    found = []
    for drawn, more in (
        (with_edges(scene, scene.edges), []),
        (drawn_from(scene, rotation), ["turned"]),
    ):
        model = evaluated(with_scalars(drawn), [*tree, *more])
        start = model.start(0.3).y
        found.append([start, model.rhs(0.3, start), model.output_values(0.3, start)])
    for one, other in zip(*found, strict=True):
        assert np.allclose(one, other, rtol=0, atol=RELATIVE * max(1.0, np.abs(one).max()))


def tumbling(rotation):
    """Two bodies in absolute coordinates and a ball, with everything in the ground turned."""

    def along(*components):
        return (rotation @ components).tolist()

    scene = Scene("tumbling", gravity=along(1.0, -9.0, 2.0))
    place, anchor = np.array([0.5, 0.2, -0.3]), np.array([-0.4, 0.6, 0.1])
    speed = np.cross([0.3, -0.8, 0.5], place - anchor)
    pose = rotation @ turn([1.0, 2.0, -0.5], 0.8)
    start = {"rotation": pose.tolist(), "w1": 0.4, "w2": -1.1, "w3": 0.6}
    start |= dict(zip("xyz", along(*place), strict=True))
    start |= dict(zip(("vx", "vy", "vz"), along(*speed), strict=True))
    scene.edge("m0", "rigid_body", "ground", "P", mass=2.0, inertia=[0.3, 0.4, 0.5], initial=start)
    scene.edge("a0", "arm", "P", "H", vector=[0.3, 0.2, 0.1])
    scene.edge("ball", "spherical", "H", "K", initial={"rotation": [0.4, -0.3, 0.2], "w2": 2.0})
    scene.edge("a1", "arm", "K", "Q", vector=[0.0, 0.4, -0.2])
    scene.edge("m1", "rigid_body", "ground", "Q", mass=1.0, inertia=[0.1, 0.15, 0.2])
    scene.edge("at", "arm", "ground", "A", vector=along(*anchor))
    length = float(np.linalg.norm(place - anchor))
    scene.edge("rod", "distance", "A", "P", length=length)
    scene.edge("line", "spring", "A", "Q", stiffness=8.0, free_length=0.4, damping=0.3)
    scene.edge("guide", "damper", "ground", "Q", axis=along(0.3, 1, 0.2), damping=0.5)
    scene.edge("push", "force", "ground", "K", force=along(2.0, 0.2, -1.0))
    scene.edge("twist", "torque", "ground", "P", torque=along(0.1, 0.5, 0))
    for name in ("rod", "ball"):
        size = " + ".join(f"{name}.f{k}**2" for k in "xyz")
        scene.output(f"of_{name}", f"sqrt({size})")
    scene.output("kinetic", "energy.kinetic")
    return scene


@pytest.mark.slow
def test_absolute_coordinates_move_the_same_in_every_frame():
    rotation = turn([0.3, -1.0, 0.7], 2.2)
    plain, turned = (evaluated(tumbling(r)) for r in (np.eye(3), rotation))
    starts = plain.start().y, turned.start().y
    values = [model.output_values(0.0, y) for model, y in zip((plain, turned), starts, strict=True)]
    assert np.allclose(*values, rtol=RELATIVE, atol=0)
    rates = plain.rhs(0.0, starts[0]), turned.rhs(0.0, starts[1])
    index = {name: i for i, name in enumerate(plain.states)}
    shared = [i for name, i in index.items() if ".w" in name or name.startswith("ball")]
    moving = [index[f"m0.v{k}"] for k in "xyz"]
    scale = np.abs(rates[0]).max()
    assert np.allclose(rates[0][shared], rates[1][shared], rtol=0, atol=RELATIVE * scale)
    assert np.allclose(rotation @ rates[0][moving], rates[1][moving], atol=RELATIVE * scale)


# ---- energy


def without(scene, kinds, fields):
    """The scene without edges of some types and with some fields zero, its energy observed."""
    edges = {}
    for name, edge in scene.edges.items():
        if edge.component.name not in kinds:
            zeros = {key: parse(0.0, key) for key in edge.fields if key in fields}
            edges[name] = replace(edge, fields={**edge.fields, **zeros})
    copy = with_edges(scene, edges, inputs={})
    copy.output("kinetic", "energy.kinetic")
    copy.output("energy", "energy.kinetic + energy.potential")
    return copy


def energies(scene, tree):
    model = scene.compile(tree=tree, optimize="-O0")
    times = np.linspace(0.0, 1.0, 41)
    result = model.simulate((0.0, 1.0), times, "dop853", rtol=1e-12, atol=1e-12, throw=True)
    return result["energy"], result["kinetic"].max()


def tree_or_loop(seed):
    if seed % 2:
        return random_loop(seed)
    scene = random_mechanism(seed, n_bodies=2)
    return scene, joints_and_arms(scene)


@pytest.mark.sampled(1)
@pytest.mark.compiler
@pytest.mark.parametrize("seed", seeds(2, 4))
def test_energy_is_kept_where_nothing_dissipates_or_drives(seed):
    scene, tree = tree_or_loop(seed)
    scene = without(scene, ("damper", "force", "torque"), ("damping", *DRIVES))
    energy, size = energies(scene, tree)
    # A step errs by 1e-12 of states of order ten; a few hundred of them add up.
    assert np.ptp(energy) <= 1e-9 * max(1.0, size)


@pytest.mark.sampled(2)
@pytest.mark.compiler
@pytest.mark.parametrize("seed", seeds(1, 4))
def test_energy_falls_where_dampers_act(seed):
    scene, tree = tree_or_loop(seed)
    energy, size = energies(without(scene, ("force", "torque"), DRIVES), tree)
    assert np.diff(energy).max() <= 1e-9 * max(1.0, size)  # as above
    assert energy[-1] < energy[0] - 1e-6 * max(1.0, size)
