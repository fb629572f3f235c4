"""Compiled C kernels as Python functions of contiguous arrays of doubles.

A kernel returns a buffer, which its next call overwrites. Each thread has its own buffers and
prepared parameters. Kernels of implicit methods (``cotree_newton``) are built at first use.
"""

from __future__ import annotations

import contextlib
import threading
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from cotree.build import (
    BuildOptions,
    BuiltLibrary,
    LoadedLibrary,
    find_toolchain,
    loop_flags,
    obtain_library,
)
from cotree.build.cache import cached
from cotree.errors import BuildError, SolveError
from cotree.model.arrays import Array, pointer_to
from cotree.program.kernels import KERNELS
from cotree.sharing import forming, locked_cache, locked_cached_property
from cotree.version import ABI_VERSION

if TYPE_CHECKING:
    from collections.abc import Mapping

    from cotree.codegen.newton import StepWork
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


def _load_points(text: ModelText, name: str) -> LoadedLibrary | None:
    from cotree.model.columns import load_points

    return load_points(text, name)


def load_kernels(
    files: Mapping[str, str], declarations: str, n_written: int, n_all: int, options: BuildOptions
) -> LoadedLibrary | None:
    """Build and load additional C functions of a model; return None if that is impossible."""
    with contextlib.suppress(BuildError):
        return obtain_kernels(files, declarations, n_written, n_all, options)[1]
    return None


def obtain_kernels(
    files: Mapping[str, str], declarations: str, n_written: int, n_all: int, options: BuildOptions
) -> tuple[BuiltLibrary, LoadedLibrary]:
    """Build and load C functions of a model; raise BuildError if that is impossible.

    ``n_written`` and ``n_all`` are the operations of the longest function and of all together.
    """
    toolchain = find_toolchain()
    if toolchain is None:
        raise BuildError(NO_COMPILER)
    return obtain_library(
        files,
        declarations,
        abi_version=ABI_VERSION,
        n_operations=n_written,
        n_all=n_all,
        options=options,
        toolchain=toolchain,
    )


def _step_work(program: Program) -> StepWork | None:
    from cotree.codegen.newton import count_step_work

    return count_step_work(program)


#: Status of a kernel whose linear system is singular.
SINGULAR = 1


class _LoadedModel:
    """The ``cotree_model`` of a library, to which a long Jacobian is added when first needed."""

    def __init__(self, text: ModelText, library: LoadedLibrary, options: BuildOptions) -> None:
        self._text, self._ffi, self._options = text, library.ffi, options
        self.c = self._own(library)
        if text.is_divided:
            # The structure in the library is constant, so the Jacobian is added to a copy.
            self.c = self._ffi.new("cotree_model *", self.c[0])
        self._lock = threading.Lock()
        self._jacobian: LoadedLibrary | None = None

    def complete(self) -> None:
        """Build and load a Jacobian that the library lacks, at the first call."""
        if not self._text.is_divided or self._jacobian is not None:
            return
        # Printed before, because threads that hold the lock for forming may wait for this lock.
        files, n_written, n_all = self._printed
        with self._lock:
            if self._jacobian is None:
                _, library = obtain_kernels(
                    files, self._text.declarations, n_written, n_all, self._options
                )
                function = self._own(library).jacobian
                self.c.jacobian = self._ffi.cast(KERNELS["jacobian"].type, function)
                self._jacobian = library  # the reference keeps the code in memory

    @locked_cached_property
    def _printed(self) -> tuple[Mapping[str, str], int, int]:
        from cotree.model.further import jacobian_files

        return jacobian_files(self._text)

    def _own(self, library: LoadedLibrary) -> Any:
        """Return the ``cotree_model`` in a library; raise BuildError if it is another model's."""
        model = getattr(library.lib, f"{self._text.prefix}_abi")()
        # In other versions, the structure may have a different layout.
        if model.abi_version != ABI_VERSION or model.n_states != len(self._text.layout.states):
            raise BuildError("the loaded library belongs to another model: clear the cache")
        return model


class _Bound(dict[str, tuple[Any, tuple[Any, ...], Array, bool]]):
    """Each kernel of a thread: function, arguments, result, and whether t is an argument."""

    def __init__(self, text: ModelText, library: LoadedLibrary, model: _LoadedModel) -> None:
        super().__init__()
        ffi, layout = library.ffi, text.layout
        self._n_results, self._model, self._ffi = text.traits.n_results, model, ffi
        n, m = len(layout.states), len(layout.sensitivities)
        self.x, self.s, self.u = np.zeros(n), np.zeros(n * max(m, 1)), np.zeros(len(layout.inputs))
        self.p, self.k = np.zeros(len(layout.parameters)), np.zeros(model.c.n_prepared)
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
        if name == "jacobian":
            self._model.complete()
        function = getattr(self._model.c, spec.field)
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

    def __init__(self, text: ModelText, library: LoadedLibrary, model: _LoadedModel) -> None:
        self.bound = _Bound(text, library, model)


class Kernels:
    """Kernels of a loaded library, whose buffers and pointers each thread binds once.

    Attributes
    ----------
    library : LoadedLibrary
        The library.
    newton : callable
        Returns ``cotree_newton``, built at the first call; None if that is impossible.
    in_lanes : callable
        Returns the library of a kernel in SIMD lanes by name; None if that is impossible.
    step_work : callable
        Returns the operation counts of an implicit step, or None if they are unknown.
    """

    backend = "C"

    def __init__(
        self, text: ModelText, library: LoadedLibrary, options: BuildOptions | None = None
    ) -> None:
        self.library = library  # the reference keeps the code in memory
        self._text, self._model = text, _LoadedModel(text, library, options or BuildOptions())
        self._own = _OwnBuffers(text, library, self._model)
        self.newton = locked_cache(lambda: load_newton(text.program))
        self.step_work = locked_cache(lambda: _step_work(text.program))
        self.in_lanes = locked_cache(partial(_load_points, text))

    def address_for(self, *, is_implicit: bool) -> int:
        """Return the address of the ``cotree_model``; the Jacobian may be NULL if not needed."""
        if is_implicit or self._text.layout.n_algebraic:
            self._model.complete()
        return int(self.library.ffi.cast("uintptr_t", self._model.c))

    def prepare(self, p: Array) -> None:
        """Set the parameters for this thread; raise ParameterError if a guard rejects them."""
        bound = self._own.bound
        bound.p[:] = p
        status = self._model.c.prepare(*bound.prepared)
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
    # Vectorised sums accelerate the steps by 20 to 25 %, but slow down compilation.
    flags = loop_flags(toolchain)
    try:
        _, loaded = obtain_library(
            code.files,
            code.declarations,
            abi_version=ABI_VERSION,
            # This has no effect, because the optimisation levels are set below.
            n_operations=1,
            options=BuildOptions("-O1"),
            toolchain=toolchain,
            levels=dict.fromkeys({"engine.c", "cotree_adjoint.c"} & code.files.keys(), flags),
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
            ffi.cast("cotree_model *", model.code.address_for(is_implicit=False)),
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
