"""Algebraic unknowns as functions of time and states: z(t, x) with 0 = g(t, x, z)."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from cotree.errors import SingularSystemError, SolveError, UnsolvedError
from cotree.model.arrays import Array
from cotree.model.linear import Linear, Matrix, linearise, singular_direction
from cotree.model.roots import NEXT, Equation, Root, find_root, iterate

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence


#: ``rates(t, y)`` and ``jacobian(t, y)``; both may return the same buffer in every call.
Rates = Callable[[float, Array], Array]
Jacobian = Callable[[float, Array], Matrix]


class Algebraic:
    """Newton solver for the algebraic unknowns, which reuses its last factorised Jacobian.

    ``rates(t, y)`` returns x', then g. ``jacobian(t, y)`` returns their derivatives with respect to
    y as a full or CSR matrix. The last ``n_algebraic`` entries of y are the unknowns. If the
    iteration fails, ``improve(t, y)`` returns a better initial guess, or None.
    """

    def __init__(
        self,
        rates: Rates,
        jacobian: Jacobian,
        names: Sequence[str],
        n_algebraic: int,
        improve: Callable[[float, Array], Array | None] = lambda t, y: None,
    ) -> None:
        self.cut = len(names) - n_algebraic
        self._rates = rates
        self._jacobian = jacobian
        self._names = names
        self._improve = improve
        self._linear: Linear | None = None

    def follow(self, t: float, y: Array) -> Array:
        """Solve for the algebraic unknowns in place from a close guess, and return the rates."""
        # Exponentials may overflow. Before NumPy 2, errstate as a decorator affects all threads.
        with np.errstate(all="ignore"):
            root = iterate(self._equation(t, y), y[self.cut :], NEXT, self._linear)
        return self._accept(t, y, root)

    def solve(self, t: float, y: Array) -> Array:
        """Solve for z in place; return the rates, or raise SolveError or SingularSystemError."""
        guess = y.copy()
        equation = self._equation(t, y)
        root = find_root(equation, guess[self.cut :], lambda: self._improve(t, guess), self._linear)
        try:
            return self._accept(t, y, root)
        except UnsolvedError as error:
            with np.errstate(all="ignore"):
                # A Jacobian may be singular at one point by chance, but not at several points.
                points = (root.z, guess[self.cut :], *_nearby_points(root.z))
                self._check_index(equation.by_unknowns(z) for z in points)
                if not np.any(root.g):  # the Jacobian is singular at a double root
                    self._check_index([equation.by_unknowns(root.z)])
            raise SolveError(str(error)) from None

    def _accept(self, t: float, y: Array, root: Root) -> Array:
        """Store the unknowns of a root in y, keep its Jacobian, and return its rates."""
        y[self.cut :] = root.z
        # The next point reuses the Jacobian of a root; after a failed search it is discarded.
        self._linear = root.linear if root.is_found else None
        if not root.is_found:
            raise UnsolvedError(self._failure_message(t, root.g))
        return root.values

    def check_index(self, t: float, y: Array) -> None:
        """Raise SingularSystemError if the equations leave unknowns undetermined near a solution.

        A single point with a regular Jacobian suffices. At the solution itself, the Jacobian may be
        numerically singular if its entries differ by many orders of magnitude, as with junctions
        that hardly conduct.
        """
        with np.errstate(all="ignore"):
            z = y[self.cut :].copy()
            slope = self._equation(t, y).by_unknowns
            self._check_index(slope(point) for point in (z, *_nearby_points(z)))

    def _equation(self, t: float, point: Array) -> Equation:
        # All evaluations share one buffer, in which only the unknowns, the last entries, change.
        point = point.copy()

        def at(z: Array) -> Array:
            point[self.cut :] = z
            return point

        return Equation(
            lambda z: np.array(self._rates(t, at(z))),
            # The last columns of these rows belong to the unknowns.
            lambda z: self._jacobian(t, at(z))[self.cut :],
            point[: self.cut],
            self.cut,
        )

    def linearised(self, t: float, y: Array) -> tuple[Matrix, Linear]:
        """Return the Jacobian at a solution, a shared buffer, and the factors of its last block."""
        matrix = self._jacobian(t, y)
        try:
            linear = linearise(matrix[self.cut :], y)
        except np.linalg.LinAlgError:
            self._linear = None
            raise UnsolvedError(
                f"the derivatives of the algebraic equations with respect to {self._listed()} are "
                f"singular or not finite at t = {float(t):.10g}"
            ) from None
        self._linear = linear
        return matrix, linear

    def reduced(self, t: float, y: Array) -> Array:
        """Return dx'/dx with the algebraic unknowns eliminated, shape (n_x, n_x)."""
        matrix, linear = self.linearised(t, y)
        return eliminated(matrix, linear.solve, self.cut)

    def residual(self, t: float, y: Array) -> Array:
        """Return the residuals of the algebraic equations at a point as a new array."""
        return np.array(self._rates(t, y)[self.cut :])

    def _check_index(self, slopes: Iterable[Matrix]) -> None:
        """Raise SingularSystemError if every matrix leaves unknowns undetermined."""
        involved = singular_direction(slopes)
        if involved:
            names = ", ".join(f"'{self._names[self.cut + i]}'" for i in involved)
            raise SingularSystemError(
                f"the algebraic equations do not determine {names}: the Jacobian with respect to "
                "these is singular, so the system has an index higher than 1 or leaves them "
                "free; look for values that are prescribed twice or not at all"
            )

    def _listed(self) -> str:
        names = [f"'{name}'" for name in self._names[self.cut :]]
        return ", ".join(names[:6]) + (", ..." if len(names) > 6 else "")

    def _failure_message(self, t: float, g: Array) -> str:
        # A residual of nan counts as infinite.
        order = np.argsort(-np.nan_to_num(np.abs(g), nan=np.inf), kind="stable")
        worst = int(order[0])
        return (
            f"the algebraic equations cannot be solved at t = {float(t):.10g}: the residual of "
            f"'{self._names[self.cut + worst]}' stays {g[worst]:.3g}; give initial values nearer "
            "to a solution, or check that there is one"
        )


def _nearby_points(z: Array) -> tuple[Array, Array]:
    """Return two random points near z; every call returns the same points."""
    rng = np.random.default_rng(0)
    away = np.maximum(1.0, np.abs(z)) * np.abs(rng.standard_normal(len(z)))
    return z + away, z - away


def eliminated(matrix: Matrix, solve: Callable[[Array], Array], cut: int) -> Array:
    """Return the Schur complement, (cut, m), of the last block, (n, n), solved by ``solve``."""
    full: Array = matrix if isinstance(matrix, np.ndarray) else matrix.toarray()
    n = len(full) - cut
    # A - B D^-1 C with the last diagonal block D
    return np.asarray(full[:cut, :-n] - full[:cut, -n:] @ solve(full[cut:, :-n]))
