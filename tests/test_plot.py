from __future__ import annotations

from itertools import combinations
from typing import TYPE_CHECKING

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import PathPatch

from cotree.errors import SceneError
from cotree.graph import GraphEdge, LinearGraph, Tree, named_tree
from cotree.plot import draw_graph, draw_graphs, plot_result, save_figure
from cotree.plot.graph import lay_out

if TYPE_CHECKING:
    from pathlib import Path


def graph_of(*edges: str, domain: str = "translation") -> LinearGraph:
    """Build a graph from strings 'name tail head'."""
    parts = tuple(GraphEdge(*edge.split(), "x") for edge in edges)
    nodes = dict.fromkeys(["ground", *(node for e in parts for node in (e.tail, e.head))])
    return LinearGraph(domain, tuple(nodes), parts)


FIGURE_1 = graph_of(*(f"{name} ground A" for name in "mkcFs"))
PENDULUM = graph_of(
    "m5 ground A", "m6 ground C", "j1 ground A", "r3 A D", "h2 D B", "r4 B C", "k ground A"
)
CHAIN = graph_of("h0 ground n1", *(f"h{i} n{i} n{i + 1}" for i in range(1, 19)))
BODIES = graph_of(
    "h1 ground C1",
    *(f"h{i} C{i - 1} C{i}" for i in range(2, 11)),
    *(f"m{i} ground C{i}" for i in range(1, 11)),
)
STAR = graph_of(*(f"e{i} ground n{i}" for i in range(6)))
COMPLETE = graph_of(*(f"e{a}{b} {a} {b}" for a, b in combinations(["ground", *"ABCD"], 2)))
MIDDLE = graph_of("a ground A", "b ground B")
IN_PIECES = LinearGraph("rotation", ("ground", "A", "B", "C"), (GraphEdge("e", "B", "C", "x"),))


@pytest.mark.sampled(2)
@pytest.mark.parametrize(
    "graph", [FIGURE_1, PENDULUM, CHAIN, BODIES, STAR, COMPLETE, MIDDLE, IN_PIECES]
)
def test_every_name_is_drawn_and_none_covers_another(graph: LinearGraph):
    figure = draw_graph(graph, None)
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    texts = figure.axes[0].texts
    assert {text.get_text() for text in texts} == {*graph.nodes, *graph.edge_names}
    boxes = [text.get_window_extent(canvas.get_renderer()) for text in texts]
    for (a, b), (one, other) in zip(combinations(texts, 2), combinations(boxes, 2), strict=True):
        assert not one.overlaps(other), f"{a.get_text()} covers {b.get_text()}"
    for text, box in zip(texts, boxes, strict=True):
        assert figure.bbox.containsx(box.x0), text.get_text()
        assert figure.bbox.containsx(box.x1), text.get_text()


def test_single_node_is_drawn():
    figure = draw_graph(LinearGraph("rotation", ("ground",), ()), None)
    assert [text.get_text() for text in figure.axes[0].texts] == ["ground"]


def test_branches_are_bold():
    figure = draw_graph(PENDULUM, named_tree(PENDULUM, ["j1", "r3", "h2", "r4"]))
    curves = [patch for patch in figure.axes[0].patches if type(patch) is PathPatch]
    widths = sorted(patch.get_linewidth() for patch in curves)
    assert widths == [1.1] * 3 + [3.0] * 4
    labels = [text.get_text() for text in figure.axes[0].get_legend().get_texts()]
    assert labels == ["branch", "chord"]


def test_curves_run_from_tail_to_head_and_parallel_ones_apart():
    graph = graph_of("a ground A", "b A ground", "c ground A")
    drawing = lay_out(graph)
    for curve in drawing.curves:
        np.testing.assert_array_equal(curve.at(0), drawing.position_of[curve.edge.tail])
        np.testing.assert_array_equal(curve.at(1), drawing.position_of[curve.edge.head])
    middles = [curve.at(0.5)[0] for curve in drawing.curves]
    # 0.36 apart by construction; a label of two letters is 0.2 wide.
    np.testing.assert_allclose(np.diff(middles), 0.36, rtol=1e-12)


def test_edge_bends_around_a_node_in_its_way():
    # The layout puts n0, ground, n1 on one line.
    graph = graph_of("a ground n0", "b ground n1", "c ground n2", "d ground n3", "e n0 n1")
    drawing = lay_out(graph)
    curve = next(curve for curve in drawing.curves if curve.edge.name == "e")
    distance = min(np.linalg.norm(curve.at(s)) for s in np.linspace(0, 1, 21))
    assert distance > 0.2


def test_graph_lies_above_its_reference():
    for graph in (PENDULUM, BODIES, STAR):
        position_of = lay_out(graph).position_of
        # Rounding of the rotation only.
        assert all(position_of[node][1] > -1e-9 for node in graph.nodes), graph.edge_names


