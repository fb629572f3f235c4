"""Export of a program to C99 files that build an executable and a library.

The folder holds the model, integrators without dependencies, a main program that integrates the
model to its end time and prints the end state, and build files.

Numbers that follow from parameters when the text is written (the start, the times of kinks) are
constants of the main program, which refuses to change the parameters that they depend on.
"""

from __future__ import annotations

import errno
import math
import os
import tempfile
import textwrap
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

from cotree.codegen.c_files import INTEGRATORS, method_files, render_model, stepper_files
from cotree.codegen.context import ModelContext, model_context
from cotree.codegen.newton import newton_context, render_newton
from cotree.codegen.printing import wrapped
from cotree.codegen.render import project_files, render, resolve
from cotree.codegen.single_file import prefixed, single_file
from cotree.codegen.start_tables import StartTables, start_tables
from cotree.codegen.tableaus import FIXED, FixedStep, RosenbrockTableau, Tableau
from cotree.codegen.targets import BY_REAL, DOUBLE, Target
from cotree.dag.nodes import Node, symbols_in
from cotree.dag.switching_times import value_of
from cotree.errors import CodegenError, SolveError, check_known
from cotree.export.c_checks import (
    Evaluated,
    check_loops,
    check_methods,
    check_numbers,
    check_prefix,
    check_range,
    check_step,
)
from cotree.files import target_path
from cotree.report import names
from cotree.scene.settings import MOST_STEPS
from cotree.sharing import forming

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence
    from pathlib import Path

    from cotree.model.start import Start
    from cotree.program.program import Kernel, Program
    from cotree.scene.settings import Simulation


#: All methods of C projects, by name: those with step size control, and those with fixed steps.
METHODS: dict[str, Tableau | RosenbrockTableau | FixedStep] = {**INTEGRATORS, **FIXED}

#: Kernels on whose parameters a computed start depends.
_OF_START = (
    *("initial", "initial_sensitivity", "constraints", "constraint_sensitivity", "gradient"),
    *("start", "start_gradient", "start_sensitivity"),
)


# Maximum number of steps between two events in a page, which does not respond while it runs.
_PAGE_STEPS = 100_000


@dataclass(frozen=True)
class MainContext:
    """The variables of the main program's template."""

    model: ModelContext
    integrator: str  # name of the default method
    methods: list[str]  # names of all compiled methods
    implicit: list[str]  # names of the methods that need a Jacobian
    #: End time and tolerances as C literals.
    t_end: str
    rtol: str
    atol: str
    has_rtol: bool  # whether any equations are solved to a relative tolerance
    #: A C initialiser for each series of time events: first time, period (zero if single), and 1 if
    #: no event precedes the first time.
    time_events: list[str]
    max_step: str
    seeds: list[int]  # indices of the sensitivity parameters, -1 for initial values
    #: C literals, line by line, of initial states and sensitivities; empty if C computes them.
    start: list[str]
    #: Tables from which C computes the start if conditions constrain it; else None.
    start_tables: StartTables | None
    guess: list[str]  # C literals of initial guesses, if any
    is_strict: bool  # whether rates are evaluated at points projected onto constraints
    step: str  # fixed step size as C text; empty if the step size is controlled
    is_extended: bool  # whether algebraic unknowns are integrated
    sizes: list[str]  # C literals of the factors of absolute tolerances
    #: For each parameter, 1 if constants in the C text depend on it, else 0; empty if all are 0.
    held: list[str]
    most_steps: int  # maximum number of steps between two events
    is_page: bool  # whether the program is run by a page instead of a command line

    def conditions(self) -> dict[str, bool]:
        """Return the value of each macro in the preprocessor conditions of the main program."""
        model, layout = self.model, self.model.layout
        found = {
            "CONSTRAINTS": bool(layout.constraints),
            "EVENTS": bool(layout.events),
            "EXPLICIT": len(self.implicit) < len(self.methods),
            "EXTENDED": self.is_extended,
            "FIXED": bool(self.step),
            "GUARDS": bool(model.guards),
            "GUESS": bool(self.guess),
            "HELD": bool(self.held),
            "METHODS": len(self.methods) > 1,
            "PAGE": self.is_page,
            "PARAMETERS": bool(layout.parameters),
            "RTOL": self.has_rtol,
            "START": bool(self.start),
            "TIME_EVENTS": bool(self.time_events),
            "TABLES": self.start_tables is not None,
            "TURNS": bool(layout.sensitivities and self.time_events),
        }
        return {f"COTREE_MAIN_{name}": value for name, value in found.items()}


