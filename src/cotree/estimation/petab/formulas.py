"""PEtab's formulas, version 1, as expressions of scenes: rewritten as trees, never evaluated.

PEtab writes ``a^b``, ``ln(x)``, ``log10(x)``, ``piecewise(value, condition, ..., otherwise)`` and
``&&`` where scenes write ``a**b``, ``log(x)``, ``log(x)/log(10)``, ``where(condition, value,
otherwise)`` and ``and``. The result is checked against the grammar of scenes.

Each distinct formula, with the overrides of the measurement table substituted for its placeholders,
becomes one output. Noise formulas without names become numbers.
"""

from __future__ import annotations

import ast
import re
from typing import TYPE_CHECKING

from cotree.dag.nodes import Dag, Node
from cotree.errors import ExpressionError, brief, nearest
from cotree.scene.expressions import parse, read_tree

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from cotree.estimation.petab.tables import MeasurementRow, ObservableRow, Tables


_LONGEST = 4000  # characters, the limit of expressions in scenes

_TOKEN = re.compile(
    r"\s*(?:(?P<number>(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)|(?P<name>[A-Za-z_][A-Za-z0-9_]*)"
    r"|(?P<sign>&&|\|\||[<>=!]=|\*\*|[-+*/^()<>,!]))"
)

# PEtab's functions in terms of those of scenes; ``{0}`` is the argument.
_AS = {
    "ln": "log({0})",
    "log10": "log({0})/2.302585092994046",
    "log2": "log({0})/0.6931471805599453",
    "sec": "1/cos({0})",
    "csc": "1/sin({0})",
    "cot": "1/tan({0})",
    "sech": "1/cosh({0})",
    "csch": "1/sinh({0})",
    "coth": "1/tanh({0})",
    "arcsin": "asin({0})",
    "arccos": "acos({0})",
    "arctan": "atan({0})",
    "arcsec": "acos(1/{0})",
    "arccsc": "asin(1/{0})",
    "arccot": "atan(1/{0})",
    "arcsinh": "log({0} + sqrt({0}**2 + 1))",
    "arccosh": "log({0} + sqrt({0}**2 - 1))",
    "arctanh": "log((1 + {0})/(1 - {0}))/2",
}
_SAME = ("sin", "cos", "tan", "sinh", "cosh", "tanh", "exp", "sqrt", "abs", "sign", "min", "max")

_TIME = "time"


class Formula:
    """A formula that is parsed once and can be written with different meanings of its names.

    Parameters
    ----------
    text : str
        The formula in PEtab's syntax.

    Attributes
    ----------
    names : tuple of str
        The names in it except ``time``, in order.

    Raises
    ------
    ExpressionError
        If the text is not a formula.
    """

    def __init__(self, text: str) -> None:
        self.text = text
        try:
            self._tree = read_tree(_python_text(text))
        except ExpressionError as error:
            raise ExpressionError(f"'{brief(text)}' {error}") from None
        functions = {id(node.func) for node in ast.walk(self._tree) if isinstance(node, ast.Call)}
        found = [
            node.id
            for node in ast.walk(self._tree)
            if isinstance(node, ast.Name) and id(node) not in functions
        ]
        self.names = tuple(name for name in dict.fromkeys(found) if name != _TIME)

    def expression(self, meaning: Callable[[str], str]) -> str:
        """Write the formula as an expression of a scene.

        Parameters
        ----------
        meaning : callable
            Returns the expression that a name stands for.

        Raises
        ------
        ExpressionError
            If scenes have no equivalent of a function in it.
        """
        tree: ast.expr = _Rewriting(meaning).visit(_copied(self._tree))
        return ast.unparse(ast.fix_missing_locations(tree))


def number_of(expression: str, where: str) -> float | None:
    """Return the value of an expression without names, else None.

    Raises
    ------
    ExpressionError
        If it is not an expression, or has no value.
    """
    checked = parse(expression, where)
    if checked.names:
        return None
    return checked.lower(Dag(), _unknown).value


def _unknown(name: str) -> Node:
    raise AssertionError(f"'{name}' in an expression without names")


def _copied(tree: ast.expr) -> ast.expr:
    # Rewriting changes trees in place; writing and parsing the text is the simplest copy.
    return read_tree(ast.unparse(tree))


