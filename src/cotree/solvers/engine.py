"""The C engine of a stepper: built once on a machine, loaded, and given jobs.

CVODE and IDA come with scikit-sundae, CVODES and IDAS with SUNDIALS' own package sundials4py. The
environment variable COTREE_SUNDIALS names a library that replaces both.

In: a name in ``codegen.c_files.STEPPERS``. Out: the library that runs jobs, with the functions
of SUNDIALS that it calls; or the reason of a failure.
"""

from __future__ import annotations

import contextlib
import importlib
import importlib.util
import os
import re
import sys
import threading
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, NoReturn

import numpy as np

from cotree.build import LoadedLibrary, abandon
from cotree.errors import BuildError, Error, SolveError
from cotree.methods import METHODS, SUNDIALS, SUNDIALS_VERSION, WITH_SENSITIVITIES
from cotree.model.arrays import pointer_to
from cotree.model.kernels import NativeModel, SharedCode, build_engine, shared_code
from cotree.sharing import locked_cache

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from cotree.model.model import CompiledModel
    from cotree.solvers.result import FloatArray


#: Environment variable that contains the path of a SUNDIALS library.
VARIABLE = "COTREE_SUNDIALS"

# Oldest version of Python that sundials4py supports.
_LEAST_PYTHON = (3, 12)


def check_installed(method: str) -> None:
    """Raise SolveError if the package with "cvode" or "ida" is not installed."""
    try:
        # Imported, not only searched for, since a part of the package may be missing.
        importlib.import_module(f"sksundae.{method}")
    except ImportError as error:
        raise SolveError(
            f"The method '{method}' needs SUNDIALS: run `pip install scikit-sundae`, or use "
            "'rodas5'."
        ) from error


def has_sundials() -> bool:
    """Return whether the package with CVODE and IDA is installed."""
    return importlib.util.find_spec("sksundae") is not None


class LibraryPath(NamedTuple):
    """The file of a library, or why it is missing, without a capital and a full stop."""

    path: str
    why_not: str = ""


def library_path(library: str) -> LibraryPath:
    """Return the file with a library of SUNDIALS: "cvode", "ida", "cvodes" or "idas"."""
    named = os.environ.get(VARIABLE, "")
    # A library named by the user is never replaced by another one.
    if named:
        if os.path.isfile(named):
            return LibraryPath(os.path.abspath(named))
        return LibraryPath("", f"{VARIABLE} names '{named}', and there is no such file")
    if library in WITH_SENSITIVITIES:
        return _in_sundials4py(library)
    name = f"_cy_{library}"
    try:
        module = importlib.import_module(f"sksundae.{name}")
    except ImportError:
        return LibraryPath("", f"scikit-sundae has no module '{name}'")
    return LibraryPath(str(module.__file__))


def open_sundials(ffi: Any, library: str, path: str) -> tuple[Any, Any] | str:
    """Open a library of SUNDIALS and find the functions that an engine calls.

    Returns a ``cotree_sundials`` and the opened library; or the reason of a failure, without a
    capital and a full stop. ``ffi`` is the engine's and declares these functions.
    """
    # cotree's own methods do not need the modules that print C.
    from cotree.codegen.c_files import sundials_functions

    try:
        # Lazy binding, since the module's Python functions are not needed.
        opened = ffi.dlopen(path, ffi.RTLD_LAZY)
        # Functions of another version may have other arguments.
        version = version_of(ffi, opened, path)
        if version != SUNDIALS_VERSION:
            here, known = (".".join(map(str, v)) or "unknown" for v in (version, SUNDIALS_VERSION))
            return f"SUNDIALS is of version {here}, not {known}"
        functions = ffi.new("cotree_sundials *")
        for function in sundials_functions(library):
            setattr(functions, function, ffi.addressof(opened, function))
    except (OSError, AttributeError) as error:
        return f"SUNDIALS' functions cannot be found ({error})"
    return functions, opened


