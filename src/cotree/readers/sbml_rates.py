"""Rates of change of the quantities of an SBML model, for ``rateOf`` in formulas."""

from __future__ import annotations

from typing import TYPE_CHECKING

from cotree.errors import ExpressionError, brief, nearest
from cotree.readers.sbml_content import Formula
from cotree.readers.sbml_located import explained
from cotree.readers.sbml_roles import Role
from cotree.readers.sbml_trees import Term, name, number

if TYPE_CHECKING:
    from collections.abc import Callable

    from cotree.readers.sbml_content import SbmlContent
    from cotree.readers.sbml_math import FormulaReader
    from cotree.readers.sbml_roles import Roles


class Rates:
    """Terms of the rates of change that formulas contain.

    Parameters
    ----------
    content : SbmlContent
        The model.
    roles : Roles
        Roles of its quantities.
    declare : callable
        Declares a quantity of the scene: takes an expression and the beginning of a name, and
        returns the name.
    """

    def __init__(
        self, content: SbmlContent, roles: Roles, declare: Callable[[str, str], str]
    ) -> None:
        self._content, self._roles, self._declare = content, roles, declare
        self._found: dict[str, Term] = {}
        self._open: list[str] = []

    def of(self, id: str, reader: FormulaReader) -> Term:
        """Return the rate of change of a quantity, in units of its identifier per time.

        Raises
        ------
        ExpressionError
            If an assignment rule determines the quantity, or its rate depends on itself.
        """
        if id in self._open:
            raise ExpressionError(f"depends on itself through rateOf({brief(id)})")
        if id not in self._found:
            self._open.append(id)
            try:
                term = self._formed(id, reader)
            finally:
                self._open.pop()
            # A name in place of the expression, which several formulas may need.
            is_short = term.size == 1
            self._found[id] = term if is_short else name(self._declare(term.text, f"rate_of_{id}"))
        return self._found[id]

    def _formed(self, id: str, reader: FormulaReader) -> Term:
        make, content = reader.make, self._content
        if id not in content.quantities:
            raise ExpressionError(
                f"contains rateOf({brief(id)}), but '{brief(id)}' is not a compartment, species or "
                f"parameter{nearest(id, content.quantities)}"
            )
        quantity, role = content.quantities[id], self._roles.of[id]
        if id in content.assignments and role is not Role.FIXED:
            raise ExpressionError(
                f"contains rateOf({brief(id)}), but '{brief(id)}' has an assignment rule: replace "
                "rateOf by the derivative of the rule"
            )
        if role is Role.RATE:
            formula = content.rates[id]
            with explained(formula):
                return reader.read(formula.node)
        if role is Role.CONCENTRATION:
            return make.operate(self._flow(id, reader), "/", reader.symbol(quantity.compartment))
        if role is Role.AMOUNT and quantity.is_amount:
            return self._flow(id, reader)
        if role not in (Role.AMOUNT, Role.DILUTED):
            return number(0.0)
        # c = n/V: c' = (n' - c V')/V.
        size = reader.symbol(quantity.compartment)
        growth = self.of(quantity.compartment, reader)
        diluted = make.operate(reader.symbol(id), "*", growth)
        if role is Role.DILUTED:
            return make.operate(make.negated(diluted), "/", size)
        flow = make.operate(self._flow(id, reader), "-", diluted)
        return make.operate(flow, "/", size)

    def _flow(self, id: str, reader: FormulaReader) -> Term:
        """Return the sum of the molar flows of all reactions to a species."""
        make, terms = reader.make, []
        for reaction in self._content.reactions:
            for part in reaction.parts:
                if part.species != id:
                    continue
                count = self._stoichiometry(part.stoichiometry, reader)
                term = make.operate(count, "*", reader.symbol(reaction.id))
                terms.append(make.negated(term) if part.sign < 0 else term)
        if not terms:
            return number(0.0)
        total = make.balanced(lambda a, b: make.operate(a, "+", b), terms)
        conversion = self._content.quantities[id].conversion
        return make.operate(reader.symbol(conversion), "*", total) if conversion else total

    def _stoichiometry(self, given: float | str | Formula, reader: FormulaReader) -> Term:
        if isinstance(given, Formula):
            with explained(given):
                return reader.read(given.node)
        if isinstance(given, str) and given in self._roles.unnamed:
            value = self._content.quantities[given].value
            return reader.symbol(given) if value is None else number(value)
        return reader.symbol(given) if isinstance(given, str) else number(given)
