"""Goals of a design as texts: what is to be least, and what has to hold.

In: texts in the grammar of expressions (:mod:`cotree.scene.expressions`), in which a few functions
stand for what a whole run gives: ``end(x)``, ``start(x)``, ``at(2.0, x)``, ``integral(x)``,
``mean(x)``, ``maximum(x)``, ``minimum(x)`` and ``time(event)``. Out: these quantities, and formulas
of them. Nothing is evaluated as Python.
"""

from __future__ import annotations

import ast
from dataclasses import dataclass
from typing import TYPE_CHECKING

from cotree.dag.derivative import adjoints
from cotree.dag.evaluate import evaluate
from cotree.dag.nodes import Dag
from cotree.errors import ExpressionError, ParameterError, brief, nearest
from cotree.scene.expressions import FUNCTIONS, WHERE, Expression, dotted, names_in, parse
from cotree.scene.words import read_tree

if TYPE_CHECKING:
    from collections.abc import Collection, Sequence

#: What a run gives, by the number of arguments of the function that stands for it.
QUANTITIES = {
    "end": 1,
    "start": 1,
    "at": 2,
    "integral": 1,
    "mean": 1,
    "maximum": 1,
    "minimum": 1,
    "time": 1,
}

#: Those that add up over the run, so that jumps inside them do no harm.
SUMMED = ("integral", "mean")

#: Functions that jump, or have a derivative of zero wherever they have one.
_JUMPING = {"sign", "floor", "mod"}

#: Begins names that no scene can have: letters of scenes are those of C.
_MARK = "quantity_ö"

_LONGEST = 4000  # characters, as of expressions
_COMPARISONS: dict[type[ast.cmpop], str] = {
    ast.LtE: "<=",
    ast.Lt: "<=",
    ast.GtE: ">=",
    ast.Gt: ">=",
    ast.Eq: "==",
}


@dataclass(frozen=True)
class Quantity:
    """A number that a run gives.

    Attributes
    ----------
    kind : str
        A key of :data:`QUANTITIES`.
    text : str
        The expression that it is taken of; of ``time`` the name of an event.
    t : float
        When, of ``at``, [s].
    """

    kind: str
    text: str
    t: float = 0.0


class Formula:
    """A formula of quantities and of the parameters that are varied.

    Parameters
    ----------
    expression : Expression
        In which marks stand for quantities.
    n_quantities : int
        Number of all quantities of a design.
    over : sequence of str
        Names that are varied.
    """

    def __init__(self, expression: Expression, n_quantities: int, over: Sequence[str]) -> None:
        dag = Dag()
        self._symbols = [dag.symbol("x", i) for i in range(n_quantities)]
        self._symbols += [dag.symbol("p", i) for i in range(len(over))]
        known = {f"{_MARK}{i}": symbol for i, symbol in enumerate(self._symbols[:n_quantities])}
        known |= dict(zip(over, self._symbols[n_quantities:], strict=True))
        self._node = expression.lower(dag, known.__getitem__)
        self._slopes = adjoints([self._node], [dag.one], self._symbols)

    def value(self, numbers: Sequence[float]) -> tuple[float, list[float]]:
        """Evaluate at quantities and then parameters; give the derivatives by these, too."""
        found = evaluate(
            [self._node, *self._slopes], dict(zip(self._symbols, numbers, strict=True))
        )
        value, *slopes = (float(number) for number in found)
        return value, slopes


@dataclass(frozen=True)
class Condition:
    """A condition: ``formula <= 0``, or ``formula == 0``.

    Attributes
    ----------
    text : str
        As the user wrote it.
    excess : Expression
        The formula, with marks for quantities.
    is_equality : bool
        Whether it is to be zero.
    """

    text: str
    excess: Expression
    is_equality: bool


