"""Loading of models from C text: libraries, operating points, and pickles for other processes."""

from __future__ import annotations

import copyreg
import os
import pickle
import platform
import warnings
import zlib
from typing import TYPE_CHECKING, Any

import numpy as np

from cotree.build import BuildOptions, find_toolchain
from cotree.errors import BuildError, Error
from cotree.model.bound import BoundModel
from cotree.model.kernels import Kernels, obtain_kernels
from cotree.model.model import CompiledModel
from cotree.model.start import find_start
from cotree.quiet import level_of_user
from cotree.sharing import locked_cached_property
from cotree.version import ABI_VERSION, VERSION

if TYPE_CHECKING:
    from collections.abc import Callable

    from cotree.model.arrays import Array
    from cotree.program.text import ModelText


def load_model(
    text: ModelText, options: BuildOptions, at_rest: Callable[[], ModelText] | None = None
) -> CompiledModel:
    """Compile and load a model and its network ``at_rest``; warn if there is no compiler."""
    if find_toolchain() is None:
        is_asked = os.environ.get("COTREE_COMPILER") == "none"
        reason = (
            "COTREE_COMPILER=none"
            if is_asked
            else "no C compiler was found (CC, cc, gcc, clang): install one, or run `pip install "
            "ziglang`"
        )
        warnings.warn(
            f"{reason}: models cannot be evaluated or simulated",
            RuntimeWarning,
            stacklevel=level_of_user(),
        )
        from cotree.model.failures import MissingKernels

        model = CompiledModel(text, MissingKernels(), options)
    else:
        library, loaded = obtain_kernels(
            text.files, text.declarations, text.n_written, text.n_written_in_all, options
        )
        model = CompiledModel(text, Kernels(text, loaded, options), options)
        model.cached = library.cached
    if at_rest is not None:
        model.rest = OperatingPoint(model, at_rest)
    return model


class OperatingPoint:
    """Computation of the operating point of a network, which is the start of its runs.

    The operating point is the steady state of a second scene, in which storages are at rest
    (:mod:`cotree.scene.variants`). This scene has only algebraic unknowns, which the searches of
    :mod:`cotree.model.roots` find. ``text`` returns its C text.
    """

    def __init__(self, model: CompiledModel, text: Callable[[], ModelText]) -> None:
        self._model, self._text = model, text

    @locked_cached_property
    def text(self) -> ModelText:
        """The program of the network at rest, and its C text."""
        return self._text()

    @locked_cached_property
    def at_rest(self) -> CompiledModel:
        """The network at rest as a model; its outputs are the states of the original model."""
        return load_model(self.text, self._model.options or BuildOptions())

    def __call__(self, t: float, p: Array, u: Array | None, s: Array) -> tuple[Array, Array]:
        """Return the states at rest and their sensitivities.

        On entry, ``s``, (n_states, n_sensitivities), contains the sensitivities of the scene's
        initial values. Its columns for parameters are overwritten; those for initial values are
        kept.
        """
        model, rest = self._model, self.at_rest
        known = dict(zip(model.parameters, p.tolist(), strict=True))
        # The network at rest has a subset of the model's parameters.
        own = rest.parameter_array({name: known[name] for name in rest.parameters})
        inputs = None
        if u is not None:
            signals = dict(zip(model.inputs, u, strict=True))
            inputs = np.array([signals[name] for name in rest.inputs])
        try:
            start = find_start(BoundModel(rest, t, own, inputs), {})
        except Error as error:
            raise type(error)(f"the operating point: {error}") from None
        # The outputs of the network at rest are the model's states, in the same order.
        y = rest.output_values(t, start.y, own, inputs)
        if rest.sensitivities:
            found = rest.output_sensitivity(t, start.y, start.s, own, inputs)
            s[:, [model.sensitivities.index(name) for name in rest.sensitivities]] = found
        return y, s


def _reduced(model: CompiledModel) -> tuple[Any, ...]:
    if not model.text.files:
        raise TypeError("a model without C source cannot be pickled")
    parts = model.text, model.options, None if model.rest is None else model.rest.text
    # Programs and texts are repetitive: compression to a quarter takes a few milliseconds.
    data = zlib.compress(pickle.dumps(parts, pickle.HIGHEST_PROTOCOL))
    return _arrived, (_versions(), data)


def _arrived(versions: dict[str, str], data: bytes) -> CompiledModel:
    """Load a pickled model; raise BuildError if another version wrote it."""
    # Another version may compute different results from the same program.
    if any(versions.get(name) != _versions()[name] for name in ("cotree", "ABI")):
        raise BuildError(
            f"this model was pickled by cotree {_named(versions)}, but this is cotree "
            f"{_named(_versions())}: install one version on all machines, or save the scene and "
            "compile it here"
        )
    try:
        text, options, at_rest = pickle.loads(zlib.decompress(data))
    except (AttributeError, ImportError, TypeError, ValueError, pickle.UnpicklingError) as error:
        raise BuildError(
            f"this model was pickled by cotree {_named(versions)} and cannot be read by cotree "
            f"{_named(_versions())} ({error}): install the same versions on all machines"
        ) from error
    return load_model(text, options, None if at_rest is None else lambda: at_rest)


def _versions() -> dict[str, str]:
    return {
        "cotree": VERSION,
        "ABI": str(ABI_VERSION),
        "Python": platform.python_version(),
        "NumPy": np.__version__,
    }


def _named(versions: dict[str, str]) -> str:
    others = ", ".join(f"{name} {value}" for name, value in versions.items() if name != "cotree")
    return f"{versions.get('cotree')} ({others})"


# A loaded library is valid only in its process, so pickles contain the C text.
copyreg.pickle(CompiledModel, _reduced)
