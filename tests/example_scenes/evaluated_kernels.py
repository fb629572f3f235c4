"""Kernels evaluated in Python, which compiled ones are compared with."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from cotree.dag.evaluate import evaluate
from cotree.dag.multi_output import results
from cotree.dag.nodes import ARGUMENT_OF, PIECE, reachable
from cotree.errors import SingularSystemError
from cotree.model.failures import check_guards

if TYPE_CHECKING:
    from cotree.program.program import Program


class EvaluatedKernels:
    """The kernels of a program, called as compiled ones are."""

    backend = "Python"

    def __init__(self, program: Program) -> None:
        self._program, self._p, self._prepared = program, np.zeros(0), {}
        self._plans = {}
        for name, kernel in program.kernels.items():
            # The last result of a `solve` tells whether its matrix was regular.
            solved = [n for n in kernel.order if n.op == "solve"]
            accepted = [results(n, n.data.size + 2)[-1] for n in solved]
            roots = [*kernel.results, *accepted]
            self._plans[name] = roots, reachable(roots, stop=kernel.prepared)

    def prepare(self, p):
        """Take parameters for all calls that follow."""
        check_guards(self._program.guards, p)
        self._p, self._prepared = np.array(p, dtype=float), {}
        values = self._values("prepare", {})
        self._prepared = dict(zip(self._program.kernels["prepare"].results, values, strict=True))

    def native(self):
        """Return None, as there is no C."""

    def address(self, name):
        """Return None, as there is no C."""

    def __call__(self, name, t, x, s, u):
        """Evaluate a kernel."""
        return np.array(self._values(name, {"t": (t,), "x": x, "s": s, "u": u}))

    def _values(self, name, arguments):
        (roots, order), known = self._plans[name], {**arguments, "p": self._p}
        values = dict(self._prepared)
        for node in order:
            if node.op == "symbol" and node.data[0] != PIECE:
                kind, place = node.data
                values[node] = float(known[ARGUMENT_OF[kind]][place])
        n = len(self._program.kernels[name].results)
        with np.errstate(all="ignore"):
            found = evaluate(roots, values, order=order)
        if not all(found[n:]):
            raise SingularSystemError(f"a matrix of '{name}' is singular")
        return found[:n]
