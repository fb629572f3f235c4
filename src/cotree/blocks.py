"""Linear systems of signals as scenes, to be added to others as parts.

States are the voltages of 1 F capacitors, charged by current sources, as in an analogue computer.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from cotree.api import Scene
from cotree.errors import SceneError

if TYPE_CHECKING:
    import numpy.typing as npt


def state_space(
    A: npt.ArrayLike,
    B: npt.ArrayLike,
    C: npt.ArrayLike,
    D: npt.ArrayLike | None = None,
    *,
    name: str = "state-space",
) -> Scene:
    """Make a part for scenes from the linear system x' = A x + B u, y = C x + D u.

    Its inputs are ``u``, or ``u1``, ``u2``, ... if there are several; outputs likewise ``y``.
    States are called ``x1.v``, ``x2.v``, ... and start at zero. Nonzero entries are parameters:
    ``a1_2`` is the entry in row 1 and column 2 of A.

    Parameters
    ----------
    A, B, C : array_like, shapes (n, n), (n, m) and (k, n)
        The matrices; a single column of B and a single row of C may be lists of n numbers.
    D : array_like, shape (k, m), optional
        The feedthrough matrix; by default zero.

    Raises
    ------
    SceneError
        If an entry is not a finite number, or shapes do not match.

    Examples
    --------
    >>> scene = Scene("loop")
    >>> scene.add("filter", state_space([[-2.0]], [2.0], [1.0]), u="sin(t)")
    >>> scene.compile(["filter.a1_1"]).states
    ('filter.x1.v',)
    """
    a = _matrix(A, "A")
    n = len(a)
    b, c = _matrix(B, "B", column=True), _matrix(C, "C")
    d = np.zeros((len(c), b.shape[1])) if D is None else _matrix(D, "D")
    for what, found, wanted in (
        ("A", a.shape, (n, n)),
        ("B", b.shape, (n, b.shape[1])),
        ("C", c.shape, (len(c), n)),
        ("D", d.shape, (len(c), b.shape[1])),
    ):
        if found != wanted:
            raise SceneError(f"{what} has the shape {found}, but must have {wanted}")
    scene = Scene(name)
    inputs = _names("u", b.shape[1])
    states = [f"x{i}.v" for i in range(1, n + 1)]
    rows = {key: _rows(scene, key, m) for key, m in {"a": a, "b": b, "c": c, "d": d}.items()}
    for signal in inputs:
        scene.input(signal, 0.0)
    for i in range(n):
        rate = _sum(rows["a"][i], states) + _sum(rows["b"][i], inputs)
        _integrate(scene, i + 1, " + ".join(rate) or 0.0)
    for i, output in enumerate(_names("y", len(c))):
        terms = _sum(rows["c"][i], states) + _sum(rows["d"][i], inputs)
        scene.output(output, " + ".join(terms) or 0.0)
    return scene


def transfer_function(
    numerator: npt.ArrayLike, denominator: npt.ArrayLike, *, name: str = "transfer-function"
) -> Scene:
    """Make a part for scenes from the transfer function y = N(s)/D(s) u.

    Coefficients are parameters: ``b2``, ``b1``, ``b0`` of the numerator and ``a2``, ``a1``, ``a0``
    of the denominator, numbered by the power of s; zero ones of the numerator are left out. States
    start at zero.

    Parameters
    ----------
    numerator, denominator : array_like, shape (m,) and (n,)
        Coefficients, the highest power of s first. The numerator must not have the higher order.

    Raises
    ------
    SceneError
        If a coefficient is not a finite number, the first one of the denominator is zero, or the
        numerator has the higher order.

    Examples
    --------
    >>> scene = Scene("scene")
    >>> scene.add("G", transfer_function([3.0], [1.0, 0.5, 9.0]), u=1.0)
    >>> scene.compile(["G.a0"]).parameters
    ('G.b0', 'G.a2', 'G.a1', 'G.a0')
    """
    b = np.trim_zeros(_matrix(numerator, "the numerator").ravel(), "f")
    a = _matrix(denominator, "the denominator").ravel()
    n = len(a) - 1
    if n < 0 or a[0] == 0.0:
        raise SceneError("the denominator begins with zero: give the highest power of s first")
    if len(b) > len(a):
        raise SceneError(
            f"the numerator has order {len(b) - 1}, higher than the order {n} of the denominator: "
            "divide by a filter of sufficient order, such as 1 + T s"
        )
    scene = Scene(name)
    scene.input("u", 0.0)
    powers = dict(zip(range(len(b) - 1, -1, -1), b.tolist(), strict=True))
    used = [i for i, value in powers.items() if value != 0.0]
    for i in used:
        scene.parameter(f"b{i}", powers[i])
    for i, value in zip(range(n, -1, -1), a.tolist(), strict=True):
        scene.parameter(f"a{i}", value)
    # Controllable canonical form: x_i' = x_(i+1); the denominator determines the last rate w.
    back = " - ".join(["u", *(f"a{i}*x{i + 1}.v" for i in range(n))])
    scene.output("highest", f"({back})/a{n}")
    for i in range(1, n + 1):
        _integrate(scene, i, "highest" if i == n else f"x{i + 1}.v")
    terms = [f"b{i}*highest" if i == n else f"b{i}*x{i + 1}.v" for i in used]
    scene.output("y", " + ".join(terms) or 0.0)
    return scene


def _integrate(scene: Scene, i: int, rate: str | float) -> None:
    """Add a state that is the integral of an expression."""
    scene.edge(f"x{i}", "capacitor", f"n{i}", "ground", capacitance=1.0)
    scene.edge(f"rate{i}", "current_source", "ground", f"n{i}", current=rate)


def _matrix(value: npt.ArrayLike, what: str, column: bool = False) -> npt.NDArray[np.float64]:
    try:
        found = np.array(value, dtype=float)
    except (TypeError, ValueError):
        raise SceneError(f"{what} must be an array of numbers") from None
    if found.ndim > 2 or not found.size or not np.isfinite(found).all():
        raise SceneError(f"{what} must be an array of finite numbers, in rows and columns")
    if found.ndim == 2:
        return found
    return found.reshape(-1, 1) if column else found.reshape(1, -1)


def _names(letter: str, n: int) -> list[str]:
    return [letter] if n == 1 else [f"{letter}{i}" for i in range(1, n + 1)]


def _rows(scene: Scene, letter: str, matrix: npt.NDArray[np.float64]) -> list[dict[int, str]]:
    """Declare the nonzero entries as parameters; return their names by row and column."""
    rows: list[dict[int, str]] = [{} for _ in matrix]
    for i, j in zip(*np.nonzero(matrix), strict=True):
        name = f"{letter}{i + 1}_{j + 1}"
        scene.parameter(name, float(matrix[i, j]))
        rows[i][int(j)] = name
    return rows


def _sum(row: dict[int, str], signals: list[str]) -> list[str]:
    return [f"{name}*{signals[j]}" for j, name in row.items()]
