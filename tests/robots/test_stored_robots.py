"""Robots against what Pinocchio gave for them, stored beside this file."""

from __future__ import annotations

import functools
import json

import numpy as np
import pytest
from robot_files import (
    HERE,
    LINKS,
    STORED,
    array_of,
    inertia_of,
    read,
    sensitivities_to,
    stored_file,
)

REFERENCES = json.loads((HERE / "references.json").read_text(encoding="utf-8"))

# Of the largest component. Both sides round: mass matrices of these robots have condition numbers
# up to 1e5, and 1e-16 times that remains.
CLOSE = 1e-11
CLOSE_SLOPES = 1e-10


@functools.cache
def model_of(name):
    link = LINKS[name]
    scene = read(stored_file(name), STORED[name][1])
    return scene.compile(sensitivities_to(link), tunable=())


def apart(found, expected):
    expected = np.asarray(expected)
    return np.max(np.abs(np.asarray(found) - expected)) / np.max(np.abs(expected))


def cases(name, model):
    for case in REFERENCES[name]:
        yield case, array_of(model.states, case["state"]), array_of(model.inputs, case["inputs"])


@pytest.mark.sampled(1)
@pytest.mark.compiler
@pytest.mark.parametrize("name", STORED)
def test_accelerations(name):
    model = model_of(name)
    for case, y, u in cases(name, model):
        rates = dict(zip(model.states, model.rhs(0.0, y, u=u), strict=True))
        found = [rates[speed] for speed in case["rates"]]
        assert apart(found, list(case["rates"].values())) < CLOSE


@pytest.mark.sampled(1)
@pytest.mark.compiler
@pytest.mark.parametrize("name", [name for name, row in STORED.items() if row[1] == "fixed"])
def test_jacobians(name):
    model = model_of(name)
    n = len(model.states) // 2
    for case, y, u in cases(name, model):
        speeds = [model.states.index(speed) for speed in case["rates"]]
        jacobian = model.jacobian(0.0, y, u=u)
        positions = [i - n for i in speeds]
        assert apart(jacobian[np.ix_(speeds, positions)], case["by_position"]) < CLOSE_SLOPES
        assert apart(jacobian[np.ix_(speeds, speeds)], case["by_speed"]) < CLOSE_SLOPES


@pytest.mark.slow
@pytest.mark.compiler
@pytest.mark.parametrize("name", STORED)
def test_sensitivities_to_all_of_a_links_inertia(name):
    model = model_of(name)
    nothing = np.zeros((len(model.states), len(model.sensitivities)))
    for case, y, u in cases(name, model):
        found = model.sensitivity_rhs(0.0, y, nothing, u=u)
        for column, expected in zip(found.T, case["by_inertia"], strict=True):
            rates = dict(zip(model.states, column, strict=True))
            assert (
                apart([rates[speed] for speed in expected], list(expected.values())) < CLOSE_SLOPES
            )


@pytest.mark.slow
@pytest.mark.compiler
def test_tunable_inertia_gives_what_a_changed_file_gives(tmp_path):
    """Parameters reach the kernels: halve a mass in the file, or at the call."""
    text = stored_file("ur5").read_text(encoding="utf-8")
    assert text.count('<mass value="2.275"/>') == 1
    changed = tmp_path / "changed.urdf"
    changed.write_text(text.replace('<mass value="2.275"/>', '<mass value="1.1375"/>'))
    model, other = read(stored_file("ur5")).compile(), read(changed).compile(tunable=[])
    y = np.linspace(0.3, 1.4, len(model.states))
    p = model.kernels.parameter_array({"forearm_link_mass": 1.1375})
    assert apart(model.rhs(0.0, y, p), other.rhs(0.0, y)) < CLOSE
    assert apart(model.rhs(0.0, y), other.rhs(0.0, y)) > 1e-2
    assert not other.parameters


def test_inertia_of_the_stored_robots_is_read_whole():
    """The mass of all links is what the file's own numbers sum to."""
    import re

    for name, (_, base) in STORED.items():
        scene = read(stored_file(name), base)
        found = sum(row.value for key, row in scene.parameters.items() if key.endswith("_mass"))
        text = re.sub(r"<!--.*?-->", "", stored_file(name).read_text(), flags=re.DOTALL)
        masses = re.findall(r'<mass\s+value="([^"]*)"', text)
        assert found == pytest.approx(sum(map(float, masses)), rel=1e-12)
        assert inertia_of(scene, LINKS[name])[1] > 0.0
