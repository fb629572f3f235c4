"""Parts of a scene: other scenes within it, single or as an array.

A part expands to the declarations of its scene, whose names begin with the part's name, such as
``leg1.knee``; the outer scene stores them in its own tables (`PartRows`). In arrays, node names may
contain the index in braces, ``n{i - 1}``; expressions contain it directly: ``R0*(1 + 0.1*i)``.
"""

from __future__ import annotations

import ast
import re
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import product
from typing import TYPE_CHECKING, Any, TypeVar

from cotree.components import Shape
from cotree.components.ports import HEAT
from cotree.errors import ExpressionError, SceneError, brief
from cotree.naming import RESERVED
from cotree.scene.edge import Edge, make_edge
from cotree.scene.expressions import Expression, map_names, parse, shared_tree, table_scope
from cotree.scene.fields import Input, make_input, parse_signal
from cotree.scene.parameters import Parameter, make_parameter

_Quantity = TypeVar("_Quantity", Parameter, Input)

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from cotree.scene.description import Origin, SceneDescription
    from cotree.scene.events import Event
    from cotree.scene.tables import LookupTable


#: Keys of tables in fields whose values are words instead of expressions.
_WORDS = frozenset({"unit", "interpolation", "beyond"})
#: Totals of a whole scene, which are not available for parts.
_OF_SCENES = ("energy.kinetic", "energy.potential")


@dataclass(frozen=True)
class Renaming:
    """Replacement of names within a part by names of the outer scene."""

    prefix: str  # text before names of the part, with its dot: ``leg1.``
    nodes: Mapping[str, str]  # for each connected node of the part, the node of the outer scene
    scene: SceneDescription  # the part's scene

    def node(self, name: str) -> str:
        """Return the outer scene's name of a node."""
        return name if name == "ground" else self.nodes.get(name, f"{self.prefix}{name}")

    def name(self, name: str) -> str:
        """Return the outer scene's name for a name in expressions."""
        if name in RESERVED:
            return name
        if name in _OF_SCENES and "energy" not in self.scene.edges:
            raise SceneError(
                f"uses '{name}', a total of the outer scene, not of the part: declare it there"
            )
        owner = name.rpartition(".")[0]
        # A node may belong to an inner part, and names of variables may contain dots.
        while owner:
            if owner == "ground":
                return name
            if owner in self.nodes:
                if owner in self.scene.edges:
                    raise SceneError(
                        f"uses '{name}', but '{owner}' is both an edge and a connected node: "
                        "rename one of them"
                    )
                return f"{self.nodes[owner]}{name[len(owner) :]}"
            owner = owner.rpartition(".")[0]
        return f"{self.prefix}{name}"

    def text(self, text: str, where: str) -> str:
        """Return the text of an expression with names of the outer scene."""
        try:
            return ast.unparse(map_names(shared_tree(text), self.name))
        except SceneError as error:
            raise SceneError(f"{where} {error}") from None

    def expression(self, value: Expression, where: str) -> Expression:
        """Return an expression with names of the outer scene; ``where`` describes its owner."""
        try:
            return value.map_names(self.name, where)
        except SceneError as error:
            raise SceneError(f"{where} {error}") from None

    def field(self, value: Any, where: str) -> Any:
        """Return a field's stated value with names of the outer scene in its expressions."""
        if isinstance(value, str):
            return self.text(value, where)
        if isinstance(value, dict):
            return {k: v if k in _WORDS else self.field(v, where) for k, v in value.items()}
        return [self.field(item, where) for item in value] if isinstance(value, list) else value

    def table(self, table: LookupTable) -> LookupTable:
        """Return the table for the outer scene."""
        own = f"{self.prefix}{table.name}"
        values = tuple(self.expression(v, v.where) for v in table.values)
        return replace(table, name=own, values=values)

    def edge(self, edge: Edge) -> Edge:
        """Return the edge for the outer scene."""
        own = f"{self.prefix}{edge.name}"
        given = dict(edge.statement)
        type, nodes = given.pop("type"), given.pop("nodes", [])
        initial = given.pop("initial", None)
        names, joints = _node_fields(edge), _joint_fields(edge)
        fields: dict[str, Any] = {}
        for key, value in given.items():
            if key in joints and isinstance(value, str):
                fields[key] = f"{self.prefix}{value.strip()}"
            elif key in names and isinstance(value, str):
                fields[key] = self.node(value)
            elif key in names and isinstance(value, list):
                fields[key] = [self.node(item) if isinstance(item, str) else item for item in value]
            else:
                fields[key] = self.field(value, f"{key} of edge '{own}'")
        first = None if initial is None else self.field(initial, f"initial of edge '{own}'")
        return make_edge(own, type, [self.node(node) for node in nodes], first, fields)

    def event(self, event: Event) -> Event:
        """Return the event for the outer scene."""
        own = f"{self.prefix}{event.name}"
        whose, restitution = f"event '{own}'", event.restitution
        if restitution is not None:
            restitution = self.expression(restitution, f"restitution of {whose}")
        return replace(
            event,
            name=own,
            when=self.expression(event.when, f"when of {whose}"),
            set={
                self.name(key): self.expression(v, f"'{self.name(key)}' in set of {whose}")
                for key, v in event.set.items()
            },
            restitution=restitution,
        )

    def quantity(self, row: _Quantity, kind: str) -> _Quantity:
        """Return a parameter or an input for the outer scene."""
        own = f"{self.prefix}{row.name}"
        if isinstance(row.value, Expression):
            return replace(row, name=own, value=self.expression(row.value, f"{kind} '{own}'"))
        return replace(row, name=own)


