"""The data of a scene: the user's statements, each checked when it is made."""

from __future__ import annotations

import copy
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Self

from cotree.arguments import is_list, plain
from cotree.errors import SceneError, UnitError, brief, check_known, nearest
from cotree.naming import check_name, check_path, check_scene_name, check_text
from cotree.report import Listing, Report, Reported, Table, Values, counted
from cotree.scene.edge import Edge, make_edge
from cotree.scene.expressions import Expression, may_call_tables, parse
from cotree.scene.fields import Input, check_vector, make_input
from cotree.scene.parameters import Parameter, check_cycle, make_parameter
from cotree.scene.settings import Simulation, with_settings

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Mapping, Sequence

    from cotree.scene.events import Event, Mode
    from cotree.scene.part import Part
    from cotree.scene.tables import LookupTable

__all__ = ["Edge", "Input", "SceneDescription"]


#: Tables of a scene to which parts add declarations.
TABLES = ("tables", "parameters", "inputs", "modes", "edges", "outputs", "events")
#: Maximum number of edges and of declarations of parts; it protects against untrusted files.
LARGEST_SCENE = 250_000

_PARAMETER, _EDGE = ("name", "value", "unit", "meaning"), ("name", "type", "nodes", "fields")

#: Rules of the linter with descriptions of their findings; 'refused' cannot be allowed.
RULES: dict[str, str] = {
    "refused": "the scene cannot be formed, or has no consistent start",
    "unused-parameter": "no expression of the scene uses a parameter",
    "unused-input": "no expression of the scene uses an input",
    "similar-names": "two names differ only in upper and lower case",
    "dangling-node": "a node belongs to one edge only, and no expression uses it",
    "shorted": "both ends of an edge are at one node",
    "inertia": "a body has no inertia, or a physically impossible one",
    "magnitude": "a value is far from what is usual in its unit",
    "dimension": "units in an expression contradict each other, or that of the field",
    "constant": "an expression does not depend on the names in it",
    "no-effect": "a source is zero, or no event sets a mode",
    "unused-allow": "an entry of allow matches no finding",
}


def check_allowed(entries: object) -> tuple[str, ...]:
    """Return a checked list of allowed findings, each ``rule`` or ``rule:name``."""
    if not isinstance(entries, (list, tuple)) or not all(isinstance(e, str) for e in entries):
        raise SceneError("allow must be a list of texts: ['unused-parameter:L']")
    for entry in entries:
        rule, colon, name = entry.partition(":")
        if rule not in RULES or (colon and not name):
            hint = nearest(rule, RULES)
            raise SceneError(f"allow holds '{brief(entry)}': give 'rule' or 'rule:name'{hint}")
        if rule == "refused":
            raise SceneError(
                "allow holds 'refused': a scene that cannot be formed cannot be allowed"
            )
    return tuple(entries)


def is_allowed(rule: str, name: str, entries: Iterable[str]) -> bool:
    """Return whether the entries allow a finding."""
    return any(entry in (rule, f"{rule}:{name}") for entry in entries)


