"""Formulas as text, with their derivatives: what the steps of a formulation are written with.

A :class:`Formula` is a sum of products in the order its author wrote it; zeros vanish, nothing
else is rearranged. A :class:`Pair` carries a formula with its derivative along one parameter, so
that the terminal equations of the sensitivity graph follow from those of the first by the product
rule, term by term (paper, Eq. (3) and (4)).
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Atom:
    """A text, and whether it needs parentheses beside another factor."""

    text: str
    is_open: bool = False


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
    if isinstance(factor, Atom):
        return f"({factor.text})" if factor.is_open and not is_bare else factor.text
    return str(factor) if is_all else f"({factor})"


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
        a, b = _as_term(self), _as_term(other)
        return Formula((Term(a.sign * b.sign, a.scalars + b.scalars, b.vector),))


ZERO = Formula()
ONE = Formula((Term(1),))


def _as_term(formula: Formula, as_vector: bool = False) -> Term:
    """See a formula as one term: a sum becomes a factor of its own."""
    if len(formula.terms) == 1:
        return formula.terms[0]
    if as_vector or any(term.vector is not None for term in formula.terms):
        return Term(1, (), formula)
    return Term(1, (formula,))


def scalar(text: str, is_open: bool = False) -> Formula:
    """Write a scalar; ``is_open`` if its text is a sum."""
    return Formula((Term(1, (Atom(text, is_open),)),))


def vector(text: str, is_open: bool = False) -> Formula:
    """Write a vector; ``is_open`` if its text is a product of vectors."""
    return Formula((Term(1, (), Atom(text, is_open)),))


def _operand(factor: Atom | Formula | None) -> str:
    assert factor is not None
    is_open = isinstance(factor, Formula) or factor.is_open
    text = str(factor) if isinstance(factor, Formula) else factor.text
    return f"({text})" if is_open else text


def cross(a: Formula, b: Formula) -> Formula:
    """Write a vector product, signs and scalars in front."""
    if a.is_zero or b.is_zero:
        return ZERO
    left, right = _as_term(a), _as_term(b)
    text = f"{_operand(left.vector)} × {_operand(right.vector)}"
    return Formula((Term(left.sign * right.sign, left.scalars + right.scalars, Atom(text, True)),))


def dot(a: Formula, b: Formula) -> Formula:
    """Write a scalar product, signs and scalars in front."""
    if a.is_zero or b.is_zero:
        return ZERO
    left, right = _as_term(a), _as_term(b)
    text = Atom(f"{_operand(left.vector)}·{_operand(right.vector)}", True)
    return Formula((Term(left.sign * right.sign, (*left.scalars, *right.scalars, text)),))


def applied(tensor: Formula, b: Formula) -> Formula:
    """Write a tensor applied to a vector; the tensor is one symbol."""
    return _as_vector(dot(tensor, b))


def _as_vector(formula: Formula) -> Formula:
    """See the last scalar of a term as its vector."""
    return Formula(tuple(Term(t.sign, t.scalars[:-1], t.scalars[-1]) for t in formula.terms))


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
