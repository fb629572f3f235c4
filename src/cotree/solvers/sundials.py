"""SUNDIALS libraries, and the data that their steppers need for a problem.

CVODE and IDA come with scikit-sundae, CVODES and IDAS with SUNDIALS' own package sundials4py. The
environment variable COTREE_SUNDIALS names a library that replaces both.

CVODE and IDA integrate states and sensitivities as one vector, with cotree's factorisation of the
Newton matrix. CVODES and IDAS have one vector per parameter; their error test and iteration use the
largest norm instead of the mean. They have two correctors:

- staggered: solves for the states and tests their error, then does the same for the sensitivities
(W. F. Feehery, J. E. Tolsma and P. I. Barton, Applied Numerical Mathematics 25, 1997); -
simultaneous: one iteration solves for states and sensitivities (T. Maly and L. R. Petzold, ibid.
20, 1996).
"""

from __future__ import annotations

import importlib
import importlib.util
import os
import re
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from cotree.errors import SolveError
from cotree.methods import SUNDIALS_VERSION, WITH_SENSITIVITIES

if TYPE_CHECKING:
    from cotree.methods import Method
    from cotree.solvers.engine import Engine
    from cotree.solvers.problem import RunProblem


#: Name of the environment variable with the path of a SUNDIALS library.
VARIABLE = "COTREE_SUNDIALS"

# Oldest version of Python that sundials4py supports.
_LEAST_PYTHON = (3, 12)


def check_installed(method: str) -> None:
    """Raise SolveError if the package with "cvode" or "ida" is not installed."""
    try:
        # The import finds a package that is incompletely installed.
        importlib.import_module(f"sksundae.{method}")
    except ImportError as error:
        raise SolveError(
            f"The method '{method}' needs SUNDIALS: run `pip install scikit-sundae`, or use "
            "'rodas5'."
        ) from error


class LibraryPath(NamedTuple):
    """Path of a library, or a clause with the reason why it is missing."""

    path: str
    why_not: str = ""


def library_path(library: str) -> LibraryPath:
    """Return the path of a SUNDIALS library: "cvode", "ida", "cvodes" or "idas"."""
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
    """Open a SUNDIALS library; return its ``cotree_sundials`` and handle, or why that failed."""
    # Imported here, because cotree's own methods do not need the modules that generate C.
    from cotree.codegen.c_files import sundials_functions

    try:
        # The library refers to Python functions that are not needed, hence lazy binding.
        opened = ffi.dlopen(path, ffi.RTLD_LAZY)
        # In other versions, functions may have other arguments.
        version = version_of(ffi, opened, path)
        if version != SUNDIALS_VERSION:
            here, known = (".".join(map(str, v)) or "unknown" for v in (version, SUNDIALS_VERSION))
            return f"SUNDIALS is of version {here}, not {known}"
        functions = ffi.new("cotree_sundials *")
        for function in sundials_functions(library):
            setattr(functions, function, ffi.addressof(opened, function))
    except (OSError, AttributeError, ffi.error) as error:
        return f"SUNDIALS' functions cannot be found ({error})"
    return functions, opened


def version_of(ffi: Any, library: Any, path: str) -> tuple[int, ...]:
    """Return the major and minor version of an opened library, or an empty tuple if unknown.

    sundials4py lacks the function that returns it, but the name of its metadata folder contains it.
    """
    try:
        get_version = library.SUNDIALSGetVersionNumber
    except (AttributeError, ffi.error):
        for folder in Path(path).parent.glob("sundials4py-*.dist-info"):
            found = re.match(r"sundials4py-(\d+)\.(\d+)\.", folder.name)
            if found:
                return int(found[1]), int(found[2])
        return ()
    major, minor, patch = (ffi.new("int *") for _ in range(3))
    failed = get_version(major, minor, patch, ffi.new("char[32]"), 32)
    return () if failed else (major[0], minor[0])


def _in_sundials4py(library: str) -> LibraryPath:
    """Return the path of the module sundials4py, which is itself the library, without an import."""
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


# A sparse factorisation is faster than a banded one with more multiplications than this.
_MOST_MULTIPLICATIONS = 3e7


class SundialsAid:
    """The ``cotree_sundials_aid`` of a job with its arrays; see :class:`cotree.solvers.job.Job`."""

    def __init__(self, engine: Engine, row: Method, problem: RunProblem, model: Any) -> None:
        ffi, n = engine.library.ffi, problem.n_states
        c = self.address = ffi.new("cotree_sundials_aid *")
        c.sundials, c.corrector = engine.functions, row.corrector
        # The residuals of sensitivities change with the states. If sensitivities are not in the
        # error test, the iteration therefore takes a minimum number of corrections.
        c.are_followed = (
            problem.n_sensitivities > 0 and not problem.settings.error_test_sensitivities
        )
        if problem.n_algebraic and not row.keeps_algebraic:
            # The Jacobian after elimination of algebraic unknowns is dense.
            c.lower = c.upper = n - problem.n_algebraic - 1
        else:
            # The arrays do not exist if no rate depends on a state.
            n_nonzeros = model.n_nonzeros
            starts = ffi.unpack(model.column_starts, n + 1) if n_nonzeros else [0] * (n + 1)
            rows = ffi.unpack(model.row_indices, n_nonzeros) if n_nonzeros else []
            from cotree.linear.elimination import narrow_band

            c.lower, c.upper, order = narrow_band(n, starts, rows)
            if order is not None:
                self._order = c.places = ffi.new("int[]", order.tolist())
        # A banded factorisation takes about n l (l + u) multiplications.
        self.is_wide = bool(n * c.lower * (c.lower + c.upper) > _MOST_MULTIPLICATIONS)
