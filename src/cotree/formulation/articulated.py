"""Elimination along the tree: articulated inertias (R. Featherstone, 1983), O(n) for each solution.

The same unknowns as :mod:`cotree.formulation.elimination` gives from the mass matrix, without
forming it: the inertia that a branch feels, less what its own motion gives way, is carried to the
parent. Long chains cost less this way, short ones more; both are counted.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from cotree.dag import vector
from cotree.dag.several import RANK_TOLERANCE, SolveShape, solve

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cotree.dag.nodes import Dag, Node
    from cotree.dag.vector import Matrix, Vector
    from cotree.equations import Link


#: Squared gradients of constraints below this share of what they are made of are scaled as if they
#: were that large: those of rounding, 1e-31 or so, then fall below the rank tolerance.
SMALLEST_SHARE = 1e-17


@dataclass(frozen=True)
class _Spatial:
    """Force F a + E alpha and torque E^T a + J alpha of a linear and an angular acceleration."""

    force: Matrix
    coupling: Matrix
    torque: Matrix


@dataclass(frozen=True)
class _Gate:
    """What one speed takes: its wrench for a unit of it, and the reciprocal of its pivot."""

    force: Vector
    torque: Vector
    inverse: Node


@dataclass(frozen=True)
class ArticulatedFactors:
    """A factorised tree, bordered by constraints.

    Attributes
    ----------
    dag : Dag
        The arena.
    links : tuple of Link
        The moving branches, parents first.
    gates : tuple of tuple of _Gate
        Of each branch, in the order of their elimination: the last speed first.
    n_speeds : int
        Number of accelerations.
    border : tuple of rows of Node
        The rows of the multipliers, over the accelerations.
    responses : tuple of rows of Node
        Accelerations for a unit of each multiplier's column.
    scales : tuple of Node
        One over the square root of the core's diagonal.
    core : tuple of rows of Node
        What is left for the multipliers, scaled from both sides.
    """

    dag: Dag
    links: tuple[Link, ...]
    gates: tuple[tuple[_Gate, ...], ...]
    n_speeds: int
    border: tuple[tuple[Node, ...], ...]
    responses: tuple[tuple[Node, ...], ...]
    scales: tuple[Node, ...]
    core: tuple[tuple[Node, ...], ...]

    def solve(self, rhs: Sequence[Node], tolerance: float = RANK_TOLERANCE) -> list[Node]:
        """Solve for one right-hand side: accelerations, then multipliers."""
        free = self._along_tree(rhs[: self.n_speeds])
        if not self.border:
            return free
        with self.dag.labelled("substitution"):
            rest = [
                value - _dot(row, free)
                for value, row in zip(rhs[self.n_speeds :], self.border, strict=True)
            ]
            if all(value.is_zero for value in rest):
                return [*free, *rest]
            scaled = [value * scale for value, scale in zip(rest, self.scales, strict=True)]
            shape = SolveShape(len(scaled), 0, tolerance)
            found = solve(self.dag, self.core, scaled, self.dag.one, shape)
            multipliers = [s * v for s, v in zip(self.scales, found, strict=False)]
            for i in range(self.n_speeds):
                for response, multiplier in zip(self.responses, multipliers, strict=True):
                    free[i] = free[i] - response[i] * multiplier
        return [*free, *multipliers]

    def _along_tree(self, rhs: Sequence[Node]) -> list[Node]:
        """Solve with the mass matrix: forces inwards, accelerations outwards."""
        dag, zero = self.dag, vector.zeros(self.dag)
        loads: list[tuple[Vector, Vector]] = [(zero, zero)] * (len(self.links) + 1)
        rest = list(rhs)
        with dag.labelled("substitution"):
            for i in range(len(self.links) - 1, -1, -1):
                link, gates = self.links[i], self.gates[i]
                force, torque = (_up(link, part) for part in loads[i + 1])
                for speed, gate in zip(_outwards(link), gates, strict=True):
                    at = link.speeds[speed]
                    rest[at] = rest[at] - _power(link, speed, force, torque)
                    given = gate.inverse * rest[at]
                    force = vector.add(force, vector.scale(given, gate.force))
                    torque = vector.add(torque, vector.scale(given, gate.torque))
                if link.parent:
                    known = loads[link.parent]
                    torque = vector.add(torque, vector.cross(link.offset, force))
                    loads[link.parent] = (
                        vector.add(known[0], force),
                        vector.add(known[1], torque),
                    )
            found = [dag.zero] * len(rest)
            moved: list[tuple[Vector, Vector]] = [(zero, zero)]
            for link, gates in zip(self.links, self.gates, strict=True):
                linear, angular = moved[link.parent]
                linear = vector.add(linear, vector.cross(angular, link.offset))
                for speed, gate in zip(reversed(_outwards(link)), reversed(gates), strict=True):
                    at = link.speeds[speed]
                    taken = vector.dot(gate.force, linear) + vector.dot(gate.torque, angular)
                    found[at] = gate.inverse * (rest[at] - taken)
                    linear = vector.add(linear, vector.scale(found[at], link.shifting[speed]))
                    angular = vector.add(angular, vector.scale(found[at], link.turning[speed]))
                moved.append((_down(link, linear), _down(link, angular)))
        return found


def factorise_tree(
    dag: Dag,
    links: Sequence[Link],
    border: Sequence[Sequence[Node]],
    sizes: Sequence[Sequence[Node]],
    n_speeds: int,
) -> ArticulatedFactors:
    """Carry articulated inertias inwards, and eliminate the accelerations from the border.

    Parameters
    ----------
    dag : Dag
        The arena.
    links : sequence of Link
        The moving branches, parents first; every pivot is known to be positive.
    border, sizes : sequence of rows of Node
        The rows of the multipliers, over the accelerations, and squares of what they are made of
        before anything cancels.
    n_speeds : int
        Number of accelerations.
    """
    carried: list[_Spatial | None] = [None] * (len(links) + 1)
    gates: list[tuple[_Gate, ...]] = [()] * len(links)
    for i in range(len(links) - 1, -1, -1):
        link = links[i]
        with dag.labelled("articulated inertias"):
            own = _sum(_rigid(dag, link), carried[i + 1])
            if own is None:
                own = _nothing(dag)
            own = _resolved(link, own)
            found = []
            for speed in _outwards(link):
                gate, own = _opened(own, link.turning[speed], link.shifting[speed])
                found.append(gate)
            gates[i] = tuple(found)
            if link.parent:
                carried[link.parent] = _sum(_shifted(own, link.offset), carried[link.parent])
    bare = ArticulatedFactors(dag, tuple(links), tuple(gates), n_speeds, (), (), (), ())
    if not border:
        return bare
    responses = tuple(tuple(bare.solve(row)) for row in border)
    with dag.labelled("elimination"):
        n = len(border)
        core = [[dag.zero] * n for _ in range(n)]
        for i in range(n):
            for j in range(i + 1):
                core[i][j] = core[j][i] = -_dot(border[i], responses[j])
        inverses = [dag.zero] * n_speeds
        for link, opened in zip(links, gates, strict=True):
            for speed, gate in zip(_outwards(link), opened, strict=True):
                inverses[link.speeds[speed]] = gate.inverse
        natural = [_dot(row, inverses) for row in sizes]
        scales = _scales(dag, [core[i][i] for i in range(n)], natural)
        scaled = tuple(
            tuple(entry * (a * b) for entry, b in zip(row, scales, strict=True))
            for row, a in zip(core, scales, strict=True)
        )
    rows = tuple(tuple(row) for row in border)
    return ArticulatedFactors(
        dag, tuple(links), tuple(gates), n_speeds, rows, responses, scales, scaled
    )


def _scales(dag: Dag, diagonal: Sequence[Node], natural: Sequence[Node]) -> tuple[Node, ...]:
    """Give what makes the diagonal one; a row of rounding stays small."""
    return tuple(
        1.0 / dag.function("sqrt", dag.function("abs", entry) + SMALLEST_SHARE * size)
        for entry, size in zip(diagonal, natural, strict=True)
    )


def _outwards(link: Link) -> range:
    """Order a branch's speeds for elimination: the outermost first."""
    return range(len(link.speeds) - 1, -1, -1)


