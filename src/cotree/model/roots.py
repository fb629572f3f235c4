"""Roots of nonlinear equations g(z) = 0 from a poor guess: globalised Newton iterations.

In: g, its derivatives and a guess. Out: a ``Root``, found or not. What is tried, in this order:

1. Newton's method, damped a little by the natural monotonicity test: the step with the same matrix
   from the new point must be shorter. The test is free of the units of g.
2. The same from a better guess, if :mod:`cotree.model.junctions` has one; then from the guess
   given, with more damping.
3. Newton's method, damped so that the residual falls; g is scaled row by row.
4. Continuation: roots of g(z) - (1 - l) g(z0) for l from 0 to 1, with step control. Where all laws
   vanish at zero, g(0) is what sources and states give: from zero this is source stepping.
5. Levenberg and Marquardt's method, which needs no regular matrix.

Then the same from zero and from points aside. See P. Deuflhard, Newton Methods for Nonlinear
Problems, Springer 2004, chapters 3 and 5.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from cotree.model.linear import SMALL, TINY, Linear, Matrix, linearise
from cotree.model.rounding import ROUNDING, is_rounding

Array = npt.NDArray[np.float64]
Function = Callable[[Array], Array]

#: ``slope(z)``: full, or compressed by rows.
Slope = Callable[[Array], Matrix]

# Far from the root of an exponential each step is one unit of its argument, and the argument may
# begin a hundred too high.
_MOST_STEPS = 200
_LEAST_DAMPING = 1e-25

# Close to a root little damping is needed; where there is no root, that should be found out soon.
_MOST_STEPS_NEAR, _LEAST_DAMPING_NEAR = 30, 1.0 / 64.0
_CORRECTIONS, _LEAST_ADVANCE, _MOST_ADVANCES = 8, 1e-6, 1000
_MOST_TRIALS = 200

#: How far aside, as a share of the guess or of 1, and how often, to look for a better start.
_ASIDE, _TRIES = 0.5, 3


@dataclass(frozen=True)
class Root:
    """The point where an iteration came to rest.

    Attributes
    ----------
    z : ndarray, shape (n,)
        The point.
    g : ndarray, shape (n,)
        The residual there.
    is_found : bool
        Whether the residual is nothing but rounding.
    """

    z: Array
    g: Array
    is_found: bool


class Equation:
    """Equations in n unknowns, with the scale that rounding gives to each unknown.

    Parameters
    ----------
    value : callable
        ``value(z)``, shape (n,).
    slope : callable
        ``slope(z)``, shape (n, m + n): derivatives with respect to the held values, then to the
        unknowns. A full matrix, or one of SciPy's matrices, compressed by rows.
    held : ndarray, shape (m,)
        The held values, which add to the size of the terms that cancel.
    """

    def __init__(self, value: Function, slope: Slope, held: Array) -> None:
        self.value = value
        self.slope = slope
        self.held = held

    def linearised(self, z: Array) -> Linear:
        """Return the linearisation that a Newton step from a point needs.

        Raises
        ------
        LinAlgError
            If the matrix is singular or not finite.
        """
        return linearise(self.slope(z), np.concatenate([self.held, z]))

    def by_unknowns(self, z: Array) -> Matrix:
        """Give the derivatives by the unknowns."""
        return self.slope(z)[:, -len(z) :]

    def square(self, z: Array) -> Array:
        """Give the derivatives by the unknowns as a full matrix."""
        slope = self.by_unknowns(z)
        found: Array = slope if isinstance(slope, np.ndarray) else slope.toarray()
        return found


def find_root(
    equation: Equation, guess: Array, improve: Callable[[], Array | None] = lambda: None
) -> Root:
    """Look for a root.

    Parameters
    ----------
    equation : Equation
        The equations; what they give may be infinite or nan where they do not hold.
    guess : ndarray, shape (n,)
        The point to begin from.
    improve : callable, optional
        Gives a better guess, or None; it is asked where Newton's method fails from this one.

    Returns
    -------
    Root
        The first root found, or the point with the least residual in the units of g.
    """
    best: Root | None = None
    with np.errstate(all="ignore"):
        for attempt, start in _attempts(guess, improve):
            root = attempt(equation, start)
            if root.is_found:
                return root
            if best is None or _size(root.g) < _size(best.g):
                best = root
    assert best is not None  # there is always one attempt
    return best


def find_near(equation: Equation, guess: Array) -> Root:
    """Look for the root that a guess belongs to: damped Newton steps, nothing more."""
    with np.errstate(all="ignore"):
        return _by_little_damping(equation, guess)


def _attempts(
    guess: Array, improve: Callable[[], Array | None]
) -> Iterator[tuple[Callable[[Equation, Array], Root], Array]]:
    yield _by_little_damping, guess
    better = improve()
    if better is not None:
        yield _by_natural_test, better
    for start in _starts(guess):
        for attempt in (_by_natural_test, _by_residual_test, _by_continuation, _by_squares):
            yield attempt, start


def _starts(guess: Array) -> Iterator[Array]:
    yield guess
    if np.any(guess):
        yield np.zeros_like(guess)
    rng = np.random.default_rng(0)
    for _ in range(_TRIES):
        yield guess + _ASIDE * np.maximum(np.abs(guess), 1.0) * rng.standard_normal(len(guess))


def _size(g: Array) -> float:
    size = float(np.linalg.norm(g))
    return size if np.isfinite(size) else np.inf


def _dampings(least: float = _LEAST_DAMPING) -> Iterator[float]:
    damping = 1.0
    while damping >= least:
        yield damping
        damping *= 0.5 if damping > 1e-3 else 0.1


def _by_little_damping(equation: Equation, z: Array) -> Root:
    return _by_natural_test(equation, z, _MOST_STEPS_NEAR, _LEAST_DAMPING_NEAR)


def _by_natural_test(
    equation: Equation, z: Array, most: int = _MOST_STEPS, least: float = _LEAST_DAMPING
) -> Root:
    """Take Newton steps, each shortened until the next one with its matrix is shorter still."""
    g = equation.value(z)
    for _ in range(most):
        if not np.all(np.isfinite(g)):  # no step leads away
            break
        try:
            linear = equation.linearised(z)
        except np.linalg.LinAlgError:
            break
        step = -linear.solve(g)
        size = linear.share(step)
        if size <= ROUNDING and linear.is_met(g):
            return Root(z, g, True)
        weights = np.maximum(np.maximum(linear.scale, np.abs(step)), TINY)
        length = float(np.max(np.abs(step) / weights))
        found = None
        for damping in _dampings(least):
            trial = z + damping * step
            residual = equation.value(trial)
            after = float(np.max(np.abs(linear.solve(residual)) / weights))
            if after <= (1.0 - damping / 4.0) * length:
                found = trial, residual
                break
            if linear.is_stalled(z, step) and linear.is_met(g):
                return Root(z, g, True)
        if found is None:
            size = max(1.0, float(np.max(np.maximum(np.abs(z), linear.scale))))
            is_short = bool(np.all(np.abs(step) <= SMALL * size))
            return Root(z, g, is_short and is_rounding(equation, z, g, step))
        z, g = found
    return Root(z, g, False)


def _by_residual_test(equation: Equation, z: Array) -> Root:
    """Take Newton steps, each shortened until the residual, scaled row by row, is smaller."""
    g = equation.value(z)
    for _ in range(_MOST_STEPS):
        try:
            linear = equation.linearised(z)
        except np.linalg.LinAlgError:
            break
        step = -linear.solve(g)
        if linear.is_stalled(z, step):
            return _by_natural_test(equation, z)
        columns = np.maximum(np.maximum(linear.scale, np.abs(step)), TINY)
        rows = 1.0 / np.maximum(np.max(np.abs(equation.square(z) * columns), axis=1), TINY)
        before = float(np.linalg.norm(rows * g))
        for damping in _dampings():
            trial = z + damping * step
            residual = equation.value(trial)
            if float(np.linalg.norm(rows * residual)) <= (1.0 - 1e-4 * damping) * before:
                z, g = trial, residual
                break
        else:
            break
    return Root(z, g, False)


def _by_continuation(equation: Equation, z: Array) -> Root:
    """Follow the root of g(z) - (1 - l) g(z0) from l = 0 to 1."""
    first = equation.value(z)
    reached, advance = 0.0, 0.1
    for _ in range(_MOST_ADVANCES):
        if reached == 1.0 or advance < _LEAST_ADVANCE:
            break
        goal = min(1.0, reached + advance)

        def value(point: Array, rest: Array = (1.0 - goal) * first) -> Array:
            return equation.value(point) - rest

        step = _by_natural_test(Equation(value, equation.slope, equation.held), z, _CORRECTIONS)
        if step.is_found:
            z, reached, advance = step.z, goal, 2.0 * advance
        else:
            advance /= 2.0
    return Root(z, equation.value(z), reached == 1.0)


def _by_squares(equation: Equation, z: Array) -> Root:
    """Take steps of Levenberg and Marquardt; then Newton's from where they end."""
    n = len(z)
    g = equation.value(z)
    columns = np.maximum(np.abs(z), 1.0)
    trust = 1e-3
    for _ in range(_MOST_TRIALS):
        slope = equation.square(z) * columns
        rows = 1.0 / np.maximum(np.max(np.abs(slope), axis=1), TINY)
        matrix = np.vstack([rows[:, None] * slope, trust * np.eye(n)])
        target = np.concatenate([-rows * g, np.zeros(n)])
        if not np.all(np.isfinite(matrix)) or not np.all(np.isfinite(target)):
            break
        step = columns * np.linalg.lstsq(matrix, target, rcond=None)[0]
        trial = z + step
        residual = equation.value(trial)
        if float(np.linalg.norm(rows * residual)) < float(np.linalg.norm(rows * g)):
            is_small = bool(np.all(np.abs(step) <= SMALL * np.abs(z)))
            z, g, trust = trial, residual, trust / 4.0
            if is_small:
                break
        else:
            trust *= 4.0
            if trust > 1e12:
                break
    return _by_natural_test(equation, z)