@dataclass(repr=False)
class SceneDescription(Reported):
    """Edges between named nodes, with parameters, inputs, outputs, gravity and initial values.

    Each method checks its arguments before it stores them, so that a description contains only
    valid names and parsed expressions. Properties of the whole scene are checked when the equations
    are formed.
    """

    name: str
    gravity: tuple[Expression, ...]
    tables: dict[str, LookupTable] = field(default_factory=dict)
    parameters: dict[str, Parameter] = field(default_factory=dict)
    inputs: dict[str, Input] = field(default_factory=dict)
    edges: dict[str, Edge] = field(default_factory=dict)
    outputs: dict[str, Expression] = field(default_factory=dict)
    modes: dict[str, Mode] = field(default_factory=dict)
    events: dict[str, Event] = field(default_factory=dict)
    parts: dict[str, Part] = field(default_factory=dict)
    ports: tuple[str, ...] = ()  # nodes that an outer scene may connect if this scene is a part
    defaults: Simulation = field(default_factory=Simulation)
    origin: Origin | None = None  # data from another tool's file
    allowed: tuple[str, ...] = ()  # rules of the linter whose findings are accepted

    def __init__(self, name: str, gravity: Sequence[float | str] = (0.0, 0.0, 0.0)) -> None:
        # The constructor is written by hand, because a generated one would accept unchecked tables.
        self.name = check_scene_name(name)
        self.gravity = check_vector(plain(gravity), "gravity")
        self.parameters, self.edges = Listing(*_PARAMETER), Listing(*_EDGE)
        self.inputs, self.outputs, self.tables = {}, {}, {}
        self.modes, self.events = {}, {}
        self.defaults = Simulation()
        self.parts, self.ports = {}, ()
        self.members: dict[str, Part] = {}  # all parts by name, including each part of an array
        self.connected: set[str] = set()  # nodes that parts connect
        # File and section from which the scene was read; equality of scenes ignores them.
        self.file = self.section = ""

    def __repr__(self) -> str:
        return f"<{type(self).__name__} {self.headline}>"

    @property
    def nodes(self) -> tuple[str, ...]:
        """Names of the nodes: the reference, then all others in order of appearance."""
        seen = dict.fromkeys(["ground"])
        for edge in self.edges.values():
            seen.update(dict.fromkeys(edge.nodes))
        return tuple(seen)

    @property
    def mechanics(self) -> SceneDescription:
        """The multibody part: the scene without its scalar networks."""
        # All tables except edges are shared, so that names in expressions keep their meaning.
        part = SceneDescription(self.name)
        part.gravity, part.defaults, part.tables = self.gravity, self.defaults, self.tables
        part.parameters, part.inputs, part.outputs = self.parameters, self.inputs, self.outputs
        part.modes, part.events = self.modes, self.events
        part.edges = {
            name: own
            for name, edge in self.edges.items()
            if (own := edge.in_mechanics()) is not None
        }
        return part

    def copied(self) -> Self:
        """Return an independent copy of the scene."""
        other = copy.copy(self)
        for name in (*TABLES, "parts", "members", "connected"):
            setattr(other, name, copy.copy(getattr(self, name)))
        return other

    @property
    def headline(self) -> str:
        """The scene in one line: its name, and the numbers of nodes, edges and other items."""
        counts = {
            "node": len(self.nodes),
            "edge": len(self.edges),
            "part": len(self.members),
            "table": len(self.tables),
            "parameter": len(self.parameters),
            "input": len(self.inputs),
            "output": len(self.outputs),
            "mode": len(self.modes),
            "event": len(self.events),
        }
        shown = [counted(n, noun) for noun, n in counts.items() if n]
        return f"{self.name}: {', '.join(shown)}"

    def report(self) -> Report:
        """Build the report; the declarations of a part are counted in the part's line."""
        edges = []
        for edge in self.edges.values():
            if "." not in edge.name:
                name, kind, nodes, fields = edge.cells()
                places = [nodes] if nodes else []
                places += [f"on {edge.statement['joint']}"] if "joint" in edge.statement else []
                places += [f"on {' - '.join(e.acts_on)}" for e in edge.ports if len(e.acts_on) == 2]
                edges.append((name, kind, ", ".join(places), fields))
        own = [row for name, row in self.parameters.items() if "." not in name]
        derived = [(row.name, row.cells()[1], row.unit) for row in own if row.is_derived]
        expressions = [
            (kind, name, getattr(value, "text", "table"))
            for kind, values in (
                ("input", {name: row.value for name, row in self.inputs.items()}),
                ("output", self.outputs),
                ("mode", {name: row.initial for name, row in self.modes.items()}),
                ("event", {name: row.when for name, row in self.events.items()}),
            )
            for name, value in values.items()
        ]
        notes = self.origin.notes if self.origin else ()
        parameters = [row.cells() for row in self.parameters.values()]
        return Report(
            f"Scene {self.headline}",
            Table(_EDGE, edges, "edges", in_text=3),
            *(f"  {part.shown}" for part in self.parts.values()),
            Values((), derived, "derived parameters", most=0),
            Table(_PARAMETER, parameters, "parameters", "lrll", in_text=0),
            Table(("", "name", "expression"), expressions, in_text=0),
            *(f"note: {note}" for note in notes),
        )

    @may_call_tables
    def parameter(
        self, name: str, value: float | str, *, unit: str = "", doc: str = "", tunable: bool = True
    ) -> None:
        """Declare a parameter.

        Parameters
        ----------
        name : str
            Its name in expressions.
        value : float or str
            Its value: a finite number or, for a derived parameter, an expression of other
            parameters.
        unit, doc : str
            The unit of the value, which is converted to SI (``1000, unit="mm"`` is 1 m), and its
            meaning. Runs give values in SI.
        tunable : bool
            If False, the value is a fixed number in the generated code.

        Raises
        ------
        SceneError, ParameterError, ExpressionError, UnitError
            If the name is invalid or taken, the unit or the value is invalid, or a derived
            parameter depends on itself.
        """
        self._check_new("parameter", name, {**self.parameters, **self.inputs, **self.modes})
        row = make_parameter(name, value, unit, doc, tunable)
        check_cycle({**self.parameters, name: row}, name)
        self.parameters[name] = row

    @may_call_tables
    def set(
        self, name: str, value: float | str | Sequence[Sequence[float]], *, unit: str = ""
    ) -> None:
        """Change the value of a parameter or input; its description and order are kept.

        Models that are already compiled keep the previous value. To change the value for a single
        run, use ``simulate(parameters={"L": 2.0})``.

        Parameters
        ----------
        name : str
            The name of a parameter or input of the scene.
        value : float, str or (times, values)
            The value, as for :meth:`parameter` and :meth:`input`.
        unit : str
            The unit of the value; by default the SI unit of the parameter or input.

        Raises
        ------
        SceneError, ParameterError, ExpressionError, UnitError
            If the name is unknown, or the value or the unit is invalid.
        """
        if self.members:
            from cotree.scene.part_adding import set_in_part

            if set_in_part(self, name, value, unit):
                return
        row = self.inputs.get(name) or self.parameters.get(name)
        if row is None:
            hint = nearest(name, {**self.parameters, **self.inputs})
            raise SceneError(f"'{brief(name)}' is neither a parameter nor an input{hint}")
        own, changed = unit or row.unit, row
        if isinstance(row, Parameter):
            changed = make_parameter(name, value, own, row.doc, row.tunable)
            check_cycle({**self.parameters, name: changed}, name)
        else:
            changed = make_input(name, value, own, row.doc)
        if row.unit and changed.unit != row.unit:
            raise UnitError(f"'{name}' is in '{row.unit}', which '{unit}' cannot be converted to")
        if isinstance(changed, Parameter):
            self.parameters[name] = changed
        else:
            self.inputs[name] = changed

    @may_call_tables
    def input(
        self,
        name: str,
        value: float | str | Sequence[Sequence[float]] = 0.0,
        *,
        unit: str = "",
        doc: str = "",
    ) -> None:
        """Declare an input: a signal over time that a run may replace.

        Parameters
        ----------
        name : str
            Its name in expressions.
        value : float, str or (times, values)
            A number, an expression of ``t`` and parameters, or a table, which is interpolated
            linearly, and is constant before the first and after the last time.
        unit, doc : str
            The unit of the value, which is converted to SI, and its meaning. Expressions, and
            values given by a run, are in SI.

        Raises
        ------
        SceneError, ExpressionError, UnitError
            If the name is invalid or taken, or the unit or the value is invalid.
        """
        self._check_new("input", name, self._signals)
        self.inputs[name] = make_input(name, value, unit, doc)

    @may_call_tables
    def edge(
        self,
        name: str,
        type: str,
        *nodes: str,
        initial: Mapping[str, Any] | None = None,
        **fields: Any,
    ) -> None:
        """Add an edge: a component between nodes.

        Parameters
        ----------
        name : str
            Its name; its coordinates have names such as ``name.coordinate``.
        type : str
            A component type, see :data:`cotree.components.COMPONENTS`.
        *nodes : str
            Names of its nodes. For multibody and one-dimensional mechanical components, the first
            and the second node: across variables are those of the second node minus those of the
            first. For electrical, hydraulic and thermal components, the plus node and the minus
            node: the across variable is the difference plus minus minus, and the through variable
            flows from plus to minus inside the component. Forces of multibody components act on the
            second node; in one-dimensional components the through variable is positive if the
            component absorbs power. As in scene files, ``nodes=[...]`` is also accepted.
        initial : mapping, optional
            Initial values of coordinates and their rates: numbers or expressions of parameters.
        **fields
            Fields of the component: numbers, expressions, or lists of them, in SI; values in other
            units as ``{"value": 20, "unit": "mm"}``; if there are several ports, the two nodes of
            each port.

        Raises
        ------
        SceneError, ExpressionError, UnitError
            If a name, field or value is invalid.
        """
        self._check_new("edge", name, self.members if name in self.members else self.edges)
        if len(self.edges) >= LARGEST_SCENE:
            raise SceneError(f"the scene has more than {LARGEST_SCENE} edges")
        listed: Any = nodes
        if "nodes" in fields:
            if nodes:
                raise SceneError(
                    f"edge '{name}' has nodes as arguments and as nodes=[...]: remove one of them"
                )
            listed = fields.pop("nodes")
            if not is_list(listed):
                raise SceneError(f"nodes of edge '{name}' must be a list of names")
        made = make_edge(name, type, listed, initial, fields)
        along = [node for ends in made.ports if len(ends.acts_on) == 2 for node in ends.acts_on]
        for node in (*made.nodes, *along):
            if "." in node or node in self.members:
                from cotree.scene.part_adding import check_node

                try:
                    check_node(self, node)
                except SceneError as error:
                    raise SceneError(f"edge '{name}': {error}") from None
        self.edges[name] = made

    def port(self, *nodes: str) -> None:
        """Declare nodes as ports: if this scene is a part, the outer scene must connect them.

        Raises
        ------
        SceneError
            If a name is invalid.
        """
        for node in nodes:
            if check_path("node", node) == "ground":
                raise SceneError("the ground is the same node in all parts and cannot be a port")
        self.ports = tuple(dict.fromkeys((*self.ports, *nodes)))

    @may_call_tables
    def output(self, name: str, value: str | float) -> None:
        """Declare an output: an expression of coordinates, node positions, inputs and parameters.

        Raises
        ------
        SceneError, ExpressionError
            If the name is invalid or taken, or the expression is invalid.
        """
        # An output may share its name with a parameter; expressions then use the parameter.
        self._check_new("output", name, {**self.outputs, **self.inputs, **self.modes})
        self.outputs[name] = parse(value, f"output '{name}'")

    @may_call_tables
    def mode(self, name: str, initial: float | str, *, doc: str = "") -> None:
        """Declare a mode: a number that only events change.

        Parameters
        ----------
        name, doc : str
            Its name in expressions and results, and its meaning as text.
        initial : float or str
            Its initial value: a number or an expression of parameters.

        Raises
        ------
        SceneError, ExpressionError
            If the name is invalid or taken, or the value is invalid.
        """
        from cotree.scene.events import Mode

        self._check_new("mode", name, self._signals)
        text = check_text(doc, f"doc of mode '{name}'")
        self.modes[name] = Mode(name, parse(initial, f"mode '{name}'"), text)

    @may_call_tables
    def event(
        self,
        name: str,
        when: str,
        *,
        direction: int = 0,
        set: Mapping[str, float | str] | None = None,
        stop: bool = False,
        impact: Mapping[str, float | str] | None = None,
    ) -> None:
        """Declare an event that occurs when an expression crosses zero.

        Parameters
        ----------
        name, when : str
            Its name in results, and its event function: an expression of outputs and of all names
            that outputs may use.
        direction : int
            -1 for downward crossings, 1 for upward ones, 0 for both.
        set : mapping of str to float or str, optional
            New values of states and modes, as expressions of their previous values.
        stop : bool
            Whether the event ends the run.
        impact : mapping, optional
            ``{"restitution": e}``: an impulse changes the rate of ``when`` to -e times its previous
            value.

        Raises
        ------
        SceneError, ExpressionError
            If the name is invalid or taken, or a field is invalid.
        """
        from cotree.scene.events import make_event

        self._check_new("event", name, self.events)
        self.events[name] = make_event(name, when, direction, set or {}, stop, impact)

    def simulation(self, **settings: Any) -> None:
        """Set the defaults of runs: ``t_end``, ``rtol``, ``atol``, ``method``, ``start``...

        ``t_end`` is the end time, [s]. ``start`` is "initial values" or "operating point", the
        steady state of an electrical network: no current flows through capacitors, and inductors
        have no voltage. ``held`` maps nodes to the voltages that are prescribed while this point is
        computed. Method, tolerances, budgets and all other settings are described in
        :class:`cotree.Settings`.

        Raises
        ------
        SceneError, ExpressionError
            If a setting is unknown or its value is invalid.
        """
        self.defaults = with_settings(self.defaults, settings)

    def allow(self, *entries: str) -> None:
        """Allow findings of the linter, each stated as ``rule`` or ``rule:name``.

        Raises
        ------
        SceneError
            If an entry does not begin with the name of a rule.
        """
        self.allowed += tuple(e for e in check_allowed(entries) if e not in self.allowed)

    @property
    def _signals(self) -> dict[str, object]:
        return {**self.parameters, **self.inputs, **self.outputs, **self.modes}

    def _check_new(self, kind: str, name: str, taken: Mapping[str, object]) -> None:
        if check_name(kind, name) in taken:
            own: Mapping[str, object] = {}
            if kind in ("parameter", "input"):
                own = self.parameters if kind == "parameter" else self.inputs
            # If a loaded scene already declares the name, the user probably means to set its value.
            cure = f'; scene.set("{name}", ...) changes its value' if name in own else ""
            raise SceneError(
                f"the name of {kind} '{name}' is taken: every {kind} needs its own{cure}"
            )


