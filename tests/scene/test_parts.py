"""Scenes made of scenes: names, bindings, arrays, and the same equations as without parts."""

import pickle
import re

import numpy as np
import pytest
from click.testing import CliRunner

import cotree
from cotree.cli.app import app
from cotree.errors import ModelError, SceneError
from cotree.scene.description import Origin, Visual
from cotree.scene.part import origins_of


def _cell() -> cotree.Scene:
    cell = cotree.Scene("cell")
    cell.parameter("R", 1.0, unit="ohm")
    cell.parameter("C", 1.0, unit="F")
    cell.edge("series", "resistor", "left", "right", resistance="R")
    cell.edge("shunt", "capacitor", "right", "ground", capacitance="C")
    cell.port("left", "right")
    return cell


def _ladder(n: int, **bindings: object) -> cotree.Scene:
    ladder = cotree.Scene("ladder")
    ladder.parameter("R0", 2.0)
    ladder.parameter("C0", 0.1)
    values = {"R": "R0", "C": "C0", **bindings}
    ladder.add("cell", _cell(), count=n, left="n{i - 1}", right="n{i}", **values)
    ladder.edge("source", "voltage_source", "n0", "ground", voltage=1.0)
    return ladder


def _flat_ladder(n: int) -> cotree.Scene:
    flat = cotree.Scene("ladder")
    flat.parameter("R0", 2.0)
    flat.parameter("C0", 0.1)
    for i in range(1, n + 1):
        flat.edge(f"series{i}", "resistor", f"n{i - 1}", f"n{i}", resistance="R0")
        flat.edge(f"shunt{i}", "capacitor", f"n{i}", "ground", capacitance="C0")
    flat.edge("source", "voltage_source", "n0", "ground", voltage=1.0)
    return flat


def _add_leg(scene: cotree.Scene, p: str, hip: str) -> None:
    """Add a leg of two links, with the prefix p before its names."""
    scene.parameter(f"{p}L", 0.3)
    scene.parameter(f"{p}k", 40.0)
    scene.input(f"{p}tau", 0.0)
    theta, L = f"{p}hip_joint.theta", f"{p}L"
    scene.edge(
        *(f"{p}hip_joint", "revolute", hip, f"{p}upper"),
        axis=[0, 1, 0],
        torque=f"{p}tau - {p}k*{theta}",
        initial={"theta": 0.4},
    )
    scene.edge(f"{p}half", "arm", f"{p}upper", f"{p}middle", vector=[0, 0, f"-{L}/2"])
    scene.edge(f"{p}link", "rigid_body", "ground", f"{p}middle", mass=1.0, inertia=[0.01, 0.01, 0])
    scene.edge(f"{p}whole", "arm", f"{p}upper", f"{p}knee", vector=[0, 0, f"-{L}"])
    scene.edge(f"{p}knee_joint", "revolute", f"{p}knee", f"{p}lower", axis=[0, 1, 0], stiffness=8.0)
    scene.edge(f"{p}shank", "arm", f"{p}lower", f"{p}foot", vector=[0, 0, f"-{L}"])
    scene.edge(f"{p}tip", "rigid_body", "ground", f"{p}foot", mass=0.3)
    scene.output(f"{p}reach", f"{hip}.z - {p}foot.z")


def _walker(hips: dict[str, tuple[float, float]], is_flat: bool) -> cotree.Scene:
    scene = cotree.Scene("walker", gravity=[0, 0, -9.81])
    leg = cotree.Scene("leg")
    _add_leg(leg, "", "hip")
    for name in hips:
        if is_flat:
            _add_leg(scene, f"{name}_", f"hip_{name}")
        else:
            scene.add(name, leg, hip=f"hip_{name}")
    for name, (x, y) in hips.items():
        scene.edge(f"to_{name}", "arm", "trunk", f"hip_{name}", vector=[x, y, 0])
    base = "free" if len(hips) > 2 else "prismatic"
    scene.edge("base", base, "ground", "trunk", **({} if base == "free" else {"axis": [0, 0, 1]}))
    scene.edge("body", "rigid_body", "ground", "trunk", mass=8.0, inertia=[0.1, 0.2, 0.2])
    return scene


