"""Symbolic equations with multipliers and quaternions, as numbers against the compiled model."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
import sympy

from cotree import Scene

if TYPE_CHECKING:
    from collections.abc import Mapping

    from cotree.export.symbolic import Key, SymbolicEquations

#: Some ten to fifty roundings for each entry, and systems whose condition is below a thousand.
TOLERANCE = 1e-10


def four_bar() -> Scene:
    """Close a loop of three turning bars with a hinge that has a spring and a damper."""
    scene = Scene("four_bar", gravity=[0, "-g", 0])
    for name, value in {"g": 9.81, "a": 0.3, "b": 0.7, "c": 0.5, "d": 0.6, "m": 2.0}.items():
        scene.parameter(name, value)
    end = "ground"
    for joint, length in (("A", "a"), ("B", "b"), ("C", "c")):
        first, middle, last = f"{joint}1", f"{joint}2", f"{joint}3"
        start = {"theta": 1.2} if joint == "B" else {}  # bars in a line could not close the loop
        scene.edge(joint, "revolute", end, first, axis=[0, 0, 1], damping=0.1, initial=start)
        scene.edge(f"l{joint}", "arm", first, last, vector=[length, 0, 0])
        scene.edge(f"c{joint}", "arm", first, middle, vector=[f"{length}/2", 0.1, 0])
        scene.edge(f"b{joint}", "rigid_body", "ground", middle, mass="m", inertia=f"0.1 + {length}")
        end = last
    scene.edge("frame", "arm", "ground", "D", vector=["d", 0, 0])
    scene.edge(
        "D4", "revolute", "D", end, axis=[0, 0, 1], damping=0.3, stiffness=2.0, free_angle=0.3
    )
    return scene


BARS = [name for joint in "ABC" for name in (joint, f"l{joint}", f"c{joint}")] + ["frame"]


def spherical_pendulum() -> Scene:
    scene = Scene("spherical_pendulum", gravity=[0, 0, "-g"])
    for name, value in {"g": 9.81, "L": 0.8, "m": 1.3}.items():
        scene.parameter(name, value)
    scene.edge("ball", "spherical", "ground", "A")
    scene.edge("rod", "arm", "A", "C", vector=[0, 0.1, "-L"])
    scene.edge("bob", "rigid_body", "ground", "C", mass="m", inertia=[0.1, "0.2*L", 0.2])
    return scene


def skate() -> Scene:
    """A free body on a blade, whose constraint is on rates, with a rod to the ground."""
    scene = Scene("skate", gravity=[0, 0, "-g"])
    for name, value in {"g": 9.81, "L": 0.8, "m": 1.3}.items():
        scene.parameter(name, value)
    scene.edge("f", "free", "ground", "C", initial={"z": "-L"})
    scene.edge("body", "rigid_body", "ground", "C", mass="m", inertia=[0.1, "0.2*L", 0.2])
    scene.edge("blade", "knife_edge", "ground", "C", axis=[0, 1, 0])
    scene.edge("rod", "distance", "ground", "C", length="L + 0.1*t")
    return scene


def shared(rows: list[sympy.Expr]) -> Any:
    return sympy.cse(rows, order="none", list=False)


def solved(
    equations: SymbolicEquations, name: str | None, values: Mapping[Key, float]
) -> np.ndarray:
    """Solve the equations of one graph for their unknowns, which they are linear in."""
    rows = [row.lhs for row in (equations.sensitivity[name] if name else equations.governing)]
    keys = (*equations.accelerations, *equations.multipliers)
    unknowns = [equations.symbols[(key, name) if name else key] for key in keys]
    known = {equations.symbols[key]: value for key, value in values.items()}
    # Shared subexpressions are printed once: written out they take half a minute.
    evaluate = sympy.lambdify([*known, *unknowns], rows, cse=shared)
    rest = np.array(evaluate(*known.values(), *np.zeros(len(keys))), dtype=float)
    columns = [evaluate(*known.values(), *unit) - rest for unit in np.eye(len(keys))]
    return np.linalg.solve(np.array(columns).T, -rest)


@pytest.mark.sampled(1)
@pytest.mark.parametrize(
    ("scene", "tree", "name"),
    [
        (four_bar(), BARS, "a"),
        (spherical_pendulum(), ["ball", "rod"], "L"),
        (skate(), ["f"], "L"),
    ],
    ids=lambda value: value.name if isinstance(value, Scene) else None,
)
def test_equations_have_the_accelerations_of_the_model(scene: Scene, tree: list[str], name: str):
    model, equations = scene.compile([name], tree), scene.equations([name], tree)
    assert model.states == equations.states
    rng = np.random.default_rng(3)
    t, n_speeds = 0.4, len(equations.accelerations)
    state = rng.uniform(0.2, 1.0, len(model.states))
    tangents = rng.uniform(-1.0, 1.0, len(model.states))
    values: dict[Key, float] = {"t": t}
    values |= zip(model.parameters, model.default_parameters, strict=True)
    values |= zip(model.states, state, strict=True)
    unknowns = solved(equations, None, values)
    expected = model.rhs(t, state)[-n_speeds:]
    np.testing.assert_allclose(unknowns[:n_speeds], expected, rtol=TOLERANCE, atol=TOLERANCE)

    values |= zip((*equations.accelerations, *equations.multipliers), unknowns, strict=True)
    values |= {(key, name): value for key, value in zip(model.states, tangents, strict=True)}
    along = solved(equations, name, values)[:n_speeds]
    expected = model.sensitivity_rhs(t, state, tangents[:, None])[-n_speeds:, 0]
    np.testing.assert_allclose(along, expected, rtol=TOLERANCE, atol=TOLERANCE)


def test_multipliers_and_free_speeds_have_symbols_of_their_own():
    equations = four_bar().equations(["a"], BARS)
    assert equations.multipliers == ("D4.x", "D4.y")
    assert equations.symbols["D4.x"].name == "lambda_D4_x"
    assert equations.symbols["D4.x", "a"].name == "lambda_D4_x_a"
    assert len(equations.governing) == len(equations.lines("a")) == 5
    assert equations.symbols["D4.x"] in equations.governing[0].free_symbols
    pendulum = spherical_pendulum().equations(["L"], ["ball", "rod"])
    quaternion = tuple(f"ball.q{i}" for i in range(4))
    assert pendulum.states == (*quaternion, "ball.w1", "ball.w2", "ball.w3")
    assert pendulum.accelerations == ("ball.w1_dot", "ball.w2_dot", "ball.w3_dot")
    assert pendulum.symbols["ball.w1_dot", "L"].name == "w1_dot_L"
    assert "ball.q0_dot" not in pendulum.symbols
    for shown in (equations, pendulum):
        assert len(set(shown.symbols.values())) == len(shown.symbols)


def test_constraints_follow_at_the_level_of_accelerations():
    scene = Scene("bead")
    scene.edge("turn", "revolute", "ground", "A", axis=[0, 0, 1], motion="t**2")
    scene.edge("body", "rigid_body", "ground", "A", mass=1, inertia=0.5)
    assert scene.equations(tree=["turn"]).lines() == [
        "theta_ddot/2 - lambda_turn_motion = 0",
        "theta_ddot - 2 = 0",
    ]


def test_latex_indexes_the_letters_of_free_speeds_once():
    scene = Scene("two")
    for i in (1, 2):
        scene.edge(f"f{i}", "free", "ground", f"C{i}")
        scene.edge(f"b{i}", "rigid_body", "ground", f"C{i}", mass=1, inertia=[1, 2, 3])
    scene.edge("rod", "distance", "C1", "C2", length=2)
    text = scene.equations(tree=["f1", "f2"]).latex()
    assert r"\dot{v}_{x,f_{1}}" in text
    assert r"\dot{w}_{1,f_{1}}" in text
    assert r"w_{2,f_{1}}" in text
    assert r"\lambda_{rod_{length}}" in text
    assert "}_{1}_{" not in text
