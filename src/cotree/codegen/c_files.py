"""C files of models and integrators, for C projects and for the engines that Python calls.

The headers of SUNDIALS are not used: ``templates/runtime/sundials/cotree_sundials.h`` declares the
functions, with a conditional part for each library. CVODES and IDAS are CVODE and IDA with one more
vector for each sensitivity.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import TYPE_CHECKING, Any

from cotree.codegen.c_text import exported
from cotree.codegen.render import (
    ALL,
    Features,
    header_text,
    render,
    resolve,
    source_texts,
    with_runtime,
)
from cotree.codegen.tableaus import (
    FIXED,
    ROSENBROCK,
    TABLEAUS,
    FixedStep,
    RosenbrockTableau,
    Tableau,
)
from cotree.codegen.targets import DOUBLE, Target
from cotree.methods import SUNDIALS, WITH_SENSITIVITIES
from cotree.quiet import without_collection
from cotree.tolerances import LIMITS
from cotree.version import VERSION

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from cotree.codegen.context import ModelContext


@without_collection()
def render_model(model: ModelContext, features: Features = ALL) -> Mapping[str, str]:
    """Return C texts by file name: model, headers and, for vectors, ``<model>_vectors.h``."""
    vectors, target = {}, model.target
    if model.uses_vectors:
        vectors[f"{model.prefix}_vectors.h"] = render("c/vectors.h.jinja", target, model=model)
    files = {
        f"{model.prefix}.h": render("c/model.h.jinja", target, model=model),
        f"{model.prefix}.c": render("c/model.c.jinja", target, model=model),
        **vectors,
    }
    return with_runtime(files, target, features=features, has_sources=False)


def cdef(header: str, prefix: str) -> str:
    """Return the cffi declarations of a model from the text of ``cotree_abi.h``."""
    return f"{declarations([header], ['cotree_model'])}const cotree_model *{prefix}_abi(void);\n"


def declarations(texts: Iterable[str], types: Sequence[str] = ()) -> str:
    """Return cffi declarations of exported functions and types, with doubles as numbers.

    Each header must follow the headers that it includes. ``types`` names further types to declare,
    besides those that the functions use.
    """
    return f"typedef double cotree_real;\n{exported(texts, types)}"


#: Result and arguments of the SUNDIALS function that returns the version; it is called first.
VERSION_FUNCTION: Mapping[str, tuple[str, str]] = {
    "SUNDIALSGetVersionNumber": (
        "int",
        "int *major, int *minor, int *patch, char *label, int length",
    )
}

_HEADER = "cotree_sundials.h"
#: Modules whose headers declare the types of a job and of a start.
_JOB_MODULES = ("abi", "run", "start_tables")
_RUN = ("run", "iteration", "least", "lu")  # modules of a run without a stepper


def sundials_files(library: str) -> dict[str, str]:
    """Return the files of the stepper that calls a SUNDIALS library."""
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
    """Return the C result type and arguments of each SUNDIALS function that is called, by name."""
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


#: All integrators with error control, by name.
INTEGRATORS: dict[str, Tableau | RosenbrockTableau] = {**TABLEAUS, **ROSENBROCK}

#: Names of all C steppers: cotree's methods and the SUNDIALS libraries.
STEPPERS = (*INTEGRATORS, *SUNDIALS)

#: Context of the templates of all methods.
_COMMON: dict[str, Any] = {"generator": VERSION, "limits": LIMITS}

#: Sources compiled in the same unit as a method, so that their functions can be inlined.
_INLINED = ("cotree_lu.c", "cotree_history.c")


def method_files(name: str, target: Target = DOUBLE) -> Mapping[str, str]:
    """Return the files of a method in ``INTEGRATORS`` or ``FIXED``, without the runtime."""
    # Fixed-step methods exist only in C projects.
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
    """Return the values of the macros that select parts of a method's C text."""
    return {
        "COTREE_IMPLICIT": method.is_implicit,
        "COTREE_TWO_ERRORS": isinstance(method, Tableau) and len(method.errors) > 1,
    }


def engine_files(name: str, *, has_events: bool = True) -> Mapping[str, str]:
    """Return the C files of the engine of a stepper in ``STEPPERS``, which fit all models."""
    own = dict(stepper_files(name))
    if name in INTEGRATORS:
        own |= method_files(name)
    features = replace(ALL, events=has_events, modes=has_events, discs=has_events)
    # Structures must have all features, because separately compiled libraries share them.
    whole = {name: header_text(name) for name in ("cotree_abi.h", "cotree_job.h")}
    files = {**with_runtime(own, features=features), **whole}
    parts = [files.pop(part) for part in [*_INLINED, *own] if part.endswith(".c") and part in files]
    return {**files, "engine.c": "\n".join(parts)}


def _sources(modules: Iterable[str]) -> dict[str, str]:
    return {
        name: text
        for module in modules
        for name, text in source_texts(f"cotree_{module}.h").items()
    }


def stepper_files(name: str, target: Target = DOUBLE) -> Mapping[str, str]:
    """Return the files of a stepper in ``STEPPERS``; SUNDIALS steppers use doubles."""
    if name in INTEGRATORS:
        text = render("c/engine/own_stepper.c.jinja", target, method=INTEGRATORS[name], **_COMMON)
        return {f"cotree_{name}_stepper.c": text}
    return sundials_files(name)


def engine_declarations(files: Mapping[str, str], name: str) -> str:
    """Return cffi declarations of an engine and of the SUNDIALS functions that it calls."""
    headers = [f"cotree_{module}.h" for module in (*_JOB_MODULES, "job")]
    types = ["cotree_start_tables"]
    functions: Mapping[str, tuple[str, str]] = {}
    stepper = f"const cotree_stepper *cotree_{name}_stepper(void);\n"
    if name in SUNDIALS:  # this header declares the steppers of all libraries
        headers.append(_HEADER)
        types += ["cotree_sundials", "cotree_sundials_aid"]
        functions = {**sundials_functions(name), **VERSION_FUNCTION}
        stepper = ""
    return (
        declarations(map(files.__getitem__, headers), types)
        + stepper
        + "".join(f"{result} {f}({arguments});\n" for f, (result, arguments) in functions.items())
    )


#: Libraries that do not depend on the model: modules to compile, modules whose headers cffi reads.
LIBRARIES: Mapping[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    "adjoint": (("adjoint", "history", *_RUN), ("abi", "run", "adjoint")),
    "batch": (("batch", "columns"), (*_JOB_MODULES, "start", "job", "batch")),
    "columns": (("columns",), ("abi", "columns")),
    "start": (("start", "assembly", *_RUN), (*_JOB_MODULES, "start")),
}


def library_texts(
    name: str, stepper: str = "", *, has_events: bool = True
) -> tuple[Mapping[str, str], str]:
    """Return the files of a library, or of the engine of a stepper, and declarations for cffi."""
    if stepper:
        files = engine_files(stepper, has_events=has_events)
        return files, engine_declarations(files, stepper)
    sources, headers = LIBRARIES[name]
    files = with_runtime(_sources(sources), has_sources=False)
    return files, declarations(files[f"cotree_{module}.h"] for module in headers)
