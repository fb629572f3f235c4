"""Rules: how each variable of a network follows from others, with its differentiated form.

A variable is a pair of a quantity and a name. Its rule is an f-circuit or f-cutset equation (a
sum) or a terminal equation (a law). Differentiated, sums stay sums and laws become sums of their
pre-formed partial derivatives, so a sensitivity graph has the same topology (paper, Eq. (4)).

A terminal equation that is solved for a rate, or is a residual, or is differentiated, is a SymPy
expression with partial derivatives too, formed once.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Any, Protocol

from cotree.components import Kind, Terminal
from cotree.components.law import Law, law_symbol
from cotree.dag.derivative import tangents
from cotree.dag.nodes import Dag, Node, substitute
from cotree.errors import FormulationError

if TYPE_CHECKING:
    from collections.abc import Collection, Hashable, Iterable, Mapping

    from cotree.scene.networks import Port


#: Quantity and name of a variable.
Variable = tuple[str, str]

#: Derivatives of a value along several directions; zero ones are absent.
Tangent = dict["Hashable", "Node"]


class Given(Protocol):
    """Function that differentiates nodes of states, parameters, inputs and fields."""

    def __call__(self, node: Node, replacements: Mapping[Node, Node]) -> Tangent:
        """Differentiate a node in which ``replacements`` replace symbols."""
        ...


class Rule:
    """Equation from which a variable follows."""

    @property
    def needs(self) -> tuple[Variable, ...]:
        """The variables on which the rule depends."""
        raise NotImplementedError

    def value(self, dag: Dag, values: Mapping[Variable, Node]) -> Node:
        """Form the variable."""
        raise NotImplementedError

    def partials(
        self, values: Mapping[Variable, Node], changing: Collection[Variable]
    ) -> Iterable[tuple[Variable, Node]]:
        """Form the partial derivatives by some of the variables."""
        raise NotImplementedError

    def explicit(self, values: Mapping[Variable, Node], given: Given) -> Tangent:
        """Form the derivatives for constant values of the other variables."""
        return {}

    def tangent(
        self, values: Mapping[Variable, Node], d: Mapping[Variable, Tangent], given: Given
    ) -> Tangent:
        """Form the derivatives of the variable along all directions ([1] eq. 4).

        ``d`` has the derivatives of the variables, ``given`` those of states, parameters, inputs,
        fields.
        """
        total = self.explicit(values, given)
        # A rule whose arguments have no derivatives needs no partial derivatives.
        changing = [variable for variable in self.needs if d[variable]]
        for variable, partial in self.partials(values, changing) if changing else ():
            for key, term in d[variable].items():
                _add(total, key, partial * term)
        return total


def _add(total: Tangent, key: Hashable, term: Node) -> None:
    """Add a term to the derivative along one direction, in place."""
    if term.is_zero:
        return
    known = total.get(key)
    result = term if known is None else known + term
    # Zero derivatives are absent, so that later rules skip them.
    if result.is_zero:
        del total[key]
    else:
        total[key] = result


@dataclass(frozen=True)
class Sum(Rule):
    """A sum of variables with signs: an f-circuit or an f-cutset equation."""

    terms: tuple[tuple[int, Variable], ...]

    @property
    def needs(self) -> tuple[Variable, ...]:
        """The variables that are added."""
        return tuple(variable for _, variable in self.terms)

    def value(self, dag: Dag, values: Mapping[Variable, Node]) -> Node:
        """Form the sum."""
        total = dag.zero
        for sign, variable in self.terms:
            total = total + values[variable] if sign > 0 else total - values[variable]
        return total

    def partials(
        self, values: Mapping[Variable, Node], changing: Collection[Variable]
    ) -> Iterable[tuple[Variable, Node]]:
        """Return the signs."""
        # Topology has no parameters: the sensitivity graph sums with the same signs.
        one = values[self.terms[0][1]].dag.one
        return ((variable, one if sign > 0 else -one) for sign, variable in self.terms)


@dataclass(frozen=True)
class Lawful(Rule):
    """A terminal equation."""

    law: Law
    arguments: tuple[tuple[str, Variable], ...]

    @property
    def needs(self) -> tuple[Variable, ...]:
        """The law's arguments."""
        return tuple(variable for _, variable in self.arguments)

    def value(self, dag: Dag, values: Mapping[Variable, Node]) -> Node:
        """Evaluate the law."""
        return self.law.value(dag, {name: values[variable] for name, variable in self.arguments})

    def partials(
        self, values: Mapping[Variable, Node], changing: Collection[Variable]
    ) -> Iterable[tuple[Variable, Node]]:
        """Evaluate the law's partial derivatives."""
        known = {name: values[variable] for name, variable in self.arguments}
        dag = next(iter(known.values())).dag
        for name, variable in self.arguments:
            if variable in changing:
                # Pre-formed with the component: the constitutive equation of the sensitivity graph.
                partial = self.law.partial_value(dag, known, name)
                if partial is not None:
                    yield variable, partial


