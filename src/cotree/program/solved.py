"""Equations solved for their unknowns, and differentiated along any direction.

In: ``A w = b`` and functions of the unknowns w. Out: the same without unknowns, and its
derivatives: along a direction ``A w' = b'``, with the known factors of A (b' = db - dA w, from the
sensitivity graphs). All derivatives of the solved system come from here: Jacobian columns,
sensitivities, events along the motion, linearisation.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from cotree.dag.derivative import tangents
from cotree.dag.nodes import substitute
from cotree.linear.factors import HeldFactors
from cotree.linear.tree import factorise_bordered

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from cotree.dag.nodes import Dag, Node
    from cotree.equations import Derivative, Equations
    from cotree.linear.factors import RankedSolver


@dataclass(frozen=True)
class Along:
    """Derivatives along one direction, in terms of states, inputs and parameters only."""

    unknowns: tuple[Node, ...]  # unknowns w' of the differentiated equations
    #: Rates by index of the state; missing ones are zero.
    rates: dict[int, Node]
    outputs: dict[int, Node]


@dataclass(frozen=True)
class SolvedSystem:
    """The solution of linear equations, with the factors to solve them again."""

    dag: Dag  # arena that holds the nodes
    matrix: Sequence[Sequence[Node]]  # matrix A of ``A w = b``, symmetric
    factors: RankedSolver
    unknowns: dict[Node, Node]  # value of each unknown, by symbol
    tangents: tuple[Node, ...]  # symbols of the derivatives of the unknowns

    @classmethod
    def of(cls, equations: Equations) -> SolvedSystem:
        """Factorise the matrix of some equations, and solve them for their unknowns."""
        factors = factorise_bordered(
            equations.dag,
            equations.matrix,
            equations.is_safe,
            equations.constraints.sizes,
            equations.links,
            equations.holding,
        )
        found = dict(zip(equations.unknowns, factors.solve(equations.forcing), strict=True))
        return cls(equations.dag, equations.matrix, factors, found, equations.unknown_tangents)

    @property
    def bare(self) -> RankedSolver:
        """Solver without friction, which does not act in projections and impacts."""
        return self.factors.inner if isinstance(self.factors, HeldFactors) else self.factors

    def substitute(self, nodes: Sequence[Node]) -> list[Node]:
        """Substitute the values of the unknowns for their symbols."""
        return substitute(nodes, self.unknowns)

    def along(self, directions: Sequence[Derivative]) -> list[Along]:
        """Differentiate along directions one by one; shared values are visited once."""
        # Derivatives of thousands of states share most of their nodes.
        known = iter(
            self.substitute(
                [
                    node
                    for row in directions
                    for node in (*row.forcing, *row.rates.values(), *row.outputs.values())
                ]
            )
        )
        found = []
        for row in directions:
            # The three groups were passed together, and are returned in the same order.
            forcing = [next(known) for _ in row.forcing]
            rates = [next(known) for _ in row.rates]
            outputs = [next(known) for _ in row.outputs]
            # The forcing of a direction is b' = db - dA w, so the factors of A are reused.
            unknowns = self.factors.solve(forcing)
            changes = dict(zip(self.tangents, unknowns, strict=True))
            found.append(
                Along(
                    tuple(unknowns),
                    dict(zip(row.rates, substitute(rates, changes), strict=True)),
                    dict(zip(row.outputs, substitute(outputs, changes), strict=True)),
                )
            )
        return found

    def solve_again(
        self, forcing: Sequence[Node], solution: Sequence[Node], seed: Mapping[Node, Node]
    ) -> list[Node]:
        """Differentiate the solution w of an impact: ``A w' = forcing - A' w``.

        ``forcing`` is the derivative of its right-hand side, ``seed`` the tangents of the symbols
        in A.
        """
        # b' - A' w, row by row. The derivative of A is formed here, since no sensitivity graph
        # contains this solution.
        rest = list(forcing)
        n = len(solution)
        for i, row in enumerate(self.matrix[:n]):
            for d, w in zip(tangents(row[:n], seed), solution, strict=True):
                rest[i] = rest[i] - d * w
        return self.bare.solve(rest)
