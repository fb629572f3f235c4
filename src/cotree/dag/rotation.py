"""Rotations of one frame against another, as matrices of nodes."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import chain
from typing import TYPE_CHECKING, Any

from cotree.dag import vector
from cotree.dag.nodes import Dag

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from cotree.dag.nodes import Node
    from cotree.dag.vector import Matrix, Vector


@dataclass(frozen=True)
class Rotation:
    """The axes of one frame, resolved in another.

    Attributes
    ----------
    matrix : Matrix
        Takes components in the rotated frame to components in the other.
    axis, angle : Vector and Node, or None
        Where it turns about one axis: successive turns about the same axis add their angles,
        which costs one sum where the product of two matrices costs many.
    """

    matrix: Matrix
    axis: Vector | None = None
    angle: Node | None = None

    @property
    def is_identity(self) -> bool:
        """Whether it is structurally the unit matrix."""
        one, zero = self.matrix[0][0].dag.one, self.matrix[0][0].dag.zero
        return all(
            entry is (one if i == j else zero)
            for i, row in enumerate(self.matrix)
            for j, entry in enumerate(row)
        )

    def then(self, axis: Vector, angle: Node) -> Rotation:
        """Turn further, about an axis fixed in the rotated frame."""
        if self.angle is None or self.axis is None:
            # From the identity any axis is taken over, so that further turns about it add their
            # angles.
            if self.is_identity:
                return about(axis, angle)
        elif all(a is b for a, b in zip(self.axis, axis, strict=True)):
            return about(axis, self.angle + angle)
        # Nodes are interned, so equal axes are the same nodes.
        elif all(a is -b for a, b in zip(self.axis, axis, strict=True)):
            return about(self.axis, self.angle - angle)
        return Rotation(vector.matmul(self.matrix, about(axis, angle).matrix))


def no_rotation(dag: Dag) -> Rotation:
    """Give the unit rotation."""
    return Rotation(vector.identity(dag))


def about(axis: Vector, angle: Node) -> Rotation:
    """Turn about a unit axis.

    Parameters
    ----------
    axis : Vector
        Unit vector.
    angle : Node
        Angle in rad.
    """
    dag = angle.dag
    cosine, sine = dag.function("cos", angle), dag.function("sin", angle)
    # Rodrigues: R = cos I + (1 - cos) e e^T + sin [e]x.
    versine = 1.0 - cosine
    x, y, z = axis

    def diagonal(e: Node) -> Node:
        # e^2 + (1 - e^2) cos, which folds to 1 or cos where the axis is a coordinate axis
        return e * e + (1.0 - e * e) * cosine

    def off(a: Node, b: Node, c: Node) -> Node:
        return a * b * versine + c * sine

    matrix = (
        (diagonal(x), off(x, y, -z), off(x, z, y)),
        (off(y, x, z), diagonal(y), off(y, z, -x)),
        (off(z, x, -y), off(z, y, x), diagonal(z)),
    )
    return Rotation(matrix, axis, angle)


def of_quaternion(q: Sequence[Node]) -> Matrix:
    """Form R(q) / (q.q), a rotation for a quaternion of any length.

    With the division every derivative of the matrix is a rotation vector; with the polynomial
    R(q) alone dR/dq R^T is not skew.
    """
    q0, q1, q2, q3 = q
    dag = q0.dag
    factor = dag.constant(2.0) / (q0 * q0 + q1 * q1 + q2 * q2 + q3 * q3)
    a, b, c = factor * q1, factor * q2, factor * q3
    xx, yy, zz = a * q1, b * q2, c * q3
    xy, xz, yz = a * q2, a * q3, b * q3
    wx, wy, wz = a * q0, b * q0, c * q0
    return (
        (1.0 - (yy + zz), xy - wz, xz + wy),
        (xy + wz, 1.0 - (xx + zz), yz - wx),
        (xz - wy, yz + wx, 1.0 - (xx + yy)),
    )


def quaternion_rates(q: Sequence[Any], w: Sequence[Any]) -> tuple[Any, ...]:
    """Form the rates of a quaternion from the angular velocity in the turned frame's axes.

    Of nodes, or of numbers.
    """
    # q' = q o (0, w) / 2, real part first.
    q0, q1, q2, q3 = (0.5 * entry for entry in q)
    w1, w2, w3 = w
    return (
        -(q1 * w1 + q2 * w2 + q3 * w3),
        q0 * w1 + q2 * w3 - q3 * w2,
        q0 * w2 + q3 * w1 - q1 * w3,
        q0 * w3 + q1 * w2 - q2 * w1,
    )


def quaternion_turn(q: Sequence[Node], d: Sequence[Node], is_own: bool) -> Vector:
    """Form the rotation vector of a change of a quaternion.

    Parameters
    ----------
    q, d : sequence of four Node
        The quaternion, real part first, and its change. The norm of q need not be one.
    is_own : bool
        Whether the result is resolved in the axes of the turned frame, 2 Im(conj(q) d) / |q|^2, or
        in those of the frame that it turns against, 2 Im(d conj(q)) / |q|^2.

    Returns
    -------
    Vector
        The rotation vector, [rad].
    """
    q0, q1, q2, q3 = q
    d0, d1, d2, d3 = d
    scale = q0.dag.constant(2.0) / (q0 * q0 + q1 * q1 + q2 * q2 + q3 * q3)
    imaginary, along = (q1, q2, q3), (d1, d2, d3)
    # Im(conj(q) d) = q0 d - d0 q - q x d, of the imaginary parts q and d. The other order of
    # factors changes the sign of the cross product.
    straight = vector.sub(vector.scale(q0, along), vector.scale(d0, imaginary))
    across = vector.cross(imaginary, along)
    total = vector.sub(straight, across) if is_own else vector.add(straight, across)
    return vector.scale(scale, total)


def quaternion_product(a: Sequence[Node], b: Sequence[Node]) -> tuple[Node, ...]:
    """Form the quaternion of the turn ``b`` within the frame that ``a`` has turned."""
    a0, a1, a2, a3 = a
    b0, b1, b2, b3 = b
    return (
        a0 * b0 - a1 * b1 - a2 * b2 - a3 * b3,
        a0 * b1 + a1 * b0 + a2 * b3 - a3 * b2,
        a0 * b2 + a2 * b0 + a3 * b1 - a1 * b3,
        a0 * b3 + a3 * b0 + a1 * b2 - a2 * b1,
    )


def quaternion_about(axis: Vector, angle: Node) -> tuple[Node, ...]:
    """Form the quaternion of a turn about a unit axis."""
    half = 0.5 * angle
    # The product does not commute: ``a`` stands left, as its frame is the outer one.
    sine = angle.dag.function("sin", half)
    return (angle.dag.function("cos", half), *vector.scale(sine, axis))


def quaternion_of_angles(angles: Vector) -> tuple[Node, ...]:
    """Form the quaternion of roll, pitch and yaw about fixed x, y and z axes, in this order."""
    dag = angles[0].dag
    total: tuple[Node, ...] = (dag.one, dag.zero, dag.zero, dag.zero)
    for axis, angle in zip(vector.identity(dag), angles, strict=True):
        # About fixed axes later turns multiply from the left.
        total = quaternion_product(quaternion_about(axis, angle), total)
    return total


def quaternion_of_matrix(rows: Sequence[Sequence[float]]) -> list[float] | None:
    """Find the quaternion of a rotation matrix of numbers; None if it is no rotation.

    A matrix is one where that quaternion's own matrix is the same; see
    :func:`quaternion_of_nodes`.
    """
    dag = Dag()
    try:
        x, y, z = ((dag.constant(a), dag.constant(b), dag.constant(c)) for a, b, c in rows)
        q = quaternion_of_nodes((x, y, z), lambda node: node.value or 0.0)
        back = of_quaternion(q)
    except ArithmeticError:  # not finite, or so large that products are not
        return None
    # 1e-6: a matrix printed with seven digits is meant to be a rotation.
    pairs = zip(chain(*back), chain(*rows), strict=True)
    if not all(abs((node.value or 0.0) - entry) <= 1e-6 for node, entry in pairs):
        return None
    length = math.hypot(*(node.value or 0.0 for node in q))
    return [(node.value or 0.0) / length for node in q]


def quaternion_of_nodes(m: Matrix, value: Callable[[Node], float]) -> tuple[Node, ...]:
    """Form the quaternion of a rotation matrix, by the largest square at the present values.

    Parameters
    ----------
    m : Matrix
        The matrix.
    value : callable
        Gives the present value of a node.

    References
    ----------
    S. W. Shepperd, J. Guidance and Control 1 (1978) 223.
    """
    dag = m[0][0].dag
    trace = m[0][0] + m[1][1] + m[2][2]
    # 4 q0^2 = 1 + tr and 4 qi^2 = 1 - tr + 2 m_ii. The largest of the trace and the diagonal tells
    # the largest component, which is at least a half, so that the division by it is safe.
    squares = [value(node) for node in (trace, m[0][0], m[1][1], m[2][2])]
    largest = squares.index(max(squares))
    if largest == 0:
        # The real part is the largest: 2 q0 = sqrt(1 + trace).
        double = dag.function("sqrt", trace + 1.0)
        scale = 0.5 / double
        sums = (m[2][1] - m[1][2], m[0][2] - m[2][0], m[1][0] - m[0][1])
        return (0.5 * double, *vector.scale(scale, sums))
    i = largest - 1
    j, k = (i + 1) % 3, (i + 2) % 3
    # An imaginary part is the largest: 2 qi = sqrt(1 + m_ii - m_jj - m_kk).
    double = dag.function("sqrt", 1.0 + m[i][i] - m[j][j] - m[k][k])
    scale = 0.5 / double
    q = [scale * (m[k][j] - m[j][k])] + [dag.zero] * 3
    q[1 + i] = 0.5 * double
    q[1 + j] = scale * (m[j][i] + m[i][j])
    q[1 + k] = scale * (m[k][i] + m[i][k])
    return tuple(q)
