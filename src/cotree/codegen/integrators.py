"""Integrators as C text: for C projects, and for the engine that Python drives.

SUNDIALS is called without its headers: the functions stand in
``templates/runtime/sundials/cotree_sundials.h``, a conditional part for each library. CVODES and
IDAS are CVODE and IDA with sensitivities, which have vectors of their own.
"""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING, Any

from cotree.codegen.model_files import declarations
from cotree.codegen.render import render
from cotree.codegen.runtime import header_text, resolve, source_texts, with_runtime
from cotree.codegen.tableaus import (
    FIXED,
    ROSENBROCK,
    TABLEAUS,
    FixedStep,
    RosenbrockTableau,
    Tableau,
)
from cotree.codegen.targets import DOUBLE
from cotree.methods import SUNDIALS, WITH_SENSITIVITIES
from cotree.tolerances import LIMITS
from cotree.version import VERSION

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping

    from cotree.codegen.targets import Target


#: Returns the version, before anything else is called.
VERSION_FUNCTION: Mapping[str, tuple[str, str]] = {
    "SUNDIALSGetVersionNumber": (
        "int",
        "int *major, int *minor, int *patch, char *label, int length",
    ),
}

_HEADER = "cotree_sundials.h"
#: Headers with the types of a job and of a start.
_JOB_HEADERS = ("cotree_abi.h", "cotree_run.h", "cotree_start_tables.h")


def sundials_files(library: str) -> dict[str, str]:
    """Write the stepper that calls a library, by name of the file.

    Parameters
    ----------
    library : str
        A name in ``SUNDIALS``.
    """
    is_ida = "ida" in library
    has_sensitivities = library in WITH_SENSITIVITIES
    known = {
        "COTREE_IDA": is_ida,
        "COTREE_SENSITIVITIES": has_sensitivities,
        "COTREE_SIMULTANEOUS": has_sensitivities and not is_ida,
    }
    texts = {_HEADER: header_text(_HEADER), **source_texts(_HEADER)}
    return {name: resolve(text, known) for name, text in texts.items()}


@cache
def sundials_functions(library: str) -> dict[str, tuple[str, str]]:
    """Return result and arguments of each function that is called of a library, by name."""
    text = sundials_files(library)[_HEADER]
    members = text.partition("typedef struct cotree_sundials {")[2].partition("\n}")[0]
    found = {}
    for member in members.split(";"):
        head, _, rest = member.partition("(*")
        name, _, arguments = rest.partition(")(")
        if name:
            result = head.rpartition("\n")[2].strip()
            found[name] = result, " ".join(arguments.removesuffix(")").split())
    return found


#: Every integrator with error control, by name.
INTEGRATORS: dict[str, Tableau | RosenbrockTableau] = {**TABLEAUS, **ROSENBROCK}

#: Every method that C takes the steps of, by name: cotree's own, and the libraries of SUNDIALS.
STEPPERS = (*INTEGRATORS, *SUNDIALS)

#: Modules that are the same in all engines and include none but each other: compiled once for all.
SHARED_MODULES = ("assembly", "events", "job", "jumps", "least", "run")

#: Sources that are compiled with a method's own, so that what is called often can be inlined.
_INLINED = ("cotree_lu.c", "cotree_history.c")


def integrator_files(name: str, target: Target = DOUBLE) -> Mapping[str, str]:
    """Write an integrator's own files and those that it shares with others.

    Parameters
    ----------
    name : str
        A name in ``INTEGRATORS`` or ``FIXED``.
    target : Target
        The type of numbers.

    Returns
    -------
    mapping of str to str
        Text by file name.
    """
    return with_runtime(method_files(name, target), target)


def method_files(name: str, target: Target = DOUBLE) -> Mapping[str, str]:
    """Write an integrator's own files.

    Parameters
    ----------
    name : str
        A name in ``INTEGRATORS`` or ``FIXED``.
    target : Target
        The type of numbers.

    Returns
    -------
    mapping of str to str
        Text by file name; it includes files of the runtime.
    """
    # C projects take methods with steps of one length, too, which no engine does.
    method: Tableau | RosenbrockTableau | FixedStep = {**INTEGRATORS, **FIXED}[name]
    kind = "fixed" if isinstance(method, FixedStep) else "variable"
    texts = {
        f"cotree_{name}{end}": render(
            f"c/integrators/{kind}{end}.jinja", target, method=method, **_COMMON
        )
        for end in (".h", ".c")
    }
    return {file: resolve(text, conditions(method)) for file, text in texts.items()}


def conditions(method: Tableau | RosenbrockTableau | FixedStep) -> dict[str, bool]:
    """Return the values of the macros that the plain C of a method is selected by."""
    return {
        "COTREE_IMPLICIT": method.is_implicit,
        "COTREE_TWO_ERRORS": isinstance(method, Tableau) and len(method.errors) > 1,
    }


