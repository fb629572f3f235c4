"""Display of expressions: short names of variables, and SymPy expressions as plain text or LaTeX.

``j1.s_dot`` becomes ``s_dot``, or ``s_j1_dot`` if ``s`` is ambiguous.
"""

from __future__ import annotations

import html
import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterable, Mapping, Sequence

#: LaTeX accents by the suffix of a coordinate, its rate and its acceleration.
ACCENTS = {"": "{}", "_dot": r"\dot{{{}}}", "_ddot": r"\ddot{{{}}}"}

# Names whose last characters become an index in LaTeX: theta1, q0, vx.
_INDEXED = re.compile(r"(?P<letter>[A-Za-z]+?)(?P<index>\d+|(?<=^v)[xyz])")


@dataclass(frozen=True)
class DisplayName:
    """The displayed name of a variable: a short name and an accent for the time derivative."""

    short: str  # the name without accent, such as ``theta_h2``
    suffix: str = ""  # accent of the name, a key of :data:`ACCENTS`

    @property
    def text(self) -> str:
        """The name in plain text."""
        return self.short + self.suffix

    def latex(self, *below: str) -> str:
        r"""Return the name in LaTeX with further subscripts: ``\dot{s}_{j1,L}``."""
        # A short name is a letter; if the letter is ambiguous, the name of the edge follows.
        letter, _, edge = self.short.partition("_")
        indices = [latex_symbol(edge)] if edge else []
        indexed = _INDEXED.fullmatch(letter)
        if indexed is not None:
            letter, indices = indexed["letter"], [indexed["index"], *indices]
        # LaTeX allows only one subscript, so join all indices.
        indices += below
        index = f"_{{{','.join(indices)}}}" if indices else ""
        return ACCENTS[self.suffix].format(latex_symbol(letter)) + index


#: MathML accents, and commands without effect there, by their names in LaTeX.
_MATHML_ACCENTS = {"dot": "&#729;", "ddot": "&#168;", "hat": "^", "bar": "&#175;", "tilde": "~"}
_MATHML_ACCENTS |= {"vec": "&#8594;", "overline": "&#175;"}
_MATHML_STYLES = frozenset({"mathrm", "operatorname", "mathbf", "text", "left", "right", "mathit"})


def real_symbol(name: str) -> Any:
    """Return the SymPy symbol of a variable."""
    import sympy

    return sympy.Symbol(name, real=True)


def latex_symbol(name: str) -> str:
    """Return a name in LaTeX."""
    import sympy

    text: str = sympy.latex(real_symbol(name))
    return text


def acceleration_name(speed: str, coordinates: Collection[str]) -> str:
    """Return the name of a speed's rate.

    >>> acceleration_name("j1.s_dot", ["j1.s"]), acceleration_name("b.w1", ["b.q0"])
    ('j1.s_ddot', 'b.w1_dot')
    """
    coordinate = speed.removesuffix("_dot")
    is_rate = coordinate != speed and coordinate in coordinates
    return f"{coordinate}_ddot" if is_rate else f"{speed}_dot"


def spell_states(
    coordinates: Sequence[str], speeds: Sequence[str], taken: Collection[str]
) -> dict[str, DisplayName]:
    """Return displayed names, not in ``taken``, of coordinates, speeds and accelerations.

    >>> shown = spell_states(["b.x", "h.theta"], ["b.vx", "h.theta_dot"], [])
    >>> {name: row.text for name, row in shown.items()}  # doctest: +NORMALIZE_WHITESPACE
    {'b.x': 'x', 'h.theta': 'theta', 'b.vx': 'vx', 'b.vx_dot': 'vx_dot',
     'h.theta_dot': 'theta_dot', 'h.theta_ddot': 'theta_ddot'}
    """
    # Angular velocities and the velocities of free bodies are not rates of coordinates.
    rates = {f"{name}_dot" for name in coordinates}
    short = short_names([*coordinates, *(name for name in speeds if name not in rates)], taken)
    shown = {name: DisplayName(short[name]) for name in coordinates}
    for name in speeds:
        if name in rates:
            own = short[name.removesuffix("_dot")]
            pair = DisplayName(own, "_dot"), DisplayName(own, "_ddot")
        else:
            pair = DisplayName(short[name]), DisplayName(short[name], "_dot")
        shown[name], shown[acceleration_name(name, coordinates)] = pair
    return shown


