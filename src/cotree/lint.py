"""The linter: rules about names, the graph and values, and their application to a scene."""

from __future__ import annotations

import difflib
import math
import os
import re
import warnings
from collections import defaultdict
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import chain
from typing import TYPE_CHECKING, Any

from cotree.components import Role
from cotree.components.terminal import Kind
from cotree.dag.nodes import Dag
from cotree.errors import Error
from cotree.files import read_text
from cotree.model.start import check_start
from cotree.scene.checks import (
    Dimensions,
    VariableUnits,
    dimension_of_unit,
    inertia_faults,
    single_name,
    stated_units,
    stated_values,
    tiny_masses,
)
from cotree.scene.description import Edge, SceneDescription, check_allowed, is_allowed
from cotree.scene.expressions import Expression, entries
from cotree.scene.parameters import in_order, parameter_values
from cotree.scene.part_adding import origin_note, origin_of, statement_lines
from cotree.scene.toml_file import LARGEST_FILE
from cotree.spec import BuildSpec
from cotree.units import Dimension, same_dimension, unit_text

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping, Sequence


@dataclass(frozen=True)
class Finding:
    """One suspicious finding in a scene.

    Attributes
    ----------
    rule : str
        The broken rule, a name in ``cotree.scene.description.RULES``.
    kind, name : str
        Kind and name of the element at fault; the kind is ``edge``, ``node``, ``parameter``,
        ``input``, ``output``, ``mode``, ``event`` or ``scene``.
    message : str
        A sentence with the fault and its remedy.
    severity : str
        ``error`` if the scene is invalid, otherwise ``warning``.
    line : int or None
        Line of the element in the scene file; None if there is no file.
    """

    rule: str
    kind: str
    name: str
    message: str
    severity: str = "warning"
    line: int | None = None

    @property
    def allow(self) -> str:
        """The entry of ``allow`` for this finding; empty for errors."""
        return "" if self.severity == "error" else f"{self.rule}:{self.name}"

    def __str__(self) -> str:
        where = "" if self.line is None else f"line {self.line}: "
        return f"{where}{self.severity} [{self.allow or self.rule}] {self.message}"

    def to_dict(self) -> dict[str, Any]:
        """Return the finding as a table for JSON."""
        return {**vars(self), "allow": self.allow}


_DIGITS = re.compile(r"\d+")
_MOST_COMPARED = 1000
_LIKE = 0.8  # minimum similarity of two names, from 0 to 1


def similar_name(name: str, others: Iterable[str]) -> str:
    """Return the one of ``others`` that ``name`` probably misspells, or "" if none is similar.

    Names in different parts, or that differ in digits only (``m1``, ``m2``), are not similar.
    """
    form, owner = _DIGITS.sub("#", name), name.rpartition(".")[0]
    alike = (other for other in others if other.rpartition(".")[0] == owner)
    choices = [o for o in sorted(alike)[:_MOST_COMPARED] if o != name]
    for other in choices:
        # The names differ in case or in a doubled letter only.
        if other.casefold() == name.casefold() or _without_doubles(other) == _without_doubles(name):
            return other
    choices = [other for other in choices if _DIGITS.sub("#", other) != form]
    close = difflib.get_close_matches(name, choices, n=1, cutoff=_LIKE)
    return close[0] if close else ""


def _without_doubles(name: str) -> str:
    return re.sub(r"([A-Za-z])\1+", r"\1", name)


_WORD = re.compile(r"[A-Za-z_]\w*(?:\.[A-Za-z_]\w*)*")
#: Minimum length of compared names. Shorter names are symbols, such as r and R or m and M.
_SHORTEST = 3


def name_findings(scene: SceneDescription) -> Iterator[Finding]:
    """Find unused parameters and inputs, and names that differ in case only."""
    used = used_names(scene)
    # A file of another tool may declare symbols that it does not use.
    own = scene.origin is None
    for kind, table in (("parameter", scene.parameters), ("input", scene.inputs)):
        for name in table:
            if own and name not in used:
                close = similar_name(name, used & {*scene.parameters, *scene.inputs})
                hint = f"; did you mean it instead of '{close}'?" if close else ""
                message = f"{kind} '{name}' is unused: remove it, or use it{hint}"
                yield Finding(f"unused-{kind}", kind, name, message)
    yield from _similar(scene)