@dataclass(frozen=True)
class FieldRule(Rule):
    """A field of a component, or a state: a node of symbols."""

    node: Node  # value of the field, with symbols for the variables on which it depends
    variables: tuple[tuple[Node, Variable], ...] = ()  # symbols in the node, with their variables

    @property
    def needs(self) -> tuple[Variable, ...]:
        """The variables on which it depends."""
        return tuple(variable for _, variable in self.variables)

    def _symbol_values(self, values: Mapping[Variable, Node]) -> dict[Node, Node]:
        """Return the values of the symbols of variables."""
        return {symbol: values[variable] for symbol, variable in self.variables}

    def value(self, dag: Dag, values: Mapping[Variable, Node]) -> Node:
        """Substitute the variables for their symbols."""
        return (
            substitute([self.node], self._symbol_values(values))[0] if self.variables else self.node
        )

    def explicit(self, values: Mapping[Variable, Node], given: Given) -> Tangent:
        """Differentiate by the other symbols."""
        # Derivatives may contain symbols of variables, too, which are replaced as in the field.
        symbols = self._symbol_values(values)
        found = given(self.node, symbols)
        if not self.variables:
            return dict(found)
        return dict(zip(found, substitute(found.values(), symbols), strict=True))

    def partials(
        self, values: Mapping[Variable, Node], changing: Collection[Variable]
    ) -> Iterable[tuple[Variable, Node]]:
        """Differentiate by the symbols of variables."""
        symbols = self._symbol_values(values)
        for symbol, variable in self.variables:
            if variable in changing:
                # A field is an expression of the scene; its partial derivatives are formed here.
                along = tangents([self.node], {symbol: symbol.dag.one}, symbols)
                yield variable, substitute(along, symbols)[0]


@dataclass(frozen=True)
class Unknown(Rule):
    """An unknown, determined such that the variable ``residual`` is zero.

    Its value comes from a block of equations (:mod:`cotree.formulation.networks.solved`).
    """

    residual: Variable

    @property
    def needs(self) -> tuple[Variable, ...]:
        """The residual that determines the unknown."""
        return (self.residual,)


def _or_zero(law: Law | None) -> Any:
    import sympy

    return sympy.Integer(0) if law is None else law.expression


@lru_cache(maxsize=1024)
def stored_rate(terminal: Terminal, is_across: bool) -> Law:
    """Solve a storage's terminal equation for the rate of its state.

    Capacities: ``rate = (through - leak) / capacity``; inertances ``rate = (across - drop) /
    inertance``.
    """
    assert terminal.storage is not None
    # Dual cases share one formula: through minus loss over capacity, across minus loss over
    # inertance.
    given, loss = _sides(terminal, is_across)
    return Law.of((given - loss) / terminal.storage.expression)


@lru_cache(maxsize=1024)
def stored_value(terminal: Terminal, is_across: bool) -> Law:
    """Return the law of a dependent storage: ``storage * rate``, or the rate of its content."""
    return Law.of(_stored(terminal, is_across))


@lru_cache(maxsize=1024)
def stored_residual(terminal: Terminal, is_across: bool) -> Law:
    """Form the residual of a storage: rate of its content plus loss, minus the inflow."""
    return Law.of(_stored(terminal, is_across) - _sides(terminal, is_across)[0])


@lru_cache(maxsize=1024)
def linear_content(terminal: Terminal) -> Law | None:
    """Return the content of a storage of constant capacity; None if its loss stores energy, too."""
    is_across = terminal.kind is Kind.ACROSS_STORAGE
    loss = terminal.through if is_across else terminal.across
    # A loss that contains rates stores something itself, so that the content is incomplete.
    if terminal.storage is None or (loss is not None and any("_rate" in a for a in loss.arguments)):
        return None
    return Law.of(terminal.storage.expression * law_symbol("across" if is_across else "through"))