def spell_multipliers(rows: Iterable[str]) -> dict[str, DisplayName]:
    """Return the displayed name of each constraint's multiplier.

    >>> spell_multipliers(["D4.x"])["D4.x"].text
    'lambda_D4_x'
    """
    return {name: DisplayName(f"lambda_{name.replace('.', '_')}") for name in rows}


def short_names(coordinates: Sequence[str], taken: Collection[str]) -> dict[str, str]:
    """Return a short name for each coordinate: ``s``, or ``s_j1`` if ``s`` is ambiguous.

    >>> short_names(["j1.s", "h2.theta", "h3.theta"], {"m", "L"})
    {'j1.s': 's', 'h2.theta': 'theta_h2', 'h3.theta': 'theta_h3'}
    """
    own = [name.rpartition(".")[2] for name in coordinates]
    chosen: dict[str, str] = {}
    used = set(taken) | {"t"}
    for name in coordinates:
        edge, _, short = name.rpartition(".")
        # The names of rates and accelerations must also be free: s_dot may be a parameter.
        if own.count(short) > 1 or not used.isdisjoint(_derived(short)):
            short = f"{short}_{edge.replace('.', '_')}"
        while not used.isdisjoint(_derived(short)):
            short += "_"
        used.update(_derived(short))
        chosen[name] = short
    return chosen


def _derived(short: str) -> list[str]:
    return [f"{short}{suffix}" for suffix in ACCENTS]


def subscript(name: str | None, shown: Mapping[str, DisplayName]) -> str:
    """Return the subscript of a derivative: ``_L``, or ``_s(0)`` for a state."""
    if name is None:
        return ""
    return f"_{shown[name].text}(0)" if name in shown else f"_{name}"


def latex_subscript(name: str | None, shown: Mapping[str, DisplayName]) -> list[str]:
    """Return the subscript of a derivative in LaTeX."""
    if name is None:
        return []
    return [f"{shown[name].latex()}(0)" if name in shown else latex_symbol(name)]


def printer(kind: str, latex_names: Mapping[Any, str]) -> Callable[[Any], str]:
    """Return a SymPy printer that caches the texts of common subexpressions."""
    from sympy.printing.latex import LatexPrinter
    from sympy.printing.str import StrPrinter

    settings = {"full_prec": False}  # otherwise 1.5e-9 is printed as 1.50000000000000e-9
    if kind == "latex":
        printer = LatexPrinter({**settings, "symbol_names": dict(latex_names)})
    else:
        printer = StrPrinter(settings)
    plain, known = printer._print, {}

    def print_once(item: Any, **options: Any) -> Any:
        # The key contains the type, because 2 and 2.0 are equal but have different texts.
        key = (type(item), item)
        if options or not hasattr(item, "free_symbols"):
            return plain(item, **options)
        if key not in known:
            known[key] = plain(item)
        return known[key]

    ordered = printer._as_ordered_terms

    def plus_first(item: Any, order: Any = None) -> list[Any]:
        terms = list(ordered(item, order))
        # If possible, a sum starts with a positive term: a - b, not -b + a.
        first = next((t for t in terms if not t.could_extract_minus_sign()), terms[0])
        terms.remove(first)
        return [first, *terms]

    printer._print, printer._as_ordered_terms = print_once, plus_first
    spell: Callable[[Any], str] = printer.doprint
    return spell


