"""Integrators as C text: for C projects, and for the engine that Python drives."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from cotree.codegen.fixed import FIXED, FixedStep
from cotree.codegen.render import abi_header, declared, render
from cotree.codegen.rosenbrock import ROSENBROCK, RosenbrockTableau
from cotree.codegen.statuses import EVENT_STATUSES, STATUSES, TURNED
from cotree.codegen.sundials import (
    SUNDIALS_FLAGS,
    SUNDIALS_FUNCTIONS,
    SUNDIALS_VERSION,
    VERSION_FUNCTION,
    WITH_SENSITIVITIES,
)
from cotree.codegen.tableaus import TABLEAUS, Tableau
from cotree.codegen.targets import DOUBLE
from cotree.tolerances import LIMITS
from cotree.version import VERSION

if TYPE_CHECKING:
    from collections.abc import Mapping

    from cotree.codegen.targets import Target

_FOLDER = "c/integrators"

#: Every integrator with error control, by name.
INTEGRATORS: dict[str, Tableau | RosenbrockTableau] = {**TABLEAUS, **ROSENBROCK}

#: Every method that C takes the steps of, by name: cotree's own, and the libraries of SUNDIALS.
STEPPERS = (*INTEGRATORS, *SUNDIALS_FUNCTIONS)

#: Files that are the same in all engines and include none but each other: compiled once for all.
SHARED_FILES = frozenset(
    {
        "cotree_abi.h",
        "cotree_events.c",
        "cotree_events.h",
        "cotree_history.h",
        "cotree_integrator.h",
        "cotree_job.c",
        "cotree_job.h",
        "cotree_jumps.c",
        "cotree_jumps.h",
        "cotree_lu.h",
        "cotree_run.c",
        "cotree_run.h",
        "cotree_stepper.h",
    }
)


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
    # C projects take methods with steps of one length, too, which no engine does.
    method: Tableau | RosenbrockTableau | FixedStep = {**INTEGRATORS, **FIXED}[name]
    files = {
        f"cotree_integrator{end}": render(
            f"{_FOLDER}/cotree_integrator{end}.jinja", target, **_COMMON
        )
        for end in (".h", ".c")
    }
    # A header follows from whether steps are controlled, a source from the kind of the method.
    kinds = "variable", "rosenbrock" if method.is_implicit else "explicit"
    if isinstance(method, FixedStep):
        kinds = "fixed", "fixed"
    for kind, end in zip(kinds, (".h", ".c"), strict=True):
        text = render(f"{_FOLDER}/{kind}{end}.jinja", target, method=method, **_COMMON)
        files[f"cotree_{name}{end}"] = text
    return files


def engine_files(name: str, target: Target = DOUBLE) -> Mapping[str, str]:
    """Write the engine of a method: a job with the stepper that runs it, the same for every model.

    Parameters
    ----------
    name : str
        A name in ``STEPPERS``.
    target : Target
        The type of numbers and the spelling of qualifiers.

    Returns
    -------
    mapping of str to str
        Text by file name.
    """
    files = {**driver_files(name, target), **run_files(target)}
    files["cotree_abi.h"] = abi_header(target)
    # In one file, so that what is called often can be inlined.
    parts = [files.pop("cotree_lu.c"), files.pop(f"cotree_{name}_stepper.c")]
    if name in INTEGRATORS:
        files |= integrator_files(name, target)
        parts = [files.pop("cotree_history.c"), files.pop(f"cotree_{name}.c"), *parts]
        # Implicit methods read the Jacobian and its elimination through an interface of their own.
        if INTEGRATORS[name].is_implicit:
            files |= stiff_files(target)
    text = render(f"{_FOLDER}/cotree_integrator.h.jinja", target, **_COMMON)
    files["cotree_integrator.h"] = text
    files.pop("cotree_integrator.c", None)
    return {**files, "engine.c": "\n".join(parts)}


def driver_files(name: str, target: Target = DOUBLE) -> Mapping[str, str]:
    """Write a job, which drives a method through breakpoints, wanted points and events.

    Parameters
    ----------
    name : str
        A name in ``STEPPERS``.
    target : Target
        The type of numbers, double for the libraries of SUNDIALS.

    Returns
    -------
    mapping of str to str
        Text by file name; :func:`run_files` and :func:`integrator_files` come with it.
    """
    files = {
        f"cotree_{part}{end}": render(f"{folder}/cotree_{part}{end}.jinja", target, **_COMMON)
        for part, folder in (
            ("history", _FOLDER),
            ("jumps", "c/run"),
            ("events", "c/run"),
            ("job", "c/engine"),
        )
        for end in (".h", ".c")
    }
    files["cotree_stepper.h"] = render("c/engine/cotree_stepper.h.jinja", target, **_COMMON)
    if name in INTEGRATORS:
        text = render("c/engine/own_stepper.c.jinja", target, method=INTEGRATORS[name], **_COMMON)
        return {**files, f"cotree_{name}_stepper.c": text}
    # Functions have the names and flags of the library without sensitivities.
    method = WITH_SENSITIVITIES.get(name, name)
    about: dict[str, Any] = {
        "library": name,
        "method": method,
        "has_correctors": name in WITH_SENSITIVITIES,
        "has_together": name == "cvodes",
        "functions": SUNDIALS_FUNCTIONS[name],
        "flags": SUNDIALS_FLAGS[method],
        "version": ".".join(map(str, SUNDIALS_VERSION)),
        **_COMMON,
    }
    files["cotree_sundials.h"] = render("c/engine/cotree_sundials.h.jinja", **about)
    text = render("c/engine/sundials_stepper.c.jinja", **about)
    return {**files, f"cotree_{name}_stepper.c": text}


def engine_declarations(files: Mapping[str, str], name: str) -> str:
    """Give the declarations of an engine and of the library functions that it calls, for cffi."""
    headers = ["cotree_abi.h", "cotree_run.h", "cotree_job.h"]
    functions: Mapping[str, tuple[str, str]] = {}
    if name in SUNDIALS_FUNCTIONS:
        headers.append("cotree_sundials.h")
        functions = {**SUNDIALS_FUNCTIONS[name], **VERSION_FUNCTION}
    return (
        "".join(declared(files[header]) for header in headers)
        + f"const cotree_stepper *cotree_{name}_stepper(void);\n"
        + "size_t cotree_job_memory(cotree_job *);\n"
        + "int cotree_job_run(cotree_job *, long);\nvoid cotree_job_stand(cotree_job *);\n"
        + "void cotree_job_end(cotree_job *);\n"
        + "".join(f"{result} {f}({arguments});\n" for f, (result, arguments) in functions.items())
    )


def run_files(target: Target = DOUBLE) -> Mapping[str, str]:
    """Write the interface of a model to integrators, the same for every model."""
    names = ("cotree_run.h", "cotree_run.c", "cotree_lu.h", "cotree_lu.c")
    return {name: render(f"c/run/{name}.jinja", target, **_COMMON) for name in names}


def stiff_files(target: Target = DOUBLE) -> Mapping[str, str]:
    """Write the interface of a model to implicit methods, the same for every model."""
    names = ("cotree_stiff.h", "cotree_stiff.c")
    return {
        "cotree_newton.h": render("c/newton/cotree_newton.h.jinja", target, **_COMMON),
        **{name: render(f"c/run/{name}.jinja", target, **_COMMON) for name in names},
    }


def sweep_files(target: Target = DOUBLE) -> Mapping[str, str]:
    """Write the evaluation of outputs at many points, the same for every model."""
    names = ("cotree_sweep.h", "cotree_sweep.c")
    return {
        "cotree_abi.h": abi_header(target),
        **{name: render(f"c/engine/{name}.jinja", target, **_COMMON) for name in names},
    }


def sweep_declarations(files: Mapping[str, str]) -> str:
    """Give the declarations of a sweep that cffi reads."""
    return declared(files["cotree_abi.h"]) + (
        "int cotree_sweep(const cotree_model *, const double *, const double *, int,"
        " const double *, const double *, int, int, double *, double *, double *);\n"
    )


def columns_files() -> Mapping[str, str]:
    """Write the evaluation of one kernel at many points, the same for every model."""
    return {
        "cotree_abi.h": abi_header(),
        "cotree_columns.c": render("c/engine/cotree_columns.c.jinja", **_COMMON),
    }


def columns_declarations(files: Mapping[str, str]) -> str:
    """Give the declarations of these that cffi reads."""
    return declared(files["cotree_abi.h"]) + (
        "int cotree_columns(const cotree_model *, cotree_state_kernel, cotree_sensitivity_kernel,"
        " int, const double *, const double *, const double *, int, const double *, int, double *,"
        " int, double *, double *, int);\n"
    )


def batch_files(target: Target = DOUBLE) -> Mapping[str, str]:
    """Write the loop over many runs of a model, the same for every model and method.

    Parameters
    ----------
    target : Target
        The spelling of qualifiers; its numbers are doubles.

    Returns
    -------
    mapping of str to str
        Text by file name. Jobs run in the engine of a method, whose functions it is given.
    """
    files = {**run_files(target), **sweep_files(target)}
    for name in ("cotree_history.h", "cotree_integrator.h"):
        files[name] = render(f"{_FOLDER}/{name}.jinja", target, **_COMMON)
    for name in ("cotree_events.h", "cotree_jumps.h"):
        files[name] = render(f"c/run/{name}.jinja", target, **_COMMON)
    for name in ("cotree_job.h", "cotree_batch.h", "cotree_batch.c"):
        files[name] = render(f"c/engine/{name}.jinja", target, **_COMMON)
    # Sources of which only the headers are read.
    return {n: text for n, text in files.items() if n not in ("cotree_run.c", "cotree_lu.c")}


def batch_declarations(files: Mapping[str, str]) -> str:
    """Give the declarations of a batch that cffi reads."""
    headers = ("cotree_abi.h", "cotree_run.h", "cotree_job.h", "cotree_batch.h")
    return "".join(declared(files[header]) for header in headers) + (
        "int cotree_batch_work(cotree_worker *);\n"
        "void cotree_batch_close(cotree_worker *);\n"
        "int cotree_batch_prepare(const cotree_batch *, int, double *, double *);\n"
        "int cotree_batch_finish(cotree_worker *, int, const double *);\n"
        "double cotree_batch_now(void);\n"
        "int cotree_batch_most_threads(void);\n"
    )


_COMMON: dict[str, Any] = {
    "generator": VERSION,
    "limits": LIMITS,
    "statuses": STATUSES,
    "event_statuses": EVENT_STATUSES,
    "turned": TURNED,
    "steppers": STEPPERS,
}