def main_context(
    program: Program,
    model: ModelContext,
    methods: Sequence[str],
    start: Start | None,
    sizes: Sequence[float],
    *,
    t_end: float,
    rtol: float,
    atol: float,
    step: float | None,
    is_strict: bool,
    is_found: bool,
    is_page: bool,
) -> MainContext:
    """Build the template variables of the main program; ``methods`` begin with the default one.

    ``is_found``: C can compute the start, also for other values. ``is_strict``: constraints are
    dependent, and rates are evaluated at projected points.
    """
    implicit = [name for name in methods if METHODS[name].is_implicit]
    target, layout = model.target, program.layout
    has_explicit = len(implicit) < len(methods)
    sought, known = (start, None) if is_found else (None, start)
    has_guess = layout.n_algebraic or any(row.part for row in layout.events)
    longest = program.longest_step(layout.parameter_values)
    held = held_parameters(program, has_start=known is not None)
    places = {row.name: i for i, row in enumerate(layout.parameters)}
    return MainContext(
        model=model,
        integrator=methods[0],
        methods=list(methods),
        implicit=implicit,
        t_end=target.literal(t_end),
        rtol=target.literal(rtol),
        atol=target.literal(atol),
        has_rtol=step is None or not implicit,
        # Fixed-step methods do not locate time events.
        time_events=[] if step is not None else _time_event_rows(program, target),
        max_step=target.literal(longest) if math.isfinite(longest) else "",
        # Initial values may also have sensitivities, but they are not parameters.
        seeds=[places.get(name, -1) for name in layout.sensitivities],
        start=[] if known is None else _lines(known.z, target),
        start_tables=None if sought is None else start_tables(layout),
        # Algebraic unknowns and the modes of friction and stops require guesses.
        guess=_lines(sought.y, target) if sought is not None and has_guess else [],
        is_strict=is_strict,
        step="" if step is None else target.literal(step),
        is_extended=has_explicit and program.traits.can_extend(layout) and not layout.events,
        sizes=_lines(sizes, target),
        held=wrapped(str(int(i in held)) for i in range(len(places))) if held else [],
        most_steps=_PAGE_STEPS if is_page else MOST_STEPS,
        is_page=is_page,
    )


def held_parameters(program: Program, *, has_start: bool) -> frozenset[int]:
    """Return the indices of the parameters on which constants in the C text depend."""
    roots: list[Node] = []
    if has_start:
        layout = program.layout
        roots += [node for name in _OF_START for node in program.kernels[name].results]
        # The rate of an algebraic unknown is the residual of its equation.
        if layout.n_algebraic:
            n = len(layout.states)
            roots += program.kernels["rhs"].results[n - layout.n_algebraic :]
            roots += program.kernels["inputs"].results
        if any(row.is_jump for row in layout.events):
            roots += [*program.kernels["events"].results, *program.kernels["inputs"].results]
    for event in (event for own in program.time_events.values() for event in own):
        roots += [event.first, *(d for pair in event.along for d in pair)]
        roots += [] if event.period is None else [event.period]
    roots += [limit for own in program.longest_steps.values() for limit in own]
    return frozenset(s.data[1] for s in symbols_in(roots) if s.data[0] == "p")


