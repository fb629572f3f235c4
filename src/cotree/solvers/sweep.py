"""Inputs, outputs and their sensitivities along a trajectory, in C."""

from __future__ import annotations

from typing import TYPE_CHECKING, NoReturn

import numpy as np

from cotree.codegen.integrators import sweep_declarations, sweep_files
from cotree.errors import BuildError, SolveError
from cotree.model.shared_code import build_engine, shared_code
from cotree.sharing import locked_cache

if TYPE_CHECKING:
    from collections.abc import Callable

    from cotree.build import LoadedLibrary
    from cotree.model.kernels import NativeModel
    from cotree.model.model import CompiledModel
    from cotree.solvers.base import FloatArray

    Inputs = Callable[[float], FloatArray | None]


def sweep(
    model: CompiledModel,
    p: FloatArray,
    u: Inputs,
    t: FloatArray,
    z: FloatArray,
    native: NativeModel,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Evaluate outputs, their sensitivities and inputs at many points.

    Parameters
    ----------
    model : CompiledModel
        The model.
    p : ndarray, shape (n_parameters,)
        Parameters.
    u : callable
        Inputs at a time; None leaves them to the model.
    t : ndarray, shape (n_t,)
        Times, [s].
    z : ndarray, shape (n_states * (1 + n_sensitivities), n_t)
        States and sensitivities.
    native : NativeModel
        The model as C sees it, with these parameters.

    Returns
    -------
    outputs, sensitivities, inputs : ndarray
        Shapes (n_outputs, n_t), (n_outputs, n_sensitivities, n_t) and (n_inputs, n_t).

    Raises
    ------
    SingularSystemError
        If an output is not determined somewhere.
    BuildError
        If no compiler can build the loop over the points.
    """
    if not model.outputs and not model.inputs:
        return (
            np.zeros((0, len(t))),
            np.zeros((0, len(model.sensitivities), len(t))),
            np.zeros((0, len(t))),
        )
    library = load_sweep()
    if library is None:
        raise BuildError("no compiler can build the loop over the points of a run")
    return _in_c(model, native, library, u, t, z) or _blame(model, p, u, t, z)


@locked_cache
def load_sweep() -> LoadedLibrary | None:
    """Build and load the loop over points; None where there is no compiler."""
    return build_engine(shared_code(sweep_files, sweep_declarations))


def _in_c(
    model: CompiledModel,
    native: NativeModel,
    library: LoadedLibrary,
    u: Inputs,
    t: FloatArray,
    z: FloatArray,
) -> tuple[FloatArray, FloatArray, FloatArray] | None:
    """Evaluate all points at once; None if a kernel fails somewhere."""
    n_t, n_outputs, m = len(t), len(model.outputs), len(model.sensitivities)
    # Inputs of the scene are evaluated in C, and written here; those of the run are handed over.
    inputs = np.zeros((n_t, len(model.inputs)))
    has_inputs = False
    if model.inputs and u(float(t[0])) is not None:
        inputs[:] = [u(float(at)) for at in t]
        has_inputs = True
    outputs, slopes = np.zeros((n_t, n_outputs)), np.zeros((n_t, m, n_outputs))
    ffi = library.ffi

    def pointer(array: FloatArray) -> object:
        return ffi.from_buffer("double[]", array) if array.size else ffi.NULL

    # C reads point after point, hence the transpose of z, whose rows have the length len(z).
    status = library.lib.cotree_sweep(
        ffi.cast("cotree_model *", native.address),
        pointer(native.p),
        pointer(native.k),
        n_t,
        pointer(np.ascontiguousarray(t, dtype=np.float64)),
        pointer(np.ascontiguousarray(z.T)),
        len(z),
        has_inputs,
        pointer(inputs),
        pointer(outputs),
        pointer(slopes),
    )
    # Python evaluates the points again, one by one, since its error names the culprit.
    if status != 0:
        return None
    # C writes point after point, while time is the last axis of results.
    return outputs.T.copy(), slopes.transpose(2, 1, 0).copy(), inputs.T.copy()


def _blame(
    model: CompiledModel, p: FloatArray, u: Inputs, t: FloatArray, z: FloatArray
) -> NoReturn:
    """Raise the error of the first point whose outputs are not determined."""
    n, m = len(model.states), len(model.sensitivities)
    for j, at in enumerate(t.tolist()):
        known, y, s = u(at), z[:n, j], z[n:, j].reshape(m, n).T
        model.output_values(at, y, p, known)
        if m:
            model.output_sensitivity(at, y, s, p, known)
    raise SolveError("the outputs cannot be evaluated along the run")
