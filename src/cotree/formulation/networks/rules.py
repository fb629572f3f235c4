"""Rules that compute each variable of a network, and its derivatives, from other variables.

A rule is a sum (an f-circuit or f-cutset equation) or a law (a terminal equation). The derivative
of a sum is a sum, and the derivative of a law is a sum with partial derivatives as factors.
Therefore sensitivity graphs have the topology of the network (paper, Eq. (4)). Partial derivatives
of a law are computed only once, even if the law is solved for a rate or differentiated in time.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Protocol

from cotree.components import Kind, Terminal
from cotree.components.law import ZERO, Law, argument
from cotree.dag.derivative import tangents
from cotree.dag.nodes import Dag, Node, substitute
from cotree.errors import FormulationError

if TYPE_CHECKING:
    from collections.abc import Collection, Hashable, Iterable, Mapping

    from cotree.components.terminal import Friction
    from cotree.scene.networks import Port


#: Quantity and name of a variable.
Variable = tuple[str, str]

#: Derivatives of a value along several directions, without zero derivatives.
Tangent = dict["Hashable", "Node"]


class Given(Protocol):
    """Differentiates nodes that depend on states, parameters, inputs and fields."""

    def __call__(self, node: Node, replacements: Mapping[Node, Node]) -> Tangent:
        """Differentiate a node; symbols are first replaced by the values in ``replacements``."""


class Rule:
    """The equation from which a variable is computed."""

    @property
    def needs(self) -> tuple[Variable, ...]:
        """Variables on which the rule depends."""
        raise NotImplementedError

    def value(self, dag: Dag, values: Mapping[Variable, Node]) -> Node:
        """Return the value of the variable."""
        raise NotImplementedError

    def partials(
        self, values: Mapping[Variable, Node], changing: Collection[Variable]
    ) -> Iterable[tuple[Variable, Node]]:
        """Yield the partial derivatives with respect to the ``changing`` variables."""
        raise NotImplementedError

    def explicit(self, values: Mapping[Variable, Node], given: Given) -> Tangent:
        """Return the derivatives of the rule while all other variables are constant."""
        return {}

    def tangent(
        self, values: Mapping[Variable, Node], d: Mapping[Variable, Tangent], given: Given
    ) -> Tangent:
        """Return the derivatives ([1] eq. 4) from the derivatives ``d`` of other variables."""
        total = self.explicit(values, given)
        # No partial derivatives are needed if the derivatives of all arguments are zero.
        changing = [variable for variable in self.needs if d[variable]]
        for variable, partial in self.partials(values, changing) if changing else ():
            for key, term in d[variable].items():
                _add(total, key, partial * term)
        return total


def _add(total: Tangent, key: Hashable, term: Node) -> None:
    if term.is_zero:
        return
    known = total.get(key)
    result = term if known is None else known + term
    # Remove zero derivatives, so that later rules skip them.
    if result.is_zero:
        del total[key]
    else:
        total[key] = result


@dataclass(frozen=True)
class Sum(Rule):
    """A signed sum of variables: an f-circuit or f-cutset equation."""

    terms: tuple[tuple[int, Variable], ...]

    @property
    def needs(self) -> tuple[Variable, ...]:
        """The variables in the sum."""
        return tuple(variable for _, variable in self.terms)

    def value(self, dag: Dag, values: Mapping[Variable, Node]) -> Node:
        """Return the sum."""
        total = dag.zero
        for sign, variable in self.terms:
            total = total + values[variable] if sign > 0 else total - values[variable]
        return total

    def partials(
        self, values: Mapping[Variable, Node], changing: Collection[Variable]
    ) -> Iterable[tuple[Variable, Node]]:
        """Return the signs of the ``changing`` variables."""
        # Topology does not depend on parameters: signs are those of the sensitivity graph.
        one = values[self.terms[0][1]].dag.one
        return ((variable, one if sign > 0 else -one) for sign, variable in self.terms)


@dataclass(frozen=True)
class Lawful(Rule):
    """A terminal equation."""

    law: Law
    arguments: tuple[tuple[str, Variable], ...]

    @property
    def needs(self) -> tuple[Variable, ...]:
        """The arguments of the law."""
        return tuple(variable for _, variable in self.arguments)

    def value(self, dag: Dag, values: Mapping[Variable, Node]) -> Node:
        """Return the value of the law."""
        return self.law.value(dag, {name: values[variable] for name, variable in self.arguments})

    def partials(
        self, values: Mapping[Variable, Node], changing: Collection[Variable]
    ) -> Iterable[tuple[Variable, Node]]:
        """Return the law's partial derivatives."""
        known = {name: values[variable] for name, variable in self.arguments}
        dag = next(iter(known.values())).dag
        for name, variable in self.arguments:
            if variable in changing:
                # The partial derivative of a law is computed once and shared by all directions.
                partial = self.law.partial_value(dag, known, name)
                if partial is not None:
                    yield variable, partial


