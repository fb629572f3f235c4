"""Translation of MathML in SBML, as libsbml's syntax trees, to expressions of scenes.

Functions of the model are expanded at each call. If an expression would become too long, a part of
it becomes a separate quantity of the scene. docs/sbml.md lists the supported operations.
"""

from __future__ import annotations

import ast
import math
from dataclasses import dataclass, field, replace
from functools import cache
from itertools import pairwise
from typing import TYPE_CHECKING, Any

from cotree.errors import ExpressionError, brief, nearest
from cotree.readers.formulas import FORMS, is_condition
from cotree.scene.expressions import map_tree, name_tree, number_tree, shared_tree

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence


#: Maximum number of nodes and of levels of a subtree that does not become a separate quantity. An
#: expression of a scene has at most 4000 characters and 100 levels, and a node may be a name of 60
#: letters.
_LARGEST, _HIGHEST = 50, 30


@dataclass(frozen=True)
class Term:
    """A part of an expression, with its size."""

    tree: ast.expr  # syntax tree of the expression
    #: Number of nodes and of levels of the tree.
    size: int = 1
    height: int = 1

    @property
    def text(self) -> str:
        """The text of the expression in the syntax of scenes."""
        return ast.unparse(self.tree)


def number(value: float) -> Term:
    """Return the term of a number."""
    if not math.isfinite(value):
        raise ExpressionError(f"contains {value}, which is not finite")
    # Integers have no decimal point.
    is_whole = value == int(value) and abs(value) < 1e15
    return Term(number_tree(int(value) if is_whole else value))


def name(identifier: str) -> Term:
    """Return the term of a name, which may contain a dot."""
    return Term(name_tree(identifier))


@dataclass
class TermMaker:
    """Combination of terms; parts that are too large become separate quantities."""

    #: Function that declares a quantity from its expression and name prefix; returns its name.
    cut: Callable[[str, str], str]

    def form(self, form: str, *terms: Term) -> Term:
        """Return the expression or condition ``form``, in which terms replace a, b and c."""
        return self._filled(shared_tree(form), dict(zip("abc", terms, strict=False)))

    def _filled(self, tree: ast.expr, given: Mapping[str, Term]) -> Term:
        if not isinstance(tree, (ast.BinOp, ast.UnaryOp, ast.Call, ast.Compare, ast.BoolOp)):
            return given[tree.id] if isinstance(tree, ast.Name) else Term(tree)
        parts: list[Term] = []

        def filled(part: ast.expr) -> ast.expr | None:
            if part is tree:
                return None
            parts.append(self._filled(part, given))
            return parts[-1].tree

        made = map_tree(tree, filled)
        size, height = 1 + sum(p.size for p in parts), 1 + max(p.height for p in parts)
        # Only values can become separate quantities, not conditions.
        is_large = not is_condition(made) and (size > _LARGEST or height > _HIGHEST)
        return name(self.cut(ast.unparse(made), "part")) if is_large else Term(made, size, height)

    def balanced(self, form: str, terms: Sequence[Term]) -> Term:
        """Combine many terms by a form with two operands, with as few levels as possible."""
        # A sum of a thousand terms would otherwise have a thousand levels.
        if len(terms) == 1:
            return terms[0]
        half = (len(terms) + 1) // 2
        return self.form(form, self.balanced(form, terms[:half]), self.balanced(form, terms[half:]))


@cache
def _kinds() -> dict[int, str]:
    """Return the names of libsbml's node types without prefix, by value."""
    import libsbml

    names = (n for n in dir(libsbml) if n.startswith("AST_"))
    # If a type has two names, the alphabetically first one is assigned last and kept.
    return {getattr(libsbml, n): n.removeprefix("AST_") for n in sorted(names, reverse=True)}


def kind_of(node: Any) -> str:
    """Return the type of a libsbml node, such as ``PLUS`` or ``FUNCTION_SIN``."""
    return _kinds().get(node.getType(), "UNKNOWN")


def children(node: Any) -> list[Any]:
    """Return the children of a node."""
    return [node.getChild(i) for i in range(node.getNumChildren())]


_DEEPEST = 200  # maximum depth of a formula after expansion of the model's functions
# Maximum number of nodes of one formula and of all: expanded calls may grow exponentially.
_MOST, _MOST_OF_ALL = 20_000, 2_000_000
_AVOGADRO = 6.02214179e23  # Avogadro constant of SBML Level 3, [1/mol]

