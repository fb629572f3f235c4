"""Mutated scene files give a scene or one of cotree's errors, never anything else."""

from __future__ import annotations

import contextlib
import warnings
from importlib import resources

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from cotree import Error, Scene
from cotree.pipeline import formulate, generate
from cotree.scene.toml_file import read_scene, shipped_scenes

TEXTS = {
    name: (resources.files("cotree") / "scenes" / f"{name}.toml").read_text(encoding="utf-8")
    for name in shipped_scenes()
}

# What a slip of the hand, or ill will, puts into a file.
PIECES = st.sampled_from(
    [
        *("0", "-1", "nan", "inf", "1e400", "1e-320", "true", "[]", "{}", '""', '"', "'", "\n"),
        *("=", ",", "[", "]", "{", "}", ".", "#", "\\", "\x00", "é", "[0, 0, 0]", '"t"', '"L/0"'),
        *('"s.s"', '"j1.s_dot"', '"ground"', '"A"', '"Z"', '"9**9**9**9"', '"0**-1"', '"sqrt(-L)"'),
        *('"rigid_body"', '"revolute"', '"weld"', '"spring"', '"torque"', '"min(t, L)"', '"A.x"'),
        *("axis = [0, 0, 1]\n", "mass = 1\n", "inertia = 1\n", "[edges.new]\n", "[inputs]\n"),
        *('"(1, 2)"', '"lambda: 1"', "\"__import__('os')\"", '"a.b.c"', '"1 if 1 else 2"', '"~1"'),
    ]
)


@st.composite
def mutated(draw: st.DrawFn) -> str:
    text = TEXTS[draw(st.sampled_from(sorted(TEXTS)))]
    for _ in range(draw(st.integers(1, 4))):
        kind = draw(st.sampled_from(["token", "token", "line", "cut", "insert", "swap"]))
        if kind in ("token", "swap"):
            tokens = text.split(" ")
            i = draw(st.integers(0, len(tokens) - 1))
            j = draw(st.integers(0, len(tokens) - 1))
            if kind == "token":
                tokens[i] = draw(PIECES)
            else:
                tokens[i], tokens[j] = tokens[j], tokens[i]
            text = " ".join(tokens)
        elif kind == "line":
            lines = text.split("\n")
            i = draw(st.integers(0, len(lines) - 1))
            lines[i : i + 1] = draw(st.sampled_from([[], [lines[i], lines[i]]]))
            text = "\n".join(lines)
        else:
            i = draw(st.integers(0, len(text)))
            length = draw(st.integers(0, 30)) if kind == "cut" else 0
            inserted = draw(PIECES) if kind == "insert" else ""
            text = text[:i] + inserted + text[i + length :]
    return text


@pytest.mark.slow
@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(text=mutated())
def test_mutated_scene_is_a_scene_or_an_error(text: str) -> None:
    with contextlib.suppress(Error):
        scene = read_scene(text, "mutated.toml", Scene)
        generate(formulate(scene, list(scene.parameters)[:1], None)[1])


@settings(max_examples=100, deadline=None)
@given(text=st.text(max_size=200))
def test_any_text_as_expression_is_an_expression_or_an_error(text: str) -> None:
    scene = Scene("fuzz")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        try:
            scene.output("y", text)
        except Error:
            assert not scene.outputs


@pytest.mark.sampled(2)
@pytest.mark.parametrize("name", sorted(TEXTS))
def test_unchanged_scene_is_accepted(name: str) -> None:
    scene = read_scene(TEXTS[name], f"{name}.toml", Scene)
    assert generate(formulate(scene, list(scene.parameters), None)[1])
