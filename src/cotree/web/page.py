"""The page of a model: one HTML file with its program, equations, graphs and scene.

Names and texts are untrusted, as in animations: the template escapes them, JSON contains no markup,
and the content security policy permits only the page's own script, and no network.
"""

from __future__ import annotations

import base64
import math
import zlib
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Protocol

from cotree.arguments import check_names
from cotree.codegen.render import environment
from cotree.errors import CodegenError, SceneError, check_known
from cotree.export.c_checks import Evaluated, check_loops
from cotree.export.c_project import Kit, held_parameters, project_texts
from cotree.export.symbolic import symbolic_equations
from cotree.files import atomic_write, check_suffix, target_path, template_folder
from cotree.graph import f_circuit, f_cutset
from cotree.methods import METHODS
from cotree.pipeline import draw_graphs, formulate
from cotree.plot.graph import freest, lay_out
from cotree.scene.expressions import check_number
from cotree.scene.toml_text import kept_scene_text
from cotree.sharing import forming
from cotree.version import VERSION
from cotree.watch.animation import animate, embedded, hashed
from cotree.watch.frame_times import WatchedModel
from cotree.web.motion import attach
from cotree.web.wasm import build_wasm, check_zig

if TYPE_CHECKING:
    import os
    from collections.abc import Iterator, Mapping, Sequence
    from pathlib import Path

    from markupsafe import Markup

    from cotree.export.c_project import MainContext
    from cotree.export.symbolic import SymbolicEquations
    from cotree.graph import LinearGraph, Tree
    from cotree.model.start import Start
    from cotree.program.layout import Layout
    from cotree.program.program import Program
    from cotree.scene.description import SceneDescription
    from cotree.solvers import RunRecord
    from cotree.web.motion import Moving

#: Intervals of slider positions by name of a parameter or state.
Ranges = dict[str, tuple[float, float]]

#: Scripts of the page in their order; each defines functions that the later ones use.
_SCRIPTS = ("viewer.js", "engine.js", "charts.js", "graph.js", "model.js")
_POINTS = 501  # number of times at which the page evaluates a run
_MOST_MARKUP = 100_000  # maximum number of characters of all equations
_MOST_SHOWN = 6  # maximum number of curves that the page shows first


@dataclass(frozen=True)
class ModelPageContext:
    """The variables of the page's template."""

    title: str  # name of the scene; untrusted
    headline: str  # numbers of nodes, edges and other items
    policy: str  # content security policy
    generator: str  # name of the program that wrote the file
    has_animation: bool
    graphs: tuple[str, ...]  # domains of the linear graphs
    #: Titles and equations as MathML, and the reason why some are missing.
    equations: tuple[tuple[str, tuple[Markup, ...]], ...]
    omitted: str
    #: Style sheet, script and data of the page, already escaped.
    style: Markup
    script: Markup
    data: Markup


class PageModel(WatchedModel, Protocol):
    """The attributes of :class:`cotree.Model` that pages need."""

    def start(self) -> Start:
        """Compute the start of a run; see :meth:`cotree.Model.start`."""
        ...

    def simulate(self) -> RunRecord:
        """Simulate the default run; see :meth:`cotree.Model.simulate`."""
        ...


def export_web(
    model: PageModel,
    path: str | os.PathLike[str],
    *,
    ranges: Mapping[str, Sequence[float]] | None = None,
) -> Path:
    """Write a model as an interactive page, one HTML file that runs it offline; return its path.

    Needs the extra ``web``.

    Parameters
    ----------
    model : Model
        The model; the page predicts changes by the sensitivities with which it was compiled.
    path : path
        The file, ``x.html``.
    ranges : mapping of str to (low, high), optional
        Ranges of sliders by the name of a parameter or state, in SI units. By default, a range
        extends from zero to twice the value, or from -1 to 1 if the value is zero.

    Raises
    ------
    SceneError
        If a range is invalid, or the file cannot be written.
    CodegenError
        If the scene cannot run without Python.
    BuildError
        If the package ``ziglang`` is missing, or the compilation fails.
    """
    check_zig()
    to = target_path(path, "the page")
    check_suffix(to, (".html",), "write a page into")
    # C projects do not search for operating points, so they receive the start.
    start = model.start() if model.kernels.begins_at_rest else None
    result = model.simulate()
    # Hold the lock: forming kernels adds nodes to the program's arena, which threads share.
    with forming:
        text = page_text(model, result, start, ranges or {})
    with atomic_write(to, "the page") as draft:
        draft.write_text(text, encoding="utf-8", newline="\n")
    return to


