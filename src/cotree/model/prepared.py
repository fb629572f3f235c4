"""Kernels with the parameters that a thread prepared them for.

In: a program and its kernels. Out: kernels as functions of time, states, sensitivities and inputs,
for solvers without checks and copies. :mod:`cotree.model.model` builds what users call on them.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from cotree.errors import ParameterError
from cotree.model.arrays import Array, as_array, as_parameters
from cotree.model.packing import whole_kernel
from cotree.model.structure import Structure

if TYPE_CHECKING:
    from collections.abc import Mapping

    from cotree.model.kernels import Kernels, NativeModel
    from cotree.program import Program


#: A kernel as a function of time, states, flat sensitivities and inputs.
Call = Callable[[float, Array, Array, Array], Array]

_NONE: Array = np.zeros(0)


class _Own(threading.local):
    """Parameters that the kernels of the calling thread are prepared for."""

    prepared: Array | None = None


class PreparedKernels:
    """Kernels of a scene with their names, prepared for parameters by each thread that calls.

    Parameters
    ----------
    program : Program
        Names, patterns, and what the kernels compute.
    kernels : Kernels
        The kernels.

    Attributes
    ----------
    layout : Layout
        Names, units and patterns.
    states, parameters, inputs, outputs : tuple of str
        Their names.
    sensitivities : tuple of str
        Parameters and states with respect to which sensitivities are taken.
    structure : Structure
        Patterns of its derivatives.
    """

    def __init__(self, program: Program, kernels: Kernels) -> None:
        self._program = program
        self._kernels = kernels
        self._own = _Own()
        self._whole: dict[str, Call] = {}
        layout = self.layout = program.layout
        self._defaults = np.array(layout.parameter_values, dtype=float)
        self.structure = Structure(layout)
        self.states = tuple(row.name for row in layout.states)
        self.parameters = tuple(row.name for row in layout.parameters)
        self.inputs = tuple(row.name for row in layout.inputs)
        self.outputs = tuple(row.name for row in layout.outputs)
        self.sensitivities = layout.sensitivities
        self._place_of = {name: i for i, name in enumerate(self.parameters)}

    @property
    def default_parameters(self) -> Array:
        """The scene's parameter values, shape (n_parameters,)."""
        return self._defaults.copy()

    def parameter_array(self, values: Any = None, others: Any = None) -> Array:
        """Give the parameter array, as every call that takes parameters does.

        Parameters
        ----------
        values : mapping of str to float, or array_like of shape (n_parameters,), optional
            Values in place of the scene's by name, or all of them.
        others : array_like, shape (n_parameters,), optional
            Values in place of the scene's for those that are not named.

        Raises
        ------
        ParameterError
            If a name is not a tunable parameter, a value is not a finite number, or an array has
            the wrong shape.
        """
        known = self._defaults
        if others is not None:
            known = as_array(others, known.shape, "the parameters")
        if values is None:
            return known.copy()
        return as_parameters(values, self._place_of, known, self.layout.derived)

    def arguments_of(self, values: Mapping[str, float]) -> Array:
        """Give the parameters of a run as an array, of all its values by name.

        Those that follow from others are among the values, and are left out.
        """
        return self.parameter_array({name: values[name] for name in self._place_of})

    def bound(self, name: str, p: Array) -> Callable[[float, Array, Array, Array | None], Array]:
        """Give a kernel as a function of time, states, flat sensitivities and inputs.

        For solvers: no checks and no copies, the result is a buffer of the thread that calls. It
        stays valid until that thread calls the kernel again; the function prepares its own
        parameters when needed.
        """
        kernels, own, has_inputs = self._kernels, self._own, bool(self.inputs)
        # Looked up once here, since solvers call the function thousands of times.
        kernel = self._kernel(name)

        def call(t: float, x: Array, s: Array, u: Array | None) -> Array:
            # By identity: solvers hand over the same array at every call, and comparing values
            # would take as long as a small kernel.
            if own.prepared is not p:
                self.take(p)
            if u is None:
                u = kernels("inputs", t, _NONE, _NONE, _NONE) if has_inputs else _NONE
            return kernel(t, x, s, u)

        return call

    def native(self, p: Array) -> NativeModel | None:
        """Give the model as C sees it, at fixed parameters; None where there is no compiler."""
        self._prepare(p)
        return self._kernels.native()

    @property
    def backend(self) -> str:
        """The evaluator of the kernels: ``C`` or ``Python``."""
        return self._kernels.backend

    def address(self, name: str) -> int | None:
        """Give the address of a kernel in C; None where it is none."""
        return self._kernels.address(name)

    def bound_jacobian(
        self, p: Array, *, is_sparse: bool = False
    ) -> Callable[[float, Array, Array | None], Any]:
        """Give the Jacobian, full or by rows, as a function like those of :meth:`bound`."""
        kernel = self.bound("jacobian", p)
        place = self.structure.by_rows if is_sparse else self.structure.full
        return lambda t, x, u: place(kernel(t, x, _NONE, u))

    def check_parameters(self, p: Any) -> None:
        """Refuse parameters that the model's guards refuse.

        Raises
        ------
        ParameterError
            For the first guard that is violated.
        """
        self._prepare(p)

    def _call(self, name: str, t: float, x: Array, s: Array, u: Array) -> Array:
        return self._kernel(name)(t, x, s, u).copy()

    def _kernel(self, name: str) -> Call:
        """Give a kernel of full arrays, found once."""
        found = self._whole.get(name)
        if found is None:
            found = self._whole[name] = whole_kernel(self._kernels, self.layout, name)
        return found

    def _prepare(self, p: Any) -> None:
        """Prepare for parameters as users give them, unless they are those of the last call."""
        # Arrays that were prepared for are cotree's own, and nobody changes these.
        if p is None or self._own.prepared is not p:
            self.take(self.parameter_array(p))

    def take(self, p: Array) -> None:
        """Prepare for an array of parameters that nobody changes.

        Calls with the same array then look at nothing but its identity.

        Raises
        ------
        ParameterError
            If a value is not finite, or a guard of the model refuses it.
        """
        own = self._own
        # Bits are compared: 0.0 equals -0.0, and 1 / p tells them apart.
        if own.prepared is None or p.tobytes() != own.prepared.tobytes():
            # A dot product finds nan and infinity in one pass; squares may overflow, too.
            if not (math.isfinite(p.dot(p)) or np.isfinite(p).all()):
                name = self.parameters[int(np.flatnonzero(~np.isfinite(p))[0])]
                raise ParameterError(f"parameter '{name}' is not finite: give a finite number")
            # Where a guard refuses the values, nothing counts as prepared any more.
            own.prepared = None
            self._kernels.prepare(p)
        own.prepared = p
