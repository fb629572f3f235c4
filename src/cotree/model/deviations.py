"""Linear systems in independent deviations that satisfy the constraints; tests for steady motion.

Small deviations from a motion x(t) follow dx' = A dx. Deviations that satisfy the constraints to
first order are dx = N z, with one entry of z per degree of freedom. With the constraint Jacobian C
along the motion, C A N + C' N = 0: deviations continue to satisfy the constraints, and

    z' = N^+ (A N - N') z + N^+ B u.

N' is nonzero in general, because the constraint directions of a moving mechanism change. Here
N = T S. T replaces deviations of quaternions by rotation vectors, and deviations of angular
velocities by the rates of these vectors, in the base frame of the quaternion. In this frame a wheel
that spins about a fixed axle is a steady motion, and T' is known. S expresses dependent deviations
in terms of independent ones. Only its rows for independent deviations are differentiated; these are
constant, so S' is not needed.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from cotree.errors import SingularSystemError
from cotree.model.linear import independent_columns, least_step
from cotree.tolerances import RANK

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from cotree.model.arrays import Array


#: Matrix entries below this fraction of the largest entry in their row are rounding errors.
_ROUNDING = 1e-10
#: Rates below this fraction of max(largest rate, 1) count as zero.
_STILL = 1e-6
#: Relative tolerance for the consistency of the derivatives of redundant constraints.
_AGREE = 1e-7
#: Changes of the linear system along the motion count as zero below this relative size.
_SAME = 1e-5


@dataclass(frozen=True, eq=False)
class Slopes:
    """A model linearised about a state; its states are all differential states except modes."""

    #: Values and rates of the differential states.
    y: Array
    rates: Array
    #: Derivatives of rates (A, B) and outputs (C, D) with respect to states (A, C), inputs (B, D).
    A: Array
    B: Array
    C: Array
    D: Array
    #: Jacobians of the constraints, without quaternion norms, and of the constraint rates.
    held: Array
    held_rates: Array
    #: Numbers of coordinates, which are the first states, and of speeds, which follow them.
    n_coordinates: int
    n_speeds: int
    #: Index of an edge's first angular velocity, by the index of its first quaternion entry.
    turns: Mapping[int, int]


@dataclass(frozen=True, eq=False)
class Reduced:
    """A linear system in independent deviations z, with dx = basis z."""

    #: Matrices of z' = A z + B u and y = C z + D u.
    A: Array
    B: Array
    C: Array
    D: Array
    basis: Array  # deviations of all states per unit of each z
    rates: Array  # rates of the motion, expressed in z
    #: Names of z: states, or rotations ``EDGE.turn_x`` and their rates ``EDGE.turn_x_dot``.
    names: tuple[str, ...]


def reduce(point: Slopes, names: Sequence[str], chosen: Sequence[str] | None = None) -> Reduced:
    """Transform a linear system to independent deviations, by default the best conditioned ones."""
    if not point.turns and not len(point.held_rates):
        # Without constraints and quaternions, all states are independent.
        unit = np.eye(len(point.y))
        return Reduced(point.A, point.B, point.C, point.D, unit, point.rates, tuple(names))
    turn, turn_rate, back, own_names = _deviations(point, names)
    values, rates = _sized(point.held @ turn), _sized(point.held_rates @ turn)
    held, n = np.vstack([values, rates]), turn.shape[1]
    if chosen is not None:
        free = np.array([own_names.index(name) for name in chosen], dtype=int)
    else:
        # Positions are chosen first: their relation to speeds is ill-conditioned at low speeds.
        cut = point.n_coordinates - len(point.turns)
        end = cut + point.n_speeds
        free = np.array(
            [
                *independent_columns(values[:, :cut]),
                *(cut + i for i in independent_columns(rates[:, cut:end])),
                *range(end, n),
            ],
            dtype=int,
        )
    bound = np.setdiff1d(np.arange(n), free)
    spread = np.zeros((n, len(free)))
    spread[free] = np.eye(len(free))
    if len(bound):
        # S solves held_bound z_bound = -held_free z_free for the dependent deviations.
        spread[bound] = -least_step(held[:, bound], held[:, free], held)
    basis = turn @ spread
    along = back[free]
    return Reduced(
        # N^+ (A N - N') with N = T S; in the rows of independent deviations, N' = T' S.
        A=along @ (point.A @ basis - turn_rate @ spread),
        B=along @ point.B,
        C=point.C @ basis,
        D=point.D,
        basis=basis,
        rates=along @ point.rates,
        names=tuple(own_names[i] for i in free),
    )


def reduce_along(
    point: Slopes, change: Slopes, found: Reduced, names: Sequence[str]
) -> tuple[Array, Array, Array]:
    """Return the derivatives of the reduced A, B and C for a change of the full system.

    Raise SingularSystemError if the model has quaternions, or if the change makes redundant
    constraints inconsistent.
    """
    if not point.turns and not len(point.held_rates):
        return change.A, change.B, change.C
    if point.turns:
        raise SingularSystemError(
            "derivatives of a reduced system are not supported for rotations by quaternions: use "
            "revolute or universal joints, or differentiate the full system"
        )
    free = np.array([list(names).index(name) for name in found.names], dtype=int)
    bound = np.setdiff1d(np.arange(len(point.y)), free)
    spread = found.basis
    moved = np.zeros_like(spread)
    if len(bound):
        rows = np.vstack([point.held, point.held_rates])
        size = np.maximum(np.linalg.norm(rows, axis=1), 1e-300)[:, None]
        rows, changes = rows / size, np.vstack([change.held, change.held_rates]) / size
        # Differentiate held S = 0: held_bound S_bound' = -held' S.
        target = changes @ spread
        moved[bound] = -least_step(rows[:, bound], target, rows)
        left = np.max(np.abs(target + rows @ moved), initial=0.0)
        if left > _AGREE * (1.0 + np.max(np.abs(target), initial=0.0)):
            raise SingularSystemError(
                "redundant constraints are inconsistent along this change if the states are held "
                "fixed: use total=True, with which the states follow the constraints"
            )
    return (
        change.A[free] @ spread + point.A[free] @ moved,
        change.B[free],
        change.C @ spread + point.C @ moved,
    )


def _sized(rows: Array) -> Array:
    """Scale rows to unit length, and drop rows that contain only rounding errors."""
    lengths = np.linalg.norm(rows, axis=1)
    kept = lengths > RANK * np.max(lengths, initial=0.0)
    return np.asarray(rows[kept] / lengths[kept, None])


def _deviations(point: Slopes, names: Sequence[str]) -> tuple[Array, Array, Array, list[str]]:
    """Return T, T', a left inverse of T, and the names of the deviations."""
    n = len(point.y)
    columns: list[tuple[Array, Array, Array, str]] = []
    turned = {
        place for q, w in point.turns.items() for place in (*range(q, q + 4), *range(w, w + 3))
    }
    for i in range(n):
        if i in point.turns:
            columns += _rotation(point, i, names[i].rpartition(".")[0])
        elif i in point.turns.values():
            first = next(q for q, w in point.turns.items() if w == i)
            columns += _rotation_rate(point, first, i, names[i].rpartition(".")[0])
        elif i not in turned:
            unit = np.eye(n)[i]
            columns.append((unit, np.zeros(n), unit, names[i]))
    empty = np.zeros((n, 0))
    turn, rate, back = (
        np.array([column[k] for column in columns]).T if columns else empty for k in range(3)
    )
    return turn, rate, back.T, [column[3] for column in columns]


