"""Conversion of SPICE netlists to scenes: elements become edges, and values become parameters."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

from cotree.errors import brief, check_known
from cotree.files import read_text
from cotree.readers.names import LARGEST_FILE, SourceLine, located, renaming_notes, scene_name
from cotree.readers.spice.devices import DEVICES, find_couplings, has_signals
from cotree.readers.spice.netlist import (
    Circuit,
    Line,
    Netlist,
    parse_netlist,
    settings,
    split_settings,
)
from cotree.readers.spice.scope import Instance, Sheet
from cotree.readers.spice.sources import Times
from cotree.readers.spice.values import ParameterRow, Scope, Value, ordered, scaled
from cotree.scene.description import Origin, SceneDescription

if TYPE_CHECKING:
    from collections.abc import Mapping


_Scene = TypeVar("_Scene", bound=SceneDescription)

_MOST_ELEMENTS, _DEEPEST = 100_000, 20
_ROOM_TEMPERATURE = 27.0  # default temperature of SPICE, [degC]


def read_spice_scene(source: str | Path, scene_type: type[_Scene]) -> _Scene:
    """Read a scene from the file of a netlist."""
    return read_spice_text(read_text(source, LARGEST_FILE), str(source), scene_type)


def read_spice_text(text: str, where: str, scene_type: type[_Scene]) -> _Scene:
    """Read a scene from the text of a netlist."""
    return Writer(scene_type, parse_netlist(text, where), where).write()


class Writer(Sheet[_Scene]):
    """Builder of the scene of a netlist."""

    def __init__(self, scene_type: type[_Scene], netlist: Netlist, file: str) -> None:
        super().__init__(scene_type(scene_name(Path(file).stem[:40], "netlist")), file)
        self.netlist = netlist
        self.shared = frozenset(netlist.shared)
        self.count = 0

    def write(self) -> _Scene:
        """Add all statements to the scene, and return it."""
        whole = self.netlist.circuit
        top = Scope(functions=whole.functions)
        # Values, waveforms and initial states depend on options, parameters and times.
        for line in self.netlist.options:
            self._option(line, top)
        own: dict[str, ParameterRow] = {}
        for row in whole.parameters:
            if row[0].lower() in own:
                raise row[2].error(f"parameter '{brief(row[0])}' is given twice")
            own[row[0].lower()] = row
        self._parameters(own, top, "", {})
        if self.netlist.transient is not None:
            self._transient(self.netlist.transient, top)
        for line in self.netlist.held:
            self._held(line, top)
        self._circuit(whole, Instance(self, whole, top), 0)
        # An element in the title line is a frequent mistake.
        if not self.scene.edges:
            raise whole.at.error("no elements: is the first line the title?")
        ends = {
            node
            for edge in self.scene.edges.values()
            for port in edge.ports
            for node in (port.tail, port.head)
        }
        for node, written, at in self.named:
            if node not in ends and node != "ground":
                raise at.error(f"'{brief(written)}' is not a node of the circuit")
        self._begin()
        changed = {**self.names.changed, **self.parameter_names.changed}
        notes = [*renaming_notes(changed), *top.remarks]
        if self.netlist.passed_over:
            passed_over = ", ".join(dict.fromkeys(self.netlist.passed_over))
            notes.insert(0, f"not read: {brief(passed_over, 200)}")
        self.scene.origin = Origin(self.file, tuple(notes), changed)
        return self.scene

    def _parameters(
        self,
        rows: Mapping[str, ParameterRow],
        scope: Scope,
        path: str,
        given: Mapping[str, tuple[Value, SourceLine]],
    ) -> None:
        for key in ordered(rows, given):
            name, word, at = rows[key]
            value, at = given[key] if key in given else (scope.value(word, at), at)
            # Underscores join the names of a path, because dots precede variables.
            label = f"{path}{name}".replace(".", "_")
            scope.values[key] = self.own_parameter(label, value, at)

    def _option(self, line: Line, scope: Scope) -> None:
        if line.key == ".temp":
            given = {"temp": line.words[1]} if len(line.words) == 2 else {}
            if not given:
                raise line.at.error(".temp needs one temperature")
        else:
            row = [i for i, word in enumerate(line.words) if word == "="]
            given = {}
            for i in row:
                # Word 0 is the name of the statement.
                if i < 2 or i + 1 >= len(line.words):
                    raise line.at.error("= must be between a name and a value")
                given[line.words[i - 1].lower()] = line.words[i + 1]
        for name, word in given.items():
            if name == "gmin":
                self.gmin = self.number(word, scope, line.at)
                if not self.gmin >= 0.0:
                    raise line.at.error("gmin must not be negative")
            elif name in ("temp", "tnom"):
                if self.number(word, scope, line.at) != _ROOM_TEMPERATURE:
                    raise line.at.error(
                        f"{name} must be 27: models are not scaled with temperature; give their "
                        "parameters at the temperature of the circuit"
                    )
            else:
                # Tolerances and methods of other simulators are ignored.
                self.netlist.passed_over.append(f".options {brief(name)}")

    def _transient(self, line: Line, scope: Scope) -> None:
        words = line.words[1:]
        if words and words[-1].lower() == "uic":
            self.uses_initial, words = True, words[:-1]
        if not 2 <= len(words) <= 4:
            raise line.at.error(".tran needs a step and an end time")
        step, stop, *_ = (self.number(word, scope, line.at) for word in words)
        if not (step > 0.0 and stop > 0.0):
            raise line.at.error("step and end time of .tran must be positive")
        self.times = Times(step, stop)
        self.scene.simulation(t_end=stop)

    def _held(self, line: Line, scope: Scope) -> None:
        words = line.words[1:]
        # Parentheses separate words, so ``v(node)=value`` consists of four words.
        for i in range(0, len(words), 4):
            four = words[i : i + 4]
            if len(four) < 4 or four[0].lower() != "v" or four[2] != "=":
                raise line.at.error(".ic is written as .ic v(node)=value")
            self.voltages[four[1].lower()] = scope.value(four[3], line.at)

    def _begin(self) -> None:
        known = {name: node for (path, name), node in self.nodes.items() if not path}
        at = self.netlist.held[0].at if self.netlist.held else self.netlist.circuit.at
        for name in self.voltages:
            if name not in known:
                raise at.error(f".ic names '{brief(name)}', which is not a node")
        # Without ``uic``, runs start at the operating point, with the voltages of ``.ic`` fixed.
        if self.uses_initial:
            return
        held = {known[name]: value for name, value in self.voltages.items()}
        with located(at):
            self.scene.simulation(start="operating point", held=held)

    def _circuit(self, circuit: Circuit, place: Instance, depth: int) -> None:
        for line in circuit.elements:
            self.count += 1
            if self.count > _MOST_ELEMENTS:
                raise line.at.error(f"more than {_MOST_ELEMENTS} elements")
            if line.key[0] == "x":
                self._instance(line, place, depth)
        rest = [line for line in circuit.elements if line.key[0] != "x"]
        # Coupled inductors are added by their K statement.
        find_couplings(place, rest)
        for line in sorted(rest, key=_turn):
            place.check_name(line)
            with located(line.at):
                DEVICES[line.key[0]](place, line)

    def _instance(self, line: Line, outer: Instance, depth: int) -> None:
        words, given = split_settings(line.words[1:])
        words = tuple(word for word in words if word.lower() != "params:")
        outer.check_name(line)
        # This limit also rejects a subcircuit that contains itself.
        if depth >= _DEEPEST:
            raise line.at.error(f"subcircuits are nested more than {_DEEPEST} levels deep")
        if not words:
            raise line.at.error(f"{brief(line.words[0])} needs nodes and a subcircuit")
        circuit, home = outer.circuit_named(words[-1], line.at)
        what = f"'{brief(circuit.name)}'"
        if len(words) - 1 != len(circuit.pins):
            raise line.at.error(
                f"{brief(line.words[0])} has {len(words) - 1} nodes, and subcircuit {what} "
                f"{len(circuit.pins)} pins"
            )
        values = settings(given, line.at)
        path = f"{outer.path}{line.words[0]}."
        for pin, node in zip(circuit.pins, words[:-1], strict=True):
            # A pin is connected to a node of the outer circuit.
            self.nodes[path, pin.lower()] = outer.node(node)
        # Names that the subcircuit does not define refer to the circuit in which it is defined.
        inner = Scope({}, home.scope, circuit.functions)
        place = Instance(self, circuit, inner, path, home, outer.count)
        # As in ngspice, the priority is: instance, ``.param`` in the subcircuit, defaults.
        rows = {name: (name, word, line.at) for name, word in circuit.defaults.items()}
        rows |= {row[0].lower(): row for row in circuit.parameters}
        # As in ngspice, ``m`` is an ordinary parameter if the subcircuit declares it.
        if "m" in values and "m" not in rows:
            place.count = scaled(place.count, outer.multiplier(values.pop("m"), line.at))
        check_known(values, rows, f"{line.at}: subcircuit {what} has no parameter")
        # Names in values of the instance refer to the outer circuit, all others to the subcircuit.
        seen = {name: (outer.scope.value(word, line.at), line.at) for name, word in values.items()}
        self._parameters(rows, inner, path, seen)
        self._circuit(circuit, place, depth + 1)


def _turn(line: Line) -> int:
    """Return a sort key with which each element is added after the elements that it names."""
    if line.key[0] == "k":
        return 2
    return 3 if line.key[0] in "fhbsw" or has_signals(line.text) else 1