def version_of(ffi: Any, library: Any, path: str) -> tuple[int, ...]:
    """Return the major and minor version of an opened library; empty if unknown.

    sundials4py lacks the function that returns it; the package has the version of SUNDIALS, which
    the name of its metadata contains.
    """
    try:
        get_version = library.SUNDIALSGetVersionNumber
    except AttributeError:
        for folder in Path(path).parent.glob("sundials4py-*.dist-info"):
            found = re.match(r"sundials4py-(\d+)\.(\d+)\.", folder.name)
            if found:
                return int(found[1]), int(found[2])
        return ()
    major, minor, patch = (ffi.new("int *") for _ in range(3))
    failed = get_version(major, minor, patch, ffi.new("char[32]"), 32)
    return () if failed else (major[0], minor[0])


def _in_sundials4py(library: str) -> LibraryPath:
    """Find the module, which is a library itself; it need not be imported."""
    try:
        spec = importlib.util.find_spec("sundials4py")
    except (ImportError, ValueError):
        spec = None
    if spec is not None and spec.origin is not None and os.path.isfile(spec.origin):
        return LibraryPath(spec.origin)
    version = ".".join(map(str, SUNDIALS_VERSION))
    least, here = (".".join(map(str, v[:2])) for v in (_LEAST_PYTHON, sys.version_info))
    install = "run `pip install sundials4py` (the extra cotree[sundials])"
    if sys.version_info[:2] < _LEAST_PYTHON:
        install = f"take Python {least} or later, here it is {here}, and {install}"
    why = (
        f"it needs SUNDIALS' {library.upper()}: {install}, or name the file of a library of "
        f"SUNDIALS {version} that has it in the environment variable {VARIABLE}"
    )
    return LibraryPath("", why)


# Threads that build engines ahead of runs.
_ahead: list[threading.Thread] = []


@dataclass(frozen=True, eq=False)
class Engine:
    """The engine of a stepper."""

    stepper: str  # name of the stepper in ``STEPPERS``
    has_events: bool  # whether its jobs may have events
    library: LoadedLibrary  # library that runs jobs
    #: A ``cotree_sundials`` structure with the functions that the stepper calls.
    functions: Any = None
    sundials: Any = None  # reference to the library of SUNDIALS, which keeps it loaded


def build_ahead(
    *methods: str, has_events: bool = True, then: Sequence[Callable[[], object]] = ()
) -> None:
    """Build or load the engines of methods in a thread, while the model is compiled.

    Methods without an engine and unknown ones are ignored; ``then`` is called afterwards.
    """
    # The choice of a method starts with steps of dop853.
    rows = [METHODS.get("dop853" if method == "auto" else method) for method in methods]
    steppers = [row.stepper for row in rows if row is not None and row.stepper]
    if steppers:
        # The text is rendered here, so that the compiler starts early.
        _code_of(steppers[0], has_events)
        thread = threading.Thread(
            target=_prepare, args=(steppers, then, has_events), name="cotree-engine"
        )
        _ahead.append(thread)
        thread.start()


def abandon_ahead() -> None:
    """End the threads of runs that will not take place, so that the program can end."""
    for thread in _ahead:
        abandon(thread)


def _prepare(
    steppers: Sequence[str], then: Sequence[Callable[[], object]], has_events: bool
) -> None:
    # A run that needs the engine raises the same error. RuntimeError: the program has ended, and
    # pools of threads accept no more work.
    with contextlib.suppress(Error, RuntimeError):
        # One after the other, since later engines use shared object files from the cache.
        for stepper in steppers:
            load_engine(stepper, has_events=has_events)
        for load in then or (load_sweep,):
            load()


def load_engine(stepper: str, *, has_events: bool = True) -> Engine | str:
    """Build and load the engine of a stepper once, or return why that fails.

    Without events it is compiled in half of the time; it runs models without events and kinks.
    """
    if stepper not in SUNDIALS:
        return _opened(stepper, "", has_events)
    found = library_path(stepper)
    # The path is part of the key, since the environment may change.
    return found.why_not or _opened(stepper, found.path, has_events)


@locked_cache
def _code_of(stepper: str, has_events: bool) -> SharedCode:
    return shared_code("engine", stepper, has_events=has_events)


