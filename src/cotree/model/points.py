"""Methods of a model that concern a single point: linearisation and trimming."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from cotree.errors import ParameterError, nearest
from cotree.model.arrays import as_array
from cotree.model.bridges import rates_of
from cotree.model.friction_modes import check_friction
from cotree.model.linearize import Direction
from cotree.model.model import CompiledModel, Moment
from cotree.model.start import find_start
from cotree.model.unknowns import solve_states
from cotree.scene.expressions import check_number
from cotree.scene.given import check_mapping, check_names

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from cotree.model.arrays import Array
    from cotree.model.linearization import Linearization
    from cotree.model.linearize import Linearizer
    from cotree.model.trim import TrimPoint


class PointMethods(CompiledModel):
    """Linearisation about a point, and search for equilibria and steady motions."""

    @property
    def _linearizer(self) -> Linearizer:
        raise NotImplementedError

    def linearize(
        self,
        t: float = 0.0,
        y: Any = None,
        p: Any = None,
        u: Any = None,
        *,
        reduced: bool = False,
        sensitivities: Sequence[str] | str = (),
        total: bool = False,
    ) -> Linearization:
        """Linearise about the motion through a state: z' = A z + B u, y = C z + D u.

        Parameters
        ----------
        t : float
            Time, [s].
        y : array_like, shape (n_states,), optional
            States, with guesses for algebraic unknowns; by default the initial states.
        p, u : array_like, shapes (n_parameters,) and (n_inputs,), optional
            Parameters, which may be a mapping of names to values, and inputs; by default those of
            the scene.
        reduced : bool
            Whether to linearise in independent deviations, whose number is that of the degrees of
            freedom of position plus velocity. A scene with constraints or quaternions needs this
            for its eigenvalues. Otherwise all states are used, which constraints make dependent.
        sensitivities : sequence of str
            Parameters, inputs or states to differentiate A, B, C and D by; see
            :meth:`~cotree.model.linearization.Linearization.sensitivity`. The model need not be
            compiled with these.
        total : bool
            Whether derivatives include the dependence of the initial states on the parameters, for
            which the model must be compiled with these sensitivities; otherwise states are held
            fixed. The dependence of algebraic unknowns and of the scene's inputs is always
            included. ``model.trim().linearize`` differentiates along equilibria.

        Returns
        -------
        Linearization
            ``A``, ``B``, ``C``, ``D`` with names, ``basis`` and ``is_steady``. Deviations that
            satisfy the constraints to first order continue to do so along the motion:
            G A N + G' N = 0 with the Jacobian G of the constraints, the basis N of its null space,
            and the time derivative G' along the motion. The reduced A includes this term.

        Raises
        ------
        ParameterError
            If an array has the wrong shape, or a name is unknown.
        SingularSystemError
            If the mass matrix is singular there.
        SolveError
            If dry friction is not in its mode there: a start at rest has the mode 0 until a run
            begins, whether forces stay within their limits or not.
        """
        p = self.parameter_array(p)
        # Linearisations are evaluated from expression graphs, without the parameter checks of the
        # compiled kernels.
        self.check_parameters(p)
        u = None if u is None else as_array(u, (len(self.inputs),), "inputs")
        at = Moment(self, check_number(t, "t"), p, u)
        names = check_names(sensitivities, "sensitivities")
        moves = self._starts_along(at, names) if total and y is None else {}
        if total and y is not None:
            raise ParameterError(
                "total=True differentiates through the model's initial states, but y was given: "
                "omit it, or use model.trim(...).linearize(...), which follows equilibria"
            )
        y = find_start(at, {}).y if y is None else as_array(y, (len(self.states),), "the states")
        directions = {name: self._direction(at, name, moves.get(name)) for name in names}
        # The implicit function theorem requires that the algebraic equations are satisfied.
        y = solve_states(at, y)
        check_friction(at, y)
        return self._linearizer.about(at, y, reduced=reduced, directions=directions)

    def trim(
        self,
        solve: Sequence[str] | str = (),
        *,
        fixed: Mapping[str, float] | None = None,
        rates: Mapping[str, float | None] | None = None,
        outputs: Mapping[str, float] | None = None,
        guess: Mapping[str, float] | None = None,
        t: float = 0.0,
        p: Any = None,
        u: Any = None,
    ) -> TrimPoint:
        """Find an equilibrium or a steady motion by Newton's method with the exact Jacobian.

        All states are unknown, except those in ``fixed``. All rates are zero, except those in
        ``rates``. Constraints and algebraic equations are satisfied.

        Parameters
        ----------
        solve : sequence of str
            Inputs and parameters that are unknown in addition to the states, one for each
            prescribed state or output.
        fixed : mapping of str to float, optional
            Prescribed values of states, inputs and parameters, in SI. The rate of a coordinate
            whose speed is prescribed is that speed.
        rates : mapping of str to float or None, optional
            Nonzero rates of states, in SI; None leaves a rate free.
        outputs : mapping of str to float, optional
            Prescribed values of outputs, in SI.
        guess : mapping of str to float, optional
            Initial guesses; by default the model's initial states and the scene's values. If there
            are several equilibria, one near the guess is found.
        t : float
            Time, [s].
        p, u : array_like, shapes (n_parameters,) and (n_inputs,), optional
            Parameters, which may be a mapping of names to values, and inputs; by default those of
            the scene.

        Returns
        -------
        TrimPoint
            ``y``, ``p``, ``u`` and values by name, ``is_unique`` and ``undetermined``,
            ``linearize()``, and ``settings`` for :meth:`cotree.Model.simulate`.

        Raises
        ------
        ParameterError
            If a name is unknown, or arguments contradict each other.
        SolveError
            If no such point is found; the message names the equations that are not satisfied.

        Examples
        --------
        >>> import cotree
        >>> scene = cotree.Scene("pendulum", gravity=[0, -9.81, 0])
        >>> scene.input("M", 0.0, unit="N m")
        >>> scene.edge("j", "revolute", "ground", "A", axis=[0, 0, 1], torque="M")
        >>> scene.edge("rod", "arm", "A", "B", vector=[0, -2.0, 0])
        >>> scene.edge("bob", "rigid_body", "ground", "B", mass=1.0)
        >>> held = scene.compile().trim(["M"], fixed={"j.theta": 0.5})
        >>> round(held["M"], 6)
        9.406329
        """
        from cotree.model.trim import Conditions, find_trim

        p = self.parameter_array(p)
        u = None if u is None else as_array(u, (len(self.inputs),), "inputs")
        conditions = Conditions(
            check_names(solve, "solve"),
            check_mapping(fixed, "fixed"),
            check_mapping(rates, "rates"),
            check_mapping(outputs, "outputs"),
            check_mapping(guess, "guess"),
        )
        at = Moment(self, check_number(t, "t"), p, u)
        return find_trim(self, self._linearizer, at, conditions)

    def _starts_along(self, at: Moment, names: Sequence[str]) -> dict[str, Array]:
        """Return the sensitivities of the initial states by name."""
        for name in names:
            if name not in self.sensitivities:
                raise ParameterError(
                    f"total=True needs sensitivities of the initial states to '{name}': compile "
                    f"the model with sensitivities to it{nearest(name, self.sensitivities)}"
                )
        s = find_start(at, {}).s
        return {name: s[:, self.sensitivities.index(name)] for name in names}

    def _direction(self, at: Moment, name: str, dy: Array | None) -> Direction:
        """Return the direction of a parameter, an input or a state."""
        y, u, p = (np.zeros(len(row)) for row in (self.states, self.inputs, self.parameters))
        if name in self.parameters:
            p[self.parameters.index(name)] = 1.0
            if at.u is None:  # the scene's own inputs may depend on it
                u = self._linearizer.inputs_by_parameters(at, p)
        elif name in self.inputs:
            u[self.inputs.index(name)] = 1.0
        elif name in self.states:
            y[self.states.index(name)] = 1.0
        else:
            known = [*self.parameters, *self.inputs, *self.states]
            raise ParameterError(
                f"'{name}' is no tunable parameter, input or state of the model"
                f"{nearest(name, known)}"
            )
        return Direction(y if dy is None else dy, u, p)

    def as_casadi(self, t: float | None = None) -> Any:
        """Give the rates as an external function of CasADi, with their exact Jacobian.

        Parameters
        ----------
        t : float, optional
            Time at which rates are taken, [s]; needed where they depend on it.

        Returns
        -------
        casadi.Callback
            The function (x, u, p) -> dx of states, inputs, and those parameters that the model was
            compiled with sensitivities to. Keep it as long as what was made of it.

        Raises
        ------
        ParameterError
            If the model has algebraic unknowns or constraints, or needs a time; or if the package
            is missing.
        """
        from cotree.model.bridges import casadi_function

        return casadi_function(rates_of(self, t, "as_casadi"))

    def as_jax(self, t: float | None = None) -> Any:
        """Give the rates as a function of JAX, with their exact first derivatives.

        Parameters
        ----------
        t : float, optional
            Time at which rates are taken, [s]; needed where they depend on it.

        Returns
        -------
        callable
            The function (x, u, p) -> dx of states, inputs, and those parameters that the model was
            compiled with sensitivities to; the scene's where p is absent.

        Raises
        ------
        ParameterError
            If the model has algebraic unknowns or constraints, or needs a time; if the package is
            missing; or if JAX computes in single precision.
        """
        from cotree.model.bridges import jax_function

        return jax_function(rates_of(self, t, "as_jax"))