def _rotation(point: Slopes, at: int, edge: str) -> list[tuple[Array, Array, Array, str]]:
    """Return the quaternion deviations due to small rotations about the axes of the base frame."""
    entries = slice(at, at + 4)
    q, rate = point.y[entries], point.rates[entries]
    found = []
    for k, axis in enumerate("xyz"):
        along, change, back = (np.zeros(len(point.y)) for _ in range(3))
        # A small rotation vector e in the base frame changes q by (0, e) q / 2.
        along[entries] = 0.5 * _premultiplied(k, q)
        change[entries] = 0.5 * _premultiplied(k, rate)
        # The columns are orthogonal with length |q| / 2, so the scaled transpose is a left inverse.
        back[entries] = 4.0 * along[entries] / (q @ q)
        found.append((along, change, back, f"{edge}.turn_{axis}"))
    return found


def _rotation_rate(
    point: Slopes, at: int, speed: int, edge: str
) -> list[tuple[Array, Array, Array, str]]:
    """Return the deviations of the body-fixed angular velocity along the axes of the base frame."""
    entries = slice(speed, speed + 3)
    rotation = _matrix(point.y[at : at + 4])
    w = point.y[entries]
    found = []
    for k, axis in enumerate("xyz"):
        along, change = np.zeros(len(point.y)), np.zeros(len(point.y))
        along[entries] = rotation[k]
        change[entries] = np.cross(rotation[k], w)  # an axis a in the rotating frame: a' = a x w
        found.append((along, change, along, f"{edge}.turn_{axis}_dot"))
    return found


def _premultiplied(axis: int, q: Array) -> Array:
    """Return the quaternion product of a unit axis vector and q."""
    unit, zero = np.eye(3)[axis], float(q[0])
    return np.array([-unit @ q[1:], *(zero * unit + np.cross(unit, q[1:]))])


def _matrix(q: Array) -> Array:
    """Return the rotation matrix, whose columns are the axes of the rotated frame."""
    q = q / np.linalg.norm(q)
    # Euler-Rodrigues formula
    a, v = q[0], q[1:]
    across = np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])
    return np.asarray((a * a - v @ v) * np.eye(3) + 2.0 * np.outer(v, v) + 2.0 * a * across)


def core(system: Reduced) -> npt.NDArray[np.int_]:
    """Return the deviations that remain if those without effect on others are removed repeatedly.

    For a vehicle on a plane, the positions are removed first, then heading and wheel angles. Each
    removed deviation has a zero eigenvalue.
    """
    scale = np.maximum(
        _ROUNDING * np.max(np.abs(system.A), axis=1, initial=0.0),
        1e-3 * _ROUNDING * np.max(np.abs(system.A), initial=0.0),
    )
    # Keep deviation j while a remaining row has a significant entry in column j.
    matters = np.abs(system.A) > scale[:, None]
    kept = np.arange(len(system.A))
    while True:
        found = kept[np.any(matters[np.ix_(kept, kept)], axis=0)]
        if len(found) == len(kept):
            return kept
        kept = found


def is_still(system: Reduced, point: Slopes) -> bool:
    """Return whether all deviations in :func:`core` are constant, as in an equilibrium."""
    rates = np.abs(system.rates[core(system)])
    return bool(
        np.max(rates, initial=0.0) <= _STILL * max(1.0, np.max(np.abs(point.rates), initial=0.0))
    )


def is_same(first: Reduced, second: Reduced) -> bool:
    """Return whether two systems agree in the deviations of :func:`core` of the first."""
    block = np.ix_(core(first), core(first))
    size = np.max(np.abs(first.A[block]), initial=0.0)
    change = np.max(np.abs(first.A[block] - second.A[block]), initial=0.0)
    return bool(change <= _SAME * max(size, 1e-300))
