"""Messages on failed kernels: C returns only a status, and Python finds the cause."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from cotree.dag.evaluate import evaluate
from cotree.dag.nodes import ARGUMENT_OF, PIECE, Node, reachable, symbols_in
from cotree.dag.operations import OPERATIONS
from cotree.errors import SingularSystemError, SolveError
from cotree.model.kernels import NO_COMPILER, Kernels

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from cotree.equations import Guard
    from cotree.model.arrays import Array
    from cotree.program.layout import Layout
    from cotree.program.program import Program

#: Maximum number of names in a message.
_MOST_NAMES = 6

_SIGNS = {"add": "+", "sub": "-", "mul": "*", "div": "/", "pow": "**"}


class MissingKernels(Kernels):
    """Substitute for kernels on a machine without a compiler: every call raises SolveError."""

    backend = "none"

    def __init__(self) -> None:
        pass

    def prepare(self, p: Array) -> None:
        """Raise SolveError."""
        raise SolveError(NO_COMPILER)

    def address(self, name: str) -> int | None:
        """Return None."""
        return None

    def __call__(self, name: str, t: float, x: Array, s: Array, u: Array) -> Array:
        """Raise SolveError."""
        raise SolveError(NO_COMPILER)


def why_undefined(program: Program, kernel: str, known: Mapping[str, Any]) -> str:
    """Describe the operation that makes results nan or infinite, or return an empty string."""
    order = reachable(program.kernels[kernel].results)
    given = {
        node: float(known[ARGUMENT_OF[node.data[0]]][node.data[1]])
        for node in order
        if node.op == "symbol" and node.data[0] != PIECE
    }
    with np.errstate(all="ignore"):
        values = dict(zip(order, evaluate(order, given, order=order), strict=True))
    lost = {node for node, value in values.items() if not np.all(np.isfinite(value))}
    # Infinity may be harmless, but nan propagates: the first nan has arguments without nan.
    wrong = next((node for node in order if np.any(np.isnan(values[node]))), None)
    if wrong is None:
        wrong = next((root for root in program.kernels[kernel].results if root in lost), None)
    if wrong is None:
        return ""
    # Trace back to an operation whose arguments are all finite.
    while any(arg in lost for arg in wrong.args):
        wrong = next(arg for arg in wrong.args if arg in lost)
    return f"{_place(program, wrong)}{_operation(wrong, values)}{_point(program, wrong, given)}"


def _place(program: Program, wrong: Node) -> str:
    """Return the innermost named field that contains an operation, or a field of its arguments."""
    origins = dict(program.dag.origins)  # a copy, because other threads may add nodes
    found: list[tuple[int, str]] = []
    for node, name in origins.items():
        inside = reachable([node])
        if wrong in inside:
            found.append((len(inside), name))
    of_arguments = (origins[arg] for arg in reversed(wrong.args) if arg in origins)
    name = min(found)[1] if found else next(of_arguments, "")
    return f"{name}: " if name else ""


def _operation(node: Node, values: Mapping[Node, Any]) -> str:
    if node.op == "symbol" or node.op not in OPERATIONS:
        return f"the given value is {values[node]}"
    numbers = [f"{values[arg]:.6g}" for arg in node.args]
    text = f"{node.op}({', '.join(numbers)})"
    if node.op in _SIGNS:
        text = f" {_SIGNS[node.op]} ".join(numbers)
    return f"{text} is {values[node]}"


def _point(program: Program, wrong: Node, given: Mapping[Node, float]) -> str:
    """Describe the time, states, parameters and inputs on which an operation depends."""
    layout = program.layout
    symbols = [
        symbol for symbol in symbols_in([wrong]) if symbol in given
    ]  # symbols of branches in piecewise expressions have no values
    named = [(_name(layout, symbol), given[symbol]) for symbol in symbols]
    texts = [f"{name} = {value:.10g}" for name, value in named[:_MOST_NAMES]]
    if len(named) > _MOST_NAMES:
        texts.append("...")
    return f" at {', '.join(texts)}" if texts else ""


def _name(layout: Layout, symbol: Node) -> str:
    kind, place = symbol.data
    rows: Mapping[str, Sequence[Any]] = {
        "x": layout.states,
        "p": layout.parameters,
        "u": layout.inputs,
    }
    if kind == "t":
        return "t"
    return f"'{rows[kind][place].name}'" if kind in rows else "a sensitivity"


#: Maximum number of coordinates of a singular position in a message.
_MOST_COORDINATES = 8


def singular(program: Program, name: str, known: Mapping[str, Any]) -> SingularSystemError:
    """Return the exception for a kernel whose linear system is singular."""
    layout, why = program.layout, why_undefined(program, name, known)
    if why:
        at = f" at t = {float(known['t'][0]):.10g}" if "t" in known else ""
        return SingularSystemError(
            f"linear equations have no solution{at}, since a coefficient is not finite ({why}): "
            "change the values on which it depends, or its expression"
        )
    if not layout.uncertain:
        return SingularSystemError(
            "the linear equations of the networks are singular at these values of parameters and "
            "states: ideal couplings such as transformers contradict each other or leave a "
            "variable undetermined, capacitances or inductances of opposite sign cancel, or "
            "springs at a node without mass have zero stiffness at their stretch; change a ratio "
            "or an initial value, or connect a resistance or a damper"
        )
    names = ", ".join(f"'{name}'" for name in layout.uncertain)
    place = _position(program, known.get("x"))
    return SingularSystemError(
        f"the mass matrix is singular in the present configuration{place}: a motion of {names}, "
        "whose joints carry no inertia of their own, moves no inertia; give the bodies that "
        "these joints carry mass or inertia, or start at a position without parallel axes"
    )


def _position(program: Program, x: Any) -> str:
    """Return the coordinates' values as a phrase; empty if they are unknown or too many."""
    layout = program.layout
    n = layout.n_coordinates
    if x is None or not 0 < n <= _MOST_COORDINATES or np.ndim(x) != 1:
        return ""
    rows = zip(layout.states[:n], x, strict=False)
    return " at " + ", ".join(f"{row.name} = {float(value):.6g}" for row, value in rows)


def check_guards(guards: Sequence[Guard], p: Array) -> None:
    """Evaluate the guards in Python and raise an error that names the rejected value."""
    values = {node: float(p[node.data[1]]) for node in symbols_in([g.value for g in guards])}
    for guard in guards:
        guard.check(evaluate([guard.value], values)[0])
