"""Models without a Jacobian, which is most of the work, for tests that never look at one."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from cotree.build import BuildOptions, build_library, find_toolchain, load_library
from cotree.codegen.context import model_context
from cotree.codegen.render import cdef, render_model
from cotree.model.kernels import CKernels, PythonKernels
from cotree.model.model import CompiledModel
from cotree.pipeline import formulate, generate
from cotree.program.lower import lower
from cotree.version import ABI_VERSION

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cotree import Scene
    from cotree.equations import Equations


def evaluated(
    scene: Scene, tree: Sequence[str] | None = None, wanted: Sequence[str] = ()
) -> CompiledModel:
    """Give the model, evaluated in Python: for a few calls."""
    program = lower(_bare(scene, tree, wanted))
    return CompiledModel(program, PythonKernels(program))


def compiled(scene: Scene, tree: Sequence[str] | None = None) -> CompiledModel:
    """Give the model in C, compiled without optimisation."""
    program, _ = generate(_bare(scene, tree, ()))
    context = model_context(program)
    files, toolchain = render_model(context), find_toolchain()
    assert toolchain is not None  # or the test is skipped
    options = BuildOptions(optimize="-O0")
    library = build_library(
        files, abi_version=ABI_VERSION, n_operations=0, options=options, toolchain=toolchain
    )
    loaded = load_library(library.path, cdef(files["cotree_abi.h"], context.prefix))
    return CompiledModel(program, CKernels(program, loaded, context.prefix))


def _bare(scene: Scene, tree: Sequence[str] | None, wanted: Sequence[str]) -> Equations:
    return replace(formulate(scene, wanted, tree)[1], columns=())
