"""Rules: how each variable of a network follows from others, with its differentiated form.

A variable is a pair of a quantity and a name. Its rule is an f-circuit or f-cutset equation (a
sum) or a terminal equation (a law). Differentiated, sums stay sums and laws become sums of their
pre-formed partial derivatives, so a sensitivity graph has the same topology (paper, Eq. (4)).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

from cotree.dag.derivative import tangents
from cotree.dag.nodes import substitute

if TYPE_CHECKING:
    from collections.abc import Collection, Hashable, Iterable, Mapping

    from cotree.components import Law
    from cotree.dag.nodes import Dag, Node

#: A quantity and a name.
Variable = tuple[str, str]

#: Derivatives along several directions; zero ones are absent.
Tangent = dict["Hashable", "Node"]


class Given(Protocol):
    """Function that differentiates nodes of states, parameters, inputs and fields."""

    def __call__(self, node: Node, standing: Mapping[Node, Node]) -> Tangent:
        """Differentiate a node in which ``standing`` will replace symbols."""
        ...


class Rule:
    """Equation from which a variable follows."""

    @property
    def needs(self) -> tuple[Variable, ...]:
        """The variables from which it follows."""
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
        # A rule that depends on no direction needs no partial derivative.
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
        """The summands."""
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

    node: Node  # the value, with symbols for the variables it depends on
    variables: tuple[tuple[Node, Variable], ...] = ()  # these symbols

    @property
    def needs(self) -> tuple[Variable, ...]:
        """The variables on which it depends."""
        return tuple(variable for _, variable in self.variables)

    def _standing(self, values: Mapping[Variable, Node]) -> dict[Node, Node]:
        """Return the values of the symbols of variables."""
        return {symbol: values[variable] for symbol, variable in self.variables}

    def value(self, dag: Dag, values: Mapping[Variable, Node]) -> Node:
        """Substitute the variables for their symbols."""
        return substitute([self.node], self._standing(values))[0] if self.variables else self.node

    def explicit(self, values: Mapping[Variable, Node], given: Given) -> Tangent:
        """Differentiate by the other symbols."""
        # Derivatives may contain symbols of variables, too, which are replaced as in the field.
        standing = self._standing(values)
        found = given(self.node, standing)
        if not self.variables:
            return dict(found)
        return dict(zip(found, substitute(found.values(), standing), strict=True))

    def partials(
        self, values: Mapping[Variable, Node], changing: Collection[Variable]
    ) -> Iterable[tuple[Variable, Node]]:
        """Differentiate by the symbols of variables."""
        standing = self._standing(values)
        for symbol, variable in self.variables:
            if variable in changing:
                # A field is an expression of the scene; its partial derivatives are formed here.
                along = tangents([self.node], {symbol: symbol.dag.one}, standing)
                yield variable, substitute(along, standing)[0]


@dataclass(frozen=True)
class Unknown(Rule):
    """An unknown, determined such that the variable ``residual`` is zero.

    Its value comes from a block of equations (:mod:`cotree.formulation.networks.solved`).
    """

    residual: Variable

    @property
    def needs(self) -> tuple[Variable, ...]:
        """The equation."""
        return (self.residual,)
