"""Elimination along a tree: articulated inertias (R. Featherstone, 1983), O(n) per solution.

The articulated inertia of each branch, without the part that moves freely along its speeds, is
added to its parent; the mass matrix is not formed. This costs less than the mass matrix for long
chains, and more for short ones.

For each speed, w w^T / d is subtracted from the inertia, with the wrench w per unit of the speed
and the pivot d. The term is subtracted at once or *deferred*: w is then shifted by the next arm,
and the effects of the term on the next wrench and pivot are subtracted there. A deferred term takes
more operations, but halves the critical path from one pivot to the next, which becomes a
reciprocal, a product and a difference.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from cotree.dag import vector
from cotree.dag.multi_output import RANK_TOLERANCE
from cotree.linear.factors import Core, kept_size

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cotree.dag.nodes import Dag, Node
    from cotree.dag.vector import Matrix, Vector


_NO_AXIS = -1  # s is not along a coordinate axis


@dataclass(frozen=True)
class Gate:
    """The wrench per unit of a speed, divided by its pivot, and the reciprocal of the pivot."""

    force: Vector
    torque: Vector
    inverse: Node


@dataclass(frozen=True)
class Spatial:
    """Inertia that maps accelerations a, alpha to force F a + E alpha and torque E^T a + J alpha.

    The deferred terms w w^T / d in ``taken`` have not yet been subtracted.
    """

    force: Matrix
    coupling: Matrix
    torque: Matrix
    taken: tuple[Gate, ...] = ()


def nothing(dag: Dag) -> Spatial:
    """Return an inertia of zero."""
    zero = vector.zeros(dag)
    return Spatial((zero, zero, zero), (zero, zero, zero), (zero, zero, zero))


def _skew(a: Vector) -> Matrix:
    zero = a[0].dag.zero
    return ((zero, -a[2], a[1]), (a[2], zero, -a[0]), (-a[1], a[0], zero))


def rigid(mass: Node, moment: Vector, tensor: Matrix) -> Spatial:
    """Return a rigid body's inertia from its first moment, [kg m], and second moment, [kg m^2]."""
    zero = mass.dag.zero
    unit = ((mass, zero, zero), (zero, mass, zero), (zero, zero, mass))
    # F = m a + alpha x h = m a - [h]x alpha, and T = h x a + J alpha with h x a = (-[h]x)^T a.
    return Spatial(unit, _skew(vector.neg(moment)), tensor)


def total(a: Spatial | None, b: Spatial | None) -> Spatial | None:
    """Add the inertias of two parts of one body; None represents zero inertia."""
    if a is None or b is None:
        return a if b is None else b
    return Spatial(
        vector.matadd(a.force, b.force),
        vector.matadd(a.coupling, b.coupling),
        vector.matadd(a.torque, b.torque),
        (*a.taken, *b.taken),
    )


def resolved(a: Spatial, step: Matrix) -> Spatial:
    """Transform an inertia to another basis by the rotation ``step``."""
    return Spatial(
        vector.congruence(step, a.force),
        # `congruence` requires a symmetric matrix, but the coupling is not symmetric.
        vector.matmul(vector.matmul(step, a.coupling), vector.transpose(step)),
        vector.congruence(step, a.torque),
        tuple(
            Gate(vector.times(step, w.force), vector.times(step, w.torque), w.inverse)
            for w in a.taken
        ),
    )


def released(
    a: Spatial, turning: Vector, shifting: Vector, is_deferred: bool
) -> tuple[Gate, Spatial]:
    """Subtract the term w w^T / d of a speed from an inertia, or defer it until the next arm.

    ``turning`` and ``shifting`` are the direction s: angular acceleration, and acceleration of the
    reference point, per unit of the speed's rate. The gate contains the wrench w = a s divided by
    its pivot d = s . w, and 1 / d. R. Featherstone, Int. J. Robotics Research 2 (1983) 13.
    """
    # w = I s is the wrench per unit of the speed; the pivot is d = s . w.
    force = vector.add(vector.times(a.force, shifting), vector.times(a.coupling, turning))
    torque = vector.add(
        vector.transposed_times(a.coupling, shifting), vector.times(a.torque, turning)
    )
    pivot = vector.dot(shifting, force) + vector.dot(turning, torque)
    for w in a.taken:
        # Each earlier deferred term reduces the pivot by (s.w)^2 / d and the wrench by w (s.w) / d.
        along = vector.dot(shifting, w.force) + vector.dot(turning, w.torque)
        pivot = pivot - w.inverse * (along * along)
        force = _less_scaled(force, w.inverse, along, w.force)
        torque = _less_scaled(torque, w.inverse, along, w.torque)
        # The deferred terms have been shifted with the inertia and can now be subtracted.
        a = _less_product(a, w, w, w.inverse)
    inverse = 1.0 / pivot
    wrench = Gate(force, torque, inverse)
    # Both substitutions, inwards and outwards, use w / d.
    gate = Gate(vector.scale(inverse, force), vector.scale(inverse, torque), inverse)
    if is_deferred:
        return gate, _struck(a, wrench, turning, shifting)
    return gate, _less_product(a, wrench, gate, inverse.dag.one)


