"""Friction of belts and ropes over drums, by Euler and Eytelwein: it depends on the direction."""

from __future__ import annotations

from math import pi

import numpy as np
import pytest

import cotree
from cotree.errors import SceneError

G = 9.81
TIGHT = {"rtol": 1e-11, "atol": 1e-13}
CLOSE = 1e-9


def slopes(function, given):
    """Return the derivatives of a closed form by each argument, by complex steps."""
    return {name: function(**{**given, name: v + 1e-30j}).imag / 1e-30 for name, v in given.items()}


@pytest.mark.parametrize("method", ["dopri5", "rodas5"])
def test_a_belt_brake_holds_more_in_the_direction_in_which_it_energises_itself(method):
    """A drum turns forwards, stops, is held, and turns backwards under a rising torque k t."""
    given = {"mu": 0.3, "phi": 4.0, "S": 20.0, "r": 0.1, "J": 0.05, "w": 30.0, "k": 4.0}
    scene = cotree.Scene("brake")
    for name, value in given.items():
        scene.parameter(name, value)
    scene.edge("d", "rotational_inertia", "ground", "A", inertia="J", initial={"w": "w"})
    scene.edge("T", "torque_source", "ground", "A", torque="-k*t")
    # The belt's slack side has the tension S; forwards it is the side that runs off.
    tight, slack = "r*S*(exp(mu*phi) - 1)", "r*S*(1 - exp(-mu*phi))"
    scene.edge("B", "rotational_dry_friction", "ground", "A", torque=tight, backward=slack)
    scene.output("held", "B.tau")
    result = scene.compile(list(given)).simulate((0, 0.6), method=method, **TIGHT)

    def stops(mu, phi, S, r, J, w, k):
        brake = r * S * (np.exp(mu * phi) - 1)
        return (np.sqrt(brake**2 + 2 * k * J * w) - brake) / k

    def slips(mu, phi, S, r, J, w, k):
        return r * S * (1 - np.exp(-mu * phi)) / k

    def speed(mu, phi, S, r, J, w, k):
        return -k / J * (0.6 - slips(mu, phi, S, r, J, w, k)) ** 2 / 2

    found = {"B stops": stops, "B slips backwards": slips}
    for event, exact in found.items():
        assert abs(result.events[event].t[0] - exact(**given)) <= CLOSE
        for name, slope in slopes(exact, given).items():
            assert abs(result.event_sensitivity(event, name)[0] - slope) <= CLOSE
    assert stops(**given) < slips(**given)
    assert abs(result["d.w"][-1] - speed(**given)) <= CLOSE
    for name, slope in slopes(speed, given).items():
        # Relative to slopes of up to a thousand.
        assert abs(result.sensitivity("d.w", name)[-1] - slope) <= CLOSE * max(1, abs(slope))
    sticks = np.rint(result["B.mode"]) == 0
    assert np.max(np.abs(result["held"] + 4.0 * result.t)[sticks]) <= CLOSE


@pytest.mark.parametrize("method", ["dopri5", "rodas5"])
@pytest.mark.parametrize(("k", "way"), [(30.0, "forwards"), (-30.0, "backwards")])
def test_a_rope_over_a_bollard_slips_by_the_tension_that_accelerates_the_other_mass(k, way, method):
    """Slack side S, tight side S exp(mu phi): a rising force pulls one of the masses."""
    given = {"mu": 0.3, "phi": pi, "m": 2.0, "M": 3.0, "k": k}
    scene = cotree.Scene("bollard", gravity=[0, -G, 0])
    for name, value in given.items():
        scene.parameter(name, value)
    scene.edge("j", "prismatic", "ground", "A", axis=[0, 1, 0])
    scene.edge("J", "prismatic", "ground", "B", axis=[0, -1, 0])
    scene.edge("b", "rigid_body", "ground", "A", mass="m")
    scene.edge("B", "rigid_body", "ground", "B", mass="M")
    scene.edge("pull", "force", "ground", "B", force=[0, "-k*t", 0])
    scene.edge("rope", "gear", "A", "B", coordinate1="j.s", coordinate2="J.s", ratio=1.0)
    scene.output("S", f"m*(A.ay + {G})")
    force = {"force": "S*(exp(mu*phi) - 1)", "backward": "S*(1 - exp(-mu*phi))"}
    scene.edge("R", "translational_dry_friction", joint="J", **force)
    result = scene.compile(list(given)).simulate((0, 1.2), method=method, **TIGHT)
    sign = 1 if k > 0 else -1

    def slips(mu, phi, m, M, k):
        return G * (m * np.exp(sign * mu * phi) - M) / k

    def speed(mu, phi, m, M, k):
        late = 1.2 - slips(mu, phi, m, M, k)
        return k * late**2 / 2 / (M + m * np.exp(sign * mu * phi))

    event = f"R slips {way}"
    assert abs(result.events[event].t[0] - slips(**given)) <= CLOSE
    assert abs(result["b.y_dot"][-1] - speed(**given)) <= CLOSE
    for name, slope in slopes(slips, given).items():
        assert abs(result.event_sensitivity(event, name)[0] - slope) <= CLOSE
    for name, slope in slopes(speed, given).items():
        assert abs(result.sensitivity("b.y_dot", name)[-1] - slope) <= CLOSE


def test_a_backward_force_excludes_a_breakaway_force():
    scene = cotree.Scene("both")
    fields = {"torque": 1.0, "backward": 2.0, "breakaway": 3.0}
    with pytest.raises(SceneError, match="edge 'B' has backward and breakaway"):
        scene.edge("B", "rotational_dry_friction", "ground", "A", **fields)
