"""Right-hand side with exact Jacobians as NumPy, CasADi and JAX functions."""

from __future__ import annotations

from dataclasses import dataclass
from importlib import import_module
from typing import TYPE_CHECKING, Any

import numpy as np

from cotree.dag.nodes import TIME, kinds_in
from cotree.errors import ParameterError

if TYPE_CHECKING:
    from collections.abc import Callable

    from cotree.model.arrays import Array
    from cotree.model.linearize import Linearizer
    from cotree.model.model import CompiledModel


@dataclass(frozen=True)
class Rates:
    """The function (x, u, p) -> dx/dt at one time."""

    model: CompiledModel
    linearizer: Callable[[], Linearizer]  # creates the linearizer
    t: float  # time, [s]
    #: Names of the parameters p, a selection of the sensitivities; others have the scene's values.
    names: tuple[str, ...]

    @property
    def sizes(self) -> tuple[int, int, int]:
        """Numbers of states, inputs and parameters ``names``."""
        return len(self.model.states), len(self.model.inputs), len(self.names)

    @property
    def values(self) -> Array:
        """The scene's values of the parameters ``names``, shape (n_parameters,)."""
        own = dict(zip(self.model.parameters, self.model.default_parameters, strict=True))
        return np.array([own[name] for name in self.names])

    def __call__(self, x: Array, u: Array, p: Array) -> Array:
        """Evaluate the rates, shape (n_states,)."""
        return self.model.rhs(self.t, x, self._given(p), u)

    def derivatives(self, x: Array, u: Array, p: Array) -> tuple[Array, Array, Array]:
        """Evaluate the derivatives with respect to x, u and p, each (n_states, argument length)."""
        model, given = self.model, self._given(p)
        n, n_inputs, n_parameters = self.sizes
        by_state = model.jacobian(self.t, x, given, u)
        by_input = np.zeros((n, 0))
        if n_inputs:
            # Models for bridges have no algebraic unknowns, so no elimination is needed.
            own = model.parameter_array(given), np.asarray(u, dtype=float)
            by_input = self.linearizer().whole(self.t, x, *own)[1][:n, n:]
        by_parameter = np.zeros((n, 0))
        if n_parameters:
            # With zero sensitivities, their rates are the partial derivatives with respect to p.
            at_rest = np.zeros((n, len(model.sensitivities)))
            rates = model.sensitivity_rhs(self.t, x, at_rest, given, u)
            by_parameter = rates[:, [model.sensitivities.index(name) for name in self.names]]
        return by_state, by_input, by_parameter

    def _given(self, p: Array) -> dict[str, float]:
        return dict(zip(self.names, map(float, p), strict=True))


def rates_of(
    model: CompiledModel, linearizer: Callable[[], Linearizer], t: float | None, bridge: str
) -> Rates:
    """Return the rates as a function, or raise ParameterError with the name of ``bridge``."""
    layout = model.layout
    if layout.n_algebraic or layout.constraints:
        what = "algebraic unknowns" if layout.n_algebraic else "constraints"
        raise ParameterError(
            f"{bridge}() needs a model without constraints and algebraic unknowns, but "
            f"'{layout.name}' has {what}: export an FMU, or call simulate"
        )
    if t is None and TIME in kinds_in(model.program.kernels["rhs"].results):
        raise ParameterError(
            f"the rates of '{layout.name}' depend on time: pass a time, such as {bridge}(t=0.0)"
        )
    names = tuple(name for name in model.sensitivities if name in model.parameters)
    return Rates(model, linearizer, 0.0 if t is None else t, names)