class Goals:
    """The objective and the conditions of a design, read from texts.

    Parameters
    ----------
    minimise : str
        The objective.
    subject_to : sequence of str
        Conditions.
    parameters : collection of str
        Parameters that are varied: their names stand for themselves, other names for values at the
        end of the run.
    """

    def __init__(
        self, minimise: object, subject_to: Sequence[object], parameters: Collection[str]
    ) -> None:
        self.quantities: list[Quantity] = []
        self._own = set(parameters)
        tree = self._read(minimise, "minimise")
        if isinstance(tree, ast.Compare):
            raise ExpressionError(
                f"minimise: '{brief(minimise)}' is a comparison: it belongs into subject_to"
            )
        self.objective = self._formula(tree, "minimise")
        self.conditions: list[Condition] = []
        for text in subject_to:
            self.conditions += self._conditions(text)

    def _read(self, text: object, where: str) -> ast.expr:
        if not isinstance(text, str) or len(text) > _LONGEST:
            raise ExpressionError(
                f"{where} must be a text of at most {_LONGEST} characters in the grammar of "
                f"expressions, not {brief(repr(text))}"
            )
        try:
            return read_tree(text)
        except ExpressionError as error:
            raise ExpressionError(f"{where}: '{brief(text)}' {error}") from None

    def _conditions(self, text: object) -> list[Condition]:
        """Read a condition; a chain such as ``0 <= x <= 2`` is two of them."""
        tree = self._read(text, "subject_to")
        if not isinstance(tree, ast.Compare):
            raise ExpressionError(
                f"subject_to: '{brief(text)}' compares nothing: write it with <=, >= or =="
            )
        sides = [tree.left, *tree.comparators]
        found = []
        for a, op, b in zip(sides[:-1], tree.ops, sides[1:], strict=True):
            sign = _COMPARISONS.get(type(op))
            if sign is None:
                raise ExpressionError(
                    f"subject_to: '{brief(text)}' compares by something other than <=, >= and =="
                )
            low, high = (b, a) if sign == ">=" else (a, b)
            excess = ast.BinOp(low, ast.Sub(), high)
            shown = f"{ast.unparse(a)} {sign} {ast.unparse(b)}"
            found.append(Condition(shown, self._formula(excess, "subject_to"), sign == "=="))
        return found

    def _formula(self, tree: ast.expr, where: str) -> Expression:
        """Put marks in the place of what runs give."""
        try:
            marked = ast.unparse(_Marking(self, where).visit(tree))
        except RecursionError:
            raise ExpressionError(f"{where} is nested too deeply: split it") from None
        return parse(marked, where)

    def add(self, quantity: Quantity) -> ast.Name:
        """Give the mark of a quantity."""
        if quantity not in self.quantities:
            self.quantities.append(quantity)
        return ast.Name(f"{_MARK}{self.quantities.index(quantity)}")

    def is_own(self, name: str) -> bool:
        """Tell whether a name stands for itself."""
        return name in self._own


class _Marking(ast.NodeTransformer):
    """Replaces what runs give in a tree by marks."""

    def __init__(self, goals: Goals, where: str) -> None:
        self._goals, self._where = goals, where

    def visit_Call(self, node: ast.Call) -> ast.expr:
        name = _called(node)
        if name not in QUANTITIES:
            if name in _JUMPING or name == WHERE:
                self._refuse(
                    f"'{name}' of what a run gives has no derivative that tells where to go: "
                    "use it inside integral(...) only"
                )
            if name not in FUNCTIONS:
                known = nearest(name, [*FUNCTIONS, *QUANTITIES])
                self._refuse(f"calls '{brief(ast.unparse(node.func))}', which is unknown{known}")
            node.args = [self.visit(arg) for arg in node.args]
            return node
        if node.keywords or len(node.args) != QUANTITIES[name]:
            self._refuse(
                f"{name} takes {QUANTITIES[name]} argument{'s' * (QUANTITIES[name] > 1)}"
                + (": a time and an expression" if name == "at" else "")
            )
        inner, t = node.args[-1], 0.0
        for part in ast.walk(inner):
            called = _called(part)
            if called in QUANTITIES:
                self._refuse(f"{called}(...) stands inside {name}(...): take them apart")
            if called in _JUMPING and name not in SUMMED:
                self._refuse(f"{called} jumps, so that {name}(...) of it has no derivative")
        if name == "at":
            t = self._time(node.args[0])
        expression = parse(ast.unparse(inner), f"{self._where}: {name}")
        return self._goals.add(Quantity(name, expression.text, t))

    def _time(self, tree: ast.expr) -> float:
        expression = parse(ast.unparse(tree), f"{self._where}: the time of at")
        if names_in(expression.tree) - {"pi"}:
            self._refuse("the time of at(...) must be a number")
        dag = Dag()
        found = expression.lower(dag, lambda name: dag.zero).value
        assert found is not None  # constants fold
        return float(found)

    def visit_Name(self, node: ast.Name) -> ast.expr:
        return node if self._is_kept(node.id) else self._goals.add(Quantity("end", node.id))

    def visit_Attribute(self, node: ast.Attribute) -> ast.expr:
        # Parameters of parts have dots in their names, as variables have.
        kept = self._is_kept(dotted(node))
        return node if kept else self._goals.add(Quantity("end", ast.unparse(node)))

    def _is_kept(self, name: str) -> bool:
        return name == "pi" or self._goals.is_own(name)

    def _refuse(self, why: str) -> None:
        raise ExpressionError(f"{self._where}: {why}")


def _called(part: ast.AST) -> str:
    """Give the name of the function that a node calls; nothing for other nodes."""
    is_call = isinstance(part, ast.Call) and isinstance(part.func, ast.Name)
    return part.func.id if is_call else ""  # type: ignore[attr-defined]


def check_times(quantities: Sequence[Quantity], span: tuple[float, float]) -> None:
    """Refuse times outside the run."""
    for quantity in quantities:
        if quantity.kind == "at" and not min(span) <= quantity.t <= max(span):
            raise ParameterError(
                f"at({quantity.t:g}, {quantity.text}) is outside the run from t = {span[0]:g} to "
                f"{span[1]:g}"
            )
