"""Spelling of SymPy expressions for people, as text or LaTeX."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence


def printer(kind: str, latex_names: Mapping[Any, str]) -> Callable[[Any], str]:
    """Give SymPy's printer, made to spell each shared subexpression once.

    Parameters
    ----------
    kind : {'text', 'latex'}
        The language.
    latex_names : mapping of sympy.Symbol to str
        LaTeX of symbols.
    """
    from sympy.printing.latex import LatexPrinter
    from sympy.printing.str import StrPrinter

    settings = {"full_prec": False}  # 1.5e-9, not 1.50000000000000e-9
    if kind == "latex":
        printer = LatexPrinter({**settings, "symbol_names": dict(latex_names)})
    else:
        printer = StrPrinter(settings)
    plain, known = printer._print, {}

    def print_once(item: Any, **options: Any) -> Any:
        # Numbers of different types are equal, but spelt differently: 2 and 2.0.
        key = (type(item), item)
        if options or not hasattr(item, "free_symbols"):
            return plain(item, **options)
        if key not in known:
            known[key] = plain(item)
        return known[key]

    ordered = printer._as_ordered_terms

    def plus_first(item: Any, order: Any = None) -> list[Any]:
        terms = list(ordered(item, order))
        # Sums begin with a positive term where there is one: a - b, not -b + a.
        first = next((t for t in terms if not t.could_extract_minus_sign()), terms[0])
        terms.remove(first)
        return [first, *terms]

    printer._print, printer._as_ordered_terms = print_once, plus_first
    spell: Callable[[Any], str] = printer.doprint
    return spell


def joined(terms: Sequence[str]) -> str:
    """Join terms, some of which begin with a minus sign, to a sum."""
    text = terms[0] if terms else "0"
    for term in terms[1:]:
        text += f" - {term[1:].lstrip()}" if term.startswith("-") else f" + {term}"
    return text
