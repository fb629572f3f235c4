"""The start of a model: the values that its scene gives, or the operating point of its network.

The operating point is the solution of another scene, whose storages are at rest
(:mod:`cotree.scene.variants`). It has no states: all that it needs is the search for algebraic
unknowns, with its limited junctions, conductances beside them and growing sources. Its sensitivity
graphs give the sensitivities of the start.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from cotree.errors import Error
from cotree.model.kernels import PythonKernels
from cotree.model.model import CompiledModel, Moment
from cotree.model.start import find_start
from cotree.sharing import locked_cached_property

if TYPE_CHECKING:
    from collections.abc import Callable

    from cotree.program import Program
    from cotree.scene.description import SceneDescription

Array = npt.NDArray[np.float64]


def program_at_rest(model: CompiledModel, scene: SceneDescription) -> Program:
    """Form the network of a model at rest, whose scene asks for its operating point.

    Raises
    ------
    ModelError, FormulationError
        If it cannot be formed.
    """
    from cotree.pipeline import formulate, generate
    from cotree.scene.jumps import jump_values
    from cotree.scene.variants import standing_scene

    # Sensitivities to initial values are the model's own: a scene at rest has none of these.
    given = [name for name in model.sensitivities if name in scene.parameters]
    wanted = list(model.states)
    for total, _ in model.layout.followers:  # which a start finds from what follows from it
        wanted[total] = "0"
    try:
        standing = standing_scene(scene, wanted, jump_values(scene))
        equations = formulate(standing, given, None)[1]
        return generate(equations)[0]
    except Error as error:
        raise type(error)(f"the operating point: {error}") from None


class OperatingPoint:
    """The operating point of a network, where a model begins.

    Parameters
    ----------
    model : CompiledModel
        The model.
    program : callable
        Gives the program of its network at rest.
    """

    def __init__(self, model: CompiledModel, program: Callable[[], Program]) -> None:
        self._model, self._program = model, program

    @locked_cached_property
    def program(self) -> Program:
        """The program of the network at rest."""
        return self._program()

    @locked_cached_property
    def at_rest(self) -> CompiledModel:
        """The network at rest, whose outputs are the model's states except for contents."""
        return CompiledModel(self.program, PythonKernels(self.program))  # a few evaluations

    def __call__(self, t: float, p: Array, u: Array | None, s: Array) -> tuple[Array, Array]:
        """Give the states at rest, and their sensitivities in place of those among s.

        Parameters
        ----------
        t : float
            When, [s].
        p, u : ndarray, shapes (n_parameters,) and (n_inputs,)
            Parameters, and inputs; None takes the scene's.
        s : ndarray, shape (n_states, n_sensitivities)
            Sensitivities of the scene's initial values, of which those to initial values stay.
        """
        model, rest = self._model, self.at_rest
        known = dict(zip(model.parameters, p.tolist(), strict=True))
        # Its parameters are some of the model's, whose values count.
        own = rest.parameter_array({name: known[name] for name in rest.parameters})
        inputs = None
        if u is not None:
            signals = dict(zip(model.inputs, u, strict=True))
            inputs = np.array([signals[name] for name in rest.inputs])
        try:
            start = find_start(Moment(rest, t, own, inputs), {})
        except Error as error:
            raise type(error)(f"the operating point: {error}") from None
        # Outputs of the scene at rest are the states of the model, in their order.
        y = rest.output_values(t, start.y, own, inputs)
        if rest.sensitivities:
            found = rest.output_sensitivity(t, start.y, start.s, own, inputs)
            s[:, [model.sensitivities.index(name) for name in rest.sensitivities]] = found
        return y, s
