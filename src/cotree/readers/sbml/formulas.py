"""Translation of SBML's MathML, given as libsbml's syntax trees, to expressions of scenes.

A part that becomes too long for one expression is cut off: it becomes a separate quantity of the
scene, and the rest contains its name.

Nothing is evaluated. Functions of the model are expanded at each call; a piecewise function becomes
``where``. docs/sbml.md says which operations are supported.
"""

from __future__ import annotations

import ast
import math
from dataclasses import dataclass, field, replace
from functools import cache
from itertools import pairwise
from typing import TYPE_CHECKING, Any

from cotree.errors import ExpressionError, brief, nearest
from cotree.scene.expressions import number_tree

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence


#: Nodes and levels of a tree above which a part is cut off. The text of a scene's expression has
#: at most 4000 characters and 100 levels; a node takes a name of up to 60 letters.
_LARGEST, _HIGHEST = 50, 30

_OPERATORS: dict[str, type[ast.operator]] = {
    "+": ast.Add,
    "-": ast.Sub,
    "*": ast.Mult,
    "/": ast.Div,
    "**": ast.Pow,
}


@dataclass(frozen=True)
class Term:
    """A partly built expression.

    Attributes
    ----------
    tree : ast.expr
        The expression.
    size, height : int
        Its numbers of nodes and levels.
    """

    tree: ast.expr
    size: int = 1
    height: int = 1

    @property
    def text(self) -> str:
        """The expression in the syntax of scenes."""
        return ast.unparse(self.tree)


def number(value: float) -> Term:
    """Make a number.

    Raises
    ------
    ExpressionError
        If it is not finite.
    """
    if not math.isfinite(value):
        raise ExpressionError(f"contains {value}, which is not finite")
    # Integers are written without a decimal point.
    is_whole = value == int(value) and abs(value) < 1e15
    return Term(number_tree(int(value) if is_whole else value))


def name(identifier: str) -> Term:
    """Make a name, which may contain a dot."""
    edge, _, variable = identifier.partition(".")
    tree: ast.expr = ast.Name(edge)
    return Term(ast.Attribute(tree, variable) if variable else tree)


@dataclass
class TermMaker:
    """Combines terms, and cuts off parts that have become too large.

    Attributes
    ----------
    cut : callable
        Declares a quantity: takes an expression and the beginning of a name, and returns the name.
    """

    cut: Callable[[str, str], str]

    def _made(self, tree: ast.expr, *parts: Term) -> Term:
        size, height = 1 + sum(p.size for p in parts), 1 + max(p.height for p in parts)
        made = Term(tree, size, height)
        return name(self.cut(made.text, "part")) if size > _LARGEST or height > _HIGHEST else made

    def operate(self, left: Term, symbol: str, right: Term) -> Term:
        """Join two terms by an operator."""
        return self._made(ast.BinOp(left.tree, _OPERATORS[symbol](), right.tree), left, right)

    def negated(self, term: Term) -> Term:
        """Change the sign of a term."""
        return self._made(ast.UnaryOp(ast.USub(), term.tree), term)

    def call(self, function: str, *terms: Term) -> Term:
        """Call a function of scenes."""
        return self._made(ast.Call(ast.Name(function), [t.tree for t in terms], []), *terms)

    def balanced(self, join: Callable[[Term, Term], Term], terms: Sequence[Term]) -> Term:
        """Join many terms in a tree whose height is the logarithm of their number."""
        # A sum of a thousand terms that is nested to the left would be a thousand levels deep.
        if len(terms) == 1:
            return terms[0]
        half = (len(terms) + 1) // 2
        return join(self.balanced(join, terms[:half]), self.balanced(join, terms[half:]))

    def where(self, condition: Term, accepted: Term, refused: Term) -> Term:
        """Choose between two terms."""
        parts = (condition, accepted, refused)
        return self._made(ast.Call(ast.Name("where"), [p.tree for p in parts], []), *parts)


def compare(left: Term, operator: type[ast.cmpop], right: Term) -> Term:
    """Compare two terms, to a condition."""
    tree = ast.Compare(left.tree, [operator()], [right.tree])
    return Term(tree, left.size + right.size + 1, max(left.height, right.height) + 1)


def combine(operator: type[ast.boolop], conditions: Sequence[Term]) -> Term:
    """Join conditions by ``and`` or ``or``."""
    if len(conditions) == 1:
        return conditions[0]
    tree = ast.BoolOp(operator(), [c.tree for c in conditions])
    return Term(tree, sum(c.size for c in conditions), 1 + max(c.height for c in conditions))


def contrary(condition: Term) -> Term:
    """Negate a condition."""
    return Term(ast.UnaryOp(ast.Not(), condition.tree), condition.size + 1, condition.height + 1)