def _less_scaled(a: Vector, inverse: Node, along: Node, b: Vector) -> Vector:
    """Return a - inverse * along * b; the reciprocal enters last, for a short critical path."""
    return vector.sub(a, vector.scale(inverse, vector.scale(along, b)))


def _less_product(a: Spatial, u: Gate, v: Gate, scale: Node) -> Spatial:
    """Return a - scale u v^T, where v is a multiple of u."""
    return Spatial(
        _less(a.force, u.force, v.force, scale, is_symmetric=True),
        _less(a.coupling, u.force, v.torque, scale, is_symmetric=False),
        _less(a.torque, u.torque, v.torque, scale, is_symmetric=True),
    )


def _less(m: Matrix, a: Vector, b: Vector, scale: Node, is_symmetric: bool) -> Matrix:
    """Return m - scale a b^T; if symmetric, only one half is computed."""
    rows = [[m[i][j] for j in range(3)] for i in range(3)]
    for i in range(3):
        for j in range(3):
            if is_symmetric and j < i:
                rows[i][j] = rows[j][i]
            else:
                rows[i][j] = m[i][j] - scale * (a[i] * b[j])
    return _matrix(rows)


def _struck(a: Spatial, wrench: Gate, turning: Vector, shifting: Vector) -> Spatial:
    """Defer the term of a speed; if s is a coordinate axis, set its row and column to zero."""
    zero, parts = wrench.inverse.dag.zero, (*shifting, *turning)
    axis, *others = (i for i, part in enumerate(parts) if not part.is_zero)
    # Subtracting w w^T / d makes the inertia's row and column of s exactly zero. If s is a
    # coordinate axis, these entries become structural zeros.
    if others or parts[axis].value not in (1.0, -1.0):
        axis = _NO_AXIS

    def struck(m: Matrix, rows: int, columns: int) -> Matrix:
        return _matrix(
            [
                [zero if axis in (rows + i, columns + j) else m[i][j] for j in range(3)]
                for i in range(3)
            ]
        )

    # These entries are already zero, so nothing is subtracted from them later.
    left = [zero if i == axis else x for i, x in enumerate((*wrench.force, *wrench.torque))]
    taken = Gate((left[0], left[1], left[2]), (left[3], left[4], left[5]), wrench.inverse)
    return Spatial(
        struck(a.force, 0, 0), struck(a.coupling, 0, 3), struck(a.torque, 3, 3), (taken,)
    )


def _matrix(rows: Sequence[Sequence[Node]]) -> Matrix:
    x, y, z = ((row[0], row[1], row[2]) for row in rows)
    return (x, y, z)


def shifted(a: Spatial, arm: Vector) -> Spatial:
    """Move the reference point of an inertia inwards along an arm."""
    if vector.is_zero(arm):
        return a
    skew = _skew(arm)
    moved = vector.matmul(a.force, skew)
    coupling = _minus(a.coupling, moved)
    # The torque part is J - E^T R + R E - R F R, with R E - R F R = R (E - F R).
    across = vector.matmul(vector.transpose(a.coupling), skew)
    torque = vector.matadd(_minus(a.torque, across), vector.matmul(skew, coupling))
    x, y, z = torque
    symmetric = (x, (x[1], y[1], y[2]), (x[2], y[2], z[2]))
    # Deferred wrenches are shifted to the new reference point like all wrenches.
    taken = tuple(
        replace(w, torque=vector.add(w.torque, vector.cross(arm, w.force))) for w in a.taken
    )
    return Spatial(a.force, coupling, symmetric, taken)


def _minus(a: Matrix, b: Matrix) -> Matrix:
    return (vector.sub(a[0], b[0]), vector.sub(a[1], b[1]), vector.sub(a[2], b[2]))


