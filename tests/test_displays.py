"""Objects as people see them: a few lines at a prompt, escaped tables in a notebook."""

from __future__ import annotations

import copy
import pickle
import sys

import matplotlib
import numpy as np
import pytest
from matplotlib.figure import Figure

import cotree
from cotree.errors import SceneError
from cotree.plot import figures as known
from cotree.report import Facts, Report, Table, matrix


@pytest.fixture(scope="module")
def pendulum():
    scene = cotree.load("slider-pendulum")
    return scene, scene.compile(["L"])


@pytest.fixture
def pyplot():
    """Pyplot without figures, before and after."""
    with matplotlib.rc_context():
        matplotlib.use("agg")
        import matplotlib.pyplot as plt

        plt.close("all")
        yield plt
        plt.close("all")


@pytest.mark.compiler
def test_representations_are_a_few_lines(pendulum):
    scene, model = pendulum
    result = model.simulate((0, 1))
    for item, words in (
        (scene, ["slider-pendulum", "5 nodes"]),
        (scene.parameters, ["zeta", "N m s/rad", "damping of the hinge"]),
        (scene.edges["h2"], ["revolute", "D → B", "damping=zeta"]),
        (scene.graph(), ["translation tree", "j1, r3, h2, r4"]),
        (scene.equations(), ["s_ddot*(m1 + m2)"]),
        (model, ["j1.s [m]", "zeta", "rod_x", "simulate()", "rodas5", "compiler"]),
        (model.linearize(), ["eigenvalues", "h2.theta_dot"]),
        (model.operations, ["augmented_rhs"]),
        (result, ["4 states"]),
    ):
        text = repr(item)
        assert all(word in text for word in words), text
        assert len(text) < 1500
        assert max(map(len, text.splitlines())) < 140


@pytest.mark.compiler
def test_eigenvalues_are_those_of_the_equation(pendulum):
    """A mass on a spring: s² + 2 s + 9 = 0."""
    scene = cotree.Scene("o")
    scene.edge("j", "prismatic", "ground", "A", axis=[1, 0, 0], stiffness=9.0, damping=2.0)
    scene.edge("m", "rigid_body", "ground", "A", mass=1.0)
    linear = scene.compile().linearize()
    # Rounding of a matrix of two rows.
    np.testing.assert_allclose(linear.eigenvalues, [-1 + 8**0.5 * 1j, -1 - 8**0.5 * 1j], rtol=1e-14)
    assert "-1 ± 2.828i" in repr(linear)
    assert ">a steady motion<" in linear._repr_html_()


def test_nothing_in_a_name_is_markup():
    scene = cotree.Scene("evil")
    scene.parameter("a", 1.0, doc='"><img src=x><script>alert(1)</script> $x$')
    scene.edge("R", "resistor", "n", "ground", resistance="a")
    for text in (scene._repr_html_(), scene.parameters._repr_html_()):
        assert "<img" not in text
        assert "<script" not in text
        assert "&lt;script&gt;" in text
        assert "mathjax_ignore" in text  # or dollars would begin mathematics


def test_long_tables_are_cut_with_a_note():
    many = Table(("n", "x"), [(str(i), 0.5 * i) for i in range(1000)], "many")
    assert "… 976 more rows" in many.html()
    assert len(many.html()) < 4000
    assert many.text(24).endswith("… 976 more")
    assert "… 976" not in many.text()
    wide = matrix("A", ["a"], [f"c{i}" for i in range(39)], np.zeros((1, 39)))
    assert "28 more columns" in wide.html()
    assert wide.text() == ""
    assert Table(("n",), []).html() == Table(("n",), []).text() == ""
    assert Report("title", "").html().count("<p>") == 1
    assert Report("x", Facts([("a", "b"), ("empty", "")])).brief() == "<x>\n  a  b"


def test_columns_of_text_are_aligned_and_tables_set_apart():
    table = Table(
        ("name", "value", "unit", "more"), [("a", 1.5, "m", 1), ("bcd", -2.0, "", 2)], in_text=3
    )
    report = Report("title", "sentence", table, "end")
    lines = [
        "title",
        "sentence",
        "",
        "name  value  unit",
        "a       1.5  m",
        "bcd      -2",
        "",
        "end",
    ]
    assert report.text().splitlines() == lines
    assert "more" in report.html()


def test_listings_are_dicts_that_copy_and_pickle():
    scene = cotree.load("slider-pendulum")
    parameters = scene.parameters
    assert parameters == dict(parameters)
    assert pickle.loads(pickle.dumps(parameters)) == parameters
    assert copy.deepcopy(parameters)["L"].value == 1.0
    assert repr(cotree.Scene("empty").parameters) == "{}"


