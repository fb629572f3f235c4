"""A rate that bends sharply where the run begins: implicit methods must not damp what grows."""

from __future__ import annotations

import math

import pytest

import cotree
from cotree.methods import METHODS
from cotree.solvers.native import is_available

GOLDEN = (1.0 + math.sqrt(5.0)) / 2.0


@pytest.fixture(scope="module")
def model() -> cotree.Model:
    """u' = 1 + u/(u + v) and v' = 1 from rest: u = c t with c = 1 + c/(c + 1), the golden ratio.

    At the start the rate's derivative is 1e30/s, and 1e9/s a nanosecond later.
    """
    scene = cotree.Scene("growth")
    for mass, node, force in (("u", "A", "1 + u.v/(u.v + v.v + 1e-30)"), ("v", "B", "1")):
        scene.edge(mass, "translational_mass", "ground", node, mass=1.0, initial={"v": 0.0})
        scene.edge(f"F{mass}", "force_source", "ground", node, force=force)
    return scene.compile()


@pytest.mark.sampled(4)
@pytest.mark.parametrize("method", [name for name in METHODS if is_available(name)])
def test_a_mode_that_grows_is_not_damped(model: cotree.Model, method: str) -> None:
    for end, atol in ((1e-9, 1e-21), (1e-3, 1e-15), (1.0, 1e-9)):
        settings = {"method": method, "rtol": 1e-6, "atol": atol}
        if method == "Radau":  # SciPy's own, which damps the mode
            with pytest.raises(cotree.SolveError, match="use 'rodas5'"):
                model.simulate((0.0, end), **settings, throw=True)
            continue
        result = model.simulate((0.0, end), **settings, throw=True)
        # The error below atol at the start stays; growth by t^0.4 and steps make some tolerances.
        assert result["u.v"][-1] == pytest.approx(GOLDEN * end, rel=5e-6)


@pytest.mark.parametrize("own", ["u", "v"])
def test_a_start_that_bends_is_followed_at_any_tolerance(own: str) -> None:
    """Both rates bend: u = v = 1.5 t, whatever the share of the end that the tolerance is.

    A first step over the bend is damped as a whole, and the error that is tested with it; with one
    rate for both, what is left of it is rounding, which goes anywhere.
    """
    scene = cotree.Scene("both")
    for mass, node, name in (("u", "A", "u"), ("v", "B", own)):
        scene.edge(mass, "translational_mass", "ground", node, mass=1.0, initial={"v": 0.0})
        force = f"1 + {name}.v/(u.v + v.v + 1e-30)"
        scene.edge(f"F{mass}", "force_source", "ground", node, force=force)
    model = scene.compile()
    for method in ("rodas4", "rodas5"):
        for end, share in ((1e-9, 1e-6), (1e-9, 1e-2), (1e-3, 1e-3), (1.0, 1e-2)):
            atol = share * end
            result = model.simulate((0.0, end), method=method, rtol=1e-6, atol=atol, throw=True)
            assert result["u.v"][-1] == pytest.approx(1.5 * end, rel=1e-6, abs=atol)
            assert result.statistics.n_steps < 60


@pytest.mark.parametrize("method", ["rodas4", "rodas5", "Radau"])
def test_what_decays_costs_no_more(method: str) -> None:
    """A stiff decay towards a slow motion, 1e6/s: a few tens of steps, as its slow part asks."""
    scene = cotree.Scene("decay")
    scene.edge("V", "voltage_source", "b", "ground", voltage="sin(t)")
    scene.edge("C", "capacitor", "a", "ground", capacitance=1.0, initial={"v": 0.5})
    scene.edge("R", "resistor", "b", "a", resistance=1e-6)
    result = scene.compile().simulate((0.0, 2.0), method=method, rtol=1e-6, atol=1e-9, throw=True)
    # v follows sin(t) a microsecond behind.
    assert result["C.v"][-1] == pytest.approx(math.sin(2.0) - 1e-6 * math.cos(2.0), abs=1e-6)
    assert result.statistics.n_steps < 200