def used_names(scene: SceneDescription) -> set[str]:
    """Collect the names in all expressions of a scene."""
    rows = [*scene.gravity, *scene.outputs.values(), *(m.initial for m in scene.modes.values())]
    rows += [held for _, held in scene.defaults.held]
    rows += [row for event in scene.events.values() for row in event.expressions]
    signals = [row.value for row in scene.inputs.values()]
    values_of = [*signals, *(row.value for row in scene.parameters.values())]
    rows += [value for value in values_of if isinstance(value, Expression)]
    found = {name for row in rows for name in row.names}
    found |= set(_gravities(scene, ""))
    for edge in scene.edges.values():
        values = chain(edge.fields.values(), edge.initial.values())
        found |= {name for value in values for entry in entries(value) for name in entry.names}
        # Components process names in these fields before they become expressions.
        fields = {k: v for k, v in edge.statement.items() if k not in ("type", "nodes")}
        found |= set(_words(fields))
    return found


def _gravities(scene: SceneDescription, prefix: str) -> Iterator[str]:
    """Yield the names in the gravity of parts, which the gravity of the outer scene replaces."""
    for member, part in scene.members.items():
        own = f"{prefix}{member}."
        for row in part.scene.gravity:
            yield from (f"{own}{name}" for name in row.names)
        yield from _gravities(part.scene, own)


def _words(value: Any) -> Iterator[str]:
    if isinstance(value, str):
        yield from _WORD.findall(value)
    elif isinstance(value, dict):
        for item in value.values():
            yield from _words(item)
    elif isinstance(value, (list, tuple)):
        for item in value:
            yield from _words(item)


def _similar(scene: SceneDescription) -> Iterator[Finding]:
    signals = [*scene.parameters, *scene.inputs, *scene.modes, *scene.outputs]
    domains = _domains(scene)
    groups: tuple[tuple[str, Iterable[str], int], ...] = (
        ("parameter", signals, _SHORTEST),
        ("edge", scene.edges, 2),
        ("node", scene.nodes, 1),
    )
    for kind, all_names, shortest in groups:
        seen: dict[str, str] = {}
        for name in dict.fromkeys(all_names):
            other = seen.setdefault(name.casefold(), name)
            if other != name and len(name) >= shortest:
                own = _kind(scene, name) if kind == "parameter" else kind
                # In textbooks a hydraulic node c may be next to a mechanical node C.
                if kind == "node" and not domains.get(name, set()) & domains.get(other, set()):
                    continue
                message = f"{own} '{name}' and '{other}' differ only in upper and lower case"
                yield Finding("similar-names", own, name, f"{message}: are they the same?")


def _kind(scene: SceneDescription, name: str) -> str:
    kinds = (("parameter", scene.parameters), ("input", scene.inputs), ("mode", scene.modes))
    return next((kind for kind, table in kinds if name in set(table)), "output")


def _domains(scene: SceneDescription) -> dict[str, set[str]]:
    found: dict[str, set[str]] = {}
    for edge in scene.edges.values():
        if edge.component.role is not Role.NETWORK:
            for node in edge.nodes:
                found.setdefault(node, set()).add("multibody")
        for port, ends in zip(edge.component.ports, edge.ports, strict=True):
            for node in (ends.tail, ends.head):
                found.setdefault(node, set()).add(port.domain)
            for node in ends.acts_on:
                found.setdefault(node, set()).add("multibody")
    return found


# Lower-case names of the ground in other tools.
_GROUNDS = frozenset({"gnd", "0", "gnd!", "earth", "ground"})


def topology_findings(scene: SceneDescription) -> Iterator[Finding]:
    """Find dangling nodes and shorted edges."""
    yield from dangling_nodes(scene)
    for node in scene.nodes:
        if node != "ground" and node.lower() in _GROUNDS:
            message = f"node '{node}' is an ordinary node: did you mean 'ground'?"
            yield Finding("similar-names", "node", node, message)
    for edge in scene.edges.values():
        if _is_shorted(edge):
            message = (
                f"both ends of edge '{edge.name}' are at node '{edge.nodes[0]}': it has no effect"
            )
            yield Finding("shorted", "edge", edge.name, message)