def _stored(terminal: Terminal, is_across: bool) -> Any:
    loss = _sides(terminal, is_across)[1]
    if terminal.content is not None:
        return rate_of(terminal.content).expression + loss
    assert terminal.storage is not None
    # A linear storage: capacity * rate of across, or inertance * rate of through, plus its loss.
    rate = law_symbol("across_rate" if is_across else "through_rate")
    return terminal.storage.expression * rate + loss


def _sides(terminal: Terminal, is_across: bool) -> tuple[Any, Any]:
    if is_across:
        return law_symbol("through"), _or_zero(terminal.through)
    return law_symbol("across"), _or_zero(terminal.across)


@lru_cache(maxsize=1024)
def across_residual(terminal: Terminal) -> Law:
    """Return the equation of a branch whose across variable is unknown."""
    if terminal.through is not None and terminal.kind is not Kind.COUPLED:
        # Symmetric if the laws are.
        return Law.of(terminal.through.expression - law_symbol("through"))
    assert terminal.across is not None
    # The variable minus its law. If the law does not depend on the variable, the slope is one.
    return Law.of(law_symbol("across") - terminal.across.expression)


@lru_cache(maxsize=1024)
def through_residual(terminal: Terminal) -> Law:
    """Return the equation of a chord whose through variable is unknown."""
    if terminal.through is not None:
        return Law.of(law_symbol("through") - terminal.through.expression)
    assert terminal.across is not None
    return Law.of(terminal.across.expression - law_symbol("across"))


@lru_cache(maxsize=1024)
def friction_residual(terminal: Terminal) -> Law:
    """Form the equation of dry friction: zero relative acceleration, or the law of the mode.

    The equation contains the same variables in all modes, so that one elimination is valid for all
    of them.
    """
    assert terminal.friction is not None
    own = terminal.friction
    through, mode = law_symbol("through"), law_symbol(own.mode)
    struck = impulse = 0
    if own.presser:
        impulse = law_symbol(f"impulse{own.suffix}")
        stuck, forward, backward, free, struck = pressed_weights(mode)
    else:
        stuck, forward, backward, free = mode_weights(mode, own.grip is not None)
    # The sign is chosen so that the derivative by the through variable is positive in every mode:
    # the through variable opposes the motion.
    return Law.of(
        -stuck * law_symbol("across_rate")
        + forward * (through - own.forward.expression)
        + backward * (through - own.backward.expression)
        + free * through
        + struck * (impulse - law_symbol("across_rate"))
    )


@lru_cache(maxsize=1024)
def holding_laws(terminal: Terminal) -> tuple[Law, Law, Law]:
    """Return the force of a unilateral constraint on a mechanism, its share and its jump.

    The force is the multiplier times the share, one while the edge sticks or is closed and zero
    otherwise, plus the law of the mode. In an impact the jump is the change of the across variable,
    which replaces its rate: the rates of all states are then their changes by the impact.
    """
    import sympy

    multiplier = law_symbol("multiplier")
    if terminal.stop is not None:
        mode = law_symbol(f"mode{terminal.stop.suffix}")
        _, held, struck = _stop_weights(mode)
        jump = struck * law_symbol(f"impulse{terminal.stop.suffix}")
        return Law.of((held + struck) * multiplier), Law.of(held + struck), Law.of(jump)
    own = terminal.friction
    assert own is not None
    mode = law_symbol(own.mode)
    jump = sympy.Integer(0)
    if own.presser:
        stuck, forward, backward, _, struck = pressed_weights(mode)
        impulse = law_symbol(f"impulse{own.suffix}")
        stuck, jump = stuck + struck, struck * impulse
    else:
        stuck, forward, backward, _ = mode_weights(mode, own.grip is not None)
    sliding = forward * own.forward.expression + backward * own.backward.expression
    return Law.of(stuck * multiplier + sliding), Law.of(stuck), Law.of(jump)


@lru_cache(maxsize=1024)
def stop_residual(terminal: Terminal) -> Law:
    """Form the equation of a rigid stop: no force, no relative acceleration, or an impact.

    In an impact the mode is doubled, and the required change of the across variable replaces the
    relative acceleration: the rates of all states are then their changes by the impact.
    """
    assert terminal.stop is not None
    suffix = terminal.stop.suffix
    mode, through = law_symbol(f"mode{suffix}"), law_symbol("through")
    # Each factor is exactly one in its own modes, and zero in the others.
    free = (1 - mode**2) * (4 - mode**2) / 4
    held = mode**2 * (4 - mode**2) / 3
    struck = mode**2 * (mode**2 - 1) / 12
    wanted = struck * law_symbol(f"impulse{suffix}")
    return Law.of(free * through + wanted - (held + struck) * law_symbol("across_rate"))