def _text(scene: cotree.Scene, *sensitivities: str) -> str:
    """Return the C text of a scene without the hash of its names."""
    return re.sub(r"program [0-9a-f]+", "program", scene.compile(sensitivities).kernels.source)


@pytest.mark.parametrize("n", [40, pytest.param(200, marks=pytest.mark.slow)])
def test_a_ladder_of_parts_has_the_very_code_of_the_flat_ladder(n) -> None:
    parts = _text(_ladder(n), "R0")
    assert re.sub(r"cell(\d+)\.(series|shunt)", r"\2\1", parts) == _text(_flat_ladder(n), "R0")
    assert "for (" in parts


_FOUR = {"a1": (0.2, 0.1), "a2": (0.2, -0.1), "b1": (-0.2, 0.1), "b2": (-0.2, -0.1)}


@pytest.mark.parametrize("n", [2, pytest.param(4, marks=pytest.mark.slow)])
def test_a_walker_of_legs_has_the_operations_of_the_flat_one(n) -> None:
    hips = dict(list(_FOUR.items())[:n])
    parts = _text(_walker(hips, is_flat=False), "a1.k")
    assert re.sub(r"\b([ab][12])\.", r"\1_", parts) == _text(_walker(hips, is_flat=True), "a1_k")


def test_parameters_of_parts_have_sensitivities() -> None:
    # Two cells with a source: v2 obeys a linear system, whose sensitivities differences confirm.
    ladder = _ladder(2, R="R0*(1 + 0.5*(i - 1))", C=0.1)
    model = ladder.compile(["R0", "cell2.C"])
    assert model.parameters == ("cell1.C", "cell2.C", "R0", "C0")
    span, name, rtol = (0, 0.5), "cell2.shunt.v", 1e-11
    result = model.simulate(span, rtol=rtol, atol=1e-13)
    for parameter, value in (("R0", 2.0), ("cell2.C", 0.1)):
        h = 1e-4 * value
        high, low = (
            model.simulate(span, parameters={parameter: value + s}, rtol=rtol, atol=1e-13)[name][-1]
            for s in (h, -h)
        )
        slope = result.sensitivity(name, parameter)[-1]
        # Central differences err by h^2 v'''/6, about 1e-8 here.
        assert slope == pytest.approx((high - low) / (2 * h), rel=1e-6)


def test_a_ladder_obeys_its_closed_form() -> None:
    # n equal cells from 1 V: the end voltage approaches 1 as modes of the discrete line decay,
    # v_n = 1 - sum of 2 (-1)^(k+1) sin(a_k)... : compared with the eigenvalues of its matrix.
    n, R, C, t = 6, 2.0, 0.1, 0.7
    A = (np.diag([-2.0] * (n - 1) + [-1.0]) + np.eye(n, k=1) + np.eye(n, k=-1)) / (R * C)
    values, vectors = np.linalg.eigh(A)
    exact = 1.0 - vectors @ (np.exp(values * t) * (vectors.T @ np.ones(n)))
    result = _ladder(n).compile().simulate((0, t), rtol=1e-11, atol=1e-13)
    found = [result[f"cell{i}.shunt.v"][-1] for i in range(1, n + 1)]
    # The tolerance of the steps, times their number.
    np.testing.assert_allclose(found, exact, rtol=0, atol=1e-9)