@pytest.mark.compiler
def test_pyplot_shows_what_was_plotted(pendulum, pyplot):
    scene, model = pendulum
    figure = model.simulate((0, 1)).plot("h2.theta")
    assert pyplot.gcf() is figure
    assert scene.graph().draw() is pyplot.gcf()
    assert len(pyplot.get_fignums()) == 2


@pytest.mark.compiler
def test_a_script_without_pyplot_keeps_no_figure(pendulum, monkeypatch):
    monkeypatch.delitem(sys.modules, "matplotlib.pyplot", raising=False)
    monkeypatch.setattr(known, "_is_interactive", lambda: False)
    figure = pendulum[1].simulate((0, 1)).plot("h2.theta")
    assert isinstance(figure, Figure)
    assert "matplotlib.pyplot" not in sys.modules


@pytest.mark.compiler
def test_given_axes_take_curves_of_one_unit(pendulum):
    result = pendulum[1].simulate((0, 1))
    ax = Figure().subplots()
    assert result.plot("h2.theta", ax=ax) is ax.figure
    assert ax.get_ylabel() == "h2.theta [rad]"
    result.plot("d(h2.theta)/d(L)", ax=Figure().subplots())
    assert len(ax.lines) == 1  # the sensitivity stays away unless it is named
    with pytest.raises(SceneError, match=r"'h2\.theta' \[rad\] and another curve in \[m\]"):
        result.plot(["h2.theta", "j1.s"], ax=ax)


@pytest.mark.compiler
def test_curves_follow_the_method_between_its_steps():
    """A mass on a spring, s = cos(3 t), by eight loose steps."""
    scene = cotree.Scene("o")
    scene.edge("j", "prismatic", "ground", "A", axis=[1, 0, 0], stiffness=9.0, initial={"s": 1.0})
    scene.edge("m", "rigid_body", "ground", "A", mass=1.0)
    result = scene.compile().simulate((0, 3), rtol=1e-4, atol=1e-4, method="dop853")
    assert len(result.t) < 12
    t, s = result.plot("j.s").axes[0].lines[0].get_data()
    assert len(t) >= 400
    # The tolerance of the run times the growth of errors over it; polygons are wrong by 0.1.
    np.testing.assert_allclose(s, np.cos(3 * t), atol=3e-3)
    assert np.isin(result.t, t).all()


@pytest.mark.compiler
def test_jumps_stay_jumps():
    """A ball dropped from 2 m hits the ground at sqrt(4/g) with sqrt(4 g)."""
    result = cotree.load("bouncing-ball").compile().simulate((0, 0.8))
    (hit,) = result.events
    t_hit = result.events[hit].t[0]
    name = next(name for name in result.states if name.endswith("_dot"))
    t, v = result.plot(name).axes[0].lines[0].get_data()
    before, after = np.flatnonzero(t < t_hit)[-1], np.flatnonzero(t > t_hit)[0]
    assert t[after] - t[before] < 2e-5  # of 0.8 s
    row = result.states.index(name)
    # A hundred-thousandth of the span away, at 10 m/s².
    assert v[before] == pytest.approx(result.events[hit].y_before[row, 0], abs=1e-4)
    assert v[after] == pytest.approx(result.events[hit].y_after[row, 0], abs=1e-4)


@pytest.mark.compiler
def test_runs_that_cannot_be_repeated_are_drawn_as_they_are(pendulum):
    scene = cotree.Scene("o")
    scene.input("F", 0.0)
    scene.edge("j", "prismatic", "ground", "A", axis=[1, 0, 0], stiffness=9.0)
    scene.edge("m", "rigid_body", "ground", "A", mass=1.0)
    scene.edge("f", "force", "ground", "A", force=["F", 0, 0])
    calls = []
    model = scene.compile()
    result = model.simulate((0, 1), inputs={"F": lambda t: calls.append(t) or 1.0})
    before = len(calls)
    assert result.smooth() is result
    assert len(calls) == before  # a function may remember its calls
    table = model.simulate((0, 1), inputs={"F": ([0, 0.5, 0.6, 1], [0, 0, 1, 1])})
    assert len(table.smooth().t) >= 400
    assert pickle.loads(pickle.dumps(table)).smooth().t.shape == table.t.shape


def test_an_error_in_a_notebook_is_its_sentence():
    with pytest.raises(SceneError) as caught:
        cotree.Scene("s").edge("x", "revolut", "A", "B")
    shown = caught.value._render_traceback_()
    assert 'cotree.Scene("s").edge("x", "revolut", "A", "B")' in shown[1]
    assert shown[-1].startswith("SceneError: edge 'x' has the unknown type 'revolut'")
    assert not any("description.py" in line for line in shown)