#: Comparisons, by libsbml's name of the node.
RELATIONS = {"LT": "a < b", "LEQ": "a <= b", "GT": "a > b", "GEQ": "a >= b"}
_RELATIONS = RELATIONS | {"EQ": "a <= b and a >= b", "NEQ": "a < b or a > b"}
#: Logical operations, by name and number of operands.
_LOGICAL = {
    ("NOT", 1): "not a",
    ("IMPLIES", 2): "not a or b",
    ("XOR", 2): "a and not b or not a and b",
}

#: Functions with the same name in scenes, and all operations by name and number of arguments.
_SAME = ("ABS", "COS", "COSH", "EXP", "FLOOR", "SIN", "SINH", "TAN", "TANH")
_FORMS = {
    **{(name, 1): f"{name.lower()}(a)" for name in _SAME},
    **{
        (name.upper(), 1): FORMS[name] for name in FORMS if name[:3] in ("arc", "sec", "csc", "cot")
    },
    **{("CEILING", 1): FORMS["ceil"], ("LN", 1): "log(a)", ("MINUS", 1): "-a"},
    **{("MINUS", 2): "a - b", ("DIVIDE", 2): "a/b", ("POWER", 2): "a**b"},
    **{("ROOT", 1): "sqrt(a)", ("ROOT", 2): "b**(1/a)"},
    **{("LOG", 1): "log(a)/log(10)", ("LOG", 2): "log(b)/log(a)"},
    # The quotient is rounded towards zero, so that the remainder has the sign of the dividend.
    ("QUOTIENT", 2): "where(a/b < 0, -floor(-(a/b)), floor(a/b))",
    ("REM", 2): "a - b*where(a/b < 0, -floor(-(a/b)), floor(a/b))",
}
_JOINED = {"PLUS": "a + b", "TIMES": "a*b", "MAX": "max(a, b)", "MIN": "min(a, b)"}

#: Unsupported operations, with the text for the error message.
_BOOLEAN = ("CONSTANT_TRUE", "CONSTANT_FALSE")
_REFUSED = {
    "FUNCTION_DELAY": (
        "delay, which is not supported: approximate it by a chain of species or rate rules"
    ),
    "FUNCTION_FACTORIAL": "factorial, which is not supported: write its value",
}


