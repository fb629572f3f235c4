"""Conversion of numbers with suffixes and of expressions to the grammar of scenes."""

from __future__ import annotations

import ast
import math
import re
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, ClassVar

from cotree.dag.nodes import Dag
from cotree.errors import ExpressionError, brief
from cotree.readers.formulas import GROUP, Rewriter, python_text
from cotree.readers.spice.netlist import unquoted
from cotree.scene.expressions import FUNCTIONS, fill, parse, shared_tree

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterator, Mapping, Sequence

    from cotree.dag.nodes import Node
    from cotree.readers.names import SourceLine
    from cotree.readers.spice.netlist import UserFunction

#: A number, or an expression in the grammar of scenes.
Value = float | str

#: Name and value of a parameter as written, and its line.
ParameterRow = tuple[str, str, "SourceLine"]

_DIGITS = r"(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?"
_NUMBER = re.compile(rf"([+-]?{_DIGITS})([A-Za-zµ]*)\Z", re.ASCII)
_TOKEN = re.compile(
    rf"\s*(?:(?P<number>{_DIGITS}[A-Za-zµ]*\d*)"
    r"|(?P<signal>[vViI]\s*\(\s*[^\s(),]+\s*(?:,\s*[^\s(),]+\s*)?\))"
    r"|(?P<call>[A-Za-z_][\w.]*)\s*\(|(?P<name>[A-Za-z_][\w.]*)"
    r"|(?P<sign>\*\*|<=|>=|==|!=|&&|\|\||[-+*/^(),<>?:!]))",
    re.ASCII,
)
_SIGNAL = re.compile(r"([vi])\s*\(\s*([^\s(),]+)\s*(?:,\s*([^\s(),]+)\s*)?\)", re.I | re.ASCII)
#: Operators, with their equivalents in Python.
_SPELT = {"^": "**", "&&": "and", "||": "or", "!": "~", "?": "if (", ":": ") else"}
_SPELT |= {"(": f"{GROUP}("}
#: Functions of netlists that scenes lack or that have another name in scenes.
_FORMS = (
    *("ln", "log10", "sgn", "arctan", "asinh", "acosh", "atanh"),
    *("u", "u2", "uramp", "ceil", "pwr", "limit"),
)
#: A number with a suffix instead of the decimal point, as printed on resistors.
_PRINTED = re.compile(r"([+-]?\d+)(?![eE]\d)([A-Za-zµ]+)(\d+)\Z", re.ASCII)
_ATTO = re.compile(rf"(?<![\w.]){_DIGITS}([aA][A-Za-z]*)(?!\w)", re.ASCII)
_SUFFIXES = {
    **{"t": 1e12, "g": 1e9, "meg": 1e6, "k": 1e3, "mil": 25.4e-6, "m": 1e-3},
    **{"u": 1e-6, "µ": 1e-6, "n": 1e-9, "p": 1e-12, "f": 1e-15, "a": 1e-18},
}
_WORD = re.compile(r"[a-z_]\w*", re.ASCII)
_DEEPEST = 20  # maximum nesting of functions
_LONGEST = 6000  # maximum number of characters of an expression after substitution of parameters


def ordered(rows: Mapping[str, ParameterRow], given: Collection[str] = ()) -> list[str]:
    """Sort parameters after those in their values, except ``given`` ones; otherwise as in the file.

    If parameters form a cycle, a name in it refers to the enclosing circuit or is unknown.
    """
    done: dict[str, None] = {}
    begun: set[str] = set()
    for first in rows:
        waiting = [first]
        while waiting:
            name = waiting[-1]
            begun.add(name)
            words = () if name in given else _WORD.findall(rows[name][1].lower())
            ahead = [word for word in words if word in rows and word not in begun]
            if ahead:
                waiting.append(ahead[0])
            else:
                done[waiting.pop()] = None
    return list(done)


def read_number(word: str) -> float | None:
    """Return the value of a number with suffix and ignored unit; None if it is not a number."""
    match = _NUMBER.match(word)
    if match is None:
        return None
    value = _scaled(match.group(1), match.group(2))
    return value if math.isfinite(value) else None


def number_text(word: str) -> str:
    """Convert a number with a suffix to a text without suffix."""
    check_point(word)
    value = read_number(word)
    if value is None:
        raise ExpressionError(f"holds '{brief(word)}', which is not a finite number")
    return repr(value)


def check_point(word: str) -> None:
    """Raise an error for a suffix instead of the decimal point, on which simulators disagree."""
    match = _PRINTED.match(word)
    if match is not None:
        whole, factor, rest = match.groups()
        raise ExpressionError(
            f"is {whole}.{rest}{factor} in some simulators and {whole}{factor} in others: write "
            "which is meant"
        )


def _is_ampere(letters: str) -> bool:
    """Return whether letters after a number are the unit ampere instead of the suffix atto."""
    small = letters.lower()
    return small == "a" or small.startswith("amp")


