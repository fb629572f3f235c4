"""Conversion of formulas from other tools to scene expressions.

A reader converts the tokens of a formula to Python tokens. Python parses this text but never
evaluates it. Then names, conditions, powers and functions in the syntax tree are replaced.
"""

from __future__ import annotations

import ast
from typing import TYPE_CHECKING, ClassVar

from cotree.errors import ExpressionError, brief, nearest
from cotree.scene.expressions import FUNCTIONS, fill, read_tree, shared_tree

if TYPE_CHECKING:
    import re
    from collections.abc import Callable, Iterable, Mapping, Sequence

#: Function name before parentheses that only group operands; no tool has such a function.
GROUP = "ö"

_LONGEST = 6000  # maximum number of characters of a formula with its functions expanded

#: Functions of other tools as expressions with functions of scenes.
FORMS = {
    "ln": "log(a)",
    "log10": "log(a)/2.302585092994046",
    "log2": "log(a)/0.6931471805599453",
    "sgn": "sign(a)",
    "ceil": "-floor(-a)",
    **{f"arc{name}": f"a{name}(a)" for name in ("sin", "cos", "tan")},
    **{"sec": "1/cos(a)", "csc": "1/sin(a)", "cot": "1/tan(a)"},
    **{"sech": "1/cosh(a)", "csch": "1/sinh(a)", "coth": "1/tanh(a)"},
    **{"arcsec": "acos(1/a)", "arccsc": "asin(1/a)", "arccot": "atan(1/a)"},
    # The two terms in the logarithm have equal signs, so they do not cancel.
    "arcsinh": "where(a < 0, -1, 1)*log(where(a < 0, -1, 1)*a + sqrt(a*a + 1))",
    "arccosh": "log(a + sqrt(a*a - 1))",
    "arctanh": "log((1 + a)/(1 - a))/2",
    "arccsch": "where(a < 0, -1, 1)*log(where(a < 0, -1, 1)/a + sqrt(1/a*(1/a) + 1))",
    "arcsech": "log(1/a + sqrt(1/a*(1/a) - 1))",
    "arccoth": "log((1 + 1/a)/(1 - 1/a))/2",
    "u": "(1 + sign(a))/2",
    "u2": "min(max(a, 0), 1)",
    "uramp": "max(a, 0)",
    "pwr": "sign(a)*abs(a)**b",
    "limit": "min(max(a, b), c)",
}
FORMS |= {f"a{name}": FORMS[f"arc{name}"] for name in ("sinh", "cosh", "tanh")}


def python_text(
    text: str, token: re.Pattern[str], spell: Callable[[re.Match[str]], str], longest: int
) -> str:
    """Convert a formula to Python syntax, token by token."""
    text, parts, at = text.strip(), [], 0
    if len(text) > longest:
        raise ExpressionError(f"is longer than {longest} characters")
    while at < len(text):
        match = token.match(text, at)
        if match is None:
            raise ExpressionError(f"contains '{brief(text[at:].strip()[:1])}', which is not known")
        at = match.end()
        parts.append(spell(match))
    return " ".join(parts)


def compared(a: ast.expr, operator: type[ast.cmpop], b: ast.expr) -> ast.expr:
    """Return the tree that compares two trees; equality becomes two inequalities."""
    if operator in (ast.Eq, ast.NotEq):
        return fill("a <= b and a >= b" if operator is ast.Eq else "a < b or a > b", a, b)
    return ast.Compare(a, [operator()], [b])


def is_condition(tree: ast.expr) -> bool:
    """Return whether a syntax tree is a condition."""
    is_not = isinstance(tree, ast.UnaryOp) and isinstance(tree.op, ast.Not)
    return is_not or isinstance(tree, (ast.Compare, ast.BoolOp))


