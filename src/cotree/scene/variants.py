"""Scenes made from other scenes: with other inputs, with fixed parameters, or at rest.

An input whose expression contains states or outputs becomes an output of the same name, which
fields may use. At rest, capacitances are replaced by their current at constant voltage, which is
zero or the static current of a junction; inductances become short circuits.
"""

from __future__ import annotations

import copy
from collections.abc import Mapping
from dataclasses import replace
from functools import lru_cache
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

from cotree.arguments import check_names
from cotree.components import Component, Kind, Role, Terminal, integral_of
from cotree.components.law import ZERO
from cotree.errors import ParameterError, SceneError, brief, check_known, nearest
from cotree.scene.description import Edge, SceneDescription
from cotree.scene.expressions import Expression, parse
from cotree.scene.fields import parse_signal
from cotree.scene.parameters import sources
from cotree.scene.part import owner_of
from cotree.scene.part_adding import set_in_part
from cotree.scene.settings import Simulation

if TYPE_CHECKING:
    from collections.abc import Callable, Hashable, Sequence


_Scene = TypeVar("_Scene", bound=SceneDescription)


def with_inputs(
    scene: _Scene,
    inputs: Mapping[str, Any],
    parameters: Mapping[str, float] | None = None,
    kind: str = "output",
) -> _Scene:
    """Return the scene with other inputs; see :meth:`cotree.Scene.with_inputs`.

    ``kind`` is the word in messages for an input that becomes an output.
    """
    given = dict(parameters or {})
    changed = scene.copied()
    found: dict[str, Any] = {}
    check_known(inputs, scene.inputs, "the scene has no input", error=ParameterError)
    for name, value in inputs.items():
        if callable(value):
            raise ParameterError(
                f"input '{name}' is a Python function: give it to a run, simulate(inputs=...)"
            )
        found[name] = parse_signal(value, f"input '{name}'")
    used = {
        name for value in found.values() if isinstance(value, Expression) for name in value.names
    }
    for name, number in given.items():
        if name in scene.parameters:
            raise ParameterError(
                f"'{brief(name)}' is a parameter of the scene already: give its value to a run, "
                "simulate(parameters=...)"
            )
        check_known([name], used, "no input uses the parameter", error=ParameterError)
        changed.parameter(name, number)
    for name, value in found.items():
        if owner_of(changed, name) is not None:
            # The statement of the part is changed as well, so that it is saved with the scene.
            if isinstance(value, Expression):
                _check_names(value, changed)
            set_in_part(changed, name, inputs[name])
            continue
        if not isinstance(value, Expression) or _is_of_time(value, changed):
            changed.inputs[name] = replace(changed.inputs[name], value=value)
            continue
        _check_names(value, changed)
        del changed.inputs[name]
        changed.outputs[name] = replace(value, where=f"{kind} '{name}'")
    for name in found:
        _check_loop(name, changed)
    return changed


def expressions_among(inputs: Mapping[str, Any]) -> dict[str, str]:
    """Return the inputs that are expressions; numbers, also in quotes, are not."""
    found = {}
    for name, value in inputs.items():
        if isinstance(value, str):
            parsed = parse_signal(value, f"input '{name}'")
            if isinstance(parsed, Expression) and parsed.number is None:
                found[name] = value
    return found


def new_names(scene: SceneDescription, inputs: Mapping[str, str], known: Any) -> list[str]:
    """Return the names in expressions that ``known`` contains but the scene does not."""
    signals = [parse_signal(text, "input") for text in inputs.values()]
    used = {name for row in signals if isinstance(row, Expression) for name in row.names}
    return sorted(name for name in used if name in known and name not in scene.parameters)


class InputExpressions(NamedTuple):
    """Expressions that replace inputs of a scene in a run."""

    key: Hashable  # equal for equal expressions
    scene: Callable[[], SceneDescription]  # returns the scene with these expressions
    others: Mapping[str, Any]  # other inputs that the run replaces


def input_expressions(
    scene: SceneDescription, given: Any, parameters: Any
) -> InputExpressions | None:
    """Return the expressions among replaced inputs; None if there are none.

    Unknown names in them are new parameters, whose values are among ``parameters``.
    """
    expressions = expressions_among(given) if isinstance(given, Mapping) else {}
    if not expressions:
        return None
    known = parameters if isinstance(parameters, Mapping) else {}
    gains = new_names(scene, expressions, known)
    texts = {name: parse(text, "input").text.strip() for name, text in expressions.items()}
    values = {name: known[name] for name in gains}
    return InputExpressions(
        (frozenset(texts.items()), tuple(gains)),
        lambda: with_inputs(scene, expressions, values, "input"),
        {name: value for name, value in given.items() if name not in expressions},
    )


def _is_of_time(value: Expression, scene: SceneDescription) -> bool:
    return all(name in scene.parameters or name in ("t", "pi") for name in value.names)


def _check_names(value: Expression, scene: SceneDescription) -> None:
    known = {*scene.parameters, *scene.inputs, *scene.outputs, *scene.modes, "t", "pi"}
    for name in sorted(value.names):
        # Names with a dot are resolved later, as in fields.
        if "." not in name and name not in known:
            raise ParameterError(
                f"{value.where} uses the unknown name '{name}'{nearest(name, known)}; a new "
                "parameter, for example a gain, needs its value in parameters"
            )


