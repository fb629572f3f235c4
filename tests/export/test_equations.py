"""Symbolic equations against the paper's, and the way from nodes to SymPy."""

from __future__ import annotations

import math
import random
import sys
from typing import TYPE_CHECKING

import pytest
import sympy

from cotree import Scene
from cotree.dag.evaluate import evaluate
from cotree.dag.lookup import LinearTable
from cotree.dag.multi_output import Function, call, solve, table
from cotree.dag.nodes import Dag
from cotree.export.spelling import short_names
from cotree.export.symbolic import SymbolicEquations, rational, symbolic_equations, to_sympy
from cotree.formulation.first_graph import form_first_graph
from cotree.scene.description import SceneDescription
from cotree.scene.graphs import choose_trees, joint_tree, linear_graphs
from cotree.scene.toml_file import load_scene
from cotree.sensitivity.graphs import form_equations

if TYPE_CHECKING:
    from cotree.equations import Equations


def formed(scene: str | SceneDescription, *names: str) -> Equations:
    if isinstance(scene, str):
        scene = load_scene(scene, SceneDescription)
    tree = joint_tree(scene, choose_trees(scene, linear_graphs(scene), None))
    return form_equations(form_first_graph(scene, tree), names)


def symbolic(scene: str | SceneDescription, *names: str) -> SymbolicEquations:
    return symbolic_equations(formed(scene, *names))


def chain(n: int) -> SceneDescription:
    """Hang ``n`` rods on each other by revolute joints."""
    scene = SceneDescription("chain", gravity=[0, "-g", 0])
    scene.parameter("g", 9.81)
    end = "ground"
    for i in range(1, n + 1):
        scene.parameter(f"m{i}", 1.0)
        scene.parameter(f"L{i}", 1.0)
        scene.edge(f"h{i}", "revolute", end, f"A{i}", axis=[0, 0, 1])
        scene.edge(f"half{i}", "arm", f"A{i}", f"C{i}", vector=[0, f"-L{i}/2", 0])
        scene.edge(f"rod{i}", "arm", f"A{i}", f"E{i}", vector=[0, f"-L{i}", 0])
        scene.edge(
            f"body{i}", "rigid_body", "ground", f"C{i}", mass=f"m{i}", inertia=f"m{i}*L{i}**2/12"
        )
        end = f"E{i}"
    return scene


# Symbols of the paper, as mathematics writes them.
m1, m2, L, r, zeta, k, s0, g = sympy.symbols("m1 m2 L r zeta k s0 g", real=True)
s, ds, dds = sympy.symbols("s s_dot s_ddot", real=True)
theta, dtheta, ddtheta = sympy.symbols("theta theta_dot theta_ddot", real=True)
s_L, ds_L, dds_L = sympy.symbols("s_L s_dot_L s_ddot_L", real=True)
theta_L, dtheta_L, ddtheta_L = sympy.symbols("theta_L theta_dot_L theta_ddot_L", real=True)

#: Paper, Eq. (8): the slider's equation second there, first here, as its coordinate is.
EQUATION_8 = (
    m2 * (L / 2) * sympy.cos(theta) * ddtheta
    + (m1 + m2) * dds
    - m2 * (L / 2) * sympy.sin(theta) * dtheta**2
    + k * (s - s0),
    m2 * (r**2 / 4 + L**2 / 3) * ddtheta
    + m2 * (L / 2) * sympy.cos(theta) * dds
    + m2 * g * (L / 2) * sympy.sin(theta)
    + zeta * dtheta,
)


def difference(equation: sympy.Eq, expected: sympy.Expr) -> sympy.Expr:
    assert equation.rhs == 0
    return sympy.simplify(sympy.expand(equation.lhs - expected))


def test_slider_pendulum_is_the_papers_equation_8():
    equations = symbolic("slider-pendulum")
    assert equations.states == ("j1.s", "h2.theta", "j1.s_dot", "h2.theta_dot")
    for equation, expected in zip(equations.governing, EQUATION_8, strict=True):
        assert difference(equation, expected) == 0


