"""User-defined components with laws in SymPy, whose arguments determine the kinds of ports.

A port whose law has the argument ``stretch`` is a spring; with the rate of a variable it is a
storage, with its other variable a dissipator. All other ports are sources, or storages if the law
gives their content.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

from cotree.components.component import Acts, Component, Field, Plane, Role, value
from cotree.components.law import Law
from cotree.components.multibody import AXIS
from cotree.components.ports import scalar
from cotree.components.terminal import Kind, Terminal, active_port
from cotree.domains import DOMAINS
from cotree.domains import domain as domain_of
from cotree.errors import SceneError, brief, check_known
from cotree.naming import check_name

#: Arguments of force laws that are variables, not fields, by the direction of the force.
_GIVEN = {Acts.LINE: ("length", "rate", "t"), Acts.VELOCITY: ("speed", "t")}


def make_component(
    name: str,
    law: Callable[..., Any],
    *,
    along: str = "line",
    units: Mapping[str, str] | None = None,
    doc: str = "",
) -> Component:
    """Build a force element from a law.

    Parameters
    ----------
    name : str
        Its ``type`` in scenes.
    law : callable
        Function that takes SymPy symbols and returns the force on the second node, [N]. With
        ``along="line"`` it may have the arguments ``length`` and ``rate``, from the first node to
        the second or along the field ``axis``. With ``along="velocity"`` it may have ``speed``, of
        the second node relative to the first. ``t`` is the time. All other arguments become fields.
    along : {'line', 'velocity'}
        Direction of the force.
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
    # Arguments that are not variables of the force element become fields of the new type.
    rows = law_fields((name for name in made.arguments if name not in _GIVEN[acts]), units or {})
    if acts is Acts.LINE:
        # Without an axis, the force acts along the line between the nodes.
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
    """Build the fields of a user-defined law from argument names and units."""
    return tuple(
        # An argument that several laws share is a single field; its sign is not checked.
        value(check_name("field", name), units.get(name, ""), "", sign="")
        for name in dict.fromkeys(names)
    )


def checked_law(function: Callable[..., Any], what: str) -> Law:
    """Build a law; raise SceneError if it is no expression or has unsupported operations."""
    import sympy

    names = Law(function).arguments
    try:
        expression = sympy.sympify(function(*(sympy.Symbol(name, real=True) for name in names)))
    except Exception as error:
        raise SceneError(f"{what} returns no expression: {error}") from None
    if not isinstance(expression, sympy.Expr):
        raise SceneError(
            f"{what} returns no expression, but {brief(expression)}: return a SymPy "
            "expression or a number"
        )
    # A symbol that is not an argument would have no value in scenes.
    free = {str(symbol) for symbol in expression.free_symbols}
    if odd := sorted(free - set(names)):
        raise SceneError(f"{what} uses {', '.join(odd)}, which is not one of its arguments")
    # Form the law and its derivatives here, to check all of their operations.
    try:
        law = Law.of(expression, names)
    except (ValueError, TypeError, ArithmeticError) as error:
        raise SceneError(f"{what} {_predicate(error)}") from None
    try:
        _ = law.changing
    except (ValueError, TypeError, ArithmeticError) as error:
        raise SceneError(f"the derivative of {what} {_predicate(error)}") from None
    return law


def _predicate(error: Exception) -> str:
    """Return the predicate of an error message on a law, from an exception."""
    message = str(error)
    is_predicate = message.startswith("the law ")
    return message.removeprefix("the law ") if is_predicate else f"has no value: {message}"


#: Arguments of laws that are neither port variables of across and through, nor fields.
_NEITHER = frozenset({"t", "stretch", "potential_head", "potential_tail"})
_VARIABLES = ("across_rate", "through_rate", "across", "through")

_GIVES = ("across", "through", "content")

#: A law, or laws by port name.
Laws = Callable[..., Any] | Mapping[str, Callable[..., Any]]

