"""Parts in scene files: where they are found, and what is said of mistakes in them."""

import os
import re

import pytest

import cotree
from cotree.errors import ModelError
from cotree.scene.toml_file import shipped_parts

_LEG = """
ports = ["a", "b"]
[parameters]
R = 1.0
k = { value = 2.0, unit = "N/m" }
[edges.r]
type = "resistor"
nodes = ["a", "m"]
resistance = "R"
[edges.c]
type = "capacitor"
nodes = ["m", "b"]
capacitance = 1.0
[edges.s]
type = "translational_spring"
nodes = ["ground", "q"]
stiffness = "k"
[edges.mass]
type = "translational_mass"
nodes = ["ground", "q"]
mass = 1.0
[outputs]
p = "r.v*r.i"
"""
_PART = '[parts.x]\nscene = "leg.toml"\na = "n"\nb = "ground"\n'
_SOURCE = '[edges.v]\ntype = "voltage_source"\nnodes = ["n", "ground"]\nvoltage = 1.0\n'


def _written(folder, text: str, **files: str) -> str:
    (folder / "leg.toml").write_text(_LEG)
    for name, other in files.items():
        path = folder / f"{name.replace('__', '/')}.toml"
        path.parent.mkdir(exist_ok=True)
        path.write_text(other)
    (folder / "outer.toml").write_text(text)
    return str(folder / "outer.toml")


def test_a_part_is_read_from_a_file_beside(tmp_path, monkeypatch) -> None:
    path = _written(tmp_path, _PART + 'k = { value = 3, unit = "N/mm" }\nR = "2*R0"\n' + _SOURCE)
    text = "[parameters]\nR0 = 4.0\n" + (tmp_path / "outer.toml").read_text()
    (tmp_path / "outer.toml").write_text(text)
    monkeypatch.chdir(tmp_path.parent)  # paths are relative to the file, wherever one is
    scene = cotree.load(path)
    assert scene.parameters["x.k"].value == 3000.0
    assert scene.edges["x.r"].nodes == ("n", "x.m")
    assert scene.compile(["R0"]).sensitivities == ("R0",)


def test_files_of_parts_may_lie_in_folders_below(tmp_path) -> None:
    inner = '[parts.y]\nscene = "../leg.toml"\na = "a"\nb = "ground"\n' + _SOURCE.replace(
        "n", "a", 0
    )
    path = _written(
        tmp_path, _PART.replace("leg", "legs/own").replace('b = "ground"\n', ""), legs__own=inner
    )
    assert "x.y.r" in cotree.load(path).edges


def test_a_scene_may_stand_in_the_same_file(tmp_path) -> None:
    ports, rest = 'ports = ["a", "b"]\n', _LEG.split("\n", 2)[2]
    inner = f"[scenes.leg]\n{ports}" + re.sub(r"^\[", "[scenes.leg.", rest, flags=re.M)
    path = _written(tmp_path, _PART.replace("leg.toml", "leg") + _SOURCE + inner)
    assert cotree.load(path).outputs["x.p"].text == "x.r.v * x.r.i"