def _node_fields(edge: Edge) -> set[str]:
    component = edge.component
    found = {row.name for row in component.fields if row.shape is Shape.NAMES}
    ports = [port.port for port in component.ports if port.port]
    if HEAT in ports or len(ports) > 1:
        found |= set(ports)
    # Components along the line between two nodes list these nodes in their field ``line``.
    if any(len(ends.acts_on) == 2 for ends in edge.ports):
        found.add("line")
    # Reactions name nodes in fields that the adapted component does not have.
    return found | {"reactants", "products"} if component.name == "reaction" else found


def _joint_fields(edge: Edge) -> set[str]:
    row = edge.component.field("joint")
    is_place = row is not None and row.shape is Shape.EXPRESSION
    sits = any(len(ends.acts_on) == 1 for ends in edge.ports)
    return {"joint"} if is_place or sits else set()


@dataclass
class PartRows:
    """Declarations that parts add to the outer scene, by table and name."""

    #: One mapping for each table of a scene.
    tables: dict[str, LookupTable] = field(default_factory=dict)
    parameters: dict[str, Parameter] = field(default_factory=dict)
    inputs: dict[str, Input] = field(default_factory=dict)
    modes: dict[str, Any] = field(default_factory=dict)
    edges: dict[str, Edge] = field(default_factory=dict)
    outputs: dict[str, Expression] = field(default_factory=dict)
    events: dict[str, Event] = field(default_factory=dict)

    def add(self, renaming: Renaming) -> None:
        """Add all declarations of a part, with its name as a prefix."""
        scene, prefix = renaming.scene, renaming.prefix
        for name, table in scene.tables.items():
            self.tables[f"{prefix}{name}"] = renaming.table(table)
        with table_scope(self.tables):
            self._add_stated(renaming)

    def _add_stated(self, renaming: Renaming) -> None:
        """Add all declarations except tables, which must exist when expressions call them."""
        scene, prefix = renaming.scene, renaming.prefix
        for name, row in scene.parameters.items():
            self.parameters[f"{prefix}{name}"] = renaming.quantity(row, "parameter")
        for name, signal in scene.inputs.items():
            self.inputs[f"{prefix}{name}"] = renaming.quantity(signal, "input")
        for name, mode in scene.modes.items():
            own = f"{prefix}{name}"
            initial = renaming.expression(mode.initial, f"mode '{own}'")
            self.modes[own] = replace(mode, name=own, initial=initial)
        for name, edge in scene.edges.items():
            self.edges[f"{prefix}{name}"] = renaming.edge(edge)
        for name, output in scene.outputs.items():
            own = f"{prefix}{name}"
            self.outputs[own] = renaming.expression(output, f"output '{own}'")
        for name, event in scene.events.items():
            self.events[f"{prefix}{name}"] = renaming.event(event)

    def bind_parameter(self, name: str, value: Any) -> None:
        """Set a parameter of a part to a number or an expression."""
        row = self.parameters[name]
        value, unit = _with_unit(value, row.unit, f"parameter '{name}'")
        # A parameter that depends on other parameters is tunable if these are.
        tunable = row.tunable or isinstance(value, str)
        made = make_parameter(name, value, unit, row.doc, tunable)
        _check_unit(made.unit, row.unit, f"parameter '{name}'")
        self.parameters[name] = made

    def bind_input(self, name: str, value: Any, scene: SceneDescription) -> None:
        """Set an input of a part; it becomes an output if its value depends on states."""
        row = self.inputs.get(name) or Input(name, parse(0.0, ""))
        value, unit = _with_unit(value, row.unit, f"input '{name}'")
        signal = parse_signal(value, f"input '{name}'")
        known = (scene.parameters, self.parameters, RESERVED)
        if isinstance(signal, Expression) and not all(
            any(used in names for names in known) for used in signal.names
        ):
            self.inputs.pop(name, None)
            self.outputs[name] = replace(signal, where=f"output '{name}'")
            return
        self.outputs.pop(name, None)
        self.inputs[name] = make_input(name, value, unit, row.doc)
        _check_unit(self.inputs[name].unit, row.unit, f"input '{name}'")