#: Shapes that a visual may have.
_SHAPES = ("box", "cylinder", "capsule", "sphere", "mesh")

_VECTORS = ("size", "xyz", "rpy")
_LARGEST = 1e300  # largest scale factor or coordinate in drawings
_ZERO = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Visual:
    """A shape fixed to a node, for drawings only."""

    node: str  # node to which the shape is attached
    shape: str  # kind of shape: ``box``, ``cylinder``, ``capsule``, ``sphere`` or ``mesh``
    #: Box: lengths along x, y and z; cylinder and capsule: radius, radius, length; sphere: three
    #: times the radius, [m]; mesh: scale factors.
    size: tuple[float, float, float]
    file: str = ""  # name of the mesh file as written; only animations open the file
    #: Position in the node's axes, [m], and roll, pitch and yaw, [rad].
    xyz: tuple[float, float, float] = _ZERO
    rpy: tuple[float, float, float] = _ZERO


@dataclass(frozen=True)
class Origin:
    """Data from another tool's file that the edges of a scene do not contain.

    Attributes
    ----------
    file : str
        The path of the file.
    notes : tuple of str
        One sentence for each item that was not read or was renamed.
    names : mapping of (str, str) to str
        Names in the scene that differ from those in the file, by kind and name in the file.
    visuals : tuple of Visual
        Shapes of the bodies.
    """

    file: str
    notes: tuple[str, ...] = ()
    names: Mapping[tuple[str, str], str] = field(default_factory=dict)
    visuals: tuple[Visual, ...] = ()


