"""Three-vectors and three-by-three matrices of nodes.

A vector is a tuple of three nodes, a matrix a tuple of three rows. What is structurally zero is
the constant zero and folds away, so that planar scenes give planar programs. The functions here
take duals of vectors and matrices, too (:mod:`cotree.dag.dual`), and then give duals.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from cotree.dag.dual import additive, bilinear, is_varied, linear, tangent_of, value_of, varied

if TYPE_CHECKING:
    from cotree.dag.nodes import Dag, Node

Vector = tuple["Node", "Node", "Node"]
Matrix = tuple[Vector, Vector, Vector]


def zeros(dag: Dag) -> Vector:
    """Give the zero vector."""
    return (dag.zero, dag.zero, dag.zero)


def identity(dag: Dag) -> Matrix:
    """Give the unit matrix."""
    one, zero = dag.one, dag.zero
    return ((one, zero, zero), (zero, one, zero), (zero, zero, one))


def is_zero(a: Vector) -> bool:
    """Whether a vector is structurally zero."""
    # A vector that changes is not zero, even where its value is: its derivative would be lost.
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
    """Form a or -a."""
    return a if sign > 0 else neg(a)


@bilinear
def scale(factor: Node, a: Vector) -> Vector:
    """Form factor * a."""
    return (factor * a[0], factor * a[1], factor * a[2])


def _dot(a: Vector, b: Vector) -> Node:
    """Form the scalar product of plain vectors, which is all that bilinear forms are asked for."""
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
    """Form R S R^T of a symmetric S, computing one half of it."""
    # Entry ij is row i of R S times row j of R; the tensor stays symmetric, so the lower half is
    # the upper one.
    rs = matmul(r, s)
    xx, xy, xz = dot(rs[0], r[0]), dot(rs[0], r[1]), dot(rs[0], r[2])
    yy, yz, zz = dot(rs[1], r[1]), dot(rs[1], r[2]), dot(rs[2], r[2])
    return ((xx, xy, xz), (xy, yy, yz), (xz, yz, zz))


def polar(a: Vector, origin: str = "") -> tuple[Node, Vector]:
    """Give the length of a vector and its direction; messages name a length of zero by its origin.

    With the direction e, the length changes by e . a', and e by (a' - (e . a') e) / length.
    """
    value = value_of(a)
    length = value[0].dag.function("sqrt", dot(value, value))
    if origin:
        length.dag.note_origin(length, origin)
    # One division serves the direction and its derivative.
    inverse = 1.0 / length
    direction = scale(inverse, value)
    if not is_varied(a):
        return length, direction
    d = tangent_of(a)
    d_length = dot(direction, d)
    d_direction = scale(inverse, sub(d, scale(d_length, direction)))
    return varied(length, d_length), varied(direction, d_direction)


def angular_acceleration_matrix(omega: Vector, alpha: Vector) -> Matrix:
    """Form A = [alpha]x + [omega]x[omega]x, so that A r is the acceleration of a fixed point r."""
    return _spread(_products(omega, omega), alpha)


@bilinear
def _products(a: Vector, b: Vector) -> tuple[Vector, Vector]:
    """Form the squares and the mixed products of two vectors that have the same value."""
    # The mixed products are taken in one order only, as both vectors have the same value. For duals
    # the two terms of the bilinear form make up the derivative of both orders.
    squares = (a[0] * b[0], a[1] * b[1], a[2] * b[2])
    return squares, (a[1] * b[2], a[0] * b[2], a[0] * b[1])


@linear
def _spread(products: tuple[Vector, Vector], alpha: Vector) -> Matrix:
    # [omega]x[omega]x = omega omega^T - |omega|^2 I is symmetric, [alpha]x is skew.
    (xx, yy, zz), (yz, xz, xy) = products
    ax, ay, az = alpha
    # The diagonal is written as -(yy + zz), never as xx - |omega|^2: nothing cancels.
    return (
        (-(yy + zz), xy - az, xz + ay),
        (xy + az, -(xx + zz), yz - ax),
        (xz - ay, yz + ax, -(xx + yy)),
    )
