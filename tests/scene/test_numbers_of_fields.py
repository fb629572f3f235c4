"""Numbers at and beyond the ends of doubles in every field of every component: run or refused."""

from __future__ import annotations

import copy
import re
import tomllib
from pathlib import Path

import numpy as np
import pytest
from evaluated_kernels import EvaluatedKernels

import cotree
from cotree.model.model import CompiledModel
from cotree.model.start import scene_start
from cotree.pipeline import formulate, generate
from cotree.program.text import ModelText
from cotree.scene.toml_file import read_scene

PAGES = sorted((Path(__file__).parents[2] / "docs" / "components").glob("*.md"))

#: As written in files: integers and floats that no double holds, its ends, and zeros.
WORDS = [
    *("1" + "0" * 400, "1" + "0" * 5000, "1e308", "-1e308", "nan", "inf", "5e-324", "-0.0", "0"),
    *("1e200", "1e-200", "1e999"),
]
_NUMBER = re.compile(r"(?<![\w.])-?\d+\.?\d*(?:e[+-]?\d+)?(?![\w.])")

#: As given in Python.
OBJECTS = [
    *(10**400, float("nan"), np.float32("inf"), np.int64(-5), -0.0, 5e-324, 1e308, True, None),
    *(1j, np.array([1.0]), [10**400], "word", {}, b"1"),
]


def evaluate(scene):
    """Form the equations and evaluate them at the start; no compiler is needed for that."""
    _, equations, _ = formulate(scene, [], None)
    program, _ = generate(equations)
    model = CompiledModel(ModelText.of(program), EvaluatedKernels(program))
    model.rhs(0.0, scene_start(model).y)
    scene.lint()  # forms and starts it once more


def run_or_refuse(act, what):
    """Accept success and refusals in a sentence; anything else is a fault."""
    try:
        with np.errstate(all="ignore"):
            act()
    except cotree.Error as error:
        return str(error)
    except Exception as error:
        raise AssertionError(f"{what}: {error!r}") from error
    return ""


def scenes_of(page):
    """List the scenes of a component's page."""
    blocks = re.findall(r"```toml\n(.*?)```", page.read_text(encoding="utf-8"), re.DOTALL)
    return [block for block in blocks if block.startswith("name")]


@pytest.mark.campaign
@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_numbers_in_files(page):
    for block in scenes_of(page):
        for match in _NUMBER.finditer(block.partition("[outputs]")[0]):
            for word in WORDS:
                text = block[: match.start()] + word + block[match.end() :]
                what = f"{text[max(0, match.start() - 30) : match.start()]}{word[:12]}"
                run_or_refuse(lambda text=text: evaluate(read_scene(text, "m", cotree.Scene)), what)


@pytest.mark.campaign
@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_objects_in_python(page):
    for block in scenes_of(page):
        data = tomllib.loads(block)
        for name, edge in data["edges"].items():
            for key in edge.keys() - {"type", "nodes"}:
                for value in OBJECTS:
                    changed = copy.deepcopy(data)
                    changed["edges"][name][key] = value
                    run_or_refuse(lambda d=changed: evaluate(_built(d)), (name, key, value))


def _built(data):
    """Declare a scene call by call."""
    scene = cotree.Scene("built", **({"gravity": data["gravity"]} if "gravity" in data else {}))
    for kind in ("parameter", "input"):
        for name, value in data.get(f"{kind}s", {}).items():
            getattr(scene, kind)(name, value["value"] if isinstance(value, dict) else value)
    for name, edge in data["edges"].items():
        fields = {key: value for key, value in edge.items() if key not in ("type", "nodes")}
        scene.edge(name, edge["type"], *edge.get("nodes", ()), **fields)
    return scene


@pytest.mark.parametrize(
    ("type", "fields", "culprit"),
    [
        ("piecewise_voltage", {"times": [0.2, 10**400, 1.7], "values": [0, 3, 0]}, "'E'"),
        ("piecewise_voltage", {"times": [0.0, 1.0], "values": [0, 10**400]}, "'E'"),
        ("resistor", {"resistance": 10**400}, "resistance of edge 'E'"),
        ("resistor", {"resistance": 5e-324}, "resistance of edge 'E'"),
        ("damper", {"axis": [1e308, 0, 0], "damping": 1.0}, "axis of edge 'E'"),
        ("prismatic", {"axis": [0, 1e308, 0]}, "axis of edge 'E'"),
    ],
)
def test_the_edge_and_the_field_are_named(type, fields, culprit):
    def act():
        scene = cotree.Scene("one")
        scene.edge("E", type, "ground", "b", **fields)
        if type == "resistor":
            scene.edge("C", "capacitor", "b", "ground", capacitance=1.0)
        else:
            scene.edge("B", "rigid_body", "ground", "b", mass=1.0)
        if type == "damper":
            scene.edge("j", "prismatic", "ground", "b", axis=[1, 0, 0])
        scene.graph()  # has no equations, whose constants overflow
        evaluate(scene)

    assert culprit in run_or_refuse(act, type)
