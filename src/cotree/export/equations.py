"""Equations for people: SymPy, LaTeX and plain text of governing and sensitivity equations.

In: :class:`~cotree.equations.Equations`. Out: :class:`SymbolicEquations`, which reads like the
paper's Eq. (8) and (9): inertia terms first, with positive sign, then the rest, equal to zero.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from cotree.export.to_sympy import to_sympy

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Mapping, Sequence

    from cotree.dag.nodes import Node
    from cotree.equations import Derivative, Equations

#: A name, or a state's name with the parameter that it is differentiated with respect to.
Key = str | tuple[str, str]

# Entries of the mass matrix beyond this many operations are left as they come: expanding them
# costs more than it shows.
_LARGEST_TIDIED = 40

#: Endings of a coordinate, its rate and its acceleration, and how LaTeX marks them.
ACCENTS = {"": "{}", "_dot": r"\dot{{{}}}", "_ddot": r"\ddot{{{}}}"}


@dataclass(frozen=True)
class SymbolicEquations:
    """Governing and sensitivity equations as SymPy expressions.

    Attributes
    ----------
    governing : tuple of sympy.Eq
        One for each coordinate, ``... = 0``.
    sensitivity : mapping of str to tuple of sympy.Eq
        The equations of the sensitivity graph of each requested parameter (or of each state whose
        initial value is meant).
    states : tuple of str
        Names of the states.
    symbols : mapping of str or (str, str) to sympy.Symbol
        By name: coordinates (``"j1.s"``), their rates (``"j1.s_dot"``) and accelerations
        (``"j1.s_ddot"``), parameters, inputs and ``"t"``; the sensitivity of each of the first
        three by a pair such as ``("j1.s_dot", "L")``.
    initial : mapping of str or (str, str) to sympy.Expr
        Initial values of the states and of their sensitivities.
    latex_names : mapping of sympy.Symbol to str
        How LaTeX spells the coordinates and their derivatives.
    """

    governing: tuple[Any, ...]
    sensitivity: Mapping[str, tuple[Any, ...]]
    states: tuple[str, ...]
    symbols: Mapping[Key, Any]
    initial: Mapping[Key, Any]
    latex_names: Mapping[Any, str]

    def lines(self, name: str | None = None) -> list[str]:
        """Write the governing equations, or those of one sensitivity, as plain text.

        Parameters
        ----------
        name : str, optional
            A key of :attr:`sensitivity`.

        Returns
        -------
        list of str
            One line for each coordinate.
        """
        spell = _printer("text", {})
        return [self._line(equation, spell, name) for equation in self._equations(name)]

    def latex(self) -> str:
        """Write all equations as one LaTeX ``align`` environment, the governing ones first."""
        spell = _printer("latex", self.latex_names)
        rows = [
            f"  {self._line(equation, spell, name).removesuffix(' = 0')} &= 0"
            for name in (None, *self.sensitivity)
            for equation in self._equations(name)
        ]
        return "\n".join([r"\begin{align}", ", \\\\\n".join(rows) + ".", r"\end{align}"])

    def __str__(self) -> str:
        return "\n".join(line for name in (None, *self.sensitivity) for line in self.lines(name))

    def _equations(self, name: str | None) -> tuple[Any, ...]:
        return self.governing if name is None else self.sensitivity[name]

    def _line(self, equation: Any, spell: Callable[[Any], str], name: str | None) -> str:
        """Write an equation with the terms of the highest derivatives first."""
        order: list[Any] = []
        for suffix in ("_ddot", "_dot", ""):
            rows = [f"{c}{suffix}" for c in self.states[: len(self.governing)]]
            order += [] if name is None else [self.symbols[row, name] for row in rows]
            order += [self.symbols[row] for row in rows]

        def place(term: Any) -> int:
            found = term.free_symbols
            return next((i for i, symbol in enumerate(order) if symbol in found), len(order))

        terms = sorted(equation.lhs.as_ordered_terms(), key=place)
        return f"{joined([spell(term) for term in terms])} = 0"


def _printer(kind: str, latex_names: Mapping[Any, str]) -> Callable[[Any], str]:
    """Give SymPy's printer, made to spell each shared subexpression once."""
    from sympy.printing.latex import LatexPrinter
    from sympy.printing.str import StrPrinter

    settings = {"full_prec": False}  # 1.5e-9, not 1.50000000000000e-9
    if kind == "latex":
        printer = LatexPrinter({**settings, "symbol_names": dict(latex_names)})
    else:
        printer = StrPrinter(settings)
    plain, known = printer._print, {}

    def print_once(item: Any, **options: Any) -> Any:
        key = (type(item), item)
        if options or not hasattr(item, "free_symbols"):
            return plain(item, **options)
        if key not in known:
            known[key] = plain(item)
        return known[key]

    ordered = printer._as_ordered_terms

    def plus_first(item: Any, order: Any = None) -> list[Any]:
        terms = list(ordered(item, order))
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


