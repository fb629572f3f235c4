"""A program to a folder of C files that a C99 compiler turns into an executable.

The folder holds the model, an integrator without dependencies, and a main program that integrates
the model to its end time and prints the end state. If the model has constraints, the main program
holds it to them as ``solvers/project.py`` does, from a consistent start that is found here and
written down. Algebraic unknowns are solved for at each evaluation; the other states are integrated.
"""

from __future__ import annotations

import math
import os
import tempfile
import textwrap
from dataclasses import dataclass
from typing import TYPE_CHECKING

from cotree.codegen.context import model_context
from cotree.codegen.fixed import FIXED
from cotree.codegen.integrators import (
    INTEGRATORS,
    driver_files,
    integrator_files,
    run_files,
    stiff_files,
)
from cotree.codegen.newton import newton_context, render_newton
from cotree.codegen.printing import literal
from cotree.codegen.render import render, render_model
from cotree.dag.stops import value_of
from cotree.errors import CodegenError, nearest
from cotree.export.c_checks import check_loops, check_numbers, check_start, check_step
from cotree.export.evaluated import Evaluated
from cotree.files import target_path
from cotree.markup import names
from cotree.naming import c_string

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence
    from pathlib import Path

    from cotree.codegen.context import ModelContext
    from cotree.model.consistent import Start
    from cotree.program import Program

_METHODS = {**INTEGRATORS, **FIXED}


@dataclass(frozen=True, repr=False)
class CProject:
    """A folder of C files.

    Attributes
    ----------
    directory : Path
        The folder.
    files : tuple of Path
        The files written there.
    command : str
        Command that builds the executable, to be run in the folder.
    """

    directory: Path
    files: tuple[Path, ...]
    command: str

    def __repr__(self) -> str:
        files = names([file.name for file in self.files])
        where = str(self.directory)
        return f"<CProject {where}: {files}>\n  build it there with: {self.command}"


@dataclass(frozen=True)
class MainContext:
    """The values that the template of the main program receives.

    Attributes
    ----------
    title, name_literal, prefix, upper, generator : str
        As in the model's context.
    integrator : str
        Its name.
    is_implicit : bool
        Whether it takes a Jacobian.
    command : str
        Command that builds the executable.
    t_end, rtol, atol : str
        C literals.
    guards : list of str
        A C string for each guard of ``prepare``: what it demands.
    stops : list of str
        A C initialiser for each time, or each row of times with a period, where something has a
        kink: the first time, the period or zero, and one where none come before the first.
    has_sensitivities : bool
        Whether the unknowns are states and sensitivities, or states alone.
    seeds : list of int
        Positions of the sensitivity parameters, -1 for initial values.
    start : list of str
        Lines of C literals: the initial states and sensitivities of a model whose start has to
        satisfy more than its kernels of the initial state; empty for others.
    n_constraints : int
        Number of constraints, with their rates and the norms of quaternions.
    n_algebraic : int
        Number of algebraic unknowns among the states.
    n_events : int
        Number of events.
    is_strict : bool
        Whether constraints are dependent, so that rates are taken on them.
    step : str
        Length of all steps; empty where the step size is controlled.
    is_extended : bool
        Whether algebraic unknowns are integrated, too.
    sizes : list of str
        Lines of C literals: the factor of each state's absolute tolerance, if any.
    least : str
        The least absolute tolerance.
    """

    title: str
    name_literal: str
    prefix: str
    upper: str
    generator: str
    integrator: str
    is_implicit: bool
    command: str
    t_end: str
    rtol: str
    atol: str
    guards: list[str]
    stops: list[str]
    max_step: str
    has_sensitivities: bool
    seeds: list[int]
    start: list[str]
    n_constraints: int
    n_algebraic: int
    n_events: int
    is_strict: bool
    step: str
    is_extended: bool
    sizes: list[str]
    least: str


def write_c_project(
    program: Program,
    directory: Path,
    integrator: str = "dopri5",
    *,
    t_end: float,
    rtol: float,
    atol: float,
    step: float | None = None,
    start: Start | None = None,
) -> CProject:
    """Write a model with a main program that integrates it.

    Files that stand there already are replaced, each at once and none unless all are complete.

    Parameters
    ----------
    program : Program
        After its passes.
    directory : Path
        Folder of the files, created where it is missing.
    integrator : str
        A name in ``INTEGRATORS`` or ``FIXED``.
    t_end : float
        End time of a run without arguments, [s].
    rtol, atol : float
        Tolerances of states and sensitivities, relative and absolute.
    step : float, optional
        Length of all steps of a method of ``FIXED``, [s].
    start : Start, optional
        The state at the start, if that is not its own consistent start.

    Returns
    -------
    CProject
        The files, and the command that builds them.

    Raises
    ------
    SceneError
        If the end time or a tolerance is not acceptable, or no folder can have the name.
    ParameterError
        If there are constraints, and the initial values violate one or a guard refuses parameters.
    SingularSystemError
        If there are constraints, and a linear system is singular at the start.
    CodegenError
        If there is no such integrator, or it takes neither the constraints nor events; or if the
        folder or a file cannot be written.
    """
    method = _METHODS.get(integrator)
    if method is None:
        raise CodegenError(f"there is no integrator '{integrator}'{nearest(integrator, _METHODS)}")
    check_numbers(t_end, rtol, atol)
    check_step(program, integrator, step)
    model = model_context(program)
    # Steps of one length go to the end time without breakpoints, points or events: no job is
    # needed.
    driver = {} if integrator in FIXED else driver_files(integrator)
    evaluated = Evaluated(program)
    is_dependent = evaluated.is_dependent()
    own: Mapping[str, str] = {}
    # Stages of an implicit method would contradict constraints that are dependent.
    if method.is_implicit:
        check_loops(program, integrator, is_dependent)
        own = {**render_newton(newton_context(program)), **stiff_files()}
    sources = [
        f"{model.prefix}.c",
        *(name for name in run_files() if name.endswith(".c")),
        *(name for name in own if name.endswith(".c")),
        f"cotree_{integrator}.c",
        "cotree_integrator.c",
        *(name for name in driver if name.endswith(".c")),
        "main.c",
    ]
    # Compilers differ in whether they fuse products and sums by default. Without, they agree.
    command = f"cc -std=c99 -O2 -ffp-contract=off -o {model.prefix} {' '.join(sources)} -lm"
    # All is refused or found before the first file is written.
    found = evaluated.found_start() if start is None else start
    check_start(evaluated, found)
    numbers = t_end, rtol, atol, step
    sizes = [] if found is None else evaluated.sizes(found)
    main = _main_context(program, model, integrator, command, numbers, is_dependent, found, sizes)
    texts = {**render_model(model), **run_files(), **own, **integrator_files(integrator), **driver}
    texts["main.c"] = render("c/main.c.jinja", main=main)
    _write_files(directory, texts)
    return CProject(directory, tuple(directory / name for name in texts), command)