def _stop_weights(mode: Any) -> tuple[Any, Any, Any]:
    """Return factors that are one in one mode of a stop: open, closed, or in an impact."""
    return (
        (1 - mode**2) * (4 - mode**2) / 4,
        mode**2 * (4 - mode**2) / 3,
        mode**2 * (mode**2 - 1) / 12,
    )


def mode_weights(mode: Any, may_be_free: bool) -> tuple[Any, Any, Any, Any]:
    """Return expressions that are one in one mode of friction and zero in the others.

    They are exact in doubles for the modes 0, 1, -1 and 2: stuck, forwards, backwards and free.
    """
    if not may_be_free:
        return 1 - mode**2, mode * (mode + 1) / 2, mode * (mode - 1) / 2, 0
    return (
        (1 - mode**2) * (2 - mode) / 2,
        mode * (mode + 1) * (2 - mode) / 2,
        mode * (mode - 1) * (2 - mode) / 6,
        mode * (mode**2 - 1) / 6,
    )


def pressed_weights(mode: Any) -> tuple[Any, Any, Any, Any, Any]:
    """Return the weights of :func:`mode_weights` for friction whose normal force is that of a stop.

    The modes are 0, 1, -1, 2 and 3: stuck, forwards, backwards, free, and sticking in an impact.
    """
    return (
        (1 - mode**2) * (2 - mode) * (3 - mode) / 6,
        mode * (mode + 1) * (2 - mode) * (3 - mode) / 4,
        mode * (mode - 1) * (2 - mode) * (3 - mode) / 24,
        mode * (mode**2 - 1) * (3 - mode) / 6,
        mode * (mode**2 - 1) * (mode - 2) / 24,
    )


@lru_cache(maxsize=1024)
def spring_residual(terminal: Terminal) -> Law:
    """Form the rate of a spring's through variable by its law, minus that by the f-cutset."""
    assert terminal.through is not None
    return Law.of(rate_of(terminal.through).expression - law_symbol("through_rate"))


@lru_cache(maxsize=1024)
def spring_rate(terminal: Terminal) -> Law:
    """Solve the differentiated law of a linear spring for the rate of its stretch."""
    assert terminal.storage is not None
    # The differentiated law is affine in the rate of the stretch, with the same slope k.
    at_rest = spring_residual(terminal).expression.subs(law_symbol("stretch_rate"), 0)
    return Law.of(-at_rest / terminal.storage.expression)


@lru_cache(maxsize=1024)
def spring_stretch(terminal: Terminal) -> Law:
    """Solve the law of a linear spring for its stretch."""
    assert terminal.through is not None
    assert terminal.storage is not None
    # The law is affine in the stretch: f = f0 + k s, where ``storage`` is k.
    unstretched = terminal.through.expression.subs(law_symbol("stretch"), 0)
    return Law.of((law_symbol("through") - unstretched) / terminal.storage.expression)


@lru_cache(maxsize=1024)
def explicit_residual(name: str, law: Law) -> Law:
    """Form the residual of an explicit law: the variable minus the law."""
    return Law.of(law_symbol(name) - law.expression)


@lru_cache(maxsize=1024)
def rate_of(law: Law) -> Law:
    """Differentiate a law by time: the sum of its partial derivatives times rates."""
    import sympy

    total = sympy.Integer(0)
    for name, partial in law.partials.items():
        total += partial * law_symbol(rate_name(name))
    return Law.of(total)


def rate_name(name: str) -> str:
    """Name the rate of a law's argument."""
    first, _, rest = name.partition("_")
    # The marker of the rate precedes the name of a sibling port: across_rate_secondary.
    if first in ("across", "through") and name != first:
        return f"{first}_rate_{rest}"
    return f"{name}_rate"


def higher_index(port: Port) -> FormulationError:
    """Return the error for an edge whose rate of change no equation determines."""
    if port.kind in (Kind.ACROSS_STORAGE, Kind.THROUGH_STORAGE):
        why = (
            "sources, gyrators or other storages determine its rate of change, which would have to"
        )
        return FormulationError(
            f"the equations of storage '{port.name}' have a higher index than supported: "
            f"{why} be differentiated once more; put a resistance in parallel or in series "
            "with it"
        )
    return FormulationError(
        f"the equations of '{port.name}' have a higher index than supported: a storage is "
        "connected to its nonlinear law such that the law's rate of change would be needed; "
        "put a resistance between them"
    )