@locked_cache
def _opened(stepper: str, path: str, has_events: bool) -> Engine | str:
    """Build an engine, and open the library of SUNDIALS that a path names, if any."""
    library = build_engine(_code_of(stepper, has_events))
    if library is None:
        return "no compiler can build its engine"
    if not path:
        return Engine(stepper, has_events, library)
    opened = open_sundials(library.ffi, stepper, path)
    return opened if isinstance(opened, str) else Engine(stepper, has_events, library, *opened)


if TYPE_CHECKING:
    Inputs = Callable[[float], FloatArray | None]


def sweep(
    model: CompiledModel, native: NativeModel, u: Inputs, t: FloatArray, z: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Evaluate outputs, their sensitivities and inputs at many points.

    Parameters
    ----------
    model : CompiledModel
        The model.
    native : NativeModel
        The model in C with its parameters.
    u : callable
        Inputs at a time; None leaves them to the model.
    t, z : ndarray, shapes (n_t,) and (n_states * (1 + n_sensitivities), n_t)
        Times, [s], and states with sensitivities.

    Returns
    -------
    outputs, sensitivities, inputs : ndarray
        Shapes (n_outputs, n_t), (n_outputs, n_sensitivities, n_t) and (n_inputs, n_t).

    Raises
    ------
    SingularSystemError
        If an output is not determined somewhere.
    BuildError
        If no compiler can build the loop over the points.
    """
    if not model.outputs and not model.inputs:
        return (
            np.zeros((0, len(t))),
            np.zeros((0, len(model.sensitivities), len(t))),
            np.zeros((0, len(t))),
        )
    library = load_sweep()
    if library is None:
        raise BuildError("no compiler can build the loop over the points of a run")
    return _in_c(model, native, library, u, t, z) or _blame(model, native.p, u, t, z)


@locked_cache
def load_sweep() -> LoadedLibrary | None:
    """Build and load the loop over points; None without a compiler."""
    return build_engine(shared_code("sweep"))


def _in_c(
    model: CompiledModel,
    native: NativeModel,
    library: LoadedLibrary,
    u: Inputs,
    t: FloatArray,
    z: FloatArray,
) -> tuple[FloatArray, FloatArray, FloatArray] | None:
    """Evaluate all points at once; None if a kernel fails somewhere."""
    n_t, n_outputs, m = len(t), len(model.outputs), len(model.sensitivities)
    # C evaluates inputs of the scene; inputs of the run are passed.
    inputs = np.zeros((n_t, len(model.inputs)))
    has_inputs = False
    if model.inputs and u(float(t[0])) is not None:
        inputs[:] = [u(float(at)) for at in t]
        has_inputs = True
    outputs, slopes = np.zeros((n_t, n_outputs)), np.zeros((n_t, m, n_outputs))
    ffi = library.ffi
    pointer = partial(pointer_to, ffi)
    # C reads point after point, hence the transpose of z.
    status = library.lib.cotree_sweep(
        ffi.cast("cotree_model *", native.address),
        pointer(native.p),
        pointer(native.k),
        n_t,
        pointer(np.ascontiguousarray(t, dtype=np.float64)),
        pointer(np.ascontiguousarray(z.T)),
        len(z),
        has_inputs,
        pointer(inputs),
        pointer(outputs),
        pointer(slopes),
    )
    # The caller evaluates the points again in Python, whose error names the cause.
    if status != 0:
        return None
    # C writes point after point, while time is the last axis of results.
    return outputs.T.copy(), slopes.transpose(2, 1, 0).copy(), inputs.T.copy()


def _blame(
    model: CompiledModel, p: FloatArray, u: Inputs, t: FloatArray, z: FloatArray
) -> NoReturn:
    """Raise the error of the first point at which outputs are undetermined."""
    n, m = len(model.states), len(model.sensitivities)
    for j, at in enumerate(t.tolist()):
        known, y, s = u(at), z[:n, j], z[n:, j].reshape(m, n).T
        model.output_values(at, y, p, known)
        if m:
            model.output_sensitivity(at, y, s, p, known)
    raise SolveError("the outputs cannot be evaluated along the run")
