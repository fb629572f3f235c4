"""Lanes: members side by side in vectors. Conditions for their use, and the library.

In: a ``Pattern``. Out: the code of its lanes, compiled for the first ensemble that uses it; or the
reason why its members run one at a time.
"""

from __future__ import annotations

import platform
import threading
import weakref
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from cotree.build import BuildOptions, find_toolchain
from cotree.build.compile import cpu_features
from cotree.codegen.lanes import (
    Lanes,
    lanes_context,
    lanes_declarations,
    lanes_refusal,
    render_lanes,
)
from cotree.errors import SolveError
from cotree.model.kernels import load_kernels
from cotree.sharing import forming

if TYPE_CHECKING:
    from cotree.build import LoadedLibrary
    from cotree.ensemble.pattern import Pattern
    from cotree.model.model import CompiledModel

# Loaded lanes of models, by method, vectors and sensitivities; loaded by one thread at a time.
_loaded: weakref.WeakKeyDictionary[CompiledModel, dict[tuple[Any, ...], LoadedLanes | str]] = (
    weakref.WeakKeyDictionary()
)
_building = threading.Lock()

# A second vector is faster if the members of a vector integrate at most this many numbers.
_FEW = 48

#: Permitted numbers of lanes; 1 disables them.
WIDTHS = (1, 2, 4, 8, 16)


@dataclass(frozen=True, eq=False)
class LoadedLanes:
    """Lanes of a model."""

    n_lanes: int  # members per call
    n_bytes: int  # memory per worker
    work: int  # address of the function
    library: LoadedLibrary  # the library, which keeps the code loaded


def find_lanes(pattern: Pattern) -> LoadedLanes | str:
    """Find or build the lanes of a pattern, or return why its members use none.

    The choice depends only on the plan and the processor, not on the number of members, so that
    results do not depend on the other members of a block.
    """
    why = refusal_of(pattern)
    if why:
        return why
    key = _key(pattern)
    with _building:
        loaded = _loaded.setdefault(pattern.plan.model, {})
        if key not in loaded:
            loaded[key] = _load(pattern, *key)
        return loaded[key]


def refusal_of(pattern: Pattern) -> str:
    """Return why members cannot run in lanes, or an empty string.

    A reason has no capital and no full stop. Whether the compiler supports vectors is found by
    building lanes.
    """
    plan, problem = pattern.plan, pattern.problem
    if plan.lanes is not None and plan.lanes not in WIDTHS:
        raise SolveError(
            f"lanes is {plan.lanes}; give one of {', '.join(map(str, WIDTHS))}, or None"
        )
    if plan.lanes == 1:
        return "one lane is requested"
    found = _loaded.get(plan.model, {}).get(_key(pattern))
    if found is not None:
        return found if isinstance(found, str) else ""
    why = lanes_refusal(
        plan.model.program, pattern.row.name, has_sensitivities=problem.n_sensitivities > 0
    )
    if why:
        return why
    if pattern.signals.by_position:
        return "the run replaces inputs of the scene"
    if problem.settings.t_eval is None or not len(problem.settings.t_eval):
        return "no output times are given"
    if len(problem.breakpoints):
        return "rates have kinks or jumps at known times"
    if pattern.is_searched:
        return "members are prepared in Python: their starts or time events differ"
    return ""


def _key(pattern: Pattern) -> tuple[str, Lanes, bool]:
    """Return the parts of a pattern that determine the code of lanes."""
    lanes = lanes_of(cpu_features().split(), pattern.plan.lanes, pattern.problem.size)
    return pattern.row.name, lanes, pattern.problem.n_sensitivities > 0


def lanes_of(features: list[str], wanted: int | None = None, n_integrated: int = 64) -> Lanes:
    """Choose vectors for a processor."""
    machine, own = platform.machine().lower(), set(features)
    width, instructions, is_fused = 2, [], machine in ("aarch64", "arm64")
    if machine in ("x86_64", "amd64"):
        # Contraction to fused products depends on the processor, not on the width.
        is_fused = {"avx2", "fma"} <= own
        if is_fused and {"avx512f", "avx512dq", "avx512vl"} <= own:
            width, instructions = 8, ["avx512f", "avx512dq", "avx512vl"]
        elif "avx2" in own:
            width, instructions = 4, ["avx2"]
        instructions += ["fma"] * is_fused
    # Two interleaved vectors are 5 to 10 % faster for small members; larger ones no longer fit in
    # the nearest cache.
    wanted = wanted or (2 * width if width > 2 and width * n_integrated <= _FEW else width)
    width = min(width, wanted)
    return Lanes(width, wanted // width, ",".join(instructions), is_fused)


def _load(
    pattern: Pattern, method: str, lanes: Lanes, has_sensitivities: bool
) -> LoadedLanes | str:
    """Build and load lanes."""
    if find_toolchain() is None:
        return "no compiler is found"
    # Unrolled columns of maps become new nodes of the model's arena.
    with forming:
        program = pattern.plan.model.program
        model = lanes_context(program, method, lanes, has_sensitivities=has_sensitivities)
        files = render_lanes(model, method)
    # This optimisation level merges common work of kernels and steps.
    library = load_kernels(model, files, lanes_declarations(model), BuildOptions("-O3"))
    if library is None:
        return "the compiler has no vectors"
    found = getattr(library.lib, f"{model.prefix}_lanes")()
    work = int(library.ffi.cast("uintptr_t", found.work))
    return LoadedLanes(int(found.n_lanes), int(found.n_bytes), work, library)