def _time_event_rows(program: Program, target: Target) -> list[str]:
    symbols = program.dag
    values = {symbols.symbol("p", i): v for i, v in enumerate(program.layout.parameter_values)}
    rows = set()
    for event in (event for own in program.time_events.values() for event in own):
        first = value_of(event.first, values)
        # A time may not exist for these values, such as a quotient with a zero divisor.
        if not math.isfinite(first):
            continue
        period = value_of(event.period, values)
        # C requires positive periods, so change the signs of a negative period and its derivatives.
        sign = math.copysign(1.0, period)
        slopes = [value_of(d, values) for pair in event.along for d in pair]
        # A single time event has period zero.
        if not math.isfinite(period) or period == 0.0:
            period, slopes[1::2] = 0.0, [0.0] * len(event.along)
        slopes[1::2] = [sign * d for d in slopes[1::2]]
        rows.add((first, abs(period), sign * event.starts, *slopes))
    return [f"{{{', '.join(map(target.literal, row))}}}" for row in sorted(rows)]


def _lines(values: Iterable[float], target: Target) -> list[str]:
    text = " ".join(f"{target.literal(value)}," for value in values)
    return textwrap.wrap(text, 96, break_long_words=False, break_on_hyphens=False)


#: Smallest relative tolerance in single precision, some hundred units in the last place.
_LEAST_RTOL = 2e-5


@dataclass(frozen=True, repr=False)
class CProject:
    """A C project that was written to a folder.

    Attributes
    ----------
    directory : Path
        The folder.
    files : tuple of Path
        The files written there.
    command : str
        Shell command that builds the executable in the folder.
    """

    directory: Path
    files: tuple[Path, ...]
    command: str

    def __repr__(self) -> str:
        files = names([file.name for file in self.files])
        where = str(self.directory)
        return f"<CProject {where}: {files}>\n  build it there with: {self.command}"


@dataclass(frozen=True)
class Kit:
    """The options of a C project."""

    #: Names of the methods to compile, keys of ``METHODS`` separated by commas; the first is the
    #: default. A fixed-step method cannot be combined with others.
    integrator: str = "dopri5"
    real: str = "double"  # C type of numbers, ``double`` or ``float``
    #: Prefix of C names and file names; if empty, the scene's name.
    prefix: str = ""
    has_wrapper: bool = False  # whether a C++ header is written
    #: Whether to write one header and one source without build files.
    is_single: bool = False
    is_page: bool = False  # whether the program is run by a page instead of a command line

    def methods(self) -> list[str]:
        """Return the names of the methods to compile."""
        return [name.strip() for name in self.integrator.split(",")]

    def target(self) -> Target:
        """Return the code generation target for the number type."""
        if self.real not in BY_REAL:
            raise CodegenError(
                f"there is no type '{self.real}' of numbers: give {' or '.join(BY_REAL)}"
            )
        return BY_REAL[self.real]


def write_project_of(
    model: Any, directory: Path, kit: Kit, step: float | None, defaults: Simulation
) -> CProject:
    """Write a C project of a :class:`cotree.Model`; see :meth:`cotree.Model.write`."""
    numbers = {"t_end": defaults.t_end, "rtol": defaults.rtol, "atol": defaults.atol}
    # C projects do not search for operating points, so they receive the start.
    start = model.start() if model.kernels.begins_at_rest else None
    # Hold the lock: forming kernels adds nodes to the program's arena, which threads share.
    with forming:
        own = Evaluated(model.kernels.program, model.kernels)
        return write_c_project(
            own.program, directory, kit, **numbers, step=step, start=start, evaluated=own
        )


