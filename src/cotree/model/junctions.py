"""Limited Newton steps for algebraic equations with exponentials, from a poor guess.

Exponents are unknowns of their own.

1. A step that raises an exponent by more than a few units is limited: the exponential then grows
   by the amount that its tangent predicts, as in SPICE (pnjlim).
2. If that does not converge, exp(w) is replaced by exp(w) + c w, a conductance in parallel with
   each junction, and c is lowered step by step.

See J. Albersmeyer and M. Diehl, The lifted Newton method, SIAM J. Optim. 20 (2010), and L. W.
Nagel, SPICE2, Berkeley 1975.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from cotree.dag.derivative import tangents_along
from cotree.dag.evaluate import evaluate
from cotree.dag.nodes import PIECE, Node, dependent, reachable
from cotree.model.linear import Linear, solve_entries
from cotree.model.roots import NewtonLimits, iterate

if TYPE_CHECKING:
    from cotree.model.arrays import Array
    from cotree.program.program import Program

#: The largest unlimited increase of an exponent, and the largest exponent taken from a guess.
_FREE, _FAR_OF_JUNCTIONS = 2.0, 40.0

#: Number of limited steps, which grows with the number of junctions, since changes propagate along
#: chains of them; and the relative step at which Newton's method takes over.
_MOST_LIMITED_STEPS, _JUNCTIONS_A_STEP, _SETTLED = 100, 4, 1e-9

#: The largest and the smallest conductance in parallel with junctions, in units of saturation
#: current over thermal voltage: at 1e-15 A the largest is that of a wire, the smallest is
#: negligible.
_LARGEST, _LEAST = 1e15, 1e-3
_FACTORS = (1.05, 10.0, 1e3)


@dataclass(frozen=True, eq=False)
class Junctions:
    """The algebraic equations of a program, as functions of unknowns and exponentials."""

    equations: tuple[Node, ...]  # the residuals g, which are to vanish
    unknowns: tuple[Node, ...]  # symbols of z
    exponentials: tuple[Node, ...]  # those that depend on z
    #: Derivatives of each equation, then of each exponent, by z and by the exponentials; keys are
    #: indices into these variables.
    slopes: tuple[dict[int, Node], ...]

    @classmethod
    def of(cls, program: Program) -> Junctions:
        """Find the exponentials of a program and differentiate."""
        dag, layout = program.dag, program.layout
        n, cut = len(layout.states), len(layout.states) - layout.n_algebraic
        # Algebraic equations are the last rows, and their unknowns the last states.
        equations = program.kernels["rhs"].results[cut:]
        unknowns = tuple(dag.symbol("x", i) for i in range(cut, n))
        order = reachable(equations)
        moving = dependent(order, unknowns)
        exponentials = tuple(node for node in order if node.op == "exp" and node in moving)
        if not exponentials:
            return cls(equations, unknowns, (), ())
        roots = [*equations, *(node.args[0] for node in exponentials)]
        # Exponentials are variables of their own: derivatives by z do not go through them.
        seeds = [{symbol: dag.one} for symbol in (*unknowns, *exponentials)]
        return cls(equations, unknowns, exponentials, tuple(tangents_along(roots, seeds)))

    def at(self, t: float, y: Array, p: Array, u: Array) -> FrozenSystem:
        """Return the equations at constant time, states, parameters and inputs.

        Parameters
        ----------
        t : float
            Time, [s].
        y, p, u : ndarray, shapes (n_states,), (n_parameters,) and (n_inputs,)
            States, whose algebraic unknowns are ignored, parameters and inputs.
        """
        return FrozenSystem(self, t, y, p, u)


class FrozenSystem:
    """The equations at constant time, states, parameters and inputs, for one search."""

    n_carried = 0

    def __init__(self, junctions: Junctions, t: float, y: Array, p: Array, u: Array) -> None:
        self._n = len(junctions.unknowns)
        self._free = (*junctions.unknowns, *junctions.exponentials)
        exponents = [node.args[0] for node in junctions.exponentials]
        entries = [(i, j, d) for i, row in enumerate(junctions.slopes) for j, d in row.items()]
        self._rows, self._columns = (np.array([e[k] for e in entries], dtype=int) for k in (0, 1))
        roots = [*junctions.equations, *exponents, *(d for _, _, d in entries)]
        known: dict[str, Array] = {"t": np.array([t]), "x": y, "p": p, "u": u}
        order = reachable(roots, stop=set(self._free))
        values = {
            node: float(known[node.data[0]][node.data[1]])
            for node in order
            if node.op == "symbol" and node not in self._free and node.data[0] != PIECE
        }
        moving = dependent(order, self._free)
        # Values that do not depend on unknowns are evaluated once.
        edge = {a for node in order if node in moving for a in node.args if a not in moving}
        fixed = list(edge.union(roots) - moving)
        self._values = values | dict(zip(fixed, evaluate(fixed, values), strict=True))
        # Evaluations overwrite only the entries in `_places`.
        self._results = np.array([self._values.get(node, 0.0) for node in roots])
        self._places = [i for i, node in enumerate(roots) if node in moving]
        self._roots = [roots[i] for i in self._places]
        self._order = reachable(self._roots, stop={*self._free, *self._values})
        self._conductance, self._entries = 0.0, np.zeros(0)

    def search(self, z: Array) -> Array | None:
        """Search for a root; return a point close to it, or None."""
        m = len(self._free) - self._n
        if not m:
            return None
        exponents = self._evaluate(z, np.ones(m))[0][self._n :]
        # Exponents that are huge at a poor guess start at zero, as at zero voltage.
        w = np.where(np.abs(exponents) < _FAR_OF_JUNCTIONS, exponents, 0.0)
        found = self._iterate(z, w, 0.0)
        return self._lower(z, np.zeros(m)) if found is None else found[0]

    def _lower(self, z: Array, w: Array) -> Array | None:
        """Lower the conductance in parallel with all junctions step by step to zero."""
        conductance, (least, factor, most) = _LARGEST, _FACTORS
        while conductance > 0.0:
            lower = conductance / factor if conductance > _LEAST else 0.0
            found = self._iterate(z, w, lower)
            if found is not None:
                # A success squares the factor; a failure takes its square root.
                (z, w), conductance, factor = found, lower, min(factor**2, most)
            elif factor < least:
                return None
            else:
                factor **= 0.5
        return z

    def _iterate(self, z: Array, w: Array, conductance: float) -> tuple[Array, Array] | None:
        """Take Newton steps in unknowns and exponents, the latter limited."""
        self._conductance = conductance
        limits = NewtonLimits(_MOST_LIMITED_STEPS + len(w) // _JUNCTIONS_A_STEP, settled=_SETTLED)
        root = iterate(self, np.concatenate([z, w]), limits)
        return (root.z[: self._n], root.z[self._n :]) if root.is_found else None

    def value(self, z: Array) -> Array:
        """Return the residuals of the equations, then a(z) - w of the exponents."""
        unknowns, w = np.split(z, [self._n])
        # Residuals are g(z, e) and a(z) - w with e = exp(w) + c w, so derivatives by e become those
        # by w with the factor de/dw = exp(w) + c.
        slope = np.exp(w) + self._conductance
        values, entries = self._evaluate(unknowns, np.exp(w) + self._conductance * w)
        values[self._n :] -= w
        along = np.concatenate([np.ones(self._n), slope])[self._columns]
        self._entries = np.append(entries * along, np.full(len(w), -1.0))
        return values

    def linearised(self, z: Array) -> Linear:
        """Return the linear equations of the point that was evaluated last."""
        own, entries = np.arange(self._n, len(z)), self._entries
        rows, columns = np.append(self._rows, own), np.append(self._columns, own)
        scale = np.maximum(1.0, np.abs(z))
        return Linear(lambda g: solve_entries(rows, columns, entries, g), scale)

    def moved(self, z: Array, step: Array) -> Array:
        """Return the point after a step, with limited growth of exponents."""
        wanted, own = z + step, slice(self._n, None)
        base = np.maximum(z[own], 0.0)
        rise = np.maximum(wanted[own] - base, 0.0)
        # The tangent predicts exp(w) (1 + rise) = exp(w + log(1 + rise)).
        wanted[own] = np.where(rise > _FREE, base + np.log1p(rise), wanted[own])
        return wanted

    def _evaluate(self, z: Array, e: Array) -> tuple[Array, Array]:
        """Return equations and exponents, and the entries of their derivatives."""
        size = len(z) + len(e)
        values = self._values | dict(zip(self._free, [*z.tolist(), *e.tolist()], strict=True))
        results = self._results.copy()
        results[self._places] = evaluate(self._roots, values, order=self._order)
        return results[:size], results[size:]
