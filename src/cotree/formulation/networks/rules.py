"""Rules: how each variable of a network follows from others, with its differentiated form.

A variable is a pair of a quantity and a name. Its rule is an f-circuit or f-cutset equation (a
sum) or a terminal equation (a law). Differentiated, sums stay sums and laws become sums of their
pre-formed partial derivatives, so a sensitivity graph has the same topology (paper, Eq. (4)).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

from cotree.dag.derivative import tangents
from cotree.dag.traverse import substitute

if TYPE_CHECKING:
    from collections.abc import Hashable, Mapping

    from cotree.components import Law
    from cotree.dag.nodes import Dag, Node

#: A quantity and a name.
Variable = tuple[str, str]

#: Derivatives along several directions; those that vanish are absent.
Tangent = dict["Hashable", "Node"]


class Rule(Protocol):
    """Equation by which a variable follows from others."""

    @property
    def needs(self) -> tuple[Variable, ...]:
        """The variables that it follows from."""
        ...

    def value(self, dag: Dag, values: Mapping[Variable, Node]) -> Node:
        """Form the variable."""
        ...

    def tangent(
        self, values: Mapping[Variable, Node], d: Mapping[Variable, Tangent], given: Given
    ) -> Tangent:
        """Form its derivatives along all directions.

        Parameters
        ----------
        values : mapping of Variable to Node
            The variables.
        d : mapping of Variable to Tangent
            Their derivatives.
        given : callable
            Differentiates nodes of states, parameters, inputs and fields.

        References
        ----------
        [1] eq. 4.
        """
        ...


class Given(Protocol):
    """Function that differentiates nodes of states, parameters, inputs and fields."""

    def __call__(self, node: Node) -> Tangent:
        """Differentiate a node along all directions."""
        ...


def added(total: Tangent, key: Hashable, term: Node) -> None:
    """Add a term to the derivative along one direction.

    Parameters
    ----------
    total : Tangent
        The derivatives so far, changed in place; one that vanishes is taken out.
    key : hashable
        The direction.
    term : Node
        What to add.
    """
    if term.is_zero:
        return
    known = total.get(key)
    result = term if known is None else known + term
    # Tangents hold only what does not vanish, so that later rules skip it.
    if result.is_zero:
        del total[key]
    else:
        total[key] = result


@dataclass(frozen=True)
class Sum:
    """A sum of variables with signs: an f-circuit or an f-cutset equation."""

    terms: tuple[tuple[int, Variable], ...]

    @property
    def needs(self) -> tuple[Variable, ...]:
        """The summands."""
        return tuple(variable for _, variable in self.terms)

    def value(self, dag: Dag, values: Mapping[Variable, Node]) -> Node:
        """Sum."""
        total = dag.zero
        for sign, variable in self.terms:
            total = total + values[variable] if sign > 0 else total - values[variable]
        return total

    def tangent(
        self, values: Mapping[Variable, Node], d: Mapping[Variable, Tangent], given: Given
    ) -> Tangent:
        """Sum the derivatives."""
        total: Tangent = {}
        for sign, variable in self.terms:
            for key, term in d[variable].items():
                added(total, key, term if sign > 0 else -term)
        return total


@dataclass(frozen=True)
class Lawful:
    """A terminal equation."""

    law: Law
    arguments: tuple[tuple[str, Variable], ...]

    @property
    def needs(self) -> tuple[Variable, ...]:
        """The law's arguments."""
        return tuple(variable for _, variable in self.arguments)

    def _known(self, values: Mapping[Variable, Node]) -> dict[str, Node]:
        return {name: values[variable] for name, variable in self.arguments}

    def value(self, dag: Dag, values: Mapping[Variable, Node]) -> Node:
        """Evaluate the law."""
        return self.law.value(dag, self._known(values))

    def tangent(
        self, values: Mapping[Variable, Node], d: Mapping[Variable, Tangent], given: Given
    ) -> Tangent:
        """Sum the law's partial derivatives times those of its arguments."""
        # Arguments that do not change along any direction need no partial derivative.
        changing = {name: variable for name, variable in self.arguments if d[variable]}
        total: Tangent = {}
        if not changing:
            return total
        known = self._known(values)
        dag = next(iter(known.values())).dag
        for name, variable in changing.items():
            partial = self.law.partial_value(dag, known, name)
            if partial is not None:
                for key, term in d[variable].items():
                    added(total, key, partial * term)
        return total


@dataclass(frozen=True)
class FieldRule:
    """A field of a component, or a state: a node of symbols.

    Attributes
    ----------
    node : Node
        The value; the variables that it is made of stand in it as symbols.
    variables : tuple of (Node, Variable)
        These symbols.
    """

    node: Node
    variables: tuple[tuple[Node, Variable], ...] = ()

    @property
    def needs(self) -> tuple[Variable, ...]:
        """The variables that it is made of."""
        return tuple(variable for _, variable in self.variables)

    def value(self, dag: Dag, values: Mapping[Variable, Node]) -> Node:
        """Put the variables in the place of their symbols."""
        if not self.variables:
            return self.node
        known = {symbol: values[variable] for symbol, variable in self.variables}
        return substitute([self.node], known)[0]

    def tangent(
        self, values: Mapping[Variable, Node], d: Mapping[Variable, Tangent], given: Given
    ) -> Tangent:
        """Differentiate by symbols and by variables."""
        total = dict(given(self.node))
        if not self.variables:
            return total
        known = {symbol: values[variable] for symbol, variable in self.variables}
        total = dict(zip(total, substitute(list(total.values()), known), strict=True))
        for symbol, variable in self.variables:
            if d[variable]:
                (partial,) = substitute(tangents([self.node], {symbol: symbol.dag.one}), known)
                for key, term in d[variable].items():
                    added(total, key, partial * term)
        return total


@dataclass(frozen=True)
class Unknown:
    """An unknown that an equation determines: the variable ``residual`` must be zero."""

    residual: Variable

    @property
    def needs(self) -> tuple[Variable, ...]:
        """The equation."""
        return (self.residual,)

    def value(self, dag: Dag, values: Mapping[Variable, Node]) -> Node:
        """Blocks of equations give it; see :mod:`cotree.formulation.networks.blocks`."""
        raise NotImplementedError

    def tangent(
        self, values: Mapping[Variable, Node], d: Mapping[Variable, Tangent], given: Given
    ) -> Tangent:
        """Blocks of equations give it."""
        raise NotImplementedError
