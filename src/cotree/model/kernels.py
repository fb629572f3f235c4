"""Compiled C kernels as Python functions of contiguous arrays of doubles.

A kernel returns a buffer, which its next call overwrites. Each thread has its own buffers and
prepared parameters. Kernels of implicit methods (``cotree_newton``) are built at first use.
"""

from __future__ import annotations

import contextlib
import hashlib
import threading
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from cotree.build import BuildOptions, LoadedLibrary, find_toolchain, loop_flags, obtain_library
from cotree.build.cache import cached
from cotree.build.compile import cpu_features
from cotree.errors import BuildError, SolveError
from cotree.model.arrays import Array, pointer_to
from cotree.program.kernels import KERNELS
from cotree.sharing import forming, locked_cache
from cotree.version import ABI_VERSION

if TYPE_CHECKING:
    from collections.abc import Mapping

    from cotree.model.model import CompiledModel
    from cotree.program.program import Program
    from cotree.program.text import ModelText


@dataclass(frozen=True, eq=False)
class Newton:
    """C functions of a model that factorise Newton matrices and compute second derivatives."""

    address: int  # address of the function ``cotree_newton``
    library: LoadedLibrary  # the reference keeps the loaded code in memory


def load_newton(program: Program) -> Newton | None:
    """Build and load a model's ``cotree_newton``; return None if that is impossible."""
    if find_toolchain() is None:
        return None
    # Imported here, because explicit methods do not need these modules.
    from cotree.codegen.newton import newton_context, newton_declarations, render_newton

    # Second derivatives add nodes to the graph, which several threads share: a lock is needed.
    with forming:
        model = newton_context(program)
        files = render_newton(model)
    written = model.n_written, model.n_written_in_all
    loaded = load_kernels(files, newton_declarations(model), *written, BuildOptions())
    if loaded is None:
        return None
    address = getattr(loaded.lib, f"{model.prefix}_newton")()
    return Newton(int(loaded.ffi.cast("uintptr_t", address)), loaded)


def load_points(text: ModelText, name: str) -> LoadedLibrary | None:
    """Build and load a kernel in SIMD lanes for many points; None if that is impossible."""
    if find_toolchain() is None:
        return None
    # Imported here, because other calls do not need these modules.
    from cotree.codegen.lanes import lanes_of, points_context, render_points

    lanes = lanes_of(cpu_features().split())

    def render() -> tuple[Mapping[str, str], str, int, int] | None:
        # Rendering may add nodes to the graph, as above.
        with forming:
            model = points_context(text.program, name, lanes)
            if isinstance(model, str):
                return None
            return *render_points(model), model.n_written, model.n_written_in_all

    digest = hashlib.sha256("\0".join(map(str, sorted(text.files.items()))).encode()).hexdigest()
    found = cached((name, lanes, digest), render)
    return None if found is None else load_kernels(*found, BuildOptions())


def load_kernels(
    files: Mapping[str, str], declarations: str, n_written: int, n_all: int, options: BuildOptions
) -> LoadedLibrary | None:
    """Build and load additional C functions of a model; return None if that is impossible.

    ``n_written`` and ``n_all`` are the operations of the longest function and of all together.
    """
    toolchain = find_toolchain()
    with contextlib.suppress(BuildError):
        if toolchain is not None:
            return obtain_library(
                files,
                declarations,
                abi_version=ABI_VERSION,
                n_operations=n_written,
                n_all=n_all,
                options=options,
                toolchain=toolchain,
            )[1]
    return None


@dataclass(frozen=True)
class StepWork:
    """Operation counts of one implicit step."""

    #: Operations of the rates, of the rates with sensitivities, and of the Jacobian.
    rates: int
    augmented: int
    jacobian: int
    #: Entries of the factors in the planned sparse elimination, and products to compute them.
    n_factors: int
    n_products: int
    is_unrolled: bool  # whether the C code has no loops
    #: Both counts for factors with row exchanges, in banded form if the band is narrow.
    n_banded: int
    n_banded_products: int


def count_step_work(program: Program) -> StepWork | None:
    """Count the operations of an implicit step; None if its matrix is structurally singular."""
    layout, plan = program.layout, program.elimination
    if plan is None:
        return None
    from cotree.codegen.newton import is_unrolled
    from cotree.linear.elimination import narrow_band

    n, counts = len(layout.states), program.operations
    lower, upper, places = narrow_band(n, layout.column_starts, layout.row_indices)
    is_banded = places is not None
    return StepWork(
        counts["rhs"].total,
        counts["augmented_rhs"].total,
        counts["jacobian"].total,
        len(plan.factors),
        sum(len(entry.products) for entry in plan.factors),
        is_unrolled(plan),
        n * (2 * lower + upper + 1 if is_banded else n),
        n * lower * (lower + upper) if is_banded else n**3 // 3,
    )