def test_parts_may_hold_parts() -> None:
    link = cotree.Scene("link")
    link.parameter("L", 0.5)
    link.edge("joint", "revolute", "base", "rod", axis=[0, 0, 1], initial={"theta": "0.2*L"})
    link.edge("rod", "arm", "rod", "tip", vector=[0, "-L", 0])
    link.edge("bob", "rigid_body", "ground", "tip", mass=1.0)
    link.output("height", "tip.y - base.y")
    arm = cotree.Scene("arm")
    arm.parameter("size", 0.8)
    arm.add("upper", link, base="shoulder", L="size")
    arm.add("lower", link, base="upper.tip", L="size/2")
    outer = cotree.Scene("two", gravity=[0, -9.81, 0])
    outer.add("left", arm, shoulder="ground")
    outer.add("right", arm, shoulder="ground", size=0.6)
    outer.output("hand", "left.lower.tip.y + left.lower.height")
    model = outer.compile(["left.size"])
    assert model.states[:2] == ("left.upper.joint.theta", "left.lower.joint.theta")
    assert model.parameters == ("left.size", "right.size")
    result = model.simulate((0, 0.5))
    # The height of the hand is that of both links, and lies once more below the elbow.
    heights = result["left.upper.height"] + 2 * result["left.lower.height"]
    np.testing.assert_allclose(result["hand"], heights, rtol=1e-12)
    assert result.sensitivity("hand", "left.size")[-1] != 0.0


def test_inputs_of_parts_follow_time_or_states() -> None:
    cart = cotree.Scene("cart")
    cart.input("push", 0.0, unit="N")
    cart.edge("rail", "prismatic", "ground", "A", axis=[1, 0, 0], force="push")
    cart.edge("body", "rigid_body", "ground", "A", mass=2.0)
    train = cotree.Scene("train")
    train.parameter("k", 8.0)
    train.add("first", cart, push="3*t")
    train.add("second", cart, push="-k*(second.rail.s - first.rail.s)")
    train.add("third", cart)
    model = train.compile(["k"])
    assert model.inputs == ("first.push", "third.push")
    assert "second.push" in model.outputs
    result = model.simulate((0, 1.0), rtol=1e-11, atol=1e-13, inputs={"third.push": 2.0})
    assert result["first.rail.s"][-1] == pytest.approx(0.25, rel=1e-10)  # 3 t^3 / (6 m)
    assert result["third.rail.s"][-1] == pytest.approx(0.5, rel=1e-10)  # F t^2 / (2 m)
    # x'' = -w^2 (x - t^3/4) with w = 2: x = t^3/4 - 3 t/(2 w^2) + 3 sin(w t)/(2 w^3).
    exact = 0.25 - 3 / 8 + 3 * np.sin(2.0) / 16
    assert result["second.rail.s"][-1] == pytest.approx(exact, rel=1e-8)
    closed = train.with_inputs({"third.push": "-k*third.rail.s"})
    assert "third.push" in closed.outputs
    assert "third.push" in train.inputs


def test_modes_and_events_of_parts_are_their_own() -> None:
    ball = cotree.Scene("ball", gravity=[0, 0, -9.81])
    ball.parameter("h", 1.0)
    ball.mode("bounces", 0)
    ball.edge("fall", "prismatic", "ground", "B", axis=[0, 0, 1], initial={"s": "h"})
    ball.edge("body", "rigid_body", "ground", "B", mass=1.0)
    ball.event(
        "hit", "fall.s", direction=-1, set={"fall.s_dot": "-fall.s_dot", "bounces": "bounces + 1"}
    )
    two = cotree.Scene("two", gravity=[0, 0, -9.81])
    two.add("ball", ball, count=2, h="0.5*i")
    result = two.compile().simulate((0, 1.2), rtol=1e-10)
    for i, h in ((1, 0.5), (2, 1.0)):
        first = np.sqrt(2 * h / 9.81)
        times = result.events[f"ball{i}.hit"].t
        np.testing.assert_allclose(times, first * (1 + 2 * np.arange(len(times))), rtol=1e-8)
        assert result[f"ball{i}.bounces"][-1] == len(times)


