"""C text of the adjoint kernels of a model."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from cotree.codegen.context import KernelFile, file_fields, kernel_context, name_tables
from cotree.codegen.render import render, with_runtime
from cotree.naming import c_identifier
from cotree.program.adjoint import form_adjoints
from cotree.quiet import without_collection

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping, Sequence

    from cotree.program.program import Program


@dataclass(frozen=True)
class AdjointContext(KernelFile):
    """Template data of ``<model>_adjoint.c``."""

    n_sources: int
    n_parameters: int


@without_collection()
def adjoint_context(
    program: Program, parameters: Sequence[str], replaced: Collection[str]
) -> AdjointContext:
    """Build the template data; see :func:`cotree.program.adjoint.form_adjoints`."""
    name = program.layout.name
    formed = form_adjoints(program, parameters, replaced)
    nodes = [node for kernel in formed.kernels for node in kernel.order]
    names = name_tables(nodes)
    kernels = [
        kernel_context(c_identifier(name), kernel, program, names, {}) for kernel in formed.kernels
    ]
    return AdjointContext(
        **file_fields(name, nodes, kernels),
        n_sources=formed.n_sources,
        n_parameters=len(parameters),
    )


def render_adjoint(model: AdjointContext) -> Mapping[str, str]:
    """Return the file of a model, and the headers that it includes, by name."""
    files = {f"{model.prefix}_adjoint.c": render("c/adjoint.c.jinja", model=model)}
    return with_runtime(files, has_sources=False)


def adjoint_declarations(model: AdjointContext) -> str:
    """Return the declarations of the file for cffi."""
    return f"const void *{model.prefix}_adjoint(void);\n"