def page_text(
    model: WatchedModel,
    result: RunRecord,
    start: Start | None,
    ranges: Mapping[str, Sequence[float]],
) -> str:
    """Return the page of a model as HTML."""
    from markupsafe import Markup

    spec, layout = model.spec, model.kernels.layout
    checked = _checked_ranges(ranges, layout)
    first = spec.formed.first
    moving = None
    if first.scene.mechanics.edges:
        p = model.kernels.default_parameters
        moving = attach(first, animate(result, model).drawing, p)
    program, outputs = _with_poses(model, moving)
    is_stiff = METHODS[result.statistics.method].implicit
    evaluated = Evaluated(program, model.kernels)
    methods = _methods(evaluated, is_stiff)
    defaults = spec.scene.defaults
    numbers = {"t_end": defaults.t_end, "rtol": defaults.rtol, "atol": defaults.atol}
    kit = Kit(",".join(methods), is_page=True)
    _, _, main, files = project_texts(program, kit, numbers, start=start, evaluated=evaluated)
    data = _model_data(program, main, model, start or evaluated.start, checked) | {
        "t_end": defaults.t_end,
        "points": _POINTS,
        "scene": _scene_parts(spec.scene, layout),
        "graphs": list(_graphs(spec.scene, first.system.trees)),
        "wasm": base64.b64encode(zlib.compress(build_wasm(files), 9)).decode("ascii"),
    }
    if moving is not None:
        names = [row.name for row in program.layout.outputs]
        data["motion"] = moving.data(lambda name: names.index(outputs[name]))
    equations, omitted = _equations(model)
    folder = template_folder() / "html"
    style = (folder / "model.css").read_text(encoding="utf-8")
    script = '"use strict";\n' + "\n".join(
        (folder / name).read_text(encoding="utf-8") for name in _SCRIPTS
    )
    policy = (
        f"default-src 'none'; script-src {hashed(script)} 'wasm-unsafe-eval'; "
        f"style-src {hashed(style)}; base-uri 'none'; form-action 'none'"
    )
    context = ModelPageContext(
        title=spec.scene.name,
        headline=spec.scene.headline.partition(": ")[2],
        policy=policy,
        generator=f"cotree {VERSION}",
        has_animation=moving is not None,
        graphs=tuple(row["domain"] for row in data["graphs"]),
        # SymPy and this package write the equations, and escape names.
        equations=tuple((title, tuple(map(Markup, rows))) for title, rows in equations),
        omitted=omitted,
        # The style and the scripts are files of the package.
        style=Markup(style),
        script=Markup(script),
        data=Markup(embedded(data)),
    )
    return environment(is_html=True).get_template("html/model.html.jinja").render(page=context)


def _checked_ranges(ranges: Mapping[str, Sequence[float]], layout: Layout) -> Ranges:
    names = [row.name for row in (*layout.parameters, *layout.states)]
    check_names(list(ranges), "ranges")
    check_known(ranges, names, "there is no parameter or state", error=SceneError)
    found: Ranges = {}
    for name, ends in ranges.items():
        what = f"the range of '{name}'"
        if isinstance(ends, str) or len(ends) != 2:
            raise SceneError(f"{what} must be a pair of numbers")
        low, high = (check_number(end, what) for end in ends)
        if not low < high:
            raise SceneError(f"{what} is {low:g} to {high:g}: give the lower end first")
        found[name] = low, high
    return found


def _methods(evaluated: Evaluated, is_stiff: bool) -> list[str]:
    """Return the methods of the page, the default one first."""
    try:
        check_loops(evaluated.program, "rodas5", evaluated.is_dependent())
    except CodegenError:  # rodas5 does not support dependent constraints
        return ["dopri5"]
    return ["rodas5", "dopri5"] if is_stiff else ["dopri5", "rodas5"]


