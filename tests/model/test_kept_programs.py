"""Programs that are kept in the cache: found only where all that they follow from is the same."""

from __future__ import annotations

import os
import pickle
import subprocess
import sys

import numpy as np
import pytest

import cotree
from cotree import pipeline
from cotree.build import cache, cache_directory
from cotree.codegen.c_files import render_model
from cotree.codegen.context import model_context
from cotree.dag.nodes import Dag, pickled_graph, unpickled_graph
from cotree.errors import SolveError
from cotree.scene.toml_file import shipped_scenes


@pytest.fixture(autouse=True)
def _kept(monkeypatch, tmp_path):
    monkeypatch.setattr(cache, "KEEPS", True)
    monkeypatch.setenv("COTREE_CACHE_DIR", str(tmp_path / "cache"))


@pytest.fixture
def formed(monkeypatch):
    """Count how often equations are formed."""
    made = []
    whole = pipeline.form_text
    monkeypatch.setattr(pipeline, "form_text", lambda *args: made.append(args) or whole(*args))
    return made


def pendulum(length: float = 2.0) -> cotree.Scene:
    scene = cotree.Scene("pendulum", gravity=[0, -9.81, 0])
    scene.parameter("L", length, unit="m")
    scene.input("torque", 0.0)
    scene.revolute("h", "ground", "A", axis=[0, 0, 1], torque="torque", initial={"theta": 0.4})
    scene.arm("rod", "A", "B", vector=[0, "-L", 0])
    scene.rigid_body("bob", "ground", "B", mass=1.0)
    return scene


@pytest.mark.sampled(4)
@pytest.mark.parametrize("name", shipped_scenes())
def test_the_text_of_a_kept_program_is_the_same(name, tmp_path):
    scene = cotree.load(name)
    wanted = [row.name for row in scene.parameters.values() if row.is_argument][:2]
    text = pipeline.form_text(scene, wanted, None, 0.0).text
    program = pickle.loads(pickle.dumps(text.program))
    # Every node, its section and its order come through, or else the text would differ.
    assert render_model(model_context(program)) == text.files
    assert program.operations == text.program.operations
    assert program.layout.units == text.program.layout.units


def test_an_arena_goes_on_interning():
    dag = Dag()
    x, y = dag.symbol("x", 0), dag.symbol("x", 1)
    z = dag.function("sin", 3.0 * x + y) - 1.0 / y
    n = len(dag)
    dag.function("cos", x)  # no value needs this node
    again, x2, z2 = unpickled_graph(pickled_graph((dag, x, z), dag))
    assert x2 is again.symbol("x", 0)
    assert again.zero is again.constant(0.0)
    assert again.one is again.constant(1.0)
    y2 = again.symbol("x", 1)
    assert again.function("sin", 3.0 * x2 + y2) - 1.0 / y2 is z2
    assert len(again) == n


@pytest.mark.compiler
def test_the_second_time_nothing_is_formed(formed):
    first = pendulum().compile(["L"])
    again = pendulum().compile(["L"])
    assert len(formed) == 1
    assert again.kernels.cached
    assert again.kernels.source == first.kernels.source
    one, other = (m.simulate((0, 2), method="dopri5") for m in (first, again))
    assert np.array_equal(one.y, other.y)
    assert np.array_equal(one.s, other.s)


@pytest.mark.compiler
def test_stages_before_the_program_are_gone_through_when_asked_for(formed):
    first = pendulum().compile(["L"])
    again = pendulum().compile(["L"])
    assert np.array_equal(first.linearize().A, again.linearize().A)
    assert len(formed) == 2
    assert again.summary() == first.summary()
    assert again.spec.formed.first.system.trees == first.spec.formed.first.system.trees
    result = again.simulate((0, 1), inputs={"torque": "-c*h.theta_dot"}, parameters={"c": 0.3})
    assert abs(result["h.theta"][-1]) < 0.4
    assert len(formed) == 3  # the closed loop; what the model itself is formed of is there


@pytest.mark.compiler
def test_another_question_has_another_answer(formed, monkeypatch):
    pendulum().compile(["L"])
    assert pendulum(3.0).compile(["L"]).default_parameters.tolist() == [3.0]
    pendulum().compile()
    pendulum().compile(["h.theta"])
    pendulum().compile(["L"], baumgarte=1.0)
    pendulum().compile(["L"], ["rod", "h"])
    assert len(formed) == 6
    monkeypatch.setattr(cache, "_sources", lambda: b"edited")
    pendulum().compile(["L"])
    assert len(formed) == 7


@pytest.mark.compiler
def test_laws_that_are_registered_are_not_kept(formed):
    kept = set()
    for law in (lambda across, k: k * across, lambda across, k: 2.0 * k * across):
        cotree.register_component("own_spring", law, domain="translational")
        scene = cotree.Scene("own")
        scene.translational_mass("m", "ground", "A", mass=1.0, initial={"v": 1.0})
        scene.edge("s", "own_spring", "ground", "A", k=1.0)
        scene.compile(optimize="-O0")
        kept.add(tuple(cache_directory().glob("*.text")))
    assert len(formed) == 2
    assert len(kept) == 1  # only C declarations, which are the same for both


@pytest.mark.compiler
def test_a_damaged_file_is_made_again(formed):
    pendulum().compile()
    for kept in cache_directory().glob("*.text"):
        kept.write_bytes(kept.read_bytes()[:-1])
    pendulum().compile()
    pendulum().compile()
    assert len(formed) == 2
    assert cotree.clear_cache() > 0
    assert not list(cache_directory().glob("*.text"))


def test_without_a_compiler_a_program_is_kept(formed, monkeypatch):
    monkeypatch.setenv("COTREE_COMPILER", "none")
    for _ in range(2):
        with pytest.warns(RuntimeWarning, match="models cannot be evaluated"):
            model = pendulum().compile(["L"])
    assert len(formed) == 1
    with pytest.raises(SolveError, match="pip install ziglang"):
        model.rhs(0.0, np.array([0.7, -0.3]))


_KEYS = """
import cotree
import hashlib, pickle
from cotree.spec import BuildSpec
from cotree.scene.toml_file import shipped_scenes
for name in shipped_scenes():
    key = BuildSpec(cotree.load(name), ("k",), {"translation": ["a"], "rotation": ["b"]}).key
    print(hashlib.sha256(pickle.dumps(key)).hexdigest())
"""


@pytest.mark.slow
def test_another_process_finds_the_same_keys():
    seeds = ("0", "4711")
    runs = [
        subprocess.run(
            [sys.executable, "-c", _KEYS],
            env={**os.environ, "PYTHONHASHSEED": seed},
            capture_output=True,
            text=True,
            check=True,
        )
        for seed in seeds
    ]
    keys = runs[0].stdout.split()
    assert len(set(keys)) == len(shipped_scenes())
    assert runs[1].stdout.split() == keys