def symbolic_equations(equations: Equations) -> SymbolicEquations:
    """Turn equations into SymPy.

    Parameters
    ----------
    equations : Equations
        The governing equations, and those of the sensitivity graphs that were asked for.

    Examples
    --------
    >>> from cotree.formulation.first_graph import form_first_graph
    >>> from cotree.scene.description import SceneDescription
    >>> from cotree.scene.graphs import choose_trees, joint_tree, linear_graphs
    >>> from cotree.sensitivity.graphs import form_equations
    >>> scene = SceneDescription("block")
    >>> scene.parameter("m", 2.0)
    >>> scene.parameter("k", 50.0)
    >>> scene.edge("body", "rigid_body", "ground", "A", mass="m")
    >>> scene.edge("guide", "prismatic", "ground", "A", axis=[1, 0, 0], stiffness="k")
    >>> tree = joint_tree(scene, choose_trees(scene, linear_graphs(scene), None))
    >>> print(symbolic_equations(form_equations(form_first_graph(scene, tree), ["k"])))
    m*s_ddot + k*s = 0
    m*s_ddot_k + k*s_k + s = 0
    """
    names = _Names.of(equations)
    known = names.known(equations)
    matrix = [[_tidied(entry) for entry in to_sympy(row, known)] for row in equations.matrix]
    rest = to_sympy(equations.forcing, known)
    rates = [names.symbols[f"{c}_ddot"] for c in names.coordinates]
    initial: dict[Key, Any] = dict(
        zip(
            names.states,
            to_sympy([state.initial for state in equations.states], known),
            strict=True,
        )
    )
    sensitivity = {}
    for direction in equations.sensitivities:
        name = direction.name
        own = names.known_along(equations, direction)
        tangents = [names.symbols[f"{c}_ddot", name] for c in names.coordinates]
        sensitivity[name] = _balances(matrix, tangents, to_sympy(direction.forcing, known | own))
        values = to_sympy(direction.initial, known)
        initial |= {(s, name): v for s, v in zip(names.states, values, strict=True)}
    return SymbolicEquations(
        governing=_balances(matrix, rates, rest),
        sensitivity=sensitivity,
        states=names.states,
        symbols=names.symbols,
        initial=initial,
        latex_names=names.latex,
    )


def _balances(matrix: list[list[Any]], rates: list[Any], forcing: list[Any]) -> tuple[Any, ...]:
    """Write matrix @ rates - forcing = 0, row by row."""
    import sympy

    return tuple(
        sympy.Eq(
            sympy.Add(*[a * w for a, w in zip(row, rates, strict=True)], -b), 0, evaluate=False
        )
        for row, b in zip(matrix, forcing, strict=True)
    )


def _tidied(entry: Any) -> Any:
    """Write an entry of the mass matrix shorter, if it is small and expanding it helps."""
    import sympy

    size = entry.count_ops()
    if size > _LARGEST_TIDIED:
        return entry
    number, factors = sympy.factor_terms(sympy.expand(entry)).as_coeff_mul()
    # Numbers go back into the sum: m (L^2/3 + r^2/4), not m (4 L^2 + 3 r^2)/12.
    sums = [factor for factor in factors if factor.is_Add][:1]
    others = [factor for factor in factors if factor not in sums]
    if sums:
        others.append(sympy.Add(*[number * term for term in sums[0].args]))
        number = 1
    other = sympy.Mul(number, *others)
    return other if other.count_ops() < size else entry


