"""The start of a model: the values that its scene gives, or the operating point of its network.

The operating point is the solution of another scene, whose storages are at rest
(:mod:`cotree.scene.standstill`). It has no states: all that it needs is the search for algebraic
unknowns, with its limited junctions, conductances beside them and growing sources. Its sensitivity
graphs give the sensitivities of the start.

The linearisation of a model about a state is here, too.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from cotree.errors import Error, ParameterError, SingularSystemError
from cotree.model.arrays import as_array
from cotree.model.kernels import PythonKernels
from cotree.model.model import CompiledModel
from cotree.model.unknowns import solve_states
from cotree.scene.simulation import OPERATING_POINT
from cotree.scene.standstill import standing_scene
from cotree.sharing import formed_once

if TYPE_CHECKING:
    from cotree.formulation.first_graph import FirstGraph
    from cotree.model.kernels import Kernels
    from cotree.model.linearize import Linearization, Linearizer
    from cotree.program import Program
    from cotree.scene.description import SceneDescription

Array = npt.NDArray[np.float64]


class OperatingModel(CompiledModel):
    """A compiled model that knows its scene, and begins where the scene says.

    Attributes
    ----------
    first_graph : FirstGraph
        The first graph, from which its equations were formed.
    """

    def __init__(
        self, program: Program, kernels: Kernels, scene: SceneDescription, first: FirstGraph
    ) -> None:
        super().__init__(program, kernels)
        self._scene, self.first_graph = scene, first

    @property
    def begins_at_rest(self) -> bool:
        """Whether runs begin at the operating point."""
        return self._scene.defaults.start == OPERATING_POINT

    @formed_once
    def at_rest(self) -> CompiledModel:
        """The network at rest; its outputs are this model's states, but for contents."""
        from cotree.pipeline import formulate, generate

        given = [name for name in self.sensitivities if name in self._scene.parameters]
        wanted = list(self.states)
        for total, _ in self.layout.followers:  # which a start finds from what follows from it
            wanted[total] = "0"
        try:
            equations = formulate(standing_scene(self._scene, wanted), given, None)[1]
            program, _ = generate(equations)
        except Error as error:
            raise type(error)(f"the operating point: {error}") from None
        return CompiledModel(program, PythonKernels(program))  # a few evaluations

    def initial_values(self, t: float, p: Array, u: Any) -> tuple[Array, Array]:
        """Give initial states and sensitivities: those of the operating point, or the scene's."""
        y, s = super().initial_values(t, p, u)
        if not self.begins_at_rest or not self.states:
            return y, s
        rest = self.at_rest
        known = dict(zip(self.parameters, p.tolist(), strict=True))
        own = rest.parameter_array({name: known[name] for name in rest.parameters})
        inputs = None
        if u is not None:
            signals = dict(
                zip(self.inputs, as_array(u, (len(self.inputs),), "inputs"), strict=True)
            )
            inputs = np.array([signals[name] for name in rest.inputs])
        try:
            start = rest.start(t, own, u=inputs)
        except Error as error:
            raise type(error)(f"the operating point: {error}") from None
        y = rest.output_values(t, start.y, own, inputs)
        if rest.sensitivities:
            found = rest.output_sensitivity(t, start.y, start.s, own, inputs)
            s[:, [self.sensitivities.index(name) for name in rest.sensitivities]] = found
        return y, s

    def check_start(self) -> None:
        """Evaluate the model once at its initial state.

        Raises
        ------
        ParameterError
            If the scene's parameter values are refused.
        SingularSystemError
            If the mass matrix is singular there.
        """
        try:
            start = self.initial_state
        except ParameterError:
            if self.is_rheonomic:
                return  # it may start at another time
            raise
        rates = self.rhs(0.0, start)
        for name, rate in zip(self.states, rates, strict=True):
            if not math.isfinite(rate):
                why = self.why_undefined(0.0, start, self.default_parameters, None)
                where = f" ({why})" if why else ""
                raise SingularSystemError(
                    f"the rate of '{name}' is not finite at the initial state{where}: check its "
                    "initial value, and the inertia and the laws that act on it"
                )

    @formed_once
    def _linearizer(self) -> Linearizer:
        from cotree.model.linearize import Linearizer
        from cotree.pipeline import equations_of_deviations

        return Linearizer(*equations_of_deviations(self.first_graph))

    def linearize(
        self, t: float = 0.0, y: Any = None, p: Any = None, u: Any = None, *, reduced: bool = False
    ) -> Linearization:
        """Linearise about the motion through a state: z' = A z + B u, y = C z + D u.

        Parameters
        ----------
        t : float
            Time, [s].
        y : array_like, shape (n_states,), optional
            States, of which algebraic unknowns are guesses; the initial ones where absent.
        p, u : array_like, shapes (n_parameters,) and (n_inputs,), optional
            Parameters, which may be a mapping of names to values, and inputs; the scene's where
            absent.
        reduced : bool
            Whether to linearise in independent deviations, as many as there are degrees of freedom
            of position and of speed; a scene with constraints or quaternions needs them for its
            eigenvalues. Otherwise all states are taken, which constraints make dependent.

        Returns
        -------
        Linearization
            ``A``, ``B``, ``C``, ``D`` with names, ``basis`` and ``is_steady``. Deviations of the
            states that satisfy the constraints to first order go on doing so along the motion: with
            the constraints' gradient G and their basis N, G A N + G' N = 0, where G' is the rate
            of G along the motion. The reduced A includes this through ``basis``.

        Raises
        ------
        ParameterError
            If an array has the wrong shape.
        SingularSystemError
            If the mass matrix is singular there.
        """
        from cotree.model.linearize import Instant

        p = self.parameter_array(p)
        self.check_parameters(p)
        t, follows = float(t), u is None
        y = self.start(t, p).y if y is None else as_array(y, (len(self.states),), "the states")
        u = self.input_values(t, p) if u is None else as_array(u, (len(self.inputs),), "inputs")
        y = solve_states(self, t, p, u, y)
        return self._linearizer.about(self, Instant(t, y, p, u, follows), reduced=reduced)
