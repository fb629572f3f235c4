"""The compiled model: right-hand side, Jacobian, sensitivities and outputs as NumPy arrays."""

from __future__ import annotations

import hashlib
import threading
from collections.abc import Callable, Container, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from cotree.build import find_toolchain
from cotree.errors import BuildError, ParameterError, SingularSystemError
from cotree.model.arrays import (
    Array,
    Structure,
    are_finite,
    as_array,
    as_parameters,
    derived_values,
    in_order,
    is_many,
    one_point,
)
from cotree.program.kernels import KERNELS
from cotree.scene.expressions import check_number
from cotree.sharing import RecentCache, locked_cached_property
from cotree.version import VERSION

if TYPE_CHECKING:
    from scipy.sparse import csc_matrix

    from cotree.build import BuildOptions
    from cotree.dag.restart_times import RestartTimes
    from cotree.model.kernels import Kernels
    from cotree.model.roots import Junctions
    from cotree.model.start_in_c import StartInC
    from cotree.program.layout import Layout
    from cotree.program.program import Program
    from cotree.program.text import ModelText


#: A kernel as a function of time, states, flat sensitivities and inputs.
Call = Callable[[float, Array, Array, Array], Array]


def whole_kernel(kernels: Kernels, layout: Layout, name: str) -> Call:
    """Return a kernel as a function of full sensitivity arrays; its result may be a buffer."""
    n_all = len(layout.states) * len(layout.sensitivities)
    # Kernels without packed sensitivities are called directly.
    if not KERNELS[name].is_packed or len(layout.sensitivity_rows) == n_all:
        return lambda t, x, s, u: kernels(name, t, x, s, u)
    places = np.array(layout.sensitivity_places, dtype=np.intp)

    def call(t: float, x: Array, s: Array, u: Array) -> Array:
        packed = kernels(name, t, x, s[places], u)
        # Augmented kernels return the state rates, then the sensitivity rates.
        n_lead = len(packed) - len(places)
        whole = np.zeros(n_lead + n_all)
        whole[:n_lead] = packed[:n_lead]
        whole[n_lead + places] = packed[n_lead:]
        return whole

    return call


_NONE: Array = np.zeros(0)


class _Own(threading.local):
    """The parameters for which the kernels are prepared in the calling thread."""

    prepared: Array | None = None


class Rest(Protocol):
    """A function that computes the operating point at which runs of a model start."""

    @property
    def text(self) -> ModelText:
        """The program of the network at rest, and its C text."""
        ...

    def __call__(self, t: float, p: Array, u: Array | None, s: Array) -> tuple[Array, Array]:
        """Return the states at rest and their sensitivities; see ``OperatingPoint``."""
        ...


# Maximum number of run settings for which a model caches preparations.
_MOST_KEPT = 8


