"""Kernels evaluated in Python, which compiled ones are compared with."""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from cotree.dag.evaluate import evaluate
from cotree.dag.multi_output import results
from cotree.dag.nodes import ARGUMENT_OF, PIECE, reachable
from cotree.errors import SingularSystemError
from cotree.model.arrays import CObjects
from cotree.model.failures import check_guards
from cotree.model.kernels import SINGULAR
from cotree.model.start_in_c import load_start
from cotree.program.kernels import KERNELS
from cotree.version import ABI_VERSION

if TYPE_CHECKING:
    from cotree.program.program import Program


class EvaluatedKernels:
    """The kernels of a program, called as compiled ones are."""

    backend = "Python"

    def __init__(self, program: Program) -> None:
        self.program, self.p, self._prepared = program, np.zeros(0), {}
        self._plans = {}
        for name, kernel in program.kernels.items():
            # The last result of a `solve` tells whether its matrix was regular.
            solved = [n for n in kernel.order if n.op == "solve"]
            accepted = [results(n, n.data.size + 2)[-1] for n in solved]
            roots = [*kernel.results, *accepted]
            self._plans[name] = roots, reachable(roots, stop=kernel.prepared)

    def prepare(self, p):
        """Take parameters for all calls that follow."""
        check_guards(self.program.guards, p)
        self.p, self._prepared = np.array(p, dtype=float), {}
        values = self._values("prepare", {})
        self._prepared = dict(zip(self.program.kernels["prepare"].results, values, strict=True))

    @cached_property
    def _called(self):
        return CalledModel(load_start().ffi, self)

    def address_for(self, *, is_implicit):
        """Return the model for the search of starts in C, which calls these kernels."""
        return self._called.address

    def prepared(self):
        """Return no values, as C calls these kernels with parameters."""
        return np.zeros(0)

    def address(self, name):
        """Return None, as there is no C."""

    def __call__(self, name, t, x, s, u):
        """Evaluate a kernel."""
        return np.array(self._values(name, {"t": (t,), "x": x, "s": s, "u": u}))

    def _values(self, name, arguments):
        (roots, order), known = self._plans[name], {**arguments, "p": self.p}
        values = dict(self._prepared)
        for node in order:
            if node.op == "symbol" and node.data[0] != PIECE:
                kind, place = node.data
                values[node] = float(known[ARGUMENT_OF[kind]][place])
        n = len(self.program.kernels[name].results)
        with np.errstate(all="ignore"):
            found = evaluate(roots, values, order=order)
        if not all(found[n:]):
            raise SingularSystemError(f"a matrix of '{name}' is singular")
        return found[:n]


#: The kernels that the search for a start calls.
_KERNELS = (
    *("prepare", "initial", "initial_sensitivity", "inputs", "rhs", "jacobian", "augmented_rhs"),
    *("constraints", "constraint_sensitivity", "gradient", "start", "start_gradient"),
    *("start_sensitivity", "events", "jumps", "event_sensitivity"),
)


class CalledModel(CObjects):
    """A ``cotree_model`` with callbacks to kernels in Python, as the search for starts needs it."""

    def __init__(self, ffi, kernels: EvaluatedKernels):
        super().__init__(ffi)
        self._kernels = kernels
        layout, c = kernels.program.layout, self.new("cotree_model *")
        self._layout, self.address = layout, int(ffi.cast("uintptr_t", c))
        c.abi_version, c.name = ABI_VERSION, self.new("char[]", layout.name.encode())
        c.n_nonzeros, c.n_algebraic = len(layout.row_indices), layout.n_algebraic
        for name in ("states", "parameters", "inputs", "sensitivities", "constraints"):
            setattr(c, f"n_{name}", len(getattr(layout, name)))
        for name in ("states", "parameters", "inputs"):
            setattr(c, name, self.quantities(getattr(layout, name)))
        for name in ("column_starts", "row_indices", "sensitivity_starts", "sensitivity_rows"):
            setattr(c, name, self.ints(getattr(layout, name)))
        for name in _KERNELS:
            n_results = kernels.program.traits.n_results.get(name)
            if n_results is not None:
                setattr(c, KERNELS[name].field, self._kernel(KERNELS[name], n_results))
        if layout.events or layout.kinks:
            c.hybrid = self._hybrid()

    def _hybrid(self):
        layout, c = self._layout, self.new("cotree_hybrid *")
        c.n_events = len(layout.events) + len(layout.kinks)
        c.n_branches, c.n_quantities = layout.n_pieces, layout.n_quantities
        # Kinks are the last events; they set no targets.
        c.events = rows = self.new("cotree_event[]", c.n_events)
        for row, own in zip(layout.events, rows, strict=False):
            own.name, own.direction = self.new("char[]", row.name.encode()), row.direction
            own.kind, own.n_targets = row.part or int(row.is_jump), len(row.targets)
            own.targets = self.ints(row.targets)
            c.n_jumps += len(row.targets)
        return c

    def _kernel(self, spec, n_results):
        layout = self._layout
        n, m = len(layout.states), len(layout.sensitivities)
        packed = len(layout.sensitivity_rows) if spec.is_packed else n * m
        sizes = {"x": n, "s": packed, "u": len(layout.inputs), "p": len(layout.parameters)}

        def array(pointer, size):
            return np.frombuffer(self._ffi.buffer(pointer, 8 * size)) if size else np.zeros(0)

        def call(*arguments):
            given = dict(zip(spec.arguments, arguments, strict=False))
            known = {key: array(given[key], size) for key, size in sizes.items() if key in given}
            if known["p"].tobytes() != self._kernels.p.tobytes():
                self._kernels.prepare(known["p"])
            if spec.name == "prepare":
                return 0
            none = {"x": np.zeros(0), "s": np.zeros(0), "u": np.zeros(0)}
            known = {"t": given.get("t", 0.0), **none, **known}
            found = array(arguments[-1], n_results)
            try:
                found[:] = self._kernels(spec.name, *(known[key] for key in ("t", "x", "s", "u")))
            except SingularSystemError:
                return SINGULAR
            return 0

        return self.callback(spec.type, call)
