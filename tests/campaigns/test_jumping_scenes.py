"""Random scenes with jumps and corners of states: every sensitivity against differences.

The environment variable ``COTREE_CASES`` gives the number of cases. A case is one scene with one
set of values; each scene is compiled once and takes a few sets. Where a run ends with a message
nothing is compared: what may not happen is a wrong number without one.
"""

from __future__ import annotations

import os
import warnings
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
import pytest

from cotree import Scene
from cotree.errors import Error

if TYPE_CHECKING:
    from cotree import Model

pytestmark = pytest.mark.compiler

CASES = int(os.environ.get("COTREE_CASES", "12"))
PER_SCENE, MOST_PARAMETERS = 4, 4
TIGHT = {"rtol": 1e-10, "atol": 1e-12}
METHODS = ("dop853", "rodas5", "cvode")

#: Relative steps of differences. Where the two agree to a share of their size, so must the
#: sensitivity; else the point is within a step of where the order of events changes.
STEPS = (1e-4, 2e-5)
AGREE, WRONG = 1e-5, 1e-4
NEAREST = 1e-6


@dataclass
class Made:
    """A scene, and the ranges of its parameters."""

    scene: Scene
    ranges: dict[str, tuple[float, float]] = field(default_factory=dict)

    def parameter(self, rng: np.random.Generator, low: float, high: float) -> str:
        """Declare a parameter, and give its name."""
        name = f"p{len(self.ranges)}"
        self.ranges[name] = (low, high)
        self.scene.parameter(name, float(rng.uniform(low, high)))
        return name


def _looked_at(rng, made, states):
    """Return the argument of a jump: a sum of states minus a level that may move."""
    terms = [f"{made.parameter(rng, 0.5, 2.0)}*{rng.choice(states)}"]
    if rng.random() < 0.4:
        terms.append(f"{made.parameter(rng, -0.7, 0.7)}*{rng.choice(states)}")
    if rng.random() < 0.3:
        terms.append(f"0.2*sin({made.parameter(rng, 1.0, 4.0)}*t)")
    return f"({' + '.join(terms)} - {made.parameter(rng, -0.4, 0.9)})"


def _condition(rng, made, states):
    def one():
        return f"{_looked_at(rng, made, states)} {rng.choice(['<', '<=', '>', '>='])} 0"

    kind = rng.integers(5)
    if kind == 0:
        return f"{one()} and {one()}"
    if kind == 1:
        return f"{one()} or not {one()}"
    if kind == 2:
        low, high = made.parameter(rng, -0.6, 0.1), made.parameter(rng, 0.2, 0.9)
        return f"{low} < {rng.choice(states)} <= {high}"
    return one()


def _jump(rng, made, states, depth=0):
    """Return an expression with a jump or a corner."""

    def g():
        return _looked_at(rng, made, states)

    size = made.parameter(rng, 0.1, 0.8)
    kinds = {
        "sign": lambda: f"{size}*sign({g()})",
        "floor": lambda: f"{size}*floor(2*{g()})",
        "mod": lambda: f"{size}*mod({g()}, {made.parameter(rng, 0.3, 0.8)})",
        "min": lambda: f"{size}*min({g()}, {g()})",
        "max": lambda: f"{size}*max({g()}, 0)",
        "abs": lambda: f"{size}*abs({g()})",
        "where": lambda: f"where({_condition(rng, made, states)}, {size}, {g()})",
        "smooth": lambda: (lambda x: f"{size}*{x}*sign({x})")(g()),
        "corner": lambda: (lambda x: f"where({x} > 0, {size}*{x}, 0)")(g()),
        "nested": lambda: f"{size}*sign({g()} + {_jump(rng, made, states, 1)})",
        "product": lambda: f"sign({g()})*{_jump(rng, made, states, 1)}",
    }
    names = list(kinds)[: -2 if depth else None]
    return kinds[str(rng.choice(names))]()


def _circuit(rng, made):
    """One or two capacitors behind resistors; the source, a resistance or a capacitance jumps."""
    scene, states = made.scene, ["C1.v"]
    if rng.random() < 0.5:
        states.append("C2.v")
    drive = f"{made.parameter(rng, 0.6, 1.6)}*cos({made.parameter(rng, 0.8, 2.5)}*t)"
    place = rng.integers(3)
    jump = _jump(rng, made, states)
    scene.edge(
        "V", "voltage_source", "a", "ground", voltage=f"{drive} + {jump}" if place == 0 else drive
    )
    resistance = f"1 + abs({jump})/4" if place == 1 else made.parameter(rng, 0.4, 1.5)
    scene.edge("R1", "resistor", "a", "b", resistance=resistance)
    capacitance = f"1.2 + tanh({jump})/3" if place == 2 else made.parameter(rng, 0.4, 1.0)
    start = {"v": made.parameter(rng, -0.8, 0.8)}
    scene.edge("C1", "capacitor", "b", "ground", capacitance=capacitance, initial=start)
    if len(states) == 2:
        scene.edge("R2", "resistor", "b", "c", resistance=made.parameter(rng, 0.4, 1.5))
        scene.edge("C2", "capacitor", "c", "ground", capacitance=made.parameter(rng, 0.3, 1.0))
    return jump