def origin_table(origin: Origin) -> dict[str, Any]:
    """Return the table of an origin with ``file``, ``notes``, ``names`` and ``visuals``."""
    names: dict[str, dict[str, str]] = {}
    for (kind, old), new in origin.names.items():
        # TOML keys cannot be pairs, so each kind has a table that maps old names to new ones.
        names.setdefault(kind, {})[old] = new
    table: dict[str, Any] = {"file": origin.file, "notes": list(origin.notes), "names": names}
    visuals = [
        {key: value for key, value in vars(visual).items() if value not in ("", _ZERO)}
        for visual in origin.visuals
    ]
    return {key: value for key, value in table.items() if value} | {"visuals": visuals}


def read_origin(table: object, nodes: Collection[str]) -> Origin:
    """Return the origin that a table of a scene file describes, after checks."""
    # The table may be written by hand or come from an untrusted source.
    rows = _entries(table, Origin, "the origin")
    notes, names, visuals = rows.get("notes", []), rows.get("names", {}), rows.get("visuals", [])
    if not _is_list_of_texts(notes):
        raise SceneError("notes of the origin must be a list of texts")
    if not isinstance(names, dict) or not all(
        isinstance(row, dict) and _is_list_of_texts(list(row.values())) for row in names.values()
    ):
        raise SceneError("names of the origin must be a table for each kind: old name = 'new name'")
    if not isinstance(visuals, list):
        raise SceneError("visuals of the origin must be tables: [[origin.visuals]]")
    return Origin(
        _text(rows, "file", "the origin"),
        tuple(notes),
        {(kind, old): new for kind, row in names.items() for old, new in row.items()},
        tuple(_visual(row, i, nodes) for i, row in enumerate(visuals, 1)),
    )


