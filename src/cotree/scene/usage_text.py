"""Docstrings, calls, and the stub of component methods, which ``src/build_hook.py`` writes."""

from __future__ import annotations

import difflib
import textwrap
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from importlib import resources
from typing import Any

from cotree.components import COMPONENTS, OWN, Component, Field, Kind, Role, Shape, Terminal
from cotree.components.ports import HEAT, loss_of
from cotree.domains import DOMAINS
from cotree.errors import SceneError, brief
from cotree.scene.fields import initial_units
from cotree.scene.scalar_ports import acts_on_multibody

_WIDEST = 88  # maximum number of columns

_LONGEST = 40  # number of letters of a name that are compared, because names from files may be long

#: Synonyms of components, in the order of the components' table.
_ALSO_CALLED = {
    "rigid_body": ("body", "mass", "point_mass", "particle", "inertia"),
    "arm": ("link", "rod", "bar", "beam", "offset"),
    "weld": ("fixed", "rigid", "clamp"),
    "revolute": ("hinge", "pin", "pivot", "rotary", "rotation"),
    "prismatic": ("slider", "slide", "rail", "guide", "linear_joint"),
    "spherical": ("ball", "ball_joint", "ball_and_socket"),
    "universal": ("cardan", "hooke"),
    "free": ("floating", "six_dof"),
    "screw": ("helical", "lead_screw"),
    "rolling_disc": ("wheel", "rolling"),
    "contact": ("collision", "impact", "ground_contact", "bump"),
    "spring": ("spring_damper",),
    "damper": ("dashpot", "viscous"),
    "coupled_inductors": ("mutual_inductance",),
    "translational_mass": ("mass",),
    "translational_stop": ("limit", "limits", "end_stop", "hard_stop", "bumper"),
    "rotational_stop": ("limit", "limits", "end_stop", "hard_stop"),
    "rotational_inertia": ("inertia", "flywheel", "rotor"),
    "ideal_gear": ("gearbox",),
    "dc_motor": ("generator",),
    "voice_coil": ("linear_motor", "loudspeaker", "actuator"),
    "hydraulic_cylinder": ("actuator", "piston", "ram"),
    "voltage_source": ("battery", "supply"),
    "battery_cell": ("battery",),
    "bjt_npn": ("transistor", "npn"),
    "bjt_pnp": ("transistor", "pnp"),
    "mosfet_n": ("transistor", "nmos"),
    "mosfet_p": ("transistor", "pmos"),
    "ideal_op_amp": ("opamp", "op_amp", "amplifier"),
}


@dataclass(frozen=True)
class Entry:
    """Name, meaning and unit of one entry of an edge other than its listed nodes."""

    name: str
    doc: str
    takes: str  # kind of value: ``value``, ``constant``, ``vector``, ``nodes``, ``name``, ...
    unit: str = ""
    required: bool = False  # whether the field must be given
    default: float | None = None  # default value; None: the entry may be omitted


@dataclass(frozen=True)
class Usage:
    """Nodes and entries in the statement of an edge of a component type."""

    component: Component  # component type of the edge
    #: Names of the nodes in their order; empty if each port has separate nodes.
    nodes: tuple[str, ...]
    n_needed: int  # number of required nodes
    #: Whether a list of nodes contains one node per port, whose other node is the ground.
    has_ports: bool
    entries: tuple[Entry, ...]  # entries for ports and fields of the component
    initial: tuple[str, ...]  # variables whose initial values may be given


def usage_of(name: str) -> Usage:
    """Return the nodes and entries with which edges of a component type are stated."""
    component = COMPONENTS.get(name)
    if component is None:
        raise SceneError(f"there is no component '{brief(name)}'{proposed_types(name)}")
    nodes, n_needed, has_ports = _nodes(component)
    fields = [_entry(field) for field in component.fields]
    entries = (*_ports(component), *fields, *_heat(component))
    initial = tuple(initial_units(component))
    return Usage(component, nodes, n_needed, has_ports, entries, initial)