def _main_context(
    program: Program,
    model: ModelContext,
    integrator: str,
    command: str,
    numbers: tuple[float, float, float, float | None],
    is_strict: bool,
    start: Start | None,
    sizes: Sequence[float],
) -> MainContext:
    t_end, rtol, atol, step = numbers
    return MainContext(
        title=model.title,
        name_literal=model.name_literal,
        prefix=model.prefix,
        upper=model.upper,
        generator=model.generator,
        integrator=integrator,
        is_implicit=_METHODS[integrator].is_implicit,
        command=command,
        t_end=literal(t_end),
        rtol=literal(rtol),
        atol=literal(atol),
        guards=[c_string(guard.demand) for guard in program.guards],
        stops=[] if step is not None else _stop_rows(program),  # steps of one length pass over
        max_step=_max_step(program),
        has_sensitivities=bool(model.sensitivities),
        seeds=_seeds(program),
        start=[] if start is None else _lines(start.z),
        n_constraints=model.n_constraints,
        n_algebraic=model.n_algebraic,
        n_events=len(program.layout.events),
        is_strict=is_strict,
        step="" if step is None else literal(step),
        is_extended=not _METHODS[integrator].is_implicit
        and program.can_extend
        and not program.layout.events,
        sizes=_lines(sizes),
        least=literal(atol * min(1.0, *sizes)) if sizes else "ATOL",
    )


def _seeds(program: Program) -> list[int]:
    places = {row.name: i for i, row in enumerate(program.layout.parameters)}
    # Initial values of states have no place among the parameters.
    return [places.get(name, -1) for name in program.layout.sensitivities]


def _stop_rows(program: Program) -> list[str]:
    """List the times of kinks of inputs and rates, at the program's parameter values."""
    symbols = program.dag
    values = {symbols.symbol("p", i): v for i, v in enumerate(program.layout.parameter_values)}
    rows = set()
    for stop in (stop for own in program.stops.values() for stop in own):
        first = value_of(stop.first, values)
        # Some times do not exist at these values: divided by a parameter that is zero, for example.
        if not math.isfinite(first):
            continue
        period = value_of(stop.period, values)
        # C takes positive periods only. Times that repeat in both directions are the same for a
        # period of the other sign, whose derivatives have the other sign, too.
        sign = math.copysign(1.0, period)
        slopes = [value_of(d, values) for pair in stop.along for d in pair]
        # One time only: C tells it by a period of zero, whose derivatives follow it.
        if not math.isfinite(period) or period == 0.0:
            period, slopes[1::2] = 0.0, [0.0] * len(stop.along)
        slopes[1::2] = [sign * d for d in slopes[1::2]]
        # With a positive period, times that began at the first one and went back end there.
        rows.add((first, abs(period), sign * stop.starts, *slopes))
    return [f"{{{', '.join(map(literal, row))}}}" for row in sorted(rows)]


def _max_step(program: Program) -> str:
    """Write the longest step at the program's parameter values; nothing if steps are unlimited."""
    longest = program.longest_step(program.layout.parameter_values)
    return literal(longest) if math.isfinite(longest) else ""


def _lines(values: Iterable[float]) -> list[str]:
    text = " ".join(f"{literal(float(value))}," for value in values)
    return textwrap.wrap(text, 96, break_long_words=False, break_on_hyphens=False)


def _write_files(directory: Path, texts: Mapping[str, str]) -> None:
    """Write all files beside their places, then move them there."""
    target_path(directory, "the C files to")
    try:
        directory.mkdir(parents=True, exist_ok=True)
        # In the same folder, so that moving a file is one rename on one file system.
        # All are complete before the first takes its place.
        with tempfile.TemporaryDirectory(prefix=".cotree-", dir=directory) as folder:
            for name, text in texts.items():
                with open(os.path.join(folder, name), "w", encoding="ascii", newline="\n") as file:
                    file.write(text)
            for name in texts:
                os.replace(os.path.join(folder, name), directory / name)
    except OSError as error:
        raise CodegenError(
            f"the C files cannot be written to '{directory}' ({error.strerror}): name a folder "
            "that can be created or written"
        ) from None
