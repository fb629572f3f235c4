"""A program to a folder of C files that a C99 compiler turns into an executable and a library.

The folder holds the model, integrators without dependencies, a main program that integrates the
model to its end time and prints the end state, and build files. If the model has constraints, the
main program finds a consistent start and projects onto them, as a run does. Algebraic unknowns are
solved for at each evaluation; the other states are integrated.
"""

from __future__ import annotations

import errno
import os
import tempfile
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from cotree.codegen.context import model_context
from cotree.codegen.integrators import method_files, stepper_files
from cotree.codegen.model_files import render_model
from cotree.codegen.newton import newton_context, render_newton
from cotree.codegen.render import render
from cotree.codegen.runtime import project_files, resolve
from cotree.codegen.single_file import prefixed, single_file
from cotree.codegen.tableaus import FIXED
from cotree.codegen.targets import BY_REAL, DOUBLE
from cotree.errors import CodegenError, nearest
from cotree.export.c_checks import (
    Evaluated,
    check_loops,
    check_methods,
    check_numbers,
    check_prefix,
    check_range,
    check_start,
    check_step,
)
from cotree.export.main_program import METHODS, Numbers, main_context
from cotree.files import target_path
from cotree.report import names

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from cotree.codegen.context import ModelContext
    from cotree.codegen.targets import Target
    from cotree.model.consistent import Start
    from cotree.program.program import Kernel, Program

#: The least relative tolerance of single precision: some hundred units in the last place, above the
#: rounding errors of rates.
_LEAST_RTOL = 2e-5


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
class Kit:
    """Options of a C project."""

    #: Names in ``METHODS``, separated by commas: the methods to compile; the first is the default.
    #: A method with fixed steps cannot be combined with others.
    integrator: str = "dopri5"
    real: str = "double"  # the type of numbers, ``double`` or ``float``
    #: Prefix of names in C and of files; empty for the name of the scene.
    prefix: str = ""
    has_wrapper: bool = False  # whether there is a header for C++, too
    #: Whether all C is in one header and one source, without build files.
    is_single: bool = False

    def methods(self) -> list[str]:
        """List the methods."""
        return [name.strip() for name in self.integrator.split(",")]

    def target(self) -> Target:
        """Return the target of the type."""
        if self.real not in BY_REAL:
            raise CodegenError(
                f"there is no type '{self.real}' of numbers: give {' or '.join(BY_REAL)}"
            )
        return BY_REAL[self.real]


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
    """Write a model with a main program that integrates it.

    Existing files are replaced atomically, once all are complete.

    Parameters
    ----------
    program : Program
        After its passes.
    directory : Path
        Folder of the files, created if it is missing.
    kit : Kit or str
        The contents of the project, or the methods only.
    t_end, rtol, atol : float
        End time of a run without arguments, [s], and tolerances of states and sensitivities. Those
        that single precision cannot meet are loosened.
    step : float, optional
        Length of all steps of a method of ``FIXED``, [s].
    start : Start, optional
        The state at the start, if that is not its own consistent start.
    evaluated : Evaluated, optional
        The program, for its start.

    Raises
    ------
    SceneError
        If the end time or a tolerance is not acceptable, or no folder can have the name.
    ParameterError, SingularSystemError
        If there are constraints, and the initial values violate one, a guard refuses parameters, or
        a linear system is singular at the start.
    CodegenError
        If there is no such integrator, or it takes neither the constraints nor events; if the
        prefix or the type of numbers is not accepted, or a parameter is beyond the range of the
        type; or if the folder or a file cannot be written.
    """
    kit = Kit(kit) if isinstance(kit, str) else kit
    methods, target = kit.methods(), kit.target()
    for name in methods:
        if name not in METHODS:
            raise CodegenError(f"there is no integrator '{name}'{nearest(name, METHODS)}")
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
    check_start(evaluated, found)
    numbers = Numbers(t_end, *_fitting(rtol, atol, target), step)
    sizes = [] if found is None else evaluated.sizes(found)
    main = main_context(
        program,
        model,
        methods,
        numbers,
        found,
        sizes,
        is_strict=is_dependent,
        is_found=found is not None and start is None and evaluated.is_found_in_c(found),
    )
    features = replace(
        model.features(),
        implicit=bool(implicit),
        moving_corners=bool(main.stops and model.layout.sensitivities) and methods[0] not in FIXED,
    )
    texts = dict(render_model(model, features))
    if implicit:
        texts |= render_newton(newton_context(program, target), features)
    for name in methods:
        texts |= method_files(name, target)
        # Fixed steps need no job: there are no breakpoints, output points or events.
        texts |= {} if name in FIXED else stepper_files(name, target)
    text = render("c/main/main.c.jinja", target, main=main)
    texts["main.c"] = resolve(text, main.conditions())
    texts = project_files(texts, target, features)
    # The model's file first, then those of the runtime.
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
    # Compilers have different defaults for fusing products and sums.
    flags = "-std=c99 -O2 -ffp-contract=off"
    command = f"cc {flags} -o {prefix} {compiled} -lm"
    _write_files(directory, texts)
    return CProject(directory, tuple(directory / name for name in texts), command)


