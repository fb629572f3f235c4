"""Each rule of the linter: a scene that breaks it, and one that nearly does."""

from __future__ import annotations

import json

import pytest
from click.testing import CliRunner

import cotree
from cotree import Scene
from cotree.cli.app import app
from cotree.errors import SceneError, SingularSystemError
from cotree.scene.description import RULES
from cotree.scene.toml_file import read_scene, shipped_scenes
from cotree.scene.toml_text import scene_text


def circuit():
    scene = Scene("rc")
    scene.parameter("R", 2.0)
    scene.edge("r", "resistor", "n", "ground", resistance="R")
    scene.edge("C", "capacitor", "n", "ground", capacitance=1.0, initial={"v": 1.0})
    return scene


def pendulum(body="B", **changes):
    scene = Scene("p", gravity=changes.pop("gravity", [0, -9.81, 0]))
    start = {"theta": changes.pop("theta", 0.1)}
    scene.edge("h", "revolute", "ground", "A", axis=[0, 0, 1], initial=start)
    scene.edge("r", "arm", "A", "B", vector=[0, changes.pop("length", -1.0), 0])
    scene.edge("b", "rigid_body", "ground", body, **({"mass": 1.0} | changes))
    return scene


def add(make, act):
    def made():
        scene = make()
        act(scene)
        return scene

    return made


def with_parameter(name, value=1.0, **more):
    return add(circuit, lambda s: s.parameter(name, value, **more))


def with_output(text):
    def act(scene):
        scene.parameter("L", 1.0, unit="m")
        scene.parameter("M", 1.0, unit="kg")
        scene.output("y", text)

    return add(circuit, act)


def resistor(*nodes, **fields):
    return add(circuit, lambda s: s.edge("x", "resistor", *nodes, **({"resistance": 1.0} | fields)))


def source(kind, **fields):
    return add(circuit, lambda s: s.edge("x", kind, "n", "ground", **fields))


def transistor():
    scene = circuit()
    values = {"saturation_current": 1e-14, "forward_gain": 100.0}
    scene.edge("q", "bjt_npn", "n", "n", "ground", **values)
    return scene


def tip(look):
    scene = pendulum()
    scene.edge("t", "arm", "B", "tip", vector=[0, -1, 0])
    if look:
        scene.output("y", "tip.y")
    return scene


def shared(unit, value=0.5):
    scene = pendulum(mass="a", length="-a")
    scene.parameter("a", value, unit=unit)
    return scene


def derived_mass(unit):
    scene = pendulum(mass="m")
    scene.parameter("m", "rho*r**3")
    scene.parameter("rho", 1.0, unit="kg/m^3")
    scene.parameter("r", 1.0, unit=unit)
    return scene


def thick(inertia):
    scene = Scene("p")
    scene.edge("s", "spherical", "ground", "A")
    scene.edge("r", "arm", "A", "B", vector=[0, 0.5, 0.1])
    scene.edge("b", "rigid_body", "ground", "B", mass=1.0, inertia=inertia)
    return scene


def moded(is_set):
    scene = circuit()
    scene.mode("m", 0)
    sets = {"m": "1"} if is_set else {}
    scene.event("e", "C.v - 0.5", set=sets, stop=not is_set)
    return scene


CASES = {
    "unused parameter": ("unused-parameter:mass", with_parameter("mass"), with_output("L*M*C.v")),
    "used in a derived one": (
        "unused-parameter:q",
        with_parameter("q", "R*2"),
        add(with_parameter("q", "R*2"), lambda s: s.output("y", "q")),
    ),
    "unused input": (
        "unused-input:u",
        add(circuit, lambda s: s.input("u", 1.0)),
        add(circuit, lambda s: (s.input("u", 1.0), s.output("y", "u"))),
    ),
    "case of parameters": (
        "similar-names:Mass",
        add(circuit, lambda s: (s.parameter("mass", 1.0), s.parameter("Mass", 1.0))),
        add(circuit, lambda s: s.parameter("r", 1.0)),  # beside R: a notation
    ),
    "case of nodes": (
        "similar-names:N",
        resistor("n", "N"),
        # A node of another domain may have the same letter.
        add(
            circuit,
            lambda s: (
                s.edge("h", "heat_capacitor", "N", "ground", capacity=1.0),
                s.edge("g", "thermal_resistor", "N", "ground", resistance=1.0),
            ),
        ),
    ),
    "open end": ("dangling-node:m", resistor("n", "m"), resistor("n", "ground")),
    "tip of an arm": ("dangling-node:tip", lambda: tip(False), lambda: tip(True)),
    "body elsewhere": ("dangling-node:BB", lambda: pendulum("BB"), pendulum),
    "short": ("shorted:x", resistor("n", "n"), transistor),
    "no inertia": ("inertia:b", lambda: pendulum(mass=0.0), pendulum),
    "no body's inertia": ("inertia:b", lambda: thick([1, 1, 3]), lambda: thick([1, 1, 2])),
    "degrees": ("magnitude:h", lambda: pendulum(theta=30), lambda: pendulum(theta=6.5)),
    "millimetres": (
        "magnitude:r",
        lambda: pendulum(length=1000),
        lambda: pendulum(length={"value": 1000, "unit": "mm"}),
    ),
    "gravity": (
        "magnitude:p",
        lambda: pendulum(gravity=[0, -9810, 0]),
        lambda: pendulum(gravity=[0, -274, 0]),
    ),
    "farads": (
        "magnitude:x",
        source("capacitor", capacitance=2e4),
        source("capacitor", capacitance=1.0),
    ),
    "a sum": ("dimension:y", with_output("L + M"), with_output("L + 2*M")),
    "a function": ("dimension:y", with_output("sin(L)"), with_output("sin(L/L)")),
    "a comparison": ("dimension:y", with_output("where(L < M, 1, 2)"), with_output("exp(-t)")),
    "a field": (
        "dimension:x",
        add(
            resistor("n", "ground", resistance="L*L"),
            lambda s: s.parameter("L", 1.0, unit="m"),
        ),
        add(
            resistor("n", "ground", resistance="V/A"),
            lambda s: (s.parameter("V", 1.0, unit="V"), s.parameter("A", 1.0, unit="A")),
        ),
    ),
    "a field of a derived one": (
        "dimension:b",
        lambda: derived_mass("kg"),
        lambda: derived_mass("m"),
    ),
    "one for two": ("dimension:a", lambda: shared(""), pendulum),
    "derived": (
        "dimension:m",
        add(with_parameter("L", unit="m"), lambda s: s.parameter("m", "L*L", unit="kg")),
        add(with_parameter("L", unit="m"), lambda s: s.parameter("m", "L*L", unit="m^2")),
    ),
    "constant": ("constant:y", with_output("L - L + 2"), with_output("L - M*0.5")),
    "vanishing": ("constant:y", with_output("0*C.v"), with_output("0.1*C.v")),
    "a source of nothing": (
        "no-effect:x",
        source("current_source", current=0.0),
        source("current_source", current="0*t + R"),
    ),
    "a mode": ("no-effect:m", lambda: moded(False), lambda: moded(True)),
    "needless": (
        "unused-allow:shorted",
        add(circuit, lambda s: s.allow("shorted")),
        add(resistor("n", "n"), lambda s: s.allow("shorted")),
    ),
}