def test_a_mesh_has_two_numbers() -> None:
    tile = cotree.Scene("tile")
    tile.edge("right", "resistor", "here", "next", resistance=1.0)
    tile.edge("down", "resistor", "here", "below", resistance=1.0)
    tile.edge("store", "capacitor", "here", "ground", capacitance=1.0)
    mesh = cotree.Scene("mesh")
    mesh.add("tile", tile, count=[3, 4], here="n{i}_{j}", next="n{i}_{j + 1}", below="n{i + 1}_{j}")
    assert len(mesh.edges) == 36
    assert mesh.edges["tile3_4.right"].nodes == ("n3_4", "n3_5")
    ring = cotree.Scene("ring")
    ring.add("cell", _cell(), count=5, index="n", left="c{n}", right="c{mod(n, 5) + 1}", R="n")
    assert ring.edges["cell5.series"].nodes == ("c5", "c1")
    # What the index alone decides is a number, which runs may change.
    assert ring.parameters["cell3.R"].number == 3.0


def test_single_parts_of_an_array_may_differ() -> None:
    ladder = _ladder(3, R=2.0)
    assert ladder.parameters["cell2.R"].number == 2.0
    ladder.set("cell2.R", 5.0)
    ladder.set("cell3.R", 4.0, unit="kohm")
    assert ladder.parameters["cell2.R"].number == 5.0
    assert ladder.parameters["cell3.R"].number == 4000.0
    other = _ladder(3, set={"cell1.left": "ground", "cell3.C": "2*C0"})
    assert other.edges["cell1.series"].nodes == ("ground", "n1")
    assert other.parameters["cell3.C"].value.text == "2*C0"


def test_saved_scenes_keep_their_parts(tmp_path) -> None:
    ladder = _ladder(3, R="R0*i")
    ladder.set("cell2.C", 0.3)
    outer = cotree.Scene("outer")
    outer.add("line", ladder)
    outer.add("again", ladder, R0=7.0)
    outer.edge("load", "resistor", "line.n3", "ground", resistance=10.0)
    outer.save(tmp_path / "outer.toml")
    text = (tmp_path / "outer.toml").read_text()
    assert text.count('type = "capacitor"') == 1  # the cell, once
    read = cotree.load(tmp_path / "outer.toml")
    assert read == outer
    for table in ("parameters", "edges", "outputs"):
        assert list(getattr(read, table)) == list(getattr(outer, table))
    assert read.compile().kernels.source == outer.compile().kernels.source


def test_parts_stay_when_a_scene_is_copied_or_pickled() -> None:
    ladder = _ladder(3)
    same = pickle.loads(pickle.dumps(ladder))
    assert same == ladder
    copied = ladder.copied()
    copied.set("cell1.R", 3.0)
    assert ladder.parts["cell"].set == {}
    assert copied != ladder
    # A part does not follow the scene that it was made of.
    cell = _cell()
    outer = cotree.Scene("outer")
    outer.add("x", cell, left="a", right="b")
    cell.edge("more", "resistor", "left", "ground", resistance=1.0)
    assert "x.more" not in outer.edges


def _of_every_form(base: str, warm: str, mixture: str) -> cotree.Scene:
    """Build a scene whose edges name nodes and joints in every way that there is."""
    part = cotree.Scene("part", gravity=[0, 0, -9.81])
    part.parameter("k", 0.1)
    part.edge("h", "revolute", base, "arm", axis=[0, 1, 0])
    part.edge("link", "arm", "arm", "tip", vector=[0.5, 0, 0])
    part.edge("bob", "rigid_body", "ground", "tip", mass=1.0)
    motor = {"electrical": ["p", "ground"], "joint": "h", "resistance": 1.0, "constant": "k"}
    part.edge("motor", "dc_motor", **motor)
    part.edge("drag", "rotational_damper", joint="h.theta", damping=0.1)
    part.edge("strut", "translational_spring", line=["anchor", "tip"], stiffness=3.0)
    part.edge("post", "arm", base, "anchor", vector=[0, 0, 1])
    part.edge("supply", "voltage_source", "p", "ground", voltage=1.0)
    part.edge("R", "resistor", "p", "q", resistance="k + 0*q.v", heat=warm)
    part.edge("C", "capacitor", "q", "ground", capacitance=1.0)
    part.edge("T", "heat_capacitor", warm, "ground", capacity=2.0, initial={"T": 300})
    part.edge("A", "species", mixture, "ground", volume=1.0)
    part.edge("B", "species", "b", "ground", volume=1.0)
    part.edge("r", "reaction", reactants=[mixture, mixture], products=["b"], rate=1.0)
    part.output("power", "motor.shaft.tau*h.theta_dot + R.i")
    return part


