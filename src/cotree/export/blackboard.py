"""Formulas as text, with their derivatives: what the steps of a formulation are written with.

A :class:`Formula` is a sum of products in the order its author wrote it; zeros vanish, nothing
else is rearranged. A :class:`Pair` carries a formula with its derivative along one parameter, so
that the terminal equations of the sensitivity graph follow from those of the first by the product
rule, term by term (paper, Eq. (3) and (4)).
"""

from __future__ import annotations

from dataclasses import dataclass

#: How tightly a text holds together: a sum, a product of vectors, anything tighter.
SUM, PRODUCT, SYMBOL = range(3)


@dataclass(frozen=True)
class Atom:
    """A text, and how tightly it holds together."""

    text: str
    level: int = SYMBOL


@dataclass(frozen=True)
class Term:
    """A signed product of scalar factors and at most one vector."""

    sign: int
    scalars: tuple[Atom | Formula, ...] = ()
    vector: Atom | Formula | None = None

    @property
    def factors(self) -> tuple[Atom | Formula, ...]:
        """All factors, the vector last."""
        return self.scalars if self.vector is None else (*self.scalars, self.vector)

    def text(self, is_alone: bool) -> str:
        """Write the term without its sign; ``is_alone`` leaves out parentheses around all of it."""
        bare = len(self.factors) == 1
        product = "*".join(
            _guarded(f, bare, bare and is_alone and self.sign > 0) for f in self.scalars
        )
        if self.vector is None:
            return product or "1"
        vector = _guarded(self.vector, bare, bare and is_alone and self.sign > 0)
        return f"{product} {vector}" if product else vector


def _guarded(factor: Atom | Formula, is_bare: bool, is_all: bool) -> str:
    """Write a factor, in parentheses where it needs them."""
    if isinstance(factor, Formula):
        is_kept = is_all
    else:
        is_kept = is_all or factor.level == SYMBOL or (factor.level == PRODUCT and is_bare)
    return text_of(factor) if is_kept else f"({text_of(factor)})"


def text_of(factor: Atom | Formula) -> str:
    """Write a factor as it is."""
    return factor.text if isinstance(factor, Atom) else str(factor)


@dataclass(frozen=True)
class Formula:
    """A sum of terms; without any, zero."""

    terms: tuple[Term, ...] = ()

    def __str__(self) -> str:
        if not self.terms:
            return "0"
        is_alone = len(self.terms) == 1
        first, *others = self.terms
        text = ("-" if first.sign < 0 else "") + first.text(is_alone)
        for term in others:
            text += (" - " if term.sign < 0 else " + ") + term.text(is_alone)
        return text

    @property
    def is_zero(self) -> bool:
        """Whether nothing is left."""
        return not self.terms

    def __add__(self, other: Formula) -> Formula:
        return Formula(self.terms + other.terms)

    def __neg__(self) -> Formula:
        return Formula(tuple(Term(-t.sign, t.scalars, t.vector) for t in self.terms))

    def __sub__(self, other: Formula) -> Formula:
        return self + -other

    def __mul__(self, other: Formula) -> Formula:
        """Multiply a scalar with a scalar or a vector."""
        if self.is_zero or other.is_zero:
            return ZERO
        b = _as_term(other)
        # A sum of scalars is spread over a vector: -(r - l0) i - k*r_k i.
        factors = [_as_term(self)] if b.vector is None else self.terms
        return Formula(
            tuple(Term(a.sign * b.sign, a.scalars + b.scalars, b.vector) for a in factors)
        )


ZERO = Formula()
ONE = Formula((Term(1),))


def _as_term(formula: Formula) -> Term:
    """See a formula as one term: a sum becomes a factor of its own."""
    if len(formula.terms) == 1:
        return formula.terms[0]
    if any(term.vector is not None for term in formula.terms):
        return Term(1, (), formula)
    return Term(1, (formula,))


def scalar(text: str, level: int = SYMBOL) -> Formula:
    """Write a scalar."""
    return Formula((Term(1, (Atom(text, level),)),))


def vector(text: str) -> Formula:
    """Write a vector."""
    return Formula((Term(1, (), Atom(text)),))


def _operand(factor: Atom | Formula | None) -> str:
    assert factor is not None  # vectors are multiplied with vectors only
    is_symbol = isinstance(factor, Atom) and factor.level == SYMBOL
    return text_of(factor) if is_symbol else f"({text_of(factor)})"


def cross(a: Formula, b: Formula) -> Formula:
    """Write a vector product, signs and scalars in front."""
    if a.is_zero or b.is_zero:
        return ZERO
    left, right = _as_term(a), _as_term(b)
    product = Atom(f"{_operand(left.vector)} × {_operand(right.vector)}", PRODUCT)
    return Formula((Term(left.sign * right.sign, left.scalars + right.scalars, product),))


def dot(a: Formula, b: Formula) -> Formula:
    """Write a scalar product, signs and scalars in front."""
    if a.is_zero or b.is_zero:
        return ZERO
    left, right = _as_term(a), _as_term(b)
    product = Atom(f"{_operand(left.vector)}·{_operand(right.vector)}", PRODUCT)
    return Formula((Term(left.sign * right.sign, (*left.scalars, *right.scalars, product)),))


def applied(tensor: Formula, b: Formula) -> Formula:
    """Write a tensor applied to a vector; the result is a vector."""
    terms = dot(tensor, b).terms
    return Formula(tuple(Term(t.sign, t.scalars[:-1], t.scalars[-1]) for t in terms))


@dataclass(frozen=True)
class Pair:
    """A formula and its derivative along one parameter."""

    value: Formula
    d: Formula = ZERO

    def __add__(self, other: Pair) -> Pair:
        return Pair(self.value + other.value, self.d + other.d)

    def __sub__(self, other: Pair) -> Pair:
        return Pair(self.value - other.value, self.d - other.d)

    def __neg__(self) -> Pair:
        return Pair(-self.value, -self.d)

    def __mul__(self, other: Pair) -> Pair:
        """Multiply a scalar with a scalar or a vector."""
        # A sum that a unit derivative is multiplied with stays together: -(r - l0) - k*r_k.
        return Pair(self.value * other.value, self.d * other.value + self.value * other.d)

    def cross(self, other: Pair) -> Pair:
        """Write a vector product."""
        return Pair(
            cross(self.value, other.value),
            cross(self.d, other.value) + cross(self.value, other.d),
        )

    def dot(self, other: Pair) -> Pair:
        """Write a scalar product."""
        return Pair(
            dot(self.value, other.value), dot(self.d, other.value) + dot(self.value, other.d)
        )

    def applied(self, other: Pair) -> Pair:
        """Write this tensor applied to a vector."""
        return Pair(
            applied(self.value, other.value),
            applied(self.d, other.value) + applied(self.value, other.d),
        )


NOTHING = Pair(ZERO)
