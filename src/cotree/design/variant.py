"""A variant of a scene that has an output for each quantity in the goals.

Expressions become outputs and integrals become states: an integral is the voltage of a capacitor of
one farad, charged by a current source with the integrand as its current. Its sensitivities
therefore follow from the sensitivity graphs, like those of any other state.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

from cotree.api import Model, Scene
from cotree.design.goals import SUMMED
from cotree.errors import Error, ParameterError, nearest
from cotree.quiet import without_warnings
from cotree.scene.expressions import parse
from cotree.scene.simulation import OPERATING_POINT

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cotree.design.goals import Quantity
    from cotree.scene.description import SceneDescription


def scene_of(source: Any) -> SceneDescription:
    """Return the scene of a model, or the scene itself."""
    if isinstance(source, Model):
        return source._scene
    if not isinstance(source, Scene):
        raise ParameterError(
            f"optimise takes a scene or a compiled model, not {type(source).__name__}: "
            "cotree.load(...) gives a scene"
        )
    return source


def variant_of(
    source: Any, scene: SceneDescription, quantities: Sequence[Quantity], over: Sequence[str]
) -> tuple[Model, dict[Quantity, str]]:
    """Compile a scene with an output for each quantity.

    Parameters
    ----------
    source : cotree.Model or cotree.Scene
        The system; the variant of a model keeps its tree and its compiler options.
    scene : SceneDescription
        Its scene, which is not modified.
    quantities : sequence of Quantity
        Quantities in the goals.
    over : sequence of str
        Design variables, to which sensitivities are needed: parameters and, by the names of states,
        initial values.

    Returns
    -------
    cotree.Model, and dict of Quantity to str
        The variant, and the output or event that provides each quantity.
    """
    changed = scene.copied()
    taken = {*scene.edges, *scene.outputs, *scene.parameters, *scene.inputs, *scene.modes}
    prefix = "goal"
    while any(name.startswith(prefix) for name in (*taken, *scene.nodes)):
        prefix += "_"
    found: dict[Quantity, str] = {}
    outputs: dict[tuple[bool, str], str] = {}
    for quantity in quantities:
        if quantity.kind == "time":
            if quantity.text not in scene.events:
                raise ParameterError(
                    f"time({quantity.text}): the scene has no event '{quantity.text}'"
                    f"{nearest(quantity.text, scene.events)}"
                )
            found[quantity] = quantity.text
            continue
        key = (quantity.kind in SUMMED, quantity.text)
        if key not in outputs:
            outputs[key] = f"{prefix}{len(outputs)}"
            _add(changed, outputs[key], *key)
        found[quantity] = outputs[key]
    try:
        return _compiled(source, changed, over), found
    except Error as error:
        # Users know the expressions that they wrote, not the names of the outputs made from them.
        message = str(error)
        for (_, text), name in outputs.items():
            message = message.replace(f"output '{name}'", f"'{text}' in a goal")
        for is_summed, text in outputs:
            # The integrand is a field of an edge, and errors in fields do not quote the expression.
            if is_summed and any(f"'{name}'" in message for name in parse(text, text).names):
                message = message.replace("a field uses", f"'{text}' in a goal uses")
        raise type(error)(message) from None


def _compiled(source: Any, changed: SceneDescription, over: Sequence[str]) -> Model:
    """Compile the variant with the options of the given model, if it is one."""
    if isinstance(source, Model):
        recipe = source._recipe.of(changed, source.first_graph)
        return replace(recipe, sensitivities=tuple(over)).made()
    assert isinstance(changed, Scene)
    with without_warnings():  # names on which nothing depends are refused by the caller
        return changed.compile(list(over))


def _add(scene: SceneDescription, name: str, is_summed: bool, text: str) -> None:
    """Add an output for an expression, or for its integral."""
    try:
        if not is_summed:
            scene.output(name, text)
            return
        if scene.defaults.start == OPERATING_POINT:
            raise ParameterError(
                f"integral({text}) needs a run from initial values, but this scene starts at its "
                "operating point, where an integral over time has no steady value"
            )
        # The integrand is not a current; a numerical factor, which may have any unit, hides that.
        current = f"1.0*({text})"
        scene.edge(f"{name}i", "current_source", "ground", f"{name}n", current=current)
        scene.edge(f"{name}c", "capacitor", f"{name}n", "ground", capacitance=1.0)
        scene.output(name, f"{name}c.v")
    except Error as error:
        raise type(error)(f"'{text}' in a goal: {error}") from None
