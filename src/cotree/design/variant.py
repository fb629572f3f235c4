"""A scene that also gives what goals ask for: expressions as outputs, integrals as states.

An integral is the voltage of a capacitor of one farad, which a source charges with the integrand;
so its derivatives come from the sensitivity graphs as those of all states do.
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
    """Give the scene of a model, or the scene itself, or load it."""
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
    """Compile a scene with what goals ask for.

    Parameters
    ----------
    source : cotree.Model or cotree.Scene
        Of a model its tree and its options are taken, too.
    scene : SceneDescription
        Its scene, which stays as it is.
    quantities : sequence of Quantity
        What is asked for.
    over : sequence of str
        Parameters, and states by their initial values, to take sensitivities to.

    Returns
    -------
    cotree.Model, and dict of Quantity to str
        The model, and the output or the event of each quantity.
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
        # People know their own texts, not the names of outputs that were made of them.
        told = str(error)
        for (_, text), name in outputs.items():
            told = told.replace(f"output '{name}'", f"'{text}' in a goal")
        for is_summed, text in outputs:
            # The source of an integral is a field of an edge, whose errors do not quote it.
            if is_summed and any(f"'{name}'" in told for name in parse(text, text).names):
                told = told.replace("a field uses", f"'{text}' in a goal uses")
        raise type(error)(told) from None


def _compiled(source: Any, changed: SceneDescription, over: Sequence[str]) -> Model:
    """Compile the scene as its model was compiled."""
    if isinstance(source, Model):
        recipe = source._recipe.of(changed, source.first_graph)
        return replace(recipe, sensitivities=tuple(over)).made()
    assert isinstance(changed, Scene)
    with without_warnings():  # of names that nothing depends on, which are refused later
        return changed.compile(list(over))


def _add(scene: SceneDescription, name: str, is_summed: bool, text: str) -> None:
    """Add an output, or an integral with one."""
    try:
        if not is_summed:
            scene.output(name, text)
            return
        if scene.defaults.start == OPERATING_POINT:
            raise ParameterError(
                f"integral({text}) needs a run from initial values, but this scene begins at its "
                "operating point, where a sum over time has no rest"
            )
        # A number in front may have any unit: integrands are no currents.
        own = f"1.0*({text})"
        scene.edge(f"{name}i", "current_source", "ground", f"{name}n", current=own)
        scene.edge(f"{name}c", "capacitor", f"{name}n", "ground", capacitance=1.0)
        scene.output(name, f"{name}c.v")
    except Error as error:
        raise type(error)(f"'{text}' in a goal: {error}") from None