def test_sensitivity_to_the_length_is_the_derivative_of_equation_8():
    along = {
        symbol: (sympy.Function(symbol.name)(L), tangent)
        for symbol, tangent in (
            (s, s_L),
            (ds, ds_L),
            (dds, dds_L),
            (theta, theta_L),
            (dtheta, dtheta_L),
            (ddtheta, ddtheta_L),
        )
    }
    equations = symbolic("slider-pendulum", "L")
    assert list(equations.sensitivity) == ["L"]
    for equation, expected in zip(equations.sensitivity["L"], EQUATION_8, strict=True):
        total = expected.subs({symbol: f for symbol, (f, _) in along.items()}).diff(L)
        total = total.subs({f.diff(L): tangent for f, tangent in along.values()})
        total = total.subs({f: symbol for symbol, (f, _) in along.items()})
        assert difference(equation, total) == 0


def test_sensitivity_to_the_length_is_the_papers_equations_9_and_10():
    # Two dots stand where the scan of the paper shows one on the second derivatives of s_L and
    # theta_L.
    sine, cosine = sympy.sin(theta), sympy.cos(theta)
    upsilon_3 = (
        2 * m2 * (L / 3) * ddtheta
        + (m2 / 2) * g * sine
        + m2 * g * (L / 2) * cosine * theta_L
        + zeta * dtheta_L
    )
    upsilon_1 = (
        (cosine - L * sine * theta_L) * ddtheta / 2
        - (L * sine * dtheta) * dtheta_L
        - (sine + L * cosine * theta_L) * dtheta**2 / 2
    )
    expected = (
        m1 * dds_L + m2 * (dds_L + (L / 2) * cosine * ddtheta_L + upsilon_1) + k * s_L,
        m2 * (r**2 / 4 + L**2 / 3) * ddtheta_L
        + (m2 / 2) * (cosine - L * sine * theta_L) * dds
        + m2 * (L / 2) * cosine * dds_L
        + upsilon_3,
    )
    equations = symbolic("slider-pendulum", "L")
    for equation, row in zip(equations.sensitivity["L"], expected, strict=True):
        assert difference(equation, row) == 0


def test_spring_mass_damper_is_both_lines_of_equation_7():
    m, c, l0, F0, w, t = sympy.symbols("m c l0 F0 w t", real=True)
    s_k, ds_k, dds_k = sympy.symbols("s_k s_dot_k s_ddot_k", real=True)
    equations = symbolic("spring-mass-damper", "k")
    (governing,), (sensitivity,) = equations.governing, equations.sensitivity["k"]
    expected = m * dds + k * (s - l0) + c * ds - F0 * sympy.sin(w * t)
    assert difference(governing, expected) == 0
    assert difference(sensitivity, m * dds_k + (s - l0) + k * s_k + c * ds_k) == 0
    assert equations.lines() == ["m*s_ddot + c*s_dot + k*(s - l0) - F0*sin(t*w) = 0"]
    assert equations.lines("k") == ["m*s_ddot_k + c*s_dot_k + k*s_k + s - l0 = 0"]


def test_plain_text_has_one_equation_a_line_and_inertia_first():
    lines = str(symbolic("slider-pendulum", "L")).splitlines()
    assert len(lines) == 4
    assert lines[:2] == [
        "s_ddot*(m1 + m2) + L*m2*theta_ddot*cos(theta)/2 - L*m2*theta_dot**2*sin(theta)/2 "
        "+ k*(s - s0) = 0",
        "L*m2*s_ddot*cos(theta)/2 + m2*theta_ddot*(L**2/3 + r**2/4) + theta_dot*zeta "
        "+ L*g*m2*sin(theta)/2 = 0",
    ]
    assert lines[2].startswith("s_ddot_L*(m1 + m2) + L*m2*theta_ddot_L*cos(theta)/2")


def test_latex_writes_dots_greek_letters_and_indices():
    text = symbolic("slider-pendulum", "L", "h2.theta_dot").latex()
    assert text.startswith("\\begin{align}\n")
    assert text.endswith("&= 0.\n\\end{align}")
    assert text.count("&= 0") == 6
    assert r"\ddot{s} \left(m_{1} + m_{2}\right)" in text
    assert r"\dot{\theta} \zeta" in text
    assert r"\ddot{\theta}_{L}" in text
    assert r"k s_{\dot{\theta}(0)}" in text


