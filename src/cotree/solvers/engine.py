"""C engines, one for each stepper: each is built once per machine, and integrates jobs."""

from __future__ import annotations

import contextlib
import importlib.util
import threading
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any, NoReturn

import numpy as np

from cotree.build import LoadedLibrary, abandon
from cotree.errors import BuildError, Error, SolveError
from cotree.methods import METHODS, SUNDIALS
from cotree.model.kernels import (
    Rows,
    SharedCode,
    build_engine,
    call_columns,
    load_columns,
    shared_code,
)
from cotree.sharing import locked_cache

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from cotree.model.bound import BoundModel
    from cotree.solvers.result import FloatArray


def has_sundials() -> bool:
    """Return whether scikit-sundae, the package with CVODE and IDA, is installed."""
    return importlib.util.find_spec("sksundae") is not None


# Threads that build engines before runs need them.
_ahead: list[threading.Thread] = []


@dataclass(frozen=True, eq=False)
class Engine:
    """A loaded C engine that integrates with one stepper."""

    stepper: str  # name of the stepper in ``STEPPERS``
    library: LoadedLibrary  # contains the functions that run jobs
    #: Table of SUNDIALS functions, of type ``cotree_sundials``; None for other steppers.
    functions: Any = None
    sundials: Any = None  # SUNDIALS library; the reference keeps it loaded


def build_ahead(
    *methods: str, has_events: bool = True, then: Sequence[Callable[[], object]] = ()
) -> None:
    """Start a thread that builds the engines of methods, then calls each function of ``then``."""
    # Method "auto" starts with dop853.
    rows = [METHODS.get("dop853" if method == "auto" else method) for method in methods]
    steppers = [row.stepper for row in rows if row is not None and row.stepper]
    if steppers:
        # The C code is rendered before the thread starts, so that the compiler starts early.
        _code_of(steppers[0], has_events)
        thread = threading.Thread(
            target=_prepare, args=(steppers, then, has_events), name="cotree-engine"
        )
        _ahead.append(thread)
        thread.start()


def abandon_ahead() -> None:
    """Abandon the threads that build engines, so that the program can end."""
    for thread in _ahead:
        abandon(thread)


def _prepare(
    steppers: Sequence[str], then: Sequence[Callable[[], object]], has_events: bool
) -> None:
    # Errors are ignored here, because a run that needs the engine raises them again. At the end of
    # the program, thread pools raise a RuntimeError.
    with contextlib.suppress(Error, RuntimeError):
        # Engines are built in sequence, because later ones reuse object files of earlier ones.
        for stepper in steppers:
            load_engine(stepper, has_events=has_events)
        for load in then or (load_columns,):
            load()


def load_engine(stepper: str, *, has_events: bool = True) -> Engine | str:
    """Return the engine of a stepper, built and loaded once, or the reason why that fails.

    An engine without events and kinks compiles in half the time.
    """
    if stepper not in SUNDIALS:
        return _opened(stepper, "", has_events)
    from cotree.solvers.sundials import library_path

    found = library_path(stepper)
    # The cache key contains the path of SUNDIALS, because the environment may change.
    return found.why_not or _opened(stepper, found.path, has_events)


@locked_cache
def _code_of(stepper: str, has_events: bool) -> SharedCode:
    return shared_code("engine", stepper, has_events=has_events)


@locked_cache
def _opened(stepper: str, path: str, has_events: bool) -> Engine | str:
    """Build an engine; if ``path`` is not empty, open the SUNDIALS library there."""
    library = build_engine(_code_of(stepper, has_events))
    if library is None:
        return "no compiler can build its engine"
    if not path:
        return Engine(stepper, library)
    from cotree.solvers.sundials import open_sundials

    opened = open_sundials(library.ffi, stepper, path)
    return opened if isinstance(opened, str) else Engine(stepper, library, *opened)


def sweep(
    native: BoundModel, t: FloatArray, z: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return outputs (n_outputs, n_t), sensitivities (n_outputs, n_sensitivities, n_t) and inputs.

    Raises SingularSystemError if an output is undetermined at a point, BuildError without compiler.
    """
    model = native.model
    if not model.outputs and not model.inputs:
        none = np.zeros((0, len(t)))
        return none, np.zeros((0, len(model.sensitivities), len(t))), none
    library = load_columns()
    if library is None:
        raise BuildError("no compiler can build the loop over the points of a run")
    return _in_c(native, library, t, z) or _blame(native, t, z)


def _in_c(
    native: BoundModel, library: LoadedLibrary, t: FloatArray, z: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray] | None:
    """Evaluate all points in one C call; return None if a kernel fails at a point."""
    model, u, n = native.model, native.inputs_at, len(native.model.states)
    # C evaluates inputs that the scene defines, and reads inputs set for this run from an array.
    inputs = np.zeros((len(t), len(model.inputs)))
    has_inputs = bool(model.inputs) and u(float(t[0])) is not None
    if has_inputs:
        inputs[:] = [u(float(at)) for at in t]
    outputs = np.zeros((len(t), len(model.outputs)))
    slopes = np.zeros((len(t), len(model.sensitivities), len(model.outputs)))
    rows = Rows(
        np.ascontiguousarray(t, dtype=np.float64),
        np.ascontiguousarray(z[:n].T),
        np.ascontiguousarray(z[n:].T),
        native.p[None, :],
    )
    evaluate = partial(call_columns, library, model)
    done = evaluate("outputs", rows, inputs, outputs, has_inputs=has_inputs)
    if slopes.size and done == len(t):
        flat = slopes.reshape(len(t), -1)
        done = evaluate("output_sensitivity", rows, inputs, flat, has_inputs=True)
    # The caller evaluates the points again in Python to raise an error that names the cause.
    if done < len(t):
        return None
    # C writes one row per point, while time is the last axis of results.
    return outputs.T.copy(), slopes.transpose(2, 1, 0).copy(), inputs.T.copy()


def _blame(native: BoundModel, t: FloatArray, z: FloatArray) -> NoReturn:
    """Raise the exception for the first point at which an output is undetermined."""
    model, p = native.model, native.p
    n, m = len(model.states), len(model.sensitivities)
    for j, at in enumerate(t.tolist()):
        known, y, s = native.inputs_at(at), z[:n, j], z[n:, j].reshape(m, n).T
        model.output_values(at, y, p, known)
        if m:
            model.output_sensitivity(at, y, s, p, known)
    raise SolveError("the outputs cannot be evaluated along the run")