def _with_unit(value: Any, own: str, what: str) -> tuple[Any, str]:
    """Return value and unit from a table; a plain value has the SI unit of the part's parameter."""
    if not isinstance(value, dict):
        return value, own
    if "value" not in value or not set(value) <= {"value", "unit"}:
        raise SceneError(f"{what} is a table: give it 'value' and 'unit', no more")
    return value["value"], value.get("unit", own)


def _check_unit(unit: str, own: str, what: str) -> None:
    if own and unit != own:
        raise SceneError(
            f"{what} is in '{own}', to which the unit of its value cannot be converted"
        )


_BRACES = re.compile(r"\{([^{}]*)\}")


def in_name(text: str, index: Mapping[str, int], what: str) -> str:
    """Replace the expressions in braces in a name by their values, given the indices."""
    if "{" not in text:
        return text
    return _BRACES.sub(lambda match: str(_whole(match[1], index, what)), text)


def in_value(value: Any, index: Mapping[str, int], what: str) -> Any:
    """Substitute the indices in a value; a constant result becomes a number."""
    if not index:
        return value
    if isinstance(value, dict):
        return {k: v if k == "unit" else in_value(v, index, what) for k, v in value.items()}
    if not isinstance(value, str):
        return value
    text = in_name(value, index, what)
    given = parse(text, what)
    if not given.names & index.keys():
        return text
    # A value that depends only on indices is a number, which runs may change.
    if given.names <= {*index, "pi"}:
        return _number(text, index, what)
    trees = {name: ast.Constant(number) for name, number in index.items()}
    return given.map_names(lambda name: trees.get(name, name)).text


def _whole(text: str, index: Mapping[str, int], what: str) -> int:
    number = _number(text, index, what)
    if not number.is_integer() or not 0 <= number < 2**53:
        raise SceneError(
            f"{what}: '{{{brief(text)}}}' is {number:g}: give a whole number that is not negative"
        )
    return int(number)


def _number(text: str, index: Mapping[str, int], what: str) -> float:
    from cotree.dag.nodes import Dag, Node

    dag = Dag()

    def resolve(name: str) -> Node:
        if name not in index:
            known = ", ".join(index) if index else "none, since it is not an array"
            raise ExpressionError(f"uses '{brief(name)}', which is not an index; known: {known}")
        return dag.constant(float(index[name]))

    found = parse(text, what).lower(dag, resolve).value
    assert found is not None  # constants fold to numbers
    return float(found)


