"""Lookup tables that expressions call, against SciPy's interpolators and against differences."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.interpolate import PchipInterpolator, RegularGridInterpolator

import cotree
from cotree.errors import ExpressionError, ModelError, SceneError
from cotree.scene.toml_file import read_scene

X, Y = [0.0, 1.0, 2.5, 3.0, 5.0], [1.0, 2.0, 1.5, 1.5, -1.0]
SECOND = [-1.0, 0.0, 2.0]
ROWS = [[1.0, 2.0, 0.5], [0.0, 3.0, 1.0], [2.0, 2.5, -1.0], [1.0, 0.0, 0.0], [4.0, 1.0, 2.0]]
_TIGHT = {"rtol": 1e-11, "atol": 1e-13}


def tabled() -> cotree.Scene:
    """Build a scene whose state x.v grows by one a second and is looked up in several tables."""
    scene = cotree.Scene("tabled")
    scene.parameter("b", 1.5)
    scene.parameter("speed", 1.0)
    for between in ("linear", "monotone"):
        for beyond in ("hold", "extend"):
            scene.table(f"{between}_{beyond}", X, Y, interpolation=between, beyond=beyond)
    scene.table("map", X, SECOND, ROWS)
    scene.table("map_on", X, SECOND, ROWS, beyond="extend")
    scene.table("written", X, [1.0, "2*b", "b", "b", -1.0])
    scene.edge("x", "capacitor", "n", "ground", capacitance=1.0, initial={"v": -1.0})
    scene.edge("rate", "current_source", "ground", "n", current="speed")
    scene.edge("y", "capacitor", "m", "ground", capacitance=1.0)
    fed = "monotone_extend(x.v) + 0.3*map(x.v, y.v) + written(x.v + y.v)"
    scene.edge("feed", "current_source", "ground", "m", current=fed)
    for name in scene.tables:
        scene.output(f"of_{name}", f"{name}(x.v, 1.5*t - 2)" if "map" in name else f"{name}(x.v)")
    return scene


@pytest.fixture(scope="module")
def model() -> cotree.Model:
    return tabled().compile(["b", "speed", "x.v"])


def _expected(at: np.ndarray, beside: np.ndarray) -> dict[str, np.ndarray]:
    """Evaluate all tables with SciPy; beyond the ends as the documentation says."""
    cubic, held = PchipInterpolator(X, Y), np.clip(at, X[0], X[-1])
    slopes = cubic(X, nu=1)
    below, above = np.minimum(at - X[0], 0.0), np.maximum(at - X[-1], 0.0)
    first, last = (Y[1] - Y[0]) / (X[1] - X[0]), (Y[-1] - Y[-2]) / (X[-1] - X[-2])
    plane = RegularGridInterpolator((X, SECOND), ROWS, bounds_error=False, fill_value=None)
    inside = np.clip(beside, SECOND[0], SECOND[-1])
    return {
        "linear_hold": np.interp(at, X, Y),
        "linear_extend": np.interp(at, X, Y) + first * below + last * above,
        "monotone_hold": cubic(held),
        "monotone_extend": cubic(held) + slopes[0] * below + slopes[-1] * above,
        "map": plane((held, inside)),
        "map_on": plane((at, beside)),
        "written": np.interp(at, X, [1.0, 3.0, 1.5, 1.5, -1.0]),
    }


def test_values_are_those_of_scipy(model: cotree.Model) -> None:
    t = np.linspace(0.0, 7.5, 151)
    result = model.simulate((0, 7.5), t, **_TIGHT)
    for name, values in _expected(result["x.v"], 1.5 * t - 2).items():
        # A few roundings of values of order ten.
        np.testing.assert_allclose(result[f"of_{name}"], values, rtol=1e-13, atol=2e-14)


def test_the_jacobian_holds_the_slopes_of_scipy(model: cotree.Model) -> None:
    for at in (-0.5, 0.4, 1.7, 2.6, 4.9, 6.0):
        row = dict(zip(model.states, model.jacobian(0.0, [at, -0.3])[1], strict=True))
        slope = PchipInterpolator(X, Y)(min(max(at, X[0]), X[-1]), nu=1)
        plane = RegularGridInterpolator((X, SECOND), ROWS)
        inside = X[0] < at < X[-1]
        # The bilinear piece is linear in each argument: any difference within it is exact.
        k = np.searchsorted(X, at) - 1 if inside else 0
        by_x = (plane((X[k + 1], -0.3)) - plane((X[k], -0.3))) / (X[k + 1] - X[k]) if inside else 0
        held = min(max(at, X[0]), X[-1])
        by_y = plane((held, 0.0)) - plane((held, -1.0))
        own = np.interp([at - 0.3 + s for s in (1e-6, -1e-6)], X, [1.0, 3.0, 1.5, 1.5, -1.0])
        written = (own[0] - own[1]) / 2e-6
        # The difference of a linear piece has the rounding of 1e-16/1e-6.
        assert row["x.v"] == pytest.approx(float(slope + 0.3 * by_x + written), abs=1e-9)
        assert row["y.v"] == pytest.approx(float(0.3 * by_y + written), abs=1e-9)


@pytest.mark.parametrize("name", ["b", "speed"])
def test_sensitivities_agree_with_differences(model: cotree.Model, name: str) -> None:
    h, value = 1e-5, dict(zip(model.parameters, model.default_parameters, strict=True))[name]
    found = model.simulate((0, 6.3), **_TIGHT)
    high, low = (model.simulate((0, 6.3), parameters={name: value + s}, **_TIGHT) for s in (h, -h))
    for wanted in ("y.v", "of_written", "of_monotone_extend", "of_map_on"):
        # Errors of the runs, 1e-11, by the step, and its square.
        difference = (high[wanted][-1] - low[wanted][-1]) / (2 * h)
        assert found.sensitivity(wanted, name)[-1] == pytest.approx(difference, rel=1e-6, abs=1e-6)


def test_members_run_in_lanes_and_give_the_same() -> None:
    """All kinds of tables act on the motion; none of their corners is passed while it runs."""
    scene = tabled()
    kinds = "linear_extend(x.v) + monotone_hold(x.v) + map(0.2*x.v, y.v) + written(x.v)"
    del scene.edges["feed"]
    scene.edge("feed", "current_source", "ground", "m", current=f"0.1*({kinds})")
    model = scene.compile(["b"], locate_kinks=False)
    members = [{"b": 1.0 + 0.1 * i} for i in range(8)]
    # From x = 1.1 to 2.4 within one piece of each table, y from 0 to about 0.5 too.
    run = {"initial": {"x.v": 1.1}, "rtol": 1e-10, "atol": 1e-12}
    found = model.ensemble((0, 1.3), members, lanes=4, **run)
    assert found.attrs["lanes"] == "members run side by side"
    for i, member in enumerate(members):
        alone = model.simulate((0, 1.3), parameters=member, **run)
        # Products are fused in lanes: roundings, and errors of runs of other steps.
        assert float(found["y.v"][i, -1]) == pytest.approx(alone["y.v"][-1], rel=1e-8)
        slope = alone.sensitivity("y.v", "b")[-1]
        assert float(found["d(y.v)"][i, -1, 0]) == pytest.approx(slope, rel=1e-8)


def test_scenes_with_tables_are_saved_and_read(tmp_path) -> None:
    scene = tabled()
    scene.save(tmp_path / "tabled.toml")
    read = cotree.load(tmp_path / "tabled.toml")
    assert read.tables == scene.tables
    y = [2.2, 0.1]
    assert (read.compile().rhs(0.0, y) == scene.compile().rhs(0.0, y)).all()


def test_parts_bring_their_tables(tmp_path) -> None:
    """Each of them follows the parameters of its own part."""
    outer = cotree.Scene("outer")
    outer.table("written", [0, 1], [0.5, 0.7])
    outer.add("p", tabled(), speed="written(0.5)")
    outer.add("q", tabled(), b=2.0)
    model = outer.compile()
    for name, given in (("p", {"speed": 0.6}), ("q", {"b": 2.0})):
        alone = tabled().compile().simulate((0, 4), parameters=given, **_TIGHT)
        whole = model.simulate((0, 4), **_TIGHT)
        assert whole[f"{name}.y.v"][-1] == pytest.approx(alone["y.v"][-1], rel=1e-9)
    outer.save(tmp_path / "outer.toml")
    assert cotree.load(tmp_path / "outer.toml").edges == outer.edges


def test_tables_of_fields_are_the_same_mechanism() -> None:
    scene = cotree.Scene("field")
    law = {"of": "x.v", "x": X, "y": Y, "interpolation": "monotone", "beyond": "extend"}
    scene.edge("x", "capacitor", "n", "ground", capacitance=1.0, initial={"v": 1.7})
    scene.edge("rate", "current_source", "ground", "n", current=law)
    assert scene.compile().rhs(0.0, [1.7])[0] == pytest.approx(float(PchipInterpolator(X, Y)(1.7)))


def test_large_tables_are_data_that_c_searches() -> None:
    """The operations do not grow with the number of points."""
    counts = []
    for n in (10, 10_000):
        scene = cotree.Scene("large")
        x = np.linspace(0.0, 9.0, n)
        scene.table("f", x, np.sin(x), interpolation="monotone")
        scene.edge("x", "capacitor", "n", "ground", capacitance=1.0, initial={"v": 1.7})
        scene.edge("rate", "current_source", "ground", "n", current="f(x.v)")
        model = scene.compile()
        counts.append(model.operations["rhs"].total)
    assert counts[0] == counts[1]
    # The cubic's error is about h^3 where the slopes of PCHIP are of second order.
    assert model.rhs(0.0, [1.7])[0] == pytest.approx(np.sin(1.7), abs=1e-6)


_FILE = """
[tables.torque]
file = "{file}"