@dataclass(frozen=True)
class TreeLink:
    """A moving branch of a tree; vectors are in the parent's basis."""

    parent: int  # index of the parent link, counted from one; zero is the ground
    speeds: tuple[int, ...]  # indices of its accelerations among the unknowns
    #: Angular acceleration of the link, and acceleration of its origin, per unit of each speed.
    turning: tuple[Vector, ...]
    shifting: tuple[Vector, ...]
    offset: Vector  # vector from the parent's origin to the link's origin
    step: Matrix | None  # rotation from the link's basis to the parent's basis; None if equal
    #: Mass, first and second moment about the link's origin, in the link's basis.
    inertia: tuple[Node, Vector, Matrix] | None
    #: Whether the terms w w^T / d of its speeds are subtracted only after the shift by the offset.
    is_deferred: bool = False


@dataclass(frozen=True)
class TreeFactors:
    """Factors of a mass matrix that is bordered by constraints, computed along the tree."""

    dag: Dag  # arena of the nodes
    links: tuple[TreeLink, ...]  # moving branches, parents first
    #: Wrench per unit of each speed, divided by the pivot, in the order of elimination: from a
    #: branch's last speed to its first. Its component along the speed is 1.
    gates: tuple[tuple[Gate, ...], ...]
    n_speeds: int  # number of accelerations
    border: tuple[tuple[Node, ...], ...] = ()  # coefficients of accelerations in border rows
    #: Accelerations per unit of each multiplier.
    responses: tuple[tuple[Node, ...], ...] = ()
    core: Core | None = None  # remaining equations of the multipliers; None without multipliers

    def solve(self, rhs: Sequence[Node], tolerance: float = RANK_TOLERANCE) -> list[Node]:
        """Solve for one right-hand side; return accelerations, then multipliers."""
        free = self._along_tree(rhs[: self.n_speeds])
        if self.core is None:
            return free
        with self.dag.labelled("substitution"):
            rest = [
                value - _dot(_entries(row), free)
                for value, row in zip(rhs[self.n_speeds :], self.border, strict=True)
            ]
            multipliers = self.core.solve(rest, tolerance)
            for i, multiplier in multipliers.items():
                for at, entry in _entries(self.responses[i]):
                    free[at] = free[at] - entry * multiplier
        return [*free, *(multipliers.get(i, self.dag.zero) for i in range(len(rest)))]

    def inverses(self) -> dict[int, Node]:
        """Return the reciprocals of all pivots by index of the speed."""
        return {
            link.speeds[speed]: gate.inverse
            for link, gates in zip(self.links, self.gates, strict=True)
            for speed, gate in zip(_outwards(link), gates, strict=True)
        }

    def _along_tree(self, rhs: Sequence[Node]) -> list[Node]:
        """Solve with the mass matrix: propagate forces inwards, then accelerations outwards."""
        dag, zero = self.dag, vector.zeros(self.dag)
        nothing = (zero, zero)
        loads: list[tuple[Vector, Vector]] = [nothing] * (len(self.links) + 1)
        rest = list(rhs)
        with dag.labelled("substitution"):
            for i in range(len(self.links) - 1, -1, -1):
                link, gates = self.links[i], self.gates[i]
                if loads[i + 1] is nothing and all(rest[at].is_zero for at in link.speeds):
                    continue  # no load: a constraint may act on only two bodies
                force, torque = (_up(link, part) for part in loads[i + 1])
                for speed, gate in zip(_outwards(link), gates, strict=True):
                    at = link.speeds[speed]
                    # u = tau - s . p is the effort that accelerates this speed.
                    rest[at] = rest[at] - _power(link, speed, force, torque)
                    # The force p + w u / d acts on the parent.
                    force = vector.add(force, vector.scale(rest[at], gate.force))
                    torque = vector.add(torque, vector.scale(rest[at], gate.torque))
                if link.parent:
                    known = loads[link.parent]
                    # The term that depends on the force is added last, for a short critical path.
                    torque = vector.add(known[1], torque)
                    torque = vector.add(torque, vector.cross(link.offset, force))
                    loads[link.parent] = (vector.add(known[0], force), torque)
            found = [dag.zero] * len(rest)
            moved: list[tuple[Vector, Vector]] = [nothing]
            for link, gates in zip(self.links, self.gates, strict=True):
                still = moved[link.parent] is nothing
                if still and all(rest[at].is_zero for at in link.speeds):
                    moved.append(nothing)
                    continue
                # With the parent's acceleration a, the acceleration along s is (u - w . a) / d.
                linear, angular = moved[link.parent]
                # Velocity terms are in the right-hand side, so an arm r adds only alpha x r.
                linear = vector.add(linear, vector.cross(angular, link.offset))
                for speed, gate in zip(reversed(_outwards(link)), reversed(gates), strict=True):
                    at = link.speeds[speed]
                    given = gate.inverse * rest[at] - vector.dot(gate.force, linear)
                    # Added last: this term cancels below if the speed rotates about this axis.
                    found[at] = given - vector.dot(gate.torque, angular)
                    linear = vector.add(linear, vector.scale(found[at], link.shifting[speed]))
                    angular = vector.add(angular, vector.scale(found[at], link.turning[speed]))
                moved.append((_down(link, linear), _down(link, angular)))
        return found