def test_edges_of_every_form_become_those_of_parts() -> None:
    alone = _of_every_form("ground", "hot", "mixture")
    outer = cotree.Scene("part", gravity=[0, 0, -9.81])
    outer.add("x", _of_every_form("base", "w", "a"), base="ground", w="hot", a="mixture")
    assert _text(outer).replace("x.", "") == _text(alone).replace("x.", "")
    edges = outer.edges
    assert edges["x.motor"].statement["joint"] == "x.h"
    assert edges["x.drag"].statement["joint"] == "x.h.theta"
    assert edges["x.strut"].statement["line"] == ["x.anchor", "x.tip"]
    assert edges["x.R"].statement["heat"] == "hot"
    assert edges["x.r"].statement["reactants"] == ["mixture", "mixture"]


def test_names_in_texts_are_replaced_as_the_parser_reads_them() -> None:
    part = cotree.Scene("part")
    part.parameter("min", 2.0)
    part.parameter("e1", 1.0)
    part.edge("in", "voltage_source", "a", "ground", voltage="min(min, 1e1) * e1 + exp (t)")
    part.edge("R", "resistor", "a", "ground", resistance=1.0)
    part.output("w", "in.v + where(in.v > 0 and not in.v > 5, 1, 0) + ground.v*0")
    outer = cotree.Scene("outer")
    outer.add("is", part, a="a")
    value = outer.edges["is.in"].fields["voltage"]
    assert value.text == "min(is.min, 10.0) * is.e1 + exp(t)"
    assert outer.outputs["is.w"].text == (
        "is.in.v + where(is.in.v > 0 and (not is.in.v > 5), 1, 0) + ground.v * 0"
    )
    assert outer.compile().simulate((0, 1))["is.w"][-1] == pytest.approx(2 + np.e + 1)


def _two_parts() -> cotree.Scene:
    scene = cotree.Scene("scene")
    scene.add("x", _cell(), left="a", right="b")
    return scene