def _visual(table: object, number: int, nodes: Collection[str]) -> Visual:
    where = f"visual {number} of the origin"
    rows = _entries(table, Visual, where)
    node, shape, file = (_text(rows, key, where) for key in ("node", "shape", "file"))
    check_known((node,), nodes, f"{where} is at the unknown node")
    check_known((shape,), _SHAPES, f"{where} has the unknown shape")
    size, xyz, rpy = (_three(rows.get(key, _ZERO), f"{key} of {where}") for key in _VECTORS)
    return Visual(node, shape, size, file, xyz, rpy)


def _entries(table: object, row: type, where: str) -> dict[str, Any]:
    if not isinstance(table, dict):
        raise SceneError(f"{where} must be a table")
    known = row.__dataclass_fields__  # type: ignore[attr-defined]
    check_known(table, known, f"{where} has no entry")
    return table


def _text(rows: Mapping[str, Any], key: str, where: str) -> str:
    value = rows.get(key, "")
    if not isinstance(value, str):
        raise SceneError(f"{key} of {where} must be a string")
    return value


def _three(value: object, where: str) -> tuple[float, float, float]:
    if not isinstance(value, (list, tuple)) or len(value) != 3 or not all(map(_is_number, value)):
        raise SceneError(f"{where} must be a list of three numbers")
    x, y, z = map(float, value)
    return x, y, z


def _is_number(value: object) -> bool:
    # Booleans are numbers in Python, but not valid coordinates.
    is_real = isinstance(value, (int, float)) and not isinstance(value, bool)
    return is_real and abs(value) <= _LARGEST  # type: ignore[arg-type]


def _is_list_of_texts(value: object) -> bool:
    return isinstance(value, list) and all(isinstance(item, str) for item in value)
