"""Different trees for translation and rotation, against joint coordinates and closed forms.

A joint that is a branch of one graph and a chord of the other has the coordinates of the first and
the constraints of the second. Whatever the trees, the motion, the reactions and the sensitivities
are the same. Sensitivity graphs of such trees are checked against direct differentiation in
tests/sensitivity/test_against_direct.py.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from jointed_scenes import four_bar, spatial_chain, two_joints
from random_scenes import random_loop, random_mechanism
from rod_chain import rod_chain

import cotree
from cotree import Scene, load, register_component
from cotree.choice import choose_first_graph
from cotree.components import Role
from cotree.dag.derivative import tangents
from cotree.dag.evaluate import evaluate
from cotree.formulation.first_graph import form_first_graph
from cotree.pipeline import count_trees, formulate, trees_to_try
from cotree.program.lower import lower
from cotree.scene.expressions import parse
from cotree.scene.graphs import choose_trees, joint_tree, linear_graphs, separate_trees
from cotree.sensitivity.graphs import form_equations

# Both sides are sums of a few hundred products of order one to a hundred, solved with matrices of
# a few decades of condition.
CLOSE = 1e-10

TIME = 0.3


def arms(scene):
    return [n for n, e in scene.edges.items() if e.component.role is Role.ARM]


def separate(scene, translation, rotation):
    return {
        "translation": [*translation, *arms(scene)],
        "rotation": [*rotation, *arms(scene)],
    }


def first_of(scene, tree):
    trees = joint_tree(scene, choose_trees(scene, linear_graphs(scene), tree))
    return form_first_graph(scene, trees)


def observing(scene):
    """The scene with accelerations, velocities, turns and reactions as outputs."""
    variables = ("x", "vy", "ax", "ay", "az", "wz", "alphax", "alphay", "alphaz", "roll")
    for node in scene.nodes[1:]:
        for variable in variables:
            scene.output(f"{node}_{variable}", f"{node}.{variable}")
    for name, edge in scene.edges.items():
        if edge.component.role is Role.JOINT:
            for variable in ("fx", "fy", "fz", "tx", "ty", "tz", "power"):
                scene.output(f"{name}_{variable}", f"{name}.{variable}")
    scene.output("energy", "energy.kinetic + energy.potential")
    return scene


def at_start(scene, tree):
    """Outputs at the initial state, which satisfies the constraints."""
    equations = form_equations(first_of(scene, tree), (), with_columns=False)
    dag = equations.dag
    values = {dag.symbol("t", 0): TIME}
    values |= {dag.symbol("p", i): v for i, v in enumerate(equations.parameter_values)}

    def numbers(nodes):
        return np.array([float(v) for v in evaluate(list(nodes), values)])

    inputs = numbers(equations.input_values)
    values |= {dag.symbol("u", i): float(v) for i, v in enumerate(inputs)}
    start = numbers([state.initial for state in equations.states])
    values |= dict(zip([s.symbol for s in equations.states], start.tolist(), strict=True))
    kernels = lower(equations).kernels
    assert np.abs(numbers(kernels["constraints"].results)).max(initial=0.0) < 1e-10
    outputs = numbers(kernels["outputs"].results)
    return equations, dict(zip(scene.outputs, outputs.tolist(), strict=True))


def check_the_same(scene, joints, tree):
    _, wanted = at_start(scene, joints)
    equations, found = at_start(scene, tree)
    size = 1.0 + max(map(abs, wanted.values()))
    assert found == pytest.approx(wanted, abs=CLOSE * size, rel=CLOSE)
    return equations


def coordinates(equations):
    n = len(equations.states) - len(equations.unknowns) + len(equations.constraints.rows)
    return [state.name for state in equations.states[:n]]


# ---- the paper's indirect coordinates of a double pendulum


def rods(n=2):
    scene, _ = rod_chain(n)
    hinges, bodies = [f"h{i}" for i in range(n)], [f"b{i}" for i in range(n)]
    return scene, separate(scene, hinges, bodies)


def test_a_double_pendulum_has_absolute_angles_and_no_multipliers():
    scene, tree = rods()
    equations = form_equations(first_of(scene, tree), ())
    assert [s.name for s in equations.states] == [
        "b0.theta",
        "b1.theta",
        "b0.theta_dot",
        "b1.theta_dot",
    ]
    assert not equations.constraints.rows
    # The joints' initial values, 0 and 0.1, are those of angles between the rods.
    assert [float(v) for v in evaluate([s.initial for s in equations.states], {})] == [
        0.0,
        0.1,
        0.0,
        0.0,
    ]


def test_a_double_pendulum_moves_as_its_closed_form_says():
    scene, tree = rods()
    equations = form_equations(first_of(scene, tree), ())
    (g, m, length, m2, length2), x = equations.parameter_values, (0.4, -0.9, 1.3, 0.7)
    dag = equations.dag
    values = {dag.symbol("p", i): v for i, v in enumerate(equations.parameter_values)}
    values |= {s.symbol: v for s, v in zip(equations.states, x, strict=True)}
    rhs = lower(equations).kernels["rhs"].results
    found = [float(v) for v in evaluate(list(rhs), values)][2:]
    # Slender rods from the horizontal: kinetic energy of absolute angles.
    a, b, c = m * length**2 / 3 + m2 * length**2, m2 * length2**2 / 3, m2 * length * length2 / 2
    cosine, sine = np.cos(x[0] - x[1]), np.sin(x[0] - x[1])
    matrix = np.array([[a, c * cosine], [c * cosine, b]])
    forces = [
        -c * sine * x[3] ** 2 - g * (m / 2 + m2) * length * np.cos(x[0]),
        c * sine * x[2] ** 2 - g * m2 / 2 * length2 * np.cos(x[1]),
    ]
    assert found == pytest.approx(np.linalg.solve(matrix, forces), rel=1e-13)


# ---- the same accelerations and reactions in any trees


def hinged_rods(**fields):
    """Two rods, with a law in the second hinge, which points inwards."""
    scene = Scene("hinged-rods", gravity=[0, "-g", 0])
    scene.parameter("g", 9.81)
    scene.parameter("a", 0.7)
    z = [0, 0, 1]
    given = {"theta": 0.3, "theta_dot": 0.8}
    scene.edge("h1", "revolute", "ground", "A", axis=z, initial=given)
    scene.edge("r1", "arm", "A", "A2", vector=["a", 0, 0])
    scene.edge("c1", "arm", "A", "C", vector=["a/2", 0.1, 0])
    scene.edge("m1", "rigid_body", "ground", "C", mass="2*a", inertia=[0, 0, 0.2])
    scene.edge("h2", "revolute", "B", "A2", axis=z, initial=given, **fields)
    scene.edge("r2", "arm", "D", "B", vector=[0, "a", 0], rotation=[0, 0, 0.4])
    scene.edge("m2", "rigid_body", "ground", "D", mass=1.5, inertia=[0, 0, 0.1])
    return observing(scene)


HINGE_LAWS = {
    "spring": {"stiffness": "30*a", "free_angle": 0.2},
    "damper": {"damping": "a"},
    "drive": {"torque": "sin(t) + D.vx"},
    "motion": {"motion": "0.3 + 0.8*(t - 0.3) + 2*(t-0.3)**2"},
}


@pytest.mark.parametrize("law", HINGE_LAWS)
def test_what_acts_in_a_joint_acts_on_its_chord(law):
    scene = hinged_rods(**HINGE_LAWS[law])
    joints = ["h1", "h2", *arms(scene)]
    equations = check_the_same(scene, joints, separate(scene, ["h1", "h2"], ["m1", "m2"]))
    assert coordinates(equations) == ["m1.theta", "m2.theta"]
    equations = check_the_same(scene, joints, separate(scene, ["m1", "m2"], ["h1", "h2"]))
    assert coordinates(equations) == ["h1.theta", "m1.x", "m1.y", "h2.theta", "m2.x", "m2.y"]
    assert len(equations.constraints.rows) == 4 + (law == "motion")


@pytest.mark.compiler
def test_motion_and_sensitivities_are_those_of_joint_coordinates():
    scene = hinged_rods(stiffness="30*a", damping="0.3*a")
    scene.outputs.clear()
    register_component("air_drag", lambda speed, c: -c * speed**2, along="velocity")
    scene.edge("drag", "air_drag", "ground", "D", c="a/2")
    scene.output("x", "D.x")
    scene.output("pull", "h2.fy")
    rates = ("theta", "theta_dot")
    ours = scene.compile(
        ["a", "g", *(f"{body}.{rate}" for rate in rates for body in ("m1", "m2"))],
        separate(scene, ["h1", "h2"], ["m1", "m2"]),
    )
    theirs = scene.compile(
        ["a", "g", *(f"{joint}.{rate}" for rate in rates for joint in ("h1", "h2"))],
        ["h1", "h2", *arms(scene)],
    )
    settings = {"t_eval": np.linspace(0.0, 1.0, 5), "rtol": 1e-12, "atol": 1e-12}
    found, known = ours.simulate((0, 1), **settings), theirs.simulate((0, 1), **settings)
    # Errors of the integration: some hundred steps at 1e-12 each, of values up to a hundred.
    close = {"rtol": 1e-9, "atol": 1e-9}
    for name in ("x", "pull"):
        assert np.allclose(found[name], known[name], **close)
        for parameter in ("a", "g"):
            mine, other = (run.sensitivity(name, parameter) for run in (found, known))
            assert np.allclose(mine, other, **close)
        for rate in rates:
            # The first joint turns both rods, the second one, which points inwards, its own back.
            second = found.sensitivity(name, f"m2.{rate}")
            both = found.sensitivity(name, f"m1.{rate}") + second
            assert np.allclose(both, known.sensitivity(name, f"h1.{rate}"), **close)
            assert np.allclose(-second, known.sensitivity(name, f"h2.{rate}"), **close)


GIVEN = {
    "spherical": {"rotation": (0.2, -0.4, 0.5), "w1": 0.7, "w2": -0.4, "w3": 0.9},
    "prismatic": {"s": 0.2, "s_dot": 0.7},
    "cylindrical": {"s": 0.2, "theta": 0.5, "s_dot": 0.7, "theta_dot": -0.4},
}


def started(kind, is_inward):
    """Two bodies on joints of a kind, away from rest."""
    scene = observing(two_joints(kind, is_inward))
    initial = {
        name: tuple(parse(entry, name) for entry in value)
        if isinstance(value, tuple)
        else parse(value, name)
        for name, value in GIVEN[kind].items()
    }
    for name in ("j1", "j2"):
        scene.edges[name] = replace(scene.edges[name], initial=initial)
    return scene


@pytest.mark.sampled(2)
@pytest.mark.parametrize("is_inward", [False, True], ids=["outward", "inward"])
@pytest.mark.parametrize(
    ("kind", "n_rows"), [("spherical", (0, 6)), ("prismatic", (6, 4)), ("cylindrical", (4, 4))]
)
def test_joints_in_space(kind, n_rows, is_inward):
    scene = started(kind, is_inward)
    joints, bodies = ["j1", "j2"], ["b1", "b2"]
    for translation, rotation, n in ((joints, bodies, n_rows[0]), (bodies, joints, n_rows[1])):
        tree = separate(scene, translation, rotation)
        equations = check_the_same(scene, [*joints, *arms(scene)], tree)
        assert len(equations.constraints.rows) == n


def test_a_hinge_in_space_keeps_its_rotational_constraints():
    scene = Scene("hinge", gravity=[0, 0.4, -9.81])
    given = {"theta": 0.5, "theta_dot": 1.2}
    scene.edge("h", "revolute", "ground", "A", axis=[0.2, 1, 0.3], initial=given, damping=0.3)
    scene.edge("r", "arm", "A", "C", vector=[0.4, 0.1, 0.3], rotation=[0.3, 0.1, 0.2])
    scene.edge("m", "rigid_body", "ground", "C", mass=1.3, inertia=[0.2, 0.3, 0.4])
    equations = check_the_same(observing(scene), ["h", "r"], separate(scene, ["h"], ["m"]))
    assert coordinates(equations) == ["m.q0", "m.q1", "m.q2", "m.q3"]
    assert [row.name for row in equations.constraints.rows] == ["h.turn1", "h.turn2"]


def test_a_carriage_may_turn_by_another_way():
    """The rotation of the load goes through a parallel slider, that of the carriage by a body."""
    scene = Scene("carriage", gravity=[0, -9.81, 0])
    given = {"s": 0.3, "s_dot": 0.5}
    scene.edge("h", "revolute", "ground", "A", axis=[0, 0, 1], initial={"theta": 0.4})
    scene.edge("c", "arm", "A", "C", vector=[0.2, 0.1, 0])
    scene.edge("m1", "rigid_body", "ground", "C", mass=2.0, inertia=[0, 0, 0.3])
    scene.edge("s1", "prismatic", "A", "B", axis=[1, 0.5, 0], initial=given, stiffness=20.0)
    scene.edge("m2", "rigid_body", "ground", "B", mass=1.0, inertia=[0, 0, 0.1])
    scene.edge("r1", "arm", "A", "P", vector=[0, 0.2, 0])
    scene.edge("r2", "arm", "B", "Q", vector=[0, 0.2, 0])
    scene.edge("s2", "prismatic", "Q", "P", axis=[1, 0.5, 0])
    # The reactions of parallel sliders are not unique: accelerations are.
    for name in ("B.ax", "B.ay", "Q.vx", "C.alphaz", "h.fx", "h.tz"):
        scene.output(name.replace(".", "_"), name)
    joints = ["h", "s1", *arms(scene)]
    for rotation in (["h", "s2"], ["m1", "s2"], ["m1", "m2"]):
        check_the_same(scene, joints, separate(scene, ["h", "s1"], rotation))


@pytest.mark.sampled(2)
@pytest.mark.parametrize("seed", [0, 1, 4, 6, 8, 13, 16, 29])
def test_random_mechanisms(seed):
    scene = observing(random_mechanism(seed, n_bodies=3, has_joint_laws=False))
    joints = [n for n, e in scene.edges.items() if e.component.role is Role.JOINT]
    chosen = np.random.default_rng(seed).integers(0, 2, (2, len(joints)))
    trees = [
        [
            _either(scene, name, bool(is_body), domain)
            for name, is_body in zip(joints, row, strict=True)
        ]
        for domain, row in zip(("translation", "rotation"), chosen, strict=True)
    ]
    check_the_same(scene, [*joints, *arms(scene)], separate(scene, *trees))


def _either(scene, joint, is_body, domain):
    """The joint, or the body that it leads to where coordinates of the chord are known."""
    kind = scene.edges[joint].component.name
    kept = ("screw", "free", "universal") if domain == "rotation" else ("screw", "free")
    return f"m{joint[1:]}" if is_body and kind not in kept else joint


@pytest.mark.sampled(2)
@pytest.mark.parametrize("seed", [2, 7, 9, 11, 12])
def test_random_planar_loops(seed):
    scene, joints = random_loop(seed, is_planar=True)
    names = [n for n in joints if scene.edges[n].component.role is Role.JOINT]
    bodies = [f"m{n[1:]}" for n in names]
    hinges = [
        body if scene.edges[name].component.name == "revolute" else name
        for name, body in zip(names, bodies, strict=True)
    ]
    observing(scene)
    check_the_same(scene, joints, separate(scene, names, hinges))
    check_the_same(scene, joints, separate(scene, names, bodies))
    check_the_same(scene, joints, separate(scene, bodies, names))


def test_a_rotation_tree_may_close_the_loop_that_translation_cuts():
    scene, joints = random_loop(3, is_planar=True)
    names = [n for n in joints if scene.edges[n].component.role is Role.JOINT]
    check_the_same(observing(scene), joints, separate(scene, names, [*names[:-1], "tie"]))


@pytest.mark.sampled(2)
@pytest.mark.parametrize("seed", [1, 4, 6, 8, 13])
def test_mass_matrix_is_the_derivative_of_the_balances(seed):
    scene = random_mechanism(seed, n_bodies=4, has_joint_laws=False)
    joints = [n for n, e in scene.edges.items() if e.component.role is Role.JOINT]
    for one, other in (("joints", "bodies"), ("bodies", "joints")):
        given = {"joints": joints, "bodies": [f"m{n[1:]}" for n in joints]}
        kept = [n for n in joints if scene.edges[n].component.name in ("screw", "universal")]
        given["bodies"] = [n if n in kept else f"m{n[1:]}" for n in joints]
        first = first_of(scene, separate(scene, given[one], given[other]))
        equations = form_equations(first, (), with_columns=False)
        dag, n = equations.dag, len(equations.balances)
        rng = np.random.default_rng(seed)
        values = {s.symbol: rng.uniform(-1.0, 1.0) for s in equations.states}
        values |= {dag.symbol("p", i): v for i, v in enumerate(equations.parameter_values)}
        values |= {symbol: rng.uniform(-1.0, 1.0) for symbol in equations.unknowns}
        values |= {dag.symbol("t", 0): TIME, dag.symbol("u", 0): 0.4}
        own = equations.unknowns[:n]
        columns = [tangents(list(equations.balances), {w: dag.one}) for w in own]
        direct = np.array([[float(v) for v in evaluate(column, values)] for column in columns]).T
        matrix = np.array([evaluate(list(row[:n]), values) for row in equations.matrix[:n]], float)
        assert np.allclose(matrix, direct, rtol=CLOSE, atol=CLOSE * np.abs(direct).max())


# ---- closed loops and shipped scenes in motion


@pytest.mark.slow
@pytest.mark.compiler
def test_a_loop_with_angles_of_its_bars_takes_the_same_course():
    scene, joints = random_loop(2, is_planar=True)
    scene.output("reaction", "tie.fx")
    names = [n for n in joints if scene.edges[n].component.role is Role.JOINT]
    # Where the loop starts does not depend on gravity, on lengths it does: which of the given
    # coordinates then give way is decided by the least step in each kind of coordinates.
    model = scene.compile(["g"], separate(scene, names, [f"m{n[1:]}" for n in names]))
    settings = {"t_eval": np.linspace(0.0, 0.6, 4), "rtol": 1e-11, "atol": 1e-11}
    found = model.simulate((0, 0.6), **settings)
    known = scene.compile(["g"], joints).simulate((0, 0.6), **settings)
    for name in scene.outputs:
        # Errors of some hundred steps, enlarged by the loop's changes of direction.
        assert np.allclose(found[name], known[name], rtol=1e-8, atol=1e-8)
        mine, other = (run.sensitivity(name, "g") for run in (found, known))
        assert np.allclose(mine, other, rtol=1e-7, atol=1e-7)


@pytest.mark.compiler
def test_the_slider_pendulum_swings_by_the_angle_of_its_bob():
    scene = load("slider-pendulum")
    tree = {"translation": ["j1", "r3", "h2", "r4"], "rotation": ["j1", "r3", "m6", "r4"]}
    model = scene.compile(["L"], tree)
    assert "m6.theta" in model.states
    result = model.simulate((0, 10), rtol=1e-10)
    # The figures of the scene in joint coordinates; see the documentation of simulate.
    assert result["j1.s"][-1] == pytest.approx(0.526045, abs=1e-6)
    known = scene.compile(["L"]).simulate((0, 10), rtol=1e-10)
    mine, other = (run.sensitivity("j1.s", "L")[-1] for run in (result, known))
    assert mine == pytest.approx(other, rel=1e-6)


# ---- what is chosen, reported and refused


def test_vectors_stand_in_ground_axes_and_the_matrix_is_eliminated():
    scene, tree = rods(6)
    _, tried = choose_first_graph(scene, trees_to_try(scene, tree), ())
    assert [(row.own_axes, row.is_along_tree) for row in tried] == [((), False)]


@pytest.mark.slow
def test_a_report_lists_them_but_nothing_takes_them_unnamed():
    scene = four_bar()
    first, _, _ = formulate(scene, (), None)
    assert first.system.trees.is_one
    report = scene.graph()
    assert [row.trees.is_one for row in report.costs].count(False) >= 1
    assert report.costs[0].trees.is_one
    last = report.costs[-1]
    assert last.trees.listed().startswith("translation: ")
    assert "used only if named" in report.summary()
    named = (last.trees.translation, last.trees.rotation)
    tree = {tree.graph.domain: tree.branches for tree in named}
    assert formulate(scene, (), tree)[2][0].n_operations == last.n_operations


def test_trees_of_angles_are_listed_for_planar_scenes_of_few_bodies_only():
    assert separate_trees(spatial_chain("bushing")) == []
    assert separate_trees(rods(9)[0]) == []
    assert [row.trees.is_one for row in count_trees(load("spring-mass-damper"))] == [True, True]


def test_a_tree_may_be_named_for_one_graph_alone():
    scene, tree = rods()
    first = first_of(scene, {"rotation": tree["rotation"]})
    assert [s.name for s in first.states][:2] == ["b0.theta", "b1.theta"]


@pytest.mark.parametrize(
    ("make", "translation", "rotation", "message"),
    [
        pytest.param(
            lambda: two_joints("screw", False),
            ["j1", "j2"],
            ["b1", "j2"],
            r"screw 'j1' is a branch of the translation tree only.*both trees, or in neither",
            id="screw",
        ),
        pytest.param(
            hinged_rods,
            ["h1", "h2"],
            ["m2", "h2"],
            r"opposite orders: the rotation tree reaches node 'A' by 'h2' from node 'B'.*'h1'",
            id="orders",
        ),
        pytest.param(
            lambda: two_joints("revolute", False),
            ["j1", "j2"],
            ["b1", "b2"],
            "angle of joint 'j1' is needed",
            id="angle",
        ),
    ],
)
def test_what_cannot_be_is_refused(make, translation, rotation, message):
    scene = make()
    with pytest.raises(cotree.FormulationError, match=message):
        first_of(scene, separate(scene, translation, rotation))


def test_an_arm_is_a_branch_of_both_trees_or_of_neither():
    scene = four_bar()
    tree = separate(scene, ["A", "B", "C"], ["A", "B", "C"])
    tree["rotation"] = [n for n in tree["rotation"] if n not in ("cc", "A")] + ["bc", "ba"]
    with pytest.raises(cotree.FormulationError, match="arm 'cc' is a branch of the translation"):
        first_of(scene, tree)