def _with_poses(model: WatchedModel, moving: Moving | None) -> tuple[Program, dict[str, str]]:
    """Return the model's program with the poses of tracks as outputs, and their names."""
    spec = model.spec
    if moving is None:
        return model.kernels.program, {}
    scene = spec.scene.copied()
    names: dict[str, str] = {}
    for track in moving.tracks:
        for variable in track.outputs():
            if variable not in names:
                name = f"pose{len(names)}"
                while name in scene.outputs or name in scene.parameters or name in scene.modes:
                    name += "_"
                scene.output(name, variable)
                names[variable] = name
    program = spec.of(scene).formed.text.program
    added = [row.name in set(names.values()) for row in program.layout.outputs]
    # The page needs no sensitivities of poses. The results are in order of the parameters.
    kernel = program.kernels["output_sensitivity"]
    own = [
        program.dag.zero if added[i % len(added)] else node for i, node in enumerate(kernel.results)
    ]
    kernels = {**program.kernels, "output_sensitivity": replace(kernel, results=tuple(own))}
    return replace(program, kernels=kernels), names


def _model_data(
    program: Program, main: MainContext, model: WatchedModel, start: Start, ranges: Ranges
) -> dict[str, Any]:
    """Return names, units, values and ranges of all quantities of a run."""
    layout, own = program.layout, len(model.kernels.layout.outputs)
    held = held_parameters(program, has_start=bool(main.start))
    is_fixed = bool(main.start)
    parameters = [
        {
            "name": row.name,
            "unit": row.unit,
            "doc": row.doc,
            "value": value,
            "range": ranges.get(row.name) or _range(value),
            "held": i in held,
        }
        for i, (row, value) in enumerate(
            zip(layout.parameters, layout.parameter_values, strict=True)
        )
    ]
    y = start.y
    follows = _following(layout, model.spec.formed.first.scene)
    states = [
        {
            "name": row.name,
            "unit": row.unit,
            "value": float(y[i]),
            "range": ranges.get(row.name) or _range(float(y[i])),
            "set": not (is_fixed or i in follows),
        }
        for i, row in enumerate(layout.states)
    ]
    places = {row.name: i for i, row in enumerate(layout.parameters)}
    of_states = {row.name: i for i, row in enumerate(layout.states)}
    outputs = [{"name": row.name, "unit": row.unit} for row in layout.outputs[:own]]
    inputs = [{"name": row.name, "unit": row.unit} for row in layout.inputs]
    shown = [f"o{i}" for i in range(own)]
    shown += [f"x{i}" for i in range(layout.n_coordinates or len(states)) if states[i]["unit"]]
    return {
        "name": layout.name,
        "generator": f"cotree {VERSION}",
        "methods": main.methods,
        "parameters": parameters,
        "states": states,
        "outputs": outputs,
        "inputs": inputs,
        "n_outputs": len(layout.outputs),
        "sensitivities": [
            {"name": name, "parameter": places.get(name, -1), "state": of_states.get(name, -1)}
            for name in layout.sensitivities
        ],
        "events": [row.name for row in layout.events],
        "shown": shown[:_MOST_SHOWN],
    }


def _following(layout: Layout, scene: SceneDescription) -> frozenset[int]:
    """Return the indices of states whose initial values cannot be chosen."""
    quaternions = {i + k for i in layout.quaternions for k in range(4)}
    return frozenset(
        i
        for i, row in enumerate(layout.states)
        if layout.algebraic[i]
        or i in quaternions
        or row.name in scene.modes
        or (layout.has_conditions and not layout.given[i])
    )


def _range(value: float) -> tuple[float, float]:
    """Return the default interval of a slider: from zero to twice the value."""
    if value == 0.0 or not math.isfinite(value):
        return -1.0, 1.0
    return (0.0, 2.0 * value) if value > 0.0 else (2.0 * value, 0.0)


