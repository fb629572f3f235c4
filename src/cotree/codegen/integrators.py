"""Integrators as C text: for C projects, and for the engine that Python drives."""

from __future__ import annotations

from typing import TYPE_CHECKING

from cotree.codegen.fixed import FIXED, FixedStep
from cotree.codegen.render import declared, render
from cotree.codegen.rosenbrock import ROSENBROCK, RosenbrockTableau
from cotree.codegen.sundials import (
    SUNDIALS_FUNCTIONS,
    SUNDIALS_VERSION,
    VERSION_FUNCTION,
    WITH_SENSITIVITIES,
)
from cotree.codegen.tableaus import TABLEAUS, Tableau
from cotree.tolerances import FARTHEST_CORRECTION
from cotree.version import ABI_VERSION, VERSION

if TYPE_CHECKING:
    from collections.abc import Mapping

_FOLDER = "c/integrators"

#: Every integrator with error control, by name.
INTEGRATORS: dict[str, Tableau | RosenbrockTableau] = {**TABLEAUS, **ROSENBROCK}


def integrator_files(name: str) -> Mapping[str, str]:
    """Write an integrator's own files and those that it shares with others.

    Parameters
    ----------
    name : str
        A name in ``INTEGRATORS`` or ``FIXED``.

    Returns
    -------
    mapping of str to str
        Text by file name.
    """
    method: Tableau | RosenbrockTableau | FixedStep = {**INTEGRATORS, **FIXED}[name]
    files = {
        f"cotree_integrator{end}": render(f"{_FOLDER}/cotree_integrator{end}.jinja", **_COMMON)
        for end in (".h", ".c")
    }
    for end in (".h", ".c"):
        kind = "rosenbrock" if method.is_implicit else "explicit"
        if isinstance(method, FixedStep):
            kind = "fixed"
        text = render(f"{_FOLDER}/{kind}{end}.jinja", method=method, **_COMMON)
        files[f"cotree_{name}{end}"] = text
    return files


def engine_files(name: str) -> Mapping[str, str]:
    """Write an integrator with a job that it runs, the same for every model.

    Parameters
    ----------
    name : str
        A name in ``INTEGRATORS``.

    Returns
    -------
    mapping of str to str
        Text by file name.
    """
    files = {**integrator_files(name), **driver_files(name)}
    # In one file, so that what is called often can be inlined.
    parts = [files.pop(f"cotree_{part}.c") for part in ("history", name, "job")]
    del files["cotree_integrator.c"]
    own = stiff_files() if INTEGRATORS[name].is_implicit else {}
    return {**files, **_job_files(), **own, "engine.c": "\n".join(parts)}


def driver_files(name: str) -> Mapping[str, str]:
    """Write the driver of an integrator through breakpoints, wanted points and events.

    Parameters
    ----------
    name : str
        A name in ``INTEGRATORS``.

    Returns
    -------
    mapping of str to str
        Text by file name; :func:`run_files` and :func:`integrator_files` come with it.
    """
    job = render("c/engine/cotree_job.c.jinja", method=INTEGRATORS[name], **_COMMON)
    header = render("c/engine/cotree_job.h.jinja", **_COMMON)
    return {**_event_files(), "cotree_job.h": header, "cotree_job.c": job}


def _event_files() -> Mapping[str, str]:
    """Write the location and execution of events, the same for every engine."""
    return {
        f"cotree_{part}{end}": render(f"{folder}/cotree_{part}{end}.jinja", **_COMMON)
        for part, folder in (("history", _FOLDER), ("jumps", "c/run"), ("events", "c/run"))
        for end in (".h", ".c")
    }