@dataclass(frozen=True)
class FieldRule(Rule):
    """A field of a component, or a state: a node that depends on symbols."""

    node: Node  # value of the field, in which symbols represent variables
    variables: tuple[tuple[Node, Variable], ...] = ()  # symbols, and the variables they represent

    @property
    def needs(self) -> tuple[Variable, ...]:
        """The variables on which the field depends."""
        return tuple(variable for _, variable in self.variables)

    def _symbol_values(self, values: Mapping[Variable, Node]) -> dict[Node, Node]:
        return {symbol: values[variable] for symbol, variable in self.variables}

    def value(self, dag: Dag, values: Mapping[Variable, Node]) -> Node:
        """Return the field, with symbols replaced by the values of their variables."""
        return (
            substitute([self.node], self._symbol_values(values))[0] if self.variables else self.node
        )

    def explicit(self, values: Mapping[Variable, Node], given: Given) -> Tangent:
        """Differentiate with respect to symbols that do not represent variables."""
        # Derivatives may contain symbols of variables, which are replaced as in the field.
        symbols = self._symbol_values(values)
        found = given(self.node, symbols)
        if not self.variables:
            return dict(found)
        return dict(zip(found, substitute(found.values(), symbols), strict=True))

    def partials(
        self, values: Mapping[Variable, Node], changing: Collection[Variable]
    ) -> Iterable[tuple[Variable, Node]]:
        """Differentiate with respect to the symbols that represent variables."""
        symbols = self._symbol_values(values)
        for symbol, variable in self.variables:
            if variable in changing:
                # The partial derivatives of a field, unlike those of a law, are formed here.
                along = tangents([self.node], {symbol: symbol.dag.one}, symbols)
                yield variable, substitute(along, symbols)[0]


@dataclass(frozen=True)
class Unknown(Rule):
    """An unknown, determined by the equation ``residual`` = 0 of a block."""

    residual: Variable

    @property
    def needs(self) -> tuple[Variable, ...]:
        """The residual, which is zero for the correct value of the unknown."""
        return (self.residual,)


@lru_cache(maxsize=1024)
def stored_rate(terminal: Terminal, is_across: bool) -> Law:
    """Return the rate of a state: (through - leak) / capacity or (across - drop) / inertance."""
    assert terminal.storage is not None
    # Both kinds of storage have the rate (given - loss) / storage.
    given, loss = _sides(terminal, is_across)
    return (given - loss) / terminal.storage


@lru_cache(maxsize=1024)
def stored_value(terminal: Terminal, is_across: bool) -> Law:
    """Return the law of a dependent storage: ``storage * rate``, or the rate of its content."""
    loss = _sides(terminal, is_across)[1]
    if terminal.content is not None:
        return rate_of(terminal.content) + loss
    assert terminal.storage is not None
    # Linear storage: capacity * rate of across, or inertance * rate of through, plus the loss.
    return terminal.storage * argument("across_rate" if is_across else "through_rate") + loss


