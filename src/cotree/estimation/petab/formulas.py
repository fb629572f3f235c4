"""PEtab's formulas, version 1, as expressions of scenes: rewritten as trees, never evaluated.

Each distinct formula, with the overrides of the measurement table substituted for its placeholders,
becomes one output. Noise formulas without names become numbers.
"""

from __future__ import annotations

import ast
import re
from typing import TYPE_CHECKING, ClassVar

from cotree.dag.nodes import Dag, Node
from cotree.errors import ExpressionError, brief, nearest
from cotree.readers.formulas import GROUP, Rewriter, python_text
from cotree.scene.expressions import fill, parse, shared_tree

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from cotree.estimation.petab.tables import MeasurementRow, ObservableRow, Tables


_LONGEST = 4000  # characters, the limit of expressions in scenes
_TIME = "time"

_TOKEN = re.compile(
    r"\s*(?:(?P<number>(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)|(?P<call>[A-Za-z_]\w*)\s*\("
    r"|(?P<name>[A-Za-z_]\w*)|(?P<sign>&&|\|\||[<>=!]=|\*\*|[-+*/^()<>,!]))",
    re.ASCII,
)
_SPELT = {"^": "**", "&&": "and", "||": "or", "!": "~", "true": "1", "false": "0"}
_SPELT |= {"(": f"{GROUP}("}
_FUNCTIONS = (
    *("sin", "cos", "tan", "sinh", "cosh", "tanh", "exp", "sqrt", "abs", "sign", "min", "max"),
    *("log", "ln", "log10", "log2", "sec", "csc", "cot", "sech", "csch", "coth"),
    *("arcsin", "arccos", "arctan", "arcsec", "arccsc", "arccot"),
    *("arcsinh", "arccosh", "arctanh"),
)


class Formula:
    """A formula in PEtab's syntax, with its ``names`` except ``time``, in order."""

    def __init__(self, text: str) -> None:
        found: dict[str, None] = {}

        def spelt(match: re.Match[str]) -> str:
            word = match[0].strip()
            if match["name"] and word not in (*_SPELT, _TIME):
                found[word] = None
            return _SPELT.get(word, word)

        try:
            self._text = python_text(text, _TOKEN, spelt, _LONGEST)
            self.expression(lambda name: name)
        except ExpressionError as error:
            raise ExpressionError(f"'{brief(text)}' {error}") from None
        self.names = tuple(found)

    def expression(self, meaning: Callable[[str], str]) -> str:
        """Write the formula as an expression of a scene."""

        def tree(name: str) -> ast.expr:
            return shared_tree("t" if name == _TIME else meaning(name))

        return _Rewriter(tree, _FUNCTIONS).text(self._text)


def number_of(expression: str, where: str) -> float | None:
    """Return the value of an expression without names, else None."""
    checked = parse(expression, where)
    return None if checked.names else checked.lower(Dag(), dict[str, Node]().__getitem__).value


class _Rewriter(Rewriter):
    own: ClassVar = {"piecewise": 3, "pow": 2}

    def own_call(self, name: str, args: Sequence[ast.expr]) -> ast.expr | None:
        if name == "piecewise" and len(args) % 2 == 1 and len(args) > 1:
            result = self.value(args[-1])
            for value, condition in reversed(list(zip(args[:-1:2], args[1::2], strict=True))):
                terms = (self.condition(condition), self.value(value), result)
                result = fill("where(a, b, c)", *terms)
            return result
        if name == "log" and len(args) == 2:
            return fill("log(a)/log(b)", *map(self.value, args))
        if name == "pow" and len(args) == 2:
            return fill("a**b", *map(self.value, args))
        return None

    def visit_BoolOp(self, node: ast.BoolOp) -> ast.expr:
        # They have equal precedence in PEtab, but not in Python.
        if any(isinstance(part, ast.BoolOp) for part in node.values):
            raise ExpressionError("mixes && and || in one condition: add parentheses")
        return super().visit_BoolOp(node)


PLACEHOLDER = re.compile(r"(observable|noise)Parameter([0-9]+)_(\w+)\Z")


class Outputs:
    """The outputs that measured rows need; ``expressions`` has them by name.

    ``meaning`` returns the expression for a name of the model or of the parameter table, or None;
    ``name`` returns an unused name of the scene, close to the one wished for.
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
        """Return the outputs of a row's observable and noise; constant noise is a number."""
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
