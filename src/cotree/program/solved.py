"""Equations solved for their unknowns, and their derivatives along any direction.

Along a direction, ``A w' = b'`` is solved with the factors of A from ``A w = b``. The sensitivity
graphs provide b' = db - dA w.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

from cotree.dag.derivative import tangents
from cotree.dag.nodes import substitute
from cotree.linear.factors import HeldFactors, factorise, hold

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from cotree.dag.nodes import Dag, Node
    from cotree.equations import Derivative, Equations
    from cotree.linear.factors import RankedSolver
    from cotree.linear.tree_elimination import TreeLink


class HeldColumn(Protocol):
    """The column of a multiplier of friction or of a mechanical stop."""

    @property
    def column(self) -> Sequence[Node]:
        """Generalised forces per unit of the multiplier."""

    @property
    def sizes(self) -> Sequence[Node]:
        """Sum of the squared terms of each entry in the multiplier's row, without cancellation."""


def factorise_bordered(
    dag: Dag,
    matrix: Sequence[Sequence[Node]],
    is_safe: Sequence[bool],
    sizes: Sequence[Sequence[Node]],
    links: Sequence[TreeLink],
    holding: Sequence[HeldColumn] = (),
) -> RankedSolver:
    """Factorise a bordered mass matrix [M, -G^T; -G, 0]; with ``links``, along its tree.

    With ``links``, M itself is not used. ``sizes`` contains the squared terms of each
    multiplier's row. The last unknowns, ``holding``, are multipliers of friction and stops.
    """
    n = len(matrix) - len(sizes) - len(holding)
    n_inner = n + len(sizes)
    if links:
        from cotree.linear.tree_elimination import factorise_tree

        border = [row[:n] for row in matrix[n:n_inner]]
        along = factorise_tree(dag, links, border, sizes, n)
        if not holding:
            return along
        inner: RankedSolver = along
        inverses = along.inverses()
    elif holding:
        rows = [row[:n_inner] for row in matrix[:n_inner]]
        inner = factorise(dag, rows, is_safe[:n_inner], sizes)
        inverses = {i: 1.0 / matrix[i][i] for i in range(n) if not matrix[i][i].is_zero}
    else:
        return factorise(dag, matrix, is_safe, sizes)
    held = [
        sum((size * inverses[k] for k, size in enumerate(own.sizes) if k in inverses), dag.zero)
        for own in holding
    ]
    return hold(dag, inner, matrix[n_inner:], [own.column for own in holding], n_inner, held)


@dataclass(frozen=True)
class Along:
    """Derivatives along one direction, as functions of states, inputs and parameters only."""

    unknowns: tuple[Node, ...]  # derivatives w' of the unknowns
    #: Derivatives of the rates by index of the state, and of the outputs; zeros are missing.
    rates: dict[int, Node]
    outputs: dict[int, Node]


@dataclass(frozen=True)
class SolvedSystem:
    """Solution of linear equations, with the factors for further solutions."""

    dag: Dag  # arena of the nodes
    matrix: Sequence[Sequence[Node]]  # matrix A of ``A w = b``, symmetric
    factors: RankedSolver
    unknowns: dict[Node, Node]  # values of the unknowns by symbol
    tangents: tuple[Node, ...]  # symbols of the derivatives of the unknowns

    @classmethod
    def of(cls, equations: Equations) -> SolvedSystem:
        """Factorise the matrix of the equations, and solve for the unknowns."""
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
        """Solver without friction multipliers, since projections and impacts exclude friction."""
        return self.factors.inner if isinstance(self.factors, HeldFactors) else self.factors

    def substitute(self, nodes: Sequence[Node]) -> list[Node]:
        """Substitute the values of the unknowns for their symbols."""
        return substitute(nodes, self.unknowns)

    def along(self, directions: Sequence[Derivative]) -> list[Along]:
        """Differentiate along each of ``directions``."""
        # Substitute all directions at once, since they share most of their nodes.
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
            # Results are in the order of the arguments.
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
        """Form w' of an impact from ``A w' = forcing - A' w``; ``seed`` has the tangents for A."""
        # A must be differentiated here: no sensitivity graph contains the solution of an impact.
        rest = list(forcing)
        n = len(solution)
        for i, row in enumerate(self.matrix[:n]):
            for d, w in zip(tangents(row[:n], seed), solution, strict=True):
                rest[i] = rest[i] - d * w
        return self.bare.solve(rest)
