"""Three-dimensional vectors, matrices and rotations, whose components are nodes.

A vector is a tuple of three nodes, a matrix a tuple of three rows. Structural zeros are the
constant zero and vanish in simplification, so the code of a planar scene contains only planar
terms. The functions also accept duals of vectors and matrices (:mod:`cotree.dag.dual`), and then
return duals.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import chain
from typing import TYPE_CHECKING, Any

from cotree.dag.dual import additive, bilinear, is_varied, linear, tangent_of, value_of, varied
from cotree.dag.nodes import Dag, Node

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence


Vector = tuple["Node", "Node", "Node"]
Matrix = tuple[Vector, Vector, Vector]


def zeros(dag: Dag) -> Vector:
    """Return the zero vector."""
    return (dag.zero, dag.zero, dag.zero)


def identity(dag: Dag) -> Matrix:
    """Return the unit matrix."""
    one, zero = dag.one, dag.zero
    return ((one, zero, zero), (zero, one, zero), (zero, zero, one))


def is_zero(a: Vector) -> bool:
    """Return whether a vector is structurally zero."""
    # A dual is never zero: even if its value is zero, its derivative is needed.
    if is_varied(a):
        return False
    zero = a[0].dag.zero
    return a[0] is zero and a[1] is zero and a[2] is zero


@additive
def add(a: Vector, b: Vector) -> Vector:
    """Form a + b."""
    return (a[0] + b[0], a[1] + b[1], a[2] + b[2])


@additive
def sub(a: Vector, b: Vector) -> Vector:
    """Form a - b."""
    return (a[0] - b[0], a[1] - b[1], a[2] - b[2])


@linear
def neg(a: Vector) -> Vector:
    """Form -a."""
    return (-a[0], -a[1], -a[2])


def signed(sign: int, a: Vector) -> Vector:
    """Return ``a`` or ``-a``, depending on ``sign``."""
    return a if sign > 0 else neg(a)


@bilinear
def scale(factor: Node, a: Vector) -> Vector:
    """Form factor * a."""
    return (factor * a[0], factor * a[1], factor * a[2])


def _dot(a: Vector, b: Vector) -> Node:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@bilinear
def dot(a: Vector, b: Vector) -> Node:
    """Form the scalar product."""
    return _dot(a, b)


@bilinear
def cross(a: Vector, b: Vector) -> Vector:
    """Form the vector product."""
    return (
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    )


@bilinear
def times(m: Matrix, a: Vector) -> Vector:
    """Form the product of a matrix and a vector."""
    return (_dot(m[0], a), _dot(m[1], a), _dot(m[2], a))


@bilinear
def transposed_times(m: Matrix, a: Vector) -> Vector:
    """Form the product of the transposed matrix and a vector."""
    return (
        m[0][0] * a[0] + m[1][0] * a[1] + m[2][0] * a[2],
        m[0][1] * a[0] + m[1][1] * a[1] + m[2][1] * a[2],
        m[0][2] * a[0] + m[1][2] * a[1] + m[2][2] * a[2],
    )


@linear
def transpose(m: Matrix) -> Matrix:
    """Form the transposed matrix."""
    a, b, c = m
    return ((a[0], b[0], c[0]), (a[1], b[1], c[1]), (a[2], b[2], c[2]))


@bilinear
def matmul(a: Matrix, b: Matrix) -> Matrix:
    """Form the product of two matrices."""
    x, y, z = zip(*b, strict=True)
    rows = [(_dot(r, x), _dot(r, y), _dot(r, z)) for r in a]
    return (rows[0], rows[1], rows[2])


@additive
def matadd(a: Matrix, b: Matrix) -> Matrix:
    """Form the sum of two matrices."""
    return (add(a[0], b[0]), add(a[1], b[1]), add(a[2], b[2]))


def congruence(r: Matrix, s: Matrix) -> Matrix:
    """Form R S R^T for a symmetric S; only one half is computed."""
    # Entry ij is the product of row i of R S and row j of R.
    rs = matmul(r, s)
    xx, xy, xz = dot(rs[0], r[0]), dot(rs[0], r[1]), dot(rs[0], r[2])
    yy, yz, zz = dot(rs[1], r[1]), dot(rs[1], r[2]), dot(rs[2], r[2])
    return ((xx, xy, xz), (xy, yy, yz), (xz, yz, zz))


def polar(a: Vector, origin: str = "") -> tuple[Node, Vector]:
    """Return length and direction of a vector; ``origin`` describes it in errors on zero length.

    The rate of the length is e . a' with the direction e, whose rate is (a' - (e . a') e) / length.
    """
    value = value_of(a)
    length = value[0].dag.function("sqrt", dot(value, value))
    # The direction and its derivative share this reciprocal.
    inverse = 1.0 / length
    for node in (length, inverse) if origin else ():
        node.dag.note_origin(node, origin)
    direction = scale(inverse, value)
    if not is_varied(a):
        return length, direction
    d = tangent_of(a)
    d_length = dot(direction, d)
    d_direction = scale(inverse, sub(d, scale(d_length, direction)))
    return varied(length, d_length), varied(direction, d_direction)


def angular_acceleration_matrix(omega: Vector, alpha: Vector) -> Matrix:
    """Form A = [alpha]x + [omega]x[omega]x; A r is the acceleration of a body-fixed point r."""
    return _spread(_products(omega, omega), alpha)


@bilinear
def _products(a: Vector, b: Vector) -> tuple[Vector, Vector]:
    """Form squares and mixed products of the components of ``a`` and ``b``, which are equal."""
    # For equal values, a_i b_j = a_j b_i. Of duals, the derivative contains both orders.
    squares = (a[0] * b[0], a[1] * b[1], a[2] * b[2])
    return squares, (a[1] * b[2], a[0] * b[2], a[0] * b[1])


@linear
def _spread(products: tuple[Vector, Vector], alpha: Vector) -> Matrix:
    # [omega]x[omega]x = omega omega^T - |omega|^2 I is symmetric, [alpha]x is skew.
    (xx, yy, zz), (yz, xz, xy) = products
    ax, ay, az = alpha
    # -(yy + zz) avoids the cancellation in xx - |omega|^2.
    return (
        (-(yy + zz), xy - az, xz + ay),
        (xy + az, -(xx + zz), yz - ax),
        (xz - ay, yz + ax, -(xx + yy)),
    )


@dataclass(frozen=True)
class Rotation:
    """The orientation of a rotated frame relative to a reference frame."""

    matrix: Matrix  # transforms components from the rotated frame to the reference frame
    #: Axis and angle if the rotation has a single axis. Successive rotations about one axis then
    #: add their angles, which costs less than a product of matrices.
    axis: Vector | None = None
    angle: Node | None = None

    @property
    def is_identity(self) -> bool:
        """Whether the matrix is structurally the unit matrix."""
        one, zero = self.matrix[0][0].dag.one, self.matrix[0][0].dag.zero
        return all(
            entry is (one if i == j else zero)
            for i, row in enumerate(self.matrix)
            for j, entry in enumerate(row)
        )

    def then(self, axis: Vector, angle: Node) -> Rotation:
        """Return this rotation followed by a rotation about an axis fixed in the rotated frame."""
        if self.angle is None or self.axis is None:
            if self.is_identity:
                return about(axis, angle)
        elif all(a is b for a, b in zip(self.axis, axis, strict=True)):
            return about(axis, self.angle + angle)
        # Equal components are identical nodes, so "is" compares axes.
        elif all(a is -b for a, b in zip(self.axis, axis, strict=True)):
            return about(self.axis, self.angle - angle)
        return Rotation(matmul(self.matrix, about(axis, angle).matrix))


def no_rotation(dag: Dag) -> Rotation:
    """Return the identity rotation."""
    return Rotation(identity(dag))


def about(axis: Vector, angle: Node) -> Rotation:
    """Return the rotation about a unit axis."""
    dag = angle.dag
    cosine, sine = dag.function("cos", angle), dag.function("sin", angle)
    # Rodrigues' formula: R = cos I + (1 - cos) e e^T + sin [e]x.
    versine = 1.0 - cosine
    x, y, z = axis

    def diagonal(e: Node) -> Node:
        # e^2 + (1 - e^2) cos simplifies to 1 or cos if the axis is a coordinate axis.
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
    """Form the matrix R(q) / (q.q), which is a rotation for a quaternion of any length.

    With the division, dR/dq R^T is skew, so that every derivative corresponds to a rotation vector;
    for the polynomial R(q) it is not skew.
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
    """Form the quaternion product q' = q (0, w) / 2, real part first; w is in the rotated frame."""
    q0, q1, q2, q3 = (0.5 * entry for entry in q)
    w1, w2, w3 = w
    return (
        -(q1 * w1 + q2 * w2 + q3 * w3),
        q0 * w1 + q2 * w3 - q3 * w2,
        q0 * w2 + q3 * w1 - q1 * w3,
        q0 * w3 + q1 * w2 - q2 * w1,
    )


def quaternion_turn(q: Sequence[Node], d: Sequence[Node], is_own: bool) -> Vector:
    """Form the rotation vector, [rad], of a change d of a quaternion q, real part first.

    The norm of q need not be one. With ``is_own``, the vector is resolved in the rotated frame,
    2 Im(conj(q) d) / |q|^2, otherwise in the reference frame, 2 Im(d conj(q)) / |q|^2.
    """
    q0, q1, q2, q3 = q
    d0, d1, d2, d3 = d
    double = q0.dag.constant(2.0) / (q0 * q0 + q1 * q1 + q2 * q2 + q3 * q3)
    imaginary, along = (q1, q2, q3), (d1, d2, d3)
    # Im(conj(q) d) = q0 d - d0 q - q x d. In Im(d conj(q)), the cross product has the other sign.
    straight = sub(scale(q0, along), scale(d0, imaginary))
    across = cross(imaginary, along)
    total = sub(straight, across) if is_own else add(straight, across)
    return scale(double, total)


def quaternion_product(a: Sequence[Node], b: Sequence[Node]) -> tuple[Node, ...]:
    """Form the quaternion of rotation ``a`` followed by ``b`` about axes of the rotated frame."""
    a0, a1, a2, a3 = a
    b0, b1, b2, b3 = b
    return (
        a0 * b0 - a1 * b1 - a2 * b2 - a3 * b3,
        a0 * b1 + a1 * b0 + a2 * b3 - a3 * b2,
        a0 * b2 + a2 * b0 + a3 * b1 - a1 * b3,
        a0 * b3 + a3 * b0 + a1 * b2 - a2 * b1,
    )


def quaternion_about(axis: Vector, angle: Node) -> tuple[Node, ...]:
    """Form the quaternion of a rotation about a unit axis."""
    half = 0.5 * angle
    sine = angle.dag.function("sin", half)
    return (angle.dag.function("cos", half), *scale(sine, axis))


def quaternion_of_angles(angles: Vector) -> tuple[Node, ...]:
    """Form the quaternion of roll, pitch and yaw about fixed x, y and z axes, in this order."""
    dag = angles[0].dag
    total: tuple[Node, ...] = (dag.one, dag.zero, dag.zero, dag.zero)
    for axis, angle in zip(identity(dag), angles, strict=True):
        # Rotations about fixed axes multiply from the left.
        total = quaternion_product(quaternion_about(axis, angle), total)
    return total


def quaternion_of_matrix(rows: Sequence[Sequence[float]]) -> list[float] | None:
    """Return the quaternion of a numeric matrix, or None if the matrix is not a rotation."""
    dag = Dag()
    try:
        x, y, z = ((dag.constant(a), dag.constant(b), dag.constant(c)) for a, b, c in rows)
        q = quaternion_of_nodes((x, y, z), lambda node: node.value or 0.0)
        back = of_quaternion(q)
    except ArithmeticError:  # entries are not finite, or so large that products overflow
        return None
    # The tolerance accepts rotation matrices that were printed with seven digits.
    pairs = zip(chain(*back), chain(*rows), strict=True)
    if not all(abs((node.value or 0.0) - entry) <= 1e-6 for node, entry in pairs):
        return None
    length = math.hypot(*(node.value or 0.0 for node in q))
    return [(node.value or 0.0) / length for node in q]


def quaternion_of_nodes(m: Matrix, value: Callable[[Node], float]) -> tuple[Node, ...]:
    """Form a rotation matrix's quaternion; ``value`` evaluates nodes to find the largest component.

    S. W. Shepperd, J. Guidance and Control 1 (1978) 223.
    """
    dag = m[0][0].dag
    trace = m[0][0] + m[1][1] + m[2][2]
    # 4 q0^2 = 1 + trace and 4 qi^2 = 1 - trace + 2 m_ii: the largest of trace and diagonal belongs
    # to the largest component, which is at least 1/2 and a safe divisor.
    squares = [value(node) for node in (trace, m[0][0], m[1][1], m[2][2])]
    largest = squares.index(max(squares))
    if largest == 0:
        # The real part is the largest component: 2 q0 = sqrt(1 + trace).
        double = dag.function("sqrt", trace + 1.0)
        half = 0.5 / double
        sums = (m[2][1] - m[1][2], m[0][2] - m[2][0], m[1][0] - m[0][1])
        return (0.5 * double, *scale(half, sums))
    i = largest - 1
    j, k = (i + 1) % 3, (i + 2) % 3
    # An imaginary part is the largest component: 2 qi = sqrt(1 + m_ii - m_jj - m_kk).
    double = dag.function("sqrt", 1.0 + m[i][i] - m[j][j] - m[k][k])
    half = 0.5 / double
    q = [half * (m[k][j] - m[j][k])] + [dag.zero] * 3
    q[1 + i] = 0.5 * double
    q[1 + j] = half * (m[j][i] + m[i][j])
    q[1 + k] = half * (m[k][i] + m[i][k])
    return tuple(q)