class CompiledModel:
    """The kernels of a scene, called with NumPy arrays.

    Every method takes parameters ``p`` and inputs ``u`` as arrays in the order of
    :attr:`parameters` and :attr:`inputs`; None selects the scene's values. ``p`` may also be a
    mapping that replaces the values of some parameters by name. Results are new arrays. Several
    threads may call the same model at the same time, each with different parameters.

    Parameters
    ----------
    text : ModelText
        The program of the model, and the C text from which the kernels were compiled.
    kernels : Kernels
        The compiled kernels.
    options : BuildOptions, optional
        The user's choices for the compiler.

    Attributes
    ----------
    traits : Traits
        Properties of the program that determine how kernels are called.
    cached : bool
        Whether the library was found in the cache.
    rest : callable or None
        Function that computes the operating point at which runs start; None if runs start at the
        scene's initial values.
    layout : Layout
        Names, units and patterns.
    states, parameters, inputs, outputs : tuple of str
        Names of the states, the tunable parameters, the inputs and the outputs.
    sensitivities : tuple of str
        Parameters and initial states with respect to which the model computes sensitivities.
    structure : Structure
        Sparsity patterns of the derivatives.
    code : Kernels
        The compiled kernels.
    kept : RecentCache
        Preparations of runs by their settings; see :mod:`cotree.solvers.prepare`.
    """

    def __init__(
        self, text: ModelText, kernels: Kernels, options: BuildOptions | None = None
    ) -> None:
        self.text, self.traits, self.options = text, text.traits, options
        self.cached = False
        self.rest: Rest | None = None
        self.code = kernels
        self._own = _Own()
        self._whole: dict[str, Call] = {}
        self.kept: RecentCache[Any] = RecentCache(_MOST_KEPT)
        layout = self.layout = text.layout
        self._defaults = np.array(layout.parameter_values, dtype=float)
        self.structure = Structure(layout)
        self.states = tuple(row.name for row in layout.states)
        self.parameters = tuple(row.name for row in layout.parameters)
        self.inputs = tuple(row.name for row in layout.inputs)
        self.outputs = tuple(row.name for row in layout.outputs)
        self.sensitivities = layout.sensitivities
        self._place_of = {name: i for i, name in enumerate(self.parameters)}

    @property
    def program(self) -> Program:
        """The program after its passes; kernel calls and runs do not need its nodes."""
        return self.text.program

    @property
    def default_parameters(self) -> Array:
        """The scene's parameter values, shape (n_parameters,)."""
        return self._defaults.copy()

    def parameter_array(self, values: Any = None, others: Any = None) -> Array:
        """Return a checked array of all parameters.

        Parameters
        ----------
        values : mapping of str to float, or array_like of shape (n_parameters,), optional
            Values by name, or an array of all values.
        others : array_like, shape (n_parameters,), optional
            Values of the parameters that are not in ``values``; by default the scene's.

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

    def derived(self, p: Any = None) -> dict[str, float]:
        """Return the values of the derived parameters by name.

        Parameters
        ----------
        p : array_like, shape (n_parameters,), or mapping of str to float, optional
            The parameters; by default the scene's values.

        Raises
        ------
        ParameterError
            If a name is unknown, or a value or the shape is invalid.
        """
        return derived_values(self.layout.derived, self.parameter_array(p))

    def arguments_of(self, values: Mapping[str, float]) -> Array:
        """Return the parameter array from a run's parameter values, which include derived ones."""
        return self.parameter_array({name: values[name] for name in self._place_of})

    def bound(self, name: str, p: Array) -> Callable[[float, Array, Array, Array | None], Array]:
        """Return a kernel as a function of time, states, flat sensitivities and inputs.

        For speed in solvers, the function neither checks nor copies. Its result is a buffer, valid
        until the calling thread calls the kernel again. If another call has changed the parameters,
        the kernels are prepared for p again.
        """
        kernels, own, has_inputs = self.code, self._own, bool(self.inputs)
        kernel = self._kernel(name)

        def call(t: float, x: Array, s: Array, u: Array | None) -> Array:
            # Arrays are compared by identity: comparing values takes as long as a small kernel.
            if own.prepared is not p:
                self.set_parameters(p)
            if u is None:
                u = kernels("inputs", t, _NONE, _NONE, _NONE) if has_inputs else _NONE
            return kernel(t, x, s, u)

        return call

    def prepared(self, p: Array) -> Array:
        """Return the values that the kernel ``prepare`` computes from p, in a new array."""
        self._prepare(p)
        return self.code.prepared()

    @property
    def can_extend(self) -> bool:
        """Whether the library can compute rates of the algebraic unknowns."""
        return self.traits.can_extend(self.layout)

    @property
    def backend(self) -> str:
        """The backend of the kernels: ``C``, or ``none`` without a compiler."""
        return self.code.backend

    @property
    def compiler(self) -> str:
        """Name and version of the compiler, or a text that begins with "none"."""
        if self.backend != "C":
            return "none: nothing is evaluated"
        try:
            found = find_toolchain()
        except BuildError:
            found = None  # the environment now selects another compiler
        return found.version if found else "C"

    def address(self, name: str) -> int | None:
        """Return the address of a C kernel, or None if the library has no such kernel."""
        return self.code.address(name)

    def bound_jacobian(
        self, p: Array, *, is_sparse: bool = False
    ) -> Callable[[float, Array, Array | None], Any]:
        """Return a function of time, states and inputs that returns the Jacobian.

        The Jacobian is a full array or a CSR matrix; see also :meth:`bound`.
        """
        kernel = self.bound("jacobian", p)
        place = self.structure.by_rows if is_sparse else self.structure.full
        return lambda t, x, u: place(kernel(t, x, _NONE, u))

    def check_parameters(self, p: Any) -> None:
        """Raise ParameterError if a guard of the model rejects the parameters."""
        self._prepare(p)

    def _call(self, name: str, t: float, x: Array, s: Array, u: Array) -> Array:
        return self._kernel(name)(t, x, s, u).copy()

    def _kernel(self, name: str) -> Call:
        """Return a kernel as a function of full sensitivity arrays, cached by name."""
        found = self._whole.get(name)
        if found is None:
            found = self._whole[name] = whole_kernel(self.code, self.layout, name)
        return found

    def _prepare(self, p: Any) -> None:
        """Prepare the kernels for parameters in any form, unless they are unchanged."""
        # Prepared arrays belong to cotree and are never changed in place.
        if p is None or self._own.prepared is not p:
            self.set_parameters(self.parameter_array(p))

    def set_parameters(self, p: Array) -> None:
        """Prepare the kernels for a parameter array, which must never be changed in place.

        Later calls compare arrays by identity. Raise ParameterError if a value is not finite or a
        guard of the model rejects it.
        """
        own = self._own
        # Bits are compared, because 0.0 equals -0.0 although 1 / p differs.
        if own.prepared is None or p.tobytes() != own.prepared.tobytes():
            if not are_finite(p):
                name = self.parameters[int(np.flatnonzero(~np.isfinite(p))[0])]
                raise ParameterError(f"parameter '{name}' is not finite: give a finite number")
            # If a guard rejects the values, the kernels remain unprepared.
            own.prepared = None
            self.code.prepare(p)
        own.prepared = p

    @property
    def digest(self) -> str:
        """Hash of C text, names and default values; equal hashes imply equal results."""
        from cotree.model.further import whole_files

        parts = [VERSION, repr(self.layout), *_listed(whole_files(self.text))]
        if self.rest is not None:
            text = self.rest.text
            parts += [repr(text.layout), *_listed(whole_files(text))]
        return hashlib.sha256("\0".join(parts).encode()).hexdigest()

    @property
    def source(self) -> str:
        """The C text of the model, empty if there is none."""
        from cotree.model.further import whole_files

        return whole_files(self.text).get(f"{self.text.prefix}.c", "")

    @property
    def slow_causes(self) -> str:
        """Messages on values in the scene that require short steps; empty if none is known."""
        return self.text.slow_causes

    @property
    def unreached(self) -> tuple[str, ...]:
        """Entries of :attr:`sensitivities` on which no state and no output depends."""
        return self.traits.unreached

    @property
    def has_constant_start(self) -> bool:
        """Whether the initial states depend neither on time nor on parameters."""
        is_found = self.begins_at_rest or self.layout.has_start_equations
        return self.traits.has_constant_start and not is_found

    @property
    def begins_at_rest(self) -> bool:
        """Whether runs start at the operating point."""
        return self.rest is not None

    def restart_times(
        self,
        p: Array,
        span: tuple[float, float],
        given: Container[str],
        others: Sequence[float],
        time_limit: float | None = None,
    ) -> RestartTimes:
        """Return the times of jumps and kinks; see :meth:`Program.restart_times`.

        ``span`` contains start and end of a run in either order, [s]; ``given`` contains the inputs
        that the run replaces, and ``others`` additional times, such as breakpoints of tables, [s].
        """
        ends = (min(span), max(span))
        return self.program.restart_times(p.tolist(), ends, given, others, time_limit)

    def longest_step(self, p: Array, replaced: Container[str] = ()) -> float:
        """Return the longest step that cannot miss a change of an input, [s]."""
        return self.program.longest_step(p.tolist(), replaced)

    @locked_cached_property
    def states_only(self) -> CompiledModel:
        """The model without sensitivities, which is the model itself if it has none."""
        return StatesOnly(self) if self.sensitivities else self

    @locked_cached_property
    def start_in_c(self) -> StartInC | None:
        """The C routine that searches for consistent initial states, or None without a compiler."""
        from cotree.model.start_in_c import start_in_c

        return start_in_c(self)

    @locked_cached_property
    def slopes(self) -> dict[str, tuple[int, int]]:
        """Row and column of each state sensitivity, by its name ``d(STATE)/d(PARAMETER)``."""
        rows, columns = list(enumerate(self.states)), list(enumerate(self.sensitivities))
        return {f"d({own})/d({by})": (i, j) for i, own in rows for j, by in columns}

    @property
    def constraints(self) -> tuple[str, ...]:
        """Names of the constraints, constraint rates and quaternion norms."""
        return tuple(row.name for row in self.layout.constraints)

    def initial_values(self, t: float, p: Array, u: Array | None) -> tuple[Array, Array]:
        """Return initial states and sensitivities, from the operating point or the scene.

        Shapes are (n_states,) and (n_states, n_sensitivities). ``t`` is the start time, [s]; u =
        None selects the scene's inputs.
        """
        y, s = self.initial(p), self.initial_sensitivity(p)
        return (y, s) if self.rest is None or not self.states else self.rest(t, p, u, s)

    @locked_cached_property
    def junctions(self) -> Junctions:
        """The algebraic equations with separate exponentials, for searches from a poor guess."""
        from cotree.model.roots import Junctions

        return Junctions.of(self.program)

    def constraint_values(self, t: Any, y: Any, p: Any = None) -> Array:
        """Return the residuals of :attr:`constraints`, shape (n_constraints,)."""
        if not self.constraints:  # such models have no kernel for constraints
            return np.zeros((0, *np.shape(y)[1:]))
        return self._at("constraints", t, y, p, None)

    def initial(self, p: Any = None) -> Array:
        """Return the scene's initial states, shape (n_states,)."""
        self._prepare(p)
        return self._call("initial", 0.0, _NONE, _NONE, _NONE)

    def initial_sensitivity(self, p: Any = None) -> Array:
        """Return the sensitivities of the scene's initial states, (n_states, n_parameters)."""
        self._prepare(p)
        return self.shaped(
            "initial_sensitivity", self._call("initial_sensitivity", 0.0, _NONE, _NONE, _NONE)
        )

    def input_values(self, t: float, p: Any = None) -> Array:
        """Return the scene's inputs at time t, shape (n_inputs,)."""
        self._prepare(p)
        return self._call("inputs", float(t), _NONE, _NONE, _NONE)

    def rhs(self, t: Any, y: Any, p: Any = None, u: Any = None) -> Array:
        """Return the rates of the states; see :meth:`cotree.Model.rhs`."""
        return self._at("rhs", t, y, p, u)

    def jacobian(self, t: Any, y: Any, p: Any = None, u: Any = None) -> Array:
        """Return the derivatives of the rates with respect to the states, (n_states, n_states)."""
        return self._at("jacobian", t, y, p, u)

    def jacobian_sparse(self, t: float, y: Any, p: Any = None, u: Any = None) -> csc_matrix:
        """Return the Jacobian at one point as a SciPy CSC matrix."""
        one = one_point(y, self.states, "state")
        return self.structure.sparse(self._at_one("jacobian", t, one, p, u))

    def sensitivity_rhs(self, t: Any, y: Any, s: Any, p: Any = None, u: Any = None) -> Array:
        """Return the rates of the sensitivities, in the shape of s."""
        return self._at("sensitivity_rhs", t, y, p, u, s)

    def output_values(self, t: Any, y: Any, p: Any = None, u: Any = None) -> Array:
        """Return the outputs, shape (n_outputs,) or (n_outputs, m)."""
        return self._at("outputs", t, y, p, u)

    def output_sensitivity(self, t: Any, y: Any, s: Any, p: Any = None, u: Any = None) -> Array:
        """Return the sensitivities of the outputs, shape (n_outputs, n_parameters)."""
        return self._at("output_sensitivity", t, y, p, u, s)

    def why_undefined(self, t: float, y: Array, p: Array, u: Array | None) -> str:
        """Return the reason why the rates are not finite at a point, or an empty string."""
        try:
            rates = self.bound("rhs", p)(t, y, _NONE, u)
        except SingularSystemError as error:
            return str(error).rstrip(".")
        if np.all(np.isfinite(rates)):
            return ""
        from cotree.model.failures import why_undefined

        u = self.input_values(t, p) if u is None else u
        return why_undefined(self.program, "rhs", {"t": [t], "x": y, "p": p, "u": u})

    def shape_of(self, name: str) -> tuple[int, ...]:
        """Return the shape of a kernel's result, in full arrays."""
        n, m = len(self.states), len(self.sensitivities)
        if name in ("sensitivity_rhs", "initial_sensitivity"):
            return n, m
        if name == "output_sensitivity":
            return len(self.outputs), m
        return (n, n) if name == "jacobian" else (self.traits.n_results.get(name, 0),)

    def shaped(self, name: str, flat: Array) -> Array:
        """Return the result of a kernel at one point in the shape :meth:`shape_of`."""
        if name == "jacobian":
            return self.structure.full(flat)
        shape = self.shape_of(name)
        # Kernels return one block per parameter; results have one column per parameter.
        return flat if len(shape) == 1 else flat.reshape(shape[::-1]).T.copy()

    def _at(self, name: str, t: Any, y: Any, p: Any, u: Any, s: Any = None) -> Array:
        # Values with labels, such as a pandas series, are reordered by name.
        if type(y) is not np.ndarray:
            y = in_order(y, self.states, "state")
        if u is not None and type(u) is not np.ndarray:
            u = in_order(u, self.inputs, "input")
        if is_many(y):
            from cotree.model.columns import in_columns

            return in_columns(self, name, t, y, p, u, s)
        return self.shaped(name, self._at_one(name, t, y, p, u, s))

    def _at_one(self, name: str, t: Any, y: Any, p: Any, u: Any, s: Any = None) -> Array:
        """Return the results of a kernel at one point in the kernel's order."""
        self._prepare(p)
        n, m = len(self.states), len(self.sensitivities)
        states = as_array(y, (n,), "the states")
        inputs = (
            self.input_values(t, p) if u is None else as_array(u, (len(self.inputs),), "inputs")
        )
        along = _NONE
        if s is not None:
            along = as_array(s, (n, m), "the sensitivities").T.ravel()
        return self._call(name, check_number(t, "t"), states, along, inputs)