@cache
def _kinds() -> dict[int, str]:
    """Name the types of libsbml's nodes, without the prefix."""
    import libsbml

    names = (n for n in dir(libsbml) if n.startswith("AST_"))
    # Of types with two names, the alphabetically first is assigned last and remains.
    return {getattr(libsbml, n): n.removeprefix("AST_") for n in sorted(names, reverse=True)}


def kind_of(node: Any) -> str:
    """Return the type of a node of libsbml: ``PLUS``, ``FUNCTION_SIN``."""
    return _kinds().get(node.getType(), "UNKNOWN")


def children(node: Any) -> list[Any]:
    """List the children of a node."""
    return [node.getChild(i) for i in range(node.getNumChildren())]


_DEEPEST = 200  # levels, with the functions of the model expanded
# Nodes of one formula, and of all formulas: expanding nested calls can grow exponentially.
_MOST, _MOST_OF_ALL = 20_000, 2_000_000
_AVOGADRO = 6.02214179e23  # 1/mol, the value that SBML Level 3 prescribes

#: Functions that scenes have, by the name of libsbml's node.
_SAME = {
    "ABS": "abs",
    "ARCCOS": "acos",
    "ARCSIN": "asin",
    "ARCTAN": "atan",
    "COS": "cos",
    "COSH": "cosh",
    "EXP": "exp",
    "FLOOR": "floor",
    "LN": "log",
    "SIN": "sin",
    "SINH": "sinh",
    "TAN": "tan",
    "TANH": "tanh",
}
#: Reciprocals of functions, and functions of reciprocals.
_RECIPROCAL = {
    "COT": "tan",
    "COTH": "tanh",
    "CSC": "sin",
    "CSCH": "sinh",
    "SEC": "cos",
    "SECH": "cosh",
}
_OF_RECIPROCAL = {
    "ARCCSC": "ARCSIN",
    "ARCSEC": "ARCCOS",
    "ARCCOTH": "ARCTANH",
    "ARCSECH": "ARCCOSH",
    "ARCCSCH": "ARCSINH",
    "ARCCOT": "ARCTAN",
}

#: Comparisons, by the name of libsbml's node.
RELATIONS: dict[str, type[ast.cmpop]] = {
    "LT": ast.Lt,
    "LEQ": ast.LtE,
    "GT": ast.Gt,
    "GEQ": ast.GtE,
}

#: Operations that are not supported, with the text of the message.
_REFUSED = {
    "FUNCTION_DELAY": (
        "delay, which is not supported: approximate it by a chain of species or rate rules"
    ),
    "FUNCTION_FACTORIAL": "factorial, which is not supported: write its value",
}


