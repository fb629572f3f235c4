"""Initial sensitivities of a run: it goes on from the end of another one."""

from __future__ import annotations

import numpy as np
import pytest

import cotree


@pytest.fixture(scope="module")
def model():
    return cotree.load("slider-pendulum").compile(["L", "k"])


def end_of(run):
    """Return all final values of a run, by name."""
    found = {name: float(run[name][-1]) for name in run.states}
    for name in run.states:
        for by in ("L", "k"):
            found[f"d({name})/d({by})"] = float(run.sensitivity(name, by)[-1])
    return found


def test_a_run_goes_on_from_the_end_of_another(model):
    settings = {"method": "dop853", "rtol": 1e-11, "atol": 1e-12}
    whole = model.simulate((0, 2), [0, 2.0], **settings)
    half = model.simulate((0, 1), [0, 1.0], **settings)
    rest = model.simulate((1, 2), [1.0, 2.0], initial=end_of(half), **settings)
    # Two integrations at 1e-11, whose errors grow tenfold over the span.
    assert rest.y[:, -1] == pytest.approx(whole.y[:, -1], abs=1e-9)
    assert rest.s[:, :, -1] == pytest.approx(whole.s[:, :, -1], abs=1e-9)


def test_members_of_an_ensemble_begin_with_sensitivities_of_their_own(model):
    first = end_of(model.simulate((0, 1), [0, 1.0], method="dop853"))
    second = end_of(model.simulate((0, 1), [0, 1.0], method="dop853", parameters={"L": 1.1}))
    run = {"t_eval": [1.0, 2.0], "method": "dop853"}
    found = model.ensemble((1, 2), [first, second], progress=False, **run)
    for i, row in enumerate((first, second)):
        alone = model.simulate((1, 2), initial=row, **run)
        assert np.array_equal(found["d(j1.s)"][i], alone.s[model.states.index("j1.s")].T)


def test_states_alone_take_no_sensitivities(model):
    given = end_of(model.simulate((0, 1), [0, 1.0]))
    run = model.simulate((1, 2), [2.0], initial=given, sensitivities=False)
    assert run["j1.s"][-1] == pytest.approx(model.simulate((0, 2), [2.0])["j1.s"][-1], abs=1e-6)


def test_a_wrong_name_is_refused(model):
    with pytest.raises(cotree.ParameterError, match=r"no sensitivity 'd\(j1.s\)/d\(K\)'; did you"):
        model.simulate((0, 1), initial={"d(j1.s)/d(K)": 1.0})


def test_a_sensitivity_that_vanishes_always_is_refused():
    scene = cotree.Scene("two")
    scene.parameter("R", 2.0)
    scene.parameter("q", 3.0)
    for name, law in (("a", "R"), ("b", 1.0)):
        scene.edge(f"C{name}", "capacitor", name, "ground", capacitance=1.0, initial={"v": 1.0})
        scene.edge(f"R{name}", "resistor", name, "ground", resistance=law)
    model = scene.compile(["R"])
    with pytest.raises(cotree.ParameterError, match="this sensitivity is always zero"):
        model.simulate((0, 1), initial={"d(Cb.v)/d(R)": 1.0})
