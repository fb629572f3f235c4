"""A ``cotree_model`` whose kernels are evaluated in Python.

It replaces the compiled model if a program is only evaluated, and after a kernel has failed: C
returns a status, Python an exception that names the cause.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from cotree.errors import SingularSystemError
from cotree.model.arrays import new_quantities
from cotree.model.kernels import SINGULAR
from cotree.program.kernels import KERNELS
from cotree.version import ABI_VERSION

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cotree.model.arrays import Array
    from cotree.model.model import CompiledModel
    from cotree.program.kernels import KernelSpec

#: The kernels that the search for a start calls.
_KERNELS = (
    "prepare",
    "initial",
    "initial_sensitivity",
    "inputs",
    "rhs",
    "jacobian",
    "augmented_rhs",
    "constraints",
    "constraint_sensitivity",
    "gradient",
    "start",
    "start_gradient",
    "start_sensitivity",
    "events",
    "jumps",
    "event_sensitivity",
)

_NONE: Array = np.zeros(0)


class CalledModel:
    """A ``cotree_model`` with callbacks to a model's kernels in Python.

    Parameters
    ----------
    ffi : FFI
        The FFI of a library that declares the structure.
    model : CompiledModel
        The model.

    Attributes
    ----------
    address : cdata
        The structure.
    errors : list of BaseException
        Exceptions of kernels since the list was last cleared.
    """

    def __init__(self, ffi: Any, model: CompiledModel) -> None:
        self._ffi, self._model = ffi, model
        self._kept: list[Any] = []
        self.errors: list[BaseException] = []
        self.address = self._structure()

    def _structure(self) -> Any:
        layout, c = self._model.layout, self._new("cotree_model *")
        c.abi_version, c.name = ABI_VERSION, self._new("char[]", layout.name.encode())
        c.n_nonzeros, c.n_algebraic = len(layout.row_indices), layout.n_algebraic
        for name in ("states", "parameters", "inputs", "sensitivities", "constraints"):
            setattr(c, f"n_{name}", len(getattr(layout, name)))
        for name in ("states", "parameters", "inputs"):
            setattr(c, name, new_quantities(self._new, getattr(layout, name)))
        for name in ("column_starts", "row_indices", "sensitivity_starts", "sensitivity_rows"):
            setattr(c, name, self._ints(getattr(layout, name)))
        for name in _KERNELS:
            spec, n_results = KERNELS[name], self._model.traits.n_results.get(name)
            if n_results is not None:
                setattr(c, spec.field, self._callback(spec, n_results))
        if layout.events or layout.corners:
            c.hybrid = self._hybrid()
        return c

    def _hybrid(self) -> Any:
        layout, c = self._model.layout, self._new("cotree_hybrid *")
        c.n_events = len(layout.events) + len(layout.corners)
        c.n_branches, c.n_quantities = layout.n_pieces, layout.n_quantities
        # Kinks are the last events; they set no targets.
        c.events = rows = self._new("cotree_event[]", c.n_events)
        for row, own in zip(layout.events, rows, strict=False):
            own.name, own.direction = self._new("char[]", row.name.encode()), row.direction
            own.kind, own.n_targets = row.part or int(row.is_jump), len(row.targets)
            own.targets = self._ints(row.targets)
            c.n_jumps += len(row.targets)
        return c

    def _callback(self, spec: KernelSpec, n_results: int) -> Any:
        """Make the C function of a kernel: it stores exceptions and returns a status."""
        layout, buffer = self._model.layout, self._ffi.buffer
        n, m = len(layout.states), len(layout.sensitivities)
        packed = len(layout.sensitivity_rows) if spec.is_packed else n * m
        sizes = {"x": n, "s": packed, "u": len(layout.inputs), "p": len(layout.parameters)}

        def array(pointer: Any, size: int) -> Array:
            return np.frombuffer(buffer(pointer, 8 * size)) if size else _NONE

        def call(*arguments: Any) -> int:
            known: dict[str, Any] = {"t": 0.0, "x": _NONE, "s": _NONE, "u": _NONE}
            for key, value in zip(spec.arguments, arguments, strict=False):
                if key != "k":
                    known[key] = value if key == "t" else array(value, sizes[key])
            try:
                self._model.set_parameters(known.pop("p").copy())
                if n_results and spec.name != "prepare":
                    found = array(arguments[-1], n_results)
                    found[:] = self._model.evaluate(spec.name, **known)
            except SingularSystemError as error:
                self.errors.append(error)
                return SINGULAR
            return 0

        def remember(kind: Any, error: BaseException, traceback: Any) -> None:
            self.errors.append(error)

        self._kept.append(self._ffi.callback(spec.type, call, error=-1, onerror=remember))
        return self._kept[-1]

    def _new(self, *what: Any) -> Any:
        self._kept.append(self._ffi.new(*what))
        return self._kept[-1]

    def _ints(self, values: Sequence[int]) -> Any:
        return self._new("int[]", list(values) or [0])