def dangling_nodes(scene: SceneDescription, is_refused: bool = False) -> Iterator[Finding]:
    """Find nodes that have only one edge and are used in no expression.

    Unconnected bodies and open terminals are findings only if the scene is invalid.
    """
    touching: dict[str, list[Edge]] = defaultdict(list)
    for edge in scene.edges.values():
        acts = {node for ends in edge.ports for node in ends.acts_on}
        for node in {*edge.nodes, *acts}:
            touching[node].append(edge)
    observed = {owner for name in used_names(scene) for owner in _owners(name)}
    # The outer scene connects the ports.
    observed |= set(scene.ports)
    observed |= {node for node, _ in scene.defaults.held}
    if scene.origin is not None:
        observed |= {visual.node for visual in scene.origin.visuals}
    for node in scene.nodes:
        edges = touching[node]
        if node == "ground" or len(edges) != 1 or node in observed:
            continue
        edge = edges[0]
        close = similar_name(node, set(scene.nodes))
        if scene.origin is not None and edge.component.role is not Role.NETWORK:
            continue  # links of robots may end in free nodes
        is_end = edge.component.role is Role.BODY  # bodies may move freely
        if is_end and edge.initial:
            continue  # the initial values show that the body moves freely
        # Sensing terminals and open ends are usual for a component with several nodes.
        is_open = edge.component.role is Role.NETWORK and len(edge.ports) > 1
        if not close and not is_refused and (is_end or is_open):
            continue
        hint = f"; did you mean '{close}'?" if close else ": connect it, or use it in an output"
        if close and len(touching[close]) == 1:  # either name may be misspelt
            other = touching[close][0].name
            hint = f", and '{close}' by edge '{other}' only: did you mean one node?"
        message = f"node '{node}' is connected to edge '{edge.name}' only{hint}"
        yield Finding("dangling-node", "node", node, message)


def _owners(name: str) -> Iterator[str]:
    """Yield the names of elements that a variable's name may begin with, the longest first."""
    while name := name.rpartition(".")[0]:
        yield name


def _is_shorted(edge: Edge) -> bool:
    if edge.component.role is not Role.NETWORK:
        return len(edge.nodes) == 2 and edge.nodes[0] == edge.nodes[1]
    # A transistor used as a diode has one shorted port, which is valid, so test all ports.
    return bool(edge.ports) and all(e.tail and e.tail == e.head for e in edge.ports)


_LONGEST_ARM = 1000.0  # largest plausible arm length, [m]
_LARGEST_ANGLE = 4.0 * math.pi  # largest plausible angle, [rad]; larger ones are probably degrees
_LARGEST_GRAVITY = 300.0  # largest plausible gravity, [m/s^2], about that of the sun
#: Largest plausible values in SI units. The limit of capacitors allows for batteries.
_LARGEST = {"capacitor": 1e4, "inductor": 1e4}


def value_findings(scene: SceneDescription) -> Iterator[Finding]:
    """Find inconsistent dimensions, unusual magnitudes, constants and values without effect."""
    try:
        known = parameter_values(scene.parameters)
    except Error:
        known = {}  # another rule reports invalid names
    yield from _dimensions(scene)
    yield from _shared(scene)
    yield from _magnitudes(scene, known)
    yield from _inertias(scene, known)
    yield from _constants(scene)
    yield from _without_effect(scene, known)


def _expressions(scene: SceneDescription) -> Iterator[tuple[str, str, str, str, Expression]]:
    """Yield each expression, after its owner's kind and name, a description and its unit."""
    for edge in scene.edges.values():
        for what, unit, value in stated_values(edge):
            yield "edge", edge.name, what, unit, value
    for name, row in scene.parameters.items():
        if isinstance(row.value, Expression):
            yield "parameter", name, f"parameter '{name}'", row.unit, row.value
    for name, signal in scene.inputs.items():
        if isinstance(signal.value, Expression):
            yield "input", name, f"input '{name}'", signal.unit, signal.value
    for name, output in scene.outputs.items():
        yield "output", name, f"output '{name}'", "", output
    for event in scene.events.values():
        yield "event", event.name, f"'when' of event '{event.name}'", "", event.when