def _python_text(text: str) -> str:
    """Translate PEtab's operators to Python's."""
    if len(text) > _LONGEST:
        raise ExpressionError(f"is longer than {_LONGEST} characters")
    place, found = 0, []
    joined: list[set[str]] = [set()]
    text = text.strip()
    while place < len(text):
        match = _TOKEN.match(text, place)
        if match is None:
            raise ExpressionError(
                f"contains '{text[place:].strip()[:1]}', which PEtab does not allow"
            )
        place, token = match.end(), match[0].strip()
        if token == "(":
            joined.append(set())
        elif token == ")" and len(joined) > 1:
            joined.pop()
        elif token == ",":
            joined[-1].clear()
        elif token in ("&&", "||"):
            # They have equal precedence in PEtab, but not in Python.
            joined[-1].add(token)
            if len(joined[-1]) > 1:
                raise ExpressionError("mixes && and || in one condition: add parentheses")
        found.append(_SPELT.get(token, token))
    return " ".join(found)


_SPELT = {"^": "**", "&&": "and", "||": "or", "!": "not", "true": "1", "false": "0"}


class _Rewriting(ast.NodeTransformer):
    """Rewrites functions, comparisons and names."""

    def __init__(self, meaning: Callable[[str], str]) -> None:
        self._meaning = meaning

    def visit_Name(self, node: ast.Name) -> ast.expr:
        return read_tree("t" if node.id == _TIME else self._meaning(node.id))

    def visit_Call(self, node: ast.Call) -> ast.expr:
        name = node.func.id if isinstance(node.func, ast.Name) else ""
        args: list[ast.expr] = [self.visit(arg) for arg in node.args]
        if name == "piecewise" and len(args) % 2 == 1 and len(args) > 1:
            result = args[-1]
            for value, condition in reversed(list(zip(args[:-1:2], args[1::2], strict=True))):
                result = _call("where", condition, value, result)
            return result
        if name in _AS and len(args) == 1:
            return read_tree(_AS[name].format(f"({ast.unparse(args[0])})"))
        if name == "log" and len(args) == 2:
            return ast.BinOp(_call("log", args[0]), ast.Div(), _call("log", args[1]))
        if name == "pow" and len(args) == 2:
            return ast.BinOp(args[0], ast.Pow(), args[1])
        if name in (*_SAME, "log"):
            return _call(name, *args)
        raise ExpressionError(
            f"'{brief(ast.unparse(node))}' is not a function of PEtab, or has the wrong number of "
            "arguments"
        )

    def visit_Compare(self, node: ast.Compare) -> ast.expr:
        sides = [self.visit(side) for side in (node.left, *node.comparators)]
        parts: list[ast.expr] = []
        for a, op, b in zip(sides[:-1], node.ops, sides[1:], strict=True):
            if isinstance(op, (ast.Eq, ast.NotEq)):
                # Expressions of scenes have no equality; a <= b and a >= b is equivalent.
                both = ast.BoolOp(
                    ast.And(), [_compared(a, ast.LtE(), b), _compared(a, ast.GtE(), b)]
                )
                is_equal = isinstance(op, ast.Eq)
                parts.append(both if is_equal else ast.UnaryOp(ast.Not(), both))
            else:
                parts.append(_compared(a, op, b))
        return parts[0] if len(parts) == 1 else ast.BoolOp(ast.And(), parts)


def _call(name: str, *args: ast.expr) -> ast.Call:
    return ast.Call(ast.Name(name), list(args), [])


def _compared(a: ast.expr, op: ast.cmpop, b: ast.expr) -> ast.Compare:
    return ast.Compare(a, [op], [b])


PLACEHOLDER = re.compile(r"(observable|noise)Parameter([0-9]+)_(\w+)\Z")