def casadi_function(rates: Rates) -> Any:
    """Return a ``casadi.Callback`` with arguments x, u and p, and result dx."""
    try:
        casadi: Any = import_module("casadi")
    except ImportError:
        raise ParameterError(
            "as_casadi() needs the package casadi: run `pip install casadi` (the extra "
            "cotree[casadi])"
        ) from None

    sizes, names = rates.sizes, ("x", "u", "p")
    n = sizes[0]

    class Jacobian(casadi.Callback):  # type: ignore[misc]
        """CasADi function that returns the Jacobian of the rates for each argument."""

        def __init__(self, name: str, given: list[str], results: list[str], options: Any) -> None:
            super().__init__()
            self._names = given, results
            self.construct(name, options)

        def get_n_in(self) -> int:
            return 4

        def get_n_out(self) -> int:
            return 3

        def get_name_in(self, i: int) -> str:
            return self._names[0][i]

        def get_name_out(self, i: int) -> str:
            return self._names[1][i]

        def get_sparsity_in(self, i: int) -> Any:
            # The fourth argument is the value of the function; it is unused except for its shape.
            return casadi.Sparsity.dense(sizes[i], 1) if i < 3 else casadi.Sparsity(n, 1)

        def get_sparsity_out(self, i: int) -> Any:
            return casadi.Sparsity.dense(n, sizes[i])

        def eval(self, arg: Any) -> Any:
            return [casadi.DM(block) for block in rates.derivatives(*map(_flat, arg[:3]))]

    class Function(casadi.Callback):  # type: ignore[misc]
        """CasADi function that returns the rates."""

        def __init__(self) -> None:
            super().__init__()
            self._jacobian: Any = None
            self.construct("rates")

        def get_n_in(self) -> int:
            return 3

        def get_n_out(self) -> int:
            return 1

        def get_name_in(self, i: int) -> str:
            return names[i]

        def get_name_out(self, i: int) -> str:
            return "dx"

        def get_sparsity_in(self, i: int) -> Any:
            return casadi.Sparsity.dense(sizes[i], 1)

        def get_sparsity_out(self, i: int) -> Any:
            return casadi.Sparsity.dense(n, 1)

        def eval(self, arg: Any) -> Any:
            return [casadi.DM(rates(*map(_flat, arg)))]

        def has_jacobian(self) -> bool:
            return True

        def get_jacobian(self, name: str, given: Any, results: Any, options: Any) -> Any:
            # CasADi keeps no reference to its callbacks, so Python must.
            self._jacobian = Jacobian(name, list(given), list(results), options)
            return self._jacobian

    return Function()


def _flat(value: Any) -> Any:
    return np.asarray(value.full(), dtype=float).ravel()


def jax_function(rates: Rates) -> Any:
    """Return a JAX function of x, u and p that supports ``jit``, ``vmap`` and first derivatives."""
    try:
        jax: Any = import_module("jax")
    except ImportError:
        raise ParameterError(
            "as_jax() needs the package jax: run `pip install jax` (the extra cotree[jax])"
        ) from None
    if not jax.config.jax_enable_x64:
        raise ParameterError(
            "as_jax() computes in double precision, which JAX leaves off: call "
            'jax.config.update("jax_enable_x64", True) first'
        )
    numbers, n = jax.numpy, rates.sizes[0]
    value = jax.ShapeDtypeStruct((n,), np.float64)
    blocks = tuple(jax.ShapeDtypeStruct((n, size), np.float64) for size in rates.sizes)

    def evaluate(x: Any, u: Any, p: Any) -> Any:
        return rates(*map(_as_vector, (x, u, p)))

    def derive(x: Any, u: Any, p: Any) -> Any:
        return rates.derivatives(*map(_as_vector, (x, u, p)))

    def evaluated(x: Any, u: Any, p: Any) -> Any:
        return jax.pure_callback(evaluate, value, x, u, p, vmap_method="sequential")

    function: Any = jax.custom_jvp(evaluated)

    def jvp(primals: Any, tangents: Any) -> Any:
        found = jax.pure_callback(derive, blocks, *primals, vmap_method="sequential")
        change = sum(block @ tangent for block, tangent in zip(found, tangents, strict=True))
        return function(*primals), change

    function.defjvp(jvp)

    def called(x: Any, u: Any = (), p: Any = None) -> Any:
        given = rates.values if p is None else p
        return function(*(numbers.asarray(row, dtype=np.float64) for row in (x, u, given)))

    return called


def _as_vector(value: Any) -> Any:
    return np.asarray(value, dtype=float).ravel()
