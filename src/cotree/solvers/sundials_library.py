"""The location of the SUNDIALS libraries.

CVODE and IDA come with scikit-sundae, CVODES and IDAS with SUNDIALS' own package sundials4py. The
environment variable COTREE_SUNDIALS names a file to take in place of both.
"""

from __future__ import annotations

import importlib
import importlib.util
import os
import re
import sys
from pathlib import Path
from typing import Any, NamedTuple

from cotree.codegen.integrators import SUNDIALS_VERSION, WITH_SENSITIVITIES, sundials_functions
from cotree.errors import SolveError

#: Names the file of a library that has the functions of all that is asked of it.
VARIABLE = "COTREE_SUNDIALS"

# The least version of Python that sundials4py is made for.
_LEAST_PYTHON = (3, 12)


def check_installed(method: str) -> None:
    """Refuse CVODE and IDA where the package is not there that brings them.

    Parameters
    ----------
    method : str
        "cvode" or "ida".
    """
    try:
        # Imported and not only looked for, since a part of the package may be missing.
        importlib.import_module(f"sksundae.{method}")
    except ImportError as error:
        raise SolveError(
            f"The method '{method}' needs SUNDIALS: run `pip install scikit-sundae`, or use "
            "'rodas5'."
        ) from error


def has_sundials() -> bool:
    """Return whether the package is there that brings CVODE and IDA."""
    return importlib.util.find_spec("sksundae") is not None


class LibraryPath(NamedTuple):
    """The file of a library, or the reason why there is none, without a capital and a full stop."""

    path: str
    why_not: str = ""


def library_path(library: str) -> LibraryPath:
    """Find the file that has a library of SUNDIALS in it.

    Parameters
    ----------
    library : str
        "cvode", "ida", "cvodes" or "idas".
    """
    named = os.environ.get(VARIABLE, "")
    # What the user names is taken or refused, never passed over for another library.
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

    Parameters
    ----------
    ffi : object
        That of the engine, with the declarations of these functions.
    library : str
        A name in ``SUNDIALS``.
    path : str
        The file.

    Returns
    -------
    (object, object) or str
        A ``cotree_sundials``, and what keeps the library loaded; or the reason why there is none,
        without a capital and a full stop.
    """
    try:
        # Lazily: of a module of Python nothing is called that needs Python.
        opened = ffi.dlopen(path, ffi.RTLD_LAZY)
        # The engine declares the functions of one version; another might take other arguments.
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
    """Return the major and minor version of an opened library; empty where it is not known.

    sundials4py leaves out the function that tells it: there the package's own version is
    SUNDIALS', and stands in a name beside the file.

    Parameters
    ----------
    ffi : object
        Declares ``SUNDIALSGetVersionNumber``.
    library : object
        The opened library.
    path : str
        Its file.
    """
    try:
        tell = library.SUNDIALSGetVersionNumber
    except AttributeError:
        for folder in Path(path).parent.glob("sundials4py-*.dist-info"):
            found = re.match(r"sundials4py-(\d+)\.(\d+)\.", folder.name)
            if found:
                return int(found[1]), int(found[2])
        return ()
    major, minor, patch = (ffi.new("int *") for _ in range(3))
    failed = tell(major, minor, patch, ffi.new("char[32]"), 32)
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
