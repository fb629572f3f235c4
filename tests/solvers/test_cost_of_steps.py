"""For stiff systems the counted cost of a step decides between rodas5 and cvode."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg

from cotree import Model, Scene
from cotree.solvers import stiffness

pytest.importorskip("sksundae")

END = 500.0


def rate(i: int, j: int) -> float:
    return 10.0 ** ((7 * i + 11 * j) % 5 - 3)


def all_to_all(n: int, feed: str = "flow", *, locate_kinks: bool = True) -> Model:
    """n species, each of which turns into all others, and a feed of the first."""
    scene = Scene(f"all-to-all-{n}")
    for i in range(n):
        scene.edge(f"S{i}", "species", f"S{i}", "ground", volume=1.0, initial={"c": 1.0 + i})
        for j in range(n):
            if i != j:
                names = {"reactants": [f"S{i}"], "products": [f"S{j}"]}
                scene.edge(f"R{i}to{j}", "reaction", **names, rate=rate(i, j))
    scene.input("flow", 0.0)
    scene.table("valve", [0.0, 1.0, 2.0], [0.0, 1.0, 1.5])
    scene.edge("feed", "molar_flow_source", "ground", "S0", flow=feed)
    return scene.compile(locate_kinks=locate_kinks)


def test_cvode_where_steps_of_rodas5_cost_much() -> None:
    n, times = 30, np.linspace(0.0, END, 6)
    result = all_to_all(n).simulate((0.0, END), times, throw=True)
    assert result.statistics.method == "cvode"
    assert "and rodas5 would take about" in result.message
    matrix = np.array([[rate(i, j) if i != j else 0.0 for i in range(n)] for j in range(n)])
    matrix -= np.diag(matrix.sum(axis=0))
    start = 1.0 + np.arange(n)
    exact = np.array([scipy.linalg.expm(matrix * t) @ start for t in times]).T
    # A hundred tolerances of 1e-8: the error of a multistep method is the sum of its steps'.
    np.testing.assert_allclose(result.y, exact, rtol=1e-6)


def test_rodas5_where_they_cost_little() -> None:
    result = all_to_all(4).simulate((0.0, END * 10.0), [0.0, END * 10.0], throw=True)
    assert result.statistics.method == "rodas5"
    assert "would take" not in result.message


def test_rodas5_where_corners_would_restart_cvode() -> None:
    flow = np.linspace(0.0, END, 7), np.array([0.0, 1.0, 0.0, 2.0, 0.0, 1.0, 0.0])
    result = all_to_all(30).simulate((0.0, END), [0.0, END], inputs={"flow": flow}, throw=True)
    assert result.statistics.method == "rodas5"


@pytest.mark.parametrize("feed", ["max(1 - S0.c, 0)", "abs(S0.c - 1)", "valve(S0.c)"])
def test_rodas5_where_corners_of_rates_would_restart_cvode(feed: str) -> None:
    taken = {}
    for locates in (True, False):
        model = all_to_all(30, feed, locate_kinks=locates)
        result = model.simulate((0.0, END), [0.0, END], throw=True)
        taken[locates] = result.statistics.method
    assert taken == {True: "rodas5", False: "cvode"}


def test_rodas5_without_sundials(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(stiffness, "has_sundials", lambda: False)
    result = all_to_all(30).simulate((0.0, END), [0.0, END], throw=True)
    assert result.statistics.method == "rodas5"