def entries(scene):
    return [row.allow or row.rule for row in scene.lint()]


@pytest.mark.parametrize(("entry", "broken", "kept"), CASES.values(), ids=CASES)
def test_rules(entry, broken, kept):
    assert entry in entries(broken())
    rule = entry.partition(":")[0]
    assert not [row for row in entries(kept()) if row.startswith(rule) and row != "dimension"]


@pytest.mark.parametrize("entry", [row[0] for row in CASES.values()])
def test_every_finding_may_be_on_purpose(entry):
    broken = next(row[1] for row in CASES.values() if row[0] == entry)()
    if not entry.startswith("unused-allow"):
        broken.allow(entry)
        assert entry not in entries(broken)


def test_every_rule_has_a_case():
    assert {row[0].partition(":")[0] for row in CASES.values()} | {"refused"} == set(RULES)


def test_a_scene_that_cannot_be_formed():
    (finding,) = (row for row in with_parameter("q", "zz")().lint() if row.severity == "error")
    assert (finding.rule, finding.kind, finding.name) == ("refused", "parameter", "q")
    assert finding.allow == ""
    assert "unknown parameter 'zz'" in finding.message


def test_initial_values_that_contradict_each_other():
    scene = circuit()
    scene.edge("D", "capacitor", "n", "ground", capacitance=1.0, initial={"v": 2.0})
    assert [row.rule for row in scene.lint()] == ["refused"]


def test_a_slip_in_a_node_is_named_where_it_hurts():
    """The mass matrix is singular, since the body is at another node than the joint carries."""
    with pytest.raises(SingularSystemError, match="'BB' by edge 'b' only: did you mean one node"):
        pendulum("BB").compile()


@pytest.mark.parametrize("name", shipped_scenes())
def test_shipped_scenes_are_clean(name):
    assert cotree.load(name).lint() == ()


def test_entries_of_files(tmp_path):
    scene = with_parameter("spare")()
    scene.allow("unused-parameter:spare")
    text = scene_text(scene)
    assert 'allow = ["unused-parameter:spare"]' in text
    again = read_scene(text, "x.toml", Scene)
    assert again.allowed == ("unused-parameter:spare",)
    assert again.lint() == ()
    for allow, told in {
        '["unused-params"]': "did you mean 'unused-parameter'",
        '"shorted"': "must be a list",
        '["refused"]': "cannot be allowed",
        "[1]": "must be a list",
    }.items():
        with pytest.raises(SceneError, match=told):
            read_scene(f"allow = {allow}", "x.toml", Scene)


def test_the_command(tmp_path):
    file = tmp_path / "rc.toml"
    with_parameter("spare")().save(file)
    shown = CliRunner().invoke(app, ["lint", str(file)])
    assert shown.exit_code == 1
    assert "line 5: warning [unused-parameter:spare] parameter 'spare' is unused" in shown.output
    assert 'allow = ["unused-parameter:spare"]' in shown.output
    (row,) = json.loads(CliRunner().invoke(app, ["lint", str(file), "--json"]).output)
    assert (row["rule"], row["name"], row["line"]) == ("unused-parameter", "spare", 5)
    shown = CliRunner().invoke(app, ["lint", str(file), "--allow", "unused-parameter"])
    assert (shown.exit_code, shown.output) == (0, "nothing suspicious\n")


def test_check_lists_findings(tmp_path):
    file = tmp_path / "rc.toml"
    with_parameter("spare")().save(file)
    shown = CliRunner().invoke(app, ["check", str(file), "-s", "R", "--t-end", "0.1"])
    assert "[unused-parameter:spare]" in shown.output
    assert shown.exit_code == 0


def test_an_unknown_name_in_an_inertia_is_reported():
    scene = cotree.Scene("arm")
    scene.revolute("h", "ground", "A", axis=[0, 0, 1])
    scene.rigid_body("b", "ground", "A", mass=1.0, inertia=["q", 1.0, 1.0])
    assert [row.rule for row in scene.lint() if "'q'" in row.message] == ["refused"]