@dataclass
class FormulaReader:
    """Translator of formulas of a model to terms."""

    functions: Mapping[str, Any]  # syntax trees of the model's functions, by identifier
    symbol: Callable[[str], Term]  # returns the term for an identifier
    time: Term  # term for the time: ``t``, or zero at the start
    make: TermMaker  # combines terms
    #: Function that returns the term for the rate of change of a quantity, given a reader.
    rate: Callable[[str, FormulaReader], Term]
    _bound: Mapping[str, Term] = field(default_factory=dict)
    _depth: int = 0
    _calls: tuple[str, ...] = ()
    _count: list[int] = field(default_factory=lambda: [0])  # number of nodes, which copies share
    _total: list[int] = field(default_factory=lambda: [0])

    def read(self, node: Any, bound: Mapping[str, Term] | None = None) -> Term:
        """Translate a numerical formula; ``bound`` maps local parameters to their terms."""
        return self._inner(bound or {})._value(node)

    def condition(self, node: Any) -> Term:
        """Translate a Boolean formula."""
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
            raise ExpressionError(
                f"increases the operations of all formulas to more than {_MOST_OF_ALL}"
            )
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
                return self.make.form("exp(1)")
            case "NAME_AVOGADRO":
                return number(_AVOGADRO)
            case "NAME_TIME":
                return self.time
            case "NAME":
                identifier = node.getName()
                return self._bound.get(identifier) or self.symbol(identifier)
        return None

    def _operation(self, kind: str, node: Any) -> Term:
        parts = children(node)
        if kind in _REFUSED:
            raise ExpressionError(f"contains {_REFUSED[kind]}")
        if kind == "FUNCTION_RATE_OF":
            return self._rate(parts)
        if kind == "FUNCTION_PIECEWISE":
            return self._piecewise(parts)
        if kind == "FUNCTION":
            reader, body = self._called(node, parts)
            return reader._value(body)
        if kind.startswith(("RELATIONAL_", "LOGICAL_")) or kind in _BOOLEAN:
            # A Boolean counts as 1 or 0 if a number is expected.
            return self.make.form("where(a, 1, 0)", self._condition_of(kind, node))
        if kind in ("PLUS", "TIMES"):
            parts = _chain(node, kind)
        terms = [self._value(part) for part in parts]
        function = kind.removeprefix("FUNCTION_")
        if function in ("PLUS", "TIMES") and not terms:
            return number(0.0 if kind == "PLUS" else 1.0)
        if function in _JOINED and terms:
            return self.make.balanced(_JOINED[function], terms)
        form = _FORMS.get((function, len(terms)))
        if form is None:
            raise ExpressionError(f"contains '{_shown(kind, node)}', which is not supported")
        if function == "ROOT" and getattr(terms[0].tree, "value", None) == 2 and len(terms) == 2:
            return self.make.form("sqrt(a)", terms[1])
        return self.make.form(form, *terms)

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
        return number(0.0)  # the name is a local parameter of the reaction

    def _piecewise(self, parts: list[Any]) -> Term:
        # Values and conditions alternate, and the value of ``otherwise`` is the last part.
        if len(parts) % 2 == 0:
            raise ExpressionError(
                "contains piecewise without otherwise, which has no value if no condition is true: "
                "add otherwise"
            )
        found = self._value(parts[-1])
        for value, condition in reversed(list(zip(parts[:-1:2], parts[1::2], strict=True))):
            terms = (self._condition(condition), self._value(value), found)
            found = self.make.form("where(a, b, c)", *terms)
        return found

    def _called(self, node: Any, given: list[Any]) -> tuple[FormulaReader, Any]:
        """Return a reader with the arguments of a call bound, and the function's body."""
        function = node.getName()
        if function not in self.functions:
            hint = nearest(function, self.functions)
            raise ExpressionError(f"calls '{brief(function)}', which is not a function{hint}")
        arguments = [self._value(part) for part in given]
        if function in self._calls:
            raise ExpressionError(f"calls '{function}', which calls itself")
        *names, body = children(self.functions[function])
        if len(names) != len(arguments):
            raise ExpressionError(
                f"calls '{function}' with {len(arguments)} arguments instead of {len(names)}"
            )
        bound = dict(zip((n.getName() for n in names), arguments, strict=True))
        return self._inner(bound, function), body

    def _condition(self, node: Any) -> Term:
        kind = self._descend(node)
        try:
            return self._condition_of(kind, node)
        finally:
            self._depth -= 1

    def _condition_of(self, kind: str, node: Any) -> Term:
        parts, make = children(node), self.make
        if kind in _BOOLEAN:
            return make.form("a > 0", number(float(kind == "CONSTANT_TRUE")))
        if kind == "FUNCTION" and node.getName() in self.functions:
            reader, body = self._called(node, parts)
            return reader._condition(body)
        prefix, _, name = kind.partition("_")
        if prefix == "RELATIONAL" and len(parts) >= 2:
            terms = [self._value(part) for part in parts]
            return _combined(
                ast.And, [make.form(_RELATIONS[name], *two) for two in pairwise(terms)]
            )
        conditions = [self._condition(part) for part in parts] if prefix == "LOGICAL" else []
        if name in ("AND", "OR") and conditions:
            return _combined(ast.And if name == "AND" else ast.Or, conditions)
        if (name, len(conditions)) in _LOGICAL:
            return make.form(_LOGICAL[name, len(conditions)], *conditions)
        raise ExpressionError(
            f"contains '{_shown(kind, node)}' instead of a condition: compare two values"
        )


def _combined(operator: type[ast.boolop], conditions: Sequence[Term]) -> Term:
    if len(conditions) == 1:
        return conditions[0]
    tree = ast.BoolOp(operator(), [c.tree for c in conditions])
    return Term(tree, sum(c.size for c in conditions), 1 + max(c.height for c in conditions))


def _chain(node: Any, kind: str) -> list[Any]:
    """Return the operands of a sum or product, including those of nested sums or products."""
    # Some tools write a sum of hundreds of terms as nested sums of two terms.
    found, waiting = [], [node]
    while waiting:
        own = waiting.pop()
        if own is not None and kind_of(own) == kind and own.getNumChildren():
            waiting += reversed(children(own))
        else:
            found.append(own)
    return found if found != [node] else []


def _shown(kind: str, node: Any) -> str:
    return brief(node.getName() or kind.removeprefix("FUNCTION_").lower())