@dataclass(frozen=True, eq=False)
class Part:
    """A scene that is part of another scene.

    Attributes
    ----------
    name : str
        Its name; the parts of an array have names such as ``cell1``, ``cell2``, or ``cell1_1``.
    scene : SceneDescription
        Its scene, which must not be changed.
    counts : tuple of int
        Number of parts along each direction of an array; empty for a single part.
    index : tuple of str
        Names of the indices in bindings.
    nodes : mapping of str to str
        For each connected node of the part, the node of the outer scene.
    parameters, inputs : mapping of str to object
        Values of the part's parameters and inputs: numbers, or expressions of the outer scene.
    set : mapping of str to object
        Values of parameters and inputs of individual parts by their full names: ``cell3.R``.
    source : str
        The source of its scene: a path, or the name of a shipped part or of a scene in the file.
    """

    name: str
    scene: SceneDescription
    counts: tuple[int, ...] = ()
    index: tuple[str, ...] = ()
    nodes: Mapping[str, str] = field(default_factory=dict)
    parameters: Mapping[str, Any] = field(default_factory=dict)
    inputs: Mapping[str, Any] = field(default_factory=dict)
    set: Mapping[str, Any] = field(default_factory=dict)
    source: str = ""

    def __eq__(self, other: object) -> bool:
        # The source is not part of the content.
        return isinstance(other, Part) and all(
            getattr(self, name) == getattr(other, name)
            for name in self.__dataclass_fields__
            if name != "source"
        )

    __hash__ = None  # type: ignore[assignment]

    def members(self) -> Iterator[tuple[str, dict[str, int]]]:
        """Yield the elements of an array, each as its name and its index values."""
        if not self.counts:
            yield self.name, {}
            return
        for place in product(*(range(1, n + 1) for n in self.counts)):
            name = f"{self.name}{'_'.join(map(str, place))}"
            yield name, dict(zip(self.index, place, strict=True))

    def nodes_of(self, member: str) -> Mapping[str, str]:
        """Return, for each connected node of one part, the node of the outer scene."""
        return {**self.nodes, **self._own_nodes.get(member, {})} if self.set else self.nodes

    def is_node(self, name: str) -> bool:
        """Return whether a qualified name denotes a node that an individual part connects."""
        member, _, local = name.partition(".")
        return local in self._own_nodes.get(member, {})

    @cached_property
    def _own_nodes(self) -> dict[str, dict[str, str]]:
        """Return, for individual parts, the nodes that they connect differently from the array."""
        ports = self.scene.ports or self.node_names - {"ground"}
        found: dict[str, dict[str, str]] = {}
        for name, value in self.set.items():
            member, _, local = name.partition(".")
            is_other = local in self.scene.parameters or local in self.scene.inputs
            if local in ports and not is_other:
                found.setdefault(member, {})[local] = value
        return found

    @cached_property
    def node_names(self) -> frozenset[str]:
        """The names of the nodes in the part's scene."""
        return frozenset(self.scene.nodes)

    @property
    def shown(self) -> str:
        """The part in one line: its name, its scene and the number of parts."""
        number = " x ".join(map(str, self.counts))
        array = f"{number} parts " if number else ""
        pairs = ", ".join(f"{own} = {outer}" for own, outer in self.nodes.items())
        return f"{self.name:12} {array}{self.scene.headline}" + (f" ({pairs})" if pairs else "")


def origins_of(scene: SceneDescription) -> Iterator[Origin]:
    """Yield data from other tools' files on a scene and its parts, with the scene's node names."""
    if scene.origin is not None:
        yield scene.origin
    for part in scene.parts.values():
        # Most parts have no such data, so their array is not expanded.
        inner = list(origins_of(part.scene))
        for member, index in part.members() if inner else ():
            nodes = {own: in_name(n, index, n) for own, n in part.nodes_of(member).items()}
            for origin in inner:
                visuals = (
                    replace(row, node=nodes.get(row.node, f"{member}.{row.node}"))
                    for row in origin.visuals
                )
                yield replace(origin, visuals=tuple(visuals))


def owner_of(scene: SceneDescription, name: str) -> tuple[Part, str, str] | None:
    """Return the part that declares a name, the part's full name, and the name within the part."""
    member, dot, local = name.partition(".")
    part = scene.members.get(member) if dot else None
    return (part, member, local) if part is not None else None