def _refused(path: str) -> str:
    with pytest.raises(ModelError) as caught:
        cotree.load(path).compile()
    return str(caught.value).replace(f"{os.path.dirname(path)}/", "")


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ('a = "n"', 'aa = "n"', "outer.toml, line 1: part 'x': leg has no port, parameter or"),
        ('a = "n"\n', "", "outer.toml, line 1: part 'x': port 'a' of leg is left open: connect it"),
        ('a = "n"', 'm = "n"', "'m' is a node of leg, but none of its ports: a, b"),
        ('a = "n"', 'a = "n m"', "node name 'n m' is not allowed"),
        ('a = "n"', 'a = "n"\nground = "n"', "'ground' is the reference of all scenes"),
        ('a = "n"', 'a = "n"\nk = { value = 2, unit = "V" }', "'x.k' is in 'N/m', to which"),
        ('a = "n"', 'a = "n"\nR = "Q"', "'x.R' is given by part 'x' of outer.toml, line 1"),
        ('a = "n"', 'a = "n"\nR = "__import__(1)"', "calls '__import__', which is not a known"),
        ('a = "n"', 'a = "n{i/2}"\ncount = 3', "line 1: part 'x1': node 'a': '{i/2}' is 0.5"),
        ('a = "n"', 'a = "n"\ncount = 999999999', "999999999 parts of 7 declarations each"),
        ('a = "n"', 'a = "n"\nR = 1\nparameters = { R = 1 }', "'R' is given twice"),
        ("scene", "scenee", "did you mean it by 'scenee'"),
        ('"leg.toml"', "7", "scene is 7: give a file or a name"),
        (
            "leg.toml",
            "lek.toml",
            "'lek.toml' is not a file in this folder; did you mean 'leg.toml'",
        ),
        ("leg.toml", "leg", "files end in .toml; known: battery-pack"),
        ("leg.toml", "rlc-filer", "did you mean 'rlc-filter'"),
        ("leg.toml", "/etc/leg.toml", "is not relative to this file"),
        ("leg.toml", "../leg.toml", "is outside the folder of the scene"),
        ("leg.toml", "a/../../leg.toml", "is outside the folder of the scene"),
        ("leg.toml", "..\\\\leg.toml", "is not relative to this file"),
        ("leg.toml", "outer.toml", "contains itself: outer.toml -> outer.toml"),
        ("[parts.x]", "[parts.v]", "line 5: the name of edge 'v' is taken"),
        ("[parts.x]", "[parts.t]", "part name 't' already has a meaning"),
        ("[parts.x]", "[parts]\ny = 1\n[parts.x]", "part 'y' must be a table"),
    ],
)
def test_a_mistake_in_a_part_names_file_and_line(tmp_path, old, new, told) -> None:
    assert told in _refused(_written(tmp_path, _PART.replace(old, new) + _SOURCE))


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        (
            "resistance =",
            "resistanc =",
            "outer.toml, line 1: part 'x': leg.toml, line 6: edge 'r'",
        ),
        ('"b"]\n[p', '"bb"]\n[p', "part 'x': leg.toml: ports names 'bb', which is no node"),
        ('"R"', '"RR"', "uses the unknown name 'x.RR'; did you mean 'x.R'? ('x.r' is edge 'r' of"),
        ("N/m", "N", "'x.s' is edge 's' of leg.toml, line 14"),
        ("r.v*r.i", "r.w", "'x.r.w' is edge 'r' of leg.toml, line 6"),
        ("[outputs]", "[outputs", "leg.toml: not valid TOML"),
        ("[outputs]", '[parts.y]\nscene = "leg.toml"\n[outputs]', "leg.toml -> leg.toml"),
    ],
)
def test_a_mistake_in_the_file_of_a_part_names_that(tmp_path, old, new, told) -> None:
    assert old in _LEG
    path = _written(tmp_path, _PART + _SOURCE)
    (tmp_path / "leg.toml").write_text(_LEG.replace(old, new, 1))
    assert told in _refused(path)


def test_links_do_not_lead_out_of_the_folder(tmp_path) -> None:
    folder = tmp_path / "scene"
    folder.mkdir()
    path = _written(folder, _PART.replace("leg.toml", "link.toml") + _SOURCE)
    (tmp_path / "leg.toml").write_text(_LEG)
    (folder / "link.toml").symlink_to(tmp_path / "leg.toml")
    assert "is outside the folder" in _refused(path)


def test_many_parts_of_many_parts_are_refused(tmp_path) -> None:
    row = '[edges.r]\ntype = "resistor"\nnodes = ["a", "b"]\nresistance = 1\n'
    part = '[parts.y]\nscene = "{}"\ncount = 100\na = "a"\nb = "b"\n'
    files = {f"f{i}": row + part.format(f"f{i + 1}.toml") for i in range(3)} | {"f3": row}
    told = _refused(_written(tmp_path, part.format("f0.toml"), **files))
    assert "100 parts of 10101 declarations each" in told


def test_the_linter_looks_into_parts_once(tmp_path) -> None:
    leg = _LEG.replace("[edges.r]", "unused = 1.0\n[edges.r]", 1)
    path = _written(tmp_path, _PART.replace("[parts.x]", "[parts.x]\ncount = 3") + _SOURCE, leg=leg)
    found = cotree.load(path).lint()
    assert [(row.rule, row.name) for row in found] == [("unused-parameter", "x1.unused")]
    assert "leg.toml, line 6" in found[0].message
    (tmp_path / "leg.toml").write_text('allow = ["unused-parameter:unused"]\n' + leg)
    assert cotree.load(path).lint() == ()


@pytest.mark.parametrize("name", shipped_parts())
def test_shipped_parts_are_read_and_say_what_they_are(name) -> None:
    scene = cotree.Scene("scene", gravity=[0, 0, -9.81])
    part = cotree.load(name)
    assert part.name == name
    assert part.ports or part.inputs
    assert all(row.doc for row in part.parameters.values() if "." not in row.name)
    scene.add("x", name, **{port: f"outer_{port}" for port in part.ports})
    assert len(scene.edges) == len(part.edges)
    # Signals alone, without what they act on, are no scene that could run.
    assert all(row.severity == "error" for row in part.lint())