def test_governing_equations_are_the_balances_of_the_formulation():
    equations = formed(chain(3))
    symbols = symbolic_equations(equations)
    dag, rng = equations.dag, random.Random(1)
    by_name = {parameter.name: i for i, parameter in enumerate(equations.parameters)}
    values = {dag.symbol("p", i): rng.uniform(0.5, 2) for i in by_name.values()}
    values |= {state.symbol: rng.uniform(-1, 1) for state in equations.states}
    values |= {node: rng.uniform(-1, 1) for node in equations.unknowns}
    shown = {symbols.symbols[name]: values[dag.symbol("p", i)] for name, i in by_name.items()}
    shown |= {symbols.symbols[x.name]: values[x.symbol] for x in equations.states}
    for name, node in zip(symbols.states, equations.unknowns, strict=False):
        shown[symbols.symbols[f"{name}_ddot"]] = values[node]
    for row, equation in zip(evaluate(equations.balances, values), symbols.governing, strict=True):
        # Some hundred roundings of terms of size ten.
        assert float(equation.lhs.subs(shown)) == pytest.approx(float(row), abs=1e-12)


def test_symbols_and_initial_values_by_name():
    equations = symbolic("spring-mass-damper", "x0", "s.s")
    x0 = sympy.Symbol("x0", real=True)
    assert equations.symbols["x0"] == x0
    assert equations.symbols["s.s_ddot"].name == "s_ddot"
    assert equations.symbols["s.s_dot", "x0"].name == "s_dot_x0"
    assert equations.symbols["s.s", "s.s"].name == "s_s(0)"
    assert all(symbol.is_real for symbol in equations.symbols.values())
    assert equations.initial["s.s"] == x0
    assert equations.initial["s.s", "x0"] == 1
    assert equations.initial["s.s", "s.s"] == 1
    assert equations.initial["s.s_dot", "s.s"] == 0


def test_names_of_coordinates_give_way_to_parameters_and_to_each_other():
    assert short_names(["j1.s", "h2.theta"], ["m"]) == {"j1.s": "s", "h2.theta": "theta"}
    assert short_names(["j1.s"], ["s"]) == {"j1.s": "s_j1"}
    assert short_names(["j1.s"], ["s_dot", "s_j1"]) == {"j1.s": "s_j1_"}
    assert short_names(["a.s", "b.s"], []) == {"a.s": "s_a", "b.s": "s_b"}


def test_a_sensitivity_never_shares_its_name_with_a_parameter():
    scene = SceneDescription("clash")
    for name in ("m", "k", "s_k"):
        scene.parameter(name, 1.0)
    scene.edge("body", "rigid_body", "ground", "A", mass="m")
    scene.edge("guide", "prismatic", "ground", "A", axis=[1, 0, 0], stiffness="k*s_k")
    equations = symbolic(scene, "k")
    assert equations.symbols["guide.s", "k"] != equations.symbols["s_k"]
    assert len(set(equations.symbols.values())) == len(equations.symbols)


def test_inputs_and_constants_that_are_not_tunable():
    scene = SceneDescription("driven")
    scene.parameter("m", 0.3, tunable=False)
    scene.input("u", "sin(t)")
    scene.edge("body", "rigid_body", "ground", "A", mass="m")
    scene.edge("guide", "prismatic", "ground", "A", axis=[1, 0, 0], force="u")
    equations = symbolic(scene)
    assert "m" not in equations.symbols
    assert str(equations) == "3*s_ddot/10 - u = 0"


def test_a_chain_of_five_rods_prints_a_line_for_each_coordinate_and_graph():
    text = str(symbolic(chain(5), "L1", "m3"))
    assert len(text.splitlines()) == 15


@pytest.mark.parametrize(
    ("value", "expected"),
    [
        (0.5, sympy.Rational(1, 2)),
        (1.0 / 12.0, sympy.Rational(1, 12)),
        (9.81, sympy.Rational(981, 100)),
        (-3.0, sympy.Integer(-3)),
        (1e6, sympy.Integer(10**6)),
    ],
)
def test_constants_become_the_simplest_rational(value: float, expected: sympy.Expr):
    assert rational(value) == expected