#: The variable that all laws return, or a mapping of port names to such variables.
Gives = str | Mapping[str, str]


def make_network_component(
    name: str,
    laws: Laws,
    *,
    domain: str,
    gives: Gives = "",
    terminals: Sequence[str] = (),
    between: Mapping[str, Sequence[str]] | None = None,
    units: Mapping[str, str] | None = None,
    doc: str = "",
) -> Component:
    """Build a scalar component from its laws.

    Parameters
    ----------
    name : str
        Its ``type`` in scenes.
    laws : callable, or mapping of str to callable
        The law of the only port, or the laws of all ports by name. A law takes SymPy symbols and
        returns either the through variable of the port as a function of ``across``, ``across_rate``
        or ``stretch``, or its across variable as a function of ``through`` or ``through_rate``.
        Further arguments are ``across_<port>`` and ``through_<port>`` of other ports, the
        potentials ``potential_head`` and ``potential_tail`` of its own nodes, and the time ``t``.
        All other arguments become fields.
    domain : str
        The graph of its ports: ``electrical``, ``hydraulic``, ``thermal``, ...
    gives : {'', 'across', 'through', 'content'}, or mapping of str to these
        The variable that the laws return, or a mapping with that of each port. It is needed only
        for sources, whose laws have none of these arguments, and for storages given by their
        content. The law of a content, such as a charge as a function of ``across`` or a flux
        linkage as a function of ``through``, may depend on the same variable of other ports. It
        must be continuous.
    terminals : sequence of str
        Names of its nodes if ports share them; otherwise each port has two nodes of its own.
    between : mapping of str to pair of str
        With ``terminals``, the nodes at head and tail of each port.
    units : mapping of str to str, optional
        Units of the fields.
    doc : str
        One line on what it models.

    Raises
    ------
    SceneError
        If a name or an argument is not allowed, or a law gives no expression.
    """
    check_name("component", name)
    domain_of(domain)
    named = dict(laws) if isinstance(laws, Mapping) else {"": laws}
    # Only a single port may have an empty name.
    for port in named:
        if port or len(named) > 1:
            check_name("port", port)
    places = _places(name, named, terminals, between or {})
    what = f"a law of component '{name}'"
    made = {port: checked_law(law, what) for port, law in named.items()}
    given = _given(name, named, gives)
    ports = (
        _content(name, domain, port, law, named, places.get(port, ("", "")))
        if given.get(port) == "content"
        else _terminal(name, domain, port, law, given.get(port, ""), places.get(port, ("", "")))
        for port, law in made.items()
    )
    fields = (
        argument
        for law in made.values()
        for argument in law.arguments
        if argument not in _NEITHER and not _is_variable(argument, named)
    )
    rows = law_fields(fields, units or {})
    return scalar(name, doc or "a user's law", rows, *ports, terminals=tuple(terminals))


def _places(
    name: str, ports: Iterable[str], terminals: Sequence[str], between: Mapping[str, Sequence[str]]
) -> dict[str, tuple[str, str]]:
    """Return the two nodes of each port; they must be terminals or the ground."""
    if not terminals:
        return {}
    places = {}
    for port in ports:
        pair = tuple(between.get(port, ()))
        what = f"port '{port}' of component '{name}' ends at"
        check_known(pair, {*terminals, "ground"}, what, ", which is not one of its terminals")
        if len(pair) != 2:
            raise SceneError(f"component '{name}' must state the two nodes of '{port}'")
        places[port] = (pair[0], pair[1])
    return places


def _given(name: str, ports: Iterable[str], gives: Gives) -> dict[str, str]:
    """Return the variable that each port's law returns; raise SceneError if it is not allowed."""
    given = dict(gives) if isinstance(gives, Mapping) else dict.fromkeys(ports, gives)
    what = f"gives of component '{name}' names"
    check_known(given, ports, what, ", which is not one of its ports")
    for gives in given.values():
        if gives not in ("", *_GIVES):
            raise SceneError(
                f"component '{name}' gives {gives!r}: give one of {', '.join(map(repr, _GIVES))}"
            )
    return given


