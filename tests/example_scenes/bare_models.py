"""Models without a Jacobian, which is most of the work, for tests that never look at one."""

from __future__ import annotations

from typing import TYPE_CHECKING

from evaluated_kernels import EvaluatedKernels

from cotree.build import BuildOptions, build_library, find_toolchain, load_library
from cotree.codegen.c_files import cdef, render_model
from cotree.codegen.context import model_context
from cotree.compiled import Model
from cotree.formulation.first_graph import form_first_graph
from cotree.model.kernels import Kernels
from cotree.model.model import CompiledModel
from cotree.pipeline import generate, trees_to_try
from cotree.program.lower import lower
from cotree.program.text import ModelText
from cotree.sensitivity.graphs import form_equations
from cotree.version import ABI_VERSION

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cotree import Scene
    from cotree.program.program import Program

EVERY_CLUSTER = tuple(range(1, 40))


class BareModel(Model):
    """A model without its scene; it starts as one with it does."""

    def __init__(self, program: Program, kernels: Kernels) -> None:
        super().__init__(CompiledModel(ModelText.of(program), kernels), b"", {})


def evaluated(
    scene: Scene, tree: Sequence[str] | None = None, wanted: Sequence[str] = ()
) -> BareModel:
    """Return the model, evaluated in Python: for a few calls.

    Its vectors stand in the axes of the ground; to count what other axes cost takes ten times as
    long as to form the equations.
    """
    first = form_first_graph(scene, trees_to_try(scene, tree)[0])
    program = lower(form_equations(first, wanted, with_columns=False))
    return BareModel(program, EvaluatedKernels(program))


def compiled(scene: Scene, tree: Sequence[str] | None = None) -> BareModel:
    """Return the model in C, compiled without optimisation, every cluster in its own axes."""
    first = form_first_graph(scene, trees_to_try(scene, tree)[0], EVERY_CLUSTER)
    program, _ = generate(form_equations(first, (), with_columns=False))
    context = model_context(program)
    files, toolchain = render_model(context), find_toolchain()
    assert toolchain is not None  # or the test is skipped
    options = BuildOptions(optimize="-O0")
    library = build_library(
        files, abi_version=ABI_VERSION, n_operations=0, options=options, toolchain=toolchain
    )
    loaded = load_library(library.path, cdef(files["cotree_abi.h"], context.prefix))
    return BareModel(program, Kernels(ModelText.of(program, prefix=context.prefix), loaded))