def _scaled(digits: str, letters: str) -> float:
    small = letters.lower()
    if _is_ampere(letters):
        return float(digits)
    # Case is ignored, so m is milli and meg is mega. Letters after the suffix are a unit.
    suffix = next((s for s in ("meg", "mil") if small.startswith(s)), small[:1])
    if suffix not in _SUFFIXES:
        return float(digits)
    power = round(math.log10(_SUFFIXES[suffix])) if suffix != "mil" else 0
    if suffix == "mil" or "e" in digits.lower():
        return float(digits) * _SUFFIXES[suffix]
    return float(f"{digits}e{power}")  # a single rounding, so that 1.1u is 1.1e-6


@dataclass(frozen=True)
class Scope:
    """Values of names in the main circuit or in an instance of a subcircuit."""

    #: Values of parameters, by name in lower case.
    values: dict[str, Value] = field(default_factory=dict)
    outer: Scope | None = None  # enclosing scope; None for the main circuit
    #: Functions of ``.func``, by name in lower case.
    functions: Mapping[str, UserFunction] = field(default_factory=dict)
    #: Notes about the netlist, stored in the outermost scope.
    remarks: list[str] = field(default_factory=list)

    def _outwards(self) -> Iterator[Scope]:
        """Yield this scope, then the enclosing ones from the innermost to the outermost."""
        scope: Scope | None = self
        while scope is not None:
            yield scope
            scope = scope.outer

    def remark(self, text: str) -> None:
        """Add a note to the outermost scope, unless the scope already contains it."""
        *_, outermost = self._outwards()
        if text not in outermost.remarks:
            outermost.remarks.append(text)

    def find(self, name: str) -> Value | None:
        """Return the value of a parameter from the innermost scope that defines it, or None."""
        return next((s.values[name] for s in self._outwards() if name in s.values), None)

    def function(self, name: str) -> UserFunction | None:
        """Return a function of ``.func`` from the innermost scope that defines it, or None."""
        return next((s.functions[name] for s in self._outwards() if name in s.functions), None)

    def value(self, word: str, at: SourceLine) -> Value:
        """Return the value of a number, a parameter name, or an expression in braces or quotes."""
        self._check_unit(word, at)
        number = read_number(word)
        if number is not None:
            return number
        body = unquoted(word)
        try:
            check_point(body.strip())
            return self._expression(body)
        except ExpressionError as error:
            raise at.error(f"'{brief(word)}' {error}") from None

    def _check_unit(self, word: str, at: SourceLine) -> None:
        """Add a note if a number has the letter a, on which simulators disagree: ampere or atto."""
        for match in _ATTO.finditer(word):
            is_ampere = _is_ampere(match[1])
            meaning = "in amperes" if is_ampere else "1e-18 of its unit"
            self.remark(
                f"{at}: '{brief(match[0])}' is taken as {meaning}; some simulators take the "
                "letter a for 1e-18 everywhere, some nowhere: write the power of ten"
            )

    def _expression(self, body: str) -> Value:
        text = SpiceFormula(self).text(body)
        expression = parse(text, "an expression")
        # Names in the expression are parameters of the scene, which may change.
        if expression.names:
            return text
        value = expression.lower(Dag(), dict[str, "Node"]().__getitem__).value
        if value is None or not math.isfinite(value):
            raise ExpressionError("has no finite value")
        return value