def test_given_axes_are_used():
    figure = Figure()
    ax = figure.subplots()
    assert draw_graph(FIGURE_1, None, ax) is figure
    assert ax.get_title() == "translation"


def test_graphs_stand_side_by_side_at_one_height():
    rotation = graph_of("m6 ground C", "j1 ground C", domain="rotation")
    pairs: list[tuple[LinearGraph, Tree | None]] = [
        (PENDULUM, None),
        (rotation, named_tree(rotation, ["j1"])),
    ]
    figure = draw_graphs(pairs)
    assert [ax.get_title() for ax in figure.axes] == ["translation", "rotation"]
    assert figure.axes[0].get_ylim() == figure.axes[1].get_ylim()


class FakeResult:
    """Just what a picture needs: s(t) = value_of[name] * sin(t), sensitivities twice that."""

    def __init__(self, units: dict[str, str], parameters: tuple[str, ...] = ()) -> None:
        self.t = np.linspace(0, 10, 101)
        self.units = units
        self.states = tuple(name for name in units if "." in name)
        self.outputs = ("rod_x",)
        self.inputs = ("push",)
        self.parameters_of_sensitivity = parameters

    def __getitem__(self, name: str) -> np.ndarray:
        return len(name) * np.sin(self.t)

    def sensitivity(self, state: str, parameter: str) -> np.ndarray:
        return 2 * self[state]

    def unit(self, name: str) -> str:
        return self.units.get(name, "")


@pytest.fixture
def pendulum() -> FakeResult:
    units = {"j1.s": "m", "h2.theta": "rad", "j1.s_dot": "m/s", "L": "m", "zeta": "N m s/rad"}
    return FakeResult(units, ("L", "zeta"))


def test_panels_are_units_by_parameters(pendulum: FakeResult):
    figure = plot_result(pendulum)
    assert [ax.get_ylabel() for ax in figure.axes] == [
        "j1.s [m]",
        "∂ j1.s / ∂ L [m/m]",
        "∂ j1.s / ∂ zeta\n[m/(N m s/rad)]",
        "h2.theta [rad]",
        "∂ h2.theta / ∂ L [rad/m]",
        "∂ h2.theta / ∂ zeta\n[rad/(N m s/rad)]",
    ]
    assert {ax.get_xlabel() for ax in figure.axes} == {"time [s]"}
    np.testing.assert_array_equal(figure.axes[4].lines[0].get_ydata(), 16 * np.sin(pendulum.t))


def test_overlay_is_drawn_as_open_circles(pendulum: FakeResult):
    t = pendulum.t
    figure = plot_result(pendulum, ["j1.s"], {("j1.s", "L"): (t, t**2)})
    ax = figure.axes[1]
    circles = ax.lines[1]
    assert (circles.get_marker(), circles.get_markerfacecolor()) == ("o", "none")
    # 101 points are thinned to every third, so that circles stay apart.
    np.testing.assert_array_equal(circles.get_ydata(), t[::3] ** 2)
    labels = [text.get_text() for text in ax.get_legend().get_texts()]
    assert labels == ["∂ j1.s / ∂ L", "finite differences"]
    assert len(figure.axes[2].lines) == 1


def test_names_of_one_unit_share_a_panel_with_a_legend():
    result = FakeResult({"a.s": "m", "b.s": "m", "rod_x": "m"}, ("L",))
    left, right = plot_result(result, ["a.s", "rod_x"]).axes
    assert [text.get_text() for text in left.get_legend().get_texts()] == ["a.s", "rod_x"]
    # The unit of L is not known, so no unit is claimed.
    assert (left.get_ylabel(), right.get_ylabel()) == ("[m]", "∂ / ∂ L")


def test_many_curves_are_explained_once():
    result = FakeResult({f"h{i}.theta": "rad" for i in range(20)}, ("L",))
    left, right = plot_result(result).axes
    assert len(left.get_legend().get_texts()) == 20
    assert right.get_legend() is None
    assert len({line.get_color() for line in right.lines}) == 20


def test_many_parameters_take_several_rows():
    result = FakeResult({"j1.s": "m"}, tuple("abcdefgh"))
    figure = plot_result(result, [("j1.s", name) for name in "abcdefgh"] + ["j1.s"])
    assert len(figure.axes) == 9
    assert figure.axes[0].get_gridspec().get_geometry() == (3, 4)


def test_of_many_parameters_few_come_along_unnamed():
    figure = plot_result(FakeResult({"j1.s": "m"}, tuple("abcdefgh")))
    # The value itself, and a readable number of its sensitivities.
    assert len(figure.axes) == 5


def test_rates_are_plotted_where_there_is_nothing_else_or_on_request(pendulum: FakeResult):
    assert len(plot_result(FakeResult({"a.s_dot": "m/s"})).axes[0].lines) == 1
    assert plot_result(pendulum, ["j1.s_dot"]).axes[0].get_ylabel() == "j1.s_dot [m/s]"


