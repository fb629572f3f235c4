"""Build files of a C project, and its header for C++.

In: a program, the context of its model, and the names of its C files. Out: a CMake project whose
library can be installed and found, a Makefile, a file for pkg-config, and the header.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from cotree.codegen.render import render
from cotree.version import VERSION

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from cotree.codegen.context import ModelContext
    from cotree.program import Kernel, Program

#: What the length of each array follows from, as a constant of the header for C++.
_LENGTHS = {"x": "n_states", "u": "n_inputs", "v": "n_states"}

#: Kernels that the header for C++ has functions of its own for.
_APART = frozenset({"prepare"})


@dataclass(frozen=True)
class MethodContext:
    """A kernel as a member function.

    Attributes
    ----------
    name : str
        Its name; in C it follows the model's.
    doc : str
        What its results are.
    arguments : list of str
        Declarations.
    checks : list of tuple of str
        An array and the length that it needs, each.
    given : list of str
        What the kernel is called with.
    """

    name: str
    doc: str
    arguments: list[str]
    checks: list[tuple[str, str]]
    given: list[str]


@dataclass(frozen=True)
class KitContext:
    """The values that the templates of build files receive.

    Attributes
    ----------
    title, prefix, upper, generator : str
        As in the model's context.
    sources : list of str
        C files of the library.
    headers : list of str
        Headers that are installed.
    methods : list of MethodContext
        Kernels, for the header for C++.
    parameters : bool
        Whether there are parameters.
    """

    title: str
    prefix: str
    upper: str
    generator: str
    sources: list[str]
    headers: list[str]
    methods: list[MethodContext]
    parameters: bool


def kit_files(
    program: Program,
    model: ModelContext,
    sources: Sequence[str],
    headers: Sequence[str],
    *,
    has_wrapper: bool,
) -> Mapping[str, str]:
    """Write the build files of a project.

    Parameters
    ----------
    program : Program
        After its passes.
    model : ModelContext
        Its context.
    sources, headers : sequence of str
        Names of the C files that make the library, and of headers.
    has_wrapper : bool
        Whether to write the header for C++.

    Returns
    -------
    mapping of str to str
        Text by file name.
    """
    prefix = model.prefix
    wrapper = [f"{prefix}.hpp"] if has_wrapper else []
    kit = KitContext(
        title=model.title,
        prefix=prefix,
        upper=model.upper,
        generator=VERSION,
        sources=list(sources),
        headers=[*headers, *wrapper],
        methods=[_method(k, model) for k in program.kernels.values() if _is_wrapped(k)],
        parameters=bool(model.parameters),
    )
    files = {
        "CMakeLists.txt": "CMakeLists.txt",
        "Makefile": "Makefile",
        f"{prefix}Config.cmake.in": "Config.cmake.in",
        f"{prefix}.pc.in": "pc.in",
        **dict.fromkeys(wrapper, "model.hpp"),
    }
    return {name: render(f"c/kit/{file}.jinja", kit=kit) for name, file in files.items()}


def _is_wrapped(kernel: Kernel) -> bool:
    return kernel.is_present and kernel.spec.name not in _APART


def _method(kernel: Kernel, model: ModelContext) -> MethodContext:
    """Write a kernel as a member function of what a model holds: p and k."""
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
