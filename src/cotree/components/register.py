"""Components that users register, with a law in SymPy."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from cotree.components.component import Acts, Component, Field, Plane, Role, value
from cotree.components.forces import AXIS
from cotree.components.law import Law
from cotree.dag.nodes import Dag
from cotree.errors import SceneError, brief
from cotree.naming import check_name

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping

#: Arguments of a law that are no fields, by the direction along which it acts.
_GIVEN = {Acts.LINE: ("length", "rate", "t"), Acts.VELOCITY: ("speed", "t")}


def make_component(
    name: str,
    law: Callable[..., Any],
    *,
    along: str = "line",
    units: Mapping[str, str] | None = None,
    doc: str = "",
) -> Component:
    """Make a force element from a law.

    Parameters
    ----------
    name : str
        Its ``type`` in scenes.
    law : callable
        Takes SymPy symbols and gives the force on the second node, [N]. Its arguments are
        ``length`` and ``rate`` (``along="line"``: of the line from the first node to the second,
        or along the field ``axis``) or ``speed`` (``along="velocity"``: of the second node
        against the first; the force acts along the velocity), the time ``t``, and any others:
        these become fields.
    along : {'line', 'velocity'}
        What the force acts along.
    units : mapping of str to str, optional
        Units of the fields.
    doc : str
        One line on what it models.

    Raises
    ------
    SceneError
        If the name or an argument is not allowed, or the law gives no expression.
    """
    check_name("component", name)
    try:
        acts = Acts(along)
    except ValueError:
        raise SceneError(
            f"component '{name}' acts along {along!r}: give 'line' or 'velocity'"
        ) from None
    made = checked_law(law, f"the law of component '{name}'")
    # Arguments that are no variable of the force element are the fields of the new type.
    rows = law_fields((name for name in made.arguments if name not in _GIVEN[acts]), units or {})
    if acts is Acts.LINE:
        # Without an axis, the force acts along the line of the nodes.
        rows = (AXIS, *rows)
    return Component(
        name,
        Role.LAW,
        doc or "a user's law",
        fields=rows,
        domains=("translation",),
        law=made,
        keeps_plane=Plane(within=("axis",)),
        acts=acts,
    )


def law_fields(names: Iterable[str], units: Mapping[str, str]) -> tuple[Field, ...]:
    """Make the fields of a user's law from the names of its arguments and their units.

    Raises
    ------
    SceneError
        If a name is not allowed.
    """
    return tuple(
        # Ports may share an argument, which is one field; its sign is the user's affair.
        value(check_name("field", name), units.get(name, ""), "", sign="")
        for name in dict.fromkeys(names)
    )


def checked_law(function: Callable[..., Any], what: str) -> Law:
    """Make a law, and check that it gives an expression of its arguments.

    Parameters
    ----------
    function : callable
        As a user wrote it.
    what : str
        Whose law it is, as the subject of a message.

    Raises
    ------
    SceneError
        If it does not, or if there is no operation for what it or a derivative of it is made of.
    """
    import sympy

    law = Law(function)
    try:
        expression = law.expression
    except Exception as error:
        raise SceneError(f"{what} gives no expression: {error}") from None
    if not isinstance(expression, sympy.Expr):
        raise SceneError(
            f"{what} gives no expression, but {brief(expression)}: give a SymPy expression or a "
            "number"
        )
    # A symbol that the function did not receive would have no value in scenes.
    free = {str(symbol) for symbol in expression.free_symbols}
    if odd := sorted(free - set(law.arguments)):
        raise SceneError(f"{what} uses {', '.join(odd)}, which is no argument of it")
    _check_operations(law, what)
    return law


def _check_operations(law: Law, what: str) -> None:
    """Form a law and its derivatives on trial, to refuse unknown operations early."""
    # An arena of its own leaves no nodes behind. Symbols of no known value keep the law from
    # folding, so that every operation is met.
    dag = Dag()
    arguments = {name: dag.symbol("x", i) for i, name in enumerate(law.arguments)}
    try:
        law.value(dag, arguments)
    except (ValueError, TypeError, ArithmeticError) as error:
        raise SceneError(f"{what} {_predicate(error)}") from None
    try:
        law.partial_values(dag, arguments)
    except (ValueError, TypeError, ArithmeticError) as error:
        raise SceneError(f"the derivative of {what} {_predicate(error)}") from None


def _predicate(error: Exception) -> str:
    """Say what is wrong with a law, without naming it."""
    told = str(error)
    return told.removeprefix("the law ") if told.startswith("the law ") else f"has no value: {told}"
