"""Compiled C kernels as Python functions of contiguous arrays of doubles.

A result is a buffer of its kernel: copy it to keep it. Each thread has its own buffers and prepared
parameters. The kernels of implicit methods (``cotree_newton``) are built at their first use.
"""

from __future__ import annotations

import contextlib
import threading
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from cotree.build import BuildOptions, LoadedLibrary, find_toolchain, loop_flags, obtain_library
from cotree.build.cache import cached
from cotree.errors import BuildError, SolveError
from cotree.model.arrays import Array, pointer_to
from cotree.program.kernels import KERNELS
from cotree.records import changed
from cotree.sharing import forming, locked_cache
from cotree.version import ABI_VERSION

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from cotree.codegen.context import KernelFile
    from cotree.program.layout import Layout
    from cotree.program.program import Program
    from cotree.program.text import ModelText


@dataclass(frozen=True, eq=False)
class Newton:
    """C functions of a model for the factorisation and the second derivatives of Newton steps."""

    address: int  # address of the function ``cotree_newton``
    library: LoadedLibrary  # loaded library; the reference keeps its code in memory


def load_newton(program: Program) -> Newton | None:
    """Build and load a model's ``cotree_newton``, or return None if that is impossible."""
    if find_toolchain() is None:
        return None
    # Imported here, because runs with explicit methods generate no C.
    from cotree.codegen.newton import newton_context, newton_declarations, render_newton

    # Second derivatives add nodes to the graph, which threads share.
    with forming:
        model = newton_context(program)
        files = render_newton(model)
    loaded = load_kernels(model, files, newton_declarations(model), BuildOptions())
    if loaded is None:
        return None
    address = getattr(loaded.lib, f"{model.prefix}_newton")()
    return Newton(int(loaded.ffi.cast("uintptr_t", address)), loaded)


def load_kernels(
    model: KernelFile, files: Mapping[str, str], declarations: str, options: BuildOptions
) -> LoadedLibrary | None:
    """Build and load further C functions of a model, or return None if that is impossible."""
    toolchain = find_toolchain()
    with contextlib.suppress(BuildError):
        if toolchain is not None:
            return obtain_library(
                files,
                declarations,
                abi_version=ABI_VERSION,
                n_operations=model.n_written,
                n_all=model.n_written_in_all,
                options=options,
                toolchain=toolchain,
            )[1]
    return None


@dataclass(frozen=True)
class StepWork:
    """Numbers of operations in one implicit step, by part."""

    #: Numbers of operations of the rates, the rates with sensitivities, and the Jacobian.
    rates: int
    augmented: int
    jacobian: int
    #: Numbers of factors of the planned sparse elimination, and of products to compute them.
    n_factors: int
    n_products: int
    is_unrolled: bool  # whether the C code has no loops
    #: The same numbers for an elimination with row exchanges, banded if the band is narrow.
    n_banded: int
    n_banded_products: int


def count_step_work(program: Program) -> StepWork | None:
    """Count operations of implicit steps; None if their matrices are structurally singular."""
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


#: Status that a kernel returns if a linear system is singular.
SINGULAR = 1


@dataclass(frozen=True, eq=False)
class NativeModel:
    """A C model with prepared parameters, as the C integrators take it."""

    address: int  # address of the function ``cotree_model``
    #: Parameters, and the values that ``prepare`` has computed from them.
    p: Array
    k: Array
    library: LoadedLibrary  # loaded library; the reference keeps its code in memory
    layout: Layout
    can_extend: bool  # whether the library can compute rates of the algebraic unknowns
    #: Function that returns the ``cotree_newton``, built at the first call, or None if impossible.
    newton: Callable[[], Newton | None]
    #: Function that returns the operation counts of implicit steps, or None if there are none.
    work: Callable[[], StepWork | None]