[edges.x]
type = "capacitor"
nodes = ["n", "ground"]
capacitance = 1.0

[edges.rate]
type = "current_source"
nodes = ["ground", "n"]
current = "{call}"
"""


@pytest.mark.parametrize(
    ("points", "call", "value"),
    [
        ("speed,torque\n0,1\n2,3\n", "torque(1)", 2.0),
        ("0,1\n2,3\n\n", "torque(3)", 3.0),
        ("x\\y,0,1\n0,1,2\n2,3,8\n", "torque(1, 0.5)", 3.5),
    ],
)
def test_points_are_read_from_files(tmp_path, points: str, call: str, value: float) -> None:
    (tmp_path / "points.csv").write_text(points)
    (tmp_path / "scene.toml").write_text(_FILE.format(file="points.csv", call=call))
    model = cotree.load(tmp_path / "scene.toml").compile()
    assert model.rhs(0.0, [0.0])[0] == pytest.approx(value)


@pytest.mark.parametrize(
    ("points", "told"),
    [
        ("x,y\n0,1\n2,nan\n", "value 2 of table 'torque' is nan: give a finite number"),
        ("x,y\n0,1\n2,high\n", "points.csv, line 3: 'high' is not a number"),
        ("0,1\n2\n", "points.csv, line 2 has 1 columns"),
        ("0,1\n0,2\n", "x of table 'torque' must ascend: number 2 is 0.0, after 0.0"),
        ("", "points.csv is empty"),
        ("x,y\n", "x of table 'torque' needs two numbers or more"),
    ],
)
def test_bad_files_are_refused_by_line(tmp_path, points: str, told: str) -> None:
    (tmp_path / "points.csv").write_text(points)
    (tmp_path / "scene.toml").write_text(_FILE.format(file="points.csv", call="torque(1)"))
    with pytest.raises(ModelError) as refused:
        cotree.load(tmp_path / "scene.toml")
    assert "scene.toml, line 2" in str(refused.value)
    assert told in str(refused.value)


@pytest.mark.parametrize(
    ("file", "told"),
    [
        ("../points.csv", "is outside the folder of the scene"),
        ("/etc/passwd", "is not relative to this file"),
        ("none.csv", "is not a file in this folder"),
    ],
)
def test_files_elsewhere_are_refused(tmp_path, file: str, told: str) -> None:
    (tmp_path / "scene.toml").write_text(_FILE.format(file=file, call="torque(1)"))
    with pytest.raises(SceneError, match=told):
        cotree.load(tmp_path / "scene.toml")


def test_texts_without_a_folder_name_no_files() -> None:
    with pytest.raises(SceneError, match="its folder is unknown"):
        read_scene(_FILE.format(file="points.csv", call="torque(1)"), "text", cotree.Scene)


@pytest.mark.parametrize(
    ("given", "told"),
    [
        ({"x": [0, 1], "y": [0]}, "has 2 numbers x but 1 values"),
        ({"x": [1, 0], "y": [0, 1]}, "must ascend: number 2 is 0, after 1"),
        ({"x": [0, float("nan")], "y": [0, 1]}, "number 2 of x"),
        ({"x": [0, float("inf")], "y": [0, 1]}, "give a finite number"),
        ({"x": [0, 1], "y": [0, float("inf")]}, "value 2 of table 'f'"),
        ({"x": [0, True], "y": [0, 1]}, "give a finite number"),
        ({"x": [0], "y": [0]}, "needs two numbers or more"),
        ({"x": 3, "y": [0, 1]}, "x of table 'f' must be a list"),
        ({"x": [0, 1]}, "needs 'x' and its values, or 'file'"),
        ({"x": [0, 1], "y": [0, 1], "interpolation": "cubic"}, "interpolation of table 'f'"),
        ({"x": [0, 1], "y": [0, 1], "beyond": "stop"}, "a terminal event"),
        ({"x": [0, 1], "y": [0, "a"], "interpolation": "monotone"}, "values that are expressions"),
        ({"x": [0, 1], "y": [0, 1], "values": [[0, 1], [2]]}, "row 2 of values"),
        ({"x": [0, 1], "y": [0, 1], "values": [[0, 1]]}, "1 rows of values"),
        (
            {"x": [0, 1], "y": [0, 1], "values": [[0, 1], [1, 2]], "interpolation": "monotone"},
            "has two arguments",
        ),
        ({"x": list(range(100_001)), "y": [0.0] * 100_001}, "at most 100000 are allowed"),
        ({"x": [0, 1], "y": [0, "sin("]}, "is not an expression"),
    ],
)
def test_wrong_tables_are_refused(given: dict, told: str) -> None:
    scene = cotree.Scene("wrong")
    with pytest.raises(ModelError) as refused:
        scene.table("f", **given)
    assert told in str(refused.value)
    assert "table 'f'" in str(refused.value)
    assert not scene.tables


@pytest.mark.parametrize("name", ["sin", "where", "t", "a b", "f;g", "lambda", "ground.x"])
def test_names_of_tables_are_checked(name: str) -> None:
    with pytest.raises(SceneError, match="name"):
        cotree.Scene("wrong").table(name, [0, 1], [0, 1])


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("torqe(1)", "did you mean 'torque'"),
        ("torque(1, 2)", "gives torque 2 arguments: the table takes 1"),
        ("torque()", "gives torque 0 arguments"),
    ],
)
def test_wrong_calls_are_refused(text: str, told: str) -> None:
    scene = cotree.Scene("wrong")
    scene.table("torque", [0, 1], [0, 1])
    with pytest.raises(ExpressionError, match=told):
        scene.output("y", text)


def test_constants_of_tables_are_derived_parameters() -> None:
    scene = cotree.Scene("derived")
    scene.parameter("a", 2.0)
    scene.table("f", X, Y, interpolation="monotone")
    scene.table("g", [0, 1, 2], [0, "a", 3])
    scene.parameter("b", "f(1.7) + g(0.5)")
    scene.edge("x", "capacitor", "n", "ground", capacitance="b", initial={"v": 1.0})
    scene.edge("r", "resistor", "n", "ground", resistance=1.0)
    model = scene.compile(["a"])
    b = float(PchipInterpolator(X, Y)(1.7)) + 1.0
    result = model.simulate((0, 1), **_TIGHT)
    assert result["x.v"][-1] == pytest.approx(np.exp(-1 / b), rel=1e-9)
    assert result.sensitivity("x.v", "a")[-1] == pytest.approx(np.exp(-1 / b) / b**2 / 2, rel=1e-8)