def short_names(coordinates: Sequence[str], taken: Collection[str]) -> dict[str, str]:
    """Choose a short name for each coordinate: ``s``, or ``s_j1`` where ``s`` says too little.

    Parameters
    ----------
    coordinates : sequence of str
        Names ``edge.coordinate``.
    taken : collection of str
        Names of parameters and inputs, which come first.

    Examples
    --------
    >>> short_names(["j1.s", "h2.theta", "h3.theta"], {"m", "L"})
    {'j1.s': 's', 'h2.theta': 'theta_h2', 'h3.theta': 'theta_h3'}
    """
    own = [name.partition(".")[2] for name in coordinates]
    chosen: dict[str, str] = {}
    used = set(taken) | {"t"}
    for name in coordinates:
        edge, _, short = name.partition(".")
        if own.count(short) > 1 or not used.isdisjoint(_derived(short)):
            short = f"{short}_{edge}"
        while not used.isdisjoint(_derived(short)):
            short += "_"
        used.update(_derived(short))
        chosen[name] = short
    return chosen


def _derived(short: str) -> list[str]:
    return [f"{short}{suffix}" for suffix in ACCENTS]


@dataclass(frozen=True)
class _Names:
    """Symbols by name, and how LaTeX spells those of the coordinates."""

    coordinates: tuple[str, ...]
    states: tuple[str, ...]
    symbols: dict[Key, Any]
    latex: dict[Any, str]

    @classmethod
    def of(cls, equations: Equations) -> _Names:
        """Choose the names of every symbol of the equations."""
        states = tuple(state.name for state in equations.states)
        coordinates = states[: len(equations.unknowns)]
        given = [row.name for row in (*equations.parameters, *equations.inputs)]
        short = short_names(coordinates, given)
        names = cls(coordinates, states, {}, {})
        used = {*given, "t"}
        for name in (*given, "t"):
            names.symbols[name] = _symbol(name)
        for along in (None, *(direction.name for direction in equations.sensitivities)):
            for coordinate in coordinates:
                for suffix in ACCENTS:
                    spelt = f"{short[coordinate]}{suffix}{subscript(along, short)}"
                    while spelt in used:
                        spelt += "_"
                    used.add(spelt)
                    symbol, row = _symbol(spelt), f"{coordinate}{suffix}"
                    names.symbols[row if along is None else (row, along)] = symbol
                    names.latex[symbol] = _latex_name(short[coordinate], suffix, along, short)
        return names

    def known(self, equations: Equations) -> dict[Node, Any]:
        """Give the SymPy symbol of each symbol of the first graph."""
        dag, n = equations.dag, len(self.coordinates)
        known = {state.symbol: self.symbols[state.name] for state in equations.states}
        for i in range(n):
            known[equations.unknowns[i]] = self.symbols[f"{self.coordinates[i]}_ddot"]
        for kind, rows in (("p", equations.parameters), ("u", equations.inputs)):
            known |= {dag.symbol(kind, i): self.symbols[row.name] for i, row in enumerate(rows)}
        known[dag.symbol("t", 0)] = self.symbols["t"]
        return known

    def known_along(self, equations: Equations, direction: Derivative) -> dict[Node, Any]:
        """Give the SymPy symbols of one sensitivity graph."""
        tangents = {state.name: direction.seed[state.symbol] for state in equations.states}
        return {node: self.symbols[name, direction.name] for name, node in tangents.items()}


def _symbol(name: str) -> Any:
    import sympy

    return sympy.Symbol(name, real=True)


def subscript(name: str | None, short: Mapping[str, str]) -> str:
    """Write what a derivative is taken with respect to: ``_L``, or ``_s(0)`` for a state."""
    if name is None:
        return ""
    coordinate = name.removesuffix("_dot")
    if coordinate in short:
        return f"_{short[coordinate]}{name[len(coordinate) :]}(0)"
    return f"_{name}"


def _latex_name(short: str, suffix: str, name: str | None, all_short: Mapping[str, str]) -> str:
    r"""Spell a coordinate, its rate or acceleration, or its derivative: ``\dot{s}_{j1,L}``."""
    import sympy

    letter, _, edge = short.partition("_")
    below = [sympy.latex(_symbol(edge))] if edge else []
    if name is not None:
        coordinate = name.removesuffix("_dot")
        if coordinate in all_short:
            below.append(
                _latex_name(all_short[coordinate], name[len(coordinate) :], None, {}) + "(0)"
            )
        else:
            below.append(sympy.latex(_symbol(name)))
    index = f"_{{{','.join(below)}}}" if below else ""
    return ACCENTS[suffix].format(sympy.latex(_symbol(letter))) + index
