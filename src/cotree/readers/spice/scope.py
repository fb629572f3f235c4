"""The scene of a netlist, and its expanded main circuit and subcircuit instances."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from cotree.dag.nodes import Dag
from cotree.errors import ExpressionError, ParameterError, brief, nearest
from cotree.readers.names import Namer, SourceLine, located
from cotree.readers.spice.models import DeviceModel, read_model
from cotree.readers.spice.sources import Times
from cotree.readers.spice.values import scaled
from cotree.scene.description import SceneDescription
from cotree.scene.expressions import Expression, parse

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from cotree.dag.nodes import Node
    from cotree.readers.spice.netlist import Circuit, Line
    from cotree.readers.spice.values import Scope, Value

_Scene = TypeVar("_Scene", bound=SceneDescription)

_GMIN = 1e-12  # default of ngspice, [S]


class Sheet(Generic[_Scene]):
    """The scene of a netlist, with its names and settings."""

    def __init__(self, scene: _Scene, file: str) -> None:
        self.scene, self.file, self.times = scene, file, Times()
        self.uses_initial = False  # ``uic``: whether the run starts at given initial values
        self.gmin = _GMIN  # conductance parallel to each p-n junction, [S]
        # Two generators of names, because an element and a parameter may have the same name.
        self.names, self.parameter_names = Namer(), Namer()
        self.nodes: dict[tuple[str, str], str] = {}
        self.voltages: dict[str, Value] = {}  # voltages in ``.ic`` by node
        #: Nodes whose voltages are used, with name in the scene, name as written, and line.
        self.named: list[tuple[str, str, SourceLine]] = []
        self.shared: frozenset[str] = frozenset()  # nodes in ``.global``
        self._shorts: dict[str, str] = {}

    def own_parameter(self, name: str, value: Value, at: SourceLine, unit: str = "") -> Value:
        """Declare a parameter for a number, and return its name; return an expression unchanged."""
        if isinstance(value, str):
            return value
        own = self.parameter_names.give("parameter", name)
        with located(at):
            self.scene.parameter(own, value, unit=unit)
        return own

    def amount(self, value: Value) -> float | None:
        """Evaluate a value with the parameters of the scene; return None if it varies in a run."""

        def known(name: str) -> Node:
            if name not in self.scene.parameters:
                raise ExpressionError(f"'{name}' is not a parameter")
            held = self.scene.parameters[name].value
            return dag.constant(held) if isinstance(held, float) else held.lower(dag, known)

        dag = Dag()
        try:
            return parse(value, "a value").lower(dag, known).value
        except ExpressionError:
            return None

    def number(self, word: str, scope: Scope, at: SourceLine) -> float:
        """Return the number for a word, which may be an expression of netlist parameters."""
        value = scope.value(word, at)
        number = self.amount(value) if isinstance(value, str) else value
        if number is None or not math.isfinite(number):
            raise at.error(f"'{brief(word)}' must be a number, or an expression of parameters")
        return number

    def join(self, nodes: Sequence[str]) -> bool:
        """Record a short circuit of two nodes; return False if other shorts connect them."""
        first, second = map(self._joined, nodes)
        self._shorts[second] = first
        return first != second

    def _joined(self, node: str) -> str:
        while self._shorts.get(node, node) != node:
            node = self._shorts[node]
        return node

    def node(self, path: str, name: str) -> str:
        """Return the node in the scene for a name in the instance with the given path."""
        key = (path, name.lower())
        if name.lower() in ("0", "gnd"):
            return "ground"
        if key not in self.nodes and name.lower() in self.shared:
            path, key = "", ("", name.lower())
        if key not in self.nodes:
            self.nodes[key] = self.names.give("node", f"{path}{name}".replace(".", "_"))
        return self.nodes[key]


@dataclass
class Coupled:
    """A group of coupled inductors."""

    #: Inductor statements, by name in lower case, in the order of the netlist.
    inductors: dict[str, Line] = field(default_factory=dict)
    #: Coupling statements by pair of inductors, in the order of the netlist.
    couplings: dict[frozenset[str], Line] = field(default_factory=dict)

    @property
    def first(self) -> str:
        """The name of the first K statement, in lower case."""
        return next(iter(self.couplings.values())).key


@dataclass
class Instance:
    """The expanded main circuit, or an instance of a subcircuit."""

    sheet: Sheet[Any]  # scene to which elements are added, with its names
    circuit: Circuit  # statements of the circuit
    scope: Scope  # parameters and functions of the circuit
    path: str = ""  # names of the enclosing instances and this one, each followed by a dot
    #: Instance of the circuit that defines this one; undefined names are searched for there.
    defined_in: Instance | None = None
    count: Value = 1.0  # number of parallel copies (``m=``), which are merged to one
    #: Edges by element name in lower case.
    edges: dict[str, str] = field(default_factory=dict)
    #: Groups of coupled inductors by inductor name in lower case.
    coupled: dict[str, Coupled] = field(default_factory=dict)
    taken: set[str] = field(default_factory=set)
    _models: dict[str, DeviceModel] = field(default_factory=dict)

    def label(self, name: str) -> str:
        """Return the name in the scene for a name in this instance."""
        return f"{self.path}{name}".replace(".", "_")

    @property
    def gmin(self) -> Value:
        """The conductance parallel to a junction in all copies of the circuit, [S]."""
        return scaled(self.sheet.gmin, self.count) if self.sheet.gmin else 0.0

    def multiplied(self, kind: str, value: Value) -> Value:
        """Return the value of a source; currents are those of all copies of the circuit."""
        return scaled(value, self.count) if kind == "current" else value

    def multiplier(self, word: str, at: SourceLine) -> Value:
        """Return a number of parallel elements; raise an error unless it is positive."""
        value = self.scope.value(word, at)
        number = self.sheet.amount(value)
        if number is not None and not number > 0.0:
            raise at.error("m must be positive: it is the number of parallel elements")
        return value

    def check_name(self, line: Line) -> None:
        """Raise an error if another element has the same name; SPICE ignores case."""
        if line.key in self.taken:
            raise line.at.error(f"there is a second {line.name}")
        self.taken.add(line.key)

    def _around(self) -> Iterator[Instance]:
        """Yield this instance, then the enclosing ones from the innermost to the outermost."""
        place: Instance | None = self
        while place is not None:
            yield place
            place = place.defined_in

    def circuit_named(self, name: str, at: SourceLine) -> tuple[Circuit, Instance]:
        """Return a subcircuit by name, and the instance in which it is defined."""
        for place in self._around():
            found = place.circuit.circuits.get(name.lower())
            if found is not None:
                return found, place
        hint = nearest(name.lower(), self.circuit.circuits)
        raise at.error(f"there is no subcircuit '{brief(name)}'{hint}")

    def has_model(self, name: str) -> bool:
        """Return whether this or an enclosing circuit has a model called ``name``."""
        return any(name.lower() in place.circuit.models for place in self._around())

    def model(self, name: str, letter: str, line: Line) -> DeviceModel:
        """Return the model of an element, from this or an enclosing circuit."""
        key = name.lower()
        place = next((place for place in self._around() if key in place.circuit.models), None)
        if place is None:
            raise line.at.error(f"there is no .model '{brief(name)}'")
        # The model is read where it is defined, so that all its elements share its parameters.
        found = place._read(key)
        if found.letter != letter:
            raise line.at.error(f"model '{brief(name)}' is not for elements {letter.upper()}")
        return found

    def _read(self, name: str) -> DeviceModel:
        if name not in self._models:
            card = self.circuit.models[name]

            def own(parameter: str, word: str, unit: str) -> Value:
                value = self.scope.value(word, card.at)
                # A zero removes a term from the laws, so it does not become a parameter.
                if not parameter or parameter == "level" or value == 0.0:
                    return value
                label = self.label(f"{card.name}_{parameter}")
                return self.sheet.own_parameter(label, value, card.at, unit)

            self._models[name] = read_model(card, own)
        return self._models[name]

    def node(self, word: str) -> str:
        """Return the node in the scene for a name in this instance."""
        return self.sheet.node(self.path, word)

    def add(
        self,
        name: str,
        type: str,
        nodes: Sequence[str],
        fields: Mapping[str, Any],
        initial: Mapping[str, Any] | None = None,
    ) -> str:
        """Add an edge to the scene, and return its name in the scene."""
        # Unlike in a netlist, nodes and elements of a scene must have different names.
        edge = self.sheet.names.give("element", self.label(name))
        self.sheet.scene.edge(edge, type, *nodes, initial=initial, **fields)
        self.edges[name.lower()] = edge
        self._check_signs(edge)
        return edge

    def add_short(self, name: str, nodes: Sequence[str]) -> None:
        """Add a voltage source of 0 V between two nodes, unless other shorts connect them."""
        if self.sheet.join(nodes):
            self.add(name, "voltage_source", nodes, {"voltage": 0.0})

    def _check_signs(self, edge: str) -> None:
        """Raise an error for expressions whose sign the component does not allow."""
        own = self.sheet.scene.edges[edge]
        for name, value in own.fields.items():
            row = own.component.field(name)
            if row is None or not row.sign or not isinstance(value, Expression):
                continue
            found = self.sheet.amount(value.text)
            if found is None or found > 0.0:
                continue
            if {"nonnegative": found < 0.0, "nonzero": found == 0.0}.get(row.sign, True):
                wanted = {"nonnegative": "not be negative", "nonzero": "not be zero"}
                must = wanted.get(row.sign, "be positive")
                raise ParameterError(f"{name} of '{edge}' is {found:.6g}: it must {must}")

    def principal(self, line: Line, word: str, unit: str) -> Value:
        """Return the value of an element; a number becomes a parameter with the element's name."""
        value = self.scope.value(word, line.at)
        return self.sheet.own_parameter(self.label(line.words[0]), value, line.at, unit)