def proposed_types(name: object) -> str:
    """Return suggestions for an unknown component type, as the end of an error message."""
    word = str(name)[:_LONGEST].lower().replace("-", "_").strip()
    rows = COMPONENTS.items()
    # Synonyms come first, then names and descriptions with the word, then misspellings.
    found = [type for type, others in _ALSO_CALLED.items() if word in others]
    # Transposed letters may form another word, such as 'ram' for 'arm'.
    found += [type for type in COMPONENTS if sorted(type) == sorted(word)]
    found += [type for type, row in rows if word in type.split("_") or word in row.doc.split()]
    if not found:
        parts = {part for type in COMPONENTS for part in (type, *type.split("_"))}
        close = difflib.get_close_matches(word, sorted(parts), n=1, cutoff=0.6)
        found = [type for type in COMPONENTS if close and close[0] in (type, *type.split("_"))]
    if not found:
        return f"; known: {', '.join(COMPONENTS)}"
    return f"; did you mean {' or '.join(repr(other) for other in dict.fromkeys(found[:5]))}?"


def _nodes(component: Component) -> tuple[tuple[str, ...], int, bool]:
    """Return a type's nodes, the number of required ones, and whether each port has two nodes."""
    if any(field.shape is Shape.NAMES for field in component.fields):
        return (), 0, False  # fields contain the nodes
    if component.terminals:
        nodes = (*component.terminals, *component.optional_terminals)
        return nodes, len(component.terminals), False
    if component.geometry is None and len(component.ports) > 1:
        return (), 0, True
    if component.geometry is not None or not component.ports:
        return ("first", "second"), 2, False
    (port,) = component.ports
    ends = ("plus", "minus") if DOMAINS[port.domain].head_first else ("first", "second")
    return ends, 0 if acts_on_multibody(port) else 2, False


def _ports(component: Component) -> list[Entry]:
    """Return the entries for nodes of ports, and for the joint or line on which a port acts."""
    if component.terminals or component.geometry is not None:
        return []
    found = []
    if len(component.ports) > 1:
        found = [Entry(port.port, _port_doc(port), "nodes") for port in component.ports]
    acting = [port for port in component.ports if acts_on_multibody(port)]
    if acting:
        doc = "joint that it acts on in place of two nodes, or its coordinate: h or h.theta"
        found.append(Entry("joint", doc, "name"))
    # Prescribed velocities along a line are not supported.
    along = [port for port in acting if port.kind is not Kind.ACROSS_SOURCE]
    if any(port.domain == "translational" for port in along):
        doc = "two nodes of the multibody system; it acts along their line"
        found.append(Entry("line", doc, "nodes"))
    return found


def _port_doc(port: Terminal) -> str:
    row = DOMAINS[port.domain]
    ends = "plus, minus" if row.head_first else "first, second"
    return f"its nodes in the {port.domain} graph: {ends}"


def _heat(component: Component) -> list[Entry]:
    if component.role is not Role.NETWORK or loss_of(component) is None:
        return []
    return [Entry(HEAT, "thermal node that takes up its loss, or two", "node or nodes")]


def _entry(field: Field) -> Entry:
    takes = field.shape.value
    if field.shape is Shape.SCALAR:
        takes = "constant" if field.constant and not field.timed else "value"
    unit = "" if field.unit == "1" else field.unit
    return Entry(field.name, field.doc, takes, unit, field.required, field.default)


@lru_cache(maxsize=1)
def examples() -> Mapping[str, tuple[str, Mapping[str, Any]]]:
    """Return the name and statement of an edge for each component type, from its page's example."""
    file = resources.files("cotree") / "components" / "examples.toml"
    tables = tomllib.loads(file.read_text(encoding="utf-8"))
    # Each table contains one edge, by name.
    return {type: next(iter(edges.items())) for type, edges in tables.items()}


def edge_call(name: str, statement: Mapping[str, Any]) -> str:
    """Return the call of a component's method that adds an edge.

    >>> print(edge_call("R", {"type": "resistor", "nodes": ["a", "b"], "resistance": "R0"}))
    scene.resistor("R", "a", "b", resistance="R0")
    """
    rest = {key: value for key, value in statement.items() if key not in ("type", "nodes")}
    arguments = [_value(item) for item in (name, *statement.get("nodes", ()))]
    keywords = [f"{key}={_value(item)}" for key, item in rest.items()]
    call = f"scene.{statement['type']}"
    line = f"{call}({', '.join([*arguments, *keywords])})"
    if len(line) <= _WIDEST:
        return line
    arguments += [f"{key}={_in_rows(item)}" for key, item in rest.items()]
    return "\n".join([f"{call}(", *(f"    {argument}," for argument in arguments), ")"])


