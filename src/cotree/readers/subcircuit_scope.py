"""Places of elements in a netlist: the circuit, or an instance of a subcircuit."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Protocol

from cotree.errors import SceneError, nearest
from cotree.readers.spice_lines import shown
from cotree.readers.spice_models import DeviceModel, read_model

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from cotree.readers.names import Namer
    from cotree.readers.spice_couplings import Coupled
    from cotree.readers.spice_lines import Line
    from cotree.readers.spice_netlist import Circuit
    from cotree.readers.spice_sources import Times
    from cotree.readers.spice_values import Scope, Value
    from cotree.scene.description import SceneDescription


class Sheet(Protocol):
    """Scene, with its names and settings, that elements are written to."""

    where: str
    names: Namer
    gmin: float
    times: Times
    uses_initial: bool
    voltages: dict[str, Value]

    @property
    def scene(self) -> SceneDescription:
        """The scene to which elements are added."""
        ...

    def error(self, line: int, message: str) -> SceneError:
        """Make an error with file and line."""
        ...

    def own_parameter(
        self, name: str, value: Value, line: int, unit: str = "", doc: str = ""
    ) -> Value:
        """Make a parameter of a number.

        Parameters
        ----------
        name : str
            The name wished for.
        value : float or str
            A number, or an expression, which stays as it is.
        line : int
            Line of the netlist, for messages.
        unit, doc : str
            Unit and meaning.
        """
        ...

    def node(self, path: str, name: str) -> str:
        """Give the node of a name in an instance."""
        ...


@dataclass
class Instance:
    """A circuit that is written out once, with the meaning of its names.

    Attributes
    ----------
    sheet : Sheet
        What it is written to.
    circuit : Circuit
        Its statements.
    scope : Scope
        Its parameters.
    path : str
        Names of the instances that it is in, each with a dot behind it.
    defined_in : Instance or None
        Instance in which names that are not found here are looked up.
    edges : dict of str to str
        Edges by names of elements in small letters.
    coupled : dict of str to Coupled
        Of inductors that share flux, by name in small letters: all that do.
    """

    sheet: Sheet
    circuit: Circuit
    scope: Scope
    path: str = ""
    defined_in: Instance | None = None
    edges: dict[str, str] = field(default_factory=dict)
    coupled: dict[str, Coupled] = field(default_factory=dict)
    taken: set[str] = field(default_factory=set)
    _models: dict[str, DeviceModel] = field(default_factory=dict)

    def at(self, line: Line) -> str:
        """Give file and line."""
        return f"{self.sheet.where}:{line.number}"

    def label(self, name: str) -> str:
        """Name something of this place for the scene."""
        return f"{self.path}{name}".replace(".", "_")

    def check_name(self, line: Line) -> None:
        """Refuse a second element of a name.

        Raises
        ------
        SceneError
            If there is one.
        """
        if line.key in self.taken:
            raise self.sheet.error(line.number, f"there is a second '{shown(line.words[0])}'")
        self.taken.add(line.key)

    def circuit_named(self, name: str, line: int) -> tuple[Circuit, Instance]:
        """Look up a subcircuit, and the place of its definition.

        Raises
        ------
        SceneError
            If there is none.
        """
        place: Instance | None = self
        while place is not None:
            found = place.circuit.circuits.get(name.lower())
            if found is not None:
                return found, place
            place = place.defined_in
        hint = nearest(name.lower(), self.circuit.circuits)
        raise self.sheet.error(line, f"there is no subcircuit '{shown(name)}'{hint}")

    def has_model(self, name: str) -> bool:
        """Say whether there is a model of a name."""
        place: Instance | None = self
        while place is not None:
            if name.lower() in place.circuit.models:
                return True
            place = place.defined_in
        return False

    def model(self, name: str, letter: str, line: Line) -> DeviceModel:
        """Look up the model of an element, here or in the circuits around.

        Parameters
        ----------
        name : str
            Name of the model.
        letter : str
            The letter of the elements that it must be for.
        line : Line
            The line that asks for it.

        Raises
        ------
        SceneError
            If there is none, or it is for other elements.
        """
        place: Instance | None = self
        while place is not None and name.lower() not in place.circuit.models:
            place = place.defined_in
        if place is None:
            raise SceneError(f"{self.at(line)}: there is no .model '{shown(name)}'")
        found = place._read(name.lower())
        if found.letter != letter:
            raise SceneError(
                f"{self.at(line)}: model '{shown(name)}' is not for elements {letter.upper()}"
            )
        return found

    def _read(self, name: str) -> DeviceModel:
        if name not in self._models:
            card = self.circuit.models[name]

            def own(parameter: str, word: str, unit: str, where: str) -> Value:
                value = self.scope.value(word, where)
                if not parameter or parameter == "level" or value == 0.0:
                    return value
                label = self.label(f"{card.name}_{parameter}")
                return self.sheet.own_parameter(label, value, card.line, unit)

            self._models[name] = read_model(card, f"{self.sheet.where}:{card.line}", own)
        return self._models[name]

    def node(self, word: str) -> str:
        """Give the node of a name."""
        return self.sheet.node(self.path, word)

    def inner_node(self, line: Line, name: str) -> str:
        """Make a node within an element."""
        return self.sheet.names.own(self.label(f"{line.words[0]}_{name}"))

    def add(
        self,
        name: str,
        type: str,
        nodes: Sequence[str],
        fields: Mapping[str, Any],
        initial: Mapping[str, Any] | None = None,
    ) -> str:
        """Add an edge to the scene, and give its name there.

        Parameters
        ----------
        name : str
            Name of the element in the netlist.
        type : str
            Component type.
        nodes : sequence of str
            Its nodes in the scene.
        fields, initial : mapping of str to value
            Fields and initial values.
        """
        edge = self.sheet.names.give("element", self.label(name))
        self.sheet.scene.edge(edge, type, *nodes, initial=initial, **fields)
        self.edges[name.lower()] = edge
        return edge

    def principal(self, line: Line, word: str, unit: str) -> Value:
        """Read the value of an element; a number becomes a parameter of the element's name.

        Parameters
        ----------
        line : Line
            The line of the element.
        word : str
            The value as it is written.
        unit : str
            Its unit.
        """
        value = self.scope.value(word, self.at(line))
        return self.sheet.own_parameter(self.label(line.words[0]), value, line.number, unit)