#: Status of a kernel whose linear system is singular.
SINGULAR = 1


class _Bound(dict[str, tuple[Any, tuple[Any, ...], Array, bool]]):
    """Each kernel of a thread: function, arguments, result, and whether t is an argument."""

    def __init__(self, text: ModelText, library: LoadedLibrary, model: Any) -> None:
        super().__init__()
        ffi, layout = library.ffi, text.layout
        self._n_results, self._model, self._ffi = text.traits.n_results, model, ffi
        n, m = len(layout.states), len(layout.sensitivities)
        self.x, self.s, self.u = np.zeros(n), np.zeros(n * max(m, 1)), np.zeros(len(layout.inputs))
        self.p, self.k = np.zeros(len(layout.parameters)), np.zeros(model.n_prepared)
        self._pointers = {key: pointer_to(self._ffi, getattr(self, key)) for key in "xsupk"}
        # `prepare` reads parameters and writes the values computed from them.
        self.prepared = (self._pointers["p"], self._pointers["k"])

    def __missing__(self, name: str) -> tuple[Any, tuple[Any, ...], Array, bool]:
        if name not in self._n_results:  # such a kernel is never called
            self[name] = absent = (lambda *_: 0), (), np.zeros(0), True
            return absent
        # Time is passed by value; all other arguments are pointers that never change.
        spec, result = KERNELS[name], np.zeros(self._n_results[name])
        arguments = [self._pointers[key] for key in spec.arguments if key != "t"]
        function = getattr(self._model, spec.field)
        bound = (
            function,
            (*arguments, pointer_to(self._ffi, result)),
            result,
            spec.arguments[0] == "t",
        )
        self[name] = bound
        return bound


class _OwnBuffers(threading.local):
    """Arguments and results of C kernels, separate for each thread."""

    def __init__(self, text: ModelText, library: LoadedLibrary, model: Any) -> None:
        self.bound = _Bound(text, library, model)


class Kernels:
    """Kernels of a loaded library, whose buffers and pointers each thread binds once.

    Attributes
    ----------
    library : LoadedLibrary
        The library.
    model_address : int
        Address of its ``cotree_model``.
    newton : callable
        Returns ``cotree_newton``, built at the first call; None if that is impossible.
    in_lanes : callable
        Returns the library of a kernel in SIMD lanes by name; None if that is impossible.
    step_work : callable
        Returns the operation counts of an implicit step, or None if they are unknown.
    """

    backend = "C"

    def __init__(self, text: ModelText, library: LoadedLibrary) -> None:
        layout = text.layout
        model = getattr(library.lib, f"{text.prefix}_abi")()
        # In other versions, the structure may have a different layout.
        if model.abi_version != ABI_VERSION or model.n_states != len(layout.states):
            raise BuildError("the loaded library belongs to another model: clear the cache")
        self.library = library  # the reference keeps the code in memory
        self.model_address = int(library.ffi.cast("uintptr_t", model))
        self._model, self._text = model, text
        self._own = _OwnBuffers(text, library, model)
        self.newton = locked_cache(lambda: load_newton(text.program))
        self.step_work = locked_cache(lambda: count_step_work(text.program))
        self.in_lanes = locked_cache(partial(load_points, text))

    def prepare(self, p: Array) -> None:
        """Set the parameters for this thread; raise ParameterError if a guard rejects them."""
        bound = self._own.bound
        bound.p[:] = p
        status = self._model.prepare(*bound.prepared)
        # C returns only a status; Python evaluates the guards again to name the rejected value.
        if status < 0:
            from cotree.model.failures import check_guards

            check_guards(self._text.program.guards, p)
        if status:
            # The guards accept the values, so a linear system is singular.
            raise self._failure(status, "prepare", {"p": bound.p})

    def __call__(self, name: str, t: float, x: Array, s: Array, u: Array) -> Array:
        """Evaluate a kernel; arguments that it does not use are ignored.

        Raise SingularSystemError if a linear system of the kernel is singular.
        """
        bound = self._own.bound
        function, arguments, result, is_timed = bound[name]
        # Values are copied to bound arrays, because new pointers cost more than a small kernel.
        if x.size:
            bound.x[: x.size] = x
        if s.size:
            bound.s[: s.size] = s  # event_rates takes a single column of sensitivities
        if u.size:
            bound.u[: u.size] = u
        status = function(t, *arguments) if is_timed else function(*arguments)
        if status:
            known = {"t": [t], "x": bound.x, "s": bound.s, "u": bound.u, "p": bound.p}
            raise self._failure(status, name, known)
        return result

    def prepared(self) -> Array:
        """Return the values that ``prepare`` computed for this thread, in a new array."""
        return self._own.bound.k.copy()

    def address(self, name: str) -> int | None:
        """Return the address of a C kernel, or None if the library does not contain it."""
        if name not in self._text.traits.n_results:
            return None
        return int(self.library.ffi.cast("uintptr_t", self._own.bound[name][0]))

    def _failure(self, status: int, name: str, known: Mapping[str, Any]) -> Exception:
        if status == SINGULAR:
            from cotree.model.failures import singular

            return singular(self._text.program, name, known)
        return SolveError(f"a kernel of the model failed with status {status}")