def project_texts(
    program: Program,
    kit: Kit,
    numbers: Mapping[str, float],
    step: float | None = None,
    start: Start | None = None,
    evaluated: Evaluated | None = None,
) -> tuple[Program, ModelContext, MainContext, dict[str, str]]:
    """Return the C files of a project by name, the program under its prefix, and their contexts.

    ``numbers`` are ``t_end``, ``rtol`` and ``atol``; see :func:`write_c_project`.
    """
    t_end, rtol, atol = (numbers[name] for name in ("t_end", "rtol", "atol"))
    methods, target = kit.methods(), kit.target()
    check_known(methods, METHODS, "there is no integrator", error=CodegenError)
    check_methods(methods)
    check_numbers(t_end, rtol, atol)
    check_step(program, methods[0], step)
    if kit.prefix:
        named = check_prefix(kit.prefix)
        program = replace(program, layout=replace(program.layout, name=named))
    check_range(program, target)
    model = model_context(program, target)
    evaluated = evaluated or Evaluated(program)
    is_dependent = evaluated.is_dependent()
    implicit = [name for name in methods if METHODS[name].is_implicit]
    if implicit:
        check_loops(program, implicit[0], is_dependent)
    found = evaluated.found_start() if start is None else start
    if found is not None and found.on_jump:
        raise SolveError(found.on_jump)
    if target is not DOUBLE and rtol < _LEAST_RTOL:  # increase both by the same factor
        rtol, atol = _LEAST_RTOL, atol * (_LEAST_RTOL / rtol if rtol > 0.0 else 1.0)
    sizes = [] if found is None else evaluated.sizes(found)
    main = main_context(
        program,
        model,
        methods,
        found,
        sizes,
        t_end=t_end,
        rtol=rtol,
        atol=atol,
        step=step,
        is_strict=is_dependent,
        # C can also find this start, unless Python mended it or added a note.
        is_found=found is not None and start is None and not (found.is_mended or found.note),
        is_page=kit.is_page,
    )
    features = replace(
        model.features(),
        implicit=bool(implicit),
        moving_breakpoints=bool(main.time_events and model.layout.sensitivities)
        and methods[0] not in FIXED,
    )
    texts = dict(render_model(model, features))
    if implicit:
        texts |= render_newton(newton_context(program, target), features)
    for name in methods:
        texts |= method_files(name, target)
        # Fixed-step methods have no breakpoints, output points or events, so they need no job.
        texts |= {} if name in FIXED else stepper_files(name, target)
    text = render("c/main/main.c.jinja", target, main=main)
    texts["main.c"] = resolve(text, main.conditions())
    return program, model, main, project_files(texts, target, features)


def write_c_project(
    program: Program,
    directory: Path,
    kit: Kit | str = "dopri5",
    *,
    t_end: float,
    rtol: float,
    atol: float,
    step: float | None = None,
    start: Start | None = None,
    evaluated: Evaluated | None = None,
) -> CProject:
    """Write a C project with the model and a main program that integrates it.

    Existing files are replaced atomically, once all are complete.

    Parameters
    ----------
    kit : Kit or str
        The options of the project, or only the names of the methods.
    t_end, rtol, atol : float
        Default end time, [s], and default tolerances, loosened if the number type cannot meet them.
    step : float, optional
        Step size of a fixed-step method, [s].
    start : Start, optional
        Initial states that replace the program's own consistent start.
    evaluated : Evaluated, optional
        The program with its start, if already computed.

    Raises
    ------
    SceneError
        If the end time, a tolerance or the folder's name is invalid.
    ParameterError, SingularSystemError
        If the initial values violate a constraint, a guard refuses parameters, or a linear system
        is singular at the start.
    CodegenError
        If a method, the prefix or the number type is invalid, or a file cannot be written.
    """
    kit = Kit(kit) if isinstance(kit, str) else kit
    numbers = {"t_end": t_end, "rtol": rtol, "atol": atol}
    program, model, _, texts = project_texts(program, kit, numbers, step, start, evaluated)
    # In a single file, the model precedes the runtime.
    sources = sorted(name for name in texts if name.endswith(".c") and name != "main.c")
    sources.sort(key=lambda name: name.startswith("cotree_"))
    headers = sorted(name for name in texts if name.endswith(".h"))
    files = kit_files(program, model, sources, headers, has_wrapper=kit.has_wrapper)
    prefix, compiled = model.prefix, f"{' '.join(sources)} main.c"
    if kit.is_single:
        wrapper = f"{prefix}.hpp"
        files = {wrapper: prefixed(files[wrapper], texts, prefix)} if kit.has_wrapper else {}
        texts = single_file(texts, prefix)
        compiled = f"-D{model.upper}_MAIN {prefix}.c"
    texts |= files
    # Compilers differ in whether they fuse products with sums by default.
    flags = "-std=c99 -O2 -ffp-contract=off"
    command = f"cc {flags} -o {prefix} {compiled} -lm"
    _write_files(directory, texts)
    return CProject(directory, tuple(directory / name for name in texts), command)