class _Known:
    """A function that returns the dimension of a name in a scene, or None if it is unknown."""

    def __init__(self, scene: SceneDescription) -> None:
        # Time counts as dimensionless, since users write exp(-t) or 1 + t without a unit factor.
        self._scene, self._units = scene, {"t": "", **stated_units(scene)}
        self._pending: set[str] = set()
        self._variable_unit = VariableUnits(scene)
        self._derived: dict[str, Dimension | None] = {}
        with suppress(Error):  # another rule reports cycles
            for name in in_order(scene.parameters):
                value = scene.parameters[name].value
                if isinstance(value, Expression):
                    self._derived[name] = Dimensions(self).of(value.tree)

    def states_any(self, value: Expression) -> bool:
        """Return whether the scene states the unit of any name in an expression."""
        if any(self.states(name) for name in value.names):
            return True
        rows = (self._scene.parameters.get(name) for name in value.names)
        derived = [row.value for row in rows if row and isinstance(row.value, Expression)]
        return any(self.states(name) for inner in derived for name in inner.names)

    def states(self, name: str) -> bool:
        return bool(self._units.get(name))

    def __call__(self, name: str) -> Dimension | None:
        if name in self._units:
            return dimension_of_unit(self._units[name])
        scene = self._scene
        if name in scene.parameters:
            return self._derived.get(name)
        if name not in scene.outputs:
            return dimension_of_unit(self._variable_unit(name))
        if name in self._pending:
            return None
        self._pending.add(name)
        found = Dimensions(self).of(scene.outputs[name].tree)
        self._pending.remove(name)
        return found


def _dimensions(scene: SceneDescription) -> Iterator[Finding]:
    known = _Known(scene)
    for kind, name, what, unit, value in _expressions(scene):
        # If only one name occurs, forming the equations rejects a wrong dimension. If no name has a
        # stated unit, the user may have chosen another unit system.
        if known.states(single_name(value)) or not known.states_any(value):
            continue
        dimensions = Dimensions(known)
        found, stated = dimensions.of(value.tree), dimension_of_unit(unit)
        message = f"{what} is '{value.text}'"
        for fault in dimensions.faults:
            yield Finding("dimension", kind, name, f"{message}, where {fault}")
        is_table = type(value) is not Expression  # a table has no dimension
        if found is None or stated is None or dimensions.faults or is_table:
            continue
        if not same_dimension(found, stated):
            yield Finding(
                "dimension", kind, name, f"{message} in {unit_text(found)}, but is in {unit}"
            )


def _shared(scene: SceneDescription) -> Iterator[Finding]:
    """Find parameters without a unit that are used in fields of different dimensions."""
    uses: dict[str, dict[str, str]] = defaultdict(dict)
    for edge in scene.edges.values():
        for what, unit, value in stated_values(edge):
            row = scene.parameters.get(single_name(value))
            if row is not None and not row.unit and dimension_of_unit(unit) is not None:
                uses[row.name].setdefault(unit, what)
    for name, by_unit in uses.items():
        (first, what), *others = by_unit.items()
        dimension = dimension_of_unit(first)
        for unit, other in others:
            own = dimension_of_unit(unit)
            if dimension and own and not same_dimension(dimension, own):
                message = f"parameter '{name}' is {what}, in {first}, and {other}, in {unit}"
                yield Finding("dimension", "parameter", name, f"{message}: give each its own")
                break


def _number(value: Expression, known: dict[str, float]) -> float:
    """Evaluate an expression that depends on parameters only; return nan for others."""
    if value.number is not None:
        return value.number
    if not all(name in known or name == "pi" for name in value.names):
        return math.nan
    dag = Dag()
    try:
        found = value.lower(dag, lambda name: dag.constant(known[name])).value
    except Error:
        return math.nan
    return math.nan if found is None else found