def sundials_files(library: str) -> Mapping[str, str]:
    """Write the engine that runs a job with SUNDIALS, the same for every model.

    Parameters
    ----------
    library : str
        A name in ``SUNDIALS_FUNCTIONS``.

    Returns
    -------
    mapping of str to str
        Text by file name.
    """
    about = {
        "library": library,
        "method": WITH_SENSITIVITIES.get(library, library),
        "has_correctors": library in WITH_SENSITIVITIES,
        "has_together": library == "cvodes",
        "functions": SUNDIALS_FUNCTIONS[library],
        **_COMMON,
    }
    version = ".".join(map(str, SUNDIALS_VERSION))
    return {
        **_job_files(),
        **_event_files(),
        "cotree_integrator.h": render(f"{_FOLDER}/cotree_integrator.h.jinja", **_COMMON),
        "cotree_sundials.h": render("c/engine/cotree_sundials.h.jinja", **about),
        "engine.c": render("c/engine/sundials_job.c.jinja", version=version, **about),
    }


def sundials_declarations(files: Mapping[str, str], library: str) -> str:
    """Give the declarations of that engine, and of SUNDIALS' functions, that cffi reads."""
    functions = {**SUNDIALS_FUNCTIONS[library], **VERSION_FUNCTION}.items()
    pointers = "int cotree_sundials_pointers(const cotree_model *);\n"
    return (
        _declared(files, ("cotree_abi.h", "cotree_run.h", "cotree_job.h", "cotree_sundials.h"))
        + "size_t cotree_sundials_doubles(const cotree_model *, int, int, int);\n"
        + "int cotree_sundials_ints(const cotree_model *);\n"
        + (pointers if library in WITH_SENSITIVITIES else "")
        + "int cotree_job_run(cotree_job *, long);\nvoid cotree_job_end(cotree_job *);\n"
        + "".join(f"{result} {name}({arguments});\n" for name, (result, arguments) in functions)
    )


def _job_files() -> Mapping[str, str]:
    """Write the files that every job needs: its own header, and the model's side of it."""
    headers = {
        "cotree_abi.h": render("c/cotree_abi.h.jinja", abi_version=ABI_VERSION, **_COMMON),
        "cotree_job.h": render("c/engine/cotree_job.h.jinja", **_COMMON),
    }
    return {**headers, **run_files()}


def run_files() -> Mapping[str, str]:
    """Write the interface of a model to integrators, the same for every model."""
    names = ("cotree_run.h", "cotree_run.c")
    return {name: render(f"c/run/{name}.jinja", **_COMMON) for name in names}


def stiff_files() -> Mapping[str, str]:
    """Write the interface of a model to implicit methods, the same for every model."""
    names = ("cotree_stiff.h", "cotree_stiff.c")
    return {
        "cotree_newton.h": render("c/newton/cotree_newton.h.jinja", **_COMMON),
        **{name: render(f"c/run/{name}.jinja", **_COMMON) for name in names},
    }


def sweep_files() -> Mapping[str, str]:
    """Write the evaluation of outputs at many points, the same for every model."""
    return {
        "cotree_abi.h": render("c/cotree_abi.h.jinja", abi_version=ABI_VERSION, **_COMMON),
        "cotree_sweep.c": render("c/engine/cotree_sweep.c.jinja", **_COMMON),
    }


def sweep_declarations(files: Mapping[str, str]) -> str:
    """Give the declarations of a sweep that cffi reads."""
    return declared(files["cotree_abi.h"]) + (
        "int cotree_sweep(const cotree_model *, const double *, const double *, int,"
        " const double *, const double *, int, int, double *, double *, double *);\n"
    )


def job_declarations(files: Mapping[str, str]) -> str:
    """Give the declarations that cffi reads, from an engine's headers."""
    of_newton = "size_t cotree_job_newton(const cotree_model *, const void *);\n"
    return _declared(files, ("cotree_abi.h", "cotree_run.h", "cotree_job.h")) + (
        "size_t cotree_job_memory(const cotree_model *, int);\n"
        "int cotree_job_run(cotree_job *, long);\n" + of_newton
    )


def _declared(files: Mapping[str, str], headers: tuple[str, ...]) -> str:
    return "".join(declared(files[name]) for name in headers)


_COMMON = {"generator": VERSION, "farthest": FARTHEST_CORRECTION}
