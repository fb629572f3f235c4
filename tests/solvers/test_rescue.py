"""Points that iterations in C do not find: Python finds them, and the same method goes on."""

from __future__ import annotations

import numpy as np
import pytest

from cotree import Scene

pytestmark = pytest.mark.compiler


@pytest.mark.sampled(2)
@pytest.mark.parametrize("method", ["dopri5", "dop853", "rodas4", "rodas5", "cvode", "ida"])
def test_an_unknown_jumps_beyond_where_its_equation_turns_round(method: str) -> None:
    """C v' = z and z^3 - 3 z = 3 q, whose sign turns at 0.5: Newton's way is barred at z = 1.

    From the root z of one side to -z, with dz/dq = 1/(z^2 - 1).
    """
    if method in ("cvode", "ida"):
        pytest.importorskip("sksundae")
    scene = Scene("fold")
    scene.parameter("q", 1.0)
    scene.edge("C", "capacitor", "a", "ground", capacitance=1.0)
    scene.edge("I", "current_source", "ground", "a", current="R.v")
    scene.edge("S", "current_source", "ground", "b", current="3*q*sign(0.5 - t)")
    scene.edge("R", "resistor", "b", "ground", resistance="1/(R.v**2 - 3)")
    times = np.array([0.25, 0.75, 1.0])
    result = scene.compile(["q"]).simulate((0.0, 1.0), times, method, throw=True)
    assert result.message == f"{method} reached t = 1."
    z = float(max(np.roots([1.0, 0.0, -3.0, -3.0]).real))
    along = np.array([0.25, 0.25, 0.0])
    # Rates are constant between corners: rounding, in the unknown by Newton's method.
    np.testing.assert_allclose(result["R.v"], [z, -z, -z], rtol=1e-12)
    np.testing.assert_allclose(result["C.v"], z * along, atol=1e-12)
    found = result.sensitivity("C.v", "q")
    np.testing.assert_allclose(found, along / (z**2 - 1.0), atol=1e-12)