def _in_rows(value: object) -> str:
    """Return a table as text, on several lines if it is long."""
    line = _value(value)
    if not isinstance(value, Mapping) or len(line) <= _WIDEST - 20:
        return line
    rows = (f"        {_value(key)}: {_value(item)}," for key, item in value.items())
    return "\n".join(["{", *rows, "    }"])


def _value(value: object) -> str:
    # Code formatters use double quotes, unlike repr().
    if isinstance(value, str):
        return '"' + value.replace("\\", "\\\\").replace('"', '\\"') + '"'
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{_value(k)}: {_value(v)}" for k, v in value.items()) + "}"
    if isinstance(value, Sequence):
        return f"[{', '.join(map(_value, value))}]"
    return repr(value)


#: Kinds of values: their description, and their type in the stub.
_TAKES = {
    "value": ("float, str or table", "_Value"),
    "constant": ("float or str", "_Value"),
    "vector": ("three of float or str", "_Vector"),
    "expression": ("str", "_Scalar"),
    "names": ("list of str", "Sequence[str]"),
    "numbers": ("list of float", "Sequence[float] | npt.NDArray[Any]"),
    "rotation": ("three angles, or a matrix", "_Rotation"),
    "inertia": ("float, str, three of them, or a matrix", "_Inertia"),
    "nodes": ("pair of str", "_Nodes"),
    "name": ("str", "str"),
    "node or nodes": ("str or pair of str", "str | _Nodes"),
}


def takes_of(entry: Entry) -> str:
    """Return a description of the values that an entry accepts."""
    return _TAKES[entry.takes][0]


def default_of(entry: Entry) -> str:
    """Return the default of an entry as text: a number, ``required`` or ""."""
    if entry.required:
        return "required"
    return "" if entry.default is None else f"{entry.default:g}"


def docstring_of(usage: Usage) -> str:
    """Return the docstring of a component's method."""
    lines = [*_headline(usage), "", "Parameters", "----------"]
    lines += ["name : str", *_wrapped(_name_doc(usage))]
    if usage.nodes:
        lines += [f"{', '.join(usage.nodes)} : str", *_wrapped(_nodes_doc(usage))]
    if usage.has_ports:
        doc = "In place of the entries of its ports: one node of each, the other being the ground."
        lines += ["*nodes : str", *_wrapped(doc)]
    for entry in usage.entries:
        lines += [_entry_line(entry), *_wrapped(sentence(entry.doc))]
    if usage.initial:
        names = ", ".join(f"``{name}``" for name in usage.initial)
        lines += ["initial : mapping, optional", *_wrapped(f"Initial values of {names}.")]
    lines += _example(usage)
    return "\n".join(lines)


def sentence(text: str) -> str:
    """Return a text as a sentence, with a capital letter unless it begins with a name."""
    first = text.partition(" ")[0]
    is_word = first.replace(",", "").isalpha() and first.islower() and len(first) > 1
    return (text[0].upper() + text[1:] if is_word or len(first) == 1 else text) + "."


def _headline(usage: Usage) -> list[str]:
    name, doc = usage.component.name, usage.component.doc
    article = "an" if name[0] in "aeio" else "a"
    line = f"Add {article} ``{name}``: {doc}."
    if len(line) <= _WIDEST:
        return [line]
    return [f"Add {article} ``{name}``.", "", *textwrap.wrap(sentence(doc), _WIDEST)]


def _name_doc(usage: Usage) -> str:
    if not usage.initial:
        return "Name of the edge."
    return f"Name of the edge; its variables are called ``name.{usage.initial[0]}`` and so on."