def _check_loop(name: str, scene: SceneDescription) -> None:
    """Raise if an input depends on itself, directly or through outputs or other inputs."""
    if name not in scene.outputs:
        return
    waiting: list[tuple[str, tuple[str, ...]]] = [(name, (name,))]
    seen: set[str] = set()
    while waiting:
        at, path = waiting.pop()
        for other in sorted(scene.outputs[at].names & scene.outputs.keys()):
            if other in scene.parameters:  # parameters take precedence over outputs
                continue
            if other == name:
                way = " -> ".join(f"'{step}'" for step in (*path, name))
                raise ParameterError(
                    f"input '{name}' would depend on itself, {way}, which is an algebraic "
                    "loop: feed back states, or outputs that do not depend on this input"
                )
            if other not in seen:
                seen.add(other)
                waiting.append((other, (*path, other)))


def keep_tunable(scene: _Scene, tunable: Sequence[str], sensitivities: Sequence[str]) -> _Scene:
    """Return the scene with only the given parameters tunable."""
    wanted = check_names(tunable, "tunable")
    after = ", which is no parameter"
    check_known(wanted, scene.parameters, "tunable names", after, ParameterError)
    for name in wanted:
        row = scene.parameters[name]
        if isinstance(row.value, Expression):
            of = ", ".join(f"'{source}'" for source in sources(scene.parameters, name))
            raise ParameterError(
                f"tunable names '{name}', which is derived, {name} = {row.value.text}: name "
                f"{of or 'none'} instead"
            )
    # Parameters of sensitivities remain tunable: fixed numbers have no derivatives.
    kept = {*wanted, *sensitivities}
    # Only the table of parameters is replaced; the caller's scene is unchanged.
    changed = copy.copy(scene)
    changed.parameters = {
        name: row if name in kept or row.is_derived else replace(row, tunable=False)
        for name, row in scene.parameters.items()
    }
    return changed


_DOMAIN = "electrical"


def scene_at_rest(
    scene: SceneDescription, wanted: Sequence[str], jumps: Mapping[str, Expression]
) -> SceneDescription:
    """Return the scene of an operating point; outputs ``wanted_0``, ... are the given variables."""
    # This copy is shallow: only tables that differ at rest are replaced.
    at_rest = copy.copy(scene)
    at_rest.edges = {name: _edge_at_rest(edge) for name, edge in scene.edges.items()}
    at_rest.events, at_rest.defaults = {}, Simulation()
    for number, (node, voltage) in enumerate(scene.defaults.held):
        if node not in scene.nodes:
            raise SceneError(f"held of the simulation names the unknown node '{node}'")
        # The scene's method checks the statement and creates the edge, which is then renamed.
        source, own = "voltage_source", at_rest.edges
        at_rest.edges = {}
        at_rest.edge(f"held_{number}", source, node, "ground", voltage=voltage.text)
        own[f"held {number}"] = replace(  # no edge of a scene can have this name
            at_rest.edges[f"held_{number}"], name=f"held {number}"
        )
        at_rest.edges = own
    at_rest.outputs = {
        f"wanted_{i}": jumps.get(name) or parse(name, f"variable '{name}' at the operating point")
        for i, name in enumerate(wanted)
    }
    return at_rest


def _edge_at_rest(edge: Edge) -> Edge:
    component = edge.component
    is_electrical = component.role is Role.NETWORK and all(
        port.domain == _DOMAIN and integral_of(port) is None for port in component.ports
    )
    if not is_electrical:
        raise SceneError(
            f"edge '{edge.name}' of type '{component.name}' has no operating point: it is not "
            "part of an electrical network, or stores a quantity that does not come to rest; "
            "start from initial values instead"
        )
    # A port with both ends at one node is in no circuit equation; see below.
    short = frozenset(i for i, ends in enumerate(edge.ports) if ends.tail == ends.head)
    # Initial values of junctions are guesses for the solution, and are kept.
    guesses = {} if any(_is_storage(port) for port in component.ports) else dict(edge.initial)
    return replace(edge, component=_at_rest(component, short), initial=guesses)


@lru_cache(maxsize=1024)
def _at_rest(component: Component, short: frozenset[int]) -> Component:
    """Return a component at rest; ``short`` contains the ports with both ends at one node."""
    if not any(_is_storage(port) for port in component.ports):
        return component
    ports = (_terminal_at_rest(port, i in short) for i, port in enumerate(component.ports))
    # The conditions concern inductances and couplings, which have no effect at rest.
    return replace(component, ports=tuple(ports), demands=())


def _is_storage(port: Terminal) -> bool:
    return port.storage is not None or port.content is not None


def _terminal_at_rest(terminal: Terminal, is_short: bool) -> Terminal:
    terminal = replace(terminal, content=None)
    # At rest the current is constant, so no voltage is induced: a source of zero voltage.
    if terminal.kind is Kind.THROUGH_STORAGE:
        if is_short:  # the circulating current is undetermined, but any resistance would end it
            return replace(
                terminal, kind=Kind.THROUGH_SOURCE, storage=None, through=ZERO, across=None
            )
        return replace(terminal, kind=Kind.ACROSS_SOURCE, storage=None, through=None, across=ZERO)
    if terminal.kind is not Kind.ACROSS_STORAGE:
        return terminal
    # At rest the voltage is constant: only the static current remains, with all rates zero.
    static = terminal.through or ZERO
    rates = [name for name in static.arguments if name.startswith("across_rate_")]
    static = static.where(**dict.fromkeys(rates, 0.0)) if rates else static
    # If the current does not depend on the port's voltage, the port is a source.
    kind = Kind.DISSIPATOR if static.uses("across") else Kind.THROUGH_SOURCE
    return replace(terminal, kind=kind, storage=None, through=static)
