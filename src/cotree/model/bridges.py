"""Right-hand side with exact Jacobians as NumPy, CasADi, JAX and PyTorch functions."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from cotree.dag.nodes import TIME, kinds_in
from cotree.errors import ParameterError, optional_package
from cotree.model.columns import input_jacobian

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from cotree.model.arrays import Array
    from cotree.model.linearize import Linearizer
    from cotree.model.model import CompiledModel

    #: Names of arguments or results, with their shapes as CasADi's sparsities.
    Shapes = Sequence[tuple[str, Any]]


@dataclass(frozen=True)
class RateFunction:
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
        """Evaluate the rates, shape (..., n_states).

        Arguments have their values on the last axis; all other axes are broadcast.
        """
        if max(x.ndim, u.ndim, p.ndim) == 1:
            return self.model.rhs(self.t, x, self._given(p), u)
        lead, columns = self._columns(x, u, p)
        return self.model.rhs(self.t, *columns).T.reshape(*lead, self.sizes[0])

    def derivatives(self, x: Array, u: Array, p: Array) -> tuple[Array, Array, Array]:
        """Evaluate the derivatives with respect to x, u and p, each (..., n_states, length)."""
        model, lead = self.model, np.broadcast_shapes(x.shape[:-1], u.shape[:-1], p.shape[:-1])
        _, (y, own, inputs) = self._columns(x, u, p)
        n, m = y.shape
        blocks = [model.jacobian(self.t, y, own, inputs)]
        by_input = np.zeros((n, 0, m))
        if len(model.inputs):
            found = input_jacobian(model, self.t, y, own, inputs)
            by_input = self._input_jacobian(y, own, inputs) if found is None else found
        by_parameter = np.zeros((n, 0, m))
        if self.names:
            # With zero sensitivities, their rates are the partial derivatives with respect to p.
            at_rest = np.zeros((n, len(model.sensitivities), m))
            rates = model.sensitivity_rhs(self.t, y, at_rest, own, inputs)
            by_parameter = rates[:, [model.sensitivities.index(name) for name in self.names]]
        blocks += [by_input, by_parameter]
        by_state, by_input, by_parameter = (
            np.moveaxis(block, -1, 0).reshape(*lead, *block.shape[:-1]) for block in blocks
        )
        return by_state, by_input, by_parameter

    def _columns(
        self, x: Array, u: Array, p: Array
    ) -> tuple[tuple[int, ...], tuple[Array, Any, Array]]:
        """Return the broadcast axes, and the arguments of the model with one column a point."""
        lead = np.broadcast_shapes(x.shape[:-1], u.shape[:-1], p.shape[:-1])
        m = math.prod(lead)
        # An empty array has no length that reshape could determine.
        y, inputs, values = (
            np.ascontiguousarray(np.broadcast_to(row, (*lead, n)).reshape(m, n).T)
            for row, n in zip((x, u, p), self.sizes, strict=True)
        )
        if p.size == len(self.names):
            return lead, (y, self._given(p.ravel()), inputs)
        own = np.repeat(self.model.default_parameters[:, None], m, axis=1)
        own[[self.model.parameters.index(name) for name in self.names]] = values
        return lead, (y, own, inputs)

    def _input_jacobian(self, y: Array, own: Any, inputs: Array) -> Array:
        """Evaluate the derivatives with respect to the inputs in Python, point by point."""
        model, n, linearizer = self.model, len(y), self.linearizer()
        columns = []
        for j in range(y.shape[1]):
            p = own if isinstance(own, dict) else own[:, j]
            # Models for bridges have no algebraic unknowns, so no elimination is needed.
            at = y[:, j], model.parameter_array(p), inputs[:, j]
            columns.append(linearizer.whole(self.t, *at)[1][:n, n:])
        return np.stack(columns, axis=-1)

    def _given(self, p: Array) -> dict[str, float]:
        return dict(zip(self.names, map(float, p), strict=True))


def rates_of(
    model: CompiledModel, linearizer: Callable[[], Linearizer], t: float | None, bridge: str
) -> RateFunction:
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
    return RateFunction(model, linearizer, 0.0 if t is None else t, names)


def casadi_function(rates: RateFunction) -> Any:
    """Return a ``casadi.Callback`` with arguments x, u and p, and result dx."""
    casadi: Any = optional_package("casadi", "as_casadi() needs", "casadi", ParameterError)
    n = rates.sizes[0]

    class Named(casadi.Callback):  # type: ignore[misc]
        """CasADi function with named arguments and results, all of known shapes."""

        def __init__(self, name: str, given: Shapes, results: Shapes, options: Any) -> None:
            super().__init__()
            self._given, self._results = given, results
            self.construct(name, options)

        def get_n_in(self) -> int:
            return len(self._given)

        def get_n_out(self) -> int:
            return len(self._results)

        def get_name_in(self, i: int) -> str:
            return self._given[i][0]

        def get_name_out(self, i: int) -> str:
            return self._results[i][0]

        def get_sparsity_in(self, i: int) -> Any:
            return self._given[i][1]

        def get_sparsity_out(self, i: int) -> Any:
            return self._results[i][1]

    class Jacobian(Named):
        """CasADi function that returns the Jacobian of the rates for each argument."""

        def eval(self, arg: Any) -> Any:
            return [casadi.DM(block) for block in rates.derivatives(*map(_flat, arg[:3]))]

    class Function(Named):
        """CasADi function that returns the rates."""

        _jacobian: Any = None

        def eval(self, arg: Any) -> Any:
            return [casadi.DM(rates(*map(_flat, arg)))]

        def has_jacobian(self) -> bool:
            return True

        def get_jacobian(self, name: str, given: Any, results: Any, options: Any) -> Any:
            # The fourth argument is the value of the function; it is unused except for its shape.
            shapes = [*columns, casadi.Sparsity(n, 1)]
            blocks = [casadi.Sparsity.dense(n, size) for size in rates.sizes]
            named = [*zip(given, shapes, strict=True)], [*zip(results, blocks, strict=True)]
            # CasADi keeps no reference to its callbacks, so Python must.
            self._jacobian = Jacobian(name, *named, options)
            return self._jacobian

    columns = [casadi.Sparsity.dense(size, 1) for size in rates.sizes]
    return Function("rates", [*zip("xup", columns, strict=True)], [("dx", columns[0])], {})


def _flat(value: Any) -> Any:
    return np.asarray(value.full(), dtype=float).ravel()


#: Largest array that a callback of JAX receives, [byte]. Beyond 100 kB, JAX copies arrays in its
#: threads, which never happens if all of them wait in callbacks.
_INLINE = 96_000


def jax_function(rates: RateFunction) -> Any:
    """Return a JAX function of x, u and p that supports ``jit``, ``vmap`` and first derivatives."""
    jax: Any = optional_package("jax", "as_jax() needs", "jax", ParameterError)
    if not jax.config.jax_enable_x64:
        raise ParameterError(
            "as_jax() computes in double precision, which JAX leaves off: call "
            'jax.config.update("jax_enable_x64", True) first'
        )
    numbers, n = jax.numpy, rates.sizes[0]
    value = jax.ShapeDtypeStruct((n,), np.float64)
    blocks = tuple(jax.ShapeDtypeStruct((n, size), np.float64) for size in rates.sizes)

    def in_batches(evaluate: Any, shapes: Any) -> Any:
        """Return a function of x, u and p, which all may have further leading axes."""

        def called_back(shapes: Any, *arguments: Any) -> Any:
            def evaluated(*values: Any) -> Any:
                return evaluate(*(np.asarray(row, dtype=np.float64) for row in values))

            return jax.pure_callback(evaluated, shapes, *arguments)

        @jax.custom_batching.custom_vmap  # type: ignore[untyped-decorator]
        def batch(*arguments: Any) -> Any:
            lead = np.broadcast_shapes(*(row.shape[:-1] for row in arguments))
            m = math.prod(lead)
            if not lead or not m:
                return called_back(_with_axes(jax, lead, shapes), *arguments)
            most = max(1, _INLINE // (8 * max(rates.sizes)))
            length = -(-m // -(-m // most))  # pieces of equal length
            padding = ((0, -m % length), (0, 0))

            def cut(row: Any) -> Any:
                n_own = row.shape[-1]
                flat = numbers.broadcast_to(row, (*lead, n_own)).reshape(m, n_own)
                padded = numbers.pad(flat, padding, mode="edge") if n_own else flat
                return padded.reshape(-(-m // length), length, n_own)

            # Parameters of all points are not copied to each of them.
            n_cut = 3 if arguments[2].ndim > 1 else 2
            pieces, own = tuple(map(cut, arguments[:n_cut])), arguments[n_cut:]
            found = jax.lax.map(
                lambda rows: called_back(_with_axes(jax, (length,), shapes), *rows, *own), pieces
            )

            def joined(row: Any) -> Any:
                shape = row.shape[2:]
                flat = row.reshape(row.shape[0] * length, *shape)
                return flat[:m].reshape(*lead, *shape)

            return jax.tree.map(joined, found)

        @batch.def_vmap  # type: ignore[untyped-decorator]
        def rule(size: int, in_batched: Any, *arguments: Any) -> Any:
            rows = _aligned(arguments, in_batched)
            return batch(*rows), jax.tree.map(lambda _: True, shapes)

        return batch

    evaluate, derive = in_batches(rates, value), in_batches(rates.derivatives, blocks)

    @jax.custom_jvp  # type: ignore[untyped-decorator]
    def function(x: Any, u: Any, p: Any) -> Any:
        return evaluate(x, u, p)

    def jvp(primals: Any, tangents: Any) -> Any:
        change = sum(
            block @ tangent for block, tangent in zip(derive(*primals), tangents, strict=True)
        )
        return function(*primals), change

    function.defjvp(jvp)
    many = numbers.vectorize(function, signature="(n),(k),(j)->(n)")

    def called(x: Any, u: Any = (), p: Any = None) -> Any:
        def convert(row: Any) -> Any:
            return numbers.asarray(row, dtype=np.float64)

        return many(*_checked(rates, convert, x, u, rates.values if p is None else p))

    return called


def _aligned(rows: Sequence[Any], is_new: Sequence[bool]) -> list[Any]:
    """Insert axes behind new first axes, so that all leading axes are broadcast together."""
    most = max(row.ndim - new for row, new in zip(rows, is_new, strict=True))
    return [
        row.reshape(row.shape[0], *[1] * (most + 1 - row.ndim), *row.shape[1:]) if new else row
        for row, new in zip(rows, is_new, strict=True)
    ]


def _with_axes(jax: Any, lead: tuple[int, ...], shapes: Any) -> Any:
    return jax.tree.map(lambda row: jax.ShapeDtypeStruct((*lead, *row.shape), row.dtype), shapes)


def _checked(rates: RateFunction, convert: Callable[[Any], Any], *arguments: Any) -> list[Any]:
    """Convert the arguments x, u and p to arrays; raise ParameterError if a length is wrong."""
    found = []
    for name, n, value in zip("xup", rates.sizes, arguments, strict=True):
        found.append(convert(value))
        if found[-1].shape[-1:] != (n,):
            shape = tuple(found[-1].shape)
            raise ParameterError(f"{name} must be an array of shape (..., {n}), not {shape}")
    return found


def torch_function(rates: RateFunction) -> Any:
    """Return a PyTorch function of x, u and p for ``backward``, ``vmap`` and first derivatives."""
    torch: Any = optional_package("torch", "as_torch() needs", "torch", ParameterError)

    def evaluated(evaluate: Any, arguments: Any) -> Any:
        values = (row.detach().cpu().numpy() for row in arguments)
        found = evaluate(*values)
        where = arguments[0].device
        if isinstance(found, tuple):
            return tuple(torch.from_numpy(np.ascontiguousarray(row)).to(where) for row in found)
        return torch.from_numpy(np.ascontiguousarray(found)).to(where)

    def aligned(in_dims: Any, arguments: Any) -> Any:
        """Move the new axis of a batch to the front of the arguments that have it."""
        moved = (
            row if dim is None else row.movedim(dim, 0)
            for row, dim in zip(arguments, in_dims, strict=True)
        )
        return _aligned([*moved], [dim is not None for dim in in_dims])

    class Derivatives(torch.autograd.Function):  # type: ignore[misc]
        """The Jacobian of the rates for each argument."""

        @staticmethod
        def forward(*arguments: Any) -> Any:
            return evaluated(rates.derivatives, arguments)

        @staticmethod
        def setup_context(ctx: Any, inputs: Any, output: Any) -> None:
            pass

        @staticmethod
        def vmap(info: Any, in_dims: Any, *arguments: Any) -> Any:
            found = Derivatives.apply(*aligned(in_dims, arguments))
            return found, (0, 0, 0)

        @staticmethod
        def backward(ctx: Any, *changes: Any) -> Any:
            raise ParameterError("as_torch() has first derivatives only")

    class Function(torch.autograd.Function):  # type: ignore[misc]
        """The rates."""

        @staticmethod
        def forward(*arguments: Any) -> Any:
            return evaluated(rates, arguments)

        @staticmethod
        def setup_context(ctx: Any, inputs: Any, output: Any) -> None:
            ctx.save_for_backward(*inputs)
            ctx.save_for_forward(*inputs)

        @staticmethod
        def vmap(info: Any, in_dims: Any, *arguments: Any) -> Any:
            return Function.apply(*aligned(in_dims, arguments)), 0

        @staticmethod
        def backward(ctx: Any, change: Any) -> Any:
            given = ctx.saved_tensors
            found = (change.unsqueeze(-2) @ block for block in Derivatives.apply(*given))
            # Arguments that were broadcast collect the changes of all points.
            return tuple(
                row.squeeze(-2).sum_to_size(own.shape)
                for row, own in zip(found, given, strict=True)
            )

        @staticmethod
        def jvp(ctx: Any, *tangents: Any) -> Any:
            blocks = Derivatives.apply(*ctx.saved_tensors)
            return sum(
                (block @ tangent.unsqueeze(-1)).squeeze(-1)
                for block, tangent in zip(blocks, tangents, strict=True)
                if tangent is not None
            )

    def called(x: Any, u: Any = (), p: Any = None) -> Any:
        x = torch.as_tensor(x, dtype=torch.float64)

        def convert(value: Any) -> Any:
            return torch.as_tensor(value, dtype=torch.float64, device=x.device)

        return Function.apply(*_checked(rates, convert, x, u, rates.values if p is None else p))

    return called