@lru_cache(maxsize=1024)
def stored_residual(terminal: Terminal, is_across: bool) -> Law:
    """Return the residual of a storage: rate of the content, plus the loss, minus the inflow."""
    return stored_value(terminal, is_across) - _sides(terminal, is_across)[0]


@lru_cache(maxsize=1024)
def linear_content(terminal: Terminal) -> Law | None:
    """Return a storage's content at constant capacity; None if its loss also stores energy."""
    is_across = terminal.kind is Kind.ACROSS_STORAGE
    loss = terminal.through if is_across else terminal.across
    # A loss that contains rates stores energy too, so the content would be incomplete.
    if terminal.storage is None or (loss is not None and any("_rate" in a for a in loss.arguments)):
        return None
    return terminal.storage * argument("across" if is_across else "through")


def _sides(terminal: Terminal, is_across: bool) -> tuple[Law, Law]:
    if is_across:
        return argument("through"), terminal.through or ZERO
    return argument("across"), terminal.across or ZERO


@lru_cache(maxsize=1024)
def across_residual(terminal: Terminal) -> Law:
    """Return the equation that determines the unknown across variable of a branch."""
    if terminal.through is not None and terminal.kind is not Kind.COUPLED:
        # This form is symmetric if the laws are symmetric.
        return terminal.through - argument("through")
    assert terminal.across is not None
    # The slope of variable minus law is one if the law does not depend on the variable.
    return argument("across") - terminal.across


@lru_cache(maxsize=1024)
def through_residual(terminal: Terminal) -> Law:
    """Return the equation that determines the unknown through variable of a chord."""
    if terminal.through is not None:
        return argument("through") - terminal.through
    assert terminal.across is not None
    return terminal.across - argument("across")


@lru_cache(maxsize=1024)
def friction_residual(terminal: Terminal) -> Law:
    """Return the equation of dry friction: zero relative acceleration, or the law of the mode.

    All modes have the same variables, so that one elimination is valid for all modes.
    """
    assert terminal.friction is not None
    own = terminal.friction
    through = argument("through")
    impulse = argument(f"impulse{own.suffix}") if own.is_struck else ZERO
    stuck, forward, backward, free, struck = _friction_weights(own)
    # The through variable opposes the motion. With this sign, the derivative with respect to the
    # through variable is positive in every mode.
    return (
        -stuck * argument("across_rate")
        + forward * (through - own.forward)
        + backward * (through - own.backward)
        + free * through
        + struck * (impulse - argument("across_rate"))
    )


@lru_cache(maxsize=1024)
def holding_laws(terminal: Terminal) -> tuple[Law, Law, Law]:
    """Return force, share and jump of a unilateral constraint on a mechanism.

    The share is one while the edge sticks or is closed, otherwise zero. The force is the multiplier
    times the share, plus the law of the mode. In an impact, the equations determine changes instead
    of rates: the jump is the required change of the across variable.
    """
    multiplier = argument("multiplier")
    if terminal.stop is not None:
        mode = argument(f"mode{terminal.stop.suffix}")
        _, held, struck = _stop_weights(mode)
        jump = struck * argument(f"impulse{terminal.stop.suffix}")
        return (held + struck) * multiplier, held + struck, jump
    own = terminal.friction
    assert own is not None
    stuck, forward, backward, _, struck = _friction_weights(own)
    sliding = forward * own.forward + backward * own.backward
    if not own.is_struck:
        return stuck * multiplier + sliding, stuck, ZERO
    share, jump = stuck + struck, struck * argument(f"impulse{own.suffix}")
    return share * multiplier + sliding, share, jump


@lru_cache(maxsize=1024)
def stop_residual(terminal: Terminal) -> Law:
    """Return the equation of a rigid stop: no force, no relative acceleration, or an impact.

    In an impact, the mode is doubled, and the equations determine changes of the states instead of
    rates: the required change of the across variable replaces the relative acceleration.
    """
    assert terminal.stop is not None
    suffix = terminal.stop.suffix
    mode, through = argument(f"mode{suffix}"), argument("through")
    free, held, struck = _stop_weights(mode)
    wanted = struck * argument(f"impulse{suffix}")
    return free * through + wanted - (held + struck) * argument("across_rate")