def _listed(files: Mapping[str, str]) -> list[str]:
    return [part for name in sorted(files) for part in (name, files[name])]


class StatesOnly(CompiledModel):
    """A model that ignores the sensitivities with which it was compiled."""

    def __init__(self, model: CompiledModel) -> None:
        text = model.text
        layout = replace(
            text.layout,
            sensitivities=(),
            sensitivity_starts=(0,),
            sensitivity_rows=(),
            input_sensitivities=((),) * len(text.layout.inputs),
        )
        super().__init__(replace(text, layout=layout), model.code)
        # Both models share the kernels, and thus the prepared parameters of each thread.
        self._own, self._whole_model, self.rest = model._own, model, model.rest

    @locked_cached_property
    def program(self) -> Program:
        """The program of the original model, whose layout contains no sensitivities."""
        return replace(self._whole_model.program, layout=self.layout)

    def initial_values(self, t: float, p: Array, u: Array | None) -> tuple[Array, Array]:
        """Return initial states and empty sensitivities."""
        if self.rest is None:
            return super().initial_values(t, p, u)
        return self._whole_model.initial_values(t, p, u)[0], np.zeros((len(self.states), 0))

    def initial_sensitivity(self, p: Any = None) -> Array:
        """Return an empty array, shape (n_states, 0)."""
        return np.zeros((len(self.states), 0))