class Outputs:
    """The outputs that measured rows need.

    Parameters
    ----------
    tables : Tables
        The tables.
    meaning : callable
        Returns the expression for a name of the model or of the parameter table, or None.
    name : callable
        Returns an unused name of the scene, close to the one wished for.

    Attributes
    ----------
    expressions : dict of str to str
        Expressions of the outputs by name.
    """

    def __init__(
        self,
        tables: Tables,
        meaning: Callable[[str], str | None],
        name: Callable[[str], str],
    ) -> None:
        self._tables, self._meaning, self._name = tables, meaning, name
        self._formulas: dict[tuple[str, str], Formula] = {}
        self._found: dict[tuple[object, ...], tuple[str, str | float]] = {}
        self._by_expression: dict[str, str] = {}
        self.expressions: dict[str, str] = {}

    def of_row(self, row: MeasurementRow) -> tuple[str, str | float]:
        """Return the outputs of a row's observable and noise; constant noise is a number.

        Raises
        ------
        SceneError
            If a formula is invalid, or the overrides do not match its placeholders.
        """
        key = (row.observable, row.observable_parameters, row.noise_parameters)
        if key not in self._found:
            observable = self._tables.observables[row.observable]
            overrides = self._overrides(row, observable)
            self._found[key] = self._pair(row, observable, overrides)
        return self._found[key]

    def _pair(
        self, row: MeasurementRow, observable: ObservableRow, overrides: Mapping[str, str]
    ) -> tuple[str, str | float]:
        """Form the two outputs of an observable with overrides."""
        formula = self._formula(observable, "observableFormula")
        wanted = self._expression(row, observable, formula, overrides)
        name = self._output(observable.name, wanted)
        formula = self._formula(observable, "noiseFormula")
        # A noise formula may name any observable by its identifier.
        known = dict(overrides)
        for other in formula.names:
            if other in self._tables.observables and other not in known:
                its = self._tables.observables[other]
                inner = self._formula(its, "observableFormula")
                known[other] = f"({self._expression(row, its, inner, overrides)})"
        noise = self._expression(row, observable, formula, known)
        try:
            number = number_of(noise, "noiseFormula")
        except ExpressionError as error:
            raise observable.row.error(str(error)) from None
        if number is None:
            return name, self._output(f"noise_{observable.name}", noise)
        if not number > 0.0:
            raise row.row.error(f"the noise of '{observable.name}' is {number:g}: not positive")
        return name, number

    def _output(self, wish: str, expression: str) -> str:
        """Return the output of an expression; equal expressions share one."""
        if expression not in self._by_expression:
            name = self._name(wish)
            self._by_expression[expression] = name
            self.expressions[name] = expression
        return self._by_expression[expression]

    def _formula(self, observable: ObservableRow, column: str) -> Formula:
        key = (observable.name, column)
        if key not in self._formulas:
            text = observable.formula if column == "observableFormula" else observable.noise
            try:
                self._formulas[key] = Formula(text)
            except ExpressionError as error:
                raise observable.row.error(f"{column}: {error}") from None
        return self._formulas[key]

    def _expression(
        self,
        row: MeasurementRow,
        observable: ObservableRow,
        formula: Formula,
        overrides: Mapping[str, str],
    ) -> str:
        def meaning(name: str) -> str:
            found = overrides.get(name) or self._meaning(name)
            if found is not None:
                return found
            if (match := PLACEHOLDER.match(name)) is not None:
                raise row.row.error(
                    f"'{observable.name}' needs a value for '{name}': "
                    f"'{match[1]}Parameters' has too few"
                )
            known = sorted(self._tables.parameters)
            raise observable.row.error(
                f"'{name}' in the formula of '{observable.name}' is neither in the model nor a "
                f"parameter{nearest(name, known)}"
            )

        try:
            return formula.expression(meaning)
        except ExpressionError as error:
            raise observable.row.error(str(error)) from None

    def _overrides(self, row: MeasurementRow, observable: ObservableRow) -> dict[str, str]:
        """Return the expressions that replace the placeholders, by name."""
        found = {}
        for kind, given, column in (
            ("observable", row.observable_parameters, "observableFormula"),
            ("noise", row.noise_parameters, "noiseFormula"),
        ):
            names = self._formula(observable, column).names
            for number, value in enumerate(given, start=1):
                placeholder = f"{kind}Parameter{number}_{observable.name}"
                if placeholder not in names:
                    raise row.row.error(
                        f"'{kind}Parameters' has {len(given)} entries, but {column} of "
                        f"'{observable.name}' has no '{placeholder}'"
                    )
                if isinstance(value, str):
                    meaning = self._meaning(value)
                    if meaning is None:
                        hint = nearest(value, self._tables.parameters)
                        raise row.row.error(f"'{value}' in '{kind}Parameters' is unknown{hint}")
                    found[placeholder] = meaning
                else:
                    found[placeholder] = f"({value!r})" if value < 0.0 else repr(value)
        return found
