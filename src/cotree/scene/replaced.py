"""Inputs of a scene replaced by expressions, tables or numbers.

In: a scene, and what is to stand in place of its inputs. Out: another scene. An input that becomes
an expression of time and parameters stays one. With states, outputs or measured variables in it, it
becomes an output of the same name: fields may name outputs, so that equations, Jacobian,
sensitivities, events and C projects know it as they know any expression of a scene.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any, TypeVar

from cotree.errors import ParameterError, brief, nearest
from cotree.scene.description import SceneDescription
from cotree.scene.expressions import Expression
from cotree.scene.part import owner_of
from cotree.scene.part_adding import set_in_part
from cotree.scene.tables import parse_signal

if TYPE_CHECKING:
    from collections.abc import Mapping

_Scene = TypeVar("_Scene", bound=SceneDescription)


def with_inputs(
    scene: _Scene,
    inputs: Mapping[str, Any],
    parameters: Mapping[str, float] | None = None,
    kind: str = "output",
) -> _Scene:
    """Return the scene with other inputs; see :meth:`cotree.Scene.with_inputs`.

    Parameters
    ----------
    scene : SceneDescription
        The scene, which stays as it is.
    inputs : mapping of str to number, str or (times, values)
        What stands in place of each input.
    parameters : mapping of str to float, optional
        Values of parameters that the expressions use and the scene does not have.
    kind : str
        The word by which messages name an input that becomes an output.

    Raises
    ------
    ParameterError
        If a name is unknown or of no use, or an input would depend on itself.
    ExpressionError, SceneError
        If a value is not accepted.
    """
    given = dict(parameters or {})
    changed = scene.copied()
    found: dict[str, Any] = {}
    for name, value in inputs.items():
        if name not in scene.inputs:
            raise ParameterError(f"the scene has no input '{name}'{nearest(name, scene.inputs)}")
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
        if name not in used:
            raise ParameterError(
                f"no input uses the parameter '{brief(name)}'{nearest(name, used)}"
            )
        changed.parameter(name, number)
    for name, value in found.items():
        if owner_of(changed, name) is not None:
            # The statement of the part says so, too, and is saved with the scene.
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
    """List the inputs that are given as expressions, and not as numbers in quotes."""
    found = {}
    for name, value in inputs.items():
        if isinstance(value, str):
            parsed = parse_signal(value, f"input '{name}'")
            if isinstance(parsed, Expression) and parsed.number is None:
                found[name] = value
    return found


def new_names(scene: SceneDescription, inputs: Mapping[str, str], known: Any) -> list[str]:
    """List the names in expressions that the scene does not have, but ``known`` does."""
    used = {name for text in inputs.values() for name in _names(text)}
    return sorted(name for name in used if name in known and name not in scene.parameters)


def _names(text: str) -> frozenset[str]:
    parsed = parse_signal(text, "input")
    return parsed.names if isinstance(parsed, Expression) else frozenset()


def _is_of_time(value: Expression, scene: SceneDescription) -> bool:
    return all(name in scene.parameters or name in ("t", "pi") for name in value.names)


def _check_names(value: Expression, scene: SceneDescription) -> None:
    """Refuse names without a dot that nothing in the scene has."""
    known = {*scene.parameters, *scene.inputs, *scene.outputs, *scene.modes, "t", "pi"}
    for name in sorted(value.names):
        # Names with a dot are looked up as those in fields are.
        if "." not in name and name not in known:
            raise ParameterError(
                f"{value.where} uses the unknown name '{name}'{nearest(name, known)}; a new "
                "parameter, a gain say, needs its value in parameters"
            )


def _check_loop(name: str, scene: SceneDescription) -> None:
    """Refuse an input that is made of itself, by way of outputs or other inputs."""
    if name not in scene.outputs:
        return
    waiting: list[tuple[str, tuple[str, ...]]] = [(name, (name,))]
    seen: set[str] = set()
    while waiting:
        at, path = waiting.pop()
        for other in sorted(scene.outputs[at].names & scene.outputs.keys()):
            if other in scene.parameters:  # which hide outputs of their name
                continue
            if other == name:
                way = " -> ".join(f"'{step}'" for step in (*path, name))
                raise ParameterError(
                    f"input '{name}' would depend on itself, {way}: an algebraic loop; feed back "
                    "states, or outputs that are made without this input"
                )
            if other not in seen:
                seen.add(other)
                waiting.append((other, (*path, other)))