class _Bound(dict[str, tuple[Any, tuple[Any, ...], Array, bool]]):
    """Kernels of one thread, each bound to its argument pointers at its first call.

    A kernel name maps to C function, arguments, result, and whether time is the first argument.
    """

    def __init__(self, text: ModelText, library: LoadedLibrary, model: Any) -> None:
        super().__init__()
        ffi, layout = library.ffi, text.layout
        self._n_results, self._model, self._ffi = text.traits.n_results, model, ffi
        n, m = len(layout.states), len(layout.sensitivities)
        self.x, self.s, self.u = np.zeros(n), np.zeros(n * max(m, 1)), np.zeros(len(layout.inputs))
        self.p, self.k = np.zeros(len(layout.parameters)), np.zeros(model.n_prepared)
        self._pointers = {key: pointer_to(self._ffi, getattr(self, key)) for key in "xsupk"}
        # The arguments of `prepare`: the parameters that it reads, and the values that it writes.
        self.prepared = (self._pointers["p"], self._pointers["k"])

    def __missing__(self, name: str) -> tuple[Any, tuple[Any, ...], Array, bool]:
        if name not in self._n_results:  # the kernel has no results, so it is not called
            self[name] = absent = (lambda *_: 0), (), np.zeros(0), True
            return absent
        # All arguments except time, which is passed by value, are pointers that never change.
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
    """Kernels of a loaded library, whose buffers and pointers each thread binds once."""

    backend = "C"

    def __init__(self, text: ModelText, library: LoadedLibrary) -> None:
        layout = text.layout
        model = getattr(library.lib, f"{text.prefix}_abi")()
        # The structure may have other fields in other versions.
        if model.abi_version != ABI_VERSION or model.n_states != len(layout.states):
            raise BuildError("the loaded library belongs to another model: clear the cache")
        self._library = library  # the reference keeps the code in memory
        self._model, self._text = model, text
        self._own = _OwnBuffers(text, library, model)
        # `native` replaces the parameters.
        self._native = NativeModel(
            int(library.ffi.cast("uintptr_t", model)),
            np.zeros(0),
            np.zeros(0),
            library,
            layout,
            text.traits.can_extend(layout),
            locked_cache(lambda: load_newton(text.program)),
            locked_cache(lambda: count_step_work(text.program)),
        )

    def prepare(self, p: Array) -> None:
        """Set the parameters for all further calls in this thread.

        Raise ParameterError if a guard of the model rejects them.
        """
        bound = self._own.bound
        bound.p[:] = p
        status = self._model.prepare(*bound.prepared)
        # C returns only a status; Python evaluates the guards again to name the rejected value.
        if status < 0:
            from cotree.model.failures import check_guards

            check_guards(self._text.program.guards, p)
        if status:
            # No guard has rejected the values, so a linear system is singular.
            raise self._failure(status, "prepare", {"p": bound.p})

    def __call__(self, name: str, t: float, x: Array, s: Array, u: Array) -> Array:
        """Evaluate a kernel; arguments that it does not use are ignored.

        Raise SingularSystemError if a linear system of the kernel is singular.
        """
        bound = self._own.bound
        function, arguments, result, is_timed = bound[name]
        # Values are copied behind bound pointers: new pointers cost more than a small kernel.
        if x.size:
            bound.x[: x.size] = x
        if s.size:
            bound.s[: s.size] = s  # event_rates takes the sensitivities of a single direction
        if u.size:
            bound.u[: u.size] = u
        status = function(t, *arguments) if is_timed else function(*arguments)
        if status:
            known = {"t": [t], "x": bound.x, "s": bound.s, "u": bound.u, "p": bound.p}
            raise self._failure(status, name, known)
        return result

    def native(self) -> NativeModel | None:
        """Return the C model with this thread's parameters, or None without a compiler."""
        # Copies, since this thread may prepare other parameters during the run.
        bound = self._own.bound
        return changed(self._native, p=bound.p.copy(), k=bound.k.copy())

    def address(self, name: str) -> int | None:
        """Return the address of a C kernel, or None if the library has no such kernel."""
        if name not in self._text.traits.n_results:
            return None
        return int(self._library.ffi.cast("uintptr_t", self._own.bound[name][0]))

    def _failure(self, status: int, name: str, known: Mapping[str, Any]) -> Exception:
        if status == SINGULAR:
            from cotree.model.failures import singular

            return singular(self._text.program, name, known)
        return SolveError(f"a kernel of the model failed with status {status}")


#: Error message of calls that need compiled kernels.
NO_COMPILER = (
    "There is no C compiler, and evaluations and simulations need one: `pip install ziglang` "
    "brings one. Equations, C and FMU sources are written without it."
)


class MissingKernels(Kernels):
    """Substitute for kernels on a machine without a compiler: every call raises SolveError."""

    backend = "none"

    def __init__(self) -> None:
        pass

    def prepare(self, p: Array) -> None:
        """Raise SolveError."""
        raise SolveError(NO_COMPILER)

    def native(self) -> NativeModel | None:
        """Return None."""
        return None

    def address(self, name: str) -> int | None:
        """Return None."""
        return None

    def __call__(self, name: str, t: float, x: Array, s: Array, u: Array) -> Array:
        """Raise SolveError."""
        raise SolveError(NO_COMPILER)


class SharedCode(NamedTuple):
    """C text that is the same for all models."""

    files: Mapping[str, str]  # contents of the C files by name
    declarations: str  # C declarations for cffi
    shared: frozenset[str]  # names of files that several libraries include


def shared_code(library: str, stepper: str = "", *, has_events: bool = True) -> SharedCode:
    """Return the C text of a library in :data:`cotree.codegen.c_files.LIBRARIES`, cached.

    The library ``engine`` also depends on the stepper, and on whether models have events.
    """

    def render() -> SharedCode:
        from cotree.codegen.c_files import library_texts, shared_files

        files, declared = library_texts(library, stepper, has_events=has_events)
        return SharedCode(files, declared, shared_files(files))

    return cached((library, stepper, has_events), render)


def build_engine(code: SharedCode) -> LoadedLibrary | None:
    """Build and load C text that is the same for all models; return None if that is impossible."""
    toolchain = find_toolchain()
    if toolchain is None:
        return None
    # Vectorised sums over equations make steps a fifth faster for 8 equations, a quarter for 36.
    # The other files would compile more slowly with these flags and run no faster.
    try:
        _, loaded = obtain_library(
            code.files,
            code.declarations,
            abi_version=ABI_VERSION,
            # Without effect, since the optimisation levels are given below.
            n_operations=1,
            options=BuildOptions("-O1"),
            toolchain=toolchain,
            levels={"engine.c": loop_flags(toolchain)},
            shared=code.shared,
        )
    except BuildError:
        return None
    return loaded
