"""Numerical checks of a scene and its first graph, before sensitivities, C text and compilation."""

from __future__ import annotations

import ast
import math
from contextlib import contextmanager
from itertools import chain
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from cotree.components import FreeRotation
from cotree.dag.evaluate import evaluate
from cotree.dag.nodes import symbols_in
from cotree.errors import FormulationError, SingularSystemError
from cotree.scene.expressions import Expression, finite

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    from cotree.dag.nodes import Node
    from cotree.formulation.first_graph import FirstGraph
    from cotree.scene.description import SceneDescription

Array = npt.NDArray[np.float64]

#: Smaller singular values are rounding errors if rows and columns have length one.
_ROUNDING = 1e-15
#: Number of random configurations that are searched for a motion without inertia.
_N_TRIED = 3


@contextmanager
def within_range(scene: SceneDescription) -> Iterator[None]:
    """Convert an overflow to an error that names the scene value that most likely caused it."""
    try:
        yield
    except ArithmeticError as error:
        # The value whose magnitude is farthest from one most likely caused the overflow.
        rows = [(abs(math.log(abs(x))), x, where) for x, where in _numbers(scene) if x]
        _, number, where = max(rows, default=(0.0, 0.0, f"scene '{scene.name}'"))
        raise FormulationError(
            f"{where} is {number:g}, for which the equations overflow or underflow ({error}): "
            "give a number closer to one, in other units if necessary"
        ) from None


def _numbers(scene: SceneDescription) -> Iterator[tuple[float, str]]:
    for edge in scene.edges.values():
        for name, value in (*edge.fields.items(), *edge.initial.items()):
            for number in _constants(value):
                yield number, f"{name} of edge '{edge.name}'"
    for parameter in scene.parameters.values():
        for number in _constants(parameter.value):
            yield number, f"parameter '{parameter.name}'"
    for number in _constants(scene.gravity):
        yield number, "gravity"


def _constants(value: object) -> Iterator[float]:
    if isinstance(value, Expression):
        for node in ast.walk(value.tree):
            if isinstance(node, ast.Constant):
                yield from _constants(node.value)
    elif isinstance(value, (tuple, list)):
        for item in value:
            yield from _constants(item)
    elif (number := finite(value)) is not None:
        yield number


def check_numbers(first: FirstGraph) -> None:
    """Raise an error if a guard is violated, or the mass matrix is singular in all states."""
    system = first.system
    names = list(system.tunable)
    for guard in first.guards:
        number = system.at_scene(guard.value)
        # Infinity is replaced by nan, which violates every guard.
        guard.named(names).check(number if np.isfinite(number) else np.nan)
    # Pivots that are certainly positive need no numerical test.
    if all(first.is_safe[: len(system.speeds)]):
        return
    found = _motion_without_inertia(first)
    if found is None:
        return
    motion, own, carried = found
    largest = np.max(np.abs(motion))
    speeds = [
        v for v, part in zip(system.speeds, motion, strict=True) if abs(part) > 1e-6 * largest
    ]
    moved = [v.name if v.coordinate is None else v.coordinate.name for v in speeds]
    edges = _listed(dict.fromkeys(v.edge for v in speeds))
    i, what = speeds[0].index, "moves no inertia"
    # The inertia may be lost in rounding errors of a larger one: another body's, or a long arm's.
    if len(speeds) == 1 and own[i] != 0.0:
        what += f" beyond rounding errors of the {carried[i]:.3g} that its joint carries"
    raise SingularSystemError(
        f"the mass matrix is singular in every configuration: a motion of {_listed(moved)} "
        f"{what}; give {edges}, or bodies beyond, mass or inertia, or weld a joint"
    )


def _listed(names: Iterable[str]) -> str:
    return ", ".join(f"'{name}'" for name in names)


def _motion_without_inertia(first: FirstGraph) -> tuple[Array, Array, Array] | None:
    """Return speeds that move neither inertia nor constraints in random states, or None.

    Also return the inertia that each speed moves, and the inertia beyond its joint.
    """
    n = len(first.system.speeds)
    # A vector in the common null space of mass matrix and gradients moves no inertia or constraint.
    entries = [entry for row in first.matrix for entry in row[:n]]
    symbols = sorted(symbols_in(entries), key=lambda symbol: symbol.data)
    # With a fixed seed, a scene always has the same result.
    random = np.random.default_rng(0)
    result = None
    for _ in range(_N_TRIED):
        least = _carried(first)
        with np.errstate(all="ignore"):
            found = np.array(evaluate(entries, _random_state(first, symbols, random)), dtype=float)
        if not (np.all(np.isfinite(found)) and np.all(np.isfinite(least))):
            return None
        # There is no such motion if the matrix is regular in one configuration.
        rows = found.reshape(-1, n)
        motion = _null_vector(rows, least)
        if motion is None:
            return None
        result = motion, np.diag(rows), least
    return result


def _random_state(
    first: FirstGraph, symbols: Sequence[Node], random: np.random.Generator
) -> dict[Node, float]:
    """Return scene values of parameters, unit quaternions, and random numbers for other symbols."""
    system = first.system
    values = dict(zip(symbols, random.uniform(0.3, 1.0, len(symbols)).tolist(), strict=True))
    values |= {s: first.scene.parameters[name].number for name, s in system.tunable.items()}
    for step in chain(*system.steps.values()):
        if isinstance(step.kind, FreeRotation):
            # Normally distributed entries prefer no direction.
            turn = random.normal(size=len(step.coordinates))
            turn /= np.linalg.norm(turn)
            values |= {c.symbol: x for c, x in zip(step.coordinates, turn.tolist(), strict=True)}
    return values


def _carried(first: FirstGraph) -> Array:
    """Return the inertia that each uncertain speed may move; rounding errors are relative to it."""
    n_clusters = len(first.motion.clusters.inertias)
    masses, moments = np.zeros(n_clusters), np.zeros(n_clusters)
    found = np.zeros(len(first.system.speeds))
    for branch in reversed(first.motion.clusters.branches):
        inertia, own = first.motion.clusters.inertias[branch.child], branch.child
        if inertia is not None:
            masses[own] += abs(first.system.at_scene(inertia.mass))
            moments[own] += sum(abs(first.system.at_scene(inertia.tensor[i][i])) for i in range(3))
        masses[branch.parent] += masses[own]
        moments[branch.turn_parent] += moments[own]
        for speed in branch.speeds:
            if not first.is_safe[speed.index]:
                found[speed.index] = moments[own] if branch.turns else masses[own]
    return found


def _null_vector(rows: Array, least: Array) -> Array | None:
    """Return a null vector up to rounding, or None; ``least`` bounds the diagonal from below."""
    n = len(least)
    # Scale to a unit diagonal, so that the tolerance does not depend on units.
    sizes = np.sqrt(np.maximum(np.abs(np.diag(rows)), least))
    sizes[sizes == 0.0] = 1.0
    scaled = rows / sizes
    scaled[:n] /= sizes[:, None]
    lengths = np.linalg.norm(scaled[n:], axis=1)
    scaled[n:] /= np.where(lengths > 0.0, lengths, 1.0)[:, None]
    _, values, right = np.linalg.svd(scaled)
    return right[-1] / sizes if values[-1] <= n * _ROUNDING * values[0] else None
