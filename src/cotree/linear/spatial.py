"""Spatial inertias of nodes: force and torque of a linear and an angular acceleration."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from cotree.dag import vector

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cotree.dag.nodes import Dag, Node
    from cotree.dag.vector import Matrix, Vector

_NO_AXIS = -1  # among force and torque


@dataclass(frozen=True)
class Gate:
    """A wrench of one speed, and the reciprocal of its pivot."""

    force: Vector
    torque: Vector
    inverse: Node


@dataclass(frozen=True)
class Spatial:
    """Force F a + E alpha and torque E^T a + J alpha of a linear and an angular acceleration.

    The deferred terms of speeds, w w^T / d of each wrench taken, are still to be subtracted.
    """

    force: Matrix
    coupling: Matrix
    torque: Matrix
    taken: tuple[Gate, ...] = ()


def nothing(dag: Dag) -> Spatial:
    """Give the inertia of what has none."""
    zero = vector.zeros(dag)
    return Spatial((zero, zero, zero), (zero, zero, zero), (zero, zero, zero))


def _skew(a: Vector) -> Matrix:
    zero = a[0].dag.zero
    return ((zero, -a[2], a[1]), (a[2], zero, -a[0]), (-a[1], a[0], zero))


def rigid(mass: Node, moment: Vector, tensor: Matrix) -> Spatial:
    """Give the inertia of a rigid body.

    Parameters
    ----------
    mass : Node
        m, [kg].
    moment : Vector
        First moment h about the point of reference, [kg m]: the coupling E is ``-[h]x``.
    tensor : Matrix
        Second moment J about that point, [kg m^2].
    """
    zero = mass.dag.zero
    unit = ((mass, zero, zero), (zero, mass, zero), (zero, zero, mass))
    # F = m a + alpha x h = m a - [h]x alpha, and T = h x a + J alpha with h x a = (-[h]x)^T a.
    return Spatial(unit, _skew(vector.neg(moment)), tensor)


def total(a: Spatial | None, b: Spatial | None) -> Spatial | None:
    """Add two inertias that move as one body; None stands for no inertia."""
    if a is None or b is None:
        return a if b is None else b
    return Spatial(
        vector.matadd(a.force, b.force),
        vector.matadd(a.coupling, b.coupling),
        vector.matadd(a.torque, b.torque),
        (*a.taken, *b.taken),
    )


def resolved(a: Spatial, step: Matrix) -> Spatial:
    """Resolve an inertia in another basis."""
    return Spatial(
        vector.congruence(step, a.force),
        # The coupling is no symmetric tensor, so that no half of it can be saved.
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
    """Release one speed: subtract w w^T / d, or defer it.

    Parameters
    ----------
    a : Spatial
        The inertia that the branch feels.
    turning, shifting : Vector
        Angular acceleration and acceleration of the point of reference for a unit of the speed's
        rate: the direction s.
    is_deferred : bool
        Whether w w^T / d is left to be subtracted behind the next arm.

    Returns
    -------
    gate : Gate
        The wrench w = a s over its pivot d = s . w, and 1 / d.
    left : Spatial
        The matrix that the parent feels.

    References
    ----------
    R. Featherstone, Int. J. Robotics Research 2 (1983) 13.
    """
    # w = I s, the wrench of a unit of the speed; its power along s itself is the pivot d.
    force = vector.add(vector.times(a.force, shifting), vector.times(a.coupling, turning))
    torque = vector.add(
        vector.transposed_times(a.coupling, shifting), vector.times(a.torque, turning)
    )
    pivot = vector.dot(shifting, force) + vector.dot(turning, torque)
    for w in a.taken:
        # Deferred terms: (s.w)^2 / d of each lowers the pivot, and w (s.w) / d the wrench.
        along = vector.dot(shifting, w.force) + vector.dot(turning, w.torque)
        pivot = pivot - w.inverse * (along * along)
        force = _less_scaled(force, w.inverse, along, w.force)
        torque = _less_scaled(torque, w.inverse, along, w.torque)
        # Behind the arm the deferred term is subtracted from the inertia after all.
        a = _less_product(a, w, w, w.inverse)
    inverse = 1.0 / pivot
    wrench = Gate(force, torque, inverse)
    # Over the pivot, as substitutions need it: both directions multiply by w / d.
    gate = Gate(vector.scale(inverse, force), vector.scale(inverse, torque), inverse)
    if is_deferred:
        return gate, _struck(a, wrench, turning, shifting)
    return gate, _less_product(a, wrench, gate, inverse.dag.one)


def _less_scaled(a: Vector, inverse: Node, along: Node, b: Vector) -> Vector:
    """Form a - inverse along b, with the reciprocal as the last factor."""
    return vector.sub(a, vector.scale(inverse, vector.scale(along, b)))


def _less_product(a: Spatial, u: Gate, v: Gate, scale: Node) -> Spatial:
    """Form a - scale u v^T, where v is a multiple of u."""
    return Spatial(
        _less(a.force, u.force, v.force, scale, is_symmetric=True),
        _less(a.coupling, u.force, v.torque, scale, is_symmetric=False),
        _less(a.torque, u.torque, v.torque, scale, is_symmetric=True),
    )


def _less(m: Matrix, a: Vector, b: Vector, scale: Node, is_symmetric: bool) -> Matrix:
    """Form m - scale a b^T, one half of it where it is symmetric."""
    rows = [[m[i][j] for j in range(3)] for i in range(3)]
    for i in range(3):
        for j in range(3):
            if is_symmetric and j < i:
                rows[i][j] = rows[j][i]
            else:
                rows[i][j] = m[i][j] - scale * (a[i] * b[j])
    return _matrix(rows)


def _struck(a: Spatial, wrench: Gate, turning: Vector, shifting: Vector) -> Spatial:
    """Defer the term of a speed; along a coordinate axis its row and column vanish at once."""
    zero, parts = wrench.inverse.dag.zero, (*shifting, *turning)
    axis, *others = (i for i, part in enumerate(parts) if not part.is_zero)
    # w w^T / d removes the row and the column of s from the inertia exactly; along a coordinate
    # axis these are known entries, which become structural zeros.
    if others or parts[axis].value not in (1.0, -1.0):
        axis = _NO_AXIS

    def struck(m: Matrix, rows: int, columns: int) -> Matrix:
        return _matrix(
            [
                [zero if axis in (rows + i, columns + j) else m[i][j] for j in range(3)]
                for i in range(3)
            ]
        )

    # What has been struck out must not be subtracted a second time.
    left = [zero if i == axis else x for i, x in enumerate((*wrench.force, *wrench.torque))]
    taken = Gate((left[0], left[1], left[2]), (left[3], left[4], left[5]), wrench.inverse)
    return Spatial(
        struck(a.force, 0, 0), struck(a.coupling, 0, 3), struck(a.torque, 3, 3), (taken,)
    )


def _matrix(rows: Sequence[Sequence[Node]]) -> Matrix:
    x, y, z = ((row[0], row[1], row[2]) for row in rows)
    return (x, y, z)


def shifted(a: Spatial, arm: Vector) -> Spatial:
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
    # Deferred wrenches move with the point of reference, as any wrench does.
    taken = tuple(
        replace(w, torque=vector.add(w.torque, vector.cross(arm, w.force))) for w in a.taken
    )
    return Spatial(a.force, coupling, symmetric, taken)


def _minus(a: Matrix, b: Matrix) -> Matrix:
    return (vector.sub(a[0], b[0]), vector.sub(a[1], b[1]), vector.sub(a[2], b[2]))
