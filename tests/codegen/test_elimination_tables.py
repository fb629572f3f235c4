"""Loops over tables and straight lines are the same elimination, to the last bit."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

import cotree
from cotree import Model, Result, Scene
from cotree.codegen import newton

if TYPE_CHECKING:
    from collections.abc import Callable


def ring(n: int, n_sensitivities: int) -> Model:
    """n species that turn into each other, with a few reactions across."""
    scene = Scene(f"ring-{n}-{n_sensitivities}")
    for i in range(n):
        scene.edge(f"S{i}", "species", f"S{i}", "ground", volume=1.0, initial={"c": 1.0 + i})
        scene.parameter(f"k{i}", 10.0 ** (i % 4 - 1))
        a, b, c = (f"S{(i + step) % n}" for step in (0, 1, 3))
        reactants, products = ([a], [b]) if i % 2 else ([a, c], [b, c])
        scene.edge(f"R{i}", "reaction", reactants=reactants, products=products, rate=f"k{i}")
    return scene.compile([f"k{i}" for i in range(n_sensitivities)])


def both(monkeypatch: pytest.MonkeyPatch, make: Callable[[], Model], t_end: float) -> list[Result]:
    """Run with straight lines, and with tables."""
    found, times = [], np.linspace(0.0, t_end, 11)
    for longest in (10**6, 0):
        monkeypatch.setattr(newton, "_LONGEST", longest)
        found.append(make().simulate((0.0, t_end), times, method="rodas5", throw=True))
    return found


# None, one alone, as many as are solved for together, and more.
@pytest.mark.parametrize("n_sensitivities", [0, 1, 8, 11])
def test_networks(monkeypatch: pytest.MonkeyPatch, n_sensitivities: int) -> None:
    lines, tables = both(monkeypatch, lambda: ring(12, n_sensitivities), 5.0)
    assert lines.statistics.n_steps == tables.statistics.n_steps > 5
    np.testing.assert_array_equal(tables.y, lines.y)
    np.testing.assert_array_equal(tables.s, lines.s)


def test_algebraic_unknowns_whose_pivots_are_beside_the_diagonal(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def make() -> Model:
        return cotree.load("bridge-rectifier").compile(["C", "RL"])

    lines, tables = both(monkeypatch, make, 0.002)
    np.testing.assert_array_equal(tables.y, lines.y)
    np.testing.assert_array_equal(tables.s, lines.s)
