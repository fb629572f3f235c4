"""The steps of the formulation as text: read back, each line holds for the compiled model."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
import pytest
from bare_models import BareModel
from evaluated_kernels import EvaluatedKernels

import cotree
from cotree import Scene
from cotree.export.steps import formulation_steps
from cotree.export.symbolic import SymbolTable
from cotree.graph import f_circuit, f_cutset
from cotree.pipeline import formulate
from cotree.program.lower import lower
from cotree.scene.description import SceneDescription
from cotree.scene.graphs import choose_trees, linear_graphs
from cotree.scene.toml_file import load_scene

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from cotree.scene.graphs import TreeChoice

GOLDEN = "../tests/export/golden"

#: Some hundred roundings, in systems whose condition is below a thousand.
TOLERANCE = 1e-9

#: Trees that translation and rotation do not share.
APART = {"translation": ["j1", "r3", "h2", "r4"], "rotation": ["m6", "j1", "r3", "r4"]}

FUNCTIONS = {name: getattr(math, name) for name in ("sin", "cos", "tan", "exp", "log", "sqrt")}
FUNCTIONS |= {"Abs": abs, "pi": math.pi, "atan2": math.atan2}


@pytest.fixture
def unwrapped(monkeypatch: pytest.MonkeyPatch) -> None:
    """Put each term and equation on one line."""
    monkeypatch.setattr("cotree.export.steps._WIDTH", 10**6)


def steps(scene: Scene, name: str | None, tree: Sequence[str] | None = None) -> str:
    first, equations, _ = formulate(scene, [] if name is None else [name], tree)
    return formulation_steps(first, equations)


def lines_of(text: str) -> list[str]:
    return [line.strip() for line in text.splitlines()]


@dataclass
class Reading:
    """The text read back as numbers: terms are computed from those above them.

    Attributes
    ----------
    known : dict of str to float
        Values by the name that the text uses.
    residuals : dict of str to float
        By line: the left-hand sides of equations that are zero, and what terms that were known
        before differ by.
    """

    known: dict[str, float]
    residuals: dict[str, float] = field(default_factory=dict)

    def value(self, text: str) -> float:
        """Evaluate an expression, whose names may hold dots, carets and parentheses."""
        names = sorted(self.known, key=len, reverse=True)
        pattern = "|".join(re.escape(name) for name in names)
        code = re.sub(
            rf"(?<![\w.^])(?:{pattern})(?![\w.^(])", lambda found: f"known[{found[0]!r}]", text
        )
        return float(eval(code, {"known": self.known, **FUNCTIONS}))

    def read(self, text: str) -> None:
        """Evaluate the lines of all sections, topology only where its variables are known."""
        for line in text.splitlines():
            plain = re.sub(r"^  \S+ \(\w+\)  +", "", line).strip()
            *left, right = re.sub(r" in the axes of \S+$", "", plain).split(" = ")
            if right == "0":
                is_known = not re.search(r"[FTrω]\^", plain) or not line.startswith("    ")
                if is_known:
                    self.residuals[plain] = self.value(left[-1].split(": ")[-1])
            elif len(left) == 1 and line.startswith("  "):
                self.define(left[0], right)

    def define(self, name: str, text: str) -> None:
        """Compute the components of a term."""
        for suffix, entry in entries(text):
            value, full = self.value(entry), f"{name}{suffix}"
            if full in self.known:
                self.residuals[f"{name} = {text}"] = value - self.known[full]
            self.known[full] = value


def entries(text: str) -> Iterator[tuple[str, str]]:
    """Split a number, a vector or a matrix into components."""
    if text.startswith("diag("):
        for i, entry in zip("xyz", parts(text[5:-1], ","), strict=True):
            yield f".{i}{i}", entry
    elif not text.startswith("["):
        yield "", text
    elif ";" not in text:
        for i, entry in zip("xyz", parts(text[1:-1], ","), strict=True):
            yield f".{i}", entry
    else:
        for i, row in zip("xyz", parts(text[1:-1], ";"), strict=True):
            for j, entry in zip("xyz", parts(row, ","), strict=True):
                yield f".{i}{j}", entry


def parts(text: str, separator: str) -> list[str]:
    """Split at separators outside parentheses."""
    found, depth = [""], 0
    for letter in text:
        depth += (letter == "(") - (letter == ")")
        if letter == separator and depth == 0:
            found.append("")
        else:
            found[-1] += letter
    return found


def read_back(scene: Scene, name: str, tree: TreeChoice = None) -> Reading:
    """Evaluate the text at random states, with the rates and outputs that the program has there."""
    first, equations, _ = formulate(scene, [name], tree)
    names, program = SymbolTable.of(equations), lower(equations)
    model = BareModel(program, EvaluatedKernels(program))
    rng = np.random.default_rng(7)
    t, n = 0.4, len(model.states)
    y, s = rng.uniform(0.2, 1.0, n), rng.uniform(-1.0, 1.0, n)
    rates = model.rhs(t, y), model.sensitivity_rhs(t, y, s[:, None])[:, 0]
    outputs = model.output_values(t, y), model.output_sensitivity(t, y, s[:, None])[:, 0]
    highest = [*names.accelerations, *names.rates]
    known = {"t": t, **dict(zip(model.parameters, model.default_parameters, strict=True))}
    for along, values, derivatives, seen in zip((None, name), (y, s), rates, outputs, strict=True):
        own = derivatives[equations.n_coordinates :][: len(highest)]
        for keys, numbers in ((model.states, values), (highest, own)):
            symbols = [names.symbols[key if along is None else (key, along)] for key in keys]
            known |= {symbol.name: value for symbol, value in zip(symbols, numbers, strict=True)}
        for output, value in zip(model.outputs, seen, strict=True):
            letter, _, edge = output.partition("__")
            known[f"{letter}{names.subscripts[along]}^{edge}"] = value
    reading = Reading(known)
    reading.read(formulation_steps(first, equations))
    return reading


def odd_scene() -> Scene:
    """Use turned axes, fields of states, and a joint that points to the ground."""
    scene = Scene("odd", gravity=[0, 0, "-g*cos(b)"])
    for name in ("g", "b", "m", "J", "k", "c", "l"):
        scene.parameter(name, 0.5)
    scene.edge("j", "revolute", "ground", "A", axis=[0, 1, 0], stiffness="k", free_angle="-b")
    scene.edge("arm", "arm", "A", "B", vector=["l", "-l/3", 0])
    scene.edge("w", "weld", "B", "W", rotation=[0.1, "b", 0.2])
    scene.edge("p", "prismatic", "P", "W", axis=[1, "b", 0], damping="c*(1 + p.s**2)")
    scene.edge("body", "rigid_body", "ground", "P", mass="m + 1", inertia=["J", "b*J", 0.5])
    scene.edge("central", "spring", "A", "P", stiffness="k", free_length="l", damping="c")
    scene.edge("axial", "spring", "B", "P", axis=[0, 0, -1], stiffness="2*k", damping=1)
    scene.edge("motor", "torque", "A", "P", torque=["k", 0, "-c*j.theta_dot"])
    scene.edge("wind", "force", "ground", "P", force=["c*t", 0, 1])
    return scene


def spherical() -> Scene:
    """Hang a rod on a joint whose orientation is a quaternion."""
    scene = Scene("spherical", gravity=[0, 0, "-g"])
    for name in ("g", "L", "J"):
        scene.parameter(name, 0.7)
    scene.edge("ball", "spherical", "ground", "A")
    scene.edge("rod", "arm", "A", "B", vector=[0, "0.1*L", "-L"])
    scene.edge("bar", "rigid_body", "ground", "B", mass="L", inertia=["J", "2*J", "2.5*J"])
    return scene


def nut() -> Scene:
    """Build a nut that climbs a screw, which stands on a cross of two axes."""
    scene = Scene("nut")
    for name in ("L", "J"):
        scene.parameter(name, 0.7)
    scene.edge("cross", "universal", "ground", "A", axis=[1, 0, 0], axis2=[0, 1, 0])
    scene.edge("shaft", "rigid_body", "ground", "A", mass=1, inertia=["J", "J", "J"])
    scene.edge("turn", "screw", "A", "S", axis=[0, 0, 1], pitch="0.1*L")
    scene.edge("top", "rigid_body", "ground", "S", mass=0.2, inertia=[0.1, 0.1, 0.1])
    return scene


def filter_() -> Scene:
    """Build a source that charges a capacitor through a coil with voltage-dependent resistance."""
    scene = Scene("filter")
    for name in ("C", "L", "R"):
        scene.parameter(name, 0.6)
    scene.edge("V", "voltage_source", "a", "ground", voltage="R*sin(3*t)")
    scene.edge("R1", "resistor", "a", "b", resistance="R*(1 + 0.1*C1.v**2)")
    scene.edge("L1", "inductor", "b", "c", inductance="L")
    scene.edge("C1", "capacitor", "c", "ground", capacitance="C")
    scene.edge("R2", "resistor", "c", "ground", resistance=2)
    for edge in ("V", "R1", "L1", "C1", "R2"):
        for letter in "iv":
            scene.output(f"{letter}__{edge}", f"{edge}.{letter}")
    return scene


def two_masses() -> Scene:
    """Set two masses on one line, joined by guides with springs, one pointing backwards."""
    scene = Scene("pair")
    for name in ("m", "k", "c", "l"):
        scene.parameter(name, 0.5)
    guide = {"stiffness": "k", "damping": "c", "free_length": "l"}
    scene.edge("m1", "rigid_body", "ground", "A", mass="m")
    scene.edge("m2", "rigid_body", "ground", "B", mass="m")
    scene.edge("j1", "prismatic", "ground", "A", axis=[-1, 0, 0], **guide)
    scene.edge("j2", "prismatic", "A", "B", axis=[1, 0, 0], stiffness="2*k", initial={"s": 0.3})
    return scene


@pytest.mark.parametrize(
    ("scene", "name", "tree", "file"),
    [
        ("spring-mass-damper", "k", None, "steps-spring-mass-damper.txt"),
        ("slider-pendulum", "L", None, "steps-slider-pendulum.txt"),
        ("motor-linkage", None, None, "steps-motor-linkage.txt"),
    ],
)
def test_the_text_is_the_golden_one(
    golden: Callable[[str, str], None],
    scene: str,
    name: str | None,
    tree: Sequence[str] | None,
    file: str,
):
    golden(f"{GOLDEN}/{file}", steps(cotree.load(scene), name, tree))


@pytest.mark.sampled(3)
@pytest.mark.usefixtures("unwrapped")
@pytest.mark.parametrize(
    ("scene", "name", "tree"),
    [
        (cotree.load("slider-pendulum"), "L", None),
        (cotree.load("slider-pendulum"), "h2.theta", None),
        (cotree.load("slider-pendulum"), "L", APART),
        (cotree.load("spring-mass-damper"), "k", ["m"]),
        (odd_scene(), "b", None),
        (spherical(), "L", None),
        (nut(), "L", None),
        (filter_(), "R", None),
        (filter_(), "C1.v", None),
        (two_masses(), "l", ["m1", "m2"]),
        (two_masses(), "k", ["m1", "j2"]),
    ],
    ids=lambda value: value.name if isinstance(value, Scene) else None,
)
def test_what_is_printed_holds_for_the_compiled_model(scene: Scene, name: str, tree: TreeChoice):
    """Projected balances, built up from printed terms only, vanish; so do the final equations."""
    reading = read_back(scene, name, tree)
    assert len(reading.residuals) >= 4
    for line, residual in reading.residuals.items():
        assert abs(residual) <= TOLERANCE, line


@pytest.mark.usefixtures("unwrapped")
def test_multipliers_that_balance_one_projection_balance_all():
    """Three balances of a four-bar linkage have two multipliers."""
    scene = Scene("four-bar", gravity=[0, -9.81, 0])
    z = [0, 0, 1]
    scene.edge("base", "arm", "ground", "D", vector=[1.5, 0, 0])
    scene.edge("a", "revolute", "ground", "A", axis=z, initial={"theta": 1.5, "theta_dot": 6.0})
    scene.edge("b", "revolute", "B", "B2", axis=z)
    scene.edge("c", "revolute", "C", "C2", axis=z, damping=0.2)
    scene.edge("d", "revolute", "D", "D2", axis=z)
    for start, end, length in ("A", "B", 1.0), ("B2", "C", 2.0), ("D2", "C2", 2.0):
        scene.edge(f"to{end}", "arm", start, end, vector=[length, 0, 0])
        scene.edge(f"m{end}", "rigid_body", "ground", end, mass=1.0, inertia=0.1)
    first, equations, _ = formulate(scene, [], ["base", "a", "b", "d", "toB", "toC", "toC2"])
    names, program = SymbolTable.of(equations), lower(equations)
    model = BareModel(program, EvaluatedKernels(program))
    y = model.start().y
    rates = model.rhs(0.0, y)[equations.n_coordinates :]
    named = zip((*model.states, *names.accelerations), (*y, *rates), strict=True)
    values = {names.symbols[name].name: value for name, value in named}
    multipliers = [names.symbols[name].name for name in names.multipliers]
    text = formulation_steps(first, equations)

    def residuals(amounts: Sequence[float]) -> np.ndarray:
        reading = Reading(values | dict(zip(multipliers, amounts, strict=True)))
        reading.read(text)
        return np.array(list(reading.residuals.values()))

    rest = residuals([0.0, 0.0])
    columns = np.array([residuals(unit) - rest for unit in np.eye(2)]).T
    amounts = np.linalg.lstsq(columns, -rest, rcond=None)[0]
    assert len(rest) == 2 + 3 + 5  # constraints, projections, equations
    # Multipliers are some hundred newtons; constraints are met within the start's tolerance.
    np.testing.assert_allclose(residuals(amounts), 0.0, atol=1e-8)


def test_spring_mass_damper_goes_the_papers_way():
    lines = lines_of(steps(cotree.load("spring-mass-damper"), "k"))
    for expected in (
        "translation tree: branches s; chords m, k, c, F",
        "F^s + F^m + F^k + F^c + F^F = 0",
        "r^k - r^s = 0",
        "k (spring)      F^k = [-k*(s - l0), 0, 0]",
        "k (spring)      F_k^k = [l0 - k*s_k - s, 0, 0]",
        "F (force)       F^F = [F0*sin(t*w), 0, 0]",
        "s (prismatic)   u(s.s_dot) = [1, 0, 0]",
        "G1: m*s_ddot + c*s_dot + k*(s - l0) - F0*sin(t*w) = 0",
        "G2: m*s_ddot_k + c*s_dot_k + k*s_k + s - l0 = 0",
    ):
        assert expected in lines


def test_tree_of_the_mass_has_the_papers_matrices():
    scene = load_scene("spring-mass-damper", SceneDescription)
    tree = choose_trees(scene, linear_graphs(scene), ["m"])["translation"]
    cutset, circuit = f_cutset(tree), f_circuit(tree)
    assert cutset.columns == circuit.columns == ("m", "k", "c", "F", "s")
    np.testing.assert_array_equal(cutset.matrix, [[1, 1, 1, 1, 1]])
    assert circuit.rows == ("k", "c", "F", "s")
    np.testing.assert_array_equal(
        circuit.matrix,
        [[-1, 1, 0, 0, 0], [-1, 0, 1, 0, 0], [-1, 0, 0, 1, 0], [-1, 0, 0, 0, 1]],
    )


def test_circuits_go_through_the_tree_that_is_named():
    lines = lines_of(steps(cotree.load("spring-mass-damper"), None, ["m"]))
    for chord in "kcFs":
        assert f"r^{chord} - r^m = 0" in lines
    assert "G1: m*x_ddot + c*x_dot + k*(x - l0) - F0*sin(t*w) = 0" in lines


def test_without_a_sensitivity_only_the_first_graph_is_shown():
    text = steps(cotree.load("spring-mass-damper"), None)
    assert "G2" not in text
    assert "(4)" not in text


def test_the_initial_value_of_a_state_changes_no_field():
    lines = lines_of(steps(cotree.load("spring-mass-damper"), "s.s"))
    assert "k (spring)      F_s(0)^k = [-k*s_s(0), 0, 0]" in lines
    assert "G2: m*s_ddot_s(0) + c*s_dot_s(0) + k*s_s(0) = 0" in lines


def test_networks_have_laws_circuits_and_cutsets():
    lines = lines_of(steps(cotree.load("bridge-rectifier"), "Is"))
    for expected in (
        "electrical tree: branches winding, D1, D2, C1; chords R1, D3, D4, R2, R3",
        "i^winding + i^R1 = 0",
        "v^R1 - v^winding + v^D1 - v^D2 = 0",
        "R1 (resistor)           i^R1 = v^R1/Rs",
        "D3 (diode)              i^D3 = Is*(exp(v^D3/U) - 1)",
        "D3 (diode)              i_Is^D3 = Is*v_Is^D3*exp(v^D3/U)/U + exp(v^D3/U) - 1",
        "C1 (capacitor)          v_dot^C1 = i^C1/C",
    ):
        assert expected in lines


def test_long_equations_are_left_to_the_command_that_prints_them():
    text = steps(spherical(), "L")
    assert "(5) projection" in text
    assert "'cotree equations' without --steps prints them" in text


def test_a_field_may_name_a_variable_of_a_network():
    """Its derivative is named in the sensitivity graph, and not followed."""
    lines = lines_of(steps(cotree.load("crane"), "area"))
    assert "Q(cylinder.rod.law) = -cylinder.rod.f" in " ".join(lines)
    assert "Q_area(cylinder.rod.law) = -cylinder.rod.f_area" in " ".join(lines)
