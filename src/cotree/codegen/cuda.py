"""The C of a model and of the engine that runs members of an ensemble, as one file of CUDA.

In: the program of a model and a method. Out: their C as the target ``CUDA`` prints it, in one unit,
which compilers of C++ take, too, with the functions that threads of a graphics processor begin
with.

Functions of different sources may share a name: C++ tells them apart by the structures that they
take first. Macros that sources share are undefined in between by the templates of these.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from cotree.codegen.context import model_context
from cotree.codegen.integrators import batch_files, engine_files
from cotree.codegen.render import render, render_model
from cotree.codegen.targets import CUDA
from cotree.version import VERSION

if TYPE_CHECKING:
    from cotree.codegen.model_text import ModelText

#: What each worker has for itself, in the order in which its memory holds it.
ROOMS = ("memory", "k", "u", "z", "times", "inputs", "outputs", "slopes")

# Headers that are the same for every model and method, each behind those that it reads.
_HEADERS = (
    *("cotree_abi.h", "cotree_lu.h", "cotree_run.h", "cotree_job.h", "cotree_batch.h"),
    *("cotree_integrator.h", "cotree_history.h", "cotree_jumps.h", "cotree_events.h"),
    *("cotree_sweep.h", "cotree_stepper.h"),
)


def cuda_text(model: ModelText, stepper: str) -> str:
    """Write the file.

    Parameters
    ----------
    model : ModelText
        The model.
    stepper : str
        An explicit method of ``codegen.integrators.INTEGRATORS``.
    """
    own = render_model(model_context(model.program, CUDA))
    files = {**batch_files(CUDA), **engine_files(stepper, CUDA), **own}
    # All headers come first: what they declare has the same name in all sources.
    headers = (*_HEADERS, f"{model.prefix}.h", f"cotree_{stepper}.h")
    sources = sorted(name for name in files if name.endswith(".c"))
    return render(
        "c/cuda/members.cu.jinja",
        CUDA,
        generator=VERSION,
        headers=[files[name] for name in headers],
        sources=[files[name] for name in sources],
        rooms=ROOMS,
        prefix=model.prefix,
        stepper=stepper,
    )