def _fitting(rtol: float, atol: float, target: Target) -> tuple[float, float]:
    """Loosen both tolerances by one factor if they are below the precision of the type."""
    if target is DOUBLE or rtol >= _LEAST_RTOL:
        return rtol, atol
    return _LEAST_RTOL, atol * (_LEAST_RTOL / rtol if rtol > 0.0 else 1.0)


def _write_files(directory: Path, texts: Mapping[str, str]) -> None:
    """Write all files to a temporary folder, then move them."""
    target_path(directory, "the C files to")
    try:
        directory.mkdir(parents=True, exist_ok=True)
        # In the same folder, so that moving a file is one rename.
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


#: Constants of the header for C++ that are the lengths of arrays.
_LENGTHS = {"x": "n_states", "u": "n_inputs", "v": "n_states"}

#: Kernels for which the header for C++ has other functions.
_APART = frozenset({"prepare"})


@dataclass(frozen=True)
class MethodContext:
    """A kernel as a member function."""

    name: str  # its name; in C it follows the model's
    doc: str  # description of its results
    arguments: list[str]  # declarations
    checks: list[tuple[str, str]]  # arrays and the lengths that they need
    given: list[str]  # arguments of the kernel


@dataclass(frozen=True)
class KitContext:
    """The values that the templates of build files receive."""

    model: ModelContext
    sources: list[str]  # C files of the library
    headers: list[str]  # headers that are installed
    methods: list[MethodContext]  # kernels, for the header for C++


def kit_files(
    program: Program,
    model: ModelContext,
    sources: Sequence[str],
    headers: Sequence[str],
    *,
    has_wrapper: bool,
) -> Mapping[str, str]:
    """Write the build files of a project, and the header for C++ if it has one.

    ``sources`` make the library.
    """
    prefix = model.prefix
    wrapper = [f"{prefix}.hpp"] if has_wrapper else []
    kit = KitContext(
        model=model,
        sources=list(sources),
        headers=[*headers, *wrapper],
        methods=[_method(k, model) for k in program.kernels.values() if _is_wrapped(k)],
    )
    files = {
        "CMakeLists.txt": "CMakeLists.txt",
        "Makefile": "Makefile",
        f"{prefix}.pc.in": "pc.in",
        **dict.fromkeys(wrapper, "model.hpp"),
    }
    return {name: render(f"c/kit/{file}.jinja", kit=kit) for name, file in files.items()}


def _is_wrapped(kernel: Kernel) -> bool:
    return kernel.is_present and kernel.spec.name not in _APART


def _method(kernel: Kernel, model: ModelContext) -> MethodContext:
    """Build a kernel as a member function; p and k are members."""
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
