"""Species, sources and reactions determine concentrations; a node without them is refused.

Every legal use has a closed form here, every other is refused by name.
"""

from __future__ import annotations

import numpy as np
import pytest

import cotree
from cotree import Scene
from cotree.errors import SceneError, TopologyError

# Ten digits asked for over some tens of steps: eight are left.
TIGHT = {"method": "dop853", "rtol": 1e-11, "atol": 1e-13, "t_eval": np.linspace(0, 1, 5)}


def _vessel(*names, start=2.0):
    """A scene with species at nodes, and a rate ``k``."""
    scene = Scene("vessel")
    scene.parameter("k", 0.7)
    for name in names:
        scene.edge(f"S{name}", "species", name, "ground", volume=1.0, initial={"c": start})
    return scene


@pytest.mark.parametrize(
    ("fields", "exact"),
    [
        ({"products": ["A"]}, lambda k, t: 2 + k * t),
        ({"reactants": ["A"]}, lambda k, t: 2 * np.exp(-k * t)),
        ({"reactants": ["A"], "reverse_rate": 0.3}, lambda k, t: _towards(0.3 / k, k, t)),
        ({"products": ["A"], "reverse_rate": 0.3}, lambda k, t: _towards(k / 0.3, 0.3, t)),
        ({"reactants": ["A", "A"]}, lambda k, t: 2 / (1 + 4 * k * t)),
        ({"reactants": ["A"], "products": ["A", "A"]}, lambda k, t: 2 * np.exp(k * t)),
        ({"reactants": ["A", "A"], "products": ["A"]}, lambda k, t: 2 / (1 + 2 * k * t)),
        ({"reactants": ["A"], "products": ["A"]}, lambda k, t: 2 + 0 * t),
    ],
)
def test_sources_and_sinks_have_their_closed_forms(fields, exact):
    scene = _vessel("A")
    scene.edge("R", "reaction", rate="k", **fields)
    scene.output("a", "A.c")
    scene.output("zero", "R.A.n + SA.n")  # the balance of the node
    if fields.get("reactants") == fields.get("products"):
        with pytest.warns(RuntimeWarning, match="no state or output depends on parameter 'k'"):
            model = scene.compile(["k"])
    else:
        model = scene.compile(["k"])
    result = model.simulate((0, 1), **TIGHT)
    np.testing.assert_allclose(result["a"], exact(0.7, result.t), rtol=1e-9)
    np.testing.assert_allclose(result["zero"], 0.0, atol=1e-14)
    slope = (exact(0.7 + 1e-6, result.t) - exact(0.7 - 1e-6, result.t)) / 2e-6
    # Central differences of step 1e-6: 1e-12 of truncation, 1e-10 of rounding.
    np.testing.assert_allclose(result.sensitivity("SA.c", "k"), slope, atol=1e-8)


def _towards(end, rate, t):
    return end + (2 - end) * np.exp(-rate * t)


def test_a_catalyst_on_both_sides_has_no_flow():
    scene = _vessel("A", "B", "E")
    scene.edge("R", "reaction", reactants=["A", "E"], products=["B", "E"], rate="k")
    scene.output("taken", "R.E.n")
    result = scene.compile(["k"]).simulate((0, 1), **TIGHT)
    a = 2 * np.exp(-1.4 * result.t)
    np.testing.assert_allclose(result["SA.c"], a, rtol=1e-9)
    np.testing.assert_allclose(result["SB.c"], 4 - a, rtol=1e-9)
    assert np.all(result["SE.c"] == 2.0)
    assert np.all(result["taken"] == 0.0)
    np.testing.assert_allclose(
        result.sensitivity("SB.c", "k"), 2 * result.t * a, rtol=1e-8, atol=1e-10
    )


@pytest.mark.parametrize("held", ["A", "B"])
def test_a_species_whose_concentration_is_held(held):
    """A held reactant makes a constant rate, a held product takes what comes."""
    scene = _vessel("B" if held == "A" else "A")
    scene.edge("H", "concentration_source", held, "ground", concentration=2.0)
    scene.edge("R", "reaction", reactants=["A"], products=["B"], rate="k")
    scene.output("fed", "-H.n")
    result = scene.compile(["k"]).simulate((0, 1), **TIGHT)
    if held == "A":
        np.testing.assert_allclose(result["SB.c"], 2 + 1.4 * result.t, rtol=1e-9)
        np.testing.assert_allclose(result["fed"], 1.4, rtol=1e-12)
    else:
        a = 2 * np.exp(-0.7 * result.t)
        np.testing.assert_allclose(result["SA.c"], a, rtol=1e-9)
        np.testing.assert_allclose(result["fed"], -0.7 * a, rtol=1e-9)