class Rewriter(ast.NodeTransformer):
    """Rewriter of a formula's tree; ``functions`` are those of scenes or keys of :data:`FORMS`."""

    #: Functions that :meth:`own_call` rewrites, with their numbers of arguments.
    own: ClassVar[Mapping[str, int]] = {}

    def __init__(self, name: Callable[[str], ast.expr], functions: Iterable[str]) -> None:
        self._name, self._functions = name, (*functions, *self.own)

    def text(self, formula: str) -> str:
        """Rewrite a formula that is in Python syntax."""
        try:
            return ast.unparse(self.value(read_tree(formula)))
        except RecursionError:
            raise ExpressionError("is nested deeper than expressions may be: split it") from None

    def value(self, tree: ast.expr) -> ast.expr:
        """Rewrite a value; a condition becomes 1 if it is true, else 0."""
        found: ast.expr = self.visit(tree)
        return fill("where(a, 1, 0)", found) if is_condition(found) else found

    def condition(self, tree: ast.expr) -> ast.expr:
        """Rewrite a condition; raise an error if it is a value."""
        found: ast.expr = self.visit(tree)
        if not is_condition(found):
            raise ExpressionError(
                f"uses '{brief(ast.unparse(found))}' as a condition, which is not a comparison: "
                "write x > 0"
            )
        return found

    def visit_Name(self, node: ast.Name) -> ast.expr:
        """Replace a name."""
        return self._name(node.id)

    def visit_BinOp(self, node: ast.BinOp) -> ast.expr:
        """Rewrite the operands of an operation."""
        return ast.BinOp(self.value(node.left), node.op, self.value(node.right))

    def visit_UnaryOp(self, node: ast.UnaryOp) -> ast.expr:
        """Rewrite a sign or a negation; readers write a negation as ``~``."""
        if isinstance(node.op, ast.Invert):
            return ast.UnaryOp(ast.Not(), self.condition(node.operand))
        return ast.UnaryOp(node.op, self.value(node.operand))

    def visit_BoolOp(self, node: ast.BoolOp) -> ast.expr:
        """Rewrite conditions that are joined by ``and`` or ``or``."""
        return ast.BoolOp(node.op, [self.condition(part) for part in node.values])

    def visit_IfExp(self, node: ast.IfExp) -> ast.expr:
        """Rewrite ``a ? b : c``, which readers write as ``a if (b) else c``."""
        condition, value = self.condition(node.body), self.value(node.test)
        return fill("where(a, b, c)", condition, value, self.value(node.orelse))

    def visit_Compare(self, node: ast.Compare) -> ast.expr:
        """Rewrite a comparison or a chain of comparisons."""
        sides = [self.value(side) for side in (node.left, *node.comparators)]
        parts = [
            compared(a, type(op), b)
            for a, op, b in zip(sides[:-1], node.ops, sides[1:], strict=True)
        ]
        return parts[0] if len(parts) == 1 else ast.BoolOp(ast.And(), parts)

    def visit_Call(self, node: ast.Call) -> ast.expr:
        """Rewrite a function call, or an expression in parentheses."""
        name = node.func.id if isinstance(node.func, ast.Name) else ""
        if name == GROUP and len(node.args) == 1:
            inner: ast.expr = self.visit(node.args[0])
            return inner
        found = self.own_call(name, node.args)
        return found or self._call(name, [self.value(arg) for arg in node.args])

    def own_call(self, name: str, args: Sequence[ast.expr]) -> ast.expr | None:
        """Rewrite a call of a function that only this tool has; return None for other functions."""
        return None

    def _call(self, name: str, args: list[ast.expr]) -> ast.expr:
        if name not in self._functions:
            shown = brief(name.replace(GROUP, "(...)"))
            hint = nearest(name, self._functions)
            raise ExpressionError(f"calls '{shown}', which is not a function here{hint}")
        form = FORMS.get(name)
        nodes = ast.walk(shared_tree(form)) if form else ()
        uses = [node.id for node in nodes if isinstance(node, ast.Name) and node.id in "abc"]
        count = len(set(uses)) if form else {**FUNCTIONS, **self.own}[name]
        if len(args) != count:
            raise ExpressionError(f"gives {name} {len(args)} arguments, not {count}")
        if form is None:
            return ast.Call(ast.Name(name), args, [])
        tree = fill(form, *args)
        # Functions that repeat their arguments make nested calls grow exponentially.
        if len(uses) > count and len(ast.unparse(tree)) > _LONGEST:
            raise ExpressionError(f"is longer than {_LONGEST} characters as an expression")
        return tree
