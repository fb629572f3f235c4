"""The C engine of a stepper: built once on a machine, loaded, and given jobs.

In: a name in ``codegen.integrators.STEPPERS``. Out: the library that runs jobs, with the functions
of SUNDIALS that it calls; or the reason why there is none.
"""

from __future__ import annotations

import contextlib
import threading
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from cotree.build import abandon
from cotree.codegen.integrators import SUNDIALS, engine_declarations, engine_files
from cotree.errors import Error
from cotree.model.shared_code import SharedCode, build_engine, shared_code
from cotree.sharing import locked_cache
from cotree.solvers.methods import METHODS
from cotree.solvers.sundials_library import library_path, open_sundials

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from cotree.build import LoadedLibrary


# Threads that build ahead of runs.
_ahead: list[threading.Thread] = []


@dataclass(frozen=True, eq=False)
class Engine:
    """The engine of a stepper."""

    stepper: str  # a name in ``STEPPERS``
    library: LoadedLibrary  # runs jobs
    #: A ``cotree_sundials``, which holds the functions of SUNDIALS that the stepper calls.
    functions: Any = None
    sundials: Any = None  # keeps SUNDIALS loaded


def build_ahead(*methods: str, then: Sequence[Callable[[], object]] = ()) -> None:
    """Begin to build or to load the engines of methods, while others form and compile the model.

    Parameters
    ----------
    *methods : str
        Methods of runs to come, in the order in which they are needed; nothing is done for those
        that need no engine or are unknown.
    then : sequence of callable, optional
        Functions that load what runs need besides; they are called after the engines are loaded.
    """
    # A choice of the method begins with steps of this one.
    rows = [METHODS.get("dop853" if method == "auto" else method) for method in methods]
    steppers = [row.stepper for row in rows if row is not None and row.stepper]
    if steppers:
        # The text is rendered here and not in the thread: two threads that run Python share the
        # interpreter, and the compiler would start later.
        _code_of(steppers[0])
        thread = threading.Thread(target=_prepare, args=(steppers, then), name="cotree-engine")
        _ahead.append(thread)
        thread.start()


def abandon_ahead() -> None:
    """End what was begun ahead of a run that will not take place: the program need not wait."""
    for thread in _ahead:
        abandon(thread)


def _prepare(steppers: Sequence[str], then: Sequence[Callable[[], object]]) -> None:
    from cotree.solvers.sweep import load_sweep

    with contextlib.suppress(Error):  # a run that needs the engine raises the same error
        # In sequence, because engines share object files, which the second takes from the cache.
        for stepper in steppers:
            load_engine(stepper)
        for load in then or (load_sweep,):
            load()


def load_engine(stepper: str) -> Engine | str:
    """Build and load the engine of a stepper, once; or say why that is not possible.

    Parameters
    ----------
    stepper : str
        A name in ``STEPPERS``.

    Returns
    -------
    Engine or str
        A reason is a sentence without a capital and an end.
    """
    if stepper not in SUNDIALS:
        return _opened(stepper, "")
    found = library_path(stepper)
    # The path is part of the key, since the environment may name another library the next time.
    return found.why_not or _opened(stepper, found.path)


@locked_cache
def _code_of(stepper: str) -> SharedCode:
    return shared_code(engine_files, engine_declarations, stepper)


@locked_cache
def _opened(stepper: str, path: str) -> Engine | str:
    """Build an engine, and open the library of SUNDIALS that a path names, if any."""
    library = build_engine(_code_of(stepper))
    if library is None:
        return "no compiler can build its engine"
    if not path:
        return Engine(stepper, library)
    opened = open_sundials(library.ffi, stepper, path)
    return opened if isinstance(opened, str) else Engine(stepper, library, *opened)