def _divider(rng, made):
    """An algebraic unknown between a source and a capacitor."""
    scene = made.scene
    jump = _jump(rng, made, ["C1.v", "n.v"])
    drive = f"{made.parameter(rng, 0.6, 1.6)}*cos({made.parameter(rng, 0.8, 2.5)}*t)"
    scene.edge("V", "voltage_source", "a", "ground", voltage=drive)
    scene.edge("R1", "resistor", "a", "n", resistance=f"{made.parameter(rng, 0.5, 1.5)} + R1.i**2")
    scene.edge("R2", "resistor", "n", "b", resistance=made.parameter(rng, 0.5, 1.5))
    scene.edge("C1", "capacitor", "b", "ground", capacitance=made.parameter(rng, 0.4, 1.0))
    scene.edge("I", "current_source", "ground", "b", current=f"({jump})/2")
    return jump


def _swing(rng, made):
    """A mass on a spring."""
    scene = made.scene
    jump = _jump(rng, made, ["s.s", "m.v"])
    scene.edge("m", "translational_mass", "ground", "A", mass=made.parameter(rng, 0.6, 1.5))
    spring = {
        "stiffness": made.parameter(rng, 0.8, 4.0),
        "initial": {"s": made.parameter(rng, 0.4, 1.1)},
    }
    scene.edge("s", "translational_spring", "ground", "A", **spring)
    scene.edge("f", "force_source", "ground", "A", force=jump)
    return jump


def _pendulum(rng, made):
    """A body on a hinge, with a torque."""
    scene = made.scene
    jump = _jump(rng, made, ["h.theta", "h.theta_dot"])
    start = {"theta": made.parameter(rng, 0.3, 1.0), "theta_dot": made.parameter(rng, -1.0, 1.0)}
    scene.edge("h", "revolute", "ground", "A", axis=[0, 0, 1], torque=jump, initial=start)
    scene.edge("rod", "arm", "A", "B", vector=[0, f"-{made.parameter(rng, 0.4, 1.0)}", 0])
    scene.edge("bob", "rigid_body", "ground", "B", mass=1.0, inertia=0.05)
    return jump


FAMILIES = (_circuit, _divider, _swing, _pendulum)


def _make(seed: int) -> Made:
    rng = np.random.default_rng([18, seed])
    made = Made(Scene(f"jumping-{seed}", gravity=[0, -9.81, 0]))
    jump = FAMILIES[seed % len(FAMILIES)](rng, made)
    made.scene.output("jump", jump)  # no field names it: what it is, not what modes make of it
    return made


def _compared(
    model: Model, plain: Model, made: Made, values: dict[str, float], method: str
) -> dict[str, int]:
    """Compare one case with differences of a model without sensitivities.

    Count what was compared, refused, and could not be decided.
    """
    counts = {"right": 0, "refused": 0, "undecided": 0}
    t_eval = np.linspace(0.0, 2.5, 6)
    settings = {"t_eval": t_eval, **TIGHT}
    moving = [name for name in model.states if name.replace(".", "").replace("_", "").isalnum()]

    def end(of, changed, by="dop853"):
        result = of.simulate((0, 2.5), parameters={**values, **changed}, method=by, **settings)
        return result, np.array([result[name][-1] for name in moving])

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # runs that stop are counted, by their status
        try:
            result, _ = end(model, {}, method)
        except Error:
            return counts | {"refused": 1}
        if result.status != 0:
            return counts | {"refused": 1}
        for name in model.sensitivities:
            found = np.array([result.sensitivity(state, name)[-1] for state in moving])
            size = max(abs(values[name]), 0.1)
            differences = []
            for step in STEPS:
                try:
                    (a, up), (b, down) = (
                        end(plain, {name: values[name] + sign * step * size}) for sign in (1, -1)
                    )
                except Error:
                    break
                if a.status or b.status:
                    break
                differences.append((up - down) / (2 * step * size))
            if len(differences) < len(STEPS):
                counts["undecided"] += 1
                continue
            scale = 1.0 + np.abs(differences[1])
            if np.any(np.abs(differences[0] - differences[1]) > AGREE * scale):
                counts["undecided"] += 1
                continue
            off = np.abs(found - differences[1]) / scale
            if np.any(off >= WRONG):
                # A jump nearer to the end than the last step moves it tilts both differences.
                near = NEAREST * size
                up, down = (end(plain, {name: values[name] + h})[1] for h in (near, -near))
                off = np.abs(found - (up - down) / (2 * near)) / scale
            assert np.all(off < WRONG), (made.scene.name, method, name, values, found, differences)
            counts["right"] += 1
    return counts


@pytest.mark.sampled(1)
@pytest.mark.parametrize("seed", range(-(-CASES // PER_SCENE)))
def test_no_sensitivity_is_wrong_without_a_message(seed):
    made = _make(seed)
    total = {"right": 0, "refused": 0, "undecided": 0}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of parameters that nothing depends on
        rng = np.random.default_rng([19, seed])
        names = rng.permutation(list(made.ranges))[:MOST_PARAMETERS]
        model = made.scene.compile([str(name) for name in names])
        plain = made.scene.compile()
    for case in range(PER_SCENE):
        values = {name: float(rng.uniform(*ends)) for name, ends in made.ranges.items()}
        method = METHODS[(seed + case) % len(METHODS)] if case == 0 else METHODS[seed % 2]
        for key, count in _compared(model, plain, made, values, method).items():
            total[key] += count
    print(total)
    assert seed > 2 or total["right"] > total["refused"] + total["undecided"]
