"""Inertia tensors with negative principal moments: taken, solved for rightly, and told early."""

from __future__ import annotations

import numpy as np
import pytest

import cotree
from cotree import pipeline
from cotree.errors import ParameterError, SingularSystemError

#: Principal moments -0.05, 0.1 and 0.25: the first two rows have a negative minor.
NEGATIVE = np.array([[0.1, 0.15, 0.0], [0.15, 0.1, 0.0], [0.0, 0.0, 0.1]])


def arm(n=2, last=None, base="weld"):
    """Links on revolute joints about axes in turn, in space; each inertia made of parameters."""
    scene = cotree.Scene("arm", gravity=[0, 0, -9.81])
    scene.edge("base", base, "ground", "n0")
    if base == "free":
        add_body(scene, "b0", "n0", np.diag([0.5, 0.4, 0.6]), mass=2.0)
    for i in range(1, n + 1):
        scene.edge(f"j{i}", "revolute", f"n{i - 1}", f"m{i}", axis=np.eye(3)[i % 3].tolist())
        scene.edge(f"a{i}", "arm", f"m{i}", f"n{i}", vector=[0.3, 0.1, 0.2])
        add_body(scene, f"b{i}", f"n{i}", np.diag([0.2, 0.3, 0.25]))
    if last is not None:
        add_body(scene, "last", f"n{n}", last)
    return scene


def add_body(scene, name, node, tensor, mass=1.0):
    entries = {f"{name}_{i}{j}": tensor[i][j] for i in range(3) for j in range(i, 3)}
    for entry, value in {**entries, f"{name}_mass": mass}.items():
        scene.parameter(entry, float(value))
    rows = [[f"{name}_{min(i, j)}{max(i, j)}" for j in range(3)] for i in range(3)]
    scene.edge(name, "rigid_body", "ground", node, mass=f"{name}_mass", inertia=rows)


def refuse(*_):
    raise AssertionError("generated all the same")


@pytest.mark.slow
def test_a_tensor_that_others_make_up_for_counts_in_full():
    """Two tensors in one body act as their sum, whichever parts of it are those of no body."""
    whole = np.diag([0.6, 0.7, 0.65])
    parted = arm(last=NEGATIVE)
    add_body(parted, "rest", "n2", whole - NEGATIVE, mass=0.5)
    with pytest.warns(RuntimeWarning, match=r"inertia of edge 'last' .* the least is negative"):
        model = parted.compile()
    joined = arm()
    add_body(joined, "both", "n2", whole, mass=1.5)
    expected = joined.compile()
    y = np.random.default_rng(1).normal(size=len(model.states))
    # Of the order of ten, and the sums are formed in another order: rounding of a matrix of 3 rows.
    assert model.rhs(0.0, y) == pytest.approx(expected.rhs(0.0, y), rel=1e-12, abs=1e-12)
    # By numbers alone the sum is known to stay that of a body, and no pivot is looked for.
    with pytest.warns(RuntimeWarning, match="'last'"):
        folded = parted.compile(tunable=[])
    assert folded.rhs(0.0, y) == pytest.approx(expected.rhs(0.0, y), rel=1e-12, abs=1e-12)
    assert not folded.kernels.layout.uncertain


def test_negative_kinetic_energy_is_solved_with_pivots():
    """A light body whose own energy may be negative: what the joints feel is kept all the same."""
    scene = arm(last=4.0 * NEGATIVE)
    scene.output("energy", "energy.kinetic + energy.potential")
    with pytest.warns(RuntimeWarning, match="'last'"):
        model = scene.compile(tree=["base", "j1", "a1", "j2", "a2"])
    assert len(model.kernels.layout.uncertain) == 2
    start = {"j1.theta_dot": 2.0, "j2.theta_dot": -3.0}
    result = model.simulate((0, 1), initial=start, rtol=1e-10, atol=1e-12)
    energy = result["energy"]
    assert result.success
    # Some 1e2 J move about: a thousand times what each of some hundred steps may lose.
    assert np.ptp(energy) < 1e-6


@pytest.mark.slow
@pytest.mark.parametrize("base", ["weld", "free"])
def test_rounding_is_no_negative_minor(base):
    """Entries of 1e-35 beside zeros, as files have them: minors of -5.8e-70."""
    tensor = [[0.2, 2.4e-35, 0.0], [2.4e-35, 0.0, 0.0], [0.0, 0.0, 0.2]]
    model = arm(last=tensor, base=base).compile()  # warnings are errors here
    assert not model.kernels.layout.uncertain


def test_parameters_that_take_the_minor_away_are_refused_at_a_run():
    model = arm(last=np.diag([0.1, 0.1, 0.1])).compile()
    with pytest.raises(ParameterError, match="minor of rows 1 and 2 of inertia of edge 'last'"):
        model.rhs(0.0, model.initial_state, model.kernels.parameter_array({"last_01": 0.15}))


@pytest.mark.parametrize("last", ["point", "spinner"])
def test_motions_without_inertia_are_refused_before_anything_is_generated(last, monkeypatch):
    monkeypatch.setattr(pipeline, "form_equations", refuse)
    scene = arm()
    scene.edge("j3", "revolute", "n2", "n3", axis=[1, 0, 0])
    tensor = np.diag([0.0, 0.1, 0.1]) if last == "spinner" else np.zeros((3, 3))
    add_body(scene, "b3", "n3", tensor)
    with pytest.raises(SingularSystemError, match=r"every configuration: a motion of 'j3\.theta'"):
        scene.compile()


def test_constraints_may_hold_what_has_no_inertia():
    """A gear drives a joint that carries nothing: its motion is determined."""
    scene = arm()
    scene.edge("j3", "revolute", "n2", "n3", axis=[1, 0, 0])
    scene.edge("g", "gear", "n2", "n3", coordinate1="j2.theta", coordinate2="j3.theta", ratio=2.0)
    model = scene.compile()
    assert np.all(np.isfinite(model.rhs(0.0, model.initial_state)))


def test_values_that_guards_refuse_are_refused_before_anything_is_generated(monkeypatch):
    monkeypatch.setattr(pipeline, "form_equations", refuse)
    scene = arm()
    add_body(scene, "b3", "n2", np.diag([-0.1, 0.1, 0.1]))
    with pytest.raises(ParameterError, match=r"entry 1 of inertia of edge 'b3' is -0\.1: it"):
        scene.compile()