#: Error message of calls that need a compiler.
NO_COMPILER = (
    "Evaluations and simulations need a C compiler, and none was found: run `pip install "
    "ziglang`. Equations, C and FMU sources can be written without a compiler."
)


class MissingKernels(Kernels):
    """Substitute for kernels on a machine without a compiler: every call raises SolveError."""

    backend = "none"

    def __init__(self) -> None:
        pass

    def prepare(self, p: Array) -> None:
        """Raise SolveError."""
        raise SolveError(NO_COMPILER)

    def address(self, name: str) -> int | None:
        """Return None."""
        return None

    def __call__(self, name: str, t: float, x: Array, s: Array, u: Array) -> Array:
        """Raise SolveError."""
        raise SolveError(NO_COMPILER)


class SharedCode(NamedTuple):
    """C text shared by all models."""

    files: Mapping[str, str]  # contents of the C files by name
    declarations: str  # C declarations for cffi


def shared_code(library: str, stepper: str = "", *, has_events: bool = True) -> SharedCode:
    """Return the cached C text of a library; only ``engine`` depends on the other arguments."""

    def render() -> SharedCode:
        from cotree.codegen.c_files import library_texts

        return SharedCode(*library_texts(library, stepper, has_events=has_events))

    return cached((library, stepper, has_events), render)


def build_engine(code: SharedCode) -> LoadedLibrary | None:
    """Build and load C text shared by all models; return None if that is impossible."""
    toolchain = find_toolchain()
    if toolchain is None:
        return None
    # Vectorised sums accelerate the steps in engine.c by 20 to 25 %, but slow down compilation.
    try:
        _, loaded = obtain_library(
            code.files,
            code.declarations,
            abi_version=ABI_VERSION,
            # This has no effect, because the optimisation levels are set below.
            n_operations=1,
            options=BuildOptions("-O1"),
            toolchain=toolchain,
            levels={"engine.c": loop_flags(toolchain)},
        )
    except BuildError:
        return None
    return loaded


@locked_cache
def load_columns() -> LoadedLibrary | None:
    """Build and load the C loop over points; return None if that is impossible."""
    return build_engine(shared_code("columns"))


@dataclass(frozen=True, eq=False)
class Rows:
    """Points in the C layout, with one row each; p has one row for each point or for all."""

    t: Array
    x: Array
    s: Array
    p: Array
    has_own: bool = False  # whether each point has its own parameters


def call_columns(
    library: LoadedLibrary,
    model: CompiledModel,
    name: str,
    points: Rows,
    inputs: Array,
    results: Array,
    *,
    has_inputs: bool,
) -> int:
    """Evaluate points in C until one fails; return the number of points before it.

    Without ``has_inputs``, the inputs of the scene are written to ``inputs``. A model without the
    kernel has no results, and only its inputs are evaluated.
    """
    ffi, spec, prepared = library.ffi, KERNELS[name], model.prepared(points.p[0])
    kernel = ffi.cast(spec.type, model.address(name) or 0)
    is_of_states = spec.type == "cotree_state_kernel"
    pointer = partial(pointer_to, ffi)
    return int(
        library.lib.cotree_columns(
            ffi.cast("cotree_model *", model.code.model_address),
            kernel if is_of_states else ffi.NULL,
            ffi.NULL if is_of_states else kernel,
            len(points.t),
            pointer(points.t),
            pointer(points.x),
            points.x.shape[1],
            pointer(points.s),
            points.s.shape[1],
            pointer(points.p),
            pointer(prepared),
            pointer(prepared) if points.has_own else ffi.NULL,
            has_inputs,
            pointer(inputs),
            pointer(results),
            results.shape[1],
        )
    )
