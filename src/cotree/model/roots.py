"""Roots of nonlinear equations g(z) = 0: a damped Newton iteration, and searches that use it.

One of these tests decides whether a step is accepted:

- natural monotonicity: a step computed with the same matrix at the new point must be shorter. This
  does not depend on the units of the residuals. Fast convergence permits reuse of this step;
- residual: the norm of the row-scaled residual must decrease;
- whole steps: every step is accepted; matrices are reused as with natural monotonicity;
- none: every step is accepted, and each point has a new matrix; only the equations limit steps.

An iteration has converged if a step is a rounding error, or if it is small and no longer shrinks.
See P. Deuflhard, Newton Methods for Nonlinear Problems, Springer 2004, chapters 2 and 3.

Searches from a poor guess use the same iteration, in this order:

1. With whole steps, then slightly damped by natural monotonicity.
2. With stronger damping by natural monotonicity, from a better guess by :class:`Junctions`, if
   there is one, then from the caller's guess.
3. Damped by the residual test.
4. By continuation: roots of g(z) - (1 - l) g(z0) for l from 0 to 1, with step control. If all
   terminal equations vanish at zero, g(0) contains only sources and states, so continuation from
   z0 = 0 is source stepping.

Methods 2 to 4 are repeated from zero and from random points near the guess. See chapters 3 and 5 of
the book.

:class:`Junctions` computes its guess from equations in which exponents are additional unknowns:

1. A step that raises an exponent by more than a few units is limited such that the exponential
   grows by the amount that its tangent predicts, as in SPICE (pnjlim).
2. If the iteration does not converge, exp(w) is replaced by exp(w) + c w, a conductance in parallel
   with each junction, and c is reduced step by step.

See J. Albersmeyer and M. Diehl, The lifted Newton method, SIAM J. Optim. 20 (2010), and L. W.
Nagel, SPICE2, Berkeley 1975.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple, Protocol

import numpy as np

from cotree.dag.derivative import tangents_along
from cotree.dag.evaluate import evaluate
from cotree.dag.nodes import PIECE, Node, dependent, reachable
from cotree.model.arrays import are_finite
from cotree.model.linear import ROUNDING, SMALL, Linear, Matrix, linearise, longest, solve_entries
from cotree.tolerances import TINY

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from cotree.model.arrays import Array
    from cotree.program.program import Program


#: Maximum number of further steps with a reused matrix; a new one squares the error per step.
_FEW = 3

#: Minimum decrease of the residual, as a fraction of the linear prediction (Armijo's rule).
_ARMIJO = 1e-4

#: Test for rounding errors of residuals: number of neighbouring points, and of their distances.
_NEIGHBOURS, _DISTANCES = 8, 5


class Residuals(Protocol):
    """Equations solved by :func:`iterate`."""

    n_carried: int  # number of leading values that are not residuals

    def value(self, z: Array) -> Array:
        """Return the values at a point as a new array, (n_carried + n,); they may be infinite."""
        ...

    def linearised(self, z: Array) -> Linear:
        """Return the Newton equations at the last evaluated point, or raise LinAlgError."""
        ...

    def moved(self, z: Array, step: Array) -> Array:
        """Return the point after a step, which the equations may shorten."""
        ...


class Equation:
    """Equations in n unknowns with their derivatives.

    ``value(z)`` returns a new array, shape (n_carried + n,). ``slope(z)`` returns the derivatives
    with respect to the constants ``held``, (m,), then to the unknowns, as a full or CSR matrix,
    (n, m + n). Terms with constants contribute to the summed magnitudes of terms.
    """

    def __init__(
        self,
        value: Callable[[Array], Array],
        slope: Callable[[Array], Matrix],
        held: Array,
        n_carried: int = 0,
    ) -> None:
        self.value = value
        self.slope = slope
        self.held = held
        self.n_carried = n_carried

    def linearised(self, z: Array) -> Linear:
        """Return the linear equations of a Newton step; see :class:`Residuals`."""
        return linearise(self.slope(z), np.concatenate([self.held, z]))

    def moved(self, z: Array, step: Array) -> Array:
        """Return the point after a full step."""
        return z + step

    def by_unknowns(self, z: Array) -> Matrix:
        """Return the derivatives with respect to the unknowns."""
        return self.slope(z)[:, -len(z) :]

    def square(self, z: Array) -> Array:
        """Return the derivatives with respect to the unknowns as a full matrix."""
        slope = self.by_unknowns(z)
        return slope if isinstance(slope, np.ndarray) else np.asarray(slope.toarray())


class Root(NamedTuple):
    """Result of an iteration: a root or, if none was found, the last or the best point."""

    z: Array  # unknowns at the point
    values: Array  # values of the equations at the point
    is_found: bool  # whether the point is a root up to rounding
    linear: Linear | None = None  # last linear equations solved, at this point or nearby
    n_carried: int = 0  # number of leading values that are not residuals

    @property
    def g(self) -> Array:
        """The residual, shape (n,)."""
        return self.values[self.n_carried :]

    @property
    def size(self) -> float:
        """The Euclidean norm of the residual; infinity if it is not finite."""
        size = math.sqrt(self.g.dot(self.g))
        return size if math.isfinite(size) else math.inf


class _Following(NamedTuple):
    """Matrix and step for reuse in the next iteration; None if it must compute them."""

    linear: Linear | None = None
    step: Array | None = None


_REFACTOR = _Following()


class NaturalTest:
    """Test that accepts a step if the next one is shorter by the fraction ``share`` * damping."""

    share = 0.25  # as recommended by Deuflhard

    def __init__(
        self, equation: Equation, point: Root, linear: Linear, units: Array, length: float
    ) -> None:
        self._linear = linear
        self._units = units
        self._before = max(length, TINY)

    def following(self, g: Array, damping: float) -> _Following | None:
        """If the step is accepted, return the matrix and the step for reuse, else None."""
        step = -self._linear.solve(g)
        after = longest(step / self._units)
        if not after <= (1.0 - self.share * damping) * self._before:
            return None
        ratio = after / self._before  # expected contraction of the next steps
        # Reuse the matrix if a few more steps with it would reach rounding level.
        is_fast = damping == 1.0 and after * min(ratio, 1.0) ** _FEW <= ROUNDING
        return _Following(self._linear, step) if is_fast else _REFACTOR


class WholeSteps(NaturalTest):
    """Test that accepts every step and reuses matrices that converge fast."""

    share = -math.inf


class ResidualTest:
    """Test that accepts a step if the row-scaled residual decreases."""

    def __init__(
        self, equation: Equation, point: Root, linear: Linear, units: Array, length: float
    ) -> None:
        # Divide each row by its largest change per unit of any unknown.
        largest = np.max(np.abs(equation.square(point.z) * units), axis=1)
        self._weights = 1.0 / np.maximum(largest, TINY)
        self._before = float(np.linalg.norm(self._weights * point.g))

    def following(self, g: Array, damping: float) -> _Following | None:
        """Return ``_REFACTOR`` if the step is accepted, else None."""
        after = float(np.linalg.norm(self._weights * g))
        return _REFACTOR if after <= (1.0 - _ARMIJO * damping) * self._before else None


@dataclass(frozen=True)
class NewtonLimits:
    """Settings of an iteration: number of steps, test, damping and convergence."""

    most_steps: int  # maximum number of steps
    #: Test that accepts or rejects a step; None accepts all full steps.
    test: type[NaturalTest] | type[ResidualTest] | None = None
    least_damping: float = 1.0  # smallest damping factor
    #: A step below this relative size ends the iteration; with a test, the predicted next step.
    settled: float = ROUNDING


def iterate(
    equations: Residuals, z: Array, limits: NewtonLimits, linear: Linear | None = None
) -> Root:
    """Take Newton steps until a step is a rounding error.

    ``linear`` contains the linear equations of a nearby point, reused while convergence is fast.
    Return the root or, if no step is accepted, a matrix is singular or the maximum number of steps
    is reached, the point with the least residual. Limits with a test require an :class:`Equation`.
    """
    point = best = _at(equations, z)
    least = best.size
    kept, step = _Following(linear), None
    for _ in range(limits.most_steps):
        if not are_finite(point.g):
            break
        is_old, before = kept.linear is not None, step
        try:
            linear = kept.linear or equations.linearised(point.z)
            step = -linear.solve(point.g) if kept.step is None else kept.step
        # A singular matrix defines no step; the caller may start from another point.
        except np.linalg.LinAlgError:
            break
        units, length = linear.measured(step)
        size = length
        ratio = math.inf
        if before is not None:
            # Both steps are measured in the scales of the newer step.
            ratio = size / max(longest(before / units), TINY)
        if limits.test is not None:  # the next step is assumed to contract equally
            size *= min(ratio, 1.0)
        # With a reused matrix the limit is stricter, because errors accumulate over steps.
        allowed = limits.settled if kept.step is None else 0.25 * limits.settled
        if size <= allowed and linear.is_met(point.g):
            # After the last step, the residuals must also be rounding errors.
            last = _at(equations, equations.moved(point.z, step))
            if linear.is_met(last.g):
                return last._replace(is_found=True, linear=linear)
        if limits.test is None:
            point, kept = _at(equations, equations.moved(point.z, step)), _REFACTOR
            if point.size < least:
                best, least = point, point.size
            continue
        assert isinstance(equations, Equation)
        test = limits.test(equations, point, linear, units, length)
        found = _damped(equations, point, limits.least_damping, test, linear, step, is_old=is_old)
        if found is not None:
            point, kept = found
            best = point  # tests accept only points that are better than the previous one
        elif is_old:
            # The matrix belongs to an earlier point: repeat the step with a new one.
            kept = _REFACTOR
        else:
            # Without damping, only infinite residuals reject a step: the point may not be a root.
            is_found = limits.least_damping < 1.0 and _is_last(equations, point, linear, step)
            return point._replace(is_found=True, linear=linear) if is_found else best
    return best


def _at(equations: Residuals, z: Array) -> Root:
    return Root(z, equations.value(z), False, n_carried=equations.n_carried)


def _damped(
    equation: Equation,
    point: Root,
    least: float,
    test: NaturalTest | ResidualTest,
    linear: Linear,
    step: Array,
    *,
    is_old: bool,
) -> tuple[Root, _Following] | None:
    """Take the largest accepted fraction of a step, at least ``least``, or return None."""
    damping = 1.0
    while damping >= least:
        trial = _at(equation, equation.moved(point.z, damping * step))
        following = test.following(trial.g, damping)
        if following is not None:
            return trial, following
        if is_old or _is_stalled(point, linear, step):
            break
        # Exponentials may need damping factors of 1e-20, which repeated halving would reach slowly.
        damping *= 0.5 if damping > 1e-3 else 0.1
    return None


def _is_stalled(point: Root, linear: Linear, step: Array) -> bool:
    """Return whether a rejected step is at rounding level."""
    return linear.is_stalled(point.z, step) and linear.is_met(point.g)


def _is_last(equations: Residuals, point: Root, linear: Linear, step: Array) -> bool:
    """Return whether a point from which no step is accepted is a root up to rounding."""
    if _is_stalled(point, linear, step):
        return True
    size = max(1.0, float(np.max(np.maximum(np.abs(point.z), linear.scale))))
    is_short = bool(np.all(np.abs(step) <= SMALL * size))
    return is_short and isinstance(equations, Equation) and _is_rounding(equations, point, step)


def _is_rounding(equation: Equation, point: Root, step: Array) -> bool:
    """Return whether a residual consists of rounding errors inside the terminal equations.

    Slopes and magnitudes of terms do not reveal cancellation inside an equation, such as a
    difference of squares. If cancellation dominates, values near z deviate from the tangent by
    similar amounts at one distance and at four times that distance. The deviation of a curve would
    grow by a factor of 16, and at a kink by 4.
    """
    z, g, cut = point.z, point.g, equation.n_carried
    slope, reach = equation.square(z).copy(), np.maximum(np.abs(step), ROUNDING * np.abs(z))
    aside = reach * np.random.default_rng(0).uniform(-1.0, 1.0, (_NEIGHBOURS, len(z)))
    away = np.array(
        [
            np.max(
                [np.abs(equation.value(z + a)[cut:] - g - slope @ a) for a in 4.0**k * aside],
                axis=0,
            )
            for k in range(_DISTANCES)
        ]
    )
    is_flat = (away[1:] <= 2.0 * away[:-1]) & (np.abs(g) <= 2.0 * away[:-1])
    # The comparison is inconclusive if neighbouring values overflow.
    is_flat &= np.isfinite(away[:-1])
    return bool(np.all(is_flat.any(axis=0) | (g == 0.0)))


# Limits of searches from a poor guess. Far from the root of an exponential, a step changes the
# exponent by one, and the initial exponent may be too large by a hundred.
_MOST_STEPS, _LEAST_DAMPING = 200, 1e-25
_FAR = NewtonLimits(_MOST_STEPS, NaturalTest, _LEAST_DAMPING)
_FALLING = NewtonLimits(_MOST_STEPS, ResidualTest, _LEAST_DAMPING)

#: Limits of an iteration that continues from a previous root: full steps only.
NEXT = NewtonLimits(20, WholeSteps)

#: Limits of a search near the guess: little damping and few steps.
NEAR = NewtonLimits(30, NaturalTest, 1.0 / 64.0)

#: Continuation: limits of the corrector, smallest advance, and maximum number of advances.
_CORRECTION = NewtonLimits(8, NaturalTest, _LEAST_DAMPING)
_LEAST_ADVANCE, _MOST_ADVANCES = 1e-6, 1000

#: Distance of random initial points, relative to max(guess, 1), and their number.
_ASIDE, _TRIES = 0.5, 3


def find_root(
    equation: Equation,
    guess: Array,
    improve: Callable[[], Array | None] = lambda: None,
    linear: Linear | None = None,
) -> Root:
    """Return the first root found, or else the point with the least residual in the units of g.

    Outside their domain, equations may return infinity or nan. If Newton's method fails from
    ``guess``, ``improve`` returns a better guess, or None. ``linear`` contains the linear equations
    of a nearby point.
    """
    return _best(_searches(equation, guess, improve, linear))


def find_near(equation: Equation, guess: Array) -> Root:
    """Search briefly from a guess, zero and points nearby; the system may be rectangular."""
    starts = [(guess, NEXT), *((start, NEAR) for start in _starts(guess))]
    return _best(iterate(equation, start, limits) for start, limits in starts)


def _best(searches: Iterator[Root]) -> Root:
    """Return the first root found, or else the point with the least residual."""
    with np.errstate(all="ignore"):
        best = next(searches)
        while not best.is_found and (root := next(searches, None)):
            if root.is_found or root.size < best.size:
                best = root
    return best


def _searches(
    equation: Equation, guess: Array, improve: Callable[[], Array | None], linear: Linear | None
) -> Iterator[Root]:
    """Search for a root from the guess, a better guess, zero and points nearby."""
    yield iterate(equation, guess, NEXT, linear)
    yield iterate(equation, guess, NEAR)
    better = improve()
    if better is not None:
        yield iterate(equation, better, _FAR)
    for start in _starts(guess):
        yield iterate(equation, start, _FAR)
        yield _falling(equation, start)
        yield _continued(equation, start)


def _starts(guess: Array) -> Iterator[Array]:
    yield guess
    # Network equations usually vanish at zero and do not overflow there.
    if np.any(guess):
        yield np.zeros_like(guess)
    rng = np.random.default_rng(0)
    for _ in range(_TRIES):
        yield guess + _ASIDE * np.maximum(np.abs(guess), 1.0) * rng.standard_normal(len(guess))


def _falling(equation: Equation, z: Array) -> Root:
    """Iterate with the residual test, then with natural monotonicity."""
    root = iterate(equation, z, _FALLING)
    return iterate(equation, root.z, _FAR) if root.is_found else root


def _continued(equation: Equation, z: Array) -> Root:
    """Follow the root of g(z) - (1 - l) g(z0) from l = 0 to 1."""
    first, cut = equation.value(z), equation.n_carried
    # Leading values that are not residuals are not shifted.
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
            # The next correction starts from this root (constant predictor).
            z, reached, advance = root.z, goal, 2.0 * advance
        else:
            advance /= 2.0
    return root._replace(z=z, values=equation.value(z), is_found=reached == 1.0)


#: Largest rise of an exponent in one step without limiting; largest exponent taken from a guess.
_FREE, _FAR_OF_JUNCTIONS = 2.0, 40.0

#: Maximum number of limited steps; number of junctions per additional step, because changes
#: propagate along chains of junctions; relative step size that ends the search.
_MOST_LIMITED_STEPS, _JUNCTIONS_A_STEP, _SETTLED = 100, 4, 1e-9

#: Largest and smallest conductance in parallel with a junction, in units of saturation current over
#: thermal voltage. At 1e-15 A the largest equals a wire; the smallest is negligible.
_LARGEST, _LEAST = 1e15, 1e-3
#: Smallest, initial and largest factor by which the conductance is divided in one reduction.
_FACTORS = (1.05, 10.0, 1e3)


@dataclass(frozen=True, eq=False)
class Junctions:
    """Algebraic equations of a program as functions of unknowns and exponentials."""

    equations: tuple[Node, ...]  # residuals g
    unknowns: tuple[Node, ...]  # symbols of the unknowns z
    exponentials: tuple[Node, ...]  # exponentials that depend on z
    #: Derivatives of equations and exponents with respect to z, then to each exponential.
    slopes: tuple[dict[int, Node], ...]

    @classmethod
    def of(cls, program: Program) -> Junctions:
        """Differentiate the algebraic equations with respect to unknowns and exponentials."""
        dag, layout = program.dag, program.layout
        n, cut = len(layout.states), len(layout.states) - layout.n_algebraic
        # Algebraic equations are the last rows; their unknowns are the last states.
        equations = program.kernels["rhs"].results[cut:]
        unknowns = tuple(dag.symbol("x", i) for i in range(cut, n))
        order = reachable(equations)
        moving = dependent(order, unknowns)
        exponentials = tuple(node for node in order if node.op == "exp" and node in moving)
        if not exponentials:
            return cls(equations, unknowns, (), ())
        roots = [*equations, *(node.args[0] for node in exponentials)]
        # Exponentials count as variables, so derivatives with respect to z omit paths through them.
        seeds = [{symbol: dag.one} for symbol in (*unknowns, *exponentials)]
        return cls(equations, unknowns, exponentials, tuple(tangents_along(roots, seeds)))

    def at(self, t: float, y: Array, p: Array, u: Array) -> FrozenSystem:
        """Return the equations for fixed time, states, parameters and inputs."""
        return FrozenSystem(self, t, y, p, u)


class FrozenSystem:
    """The equations of :class:`Junctions` for fixed time, states, parameters and inputs."""

    n_carried = 0

    def __init__(self, junctions: Junctions, t: float, y: Array, p: Array, u: Array) -> None:
        self._n = len(junctions.unknowns)
        self._free = (*junctions.unknowns, *junctions.exponentials)
        exponents = [node.args[0] for node in junctions.exponentials]
        entries = [(i, j, d) for i, row in enumerate(junctions.slopes) for j, d in row.items()]
        self._rows, self._columns = (np.array([e[k] for e in entries], dtype=int) for k in (0, 1))
        roots = [*junctions.equations, *exponents, *(d for _, _, d in entries)]
        known: dict[str, Array] = {"t": np.array([t]), "x": y, "p": p, "u": u}
        order = reachable(roots, stop=set(self._free))
        values = {
            node: float(known[node.data[0]][node.data[1]])
            for node in order
            if node.op == "symbol" and node not in self._free and node.data[0] != PIECE
        }
        moving = dependent(order, self._free)
        # Nodes that do not depend on unknowns are evaluated only once.
        edge = {a for node in order if node in moving for a in node.args if a not in moving}
        fixed = list(edge.union(roots) - moving)
        self._values = values | dict(zip(fixed, evaluate(fixed, values), strict=True))
        # Evaluations overwrite only the entries in `_places`.
        self._results = np.array([self._values.get(node, 0.0) for node in roots])
        self._places = [i for i, node in enumerate(roots) if node in moving]
        self._roots = [roots[i] for i in self._places]
        self._order = reachable(self._roots, stop={*self._free, *self._values})
        self._conductance, self._entries = 0.0, np.zeros(0)

    def search(self, z: Array) -> Array | None:
        """Search for a root; return a point close to it, or None."""
        m = len(self._free) - self._n
        if not m:
            return None
        exponents = self._evaluate(z, np.ones(m))[0][self._n :]
        # Exponents that are huge at the guess start at zero, as for zero voltage.
        w = np.where(np.abs(exponents) < _FAR_OF_JUNCTIONS, exponents, 0.0)
        found = self._iterate(z, w, 0.0)
        return self._lower(z, np.zeros(m)) if found is None else found[0]

    def _lower(self, z: Array, w: Array) -> Array | None:
        """Reduce the conductance in parallel with all junctions to zero, step by step."""
        conductance, (least, factor, most) = _LARGEST, _FACTORS
        while conductance > 0.0:
            lower = conductance / factor if conductance > _LEAST else 0.0
            found = self._iterate(z, w, lower)
            if found is not None:
                # A success squares the factor; a failure replaces it by its square root.
                (z, w), conductance, factor = found, lower, min(factor**2, most)
            elif factor < least:
                return None
            else:
                factor **= 0.5
        return z

    def _iterate(self, z: Array, w: Array, conductance: float) -> tuple[Array, Array] | None:
        """Take Newton steps in unknowns and limited exponents; return None if they diverge."""
        self._conductance = conductance
        limits = NewtonLimits(_MOST_LIMITED_STEPS + len(w) // _JUNCTIONS_A_STEP, settled=_SETTLED)
        root = iterate(self, np.concatenate([z, w]), limits)
        return (root.z[: self._n], root.z[self._n :]) if root.is_found else None

    def value(self, z: Array) -> Array:
        """Return the residuals: g of the equations, then a - w of the exponents."""
        unknowns, w = np.split(z, [self._n])
        # Residuals: g(z, e) and a(z, e) - w with e = exp(w) + c w; d/dw = (exp(w) + c) d/de.
        slope = np.exp(w) + self._conductance
        values, entries = self._evaluate(unknowns, np.exp(w) + self._conductance * w)
        values[self._n :] -= w
        along = np.concatenate([np.ones(self._n), slope])[self._columns]
        self._entries = np.append(entries * along, np.full(len(w), -1.0))
        return values

    def linearised(self, z: Array) -> Linear:
        """Return the linear equations at the last evaluated point."""
        own, entries = np.arange(self._n, len(z)), self._entries
        rows, columns = np.append(self._rows, own), np.append(self._columns, own)
        scale = np.maximum(1.0, np.abs(z))
        return Linear(lambda g: solve_entries(rows, columns, entries, g), scale)

    def moved(self, z: Array, step: Array) -> Array:
        """Return the point after a step in which the growth of exponents is limited."""
        wanted, own = z + step, slice(self._n, None)
        base = np.maximum(z[own], 0.0)
        rise = np.maximum(wanted[own] - base, 0.0)
        # The tangent predicts exp(w) (1 + rise) = exp(w + log(1 + rise)).
        wanted[own] = np.where(rise > _FREE, base + np.log1p(rise), wanted[own])
        return wanted

    def _evaluate(self, z: Array, e: Array) -> tuple[Array, Array]:
        """Return the values of equations and exponents, and the entries of their derivatives."""
        size = len(z) + len(e)
        values = self._values | dict(zip(self._free, [*z.tolist(), *e.tolist()], strict=True))
        results = self._results.copy()
        results[self._places] = evaluate(self._roots, values, order=self._order)
        return results[:size], results[size:]
