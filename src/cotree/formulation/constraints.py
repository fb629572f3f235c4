"""Constraints: measures that must be zero, and multipliers as their dual through variables."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from cotree.dag import vector
from cotree.formulation.chords import constraint_rows
from cotree.formulation.elements import Sums, Wrench
from cotree.formulation.laws import Applied, prescribed_rate_rows
from cotree.formulation.through import carried, hand_on, project

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from cotree.dag.nodes import Node
    from cotree.formulation.across import Motion, View
    from cotree.formulation.chords import Constraint
    from cotree.formulation.frames import Geometry
    from cotree.formulation.measures import Measure, Pull


@dataclass(frozen=True)
class Constraints:
    """The constraint equations of a scene."""

    rows: tuple[Constraint, ...]  # constraints whose rate depends on at least one speed
    multipliers: tuple[Node, ...]  # symbols of the multipliers, which are constraint forces
    applied: tuple[Applied, ...]  # generalised forces due to the multipliers
    #: Derivative of each rate with respect to each speed, shape (n_rows, n_speeds).
    gradient: tuple[tuple[Node, ...], ...]
    #: Sum of the squared terms of each gradient entry, in which terms cannot cancel.
    sizes: tuple[tuple[Node, ...], ...]
    values: tuple[Node | None, ...]  # values of the measures; None if a measure has only a rate
    rates: tuple[Node, ...]  # rates of the measures
    #: Accelerations of the measures at zero coordinate accelerations, plus stabilisation terms.
    biases: tuple[Node, ...]
    baumgarte: float  # decay rate of constraint violations


def form_constraints(
    motion: Motion, view: View, baumgarte: float
) -> tuple[Constraints, list[Constraint]]:
    """Form the constraints (``baumgarte`` in 1/s); also return rows that no motion can change."""
    dag, speeds = motion.system.dag, motion.system.speeds
    kept, idle = [], []
    for row in (*constraint_rows(motion), *prescribed_rate_rows(motion)):
        with dag.labelled(f"constraint of {row.edge}"):
            pull = row.measure.pull(view)
            # The derivative of the rate with respect to a speed is the power of the pull per unit
            # of this speed. This yields a row of G without differentiation of the value.
            gradient = tuple(along_speeds(motion, pull))
        # With a zero row, the multiplier would act on no speed, and the matrix would be singular.
        if all(entry.is_zero for entry in gradient):
            idle.append(row)
        else:
            kept.append((row, pull, gradient))
    # Multipliers follow the accelerations among the unknowns of the system.
    symbols = [dag.symbol("w", len(speeds) + i) for i in range(len(kept))]
    values, rates, biases = [], [], []
    for row, _, _ in kept:
        with dag.labelled(f"constraint of {row.edge}"):
            values.append(row.measure.value(view))
            rates.append(row.measure.rate(view))
            # c'' = G v' + b; the accelerations v' of the view are zero, so the result is b.
            biases.append(stabilised(row.measure, view, baumgarte))
    constraints = Constraints(
        tuple(row for row, _, _ in kept),
        tuple(symbols),
        tuple(
            Applied(row.edge, row.name, row.measure, pull, symbol)
            for (row, pull, _), symbol in zip(kept, symbols, strict=True)
        ),
        tuple(gradient for _, _, gradient in kept),
        tuple(_sizes(motion, pull, gradient) for _, pull, gradient in kept),
        tuple(values),
        tuple(rates),
        tuple(biases),
        baumgarte,
    )
    return constraints, idle


def _sizes(motion: Motion, pull: Pull, gradient: Sequence[Node]) -> tuple[Node, ...]:
    """Return the squared magnitudes of the gradient's entries that are not structurally zero."""
    with motion.system.dag.labelled("sizes of constraints"):
        sizes = sizes_along_speeds(motion, pull)
    return tuple(
        entry if entry.is_zero else size for entry, size in zip(gradient, sizes, strict=True)
    )


def stabilised(measure: Measure, view: View, rate: float) -> Any:
    """Return c'' + 2 b c' + b^2 c of a measure c, without the last term if c has no value.

    With the rate b = 0 it is c'' (J. Baumgarte, Comput. Methods Appl. Mech. Eng. 1 (1972) 1).
    """
    # A violation decays like exp(-b t), critically damped; without stabilisation, it may grow.
    total = measure.acceleration(view)
    if rate:
        total = total + (2.0 * rate) * measure.rate(view)
        value = measure.value(view)
        total = total if value is None else total + (rate * rate) * value
    return total


def along_speeds(motion: Motion, pull: Pull) -> list[Node]:
    """Return the projection of a force onto the motion spaces: its power per unit of each speed."""
    return _along_speeds(motion, pull, project, lambda effort: effort)


def sizes_along_speeds(motion: Motion, pull: Pull) -> list[Node]:
    """Return for each result of :func:`along_speeds` the sum of its squared terms."""
    return _along_speeds(motion, pull, _projected_size, lambda effort: effort * effort)


def _projected_size(geometry: Geometry, i: int, wrench: Wrench) -> Node:
    turning, shifting = geometry.turning[i], geometry.shifting[i]
    # |e|^2 |T|^2 bounds (e.T)^2: entries far below this bound are rounding errors.
    turned = vector.dot(turning, turning) * vector.dot(wrench.torque, wrench.torque)
    return turned + vector.dot(shifting, shifting) * vector.dot(wrench.force, wrench.force)


def _along_speeds(
    motion: Motion,
    pull: Pull,
    projected: Callable[[Geometry, int, Wrench], Node],
    of_effort: Callable[[Node], Node],
) -> list[Node]:
    """Traverse the branches inwards from each cluster on which a wrench acts."""
    dag, frames = motion.system.dag, motion.frames
    totals = [dag.zero] * len(motion.system.speeds)
    for index, effort in pull.efforts.items():
        # Efforts act along speeds and need no projection.
        totals[index] = totals[index] + of_effort(effort)
    for pulled, force, torque in pull.wrenches:
        # Propagate each wrench separately, since a size is a sum of squares of single terms.
        # Parents have smaller numbers, so the wrench does not reach clusters with larger numbers.
        sums = Sums(pulled + 1)
        sums.gather(pulled, Wrench(force, torque))
        for cluster in range(pulled, 0, -1):
            total = sums.at(cluster)
            if total is None:
                continue
            geometry, wrench = motion.to(cluster), carried(frames, cluster, total)
            for i, speed in enumerate(geometry.branch.speeds):
                totals[speed.index] = totals[speed.index] + projected(geometry, i, wrench)
            hand_on(sums, geometry, wrench)
    return totals


def multiplier_loads(applied: Sequence[Applied]) -> list[Pull]:
    """Return the pulls, each multiplied by the value of its through variable."""
    return [row.pull.scaled(row.magnitude) for row in applied]
