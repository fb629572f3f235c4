"""Choice of the parameters that may change after compiling; others become numbers in code."""

from __future__ import annotations

import copy
from dataclasses import replace
from typing import TYPE_CHECKING, TypeVar

from cotree.errors import ParameterError, nearest
from cotree.scene.description import SceneDescription
from cotree.scene.expressions import Expression
from cotree.scene.parameters import sources

if TYPE_CHECKING:
    from collections.abc import Sequence

_Scene = TypeVar("_Scene", bound=SceneDescription)


def listed_names(names: Sequence[str] | None, what: str) -> list[str]:
    """Accept one name, several, or none.

    Raises
    ------
    ParameterError
        If one is no text.
    """
    if isinstance(names, str):
        return [names]
    found = list(names or ())
    for name in found:
        if not isinstance(name, str):
            raise ParameterError(f"{what} holds {name!r}: give names of parameters or states")
    return found


def keep_tunable(
    scene: _Scene, tunable: Sequence[str] | None, sensitivities: Sequence[str]
) -> _Scene:
    """Return the scene with only the wanted parameters tunable.

    Parameters
    ----------
    scene : SceneDescription
        The scene, which stays as it is.
    tunable : sequence of str or None
        The parameters that a run may change. None leaves that to the scene.
    sensitivities : sequence of str
        Sensitivities are wanted to these; parameters among them stay as the scene has them.

    Raises
    ------
    ParameterError
        If a name is no parameter.
    """
    if tunable is None:
        return scene
    wanted = listed_names(tunable, "tunable")
    for name in wanted:
        if name not in scene.parameters:
            hint = nearest(name, scene.parameters)
            raise ParameterError(f"tunable names '{name}', which is no parameter{hint}")
        row = scene.parameters[name]
        if isinstance(row.value, Expression):
            of = ", ".join(f"'{source}'" for source in sources(scene.parameters, name))
            raise ParameterError(
                f"tunable names '{name}', which is derived, {name} = {row.value.text}: name "
                f"{of or 'none'} in its place"
            )
    # A parameter that is folded into the code as a number has no derivative.
    kept = {*wanted, *sensitivities}
    # The scene of the caller stays as it is: only the table of parameters is another one.
    changed = copy.copy(scene)
    changed.parameters = {
        name: row if name in kept or row.is_derived else replace(row, tunable=False)
        for name, row in scene.parameters.items()
    }
    return changed