def engine_files(name: str) -> Mapping[str, str]:
    """Write the engine of a method: a job with the stepper that runs it, the same for every model.

    Parameters
    ----------
    name : str
        A name in ``STEPPERS``.

    Returns
    -------
    mapping of str to str
        Text by file name.
    """
    own = dict(stepper_files(name))
    if name in INTEGRATORS:
        own |= method_files(name)
    files = with_runtime(own)
    parts = [files.pop(part) for part in [*_INLINED, *own] if part.endswith(".c") and part in files]
    return {**files, "engine.c": "\n".join(parts)}


def shared_files(files: Iterable[str]) -> frozenset[str]:
    """Return those files of an engine that are the same in all of them."""
    sources = _sources(*(f"cotree_{module}.h" for module in SHARED_MODULES))
    return frozenset(with_runtime(sources, has_sources=False).keys() & {*files})


def _sources(*headers: str) -> dict[str, str]:
    """Write the sources of modules."""
    return {name: text for header in headers for name, text in source_texts(header).items()}


def stepper_files(name: str, target: Target = DOUBLE) -> Mapping[str, str]:
    """Write what a job runs a method by.

    Parameters
    ----------
    name : str
        A name in ``STEPPERS``.
    target : Target
        The type of numbers, double for the libraries of SUNDIALS.

    Returns
    -------
    mapping of str to str
        Text by file name; it includes files of the runtime.
    """
    if name in INTEGRATORS:
        text = render("c/engine/own_stepper.c.jinja", target, method=INTEGRATORS[name], **_COMMON)
        return {f"cotree_{name}_stepper.c": text}
    return sundials_files(name)


def engine_declarations(files: Mapping[str, str], name: str) -> str:
    """Return the declarations of an engine and of the library functions that it calls, for cffi."""
    headers = [*_JOB_HEADERS, "cotree_job.h"]
    types = ["cotree_start_tables"]
    functions: Mapping[str, tuple[str, str]] = {}
    stepper = f"const cotree_stepper *cotree_{name}_stepper(void);\n"
    if name in SUNDIALS:  # its header declares the steppers of all libraries
        headers.append(_HEADER)
        types += ["cotree_sundials", "cotree_sundials_aid"]
        functions = {**sundials_functions(name), **VERSION_FUNCTION}
        stepper = ""
    return (
        declarations(map(files.__getitem__, headers), types)
        + stepper
        + "".join(f"{result} {f}({arguments});\n" for f, (result, arguments) in functions.items())
    )


def sweep_files() -> Mapping[str, str]:
    """Write the evaluation of outputs at many points, the same for every model."""
    return with_runtime(_sources("cotree_sweep.h"), has_sources=False)


def sweep_declarations(files: Mapping[str, str]) -> str:
    """Return the declarations of a sweep that cffi reads."""
    return declarations([files["cotree_abi.h"], files["cotree_sweep.h"]])


def columns_files() -> Mapping[str, str]:
    """Write the evaluation of one kernel at many points, the same for every model."""
    return with_runtime(_sources("cotree_columns.h"), has_sources=False)


def columns_declarations(files: Mapping[str, str]) -> str:
    """Return the declarations of these that cffi reads."""
    return declarations([files["cotree_abi.h"], files["cotree_columns.h"]])


def batch_files() -> Mapping[str, str]:
    """Write the loop over many runs of a model, the same for every model and method.

    Returns
    -------
    mapping of str to str
        Text by file name. Jobs run in the engine of a method, whose functions it is given.
    """
    return with_runtime(_sources("cotree_batch.h", "cotree_sweep.h"), has_sources=False)


def batch_declarations(files: Mapping[str, str]) -> str:
    """Return the declarations of a batch that cffi reads."""
    headers = (*_JOB_HEADERS, "cotree_start.h", "cotree_job.h", "cotree_batch.h")
    return declarations(map(files.__getitem__, headers))


def start_files() -> Mapping[str, str]:
    """Write the start as files of a library, the same for every model."""
    return with_runtime(source_texts("cotree_start.h"))


def start_declarations(files: Mapping[str, str]) -> str:
    """Return the declarations of the start that cffi reads."""
    return declarations(map(files.__getitem__, (*_JOB_HEADERS, "cotree_start.h")))


#: Functions that return the files and the declarations of each library that serves all models.
LIBRARIES: Mapping[str, tuple[Callable[..., Mapping[str, str]], Callable[..., str]]] = {
    "engine": (engine_files, engine_declarations),
    "sweep": (sweep_files, sweep_declarations),
    "columns": (columns_files, columns_declarations),
    "batch": (batch_files, batch_declarations),
    "start": (start_files, start_declarations),
}


_COMMON: dict[str, Any] = {
    "generator": VERSION,
    "limits": LIMITS,
}
