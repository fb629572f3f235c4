"""Rotations of one frame against another, as matrices of nodes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from cotree.dag import vector

if TYPE_CHECKING:
    from cotree.dag.nodes import Dag, Node
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
            if self.is_identity:
                return about(axis, angle)
        elif all(a is b for a, b in zip(self.axis, axis, strict=True)):
            return about(axis, self.angle + angle)
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