def factorise_tree(
    dag: Dag,
    links: Sequence[TreeLink],
    border: Sequence[Sequence[Node]],
    sizes: Sequence[Sequence[Node]],
    n_speeds: int,
) -> TreeFactors:
    """Propagate articulated inertias inwards, and eliminate the accelerations from the border.

    ``links``, parents first, have positive pivots. ``border`` contains the coefficients of the
    accelerations in the multipliers' rows, ``sizes`` the squared terms of these rows.
    """
    carried: list[Spatial | None] = [None] * (len(links) + 1)
    gates: list[tuple[Gate, ...]] = [()] * len(links)
    for i in range(len(links) - 1, -1, -1):
        link = links[i]
        with dag.labelled("articulated inertias"):
            alone = None if link.inertia is None else rigid(*link.inertia)
            own = total(alone, carried[i + 1]) or nothing(dag)
            if link.step is not None:
                # Motion spaces are resolved in the parent's basis.
                own = resolved(own, link.step)
            found = []
            for speed in _outwards(link):
                gate, own = released(
                    own, link.turning[speed], link.shifting[speed], link.is_deferred
                )
                found.append(gate)
            gates[i] = tuple(found)
            if link.parent:
                carried[link.parent] = total(shifted(own, link.offset), carried[link.parent])
    bare = TreeFactors(dag, tuple(links), tuple(gates), n_speeds)
    if not border:
        return bare
    # Columns of M^-1 G^T; the matrix of the multipliers is -G M^-1 G^T.
    responses = tuple(tuple(bare.solve(row)) for row in border)
    # A constraint between two bodies has mostly zeros in its row.
    entries = [_entries(row) for row in border]
    n = range(len(border))
    with dag.labelled("elimination"):
        core = [[dag.zero for _ in n] for _ in n]
        for i in n:
            for j in range(i + 1):
                # The matrix is symmetric: only one half is computed.
                core[i][j] = core[j][i] = -_dot(entries[i], responses[j])
        # The diagonal without cancellation is the sum of squared gradient entries over the pivots.
        inverses = bare.inverses()
        diagonal = tuple(
            kept_size(
                dag.function("abs", core[i][i]),
                [entry * inverses[k] for k, entry in _entries(sizes[i])],
            )
            for i in n
        )
    return replace(
        bare,
        border=tuple(map(tuple, border)),
        responses=responses,
        # Multipliers of redundant constraints are indeterminate: uniqueness is not required.
        core=Core(tuple(n), tuple(map(tuple, core)), diagonal, 0),
    )


def _outwards(link: TreeLink) -> range:
    """Return the speeds of a branch in the order of elimination: the outermost first."""
    return range(len(link.speeds) - 1, -1, -1)


def _entries(row: Sequence[Node]) -> list[tuple[int, Node]]:
    return [(i, entry) for i, entry in enumerate(row) if not entry.is_zero]


def _dot(a: Sequence[tuple[int, Node]], b: Sequence[Node]) -> Node:
    total = b[0].dag.zero
    for i, entry in a:
        total = total + entry * b[i]
    return total


def _power(link: TreeLink, speed: int, force: Vector, torque: Vector) -> Node:
    return vector.dot(link.turning[speed], torque) + vector.dot(link.shifting[speed], force)


def _up(link: TreeLink, a: Vector) -> Vector:
    return a if link.step is None else vector.times(link.step, a)


def _down(link: TreeLink, a: Vector) -> Vector:
    return a if link.step is None else vector.transposed_times(link.step, a)