@pytest.mark.parametrize("value", [math.pi, 1e-9, 6.02214076e23, 0.1 + 0.2])
def test_constants_without_a_simple_rational_stay_what_they_are(value: float):
    assert rational(value).is_Float
    assert float(rational(value)) == value


def test_every_operation_has_the_value_of_the_program():
    dag = Dag()
    x, y = dag.symbol("x", 0), dag.symbol("x", 1)
    names = ("sqrt", "sin", "cos", "tan", "asin", "acos", "atan", "sinh", "cosh", "tanh", "erf")
    nodes = [dag.function(name, x) for name in (*names, "exp", "log", "abs")]
    nodes += [dag.function("sign", -x), dag.function("atan2", y, -x), x**y, x - y, -(x / y)]
    nodes += [dag.select(x - y, x, y), dag.select(y - x, x, y)]
    a, b = sympy.symbols("a b", real=True)
    point = {x: 0.3, y: 0.7}
    for node, value in zip(nodes, evaluate(nodes, point), strict=True):
        (expression,) = to_sympy([node], {x: a, y: b})
        shown = float(expression.subs({a: point[x], b: point[y]}))
        # One or two library calls, each good to a few units in the last place.
        assert shown == pytest.approx(float(value), rel=1e-14), node


def test_long_programs_need_no_recursion():
    dag = Dag()
    x = dag.symbol("x", 0)
    total, n = x, 2 * sys.getrecursionlimit()
    for i in range(n):
        total = x * (total + dag.symbol("p", i))
    symbols = {dag.symbol("p", i): sympy.Symbol(f"p{i}", real=True) for i in range(n)}
    (expression,) = to_sympy([total], {x: s, **symbols})
    assert expression.args[0] == s


def test_nodes_with_several_results_become_named_functions():
    dag = Dag()
    x, a = dag.symbol("x", 0), sympy.Symbol("a", real=True)
    first, second = LinearTable((0.0, 1.0), (0.0, 2.0)), LinearTable((0.0, 1.0), (1.0, 0.0))
    law = Function("tyre", 2, lambda values: [values[0], 0.0])
    nodes = [*table(dag, first, x), table(dag, second, x)[0], *call(dag, law, [x])]
    nodes += solve(dag, [[x]], [dag.one])
    shown = [str(expression) for expression in to_sympy(nodes, {x: a})]
    assert shown == [
        "table_1(a)",
        "table_1_slope(a)",
        "table_2(a)",
        "tyre_1(a)",
        "tyre_2(a)",
        "solve_1_x_1(a, 1)",
        "solve_1_rank(a, 1)",
        "solve_1_is_determined(a, 1)",
    ]


def test_a_symbol_without_a_name_is_refused():
    dag = Dag()
    with pytest.raises(KeyError, match="no SymPy symbol is given"):
        to_sympy([dag.symbol("p", 0) + 1.0], {})


def test_events_are_listed() -> None:
    scene = Scene("ball", gravity=[0, 0, "-g"])
    scene.parameter("g", 9.81)
    scene.parameter("e", 0.8)
    scene.mode("n", 0)
    scene.edge("j", "prismatic", "ground", "B", axis=[0, 0, 1], initial={"s": 2.0})
    scene.edge("b", "rigid_body", "ground", "B", mass=1.0)
    scene.event("hit", "j.s", direction=-1, impact={"restitution": "e"}, set={"n": "n + 1"})
    scene.event("top", "j.s_dot", direction=1, stop=True)
    scene.event("seen", "j.s - 1")
    found = scene.equations(["e"])
    assert found.event_lines() == [
        "hit: where s falls through 0, n := n + 1, an impact with restitution e",
        "top: where s_dot rises through 0, the run ends",
        "seen: where s - 1 passes 0, it is noted",
    ]
    assert str(found).endswith("\n".join(found.event_lines()))
    assert found.events["hit"].set == {"n": found.symbols["n"] + 1}
    assert found.events["hit"].restitution == found.symbols["e"]