@pytest.mark.parametrize("method", ["dop853", "rodas5"])
def test_a_held_concentration_that_a_reaction_makes_and_takes(method):
    """An intermediate without a species: what comes goes on at once, 0.7 a = 3 x."""
    scene = _vessel("A", "C")
    scene.edge("R", "reaction", reactants=["A"], products=["X"], rate="k")
    scene.edge("Q", "reaction", reactants=["X"], products=["C"], rate=3.0)
    scene.output("x", "X.c")
    result = scene.compile(["k"]).simulate((0, 1), **{**TIGHT, "method": method})
    a = 2 * np.exp(-0.7 * result.t)
    np.testing.assert_allclose(result["x"], 0.7 * a / 3, rtol=1e-8)
    np.testing.assert_allclose(result["SC.c"], 4 - a, rtol=1e-8)
    slope = (1 - 0.7 * result.t) * a / 3
    np.testing.assert_allclose(result.sensitivity("x", "k"), slope, rtol=1e-8)


@pytest.mark.parametrize(
    ("fields", "lost"),
    [
        ({"reactants": ["A"], "products": ["B"]}, "R.B reaches the node B"),
        ({"products": ["A", "B"]}, "R.B reaches the node B"),
        ({"products": ["B"]}, "R.B reaches the node B"),
        ({"reactants": ["A"], "products": ["B", "C"]}, "R.B, R.C reach the nodes B, C"),
        ({"reactants": ["A", "B"], "products": ["A", "B"]}, "R.B reaches the node B"),
        (
            {"reactants": ["B"], "products": ["B"], "reverse_rate": 1.0},
            "R.B reaches the node B",
        ),
    ],
)
def test_a_product_that_nothing_holds_or_takes_is_refused_by_name(fields, lost):
    scene = _vessel("A")
    scene.edge("R", "reaction", rate="k", **fields)
    scene.output("b", "R.A.n" if "A" in str(fields) else "k")
    with pytest.raises(TopologyError, match=rf"only edges? {lost}.*undetermined; add a species"):
        scene.compile()


@pytest.mark.parametrize("field", ["reactants", "products"])
@pytest.mark.parametrize(
    ("value", "message"),
    [
        (5, "must be a list of names of nodes"),
        (None, "must be a list of names of nodes"),
        ({"A": 2}, "must be a list of names of nodes"),
        ([["A"]], "must be a list of names of nodes"),
        (["A", "ground"], "name 'ground', the reference of concentrations"),
    ],
)
def test_lists_of_species_that_are_none(field, value, message):
    with pytest.raises(SceneError, match=f"{field} of edge 'R' {message}"):
        Scene("s").edge("R", "reaction", rate=1.0, **{field: value})


@pytest.mark.parametrize("nodes", [("ground", "A"), ("A", "B")])
def test_a_species_counts_from_the_ground(nodes):
    scene = Scene("s")
    with pytest.raises(SceneError, match=rf"'S' is connected to '{nodes[1]}'.*then 'ground'"):
        scene.edge("S", "species", *nodes, volume=1.0)


def test_a_law_whose_own_variable_cancels_is_a_source():
    """It cannot be a branch of the tree: nothing in it determines its across variable."""

    def given(across, k):
        return k + 0 * across

    with pytest.raises(SceneError, match=r"does not show which variable it gives: add gives="):
        cotree.register_component("bare", given, domain="electrical")
    cotree.register_component("bare", given, domain="electrical", gives="through")
    scene = Scene("s")
    scene.edge("B", "bare", "a", "ground", k=1.0)
    with pytest.raises(TopologyError, match="only edge B reaches the node a"):
        scene.compile()
    scene.edge("R", "resistor", "a", "ground", resistance=2.0)
    scene.output("v", "a.v")
    assert scene.compile().simulate((0, 1))["v"][-1] == -2.0