def test_named_sensitivities_are_drawn_and_no_others(pendulum: FakeResult):
    figure = plot_result(pendulum, ["j1.s", "push", "d(h2.theta)/d(L)", ("rod_x", "zeta")])
    assert [ax.get_ylabel() for ax in figure.axes] == [
        "j1.s [m]",
        "push",
        "∂ rod_x / ∂ zeta",
        "∂ h2.theta / ∂ L [rad/m]",
    ]
    assert figure.axes[0].get_gridspec().get_geometry() == (3, 2)


def test_sensitivities_alone_leave_no_column_for_values(pendulum: FakeResult):
    for names in ("d(j1.s)/d(L)", [("j1.s", "L")], [["j1.s", "L"]]):
        (ax,) = plot_result(pendulum, names).axes
        assert ax.get_ylabel() == "∂ j1.s / ∂ L [m/m]"
        assert ax.get_gridspec().get_geometry() == (1, 1)


def test_inputs_have_no_sensitivities(pendulum: FakeResult):
    (ax,) = plot_result(pendulum, "push").axes
    np.testing.assert_array_equal(ax.lines[0].get_ydata(), pendulum["push"])


def test_a_name_has_one_colour_in_all_panels():
    result = FakeResult({"a.s": "m", "b.s": "m"}, ("L",))
    left, right = plot_result(result, ["a.s", "b.s", ("b.s", "L")]).axes
    assert right.lines[0].get_color() == left.lines[1].get_color()


@pytest.mark.parametrize(
    ("names", "message"),
    [
        (
            ["j1.x"],
            r"cannot plot 'j1\.x', which is not a state, output or input; did you mean 'j1\.s'",
        ),
        (
            ["d(j1.q)/d(L)"],
            r"cannot plot a sensitivity of 'j1\.q', which is not a state or output.*'j1\.s'",
        ),
        ([("push", "L")], r"cannot plot a sensitivity of 'push', which is not a state or output"),
        ([("j1.s", "Lr")], r"sensitivities to 'Lr', which were not computed; did you mean 'L'"),
        ([("j1.s", 3)], r"sensitivities to '3', which were not computed"),
        ([("j1.s", "L", "L")], r"cannot plot '\('j1\.s', 'L', 'L'\)', which is not a state"),
        ([None], "cannot plot 'None', which is not a state"),
        ([], "there are no names of variables to plot"),
    ],
)
def test_what_is_not_there_is_named(pendulum: FakeResult, names, message: str):
    with pytest.raises(SceneError, match=message):
        plot_result(pendulum, names)


def test_wrong_names_are_named(pendulum: FakeResult):
    with pytest.raises(SceneError, match=r"cannot plot 'j1\.x'.*did you mean 'j1\.s'"):
        plot_result(pendulum, ["j1.x"])
    with pytest.raises(SceneError, match=r"overlay of 'j1\.s' by 'm1' belongs to no curve"):
        plot_result(pendulum, overlay={("j1.s", "m1"): (pendulum.t, pendulum.t)})


@pytest.mark.sampled(2)
@pytest.mark.parametrize(
    ("suffix", "begin"),
    [("svg", b"<?xml"), ("png", b"\x89PNG"), ("pdf", b"%PDF"), ("PNG", b"\x89")],
)
def test_figure_is_written_the_same_each_time(tmp_path: Path, suffix: str, begin: bytes):
    for name in ("one", "two"):
        save_figure(draw_graph(FIGURE_1, None), tmp_path / f"{name}.{suffix}")
    one, two = ((tmp_path / f"{name}.{suffix}").read_bytes() for name in ("one", "two"))
    assert one.startswith(begin)
    assert one == two
    assert len(list(tmp_path.iterdir())) == 2


@pytest.mark.parametrize("name", ["graph.bmp", "graph", ".svg"])
def test_unknown_suffix_is_refused(tmp_path: Path, name: str):
    with pytest.raises(SceneError, match=r"unknown suffix .* ones are \.svg, \.png and \.pdf"):
        save_figure(Figure(), tmp_path / name)


def test_missing_folder_is_named(tmp_path: Path):
    with pytest.raises(SceneError, match=r"cannot write the picture '.*gone.*': No such file"):
        save_figure(Figure(), tmp_path / "gone" / "graph.svg")


def test_failure_leaves_the_old_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    path = tmp_path / "graph.svg"
    path.write_text("old")
    figure = Figure()

    def fail(temporary: Path, **_: object) -> None:
        temporary.write_text("half")
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(figure, "savefig", fail)
    with pytest.raises(SceneError, match="No space left"):
        save_figure(figure, path)
    assert [file.read_text() for file in tmp_path.iterdir()] == ["old"]