def _write_files(directory: Path, texts: Mapping[str, str]) -> None:
    """Write all files to a temporary folder, then move them to ``directory``."""
    target_path(directory, "the C files to")
    try:
        directory.mkdir(parents=True, exist_ok=True)
        # The temporary folder is inside the target folder, so that each move is a renaming.
        with tempfile.TemporaryDirectory(prefix=".cotree-", dir=directory) as folder:
            for name, text in texts.items():
                with open(os.path.join(folder, name), "w", encoding="ascii", newline="\n") as file:
                    file.write(text)
            for name in texts:
                if (directory / name).is_dir():
                    raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), name)
            for name in texts:
                os.replace(os.path.join(folder, name), directory / name)
    except OSError as error:
        raise CodegenError(
            f"the C files cannot be written to '{directory}' ({error.strerror}): name a folder "
            "that can be created or written"
        ) from None


#: Array lengths that are constants in the C++ header.
_LENGTHS = {"x": "n_states", "u": "n_inputs", "v": "n_states"}

#: Kernels that the C++ header wraps separately.
_APART = frozenset({"prepare"})


@dataclass(frozen=True)
class MethodContext:
    """Template variables of a kernel's member function in the C++ header."""

    name: str  # name of the function, without the prefix of the model
    doc: str  # description of the results
    arguments: list[str]  # argument declarations
    checks: list[tuple[str, str]]  # array arguments with their required lengths
    given: list[str]  # arguments passed to the kernel


@dataclass(frozen=True)
class KitContext:
    """The variables of the build files' templates."""

    model: ModelContext
    sources: list[str]  # paths of the library's C files
    headers: list[str]  # paths of the installed headers
    methods: list[MethodContext]  # kernels for the C++ header


def kit_files(
    program: Program,
    model: ModelContext,
    sources: Sequence[str],
    headers: Sequence[str],
    *,
    has_wrapper: bool,
) -> Mapping[str, str]:
    """Return the build files of a project and its C++ header, if any, as texts by file name."""
    prefix = model.prefix
    wrapper = [f"{prefix}.hpp"] if has_wrapper else []
    kit = KitContext(
        model=model,
        sources=list(sources),
        headers=[*headers, *wrapper],
        methods=[
            _method(kernel, model)
            for kernel in program.kernels.values()
            if kernel.is_present and kernel.spec.name not in _APART
        ],
    )
    files = {
        "CMakeLists.txt": "CMakeLists.txt",
        "Makefile": "Makefile",
        f"{prefix}.pc.in": "pc.in",
        **dict.fromkeys(wrapper, "model.hpp"),
    }
    return {name: render(f"c/kit/{file}.jinja", kit=kit) for name, file in files.items()}


def _method(kernel: Kernel, model: ModelContext) -> MethodContext:
    """Build the template variables of a kernel's member function; p and k are data members."""
    spec = kernel.spec
    lengths = {**_LENGTHS, "s": "n_reached" if spec.is_packed else "n_states * n_sensitivities"}
    arrays = [name for name in spec.arguments if name in lengths]
    heads = ["real t"] if "t" in spec.arguments else []
    heads += [f"span<const real> {name}" for name in arrays]
    checks = [(name, lengths[name]) for name in arrays]
    given = {name: f"{name}.data()" for name in arrays} | {"p": "p_.data()", "k": "k_.data()"}
    return MethodContext(
        name=spec.name,
        doc=f"{spec.doc[0].upper()}{spec.doc[1:]}",
        arguments=[*heads, f"span<real> {spec.result}"],
        checks=[*checks, (spec.result, str(len(kernel.results)))],
        given=[*(given.get(name, name) for name in spec.arguments), f"{spec.result}.data()"],
    )