def _magnitudes(scene: SceneDescription, known: dict[str, float]) -> Iterator[Finding]:
    gravity = math.hypot(*(_number(item, known) for item in scene.gravity))
    if gravity > _LARGEST_GRAVITY:
        message = f"gravity is {gravity:.4g} m/s^2: is its unit correct?"
        yield Finding("magnitude", "scene", scene.name, message)
    for edge in scene.edges.values():
        yield from _edge_magnitudes(edge, known)


def _edge_magnitudes(edge: Edge, known: dict[str, float]) -> Iterator[Finding]:
    for what, unit, value in stated_values(edge):
        size = abs(_number(value, known))
        is_initial = what.startswith("initial")
        message = ""
        if unit == "m" and edge.component.role is Role.ARM and size >= _LONGEST_ARM:
            message = 'm: if millimetres are meant, write unit = "mm"'
        elif unit == "rad" and size > _LARGEST_ANGLE and (is_initial or "rotation" in what):
            message = 'rad: if degrees are meant, write unit = "deg"'
        elif edge.component.name in _LARGEST and size > _LARGEST[edge.component.name]:
            message = f"{unit}: is a prefix missing?"
        if message:
            yield Finding("magnitude", "edge", edge.name, f"{what} is {size:.6g} {message}")
            return
    for row in edge.component.fields:
        given = edge.fields.get(row.name)
        if row.sign == "nonzero" and isinstance(given, Expression) and _number(given, known) < 0.0:
            message = (
                f"{row.name} of edge '{edge.name}' is {_number(given, known):.6g}: it "
                "supplies energy; is the sign correct?"
            )
            yield Finding("magnitude", "edge", edge.name, message)
            return


def _inertias(scene: SceneDescription, known: dict[str, float]) -> Iterator[Finding]:
    try:
        for name, message in (*inertia_faults(scene), *tiny_masses(scene)):
            yield Finding("inertia", "edge", name, message)
    except (Error, KeyError):  # KeyError: an unknown name
        return  # another rule reports the error
    for edge in scene.edges.values():
        if edge.component.role is not Role.BODY:
            continue
        given = [e for name in ("mass", "inertia") for e in entries(edge.fields.get(name))]
        if given and all(_number(entry, known) == 0.0 for entry in given):
            message = f"edge '{edge.name}' has neither mass nor inertia: it has no effect"
            yield Finding("inertia", "edge", edge.name, message)


def _constants(scene: SceneDescription) -> Iterator[Finding]:
    for kind, name, what, _, value in _expressions(scene):
        names = value.names - {"pi"}
        if not names or type(value) is not Expression:
            continue
        dag = Dag()
        places = {own: dag.symbol("x", i) for i, own in enumerate(sorted(names))}
        try:
            found = value.lower(dag, places.__getitem__).value
        except Error:
            continue  # another rule reports undefined values
        if found is not None:
            message = f"{what} is '{value.text}', which is {found:.6g} for any values of its names"
            yield Finding("constant", kind, name, message)


def _without_effect(scene: SceneDescription, known: dict[str, float]) -> Iterator[Finding]:
    for edge in scene.edges.values() if scene.origin is None else ():
        sources = edge.component.ports and all(
            port.kind is Kind.THROUGH_SOURCE for port in edge.component.ports
        )
        if not (sources or edge.component.role in (Role.FORCE, Role.TORQUE)):
            continue
        given = list(chain.from_iterable(entries(value) for value in edge.fields.values()))
        is_plain = all(entry.number is not None for entry in given)
        if given and is_plain and all(_number(entry, known) == 0.0 for entry in given):
            message = (
                f"edge '{edge.name}' of type '{edge.component.name}' has no effect: all "
                "its values are zero"
            )
            yield Finding("no-effect", "edge", edge.name, message)
    set_by_events = {name for event in scene.events.values() for name in event.set}
    for name, mode in scene.modes.items():
        if name not in set_by_events and not mode.is_jump:
            message = f"mode '{name}' is set by no event: it is constant, like a parameter"
            yield Finding("no-effect", "mode", name, message)


_LARGEST_STARTED = 60  # maximum number of edges of scenes that are compiled


