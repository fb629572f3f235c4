"""A user's script, which type checkers read in their strict modes; see test_consumer.py."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

import cotree


def pendulum() -> cotree.Scene:
    scene = cotree.Scene("pendulum", gravity=[0, "-g", 0])
    scene.parameter("g", 9.81, unit="m/s^2")
    scene.parameter("L", 2, unit="m", doc="length")
    scene.input("tau", "0.1*sin(t)", unit="N m")
    axis: npt.NDArray[np.float64] = np.array([0.0, 0.0, 1.0])
    scene.revolute("h", "ground", "A", axis=axis, torque="tau", initial={"theta": 0.1})
    scene.arm("rod", "A", "B", vector=[0, "-L", 0])
    scene.rotational_stop("limits", joint="h", lower=-1, upper=1, stiffness=1e3)
    scene.set("L", 350, unit="mm")
    scene.rigid_body(
        "bob", "ground", "B", mass={"value": 500, "unit": "g"}, inertia=[0.1, 0.1, 0.1]
    )
    scene.output("height", "B.y")
    scene.event("bottom", "h.theta", direction=-1)
    return scene


def drive(scene: cotree.Scene) -> None:
    scene.voltage_source("V", "a", "ground", voltage={"of": "t", "x": [0, 1], "y": [0, 12]})
    scene.dc_motor(
        "M", electrical=["a", "ground"], joint="h", resistance="1.2", constant=0.05, heat="winding"
    )
    scene.voice_coil(
        "C", joint="rail", electrical=["a", "ground"], resistance=1, constant=np.float64(3)
    )
    scene.heat_capacitor("W", "winding", "ground", capacity=8.0, initial={"T": 293.15})
    scene.mosfet_n("Q", "a", "b", "ground", factor=1e-3, threshold=1.0)
    scene.edge("C", "capacitor", "b", "ground", capacitance=1e-6)


def results(scene: cotree.Scene) -> float:
    model: cotree.Model = scene.compile(["L"], tunable=["g", "L"])
    names: tuple[str, ...] = model.states
    result: cotree.Result = model.simulate(
        (0, 1), np.linspace(0, 1, 11), parameters={"L": 1.9}, method="dopri5", rtol=1e-8
    )
    angle: npt.NDArray[np.float64] = result["h.theta"]
    slope: npt.NDArray[np.float64] = result.sensitivity("h.theta", "L")
    rates: npt.NDArray[np.float64] = model.rhs(0.0, model.initial_state)
    linear = model.linearize()
    poles: npt.NDArray[np.complex128] = np.linalg.eigvals(linear.A).astype(np.complex128)
    times: npt.NDArray[np.float64] = result.events["bottom"].t
    result.to_csv("pendulum.csv")
    print(names, rates, times, model.summary(), scene.summary(), result.success, poles)
    return float(angle[-1]) + float(slope[-1])


def wrong(scene: cotree.Scene) -> None:
    """Each of these lines is refused."""
    scene.revolute("h", "ground", "A")  # refused
    scene.revolute("h", "ground", "A", axis=[0, 0, 1], damp=0.1)  # refused
    scene.revolute("h", "ground", axis=[0, 0, 1])  # refused
    scene.arm("rod", "A", "B", vector=1.0)  # refused
    scene.resistor("R", "a", "b", resistance=None)  # refused
    scene.hinge("h", "ground", "A")  # refused


if __name__ == "__main__":
    made = pendulum()
    drive(made)
    print(results(made))