def _stop_weights(mode: Law) -> tuple[Law, Law, Law]:
    """Return factors, each of which is one in one mode of a stop: open, closed, in an impact."""
    return (
        (1 - mode**2) * (4 - mode**2) / 4,
        mode**2 * (4 - mode**2) / 3,
        mode**2 * (mode**2 - 1) / 12,
    )


def _friction_weights(friction: Friction) -> tuple[Law, Law, Law, Law, Law]:
    """Return expressions, each of which is one in one mode of friction and zero in all others.

    They are exact in floating point for the modes 0, 1, -1, 2 and 3: stuck, forwards, backwards,
    free and, if an impulse may act, sticking in an impact.
    """
    mode = argument(friction.mode)
    if not friction.is_struck and friction.grip is None:
        return 1 - mode**2, mode * (mode + 1) / 2, mode * (mode - 1) / 2, ZERO, ZERO
    if not friction.is_struck:
        return (
            (1 - mode**2) * (2 - mode) / 2,
            mode * (mode + 1) * (2 - mode) / 2,
            mode * (mode - 1) * (2 - mode) / 6,
            mode * (mode**2 - 1) / 6,
            ZERO,
        )
    return (
        (1 - mode**2) * (2 - mode) * (3 - mode) / 6,
        mode * (mode + 1) * (2 - mode) * (3 - mode) / 4,
        mode * (mode - 1) * (2 - mode) * (3 - mode) / 24,
        mode * (mode**2 - 1) * (3 - mode) / 6,
        mode * (mode**2 - 1) * (mode - 2) / 24,
    )


@lru_cache(maxsize=1024)
def spring_residual(terminal: Terminal) -> Law:
    """Return the rate of a spring's through variable by its law, minus the rate by the f-cutset."""
    assert terminal.through is not None
    return rate_of(terminal.through) - argument("through_rate")


@lru_cache(maxsize=1024)
def spring_rate(terminal: Terminal) -> Law:
    """Return the time derivative of a linear spring's law, solved for the rate of the stretch."""
    assert terminal.storage is not None
    # The differentiated law is affine in the rate of the stretch, with the slope k.
    at_rest = spring_residual(terminal).where(stretch_rate=0.0)
    return -at_rest / terminal.storage


@lru_cache(maxsize=1024)
def spring_stretch(terminal: Terminal) -> Law:
    """Return a linear spring's law, solved for its stretch."""
    assert terminal.through is not None
    assert terminal.storage is not None
    # The law f = f0 + k s is affine in the stretch s, with k = ``storage``.
    unstretched = terminal.through.where(stretch=0.0)
    return (argument("through") - unstretched) / terminal.storage


@lru_cache(maxsize=1024)
def explicit_residual(name: str, law: Law) -> Law:
    """Return the residual of an explicit law: the variable minus the law."""
    return argument(name) - law


@lru_cache(maxsize=1024)
def rate_of(law: Law) -> Law:
    """Return a law's time derivative: the sum of partial derivatives times rates."""
    total = ZERO
    for name in law.changing:
        total += law.slope(name) * argument(rate_name(name))
    return total


def rate_name(name: str) -> str:
    """Return the name of the argument that is the rate of another argument."""
    first, _, rest = name.partition("_")
    # "_rate" precedes the name of another port, as in across_rate_secondary.
    if first in ("across", "through") and name != first:
        return f"{first}_rate_{rest}"
    return f"{name}_rate"


def higher_index(port: Port) -> FormulationError:
    """Return the error for an edge if no equation determines its rate of change."""
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
        f"the equations of '{port.name}' have a higher index than supported: a storage connected "
        "to it requires the time derivative of its nonlinear law; put a resistance between them"
    )
