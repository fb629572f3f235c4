"""Networks without one solution: each is refused, and the message names the edges at fault."""

from __future__ import annotations

import pytest

from cotree import Scene
from cotree.errors import FormulationError, ParameterError, SingularSystemError, TopologyError
from cotree.pipeline import formulate


def network(*rows: tuple[object, ...], **initial: dict[str, float]) -> Scene:
    """Write a scene from rows of name, plus, minus and value; the first letter says what it is.

    Current or voltage of the last is an output.
    """
    types = {
        "R": ("resistor", "resistance"),
        "C": ("capacitor", "capacitance"),
        "L": ("inductor", "inductance"),
        "V": ("voltage_source", "voltage"),
        "I": ("current_source", "current"),
    }
    scene = Scene("refused")
    scene.output("first", f"{rows[-1][0]}.{'v' if str(rows[-1][0])[0] == 'L' else 'i'}")
    scene.input("u", 0.0)
    for name, plus, minus, value in rows:
        kind, field = types[str(name)[0]]
        scene.edge(
            str(name), kind, str(plus), str(minus), initial=initial.get(str(name)), **{field: value}
        )
    return scene


G = "ground"

CASES = {
    "voltage sources side by side": (
        network(("V1", "a", G, 1), ("V2", "a", G, 2), ("R", "a", G, 1)),
        TopologyError,
        ("V1", "V2"),
    ),
    "a loop of three voltage sources": (
        network(("V1", "a", G, 1), ("V2", "b", "a", 2), ("V3", "b", G, 2), ("R", "b", G, 1)),
        TopologyError,
        ("V1", "V2", "V3"),
    ),
    "a node that only current sources reach": (
        network(("I1", "a", G, 1), ("I2", "a", "b", 2), ("R", "b", G, 1)),
        TopologyError,
        ("I1", "I2", "node a"),
    ),
    "a part that nothing connects": (
        network(("R1", "a", G, 1), ("R2", "b", "c", 1), ("C", "b", "c", 1)),
        TopologyError,
        ("b", "c", "ground"),
    ),
    "a capacitor across an input": (
        network(("V1", "a", G, "u"), ("C1", "a", G, 1)),
        FormulationError,
        ("V1", "input"),
    ),
    "an inductor in series with an input": (
        network(("I1", G, "a", "u"), ("L1", "a", G, 1)),
        FormulationError,
        ("I1", "input"),
    ),
    "a capacitor across a step of time": (
        network(("V1", "a", G, "max(0, sign(t - 1))"), ("C1", "a", G, 1)),
        FormulationError,
        ("V1", "jumps"),
    ),
    "a capacitor across what jumps wherever a sine is zero": (
        network(("V1", "a", G, "sign(sin(t))"), ("C1", "a", G, 1)),
        FormulationError,
        ("V1", "jumps"),
    ),
    "a resistance of zero": (
        network(("V1", "a", G, 1), ("R1", "a", G, 0)),
        ParameterError,
        ("R1", "resistance"),
    ),
}


@pytest.mark.parametrize("case", CASES, ids=str)
def test_the_edges_at_fault_are_named(case):
    scene, kind, named = CASES[case]
    with pytest.raises(kind) as caught:
        formulate(scene, (), None)
    for name in named:
        assert name in str(caught.value), str(caught.value)


def test_transformers_that_contradict():
    scene = network(("V1", "a", G, 1), ("V2", "b", G, 1))
    scene.edge("T", "transformer", primary=["a", G], secondary=["b", G], ratio=2)
    with pytest.raises(TopologyError, match="T"):
        formulate(scene, (), None)


@pytest.mark.compiler
def test_a_network_that_is_singular_at_its_values_only():
    """A transformer of ratio one across itself: no topology says so, the numbers do."""
    scene = network(("R1", "a", G, 1), ("C1", "b", G, 1), ("R2", "a", "b", 1))
    scene.parameter("n", 1.0)
    scene.edge("T", "transformer", primary=["a", G], secondary=["a", G], ratio="n")
    with pytest.raises(SingularSystemError, match="transformers"):
        scene.compile()
