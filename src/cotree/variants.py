"""Models of one scene with expressions in place of its inputs, each compiled once."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from cotree.scene.expressions import parse
from cotree.scene.variants import new_names, with_inputs

if TYPE_CHECKING:
    from collections.abc import Callable

    from cotree.scene.description import SceneDescription

_Model = TypeVar("_Model")

# Texts that hold numbers, such as those of an optimiser, would be kept without end. What is dropped
# here is still in the cache on disk.
_MOST_KEPT = 32


class Variants(Generic[_Model]):
    """The models that runs with expressions as inputs take.

    Parameters
    ----------
    scene : SceneDescription
        The scene.
    compile : callable
        Compiles another scene as the scene was compiled.
    """

    def __init__(self, scene: SceneDescription, compile: Callable[[Any], _Model]) -> None:
        self._scene, self._compile = scene, compile
        self._made: OrderedDict[object, _Model] = OrderedDict()
        self._lock = threading.RLock()

    def of(self, expressions: Mapping[str, str], parameters: Any) -> _Model:
        """Give the model with expressions in place of inputs.

        Parameters
        ----------
        expressions : mapping of str to str
            By name of the input.
        parameters : object
            Those of the run: names that the scene does not have become parameters of the model.

        Raises
        ------
        ModelError, FormulationError
            If an expression is not accepted, or the equations cannot be formed with it.
        """
        known = parameters if isinstance(parameters, Mapping) else {}
        gains = new_names(self._scene, expressions, known)
        texts = tuple(
            sorted((name, parse(text, "input").text.strip()) for name, text in expressions.items())
        )
        key = texts, tuple(gains)
        with self._lock:
            if key not in self._made:
                values = {name: known[name] for name in gains}
                scene = with_inputs(self._scene, expressions, values, "input")
                self._made[key] = self._compile(scene)
                if len(self._made) > _MOST_KEPT:
                    self._made.popitem(last=False)
            self._made.move_to_end(key)
            return self._made[key]