def lint(
    scene: SceneDescription, allow: Sequence[str] = (), *, is_formed: bool = True
) -> tuple[Finding, ...]:
    """Return the findings of a scene, except those that ``allow`` or the scene permits.

    If ``is_formed``, the equations are formed, too, and errors are findings. Raises SceneError for
    an unknown rule in ``allow``.
    """
    allowed = (*scene.allowed, *check_allowed(list(allow)))
    found: list[Finding] = []
    # Nodes of a scene with open ports may float, so its equations cannot be formed.
    if is_formed and not scene.ports:
        found += _refused(scene)
    for findings in (name_findings, topology_findings, value_findings):
        found += findings(scene)
    found = list(_once_in_parts(scene, found))
    kept = [row for row in found if not is_allowed(row.rule, row.name, allowed)]
    for entry in dict.fromkeys(allowed):
        if not any(is_allowed(row.rule, row.name, (entry,)) for row in found):
            message = f"allow has '{entry}', but there is no such finding: remove it"
            kept.append(Finding("unused-allow", "scene", entry, message))
    return tuple(_with_lines(scene, kept))


def _once_in_parts(scene: SceneDescription, found: Iterable[Finding]) -> Iterable[Finding]:
    """Keep one of several equal findings in copies of a part; drop those that the part allows."""
    seen = set()
    for row in found:
        place = origin_of(row.name, scene.members)
        if place is None:
            yield row
            continue
        part, local = place
        key = (row.rule, row.kind, id(part.scene), local)
        if key not in seen and not is_allowed(row.rule, local, part.scene.allowed):
            seen.add(key)
            message = origin_note(f"'{row.name}'", scene.members, scene)
            yield replace(row, message=f"{row.message}{message}")


def dangling_hint(scene: SceneDescription) -> str:
    """Return the end of a message that suggests a misspelt node, or "" if there is none."""
    found = list(dangling_nodes(scene, is_refused=True))
    # Nodes with a similar name come first.
    found.sort(key=lambda row: "did you mean" not in row.message)
    return f"; {found[0].message}" if found else ""


def _refused(scene: SceneDescription) -> Iterable[Finding]:
    """Yield the error that prevents the equations or, in small scenes, the start."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            if len(scene.edges) <= _LARGEST_STARTED:
                model, _ = BuildSpec(scene.copied()).compile()
                if model.backend != "none":
                    check_start(model)
                return
            # Imported here, because every run lints, but without forming equations.
            from cotree.formulation.early import check_numbers, within_range
            from cotree.hybrid.jumps import lower_discontinuities
            from cotree.pipeline import formulate

            with within_range(scene):
                acting = lower_discontinuities(scene, has_sensitivities=False)
                formulate(acting, (), None, 0.0, check_numbers)
    except Error as error:
        message = f"{error}{dangling_hint(scene)}"
        yield Finding("refused", *_culprit(scene, message), message, "error")


def _culprit(scene: SceneDescription, message: str) -> tuple[str, str]:
    kinds: dict[str, Mapping[str, object]] = {
        "edge": scene.edges,
        "parameter": scene.parameters,
        "input": scene.inputs,
        "output": scene.outputs,
        "event": scene.events,
    }
    named = [(kind, name) for kind, row in kinds.items() for name in row]
    places = [(message.find(f"{kind} '{name}'"), kind, name) for kind, name in named]
    found = sorted(place for place in places if place[0] >= 0)
    return (found[0][1], found[0][2]) if found else ("scene", scene.name)


def _with_lines(scene: SceneDescription, found: Iterable[Finding]) -> Iterable[Finding]:
    lines: dict[tuple[str, str], int] = {}
    if scene.file.endswith(".toml") and os.path.isfile(scene.file):
        lines = statement_lines(read_text(scene.file, LARGEST_FILE))
    first: dict[str, str] = {}
    for edge in scene.edges.values():
        for node in edge.nodes:
            first.setdefault(node, edge.name)
    for row in found:
        # A node has no line; use the line of its first edge.
        key = ("edge", first.get(row.name, "")) if row.kind == "node" else (row.kind, row.name)
        yield replace(row, line=lines.get(key))