def _is_variable(argument: str, ports: Iterable[str]) -> bool:
    siblings = {f"{variable}_{port}" for variable in _VARIABLES for port in ports if port}
    return argument in _VARIABLES or argument in siblings


def _terminal(
    name: str, domain: str, port: str, law: Law, gives: str, between: tuple[str, str]
) -> Terminal:
    # A law of the through variable depends on across, its rate or its integral; a law of across on
    # through or its rate. Arguments that cancel in the expression are ignored.
    own = [v for v in ("across", "across_rate", "stretch") if law.uses(v)]
    dual = [v for v in ("through", "through_rate") if law.uses(v)]
    if own and dual:
        raise SceneError(
            f"a law of component '{name}' is a function of {own[0]} and {dual[0]} of its own port: "
            "give one variable as a function of the other"
        )
    found = "through" if own else "across" if dual else gives
    if found not in ("across", "through"):
        raise SceneError(
            f"a law of component '{name}' does not show which variable it gives: add "
            "gives='across' or gives='through'"
        )
    is_through = found == "through"
    rate = "across_rate" if is_through else "through_rate"
    storage = None
    if law.uses(rate):
        # The rate decides first: a storage may also depend on across, as a leaky capacitor does.
        kind = Kind.ACROSS_STORAGE if is_through else Kind.THROUGH_STORAGE
        storage, law = _linear(name, law, rate)
    elif law.uses("stretch"):
        kind = Kind.SPRING
    elif own or dual:
        kind = Kind.DISSIPATOR
    else:
        kind = Kind.THROUGH_SOURCE if is_through else Kind.ACROSS_SOURCE
    return active_port(
        domain,
        kind,
        port,
        across=None if is_through else law,
        through=law if is_through else None,
        storage=storage,
        # Slopes of user-defined laws may have any sign: equations may be unsymmetric or indefinite.
        between=between,
    )


def _content(
    name: str, domain: str, port: str, law: Law, ports: Iterable[str], between: tuple[str, str]
) -> Terminal:
    used = [v for v in law.arguments if v in _NEITHER - {"t"} or _is_variable(v, ports)]
    # The set also contains the words ``stretch`` and ``potential``.
    of = {v.partition("_")[0] for v in used}
    if any("_rate" in v for v in used) or of not in ({"across"}, {"through"}):
        raise SceneError(
            f"a law of component '{name}' gives a content: make it a function of across, or of "
            "through, of its port, and of the same variable of other ports, but of no rate, "
            "stretch or potential"
        )
    # If the domain has no name for a content, no storage with this content exists.
    row, is_across = DOMAINS[domain], of == {"across"}
    if not (row.content if is_across else row.impulse)[0]:
        also = ": give through as a function of stretch" if row.stretch else ""
        raise SceneError(
            f"a law of component '{name}' gives a content as a function of {used[0]}, but the "
            f"{domain} graph has no such storage{also}"
        )
    kind = Kind.ACROSS_STORAGE if is_across else Kind.THROUGH_STORAGE
    return active_port(domain, kind, port, content=law, between=between)


def _linear(name: str, law: Law, rate: str) -> tuple[Law, Law]:
    """Split a law that is linear in a rate into the factor of the rate and the remainder."""
    import sympy

    symbol = sympy.Symbol(rate, real=True)
    # The factor may depend on all arguments except the rate.
    factor = sympy.diff(law.expression, symbol)
    if symbol in factor.free_symbols:
        raise SceneError(
            f"a law of component '{name}' is not linear in {rate}: write it as a storage "
            f"times {rate}, plus terms without it"
        )
    return Law.of(factor), Law.of(law.expression.subs(symbol, 0))