def _scene_parts(scene: SceneDescription, layout: Layout) -> list[Any]:
    """Return the scene as TOML, divided at the values that the page may change.

    Entries are texts, ``{"p": index of a parameter}`` and ``{"x": index of a state}``.
    """
    import tomlkit

    text = kept_scene_text(scene)
    document, prefix = tomlkit.parse(text), "value"
    while prefix in text:  # for example in a comment
        prefix += "_"
    marks: list[tuple[str, dict[str, Any]]] = []

    def mark(kind: str, index: int) -> str:
        marks.append((f"{prefix}{len(marks)}", {kind: index}))
        return marks[-1][0]

    parameters: Any = document.get("parameters", {})
    for i, row in enumerate(layout.parameters):
        own = parameters.get(row.name)
        if hasattr(own, "keys") and "value" in own:
            own["value"] = mark("p", i)
            if "unit" in own:
                own["unit"] = row.unit  # values of runs are in SI
        elif own is not None:
            parameters[row.name] = mark("p", i)
    edges: Any = document.get("edges", {})
    for i, state in enumerate(layout.states):
        name, _, variable = state.name.rpartition(".")
        initial = edges.get(name, {}).get("initial", {})
        # An initial value that depends on parameters remains an expression.
        if isinstance(initial.get(variable), (int, float)):
            initial[variable] = mark("x", i)
    parts: list[Any] = []
    text = tomlkit.dumps(document)
    for sign, part in sorted(marks, key=lambda row: text.find(f'"{row[0]}"')):
        before, found, after = text.partition(f'"{sign}"')
        if found:
            parts += [before, part]
            text = after
    return [*parts, text]


def _graphs(scene: SceneDescription, trees: Any) -> Iterator[dict[str, Any]]:
    """Yield the drawings of the linear graphs, with the terms of their cutsets and circuits."""
    tree = None
    if scene.mechanics.edges:
        own = {"translation": trees.translation, "rotation": trees.rotation}
        tree = {name: row.branches for name, row in own.items()}
    graphs, chosen = draw_graphs(scene, tree)
    for domain, graph in graphs.items():
        yield _graph(domain, graph, chosen[domain])


def _graph(domain: str, graph: LinearGraph, tree: Tree) -> dict[str, Any]:
    drawing = lay_out(graph)
    cutsets, circuits = f_cutset(tree), f_circuit(tree)
    rows = {
        name: dict(zip(matrix.columns, matrix.matrix[i].tolist(), strict=True))
        for matrix in (cutsets, circuits)
        for i, name in enumerate(matrix.rows)
    }
    nodes = []
    for node, position in drawing.position_of.items():
        directions = [
            (curve.at(0.15) if curve.edge.tail == node else curve.at(0.85)) - position
            for curve in drawing.curves
            if node in (curve.edge.tail, curve.edge.head)
        ]
        away = freest(directions, 4 if node == graph.reference else 16)
        nodes.append({"name": node, "at": _short(position), "away": _short(away)})
    return {
        "domain": domain,
        "reference": graph.reference,
        "nodes": nodes,
        "edges": [
            {
                "name": curve.edge.name,
                "kind": curve.edge.kind,
                "tail": curve.edge.tail,
                "head": curve.edge.head,
                "branch": tree.is_branch(curve.edge.name),
                "points": [_short(point) for point in curve.points],
                "label": _short(label),
                "terms": {name: int(v) for name, v in rows[curve.edge.name].items() if v},
            }
            for curve, label in zip(drawing.curves, drawing.labels, strict=True)
        ],
    }


def _short(values: Any) -> list[float]:
    return [round(float(v), 3) + 0.0 for v in values]


def _equations(model: WatchedModel) -> tuple[list[tuple[str, list[str]]], str]:
    """Return titles and equations as MathML, and why some are missing."""
    spec = model.spec
    _, formed, _ = formulate(spec.scene, spec.sensitivities, spec.of(spec.scene).tree)
    symbolic: SymbolicEquations = symbolic_equations(formed)
    found: list[tuple[str, list[str]]] = []
    size = 0
    for name in (None, *symbolic.sensitivity):
        rows = symbolic.mathml(name)
        size += sum(map(len, rows))
        if size > _MOST_MARKUP:
            what = "The equations" if name is None else "Further sensitivity equations"
            return found, f"{what} are too long for this page: see cotree equations."
        title = "Governing equations" if name is None else f"Sensitivity to {name}"
        found.append((title, rows))
    return found, ""
