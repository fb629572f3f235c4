"""Roots of nonlinear equations g(z) = 0 from a poor guess: Newton's method from several sides.

In: g, its derivatives and a guess. Out: a ``Root``, found or not. What is tried, in this order, is
always the iteration of :mod:`cotree.model.damped_newton`:

1. With whole steps, then a little damped by the natural monotonicity test.
2. The same from a better guess, if :mod:`cotree.model.limited_newton` has one; then from the guess
   given, with more damping.
3. Damped so that the residual falls; g is scaled row by row.
4. Continuation: roots of g(z) - (1 - l) g(z0) for l from 0 to 1, with step control. Where all laws
   vanish at zero, g(0) is what sources and states give: from zero this is source stepping.

Then the same from zero and from points aside. See P. Deuflhard, Newton Methods for Nonlinear
Problems, Springer 2004, chapters 3 and 5.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from cotree.model.damped_newton import (
    Equation,
    NaturalTest,
    NewtonLimits,
    ResidualTest,
    Root,
    WholeSteps,
    iterate,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from cotree.model.arrays import Array
    from cotree.model.linear import Linear


# Far from the root of an exponential each step is one unit of its argument, and the argument may
# begin a hundred too high.
_MOST_STEPS, _LEAST_DAMPING = 200, 1e-25
_FAR = NewtonLimits(_MOST_STEPS, NaturalTest, _LEAST_DAMPING)
_FALLING = NewtonLimits(_MOST_STEPS, ResidualTest, _LEAST_DAMPING)

#: Next to a root whole steps get there, or there is another one nearer.
NEXT = NewtonLimits(20, WholeSteps)

#: Close to a root little damping is needed; where there is none, that should be found out soon.
NEAR = NewtonLimits(30, NaturalTest, 1.0 / 64.0)

#: Continuation: each root has to be found in few steps, or the advance is halved.
_CORRECTION = NewtonLimits(8, NaturalTest, _LEAST_DAMPING)
_LEAST_ADVANCE, _MOST_ADVANCES = 1e-6, 1000

#: How far aside, as a share of the guess or of 1, and how often, to look for a better start.
_ASIDE, _TRIES = 0.5, 3


def find_root(
    equation: Equation,
    guess: Array,
    improve: Callable[[], Array | None] = lambda: None,
    linear: Linear | None = None,
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
    linear : Linear, optional
        Linear equations of a point near the guess.

    Returns
    -------
    Root
        The first root found, or the point with the least residual in the units of g.
    """
    with np.errstate(all="ignore"):
        best = iterate(equation, guess, NEXT, linear)
        attempts = _attempts(guess, improve)
        while not best.is_found and (following := next(attempts, None)):
            attempt, start = following
            root = attempt(equation, start)
            if root.is_found or root.size < best.size:
                best = root
    return best


def find_near(equation: Equation, guess: Array) -> Root:
    """Look for a root near a guess, and near points aside from it, in few steps each.

    Equations may be more, or fewer, than unknowns; other parameters as of :func:`find_root`.
    """
    with np.errstate(all="ignore"):
        best = iterate(equation, guess, NEXT)
        for start in _starts(guess):
            if best.is_found:
                break
            root = _near(equation, start)
            if root.is_found or root.size < best.size:
                best = root
    return best


def _attempts(
    guess: Array, improve: Callable[[], Array | None]
) -> Iterator[tuple[Callable[[Equation, Array], Root], Array]]:
    yield _near, guess
    better = improve()
    if better is not None:
        yield _far, better
    for start in _starts(guess):
        for attempt in (_far, _falling, _continued):
            yield attempt, start


def _starts(guess: Array) -> Iterator[Array]:
    yield guess
    # Laws of networks mostly vanish at zero, where nothing overflows.
    if np.any(guess):
        yield np.zeros_like(guess)
    rng = np.random.default_rng(0)
    for _ in range(_TRIES):
        yield guess + _ASIDE * np.maximum(np.abs(guess), 1.0) * rng.standard_normal(len(guess))


def _near(equation: Equation, z: Array) -> Root:
    return iterate(equation, z, NEAR)


def _far(equation: Equation, z: Array) -> Root:
    return iterate(equation, z, _FAR)


def _falling(equation: Equation, z: Array) -> Root:
    """Let the residual fall as far as it goes, and end by the natural test."""
    root = iterate(equation, z, _FALLING)
    return iterate(equation, root.z, _FAR) if root.is_found else root


def _continued(equation: Equation, z: Array) -> Root:
    """Follow the root of g(z) - (1 - l) g(z0) from l = 0 to 1."""
    first, cut = equation.value(z), equation.n_carried
    # What is carried along is no residual and keeps its values.
    first[:cut] = 0.0
    reached, advance = 0.0, 0.1
    for _ in range(_MOST_ADVANCES):
        if reached == 1.0 or advance < _LEAST_ADVANCE:
            break
        goal = min(1.0, reached + advance)

        def value(point: Array, rest: Array = (1.0 - goal) * first) -> Array:
            return equation.value(point) - rest

        root = iterate(Equation(value, equation.slope, equation.held, cut), z, _CORRECTION)
        if root.is_found:
            # The next correction begins at this root, which is a constant predictor.
            z, reached, advance = root.z, goal, 2.0 * advance
        else:
            advance /= 2.0
    return root._replace(z=z, values=equation.value(z), is_found=reached == 1.0)
