"""Power that edges deliver, against closed forms and against the rate of the energy."""

from __future__ import annotations

import numpy as np
import pytest

from cotree import Scene


def driven() -> Scene:
    """A driven crank with a slider on it, a spring, a damper and a damped hinge."""
    scene = Scene("driven", gravity=[0, -9.81, 0])
    scene.edge("h", "revolute", "ground", "A", axis=[0, 0, 1], motion="0.3 + 2*t + sin(3*t)")
    scene.edge(
        "g", "prismatic", "A", "B", axis=[1, 0.5, 0], stiffness=20, damping=0.4, initial={"s": 1}
    )
    scene.edge("p", "revolute", "B", "C", axis=[0, 0, 1], damping=0.2, initial={"theta_dot": 1.0})
    scene.edge("r", "arm", "C", "D", vector=[0.3, 0.2, 0])
    scene.edge("mB", "rigid_body", "ground", "B", mass=1.5, inertia=0.2)
    scene.edge("mD", "rigid_body", "ground", "D", mass=0.7, inertia=0.1)
    scene.edge("gE", "arm", "ground", "E", vector=[2, 1, 0])
    scene.edge("k", "spring", "E", "D", stiffness=30, free_length=1.0)
    scene.edge("c", "damper", "E", "D", damping=0.5)
    scene.edge("f", "force", "ground", "D", force=["2*cos(t)", 1, 0])
    for name in ("h", "g", "p", "c", "f"):
        scene.output(f"power_{name}", f"{name}.power")
    scene.output("stored", "energy.kinetic + energy.potential")
    scene.output("spring", "k.power")
    for name in ("h.drive", "D.vx", "D.vy", "h.theta_dot", "g.s", "g.s_dot"):
        scene.output(name.replace(".", "_"), name)
    return scene


@pytest.mark.sampled(1)
@pytest.mark.parametrize("is_absolute", [False, True], ids=["joints", "bodies"])
def test_power_is_the_rate_of_the_energy(is_absolute):
    scene = driven()
    tree = ["mB", "mD", "r", "gE", "h"] if is_absolute else None
    model = scene.compile(tree=tree)
    h = 1e-3
    times = np.add.outer(np.linspace(0.2, 1.8, 9), h * np.array([-2, -1, 0, 1, 2])).ravel()
    result = model.simulate((0, 2), times, "dop853", 1e-12, 1e-12)
    middle = slice(2, None, 5)
    stored = result["stored"].reshape(-1, 5)
    rate = (stored @ np.array([1, -8, 0, 8, -1])) / (12 * h)
    # The spring of joint g is part of the stored energy, so its share of g's power is not.
    spring_of_g = -20 * result["g_s"] * result["g_s_dot"]
    names = ("h", "g", "p", "c", "f")
    power = sum(result[f"power_{name}"] for name in names) - spring_of_g
    # Five points: h^4 times the fifth derivative, and rounding of the energy over h.
    assert np.allclose(rate, power[middle], rtol=1e-7, atol=1e-7)
    assert np.allclose(result["power_h"], result["h_drive"] * result["h_theta_dot"], rtol=1e-9)
    given = 2 * np.cos(result.t) * result["D_vx"] + result["D_vy"]
    assert np.allclose(result["power_f"], given, rtol=1e-10, atol=1e-10)