def nodes_of(usage: Usage) -> str:
    """Return a description of the listed nodes in one line."""
    needed, rest = usage.nodes[: usage.n_needed], usage.nodes[usage.n_needed :]
    if usage.has_ports:
        return "those of its ports, below; or a list of one of each, the other being the ground"
    if not usage.nodes:
        return "none listed; its fields name them"
    if rest and not needed:
        return f"{', '.join(rest)}; none where it acts on {_places(usage)}"
    text = ", ".join(needed)
    return f"{text}, and {', '.join(rest)} if wanted" if rest else text


def _nodes_doc(usage: Usage) -> str:
    optional = usage.nodes[usage.n_needed :]
    if not optional:
        return "Its nodes."
    if usage.n_needed:
        return f"Its nodes; {' and '.join(optional)} may be left out."
    return f"Its nodes; none where it acts on {_places(usage)}."


def _places(usage: Usage) -> str:
    has_line = any(entry.name == "line" for entry in usage.entries)
    return "a joint or along a line" if has_line else "a joint"


def _entry_line(entry: Entry) -> str:
    unit = f", [{entry.unit}]" if entry.unit else ""
    default = default_of(entry)
    text = f", default {default}" if entry.default is not None else ""
    text = text if entry.required or text else ", optional"
    return f"{entry.name} : {takes_of(entry)}{unit}{text}"


def _wrapped(text: str) -> list[str]:
    indent = "    "
    return textwrap.wrap(text, _WIDEST, initial_indent=indent, subsequent_indent=indent)


def _example(usage: Usage) -> list[str]:
    found = examples().get(usage.component.name)
    if found is None:
        return []
    call = textwrap.indent(edge_call(*found), "    ")
    return ["", "Examples", "--------", "::", "", *call.splitlines()]


_HEAD = '''\
"""A method of scenes for each component that cotree comes with.

Generated from the table of components when the package is built or installed.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

_Scalar = float | str | np.floating[Any] | np.integer[Any]
_Table = Mapping[str, Any]  # over an expression, or a value with its unit
_Value = _Scalar | _Table
_Vector = Sequence[_Value] | npt.NDArray[Any] | _Table
_Rotation = _Vector | Sequence[Sequence[float]]
_Inertia = _Value | _Vector | Sequence[Sequence[_Value]]
_Nodes = tuple[str, str] | list[str]
_Initial = Mapping[str, _Value | _Rotation]

class ComponentMethod:
    """The method of one component, made when it is first used."""

    type: str
    def __init__(self, type: str) -> None: ...
    def __get__(self, scene: object, owner: object = None) -> Callable[..., None]: ...

class ComponentMethods:
    """Methods that add an edge of each component: ``scene.revolute("h", "D", "B", axis=...)``.

    Fields take numbers in SI, names of parameters, expressions in quotes, and values with a unit,
    ``{"value": 35, "unit": "mm"}``.
    """
'''


def stub_text() -> str:
    """Return the stub of the methods of all components."""
    return "\n".join([_HEAD, *map(_method, sorted(OWN))]).rstrip() + "\n"


def _method(name: str) -> str:
    usage = usage_of(name)
    rows = ["self", "name: str", *(f"{node}: str" for node in usage.nodes[: usage.n_needed])]
    rows += [f"{node}: str = ..." for node in usage.nodes[usage.n_needed :]]
    keywords = [_keyword(entry) for entry in usage.entries]
    if usage.initial:
        keywords.append("initial: _Initial | None = None")
    rows.append("/")
    if usage.has_ports:
        rows.append("*nodes: str")
    elif keywords:
        rows.append("*")
    arguments = [f"        {row}," for row in (*rows, *keywords)]
    body = textwrap.indent(f'"""{docstring_of(usage)}\n"""', 8 * " ")
    return "\n".join([f"    def {name}(", *arguments, "    ) -> None:", body, ""])


def _keyword(entry: Entry) -> str:
    kind = _TAKES[entry.takes][1]
    if entry.required:
        return f"{entry.name}: {kind}"
    if entry.default is None:
        return f"{entry.name}: {kind} | None = None"
    # Code formatters write exponents without a plus sign.
    return f"{entry.name}: {kind} = {entry.default!r}".replace("e+", "e")