class SpiceFormula(Rewriter):
    """Rewriter of a netlist's expressions for scenes.

    ``signal`` converts voltages and currents; if it is None, they raise an error.
    """

    own: ClassVar = {"if": 3, "ternary_fcn": 3, "pow": 2}

    def __init__(
        self,
        scope: Scope,
        signal: Callable[[str, str, str | None], str] | None = None,
        depth: int = 0,
    ) -> None:
        super().__init__(lambda name: self._put[name], (*FUNCTIONS, *_FORMS))
        self._scope, self._signal, self._depth = scope, signal, depth
        #: Syntax trees that replace placeholder names.
        self._put: dict[str, ast.expr] = {}
        self._length = 0

    def text(self, formula: str) -> str:
        """Rewrite an expression of a netlist for scenes."""
        if not formula.strip():
            raise ExpressionError("ends where a value is expected")
        return super().text(python_text(formula, _TOKEN, self._spelt, _LONGEST))

    def _spelt(self, match: re.Match[str]) -> str:
        word = match[0].strip()
        if match["number"]:
            return number_text(word)
        if match["sign"]:
            if word in ("==", "!="):
                raise ExpressionError(f"compares by '{word}': compare by < <= > >=")
            return _SPELT.get(word, word)
        if match["call"]:
            name = match["call"].lower()
            if name in ("v", "i") and self._signal is not None:
                raise ExpressionError(
                    f"calls '{name}', which takes a name in parentheses: V(node), V(node, node) "
                    "or I(source)"
                )
            return f"{'ternary_fcn' if name == 'if' else name}("
        text = self._named(word) if match["name"] else self._signal_text(word)
        mark = f"{GROUP}{len(self._put)}"
        self._put[mark] = self._substituted(text)
        return mark

    def _substituted(self, text: str) -> ast.expr:
        """Return the syntax tree of a text that replaces a name or a call."""
        # Nested definitions may grow exponentially.
        self._length += len(text)
        if self._length > _LONGEST:
            raise ExpressionError(f"is longer than {_LONGEST} characters with its parameters")
        return shared_tree(text)

    def _signal_text(self, word: str) -> str:
        match = _SIGNAL.fullmatch(word)
        assert match is not None
        if self._signal is None:
            raise ExpressionError(f"calls '{match[1]}', which is not a function of parameters")
        if match[3] and match[1] in "iI":
            raise ExpressionError(f"takes a current of two names: '{brief(word)}'")
        return self._signal(match[1].lower(), match[2], match[3])

    def _named(self, word: str) -> str:
        name = word.lower()
        found = self._scope.find(name)
        # Parameters take precedence over constants of the same name.
        if found is not None:
            return text_of(found)
        known = {"pi": repr(math.pi)}
        if self._signal is not None:
            known |= {"time": "t", "temper": "27.0"}
        if name not in known:
            raise ExpressionError(f"names '{brief(word)}', which is not a parameter")
        return known[name]

    def own_call(self, name: str, args: Sequence[ast.expr]) -> ast.expr | None:
        """Rewrite a conditional expression, a power or a function of ``.func``."""
        if (own := self._scope.function(name)) is not None:
            return self._expanded(name, own, [ast.unparse(self.value(arg)) for arg in args])
        if name == "ternary_fcn" and len(args) == 3:
            return fill("where(a, b, c)", self.condition(args[0]), *map(self.value, args[1:]))
        if name == "pow" and len(args) == 2:
            # In parameters, ngspice keeps the sign of the base in ``pow``, but not in ``**``.
            base, exponent = map(self.value, args)
            return self._power(base, exponent) if self._signal else fill("a**b", base, exponent)
        # In laws, ngspice keeps the sign of the base in ``pwr``; in parameters, it does not.
        if name == "pwr" and len(args) == 2:
            base, exponent = map(self.value, args)
            if self._signal is None:
                return fill("abs(a)**b", base, exponent)
            # The sign of zero is positive, which matters if the exponent is zero.
            if not (isinstance(exponent, ast.Constant) and exponent.value):
                return fill("where(a < 0, -1, 1)*abs(a)**b", base, exponent)
        return None

    def _expanded(self, name: str, own: UserFunction, args: Sequence[str]) -> ast.expr:
        """Return the body of a ``.func`` function with the given arguments inserted."""
        if len(args) != len(own.arguments):
            raise ExpressionError(f"gives {name} {len(args)} arguments, not {len(own.arguments)}")
        if self._depth >= _DEEPEST:
            raise ExpressionError(f"calls '{brief(name)}', nested more than {_DEEPEST} levels deep")
        inner = Scope(dict(zip(own.arguments, args, strict=True)), self._scope)
        formula = SpiceFormula(inner, self._signal, self._depth + 1)
        return self._substituted(f"({formula.text(own.body)})")

    def visit_BinOp(self, node: ast.BinOp) -> ast.expr:
        """Rewrite an operation; powers are left-associative, as in ngspice."""
        if not isinstance(node.op, ast.Pow):
            return super().visit_BinOp(node)
        base, exponent = self.value(node.left), node.right
        while True:
            has_sign = isinstance(exponent, ast.UnaryOp)
            inner = exponent.operand if isinstance(exponent, ast.UnaryOp) else exponent
            if not (isinstance(inner, ast.BinOp) and isinstance(inner.op, ast.Pow)):
                break
            first = ast.UnaryOp(ast.USub(), inner.left) if has_sign else inner.left
            base, exponent = self._power(base, self.value(first)), inner.right
        return self._power(base, self.value(exponent))

    def _power(self, base: ast.expr, exponent: ast.expr) -> ast.expr:
        """Return a power; in laws, its base is an absolute value, as in ngspice."""
        power = exponent.value if isinstance(exponent, ast.Constant) else None
        is_even = isinstance(power, float) and power % 2.0 == 0.0
        # Even powers and powers of numbers need no absolute value.
        if not (is_even or isinstance(base, ast.Constant)):
            if self._signal is not None:
                self._scope.remark(
                    "powers of voltages and currents use absolute values, as in ngspice: write "
                    "products to keep signs"
                )
            base = fill("abs(a)", base)
        return fill("a**b", base, exponent)


def text_of(value: Value) -> str:
    """Return the text of a value as an operand, in parentheses."""
    return f"({value!r})" if isinstance(value, float) else f"({value})"


def scaled(value: Value, factor: Value, sign: str = "*") -> Value:
    """Return the product or quotient of two values."""
    if factor == 1.0:
        return value
    if isinstance(value, float) and isinstance(factor, float):
        return value * factor if sign == "*" else value / factor
    return f"{text_of(value)}{sign}{text_of(factor)}"


def is_zero(value: Value | None) -> bool:
    """Return whether a value is absent or the number zero."""
    return value is None or value == 0.0
