"""Check for inertia tensors that no body can have.

The moments of inertia of a body are sums over its mass, so that none of the principal ones exceeds
the sum of the other two. Equations can be formed and solved without that; therefore a violation is
reported, not refused.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from cotree.components import Shape
from cotree.dag.nodes import Dag
from cotree.scene.expressions import Expression
from cotree.scene.motion_spaces import motion_spaces
from cotree.scene.parameters import parameter_values

if TYPE_CHECKING:
    from collections.abc import Iterator

    import numpy.typing as npt

    from cotree.scene.description import SceneDescription
    from cotree.scene.expressions import FieldValue

# Thin rods and plates are at the limit, and their three values may be written with six digits.
_WRITTEN = 2e-5

# A share of the heaviest body's mass below which rounding errors of its forces are felt.
_TINY = 1e-8

#: Principal moments above minus this share of the sum of all are zero but for rounding.
ROUNDING = 1e-12


def tiny_masses(scene: SceneDescription) -> Iterator[tuple[str, str]]:
    """Name bodies whose mass is far below that of the heaviest, with a sentence each.

    Forces that balance there but for rounding accelerate them, which takes short steps.
    """
    values = parameter_values(scene.parameters)
    dag = Dag()
    masses: dict[str, float] = {}
    for edge in scene.edges.values():
        given = edge.fields.get("mass")
        if not isinstance(given, Expression) or not all(name in values for name in given.names):
            continue
        number = given.lower(dag, lambda name: dag.constant(values[name])).value
        if number is not None and number > 0.0:
            masses[edge.name] = number
    heaviest = max(masses, key=masses.__getitem__, default="")
    for name, mass in masses.items():
        if mass < _TINY * masses[heaviest]:
            yield (
                name,
                f"mass of edge '{name}' is {mass:.3g}, {mass / masses[heaviest]:.1g} of that of "
                f"'{heaviest}': rounding errors of forces accelerate it, and steps become short; "
                "give it more mass, or leave the body out where constraints hold its motion",
            )


def impossible_inertias(scene: SceneDescription) -> Iterator[str]:
    """Give the sentences of :func:`inertia_faults`."""
    return (told for _, told in inertia_faults(scene))


def inertia_faults(scene: SceneDescription) -> Iterator[tuple[str, str]]:
    """Name the bodies with negative principal moments, or that break the triangle rule.

    In a plane scene, where only the moment about one axis is read, negative ones alone are named.

    Parameters
    ----------
    scene : SceneDescription
        A scene whose equations could be formed; what counts are its values.

    Yields
    ------
    edge, sentence : str
        For each such body.
    """
    is_plane = bool(motion_spaces(scene).plane)
    for edge in scene.edges.values():
        for row in edge.component.fields:
            if row.shape is not Shape.INERTIA or row.name not in edge.fields:
                continue
            tensor = _numbers(scene, edge.fields[row.name])
            # Eigenvalues come in ascending order. Of a tensor with one entry only that moment is
            # meant, and the others are left out on purpose.
            least, middle, largest = np.linalg.eigvalsh(tensor)
            is_negative = least < -ROUNDING * np.trace(tensor)
            if is_negative:
                fault = "the least is negative"
            elif (
                not is_plane
                and np.count_nonzero(tensor) > 1
                and least + middle < (1.0 - _WRITTEN) * largest
            ):
                fault = "the largest exceeds the sum of the others"
            else:
                continue
            yield (
                edge.name,
                f"{row.name} of edge '{edge.name}' is that of no body: of its principal "
                f"moments {least:.6g}, {middle:.6g} and {largest:.6g} {row.unit} {fault}; "
                "check the numbers, the signs of the products of inertia, and that they are "
                "about the centre of mass",
            )


def _numbers(scene: SceneDescription, field: FieldValue) -> npt.NDArray[np.float64]:
    """Evaluate a tensor, or three principal values, at the parameters' values."""
    # Expressions fold to numbers in an arena where parameters are constants.
    dag, values = Dag(), parameter_values(scene.parameters)

    def number(entry: Expression) -> float:
        node = entry.lower(dag, lambda name: dag.constant(values[name]))
        assert node.value is not None  # there are but numbers in it
        return node.value

    rows = [number(row) if isinstance(row, Expression) else [*map(number, row)] for row in field]  # type: ignore[union-attr]
    found = np.array(rows)
    return np.diag(found) if found.ndim == 1 else found