@dataclass
class FormulaReader:
    """Reads formulas of a model.

    Attributes
    ----------
    functions : mapping of str to node
        The model's functions by id: the trees of their lambdas.
    symbol : callable
        Returns the term of an identifier.
    time : Term
        The time: ``t``, or zero at the start.
    make : TermMaker
        Makes terms.
    rate : callable
        Returns the term of the rate of change of a quantity, read by the given reader.
    """

    functions: Mapping[str, Any]
    symbol: Callable[[str], Term]
    time: Term
    make: TermMaker
    rate: Callable[[str, FormulaReader], Term]
    _bound: Mapping[str, Term] = field(default_factory=dict)
    _depth: int = 0
    _calls: tuple[str, ...] = ()
    _count: list[int] = field(default_factory=lambda: [0])  # nodes of a formula, shared by copies
    _total: list[int] = field(default_factory=lambda: [0])

    def read(self, node: Any, bound: Mapping[str, Term] | None = None) -> Term:
        """Read a formula whose value is a number.

        Parameters
        ----------
        node : libsbml.ASTNode
            Its tree.
        bound : mapping of str to Term, optional
            Names with a local meaning in the formula: local parameters.

        Raises
        ------
        ExpressionError
            If scenes have no equivalent; the message continues the description of the formula.
        """
        return self._inner(bound or {})._value(node)

    def condition(self, node: Any) -> Term:
        """Read a formula whose value is Boolean.

        Raises
        ------
        ExpressionError
            As :meth:`read`.
        """
        return self._inner({})._condition(node)

    def _inner(self, bound: Mapping[str, Term], *calls: str) -> FormulaReader:
        if not calls:
            self._count[0] = 0
        return replace(self, _bound=bound, _calls=(*self._calls, *calls))

    def _descend(self, node: Any) -> str:
        self._depth += 1
        self._count[0] += 1
        self._total[0] += 1
        if self._depth > _DEEPEST:
            raise ExpressionError(f"is nested deeper than {_DEEPEST} levels")
        if self._count[0] > _MOST:
            raise ExpressionError(f"has more than {_MOST} operations with functions expanded")
        if self._total[0] > _MOST_OF_ALL:
            raise ExpressionError(f"brings all formulas to more than {_MOST_OF_ALL} operations")
        if node is None:
            raise ExpressionError("contains an operation without an operand")
        return kind_of(node)

    def _value(self, node: Any) -> Term:
        kind = self._descend(node)
        try:
            return self._leaf(kind, node) or self._operation(kind, node)
        finally:
            self._depth -= 1

    def _leaf(self, kind: str, node: Any) -> Term | None:
        match kind:
            case "INTEGER" | "REAL" | "REAL_E" | "RATIONAL":
                return number(node.getValue())
            case "CONSTANT_PI":
                return name("pi")
            case "CONSTANT_E":
                return self.make.call("exp", number(1.0))
            case "NAME_AVOGADRO":
                return number(_AVOGADRO)
            case "NAME_TIME":
                return self.time
            case "NAME":
                identifier = node.getName()
                return self._bound.get(identifier) or self.symbol(identifier)
        return None

    def _operation(self, kind: str, node: Any) -> Term:
        parts, make = children(node), self.make
        if kind in _REFUSED:
            raise ExpressionError(f"contains {_REFUSED[kind]}")
        if kind == "FUNCTION_RATE_OF":
            return self._rate(parts)
        if kind == "FUNCTION_PIECEWISE":
            return self._piecewise(parts)
        if kind == "FUNCTION":
            return self._call(node.getName(), [self._value(part) for part in parts])
        if kind.startswith(("RELATIONAL_", "LOGICAL_")) or kind in (
            "CONSTANT_TRUE",
            "CONSTANT_FALSE",
        ):
            # A Boolean counts as one or zero if a number is expected.
            return make.where(self._condition_of(kind, node), number(1.0), number(0.0))
        if kind in ("PLUS", "TIMES"):
            parts = _chain(node, kind)
        terms = [self._value(part) for part in parts]
        function = kind.removeprefix("FUNCTION_")
        match function, terms:
            case "PLUS" | "TIMES", []:
                return number(0.0 if kind == "PLUS" else 1.0)
            case "PLUS" | "TIMES", _:
                sign = "+" if kind == "PLUS" else "*"
                return make.balanced(lambda a, b: make.operate(a, sign, b), terms)
            case "MINUS", [one]:
                return make.negated(one)
            case "MINUS", [left, right]:
                return make.operate(left, "-", right)
            case "DIVIDE", [left, right]:
                return make.operate(left, "/", right)
            case "POWER", [left, right]:
                return make.operate(left, "**", right)
            case "ROOT", [one] | [Term(tree=ast.Constant(value=2)), one]:
                return make.call("sqrt", one)
            case "ROOT", [degree, one]:
                return make.operate(one, "**", make.operate(number(1.0), "/", degree))
            case "LOG", [one]:
                return self._logarithm(number(10.0), one)
            case "LOG", [base, one]:
                return self._logarithm(base, one)
            case "QUOTIENT", [left, right]:
                return self._quotient(left, right)
            case "REM", [left, right]:
                whole = make.operate(right, "*", self._quotient(left, right))
                return make.operate(left, "-", whole)
            case "MAX" | "MIN", [_, *_]:
                return make.balanced(lambda a, b: make.call(function.lower(), a, b), terms)
            case _, [one]:
                return self._of_one(function, one)
        raise ExpressionError(f"contains '{_told(kind, node)}', which is not supported")

    def _quotient(self, left: Term, right: Term) -> Term:
        """Divide, and round towards zero: the remainder has the sign of the dividend."""
        make = self.make
        ratio = make.operate(left, "/", right)
        up = make.negated(make.call("floor", make.negated(ratio)))
        return make.where(compare(ratio, ast.Lt, number(0.0)), up, make.call("floor", ratio))

    def _logarithm(self, base: Term, one: Term) -> Term:
        make = self.make
        return make.operate(make.call("log", one), "/", make.call("log", base))

    def _of_one(self, function: str, one: Term) -> Term:
        make = self.make
        if function in _SAME:
            return make.call(_SAME[function], one)
        if function in _RECIPROCAL:
            return make.operate(number(1.0), "/", make.call(_RECIPROCAL[function], one))
        if function in _OF_RECIPROCAL:
            return self._of_one(_OF_RECIPROCAL[function], make.operate(number(1.0), "/", one))
        if function == "CEILING":
            return make.negated(make.call("floor", make.negated(one)))
        unit, square = number(1.0), make.operate(one, "*", one)
        if function in ("ARCSINH", "ARCCOSH"):
            sign = "+" if function == "ARCSINH" else "-"
            root = make.call("sqrt", make.operate(square, sign, unit))
            return make.call("log", make.operate(one, "+", root))
        if function == "ARCTANH":
            ratio = make.operate(make.operate(unit, "+", one), "/", make.operate(unit, "-", one))
            return make.operate(make.call("log", ratio), "/", number(2.0))
        raise ExpressionError(f"contains '{function.lower()}', which is not supported")

    def _rate(self, parts: list[Any]) -> Term:
        identifier = parts[0].getName() if len(parts) == 1 else None
        if not identifier or kind_of(parts[0]) != "NAME":
            raise ExpressionError("contains rateOf of something that is not an identifier")
        if identifier not in self._bound:
            return self.rate(identifier, replace(self, _bound={}, _calls=()))
        if self._calls:
            raise ExpressionError(
                f"contains rateOf of an argument of function '{self._calls[-1]}', which is not "
                "supported: write rateOf in the formula that calls the function"
            )
        return number(0.0)  # a local parameter

    def _piecewise(self, parts: list[Any]) -> Term:
        # Values and conditions alternate; the value of otherwise comes last.
        if len(parts) % 2 == 0:
            raise ExpressionError(
                "contains piecewise without otherwise, which has no value if no condition is true: "
                "add otherwise"
            )
        found = self._value(parts[-1])
        for value, condition in reversed(list(zip(parts[:-1:2], parts[1::2], strict=True))):
            found = self.make.where(self._condition(condition), self._value(value), found)
        return found

    def _call(self, function: str, arguments: list[Term]) -> Term:
        if function not in self.functions:
            hint = nearest(function, self.functions)
            raise ExpressionError(f"calls '{brief(function)}', which is not a function{hint}")
        if function in self._calls:
            raise ExpressionError(f"calls '{function}', which calls itself")
        *names, body = children(self.functions[function])
        if len(names) != len(arguments):
            raise ExpressionError(
                f"calls '{function}' with {len(arguments)} arguments instead of {len(names)}"
            )
        bound = dict(zip((n.getName() for n in names), arguments, strict=True))
        return self._inner(bound, function)._value(body)

    def _condition(self, node: Any) -> Term:
        kind = self._descend(node)
        try:
            return self._condition_of(kind, node)
        finally:
            self._depth -= 1

    def _condition_of(self, kind: str, node: Any) -> Term:
        parts = children(node)
        if kind in ("CONSTANT_TRUE", "CONSTANT_FALSE"):
            value = number(1.0 if kind == "CONSTANT_TRUE" else 0.0)
            return compare(value, ast.Gt, number(0.0))
        if kind == "FUNCTION" and node.getName() in self.functions:
            bound_body = children(self.functions[node.getName()])
            return self._called_condition(node.getName(), bound_body, parts)
        relation = kind.removeprefix("RELATIONAL_")
        if kind != relation and len(parts) >= 2:
            terms = [self._value(part) for part in parts]
            return combine(ast.And, [_relate(relation, a, b) for a, b in pairwise(terms)])
        match kind, [self._condition(part) for part in parts] if "LOGICAL" in kind else []:
            case "LOGICAL_AND", [_, *_] as conditions:
                return combine(ast.And, conditions)
            case "LOGICAL_OR", [_, *_] as conditions:
                return combine(ast.Or, conditions)
            case "LOGICAL_NOT", [one]:
                return contrary(one)
            case "LOGICAL_IMPLIES", [a, b]:
                return combine(ast.Or, [contrary(a), b])
            case "LOGICAL_XOR", [a, b]:
                sides = [combine(ast.And, [a, contrary(b)]), combine(ast.And, [contrary(a), b])]
                return combine(ast.Or, sides)
        raise ExpressionError(
            f"contains '{_told(kind, node)}' instead of a condition: compare two values"
        )

    def _called_condition(self, function: str, lambda_parts: list[Any], given: list[Any]) -> Term:
        *names, body = lambda_parts
        if function in self._calls or len(names) != len(given):
            raise ExpressionError(
                f"calls '{function}' recursively or with the wrong number of arguments"
            )
        terms = [self._value(part) for part in given]
        bound = dict(zip((n.getName() for n in names), terms, strict=True))
        return self._inner(bound, function)._condition(body)


def _chain(node: Any, kind: str) -> list[Any]:
    """List the operands of a sum or product, with nested ones of the same kind flattened."""
    # Some tools write a sum of hundreds of terms as nested sums of two.
    found, waiting = [], [node]
    while waiting:
        own = waiting.pop()
        if own is not None and kind_of(own) == kind and own.getNumChildren():
            waiting += reversed(children(own))
        else:
            found.append(own)
    return found if found != [node] else []


def _relate(relation: str, a: Term, b: Term) -> Term:
    if relation == "EQ":
        return combine(ast.And, [compare(a, ast.LtE, b), compare(a, ast.GtE, b)])
    if relation == "NEQ":
        return combine(ast.Or, [compare(a, ast.Lt, b), compare(a, ast.Gt, b)])
    return compare(a, RELATIONS[relation], b)


def _told(kind: str, node: Any) -> str:
    return brief(node.getName() or kind.removeprefix("FUNCTION_").lower())