@pytest.mark.parametrize(
    ("act", "told"),
    [
        (lambda s: s.add("x", _cell(), left="a", right="b"), "every part needs its own"),
        (lambda s: s.add("y", _cell(), left="a"), "port 'right' of cell is left open"),
        (lambda s: s.add("y", _cell(), lefft="a"), "did you mean 'left'"),
        (lambda s: s.add("b", _cell(), left="a", right="c"), "also that of a node"),
        (lambda s: s.add("y", _cell(), left="x", right="c"), "'x' is a part, not a node"),
        (lambda s: s.add("y", _cell(), left="x.right", right="c"), "use its name, 'b'"),
        (lambda s: s.add("y", _cell(), left=3, right="c"), "give the name of a node"),
        (lambda s: s.add("y.z", _cell(), left="a", right="b"), "part name 'y.z' is not allowed"),
        (lambda s: s.add("pi", _cell(), left="a", right="b"), "already has a meaning"),
        (lambda s: s.add("energy", _cell(), left="a", right="b"), "already has a meaning"),
        (lambda s: s.add("y", _cell(), left="a", right="b", R=[1]), "give a number"),
        (lambda s: s.add("y", _cell(), left="a", right="b", R=True), "give a number"),
        (lambda s: s.add("y", _cell(), left="a", right="b", count=0), "whole number from 1"),
        (lambda s: s.add("y", _cell(), left="a", right="b", count=10**12), "larger than 250000"),
        (
            lambda s: s.add("y", _cell(), left="a{k}", right="b", count=2),
            "'k', which is not an index",
        ),
        (lambda s: s.add("y", _cell(), left="a{i - 2}", right="b", count=2), "is -1"),
        (lambda s: s.add("y", _cell(), left="a", right="b", index="n"), "1 names for 0 counts"),
        (lambda s: s.add("y", _cell(), left="a", right="b", set={"y.Q": 1}), "did you mean 'y.R'"),
        (lambda s: s.add("y", None), "give a scene, a file, or the name of a shipped part"),
        (lambda s: s.add("y", "no-such-part"), "neither a file nor a shipped part"),
        (lambda s: s.edge("x", "resistor", "a", "b", resistance=1), "name of edge 'x' is taken"),
        (lambda s: s.edge("y", "resistor", "x.q", "b", resistance=1), "part 'x' has no node 'q'"),
        (lambda s: s.edge("y", "resistor", "z.q", "b", resistance=1), "the unknown part 'z'"),
        (lambda s: s.set("x.R", "2*x.R"), "depends on itself"),
        (lambda s: s.set("x.Q", 1.0), "neither a parameter nor an input"),
        (lambda s: s.port("ground"), "cannot be a port"),
    ],
)
def test_wrong_parts_are_refused_and_change_nothing(act, told) -> None:
    scene = _two_parts()
    before = pickle.loads(pickle.dumps(scene))
    with pytest.raises(ModelError, match=re.escape(told)):
        act(scene)
    assert scene == before
    assert scene.members == before.members


def test_what_counts_a_whole_scene_is_refused_in_parts() -> None:
    part = _cell()
    part.output("E", "energy.kinetic")
    with pytest.raises(SceneError, match="a total of the outer scene"):
        cotree.Scene("outer").add("x", part, left="a", right="b")


def test_shapes_of_a_robot_are_drawn_where_it_is_a_part() -> None:
    robot = cotree.Scene("robot")
    robot.edge("h", "revolute", "base", "A", axis=[0, 0, 1])
    robot.edge("body", "rigid_body", "ground", "A", mass=1.0, inertia=1.0)
    robot.origin = Origin("robot.urdf", visuals=(Visual("A", "sphere", (0.1, 0.1, 0.1)),))
    pair = cotree.Scene("pair")
    pair.add("arm", robot, count=2, base="stand{i}")
    for i in (1, 2):
        pair.edge(f"to{i}", "arm", "ground", f"stand{i}", vector=[i, 0, 0])
    assert [row.visuals[0].node for row in origins_of(pair)] == ["arm1.A", "arm2.A"]
    animation = pair.compile().simulate((0, 1)).animate()
    assert "<canvas" in animation.html


def test_the_drawing_of_a_graph_shows_its_parts() -> None:
    figure = _ladder(2).graph().draw()
    # Both edges of each cell have a broad stroke under them.
    assert sum(patch.get_linewidth() > 20 for patch in figure.axes[0].patches) == 4
    plain = _flat_ladder(2).graph().draw()
    assert not any(patch.get_linewidth() > 20 for patch in plain.axes[0].patches)


def test_options_of_the_command_line_name_what_is_in_parts(tmp_path) -> None:
    _ladder(2, R=2.0).save(tmp_path / "ladder.toml")
    line = ["run", str(tmp_path / "ladder.toml"), "-s", "cell1.R", "--set", "cell2.R=3"]
    result = CliRunner().invoke(app, [*line, "--initial", "cell1.shunt.v=0.5", "--t-end", "0.1"])
    assert result.exit_code == 0, result.output
    assert "d(cell2.shunt.v)/d(cell1.R)" in result.output
    told = CliRunner().invoke(app, ["components", "rlc-filter"]).output
    assert "ports: input, output" in told
    assert 'scene.add("x", "rlc-filter", input="my_input"' in told
