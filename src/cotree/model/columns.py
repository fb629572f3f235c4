"""Evaluation of a kernel at many points, one per column, in C.

At many points, a kernel that is compiled for this purpose evaluates several points at once, one in
each SIMD lane. Threads share the points. Results depend neither on the number of threads nor on the
lane.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from cotree.build import find_toolchain
from cotree.build.compile import cpu_features
from cotree.errors import Error, ParameterError
from cotree.model.arrays import Array, CObjects, as_array, is_many
from cotree.model.further import load_further
from cotree.model.kernels import Rows, call_columns, load_columns
from cotree.naming import c_identifier
from cotree.program.kernels import KERNELS
from cotree.scene.expressions import check_number
from cotree.sharing import usable_cores

if TYPE_CHECKING:
    from collections.abc import Callable

    import numpy.typing as npt

    from cotree.build import LoadedLibrary
    from cotree.model.further import Rendered
    from cotree.model.model import CompiledModel
    from cotree.program.text import ModelText

    IndexArray = npt.NDArray[np.intp]

# Kernels that have SIMD lanes, and the smallest number of points for which these are compiled. Once
# compiled, they save time from 30 points of a robot or 400 of a pendulum.
_IN_LANES = ("rhs", "jacobian", "outputs", "sensitivity_rhs", "output_sensitivity")
_MANY = 256

# Largest number of lanes, and number of points that scalar code evaluates in one call. The copies
# of more points exceed the processor's cache.
_BLOCK, _PIECE = 8, 256

# Number of points after whose evaluation the number of threads is chosen, and the time that is
# worth a thread, [s].
_FIRST, _WORTH = 512, 3e-4


def load_points(text: ModelText, name: str) -> LoadedLibrary | None:
    """Build and load a kernel in SIMD lanes for many points; None if that is impossible."""
    if find_toolchain() is None:
        return None
    # Imported here, because other calls do not need these modules.
    from cotree.codegen.lanes import lanes_of, points_context, render_points

    lanes = lanes_of(cpu_features().split())

    def render() -> Rendered | None:
        model = points_context(text.program, name, lanes)
        if isinstance(model, str):
            return None
        return *render_points(model), model.n_written, model.n_written_in_all

    return load_further(text, (name, lanes), render)


def in_columns(
    model: CompiledModel, name: str, t: Any, y: Any, p: Any, u: Any, s: Any = None
) -> Array:
    """Evaluate a kernel at m points; the last axis of the result has length m.

    Shapes: t () or (m,), y (n_states, m), s (n_states, n_sensitivities, m); p and u may have m
    columns. Raise ParameterError if a shape is wrong or a guard rejects a parameter. Errors at a
    point name its column.
    """
    points = _checked(model, t, y, p, u, s)
    n, n_s, m = len(model.states), len(model.sensitivities), len(points.t)
    shape = model.shape_of(name)
    if 0 in (*shape, m):
        return np.zeros((*shape, m))
    # Kernels order sensitivities by parameter and omit those that are identically zero.
    places = np.arange(n * n_s)
    if KERNELS[name].is_packed:
        places = np.array(model.layout.sensitivity_places, dtype=np.intp)
    rows = np.arange(shape[0])
    if name == "jacobian":
        rows = model.structure.jacobian_places
    elif len(shape) == 2:
        rows = _rows(places if name == "sensitivity_rhs" else np.arange(n_s * shape[0]), *shape)
    found = (np.empty if len(rows) == np.prod(shape) else np.zeros)((*shape, m))
    s_rows = np.arange(0) if s is None else _rows(places, n, n_s)
    done = points.evaluate(name, s_rows, found.reshape(-1, m), rows)
    # Without a compiler, or after a failure in C, Python evaluates the remaining points.
    for j in range(done, m):
        found[..., j] = points.at(name, j)
    return found


def input_jacobian(model: CompiledModel, t: float, y: Array, p: Any, u: Array) -> Array | None:
    """Differentiate the rates with respect to the inputs, (n_states, n_inputs, m).

    Arguments as for :func:`in_columns`. Return None if the kernel cannot be compiled for SIMD
    lanes.
    """
    shape, m = (len(model.states), len(model.inputs)), np.shape(y)[1]
    lanes = model.code.in_lanes("input_jacobian") if model.backend == "C" else None
    if lanes is None:
        return None
    # The last points are repeated, since lanes need a whole vector of points.
    wide = partial(np.pad, pad_width=((0, 0), (0, max(0, _BLOCK - m))), mode="edge")
    many = [wide(row) if is_many(row) else row for row in (y, p, u)]
    points = _checked(model, t, many[0], many[1], many[2], None)
    found = np.empty((*shape, len(points.t)))
    rows, flat = np.arange(shape[0] * shape[1]), found.reshape(-1, len(points.t))
    call = points.in_lanes(lanes, "input_jacobian", rows[:0], flat, rows)
    done = _shared_by_threads(call, len(points.t))
    if done < len(points.t):
        points.at("rhs", done)  # raises an error, because the parameters are rejected
    return found[..., :m]


def _rows(places: IndexArray, n: int, n_s: int) -> IndexArray:
    """Return the rows of an array (n, n_s, m) for places in an array with one row a parameter."""
    return places % n * n_s + places // n


@dataclass(eq=False)
class Points:
    """Arguments of a kernel at m points: contiguous arrays with one row for each value."""

    model: CompiledModel
    t: Array  # shape (m,), [s]
    x: Array
    s: Array  # shape (n_states n_sensitivities, m)
    u: Array | None  # None: the scene's inputs
    p: Array  # parameters of all points, or one row for each

    @property
    def has_own(self) -> bool:
        """Whether each point has its own parameters."""
        return self.p.ndim > 1

    def evaluate(self, name: str, s_rows: IndexArray, results: Array, rows: IndexArray) -> int:
        """Evaluate a kernel in C until one point fails; return the number of points before it.

        The kernel reads the rows ``s_rows`` of s, and writes the rows ``rows`` of the results.
        """
        model, library, m = self.model, load_columns(), len(self.t)
        if model.backend != "C" or library is None or model.address(name) is None:
            return 0
        if m >= _MANY and name in _IN_LANES and (lanes := model.code.in_lanes(name)) is not None:
            return _shared_by_threads(self.in_lanes(lanes, name, s_rows, results, rows), m)

        def evaluate(first: int, last: int) -> int:
            for begun in range(first, last, _PIECE):
                piece = slice(begun, min(begun + _PIECE, last))
                x, p = self.x[:, piece].T.copy(), self.p[None, :]
                if self.has_own:
                    p = self.p[:, piece].T.copy()
                points = Rows(self.t[piece], x, self.s[s_rows, piece].T.copy(), p, self.has_own)
                u, found = np.zeros((len(x), len(model.inputs))), np.zeros((len(x), len(rows)))
                if self.u is not None:
                    u = self.u[:, piece].T.copy()
                has_inputs = self.u is not None
                done = call_columns(library, model, name, points, u, found, has_inputs=has_inputs)
                results[rows, begun : begun + done] = found[:done].T
                if done < len(x):
                    return begun + done
            return last

        return _shared_by_threads(evaluate, m)

    def in_lanes(
        self,
        lanes: LoadedLibrary,
        name: str,
        s_rows: IndexArray,
        results: Array,
        rows: IndexArray,
    ) -> Callable[[int, int], int]:
        """Return a function that evaluates points in SIMD lanes, from one number to another."""
        model, objects = self.model, CObjects(lanes.ffi)
        # C prepares the values of each point that has its own parameters.
        k = model.code.prepared() if self.has_own else model.prepared(self.p)
        c = objects.new("cotree_points *")
        c.n_points, c.has_own = len(self.t), self.has_own
        c.prepare = lanes.ffi.cast("cotree_prepare_kernel", model.address("prepare") or 0)
        c.t, c.x, c.s, c.p, c.k = map(objects.pointer, (self.t, self.x, self.s, self.p, k))
        c.u = lanes.ffi.NULL if self.u is None else objects.pointer(self.u)
        c.results = objects.pointer(results)
        c.s_rows, c.rows = (objects.pointer(own.astype(np.intc), "int") for own in (s_rows, rows))
        # Lanes also compute the results that precede those of the kernel.
        whole = KERNELS[name].tail_of if name in KERNELS else ""
        n_results = model.traits.n_results[whole] if whole else len(rows)
        size = (
            len(self.x) + len(s_rows) + len(model.inputs) + 2 * (len(self.p) + len(k)) + n_results
        )
        call = getattr(lanes.lib, f"{c_identifier(model.layout.name)}_points")

        def evaluate(first: int, last: int) -> int:
            work = np.empty(_BLOCK * (size + 1))
            aligned = work[-work.ctypes.data // 8 % _BLOCK :]
            return int(call(c, first, last, CObjects(lanes.ffi).pointer(aligned)))

        return evaluate

    def at(self, name: str, j: int) -> Array:
        """Evaluate a kernel at one point in Python."""
        try:
            p = self.p[:, j] if self.has_own else self.p
            u = None if self.u is None else self.u[:, j]
            x = self.x[:, j]
            s = self.s[:, j].reshape(max(len(x), 1), -1).T.ravel()
            return self.model.shaped(name, self.model.bound(name, p)(float(self.t[j]), x, s, u))
        except Error as error:
            raise type(error)(f"column {j}: {error}") from None


def _shared_by_threads(evaluate: Callable[[int, int], int], n: int) -> int:
    """Evaluate n points in pieces of at least 8; return the number of points before a failure."""
    first = n if n < _FIRST + _BLOCK else _FIRST
    began = time.perf_counter()
    done = evaluate(0, first)
    n_threads = int((time.perf_counter() - began) * (n - first) / (first * _WORTH))
    if done < first or first == n:
        return done
    if n_threads > 1:
        n_threads = min(n_threads, usable_cores())
    if n_threads <= 1:
        return evaluate(first, n)
    from concurrent.futures import ThreadPoolExecutor

    # Pieces are shorter than the share of a thread, since other programs may use a core.
    length = max(_BLOCK, -(-(n - first) // (4 * n_threads * _BLOCK)) * _BLOCK)
    bounds = [*range(first, n - _BLOCK + 1, length), n]
    with ThreadPoolExecutor(n_threads) as pool:
        for end, reached in zip(bounds[1:], pool.map(evaluate, bounds, bounds[1:]), strict=True):
            if reached < end:
                return reached
    return n


def _checked(model: CompiledModel, t: Any, y: Any, p: Any, u: Any, s: Any) -> Points:
    """Check the arguments of a kernel, or raise ParameterError."""
    n, n_s, m = len(model.states), len(model.sensitivities), np.shape(y)[1]
    x = _as_rows(y, (n, m), "the states")
    times = np.full(m, check_number(t, "t")) if np.ndim(t) == 0 else _as_rows(t, (m,), "the times")
    for j in np.flatnonzero(~np.isfinite(times))[:1].tolist():
        raise ParameterError(f"column {j}: t is {times[j]}: give a finite number")
    inputs: Array | None = None
    if u is not None and is_many(u):
        inputs = _as_rows(u, (len(model.inputs), m), "inputs")
    elif u is not None:
        inputs = np.repeat(as_array(u, (len(model.inputs),), "inputs")[:, None], m, axis=1)
    slopes = np.zeros((0, m))
    if s is not None:
        slopes = _as_rows(s, (n, n_s, m), "the sensitivities").reshape(n * n_s, m)
    # Parameters have one column per point, or one for all points.
    if not is_many(p):
        own = model.parameter_array(p)
        model.set_parameters(own)
        return Points(model, times, x, slopes, inputs, own)
    own = _as_rows(p, (len(model.parameters), m), "the parameters")
    points = Points(model, times, x, slopes, inputs, own)
    for j in np.flatnonzero(~np.isfinite(own).all(axis=0))[:1].tolist():
        points.at("rhs", j)  # C returns nan here; Python raises the error
    return points


def _as_rows(values: Any, shape: tuple[int, ...], what: str) -> Array:
    """Return a checked contiguous array, which is not copied if it is one."""
    if type(values) is np.ndarray and values.shape == shape and values.dtype == np.float64:
        return np.ascontiguousarray(values)
    return as_array(values, shape, what)