def _dot(a: Sequence[Node], b: Sequence[Node]) -> Node:
    total = a[0].dag.zero
    for x, y in zip(a, b, strict=True):
        total = total + x * y
    return total


def _power(link: Link, speed: int, force: Vector, torque: Vector) -> Node:
    return vector.dot(link.turning[speed], torque) + vector.dot(link.shifting[speed], force)


def _up(link: Link, a: Vector) -> Vector:
    return a if link.step is None else vector.times(link.step, a)


def _down(link: Link, a: Vector) -> Vector:
    return a if link.step is None else vector.transposed_times(link.step, a)


def _nothing(dag: Dag) -> _Spatial:
    zero = vector.zeros(dag)
    return _Spatial((zero, zero, zero), (zero, zero, zero), (zero, zero, zero))


def _skew(a: Vector) -> Matrix:
    zero = a[0].dag.zero
    return ((zero, -a[2], a[1]), (a[2], zero, -a[0]), (-a[1], a[0], zero))


def _rigid(dag: Dag, link: Link) -> _Spatial | None:
    """Give the inertia of the child's own cluster."""
    if link.mass is None or link.moment is None or link.tensor is None:
        return None
    zero, mass = dag.zero, link.mass
    unit = ((mass, zero, zero), (zero, mass, zero), (zero, zero, mass))
    coupling = _skew(vector.neg(link.moment))
    return _Spatial(unit, coupling, link.tensor)