def mathml_printer(latex_names: Mapping[Any, str]) -> Callable[[Any], str]:
    """Return a function that writes a sum's terms as MathML (presentation, ``mrow``)."""
    from sympy.printing.mathml import MathMLPresentationPrinter

    known = dict(latex_names)

    class Printer(MathMLPresentationPrinter):  # type: ignore[misc]
        def _print_Symbol(self, sym: Any, style: str = "plain") -> Any:
            element = self.dom.createElement("mrow")
            # SymPy writes the text of elements unchanged, so that it may contain markup.
            text = mathml_of_latex(known.setdefault(sym, latex_symbol(sym.name)))
            element.appendChild(self.dom.createTextNode(text))
            return element

        def _print_Function(self, e: Any) -> Any:
            element = super()._print_Function(e)
            name = element.firstChild.firstChild
            name.data = html.escape(name.data)
            return element

        def _print_Piecewise(self, e: Any) -> Any:
            rows = ""
            for value, condition in e.args:
                cells = [self._print(value).toxml(), "otherwise"]
                if condition not in (True,):
                    cells[1] = f"if&#160;</mtext>{self._print(condition).toxml()}<mtext>"
                cells[1] = f"<mtext>{cells[1]}</mtext>"
                rows += f"<mtr>{''.join(f'<mtd>{cell}</mtd>' for cell in cells)}</mtr>"
            element = self.dom.createElement("mrow")
            text = f"<mo>{{</mo><mtable columnalign='left'>{rows}</mtable>"
            element.appendChild(self.dom.createTextNode(text))
            return element

    printer = Printer()

    def spell(terms: Sequence[Any]) -> str:
        parts = []
        for i, term in enumerate(terms):
            is_minus = term.could_extract_minus_sign()
            sign = "<mo>&#8722;</mo>" if is_minus else "<mo>+</mo>" if i else ""
            parts.append(sign + str(printer.doprint(-term if is_minus else term)))
        # In some fonts, hyphens are shorter than minus signs, and SymPy's sign for e is missing.
        text = "".join(parts).replace("<mo>-</mo>", "<mo>&#8722;</mo>")
        for sign in ("&ExponentialE;", "&#8519;", "\u2147"):
            text = text.replace(sign, "e")
        return f"<mrow>{text or '<mn>0</mn>'}</mrow>"

    return spell


_TOKEN = re.compile(r"\\([A-Za-z]+)|([{}_^,])|(\d+|[^\W\d_]+|.)")


def mathml_of_latex(text: str) -> str:
    r"""Convert the LaTeX name of a variable to MathML.

    >>> mathml_of_latex(r"\dot{s}_{1}")
    '<msub><mover><mi>s</mi><mo>&#729;</mo></mover><mn>1</mn></msub>'
    """
    from sympy.printing.pretty.pretty_symbology import greek_unicode

    tokens = [match.groups() for match in _TOKEN.finditer(text)]

    def one() -> str:
        command, mark, word = tokens.pop(0)
        if mark == "{":
            found = several("}")
            tokens.pop(0)
            return found
        if command in _MATHML_ACCENTS:
            return f"<mover>{one()}<mo>{_MATHML_ACCENTS[command]}</mo></mover>"
        if command in _MATHML_STYLES:
            return one()
        own = greek_unicode.get(command, command) if command else word or mark
        tag = "mn" if own.isdigit() else "mi" if own.isalnum() else "mo"
        return f"<{tag}>{html.escape(own)}</{tag}>"

    def several(end: str) -> str:
        parts: list[str] = []
        while tokens and tokens[0][1] != end:
            mark = tokens[0][1]
            if mark and mark in "_^" and parts:
                tokens.pop(0)
                tag = "msub" if mark == "_" else "msup"
                parts[-1] = f"<{tag}>{parts[-1]}{one()}</{tag}>"
            elif tokens[0] == (None, None, " "):
                tokens.pop(0)
            else:
                parts.append(one())
        return parts[0] if len(parts) == 1 else f"<mrow>{''.join(parts)}</mrow>"

    return several("")


def joined(terms: Sequence[str]) -> str:
    """Join terms to a sum; some begin with a minus sign."""
    text = terms[0] if terms else "0"
    for term in terms[1:]:
        text += f" - {term[1:].lstrip()}" if term.startswith("-") else f" + {term}"
    return text