def _sum(a: _Spatial | None, b: _Spatial | None) -> _Spatial | None:
    if a is None or b is None:
        return a if b is None else b
    return _Spatial(
        vector.matadd(a.force, b.force),
        vector.matadd(a.coupling, b.coupling),
        vector.matadd(a.torque, b.torque),
    )


def _resolved(link: Link, a: _Spatial) -> _Spatial:
    """Resolve in the parent's basis."""
    if link.step is None:
        return a
    return _Spatial(
        vector.congruence(link.step, a.force),
        vector.matmul(vector.matmul(link.step, a.coupling), vector.transpose(link.step)),
        vector.congruence(link.step, a.torque),
    )


def _opened(a: _Spatial, turning: Vector, shifting: Vector) -> tuple[_Gate, _Spatial]:
    """Let one speed give way: less u u^T / d."""
    force = vector.add(vector.times(a.force, shifting), vector.times(a.coupling, turning))
    torque = vector.add(
        vector.transposed_times(a.coupling, shifting), vector.times(a.torque, turning)
    )
    pivot = vector.dot(shifting, force) + vector.dot(turning, torque)
    inverse = 1.0 / pivot
    left_force, left_torque = vector.scale(inverse, force), vector.scale(inverse, torque)
    rest = _Spatial(
        _less(a.force, force, left_force, is_symmetric=True),
        _less(a.coupling, force, left_torque, is_symmetric=False),
        _less(a.torque, torque, left_torque, is_symmetric=True),
    )
    return _Gate(force, torque, inverse), rest


def _less(m: Matrix, a: Vector, b: Vector, is_symmetric: bool) -> Matrix:
    """Form m - a b^T, one half of it where it is symmetric."""
    rows = [[m[i][j] for j in range(3)] for i in range(3)]
    for i in range(3):
        for j in range(3):
            if is_symmetric and j < i:
                rows[i][j] = rows[j][i]
            else:
                rows[i][j] = m[i][j] - a[i] * b[j]
    x, y, z = ((row[0], row[1], row[2]) for row in rows)
    return (x, y, z)


def _shifted(a: _Spatial, arm: Vector) -> _Spatial:
    """Move the point of reference back along an arm."""
    if vector.is_zero(arm):
        return a
    skew = _skew(arm)
    moved = vector.matmul(a.force, skew)
    coupling = _minus(a.coupling, moved)
    # J - E^T R + R E - R F R, with R F R = R (F R) and R E - R F R = R (E - F R).
    across = vector.matmul(vector.transpose(a.coupling), skew)
    torque = vector.matadd(_minus(a.torque, across), vector.matmul(skew, coupling))
    x, y, z = torque
    symmetric = (x, (x[1], y[1], y[2]), (x[2], y[2], z[2]))
    return _Spatial(a.force, coupling, symmetric)


def _minus(a: Matrix, b: Matrix) -> Matrix:
    return (vector.sub(a[0], b[0]), vector.sub(a[1], b[1]), vector.sub(a[2], b[2]))
